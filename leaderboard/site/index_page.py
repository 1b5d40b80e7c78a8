"""The front page: a ranking by every protocol, with every sequence below it, and published tables of other papers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

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
from leaderboard.points import FIRST, TRACK_TEXTS, TRACKS, Standing, row_points, standings
from leaderboard.protocols import Group, Metric, Protocol, protocol_named
from leaderboard.reference import is_outside_ranking
from leaderboard.site.entrant import Entrant
from leaderboard.site.html import (
    TABLES_ONLY,
    Board,
    columns,
    explained,
    facts,
    method_heads,
    method_link,
    metric_head,
    metric_name,
    page,
    sentence,
    sequence_link,
)
from leaderboard.site.published_tables import published_section

HIDDEN = (
    "The ground truth is hidden: shown are scores and the methods' results as they are. Joint states appear in means "
    "only, because the penalty of a failure is the true range of motion."
)
MIN_ROWS = 3
"""Rows from which mean and deviation do not reveal single values."""

Cell = tuple[float, float | None]
"""Mean and sample standard deviation, None for one row."""


@dataclass(frozen=True)
class Place:
    """One line of a ranking."""

    entrant: Entrant
    standings: dict[str, Standing]
    """By track (`leaderboard.points`), without tracks whose numbers it lacks."""
    cells: tuple[Cell | None, ...]
    """Of every column; None where it has no number."""
    measured: int
    sequences: int

    @property
    def text(self) -> str:
        """Its place in the first track; a dash where it has none."""
        whole = self.standings.get(FIRST)
        return NONE if whole is None else "ref." if whole.place is None else str(whole.place)


def index_page(board: Board) -> bytes:
    """The front page."""
    n, m, benchmark = len(board.entrants), len(board.sequences), board.benchmark
    frames = sum(s.facts.get("frames", 0) for s in board.sequences)
    truth = f'<code title="{escape(benchmark["sha256"])}">{escape(benchmark["sha256"][:12])}</code>'
    rows = [
        ("benchmark", escape(f"{benchmark['name']}, version {benchmark['version']}")),
        ("split", escape(benchmark["split"])),
        *([("frames", f"{frames:,}".replace(",", " "))] if frames else []),
        ("ground truth", f"{truth}, hidden" if benchmark.get("hidden") else truth),
    ]
    lead = (
        f"<p>{n} method{'s' * (n != 1)} on {m} RGB-D video{'s' * (m != 1)} of articulated objects that move freely in "
        "front of the camera. Each estimates the two parts, the joint, its state in every frame, and an asset for "
        f"simulation. A failure counts with a fixed penalty in every mean; none is left out.</p>{facts(rows)}"
    )
    lead += f'<p class="note">{HIDDEN}</p>' * bool(benchmark.get("hidden"))
    lead += f'<p class="note">{TABLES_ONLY}</p>' * (not frames)
    lead += "".join(f'<p class="note">{escape(text)}</p>' for text in describe_copies(board.entrants))
    lead += '<div class="protocols" data-protocols></div>' * (len(board.protocols) > 1)
    sections = [*(_ranking_section(board, name) for name in board.protocols), published_section()]
    return page(board, board.title, sections, here="index.html", lead=lead)


def describe_copies(methods: Sequence[Entrant]) -> list[str]:
    """A sentence for each pair of methods that hold the same files for some sequences."""
    of = [
        {row.sequence: row.result_sha256 for row in next(iter(e.scores.values())).rows if row.status == "ok"}
        for e in methods
    ]
    found = []
    for (one, own), (other, its) in combinations(zip(methods, of, strict=True), 2):
        same = sum(digest is not None and its.get(name) == digest for name, digest in own.items())
        if same:
            found.append(f"{one.name} and {other.name} hold the same files for {same} of {len(own)} sequences.")
    return found


def _ranking_section(board: Board, protocol: str) -> Section:
    rules = protocol_named(protocol)
    heads = columns(rules)
    places = ranked(protocol, board.entrants)
    titles = [metric_head(metric, group, True) for metric, group in heads]
    head = [
        column_head("#", sortable=True),
        column_head("method", sortable=True),
        column_head("measured", number=True, sortable=True),
        *(column_head(_track_head(track), number=True, sortable=True) for track in TRACKS),
        *(column_head(title, number=True, sortable=True) for title in titles),
    ]
    best = _best(places, heads)
    rows = [_line(place, heads, titles, best) for place in places]
    intro = (
        '<p class="note">Mean ± standard deviation over all sequences, failures with their penalty. Ordered by points: '
        "each number earns points on a fixed scale, in tracks for joint, geometry, views and the whole, whoever else "
        "takes part. A place is 1 plus the number of methods that are better beyond doubt (paired intervals over "
        "sequences; fewer than six tell nobody apart), so methods with one place are tied. "
        f'<a href="definitions.html#points">Points</a>, <a href="definitions.html#{protocol}">numbers</a>.</p>'
    )
    explain = '<p class="explain" aria-live="polite">Point at, focus or tap a column to read what it means.</p>'
    html = (
        f'<div class="filters"></div>{intro}{table(rows, head, "ranking", "ranking")}{explain}'
        f"<h3>Every sequence</h3>{_sequences(board, rules)}"
    )
    title = f"Ranking by {protocol}" if rules.ranking else f"By {protocol}: another protocol, not the ranking"
    return Section(title, html, "ranking", _data(board, rules), "full", id=f"protocol-{protocol}")


def ranked(protocol: str, entrants: Sequence[Entrant]) -> list[Place]:
    """All methods by their points on the whole; those that lack a number of it after the others, by their other points.

    The order of two methods depends on these two alone.
    """
    rules, heads = protocol_named(protocol), columns(protocol_named(protocol))
    references = frozenset(e.name for e in entrants if is_outside_ranking(e.method))
    tables = {entrant.name: entrant.whole[protocol] for entrant in entrants}
    found = {track: standings(tables, track, rules, references) for track in TRACKS}
    places = []
    for entrant in entrants:
        own = {track: of[entrant.name] for track, of in found.items() if entrant.name in of}
        cells = tuple(_cell(entrant, protocol, metric, group) for metric, group in heads)
        rows = entrant.scores[protocol].rows
        places.append(Place(entrant, own, cells, sum(row.status == "ok" for row in rows), len(rows)))

    def points(place: Place) -> tuple[float, ...]:
        return tuple(-place.standings[track].points if track in place.standings else 1.0 for track in TRACKS)

    return sorted(places, key=points)


def _track_head(track: str) -> str:
    return f"{track} <small>points {ARROWS['up'][0]}</small>"


def hidden_metrics(entrant: Entrant, rules: Protocol) -> tuple[str, ...]:
    """Ids of the metrics that are shown in means only, because the truth is hidden."""
    return rules.penalised_by_truth if entrant.scores[rules.name].benchmark.get("hidden") else ()


def _cell(entrant: Entrant, protocol: str, metric: Metric, group: str) -> Cell | None:
    rows = entrant.whole[protocol].rows
    values = [v for row in rows if group in ("all", row.joint_type) and (v := row.values.get(metric.id)) is not None]
    if len(values) < (MIN_ROWS if metric.id in hidden_metrics(entrant, protocol_named(protocol)) else 1):
        return None
    return float(np.mean(values)), float(np.std(values, ddof=1)) if len(values) > 1 else None


def _best(places: Sequence[Place], heads: Sequence[tuple[Metric, Any]]) -> list[float | None]:
    best: list[float | None] = []
    for k, (metric, _) in enumerate(heads):
        means = [cell[0] for place in places if (cell := place.cells[k]) is not None]
        best.append((max if metric.direction == "up" else min)(means) if len(set(means)) > 1 else None)
    return best


def _line(
    place: Place,
    heads: Sequence[tuple[Metric, Group]],
    titles: Sequence[str],
    best: Sequence[float | None],
) -> list[Markup]:
    """A row; the buttons with the columns' names in its cells are shown on narrow screens."""
    cells = []
    for (metric, group), title, cell, top in zip(heads, titles, place.cells, best, strict=True):
        unit = metric.unit(group)
        std = "" if cell is None or cell[1] is None else f"± {number_text(cell[1], unit)}"
        text = number_text(None if cell is None else cell[0], unit)
        html = f'<button type="button" class="what">{title}</button><span>{text}</span><small>{std}</small>'
        cells.append(value_cell(html, None, True, "number" + " best" * (cell is not None and cell[0] == top)))
    points = []
    for track in TRACKS:
        own = place.standings.get(track)
        text = number_text(None if own is None else own.points, "points")
        html = f'<button type="button" class="what">{_track_head(track)}</button><span>{text}</span><small></small>'
        points.append(value_cell(html, None, True, "number"))
    measured = f'<b class="what">measured</b><span>{place.measured} of {place.sequences}</span>'
    return [
        value_cell(place.text, css="place"),
        row_head(method_link(place.entrant, False)),
        value_cell(measured, None, True, "number measured"),
        *points,
        *cells,
    ]


