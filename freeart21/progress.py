"""Progress on standard error: what is done, how fast, and the time left."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars
from rich.text import Text

Progress = Callable[[int, int], None]
"""Called with the number of pictures done and their total."""


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text("" if task.speed is None else f"{task.speed:.1f} pictures/s")


class Board:
    """A progress bar on standard error; without a terminal a line for every finished one of several sequences."""

    def __init__(self, bars: Bars, console: Console, sequences: int, pictures: int) -> None:
        """`sequences` are recorded, with `pictures` in all; with 0 the bar shows the present sequence alone."""
        self._bars, self._console, self._sequences, self._pictures = bars, console, sequences, pictures
        self._bar = bars.add_task("", total=pictures)
        self._drawn: dict[str, int] = {}
        self._finished, self._started = 0, time.monotonic()

    def update(self, sequence: str, done: int, total: int) -> None:
        """Report that `done` of `total` pictures of a sequence exist."""
        self._drawn[sequence] = done
        title = sequence if self._sequences == 1 else f"{self._finished}/{self._sequences} sequences"
        drawn = sum(self._drawn.values()) if self._pictures else done
        self._bars.update(self._bar, description=title, completed=drawn, total=self._pictures or total)

    def finished(self, sequence: str) -> None:
        """Report a finished sequence."""
        self._finished += 1
        if self._sequences > 1 and not self._console.is_terminal:
            drawn = sum(self._drawn.values())
            rate = drawn / max(time.monotonic() - self._started, 1e-9)
            left = (self._pictures - drawn) / max(rate, 1e-9)
            print_line(f"{self._finished}/{self._sequences} {sequence}: {rate:.1f} pictures/s, {_span(left)} left")


@contextmanager
def progress_board(sequences: int, pictures: int) -> Iterator[Board]:
    """Open a board for `sequences` with `pictures` in all."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _Rate(), TimeRemainingColumn())
    with Bars(*columns, console=console, disable=not console.is_terminal, speed_estimate_period=20) as bars:
        yield Board(bars, console, sequences, pictures)


@contextmanager
def progress_bar(text: str, counted: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """Open one bar on a terminal; gives a function that updates it: text, number done, total."""
    console, numbers = Console(stderr=True), (MofNCompleteColumn(),) if counted else ()
    columns = (TextColumn("{task.description}"), BarColumn(), *numbers, TimeElapsedColumn())
    with Bars(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task(text, total=None)
        yield lambda now, done, total: bars.update(task, description=now, completed=done, total=total)


def print_line(text: str) -> None:
    """Print one plain line on standard error."""
    Console(stderr=True).print(text, highlight=False, markup=False, soft_wrap=True)


def _span(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
