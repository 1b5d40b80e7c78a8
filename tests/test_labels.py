"""Part masks from known poses: what frames say, what they tell each other, what stays in doubt; votes on surfaces."""

from dataclasses import replace

import numpy as np
import pytest
from reconstruct_clip import make_clip

from freeart21.recording import Recording
from reconstruct import labels
from reconstruct.evidence import Evidence
from reconstruct.labels import SURE
from reconstruct.propagation import body_points
from reconstruct.scene import prepare_scene, uncrop_labels
from reconstruct.settings import ReconstructSettings
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
