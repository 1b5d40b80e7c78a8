"""The laws of strict-1, on a made-up truth."""

from dataclasses import replace

import numpy as np
import pytest
from perturbed import other_type, shifted, tilted, with_parts, with_poses, with_states
from synthetic_case import (
    in_frame,
    make_truth,
    noisy_answer,
    pictures,
    random_answer,
    random_pose,
    truth_as_answer,
    with_joint,
    with_names_exchanged,
)

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.mesh import Mesh, join_meshes
from leaderboard.protocol import Case
from leaderboard.protocols.strict1 import Strict1, both_seen, measure, spread_frames

KINDS = ("revolute", "prismatic")
QUICK = Strict1(samples=3000)
UP = ("joint_type", "miou", "fscore", "psnr", "ssim")
BEST = {"joint_type": 1, "miou": 1, "fscore": 1, "psnr": 100, "ssim": 1}
LENGTHS_AND_ANGLES = (
    "axis",
    "state",
    "state_all",
    "pose_rotation",
    "pose_translation",
    "chamfer_w",
    "chamfer_m",
    "chamfer_s",
)


def scored(truth, answer, renders=None):
    return measure(Case(truth, answer, pictures(truth) if renders is None else renders), QUICK).values


def same(a, b, tolerance=1e-6):
    assert a.keys() == b.keys()
    for id in a:
        assert a[id] == pytest.approx(b[id], abs=tolerance), id


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_scores_perfect(kind):
    values = scored(make_truth(kind), truth_as_answer(make_truth(kind)))
    for id in LENGTHS_AND_ANGLES + (("position", "position_line") if kind == "revolute" else ()):
        assert 0 <= values[id] < 1e-6, id
    for id in UP:
        assert values[id] == pytest.approx(BEST[id], abs=1e-9), id
    assert ("position" in values) == (kind == "revolute")


