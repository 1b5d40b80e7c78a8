"""The frame of every page, and the small pieces that all pages share."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from typing import Any

from freeart21 import __version__
from freeart21.view.document import TRUTH, embed_json, escape
from leaderboard.protocols import Group, Metric, Protocol
from leaderboard.site.entrant import Entrant

POLICY = (
    "default-src 'none'; img-src 'self' file: data:; script-src 'self' file:; style-src 'self' file:; "
    "base-uri 'none'; form-action 'none'"
)
"""Nothing from elsewhere, nothing inline; 'file:' because a page opened from disk has no origin in some browsers."""
VIEW_SCRIPTS = ("base.js", "kinematics.js", "scene.js")
"""Of `freeart21.view`."""
OWN_SCRIPTS = ("packed.js", "arrows.js", "player.js", "states.js", "ranking.js", "tables.js", "start.js")
PLACES = (
    ("index.html", "Ranking"),
    ("failures.html", "Failures"),
    ("definitions.html", "Definitions"),
    ("downloads.html", "Downloads"),
)
TRUTH_PATH = "M1.2 8.6l2.2-2.2l3.1 3.1l6.2-6.4l2.2 2.2l-8.4 8.6z"
"""A tick: the truth's mark."""
_DIGITS = {"deg": 2, "%": 2, "cm": 2, "dB": 1, "fraction": 3, "m": 4, "rad": 3, "1": 3, "dm²": 4}
_SIGNS = {"deg": "°", "%": " %", "dB": " dB", "cm": " cm", "m": " m", "rad": " rad"}
NONE = "\N{EN DASH}"


def script() -> str:
    """All scripts as one file: the viewer's and the site's."""
    view = (resources.files("freeart21.view").joinpath("static", name) for name in VIEW_SCRIPTS)
    own = (resources.files("leaderboard.site").joinpath("static", name) for name in OWN_SCRIPTS)
    return "\n".join(file.read_text("utf-8") for file in (*view, *own))


def style() -> str:
    """All styles as one file: the pages' own and the site's."""
    own = resources.files("leaderboard.site").joinpath("static", "site.css").read_text("utf-8")
    return resources.files("freeart21.view").joinpath("static", "page.css").read_text("utf-8") + own


def page(
    title: str,
    main: str,
    site: str,
    deep: bool = False,
    here: str = "",
    lead: str = "",
    kind: str = "",
    scripts: Sequence[str] = (),
    icon: str = "",
) -> bytes:
    """A whole page as bytes.

    Args:
        title: Of the page; escaped here.
        main: What stands in it, already escaped.
        site: Title of the site; escaped here.
        deep: Whether it stands in a folder of the site, so that links go up first.
        here: Address of the entry of the menu that is the page's own.
        lead: What stands below the title, already escaped.
        kind: A small word over the title; escaped here.
        scripts: Addresses of scripts that hold its data, from the page on.
        icon: A mark before the title, already escaped.
    """
    up = "../" if deep else ""
    menu = "".join(
        f'<li><a href="{up}{address}"{" aria-current=page" if address == here else ""}>{name}</a></li>'
        for address, name in PLACES
    )
    over = f'<p class="kind">{escape(kind)}</p>' if kind else ""
    lines = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{escape(POLICY)}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        '<meta name="referrer" content="no-referrer">',
        f'<meta name="generator" content="freeart21 {__version__}">',
        f"<title>{escape(title)} · {escape(site)}</title>" if title != site else f"<title>{escape(site)}</title>",
        '<link rel="icon" href="data:,">',
        f'<link rel="stylesheet" href="{up}static/site.css">',
        "</head>",
        '<body class="site">',
        '<a class="skip" href="#main">Skip to the content</a>',
        f'<nav class="top" aria-label="site"><a class="brand" href="{up}index.html">{escape(site)}</a>',
        f"<ul>{menu}</ul></nav>",
        f"<header>{over}<h1>{icon}{escape(title)}</h1>{f'<div class=lead>{lead}</div>' if lead else ''}</header>",
        '<main id="main">',
        '<noscript><p class="notice">Sorting, filters, video and 3D need JavaScript; all numbers stand here without.',
        "</p></noscript>",
        main,
        "</main>",
        f"<footer><p>Made by <code>freeart21 site</code> {escape(__version__)}. Nothing here is fetched from",
        "elsewhere.</p></footer>",
        *(f'<script src="{escape(address)}"></script>' for address in scripts),
        f'<script src="{up}static/site.js"></script>',
        "</body>",
        "</html>",
        "",
    ]
    return "\n".join(lines).encode()


