"""Where a table of numbers comes from, as facts on a page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from freeart21.view.document import escape
from leaderboard.rows import Scores
from leaderboard.site.html import NONE


def provenance(scores: Scores) -> list[tuple[str, str]]:
    """Names and values, the values escaped: benchmark and its hash, code, libraries and machine."""
    benchmark = scores.benchmark
    rows = [
        ("benchmark", escape(f"{benchmark['name']}, version {benchmark['version']}, {benchmark['split']}")),
        ("benchmark.json", _hash(benchmark["sha256"])),
        ("protocol", escape(scores.protocol)),
    ]
    return rows + _flat("", scores.made_with)


def _flat(before: str, said: Mapping[str, Any]) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in said.items():
        name = f"{before} {key}".strip().replace("_", " ")
        if isinstance(value, Mapping):
            rows += _flat(name, value)
        elif isinstance(value, str) and len(value) == 64 and set(value) <= set("0123456789abcdef"):
            rows.append((name, _hash(value)))
        else:
            rows.append((name, escape(NONE if value in (None, "") else value)))
    return rows


def _hash(sha256: str) -> str:
    return f'<code class="hash">{escape(sha256)}</code>'
