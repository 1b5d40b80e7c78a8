"""Prescribed motion with measured force: friction against speed is found in the torque, not in the positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gap_case import ARM, INERTIA, MASS, G, asset_of

from freeart21.effects.actuator_offset import ActuatorOffset
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.stribeck_friction import StribeckFriction
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.files.asset import read_asset
from freeart21.measured import Measured, Run
from simgap.motion.equation_error import smoothed
from simgap.motion.surrogate import plant_of
from simgap.motion.torque_residual import breakaways, explained, torque_residual

DIRECTDRIVE = Path(__file__).resolve().parents[1].parent / "shared" / "measured" / "directdrive_friction" / "test2"
STEP = 2 * np.pi / 1_024_000
SPEEDS = (0.003, 0.01, 0.02, 0.05, 0.1, 0.3, 0.6, 1.0)


def steady(speed: float, friction, bias: float, seed: int) -> Run:
    """A joint that a drive brings to `speed`, rad/s, and holds there, under the torque that it needs."""
    rng, times = np.random.default_rng(seed), np.arange(800) / 200
    qd = speed * (1 - np.exp(-times / 0.1))
    q = speed * (times - 0.1 * (1 - np.exp(-times / 0.1)))
    qdd = speed / 0.1 * np.exp(-times / 0.1)
    torque = INERTIA * qdd + MASS * G * ARM * np.sin(q) + friction(qd) - bias
    read = STEP * np.round(q / STEP)
    return Run(f"{speed:g}", times, read, torque + rng.normal(0, 0.05, 800))


def measured_of(friction, bias: float = 0.0) -> Measured:
    runs = tuple(steady(sign * v, friction, bias, i) for i, v in enumerate(SPEEDS) for sign in (1, -1))
    gravity = np.array([0, 0, -G])
    return Measured("j", "revolute", gravity, 200.0, "recorded", "commanded", None, 0.05, 0.05, runs, "linear")


def stribeck(qd):
    return np.sign(qd) * (0.8 + 0.5 * np.exp(-((qd / 0.03) ** 2))) + 0.3 * qd


def seen_of(folder: Path, measured: Measured):
    return torque_residual(measured, plant_of(read_asset(asset_of(folder)), measured))


def test_the_torque_of_steady_turns_is_the_friction_at_their_speeds(tmp_path: Path):
    seen = seen_of(tmp_path, measured_of(stribeck))
    for i, name in enumerate(seen.run_names):
        here = seen.run == i
        assert np.median(seen.torque[here]) == pytest.approx(stribeck(float(name)), abs=0.02)


def test_a_stribeck_curve_under_a_biased_drive_is_found_with_its_numbers(tmp_path: Path):
    seen = seen_of(tmp_path, measured_of(stribeck, bias=-0.25))
    right = explained(seen, ("stribeck_friction", "viscous_damping", "actuator_offset"))
    friction, oil, drive = right.effects
    assert isinstance(friction, StribeckFriction) and isinstance(oil, ViscousDamping)
    assert isinstance(drive, ActuatorOffset)
    assert friction.values() == pytest.approx((0.8, 0.5, 0.03), rel=0.1)
    assert oil.coefficient == pytest.approx(0.3, rel=0.1) and drive.bias == pytest.approx(-0.25, abs=0.01)
    assert right.inertia == pytest.approx(1, abs=0.04) and right.gravity == pytest.approx(1, abs=0.01)
    plain = explained(seen, ("coulomb_friction", "viscous_damping", "actuator_offset"))
    assert right.after < 0.06 < 0.1 < plain.after < right.before
    assert explained(seen, ()).after == right.before


def test_a_long_run_that_never_turns_back_keeps_its_acceleration():
    """The widest window's polynomials have all their digits; and what forces are seen through is a mean."""
    times = np.arange(20_000) / 1000
    smooth = smoothed(Run("r", times, 3.0 * times**2 + 100.0))
    assert smooth is not None
    _, _, _, _, qdd, kernel = smooth
    np.testing.assert_allclose(qdd, 6.0, rtol=2e-3)
    assert kernel.sum() == pytest.approx(1.0, rel=2e-3)


def test_what_is_in_the_simulation_is_no_residual(tmp_path: Path):
    measured = measured_of(lambda qd: 0.6 * np.sign(qd))
    plant = plant_of(read_asset(asset_of(tmp_path)), measured)
    left = torque_residual(measured, plant, (CoulombFriction(0.6),))
    assert np.sqrt(np.mean(left.torque**2)) < 0.06


def test_a_ramp_that_breaks_away_tells_the_level_though_the_contact_gives_way_first(tmp_path: Path):
    times = np.arange(1000) / 100
    torque = 0.5 * times
    bent = np.where(torque < 3.0, 2e-3 * torque / 3.0, 2e-3 + 0.5 * np.maximum(times - 6.0, 0) ** 2)
    runs = tuple(Run(n, times, s * bent, s * torque) for n, s in (("up", 1.0), ("down", -1.0)))
    still = Run("still", times, 0 * times, torque)
    measured = Measured("j", "revolute", np.zeros(3), 100.0, "recorded", "commanded", runs=(*runs, still))
    plant = plant_of(read_asset(asset_of(tmp_path)), measured)
    up, down = breakaways(measured, plant, reach=3e-3)
    assert (up.run, down.run) == ("up", "down")
    assert up.torque == pytest.approx(3.0, abs=0.05) and down.torque == pytest.approx(-3.0, abs=0.05)
    early, _ = breakaways(measured, plant, reach=5e-4)
    assert early.torque < 1.0, "taken for a slide where the contact only gave way"


@pytest.mark.skipif(not DIRECTDRIVE.is_dir(), reason="the recordings are not here")
def test_a_real_direct_drive_has_dry_friction_that_falls_with_speed_and_breaks_away_as_its_authors_say(tmp_path: Path):
    """Authors: inertia 2.351 + .168 kg m^2, breakaway 10.75 and -12.00 N m. The weight's moment is some 40 N m."""
    from export.joint_asset import JointNumbers, write_joint_asset

    write_joint_asset(tmp_path / "arm.urdf", JointNumbers("pendulum", 10.0, 40.0 / 98.1, 2.519))
    asset, runs = read_asset(tmp_path / "arm.urdf"), []
    for name in (sign + speed for speed in ("05", "1", "2", "3", "5", "10", "15", "20") for sign in ("", "n")):
        pos, vel, tau = (np.loadtxt(DIRECTDRIVE / f"cin_{w}1_{name}_exp_gan.t") for w in ("pos", "vel", "tau"))
        new = np.append(True, np.diff(pos[:, 0]) > 0)
        runs.append(Run(name, pos[new, 0], np.radians(pos[new, 1]), tau[new, 1], qd=np.radians(vel[new, 1])))
    gravity = np.array([0, 0, -9.81])
    measured = Measured(
        asset.joint, "revolute", gravity, 66.7, "recorded", "commanded", None, 0.05, 0.2, tuple(runs), "unknown"
    )
    plant = plant_of(asset, measured)
    seen = torque_residual(measured, plant)
    dry = explained(seen, ("coulomb_friction",))
    assert isinstance(dry.effects[0], CoulombFriction) and 11 < dry.effects[0].level < 14
    assert dry.after < 0.15 * dry.before
    levels = [abs(b.torque) for b in breakaways(measured, plant, reach=np.radians(0.2)) if b.time_s > 0.05]
    assert len(levels) >= 10 and 10 < np.median(levels) < 13.5
