"""Methods that do not make all there is: what is left is scored as ever, the rest has no number, and nobody gains."""

import functools
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from perturbed import KINDS, tilted, with_parts
from rich.console import Console
from score_files import score_results, submit, truths
from synthetic_case import (
    in_frame,
    make_recording,
    make_truth,
    noisy_answer,
    random_pose,
    truth_as_answer,
    with_names_exchanged,
)

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.files.result import Method, write_method, write_result
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import PIECES, Failure
from leaderboard import protocols
from leaderboard.protocols.paper1 import Paper1
from leaderboard.protocols.strict import Strict
from leaderboard.sequence_score import SequenceScorer
from leaderboard.tables import NOTHING, format_cell, print_scores

FEW = {
    **{f"strict-{version}": Strict(version, samples=1500) for version in (1, 2, 3)},
    **dict.fromkeys(("paper-1", "itaco-1"), Paper1(samples=1500)),
}
"""Constants of protocols that take long with their own."""
PROTOCOLS = {
    name: replace(rules, measure=functools.partial(rules.measure, constants=FEW[name])) if name in FEW else rules
    for name, rules in protocols.PROTOCOLS.items()
}
by_protocol = pytest.mark.parametrize("rules", PROTOCOLS.values(), ids=PROTOCOLS)
SOME = [
    ("joint",),
    ("joint", "states", "poses"),
    ("states",),
    ("poses",),
    ("masks",),
    ("meshes",),
    ("renders",),
    ("states", "poses", "masks", "renders"),
    PIECES,
]
MATCHABLE = [lacks for lacks in SOME if not {"poses", "masks", "meshes"} <= {*lacks}]
ANCHOR = 5


def without(answer, lacks, anchor=ANCHOR):
    """`answer` with fillers for what it lacks, as the formats ask for: whole shapes that say nothing."""
    parts, states = answer.articulation, answer.states
    if "states" in lacks:  # the parts stand as they do in the anchor frame, and that is state zero
        zero = states[anchor]
        T = parts.joint.transform(zero)
        joint = replace(parts.joint, lower=parts.joint.lower - zero, upper=parts.joint.upper - zero)
        answer = replace(
            answer,
            articulation=Articulation(joint, parts.reference, parts.moving.moved(T)),
            Ts_camera_moving=answer.Ts_camera_moving @ se3.inverse(T),
            states=0 * states,
        )
    if "joint" in lacks:
        parts = answer.articulation
        nothing = Joint("unknown", "revolute", np.array([0.0, 0.0, 1.0]), np.zeros(3), -np.inf, np.inf)
        answer = replace(answer, articulation=Articulation(nothing, parts.reference, parts.moving))
    if "poses" in lacks:
        constant = np.repeat(answer.Ts_camera_reference[anchor : anchor + 1], len(answer), 0)
        answer = replace(answer, Ts_camera_reference=constant, Ts_camera_moving=constant)
    if "masks" in lacks:
        answer = replace(answer, part_masks=np.zeros_like(answer.part_masks))
    if "meshes" in lacks:
        tiny = Mesh(1e-4 * np.eye(4, 3), np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))
        answer = with_parts(answer, tiny, tiny)
    return replace(answer, anchor=anchor)


def row_of(rules, truth, answer, lacks, folder=Path("none")):
    return SequenceScorer(rules, make_recording(truth), truth, lacks).measure_row(answer, folder, "files")


def assert_perfect(rules, row, lacks):
    for metric in rules.metrics:
        value = row.values[metric.id]
        if metric.unit(row.joint_type) is None or {*lacks} & {*metric.needs}:
            assert value is None, metric.id
        elif metric.id == "area":
            assert value < 0.02  # other samples, another frame
        elif "cd_" in metric.id:
            assert 0 < value < 0.06, metric.id  # the floor of sampling
        elif metric.id in ("psnr", "ssim", "view_iou"):
            assert value == 0, metric.id  # no pictures lie in a folder that does not exist
        else:
            assert value == pytest.approx(0 if metric.direction == "down" else 1, abs=1e-6), metric.id


@by_protocol
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("lacks", SOME, ids="-".join)
def test_the_truth_is_perfect_in_all_that_is_left(rules, kind, lacks):
    truth = make_truth(kind)
    assert_perfect(rules, row_of(rules, truth, without(truth_as_answer(truth), lacks), lacks), lacks)


