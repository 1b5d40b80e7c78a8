"""From an explanation to what stands on disk: the repaired asset, shown in SAPIEN or rolled back, verdict and page."""

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
from freeart21.files.asset import guesses_dynamics
from freeart21.files.atomic import new_folder
from freeart21.files.lock import only_writer
from freeart21.files.measured import read_measured, run_hashes
from freeart21.files.measured_writer import write_measured
from freeart21.files.places import ANSWER, check_place
from freeart21.joint import JointType
from freeart21.measured import Measured, Run
from freeart21.mechanics import JointMechanics
from simgap.geometry.finding import KinematicsFinding
from simgap.geometry.placing import Placed, place
from simgap.geometry.track_geometry import lever_of, middle_of
from simgap.models.equation_error import missing_force
from simgap.models.localise import residual_maps, where
from simgap.models.surrogate import Nuisance, Plant, plant_of
from simgap.page.report import GEOMETRY, Gap, Ranked, page, use_of
from simgap.prove.body import NO_CORRECTION, BodyCorrection
from simgap.prove.replay import (
    SECONDS,
    AssetOnDisk,
    CannotReplay,
    PosesToReplay,
    Progress,
    Replay,
    Starts,
    address_of,
    replay,
    replay_from,
)
from simgap.prove.show import Chosen, ChosenPoses, ReplayGap, Shown, alike, closed_alike, helps, show
from simgap.prove.writeback import repaired
from simgap.select.experiment import UNNAMED
from simgap.select.words import plain, runs_text, with_closed, with_replayed
from simgap.settings import JudgementSettings
from simgap.verdict import Named, Proof, RunGap, Use, Verdict, halved, root_mean_square, told_by, unit_of

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
    """Of runs whose motion was prescribed, the force by inverse dynamics: by the asset as it is and by the best that
    was found."""
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


@dataclass(frozen=True)
class Paths:
    """Where things are, as they were given: for the command lines that repeat the proof."""

    asset: Path
    measured: Path
    out: Path
    root: Path | None = None
    runs: dict[str, str] = field(default_factory=dict)
    """Run name to the SHA-256 of its file in `measured`."""


@contextmanager
def answer_folder(out: Path, inputs: Sequence[Path]) -> Iterator[Path]:
    """A new folder that takes the place of `out` at the end, whole or not at all. Raises FreeArtError where `out` holds
    anything but an older answer, or is one of the inputs."""
    check_place(out, ANSWER, inputs)
    with only_writer(out), new_folder(out, ANSWER) as aside:
        yield aside


