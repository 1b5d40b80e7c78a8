"""itaco-1 on truths wrong by a known amount."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from perturbed import (
    KINDS,
    in_millimetres,
    make_truth,
    moving_part_off_by,
    opengl,
    other_type,
    quaternions_confused,
    reversed_axis,
    shifted,
    tilted,
    values_of,
    with_parts,
    with_poses,
    with_states,
)
from synthetic_case import in_frame, make_recording, random_pose, truth_as_answer, with_names_exchanged

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.mesh import Mesh
from leaderboard.protocols.itaco1 import ITACO_1, Itaco1
from leaderboard.sequence_score import SequenceScorer

scored = functools.partial(values_of, ITACO_1, constants=Itaco1(samples=3000))
SURFACES = ("cd_w", "cd_m", "cd_s")


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_is_as_good_as_sampling_allows(kind):
    truth = make_truth(kind)
    values = scored(truth, truth_as_answer(truth), [None, None])
    assert set(values) == {m.id for m in ITACO_1.metrics if kind == "revolute" or m.id != "position"}
    for id in ("axis", "position", "state", "camera_rotation", "camera_position"):
        assert values.get(id, 0.0) == pytest.approx(0, abs=1e-6), id
    assert values["joint_type"] == values["miou"] == 1
    assert all(0 < values[id] < 0.02 for id in SURFACES)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degrees", [0.01, 3.0, 90.0, 150.0])
def test_tilting_the_axis_costs_that_whatever_its_sign(kind, degrees):
    assert scored(make_truth(kind), tilted(make_truth(kind), degrees))["axis"] == pytest.approx(
        min(degrees, 180 - degrees), abs=1e-6
    )


def test_parallel_and_opposite_axes_have_a_distance_where_theirs_has_none():
    truth = make_truth()
    assert scored(truth, shifted(truth, across=0.05))["position"] == pytest.approx(5.0)
    assert scored(truth, shifted(truth, along=0.7))["position"] == pytest.approx(0, abs=1e-9)
    opposite = reversed_axis(truth)
    assert scored(truth, opposite)["position"] == pytest.approx(0, abs=1e-9)
    assert scored(truth, opposite)["axis"] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_the_sign_of_a_state_is_not_seen_and_an_offset_is_paid_for(kind):
    truth = make_truth(kind)
    unit = np.rad2deg(1) if kind == "revolute" else 100
    assert scored(truth, with_states(truth, -truth.states))["state"] == pytest.approx(0, abs=1e-9)
    mixed = truth.states * np.where(np.arange(len(truth)) % 2, 1, -1)
    assert scored(truth, with_states(truth, mixed))["state"] == pytest.approx(0, abs=1e-9)
    assert scored(truth, with_states(truth, truth.states + 0.3))["state"] == pytest.approx(0.3 * unit)
    around = replace(truth, states=truth.states - 0.1, Ts_camera_moving=truth.Ts_camera_moving)
    across = np.mean(np.abs(np.abs(around.states) - np.abs(truth.states)))  # less than 0.1: they cross 0
    assert scored(around, with_states(truth, truth.states))["state"] == pytest.approx(unit * across)


def test_cameras_are_aligned_in_the_first_frame_alone():
    truth = make_truth()
    n = len(truth)
    shake = np.where(np.arange(n) > 0, 0.01, 0.0)[:, None] * np.array([0, 0, 1.0])
    off = scored(truth, with_poses(truth, lambda Ts: Ts @ se3.pose(np.eye(3), shake)))
    assert off["camera_position"] == pytest.approx(100 * 0.01 * (n - 1) / n)
    turn = np.where(np.arange(n) > 0, np.deg2rad(2.0), 0.0)[:, None] * np.array([0, 0, 1.0])
    turned = scored(truth, with_poses(truth, lambda Ts: Ts @ se3.pose(se3.exp_so3(turn), np.zeros((n, 3)))))
    assert turned["camera_rotation"] == pytest.approx(2.0 * (n - 1) / n)
    moved = scored(truth, in_frame(truth_as_answer(truth), random_pose(np.random.default_rng(1), 3.0)))
    assert moved["camera_position"] < 1e-6 and moved["axis"] < 1e-6 and moved["cd_m"] < 0.02


def test_a_part_out_of_place_costs_twice_its_square():
    """A flat part: every point of it is x away when it is lifted by x off its plane."""
    truth, x = make_truth(), 0.05
    sheet = Mesh(np.array([[0, 0, 0], [0.4, 0, 0], [0, 0.3, 0], [0.4, 0.3, 0]]), np.array([[0, 1, 2], [1, 3, 2]]))
    flags = (truth.outer[0], np.ones(2, bool))
    truth = replace(truth, articulation=replace(truth.articulation, moving=sheet), outer=flags, visible=flags)
    values = scored(truth, moving_part_off_by(truth, x))
    assert values["cd_m"] == pytest.approx(100 * 2 * x**2, rel=0.02)
    assert values["cd_s"] < 0.02


@pytest.mark.parametrize("kind", KINDS)
def test_parts_go_by_the_names_that_they_are_given(kind):
    truth = make_truth(kind)
    values = scored(truth, with_names_exchanged(truth_as_answer(truth)))
    assert values["miou"] == 0 and values["cd_m"] > 0.5 and values["cd_s"] > 0.2


@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_type_is_a_flag_and_nothing_else_is_priced(kind):
    truth = make_truth(kind)
    values = scored(truth, other_type(truth))
    assert values["joint_type"] == 0 and values["axis"] == pytest.approx(0, abs=1e-6)
    assert values["state"] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_millimetres_are_seen(kind):
    truth = make_truth(kind)
    values = scored(truth, in_millimetres(truth))
    assert all(values[id] > 1000 for id in SURFACES) and values["camera_position"] > 1000
    assert kind == "revolute" or values["state"] > 1000


@pytest.mark.parametrize("change", [quaternions_confused, opengl])
def test_poses_of_another_convention_are_seen(change):
    values = scored(make_truth(), with_poses(make_truth(), change))
    assert values["camera_rotation"] > 10 and values["cd_w"] > 0.1


def test_the_moving_map_counts_the_frames_that_have_any():
    truth = make_truth()
    answer = truth_as_answer(truth)
    none = answer.part_masks.copy()
    none[:4][none[:4] == 2] = 1
    n = len(truth)
    assert scored(truth, replace(answer, part_masks=none))["miou"] == pytest.approx((n - 4) / n)
    hidden = replace(truth, part_mask=lambda i: none[i])
    assert scored(hidden, replace(answer, part_masks=none))["miou"] == 1  # the four empty frames are left out
    assert scored(hidden, answer)["miou"] == pytest.approx((n - 4) / n)
    nothing = np.zeros_like(none)
    assert scored(replace(truth, part_mask=lambda i: nothing[i]), replace(answer, part_masks=nothing))["miou"] == 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_failure_costs_what_theirs_does(kind):
    truth = make_truth(kind)
    case = SequenceScorer(ITACO_1, make_recording(truth), truth)
    assert case.penalised_row("failed", "declared").values == {
        "joint_type": 0,
        "axis": 90,
        "position": 100 if kind == "revolute" else None,
        "state": 90 if kind == "revolute" else 100,
        **dict.fromkeys(SURFACES, 100),
        "miou": 0,
        "camera_rotation": 90,
        "camera_position": 100,
    }
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    row = case.measure_row(with_parts(truth_as_answer(truth), moving=empty), Path("none"), "files")
    assert row.values["cd_m"] == 100 and row.notes == ()  # held-out views are not asked for
    parts = truth.articulation
    neither = replace(truth_as_answer(truth), articulation=Articulation(parts.joint, empty, empty))
    assert case.measure_row(neither, Path("none"), "files").values["cd_w"] == 100
