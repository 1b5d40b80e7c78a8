"""What the pages of a site share: their frame, links to methods and sequences, and texts about metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from freeart21.view.document import Markup, Section, document
from freeart21.view.tables import ARROWS, Cell, number_cell, number_text
from leaderboard.protocols import Group, Metric, Protocol
from leaderboard.rows import Row, Statistic
from leaderboard.site.entrant import Entrant
from leaderboard.site.sequence_view import SequenceContent

PACKAGE = "leaderboard.site"
MENU = (
    ("index.html", "Ranking"),
    ("failures.html", "Failures"),
    ("definitions.html", "Definitions"),
)
MIN_ROWS = 3
"""Rows from which mean and deviation do not reveal single values."""
LACKS = {
    "states": "makes no joint states",
    "poses": "makes no poses of the parts over time",
    "masks": "makes no part masks",
    "meshes": "makes no meshes",
    "renders": "makes no held-out views",
}
"""What a method states that it does not make."""


@dataclass(frozen=True)
class Board:
    """The content of a site."""

    title: str
    entrants: Sequence[Entrant]
    protocols: Sequence[str]
    sequences: Sequence[SequenceContent]
    files: dict[str, str]
    """Sequence to its file name, without ending."""
    benchmark: dict[str, str]
    """Name, version, split, sha256, and the digest of a hidden truth as 'hidden'."""
    command: Sequence[str] = ()
    """The command that made the site."""


def page(
    board: Board, title: str, sections: Sequence[Section], here: str = "", deep: bool = False, **options: Any
) -> bytes:
    """A page of the site; `deep` when it is in a folder. `options` are those of `document`."""
    around = {"title": board.title, "menu": MENU, "here": here, "root": "../" * deep}
    return document(title, sections, site=around, **options).encode()


def method_link(entrant: Entrant, deep: bool = False) -> Markup:
    """A method's colour and name as a link to its page."""
    link = Markup('<a class="method" href="{}methods/{}.html"><i style="background:{}"></i><span>{}</span></a>')
    return link.format("../" * deep, entrant.file, entrant.colour, entrant.name)


def method_heads(entrants: Sequence[Entrant], deep: bool = False) -> list[Cell]:
    """A column heading for every method."""
    return [Cell(method_link(entrant, deep), css="number", link=True) for entrant in entrants]


def sequence_link(name: str, board: Board, deep: bool = False) -> Markup:
    """A sequence's name as a link to its page."""
    link = Markup('<a href="{}sequences/{}.html">{}</a>')
    return link.format("../" * deep, board.files[name], name)


def unit_text(unit: str | None) -> str:
    """A unit as a heading shows it: empty for fractions."""
    return {"deg": "°", "fraction": "", "1": ""}.get(unit or "", unit or "")


def metric_name(metric: Metric) -> str:
    """Its label, else its id."""
    return metric.label or metric.id


def metric_head(metric: Metric, group: Group) -> Cell:
    """A metric's short name, unit, direction and joint type as a column heading, its definition as a tooltip."""
    kind = "" if group == "all" or metric.unit("all") is not None else f"{group} "
    unit = f"{kind}{unit_text(metric.unit(group))} {ARROWS[metric.direction][0]}".strip()
    return Cell(metric.column.replace("\n", " ") or metric_name(metric), None, "number", unit, title=explained(metric))


def metric_row_head(rules: Protocol, metric: Metric) -> Cell:
    """A metric's name as a row's heading on a page in a folder, with a link to its definition."""
    link = Markup('<a href="../definitions.html#{}.{}">{}</a> {}')
    return Cell(link.format(rules.name, metric.id, metric_name(metric), ARROWS[metric.direction][0]))


def columns(rules: Protocol) -> list[tuple[Metric, Group]]:
    """The columns of a ranking: every ranking metric, once per joint type where these have different units."""
    found: list[tuple[Metric, Group]] = []
    for metric in rules.metrics:
        if metric.supplements is not None or not (metric.column or metric.id == "joint_type"):
            continue
        if metric.unit("all") is not None:
            found.append((metric, "all"))
        else:
            found += [(metric, group) for group in ("revolute", "prismatic") if metric.unit(group) is not None]
    return found


def hidden_metrics(entrant: Entrant, rules: Protocol) -> tuple[str, ...]:
    """Ids of the metrics that are shown in means only, because the truth is hidden."""
    return rules.penalised_by_truth if entrant.scores[rules.name].benchmark.get("hidden") else ()


def statistic_of(entrant: Entrant, rules: Protocol, metric: Metric, group: Group) -> Statistic | None:
    """A method's statistic over a group of sequences; None without one, or where it would reveal a hidden truth."""
    summaries = {summary.group: summary for summary in entrant.whole[rules.name].summaries}
    found = summaries[group].statistics.get(metric.id) if group in summaries else None
    tells = found is not None and found.sequences < MIN_ROWS and metric.id in hidden_metrics(entrant, rules)
    return None if tells else found


def score_cell(
    row: Row | None, metric: Metric, kind: Group, with_unit: bool = True, best: float | None = None, below: str = ""
) -> Cell:
    """A row's number by a metric, in its unit for joints of a kind; bold when it is the best one."""
    value = None if row is None else row.values.get(metric.id)
    text = number_text(value, metric.unit(kind), with_unit)
    return number_cell(text, value is not None and value == best, value, below)


def best_of(values: Sequence[float | None], metric: Metric) -> float | None:
    """The best of several methods' numbers; None when all are the same."""
    known = {value for value in values if value is not None}
    return (max if metric.direction == "up" else min)(known) if len(known) > 1 else None


def explained(metric: Metric) -> str:
    """Definition, direction and penalty in two sentences."""
    return f"{sentence(metric.definition)} {sentence(ARROWS[metric.direction][1])[:-1]}; {penalty_sentence(metric)}."


def penalty_sentence(metric: Metric) -> str:
    """'a failure counts as 90°', for example."""
    penalty = getattr(metric, "penalty_text", metric.penalty)
    if not isinstance(penalty, str):
        unit = metric.revolute_unit or metric.prismatic_unit
        penalty = "the range of motion" if penalty is None else number_text(penalty, unit, True)
    return f"a failure counts as {penalty}"


def sentence(text: str) -> str:
    """`text` with a capital first letter and one full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def facts(rows: Sequence[tuple[str, object]]) -> Markup:
    """A list of names and values."""
    entries = (Markup("<div><dt>{}</dt><dd>{}</dd></div>").format(name, value) for name, value in rows)
    return Markup('<dl class="facts">{}</dl>').format(Markup("").join(entries))
