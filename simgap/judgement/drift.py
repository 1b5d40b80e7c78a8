"""Whether an effect's size changes over the session: what warms up, wears or slips is none of the library's, whose
sizes are constants.

The size of each effect is estimated anew from every single run, to first order about the fit, all else being as fitted.
A straight line through these sizes in the order of recording is tested against what they scatter by; how fast a run is
may change the size, too, for a real effect is not the library's formula, and its size depends on what it is asked from.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from simgap.fitting.fit import Fit, placed, tangent
from simgap.fitting.guess import neutral_value
from simgap.measure.data import FitRun
from simgap.settings import ChoiceSettings

_LEAST_RUNS = 6
_TOLD = 0.25
"""Part of itself to which a run must tell a size for it to count."""
_SCATTER = 0.02
"""Part of itself by which the size differs from run to run in any case."""
_LINEAR = ("force", "drive", "reading", "command")
"""What acts so does about twice as much when it is twice as large; what catches or bounces does not."""


@dataclass(frozen=True)
class Drift:
    """An effect that is not the same all the session."""

    name: str
    first: float
    """Its size in the first run, as a part of the fitted one."""
    last: float
    p_value: float


def drift_of(fit: Fit, runs: tuple[FitRun, ...], settings: ChoiceSettings) -> Drift | None:
    """The effect of the fit that changes most surely over the runs, in the order of recording; None where none does."""
    runs = tuple(sorted(runs, key=lambda run: run.turn))
    if len({run.turn for run in runs}) < _LEAST_RUNS or not fit.theory.names:
        return None
    new = tuple(run for run in runs if run.name not in fit.starts)
    if new:
        fit = replace(fit, starts={**fit.starts, **placed(fit, new).starts})
    ranges = fit.theory.ranges()
    own = {cls.name: next(i for i, r in enumerate(ranges) if r.owner == cls.name) for cls in fit.theory.classes}
    sizes = np.array([fit.theta[own[cls.name]] - neutral_value(cls) for cls in fit.theory.classes])
    if not sizes.all():
        return None
    told = [_told(*each) for each in zip(*_freed(fit, runs, list(own.values())), strict=True)]
    turns, speeds = np.array([run.turn for run in runs]), np.array([np.sqrt(np.mean(run.speed**2)) for run in runs])
    found = []
    for k, cls in enumerate(fit.theory.classes):
        size, spread = (np.array([each[i][k] for each in told]) / abs(sizes[k]) for i in (0, 1))
        drift = _drift(cls.name, np.sign(sizes[k]) * size, spread, turns, speeds) if cls.acts in _LINEAR else None
        if drift and abs(drift.last - drift.first) > settings.drift and drift.p_value < settings.p_value:
            found.append(drift)
    return min(found, key=lambda drift: drift.p_value, default=None)


def _freed(fit: Fit, runs: tuple[FitRun, ...], own: list[int]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Of every run the residual (n,) and what the parameters `own` do to it (n, k), the run's start being free."""
    parts, starts, slopes = tangent(fit, runs)
    bases = [np.linalg.qr(J.T)[0] for J in starts]
    left = [part - Q @ (Q.T @ part) for part, Q in zip(parts, bases, strict=True)]
    does = [J[own].T - Q @ (Q.T @ J[own].T) for J, Q in zip(slopes, bases, strict=True)]
    return left, does


def _told(left: np.ndarray, does: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k,) by how much the parameters are other in this run, and standard deviations; what stirs nothing, endlessly."""
    norm = np.linalg.norm(does, axis=0)
    scale = np.where(norm > 1e-9, norm, 1.0)
    normal = (does / scale).T @ (does / scale)
    inverse = np.linalg.pinv(normal, rcond=1e-8, hermitian=True)
    move = inverse @ ((does / scale).T @ left)
    power = max(1.0, float(np.mean((left - does / scale @ move) ** 2)))
    spread = np.sqrt(power * np.maximum(np.diag(inverse), 1e-12))
    return move / scale, np.where(norm > 1e-9, spread / scale, np.inf)


def _drift(name: str, size: np.ndarray, spread: np.ndarray, turns: np.ndarray, speeds: np.ndarray) -> Drift | None:
    """The line through sizes that runs tell, each by its spread and what they scatter by; far ones count for less."""
    kept = spread < _TOLD
    if kept.sum() < _LEAST_RUNS:
        return None
    y, s = size[kept], spread[kept]
    when, fast = (turns[kept] - turns.min()) / np.ptp(turns), np.log(speeds[kept])
    A = np.stack([np.ones(len(y)), when - 0.5, fast - fast.mean()], 1)
    free, scatter, count = len(y) - A.shape[1], 0.05, np.ones(len(y))
    for _ in range(30):
        weights = count / (s**2 + scatter**2)
        normal = (A.T * weights) @ A
        line = np.linalg.solve(normal + 1e-9 * np.diag(np.diag(normal)), (A.T * weights) @ y)
        off = np.abs(y - A @ line)
        count = np.minimum(1.0, 1.5 * np.sqrt(s**2 + scatter**2) / np.maximum(off, 1e-12))  # Huber's
        scatter = max(_SCATTER, 1.48 * float(np.median(off)) * np.sqrt(len(y) / free))
    t = line[1] / np.sqrt(np.linalg.pinv(normal)[1, 1])
    middle = 1.0 + line[0]
    return Drift(name, middle - 0.5 * line[1], middle + 0.5 * line[1], float(2 * stats.t.sf(abs(t), free)))
