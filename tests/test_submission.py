"""One submission's fault costs its own row: hostile files, links, assets, and rows without end; all faults at once."""

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run_command
from hypothesis import given, settings
from hypothesis import strategies as st
from mutations import MUTATED, mutated_arrays, mutated_bytes, mutated_json
from refusal import assert_refused
from score_files import assert_penalised, score_one, score_results, submit, submit_with_asset, truths
from synthetic_case import (
    HEIGHT,
    WIDTH,
    pictures,
    truth_as_answer,
    with_names_exchanged,
)

from freeart21 import processes
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.mesh_file import write_ply
from freeart21.files.result import write_result
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure
from leaderboard.protocols import protocol_named
from leaderboard.score import score_results as score_in_processes
from leaderboard.scores_file import write_scores
from leaderboard.sequence_score import SequenceScorer
from leaderboard.skeleton import write_skeleton
from leaderboard.submission import UNREADABLE, find_faults, read_submission, read_submitted_method
from leaderboard.tables import print_scores
from leaderboard.validate import validate_results

pytestmark = pytest.mark.usefixtures("few_samples")


# ---- assets that are none

ZERO = 'scale="0 0 0"'


def _bytes(content):
    return lambda folder: (folder / "meshes" / "lid.ply").write_bytes(content)


def _no_faces(folder):
    write_ply(folder / "meshes" / "base.ply", Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)))


def _nan(folder):
    path = folder / "meshes" / "lid.ply"
    head, _, body = path.read_bytes().partition(b"end_header\n")
    path.write_bytes(head + b"end_header\n" + np.full(3, np.nan).tobytes() + body[24:])


def _text(old, new):
    def change(folder):
        path = folder / "made.urdf"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return change


LID = 'filename="meshes/lid.ply"'
BROKEN_ASSETS = {
    "an empty file": (_bytes(b""), "lid.ply"),
    "a mesh without faces": (_no_faces, "base.ply is not a readable .ply file: it has no faces"),
    "vertices that are NaN": (_nan, "finite"),
    "a mesh that is not there": (lambda folder: (folder / "meshes" / "lid.ply").unlink(), "does not exist"),
    "scale 0": (_text(LID, f"{LID} {ZERO}"), "no surface"),
    "nothing to see": (_text("visual>", "sight>"), "no link on the side"),
    "mass NaN": (_text('<mass value="1"/>', '<mass value="nan"/>'), "link 'base'"),
    "no URDF": (lambda folder: (folder / "made.urdf").write_text("<robot"), "is not XML"),
    "a path out": (_text("meshes/lid.ply", "../../../secret.ply"), "leads out of the folder"),
    "no such inertia": (_text('ixx="1"', 'ixx="9"'), "triangle inequality"),
}


@pytest.mark.parametrize("name", BROKEN_ASSETS)
def test_a_broken_mesh_or_mass_is_a_failed_row(data, tmp_path, name):
    truth = truths()["a"]
    folder = submit_with_asset(tmp_path / "a", truth)
    spoil, message = BROKEN_ASSETS[name]
    spoil(folder / "asset")
    row = score_one(data, folder)
    assert row.status == "failed" and row.reason.startswith("asset: ") and message in row.reason, row.reason
    assert_penalised(row, truth)


def test_what_the_checks_find_is_a_note(data, tmp_path):
    truth = truths()["a"]
    folder = submit_with_asset(
        tmp_path / "a", truth, truth.articulation.joint, urdf=lambda text: text.replace('effort="1"', 'effort="0"')
    )
    row = score_one(data, folder)
    assert row.status == "ok" and any("asset: limits: joint 'lid' has effort 0" in note for note in row.notes)


def test_a_material_outside_the_asset_is_not_opened(data, tmp_path):
    truth = truths()["a"]
    folder = submit_with_asset(
        tmp_path / "a", truth, truth.articulation.joint, urdf=lambda text: text.replace("base.ply", "base.obj")
    )
    mesh = truth.articulation.reference
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces]
    (tmp_path / "secret.mtl").write_text("newmtl x\nmap_Kd the_secret\n")
    (folder / "asset" / "meshes" / "base.obj").write_text("\n".join(["mtllib ../../../secret.mtl", *lines]))
    row = score_one(data, folder)
    assert "the_secret" not in f"{row.reason}{row.notes}" and "leads out of the folder" in f"{row.reason}{row.notes}"


