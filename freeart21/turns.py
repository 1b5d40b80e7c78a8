"""Angles that a sensor counts within one turn, made whole."""

from __future__ import annotations

import numpy as np

from freeart21.se3 import Array

_LEAP = 1.5 * np.pi
"""rad from one reading to the next that no joint goes, but a turn's end is."""
_WITHIN = 1.02
"""Turns that the readings of one turn span at most, with their noise."""


def unwrapped(q: Array, leap: float = _LEAP) -> tuple[Array, int]:
    """(n,) positions, rad, without leaps of a whole turn from one reading to the next, and how many there were."""
    known = np.isfinite(q)
    straight = q.copy()
    straight[known] = np.unwrap(q[known], discont=leap)
    return straight, int((np.abs(np.diff(straight[known] - q[known])) > 1.0).sum())


def near(command: Array, q: Array, leap: float = _LEAP) -> tuple[Array, int]:
    """(n,) commands, rad, without leaps of a whole turn, on the positions' turn, and how many turns were undone."""
    straight, jumps = unwrapped(command, leap)
    apart = float(np.nanmedian(q - straight))
    turns = round(apart / (2 * np.pi)) if np.isfinite(apart) else 0
    return straight + 2 * np.pi * turns, jumps + abs(turns)


def is_wrapped(q: Array) -> bool:
    """Whether readings (n,), rad, are clearly of one turn: all within it, with leaps from one end of it to the other,
    next to which they move a tenth of a turn at most."""
    x = q[np.isfinite(q)]
    steps = np.diff(x)
    leaps = np.abs(steps) > _LEAP
    if not leaps.any() or np.ptp(x) > _WITHIN * 2 * np.pi:
        return False
    rest = np.abs(np.abs(steps[leaps]) - 2 * np.pi)
    return bool(rest.max() < 0.2 * np.pi and np.abs(steps[~leaps]).max(initial=0.0) < 0.2 * np.pi)
