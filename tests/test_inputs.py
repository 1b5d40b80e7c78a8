"""What drives a joint between the rows of its log: followed exactly where it is known, no effect where nobody knows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import RATE, SERVO, G, asset_of, measured_of, replay_both

from freeart21.files.asset import read_asset
from freeart21.measured import Measured, Run
from freeart21.mechanics import Actuator, interpolate_series
from generator.simulate import roll_out
from simgap.measure.inputs import make_inputs
from simgap.models.surrogate import Nuisance, make_plant, simulate
from simgap.workflow import find_gap

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


def test_a_smooth_command_sampled_is_no_time_offset(tmp_path: Path):
    """Nothing is missing: half a row of lateness is how it was logged. Declared held it is one, and rightly."""
    asset = read_asset(asset_of(tmp_path))
    measured = measured_of(0, servo=True, smooth=100, between="unknown")
    assert find_gap(asset, measured).verdict == "no_gap"
    assert find_gap(asset, replace(measured, interpolation="linear")).verdict == "no_gap"
    late = find_gap(asset, replace(measured, interpolation="held"))
    assert [named.effect.name for named in late.effects] == ["time_offset"]
    assert late.effects[0].effect.values()[0] == pytest.approx(-0.5 / RATE, rel=0.2)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_replay_goes_on_between_rows_as_the_fit_found(share: float, tmp_path: Path):
    """In SAPIEN, in a process of its own."""
    measured = measured_of(0, runs=1, servo=True, smooth=1 if share else 100, between="unknown", exact=True, lean=0.0)
    run = measured.runs[0]
    assert run.q_command is not None
    asset, start = read_asset(asset_of(tmp_path)), (float(run.q_command[0]), 0.0)
    right, wrong = (replay_both(asset, asset, measured, (start,), holding=s).runs[0] for s in (share, 1 - share))
    assert right.after < 1.5e-3 < wrong.after
