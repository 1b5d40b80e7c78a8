"""The laws of strict-1, strict-2 and strict-3 on a made-up truth: what each fault costs, and what costs nothing."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from perturbed import (
    KINDS,
    in_millimetres,
    lid_centre,
    moving_part_off_by,
    opengl,
    other_type,
    quaternions_confused,
    shifted,
    tilted,
    with_parts,
    with_poses,
    with_states,
)
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
    with_joint,
    with_names_exchanged,
)

from benchmarks.gaming import CHEATS, NOTHING, make_honest, score
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.mesh import Mesh, join_meshes
from leaderboard.points import TRACKS
from leaderboard.protocol import Case, Shape
from leaderboard.protocols import DEFAULT, PROTOCOLS
from leaderboard.protocols.strict import STRICT_1, Strict, both_seen, picture_values
from leaderboard.sequence_score import SequenceScorer

RULES = {
    f"strict-{k}": replace(rules, measure=functools.partial(rules.measure, constants=Strict(k, samples=3000)))
    for k in (1, 2, 3)
    for rules in [PROTOCOLS[f"strict-{k}"]]
}
by_protocol = pytest.mark.parametrize("protocol", RULES)
by_kind = pytest.mark.parametrize("kind", KINDS)
EMPTY = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))


def measured(protocol, truth, answer, renders=None, asset=None, other=None):
    return RULES[protocol].measure(Case(truth, answer, renders or on_white(truth), asset, other))


def scored(*arguments, **named):
    return measured(*arguments, **named).values


def on_white(truth):
    """The true held-out views, white around the object, as strict-3 has it; the others look inside the mask."""
    views = enumerate(pictures(truth))
    return [np.where(truth.query_mask(i)[..., None], view, 255).astype(np.uint8) for i, view in views]


def shape_of(answer) -> Shape:
    """The shape that an asset would have that says what the answer's files say."""
    parts = answer.articulation
    return Shape((parts.reference, parts.moving), np.stack([parts.joint.transform(q) for q in answer.states]))


def with_moving_poses(truth, Ts):
    return replace(truth_as_answer(truth), Ts_camera_moving=Ts)


# ---- what a perturbation costs


def shaken(truth, metres):
    """The moving part off by `metres` to and fro: no alignment takes it."""
    signs = np.where(np.arange(len(truth)) % 2, 1, -1)[:, None]
    return with_moving_poses(truth, se3.pose(np.eye(3), metres * signs * [0.0, 0, 1]) @ truth.Ts_camera_moving)


def turned(truth, degrees):
    """The moving part turned about its centre by `degrees` to and fro."""
    signs, centre = np.where(np.arange(len(truth)) % 2, 1, -1)[:, None], lid_centre(truth)
    R = se3.exp_so3(np.deg2rad(degrees) * signs * [0.0, 0, 1])
    return with_moving_poses(truth, truth.Ts_camera_moving @ se3.pose(R, centre - R @ centre))


def slid_along_z(truth):
    """Poses 5 cm along the object's own -z: alignment hides it from joint and pose, not from chamfer."""
    T = np.stack([se3.pose(np.eye(3), -0.05 * T[:3, 2]) for T in truth.Ts_camera_reference])
    return with_poses(truth, lambda Ts: T @ Ts)


def pivot_far_along_a_tilted_axis(truth):
    joint = truth.articulation.joint
    axis, pivot = se3.exp_so3([0.1, 0, 0]) @ joint.axis, joint.pivot + 5 * joint.axis
    return with_joint(truth_as_answer(truth), replace(joint, axis=axis, pivot=pivot))


def of_length(metres):
    """A length in % of the diagonal, for any truth."""
    return lambda truth: 100 * metres / truth.diagonal


def of_reversed_states(truth):
    difference = 2 * truth.states
    unit = np.rad2deg(1) if truth.articulation.joint.type == "revolute" else 100 / truth.diagonal
    return unit * np.abs(difference - np.median(difference)).mean()


