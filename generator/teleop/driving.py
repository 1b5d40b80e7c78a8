"""The state of a teleoperation: moving, recording, pausing, undoing. Without network or simulator.

A take has no gaps in time: pauses and undone motion are cut out, and the object continues from where the take ended.
The server then places the object itself; `epoch` counts these placements, and moves that a page sent before one are
dropped.
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
"""Time that one undo drops: long enough for a mistake, short enough to be repeated."""
STEP_S = 1 / 60
"""Time from the last sample before a cut to the first one after it: a time step of the page."""
MAX_S = 3300.0
"""Longest take: the recorder replays at most 100,000 frames, 30 a second."""
MAX_SAMPLES = 230_000
"""Largest number of samples: a line has up to 282 bytes, `files.take` reads 64 MiB. An hour at 60 Hz has 216,000."""
GAP_S = 1.0
"""Longest time between samples; longer silences are shortened to it."""
MAX_TRAIL = 3600
"""Samples of unrecorded motion that are kept for an undo: a minute."""
STILL = 1e-9
"""Largest change of a pose entry (m, or of the rotation matrix) that counts as no motion."""

_NUMBERS = 13

Phase = Literal["idle", "recording", "paused"]


@dataclass(frozen=True)
class Placement:
    """Pose and joint state of the object."""

    T: Array
    """(4, 4) the object's frame in the camera's axes."""
    state: float
    """rad or m."""

    def is_close(self, other: Placement) -> bool:
        """Whether both are the same within `STILL`."""
        return abs(self.state - other.state) < STILL and bool(np.abs(self.T - other.T).max() < STILL)


class Track:
    """Samples of placements over time; time starts at zero and has no gaps."""

    def __init__(self) -> None:
        self.times = array("d")
        self._numbers = array("d")
        """The upper three rows of the pose and the state of each sample: 112 bytes with its time, 24 MB an hour."""
        self.unchanged = 0
        """Number of first samples that have not changed since a writer set this."""
        self._shift: float | None = None
        """Track time minus the page's time, s; None after a cut."""

    def __len__(self) -> int:
        return len(self.times)

    @property
    def seconds(self) -> float:
        """Duration."""
        return self.times[-1] if self.times else 0.0

    def add(self, time_s: float, place: Placement) -> bool:
        """Add a sample at `time_s` of the page's clock; False when it is not later than the last one."""
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
        """Let the next sample follow after `STEP_S`, whatever its time."""
        self._shift = None

    def drop_last(self, seconds: float) -> Placement | None:
        """Drop the last `seconds`, but not the first sample, and cut; returns the placement that is now the last."""
        if not self.times:
            return None
        keep = max(bisect_left(self.times, self.times[-1] - seconds), 1)
        del self.times[keep:], self._numbers[_NUMBERS * keep :]
        self.unchanged = min(self.unchanged, keep)
        self.cut()
        return self.last

    def keep_last(self, most: int) -> None:
        """Keep only the last `most` samples."""
        if len(self.times) > 2 * most:
            del self.times[:-most], self._numbers[: -_NUMBERS * most]

    def at(self, k: int) -> Placement:
        """The placement of sample `k`, from 0."""
        numbers = self._numbers[_NUMBERS * k : _NUMBERS * (k + 1)]
        return Placement(np.array([*numbers[:-1], 0.0, 0.0, 0.0, 1.0]).reshape(4, 4), numbers[-1])

    @property
    def last(self) -> Placement:
        """The placement of the last sample; the track must not be empty."""
        return self.at(len(self) - 1)

    def sample(self, k: int) -> tuple[float, Array, float]:
        """Time in s, pose (4, 4) and state, rad or m, of sample `k`."""
        place = self.at(k)
        return self.times[k], place.T, place.state

    def samples(self) -> Iterator[tuple[float, Array, float]]:
        """All samples as `sample` gives them."""
        return map(self.sample, range(len(self)))


class Driving:
    """The object's placement and the take that is being recorded."""

    def __init__(self, start: Placement) -> None:
        self.start = self.place = start
        self.phase: Phase = "idle"
        self.epoch = 0
        self.take = Track()
        self.devices: dict[str, None] = {}
        """Input devices of the take, in the order of first use."""
        self._trail = Track()

    @property
    def has_take(self) -> bool:
        """Whether there is a take to save."""
        return len(self.take) >= 2

    def move(self, move: Move, time_s: float) -> bool:
        """Move the object at `time_s` of the page's clock; False for a move of an older epoch, which is dropped."""
        if move.epoch != self.epoch:
            return False
        place = Placement(move.T, move.state)
        moved = not place.is_close(self.place)
        if self.phase == "recording":
            if self.take.add(time_s, place) and moved:  # a device that does not move the object is not listed
                self.devices[move.device] = None
        elif moved:
            if not len(self._trail):
                self._trail.add(time_s - STEP_S, self.place)
            self._trail.add(time_s, place)
            self._trail.keep_last(MAX_TRAIL)
        self.place = place
        return True

    @property
    def is_full(self) -> bool:
        """Whether the take has its largest length."""
        return self.take.seconds >= MAX_S or len(self.take) >= MAX_SAMPLES

    def record(self) -> bool:
        """Start a take, or continue a paused one (True): the object then returns to the end of the take."""
        continues = self.phase == "paused" and len(self.take) > 0
        if continues:
            self.put(self.take.last)
        elif self.phase != "recording":
            self._new_take()
        self.phase = "recording"
        return continues

    def pause(self) -> bool:
        """Pause the recording; False when there is none."""
        if self.phase != "recording":
            return False
        self.phase = "paused"
        self._trail = Track()
        return True

    def undo(self) -> float:
        """Undo the last `UNDO_S`; returns the seconds undone.

        It undoes the take; without a take, or when the object was moved during a pause, it undoes this motion instead.
        """
        aside = self.phase != "recording" and len(self._trail) > 1
        track = self._trail if aside or self.phase == "idle" else self.take
        before = track.seconds
        place = track.drop_last(UNDO_S)
        if place is None:
            return 0.0
        self.put(place)
        return before - track.seconds

    def reset(self) -> None:
        """Discard the take and move the object to its start."""
        self._new_take()
        self.phase = "idle"
        self.put(self.start)

    def start_new_take(self) -> None:
        """Start a new take after one was saved."""
        self._new_take()
        self.phase = "idle"

    def put(self, place: Placement) -> None:
        """Place the object and start a new epoch: moves that pages sent before are dropped."""
        self.place = place
        self.epoch += 1
        self.cut()

    def cut(self) -> None:
        """Let the next move follow after `STEP_S`, whatever its time."""
        self.take.cut()
        self._trail.cut()

    def _new_take(self) -> None:
        self.take, self._trail, self.devices = Track(), Track(), {}
