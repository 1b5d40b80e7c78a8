"""A look at a video before it is solved: each fault is graded, and a good video has none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run_command

from freeart21.camera import Camera
from freeart21.recording import Frame, Recording
from reconstruct.look import look_at

H, W, N = 120, 160, 60
ROW, COLUMN = np.indices((H, W))


def video(change=lambda i, frame: frame, n=N, fps=30.0, fov=1.1, times=None) -> Recording:
    """A textured ball of 10 cm, a quarter of a metre away, that moves to and fro; `change` spoils a frame."""
    camera = Camera.from_fov(W, H, fov)
    texture = np.random.default_rng(0).integers(30, 220, (H // 4, W // 4, 3)).astype(np.uint8)
    texture = np.kron(texture, np.ones((4, 4, 1), np.uint8))

    def load(i: int) -> Frame:
        shift = round(8 * np.sin(i / 3))
        r = np.hypot(COLUMN - W / 2 - shift, ROW - H / 2) / (0.2 * camera.K[0, 0])
        mask = r < 1
        depth = np.where(mask, 0.25 - 0.05 * np.sqrt(np.maximum(1 - r**2, 0)), 0).astype(np.float32)
        return change(i, Frame(np.roll(texture, shift, 1), depth, mask))

    return Recording(camera, np.arange(n) / fps if times is None else times, load)


def test_a_good_video_has_no_fault():
    found = look_at(video())
    assert found.grade == "good" and {f.advice for f in found.findings} == {""}, found.findings
    of = {f.what: f.value for f in found.findings}
    assert of["frames"] == "60" and of["frame rate"] == "30 a second" and of["distance"] in ("0.21 m", "0.22 m")
    assert 11 <= int(of["size of the object"].split()[0]) <= 15
    assert found.sheet.shape == (3 * 480, 4 * 320, 3)


def without_mask(i, f):
    return replace(f, mask=np.zeros_like(f.mask))


def with_noise(i, f):
    noise = np.random.default_rng(i).normal(0, 0.006, f.depth.shape).astype(np.float32)
    return replace(f, depth=np.where(f.depth > 0, f.depth + noise, 0))


FAULTS = {
    "field of view": (dict(fov=2.6), "bad"),
    "frames": (dict(n=4), "bad"),
    "frame rate": (dict(fps=3.0), "bad"),
    "longest gap": (dict(times=np.r_[np.arange(30), 60 + np.arange(30)] / 30), "bad"),
    "frames without the object": (dict(change=lambda i, f: without_mask(i, f) if i % 2 else f), "bad"),
    "frames that cut the object": (dict(change=lambda i, f: replace(f, mask=f.mask | (ROW == 0))), "bad"),
    "depth inside the mask": (dict(change=lambda i, f: replace(f, depth=f.depth * (COLUMN % 5 == 0))), "bad"),
    "distance": (dict(change=lambda i, f: replace(f, depth=1000 * f.depth)), "bad"),
    "size of the object": (dict(change=lambda i, f: replace(f, depth=f.depth / 10)), "bad"),
    "depth noise, pixel by pixel": (dict(change=with_noise), "poor"),
    "overexposed pixels": (dict(change=lambda i, f: replace(f, rgb=np.full_like(f.rgb, 255))), "bad"),
    "motion from frame to frame": (dict(change=lambda i, f: video().frame(0)), "bad"),
}


@pytest.mark.parametrize("what", FAULTS)
def test_each_fault_is_graded_with_advice(what: str):
    settings, grade = FAULTS[what]
    look = look_at(video(**settings))
    found = next(f for f in look.findings if f.what == what)
    assert found.grade == grade and found.advice, found
    assert look.grade == "bad" or grade != "bad"


def test_an_object_that_is_never_seen_is_bad():
    found = {f.what: f for f in look_at(video(without_mask)).findings}
    assert found["frames without the object"].value == "100 %" and found["object, share of the picture"].grade == "bad"


def test_the_command_says_how_to_make_a_sequence_of_something_else(tmp_path: Path, capsys):
    (tmp_path / "lid.r3d").write_bytes(b"")
    code, _, err = run_command(capsys, "look", tmp_path / "lid.r3d", "--out", tmp_path / "look.html")
    assert code == 1 and err.count("\n") == 1 and "freeart21 convert" in err and not (tmp_path / "look.html").exists()
