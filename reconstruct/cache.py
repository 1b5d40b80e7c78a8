"""What finished stages found, kept beside the result: a stopped run goes on from there, to the same result bit for bit.

A stage is kept as one .npz file (arrays, and facts as JSON; nothing that can be executed) under a key made of the
video's bytes, the settings that this and earlier stages use, the solver's code and its libraries, and what draws
Gaussians on this machine. Random numbers go on where the stage left them.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import zipfile
import zlib
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import code
from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.diagnostics import Diagnostics, diagnostics_from_json, diagnostics_to_json
from freeart21.gaussians import Gaussians
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction, Trust
from reconstruct import VERSION
from reconstruct.gaussians import gsplat_backend
from reconstruct.growth import Grown
from reconstruct.poses import FreePoses, JointedPoses
from reconstruct.settings import ReconstructSettings
from reconstruct.stages import KEPT, KeptStage, used_by

_LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "scikit-image")
MAX_STAGE_BYTES = 16 << 30
"""Of a stage, packed and unpacked: labels and log odds of a minute of 1280 x 720 at 30 Hz, 5 bytes a pixel, have 8."""
_UNREADABLE = (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error, FreeArtError)


@dataclass(frozen=True)
class Known:
    """All that the stages so far have found."""

    grown: Grown | None = None
    """Parts, poses and joint."""
    appearance: Gaussians | None = None
    """In the frame of the reference part, at state zero of the joint in `grown`."""
    free: tuple[FreePoses, ...] = ()
    """Both parts' poses without the joint."""
    answer: Reconstruction | None = None
    """The whole; what led to it is dropped."""
    diagnostics: Diagnostics | None = None
    """Of the whole."""


@dataclass(frozen=True)
class Kept:
    """A stage's outcome, and all that the next one needs."""

    stage: KeptStage | None
    """None before any stage."""
    known: Known
    rng: np.random.Generator
    """As the stage left it."""
    seconds: dict[str, float] = field(default_factory=dict)
    """What this stage and those before it took, when they were solved."""


class Work:
    """The folder of kept stages that belongs to one result folder."""

    def __init__(self, sequence: Path, out: Path, settings: ReconstructSettings) -> None:
        """`sequence` is read once, for the keys. The folder is made when a stage is kept."""
        self.folder = work_folder(out)
        self._keys = stage_keys(sequence, settings)

    def path(self, stage: KeptStage) -> Path:
        """The file of a stage."""
        return self.folder / f"{stage}.npz"

    def last(self) -> tuple[Kept | None, list[str]]:
        """The furthest stage that is kept under today's key, and a line for each file that cannot be used."""
        complaints = []
        for stage in reversed(KEPT):
            if not self.path(stage).is_file():
                continue
            try:
                kept = _read(self.path(stage), stage, self._keys[stage])
            except _UNREADABLE as error:
                complaints.append(f"{self.path(stage)} is not a readable stage: {error}; it is solved again")
                continue
            if kept is not None:
                return kept, complaints
            complaints.append(f"{self.path(stage)} is of another video, other settings, another solver or another GPU")
        return None, complaints

    def keep(self, kept: Kept) -> None:
        """Write a stage's outcome, whole or not at all. Raises CannotWrite."""
        assert kept.stage is not None
        atomic.write_bytes(self.path(kept.stage), _packed(kept, self._keys[kept.stage]))

    def remove(self) -> None:
        """Forget everything."""
        shutil.rmtree(self.folder, ignore_errors=True)


def work_folder(out: Path) -> Path:
    """Where the stages of the result folder `out` are kept: beside it, hidden, since `out` itself appears whole."""
    out = Path(out)
    return out.parent / f".{out.name}.work"


