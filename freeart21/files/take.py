"""A take: the motion of a hand-moved object and its joint over time, as a text file with one JSON object per line.

    {"schema": "freeart21/take/1", "device": "mouse", "poses": "first", "joint_type": "revolute",
     "units": {"time": "s", "position": "m", "state": "rad"}}                               (first line)
    {"time": 0.0, "position": [0, 0, 0.5], "quaternion": [1, 0, 0, 0], "state": 0.2}        (one per sample)

Poses are the object's frame in the camera's axes (x right, y down, z forward). `poses` is "camera" where they are
absolute, and "first" where only their change since the first sample counts: the rotation, and the shift of the object's
origin. Quaternions are wxyz. Samples are raw; where they need smoothing before use, as those of a hand-held controller,
the first line also has `"filter": {"one_euro": {...}}` (`freeart21.one_euro`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.json_record import read_record
from freeart21.joint import JointType
from freeart21.one_euro import Band, OneEuro
from freeart21.se3 import Array

TAKE_SCHEMA = "freeart21/take/1"
MAX_TAKE_BYTES = 64 << 20
"""About 400,000 samples: an hour at 100 Hz."""
MAX_SAMPLES = 500_000
Meaning = Literal["camera", "first"]
_UNIT = {"revolute": "rad", "prismatic": "m"}
_FARTHEST = 1e4
"""Largest number of a sample: metres, radians, and seconds since the first one."""
_MOST_IN_FILTER = 1e4
"""Largest filter parameter: beyond it a filter does nothing at any sampling rate of a take."""


@dataclass(frozen=True)
class Take:
    """The motion of an object in n samples."""

    name: str
    """Name of its file, without the folder."""
    sha256: str
    """Hash of the file."""
    form: str
    """Its schema, or the name of a third-party layout."""
    device: str
    """Input device."""
    poses: Meaning
    """Whether poses are absolute in the camera's axes, or count as changes since the first."""
    joint_type: JointType
    times: Array
    """(n,) seconds, increasing."""
    Ts: Array
    """(n, 4, 4) the object's frame in the camera's axes."""
    states: Array
    """(n,) joint state, rad or m."""
    filter: OneEuro | None = None
    """Filter to apply before use; None for none."""
    size: float | None = None
    """Metres: diagonal of the bounding box of the moved object; None when unknown."""

    def __post_init__(self) -> None:
        n = len(self.times)
        if not 2 <= n <= MAX_SAMPLES:
            raise FreeArtError(f"{self.name} holds {n} samples, expected 2 to {MAX_SAMPLES}")
        back = np.flatnonzero(np.diff(self.times) <= 0)
        if len(back):
            i = int(back[0]) + 1
            raise FreeArtError(
                f"{self.name}: sample {i} is of {self.times[i]:g} s, after one of {self.times[i - 1]:g} s; expected "
                "increasing times"
            )
        far = max(np.ptp(self.times), np.abs(self.Ts[:, :3, 3]).max(), np.abs(self.states).max())
        if not far <= _FARTHEST:
            raise FreeArtError(f"{self.name} holds a number of {far:.3g}, expected at most {_FARTHEST:g} s, m or rad")
        if self.size is not None and not 0 < self.size <= _FARTHEST:
            raise FreeArtError(f"{self.name}: 'size' is {self.size:g} m, expected more than 0, at most {_FARTHEST:g}")


def header_line(
    device: str, poses: Meaning, joint_type: JointType, filter: OneEuro | None = None, size: float | None = None
) -> str:
    """The first line of a take's file, without the line end."""
    units = {"time": "s", "position": "m", "state": _UNIT[joint_type]}
    head = {"schema": TAKE_SCHEMA, "device": device, "poses": poses, "joint_type": joint_type, "units": units}
    smoothed = {} if filter is None else {"filter": {"one_euro": asdict(filter)}}
    return _line(head | smoothed | ({} if size is None else {"size": float(size)}))


def sample_line(time: float, T: Array, state: float) -> str:
    """The line of a sample, without the line end; `T` is its pose (4, 4)."""
    T = np.asarray(T, float)
    numbers = {"position": T[:3, 3].tolist(), "quaternion": se3.wxyz(T).tolist()}
    return _line({"time": float(time), **numbers, "state": float(state)})


