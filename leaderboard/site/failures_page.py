"""Failures: sequences that could not be measured, with their reasons, then the worst by every number."""

from __future__ import annotations

from collections.abc import Sequence

from freeart21.view.document import Section, escape
from freeart21.view.tables import number_text
from leaderboard.protocols import Metric, protocol_named
from leaderboard.rows import Row
from leaderboard.site.entrant import Entrant
from leaderboard.site.html import Board, explained, method_link, page

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
    thumbs = {s.name for s in board.sequences if s.thumb}

    def card(entrant: Entrant, row: Row, head: str, text: str = "") -> str:
        return _card(entrant, row, board.files[row.sequence], row.sequence in thumbs, head, text)

    sections = [
        _cards(
            f"Not measured: {len(lost)} of {len(rows)}",
            [card(e, row, row.status, row.reason) for e, row in lost],
            "Each counts with its penalty in all means." if lost else "Every result of every method could be measured.",
        ),
        _cards(
            f"Wrong joint type: {len(wrong)}",
            [card(e, row, "wrong type", row.notes[0] if row.notes else "") for e, row in wrong],
            "Axis, position and state count with their penalty; masks, poses and surfaces are measured."
            if wrong
            else "Every measured result has the right joint type.",
        ),
    ]
    for metric in rules.metrics:
        if metric.supplements is None and metric.column and (worst := _worst(metric, measured)):
            cards = [
                card(e, row, number_text(row.values[metric.id], metric.unit(row.joint_type), True)) for e, row in worst
            ]
            link = f' <a href="definitions.html#{rules.name}.{metric.id}">Definition</a>'
            sections.append(_cards(f"Worst by {metric.label}", cards, escape(explained(metric)) + link))
    sections += _notes_section(measured, board)
    lead = f"<p>Failures first, then the worst results by {escape(rules.name)}.</p>"
    return page(board, "Failures", sections, here="failures.html", lead=lead)


def _worst(metric: Metric, rows: Sequence[EntrantRow]) -> list[EntrantRow]:
    """The worst measured rows by one number; half of them by joint type where these have different units."""
    sign = 1.0 if metric.direction == "up" else -1.0
    known = [(e, row) for e, row in rows if row.values.get(metric.id) is not None]
    known.sort(key=lambda pair: sign * (pair[1].values[metric.id] or 0.0))
    if metric.unit("all") is not None:
        return known[:MAX_SHOWN]
    kinds = [[pair for pair in known if pair[1].joint_type == kind] for kind in ("revolute", "prismatic")]
    return [pair for kind in kinds for pair in kind[: MAX_SHOWN // 2]]


def _notes_section(rows: Sequence[EntrantRow], board: Board) -> list[Section]:
    """Notes of scoring on measured rows: each once per method, with its sequences."""
    groups: dict[tuple[Entrant, str], list[str]] = {}
    for entrant, row in rows:
        for note in row.notes:
            groups.setdefault((entrant, note), []).append(row.sequence)
    lines = []
    for (entrant, note), names in groups.items():
        links = ", ".join(f'<a href="sequences/{board.files[n]}.html">{escape(n)}</a>' for n in names[:MAX_SHOWN])
        more = f" and {len(names) - MAX_SHOWN} more" if len(names) > MAX_SHOWN else ""
        lines.append(f"<li>{method_link(entrant, False)} <p>{escape(note)} <small>{links}{more}</small></p></li>")
    html = f'<ul class="remarked">{"".join(lines)}</ul>'
    return [Section("Measured, with a note", html, place="full")] if lines else []


def _card(entrant: Entrant, row: Row, file: str, thumb: bool, head: str, text: str) -> str:
    image = (
        f'<a href="sequences/{file}.html" tabindex="-1" aria-hidden="true">'
        f'<img src="thumbs/{file}.jpg" alt="" width="176" height="99" loading="lazy"></a>'
    ) * thumb
    words = f"<p>{escape(text)}</p>" if text else ""
    return (
        f'<li class="card">{image}<div><b>{escape(head)}</b><a href="sequences/{file}.html">'
        f"{escape(row.sequence)}</a>{method_link(entrant, False)}{words}</div></li>"
    )


def _cards(title: str, cards: Sequence[str], note: str) -> Section:
    """Cards under a note, which is HTML."""
    grid = f'<ul class="cards">{"".join(cards)}</ul>' if cards else ""
    return Section(title, f'<p class="note">{note}</p>{grid}', place="full")
