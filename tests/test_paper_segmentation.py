"""The paper's part segmentation: its objective against finite differences, its transforms against planted motions."""

from dataclasses import replace

import numpy as np
import pytest
from priors_case import make_or_skip
from reconstruct_clip import make_clip

from freeart21 import se3
from freeart21.reconstruction import Reconstruction
from reconstruct import paper_segmentation, pipeline
from reconstruct.evidence import Evidence
from reconstruct.features import FEATURES
from reconstruct.features.hand_made import HandMade
from reconstruct.paper_segmentation import (
    Graph,
    Pair,
    dense_weights,
    initial_transforms,
    neighbour_graph,
    objective,
    segment,
    solve_pair,
)
from reconstruct.rigid import tukey_weights
from reconstruct.scene import prepare_scene
from reconstruct.settings import GaussianSettings, PaperSegmentationSettings, ReconstructSettings, TrackSettings
from reconstruct.trackers.dis import Dis
from reconstruct.tracks import filter_tracks

PAPER = PaperSegmentationSettings()
AHEAD = np.array([0, 0, 1.5])
SWITCHES = ("main", "smoothness", "entropy", "init")


class Gaussian:
    """Features for descriptors that a test makes itself: one, `x`, for each column of a picture."""

    def __init__(self, x=()):
        self.x = np.asarray(x, float)

    def describe(self, frame, pixels):
        return self.x[np.asarray(pixels)[:, 1]][:, None]

    def similarity(self, squared_distance):
        return np.exp(-0.5 * squared_distance)


def planted(rng, p=400, outliers=0.2, noise=0.002, turn=0.2):
    """Points, where two motions and some nonsense take them, the motions, and who follows which (2: nobody)."""
    X = rng.uniform(-0.5, 0.5, (p, 3)) + AHEAD
    Ts = se3.exp_se3(np.concatenate([rng.normal(size=(2, 3)) * 0.1, rng.normal(size=(2, 3)) * turn], 1))
    part = (X[:, 0] > 0.1).astype(int)
    Y = np.einsum("pij,pj->pi", Ts[part][:, :3, :3], X) + Ts[part][:, :3, 3] + noise * rng.normal(size=X.shape)
    wild = rng.random(p) < outliers
    Y[wild] = rng.uniform(-0.8, 0.8, (int(wild.sum()), 3)) + AHEAD
    return X, Y, Ts, np.where(wild, 2, part)


def pair_of(X, Y, part, rng, wrong=0.0):
    """A frame pair with the true parts as initial weights, some of them `wrong`, and neighbours of like place."""
    w = np.where((part == 1) ^ (rng.random(len(X)) < wrong), 0.95, 0.05)
    return Pair(X, Y, w, neighbour_graph(X / 0.2, Gaussian()))


# --- pieces -----------------------------------------------------------------------------------------------------------


def test_tukey_weights():
    assert np.allclose(tukey_weights(np.array([0, 1, 2, 3.0]), 2.0), [1, 9 / 16, 0, 0])


@pytest.mark.parametrize("off", [(), *((name,) for name in SWITCHES), ("main", "init")])
def test_gradients_are_those_of_finite_differences(off, monkeypatch):
    rng = np.random.default_rng(1)
    X, Y, Ts, part = planted(rng, 60, noise=0.05)
    pair = pair_of(X, Y, part, rng)
    monkeypatch.setattr(paper_segmentation, "HUBER", 0.3)
    monkeypatch.setitem(paper_segmentation.LAMBDAS, "entropy", 3.0)
    settings = replace(PAPER, **{f"use_{name}": False for name in off})
    Ts = se3.exp_se3(0.1 * rng.normal(size=(2, 6))) @ Ts
    w = rng.uniform(0.05, 0.95, len(X))

    def total(Ts, w):
        return sum(objective(pair, Ts, w, settings)[0].values())

    value, dT, dw = objective(pair, Ts, w, settings)
    assert {name for name, v in value.items() if v == 0} == set(off)
    eps = 1e-6
    for k in range(2):
        for c in range(6):
            twist = np.zeros((2, 6))
            twist[k, c] = eps
            slope = (total(se3.exp_se3(twist) @ Ts, w) - total(se3.exp_se3(-twist) @ Ts, w)) / (2 * eps)
            assert dT[k, c] == pytest.approx(slope, rel=1e-4, abs=1e-4)
    for i in range(0, len(w), 7):
        d = np.eye(len(w))[i] * eps
        assert dw[i] == pytest.approx((total(Ts, w + d) - total(Ts, w - d)) / (2 * eps), rel=1e-4, abs=1e-4)