def write_take(
    path: Path,
    device: str,
    poses: Meaning,
    joint_type: JointType,
    samples: Iterable[tuple[float, Array, float]],
    filter: OneEuro | None = None,
    size: float | None = None,
) -> None:
    """Write a take, whole or not at all; `samples` are (time in s, pose (4, 4), state in rad or m)."""
    lines = [header_line(device, poses, joint_type, filter, size), *(sample_line(*s) for s in samples)]
    atomic.write_bytes(path, ("\n".join(lines) + "\n").encode())


def read_take(path: Path) -> Take:
    """The take in `path`; FreeArtError names a wrong line."""
    data = checked.read_bytes(path, MAX_TAKE_BYTES, checked.ANYWHERE)
    lines = data.splitlines()
    head = _object(lines[0] if lines else b"", f"{path} line 1")
    if head.get("schema") != TAKE_SCHEMA:
        raise FreeArtError(f"{path} has schema {head.get('schema')!r}, expected '{TAKE_SCHEMA}'")
    joint_type = checked.one_of(head, "joint_type", get_args(JointType), path)
    poses = checked.one_of(head, "poses", get_args(Meaning), path)
    units = {"time": "s", "position": "m", "state": _UNIT[joint_type]}
    if head.get("units") != units:
        raise FreeArtError(f"{path}: 'units' is {head.get('units')!r}, expected {units}")
    rows = [_sample(line, f"{path} line {k}") for k, line in enumerate(lines[1 : MAX_SAMPLES + 2], start=2)]
    table = np.array(rows, float).reshape(-1, 9)
    Ts = se3.pose_from_wxyz(table[:, 1:4], table[:, 4:8]) if len(table) else np.zeros((0, 4, 4))
    return Take(
        path.name,
        hashlib.sha256(data).hexdigest(),
        TAKE_SCHEMA,
        checked.text(head, "device", path),
        cast(Meaning, poses),
        cast(JointType, joint_type),
        table[:, 0],
        Ts,
        table[:, 8],
        _filter(head.get("filter"), path),
        None if head.get("size") is None else float(checked.numbers(head, "size", (), path)),
    )


def _line(data: dict[str, Any]) -> str:
    return json.dumps(data, allow_nan=False)


def _object(line: bytes, where: str) -> dict[str, Any]:
    try:
        data = checked.parse_json(line.decode("utf-8"), where)
    except UnicodeDecodeError as error:
        raise FreeArtError(f"{where} is not JSON: {error}") from error
    if not isinstance(data, dict):
        raise FreeArtError(f"{where} holds a {type(data).__name__}, expected an object")
    return data


@dataclass(frozen=True)
class _Filters:
    """`filter` of the first line."""

    one_euro: OneEuro


def _filter(given: object, path: Path) -> OneEuro | None:
    """`filter` of the first line; FreeArtError when it is invalid."""
    if given is None:
        return None
    where = f"{path}: 'filter'"
    found = read_record(_Filters, given, where, whole=True).one_euro
    numbers = {"speed_cutoff_hz": (found.speed_cutoff_hz, 1e-3)}
    for name in ("position", "rotation", "state"):
        band: Band | None = getattr(found, name)
        if band is not None:
            numbers |= {f"{name}.min_cutoff_hz": (band.min_cutoff_hz, 1e-3), f"{name}.beta": (band.beta, 0.0)}
    for name, (value, least) in numbers.items():
        if not least <= value <= _MOST_IN_FILTER:
            raise FreeArtError(f"{where}: '{name}' is {value:g}, expected {least:g} to {_MOST_IN_FILTER:g}")
    return found


def _sample(line: bytes, where: str) -> list[float]:
    """Time, position, quaternion, state."""
    data = _object(line, where)
    row: list[float] = []
    for key, count in (("time", 1), ("position", 3), ("quaternion", 4), ("state", 1)):
        given = data.get(key)
        values: list[Any] = given if isinstance(given, list) else [given]
        if len(values) != count or isinstance(given, list) == (count == 1) or not all(map(checked.is_number, values)):
            noun = "a finite number" if count == 1 else f"{count} finite numbers"
            raise FreeArtError(f"{where}: '{key}' is {str(given)[:60]}, expected {noun}")
        row += [float(v) for v in values]
    if abs(np.linalg.norm(row[4:8]) - 1) > 1e-3:
        raise FreeArtError(f"{where}: 'quaternion' has length {np.linalg.norm(row[4:8]):.4g}, expected 1")
    return row
