"""How much of an effect the runs show that nothing known to be off about the machine can take up: in floors of the sensor."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from benchmarks.second_world import laws as w
from benchmarks.second_world.hidden import Effect, Sensing, apply, longest
from benchmarks.second_world.machines import Machine, Nuisance, truth
from benchmarks.second_world.protocols import Plan, Run
from benchmarks.second_world.sensor import STAMP, Encoder, clean

READINGS = 250  # of a run that are looked at; a tenth of a per cent of the figure (8 cases, against all of them)
LEAN = math.radians(0.4)  # by which a base may stand off unseen; machines do by .3


def hidden(machine: Machine, nuisance: Nuisance, effects: list[Effect]) -> tuple[np.ndarray, Sensing]:
    """The real machine with these effects."""
    p, sensing = truth(machine, nuisance), Sensing()
    for effect in effects:
        p, sensing = apply(effect, machine, p, sensing)
    return p, sensing


def strength(
    machine: Machine, nuisance: Nuisance, plan: Plan, encoder: Encoder, effects: list[Effect], others: list[Effect]
) -> float:
    """Root mean square over all readings, in floors, of what `effects` do beyond `others`, less what start states, and inertia,
    weight and lean within what the asset is told to be right to, take up (linear least squares within bounds)."""
    from scipy.optimize import lsq_linear

    p1, s1 = hidden(machine, nuisance, effects)
    p0, s0 = hidden(machine, nuisance, others)
    finest = max(longest(p0), 1e-4 if p0[w.TRAVEL] == 0 else 0.0)
    told = 0.05 if machine.slides else 0.1
    room = np.array(
        [
            [-told - nuisance.inertia, told - nuisance.inertia],
            [-0.05 - nuisance.weight, 0.05 - nuisance.weight],
            [-LEAN, LEAN],
        ]
    )
    steps = (0.01, 0.01, 2e-3)
    moved = (
        replace(nuisance, inertia=nuisance.inertia + steps[0]),
        replace(nuisance, weight=nuisance.weight + steps[1]),
        replace(nuisance, tilt=_leaning(machine, nuisance, steps[2])),
    )
    variants = [hidden(machine, n, others)[0] for n in moved]
    left, columns = [], []
    for i, run in enumerate(plan.runs):
        few = _thinned(run)
        still = np.zeros(len(run.times))
        base, speed = clean(p0, s0, few, plan, still, finest)
        full, _ = clean(p1, s1, few, plan, still, longest(p1))
        sigma = math.hypot(encoder.sigma, STAMP * float(np.sqrt(np.mean(speed**2))))
        block = np.zeros((len(base), 3 + 2 * len(plan.runs)))
        for k, (p, step) in enumerate(zip(variants, steps, strict=True)):
            block[:, k] = (clean(p, s0, few, plan, still, finest)[0] - base) / step
        for k in range(2):
            nudge = 1e-3 if k == 0 else 1e-3 * machine.omega
            q, v = run.start
            start = (q + nudge, v) if k == 0 else (q, v + nudge)
            block[:, 3 + 2 * i + k] = (clean(p0, s0, replace(few, start=start), plan, still, finest)[0] - base) / nudge
        left.append((full - base) / sigma)
        columns.append(block / sigma)
    a, b = np.concatenate(columns), np.concatenate(left)
    bounds = np.full((a.shape[1], 2), [-np.inf, np.inf])
    bounds[:3] = room
    free = lsq_linear(a, b, (bounds[:, 0] - 1e-9, bounds[:, 1] + 1e-9), method="trf", tol=1e-6)
    return float(np.sqrt(np.mean((b - a @ free.x) ** 2)))


def _leaning(machine: Machine, nuisance: Nuisance, angle: float) -> tuple[float, float]:
    a, b = nuisance.tilt
    return (a + angle, b) if machine.kind == "door" else (a, b + angle)


def _thinned(run: Run) -> Run:
    keep = np.unique(np.linspace(0, len(run.stamps) - 1, READINGS).astype(int))
    return replace(run, stamps=run.stamps[keep], lost=run.lost[keep])
