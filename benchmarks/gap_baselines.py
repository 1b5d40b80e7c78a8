"""What else one might do, on the same measured sets: each answers with names, a closed part of the gap, or both.

fit_all     every parameter of every effect at once; the one that explains most has the name (as sysid tools do)
greedy_bic  the effect that helps most, then the next, for as long as BIC falls
stlsq       sparse regression of the missing force (pysindy's sequentially thresholded least squares)
gp          a Gaussian process of the missing force over position, speed and direction: no name, but a ceiling
nothing     the asset as it is
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

Array = NDArray[np.float64]
_MOST_POINTS = 400
_THRESHOLD = 0.15
"""Part of the missing force's spread that a term must make to be kept."""


def answers(folder: str) -> dict[str, Any]:
    """Baseline to {"names", "closed"} for one case; a failure says so and names nothing."""
    from freeart21.files.asset import read_asset
    from freeart21.files.measured import read_measured
    from simgap.fitting.fit import Theory, fitted
    from simgap.fitting.problem import problem_of
    from simgap.measure.data import fit_runs
    from simgap.motion.surrogate import plant_of
    from simgap.workflow import DEFAULTS

    measured = read_measured(Path(folder) / "measured")
    asset = read_asset(Path(folder) / "asset", measured.joint)
    plant = plant_of(asset, measured)
    runs, floor = fit_runs(measured, plant)
    problem = problem_of(plant, measured, runs, floor, DEFAULTS)
    train, test = tuple(r for r in runs if not r.held_out), tuple(r for r in runs if r.held_out)
    base = fitted(Theory(problem, ()), train)
    found: dict[str, Any] = {"nothing": {"names": [], "closed": 0.0}}
    for name, ask in (("fit_all", _fit_all), ("greedy_bic", _greedy), ("stlsq", _stlsq), ("gp", _gp)):
        try:
            found[name] = ask(problem, base, train, test, DEFAULTS)
        except Exception as error:
            found[name] = {"names": [], "closed": None, "failed": f"{type(error).__name__}: {error}"[:300]}
    return found


def _closed(base: Any, fit: Any, test: Any) -> float | None:
    from simgap.fitting.fit import placed

    before, after = _floors(placed(base, test).residuals), _floors(placed(fit, test).residuals)
    return (before - after) / (before - 1) if before > 1.5 else None


def _floors(residuals: dict[str, Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(list(residuals.values())) ** 2)))


def _fit_all(problem: Any, base: Any, train: Any, test: Any, settings: Any) -> dict[str, Any]:
    from simgap.fitting.fit import Theory, fitted, joined
    from simgap.fitting.guess import off
    from simgap.fitting.search import candidates

    names = tuple(n for n in candidates(problem, train) if n != "backlash")  # a body of its own, not a parameter
    theory = Theory(problem, tuple(sorted(names)))
    neutral = {name: off(problem, name) for name in names}
    fit = fitted(theory, train, joined(theory, base, neutral), base.starts, iterations=12)
    ranges, lost = theory.ranges(), {}
    for name in names:
        theta = fit.theta.copy()
        for i, r in enumerate(ranges):
            if r.owner == name:
                theta[i] = neutral[name][r.name]
        without = fitted(theory, train, theta, fit.starts, iterations=1, free=False)
        lost[name] = without.rss - fit.rss
    return {"names": [max(lost, key=lambda n: lost[n])], "closed": _closed(base, fit, test)}


def _greedy(problem: Any, base: Any, train: Any, test: Any, settings: Any) -> dict[str, Any]:
    from simgap.fitting.search import Search, candidates

    search = Search(problem, train, settings.search, candidates(problem, train))
    n = sum(len(run.q) for run in train)

    def bic(fit: Any) -> float:
        return float(fit.cost + len(fit.theta) * np.log(n))

    now = search.base()
    following = search.singles()[:1]
    while following and bic(following[0]) < bic(now):
        now = following[0]
        if len(now.theory.names) == settings.search.max_effects:
            break
        following = sorted(search.larger([now]), key=lambda fit: fit.cost)[:1]
    return {"names": list(now.theory.names), "closed": _closed(base, now, test)}


def _true(problem: Any, base: Any) -> tuple[float, Array]:
    """Inertia, and gravity's parts of cos q, of sin q and constant (3,), as far as the asset may be off by them."""
    from simgap.fitting.fit import Reader
    from simgap.motion.surrogate import kernel, numbers_of

    numbers = numbers_of(problem.plant, problem.plant.effects, Reader(base.theory).nuisance(base.theta))
    return float(numbers[kernel.INERTIA]), numbers[kernel.GRAVITY_COS : kernel.GRAVITY_CONST + 1]


