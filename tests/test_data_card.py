"""The card of a data folder: what others' readers make of it, and that it has nothing of a hidden truth."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from score_files import truths, write_data
from synthetic_case import QUERIES, make_recording

from freeart21.files.benchmark import write_benchmark
from freeart21.files.data_card import CARD_FILES, MARK, SequenceFacts, describe, write_card_of
from freeart21.files.sequence import write_sequence
from freeart21.files.truth import write_truth
from freeart21.files.verify import differing_files, listed_files
from leaderboard.pack import pack_public

yaml = pytest.importorskip("yaml")


def differing(data: Path) -> list[str]:
    return list(differing_files(data, listed_files(data)))


NASTY = 'x: "y" | <b>\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A data folder of three sequences with a card, one with a source and a licence of many characters."""
    data = write_data(tmp_path_factory.mktemp("card") / "data")
    truth = replace(truths()["a"], source={"object": "stapler", "category": NASTY, "seed": 7, "sensor": "tof"})
    shutil.rmtree(data / "sequences" / "a"), shutil.rmtree(data / "truth" / "a")
    write_sequence(data / "sequences" / "a", replace(make_recording(truth, "a"), licence="CC0-1.0"), 1e-4)
    write_truth(data / "truth" / "a", truth, QUERIES)
    write_benchmark(data, "made-up", "1", "test")
    write_card_of(data)
    return data


def header(folder: Path) -> dict:
    text = (folder / "README.md").read_text()
    assert text.startswith("---\n")
    return yaml.safe_load(text.split("---\n")[1])


def test_the_readme_has_the_hubs_header_and_every_count(folder):
    found = header(folder)
    assert found["license"] == "other" and found["pretty_name"] == "made-up" and found["size_categories"] == ["n<1K"]
    (config,) = found["configs"]
    assert config["data_files"] == [{"split": "test", "path": "sequences.jsonl"}]
    text = (folder / "README.md").read_text()
    assert "| sequences | 3 |" in text and "| frames | 48 |" in text and "| held-out views | 6 |" in text
    assert "prismatic (1), revolute (2)" in text and r"x: " in text and r"\| \<b\>" in text and MARK in text


def test_the_table_has_what_the_files_say(folder):
    rows = [json.loads(line) for line in (folder / "sequences.jsonl").read_text().splitlines()]
    assert [row["sequence"] for row in rows] == ["a", "b", "c"] and set(rows[0]) == set(SequenceFacts.__annotations__)
    assert rows[0]["seed"] == 7 and rows[0]["category"] == NASTY and rows[1]["seed"] is None
    assert (rows[0]["frames"], rows[0]["width"], rows[0]["height"], rows[0]["queries"]) == (16, 40, 32, 2)
    assert rows[0]["seconds"] == 0.5 and rows[0]["licence"] == "CC0-1.0" and rows[0]["hard"] is False
    assert len({row["sha256"] for row in rows}) == 3


def test_a_card_is_no_data_and_is_made_again(folder, tmp_path):
    data = Path(shutil.copytree(folder, tmp_path / "data"))
    assert differing(data) == [] and all((data / name).is_file() for name in CARD_FILES)
    before = {name: (data / name).read_bytes() for name in CARD_FILES}
    write_card_of(data)
    assert {name: (data / name).read_bytes() for name in CARD_FILES} == before
    (data / "README.md").write_text("my own words")
    write_card_of(data)
    assert (data / "README.md").read_text() == "my own words"
    (data / "more.md").write_text("")
    assert "more.md is not listed" in differing(data)[0]


def test_the_card_of_a_packed_set_has_nothing_of_its_truth(folder, tmp_path):
    pack_public(folder, tmp_path / "public", tmp_path / "key")
    assert differing(tmp_path / "public") == []
    text = "".join((tmp_path / "public" / name).read_text() for name in CARD_FILES)
    for word in ("stapler", "revolute", "tof", "Stapler", "hard (", "truth/SEQ"):
        assert word not in text
    rows = [json.loads(line) for line in (tmp_path / "public" / "sequences.jsonl").read_text().splitlines()]
    known = {"sequence", "frames", "seconds", "width", "height", "queries", "licence", "sha256"}
    assert all(row[key] is None for row in rows for key in set(row) - known) and all(
        len(row["sha256"]) == 64 for row in rows
    )
    write_card_of(tmp_path / "public")  # from the files alone it is the same
    assert "".join((tmp_path / "public" / name).read_text() for name in CARD_FILES) == text


def test_a_doi_is_in_header_text_and_croissant(folder):
    from freeart21.files.data_card import card_files

    files = card_files(describe(folder, doi="10.5281/zenodo.1"))
    assert b'doi: "10.5281/zenodo.1"' in files["README.md"] and b"| DOI | 10.5281/zenodo.1 |" in files["README.md"]
    assert json.loads(files["croissant.json"])["citeAs"] == "https://doi.org/10.5281/zenodo.1"
