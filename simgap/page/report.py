"""The page of a gap: missing effects, confidence, where they act, and how much smaller the gap is with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import get_args

import numpy as np

from freeart21.effects.base import Effect
from freeart21.joint import JointType
from freeart21.measured import Measured
from freeart21.view.document import Markup, Section, document, render
from freeart21.view.plots import Curve, curves_section
from freeart21.view.tables import NONE, Cell, table_section
from simgap.geometry.finding import KinematicsFinding
from simgap.models.localise import LEVEL, ResidualMap
from simgap.models.surrogate import Nuisance
from simgap.page.replay_page import repeat_section
from simgap.page.report_plots import AFTER, BEFORE, chart, drawn_samples, force_map, p_text, run_section
from simgap.prove.body import NO_CORRECTION, BodyCorrection
from simgap.prove.comparison import ReplayComparison, ReplayGap, track_use
from simgap.select.words import amount, capitalise, effect_label, effect_words, number_text, runs_text
from simgap.settings import JudgementSettings
from simgap.verdict import GEOMETRY, NamedEffect, RunGap, Use, Verdict, deciding_runs, root_mean_square, unit_of

Tile = tuple[str, str, str]
"""A figure with its description and a remark."""
PACKAGE = "simgap.page"
ROLLED_BACK = "with the repair that was rolled back"
MOST_RUNS = 4
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
    """One evaluated set of effects."""

    names: tuple[str, ...]
    """Effects; none for the asset as it is."""
    rms: float
    """Normalised RMS of test runs: 1 is noise alone."""
    ahead: float = 0.0
    """Log density less that of the most probable set; NaN without one,"""
    error: float = 0.0
    """... and its standard error."""


@dataclass(frozen=True)
class Draft:
    """Result of fits and model selection, before the replay in SAPIEN."""

    verdict: Verdict
    """With gaps of the fits; those of replayed runs are measured anew."""
    nuisance: Nuisance = field(default_factory=Nuisance)
    """Errors of the asset itself, corrected in the maps."""
    ranking: tuple[Ranked, ...] = ()
    """Best first."""
    geometry: KinematicsFinding | None = None
    floor: float = 0.0
    """Noise sigma at rest, rad or m."""
    motion_differs: bool = True
    """Whether the motion along the joint differs; without that there are no maps."""
    certain: tuple[NamedEffect, ...] = ()
    """Effects named without doubt; only these go into the asset."""
    curves: tuple[ReplayGap, ...] = ()
    """Force by inverse dynamics of runs with prescribed motion: with the asset as given and with the best set."""
    body: BodyCorrection = NO_CORRECTION
    """Correction of the asset's inertia and weight."""
    dominant: float = JudgementSettings.dominant
    """Share of the gap that the delivered asset may leave of confirming runs."""


@dataclass(frozen=True)
class Gap:
    """Contents of the page."""

    title: str
    measured: Measured
    verdict: Verdict
    draft: Draft
    maps: tuple[ResidualMap, ...] = ()
    comparison: ReplayComparison | None = None
    notes: tuple[str, ...] = ()
    """Other remarks, such as a repair that was rolled back."""
    seconds: float | None = None

    @property
    def motion(self) -> list[RunGap]:
        """Gaps along the joint."""
        return [g for g in self.verdict.gaps if g.regime != GEOMETRY]

    @property
    def in_turn(self) -> bool:
        """Whether no motion run is held out for good; the fits then hold out each in turn."""
        return all(g.use == "fitted" for g in self.motion)

    @property
    def motion_differs(self) -> bool:
        """Whether the answer includes motion, not the joint's geometry alone."""
        kinds = [named.effect.kind for named in self.verdict.effects]
        return not kinds or any(kind != "kinematics" for kind in kinds)

    @property
    def second_curve(self) -> str | None:
        """Name of the second curve of a replayed run; None without one."""
        verdict = self.verdict
        if self.comparison is None or not self.comparison.changed:
            return None
        if verdict.verdict == "ambiguous":
            return "with the best of these answers"
        moved = any(n.effect.kind != "kinematics" and n.effect.name in verdict.added for n in verdict.effects)
        return "after" if moved or verdict.corrections else ROLLED_BACK

    def text(self, value: float) -> str:
        """A gap as text: length or angle, or force for prescribed motion."""
        return amount(value, unit_of(self.verdict.by, self.measured.joint_type))


