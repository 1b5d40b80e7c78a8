"""docs/scale.md has the measured rates, and an unreadable data folder is not started."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.results import RATED
from benchmarks.scale import LISTED_BYTES, LISTED_FILES, cost_table, hours, shards, terabytes
from freeart21.errors import FreeArtError
from generator.dataset import _listed_bytes, procedural_jobs, record_jobs
from generator.session import RecordSettings
from leaderboard.suite.rates import Rate, read_rates

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "scale.md").read_text()


def test_the_table_of_the_page_is_that_of_the_rates():
    for line in cost_table(read_rates(), 100_000, 300, 0.04, 0.02):
        assert line in TEXT.splitlines()


def test_the_sums_by_hand():
    rate = Rate(0.5, 1e5, "")
    assert hours(rate, 7200, 100) == 100 and terabytes(rate, 1000, 1000) == 0.1
    (line,) = [
        line for line in cost_table(dict.fromkeys(read_rates(), rate), 7200, 100, 2.0, 3.0) if "| export" in line
    ]
    assert line == "| export | 50.0 | 10.00 | 100 | 0.07 | 0.1 | 200 | 216 |"


def test_the_rates_of_reconstruct_are_those_of_the_benchmark():
    for kind, run in RATED.items():
        table = json.loads((ROOT / "benchmarks/results" / run.file).read_text())
        seconds = np.mean([row["seconds_total"] for row in table["rows"]]) / table["settings"]["frames"]
        assert read_rates()[kind].seconds_per_frame == pytest.approx(seconds, rel=0.01), (
            "python -m benchmarks.results --write"
        )


def test_a_list_that_would_be_too_long_to_read_is_refused_before_anything_is_made(tmp_path):
    jobs = procedural_jobs("Stapler", 500, 0, RecordSettings())
    with pytest.raises(FreeArtError, match=r"about 7\d MiB, at most 64 are read; record at most 4[0-4]\d of them here"):
        record_jobs(tmp_path / "data", jobs)
    assert not (tmp_path / "data").exists()
    most, folders = shards(100_000)
    assert (most, folders) == (429, 250) and f"**{most} sequences a folder**" in TEXT and f"{folders} folders" in TEXT
    assert _listed_bytes(jobs[0]) == pytest.approx(LISTED_BYTES, rel=0.03)
    assert f"{LISTED_FILES * 100_000 / 1e6:.0f} million files" in TEXT
