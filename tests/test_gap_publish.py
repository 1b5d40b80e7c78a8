"""What is written into the asset and reported: only certain effects, geometry and dynamics separately, timeouts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from test_gap_show import STARTS, bob, damped, draft, filmed, held_out, named, pendulum

from freeart21.effects.axis_tilt import AxisTilt
from freeart21.effects.pivot_offset import PivotOffset
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.files.asset import read_asset
from simgap.geometry.finding import KinematicsFinding
from simgap.geometry.kinematics import find_geometry
from simgap.page.publish import publish
from simgap.verdict import GEOMETRY, Verdict
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
        (
            make_verdict("ambiguous", ViscousDamping(1.0), rivals=TWO, more="Push."),
            make_finding("ambiguous", TILT, rivals=CROOKED),
            *("ambiguous", 2, 0, 4),
        ),
        (make_verdict("named", ViscousDamping(1.0)), make_finding("unexplained", TILT), "unexplained", 1, 1, 0),
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
