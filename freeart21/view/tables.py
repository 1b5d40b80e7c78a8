"""Tables of pages, and the rows of those about recordings, joints, links, scores and run times."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from freeart21.files.certificate import Certificate
from freeart21.files.urdf import Urdf
from freeart21.joint import Joint
from freeart21.recording import Recording
from freeart21.view.document import Markup, Place, Section, render
from freeart21.view.plots import display_unit

ARROWS = {"up": ("↑", "larger is better"), "down": ("↓", "smaller is better")}
NONE = "\N{EN DASH}"
"""Shown where a number is missing."""
_DIGITS = {"deg": 2, "%": 2, "cm": 2, "dB": 1, "fraction": 3, "m": 4, "rad": 3, "1": 3, "dm²": 4, "points": 1}
_SIGNS = {"deg": "°", "%": " %", "dB": " dB", "cm": " cm", "m": " m", "rad": " rad"}
_WORDS = re.compile(r"[^\W\d_]{4,}|, ")
"""A word of four letters or more, or a comma: a cell with one is text or a list, not a number with its unit."""


@dataclass(frozen=True)
class Cell:
    """A cell or a heading with more than a text."""

    text: object = ""
    """Escaped unless it is `Markup`."""
    value: object = None
    """What it is sorted by, when not by its text."""
    css: str = ""
    below: object = ""
    """A smaller second line."""
    bar: float | None = None
    """A bar over this share of the cell's width, 0 to 1, in place of the text."""
    title: str = ""
    """Tooltip."""
    link: bool = False
    """Of a heading that is a link, not a button to sort by."""


def number_cell(text: str, best: bool = False, value: float | None = None, below: object = "") -> Cell:
    """A right-aligned number."""
    return Cell(text, value, "number" + " best" * best, below)


def table(
    rows: Sequence[Sequence[object] | Mapping[str, object]],
    head: Sequence[object] = (),
    css: str = "",
    label: str = "",
    row_css: Sequence[str] = (),
) -> Markup:
    """A table in a box that scrolls sideways.

    Args:
        rows: Texts or `Cell`s; the first one of a row is its heading. Mappings, all with the same keys, have them by
            the headings of the columns.
        head: Headings of the columns, where rows have none.
        css: Class of the table; with 'sortable' a click on a heading sorts the rows.
        label: What the table is, for screen readers; the keyboard then scrolls it.
        row_css: Class of each row, when given.
    """
    head = list(rows[0]) if rows and isinstance(rows[0], Mapping) else head
    lists = [list(row.values()) if isinstance(row, Mapping) else row for row in rows]
    lines = [
        (row_css[k] if row_css else "", [_cell(one, i) for i, one in enumerate(row)]) for k, row in enumerate(lists)
    ]
    heads = [one if isinstance(one, Cell) else Cell(one) for one in head]
    return render("table.html.j2", rows=lines, head=heads, css=css, label=label, sortable="sortable" in css.split())


def table_section(
    title: str,
    rows: Sequence[Sequence[object] | Mapping[str, object]],
    head: Sequence[object] = (),
    place: Place = "small",
    note: str = "",
    css: str = "",
) -> Section:
    """A section with one table; `css` is its class."""
    return Section(title, table(rows, head, css), place=place, note=note)


def _cell(given: object, column: int) -> Cell:
    """A number and its unit stay on one line, so that a narrow page scrolls the table instead."""
    if isinstance(given, Cell):
        return given
    text = str(given)
    is_number = column > 0 and any(c.isdigit() for c in text) and not _WORDS.search(text)
    return Cell(given, css="number" if is_number else "")


def number_text(value: float | None, unit: str | None, with_unit: bool = False) -> str:
    """A value with about three significant digits."""
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


