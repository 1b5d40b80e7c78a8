"""A joint on a moving base (cart, rotary arm, any), against the motion of point masses in the world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import ARM, INERTIA, MASS, G, asset_of, replay_both
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured
from freeart21.files.measured_writer import write_measured
from freeart21.measured import BaseAxis, BaseSeries, Measured, Run
from simgap.fit.fit import Model, fit_model, predict_readings, refit_starts
from simgap.fit.problem import make_problem
from simgap.measure.data import make_fit_runs
from simgap.measure.inputs import make_inputs
from simgap.models.equation_error import estimate_missing_force
from simgap.models.surrogate import make_plant, simulate

ROTARY = Path(__file__).resolve().parents[1].parent / "shared" / "measured" / "rotary_and_cart"
RATE, SECONDS = 500, 2.0
TIMES = np.arange(round(RATE * SECONDS)) / RATE
GRAVITY = np.array([0.0, 0.0, -G])
TYPES = pytest.mark.parametrize("kind", ["revolute", "prismatic"])

RNG = np.random.default_rng(5)
BITS = RNG.uniform(-0.2, 0.2, (6, 3)) + np.array([0.1, -0.05, -0.25])
MASSES = RNG.uniform(0.1, 0.5, 6)
ORIGIN, RPY, JOINT_AXIS = np.array([0.3, -0.1, 0.4]), np.array([0.3, -0.5, 0.8]), np.array([0.6, 0.0, 0.8])
AXIS, POINT = np.array([2.0, -1.0, 2.0]) / 3, np.array([-0.1, 0.2, 0.05])


def swung(t):
    """Rotation of the base (rad)."""
    return 0.6 * np.sin(3.0 * t) + 0.3 * t


def shifted(t):
    """(..., 3) translation of the base (m)."""
    return np.stack([0.2 * np.sin(4 * t), 0.1 * np.cos(3 * t), 0.05 * np.sin(6 * t)], -1)


def write_crooked(folder: Path, kind: str) -> Path:
    """URDF of BITS on a tilted joint."""
    centre = MASSES @ BITS / MASSES.sum()
    arms = BITS - centre
    tensor = sum(m * ((a @ a) * np.eye(3) - np.outer(a, a)) for m, a in zip(MASSES, arms, strict=True))
    xx, xy, xz, yy, yz, zz = tensor[np.triu_indices(3)]
    path = folder / "crooked.urdf"
    path.write_text(f"""<robot name="crooked"><link name="base"/><link name="part"><inertial>
        <origin xyz="{" ".join(map(repr, centre.tolist()))}"/><mass value="{MASSES.sum()}"/>
        <inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/></inertial></link>
        <joint name="j" type="{kind}"><parent link="base"/><child link="part"/>
        <origin xyz="{" ".join(map(str, ORIGIN))}" rpy="{" ".join(map(str, RPY))}"/>
        <axis xyz="{" ".join(map(str, JOINT_AXIS))}"/><limit lower="-50" upper="50"/></joint></robot>""")
    return path


def places(q: float, t: float, kind: str) -> np.ndarray:
    """(6, 3) positions of the point masses in the world."""
    if kind == "revolute":
        on_part = BITS @ Rotation.from_rotvec(q * JOINT_AXIS).as_matrix().T
    else:
        on_part = BITS + q * JOINT_AXIS
    in_base = on_part @ Rotation.from_euler("xyz", RPY).as_matrix().T + ORIGIN
    return (in_base - POINT) @ Rotation.from_rotvec(swung(t) * AXIS).as_matrix().T + POINT + shifted(t)


def world_course(kind: str, spring: float) -> np.ndarray:
    """(n,) joint positions by d'Alembert's principle on the point masses; derivatives by differences."""
    h = 2e-4

    def slope(t, y):
        q, v = y
        at = {(a, b): places(q + a * h, t + b * h, kind) for a in (-1, 0, 1) for b in (-1, 0, 1)}
        along = (at[1, 0] - at[-1, 0]) / (2 * h)
        bent = (at[1, 0] - 2 * at[0, 0] + at[-1, 0]) / h**2
        mixed = (at[1, 1] - at[1, -1] - at[-1, 1] + at[-1, -1]) / (4 * h**2)
        carried = (at[0, 1] - 2 * at[0, 0] + at[0, -1]) / h**2
        rest = bent * v**2 + 2 * mixed * v + carried - GRAVITY
        force = -spring * q - np.sum(MASSES[:, None] * along * rest)
        return [v, force / np.sum(MASSES[:, None] * along**2)]

    return solve_ivp(slope, (0, TIMES[-1]), [0.4, 0.0], t_eval=TIMES, rtol=1e-7, atol=1e-8).y[0]


def measured_of(kind: str, q: np.ndarray, base: BaseSeries, axis: BaseAxis | None) -> Measured:
    runs = (Run("r", TIMES, q, base=base),)
    return Measured("j", kind, GRAVITY, RATE, "recorded", runs=runs, base_axis=axis)  # type: ignore[arg-type]


def simulated(folder: Path, measured: Measured, path: Path, effects=()) -> np.ndarray:
    plant = make_plant(read_asset(path), measured)
    return simulate(
        plant, effects, TIMES, measured.runs[0].q[0], 0.0, make_inputs(measured.runs[0], measured, 0.01, plant)
    )


@TYPES
def test_a_moving_base_matches_point_masses(kind: str, tmp_path: Path):
    from freeart21.effects.return_spring import ReturnSpring

    spring = 6.0
    q = world_course(kind, spring)
    base = BaseSeries(shifted(TIMES) - shifted(0.0), None, swung(TIMES))
    measured = measured_of(kind, q, base, BaseAxis(AXIS, POINT))
    path = write_crooked(tmp_path, kind)
    effects = (ReturnSpring(spring, 0.0),)
    ours = simulated(tmp_path, measured, path, effects)
    assert np.abs(ours - q).max() < 2e-4 * np.ptp(q)
    still = simulated(tmp_path, replace(measured, runs=(replace(measured.runs[0], base=None),)), path, effects)
    assert np.abs(still - q).max() > 0.1 * np.ptp(q)
    from simgap.prove.writeback import write_repaired

    asset = write_repaired(read_asset(path), effects, tmp_path / "sprung")
    start = (0.4, 0.0)
    (there,) = replay_both(asset, asset, measured, (start,), 1e-4).runs
    assert there.after < 2e-4 * np.ptp(q)  # in SAPIEN
    plant = make_plant(asset, measured)
    missing = estimate_missing_force(measured, plant.mechanics, -50, 50, effects, plant=plant)
    assert np.sqrt(np.mean(missing.force**2)) < 0.02 * missing.inertia * np.std(
        np.gradient(np.gradient(q, TIMES), TIMES)
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


@pytest.mark.skipif(not ROTARY.is_dir(), reason="the recordings are not here")
def test_a_real_pendulum_follows_its_arm(tmp_path: Path):
    """An arm that stands up turns by a radian in the pendulum's own plane, whose angle is read against the vertical.

    How far its pivot is from the arm's axis is read off the first tenth of a second, when the bob stays behind: .229 m.
    """
    from scipy.io import loadmat

    from export.joint_asset import JointNumbers, write_joint_asset

    write_joint_asset(tmp_path / "asset.urdf", JointNumbers("pendulum", 0.096, 0.195, period=0.993))
    asset, runs, reach = read_asset(tmp_path / "asset.urdf"), [], 0.229
    for gain in (3, 5):
        data = loadmat(ROTARY / f"adip_arm_pcont_data_kP_{gain}_ref_1.mat")
        t, arm, q = (data[name].ravel() for name in ("t", "theta1", "theta2"))
        pivot = np.stack([reach * np.sin(arm), 0 * t, reach * (np.cos(arm) - 1)], 1)
        runs.append(Run(f"kp{gain}", t, q, base=BaseSeries(pivot)))
    measured = Measured(asset.joint, "revolute", GRAVITY, 1000.0, "recorded", runs=tuple(runs), gravity_relative=0.05)
    still = replace(measured, runs=tuple(replace(run, base=None) for run in runs))
    left = []
    for series in (measured, still):
        plant = make_plant(asset, series)
        seen, noise = make_fit_runs(series, plant)
        problem = make_problem(plant, series, seen, noise)
        fit = fit_model(Model(problem, ("coulomb_friction", "viscous_damping")), seen[:1])
        both = refit_starts(fit, seen)
        left.append([np.sqrt(np.mean((predict_readings(both, run) - run.q) ** 2)) for run in seen])
    assert max(left[0]) < 5e-3 and min(left[1]) > 0.15  # rad; the second run was not fitted
