"""Printing scores: a table of sequences and a table by joint type."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from leaderboard.protocols import Metric, protocol_named
from leaderboard.rows import Row, Scores, Statistic

_DIGITS = {"deg": 2, "%": 2, "cm": 2, "dB": 1, "fraction": 3}


def print_scores(scores: Scores, console: Console | None = None) -> None:
    """Print a table of sequences, a line for each that needs a word, and means by joint type when there are several."""
    console = console or Console()
    if not console.is_terminal:  # a file or a pipe has room for every column
        console.width = max(console.width, 22 + 20 * max(len(scores.rows), 2))
    console.print(sequence_table(scores))
    for row in scores.rows:
        for line in (*([f"{row.status}: {row.reason}"] if row.reason else []), *row.notes):
            console.print(f"  {escape(row.sequence)}: {escape(line)}", style="red" if row.status != "ok" else "yellow")
    if len(scores.rows) > 1:
        console.print(group_table(scores))


def sequence_table(scores: Scores) -> Table:
    """A row a metric, a column a sequence; lengths in % of the diagonal with cm beside; failures flagged and priced."""
    rules = protocol_named(scores.protocol)
    table = Table(title=escape(f"{scores.method.name} by {rules.name}, sequences of {scores.benchmark['name']}"))
    table.add_column("metric")
    for row in scores.rows:
        style = None if row.status == "ok" else "red"
        table.add_column(escape(f"{row.sequence}\n{row.joint_type}"), justify="right", style=style)
    table.add_row("status", *(_status(row) for row in scores.rows))
    table.add_row("joint from", *(row.measured_from for row in scores.rows), end_section=True)
    for metric in rules.metrics:
        cells = (
            _cell(row.values[metric.id], metric.unit(row.joint_type), row.values_cm.get(metric.id))
            for row in scores.rows
        )
        table.add_row(_label(metric), *cells)
    table.add_section()
    table.add_row("seconds", *("-" if row.seconds is None else f"{row.seconds:.0f}" for row in scores.rows))
    return table


def group_table(scores: Scores) -> Table:
    """A row a metric, a column a joint type: mean ± standard deviation, then median and worst."""
    rules = protocol_named(scores.protocol)
    table = Table(title=escape(f"{scores.method.name} by {rules.name}: mean ± std (median, worst), failures priced"))
    table.add_column("metric")
    for summary in scores.summaries:
        table.add_column(summary.group, justify="right")
    table.add_row("sequences", *(str(s.sequences) for s in scores.summaries))
    table.add_row("failures", *(f"[red]{s.failures}[/red]" if s.failures else "0" for s in scores.summaries))
    table.add_row("coverage", *(f"{100 * s.coverage:.0f} %" for s in scores.summaries), end_section=True)
    for metric in rules.metrics:
        table.add_row(
            _label(metric),
            *(
                _statistic(s.statistics.get(metric.id), s.statistics.get(f"{metric.id}_cm"), metric.unit(s.group))
                for s in scores.summaries
            ),
        )
    return table


def page_entries(row: Row, protocol: str) -> dict[str, dict[str, object]]:
    """A row for a page: metric id to its value, unit, better ('up' or 'down') and the value in cm beside; no None."""
    entries: dict[str, dict[str, object]] = {}
    for metric in protocol_named(protocol).metrics:
        value, centimetres = row.values[metric.id], row.values_cm.get(metric.id)
        if value is not None:
            entries[metric.id] = {"value": value, "unit": metric.unit(row.joint_type), "better": metric.direction}
            if centimetres is not None:
                entries[metric.id]["beside"] = _number(centimetres, "cm")
    return entries


def _label(metric: Metric) -> str:
    arrow = "↑" if metric.direction == "up" else "↓"
    return f"  {metric.id} {arrow}" if metric.beside else f"{metric.id} {arrow}"


def _status(row: Row) -> str:
    if row.status != "ok":
        return row.status.upper()
    return "wrong type" if row.values["joint_type"] == 0 else "ok"


def _cell(value: float | None, unit: str | None, value_cm: float | None) -> str:
    if value is None or unit is None:
        return "-"
    beside = "" if value_cm is None else f" ({_number(value_cm, 'cm')})"
    return f"{_number(value, unit)}{beside}"


def _statistic(value: Statistic | None, in_cm: Statistic | None, unit: str | None) -> str:
    if value is None or unit is None:
        return "-"
    digits = _DIGITS[unit]
    std = "" if value.std is None else f" ± {value.std:.{digits}f}"
    beside = "" if in_cm is None else f" ({_number(in_cm.mean, 'cm')})"
    shown = "" if unit == "fraction" else f" {unit}"
    return f"{value.mean:.{digits}f}{std}{shown}{beside}, {value.median:.{digits}f}, {value.worst:.{digits}f}"


def _number(value: float, unit: str) -> str:
    return f"{value:.{_DIGITS[unit]}f}" + ("" if unit == "fraction" else f" {unit}")
