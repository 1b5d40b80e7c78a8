"""An asset as it is once loaded: its joint, its visual meshes where the simulator puts them, and what is wrong with it.

Assets come from anywhere and are read by native code, so scoring drives them in a Python of their own
(`freeart21.child`): one that crashes the simulator costs its own row, not the whole table.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import child, se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import find_movable_joint, read_asset
from freeart21.files.joint_json import joint_from_json, joint_to_json
from freeart21.files.urdf import parse_urdf, read_urdf_joints
from freeart21.files.urdf_files import resolve_file
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from leaderboard import asset_process
from leaderboard.protocol import Shape
from leaderboard.submission import LARGEST, MAX_FACES
from leaderboard.surface import Surface

NEEDED = (
    "sapien",
    "mujoco",
    "trimesh.convex",
    "scipy.spatial",
    "generator.simulate",
    "export.checklist",
    "freeart21.view.link_shapes",
)
"""What an asset's process imports, as far as it is installed, before it is asked."""
DRIVEN_STATES = 33
"""States, spread over the joint's range, at which the link poses are read."""
TIME_LIMIT_S = 90.0
"""How long an asset may take to load, move and be checked: ours take 2 to 5 s on two cores."""
MAX_ASSET_BYTES = 1 << 30
LEAST_TURN = 1e-4
"""Radians over the whole range below which a joint does not turn (SAPIEN's poses are float32: 1e-6)."""
LEAST_SLIDE = 1e-6
"""Metres over the whole range below which a joint does not slide."""
LOOSEST_FIT = 1e-3
"""Largest entry, per metre of travel, by which the motion may differ from that of one hinge or slider."""


@dataclass(frozen=True)
class MeasuredAsset:
    """What an asset is once loaded, in its canonical frame."""

    joint: Joint
    states: Array
    """(n,) what the joint makes of the states that it was asked for, rad or m."""
    shape: Shape | None
    """Its visual meshes as the link poses place them, moved as the joint moves; None when only the joint was asked."""
    findings: tuple[str, ...]
    """What `export.checklist.check_asset` finds, one line each; empty when only the joint was asked."""


def measure_joint(folder: Path, states: ArrayLike) -> tuple[Joint, Array]:
    """The joint of the asset in `folder`, canonical frame, and what it makes of the canonical `states` (n,), rad or m.

    Drives the asset in a process of its own. Raises FreeArtError with one reason when it does not load, does not move,
    or crashes the simulator.
    """
    asset = _measured(folder, states, whole=False)
    return asset.joint, asset.states


def measure_asset(folder: Path, states: ArrayLike) -> MeasuredAsset:
    """The asset in `folder` as it is once loaded and put at the canonical `states` (n,), rad or m.

    Raises FreeArtError as `measure_joint` does, and when a mesh or a mass is broken: empty, not finite, of no size, or
    one that no body has.
    """
    return _measured(folder, states, whole=True)


def _measured(folder: Path, states: ArrayLike, whole: bool) -> MeasuredAsset:
    check_asset_files(folder)
    with tempfile.TemporaryDirectory() as made:
        place = Path(made)
        shape = place / "shape.npz"
        request = {"asset": str(folder.resolve()), "states": np.asarray(states, float).tolist()}
        if whole:
            request["shape"] = str(shape)
        said = _ask(folder, request, place)
        joint = joint_from_json(said["joint"], folder)
        found = _read_shape(shape) if whole else None
    return MeasuredAsset(joint, np.array(said["states"], float), found, tuple(said["findings"]))


def _ask(folder: Path, request: dict[str, Any], place: Path) -> dict[str, Any]:
    try:
        answer = asset_process.ask("leaderboard.asset_measurement", request, place, TIME_LIMIT_S)
    except asset_process.TimedOut as error:
        raise FreeArtError(f"{folder} did not load and move within {TIME_LIMIT_S:g} s") from error
    except asset_process.Crashed as error:
        code, _, said = str(error).partition(": ")
        raise FreeArtError(f"{folder} ended the simulator that loaded it ({code}): {said}") from error
    if "error" in answer:
        raise FreeArtError(answer["error"])
    return answer


def _write_shape(path: Path, shape: Shape) -> None:
    named = {f"{key}_{k}": getattr(m, key) for k, m in enumerate(shape.parts) for key in ("vertices", "faces")}
    np.savez(path, motions=shape.motions, **named)


def _read_shape(path: Path) -> Shape:
    keys = ("vertices_0", "faces_0", "vertices_1", "faces_1", "motions")
    data = checked.read_npz(path, keys)
    reference, moving = (Mesh(data[f"vertices_{k}"], data[f"faces_{k}"]) for k in (0, 1))
    return Shape((reference, moving), data["motions"])


def check_asset_files(folder: Path) -> None:
    """FreeArtError unless the asset is of bounded size and its URDF names no file outside `folder`."""
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    if size > MAX_ASSET_BYTES:
        raise FreeArtError(f"{folder} has {size} bytes, at most {MAX_ASSET_BYTES} are read")
    for urdf in sorted(folder.rglob("*.urdf")):
        for element in parse_urdf(urdf).iter():
            if "filename" in element.attrib:
                resolve_file(urdf, element.attrib["filename"], folder)


