"""Plain folders as cameras and segmenters write them: masks of every kind, time stamps in names, depth that is none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from refusal import assert_refused

from freeart21.errors import FreeArtError
from freeart21.formats import third_party
from freeart21.formats.convert import convert
from freeart21.formats.rgbd_folder import read_rgbd_folder
from freeart21.formats.third_party import ReadOptions

W, H = 24, 16
OBJECT = np.zeros((H, W), np.uint8)
OBJECT[4:12, 6:11] = 1
OBJECT[4:12, 11:18] = 2
PALETTE = [0, 0, 0, 128, 0, 0]  # Pillow pads it with black: label 2 has the background's colour


def write_frame(folder: Path, name: str, at: int = 0, mask: np.ndarray | None = None, depth: int = 500) -> None:
    """One frame of the folder: grey colours of brightness `at`, depth of the object alone, its mask."""
    pictures = {
        "rgb": np.full((H, W, 3), at, np.uint8),
        "depth": np.where(OBJECT > 0, depth, 0).astype(np.uint16),
        "masks": np.where(OBJECT > 0, 255, 0).astype(np.uint8) if mask is None else mask,
    }
    for sub, image in pictures.items():
        (folder / sub).mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(folder / sub / f"{name}.png"), image)
    (folder / "cam_K.txt").write_text("20 0 11.5\n0 20 7.5\n0 0 1\n")


def in_palette(path: Path, palette: list[int] = PALETTE, labels: np.ndarray = OBJECT) -> None:
    image = Image.fromarray(labels)
    image.putpalette(palette)
    image.save(path)


def cut_out(path: Path) -> None:
    picture = np.full((H, W, 4), 90, np.uint8)
    picture[..., 3] = np.where(OBJECT > 0, 255, 0)
    cv2.imwrite(str(path), picture)


def enlarged(path: Path) -> None:
    small = cv2.resize((OBJECT > 0).astype(np.uint8) * 255, (W // 2, H // 2), interpolation=cv2.INTER_NEAREST)
    cv2.imwrite(str(path), cv2.resize(small, (W, H), interpolation=cv2.INTER_LINEAR))


def soft(path: Path) -> None:
    inside = cv2.distanceTransform((OBJECT > 0).astype(np.uint8), cv2.DIST_L2, 5)
    outside = cv2.distanceTransform((OBJECT == 0).astype(np.uint8), cv2.DIST_L2, 5)
    rng = np.random.default_rng(1)
    distance = inside - outside + 0.3 * rng.random((H, W))
    cv2.imwrite(str(path), np.rint(255 / (1 + np.exp(-2 * distance))).astype(np.uint8))


COLOURS = np.array([[0, 0, 0], [0, 0, 255], [0, 160, 0]], np.uint8)  # blue, green, red
MASKS: dict[str, Callable[[Path], object]] = {
    "labels": lambda path: cv2.imwrite(str(path), OBJECT),
    "labels_and_void": lambda path: cv2.imwrite(str(path), np.array([0, 1, 255], np.uint8)[OBJECT]),
    "labels_spread": lambda path: cv2.imwrite(str(path), np.array([0, 100, 200], np.uint8)[OBJECT]),
    "labels_16_bits": lambda path: cv2.imwrite(str(path), OBJECT.astype(np.uint16)),
    "white_16_bits": lambda path: cv2.imwrite(str(path), np.where(OBJECT > 0, 65535, 0).astype(np.uint16)),
    "bits": lambda path: Image.fromarray(OBJECT > 0).save(path),
    "red": lambda path: cv2.imwrite(str(path), COLOURS[np.minimum(OBJECT, 1)]),
    "colours": lambda path: cv2.imwrite(str(path), COLOURS[OBJECT]),
    "palette": in_palette,
    "palette_of_white_first": lambda path: in_palette(path, [255, 255, 255, 0, 0, 0], (OBJECT == 0).astype(np.uint8)),
    "opaque": lambda path: cv2.imwrite(str(path), np.dstack([COLOURS[OBJECT], np.full((H, W), 255, np.uint8)])),
    "cut_out": cut_out,
    "enlarged": enlarged,
    "soft": soft,
}


@pytest.mark.parametrize("kind", MASKS)
def test_a_mask_of_any_kind_is_the_object(tmp_path: Path, kind: str) -> None:
    MASKS[kind](tmp_path / "mask.png")
    shown = third_party.read_foreground(tmp_path / "mask.png")
    wrong = int(np.count_nonzero(shown != (OBJECT > 0)))
    assert wrong <= (4 if kind == "enlarged" else 0), f"{wrong} pixels"  # enlarging rounds the four corners


def test_masks_in_jpeg(tmp_path: Path) -> None:
    large = np.kron(OBJECT > 0, np.ones((8, 8))).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "mask.jpg"), 255 * large, [cv2.IMWRITE_JPEG_QUALITY, 60])
    assert np.array_equal(third_party.read_foreground(tmp_path / "mask.jpg"), large > 0)
    noise = np.random.default_rng(0).integers(0, 8, large.shape).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "empty.jpg"), noise)
    assert not third_party.read_foreground(tmp_path / "empty.jpg").any()


def test_masks_that_say_nothing_are_refused(tmp_path: Path) -> None:
    for k in range(3):
        write_frame(tmp_path / "lid", str(k), mask=np.zeros((H, W), np.uint8) if k else OBJECT)
        write_frame(tmp_path / "box", str(k), mask=np.where(OBJECT > 0, 0, 255).astype(np.uint8))  # inverted
    with pytest.raises(FreeArtError, match="mask is empty in 2 of 3 frames"):
        list(convert(tmp_path / "lid", tmp_path / "data", "native"))
    with pytest.raises(FreeArtError, match="mask covers the picture's rim in 3 of 3 frames"):
        list(convert(tmp_path / "box", tmp_path / "data", "native"))
    assert not (tmp_path / "data").exists()


TIMES = [0.0, 0.1, 0.2, 0.3, 0.6, 1.1]
STAMPS: dict[str, Callable[[float], str]] = {
    "tum": lambda t: f"{1305031102.7 + t:.6f}",
    "short": lambda t: str(round(1305031102.9 + t, 3)),  # as str writes it: 1305031103.0, 1305031103.1
    "prefixed": lambda t: f"rgb_{9.9 + t:.3f}",
    "ms": lambda t: str(round(1e3 * (1305031102 + t))),
    "us": lambda t: str(round(1e6 * (1305031102 + t))),
    "ns": lambda t: str(1305031102 * 10**9 + round(t * 1e9)),
    "ns_prefixed": lambda t: f"frame-{1305031102 * 10**9 + round(t * 1e9)}",
}


@pytest.mark.parametrize("kind", STAMPS)
def test_times_are_those_of_the_names(tmp_path: Path, kind: str) -> None:
    for k, t in enumerate(TIMES):
        write_frame(tmp_path / "lid", STAMPS[kind](t), k)
    read = read_rgbd_folder(tmp_path / "lid")
    assert read.recording.times_s == pytest.approx(TIMES, abs=1e-6)
    assert [int(frame.rgb[0, 0, 0]) for frame in read.recording.frames()] == list(range(len(TIMES)))
    assert read.notes[0].endswith("6 frames in 1.1 s, 100 ms apart; gaps are kept (2), the longest 0.5 s after frame 4")
    assert read_rgbd_folder(tmp_path / "lid", ReadOptions(fps=10)).recording.times_s == pytest.approx(
        [0, 0.1, 0.2, 0.3, 0.4, 0.5]
    )


def test_depth_has_stamps_of_its_own_as_in_tum(tmp_path: Path) -> None:
    for k in range(4):
        write_frame(tmp_path / "lid", f"{100 + k / 30:.6f}", k, depth=500 + k)
    for k, path in enumerate(sorted((tmp_path / "lid/depth").iterdir())):
        if k == 2:
            path.unlink()
        else:
            path.rename(path.with_name(f"{100.007 + k / 30:.6f}.png"))
    read = read_rgbd_folder(tmp_path / "lid")
    assert [int(frame.depth.max() * 1000 + 0.5) for frame in read.recording.frames()] == [500, 501, 503]
    assert read.recording.times_s == pytest.approx([0, 1 / 30, 0.1], abs=1e-6)
    assert read.notes[0].startswith("1 of 4 colours have no depth and mask within 20 ms")


def test_two_frames_of_one_time_are_refused(tmp_path: Path) -> None:
    for name in ("1.5", "1.50", "1.6"):
        write_frame(tmp_path / "lid", name)
    assert_refused(r"1\.5\.png and 1\.50\.png have one time stamp", read_rgbd_folder, tmp_path / "lid")


def test_frames_with_other_names_go_by_their_numbers(tmp_path: Path) -> None:
    for k in (2, 12):
        write_frame(tmp_path / "lid", f"img_{k}", k)
        for sub in ("depth", "masks"):
            path = tmp_path / "lid" / sub / f"img_{k}.png"
            path.rename(path.with_name(f"{k:05d}.png"))
    read = read_rgbd_folder(tmp_path / "lid")
    assert [int(frame.rgb[0, 0, 0]) for frame in read.recording.frames()] == [2, 12]
    assert "step by 10 to 10" in read.notes[0]


@pytest.mark.parametrize("none", [65535, 10000, 2047])
def test_what_stands_for_no_depth_is_none(tmp_path: Path, none: int) -> None:
    for k in range(3):
        write_frame(tmp_path / "lid", str(k), depth=500 + k)
        path = tmp_path / f"lid/depth/{k}.png"
        raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        raw[raw == 0] = none
        raw[5, 7] = none  # a hole in the object
        cv2.imwrite(str(path), raw)
    (done,) = convert(tmp_path / "lid", tmp_path / "data", "native")
    assert f"depth {none} is taken as none" in done.notes
    for k, frame in enumerate(read_rgbd_folder(tmp_path / "lid").recording.frames()):
        assert frame.depth.max() == pytest.approx(0.5 + k / 1000) and frame.depth[5, 7] == 0


def test_a_wall_behind_the_object_is_depth(tmp_path: Path) -> None:
    write_frame(tmp_path / "lid", "0")
    raw = np.where(OBJECT > 0, 500, np.linspace(800, 2000, W)).astype(np.uint16)  # a floor leads to the wall
    raw[:, -1] = 2000
    cv2.imwrite(str(tmp_path / "lid/depth/0.png"), raw)
    read = read_rgbd_folder(tmp_path / "lid")
    assert read.recording.frame(0).depth.max() == pytest.approx(2.0) and read.notes == ()


@pytest.mark.parametrize("raw", [np.uint16(65535), np.int16(32767), np.float32(1e10), np.float16(65504), np.inf])
def test_the_largest_of_a_type_is_no_depth(raw: np.generic) -> None:
    array = np.full((H, W), raw)
    array[4:12, 6:11] = 0.5 if array.dtype.kind == "f" else 500
    depth = third_party.depth_metres(array, Path("depth.npz"))
    assert depth[5, 7] == pytest.approx(0.5) and depth[0, 0] == 0
