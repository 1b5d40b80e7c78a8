"""Scoring from files: penalties, coverage, untrusted submissions, and the joint read from the reloaded asset."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from refusal import assert_refused
from rich.console import Console
from score_files import (
    assert_penalised,
    score_one,
    score_results,
    submit,
    submit_with_asset,
    truths,
    write_asset,
)
from synthetic_case import (
    in_frame,
    noisy_answer,
    random_pose,
    truth_as_answer,
    with_joint,
    with_names_exchanged,
)

from freeart21.errors import FreeArtError
from freeart21.files.result import Method, write_method, write_result
from freeart21.joint import Joint
from freeart21.reconstruction import Failure
from leaderboard import asset_measurement, forked
from leaderboard.asset_measurement import measure_asset
from leaderboard.protocols import PROTOCOLS, protocol_named
from leaderboard.protocols.strict import STRICT_3
from leaderboard.scores_file import write_scores
from leaderboard.tables import page_entries, print_scores, score_note

pytestmark = pytest.mark.usefixtures("few_samples")


# ---- whole tables


def test_the_truth_handed_in_is_perfect_and_the_table_complete(data, tmp_path):
    for name, truth in truths().items():
        submit(tmp_path / name, truth)
    write_method(tmp_path, Method("oracle"))
    rows_done = []
    scores = score_results(tmp_path, data, progress=lambda row, of: rows_done.append(row))
    assert [row.sequence for row in scores.rows] == ["a", "b", "c"]
    assert rows_done == [
        replace(row, result_sha256=None, truth_sha256=None) for row in scores.rows
    ]  # hashed at the end
    for row in scores.rows:
        assert row.status == "ok" and row.measured_from == "files" and row.notes == () and not row.swapped
        for metric in STRICT_3.metrics:
            value = row.values[metric.id]
            if metric.id.startswith("position") and row.joint_type == "prismatic":
                assert value is None
            elif metric.direction == "down":
                assert 0 <= value < 1e-6, metric.id
            else:
                assert value == pytest.approx(100 if metric.id == "psnr" else 1), metric.id
    assert scores.method.name == "oracle" and scores.protocol == "strict-3"
    assert all(s.failures == 0 and s.coverage == 1 for s in scores.summaries)


def test_failures_and_missing_sequences_are_priced_and_stay_in_every_mean(data, tmp_path):
    submit(tmp_path / "a", truths()["a"])
    write_result(tmp_path / "b", Failure("segmentation", "one motion only", {"tracks": 2.0}))
    scores = score_results(tmp_path, data)
    rows = {row.sequence: row for row in scores.rows}
    assert (rows["b"].status, rows["c"].status) == ("failed", "missing")
    assert "segmentation: one motion only" in rows["b"].reason and rows["b"].seconds == 2.0
    for name in "bc":
        assert_penalised(rows[name], truths()[name])
    by_group = {s.group: s for s in scores.summaries}
    assert [by_group[g].sequences for g in ("revolute", "prismatic", "all")] == [2, 1, 3]
    assert [by_group[g].failures for g in ("revolute", "prismatic", "all")] == [1, 1, 2]
    assert by_group["all"].coverage == pytest.approx(1 / 3)
    axis = by_group["revolute"].statistics["axis"]
    assert axis.mean == pytest.approx(45) and axis.std == pytest.approx(90 / np.sqrt(2)) and axis.worst == 90
    assert by_group["all"].statistics["axis"].mean == pytest.approx(60)
    assert by_group["prismatic"].statistics["axis"].std is None
    assert by_group["all"].statistics["position"].sequences == 2
    assert "state" not in by_group["all"].statistics  # degrees and % have no common mean
    assert by_group["revolute"].statistics["psnr"].worst == 0


def test_scores_are_json_with_units_prices_and_no_nan(data, tmp_path):
    submit(tmp_path / "results" / "a", truths()["a"], noisy_answer(truths()["a"]), renders=False)
    path = tmp_path / "scores.json"
    scores = score_results(tmp_path / "results", data)
    write_scores(path, scores)
    text = path.read_text()
    body = json.loads(text)
    assert "NaN" not in text and "Infinity" not in text
    assert body["schema"] == "freeart21/scores/2" and len(body["benchmark"]["sha256"]) == 64
    units = {m["id"]: (m["unit"], m["direction"], m["price"]) for m in body["protocol"]["metrics"]}
    assert units["state"] == ({"revolute": "deg", "prismatic": "%"}, "down", "range of motion")
    assert body["rows"][0]["values"]["position"] == pytest.approx(
        body["rows"][0]["values_cm"]["position"] / body["rows"][0]["diagonal_m"]
    )
    assert body["rows"][0]["notes"] == ["2 of 2 held-out views have no render"]


def test_tables_show_every_metric_and_flag_failures(data, tmp_path):
    submit(tmp_path / "a", truths()["a"])
    write_result(tmp_path / "b", Failure("tracks", "[red]no[/red] texture"))
    scores = score_results(tmp_path, data)
    for everything in (False, True):
        console = Console(record=True, width=100, file=io.StringIO())
        print_scores(scores, console, everything)
        text = console.export_text()
        assert max(len(line) for line in text.splitlines()) <= 100
        words = text.split()
        for metric in STRICT_3.metrics:
            for word in metric.id.split("_") if everything else metric.column.split():
                assert word in words, metric.id
        for piece in ("FAILED", "MISSING", "tracks: [red]no[/red] texture", "revolute mean", "1/2 fail", "1 of 3 seq"):
            assert piece in text, piece
    assert "strict-3" in score_note(scores.rows[0], "strict-3") and "no asset" in score_note(scores.rows[0], "strict-3")
    entries = page_entries(scores.rows[0], "strict-3")
    assert entries["psnr"] == {"label": "held-out views (PSNR)", "value": 100.0, "unit": "dB", "better": "up"}
    assert entries["chamfer_w"]["beside"] == "0.00 cm"


def test_unknown_protocols_and_folders_are_one_clear_line(data, tmp_path):
    with pytest.raises(FreeArtError, match=f"'paper-9'; protocols: {', '.join(PROTOCOLS)}$"):
        score_results(tmp_path, data, "paper-9")
    assert_refused("not a folder of results", score_results, tmp_path / "nowhere", data)
    assert_refused("is not a benchmark", score_results, tmp_path, tmp_path)
    assert_refused("the result of one sequence", score_results, submit(tmp_path / "a", truths()["a"]), data)
    with pytest.raises(FreeArtError, match="unknown metric 'axis_err'; metrics of strict-1: joint_type, axis"):
        protocol_named("strict-1").metric("axis_err")


def test_every_metric_has_a_definition_and_a_price():
    for name, protocol in PROTOCOLS.items():
        assert protocol.name == name
        for metric in protocol.metrics:
            assert (
                metric.definition and metric.label and metric.direction in ("up", "down") and metric.penalty_text != ""
            )
        for truth in truths().values():
            kind, prices = truth.articulation.joint.type, protocol.penalties(truth)
            assert {id for id, price in prices.items() if price is None} == {
                metric.id for metric in protocol.metrics if metric.unit(kind) is None
            }


def test_a_wrong_joint_type_prices_the_joint_and_measures_the_rest(data, tmp_path):
    truth = truths()["a"]
    wrong = with_joint(truth_as_answer(truth), replace(truth.articulation.joint, type="prismatic"))
    row = score_one(data, submit(tmp_path / "a", truth, wrong))
    assert row.status == "ok" and row.notes == ("the joint is prismatic, expected revolute",)
    assert [row.values[id] for id in ("joint_type", "axis", "position")] == [0, 90, 100]
    assert row.values["state"] == pytest.approx(np.rad2deg(truth.range_of_motion))
    assert row.values["miou"] == 1 and row.values["chamfer_s"] < 1e-6 and row.values["psnr"] == 100


# ---- the joint, measured from the asset


@pytest.mark.parametrize("name", ["a", "b"])
def test_the_true_joint_as_an_asset_scores_perfect(data, tmp_path, name):
    truth = truths()[name]
    T = random_pose(np.random.default_rng(4))
    folder = submit_with_asset(tmp_path / name, truth, truth.articulation.joint, T, state_zero=0.25)
    row = score_one(data, folder, name)
    assert row.measured_from == "asset" and row.status == "ok", row.reason
    for id in ("axis", "state", "state_all", "chamfer_m", *(["position"] if name == "a" else [])):
        assert row.values[id] < 1e-3, id  # SAPIEN's link poses are float32


def test_shifting_the_urdfs_joint_moves_position_by_as_much(data, tmp_path):
    truth = truths()["a"]
    joint = truth.articulation.joint
    folder = submit_with_asset(tmp_path / "a", truth, replace(joint, pivot=joint.pivot + np.array([0.03, 0, 0.04])))
    assert score_one(data, folder).values["position"] == pytest.approx(100 * 0.05 / truth.diagonal, abs=1e-3)


def test_states_beyond_the_assets_limits_stop_at_the_limit(data, tmp_path):
    truth = truths()["a"]
    folder = submit_with_asset(tmp_path / "a", truth, truth.articulation.joint, state_zero=0.25, limits=(0.15, 0.75))
    clipped = replace(truth_as_answer(truth), states=np.minimum(truth.states, 0.5))
    expected = submit(tmp_path / "x" / "a", truth, clipped)
    row = score_one(data, folder)
    assert row.values["state_all"] == pytest.approx(score_one(data, expected).values["state_all"], abs=1e-3)
    assert row.values["state_all"] > 5


def test_the_asset_keeps_up_with_exchanged_names_and_moved_frames(data, tmp_path):
    truth = truths()["a"]
    answer = noisy_answer(truth, 3)
    T = random_pose(np.random.default_rng(5))
    turned = with_names_exchanged(in_frame(answer, T))
    plain, other = submit(tmp_path / "x" / "a", truth, answer), submit(tmp_path / "y" / "a", truth, turned)
    write_asset(plain / "asset", answer.articulation.joint, parts=answer.articulation)
    write_asset(other / "asset", turned.articulation.joint, T, parts=turned.articulation)
    a, b = score_one(data, plain), score_one(data, other)
    assert (a.swapped, b.swapped) == (False, True) and a.measured_from == b.measured_from == "asset"
    assert a.values == pytest.approx(b.values, abs=1e-3)


"""Reason to what becomes of the URDF's text."""


