"""Prints score tables: sequences as rows, ranking metrics as columns, statistics by joint type below."""

from __future__ import annotations

from collections.abc import Iterator

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from leaderboard.protocol import Metric, Protocol
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row, Scores, Summary
from leaderboard.submission import escape_unprintable

WIDTH = 100
"""Characters that the table of ranking metrics fits."""
COLUMNS_AT_ONCE = 5
"""Metrics per table when all are printed."""
NOTHING = "–"  # noqa: RUF001
"""Stands for a missing value."""
_DIGITS = {"deg": 2, "%": 2, "cm": 2, "m": 4, "dm²": 4, "1": 3, "dB": 1, "fraction": 3}
_SIGNS = {"deg": "°", "%": "%", "cm": " cm", "m": " m", "dm²": "", "1": "", "dB": "", "fraction": ""}


def decimals(unit: str) -> int:
    """Decimals of values in `unit`."""
    return _DIGITS.get(unit, 3)


def unit_suffix(unit: str) -> str:
    """Suffix of values in `unit`."""
    return _SIGNS.get(unit, f" {unit}")


def column_foot(metric: Metric, second_unit: str = "") -> str:
    """Last line of a column's head: the unit if all sequences share one, and an arrow towards better values."""
    unit = metric.unit("all") or ""
    shown = (
        "" if unit in ("dB", "fraction", "1") else f"{unit} ({second_unit})" if second_unit and unit == "%" else unit
    )
    return f"{shown} {'↑' if metric.direction == 'up' else '↓'}".strip()


def ranking_metrics(rules: Protocol) -> tuple[Metric, ...]:
    """The metrics with a column in short tables; if none has one, all that do not supplement another."""
    chosen = tuple(metric for metric in rules.metrics if metric.column)
    return chosen or tuple(metric for metric in rules.metrics if metric.supplements is None)


def column_head(metric: Metric) -> str:
    """The head of a metric's column, in one or more lines."""
    return metric.column or metric.id.replace("_", "\n")


def print_scores(scores: Scores, console: Console | None = None, everything: bool = False) -> None:
    """Print the table of sequences with statistics by joint type, then failures and notes.

    `everything` prints every metric of the protocol in several tables, with lengths in cm, too.
    """
    console = console or Console()
    if not console.is_terminal:  # a file or pipe has no width
        console.width = max(console.width, WIDTH)
    for table in all_tables(scores) if everything else [score_table(scores)]:
        console.print(table)
    for note in scores.notes:
        console.print(f"  {escape(note)}", style="yellow", soft_wrap=True)
    for row in scores.rows:
        for line in (*([f"{row.status}: {row.reason}"] if row.reason else []), *row.notes):
            style = "red" if row.status != "ok" else "yellow"
            console.print(f"  {escape(f'{row.sequence}: {line}')}", style=style, soft_wrap=True)
    duration = "" if scores.seconds is None else f", in {scores.seconds:.0f} s"
    console.print(f"  {scores.measured} of {len(scores.rows)} sequences were measured{duration}", style="dim")
    assets_count = protocol_named(scores.protocol).asset != "none"
    if assets_count and any(row.measured_from == "files" for row in scores.rows):
        console.print("  'files': there is no asset; joint and surfaces are read from the files.", style="dim")


def score_table(scores: Scores) -> Table:
    """The table of ranking metrics: a row per sequence, then statistics by joint type."""
    return _table(scores, list(ranking_metrics(protocol_named(scores.protocol))), False)


def all_tables(scores: Scores) -> Iterator[Table]:
    """Tables of every metric of the protocol, COLUMNS_AT_ONCE each."""
    metrics = protocol_named(scores.protocol).metrics
    for at in range(0, len(metrics), COLUMNS_AT_ONCE):
        yield _table(scores, list(metrics[at : at + COLUMNS_AT_ONCE]), True)