def page(gap: Gap) -> str:
    """The page as HTML."""
    verdict = gap.verdict
    uses, kind = list({g.run: g.use for g in verdict.gaps}.values()), gap.measured.joint_type
    counts = ", ".join(f"{uses.count(use)} {use}" for use in get_args(Use) if use in uses)
    chips = [f"joint {gap.measured.joint}, {kind}", f"{len(uses)} runs: {counts}"]
    if gap.seconds is not None:
        chips.append(f"{gap.seconds:.1f} s")
    names = list(dict.fromkeys(g.run for g in verdict.gaps if g.use == "fitted"))
    fitted = f"run {names[0]}" if len(names) == 1 else f"{len(names)} runs: {', '.join(names)}"
    sections = [
        answer_section(verdict, _tiles(gap), gap.notes),
        *parameters_section(verdict, kind, f"Fitted to {fitted}.", _file_of),
        *doubt_sections(verdict, runs_text(uses)),
    ]
    motion, geometry = [*_runs(gap), *_maps(gap)], _geometry(gap)
    sections += [*motion, *geometry] if gap.motion_differs else [*geometry, *motion]
    marked = [g.use for g in gap.motion if g.use == "choosing"]
    of = runs_text(marked) if marked else runs_text([g.use for g in gap.motion if g.use == "fitted"], in_turn=True)
    sections += [*ranking_section(gap.draft.ranking[:12], of), _gaps(gap)]
    if verdict.proof is not None:
        texts = {
            "before": "The gap before, from the files of the asset as it was given",
            "after": "The gap after, from the files of the asset beside the verdict",
            "trial": "The gap with the trial repair, which is not in that asset",
        }
        absent = verdict.proof.witness.get("absent")
        note = f"MuJoCo has not witnessed it: {absent}." if absent else "Add --engine mujoco for MuJoCo's numbers."
        sections.append(repeat_section({texts[k]: line for k, line in verdict.proof.repeat.items()}, note))
    return document(gap.title, sections, "gap", chips)


def answer_section(verdict: Verdict, tiles: Sequence[Tile], notes: Sequence[str] = ()) -> Section:
    """The sentence, and the main figures."""
    word = _WORDS[verdict.verdict] + ", in part" * verdict.in_part
    lines = *notes, *verdict.notes
    html = render("answer.html.j2", PACKAGE, verdict=verdict, word=word, tiles=tiles, notes=lines)
    return Section("The answer", html, place="full")


def _tiles(gap: Gap) -> list[Tile]:
    """The gap before and, where replayed, after: of motion, and of poses off the joint."""
    tiles = []
    motion = [g for g in gap.motion if np.isfinite(g.before)]
    if gap.motion_differs and motion:
        replayed = gap.comparison is not None and bool(gap.comparison.runs)
        after = gap.second_curve if replayed else None
        tiles.append(_sizes(motion, gap.text, "gap ", after, gap.in_turn and not replayed))
    off = [g for g in gap.verdict.gaps if g.regime == GEOMETRY]
    if off:
        tiles.append(_sizes(off, lambda v: amount(v, "m"), "gap off the joint, ", "after"))
    return tiles


def _sizes(
    gaps: list[RunGap], text: Callable[[float], str], what: str, after_is: str | None, in_turn: bool = False
) -> Tile:
    """A tile with the gap before and, unless rolled back, after, relative to noise, on the deciding runs."""
    judged = deciding_runs(gaps)
    before, floor = (root_mean_square([getattr(g, name) for g in judged]) for name in ("before", "floor"))
    after = root_mean_square([g.after if g.trial is None else g.trial for g in judged])
    shown = [before, after] if after_is and after_is != ROLLED_BACK and np.isfinite(after) else [before]
    how = f"before and {after_is}, in SAPIEN, " if len(shown) > 1 else ""
    times = " → ".join(f"{v / floor:.1f}" for v in shown)
    return (
        " → ".join(map(text, shown)),
        f"{what}{how}on {runs_text([g.use for g in judged], in_turn)}",
        f"{times} times the sensor's noise, {text(floor)}",
    )


def parameters_section(verdict: Verdict, kind: JointType, note: str, file_of: Callable[[Effect], str]) -> list[Section]:
    """Every parameter of the named effects and every correction, with 90 % interval and file (`file_of` an effect)."""
    rows = []
    for c in verdict.corrections:
        value, low, high = (f"{v:.4g}" if c.unit == "1" else number_text(v, c.unit) for v in (c.value, c.low, c.high))
        head = Cell("The asset's own", below="in asset/: <inertial>")
        rows.append((head, Cell(c.name, below=_OWN[c.unit]), Cell(value, below=f"{low} to {high}")))
    for named in verdict.effects:
        effect = named.effect
        file = f"in {file_of(effect)}" if effect.name in verdict.added else "not written"
        head = Cell(capitalise(effect_label(effect.name)), below=f"{effect.name}, {file}")
        for name, spec in effect.parameters(kind).items():
            ends = named.low[name], named.high[name]
            value, low, high = (number_text(v, spec.unit(kind)) for v in (getattr(effect, name), *ends))
            span = f"{low} to {high}" if np.isfinite(ends).any() else ""
            rows.append((head, Cell(name, below=spec.meaning), Cell(value, below=span)))
            head = Cell()
    if not rows:
        return []
    whole = {named.effect.name for named in verdict.effects} <= set(verdict.added)
    part = f"; written: {', '.join(verdict.added)}" if verdict.added else ", not certain, and not written"
    title = "What was written" if whole else f"The best explanation{part}"
    return [table_section(title, rows, ("", "parameter", "value, 90 % interval"), "full", note)]