ABSENT = object()
REVOLUTE, BOTH = KINDS[:1], KINDS
PERTURBED = {  # name: joint types, the answer, and metric to its value, or to its bounds, in every protocol that has it
    **{
        f"axis {d} deg": (BOTH, functools.partial(tilted, degrees=d), {"axis": min(d, 180 - d), "miou": 1})
        for d in (1e-4, 1.0, 60.0, 90.0, 120.0)
    },
    "axis 5 deg, position": (REVOLUTE, functools.partial(tilted, degrees=5.0), {"axis": 5, "position": 0, "state": 0}),
    **{
        f"pivot {x} m": (
            REVOLUTE,
            functools.partial(shifted, across=x),
            {"position": of_length(x), "position_line": of_length(x), "axis": 0, "state": 0},
        )
        for x in (1e-5, 0.01, 0.5)
    },
    "crossing lines": (REVOLUTE, pivot_far_along_a_tilted_axis, {"position_line": 0, "position": (40, 1000)}),
    "reversed": (
        BOTH,
        lambda truth: with_states(truth, -truth.states),
        {"state_all": of_reversed_states, "axis": 0, "chamfer_m": (1, 100)},
    ),
    "other type": (
        BOTH,
        other_type,
        {**dict.fromkeys(("axis", "position", "state", "state_all"), ABSENT), "joint_type": 0, "miou": 1},
    ),
    "millimetres": (BOTH, in_millimetres, {"pose_translation": (1000, 1e9), "chamfer_w": (100, 1e9), "axis": 0}),
    "quaternions": (
        BOTH,
        lambda truth: with_poses(truth, quaternions_confused),
        {"pose_rotation": (10, 180), "chamfer_w": (5, 1e9)},
    ),
    "OpenGL": (BOTH, lambda truth: with_poses(truth, opengl), {"pose_rotation": (10, 180), "chamfer_w": (5, 1e9)}),
    "slid": (BOTH, slid_along_z, {"pose_translation": 0, "axis": 0}),
    "shaken": (
        REVOLUTE,
        functools.partial(shaken, metres=0.01),
        {"pose_moving_translation": lambda t: (0.98 * of_length(0.01)(t), 1.02 * of_length(0.01)(t))}
        | dict.fromkeys(("pose_moving_rotation", "pose_translation"), 0),
    ),
    "turned": (
        REVOLUTE,
        functools.partial(turned, degrees=3.0),
        {"pose_moving_rotation": (2.997, 3.003), "pose_moving_translation": 0},
    ),
    "without a moving part": (
        BOTH,
        lambda truth: with_parts(truth_as_answer(truth), moving=EMPTY),
        {"chamfer_m": ABSENT, "chamfer_w": (0.1, 100)},
    ),
    "static": (BOTH, static_answer, {"pose_rotation": (1, 180), "chamfer_w": (1, 1e9)}),
    "lifted": (REVOLUTE, functools.partial(moving_part_off_by, metres=0.004), {"depth_95": (0.4, 100), "miou": 1}),
}


@pytest.mark.parametrize("name", PERTURBED)
@by_protocol
def test_a_perturbation_costs_what_it_is_off_by(protocol, name):
    kinds, perturb, expected = PERTURBED[name]
    known = {metric.id for metric in RULES[protocol].metrics}
    for kind in kinds:
        truth = make_truth(kind)
        values = scored(protocol, truth, perturb(truth))
        for id, wanted in expected.items():
            wanted = wanted(truth) if callable(wanted) else wanted
            if id not in known:
                continue
            if wanted is ABSENT:
                assert id not in values, (kind, id)
            elif isinstance(wanted, tuple):
                assert wanted[0] < values[id] <= wanted[1], (kind, id)
            else:
                assert values[id] == pytest.approx(wanted, abs=1e-6), (kind, id)


@by_protocol
@by_kind
def test_the_truth_is_perfect_from_files_and_from_an_asset(protocol, kind):
    truth = make_truth(kind)
    answer, rules = truth_as_answer(truth), RULES[protocol]
    for asset in (None, shape_of(answer)):
        values = scored(protocol, truth, answer, asset=asset)
        assert set(values) == {m.id for m in rules.metrics if kind == "revolute" or "position" not in m.id}
        for metric in rules.metrics:
            best = 100 if metric.id == "psnr" else 1 if metric.direction == "up" else 0
            assert values.get(metric.id, best) == pytest.approx(best, abs=1e-6), metric.id