def _first_metric(rules: Protocol) -> Metric:
    """The metric that the table of every sequence shows at first."""
    return next((m for m in rules.metrics if m.column and m.supplements is None), rules.metrics[0])


def _sequences(board: Board, rules: Protocol) -> str:
    """Every sequence with one number of every method; the scripts offer the other numbers."""
    metric = _first_metric(rules)
    rows = []
    for s in board.sequences:
        cells = []
        for entrant in board.entrants:
            row = entrant.row(rules.name, s.name)
            value = None if row is None else row.values.get(metric.id)
            more = "" if row is None or row.status == "ok" else f'<small class="failed">{escape(row.status)}</small>'
            cells.append(number_cell(number_text(value, metric.unit(s.facts["joint_type"]), True), more=more))
        rows.append([row_head(sequence_link(s, board)), s.facts["category"], s.facts["joint_type"], *cells])
    head = ["sequence", "category", "joint", *method_heads(board.entrants, False)]
    return f'<p class="note metric">{escape(metric.label)}</p>{table(rows, head, "every", "every sequence")}'


def _data(board: Board, rules: Protocol) -> dict[str, Any]:
    """Input of `static/ranking.js`."""
    entrants, shown = board.entrants, board.sequences
    metrics = [m for m in rules.metrics if any(e.row(rules.name, s.name) for e in entrants for s in shown)]
    at = {metric.id: k for k, metric in enumerate(metrics)}
    methods = []
    of = {place.entrant.name: place for place in ranked(rules.name, entrants)}
    hidden = any(hidden_metrics(e, rules) for e in entrants)
    for entrant in entrants:
        place, whole = of[entrant.name], {row.sequence: row for row in entrant.whole[rules.name].rows}
        rows = [entrant.row(rules.name, s.name) for s in shown]
        methods.append(
            {
                "name": entrant.name,
                "href": f"methods/{entrant.file}.html",
                "place": place.text,
                "points": {
                    track: [_short(row_points(whole[s.name], track, rules)) if s.name in whole else None for s in shown]
                    for track in place.standings
                    if not hidden
                },
                "status": [row.status if row else "missing" for row in rows],
                "values": [[_short(row.values.get(metric.id)) if row else None for metric in metrics] for row in rows],
            }
        )
    return {
        "protocol": rules.name,
        "columns": [
            {
                "track": track,
                "label": f"points, {track}",
                "explain": f"{sentence(TRACK_TEXTS[track])} 0 to 100, larger is better; a failure counts as 0.",
                "group": "all",
                "unit": "points",
                "up": True,
                "cells": [
                    (place.standings[track].points, None) if track in place.standings else None
                    for place in (of[entrant.name] for entrant in entrants)
                ]
                if hidden
                else None,
            }
            for track in TRACKS
        ]
        + [
            {
                "metric": at[m.id],
                "group": g,
                "unit": m.unit(g),
                "up": m.direction == "up",
                "cells": [_cell(e, rules.name, m, g) for e in entrants]
                if any(m.id in hidden_metrics(e, rules) for e in entrants)
                else None,
            }
            for m, g in columns(rules)
        ],
        "metrics": [
            {
                "id": m.id,
                "label": metric_name(m),
                "explain": explained(m),
                "units": {"revolute": m.revolute_unit, "prismatic": m.prismatic_unit},
                "up": m.direction == "up",
            }
            for m in metrics
        ],
        "first": at.get(_first_metric(rules).id, 0),
        "methods": methods,
        "sequences": [{"type": s.facts["joint_type"], "category": s.facts["category"]} for s in shown],
    }


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")
