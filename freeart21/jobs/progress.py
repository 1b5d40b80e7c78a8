"""Progress of jobs: the number done, and the time left, from estimates that finished jobs correct."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

from freeart21.jobs.job import Job
from freeart21.jobs.run import Event


class Forecast:
    """Time left: estimates, scaled by the ratio of measured to estimated time of ended jobs of the same kind."""

    def __init__(self, jobs: Sequence[Job], workers: int) -> None:
        self._pending = {job.name: job for job in jobs}
        self._workers = workers
        self._taken: dict[str, list[float]] = {}
        self.done = 0

    def job_ended(self, job: Job, seconds: float | None) -> None:
        """Count a job as done; `seconds` is its measured time, or None to leave it out of the ratio."""
        self._pending.pop(job.name, None)
        self.done += 1
        if seconds is not None and job.seconds > 0:
            taken = self._taken.setdefault(job.kind, [0.0, 0.0])
            taken[0] += seconds
            taken[1] += job.seconds

    def remaining_s(self) -> float:
        """Seconds until all jobs are done, with all workers busy."""
        return sum(job.seconds * self._ratio(job.kind) for job in self._pending.values()) / self._workers

    def _ratio(self, kind: str) -> float:
        measured, estimated = self._taken.get(kind, (0.0, 0.0))
        return measured / estimated if estimated else 1.0


@contextlib.contextmanager
def job_progress(jobs: Sequence[Job], workers: int) -> Iterator[Any]:
    """A listener for `run_jobs` over the unfinished `jobs`: a progress bar on a terminal, else one line per job."""
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
                forecast.job_ended(job, took if event == "finished" else None)
                word = f"{took:.0f} s" if event == "finished" and took is not None else f"failed: {facts.get('line')}"
            elif event == "lost":
                word = "was killed, and starts again"
            else:
                word = ""
            head = f"{forecast.done}/{len(jobs)}"
            bars.update(
                task,
                completed=forecast.done,
                description=f"{head} jobs, {format_duration(forecast.remaining_s())} left",
            )
            if word and (event != "finished" or not console.is_terminal):
                line = f"{head} {job.name}: {word}; about {format_duration(forecast.remaining_s())} left"
                console.print(line, highlight=False, markup=False, soft_wrap=True)

        yield listener


def format_duration(seconds: float) -> str:
    """A duration in s, min or h."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