def certificate_section(certificate: Certificate) -> Section:
    """How good an asset is, from its certificate: what holds for the whole, then a row a link."""
    engines = {
        f"{engine} {of.version}".strip(): ", ".join([of.verdict, *of.failed])
        for engine, of in certificate.engines.items()
    }
    whole = source_rows(
        {
            "Trust": [certificate.trust, *certificate.reasons],
            "Upright by": certificate.upright,
            "Visual meshes in each other": f"{1000 * certificate.visual_overlap_m:.2g} mm at most",
            "Collision shapes in each other": f"{1000 * certificate.contact_overlap_m:.2g} mm at most",
            "Tried": engines,
        }
    )
    mm = {
        name: {key: f"{1000 * value:.2g}" for key, value in link.contact.items()}
        for name, link in certificate.links.items()
    }
    links = [
        {
            "": name,
            "seen": f"{link.seen_share:.0%}",
            "the rest": ", ".join(f"{how} {share:.0%}" for how, share in link.supposed.items()) or "nothing",
            "visual to contact": f"{mm[name].get('median_m', NONE)}; {mm[name].get('worst_of_95_m', NONE)} mm",
            "contact beyond visual": f"{mm[name].get('outward_95_m', NONE)} mm",
            "mass": f"{link.mass_kg:.3g} kg",
            "by": link.mass,
            "bounds": f"{link.mass_low_kg:.2g} to {link.mass_high_kg:.2g} kg",
            "material": link.material,
        }
        for name, link in certificate.links.items()
    ]
    note = (
        "Visual to contact: the median; 95 % of the surface lie within the second number, as of contact beyond visual."
    )
    return Section("Certificate", table(whole) + table(links), place="full", note=note)


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
    pivot = [("Pivot", f"{_vector(joint.pivot)} m")] if joint.type == "revolute" else []
    return [
        ("Type", joint.type),
        ("Axis", _vector(joint.axis)),
        *pivot,
        ("Limits", limits_text(joint.type, joint.lower, joint.upper)),
        ("States in the video", limits_text(joint.type, float(np.min(states)), float(np.max(states)))),
    ]


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
    rows: list[list[object]] = [
        [stage, Cell(bar=max(v, 0.0) / longest, css="bar"), f"{v:.2f} s"] for stage, v in seconds.items()
    ]
    rows.append(["total", "", f"{sum(seconds.values()):.2f} s"])
    if peak_bytes is not None:
        rows.append(["peak memory", "", f"{peak_bytes / 1e9:.2f} GB"])
    return table_section("Time per stage", rows)


def score_section(
    scores: Mapping[str, Mapping[str, Any]], note: str = "", place: Literal["right", "small"] = "right"
) -> Section:
    """The table of scores, with a `note` under it, such as the protocol.

    `scores` maps a metric's id to its "label", "value", "unit", "better" ('up' or 'down') and "beside", a second figure
    as text, such as '0.4 cm'. All may lack.
    """
    rows = []
    for name, entry in scores.items():
        value, unit = entry.get("value"), entry.get("unit")
        arrow, meaning = ARROWS.get(entry.get("better") or "", ("", ""))
        if value is None or isinstance(value, str):
            text = value or NONE
        elif unit in _DIGITS and not isinstance(value, int):
            text = number_text(value, unit, True)
        else:
            text = f"{value:.4g}{f' {unit}' if unit else ''}"
        label = entry.get("label") or name.replace("_", " ").capitalize()
        numbers = (Cell(one, css="number") for one in (text, entry.get("beside") or ""))
        rows.append([Cell(f"{label} {arrow}".strip(), title=meaning), *numbers])
    return table_section("Score", rows, (), place, note, "scores")


def link_section(urdf: Urdf) -> Section:
    """Mass properties of every link with a shape or a mass."""
    links = [urdf.links[name] for name in urdf.parents_first]
    rows = [
        {
            "": link.name,
            "mass": "not given" if link.inertial is None else f"{link.inertial.mass:.4g} kg",
            "centre of mass": "" if link.inertial is None else f"{_vector(link.inertial.centre)} m",
            "Ixx, Iyy, Izz, kg m²": ""
            if link.inertial is None
            else ", ".join(f"{moment:.3g}" for moment in np.diag(link.inertial.inertia)),
            "visual / collision shapes": f"{len(link.visuals)} / {len(link.collisions)}",
        }
        for link in links
        if link.inertial is not None or link.visuals or link.collisions
    ]
    return table_section("Links", rows, (), "full")


def joint_section(urdf: Urdf, effects: Mapping[str, Sequence[Any]]) -> Section:
    """Every movable joint: limits, effort, velocity, and its `effects`, by the joint's name."""
    rows = []
    for name, joint in urdf.joints.items():
        if joint.joint_type is None:
            continue
        words = []
        for effect in effects.get(name, ()):
            values = ", ".join(
                f"{key} {getattr(effect, key):.4g} {spec.unit(joint.joint_type).replace('*', ' ')}"
                for key, spec in effect.parameters(joint.joint_type).items()
            )
            words.append(f"{effect.name} ({values})")
        effort, velocity = ("N m", "rad/s") if joint.joint_type == "revolute" else ("N", "m/s")
        rows.append(
            {
                "": name,
                "type": joint.type,
                "links": f"{joint.parent} → {joint.child}",
                "axis": _vector(joint.axis),
                "limits": limits_text(joint.joint_type, joint.lower, joint.upper),
                "effort": NONE if joint.effort is None else f"{joint.effort:g} {effort}",
                "velocity": NONE if joint.velocity is None else f"{joint.velocity:g} {velocity}",
                "effects": "; ".join(words) or "none",
            }
        )
    return table_section("Joints", rows, (), "full")


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
