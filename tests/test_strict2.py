"""The laws of strict-2 on a made-up truth, strict-1's numbers for ever, and the text that says what each means."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from perturbed import in_millimetres, lid_centre, opengl, quaternions_confused, with_poses
from synthetic_case import (
    in_frame,
    make_recording,
    make_truth,
    noisy_answer,
    pictures,
    random_answer,
    random_pose,
    static_answer,
    truth_as_answer,
    with_names_exchanged,
)

from freeart21 import se3
from freeart21.mesh import Mesh
from leaderboard.protocol import Case, Shape
from leaderboard.protocols import DEFAULT, PROTOCOLS, strict1, strict2
from leaderboard.protocols.strict1 import STRICT_1, Strict1
from leaderboard.protocols.strict2 import STRICT_2
from leaderboard.sequence_score import SequenceScorer

KINDS = ("revolute", "prismatic")
QUICK = Strict1(samples=3000)


def scored(truth, answer, asset=None, other=None):
    return strict2.measure(Case(truth, answer, pictures(truth), asset, other), QUICK).values


def shape_of(answer, motions=None) -> Shape:
    """The shape that an asset would have that says what the answer's files say."""
    parts = answer.articulation
    motions_of_joint = np.stack([parts.joint.transform(q) for q in answer.states])
    return Shape((parts.reference, parts.moving), motions_of_joint if motions is None else motions)


# ---- strict-1, frozen

FROZEN = {
    "revolute": {
        "joint_type": 1.0,
        "axis": 3.05111649819525,
        "state": 1.4781553235427087,
        "state_all": 1.4781553235427087,
        "position": 7.061974683073147,
        "position_line": 6.8840144394374,
        "miou": 0.8410474095093439,
        "pose_rotation": 4.305101305792171,
        "pose_translation": 5.980869952419603,
        "chamfer_s": 3.3813836321320494,
        "chamfer_m": 5.447089239114261,
        "chamfer_w": 3.3885543415176955,
        "fscore": 0.2588429756970999,
        "psnr": 6.974276737861769,
        "ssim": 0.4086755856700564,
    },
    "prismatic": {
        "joint_type": 1.0,
        "axis": 3.05111649819525,
        "state": 4.968639589921619,
        "state_all": 4.968639589921619,
        "miou": 0.8410474095093439,
        "pose_rotation": 4.305101305792171,
        "pose_translation": 5.980869952419603,
        "chamfer_s": 3.3813836321320494,
        "chamfer_m": 3.0197995602818715,
        "chamfer_w": 2.9864316544523835,
        "fscore": 0.31342185100239434,
        "psnr": 6.974276737861769,
        "ssim": 0.4086755856700564,
    },
}


