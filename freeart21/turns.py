"""Angles that a sensor reports within one turn: detect and unwrap them."""

from __future__ import annotations

import numpy as np

from freeart21.se3 import Array

_JUMP = 1.5 * np.pi
"""rad between two readings: more than any joint moves, less than the jump at the end of a turn."""
_SPAN = 1.02
"""Largest range, in turns, of readings within one turn, with their noise."""


def unwrap_angles(q: Array, jump: float = _JUMP) -> tuple[Array, int]:
    """(n,) positions, rad, NaN allowed, without jumps of a whole turn between readings; and the number of jumps."""
    known = np.isfinite(q)
    straight = q.copy()
    straight[known] = np.unwrap(q[known], discont=jump)
    return straight, int((np.abs(np.diff(straight[known] - q[known])) > 1.0).sum())


def unwrap_command(command: Array, q: Array) -> tuple[Array, int]:
    """(n,) commands, rad, without jumps, on the turn of the positions `q` (n,); and the number of turns removed."""
    straight, jumps = unwrap_angles(command, _JUMP)
    offset = float(np.nanmedian(q - straight))
    turns = round(offset / (2 * np.pi)) if np.isfinite(offset) else 0
    return straight + 2 * np.pi * turns, jumps + abs(turns)


def is_wrapped(q: Array) -> bool:
    """Whether readings (n,), rad, are clearly within one turn.

    Their range is one turn at most, they jump from one end of it to the other, and move a tenth of a turn at most
    otherwise.
    """
    x = q[np.isfinite(q)]
    steps = np.diff(x)
    jumps = np.abs(steps) > _JUMP
    if not jumps.any() or np.ptp(x) > _SPAN * 2 * np.pi:
        return False
    rest = np.abs(np.abs(steps[jumps]) - 2 * np.pi)
    return bool(rest.max() < 0.2 * np.pi and np.abs(steps[~jumps]).max(initial=0.0) < 0.2 * np.pi)
