"""Progress of jobs: what is done, and how long the rest takes, from estimates that measured jobs correct."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

from freeart21.jobs.job import Job
from freeart21.jobs.run import Event


class Forecast:
    """How long jobs take: estimates, times what those of the same kind that have ended took of theirs."""

    def __init__(self, jobs: Sequence[Job], workers: int) -> None:
        self._left = {job.name: job for job in jobs}
        self._workers = workers
        self._taken: dict[str, list[float]] = {}
        self.done = 0

    def ended(self, job: Job, seconds: float | None) -> None:
        """A job is over; `seconds` is what it took, None when it does not count."""
        self._left.pop(job.name, None)
        self.done += 1
        if seconds is not None and job.seconds > 0:
            taken = self._taken.setdefault(job.kind, [0.0, 0.0])
            taken[0] += seconds
            taken[1] += job.seconds

    def left_s(self) -> float:
        """Seconds until all are over, were the workers busy all the time."""
        return sum(job.seconds * self._ratio(job.kind) for job in self._left.values()) / self._workers

    def _ratio(self, kind: str) -> float:
        measured, estimated = self._taken.get(kind, (0.0, 0.0))
        return measured / estimated if estimated else 1.0


@contextlib.contextmanager
def job_board(jobs: Sequence[Job], workers: int) -> Iterator[Any]:
    """A listener for `run_jobs` over `jobs` (those that are to be done): a bar on a terminal, else a line a job."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    forecast = Forecast(jobs, workers)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        task = bars.add_task("", total=len(jobs))

        def listener(event: Event, job: Job, facts: dict[str, object]) -> None:
            if event in ("finished", "failed"):
                seconds = facts.get("seconds")
                took = float(seconds) if isinstance(seconds, int | float) else None
                forecast.ended(job, took if event == "finished" else None)
                word = f"{took:.0f} s" if event == "finished" and took is not None else f"failed: {facts.get('line')}"
            elif event == "lost":
                word = "was killed, and begins again"
            else:
                word = ""
            head = f"{forecast.done}/{len(jobs)}"
            bars.update(task, completed=forecast.done, description=f"{head} jobs, {span(forecast.left_s())} left")
            if word and (event != "finished" or not console.is_terminal):
                line = f"{head} {job.name}: {word}; about {span(forecast.left_s())} left"
                console.print(line, highlight=False, markup=False, soft_wrap=True)

        yield listener


def span(seconds: float) -> str:
    """A duration for people."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
