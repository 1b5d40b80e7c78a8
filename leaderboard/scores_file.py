"""The file that `score --out` writes: every number of one method by one protocol, with what each means."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from freeart21.files import atomic
from freeart21.files.places import SCORES, require_replaceable
from leaderboard.protocols import protocol_named
from leaderboard.rows import Scores

SCHEMA = "freeart21/scores/1"


def write_scores(path: Path, scores: Scores) -> None:
    """Write `scores` as JSON, with the protocol's text, units, directions and prices beside the numbers.

    Raises FreeArtError unless only an older table of scores stands at `path`.
    """
    require_replaceable(Path(path), SCORES)
    rules = protocol_named(scores.protocol)
    metrics = [
        {
            "id": m.id,
            "label": m.label,
            "unit": {"revolute": m.revolute_unit, "prismatic": m.prismatic_unit},
            "direction": m.direction,
            "price": m.price_text,
            "beside": m.beside,
            "definition": m.definition,
        }
        for m in rules.metrics
    ]
    body: dict[str, Any] = asdict(scores)
    body["protocol"] = {"name": rules.name, "preamble": rules.preamble, "metrics": metrics}
    atomic.write_json(Path(path), {"schema": SCHEMA, **body})