def _file_of(effect: Effect) -> str:
    """Files of the delivered asset that contain an effect."""
    more = ", ".join(f"<dynamics {name}>" for name in effect.urdf_dynamics())
    return f"asset/effects.json{', URDF ' * bool(more)}{more}"


_OWN = {"1": "times what the asset says", "rad": "of the pull of its weight"}


def doubt_sections(verdict: Verdict, of: str, more: Sequence[tuple[str, Sequence[str]]] = ()) -> list[Section]:
    """Rivals, other doubts (`more`: titles and lines), the next experiment, and flagged regions in the runs `of`."""
    rivals = [
        f"{capitalise(' and '.join(effect_label(n) for n in names))} ({', '.join(names)})" for names in verdict.rivals
    ]
    lists = [*([("These explain what was measured equally well", rivals)] if rivals else []), *more]
    found = []
    if lists or verdict.next_experiment:
        html = render("doubt.html.j2", PACKAGE, lists=lists, next_experiment=verdict.next_experiment)
        title = "What these runs cannot decide" if rivals else "What is in doubt" if more else "What would tell more"
        found.append(Section(title, html, place="full"))
    if verdict.where:
        rows = [(w.text, p_text(w.p_value)) for w in verdict.where[:8]]
        rest = f"And {len(verdict.where) - 8} more." if len(verdict.where) > 8 else ""
        found.append(table_section(f"Where it shows, in {of}", rows, ("", "p"), "full", rest))
    return found


def _runs(gap: Gap) -> list[Section]:
    """Runs before and after, replayed in SAPIEN, or by inverse dynamics for prescribed motion."""
    replayed = gap.comparison.runs if gap.comparison is not None else ()
    most = MOST_RUNS if gap.motion_differs else 1
    names: tuple[str, str | None]
    if replayed:
        second = gap.second_curve
        runs, where, names = replayed, "in SAPIEN", ("as the asset was" if second else "as the asset is", second)
    else:
        nearest = "with the nearest try, which is no answer" if gap.verdict.verdict == "unexplained" else None
        runs, where, names = gap.draft.curves, "by inverse dynamics", ("as the asset is", nearest)
    sections = []
    for run in sorted(runs, key=lambda r: get_args(Use)[::-1].index(r.use))[:most]:  # deciding ones first
        role = run.use if run.use != "fitted" or replayed else "held out in turn"
        facts = ", ".join(w for w in (role, run.regime, where) if w)
        sizes = [gap.text(v) for v in (run.before, run.after)]
        title = f"Run {run.run}, {facts}: {' → '.join(sizes if names[1] else sizes[:1])}"
        sections.append(run_section(title, run, gap.measured.joint_type, names, gap.verdict.by))
    return sections


def _maps(gap: Gap) -> list[Section]:
    """Maps of the missing force, the most significant first."""
    maps = sorted(gap.maps, key=lambda m: m.p_value)
    note = (
        "What force the asset's equation lacks, by the accelerations in "
        f"{runs_text([*{g.run: g.use for g in gap.verdict.gaps}.values()])}; bars with standard errors."
    )
    return maps_section([force_map(m, gap.measured.joint_type) for m in maps], maps, "half-swings", note)


def maps_section(drawings: Sequence[Markup], maps: Sequence[ResidualMap], units: str, note: str) -> list[Section]:
    """Maps of where measurement and simulation differ, the most significant first; insignificant ones are collapsed."""
    if not maps:
        return []
    sure = [drawing for drawing, m in zip(drawings, maps, strict=True) if m.adjusted <= LEVEL]
    rest = [drawing for drawing, m in zip(drawings, maps, strict=True) if m.adjusted > LEVEL]
    note += (
        f" {len(sure)} of {len(maps)} maps differ from nothing beyond chance ({units} flipped at random, corrected for "
        "the number of maps); where, is on colour. These maps point; the fits decide."
    )
    html = render("maps.html.j2", PACKAGE, sure=sure, rest=rest)
    return [Section("Where simulation and measurement differ", html, place="full", note=note)]


