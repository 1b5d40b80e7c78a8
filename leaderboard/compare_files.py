"""Writes a comparison as CSV, JSON, Markdown or LaTeX, by the file name's suffix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

import pandas as pd

from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.places import Output, require_replaceable
from leaderboard import bootstrap
from leaderboard.compare import By, Comparison, Group
from leaderboard.compare_tables import latex, legend, markdown
from leaderboard.scores_file import metric_terms

SCHEMA = "freeart21/comparison/1"
_CSV_HEAD = "protocol,benchmark,by,"
COMPARISONS: dict[str, Output] = {
    ".csv": Output("table of a comparison", _CSV_HEAD.encode()),
    ".json": Output("comparison", b'"schema": "freeart21/comparison/'),
    ".md": Output("comparison", b"<!-- freeart21 comparison"),
    ".tex": Output("comparison", b"% freeart21 comparison"),
}
"""Suffix to how an older file of that kind is recognised."""


def kind_of(path: Path) -> Output:
    """The kind of file that `path` names; FreeArtError lists the suffixes."""
    if path.suffix not in COMPARISONS:
        raise FreeArtError(f"{path} ends in '{path.suffix}', expected {', '.join(COMPARISONS)}")
    return COMPARISONS[path.suffix]


def write_comparison(path: Path, comparison: Comparison, by: By) -> None:
    """Write `comparison` in the format of `path`'s suffix; JSON has all groups, the others those of `by`.

    Raises FreeArtError for another suffix, and when something else than an older file of this kind exists at `path`.
    """
    require_replaceable(path, kind_of(path))
    writers: dict[str, Callable[[], str]] = {
        ".csv": lambda: csv(comparison, by),
        ".json": lambda: atomic.json_text(to_json(comparison)),
        ".md": lambda: markdown(comparison, by),
        ".tex": lambda: latex(comparison, by),
    }
    atomic.write_bytes(path, writers[path.suffix]().encode())


def table(comparison: Comparison, by: By) -> pd.DataFrame:
    """A row per group and method; by sequence, `Comparison.frame`.

    Columns: group, method, sequences, failures, coverage; for each metric with a unit in the group its mean (id),
    id_std, id_median, id_worst, id_sequences; and the difference to the first method, id_difference, with the ends
    id_low and id_high of its interval.
    """
    if by == "sequence":
        return comparison.frame()
    lines = []
    for group in comparison.groups(by):
        found = {(one.method, one.metric): one for one in reversed(comparison.differences(group))}
        for entrant in comparison.entrants:
            standing = comparison.standing(entrant, group)
            line: dict[str, Any] = {
                "group": group.name,
                "method": entrant.name,
                "sequences": standing.sequences,
                "failures": standing.failures,
                "coverage": standing.coverage,
            }
            for id, one in standing.statistics.items():
                line |= {id: one.mean, f"{id}_std": one.std, f"{id}_median": one.median, f"{id}_worst": one.worst}
                line[f"{id}_sequences"] = one.sequences
                difference = found.get((entrant.name, id))
                if difference is not None and difference.other == comparison.entrants[0].name:
                    interval = difference.interval
                    ends = {f"{id}_low": interval.low, f"{id}_high": interval.high}
                    line |= {f"{id}_difference": interval.mean, **ends}
            lines.append(line)
    return pd.DataFrame(lines)


def csv(comparison: Comparison, by: By) -> str:
    """The table as CSV; text that a spreadsheet would take for a formula gets a leading apostrophe."""
    found = table(comparison, by)
    for name in found.select_dtypes(exclude="number"):
        found[name] = [f"'{v}" if isinstance(v, str) and v[:1] in "=+-@" else v for v in found[name]]
    found.insert(0, "by", by)
    found.insert(0, "benchmark", f"{comparison.benchmark['name']} {comparison.benchmark['sha256'][:12]}")
    found.insert(0, "protocol", comparison.rules.name)
    return str(found.to_csv(index=False, lineterminator="\n"))


def to_json(comparison: Comparison) -> dict[str, Any]:
    """The whole comparison: methods with their environment, groups by type and by category, every sequence."""
    return {
        "schema": SCHEMA,
        "protocol": comparison.rules.name,
        "benchmark": comparison.benchmark,
        "metrics": [
            {key: value for key, value in metric_terms(metric).items() if key != "price"}
            for metric in comparison.rules.metrics
        ],
        "methods": [
            {"name": entrant.name, "method": asdict(entrant.scores.method), "made_with": entrant.scores.made_with}
            for entrant in comparison.entrants
        ],
        "interval": bootstrap.describe(),
        "groups": [
            _group(comparison, group) for by in get_args(By) if by != "sequence" for group in comparison.groups(by)
        ],
        "sequences": [
            {
                "sequence": name,
                "joint_type": kind,
                "category": comparison.categories[name],
                "methods": {
                    entrant.name: {
                        key: getattr(row, key) for key in ("status", "measured_from", "result_sha256", "values")
                    }
                    for entrant in comparison.entrants
                    if (row := comparison.row(entrant, name)) is not None
                },
            }
            for name, kind in comparison.types.items()
        ],
        "notes": list(legend(comparison, "type")),
    }


def _group(comparison: Comparison, group: Group) -> dict[str, Any]:
    standings = {entrant.name: comparison.standing(entrant, group) for entrant in comparison.entrants}
    return {
        "by": group.by,
        "group": group.name,
        "sequences": list(group.sequences),
        "methods": {name: {**asdict(one), "coverage": one.coverage} for name, one in standings.items()},
        "differences": [
            {
                **{key: getattr(one, key) for key in ("method", "other", "metric", "verdict")},
                **{key: getattr(one.interval, key) for key in ("low", "high", "sequences")},
                "difference": one.interval.mean,
            }
            for one in comparison.differences(group)
        ],
    }
