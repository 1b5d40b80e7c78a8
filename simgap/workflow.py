"""The five steps of `gap`: measure, localise, name, add, show."""

from __future__ import annotations

import hashlib
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import __version__
from freeart21.asset import Asset
from freeart21.effects.base import Effect
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured, run_hashes
from freeart21.joint import JointType
from freeart21.measured import Measured
from simgap.fit.fit import Model, ParameterMap, Problem, fit_starts, refit_starts
from simgap.fit.force_search import ForceSearch
from simgap.fit.force_search import list_candidates as force_candidates
from simgap.fit.problem import make_problem, without_asset_error
from simgap.fit.search import Search, list_candidates
from simgap.geometry.finding import KinematicsFinding, KinematicsSettings
from simgap.geometry.kinematics import find_geometry
from simgap.measure.data import FitRun, make_fit_runs, thinning_notes
from simgap.measure.noise import SensorNoise
from simgap.measure.prescribed import ForceRun, make_force_runs
from simgap.measure.stiction import find_stiction_bound
from simgap.models.surrogate import make_plant
from simgap.page.publish import Paths, answer_folder, publish, replace_poses
from simgap.page.report import Draft, Ranked
from simgap.prove.body import NO_CORRECTION
from simgap.prove.comparison import ReplayGap, compare_curves
from simgap.prove.replay import SECONDS, Progress
from simgap.prove.replay_process import check_match
from simgap.select.choose import Choice, choose_hypotheses
from simgap.select.decide import (
    DeliveredFits,
    has_enough_motion,
    has_enough_readings,
    make_verdict,
    not_excited_verdict,
)
from simgap.select.delivery import deliver
from simgap.select.hypotheses import FORM_ERROR, evaluate_set
from simgap.select.predictive import DECISIVE_LOG_ODDS, DEGREES_OF_FREEDOM, score_difference
from simgap.select.split import Split, split_runs
from simgap.select.words import amount, effect_label, effect_words
from simgap.settings import GapSettings, JudgementSettings
from simgap.verdict import GAP_THRESHOLD, NamedEffect, Verdict, root_mean_square

DEFAULTS = GapSettings()
NOT_REPLAYED = (
    "SAPIEN has not confirmed it: where the force is read that prescribed motion took, no free simulation can follow; "
    "runs kept to confirm it are judged by inverse dynamics."
)
STOPPED = (
    "The search was stopped after {:.0f} s of processor time (--seconds): this is the best that it had found; a "
    "larger --seconds may find more."
)
MOST_RANKED = 12
"""Sets of effects that the page lists."""
_ORDER = ("no_gap", "not_excited", "named", "ambiguous", "unexplained")
"""Verdicts by precedence: of two, the later one is reported."""


def find_gap(asset: Asset, measured: Measured, settings: GapSettings = DEFAULTS) -> Verdict:
    """The effects that the simulation of `asset` lacks, from measured runs. Writes nothing.

    Raises FreeArtError when the measurement is of another joint, or its units cannot be right.
    """
    return explain(asset, measured, settings).verdict


def explain(asset: Asset, measured: Measured, settings: GapSettings = DEFAULTS) -> Draft:
    """Everything but the replay in SAPIEN: fits, the choice of effects and the verdict."""
    draft = _analyse(asset, measured, settings)
    notes = (*measured.notes, *draft.verdict.notes, *(() if draft.verdict.by == "force" else thinning_notes(measured)))
    return replace(draft, verdict=replace(draft.verdict, notes=notes, judged_by=judgement_provenance(settings)))


