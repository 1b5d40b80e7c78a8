"""The style `human`: submovements and rests as measured, whichever candidate is chosen."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest

from freeart21 import catalog, se3
from freeart21.camera import Camera
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from generator.motion import Plan, human_hand, plan_motion
from generator.motion.body import Body
from generator.motion.framing import MARGIN, image_extent
from generator.motion.style import Task
from generator.motion.styles.human import propose
from generator.motion.timing import Hold
from generator.motion.visibility import Atlas
from generator.session import RecordSettings, load_object, plan_recording
from generator.shapes import box, triangles

CAMERA = Camera.from_fov(640, 360, np.radians(40))
MESHES = Mesh(*triangles(box((1, 1, 1)))), Mesh(*triangles(box((1, 1, 0.2), (0, 0, 0.62))))
LID = Joint("lid", "revolute", np.array([0.0, 1, 0]), np.array([0.5, 0, 0.5]), 0.0, 1.4)
BODY = Body.of(MESHES, LID)
SEEDS = range(8)


@functools.cache
def _plan(seed: int, hard: bool | None = False, frames: int = 300, fps: float = 30.0) -> Plan:
    return plan_motion("human", MESHES, LID, CAMERA, frames, fps, seed, hard=hard)


def _degrees(plan: Plan) -> np.ndarray:
    """(n - 1,) rotation from frame to frame, degrees."""
    Rs = plan.Ts_camera_object[:, :3, :3]
    return np.degrees(se3.rotation_angle(Rs[1:] @ np.swapaxes(Rs[:-1], 1, 2)))


# --- what is drawn ----------------------------------------------------------------------------------------------------


def test_sweeps_are_drawn_as_they_were_measured() -> None:
    hands = [human_hand.draw_hand(3000, 30.0, np.random.default_rng(seed)) for seed in range(60)]
    each = [np.log([s.degrees for s in h.sweeps]) for h in hands]
    mean, between, within = human_hand.SWEEP_DEGREES
    assert np.mean([e.mean() for e in each]) == pytest.approx(mean, abs=0.2)
    assert np.std([e.mean() for e in each]) == pytest.approx(between, abs=0.12)
    assert np.mean([e.std() for e in each]) == pytest.approx(within, abs=0.1)
    ends = [(a.start + a.length, b.start) for h in hands for a, b in zip(h.sweeps, h.sweeps[1:], strict=False)]
    at_once = np.mean([start < end for end, start in ends])
    assert at_once == pytest.approx(human_hand.AT_ONCE, abs=0.02)
    assert max(1.875 * s.degrees / s.length for h in hands for s in h.sweeps) <= human_hand.FASTEST + 1e-9
    long = sum(start - end >= 30 for end, start in ends)
    assert sum(len(h.resting_on_table) for h in hands) == pytest.approx(human_hand.LAID * long, rel=0.3)


def test_the_joint_is_worked_as_it_was_measured_and_rests_when_asked_to() -> None:
    courses = [human_hand.draw_joint_course(6000, 30.0, np.random.default_rng(seed)) for seed in range(20)]
    assert all(c.shares.min() >= 0 and c.shares.max() <= 1 for c in courses)
    assert 0.4 < np.mean([np.abs(np.diff(c.shares)) < 0.002 for c in courses]) < 0.85
    for seed in range(8):
        course = human_hand.draw_joint_course(300, 30.0, np.random.default_rng(seed), Hold(0.4, 0.25))
        assert course.held is not None
        a, b = course.held
        assert b - a == pytest.approx(75, abs=1) and b <= 299
        assert np.ptp(course.shares[int(np.ceil(a)) : int(b)]) == pytest.approx(0, abs=1e-9)
        assert course.shares[int(a) + 1] == pytest.approx(0.4, abs=1e-6)


def test_candidates_differ_in_directions_alone() -> None:
    """Else the choice among them would be one of larger sweeps, or of fewer rests."""
    task = Task(BODY, Atlas(BODY, 4.0, 96, 4), 300, 30.0, "none", None, seed=(3, 4))
    rng = np.random.default_rng(0)
    rates = [np.diff(propose(task, rng).clock) for _ in range(3)]
    assert np.array_equal(rates[0], rates[1]) and np.array_equal(rates[0], rates[2])
    other = propose(dataclasses.replace(task, seed=(4, 4)), rng)
    assert not np.allclose(np.diff(other.clock), rates[0])


# --- what comes out ---------------------------------------------------------------------------------------------------


def test_people_hold_and_sweep() -> None:
    """Loose bounds of the measures in docs/recorder.md: what a steady turn, or one without bursts, would not pass."""
    turns = [_degrees(_plan(seed)) for seed in SEEDS]
    medians = np.array([np.median(t) for t in turns])
    assert 0.5 < np.median(medians) < 2.0 and np.ptp(medians) > 0.8  # people differ
    assert max(t.max() for t in turns) > 10
    assert all(t.max() < 1.6 * human_hand.FASTEST for t in turns)  # overlapping submovements add
    assert all(t.max() > 4 * np.median(t) for t in turns)
    assert 0.1 < np.median([np.mean(t < 0.3) for t in turns]) < 0.5
    assert 0.4 < np.median([np.mean(np.abs(np.diff(_plan(k).states)) < 0.002 * 1.4) for k in SEEDS]) < 0.85
    assert all(np.ptp(_plan(seed).states) > 0.7 * 1.4 for seed in SEEDS)


def test_in_rests_the_hand_trembles_and_a_table_does_not() -> None:
    turns = np.concatenate([_degrees(_plan(seed)) for seed in SEEDS])
    assert 0.025 < np.median(turns[turns < 0.3]) < 0.09
    hands = [human_hand.draw_hand(300, 30.0, np.random.default_rng([seed, 11])) for seed in range(200)]
    seed = next(k for k, hand in enumerate(hands) if hand.resting_on_table and hand.resting_on_table[0][1] < 290)
    task = Task(BODY, Atlas(BODY, 4.0, 96, 4), 300, 30.0, "none", None, seed=(seed,))
    course, (a, b) = propose(task, np.random.default_rng(1)), hands[seed].resting_on_table[0]
    part = slice(int(a) + 8, int(b) - 8)
    assert np.ptp(course.Rs[part], axis=0).max() < 1e-9 and np.ptp(course.offsets[part], axis=0).max() < 1e-9


def test_the_same_seed_moves_the_same_and_another_object_differently() -> None:
    again = plan_motion("human", MESHES, LID, CAMERA, 300, 30.0, 1, hard=False)
    assert np.array_equal(again.Ts_camera_object, _plan(1).Ts_camera_object)
    assert np.array_equal(again.states, _plan(1).states)
    long = Mesh(MESHES[0].vertices * [2, 1, 1], MESHES[0].faces)
    other = plan_motion("human", (long, MESHES[1]), LID, CAMERA, 300, 30.0, 1, hard=False)
    assert not np.allclose(_degrees(other), _degrees(again), atol=0.1)


@pytest.mark.parametrize(("frames", "fps"), [(2, 30.0), (12, 30.0), (150, 15.0), (600, 60.0)])
def test_any_length_and_clock(frames: int, fps: float) -> None:
    plan = _plan(2, None, frames, fps)
    low, high = image_extent(plan.Ts_camera_object, plan.states, BODY, CAMERA)
    assert plan.Ts_camera_object.shape == (frames, 4, 4) and low.min() > 0 and (high < [640, 360]).all()
    if frames > 2:
        assert np.ptp(plan.states) > 0.3
    if frames >= 150:  # ten seconds, whatever the clock
        assert 100 < _degrees(plan).sum() < 1500


def test_objects_of_every_category_stay_in_the_picture(tmp_path: Path) -> None:
    for name in catalog.built_in_names()[1::3]:
        settings = RecordSettings(frames=60, seed=5, motion="human")
        loaded = load_object(catalog.find(name), settings, tmp_path)
        camera, plan = plan_recording(loaded, settings)
        body = Body.of((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()), loaded.joint)
        low, high = image_extent(plan.Ts_camera_object, plan.states, body, camera)
        strip = 0.5 * MARGIN * camera.height
        assert low.min() > strip and (high < np.array([camera.width, camera.height]) - strip).all(), name
        assert body.lower <= plan.states.min() and plan.states.max() <= body.upper + 1e-12, name
