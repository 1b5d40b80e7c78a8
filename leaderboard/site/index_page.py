"""The front page: a ranking a protocol, every sequence below it, and tables as others published them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from freeart21.view.document import escape
from leaderboard.protocols import Group, Metric, Protocol, protocol_named
from leaderboard.site.entrant import Entrant
from leaderboard.site.html import (
    NONE,
    columns,
    explained,
    facts,
    method_link,
    number,
    number_cell,
    page,
    section,
    table,
    unit_text,
)
from leaderboard.site.published_tables import published_section
from leaderboard.site.sequence_data import Shown

RANKING = "strict-2"
"""The protocol whose table is the ranking; all others are tables of their own."""


HIDDEN = (
    "The truth is hidden: shown are scores, and the methods' answers as they are. Joint states are scored in the means "
    "alone, as the price of a failed one is the true range of motion."
)
TABLES_ALONE = "Made of tables of scores alone: without the videos and the methods' answers."
FEWEST = 3
"""Rows of which a mean and its deviation do not tell the single values."""


@dataclass(frozen=True)
class Place:
    """One line of a ranking."""

    entrant: Entrant
    rank: float | None
    """Mean of its places over all columns; None when it lacks one."""
    cells: tuple[tuple[float, float | None] | None, ...]
    """Mean and sample standard deviation a column; None where it has no number."""
    measured: int
    sequences: int


def index_page(
    site: str,
    entrants: Sequence[Entrant],
    protocols: Sequence[str],
    shown: Sequence[Shown],
    files: dict[str, str],
    benchmark: dict[str, str],
) -> bytes:
    """The front page; `files` says by which file name a sequence goes."""
    frames = sum(s.facts.get("frames", 0) for s in shown)
    truth = f'<code title="{escape(benchmark["sha256"])}">{escape(benchmark["sha256"][:12])}</code>'
    lead = (
        f"<p>{len(entrants)} method{'s' * (len(entrants) != 1)} on {len(shown)} video{'s' * (len(shown) != 1)} of "
        "articulated objects that move freely before a camera: find the two parts, the joint, its state in every "
        "frame, and an asset to simulate. Failures are priced, never dropped.</p>"
    )
    lead += facts(
        [
            ("benchmark", escape(f"{benchmark['name']}, version {benchmark['version']}")),
            ("split", escape(benchmark["split"])),
            *([("frames", f"{frames:,}".replace(",", " "))] if frames else []),
            ("truth", f"{truth}, hidden" if benchmark.get("hidden") else truth),
        ]
    )
    if benchmark.get("hidden"):
        lead += f'<p class="note">{HIDDEN}</p>'
    if not frames:
        lead += f'<p class="note">{TABLES_ALONE}</p>'
    chooser = '<div class="protocols" data-protocols></div>' if len(protocols) > 1 else ""
    sections = [_board(name, entrants, shown, files) for name in protocols]
    return page(site, chooser + "".join(sections) + published_section(), site, here="index.html", lead=lead)


def _board(protocol: str, entrants: Sequence[Entrant], shown: Sequence[Shown], files: dict[str, str]) -> str:
    rules = protocol_named(protocol)
    heads = columns(rules)
    places = ranked(protocol, entrants)
    titles = [_head(m.column.replace("\n", " ") or m.label, m, g) for m, g in heads]
    head = "".join(
        f'<th scope="col" class="number"><button type="button" data-column="{k}" aria-describedby="explain-{protocol}">'
        f"{title}</button></th>"
        for k, title in enumerate(titles)
    )
    best = _best(places, heads)
    body = "".join(_line(place, k, heads, titles, best) for k, place in enumerate(places))
    first = (
        '<th scope="col" class="place"><button type="button" data-column="rank">#</button></th>'
        '<th scope="col"><button type="button" data-column="name">method</button></th>'
        '<th scope="col" class="number"><button type="button" data-column="measured">measured</button></th>'
    )
    ranking = table("ranking", "ranking", first + head, body)
    intro = (
        '<p class="note">Mean ± standard deviation over all sequences, failures at their price. Ordered by mean '
        "rank: a method's place by each column, averaged over all columns; only methods with every number have "
        "one. No single number decides: sort by the one that you care for. "
        f'<a href="definitions.html#{protocol}">What each number means</a>.</p>'
    )
    explain = (
        f'<p class="explain" id="explain-{protocol}" aria-live="polite">Point at, focus or tap a column to read what '
        "it means.</p>"
    )
    ranks = getattr(rules, "ranking", protocol == RANKING)
    title = f"Ranking by {protocol}" if ranks else f"By {protocol}: another protocol, not the ranking"
    data = _data(rules, entrants, shown, files)
    matrix = f'<h3>Every sequence</h3><div class="matrix">{_matrix(rules, entrants, shown, files)}</div>'
    return section(
        title,
        f'<div class="filters"></div>{intro}{ranking}{explain}{matrix}',
        "ranking",
        data,
        id=f"protocol-{protocol}",
    )


def _head(label: str, metric: Metric, group: Group) -> str:
    unit = unit_text(metric.unit(group))
    arrow = "↑" if metric.direction == "up" else "↓"
    kind = f" <i>{group}</i>" if group != "all" else ""
    return f"{escape(label)}{kind} <small>{escape(unit)} {arrow}</small>"


def ranked(protocol: str, entrants: Sequence[Entrant]) -> list[Place]:
    """All methods in the order of their mean rank; those that lack a number after the others, as given."""
    heads = columns(protocol_named(protocol))
    cells = [tuple(_cell(entrant, protocol, m, g) for m, g in heads) for entrant in entrants]
    ranks = np.full((len(entrants), len(heads)), np.nan)
    for k, (metric, _) in enumerate(heads):
        column = [row[k] for row in cells]
        values = np.array([np.nan if cell is None else cell[0] for cell in column])
        if metric.direction == "up":
            values = -values
        for i, value in enumerate(values):
            if np.isfinite(value):
                ranks[i, k] = 1 + (values < value).sum() + 0.5 * ((values == value).sum() - 1)
    there = [k for k in range(len(heads)) if any(c[k] is not None for c in cells)]
    places = []
    for entrant, given, own in zip(entrants, cells, ranks[:, there], strict=True):
        rows = entrant.scores[protocol].rows
        rank = float(own.mean()) if len(own) and np.isfinite(own).all() else None
        places.append(Place(entrant, rank, given, sum(row.status == "ok" for row in rows), len(rows)))
    return sorted(places, key=lambda place: (place.rank is None, place.rank or 0.0))


def hidden_metrics(entrant: Entrant, rules: Protocol) -> tuple[str, ...]:
    """Ids of the numbers that are shown in means alone, as the truth is hidden."""
    return rules.penalised_by_truth if entrant.scores[rules.name].benchmark.get("hidden") else ()


def _cell(entrant: Entrant, protocol: str, metric: Metric, group: str) -> tuple[float, float | None] | None:
    rows = entrant.whole[protocol].rows
    values = [v for row in rows if group in ("all", row.joint_type) and (v := row.values.get(metric.id)) is not None]
    if len(values) < (FEWEST if metric.id in hidden_metrics(entrant, protocol_named(protocol)) else 1):
        return None
    return float(np.mean(values)), float(np.std(values, ddof=1)) if len(values) > 1 else None


def _best(places: Sequence[Place], heads: Sequence[tuple[Metric, Any]]) -> list[float | None]:
    best: list[float | None] = []
    for k, (metric, _) in enumerate(heads):
        means = [cell[0] for place in places if (cell := place.cells[k]) is not None]
        best.append((max if metric.direction == "up" else min)(means) if len(set(means)) > 1 else None)
    return best


def _line(
    place: Place, k: int, heads: Sequence[tuple[Metric, Any]], titles: Sequence[str], best: Sequence[float | None]
) -> str:
    cells = []
    for c, ((metric, group), cell) in enumerate(zip(heads, place.cells, strict=True)):
        unit = metric.unit(group)
        label = f'<button type="button" class="what" data-column="{c}">{titles[c]}</button>'
        if cell is None:
            text = f"<span>{NONE}</span>"
        else:
            std = "" if cell[1] is None else f"<small>± {number(cell[1], unit)}</small>"
            text = f"<span>{number(cell[0], unit)}</span>{std}"
        cells.append(f'<td class="number{" best" * (cell is not None and cell[0] == best[c])}">{label}{text}</td>')
    return (
        f'<tr><td class="place">{k + 1 if place.rank is not None else NONE}</td><th scope="row">'
        f'{method_link(place.entrant, False)}</th><td class="number measured"><span class="what">measured</span>'
        f"<span>{place.measured} of {place.sequences}</span></td>{''.join(cells)}</tr>"
    )


def _matrix(rules: Protocol, entrants: Sequence[Entrant], shown: Sequence[Shown], files: dict[str, str]) -> str:
    """Every sequence with the first ranking number of every method; the scripts offer the others."""
    metric = next((m for m in rules.metrics if m.column and m.supplements is None), rules.metrics[0])
    head = "".join(f'<th scope="col">{name}</th>' for name in ("sequence", "category", "joint"))
    head += "".join(f'<th scope="col" class="number">{method_link(e, False)}</th>' for e in entrants)
    lines = []
    for s in shown:
        cells = []
        for entrant in entrants:
            row = entrant.row(rules.name, s.name)
            value = None if row is None else row.values.get(metric.id)
            more = "" if row is None or row.status == "ok" else f'<small class="failed">{escape(row.status)}</small>'
            cells.append(number_cell(number(value, metric.unit(s.facts["joint_type"]), True), more=more))
        lines.append(
            f'<tr><th scope="row">{sequence_link(s, files)}</th><td>{escape(s.facts["category"])}</td>'
            f"<td>{escape(s.facts['joint_type'])}</td>{''.join(cells)}</tr>"
        )
    every = table("every sequence", "every", head, "".join(lines))
    return f'<p class="note metric">{escape(metric.label)}</p>{every}'


def sequence_link(shown: Shown, files: dict[str, str], deep: bool = False) -> str:
    """A sequence's small picture and name, leading to its page."""
    up, file = "../" if deep else "", files[shown.name]
    picture = f'<img src="{up}thumbs/{file}.jpg" alt="" width="88" height="50" loading="lazy">' if shown.thumb else ""
    return f'<a class="sequence" href="{up}sequences/{file}.html">{picture}<span>{escape(shown.name)}</span></a>'