def judgement_provenance(settings: GapSettings) -> dict[str, Any]:
    """Version, digest of this package's code, and every number that decides a verdict."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    fixed = {"form": FORM_ERROR, "freedom": DEGREES_OF_FREEDOM, "decisive": DECISIVE_LOG_ODDS, "shows": GAP_THRESHOLD}
    reported = {**asdict(settings.judgement), **fixed}
    return {"freeart21": __version__, "code": digest.hexdigest()[:12], "settings": reported}


def _analyse(asset: Asset, measured: Measured, settings: GapSettings) -> Draft:
    check_match(asset, measured, "gap")
    geometry = find_geometry(asset, measured, KinematicsSettings(without=settings.without))
    positions = replace_poses(measured, geometry)
    plant = make_plant(asset, measured)
    runs, noise = apply_tracking_noise(*make_fit_runs(positions, plant), geometry)
    moved = has_enough_motion(runs, noise, settings.judgement)
    stiction = find_stiction_bound(positions, plant, noise)
    if stiction is not None or not moved or not has_enough_readings(runs, settings.judgement):
        motion = not_excited_verdict(runs, noise, moved, measured.joint_type, stiction)
        return Draft(
            join_geometry(motion, geometry, measured.joint_type),
            geometry=geometry,
            floor=noise.sigma_at_rest,
            certain=select_certain(motion, geometry),
        )
    return judge(prepare(asset, measured, positions, runs, noise, geometry, settings), settings.judgement)


@dataclass(frozen=True)
class Prepared:
    """What the choice of effects starts from."""

    asset: Asset
    measured: Measured
    geometry: KinematicsFinding | None
    runs: tuple[FitRun, ...]
    noise: SensorNoise
    problem: Problem
    split: Split
    search: Search | ForceSearch
    notes: tuple[str, ...] = ()
    """What was left out where motion is prescribed."""


def prepare(
    asset: Asset,
    measured: Measured,
    positions: Measured,
    runs: tuple[FitRun, ...],
    noise: SensorNoise,
    geometry: KinematicsFinding | None,
    settings: GapSettings,
) -> Prepared:
    """The fitted quantity, position or the force of prescribed motion, the use of each run, and the search.

    Args:
        positions: the measurement, with positions in place of part poses.
        runs: of `positions`.
        noise: of `runs`.
        geometry: what part poses say about the joint.
    """
    plant = make_plant(asset, measured)
    problem = make_problem(plant, measured, runs, noise)
    notes: tuple[str, ...] = ()
    prescribed = make_force_runs(positions, plant)
    if prescribed is not None and has_enough_readings(prescribed[0], settings.judgement):
        runs, noise, notes = prescribed
        problem = make_force_problem(problem, prescribed[0])
    split = split_runs(runs)
    search = make_search(problem, split, measured, settings)
    return Prepared(asset, measured, geometry, runs, noise, problem, split, search, notes)


def judge(prepared: Prepared, settings: JudgementSettings) -> Draft:
    """The choice of effects, what files can express of it, and the verdict."""
    problem, split, search, runs = prepared.problem, prepared.split, prepared.search, prepared.runs
    choice = choose_hypotheses(search, split.folds, settings)
    if isinstance(search, ForceSearch):
        choice = add_confounded_sets(choice, search, split)
    best = choice.accepted[0] if choice.accepted else choice.base
    delivery = deliver(best, search.train, split.folds, prepared.asset, prepared.measured, search.names)
    as_is = Model(without_asset_error(problem), (), instant_friction=True)
    before = fit_starts(as_is, np.full(len(as_is.ranges()), delivery.holding), runs)
    delivered = DeliveredFits(delivery, before, refit_starts(delivery.fit, runs))
    motion = make_verdict(choice, split, delivered, runs, prepared.noise, problem, settings)
    if isinstance(search, Search) and search.stopped:
        motion = replace(motion, notes=(*motion.notes, STOPPED.format(search.seconds)))
    if problem.inverse_dynamics:
        motion = replace(motion, notes=(*prepared.notes, NOT_REPLAYED))
    geometry = prepared.geometry
    return Draft(
        join_geometry(motion, geometry, prepared.measured.joint_type),
        ParameterMap(choice.base.fit.model).nuisance(choice.base.fit.theta),
        rank_hypotheses(choice),
        geometry,
        prepared.noise.sigma_at_rest,
        motion.verdict != "no_gap",
        select_certain(motion, geometry),
        make_force_curves(choice, split, delivered, runs) if problem.inverse_dynamics else (),
        delivery.body if motion.corrections or motion.verdict == "ambiguous" else NO_CORRECTION,
        settings.dominant,
    )


def make_search(problem: Problem, split: Split, measured: Measured, settings: GapSettings) -> Search | ForceSearch:
    """The search over sets of effects, on positions or on the force of prescribed motion."""
    if problem.inverse_dynamics:
        names = force_candidates(problem, split.train_runs, settings.without)
        return ForceSearch(problem, split.train_runs, names)
    encoder = any(run.poses is None for run in measured.runs)
    names = list_candidates(problem, split.train_runs, encoder, settings.without)
    return Search(problem, split.train_runs, names, settings.seconds)


def add_confounded_sets(choice: Choice, search: ForceSearch, split: Split) -> Choice:
    """The choice with all sets that these runs cannot distinguish from the accepted ones."""
    confounded = [
        evaluate_set(fit, split.folds, choice.base) for h in choice.accepted for fit in search.confounded_sets(h.names)
    ]
    return replace(choice, accepted=(*choice.accepted, *confounded))


def make_force_problem(problem: Problem, runs: tuple[ForceRun, ...]) -> Problem:
    """The problem with the reference sizes of inverse dynamics."""
    return replace(
        problem,
        inverse_dynamics=True,
        unknown_inputs=False,
        speed=float(max(np.abs(run.speed).max() for run in runs)),
        force=float(np.sqrt(np.mean(np.concatenate([run.q for run in runs]) ** 2))),
        load=float(np.sqrt(np.mean(np.concatenate([run.load for run in runs]) ** 2))),
    )


def apply_tracking_noise(
    runs: tuple[FitRun, ...], noise: SensorNoise, geometry: KinematicsFinding | None
) -> tuple[tuple[FitRun, ...], SensorNoise]:
    """The runs with the noise of part poses. A tracker's errors are correlated over time, so differences between
    neighbouring readings miss them."""
    q_std = {} if geometry is None else {track.name: track.q_std for track in geometry.tracks}
    if not q_std:
        return runs, noise
    louder = tuple(replace(run, sigma=np.maximum(run.sigma, q_std.get(run.name, 0.0))) for run in runs)
    if len(q_std) < len(runs):
        return louder, noise
    return louder, replace(noise, sigma_at_rest=max(noise.sigma_at_rest, float(np.median(list(q_std.values())))))


def make_force_curves(
    choice: Choice, split: Split, delivered: DeliveredFits, runs: tuple[FitRun, ...]
) -> tuple[ReplayGap, ...]:
    """Measured and modelled force of each run, with the asset as given and as delivered. Where nothing is delivered:
    with the most probable set, on runs that it was not fitted to."""
    nearest = {} if choice.accepted or not choice.has_gap else choice.best.test_residuals
    found = []
    for run in runs:
        if nearest and run.name not in nearest:
            continue
        after = nearest.get(run.name, delivered.after.residuals[run.name])
        curves = run.q - delivered.before.residuals[run.name] * run.sigma, run.q - after * run.sigma
        noise, use = root_mean_square(run.sigma), split.use(run.name)
        found.append(compare_curves(run.name, run.times_s, run.q, curves, noise, run.regime, use))
    return tuple(found)


def rank_hypotheses(choice: Choice) -> tuple[Ranked, ...]:
    """All evaluated sets, the most probable first."""
    by_names = {h.names: h for h in (*choice.table, *choice.accepted)}
    order = sorted(by_names.values(), key=lambda h: -h.score.total)
    return tuple(Ranked(h.names, h.rms, *score_difference(h.score, order[0].score)) for h in order[:MOST_RANKED])


def select_certain(motion: Verdict, geometry: KinematicsFinding | None) -> tuple[NamedEffect, ...]:
    """The effects that are named without doubt. Only these are written into the asset."""
    return (
        *(geometry.named if geometry is not None and geometry.verdict == "named" else ()),
        *(motion.effects if motion.verdict == "named" else ()),
    )


def join_geometry(motion: Verdict, geometry: KinematicsFinding | None, kind: JointType) -> Verdict:
    """The verdict on motion along the joint joined with that on the joint's geometry."""
    if geometry is None or geometry.verdict in ("no_gap", "not_excited"):
        return motion
    answer = max(motion.verdict, geometry.verdict, key=_ORDER.index)
    reported = ("named",) if answer == "unexplained" else ("named", "ambiguous")
    geometry_effects = geometry.named if geometry.verdict in reported else ()
    effects = (*geometry_effects, *(motion.effects if motion.verdict in reported else ()))
    sets = [
        tuple(dict.fromkeys((*geometry_set, *other)))
        for geometry_set in geometry.rivals or (tuple(e.name for e in geometry.effects),)
        for other in motion.rivals or (tuple(n.effect.name for n in effects[len(geometry_effects) :]),)
    ]
    text = geometry_sentence(geometry, kind)
    return replace(
        motion,
        verdict=answer,
        effects=effects,
        rivals=tuple(sets) if answer == "ambiguous" else (),
        next_experiment=" ".join(filter(None, (geometry.next_experiment, motion.next_experiment))) or None,
        sentence=text if motion.verdict == "no_gap" and not motion.corrections else f"{text} {motion.sentence}",
        in_part=motion.in_part and answer in ("named", "ambiguous"),
    )


