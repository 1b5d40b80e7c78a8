"""Part swaps in a stretch of a clip, made by hand here, are undone."""

from dataclasses import replace

import numpy as np
import pytest
from reconstruct_clip import make_clip
from test_reconstruct import GENTLE, QUIET, true_estimate

from freeart21 import se3
from reconstruct.part_swaps import undo_part_swaps

FRAMES = 48
SWEEP = 0.5 - 0.5 * np.cos(3 * np.pi * np.arange(FRAMES) / FRAMES)  # symmetric about frames 16 and 32
REST = slice(18, 30)


def truth_of(name, sweep):
    """The scene of a small clip and its true answer, sure of its labels."""
    clip = make_clip(name, FRAMES, size=(160, 120), spin=GENTLE, sweep=sweep)
    evidence, estimate = true_estimate(clip, slice(0, 0), 1)
    joint = replace(estimate.poses.joint, lower=clip.states.min(), upper=clip.states.max())
    return evidence, replace(estimate, logodds=4 * estimate.logodds, poses=replace(estimate.poses, joint=joint))


@pytest.fixture(scope="module")
def clips():
    return {name: truth_of(name, SWEEP) for name in ("hinge", "slide")}


@pytest.fixture(scope="module")
def resting():
    turn = np.arange(FRAMES) - np.clip(np.arange(FRAMES), REST.start, REST.stop - 1)
    return truth_of("hinge", 0.5 - 0.5 * np.cos(2 * np.pi * (0.3 + turn / 36)))


def within(first, last=FRAMES):
    return (np.arange(FRAMES) >= first) & (np.arange(FRAMES) < last)


def hidden(estimate, frames, part):
    seen = estimate.seen.copy()
    seen[frames, part] = False
    return replace(estimate, seen=seen)


def swap_parts(estimate, side, r):
    """`estimate` with its parts swapped in the frames of `side`, consistently at state r."""
    poses, J = estimate.poses, estimate.poses.joint.transform
    first, second, states = poses.Ts.copy(), poses.Ts_moving.copy(), poses.states.copy()
    first[side], second[side] = poses.Ts_moving[side] @ J(-r), poses.Ts[side] @ J(r)
    states[side] = 2 * r - states[side]
    assert np.allclose(first @ J(states), second, atol=1e-9), "still joined"
    labels, logodds, seen = estimate.labels.copy(), estimate.logodds.copy(), estimate.seen.copy()
    labels[side] = np.array([0, 2, 1], np.uint8)[labels[side]]
    logodds[side], seen[side] = -logodds[side], seen[side][:, ::-1]
    joint = replace(poses.joint, lower=states.min(), upper=states.max())
    poses = replace(poses, joint=joint, states=states, Ts=first)
    return replace(estimate, poses=poses, labels=labels, logodds=logodds, seen=seen)


def undone(evidence, estimate, settings=QUIET.exchanges):
    return undo_part_swaps(evidence, estimate, settings, np.random.default_rng(0))


def as_named_by(found, true, r):
    """`true`, or, where `found` calls the second part the first in most frames, `true` exchanged in all frames."""
    other_way = (found.labels == true.labels)[true.labels > 0].mean() < 0.5
    return swap_parts(true, within(0), r) if other_way else true


def assert_same_poses(found, true):
    relative = se3.inverse(found.Ts) @ found.Ts_moving
    assert np.allclose(relative, se3.inverse(true.Ts) @ true.Ts_moving, atol=1e-9)
    assert np.allclose(found.states, true.states, atol=1e-9) and np.allclose(found.Ts, true.Ts, atol=1e-9)
    assert np.allclose([found.joint.lower, found.joint.upper], [true.joint.lower, true.joint.upper], atol=1e-9)


def assert_same(found, true):
    assert_same_poses(found.poses, true.poses)
    assert np.array_equal(found.labels, true.labels) and np.array_equal(found.logodds, true.logodds)
    assert np.array_equal(found.seen, true.seen)


@pytest.mark.parametrize(
    "first, last", [(24, FRAMES), (36, FRAMES), (12, FRAMES), (22, FRAMES), (25, FRAMES), (24, 40), (8, 24)]
)
@pytest.mark.parametrize("name", ["hinge", "slide"])
def test_an_exchanged_stretch_is_turned_back(name, first, last, clips):
    evidence, true = clips[name]
    r = true.poses.states[first]
    assert last == FRAMES or abs(true.poses.states[last] - r) < 1e-9, "else what follows is shifted for good"
    wrong = swap_parts(true, within(first, last), r)
    found = undone(evidence, wrong)
    assert_same(found, as_named_by(found, true, r))


@pytest.mark.parametrize("part", [0, 1])
@pytest.mark.parametrize("first", [20, 28])
@pytest.mark.parametrize("name", ["hinge", "slide"])
def test_a_hidden_part_is_no_obstacle(name, first, part, clips):
    evidence, true = clips[name]
    true = hidden(true, slice(first, first + 4), part)
    found = undone(evidence, swap_parts(true, within(24), true.poses.states[24]))
    assert_same(found, true)


@pytest.mark.parametrize("name", ["hinge", "slide"])
def test_where_nothing_was_exchanged_nothing_is_turned(name, clips, resting):
    evidence, true = clips[name]
    assert undone(evidence, true) is true
    evidence, true = resting
    assert undone(evidence, true) is true
