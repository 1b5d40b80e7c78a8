"""Tables as others published them: other objects, another protocol, never ranked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from freeart21.view.document import escape
from leaderboard.protocols import PROTOCOLS
from leaderboard.site.html import NONE, section, table, unit_text


def published_rows() -> Sequence[Any]:
    """The rows of `leaderboard.published`, none when this version has no such tables."""
    try:
        from leaderboard.published import PUBLISHED  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        return ()
    return tuple(PUBLISHED)


def published_section() -> str:
    """All published rows, a table a protocol, data set and joint type; empty when there are none."""
    rows = published_rows()
    groups: dict[tuple[str, str, str, str], list[Any]] = {}
    for row in rows:
        groups.setdefault((row.protocol, row.dataset, row.group, str(row.source)), []).append(row)
    if not groups:
        return ""
    tables: list[str] = []
    for (protocol, dataset, group, source), members in groups.items():
        ids = list(dict.fromkeys(id for row in members for id in row.values))
        head = '<th scope="col">method</th>' + "".join(_head(protocol, id, group) for id in ids)
        lines = []
        for row in members:
            cells = "".join(f'<td class="number">{_cell(row.values.get(id))}</td>' for id in ids)
            lines.append(f'<tr><th scope="row">{escape(row.method)}</th>{cells}</tr>')
        tables.append(
            f"<details{' open' * (not tables)}><summary>{escape(dataset)}, {escape(group)}, nearest protocol "
            f"{escape(protocol)} <small>{escape(source)}</small></summary>"
            f"{table(f'{dataset}, {group}', 'published', head, ''.join(lines))}</details>"
        )
    return section(
        "As published",
        '<p class="note">Other objects, other videos: copied from the publication, not measured here, and never ranked '
        f"with the tables above. The protocol named is the one whose definitions come nearest.</p>{''.join(tables)}",
        id="published",
    )


def _head(protocol: str, id: str, group: str) -> str:
    """The head of a column: the number's name and unit where its protocol is known here."""
    if protocol not in PROTOCOLS:
        return f'<th scope="col" class="number">{escape(id)}</th>'
    metric = PROTOCOLS[protocol].metric(id)
    unit = metric.unit(group)  # type: ignore[arg-type]
    arrow = "↑" if metric.direction == "up" else "↓"
    name = escape(metric.column.replace("\n", " ") or metric.label)
    return f'<th scope="col" class="number">{name} <small>{escape(unit_text(unit))} {arrow}</small></th>'


def _cell(value: Any) -> str:
    if value is None:
        return NONE
    mean, std = value if isinstance(value, tuple) else (value, None)
    return f"<span>{mean:.2f}</span>" + ("" if std is None else f" <small>± {std:.2f}</small>")
