"""Tables as others published them: other objects, another protocol, never ranked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from freeart21.view.document import escape
from leaderboard.site.html import NONE, section


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
    groups: dict[tuple[str, str, str], list[Any]] = {}
    for row in rows:
        groups.setdefault((row.protocol, row.dataset, row.group), []).append(row)
    if not groups:
        return ""
    tables = []
    for (protocol, dataset, group), members in groups.items():
        ids = list(dict.fromkeys(id for row in members for id in row.values))
        head = "".join(f'<th scope="col" class="number">{escape(id)}</th>' for id in ids)
        lines = []
        for row in members:
            cells = "".join(f'<td class="number">{_cell(row.values.get(id))}</td>' for id in ids)
            lines.append(f'<tr><th scope="row">{escape(row.method)}</th>{cells}</tr>')
        tables.append(
            f"<h3>{escape(dataset)}, {escape(group)}, protocol {escape(protocol)}</h3>"
            f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(dataset)}, {escape(group)}"><table>'
            f'<thead><tr><th scope="col">method</th>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'
        )
    origins = "; ".join(dict.fromkeys(escape(str(row.source)) for row in rows))
    return section(
        "As published",
        '<p class="note">Other objects, other videos, protocol as named: copied from the publication, not measured '
        f"here, and not to be ranked with the tables above. Source: {origins}.</p>{''.join(tables)}",
        id="published",
    )


def _cell(value: Any) -> str:
    if value is None:
        return NONE
    mean, std = value if isinstance(value, tuple) else (value, None)
    return f"<span>{mean:g}</span>" + ("" if std is None else f"<small>± {std:g}</small>")
