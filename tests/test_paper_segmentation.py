"""The paper's part segmentation: its objective against finite differences, its transforms against planted motions."""

import numpy as np
import pytest
from reconstruct_clip import make_clip

from baselines import paper, paper_features, paper_segmentation
from baselines.paper_segmentation import Pair, initial_transforms, neighbour_graph, objective
from freeart21 import se3
from freeart21.files.result import read_result
from freeart21.files.sequence import write_sequence
from freeart21.reconstruction import Reconstruction
from reconstruct import pipeline
from reconstruct.scene import prepare_scene
from reconstruct.settings import SceneSettings

AHEAD = np.array([0, 0, 1.5])


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
    return Pair(X, Y, w, neighbour_graph(X / 0.2))


# --- pieces -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("term", ["MAIN", "SMOOTHNESS", "ENTROPY", "INIT"])
def test_gradients_are_those_of_finite_differences(term, monkeypatch):
    rng = np.random.default_rng(1)
    X, Y, Ts, part = planted(rng, 60, noise=0.05)
    pair = pair_of(X, Y, part, rng)
    monkeypatch.setattr(paper_segmentation, "HUBER", 0.3)
    for name in ("MAIN", "SMOOTHNESS", "ENTROPY", "INIT"):
        monkeypatch.setattr(paper_segmentation, name, 3.0 if name == term else 0.0)
    Ts = se3.exp_se3(0.1 * rng.normal(size=(2, 6))) @ Ts
    w = rng.uniform(0.05, 0.95, len(X))

    def total(Ts, w):
        return objective(pair, Ts, w)[0]

    value, dT, dw = objective(pair, Ts, w)
    assert value > 0
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


# --- whole clips ------------------------------------------------------------------------------------------------------


def test_features_are_more_similar_within_a_part_than_between_two():
    clip = make_clip("slide", 16, spin=0.3)
    scene = prepare_scene(clip.recording, SceneSettings())
    at = np.argwhere(scene.valid[0] & ~scene.edge[0])[::7]
    part = clip.part_masks[0][tuple((at + scene.origin[0, ::-1]).T)]
    found = paper_features.describe(scene, 0, at)
    similarity = paper_features.similarity(((found[:, None] - found[None]) ** 2).sum(-1))
    assert similarity.min() >= 0 and np.allclose(np.diag(similarity), 1) and similarity.max() <= 1 + 1e-9
    same = part[:, None] == part[None]
    assert similarity[same].mean() > 1.5 * similarity[~same].mean()


def test_a_whole_result_comes_of_the_papers_labels_alone(monkeypatch, tmp_path):
    def never(*_):
        raise AssertionError("the paper's labels are not made anew")

    for name in ("relabel_frames", "find_seeds", "propagate_from_seeds"):
        monkeypatch.setattr(pipeline, name, never)
    clip = make_clip("slide", 12, (120, 90), spin=0.25, queries=((3, 8, np.eye(4)),))
    write_sequence(tmp_path / "s", clip.recording, 2e-5)
    paper.main(tmp_path / "s", tmp_path / "r")
    result = read_result(tmp_path / "r")
    assert (tmp_path / "r" / "renders" / "00000.png").is_file()
    assert isinstance(result, Reconstruction) and result.articulation.joint.type == "prismatic"
    first = result.Ts_camera_reference[0] @ np.append(result.articulation.joint.axis, 0)
    true = clip.Ts[0] @ np.append(clip.joint.axis, 0)
    assert abs(first @ true) > np.cos(np.radians(3))
