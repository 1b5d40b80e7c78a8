"""Where the links of an asset stand: from a reconstruction's canonical frame to link frames that people can use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from export.carving import carved
from export.joint_range import STATES, TOLERANCE, ZEROS, JointRange, Zero, joint_range, zero_state
from export.penetration import Overlap
from export.resting import FLAT, TOUCHING, carrier_of, resting_poses, settled, upright
from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal, box_centre
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array

STILL = 0.02
"""Part of the object's diagonal by which no point of a part that stands still moves before the camera: what poses of
reconstructions are off by at most."""

Direction = tuple[float, float, float]


@dataclass(frozen=True)
class PlacementSettings:
    """Where an asset stands and where its joint begins and ends."""

    up: Direction | None = None
    """Direction in the canonical frame that becomes z of the links; None is a resting pose's, or gravity's."""
    gravity: Direction | None = None
    """Which way gravity pulls, in the camera's axes (right, down, forward) of the first frame; any length. Only when
    the reference part stood still before the camera; not together with `up`."""
    zero: Zero = "closed"
    """Where the URDF joint is at zero: 'first' frame, 'closed' (the end where both parts fill the least space),
    'lower', 'upper'."""
    tolerance_m: float = TOLERANCE
    """Metres by which the parts may be in each other, in the asset's own lengths when it is scaled."""
    carve: bool = True
    """Whether what one part sweeps is cut out of what the other collides with, where both are closed."""

    def check(self) -> None:
        """FreeArtError when a setting cannot be."""
        for name in ("up", "gravity"):
            value = getattr(self, name)
            if value is not None:
                _unit(value, name)
        if self.up is not None and self.gravity is not None:
            raise FreeArtError("up and gravity are both given: give one of them")
        if self.zero not in ZEROS:
            raise FreeArtError(f"zero is '{self.zero}', expected one of {', '.join(ZEROS)}")
        if not 0 < self.tolerance_m < np.inf:
            raise FreeArtError(f"tolerance_m is {self.tolerance_m:g} m, expected more than 0")


@dataclass(frozen=True)
class Placement:
    """The two link frames of an asset and the joint between them.

    At joint position zero the object stands on z = 0, z up; the root link's origin is under the middle of what it
    stands on. The other link's axes are parallel to it there, its origin at the pivot.
    """

    T_canonical_reference: Array
    """(4, 4) canonical frame from the reference link's frame."""
    root: str
    """The part that carries the object, 'reference' or 'moving': its link is the root of the tree."""
    joint: Joint
    """In the root link's frame, of the other link against it; its limits are those of the URDF joint."""
    state_zero: float
    """URDF joint position at canonical state zero, rad or m."""
    reference: Mesh
    """Reference part in its link's frame."""
    moving: Mesh
    """Moving part in its link's frame."""
    solids: dict[str, Mesh]
    """What each part collides with, in its link's frame: its mesh, less what was carved."""
    said: dict[str, Any]
    """For asset.json: `up`, `limits`, `zero`, `penetration`."""


