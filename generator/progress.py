"""Progress of a recording: what is done, how fast, and the time left."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.text import Text

Progress = Callable[[int, int], None]
"""Called with the number of pictures done and their total."""


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text("" if task.speed is None else f"{task.speed:.1f} pictures/s")


class Board:
    """Progress bars on standard error: one for each running sequence, and one for all when there are several.

    Without a terminal, and with several sequences, a line for every finished sequence instead.
    """

    def __init__(self, bars: Bars, console: Console, sequences: int, pictures: int) -> None:
        """`sequences` are recorded, with `pictures` in all."""
        self._bars, self._console, self._sequences = bars, console, sequences
        self._running: dict[str, TaskID] = {}
        self._shares: dict[str, int] = {}
        self._finished, self._drawn, self._started = 0, 0, time.monotonic()
        self._all = bars.add_task(self._title(), total=pictures) if sequences > 1 else None
        self._pictures = pictures

    def update(self, sequence: str, done: int, total: int) -> None:
        """Report that `done` of `total` pictures of a sequence exist."""
        if sequence not in self._running:
            self._running[sequence] = self._bars.add_task(sequence, total=total)
        self._drawn += done - self._shares.get(sequence, 0)
        self._shares[sequence] = done
        self._bars.update(self._running[sequence], completed=done, total=total)
        if self._all is not None:
            self._bars.update(self._all, completed=self._drawn)

    def finished(self, sequence: str) -> None:
        """Report a finished sequence."""
        self._finished += 1
        if sequence in self._running:
            self._bars.remove_task(self._running.pop(sequence))
        if self._all is None:
            return
        self._bars.update(self._all, description=self._title())
        if not self._console.is_terminal:
            rate = self._drawn / max(time.monotonic() - self._started, 1e-9)
            left = (self._pictures - self._drawn) / max(rate, 1e-9)
            print_line(f"{self._finished}/{self._sequences} {sequence}: {rate:.1f} pictures/s, {_span(left)} left")

    def _title(self) -> str:
        return f"{self._finished}/{self._sequences} sequences"


@contextmanager
def progress_board(sequences: int, pictures: int) -> Iterator[Board]:
    """Open a board for `sequences` with `pictures` in all."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _Rate(), TimeRemainingColumn())
    with Bars(*columns, console=console, disable=not console.is_terminal, speed_estimate_period=20) as bars:
        yield Board(bars, console, sequences, pictures)


@contextmanager
def progress_bar(what: str) -> Iterator[Progress]:
    """Open one bar named `what`, on standard error when that is a terminal; call it with (done, total)."""
    with progress_board(1, 0) as board:
        yield partial(board.update, what)


def print_line(text: str) -> None:
    """Print one plain line on standard error."""
    Console(stderr=True).print(text, highlight=False, markup=False, soft_wrap=True)


def _span(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
