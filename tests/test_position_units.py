"""The unit of positions: from the joint's limits, from its motion, or asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusal import assert_refused
from scipy.integrate import solve_ivp

from freeart21.errors import FreeArtError
from freeart21.files.measured import read_measured
from freeart21.formats.measured_series import measure_series
from freeart21.formats.series_settings import SeriesSettings

G, MASS, ARM, INERTIA = 9.81, 1.0, 0.3, 0.01
T = 0.01 * np.arange(500)
LIMITS = '<limit lower="-2" upper="2" effort="9" velocity="9"/>'


def asset(folder: Path, kind: str = "continuous", axis: str = "0 1 0", limits: str = "") -> Path:
    """A body that hangs from a joint, its centre of mass .3 m below, in frames that are turned."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "part.urdf"
    path.write_text(f"""<robot name="part"><link name="root"/><link name="base"/><link name="part"><inertial>
        <origin xyz="{ARM} 0 0"/><mass value="{MASS}"/>
        <inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="f" type="fixed"><parent link="root"/><child link="base"/><origin xyz="1 2 3" rpy="0 0 1"/></joint>
        <joint name="j" type="{kind}"><parent link="base"/><child link="part"/><origin rpy="0 1.5707963267948966 0"/>
        <axis xyz="{axis}"/>{limits}</joint></robot>""")
    return path


def moved(q0: float, force, inertia: float, seed: int = 0) -> np.ndarray:
    """(n,) readings of a motion from rest under `force` of time, position and velocity."""
    done = solve_ivp(
        lambda t, y: [y[1], force(t, *y) / inertia], (0, T[-1]), [q0, 0.0], t_eval=T, rtol=1e-8, max_step=0.01
    )
    return done.y[0] + np.random.default_rng(seed).normal(0, 1e-3 * max(np.ptp(done.y[0]), 1e-3), len(T))


def measured(folder: Path, urdf: Path, header: str, *columns: np.ndarray, **options):
    """The measured set of one file, and the lines that were printed."""
    np.savetxt(folder / "run.csv", np.column_stack([T, *columns]), delimiter=",", header=header, comments="")
    notes = measure_series([folder / "run.csv"], folder / "out", SeriesSettings(asset=urdf, **options))
    return read_measured(folder / "out" / "measured"), "\n".join(notes)


def swing(q0: float) -> np.ndarray:
    """(n,) rad of a pendulum with 1.2 times the inertia that its asset says, and oil."""
    own = INERTIA + MASS * ARM**2
    return moved(q0, lambda t, q, v: -MASS * G * ARM * np.sin(q) - 0.02 * v, 1.2 * own)


def turned() -> tuple[np.ndarray, np.ndarray]:
    """(n,) rad and N*m of a rotor that a motor turns far to one side, with dry friction and oil."""
    torque = 0.03 * np.sin(3 * T) + 0.015 + 0.005 * np.sin(17 * T)  # its mass is on its axis
    q = moved(0.0, lambda t, q, v: np.interp(t, T, torque) - 4e-3 * np.tanh(v / 1e-2) - 1e-3 * v, INERTIA)
    return q, torque


def slid() -> tuple[np.ndarray, np.ndarray]:
    """(n,) m and N of a slider that is pushed to and fro."""
    push = 3 * np.sin(4 * T) + 2 * np.cos(9 * T)
    return moved(0.2, lambda t, q, v: np.interp(t, T, push) - 2.0 * v, MASS), push


@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_a_wide_swing_tells_its_unit(unit: str, tmp_path: Path):
    q = swing(1.4)
    found, notes = measured(tmp_path, asset(tmp_path), "time,angle", np.degrees(q) if unit == "deg" else q)
    assert f"is in {unit}, by the asset's inertia" in notes
    np.testing.assert_allclose(found.runs[0].q, q, atol=1e-9)


@pytest.mark.parametrize("unit", ["rad", "deg"])
@pytest.mark.parametrize("reverse", [False, True])
def test_a_known_torque_tells_the_unit_of_many_turns(unit: str, reverse: bool, tmp_path: Path):
    q, torque = turned()
    assert np.ptp(q) > 2 * np.pi  # which a range alone calls degrees
    vertical, sign = asset(tmp_path, axis="1 0 0"), -1 if reverse else 1
    recorded = sign * (np.degrees(q) if unit == "deg" else q)
    options = {"effort": "commanded", "reverse": reverse}
    found, notes = measured(tmp_path, vertical, "t,q,effort", recorded, sign * torque, **options)
    assert f"is in {unit}, by the asset's inertia" in notes
    np.testing.assert_allclose(found.runs[0].q, q, atol=1e-9)


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_a_known_push_tells_the_unit_of_a_slider(unit: str, tmp_path: Path):
    q, push = slid()
    urdf = asset(tmp_path, "prismatic", "0 1 0", '<limit lower="-1e4" upper="1e4" effort="9" velocity="9"/>')
    _, notes = measured(tmp_path, urdf, "t,q,effort", q * (1e3 if unit == "mm" else 1), push, effort="external")
    assert f"is in {unit}, by the asset's inertia" in notes


REFUSED = {
    "a small swing": (swing(0.1), "angle", "", "the joint has no limits, and no motion tells it"),
    "a rotor that runs down": (5 - 5 * np.exp(-T), "angle", "", "the joint has no limits, and no motion tells it"),
    "counts": (np.round(2048 + 650 * swing(1.0)), "counts", LIMITS, "counts have no unit of their own"),
    "counts under another name": (
        np.round(2048 + 650 * swing(1.0)),
        "angle",
        LIMITS,
        "the joint's limits allow it in none",
    ),
    "raw": (swing(1.0), "raw", "", "counts have no unit of their own"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_unit_that_nothing_tells_is_asked_for(what: str, tmp_path: Path):
    q, name, limits, why = REFUSED[what]
    urdf = asset(tmp_path, "revolute" if limits else "continuous", limits=limits)
    line = assert_refused(why, measured, tmp_path, urdf, f"time,{name}", q, columns=(f"q={name}",))
    assert f"column '{name}'" in line and "expected --unit-q rad or --unit-q deg" in line
    assert not (tmp_path / "out").exists()


def test_counts_have_a_number_per_turn(tmp_path: Path):
    q = swing(1.0)
    counts = np.round(2048 + 4096 / (2 * np.pi) * q)
    urdf = asset(tmp_path, "revolute", limits=LIMITS)
    options = {"columns": ("q=counts",), "zero": 2048.0}
    found, _ = measured(tmp_path, urdf, "time,counts", counts, unit_q="counts=4096", **options)
    np.testing.assert_allclose(found.runs[0].q, q, atol=1e-3)
    for wrong in ("counts", "counts=", "counts=0", "counts=nan", "counts=many", "steps=4096"):
        with pytest.raises(FreeArtError, match=f"--unit-q {wrong}: .*expected .*counts=N"):
            measured(tmp_path, urdf, "time,counts", counts, unit_q=wrong, **options)


@pytest.mark.parametrize(("size", "unit"), [(1.0, "rad"), (180 / np.pi, "deg")])
def test_limits_tell_a_unit_that_motion_does_not(size: float, unit: str, tmp_path: Path):
    urdf = asset(tmp_path, "revolute", "1 0 0", LIMITS)
    _, notes = measured(tmp_path, urdf, "time,angle", size * 0.8 * np.exp(-T))
    assert f"is in {unit}, by the joint's limits" in notes