def section(
    title: str, html: str, kind: str = "", data: Any = None, id: str = "", place: str = "full", note: str = ""
) -> str:
    """One box of a page; `html` is escaped already, `kind` says which script brings it to life with `data`."""
    stored = f'<script type="application/json">{embed_json(data)}</script>' if data is not None else ""
    named = f' id="{escape(id)}"' if id else ""
    alive = f' data-kind="{kind}"' if kind else ""
    below = f'<p class="note">{note}</p>' if note else ""
    return f'<section class="{place}"{named}{alive}><h2>{escape(title)}</h2>{html}{below}{stored}</section>'


def mark(entrant: Entrant) -> str:
    """The shape of a method in its colour."""
    return (
        f'<svg class="mark" viewBox="0 0 16 16" aria-hidden="true"><path d="{entrant.shape}" '
        f'fill="{entrant.colour}"/></svg>'
    )


def method_link(entrant: Entrant, deep: bool) -> str:
    """A method's mark and name, leading to its page."""
    up = "../" if deep else ""
    name = f"{mark(entrant)}<span>{escape(entrant.name)}</span>"
    return f'<a class="method" href="{up}methods/{entrant.file}.html">{name}</a>'


def sources(entrants: Sequence[Entrant], hidden: bool) -> list[dict[str, Any]]:
    """The truth, unless hidden, and the methods as the scripts know them: id, name, colour, shape, dash."""
    truth = {"id": "truth", "name": "ground truth", "colour": TRUTH, "shape": TRUTH_PATH, "dash": ""}
    return [
        *([] if hidden else [truth]),
        *({"id": e.file, "name": e.name, "colour": e.colour, "shape": e.shape, "dash": e.dash} for e in entrants),
    ]


def number(value: float | None, unit: str | None, signed: bool = False) -> str:
    """A value in three digits or as many as it has before the point, `signed` with its unit. So do the scripts."""
    if value is None or unit is None:
        return NONE
    plain = abs(value) < 10 or unit in ("dB", "fraction")
    digits = _DIGITS.get(unit, 2) if plain else 1 if abs(value) < 99.95 else 0
    return f"{value:.{digits}f}{_SIGNS.get(unit, '') if signed else ''}"


def unit_text(unit: str | None) -> str:
    """A unit as a heading shows it: empty for fractions."""
    return {"deg": "°", "fraction": "", "1": ""}.get(unit or "", unit or "")


def columns(rules: Protocol) -> list[tuple[Metric, Group]]:
    """The columns of a ranking: every ranking number, twice where revolute and prismatic have units of their own."""
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
    """What a number means, in a sentence or two, unescaped."""
    better = "Larger" if metric.direction == "up" else "Smaller"
    return f"{sentence(metric.definition)} {better} is better; a failure costs {price_text(metric)}."


def sentence(text: str) -> str:
    """`text` with a capital at its beginning and one full stop at its end."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def price_text(metric: Metric) -> str:
    """What a failure costs, in words: a number with its unit, two where joint types differ, or where it comes from."""
    told = getattr(metric, "penalty_text", metric.penalty)
    if isinstance(told, str):
        return told
    if told is None:
        return "the range of motion"
    return number(told, metric.revolute_unit or metric.prismatic_unit, True)


def facts(rows: Sequence[tuple[str, str]]) -> str:
    """A list of facts: names, and values already escaped."""
    return '<dl class="facts">' + "".join(f"<div><dt>{escape(k)}</dt><dd>{v}</dd></div>" for k, v in rows) + "</dl>"


def table(label: str, kind: str, head: str, body: str) -> str:
    """A table that scrolls sideways where the screen is narrow; `head` and `body` are cells and rows, escaped."""
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(label)}, scrolls sideways">'
        f'<table class="{kind}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def metric_row(rules: Protocol, metric: Metric, cells: str) -> str:
    """A row of a table of numbers on a page in a folder: the metric's name, leading to its definition, and `cells`."""
    arrow = "↑" if metric.direction == "up" else "↓"
    place = f"../definitions.html#{escape(rules.name)}.{escape(metric.id)}"
    name = f'<a href="{place}">{escape(metric.label or metric.id)}</a> <small>{arrow}</small>'
    return f'<tr class="{"beside" if metric.supplements else ""}"><th scope="row">{name}</th>{cells}</tr>'


def number_cell(text: str, best: bool = False, value: float | None = None, more: str = "") -> str:
    """A cell with a number as `text`, by which value it sorts, and what stands small below it, escaped."""
    sort = "" if value is None else f' data-value="{value!r}"'
    return f'<td class="number{" best" if best else ""}"{sort}><span>{text}</span>{more}</td>'
