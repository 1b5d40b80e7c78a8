"""Limits of a joint: observed states, predicted states of hidden frames, and contact between the parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from export.penetration import Overlap
from export.settings import TOLERANCE, Zero
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.reconstruction import Reconstruction

End = Literal["seen", "hidden", "contact"]
"""What determines a limit: an observed frame, a predicted state of a frame in which a part was hidden, or contact."""
SIGMAS = 2.0
"""Standard deviations of uncertainty of a state: 95 %."""
STATES = 31
"""States per range at which the parts are compared."""
CONTACT_STEPS = 8
"""States between the inside of the range and its outermost end that are searched for contact before bisection."""
VOLUME_MARGIN = 0.01
"""Relative difference between the hull volumes at both ends below which neither end counts as closed."""


@dataclass(frozen=True)
class JointRange:
    """Limits in canonical states, rad or m, and what determines them."""

    low: float
    high: float
    low_by: End
    high_by: End


def robust_maximum(states: NDArray[np.float64], stds: NDArray[np.float64]) -> tuple[float, float]:
    """The largest of states (n,) and its standard deviation: the frame argmax(q - SIGMAS std).

    Every larger state is within its own uncertainty of it. On ten reconstructions the plain maximum was as close to the
    true limits, but a single outlier moves it.
    """
    best = int(np.argmax(states - SIGMAS * stds))
    return float(states[best]), float(stds[best])


def estimate_joint_range(answer: Reconstruction, overlap: Overlap | None, tolerance: float = TOLERANCE) -> JointRange:
    """The limits of a reconstruction's joint.

    States are weighted by their uncertainty (`robust_maximum`). Frames without one, because a part was hidden, count as
    predicted. A limit moves to the state of contact when that lies within the uncertainty of an observed limit, or
    before a predicted one. Contact is the state where a point of one part gets `tolerance` deeper into the other than
    anywhere in the range that was certainly observed. An absolute depth would not do: reconstructed parts overlap near
    their hinge, or are solid where nobody looked.

    Args:
        answer: two parts, their joint and states.
        overlap: of the parts in the canonical frame; None skips contact.
        tolerance: m.
    """
    states = answer.states
    stds = np.where(answer.seen.all(axis=1), 0.0, np.nan) if answer.state_std is None else answer.state_std
    known = np.isfinite(stds)
    if not known.any():
        known, stds = np.ones(len(states), bool), np.zeros(len(states))
    high, high_std = robust_maximum(states[known], stds[known])
    low, low_std = robust_maximum(-states[known], stds[known])
    low = -low
    if low >= high:
        low, high = float(states[known].min()), float(states[known].max())
    least = float(states.min(where=~known, initial=low))
    most = float(states.max(where=~known, initial=high))
    by: dict[int, End] = {-1: "hidden" if least < low else "seen", 1: "hidden" if most > high else "seen"}
    ends = {-1: least, 1: most}
    if overlap is None or not high > low:
        return JointRange(ends[-1], ends[1], by[-1], by[1])
    doubt = {-1: SIGMAS * low_std, 1: SIGMAS * high_std}
    share = min(1.0, 0.25 * (high - low) / max(doubt[-1] + doubt[1], 1e-12))
    inner = {-1: low + share * doubt[-1], 1: high - share * doubt[1]}
    known_depth = np.zeros(len(overlap.speeds))
    for state in np.linspace(inner[-1], inner[1], STATES):
        known_depth = np.maximum(known_depth, overlap.depths(float(state)))
    for way, seen in ((-1, low), (1, high)):
        outermost = way * max(way * ends[way], way * seen + doubt[way])
        contact = _find_contact(overlap, known_depth, inner[way], outermost, tolerance)
        if contact is not None:
            ends[way], by[way] = contact, "contact"
    return JointRange(ends[-1], ends[1], by[-1], by[1])


def _find_contact(
    overlap: Overlap, known_depth: NDArray[np.float64], start: float, stop: float, tolerance: float
) -> float | None:
    """The first state from `start` to `stop` where a point is `tolerance` deeper than `known_depth` (n,), or None."""

    def free(state: float) -> bool:
        return bool((overlap.depths(state) - known_depth).max(initial=0.0) <= tolerance)

    inside = start
    for state in np.linspace(start, stop, CONTACT_STEPS + 1)[1:]:
        if not free(float(state)):
            outside = float(state)
            for _ in range(8):
                middle = 0.5 * (inside + outside)
                inside, outside = (middle, outside) if free(middle) else (inside, middle)
            return inside
        inside = float(state)
    return None


def choose_zero(parts: Articulation, found: JointRange, zero: Zero) -> tuple[float, str]:
    """The canonical state, within the range, that becomes zero of the URDF joint, and its name for asset.json.

    'closed' is the end at which the convex hull of both parts has the smaller volume. When the volumes differ by less
    than `VOLUME_MARGIN`, as for a wheel, it is the end nearer to state zero (ours: the first frame's), or the lower.
    """
    if zero == "first":
        return float(np.clip(0.0, found.low, found.high)), "first"
    if zero != "closed":
        return (found.low, "lower") if zero == "lower" else (found.high, "upper")
    low, high = (_hull_volume(parts, state) for state in (found.low, found.high))
    if abs(low - high) <= VOLUME_MARGIN * max(low, high):
        lower = abs(found.low) <= abs(found.high)
        return (
            (found.low, "lower, as both ends are similar") if lower else (found.high, "upper, as both ends are similar")
        )
    return (found.low, "lower") if low < high else (found.high, "upper")


def _hull_volume(parts: Articulation, state: float) -> float:
    """m^3 of the convex hull of both parts at a joint state; 0 when they are flat."""
    moved = se3.transform(parts.joint.transform(state), parts.moving.vertices[np.unique(parts.moving.faces)])
    points = np.concatenate([parts.reference.vertices[np.unique(parts.reference.faces)], moved])
    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0
