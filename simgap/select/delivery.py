"""What of an explanation files can express: the effects' parameters with the asset's inertia and weight as they are, or
corrected.

In the fits, inertia, weight and tilt of the asset are free within their uncertainty. Here the smallest correction that
the runs need is chosen by the score that chooses effects, and the effects are refitted with the corrected asset.
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from freeart21.asset import Asset
from freeart21.effects import ASSET_ERRORS, gravity_change
from freeart21.effects.base import Effect
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
from simgap.fit.model import ASSET, HOLDING, TILT_RAD, ParameterMap, Problem
from simgap.fit.problem import without_asset_error
from simgap.measure.data import FitRun
from simgap.models.surrogate import make_plant
from simgap.prove.body import NO_CORRECTION, BodyCorrection, find_correction
from simgap.prove.writeback import write_repaired
from simgap.select.hypotheses import Hypothesis, evaluate_set
from simgap.select.intervals import NORMAL_90, covariance
from simgap.select.predictive import Score, score_difference
from simgap.select.split import Fold
from simgap.verdict import GAP_THRESHOLD, Correction, NamedEffect


@dataclass(frozen=True)
class RivalCorrection:
    """Another explanation of what a correction explains."""

    fit: Fit
    numbers: tuple[Correction, ...] = ()
    """Parameters of the asset that the correction does not have."""
    effects: tuple[Effect, ...] = ()
    """Effects that the correction does not have."""


@dataclass(frozen=True)
class Delivery:
    """An explanation as files can express it."""

    fit: Fit
    """The effects, with inertia and weight as in the corrected files."""
    body: BodyCorrection = NO_CORRECTION
    corrected: tuple[Correction, ...] = ()
    """Corrected parameters with 90 % intervals."""
    correction_fit: Fit | None = None
    """The fit with the corrected parameters free."""
    rivals: tuple[RivalCorrection, ...] = ()
    """Explanations as good as parameters of the correction."""

    @property
    def holding(self) -> float:
        """Interpolation of inputs, see `Nuisance`."""
        return ParameterMap(self.fit.model).nuisance(self.fit.theta).holding

    def with_delivered_values(self, named: Sequence[NamedEffect]) -> tuple[NamedEffect, ...]:
        """The effects with the delivered values; intervals keep the uncertainty of the asset."""
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
    """The effects of a hypothesis with the smallest correction of the asset that leaves noise where the full correction
    does; where that leaves more, the smallest within one standard error of the best. Of two of one size the better fit
    is taken.

    Args:
        hypothesis: the effects.
        train: runs to fit.
        folds: runs to choose by.
        asset: as given.
        measured: the measurement.
        names: effects that the runs could show.
    """
    problem = hypothesis.fit.model.problem
    tried = [
        _refit_delivered(variant, hypothesis.fit, train) for variant in _correction_variants(problem, hypothesis.names)
    ]
    if len(tried) == 1:  # the asset is exact
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
    except FreeArtError:  # its files cannot express it
        return Delivery(tried[0])
    corrected = _make_corrections(fit, every_doubt)
    delivered = _refit_delivered(without_asset_error(problem, plant), fit, train)
    return Delivery(delivered, body, corrected, fit, tuple(rivals))


def _leaves_noise(hypothesis: Hypothesis, runs: set[str]) -> bool:
    """Whether three of four of these runs show no gap."""
    shown = sum(hypothesis.rms_by_run[run] > GAP_THRESHOLD for run in runs)
    return shown <= 0.25 * len(runs)


def _is_as_good(hypothesis: Hypothesis, other: Hypothesis, runs: set[str]) -> bool:
    """Whether a hypothesis leaves noise in these runs, or is within one standard error of another."""
    return _leaves_noise(hypothesis, runs) or _is_near(other.score, hypothesis.score)


def _fit_lean_alternatives(fit: Fit, runs: tuple[FitRun, ...], names: Collection[str]) -> list[Fit]:
    """Fits with another effect, of `names`, in place of a tilt of the weight beyond a usual mounting. They start
    without tilt, at which its prior holds it."""
    problem, nuisance = fit.model.problem, ParameterMap(fit.model).nuisance(fit.theta)
    if problem.inverse_dynamics or abs(nuisance.lean[0]) <= TILT_RAD:
        return []
    terms = problem.plant.gravity_terms
    pull = nuisance.gravity * (terms[0] + nuisance.lean[0] * terms[1] + nuisance.lean[1] * terms[2])
    change = [float(value) for value in pull - terms[0]]
    inertia = nuisance.inertia * problem.plant.mechanics.inertia
    operating_point = replace(problem.operating_point, inertia=inertia)
    found = []
    for other in gravity_change(*change).alternatives(operating_point):
        if other.name in fit.model.names or other.name not in names:
            continue
        model = Model(problem, tuple(sorted((*fit.model.names, other.name))), instant_friction=True)
        begin = initial_theta(model, fit, {other.name: other.point, ASSET: {"lean": 0.0}})
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
    """The problem with no asset parameter free, with inertia, tilt, both, weight, and all of them."""
    bare = without_asset_error(problem)
    variants = [
        bare,
        replace(bare, inertia_relative=problem.inertia_relative),
        replace(bare, tilt_rad=problem.tilt_rad),
        replace(bare, tilt_rad=problem.tilt_rad, inertia_relative=problem.inertia_relative),
        replace(bare, gravity_relative=problem.gravity_relative),
        problem,
    ]
    found: dict[tuple[str, ...], Problem] = {}
    for variant in variants:
        ranges = Model(variant, names, instant_friction=True).ranges()
        found.setdefault(tuple(r.name for r in ranges if r.owner == ASSET), variant)
    return list(found.values())


def _refit_delivered(problem: Problem, parent: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The effects of a fit, without presliding, refitted under another problem."""
    model = Model(problem, parent.model.names, instant_friction=True)
    starts = {run.name: parent.starts[run.name] for run in runs if run.name in parent.starts}
    return refit_missed_starts(fit_model(model, runs, initial_theta(model, parent, {}), starts), runs)


def _asset_parameters(fit: Fit) -> dict[str, int]:
    """Name to index of the asset's own parameters."""
    return {r.name: i for i, r in enumerate(fit.model.ranges()) if r.owner == ASSET and r.name != HOLDING}


def _make_corrections(fit: Fit, every: Fit, without: Collection[str] = ()) -> tuple[Correction, ...]:
    """The fitted asset parameters but those of `without`, with 90 % intervals from a fit with all of them free."""
    at = _asset_parameters(every)
    spread = NORMAL_90 * np.sqrt(np.diag(covariance(every, residual_dispersion(robust_residuals(every.residuals)))))
    joint_type = fit.model.problem.plant.joint_type
    units = {n: spec.unit(joint_type) for cls in ASSET_ERRORS.values() for n, spec in cls.parameters().items()}
    found = []
    for name, i in _asset_parameters(fit).items():
        if name in without:
            continue
        x, free, s = float(fit.theta[i]), float(every.theta[at[name]]), float(spread[at[name]])
        found.append(Correction(name, units[name], x, min(x, free - s), max(x, free + s)))
    return tuple(found)