def test_each_term_is_the_papers_formula(monkeypatch):
    X = np.array([[0.0, 0, 1], [1, 0, 1]])
    Y = X + np.array([0.5, 0, 0])
    Ts = np.stack([np.eye(4), se3.pose(np.eye(3), [0.5, 0, 0])])
    pair = Pair(X, Y, np.array([1.0, 0.5]), Graph(np.array([[0, 1]]), np.array([0.4])))
    w = np.array([0.8, 0.3])
    monkeypatch.setattr(paper_segmentation, "EPSILON", 0.0)
    value, _, _ = objective(pair, Ts, w, PAPER)
    assert value["main"] == pytest.approx(
        200 * (0.2 * 0.5 + 0.7 * 0.5)
    )  # standing still leaves all of the way: ratio 1
    assert value["smoothness"] == pytest.approx(10 * 0.4 * 0.5)
    entropy = -sum(p * np.log(p) for p in (0.8, 0.2, 0.3, 0.7))
    assert value["entropy"] == pytest.approx(0.01 * entropy)
    assert value["init"] == pytest.approx(5 * -(np.log(0.8) + 0.5 * np.log(0.3) + 0.5 * np.log(0.7)))


@pytest.mark.parametrize("seed", range(4))
def test_two_planted_motions_are_found_among_outliers(seed):
    rng = np.random.default_rng(seed)
    X, Y, Ts, part = planted(rng)
    guess = (part == 1) ^ (rng.random(len(X)) < 0.25)
    found, second = initial_transforms(X, Y, guess, 0.03, rng)
    for mine, true in zip(found, Ts, strict=True):
        off = se3.log_se3(mine @ se3.inverse(true))
        assert np.linalg.norm(off[:3]) < 0.01 and np.linalg.norm(off[3:]) < 0.01
    assert (second == (part == 1))[part < 2].mean() > 0.97


@pytest.mark.parametrize("most", [4, 3])
def test_fill_keeps_tracks_and_gives_the_rest_to_whom_they_resemble(most):
    features = Gaussian([0, 0.2, 0.3, 5, 5.2, 5.3, 5.4])
    foreground = np.array([[True] * 6 + [False]])
    pixels = np.array([[0, 0], [0, 1], [0, 3], [0, 4]])
    known = np.array([0.1, 0.2, 0.9, 0.8])
    dense = dense_weights(features, 0, foreground, pixels, known, most)
    assert np.allclose(dense[0, [0, 1, 3, 4, 6]], [*known, 0.5])
    s = np.exp(-0.5 * np.array([0.3, 0.1, 4.7, 4.9]) ** 2)
    if most == 4:
        assert dense[0, 2] == pytest.approx(s @ known / s.sum())
    assert dense[0, 2] == pytest.approx(0.15, abs=0.01) and dense[0, 5] == pytest.approx(0.85, abs=0.01)


