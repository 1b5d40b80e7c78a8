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
from freeart21.effects.base import Effect, OperatingPoint
from freeart21.errors import FreeArtError
from freeart21.measured import Measured
from simgap.fit.fit import (
    Fit,
    Model,
    fit_model,
    initial_theta,
    refit_missed_starts,
    residual_dispersion,
    robust_residuals,
)
from simgap.fit.model import HOLDING, ParameterMap, Problem
from simgap.fit.problem import without_asset_error
from simgap.measure.data import FitRun
from simgap.models.surrogate import make_plant
from simgap.prove.body import NO_CORRECTION, BodyCorrection, find_correction
from simgap.prove.writeback import write_repaired
from simgap.select.hypotheses import Hypothesis, evaluate_set
from simgap.select.intervals import NORMAL_90, covariance
from simgap.select.predictive import Score, score_difference
from simgap.select.split import Fold
from simgap.settings import FitSettings
from simgap.verdict import GAP_THRESHOLD, Correction, NamedEffect

ASSET = "asset"
"""Owner of the numbers that say how the asset is off (`Theory.ranges`)."""
_LEAN = "lean_1"
_VERDICT_NAMES = {
    "inertia": ("inertia", "1"),
    "gravity": ("weight", "1"),
    _LEAN: ("lean", "rad"),
    "lean_2": ("lean_across", "rad"),
}
"""Its names to those of verdict.json, and units."""


@dataclass(frozen=True)
class RivalCorrection:
    """Another explanation of what a correction explains."""

    fit: Fit
    numbers: tuple[Correction, ...] = ()
    """Those of the asset that the correction does not have."""
    effects: tuple[Effect, ...] = ()
    """Likewise."""


@dataclass(frozen=True)
class Delivery:
    """An explanation as files say it."""

    fit: Fit
    """The effects, the asset's inertia and weight being what the corrected files say."""
    body: BodyCorrection = NO_CORRECTION
    corrected: tuple[Correction, ...] = ()
    """The numbers of the body that were fitted, with 90 % intervals."""
    correction_fit: Fit | None = None
    """The fit by which the body is corrected."""
    rivals: tuple[RivalCorrection, ...] = ()
    """What does as well in the place of numbers of the correction."""

    @property
    def holding(self) -> float:
        """How inputs go on between their rows, see `Nuisance`."""
        return ParameterMap(self.fit.model).nuisance(self.fit.theta).holding

    def with_delivered_values(self, named: Sequence[NamedEffect]) -> tuple[NamedEffect, ...]:
        """The effects with the numbers that are delivered; intervals keep the doubt of the asset."""
        of = {effect.name: effect for effect in self.fit.effects}
        return tuple(_replace_values(n, of[n.effect.name]) for n in named)


def _replace_values(named: NamedEffect, effect: Effect) -> NamedEffect:
    low = {name: min(value, getattr(effect, name)) for name, value in named.low.items()}
    high = {name: max(value, getattr(effect, name)) for name, value in named.high.items()}
    return NamedEffect(effect, low, high)


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
    problem = hypothesis.fit.model.problem
    tried = [
        _refit_delivered(variant, hypothesis.fit, train) for variant in _correction_variants(problem, hypothesis.names)
    ]
    if len(tried) == 1:  # nothing of the asset is in doubt
        return Delivery(tried[0])
    seen = [evaluate_set(fit, folds) for fit in tried]
    best = max((h.score for h in seen), key=lambda score: score.total)
    every, quiet = (
        set(seen[-1].rms_by_run),
        {run for run, floors in seen[-1].rms_by_run.items() if floors <= GAP_THRESHOLD},
    )
    able = [h for h in seen if h is seen[-1] or _leaves_noise(h, quiet)]
    near = [h.fit for h in able if h is seen[-1] or _leaves_noise(h, every) or _is_near(best, h.score)]
    fewest = min(len(_asset_parameters(fit)) for fit in near)
    fit = min((fit for fit in near if len(_asset_parameters(fit)) == fewest), key=lambda fit: fit.cost)
    if not _asset_parameters(fit):
        return Delivery(fit)
    numbers, every_doubt = {*_asset_parameters(fit)}, tried[-1]
    others = [
        o
        for o in near
        if not numbers <= {*_asset_parameters(o)} and len(_asset_parameters(o)) < len(_asset_parameters(every_doubt))
    ]
    rivals = [
        RivalCorrection(o, _make_corrections(o, every_doubt, numbers)) for o in sorted(others, key=lambda o: o.cost)[:1]
    ]
    turned = [RivalCorrection(o, effects=_added_effects(o, fit)) for o in _fit_lean_alternatives(fit, train, names)]
    rivals += [rival for rival in turned if _is_as_good(evaluate_set(rival.fit, folds), seen[tried.index(fit)], every)]
    body = find_correction(problem.plant, ParameterMap(fit.model).nuisance(fit.theta))
    try:
        with tempfile.TemporaryDirectory(prefix="freeart21-") as folder:
            plant = make_plant(write_repaired(asset, (), Path(folder) / "asset", body=body), measured)
    except FreeArtError:  # its files cannot say so
        return Delivery(tried[0])
    corrected = _make_corrections(fit, every_doubt)
    delivered = _refit_delivered(without_asset_error(problem, plant), fit, train)
    return Delivery(delivered, body, corrected, fit, tuple(rivals))