def test_modules_among_the_results_are_not_imported(data, tmp_path, monkeypatch):
    """A Python started in the results folder must not take its modules from there."""
    for name in ("numpy", "json", "leaderboard"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('taken from the results')")
    monkeypatch.chdir(tmp_path)
    truth = truths()["a"]
    folder = submit_with_asset(tmp_path / "a", truth)
    assert score_one(data, folder).status == "ok"
    assert (
        subprocess.run(processes.command("leaderboard.parallel_rows"), input="", text=True, timeout=60).returncode == 0
    )


# ---- held-out views of the other choice


def test_views_of_the_other_choice_are_read_when_the_parts_are_swapped(data, tmp_path):
    truth = truths()["a"]
    folder = submit(tmp_path / "a", truth, with_names_exchanged(truth_as_answer(truth)), renders=False)
    for sub, views in (("renders", [np.zeros_like(p) for p in pictures(truth)]), ("renders_other", pictures(truth))):
        (folder / sub).mkdir()
        for i, view in enumerate(views):
            (folder / sub / f"{i:05d}.png").write_bytes(checked.encode_png(view))
    row = score_one(data, folder)
    assert row.swapped and row.values["psnr"] == 100 and row.notes == ()
    (folder / "renders_other" / "00000.png").write_text("no picture")
    row = score_one(data, folder)
    assert row.values["psnr"] == 50 and "renders_other/00000.png is not a PNG" in row.notes[0]
    shutil.rmtree(folder / "renders_other")
    row = score_one(data, folder)
    assert row.values["psnr"] < 20 and "no renders_other/" in row.notes[0]


# ---- method.json and text


def _linked(path):
    path.with_name("elsewhere.json").write_text('{"schema": "freeart21/method/1", "name": "x"}')
    path.symlink_to(path.with_name("elsewhere.json"))


METHODS = {
    "a list": lambda path: path.write_text("[1, 2]"),
    "another schema": lambda path: path.write_text('{"schema": "x", "name": "y"}'),
    "not UTF-8": lambda path: path.write_bytes(b'{"name": "\xff\xfe"}'),
    "deep": lambda path: path.write_text("[" * 100_000),
    "huge": lambda path: path.write_text('{"schema": "freeart21/method/1", "name": "' + "x" * (1 << 21) + '"}'),
    "a link": _linked,
    "a folder": lambda path: path.mkdir(),
}


@pytest.mark.parametrize("name", METHODS)
def test_a_broken_method_json_is_a_fault_and_loses_no_row(tmp_path, name):
    METHODS[name](tmp_path / "method.json")
    method, (fault,) = read_submitted_method(tmp_path)
    assert method.name == UNREADABLE and fault.file == "method.json" and fault.fix


HOSTILE = "a\x1b[2Jb\r\nc\ud800d\u202ee\x00" + "y" * 1000


def test_hostile_words_and_numbers_are_escaped_wherever_they_are_shown(data, tmp_path, capsys):
    results = tmp_path / "results"
    settings = {HOSTILE: [float("inf"), float("nan"), 1e300, HOSTILE], "deep": json.loads("[" * 50 + "]" * 50)}
    header = {"schema": "freeart21/method/1", "name": HOSTILE, "code": HOSTILE, "hardware": 7, "settings": settings}
    submit(results / "a", truths()["a"], replace(truth_as_answer(truths()["a"]), seconds={"tracks": 1e300}))
    (results / "method.json").write_text(json.dumps(header))
    declared = {"schema": "freeart21/prediction/1", "status": "failed", "stage": HOSTILE, "reason": HOSTILE}
    (results / "b").mkdir()
    (results / "b" / "prediction.json").write_text(json.dumps({**declared, "seconds": {"x": 1e308, "y": 1e308}}))
    scores = score_results(results, data)
    assert [row.status for row in scores.rows] == ["ok", "failed", "missing"]
    assert scores.rows[0].seconds is None and scores.rows[1].seconds is None
    print_scores(scores, everything=True)
    shown = capsys.readouterr().out
    write_scores(tmp_path / "scores.json", scores)
    written = (tmp_path / "scores.json").read_bytes().decode("utf-8")
    body = json.loads(written, parse_constant=lambda word: pytest.fail(word))
    assert max(map(len, shown.splitlines())) < 700
    for text in (shown.replace("\n", ""), scores.method.name, json.dumps(body, ensure_ascii=False)):
        assert text.isprintable() and "\\x1b[2J" in text.replace("\\\\", "\\")
        text.encode("utf-8")


# ---- links


@pytest.mark.parametrize("to", ["a folder", "nothing"])
def test_a_link_in_place_of_a_result_is_refused_as_its_own_fault(data, tmp_path, to):
    elsewhere = submit(tmp_path / "elsewhere", truths()["a"])
    results = tmp_path / "results"
    results.mkdir()
    (results / "a").symlink_to(elsewhere if to == "a folder" else tmp_path / "nowhere")
    submit(results / "c", truths()["c"])
    rows = score_results(results, data).rows
    assert [row.status for row in rows] == ["unreadable", "missing", "ok"] and "a is a link" in rows[0].reason
    assert [fault.file for fault in validate_results(results, data).faults] == ["a", "b"]


# ---- where the results are


def test_one_level_too_high_or_too_low_says_what_was_meant(data, tmp_path):
    folder = submit(tmp_path / "results" / "ours" / "a", truths()["a"])
    for check in (score_results, validate_results):
        assert_refused("did you mean .*results/ours", check, tmp_path / "results", data)
        assert_refused("did you mean .*results/ours", check, folder, data)


# ---- rows in a process of their own


@pytest.fixture
def impatient(monkeypatch):
    """A scorer that sleeps on sequence b and dies on sequence c."""
    source = (
        "import sys, os, time, leaderboard.sequence_score as s, leaderboard.parallel_rows as w\n"
        "real = s.score_sequence\n"
        "def slow(result, *rest):\n"
        "    if result.name == 'b': time.sleep(600)\n"
        "    if result.name == 'c': os.abort()\n"
        "    return real(result, *rest)\n"
        "s.score_sequence = slow\n"
        "w.main()\n"
    )
    places = [place for place in sys.path if place]
    command = [sys.executable, "-c", f"import sys; sys.path[:] = {places!r}\n{source}"]
    monkeypatch.setattr(processes, "command", lambda module: command)


def test_a_row_without_end_and_one_that_crashes_cost_only_themselves(data, tmp_path, impatient):
    for name in "abc":
        write_result(tmp_path / name, Failure("tracks", f"declared by {name}"))
    rows = score_in_processes(tmp_path, data, limit_s=20.0).rows
    assert [row.status for row in rows] == ["failed"] * 3
    assert rows[0].reason == "tracks: declared by a"
    assert rows[1].reason == "scoring took more than 20 s"
    assert rows[2].reason == f"scoring ended with exit code {-signal.SIGABRT}"
    assert_penalised(rows[1], truths()["b"])


def test_a_row_scored_apart_is_the_row_scored_here(data, tmp_path):
    write_result(tmp_path / "a", Failure("tracks", "declared", {"tracks": 2.5}))
    submit_with_asset(tmp_path / "c", truths()["c"])
    apart, here = score_in_processes(tmp_path, data).rows, score_results(tmp_path, data).rows
    assert apart[:2] == here[:2] and apart[2].measured_from == "asset" and apart[2].status == "ok"
    exact = ("axis", "state", "miou", "pose_rotation")  # whatever the number of samples
    assert [apart[2].values[id] for id in exact] == [here[2].values[id] for id in exact]


def test_a_fault_of_the_truth_is_said_and_not_priced(data, tmp_path):
    shutil.copytree(data, tmp_path / "data")
    (tmp_path / "data" / "truth" / "b" / "truth.json").unlink()
    write_result(tmp_path / "results" / "a", Failure("tracks", "declared"))
    assert_refused("truth.json", score_in_processes, tmp_path / "results", tmp_path / "data")


# ---- one file, spoiled


def _put_json(folder, value):
    (folder / "prediction.json").write_text(json.dumps(value))


def _put_arrays(folder, arrays):
    np.savez(folder / "poses.npz", **arrays)


@pytest.fixture(scope="module")
def answer(tmp_path_factory):
    """A valid answer to sequence a, with renders, and what its JSON and its poses hold."""
    folder = submit(tmp_path_factory.mktemp("answer") / "results" / "a", truths()["a"])
    with np.load(folder / "poses.npz") as read:
        arrays = {name: read[name] for name in read}
    return folder, json.loads((folder / "prediction.json").read_text()), arrays


@settings(MUTATED, max_examples=60)
@given(draw=st.data())
def test_a_spoiled_file_is_read_or_penalised_for_one_reason_that_validate_has_too(data, answer, draw):
    folder, header, arrays = answer
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    kind = draw.draw(st.sampled_from(("json", "json", "arrays", "bytes", "missing")))
    path = {"json": folder / "prediction.json", "arrays": folder / "poses.npz"}.get(kind)
    path = path or draw.draw(st.sampled_from(files))
    whole = path.read_bytes()
    try:
        if kind == "json":
            _put_json(folder, draw.draw(mutated_json(header)))
        elif kind == "arrays":
            _put_arrays(folder, draw.draw(mutated_arrays(arrays)))
        elif kind == "bytes":
            path.write_bytes(draw.draw(mutated_bytes(whole)))
        else:
            path.unlink()
        recording = read_sequence(data / "sequences" / "a")
        scorer = SequenceScorer(protocol_named("strict-1"), recording, read_truth(data / "truth" / "a"))
        _, faults = find_faults(folder, len(recording), HEIGHT, WIDTH)
        assert all(str(fault).isprintable() and len(str(fault)) < 1000 for fault in faults)
        fatal = [str(fault) for fault in faults if fault.fatal]
        try:
            read, notes = read_submission(folder, len(recording), HEIGHT, WIDTH)
        except FreeArtError as error:
            assert str(error) == fatal[0]
        else:
            assert not fatal and list(notes) == [str(fault) for fault in faults]
            if not isinstance(read, Failure):
                row = scorer.measure_row(read, folder, "files")
                assert all(value is None or np.isfinite(value) for value in row.values.values())
    finally:
        path.write_bytes(whole)


@pytest.mark.parametrize("path", ["part_mask/00006.png", "parts", "prediction.json", "renders"])
def test_a_link_to_itself_is_a_fault_of_its_row(data, tmp_path, path):
    folder = submit(tmp_path / "a", truths()["a"])
    spoiled = folder / path
    shutil.rmtree(spoiled) if spoiled.is_dir() else spoiled.unlink()
    spoiled.symlink_to(spoiled.name)
    fault = validate_results(tmp_path, data).faults[0]
    assert str(fault) == f"a/{path} leads to itself, expected the file or folder itself"
    row = score_one(data, folder)
    assert row.status == "unreadable" and row.reason == str(fault)


# ---- validate


def spoil_everything(folder: Path) -> None:
    header = json.loads((folder / "prediction.json").read_text())
    header["joint"]["axis"] = [0, 0, 2]
    header["states"][3] = None
    header["seen"] = [[1, 1]]
    (folder / "prediction.json").write_text(json.dumps(header))
    Ts = np.repeat(np.eye(4)[None], 16, 0)
    wrong = Ts.copy()
    wrong[[4, 9], :3, :3] *= 2
    np.savez(folder / "poses.npz", T_camera_reference=wrong, T_camera_moving=Ts[:15])
    for i, picture in ((2, np.zeros((2, 3), np.uint8)), (5, np.full((HEIGHT, WIDTH), 7, np.uint8))):
        (folder / "part_mask" / f"{i:05d}.png").write_bytes(checked.encode_png(picture))
    for i in (7, 8):
        (folder / "part_mask" / f"{i:05d}.png").unlink()
    (folder / "parts" / "moving.ply").write_text("ply?")
    (folder / "renders" / "00001.png").write_bytes(checked.encode_png(np.zeros((2, 3, 3), np.uint8)))


def test_validate_tells_every_fault_at_once_and_score_the_first_of_them(data, tmp_path):
    folder = submit(tmp_path / "a", truths()["a"])
    write_result(tmp_path / "b", Failure("tracks", "declared"))
    (tmp_path / "extra").mkdir()
    spoil_everything(folder)
    report = validate_results(tmp_path, data)
    found = {(fault.file, fault.field, fault.frame) for fault in report.faults}
    assert found == {
        ("a/prediction.json", "joint", None),
        ("a/prediction.json", "states", None),
        ("a/prediction.json", "seen", None),
        ("a/poses.npz", "T_camera_reference", 4),
        ("a/poses.npz", "T_camera_moving", None),
        ("a/part_mask/00002.png", "", 2),
        ("a/part_mask/00005.png", "", 5),
        ("a/part_mask/00007.png", "", 7),
        ("a/parts/moving.ply", "", None),
        ("a/renders/00001.png", "", None),
        ("c", "", None),
    }
    messages = {fault.file + fault.field: str(fault) for fault in report.faults}
    assert "2 of 16 frames" in messages["a/poses.npzT_camera_reference"]
    assert "1 more of 16 frames" in messages["a/part_mask/00007.png"]
    assert (
        "(15, 4, 4)" in messages["a/poses.npzT_camera_moving"]
        and "expected (16, 4, 4)" in messages["a/poses.npzT_camera_moving"]
    )
    assert any("extra" in note for note in report.notes) and any("method.json" in note for note in report.notes)
    assert (report.answers, report.failures) == (0, 1)
    row = score_one(data, folder)
    assert row.status == "unreadable" and row.reason == str(report.faults[0])


# ---- a skeleton to fill in


def test_a_skeleton_is_valid_and_priced_and_its_examples_are_answers(data, tmp_path):
    out = tmp_path / "mine"
    assert write_skeleton(data, out) == ("a", "b", "c")
    report = validate_results(out, data)
    assert report.faults == () and (report.answers, report.failures) == (0, 3)
    scores = score_results(out, data)
    assert {row.status for row in scores.rows} == {"failed"} and scores.measured == 0 and scores.method.name == "mine"
    for name, truth in truths().items():
        assert_penalised(scores.rows["abc".index(name)], truth)
        (out / name / "prediction.example.json").replace(out / name / "prediction.json")
    report = validate_results(out, data)
    assert report.faults == () and report.answers == 3
    assert score_results(out, data).measured == 3
    readme = (out / "README.txt").read_text()
    for path in (p for p in (out / "a").rglob("*") if p.is_file() and p.name not in ("00000.png",)):
        relative = path.relative_to(out / "a").as_posix()
        assert path.parent.name == "part_mask" or f"SEQ/{relative}" in readme, relative


# ---- commands


def test_exit_codes_say_whether_anything_was_measured_or_wrong(data, tmp_path, capsys):
    out = tmp_path / "mine"
    assert run_command(capsys, "init-submission", data, "--out", out)[0] == 0
    assert run_command(capsys, "init-submission", data, "--out", out)[0] == 1
    assert run_command(capsys, "validate", out, "--data", data)[0] == 0
    code, shown, _ = run_command(capsys, "score", out, "--data", data, "--out", tmp_path / "scores.json")
    assert code == 1 and "0 of 3 sequences were measured" in shown
    assert max(map(len, shown.splitlines())) <= 100
    assert json.loads((tmp_path / "scores.json").read_text())["protocol"]["name"] == "strict-3"
    (out / "a" / "poses.npz").unlink()
    (out / "a" / "prediction.example.json").replace(out / "a" / "prediction.json")
    code, shown, err = run_command(capsys, "validate", out, "--data", data)
    assert code == 1 and shown.startswith("a/poses.npz is missing") and "1 fault" in err
