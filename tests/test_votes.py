"""Beliefs of all frames about each surface: wrong frames are outvoted, and frames without a vote do not count."""

import numpy as np
import pytest
from reconstruct_clip import make_clip
from test_labels import cropped, evidence_of, poses_of

from reconstruct.labels import SURE, label_frames
from reconstruct.propagation import body_points
from reconstruct.votes import SurfaceVotes

FRAMES = 20


@pytest.fixture(scope="module")
def case():
    clip = make_clip("hinge", FRAMES, spin=0.35)
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
    found = label_frames(evidence, Ts, body, seen, start, np.random.default_rng(0))
    for i in range(9, 12):
        assert right(found[i], truth[i], evidence.scene.valid[i]) > 0.95
