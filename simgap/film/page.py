"""The page of a gap between two films: camera faults, confidence, where they act, and one frame three times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.files import checked
from freeart21.se3 import Array
from freeart21.view.document import Markup, Section, data_url, document
from freeart21.view.tables import table_section
from simgap.film.answer import FilmVerdict, size_text
from simgap.film.result import FilmResult
from simgap.film.samples import simulate_frame
from simgap.page.replay_page import repeat_section
from simgap.page.report import (
    Ranked,
    answer_section,
    doubt_sections,
    maps_section,
    parameters_section,
    ranking_section,
)
from simgap.page.report_plots import map_drawing, p_text
from simgap.select.predictive import score_difference

Image = NDArray[np.uint8]
MARGIN = 0.12
"""Margin round the object's box, as a share of it."""
WIDEST = 420
"""Largest width of a picture on the page, pixels."""
_BLUE, _RED = np.array([0, 114, 178.0]), np.array([213, 94, 0.0])


def page(verdict: FilmVerdict, found: FilmResult, command: str, seconds: float) -> str:
    """The page as HTML. `command` repeats it."""
    n = {k: len(v) for k, v in verdict.frames.items()}
    chips = [
        f"{sum(n.values())} frames: {n['fit']} fitted, {n['choose']} choosing, {n['confirm']} confirming",
        f"poses from {verdict.poses}",
        f"{seconds:.0f} s",
    ]
    largest = sorted(verdict.gaps, key=lambda g: -g.before / max(g.floor, 1e-12))[:4]
    tiles = [
        (
            f"{size_text(g.before, g.unit)} → {size_text(g.after, g.unit)}",
            f"{g.regime}, on confirming frames",
            f"floor {size_text(g.floor, g.unit)}",
        )
        for g in largest
    ]
    note = "Filmed with what is certain by `freeart21 record NAME --camera camera.json`." * bool(verdict.added)
    sections = [
        answer_section(verdict, tiles),
        _frame(verdict, found),
        *parameters_section(verdict, "revolute", note, lambda effect: "camera.json"),
        *doubt_sections(verdict, "all frames", _doubt(verdict)),
        *_maps(found),
    ]
    for kind in found.kinds:
        none = next(s for s in kind.scores if not s.names)
        ranking = [
            Ranked(
                tuple(n if n in kind.kind.effects else f"errors by {n}" for n in s.names),
                np.nan,
                *score_difference(s, kind.scores[0]),
            )
            for s in kind.scores[:8]
        ]
        if kind.names or kind.scores[0] is not none:
            sections += ranking_section(ranking, f"frames that chose ({kind.kind.name})")
    trial = any(g.trial is not None for g in verdict.gaps)
    head = ("", "before", "after, with camera.json", *["with all that is named"] * trial, "floor")
    rows = [
        (g.regime, *(size_text(v, g.unit) for v in (g.before, g.after, *[g.trial or 0.0] * trial, g.floor)))
        for g in verdict.gaps
    ]
    gaps = table_section("The gap on confirming frames", rows, head, "full")
    sections += [gaps, repeat_section({"All of it": command})]
    return document(found.film.recording.name, sections, "gap between films", chips)


def _doubt(verdict: FilmVerdict) -> list[tuple[str, Sequence[str]]]:
    found: list[tuple[str, Sequence[str]]] = []
    part = verdict.missing_part
    if part is not None:
        sides = " x ".join(f"{1e3 * v:.0f}" for v in part.size_m)
        at = ", ".join(f"{1e3 * v:.0f}" for v in part.middle_m)
        lines = [
            f"Something of about {sides} mm on its {part.part} part, at ({at}) mm of the canonical frame.",
            f"{part.frames} confirming frames show it, and {100 * part.share_explained:.0f} % of what they have beyond "
            "the asset lies there.",
        ]
        found.append(("The asset lacks", lines))
    unknown = [f"{names.replace('_', ' ')}: {why}" for names, why in verdict.cannot_tell]
    lists = ("Nothing can be said of these", unknown), ("What is left without a name", verdict.left)
    return [*found, *((title, lines) for title, lines in lists if lines)]


