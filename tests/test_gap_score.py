"""What verdicts are worth: the benchmark's figures on verdicts made by hand."""

import json
from pathlib import Path

import pytest

from benchmarks import gap_draws
from benchmarks import gap_score as score


def label(stratum: str, *names: str, sets: tuple[str, ...] = (), strength: str = "clear") -> dict:
    hidden = [{"name": n, "size": 1.0, "parameters": {"level": 2.0}} for n in names]
    return {
        "id": "a", "stratum": stratum, "strength": strength, "rig": "full", "kind": "revolute", "family": "door",
        "sets": list(sets), "effects": hidden, "ratio": 9.0, "distinct": 9.0,
    }  # fmt: skip


def verdict(kind: str, *names: str, rivals: tuple = (), after: float = 1.0, low: float = 1.5) -> dict:
    gap = [{"run": f"run_{i:02d}", "before": 10.0, "after": after, "floor": 1.0, "held_out": i > 7} for i in range(13)]
    said = [{"name": n, "parameters": {"level": {"value": 2.1, "low": low, "high": 2.5}}} for n in names]
    return {"verdict": kind, "effects": said, "rivals": [list(r) for r in rivals], "gap": gap}


def row(label: dict, verdict: dict) -> dict:
    return score.judged(label, verdict, {"verdict": 2.0})


def test_bounds_are_those_of_the_books():
    assert score.upper(0, 59) < 0.05 < score.upper(0, 58)  # 0 of 59 proves less than 5 %
    assert score.upper(0, 299) < 0.01 < score.upper(0, 298)
    assert score.upper(3, 3) == 1.0 and score.upper(0, 0) == 1.0
    assert score.clopper_pearson(0, 10)[1] == pytest.approx(0.3085, abs=1e-4)
    assert score.wilson(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)


def test_what_is_right_depends_on_what_was_hidden():
    two = ("armature", "actuator_gain")
    sets = ((two[0],), (two[1],))
    cases = [
        (label("null"), verdict("no_gap"), True),
        (label("null"), verdict("unexplained"), False),
        (label("single", "detent"), verdict("named", "detent"), True),
        (label("single", "detent"), verdict("named", "detent", "latch"), False),
        (label("single", "detent"), verdict("ambiguous", "detent"), False),
        (label("pair", "latch", "detent"), verdict("named", "detent", "latch"), True),
        (label("strange", "cogging"), verdict("unexplained"), True),
        (label("strange", "cogging"), verdict("named", "detent"), False),
        (label("strange", "cogging"), verdict("crashed"), False),
        (label("gauge", two[1], sets=two), verdict("ambiguous", two[0], rivals=sets), True),
        (label("gauge", two[1], sets=two), verdict("ambiguous", two[0], rivals=sets[:1]), False),
        (label("gauge", two[1], sets=two), verdict("named", two[1]), False),
        (label("still"), verdict("not_excited"), True),
        (label("still"), verdict("no_gap"), False),
    ]
    for hidden, said, right in cases:
        assert row(hidden, said)["right"] == right, (hidden["stratum"], said["verdict"])
    assert row(label("strange", "cogging"), verdict("named", "detent"))["false_name"]
    assert not row(label("single", "detent"), verdict("named", "detent"))["false_name"]


def test_the_closed_part_is_that_beyond_the_floor():
    assert score.closed(verdict("named", "detent", after=1.0), score.SAME) == (1.0, False)
    assert score.closed(verdict("named", "detent", after=5.5), score.OTHER) == (0.5, False)
    wider = verdict("named", "detent", after=10.3)
    assert score.closed({**wider, "added": ["detent"]}, score.SAME)[1]
    assert not score.closed({**wider, "added": []}, score.SAME)[1]  # nothing was written, so nothing hurts
    assert score.closed({"verdict": "crashed"}, score.SAME) == (None, False)


