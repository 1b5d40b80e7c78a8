"""Every effect in SAPIEN, against closed forms and independent event-driven solutions.

The equations (scipy, double precision, events for sticking, impacts, catches and contacts) take nothing from the
product but the effects' parameters.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effect_cases import EVERY
from refusal import assert_refused
from scipy.integrate import solve_ivp

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects import Effect
from freeart21.effects.actuator_delay import ActuatorDelay
from freeart21.effects.actuator_gain import ActuatorGain
from freeart21.effects.armature import Armature
from freeart21.effects.axis_tilt import AxisTilt
from freeart21.effects.backlash import Backlash
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.eccentricity import Eccentricity
from freeart21.effects.end_stop_bounce import EndStopBounce
from freeart21.effects.gear_friction import GearFriction
from freeart21.effects.latch import Latch
from freeart21.effects.pivot_offset import PivotOffset
from freeart21.effects.quadratic_drag import QuadraticDrag
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.sag import Sag
from freeart21.effects.screw_pitch import ScrewPitch
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.effects.wobble import Wobble
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.measured import Measured
from freeart21.mechanics import Actuator
from generator.simulate import joint_motion, load, roll_out
from simgap.models.surrogate import make_plant, simulate

MASS, ARM, G = 1.6, 0.5, 9.81
INERTIA = {"revolute": 0.01 + MASS * ARM**2, "prismatic": MASS}
WEIGHTLESS = (0.0, 0.0, 0.0)
TYPES = pytest.mark.parametrize("kind", ["revolute", "prismatic"])


def asset_with(folder: Path, kind: str, *effects, axis: str = "0 1 0", limit: str = "") -> Asset:
    """A bob of MASS at ARM below a hinge along y (or on a slider)."""
    path = folder / "bob.urdf"
    path.write_text(f"""<robot name="bob"><link name="base"/><link name="bob"><inertial><origin xyz="0 0 {-ARM}"/>
        <mass value="{MASS}"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j" type="{kind}"><parent link="base"/><child link="bob"/><origin xyz="0 0 1" rpy="0 0 0"/>
        <axis xyz="{axis}"/>{limit or '<limit lower="-50" upper="50"/>'}</joint></robot>""")
    return replace(read_asset(path), effects={"j": effects})


def limits(lower: float, upper: float) -> str:
    return f'<limit lower="{lower}" upper="{upper}"/>'


def solved(acceleration, q0: float, qd0: float, times) -> np.ndarray:
    """(n, 2) position and velocity of qdd = acceleration(t, q, qd), smooth."""
    found = solve_ivp(
        lambda t, y: [y[1], acceleration(t, *y)], (0, times[-1]), [q0, qd0], t_eval=times, rtol=1e-10, atol=1e-12
    )
    return np.asarray(found.y.T)


def with_friction(drive, level, q0: float, qd0: float, end: float, step: float = 1e-3) -> np.ndarray:
    """(n,) positions under accelerations drive(q, qd) with sticking friction level(q, qd, qdd), event-driven."""
    times = np.arange(round(end / step) + 1) * step
    q = np.full(len(times), np.nan)
    now, state = 0.0, [q0, qd0]
    while now < end:
        pull = drive(*state)
        if abs(state[1]) < 1e-9 and abs(pull) <= level(state[0], 0.0, 0.0):
            q[times >= now - 1e-12] = state[0]
            return q
        way = np.sign(state[1]) if abs(state[1]) >= 1e-9 else np.sign(pull)

        def slope(t, y, way=way):
            free = drive(*y)
            qdd = free
            for _ in range(6):  # the load depends on the acceleration that friction changes
                qdd = free - way * level(y[0], y[1], qdd)
            return [y[1], qdd]

        def stops(t, y, way=way):
            return way * y[1]

        stops.terminal, stops.direction = True, -1  # type: ignore[attr-defined]
        ahead = [state[0], way * max(abs(state[1]), 1e-12)]
        found = solve_ivp(slope, (now, end), ahead, events=stops, dense_output=True, rtol=1e-9, atol=1e-12)
        here = (times >= now - 1e-12) & (times <= found.t[-1] + 1e-12)
        q[here] = found.sol(times[here])[0]
        now, state = found.t[-1], [float(found.y[0, -1]), 0.0 if found.status == 1 else float(found.y[1, -1])]
    return q


def error(run, q: np.ndarray) -> float:
    """Largest error of position over the largest travel."""
    return float(np.abs(run.q - q).max() / np.ptp(q))


# laws, on a pendulum let go and a slider pushed, both under gravity


@pytest.mark.parametrize(
    "effect, kind", [param for param in EVERY if param.values[0].acts in ("force", "drive", "inertia")]
)
def test_a_law_moves_the_joint_alike_in_sapien_and_in_the_fast_simulation(tmp_path: Path, effect: Effect, kind: str):
    """Without a memory, also as an event-driven solution of the law in plain numpy."""
    q0, qd0 = (0.9, 0.0) if kind == "revolute" else (-0.2, 0.9)
    asset = asset_with(tmp_path, kind, effect)
    run = roll_out(asset, q0, qd0, duration_s=3)
    plant = make_plant(asset, Measured("j", kind, np.array([0.0, 0.0, -G]), 1000.0, "recorded"))
    fast, plain = (simulate(plant, effects, run.times_s, q0, qd0) for effects in ((effect,), ()))
    assert error(run, fast) < 2e-3
    idle = kind == "prismatic" and effect.name in ("armature", "gear_friction")  # nothing pulls, nor presses on teeth
    assert error(run, plain) > 2e-3 or idle
    if type(effect).remember is not Effect.remember:
        return
    I = INERTIA[kind] + effect.added_inertia()  # noqa: E741

    def pull(q):
        return -MASS * G * ARM * np.sin(q) if kind == "revolute" else 0.0

    def level(q, qd, qdd):
        along = MASS * np.hypot(G * np.cos(q) + ARM * qd**2, G * np.sin(q) + ARM * qdd)  # and across the rod
        bearing = along if kind == "revolute" else MASS * G
        return effect.drive_limit(q, qd, abs(pull(q)) if effect.geared else bearing) / I

    expected = with_friction(lambda q, qd: (pull(q) + effect.force(q, qd)) / I, level, q0, qd0, 3.0)
    assert error(run, expected) < 2e-3


# friction


@pytest.mark.parametrize(("share", "slides"), [(1.15, 0), (1.30, 1), (0.78, -1), (0.85, 0), (-0.5, -1), (0.0, -1)])
def test_gear_friction_of_a_slider(tmp_path: Path, share: float, slides: int):
    """A drive with force `asked` times the weight along a rail: upwards it needs (1 + c) / (1 - c) of it, and lets it
    down below (1 - c) / (1 + c)."""
    c, weight = 0.1, MASS * G * 0.6
    asset = asset_with(tmp_path, "prismatic", GearFriction(c), axis="0 0.8 0.6")
    run = roll_out(asset, 0.0, duration_s=1, actuator=Actuator(effort=lambda t: share * weight))
    force = share * weight - weight - slides * c * abs(share * weight + weight)
    expected = force / MASS if slides else 0.0
    assert run.qd[-1] == pytest.approx(expected, abs=2e-3 * G)


# forces of position


@TYPES
@pytest.mark.parametrize("speed", [0.15, 0.8])
def test_latch_catches_a_slow_part_and_lets_a_fast_one_pass(tmp_path: Path, kind: str, speed: float):
    """Entering gains k reach^2 / 2, leaving costs k travel^2 / 2: caught when that stops it."""
    hold, position, travel, capture = 4.0, 0.2, 0.03, 0.4
    run = roll_out(
        asset_with(tmp_path, kind, Latch(hold, position, travel, capture)), 0.1, speed, duration_s=2, gravity=WEIGHTLESS
    )
    k, I = hold / travel, INERTIA[kind]  # noqa: E741
    left = speed**2 + k / I * ((capture * travel) ** 2 - travel**2)  # Newton: nothing pulls before it catches
    if left > 0:
        assert run.qd[-1] == pytest.approx(np.sqrt(left), rel=0.01)
    else:
        late = run.q[-1000:]
        amplitude = np.sqrt((capture * travel) ** 2 + speed**2 * I / k)
        assert late.max() == pytest.approx(position + amplitude, abs=1e-3)
        assert late.min() == pytest.approx(position - amplitude, abs=1e-3)


# inertia and limits


@pytest.mark.parametrize("e, timestep_s", [(0.0, 1e-3), (0.6, 7e-3), (0.9, 1e-3), (1.0, 7e-3)])
def test_bounces_rise_to_e_squared_each(tmp_path: Path, e: float, timestep_s: float):
    asset = asset_with(tmp_path, "prismatic", EndStopBounce(e), axis="0 0 1", limit=limits(0, 9))
    height = 1.0
    run = roll_out(asset, height, duration_s=3, timestep_s=timestep_s)
    assert run.q.min() >= 0
    expected = np.empty(len(run.times_s))
    hit, speed = np.sqrt(2 * height / G), np.sqrt(2 * G * height)
    expected[:] = height - 0.5 * G * run.times_s**2
    while hit < 3:
        speed *= e
        after = run.times_s >= hit
        since = run.times_s[after] - hit
        expected[after] = np.maximum(speed * since - 0.5 * G * since**2, 0.0)
        if speed < 1e-3:
            expected[after] = 0
            break
        hit += 2 * speed / G
    assert np.abs(run.q - expected).max() < (2e-3 if e < 1 else 3e-4)
    if e == 0.6:
        assert np.all(run.q[-20:] == 0) and np.all(run.qd[-20:] == 0)  # at rest at last
    if e == 1.0:
        assert np.ptp(run.energy_j) < 1e-3 * MASS * G


# actuator


def servo(times, I, gain, delay, stiffness, damping, command):  # noqa: E741
    return solved(lambda t, q, qd: gain * (stiffness * (command(t - delay) - q) - damping * qd) / I, 0.0, 0.0, times)


@TYPES
def test_servo_with_delay_and_gain(tmp_path: Path, kind: str):
    def command(t):
        return 0.3 * np.sin(5 * t) * (t > 0)

    law = Actuator(command, 40.0, 3.0)
    plain = None
    for gain, delay in ((1.0, 0.0), (0.6, 0.0), (1.0, 0.08), (1.3, 0.04)):
        asset = asset_with(tmp_path, kind, ActuatorGain(gain), ActuatorDelay(delay))
        run = roll_out(asset, 0.0, duration_s=2, gravity=WEIGHTLESS, actuator=law)
        expected = servo(run.times_s, INERTIA[kind], gain, delay, 40.0, 3.0, command)
        assert error(run, expected[:, 0]) < 2e-5
        if plain is not None:
            assert error(run, plain) > 0.03
        else:
            plain = expected[:, 0]


def two_bodies(times, I, J, width, drive, state):  # noqa: E741
    """(n, 2) positions of part and drive side; contact at +-width/2 stiff and inelastic; drive(t, x, v) its force."""
    out = np.full((len(times), 2), np.nan)
    now, side, y = 0.0, 0, np.array(state, float)  # q, qd, x, v
    end = times[-1]
    while now < end - 1e-12:

        def slope(t, y, side=side):
            f = drive(t, y[2], y[3])
            a = f / (I + J) if side else 0.0
            return [y[1], a, y[3], a if side else f / J]

        if side:

            def event(t, y, side=side):  # contact force from drive side on part
                return side * (drive(t, y[2], y[3]) * I / (I + J)) + 1e-12

            event.direction = -1  # type: ignore[attr-defined]
            events = [event]
        else:
            ahead, behind = (lambda t, y, s=s: s * (y[2] - y[0]) - width / 2 for s in (1, -1))
            ahead.direction = behind.direction = 1  # type: ignore[attr-defined]
            events = [ahead, behind]
        for e in events:
            e.terminal = True  # type: ignore[attr-defined]
        found = solve_ivp(slope, (now, end), y, events=events, dense_output=True, rtol=1e-9, atol=1e-12, max_step=0.01)
        here = (times >= now - 1e-12) & (times <= found.t[-1] + 1e-12)
        out[here] = found.sol(times[here])[[0, 2]].T
        now, y = found.t[-1], found.y[:, -1].copy()
        if found.status == 1:
            if side:
                side = 0
            else:
                side = 1 if len(found.t_events[0]) else -1
                y[1] = y[3] = (I * y[1] + J * y[3]) / (I + J)
    return out


@TYPES
@pytest.mark.parametrize("through", ["servo", "effort"])
def test_backlash_is_two_bodies_with_a_gap(tmp_path: Path, kind: str, through: str):
    I = INERTIA[kind]  # noqa: E741
    J, width = 0.3 * I, 0.2

    def command(t):
        return 0.5 * np.sin(3 * t)

    def effort(t):
        return 2.0 * I * np.sin(4 * t)

    if through == "servo":
        law = Actuator(command, 60.0 * I, 8.0 * I)
    else:
        law = Actuator(effort=effort)
    run = roll_out(asset_with(tmp_path, kind, Backlash(width, J)), 0.0, duration_s=3, gravity=WEIGHTLESS, actuator=law)

    def drive(t, x, v):
        return 60 * I * (command(t) - x) - 8 * I * v if through == "servo" else effort(t)

    expected = two_bodies(run.times_s, I, J, width, drive, [0.0, 0.0, 0.0, 0.0])
    assert error(run, expected[:, 0]) < 2e-3
    stiff = solved(lambda t, q, qd: drive(t, q, qd) / (I + J), 0.0, 0.0, run.times_s)
    assert error(run, stiff[:, 0]) > 0.015
    early = run.times_s < 0.1
    assert np.abs(run.q[early]).max() < (1e-3 if through == "servo" else 1e-9)


# kinematics and sensing, through the loaded asset


@TYPES
def test_joint_motion_includes_kinematic_effects(tmp_path: Path, kind: str):
    """In the asset's canonical frame, from its canonical zero; what each does to a point, test_effects has by hand."""
    asset = asset_with(tmp_path, kind, axis="0 0.6 0.8", limit=limits(0.1, 2))
    C = se3.exp_se3([0.1, -0.2, 0.3, 0.4, 0.5, -0.6])
    asset = replace(asset, T_canonical_reference=C, state_zero=0.2)
    states, times = np.array([-0.4, 0.0, 0.9]), np.array([0.0, 0.1, 0.3])
    effects = [AxisTilt(0.05, -0.1), Wobble(0.05, 2.0, 0.3, 0.7), ScrewPitch(0.2), Sag(1e-3)]
    if kind == "revolute":
        effects += [PivotOffset(0.02, -0.03), Eccentricity(0.01, 0.4)]
    mechanics = load(asset).mechanics
    ideal = mechanics.joint.transform(0.2 + states)
    zero = se3.inverse(C @ mechanics.joint.transform(0.2))
    np.testing.assert_allclose(joint_motion(asset, states), C @ ideal @ zero, atol=2e-6)
    for effect in effects:
        got = joint_motion(replace(asset, effects={"j": (effect,)}), states, times)
        moved = effect.displacement(0.2 + states, times, mechanics) @ ideal
        np.testing.assert_allclose(got, C @ moved @ zero, atol=2e-6, err_msg=effect.name)
        assert np.abs(got - C @ ideal @ zero).max() > 1e-3, effect.name