def test_each_track_filter_has_its_switch():
    """Tracks: steady; doubted at step 2; off the object at step 2; a leap at step 3."""
    points = np.zeros((40, 4, 3))
    points[:, :, 0] = 0.01 * np.arange(4) + 0.001 * np.arange(40)[:, None] * np.arange(4) / 40
    points[3, 3, 1] = 1.0
    confidence, on_object = np.ones((40, 4)), np.ones((40, 4), bool)
    confidence[1, 2], on_object[2, 2] = 0.6, False
    visible = filter_tracks(points, confidence, on_object, TrackSettings())
    assert visible[[0, 1]].all()
    assert visible[2].tolist() == [True, True, False, False] and visible[3].tolist() == [True, True, True, False]
    strict = filter_tracks(points, confidence, on_object, TrackSettings(tau_c=0.7))
    assert strict[1].tolist() == [True, True, False, False]
    blind = filter_tracks(points, confidence, on_object, TrackSettings(tau_c=0.7, visibility_filter=False))
    assert blind[1].all() and not blind[2, 2]
    assert filter_tracks(points, confidence, on_object, TrackSettings(displacement_filter=False))[3].all()


# --- the solver -------------------------------------------------------------------------------------------------------


def wrong_after(pair, start, part, settings):
    """Share of wrongly labelled tracks, and the solution, after `solve_pair`."""
    Ts, w = solve_pair(pair, start, settings)
    return float(((w > 0.5) != (part == 1)).mean()), Ts, w


def test_the_objective_corrects_wrong_labels_and_each_switch_has_its_effect(monkeypatch):
    """While both parts travel far together."""
    rng = np.random.default_rng(0)
    X, _, Ts, part = planted(rng, 500, outliers=0.0)
    Ts = se3.pose(np.eye(3), [1.0, 0, 0]) @ Ts
    places = np.einsum("kij,pj->kpi", Ts[:, :3, :3], X) + Ts[:, None, :3, 3]
    bad = rng.random(len(X)) < 0.12  # tracks that slip onto the other part
    Y = places[np.where(bad, 1 - part, part), np.arange(len(X))]
    pair = pair_of(X, Y, part, rng, wrong=0.1)
    asleep = wrong_after(pair, Ts, part, replace(PAPER, use_main=False, use_smoothness=False, use_entropy=False))
    assert asleep[0] > 0.07 and np.allclose(asleep[2], pair.w_init, atol=0.02)
    whole = wrong_after(pair, Ts, part, PAPER)
    rough = wrong_after(pair, Ts, part, replace(PAPER, use_smoothness=False))
    unheld = wrong_after(pair, Ts, part, replace(PAPER, use_init=False))
    assert whole[0] < 0.06 and rough[0] > 1.7 * whole[0] and unheld[0] > 1.3 * whole[0]
    believed = wrong_after(pair, Ts, part, replace(PAPER, use_smoothness=False, use_init=False))[2] > 0.5
    assert (believed[bad] != (part[bad] == 1)).all()  # main alone goes by the tracks, slipped ones too
    entropy = replace(PAPER, use_main=False, use_init=False, use_smoothness=False)
    monkeypatch.setitem(paper_segmentation.LAMBDAS, "entropy", 1.0)
    assert np.abs(wrong_after(pair, Ts, part, entropy)[2] - 0.5).min() > 0.49
    monkeypatch.setitem(paper_segmentation.LAMBDAS, "entropy", -1.0)
    assert np.abs(wrong_after(pair, Ts, part, entropy)[2] - 0.5).max() < 0.1


# --- whole clips ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def slide():
    clip = make_clip("slide", 16, spin=0.3)
    settings = ReconstructSettings()
    scene = prepare_scene(clip.recording, settings.scene)
    evidence = Evidence(scene, settings.evidence, settings.labels)
    return clip, evidence, Dis(scene, settings.tracks), HandMade(scene, settings.features)


def crop_truth(clip, scene):
    assert scene.factor == 1
    h, w = scene.mask.shape[1:]
    return np.stack([m[y : y + h, x : x + w] for m, (x, y) in zip(clip.part_masks, scene.origin, strict=True)])


def ious(weights, truth):
    """(n,) mean IoU of the parts of each frame; parts swapped in all frames or in none."""
    found = np.where(truth > 0, np.where(weights > 0.5, 2, 1), 0)
    either = []
    for names in ((1, 2), (2, 1)):
        mine = [((found == a) & (truth == b), (found == a) | (truth == b)) for a, b in zip((1, 2), names, strict=True)]
        either.append(np.mean([x.sum((1, 2)) / np.maximum(y.sum((1, 2)), 1) for x, y in mine], 0))
    return max(either, key=lambda iou: iou.mean())


