"""Cleans the rows of a recording: sorts late rows, drops rows without a new time or before the first drive value."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files.measured import MIN_SAMPLES
from freeart21.se3 import Array

_SWAPPED, _SWAPPED_STEPS = 0.05, 10
"""Largest share of late rows, and by how many steps, in one recording: networks swap neighbours, while a second
recording starts again. Not measured."""


@dataclass(frozen=True)
class RawRun:
    """One run in the units of its file."""

    name: str
    values: dict[str, Array]
    """Role to (n,) numbers."""


def remove_bad_times(run: RawRun, notes: list[str]) -> RawRun:
    """The run without rows whose time is missing or repeated. FreeArtError when time goes back."""
    run = _sort_rows(run, notes)
    t = run.values["t"]
    valid = np.isfinite(t)
    valid[np.flatnonzero(valid)[1:]] = np.diff(t[valid]) != 0
    if valid.sum() < MIN_SAMPLES:
        raise FreeArtError(
            f"run '{run.name}' has {valid.sum()} rows of different times, expected {MIN_SAMPLES} or more"
        )
    rows, back = np.flatnonzero(valid), np.diff(t[valid]) < 0
    if back.any():
        row = rows[int(np.argmax(back)) + 1]
        raise FreeArtError(
            f"run '{run.name}': time goes back from {t[valid][int(np.argmax(back))]:g} to {t[row]:g} in row {row + 1}, "
            "expected increasing times. Is it a second recording? Give each its own file"
        )
    if not valid.all():
        notes.append(f"{run.name}: {int((~valid).sum())} rows without a new time were left out")
    return replace(run, values={role: v[valid] for role, v in run.values.items()})


def _sort_rows(run: RawRun, notes: list[str]) -> RawRun:
    """The run with its rows sorted by time, if they are only slightly out of order, as after a network."""
    t = run.values["t"]
    known = np.flatnonzero(np.isfinite(t))
    steps = np.diff(t[known])
    back = steps < 0
    if not back.any() or back.sum() > _SWAPPED * len(t):
        return run
    if (np.maximum.accumulate(t[known]) - t[known]).max() > _SWAPPED_STEPS * np.median(np.abs(steps)):
        return run
    order = known[np.argsort(t[known], kind="stable")]
    notes.append(f"{run.name}: {int(back.sum())} rows came late, and were sorted")
    return replace(run, values={role: values[order] for role, values in run.values.items()})


def trim_start(run: RawRun, notes: list[str]) -> RawRun:
    """The run from the first row where every drive has a value: the drive before is unknown."""
    drives = [role for role in ("effort", "q_command", "voltage") if role in run.values]
    known = [np.isfinite(run.values[role]) for role in drives]
    for role, there in zip(drives, known, strict=True):
        if not there.any():
            raise FreeArtError(f"run '{run.name}': {role} has no value; leave out the column or the run")
    first = max((int(np.argmax(there)) for there in known), default=0)
    if first == 0:
        return run
    if len(run.values["t"]) - first < MIN_SAMPLES:
        raise FreeArtError(
            f"run '{run.name}': {' and '.join(drives)} begin in row {first + 1} of {len(run.values['t'])}, expected "
            f"{MIN_SAMPLES} rows or more from there on"
        )
    notes.append(f"{run.name}: the first {first} rows were left out: they have no {' and '.join(drives)}")
    return replace(run, values={role: values[first:] for role, values in run.values.items()})
