"""Methods side by side: closed forms, intervals that hold as often as they say, and nothing mixed that must not be."""

import io
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from refusal import assert_refused
from rich.console import Console

from freeart21.files.atomic import write_json
from freeart21.files.benchmark import read_benchmark
from freeart21.files.result import Method
from leaderboard import commands, compare
from leaderboard.bootstrap import bootstrap_intervals
from leaderboard.compare import compare_results, read_category
from leaderboard.compare_tables import (
    COMPARISONS,
    latex,
    legend,
    make_grids,
    print_comparison,
    split_columns,
    write_comparison,
)
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row, Scores
from leaderboard.score import benchmark_facts, summarise
from leaderboard.scores_file import write_scores

REVOLUTE = tuple(f"r{k:02d}" for k in range(15))
PRISMATIC = tuple(f"p{k:02d}" for k in range(6))
CATEGORIES = {name: ("Stapler", "USB", "Scissors")[k % 3] for k, name in enumerate(REVOLUTE)}
CATEGORIES |= dict.fromkeys(PRISMATIC, "Phone")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A benchmark of the paper's make, of 15 revolute and 6 prismatic sequences: names, and what truth.json says."""
    folder = tmp_path_factory.mktemp("data")
    for name in (*REVOLUTE, *PRISMATIC):
        source = {"category": CATEGORIES[name]}
        write_json(folder / "truth" / name / "truth.json", {"schema": "freeart21/truth/1", "source": source})
    names = sorted((*REVOLUTE, *PRISMATIC))
    facts = {"name": "paper-like", "version": "1", "split": "none", "sequences": names, "sha256": {}}
    write_json(folder / "benchmark.json", {"schema": "freeart21/benchmark/1", **facts})
    return folder


def make_scores(data, name, numbers=None, protocol="strict-2", lacks=(), failed=(), sequences=None):
    """A table in which every number is 1 but for those of `numbers`, metric to sequence to value (or to one value)."""
    rules, rows = protocol_named(protocol), []
    for sequence in sequences or sorted((*REVOLUTE, *PRISMATIC)):
        kind = "revolute" if sequence in REVOLUTE else "prismatic"
        values = {}
        for metric in rules.metrics:
            given = (numbers or {}).get(metric.id, 1.0)
            value = given.get(sequence, 1.0) if isinstance(given, dict) else given
            values[metric.id] = None if metric.unit(kind) is None else value
        ok = sequence not in failed
        answered = ("ok", "", "files") if ok else ("failed", "too dark", "nothing")
        rows.append(Row(sequence, kind, answered[0], answered[1], answered[2], False, 0.5, values, {}))
    facts = benchmark_facts(read_benchmark(data))
    made_with = {"freeart21": "1", "libraries": {"numpy": "2"}}
    method = Method(name, lacks=lacks)
    return Scores(protocol, method, facts, tuple(rows), summarise(rows, rules), made_with=made_with)


@pytest.fixture
def compared(data, tmp_path):
    """The comparison of tables, each written to a file and read again."""

    def compared(*tables, protocol=None):
        paths = []
        for k, table in enumerate(tables):
            paths.append(tmp_path / f"{k}.json")
            write_scores(paths[-1], table)
        return compare_results(paths, data, protocol)

    return compared


def lines_of(comparison, method):
    """Group to the row of the method."""
    table = comparison.table("type")
    return {line.group: line for _, line in table[table.method == method].iterrows()}


# ---- closed forms


def test_means_and_deviations_are_those_of_the_papers_table(data, compared):
    """Articulate-Anything: 7 of 15 revolute and 3 of 6 prismatic objects at 90 degrees, the others at 0."""
    axis = {name: 90.0 * (k < 7) for k, name in enumerate(REVOLUTE)}
    axis |= {name: 90.0 * (k < 3) for k, name in enumerate(PRISMATIC)}
    right = {name: float(value == 0) for name, value in axis.items()}
    comparison = compared(make_scores(data, "AA", {"axis": axis, "joint_type": right}, failed=REVOLUTE[:2]))
    lines = lines_of(comparison, "AA")
    assert list(lines) == ["revolute", "prismatic", "all"]
    revolute, prismatic, every = lines.values()
    found = revolute.axis, revolute.axis_std, revolute.axis_median, revolute.axis_worst
    assert np.round(found, 2).tolist() == [42.00, 46.48, 0, 90]
    assert (round(prismatic.axis, 2), round(prismatic.axis_std, 2)) == (45.00, 49.30)
    assert revolute.coverage == pytest.approx(13 / 15) and every.coverage == pytest.approx(19 / 21)
    assert revolute.joint_type == pytest.approx(8 / 15)
    first = make_grids(comparison, "type")[0]
    (name, (row,)) = first.sections[0]
    assert name == "revolute, 15 sequences" and [cell.text for cell in row[:4]] == [
        "AA",
        "13/15",
        "53%",
        "42.00 ± 46.48",
    ]
    assert first.sections[1][1][0][3].text == "45.00 ± 49.30"


