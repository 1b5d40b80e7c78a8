"""The HTML document: sections side by side, with style, scripts and data inside."""

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
from numpy.typing import ArrayLike, NDArray

from freeart21 import __version__

SCRIPTS = (
    *("base.js", "kinematics.js", "video.js", "plot.js", "curves.js", "splats.js", "scene.js", "table.js", "start.js"),
)
"""Files of `static/`, in the order in which they run."""

REFERENCE, MOVING, TRUTH = "#0072B2", "#E69F00", "#009E73"
"""Colours of the two parts and of the truth: blue, orange and green of Okabe and Ito (2008), safe for all eyes."""

_DTYPES = {"f32": "<f4", "u32": "<u4", "u16": "<u2", "u8": "u1"}


@dataclass(frozen=True)
class Section:
    """One box of a page."""

    title: str
    html: str
    """What stands in the box, already escaped."""
    kind: Literal["video", "scene", "plot", "curves", "remarks", "table", "still"] = "still"
    """Which script brings it to life."""
    data: dict[str, Any] = field(default_factory=dict)
    """What that script reads: plain values, and arrays by `embed_array`."""
    place: Literal["left", "right", "full", "small"] = "small"
    """In one of the two columns on top, or below them over the whole width or side by side with others."""


def escape(text: object) -> str:
    """`text` for use in HTML, in content and in quoted attributes."""
    return html.escape(str(text), quote=True)


def embed_json(data: Any) -> str:
    """`data` as JSON that can stand inside a `<script>` element: it holds no '<', '>' or '&'; inf and NaN are null."""
    text = json.dumps(_finite(data), allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def embed_array(array: ArrayLike, dtype: Literal["f32", "u32", "u16", "u8"]) -> dict[str, Any]:
    """An array as plain data: dtype, shape and base64 of its little-endian bytes in C order."""
    values = np.ascontiguousarray(array, _DTYPES[dtype])
    return {"dtype": dtype, "shape": list(values.shape), "base64": base64.b64encode(values.tobytes()).decode("ascii")}


def embed_points(points: ArrayLike) -> dict[str, Any]:
    """Points (n, d) as `embed_array` has them, in half the bytes: to 1/65535 of the box around all."""
    points = np.asarray(points, float)
    low, high = (points.min(0), points.max(0)) if len(points) else np.zeros((2, points.shape[1]))
    steps = (high - low) / 65535
    return {**embed_array(np.rint((points - low) / np.where(steps > 0, steps, 1)), "u16"), "low": low, "steps": steps}


def extract_array(data: dict[str, Any]) -> NDArray[Any]:
    """The array that `embed_array` or `embed_points` put away."""
    array = np.frombuffer(base64.b64decode(data["base64"]), _DTYPES[data["dtype"]]).reshape(data["shape"])
    return data["low"] + array * np.asarray(data["steps"]) if "low" in data else array


def data_url(mime: str, content: bytes) -> str:
    """`content` as a data: address."""
    return f"data:{mime};base64,{base64.b64encode(content).decode('ascii')}"


def document(
    title: str, sections: Sequence[Section], kind: str = "", chips: Iterable[str] = (), notices: Iterable[str] = ()
) -> str:
    """The whole page.

    `kind` is a small word over the title ('result'), `chips` are short facts under it, `notices` are warnings shown
    above all sections. All texts but `Section.html` are escaped here.
    """
    script = "".join(_static(name) for name in SCRIPTS)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="color-scheme" content="light dark">',
            f'<meta name="generator" content="freeart21 {__version__}">',  # by which `files.places` knows our pages
            f"<title>{escape(title)} · FreeArt-21</title>",
            '<link rel="icon" href="data:,">',
            f"<style>{_static('page.css')}</style>",
            "</head>",
            "<body>",
            "<header>",
            f'<p class="kind">FreeArt-21{f" · {escape(kind)}" if kind else ""}</p>',
            f"<h1>{escape(title)}</h1>",
            '<ul class="chips">' + "".join(f"<li>{escape(chip)}</li>" for chip in chips) + "</ul>",
            "</header>",
            *(f'<p class="notice" role="note">{escape(notice)}</p>' for notice in notices),
            "<noscript><p class='notice'>This page needs JavaScript for the video and the 3D view.</p></noscript>",
            "<main>",
            *_columns([section for section in sections if section.place in ("left", "right")]),
            '<div class="below">',
            *(_section(section) for section in sections if section.place in ("full", "small")),
            "</div>",
            "</main>",
            f"<script>{script}</script>",
            "</body>",
            "</html>",
            "",
        ]
    )


def _columns(sections: list[Section]) -> list[str]:
    if not sections:
        return []
    columns = (
        "".join(_section(section) for section in sections if section.place == place) for place in ("left", "right")
    )
    return ['<div class="columns">', *(f'<div class="column">{column}</div>' for column in columns if column), "</div>"]


def _section(section: Section) -> str:
    data = f'<script type="application/json">{embed_json(section.data)}</script>' if section.data else ""
    return (
        f'<section class="{section.place}" data-kind="{section.kind}"><h2>{escape(section.title)}</h2>'
        f"{section.html}{data}</section>"
    )


def _static(name: str) -> str:
    return resources.files("freeart21.view").joinpath("static", name).read_text("utf-8")


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