def _data(
    rules: Protocol, entrants: Sequence[Entrant], shown: Sequence[Shown], files: dict[str, str]
) -> dict[str, Any]:
    """What `static/ranking.js` sorts and filters."""
    heads = columns(rules)
    metrics = [m for m in rules.metrics if any(e.row(rules.name, s.name) for e in entrants for s in shown)]
    at = {metric.id: k for k, metric in enumerate(metrics)}
    methods = []
    for entrant in entrants:
        rows = [entrant.row(rules.name, s.name) for s in shown]
        methods.append(
            {
                "name": entrant.name,
                "colour": entrant.colour,
                "shape": entrant.shape,
                "href": f"methods/{entrant.file}.html",
                "status": [row.status if row else "missing" for row in rows],
                "values": [[_short(row.values.get(metric.id)) if row else None for metric in metrics] for row in rows],
            }
        )
    return {
        "protocol": rules.name,
        "columns": [
            {
                "metric": at[m.id],
                "group": g,
                "unit": m.unit(g),
                "up": m.direction == "up",
                "title": _head(m.column.replace("\n", " ") or m.label, m, g),
                "cells": [_cell(e, rules.name, m, g) for e in entrants]
                if any(m.id in hidden_metrics(e, rules) for e in entrants)
                else None,
            }
            for m, g in heads
        ],
        "metrics": [
            {
                "id": m.id,
                "label": m.label or m.id,
                "explain": explained(m),
                "units": {"revolute": m.revolute_unit, "prismatic": m.prismatic_unit},
                "up": m.direction == "up",
            }
            for m in metrics
        ],
        "first": at[next((m for m in metrics if m.column and m.supplements is None), metrics[0]).id] if metrics else 0,
        "methods": methods,
        "sequences": [
            {
                "name": s.name,
                "file": files[s.name],
                "type": s.facts["joint_type"],
                "category": s.facts["category"],
            }
            for s in shown
        ],
    }


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")
