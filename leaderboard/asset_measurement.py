"""Measures a submitted asset in the simulator: its joint, its visual meshes, and the findings of its checks.

The loaders of an asset are native code that a hostile file can crash, so each asset is measured in a process of its own
(`leaderboard.forked`).
"""

from __future__ import annotations

import atexit
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import processes, se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import find_movable_joint, read_asset
from freeart21.files.joint_json import joint_from_json, joint_to_json
from freeart21.files.urdf import read_file_names, read_urdf_joints, subtree_links
from freeart21.files.urdf_files import resolve_file
from freeart21.joint import Joint
from freeart21.mesh import Mesh, join_meshes
from freeart21.se3 import Array
from leaderboard import forked
from leaderboard.protocol import Shape
from leaderboard.submission import LARGEST, MAX_FACES
from leaderboard.surface import Surface

MODULES = (
    "sapien",
    "mujoco",
    "trimesh.convex",
    "scipy.spatial",
    "generator.simulate",
    "export.checklist",
    "freeart21.view.link_shapes",
)
"""Imported by the asset process before the first request, as far as installed."""
DRIVEN_STATES = 33
"""States, evenly spaced over the joint's range, at which the link poses are read."""
TIME_LIMIT_S = 90.0
"""Time limit to load, drive and check an asset. Measured: 2 to 5 s on two cores."""
MAX_ASSET_BYTES = 1 << 30
LEAST_TURN = 1e-4
"""Radians over the whole range below which a joint counts as not rotating (SAPIEN's poses are float32: 1e-6)."""
LEAST_SLIDE = 1e-6
"""Metres over the whole range below which a joint counts as not sliding."""
LOOSEST_FIT = 1e-3
"""Largest entry, per metre of travel, of the difference between the motion and that of a hinge or slider."""

_SERVER = forked.Server("leaderboard.asset_measurement")
atexit.register(_SERVER.close)


@dataclass(frozen=True)
class MeasuredAsset:
    """A loaded asset, in its canonical frame."""

    joint: Joint
    states: Array
    """(n,) joint states reached for the n requested ones, rad or m."""
    shape: Shape | None
    """Its visual meshes, placed by the simulator's link poses; None when only the joint was measured."""
    findings: tuple[str, ...]
    """Findings of `export.checklist.check_asset`, one line each; empty when only the joint was measured."""


def measure_asset(folder: Path, states: ArrayLike, whole: bool = True) -> MeasuredAsset:
    """The asset in `folder`, loaded and driven to the canonical `states` (n,), rad or m; `whole`: not its joint alone.

    Raises FreeArtError with one reason when the asset does not load, does not move, or crashes the simulator, and if
    `whole` for a broken mesh or mass: empty, not finite, of no size or implausible.
    """
    check_asset_files(folder)
    with tempfile.TemporaryDirectory() as temporary:
        shape_file = Path(temporary) / "shape.npz"
        request = {"asset": str(folder.resolve()), "states": np.asarray(states, float).tolist()}
        if whole:
            request["shape"] = str(shape_file)
        answer = _ask(folder, request, Path(temporary))
        joint = joint_from_json(answer["joint"], folder)
        shape = _read_shape(shape_file) if whole else None
    return MeasuredAsset(joint, np.array(answer["states"], float), shape, tuple(answer["findings"]))


def _ask(folder: Path, request: dict[str, Any], temporary: Path) -> dict[str, Any]:
    try:
        answer = _SERVER.ask(request, temporary, TIME_LIMIT_S)
    except forked.TimedOut as error:
        raise FreeArtError(f"{folder} did not load and move within {TIME_LIMIT_S:g} s") from error
    except forked.Crashed as error:
        code, _, message = str(error).partition(": ")
        raise FreeArtError(f"{folder} ended the simulator that loaded it ({code}): {message}") from error
    if "error" in answer:
        raise FreeArtError(answer["error"])
    return answer


