"""The numbers of a page: facts, found against true, seconds a stage, scores."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files.urdf import Urdf, UrdfJoint
from freeart21.joint import Joint
from freeart21.recording import Recording
from freeart21.view.document import Section, escape
from freeart21.view.plot import display_unit

ARROWS = {"up": ("↑", "more is better"), "down": ("↓", "less is better")}


class Markup(str):
    """A whole cell of a table as HTML, already escaped."""

    __slots__ = ()


def two_lines(text: str, below: str, heading: bool = False, bold: bool = False) -> Markup:
    """A cell, or a row's heading, with a text, and a smaller one below."""
    lines = f"{f'<b>{escape(text)}</b>' if bold else escape(text)}<br><small>{escape(below)}</small>"
    return Markup(f"<th scope=row>{lines}</th>" if heading else f"<td>{lines}</td>")


def bar(share: float) -> Markup:
    """A cell with a bar as wide as this share of it, 0 to 1."""
    return Markup(f'<td class="bar"><i style="width:{100 * share:.1f}%"></i></td>')


def table_section(
    title: str,
    rows: Iterable[Sequence[str]],
    head: Sequence[str] = (),
    place: Literal["left", "right", "full", "small"] = "small",
    note: str = "",
    kind: str = "",
) -> Section:
    """A table of texts, all escaped here but `Markup`; the first cell of a row is its heading, `kind` a CSS class."""
    header = f"<thead><tr>{''.join(f'<th scope=col>{escape(cell)}</th>' for cell in head)}</tr></thead>" if head else ""
    body = "".join(f"<tr>{table_cell(row[0], 'th')}{''.join(map(table_cell, row[1:]))}</tr>" for row in rows)
    below = f'<p class="note">{escape(note)}</p>' if note else ""
    table = f"<table>{header}<tbody>{body}</tbody></table>"
    return Section(title, f'<div class="{f"table {kind}".strip()}">{table}</div>{below}', place=place)


def table_cell(text: str, tag: Literal["td", "th"] = "td") -> str:
    """A cell; one of numbers is never broken, so that a narrow page scrolls the table in its box instead."""
    if isinstance(text, Markup):
        return text
    if tag == "th":
        return f"<th scope=row>{escape(text)}</th>"
    figures = any(c.isdigit() for c in text) and not _WORDS.search(text)
    return f"<td{' class=number' * figures}>{escape(text)}</td>"


_WORDS = re.compile(r"[^\W\d_]{4,}")
"""A word of four letters or more: what has one is text, not numbers with their units."""


