"""What scoring makes: a row a sequence, statistics over rows, a whole table."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Literal

import pandas as pd

from freeart21.files.result import Method
from freeart21.joint import JointType
from leaderboard.protocol import Group

Status = Literal["ok", "failed", "missing", "unreadable"]
Source = Literal["asset", "files", "nothing"]


@dataclass(frozen=True)
class Row:
    """The score of one sequence."""

    sequence: str
    joint_type: JointType
    """Of the truth."""
    status: Status
    """'ok' was measured; 'failed' says so itself or has an asset that does not load; all but 'ok' are priced."""
    reason: str
    """Why it was not measured; empty when it was."""
    measured_from: Source
    """What joint and surfaces were measured from."""
    swapped: bool
    """Whether the answer's parts went by each other's names."""
    diagonal_m: float
    """Of the truth: what lengths in % are shares of."""
    values: dict[str, float | None]
    """Every metric of the protocol in its unit; None where it does not exist for this sequence."""
    values_cm: dict[str, float]
    """Those that are shares of the diagonal, in cm."""
    notes: tuple[str, ...] = ()
    """What the reader should know: a wrong joint type, a picture that could not be read."""
    seconds: float | None = None
    """What the method says it took, all stages together; None when it does not say."""
    result_sha256: str | None = None
    """Of the result's folder (`leaderboard.provenance.folder_sha256`); None when there is none, or it is too large."""
    truth_sha256: str | None = None
    """The same of the truth's folder."""

    @staticmethod
    def from_json(data: dict[str, Any]) -> Row:
        """The row whose fields `data` holds, as JSON gives them back."""
        return Row(**{**data, "notes": tuple(data["notes"])})


@dataclass(frozen=True)
class Statistic:
    """One metric over a group of sequences."""

    mean: float
    std: float | None
    """Sample standard deviation (ddof 1); None for one sequence."""
    median: float
    worst: float
    sequences: int
    """How many have this number: all, but for position (revolute only) and pictures (where there are queries)."""


@dataclass(frozen=True)
class Summary:
    """All sequences of a joint type, or all of them; failures and missing ones at their price."""

    group: Group
    sequences: int
    failures: int
    """Sequences that were not measured: failed, missing or unreadable."""
    coverage: float
    """Fraction that was measured."""
    statistics: dict[str, Statistic]
    """Metric id, or id_cm, to its statistic; only those with one unit in the group."""


@dataclass(frozen=True)
class Scores:
    """A whole table."""

    protocol: str
    method: Method
    benchmark: dict[str, str]
    """name, version, split, and sha256 of benchmark.json, which holds the hash of every file of the truth."""
    rows: tuple[Row, ...]
    summaries: tuple[Summary, ...]
    seconds: float | None = None
    """What scoring took; None of a table that was read from a file, which does not say: it is the same every time."""
    notes: tuple[str, ...] = ()
    """What the reader should know of the method as a whole: a method.json that cannot be read."""
    made_with: dict[str, Any] = field(default_factory=dict)
    """The code, libraries and machine that made the numbers, see `leaderboard.provenance.made_with`."""

    @property
    def measured(self) -> int:
        """How many rows were measured rather than priced."""
        return sum(row.status == "ok" for row in self.rows)

    def frame(self) -> pd.DataFrame:
        """All rows as `frame` gives them."""
        return frame(self.rows)


def frame(rows: Iterable[Row]) -> pd.DataFrame:
    """A line a sequence, by its name: truth_type, status, reason, measured_from, swapped, seconds, every metric in its
    unit (NaN where it does not exist) and, as id_cm, those that are shares of the diagonal in cm."""
    words = ("status", "reason", "measured_from", "swapped")
    lines = [
        {
            "sequence": row.sequence,
            "truth_type": row.joint_type,
            **{name: getattr(row, name) for name in words},
            "seconds": row.seconds,
            **row.values,
            **{f"{id}_cm": value for id, value in row.values_cm.items()},
        }
        for row in rows
    ]
    table = pd.DataFrame(lines).set_index("sequence")
    return table.astype({name: float for name in table if name not in ("truth_type", *words)})
