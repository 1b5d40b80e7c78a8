"""A change over the session is not a constant of the joint and is not named."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from gap_case import asset_of, measured_of

from freeart21.files.asset import read_asset
from simgap.workflow import find_gap

RUNS = 8


def oiled(last: float, seed: int = 31):
    """Runs of one session in which viscous damping changes linearly from 0.2 to `last` N m s/rad."""
    sessions = [measured_of(seed, runs=RUNS, viscous=b) for b in np.linspace(0.2, last, RUNS)]
    return replace(sessions[0], runs=tuple(session.runs[i] for i, session in enumerate(sessions)))


def test_warming_damping_is_reported_but_not_named(tmp_path: Path):
    found = find_gap(read_asset(asset_of(tmp_path), "j"), oiled(0.11))
    assert found.verdict == "unexplained" and not found.effects
    assert "a size that changes over the session" in found.sentence
    told = re.search(r"viscous damping changes by (-\d+)%", found.sentence)
    assert told is not None and -70 < float(told[1]) < -40, found.sentence  # of .155 in the middle .09 less
    assert found.next_experiment is not None and "last ones first" in found.next_experiment
