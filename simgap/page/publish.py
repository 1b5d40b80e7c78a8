"""Publication: the repaired asset, confirmed in SAPIEN or rolled back, the verdict and the page."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects import Effect, gravity_change
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.asset import has_guessed_dynamics
from freeart21.files.atomic import new_folder
from freeart21.files.lock import only_writer
from freeart21.files.measured import read_measured, run_hashes, write_measured
from freeart21.files.places import ANSWER, check_place
from freeart21.joint import JointType
from freeart21.measured import Measured, Run
from freeart21.mechanics import JointMechanics
from simgap.geometry.finding import KinematicsFinding
from simgap.geometry.placing import place
from simgap.geometry.track_geometry import TrackGeometry, gyration_radius, part_centre
from simgap.models.equation_error import estimate_missing_force
from simgap.models.localise import flagged_regions, make_residual_maps
from simgap.models.surrogate import Nuisance, Plant, make_plant
from simgap.page.report import Draft, Gap, page
from simgap.prove.body import NO_CORRECTION, BodyCorrection, corrected_gravity
from simgap.prove.comparison import ReplayComparison, closed_part, compare_replays, is_improved
from simgap.prove.replay import SECONDS, CannotReplay, Progress, Replay, asset_address, replay
from simgap.prove.replay_process import AssetOnDisk, PosesToReplay, Starts
from simgap.prove.writeback import write_repaired
from simgap.select.experiment import DISCREPANCY_EXPERIMENTS
from simgap.select.words import effect_label, replace_amounts, replace_closed_part, runs_text
from simgap.verdict import (
    GEOMETRY,
    NamedEffect,
    Proof,
    RunGap,
    Verdict,
    closes_gap,
    deciding_runs,
    root_mean_square,
    unit_of,
)

MOST_REPLAYS = 6
"""Runs that SAPIEN replays, from every regime some."""
_MOST_POSES = 150


def replace_poses(measured: Measured, geometry: KinematicsFinding | None) -> Measured:
    """The set with part poses replaced by positions along the joint, the named geometry removed."""
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


@dataclass(frozen=True)
class Paths:
    """Paths as given to the command, for the command lines that repeat the proof."""

    asset: Path
    measured: Path
    out: Path
    root: Path | None = None
    runs: dict[str, str] = field(default_factory=dict)
    """Run name to the SHA-256 of its file in `measured`."""


@contextmanager
def answer_folder(out: Path, inputs: Sequence[Path]) -> Iterator[Path]:
    """A new folder that replaces `out` at the end, as a whole. Raises FreeArtError where `out` holds anything but an
    older answer, or is an input."""
    check_place(out, ANSWER, inputs)
    with only_writer(out), new_folder(out, ANSWER) as aside:
        yield aside


def write_answer(folder: Path, verdict: Verdict, kind: JointType, html: str) -> None:
    """Write the page, then verdict.json, which lists the other files."""
    atomic.write_bytes(folder / "index.html", html.encode())
    verdict.write(folder / "verdict.json", kind)


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
    paths: Paths | None = None,
) -> Verdict:
    """Write asset/, verdict.json and index.html into `folder`; returns the verdict after the replay in SAPIEN.

    Only certain effects are written into asset/. Those that do not improve runs that were not fitted are rolled back,
    motion and geometry separately, and the verdict becomes unexplained. A trial repair that is not in asset/ is in
    trial/, for example the best of several rivals. Positions from part poses are in runs/. Every gap in position is a
    replay of these files.

    Args:
        asset: as given.
        measured: all runs, poses included.
        draft: result of the fits.
        folder: must exist.
        title: of the page.
        seconds: duration of the analysis, for the page.
        seed: of permutation tests.
        replay_seconds: limit of the replay; the verdict then says so.
        progress: called with the number of replays done.
        paths: those of the command; None for the actual ones.
    """
    runs, posed = replace_poses(measured, draft.geometry), any(run.poses is not None for run in measured.runs)
    if posed:
        write_measured(folder / "runs", runs)
        runs = read_measured(folder / "runs")
    plant, verdict, kind = make_plant(asset, measured), draft.verdict, measured.joint_type
    found = estimate_missing_force(*_missing_force_inputs(runs, plant, draft.nuisance), plant=plant)
    maps = make_residual_maps(found, seed)
    tried = verdict.effects if verdict.verdict in ("named", "ambiguous") else draft.certain
    changed = bool(tried) or draft.body != NO_CORRECTION
    _write_asset(asset, tried, draft.body, verdict, folder / "asset")
    given, repaired = AssetOnDisk(asset_address(asset), asset.root, guesses=False), AssetOnDisk(folder / "asset")
    end, files = time.monotonic() + replay_seconds, (given, repaired) if changed else (given,)
    tracks = _place_tracks(asset, measured, draft.geometry, tried)
    replays, comparison, why = _replay_trial(files, runs, draft, tracks, replay_seconds, progress)
    rejected, notes = _judge(draft, tried, changed, comparison, why, replay_seconds)
    where = flagged_regions(maps, found, kind) if draft.motion_differs and not verdict.where else verdict.where
    verdict = replace(verdict, where=where, sentence=_replayed_sentence(verdict, comparison, kind))
    delivered = draft.certain
    if rejected is not None:
        verdict = _make_rolled_back(verdict, draft.certain, rejected)
        delivered = verdict.effects
    body = draft.body if verdict.corrections else NO_CORRECTION
    if (delivered, body) != (tried, draft.body):
        (folder / "asset").rename(folder / "trial")
        _write_asset(asset, delivered, body, verdict, folder / "asset")
    gaps, proof = (*verdict.gaps, *(() if comparison is None else comparison.poses)), None
    if verdict.by == "position":
        gaps = _gaps_of_files(gaps, comparison, tried, delivered, body == draft.body)
    if replays:
        same = not _select_moving(delivered) and body == NO_CORRECTION
        assets = (given,) if same else (given, repaired)
        witness = _ask_witness(assets, runs, replays, verdict.holding or 0.0, end - time.monotonic())
        proof = _make_proof(paths, asset, posed, folder, verdict.holding, replays[0], witness)
    verdict = replace(verdict, added=tuple(n.effect.name for n in delivered), gaps=gaps, proof=proof)
    gap = Gap(title, measured, verdict, draft, maps, comparison, tuple(notes), seconds)
    write_answer(folder, verdict, kind, page(gap))
    return verdict


def _write_asset(
    asset: Asset, effects: tuple[NamedEffect, ...], body: BodyCorrection, verdict: Verdict, folder: Path
) -> None:
    """Write the asset with these effects and this body, with the source in asset.json."""
    source: dict[str, Any] = {"verdict": verdict.verdict, "effects": [n.effect.name for n in effects]}
    source |= {"corrections": [vars(c) for c in verdict.corrections]} if verdict.corrections else {}
    changed = bool(effects) or body != NO_CORRECTION
    write_repaired(asset, tuple(n.effect for n in effects), folder, source if changed else None, body)


def _select_moving(effects: Sequence[NamedEffect]) -> list[NamedEffect]:
    """Effects that change the joint's motion or its readings."""
    return [named for named in effects if named.effect.kind != "kinematics"]