def _missing(problem: Any, base: Any, run: Any) -> Array:
    """(4, n) smoothed position, speed and acceleration, and the force that the asset lacks by them: equation error."""
    times = run.times_s
    even = np.arange(times[0], times[-1], float(np.median(np.diff(times))))
    q = np.interp(even, times, run.q)
    step = even[1] - even[0]
    window = max(7, 2 * int(0.06 / step) + 1)
    smooth, speed, bend = (savgol_filter(q, window, 3, d, step) for d in (0, 1, 2))
    inertia, gravity = _true(problem, base)
    force = gravity[0] * np.cos(smooth) + gravity[1] * np.sin(smooth) + gravity[2]
    inputs, plant = run.inputs, problem.plant
    if len(inputs.times_s):
        at = np.clip(np.searchsorted(inputs.times_s, even, side="right") - 1, 0, None)
        servo = plant.stiffness * (inputs.command[at] - smooth) - plant.damping * speed
        force += inputs.push[at] + inputs.effort[at] + np.where(np.isfinite(inputs.command[at]), servo, 0.0)
    return np.array([smooth, speed, bend, inertia * bend - force - _own(plant, smooth, speed)])


def _own(plant: Any, q: Array, speed: Array) -> Array:
    """Force of the losses that the asset knows."""
    return np.asarray(
        sum((e.force(q, speed) - np.sign(speed) * e.drive_limit(q, speed) for e in plant.effects), 0.0 * q)
    )


def _collected(problem: Any, base: Any, runs: Any) -> Array:
    """(4, n) of all runs, away from the limits, where impacts would be forces."""
    found = np.concatenate([_missing(problem, base, run) for run in runs], axis=1)
    room = 0.03 * (problem.q_high - problem.q_low)
    return found[:, (found[0] > problem.plant.lower + room) & (found[0] < problem.plant.upper - room)]


def _stlsq(problem: Any, base: Any, train: Any, test: Any, settings: Any) -> dict[str, Any]:
    """Names of the terms that stay."""
    import pysindy

    q, speed, bend, force = _collected(problem, base, train)
    middle, half = 0.5 * (problem.q_low + problem.q_high), 0.5 * (problem.q_high - problem.q_low)
    terms = {
        "viscous_damping": speed,
        "coulomb_friction": np.tanh(speed / (0.01 * problem.speed)),
        "quadratic_drag": speed * np.abs(speed),
        "return_spring": (q - middle) / half,
        "gravity_offset": np.cos(q) if problem.plant.joint_type == "revolute" else np.ones(len(q)),
        "gravity_offset ": np.sin(q) if problem.plant.joint_type == "revolute" else np.zeros(len(q)),
        "armature": bend,
    }
    columns = np.column_stack(list(terms.values()))
    scale = np.sqrt((columns**2).mean(0))
    kept = scale > 1e-12
    model = pysindy.STLSQ(threshold=_THRESHOLD, alpha=1e-3, normalize_columns=False)
    model.fit(columns[:, kept] / scale[kept], (force / max(force.std(), 1e-12))[:, None])
    names = np.array(list(terms))[kept][np.abs(np.ravel(model.coef_)) > 0]
    return {"names": sorted({str(n).strip() for n in names}), "closed": None}


@njit(cache=True)
def _swing(y0, y1, times, inputs, numbers, lower, upper, grid_q, grid_v, grid, out):
    """Positions at `times` with the missing force from a table; steps of 2 ms at most, dead stops."""
    inertia, gc, gs, g1, kp, kd = numbers
    q, v = y0, y1
    out[0] = q
    k = 0
    for i in range(1, len(times)):
        steps = max(1, int(np.ceil((times[i] - times[i - 1]) / 0.002)))
        h = (times[i] - times[i - 1]) / steps
        for s in range(steps):
            t = times[i - 1] + (s + 0.5) * h
            force = gc * np.cos(q) + gs * np.sin(q) + g1
            if inputs.shape[1] > 0:
                while k + 1 < inputs.shape[1] and inputs[0, k + 1] <= t:
                    k += 1
                force += inputs[2, k]
                if inputs[1, k] == inputs[1, k]:
                    force += kp * (inputs[1, k] - q) - kd * v
            a = (q - grid_q[0]) / (grid_q[1] - grid_q[0])
            b = (v - grid_v[0]) / (grid_v[1] - grid_v[0])
            a, b = min(max(a, 0.0), len(grid_q) - 1.001), min(max(b, 0.0), len(grid_v) - 1.001)
            ia, ib = int(a), int(b)
            a, b = a - ia, b - ib
            force += (1 - a) * ((1 - b) * grid[ia, ib] + b * grid[ia, ib + 1])
            force += a * ((1 - b) * grid[ia + 1, ib] + b * grid[ia + 1, ib + 1])
            v += h * force / inertia
            q += h * v
            if q < lower:
                q, v = lower, max(v, 0.0)
            elif q > upper:
                q, v = upper, min(v, 0.0)
        out[i] = q


