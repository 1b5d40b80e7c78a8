"""Tables from publications: measured by others, on other objects or by other protocols; never ranked."""

from __future__ import annotations

from freeart21.view.document import Section, escape
from freeart21.view.tables import NONE, column_head, number_cell, table
from leaderboard.protocol import Group
from leaderboard.protocols import protocol_named
from leaderboard.published import PUBLISHED, PublishedRow
from leaderboard.site.html import metric_head


def published_section() -> Section:
    """A table for every protocol, data set, joint type and source."""
    groups: dict[tuple[str, str, Group, str], list[PublishedRow]] = {}
    for row in PUBLISHED:
        groups.setdefault((row.protocol, row.dataset, row.group, row.source), []).append(row)
    html = (
        '<p class="note">Copied from publications, on other objects and videos; not measured here and not ranked with '
        "the tables above. The protocol named is the one with the closest definitions.</p>"
    )
    for k, ((protocol, dataset, group, source), members) in enumerate(groups.items()):
        ids = list(dict.fromkeys(id for row in members for id in row.values))
        rules = protocol_named(protocol)
        head = ["method", *(column_head(metric_head(rules.metric(id), group), number=True) for id in ids)]
        rows = [[row.method, *(number_cell(*_texts(row.values.get(id))) for id in ids)] for row in members]
        html += (
            f"<details{' open' * (k == 0)}><summary>{escape(dataset)}, {escape(group)}, closest protocol "
            f"{escape(protocol)} <small>{escape(source)}</small></summary>"
            f"{table(rows, head, 'published', f'{dataset}, {group}')}</details>"
        )
    return Section("As published", html, place="full", id="published")


def _texts(value: tuple[float, float | None] | None) -> tuple[str, bool, None, str]:
    """Arguments of `number_cell` for mean and standard deviation."""
    if value is None:
        return NONE, False, None, ""
    mean, std = value
    return f"{mean:.2f}", False, None, "" if std is None else f" <small>± {std:.2f}</small>"
