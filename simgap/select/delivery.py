"""What of an explanation can be delivered in files: its numbers with the asset as it is, or with its body corrected.

Fits leave inertia, weight and base free by what the asset may be off by. No file says so. Here the smallest correction
of the body that runs need is chosen by the score that chooses effects, and the effects are fitted anew to the
asset as it then is.
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from freeart21.asset import Asset
from freeart21.effects import gravity_change
from freeart21.effects.base import Effect, Surroundings
from freeart21.errors import FreeArtError
from freeart21.measured import Measured
from simgap.fit.fit import Fit, Theory, fitted, joined, resettled, tempered, unit_of
from simgap.fit.problem import as_delivered
from simgap.fit.theory import HOLDING, Problem, Reader
from simgap.measure.data import FitRun
from simgap.models.surrogate import plant_of
from simgap.prove.body import NO_CORRECTION, BodyCorrection, correction_of
from simgap.prove.writeback import repaired
from simgap.select.hypotheses import Hypothesis, judged
from simgap.select.intervals import NORMAL_90, covariance
from simgap.select.predictive import Score, lead
from simgap.select.split import Fold
from simgap.settings import FitSettings
from simgap.verdict import SHOWS, Corrected, Named

ASSET = "asset"
"""Owner of the numbers that say how the asset is off (`Theory.ranges`)."""
_LEAN = "lean_1"
_SAID = {
    "inertia": ("inertia", "1"),
    "gravity": ("weight", "1"),
    _LEAN: ("lean", "rad"),
    "lean_2": ("lean_across", "rad"),
}
"""Its names to those of verdict.json, and units."""


@dataclass(frozen=True)
class Rival:
    """Another explanation of what a correction explains."""

    fit: Fit
    numbers: tuple[Corrected, ...] = ()
    """Those of the asset that the correction does not have."""
    effects: tuple[Effect, ...] = ()
    """Likewise."""


@dataclass(frozen=True)
class Delivery:
    """An explanation as files say it."""

    fit: Fit
    """The effects, the asset's inertia and weight being what the corrected files say."""
    body: BodyCorrection = NO_CORRECTION
    corrected: tuple[Corrected, ...] = ()
    """The numbers of the body that were fitted, with 90 % intervals."""
    chosen: Fit | None = None
    """The fit by which the body is corrected."""
    rivals: tuple[Rival, ...] = ()
    """What does as well in the place of numbers of the correction."""

    @property
    def holding(self) -> float:
        """How inputs go on between their rows, see `Nuisance`."""
        return Reader(self.fit.theory).nuisance(self.fit.theta).holding

    def renumbered(self, named: Sequence[Named]) -> tuple[Named, ...]:
        """The effects with the numbers that are delivered; intervals keep the doubt of the asset."""
        of = {effect.name: effect for effect in self.fit.effects}
        return tuple(_renumbered(n, of[n.effect.name]) for n in named)


def _renumbered(named: Named, effect: Effect) -> Named:
    low = {name: min(value, getattr(effect, name)) for name, value in named.low.items()}
    high = {name: max(value, getattr(effect, name)) for name, value in named.high.items()}
    return Named(effect, low, high)


def deliver(
    hypothesis: Hypothesis,
    train: tuple[FitRun, ...],
    folds: tuple[Fold, ...],
    asset: Asset,
    measured: Measured,
    names: Collection[str] = (),
) -> Delivery:
    """The effects of a hypothesis with the smallest correction of the body that leaves noise where all of them do: what
    is fitted and not delivered may explain nothing. Where all leave more, with the smallest within one standard error
    of the best.

    Of two corrections as small the one that the asset's doubts make likelier stands. `train` are the runs to fit,
    `names` effects that these could show.
    """
    problem = hypothesis.fit.theory.problem
    tried = [_refitted(variant, hypothesis.fit, train) for variant in _variants(problem, hypothesis.names)]
    if len(tried) == 1:  # nothing of the asset is in doubt
        return Delivery(tried[0])
    seen = [judged(fit, folds) for fit in tried]
    best = max((h.score for h in seen), key=lambda score: score.total)
    every, quiet = set(seen[-1].by_run), {run for run, floors in seen[-1].by_run.items() if floors <= SHOWS}
    able = [h for h in seen if h is seen[-1] or _is_quiet(h, quiet)]
    near = [h.fit for h in able if h is seen[-1] or _is_quiet(h, every) or _near(best, h.score)]
    fewest = min(len(_doubts(fit)) for fit in near)
    fit = min((fit for fit in near if len(_doubts(fit)) == fewest), key=lambda fit: fit.cost)
    if not _doubts(fit):
        return Delivery(fit)
    numbers, every_doubt = {*_doubts(fit)}, tried[-1]
    others = [o for o in near if not numbers <= {*_doubts(o)} and len(_doubts(o)) < len(_doubts(every_doubt))]
    rivals = [Rival(o, _corrected(o, every_doubt, numbers)) for o in sorted(others, key=lambda o: o.cost)[:1]]
    turned = [Rival(o, effects=_added(o, fit)) for o in _instead_of_lean(fit, train, names)]
    rivals += [rival for rival in turned if _is_as_good(judged(rival.fit, folds), seen[tried.index(fit)], every)]
    body = correction_of(problem.plant, Reader(fit.theory).nuisance(fit.theta))
    try:
        with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
            plant = plant_of(repaired(asset, (), Path(place) / "asset", body=body), measured)
    except FreeArtError:  # its files cannot say so
        return Delivery(tried[0])
    corrected = _corrected(fit, every_doubt)
    delivered = _refitted(as_delivered(problem, plant), fit, train)
    return Delivery(delivered, body, corrected, fit, tuple(rivals))


