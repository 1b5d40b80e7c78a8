"""What is written into the asset and reported: only certain effects, geometry and dynamics separately, timeouts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_gap_show import ARM, INERTIA, MASS, STARTS, G, bob, damped, draft, filmed, held_out, named, pendulum

from freeart21.effects.axis_tilt import AxisTilt
from freeart21.effects.detent import Detent
from freeart21.effects.pivot_offset import PivotOffset
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.files.asset import read_asset
from freeart21.measured import Run
from simgap.geometry.finding import KinematicsFinding
from simgap.geometry.kinematics import find_geometry
from simgap.models.equation_error import estimate_missing_force
from simgap.models.localise import make_residual_maps
from simgap.models.surrogate import Nuisance, make_plant
from simgap.page.publish import _missing_force_inputs, publish
from simgap.prove import replay_process
from simgap.prove.comparison import compare_replays
from simgap.prove.replay import CannotReplay, Replay, RunReplay
from simgap.verdict import GEOMETRY, RunGap, Verdict
from simgap.workflow import join_geometry, select_certain

TILT = AxisTilt(0.02, -0.015)


def make_finding(answer, *effects, rivals=()):
    more = "Tip the base." if rivals else None
    return KinematicsFinding(answer, named(*effects), rivals, (), (), 0.0, more)


def make_verdict(answer, *effects, rivals=(), more=None):
    return Verdict(answer, named(*effects), (), (), rivals, more, "Oil." if answer != "no_gap" else "They agree.")


def names(effects):
    return [n.effect.name for n in effects]


TWO = (("viscous_damping",), ("coulomb_friction",))
CROOKED = (("axis_tilt",), ("pivot_offset",))


@pytest.mark.parametrize(
    ("motion", "geometry", "answer", "counted", "certain", "rivals"),
    [
        (make_verdict("named", ViscousDamping(1.0)), make_finding("named", TILT), "named", 2, 2, 0),
        (make_verdict("no_gap"), make_finding("named", TILT), "named", 1, 1, 0),
        (make_verdict("not_excited", ViscousDamping(1.0)), make_finding("named", TILT), "named", 1, 1, 0),
        (make_verdict("ambiguous", ViscousDamping(1.0), rivals=TWO), make_finding("named", TILT), "ambiguous", 2, 1, 2),
        (
            make_verdict("named", ViscousDamping(1.0)),
            make_finding("ambiguous", TILT, rivals=CROOKED),
            "ambiguous",
            2,
            1,
            2,
        ),
        (
            make_verdict("ambiguous", ViscousDamping(1.0), rivals=TWO, more="Push."),
            make_finding("ambiguous", TILT, rivals=CROOKED),
            *("ambiguous", 2, 0, 4),
        ),
        (make_verdict("unexplained"), make_finding("named", TILT), "unexplained", 1, 1, 0),
        (make_verdict("named", ViscousDamping(1.0)), make_finding("unexplained", TILT), "unexplained", 1, 1, 0),
        (make_verdict("unexplained"), make_finding("ambiguous", TILT, rivals=CROOKED), "unexplained", 0, 0, 0),
        (make_verdict("ambiguous", ViscousDamping(1.0), rivals=TWO), None, "ambiguous", 1, 0, 2),
        (make_verdict("named", ViscousDamping(1.0)), make_finding("no_gap"), "named", 1, 1, 0),
    ],
)
def test_geometry_and_dynamics_are_reported_together(motion, geometry, answer, counted, certain, rivals):
    verdict = join_geometry(motion, geometry, "revolute")
    assert (verdict.verdict, len(verdict.effects), len(verdict.rivals)) == (answer, counted, rivals)
    assert len(select_certain(motion, geometry)) == certain
    assert verdict.sentence.strip() and ": ." not in verdict.sentence and ":  " not in verdict.sentence
    if geometry is not None and geometry.verdict == "named":
        assert "by 1.43°" in verdict.sentence  # never without its number
    if motion.verdict != "no_gap":
        assert motion.sentence in verdict.sentence
    for more in (motion.next_experiment, geometry and geometry.next_experiment):
        assert more is None or more in (verdict.next_experiment or "")


def test_uncertain_effects_are_not_written(tmp_path: Path):
    asset, measured = bob(tmp_path / "a", '<dynamics damping="0.01"/>'), held_out(pendulum(STARTS, damped), 1)
    drafted = draft(measured, STARTS, ViscousDamping(0.02), answer="ambiguous")
    verdict = publish(asset, measured, drafted, tmp_path / "out", "bob")
    assert (verdict.verdict, verdict.added) == ("ambiguous", ())
    assert names(verdict.effects) == ["viscous_damping"]
    assert read_asset(tmp_path / "out/asset").effects == {"j": (ViscousDamping(0.01),)}
    data = json.loads((tmp_path / "out/verdict.json").read_text())
    assert data["added"] == [] and data["effects"][0]["name"] == "viscous_damping"
    page = (tmp_path / "out/index.html").read_text()
    assert "not written" in page and "What was written" not in page


def test_geometry_repair_survives_a_harmful_dynamics_repair(tmp_path: Path):
    asset = bob(tmp_path / "a")
    measured, true = filmed(replace(asset, effects={"j": (TILT, PivotOffset(0.01, 0.006), ViscousDamping(0.03))}))
    geometry = find_geometry(asset, measured)
    assert geometry is not None and geometry.verdict == "named"
    starts = tuple(start for _, start in true)
    wrong = draft(measured, starts, *geometry.effects, ReturnSpring(3.0, 0.0), geometry=geometry)
    verdict = publish(asset, measured, wrong, tmp_path / "out", "half")
    assert verdict.verdict == "unexplained"
    assert sorted(verdict.added) == sorted(names(verdict.effects)) == ["axis_tilt", "pivot_offset"]
    assert read_asset(tmp_path / "out/asset").effects["j"] == geometry.effects
    gaps = {gap.regime: gap for gap in verdict.gaps if gap.held_out}
    assert gaps[GEOMETRY].after < 0.4 * gaps[GEOMETRY].before
    assert gaps["fast"].after == gaps["fast"].before
    assert (
        "This is repaired" in verdict.sentence
        and "return_spring was tried" in (tmp_path / "out/index.html").read_text()
    )


def test_a_replay_timeout_is_reported(tmp_path: Path):
    asset, measured = bob(tmp_path / "a"), held_out(pendulum(STARTS, damped), 1, 2)
    drafted = draft(measured, STARTS, ViscousDamping(0.03))
    verdict = publish(asset, measured, drafted, tmp_path / "out", "late", replay_seconds=0.1)
    assert (verdict.verdict, verdict.added) == ("named", ("viscous_damping",))
    assert "SAPIEN has not confirmed it" in verdict.sentence
    assert read_asset(tmp_path / "out/asset").effects == {"j": (ViscousDamping(0.03),)}
    page = (tmp_path / "out/index.html").read_text()
    assert "more than 0.1 s and was given up: 0 of 2 runs" in page
    steps: list[tuple[int, int]] = []
    publish(asset, measured, drafted, tmp_path / "in_time", "in time", progress=lambda *of: steps.append(of))
    assert steps[0] == (0, 4) and (4, 4) in steps


def test_effects_that_sapien_cannot_step_are_not_written(tmp_path: Path, monkeypatch):
    def stiff(*_, **__):
        raise CannotReplay("shorten timestep_s")

    asset, measured = bob(tmp_path / "a"), held_out(pendulum(STARTS[:2], damped, seconds=1.0), 1)
    drafted = draft(measured, STARTS[:2], Detent(1e4, 0.3, 1e-5))
    monkeypatch.setattr("simgap.page.publish.replay", stiff)
    verdict = publish(asset, measured, drafted, tmp_path / "out", "stiff")
    assert (verdict.verdict, verdict.added) == ("unexplained", ())
    assert "shorten timestep_s" in (tmp_path / "out/index.html").read_text()


class _Stage:
    def __init__(self, stiff: float):
        self.stiff = stiff

    def load(self, h: float) -> float:
        return h

    def replay(self, loaded, h, run, start):
        return np.full(20, self.stiff * h**2)


def run_of(off: float, seconds: float = 2.0) -> Run:
    """A run with this constant error against a simulation at zero."""
    return Run("run", np.linspace(0, seconds, 20), np.full(20, off))


def test_replay_time_step_is_chosen_per_run():
    def needed(stiff: float, run: Run | None = None) -> tuple[float, float]:
        run = run or run_of(0.0)
        q, h, numerics = replay_process._replay_converged(_Stage(stiff), run, (0.0, 0.0), 1e-3, 2e-3)
        np.testing.assert_allclose(q, stiff * h**2)  # the finest that was tried
        return h, numerics

    (smooth, at_once), (stiff, later) = needed(1e-3), needed(1e2)
    assert smooth == 1e-3 and stiff == 5e-4 and max(at_once, later) < replay_process.ENOUGH
    h, numerics = needed(1e9)  # and does not go on for ever
    assert h == 2e-3 / 2**replay_process.HALVINGS and numerics > 1
    assert needed(1e6, run_of(1e3))[0] == 1e-3  # off by so much that no step matters
    long = 0.9 * replay_process.MOST_STEPS * 1e-3
    assert needed(1e9, run_of(0.0, seconds=long))[0] == 1e-3


@pytest.mark.parametrize("change, counted", [(0.9, ["run_0", "run_1"]), (40.0, ["run_0"]), (None, ["run_1"])])
def test_a_run_sensitive_to_the_time_step_does_not_count(change: float | None, counted: list[str]):
    """The repaired gap is 100 times the noise; halving the time step changes it by `change` (None: both change)."""

    def make_replay(name: str, off: float, change: float) -> RunReplay:
        return RunReplay(name, np.arange(20.0), np.zeros(20), np.full(20, off), 1e-3, (0.0, 0.0), 1e-3, change)

    first = (make_replay("run_0", 0.0, 0.02 if change else 7.0), make_replay("run_1", 0.0, 0.02))
    second = (make_replay("run_0", 0.0, 0.05), make_replay("run_1", 0.1, change or 0.05))
    gaps = [RunGap(f"run_{i}", 0.0, 0.0, 0.0, True, "", "confirming") for i in (0, 1)]
    seen = compare_replays(Replay("sapien", "3", first), Replay("sapien", "3", second), 1e-3, gaps)
    assert [run.run for run in seen.runs] == counted
    assert sorted([*counted, *(run.run for run in seen.inconclusive)]) == ["run_0", "run_1"] and seen.numerics < 1


def test_asset_errors_do_not_localise_a_gap(tmp_path: Path):
    """Base tilt, inertia and weight errors are part of the maps as of the fit."""
    weight = MASS * G * ARM
    starts = ((1.2, 0.0), (0.6, 0.5), (-1.5, 0.0), (0.9, 1.0))

    def lean(s, q, qd):
        return 0.02 * weight * np.cos(q)

    asset, measured = bob(tmp_path / "a"), pendulum(starts, lean, seconds=5.0, inertia=1.06 * INERTIA, gravity=0.97)
    plant = make_plant(asset, measured)
    leans = float(np.sign(plant.gravity_terms[1, 0])) * 0.02 / 0.97
    naive, known = (
        make_residual_maps(estimate_missing_force(*_missing_force_inputs(measured, plant, nuisance)))
        for nuisance in (Nuisance(), Nuisance(1.06, 0.97, (leans, 0.0)))
    )
    assert min(m.adjusted for m in naive) < 0.01
    assert min(m.adjusted for m in known) > 0.05
    quiet = replace(draft(measured, starts, answer="no_gap"), motion_differs=False)
    verdict = publish(asset, measured, quiet, tmp_path / "out", "leaning")
    assert verdict.where == () and "Where it shows" not in (tmp_path / "out/index.html").read_text()
