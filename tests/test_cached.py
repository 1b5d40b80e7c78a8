"""Tables of scores as files: the same bytes every time, checked when read, cached while nothing has changed."""

import json
import os
import shutil
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mutations import MUTATED, mutated_bytes, mutated_json, reads_or_refuses
from refusal import assert_refused
from score_files import score_results, submit, truths

import freeart21
from freeart21.files.result import Method, write_method, write_result
from freeart21.reconstruction import Failure
from leaderboard import cached, provenance
from leaderboard.cached import cached_scores
from leaderboard.provenance import describe_environment, folder_sha256
from leaderboard.scores_file import read_scores, write_scores

pytestmark = pytest.mark.usefixtures("few_samples")


@pytest.fixture
def results(tmp_path):
    """An answer, a failure that says so, and one that is missing."""
    submit(tmp_path / "mine" / "a", truths()["a"])
    write_result(tmp_path / "mine" / "b", Failure("tracking", "too dark", {"tracking": 3.0}))
    write_method(tmp_path / "mine", Method("mine", "somewhere, 3", {"a": [1, 2.5, None]}, "a laptop"))
    return tmp_path / "mine"


@pytest.fixture
def counted(monkeypatch):
    """The names of results folders that were scored rather than read."""
    scored = []

    def score(results, *arguments, **named):
        scored.append(results.name)
        return score_results(results, *arguments, **named)

    monkeypatch.setattr(cached, "score_results", score)
    return scored


# ---- the same bytes


def test_scoring_twice_gives_the_same_bytes_and_reading_gives_the_same_table(data, results, tmp_path):
    for name in ("one", "two"):
        write_scores(tmp_path / name, score_results(results, data))
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    scores = read_scores(tmp_path / "one")
    assert replace(score_results(results, data), seconds=None) == scores
    write_scores(tmp_path / "three", scores)
    assert (tmp_path / "three").read_bytes() == (tmp_path / "one").read_bytes()


def test_every_row_says_of_which_bytes_it_is(data, results):
    scores = score_results(results, data)
    rows = {row.sequence: row for row in scores.rows}
    for name in "ab":
        assert rows[name].result_sha256 == folder_sha256(results / name)
    assert rows["c"].status == "missing" and rows["c"].result_sha256 is None
    assert {row.truth_sha256 for row in scores.rows} == {folder_sha256(data / "truth" / name) for name in "abc"}
    assert scores.made_with == describe_environment()
    assert scores.made_with["libraries"]["numpy"] and scores.made_with["machine"]["machine"]


def test_a_folder_is_hashed_without_following_links_or_waiting_for_pipes(tmp_path, monkeypatch):
    folder = tmp_path / "results"
    folder.mkdir()
    (tmp_path / "secret").write_text("s")
    (folder / "link").symlink_to(tmp_path / "secret")
    (folder / "up").symlink_to(tmp_path)
    os.mkfifo(folder / "pipe")
    before = folder_sha256(folder)
    (tmp_path / "secret").write_text("t")
    assert folder_sha256(folder) == before
    monkeypatch.setattr(provenance, "MAX_BYTES", 9)
    (folder / "large").write_text("0123456789")
    assert_refused("more than 9 bytes", folder_sha256, folder)
    assert_refused("is not a folder", folder_sha256, folder / "link")


# ---- cached


def test_a_table_is_cached_and_read_again(data, results, counted, tmp_path):
    first = cached_scores(results, data, "strict-2", tmp_path / "keep")
    again = cached_scores(results, data, "strict-2", tmp_path / "keep")
    assert counted == ["mine"] and again == replace(first, seconds=None)
    assert [path.name for path in (tmp_path / "keep").iterdir()] == ["mine.strict-2.json"]
    cached_scores(results, data, "strict-1", tmp_path / "keep")
    assert counted == ["mine"] * 2 and (tmp_path / "keep" / "mine.strict-1.json").is_file()


def _append(path):
    path.write_bytes(path.read_bytes() + b" ")


