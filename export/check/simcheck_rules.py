"""Rows of the public checker `simcheck` (PyPI, 0.2): its errors fail, its warnings are reported."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from export.check.report import Row, Verdict

_ENGINES_SHARE = 0.8
"""Of the time, for its engines, which it runs at once; before them it reads the files: 24 of 133 s, measured."""
_VERDICTS: dict[str, Verdict] = {"fail": "fail", "skip": "skip"}


def run_simcheck(file: Path, limit_s: float) -> Iterator[Row]:
    """A row for each of its checks and engines, with its own ids behind `simcheck.`.

    Its settings are its own, except for the engines' time, 240 s, which becomes what is left of `limit_s`. Checks that
    it did not finish are unknown, though it only warns about them.
    """
    from simcheck.config import Config, Thresholds
    from simcheck.core import check_file

    config = Config(thresholds=Thresholds(engine_timeout=_ENGINES_SHARE * limit_s))
    for result in check_file(file, config).results:
        messages = "; ".join(finding.message for finding in result.findings)
        level = f"{result.status}: " if result.status in ("warn", "info") and messages else ""
        engine = f"simcheck/{result.engine}" if result.engine else "simcheck"
        reason = (level + (messages or result.note or ""))[:600]
        unfinished = any(finding.data.get("incomplete") for finding in result.findings)
        verdict: Verdict = "unknown" if unfinished else _VERDICTS.get(result.status, "pass")
        yield Row(f"simcheck.{result.id}", engine, verdict, reason)
