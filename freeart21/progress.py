"""Progress on standard error: what is done, and the time left."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars

Progress = Callable[[int, int], None]
"""Called with the number of pictures done and their total."""


class Board:
    """A bar for the pictures of several sequences; without a terminal a line for every finished sequence."""

    def __init__(self, show: Callable[[str, int, int], None], sequences: int, pictures: int) -> None:
        """`show` updates a bar; `sequences` are recorded, with `pictures` in all."""
        self._show, self._sequences, self._pictures = show, sequences, pictures
        self._drawn: dict[str, int] = {}
        self._finished = 0

    def update(self, sequence: str, done: int, total: int) -> None:
        """Report that `done` of `total` pictures of a sequence exist."""
        self._drawn[sequence] = done
        title = sequence if self._sequences == 1 else f"{self._finished}/{self._sequences} sequences"
        self._show(title, sum(self._drawn.values()), self._pictures)

    def finished(self, sequence: str) -> None:
        """Report a finished sequence."""
        self._finished += 1
        if self._sequences > 1 and not Console(stderr=True).is_terminal:
            print_line(f"{self._finished}/{self._sequences} {sequence}")


@contextmanager
def progress_board(sequences: int, pictures: int) -> Iterator[Board]:
    """Open a board for `sequences` with `pictures` in all."""
    with progress_bar("", counted=True) as show:
        yield Board(show, sequences, pictures)


@contextmanager
def progress_bar(text: str, counted: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """Open one bar on a terminal; gives a function that updates it: text, number done, total."""
    console, numbers = Console(stderr=True), (MofNCompleteColumn(), TimeRemainingColumn()) if counted else ()
    columns = (TextColumn("{task.description}"), BarColumn(), *numbers, TimeElapsedColumn())
    with Bars(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task(text, total=None)
        yield lambda now, done, total: bars.update(task, description=now, completed=done, total=total)


def print_line(text: str) -> None:
    """Print one plain line on standard error."""
    Console(stderr=True).print(text, highlight=False, markup=False, soft_wrap=True)
