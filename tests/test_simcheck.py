"""The public checker's findings as rows: errors fail, what it did not finish is unknown, warnings are listed.

With a stand-in for it; what needs simcheck itself, an extra, is skipped without it. 8 s with it, else 1 s."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from little_asset import write_little

from export.check import checking
from export.check.report import Row
from export.check.simcheck_rules import run_simcheck


def stand_in(monkeypatch, results: list) -> list:
    """A module like simcheck's, that finds `results`; the configurations that it was given."""
    given = []
    core, config = ModuleType("simcheck.core"), ModuleType("simcheck.config")
    config.Thresholds = lambda **values: SimpleNamespace(**values)
    config.Config = lambda **values: SimpleNamespace(**values)
    core.check_file = lambda file, config: given.append(config) or SimpleNamespace(results=results)
    for module in (ModuleType("simcheck"), core, config):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    return given


def result(name: str, status: str, *findings, engine: str = "", note: str = "") -> SimpleNamespace:
    return SimpleNamespace(id=name, status=status, engine=engine, note=note, findings=findings)


def finding(message: str, **data) -> SimpleNamespace:
    return SimpleNamespace(message=message, data=data)


def test_errors_fail_what_was_not_finished_is_unknown_and_warnings_are_listed(monkeypatch):
    given = stand_in(
        monkeypatch,
        [
            result("a", "pass"),
            result("b", "warn", finding("thin")),
            result("c", "fail", finding("no mass"), finding("no shape")),
            result("d", "skip", engine="pybullet", note="not installed"),
            result("e", "warn", finding("did not finish", incomplete=True), engine="mujoco"),
        ],
    )
    assert list(run_simcheck(Path("a.urdf"), 100.0)) == [
        Row("simcheck.a", "simcheck", "pass", ""),
        Row("simcheck.b", "simcheck", "pass", "warn: thin"),
        Row("simcheck.c", "simcheck", "fail", "no mass; no shape"),
        Row("simcheck.d", "simcheck/pybullet", "skip", "not installed"),
        Row("simcheck.e", "simcheck/mujoco", "unknown", "warn: did not finish"),
    ]
    assert given[0].thresholds.engine_timeout == 80.0


def test_it_finds_no_error_in_a_sound_asset_and_one_in_a_broken_one(tmp_path):
    pytest.importorskip("simcheck", reason="simcheck is not installed: freeart21[simcheck]")
    urdf = write_little(tmp_path / "lid")
    rows = checking.check(urdf, [], simcheck=True).rows
    own_rows = [row for row in rows if row.rule.startswith("simcheck.")]
    assert len(own_rows) > 20 and not [row for row in own_rows if row.verdict == "fail"]
    urdf.write_text(urdf.read_text().replace('izz="', 'izz="-'))
    failed = [row.rule for row in checking.check(urdf, [], simcheck=True).failed]
    assert "simcheck.inertia.tensor" in failed
