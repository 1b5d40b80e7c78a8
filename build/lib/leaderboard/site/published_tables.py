"""Tables as others published them: other objects, another protocol, never ranked."""

from __future__ import annotations

from freeart21.view.document import escape
from leaderboard.protocol import Group
from leaderboard.protocols import protocol_named
from leaderboard.published import PUBLISHED, PublishedRow
from leaderboard.site.html import NONE, section, table, unit_text


def published_section() -> str:
    """All published rows, a table a protocol, data set and joint type."""
    groups: dict[tuple[str, str, Group, str], list[PublishedRow]] = {}
    for row in PUBLISHED:
        groups.setdefault((row.protocol, row.dataset, row.group, row.source), []).append(row)
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


def _head(protocol: str, id: str, group: Group) -> str:
    """The head of a column: the number's name and unit."""
    metric = protocol_named(protocol).metric(id)
    arrow = "↑" if metric.direction == "up" else "↓"
    name = escape(metric.column.replace("\n", " ") or metric.label)
    unit = escape(unit_text(metric.unit(group)))
    return f'<th scope="col" class="number">{name} <small>{unit} {arrow}</small></th>'


def _cell(value: tuple[float, float | None] | None) -> str:
    if value is None:
        return NONE
    mean, std = value
    return f"<span>{mean:.2f}</span>" + ("" if std is None else f" <small>± {std:.2f}</small>")
