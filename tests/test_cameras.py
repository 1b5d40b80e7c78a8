"""Recordings as cameras and their apps write them, synthesised: one scene, known in closed form, filmed by all."""

from __future__ import annotations

import json
import sys
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_scene import film, rig, small_lens, view_scene
from PIL import Image
from refusal import assert_refused

from freeart21 import cli
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files.sequence import read_sequence
from freeart21.formats import rgbd_video
from freeart21.formats.convert import convert, find_sources
from freeart21.formats.rgbd_folder import read_rgbd_folder
from freeart21.formats.rgbd_video import Lens, Picture, RgbdVideo, align_video, turn_intrinsics
from freeart21.formats.third_party import DEFAULTS, ReadOptions
from freeart21.recording import Frame

PHONE = Lens(np.array([[260.0, 0, 158], [0, 260, 122], [0, 0, 1]]), 320, 240)
"""A phone's colour camera; its depth has a quarter of the pixels in each direction."""
N = 4


def read_one(source: Path, **options) -> rgbd_video.ThirdPartyRecording:
    ((layout, folder),) = find_sources(source)
    return layout.read(folder, ReadOptions(**options))


def truth_of(camera: Camera, turns: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Depth and board of the scene as the finished, turned camera sees them."""
    back = np.rot90(np.arange(camera.width * camera.height).reshape(camera.height, camera.width), turns)
    K = turn_intrinsics(camera.K, camera.width, camera.height, -turns % 4)
    size = (camera.height, camera.width) if turns % 2 else (camera.width, camera.height)
    board, depth = view_scene(Camera(K, *size).rays())
    assert back.shape == board.shape
    return rgbd_video.turn_pixels(depth, turns), rgbd_video.turn_pixels(board, turns)


def assert_seen(frame: Frame, camera: Camera, turns: int = 0, tolerance: float = 0.004, colour_px: float = 1.5) -> None:
    """The frame shows the scene: colours within `colour_px` of the board's edge, depth of one side or the other."""
    depth, board = truth_of(camera, turns)
    red = frame.rgb[..., 0] > frame.rgb[..., 2]
    edge = cv2.distanceTransform(
        255 * (board == cv2.erode(board.astype(np.uint8), None)).astype(np.uint8), cv2.DIST_L2, 5
    )
    wrong = red != board
    assert edge[wrong].max(initial=0) <= colour_px and wrong.mean() < 0.02
    some = frame.depth > 0
    inner = (edge > 6) & some
    assert some.mean() > 0.9 and np.abs(frame.depth - depth)[inner].max() < tolerance
    assert not ((frame.depth > 0.72) & (frame.depth < 0.9)).any(), "no depth between the board and the wall"


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
    "identity": (np.eye(3), "identity or normalised"),
    "normalised": (np.array([[0.8, 0, 0.5], [0, 1.07, 0.5], [0, 0, 1]]), "identity or normalised"),
    "four times too large": (np.diag([4, 4, 1]) @ PHONE.K, "of pictures 4 times as large"),
    "half": (np.diag([0.5, 0.5, 1]) @ PHONE.K, "of pictures 0.5 times as large"),
    "unturned": (turn_intrinsics(PHONE.K, 320, 240, 1), "of the unturned picture"),
    "outside": (np.array([[260.0, 0, 400], [0, 260, 122], [0, 0, 1]]), "outside of the picture"),
    "a pinhole": (np.array([[5.0, 0, 160], [0, 5, 120], [0, 0, 1]]), "field of view"),
}


@pytest.mark.parametrize("kind", IMPOSSIBLE)
def test_impossible_intrinsics_are_refused(kind):
    K, words = IMPOSSIBLE[kind]
    assert_refused(f"lid: K has fx .*{words}", rgbd_video.check_intrinsics, K, 320, 240, "lid")
    rgbd_video.check_intrinsics(PHONE.K, 320, 240, "lid")


def write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)


def in_millimetres(depth: np.ndarray) -> np.ndarray:
    return np.rint(1000 * depth).astype(np.uint16)


# ---- plain folders


