"""`masks`: the object that is held in front, without hand, arm, background, and whoever stands behind."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import run_command

from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.recording import Frame, Recording
from reconstruct.masks import Click, Foreground, Masks, carry_masks
from reconstruct.segmenters import Prompt

H, W, F = 120, 160, 140.0
SKIN, SLEEVE, BLUE, GREY = (205, 150, 125), (90, 60, 100), (40, 70, 200), (60, 60, 60)
RNG = np.random.default_rng(0)
WALL = cv2.GaussianBlur(RNG.integers(0, 255, (400, 500, 3), np.uint8), (0, 0), 1.5)
PAINT = cv2.GaussianBlur(RNG.integers(0, 60, (40, 50, 3), np.uint8), (0, 0), 1.0)


def film(
    n: int = 20, shift: float = 0.0, person: bool = False, still: bool = False, paint: tuple = (BLUE, GREY)
) -> Recording:
    """A blue and grey block in a hand whose arm comes from below, before a wall; `shift`: the camera's, px."""

    def load(i: int) -> Frame:
        x = round(shift * i)
        rgb, depth = WALL[100 : 100 + H, 100 + x : 100 + x + W].copy(), np.full((H, W), 1.5, np.float32)
        if person:
            at = 50 + round(4 * np.sin(i))
            rgb[10:, at : at + 60], depth[10:, at : at + 60] = (150, 140, 30), 0.9
        c = 40 + round(0 if still else 25 * (1 + np.sin(0.36 * i)))
        mask = np.zeros((H, W), bool)
        mask[30:62, c : c + 45] = True
        rgb[30:46, c : c + 45], rgb[46:62, c : c + 45] = paint
        rgb[26:66, c - 3 : c + 47][mask[26:66, c - 3 : c + 47]] += PAINT[:, :50].reshape(-1, 3)[: 45 * 32]
        for rows, colour in ((slice(52, 95), SKIN), (slice(95, H), SLEEVE)):
            rgb[rows, c + 14 : c + 30] = colour
            mask[rows, c + 14 : c + 30] = False
        depth[mask] = 0.5
        depth[52:, c + 14 : c + 30] = 0.48
        noise = np.random.default_rng(i).normal(0, 0.001, depth.shape)
        return Frame(rgb, (depth + noise).astype(np.float32), mask)

    return Recording(Camera(np.array([[F, 0, W / 2], [0, F, H / 2], [0, 0, 1]]), W, H), np.arange(n) / 30, load)


def iou_of(found: np.ndarray, recording: Recording) -> float:
    true = np.stack([frame.mask for frame in recording.frames()])
    return float((true & found).sum() / (true | found).sum())


@pytest.mark.parametrize("case", [{}, {"person": True}, {"shift": 1.7}])
def test_the_object_is_found_without_hand_arm_wall_and_who_stands_behind(case: dict):
    recording = film(**case)
    found = Foreground(recording).masks()
    assert iou_of(found.masks, recording) > (0.7 if "shift" in case else 0.8), case
    assert np.median(found.doubt) < 0.5
    hand = np.stack([frame.depth < 0.6 for frame in recording.frames()])
    hand &= ~np.stack([frame.mask for frame in recording.frames()])
    assert (found.masks & hand).sum() < 0.1 * hand.sum()


def test_a_scene_in_which_nothing_moves_is_refused():
    with pytest.raises(FreeArtError, match="nothing that is held"):
        Foreground(film(still=True)).masks()


def test_two_clicks_part_a_wooden_object_from_the_hand():
    recording = film(paint=((150, 95, 60), (130, 80, 50)))  # the hues of skin
    foreground, where = Foreground(recording), np.stack([frame.mask for frame in recording.frames()])
    before = iou_of(foreground.masks().masks, recording)
    clicks = []
    for place in ((38, 5), (55, 5), (55, 40)):
        row, column = place[0], int(np.flatnonzero(where[10].any(0))[0]) + place[1]
        clicks.append(Click(10, column, row, bool(where[10, row, column])))
    clicks.append(Click(10, int(np.flatnonzero(where[10].any(0))[0]) + 22, 80, False))
    after = foreground.masks(clicks)
    assert before < 0.6 and iou_of(after.masks, recording) > max(0.75, before + 0.2), before
    assert after.masks[10, clicks[0].row, clicks[0].column] and not after.masks[10, 80, clicks[3].column]