@pytest.mark.parametrize("kind", KINDS)
def test_everything_between_is_finite_and_worse_than_the_truth(kind):
    rng = np.random.default_rng(1)
    truth = make_truth(kind)
    for seed in range(12):
        answer = noisy_answer(truth, seed) if seed % 2 else random_answer(truth, seed)
        if seed % 3 == 0:
            answer = with_joint(answer, replace(answer.articulation.joint, type=KINDS[seed % 2]))
        if seed % 5 == 0:
            answer = replace(answer, part_masks=np.zeros_like(answer.part_masks))
        answer = in_frame(answer, random_pose(rng, 100.0))
        values = scored(truth, answer, [None, pictures(truth)[0]])
        for id, value in values.items():
            assert np.isfinite(value), (seed, id)
            assert value <= BEST[id] + 1e-12 if id in UP else value >= 0, (seed, id)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_what_is_the_same_answer_gets_the_same_score(kind, seed):
    rng = np.random.default_rng(100 + seed)
    truth = make_truth(kind)
    answer = noisy_answer(truth, seed)
    joint = answer.articulation.joint
    values = scored(truth, answer)
    assert values["axis"] > 0.1 and values["pose_rotation"] > 1 and values["chamfer_m"] > 0.1
    same(values, scored(truth, with_names_exchanged(answer)))
    same(values, scored(truth, with_joint(answer, joint.reversed(), -answer.states)))
    same(values, scored(truth, with_joint(answer, replace(joint, pivot=joint.pivot + 0.7 * joint.axis))))
    same(values, scored(truth, in_frame(answer, random_pose(rng))))
    same(values, scored(truth, in_frame(answer, random_pose(rng, 30.0))), 1e-5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("offset", [0.3, -2.0, np.pi, 3 * np.pi])
def test_another_state_zero_changes_nothing(kind, offset):
    truth = make_truth(kind)
    answer = noisy_answer(truth, 5)
    joint, parts = answer.articulation.joint, answer.articulation
    # The same moving mesh, written at the new state zero, which is state -offset of the old.
    shifted = replace(
        answer,
        states=answer.states + offset,
        articulation=Articulation(joint, parts.reference, parts.moving.moved(joint.transform(-offset))),
        Ts_camera_moving=answer.Ts_camera_moving @ joint.transform(offset),
    )
    same(scored(truth, answer), scored(truth, shifted))
    same(scored(truth, answer), scored(truth, with_names_exchanged(shifted)))


@pytest.mark.parametrize("kind", KINDS)
def test_reversing_the_motion_costs_exactly_that(kind):
    truth = make_truth(kind)
    values = scored(truth, with_states(truth, -truth.states))
    difference = 2 * truth.states
    expected = np.abs(difference - np.median(difference)).mean()
    unit = np.rad2deg(1) if kind == "revolute" else 100 / truth.diagonal
    assert values["state_all"] == pytest.approx(unit * expected, abs=1e-9)
    assert values["axis"] < 1e-6 and values["chamfer_s"] < 1e-6 and values["chamfer_m"] > 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degrees", [1e-4, 1.0, 5.0, 60.0, 90.0, 120.0])
def test_tilting_the_axis_costs_exactly_that(kind, degrees):
    truth = make_truth(kind)
    answer = tilted(truth, degrees)
    values = scored(truth, answer)
    assert values["axis"] == pytest.approx(min(degrees, 180 - degrees), abs=1e-6)
    if kind == "revolute":
        assert values["position"] == pytest.approx(0, abs=1e-6)
    reverse = scored(truth, with_states(truth, -truth.states))["state"] if degrees > 90 else 0
    assert values["state"] == pytest.approx(reverse, abs=1e-6)
    if degrees == 90:  # an axis across the true one has no sign: the better one counts
        joint = answer.articulation.joint
        opposite = with_joint(answer, replace(joint, axis=-joint.axis))
        assert scored(truth, opposite)["state"] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("shift", [1e-5, 0.01, 0.5])
def test_shifting_the_axis_costs_exactly_that(shift):
    truth = make_truth()
    values = scored(truth, shifted(truth, across=shift))
    for id in ("position", "position_line"):
        assert values[id] == pytest.approx(100 * shift / truth.diagonal, abs=1e-6), id
    assert values["axis"] < 1e-6 and values["state"] < 1e-6


def test_a_pivot_error_at_the_part_is_seen_where_crossing_lines_hide_it():
    truth = make_truth()
    joint = truth.articulation.joint
    far = replace(joint, axis=se3.exp_so3([0.1, 0, 0]) @ joint.axis, pivot=joint.pivot + 5 * joint.axis)
    values = scored(truth, with_joint(truth_as_answer(truth), far))
    assert values["position_line"] < 1e-6
    assert values["position"] > 40


@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_joint_type_leaves_the_joint_figures_to_the_protocol_and_the_rest_measured(kind):
    truth = make_truth(kind)
    values = scored(truth, other_type(truth))
    assert values["joint_type"] == 0
    assert not {"axis", "position", "state", "state_all"} & values.keys()
    assert values["miou"] == 1 and values["pose_rotation"] < 1e-6 and values["chamfer_s"] < 1e-6


def test_parts_are_matched_by_masks_even_when_the_other_naming_is_given():
    truth = make_truth()
    found = measure(Case(truth, with_names_exchanged(truth_as_answer(truth)), pictures(truth)), QUICK)
    assert found.swapped
    assert found.values["miou"] == 1 and found.values["chamfer_m"] < 1e-6 and found.values["state"] < 1e-6


def test_without_masks_the_reference_poses_match_the_parts():
    truth = make_truth()
    answer = replace(noisy_answer(truth, 2), part_masks=np.zeros_like(noisy_answer(truth, 2).part_masks))
    same(scored(truth, answer), scored(truth, with_names_exchanged(answer)))


def test_state_looks_only_where_both_parts_are_seen():
    truth = make_truth()
    seen = truth.seen.copy()
    seen[3] = [1000, 9]
    seen[4] = [1000, 11]
    truth = replace(truth, seen=seen)
    assert not both_seen(truth, 0.01)[3] and both_seen(truth, 0.01)[4]
    states = truth.states.copy()
    states[3] += 1.0
    values = scored(truth, replace(truth_as_answer(truth), states=states))
    assert values["state"] < 1e-6
    assert values["state_all"] == pytest.approx(np.rad2deg(1.0) / len(truth), abs=1e-6)


def test_a_part_never_seen_leaves_all_frames_to_the_state():
    truth = make_truth()
    assert both_seen(replace(truth, seen=truth.seen * [1, 0]), 0.01).all()


def test_the_five_poses_span_the_joint_range():
    states = make_truth().states
    frames = spread_frames(states, 5)
    assert states[frames[0]] == states.min() and states[frames[-1]] == states.max()
    assert len(set(frames)) == 5


@pytest.mark.parametrize("kind", KINDS)
def test_chamfer_uses_the_answers_own_poses_in_the_camera_frame(kind):
    """A shift of all poses along the object's own z: alignment hides it from joint and pose, not from chamfer."""
    truth = make_truth(kind)
    T = np.stack([se3.pose(np.eye(3), -0.05 * T[:3, 2]) for T in truth.Ts_camera_reference])  # 5 cm along the body's -z
    values = scored(truth, with_poses(truth, lambda Ts: T @ Ts))
    assert values["pose_translation"] < 1e-6 and values["axis"] < 1e-6
    assert 0.1 < values["chamfer_s"] / (100 * 0.05 / truth.diagonal) < 1


def test_hidden_surface_is_neither_demanded_nor_forbidden():
    truth = make_truth()
    inner = Mesh(truth.articulation.reference.vertices * 0.5, truth.articulation.reference.faces)
    whole = truth.articulation.reference
    both = join_meshes([whole, inner])
    n = len(whole.faces)
    bottom = whole.vertices[whole.faces].mean(1)[:, 2] < -0.049
    outer = np.concatenate([np.ones(n, bool), np.zeros(n, bool)])
    visible = np.concatenate([~bottom, np.zeros(n, bool)])
    hiding = replace(
        truth,
        articulation=Articulation(truth.articulation.joint, both, truth.articulation.moving),
        outer=(outer, truth.outer[1]),
        visible=(visible, truth.visible[1]),
    )
    answer = truth_as_answer(truth)

    def chamfer(reference):
        return scored(hiding, with_parts(answer, reference))["chamfer_s"]

    assert chamfer(whole) < 1e-6
    assert chamfer(Mesh(whole.vertices, whole.faces[~bottom])) < 1e-6  # what the video never shows need not be there
    assert chamfer(both) > 0.3  # a surface inside, which nobody can ever see, must not


def test_an_answer_without_a_part_is_measured_where_it_can_be():
    truth = make_truth()
    answer = truth_as_answer(truth)
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    for nothing in (empty, flat):
        values = scored(truth, with_parts(answer, moving=nothing))
        assert "chamfer_m" not in values
        assert values["chamfer_s"] < 1e-6 and values["chamfer_w"] > 0.1 and 0 < values["fscore"] < 1
    neither = scored(truth, with_parts(answer, empty, empty))
    assert not {"chamfer_w", "chamfer_m", "chamfer_s", "fscore"} & neither.keys()


def test_pictures_are_compared_inside_the_mask_only():
    truth = make_truth()
    spoiled = [np.where(truth.query_mask(i)[..., None], p, 0).astype(np.uint8) for i, p in enumerate(pictures(truth))]
    values = scored(truth, truth_as_answer(truth), spoiled)
    assert values["psnr"] == 100 and values["ssim"] == pytest.approx(1)
    half = scored(truth, truth_as_answer(truth), [pictures(truth)[0], None])
    assert half["psnr"] == 50


def test_a_view_that_shows_nothing_is_left_out():
    truth = replace(make_truth(), query_mask=lambda i: np.zeros((32, 40), bool))
    assert scored(truth, truth_as_answer(truth))["psnr"] is None
