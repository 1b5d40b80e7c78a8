"""The five steps, from an asset and what was measured of it to a verdict."""

from __future__ import annotations

import hashlib
import time
from dataclasses import asdict, replace
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
from simgap.fit.fit import Problem, Reader, Theory, fit_starts, placed
from simgap.fit.force_search import ForceSearch
from simgap.fit.force_search import candidates as force_candidates
from simgap.fit.problem import as_delivered, problem_of
from simgap.fit.search import Search, candidates
from simgap.geometry.finding import KinematicsFinding
from simgap.geometry.kinematics import KinematicsSettings, find_geometry_of
from simgap.measure.data import FitRun, fit_runs, thinned
from simgap.measure.floor import Floor
from simgap.measure.prescribed import ForceRun, force_runs
from simgap.measure.withstood import withstood
from simgap.models.surrogate import plant_of
from simgap.page.publish import Draft, Paths, answer_folder, publish, with_positions
from simgap.page.report import Ranked
from simgap.prove.body import NO_CORRECTION
from simgap.prove.replay import SECONDS, Progress
from simgap.prove.replay_process import check_match
from simgap.prove.show import ReplayGap, compare_curves
from simgap.select.choose import Choice, chosen
from simgap.select.decide import Delivered, moves_enough, says_enough, silent_verdict, verdict_of
from simgap.select.delivery import deliver
from simgap.select.hypotheses import FORM, Hypothesis, judged
from simgap.select.predictive import DECISIVE, FREEDOM, lead
from simgap.select.split import Split, split_of
from simgap.select.words import amount, effect_words, plain
from simgap.settings import GapSettings
from simgap.verdict import SHOWS, Named, Verdict, root_mean_square

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
"""Sets that the page lists."""
_ORDER = ("no_gap", "not_excited", "named", "ambiguous", "unexplained")
"""Answers; of two the later one stands."""


def find_gap(asset: Asset, measured: Measured, settings: GapSettings = DEFAULTS) -> Verdict:
    """What the simulation of `asset` lacks, by what was measured of it; nothing is written.

    Raises FreeArtError when the measurement is not of this asset's joint, or its units cannot be right.
    """
    return explain(asset, measured, settings).verdict


def explain(asset: Asset, measured: Measured, settings: GapSettings = DEFAULTS) -> Draft:
    """Measure, tell geometry from dynamics, name: all but what SAPIEN has to show."""
    draft = _explained(asset, measured, settings)
    notes = (*measured.notes, *draft.verdict.notes, *(() if draft.verdict.by == "force" else thinned(measured)))
    return replace(draft, verdict=replace(draft.verdict, notes=notes, judged_by=judged_by(settings)))


