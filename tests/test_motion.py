"""Motions: smooth, at a human pace, in the picture, all round; hard ones hide a part; released joints obey physics."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from freeart21 import se3, sphere
from freeart21.camera import Camera
from freeart21.effects import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from generator import partnet, simulate
from generator.model import Hinge, Link, Material, ObjectModel, Piece
from generator.motion import STYLES, Plan, plan_motion
from generator.motion.body import Body
from generator.motion.styles.release import SLOPE, tip_base
from generator.partnet_writer import write_partnet
from generator.rays import Caster
from generator.release import add_inertia, roll_out_release
from generator.shapes import box, triangles

CAMERA = Camera.from_fov(640, 360, np.radians(40))
HAND = ("tumble", "inspect", "wave")
PLANNED = tuple(name for name, style in STYLES.items() if style.propose and name != "human")  # test_human_motion
LID = Joint("lid", "revolute", np.array([0.0, 1, 0]), np.array([0.5, 0, 0.5]), 0.0, 1.4)
DRAWER = Joint("drawer", "prismatic", np.array([-1.0, 0, 0]), np.zeros(3), 0.0, 0.7)


def _lidded() -> tuple[Mesh, Mesh]:
    return Mesh(*triangles(box((1, 1, 1)))), Mesh(*triangles(box((1, 1, 0.2), (0, 0, 0.62))))


def _drawer() -> tuple[Mesh, Mesh]:
    shell = box((1, 1, 1)) - box((0.98, 0.9, 0.35), (-0.02, 0, 0.2))
    return Mesh(*triangles(shell)), Mesh(*triangles(box((0.94, 0.86, 0.3), (-0.03, 0, 0.2))))


def _crossed() -> tuple[Mesh, Mesh]:
    """Two bars side by side, like scissors: no view hides one of them."""
    return Mesh(*triangles(box((1, 0.1, 0.05)))), Mesh(*triangles(box((1, 0.1, 0.05), (0, 0, 0.06))))


CROSSED = Joint("pin", "revolute", np.array([0.0, 0, 1]), np.zeros(3), 0.3, 1.3)
OBJECTS = {"lidded": (_lidded(), LID), "drawer": (_drawer(), DRAWER), "crossed": (_crossed(), CROSSED)}


@functools.cache
def _plan(style: str, name: str = "lidded", seed: int = 0, hard: bool | None = False, frames: int = 300) -> Plan:
    meshes, joint = OBJECTS[name]
    return plan_motion(style, meshes, joint, CAMERA, frames, 30.0, seed, hard=hard)


def _steps(plan: Plan) -> np.ndarray:
    Rs = plan.Ts_camera_object[:, :3, :3]
    return np.degrees(se3.rotation_angle(Rs[1:] @ np.swapaxes(Rs[:-1], 1, 2)))


def _small_shares(plan: Plan, name: str) -> np.ndarray:
    """Share of the side that shows less in the whole video, counted in small pictures by an independent look."""
    meshes, joint = OBJECTS[name]
    camera, caster = Camera.from_fov(96, 54, np.radians(40)), Caster(meshes)
    sides = [
        caster.look(camera, (T, T @ joint.transform(q))).side
        for T, q in zip(plan.Ts_camera_object, plan.states, strict=True)
    ]
    counts = np.array([[np.sum(side == 0), np.sum(side == 1)] for side in sides])
    return counts[:, counts.sum(0).argmin()] / counts.sum(1)


# --- pace and smoothness ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("style", PLANNED)
def test_motions_are_smooth_and_at_a_human_pace(style: str) -> None:
    for hard in (False, True) if style in HAND else (False,):
        plan = _plan(style, hard=hard)
        steps = _steps(plan)
        slowest = 1.0 if STYLES[style].world == "foot" else 2.0  # a camera walks at half the pace
        assert slowest <= np.median(steps) <= 3 and steps.max() < 8
        twists = se3.log_se3(se3.inverse(plan.Ts_camera_object[:-1]) @ plan.Ts_camera_object[1:])
        change = np.degrees(np.linalg.norm(np.diff(twists[:, 3:], axis=0), axis=1))
        jerk = np.degrees(np.linalg.norm(np.diff(twists[:, 3:], 2, axis=0), axis=1))
        assert change.max() < 3.0 and jerk.max() < 2.0  # degrees a frame, from one frame to the next
        far = np.linalg.norm(plan.Ts_camera_object[:, :3, 3], axis=1)
        assert np.abs(np.diff(plan.Ts_camera_object[:, :3, 3], 2, axis=0)).max() < 0.02 * far.min()


@pytest.mark.parametrize("style", PLANNED)
def test_the_joint_runs_smoothly_over_its_whole_range_there_and_back(style: str) -> None:
    states = _plan(style).states
    assert states.min() == pytest.approx(0, abs=1e-3) and states.max() == pytest.approx(1.4, abs=1e-3)
    top, bottom = np.flatnonzero(states > 1.39), np.flatnonzero(states < 0.01)
    assert top.min() < bottom.min() < top.max()  # open, shut and open again
    assert np.abs(np.diff(states)).max() < 0.08 and np.abs(np.diff(states, 2)).max() < 0.01


@pytest.mark.parametrize("style", HAND)
@pytest.mark.parametrize("hard", [False, True])
def test_pose_and_joint_move_together_alone_and_not_at_all(style: str, hard: bool) -> None:
    plan = _plan(style, hard=hard)
    pose, joint = _steps(plan) > 0.3, np.abs(np.diff(plan.states)) > 0.002 * 1.4
    for turning in (True, False):
        for working in (True, False):
            assert np.sum((pose == turning) & (joint == working)) >= 4, (turning, working)
    rest = ~pose & ~joint
    shift = np.linalg.norm(np.diff(plan.Ts_camera_object[:, :3, 3], axis=0), axis=1)
    assert np.median(shift[rest]) < 0.2 * np.median(shift[pose])  # distance and aim rest, too


# --- picture and coverage ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("style", (*PLANNED, "human"))
@pytest.mark.parametrize(("name", "frames"), [("lidded", 2), ("crossed", 80), ("lidded", 300)])
def test_every_corner_stays_in_the_picture_and_the_object_fills_it(style: str, name: str, frames: int) -> None:
    plan, (meshes, joint) = _plan(style, name, frames=frames), OBJECTS[name]
    assert plan.Ts_camera_object.shape == plan.Ts_camera_world.shape == (frames, 4, 4)
    heights = []
    for T, q in zip(plan.Ts_camera_object, plan.states, strict=True):
        points = np.concatenate(
            [se3.transform(T, meshes[0].vertices), se3.transform(T @ joint.transform(q), meshes[1].vertices)]
        )
        uv = CAMERA.project(points)
        assert (uv > 3).all() and (uv < [637, 357]).all()
        heights.append(np.ptp(uv[:, 1]) / 360)
    if frames == 300:
        low = 0.45 if style == "turntable" else 0.6  # on a plate the distance is the same all along
        assert low < np.mean(heights) < 0.75


@pytest.mark.parametrize(("style", "least"), [("tumble", 0.7), ("inspect", 0.7), ("wave", 0.3), ("turntable", 0.3)])
def test_the_object_is_seen_from_all_round(style: str, least: float) -> None:
    body = Body.of(*OBJECTS["lidded"])
    assert sphere.coverage(sphere.view_directions(_plan(style).Ts_camera_object, body.centre)) >= least


# --- hardship ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("style", "name"), [*((style, "lidded") for style in (*HAND, "human")), ("tumble", "drawer")])
def test_hard_motions_hide_the_smaller_part_and_others_show_it(style: str, name: str) -> None:
    easy, hard = (_small_shares(_plan(style, name, hard=hard), name) for hard in (False, True))
    least = 0.08 if style == "wave" else 0.15  # held about upright, a wave comes late to views from below
    assert least <= np.mean(hard < 0.05) < 0.5
    assert np.mean(easy < 0.05) < 0.15
    assert hard[0] > 0.1 and easy[0] > 0.1


# --- seeds and requests -----------------------------------------------------------------------------------------------


def test_bad_requests_get_one_clear_line() -> None:
    meshes, joint = OBJECTS["lidded"]
    for message, style, frames, states in (
        ("unknown motion 'dance'; motions: tumble, inspect", "dance", 5, None),
        ("cannot plan 1 frames", "tumble", 1, None),
        ("'release' needs the joint's states", "release", 5, None),
        (r"given states have shape \(3,\), expected 5", "release", 5, np.zeros(3)),
    ):
        with pytest.raises(FreeArtError, match=message) as caught:
            plan_motion(style, meshes, joint, CAMERA, frames, 30.0, 0, states=states)
        assert "\n" not in str(caught.value)


def test_what_a_seed_draws_is_frozen() -> None:
    frozen = ("tumble", "inspect", "wave", "turntable", "static_base", "release", "human")
    assert [STYLES[name].stream for name in frozen] == list(range(7))
    assert len({style.stream for style in STYLES.values()}) == len(STYLES)


# --- release ----------------------------------------------------------------------------------------------------------


def _toy(kind: str) -> ObjectModel:
    steel = Material("steel", (0.5, 0.5, 0.5), "metal", 2000.0)
    base = Link("heavy base", (Piece("base", box((0.2, 0.2, 0.1)), steel),))
    if kind == "revolute":
        hinge = Hinge("revolute", "link_1", (0, 1, 0), (-0.1, 0, 0.05), -2.0, 0.0)
        part = Link("hinge lid", (Piece("lid", box((0.2, 0.2, 0.02), (0, 0, 0.06)), steel),), hinge)
    else:
        hinge = Hinge("prismatic", "link_1", (-1, 0, 0), (0, 0, 0), 0.0, 0.15)
        part = Link("slider drawer", (Piece("drawer", box((0.18, 0.16, 0.05), (0, 0, 0)), steel),), hinge)
    return ObjectModel("toy", "Box", (part, base), 0, 0)


def test_a_released_lid_swings_for_ever_without_losses_and_dies_down_with_damping(tmp_path: Path) -> None:
    model = _toy("revolute")
    loaded = partnet.load(write_partnet(model, tmp_path / "toy"))
    free = roll_out_release(loaded, (), 150, 30.0, model=model)
    joint = loaded.joint
    assert (free > joint.lower + 0.01).all() and (free <= joint.upper).all()  # it swings clear of its lower limit
    first, last = free[:60], free[-60:]
    assert np.ptp(first) > 0.6 * (joint.upper - joint.lower) and np.ptp(last) == pytest.approx(np.ptp(first), rel=0.03)
    inertia = simulate.load(add_inertia(loaded.asset, model, tmp_path)).joint_inertia
    damped = roll_out_release(loaded, (ViscousDamping(2 * inertia),), 150, 30.0, model=model)
    assert damped[0] == free[0]
    assert np.ptp(damped[-30:]) < 0.1 * np.ptp(damped[:60])
    body = Body.of((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()), joint)
    R_world_object, _ = tip_base(body)
    arm = (joint.transform(damped[-1]) @ [0, 0, 0.06, 1])[:3] - joint.pivot
    arm -= joint.axis * (joint.axis @ arm)
    assert np.allclose(R_world_object @ arm / np.linalg.norm(arm), [0, 0, -1], atol=0.02)  # it hangs straight down
    weight = sum(p.solid.volume() * p.material.density for p in model.links[0].pieces)
    centre, half = np.linalg.norm([0.1, 0.01]), weight / 12 * (0.2**2 + 0.02**2)
    assert inertia == pytest.approx(half + weight * centre**2, rel=1e-4)  # by hand: a plate about its rear edge


def test_a_released_drawer_runs_down_its_slope_to_the_stop(tmp_path: Path) -> None:
    model = _toy("prismatic")
    loaded = partnet.load(write_partnet(model, tmp_path / "toy"))
    states = roll_out_release(loaded, (), 60, 30.0, start=0.0, model=model)
    t = np.arange(60) / 30
    fall = 0.5 * 9.81 * np.sin(SLOPE) * t**2
    rolling = fall < 0.14
    assert np.allclose(states[rolling], fall[rolling], atol=2e-3) and rolling.sum() > 5
    assert np.allclose(states[20:], 0.15, atol=1e-6)  # perfectly inelastic
    with pytest.raises(FreeArtError, match=r"let go at 0.2, expected a state within 0 to 0.15"):
        roll_out_release(loaded, (), 5, 30.0, start=0.2)


def test_a_release_is_shown_at_rest_and_tipped_as_the_roll_out_was() -> None:
    meshes, joint = OBJECTS["lidded"]
    states = np.linspace(1.4, 0.5, 30)
    plan = plan_motion("release", meshes, joint, CAMERA, 30, 30.0, 2, states=states)
    assert np.array_equal(plan.states, states)
    for Ts in (plan.Ts_camera_object, plan.Ts_camera_world):
        assert np.array_equal(Ts, np.broadcast_to(Ts[0], Ts.shape))
    T_world_object = se3.inverse(plan.Ts_camera_world[0]) @ plan.Ts_camera_object[0]
    assert np.allclose(T_world_object[:3, :3], tip_base(Body.of(meshes, joint))[0])
    assert abs((T_world_object[:3, :3] @ joint.axis)[2]) < 1e-9  # a hinge lies level
    assert plan.Ts_camera_world[0, 0, 2] == pytest.approx(0)  # no roll: the world's up is up in the picture
    assert plan.Ts_camera_world[0, 1, 2] < 0