@pytest.mark.parametrize("kind", KINDS)
def test_strict_1_gives_the_numbers_that_it_gave_before_there_was_strict_2(kind):
    truth = make_truth(kind)
    answer = noisy_answer(truth, 3)
    if kind == "prismatic":
        answer = with_names_exchanged(answer)
    values = strict1.measure(Case(truth, answer, [pictures(truth)[0] // 2 + 30, None]), QUICK).values
    assert values == pytest.approx(FROZEN[kind], rel=1e-9)


def test_strict_1_caps_nothing():
    truth = make_truth()
    worse = replace(truth_as_answer(truth), articulation=far_off(truth))
    row = SequenceScorer(STRICT_1, make_recording(truth), truth).measure_row(worse, Path("none"), "files")
    assert row.values["chamfer_s"] > 1000


# ---- a penalty is a cap


def far_off(truth):
    parts = truth.articulation
    return replace(parts, reference=parts.reference.moved(se3.pose(np.eye(3), [50.0, 0, 0])))


@pytest.mark.parametrize("kind", KINDS)
def test_no_answer_costs_more_than_a_declared_failure(kind, monkeypatch):
    truth = make_truth(kind)
    rules = replace(STRICT_2, measure=functools.partial(strict2.measure, constants=QUICK))
    case = SequenceScorer(rules, make_recording(truth), truth)
    failed = case.penalised_row("failed", "declared")
    answers = [replace(truth_as_answer(truth), articulation=far_off(truth)), static_answer(truth)]
    for answer in answers + [random_answer(truth, seed) for seed in range(3)]:
        row = case.measure_row(answer, Path("none"), "files")
        for metric in rules.metrics:
            value, penalty = row.values[metric.id], failed.values[metric.id]
            if penalty is not None:
                assert value <= penalty if metric.direction == "down" else value >= penalty, metric.id
    assert case.measure_row(answers[0], Path("none"), "files").values["chamfer_s"] == 100


# ---- laws


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_is_perfect_from_files_and_from_an_asset(kind):
    truth = make_truth(kind)
    answer = truth_as_answer(truth)
    for values in (scored(truth, answer), scored(truth, answer, shape_of(answer))):
        assert set(values) == {m.id for m in STRICT_2.metrics if kind == "revolute" or "position" not in m.id}
        for metric in STRICT_2.metrics:
            if metric.id not in values:
                continue
            best = 0 if metric.direction == "down" else 100 if metric.id == "psnr" else 1
            assert values[metric.id] == pytest.approx(best, abs=1e-6), metric.id


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_that_strict_1_has_stay_as_they_were_where_the_definition_did(kind):
    truth = make_truth(kind)
    answer = noisy_answer(truth, 3)
    before = strict1.measure(Case(truth, answer, pictures(truth)), QUICK).values
    after = scored(truth, answer)
    assert {id: after[id] for id in before} == before
    for id in ("chamfer_w", "chamfer_m", "chamfer_s", "fscore"):
        assert after[f"{id}_parts"] == after[id]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_the_moving_parts_pose_does_not_mind_what_is_the_methods_own_affair(kind, seed):
    truth = make_truth(kind)
    answer = noisy_answer(truth, seed)
    joint = answer.articulation.joint
    values = scored(truth, answer)
    assert values["pose_moving_rotation"] > 1 and values["pose_moving_translation"] > 1
    moved_zero = replace(answer, Ts_camera_moving=answer.Ts_camera_moving @ joint.transform(0.7))
    other_type = replace(answer.articulation, joint=replace(joint, type=KINDS[kind == "revolute"]))
    for same in (
        moved_zero,
        in_frame(answer, random_pose(np.random.default_rng(seed), 3.0)),
        with_names_exchanged(answer),
        replace(answer, articulation=other_type),
    ):
        found = scored(truth, same)
        for id in ("pose_moving_rotation", "pose_moving_translation"):
            assert found[id] == pytest.approx(values[id], abs=1e-6), id


def test_the_moving_parts_pose_costs_what_it_is_off_by():
    truth = make_truth()
    n = len(truth)
    x = 0.01
    shake = np.where(np.arange(n) % 2, x, -x)[:, None] * np.array([0.0, 0, 1])  # mean 0: no alignment takes it
    shaken = se3.pose(np.eye(3), shake) @ truth.Ts_camera_moving
    values = scored(truth, replace(truth_as_answer(truth), Ts_camera_moving=shaken))
    assert values["pose_moving_translation"] == pytest.approx(100 * x / truth.diagonal, rel=0.02)
    assert values["pose_moving_rotation"] < 1e-6 and values["pose_translation"] < 1e-6
    turns = np.deg2rad(np.where(np.arange(n) % 2, 3.0, -3.0))[:, None] * np.array([0.0, 0, 1])
    centre = lid_centre(truth)
    R = se3.exp_so3(turns)
    turned = truth.Ts_camera_moving @ se3.pose(R, centre - R @ centre)
    values = scored(truth, replace(truth_as_answer(truth), Ts_camera_moving=turned))
    assert values["pose_moving_rotation"] == pytest.approx(3.0, rel=1e-3)
    assert values["pose_moving_translation"] < 1e-6


# ---- faults that a method makes when it writes


@pytest.mark.parametrize("kind", KINDS)
def test_millimetres_are_seen(kind):
    truth = make_truth(kind)
    values = scored(truth, in_millimetres(truth))
    assert values["pose_translation"] > 1000 and values["chamfer_w"] > 1000 and values["fscore"] == 0
    assert values["position" if kind == "revolute" else "state"] > 100
    assert values["axis"] < 1e-6  # a direction has no length


@pytest.mark.parametrize("change", [quaternions_confused, opengl])
def test_poses_of_another_convention_are_seen(change):
    truth = make_truth()
    values = scored(truth, with_poses(truth, change))
    assert values["pose_rotation"] > 10 and values["chamfer_w"] > 5


# ---- surfaces of the asset


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("swap", [False, True])
def test_surfaces_are_the_assets_and_those_of_the_files_stand_beside(kind, swap):
    truth = make_truth(kind)
    answer = noisy_answer(truth, 3)
    if swap:
        answer = with_names_exchanged(answer)
    answer = in_frame(answer, random_pose(np.random.default_rng(0)))
    cube = Mesh(
        0.05 * (np.array(list(np.ndindex(2, 2, 2))) - 0.5), np.array([[0, 1, 2], [1, 2, 3], [4, 5, 6], [5, 6, 7]])
    )
    shape = shape_of(answer)
    files = scored(truth, answer)
    same = scored(truth, answer, shape)
    cubes = scored(truth, answer, Shape((cube, cube), shape.motions))
    for part in "wms":
        assert same[f"chamfer_{part}"] == pytest.approx(files[f"chamfer_{part}"], abs=1e-6)
        assert cubes[f"chamfer_{part}_parts"] == files[f"chamfer_{part}"]
        assert cubes[f"chamfer_{part}"] > files[f"chamfer_{part}"] + 10
    still = Shape(shape.parts, np.repeat(shape.motions[:1], len(truth), 0))
    assert scored(truth, answer, still)["chamfer_m"] > same["chamfer_m"] + 1


@pytest.mark.parametrize("x", [1e-4, 0.003])
def test_an_asset_whose_mesh_is_shifted_by_x_costs_x(x):
    """A flat part: every point of it is x away when it is lifted by x off its plane."""
    truth = make_truth()
    sheet = Mesh(np.array([[0, 0, 0], [0.4, 0, 0], [0, 0.3, 0], [0.4, 0.3, 0]]), np.array([[0, 1, 2], [1, 3, 2]]))
    parts = replace(truth.articulation, moving=sheet)
    flags = (truth.outer[0], np.ones(2, bool))
    truth = replace(truth, articulation=parts, outer=flags, visible=flags)
    answer = truth_as_answer(truth)
    lifted = Shape((parts.reference, sheet.moved(se3.pose(np.eye(3), [0, 0, x]))), shape_of(answer).motions)
    values = scored(truth, answer, lifted)
    assert values["chamfer_m"] == pytest.approx(100 * x / truth.diagonal, rel=1e-6)
    assert values["chamfer_m_parts"] < 1e-6 and values["chamfer_s"] < 1e-6


# ---- held-out views under both choices


def test_pictures_are_those_of_the_choice_that_the_matching_made():
    truth = make_truth()
    good, bad = pictures(truth), [np.zeros_like(p) for p in pictures(truth)]
    plain, turned = truth_as_answer(truth), with_names_exchanged(truth_as_answer(truth))
    for answer, renders, other, expected, taken in (
        (plain, good, bad, 100, False),
        (turned, bad, good, 100, True),
        (turned, good, None, 100, False),
        (turned, good, bad, None, True),
    ):
        found = strict2.measure(Case(truth, answer, renders, None, other), QUICK)
        assert found.other_views == taken
        assert found.values["psnr"] == 100 if expected else found.values["psnr"] < 20


# ---- the text


def test_the_protocol_text_names_every_number_of_every_protocol():
    text = (Path(__file__).resolve().parents[1] / "docs" / "protocols.md").read_text()
    for name, protocol in PROTOCOLS.items():
        assert f"# {name}" in text
        for metric in protocol.metrics:
            assert f"`{metric.id}`" in text, metric.id
    assert f"`{DEFAULT}` is the default" in text