def judged_by(settings: GapSettings) -> dict[str, Any]:
    """Version, digest of this package's code and every number that decides a verdict."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    fixed = {"form": FORM, "freedom": FREEDOM, "decisive": DECISIVE, "shows": SHOWS}
    told = {**asdict(settings.judgement), **fixed}
    return {"freeart21": __version__, "code": digest.hexdigest()[:12], "settings": told}


def _explained(asset: Asset, measured: Measured, settings: GapSettings) -> Draft:
    check_match(asset, measured, "gap")
    geometry = find_geometry_of(asset, measured, KinematicsSettings(without=settings.without))
    positions = with_positions(measured, geometry)
    plant = plant_of(asset, measured)
    runs, floor = as_tracked(*fit_runs(positions, plant), geometry)
    moved = moves_enough(runs, floor, settings.judgement)
    held = withstood(positions, plant, floor)
    if held is not None or not moved or not says_enough(runs, settings.judgement):
        motion = silent_verdict(runs, floor, moved, measured.joint_type, held)
        return Draft(
            joined(motion, geometry, measured.joint_type),
            geometry=geometry,
            floor=floor.still,
            certain=certain_of(motion, geometry),
        )
    problem = problem_of(plant, measured, runs, floor, settings)
    seen = force_runs(positions, plant)
    if seen is not None and says_enough(seen[0], settings.judgement):
        runs, floor, problem = seen[0], seen[1], force_problem(problem, seen[0])
    split = split_of(runs)
    search = search_of(problem, split, measured, settings)
    choice = chosen(search, split.folds, settings.judgement)
    if isinstance(search, ForceSearch):
        choice = with_twins(choice, search, split)
    best = choice.explaining[0] if choice.explaining else choice.base
    delivery = deliver(best, search.train, split.folds, asset, measured, search.names)
    as_is = Theory(as_delivered(problem), (), prompt=True)
    before = fit_starts(as_is, np.full(len(as_is.ranges()), delivery.holding), runs)
    delivered = Delivered(delivery, before, placed(delivery.fit, runs))
    motion = verdict_of(choice, split, delivered, runs, floor, problem, settings.judgement)
    if isinstance(search, Search) and search.stopped:
        motion = replace(motion, notes=(*motion.notes, STOPPED.format(settings.seconds)))
    motion = replace(motion, notes=(*seen[2], NOT_REPLAYED)) if seen is not None and problem.force_read else motion
    return Draft(
        joined(motion, geometry, measured.joint_type),
        Reader(choice.base.fit.theory).nuisance(choice.base.fit.theta),
        ranking_of(choice),
        geometry,
        floor.still,
        motion.verdict != "no_gap",
        certain_of(motion, geometry),
        curves_of(choice, split, delivered, runs) if problem.force_read else (),
        delivery.body if motion.corrections or motion.verdict == "ambiguous" else NO_CORRECTION,
        settings.judgement.dominant,
    )


def search_of(problem: Problem, split: Split, measured: Measured, settings: GapSettings) -> Search | ForceSearch:
    """What looks for sets: in positions, or in the force of prescribed motion."""
    if problem.force_read:
        names = force_candidates(problem, split.fitted, settings.without)
        return ForceSearch(problem, split.fitted, settings.search, names)
    encoder = any(run.poses is None for run in measured.runs)
    names = candidates(problem, split.fitted, encoder, settings.without)
    return Search(problem, split.fitted, settings.search, names, settings.seconds)


def with_twins(choice: Choice, search: ForceSearch, split: Split) -> Choice:
    """The choice with all that these runs cannot tell from what stands."""
    twins = [judged(fit, split.folds, choice.base) for h in choice.explaining for fit in search.twins(h.names)]
    return replace(choice, explaining=(*choice.explaining, *twins))


def force_problem(problem: Problem, runs: tuple[ForceRun, ...]) -> Problem:
    """What fits to the force of prescribed motion share."""
    return replace(
        problem,
        force_read=True,
        unknown_inputs=False,
        speed=float(max(np.abs(run.speed).max() for run in runs)),
        force=float(np.sqrt(np.mean(np.concatenate([run.q for run in runs]) ** 2))),
        load=float(np.sqrt(np.mean(np.concatenate([run.load for run in runs]) ** 2))),
    )


def as_tracked(
    runs: tuple[FitRun, ...], floor: Floor, geometry: KinematicsFinding | None
) -> tuple[tuple[FitRun, ...], Floor]:
    """Runs with the noise that part poses have: a tracker's errors last, so that neighbouring readings hide them."""
    noise = {} if geometry is None else {track.name: track.q_std for track in geometry.tracks}
    if not noise:
        return runs, floor
    louder = tuple(replace(run, sigma=np.maximum(run.sigma, noise.get(run.name, 0.0))) for run in runs)
    if len(noise) < len(runs):
        return louder, floor
    return louder, replace(floor, still=max(floor.still, float(np.median(list(noise.values())))))


def curves_of(choice: Choice, split: Split, delivered: Delivered, runs: tuple[FitRun, ...]) -> tuple[ReplayGap, ...]:
    """Runs by inverse dynamics, with the asset as it is and as it is delivered; where nothing is, with the best set
    before runs that it was not fitted to."""
    nearest = {} if choice.explaining or not choice.gap else choice.best.left
    found = []
    for run in runs:
        if nearest and run.name not in nearest:
            continue
        after = nearest.get(run.name, delivered.after.residuals[run.name])
        curves = run.q - delivered.before.residuals[run.name] * run.sigma, run.q - after * run.sigma
        floor, use = root_mean_square(run.sigma), split.use(run.name)
        found.append(compare_curves(run.name, run.times_s, run.q, curves, floor, run.regime, use))
    return tuple(found)


