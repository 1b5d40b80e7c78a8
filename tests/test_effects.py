"""Effects: bounds, units, formulas, file round trips, refused contradictions."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effect_cases import ALL, EVERY
from hypothesis import given, settings
from hypothesis import strategies as st
from refusal import assert_refused

from freeart21 import se3
from freeart21.effects import (
    EFFECTS,
    effect_from_json,
    effects_from_urdf_dynamics,
    readings,
)
from freeart21.effects.actuator_delay import ActuatorDelay
from freeart21.effects.actuator_gain import ActuatorGain
from freeart21.effects.armature import Armature
from freeart21.effects.axis_tilt import AxisTilt
from freeart21.effects.backlash import Backlash
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.detent import Detent
from freeart21.effects.eccentricity import Eccentricity
from freeart21.effects.encoder_offset import EncoderOffset
from freeart21.effects.encoder_scale import EncoderScale
from freeart21.effects.end_stop_bounce import EndStopBounce
from freeart21.effects.gravity_offset import GravityOffset
from freeart21.effects.latch import Latch
from freeart21.effects.load_friction import LoadFriction
from freeart21.effects.pivot_offset import PivotOffset
from freeart21.effects.quadratic_drag import QuadraticDrag
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.sag import Sag
from freeart21.effects.screw_pitch import ScrewPitch
from freeart21.effects.stribeck_friction import StribeckFriction
from freeart21.effects.time_offset import TimeOffset
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.effects.wobble import Wobble
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset, write_asset_json
from freeart21.joint import Joint, JointType
from freeart21.mechanics import JointMechanics

EXAMPLES = (ViscousDamping(0.3), CoulombFriction(0.2), ReturnSpring(4.0, -0.1))
TYPES = pytest.mark.parametrize("kind", ["revolute", "prismatic"])


def write_urdf(folder: Path, inside: str = "", kind: str = "revolute") -> Path:
    path = folder / "lid.urdf"
    path.write_text(f"""<robot name="lid"><link name="a"/><link name="b"/><joint name="j" type="{kind}">
        <parent link="a"/><child link="b"/><limit lower="0" upper="1"/>{inside}</joint></robot>""")
    return path


def test_every_effect_is_found_under_its_file_s_name():
    for name, cls in EFFECTS.items():
        assert cls.name == name and cls.__module__ == f"freeart21.effects.{name}"
    labels = [cls.label for cls in EFFECTS.values()]
    assert all(labels) and len({*labels}) == len(labels)


@pytest.mark.parametrize("effect, kind", EVERY)
def test_round_trip_through_json_text(effect, kind):
    data = json.loads(json.dumps(effect.to_json(kind)))
    assert effect_from_json(data, kind, "here") == effect
    specs = effect.parameters(kind)
    assert set(data["parameters"]) == set(specs) and specs
    for name, spec in specs.items():
        assert data["parameters"][name]["unit"] == spec.unit(kind)
        assert 0 < spec.scale <= spec.upper - spec.lower


@pytest.mark.parametrize("cls", EFFECTS.values(), ids=lambda c: c.name)
def test_bounds_are_closed(cls):
    specs = cls.parameters()
    for bound in ("lower", "upper"):
        good = {name: getattr(spec, bound) for name, spec in specs.items()}
        assert cls(**good) == cls(**good)
        for name, spec in specs.items():
            beyond = np.nextafter(getattr(spec, bound), -np.inf if bound == "lower" else np.inf)
            for value in (beyond, np.nan, np.inf, "1", None):
                assert_refused(f"effect '{cls.name}' {name} is", cls, **{**good, name: value})


VALUES = st.sampled_from([None, "1", [], {}, True, -1e9, 1e9, float("nan"), {"value": "x", "unit": "s"}])


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.sampled_from([param.values for param in EVERY]), st.data())
def test_a_broken_entry_reads_or_is_one_line(case, data):
    """Of a valid entry a field is dropped, added or gets another value."""
    effect, kind = case
    entry = effect.to_json(kind)
    name = data.draw(st.sampled_from(sorted(entry["parameters"])))
    place = data.draw(st.sampled_from([entry, entry["parameters"], entry["parameters"][name]]))
    field = data.draw(st.sampled_from([*sorted(place), "extra"]))
    if data.draw(st.booleans()):
        place.pop(field, None)
    else:
        place[field] = data.draw(VALUES)
    try:
        assert effect_from_json(entry, kind, "here").name in EFFECTS
    except FreeArtError as error:
        assert str(error).startswith("here: ") or str(error).startswith("effect ")
        assert "\n" not in str(error)


def test_formulas_by_hand():
    damping, friction, spring = EXAMPLES
    assert damping.force(0.7, -2.0, 0.0) == 0.6
    assert spring.force(0.4, 9.0, 0.0) == pytest.approx(-2.0)
    assert (friction.force(0.7, 3.0, 0.0), friction.drive_limit(0.7, 3.0)) == (0.0, 0.2)
    assert [e.acts for e in EXAMPLES] == ["force", "drive", "force"]
    assert StribeckFriction(0.2, 0.3, 0.5).drive_limit(0.0, np.array([0.0, -0.5, 50.0])) == pytest.approx(
        [0.5, 0.2 + 0.3 / np.e, 0.2]
    )
    assert QuadraticDrag(0.3).force(0.0, np.array([-2.0, 3.0])) == pytest.approx([1.2, -2.7])
    assert LoadFriction(0.01).drive_limit(0.0, 1.0, 30.0) == pytest.approx(0.3)
    assert GravityOffset(cosine=0.3, sine=-0.2).force(np.array([0.0, np.pi / 2]), 0.0) == pytest.approx([0.3, -0.2])
    detent = Detent(0.5, 0.4, 0.05)
    assert detent.force(np.array([0.35, 0.4, 0.45, 0.6]), 0.0) == pytest.approx([0.5, 0, -0.5, 0], abs=2e-3)
    assert np.abs(detent.force(np.linspace(0, 1, 10001), 0.0)).max() == pytest.approx(0.5, rel=1e-6)
    for tail in (0.05, 0.25, 1.0, 2.0):  # largest one width away, however it ends, and nowhere steeper than it says
        notch, q = Detent(0.5, 0.4, 0.05, tail), np.linspace(0, 1, 100001)
        force = notch.force(q, 0.0)
        assert force[35000] == np.abs(force).max() == pytest.approx(0.5, rel=1e-6)
        assert np.abs(np.diff(force)).max() / 1e-5 == pytest.approx(notch.steepness(), rel=0.03)
    latch = Latch(2.0, 0.1, 0.02, 0.5)
    course, memory, forces = np.array([0.13, 0.115, 0.109, 0.119, 0.0801, 0.121, 0.115]), 0.0, []
    for q in course:
        memory = latch.remember(q, memory, *latch.values())
        forces.append(float(latch.force(q, 0.0, 0.0, memory)))
    assert forces == pytest.approx([0, 0, -0.9, -1.9, 1.99, 0, 0])
    assert EndStopBounce(0.5).rebound(-3.0) == 1.5
    assert EndStopBounce(0.5, 2.0).rebound(-0.5) == pytest.approx(0.125)  # half of it at 1 / fading
    assert (ActuatorDelay(0.02).delay(), ActuatorGain(0.8).gain(), Armature(0.05).added_inertia()) == (0.02, 0.8, 0.05)


@pytest.mark.parametrize("effect, kind", EVERY)
def test_laws_take_arrays(effect, kind):
    """That they compile to the same numbers, test_surrogate has."""
    if effect.acts not in ("force", "drive", "inertia", "stop"):
        with pytest.raises(NotImplementedError):
            effect.law(0.0, 0.0, 0.0, 0.0, *effect.values())
        return
    values = effect.values()
    q, qd = np.linspace(-1, 1, 5), np.linspace(-2, 3, 5)
    load = np.full(5, 7.0)
    many = effect.law(q, qd, load, 1.0, *values)
    for i in range(5):
        assert effect.law(q[i], qd[i], 7.0, 1.0, *values) == pytest.approx(many[i], rel=1e-12)
    if effect.name == "latch":
        seen = effect.remember(q, 1.0, *values)
        assert [float(effect.remember(x, 1.0, *values)) for x in q] == list(seen)


@pytest.mark.parametrize("effect, kind", EVERY)
def test_forces_obey_their_slope_bound(effect, kind):
    q = np.linspace(-4, 4, 200_001)
    force = effect.force(q, 0.0 * q, 0.0, 1.0) + 0.0 * q
    steepest = np.max(-np.diff(force) / np.diff(q))
    assert steepest <= effect.steepness() * (1 + 1e-6) + 1e-9
    assert steepest >= 0.9 * effect.steepness()


@pytest.mark.parametrize("effect, kind", [param for param in EVERY if param.values[0].acts == "force"])
def test_speed_dependence_is_declared(effect, kind):
    q = np.linspace(-1, 1, 101)
    slow, fast = (effect.force(q, qd, 0.0, 1.0) + 0.0 * q for qd in (0.3, 2.0))
    assert effect.speed_dependent == (not np.array_equal(slow, fast))


def hinge(kind: JointType, mass: float = 2.0) -> JointMechanics:
    """A part of 2 kg, its centre at (0.5, 0, 0.1), on a vertical axis through (0.1, 0.2, 0)."""
    joint = Joint("j", kind, np.array([0.0, 0, 1]), np.array([0.1, 0.2, 0.0]), -9, 9)
    return JointMechanics(joint, mass, 1.0, mass * np.array([0.5, 0, 0.1]), np.array([0.0, 0, -10.0]))


def moved_point(effect, kind: JointType, q: float, point, t: float = 0.0) -> np.ndarray:
    """Position of a point of the moving part (given at q = 0) under the effect, parent frame."""
    mechanics = hinge(kind)
    T = effect.displacement(q, t, mechanics) @ mechanics.joint.transform(q)
    return se3.transform(T, np.asarray(point, float))


def test_kinematic_effects_move_points_as_by_hand():
    quarter = np.pi / 2
    # axis tilted by 0.1 about -y: it points to (-sin 0.1, 0, cos 0.1)
    tilted = se3.exp_so3(quarter * np.array([-np.sin(0.1), 0, np.cos(0.1)]))
    expected = np.array([0.1, 0.2, 0]) + tilted @ [0.4, -0.2, 0]
    np.testing.assert_allclose(moved_point(AxisTilt(0.1, 0.0), "revolute", quarter, [0.5, 0, 0]), expected, atol=1e-12)
    along = np.array([-np.sin(0.1), 0, np.cos(0.1)])
    np.testing.assert_allclose(moved_point(AxisTilt(0.1, 0.0), "prismatic", 0.3, [0, 0, 0]), 0.3 * along, atol=1e-12)
    # pivot at (0.1 + 0.02, 0.2 - 0.01): a quarter turn about it takes (0.5, 0) to (0.12 + 0.19, 0.19 + 0.38)
    np.testing.assert_allclose(
        moved_point(PivotOffset(0.01, 0.02), "revolute", quarter, [0.5, 0, 0]), [0.31, 0.57, 0], atol=1e-12
    )
    np.testing.assert_allclose(
        moved_point(ScrewPitch(0.2), "revolute", 0.5, [0.1, 0.2, 0]), [0.1, 0.2, 0.1], atol=1e-12
    )
    # a slider's turn of a quarter about (0.1, 0.2)
    np.testing.assert_allclose(
        moved_point(ScrewPitch(quarter / 0.3), "prismatic", 0.3, [0.5, 0.2, 0]), [0.1, 0.6, 0.3], atol=1e-12
    )
    # rocking about x + the pivot: a point 1 m up the axis goes to -y by sin(angle)
    wobble = Wobble(0.05, 2.0, 0.0, quarter)
    for t in (0.0, 0.125, 0.3):
        angle = 0.05 * np.sin(4 * np.pi * t)
        expected = np.array([0.1, 0.2 - np.sin(angle), np.cos(angle)])
        np.testing.assert_allclose(moved_point(wobble, "revolute", 1.0, [0.1, 0.2, 1.0], t), expected, atol=1e-12)
    # moment of 2 kg at 10 m/s^2, arm (0.4, -0.2): 20 N * 0.4472 m about the horizontal across the arm: the part drops
    droop = 1e-3 * 20 * np.hypot(0.4, 0.2)
    dropped = moved_point(Sag(1e-3), "revolute", 0.0, [0.5, 0, 0])
    assert dropped[2] == pytest.approx(-np.hypot(0.4, 0.2) * np.sin(droop), rel=1e-9)
    tip = [moved_point(Sag(1e-3), "revolute", q, [0.5, 0, 0])[2] for q in (0.0, 1.0, 2.0)]
    assert np.ptp(tip) < 1e-12  # upright axis: the same droop at every angle
    # out of round: twice round per turn, starting towards -y
    for q in (0.0, quarter / 2, quarter):
        shift = moved_point(Eccentricity(0.01, 0.0), "revolute", q, [0.1, 0.2, 0]) - [0.1, 0.2, 0]
        np.testing.assert_allclose(shift, 0.01 * np.array([np.sin(2 * q), -np.cos(2 * q), 0]), atol=1e-12)


@pytest.mark.parametrize("effect, kind", EVERY)
def test_displacements_are_vectorised_poses(effect, kind):
    if effect.kind != "kinematics":
        with pytest.raises(NotImplementedError):
            effect.displacement(0.1, 0.0, hinge(kind))
        return
    q, t = np.array([-0.3, 0.0, 0.7]), np.array([0.0, 0.2, 0.9])
    T = effect.displacement(q, t, hinge(kind))
    se3.check_poses(effect.name, T)
    for i in range(3):
        np.testing.assert_allclose(T[i], effect.displacement(q[i], t[i], hinge(kind)), atol=1e-14)
    assert np.abs(T[2] - np.eye(4)).max() > 1e-4


def test_readings_are_delayed_scaled_and_offset():
    t = np.arange(200) * 0.01
    q = 3.0 * t
    assert readings((), t, q) == pytest.approx(q)
    effects = (EncoderOffset(0.1), EncoderScale(1.1), TimeOffset(0.025), ViscousDamping(1.0))
    assert readings(effects, t, q) == pytest.approx(1.1 * 3.0 * (t - 0.025) + 0.1)
    assert readings(effects[::-1], t, q) == pytest.approx(readings(effects, t, q))
    assert readings((TimeOffset(-0.025),), t, q) == pytest.approx(3.0 * (t + 0.025))
    curved = readings((TimeOffset(0.02),), t, np.sin(t))
    assert curved[2:] == pytest.approx(np.sin(t - 0.02)[2:], abs=1e-12)


def test_joint_mechanics_of_a_pendulum():
    """A point of 2 kg, 0.5 m below a level hinge along y: m g r sin q back to rest; rod force m (g cos q + r qd^2)."""
    joint = Joint("j", "revolute", np.array([0.0, 1, 0]), np.array([0.0, 0, 1.0]), -9, 9)
    body = JointMechanics(joint, 2.0, 0.5, np.array([0.0, 0, 1.0]), np.array([0.0, 0, -10.0]))
    q, qd = np.array([0.0, 0.4, -1.2]), np.array([1.0, -2.0, 0.5])
    assert body.gravity_force(q) == pytest.approx(-2 * 10 * 0.5 * np.sin(q))
    free = -10 / 0.5 * np.sin(q)
    assert body.load(q, qd, free) == pytest.approx(2 * (10 * np.cos(q) + 0.5 * qd**2))
    assert body.load(q, 0 * q, 0 * q) == pytest.approx(20.0)  # held still: its whole weight
    slider = replace(body, joint=Joint("j", "prismatic", np.array([0, 0.6, 0.8]), np.zeros(3), -9, 9))
    assert slider.gravity_force(q) == pytest.approx(-16.0)
    assert slider.load(q, qd, qd) == pytest.approx(12.0)


def test_urdf_and_mjcf_attributes():
    assert [e.urdf_dynamics() for e in EXAMPLES] == [{"damping": 0.3}, {"friction": 0.2}, {}]
    assert [e.mjcf_joint() for e in EXAMPLES] == [
        {"damping": 0.3},
        {"frictionloss": 0.2},
        {"stiffness": 4.0, "springref": -0.1},
    ]
    assert Armature(0.05).mjcf_joint() == {"armature": 0.05}
    assert QuadraticDrag(0.3).mjcf_joint() == {"damping": (0.0, 0.3)}
    words = ("viscous_damping", "coulomb_friction", "return_spring", "armature", "quadratic_drag")
    silent = [e for e in ALL["revolute"] if e.name not in words]
    assert all(e.urdf_dynamics() == e.mjcf_joint() == {} for e in silent)
    assert effects_from_urdf_dynamics(0.3, 0.2) == EXAMPLES[:2]
    assert effects_from_urdf_dynamics(0.0, 0.0) == ()


def described(folder: Path, inside: str = '<dynamics damping="0.3" friction="0.2"/>') -> None:
    asset = read_asset(write_urdf(folder, inside))
    write_asset_json(folder, replace(asset, effects={"j": EXAMPLES}))


@TYPES
def test_effects_json_holds_the_whole_library(tmp_path: Path, kind: JointType):
    dynamics = {k: v for effect in ALL[kind] for k, v in effect.urdf_dynamics().items()}
    inside = "<dynamics " + " ".join(f'{name}="{value}"' for name, value in dynamics.items()) + "/>"
    asset = read_asset(write_urdf(tmp_path, inside, kind))
    write_asset_json(tmp_path, replace(asset, effects={"j": ALL[kind]}))
    assert read_asset(tmp_path).effects == {"j": ALL[kind]}
    path = tmp_path / "effects.json"
    data = json.loads(path.read_text())
    for name, value in (("restitution", 1.5), ("spin", 0.5)):
        broken = json.loads(json.dumps(data))
        entry = next(e for e in broken["joints"]["j"] if e["effect"] == "end_stop_bounce")
        entry["parameters"] = {name: {"value": value, "unit": "1"}}
        path.write_text(json.dumps(broken))
        assert_refused(f"end_stop_bounce.*({name} is 1.5, expected 0 to 1|expected \\['fading)", read_asset, tmp_path)


@pytest.mark.parametrize(
    "inside, message",
    [
        ("", r"damping 0.3, but lid.urdf has 0"),
        ('<dynamics damping="0.3"/>', r"friction 0.2, but lid.urdf has 0"),
        ('<dynamics damping="0.31" friction="0.2"/>', r"damping 0.3, but lid.urdf has 0.31"),
    ],
)
def test_effects_json_that_contradicts_the_urdf_is_refused(tmp_path: Path, inside: str, message: str):
    described(tmp_path, inside)
    assert_refused(message, read_asset, tmp_path)


def test_equal_effects_merge():
    assert CoulombFriction(0.2).merge(CoulombFriction(0.3)) == CoulombFriction(0.5)
    assert Armature(0.25, 0.2, 0.01).merge(Armature(0.5, 0.1, 0.02)) == Armature(0.75, 0.2, 0.02)
    both, q = ReturnSpring(3.0, 0.4).merge(ReturnSpring(1.0, -0.4)), np.linspace(-1, 1, 5)
    assert both.force(q, 0.0) == pytest.approx(ReturnSpring(3.0, 0.4).force(q, 0) + ReturnSpring(1.0, -0.4).force(q, 0))
    for two in (Detent(0.5, 0.4, 0.05), StribeckFriction(0.2, 0.3, 0.5), GravityOffset(sine=0.1), EncoderScale(1.1)):
        assert two.merge(two) is None
    with pytest.raises(FreeArtError, match="has an effect 'backlash' already, expected at most one"):
        Backlash(0.02, 0.1).merge(Backlash(0.02, 0.1))
