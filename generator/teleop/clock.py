"""Converts times of a page's clock to the server's clock, from the time stamps of messages.

The minimum of (arrival - sent) over a window is the offset of the clocks plus the shortest delay, which is constant
(Cristian 1989 bounds it by half the round trip). Quartz clocks drift by up to 100 ppm, so the window moves, and the
offset follows the minimum so slowly that no interval is stretched by more than `SLEW`.
"""

from __future__ import annotations

import math
from collections import deque

WINDOW_S = 20.0
"""Window of the minimum: 100 ppm of it are 2 ms."""
SLEW = 1e-3
"""Largest rate of change of the offset, s/s: ten times the drift of a quartz clock."""
SETTLING_S = 1.0
"""Time after the first message in which the offset jumps to a smaller minimum, unless a recording starts before."""


class Clock:
    """The clock of one page; `observe` gets every message. All times in seconds."""

    def __init__(self) -> None:
        self._least: deque[tuple[float, float]] = deque()
        """(arrival, offset) with increasing offsets: the first is the minimum of the window."""
        self._offset: float | None = None
        self._settled = math.inf
        self._last = 0.0

    def observe(self, sent: float, arrived: float) -> None:
        """Note a message that was sent at `sent` (page's clock) and arrived at `arrived` (server's clock)."""
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

    def stop_jumping(self) -> None:
        """Let the offset change only slowly from now on, because a recording starts."""
        self._settled = -math.inf

    def server_time(self, sent: float) -> float:
        """The server's time for the page's time `sent`; needs at least one observation."""
        assert self._offset is not None
        return sent + self._offset
