"""Submovements and rests of a hand-held object and its joint, and how smooth their motion is.

A hand moves in submovements whose speed rises and falls (Flash and Hogan 1985). Between two of them the speed has a
dip; where it falls to rest between two sweeps, the object is held or regrasped.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array

TURN_DEGREES = 0.3
"""An object that turns less than this from frame to frame, and shifts less, is at rest. Motion capture noise at rest is
.007 to .028 (2nd percentile of 32 takes of ARCTIC), that of an object held still in a hand .02 to .08 (median)."""
SHIFT = 0.003
"""The same limit for its centre, as a share of the object's diagonal."""
JOINT_SHARE = 0.002
"""A joint that moves less than this share of its range from frame to frame is at rest."""

_DIP = 0.5
"""Two submovements are separate where the speed falls below this share of the lower of their peaks. Not measured."""
SWEEP_DEGREES = 5.0
"""A submovement that turns the object this far is a sweep; smaller ones are corrections. Not measured."""
JOINT_SUBMOVEMENT = 0.05
"""Least share of the range that a submovement of the joint covers. Not measured."""
_HOLD_S = 0.1  # three frames: a shorter rest is the dip between two submovements
_REGRASP_S = 1.0  # a longer rest is a hold


@dataclass(frozen=True)
class Movement:
    """How object and joint moved over n frames."""

    turns: Array
    """(n - 1, 3) rotation of the object from frame to frame, axis times degrees, camera axes."""
    shifts: Array
    """(n - 1,) shift of its centre from frame to frame, in diagonals of the object."""
    opening: Array
    """(n,) joint state as a share of its range."""
    fps: float
    """Frames a second."""

    @classmethod
    def of(cls, Rs: Array, places: Array, opening: Array, fps: float) -> Movement:
        """From rotations (n, 3, 3) and positions (n, 3), in diagonals, both in the camera's axes."""
        turns = np.degrees(se3.log_so3(Rs[1:] @ np.swapaxes(Rs[:-1], 1, 2)))
        return cls(turns, np.linalg.norm(np.diff(places, axis=0), axis=1), np.asarray(opening, float), fps)

    @cached_property
    def degrees(self) -> Array:
        """(n - 1,) rotation angle from frame to frame, degrees."""
        return np.asarray(np.linalg.norm(self.turns, axis=1))

    @cached_property
    def pose_moves(self) -> NDArray[np.bool_]:
        """(n - 1,) whether the object turns or shifts."""
        return np.maximum(self.degrees / TURN_DEGREES, self.shifts / SHIFT) >= 1

    @cached_property
    def joint_moves(self) -> NDArray[np.bool_]:
        """(n - 1,) whether the joint moves."""
        return np.abs(np.diff(self.opening)) >= JOINT_SHARE

    @cached_property
    def sweeps(self) -> NDArray[np.int64]:
        """(k, 2) first frame and end of every submovement that turns the object by `SWEEP_DEGREES` or more."""
        found = find_submovements(self.degrees, TURN_DEGREES)
        return found[self._along(found) >= SWEEP_DEGREES]

    @cached_property
    def sweep_degrees(self) -> Array:
        """(k,) how far each sweep turns."""
        return self._along(self.sweeps)

    @cached_property
    def joint_submovements(self) -> NDArray[np.int64]:
        """(k, 2) first frame and end of every submovement of the joint, in one direction, of `JOINT_SUBMOVEMENT` or
        more."""
        step = np.diff(self.opening)
        both = [find_submovements(np.maximum(sign * step, 0.0), JOINT_SHARE) for sign in (1, -1)]
        found = np.concatenate(both)
        found = found[np.argsort(found[:, 0], kind="stable")]
        return found[np.abs(self.opening[found[:, 1]] - self.opening[found[:, 0]]) >= JOINT_SUBMOVEMENT]

    @cached_property
    def joint_ways(self) -> Array:
        """(k,) share of the range that each submovement of the joint covers, negative where it closes."""
        return self.opening[self.joint_submovements[:, 1]] - self.opening[self.joint_submovements[:, 0]]

    @property
    def holds_s(self) -> Array:
        """(k,) seconds of every rest of the object."""
        return self._rests(~self.pose_moves)

    @property
    def joint_holds_s(self) -> Array:
        """(k,) seconds of every rest of the joint."""
        return self._rests(~self.joint_moves)

    @property
    def regrasps_a_minute(self) -> float:
        """Rests between two sweeps of at most a second, a minute."""
        starts, ends = self.sweeps[1:, 0], self.sweeps[:-1, 1]
        if not len(starts):
            return 0.0
        short = starts - ends <= _REGRASP_S * self.fps
        low = [bool((self.degrees[a - 1 : b + 1] < TURN_DEGREES).any()) for a, b in zip(ends, starts, strict=True)]
        return self._a_minute(int(np.sum(short & low)))

    @property
    def sweeps_a_minute(self) -> float:
        """Sweeps a minute."""
        return self._a_minute(len(self.sweeps))

    @property
    def joint_submovements_a_minute(self) -> float:
        """Submovements of the joint a minute."""
        return self._a_minute(len(self.joint_submovements))

    @property
    def reversals_a_minute(self) -> float:
        """Changes of direction between submovements of the joint, a minute."""
        return self._a_minute(int(np.sum(np.diff(np.sign(self.joint_ways)) != 0)))

    @property
    def together(self) -> float:
        """Share of time in which the object moves, while the joint moves, over that of all frames; 1 when
        independent."""
        pose, joint = self.pose_moves, self.joint_moves
        return float(pose[joint].mean() / pose.mean()) if joint.any() and pose.any() else float("nan")

    @property
    def smoothness(self) -> float:
        """Spectral arc length of the object's rotation speed: nearer to zero is smoother."""
        return spectral_arc_length(self.degrees, self.fps)

    def _along(self, spans: NDArray[np.int64]) -> Array:
        passed = np.concatenate([[0.0], np.cumsum(self.degrees)])
        return np.asarray(passed[spans[:, 1]] - passed[spans[:, 0]])

    def _rests(self, flags: NDArray[np.bool_]) -> Array:
        lengths = np.diff(spans_of(flags), axis=1)[:, 0] / self.fps
        return np.asarray(lengths[lengths >= _HOLD_S])

    def _a_minute(self, count: int) -> float:
        return 60.0 * count * self.fps / max(len(self.degrees), 1)


