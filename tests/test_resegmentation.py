"""A stretch in which tracking was lost is segmented anew from its own seed, with consistent part names."""

import numpy as np
import pytest
from reconstruct_clip import make_clip
from test_reconstruct import GENTLE, QUIET, true_estimate
from test_recovery import RNG, right_labels

from reconstruct.propagation import Propagation
from reconstruct.resegmentation import find_lost_stretches
from reconstruct.seeds import Seed
from reconstruct.segmentation import _resegment
from reconstruct.trackers.dis import Dis

FRAMES = 32
STRETCH = np.arange(12, 24)
NAMES = ("hinge", "slide")
SWEEP = 0.5 - 0.5 * np.cos(3 * np.pi * np.arange(FRAMES) / FRAMES)


@pytest.fixture(scope="module")
def films():
    return {name: filmed(make_clip(name, FRAMES, size=(160, 120), spin=GENTLE, sweep=SWEEP)) for name in NAMES}


def filmed(clip):
    evidence, true = true_estimate(clip, slice(0, 0), 1)
    return clip, evidence, true, Dis(evidence.scene, QUIET.tracks)


def lost_propagation(film, turn, shift, swap):
    """The true propagation, except for STRETCH: there poses are turned, states shifted or parts swapped."""
    clip, evidence, true, tracker = film
    nothing = Seed(0, np.zeros(0, np.int64), np.zeros((0, 2, 4, 4)), 4 * true.logodds[0], 0.0, 0)
    propagation = Propagation(evidence, tracker, nothing, QUIET, RNG(0))
    for i in range(FRAMES):
        wrong = i in STRETCH and swap
        propagation.set_labels(i, (-4 if wrong else 4) * np.where(true.labels[i] > 0, true.logodds[i], 0))
    propagation.done[:] = True
    propagation.set_joint(true.poses)
    propagation.costs[:] = 0.1
    for i in STRETCH:
        T = propagation.Ts[0, i].copy()
        T[:3, :3] = turn @ T[:3, :3]
        propagation.set_pose(int(i), T, propagation.states[i] + shift * np.ptp(clip.states))
        propagation.costs[i] = 2.0
    return propagation


def quarter_turn():
    return np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


@pytest.mark.parametrize(
    "name, turn, shift, swap",
    [("hinge", np.eye(3), 0.6, False), ("slide", np.eye(3), -0.5, True), ("hinge", quarter_turn(), 0, True)],
)
def test_a_lost_stretch_is_found_and_replaced(name, turn, shift, swap, films):
    clip, _, true, _ = films[name]
    propagation = lost_propagation(films[name], turn, shift, swap)
    (stretch,) = find_lost_stretches(propagation)
    assert np.array_equal(stretch, STRETCH)
    assert _resegment(propagation, stretch, RNG(0))
    off = np.abs(propagation.states - clip.states) / np.ptp(clip.states)
    assert np.median(off) < 0.01 and off.max() < 0.08
    assert right_labels(propagation.labels, true.labels).min() > 0.85
    named = (propagation.labels == true.labels)[true.labels > 0].mean()
    assert named > 0.95, "with the part names of the rest"


def test_reliable_frames_are_not_replaced(films):
    propagation = lost_propagation(films["slide"], np.eye(3), 0.0, False)
    Ts, labels = propagation.Ts.copy(), propagation.labels.copy()
    propagation.costs[:] = 0.1
    assert find_lost_stretches(propagation) == []
    propagation.costs[STRETCH] = 2.0  # seems lost, yet no new segmentation fits better
    assert not _resegment(propagation, STRETCH, RNG(0))
    assert np.array_equal(propagation.Ts, Ts) and np.array_equal(propagation.labels, labels)