# together


def test_effects_unfit_for_a_joint_are_a_one_line_error(tmp_path: Path):
    for effects, message in (
        ((PivotOffset(0.1, 0.0),), "effect 'pivot_offset' on a prismatic joint, expected revolute"),
        ((Backlash(0.1, 0.1), Backlash(0.2, 0.1)), "2 effects 'backlash', expected at most one"),
    ):
        assert_refused(message, load, asset_with(tmp_path, "prismatic", *effects))
    with pytest.raises(FreeArtError, match="internal steps"):
        roll_out(
            asset_with(tmp_path, "prismatic"), 0, duration_s=1, timestep_s=1.0, actuator=Actuator(lambda t: 0, 1e6)
        )


@TYPES
@pytest.mark.parametrize(
    "effect",
    [ViscousDamping(0.3), QuadraticDrag(0.2), CoulombFriction(0.5), ReturnSpring(6.0, -0.2), Armature(0.4)],
    ids=lambda e: e.name,
)
def test_mujoco_and_sapien_agree_on_an_effect(tmp_path: Path, kind: str, effect):
    mujoco = pytest.importorskip("mujoco")
    joint = "hinge" if kind == "revolute" else "slide"
    words = {word: np.atleast_1d(value) for word, value in effect.mjcf_joint().items()}
    more = " ".join(f'{word}="{" ".join(map(str, values))}"' for word, values in words.items())
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><compiler angle="radian"/>
        <option timestep="0.0005" integrator="implicitfast"/>
        <worldbody><body pos="0 0 1"><joint type="{joint}" axis="0 1 0" {more}/><inertial pos="0 0 {-ARM}" mass="{MASS}"
        diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = 0.8, 2.0
    theirs = [0.8]
    for _ in range(3000):
        mujoco.mj_step(model, data)
        theirs.append(float(data.qpos[0]))
    run = roll_out(asset_with(tmp_path, kind, effect), 0.8, 2.0, duration_s=1.5)
    assert error(run, np.array(theirs[::2])) < (8e-3 if effect.name == "coulomb_friction" else 1e-3)  # theirs is soft
    free = roll_out(asset_with(tmp_path, kind), 0.8, 2.0, duration_s=1.5)
    changed = np.abs(free.q - run.q).max()
    assert changed > 0.02 or (kind == "prismatic" and effect.name == "armature")  # a free slider does not feel inertia
