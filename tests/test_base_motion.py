"""A joint on a moving base (cart, rotary arm, any), against the motion of point masses in the world."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gap_case import ARM, INERTIA, MASS, G, asset_of
from scipy.integrate import solve_ivp

from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured, write_measured
from freeart21.measured import BaseAxis, BaseSeries, Measured, Run
from simgap.measure.inputs import make_inputs
from simgap.models.surrogate import make_plant, simulate

RATE, SECONDS = 500, 2.0
TIMES = np.arange(round(RATE * SECONDS)) / RATE
GRAVITY = np.array([0.0, 0.0, -G])

ORIGIN, RPY, JOINT_AXIS = np.array([0.3, -0.1, 0.4]), np.array([0.3, -0.5, 0.8]), np.array([0.6, 0.0, 0.8])
AXIS, POINT = np.array([2.0, -1.0, 2.0]) / 3, np.array([-0.1, 0.2, 0.05])


def swung(t):
    """Rotation of the base (rad)."""
    return 0.6 * np.sin(3.0 * t) + 0.3 * t


def shifted(t):
    """(..., 3) translation of the base (m)."""
    return np.stack([0.2 * np.sin(4 * t), 0.1 * np.cos(3 * t), 0.05 * np.sin(6 * t)], -1)


def measured_of(kind: str, q: np.ndarray, base: BaseSeries, axis: BaseAxis | None) -> Measured:
    runs = (Run("r", TIMES, q, base=base),)
    return Measured("j", kind, GRAVITY, RATE, "recorded", runs=runs, base_axis=axis)  # type: ignore[arg-type]


def simulated(folder: Path, measured: Measured, path: Path, effects=()) -> np.ndarray:
    plant = make_plant(read_asset(path), measured)
    return simulate(
        plant, effects, TIMES, measured.runs[0].q[0], 0.0, make_inputs(measured.runs[0], measured, 0.01, plant)
    )


def cart(t):
    return 0.15 * np.sin(2 * np.pi * 0.9 * t)


@pytest.mark.parametrize("quantity", ["position", "acceleration"])
def test_cart_pendulum_matches_the_textbook(quantity: str, tmp_path: Path):
    """I q'' = m l x'' cos q - m g l sin q, for a bob that hangs at -z and turns about y."""
    pull = -0.15 * (2 * np.pi * 0.9) ** 2

    def slope(t, y):
        xdd = pull * np.sin(2 * np.pi * 0.9 * t)
        return [y[1], (MASS * ARM * xdd * np.cos(y[0]) - MASS * G * ARM * np.sin(y[0])) / INERTIA]

    q = solve_ivp(slope, (0, TIMES[-1]), [0.2, 0.0], t_eval=TIMES, rtol=1e-9, atol=1e-10).y[0]
    nothing = 0 * TIMES
    x = cart(TIMES) if quantity == "position" else pull * np.sin(2 * np.pi * 0.9 * TIMES)
    base = BaseSeries(**{quantity: np.stack([x, nothing, nothing], 1)})
    measured = measured_of("revolute", q, base, None)
    assert np.abs(simulated(tmp_path, measured, asset_of(tmp_path)) - q).max() < 1e-3 * np.ptp(q)


def test_bases_round_trip_and_bad_ones_are_refused(tmp_path: Path):
    base = BaseSeries(shifted(TIMES), None, swung(TIMES))
    measured = measured_of("revolute", 0.1 * np.sin(TIMES), base, BaseAxis(AXIS, POINT))
    write_measured(tmp_path / "a", measured)
    read = read_measured(tmp_path / "a")
    assert read.base_axis is not None and read.runs[0].base is not None
    np.testing.assert_allclose(read.base_axis.axis, AXIS)
    np.testing.assert_allclose(read.base_axis.point, POINT)
    np.testing.assert_array_equal(read.runs[0].base.position, base.position)
    np.testing.assert_array_equal(read.runs[0].base.angle, base.angle)
    path = tmp_path / "a" / "measured.json"
    good = path.read_text()
    for change, message in (
        (('"base_x": "m"', '"base_x": "mm"'), "'base_x' of a revolute joint is in 'mm', expected 'm'"),
        (('"base": {', '"base": "moving", "else": {'), "a run has 'base_angle', but base is 'moving'"),
        (('"base": {', '"base": "fixed", "else": {'), "a run has 'base_angle', but base is 'fixed'"),
    ):
        assert change[0] in good
        path.write_text(good.replace(*change))
        with pytest.raises(FreeArtError, match=message):
            read_measured(tmp_path / "a")
    path.write_text(good)
    rows = (tmp_path / "a" / "r.csv").read_text()
    (tmp_path / "a" / "r.csv").write_text(rows.replace("base_x", "base_ax", 1))
    with pytest.raises(FreeArtError, match="positions and accelerations of its base, expected one of both"):
        read_measured(tmp_path / "a")
