"""The laws of strict-3 on a made-up truth, what each fault costs there, and that cheating does not pay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from perturbed import moving_part_off_by
from synthetic_case import (
    in_frame,
    make_truth,
    noisy_answer,
    random_answer,
    random_pose,
    static_answer,
    truth_as_answer,
    with_names_exchanged,
)

from benchmarks.gaming import CHEATS, NOTHING, make_honest, score
from freeart21.articulation import Articulation
from freeart21.mesh import Mesh
from leaderboard.depth_views import cameras, draw
from leaderboard.points import TRACKS
from leaderboard.protocol import Case, Shape
from leaderboard.protocols import strict3
from leaderboard.protocols.strict3 import STRICT_3, Strict3, cell_weights, picture_values

KINDS = pytest.mark.parametrize("kind", ["revolute", "prismatic"])
QUICK = Strict3(samples=3000)
RULES = replace(STRICT_3, measure=lambda case: strict3.measure(case, QUICK))


def on_white(truth):
    return [np.where(truth.query_mask(i)[..., None], truth.query_rgb(i), 255).astype(np.uint8) for i in range(2)]


def scored(truth, answer, renders=None):
    case = Case(truth, answer, on_white(truth) if renders is None else renders)
    return strict3.measure(case, QUICK).values


@KINDS
def test_the_truth_is_perfect(kind):
    truth = make_truth(kind)
    answer = truth_as_answer(truth)
    motions = np.stack([answer.articulation.joint.transform(q) for q in answer.states])
    shape = Shape((answer.articulation.reference, answer.articulation.moving), motions)
    asset = strict3.measure(Case(truth, answer, on_white(truth), shape), QUICK).values
    for values in (scored(truth, answer), asset):
        assert set(values) == {m.id for m in STRICT_3.metrics if kind == "revolute" or "position" not in m.id}
        for metric in STRICT_3.metrics:
            best = 100 if metric.id == "psnr" else 1 if metric.direction == "up" else 0
            assert values.get(metric.id, best) == pytest.approx(best, abs=1e-6), metric.id


@KINDS
def test_what_is_the_methods_own_affair_changes_nothing(kind):
    truth = make_truth(kind)
    answer = noisy_answer(truth)
    values = scored(truth, answer)
    for same in (in_frame(answer, random_pose(np.random.default_rng(1), 3.0)), with_names_exchanged(answer)):
        found = scored(truth, same)
        for id, value in values.items():
            tolerance = 0.15 if id.startswith("chamfer") else 0.01  # other samples, another rounding of pixels
            assert found[id] == pytest.approx(value, rel=tolerance, abs=1e-6), id


@KINDS
def test_bad_answers_are_bad(kind):
    truth = make_truth(kind)
    noisy = scored(truth, noisy_answer(truth))
    for answer in (static_answer(truth), random_answer(truth)):
        found = scored(truth, answer)
        for id in ("depth_median", "chamfer_w", "chamfer_m"):
            assert found[id] > noisy[id]
        assert found["silhouette"] < noisy["silhouette"]


def test_a_shifted_part_costs_its_shift():
    truth = make_truth()
    x = 0.004
    found = scored(truth, moving_part_off_by(truth, x))
    assert found["chamfer_m"] == pytest.approx(100 * x / truth.diagonal, rel=0.2)
    assert 0.5 * 100 * x / truth.diagonal < found["depth_95"] < 100 and found["silhouette"] < 1


def test_depth_is_that_of_the_nearest_surface():
    centre, box = np.array([0.1, 0.2, 0.3]), make_truth().articulation.reference
    box = Mesh(box.vertices - box.vertices.mean(0) + centre, box.faces)
    far = Mesh(np.full((3, 3), 50.0), np.array([[0, 1, 2]]))
    for T in cameras(centre, 1.0):
        view = draw((box, far), (T, T))
        middle = view.depth[128, 128]
        assert 3.0 - 0.26 <= middle < 3.0 and view.part[128, 128] == 0 and view.face[128, 128] >= 0
        assert not np.isfinite(view.depth[0, 0]) and view.part[0, 0] == -1
        assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3)) and np.linalg.det(T[:3, :3]) > 0


def test_surfaces_that_the_video_never_shows_cost_no_depth():
    truth = make_truth()
    hidden = truth.articulation.reference
    flags = hidden.vertices[hidden.faces].mean(1)[:, 2] > -0.049  # all but the bottom
    unseen = replace(truth, visible=(flags, truth.visible[1]))
    parts = truth.articulation
    inside = (hidden.vertices[:, 2] < -0.049) & (np.abs(hidden.vertices[:, :2]) < [0.19, 0.14]).all(1)
    dented = hidden.vertices + np.where(inside[:, None], [[0, 0, 0.06]], 0.0)
    answer = replace(
        truth_as_answer(truth), articulation=Articulation(parts.joint, Mesh(dented, hidden.faces), parts.moving)
    )
    assert scored(truth, answer)["depth_95"] > 1 > scored(unseen, answer)["depth_95"]


def test_a_crowd_of_samples_counts_as_one():
    points = np.concatenate([np.zeros((99, 3)), [[1.0, 0, 0]]])
    weights = cell_weights(points, 0.1)
    assert weights[:99].sum() == pytest.approx(1) and weights[99] == 1
    assert len(cell_weights(np.zeros((0, 3)), 0.1)) == 0
    assert np.isfinite(cell_weights(np.array([[0.0, 0, 0], [1e9, 0, 0]]), 1e-3)).all()


def test_pictures_are_whole():
    truth = make_truth()
    good = on_white(truth)
    noisy = [np.where(truth.query_mask(i)[..., None], p, 7).astype(np.uint8) for i, p in enumerate(good)]
    perfect, flooded, none = (picture_values(truth, views) for views in (good, noisy, [None, None]))
    assert perfect == {"psnr": 100.0, "ssim": pytest.approx(1.0), "view_iou": 1.0}
    assert flooded["psnr"] < 5 and flooded["view_iou"] < 0.5 and flooded["ssim"] < 0.7
    assert none == {"psnr": 0.0, "ssim": 0.0, "view_iou": 0.0}
    empty = replace(truth, query_mask=lambda i: np.zeros((32, 40), bool))
    assert picture_values(empty, good) == {"psnr": None, "ssim": None, "view_iou": None}


def test_white_parts_of_the_object_count_in_no_silhouette():
    truth = make_truth()
    white = np.full((32, 40, 3), 255, np.uint8)
    half = white.copy()
    half[:, :20] = 90
    pale = replace(truth, query_rgb=lambda i: half)
    views = [np.where(truth.query_mask(i)[..., None], half, 255).astype(np.uint8) for i in range(2)]
    assert picture_values(pale, views)["view_iou"] == 1.0
    assert picture_values(pale, [white, white])["view_iou"] == 0.0


@pytest.fixture(scope="module")
def honest():
    truth = make_truth()
    answer = make_honest(truth)
    return answer, {track: score(answer, RULES, track) for track in TRACKS}


@pytest.mark.parametrize("cheat", CHEATS)
def test_cheating_does_not_pay(honest, cheat):
    (answer, points), (change, track) = honest, CHEATS[cheat]
    answer = change(answer)
    for name in {track, "whole"}:
        gain = score(answer, RULES, name) - points[name]
        assert gain < (NOTHING if cheat in ("mist", "decoy", "doubled", "slivers") else 0), name
