"""The HTML document of every page: a self-contained file, or one page of a site whose style and scripts are files."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import __version__

SCRIPTS = (
    *("base.js", "kinematics.js", "player.js", "video.js", "plots.js", "splats.js", "scene.js", "table.js", "start.js"),
)
"""Files of `static/`, in the order in which they run."""

SITE_POLICY = (
    "default-src 'none'; img-src 'self' file: data:; script-src 'self' file:; style-src 'self' file:; "
    "base-uri 'none'; form-action 'none'"
)
"""Content security policy of a site's pages: own files only, nothing inline. Some browsers give a page opened from disk
no origin, hence 'file:'."""

REFERENCE, MOVING, TRUTH = "#0072B2", "#E69F00", "#009E73"
"""Colours of the two parts and of the ground truth: blue, orange and green of Okabe and Ito (2008), safe for all
eyes."""

_DTYPES = {"f32": "<f4", "u32": "<u4", "u16": "<u2", "u8": "u1"}


@dataclass(frozen=True)
class Section:
    """One box of a page."""

    title: str
    html: str
    """Content, already escaped."""
    kind: Literal["video", "overlays", "scene", "curves", "remarks", "ranking", "still"] = "still"
    """Which script handles it; 'still' for none."""
    data: dict[str, Any] = field(default_factory=dict)
    """Input of that script: plain values, and arrays by `embed_array`."""
    place: Literal["left", "right", "full", "small"] = "small"
    """Left or right column at the top, or below them at full width, or below them beside others."""
    note: str = ""
    """A sentence under the content; escaped here."""
    id: str = ""
    """Target of links."""


@dataclass(frozen=True)
class Site:
    """What a page of a site has around its content."""

    title: str
    menu: Sequence[tuple[str, str]]
    """Address, from the site's root, and text of every entry."""
    here: str = ""
    """Address of this page, when it has an entry in the menu."""
    root: str = ""
    """'../' on a page in a folder."""
    data: Sequence[str] = ()
    """Addresses, from the page, of scripts with its data."""


def escape(text: object) -> str:
    """`text` for use in HTML, in content and in quoted attributes."""
    return html.escape(str(text), quote=True)


def embed_json(data: Any) -> str:
    """`data` as JSON that is safe inside a `<script>` element: no '<', '>' or '&'; infinities and NaN become null."""
    text = json.dumps(_finite(data), allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def embed_array(array: ArrayLike, dtype: Literal["f32", "u32", "u16", "u8"]) -> dict[str, Any]:
    """An array as plain data: dtype, shape and base64 of its little-endian bytes in C order."""
    values = np.ascontiguousarray(array, _DTYPES[dtype])
    return {"dtype": dtype, "shape": list(values.shape), "base64": base64.b64encode(values.tobytes()).decode("ascii")}


def embed_points(points: ArrayLike) -> dict[str, Any]:
    """Points (n, d) as 16-bit integers over their bounding box: `embed_array` with the box's corner and step."""
    points = np.asarray(points, float)
    low, high = (points.min(0), points.max(0)) if len(points) else np.zeros((2, points.shape[1]))
    steps = (high - low) / 65535
    return {**embed_array(np.rint((points - low) / np.where(steps > 0, steps, 1)), "u16"), "low": low, "steps": steps}


def data_url(mime: str, content: bytes) -> str:
    """`content` as a data: address."""
    return f"data:{mime};base64,{base64.b64encode(content).decode('ascii')}"


def static_text(*names: str, package: str = "freeart21.view") -> str:
    """The texts of files in a package's `static/`, one after the other."""
    return "".join(resources.files(package).joinpath("static", name).read_text("utf-8") for name in names)


def document(
    title: str,
    sections: Sequence[Section],
    kind: str = "",
    chips: Iterable[str] = (),
    notices: Iterable[str] = (),
    lead: str = "",
    icon: str = "",
    site: Site | None = None,
) -> str:
    """The whole page; self-contained when it belongs to no `site`.

    Args:
        title: Heading and window title.
        sections: Boxes of the page.
        kind: Small word over the title, such as 'result'.
        chips: Short facts under the title.
        notices: Warnings above all sections.
        lead: What else stands under the title, already escaped.
        icon: A mark in front of the title, already escaped.
        site: What the page has around its content when it is one of a site.
    """
    script = static_text(*SCRIPTS)
    if site is None:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
        policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
        style, scripts = f"<style>{static_text('page.css')}</style>", f"<script>{script}</script>"
        above, window = f"FreeArt-21{f' · {kind}' if kind else ''}", f"{title} · FreeArt-21"
    else:
        policy, style = SITE_POLICY, f'<link rel="stylesheet" href="{site.root}static/site.css">'
        addresses = [*site.data, f"{site.root}static/site.js"]
        scripts = "".join(f'<script src="{escape(address)}"></script>' for address in addresses)
        above, window = kind, f"{title} · {site.title}" if title != site.title else title
    top = [section for section in sections if section.place in ("left", "right")]
    below = "".join(_section_html(section) for section in sections if section.place in ("full", "small"))
    marks = "".join(f"<li>{escape(chip)}</li>" for chip in chips)
    warnings = "".join(f'<p class="notice" role="note">{escape(notice)}</p>' for notice in notices)
    footer = (
        f"<footer><p>Made by <code>freeart21 site</code> {__version__}. Nothing is loaded from elsewhere.</p></footer>"
    )
    # `files.places` recognises our pages by their generator
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta name="referrer" content="no-referrer">
<meta name="generator" content="freeart21 {__version__}">
<title>{escape(window)}</title>
<link rel="icon" href="data:,">
{style}
</head>
<body>
{_navigation(site) if site else ""}
<header>
{f'<p class="kind">{escape(above)}</p>' if above else ""}
<h1>{icon}{escape(title)}</h1>
{f'<ul class="chips">{marks}</ul>' if marks else ""}
{f'<div class="lead">{lead}</div>' if lead else ""}
</header>
{warnings}
<noscript><p class="notice">Video, 3D view and sorting need JavaScript; all numbers are here.</p></noscript>
<main id="main">
{_columns_html(top) if top else ""}
<div class="below">{below}</div>
</main>
{footer if site else ""}
{scripts}
</body>
</html>
"""


def _navigation(site: Site) -> str:
    entries = "".join(
        f'<li><a href="{site.root}{address}"{" aria-current=page" * (address == site.here)}>{escape(text)}</a></li>'
        for address, text in site.menu
    )
    home = f'<a class="brand" href="{site.root}index.html">{escape(site.title)}</a>'
    skip = '<a class="skip" href="#main">Skip to the content</a>'
    return f'{skip}<nav class="top" aria-label="site">{home}<ul>{entries}</ul></nav>'


def _columns_html(sections: list[Section]) -> str:
    columns = ("".join(_section_html(s) for s in sections if s.place == place) for place in ("left", "right"))
    return f'<div class="columns">{"".join(f"<div class=column>{column}</div>" for column in columns if column)}</div>'


def _section_html(section: Section) -> str:
    data = f'<script type="application/json">{embed_json(section.data)}</script>' if section.data else ""
    target = f' id="{escape(section.id)}"' if section.id else ""
    kind = f' data-kind="{section.kind}"' if section.kind != "still" else ""
    note = f'<p class="note">{escape(section.note)}</p>' if section.note else ""
    return (
        f'<section class="{section.place}"{target}{kind}><h2>{escape(section.title)}</h2>'
        f"{section.html}{note}{data}</section>"
    )


def _finite(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