def _geometry(gap: Gap) -> list[Section]:
    """The part's displacement off its joint, from poses alone."""
    g = gap.draft.geometry
    if g is None or not g.tracks:
        return []
    track = sorted(g.tracks, key=lambda t: not t.held_out)[0]
    drawn = drawn_samples(len(track.times_s), 500)
    charts = []
    for columns, what, unit, factor in (
        (slice(0, 3), "shift of the part's middle", "mm", 1e3),
        (slice(3, 6), "turn", "°", 180 / np.pi),
    ):
        both = ("before", BEFORE, track.off_before), ("after", AFTER, track.off_after)
        lines = [Curve(n, colour, factor * np.linalg.norm(off[drawn, columns], axis=1)) for n, colour, off in both]
        charts.append(chart(lines, f"Off the joint: {what}", unit))
    chosen = {e.name for e in g.effects}
    shown = [r for r in g.ranking if len(r[0]) < 2 or set(r[0]) == chosen or r[0] in g.rivals]
    what = f"Run {track.name}, {'held out' if track.held_out else 'fitted'}"
    note = (
        "The position along the joint is free in every frame here, so no dynamics is in it: what remains is geometry. "
        + capitalise("; ".join(effect_words(e, gap.measured.joint_type) for e in g.effects))
    )
    of = f"poses of {runs_text([track_use(t) for t in g.tracks if not t.held_out])}, left out in turn"
    ranking = ranking_section([Ranked(names, float(np.sqrt(loss)), np.nan) for names, loss, _ in shown], of)
    title = (
        f"Off its joint: {what}, {1e3 * track.gap_before:.2g} mm → {1e3 * track.gap_after:.2g} mm "
        f"(noise {1e3 * track.floor:.2g} mm)"
    )
    x = track.times_s[drawn] - track.times_s[0]
    return [curves_section(title, charts, x, note=note), *ranking]


def ranking_section(ranking: Sequence[Ranked], of: str) -> list[Section]:
    """Evaluated sets with their error on `of`."""
    worst = max((np.log10(max(r.rms, 1.0)) for r in ranking if np.isfinite(r.rms)), default=0.0)
    rows = []
    for r in ranking:
        names = capitalise(" and ".join(effect_label(n) for n in r.names) or "nothing is missing")
        behind = "0" if r.ahead == 0.0 else "" if np.isnan(r.ahead) else f"{r.ahead:.0f} ± {r.error:.0f}"
        cells: list[object] = [Cell(names, below=", ".join(r.names)), behind]
        if worst:
            cells += [Cell(bar=np.log10(max(r.rms, 1.0)) / worst, css="bar"), f"{r.rms:.2f}"]
        rows.append(cells)
    heads = ("", "log probability", *("error (log)", "error / noise") * bool(worst))
    return [table_section(f"Explanations, judged on {of}", rows, heads, "full")] if ranking else []


def _gaps(gap: Gap) -> Section:
    """All runs in numbers."""
    proof = gap.verdict.proof
    witness = {} if proof is None else {row["run"]: row for row in proof.witness.get("gap", ())}
    shown = [g for g in gap.verdict.gaps if np.isfinite(g.before)]
    rows = []
    for g in shown:
        off = g.regime == GEOMETRY
        seen = {} if off else witness.get(g.run, {})
        sizes = {
            "gap before": g.before,
            "after": g.after,
            "trial repair": g.trial,
            "floor": g.floor,
            "MuJoCo: before": seen.get("before"),
            "MuJoCo: after": seen.get("after"),
        }
        in_turn = gap.verdict.by != "position" and not off and gap.in_turn
        use = "held out in turn" if g.use == "fitted" and in_turn else g.use
        texts = {k: NONE if v is None else amount(v, "m") if off else gap.text(v) for k, v in sizes.items()}
        rows.append({"run": g.run, "use": use, "motion": g.regime, **texts})
    empty = [name for name in sizes if all(row[name] == NONE for row in rows)] if rows else []
    rows = [{name: text for name, text in row.items() if name not in empty} for row in rows]
    still = len(gap.verdict.gaps) - len(shown)
    note = ""
    if gap.comparison is not None and gap.comparison.runs:
        note = (
            "Replayed by the files in a fresh process in SAPIEN, each run at the time step that it needs, "
            f"{1e3 * gap.comparison.timestep_s:g} ms at the finest; the last halving changed a run, before or after, "
            f"by no more than {gap.comparison.numerics:.2g} sigmas."
        )
    note += f" {still} more runs were not replayed." if still else ""
    return table_section("Runs", rows, (), "full", note)
