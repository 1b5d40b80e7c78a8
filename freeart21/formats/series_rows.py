"""Rows of a recording as people have them, put in order: what came late, what is missing, what was leapt over."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files.measured import MIN_SAMPLES
from freeart21.se3 import Array

_SWAPPED, _SWAPPED_STEPS = 0.05, 10
"""Share of rows that may come after later ones, and by how many steps at most, before it is another recording. Not
measured: a network swaps neighbours, a second recording begins anew."""


@dataclass(frozen=True)
class Raw:
    """One run in the units of its file."""

    name: str
    values: dict[str, Array]
    """Role to (n,) numbers."""


def rising(run: Raw, notes: list[str]) -> Raw:
    """A run without rows whose time is missing or that of the row before."""
    run = _in_order(run, notes)
    t = run.values["t"]
    kept = np.isfinite(t)
    kept[np.flatnonzero(kept)[1:]] = np.diff(t[kept]) != 0
    if kept.sum() < MIN_SAMPLES:
        raise FreeArtError(f"run '{run.name}' has {kept.sum()} rows of different times, expected {MIN_SAMPLES} or more")
    rows, back = np.flatnonzero(kept), np.diff(t[kept]) < 0
    if back.any():
        row = rows[int(np.argmax(back)) + 1]
        raise FreeArtError(
            f"run '{run.name}': time goes back from {t[kept][int(np.argmax(back))]:g} to {t[row]:g} in row {row + 1}, "
            "expected rising times: a second recording? Give each a file of its own"
        )
    if not kept.all():
        notes.append(f"{run.name}: {int((~kept).sum())} rows whose time is missing or not a new one were left out")
    return replace(run, values={role: v[kept] for role, v in run.values.items()})


def _in_order(run: Raw, notes: list[str]) -> Raw:
    """A run whose rows came a little out of order, as they do over a network, in the order of their times."""
    t = run.values["t"]
    known = np.flatnonzero(np.isfinite(t))
    steps = np.diff(t[known])
    back = steps < 0
    if not back.any() or back.sum() > _SWAPPED * len(t):
        return run
    if (np.maximum.accumulate(t[known]) - t[known]).max() > _SWAPPED_STEPS * np.median(np.abs(steps)):
        return run
    order = known[np.argsort(t[known], kind="stable")]
    notes.append(f"{run.name}: {int(back.sum())} rows came after later ones, and were put in order")
    return replace(run, values={role: values[order] for role, values in run.values.items()})


def trim_start(run: Raw, notes: list[str]) -> Raw:
    """A run from the first row on in which every drive has a value: what drove it before is not known."""
    drives = [role for role in ("effort", "q_command", "voltage") if role in run.values]
    known = [np.isfinite(run.values[role]) for role in drives]
    for role, there in zip(drives, known, strict=True):
        if not there.any():
            raise FreeArtError(f"run '{run.name}': {role} has no value at all; leave it out, or the run")
    first = max((int(np.argmax(there)) for there in known), default=0)
    if first == 0:
        return run
    if len(run.values["t"]) - first < MIN_SAMPLES:
        raise FreeArtError(
            f"run '{run.name}': {' and '.join(drives)} begin in row {first + 1} of {len(run.values['t'])}, expected "
            f"{MIN_SAMPLES} rows or more from there on"
        )
    notes.append(f"{run.name}: the first {first} rows were left out: no value of {' and '.join(drives)} is known there")
    return replace(run, values={role: values[first:] for role, values in run.values.items()})
