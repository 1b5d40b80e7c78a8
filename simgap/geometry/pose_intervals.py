"""90 % intervals of kinematic effects' parameters, with dependent frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21.effects import EFFECTS
from freeart21.se3 import Array
from simgap.geometry.pose_model import Geometry, Linear, Weighting, normal_equations, rocking_effect
from simgap.verdict import NamedEffect


def intervals(lin: Linear, point: Geometry, weighting: Weighting, units: NDArray[np.int64]) -> list[NamedEffect]:
    """Every effect of `point`, outermost displacement first, with its interval.

    Covariance by the sandwich estimator with scores summed over half swings `units` (n,) (Liang and Zeger 1986), plus
    the registration's prior.
    """
    from scipy.stats import t as student

    columns, k = lin.columns, len(point.values)
    data = lin.residual(point)
    if point.rock is not None:
        rocking, derivatives = _rocking(lin, point)
        data, columns = data - rocking, np.concatenate([columns, derivatives], -1)
    A, _ = normal_equations(columns, data)
    prior = np.concatenate([weighting.priors(point.names), np.zeros(columns.shape[-1] - k - 6)])
    scores = np.zeros((int(units.max()) + 1, columns.shape[-1]))
    np.add.at(scores, units, np.einsum("nij,ni->nj", columns, data))
    n = len(scores)
    meat = scores.T @ scores * n / max(n - 1, 1)
    meat[range(k, k + 6), range(k, k + 6)] += weighting.correlation * weighting.registration_precision
    bread = np.linalg.inv(A + np.diag(prior) + 1e-12 * np.trace(A) * np.eye(len(A)))
    covariance = bread @ meat @ bread
    reach = float(student.ppf(0.95, max(n - 1, 1)))
    found, at = [], 0
    if point.rock is not None:
        rocks = rocking_effect(point.rock)
        spread = reach * np.sqrt(np.maximum(np.diag(covariance)[k + 6 :], 0.0))
        ends = dict(zip(("amplitude", "direction", "frequency", "phase"), spread.tolist(), strict=False))
        low, high = ({name: getattr(rocks, name) + sign * e for name, e in ends.items()} for sign in (-1, 1))
        low["amplitude"] = max(low["amplitude"], 0.0)
        found.append(NamedEffect(rocks, low, high))
    for effect, (name, values) in zip(point.effects(), point.split(), strict=True):
        block = covariance[at : at + len(values), at : at + len(values)]
        at += len(values)
        change = np.eye(len(values))
        if EFFECTS[name].polar:  # from length * (cos, sin) to length and angle
            size = max(float(np.hypot(*values)), 1e-12)
            change = np.array([values / size, [-values[1] / size**2, values[0] / size**2]])
        errors = reach * np.sqrt(np.maximum(np.diag(change @ block @ change.T), 0.0))
        centres, specs = effect.values(), effect.parameters()
        low = {n: max(c - float(e), specs[n].lower) for n, c, e in zip(specs, centres, errors, strict=True)}
        high = {n: c + float(e) for n, c, e in zip(specs, centres, errors, strict=True)}
        found.append(NamedEffect(effect, low, high))
    return found


def _rocking(lin: Linear, point: Geometry) -> tuple[Array, Array]:
    """(n, 6) twist of the rocking, and (n, 6, 3 + runs) derivatives by amplitude, direction, frequency, every phase."""
    rock = point.rock
    assert rock is not None
    angles, turned = (rock.angles(lin.run, lin.times_s, ahead) for ahead in (False, True))
    size = float(np.sqrt((rock.coefficients**2).sum((1, 2)).mean())) or 1.0
    across = np.stack([-angles[:, 1], angles[:, 0]], -1)
    parts = [angles / size, across, turned * (2 * np.pi * lin.times_s)[:, None]]
    parts += [turned * (lin.run == r)[:, None] for r in range(len(rock.coefficients))]
    directions = np.stack(parts, -1)  # (n, 2, 3 + runs)
    return (lin.rocks @ angles[..., None])[..., 0], lin.rocks @ directions