def test_a_click_corrects_the_surface_around_it_in_other_frames():
    foreground = Foreground(film())
    without = foreground.masks().masks
    at = [int(np.flatnonzero(m.any(0))[0]) + 10 for m in without]
    after = foreground.masks([Click(5, at[5], 37, False)]).masks
    assert without[5, 37, at[5]] and not after[5, 37, at[5]] and not after[7, 37, at[7]]
    with pytest.raises(FreeArtError, match="not in the video"):
        foreground.masks([Click(99, 5, 5, True)])


def write_film(folder: Path, recording: Recording) -> Path:
    for sub in ("rgb", "depth"):
        (folder / sub).mkdir(parents=True)
    (folder / "cam_K.txt").write_text(f"{F} 0 {W / 2 - 0.5}\n0 {F} {H / 2 - 0.5}\n0 0 1\n")
    for i, frame in enumerate(recording.frames()):
        cv2.imwrite(str(folder / "rgb" / f"{i:05d}.png"), frame.rgb[..., ::-1])
        cv2.imwrite(str(folder / "depth" / f"{i:05d}.png"), (1000 * frame.depth).astype(np.uint16))
    return folder


def test_the_command_writes_what_convert_and_film_take(tmp_path: Path, capsys):
    recording = film()
    source, out = write_film(tmp_path / "block", recording), tmp_path / "masks"
    for _ in range(2):  # its own older output is replaced
        code, shown, _ = run_command(capsys, "masks", source, "--out", out)
        assert code == 0 and "of 20 masks are doubtful" in shown
    assert len(json.loads((out / "masks.json").read_text())["frames"]) == 20
    page = (out / "index.html").read_text()
    assert page.count("<figure") >= 12 and "doubt" in page
    code, _, err = run_command(capsys, "convert", source, "--to", "native", "--out", tmp_path / "data", "--masks", out)
    assert code == 0, err
    (out / "mine.txt").write_text("kept")
    code, _, err = run_command(capsys, "masks", source, "--out", out)
    assert code == 1 and "mine.txt" in err and (out / "mine.txt").exists()


class Fixed:
    """Gives what it is made with, and keeps what it was asked."""

    name = "fixed"

    def __init__(self, masks: np.ndarray) -> None:
        self.masks = masks
        self.prompts: list[Prompt] = []

    def carry(self, pictures, prompts):
        assert pictures[0].shape == (H, W, 3) and len(pictures) == len(self.masks)
        self.prompts = list(prompts)
        return self.masks


def test_a_segmenter_starts_from_the_least_doubtful_masks_and_from_clicks():
    recording = film(9)
    true = np.stack([frame.mask for frame in recording.frames()])
    own = Masks(true.copy(), np.array([0.3, 0.1, 0.3, 0.3, 0.3, 0.2, 0.0, 0.3, 0.3]), ("",) * 9)
    own.masks[4, :46] = False  # half of it
    segmenter = Fixed(true.copy())
    segmenter.masks[8] = False
    made = carry_masks(recording, own, segmenter, [Click(5, 60.0, 40.0, True), Click(5, 1.0, 1.0, False)])
    assert [prompt.frame for prompt in segmenter.prompts] == [1, 6, 5]
    assert segmenter.prompts[2].clicks == ((60.0, 40.0, True), (1.0, 1.0, False)) and segmenter.prompts[2].mask is None
    assert np.array_equal(segmenter.prompts[0].mask, true[1]) and np.array_equal(made.masks, segmenter.masks)
    assert made.doubt[8] == 1 and 0.3 < made.doubt[4] < 0.7 and not made.doubt[[0, 1, 2, 3, 5, 6, 7]].any()
    assert made.reasons[8] == "fixed finds nothing" and "from frames 1, 6, 5" in made.notes[-1]
    with pytest.raises(FreeArtError, match="no frame has a mask to start from"):
        carry_masks(recording, Masks(np.zeros_like(true), own.doubt, ("",) * 9), segmenter)


def test_an_unknown_segmenter_and_missing_weights_are_refused_before_anything_is_read(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("FREEART21_WEIGHTS", str(tmp_path))
    for name, words in (("sam3", "unknown segmenter 'sam3'; segmenters: sam2"), ("sam2", "sam2.1_hiera_")):
        code, out, err = run_command(capsys, "masks", tmp_path / "film", "--out", tmp_path / "m", "--segmenter", name)
        assert code == 1 and words in err and not out and not (tmp_path / "m").exists()