def write_answer(folder: Path, verdict: Verdict, kind: JointType, html: str) -> None:
    """The page and verdict.json, which names the files that lie beside it."""
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
    """Write asset/, verdict.json and index.html into `folder`; the verdict as it stands after the replay in SAPIEN.

    Only effects that are certain are written into asset/. Those that do not help on runs that were not fitted are
    rolled back, motion and geometry each by itself, and the verdict is then unexplained. A trial repair that is not in
    asset/ is in trial/, as of several rivals the best. Positions that part poses were made into are in runs/.
    Every gap of positions is a replay of these files.

    Args:
        asset: as it was.
        measured: all runs, poses too.
        draft: what the fits came to.
        folder: must exist.
        title: of the page.
        seconds: what the verdict took, for the page.
        seed: of permutations.
        replay_seconds: when these are over the replay is given up; the answer stays, and says so.
        progress: told how many replays are done.
        paths: those of the command; as they are here when not given.
    """
    placed = place(asset, measured.gravity)
    runs = with_positions(measured, draft.geometry)
    posed = any(run.poses is not None for run in measured.runs)
    if posed:
        write_measured(folder / "runs", runs)
        runs = read_measured(folder / "runs")
    acting = asset.effects.get(asset.joint, ())
    known = _as_fitted(runs, placed, acting, draft.off, _limits(asset))
    found = missing_force(*known, plant=plant_of(asset, measured))
    maps = residual_maps(found, seed)
    verdict = draft.verdict
    if draft.moves_otherwise and not verdict.where:
        verdict = replace(verdict, where=where(maps, found, measured.joint_type))
    tried = verdict.effects if verdict.verdict in ("named", "ambiguous") else draft.certain
    changed = bool(tried) or draft.body != NO_CORRECTION
    _write_asset(asset, tried, draft.body, verdict, folder / "asset")
    given = AssetOnDisk(address_of(asset), asset.root, guesses=False)
    trial = Trial(asset, measured, runs, draft, placed, tried)
    began = time.monotonic()
    replays, shown, why = trial.replayed((given, AssetOnDisk(folder / "asset")), changed, replay_seconds, progress)
    kept, notes = draft.certain, [] if changed or not why else [f"SAPIEN could not replay the asset: {why}"]
    if shown is not None:
        verdict = replace(verdict, gaps=_measured_gaps(verdict.gaps, shown))
    if shown is not None and shown.runs:
        sizes = ("gap_before", "gap_after", "floor")
        was, is_now, floor = (root_mean_square([getattr(run, k) for run in shown.runs]) for k in sizes)
        said = with_replayed(verdict.sentence, was, is_now, floor, unit_of("position", measured.joint_type))
        verdict = replace(verdict, sentence=said)
    if changed:
        verdict, kept, notes = _judged(verdict, draft, tried, shown, why, replay_seconds)
    body = draft.body if verdict.corrections else NO_CORRECTION
    if (kept, body) != (tried, draft.body):
        (folder / "asset").rename(folder / "trial")
        _write_asset(asset, kept, body, verdict, folder / "asset")
    verdict = replace(verdict, added=tuple(n.effect.name for n in kept))
    if verdict.by == "position":
        verdict = replace(verdict, gaps=_gaps_of_files(verdict.gaps, shown, tried, kept, body == draft.body))
    if replays:
        delivered = AssetOnDisk(folder / "asset")
        left = replay_seconds - (time.monotonic() - began)
        same = not _select_moving(kept) and body == NO_CORRECTION
        witness = _ask_witness((given,) if same else (given, delivered), runs, replays, verdict.holding or 0.0, left)
        verdict = replace(
            verdict, proof=_make_proof(paths, asset, measured, folder, verdict.holding, replays[0], witness)
        )
    gap = Gap(
        *(title, measured.joint, measured.joint_type, verdict, draft.ranking, maps, shown, draft.geometry),
        *(tuple(notes), seconds, draft.curves),
    )
    write_answer(folder, verdict, measured.joint_type, page(gap))
    return verdict


def _write_asset(
    asset: Asset, effects: tuple[Named, ...], body: BodyCorrection, verdict: Verdict, folder: Path
) -> None:
    """The asset with these effects and this body, which says what became of it."""
    source: dict[str, Any] = {"verdict": verdict.verdict, "effects": [n.effect.name for n in effects]}
    source |= {"corrections": [vars(c) for c in verdict.corrections]} if verdict.corrections else {}
    changed = bool(effects) or body != NO_CORRECTION
    repaired(asset, tuple(n.effect for n in effects), folder, source if changed else None, body)


def _select_moving(effects: Sequence[Named]) -> list[Named]:
    """Those that change how the joint moves, or what is read of it."""
    return [named for named in effects if named.effect.kind != "kinematics"]


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

    def replayed(
        self, files: tuple[AssetOnDisk, AssetOnDisk], changed: bool, seconds: float, progress: Progress | None
    ) -> tuple[tuple[Replay, ...], Shown | None, str]:
        """The replays by the asset as it was and, where it was changed, by the other one, and what they show; or why
        there are none, which is empty for nothing to replay."""
        draft = self.draft
        able = [run for run in self.runs.runs if np.isfinite(run.q).any()] if draft.verdict.by == "position" else []
        chosen = [self._chosen(run) for run in _picked(able, draft)]
        tracks: list[tuple[ChosenPoses, PosesToReplay, PosesToReplay]] = []
        if draft.geometry is not None and any(n.effect.kind == "kinematics" for n in self.tried):
            tracks = _tracks(self.measured, draft.geometry, self.placed, self.asset.state_zero)
        if not chosen and not tracks:
            return (), None, ""
        try:
            replays = replay(
                files if changed else files[:1],
                self.runs,
                [run.name for run in chosen],
                holding=draft.verdict.holding or 0.0,
                poses=([was for _, was, _ in tracks], [is_now for *_, is_now in tracks]),
                seconds=seconds,
                progress=progress,
            )
        except CannotReplay as error:
            return (), None, str(error)
        return replays, show(replays[0], replays[-1], chosen, [run for run, *_ in tracks]), ""

    def _chosen(self, run: Run) -> Chosen:
        draft = self.draft
        return Chosen(run.name, draft.floor, draft.regimes.get(run.name, ""), draft.uses.get(run.name, "fitted"))


