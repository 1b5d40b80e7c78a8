"""Impact, backlash and stiction in both simulations, against closed forms; both run the same code."""

from __future__ import annotations

import numpy as np
import pytest

from freeart21 import events
from freeart21.effects import EFFECTS, Effect
from freeart21.joint import Joint
from freeart21.mechanics import DriveLaw, JointMechanics
from generator import simulate
from simgap.models import laws
from simgap.models.surrogate import Inputs, Plant
from simgap.models.surrogate import simulate as fast

NOTHING = np.zeros(3)


def slider(lower: float = -10.0, upper: float = 10.0, drive: DriveLaw | None = None) -> Plant:
    """A mass of 2 kg on a horizontal slider."""
    joint = Joint("j", "prismatic", np.eye(3)[0], NOTHING, lower, upper)
    return Plant(
        JointMechanics(joint, 2.0, 2.0, NOTHING, -9.81 * np.eye(3)[2]), lower, upper, drive=drive or DriveLaw()
    )


def made(name: str, **values: float) -> Effect:
    return EFFECTS[name](**values)


def test_both_simulations_run_this_code():
    for name in ("drive_rebound", "meet_part", "part_at_limit", "touching_side"):
        assert getattr(laws, name).py_func is getattr(simulate, name) is getattr(events, name)


def test_backlash_contact_by_relative_motion():
    touching = events.touching_side
    assert [touching(0, 0.31, w, 0.2, 1.0, 0.0, 0.2) for w in (2.0, 0.5)] == [1, 0]
    assert [touching(0, 0.09, w, 0.2, 1.0, 0.0, 0.2) for w in (2.0, 0.5)] == [0, -1]
    assert [touching(side, 0, 0, 0, 0, push, 0.2) for side in (1, -1) for push in (-1.0, 1.0)] == [0, 1, -1, 0]


def test_impacts_conserve_momentum():
    v, w, side = events.meet_part(-1, 1.0, -3.0, False, 2.0, 0.5, 0.3, 0.0)
    assert v == w == pytest.approx((2.0 - 1.5) / 2.5) and side == -1
    for side, w in ((1, 3.0), (-1, -3.0)):
        assert events.meet_part(side, 0.0, w, True, 2.0, 0.5, 0.3, 0.0) == (0.0, pytest.approx(-0.3 * w), 0)
        assert events.meet_part(side, 0.0, w, True, 2.0, 0.5, 0.3, 1.0) == (0.0, 0.0, side)


def test_drive_side_at_a_limit():
    assert events.part_at_limit(-1, 1.0, 2.0, 0.0, 0.3) == (2.0, 0)
    assert events.part_at_limit(1, 1.0, 2.0, 0.0, 0.3) == (-0.6, 0)
    assert events.part_at_limit(1, 1.0, 2.0, -0.8, 0.0) == (-0.8, 1)
    assert events.part_at_limit(1, 1.0, 2.0, -0.6, 0.3) == (-0.6, 1)


@pytest.mark.parametrize("way", [1, -1])
def test_dry_friction_stops_a_slider_in_closed_form(way: int):
    times = np.linspace(0.0, 2.0, 201)
    q = fast(slider(), (made("coulomb_friction", level=3.0),), times, 0.1, way * 1.2)
    stop, slows = 1.2 * 2.0 / 3.0, 3.0 / 2.0
    gone = np.minimum(times, stop)
    assert q == pytest.approx(0.1 + way * (1.2 * gone - 0.5 * slows * gone**2), abs=1e-9)


def test_coulomb_decay_per_half_swing():
    spring, friction = made("return_spring", stiffness=50.0, rest=0.0), made("coulomb_friction", level=1.0)
    half = np.pi * np.sqrt(2.0 / 50.0)  # friction changes no period
    turns = np.array([0.11 - 2 * k / 50 for k in range(3)]) * [1, -1, 1]
    q = fast(slider(), (spring, friction), np.append(half * np.arange(3), [3 * half, 9 * half]), 0.11)
    assert q[:3] == pytest.approx(turns, abs=1e-6)
    # .03 m from its middle the spring pulls with 1.5 N; there it goes on, and .01 m from it 0.5 N hold nothing
    assert q[3:] == pytest.approx([0.01, 0.01], abs=1e-6)


def test_restitution_scales_the_speed():
    times = np.linspace(0.0, 3.0, 61)
    q = fast(slider(0.0, 1.0), (made("end_stop_bounce", restitution=0.6),), times, 0.5, 1.0)
    met = np.cumsum([0.5, 1 / 0.6])  # at the upper limit, then at the lower one
    there = np.where(times < met[0], 0.5 + times, 1.0 - 0.6 * (times - met[0]))
    assert q == pytest.approx(np.where(times < met[1], there, 0.36 * (times - met[1])), abs=1e-9)


def test_backlash_delays_the_part():
    slack = made("backlash", width=0.02, drive_inertia=0.5)
    times = np.linspace(0.0, 0.5, 251)
    inputs = Inputs(times[:1], np.full(1, np.nan), np.full(1, 4.0), np.zeros(1))
    q = fast(slider(), (slack,), times, 0.0, 0.0, inputs)
    taken = np.sqrt(2 * 0.01 * 0.5 / 4.0)  # half of the slack, at 8 m/s^2
    after = np.maximum(times - taken, 0.0)
    speed = 0.5 * (8.0 * taken) / 2.5  # of both, by momentum
    assert q == pytest.approx(speed * after + 0.5 * (4.0 / 2.5) * after**2, abs=1e-9)


def test_drive_force_acts_inside_the_backlash():
    slack = made("backlash", width=0.02, drive_inertia=0.5)
    times = np.linspace(0.0, 0.3, 151)
    inputs = Inputs(times[:1], np.full(1, 5.0), np.zeros(1), np.zeros(1))
    q = fast(slider(drive=DriveLaw(stiffness=100.0, max_commanded=4.0)), (slack,), times, 0.0, 0.0, inputs)
    taken = np.sqrt(2 * 0.01 * 0.5 / 4.0)
    after = np.maximum(times - taken, 0.0)
    assert q == pytest.approx(0.5 * 8.0 * taken / 2.5 * after + 0.5 * (4.0 / 2.5) * after**2, abs=1e-6)
