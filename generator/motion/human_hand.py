"""Draws how a person's hand moves an object and its joint: submovements and rests, with measured distributions.

The numbers are fitted to the takes of subjects s1 and s4 of ARCTIC's motion capture (13 takes of people who use a
laptop, a mixer, a ketchup bottle; 30 Hz); the takes of subject s2 were not used. Every submovement has minimum jerk
(Flash and Hogan 1985); overlapping submovements add.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeart21.se3 import Array
from generator.motion.timing import Hold, JointCourse, ease


@dataclass(frozen=True)
class Law:
    """ln y = at + slope * (ln x - about) + a normal error of standard deviation `spread`."""

    at: float
    slope: float
    about: float
    spread: float

    def sample(self, x: float, rng: np.random.Generator) -> float:
        """Draw y for x."""
        return float(np.exp(self.at + self.slope * (np.log(x) - self.about) + self.spread * rng.normal()))


SWEEP_DEGREES = (3.27, 0.50, 0.84)
"""ln of a sweep's rotation, degrees: mean, standard deviation between takes, and within a take."""
SWEEP_SECONDS = Law(-0.81, 0.39, 3.39, 0.41)
"""Duration of a sweep as a function of its degrees."""
SWEEP_WAY = Law(-1.45, 0.90, 3.39, 0.59)
"""Translation of a sweep, in diagonals of the object, as a function of its degrees."""
AT_ONCE = 0.86
"""Share of sweeps that start within a tenth of a second after the one before."""
PAUSE_SECONDS = (-0.57, 1.18)
"""ln of the other pauses: mean, standard deviation."""
ON, BACK = 0.25, 0.41
"""Shares of sweeps with an axis within 60 degrees of the axis of the one before, and of its opposite."""
OVERLAP = (0.12, 0.34)
"""Overlap of successive sweeps, as a share of their duration. Two of equal speed with perpendicular axes then have a
minimum of .07 to .45 of their peaks between them (measured, 5 to 95 %: .06 to .48)."""
TO_END = (0.52, 0.83)
"""Shares of joint submovements that end within a tenth of the range from its end: of those with at least four fifths of
the range before them, and of the others."""
PARTWAY = (0.07, 0.88)
"""Share of the remaining range that the other joint submovements cover (5 to 95 %)."""
JOINT_SECONDS = Law(-0.89, 0.64, -0.74, 0.44)
"""Duration of a joint submovement as a function of the share of the range that it covers."""
JOINT_AT_ONCE = 0.43
"""Share of joint submovements that start within a tenth of a second after the one before."""
JOINT_REST_SECONDS = (-0.01, 1.24)
"""ln of the joint's other rests: mean, standard deviation."""
TURNED_ROUND = 0.76
"""Share of joint submovements that reverse the one before."""
LAID = 0.23
"""Share of rests of a second or more in which the object is as still as on a table: less than .025 degrees a frame.
Noise of the motion capture makes .02. An object held still in the hand has .040 (median)."""

_LEAST = 0.05  # of the range: smaller submovements were not measured
_LARGEST = 170.0  # degrees: a larger rotation has no unique axis; 1 % of those measured are larger
FASTEST = 25.0
"""Largest rotation, degrees a frame at 30 a second; the largest measured is 24.8."""
_QUICKEST = 0.12  # s: four samples of the motion capture; shorter submovements cannot be separated from noise
_LATEST_START, _LONGEST_MOVE = 0.25, 0.6  # shares of a short video: something moves in it, however few its frames
_LONGEST = 5.0  # s: the longest rest measured is 4.7


@dataclass(frozen=True)
class Sweep:
    """A submovement of the hand."""

    start: float
    length: float
    """Frames, from rest to rest."""
    degrees: float
    way: float
    """Translation, diagonals of the object."""

    def course(self, frames: int) -> Array:
        """(frames,) progress: 0 before the sweep, 1 after it."""
        return ease((np.arange(frames, dtype=float) - self.start) / self.length)


@dataclass(frozen=True)
class Hand:
    """The motion of a hand with an object, without directions."""

    sweeps: tuple[Sweep, ...]
    resting_on_table: tuple[tuple[float, float], ...]
    """First and last frame of every rest on the table."""


