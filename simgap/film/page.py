"""The page of a gap between two films: what the camera does, how sure that is, where it shows, and one frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from freeart21.files import atomic, checked
from freeart21.view.document import MOVING, REFERENCE, Section, data_url, document, escape
from freeart21.view.tables import table_section
from simgap.film.choose import Tried, standard_error
from simgap.film.errors import film_maps
from simgap.film.found import Found
from simgap.film.pictures import Image, heat, shown
from simgap.film.verdict import FilmGap, FilmVerdict
from simgap.film.where import LEVEL, FilmMap
from simgap.film.words import PLAIN

_WORDS = {
    "no_gap": "No gap",
    "named": "Named",
    "ambiguous": "More than one answer",
    "unexplained": "Unexplained",
}
_LEFT, _RIGHT, _TOP, _BOTTOM = 50, 8, 8, 22
BEFORE, AFTER = MOVING, REFERENCE
"""Orange for the film as it was, blue with the camera's faults."""


def write_page(path: Path, verdict: FilmVerdict, found: Found, seconds: float) -> None:
    """Write the page, one file that needs no other."""
    atomic.write_bytes(path, page(verdict, found, seconds).encode())


def page(verdict: FilmVerdict, found: Found, seconds: float) -> str:
    """The page as HTML."""
    frames = {k: len(v) for k, v in verdict.frames.items()}
    chips = [
        f"{len(found.frames)} frames: {frames['fit']} fit, {frames['choose']} choose, {frames['confirm']} kept back",
        f"poses from {verdict.poses}",
        f"{seconds:.0f} s",
    ]
    sections = [_answer(verdict), _frame(verdict, found), *_parameters(verdict), *_doubt(verdict)]
    sections += [_maps(found), _explanations(found), _gaps(verdict)]
    return document(found.recording.name, sections, "gap between films", chips)


def _answer(verdict: FilmVerdict) -> Section:
    word = _WORDS[verdict.verdict] + ", in part" * verdict.in_part
    shown_gaps = sorted(verdict.gaps, key=lambda g: -(g.before / max(g.floor, 1e-12)))[:4]
    tiles = "".join(
        f"<div><b>{escape(size_text(g.before, g.unit))} → {escape(size_text(g.after, g.unit))}</b>"
        f"<span>{escape(g.quantity)}, on the frames kept back</span>"
        f"<small>floor {escape(size_text(g.floor, g.unit))}</small></div>"
        for g in shown_gaps
    )
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in verdict.notes)
    html = (
        f'<p class="verdict {escape(verdict.verdict)}"><b>{escape(word)}</b></p>'
        f'<p class="sentence">{escape(verdict.sentence)}</p><div class="tiles">{tiles}</div>{notes}'
    )
    return Section("The answer", html, place="full")


def size_text(value: float, unit: str) -> str:
    """A size with its unit, for people."""
    if unit == "m":
        return f"{1e3 * value:.2g} mm"
    return f"{100 * value:.2g} %" if unit == "" else f"{value:.2g} {unit}"


def _frame(verdict: FilmVerdict, found: Found) -> Section:
    """The frame kept back that the film as it is misses most."""
    confirm = found.split[2]
    rows = found.rows
    size = [
        float(np.nanmedian(np.abs(rows.frames[int(i)].error))) if len(rows.frames[int(i)].error) else 0.0
        for i in confirm
    ]
    index = int(found.frames[confirm[int(np.nanargmax(size))]])
    pictures = shown(found.recording, found.scene, index, verdict.camera)
    names = ("measured", "simulated, as the asset is", "simulated, with the camera's faults")
    figures = "".join(
        f'<figure><figcaption><b>{what}</b>, {name}</figcaption><img alt="{what}, {name}" src="{_png(image)}" '
        'style="width:100%;image-rendering:pixelated;border-radius:6px"></figure>'
        for what, images in (("Colour", pictures.colours), ("Depth", pictures.depths))
        for name, image in zip(names, images, strict=True)
    )
    note = (
        f"Depth from {pictures.near:.3g} m (dark) to {pictures.far:.3g} m (light); white: none; grey: beyond. The "
        "asset's colours are not lit."
    )
    style = "grid-template-columns:repeat(auto-fit,minmax(min(100%,340px),1fr))"
    html = f'<div class="charts" style="{style}">{figures}</div><p class="note">{escape(note)}</p>'
    return Section(f"Frame {index}, which was kept back", html, place="full")


def _png(image: Image) -> str:
    return data_url("image/png", checked.encode_png(image))


