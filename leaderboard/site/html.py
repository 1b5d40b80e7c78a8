"""What the pages of a site share: their frame, links to methods and sequences, and texts about metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from freeart21.view.document import SCRIPTS, Section, Site, document, escape, static_text
from freeart21.view.tables import ARROWS, NONE, Markup, column_head, number_text, row_head
from leaderboard.protocols import Group, Metric, Protocol
from leaderboard.site.entrant import Entrant, svg_mark
from leaderboard.site.sequence_data import SequenceContent

OWN_SCRIPTS = ("packed.js", "overlays.js", "ranking.js")
MENU = (
    ("index.html", "Ranking"),
    ("failures.html", "Failures"),
    ("definitions.html", "Definitions"),
    ("downloads.html", "Downloads"),
)
TABLES_ONLY = "Made from tables of scores only: without videos and the methods' results."


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


def script() -> str:
    """All scripts of the pages and of the site as one file; the last one starts them."""
    own = static_text(*OWN_SCRIPTS, package="leaderboard.site")
    return static_text(*SCRIPTS[:-1]) + own + static_text(SCRIPTS[-1])


def style() -> str:
    """All styles as one file."""
    return static_text("page.css") + static_text("site.css", package="leaderboard.site")


def page(
    board: Board,
    title: str,
    sections: Sequence[Section],
    here: str = "",
    deep: bool = False,
    lead: str = "",
    kind: str = "",
    data: Sequence[str] = (),
    icon: str = "",
    notices: Sequence[str] = (),
) -> bytes:
    """A page of the site; `deep` when it is in a folder, everything else as in `document` and `Site`."""
    site = Site(board.title, MENU, here, "../" if deep else "", data)
    return document(title, sections, kind, (), notices, lead, icon, site).encode()


def mark(entrant: Entrant) -> str:
    """The shape of a method in its colour."""
    return svg_mark(entrant.shape, entrant.colour)


def method_link(entrant: Entrant, deep: bool) -> str:
    """A method's mark and name as a link to its page."""
    up = "../" if deep else ""
    name = f"{mark(entrant)}<span>{escape(entrant.name)}</span>"
    return f'<a class="method" href="{up}methods/{entrant.file}.html">{name}</a>'


def method_heads(entrants: Sequence[Entrant], deep: bool) -> list[Markup]:
    """A column heading for every method."""
    return [column_head(method_link(entrant, deep), number=True) for entrant in entrants]


def sequence_link(shown: SequenceContent, board: Board, deep: bool = False) -> str:
    """A sequence's thumbnail and name as a link to its page."""
    up, file = "../" if deep else "", board.files[shown.name]
    image = f'<img src="{up}thumbs/{file}.jpg" alt="" width="88" height="50" loading="lazy">' if shown.thumb else ""
    return f'<a class="sequence" href="{up}sequences/{file}.html">{image}<span>{escape(shown.name)}</span></a>'


def unit_text(unit: str | None) -> str:
    """A unit as a heading shows it: empty for fractions."""
    return {"deg": "°", "fraction": "", "1": ""}.get(unit or "", unit or "")


def metric_name(metric: Metric) -> str:
    """Its label, else its id."""
    return metric.label or metric.id


def metric_head(metric: Metric, group: Group, only: bool = False) -> str:
    """A metric's short name, unit and direction as HTML for a column heading, with the joint type if `only` that."""
    name = escape(metric.column.replace("\n", " ") or metric_name(metric))
    unit = escape(unit_text(metric.unit(group)))
    kind = f" <i>{group}</i>" if only and group != "all" else ""
    return f"{name}{kind} <small>{unit} {ARROWS[metric.direction][0]}</small>"


def metric_row_head(rules: Protocol, metric: Metric) -> Markup:
    """A metric's name as a row's heading on a page in a folder, with a link to its definition."""
    place = f"../definitions.html#{escape(rules.name)}.{escape(metric.id)}"
    arrow = ARROWS[metric.direction][0]
    return row_head(f'<a href="{place}">{escape(metric_name(metric))}</a> <small>{arrow}</small>')


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


def explained(metric: Metric) -> str:
    """Definition, direction and penalty in two sentences, not escaped."""
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


def facts(rows: Sequence[tuple[str, str]]) -> str:
    """A list of names and values; the values are already escaped."""
    return '<dl class="facts">' + "".join(f"<div><dt>{escape(k)}</dt><dd>{v}</dd></div>" for k, v in rows) + "</dl>"


def hash_text(sha256: str) -> str:
    """A hash as HTML."""
    return f'<code class="hash">{escape(sha256)}</code>'


def missing(value: object) -> str:
    """`value` escaped, or a dash for none."""
    return escape(NONE if value in (None, "") else value)
