"""What a hand does to an object over time: moving, recording, pausing, undoing. No network, no simulator.

A take has no gap: what lies between a pause and going on, or between an undo and what follows, is cut out of its time,
and there the object goes on from where the take left it (`epoch` counts these placings, so that a move which was sent
before one is known and dropped).
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from freeart21.se3 import Array
from generator.teleop.wire import Move

UNDO_S = 2.0
"""How much of a take an undo drops: long enough for a slip of the hand, short enough to be pressed a few times."""
STEP_S = 1 / 60
"""From the last sample before a cut to the first after it: one of the page's own steps."""
MOST_S = 3300.0
"""How long a take may be: the recorder replays at most 100,000 frames, 30 a second."""
MAX_SAMPLES = 230_000
"""How many samples it may have: a line has up to 282 bytes, and `files.take` reads 64 MiB. An hour at 60 Hz has
216,000."""
GAP_S = 1.0
"""A longer silence within a recording counts as so long: a page that stood still for a minute did not move."""
MAX_TRAIL = 3600
"""Samples that are kept of what was not recorded, for an undo: a minute."""
STILL = 1e-9
"""Metres, and parts of a turn's matrix, below which the object did not move."""

_NUMBERS = 13

Phase = Literal["idle", "recording", "paused"]


@dataclass(frozen=True)
class Placement:
    """Where the object is, and its joint."""

    T: Array
    """(4, 4) the object's frame in the camera's axes."""
    state: float
    """rad or m."""

    def is_like(self, other: Placement) -> bool:
        """Whether it shows the same picture."""
        return abs(self.state - other.state) < STILL and bool(np.abs(self.T - other.T).max() < STILL)


class Track:
    """Samples against a time that has no gaps; it begins at zero."""

    def __init__(self) -> None:
        self.times = array("d")
        self._numbers = array("d")
        """Of each sample, the upper three rows of its pose and its state: 112 bytes with its time, 24 MB an hour."""
        self.unchanged = 0
        """Samples from the first that were not taken back since whoever writes them down set this."""
        self._shift: float | None = None
        """Seconds from the time of the next sample to the track's; None after a cut."""

    def __len__(self) -> int:
        return len(self.times)

    @property
    def seconds(self) -> float:
        """How long it lasts."""
        return self.times[-1] if self.times else 0.0

    def add(self, time_s: float, place: Placement) -> bool:
        """Add a sample of the server's time; False when it is no later than the last."""
        if self._shift is None:
            self._shift = (self.times[-1] + STEP_S if self.times else 0.0) - time_s
        time = time_s + self._shift
        if self.times:
            since = time - self.times[-1]
            if since <= 0:
                return False
            if since > GAP_S:
                self._shift -= since - GAP_S
                time = self.times[-1] + GAP_S
        self.times.append(time)
        self._numbers.extend(place.T[:3].ravel())
        self._numbers.append(place.state)
        return True

    def cut(self) -> None:
        """What comes next follows at once, however much later it is."""
        self._shift = None

    def back(self, seconds: float) -> Placement | None:
        """Drop the last `seconds`, but not the first sample, and cut; the placement that is now the last."""
        if not self.times:
            return None
        keep = max(bisect_left(self.times, self.times[-1] - seconds), 1)
        del self.times[keep:], self._numbers[_NUMBERS * keep :]
        self.unchanged = min(self.unchanged, keep)
        self.cut()
        return self.last

    def forget(self, most: int) -> None:
        """Keep only the last `most` samples."""
        if len(self.times) > 2 * most:
            del self.times[:-most], self._numbers[: -_NUMBERS * most]

    def at(self, k: int) -> Placement:
        """The placement of sample `k`, from 0."""
        numbers = self._numbers[_NUMBERS * k : _NUMBERS * (k + 1)]
        return Placement(np.array([*numbers[:-1], 0.0, 0.0, 0.0, 1.0]).reshape(4, 4), numbers[-1])

    @property
    def last(self) -> Placement:
        """The placement of the last sample; there is one."""
        return self.at(len(self) - 1)

    def sample(self, k: int) -> tuple[float, Array, float]:
        """Of sample `k`: time in s, pose (4, 4), state in rad or m."""
        place = self.at(k)
        return self.times[k], place.T, place.state

    def samples(self) -> Iterator[tuple[float, Array, float]]:
        """Each `sample`."""
        return map(self.sample, range(len(self)))


class Driving:
    """The object in somebody's hand, and the take that is being made."""

    def __init__(self, start: Placement) -> None:
        self.start = self.place = start
        self.phase: Phase = "idle"
        self.epoch = 0
        self.take = Track()
        self.devices: dict[str, None] = {}
        """What the take was made with, in the order of first use."""
        self._trail = Track()

    @property
    def has_take(self) -> bool:
        """Whether there is something to save."""
        return len(self.take) >= 2

    def move(self, move: Move, time_s: float) -> bool:
        """The object goes where a move says, at `time_s` of the server's clock; False for a move of an older epoch."""
        if move.epoch != self.epoch:
            return False
        place = Placement(move.T, move.state)
        moved = not place.is_like(self.place)
        if self.phase == "recording":
            if self.take.add(time_s, place) and moved:  # a page that only says that it holds still has used nothing
                self.devices[move.device] = None
        elif moved:
            if not len(self._trail):
                self._trail.add(time_s - STEP_S, self.place)
            self._trail.add(time_s, place)
            self._trail.forget(MAX_TRAIL)
        self.place = place
        return True

    @property
    def is_full(self) -> bool:
        """Whether the take is as long as one may be."""
        return self.take.seconds >= MOST_S or len(self.take) >= MAX_SAMPLES

    def record(self) -> bool:
        """Begin a take, or go on with one that is paused (True): the object returns to where the take left it."""
        goes_on = self.phase == "paused" and len(self.take) > 0
        if goes_on:
            self.put(self.take.last)
        elif self.phase != "recording":
            self._new_take()
        self.phase = "recording"
        return goes_on

    def pause(self) -> bool:
        """Stop recording for a while; False when nothing is recorded."""
        if self.phase != "recording":
            return False
        self.phase = "paused"
        self._trail = Track()
        return True

    def undo(self) -> float:
        """Take back the last `UNDO_S`; the seconds that went.

        Of the take while there is one. Without one, or where it is paused and the object was moved since: of what was
        moved.
        """
        aside = self.phase != "recording" and len(self._trail) > 1
        track = self._trail if aside or self.phase == "idle" else self.take
        before = track.seconds
        place = track.back(UNDO_S)
        if place is None:
            return 0.0
        self.put(place)
        return before - track.seconds

    def reset(self) -> None:
        """Throw the take away and put the object where it was at the beginning."""
        self._new_take()
        self.phase = "idle"
        self.put(self.start)

    def saved(self) -> None:
        """The take is in a file; the next one is a new one."""
        self._new_take()
        self.phase = "idle"

    def put(self, place: Placement) -> None:
        """Place the object, whatever the page's hand says: moves that were sent before do not count."""
        self.place = place
        self.epoch += 1
        self.take.cut()
        self._trail.cut()

    def _new_take(self) -> None:
        self.take, self._trail, self.devices = Track(), Track(), {}