def _gp(problem: Any, base: Any, train: Any, test: Any, settings: Any) -> dict[str, Any]:
    """How much of the held-out gap a nameless force over position and speed closes."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    from simgap.fitting.fit import placed

    q, speed, _, force = _collected(problem, base, train)
    chosen = np.random.default_rng(0).permutation(len(q))[:_MOST_POINTS]
    size = max(float(force.std()), 1e-12)
    qs, vs = problem.q_high - problem.q_low, problem.speed

    def seen(q: Array, v: Array) -> Array:
        return np.column_stack([q / qs, v / vs, np.tanh(v / (0.02 * vs))])

    kernel = ConstantKernel(1.0) * RBF([0.5, 0.5, 1.0]) + WhiteKernel(0.1)
    model = GaussianProcessRegressor(kernel, n_restarts_optimizer=0, random_state=0)
    model.fit(seen(q[chosen], speed[chosen]), force[chosen] / size)
    grid_q = np.linspace(problem.q_low, problem.q_high, 41)
    grid_v = np.linspace(-1.2 * vs, 1.2 * vs, 121)
    at_q, at_v = np.meshgrid(grid_q, grid_v, indexing="ij")
    grid = size * model.predict(seen(at_q.ravel(), at_v.ravel())).reshape(at_q.shape)
    plant = problem.plant
    grid += _own(plant, at_q, at_v)
    inertia, gravity = _true(problem, base)
    numbers = np.array([inertia, *gravity, plant.stiffness, plant.damping])
    start = placed(base, test)
    residuals = {}
    for run in test:
        given = run.inputs
        inputs = np.array([given.times_s, given.command, given.effort + given.push]).reshape(3, -1)

        def left(y: Array, run: Any = run, inputs: Array = inputs) -> Array:
            out = np.empty(len(run.q))
            _swing(y[0], y[1], run.times_s, inputs, numbers, plant.lower, plant.upper, grid_q, grid_v, grid, out)
            return np.asarray((run.q - out) / run.sigma)

        first = np.array(start.starts[run.name])
        low, high = [plant.lower - 1e-9, -np.inf], [plant.upper + 1e-9, np.inf]
        found = least_squares(left, np.clip(first, low, high), bounds=(low, high), x_scale=[qs, vs], max_nfev=12)
        residuals[run.name] = left(found.x)
    before, after = _floors(start.residuals), _floors(residuals)
    return {"names": [], "closed": (before - after) / (before - 1) if before > 1.5 else None}


def summary(answers: dict[str, Any], rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Baseline to its figures; ours on the very same cases beside it."""
    by = {row["id"]: row for row in rows}
    found: dict[str, dict[str, Any]] = {}

    def figures(names: dict[str, list[str]], closed: dict[str, float | None]) -> dict[str, Any]:
        named = [i for i in names if by[i]["stratum"] in ("single", "pair") and by[i]["strength"] == "clear"]
        none = [i for i in names if by[i]["stratum"] in ("null", "strange")]
        parts = [closed[i] for i in named if closed[i] is not None]
        return {
            "cases": len(names),
            "right": np.mean([sorted(names[i]) == sorted(by[i]["truth"]) for i in named]) if named else None,
            "false_names": np.mean([bool(names[i]) for i in none]) if none else None,
            "closed_fraction_median": float(np.median(parts)) if parts else None,
        }

    for name in next(iter(answers.values()), {}):
        found[name] = figures(
            {i: a[name]["names"] for i, a in answers.items()}, {i: a[name]["closed"] for i, a in answers.items()}
        )
        found[name]["failed"] = sum("failed" in a[name] for a in answers.values())
    ours = {i: list(by[i]["said"]) if by[i]["verdict"] == "named" else [] for i in answers}
    found["this workflow"] = figures(ours, {i: by[i]["closed_same"] for i in answers})
    return found
