"""The state of a teleoperation: moving, recording, pausing, undoing. Without network or simulator.

A take has no gaps in time: pauses and undone motion are cut out, and the object continues from where the take ended.
The server then places the object itself; `epoch` counts these placements, and moves that a page sent before one are
dropped.
"""

from __future__ import annotations

from bisect import bisect_left
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
STILL = 1e-9
"""Largest change of a pose entry (m, or of the rotation matrix) that counts as no motion."""


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
        self.times: list[float] = []
        """Seconds."""
        self.places: list[Placement] = []
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
        self.places.append(place)
        return True

    def cut(self) -> None:
        """Let the next sample follow after `STEP_S`, whatever its time."""
        self._shift = None

    def drop_last(self, seconds: float) -> None:
        """Drop the last `seconds`, but not the first sample, and cut."""
        keep = max(bisect_left(self.times, self.seconds - seconds), 1)
        del self.times[keep:], self.places[keep:]
        self.unchanged = min(self.unchanged, keep)
        self.cut()


class Driving:
    """The object's placement and the take that is being recorded."""

    def __init__(self, start: Placement) -> None:
        self.start = self.place = start
        self.epoch = 0
        self.start_new_take()

    def start_new_take(self) -> None:
        """Forget the take: it was saved or discarded."""
        self.phase: Literal["idle", "recording", "paused"] = "idle"
        self.take = Track()
        self.devices: dict[str, None] = {}
        """Input devices of the take, in the order of first use."""

    @property
    def has_take(self) -> bool:
        """Whether there is a take to save."""
        return len(self.take) >= 2

    @property
    def is_full(self) -> bool:
        """Whether the take has its largest length."""
        return self.take.seconds >= MAX_S or len(self.take) >= MAX_SAMPLES

    def move(self, move: Move, time_s: float) -> bool:
        """Move the object at `time_s` of the page's clock; False for a move of an older epoch, which is dropped."""
        if move.epoch != self.epoch:
            return False
        place = Placement(move.T, move.state)
        added = self.phase == "recording" and self.take.add(time_s, place)
        if added and not place.is_close(self.place):  # a device that does not move the object is not listed
            self.devices[move.device] = None
        self.place = place
        return True

    def record(self) -> bool:
        """Start a take, or continue a paused one (True): the object then returns to the end of the take."""
        continues = self.phase == "paused" and len(self.take) > 0
        if continues:
            self.put(self.take.places[-1])
        elif self.phase != "recording":
            self.start_new_take()
        self.phase = "recording"
        return continues

    def pause(self) -> bool:
        """Pause the recording; False when there is none."""
        if self.phase != "recording":
            return False
        self.phase = "paused"
        return True

    def undo(self) -> float:
        """Drop the last `UNDO_S` of the take and place the object at its end; returns the seconds dropped."""
        if not len(self.take):
            return 0.0
        before = self.take.seconds
        self.take.drop_last(UNDO_S)
        self.put(self.take.places[-1])
        return before - self.take.seconds

    def reset(self) -> None:
        """Discard the take and move the object to its start."""
        self.start_new_take()
        self.put(self.start)

    def put(self, place: Placement) -> None:
        """Place the object and start a new epoch: moves that pages sent before are dropped."""
        self.place = place
        self.epoch += 1
        self.take.cut()
