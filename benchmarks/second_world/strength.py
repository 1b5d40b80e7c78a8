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

READINGS = 250  # of a run that are looked at
ROUNDS = 6  # of Gauss and Newton; 8 cases were within 3 % of their last after 4
COARSE = 5e-4  # s a step where nothing is quick
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
    weight and lean within what the asset is told to be right to, take up (least squares within bounds, from the truth on)."""
    from scipy.optimize import lsq_linear

    p1, s1 = hidden(machine, nuisance, effects)
    runs = [_thinned(run) for run in plan.runs]
    still = [np.zeros(len(run.times)) for run in runs]
    full, speed = zip(*(clean(p1, s1, r, plan, z, longest(p1)) for r, z in zip(runs, still, strict=True)), strict=True)
    sigma = [math.hypot(encoder.sigma, STAMP * float(np.sqrt(np.mean(v**2)))) for v in speed]
    told = 0.05 if machine.slides else 0.1
    room = np.array([[-told, told], [-0.05, 0.05], [-LEAN, LEAN]]) - np.array(
        [[nuisance.inertia], [nuisance.weight], [0.0]]
    )
    steps = np.array([2e-3, 2e-3, 5e-4])
    shared, starts = np.zeros(3), np.array([run.start for run in runs])

    def motion(shared: np.ndarray, starts: np.ndarray, i: int) -> np.ndarray:
        p, s = hidden(machine, _moved(machine, nuisance, shared), others)
        finest = longest(p) if p[w.TRAVEL] > 0 or p[w.ROTOR] > 0 or p[w.STOP_K] > 0 else COARSE
        moved = replace(runs[i], start=(float(starts[i, 0]), float(starts[i, 1])))
        return clean(p, s, moved, plan, still[i], finest)[0]

    best = math.inf
    for _ in range(ROUNDS):  # Gauss and Newton: a swing's phase is far from linear in what shifts it
        base = [motion(shared, starts, i) for i in range(len(runs))]
        left = np.concatenate([(f - b) / s for f, b, s in zip(full, base, sigma, strict=True)])
        now = float(np.sqrt(np.mean(left**2)))
        if now > 0.97 * best:
            return min(now, best)
        best = now
        columns = np.zeros((len(left), 3 + 2 * len(runs)))
        row = 0
        for i, b in enumerate(base):
            part = slice(row, row + len(b))
            row += len(b)
            for k in range(3):
                nudged = shared + steps * (np.arange(3) == k)
                columns[part, k] = (motion(nudged, starts, i) - b) / steps[k] / sigma[i]
            for k in range(2):
                nudge = 1e-4 if k == 0 else 1e-4 * machine.omega
                moved = starts.copy()
                moved[i, k] += nudge
                columns[part, 3 + 2 * i + k] = (motion(shared, moved, i) - b) / nudge / sigma[i]
        low, high = np.full(columns.shape[1], -np.inf), np.full(columns.shape[1], np.inf)
        low[:3], high[:3] = room[:, 0] - shared - 1e-9, room[:, 1] - shared + 1e-9
        found = lsq_linear(columns, left, (low, high), tol=1e-8).x
        shared, starts = shared + found[:3], starts + found[3:].reshape(-1, 2)
    return best


def _moved(machine: Machine, nuisance: Nuisance, shared: np.ndarray) -> Nuisance:
    inertia, weight, lean = shared
    a, b = nuisance.tilt
    tilt = (a + lean, b) if machine.kind == "door" else (a, b + lean)
    return Nuisance(nuisance.inertia + inertia, nuisance.weight + weight, tilt)


def _thinned(run: Run) -> Run:
    keep = np.unique(np.linspace(0, len(run.stamps) - 1, READINGS).astype(int))
    return replace(run, stamps=run.stamps[keep], lost=run.lost[keep])
