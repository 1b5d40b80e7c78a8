"""Recordings as cameras and their apps write them, synthesised: one scene, known in closed form, filmed by all."""

from __future__ import annotations

import json
import re
import struct
import zipfile
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_scene import BOARD, WALL, distort, film, rig, small_lens, view_scene
from hypothesis import given, settings
from hypothesis import strategies as st
from mutations import MUTATED, mutated_bytes, mutated_json, reads_or_refuses
from PIL import Image
from refusal import assert_refused

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files.sequence import read_sequence
from freeart21.formats import rgbd_video, ros_log
from freeart21.formats.convert import convert, find_sources
from freeart21.formats.rgbd_folder import read_rgbd_folder
from freeart21.formats.rgbd_video import Lens, Picture, RgbdVideo, align_video, turn_intrinsics
from freeart21.formats.third_party import DEFAULTS, ReadOptions
from freeart21.recording import Frame
from generator import commands

PHONE = Lens(np.array([[260.0, 0, 158], [0, 260, 122], [0, 0, 1]]), 320, 240)
"""A phone's colour camera; its depth has a quarter of the pixels in each direction."""
N = 4


def read_one(source: Path, **options) -> rgbd_video.ThirdPartyRecording:
    ((layout, folder),) = find_sources(source)
    return layout.read(folder, ReadOptions(**options))


def truth_of(camera: Camera, turns: int = 0) -> tuple[np.ndarray, ...]:
    """Depth and board of the scene as the finished, turned camera sees them, and the depths of both planes."""
    K = turn_intrinsics(camera.K, camera.width, camera.height, -turns % 4)
    size = (camera.height, camera.width) if turns % 2 else (camera.width, camera.height)
    board, near, far = view_scene(Camera(K, *size).rays())
    turned = (np.where(board, near, far), board, near, far)
    return tuple(rgbd_video.turn_pixels(one, turns) for one in turned)


def assert_seen(frame: Frame, camera: Camera, turns: int = 0, tolerance: float = 0.005, colour_px: float = 1.5) -> None:
    """The frame shows the scene: colours within `colour_px` of the board's edge, depth of one side or the other."""
    depth, board, near, far = truth_of(camera, turns)
    red = frame.rgb[..., 0] > frame.rgb[..., 2]
    same = board == cv2.erode(board.astype(np.uint8), None)
    edge = cv2.distanceTransform(255 * same.astype(np.uint8), cv2.DIST_L2, 5)
    wrong = (red != board) & (frame.rgb.max(2) > 20)
    assert edge[wrong].max(initial=0) <= colour_px and wrong.mean() < 0.02
    some = frame.depth > 0
    assert some.mean() > 0.9 and np.abs(frame.depth - depth)[some & (edge > 6)].max() < tolerance
    mixed = np.minimum(np.abs(frame.depth - near), np.abs(frame.depth - far))
    assert mixed[some].max() < tolerance, "no depth between the board and the wall"


# ---- all that readers share


def test_depth_of_a_fewer_pixels_follows_the_colours_edges():
    lens = Lens(PHONE.K, PHONE.width, PHONE.height)
    rgb, depth, _ = film(lens)
    low = film(small_lens(lens, 4))[1].astype(np.float32)
    high = rgbd_video.enlarge_depth(low, small_lens(lens, 4), rgb, Camera(lens.K, lens.width, lens.height))
    wrong = np.abs(high - depth) > 0.05
    assert (high > 0).all() and wrong.mean() < 0.001, "the nearest neighbour is wrong in 0.46 %"
    assert np.abs(high - depth)[~wrong].max() < 0.004
    assert not ((high > 0.72) & (high < 0.9)).any()
    low[10:20, 30:40] = 0
    holed = rgbd_video.enlarge_depth(low, small_lens(lens, 4), rgb, Camera(lens.K, lens.width, lens.height))
    assert (holed[44:76, 124:156] == 0).all() and (holed > 0).mean() > 0.97


DISTORTED = np.array([0.6, -0.4, 0.01, -0.005, 0.2, 0.1, -0.05, 0.05])


