"""What changes over the session is no constant of the joint, and has no name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import asset_of, measured_of

from freeart21.files.asset import read_asset
from simgap.judgement import drift
from simgap.workflow import find_gap

RUNS = 8


def oiled(last: float, seed: int = 31):
    """Runs of one session in which the loss to oil goes evenly from 0.2 to `last` N m s/rad."""
    sessions = [measured_of(seed, runs=RUNS, viscous=b) for b in np.linspace(0.2, last, RUNS)]
    return replace(sessions[0], runs=tuple(session.runs[i] for i, session in enumerate(sessions)))


def test_oil_that_warms_up_is_told_and_not_named(tmp_path: Path):
    found = find_gap(read_asset(asset_of(tmp_path), "j"), oiled(0.11))
    assert found.verdict == "unexplained" and not found.effects
    assert "Damping as by oil is not the same all the session: its size falls from 1." in found.sentence
    assert found.next_experiment is not None and "last ones first" in found.next_experiment


def test_oil_that_stays_as_it_is_is_named(tmp_path: Path):
    found = find_gap(read_asset(asset_of(tmp_path), "j"), oiled(0.2))
    assert found.verdict == "named" and [named.effect.name for named in found.effects] == ["viscous_damping"]


@pytest.mark.parametrize("per_session, wild, sure", [(0.0, False, False), (-0.5, False, True), (-0.5, True, True)])
def test_a_line_through_sizes_stands_one_wild_run(per_session: float, wild: bool, sure: bool):
    rng = np.random.default_rng(4)
    turns, speeds = np.arange(10), np.exp(rng.normal(0, 0.5, 10))
    size = 1.0 + per_session * (turns / 9 - 0.5) + 0.1 * np.log(speeds) + rng.normal(0, 0.03, 10)
    size[6] += 0.8 * wild
    found = drift._drift("viscous_damping", size - 1.0, np.full(10, 0.03), turns, speeds)
    assert found is not None and (found.p_value < 1e-3) == sure
    assert found.last - found.first == pytest.approx(per_session, abs=0.1)


def test_runs_that_tell_no_size_do_not_count():
    turns, speeds, spread = np.arange(8), np.ones(8), np.full(8, 0.05)
    spread[:3] = 5.0
    assert drift._drift("viscous_damping", np.zeros(8), spread, turns, speeds) is None