def stage_keys(sequence: Path, settings: ReconstructSettings) -> dict[KeptStage, str]:
    """SHA-256, hexadecimal, of all that a stage's outcome depends on. Held-out views are not among it."""
    basis = hashlib.sha256(json.dumps([VERSION, _own_code(), _libraries()]).encode())
    for name in ("sequence.json", "rgb", "depth", "mask"):
        path = sequence / name
        for file in sorted(path.glob("*.png")) if path.is_dir() else [path]:
            basis.update(f"{file.relative_to(sequence)} {file.stat().st_size} ".encode())
            basis.update(checked.read_bytes(file, checked.MAX_IMAGE_BYTES, sequence))
    groups = settings.to_json()
    del groups["progress"]
    if settings.gaussians.refine and settings.gaussians.backend != "numba":
        groups["gaussians"]["drawn by"] = _drawn_by()
    keys = {}
    for stage in KEPT:
        digest = basis.copy()
        digest.update(json.dumps([stage, used_by(stage, groups)], sort_keys=True).encode())
        keys[stage] = digest.hexdigest()
    return keys


def code_digest(folder: Path | None = None) -> str:
    """SHA-256, hexadecimal, of what the modules in `folder` (the solver's own when None) do: comments, docstrings and
    layout left out."""
    folder = folder or Path(__file__).parent
    return code.code_digest((str(path.relative_to(folder)), path) for path in sorted(folder.rglob("*.py")))


@lru_cache
def _own_code() -> str:
    return code_digest()


def _libraries() -> dict[str, str]:
    found = {}
    for name in _LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:  # OpenCV goes by several names
            found[name] = ""
    return found


@lru_cache
def _drawn_by() -> list[str]:
    """What draws Gaussians here, beside what every key holds: nothing without a GPU; else it, gsplat and torch.

    There sums have no fixed order: what is kept stays, bit for bit, but a second solving differs in its last bits.
    """
    if gsplat_backend.lack() is not None:
        return []
    import torch

    return [metadata.version("gsplat"), torch.__version__, torch.cuda.get_device_name()]


# --- a stage as a file ------------------------------------------------------------------------------------------------


def _packed(kept: Kept, key: str) -> bytes:
    arrays: dict[str, NDArray[Any]] = {}
    facts: dict[str, Any] = {
        "stage": kept.stage,
        "key": key,
        "solver": VERSION,
        "seconds": kept.seconds,
        "rng": kept.rng.bit_generator.state,
    }
    known = kept.known
    if known.grown is not None:
        grown, poses = known.grown, known.grown.poses
        facts["joint"] = _pack_joint(poses.joint, arrays)
        arrays |= {"labels": grown.labels, "logodds": grown.logodds, "seen": grown.seen, "cost": np.array(poses.cost)}
        arrays |= {"states": poses.states, "Ts": poses.Ts, "state_std": poses.state_std}
        if poses.joint_std is not None:
            arrays["joint_std"] = poses.joint_std
    for k, free in enumerate(known.free):
        arrays |= {f"free_{k}_Ts": free.Ts, f"free_{k}_covariances": free.covariances}
    facts["free"] = len(known.free)
    _pack_appearance("appearance", known.appearance, arrays)
    if known.answer is not None:
        facts["answer"] = _pack_answer(known.answer, arrays)
    if known.diagnostics is not None:
        facts["diagnostics"] = diagnostics_to_json(known.diagnostics)
        if known.diagnostics.confidence_maps is not None:
            arrays["confidence_maps"] = known.diagnostics.confidence_maps
    arrays["facts"] = np.frombuffer(json.dumps(facts).encode(), np.uint8)
    buffer = io.BytesIO()
    with zipfile.ZipFile(
        buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1
    ) as archive:  # 6: half as slow again, 5 % less
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)
    return buffer.getvalue()


