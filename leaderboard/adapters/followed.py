"""Methods that follow rigid parts and name no joint: poses of two parts or more become two, and a joint is fitted.

The joint is ours (`fitting`), not the method's: every such answer says so in its notes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh, box_centre
from freeart21.se3 import Array
from leaderboard.adapters.fitting import fit_joint
from leaderboard.adapters.toolbox import Found, answered, joined, spread_poses, spread_states

FITTED = "the joint is not the method's: it was fitted to the poses of its parts by the import"
_SIZE_M = 0.1  # of a part of which no surface is known: errors of pose are weighed for a part as large


@dataclass(frozen=True)
class Followed:
    """One part that was followed."""

    Ts: Array
    """(m, 4, 4) camera from the part's own frame, in the frames that are answered."""
    mesh: Mesh | None
    """In the part's own frame."""
    weight: float
    """How much of the object it is, in any one unit: the largest part is the reference part."""


def found_of(
    parts: list[Followed], at: NDArray[np.int64], frames: int, notes: tuple[str, ...], first_is_reference: bool = False
) -> Found:
    """The answer that two or more followed parts make in the frames `at` (m,) of the video.

    The reference part is the heaviest, or the first; the moving part the one that moves most against it, and every
    other part belongs to the one of both against which it moves less.
    """
    order = sorted(range(len(parts)), key=lambda k: 0 if first_is_reference else -parts[k].weight)
    base = parts[order[0]]
    slips = [0.0 if part is base else _slip(base.Ts, part.Ts, _size(part)) for part in parts]
    moving = parts[int(np.argmax(slips))]
    if moving is base:
        raise FreeArtError("its parts do not move against each other: there is no joint to be fitted")
    sides: tuple[list[Followed], list[Followed]] = ([base], [moving])
    for part in parts:
        if part is not base and part is not moving:
            sides[_slip(moving.Ts, part.Ts, _size(part)) < _slip(base.Ts, part.Ts, _size(part))].append(part)
    motion = se3.inverse(base.Ts) @ moving.Ts
    centre = np.zeros(3) if moving.mesh is None else box_centre(moving.mesh)
    fit = fit_joint("joint", motion, centre, _size(moving))
    T_moving_own = se3.inverse(fit.T_reference_moving)
    reference = spread_poses(base.Ts, at, frames)
    carried = spread_poses(moving.Ts @ T_moving_own, at, frames)
    meshes = None
    if all(part.mesh is not None for part in parts):
        meshes = _whole(base, sides[0]), _whole(moving, sides[1]).moved(fit.T_reference_moving)
    seen, more = answered(at, frames)
    said = f"{FITTED} ({fit.joint.type}, {1000 * fit.residual:.2g} mm off in the median frame; the other type "
    said += f"{1000 * fit.other_residual:.2g} mm)" if np.isfinite(fit.other_residual) else "not looked for)"
    states = spread_states(fit.states, at, frames)
    return Found(fit.joint, states, (reference, carried), 0, None, None, meshes, seen, (said, *more, *notes))


def _size(part: Followed) -> float:
    return _SIZE_M if part.mesh is None else float(np.linalg.norm(np.ptp(part.mesh.vertices, axis=0)))


def _slip(Ts: Array, others: Array, size: float) -> float:
    """Metres by which a part of that size moves against a carrier: the 90th percentile over frames."""
    relative = se3.inverse(Ts) @ others
    still = relative[len(relative) // 2]
    turn = se3.rotation_angle(relative[:, :3, :3] @ still[:3, :3].T)
    return float(np.quantile(np.linalg.norm(relative[:, :3, 3] - still[:3, 3], axis=1) + 0.5 * size * turn, 0.9))


def _whole(carrier: Followed, parts: list[Followed]) -> Mesh:
    """The parts as one, in the carrier's frame, as they stand against it in the middle frame."""
    at = len(carrier.Ts) // 2
    placed = [p.mesh.moved(se3.inverse(carrier.Ts[at]) @ p.Ts[at]) for p in parts if p.mesh is not None]
    return joined(placed)
