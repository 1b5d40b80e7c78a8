"""Runs jobs: each once, after those it needs. Finished jobs are skipped; a failed one does not stop the others."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from freeart21 import stopping
from freeart21.files import atomic
from freeart21.files.lock import hold_lock
from freeart21.jobs.executors import Executor, executor_named
from freeart21.jobs.job import Job, job_digests, write_jobs
from freeart21.jobs.ledger import Ledger
from freeart21.jobs.worker import ProcessExit, encode_request

ATTEMPTS = 3
"""Times that a job is started when its process is killed. A job that fails by itself is not started again."""
_LOCK_PATIENCE_S = 3.0
"""Waiting time for the folder's lock: a killed run loses its lock with its process."""


@dataclass(frozen=True)
class Failed:
    """A job that is not finished, and the reason."""

    name: str
    reason: str


@dataclass(frozen=True)
class Report:
    """The outcome of a run."""

    finished: tuple[str, ...]
    """Jobs finished by this run, in the order in which they ended."""
    skipped: tuple[str, ...]
    """Jobs that were finished before."""
    failed: tuple[Failed, ...]
    """Failed jobs, and those that need them."""


Event = Literal["begins", "finished", "failed", "lost"]
Listener = Callable[[Event, Job, dict[str, object]], None]
"""Called with an event, its job and, once the job has ended, its statistics."""


def unfinished_jobs(folder: Path, jobs: Sequence[Job]) -> list[Job]:
    """The jobs that a run would do: without a marker of the same digest, or needing such a job."""
    digests, ledger, by_name = job_digests(jobs), Ledger(folder), {job.name: job for job in jobs}
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
    """Run the unfinished ones of `jobs` in `folder`, up to `workers` at a time.

    `executor` is a name in `executors.EXECUTORS`, or an executor (with its own number of workers). A failed job stops
    only those that need it. The run can be interrupted or killed at any moment: the same call resumes it.

    Raises FreeArtError when a job is invalid (`job_digests`), the executor is unknown or not installed, or another
    process runs jobs here; KeyboardInterrupt after a stop signal, once the jobs' processes have ended.
    """
    folder = Path(folder)
    digests = job_digests(jobs)
    made = executor_named(executor, workers, folder) if isinstance(executor, str) else executor
    ledger = Ledger(folder)
    with hold_lock(ledger.place / "lock", f"another process runs jobs in {folder}", _LOCK_PATIENCE_S):
        atomic.remove_leftovers(ledger.place)
        write_jobs(folder / "jobs.json", jobs)
        todo = unfinished_jobs(folder, jobs)
        run = _Run(folder, todo, digests, attempts, listener or (lambda event, job, facts: None))
        for job in todo:
            ledger.forget(job)
        if todo:
            with _clean_up_on_error(run), made as started:
                run.run_all(started)
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

    def run_all(self, executor: Executor) -> None:
        """Run until no job is ready or running."""
        while self.ready or self.running:
            stopping.raise_if_stopped()
            while self.ready and len(self.running) < executor.workers:
                self._start(self.ready.popleft(), executor)
            for end in executor.wait():
                self._handle_exit(end)

    def _start(self, name: str, executor: Executor) -> None:
        job = self.jobs[name]
        self.tried[name] = self.running[name] = self.tried.get(name, 0) + 1
        self.listener("begins", job, {})
        executor.start(name, encode_request(self.folder, job, self.digests[name]), job.seconds)

    def _handle_exit(self, end: ProcessExit) -> None:
        job, digest = self.jobs[end.name], self.digests[end.name]
        del self.running[end.name]
        facts = self.ledger.read_statistics(job, digest)
        if self.ledger.finished(job, digest):
            self.finished.append(job.name)
            self.listener("finished", job, facts)
            for name in self.waiting.get(job.name, []):
                self.missing[name].discard(job.name)
                if not self.missing[name]:
                    self.ready.append(name)
        elif (facts and not facts.get("good")) or end.code >= 0:  # the job or its process reports an error
            self._fail(job.name, str(facts.get("line") or end.line or f"exit code {end.code}"), facts)
        elif self.tried[job.name] < self.attempts:
            self.listener("lost", job, facts)
            self.ready.append(job.name)
        else:
            times = f"{self.attempts} time{'s' if self.attempts > 1 else ''}"
            self._fail(job.name, f"its process was killed {times}{f' ({end.line})' if end.line else ''}", facts)

    def _fail(self, name: str, reason: str, facts: dict[str, object]) -> None:
        """Record a failed job, and all that directly or indirectly need it."""
        lost = [(name, reason)]
        for job, why in lost:
            if job not in self.given_up:
                self.given_up.add(job)
                self.failed.append(Failed(job, why))
                self.listener("failed", self.jobs[job], {**(facts if job == name else {}), "line": why})
                lost += [(later, f"needs {job}, which failed") for later in self.waiting.get(job, [])]


@contextlib.contextmanager
def _clean_up_on_error(run: _Run) -> Iterator[None]:
    """When the block fails, remove unfinished output of the running jobs."""
    try:
        yield
    except BaseException:
        with stopping.defer_stop():
            for name in run.running:
                out = run.jobs[name].out
                if out is not None:
                    atomic.recover_folder(run.folder / out)
        raise