Tracks = tuple[tuple[TrackGeometry, ...], tuple[PosesToReplay, ...], tuple[PosesToReplay, ...]]
"""Runs of poses, and what is replayed of them with the asset as given and as repaired."""


def _replay_trial(
    files: Sequence[AssetOnDisk],
    runs: Measured,
    draft: Draft,
    poses: Tracks,
    seconds: float,
    progress: Progress | None,
) -> tuple[tuple[Replay, ...], ReplayComparison | None, str]:
    """Replays with the asset as given and as repaired, their comparison, and why there is none (empty for nothing to
    replay)."""
    verdict, (tracks, *posed) = draft.verdict, poses
    chosen = _pick_runs(runs, verdict) if verdict.by == "position" else []
    if not chosen and not tracks:
        return (), None, ""
    holding, both = verdict.holding or 0.0, (posed[0], posed[1])
    try:
        replays = replay(files, runs, chosen, holding=holding, poses=both, seconds=seconds, progress=progress)
    except CannotReplay as error:
        return (), None, str(error)
    return replays, compare_replays(replays[0], replays[-1], draft.floor, verdict.gaps, tracks), ""


def _ask_witness(
    assets: Sequence[AssetOnDisk], runs: Measured, replays: tuple[Replay, ...], holding: float, seconds: float
) -> dict[str, Any]:
    """MuJoCo's gaps of the same runs, from the same start states, with the files as given and as delivered."""
    answer: dict[str, Any] = {"engine": "mujoco"}
    names = [run.run for run in replays[0].runs]
    starts = [Starts({r.run: r.start for r in one.runs}, {r.run: r.noise for r in one.runs}) for one in replays]
    if not names:
        return {**answer, "absent": "no run was replayed in time"}
    starts, seconds = starts[: len(assets)], max(seconds, 1.0)
    try:
        found = replay(assets, runs, names, starts=starts, engine="mujoco", holding=holding, seconds=seconds)
    except FreeArtError as error:
        return {**answer, "absent": str(error)}
    pairs = zip(found[0].runs, found[-1].runs, strict=True)
    gaps = [{"run": was.run, "before": was.error, "after": is_now.error} for was, is_now in pairs]
    return {**answer, "version": found[0].version, "gap": gaps}


