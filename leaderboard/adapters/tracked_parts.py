"""Results of methods that track two or more rigid parts without a joint: parts become two, and a joint is fitted.

The joint is ours (`fitting`), not the method's; a note says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh, box_centre, join_meshes
from freeart21.se3 import Array
from leaderboard.adapters.fitting import fit_joint
from leaderboard.adapters.layout import ImportedResult
from leaderboard.adapters.readers import frames_with_result, interpolate_states, nearest_poses

FITTED = "the joint is not the method's: it was fitted to the poses of its parts by the import"
_DEFAULT_SIZE = 0.1
"""Metres; size of a part without a surface, for weighing rotations against translations."""


@dataclass(frozen=True)
class TrackedPart:
    """One tracked part."""

    Ts: Array
    """(m, 4, 4) camera from the part's own frame, in the frames with a result."""
    mesh: Mesh | None
    """In the part's own frame."""
    weight: float
    """Relative size; the largest part is the reference part."""


def fit_tracked_parts(
    parts: list[TrackedPart],
    at: NDArray[np.int64],
    frames: int,
    notes: tuple[str, ...],
    first_is_reference: bool = False,
) -> ImportedResult:
    """The result of two or more tracked parts in the frames `at` (m,) of the video.

    The reference part is the heaviest, or the first. The moving part is the one that moves most relative to it. Any
    other part joins the one of the two relative to which it moves less.
    """
    order = sorted(range(len(parts)), key=lambda k: 0 if first_is_reference else -parts[k].weight)
    base = parts[order[0]]
    travels = [0.0 if part is base else _travel(base.Ts, part.Ts, _size(part)) for part in parts]
    moving = parts[int(np.argmax(travels))]
    if moving is base:
        raise FreeArtError("its parts do not move against each other: there is no joint to be fitted")
    sides: tuple[list[TrackedPart], list[TrackedPart]] = ([base], [moving])
    for part in parts:
        if part is not base and part is not moving:
            follows_moving = _travel(moving.Ts, part.Ts, _size(part)) < _travel(base.Ts, part.Ts, _size(part))
            sides[follows_moving].append(part)
    motion = se3.inverse(base.Ts) @ moving.Ts
    centre = np.zeros(3) if moving.mesh is None else box_centre(moving.mesh)
    fit = fit_joint("joint", motion, centre, _size(moving))
    reference = nearest_poses(base.Ts, at, frames)
    carried = nearest_poses(moving.Ts @ se3.inverse(fit.T_reference_moving), at, frames)
    meshes = None
    if all(part.mesh is not None for part in parts):
        meshes = _join_side(base, sides[0]), _join_side(moving, sides[1]).moved(fit.T_reference_moving)
    seen, more = frames_with_result(at, frames)
    note = f"{FITTED} ({fit.joint.type}, {1000 * fit.residual:.2g} mm off in the median frame; the other type "
    note += f"{1000 * fit.other_residual:.2g} mm)" if np.isfinite(fit.other_residual) else "not tried)"
    states = interpolate_states(fit.states, at, frames)
    notes = (note, *more, *notes)
    return ImportedResult(fit.joint, states, (reference, carried), meshes=meshes, seen=seen, notes=notes)


def _size(part: TrackedPart) -> float:
    return _DEFAULT_SIZE if part.mesh is None else float(np.linalg.norm(np.ptp(part.mesh.vertices, axis=0)))


def _travel(Ts: Array, others: Array, size: float) -> float:
    """Metres by which a part of `size` moves relative to a carrier: the 90th percentile over frames."""
    relative = se3.inverse(Ts) @ others
    still = relative[len(relative) // 2]
    turn = se3.rotation_angle(relative[:, :3, :3] @ still[:3, :3].T)
    return float(np.quantile(np.linalg.norm(relative[:, :3, 3] - still[:3, 3], axis=1) + 0.5 * size * turn, 0.9))


def _join_side(carrier: TrackedPart, parts: list[TrackedPart]) -> Mesh:
    """The meshes of `parts` as one, in the carrier's frame, placed as in the middle frame."""
    at = len(carrier.Ts) // 2
    return join_meshes([p.mesh.moved(se3.inverse(carrier.Ts[at]) @ p.Ts[at]) for p in parts if p.mesh is not None])
