"""Predictive density of held-out runs, and effects named in part by it; about 40 s."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import asset_of, measured_of
from scipy.stats import multivariate_t

from freeart21.files.asset import read_asset
from simgap.select.predictive import (
    DECISIVE_LOG_ODDS,
    DEGREES_OF_FREEDOM,
    Score,
    log_densities,
    score_difference,
    select_smallest,
)
from simgap.verdict import Verdict
from simgap.workflow import find_gap


def test_predictive_density_is_a_student_t():
    rng = np.random.default_rng(0)
    times, left = np.cumsum(rng.uniform(0.002, 0.03, 60)), rng.normal(0, 3, 60)
    K = np.eye(60) + 2.5**2 * np.exp(-np.abs(times[:, None] - times) / 0.2)
    densities = log_densities(left, times, 2.5, 0.2)
    for n in (1, 7, 60):
        dense = multivariate_t(np.zeros(n), K[:n, :n], df=DEGREES_OF_FREEDOM).logpdf(left[:n])
        assert densities[n - 1] == pytest.approx(dense, abs=1e-9)


def test_smallest_model_within_one_standard_error_is_chosen():
    even = np.array([3.0, -3.0, 3.0, -3.0, 3.0, -3.0, 3.0, -3.0])
    best = Score(("a", "b"), np.full(8, 10.0) + even)
    pair = Score(("a", "c"), np.full(8, 9.9) - even)
    one, far = Score(("a",), np.full(8, 5.0)), Score(("b",), np.full(8, 9.0) + even)
    assert score_difference(best, far) == pytest.approx((8.0, DECISIVE_LOG_ODDS))
    assert [s.names for s in select_smallest([pair, one, best, far])] == [("a", "b"), ("a", "c")]
    near = replace(one, parts=best.parts - 0.1 + 0.2 * even)
    assert [s.names for s in select_smallest([pair, near, best, far])] == [("a",)]


def verdict(folder: Path, seed: int, **hidden: float) -> Verdict:
    return find_gap(read_asset(asset_of(folder), "j"), measured_of(seed, **hidden))


def test_a_dominant_effect_is_named_in_part(tmp_path: Path):
    found = verdict(tmp_path, 4, dry=0.12, drag=0.06, cog=0.1, count=9.0, seconds=4.0)  # cogging is in no library
    assert found.verdict in ("named", "ambiguous") and found.in_part, found
    dry = {"coulomb_friction", "load_friction", "stribeck_friction"}
    sets = found.rivals or [tuple(named.effect.name for named in found.effects)]
    assert all("quadratic_drag" in names and dry & set(names) and len(names) == 2 for names in sets)
    sizes = {named.effect.name: named.effect for named in found.effects}
    assert sizes["quadratic_drag"].values()[0] == pytest.approx(0.06, rel=0.2)
    assert "has no name" in found.sentence
    assert found.to_json("revolute")["in_part"] is True