def ranking_of(choice: Choice) -> tuple[Ranked, ...]:
    """All sets that were judged, the most probable first."""
    of = {h.names: h for h in (*choice.table, *choice.explaining)}
    order = sorted(of.values(), key=lambda h: -h.score.total)
    return tuple(
        Ranked(h.names, h.floors, *lead(h.score, order[0].score), spread=spread_of(h)) for h in order[:MOST_RANKED]
    )


def spread_of(hypothesis: Hypothesis) -> tuple[float, float]:
    """The least and the largest error of one choosing run, in floors."""
    runs = [float(np.sqrt(np.mean(residual**2))) for residual in hypothesis.left.values()]
    return min(runs), max(runs)


def certain_of(motion: Verdict, geometry: KinematicsFinding | None) -> tuple[Named, ...]:
    """The effects that are named without doubt, whatever may be said of the rest: these go into the asset."""
    return (
        *(geometry.named if geometry is not None and geometry.verdict == "named" else ()),
        *(motion.effects if motion.verdict == "named" else ()),
    )


def joined(motion: Verdict, geometry: KinematicsFinding | None, kind: JointType) -> Verdict:
    """The verdict on motion along the joint, and what part poses say of the joint itself."""
    if geometry is None or geometry.verdict in ("no_gap", "not_excited"):
        return motion
    answer = max(motion.verdict, geometry.verdict, key=_ORDER.index)
    told = ("named",) if answer == "unexplained" else ("named", "ambiguous")
    crooked_effects = geometry.named if geometry.verdict in told else ()
    kept = (*crooked_effects, *(motion.effects if motion.verdict in told else ()))
    sets = [
        tuple(dict.fromkeys((*crooked, *other)))
        for crooked in geometry.rivals or (tuple(e.name for e in geometry.effects),)
        for other in motion.rivals or (tuple(n.effect.name for n in kept[len(crooked_effects) :]),)
    ]
    said = sentence_of(geometry, kind)
    return replace(
        motion,
        verdict=answer,
        effects=kept,
        rivals=tuple(sets) if answer == "ambiguous" else (),
        next_experiment=" ".join(filter(None, (geometry.next_experiment, motion.next_experiment))) or None,
        sentence=said if motion.verdict == "no_gap" and not motion.corrections else f"{said} {motion.sentence}",
        in_part=motion.in_part and answer in ("named", "ambiguous"),
    )


def sentence_of(geometry: KinematicsFinding, kind: JointType) -> str:
    """What part poses say of the joint, with its numbers."""
    if geometry.verdict == "named":
        words = " and ".join(_how_far(effect, kind) for effect in geometry.effects)
        return f"The joint is not where the asset has it: {words}."
    if geometry.verdict == "ambiguous":
        sets = ", or ".join(" with ".join(plain(name) for name in names) for names in geometry.rivals)
        return f"The joint is not where the asset has it, but these poses cannot decide how: {sets}."
    off = max((track.gap_before for track in geometry.tracks), default=0.0)
    return f"The part strays from its joint by {amount(off, 'm')}, and no effect of the library explains it."


def _how_far(effect: Effect, kind: JointType) -> str:
    """The effect in words; of one with a direction, how far in all."""
    sizes = {n: s.unit(kind) for n, s in effect.parameters(kind).items() if n.endswith(("_first", "_second"))}
    if len(sizes) != 2:
        return effect_words(effect, kind)
    far = float(np.hypot(*(getattr(effect, n) for n in sizes)))
    return f"{plain(effect.name)}, by {amount(far, next(iter(sizes.values())))}"


def gap_folder(
    asset: Path,
    measured: Path,
    out: Path,
    settings: GapSettings = DEFAULTS,
    replay_seconds: float = SECONDS,
    progress: Progress | None = None,
    root: Path | None = None,
) -> Verdict:
    """`find_gap` from folders to a folder with verdict, repaired asset and page, which appears whole or not at all.

    Only an older answer is replaced. SAPIEN's replay is given up after `replay_seconds`; `progress` is told how many
    runs are replayed; `root` bounds what the asset's URDF may name. Raises FreeArtError when `out` holds anything else,
    or asset or measurement.
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