def placed(
    reconstruction: Reconstruction,
    settings: PlacementSettings,
    min_range: dict[str, float],
    scale: float = 1.0,
    observed: dict[str, NDArray[np.bool_]] | None = None,
    not_solid: Sequence[str] = (),
) -> Placement:
    """Link frames for a reconstruction.

    Args:
        reconstruction: two parts and their joint.
        settings: which way is up, where zero is.
        min_range: joint type to the smallest range, rad or m, that counts as motion.
        scale: the reconstruction's lengths over those of its video: tolerances grow with them.
        observed: (F,) of each part, which of its triangles were seen; None is all. Others do not end the joint's range.
        not_solid: parts that are no solids: nothing is carved.

    The URDF joint has the range of `joint_range` and its zero at the end, or state, that `zero_state` chooses. Parts
    that are in each other by more than the tolerance within the range are carved where both are closed: what collides,
    not what is looked at. Raises FreeArtError on an empty part, when the joint was not seen to move, or on `gravity` of
    a reference part that did not stand still.
    """
    articulation = reconstruction.articulation
    joint = articulation.joint
    for name in PARTS:
        if articulation.part(name).empty or not articulation.part(name).areas().sum() > 0:
            what = "is an empty mesh" if articulation.part(name).empty else "has no triangle of any area"
            raise FreeArtError(f"{name} part of joint '{joint.name}' {what}: nothing to export")
    tolerance = settings.tolerance_m * scale
    overlap = Overlap(articulation)
    touching = overlap if observed is None else Overlap(articulation, observed)
    found = joint_range(reconstruction, touching, tolerance)
    if found.high - found.low < min_range[joint.type]:
        raise FreeArtError(
            f"joint '{joint.name}' was seen to move by {found.high - found.low:.3g} {joint.state_unit}, expected at "
            f"least {min_range[joint.type]:g}: its limits cannot be told"
        )
    zero, said_zero = zero_state(articulation, found, settings.zero)
    apart, said_penetration = _apart(articulation, found, overlap, tolerance, settings.carve, not_solid)
    up, carrier, said_up = _up(reconstruction, settings, found, zero)
    root = "moving" if carrier == "moving" else "reference"
    T_canonical_root = _standing(articulation, carrier, up, zero)
    T_root_canonical = se3.inverse(T_canonical_root)
    Ts = {"reference": T_root_canonical, "moving": T_root_canonical @ joint.transform(zero)}  # at joint position zero
    parts = {name: articulation.part(name).moved(Ts[name]) for name in PARTS}
    child = "reference" if root == "moving" else "moving"
    in_root = joint.moved(T_root_canonical)
    pivot = box_centre(parts[child])
    if joint.type == "revolute":  # the point of the axis nearest to the part: a reconstructed pivot may be far away
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
        {name: apart.part(name).moved(frames[name] @ Ts[name]) for name in PARTS},
        {
            "up": said_up,
            "limits": {"lower": found.low_by, "upper": found.high_by},
            "zero": {"asked": settings.zero, "end": said_zero},
            "penetration": said_penetration,
        },
    )


def _apart(
    parts: Articulation, found: JointRange, overlap: Overlap, tolerance: float, carve: bool, not_solid: Sequence[str]
) -> tuple[Articulation, dict[str, Any]]:
    """What collides: the parts no deeper in each other than `tolerance` in the range, where that can be; what was done.

    The meshes that are looked at stay: their triangles wear a texture, and what they hide in each other is not seen.
    """
    states = np.linspace(found.low, found.high, STATES)
    before = float(overlap.deepest(states).max())
    said: dict[str, Any] = {"deepest_m": before, "deepest_visual_m": before, "tolerance_m": tolerance, "carved": None}
    if before <= tolerance or not carve:
        return parts, said
    if not_solid:
        return parts, said | {"not_carved_because": f"the {not_solid[0]} part is no solid"}
    cut = carved(parts, found.low, found.high, tolerance, overlap)
    if isinstance(cut, str):
        return parts, said | {"not_carved_because": cut}
    reference, moving = (cut.mesh, cut.other) if cut.name == "reference" else (cut.other, cut.mesh)
    parts = replace(parts, reference=reference, moving=moving)
    after = float(Overlap(parts).deepest(states).max())
    return parts, said | {"deepest_m": after, "carved": cut.name, "carved_m3": cut.volume}


