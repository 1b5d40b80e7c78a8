"""The page of a method: its own facts, means, every sequence, settings, and the provenance of its numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from freeart21.view.document import Section, escape
from freeart21.view.tables import (
    ARROWS,
    NONE,
    Markup,
    column_head,
    number_cell,
    number_text,
    row_head,
    table,
    value_cell,
)
from leaderboard.protocols import Metric, Protocol, protocol_named
from leaderboard.rows import Row, Scores, Summary
from leaderboard.site.entrant import Entrant
from leaderboard.site.html import (
    Board,
    columns,
    facts,
    hash_text,
    mark,
    metric_row_head,
    missing,
    page,
    sequence_link,
    unit_text,
)
from leaderboard.site.index_page import MIN_ROWS, hidden_metrics
from leaderboard.site.sequence_data import LACKS


def method_page(board: Board, entrant: Entrant) -> bytes:
    """The page of one method."""
    method, protocols = entrant.method, board.protocols
    first = entrant.scores[protocols[0]]
    lead = facts(
        [
            ("code", escape(method.code) or "not stated"),
            ("hardware", escape(method.hardware) or "not stated"),
            ("measured", f"{first.measured} of {len(first.rows)} sequences"),
            ("time", _time_text(first)),
        ]
    )
    notices = list(dict.fromkeys(first.notes))
    if method.lacks:
        *some, last = [LACKS[piece] for piece in method.lacks]
        names = f"{', '.join(some)} and {last}" if some else last
        notices.insert(0, f"This method {names}: numbers that need them are left out ({NONE}), without a penalty.")
    settings = json.dumps(method.settings, indent=2, ensure_ascii=True, sort_keys=True) if method.settings else ""
    own = f"<pre tabindex=0>{escape(settings)}</pre>" if settings else '<p class="note">Not stated.</p>'
    sections = [
        *(_protocol_section(board, entrant, protocol_named(name)) for name in protocols),
        Section("Settings, as stated by the method", own, place="full"),
        Section("Provenance", _provenance(entrant, protocols), place="full", id="provenance"),
    ]
    return page(board, entrant.name, sections, deep=True, lead=lead, kind="Method", icon=mark(entrant), notices=notices)


def _time_text(scores: Scores) -> str:
    seconds = sorted(row.seconds for row in scores.rows if row.seconds is not None)
    if not seconds:
        return "not stated"
    return f"{seconds[len(seconds) // 2]:.0f} s per sequence (median, stated by the method)"


def _protocol_section(board: Board, entrant: Entrant, rules: Protocol) -> Section:
    html = f"{_means(entrant, rules)}<h3>Every sequence</h3>{_sequences(board, entrant, rules)}"
    return Section(f"Scores by {rules.name}", html, place="full", id=f"protocol-{rules.name}")


def _means(entrant: Entrant, rules: Protocol) -> str:
    """Every number by joint type and over all: mean and standard deviation, median and worst."""
    groups, hidden = entrant.whole[rules.name].summaries, hidden_metrics(entrant, rules)
    head = ["mean ± standard deviation"]
    for group in groups:
        measured = f"<small>{group.sequences - group.failures} of {group.sequences}</small>"
        head.append(column_head(f"{group.group} {measured}", number=True))
    rows = []
    for metric in rules.metrics:
        cells = [_mean(metric, summary, metric.id in hidden) for summary in groups]
        if any(NONE not in cell for cell in cells):
            rows.append((metric, [metric_row_head(rules, metric), *cells]))
    css = ["beside" if metric.supplements else "" for metric, _ in rows]
    return table([row for _, row in rows], head, "numbers means", "means", css)


def _mean(metric: Metric, summary: Summary, hidden: bool) -> Markup:
    """A cell; when `hidden` it must not reveal the number of a single sequence."""
    unit, found = metric.unit(summary.group), summary.statistics.get(metric.id)
    if unit is None or found is None or (hidden and found.sequences < MIN_ROWS):
        return number_cell(NONE)
    more = "" if found.std is None else f' <small class="std">± {number_text(found.std, unit)}</small>'
    if not hidden:
        more += f"<small>median {number_text(found.median, unit)}, worst {number_text(found.worst, unit)}</small>"
    return number_cell(number_text(found.mean, unit, True), more=more)


def _sequences(board: Board, entrant: Entrant, rules: Protocol) -> str:
    """Every sequence with the ranking numbers, sortable."""
    metrics = list({metric.id: metric for metric, _ in columns(rules) if metric.column}.values())
    head = [column_head(text, sortable=True) for text in ("sequence", "joint", "status")]
    for metric in metrics:
        unit = f" <small>{escape(unit_text(metric.unit('all')))} {ARROWS[metric.direction][0]}</small>"
        head.append(column_head(escape(metric.column.replace("\n", " ")), True, True, unit))
    head.append(column_head("s", True, True))
    rows = []
    for s in board.sequences:
        row = entrant.row(rules.name, s.name)
        if row is not None:
            rows.append(_line(row, metrics, sequence_link(s, board, True)))
    return table(rows, head, "sortable", "every sequence")


def _line(row: Row, metrics: Sequence[Metric], link: str) -> list[str]:
    wrong = row.status == "ok" and row.values.get("joint_type") == 0
    word = "wrong type" if wrong else "files" if row.status == "ok" and row.measured_from == "files" else row.status
    status = f'<span title="{escape(row.reason)}">{escape(word)}</span>'
    cells = []
    for metric in metrics:
        value, unit = row.values.get(metric.id), metric.unit(row.joint_type)
        cells.append(number_cell(number_text(value, unit, metric.unit("all") is None), value=value))
    took = NONE if row.seconds is None else f"{row.seconds:.0f}"
    return [
        row_head(link, row.sequence),
        value_cell(row.joint_type),
        value_cell(status, word, True, "failed" if row.status != "ok" or wrong else ""),
        *cells,
        number_cell(took, value=row.seconds),
    ]


def _provenance(entrant: Entrant, protocols: Sequence[str]) -> str:
    """Benchmark, code, libraries and machine behind every table, with the tables as files."""
    html = ""
    for name in protocols:
        scores, benchmark = entrant.scores[name], entrant.scores[name].benchmark
        rows = [
            ("benchmark", escape(f"{benchmark['name']}, version {benchmark['version']}, {benchmark['split']}")),
            ("benchmark.json", hash_text(benchmark["sha256"])),
            ("protocol", escape(scores.protocol)),
            *_nested_facts("", scores.made_with),
        ]
        html += (
            f'<h3>By {escape(name)}</h3>{facts(rows)}<p class="note">'
            f'<a href="../scores/{entrant.file}.{name}.json">Every number as JSON</a>, '
            f'<a href="../scores/{entrant.file}.{name}.csv">as CSV</a></p>'
        )
    return html


def _nested_facts(before: str, given: Mapping[str, Any]) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in given.items():
        name = f"{before} {key}".strip().replace("_", " ")
        if isinstance(value, Mapping):
            rows += _nested_facts(name, value)
        elif isinstance(value, str) and len(value) == 64 and set(value) <= set("0123456789abcdef"):
            rows.append((name, hash_text(value)))
        else:
            rows.append((name, missing(value)))
    return rows