def test_depth_of_another_camera_is_seen_by_the_colours():
    colour = Lens(np.array([[300.0, 0, 161], [0, 302, 118], [0, 0, 1]]), 320, 240, DISTORTED)
    depth = Lens(np.array([[250.0, 0, 158], [0, 250, 146], [0, 0, 1]]), 320, 288, -0.5 * DISTORTED)
    T_colour_depth = rig()
    rgb = film(colour)[0]
    metres = film(depth, T_colour_depth)[1].astype(np.float32)
    video = RgbdVideo("rig", np.arange(1.0), lambda i: Picture(rgb, metres), colour, depth, T_colour_depth)
    read = align_video(video, DEFAULTS)
    frame, camera = read.recording.frame(0), read.recording.camera
    assert_seen(frame, camera)
    unmoved = RgbdVideo("rig", np.arange(1.0), lambda i: Picture(rgb, metres), colour, depth, np.eye(4))
    with pytest.raises(AssertionError):
        assert_seen(align_video(unmoved, DEFAULTS).recording.frame(0), camera)
    straight = RgbdVideo("rig", np.arange(1.0), lambda i: Picture(rgb, metres), Lens(colour.K, 320, 240), depth, rig())
    with pytest.raises(AssertionError):
        assert_seen(align_video(straight, DEFAULTS).recording.frame(0), camera)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_pictures_are_turned_with_their_intrinsics_and_masks(turns):
    rgb, depth, board = film(PHONE)
    made = {"times_s": np.arange(1.0), "load": lambda i: Picture(rgb, depth.astype(np.float32)), "colour": PHONE}
    read = align_video(RgbdVideo("phone", turns=turns, mask=lambda i: board, **made), DEFAULTS)
    frame, camera = read.recording.frame(0), read.recording.camera
    assert (camera.width, camera.height) == ((240, 320) if turns % 2 else (320, 240))
    assert_seen(frame, camera, turns, colour_px=0)
    finished = (
        board if turns == 2 else truth_of(camera, turns)[1]
    )  # a mask of either size is one of the finished picture
    assert np.array_equal(frame.mask, finished)
    small = align_video(RgbdVideo("phone", turns=turns, mask=lambda i: board, **made), ReadOptions(longest_side=160))
    assert max(small.recording.camera.width, small.recording.camera.height) == 160
    assert_seen(small.recording.frame(0), small.recording.camera, turns)
    assert "320 x 240 are made 160 x 120" in small.notes[0]


def test_colours_and_depth_are_paired_by_time():
    colour = np.array([0.0, 0.033, 0.066, 0.1, 0.133])
    depth = np.array([0.001, 0.034, 0.0655, 0.08, 0.2])
    assert [list(map(int, one)) for one in rgbd_video.pair_times(colour, depth)] == [[0, 1, 2], [0, 1, 2]]
    crowded = rgbd_video.pair_times(np.array([0.0, 0.01, 0.03]), np.array([0.009, 0.031]))
    assert [list(map(int, one)) for one in crowded] == [[1, 2], [0, 1]]
    assert [len(one) for one in rgbd_video.pair_times(colour, np.array([0.034]))] == [1, 1]


IMPOSSIBLE = {
    "identity": np.eye(3),
    "normalised": np.array([[0.8, 0, 0.5], [0, 1.07, 0.5], [0, 0, 1]]),
    "four times too large": np.diag([4, 4, 1]) @ PHONE.K,
    "half": np.diag([0.5, 0.5, 1]) @ PHONE.K,
    "unturned": turn_intrinsics(PHONE.K, 320, 240, 1),
    "outside": np.array([[260.0, 0, 400], [0, 260, 122], [0, 0, 1]]),
    "a pinhole": np.array([[5.0, 0, 160], [0, 5, 120], [0, 0, 1]]),
    "not finite": np.diag([np.nan, 1, 1]) @ PHONE.K,
}


@pytest.mark.parametrize("kind", IMPOSSIBLE)
def test_impossible_intrinsics_are_refused(kind):
    words = "lid: K has fx .* for 320 x 240 pixels, expected that of these pictures"
    assert_refused(words, rgbd_video.check_intrinsics, IMPOSSIBLE[kind], 320, 240, "lid")
    rgbd_video.check_intrinsics(PHONE.K, 320, 240, "lid")


def write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)


def in_millimetres(depth: np.ndarray) -> np.ndarray:
    return np.rint(1000 * depth).astype(np.uint16)


# ---- plain folders


@pytest.mark.parametrize("upright_K", [False, True])
@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 1), (8, 3)])
def test_exif_turns_colours_depth_masks_and_intrinsics_together(tmp_path, orientation, turns, upright_K):
    rgb, _, board = film(PHONE)
    low = in_millimetres(film(small_lens(PHONE, 4))[1])
    K = turn_intrinsics(PHONE.K, 320, 240, turns) if upright_K and turns != 2 else PHONE.K
    np.savetxt(tmp_path / "cam_K.txt", K - rgbd_video.HALF_PIXEL)
    exif = Image.Exif()
    exif[0x0112] = orientation
    for i in range(N):
        write_png(tmp_path / f"depth/{i}.png", low)
        write_png(
            tmp_path / f"masks/{i}.png", 255 * rgbd_video.turn_pixels(board, turns if i % 2 and turns != 2 else 0)
        )
        (tmp_path / "rgb").mkdir(exist_ok=True)
        Image.fromarray(rgb).save(tmp_path / f"rgb/{i}.jpg", quality=95, exif=exif)
    read = read_rgbd_folder(tmp_path)
    for frame in read.recording.frames():
        assert_seen(frame, read.recording.camera, turns, colour_px=3)
        assert np.array_equal(frame.mask, board if turns == 2 else rgbd_video.turn_pixels(board, turns))
    assert any("80 x 60 pixels is taken to have the view of the colours" in line for line in read.notes)


