"""What went wrong, first: rows that could not be measured with their reasons, then the worst rows by every number."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from freeart21.view.document import escape
from leaderboard.protocols import Metric, protocol_named
from leaderboard.rows import Row
from leaderboard.site.entrant import Entrant
from leaderboard.site.html import explained, method_link, number, page, section
from leaderboard.site.sequence_data import Shown

WORST = 6
"""Rows shown a number."""


def failures_page(
    site: str, entrants: Sequence[Entrant], protocol: str, shown: Sequence[Shown], files: dict[str, str]
) -> bytes:
    """The page, by one protocol."""
    rules = protocol_named(protocol)
    rows = [(e, row) for e in entrants for row in e.scores[protocol].rows if row.sequence in files]
    pictures = {s.name for s in shown if s.thumb}
    lost = [(e, row) for e, row in rows if row.status != "ok"]
    wrong = [(e, row) for e, row in rows if row.status == "ok" and row.values.get("joint_type") == 0]
    sections = [
        _cards(
            f"Not measured: {len(lost)} of {len(rows)}",
            [_card(e, row, files, pictures, row.status, row.reason) for e, row in lost],
            "Every one stands in all means at the price of a failure.",
            "Every row of every method could be measured.",
        ),
        _cards(
            f"The wrong kind of joint: {len(wrong)}",
            [_card(e, row, files, pictures, "wrong type", row.notes[0] if row.notes else "") for e, row in wrong],
            "Axis, place and state are priced; masks, poses and surfaces count as they are.",
            "Every measured row has the right kind of joint.",
        ),
    ]
    measured = [(e, row) for e, row in rows if row.status == "ok"]
    for metric in rules.metrics:
        if metric.supplements is None and metric.column and (worst := _worst(metric, measured)):
            cards = [
                _card(e, row, files, pictures, number(row.values[metric.id], metric.unit(row.joint_type), True), "")
                for e, row in worst
            ]
            sections.append(
                _cards(f"Worst by {metric.label}", cards, escape(explained(metric)), "", rules.name, metric.id)
            )
    sections.append(_remarks(measured, files))
    lead = f"<p>The worst rows by {escape(protocol)}, failures first. What a number hides, its page shows.</p>"
    return page("Failures first", "".join(sections), site, here="failures.html", lead=lead)


def _worst(metric: Metric, rows: Sequence[tuple[Entrant, Row]]) -> list[tuple[Entrant, Row]]:
    """The worst measured rows by one number: of each unit by itself, as their price says how much is much."""
    known = [(e, row) for e, row in rows if row.values.get(metric.id) is not None]
    if metric.unit("all") is None:
        kinds = [[p for p in known if p[1].joint_type == kind] for kind in ("revolute", "prismatic")]
        return [pair for kind in kinds for pair in _ordered(metric, kind)[: WORST // 2]]
    return _ordered(metric, known)[:WORST]


def _ordered(metric: Metric, rows: Sequence[tuple[Entrant, Row]]) -> list[tuple[Entrant, Row]]:
    sign = 1.0 if metric.direction == "up" else -1.0
    return sorted(rows, key=lambda pair: sign * (pair[1].values[metric.id] or 0.0))


def _remarks(rows: Sequence[tuple[Entrant, Row]], files: dict[str, str]) -> str:
    """What scoring remarks on measured rows, each remark once a method with the sequences that it is of."""
    groups: dict[tuple[Entrant, str], list[str]] = {}
    for entrant, row in rows:
        for note in row.notes:
            groups.setdefault((entrant, note), []).append(row.sequence)
    if not groups:
        return ""
    lines = []
    for (entrant, note), names in groups.items():
        some = ", ".join(f'<a href="sequences/{files[n]}.html">{escape(n)}</a>' for n in names[:WORST])
        more = f" and {len(names) - WORST} more" if len(names) > WORST else ""
        lines.append(f"<li>{method_link(entrant, False)} <p>{escape(note)} <small>{some}{more}</small></p></li>")
    return section("Measured, with a remark", f'<ul class="remarked">{"".join(lines)}</ul>')


def _card(entrant: Entrant, row: Row, files: dict[str, str], pictures: Collection[str], head: str, text: str) -> str:
    file = files[row.sequence]
    picture = (
        f'<a href="sequences/{file}.html" tabindex="-1" aria-hidden="true">'
        f'<img src="thumbs/{file}.jpg" alt="" width="176" height="99" loading="lazy"></a>'
        if row.sequence in pictures
        else ""
    )
    words = f"<p>{escape(text)}</p>" if text else ""
    return (
        f'<li class="card">{picture}<div><b>{escape(head)}</b><a href="sequences/{file}.html">'
        f"{escape(row.sequence)}</a>{method_link(entrant, False)}{words}</div></li>"
    )


def _cards(title: str, cards: Sequence[str], note: str, empty: str, protocol: str = "", metric: str = "") -> str:
    if not cards:
        return section(title, f'<p class="note">{empty}</p>')
    more = f' <a href="definitions.html#{protocol}.{metric}">Definition</a>' if metric else ""
    return section(title, f'<p class="note">{note}{more}</p><ul class="cards">{"".join(cards)}</ul>')