@pytest.mark.parametrize("upright_K", [False, True])
@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 1), (8, 3)])
def test_exif_turns_colours_depth_masks_and_intrinsics_alike(tmp_path, orientation, turns, upright_K):
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
    assert any("80 x 60 pixels is taken to have the view of the colours" in line for line in read.observe())


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
    for i in (0, 2, 1, 3):
        frame = recording.frame(i)
        assert np.percentile(frame.rgb[..., 0], 99) == pytest.approx(200 - 4 * i, abs=2), "frames keep their order"
        upright = rgbd_video.turn_pixels(frame.depth, -turns)
        assert (upright[:8] == 0).all() and (upright[14:] > 0).all(), "low confidence is no depth"
        whole = Frame(
            frame.rgb, np.where(frame.depth > 0, frame.depth, truth_of(recording.camera, turns)[0]), frame.mask
        )
        assert_seen(whole, recording.camera, turns, colour_px=4)


def test_stray_scanner_leaves_frames_without_depth_out(tmp_path):
    write_stray(tmp_path, UPRIGHT[0])
    (tmp_path / "depth/000001.png").unlink()
    read = read_one(tmp_path)
    assert "1 of 4 frames have no depth" in read.notes[0]
    assert [np.percentile(frame.rgb[..., 0], 99) for frame in read.recording.frames()] == pytest.approx(
        [200, 192, 188], abs=2
    )


def test_the_way_from_a_camera_to_a_sequence(tmp_path, capsys):
    write_stray(tmp_path / "mug", UPRIGHT[1])
    assert_refused("mug has no masks: `--to rgbd` writes", list, convert(tmp_path / "mug", tmp_path / "out", "native"))
    cli.convert(tmp_path / "mug", tmp_path / "out", "rgbd", longest_side=160)
    pictures = tmp_path / "out/pictures/mug"
    names = sorted(path.name for path in (pictures / "rgb").iterdir())
    assert names[:2] == ["000000.000000.png", "000000.066667.png"] and not (pictures / "masks").exists()
    for name in names:
        red, _, blue = cv2.split(cv2.imread(str(pictures / "rgb" / name))[..., ::-1])
        write_png(pictures / "masks" / name, 255 * (red > blue).astype(np.uint8))
    cli.convert(tmp_path / "mug", tmp_path / "out", "native", masks=pictures / "masks", longest_side=160)
    cli.convert(pictures, tmp_path / "again", "native")
    straight, detour = read_sequence(tmp_path / "out/sequences/mug"), read_sequence(tmp_path / "again/sequences/mug")
    assert straight.times_s == pytest.approx(detour.times_s, abs=1e-5)
    assert np.allclose(straight.camera.K, detour.camera.K, rtol=0, atol=1e-4)
    for one, other in zip(straight.frames(), detour.frames(), strict=True):
        assert np.array_equal(one.rgb, other.rgb) and np.array_equal(one.mask, other.mask) and one.mask.any()
        assert np.abs(one.depth - other.depth).max() < 0.0006
    (pictures / "masks" / names[0]).unlink()
    wrong = convert(tmp_path / "mug", tmp_path / "third", "native", masks=pictures / "masks")
    assert_refused("has 3 masks, expected 4: one for each", list, wrong)


STRAY_FAULTS = {
    "no video": (lambda f: (f / "rgb.mp4").write_bytes(b"#EXTM3U\nfile:///etc/passwd\n"), "not a readable mp4 video"),
    "no columns": (lambda f: (f / "odometry.csv").write_text("a, b\n1, 2\n"), "has no column timestamp"),
    "words": (
        lambda f: (f / "odometry.csv").write_text("timestamp,frame,qx,qy,qz,qw\n1,x,0,0,0,1\n"),
        "row 1 is no row",
    ),
    "K": (lambda f: (f / "camera_matrix.csv").write_text("1 0 0\n0 1 0\n0 0 1\n"), "identity or normalised"),
    "a long row": (
        lambda f: (f / "odometry.csv").write_text("timestamp,frame,qx,qy,qz,qw\n1,0,0,0,0,1,1,1\n"),
        "row 1 is no row of 6 numbers",
    ),
    "no depth": (lambda f: [path.unlink() for path in (f / "depth").iterdir()], "no row of odometry.csv has"),
}