def drive_joint(asset: Asset, states: ArrayLike) -> tuple[Joint, Array, Array]:
    """Load `asset` in SAPIEN, drive its joint over its range, and read joint, states and motions from the link poses.

    The motions (n, 4, 4) displace the moving part from canonical state zero to `states` (n,). States beyond the URDF's
    limits are driven to the limit: an asset shows what it can do.
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
    found = fit_joint_to_motion(asset.joint, driven, motion[: len(driven)])
    joint = replace(found, lower=lower, upper=upper)  # as far as it goes, which may be without end
    motions = motion[len(driven) :]
    return joint, project_states(joint, motions), motions


def read_visual_parts(asset: Asset) -> tuple[Mesh, Mesh]:
    """All visual meshes on the reference link's side of the joint, and all on the moving link's, at state zero.

    In the canonical frame, each link where SAPIEN has it. Raises FreeArtError when a mesh cannot be read, has no
    surface or numbers beyond LARGEST, or a side shows nothing at all.
    """
    from freeart21.view.link_shapes import read_shown
    from generator.simulate import load

    shown, simulated = read_shown(asset.urdf, asset.root), load(asset)
    if shown.missing:
        raise FreeArtError(f"mesh: {asset.urdf.name} names {shown.missing[0]}, which does not exist")
    simulated.set_effects(())
    simulated.set_state(asset.state_zero)
    T_canonical_world = asset.T_canonical_reference @ se3.inverse(simulated.link_pose(asset.reference_link))
    beyond = _beyond(asset)
    sides: dict[bool, list[Mesh]] = {False: [], True: []}
    for name, pieces in shown.visuals.items():
        T_canonical_link = T_canonical_world @ simulated.link_pose(name)
        for piece in pieces:
            _check_visual(piece.mesh, name)
            sides[name in beyond].append(piece.mesh.moved(T_canonical_link))
    moving = asset.moving_link in beyond
    for side, link_name in ((not moving, asset.reference_link), (moving, asset.moving_link)):
        if not sides[side]:
            raise FreeArtError(f"mesh: no link on the side of '{link_name}' has a visual with a surface")
    return _joined(sides[not moving]), _joined(sides[moving])


def _beyond(asset: Asset) -> set[str]:
    """The child link of the scored joint and all links that hang on it."""
    joints = read_urdf_joints(asset.urdf)
    found = {joints[asset.joint].child}
    while more := {j.child for j in joints.values() if j.parent in found} - found:
        found |= more
    return found


def _check_visual(mesh: Mesh, link: str) -> None:
    largest = float(np.abs(mesh.vertices).max(initial=0.0))
    if largest > LARGEST:
        raise FreeArtError(f"mesh: a visual of link '{link}' reaches {largest:.3g} m, expected below {LARGEST:g}")
    if len(mesh.faces) > MAX_FACES:
        raise FreeArtError(f"mesh: a visual of link '{link}' has {len(mesh.faces)} faces, at most {MAX_FACES} are read")
    if Surface(mesh).empty:
        raise FreeArtError(f"mesh: a visual of link '{link}' has no surface (empty, or of scale 0)")


def _joined(meshes: list[Mesh]) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return Mesh(vertices, np.concatenate([m.faces + start for m, start in zip(meshes, starts[:-1], strict=True)]))


def fit_joint_to_motion(name: str, states: Array, motion: Array) -> Joint:
    """The hinge or slider that displaces a part by `motion` (n, 4, 4), canonical frame, at rising `states` (n,).

    The axis is the direction of the summed small rotations (or of the whole translation) towards larger states; the
    pivot solves (I - R) p = t in the plane across it by least squares over all displacements. Raises FreeArtError when
    the part does not move, or moves otherwise.
    """
    steps = motion[1:] @ se3.inverse(motion[:-1])
    turn = se3.log_so3(steps[:, :3, :3]).sum(0)
    slide = motion[-1, :3, 3] - motion[0, :3, 3]
    from_first = motion @ se3.inverse(motion[0])
    limits = float(states[0]), float(states[-1])
    if np.linalg.norm(turn) > LEAST_TURN:
        axis = turn / np.linalg.norm(turn)
        across = np.linalg.svd(axis[None])[2][1:].T  # (3, 2) basis of the plane across the axis
        A = (np.eye(3) - from_first[:, :3, :3]) @ across
        in_plane, *_ = np.linalg.lstsq(A.reshape(-1, 2), from_first[:, :3, 3].reshape(-1), rcond=None)
        joint = Joint(name, "revolute", axis, across @ in_plane, *limits)
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
    """States (n,) along `joint` of displacements (n, 4, 4): rad in [-pi, pi] about its axis, or m along it."""
    if joint.type == "prismatic":
        return motion[:, :3, 3] @ joint.axis
    return se3.log_so3(motion[:, :3, :3]) @ joint.axis


def _examine_asset(folder: Path, states: Array, shape: Path | None) -> dict[str, Any]:
    asset, findings = read_asset(folder), []
    if shape is not None:
        from export.checklist import check_asset

        findings = check_asset(folder)
        for finding in findings:
            if finding.broken:
                raise FreeArtError(str(finding))
    joint, moved_states, motions = drive_joint(asset, states)
    if shape is not None:
        _write_shape(shape, Shape(read_visual_parts(asset), motions))
    return {"joint": joint_to_json(joint), "states": moved_states.tolist(), "findings": [str(f) for f in findings]}


def reply(request: dict[str, Any]) -> dict[str, Any]:
    """What the asset is, or the one error that it has."""
    shape = request.get("shape")
    try:
        return _examine_asset(Path(request["asset"]), np.array(request["states"], float), shape and Path(shape))
    except Exception as error:  # hostile files reach parsers of many libraries; each has exceptions of its own
        return {"error": child.one_line(error)}


def main() -> None:
    """Answer requests, each in a process of its own."""
    asset_process.serve(reply, NEEDED)