def geometry_sentence(geometry: KinematicsFinding, kind: JointType) -> str:
    """What part poses say about the joint, with numbers."""
    if geometry.verdict == "named":
        words = " and ".join(_effect_text(effect, kind) for effect in geometry.effects)
        return f"The joint is not where the asset has it: {words}."
    if geometry.verdict == "ambiguous":
        sets = ", or ".join(" with ".join(effect_label(name) for name in names) for names in geometry.rivals)
        return f"The joint is not where the asset has it, but these poses cannot decide how: {sets}."
    off = max((track.gap_before for track in geometry.tracks), default=0.0)
    return f"The part strays from its joint by {amount(off, 'm')}, and no effect of the library explains it."


def _effect_text(effect: Effect, kind: JointType) -> str:
    """The effect in words; of one with two vector components, its length."""
    sizes = {n: s.unit(kind) for n, s in effect.parameters(kind).items() if n.endswith(("_first", "_second"))}
    if len(sizes) != 2:
        return effect_words(effect, kind)
    far = float(np.hypot(*(getattr(effect, n) for n in sizes)))
    return f"{effect_label(effect.name)}, by {amount(far, next(iter(sizes.values())))}"


def gap_folder(
    asset: Path,
    measured: Path,
    out: Path,
    settings: GapSettings = DEFAULTS,
    replay_seconds: float = SECONDS,
    progress: Progress | None = None,
    root: Path | None = None,
) -> Verdict:
    """`find_gap` from folders to a folder with verdict, repaired asset and page. `out` appears whole or not at all.

    Args:
        asset: asset folder or URDF.
        measured: measured set.
        out: new folder, or an older answer, which is replaced.
        settings: of the analysis.
        replay_seconds: limit for SAPIEN's replay, s.
        progress: called with the number of replayed runs and their total.
        root: folder that the files named in the URDF must be in.

    Raises FreeArtError when `out` holds anything else, or is the asset or the measurement.
    """
    with answer_folder(out, (asset, measured)) as folder:
        runs = read_measured(measured)
        loaded = read_asset(asset, runs.joint, guesses=False, root=root)
        began = time.perf_counter()
        draft = explain(loaded, runs, settings)
        seconds = time.perf_counter() - began
        named = Path(measured).resolve()
        title = named.parent.name if named.name == "measured" else named.name
        paths = Paths(Path(asset), Path(measured), Path(out), root, run_hashes(Path(measured)))
        return publish(loaded, runs, draft, folder, title, seconds, settings.seed, replay_seconds, progress, paths)
