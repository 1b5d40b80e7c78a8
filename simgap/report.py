"""The page of a gap: what is missing, how sure that is, where it shows, and how much smaller the gap is with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from freeart21.files import atomic
from freeart21.joint import JointType
from freeart21.view.document import Section, document, escape
from freeart21.view.plot import display_unit
from freeart21.view.tables import table_section
from simgap.kinematics import KinematicsFinding
from simgap.localise import LEVEL, ResidualMap
from simgap.report_plots import AFTER, BEFORE, Line, chart, interval_drawing, map_drawing, p_text, run_drawings
from simgap.show import Shown
from simgap.track_geometry import TrackGeometry
from simgap.verdict import Verdict
from simgap.words import capital, effect_words, number_text, plain

MOST_RUNS = 6
"""Held-out runs that are drawn."""
_WORDS = {
    "no_gap": "No gap",
    "named": "Named",
    "ambiguous": "More than one answer",
    "unexplained": "Unexplained",
    "not_excited": "Cannot tell from these runs",
}


@dataclass(frozen=True)
class Ranked:
    """One explanation that was tried."""

    names: tuple[str, ...]
    """Effects; none for the asset as it is."""
    floors: float
    """Held-out error in floors: 1 is noise alone."""
    p_value: float | None = None
    """Chance that effects that do not exist look as good."""
    note: str = ""


@dataclass(frozen=True)
class Gap:
    """All that the page shows."""

    title: str
    joint: str
    joint_type: JointType
    verdict: Verdict
    ranking: tuple[Ranked, ...] = ()
    """Best first."""
    maps: tuple[ResidualMap, ...] = ()
    shown: Shown | None = None
    geometry: KinematicsFinding | None = None
    notes: tuple[str, ...] = ()
    """What else should be known, such as that a repair was rolled back."""
    seconds: float | None = None


def write_report(path: Path, gap: Gap) -> None:
    """Write the page, one file that needs no other."""
    atomic.write_bytes(path, page(gap).encode())


def page(gap: Gap) -> str:
    """The page as HTML."""
    verdict = gap.verdict
    held = [g for g in verdict.gaps if g.held_out]
    chips = [f"joint {gap.joint}, {gap.joint_type}", f"{len(verdict.gaps)} runs, {len(held)} held out"]
    if gap.seconds is not None:
        chips.append(f"{gap.seconds:.1f} s")
    sections = [_answer(gap), *_parameters(gap), *_doubt(gap), *_runs(gap), *_maps(gap), *_geometry(gap)]
    sections += [*_ranking(gap), *_gaps(gap)]
    return document(gap.title, sections, "gap", chips)


def _answer(gap: Gap) -> Section:
    """The sentence, and the three figures that matter."""
    verdict = gap.verdict
    tiles = _tiles(gap)
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in gap.notes)
    html = (
        f'<p class="verdict {escape(verdict.verdict)}"><b>{escape(_WORDS[verdict.verdict])}</b></p>'
        f'<p class="sentence">{escape(verdict.sentence)}</p>'
        f'<div class="tiles">{"".join(tiles)}</div>{notes}'
    )
    return Section("The answer", html, place="full")


def _tiles(gap: Gap) -> list[str]:
    runs = [g for g in gap.verdict.gaps if g.held_out] or list(gap.verdict.gaps)
    if not runs:
        return []
    before, after, floor = (
        float(np.sqrt(np.mean([getattr(r, name) ** 2 for r in runs]))) for name in ("before", "after", "floor")
    )
    where = "on runs never fitted" if any(r.held_out for r in runs) else "on the fitted runs"
    tiles = [_tile(length_text(before, gap.joint_type), f"gap before, {where}", f"{before / floor:.1f} floors")]
    if np.isfinite(after) and gap.shown is not None:
        tiles.append(_tile(length_text(after, gap.joint_type), "gap after, in SAPIEN", f"{after / floor:.1f} floors"))
    tiles.append(_tile(length_text(floor, gap.joint_type), "floor: the sensor's noise", ""))
    if gap.shown is not None:
        fitted = {r.regime for r in gap.verdict.gaps if not r.held_out}
        regimes = {r.regime for r in gap.shown.runs}
        same, other = gap.shown.closed(regimes & fitted or regimes), gap.shown.closed(regimes - fitted)
        if same is not None:
            tiles.append(_tile(f"{100 * same:.0f} %", "of the gap closed", "same kind of motion as was fitted"))
        if other is not None and regimes & fitted and regimes - fitted:
            kinds = ", ".join(sorted(regimes - fitted))
            tiles.append(_tile(f"{100 * other:.0f} %", "closed in other motion", kinds))
    return tiles


def _tile(figure: str, what: str, more: str) -> str:
    return f"<div><b>{escape(figure)}</b><span>{escape(what)}</span><small>{escape(more)}</small></div>"


def _parameters(gap: Gap) -> list[Section]:
    """Every parameter of the named effects, with its interval."""
    rows = []
    for named in gap.verdict.effects:
        specs = named.effect.parameters(gap.joint_type)
        for k, (name, spec) in enumerate(specs.items()):
            unit = spec.unit(gap.joint_type)
            value, low, high = getattr(named.effect, name), named.low[name], named.high[name]
            head = (
                f"<b>{escape(capital(plain(named.effect.name)))}</b><br>{escape(named.effect.name)}" if k == 0 else ""
            )
            rows.append(
                f"<tr><th scope=row>{head}</th><td>{escape(name)}<br><small>{escape(spec.meaning)}</small></td>"
                f"<td><b>{escape(number_text(value, unit))}</b></td>"
                f"<td>{escape(number_text(low, unit))} to {escape(number_text(high, unit))}</td>"
                f"<td>{interval_drawing(value, low, high)}</td></tr>"
            )
    if not rows:
        return []
    head = "".join(f"<th scope=col>{cell}</th>" for cell in ("", "parameter", "value", "90 % interval", ""))
    html = f'<div class="table"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
    title = "What was added to the asset" if gap.verdict.verdict == "named" else "The best explanation, not certain"
    return [Section(title, html, place="full")]


def _doubt(gap: Gap) -> list[Section]:
    """Rivals and the next experiment, and where something remains."""
    verdict, lines = gap.verdict, []
    for names in verdict.rivals:
        said = capital(" and ".join(plain(n) for n in names))
        lines.append(f"<li>{escape(said)} <small>{escape(', '.join(names))}</small></li>")
    html = ""
    if lines:
        html += "<p>These explain the runs equally well:</p>" + f'<ul class="remarks">{"".join(lines)}</ul>'
    if verdict.next_experiment:
        html += f'<p class="next"><b>Next experiment.</b> {escape(verdict.next_experiment)}</p>'
    title = "What the data cannot tell apart" if lines else "What would tell more"
    found = [Section(title, html, place="full")] if html else []
    if verdict.where:
        spots = "".join(
            f"<li>{escape(w.text)} <small>p = {escape(p_text(w.p_value))}</small></li>" for w in verdict.where[:8]
        )
        more = f'<p class="note">And {len(verdict.where) - 8} more.</p>' if len(verdict.where) > 8 else ""
        found.append(Section("Where it shows", f'<ul class="remarks two">{spots}</ul>{more}', place="full"))
    return found


def _runs(gap: Gap) -> list[Section]:
    """Held-out runs before and after, as SAPIEN replays them."""
    if gap.shown is None:
        return []
    runs = sorted(gap.shown.runs, key=lambda r: not r.held_out)[:MOST_RUNS]
    sections = []
    for run in runs:
        figures, data = run_drawings(run, gap.joint_type)
        sizes = " → ".join(length_text(v, gap.joint_type) for v in (run.gap_before, run.gap_after))
        facts = ", ".join(w for w in ("held out" if run.held_out else "fitted", run.regime) if w)
        title = f"Run {run.run}, {facts}: {sizes}"
        sections.append(Section(title, f'<div class="charts">{"".join(figures)}</div>', "curves", data, "full"))
    return sections


def _maps(gap: Gap) -> list[Section]:
    """Maps of the missing force, the surest first."""
    if not gap.maps:
        return []
    maps = sorted(gap.maps, key=lambda m: m.p_value)
    drawn = "".join(map_drawing(m, gap.joint_type) for m in maps)
    told = sum(m.adjusted <= LEVEL for m in maps)
    note = (
        "What force the asset's equation lacks, by the accelerations of the fitted runs; bars with standard errors. "
        f"{told} of {len(maps)} maps differ from nothing beyond chance (half-swings flipped at random, corrected for "
        "the number of maps); where, is on colour. These maps point; the fits decide."
    )
    return [
        Section(
            "Where simulation and measurement part",
            f'<div class="charts maps">{drawn}</div><p class="note">{escape(note)}</p>',
            place="full",
        )
    ]


def _geometry(gap: Gap) -> list[Section]:
    """How far the part is off its joint, by the poses alone."""
    if gap.geometry is None or not gap.geometry.tracks:
        return []
    g = gap.geometry
    track = sorted(g.tracks, key=lambda t: not t.held_out)[0]
    figures = "".join(
        _off_drawing(track, columns, title, unit, factor)
        for columns, title, unit, factor in (
            (slice(0, 3), "Off the joint: shift of the part's middle", "mm", 1e3),
            (slice(3, 6), "Off the joint: turn", "°", 180 / np.pi),
        )
    )
    rows = [
        (
            capital(" and ".join(plain(n) for n in names) or "the asset's ideal joint"),
            f"{np.sqrt(loss):.2f}",
            p_text(p) if names else "",
        )
        for names, loss, p in g.ranking[:6]
    ]
    what = f"Run {track.name}" + (", held out" if track.held_out else "")
    note = (
        "The position along the joint is free in every frame here, so no dynamics is in it: what remains is geometry. "
        + capital("; ".join(effect_words(e, gap.joint_type) for e in g.effects))
    )
    table = table_section(
        "Geometry, by held-out poses",
        rows,
        ("", "error, in floors", "p of no gain"),
        "small",
        f"{g.remainder_floors:.1f} floors of displacement go with the position and have no name.",
    )
    drawing = Section(
        f"Off its joint: {what}, {1e3 * track.gap_before:.2g} mm → {1e3 * track.gap_after:.2g} mm "
        f"(noise {1e3 * track.floor:.2g} mm)",
        f'<div class="charts">{figures}</div><p class="note">{escape(note)}</p>',
        place="full",
    )
    return [drawing, table]


def _off_drawing(track: TrackGeometry, columns: slice, title: str, unit: str, factor: float) -> str:
    kept = np.unique(np.linspace(0, len(track.times_s) - 1, min(500, len(track.times_s))).astype(int))
    lines = [
        Line(name, colour, factor * np.linalg.norm(off[kept][:, columns], axis=1))
        for name, colour, off in (("before", BEFORE, track.off_before), ("after", AFTER, track.off_after))
    ]
    return chart(track.times_s[kept] - track.times_s[0], lines, title, unit, height=170)


def _ranking(gap: Gap) -> list[Section]:
    """Every explanation tried, by what it leaves on runs that it was not fitted to."""
    if not gap.ranking:
        return []
    worst = max(np.log10(max(r.floors, 1.0)) for r in gap.ranking) or 1.0
    rows = []
    for r in gap.ranking[:12]:
        names = capital(" and ".join(plain(n) for n in r.names) or "nothing is missing")
        share = 100 * np.log10(max(r.floors, 1.0)) / worst
        p = "" if r.p_value is None else p_text(r.p_value)
        rows.append(
            f"<tr><th scope=row>{escape(names)}<br><small>{escape(', '.join(r.names))}</small></th>"
            f'<td class="bar"><i style="width:{share:.1f}%"></i></td><td>{r.floors:.2f}</td>'
            f"<td>{escape(p)}</td><td>{escape(r.note)}</td></tr>"
        )
    head = "".join(f"<th scope=col>{cell}</th>" for cell in ("", "held-out error (log)", "floors", "p", ""))
    html = f'<div class="table"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
    return [Section("Explanations, by held-out error", html, place="full")]


def _gaps(gap: Gap) -> list[Section]:
    """All runs in numbers."""
    rows = [
        (
            g.run,
            "held out" if g.held_out else "fitted",
            g.regime,
            length_text(g.before, gap.joint_type),
            length_text(g.after, gap.joint_type) if np.isfinite(g.after) else "-",
            length_text(g.floor, gap.joint_type),
        )
        for g in gap.verdict.gaps
    ]
    note = ""
    if gap.shown is not None:
        note = (
            f"Replayed in a fresh process in SAPIEN at {1e3 * gap.shown.timestep_s:g} ms; halving that changes the "
            f"longest run by {gap.shown.numerics:.2g} floors."
        )
    return [table_section("Runs", rows, ("", "", "motion", "gap before", "after", "floor"), "full", note)]


def length_text(value: float, kind: JointType) -> str:
    """A joint's position or a difference of two, in degrees or millimetres."""
    if kind == "prismatic":
        return f"{1e3 * value:.2g} mm" if value < 0.0995 else f"{1e3 * value:.0f} mm"
    return f"{display_unit(kind)[1] * value:.2g}°"