def page_entries(row: Row, protocol: str) -> dict[str, dict[str, object]]:
    """A row for a page: metric id to label, value, unit, better ('up' or 'down') and, as `beside`, the value in cm.

    Metrics without a value are left out.
    """
    entries: dict[str, dict[str, object]] = {}
    for metric in protocol_named(protocol).metrics:
        value, centimetres = row.values.get(metric.id), row.values_cm.get(metric.id)
        if value is not None:
            entries[metric.id] = {
                "label": metric.label,
                "value": value,
                "unit": metric.unit(row.joint_type),
                "better": metric.direction,
            }
            if centimetres is not None:
                entries[metric.id]["beside"] = f"{centimetres:.{decimals('cm')}f} cm"
    return entries


def score_note(row: Row, protocol: str) -> str:
    """The text of a page below a row: protocol, frames, and where the values were measured."""
    measured = {
        "asset": "joint and surfaces of the asset, reloaded and driven in the simulator",
        "files": "joint and surfaces of the result's files, "
        + ("as there is no asset" if protocol_named(protocol).asset != "none" else "which are all that it reads"),
        "nothing": f"nothing could be measured ({row.reason}), and every number is the penalty of a failure",
    }[row.measured_from]
    return (
        f"By protocol {protocol}, over all frames of the video (joint state: those that show both parts) and all "
        f"held-out views; {measured}."
    )


def _table(scores: Scores, metrics: list[Metric], whole: bool) -> Table:
    rules = protocol_named(scores.protocol)
    title = f"{scores.method.name} by {rules.name}, sequences of {scores.benchmark['name']}; failures penalised"
    table = Table(title=escape(escape_unprintable(title)), box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("sequence", overflow="fold", min_width=len("prismatic mean"))
    table.add_column("", overflow="fold")
    for metric in metrics:
        head = metric.id.replace("_", "\n") if whole else column_head(metric)
        foot = column_foot(metric, "cm" if whole else "")
        table.add_column(f"{head}\n{foot}", justify="right", no_wrap=True)
    table.add_column("s", justify="right", no_wrap=True)
    for row in scores.rows:
        cells = [format_cell(row, metric, whole) for metric in metrics]
        style = None if row.status == "ok" else "red"
        seconds = NOTHING if row.seconds is None else f"{row.seconds:.0f}"
        table.add_row(escape(row.sequence), _format_status(row, rules), *cells, seconds, style=style)
    groups = scores.summaries if len(scores.summaries) > 2 else scores.summaries[:1]
    for summary in groups if len(scores.rows) > 1 else ():
        table.add_section()
        for name, style in (("mean", None), ("std", "dim"), ("median", "dim"), ("worst", "dim")):
            head, failed = f"  {name}", ""
            if name == "mean":
                head = f"{summary.group} mean"
                failed = f"{summary.failures}/{summary.sequences} fail" if summary.failures else f"{summary.sequences}"
            cells = [_format_statistic(summary, metric, name, whole) for metric in metrics]
            table.add_row(head, failed, *cells, "", style=style)
    return table


def _format_status(row: Row, rules: Protocol) -> str:
    """The status of a row, in one or two words."""
    if row.status != "ok":
        return row.status.upper()
    if row.values.get("joint_type") == 0:
        return "wrong type"
    return "files" if row.measured_from == "files" and rules.asset != "none" else "ok"


def format_cell(row: Row, metric: Metric, whole: bool) -> str:
    """The text of a row's value, with the unit if the column has no common one."""
    value, centimetres = row.values.get(metric.id), row.values_cm.get(metric.id)
    return _format_number(value, metric.unit(row.joint_type), metric, centimetres, whole)


def _format_statistic(summary: Summary, metric: Metric, name: str, whole: bool) -> str:
    value, centimetres = (getattr(summary.statistics.get(id), name, None) for id in (metric.id, f"{metric.id}_cm"))
    return _format_number(value, metric.unit(summary.group), metric, centimetres, whole)


def _format_number(
    value: float | None, unit: str | None, metric: Metric, centimetres: float | None, whole: bool
) -> str:
    """`value` with about three digits, and its unit if the column has no common one."""
    if value is None or unit is None:
        return NOTHING
    digits = decimals(unit) if abs(value) < 10 or unit in ("dB", "fraction") else 1 if abs(value) < 99.95 else 0
    in_cm = f" ({centimetres:.{decimals('cm')}f})" if whole and centimetres is not None else ""
    return f"{value:.{digits}f}{'' if metric.unit('all') else unit_suffix(unit)}{in_cm}"