def test_a_mirrored_picture_is_refused(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 5
    Image.fromarray(film(PHONE)[0]).save(tmp_path / "a.jpg", exif=exif)
    assert_refused(r"a\.jpg is mirrored by its EXIF \(orientation 5\)", rgbd_video.read_unturned, tmp_path / "a.jpg")


# ---- Stray Scanner

av = pytest.importorskip("av")
UPRIGHT = {0: (0.0, 1.0, 0.0, 0.0), 1: (0.0, 0.5**0.5, -(0.5**0.5), 0.0)}


def write_video(path: Path, pictures: list[np.ndarray], rate: int = 30) -> None:
    with av.open(str(path), "w", format="mp4") as file:
        stream = file.add_stream("mpeg4", rate=rate)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = "yuv420p", 8_000_000
        for picture in pictures:
            for packet in stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")):
                file.mux(packet)
        for packet in stream.encode():
            file.mux(packet)


def write_stray(folder: Path, wxyz: tuple[float, ...], focus: bool = True) -> None:
    rgb, _, _ = film(PHONE)
    low = in_millimetres(film(small_lens(PHONE, 4))[1])
    confidence = np.full(low.shape, 2, np.uint8)
    confidence[:3] = 0
    folder.mkdir(parents=True, exist_ok=True)
    write_video(folder / "rgb.mp4", [rgb - np.uint8(4 * i) for i in range(N)])
    K = PHONE.K - rgbd_video.HALF_PIXEL
    np.savetxt(folder / "camera_matrix.csv", K if not focus else np.diag([1.5, 1.5, 1]) @ K, delimiter=", ")
    head = "timestamp, frame, x, y, z, qx, qy, qz, qw" + ", fx, fy, cx, cy, distortion_center_x" * focus
    lines = [head]
    for i in range(N):
        write_png(folder / f"depth/{i:06d}.png", low)
        write_png(folder / f"confidence/{i:06d}.png", confidence)
        tail = f", {K[0, 0]}, {K[1, 1]}, {K[0, 2]}, {K[1, 2]}, " * focus
        w, x, y, z = wxyz
        lines.append(f"{100 + i / 15 + (i > 1)}, {i:06d}, 0, 0, 0, {x}, {y}, {z}, {w}" + tail)
    (folder / "odometry.csv").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("focus", [True, False])
@pytest.mark.parametrize("turns", UPRIGHT)
def test_stray_scanner(tmp_path, turns, focus):
    write_stray(tmp_path / "mug", UPRIGHT[turns], focus)
    read = read_one(tmp_path / "mug")
    recording = read.recording
    assert (recording.camera.width, recording.camera.height) == ((240, 320) if turns else (320, 240))
    assert recording.times_s == pytest.approx([0, 1 / 15, 1 + 2 / 15, 1.2]), "gaps stay"
    np.testing.assert_allclose(recording.gravity[:, :2], np.tile([0, 1], (N, 1)), atol=1e-6)
    for i in (0, 2, 1, 3):
        frame = recording.frame(i)
        assert np.percentile(frame.rgb[..., 0], 99) == pytest.approx(200 - 4 * i, abs=2), "frames keep their order"
        upright = rgbd_video.turn_pixels(frame.depth, -turns)
        assert (upright[:8] == 0).all() and (upright[14:] > 0).all(), "low confidence is no depth"
        whole = Frame(
            frame.rgb, np.where(frame.depth > 0, frame.depth, truth_of(recording.camera, turns)[0]), frame.mask
        )
        assert_seen(whole, recording.camera, turns, colour_px=4)


def test_the_way_from_a_camera_to_a_sequence(tmp_path, capsys):
    write_stray(tmp_path / "mug", UPRIGHT[1])
    assert_refused("mug has no masks: `--to rgbd` writes", list, convert(tmp_path / "mug", tmp_path / "out", "native"))
    commands.convert(tmp_path / "mug", tmp_path / "out", "rgbd", longest_side=160)
    pictures = tmp_path / "out/pictures/mug"
    names = sorted(path.name for path in (pictures / "rgb").iterdir())
    assert names[:2] == ["000000.000000.png", "000000.066667.png"] and not (pictures / "masks").exists()
    for name in names:
        red, _, blue = cv2.split(cv2.imread(str(pictures / "rgb" / name))[..., ::-1])
        write_png(pictures / "masks" / name, 255 * (red > blue).astype(np.uint8))
    commands.convert(tmp_path / "mug", tmp_path / "out", "native", masks=pictures / "masks", longest_side=160)
    commands.convert(pictures, tmp_path / "again", "native")
    straight, detour = read_sequence(tmp_path / "out/sequences/mug"), read_sequence(tmp_path / "again/sequences/mug")
    assert straight.times_s == pytest.approx(detour.times_s, abs=1e-5)
    assert np.allclose(straight.camera.K, detour.camera.K, rtol=0, atol=1e-4)
    for one, other in zip(straight.frames(), detour.frames(), strict=True):
        assert np.array_equal(one.rgb, other.rgb) and np.array_equal(one.mask, other.mask) and one.mask.any()
        assert np.abs(one.depth - other.depth).max() < 0.0006
    (pictures / "masks" / names[0]).unlink()
    wrong = convert(tmp_path / "mug", tmp_path / "third", "native", options=ReadOptions(masks=pictures / "masks"))
    assert_refused("has 3 masks, expected 4: one for each", list, wrong)


# ---- Record3D

PORTRAIT = Lens(turn_intrinsics(PHONE.K, 320, 240, 1), 240, 320)
FOCUS = [PORTRAIT.K[0, 0], PORTRAIT.K[1, 1], PORTRAIT.K[0, 2] - 0.5, PORTRAIT.K[1, 2] - 0.5]


def record3d_files(packed: bool = True) -> dict[str, bytes]:
    """The files of an .r3d recording: an upright phone, whose metadata names one frame more than there is."""
    lzfse = pytest.importorskip("liblzfse")
    rgb = film(PORTRAIT)[0]
    low = film(small_lens(PORTRAIT, 4))[1].astype("<f4")
    low[40:, :5] = np.nan
    certain = np.full(low.shape, 2, np.uint8)
    certain[:3] = 0
    about = {
        **{"w": 240, "h": 320, "dw": 60, "dh": 80, "fps": 60, "cameraType": 1, "poses": []},
        "K": [FOCUS[0], 0, 0, 0, FOCUS[1], 0, FOCUS[2], FOCUS[3], 1],
        "perFrameIntrinsicCoeffs": [[2 * FOCUS[0], 2 * FOCUS[1], *FOCUS[2:]]] + [FOCUS] * (N + 1),
        "frameTimestamps": [0, 0.1, 0.2, 0.5, 0.6, 0.7],
    }
    files = {"metadata": json.dumps(about).encode(), "icon": b"no picture"}
    for i in range(1, N + 1):
        picture = cv2.imencode(".jpg", (rgb - np.uint8(4 * i))[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        files[f"rgbd/{i}.jpg"] = picture.tobytes()
        files[f"rgbd/{i}.depth"] = lzfse.compress(low.tobytes()) if packed else low.tobytes()
        files[f"rgbd/{i}.conf"] = lzfse.compress(certain.tobytes()) if packed else certain.tobytes()
    return files


def write_r3d(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def write_unpacked(folder: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


def write_exr(folder: Path, files: dict[str, bytes]) -> Path:
    """Record3D's export of pictures."""
    exr = pytest.importorskip("OpenEXR")
    low = film(small_lens(PORTRAIT, 4))[1].astype(np.float16)
    write_unpacked(
        folder, {name.replace("rgbd/", "rgb/"): data for name, data in files.items() if name.endswith("jpg")}
    )
    (folder / "metadata.json").write_bytes(files["metadata"])
    (folder / "depth").mkdir()
    for i in range(1, N + 1):
        header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
        with exr.File(header, {"R": low}) as file:
            file.write(str(folder / f"depth/{i}.exr"))
    return folder


@pytest.mark.parametrize("form", ["file", "unpacked", "raw", "exr"])
def test_record3d(tmp_path, form):
    files = record3d_files(packed=form != "raw")
    make = {"file": lambda: write_r3d(tmp_path / "a mug.r3d", files), "exr": lambda: write_exr(tmp_path / "e", files)}
    source = make.get(form, lambda: write_unpacked(tmp_path / "a mug", files))()
    read = read_one(source)
    recording = read.recording
    assert recording.name == ("e" if form == "exr" else "a-mug")
    assert recording.times_s == pytest.approx([0, 0.1, 0.4, 0.5]), "of frames 1 to 4, not 0 to 3"
    for i, frame in enumerate(recording.frames()):
        assert np.percentile(frame.rgb[..., 0], 99) == pytest.approx(196 - 4 * i, abs=2)
        if form != "exr":
            assert (frame.depth[:8] == 0).all() and (frame.depth[170:, :14] == 0).all()
        whole = np.where(frame.depth > 0, frame.depth, truth_of(recording.camera)[0])
        assert_seen(Frame(frame.rgb, whole, frame.mask), recording.camera, colour_px=3)


def test_record3d_of_early_versions(tmp_path):
    files = record3d_files()
    about = json.loads(files["metadata"])
    for key in ("dw", "dh", "perFrameIntrinsicCoeffs", "frameTimestamps"):
        del about[key]
    files["metadata"] = json.dumps(about).encode()
    recording = read_one(write_r3d(tmp_path / "mug.r3d", files)).recording
    assert recording.times_s == pytest.approx(np.arange(N) / 60)
    assert np.allclose(recording.camera.K, PORTRAIT.K) and recording.frame(0).depth.max() > 1


REAL = Path(__file__).resolve().parents[2] / "shared/rgbd"


@pytest.mark.skipif(not (REAL / "record3d").is_dir(), reason="the real recording is not here")
def test_a_real_export_of_record3d():
    pytest.importorskip("OpenEXR")
    recording = read_one(REAL / "record3d").recording
    frame = recording.frame(11)
    assert (recording.camera.width, recording.camera.height, len(recording)) == (960, 1280, 12)
    assert frame.rgb.std() > 10 and (frame.depth > 0).mean() > 0.95 and 0.2 < np.median(frame.depth) < 3
    assert recording.times_s[-1] == pytest.approx(11 / 60, abs=0.01)


# ---- TUM RGB-D and Articulat3D


def write_plain(
    folder: Path, lens: Lens, per_metre: float, colours: str, names: tuple[str, ...], late: float = 0.0
) -> None:
    rgb, depth, _ = film(lens)
    for name in names:
        write_png(folder / colours / f"{name}.png", rgb)
        shown = name if not late else f"{float(name) + late:.6f}"
        write_png(folder / f"depth/{shown}.png", np.rint(per_metre * depth).astype(np.uint16))


STAMPS = ("1305031102.175304", "1305031102.211214", "1305031102.443271")


def test_tum_has_its_own_unit_cameras_and_distortion(tmp_path):
    folder = tmp_path / "rgbd_dataset_freiburg1_mug"
    lens = Lens(
        np.array([[517.3, 0, 319.1], [0, 516.5, 255.8], [0, 0, 1]]),
        640,
        480,
        np.array([0.2624, -0.9531, -0.0054, 0.0026, 1.1633, 0, 0, 0]),
    )
    write_plain(folder, lens, 5000, "rgb", STAMPS, late=0.008)
    for name in ("rgb.txt", "depth.txt"):
        (folder / name).write_text("# color images\n")
    recording = read_one(folder).recording
    assert recording.times_s == pytest.approx([0, 0.03591, 0.267967], abs=1e-6)
    assert_seen(recording.frame(2), recording.camera)
    other = folder.rename(tmp_path / "mug")
    assert_refused("mug has no cam_K.txt, and is no freiburg1, 2 or 3", read_one, other)
    (other / "cam_K.txt").write_text("517.3 0 318.6\n0 516.5 255.3\n0 0 1\n")
    assert 0.5 < np.median(read_one(other).recording.frame(0).depth) < 1.3


def test_articulat3d_has_its_own_unit(tmp_path):
    write_plain(tmp_path / "lid", PHONE, 6553.5, "images", ("00000", "00001"))
    (tmp_path / "lid/intrinsics.json").write_text(json.dumps((PHONE.K - rgbd_video.HALF_PIXEL).tolist()))
    recording = read_one(tmp_path / "lid").recording
    assert_seen(recording.frame(1), recording.camera, colour_px=0)
    (tmp_path / "lid/intrinsics.json").write_text("[[1, 0, 0], [0, 1, 0], [0, 0, 1]]")
    assert_refused("expected that of these pictures", read_one, tmp_path / "lid")


# ---- Azure Kinect

KINECT = {  # numbers of a real device, from a test of pyk4a
    "CALIBRATION_CameraPurposeDepth": (
        [
            *(0.51296979, 0.51692355, 0.49278089, 0.49290285, 0.54793978, -0.02097137, -0.00265222, 0.88967907),
            *(0.08613021, -0.01391038, 0, 0, -7.21041579e-05, 2.05575343e-05),
        ],
        [1, 0, 0, 0, 1, 0, 0, 0, 1],
        [0, 0, 0],
        (1024, 1024),
    ),
    "CALIBRATION_CameraPurposePhotoVideo": (
        [
            *(0.49984714, 0.50661761, 0.47796512, 0.63742393, 0.33012131, -2.4893966, 1.45367086, 0.20891207),
            *(-2.3029151, 1.37512755, 0, 0, -0.00012944524, -0.00016178244),
        ],
        [0.99999923, 0.00118176, -0.00044814, -0.00113875, 0.99628061, 0.08616032, 0.00054829, -0.08615975, 0.99628121],
        [-0.03208343, -0.00220537, 0.00388369],
        (4096, 3072),
    ),
}
COLOUR_MODE, DEPTH_MODE = (1280, 720), (320, 288)


def kinect_calibration() -> dict:
    return {
        "CalibrationInformation": {
            "Cameras": [
                {
                    "Purpose": purpose,
                    "Intrinsics": {
                        "ModelParameterCount": 14,
                        "ModelParameters": numbers,
                        "ModelType": "CALIBRATION_LensDistortionModelBrownConrady",
                    },
                    "Rt": {"Rotation": rotation, "Translation": translation},
                    "SensorWidth": size[0],
                    "SensorHeight": size[1],
                }
                for purpose, (numbers, rotation, translation, size) in KINECT.items()
            ]
        }
    }


def kinect_lens(purpose: str, whole: tuple[int, int], corner: tuple[int, int], size: tuple[int, int]) -> Lens:
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = KINECT[purpose][0]
    K = [[fx * whole[0], 0, cx * whole[0] - corner[0]], [0, fy * whole[1], cy * whole[1] - corner[1]], [0, 0, 1]]
    return Lens(np.array(K), *size, np.array([k1, k2, p1, p2, k3, k4, k5, k6]))


def write_mkv(path: Path, colours: list, depths: list, times_ms: list, calibration: dict | None) -> Path:
    """A Kinect's recording: the colours' and the depth's time stamps are `times_ms`, pairs."""
    with av.open(str(path), "w", format="matroska", options={"allow_raw_vfw": "1"}) as file:
        colour = file.add_stream("mjpeg", rate=30)
        (colour.height, colour.width), colour.pix_fmt = colours[0].shape[:2], "yuvj420p"
        depth = file.add_stream("rawvideo", rate=30)
        (depth.height, depth.width), depth.pix_fmt = depths[0].shape, "gray16be"
        infrared = file.add_stream("rawvideo", rate=30)
        (infrared.height, infrared.width), infrared.pix_fmt = depths[0].shape, "gray16be"
        for stream, title in ((colour, "COLOR"), (depth, "DEPTH"), (infrared, "IR")):
            stream.metadata["title"], stream.codec_context.time_base = title, Fraction(1, 1000)
        if calibration is not None:
            file.add_attachment(
                "calibration.json", "application/octet-stream", json.dumps(calibration).encode() + b"\0"
            )
        for rgb, metres, at in zip(colours, depths, times_ms, strict=True):
            bright = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
            grey = av.VideoFrame.from_ndarray(in_millimetres(metres), format="gray16le").reformat(format="gray16be")
            for stream, frame, t in ((colour, bright, at[0]), (depth, grey, at[1]), (infrared, grey, at[1])):
                frame.pts, frame.time_base = t, Fraction(1, 1000)
                for packet in stream.encode(frame):
                    file.mux(packet)
        for stream in (colour, depth, infrared):
            for packet in stream.encode():
                file.mux(packet)
    # FFmpeg's writer leaves the kind of the pixels out; the device's has it (BITMAPINFOHEADER.biCompression)
    height, width = depths[0].shape
    head = struct.pack("<Iii", 40, width, -height)
    data = path.read_bytes()
    assert data.count(head) == 2
    path.write_bytes(re.sub(re.escape(head) + b"(....)....", lambda m: head + m[1] + b"b16g", data, flags=re.DOTALL))
    return path


def kinect_views() -> tuple[np.ndarray, np.ndarray]:
    """Colours, and depth of the other camera."""
    colour = kinect_lens("CALIBRATION_CameraPurposePhotoVideo", (1280, 960), (0, 120), COLOUR_MODE)
    depth = kinect_lens("CALIBRATION_CameraPurposeDepth", (512, 512), (96, 90), DEPTH_MODE)
    _, rotation, translation, _ = KINECT["CALIBRATION_CameraPurposePhotoVideo"]
    T_colour_depth = se3.pose(np.reshape(rotation, (3, 3)), translation)
    return film(colour)[0], film(depth, T_colour_depth)[1]


def test_azure_kinect(tmp_path):
    rgb, metres = kinect_views()
    times = [(0, 1), (33, 34), (67, 200), (400, 401)]
    source = write_mkv(
        tmp_path / "my lid.mkv", [rgb - np.uint8(10 * i) for i in range(4)], [metres] * 4, times, kinect_calibration()
    )
    read = read_one(source)
    recording = read.recording
    assert recording.name == "my-lid" and recording.times_s == pytest.approx([0, 0.033, 0.4])
    assert "1 of 4 colours have no depth within 20 ms" in read.notes[0]
    for i, k in ((0, 0), (2, 3)):
        frame = recording.frame(i)
        assert np.percentile(frame.rgb[..., 0], 99) == pytest.approx(200 - 10 * k, abs=3)
        depth = truth_of(recording.camera)[0]
        seen = frame.depth > 0
        assert seen.mean() > 0.6, "the depth camera sees less than the colours at the sides"
        whole = np.where(seen, frame.depth, depth)
        assert_seen(Frame(frame.rgb, whole, frame.mask), recording.camera, tolerance=0.002, colour_px=5)
        wrong = np.abs(frame.depth - depth)[seen] > 0.05
        assert wrong.mean() < 0.01, "of the board's edge"


# ---- RealSense and ROS

RS_COLOUR = Lens(np.array([[300.0, 0, 161], [0, 302, 118], [0, 0, 1]]), 320, 240)
RS_DEPTH = Lens(np.array([[250.0, 0, 158], [0, 250, 122], [0, 0, 1]]), 320, 240)
INVERSE = np.array([-0.056, 0.066, 0.0006, -0.0004, -0.021])
"""Distortion as a D435i has it, of the model that undistorts pixels."""
TIMES = ((0, 3), (33, 36), (67, 71), (400, 402))


def ros_store(version: int):
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    if "tf2_msgs/msg/TFMessage" not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    return store


def ros_messages(
    store, version: int, driver: bool, encoding: str, inverse: bool = False
) -> list[tuple[str, str, int, object]]:
    """Topic, type, ms and message of a recording: RealSense's own, or that of its driver."""
    types = store.types
    base = (
        ("/camera/color", "/camera/depth") if driver else ("/device_0/sensor_1/Color_0", "/device_0/sensor_0/Depth_0")
    )
    image, info = ("image_raw", "camera_info") if driver else ("image/data", "info/camera_info")
    T_colour_depth = rig()
    T_ref = se3.exp_se3(np.array([0.1, 0.2, -0.1, 0.3, 0.1, 0.2]))  # of the reference in the colours, as in depth

    def header(ms: int, frame: str):
        stamp = types["builtin_interfaces/msg/Time"](sec=1000, nanosec=ms * 10**6)
        own = {"seq": 0} if version == 1 else {}
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **own)

    def transform(T: np.ndarray):
        w, x, y, z = se3.wxyz(T)
        return types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](*T[:3, 3]),
            rotation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        )

    def camera_info(lens: Lens, frame: str, D: np.ndarray, model: str):
        roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        K = (lens.K - rgbd_video.HALF_PIXEL).ravel()
        names = ("D", "K", "R", "P") if version == 1 else ("d", "k", "r", "p")
        arrays = dict(zip(names, (D, K, np.eye(3).ravel(), np.zeros(12)), strict=True))
        fixed = {"binning_x": 0, "binning_y": 0, "roi": roi, "height": lens.height, "width": lens.width}
        return types["sensor_msgs/msg/CameraInfo"](header=header(0, frame), distortion_model=model, **arrays, **fixed)

    def picture(pixels: np.ndarray, encoding: str, ms: int, frame: str):
        data = np.ascontiguousarray(pixels)
        step = data.nbytes // data.shape[0]
        return types["sensor_msgs/msg/Image"](
            header(ms, frame), data.shape[0], data.shape[1], encoding, 0, step, np.frombuffer(data.tobytes(), np.uint8)
        )

    rgb, D = film(RS_COLOUR)[0], np.zeros(5)
    if inverse:
        D = INVERSE
        u, v = np.meshgrid(np.arange(320) + 0.5, np.arange(240) + 0.5)
        aim = (np.stack([u, v], -1) - RS_COLOUR.K[:2, 2]) / [300, 302]
        flat = distort(aim, np.append(D, [0, 0, 0]))
        rgb = np.where(view_scene(np.dstack([flat, np.ones_like(u)]))[0][..., None], BOARD, WALL).astype(np.uint8)
    metres = film(RS_DEPTH, T_colour_depth)[1]
    unit = 1e-3 if driver else 1e-4
    model = "plumb_bob" if driver else "Inverse Brown Conrady"
    found = [
        (f"{base[0]}/{info}", "sensor_msgs/msg/CameraInfo", 0, camera_info(RS_COLOUR, "colours", D, model)),
        (f"{base[1]}/{info}", "sensor_msgs/msg/CameraInfo", 0, camera_info(RS_DEPTH, "depth", np.zeros(5), model)),
    ]
    if driver:
        tree = []
        for parent, child, T in (
            ("base", "colours", se3.inverse(T_ref)),
            ("base", "depth", se3.inverse(T_ref) @ T_colour_depth),
        ):
            tree.append(types["geometry_msgs/msg/TransformStamped"](header(0, parent), child, transform(T)))
        found.append(("/tf_static", "tf2_msgs/msg/TFMessage", 0, types["tf2_msgs/msg/TFMessage"](tree)))
    else:
        kind = "geometry_msgs/msg/Transform"
        found.append((f"{base[0]}/tf/0", kind, 0, transform(T_ref)))
        found.append((f"{base[1]}/tf/0", kind, 0, transform(se3.inverse(T_colour_depth) @ T_ref)))
        value = types["std_msgs/msg/Float32"](data=unit)
        found.append(("/device_0/sensor_0/option/Depth_Units/value", "std_msgs/msg/Float32", 0, value))
    raw = np.rint(metres / unit).astype(np.uint16)
    raw[:4] = 65535
    for i, (bright, deep) in enumerate(TIMES):
        shown = rgb - np.uint8(10 * i)
        message = picture(shown[..., ::-1] if encoding == "bgr8" else shown, encoding, bright, "colours")
        if encoding == "jpeg":
            data = cv2.imencode(".jpg", shown[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1].ravel()
            message = types["sensor_msgs/msg/CompressedImage"](
                header(bright, "colours"), "rgb8; jpeg compressed bgr8", data
            )
        name = f"{base[0]}/{image}" + "/compressed" * (encoding == "jpeg")
        found.append((name, message.__msgtype__, bright, message))
        deep_message = picture(raw, "mono16" if not driver else "16UC1", deep, "depth")
        if encoding == "jpeg":
            data = np.concatenate([np.zeros(12, np.uint8), cv2.imencode(".png", raw)[1].ravel()])
            kind = "16UC1; compressedDepth png"
            deep_message = types["sensor_msgs/msg/CompressedImage"](header(deep, "depth"), kind, data)
        name = f"{base[1]}/{image}" + "/compressedDepth" * (encoding == "jpeg")
        found.append((name, deep_message.__msgtype__, deep, deep_message))
        found.append(("/camera/infra1/image", "sensor_msgs/msg/Image", deep, picture(shown, "rgb8", deep, "infra")))
    return found


def write_bag(path: Path, store, messages, compression: str = "none") -> Path:
    from rosbags.rosbag1 import Writer

    writer = Writer(path)
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression])
    with writer:
        known = {}
        for topic, kind, ms, message in messages:
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(known[topic], 10**12 + ms * 10**6, store.serialize_ros1(message, kind))
    return path


def write_mcap(path: Path, store, messages, compression: str = "ZSTD") -> Path:
    mcap = pytest.importorskip("mcap.writer")
    with path.open("wb") as file:
        writer = mcap.Writer(file, chunk_size=200_000, compression=mcap.CompressionType[compression])
        writer.start("ros2")
        known = {}
        for topic, kind, ms, message in messages:
            if topic not in known:
                schema = writer.register_schema(kind, "ros2msg", b"any text")
                known[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(known[topic], 10**12 + ms * 10**6, data, 10**12 + ms * 10**6)
        writer.finish()
    return path


LOGS = {
    "RealSense": (1, False, "rgb8", False, "none"),
    "RealSense, inverse distortion, lz4": (1, False, "bgr8", True, "LZ4"),
    "ROS 1 driver, bz2": (1, True, "bgr8", False, "BZ2"),
    "ROS 2": (2, True, "rgb8", False, "ZSTD"),
    "ROS 2, compressed pictures, lz4": (2, True, "jpeg", False, "LZ4"),
    "ROS 2, not packed": (2, True, "bgr8", False, "NONE"),
}


@pytest.mark.parametrize("kind", LOGS)
def test_ros_logs(tmp_path, kind):
    version, driver, encoding, inverse, compression = LOGS[kind]
    store = ros_store(version)
    write = write_bag if version == 1 else write_mcap
    messages = ros_messages(store, version, driver, encoding, inverse)
    source = write(tmp_path / f"a lid{'.bag' if version == 1 else '.mcap'}", store, messages, compression)
    read = read_one(source)
    recording = read.recording
    assert recording.name == "a-lid" and recording.times_s == pytest.approx([0, 0.033, 0.067, 0.4])
    for i in (0, 3, 1):
        frame = recording.frame(i)
        assert np.percentile(frame.rgb[..., 0], 99) == pytest.approx(200 - 10 * i, abs=3)
        assert (frame.depth > 0).mean() > 0.8 and frame.depth.max() < 2, "65535 is no depth"
        whole = np.where(frame.depth > 0, frame.depth, truth_of(recording.camera)[0])
        tight = 0.002 if driver else 0.0005
        assert_seen(Frame(frame.rgb, whole, frame.mask), recording.camera, tolerance=tight, colour_px=3)


def test_depth_that_is_aligned_already_is_taken(tmp_path):
    store = ros_store(2)
    aligned = np.rint(1000 * film(RS_COLOUR)[1]).astype(np.uint16)
    found = []
    for topic, kind, ms, message in ros_messages(store, 2, True, "rgb8"):
        if topic == "/camera/depth/image_raw":
            frame = {"frame_id": "colours", "stamp": message.header.stamp}
            header = store.types["std_msgs/msg/Header"](**frame)
            data = np.frombuffer(aligned.tobytes(), np.uint8)
            message = store.types["sensor_msgs/msg/Image"](header, 240, 320, "16UC1", 0, 640, data)
            topic = "/camera/aligned_depth_to_color/image_raw"
        if topic != "/tf_static":
            found.append((topic, kind, ms, message))
    recording = read_one(write_mcap(tmp_path / "a.mcap", store, found)).recording
    assert_seen(recording.frame(2), recording.camera, tolerance=0.001, colour_px=0)


def without(*names: str):
    return lambda messages: [one for one in messages if not any(name in one[0] for name in names)]


@pytest.mark.parametrize("version", [1, 2])
def test_a_broken_log_is_one_line(tmp_path, monkeypatch, version):
    store = ros_store(version)
    messages = ros_messages(store, version, version == 2, "rgb8")
    name = "a.bag" if version == 1 else "a.mcap"
    source = (write_bag if version == 1 else write_mcap)(tmp_path / name, store, messages, "LZ4")
    data = source.read_bytes()
    for broken in (data[: len(data) // 2], data[:20], b"\0" * 300, b"#ROSBAG V2.0\n" + bytes(90)):
        source.write_bytes(broken)
        with pytest.raises(FreeArtError) as caught:
            list(read_one(source).recording.frames())
        assert "\n" not in str(caught.value) and name in str(caught.value)
    source.write_bytes(data)
    monkeypatch.setattr(ros_log, "MAX_CHUNK_BYTES", 100_000)
    assert_refused("is not a readable log: .*(unpacks to more than 100000|100000)", read_one, source)


# ---- nearly valid files


def test_every_layout_names_what_it_lacks(tmp_path):
    write_stray(tmp_path / "stray", UPRIGHT[0], focus=False)
    (tmp_path / "stray/odometry.csv").write_text("a, b\n1, 2\n")
    assert_refused("has no column timestamp", read_one, tmp_path / "stray")
    rgb, metres = np.zeros((*COLOUR_MODE[::-1], 3), np.uint8), np.ones(DEPTH_MODE[::-1])
    source = write_mkv(tmp_path / "a.mkv", [rgb], [metres], [(0, 0)], None)
    assert_refused("has no attachment calibration.json", read_one, source)
    store = ros_store(1)
    found = [one for one in ros_messages(store, 1, False, "rgb8") if "camera_info" not in one[0]]
    assert_refused("has no CameraInfo", read_one, write_bag(tmp_path / "a.bag", store, found))


@settings(MUTATED, max_examples=40)
@given(data=st.data())
def test_an_r3d_file_with_a_wrong_field_or_bytes_is_read_or_one_line(tmp_path, data):
    files = record3d_files()
    name = data.draw(st.sampled_from(("metadata", "rgbd/1.depth", "rgbd/2.conf", "rgbd/1.jpg")))
    if name == "metadata":
        files[name] = json.dumps(data.draw(mutated_json(json.loads(files[name])))).encode()
    else:
        files[name] = data.draw(mutated_bytes(files[name]))
    source = write_r3d(tmp_path / "mug.r3d", files)
    reads_or_refuses(lambda: list(read_one(source).recording.frames()))


@settings(MUTATED, max_examples=25)
@given(data=st.data())
def test_a_kinects_calibration_with_a_wrong_field_is_read_or_one_line(tmp_path, data):
    rgb, metres = np.zeros((*COLOUR_MODE[::-1], 3), np.uint8), np.ones(DEPTH_MODE[::-1])
    calibration = data.draw(mutated_json(kinect_calibration()))
    source = write_mkv(tmp_path / "a.mkv", [rgb], [metres], [(0, 0)], calibration)
    reads_or_refuses(read_one, source)
