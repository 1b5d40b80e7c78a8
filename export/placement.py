"""Link frames of an asset: upright on the ground, with limits and zero of the joint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from export.joint_range import JointRange, choose_zero
from export.resting_pose import FACET_ANGLE, GROUND_SHARE, choose_upright, find_support, resting_poses, settle
from export.settings import PlacementSettings
from export.standing import BASE, find_front, name_role, normalise
from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal, box_centre
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array

MAX_STILL_SHARE = 0.02
"""Fraction of the object's diagonal by which points of a still part may move in the camera frame: poses of
reconstructions are off by at most this."""

MIN_RANGE = {"revolute": 1e-3, "prismatic": 1e-4}
"""rad or m: a joint that was observed to move less has no limits to export."""
MIN_STANDING = 0.5
"""Share of the frames in which the reference part has one tilt: whoever carries an object about tilts it."""


@dataclass(frozen=True)
class Placement:
    """The two link frames of an asset and the joint between them.

    At joint position zero the object stands on z = 0 with z up. The root link's origin is below the middle of its
    support. The child link is parallel to it there, its origin at the pivot.
    """

    T_canonical_reference: Array
    """(4, 4) the reference link's frame in the canonical frame."""
    root: str
    """The part whose link is the root of the tree, 'reference' or 'moving': the one that stands on the ground."""
    joint: Joint
    """Motion of the child link in the root link's frame, with the limits of the URDF joint."""
    state_zero: float
    """URDF joint position, rad or m, at canonical state zero."""
    reference: Mesh
    """Reference part in its link's frame."""
    moving: Mesh
    """Moving part in its link's frame."""
    roles: dict[str, str]
    """Role by part, such as 'base' and 'drawer' (`standing.name_role`)."""
    report: dict[str, Any]
    """For asset.json: `up`, `limits`, `zero`."""


def place_parts(
    reconstruction: Reconstruction,
    found: JointRange,
    settings: PlacementSettings,
    scale: float = 1.0,
    gravity: NDArray[np.float64] | None = None,
) -> Placement:
    """Link frames for a reconstruction.

    Args:
        reconstruction: two parts and their joint.
        found: the joint's range.
        settings: up direction and zero.
        scale: the reconstruction's lengths over those of its video.
        gravity: (n, 3) unit direction of gravity in each frame's camera axes, where the recording has it.

    Zero comes from `choose_zero`. Raises FreeArtError on a joint that does not move, or `gravity` with a reference part
    that did not stand still.
    """
    articulation = reconstruction.articulation
    joint = articulation.joint
    min_range = MIN_RANGE[joint.type] * (scale if joint.type == "prismatic" else 1.0)
    if found.high - found.low < min_range:
        raise FreeArtError(
            f"joint '{joint.name}' was seen to move by {found.high - found.low:.3g} {joint.state_unit}, expected at "
            f"least {min_range:g}: its limits are unknown"
        )
    zero, zero_name = choose_zero(articulation, found, settings.zero)
    up, support, up_report = _choose_up(reconstruction, settings, found, zero, gravity)
    root = "moving" if support == "moving" else "reference"
    T_canonical_root = _root_pose(articulation, support, up, _find_front(articulation, root, up, found, zero), zero)
    T_root_canonical = se3.inverse(T_canonical_root)
    Ts = {"reference": T_root_canonical, "moving": T_root_canonical @ joint.transform(zero)}  # at joint position zero
    parts = {name: articulation.part(name).moved(Ts[name]) for name in PARTS}
    child = "reference" if root == "moving" else "moving"
    in_root = joint.moved(T_root_canonical)
    pivot = box_centre(parts[child])
    if joint.type == "revolute":  # the point of the axis nearest to the part: the reconstructed pivot can be far away
        pivot = in_root.pivot + in_root.axis * (in_root.axis @ (pivot - in_root.pivot))
    to_child = se3.pose(np.eye(3), -pivot)
    frames = {root: np.eye(4), child: to_child}
    axis = -in_root.axis if root == "moving" else in_root.axis
    return Placement(
        T_canonical_root @ se3.inverse(frames["reference"]),
        root,
        replace(in_root, axis=axis, pivot=pivot, lower=found.low - zero, upper=found.high - zero),
        0.0 - zero,
        parts["reference"].moved(frames["reference"]),
        parts["moving"].moved(frames["moving"]),
        {root: BASE, child: name_role(in_root, parts[root], parts[child])},
        {
            "up": up_report,
            "limits": {"lower": found.low_by, "upper": found.high_by},
            "zero": {"asked": settings.zero, "end": zero_name},
        },
    )