@pytest.mark.parametrize("rules", [PROTOCOLS["strict-2"], PROTOCOLS["arena-1"]], ids=lambda r: r.name)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("lacks", MATCHABLE, ids="-".join)
def test_parts_that_go_by_each_others_names_are_found_out_by_what_is_there(rules, kind, lacks):
    truth = make_truth(kind)
    answer = in_frame(with_names_exchanged(truth_as_answer(truth)), random_pose(np.random.default_rng(4), 2.0))
    row = row_of(rules, truth, without(answer, lacks), lacks)
    assert row.swapped
    assert_perfect(rules, row, lacks)


@by_protocol
@pytest.mark.parametrize("lacks", SOME, ids="-".join)
def test_fillers_do_not_count(rules, lacks):
    """What stands in place of a lacking piece changes no number: neither the best there is nor the worst."""
    truth = make_truth()
    rng, noisy = np.random.default_rng(0), noisy_answer(truth)
    plain = without(noisy, lacks)
    other = plain
    if "poses" in lacks:
        wild = np.stack([random_pose(rng) for _ in range(len(truth))])
        wild[ANCHOR] = plain.Ts_camera_reference[ANCHOR]
        other = replace(other, Ts_camera_reference=wild, Ts_camera_moving=wild)
    if "masks" in lacks:
        other = replace(other, part_masks=truth_as_answer(truth).part_masks)
    values = row_of(rules, truth, plain, lacks).values
    assert row_of(rules, truth, other, lacks).values == pytest.approx(values, abs=1e-9)


@by_protocol
@pytest.mark.parametrize("lacks", SOME, ids="-".join)
def test_a_failure_has_no_price_for_what_the_method_does_not_make(rules, lacks):
    truth = make_truth()
    case = SequenceScorer(rules, make_recording(truth), truth, lacks)
    full = SequenceScorer(rules, make_recording(truth), truth).penalties()
    for metric in rules.metrics:
        expected = None if {*lacks} & {*metric.needs} else full[metric.id]
        assert case.penalised_row("failed", "declared").values[metric.id] == expected, metric.id


def test_the_axis_and_its_place_are_measured_in_the_anchor_frame():
    truth, lacks = make_truth(), ("poses", "masks", "states", "renders")
    rules = PROTOCOLS["strict-2"]
    values = row_of(rules, truth, without(tilted(truth, 3.0), lacks), lacks).values
    assert values["axis"] == pytest.approx(3.0) and values["position"] == pytest.approx(0, abs=1e-6)
    answer = without(truth_as_answer(truth), lacks)
    turned = answer.Ts_camera_reference @ se3.pose(se3.exp_so3([np.deg2rad(4.0), 0, 0]), np.zeros(3))
    values = row_of(rules, truth, replace(answer, Ts_camera_reference=turned), lacks).values
    assert values["axis"] == pytest.approx(4.0) and values["chamfer_s"] > 0.1
    wrong_frame = replace(answer, anchor=ANCHOR + 3)
    assert row_of(rules, truth, wrong_frame, lacks).values["axis"] > 5


# ---- from files


def test_a_method_says_it_once_for_all_sequences(data, tmp_path, few_samples):
    lacks = ("masks", "renders")
    write_method(tmp_path, Method("blind", lacks=lacks))
    for name in "ab":
        submit(tmp_path / name, truths()[name], without(truth_as_answer(truths()[name]), lacks), renders=False)
    scores = score_results(tmp_path, data)
    assert [row.status for row in scores.rows] == ["ok", "ok", "missing"]
    for row in scores.rows:
        assert all(row.values[id] is None for id in ("miou", "psnr", "ssim")), row
    assert scores.rows[2].values["axis"] == 90
    assert "miou" not in scores.summaries[0].statistics and "axis" in scores.summaries[0].statistics
    assert scores.notes == ("the method makes no masks, renders: no miou, psnr, ssim, view_iou",)
    assert not any("held-out" in note for row in scores.rows for note in row.notes)
    assert np.isnan(scores.frame()["miou"]).all()


@by_protocol
def test_tables_show_a_dash_and_say_why(data, tmp_path, rules):
    write_method(tmp_path, Method("blind", lacks=("masks", "meshes")))
    write_result(tmp_path / "a", Failure("tracks", "declared"))
    scores = score_results(tmp_path, data, rules.name)
    console = Console(record=True, width=160, file=io.StringIO())
    print_scores(scores, console, everything=True)
    output = console.export_text()
    assert "the method makes no masks, meshes: no" in output
    row = next(row for row in scores.rows if row.sequence == "a")
    for metric in rules.metrics:
        shown = format_cell(row, metric, False)
        assert (shown == NOTHING) == bool({"masks", "meshes"} & {*metric.needs}), metric.id