@pytest.mark.parametrize("fault", STRAY_FAULTS)
def test_a_broken_folder_of_stray_scanner_is_one_line(tmp_path, fault):
    spoil, words = STRAY_FAULTS[fault]
    write_stray(tmp_path, UPRIGHT[0], focus=False)
    spoil(tmp_path)
    assert_refused(words, read_one, tmp_path)


def test_a_missing_package_names_its_extra(tmp_path, monkeypatch):
    write_stray(tmp_path, UPRIGHT[0])
    monkeypatch.setitem(sys.modules, "av", None)
    line = assert_refused(r"rgb\.mp4 needs the package av: pip install 'freeart21\[cameras\]'", read_one, tmp_path)
    assert isinstance(line, str) and json.dumps(line) and issubclass(FreeArtError, Exception)


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


def of_r3d(change):
    """Spoils the files of an .r3d recording."""

    def spoil(files: dict[str, bytes]) -> None:
        about = json.loads(files["metadata"])
        change(files, about)
        files["metadata"] = json.dumps(about).encode()

    return spoil


LZFSE_BOMB = b"bvxn" + (1 << 30).to_bytes(4, "little") + (8).to_bytes(4, "little") + bytes(8) + b"bvx$"
R3D_FAULTS = {
    "bomb": (of_r3d(lambda f, a: f.update({"rgbd/1.depth": LZFSE_BOMB})), "1.depth has 1073741824 bytes unpacked"),
    "cut off": (of_r3d(lambda f, a: f.update({"rgbd/1.depth": f["rgbd/1.depth"][:-30]})), "LZFSE: it is cut off"),
    "no LZFSE": (of_r3d(lambda f, a: f.update({"rgbd/2.conf": b"bvx?" + bytes(9)})), "a block of the kind"),
    "unturned": (of_r3d(lambda f, a: a.update(w=320, h=240)), "is of pictures 320 x 240, but rgbd/1.jpg is 240 x 320"),
    "normalised": (
        of_r3d(lambda f, a: a.update(perFrameIntrinsicCoeffs=[[0.8, 0.6, 0.5, 0.5]])),
        "identity or normalised",
    ),
    "few times": (of_r3d(lambda f, a: a.update(frameTimestamps=[0, 1])), "'frameTimestamps' has 2 entries"),
    "no size": (of_r3d(lambda f, a: a.pop("w")), "'w' is None"),
    "another depth": (of_r3d(lambda f, a: a.update(dw=61)), "expected 19520"),
    "nothing": (
        of_r3d(lambda f, a: [f.pop(n) for n in list(f) if "depth" in n]),
        "has 0 frames with colours and depth",
    ),
}


@pytest.mark.parametrize("fault", R3D_FAULTS)
def test_a_broken_r3d_file_is_one_line(tmp_path, fault):
    spoil, words = R3D_FAULTS[fault]
    files = record3d_files()
    spoil(files)
    source = write_r3d(tmp_path / "mug.r3d", files)
    assert_refused(words, lambda: list(read_one(source).recording.frames()))
    data = source.read_bytes()
    source.write_bytes(data[:-40])
    assert_refused(r"mug\.r3d is not a readable \.r3d file", read_one, source)


REAL = Path(__file__).resolve().parents[2] / "shared/rgbd"


@pytest.mark.skipif(not (REAL / "record3d").is_dir(), reason="the real recording is not here")
def test_a_real_export_of_record3d():
    pytest.importorskip("OpenEXR")
    recording = read_one(REAL / "record3d").recording
    frame = recording.frame(11)
    assert (recording.camera.width, recording.camera.height, len(recording)) == (960, 1280, 12)
    assert frame.rgb.std() > 10 and (frame.depth > 0).mean() > 0.95 and 0.2 < np.median(frame.depth) < 3
    assert recording.times_s[-1] == pytest.approx(11 / 60, abs=0.01)
