"""Names that could be taken for others are refused; the same answer under two names is reported."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from refusal import assert_refused

from freeart21.files.result import Method
from leaderboard.method_names import check_name, check_names, looks_of
from leaderboard.rows import Row, Scores
from leaderboard.site.entrant import entrants
from leaderboard.site.index_page import describe_copies

TRUTH = Method("truth", "freeart21 0.2.0, reference row made from the truth")


@pytest.mark.parametrize(
    "name",
    [
        "truth",
        "Truth",
        "TRUTH ",
        "t-r-u-t-h",
        "\u0442ruth",
        "\uff54\uff52\uff55\uff54\uff48",
        "Ground Truth",
        "st@tic",
        "rand0m",
    ],
)
def test_reserved_names_and_their_look_alikes_are_refused(name):
    assert_refused("looks like", check_name, Method(name, "mine 1.0"), "here")


@pytest.mark.parametrize("name", ["ours", "truth-seeker", "v1", "方法", "", "???"])
def test_other_names_are_fine(name):
    check_name(Method(name, "mine 1.0"), "here")


def test_rows_made_from_the_truth_keep_their_name():
    check_names([("a", TRUTH), ("b", Method("ours"))])


def test_two_names_with_the_same_looks_are_refused_and_equal_names_are_not():
    check_names([("a", Method("ours")), ("b", Method("ours"))])  # two results of one method, parted by their folder
    check_names([("a", Method("v1")), ("b", Method("v2"))])
    for one, other in (("ours", "0urs"), ("ours", "Ours"), ("net", "n\u0435t")):
        assert_refused(f"looks like '{one}' of a", check_names, [("a", Method(one)), ("b", Method(other))])
    assert looks_of("A-b c") == "abc"


def test_the_same_files_under_two_names_are_reported():
    row = Row("s", "revolute", "ok", "", "files", False, 1.0, {}, {}, result_sha256="1" * 64)
    failed = dataclasses.replace(row, sequence="t", status="failed")
    other = dataclasses.replace(row, result_sha256="2" * 64)
    tables = [("one", (row, failed)), ("two", (row, failed)), ("three", (other, failed))]
    board = entrants([(Path(n), {"strict-2": Scores("strict-2", Method(n), {}, rows, ())}) for n, rows in tables])
    assert describe_copies(board) == ["one and two hold the same files for 1 of 1 sequences."]
