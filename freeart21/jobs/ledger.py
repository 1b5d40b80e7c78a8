"""The state of jobs, in files: started, statistics, finished."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.jobs.job import Job

PLACE = ".jobs"
STATISTICS_SCHEMA = "freeart21/job-statistics/1"


class Ledger:
    """The state files of a folder of jobs. Readers and writers can be killed at any moment."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.place = self.folder / PLACE

    def path(self, what: str, name: str, ending: str = ".json") -> Path:
        """The file of a job in the folder `what` of `.jobs`, such as 'done'."""
        return self.place / what / f"{name}{ending}"

    def finished(self, job: Job, digest: str) -> bool:
        """Whether the job has a marker of this digest, and its output exists."""
        if job.out is not None and not (self.folder / job.out).exists():
            return False
        return _read(self.path("done", job.name)).get("digest") == digest

    def finish(self, job: Job, digest: str) -> None:
        """Write the marker, as the last step of a job."""
        atomic.write_json(self.path("done", job.name), {"digest": digest})

    def forget(self, job: Job) -> None:
        """Remove the marker and the statistics, so that the job runs again."""
        for what in ("done", "statistics"):
            self.path(what, job.name).unlink(missing_ok=True)

    def begin(self, job: Job) -> None:
        """Record that the job has started: output found later is its own.

        Raises FreeArtError when its output exists although it never started.
        """
        started = self.path("begun", job.name)
        if started.is_file():
            return
        if job.out is not None and (self.folder / job.out).exists():
            raise FreeArtError(f"{self.folder / job.out} exists and was not made by the job '{job.name}'; move it away")
        atomic.write_json(started, {})

    def write_statistics(self, job: Job, digest: str, **facts: Any) -> None:
        """Save the outcome of a job: code, last line, seconds."""
        data = {"schema": STATISTICS_SCHEMA, "job": job.name, "digest": digest, **facts}
        atomic.write_json(self.path("statistics", job.name), data)

    def read_statistics(self, job: Job, digest: str) -> dict[str, Any]:
        """The saved outcome of the job with this digest; empty without one."""
        data = _read(self.path("statistics", job.name))
        return data if data.get("digest") == digest else {}


def _read(path: Path) -> dict[str, Any]:
    """The JSON object in `path`; empty when it is missing or incomplete."""
    try:
        return checked.read_json(path)
    except FreeArtError:
        return {}
