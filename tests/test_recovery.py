"""Clips in which the joint rests, the object is hidden for a while, or a part appears late."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reconstruct_clip import make_clip
from test_reconstruct import GENTLE, QUIET, true_estimate

from freeart21.files.sequence import read_sequence
from freeart21.recording import Frame, Recording
from reconstruct import seeds
from reconstruct.evidence import Evidence
from reconstruct.propagation import Propagation
from reconstruct.rigid import view_angle
from reconstruct.scene import prepare_scene
from reconstruct.seeds import Seed, find_seeds
from reconstruct.segmentation import add_frames, propagate_from_seeds
from reconstruct.trackers.dis import Dis

SIZE = (160, 120)
SWEEP = np.concatenate([np.linspace(0, 0.5, 7), np.full(17, 0.5), np.linspace(0.5, 1, 8)])
REST = slice(6, 25)
RNG = np.random.default_rng
BUCKET = Path(__file__).resolve().parents[2] / "shared/failing/solver/bucket/data/sequences/bucket-bail-s9"


@pytest.fixture(scope="module")
def resting():
    """A clip whose joint rests for 19 frames, its evidence, its true estimate with certain labels, its tracker."""
    clip = make_clip("hinge", len(SWEEP), size=(200, 150), spin=GENTLE, sweep=SWEEP)
    evidence, true = true_estimate(clip, slice(0, 0), 1)
    return clip, evidence, replace(true, logodds=4 * true.logodds), Dis(evidence.scene, QUIET.tracks)


def without(clip, frames, part=None):
    """`clip` with `part`, or all of the object, cut out of the masks of `frames`."""
    loaded = [clip.recording.frame(i) for i in range(len(clip.states))]
    for i in np.arange(len(loaded))[frames]:
        mask_left = loaded[i].mask & (part is not None) & (clip.part_masks[i] != part)
        loaded[i] = Frame(loaded[i].rgb, loaded[i].depth, mask_left)
    masks = clip.part_masks * np.stack([frame.mask for frame in loaded])
    recording = Recording(clip.recording.camera, clip.recording.times_s, loaded.__getitem__)
    return replace(clip, recording=recording, part_masks=masks)


def state_errors(states, clip):
    """(n,) state errors relative to their median, as a share of the clip's range, up to the sign of the states."""
    sign = np.sign(np.corrcoef(states, clip.states)[0, 1])
    off = sign * states - clip.states
    return (off - np.median(off)) / np.ptp(clip.states)


def right_labels(found, truth):
    """Share of correct labels in each frame that shows the object, with the parts in either order."""
    found = found if (found == truth)[truth > 0].mean() > 0.5 else np.array([0, 2, 1], np.uint8)[found]
    return np.array([(f == t)[t > 0].mean() for f, t in zip(found, truth, strict=True) if t.any()])


def partial_propagation(done, resting, settings):
    """A propagation whose first `done` frames are the true ones."""
    clip, evidence, true, tracker = resting
    nothing = Seed(0, np.zeros(0, np.int64), np.zeros((0, 2, 4, 4)), true.logodds[0], 0.0, 0)
    propagation = Propagation(evidence, tracker, nothing, settings, RNG(0))
    for i in range(done):
        propagation.set_labels(i, true.logodds[i])
    propagation.done[:done] = True
    past = np.arange(len(clip.states)) < done
    Ts = np.where(past[:, None, None], true.poses.Ts, np.eye(4))
    propagation.set_joint(replace(true.poses, states=np.where(past, clip.states, 0), Ts=Ts))
    return propagation


# ---- a rest --------------------------------------------------------------------------------------------------------


def test_propagation_keeps_a_resting_joint_still_and_follows_it_afterwards(resting):
    clip = resting[0]
    propagation = partial_propagation(done=20, resting=resting, settings=QUIET)
    add_frames(propagation, len(SWEEP) - 20)
    steps = np.diff(propagation.states)
    assert (steps[19 : REST.stop - 1] == 0).mean() > 0.5, "not only nearly"
    assert (steps[REST.stop - 1 :] != 0).all()
    assert np.abs(propagation.states - clip.states).max() < 0.017 * np.ptp(clip.states)
    assert propagation.seen.all() and propagation.done.all()


def test_a_joint_that_rests_and_goes_on_is_followed(resting):
    clip, evidence, true, tracker = resting
    rng = RNG(0)
    estimate = propagate_from_seeds(evidence, tracker, find_seeds(evidence, tracker, rng), QUIET, rng)
    off = state_errors(estimate.poses.states, clip)
    assert estimate.poses.joint.type == "revolute"
    assert np.ptp(off[REST]) < 0.028 and np.abs(off).mean() < 0.006 and np.abs(off).max() < 0.015
    assert right_labels(estimate.labels, true.labels).min() > 0.93


@pytest.mark.skipif(not BUCKET.is_dir(), reason="the bucket's video is not on this machine")
def test_a_thin_handle_is_found():
    """A bucket's bail, 3 % of the pixels: too few tracks, but the bucket's motion leaves it unexplained."""
    scene = prepare_scene(read_sequence(BUCKET), QUIET.scene)
    evidence = Evidence(scene, QUIET.evidence, QUIET.labels)
    best = find_seeds(evidence, Dis(scene, QUIET.tracks), RNG(0))[0]
    assert best.pixels < 0.06 * scene.valid[best.frame].sum() and best.evidence > 2 * seeds.LEAST_EVIDENCE
    turned = view_angle(best.Ts[-1, 0, :3, :3], best.Ts[-1, 1, :3, :3])
    assert turned > 0.1, turned
