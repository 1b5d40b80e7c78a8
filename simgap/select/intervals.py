"""90 % intervals of effects' parameters."""

from __future__ import annotations

import numpy as np

from freeart21.effects import Effect
from simgap.fit.fit import Fit, information_matrix, residual_dispersion, robust_residuals
from simgap.fit.model import SHAFT
from simgap.select.hypotheses import Hypothesis
from simgap.verdict import NamedEffect

NORMAL_90 = 1.645


def estimate_intervals(hypothesis: Hypothesis) -> tuple[NamedEffect, ...]:
    """The effects with 90 % intervals, strongest first: the one whose removal costs most.

    Noise is taken from the residuals of the test runs, with their correlation. An effect's size is known only up to its
    model error, which is uniform within `Effect.model_error`.
    """
    fit, unit = hypothesis.fit, residual_dispersion(robust_residuals(hypothesis.test_residuals))
    ranges = fit.model.ranges()
    errors = dict(zip(fit.values, np.sqrt(np.diag(covariance(fit, unit))), strict=True))
    found = []
    for effect in fit.effects:
        own = {r.name: i for i, r in enumerate(ranges) if r.owner == effect.name}
        specs, part, ends = effect.parameters(), max(effect.model_error) / np.sqrt(3.0), {}  # uniform
        for name, i in own.items():
            x = fit.theta[i]
            size = 0.0 if is_place(effect, name) else x - effect.neutral * (i == min(own.values()))
            spread = NORMAL_90 * np.hypot(errors[effect.name, name], part * size)
            ends[name] = max(x - spread, specs[name].lower), min(x + spread, specs[name].upper)
        for shaft, form in zip(effect.rotor_fields[1:], ("rebound", "swing"), strict=False):
            ends[shaft] = _shaft_interval(fit, errors, effect, form, shaft)
        low, high = ({name: float(end[k]) for name, end in ends.items()} for k in (0, 1))
        i = min(own.values())
        weight = (fit.theta[i] - effect.neutral) ** 2 * fit.normal[i, i]
        found.append((float(weight), NamedEffect(effect, low, high)))
    found.sort(key=lambda pair: -pair[0])
    return tuple(named for _, named in found)


def _shaft_interval(
    fit: Fit, errors: dict[tuple[str, str], float], effect: Effect, name: str, parameter: str
) -> tuple[float, float]:
    """90 % interval of the drive's shaft `parameter`, fitted as SHAFT's `name`; 0 to 0 where a stop effect bounces
    instead."""
    ranges = fit.model.ranges()
    at = next((i for i, r in enumerate(ranges) if (r.owner, r.name) == (SHAFT, name)), None)
    if at is None:
        return 0.0, 0.0
    spread, ends = NORMAL_90 * errors[SHAFT, name], []
    for x in (fit.theta[at] - spread, fit.theta[at] + spread):
        theta = fit.theta.copy()
        theta[at] = np.clip(x, ranges[at].lower, ranges[at].upper)
        ends.append(float(next(getattr(e, parameter) for e in fit.model.effects(theta) if e.name == effect.name)))
    return ends[0], ends[1]


def is_place(effect: Effect, name: str) -> bool:
    """Whether a parameter of a force is a position."""
    spec = effect.parameters()[name]
    return effect.acts == "force" and spec.revolute_unit == "rad" and spec.lower < 0


def covariance(fit: Fit, unit: float) -> np.ndarray:
    """(p, p) of the parameters; `unit` is the residual dispersion."""
    normal = information_matrix(fit, unit)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-10, hermitian=True) / np.outer(scale, scale)
