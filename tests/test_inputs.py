"""What drives a joint between the rows of its log: followed exactly where it is known, no effect where nobody knows."""

from __future__ import annotations

import html
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import INERTIA, RATE, SERVO, G, asset_of, measured_of, replay_both

from freeart21.files.asset import read_asset
from freeart21.files.measured_writer import write_measured
from freeart21.measured import Measured, Run
from freeart21.mechanics import Actuator, interpolate_series, interpolation_terms
from generator.simulate import roll_out
from simgap import commands
from simgap.measure.data import thinning_notes, thinning_stride
from simgap.measure.inputs import logged_at, make_inputs
from simgap.models.surrogate import Nuisance, make_plant, simulate
from simgap.workflow import find_gap

TIMES = np.array([0.0, 0.1, 0.25, 0.3, 0.5, 0.6])
VALUES = np.array([0.0, 1.0, -1.0, 2.0, 2.0, 0.5])
HOW = pytest.mark.parametrize("how", ["held", "linear", "unknown"])


def wave(t):
    """A command as a planner has it, rad."""
    return 0.4 * np.sin(4 * np.asarray(t)) + 0.2 * np.sin(9 * np.asarray(t) + 1)


def driven(rows: int, rate: float, how: str, effort: bool = False) -> Measured:
    """A set of one run that is driven by `wave`, logged at `rate`."""
    times = np.arange(rows) / rate
    run = Run("r", times, 0 * times, wave(times) if effort else None, None if effort else wave(times))
    law = None if effort else Actuator(None, *SERVO)
    kind = "commanded" if effort else None
    return Measured("j", "revolute", np.array([0, 0, -G]), rate, "recorded", kind, law, 0, 0, (run,), how)  # type: ignore[arg-type]


def test_a_straight_line_goes_from_row_to_row_and_a_smooth_one_through_them():
    straight, smooth = (interpolate_series(TIMES, VALUES, how, holding=0.0) for how in ("linear", "unknown"))
    at = np.linspace(-0.1, 0.8, 91)
    assert [straight(t) for t in at] == pytest.approx(np.interp(at, TIMES, VALUES))
    assert [smooth(t) for t in TIMES] == pytest.approx(VALUES) and smooth(-1) == 0.0 and smooth(9) == 0.5
    parabola = interpolate_series(TIMES, 3 * TIMES**2 - TIMES, "unknown", holding=0.0)
    assert [parabola(t) for t in at[10:70]] == pytest.approx(3 * at[10:70] ** 2 - at[10:70])
    half = interpolate_series(TIMES, VALUES, "unknown", holding=0.5)
    assert half(0.2) == pytest.approx(0.5 * (interpolate_series(TIMES, VALUES, "held")(0.2) + smooth(0.2)))
    assert interpolate_series(TIMES, VALUES, "unknown", holding=1.0)(0.2) == 1.0


@HOW
def test_the_mean_over_a_step_has_the_impulse(how: str):
    value, mean = (interpolate_series(TIMES, VALUES, how, over, 0.3) for over in (0.0, 0.07))
    for t in (-0.2, 0.0, 0.02, 0.13, 0.27, 0.55, 0.59, 0.9):
        fine = t + 0.07 * (np.arange(7000) + 0.5) / 7000 - 0.035
        assert mean(t) == pytest.approx(np.mean([value(s) for s in fine]), abs=2e-4)


@HOW
@pytest.mark.parametrize("rate", [7.0, 20.0, 100.0])
def test_a_servo_follows_its_command_as_in_sapien(how: str, rate: float, tmp_path: Path):
    """The kernel's values, which last, against the curve itself; at a few rows a swing, too."""
    measured = driven(round(3 * rate), rate, how)
    run = measured.runs[0]
    asset = read_asset(asset_of(tmp_path))
    plant = make_plant(asset, measured)
    times, share = np.arange(0, 2801) * 1e-3, 0.3
    law = Actuator(interpolate_series(run.times_s, run.q_command, how, 1e-3, share), *SERVO)
    theirs = roll_out(asset, 0.1, duration_s=2.8, actuator=law)
    ours = simulate(plant, (), times, 0.1, 0.0, make_inputs(run, measured, 0.01), Nuisance(holding=share))
    assert np.abs(ours - theirs.q).max() < 1e-4