def _leaves_noise(hypothesis: Hypothesis, runs: set[str]) -> bool:
    """Whether three of four of these runs show no gap of their own."""
    shown = sum(hypothesis.rms_by_run[run] > GAP_THRESHOLD for run in runs)
    return shown <= 0.25 * len(runs)


def _is_as_good(hypothesis: Hypothesis, other: Hypothesis, runs: set[str]) -> bool:
    """Whether a hypothesis leaves noise of these runs, or is within one standard error of another."""
    return _leaves_noise(hypothesis, runs) or _is_near(other.score, hypothesis.score)


def _fit_lean_alternatives(fit: Fit, runs: tuple[FitRun, ...], names: Collection[str]) -> list[Fit]:
    """What else, of the effects `names`, explains that the weight pulls from where the asset does not say, by more than
    a usual mounting: that set, begun without a lean, to which its prior holds it."""
    problem, nuisance = fit.model.problem, ParameterMap(fit.model).nuisance(fit.theta)
    if problem.inverse_dynamics or abs(nuisance.lean[0]) <= FitSettings.tilt_rad:
        return []
    terms = problem.plant.gravity_terms
    pull = nuisance.gravity * (terms[0] + nuisance.lean[0] * terms[1] + nuisance.lean[1] * terms[2])
    own, change = ([float(value) for value in each] for each in (terms[0], pull - terms[0]))
    plant, span = problem.plant, problem.q_high - problem.q_low
    inertia = nuisance.inertia * plant.mechanics.inertia
    operating_point = OperatingPoint(
        plant.joint_type, problem.speed, span, problem.load, inertia, (own[0], own[1], own[2])
    )
    found = []
    for other in gravity_change(*change).alternatives(operating_point):
        if other.name in fit.model.names or other.name not in names:
            continue
        model = Model(problem, tuple(sorted((*fit.model.names, other.name))), instant_friction=True)
        begin = initial_theta(model, fit, {other.name: other.point, ASSET: {_LEAN: 0.0}})
        starts = {run: (q + other.position_shift, speed) for run, (q, speed) in fit.starts.items()}
        found.append(refit_missed_starts(fit_model(model, runs, begin, starts), runs))
    return found


def _added_effects(fit: Fit, other: Fit) -> tuple[Effect, ...]:
    """The effects that another fit does not have."""
    return tuple(effect for effect in fit.effects if effect.name not in other.model.names)


def _is_near(best: Score, score: Score) -> bool:
    """Whether a score is within one standard error of the best."""
    ahead, error = score_difference(best, score)
    return ahead <= error


def _correction_variants(problem: Problem, names: tuple[str, ...]) -> list[Problem]:
    """The problem without doubts of the asset, with that of its inertia, of its base, of both, of its weight, and with
    all."""
    bare = without_asset_error(problem)
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
        ranges = Model(variant, names, instant_friction=True).ranges()
        found.setdefault(tuple(r.name for r in ranges if r.owner == ASSET), variant)
    return list(found.values())


def _refit_delivered(problem: Problem, parent: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The effects of a fit, as a simulator has them, fitted under another problem."""
    model = Model(problem, parent.model.names, instant_friction=True)
    starts = {run.name: parent.starts[run.name] for run in runs if run.name in parent.starts}
    return refit_missed_starts(fit_model(model, runs, initial_theta(model, parent, {}), starts), runs)


def _asset_parameters(fit: Fit) -> dict[str, int]:
    """Names of the numbers that say how the asset is off, and their indices."""
    return {r.name: i for i, r in enumerate(fit.model.ranges()) if r.owner == ASSET and r.name != HOLDING}


def _make_corrections(fit: Fit, every: Fit, without: Collection[str] = ()) -> tuple[Correction, ...]:
    """The numbers of the asset that were fitted, but those `without`, with the 90 % intervals that they have in a fit
    of `every` doubt."""
    at = _asset_parameters(every)
    spread = NORMAL_90 * np.sqrt(np.diag(covariance(every, residual_dispersion(robust_residuals(every.residuals)))))
    found = []
    for name, i in _asset_parameters(fit).items():
        if name in without:
            continue
        x, free, s = float(fit.theta[i]), float(every.theta[at[name]]), float(spread[at[name]])
        found.append(Correction(*_VERDICT_NAMES[name], x, min(x, free - s), max(x, free + s)))
    return tuple(found)