def _make_proof(
    paths: Paths | None,
    asset: Asset,
    posed: bool,
    folder: Path,
    holding: float | None,
    made_by: Replay,
    witness: dict[str, Any],
) -> Proof:
    """The engine of the replay, and the command lines that repeat it."""
    paths = paths or Paths(asset_address(asset), Path("MEASURED"), folder, asset.root)
    measured_path = paths.out / "runs" if posed else paths.measured
    how = [] if holding is None else ["--holding", repr(holding)]
    bounds = [] if paths.root is None else ["--root", str(paths.root)]
    bounds += ["--without-guesses"] if has_guessed_dynamics(asset) else []

    def command(path: Path, *more: str) -> str:
        return shlex.join(["freeart21", "replay", str(path), str(measured_path), *how, *more])

    repeat = {"before": command(paths.asset, *bounds), "after": command(paths.out / "asset")}
    if (folder / "trial").is_dir():
        repeat["trial"] = command(paths.out / "trial")
    hashes = run_hashes(folder / "runs") if posed else paths.runs
    return Proof(made_by.engine, made_by.version, repeat, witness, hashes)


def _replayed_sentence(verdict: Verdict, comparison: ReplayComparison | None, kind: JointType) -> str:
    """The sentence with the numbers of the replay in SAPIEN."""
    if comparison is None:
        return verdict.sentence
    if not comparison.runs:
        late = comparison.changed and comparison.given_up and not comparison.inconclusive
        return verdict.sentence + " SAPIEN has not confirmed it: the replay took too long." * bool(late)
    was, left, floor = (
        root_mean_square([getattr(r, name) for r in comparison.runs]) for name in ("before", "after", "floor")
    )
    sentence = replace_amounts(verdict.sentence, was, left, floor, unit_of("position", kind))
    near, _ = comparison.split({gap.regime for gap in verdict.gaps if gap.use == "fitted"})
    part, of = closed_part(near), f"{runs_text([run.use for run in near])}, replayed in SAPIEN,"
    return sentence if part is None else replace_closed_part(sentence, part, of)


def _judge(
    draft: Draft,
    tried: tuple[NamedEffect, ...],
    changed: bool,
    comparison: ReplayComparison | None,
    why: str,
    seconds: float,
) -> tuple[list[NamedEffect] | None, list[str]]:
    """What to roll back of a repair (no effects: the body; None: nothing), and notes.

    `changed` is whether there is a repair, `why` the reason that it could not be replayed.
    """
    if why:
        rejected = _select_moving(tried) or list(tried)
        what = (_names(rejected) or "the corrected asset") if changed else "the asset"
        return rejected if changed else None, [f"SAPIEN could not replay {what}: {why}"]
    if comparison is None or not changed:
        return None, []
    notes = []
    if comparison.given_up:
        done = len(comparison.runs) + len(comparison.inconclusive)
        notes.append(
            f"SAPIEN's replay took more than {seconds:g} s and was given up: {done} of "
            f"{done + len(comparison.given_up)} runs are replayed."
        )
    replayed = {run.run: run for run in comparison.runs}
    confirming = [
        replace(gap, before=replayed[gap.run].before, after=replayed[gap.run].after)
        for gap in draft.verdict.gaps
        if gap.use == "confirming" and gap.run in replayed
    ]
    confirmed = not confirming or closes_gap(confirming, draft.dominant)
    motion = is_improved(comparison.runs) and confirmed if comparison.runs else None
    geometry = is_improved(comparison.poses) if comparison.poses else None
    rejected = [n for n in tried if (geometry if n.effect.kind == "kinematics" else motion) is False]
    if rejected or (motion is False and draft.verdict.corrections):
        of = runs_text([run.use for run in comparison.runs or comparison.poses])
        notes.append(
            f"A repair with {_names(rejected) or 'another body'} was tried and rolled back: replayed in SAPIEN it did "
            f"not help on {of}, or made some of their motion worse."
        )
        return rejected, notes
    rest = [n for n in tried if n not in draft.certain]
    if rest:
        notes.append(
            f"The asset was not given {_names(rest)}: that is not certain. It is in trial/, and curves show what it "
            "would do."
        )
    if comparison.inconclusive:
        notes.append(
            f"Not judged by its replay: {', '.join(run.run for run in comparison.inconclusive)}. Such a run is "
            "ill-conditioned: SAPIEN's time step changes it, however small."
        )
    return None, notes


def _names(effects: Sequence[NamedEffect]) -> str:
    return ", ".join(named.effect.name for named in effects)


