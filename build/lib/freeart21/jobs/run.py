"""Running jobs: each once, after what it needs; what is finished is skipped, what fails is said, the others go on."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from freeart21 import stopping
from freeart21.files import atomic
from freeart21.files.lock import locked
from freeart21.jobs.executors import Executor, executor_named
from freeart21.jobs.job import Job, in_order, write_jobs
from freeart21.jobs.ledger import Ledger
from freeart21.jobs.work import Ended, request

ATTEMPTS = 3
"""Times that a job is begun whose process is killed; one that says itself that it failed is not begun again."""
_LOCK_PATIENCE_S = 3.0
"""How long the folder's lock is waited for: that of a killed run goes with its process."""


@dataclass(frozen=True)
class Failed:
    """A job that is not finished, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class Report:
    """What came of a run."""

    finished: tuple[str, ...]
    """Done by this run, in the order in which they ended."""
    skipped: tuple[str, ...]
    """Had been finished before."""
    failed: tuple[Failed, ...]
    """With those that could not begin because of them."""


Event = Literal["begins", "finished", "failed", "lost"]
Listener = Callable[[Event, Job, dict[str, object]], None]
"""Told what happens to a job, with its statistics once it has ended."""


def unfinished(folder: Path, jobs: Sequence[Job]) -> list[Job]:
    """Those of `jobs` that a run would do: without a marker, of another digest, or after one that would be done."""
    digests, ledger, by_name = in_order(jobs), Ledger(folder), {job.name: job for job in jobs}
    todo: dict[str, Job] = {}
    for name, digest in digests.items():  # what a job needs comes before it
        job = by_name[name]
        if any(need in todo for need in job.needs) or not ledger.finished(job, digest):
            todo[name] = job
    return [job for job in jobs if job.name in todo]


def run_jobs(
    folder: Path,
    jobs: Sequence[Job],
    workers: int = 1,
    executor: str | Executor = "local",
    attempts: int = ATTEMPTS,
    listener: Listener | None = None,
) -> Report:
    """Run those of `jobs` that are not finished in `folder`, up to `workers` at a time.

    `executor` is a name (`executors.EXECUTORS`), or one that is made already (`workers` is then its own). A job that
    fails stops none but those that need it. May be interrupted or killed at any moment: the same call goes on.

    Raises FreeArtError when a job is none (`job.in_order`), an executor is unknown or not installed, or another process
    runs jobs here; KeyboardInterrupt when told to stop, after the jobs' processes have ended.
    """
    folder = Path(folder)
    digests = in_order(jobs)
    made = executor_named(executor, workers, folder) if isinstance(executor, str) else executor
    ledger = Ledger(folder)
    with locked(ledger.place / "lock", f"another process runs jobs in {folder}", _LOCK_PATIENCE_S):
        atomic.sweep(ledger.place)
        write_jobs(folder / "jobs.json", jobs)
        todo = unfinished(folder, jobs)
        run = _Run(folder, todo, digests, attempts, listener or (lambda event, job, facts: None))
        for job in todo:
            ledger.forget(job)
        if todo:
            with _cleared_up(run), made as started:
                run.all_of_them(started)
    names = {job.name for job in todo}
    skipped = tuple(job.name for job in jobs if job.name not in names)
    return Report(tuple(run.finished), skipped, tuple(run.failed))


class _Run:
    """The jobs of one run, as they wait, are ready, run, and end."""

    def __init__(
        self, folder: Path, todo: list[Job], digests: dict[str, str], attempts: int, listener: Listener
    ) -> None:
        self.folder, self.digests, self.attempts, self.listener = folder, digests, attempts, listener
        self.ledger = Ledger(folder)
        self.jobs = {job.name: job for job in todo}
        self.missing = {job.name: {need for need in job.needs if need in self.jobs} for job in todo}
        self.waiting: dict[str, list[str]] = {}
        for job in todo:
            for need in self.missing[job.name]:
                self.waiting.setdefault(need, []).append(job.name)
        self.ready = deque(job.name for job in todo if not self.missing[job.name])
        self.running: dict[str, int] = {}
        """Name to the number of the attempt."""
        self.tried: dict[str, int] = {}
        self.finished: list[str] = []
        self.failed: list[Failed] = []
        self.given_up: set[str] = set()

    def all_of_them(self, executor: Executor) -> None:
        """Until none is left that can be done."""
        while self.ready or self.running:
            stopping.check()
            while self.ready and len(self.running) < executor.workers:
                self._begin(self.ready.popleft(), executor)
            for end in executor.wait():
                self._ended(end)

    def _begin(self, name: str, executor: Executor) -> None:
        job = self.jobs[name]
        self.tried[name] = self.running[name] = self.tried.get(name, 0) + 1
        self.listener("begins", job, {})
        executor.start(name, request(self.folder, job, self.digests[name]), job.seconds)

    def _ended(self, end: Ended) -> None:
        job, digest = self.jobs[end.name], self.digests[end.name]
        del self.running[end.name]
        facts = self.ledger.said(job, digest)
        if self.ledger.finished(job, digest):
            self.finished.append(job.name)
            self.listener("finished", job, facts)
            for name in self.waiting.get(job.name, []):
                self.missing[name].discard(job.name)
                if not self.missing[name]:
                    self.ready.append(name)
        elif (facts and not facts.get("good")) or end.code >= 0:  # it, or its process, says itself what was wrong
            self._fail(job.name, str(facts.get("line") or end.line or f"exit code {end.code}"), facts)
        elif self.tried[job.name] < self.attempts:
            self.listener("lost", job, facts)
            self.ready.append(job.name)
        else:
            times = f"{self.attempts} time{'s' if self.attempts > 1 else ''}"
            self._fail(job.name, f"its process was killed {times}{f' ({end.line})' if end.line else ''}", facts)

    def _fail(self, name: str, reason: str, facts: dict[str, object]) -> None:
        """Not finished; nor are those that need it, and those that need them."""
        lost = [(name, reason)]
        for job, why in lost:
            if job not in self.given_up:
                self.given_up.add(job)
                self.failed.append(Failed(job, why))
                self.listener("failed", self.jobs[job], {**(facts if job == name else {}), "line": why})
                lost += [(later, f"needs {job}, which failed") for later in self.waiting.get(job, [])]


@contextlib.contextmanager
def _cleared_up(run: _Run) -> Iterator[None]:
    """When the block fails: remove what those that ran have left aside."""
    try:
        yield
    except BaseException:
        with stopping.deferred():
            for name in run.running:
                out = run.jobs[name].out
                if out is not None:
                    atomic.mend(run.folder / out)
        raise