# ---- differences


def test_a_difference_that_is_known_by_construction(data, compared):
    """B is A and exactly 2 more everywhere: the interval is that point, whatever A's own spread."""
    rng = np.random.default_rng(0)
    axis = dict(zip((*REVOLUTE, *PRISMATIC), rng.exponential(20, 21), strict=True))
    comparison = compared(
        make_scores(data, "A", {"axis": axis}), make_scores(data, "B", {"axis": {k: v + 2 for k, v in axis.items()}})
    )
    for line in lines_of(comparison, "B").values():
        assert (line.axis_difference, line.axis_low, line.axis_high) == pytest.approx((2, 2, 2))
        assert line.axis_verdict == "worse" and line.axis_sequences == line.sequences


@pytest.mark.parametrize("metric, better", [("axis", -1.0), ("miou", 0.1), ("psnr", 1.0), ("chamfer_w", -1.0)])
def test_better_is_what_the_metric_calls_better(metric, better, data, compared):
    first = {name: 0.5 for name in (*REVOLUTE, *PRISMATIC)}
    for step, verdict in ((better, "better"), (-better, "worse"), (0.0, "open")):
        then = {name: value + step for name, value in first.items()}
        comparison = compared(make_scores(data, "A", {metric: first}), make_scores(data, "B", {metric: then}))
        found = lines_of(comparison, "B")["all"]
        assert found[f"{metric}_verdict"] == verdict and found[f"{metric}_difference"] == pytest.approx(step)
        assert found.ssim_verdict == "open"


def test_an_interval_of_two_values_is_that_of_the_binomial_distribution():
    """Of n differences half 0 and half 1, a resample's mean is binomial: the ends are its quantiles."""
    from scipy.stats import binom, norm, t

    n, level = 20, 0.9
    (found,) = bootstrap_intervals(np.repeat([0.0, 1.0], n // 2)[:, None], level, 200_000)
    tail = norm.cdf(-np.sqrt(n / (n - 1)) * t.ppf((1 + level) / 2, n - 1))
    assert found.mean == 0.5
    assert found.low == binom.ppf(tail, n, 0.5) / n and found.high == binom.ppf(1 - tail, n, 0.5) / n


@pytest.mark.parametrize("n", [6, 15, 21])
def test_an_interval_of_90_percent_holds_the_true_difference_that_often(n):
    draws = np.random.default_rng(n).normal(0.3, 2.0, (n, 400))
    held = [one.low <= 0.3 <= one.high for one in bootstrap_intervals(draws, 0.9, 4000)]
    assert 0.85 <= np.mean(held) <= 0.95


def test_methods_are_compared_only_on_sequences_that_both_have(data, compared):
    """B lacks three sequences on which A is bad: there A is not charged for them in the difference."""
    axis = {name: 50.0 if name in REVOLUTE[:3] else 1.0 for name in REVOLUTE}
    some = [*REVOLUTE[3:], *PRISMATIC]
    comparison = compared(make_scores(data, "A", {"axis": axis}), make_scores(data, "B", {"axis": 2.0}, sequences=some))
    found = lines_of(comparison, "B")["revolute"]
    assert (found.axis_difference, found.axis_low, found.axis_high, found.axis_sequences) == (1, 1, 1, 12)
    assert lines_of(comparison, "A")["revolute"].axis == pytest.approx(10.8)
    assert any("has rows for 18 of 21 sequences" in note for note in comparison.notes)


def test_what_a_method_does_not_make_is_a_dash_and_in_no_difference(data, compared):
    nothing = dict.fromkeys(("pose_rotation", "pose_translation", "state"))
    comparison = compared(make_scores(data, "A"), make_scores(data, "B", nothing, lacks=("poses", "states")))
    first = make_grids(comparison, "type")[0]
    column = [" ".join(head.split()) for head in first.head].index("ref. part deg ↓")
    texts = [[row[column].text for row in rows] for _, rows in first.sections]
    assert texts == [["1.00 ± 0.00", "–"]] * 3  # noqa: RUF001
    found = lines_of(comparison, "B")["all"]
    assert found.axis_verdict == "open" and all(pd.isna(found.get(f"{id}_difference", None)) for id in nothing)
    assert any("B makes no states, poses" in line for line in legend(comparison, "type"))
    assert not any(row[column].best for _, rows in first.sections for row in rows), "nobody is best of one"


# ---- groups


def test_categories_are_what_the_truth_says_and_never_guessed(tmp_path):
    def category_in(source):
        write_json(tmp_path / "truth.json", {"schema": "freeart21/truth/1", "source": source})
        return read_category(tmp_path)

    assert category_in({"category": "Stapler"}) == "Stapler"
    assert category_in({"object": "mini_stapler"}) == "Stapler" and category_in({"object": "4552"}) == "Display"
    for source in ({"object": "my_stapler"}, {}, None, {"category": 3}):
        assert category_in(source) == "unknown"
    assert read_category(tmp_path / "none") == "unknown"
    assert category_in({"category": "a\x1b[2J\nb"}).isprintable()


# ---- tables that cannot be compared


def _row_of(scores, **changes):
    return replace(scores, rows=(replace(scores.rows[0], **changes), *scores.rows[1:]))


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda b: replace(b, benchmark={**b.benchmark, "name": "other", "sha256": "0" * 64}), "is scored on other 1"),
        (lambda b: _row_of(b, sequence="x"), "has a row for x, which is not a sequence of"),
        (lambda b: replace(b, made_with={"freeart21": "2"}), "is scored by freeart21 2, .* by 1: score it again"),
    ],
)
def test_tables_that_cannot_be_compared(change, message, data, compared):
    assert_refused(message, compared, make_scores(data, "A"), change(make_scores(data, "B")))


