"""From an explanation to what stands on disk: the repaired asset, shown in SAPIEN or rolled back, verdict and page."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects.base import Effect
from freeart21.effects.gravity_offset import GravityOffset
from freeart21.measured import Measured, Run
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array
from simgap.geometry.finding import KinematicsFinding
from simgap.geometry.placing import Placed, place
from simgap.geometry.track_geometry import lever_of, middle_of
from simgap.judgement.words import plain, runs_text, with_closed
from simgap.motion.equation_error import missing_force
from simgap.motion.localise import residual_maps, where
from simgap.motion.surrogate import Nuisance, Plant, plant_of
from simgap.page.report import GEOMETRY, Gap, Ranked, use_of, write_report
from simgap.proof.body import NO_CORRECTION, BodyCorrection
from simgap.proof.files import Chosen, replay_files
from simgap.proof.show import (
    SECONDS,
    CannotReplay,
    PosesReplayed,
    Progress,
    ReplayGap,
    Shown,
    address_of,
    alike,
    closed_alike,
    helps,
)
from simgap.proof.writeback import repaired
from simgap.settings import JudgementSettings
from simgap.verdict import Named, RunGap, Use, Verdict, halved, told_by

MOST_REPLAYS = 6
"""Runs that SAPIEN replays; of every regime some."""
_MOST_POSES = 150


@dataclass(frozen=True)
class Off:
    """How far an asset is off without anything missing, as a fit has it."""

    inertia: float = 1.0
    """True inertia over the asset's."""
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Torque of cos q and of sin q (N*m), or force (N): what true gravity has beyond the asset's."""


@dataclass(frozen=True)
class Draft:
    """What fits and choice have come to, before SAPIEN has seen it."""

    verdict: Verdict
    """Gaps as the fits have them; those of replayed runs are measured anew."""
    off: Off = Off()
    """How far the asset is off by itself, which the maps of where know."""
    ranking: tuple[Ranked, ...] = ()
    geometry: KinematicsFinding | None = None
    regimes: dict[str, str] = field(default_factory=dict)
    """Run name to regime."""
    floor: float = 0.0
    """rad or m."""
    moves_otherwise: bool = True
    """Whether the motion along the joint is other than simulated; without that, nothing is said of where."""
    certain: tuple[Named, ...] = ()
    """Effects that are named without doubt, whatever is said of the rest: only these go into the asset."""
    curves: tuple[ReplayGap, ...] = ()
    """Runs that were not fitted as the fits' own simulation has them, by the asset as it is and by the best that was
    found."""
    uses: dict[str, Use] = field(default_factory=dict)
    """Run name to what it was used for."""
    body: BodyCorrection = NO_CORRECTION
    """What the asset's inertia and weight are corrected by, beside the effects of the verdict."""
    dominant: float = JudgementSettings.dominant
    """Part of the gap that what is delivered may leave of confirming runs."""


def off_of(plant: Plant, nuisance: Nuisance) -> Off:
    """How a fit's nuisance changes inertia and gravity."""
    terms = plant.gravity_terms
    true = nuisance.gravity * (terms[0] + nuisance.lean[0] * terms[1] + nuisance.lean[1] * terms[2])
    cosine, sine, constant = (float(v) for v in true - terms[0])
    return Off(nuisance.inertia, (cosine, sine, constant))


def with_positions(measured: Measured, geometry: KinematicsFinding | None) -> Measured:
    """The set with the poses of its runs replaced by positions along the joint, the named geometry taken out."""
    if geometry is None:
        return measured
    of = {track.name: track for track in geometry.tracks}
    runs = tuple(
        replace(run, times_s=of[run.name].times_s, q=of[run.name].q, poses=None, seen=None)
        if run.poses is not None and run.name in of
        else run
        for run in measured.runs
    )
    return replace(measured, runs=runs)