def _up(
    answer: Reconstruction, settings: PlacementSettings, found: JointRange, zero: float
) -> tuple[NDArray[np.float64], str, dict[str, Any]]:
    """(3,) up in the canonical frame, the part that then carries, and how up was found."""
    parts = answer.articulation
    if settings.up is not None:
        up = _unit(settings.up, "up")
        return up, carrier_of(parts, zero, up), _said("given", up)
    first = _first(answer)
    R_canonical_camera = answer.Ts_camera_reference[first, :3, :3].T
    if settings.gravity is not None:
        _check_still(answer)
        up = -R_canonical_camera @ _unit(settings.gravity, "gravity")
        return up, carrier_of(parts, zero, up), _said("gravity", up)
    camera_up = R_canonical_camera @ np.array([0.0, -1.0, 0.0])
    poses = resting_poses(parts, found.low, found.high, zero)
    best = upright(poses, camera_up)
    if best is None:
        rest = settled(parts, zero, camera_up)  # it lies as it falls, though the joint may then not be free
        up, how = (camera_up, "first frame's camera") if rest is None else (rest, "rest from the first frame's camera")
        return up, carrier_of(parts, zero, up), _said(how, up)
    pose, share = best
    rest = settled(parts, zero, pose.up)
    up = pose.up if rest is None or rest @ pose.up < np.cos(FLAT) else rest
    return (
        up,
        pose.carrier,
        _said("resting pose", up)
        | {
            "share": share,
            "tipping_rad": pose.tipping,
            "tipping_worst_rad": pose.worst,
            "carried_by": pose.carrier,
        },
    )


def _said(how: str, up: NDArray[np.float64]) -> dict[str, Any]:
    return {"axis": "z", "how": how, "direction_canonical": [float(x) for x in up]}


def _first(answer: Reconstruction) -> int:
    """The frame by whose camera directions are told: the anchor, or the first in which the reference part was seen."""
    seen = answer.seen[:, 0]
    return answer.anchor if answer.anchor or seen[0] or not seen.any() else int(np.argmax(seen))


def _check_still(answer: Reconstruction) -> None:
    """FreeArtError when the reference part moved before the camera by more than `STILL`."""
    corners = answer.articulation.reference.vertices
    box = np.stack(np.meshgrid(*np.stack([corners.min(0), corners.max(0)], -1), indexing="ij"), -1).reshape(-1, 3)
    Ts = answer.Ts_camera_reference[answer.seen[:, 0]] if answer.seen[:, 0].any() else answer.Ts_camera_reference
    there = se3.transform(Ts, np.broadcast_to(box, (len(Ts), 8, 3)))
    moved = float(np.linalg.norm(there - there[:1], axis=-1).max())
    most = STILL * bounding_diagonal(answer.articulation.reference, answer.articulation.moving)
    if moved > most:
        raise FreeArtError(
            f"gravity: the reference part moved before the camera by {1000 * moved:.3g} mm, expected that it stood "
            f"still (at most {1000 * most:.3g} mm); give up instead"
        )


def _standing(parts: Articulation, carrier: str, up: NDArray[np.float64], zero: float) -> Array:
    """(4, 4) canonical from root link: z up, at state `zero` on z = 0 and above it the middle of what it stands on."""
    R = _rotation_with_z(up)
    posed = dict(zip(PARTS, parts.posed(np.eye(4), zero), strict=True))
    corners = {name: mesh.vertices[np.unique(mesh.faces)] @ R for name, mesh in posed.items()}
    level = min(points[:, 2].min() for points in corners.values())
    near = level + TOUCHING * bounding_diagonal(parts.reference, parts.moving)
    standing = np.concatenate([points for name, points in corners.items() if carrier in (name, "both")])
    base = standing[standing[:, 2] < near]
    base = base if len(base) else standing
    x, y, _ = 0.5 * (base.min(0) + base.max(0))
    return se3.pose(R, R @ np.array([x, y, level]))


def _unit(direction: Direction, name: str) -> NDArray[np.float64]:
    """(3,) of length one."""
    d = np.asarray(direction, float)
    if d.shape != (3,) or not np.isfinite(d).all() or not np.linalg.norm(d) > 0:
        raise FreeArtError(f"{name} is {direction}, expected three finite numbers that are not all zero")
    return d / np.linalg.norm(d)


def _rotation_with_z(z: NDArray[np.float64]) -> Array:
    """(3, 3) with columns x, y, z, z the unit vector given and x as near to the canonical x axis as it can be."""
    first = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[2]
    x = first - z * (z @ first)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], -1)
