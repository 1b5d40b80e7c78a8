"""From an explanation to what stands on disk: the repaired asset, shown in SAPIEN or rolled back, verdict and page."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.measured import Measured, Run
from freeart21.se3 import Array
from simgap.equation_error import missing_force
from simgap.kinematics import KinematicsFinding
from simgap.localise import residual_maps, where
from simgap.placing import Placed, place
from simgap.report import GEOMETRY, Gap, Ranked, write_report
from simgap.show import Off, PosesReplayed, Replayed, Shown, show
from simgap.surrogate import Nuisance, Plant
from simgap.track_geometry import lever_of, middle_of
from simgap.verdict import Named, RunGap, Verdict
from simgap.writeback import repaired

MOST_REPLAYS = 6
"""Runs that SAPIEN replays; of every regime some."""
_MOST_POSES = 150


@dataclass(frozen=True)
class Draft:
    """What fits and choice have come to, before SAPIEN has seen it."""

    verdict: Verdict
    """Gaps as the fits have them; those of replayed runs are measured anew."""
    starts: dict[str, tuple[tuple[float, float], tuple[float, float]]] = field(default_factory=dict)
    """Run name to its start state (rad or m, and a second) with the asset as it was, and with the effects."""
    off: tuple[Off, Off] = (Off(), Off())
    """How far the asset is off in these two fits."""
    ranking: tuple[Ranked, ...] = ()
    geometry: KinematicsFinding | None = None
    regimes: dict[str, str] = field(default_factory=dict)
    """Run name to regime."""
    floor: float = 0.0
    """rad or m."""


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
) -> Verdict:
    """Write asset/, verdict.json and index.html into `folder`; the verdict as it stands after the replay in SAPIEN.

    A repair that does not help on runs that were not fitted is rolled back: asset/ is then the asset as it was, and the
    verdict is unexplained.

    Args:
        asset: as it was.
        measured: all runs, poses too.
        draft: what the fits came to.
        folder: must exist.
        title: of the page.
        seconds: what the verdict took, for the page.
        seed: of permutations.
    """
    placed = place(asset, measured.gravity)
    runs = with_positions(measured, draft.geometry)
    acting = asset.effects.get(asset.joint, ())
    found = missing_force(runs, placed.mechanics, *_limits(asset), acting, runs.runs)  # held-out ones may point, too
    maps = residual_maps(found, seed)
    verdict = draft.verdict
    if not verdict.where:
        verdict = replace(verdict, where=where(maps, found, measured.joint_type))
    effects = tuple(named.effect for named in verdict.effects)
    shown, notes = None, []
    if effects:
        source = {"verdict": verdict.verdict, "effects": [effect.name for effect in effects]}
        mended = repaired(asset, effects, folder / "asset", source)
        shown = _shown(asset, mended, measured, runs, draft, placed)
        verdict = replace(verdict, gaps=_measured_gaps(verdict.gaps, shown))
        if not shown.helps:
            verdict, note = _rolled_back(verdict)
            notes.append(note)
            _remove(folder / "asset")
    if not (folder / "asset").exists():
        repaired(asset, (), folder / "asset")
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
        ),
    )
    return verdict


def _limits(asset: Asset) -> tuple[float, float]:
    from freeart21.files.asset import movable_joint

    joint = movable_joint(asset.urdf, asset.joint)
    return joint.lower, joint.upper


def _shown(asset: Asset, mended: Asset, measured: Measured, runs: Measured, draft: Draft, placed: Placed) -> Shown:
    picked = _picked([run for run in runs.runs if run.name in draft.starts], draft.regimes)
    replays = tuple(
        Replayed(run, *draft.starts[run.name], draft.floor, draft.regimes.get(run.name, ""), bool(run.held_out))
        for run in picked
    )
    tracks = () if draft.geometry is None else _tracks(measured, draft.geometry, placed, asset.state_zero)
    return show(asset, mended, runs, replays, draft.off, poses=tracks)


def _picked(runs: list[Run], regimes: dict[str, str]) -> list[Run]:
    """Runs to replay: held out ones, all when none is; the regimes in turn."""
    pool = [run for run in runs if run.held_out] or runs
    by_regime: dict[str, list[Run]] = {}
    for run in pool:
        by_regime.setdefault(regimes.get(run.name, ""), []).append(run)
    turns = [group[k] for k in range(len(pool)) for group in by_regime.values() if k < len(group)]
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
        replace(gap, before=replayed[gap.run].gap_before, after=replayed[gap.run].gap_after)
        if gap.run in replayed
        else gap
        for gap in gaps
    ]
    out += [RunGap(p.run, p.before, p.after, p.floor, p.held_out, GEOMETRY) for p in shown.poses]
    return tuple(out)


def _rolled_back(verdict: Verdict) -> tuple[Verdict, str]:
    tried: tuple[Named, ...] = verdict.effects
    names = ", ".join(named.effect.name for named in tried)
    note = f"A repair with {names} was tried and rolled back: replayed in SAPIEN it did not help on held-out runs."
    sentence = "Simulation and measurement differ, and nothing known here mends it: the best repair did not help."
    gaps = tuple(replace(gap, after=gap.before) for gap in verdict.gaps)
    return replace(verdict, verdict="unexplained", effects=(), rivals=(), gaps=gaps, sentence=sentence), note


def _remove(folder: Path) -> None:
    import shutil

    shutil.rmtree(folder)
