"""The style `human`: submovements and rests as measured, whichever candidate is chosen."""

from __future__ import annotations

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
from generator.object_source import find_object
from generator.session import RecordSettings, plan_recording
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
        loaded = find_object(name, settings).load(tmp_path)
        camera, plan = plan_recording(loaded, settings)
        body = Body.of((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()), loaded.joint)
        low, high = image_extent(plan.Ts_camera_object, plan.states, body, camera)
        strip = 0.5 * MARGIN * camera.height
        assert low.min() > strip and (high < np.array([camera.width, camera.height]) - strip).all(), name
        assert body.lower <= plan.states.min() and plan.states.max() <= body.upper + 1e-12, name
