"""Tables of pages, and the rows of those about recordings, joints, links, scores and run times."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from freeart21.certificate import Certificate, LinkCertificate
from freeart21.errors import FreeArtError
from freeart21.files.urdf import Urdf, UrdfJoint
from freeart21.joint import Joint
from freeart21.reconstruction import Alternative
from freeart21.recording import Recording
from freeart21.view.document import Section, escape
from freeart21.view.plots import display_unit

ARROWS = {"up": ("↑", "larger is better"), "down": ("↓", "smaller is better")}
NONE = "\N{EN DASH}"
"""Shown where a number is missing."""
_DIGITS = {"deg": 2, "%": 2, "cm": 2, "dB": 1, "fraction": 3, "m": 4, "rad": 3, "1": 3, "dm²": 4, "points": 1}
_SIGNS = {"deg": "°", "%": " %", "dB": " dB", "cm": " cm", "m": " m", "rad": " rad"}
_WORDS = re.compile(r"[^\W\d_]{4,}|, ")
"""A word of four letters or more, or a comma: a cell with one is text or a list, not a number with its unit."""


class Markup(str):
    """A whole cell of a table as HTML, already escaped."""

    __slots__ = ()


def two_lines(text: str, below: str, heading: bool = False, bold: bool = False) -> Markup:
    """A cell, or a row's heading, with a text and a smaller one below."""
    lines = f"{f'<b>{escape(text)}</b>' if bold else escape(text)}<br><small>{escape(below)}</small>"
    return Markup(f"<th scope=row>{lines}</th>" if heading else f"<td>{lines}</td>")


def bar(share: float) -> Markup:
    """A cell with a bar over this share of its width, 0 to 1."""
    return Markup(f'<td class="bar"><i style="width:{100 * share:.1f}%"></i></td>')


def value_cell(text: str, value: object = None, html: bool = False, css: str = "") -> Markup:
    """A cell that sorts by `value` (by its text when None); `text` is HTML if so said, `css` its class."""
    sort = "" if value is None else f' data-value="{escape(value)}"'
    look = f' class="{css}"' if css else ""
    return Markup(f"<td{look}{sort}>{text if html else escape(text)}</td>")


def number_cell(text: str, best: bool = False, value: float | None = None, more: str = "") -> Markup:
    """A right-aligned cell with a number as `text`, sorted by `value`, with HTML `more` below it."""
    return value_cell(f"<span>{text}</span>{more}", value, True, "number" + " best" * best)


def row_head(html: str, value: object = None) -> Markup:
    """A row's heading as HTML, sorted by `value`."""
    sort = "" if value is None else f' data-value="{escape(value)}"'
    return Markup(f"<th scope=row{sort}>{html}</th>")


def column_head(html: str, number: bool = False, sortable: bool = False, more: str = "") -> Markup:
    """A column's heading as HTML, a button when it is sortable, with HTML `more` behind it."""
    inside = f'<button type="button">{html}</button>' if sortable else html
    look = " class=number" if number else ""
    return Markup(f"<th scope=col{look}>{inside}{more}</th>")


def table(
    rows: Iterable[Sequence[str]], head: Sequence[str] = (), css: str = "", label: str = "", row_css: Sequence[str] = ()
) -> str:
    """A table in a box that scrolls sideways.

    Args:
        rows: Texts, escaped here, or `Markup`; the first cell of a row is its heading.
        head: Headings of the columns, as texts or `Markup`.
        css: Class of the table; with 'sortable' a click on a heading's button sorts the rows.
        label: What the table is, for screen readers; the keyboard then scrolls it.
        row_css: Class of each row, when given.
    """
    names = [cell if isinstance(cell, Markup) else column_head(escape(cell)) for cell in head]
    header = f"<thead><tr>{''.join(names)}</tr></thead>" if head else ""
    lines = []
    for k, row in enumerate(rows):
        look = f' class="{row_css[k]}"' if k < len(row_css) and row_css[k] else ""
        lines.append(f"<tr{look}>{table_cell(row[0], 'th')}{''.join(map(table_cell, row[1:]))}</tr>")
    region = f' tabindex="0" role="region" aria-label="{escape(label)}, scrolls sideways"' if label else ""
    look = f' class="{css}"' if css else ""
    return f'<div class="table"{region}><table{look}>{header}<tbody>{"".join(lines)}</tbody></table></div>'