def test_values_that_last_move_a_free_part_as_the_curve_does(tmp_path: Path):
    """At every row, however far apart the rows are: not the impulse alone is right, but its moment."""
    measured = replace(driven(12, 4.0, "linear", effort=True), gravity=np.zeros(3))
    run = measured.runs[0]
    assert run.effort is not None
    plant = make_plant(read_asset(asset_of(tmp_path)), measured)
    ours = simulate(plant, (), run.times_s, 0.0, 0.0, make_inputs(run, measured))
    fine = np.arange(run.times_s[-1] * 1e5 + 1) / 1e5
    force = np.interp(fine, run.times_s, run.effort)
    speed = np.append(0.0, np.cumsum(0.5 * (force[1:] + force[:-1])) * 1e-5) / INERTIA
    way = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1])) * 1e-5)
    np.testing.assert_allclose(ours, np.interp(run.times_s, fine, way), atol=1e-8)


@HOW
def test_rows_without_a_command_are_no_rows_of_it(how: str):
    """A topic that comes a fourth as often is followed as in a log of its own."""
    dense = driven(97, 40.0, how)
    run = dense.runs[0]
    assert run.q_command is not None
    sparse = replace(run, q_command=np.where(np.arange(97) % 4, np.nan, run.q_command))
    own = Run("own", run.times_s[::4], run.q[::4], None, run.q_command[::4])
    for holding in (0.0, 0.4, 1.0):
        run_inputs = make_inputs(sparse, dense, 0.01)
        command = run_inputs.command + (
            0 if run_inputs.hold_difference is None else holding * run_inputs.hold_difference[0]
        )
        passed = np.append(0.0, np.cumsum(np.diff(run_inputs.times_s) * command[:-1]))
        impulse = np.interp(run.times_s[:-4], run_inputs.times_s, passed)
        mean = interpolate_series(own.times_s, own.q_command, how, 0.025, holding)
        expected = np.append(0.0, np.cumsum([0.025 * mean(t + 0.0125) for t in run.times_s[:-5]]))
        np.testing.assert_allclose(impulse, expected, atol=1e-12)
        value, same = (interpolate_series(r.times_s, r.q_command, how, 0.0, holding) for r in (sparse, own))
        assert [value(t) for t in run.times_s] == [same(t) for t in run.times_s]


def test_what_is_held_is_as_it_was_and_what_stays_costs_nothing():
    measured = driven(50, 20.0, "held", effort=True)
    run_inputs = make_inputs(measured.runs[0], measured, 1e-3)
    np.testing.assert_array_equal(run_inputs.effort, wave(measured.runs[0].times_s))
    assert run_inputs.hold_difference is None
    still = replace(measured.runs[0], effort=np.repeat([0.0, 1.0], 25))
    assert len(make_inputs(still, replace(measured, interpolation="linear"), 0.01).times_s) < 10


@HOW
def test_a_logged_series_at_any_time_is_the_same_curve(how: str):
    at = np.linspace(-0.1, 0.7, 50)
    value = interpolate_series(TIMES, VALUES, how)
    np.testing.assert_allclose(logged_at(TIMES, VALUES, how, at), [value(t) for t in at], atol=1e-12)  # type: ignore[arg-type]
    assert interpolation_terms(TIMES[:1], VALUES[:1], how).tolist() == [[0, 0, 0, 0]]