def _write_shape(path: Path, shape: Shape) -> None:
    arrays = {f"{key}_{k}": getattr(m, key) for k, m in enumerate(shape.parts) for key in ("vertices", "faces")}
    np.savez(path, motions=shape.motions, **arrays)


def _read_shape(path: Path) -> Shape:
    data = checked.read_npz(path, ("vertices_0", "faces_0", "vertices_1", "faces_1", "motions"))
    reference, moving = (Mesh(data[f"vertices_{k}"], data[f"faces_{k}"]) for k in (0, 1))
    return Shape((reference, moving), data["motions"])


def check_asset_files(folder: Path) -> None:
    """Raise FreeArtError unless the asset is of bounded size and its URDFs name no file outside `folder`."""
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    if size > MAX_ASSET_BYTES:
        raise FreeArtError(f"{folder} has {size} bytes, at most {MAX_ASSET_BYTES} are read")
    for urdf in sorted(folder.rglob("*.urdf")):
        for name in read_file_names(urdf):
            resolve_file(urdf, name, folder)


# ---- in the asset process


def drive_joint(asset: Asset, states: ArrayLike) -> tuple[Joint, Array, Array]:
    """Load `asset` in SAPIEN, drive its joint over its range, and measure joint, states and motions from link poses.

    The motions (n, 4, 4) displace the moving part from canonical state zero to `states` (n,). States beyond the URDF's
    limits are driven to the limit.
    """
    from generator.simulate import joint_motion

    if asset.scale != 1.0:
        raise FreeArtError(f"{asset.urdf.parent} has {asset.scale:g} times the video's lengths (its scale), expected 1")
    states = np.asarray(states, float)
    limits = find_movable_joint(asset.urdf, asset.joint)
    lower, upper = limits.lower - asset.state_zero, limits.upper - asset.state_zero
    reachable = np.clip(states, lower, upper)
    low = lower if np.isfinite(lower) else min(reachable.min(), -0.5)
    high = upper if np.isfinite(upper) else max(reachable.max(), 0.5)
    driven = np.linspace(low, high, DRIVEN_STATES)
    motion = joint_motion(asset, np.concatenate([driven, reachable]))
    joint = fit_joint_to_motion(asset.joint, driven, motion[: len(driven)])
    joint = replace(joint, lower=lower, upper=upper)  # infinite limits, too
    motions = motion[len(driven) :]
    return joint, project_states(joint, motions), motions


def read_visual_parts(asset: Asset) -> tuple[Mesh, Mesh]:
    """All visual meshes on the reference link's side of the joint, and all on the moving link's, at state zero.

    In the canonical frame, placed by SAPIEN's link poses. Raises FreeArtError when a mesh cannot be read, has no
    surface or coordinates beyond LARGEST, or a side has no mesh.
    """
    from freeart21.view.link_shapes import read_shown
    from generator.simulate import load

    shown, simulated = read_shown(asset.urdf, asset.root), load(asset)
    if shown.missing:
        raise FreeArtError(f"mesh: {asset.urdf.name} names {shown.missing[0]}, which does not exist")
    simulated.set_effects(())
    simulated.set_state(asset.state_zero)
    T_canonical_world = asset.T_canonical_reference @ se3.inverse(simulated.link_pose(asset.reference_link))
    joints = read_urdf_joints(asset.urdf)
    child_side = subtree_links(joints, joints[asset.joint].child)
    sides: dict[bool, list[Mesh]] = {False: [], True: []}
    for link, pieces in shown.visuals.items():
        T_canonical_link = T_canonical_world @ simulated.link_pose(link)
        for piece in pieces:
            _check_visual(piece.mesh, link)
            sides[link in child_side].append(piece.mesh.moved(T_canonical_link))
    moving = asset.moving_link in child_side
    for side, link in ((not moving, asset.reference_link), (moving, asset.moving_link)):
        if not sides[side]:
            raise FreeArtError(f"mesh: no link on the side of '{link}' has a visual with a surface")
    return join_meshes(sides[not moving]), join_meshes(sides[moving])


