"""The HTML document of every page: one file with its style, scripts and data, which opens offline."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup, escape
from numpy.typing import ArrayLike

from freeart21 import __version__

__all__ = ["Markup", "Section", "document", "escape", "render"]

SCRIPTS = {
    "video": ("video.js",),
    "scene": ("kinematics.js", "splats.js", "scene.js"),
    "curves": ("plots.js",),
}
"""Files of `static/` that a kind of section needs, between base.js and start.js."""

REFERENCE, MOVING, TRUTH = "#0072B2", "#E69F00", "#009E73"
"""Colours of the two parts and of the ground truth: blue, orange and green of Okabe and Ito (2008), safe for all
eyes."""

Place = Literal["left", "right", "full", "small"]
_DTYPES = {"f32": "<f4", "u32": "<u4", "u16": "<u2", "u8": "u1"}


@dataclass(frozen=True)
class Section:
    """One box of a page."""

    title: str
    html: str
    """Content; escaped unless it is `Markup`."""
    kind: Literal["video", "scene", "curves", ""] = ""
    """Which script handles it."""
    data: dict[str, Any] = field(default_factory=dict)
    """Input of that script: plain values, and arrays by `embed_array`."""
    place: Place = "small"
    """Left or right column at the top, or below them at full width, or below them beside others."""
    note: str = ""
    """A sentence under the content."""
    id: str = ""
    """Target of links."""


@cache
def _environment(package: str) -> Environment:
    loaders = [PackageLoader(name) for name in dict.fromkeys((package, "freeart21.view"))]
    return Environment(
        loader=ChoiceLoader(loaders), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )


def render(template: str, package: str = "freeart21.view", **values: Any) -> Markup:
    """A file of a package's `templates/`, filled in; every value is escaped that is no `Markup`."""
    return Markup(_environment(package).get_template(template).render(**values))


def document(
    title: str,
    sections: Sequence[Section],
    kind: str = "",
    chips: Iterable[str] = (),
    notices: Iterable[str] = (),
    lead: str = "",
    site: Mapping[str, Any] | None = None,
) -> str:
    """The whole page.

    Args:
        title: Heading and window title.
        sections: Boxes of the page.
        kind: Small word over the title, such as 'result'.
        chips: Short facts under the title.
        notices: Warnings above all sections.
        lead: What else stands under the title.
        site: What a page of a site has around it: the site's "title", its "menu" of addresses and texts, the address
            "here", and the "root" that addresses follow ('../' on a page in a folder).
    """
    needed = dict.fromkeys(name for section in sections for name in SCRIPTS.get(section.kind, ()))
    script = static_text("base.js", *needed, "start.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    columns = [[section for section in sections if section.place == place] for place in ("left", "right")]
    return render(
        "page.html.j2",
        title=title,
        kind=kind,
        chips=list(chips),
        notices=list(notices),
        lead=lead,
        site=site,
        columns=[column for column in columns if column],
        below=[section for section in sections if section.place in ("full", "small")],
        policy=f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; "
        "base-uri 'none'; form-action 'none'",
        style=Markup(static_text("page.css")),
        script=Markup(script),
        embed_json=embed_json,
        version=__version__,
    )


def embed_json(data: Any) -> Markup:
    """`data`, dataclasses by their fields, as JSON that is safe inside a `<script>`; infinities and NaN become null."""
    return htmlsafe_json_dumps(_finite(data), allow_nan=False, separators=(",", ":"))


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


def static_text(*names: str) -> str:
    """The texts of files in `static/`, one after the other."""
    return "".join(resources.files("freeart21.view").joinpath("static", name).read_text("utf-8") for name in names)


def _finite(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if is_dataclass(value):
        value = vars(value)
    if isinstance(value, dict):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
