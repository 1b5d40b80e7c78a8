"""What is known of jobs, in files: which began, what each said, and which are finished."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.jobs.job import Job

PLACE = ".jobs"
STATISTICS_SCHEMA = "freeart21/job-statistics/1"


class Ledger:
    """The files of a folder of jobs that say how far it is. Whoever reads them may be killed at any moment."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.place = self.folder / PLACE

    def path(self, what: str, name: str, ending: str = ".json") -> Path:
        """The file of a job: `what` is 'begun', 'logs', 'statistics', 'running' or 'done'."""
        return self.place / what / f"{name}{ending}"

    def finished(self, job: Job, digest: str) -> bool:
        """Whether the job has its marker, of this digest, and its output is there."""
        if job.out is not None and not (self.folder / job.out).exists():
            return False
        return _read(self.path("done", job.name)).get("digest") == digest

    def finish(self, job: Job, digest: str) -> None:
        """Set the marker: the last thing that a job does."""
        atomic.write_json(self.path("done", job.name), {"digest": digest})

    def forget(self, job: Job) -> None:
        """Take away the marker and the statistics: the job is to be done anew."""
        for what in ("done", "statistics"):
            self.path(what, job.name).unlink(missing_ok=True)

    def begin(self, job: Job) -> None:
        """Note that the job may have written its output from now on, so that what is found there is its own.

        Raises FreeArtError when something stands there already although the job never began.
        """
        begun = self.path("begun", job.name)
        if begun.is_file():
            return
        if job.out is not None and (self.folder / job.out).exists():
            raise FreeArtError(f"{self.folder / job.out} exists and was not made by the job '{job.name}'; move it away")
        atomic.write_json(begun, {})

    def say(self, job: Job, digest: str, **facts: Any) -> None:
        """Keep what came of a job: code, last line, seconds."""
        data = {"schema": STATISTICS_SCHEMA, "job": job.name, "digest": digest, **facts}
        atomic.write_json(self.path("statistics", job.name), data)

    def said(self, job: Job, digest: str) -> dict[str, Any]:
        """What was kept of this very job; empty when nothing was."""
        data = _read(self.path("statistics", job.name))
        return data if data.get("digest") == digest else {}


def _read(path: Path) -> dict[str, Any]:
    """The JSON object in `path`; an empty one when there is none, or it is cut short."""
    try:
        return checked.read_json(path)
    except FreeArtError:
        return {}