def _parameters(verdict: FilmVerdict) -> list[Section]:
    rows = []
    for effect in verdict.effects:
        for k, (name, p) in enumerate(effect.parameters.items()):
            value = ", ".join(f"{v:.2g}" for v in p.value) if isinstance(p.value, tuple) else f"{p.value:.4g}"
            between: str = "" if p.low is None or p.high is None else f"{p.low:.4g} to {p.high:.4g}"
            sure = "" if effect.certain else "not certain"
            head = (PLAIN[effect.name], f"{effect.p_value:.2g}", sure) if k == 0 else ("", "", "")
            rows.append((head[0], name, f"{value} {p.unit}".strip(), between, head[1], head[2]))
    if not rows:
        return []
    certain = [e.name for e in verdict.effects if e.certain]
    note = (
        "camera.json holds what is certain; `freeart21 record NAME --camera camera.json` films with it."
        if certain
        else ""
    )
    return [
        table_section("What the camera does", rows, ("", "parameter", "value", "90 % interval", "p", ""), "full", note)
    ]


def _doubt(verdict: FilmVerdict) -> list[Section]:
    html = ""
    if verdict.rivals:
        sets = "".join(f"<li>{escape(' and '.join(PLAIN[n] for n in names))}</li>" for names in verdict.rivals)
        html += f'<p>These explain the frames equally well:</p><ul class="remarks">{sets}</ul>'
    part = verdict.missing_part
    if part is not None:
        sides = " x ".join(f"{1e3 * v:.0f}" for v in part.size)
        at = ", ".join(f"{1e3 * v:.0f}" for v in part.middle)
        html += (
            f"<p>The asset lacks something of about {escape(sides)} mm on its {escape(part.part)} part, at "
            f"({escape(at)}) mm of the canonical frame; {part.frames} frames kept back show it, and "
            f"{100 * part.told:.0f} % of what they have beyond the asset lies there.</p>"
        )
    if verdict.cannot_tell:
        lines = "".join(
            f"<li><b>{escape(names.replace('_', ' '))}</b>: {escape(why)}</li>" for names, why in verdict.cannot_tell
        )
        html += f'<p>Nothing can be said of these:</p><ul class="remarks">{lines}</ul>'
    if verdict.left:
        lines = "".join(f"<li>{escape(line)}</li>" for line in verdict.left)
        html += f'<p>What is left without a name:</p><ul class="remarks">{lines}</ul>'
    return [Section("What is in doubt, and what is left", html, place="full")] if html else []


def _maps(found: Found) -> Section:
    maps = sorted(film_maps(found), key=lambda m: (m.p_value, not len(m.rows)))
    drawn = "".join(_picture_map(m) if len(m.rows) else _bars(m) for m in maps)
    told = sum(m.adjusted <= LEVEL for m in maps)
    note = (
        "Means over all frames, orange as the asset is, blue with what was found. "
        f"{told} of {len(maps)} maps differ from nothing beyond chance (signs of frames flipped at random, corrected "
        "for the number of maps); where, is on colour. Holes and brightness are against their frame's and film's mean. "
        "These maps point; the frames kept back decide."
    )
    html = f'<div class="charts maps">{drawn}</div><p class="note">{escape(note)}</p>'
    return Section("Where the two films part", html, place="full")


def _factor(m: FilmMap) -> float:
    return {"mm": 1e3, "%": 100.0}.get(m.unit, 1.0)


def _caption(m: FilmMap) -> str:
    text = f"{m.what[:1].upper()}{m.what[1:]}"
    return (
        f"<figcaption><b>{escape(text)}</b>, {escape(m.unit)}, by {escape(m.over)}; p = {m.adjusted:.2g}</figcaption>"
    )