def _maps(found: FilmResult) -> list[Section]:
    maps = sorted(found.maps, key=lambda m: (m.bins.adjusted, not len(m.rows)))
    drawings = []
    for m in maps:
        if not len(m.rows):
            title, unit = f"{m.what} by {m.over}".capitalize(), m.over_unit.split(" ")[0]
            drawings.append(map_drawing(m.bins, title, m.unit, 1.0, unit))
            continue
        values = m.bins.mean.reshape(len(m.rows) - 1, -1)
        reach = float(np.nanquantile(np.abs(values), 0.98)) or 1.0
        level = np.clip(np.nan_to_num(values) / reach, -1, 1)[..., None]
        colours = np.where(level > 0, 255 + level * (_RED - 255), 255 - level * (_BLUE - 255))
        colours[~np.isfinite(values)] = 225
        image = cv2.resize(np.rint(colours).astype(np.uint8), None, fx=24, fy=24, interpolation=cv2.INTER_NEAREST)
        about = f"p = {p_text(m.bins.p_value)}, blue -{reach:.2g}, red +{reach:.2g} {m.unit}"
        drawings.append(_picture(f"{m.what} over the picture".capitalize(), about, np.asarray(image, np.uint8)))
    note = "Measured less simulated, as the asset is with an ideal camera; holes are against their frame's mean."
    return maps_section(drawings, [m.bins for m in maps], "signs of frames", note)


def _picture(title: str, about: str, image: Image) -> Markup:
    figure = Markup('<figure><figcaption><b>{0}</b>, {1}</figcaption><img class="pixels" alt="{0}" src="{2}"></figure>')
    return figure.format(title, about, data_url("image/png", checked.encode_png(image)))


def _frame(verdict: FilmVerdict, found: FilmResult) -> Section:
    """The confirming frame with the largest error: measured, simulated, and simulated with the camera's faults."""
    of = {f.frame: f for f in found.rows.frames}
    index = max(verdict.frames["confirm"], key=lambda i: np.nansum(np.abs(of[i].fields["error"])))
    recording, scene, camera = found.film.recording, found.film.scene, verdict.camera
    fps = 1 / float(np.median(np.diff(recording.times_s)))
    frame = recording.frame(index)
    ideal = simulate_frame(scene, recording.camera, type(camera)(), index, fps).colour
    then = simulate_frame(scene, recording.camera, camera, index, fps)
    rest = replace(camera, depth_shift_u=0.0, depth_shift_v=0.0, depth_turn=0.0)
    rng = np.random.default_rng([index, 51])
    depth = rest.depth(then.depth.depth, then.depth.brightness, then.depth.cosine, recording.camera, rng)
    rgb = camera.colour(np.rint(then.colour.rgb).astype(np.uint8), index / max(len(recording) - 1, 1))
    on = frame.mask | (ideal.part > 0)
    ends = [np.flatnonzero(on.any(axis))[[0, -1]] for axis in (1, 0)]
    pad = int(MARGIN * max(np.ptp(e) for e in ends)) + 4
    box = tuple(slice(max(e[0] - pad, 0), e[1] + pad) for e in ends)
    seen = ideal.depth[ideal.depth > 0]
    room = 0.15 * max(float(np.ptp(seen)), 0.02 * float(seen.max()))
    near, far = float(seen.min()) - room, float(seen.max()) + room
    depths = [
        _coloured(np.where(on | (d > 0) & (d < far), d, 0)[box], near, far) for d in (frame.depth, ideal.depth, depth)
    ]
    colours = [frame.rgb[box], np.rint(ideal.rgb).astype(np.uint8)[box], rgb[box]]
    names = ["measured", "simulated, as the asset is", "simulated, with camera.json"]
    factor, figures = min(WIDEST / colours[0].shape[1], 4.0), Markup("")
    how = cv2.INTER_NEAREST if factor > 1 else cv2.INTER_AREA
    for what, images in (("Colour", colours), ("Depth", depths)):
        for name, image in list(zip(names, images, strict=True))[: 2 if camera.is_ideal else 3]:
            sized = np.asarray(cv2.resize(image, None, fx=factor, fy=factor, interpolation=how), np.uint8)
            figures += _picture(what, name, sized)
    note = f"Depth from {near:.3g} m (dark) to {far:.3g} m (light); white: none; grey: beyond. The asset is not lit."
    html = Markup('<div class="charts pictures">{}</div>').format(figures)
    return Section(f"Frame {index}, of the confirming ones", html, place="full", note=note)


def _coloured(depth: Array, near: float, far: float) -> Image:
    """Near dark, far light (viridis); white for none, grey beyond."""
    level = np.clip((depth - near) / max(far - near, 1e-9), 0, 1)
    out = cv2.applyColorMap((255 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1].copy()
    out[depth <= 0] = 255
    out[depth > far] = 128
    return np.asarray(out, np.uint8)