def _ask_witness(
    assets: tuple[AssetOnDisk, ...], runs: Measured, replays: tuple[Replay, ...], holding: float, seconds: float
) -> dict[str, Any]:
    """What MuJoCo says of the same runs, from the same states, by the files as they were given and as delivered."""
    said: dict[str, Any] = {"engine": "mujoco"}
    names = [run.run for run in replays[0].runs]
    starts = [
        Starts({run.run: run.start for run in one.runs}, {run.run: run.noise for run in one.runs}) for one in replays
    ]
    if not names:
        return {**said, "absent": "no run was replayed in time"}
    try:
        found = replay_from(
            assets, runs, starts[: len(assets)], names, engine="mujoco", holding=holding, seconds=max(seconds, 1.0)
        )
    except FreeArtError as error:
        return {**said, "absent": str(error)}
    pairs = zip(found[0].runs, found[-1].runs, strict=True)
    return {
        **said,
        "version": found[0].version,
        "gap": [{"run": was.run, "before": was.error, "after": is_now.error} for was, is_now in pairs],
    }


def _make_proof(
    paths: Paths | None,
    asset: Asset,
    measured: Measured,
    folder: Path,
    holding: float | None,
    made_by: Replay,
    witness: dict[str, Any],
) -> Proof:
    """What replayed, and the command lines that do it again."""
    paths = paths or Paths(address_of(asset), Path("MEASURED"), folder, asset.root)
    posed = any(run.poses is not None for run in measured.runs)
    set_ = paths.out / "runs" if posed else paths.measured
    how = [] if holding is None else ["--holding", repr(holding)]
    bounds = [] if paths.root is None else ["--root", str(paths.root)]
    bounds += ["--without-guesses"] if guesses_dynamics(asset) else []

    def command(path: Path, *more: str) -> str:
        return shlex.join(["freeart21", "replay", str(path), str(set_), *how, *more])

    repeat = {"before": command(paths.asset, *bounds), "after": command(paths.out / "asset")}
    if (folder / "trial").is_dir():
        repeat["trial"] = command(paths.out / "trial")
    hashes = run_hashes(folder / "runs") if posed else paths.runs
    return Proof(made_by.engine, made_by.version, repeat, witness, hashes)