def draw_hand(frames: int, fps: float, rng: np.random.Generator) -> Hand:
    """Draw sweeps and rests of one person over a video."""
    sweeps: list[Sweep] = []
    resting_on_table: list[tuple[float, float]] = []
    mean, between, within = SWEEP_DEGREES
    mean += between * float(np.clip(rng.normal(), -2, 2))
    begins = 0.0 if rng.uniform() < AT_ONCE else _rest(PAUSE_SECONDS, rng) * rng.uniform() * fps
    at = min(max(begins, 1.0), _LATEST_START * frames)
    while at < frames:
        degrees = min(float(np.exp(mean + within * rng.normal())), _LARGEST)
        overlap = rng.uniform(*OVERLAP)
        seconds = max(SWEEP_SECONDS.sample(degrees, rng), _QUICKEST) / (1 - overlap)  # measured between minima
        seconds = max(seconds, 1.875 * degrees / (FASTEST * 30))  # peak speed of minimum jerk
        sweeps.append(Sweep(at, seconds * fps, degrees, SWEEP_WAY.sample(degrees, rng)))
        if rng.uniform() < AT_ONCE:
            at += (1 - overlap) * seconds * fps
            continue
        rest = _rest(PAUSE_SECONDS, rng)
        first = at + seconds * fps
        at = first + rest * fps
        if rest >= 1 and rng.uniform() < LAID:
            resting_on_table.append((first, at))
    return Hand(tuple(sweeps), tuple(resting_on_table))


def draw_joint_course(frames: int, fps: float, rng: np.random.Generator, hold: Hold | None = None) -> JointCourse:
    """Draw the joint's submovements: nearly closed at first, then fully open, then random.

    A `hold` is inserted after the first submovement, within the first half of the remaining time.
    """
    share, turn = float(rng.uniform(0.0, 0.25)), 1.0
    at = min(float(rng.uniform(0.2, 1.0)) * fps, _LATEST_START * frames)
    wait = 0.0 if hold is None else rng.uniform(0.1, 0.5) * (1 - hold.length) * frames
    goals: list[float] = [share]
    moves: list[tuple[float, float]] = []
    held: tuple[float, float] | None = None
    while at < frames:
        if hold is not None and held is None and moves and at >= wait:
            goal = hold.share
        elif not moves:
            goal = 1.0
        else:
            turn = -turn if rng.uniform() < TURNED_ROUND else turn
            turn = turn if (1 - share if turn > 0 else share) > _LEAST else -turn
            room = 1 - share if turn > 0 else share
            to_end = rng.uniform() < TO_END[int(room < 0.8)]
            goal = share + turn * room * (1.0 if to_end else float(rng.uniform(*PARTWAY)))
        passed = abs(goal - share)
        length = max(JOINT_SECONDS.sample(max(passed, _LEAST), rng), 2 * _QUICKEST) * fps
        length = min(length, _LONGEST_MOVE * frames)
        moves.append((at, at + length))
        at += length
        if hold is not None and held is None and goal == hold.share:
            held = at, min(at + hold.length * frames, frames - 1.0)
            at = held[1]
        elif rng.uniform() < JOINT_AT_ONCE:
            at += rng.uniform(0.0, 0.1) * fps
        else:
            rest = _rest(JOINT_REST_SECONDS, rng) * fps
            at = min(at + rest, max(at, wait)) if hold is not None and held is None else at + rest
        turn = float(np.sign(goal - share)) or turn
        share = goal
        goals.append(goal)
    t, shares = np.arange(frames, dtype=float), np.full(frames, goals[0])
    for (a, b), before, after in zip(moves, goals[:-1], goals[1:], strict=True):
        shares += (after - before) * ease((t - a) / (b - a))
    ends = [0.0, *(b for _, b in moves)]
    starts = [*(a for a, _ in moves), frames - 1.0]
    rests = tuple((a, b) for a, b in zip(ends, starts, strict=True) if b > a)
    return JointCourse(np.clip(shares, 0.0, 1.0), tuple(moves), rests, held)


def _rest(law: tuple[float, float], rng: np.random.Generator) -> float:
    """Draw the duration of a rest, s."""
    return min(float(np.exp(law[0] + law[1] * rng.normal())), _LONGEST)