OF_POINTS = {"xfeat"}
"""Features made to tell points of one surface apart, which say little of parts."""


@pytest.mark.parametrize("name", FEATURES)
def test_features_are_more_similar_within_a_part_than_between_two(name, slide):
    clip, evidence, _, features = slide
    scene = evidence.scene
    at = np.argwhere(scene.valid[0] & ~scene.edge[0])[::7]
    part = crop_truth(clip, scene)[0][tuple(at.T)]
    model = make_or_skip(FEATURES[name], scene, features.settings)
    found = model.describe(0, at)
    assert found.ndim == 2 and len(found) == len(at) and np.isfinite(found).all()
    similarity = model.similarity(((found[:, None] - found[None]) ** 2).sum(-1))
    assert similarity.min() >= 0 and np.allclose(np.diag(similarity), 1) and similarity.max() <= 1 + 1e-9
    same = part[:, None] == part[None]
    ratio = 1.1 if name in OF_POINTS else 1.5
    assert similarity[same].mean() > ratio * similarity[~same].mean()


def test_features_are_of_the_surface_and_may_be_left_out(slide):
    clip, evidence, _, features = slide
    scene = evidence.scene
    at = np.argwhere(scene.valid[0])
    assert features.describe(0, at).shape == (len(at), 12)
    assert np.isfinite(features.describe(0, at)).all()
    part = crop_truth(clip, scene)[0][tuple(at.T)]
    colour = HandMade(scene, replace(features.settings, gradient=0, place=0, normal=0, curvature=0))
    d = colour.describe(0, at)
    assert d.shape[1] == 3
    between = np.linalg.norm(d[part == 1].mean(0) - d[part == 2].mean(0))
    assert between > 1  # a warm and a cold part: one unit of distance or more


def test_parts_are_found_and_keep_their_names_across_windows(slide, monkeypatch):
    clip, evidence, tracker, features = slide
    truth = crop_truth(clip, evidence.scene)
    monkeypatch.setattr(paper_segmentation, "MAX_TRACKS", 400)
    found, again = (segment(evidence, tracker, features, PAPER, np.random.default_rng(0)) for _ in range(2))
    assert np.array_equal(found.weights, again.weights)
    iou = ious(found.weights, truth)
    assert iou.mean() > 0.8 and iou[8:].min() > 0.7, iou  # frames 8 on are of the second window and the third
    true = [clip.Ts, clip.Ts @ clip.joint.transform(clip.states)]
    first = int(((found.weights > 0.5) & (truth == 2)).sum() < ((found.weights > 0.5) & (truth == 1)).sum())
    for k in range(2):
        T = true[1 - k if first else k]
        steps = T[1:] @ se3.inverse(T[:-1])
        off = se3.rotation_angle((found.motions[:-1, k] @ se3.inverse(steps))[:, :3, :3])
        assert np.median(off) < 0.3 * np.median(se3.rotation_angle(steps[:, :3, :3])), off


def test_a_whole_result_comes_of_the_papers_labels_alone(monkeypatch):
    def never(*_):
        raise AssertionError("the paper's labels are not made anew")

    for name in ("relabel_frames", "find_seeds", "propagate_from_seeds"):
        monkeypatch.setattr(pipeline, name, never)
    clip = make_clip("slide", 12, (120, 90), spin=0.25)
    geometry = ReconstructSettings(segmentation="paper", gaussians=GaussianSettings(refine=False), progress=False)
    result = pipeline.reconstruct(clip.recording, geometry)
    assert isinstance(result, Reconstruction) and result.articulation.joint.type == "prismatic"
    first = result.Ts_camera_reference[0] @ np.append(result.articulation.joint.axis, 0)
    true = clip.Ts[0] @ np.append(clip.joint.axis, 0)
    assert abs(first @ true) > np.cos(np.radians(3))
