"""The suite's table: means of the ranking metrics by joint type, a row per method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from leaderboard.protocols import Group, protocol_named
from leaderboard.tables import decimals

WIDTH = 120


def print_table(protocol: str, tables: Mapping[str, Sequence[Mapping[str, Any]]], console: Console) -> None:
    """Print the means of `tables` (row to its statistics by joint type), one table per joint type."""
    if not console.is_terminal:
        console.width = max(console.width, WIDTH)
    groups: tuple[Group, ...] = ("revolute", "prismatic", "all")
    found = {summary["group"] for summaries in tables.values() for summary in summaries}
    for group in groups if len(found) > 2 else groups[:-1]:
        lines = {row: s for row, summaries in tables.items() for s in summaries if s["group"] == group}
        if lines:
            console.print(_table(protocol, group, lines))


def _table(protocol: str, group: Group, lines: Mapping[str, Mapping[str, Any]]) -> Table:
    metrics = [m for m in protocol_named(protocol).metrics if m.column and m.unit(group) is not None]
    n = max(line["sequences"] for line in lines.values())
    table = Table(
        title=f"{protocol}, means over {n} {group if group != 'all' else 'sequences of all types'}", box=box.SIMPLE
    )
    table.add_column("row", no_wrap=True, min_width=max(map(len, lines)))
    table.add_column("failed", justify="right")
    for metric in metrics:
        unit = metric.unit(group)
        table.add_column(f"{metric.column}\n{'' if unit == 'fraction' else unit}", justify="right")
    for row, line in lines.items():
        cells = []
        for metric in metrics:
            statistic = line["statistics"].get(metric.id)
            unit = metric.unit(group) or ""
            cells.append("-" if statistic is None else f"{statistic['mean']:.{decimals(unit)}f}")
        table.add_row(row, str(line["failures"]), *cells)
    return table
