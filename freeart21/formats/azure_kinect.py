"""An .mkv recording of an Azure Kinect, or of an Orbbec Femto Bolt by its K4A wrapper.

Tracks are named COLOR (MJPG, NV12 or YUY2), DEPTH (16 bits big-endian, millimetres, 0 for none) and IR; the attachment
calibration.json has both cameras. Its numbers are for the whole sensor: `_MODES` says which part a picture shows
(Azure-Kinect-Sensor-SDK, mode_specific_calibration.c). Principal points count from the picture's corner, as ours.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.formats import third_party
from freeart21.formats.rgbd_video import Lens, Picture, RgbdVideo, align_video, pair_streams
from freeart21.formats.third_party import ReadOptions, RecordingLayout, ThirdPartyRecording
from freeart21.formats.video_file import VideoFile, VideoTrack
from freeart21.se3 import Array

_COLOUR, _DEPTH = "CALIBRATION_CameraPurposePhotoVideo", "CALIBRATION_CameraPurposeDepth"
_BROWN_CONRADY = "CALIBRATION_LensDistortionModelBrownConrady"
_ORDER = [4, 5, 13, 12, 6, 7, 8, 9]
"""Places of OpenCV's coefficients in ModelParameters: cx, cy, fx, fy, k1 to k6, codx, cody, p2, p1."""
_MODES = {
    _DEPTH: {
        (320, 288): ((512, 512), (96, 90)),
        (640, 576): ((1024, 1024), (192, 180)),
        (512, 512): ((512, 512), (0, 0)),
        (1024, 1024): ((1024, 1024), (0, 0)),
    },
    _COLOUR: {
        (1280, 720): ((1280, 960), (0, 120)),
        (1920, 1080): ((1920, 1440), (0, 180)),
        (2560, 1440): ((2560, 1920), (0, 240)),
        (2048, 1536): ((2048, 1536), (0, 0)),
        (3840, 2160): ((3840, 2880), (0, 360)),
        (4096, 3072): ((4096, 3072), (0, 0)),
    },
}
"""Size of the picture to that of the whole sensor, binned, and the place of the picture's corner in it."""


def read_azure_kinect(source: Path, options: ReadOptions) -> ThirdPartyRecording:
    """The recording in the file `source`. Raises FreeArtError in one line."""
    source = Path(source)
    file = VideoFile(source, "matroska", checked.ANYWHERE)
    lacking = [name for name in ("COLOR", "DEPTH") if name not in file.titles]
    data = next((data for name, data in file.attachments.items() if name.lower().endswith(".json")), None)
    if lacking or data is None:
        what = f"track {lacking[0]}" if lacking else "attachment calibration.json"
        raise FreeArtError(f"{source} has no {what}, expected a recording of an Azure Kinect or Femto Bolt")
    where = f"{source}: calibration.json"
    known = checked.parse_json(data.rstrip(b"\0").decode("utf-8", "replace"), where)
    cameras = _find_cameras(known, where)
    colour, depth = (VideoTrack(file, file.titles[name]) for name in ("COLOR", "DEPTH"))
    lens, T_colour = _read_camera(cameras, _COLOUR, colour, where)
    depth_lens, T_depth = _read_camera(cameras, _DEPTH, depth, where)
    colours, depths, times, notes = pair_streams(source, colour.times_s, depth.times_s)

    def load(index: int) -> Picture:
        raw = depth.read(int(depths[index]))
        if raw.ndim != 2 or raw.dtype.itemsize != 2:
            raise FreeArtError(f"{source}: track DEPTH has pixels {raw.shape} {raw.dtype}, expected 16 bits")
        return Picture(colour.read(int(colours[index]), "rgb24"), raw.astype(np.float32) / np.float32(1000))

    video = RgbdVideo(
        third_party.safe_name(source.resolve().stem),
        times,
        load,
        lens,
        depth_lens,
        T_colour @ se3.inverse(T_depth),
        notes=notes,
    )
    return align_video(video, options)


def _find_cameras(known: Any, where: str) -> dict[str, dict[str, Any]]:
    """Purpose to camera."""
    try:
        return {str(one["Purpose"]): one for one in known["CalibrationInformation"]["Cameras"]}
    except (TypeError, KeyError, AttributeError):
        raise FreeArtError(f"{where} has no CalibrationInformation with Cameras that have a Purpose") from None


def _read_camera(cameras: dict[str, Any], purpose: str, track: VideoTrack, where: str) -> tuple[Lens, Array]:
    """The camera of a track's pictures, and T_camera_rig (4, 4)."""
    if purpose not in cameras:
        raise FreeArtError(f"{where} has no camera {purpose}; it has {', '.join(cameras)[:200]}")
    where, about = f"{where}: {purpose}", cameras[purpose]
    size = (track.width, track.height)
    if size not in _MODES[purpose]:
        known = ", ".join(f"{w} x {h}" for w, h in _MODES[purpose])
        raise FreeArtError(f"{where}: its track has {size[0]} x {size[1]} pixels, expected {known}")
    model = checked.json_object(about, "Intrinsics", where)
    checked.one_of(model, "ModelType", (_BROWN_CONRADY,), where)
    values = checked.numbers(model, "ModelParameters", (None,), Path(where))
    if len(values) != 14 or np.abs(values[10:12]).max() > 0:
        raise FreeArtError(f"{where}: ModelParameters has {len(values)} numbers, expected 14, codx and cody zero")
    cx, cy, fx, fy = values[:4]
    sensor = [checked.number(about, key, where, 1) for key in ("SensorWidth", "SensorHeight")]
    if purpose == _COLOUR and abs(sensor[0] * 9 / 16 - sensor[1]) < 1:  # calibrated on 16:9, the middle of 4:3
        cy, fy = (cy * 2304 + 384) / 3072, fy * 2304 / 3072
    (width, height), corner = _MODES[purpose][size]
    K = np.array([[fx * width, 0, cx * width - corner[0]], [0, fy * height, cy * height - corner[1]], [0, 0, 1.0]])
    rig = checked.json_object(about, "Rt", where)
    R = checked.numbers(rig, "Rotation", (9,), Path(where)).reshape(3, 3)
    T = se3.pose(R, checked.numbers(rig, "Translation", (3,), Path(where)))
    return Lens(K, *size, values[_ORDER]), se3.orthonormalised(se3.check_poses(f"{where}: Rt", T[None], 1e-3)[0])


LAYOUT = RecordingLayout(
    "azure",
    1,
    "an .mkv file of an Azure Kinect or Femto Bolt",
    lambda path: path.is_file() and path.suffix.lower() == ".mkv",
    read_azure_kinect,
)
