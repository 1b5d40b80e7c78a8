"""Presliding friction, and forces and frictions of any shape over position."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from gap_case import asset_of, measured_of

from freeart21.effects import EFFECTS
from freeart21.files.asset import read_asset
from simgap.fit.fit import Model, ParameterMap, fit_model, predict_readings
from simgap.fit.model import repeats_family
from simgap.fit.problem import make_problem
from simgap.fit.search import Search, list_candidates
from simgap.measure.data import make_fit_runs
from simgap.models import kernel
from simgap.models.surrogate import make_plant
from simgap.select.choose import choose_hypotheses
from simgap.select.split import split_runs
from simgap.settings import GapSettings

HIDDEN = {
    "presliding_friction": {"level": 0.15, "travel": 0.08},
    "force_over_position": {f"force_{k + 1}": x for k, x in enumerate((-0.3, 0.1, 0.4, 0.5, 0.2, 0.3, 0.6, 0.1))},
    "friction_over_position": {f"level_{k + 1}": 0.02 + 0.3 * (k in (2, 5)) for k in range(8)},
}


def test_presliding_friction_dissipates_only_sliding():
    """Loss per cycle is 4 * level * (amplitude - travel), zero within the travel (Dupont et al. 2002)."""
    law, remember, level, travel = *(getattr(EFFECTS["presliding_friction"], k) for k in ("law", "remember")), 0.3, 0.02
    for amplitude, expected in ((0.1, 4 * 0.3 * 0.08), (0.019, 0.0)):
        q = amplitude * np.sin(np.linspace(0, 4 * np.pi, 40_001))
        anchor, work = remember(0.0, 0.0, level, travel), []
        for a, b in pairwise(q):
            work.append(-law(0.5 * (a + b), 0.0, 0.0, anchor, level, travel) * (b - a))
            anchor = remember(b, anchor, level, travel)
        assert sum(work[20_000:]) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(("name", "said"), list(zip(HIDDEN, [*list(HIDDEN)[:2], "coulomb_friction"], strict=True)))
def test_a_shape_over_position_is_named(tmp_path: Path, name: str, said: str):
    """Common effects come first: friction that varies with position is dry friction, in part."""
    measured, settings = measured_of(5, exact=True, marked=False), GapSettings()
    plant = make_plant(read_asset(asset_of(tmp_path), "j"), measured)
    runs, noise = make_fit_runs(measured, plant)
    problem = make_problem(plant, measured, runs, noise)
    model = Model(problem, (name,), instant_friction=True)
    theta = np.array([HIDDEN[name].get(r.name, x) for r, x in zip(model.ranges(), model.neutral(), strict=True)])
    true = fit_model(model, runs, theta, iterations=0)
    rng = np.random.default_rng(0)
    runs = tuple(replace(run, q=predict_readings(true, run) + run.sigma * rng.normal(size=len(run.q))) for run in runs)
    split = split_runs(runs)
    search = Search(problem, split.train_runs, list_candidates(problem, split.train_runs))
    choice = choose_hypotheses(search, split.folds, settings.judgement)
    assert choice.accepted and choice.accepted[0].names == (said,) and choice.in_part == (said != name), choice
    assert not any(repeats_family(names) for names in search.fits)


def test_presliding_friction_starts_where_that_of_bearings_ends(tmp_path: Path):
    """The effect's own travel starts where that of all dry friction ends."""
    measured = measured_of(5, exact=True, marked=False)
    plant = make_plant(read_asset(asset_of(tmp_path), "j"), measured)
    runs, noise = make_fit_runs(measured, plant)
    model = Model(make_problem(plant, measured, runs, noise), ("coulomb_friction",))
    theta = np.array([r.upper if r.name == "travel_root" else r.neutral for r in model.ranges()])
    own = Model(model.problem, ("presliding_friction",)).ranges()
    least = next(r.lower for r in own if (r.owner, r.name) == ("presliding_friction", "travel"))
    assert least == pytest.approx(ParameterMap(model).vector(theta)[0][kernel.TRAVEL])


def test_a_set_has_one_effect_of_a_family():
    assert repeats_family(("coulomb_friction", "presliding_friction"))
    assert repeats_family(("presliding_friction", "stribeck_friction", "viscous_damping"))
    assert not repeats_family(("load_friction", "presliding_friction"))
