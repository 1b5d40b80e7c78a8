"""The report of a check: a row for every rule and place where it was judged."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import freeart21
from export.check.rules import RULES

SCHEMA = "freeart21/check/1"
Verdict = Literal["pass", "fail", "unknown", "skip"]
"""'unknown': judging took longer than allowed. 'skip': not applicable, or not judgeable."""


@dataclass(frozen=True)
class Row:
    """One verdict."""

    rule: str
    """Stable id, a key of `rules.RULES`; rules of simcheck are `simcheck.` and its own id."""
    engine: str
    """'file' for rules on files, else the engine or checker."""
    verdict: Verdict
    reason: str = ""
    """What is wrong, why it was skipped, or what was measured."""
    value: float | None = None
    """The number that was compared with the rule's limit, in `unit`."""
    unit: str = ""


@dataclass(frozen=True)
class CheckReport:
    """All rows of one asset."""

    path: str
    """As given by the user."""
    rows: tuple[Row, ...]
    engines: dict[str, str] = field(default_factory=dict)
    """Engine to version, or why it was not used."""
    settings: dict[str, str] = field(default_factory=dict)
    """Engine to its time step and contact settings."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Engine to wall time, with its start."""
    notes: tuple[str, ...] = ()
    """Changes made to the asset before it was judged."""

    @property
    def failed(self) -> tuple[Row, ...]:
        """The rows that fail."""
        return tuple(row for row in self.rows if row.verdict == "fail")

    @property
    def not_passed(self) -> tuple[Row, ...]:
        """The rows that fail or were not judged in time."""
        return tuple(row for row in self.rows if row.verdict in ("fail", "unknown"))

    @property
    def verdict(self) -> Verdict:
        """'fail' when a row fails, else 'unknown' when one was not judged in time or none was judged, else 'pass'."""
        verdicts = {row.verdict for row in self.rows}
        return next((v for v in ("fail", "unknown", "pass") if v in verdicts), "unknown")

    def to_json(self) -> dict[str, Any]:
        """The report for a file, with the texts of its rules."""
        named = {row.rule: asdict(RULES[row.rule]) for row in self.rows if row.rule in RULES}
        return {
            "schema": SCHEMA,
            "path": self.path,
            "checked_by": f"freeart21 {freeart21.__version__}",
            "passed": self.verdict == "pass",
            "verdict": self.verdict,
            "rows": [asdict(row) for row in self.rows],
            "rules": named,
            "engines": self.engines,
            "settings": self.settings,
            "seconds": self.seconds,
            "notes": list(self.notes),
        }


def print_report(report: CheckReport) -> None:
    """Print a table of rules by engine, then a line for every failure and group of skips."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    own = [row for row in report.rows if not row.rule.startswith("simcheck.")]
    engines = [e for e in dict.fromkeys(row.engine for row in own) if report.engines.get(e) != "not installed"]
    marks = {"pass": "[green]pass[/]", "fail": "[bold red]fail[/]", "skip": "[dim]skip[/]"}
    marks["unknown"] = "[yellow]unknown[/]"
    worst: dict[tuple[str, str], Verdict] = {}
    order: tuple[Verdict, ...] = ("skip", "pass", "unknown", "fail")
    for row in report.rows:
        key = (row.rule, row.engine)
        worst[key] = max(worst.get(key, "skip"), row.verdict, key=order.index)
    table = Table("rule", *engines, title=escape(f"check-asset {Path(report.path).name}"))
    for rule in dict.fromkeys(row.rule for row in own):
        table.add_row(rule, *(marks[worst[rule, e]] if (rule, e) in worst else "" for e in engines))
    console = Console()
    console.print(table)
    for note in report.notes:
        print(f"note  {note}")
    for row in report.failed:
        print(f"fail  {row.rule} ({row.engine}): {row.reason}")
    for verdict in ("unknown", "skip"):
        groups: dict[str, list[Row]] = {}
        for row in report.rows if verdict == "unknown" else own:
            if row.verdict == verdict:
                groups.setdefault(row.reason, []).append(row)
        for reason, rows in groups.items():
            rules, where = ({getattr(row, key) for row in rows} for key in ("rule", "engine"))
            which = next(iter(rules)) if len(rules) == 1 else f"{len(rules)} rules"
            print(f"{verdict}  {which} ({', '.join(sorted(where))}): {reason}")
    theirs = [row for row in report.rows if row.rule.startswith("simcheck.")]
    for row in theirs:
        if row.verdict == "pass" and row.reason.startswith("warn: "):
            print(f"note  {row.rule} ({row.engine}): {row.reason.removeprefix('warn: ')}")
    for engine, seconds in report.seconds.items():
        settings = f"; {report.settings[engine]}" if engine in report.settings else ""
        print(f"{' '.join((engine, report.engines.get(engine, ''))).strip()}: {seconds:.1f} s{settings}")
    count = {v: sum(row.verdict == v for row in report.rows) for v in ("fail", "unknown")}
    print(f"{report.verdict}: rules that fail: {count['fail']}, that could not be judged in time: {count['unknown']}")


def write_report(path: Path, report: CheckReport) -> None:
    """Write the report as JSON."""
    from freeart21.files import atomic

    atomic.write_bytes(path, (json.dumps(report.to_json(), indent=1) + "\n").encode())