def test_protocols_truths_and_libraries_are_never_mixed(data, compared, tmp_path):
    table, other = make_scores(data, "B"), make_scores(data, "B", protocol="strict-1")
    assert_refused(r"1\.json is scored by strict-1, expected strict-2: .* protocols", compared, table, other)
    assert_refused("scored by strict-2, expected strict-1", compared, table, protocol="strict-1")
    assert compared(other).rules.name == "strict-1", "that of the tables"
    truths = [_row_of(table, truth_sha256=digit * 64) for digit in "12"]
    assert_refused("against another truth of p00", compared, *truths)
    newer = replace(table, made_with={**table.made_with, "libraries": {"numpy": "3"}})
    assert "other versions of libraries" in compared(make_scores(data, "A"), newer).notes[0]
    assert_refused("nothing to compare", compare_results, [], data)
    twice = [tmp_path / "0.json", tmp_path / ".." / tmp_path.name / "0.json"]
    assert_refused("is named twice", compare_results, twice, data)
    assert_refused("is not a folder of results", compare_results, [tmp_path / "none"], data)


def test_results_folders_are_scored_and_kept(data, tmp_path, monkeypatch):
    calls = []

    def score_again(place, data, protocol, keep, progress, truth):
        calls.append((place.name, protocol, keep))
        return make_scores(data, place.name)

    monkeypatch.setattr(compare, "cached_scores", score_again)
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "method.json").write_text("{}")
    comparison = compare_results([tmp_path / "one", tmp_path / "two"], data, None, tmp_path / "keep")
    assert calls == [(name, "strict-3", tmp_path / "keep") for name in ("one", "two")]
    assert [entrant.name for entrant in comparison.entrants] == ["one", "two"]
    shutil.make_archive(str(tmp_path / "three"), "zip", tmp_path, "one")
    assert compare_results([tmp_path / "three.zip"], data).entrants[0].name == "one"


def test_methods_of_one_name_are_distinguished(data, compared):
    comparison = compared(*(make_scores(data, name) for name in ("A", "B", "A", "A (0.json)")))
    names = [entrant.name for entrant in comparison.entrants]
    assert len(set(names)) == 4 and names[1] == "B" and names[2] == "A (2.json)"


# ---- files and screens

NASTY = r"50% | a_b & <c> *d* #1 \emph{x} ~^ [y]"


@pytest.mark.parametrize("suffix", COMPARISONS)
@pytest.mark.parametrize("by", ["type", "category", "sequence"])
def test_every_format_is_written_replaced_and_the_same_every_time(by, suffix, data, compared, tmp_path):
    comparison = compared(make_scores(data, "A"), make_scores(data, "B", {"axis": 3.0}))
    path = tmp_path / f"out{suffix}"
    write_comparison(path, comparison, by)
    first = path.read_bytes()
    write_comparison(path, comparison, by)
    assert path.read_bytes() == first and b"A" in first
    (tmp_path / f"mine{suffix}").write_text("mine")
    assert_refused("is no older", write_comparison, tmp_path / f"mine{suffix}", comparison, by)