def publish(
    asset: Asset,
    measured: Measured,
    draft: Draft,
    folder: Path,
    title: str,
    seconds: float | None = None,
    seed: int = 0,
    replay_seconds: float = SECONDS,
    progress: Progress | None = None,
) -> Verdict:
    """Write asset/, verdict.json and index.html into `folder`; the verdict as it stands after the replay in SAPIEN.

    Only effects that are certain are written into asset/. Those that do not help on runs that were not fitted are
    rolled back, motion and geometry each by itself, and the verdict is then unexplained. The best of several rivals is
    replayed, too, for the page, but not written.

    Args:
        asset: as it was.
        measured: all runs, poses too.
        draft: what the fits came to.
        folder: must exist.
        title: of the page.
        seconds: what the verdict took, for the page.
        seed: of permutations.
        replay_seconds: when these are over the replay is given up; the answer stays, and says so.
        progress: told how many runs are replayed.
    """
    placed = place(asset, measured.gravity)
    runs = with_positions(measured, draft.geometry)
    acting = asset.effects.get(asset.joint, ())
    known = _as_fitted(runs, placed, acting, draft.off, _limits(asset))
    found = missing_force(*known, plant=plant_of(asset, measured))
    maps = residual_maps(found, seed)
    verdict = draft.verdict
    if draft.moves_otherwise and not verdict.where:
        verdict = replace(verdict, where=where(maps, found, measured.joint_type))
    tried = verdict.effects if verdict.verdict in ("named", "ambiguous") else draft.certain
    shown, kept = None, draft.certain
    notes: list[str] = []
    if tried or draft.body != NO_CORRECTION:
        trial = Trial(asset, measured, runs, draft, placed, tried)
        shown, why = trial.replayed(replay_seconds, progress)
        verdict, kept, notes = _judged(verdict, draft, tried, shown, why, replay_seconds)
    source: dict[str, Any] = {"verdict": verdict.verdict, "effects": [n.effect.name for n in kept]}
    source |= {"corrections": [vars(c) for c in verdict.corrections]} if verdict.corrections else {}
    body = draft.body if verdict.corrections else NO_CORRECTION
    written = kept or verdict.corrections
    repaired(asset, tuple(n.effect for n in kept), folder / "asset", source if written else None, body)
    verdict = replace(verdict, added=tuple(n.effect.name for n in kept))
    verdict.write(folder / "verdict.json", measured.joint_type)
    write_report(
        folder / "index.html",
        Gap(
            title,
            measured.joint,
            measured.joint_type,
            verdict,
            draft.ranking,
            maps,
            shown,
            draft.geometry,
            tuple(notes),
            seconds,
            draft.curves,
        ),
    )
    return verdict


@dataclass(frozen=True)
class Trial:
    """Effects that are tried in SAPIEN."""

    asset: Asset
    measured: Measured
    runs: Measured
    """The same with positions in the place of poses."""
    draft: Draft
    placed: Placed
    tried: tuple[Named, ...]

    def replayed(self, seconds: float, progress: Progress | None) -> tuple[Shown | None, str]:
        """What SAPIEN shows, or why it cannot; None for nothing to show."""
        draft, runs = self.draft, self.runs
        moving = any(n.effect.kind != "kinematics" for n in self.tried) or draft.body != NO_CORRECTION
        able = [run for run in runs.runs if np.isfinite(run.q).any()] if draft.verdict.by == "position" else []
        picked = _picked(able, draft) if moving else []
        replays = tuple(self._chosen(run) for run in picked)
        tracks: tuple[PosesReplayed, ...] = ()
        if draft.geometry is not None and any(n.effect.kind == "kinematics" for n in self.tried):
            tracks = _tracks(self.measured, draft.geometry, self.placed, self.asset.state_zero)
        if not replays and not tracks:
            return None, ""
        try:
            return self._shown(replays, tracks, seconds, progress), ""
        except CannotReplay as error:
            return None, str(error)

    def _chosen(self, run: Run) -> Chosen:
        draft = self.draft
        return Chosen(run.name, draft.floor, draft.regimes.get(run.name, ""), draft.uses.get(run.name, "fitted"))

    def _shown(
        self,
        replays: tuple[Chosen, ...],
        tracks: tuple[PosesReplayed, ...],
        seconds: float,
        progress: Progress | None,
    ) -> Shown:
        with tempfile.TemporaryDirectory(prefix="freeart21-") as place_:
            after = Path(place_) / "asset"
            repaired(self.asset, tuple(n.effect for n in self.tried), after, body=self.draft.body)
            holding = self.draft.verdict.holding or 0.0
            before = address_of(self.asset)
            return replay_files(before, after, self.runs, replays, holding, tracks, seconds, progress, self.asset.root)