def _is_quiet(hypothesis: Hypothesis, runs: set[str]) -> bool:
    """Whether three of four of these runs show no gap of their own."""
    shown = sum(hypothesis.by_run[run] > SHOWS for run in runs)
    return shown <= 0.25 * len(runs)


def _is_as_good(hypothesis: Hypothesis, other: Hypothesis, runs: set[str]) -> bool:
    """Whether a hypothesis leaves noise of these runs, or is within one standard error of another."""
    return _is_quiet(hypothesis, runs) or _near(other.score, hypothesis.score)


def _instead_of_lean(fit: Fit, runs: tuple[FitRun, ...], names: Collection[str]) -> list[Fit]:
    """What else, of the effects `names`, explains that the weight pulls from where the asset does not say, by more than
    a usual mounting: that set, begun without a lean, to which its prior holds it."""
    problem, nuisance = fit.theory.problem, Reader(fit.theory).nuisance(fit.theta)
    if problem.force_read or abs(nuisance.lean[0]) <= FitSettings.tilt_rad:
        return []
    terms = problem.plant.gravity_terms
    pull = nuisance.gravity * (terms[0] + nuisance.lean[0] * terms[1] + nuisance.lean[1] * terms[2])
    own, change = ([float(value) for value in each] for each in (terms[0], pull - terms[0]))
    plant, span = problem.plant, problem.q_high - problem.q_low
    inertia = nuisance.inertia * plant.mechanics.inertia
    among = Surroundings(plant.joint_type, problem.speed, span, problem.load, inertia, (own[0], own[1], own[2]))
    found = []
    for other in gravity_change(*change).alternatives(among):
        if other.name in fit.theory.names or other.name not in names:
            continue
        theory = Theory(problem, tuple(sorted((*fit.theory.names, other.name))), prompt=True)
        begin = joined(theory, fit, {other.name: other.point, ASSET: {_LEAN: 0.0}})
        starts = {run: (q + other.ahead, speed) for run, (q, speed) in fit.starts.items()}
        found.append(resettled(fitted(theory, runs, begin, starts), runs))
    return found


def _added(fit: Fit, other: Fit) -> tuple[Effect, ...]:
    """The effects that another fit does not have."""
    return tuple(effect for effect in fit.effects if effect.name not in other.theory.names)


def _near(best: Score, score: Score) -> bool:
    """Whether a score is within one standard error of the best."""
    ahead, error = lead(best, score)
    return ahead <= error


def _variants(problem: Problem, names: tuple[str, ...]) -> list[Problem]:
    """The problem without doubts of the asset, with that of its inertia, of its base, of both, of its weight, and with
    all."""
    bare = as_delivered(problem)
    variants = [
        bare,
        replace(bare, inertia_relative=problem.inertia_relative),
        replace(bare, fit=problem.fit),
        replace(bare, fit=problem.fit, inertia_relative=problem.inertia_relative),
        replace(bare, gravity_relative=problem.gravity_relative),
        problem,
    ]
    found: dict[tuple[str, ...], Problem] = {}
    for variant in variants:
        ranges = Theory(variant, names, prompt=True).ranges()
        found.setdefault(tuple(r.name for r in ranges if r.owner == ASSET), variant)
    return list(found.values())


def _refitted(problem: Problem, parent: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The effects of a fit, as a simulator has them, fitted under another problem."""
    theory = Theory(problem, parent.theory.names, prompt=True)
    starts = {run.name: parent.starts[run.name] for run in runs if run.name in parent.starts}
    return resettled(fitted(theory, runs, joined(theory, parent, {}), starts), runs)


def _doubts(fit: Fit) -> dict[str, int]:
    """Names of the numbers that say how the asset is off, and their indices."""
    return {r.name: i for i, r in enumerate(fit.theory.ranges()) if r.owner == ASSET and r.name != HOLDING}


def _corrected(fit: Fit, every: Fit, without: Collection[str] = ()) -> tuple[Corrected, ...]:
    """The numbers of the asset that were fitted, but those `without`, with the 90 % intervals that they have in a fit
    of `every` doubt."""
    at = _doubts(every)
    spread = NORMAL_90 * np.sqrt(np.diag(covariance(every, unit_of(tempered(every.residuals)))))
    found = []
    for name, i in _doubts(fit).items():
        if name in without:
            continue
        x, free, s = float(fit.theta[i]), float(every.theta[at[name]]), float(spread[at[name]])
        found.append(Corrected(*_SAID[name], x, min(x, free - s), max(x, free + s)))
    return tuple(found)
