"""One job, and a list of them as a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked

SCHEMA = "freeart21/jobs/1"


@dataclass(frozen=True)
class Job:
    """One piece of work that can be done anew at any time: a command, or a call of a function of ours.

    In the words of a command and in the texts among a call's arguments, `{folder}` is the folder of jobs, `{out}` a
    place aside that takes the name `out` once all is well, `{freeart21}` (a whole word) the command line of this
    program and `{python}` its Python. Without `{out}` the job itself must see to it that its output appears whole.
    """

    name: str
    """Unique; parts of it between '/' sort jobs by kind, as 'score/ours'."""
    command: tuple[str, ...] = ()
    """Words of a command; it runs in the folder of jobs."""
    call: str = ""
    """Instead of a command 'module:function'; what it returns (JSON) is kept with the statistics."""
    arguments: dict[str, Any] = field(default_factory=dict)
    """Of the call, by name; plain JSON."""
    out: str | None = None
    """File or folder that it makes, inside the folder of jobs; None when it puts its results elsewhere."""
    needs: tuple[str, ...] = ()
    """Jobs that must be finished before."""
    seconds: float = 0.0
    """Estimate of what it takes."""
    codes: tuple[int, ...] = (0,)
    """Exit codes of the command that are an answer, as long as `out` is there."""
    resumes: bool = False
    """It goes on from what stands at `out`; otherwise what an unfinished one left there is cleared away first."""
    key: str = ""
    """What else decides the result, such as a hash of the inputs: another key is another job."""

    @property
    def kind(self) -> str:
        """What stands before the first '/' of its name: jobs of a kind take about the same time a unit."""
        return self.name.split("/")[0]

    def to_json(self) -> dict[str, Any]:
        """As `read_jobs` reads it: only what is not the default."""
        empty = Job("")
        return {name: value for name, value in asdict(self).items() if value != getattr(empty, name)}


def write_jobs(path: Path, jobs: Iterable[Job]) -> None:
    """Write `jobs` to `path`, in their order."""
    atomic.write_json(path, {"schema": SCHEMA, "jobs": [job.to_json() for job in jobs]})


def read_jobs(path: Path) -> list[Job]:
    """The jobs in `path`; FreeArtError names what is wrong with the first that is no job."""
    listed = checked.read_json(Path(path), SCHEMA, checked.ANYWHERE).get("jobs")
    if not isinstance(listed, list):
        raise FreeArtError(f"{path}: 'jobs' is {str(listed)[:60]}, expected a list")
    jobs = [job_from_json(data, f"{path}: job {k}") for k, data in enumerate(listed)]
    in_order(jobs)
    return jobs


_KINDS: dict[str, tuple[type, ...]] = {
    **dict.fromkeys(("name", "call", "key"), (str,)),
    "out": (str, type(None)),
    **dict.fromkeys(("command", "needs", "codes"), (list, tuple)),
    "arguments": (dict,),
    "seconds": (int, float),
    "resumes": (bool,),
}


def job_from_json(data: Any, what: str = "job") -> Job:
    """The job that `data` says; FreeArtError, beginning with `what`, when it says none."""
    if not isinstance(data, dict):
        raise FreeArtError(f"{what} is {str(data)[:60]}, expected an object")
    known = [f.name for f in fields(Job)]
    for name, value in data.items():
        if name not in known:
            raise FreeArtError(f"{what} has '{name}'; expected {', '.join(known)}")
        if not isinstance(value, _KINDS[name]):
            expected = " or ".join(kind.__name__ for kind in _KINDS[name])
            raise FreeArtError(f"{what}: '{name}' is {str(value)[:60]!r}, expected {expected}")
    for name, kind in (("command", str), ("needs", str), ("codes", int)):
        if not all(isinstance(value, kind) for value in data.get(name, ())):
            raise FreeArtError(f"{what}: '{name}' is {str(data[name])[:60]}, expected a list of {kind.__name__}")
    lists = {name: tuple(data[name]) for name in ("command", "needs", "codes") if name in data}
    return Job(**{"name": "", **data, **lists})


def in_order(jobs: Sequence[Job]) -> dict[str, str]:
    """Job name to digest, every job after those that it needs, otherwise in their order.

    A digest is over all that decides a job's result, those of the jobs it needs included: after a change, it and what
    hangs on it are other jobs. Raises FreeArtError when a name is taken twice or is none, a need is unknown, needs go
    in a circle, or a job is neither a command nor a call.
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