def _judged(
    verdict: Verdict,
    draft: Draft,
    tried: tuple[Named, ...],
    shown: Shown | None,
    why: str,
    seconds: float,
) -> tuple[Verdict, tuple[Named, ...], list[str]]:
    """The verdict after the replay, the effects that go into the asset, and what else must be said."""
    certain = draft.certain
    notes: list[str] = []
    if shown is None and not why:
        return verdict, certain, notes
    if shown is None:
        bad = [n for n in tried if n.effect.kind != "kinematics"]
        notes.append(f"SAPIEN could not replay {_names(bad or tried) or 'the corrected asset'}: {why}")
        return _rolled_back(verdict, certain, bad or list(tried)), _without(certain, bad or list(tried)), notes
    fitted = {gap.regime for gap in verdict.gaps if gap.use == "fitted"}
    verdict = replace(verdict, gaps=_measured_gaps(verdict.gaps, shown))
    same = closed_alike(shown, fitted)[0] if shown.runs else None
    if same is not None:
        of = runs_text([run.use for run in alike(shown, fitted)])
        verdict = replace(verdict, sentence=with_closed(verdict.sentence, same, f"{of}, replayed in SAPIEN,"))
    if shown.given_up:
        done = len(shown.runs) + len(shown.unsure)
        notes.append(
            f"SAPIEN's replay took more than {seconds:g} s and was given up: {done} of {done + len(shown.given_up)} "
            "runs are replayed. " + ("" if done else "Gaps of the motion are the fits' own, not SAPIEN's.")
        )
        if not done:
            unsure = "SAPIEN has not confirmed it: the replay took too long."
            verdict = replace(verdict, sentence=f"{verdict.sentence} {unsure}")
    motion = helps(shown.runs) and _confirms(verdict, shown, draft.dominant) if shown.runs else None
    geometry = helps((), shown.poses) if shown.poses else None
    bad = [n for n in tried if (geometry if n.effect.kind == "kinematics" else motion) is False]
    if bad or (motion is False and verdict.corrections):
        of = runs_text([run.use for run in shown.runs] or [use_of(p) for p in shown.poses])
        notes.append(
            f"A repair with {_names(bad) or 'another body'} was tried and rolled back: replayed in SAPIEN it did not "
            f"help on {of}, or made some of their motion worse."
        )
        return _rolled_back(verdict, certain, bad), _without(certain, bad), notes
    rest = [n for n in tried if n not in certain]
    if rest:
        notes.append(
            f"The asset was not given {_names(rest)}: that is not certain. Curves and gaps after show what it would do."
        )
    if shown.unsure:
        notes.append(
            f"Not judged by its replay: {', '.join(shown.unsure)}. Such a run hangs on a hair, and the fineness of "
            "SAPIEN's time steps changes its course: its gaps are the fits' own."
        )
    if np.isfinite(shown.numerics) and shown.numerics > 0.25:
        notes.append(
            f"Halving SAPIEN's time step down to {1e3 * shown.timestep_s:g} ms still changed a run by "
            f"{shown.numerics:.2g} floors: gaps are no surer than that."
        )
    return verdict, certain, notes


def _confirms(verdict: Verdict, shown: Shown, most: float) -> bool:
    """Whether confirming runs, as far as they were replayed, keep at most this part of their gap."""
    replayed = {run.run for run in shown.runs}
    kept = [gap for gap in verdict.gaps if gap.use == "confirming" and gap.run in replayed]
    return not kept or halved(kept, most)


def _names(effects: Sequence[Named]) -> str:
    return ", ".join(named.effect.name for named in effects)


def _without(certain: tuple[Named, ...], bad: Sequence[Named]) -> tuple[Named, ...]:
    return tuple(named for named in certain if named not in bad)


def _as_fitted(
    runs: Measured, placed: Placed, acting: tuple[Effect, ...], off: Off, limits: tuple[float, float]
) -> tuple[Measured, JointMechanics, float, float, tuple[Effect, ...], tuple[Run, ...]]:
    """What `missing_force` takes, held-out runs too: by as much as the asset is known to be off there is no gap."""
    if off == Off():
        return runs, placed.mechanics, *limits, acting, runs.runs
    cosine, sine, constant = off.gravity
    if placed.mechanics.joint.type == "revolute":
        other = GravityOffset(cosine=cosine, sine=sine)
    else:
        other = GravityOffset(constant=constant)
    exact = replace(runs, inertia_relative=0.0, gravity_relative=0.0)
    mechanics = replace(placed.mechanics, inertia=placed.mechanics.inertia * off.inertia)
    return exact, mechanics, *limits, (*acting, other), runs.runs