def test_csv_has_every_number_and_no_formula(data, compared, tmp_path):
    axis = {name: float(k) for k, name in enumerate(REVOLUTE)}
    comparison = compared(make_scores(data, "A"), make_scores(data, "=1+1", {"axis": axis}))
    write_comparison(tmp_path / "t.csv", comparison, "type")
    table = pd.read_csv(tmp_path / "t.csv").set_index(["group", "method"])
    row = table.loc["revolute", "'=1+1"]
    assert (row.axis, row.axis_median, row.axis_worst, row.axis_sequences) == (7, 7, 14, 15)
    assert row.axis_std == pytest.approx(np.std(list(axis.values()), ddof=1))
    assert row.axis_difference == 6 and row.axis_low < 6 < row.axis_high
    assert np.isnan(table.loc["revolute", "A"].axis_difference) and np.isnan(table.loc["all", "A"].state)
    assert set(table.protocol) == {"strict-2"} and set(table.by) == {"type"}
    write_comparison(tmp_path / "s.csv", comparison, "sequence")
    assert len(pd.read_csv(tmp_path / "s.csv")) == 42


def test_json_has_everything_and_traces_it(data, compared, tmp_path):
    comparison = compared(make_scores(data, "A"), make_scores(data, "B", {"axis": 3.0}), make_scores(data, "C"))
    write_comparison(tmp_path / "c.json", comparison, "type")
    body = json.loads((tmp_path / "c.json").read_text())
    assert body["benchmark"]["sha256"] == benchmark_facts(read_benchmark(data))["sha256"]
    assert [one["made_with"]["freeart21"] for one in body["methods"]] == ["1"] * 3
    found = {(one["group"], one["method"]): one for one in body["by_type"]}["all", "C"]
    assert found["axis_difference"] == 0 and found["axis_verdict"] == "open"
    assert {one["group"] for one in body["by_category"]} == {*CATEGORIES.values()}
    rows = [row for row in body["sequences"] if row["method"] == "B"]
    assert rows[0]["axis"] == 3 and len(rows) == 21 and rows[0]["state"] == 1
    assert body["interval"]["level"] == 0.95 and body["interval"]["resamples"] == 10_000


def test_latex_is_balanced_and_shows_words_as_they_are(data, compared):
    text = latex(compared(make_scores(data, "A", {"axis": 0.5}), make_scores(data, NASTY + " 漢")), "type")
    assert r"50\% \textbar{} a\_b \& \textless{}c\textgreater{} *d* \#1 \textbackslash{}emph\{x\}" in text
    assert r"1.00 $\pm$ 0.00" in text and "±" not in text and "–" not in text  # noqa: RUF001
    assert r"$-$0.50" in latex(compared(make_scores(data, "A"), make_scores(data, "B", {"axis": 0.5})), "type")
    bare = re.sub(r"\\.", "", "\n".join(line for line in text.splitlines() if not line.startswith("%")))
    assert bare.count("{") == bare.count("}") and bare.count("$") % 2 == 0 and bare.isascii()
    assert "%" not in bare.replace("{%\n", "") and "#" not in bare and "_" not in bare
    for table in re.findall(r"\\begin{tabular}{(\w+)}(.*?)\\end{tabular}", text, re.S):
        columns, body = len(table[0]), table[1]
        lines = [line for line in body.splitlines() if line.endswith(r"\\") and "multicolumn" not in line]
        assert len(lines) > 5 and {len(re.findall(r"(?<!\\)&", line)) for line in lines} == {columns - 1}
        assert body.count("toprule") == body.count("bottomrule") == 1
    assert text.count(r"\begin{table}") == text.count(r"\end{table}") == 3


@pytest.mark.parametrize("by", ["type", "category", "sequence"])
def test_ten_methods_fit_a_screen_of_100_columns(by, data, compared):
    names = ["a-method-of-a-very-long-name-indeed-yes", *"BCDEFGHIJ"]
    comparison = compared(*(make_scores(data, name, {"axis": 88.88, "psnr": 100.0}) for name in names))
    console = Console(width=100, file=io.StringIO(), color_system=None)
    print_comparison(comparison, by, console)
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= 100
    text = "\n".join(lines)
    assert "88.88" in text and "a-method-of-a-very-lo…" in text and all(f"  {name} " in text for name in "BCDEFGHIJ")
    for grid in make_grids(comparison, by):
        shown = [column.header for piece in split_columns(grid, console) for column in piece.columns[1:]]
        assert shown == list(grid.head[1:]), "every column, once"


def test_the_command_prints_and_writes(data, tmp_path, capsys):
    write_scores(tmp_path / "a.json", make_scores(data, "A"))
    write_scores(tmp_path / "b.json", make_scores(data, "B", {"axis": 3.0}))
    commands.compare((tmp_path / "a.json", tmp_path / "b.json"), data, out=tmp_path / "c.csv")
    printed = capsys.readouterr().out
    assert "B less A" in printed and "+2.00° [2.00, 2.00] ✗" in printed
    assert (tmp_path / "c.csv").is_file()
    assert_refused("is no older comparison", commands.compare, (tmp_path / "a.json",), data, out=tmp_path / "a.json")
