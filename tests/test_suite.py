"""The suite: its rows are settings that the solver knows, its reference rows say whether scoring can be believed."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from refusal import assert_refused
from score_files import score_results, submit, truths, write_data

from freeart21.errors import FreeArtError
from freeart21.files.result import read_result, write_result
from freeart21.jobs import EXECUTORS
from freeart21.jobs.executors import Local
from freeart21.reconstruction import Failure
from leaderboard.reference import KINDS, write_reference
from leaderboard.score import score_results as score_in_processes
from leaderboard.suite import steps
from leaderboard.suite.rates import MEASURED, read_rates, update_rates
from leaderboard.suite.rows import GROUPS, ROWS, choose_rows
from leaderboard.suite.workflow import _describe_data, _find_objections, prepare, run_suite
from reconstruct.settings import ReconstructSettings, read_settings

ROOT = Path(__file__).resolve().parents[1]
ROWS_RUN = ("truth", "random")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="module")
def suite(data, tmp_path_factory):
    """A suite of two reference rows over one sequence, run at once."""
    out = tmp_path_factory.mktemp("suite") / "out"
    return out, run_suite(prepare(data, out, ROWS_RUN, ["a"]), 2)


def tables(out: Path) -> dict[str, dict]:
    """Every table."""
    return {path.name: json.loads(path.read_text()) for path in sorted((out / "scores").iterdir())}


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_truth_scores_perfect_and_what_knows_nothing_badly(data, tmp_path, few_samples):
    tables = {}
    for kind in KINDS:
        write_reference(kind, data, tmp_path / kind)
        tables[kind] = score_results(tmp_path / kind, data, "strict-3")
    means = {
        kind: {s.group: {id: v.mean for id, v in s.statistics.items()} for s in scores.summaries}
        for kind, scores in tables.items()
    }
    truth = means["truth"]["all"]
    assert not steps.list_imperfect(tables["truth"])
    assert truth["miou"] == truth["joint_type"] == 1 and truth["psnr"] == 100 and truth["axis"] < 1e-3
    assert truth["chamfer_w"] < 1e-6 and truth["pose_moving_rotation"] < 1e-3
    for row in ("static", "random"):
        assert means[row]["all"]["miou"] < 0.6 and means[row]["all"]["psnr"] == 0
        assert means[row]["all"]["pose_rotation"] > 10 and means[row]["revolute"]["state"] > 10
        assert means[row]["all"]["pose_moving_translation"] > 5 and means[row]["all"]["chamfer_m"] > 1
    rows = {row.sequence: row.values for row in tables["static"].rows}
    assert rows["b"]["joint_type"] == 0 and rows["b"]["axis"] == 90  # it says revolute of all
    assert rows["a"]["joint_type"] == 1


def test_what_is_done_is_skipped_and_a_new_row_joins(suite, data):
    out, outcome = suite
    assert not outcome.failed and not outcome.objections and set(outcome.tables["strict-3"]) == set(ROWS_RUN)
    plan = prepare(data, out, ROWS_RUN, ["a"])
    assert not plan.todo and plan.seconds == 0
    before = tables(out)
    again = run_suite(plan)
    assert again.tables == outcome.tables and tables(out) == before
    assert {job.kind for job in prepare(data, out, ["ours", *ROWS_RUN], ["a"]).todo} == {
        "reconstruct",
        "export",
        "score",
    }
    rates = read_rates(out / "rates.json")
    assert "this suite" in rates["score"].source and rates["record"] == read_rates()["record"]


def test_a_suite_that_is_killed_goes_on_to_the_same_tables(suite, data, tmp_path):
    whole, _ = suite
    out, draw = tmp_path / "out", random.Random(3)
    command = [sys.executable, "-m", "freeart21", "suite", str(data), "--out", str(out)]
    command += ["--rows", "random", "--sequences", "a"]
    for _ in range(2):
        with subprocess.Popen(command, env=ENVIRONMENT, stdout=-3, stderr=-3) as run:
            deadline = time.monotonic() + 60
            while not (out / "jobs.json").exists() and time.monotonic() < deadline:
                time.sleep(0.02)
            time.sleep(draw.uniform(0, 3))
            run.send_signal(signal.SIGKILL)
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "1 rows over 1 sequences: 2 jobs" in done.stdout and "GB free" in done.stdout
    assert "strict-3, means over 1 revolute" in done.stdout and "random" in done.stdout
    assert tables(out)["random.strict-3.json"] == tables(whole)["random.strict-3.json"]
    there = files(whole / "results")
    assert files(out / "results") == {path: there[path] for path in files(out / "results")}


def test_a_failure_of_the_solver_is_an_answer_and_is_priced(data, tmp_path):
    """The made-up videos are flat grey pictures: nothing can be found in them."""
    out = tmp_path / "out"
    outcome = run_suite(prepare(data, out, ["ours"], sequences=["a"]))
    assert not outcome.failed
    assert isinstance(read_result(out / "results" / "ours" / "a"), Failure)
    (row,) = tables(out)["ours.strict-3.json"]["rows"]
    assert row["status"] == "failed" and row["values"]["axis"] == 90
    assert "1 of 3 sequences were chosen: a" in tables(out)["ours.strict-3.json"]["notes"]


def test_a_place_that_is_no_suite_over_these_data_is_refused(data, tmp_path):
    out = tmp_path / "out"
    (out / "results").mkdir(parents=True)
    assert_refused("is no older suite of rows", prepare, data, out)
    (out / "suite.json").write_text('{"schema": "freeart21/suite/1"}')
    assert_refused("is a suite over other data", prepare, data, out)


def test_jobs_that_fail_are_listed_and_the_command_ends_with_1(data, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "suite.json").write_text(json.dumps({"schema": "freeart21/suite/1", **_describe_data(data)}))
    (out / "results" / "static").mkdir(parents=True)  # of nobody's job
    command = [sys.executable, "-m", "freeart21", "suite", str(data), "--rows", "static", "--out", str(out)]
    done = subprocess.run([*command, "--sequences", "a"], env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 1
    output = [line for line in done.stderr.splitlines() if line.startswith("freeart21: ")]
    assert output[0].startswith("freeart21: reference/static: ") and "was not made by the job" in output[0]
    assert output[1:] == ["freeart21: score/static/strict-3: needs reference/static, which failed"]
    assert list((out / "results" / "static").iterdir()) == [] and not (out / "scores").exists()


def test_reference_rows_are_the_same_bytes_again_and_others_by_another_seed(data, tmp_path):
    for kind in KINDS:
        write_reference(kind, data, tmp_path / "one" / kind)
        write_reference(kind, data, tmp_path / "two" / kind)
        assert files(tmp_path / "one" / kind) == files(tmp_path / "two" / kind)
    write_reference("random", data, tmp_path / "three" / "random", seed=1)
    assert files(tmp_path / "one" / "random") != files(tmp_path / "three" / "random")
    assert_refused("exists", write_reference, "truth", data, tmp_path / "one" / "truth")
    assert_refused("truth, static, random", write_reference, "still", data, tmp_path / "four")
    with pytest.raises(FreeArtError, match="no sequence 'z'; it has a, b, c"):
        write_reference("truth", data, tmp_path / "four", sequences=["z"])
    assert not (tmp_path / "four").exists()


def test_a_truth_that_is_a_little_off_is_objected_to(data, tmp_path, few_samples):
    write_reference("truth", data, tmp_path / "truth")
    scores = score_results(tmp_path / "truth", data, "strict-1")
    assert steps.list_imperfect(scores) == []
    write_result(tmp_path / "truth" / "b", Failure("none", "not solved"))
    found = steps.list_imperfect(score_results(tmp_path / "truth", data, "strict-1"))
    assert any(line.startswith("b: axis 90, expected 0") for line in found)
    row = {row.name: row for row in ROWS}
    assert "does not score perfect" in _find_objections(row["truth"], "strict-1", {"imperfect": found})[0]
    lucky = {"summaries": [{"group": "all", "statistics": {"miou": {"mean": 0.9}}}]}
    assert "mean mIoU of 0.90" in _find_objections(row["random"], "strict-1", lucky)[0]


# --- rows as data -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", [row for row in ROWS if row.settings], ids=lambda row: row.name)
def test_the_settings_of_a_row_are_the_solvers_and_change_it(row, tmp_path):
    path = tmp_path / "settings.json"
    path.write_text(json.dumps(row.settings))
    settings = read_settings(path)
    others = [read_settings(_written(tmp_path, other.settings)) for other in ROWS if other.settings and other != row]
    assert settings != ReconstructSettings() and settings not in others


def _written(folder: Path, settings) -> Path:
    (folder / "other.json").write_text(json.dumps(settings))
    return folder / "other.json"


def test_rows_are_chosen_by_name_or_group():
    assert choose_rows([]) == list(ROWS) and {row.group for row in ROWS} == set(GROUPS)
    assert len({row.name for row in ROWS}) == len(ROWS)
    assert [row.name for row in choose_rows(["random", "ours"])] == ["random", "ours"]
    assert all(row.group == "paper-pieces" for row in choose_rows(["paper-pieces"]))
    assert_refused("unknown row 'theirs'; groups: reference", choose_rows, ["theirs"])


def test_rows_without_a_piece_of_the_gaussians_are_solved_by_its_switch(data, tmp_path):
    switches = {"no-gaussians": "refine", "no-end-to-end": "end_to_end", "no-blended-rendering": "blended"}
    rows = {row.name: row for row in ROWS}
    for name, switch in switches.items():
        assert rows[f"ours-{name}"].settings == {"gaussians": {switch: False}}
        if name != "no-gaussians":
            assert rows[f"paper-{name}"].settings == {"segmentation": "paper", "gaussians": {switch: False}}
    jobs = prepare(data, tmp_path / "out", ["paper-no-blended-rendering"], sequences=["a"]).plan.jobs
    solve = next(job for job in jobs if job.name == "reconstruct-paper/paper-no-blended-rendering/a")
    assert solve.command[-2:] == ("--settings", "{folder}/settings/paper-no-blended-rendering.json")


def test_what_was_not_recorded_by_us_cannot_be_recorded_with_another_sensor(data, tmp_path):
    assert_refused("a cannot be recorded with another sensor", prepare, data, tmp_path / "out", ["sensors"])


def test_another_sensor_is_recorded_as_the_sequence_was(data, tmp_path):
    where = write_data(tmp_path / "data")
    header = json.loads((where / "truth" / "a" / "truth.json").read_text())
    settings = {"frames": 16, "seed": 4, "width": 40, "height": 32, "queries": 2, "motion": "wave", "preset": "paper"}
    header["source"] = {
        "object": "stapler",
        "object_source": "procedural",
        "settings": {**settings, "shader": "trivial", "fps": 30.0},
    }
    (where / "truth" / "a" / "truth.json").write_text(json.dumps(header))
    jobs = prepare(where, tmp_path / "out", ["ours-tof"], sequences=["a"]).plan.jobs
    (words,) = jobs[0].arguments["commands"]
    assert words[:3] == ["stapler", "--sensor", "tof"] and words[words.index("--motion") + 1] == "wave"
    assert [job.name for job in jobs[1:]] == [
        "reconstruct/ours-tof/stapler-s4",
        "export/ours-tof/stapler-s4",
        "score/ours-tof/strict-3",
    ]
    assert "{folder}/data/tof/sequences/stapler-s4" in jobs[1].command


def test_a_forecast_beyond_the_disk_is_refused_before_anything_is_written(data, tmp_path):
    plan = prepare(data, tmp_path / "out", ["truth"])
    assert plan.seconds > 0 and 0 < plan.bytes < plan.free_bytes
    full = type(plan)(**{**vars(plan), "free_bytes": 10})
    assert_refused("GB free", run_suite, full)
    assert not (tmp_path / "out").exists()


def test_rates_have_a_source_and_follow_what_is_measured():
    rates = read_rates(MEASURED)
    kinds = {"record", "record-trivial", "reconstruct", "reconstruct-paper", "export", "reference", "score"}
    assert set(rates) == kinds and all(rate.source for rate in rates.values())
    now = update_rates(rates, [("score", 6.0, 10), ("score", 2.0, 10)], "here")
    assert now["score"].seconds_per_frame == 0.4 and now["score"].source == "here: 2 jobs"
    assert now["export"] == rates["export"]


# --- scoring side by side ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def few(data, tmp_path_factory) -> Path:
    """Results: one has to be measured, one is a failure and one is missing."""
    folder = tmp_path_factory.mktemp("few") / "few"
    submit(folder / "b", truths()["b"])
    write_result(folder / "a", Failure("none", "not solved"))
    return folder


@pytest.fixture(scope="module")
def one_by_one(data, few):
    return score_in_processes(few, data, "strict-1")


def test_rows_scored_side_by_side_are_the_same_rows_in_the_same_order(data, few, one_by_one):
    heard = []
    two = score_in_processes(few, data, "strict-1", lambda row, of: heard.append((row.sequence, of)), workers=2)
    assert one_by_one.rows == two.rows and one_by_one.summaries == two.summaries
    assert [row.status for row in two.rows] == ["failed", "ok", "missing"]
    assert sorted(heard) == [("a", 3), ("b", 3), ("c", 3)]
    assert_refused("0 workers", score_in_processes, few, data, workers=0)


def test_a_row_as_a_job_is_the_same_row(data, few, one_by_one, tmp_path, monkeypatch):
    monkeypatch.setitem(EXECUTORS, "elsewhere", Local)
    where = few, data, "strict-1"
    rows = score_in_processes(*where, executor="elsewhere", workers=2, work=tmp_path / "work", sequences=["b", "a"])
    assert rows.rows == one_by_one.rows[:2]
    assert_refused("needs a folder", score_in_processes, *where, executor="elsewhere")


def test_rows_that_take_too_long_are_priced_also_beside_others(data, few):
    scores = score_in_processes(few, data, "strict-1", limit_s=0.01, workers=2)
    assert [row.status for row in scores.rows] == ["failed"] * 3
    assert all("more than 0.01 s" in row.reason for row in scores.rows)
