"""Score tables: a row per sequence, statistics over rows, and the whole table."""

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
    """'ok': measured. 'failed': declares a failure, or its asset does not load. All but 'ok' are penalised."""
    reason: str
    """Why it was not measured; empty for 'ok'."""
    measured_from: Source
    """Where joint and surfaces were measured."""
    swapped: bool
    """Whether the answer's moving part was matched to the true reference part."""
    diagonal_m: float
    """Diagonal of the true object: lengths in % are relative to it."""
    values: dict[str, float | None]
    """Metric id to value in the metric's unit; None where there is none for this sequence."""
    values_cm: dict[str, float]
    """The values in %, as cm."""
    notes: tuple[str, ...] = ()
    """Remarks, such as a wrong joint type or an unreadable picture."""
    seconds: float | None = None
    """Run time that the method reports, all stages together; None when it reports none."""
    result_sha256: str | None = None
    """Hash of the result's folder (`leaderboard.provenance.folder_sha256`); None when it is missing or too large."""
    truth_sha256: str | None = None
    """Hash of the truth's folder."""

    @staticmethod
    def from_json(data: dict[str, Any]) -> Row:
        """The row with the fields `data`, as read from JSON."""
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
    """Number of sequences with a value. Position exists for revolute joints only, renders where there are queries."""


@dataclass(frozen=True)
class Summary:
    """Statistics over all sequences of a joint type, or over all; failed and missing ones count with their penalty."""

    group: Group
    sequences: int
    failures: int
    """Number of sequences that are failed, missing or unreadable."""
    coverage: float
    """Fraction of the sequences that was measured."""
    statistics: dict[str, Statistic]
    """Metric id (and id_cm, in cm) to its statistic; only metrics with one unit in the group."""


@dataclass(frozen=True)
class Scores:
    """The score table of one method by one protocol."""

    protocol: str
    method: Method
    benchmark: dict[str, str]
    """name, version, split, and sha256 of benchmark.json, which lists the hash of every file of the truth."""
    rows: tuple[Row, ...]
    summaries: tuple[Summary, ...]
    seconds: float | None = None
    """Time that scoring took; None for a table read from a file, which does not store it."""
    notes: tuple[str, ...] = ()
    """Remarks on the method as a whole, such as an unreadable method.json."""
    made_with: dict[str, Any] = field(default_factory=dict)
    """Code, libraries and machine, as `leaderboard.provenance.describe_environment` returns them."""

    @property
    def measured(self) -> int:
        """Number of measured rows."""
        return sum(row.status == "ok" for row in self.rows)

    def frame(self) -> pd.DataFrame:
        """All rows as a table, see `frame`."""
        return frame(self.rows)


def frame(rows: Iterable[Row]) -> pd.DataFrame:
    """A row per sequence, indexed by its name.

    Columns: truth_type, status, reason, measured_from, swapped, seconds, every metric in its unit (NaN without a value)
    and, as id_cm, values in % as cm.
    """
    text_columns = ("status", "reason", "measured_from", "swapped")
    lines = [
        {
            "sequence": row.sequence,
            "truth_type": row.joint_type,
            **{name: getattr(row, name) for name in text_columns},
            "seconds": row.seconds,
            **row.values,
            **{f"{id}_cm": value for id, value in row.values_cm.items()},
        }
        for row in rows
    ]
    table = pd.DataFrame(lines).set_index("sequence")
    return table.astype({name: float for name in table if name not in ("truth_type", *text_columns)})