def source_rows(source: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Where an asset came from, one line for each thing: nested entries by their path, and nothing for None."""
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


def recording_rows(recording: Recording) -> list[tuple[str, str]]:
    """What is known of a video."""
    camera, n = recording.camera, len(recording)
    span = float(recording.times_s[-1] - recording.times_s[0])
    rate = f", {(n - 1) / span:.3g} per second" if n > 1 else ""
    return [
        ("Frames", f"{n}{rate}"),
        ("Length", f"{span:.3g} s"),
        ("Picture", f"{camera.width} x {camera.height} pixels"),
        ("Focal length", f"{camera.K[0, 0]:.1f}, {camera.K[1, 1]:.1f} pixels"),
        ("Principal point", f"{camera.K[0, 2]:.1f}, {camera.K[1, 2]:.1f}"),
        ("Held-out views", str(len(recording.queries))),
        ("Licence", str(recording.licence or "not stated")),
    ]


def joint_rows(joint: Joint, states: Sequence[float] | np.ndarray) -> list[tuple[str, str]]:
    """What is said of a joint: type, axis, pivot, limits, states of the video."""
    rows = [("Type", joint.type), ("Axis", _vector(joint.axis))]
    if joint.type == "revolute":
        rows.append(("Pivot", f"{_vector(joint.pivot)} m"))
    return [
        *rows,
        ("Limits", limits_text(joint.type, joint.lower, joint.upper)),
        ("States in the video", limits_text(joint.type, float(np.min(states)), float(np.max(states)))),
    ]


def compared_rows(
    found: Joint, found_states: np.ndarray, true: Joint, true_states: np.ndarray
) -> list[tuple[str, str, str]]:
    """The rows of `joint_rows` for a found and a true joint, side by side, both in the prediction's frame.

    A pivot may be any point of its axis: the true one is told where it is nearest to the found one.
    """
    true = replace(true, pivot=true.pivot + true.axis * (true.axis @ (found.pivot - true.pivot)))
    left, right = dict(joint_rows(found, found_states)), dict(joint_rows(true, true_states))
    return [(name, left.get(name, "-"), right.get(name, "-")) for name in {**left, **right}]


def seconds_section(seconds: Mapping[str, float], peak_bytes: int | None = None) -> Section:
    """Seconds a stage, with bars; most memory held, if known."""
    most, total = max([*seconds.values(), 1e-9]), sum(seconds.values())
    rows = "".join(
        f"<tr><th scope=row>{escape(stage)}</th>{bar(max(value, 0.0) / most)}<td>{value:.2f} s</td></tr>"
        for stage, value in seconds.items()
    )
    last = f'<tr class="total"><th scope=row>all</th><td></td><td>{total:.2f} s</td></tr>'
    if peak_bytes is not None:
        last += f"<tr><th scope=row>memory</th><td></td><td>{peak_bytes / 1e9:.2f} GB at most</td></tr>"
    return Section("Time per stage", f'<div class="table"><table><tbody>{rows}{last}</tbody></table></div>')


def score_section(scores: Mapping[str, Any], note: str = "", place: Literal["right", "small"] = "right") -> Section:
    """The score table, and below it `note`: by which protocol, of what.

    `scores` maps a metric's id to its value, or to {"value", "unit", "better" ('up' or 'down'), "beside", "label"};
    `beside` is a second figure as text, such as '0.4 cm', and `label` the metric's name for people, without which it is
    made of the id. Raises FreeArtError on anything else.
    """
    rows = []
    for name, entry in scores.items():
        entry = entry if isinstance(entry, Mapping) else {"value": entry}
        value, better = entry.get("value"), entry.get("better")
        if not (value is None or isinstance(value, int | float | str)) or better not in (None, *ARROWS):
            raise FreeArtError(f"score '{name}' is {entry!r}, expected a value, and better 'up' or 'down'")
        arrow = '<abbr title="{1}">{0}</abbr>'.format(*ARROWS[better]) if better else ""
        rows.append(
            f"<tr><th scope=row>{escape(entry.get('label') or _label(name))} {arrow}</th>"
            f"<td class=number>{escape(_score(value, entry.get('unit')))}</td>"
            f"<td class=number>{escape(entry.get('beside') or '')}</td></tr>"
        )
    below = f'<p class="note">{escape(note)}</p>' if note else ""
    table = f'<div class="table scores"><table><tbody>{"".join(rows)}</tbody></table></div>'
    return Section("Score", table + below, place=place)


def link_section(urdf: Urdf) -> Section:
    """Mass properties of every link that has any shape or mass."""
    rows = []
    for link in (urdf.links[name] for name in urdf.parents_first):
        if link.inertial is None and not link.visuals and not link.collisions:
            continue
        shapes = f"{len(link.visuals)} / {len(link.collisions)}"
        if link.inertial is None:
            rows.append((link.name, "not given", "", "", shapes))
            continue
        rows.append(
            (
                link.name,
                f"{link.inertial.mass:.4g} kg",
                f"{_vector(link.inertial.centre)} m",
                ", ".join(f"{moment:.3g}" for moment in np.diag(link.inertial.inertia)),
                shapes,
            )
        )
    return table_section(
        "Links", rows, ("", "mass", "centre of mass", "Ixx, Iyy, Izz, kg m²", "visuals / collisions"), "full"
    )


def joint_section(urdf: Urdf, effects: Mapping[str, Sequence[Any]]) -> Section:
    """Every movable joint: limits, effort, velocity, and the effects that act on it."""
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
    """Two states in degrees or centimetres."""
    unit, factor = display_unit(joint_type)
    if not np.isfinite([lower, upper]).any():
        return "none"
    low, high = (
        f"{round(factor * value, 1) + 0.0:.1f}" if np.isfinite(value) else "no limit" for value in (lower, upper)
    )
    return f"{low}° to {high}°" if unit == "°" else f"{low} to {high} {unit}"


def _vector(values: np.ndarray) -> str:
    return ", ".join(f"{value:.3f}" for value in np.round(np.asarray(values), 3) + 0.0)


_ACRONYMS = {
    "iou": "IoU",
    "psnr": "PSNR",
    "miou": "mean IoU",
    "fscore": "F-score",
    "ssim": "SSIM",
    "lpips": "LPIPS",
    "fps": "frames per second",
}


def _label(id: str) -> str:
    """A metric's id as people read it, such as 'Mask IoU, moving'."""
    words = [_ACRONYMS.get(word, word) for word in id.split("_")]
    text = " ".join(words)
    return text[:1].upper() + text[1:]


_UNITS = {"deg": "°", "fraction": "", "": ""}


def _score(value: float | str | None, unit: str | None) -> str:
    """A score with its unit, to three significant digits, and to no more than three decimals; tiny is 'below 0.001'."""
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    sign = _UNITS.get(unit or "", f" {unit}")
    if isinstance(value, int) or not np.isfinite(value):
        return f"{value}{sign}"
    if 0 < abs(value) < 0.001:
        return f"below 0.001{sign}" if value > 0 else f"above -0.001{sign}"
    digits = 0 if value == 0 else min(3, max(0, 2 - int(np.floor(np.log10(abs(value))))))
    return f"{value:.{digits}f}{sign}"
