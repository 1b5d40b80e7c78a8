"""A page's clock brought to the server's, by the messages themselves.

A message arrives after it was sent, by the way's delay; the least of (arrival - sent) over a while is the clocks'
offset plus the shortest delay, which is the same all along (Cristian 1989 bounds it by half the round trip). Clocks
drift against each other, by up to 100 ppm of common quartz: the least is taken over a window that goes on, and the
offset follows it so slowly that no time between two samples is stretched by more than `SLEW`.
"""

from __future__ import annotations

import math
from collections import deque

WINDOW_S = 20.0
"""Over which the shortest way is looked for: 100 ppm of it are 2 ms."""
SLEW = 1e-3
"""Seconds a second by which the offset may follow: ten times the drift of common quartz."""
SETTLING_S = 1.0
"""From the first message: until then, or until something is recorded, the offset jumps to a shorter way."""


class Clock:
    """The clock of one page, in seconds; every message is told to it."""

    def __init__(self) -> None:
        self._least: deque[tuple[float, float]] = deque()
        """(arrival, offset) of growing offsets: the first is the window's least."""
        self._offset: float | None = None
        self._settled = math.inf
        self._last = 0.0

    def heard(self, sent: float, arrived: float) -> None:
        """A message that the page stamped `sent` arrived at `arrived`, of the server's clock; seconds."""
        offset = arrived - sent
        if self._least and arrived < self._least[-1][0]:
            return
        while self._least and self._least[-1][1] >= offset:
            self._least.pop()
        self._least.append((arrived, offset))
        while self._least[0][0] < arrived - WINDOW_S:
            self._least.popleft()
        least = self._least[0][1]
        if self._offset is None:
            self._offset, self._last = least, sent
            self._settled = arrived + SETTLING_S
        elif arrived <= self._settled:
            self._offset = min(self._offset, least)
        else:
            most = SLEW * max(sent - self._last, 0.0)
            self._offset += min(max(least - self._offset, -most), most)
        self._last = max(self._last, sent)

    def steady(self) -> None:
        """From now on the offset only follows slowly: something is recorded."""
        self._settled = -math.inf

    def at(self, sent: float) -> float:
        """The server's time of what the page stamped `sent`; a message was heard before."""
        assert self._offset is not None
        return sent + self._offset
