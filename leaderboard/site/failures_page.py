"""Failures: sequences that could not be measured, with their reasons, then the worst by every number."""

from __future__ import annotations

from collections.abc import Sequence

from freeart21.view.document import Markup, Section
from freeart21.view.tables import Cell, number_text, table_section
from leaderboard.protocols import Metric, protocol_named
from leaderboard.rows import Row
from leaderboard.site.common import Board, method_link, metric_name, page, sequence_link
from leaderboard.site.entrant import Entrant

MAX_SHOWN = 6
"""Results per number."""
EntrantRow = tuple[Entrant, Row]


def failures_page(board: Board) -> bytes:
    """The page, by the site's first protocol."""
    rules = protocol_named(board.protocols[0])
    rows = [(e, row) for e in board.entrants for row in e.scores[rules.name].rows if row.sequence in board.files]
    measured = [(e, row) for e, row in rows if row.status == "ok"]
    lost = [
        (sequence_link(row.sequence, board), method_link(e), row.status, row.reason)
        for e, row in rows
        if row.status != "ok"
    ]
    noted = [
        (sequence_link(row.sequence, board), method_link(e), "wrong type" * (row.values.get("joint_type") == 0), note)
        for e, row in measured
        for note in row.notes or ("",) * (row.values.get("joint_type") == 0)
    ]
    worst = [
        [
            Cell(Markup('<a href="definitions.html#{}.{}">{}</a>').format(rules.name, metric.id, metric_name(metric))),
            *(
                Cell(
                    number_text(row.values[metric.id], metric.unit(row.joint_type), True),
                    below=sequence_link(row.sequence, board) + Markup("<br>") + e.name,
                )
                for e, row in _worst(metric, measured)
            ),
        ]
        for metric in rules.metrics
        if metric.supplements is None and metric.column
    ]
    note = "Each counts with its penalty in all means." if lost else "Every result of every method could be measured."
    sections = [
        _section(f"Not measured: {len(lost)} of {len(rows)}", lost, note),
        _section("Worst by every number", worst, "The worst first."),
        *(
            [_section("Measured, with a note", noted, "A wrong joint type costs axis, position and state.")]
            if noted
            else []
        ),
    ]
    lead = Markup("<p>Failures first, then the worst results by {}.</p>").format(rules.name)
    return page(board, "Failures", sections, here="failures.html", lead=lead)


def _section(title: str, rows: Sequence[Sequence[object]], note: str) -> Section:
    return table_section(title, rows, (), "full", note)


def _worst(metric: Metric, rows: Sequence[EntrantRow]) -> list[EntrantRow]:
    """The worst measured rows by one number; half of them by joint type where these have different units."""
    sign = 1.0 if metric.direction == "up" else -1.0
    known = [(e, row) for e, row in rows if row.values.get(metric.id) is not None]
    known.sort(key=lambda pair: sign * (pair[1].values[metric.id] or 0.0))
    if metric.unit("all") is not None:
        return known[:MAX_SHOWN]
    kinds = [[pair for pair in known if pair[1].joint_type == kind] for kind in ("revolute", "prismatic")]
    return [pair for kind in kinds for pair in kind[: MAX_SHOWN // 2]]