def _missing_force_inputs(
    runs: Measured, plant: Plant, nuisance: Nuisance
) -> tuple[Measured, JointMechanics, float, float, tuple[Effect, ...], tuple[Run, ...]]:
    """Arguments of `estimate_missing_force` for all runs, with the fitted errors of the asset corrected."""
    limits, more = (plant.lower, plant.upper), corrected_gravity(plant, nuisance) - plant.gravity_terms[0]
    if nuisance.inertia == 1.0 and not more.any():
        return runs, plant.mechanics, *limits, plant.effects, runs.runs
    exact = replace(runs, inertia_relative=0.0, gravity_relative=0.0)
    mechanics = replace(plant.mechanics, inertia=plant.mechanics.inertia * nuisance.inertia)
    return exact, mechanics, *limits, (*plant.effects, gravity_change(*map(float, more))), runs.runs


def _pick_runs(runs: Measured, verdict: Verdict) -> list[str]:
    """Runs to replay: deciding ones with a start state, from the regimes in turn."""
    tell = {gap.run: gap for gap in deciding_runs(verdict.gaps)}
    unfitted = {gap.run for gap in verdict.gaps if gap.use != "fitted"}
    wanted = tell.keys() & unfitted or tell.keys()
    by_regime: dict[str, list[str]] = {}
    for run in runs.runs:
        if run.name in wanted and np.isfinite(run.q).any():
            by_regime.setdefault(tell[run.name].regime, []).append(run.name)
    turns = [group[k] for k in range(len(runs.runs)) for group in by_regime.values() if k < len(group)]
    return turns[:MOST_REPLAYS]


def _place_tracks(
    asset: Asset, measured: Measured, geometry: KinematicsFinding | None, tried: tuple[NamedEffect, ...]
) -> Tracks:
    """Runs of poses to replay: held-out ones, else three, where any geometry is tried."""
    if geometry is None or not geometry.effects or len(_select_moving(tried)) == len(tried):
        return (), (), ()
    of, placed = {run.name: run for run in measured.runs}, place(asset, measured.gravity)
    at_zero = se3.inverse(placed.T_parent_canonical) @ placed.mechanics.joint.transform(asset.state_zero)
    middle = part_centre(placed.mechanics)
    point, lever = se3.transform(at_zero, middle[None])[0], gyration_radius(placed.mechanics, middle)
    chosen = tuple(t for t in geometry.tracks if t.held_out) or geometry.tracks[:3]
    found: tuple[list[PosesToReplay], ...] = [], []
    for track in chosen:
        motions = placed.track(of[track.name]).motions
        sampled = np.unique(np.linspace(0, len(motions) - 1, min(_MOST_POSES, len(motions))).astype(int))
        times = track.times_s[sampled] + track.time_shift_s
        for some, registration, q in zip(found, geometry.registrations, (track.q_before, track.q), strict=True):
            poses = placed.poses(motions[sampled] @ se3.exp_se3(-registration))
            some.append(PosesToReplay(poses, q[sampled] - asset.state_zero, times, point, lever))
    return chosen, tuple(found[0]), tuple(found[1])


def _gaps_of_files(
    gaps: tuple[RunGap, ...],
    comparison: ReplayComparison | None,
    tried: tuple[NamedEffect, ...],
    delivered: tuple[NamedEffect, ...],
    same_body: bool,
) -> tuple[RunGap, ...]:
    """Gaps of the delivered files, as SAPIEN measured them: as tried where motion or geometry was delivered, else as
    before; NaN without a replay."""
    same_geometry = all(n in delivered for n in tried if n.effect.kind == "kinematics")
    same_motion = same_body and all(n in delivered for n in _select_moving(tried))
    done = {} if comparison is None else {run.run: run for run in (*comparison.runs, *comparison.inconclusive)}
    found = []
    for gap in gaps:
        off = gap.regime == GEOMETRY
        size = gap if off else done.get(gap.run)
        before, after = (np.nan, np.nan) if size is None else (size.before, size.after)
        if same_geometry if off else same_motion or size is None:
            found.append(replace(gap, before=before, after=after))
        else:
            found.append(replace(gap, before=before, after=before, trial=after))
    return tuple(found)


def _make_rolled_back(verdict: Verdict, certain: tuple[NamedEffect, ...], rejected: Sequence[NamedEffect]) -> Verdict:
    """Unexplained, except effects that are certain and helped."""
    delivered_effects = tuple(named for named in certain if named not in rejected)
    same_motion = bool(_select_moving(rejected)) or not rejected
    what = "the best repair of it did not help, or made some motion worse"
    if delivered_effects:
        words = ", ".join(effect_label(named.effect.name) for named in delivered_effects)
        sentence = f"This is repaired: {words}. What else simulation and measurement differ by is not known: {what}."
    else:
        sentence = f"Simulation and measurement differ, and nothing known here repairs it: {what}."
    return replace(
        verdict,
        verdict="unexplained",
        effects=delivered_effects,
        rivals=(),
        in_part=False,
        corrections=() if same_motion else verdict.corrections,
        sentence=sentence,
        next_experiment=verdict.next_experiment or DISCREPANCY_EXPERIMENTS[""],
    )