def _bars(m: FilmMap, width: int = 330, height: int = 150) -> str:
    f = _factor(m)
    before, after = f * m.before, f * m.after
    both = np.concatenate([before, after])
    low, high = min(float(np.nanmin(both)), 0.0), max(float(np.nanmax(both)), 0.0)
    pad = 0.08 * (high - low) or 1.0
    low, high = low - pad, high + pad
    n = len(before)
    ends = np.linspace(_LEFT, width - _RIGHT, n + 1)

    def down(v: float) -> float:
        return float(_TOP + (high - v) / (high - low) * (height - _TOP - _BOTTOM))

    parts = [f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(m.what)} by {escape(m.over)}">']
    for k in range(n):
        x, w = float(ends[k]), float(ends[k + 1] - ends[k])
        if m.flagged[k]:
            parts.append(
                f'<rect class="flagged" x="{x:.1f}" width="{w:.1f}" y="{_TOP}" height="{height - _TOP - _BOTTOM}"/>'
            )
        for values, colour, at, share in ((before, BEFORE, 0.14, 0.34), (after, AFTER, 0.52, 0.34)):
            if np.isfinite(values[k]):
                y0, y1 = sorted((down(0.0), down(float(values[k]))))
                parts.append(
                    f'<rect fill="{colour}" x="{x + at * w:.1f}" width="{share * w:.1f}" y="{y0:.1f}" '
                    f'height="{max(y1 - y0, 0.8):.1f}"/>'
                )
    parts.append(f'<line class="zero" x1="{_LEFT}" x2="{width - _RIGHT}" y1="{down(0):.1f}" y2="{down(0):.1f}"/>')
    for v in (low + pad, high - pad):
        parts.append(f'<text x="{_LEFT - 5}" y="{down(v) + 4:.1f}" text-anchor="end">{v:.2g}</text>')
    for k in (0, n // 2, n):
        anchor = "start" if k == 0 else "end" if k == n else "middle"
        unit = f" {m.over_unit.split(' ')[0]}" if k == n and len(m.over_unit.split(" ")[0]) < 3 else ""
        parts.append(
            f'<text x="{ends[k]:.1f}" y="{height - 6}" text-anchor="{anchor}">{m.edges[k]:.3g}{escape(unit)}</text>'
        )
    return f"<figure>{_caption(m)}{''.join(parts)}</svg></figure>"


def _picture_map(m: FilmMap) -> str:
    f = _factor(m)
    reach = float(np.nanquantile(np.abs(f * m.before), 0.98)) or 1.0
    images = []
    for values in (m.before, m.after):
        small = heat(f * values, reach)
        images.append(cv2.resize(small, None, fx=12, fy=12, interpolation=cv2.INTER_NEAREST))
    gap = np.full((images[0].shape[0], 10, 3), 255, np.uint8)
    both = np.concatenate([images[0], gap, images[1]], 1)
    note = f"left before, right after; blue -{reach:.2g}, red +{reach:.2g} {m.unit}"
    return (
        f'<figure>{_caption(m)}<img alt="{escape(m.what)} over the picture" src="{_png(both)}" style="width:100%;'
        f'image-rendering:pixelated;border-radius:4px"><small>{escape(note)}</small></figure>'
    )


def _explanations(found: Found) -> Section:
    kinds: list[tuple[str, Sequence[Tried], Tried | None, tuple[str, ...]]] = [
        ("depth and outlines", found.geometry.tried, found.geometry.null, tuple(e.key for e in found.geometry.chosen))
    ]
    kinds += [(f.kind, f.tried, f.null, f.chosen) for f in found.families]
    if found.drift is not None:
        kinds.append(("colours", found.drift.tried, found.drift.null, found.drift.chosen))
    rows = []
    for kind, tried, null, chosen in kinds:
        if null is None:
            continue
        kept = [t for t in tried if t.nameless][:2] + [t for t in tried if not t.nameless][:4]
        if all(t.names != chosen for t in kept):
            kept += [t for t in tried if t.names == chosen and not t.nameless]
        for k, t in enumerate(sorted(kept, key=lambda t: -t.mean)):
            gain = t.densities - null.densities
            names = " and ".join(_said(n) for n in t.names) or "nothing"
            mark = "chosen" if t.names == chosen and not t.nameless else "nameless" if t.nameless else ""
            error = standard_error(gain)
            spread = f"{error:.2g}" if np.isfinite(error) else ""
            rows.append((kind if k == 0 else "", names, f"{gain.mean():.1f}", spread, mark))
    note = (
        "Log predictive density that a frame gains over the film as it is, on frames that choose and were not fitted."
    )
    return table_section("Explanations that were tried", rows, ("", "", "gain", "standard error", ""), "full", note)


def _said(key: str) -> str:
    name, _, way = key.partition(",")
    if name not in PLAIN:
        return f"a free map by {key}"
    return PLAIN[name] + (f" ({way.strip()})" if way else "")


def _gaps(verdict: FilmVerdict) -> Section:
    def cells(g: FilmGap) -> tuple[str, ...]:
        return g.quantity, *(size_text(v, g.unit) for v in (g.before, g.after, g.floor))

    return table_section(
        "The gap on the frames kept back", [cells(g) for g in verdict.gaps], ("", "before", "after", "floor"), "full"
    )