def test_the_summary_counts_every_case_and_drops_none():
    rows = [
        *[row(label("null"), verdict("no_gap"))] * 9,
        row(label("null"), verdict("named", "latch")),
        row(label("single", "detent"), verdict("named", "detent")),
        row(label("single", "latch"), verdict("unexplained", after=10.0)),
        row(label("single", "latch", strength="weak"), verdict("no_gap", after=10.0)),
        row(label("strange", "cogging"), verdict("named", "detent")),
        row(label("pair", "latch", "detent"), verdict("named", "detent", "latch", low=2.2)),
        row(label("gauge", "armature", sets=("armature", "actuator_gain")), verdict("named", "armature")),
    ]
    found = score.summary(rows, [{"refused": True}, {"refused": False}])
    assert (found["nulls"], found["false_alarms"], found["false_names_on_nulls"]) == (10, 1, 1)
    assert found["false_alarm_upper95"] == pytest.approx(0.394, abs=1e-3)
    assert (found["clear_singles_top1"], found["weak_singles_top1"], found["pairs_exact"]) == (0.5, 0.0, 1.0)
    assert (found["out_of_library_false_names"], found["ambiguous_answered"]) == (1.0, 0.0)
    assert found["leave_one_out_refused"] == 0.5
    assert found["closed_fraction_median"] == 1.0 and found["repairs_that_hurt"] == 0
    assert found["interval_coverage"] == {"k": 1, "n": 3, "nominal": 0.9}
    assert score.smallest_nameable(rows)["detent"]["floors"] == 9.0
    assert score.smallest_nameable(rows)["latch"]["floors"] is None


def test_the_confusion_matrix_is_drawn(tmp_path: Path):
    rows = [row(label("null"), verdict("no_gap")), row(label("single", "latch"), verdict("named", "detent"))]
    truths, answers, counts = score.confusion(rows)
    assert truths == ["latch", "nothing"] and counts.sum() == 2 and counts[0][answers.index("detent")] == 1
    score.picture(rows, tmp_path / "confusion.png")
    assert (tmp_path / "confusion.png").stat().st_size > 500


def drawn(seed: int, right: int, n: int = 10, commit: str = "abc") -> dict:
    """A draw as the benchmark writes it: `n` clear springs of which `right` are named, and a null."""
    cases = [label("single", "return_spring") for _ in range(n)]
    rows = [row(c, verdict("named", "return_spring" if k < right else "sag")) for k, c in enumerate(cases)]
    rows.append(row(label("null"), verdict("no_gap")))
    settings = {"seed": seed, "share": 1.0}
    return {
        "summary": {**score.summary(rows, []), "minutes": 1.0},
        "rows": rows,
        "commit": commit,
        "settings": settings,
    }


def test_draws_add_up_to_one_table_and_none_counts_twice(tmp_path: Path):
    file = tmp_path / "draws.json"
    for draw in (drawn(1, 4), drawn(2, 9), drawn(1, 5), drawn(2, 9, commit="def")):
        gap_draws.append(draw, file)
    table = json.loads(file.read_text())
    assert [(r["seed"], r["commit"], r["counts"]["clear_singles_top1"]) for r in table["rows"]] == [
        (2, "abc", [9, 10]), (1, "abc", [5, 10]), (2, "def", [9, 10])
    ]  # fmt: skip
    together = table["summary"]
    assert (together["draws"], together["nulls"], together["false_alarms"]) == (3, 3, 0)
    singles = together["clear_singles_top1"]
    assert (singles["k"], singles["n"], singles["share"]) == (23, 30, pytest.approx(23 / 30))
    assert singles["wilson95"] == pytest.approx(score.wilson(23, 30))
    assert together["clear_by_effect"]["return_spring"]["k"] == 23


def test_the_newest_draw_is_the_last_row_of_the_table():
    newest = json.loads((gap_draws.RESULTS / "simgap.json").read_text())
    table = json.loads(gap_draws.DRAWS.read_text())
    assert table["rows"][-1] == gap_draws.row_of(newest)
    assert table["summary"] == gap_draws.pooled(table["rows"])
