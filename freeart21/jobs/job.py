"""A job, and a list of jobs as a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.json_record import read_record

SCHEMA = "freeart21/jobs/1"


@dataclass(frozen=True)
class Job:
    """A repeatable piece of work: a command, or a call of a function of this project.

    In the words of a command and in a call's text arguments, `{folder}` is the folder of jobs, `{out}` a temporary path
    that is renamed to `out` on success, `{freeart21}` (a whole word) the command line of this program and `{python}`
    its Python. A job without `{out}` must write its output atomically itself.
    """

    name: str
    """Unique; the part before the first '/' is its kind, as in 'score/ours'."""
    command: tuple[str, ...] = ()
    """Words of a command, which runs in the folder of jobs."""
    call: str = ""
    """'module:function' in place of a command; its return value (JSON) is saved with the statistics."""
    arguments: dict[str, Any] = field(default_factory=dict)
    """Keyword arguments of the call; plain JSON."""
    out: str | None = None
    """File or folder that it makes in the folder of jobs; None when its results are elsewhere."""
    needs: tuple[str, ...] = ()
    """Jobs that must finish first."""
    seconds: float = 0.0
    """Estimated time."""
    codes: tuple[int, ...] = (0,)
    """Exit codes of the command that count as success when `out` exists."""
    resumes: bool = False
    """Whether it resumes from an existing `out`; otherwise unfinished output is removed first."""
    key: str = ""
    """Further inputs of the result, such as a hash of files: another key makes another job."""

    @property
    def kind(self) -> str:
        """The part of its name before the first '/'. Time estimates of one kind share their error."""
        return self.name.split("/")[0]

    def to_json(self) -> dict[str, Any]:
        """The fields that differ from their defaults."""
        empty = Job("")
        return {name: value for name, value in asdict(self).items() if value != getattr(empty, name)}


def write_jobs(path: Path, jobs: Iterable[Job]) -> None:
    """Write `jobs` to `path`, in their order."""
    atomic.write_json(path, {"schema": SCHEMA, "jobs": [job.to_json() for job in jobs]})


def read_jobs(path: Path) -> list[Job]:
    """The jobs in `path`; FreeArtError names the first invalid one."""
    listed = checked.read_json(Path(path), SCHEMA, checked.ANYWHERE).get("jobs")
    if not isinstance(listed, list):
        raise FreeArtError(f"{path}: 'jobs' is {str(listed)[:60]}, expected a list")
    jobs = [read_record(Job, data, f"{path}: job {k}") for k, data in enumerate(listed)]
    job_digests(jobs)
    return jobs


def job_digests(jobs: Sequence[Job]) -> dict[str, str]:
    """Job name to digest, in topological order: every job after those that it needs.

    A digest covers all inputs of a job's result, with the digests of the jobs it needs: a change makes it and its
    dependents other jobs. Raises FreeArtError on a duplicate or invalid name, an unknown need, a cycle, or a job that
    is neither a command nor a call.
    """
    by_name: dict[str, Job] = {}
    for job in jobs:
        _check(job)
        if job.name in by_name:
            raise FreeArtError(f"two jobs are called '{job.name}'")
        by_name[job.name] = job
    outs: dict[str, str] = {}
    for job in jobs:
        for need in job.needs:
            if need not in by_name:
                raise FreeArtError(f"job '{job.name}' needs '{need}', which is no job")
        if job.out is not None and outs.setdefault(job.out, job.name) != job.name:
            raise FreeArtError(f"jobs '{outs[job.out]}' and '{job.name}' make the same output {job.out}")
    digests: dict[str, str] = {}
    pending = list(reversed(jobs))
    waiting: set[str] = set()
    while pending:
        job = pending[-1]
        missing = [by_name[need] for need in job.needs if need not in digests]
        if job.name in digests or not missing:
            pending.pop()
            digests.setdefault(job.name, _digest(job, digests))
            continue
        if job.name in waiting:
            raise FreeArtError(f"job '{job.name}' needs itself, by way of '{missing[0].name}'")
        waiting.add(job.name)
        pending += reversed(missing)
    return digests


def _digest(job: Job, digests: dict[str, str]) -> str:
    facts = {name: value for name, value in job.to_json().items() if name not in ("seconds", "needs")}
    facts["needs"] = [digests[need] for need in job.needs]
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def _check(job: Job) -> None:
    parts = job.name.split("/")
    if any(part in ("", ".", "..") or part.startswith(".") or "\\" in part or "\0" in part for part in parts):
        raise FreeArtError(
            f"'{job.name[:60]}' is no name of a job: expected words joined by '/', none beginning with '.'"
        )
    if bool(job.command) == bool(job.call):
        has = "both a command and a call" if job.call else "neither a command nor a call"
        raise FreeArtError(f"job '{job.name}' has {has}; expected one of them")
    if job.call and job.call.count(":") != 1:
        raise FreeArtError(f"job '{job.name}': call is '{job.call[:60]}', expected module:function")
    if job.out is not None:
        path = Path(job.out)
        if path.is_absolute() or ".." in path.parts or path == Path() or path.parts[0] == ".jobs":
            raise FreeArtError(f"job '{job.name}': out is '{job.out[:60]}', expected a place inside the folder of jobs")