def spans_of(flags: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(k, 2) first index and end of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(flags, int), [0]])))
    return edges.reshape(-1, 2)


def find_submovements(speed: Array, rest: float) -> NDArray[np.int64]:
    """(k, 2) first frame and end of every submovement: where `speed` (n,) is `rest` or more, cut at the deepest
    dips."""
    found: list[tuple[int, int]] = []
    waiting = [(int(a), int(b)) for a, b in spans_of(speed >= rest)][::-1]
    while waiting:
        a, b = waiting.pop()
        part = speed[a:b]
        before, after = np.maximum.accumulate(part), np.maximum.accumulate(part[::-1])[::-1]
        depth = part / np.minimum(before, after)
        k = int(depth.argmin())
        if depth[k] < _DIP:
            waiting += [(a + k, b), (a, a + k)]
        else:
            found.append((a, b))
    return np.array(found, np.int64).reshape(-1, 2)


def spectral_arc_length(speed: Array, fps: float, highest_hz: float = 10.0, least: float = 0.05) -> float:
    """The spectral arc length of a speed (n,) (Balasubramanian, Melendez-Calderon, Roby-Brami and Burdet 2015).

    Minus the length of the magnitude spectrum, both axes scaled to 1, up to the last frequency (at most `highest_hz`)
    at which it reaches `least` of its maximum. Zero where nothing moves. Compare recordings of equal length only.
    """
    size = 1 << (int(np.ceil(np.log2(max(len(speed), 2)))) + 4)
    spectrum = np.abs(np.fft.rfft(speed, size))
    if spectrum[0] <= 0:
        return 0.0
    spectrum /= spectrum.max()
    within = np.fft.rfftfreq(size, 1 / fps) <= highest_hz
    last = int(np.flatnonzero(within & (spectrum >= least))[-1])
    if last == 0:
        return 0.0
    return -float(np.hypot(1.0 / last, np.diff(spectrum[: last + 1])).sum())
