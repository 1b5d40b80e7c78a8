"""Failures: sequences that could not be measured, with their reasons, and what scoring noted on the others."""

from __future__ import annotations

from freeart21.view.document import Markup
from freeart21.view.tables import table_section
from leaderboard.protocols import protocol_named
from leaderboard.site.common import Board, method_link, page, sequence_link


def failures_page(board: Board) -> bytes:
    """The page, by the site's first protocol."""
    rules = protocol_named(board.protocols[0])
    rows = [(e, row) for e in board.entrants for row in e.scores[rules.name].rows if row.sequence in board.files]
    lost, noted = [], []
    for e, row in rows:
        links = sequence_link(row.sequence, board), method_link(e)
        wrong = row.values.get("joint_type") == 0
        if row.status != "ok":
            lost.append((*links, row.status, row.reason))
        else:
            noted += [(*links, "wrong type" * wrong, note) for note in row.notes or ("",) * wrong]
    note = "Each counts with its penalty in all means." if lost else "Every result of every method could be measured."
    sections = [table_section(f"Not measured: {len(lost)} of {len(rows)}", lost, (), "full", note)]
    if noted:
        note = "A wrong joint type costs axis, position and state."
        sections.append(table_section("Measured, with a note", noted, (), "full", note))
    lead = Markup("<p>Failures by {}. The worst of the others: sort the page of a method.</p>").format(rules.name)
    return page(board, "Failures", sections, here="failures.html", lead=lead)