def table_section(
    title: str,
    rows: Iterable[Sequence[str]],
    head: Sequence[str] = (),
    place: Literal["left", "right", "full", "small"] = "small",
    note: str = "",
    kind: str = "",
) -> Section:
    """A section with one table; `kind` is its CSS class."""
    return Section(title, table(rows, head, kind), place=place, note=note)


def table_cell(text: str, tag: Literal["td", "th"] = "td") -> str:
    """A cell; a number and its unit stay on one line, so that a narrow page scrolls the table instead."""
    if isinstance(text, Markup):
        return text
    if tag == "th":
        return f"<th scope=row>{escape(text)}</th>"
    figures = any(c.isdigit() for c in text) and not _WORDS.search(text)
    return f"<td{' class=number' * figures}>{escape(text)}</td>"


def number_text(value: float | None, unit: str | None, with_unit: bool = False) -> str:
    """A value with about three significant digits; `FreeArt.numberText` does the same."""
    if value is None or unit is None:
        return NONE
    small = abs(value) < 10 or unit in ("dB", "fraction")
    digits = _DIGITS.get(unit, 2) if small else 1 if abs(value) < 99.95 else 0
    return f"{value:.{digits}f}{_SIGNS.get(unit, '') if with_unit else ''}"


def source_rows(source: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Nested facts as rows: names joined by commas, values as text; None is left out."""
    rows: list[tuple[str, str]] = []
    for key, value in source.items():
        name = str(key).replace("_", " ")
        if isinstance(value, Mapping):
            rows += [(f"{name}, {inner}", text) for inner, text in source_rows(value)]
        elif value is not None:
            rows.append((name, _plain(value)))
    return rows


def certificate_section(certificate: Certificate) -> Section:
    """How good an asset is, from its certificate: a column a link, then what holds for the whole."""
    links = certificate.links

    def per_link(text: Callable[[LinkCertificate], str]) -> list[str]:
        return [text(link) for link in links.values()]

    def distance(link: LinkCertificate, key: str) -> str:
        return f"{1000 * link.contact[key]:.2g} mm" if key in link.contact else NONE

    def supposed(link: LinkCertificate) -> str:
        return ", ".join(f"{how} {share:.0%}" for how, share in link.supposed.items()) or "nothing"

    span = [
        ("Trust", ": ".join(filter(None, [certificate.trust, "; ".join(certificate.reasons)]))),
        ("Upright by", certificate.upright),
        ("Visual meshes in each other", f"{1000 * certificate.visual_overlap_m:.2g} mm at most"),
        ("Collision shapes in each other", f"{1000 * certificate.contact_overlap_m:.2g} mm at most"),
        *(
            (_engine_title(engine, of.version), ": ".join(filter(None, [of.verdict, ", ".join(of.failed)])))
            for engine, of in certificate.engines.items()
        ),
    ]
    rows = [
        ["Area that was seen", *per_link(lambda link: f"{link.seen_share:.0%}")],
        ["The rest", *per_link(supposed)],
        ["Visual to contact, median", *per_link(lambda link: distance(link, "median_m"))],
        ["Visual to contact, 95 % within", *per_link(lambda link: distance(link, "worst_of_95_m"))],
        ["Contact beyond visual, 95 % within", *per_link(lambda link: distance(link, "outward_95_m"))],
        ["Mass", *per_link(lambda link: f"{link.mass_kg:.3g} kg")],
        ["Mass by", *per_link(lambda link: link.mass)],
        ["Mass, bounds", *per_link(lambda link: f"{link.mass_low_kg:.2g} to {link.mass_high_kg:.2g} kg")],
        ["Material", *per_link(lambda link: link.material)],
    ]
    return Section("Certificate", table(span) + table(rows, ["", *links]), place="full")


def _engine_title(engine: str, version: str) -> str:
    return "Rules on files" if engine == "file" else f"Tried in {engine} {version}".strip()


def _plain(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return ", ".join(_plain(entry) for entry in value) or "none"
    if isinstance(value, Mapping):
        return "; ".join(f"{name} {text}" for name, text in source_rows(value))
    return str(value)


def recording_rows(recording: Recording) -> list[tuple[str, str]]:
    """Facts about a video."""
    camera, n = recording.camera, len(recording)
    span = float(recording.times_s[-1] - recording.times_s[0])
    rate = f", {(n - 1) / span:.3g} per second" if n > 1 else ""
    return [
        ("Frames", f"{n}{rate}"),
        ("Length", f"{span:.3g} s"),
        ("Image size", f"{camera.width} x {camera.height} pixels"),
        ("Focal length", f"{camera.K[0, 0]:.1f}, {camera.K[1, 1]:.1f} pixels"),
        ("Principal point", f"{camera.K[0, 2]:.1f}, {camera.K[1, 2]:.1f}"),
        ("Held-out views", str(len(recording.queries))),
        ("Licence", str(recording.licence or "not stated")),
    ]


def joint_rows(joint: Joint, states: Sequence[float] | np.ndarray) -> list[tuple[str, str]]:
    """Type, axis, pivot, limits, and the range of the video's states (n,)."""
    rows = [("Type", joint.type), ("Axis", _vector(joint.axis))]
    if joint.type == "revolute":
        rows.append(("Pivot", f"{_vector(joint.pivot)} m"))
    return [
        *rows,
        ("Limits", limits_text(joint.type, joint.lower, joint.upper)),
        ("States in the video", limits_text(joint.type, float(np.min(states)), float(np.max(states)))),
    ]


def alternative_rows(other: Alternative) -> list[tuple[str, str]]:
    """Rows of `joint_rows` and the cost of a pixel under the joint, beyond that under the result's."""
    return [*joint_rows(other.joint, other.states), ("Cost of a pixel, difference", f"{other.cost_difference:+.3f}")]


def compared_rows(
    estimate: Joint, states: np.ndarray, true: Joint, true_states: np.ndarray
) -> list[tuple[str, str, str]]:
    """The rows of `joint_rows` for an estimated and a true joint side by side, both in the estimate's frame.

    Any point of the axis may be its pivot: shown is the one of the true axis nearest to the estimated pivot.
    """
    true = replace(true, pivot=true.pivot + true.axis * (true.axis @ (estimate.pivot - true.pivot)))
    left, right = dict(joint_rows(estimate, states)), dict(joint_rows(true, true_states))
    return [(name, left.get(name, "-"), right.get(name, "-")) for name in {**left, **right}]


def seconds_section(seconds: Mapping[str, float], peak_bytes: int | None = None) -> Section:
    """Seconds of every stage, with bars, and the peak memory when known."""
    longest = max([*seconds.values(), 1e-9])
    rows: list[list[str]] = [[stage, bar(max(v, 0.0) / longest), f"{v:.2f} s"] for stage, v in seconds.items()]
    rows.append(["total", "", f"{sum(seconds.values()):.2f} s"])
    if peak_bytes is not None:
        rows.append(["peak memory", "", f"{peak_bytes / 1e9:.2f} GB"])
    return Section("Time per stage", table(rows, row_css=[""] * len(seconds) + ["total"]))


def score_section(scores: Mapping[str, Any], note: str = "", place: Literal["right", "small"] = "right") -> Section:
    """The table of scores, with a `note` under it, such as the protocol.

    `scores` maps a metric's id to its value, or to {"value", "unit", "better" ('up' or 'down'), "beside", "label"}:
    `beside` is a second figure as text, such as '0.4 cm', `label` the metric's name, else made from the id. Raises
    FreeArtError on anything else.
    """
    rows = []
    for name, entry in scores.items():
        entry = entry if isinstance(entry, Mapping) else {"value": entry}
        value, better = entry.get("value"), entry.get("better")
        if not (value is None or isinstance(value, int | float | str)) or better not in (None, *ARROWS):
            raise FreeArtError(f"score '{name}' is {entry!r}, expected a value, and better 'up' or 'down'")
        arrow = '<abbr title="{1}">{0}</abbr>'.format(*ARROWS[better]) if better else ""
        label = escape(entry.get("label") or name.replace("_", " ").capitalize())
        texts = escape(_score_text(value, entry.get("unit"))), escape(entry.get("beside") or "")
        rows.append([Markup(f"<th scope=row>{label} {arrow}</th>"), *map(Markup, map(_FIGURE, texts))])
    return Section("Score", table(rows, css="scores"), place=place, note=note)


_FIGURE = "<td class=number>{}</td>".format


def _score_text(value: float | str | None, unit: str | None) -> str:
    if value is None or isinstance(value, str):
        return value or NONE
    if unit in _DIGITS and not isinstance(value, int):
        return number_text(value, unit, True)
    return f"{value:.4g}{f' {unit}' if unit else ''}"


def link_section(urdf: Urdf) -> Section:
    """Mass properties of every link with a shape or a mass."""
    rows = []
    for link in (urdf.links[name] for name in urdf.parents_first):
        if link.inertial is None and not link.visuals and not link.collisions:
            continue
        mass, centre, moments = "not given", "", ""
        if link.inertial is not None:
            mass, centre = f"{link.inertial.mass:.4g} kg", f"{_vector(link.inertial.centre)} m"
            moments = ", ".join(f"{moment:.3g}" for moment in np.diag(link.inertial.inertia))
        rows.append((link.name, mass, centre, moments, f"{len(link.visuals)} / {len(link.collisions)}"))
    return table_section(
        "Links", rows, ("", "mass", "centre of mass", "Ixx, Iyy, Izz, kg m²", "visual / collision shapes"), "full"
    )


def joint_section(urdf: Urdf, effects: Mapping[str, Sequence[Any]]) -> Section:
    """Every movable joint: limits, effort, velocity, and its `effects`, by the joint's name."""
    rows = []
    for name, joint in urdf.joints.items():
        if joint.joint_type is None:
            continue
        unit = ("N m", "rad/s") if joint.joint_type == "revolute" else ("N", "m/s")
        acting = "; ".join(effect_text(effect, joint) for effect in effects.get(name, ())) or "none"
        rows.append(
            (
                name,
                joint.type,
                f"{joint.parent} → {joint.child}",
                _vector(joint.axis),
                limits_text(joint.joint_type, joint.lower, joint.upper),
                "-" if joint.effort is None else f"{joint.effort:g} {unit[0]}",
                "-" if joint.velocity is None else f"{joint.velocity:g} {unit[1]}",
                acting,
            )
        )
    return table_section(
        "Joints", rows, ("", "type", "links", "axis", "limits", "effort", "velocity", "effects"), "full"
    )


def effect_text(effect: Any, joint: UrdfJoint) -> str:
    """An effect with its values and units, such as 'viscous_damping (coefficient 0.02 N m s/rad)'."""
    assert joint.joint_type is not None
    parameters = ", ".join(
        f"{name} {getattr(effect, name):.4g} {spec.unit(joint.joint_type).replace('*', ' ')}"
        for name, spec in effect.parameters(joint.joint_type).items()
    )
    return f"{effect.name} ({parameters})"


def limits_text(joint_type: str, lower: float, upper: float) -> str:
    """Two states, rad or m, as text in degrees or centimetres."""
    unit, factor = display_unit(joint_type)
    if not np.isfinite([lower, upper]).any():
        return "none"
    low, high = (
        f"{round(factor * value, 1) + 0.0:.1f}" if np.isfinite(value) else "no limit" for value in (lower, upper)
    )
    return f"{low}° to {high}°" if unit == "°" else f"{low} to {high} {unit}"


def _vector(values: np.ndarray) -> str:
    return ", ".join(f"{value:.3f}" for value in np.round(np.asarray(values), 3) + 0.0)
