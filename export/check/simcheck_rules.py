"""What the public checker `simcheck` (PyPI, 0.2) says of an asset, as rows: its errors fail, its warnings are told."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from export.check.report import Row, Verdict

_ENGINES_SHARE = 0.8
"""Of the time, for its engines, which it tries at once; before them it looks at the files: 24 of 133 s, measured."""
_VERDICTS: dict[str, Verdict] = {"fail": "fail", "skip": "skip"}


def simcheck_rows(file: Path, limit_s: float) -> Iterator[Row]:
    """A row for each of its checks and engines; ids are its own, behind `simcheck.`. All settings are its own, too, but
    the seconds that it gives its engines, 240, are what is left of `limit_s`. What it did not finish is unknown,
    though it only warns of that."""
    from simcheck.config import Config, Thresholds
    from simcheck.core import check_file

    config = Config(thresholds=Thresholds(engine_timeout=_ENGINES_SHARE * limit_s))
    for result in check_file(file, config).results:
        told = "; ".join(finding.message for finding in result.findings)
        level = f"{result.status}: " if result.status in ("warn", "info") and told else ""
        engine = f"simcheck/{result.engine}" if result.engine else "simcheck"
        reason = (level + (told or result.note or ""))[:600]
        unfinished = any(finding.data.get("incomplete") for finding in result.findings)
        verdict: Verdict = "unknown" if unfinished else _VERDICTS.get(result.status, "pass")
        yield Row(f"simcheck.{result.id}", engine, verdict, reason)