def _check_visual(mesh: Mesh, link: str) -> None:
    largest = float(np.abs(mesh.vertices).max(initial=0.0))
    if largest > LARGEST:
        raise FreeArtError(f"mesh: a visual of link '{link}' reaches {largest:.3g} m, expected below {LARGEST:g}")
    if len(mesh.faces) > MAX_FACES:
        raise FreeArtError(f"mesh: a visual of link '{link}' has {len(mesh.faces)} faces, at most {MAX_FACES} are read")
    if Surface(mesh).empty:
        raise FreeArtError(f"mesh: a visual of link '{link}' has no surface (empty, or of scale 0)")


def fit_joint_to_motion(name: str, states: Array, motion: Array) -> Joint:
    """The hinge or slider that displaces a part by `motion` (n, 4, 4), canonical frame, at rising `states` (n,).

    The axis is the direction of the summed small rotations (or of the whole translation) towards larger states. The
    pivot solves (I - R) p = t in the plane normal to the axis by least squares over all displacements. Raises
    FreeArtError when the part does not move, or moves like neither.
    """
    steps = motion[1:] @ se3.inverse(motion[:-1])
    turn = se3.log_so3(steps[:, :3, :3]).sum(0)
    slide = motion[-1, :3, 3] - motion[0, :3, 3]
    from_first = motion @ se3.inverse(motion[0])
    limits = float(states[0]), float(states[-1])
    if np.linalg.norm(turn) > LEAST_TURN:
        axis = turn / np.linalg.norm(turn)
        plane = np.linalg.svd(axis[None])[2][1:].T  # (3, 2) basis of the plane normal to the axis
        A = (np.eye(3) - from_first[:, :3, :3]) @ plane
        in_plane, *_ = np.linalg.lstsq(A.reshape(-1, 2), from_first[:, :3, 3].reshape(-1), rcond=None)
        joint = Joint(name, "revolute", axis, plane @ in_plane, *limits)
    elif np.linalg.norm(slide) > LEAST_SLIDE:
        joint = Joint(name, "prismatic", slide / np.linalg.norm(slide), np.zeros(3), *limits)
    else:
        raise FreeArtError(f"joint '{name}' of the asset does not move over its range {limits[0]:g} to {limits[1]:g}")
    q = project_states(joint, from_first)
    error = np.abs(from_first - joint.transform(q)).max()
    if error > LOOSEST_FIT * (1 + np.linalg.norm(from_first[:, :3, 3], axis=-1).max()):
        raise FreeArtError(f"joint '{name}' of the asset moves like neither hinge nor slider: off by {error:.2g}")
    return joint


def project_states(joint: Joint, motion: Array) -> Array:
    """States (n,) of `joint` for displacements (n, 4, 4): rad in [-pi, pi] about its axis, or m along it."""
    if joint.type == "prismatic":
        return motion[:, :3, 3] @ joint.axis
    return se3.log_so3(motion[:, :3, :3]) @ joint.axis


def _examine_asset(folder: Path, states: Array, shape_file: Path | None) -> dict[str, Any]:
    asset, findings = read_asset(folder), []
    if shape_file is not None:
        from export.checklist import check_asset

        findings = check_asset(folder)
        for finding in findings:
            if finding.broken:
                raise FreeArtError(str(finding))
    joint, reached, motions = drive_joint(asset, states)
    if shape_file is not None:
        _write_shape(shape_file, Shape(read_visual_parts(asset), motions))
    return {"joint": joint_to_json(joint), "states": reached.tolist(), "findings": [str(f) for f in findings]}


def reply(request: dict[str, Any]) -> dict[str, Any]:
    """The measured asset of `request`, or its first error."""
    shape_file = request.get("shape")
    states = np.array(request["states"], float)
    try:
        return _examine_asset(Path(request["asset"]), states, shape_file and Path(shape_file))
    except Exception as error:  # parsers of many libraries read hostile files, each with its own exceptions
        return {"error": processes.one_line(error)}


def main() -> None:
    """Serve requests as an asset process."""
    forked.serve(reply, MODULES)
