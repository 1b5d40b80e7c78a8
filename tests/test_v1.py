"""freeart21-v1 is what it was when it was frozen."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from freeart21 import catalog
from freeart21.errors import FreeArtError
from freeart21.files.benchmark import write_benchmark
from generator import v1
from generator.dataset import Job, Label
from generator.session import RecordSettings

EVERY = [*v1.entries("public"), *v1.entries("test")]


def test_both_splits_have_the_same_objects_and_every_category_every_style() -> None:
    for split in ("public", "test"):
        entries = v1.entries(split)
        assert {e.object for e in entries} <= set(catalog.built_in_names()) and len(entries) == 21
        assert set(Counter((catalog.find(e.object).category, e.motion) for e in entries).values()) == {1}
    assert [e.object for e in v1.entries("public")] == [e.object for e in v1.entries("test")]
    styles = [[e.motion for e in v1.entries(split)] for split in ("public", "test")]
    assert all(a != b for a, b in zip(*styles, strict=True))
    assert len({e.sequence for e in EVERY}) == 42


def test_jobs_take_seed_and_motion_from_the_table_and_the_rest_from_the_settings() -> None:
    jobs = v1.jobs("test", RecordSettings(sensor="tof", seed=5, motion="release"))
    assert {job.settings.sensor for job in jobs} == {"tof"} and {job.settings.seed for job in jobs} == {42}
    assert [job.settings.motion for job in jobs] == [e.motion for e in v1.entries("test")]
    assert v1.label("test", RecordSettings(seed=9)) == Label("freeart21-v1", "1", "test")
    assert v1.label("test", RecordSettings(frames=200)) == Label("freeart21-v1-changed", "1", "test")


def test_no_other_sequences_bear_the_benchmarks_name(tmp_path: Path) -> None:
    own, other = v1.jobs("public"), [Job("stapler", "stapler-s5", RecordSettings())]
    label = v1.label("public", RecordSettings())
    data = tmp_path / "data"
    v1.check_own_sequences(data, own, label)
    v1.check_own_sequences(data, other, None)
    with pytest.raises(FreeArtError, match="is freeart21-v1, which has sequences of its own only"):
        v1.check_own_sequences(tmp_path / "freeart21-v1", other, None)
    (data / "sequences" / "stapler-v1").mkdir(parents=True)
    (data / "sequences" / "stapler-v1" / "sequence.json").write_text("{}")
    write_benchmark(data, v1.NAME, v1.VERSION, "public")
    v1.check_own_sequences(data, own, label)
    with pytest.raises(FreeArtError, match="is freeart21-v1, which has sequences of its own only"):
        v1.check_own_sequences(data, other, None)
    with pytest.raises(FreeArtError, match="holds stapler-v1, which is not of freeart21-v1 test"):
        v1.check_own_sequences(data, v1.jobs("test"), v1.label("test", RecordSettings()))


@pytest.mark.parametrize("entry", EVERY, ids=lambda e: e.sequence)
def test_shapes_are_those_that_were_frozen(entry: v1.Entry) -> None:
    assert v1.read_frozen()[entry.sequence]["shape"] == v1.shape_fingerprint(entry), (
        "a change of v1 takes a new version"
    )


@pytest.mark.parametrize("entry", v1.entries("public")[3:6], ids=lambda e: e.motion)
def test_motions_are_those_that_were_frozen(entry: v1.Entry) -> None:
    assert v1.read_frozen()[entry.sequence]["motion"] == v1.motion_fingerprint(entry), (
        "a change of v1 takes a new version"
    )


def test_another_seed_or_motion_has_another_fingerprint() -> None:
    entry = v1.entries("public")[4]
    assert v1.shape_fingerprint(entry) != v1.shape_fingerprint(replace(entry, seed=entry.seed + 1))
    assert v1.motion_fingerprint(entry) != v1.motion_fingerprint(replace(entry, motion="turntable"))
