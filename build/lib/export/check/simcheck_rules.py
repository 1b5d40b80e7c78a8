"""What the public checker `simcheck` (PyPI, 0.2) says of an asset, as rows: its errors fail, its warnings are told."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from export.check.report import Row, Verdict

_VERDICTS: dict[str, Verdict] = {"fail": "fail", "skip": "skip"}


def simcheck_rows(file: Path) -> Iterator[Row]:
    """A row for each of its checks and engines; ids are its own, behind `simcheck.`."""
    from simcheck.core import check_file

    for result in check_file(file).results:
        told = "; ".join(finding.message for finding in result.findings)
        level = f"{result.status}: " if result.status in ("warn", "info") and told else ""
        engine = f"simcheck/{result.engine}" if result.engine else "simcheck"
        reason = (level + (told or result.note or ""))[:600]
        yield Row(f"simcheck.{result.id}", engine, _VERDICTS.get(result.status, "pass"), reason)