def _judged(
    verdict: Verdict, draft: Draft, tried: tuple[Named, ...], shown: Shown | None, why: str, seconds: float
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
    same = closed_alike(shown, fitted)[0] if shown.runs else None
    if same is not None:
        of = runs_text([run.use for run in alike(shown, fitted)])
        verdict = replace(verdict, sentence=with_closed(verdict.sentence, same, f"{of}, replayed in SAPIEN,"))
    if shown.given_up:
        done = len(shown.runs) + len(shown.unsure)
        notes.append(
            f"SAPIEN's replay took more than {seconds:g} s and was given up: {done} of {done + len(shown.given_up)} "
            "runs are replayed."
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
            f"The asset was not given {_names(rest)}: that is not certain. It is in trial/, and curves show what it "
            "would do."
        )
    if shown.unsure:
        notes.append(
            f"Not judged by its replay: {', '.join(run.run for run in shown.unsure)}. Such a run hangs on a hair, and "
            "the fineness of SAPIEN's time steps changes its course."
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
    exact = replace(runs, inertia_relative=0.0, gravity_relative=0.0)
    mechanics = replace(placed.mechanics, inertia=placed.mechanics.inertia * off.inertia)
    return exact, mechanics, *limits, (*acting, gravity_change(*off.gravity)), runs.runs


def _limits(asset: Asset) -> tuple[float, float]:
    from freeart21.files.asset import movable_joint

    joint = movable_joint(asset.urdf, asset.joint)
    return joint.lower, joint.upper


def _picked(runs: list[Run], draft: Draft) -> list[Run]:
    """Runs to replay, of those with a start that tell what the answer is worth: the regimes in turn."""
    gaps = draft.verdict.gaps
    tell = {gap.run for gap in told_by(gaps)}
    unfitted = {gap.run for gap in gaps if gap.use != "fitted"}
    by_regime: dict[str, list[Run]] = {}
    for run in runs:
        if run.name in (tell & unfitted or tell):
            by_regime.setdefault(draft.regimes.get(run.name, ""), []).append(run)
    turns = [group[k] for k in range(len(runs)) for group in by_regime.values() if k < len(group)]
    return turns[:MOST_REPLAYS]


def _tracks(
    measured: Measured, geometry: KinematicsFinding, placed: Placed, state_zero: float
) -> list[tuple[ChosenPoses, PosesToReplay, PosesToReplay]]:
    """Runs of poses, as they are held against the asset as it was and as it is now."""
    if not geometry.effects:
        return []
    of = {run.name: run for run in measured.runs}
    T_canonical_parent = se3.inverse(placed.T_parent_canonical)
    middle = middle_of(placed.mechanics)
    at_zero = placed.mechanics.joint.transform(state_zero)
    tracks = sorted(geometry.tracks, key=lambda t: not t.held_out)
    found = []
    for track in [t for t in tracks if t.held_out] or tracks[:3]:
        motions = placed.track(of[track.name]).motions
        kept = np.unique(np.linspace(0, len(motions) - 1, min(_MOST_POSES, len(motions))).astype(int))
        was, is_now = (
            PosesToReplay(
                placed.poses(motions[kept] @ se3.exp_se3(-registration)),
                q[kept] - state_zero,
                track.times_s[kept] + track.time_shift_s,
                se3.transform(T_canonical_parent @ at_zero, middle[None])[0],
                lever_of(placed.mechanics, middle),
            )
            for registration, q in zip(geometry.registrations, (track.q_before, track.q), strict=True)
        )
        found.append((ChosenPoses(track.name, track.floor, track.held_out), was, is_now))
    return found


def _measured_gaps(gaps: tuple[RunGap, ...], shown: Shown) -> tuple[RunGap, ...]:
    """Gaps with those that SAPIEN measured in their places, and those of the geometry."""
    replayed = {run.run: run for run in (*shown.runs, *shown.unsure)}
    out = [
        replace(gap, before=replayed[gap.run].gap_before, after=replayed[gap.run].gap_after)
        if gap.run in replayed
        else gap
        for gap in gaps
    ]
    out += [RunGap(p.run, p.before, p.after, p.floor, p.held_out, GEOMETRY, use_of(p)) for p in shown.poses]
    return tuple(out)


def _gaps_of_files(
    gaps: tuple[RunGap, ...], shown: Shown | None, tried: tuple[Named, ...], kept: tuple[Named, ...], same_body: bool
) -> tuple[RunGap, ...]:
    """Gaps by the files that are delivered: of motion and of geometry what was tried where it was kept, else as before;
    NaN of what was not replayed."""
    bent = all(n in kept for n in tried if n.effect.kind == "kinematics")
    moved = same_body and all(n in kept for n in _select_moving(tried))
    done = set() if shown is None else {run.run for run in (*shown.runs, *shown.unsure)}
    found = []
    for gap in gaps:
        if gap.regime != GEOMETRY and gap.run not in done:
            found.append(replace(gap, before=np.nan, after=np.nan))
        elif bent if gap.regime == GEOMETRY else moved:
            found.append(gap)
        else:
            found.append(replace(gap, after=gap.before, trial=gap.after))
    return tuple(found)


def _rolled_back(verdict: Verdict, certain: tuple[Named, ...], bad: Sequence[Named]) -> Verdict:
    """Unexplained but for what helped."""
    kept = _without(certain, bad)
    bent = any(named.effect.kind == "kinematics" for named in bad)
    moved = any(named.effect.kind != "kinematics" for named in bad) or not bent
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
        next_experiment=verdict.next_experiment or UNNAMED[""],
        effects=kept,
        rivals=(),
        sentence=sentence,
        in_part=False,
        corrections=corrections,
    )
