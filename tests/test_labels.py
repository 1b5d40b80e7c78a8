"""Part masks from known poses: what frames say, what they tell each other, what stays in doubt; votes on surfaces."""

from dataclasses import replace

import numpy as np
import pytest
from reconstruct_clip import make_clip

from freeart21 import se3
from freeart21.recording import Recording
from reconstruct import kernels, labels
from reconstruct.evidence import Evidence
from reconstruct.labels import SURE
from reconstruct.propagation import body_points
from reconstruct.rigid import view_angle
from reconstruct.scene import prepare_scene, uncrop_labels
from reconstruct.settings import ReconstructSettings, SceneSettings
from reconstruct.votes import SurfaceVotes

FRAMES = 20
SETTINGS = ReconstructSettings()


@pytest.fixture(scope="module")
def clip():
    return make_clip("hinge", FRAMES, spin=0.35)


def evidence_of(recording, scene_settings=SETTINGS.scene):
    scene = prepare_scene(recording, scene_settings)
    return Evidence(scene, SETTINGS.evidence, SETTINGS.labels)


def poses_of(clip, states):
    return np.stack([clip.Ts, clip.Ts @ clip.joint.transform(states)])


def labelled(clip, evidence, states):
    """Log-odds of all frames under the clip's poses and the given states."""
    Ts = poses_of(clip, states)
    everywhere = np.ones(FRAMES, bool)
    body = body_points(evidence, cropped(clip.part_masks, evidence.scene), Ts[1], everywhere)
    nothing = np.zeros(evidence.scene.mask.shape, np.float32)
    both = np.ones((FRAMES, 2), bool)
    return labels.label_frames(evidence, Ts, body, both, nothing, np.random.default_rng(0))


def cropped(masks, scene):
    """Full masks (n, height, width) as the scene's crop pixels see them."""
    h, w = scene.mask.shape[1:]
    f, at = scene.factor, scene.factor // 2
    corners = zip(masks, scene.origin, strict=True)
    cut = [m[y + at : y + at + f * h : f, x + at : x + at + f * w : f] for m, (x, y) in corners]
    return np.stack([m[:h, :w] for m in cut])


def shared(found, truth):
    """Mean IoU of both parts over frames."""
    pairs = [((found == k), (truth == k)) for k in (1, 2)]
    return np.mean([(a & b).sum((1, 2)) / np.maximum((a | b).sum((1, 2)), 1) for a, b in pairs])


def test_true_poses_give_true_labels(clip):
    evidence = evidence_of(clip.recording)
    logodds = labelled(clip, evidence, clip.states)
    found = uncrop_labels(evidence.scene, np.where(logodds > 0, 2, 1).astype(np.uint8), logodds, clip.recording)
    assert shared(found, clip.part_masks) > 0.95


def test_a_joint_that_never_moves_leaves_doubt(clip):
    evidence = evidence_of(clip.recording)
    logodds = labelled(clip, evidence, np.zeros(FRAMES))
    assert np.abs(logodds).max() == 0


def test_a_smaller_crop_keeps_the_outline(clip):
    evidence = evidence_of(clip.recording, SceneSettings(max_crop_pixels=3000))
    assert evidence.scene.factor > 1
    logodds = labelled(clip, evidence, clip.states)
    found = uncrop_labels(evidence.scene, np.where(logodds > 0, 2, 1).astype(np.uint8), logodds, clip.recording)
    masks = np.stack([clip.recording.frame(i).mask for i in range(FRAMES)])
    assert ((found > 0) == masks).mean() > 0.999
    assert shared(found, clip.part_masks) > 0.9


def test_pixels_without_depth_go_with_their_part(clip):
    holes = np.zeros(clip.part_masks.shape, bool)
    holes[:, ::5, ::5] = True
    holes &= clip.part_masks > 0

    def frame(i):
        whole = clip.recording.frame(i)
        return replace(whole, depth=np.where(holes[i], 0, whole.depth).astype(whole.depth.dtype))

    r = clip.recording
    recording = Recording(r.camera, r.times_s, frame, r.queries)
    evidence = evidence_of(recording)
    logodds = labelled(clip, evidence, clip.states)
    found = np.where(logodds > 0, 2, 1) * evidence.scene.mask
    truth = cropped(clip.part_masks, evidence.scene)
    blind = evidence.scene.mask & ~evidence.scene.valid & (truth == 2)
    assert blind.sum() > 50
    assert (found[blind] == 2).mean() > 0.9


def test_telling_frames_are_those_in_which_the_joint_stood_elsewhere(clip):
    Ts = poses_of(clip, np.where(np.arange(FRAMES) < 10, 0.0, 0.5))
    body = clip.joint.pivot + np.array([[0.1, 0, 0], [0, 0, 0.1], [-0.1, 0, 0.1]])
    evidence, everywhere, rng = evidence_of(clip.recording), np.ones(FRAMES, bool), np.random.default_rng(0)
    frames = labels.discriminative_frames(evidence, 3, Ts, body, everywhere, rng)
    assert len(frames) and frames.min() >= 10
    Ts[:, 10:] = se3.pose(se3.exp_so3(np.array([0.0, 2, 0])), np.zeros(3)) @ Ts[:, 10:]  # other surfaces are seen there
    assert len(labels.discriminative_frames(evidence, 3, Ts, body, everywhere, rng)) == 0


