"""Cache of finished stages, next to the result: an interrupted run continues to the same result, bit for bit.

Each stage is one .npz file (arrays, and facts as JSON; nothing executable). Its key is made of the video's bytes, the
settings used by this and earlier stages, the solver's code, its libraries, and on CUDA the renderer. Random numbers
continue where the stage left them.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import zipfile
import zlib
from dataclasses import dataclass, field, fields, is_dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.diagnostics import Diagnostics
from freeart21.gaussians import Gaussians
from freeart21.joint import Joint
from freeart21.reconstruction import Reconstruction
from reconstruct import VERSION
from reconstruct.gaussians import gsplat_backend
from reconstruct.pose_sources import digest_poses
from reconstruct.poses import FreePoses
from reconstruct.propagation import PartEstimate
from reconstruct.settings import ReconstructSettings
from reconstruct.stages import CACHED_STAGES, CachedStageName, settings_used_by

_LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "scikit-image")
MAX_STAGE_BYTES = 16 << 30
"""Limit for a stage file, packed and unpacked. Labels and log-odds of a minute of 1280 x 720 at 30 Hz, 5 bytes a pixel,
take 8 GB."""
_READ_ERRORS = (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error, FreeArtError)


@dataclass(frozen=True)
class SolverState:
    """What the stages so far have found."""

    estimate: PartEstimate | None = None
    """Labels, poses and joint."""
    appearance: Gaussians | None = None
    """In the frame of the reference part, at state zero of the joint of `estimate`."""
    free_poses: tuple[FreePoses, ...] = ()
    """Both parts' poses without the joint."""
    result: Reconstruction | None = None
    """The final result; the other fields are then dropped."""
    diagnostics: Diagnostics | None = None
    """Of the final result."""


@dataclass(frozen=True)
class CachedStage:
    """A stage's outcome, and all that the next one needs."""

    stage: CachedStageName | None
    """None before the first stage."""
    state: SolverState
    rng: np.random.Generator
    """As the stage left it."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Duration of this stage and of those before it, when they were solved."""


class StageCache:
    """The folder of cached stages that belongs to one result folder."""

    def __init__(self, sequence: Path, out: Path, settings: ReconstructSettings) -> None:
        """Reads `sequence` once, for the keys. The folder is created when a stage is stored."""
        self.folder = work_folder(out)
        self._keys = stage_keys(sequence, settings)

    def path(self, stage: CachedStageName) -> Path:
        """The file of a stage."""
        return self.folder / f"{stage}.npz"

    def load_last(self) -> tuple[CachedStage | None, list[str]]:
        """The furthest stage cached under the present key, and a line for each file that cannot be used."""
        complaints = []
        for stage in reversed(CACHED_STAGES):
            path = self.path(stage)
            if not path.is_file():
                continue
            try:
                found = _read_stage(path, stage, self._keys[stage])
            except _READ_ERRORS as error:
                complaints.append(f"{path} is not a readable stage: {error}; it is solved again")
                continue
            if found is not None:
                return found, complaints
            complaints.append(f"{path} is of another video, other settings, another solver or another GPU")
        return None, complaints

    def store(self, outcome: CachedStage) -> None:
        """Write a stage's outcome, whole or not at all. Raises CannotWrite."""
        assert outcome.stage is not None
        atomic.write_bytes(self.path(outcome.stage), _pack_stage(outcome, self._keys[outcome.stage]))

    def remove(self) -> None:
        """Delete the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)


def work_folder(out: Path) -> Path:
    """The hidden folder next to the result folder `out` for its cached stages; `out` itself appears only when
    complete."""
    out = Path(out)
    return out.parent / f".{out.name}.work"


def stage_keys(sequence: Path, settings: ReconstructSettings) -> dict[CachedStageName, str]:
    """SHA-256, hexadecimal, of all that each stage's outcome depends on. Held-out views are not part of it."""
    basis = hashlib.sha256(json.dumps([VERSION, _own_code(), _libraries()]).encode())
    for name in ("sequence.json", "rgb", "depth", "mask"):
        path = sequence / name
        for file in sorted(path.glob("*.png")) if path.is_dir() else [path]:
            basis.update(f"{file.relative_to(sequence)} {file.stat().st_size} ".encode())
            basis.update(checked.read_bytes(file, checked.MAX_IMAGE_BYTES, sequence))
    groups = settings.to_json()
    del groups["progress"]
    if settings.gaussians.refine and settings.gaussians.backend != "numba":
        groups["gaussians"]["renderer"] = _describe_renderer()
    groups["poses_from"] = digest_poses(settings.poses_from)
    keys = {}
    for stage in CACHED_STAGES:
        digest = basis.copy()
        digest.update(json.dumps([stage, settings_used_by(stage, groups)], sort_keys=True).encode())
        keys[stage] = digest.hexdigest()
    return keys


