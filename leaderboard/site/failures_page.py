"""Failures: sequences that could not be measured, with their reasons, then the worst by every number."""

from __future__ import annotations

from collections.abc import Sequence

from freeart21.view.document import Markup, Section, render
from freeart21.view.tables import number_text
from leaderboard.protocols import Metric, protocol_named
from leaderboard.rows import Row
from leaderboard.site.common import PACKAGE, Board, explained, method_link, page, sequence_link
from leaderboard.site.entrant import Entrant
from leaderboard.site.index_page import thumb

MAX_SHOWN = 6
"""Cards per number."""
EntrantRow = tuple[Entrant, Row]


def failures_page(board: Board) -> bytes:
    """The page, by the site's first protocol."""
    rules = protocol_named(board.protocols[0])
    rows = [(e, row) for e in board.entrants for row in e.scores[rules.name].rows if row.sequence in board.files]
    lost = [(e, row) for e, row in rows if row.status != "ok"]
    measured = [(e, row) for e, row in rows if row.status == "ok"]
    wrong = [(e, row) for e, row in measured if row.values.get("joint_type") == 0]
    thumbs = {s.name: s.thumb for s in board.sequences}

    def cards(
        title: str, shown: Sequence[tuple[EntrantRow, str, str]], note: str, more: str = ""
    ) -> Section:
        given = [
            (
                sequence_link(row.sequence, board, inside=thumb(thumbs.get(row.sequence, ""))),
                head,
                sequence_link(row.sequence, board),
                method_link(entrant),
                text,
            )
            for (entrant, row), head, text in shown
        ]
        return Section(title, render("cards.html.j2", PACKAGE, note=note, more=more, cards=given), place="full")

    sections = [
        cards(
            f"Not measured: {len(lost)} of {len(rows)}",
            [(pair, pair[1].status, pair[1].reason) for pair in lost],
            "Each counts with its penalty in all means." if lost else "Every result of every method could be measured.",
        ),
        cards(
            f"Wrong joint type: {len(wrong)}",
            [(pair, "wrong type", pair[1].notes[0] if pair[1].notes else "") for pair in wrong],
            "Axis, position and state count with their penalty; masks, poses and surfaces are measured."
            if wrong
            else "Every measured result has the right joint type.",
        ),
    ]
    for metric in rules.metrics:
        if metric.supplements is None and metric.column and (worst := _worst(metric, measured)):
            texts = [number_text(row.values[metric.id], metric.unit(row.joint_type), True) for _, row in worst]
            link = Markup('<a href="definitions.html#{}.{}">Definition</a>').format(rules.name, metric.id)
            shown = [(pair, text, "") for pair, text in zip(worst, texts, strict=True)]
            sections.append(cards(f"Worst by {metric.label}", shown, explained(metric), link))
    lead = Markup("<p>Failures first, then the worst results by {}.</p>").format(rules.name)
    return page(board, "Failures", [*sections, *_notes(measured, board)], here="failures.html", lead=lead)


def _worst(metric: Metric, rows: Sequence[EntrantRow]) -> list[EntrantRow]:
    """The worst measured rows by one number; half of them by joint type where these have different units."""
    sign = 1.0 if metric.direction == "up" else -1.0
    known = [(e, row) for e, row in rows if row.values.get(metric.id) is not None]
    known.sort(key=lambda pair: sign * (pair[1].values[metric.id] or 0.0))
    if metric.unit("all") is not None:
        return known[:MAX_SHOWN]
    kinds = [[pair for pair in known if pair[1].joint_type == kind] for kind in ("revolute", "prismatic")]
    return [pair for kind in kinds for pair in kind[: MAX_SHOWN // 2]]


def _notes(rows: Sequence[EntrantRow], board: Board) -> list[Section]:
    """Notes of scoring on measured rows: each once per method, with its sequences."""
    groups: dict[tuple[Entrant, str], list[str]] = {}
    for entrant, row in rows:
        for text in row.notes:
            groups.setdefault((entrant, text), []).append(row.sequence)
    lines = [
        (
            method_link(e),
            [text, ", ".join(names[:MAX_SHOWN]) + f" and {len(names) - MAX_SHOWN} more" * (len(names) > MAX_SHOWN)],
        )
        for (e, text), names in groups.items()
    ]
    return (
        [Section("Measured, with a note", render("notes.html.j2", PACKAGE, blocks=lines), place="full")]
        if lines
        else []
    )