# ---- what costs nothing


def _same_joint(answer):
    joint, parts, q = answer.articulation.joint, answer.articulation, 0.7
    yield with_joint(answer, joint.reversed(), -answer.states)
    yield with_joint(answer, replace(joint, pivot=joint.pivot + 0.7 * joint.axis))
    moved = Articulation(joint, parts.reference, parts.moving.moved(joint.transform(-q)))
    Ts = answer.Ts_camera_moving @ joint.transform(q)  # another state zero
    yield replace(answer, states=answer.states + q, articulation=moved, Ts_camera_moving=Ts)


@by_protocol
@by_kind
def test_what_is_the_methods_own_affair_changes_nothing(protocol, kind):
    truth, rng = make_truth(kind), np.random.default_rng(100)
    answer = noisy_answer(truth, 1)
    values = scored(protocol, truth, answer)
    assert values["axis"] > 0.1 and values["pose_rotation"] > 1 and values["chamfer_m"] > 0.1
    others = (*_same_joint(answer), with_names_exchanged(answer), in_frame(answer, random_pose(rng, 3.0)))
    for same in others:
        found = scored(protocol, truth, same)
        assert found.keys() == values.keys()
        for id, value in values.items():
            loose = 0.15 if id.startswith("chamfer") else 0.01  # other samples, another rounding of pixels
            relative = loose if protocol == "strict-3" else 0
            assert found[id] == pytest.approx(value, rel=relative, abs=0.02 if id == "area" else 1e-5), id


def test_without_masks_the_reference_poses_match_the_parts():
    truth = make_truth()
    answer = replace(noisy_answer(truth, 2), part_masks=np.zeros_like(noisy_answer(truth, 2).part_masks))
    plain, exchanged = measured("strict-1", truth, answer), measured("strict-1", truth, with_names_exchanged(answer))
    assert exchanged.swapped and exchanged.values == pytest.approx(plain.values, abs=1e-6)


# ---- strict-1

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


