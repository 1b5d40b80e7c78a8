"""The peers of `gap`: held-back runs, the library's fits, MuJoCo's fit, and the ratios."""

import math

import numpy as np
import pytest
from gap_case import asset_of, measured_of

from benchmarks.gap_peers import compare, fit_all, open_library
from freeart21.files.asset import read_asset


def test_ratios_are_geometric_means_over_delivered_answers():
    errors = {"a": {"nothing": 4.0, "gap": 1.0, "sysid": 2.0}, "b": {"nothing": 2.0, "gap": 1.0, "sysid": None}}
    errors["c"] = {"nothing": 1.0, "gap": 1.0, "sysid": 0.5}
    rows = [{"case": c, "way": w, "error": e} for c, of in errors.items() for w, e in of.items()]
    found = compare(rows, ("nothing", "gap", "sysid"))
    assert found["sysid"]["ratio"] == pytest.approx((0.5 * 0.5 * 2.0) ** (1 / 3))
    logs = np.log([0.5, 0.5, 2.0])
    assert found["sysid"]["standard_error_of_log"] == pytest.approx(logs.std(ddof=1) / math.sqrt(3))
    assert found["sysid"]["worse"] == ["c"] and found["nothing"]["worse"] == []
    assert "gap" not in found


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    """A pendulum whose asset lacks dry friction and damping, five runs, and the names of the held-back ones."""
    measured = measured_of(5, dry=0.06, viscous=0.05, marked=False)
    return asset_of(tmp_path_factory.mktemp("asset")), measured, ["run_4"]


def test_a_fit_of_all_effects_predicts_an_unseen_run(pendulum):
    urdf, measured, untouched = pendulum
    library = open_library(read_asset(urdf), measured, untouched)
    (before,) = library.errors(library.as_delivered())
    fit, claims, _ = fit_all(library, 0.0)
    (after,) = library.errors(fit)
    assert after < 0.1 * before
    assert set(claims) <= set(library.names)


def test_mujoco_identifies_a_pendulum(pendulum):
    from benchmarks.mujoco_sysid import Identification

    urdf, measured, untouched = pendulum
    runs = tuple(run for run in measured.runs if run.name not in untouched)[:2]
    identification = Identification(urdf, measured, runs)
    (run,) = (run for run in measured.runs if run.name in untouched)
    before = identification.score(identification.fit(0.0), run)
    found = identification.fit(60.0, iterations=12)
    assert identification.score(found, run) < 0.2 * before
