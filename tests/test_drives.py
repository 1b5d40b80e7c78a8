"""What drives a joint, as it is stated: limits, dead bands, motors under a voltage, what is switched off; a drive that
pushes without a command. The fast simulation, SAPIEN and a replay, against equations solved here by scipy."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import ARM, INERTIA, MASS, G, asset_of, replay_both
from hypothesis import given
from hypothesis import strategies as st
from mutations import MUTATED, mutated_json, reads_or_refuses
from refusal import assert_refused
from scipy.integrate import solve_ivp

from freeart21.effects.actuator_offset import ActuatorOffset
from freeart21.files.actuator_json import actuator_from_json
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured, write_measured
from freeart21.measured import Measured, Run
from freeart21.mechanics import Actuator, DcMotor
from simgap.measure.inputs import make_inputs
from simgap.models.surrogate import make_plant, simulate
from simgap.prove.writeback import write_repaired

RATE, SECONDS = 1000, 2.0
TIMES = np.arange(round(RATE * SECONDS)) / RATE
COMMAND = 0.5 * np.sin(4 * TIMES) + 0.3 * np.sign(np.sin(2.5 * TIMES))
WAVE = 3.0 * np.sin(5 * TIMES) + 1.5
ON = ((TIMES < 0.8) | (TIMES > 1.4)).astype(float)
BIAS = -0.8
MOTOR = DcMotor(1.2, 2.0, 9.0, 2.4)


def clipped(x, most):
    return min(max(x, -most), most)


def servo(e, v, u, on):
    """A servo (60 N m/rad, 4 N m s/rad) with a dead band of 0.05 rad and at most 4 N m."""
    e = e - 0.05 if e > 0.05 else e + 0.05 if e < -0.05 else 0.0
    return clipped(60 * e - 4 * v, 4.0)


def limited(e, v, u, on):
    """An ideal torque of 3 N m at most."""
    return clipped(u, 3.0)


def offset(e, v, u, on):
    """A drive that is switched off for a while and has an offset BIAS while on."""
    return u + BIAS if on else 0.0


def motor(e, v, u, on):
    """A motor of 1.2 N m/A and 2 ohm under u volts; open circuit while off."""
    return 1.2 * (u - 1.2 * v) / 2.0 if on else 0.0


def motor_servo(e, v, u, on):
    """The same motor as a servo of 40 V/rad, at most 9 V and 2.4 A."""
    return 1.2 * clipped((clipped(40 * e - 1.0 * v, 9.0) - 1.2 * v) / 2.0, 2.4) if on else 0.0


DRIVES = {
    "servo": (servo, Actuator(None, 60.0, 4.0, dead_band=0.05, max_effort=4.0), {"q_command": COMMAND}),
    "limited": (limited, Actuator(max_effort=3.0), {"effort": WAVE}),
    "offset": (offset, None, {"effort": WAVE, "enabled": ON}),
    "motor": (motor, Actuator(motor=DcMotor(1.2, 2.0)), {"voltage": 3 * WAVE, "enabled": ON}),
    "motor_servo": (motor_servo, Actuator(None, 40.0, 1.0, motor=MOTOR), {"q_command": COMMAND, "enabled": ON}),
}
NAMES = pytest.mark.parametrize("name", DRIVES)


@functools.cache
def course(name: str) -> np.ndarray:
    """(n, 2) positions and speeds of the pendulum from 0.3 rad, commands held between rows."""
    give, _, series = DRIVES[name]
    out, y = [], [0.3, 0.0]
    columns = {key: series.get(key, np.zeros(len(TIMES))) for key in ("q_command", "effort", "voltage")}
    on = series.get("enabled", np.ones(len(TIMES)))
    for i in range(len(TIMES)):
        out.append(y)
        command, u = columns["q_command"][i], columns["effort"][i] + columns["voltage"][i]

        def slope(t, y, command=command, u=u, on=on[i] > 0):
            return [y[1], (give(command - y[0], y[1], u, on) - MASS * G * ARM * np.sin(y[0])) / INERTIA]

        y = solve_ivp(slope, (0, 1 / RATE), y, rtol=1e-8, atol=1e-10).y[:, -1]
    return np.array(out)


def measured_of(name: str) -> Measured:
    _, actuator, series = DRIVES[name]
    run = Run("r", TIMES, course(name)[:, 0], **series)
    kind = "commanded" if "effort" in series else None
    return Measured("j", "revolute", np.array([0, 0, -G]), RATE, "recorded", kind, actuator, runs=(run,))  # type: ignore[arg-type]


def effects_of(name: str):
    return (ActuatorOffset(BIAS),) if name == "offset" else ()


@NAMES
def test_fast_simulation_matches_the_equation(name: str, tmp_path: Path):
    measured = measured_of(name)
    plant = make_plant(read_asset(asset_of(tmp_path)), measured)
    for longest, within in ((np.inf, 2e-5), (0.01, 5e-5)):  # as it was logged, and taken together
        ours = simulate(plant, effects_of(name), TIMES, 0.3, 0.0, make_inputs(measured.runs[0], measured, longest))
        assert np.abs(ours - course(name)[:, 0]).max() < within


@NAMES
def test_sapien_replay_matches_the_equation(name: str, tmp_path: Path):
    """Through job files and a separate process; without the drive's parameters the motion differs."""
    measured, asset = measured_of(name), read_asset(asset_of(tmp_path))
    right = write_repaired(asset, effects_of(name), tmp_path / "right")
    run, start = measured.runs[0], (0.3, 0.0)
    before = asset if name == "offset" else right
    plain = replace(measured, runs=(replace(run, enabled=None),))
    (there,) = replay_both(before, right, measured, (start,), 1e-4).runs
    assert there.after < 1e-5
    if name == "offset":
        assert there.before > 0.05
    elif run.enabled is not None:
        (on,) = replay_both(right, right, plain, (start,), 1e-4).runs
        assert on.after > 0.05


@NAMES
def test_drives_round_trip(name: str, tmp_path: Path):
    measured = measured_of(name)
    write_measured(tmp_path / "set", measured)
    read = read_measured(tmp_path / "set")
    assert read.actuator == measured.actuator or (measured.actuator is not None and read.actuator is not None)
    if measured.actuator is not None and read.actuator is not None:
        assert read.actuator.law == measured.actuator.law
    for column in ("effort", "q_command", "voltage", "enabled"):
        ours, theirs = (getattr(m.runs[0], column) for m in (measured, read))
        assert (ours is None) == (theirs is None)
        if ours is not None:
            np.testing.assert_array_equal(ours, theirs)


GIVEN = {"type": "position", "stiffness": 1.0, "damping": 1.0, "dead_band": 0.1, "max_effort": 2.0}
MOTORS = {"type": "dc_motor", "torque_constant": 1.0, "resistance": 2.0, "max_voltage": 9.0, "max_current": 2.0}


@MUTATED
@given(st.one_of(mutated_json(GIVEN), mutated_json(MOTORS)).filter(lambda law: isinstance(law, dict)))
def test_a_broken_actuator_is_read_or_refused_in_one_line(given_law):
    line = reads_or_refuses(actuator_from_json, given_law, "here")
    assert not line or line.startswith("here")


def test_a_misspelt_limit_is_a_one_line_error():
    misspelt = {"type": "position", "stiffness": 1, "damping": 1, "max_efort": 2}
    assert_refused("here: .*has no 'max_efort'; expected stiffness", actuator_from_json, misspelt, "here")
