"""The page of a method: its own facts, means, every sequence, settings, and the provenance of its numbers."""

from __future__ import annotations

import json
from collections.abc import Sequence

from freeart21.view.document import Markup, Section, render
from freeart21.view.tables import NONE, Cell, number_cell, number_text, source_rows, table
from leaderboard.protocols import Protocol, protocol_named
from leaderboard.rows import Statistic
from leaderboard.site.common import (
    LACKS,
    PACKAGE,
    Board,
    columns,
    facts,
    hidden_metrics,
    metric_head,
    metric_row_head,
    page,
    score_cell,
    sequence_link,
    statistic_of,
)
from leaderboard.site.entrant import Entrant


def method_page(board: Board, entrant: Entrant) -> bytes:
    """The page of one method."""
    method, first = entrant.method, entrant.scores[board.protocols[0]]
    seconds = sorted(row.seconds for row in first.rows if row.seconds is not None)
    median = [f"{one:.0f} s per sequence (median, stated by the method)" for one in seconds[len(seconds) // 2 :]]
    lead = facts(
        [
            ("code", method.code or "not stated"),
            ("hardware", method.hardware or "not stated"),
            ("measured", f"{first.measured} of {len(first.rows)} sequences"),
            ("time", next(iter(median), "not stated")),
        ]
    )
    notices = list(dict.fromkeys(first.notes))
    if method.lacks:
        names = " and ".join(LACKS[piece] for piece in method.lacks)
        notices.insert(0, f"This method {names}: numbers that need them are left out ({NONE}), without a penalty.")
    settings = json.dumps(method.settings, indent=2, ensure_ascii=True, sort_keys=True) if method.settings else ""
    own = Markup("<pre tabindex=0>{}</pre>").format(settings or "not stated")
    sections = []
    for rules in map(protocol_named, board.protocols):
        html = _means(entrant, rules) + Markup("<h3>Every sequence</h3>") + _sequences(board, entrant, rules)
        sections.append(Section(f"Scores by {rules.name}", html, place="full", id=f"protocol-{rules.name}"))
    sections += [
        Section("Settings, as stated by the method", own, place="full"),
        Section("Provenance", _provenance(entrant, board.protocols), place="full", id="provenance"),
    ]
    return page(board, entrant.name, sections, deep=True, lead=lead, kind="Method", notices=notices)


def _means(entrant: Entrant, rules: Protocol) -> Markup:
    """Every number by joint type and over all: mean and standard deviation, median and worst."""
    groups, rows, css = entrant.whole[rules.name].summaries, [], []
    head: list[object] = ["mean ± standard deviation"]
    head += [Cell(g.group, None, "number", f"{g.sequences - g.failures} of {g.sequences}") for g in groups]
    for metric in rules.metrics:
        found = {summary.group: statistic_of(entrant, rules, metric, summary.group) for summary in groups}
        cells = [
            _mean(statistic, metric.unit(group), metric.id in hidden_metrics(entrant, rules))
            for group, statistic in found.items()
        ]
        if any(cell.text != NONE for cell in cells):
            rows.append([metric_row_head(rules, metric), *cells])
            css.append("beside" if metric.supplements else "")
    return table(rows, head, "numbers", "means", css)


def _mean(found: Statistic | None, unit: str | None, hidden: bool) -> Cell:
    """A cell; when `hidden` it must not reveal the number of a single sequence."""
    if unit is None or found is None:
        return number_cell(NONE)
    below = [] if found.std is None else [f"± {number_text(found.std, unit)}"]
    if not hidden:
        below += [f"median {number_text(found.median, unit)}", f"worst {number_text(found.worst, unit)}"]
    return number_cell(number_text(found.mean, unit, True), below=", ".join(below))


def _sequences(board: Board, entrant: Entrant, rules: Protocol) -> Markup:
    """Every sequence with the ranking numbers, sortable."""
    metrics = list({metric.id: metric for metric, _ in columns(rules) if metric.column}.values())
    head = ["sequence", "joint", "status", *(metric_head(metric, "all") for metric in metrics), Cell("s", css="number")]
    rows = []
    for s in board.sequences:
        row = entrant.row(rules.name, s.name)
        if row is None:
            continue
        wrong = row.status == "ok" and row.values.get("joint_type") == 0
        word = "files" if row.status == "ok" and row.measured_from == "files" else row.status
        seconds = number_cell(NONE if row.seconds is None else f"{row.seconds:.0f}", value=row.seconds)
        status = Cell("wrong type" if wrong else word, css="failed" * (row.status != "ok" or wrong), title=row.reason)
        cells = [score_cell(row, metric, row.joint_type, metric.unit("all") is None) for metric in metrics]
        link = Cell(sequence_link(s.name, board, True), row.sequence)
        rows.append([link, row.joint_type, status, *cells, seconds])
    return table(rows, head, "sortable", "every sequence")


def _provenance(entrant: Entrant, protocols: Sequence[str]) -> Markup:
    """Benchmark, code, libraries and machine behind every table, with the tables as files."""
    found = []
    for name in protocols:
        scores, benchmark = entrant.scores[name], entrant.scores[name].benchmark
        rows = [
            ("benchmark", f"{benchmark['name']}, version {benchmark['version']}, {benchmark['split']}"),
            ("benchmark.json", benchmark["sha256"]),
            ("protocol", scores.protocol),
            *source_rows(scores.made_with),
        ]
        found.append((name, facts(rows)))
    return render("provenance.html.j2", PACKAGE, tables=found, file=entrant.file)
