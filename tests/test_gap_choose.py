"""Verdicts on motions integrated by equations independent of the product: named, inconclusive, refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import ARM, INERTIA, MASS, G, asset_of, measured_of, problem_of

from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.measured import Measured
from simgap.fit.fit import Fit, Model
from simgap.fit.problem import Problem, without_asset_error
from simgap.select.experiment import next_experiment
from simgap.select.split import split_runs
from simgap.verdict import Verdict
from simgap.workflow import find_gap


def verdict(folder: Path, measured: Measured, lower: float = -3.0, upper: float = 3.0) -> Verdict:
    return find_gap(read_asset(asset_of(folder, lower, upper), "j"), measured)


@pytest.fixture(scope="module")
def damped(tmp_path_factory: pytest.TempPathFactory) -> Verdict:
    """Verdict on runs with a nearly viscous loss."""
    return verdict(tmp_path_factory.mktemp("damped"), measured_of(11, viscous=0.12, power=0.98))


def names(found: Verdict) -> set[str]:
    return {named.effect.name for named in found.effects}


@pytest.mark.parametrize("seed, servo", [(0, False), (1, True)])
def test_a_complete_asset_has_no_gap(tmp_path: Path, seed: int, servo: bool):
    found = verdict(tmp_path, measured_of(seed, servo=servo))
    assert found.verdict == "no_gap" and not found.effects and not found.rivals
    assert found.corrections and max(gap.before / gap.floor for gap in found.gaps) > 2  # its inertia and base are off
    assert all(gap.after < 1.3 * gap.floor for gap in found.gaps)


@pytest.mark.parametrize(
    "hidden, expected",
    [
        ({"spring": 2.0, "rest": 0.3, "seconds": 3.0}, "return_spring"),
        ({"viscous": 100.0}, "viscous_damping"),  # its speed is gone in a 240th of a second, and it creeps
    ],
)
def test_a_clear_effect_is_named(tmp_path: Path, hidden: dict[str, float], expected: str):
    agrees(verdict(tmp_path, measured_of(11, **hidden)), expected)


def test_a_named_loss_is_written_to_the_asset(damped: Verdict, tmp_path: Path):
    agrees(damped, "viscous_damping")
    damped.write(tmp_path / "verdict.json", "revolute")
    document = json.loads((tmp_path / "verdict.json").read_text())
    assert document["verdict"] == "named" and document["effects"][0]["name"] == "viscous_damping"
    coefficient = document["effects"][0]["parameters"]["coefficient"]
    assert coefficient["unit"] == "N*m*s/rad" and coefficient["low"] < coefficient["value"] < coefficient["high"]
    assert [gap["held_out"] for gap in document["gap"]] == [False] * 3 + [True] * 2


def agrees(found: Verdict, expected: str) -> None:
    assert (found.verdict, names(found)) == ("named", {expected})
    held = [gap for gap in found.gaps if gap.held_out]
    assert len(held) == 2 and all(gap.after < 0.2 * gap.before for gap in held)
    low, high = found.effects[0].low, found.effects[0].high
    assert all(low[k] <= getattr(found.effects[0].effect, k) <= high[k] for k in low)


def test_restitution_is_named(tmp_path: Path):
    measured = measured_of(12, lower=-0.5, upper=1.6, bounce=0.6)
    found = verdict(tmp_path, measured, -0.5, 1.6)
    assert (found.verdict, names(found)) == ("named", {"end_stop_bounce"})
    assert found.effects[0].effect.restitution == pytest.approx(0.6, abs=0.03)


def test_a_pair_is_named_that_single_steps_miss(tmp_path: Path):
    """Coulomb friction with quadratic drag resembles viscous damping, which a stepwise search would name."""
    found = verdict(tmp_path, measured_of(13, dry=0.1, drag=0.05, seconds=4.0))
    assert (found.verdict, names(found)) == ("named", {"coulomb_friction", "quadratic_drag"})


def test_friction_with_damping_is_not_load_friction(tmp_path: Path):
    """On a swing, load friction varies with speed squared leaving hardly more than noise; the pair is more probable."""
    found = verdict(tmp_path, measured_of(23, dry=0.5, viscous=0.1, seconds=1.5))
    assert (found.verdict, names(found)) == ("named", {"coulomb_friction", "viscous_damping"})


def test_a_notch_of_another_shape_is_one_notch(tmp_path: Path):
    """Two lobes of bounded support, unlike a Gaussian: the remainder is not a second detent."""
    found = verdict(tmp_path, measured_of(6, groove=0.6, centre=-0.2, width=0.1, servo=True))
    assert (found.verdict, names(found), found.in_part) == ("named", {"detent"}, False)
    (notch,) = found.effects
    assert notch.effect.peak == pytest.approx(0.6, rel=0.15) and notch.effect.tail < 0.4


def test_chaotic_runs_do_not_decide(tmp_path: Path):
    """One fitted and one held-out run diverge from the middle on, as if someone had bumped the table."""
    measured = measured_of(25, runs=9, viscous=0.12)
    bumped = []
    for i, run in enumerate(measured.runs):
        half = len(run.q) // 2
        q = np.concatenate([run.q[:half], 0.7 * run.q[half:] + 0.3]) if i in (1, 6) else run.q
        bumped.append(replace(run, q=q, held_out=i >= 5))
    found = verdict(tmp_path, replace(measured, runs=tuple(bumped)))
    assert (found.verdict, names(found)) == ("named", {"viscous_damping"})
    assert found.effects[0].effect.coefficient == pytest.approx(0.12, rel=0.1)


def test_zero_offset_and_tilted_base_are_rivals(tmp_path: Path):
    found = verdict(tmp_path, measured_of(14, offset=0.15))
    assert found.verdict == "ambiguous"
    assert {("encoder_offset",), ("gravity_offset",)} <= set(found.rivals)
    assert found.next_experiment and "the explanations then differ by" in found.next_experiment


def test_drive_delay_and_clock_delay_are_rivals(tmp_path: Path):
    found = verdict(tmp_path, measured_of(15, servo=True, delay=0.03))
    assert found.verdict == "ambiguous" and {("actuator_delay",), ("time_offset",)} <= set(found.rivals)


def test_friction_of_gears_is_named_beside_a_servo_s_gain_and_dry_friction(tmp_path: Path):
    found = verdict(tmp_path, measured_of(31, servo=True, gears=0.15, gain=1.3, dry=0.5, runs=4, seconds=1.5))
    assert found.verdict == "named" and names(found) == {"gear_friction", "actuator_gain", "coulomb_friction"}, found
    gears = next(named for named in found.effects if named.effect.name == "gear_friction")
    assert gears.low["coefficient"] < 0.15 < gears.high["coefficient"]
    assert gears.effect.values()[0] == pytest.approx(0.15, rel=0.2)


def test_a_force_outside_the_library_is_not_named(tmp_path: Path):
    found = verdict(tmp_path, measured_of(16, cog=0.4, count=7.0, runs=4))
    assert found.verdict == "unexplained" and not found.effects


def test_a_hardening_spring_is_named_a_spring_alone(tmp_path: Path):
    """A linear spring leaves far more than noise, which a second effect could absorb."""
    found = verdict(tmp_path, measured_of(11, spring=8.0, rest=0.3, hardens=0.05, runs=4, seconds=1.2))
    assert names(found) <= {"return_spring"}, found


def at(model: Model, **real: float) -> np.ndarray:
    """Neutral values except for these parameters."""
    return np.array([real.get(r.name, x) for r, x in zip(model.ranges(), model.neutral(), strict=True)])


def test_a_joint_that_hardly_moves_is_refused(tmp_path: Path):
    found = verdict(tmp_path, measured_of(17, largest=4e-3, dry=0.0, viscous=0.3, seconds=4.0))
    assert found.verdict == "not_excited" and found.next_experiment


def test_without_marks_runs_are_cross_validated(tmp_path: Path):
    measured = measured_of(18, marked=False, viscous=0.1, runs=3, seconds=3.0)
    found = verdict(tmp_path, measured)
    assert (found.verdict, names(found)) == ("named", {"viscous_damping"})
    _, runs = problem_of(tmp_path, measured)
    folds = split_runs(runs).folds
    assert sorted(run.name for fold in folds for run in fold.test) == sorted(run.name for run in runs)
    assert all(not {r.name for r in fold.train} & {r.name for r in fold.test} for fold in folds)


def test_the_wrong_joint_is_a_one_line_error(tmp_path: Path):
    asset = read_asset(asset_of(tmp_path), "j")
    for wrong, message in (
        ({"joint": "k"}, "it has no movable joint 'k'"),
        ({"joint_type": "prismatic"}, "is revolute"),
    ):
        with pytest.raises(FreeArtError, match=message) as caught:
            find_gap(asset, replace(measured_of(0), **wrong))
        assert "\n" not in str(caught.value)


def test_warming_damping_is_reported_but_not_named(tmp_path: Path):
    """Runs of one session in which viscous damping falls from 0.2 to 0.11 N m s/rad."""
    sessions = [measured_of(31, runs=8, viscous=b) for b in np.linspace(0.2, 0.11, 8)]
    found = verdict(tmp_path, replace(sessions[0], runs=tuple(s.runs[i] for i, s in enumerate(sessions))))
    assert found.verdict == "unexplained" and not found.effects
    assert "a size that changes over the session" in found.sentence
    match = re.search(r"viscous damping changes by (-\d+)%", found.sentence)
    assert match is not None and -70 < float(match[1]) < -40, found.sentence  # of .155 in the middle .09 less
    assert found.next_experiment is not None and "last ones first" in found.next_experiment


# --- experiments, designed from what the rivals predict ---------------------------------------------------------------


@pytest.fixture
def problem(tmp_path: Path) -> Problem:
    """A free pendulum without asset uncertainty."""
    return without_asset_error(problem_of(tmp_path, measured_of(3, runs=2))[0])


def fit(problem: Problem, name: str, *values: float) -> Fit:
    """A fit of one effect with known parameters."""
    model = Model(problem, (name,))
    count = len(model.ranges())
    assert count == len(values)
    return Fit(model, np.array(values), {}, {}, 0.0, np.eye(count))


def test_an_experiment_separates_all_rivals(problem: Problem):
    """10 % more inertia swings as weaker gravity; a known push separates them, and both from damping."""
    heavier = fit(problem, "armature", 0.1 * INERTIA)
    weaker = fit(problem, "gravity_offset", 0.0, MASS * G * ARM / 11)
    damped = fit(problem, "viscous_damping", 0.06)
    assert next_experiment([heavier, weaker]).startswith("Push it to and fro with a known")
    assert "the explanations then differ by at least" in next_experiment([heavier, weaker, damped])