def test_random_walk_solves_its_equations():
    rng = np.random.default_rng(0)
    h, w = shape = 8, 7
    valid, number = rng.random(shape) < 0.8, np.arange(h * w).reshape(shape)
    weights, W = np.zeros((6, *shape), np.float32), np.zeros((h * w, h * w))
    for q, step in enumerate(np.repeat(kernels.STEPS, 2)):
        to = np.roll(number, -step, q % 2)
        edge = valid & np.roll(valid, -step, q % 2) & (to > number) & (rng.random(shape) < 0.5)
        weights[q][edge] = rng.random(edge.sum())
        W[number[edge], to[edge]] = W[to[edge], number[edge]] = weights[q][edge]
    strength, target = rng.random(shape) + 0.01, rng.uniform(-1, 1, shape)
    expected = np.linalg.solve(np.diag(strength.ravel() + W.sum(1)) - W, (strength * target).ravel()).reshape(shape)
    found = labels._random_walk(strength, target, rng.uniform(-1, 1, shape), valid, weights, 1e-8, 500)
    np.testing.assert_allclose(found[valid], expected[valid], atol=1e-5)


def test_a_roll_changes_no_view():
    R = se3.exp_so3(np.array([0.3, -0.2, 0.5]))
    rolled = se3.exp_so3(np.array([0, 0, 1.3])) @ R
    turned = se3.exp_so3(np.array([0.4, 0, 0])) @ R
    np.testing.assert_allclose(view_angle(np.stack([rolled, turned]), R), [0, 0.4], atol=1e-6)


# --- beliefs of all frames about each surface: wrong frames are outvoted, frames without a vote do not count ----------


@pytest.fixture(scope="module")
def case(clip):
    evidence = evidence_of(clip.recording)
    truth = cropped(clip.part_masks, evidence.scene)
    logodds = np.where(truth == 2, SURE, np.where(truth == 1, -SURE, 0)).astype(np.float32)
    return clip, evidence, poses_of(clip, clip.states), truth, logodds


def right(beliefs, truth, valid):
    """Share of the valid pixels that are believed to be of their own part."""
    return ((beliefs > 0) == (truth == 2))[valid].mean()


def test_a_wrong_frame_is_outvoted(case):
    _, evidence, Ts, truth, logodds = case
    wrong = logodds.copy()
    wrong[7] *= -1
    votes = SurfaceVotes(evidence, Ts, np.ones((FRAMES, 2), bool))
    found = votes.frame_beliefs(votes.surface_beliefs(wrong, SURE), 7)
    assert right(found, truth[7], evidence.scene.valid[7]) > 0.9  # its own wrong voice counts too


def test_a_blank_frame_gets_beliefs_about_both_parts(case):
    _, evidence, Ts, truth, logodds = case
    blank = logodds.copy()
    blank[7] = 0
    votes = SurfaceVotes(evidence, Ts, np.ones((FRAMES, 2), bool))
    found = votes.frame_beliefs(votes.surface_beliefs(blank, SURE), 7)
    assert right(found, truth[7], evidence.scene.valid[7]) > 0.95
    assert {1, 2} <= set(np.unique(truth[7][np.abs(found) > 0.5]))


def test_frames_without_a_vote_do_not_count(case):
    _, evidence, Ts, truth, logodds = case
    wrong, voting = logodds.copy(), np.ones((FRAMES, 2), bool)
    wrong[:12] *= -1
    everyone = SurfaceVotes(evidence, Ts, voting)
    voting[:12] = False
    few = SurfaceVotes(evidence, Ts, voting)
    valid = evidence.scene.valid[15]
    assert right(everyone.frame_beliefs(everyone.surface_beliefs(wrong, SURE), 15), truth[15], valid) < 0.7
    assert right(few.frame_beliefs(few.surface_beliefs(wrong, SURE), 15), truth[15], valid) > 0.95


def test_votes_are_weighted_by_certainty(case):
    _, evidence, Ts, truth, logodds = case
    mixed = logodds.copy()
    mixed[:15] *= -0.2  # most frames are wrong, and hardly sure
    votes = SurfaceVotes(evidence, Ts, np.ones((FRAMES, 2), bool))
    found = votes.frame_beliefs(votes.surface_beliefs(mixed, SURE), 17)
    assert right(found, truth[17], evidence.scene.valid[17]) > 0.9


def test_labels_of_frames_in_which_the_joint_is_a_guess_come_from_the_others(case):
    _, evidence, Ts, truth, logodds = case
    seen, start = np.ones((FRAMES, 2), bool), logodds.copy()
    seen[9:12, 1] = False
    start[9:12] = -SURE * (truth[9:12] > 0)
    body = body_points(evidence, truth, Ts[1], np.ones(FRAMES, bool))
    found = labels.label_frames(evidence, Ts, body, seen, start, np.random.default_rng(0))
    for i in range(9, 12):
        assert right(found[i], truth[i], evidence.scene.valid[i]) > 0.95