def _limits(asset: Asset) -> tuple[float, float]:
    from freeart21.files.asset import movable_joint

    joint = movable_joint(asset.urdf, asset.joint)
    return joint.lower, joint.upper


def _picked(runs: list[Run], draft: Draft) -> list[Run]:
    """Runs to replay, of those with a start that tell what the answer is worth: the regimes in turn."""
    tell = {gap.run for gap in told_by(draft.verdict.gaps)}
    by_regime: dict[str, list[Run]] = {}
    for run in runs:
        if run.name in tell:
            by_regime.setdefault(draft.regimes.get(run.name, ""), []).append(run)
    turns = [group[k] for k in range(len(runs)) for group in by_regime.values() if k < len(group)]
    return turns[:MOST_REPLAYS]


def _tracks(
    measured: Measured, geometry: KinematicsFinding, placed: Placed, state_zero: float
) -> tuple[PosesReplayed, ...]:
    if not geometry.effects:
        return ()
    of = {run.name: run for run in measured.runs}
    T_canonical_parent = se3.inverse(placed.T_parent_canonical)
    middle = middle_of(placed.mechanics)
    at_zero = placed.mechanics.joint.transform(state_zero)
    tracks = sorted(geometry.tracks, key=lambda t: not t.held_out)
    found = []
    for track in [t for t in tracks if t.held_out] or tracks[:3]:
        motions = placed.track(of[track.name]).motions
        kept = np.unique(np.linspace(0, len(motions) - 1, min(_MOST_POSES, len(motions))).astype(int))
        poses = [placed.poses(motions[kept] @ se3.exp_se3(-b)) for b in geometry.registrations]
        states: tuple[Array, Array] = (track.q_before[kept] - state_zero, track.q[kept] - state_zero)
        found.append(
            PosesReplayed(
                track.name,
                (poses[0], poses[1]),
                states,
                track.times_s[kept] + track.time_shift_s,
                se3.transform(T_canonical_parent @ at_zero, middle[None])[0],
                lever_of(placed.mechanics, middle),
                track.floor,
                track.held_out,
            )
        )
    return tuple(found)


def _measured_gaps(gaps: tuple[RunGap, ...], shown: Shown) -> tuple[RunGap, ...]:
    """Gaps with those that SAPIEN measured in their places, and those of the geometry."""
    replayed = {run.run: run for run in shown.runs}
    out = [
        replace(
            gap,
            before=replayed[gap.run].gap_before,
            after=replayed[gap.run].gap_after,
        )
        if gap.run in replayed
        else gap
        for gap in gaps
    ]
    out += [RunGap(p.run, p.before, p.after, p.floor, p.held_out, GEOMETRY, use_of(p)) for p in shown.poses]
    return tuple(out)


def _rolled_back(verdict: Verdict, certain: tuple[Named, ...], bad: Sequence[Named]) -> Verdict:
    """Unexplained but for what helped; the gaps of what did not are as before."""
    kept = _without(certain, bad)
    bent = any(named.effect.kind == "kinematics" for named in bad)
    moved = any(named.effect.kind != "kinematics" for named in bad) or not bent
    gaps = tuple(
        replace(gap, after=gap.before) if (bent if gap.regime == GEOMETRY else moved) else gap for gap in verdict.gaps
    )
    what = "the best repair of it did not help, or made some motion worse"
    if kept:
        words = ", ".join(plain(named.effect.name) for named in kept)
        sentence = f"This is mended: {words}. What else simulation and measurement differ by is not known: {what}."
    else:
        sentence = f"Simulation and measurement differ, and nothing known here mends it: {what}."
    corrections = () if moved else verdict.corrections
    return replace(
        verdict,
        verdict="unexplained",
        effects=kept,
        rivals=(),
        gaps=gaps,
        sentence=sentence,
        in_part=False,
        corrections=corrections,
    )
