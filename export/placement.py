"""Where the links of an asset stand: from a reconstruction's canonical frame to link frames that people can use."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array


@dataclass(frozen=True)
class Placement:
    """The two link frames of an asset and the joint between them.

    The root link's origin is the middle of the reference part's box, so that single precision suffices, with z up. The
    moving link's axes are parallel to it at joint position zero, its origin at the pivot.
    """

    T_canonical_reference: Array
    """(4, 4) canonical frame from the reference link's frame."""
    joint: Joint
    """In the reference link's frame, its limits those of the URDF joint."""
    state_zero: float
    """URDF joint position at canonical state zero, rad or m."""
    reference: Mesh
    """Reference part in its link's frame."""
    moving: Mesh
    """Moving part in its link's frame."""


def placed(
    reconstruction: Reconstruction, up: tuple[float, float, float], margin: float, min_range: dict[str, float]
) -> Placement:
    """Link frames for a reconstruction.

    Args:
        reconstruction: two parts and their joint.
        up: direction in the canonical frame that becomes the links' z axis.
        margin: fraction of the observed range by which each limit lies beyond it.
        min_range: joint type to the smallest observed range, rad or m, that counts as motion.

    The URDF joint's zero is canonical state zero, or the observed state nearest to it when the joint was never there:
    so zero lies within limits that come from observation alone. Raises FreeArtError on an empty part, or when the joint
    was not seen to move.
    """
    articulation = reconstruction.articulation
    joint = articulation.joint
    for name in ("reference", "moving"):
        if articulation.part(name).empty:
            raise FreeArtError(f"{name} part of joint '{joint.name}' is an empty mesh: nothing to export")
    low, high = observed_range(reconstruction)
    if high - low < min_range[joint.type]:
        raise FreeArtError(
            f"joint '{joint.name}' was seen to move by {high - low:.3g} {joint.state_unit}, expected at "
            f"least {min_range[joint.type]:g}: its limits cannot be told"
        )
    nearest = float(np.clip(0.0, low, high))
    beyond = margin * (high - low)
    T_canonical_reference = se3.pose(_rotation_with_z(up), _middle(articulation.reference))
    T_reference_canonical = se3.inverse(T_canonical_reference)
    moving = articulation.moving.moved(T_reference_canonical @ joint.transform(nearest))
    in_link = joint.moved(T_reference_canonical)
    pivot = _middle(moving)
    if joint.type == "revolute":  # the point of the axis nearest to the part: a reconstructed pivot may be far away
        pivot = in_link.pivot + in_link.axis * (in_link.axis @ (pivot - in_link.pivot))
    return Placement(
        T_canonical_reference,
        replace(in_link, pivot=pivot, lower=low - beyond - nearest, upper=high + beyond - nearest),
        0.0 - nearest,
        articulation.reference.moved(T_reference_canonical),
        moving.moved(se3.pose(np.eye(3), -pivot)),
    )


def observed_range(reconstruction: Reconstruction) -> tuple[float, float]:
    """Least and greatest state, rad or m, over the frames in which both parts were seen (over all when none was)."""
    seen = reconstruction.seen.all(axis=1)
    states = reconstruction.states[seen] if seen.any() else reconstruction.states
    return float(states.min()), float(states.max())


def _middle(mesh: Mesh) -> NDArray[np.float64]:
    used = mesh.vertices[np.unique(mesh.faces)]
    return 0.5 * (used.min(0) + used.max(0))


def _rotation_with_z(up: tuple[float, float, float]) -> Array:
    """(3, 3) with columns x, y, z, z along `up` and x as near to the canonical x axis as it can be."""
    z = np.asarray(up, float)
    if z.shape != (3,) or not np.isfinite(z).all() or not np.linalg.norm(z) > 0:
        raise FreeArtError(f"up is {up}, expected three finite numbers that are not all zero")
    z = z / np.linalg.norm(z)
    first = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[2]
    x = first - z * (z @ first)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], -1)
