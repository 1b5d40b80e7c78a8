"""A sequence folder: the part of a recording that methods see."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.recording import Frame, Query, Recording

SCHEMA = "freeart21/sequence/1"
QUERIES_SCHEMA = "freeart21/queries/1"
NO_DEPTH = 65535
"""The largest depth value: cameras write it where they measured nothing. It means no depth, as 0 does."""
MAX_SIDE = 16384


def header_json(
    camera: Camera, depth_scale: float, times_s: np.ndarray, licence: str | None, gravity: np.ndarray | None = None
) -> dict[str, Any]:
    """The JSON object of sequence.json. `depth_scale` is metres per depth unit, `gravity` as in `Recording`."""
    header = {
        "schema": SCHEMA,
        "camera": {"K": camera.K, "width": camera.width, "height": camera.height},
        "depth_scale": depth_scale,
        "times_s": times_s,
        "licence": licence,
    }
    return header if gravity is None else header | {"gravity": np.round(gravity, 6)}


def write_header(
    folder: Path,
    camera: Camera,
    depth_scale: float,
    times_s: np.ndarray,
    licence: str | None,
    gravity: np.ndarray | None = None,
) -> None:
    """Write sequence.json. `depth_scale` is metres per depth unit, `gravity` as in `Recording`."""
    atomic.write_json(folder / "sequence.json", header_json(camera, depth_scale, times_s, licence, gravity))


def queries_json(queries: tuple[Query, ...]) -> dict[str, Any]:
    """The JSON object of queries.json."""
    return {
        "schema": QUERIES_SCHEMA,
        "queries": [
            {"pose_of_frame": q.pose_of_frame, "state_of_frame": q.state_of_frame, "T_newcam_cam": q.T_newcam_cam}
            for q in queries
        ],
    }


def write_queries(folder: Path, queries: tuple[Query, ...]) -> None:
    """Write queries.json."""
    atomic.write_json(folder / "queries.json", queries_json(queries))


def encode_depth(depth: np.ndarray, depth_scale: float) -> np.ndarray:
    """A z-depth map, metres, in uint16 units; 0 where there is no depth or it is out of range."""
    units = np.rint(np.asarray(depth, np.float32) * np.float32(1 / depth_scale))
    return np.where((units >= 1) & (units < NO_DEPTH), units, np.float32(0)).astype(np.uint16)


def write_frame(folder: Path, index: int, frame: Frame, depth_scale: float) -> None:
    """Write rgb/, depth/ and mask/ of one frame."""
    name = f"{index:05d}.png"
    for sub, image in (
        ("rgb", frame.rgb),
        ("depth", encode_depth(frame.depth, depth_scale)),
        ("mask", frame.mask.astype(np.uint8) * 255),
    ):
        atomic.write_bytes(folder / sub / name, checked.encode_png(image))


def write_sequence(folder: Path, recording: Recording, depth_scale: float) -> None:
    """Write a whole sequence folder."""
    with atomic.new_folder(folder) as aside:
        for i, frame in enumerate(recording.frames()):
            write_frame(aside, i, frame, depth_scale)
        write_queries(aside, recording.queries)
        write_header(aside, recording.camera, depth_scale, recording.times_s, recording.licence, recording.gravity)


def read_sequence(folder: Path) -> Recording:
    """The recording in a sequence folder; frames load lazily, but every file must be there.

    Raises FreeArtError when the folder is not a sequence, a frame is missing, or an image has another size.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FreeArtError(f"{folder} is not a folder")
    header = folder / "sequence.json"
    if not checked.is_there(header):
        raise FreeArtError(f"{folder} is not a sequence: it has no sequence.json")
    data = checked.read_json(header, SCHEMA, folder)
    with checked.naming(header):
        camera = _camera(data, header)
    times = checked.numbers(data, "times_s", (None,), header)
    scale = data.get("depth_scale")
    if not isinstance(scale, int | float) or not 0 < scale < 1:
        raise FreeArtError(f"{header}: depth_scale is {scale!r}, expected metres per unit between 0 and 1")
    for sub in ("rgb", "depth", "mask"):
        have = {p.name for p in (folder / sub).glob("*.png")} if (folder / sub).is_dir() else set()
        missing = [i for i in range(len(times)) if f"{i:05d}.png" not in have]
        if missing:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise FreeArtError(
                f"{folder}: frame {missing[0]} is missing: no {sub}/{missing[0]:05d}.png{more}, "
                f"expected {len(times)} frames"
            )

    def load(index: int) -> Frame:
        name = f"{index:05d}.png"
        units = checked.read_uint16(folder / "depth" / name, folder)
        depth = np.where(units < NO_DEPTH, units, np.uint16(0)).astype(np.float32) * np.float32(scale)
        mask = checked.read_labels(folder / "mask" / name, folder) > 127
        return Frame(checked.read_rgb(folder / "rgb" / name, folder), depth, mask)

    gravity = checked.numbers(data, "gravity", (len(times), 3), header) if "gravity" in data else None
    with checked.naming(folder):
        return Recording(camera, times, load, _read_queries(folder), data.get("licence"), folder.name, gravity)


def _camera(data: dict[str, Any], path: Path) -> Camera:
    camera = data.get("camera")
    if not isinstance(camera, dict):
        raise FreeArtError(f"{path}: 'camera' is {camera!r}, expected an object with K, width, height")
    size = checked.numbers({"size": [camera.get("width"), camera.get("height")]}, "size", (2,), path)
    if (size != size.round()).any() or size.min() < 1 or size.max() > MAX_SIDE:
        raise FreeArtError(f"{path}: camera size is {size.tolist()}, expected whole numbers from 1 to {MAX_SIDE}")
    return Camera(checked.numbers(camera, "K", (3, 3), path), int(size[0]), int(size[1]))


def _read_queries(folder: Path) -> tuple[Query, ...]:
    path = folder / "queries.json"
    if not checked.is_there(path):
        return ()
    entries = checked.read_json(path, QUERIES_SCHEMA).get("queries")
    if not isinstance(entries, list):
        raise FreeArtError(f"{path}: 'queries' is {type(entries).__name__}, expected a list")
    queries = []
    for i, entry in enumerate(entries):
        a, b = (entry.get("pose_of_frame"), entry.get("state_of_frame")) if isinstance(entry, dict) else (None, None)
        if not isinstance(a, int) or not isinstance(b, int):
            raise FreeArtError(f"{path}: query {i} has frames {a!r} and {b!r}, expected two whole numbers")
        queries.append(Query(a, b, checked.numbers(entry, "T_newcam_cam", (4, 4), path)))
    return tuple(queries)