@lru_cache
def _own_code() -> str:
    """SHA-256, hexadecimal, of the solver's files."""
    folder, digest = Path(__file__).parent, hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(f"{path.relative_to(folder)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def _libraries() -> dict[str, str]:
    found = {}
    for name in _LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:  # OpenCV goes by several names
            found[name] = ""
    return found


@lru_cache
def _describe_renderer() -> list[str]:
    """gsplat's version, torch's version and the GPU, where Gaussians are rendered on one; otherwise nothing.

    On a GPU sums have no fixed order: cached results are reused exactly, but solving again differs in the last bits.
    """
    if gsplat_backend.missing_requirement() is not None:
        return []
    import torch

    return [metadata.version("gsplat"), torch.__version__, torch.cuda.get_device_name()]


# --- a stage as a file ------------------------------------------------------------------------------------------------


def _pack_stage(outcome: CachedStage, key: str) -> bytes:
    arrays: dict[str, NDArray[Any]] = {}
    facts = {
        "stage": outcome.stage,
        "key": key,
        "seconds": outcome.seconds,
        "rng": outcome.rng.bit_generator.state,
        "state": _pack(outcome.state, "state", arrays),
    }
    arrays["facts"] = np.frombuffer(json.dumps(facts).encode(), np.uint8)
    buffer = io.BytesIO()
    # compression level 6 takes 1.5 times as long for 5 % less
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)
    return buffer.getvalue()


def _read_stage(path: Path, stage: CachedStageName, key: str) -> CachedStage | None:
    """What `_pack_stage` wrote; None when it has another key. Raises one of _READ_ERRORS."""
    packed = checked.read_npz(path, ("facts",), limit=MAX_STAGE_BYTES)["facts"]
    facts = checked.parse_json(packed.tobytes().decode(), path)
    if (facts["stage"], facts["key"]) != (stage, key):
        return None
    rng = np.random.default_rng()
    rng.bit_generator.state = facts["rng"]
    state = _unpack(SolverState, facts["state"], "state", checked.read_npz(path, limit=MAX_STAGE_BYTES))
    return CachedStage(stage, state, rng, facts["seconds"])


def _pack(value: Any, name: str, arrays: dict[str, NDArray[Any]]) -> Any:
    """`value` as JSON, of which `name` is the place; the arrays in it go to `arrays`, by their places."""
    if is_dataclass(value):
        return {f.name: _pack(getattr(value, f.name), f"{name}.{f.name}", arrays) for f in fields(value)}
    if isinstance(value, tuple):
        return [_pack(entry, f"{name}.{k}", arrays) for k, entry in enumerate(value)]
    if isinstance(value, np.ndarray):
        arrays[name] = value
        return {}
    return value.item() if isinstance(value, np.generic) else value


def _unpack(hint: Any, value: Any, name: str, arrays: dict[str, NDArray[Any]]) -> Any:
    """What `_pack` was given, of the type `hint`."""
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (kind for kind in get_args(hint) if kind is not NoneType)
    if value is None:
        return None
    if is_dataclass(hint):
        assert isinstance(hint, type)
        hints = get_type_hints(hint)
        found = hint(**{key: _unpack(hints[key], entry, f"{name}.{key}", arrays) for key, entry in value.items()})
        if hint is Joint:
            object.__setattr__(found, "axis", arrays[f"{name}.axis"])  # normalised again the last bit may change
        return found
    if get_origin(hint) is tuple:
        return tuple(_unpack(get_args(hint)[0], entry, f"{name}.{k}", arrays) for k, entry in enumerate(value))
    return arrays[name] if get_origin(hint) is np.ndarray else value
