"""How a person's hand moves an object and its joint: strokes and rests, drawn as they were measured.

The numbers are those of the takes of subjects s1 and s4 of ARCTIC's motion capture (13 takes of people who use a
laptop, a mixer, a ketchup bottle; 30 Hz), as `python -m benchmarks.motion_styles --fitted` prints them; no take of
subject s2 was looked at for them. Every stroke is a minimum-jerk one (Flash and Hogan 1985); strokes that overlap add.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeart21.se3 import Array
from generator.motion.timing import Hold, JointCourse, ease


@dataclass(frozen=True)
class Law:
    """ln y = at + slope * (ln x - about), and a normal error of standard deviation `spread`."""

    at: float
    slope: float
    about: float
    spread: float

    def sample(self, x: float, rng: np.random.Generator) -> float:
        """A y for x."""
        return float(np.exp(self.at + self.slope * (np.log(x) - self.about) + self.spread * rng.normal()))


SWEEP_DEGREES = (3.27, 0.50, 0.84)
"""ln of a sweep's turn, degrees: mean, standard deviation between takes, and within one."""
SWEEP_SECONDS = Law(-0.81, 0.39, 3.39, 0.41)
"""A sweep's time, from its degrees."""
SWEEP_WAY = Law(-1.45, 0.90, 3.39, 0.59)
"""Its way, in diagonals of the object, from its degrees."""
AT_ONCE = 0.86
"""Share of the sweeps that follow the one before within a tenth of a second."""
PAUSE_SECONDS = (-0.57, 1.18)
"""ln of the other pauses: mean, standard deviation."""
ON, BACK = 0.25, 0.41
"""Shares of the sweeps that turn within 60 degrees of the direction of the one before, or of its opposite."""
OVERLAP = (0.12, 0.34)
"""Share of its time by which a sweep begins before the end of the one before: two of equal speed whose axes are at
right angles then have a dip of .07 to .45 of their peaks between them (measured, 5 to 95 %: .06 to .48)."""
TO_END = (0.52, 0.83)
"""Shares of the joint's strokes that end within a tenth of the range of where it ends: of those that have four fifths
of it before them or more, and of the others."""
PARTWAY = (0.07, 0.88)
"""Share of the way to that end that the others pass (5 to 95 %)."""
JOINT_SECONDS = Law(-0.89, 0.64, -0.74, 0.44)
"""A joint stroke's time, from the share that it passes."""
JOINT_AT_ONCE = 0.43
"""Share of the joint's strokes that follow the one before within a tenth of a second."""
JOINT_REST_SECONDS = (-0.01, 1.24)
"""ln of the joint's other rests: mean, standard deviation."""
TURNED_ROUND = 0.76
"""Share of the joint's strokes that go back where the one before came from."""
LAID = 0.23
"""Share of the rests of a second or more in which an object is as still as on a table: less than .025 degrees a frame,
where motion capture itself makes .02. An object held still in the hand makes .040 (median)."""

_LEAST = 0.05  # of the range: what passes less was not measured (`freeart21.strokes.JOINT_STROKE`)
_LARGEST = 170.0  # degrees: beyond, a stroke has no one direction; 1 % of those measured are longer
FASTEST = 25.0
"""Degrees a frame at 30 a second; the most that was measured is 24.8."""
_QUICKEST = 0.12  # s: four samples of the motion capture, in which no shorter stroke is told from noise
_BEGUN, _MOST = 0.25, 0.6  # shares of a short video: within it something moves, however few its frames are
_LONGEST = 5.0  # s: the longest rest that was measured lasts 4.7


@dataclass(frozen=True)
class Sweep:
    """A stroke of the hand."""

    start: float
    length: float
    """Frames, from rest to rest."""
    degrees: float
    way: float
    """Diagonals of the object."""

    def course(self, frames: int) -> Array:
        """(frames,) 0 before, 1 after."""
        return ease((np.arange(frames, dtype=float) - self.start) / self.length)


@dataclass(frozen=True)
class Hand:
    """What a hand does with an object, but for the directions."""

    sweeps: tuple[Sweep, ...]
    resting_on_table: tuple[tuple[float, float], ...]
    """First and last frame of every rest in which the object is put down."""


def draw_hand(frames: int, fps: float, rng: np.random.Generator) -> Hand:
    """Sweeps and rests of one person over a video."""
    sweeps: list[Sweep] = []
    resting_on_table: list[tuple[float, float]] = []
    mean, between, within = SWEEP_DEGREES
    mean += between * float(np.clip(rng.normal(), -2, 2))
    begins = 0.0 if rng.uniform() < AT_ONCE else _rest(PAUSE_SECONDS, rng) * rng.uniform() * fps
    at = min(max(begins, 1.0), _BEGUN * frames)
    while at < frames:
        degrees = min(float(np.exp(mean + within * rng.normal())), _LARGEST)
        overlap = rng.uniform(*OVERLAP)
        seconds = max(SWEEP_SECONDS.sample(degrees, rng), _QUICKEST) / (1 - overlap)  # measured from dip to dip
        seconds = max(seconds, 1.875 * degrees / (FASTEST * 30))  # the peak of a minimum-jerk stroke
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
    """The joint, worked in strokes of its own: nearly shut at first, then wide open, then as it comes.

    A `hold` is put in, after the first stroke, before half of the time that it leaves has passed.
    """
    share, turn = float(rng.uniform(0.0, 0.25)), 1.0
    at = min(float(rng.uniform(0.2, 1.0)) * fps, _BEGUN * frames)
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
        length = min(length, _MOST * frames)
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
    """Seconds of a rest."""
    return min(float(np.exp(law[0] + law[1] * rng.normal())), _LONGEST)
