"""Answers on real recordings are graded by physics; what is known of each speaks of effects that there are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks import real_gap, real_recordings
from benchmarks.real_grade import grade_answer
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured

KNOWN = json.loads(real_gap.EXPECTED.read_text())
GROUPS = {"dry": ["coulomb_friction", "load_friction"]}
PENDULUM: dict[str, Any] = {
    "answer": "named",
    "dominant": ["dry", "quadratic_drag"],
    "also": ["encoder_offset"],
    "never": {"detent": "nothing holds"},
    "sizes": {"coulomb_friction.level": [1.0, 2.0], "encoder_offset.offset": [-0.1, 0.1]},
}


def make_answer(verdict: str, *effects: str, rivals=(), size: float = 1.5, left: float = 1.5) -> Any:
    first = {"coulomb_friction": "level", "encoder_offset": "offset"}
    return {
        "verdict": verdict,
        "sentence": "",
        "effects": [{"name": n, "parameters": {first.get(n, "x"): {"value": size}}} for n in effects],
        "rivals": [list(names) for names in rivals],
        "gap": [
            {"before": 0.2, "after": 0.2, "floor": 0.001, "held_out": False},
            {"before": 0.2, "after": 0.001 * left, "floor": 0.001, "held_out": True},
        ],
    }


BOTH = ("coulomb_friction", "quadratic_drag")
GRADED = {
    "all that dominates": (make_answer("named", *BOTH), "right"),
    "the same by another name": (make_answer("named", "load_friction", "quadratic_drag"), "right"),
    "part of it": (make_answer("named_in_part", "quadratic_drag"), "in part"),
    "a size that is off": (make_answer("named", *BOTH, size=3.0), "in part"),
    "an effect that may be there, far too large": (make_answer("named", *BOTH, "encoder_offset", size=1.5), "wrong"),
    "one that nobody knows of": (make_answer("named", *BOTH, "wobble"), "in part"),
    "one that is not there": (make_answer("named", *BOTH, "detent"), "wrong"),
    "nothing that dominates": (make_answer("named", "viscous_damping"), "wrong"),
    "nothing missing": (make_answer("no_gap"), "wrong"),
    "no explanation": (make_answer("unexplained"), "silent"),
    "no answer": (None, "silent"),
    "two names of one thing": (make_answer("ambiguous", rivals=(BOTH, ("load_friction", "quadratic_drag"))), "right"),
    "a doubt with a sure member": (make_answer("ambiguous", rivals=(BOTH, ("coulomb_friction",))), "in part"),
    "a doubt with a stranger": (make_answer("ambiguous", rivals=(BOTH, ("viscous_damping",))), "silent"),
    "a doubt among strangers": (make_answer("ambiguous", rivals=(("detent",), ("viscous_damping",))), "wrong"),
    "a large claim that hides what is left": (make_answer("named", *BOTH, left=10.5), "in part"),
    "the same, given": (make_answer("named_in_part", *BOTH, left=10.5), "right"),
}


@pytest.mark.parametrize("name", GRADED)
def test_answers_are_graded_by_physics(name: str):
    answer, expected = GRADED[name]
    grade, reasons = grade_answer(PENDULUM, GROUPS, answer)
    assert grade == expected, reasons
    assert reasons or grade == "right"


@pytest.mark.skipif(not real_recordings.recordings(), reason="recordings of others are not at hand")
def test_what_is_at_hand_is_known_and_becomes_sets(tmp_path: Path):
    here = real_recordings.recordings()
    assert set(here) <= set(KNOWN["recordings"])
    for name in sorted(set(here) & {"dfki", "bam_free", "directdrive_breakaway", "phy180_whole"}):
        (tmp_path / name).mkdir()
        here[name](tmp_path / name)
        measured = read_measured(tmp_path / name / "measured")
        assert read_asset(tmp_path / name / "asset.urdf").joint == measured.joint


@pytest.mark.parametrize("ways", ["sleep 60 & wait", "while :; do :; done"])
def test_an_answer_that_does_not_come_in_time_is_none_and_is_not_asked_again(ways, tmp_path: Path, monkeypatch, capsys):
    """By the processor's time or the clock; killed with all that it started; the row is kept."""
    calls: list[str] = []

    def write_recording(out: Path) -> None:
        calls.append("made")
        (out / "asset.urdf").write_text("<robot/>")

    monkeypatch.setattr(real_gap, "recordings", lambda: {"dfki": write_recording})
    monkeypatch.setattr(real_gap, "sys", type("sys", (), {"executable": "/bin/sh"}))
    monkeypatch.setattr(real_gap, "_COMMAND", ("-c", ways))
    for _ in range(2):
        real_gap.main(0.2, ("dfki",), tmp_path / "work", tmp_path / "told.json")
    document = json.loads((tmp_path / "told.json").read_text())
    assert (
        calls == ["made"]
        and document["rows"][0]["status"] == "out of time"
        and document["rows"][0]["grade"] == "silent"
    )
    assert "1 of 1: dfki: silent" in capsys.readouterr().out
