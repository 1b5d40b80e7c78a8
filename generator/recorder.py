"""Records one object: a sequence folder, for methods, and a truth folder, which they must not see."""

from __future__ import annotations

from pathlib import Path

from freeart21.catalog import built_in_names
from generator.dataset import Job, plan_jobs, record_jobs
from generator.session import LICENCES, nice_scale
from generator.settings import RecordSettings

__all__ = ["LICENCES", "Job", "RecordSettings", "built_in_names", "nice_scale", "record"]


def record(name: str, out: Path, settings: RecordSettings | None = None) -> str:
    """Record the object `name` of the catalog into the data folder `out`; returns the sequence's name.

    Writes `out/sequences/SEQ` and `out/truth/SEQ`, both or neither, and updates `out/benchmark.json`. A sequence that
    exists with the same settings is kept. Progress is shown when standard error is a terminal. Raises FreeArtError when
    the object is unknown, its files are unfit, the sequence exists with other settings, or this machine cannot render.
    """
    jobs = plan_jobs([name], settings or RecordSettings())
    record_jobs(out, jobs)
    return jobs[0].sequence
