"""The page of a method: what it says of itself, where its numbers come from, its means, and every sequence."""

from __future__ import annotations

import json
from collections.abc import Sequence

from freeart21.view.document import escape
from leaderboard.protocols import Metric, Protocol, protocol_named
from leaderboard.rows import Row, Scores, Summary
from leaderboard.site.entrant import Entrant
from leaderboard.site.html import (
    NONE,
    columns,
    facts,
    mark,
    metric_row,
    number,
    number_cell,
    page,
    section,
    table,
    unit_text,
)
from leaderboard.site.index_page import FEWEST, hidden_metrics, sequence_link
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
    own = section("Settings, by its own word", own)
    traced = section("Where these numbers come from", traced, id="provenance")
    main = f"{notice}{notes}{tables}{own}{traced}"
    return page(entrant.name, main, site, True, lead=lead, kind="Method", icon=mark(entrant))


def _time(scores: Scores) -> str:
    seconds = sorted(row.seconds for row in scores.rows if row.seconds is not None)
    if not seconds:
        return "not said"
    return f"{seconds[len(seconds) // 2]:.0f} s a sequence (median, by its own word)"


def _protocol(entrant: Entrant, rules: Protocol, shown: Sequence[Shown], files: dict[str, str]) -> str:
    return section(
        f"By {rules.name}",
        f"{_means(entrant, rules)}<h3>Every sequence</h3>{_rows(entrant, rules, shown, files)}",
        "sortable",
        id=f"protocol-{rules.name}",
    )


def _means(entrant: Entrant, rules: Protocol) -> str:
    """Every number over each joint type and over all: mean and standard deviation, median and worst."""
    groups, hidden = entrant.whole[rules.name].summaries, hidden_metrics(entrant, rules)
    head = '<th scope="col">mean ± standard deviation</th>' + "".join(
        f'<th scope="col" class="number">{s.group} <small>{s.sequences - s.failures} of {s.sequences}</small></th>'
        for s in groups
    )
    lines = []
    for metric in rules.metrics:
        cells = [_mean(metric, summary, metric.id in hidden) for summary in groups]
        if any(NONE not in cell for cell in cells):
            lines.append(metric_row(rules, metric, "".join(cells)))
    return table("means", "numbers means", head, "".join(lines))


def _mean(metric: Metric, summary: Summary, hidden: bool) -> str:
    """A cell; `hidden` where it must not tell the number of any one sequence."""
    unit, found = metric.unit(summary.group), summary.statistics.get(metric.id)
    if unit is None or found is None or (hidden and found.sequences < FEWEST):
        return number_cell(NONE)
    std = "" if found.std is None else f' <small class="std">± {number(found.std, unit)}</small>'
    rest = "" if hidden else f"<small>median {number(found.median, unit)}, worst {number(found.worst, unit)}</small>"
    return number_cell(number(found.mean, unit, True), more=std + rest)


def _rows(entrant: Entrant, rules: Protocol, shown: Sequence[Shown], files: dict[str, str]) -> str:
    """Every sequence with the ranking numbers; sorted by a click on a heading."""
    metrics = list({metric.id: metric for metric, _ in columns(rules) if metric.column}.values())
    head = _sortable("sequence") + _sortable("joint") + _sortable("status")
    for metric in metrics:
        arrow = "↑" if metric.direction == "up" else "↓"
        unit = f" <small>{escape(unit_text(metric.unit('all')))} {arrow}</small>"
        head += _sortable(metric.column.replace("\n", " "), unit, ' class="number"')
    head += _sortable("s", "", ' class="number"')
    lines = []
    for s in shown:
        row = entrant.row(rules.name, s.name)
        if row is not None:
            lines.append(_line(row, metrics, sequence_link(s, files, True)))
    return table("every sequence", "rows", head, "".join(lines))


def _sortable(name: str, more: str = "", attributes: str = "") -> str:
    return f'<th scope="col"{attributes}><button type="button">{escape(name)}</button>{more}</th>'


def _line(row: Row, metrics: Sequence[Metric], link: str) -> str:
    wrong = row.status == "ok" and row.values.get("joint_type") == 0
    word = "wrong type" if wrong else "files" if row.status == "ok" and row.measured_from == "files" else row.status
    failed = ' class="failed"' if row.status != "ok" or wrong else ""
    cells = []
    for metric in metrics:
        value, unit = row.values.get(metric.id), metric.unit(row.joint_type)
        cells.append(number_cell(number(value, unit, metric.unit("all") is None), value=value))
    took = NONE if row.seconds is None else f"{row.seconds:.0f}"
    return (
        f'<tr><th scope="row" data-value="{escape(row.sequence)}">{link}</th><td>{escape(row.joint_type)}</td>'
        f'<td{failed} title="{escape(row.reason)}">{escape(word)}</td>{"".join(cells)}'
        f"{number_cell(took, value=row.seconds)}</tr>"
    )