@by_kind
def test_strict_1_gives_the_numbers_that_it_always_gave(kind):
    truth = make_truth(kind)
    answer = noisy_answer(truth, 3)
    if kind == "prismatic":
        answer = with_names_exchanged(answer)
    values = scored("strict-1", truth, answer, [pictures(truth)[0] // 2 + 30, None])
    assert values == pytest.approx(FROZEN[kind], rel=1e-9)


def test_state_looks_only_where_both_parts_are_seen():
    truth = make_truth()
    seen = truth.seen.copy()
    seen[3] = [1000, 9]
    seen[4] = [1000, 11]
    truth = replace(truth, seen=seen)
    assert not both_seen(truth, 0.01)[3] and both_seen(truth, 0.01)[4]
    assert both_seen(replace(truth, seen=truth.seen * [1, 0]), 0.01).all(), "a part never seen leaves all frames"
    values = scored("strict-1", truth, with_states(truth, truth.states + (np.arange(len(truth)) == 3)))
    assert values["state"] < 1e-6
    assert values["state_all"] == pytest.approx(np.rad2deg(1.0) / len(truth), abs=1e-6)


def test_hidden_surface_is_neither_demanded_nor_forbidden():
    truth = make_truth()
    whole = truth.articulation.reference
    both = join_meshes([whole, Mesh(whole.vertices * 0.5, whole.faces)])
    bottom, inside = whole.vertices[whole.faces].mean(1)[:, 2] < -0.049, np.zeros(len(whole.faces), bool)
    hiding = replace(
        truth,
        articulation=Articulation(truth.articulation.joint, both, truth.articulation.moving),
        outer=(np.concatenate([~inside, inside]), truth.outer[1]),
        visible=(np.concatenate([~bottom, inside]), truth.visible[1]),
    )

    def chamfer(reference):
        return scored("strict-1", hiding, with_parts(truth_as_answer(truth), reference))["chamfer_s"]

    assert chamfer(whole) < 1e-6
    assert chamfer(Mesh(whole.vertices, whole.faces[~bottom])) < 1e-6  # what the video never shows need not be there
    assert chamfer(both) > 0.3  # a surface inside, which nobody can ever see, must not


def test_pictures_are_compared_inside_the_mask_only():
    truth = make_truth()
    spoiled = [np.where(truth.query_mask(i)[..., None], p, 0).astype(np.uint8) for i, p in enumerate(pictures(truth))]
    values = scored("strict-1", truth, truth_as_answer(truth), spoiled)
    assert values["psnr"] == 100 and values["ssim"] == pytest.approx(1)
    assert scored("strict-1", truth, truth_as_answer(truth), [pictures(truth)[0], None])["psnr"] == 50
    unseen = replace(truth, query_mask=lambda i: np.zeros((32, 40), bool))
    assert scored("strict-1", unseen, truth_as_answer(truth))["psnr"] is None


# ---- strict-2: a penalty is a cap; surfaces are the asset's


def far_off(truth):
    far = truth.articulation.reference.moved(se3.pose(np.eye(3), [50.0, 0, 0]))
    return with_parts(truth_as_answer(truth), far)


@by_kind
def test_no_answer_costs_more_than_a_declared_failure(kind):
    truth, rules = make_truth(kind), RULES["strict-2"]
    case = SequenceScorer(rules, make_recording(truth), truth)
    failed = case.penalised_row("failed", "declared")
    for answer in (far_off(truth), static_answer(truth), random_answer(truth, 0), random_answer(truth, 1)):
        row = case.measure_row(answer, Path("none"), "files")
        for metric in rules.metrics:
            value, penalty = row.values[metric.id], failed.values[metric.id]
            if penalty is not None:
                assert value <= penalty if metric.direction == "down" else value >= penalty, metric.id
    first = SequenceScorer(STRICT_1, make_recording(truth), truth).measure_row(far_off(truth), Path("none"), "files")
    assert first.values["chamfer_s"] > 1000, "strict-1 caps nothing"


@by_kind
@pytest.mark.parametrize("swap", [False, True])
def test_surfaces_are_the_assets_and_those_of_the_files_are_supplements(kind, swap):
    truth = make_truth(kind)
    answer = noisy_answer(truth, 3)
    answer = in_frame(with_names_exchanged(answer) if swap else answer, random_pose(np.random.default_rng(0)))
    corners = 0.05 * (np.array(list(np.ndindex(2, 2, 2))) - 0.5)
    cube, shape = Mesh(corners, np.array([[0, 1, 2], [1, 2, 3], [4, 5, 6], [5, 6, 7]])), shape_of(answer)
    still = Shape(shape.parts, np.repeat(shape.motions[:1], len(truth), 0))
    assets = (None, shape, Shape((cube, cube), shape.motions), still)
    files, same, cubes, stopped = (scored("strict-2", truth, answer, asset=asset) for asset in assets)
    for part in "wms":
        assert same[f"chamfer_{part}"] == pytest.approx(files[f"chamfer_{part}"], abs=1e-6)
        assert cubes[f"chamfer_{part}_parts"] == files[f"chamfer_{part}"]
        assert cubes[f"chamfer_{part}"] > files[f"chamfer_{part}"] + 10
    assert stopped["chamfer_m"] > same["chamfer_m"] + 1


@pytest.mark.parametrize("x", [1e-4, 0.003])
def test_an_asset_whose_mesh_is_shifted_by_x_costs_x(x):
    """A flat part: every point of it is x away when it is lifted by x off its plane."""
    truth = make_truth()
    sheet = Mesh(np.array([[0, 0, 0], [0.4, 0, 0], [0, 0.3, 0], [0.4, 0.3, 0]]), np.array([[0, 1, 2], [1, 3, 2]]))
    flags = (truth.outer[0], np.ones(2, bool))
    truth = replace(truth, articulation=replace(truth.articulation, moving=sheet), outer=flags, visible=flags)
    shape = shape_of(truth_as_answer(truth))
    lifted = Shape((shape.parts[0], sheet.moved(se3.pose(np.eye(3), [0, 0, x]))), shape.motions)
    values = scored("strict-2", truth, truth_as_answer(truth), asset=lifted)
    assert values["chamfer_m"] == pytest.approx(100 * x / truth.diagonal, rel=1e-6)
    assert values["chamfer_m_parts"] < 1e-6 and values["chamfer_s"] < 1e-6


def test_pictures_are_those_of_the_choice_that_the_matching_made():
    truth = make_truth()
    good, bad = pictures(truth), [np.zeros_like(p) for p in pictures(truth)]
    plain, exchanged = truth_as_answer(truth), with_names_exchanged(truth_as_answer(truth))
    for answer, renders, other, is_best, taken in (
        (plain, good, bad, True, False),
        (exchanged, bad, good, True, True),
        (exchanged, good, None, True, False),
        (exchanged, good, bad, False, True),
    ):
        found = measured("strict-2", truth, answer, renders, None, other)
        assert found.other_views == taken and (found.values["psnr"] == 100) == is_best


# ---- strict-3: depth from outside, pictures as a whole, and cheating does not pay


def test_surfaces_that_the_video_never_shows_cost_no_depth():
    truth = make_truth()
    hidden = truth.articulation.reference
    flags = hidden.vertices[hidden.faces].mean(1)[:, 2] > -0.049  # all but the bottom
    unseen = replace(truth, visible=(flags, truth.visible[1]))
    inside = (hidden.vertices[:, 2] < -0.049) & (np.abs(hidden.vertices[:, :2]) < [0.19, 0.14]).all(1)
    dented = Mesh(hidden.vertices + np.where(inside[:, None], [[0, 0, 0.06]], 0.0), hidden.faces)
    answer = with_parts(truth_as_answer(truth), dented)
    assert scored("strict-3", truth, answer)["depth_95"] > 1 > scored("strict-3", unseen, answer)["depth_95"]


def test_pictures_are_whole():
    truth = make_truth()
    good = on_white(truth)
    noisy = [np.where(truth.query_mask(i)[..., None], p, 7).astype(np.uint8) for i, p in enumerate(good)]
    perfect, flooded, none = (picture_values(truth, views, Strict(3)) for views in (good, noisy, [None, None]))
    assert perfect == {"psnr": 100.0, "ssim": pytest.approx(1.0), "view_iou": 1.0}
    assert flooded["psnr"] < 5 and flooded["view_iou"] < 0.5 and flooded["ssim"] < 0.7
    assert none == {"psnr": 0.0, "ssim": 0.0, "view_iou": 0.0}
    empty = replace(truth, query_mask=lambda i: np.zeros((32, 40), bool))
    assert picture_values(empty, good, Strict(3)) == {"psnr": None, "ssim": None, "view_iou": None}


def test_white_parts_of_the_object_count_in_no_silhouette():
    truth = make_truth()
    white = np.full((32, 40, 3), 255, np.uint8)
    half = white.copy()
    half[:, :20] = 90
    pale = replace(truth, query_rgb=lambda i: half)
    views = [np.where(truth.query_mask(i)[..., None], half, 255).astype(np.uint8) for i in range(2)]
    assert picture_values(pale, views, Strict(3))["view_iou"] == 1.0
    assert picture_values(pale, [white, white], Strict(3))["view_iou"] == 0.0


@pytest.fixture(scope="module")
def honest():
    truth, rules = make_truth(), RULES["strict-3"]
    answer = make_honest(truth)
    return rules, answer, {track: score(answer, rules, track) for track in TRACKS}


@pytest.mark.parametrize("cheat", CHEATS)
def test_cheating_does_not_pay(honest, cheat):
    (rules, answer, points), (change, track) = honest, CHEATS[cheat]
    answer = change(answer)
    for name in {track, "whole"}:
        gain = score(answer, rules, name) - points[name]
        assert gain < (NOTHING if cheat in ("mist", "decoy", "doubled", "slivers") else 0), name


# ---- the text


def test_the_protocol_text_names_every_number_of_every_protocol():
    text = (Path(__file__).resolve().parents[1] / "docs" / "protocols.md").read_text()
    for name, protocol in PROTOCOLS.items():
        assert f"# {name}" in text
        for metric in protocol.metrics:
            assert f"`{metric.id}`" in text, metric.id
    assert f"`{DEFAULT}` is the default" in text
