"""The ends of a joint's range: what was seen, what prediction says of hidden frames, and where the parts touch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from export.penetration import Overlap
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.reconstruction import Reconstruction

End = Literal["seen", "hidden", "contact"]
"""What explains an end: a frame that was measured, a prediction for one in which a part was hidden, or contact."""
Zero = Literal["first", "closed", "lower", "upper"]
ZEROS: tuple[str, ...] = get_args(Zero)
TOLERANCE = 5e-4
"""Metres by which parts may be in each other, and by which more than before they touch: what we ask of an asset."""
SIGMAS = 2.0
"""Standard deviations that a state is doubted by: 95 %."""
STATES = 31
"""States at which parts are compared over a range."""
STEPS = 8
"""States between a range's inside and its outermost end at which contact is looked for, before halving."""
ALIKE = 0.01
"""Part of itself by which the space that two parts fill has to be less at one end: nearer, they are alike."""


@dataclass(frozen=True)
class JointRange:
    """The ends of the range in canonical states, rad or m, and why they are there."""

    low: float
    high: float
    low_by: End
    high_by: End


def seen_end(states: NDArray[np.float64], stds: NDArray[np.float64]) -> tuple[float, float]:
    """The greatest of states (n,) and its standard deviation, one that may be less by its doubt left out.

    It is the state of the frame that is surely furthest out, argmax(q - SIGMAS std): any other lies within it by its
    own doubt. On ten reconstructions the plain greatest was as near to the true ends, but takes one wild frame for an
    end.
    """
    best = int(np.argmax(states - SIGMAS * stds))
    return float(states[best]), float(stds[best])


def joint_range(answer: Reconstruction, overlap: Overlap | None, tolerance: float = TOLERANCE) -> JointRange:
    """The range of a reconstruction's joint.

    A frame counts by its state and doubt; its end is that of `seen_end`. Frames without a known doubt, because a part
    was hidden, count as predicted. An end is moved to where the parts touch, if that is within the doubt of a seen end
    or before a hidden one: to the state where a point of one gets `tolerance`, metres, deeper into the other than it is
    anywhere within the range that was seen beyond doubt. That is no absolute depth: reconstructed parts overlap about
    their hinge, or are solid where nobody looked, and what was seen to happen was possible.

    Args:
        answer: two parts, their joint and states.
        overlap: of the parts in the canonical frame; None looks for no contact.
        tolerance: metres.
    """
    states = answer.states
    stds = np.where(answer.seen.all(axis=1), 0.0, np.nan) if answer.state_std is None else answer.state_std
    known = np.isfinite(stds)
    if not known.any():
        known, stds = np.ones(len(states), bool), np.zeros(len(states))
    high, high_std = seen_end(states[known], stds[known])
    low, low_std = seen_end(-states[known], stds[known])
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
    usual = np.zeros(len(overlap.speeds))
    for state in np.linspace(inner[-1], inner[1], STATES):
        usual = np.maximum(usual, overlap.depths(float(state)))
    for way, seen in ((-1, low), (1, high)):
        outermost = way * max(way * ends[way], way * seen + doubt[way])
        contact = _contact(overlap, usual, inner[way], outermost, tolerance)
        if contact is not None:
            ends[way], by[way] = contact, "contact"
    return JointRange(ends[-1], ends[1], by[-1], by[1])


def _contact(overlap: Overlap, usual: NDArray[np.float64], start: float, stop: float, tolerance: float) -> float | None:
    """The first state from `start` to `stop` where a point is `tolerance` deeper than `usual` (n,), or None."""

    def free(state: float) -> bool:
        return bool((overlap.depths(state) - usual).max(initial=0.0) <= tolerance)

    inside = start
    for state in np.linspace(start, stop, STEPS + 1)[1:]:
        if not free(float(state)):
            outside = float(state)
            for _ in range(8):
                middle = 0.5 * (inside + outside)
                inside, outside = (middle, outside) if free(middle) else (inside, middle)
            return inside
        inside = float(state)
    return None


def zero_state(parts: Articulation, found: JointRange, zero: Zero) -> tuple[float, str]:
    """The canonical state that becomes the URDF's zero, within the range, and the end that it is.

    'closed' is the end where both parts fill the least space: the lesser volume of the convex hull of both. Ends alike
    within `ALIKE`, as of what turns all the way round, are none of them closed: then it is the one nearer to state zero
    (ours: the first frame's), or the lower.
    """
    if zero == "first":
        return float(np.clip(0.0, found.low, found.high)), "first"
    if zero != "closed":
        return (found.low, "lower") if zero == "lower" else (found.high, "upper")
    low, high = (_space(parts, state) for state in (found.low, found.high))
    if abs(low - high) <= ALIKE * max(low, high):
        lower = abs(found.low) <= abs(found.high)
        return (found.low, "lower, as the ends are alike") if lower else (found.high, "upper, as the ends are alike")
    return (found.low, "lower") if low < high else (found.high, "upper")


def _space(parts: Articulation, state: float) -> float:
    """m^3, the convex hull of both parts at a joint state; 0 when they are flat."""
    moved = se3.transform(parts.joint.transform(state), parts.moving.vertices[np.unique(parts.moving.faces)])
    points = np.concatenate([parts.reference.vertices[np.unique(parts.reference.faces)], moved])
    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0