def _replace(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


CHANGES = {
    "a byte of a result": lambda results, data, patch: _append(results / "a" / "poses.npz"),
    "a result that was missing": lambda results, data, patch: write_result(results / "c", Failure("tracking", "dark")),
    "the name of the method": lambda results, data, patch: write_method(results, Method("other")),
    "a byte of the truth": lambda results, data, patch: _append(data / "truth" / "a" / "part_mask" / "00000.png"),
    "the benchmark": lambda results, data, patch: _replace(data / "benchmark.json", '"version": "1"', '"version": "2"'),
    "the version": lambda results, data, patch: patch.setattr(freeart21, "__version__", "0.0"),
    "a library": lambda results, data, patch: patch.setattr(provenance, "_version", lambda name: "0.0"),
    "the table itself": lambda results, data, patch: _replace(
        results.parent / "keep" / "mine.strict-2.json", '"axis": ', '"axle": '
    ),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_change_is_scored_again(change, data, results, counted, tmp_path, monkeypatch):
    mine = shutil.copytree(data, tmp_path / "data")
    cached_scores(results, mine, "strict-2", tmp_path / "keep")
    change(results, mine, monkeypatch)
    cached_scores(results, mine, "strict-2", tmp_path / "keep")
    cached_scores(results, mine, "strict-2", tmp_path / "keep")
    assert counted == ["mine"] * 2


def test_results_that_change_while_they_are_scored_are_not_cached(data, results, tmp_path, monkeypatch):
    def score(results, *arguments, **named):
        scores = score_results(results, *arguments, **named)
        return replace(scores, rows=(replace(scores.rows[0], result_sha256="0" * 64), *scores.rows[1:]))

    monkeypatch.setattr(cached, "score_results", score)
    assert_refused("changed while it was scored", cached_scores, results, data, "strict-2", tmp_path / "keep")
    assert not (tmp_path / "keep").exists()


def test_what_is_no_table_is_never_replaced(data, results, counted, tmp_path):
    path = tmp_path / "keep" / "mine.strict-2.json"
    path.parent.mkdir()
    path.write_text("{}")
    assert_refused("is no older table of scores", cached_scores, results, data, "strict-2", tmp_path / "keep")
    assert path.read_text() == "{}" and counted == []
    assert_refused("lies in", cached_scores, results, data, "strict-2", data / "keep")


# ---- tables from anybody


@pytest.fixture
def table(data, results, tmp_path):
    """The path of a good table, and a function that changes its JSON."""
    path = tmp_path / "scores.json"
    write_scores(path, score_results(results, data))

    def changed(change):
        body = json.loads(path.read_text())
        path.write_text(json.dumps(change(body) or body))
        return path

    return path, changed


def _put(*place):
    """A change that sets the last of `place` there."""
    *way, key, value = place

    def change(body):
        for step in way:
            body = body[step]
        body[key] = value

    return change


@pytest.mark.parametrize(
    "change, message",
    [
        (_put("schema", "freeart21/scores/1"), "schema 'freeart21/scores/1', expected 'freeart21/scores/2'"),
        (_put("protocol", "name", "loose-9"), "unknown protocol 'loose-9'"),
        (_put("rows", []), "has 0 rows, expected 1 to"),
        (_put("rows", 0, "sequence", "../a"), "expected the name of a folder"),
        (_put("rows", 0, "measured_from", "nothing"), "is ok and measured from nothing"),
        (_put("rows", 0, "values", "axis", float("nan")), "axis' is nan, expected a finite number"),
        (_put("rows", 0, "values", "axle", 0.0), "its values has 'axle'"),
    ],
)
def test_a_table_that_is_wrong_is_refused_in_one_line(change, message, table):
    path, changed = table
    line = assert_refused("", read_scores, changed(change))
    assert (message in line and str(path) in line) or message.startswith("unknown")


def test_a_mutated_table_is_read_or_refused(table):
    path, _ = table
    whole = path.read_bytes()

    @settings(MUTATED, max_examples=60)
    @given(draw=st.data())
    def mutate(draw):
        spoiled = draw.draw(mutated_bytes(whole)) if draw.draw(st.booleans()) else None
        path.write_bytes(spoiled or json.dumps(draw.draw(mutated_json(json.loads(whole)))).encode())
        line = reads_or_refuses(read_scores, path)
        assert len(line) < 1000 and line.isprintable()

    mutate()


def test_a_table_without_fields_that_have_a_default_and_with_unknown_ones_is_read(table):
    path, changed = table
    scores = read_scores(path)

    def older(body):
        del body["notes"], body["summaries"], body["rows"][1]["notes"], body["rows"][1]["seconds"]
        body["later"] = {"a": 1}
        body["rows"][0]["later"] = 3

    assert read_scores(changed(older)).summaries == scores.summaries


def test_words_of_a_table_are_made_printable_and_short(table):
    _, changed = table
    changed(_put("method", "name", "a\x1b[31m" + "x" * 1000))
    changed(_put("rows", 0, "notes", ["\x1b[2J\u202e"]))
    scores = read_scores(changed(_put("method", "settings", {"a": ["\x07"] * 2})))
    assert scores.method.name.isprintable() and len(scores.method.name) == 300
    assert scores.rows[0].notes[0].isprintable() and scores.method.settings == {"a": ["\\x07"] * 2}