def test_an_asset_that_ends_the_simulator_ends_only_itself(data, tmp_path, monkeypatch):
    crash = tmp_path / "site"
    crash.mkdir()
    (crash / "sapien.py").write_text("import os; os.abort()")
    monkeypatch.syspath_prepend(str(crash))
    monkeypatch.setattr(asset_measurement, "_SERVER", forked.Server("leaderboard.asset_measurement"))  # a new process
    truth = truths()["a"]
    folder = submit_with_asset(tmp_path / "a", truth)
    row = score_one(data, folder)
    assert row.status == "failed" and "ended the simulator" in row.reason


def test_a_range_of_several_turns_is_read_right(tmp_path):
    joint = Joint("lid", "revolute", np.array([0, 0.6, 0.8]), np.array([0.1, 0.2, -0.3]), -7.0, 9.0)
    write_asset(tmp_path, joint, limits=(-7.0, 9.0))
    measured = measure_asset(tmp_path, [-6.0, 0.0, 2.0, 8.5], whole=False)
    found, states = measured.joint, measured.states
    assert np.allclose(found.axis, joint.axis, atol=1e-5)
    assert np.linalg.norm(np.cross(found.pivot - joint.pivot, joint.axis)) < 1e-5
    assert np.allclose(np.exp(1j * states), np.exp(1j * np.array([-6.0, 0.0, 2.0, 8.5])), atol=1e-5)