def _read(path: Path, stage: KeptStage, key: str) -> Kept | None:
    """What `_packed` wrote; None when it was under another key. Raises one of _UNREADABLE."""
    packed = checked.read_npz(path, ("facts",), limit=MAX_STAGE_BYTES)["facts"]
    facts = checked.parse_json(packed.tobytes().decode(), path)
    if (facts["stage"], facts["key"]) != (stage, key):
        return None
    arrays = checked.read_npz(path, limit=MAX_STAGE_BYTES)
    rng = np.random.default_rng()
    rng.bit_generator.state = facts["rng"]
    grown = None
    if "joint" in facts:
        joint = _unpack_joint(facts["joint"], arrays)
        found_poses = arrays["states"], arrays["Ts"], arrays["state_std"], float(arrays["cost"])
        poses = JointedPoses(joint, *found_poses, arrays.get("joint_std"))
        grown = Grown(poses, arrays["labels"], arrays["logodds"], arrays["seen"])
    free = tuple(FreePoses(arrays[f"free_{k}_Ts"], arrays[f"free_{k}_covariances"]) for k in range(facts["free"]))
    answer = _unpack_answer(facts["answer"], arrays) if "answer" in facts else None
    diagnostics = None
    if "diagnostics" in facts:
        found = diagnostics_from_json(facts["diagnostics"], path)
        diagnostics = replace(found, confidence_maps=arrays.get("confidence_maps"))
    appearance = _unpack_appearance("appearance", arrays)
    return Kept(stage, Known(grown, appearance, free, answer, diagnostics), rng, facts["seconds"])


_OF_ANSWER = ("states", "Ts_camera_reference", "Ts_camera_moving", "part_masks", "seen", "state_std", "covariances")
_OF_GAUSSIANS = tuple(f.name for f in fields(Gaussians))


def _pack_answer(answer: Reconstruction, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    for name in _OF_ANSWER:
        value = getattr(answer, name)
        if value is not None:
            arrays[f"answer_{name}"] = value
    for part in PARTS:
        mesh = answer.articulation.part(part)
        arrays |= {f"{part}_vertices": mesh.vertices, f"{part}_faces": mesh.faces}
        if mesh.colours is not None:
            arrays[f"{part}_colours"] = mesh.colours
    _pack_appearance("answer_appearance", answer.appearance, arrays)
    said = None if answer.trust is None else {"verdict": answer.trust.verdict, "reasons": answer.trust.reasons}
    stds = {"axis_std": answer.axis_std, "pivot_std": answer.pivot_std}
    return {**_pack_joint(answer.articulation.joint, arrays), **stds, "trust": said}


def _unpack_answer(facts: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Reconstruction:
    meshes = [Mesh(arrays[f"{p}_vertices"], arrays[f"{p}_faces"], arrays.get(f"{p}_colours")) for p in PARTS]
    articulation = Articulation(_unpack_joint(facts, arrays), meshes[0], meshes[1])
    answer = Reconstruction(articulation, **{name: arrays.get(f"answer_{name}") for name in _OF_ANSWER})  # type: ignore[arg-type]
    said = facts["trust"]
    trust = None if said is None else Trust(said["verdict"], tuple(said["reasons"]))
    appearance = _unpack_appearance("answer_appearance", arrays)
    return replace(answer, trust=trust, axis_std=facts["axis_std"], pivot_std=facts["pivot_std"], appearance=appearance)


def _pack_appearance(where: str, gaussians: Gaussians | None, arrays: dict[str, NDArray[Any]]) -> None:
    if gaussians is not None:
        found = {name: getattr(gaussians, name) for name in _OF_GAUSSIANS}
        arrays.update({f"{where}_{name}": array for name, array in found.items() if array is not None})


def _unpack_appearance(where: str, arrays: dict[str, NDArray[Any]]) -> Gaussians | None:
    found = {name: arrays[f"{where}_{name}"] for name in _OF_GAUSSIANS if f"{where}_{name}" in arrays}
    return Gaussians(**found) if found else None


def _pack_joint(joint: Joint, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    arrays["joint"] = np.array([*joint.axis, *joint.pivot, joint.lower, joint.upper])
    return {"name": joint.name, "type": joint.type}


def _unpack_joint(facts: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Joint:
    numbers = arrays["joint"]
    joint = Joint(facts["name"], facts["type"], numbers[:3], numbers[3:6], float(numbers[6]), float(numbers[7]))
    axis = numbers[:3].copy()
    axis.flags.writeable = False
    object.__setattr__(joint, "axis", axis)  # a Joint makes its axis a unit vector again, which may move the last bit
    return joint
