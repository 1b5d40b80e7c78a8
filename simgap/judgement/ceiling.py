"""How much of what an explanation leaves a force without a name would explain: the ceiling of any explanation.

The force may be any function of position, and any friction besides, to first order about the explanation, on the runs
that it was fitted to: thousands of readings tell some tens of numbers. Where it does much better, the explanation has
the wrong name, or not all of them (Brynjarsdottir and O'Hagan 2014: a discrepancy without a name names nothing).
"""

from __future__ import annotations

import numpy as np

from simgap.fitting.fit import Fit
from simgap.fitting.guess import Linear
from simgap.measure.data import FitRun

_FREE = ("coulomb_friction", "detent", "quadratic_drag", "return_spring", "stribeck_friction", "viscous_damping")
"""Effects whose forces at all places and speeds together make about any force."""


def ceiling(fit: Fit, runs: tuple[FitRun, ...], weights: dict[str, float]) -> float:
    """Floors that a free force beside the fit would leave of runs that it was fitted to, each by its weight."""
    linear = Linear(fit, runs, weights)
    names = [name for name in _FREE if name not in fit.theory.names]
    columns = np.concatenate([linear.rest, *(linear.columns(name) for name in names)])
    size = np.linalg.norm(columns, axis=1)
    columns = columns[size > 1e-9] / size[size > 1e-9, None]
    told = linear.freed
    ridge = len(columns) / max(float(told @ told), 1e-12)  # each of them as large as all that is left, at most
    normal = columns @ columns.T + ridge * np.eye(len(columns))
    left = told - np.linalg.solve(normal, columns @ told) @ columns
    taken = len(columns) - ridge * np.trace(np.linalg.inv(normal))  # degrees of freedom
    return float(np.sqrt(left @ left / max(len(told) - taken, 1.0)))
