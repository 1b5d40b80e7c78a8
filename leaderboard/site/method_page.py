"""The page of a method: what it says of itself, where its numbers come from, its means, and every sequence."""

from __future__ import annotations

import json
from collections.abc import Sequence

from freeart21.view.document import escape
from leaderboard.protocols import Protocol, protocol_named
from leaderboard.rows import Scores
from leaderboard.site.entrant import Entrant
from leaderboard.site.html import NONE, columns, facts, mark, number, page, section, unit_text
from leaderboard.site.index_page import sequence_link
from leaderboard.site.provenance import provenance
from leaderboard.site.sequence_data import Shown
from leaderboard.site.sequence_page import WORDS


def method_page(
    site: str, entrant: Entrant, protocols: Sequence[str], shown: Sequence[Shown], files: dict[str, str]
) -> bytes:
    """The page of one method."""
    method = entrant.method
    first = entrant.scores[protocols[0]]
    lead = facts(
        [
            ("code", escape(method.code) or "not said"),
            ("hardware", escape(method.hardware) or "not said"),
            ("measured", f"{first.measured} of {len(first.rows)} sequences"),
            ("time", _time(first)),
        ]
    )
    lacks = [WORDS[piece] for piece in method.lacks]
    notice = ""
    if lacks:
        told = " and ".join([", ".join(lacks[:-1]), lacks[-1]] if len(lacks) > 1 else lacks)
        notice = f'<p class="notice">It {escape(told)}: numbers that need them are left out ({NONE}), never priced.</p>'
    notes = "".join(f'<p class="notice">{escape(note)}</p>' for note in dict.fromkeys(first.notes))
    tables = "".join(_protocol(entrant, protocol_named(name), shown, files) for name in protocols)
    settings = json.dumps(method.settings, indent=2, ensure_ascii=True, sort_keys=True) if method.settings else ""
    own = f"<pre tabindex=0>{escape(settings)}</pre>" if settings else '<p class="note">It says none.</p>'
    traced = "".join(
        f"<h3>By {escape(name)}</h3>{facts(provenance(entrant.scores[name]))}"
        f'<p class="note"><a href="../scores/{entrant.file}.{name}.json">Every number as JSON</a>, '
        f'<a href="../scores/{entrant.file}.{name}.csv">as CSV</a></p>'
        for name in protocols
    )
    main = f"{notice}{notes}{tables}{section('Settings, by its own word', own)}{section('Where these numbers come from', traced, id='provenance')}"
    return page(entrant.name, main, site, True, lead=lead, kind="Method", icon=mark(entrant))


def _time(scores: Scores) -> str:
    seconds = sorted(row.seconds for row in scores.rows if row.seconds is not None)
    if not seconds:
        return "not said"
    return f"{seconds[len(seconds) // 2]:.0f} s a sequence (median, by its own word)"


def _protocol(entrant: Entrant, rules: Protocol, shown: Sequence[Shown], files: dict[str, str]) -> str:
    scores = entrant.scores[rules.name]
    return section(
        f"By {rules.name}",
        f"{_means(scores, rules)}<h3>Every sequence</h3>{_rows(entrant, rules, shown, files)}",
        "sortable",
        id=f"protocol-{rules.name}",
    )


def _means(scores: Scores, rules: Protocol) -> str:
    groups = scores.summaries
    head = "".join(
        f'<th scope="col" class="number">{escape(s.group)} <small>{s.sequences - s.failures} of {s.sequences}</small></th>'
        for s in groups
    )
    lines = []
    for metric in rules.metrics:
        cells, any_value = [], False
        for summary in groups:
            unit, found = metric.unit(summary.group), summary.statistics.get(metric.id)
            if unit is None or found is None:
                cells.append(f'<td class="number" data-value=""><span>{NONE}</span></td>')
                continue
            any_value = True
            std = "" if found.std is None else f" <small>± {number(found.std, unit)}</small>"
            rest = f"<small>median {number(found.median, unit)}, worst {number(found.worst, unit)}</small>"
            cells.append(f'<td class="number" data-value="{found.mean!r}"><span>{number(found.mean, unit, True)}</span>{std}{rest}</td>')
        if any_value:
            arrow = "↑" if metric.direction == "up" else "↓"
            name = f'<a href="../definitions.html#{rules.name}.{metric.id}">{escape(metric.label or metric.id)}</a>'
            lines.append(f'<tr class="{"beside" if metric.beside else ""}"><th scope="row">{name} <small>{arrow}</small></th>{"".join(cells)}</tr>')
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="means, scrolls sideways"><table class="numbers means"><thead><tr>'
        f'<th scope="col">mean ± standard deviation</th>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'
    )


def _rows(entrant: Entrant, rules: Protocol, shown: Sequence[Shown], files: dict[str, str]) -> str:
    heads = list(dict.fromkeys(metric.id for metric, _ in columns(rules) if metric.column))
    metrics = [rules.metric(id) for id in heads]
    names = ["sequence", "joint", "", *(m.column.replace("\n", " ") for m in metrics), "s"]
    head = "".join(
        f'<th scope="col"{" class=number" if k > 2 else ""}><button type="button">{escape(name) or "status"}</button>'
        + (f" <small>{escape(unit_text(metrics[k - 3].unit('all')))} {'↑' if metrics[k - 3].direction == 'up' else '↓'}</small>" if 3 <= k < 3 + len(metrics) else "")
        + "</th>"
        for k, name in enumerate(names)
    )
    lines = []
    for s in shown:
        row = entrant.row(rules.name, s.name)
        if row is None:
            continue
        wrong = row.status == "ok" and row.values.get("joint_type") == 0
        word = row.status if row.status != "ok" else "wrong type" if wrong else "files" if row.measured_from == "files" else "ok"
        cells = []
        for metric in metrics:
            value, unit = row.values.get(metric.id), metric.unit(row.joint_type)
            signed = metric.unit("all") is None
            cells.append(f'<td class="number" data-value="{"" if value is None else repr(value)}">{number(value, unit, signed)}</td>')
        took = "" if row.seconds is None else f"{row.seconds:.0f}"
        failed = ' class="failed"' if row.status != "ok" or wrong else ""
        lines.append(
            f'<tr><th scope="row" data-value="{escape(s.name)}">{sequence_link(s, files, True)}</th><td>{escape(row.joint_type)}</td>'
            f'<td{failed} title="{escape(row.reason)}">{escape(word)}</td>{"".join(cells)}<td class="number">{took or NONE}</td></tr>'
        )
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="every sequence, scrolls sideways"><table class="rows"><thead>'
        f"<tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )
