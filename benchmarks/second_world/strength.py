"""How much of an effect the runs show that nothing known to be off about the machine can take up: in floors of the
sensor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.second_world import laws as w
from benchmarks.second_world.hidden import Effect, Sensing, apply, longest
from benchmarks.second_world.machines import Machine, Nuisance, truth
from benchmarks.second_world.protocols import Plan, Run
from benchmarks.second_world.sensor import STAMP, Encoder, clean

READINGS = 250  # of a run that are looked at
ROUNDS = 6  # of Gauss and Newton; most end after 3, when one gains less than 3 %
COARSE = 4e-4  # s a step where nothing is quick
LEAN = math.radians(0.4)  # by which a base may stand off unseen; machines do by .3
SIDEWAYS = 0.05  # rad: a weight whose torque is told to be right to 5 % may have its centre so far aside, too


def hidden(machine: Machine, nuisance: Nuisance, effects: list[Effect]) -> tuple[np.ndarray, Sensing]:
    """The real machine with these effects."""
    p, sensing = truth(machine, nuisance), Sensing()
    for effect in effects:
        p, sensing = apply(effect, machine, p, sensing)
    return p, sensing


def strength(
    machine: Machine,
    nuisance: Nuisance,
    plan: Plan,
    encoder: Encoder,
    effects: list[Effect],
    others: list[Effect],
    least: float = 0.0,
) -> float:
    """Root mean square over all readings, in floors, of what `effects` do beyond the best that `others` can, whatever
    their sizes, less what start states, and inertia, weight and lean within what the asset is told to be right to,
    take up: least squares within bounds by Gauss and Newton, from the truth on. Given up below `least`."""
    p1, s1 = hidden(machine, nuisance, effects)
    runs = [_thinned(run) for run in plan.runs][:: 2 if others else 1]  # half of them is as telling
    still = [np.zeros(len(run.times)) for run in runs]
    full, speed = zip(*(clean(p1, s1, r, plan, z, longest(p1)) for r, z in zip(runs, still, strict=True)), strict=True)
    sigma = [math.hypot(encoder.sigma, STAMP * float(np.sqrt(np.mean(v**2)))) for v in speed]
    steps = np.array([2e-3, 2e-3, 5e-4] + [0.02] * len(others))
    told = 0.05 if machine.slides else 0.1
    lean = LEAN if machine.kind in ("door", "drawer") else LEAN + SIDEWAYS
    room = np.array([[-told, told], [-0.05, 0.05], [-lean, lean], *([[-0.9, 4.0]] * len(others))])
    room[:2] -= np.array([[nuisance.inertia], [nuisance.weight]])

    def errors(shared: np.ndarray, starts: np.ndarray, i: int) -> np.ndarray:
        sized = [replace(o, size=o.size * (1 + x)) for o, x in zip(others, shared[3:], strict=True)]
        p, s = hidden(machine, _moved(machine, nuisance, shared), sized)
        moved = replace(runs[i], start=(float(starts[i, 0]), float(starts[i, 1])))
        return (
            full[i]
            - clean(p, s, moved, plan, still[i], min(4 * longest(p), COARSE) if not _stiff(p) else longest(p))[0]
        ) / sigma[i]

    def everywhere(shared: np.ndarray, starts: np.ndarray) -> list[np.ndarray]:
        return [errors(shared, starts, i) for i in range(len(runs))]

    shared, starts = np.zeros(len(steps)), np.array([run.start for run in runs])
    left = everywhere(shared, starts)
    best = _rms(left)
    for _ in range(ROUNDS):
        if best < least:
            return best
        step = _step(errors, shared, starts, left, steps, room, 1e-4 * machine.omega)
        for share in (1.0, 0.4, 0.1):
            now = everywhere(shared + share * step[0], starts + share * step[1])
            if _rms(now) < best:
                break
        if _rms(now) > 0.97 * best:
            return min(best, _rms(now))
        shared, starts, left, best = shared + share * step[0], starts + share * step[1], now, _rms(now)
    return best


def _stiff(p: np.ndarray) -> bool:
    """Teeth and stops need their fine step; bristles bear four of them (their rate is below 8,000 / s)."""
    return bool(p[w.ROTOR] > 0 or p[w.STOP_K] > 0)


def _rms(parts: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def _step(
    errors: Callable[[np.ndarray, np.ndarray, int], np.ndarray],
    shared: np.ndarray,
    starts: np.ndarray,
    left: list[np.ndarray],
    steps: np.ndarray,
    room: np.ndarray,
    fast: float,
) -> tuple[np.ndarray, np.ndarray]:
    """One step of Gauss and Newton, by differences, of what all runs share and of their starts."""
    from scipy.optimize import lsq_linear

    n = len(steps)
    columns = np.zeros((sum(len(x) for x in left), n + 2 * len(left)))
    row = 0
    for i, now in enumerate(left):
        part = slice(row, row + len(now))
        row += len(now)
        for k in range(n):
            nudged = shared + steps * (np.arange(n) == k)
            columns[part, k] = (now - errors(nudged, starts, i)) / steps[k]
        for k, nudge in enumerate((1e-4, fast)):
            moved = starts.copy()
            moved[i, k] += nudge
            columns[part, n + 2 * i + k] = (now - errors(shared, moved, i)) / nudge
    low, high = np.full(columns.shape[1], -np.inf), np.full(columns.shape[1], np.inf)
    low[:n], high[:n] = room[:, 0] - shared - 1e-9, room[:, 1] - shared + 1e-9
    found = lsq_linear(columns, np.concatenate(left), (low, high), tol=1e-8).x
    return found[:n], found[n:].reshape(-1, 2)


def _moved(machine: Machine, nuisance: Nuisance, shared: np.ndarray) -> Nuisance:
    inertia, weight, lean = shared[:3]
    a, b = nuisance.tilt
    tilt = (a + lean, b) if machine.kind == "door" else (a, b + lean)
    return Nuisance(nuisance.inertia + inertia, nuisance.weight + weight, tilt)


def _thinned(run: Run) -> Run:
    keep = np.unique(np.linspace(0, len(run.stamps) - 1, READINGS).astype(int))
    return replace(run, stamps=run.stamps[keep], lost=run.lost[keep])
