"""`measure` reads the circumstances of a measured set from a file. 2 s."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from gap_case import asset_of

from freeart21.errors import FreeArtError
from freeart21.files.measured import read_measured
from freeart21.formats.measured_series import measure_series
from freeart21.formats.series_settings import SeriesSettings

T = 0.01 * np.arange(120)
Q = 0.8 * np.cos(7 * T)
TABLE = {"time": T, "angle": Q, "rate": np.degrees(-5.6 * np.sin(7 * T)), "volts": 3 * np.sin(T),
         "torque": np.sin(T), "cart": 40 * np.sin(2 * T), "arm": 10 * np.sin(3 * T), "goal": Q}  # fmt: skip
MOTOR = {"type": "dc_motor", "torque_constant": 0.3, "resistance": 3.0, "max_voltage": 7.4}


def set_of(folder: Path, facts: dict, wanted: dict[str, str], **options):
    """The measured set of these columns under these circumstances, and the printed lines."""
    folder.mkdir(parents=True, exist_ok=True)
    asset = asset_of(folder / "asset")
    names = ["time", "angle", *wanted.values()]
    rows = [",".join(names), *(",".join(f"{v:.9g}" for v in row) for row in np.column_stack([TABLE[n] for n in names]))]
    (folder / "run.csv").write_text("\n".join(rows) + "\n")
    (folder / "told.json").write_text(json.dumps(facts))
    columns = ("t=time", "q=angle", *(f"{role}={name}" for role, name in wanted.items()))
    given = {"asset": asset, "columns": columns, "circumstances": folder / "told.json", "unit_q": "rad", **options}
    notes = measure_series([folder / "run.csv"], folder / "out", SeriesSettings(**given))
    return read_measured(folder / "out" / "measured"), "\n".join(notes)


def test_motor_voltage_and_measured_velocity(tmp_path: Path):
    facts = {"actuator": MOTOR, "units": {"qd": "deg/s"}}
    got, notes = set_of(tmp_path, facts, {"voltage": "volts", "qd": "rate"}, reverse=True)
    (run,) = got.runs
    assert got.actuator is not None and got.actuator.motor is not None
    assert (got.actuator.motor.resistance, got.actuator.motor.max_voltage) == (3.0, 7.4)
    assert run.voltage is not None and run.qd is not None
    np.testing.assert_allclose(run.voltage, -TABLE["volts"], atol=1e-8)
    np.testing.assert_allclose(run.qd, 5.6 * np.sin(7 * T), atol=1e-6)
    assert "voltage: unknown between" in notes


def test_drive_limits_and_dead_band(tmp_path: Path):
    law = {"type": "position", "stiffness": 5.0, "damping": 0.5, "dead_band": 0.01, "max_effort": 2.0}
    got, _ = set_of(tmp_path, {"actuator": law}, {"q_command": "goal"})
    assert got.actuator is not None
    assert (got.actuator.stiffness, got.actuator.dead_band, got.actuator.max_effort) == (5.0, 0.01, 2.0)


def test_moving_bases(tmp_path: Path):
    cart, _ = set_of(tmp_path / "cart", {"units": {"base_x": "mm"}}, {"base_x": "cart"})
    assert cart.runs[0].base is not None and cart.runs[0].base.position is not None
    np.testing.assert_allclose(cart.runs[0].base.position[:, 0], 0.04 * np.sin(2 * T), atol=1e-9)
    axis = {"axis": [0, 0, 1], "point": [0, 0.3, 0]}
    arm, _ = set_of(tmp_path / "arm", {"base": axis, "units": {"base_angle": "deg"}}, {"base_angle": "arm"})
    assert arm.base_axis is not None and arm.runs[0].base is not None and arm.runs[0].base.angle is not None
    np.testing.assert_allclose(arm.base_axis.point, [0, 0.3, 0])
    np.testing.assert_allclose(arm.runs[0].base.angle, np.radians(TABLE["arm"]), atol=1e-9)


def test_prescribed_motion_and_unwrapped_angles(tmp_path: Path):
    for k, value in enumerate((True, ["run"])):
        got, _ = set_of(tmp_path / str(k), {"prescribed": value}, {"effort": "torque"}, effort="commanded")
        assert got.runs[0].prescribed is True


BAD = {
    "a word that is none": ({"drive": 1}, {}, "has 'drive', expected actuator, base, prescribed"),
    "no such actuator": ({"actuator": {"type": "steam"}}, {}, "the actuator's type is 'steam'"),
    "no such unit": (
        {"units": {"qd": "rpm"}},
        {"qd": "rate"},
        "units of qd rpm: joint 'j' is revolute, expected rad/s, deg/s",
    ),
    "a unit of no column": ({"units": {"qd": "deg/s"}}, {}, "units of 'qd', which no column has; expected t, q"),
    "an angle about nothing": ({}, {"base_angle": "arm"}, "a run has 'base_angle', but base is 'moving'"),
    "a voltage without a motor": ({}, {"voltage": "volts"}, "needs an actuator of type 'dc_motor'"),
    "a run that is not there": ({"prescribed": ["other"]}, {}, "prescribed: there is no run 'other'; runs: run"),
    "prescribed without a force": ({"prescribed": True}, {}, "run 'run' is prescribed, but has no 'effort'"),
    "not yes or no": ({"wrapped": 3}, {}, "'wrapped' is 3, expected true or false"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_circumstances_are_a_one_line_error_without_output(tmp_path: Path, case: str):
    facts, wanted, why = BAD[case]
    with pytest.raises(FreeArtError, match=re.escape(why)) as error:
        set_of(tmp_path, facts, wanted)
    assert "\n" not in str(error.value) and not (tmp_path / "out").exists()