def _choose_up(
    answer: Reconstruction,
    settings: PlacementSettings,
    found: JointRange,
    zero: float,
    gravity: NDArray[np.float64] | None,
) -> tuple[NDArray[np.float64], str, dict[str, Any]]:
    """(3,) up in the canonical frame, the part that then supports the object, and a report."""
    parts = answer.articulation
    if settings.up is not None:
        up = normalise(np.array(settings.up))
        return up, find_support(parts, zero, up), _describe_up("given", up)
    first = _first_frame(answer)
    R_canonical_camera = answer.Ts_camera_reference[first, :3, :3].T
    if settings.gravity is not None:
        _check_reference_still(answer)
        up = -R_canonical_camera @ normalise(np.array(settings.gravity))
        return up, find_support(parts, zero, up), _describe_up("gravity", up)
    standing = None if gravity is None else find_standing_up(answer, gravity)
    if standing is not None:
        up, share = standing
        rest = settle(parts, zero, up)
        up = rest if rest is not None and rest @ up > np.cos(FACET_ANGLE) else up
        how = "gravity in the recording"
        return up, find_support(parts, zero, up), _describe_up(how, up) | {"share_of_frames": share}
    camera_up = R_canonical_camera @ (np.array([0.0, -1.0, 0.0]) if gravity is None else -gravity[first])
    poses = resting_poses(parts, found.low, found.high, zero)
    best = choose_upright(poses, camera_up)
    if best is None:
        rest = settle(parts, zero, camera_up)  # in this pose the joint need not be free
        up, how = (camera_up, "first frame's camera") if rest is None else (rest, "rest from the first frame's camera")
        return up, find_support(parts, zero, up), _describe_up(how, up)
    pose, share = best
    rest = settle(parts, zero, pose.up)
    up = pose.up if rest is None or rest @ pose.up < np.cos(FACET_ANGLE) else rest
    return (
        up,
        pose.support,
        _describe_up("resting pose", up)
        | {
            "share": share,
            "tipping_rad": pose.tipping,
            "tipping_worst_rad": pose.worst,
            "carried_by": pose.support,
        },
    )


def find_standing_up(answer: Reconstruction, gravity: NDArray[np.float64]) -> tuple[NDArray[np.float64], float] | None:
    """(3,) up in the canonical frame, in which the reference part stood for at least `MIN_STANDING` of the frames in
    which it was seen, and that share; None when it was tilted to and fro.

    `gravity` (n, 3) is its direction in each frame's camera axes.
    """
    seen = answer.seen[:, 0] if answer.seen[:, 0].any() else np.ones(len(answer), bool)
    ups = -np.einsum("nji,nj->ni", answer.Ts_camera_reference[seen, :3, :3], gravity[seen])
    near = ups @ ups.T > np.cos(FACET_ANGLE)
    most = int(np.argmax(near.sum(1)))
    share = float(near[most].mean())
    return (normalise(ups[near[most]].mean(0)), share) if share >= MIN_STANDING else None


def _describe_up(how: str, up: NDArray[np.float64]) -> dict[str, Any]:
    return {"axis": "z", "how": how, "direction_canonical": [float(x) for x in up]}


def _first_frame(answer: Reconstruction) -> int:
    """The frame that defines camera directions: the anchor, or the first in which the reference part was seen."""
    seen = answer.seen[:, 0]
    return answer.anchor if answer.anchor or seen[0] or not seen.any() else int(np.argmax(seen))


def _check_reference_still(answer: Reconstruction) -> None:
    """Raise FreeArtError when the reference part moved in the camera frame by more than `MAX_STILL_SHARE`."""
    corners = answer.articulation.reference.vertices
    box = np.stack(np.meshgrid(*np.stack([corners.min(0), corners.max(0)], -1), indexing="ij"), -1).reshape(-1, 3)
    Ts = answer.Ts_camera_reference[answer.seen[:, 0]] if answer.seen[:, 0].any() else answer.Ts_camera_reference
    there = se3.transform(Ts, np.broadcast_to(box, (len(Ts), 8, 3)))
    moved = float(np.linalg.norm(there - there[:1], axis=-1).max())
    most = MAX_STILL_SHARE * bounding_diagonal(answer.articulation.reference, answer.articulation.moving)
    if moved > most:
        raise FreeArtError(
            f"gravity: the reference part moved before the camera by {1000 * moved:.3g} mm, expected that it stood "
            f"still (at most {1000 * most:.3g} mm); give --up instead"
        )


def _find_front(
    parts: Articulation, root: str, up: NDArray[np.float64], found: JointRange, zero: float
) -> NDArray[np.float64]:
    """(3,) x axis of the root link in the canonical frame (`standing.find_front`)."""
    posed = dict(zip(PARTS, parts.posed(np.eye(4), zero), strict=True))
    opening = 1.0 if found.high - zero >= zero - found.low else -1.0
    child = "reference" if root == "moving" else "moving"
    return find_front(up, parts.joint, posed[root], posed[child], opening if child == "moving" else -opening)


def _root_pose(
    parts: Articulation, support: str, up: NDArray[np.float64], front: NDArray[np.float64], zero: float
) -> Array:
    """(4, 4) root link in the canonical frame: z up, x to the front, origin on the ground below the middle of the
    support at state `zero`."""
    R = np.stack([front, np.cross(up, front), up], -1)
    posed = dict(zip(PARTS, parts.posed(np.eye(4), zero), strict=True))
    corners = {name: mesh.vertices[np.unique(mesh.faces)] @ R for name, mesh in posed.items()}
    level = min(points[:, 2].min() for points in corners.values())
    near = level + GROUND_SHARE * bounding_diagonal(parts.reference, parts.moving)
    standing = np.concatenate([points for name, points in corners.items() if support in (name, "both")])
    base = standing[standing[:, 2] < near]
    base = base if len(base) else standing
    x, y, _ = 0.5 * (base.min(0) + base.max(0))
    return se3.pose(R, R @ np.array([x, y, level]))
