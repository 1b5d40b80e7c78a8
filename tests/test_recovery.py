"""Clips in which the joint rests, the object is hidden for a while, or a part appears late."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reconstruct_clip import make_clip
from test_reconstruct import GENTLE, QUIET, true_estimate

from freeart21 import se3
from freeart21.files.sequence import read_sequence
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Frame, Recording
from reconstruct import seeds, segmentation
from reconstruct.evidence import Evidence
from reconstruct.paper_segmentation import PartWeights, part_poses
from reconstruct.pipeline import reconstruct
from reconstruct.propagation import Propagation
from reconstruct.recovery import _match_poses, _UnlabelledFrame
from reconstruct.rigid import view_angle
from reconstruct.scene import UnsolvableError, prepare_scene
from reconstruct.seeds import Seed, find_seeds
from reconstruct.segmentation import _initial_propagation, add_frames, propagate_from_seeds, redo_lost_frames
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


def test_redoing_lost_frames_corrects_them(resting):
    clip, _, true, _ = resting
    propagation = partial_propagation(done=30, resting=resting, settings=QUIET)
    lost = np.arange(15, 24)
    propagation.states[lost] += 0.5 * np.ptp(clip.states)
    propagation.Ts[1, lost] = propagation.Ts[0, lost] @ propagation.joint.transform(propagation.states[lost])
    for i in lost:
        propagation.set_labels(int(i), np.where(true.labels[i] > 0, -3, 0).astype(np.float32))
    assert redo_lost_frames(propagation, 24, 23)
    assert np.abs(propagation.states[:30] - clip.states[:30]).max() < 0.02 * np.ptp(clip.states)


# ---- hidden frames ------------------------------------------------------------------------------------------------


def test_both_sides_of_blank_frames_are_solved_as_one():
    frames, blank = 20, slice(9, 12)
    clip = without(make_clip("hinge", frames, size=SIZE, spin=GENTLE), blank)
    result = reconstruct(clip.recording, QUIET)
    assert isinstance(result, Reconstruction) and result.articulation.joint.type == "revolute"
    shown = np.ones(frames, bool)
    shown[blank] = False
    assert np.array_equal(result.seen.all(1), shown) and not result.seen[blank].any()
    off = state_errors(result.states, clip)
    assert np.abs(off[shown]).max() < 0.016 and np.abs(off).max() < 0.06
    share = right_labels(result.part_masks, clip.part_masks)
    assert len(share) == shown.sum() and share.min() > 0.91
    swapped = (result.part_masks == clip.part_masks)[clip.part_masks > 0].mean() < 0.5
    T = se3.inverse(clip.Ts) @ (result.Ts_camera_moving if swapped else result.Ts_camera_reference)
    drift = se3.log_se3(se3.inverse(se3.mean_pose(T[shown])) @ T[shown])
    assert np.linalg.norm(drift[:, 3:], axis=1).max() < 0.038, "no turn of the reference part behind the blank frames"


# ---- a part that appears late, under the paper's segmentation ------------------------------------------------------


def test_poses_under_the_papers_labels_when_a_part_appears_late():
    late = 3
    clip = without(make_clip("hinge", 12, size=SIZE, spin=GENTLE), slice(0, late), part=2)
    evidence, true = true_estimate(clip, slice(0, 0), 1)
    given = PartWeights((true.labels == 2).astype(np.float32), np.tile(np.eye(4), (12, 2, 1, 1)))
    estimate = part_poses(evidence, Dis(evidence.scene, QUIET.tracks), given, QUIET, RNG(0))
    assert estimate.seen[:, 0].all() and np.array_equal(estimate.seen[:, 1], np.arange(12) >= late)
    assert estimate.poses.joint.type == "revolute"
    assert np.abs(state_errors(estimate.poses.states, clip)[late:]).max() < 0.016


# ---- recovery ----------------------------------------------------------------------------------------------


class TrueMatches(Dis):
    """Points carried by the true poses, every fifth to a wrong place."""

    def match(self, first, second):
        scene, labels = self.scene, self.labels
        at = np.argwhere(labels[first] > 0)[::17]
        Ts = np.stack([self.clip.Ts, self.clip.Ts @ self.clip.joint.transform(self.clip.states)], 1)
        motion = (Ts[second] @ se3.inverse(Ts[first]))[labels[first][tuple(at.T)] - 1]
        moved = np.einsum("mij,mj->mi", motion[:, :3, :3], scene.points[first][tuple(at.T)]) + motion[:, :3, 3]
        there = moved[:, :2] / moved[:, 2:] * (scene.fx, scene.fy)
        there += np.stack([scene.cx[second], scene.cy[second]])
        there[::5] = there[::5][::-1]
        x, y = np.rint(there).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < scene.mask.shape[2]) & (y < scene.mask.shape[1])
        inside[inside] = labels[second, y[inside], x[inside]] == labels[first][tuple(at.T)][inside]
        return at[inside][:, ::-1].astype(float), there[inside]


def test_a_part_is_found_again_by_its_points(resting):
    """Points give pose and state of a frame far from the last known one; none where a tracker knows no points."""
    clip, evidence, true, _ = resting
    frame, known = 22, np.arange(12)
    tracker = TrueMatches(evidence.scene, QUIET.tracks)
    tracker.clip, tracker.labels = clip, true.labels
    propagation = partial_propagation(done=12, resting=resting, settings=QUIET)
    view = _UnlabelledFrame(propagation, frame, np.array([2, 7, 10]), np.zeros((0, 2), int), np.zeros(0, int))
    before = propagation.rng.bit_generator.state
    assert _match_poses(propagation, view, 0.0, 0.0, known) == []
    assert propagation.rng.bit_generator.state == before, "the same answer as without such a way"
    propagation.tracker = tracker
    guesses = _match_poses(propagation, view, 0.0, 0.0, known)
    off = [
        (np.degrees(np.linalg.norm(se3.log_so3(T[:3, :3].T @ clip.Ts[frame, :3, :3]))), abs(q - clip.states[frame]))
        for T, q in guesses
    ]
    assert min(turn for turn, _ in off) < 1
    assert any(turn < 1 and state < 0.03 * np.ptp(clip.states) for turn, state in off)


def test_an_object_that_turned_far_while_it_was_hidden_is_found_again_by_its_points():
    frames, first, last = 22, 10, 18
    clip = without(make_clip("hinge", frames, size=SIZE, spin=0.8), slice(first, last))
    evidence, true = true_estimate(clip, slice(first, last), slice(None))
    true = replace(true, logodds=4 * true.logodds)
    turn = {}
    for kind in (Dis, TrueMatches):
        tracker = kind(evidence.scene, QUIET.tracks)
        tracker.clip, tracker.labels = clip, true.labels
        propagation = partial_propagation(first, (clip, evidence, true, tracker), QUIET)
        add_frames(propagation, last + 1 - first)
        R = propagation.Ts[0, last, :3, :3].T @ clip.Ts[last, :3, :3]
        turn[kind] = np.degrees(np.linalg.norm(se3.log_so3(R)))
    assert turn[TrueMatches] < 10 < 40 < turn[Dis], turn


def test_the_seed_whose_joint_explains_its_frames_best_is_taken(resting, monkeypatch):
    _, evidence, true, tracker = resting
    good = find_seeds(evidence, tracker, RNG(0))
    at = 9  # the joint rests: halves of the picture are taken for parts
    halves = np.where(np.arange(true.labels.shape[2]) < true.labels.shape[2] // 2, -3, 3)
    others = np.arange(at + 1, at + 7)
    Ts = true.poses.Ts[others] @ se3.inverse(true.poses.Ts[at])
    bad = Seed(at, others, np.stack([Ts, Ts], 1), np.where(true.labels[at] > 0, halves, 0).astype(np.float32), 1.0, 100)
    monkeypatch.setattr(segmentation, "SEED_DISTANCE", 1)

    def start_from(*seeds):
        return _initial_propagation(evidence, tracker, seeds, QUIET, RNG(0))[0]

    def right(propagation):
        return right_labels(propagation.labels[propagation.done], true.labels[propagation.done]).mean()

    assert right(start_from(bad)) < 0.8 < 0.93 < right(start_from(bad, *good))
    assert right(start_from(good[0], bad)) > 0.93


@pytest.mark.parametrize(
    "pixels, evidence, shown, left_out",
    [
        (29, 1.5, ["shows on 29 pixels, at least 30 are needed"], ["factor"]),
        (200, 0.89, ["by a factor of 1.8, at least 1.9 is needed"], ["shows on"]),
        (20, 0.5, ["shows on 20 pixels", "by a factor of 1.5"], []),
    ],
)
def test_a_rejection_names_the_failed_tests_only(pixels, evidence, shown, left_out):
    def window(frame, pixels, evidence):
        nothing = np.zeros((0, 2, 4, 4))
        return Seed(frame, np.zeros(0, int), nothing, np.zeros((1, 1), np.float32), evidence, pixels)

    text = seeds._explain_rejection([window(3, 10, 0.01), window(7, pixels, evidence)])
    assert "frame 7 comes nearest" in text and all(words in text for words in shown), text
    assert not any(words in text for words in left_out), text


@pytest.mark.parametrize(
    "name, value, words",
    [
        ("SAMPLE", 10**6, r"\d+ points of the object can be followed, at least 8000000 are needed"),
        ("NEIGHBOURHOOD", 1e-6, "0 neighbourhoods hold 8 points that can be followed, at least 2 are needed"),
        ("FRAME_GAPS", (1000,), "hold no pair 1000 apart"),
    ],
)
def test_a_rejection_by_the_tracks_names_the_failed_test(resting, monkeypatch, name, value, words):
    _, evidence, _, tracker = resting
    monkeypatch.setattr(seeds, name, value)
    monkeypatch.setattr(seeds, "find_unexplained_parts", lambda *_: [])
    with pytest.raises(UnsolvableError, match=words):
        find_seeds(evidence, tracker, RNG(0))


@pytest.mark.skipif(not BUCKET.is_dir(), reason="the bucket's video is not on this machine")
def test_a_thin_handle_is_found():
    """A bucket's bail, 3 % of the pixels: too few tracks, but the bucket's motion leaves it unexplained."""
    scene = prepare_scene(read_sequence(BUCKET), QUIET.scene)
    evidence = Evidence(scene, QUIET.evidence, QUIET.labels)
    best = find_seeds(evidence, Dis(scene, QUIET.tracks), RNG(0))[0]
    assert best.pixels < 0.06 * scene.valid[best.frame].sum() and best.evidence > 2 * seeds.LEAST_EVIDENCE
    turned = view_angle(best.Ts[-1, 0, :3, :3], best.Ts[-1, 1, :3, :3])
    assert turned > 0.1, turned