def test_a_smooth_command_sampled_is_no_time_offset(tmp_path: Path):
    """Nothing is missing: half a row of lateness is how it was logged. Declared held it is one, and rightly."""
    asset = read_asset(asset_of(tmp_path))
    measured = measured_of(0, servo=True, smooth=100, between="unknown")
    assert find_gap(asset, measured).verdict == "no_gap"
    assert find_gap(asset, replace(measured, interpolation="linear")).verdict == "no_gap"
    late = find_gap(asset, replace(measured, interpolation="held"))
    assert [named.effect.name for named in late.effects] == ["time_offset"]
    assert late.effects[0].effect.values()[0] == pytest.approx(-0.5 / RATE, rel=0.2)


def test_a_command_that_was_held_is_no_time_offset_where_nobody_says_so(tmp_path: Path):
    measured = measured_of(3, servo=True, between="unknown")
    assert find_gap(read_asset(asset_of(tmp_path)), measured).verdict == "no_gap"


def test_what_is_missing_beside_an_unknown_command_is_still_named(tmp_path: Path):
    measured = measured_of(1, servo=True, smooth=100, between="unknown", viscous=0.3)
    (named,) = find_gap(read_asset(asset_of(tmp_path)), measured).effects
    assert named.effect.name == "viscous_damping" and named.effect.values()[0] == pytest.approx(0.3, rel=0.15)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_replay_goes_on_between_rows_as_the_fit_found(share: float, tmp_path: Path):
    """In SAPIEN, in a process of its own."""
    measured = measured_of(0, runs=1, servo=True, smooth=1 if share else 100, between="unknown", exact=True, lean=0.0)
    run = measured.runs[0]
    assert run.q_command is not None
    asset, start = read_asset(asset_of(tmp_path)), (float(run.q_command[0]), 0.0)
    right, wrong = (replay_both(asset, asset, measured, (start,), holding=s).runs[0] for s in (share, 1 - share))
    assert right.after < 1.5e-3 < wrong.after


def test_many_readings_are_thinned_as_far_as_the_motion_allows_and_that_is_said():
    times = np.arange(24000) / 200
    run = Run("long", times, np.sin(2 * np.pi * 1.0 * times))
    assert thinning_stride(times, run.q) == 16  # 1,500 readings are 6 a half swing
    fast = np.sin(2 * np.pi * 4.0 * times)
    assert thinning_stride(times, fast) == 6  # a half swing has 25
    assert thinning_stride(times, np.sin(2 * np.pi * 30.0 * times)) == 4  # 6,000 at most
    assert thinning_stride(times[:1500], fast[:1500]) == 1
    assert thinning_stride(times, times) == 16  # what never turns back
    measured = Measured("j", "revolute", np.zeros(3), 200.0, "recorded", runs=(run, replace(run, q=fast)))
    assert thinning_notes(measured) == (
        "run 'long': one reading of 16 is looked at, 12.5 of 200 a second",
        "run 'long': one reading of 6 is looked at, 33.3 of 200 a second",
    )


def test_what_was_left_out_stands_in_the_answer_and_on_its_page(tmp_path: Path, capsys: pytest.CaptureFixture):
    still = Run("still", np.arange(3000) / 100, np.zeros(3000))
    runs = (still, replace(still, name="again"))
    measured = Measured("j", "revolute", np.array([0, 0, -G]), 100.0, "recorded", runs=runs)
    write_measured(tmp_path / "measured", measured)
    commands.gap(asset_of(tmp_path / "asset"), tmp_path / "measured", tmp_path / "out")
    notes = json.loads((tmp_path / "out" / "verdict.json").read_text())["notes"]
    assert notes[0] == "run 'again' is run 'still' again, reading by reading: it was left out"
    assert notes[1].startswith("run 'still': one reading of 2 is looked at") and len(notes) == 2
    page, output = (tmp_path / "out" / "index.html").read_text(), capsys.readouterr().err
    assert all(note in html.unescape(page) and f"- {note}" in output for note in notes)
