"""Equation error: the force that measured accelerations require beyond the asset's equation of motion.

Smoothed derivatives make it biased and noisy (errors in regressors). It shows where simulation and measurement differ,
and never decides which effect is named.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from freeart21.base_motion import base_motion_force
from freeart21.effects.base import Effect
from freeart21.measured import Measured, Run
from freeart21.mechanics import DriveLaw, JointMechanics
from freeart21.se3 import Array
from simgap.measure.inputs import base_force_of, enabled_at, logged_at, split_efforts
from simgap.measure.swings import reversals, unit_numbers
from simgap.models.surrogate import Plant

_ORDER = 4  # of the local polynomials
_SHORTEST = 7  # readings of a window
_LONGEST = 501  # readings of one: scipy's coefficients lose precision beyond (with 3,333 accelerations were 20-fold)
_WINDOWS_PER_HALF_SWING = 6  # wider blurs, narrower adds noise with power 2.5
_IMPACT_READINGS = (5, 12)  # fewest and most on either side of an impact


@dataclass(frozen=True)
class MissingForce:
    """Samples of all runs in a row, those in contact with a limit excluded; (n,) each."""

    force: Array
    """N*m or N that the measured motion requires beyond the simulated equation."""
    inertia: float
    """kg*m^2 or kg."""
    q: Array
    """Smoothed position, rad or m."""
    qd: Array
    """Smoothed velocity."""
    time_s: Array
    """Since the start of the run."""
    run: NDArray[np.int64]
    """Number of the run."""
    unit: NDArray[np.int64]
    """Number of the half swing, over all runs."""
    since_reversal: Array
    """Distance since the last reversal, rad or m; NaN before the first."""
    to_limit: Array
    """Distance to the nearer limit; inf without any."""
    command: Array
    """Commanded position less position; NaN without any."""
    run_names: tuple[str, ...]
    impacts: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3) of every impact at a limit: which (-1 or 1), speed before, rebound speed."""


def estimate_missing_force(
    measured: Measured,
    mechanics: JointMechanics,
    lower: float,
    upper: float,
    effects: tuple[Effect, ...] = (),
    runs: tuple[Run, ...] | None = None,
    plant: Plant | None = None,
) -> MissingForce:
    """The force that the asset's equation lacks, with `effects` acting.

    Args:
        measured: circumstances; inertia and gravity are scaled within their uncertainty to the best fit.
        mechanics: the joint's, with the gravity of the recording.
        lower: limit, rad or m.
        upper: limit.
        effects: those in the simulation.
        runs: to use; None for all that are not held out. Their `q` must be known.
        plant: for runs with base motion.
    """
    runs = tuple(r for r in measured.runs if not r.held_out) if runs is None else runs
    pieces, impacts, how = [], [], measured.interpolation
    for index, run in enumerate(runs):
        smooth = smooth_run(run)
        if smooth is None:
            continue
        t, raw, q, qd, qdd, kernel = smooth
        half = len(kernel) // 2 + 1
        # the contact force at a stop is unknown
        touching = _is_near_limit(q, lower, upper)
        near = np.convolve(touching, np.ones(2 * half + 1), "same") > 0
        impacts += _find_impacts(t, raw, touching)
        acting = model_forces(measured, mechanics, run, effects, t, q, qd, qdd)
        if run.base is not None and plant is not None:
            acting = acting[0] + base_motion_force(base_force_of(run, measured, plant).at(t), q), acting[1]
        given, gravity = (np.convolve(force, kernel, "same") for force in acting)  # smoothed as qdd
        since = _distance_since_reversal(q)
        command = (
            np.full(len(t), np.nan) if run.q_command is None else logged_at(run.times_s, run.q_command, how, t) - q
        )
        columns = [t - run.times_s[0], q, qd, qdd, given, gravity, since, command, np.full(len(t), float(index))]
        keep = ~near
        keep[:half], keep[len(keep) - half :] = False, False  # one-sided windows
        pieces.append(np.stack(columns, -1)[keep])
    rows = np.concatenate(pieces) if pieces else np.zeros((0, 9))
    time, q, qd, qdd, given, gravity, since, command, number = rows.T
    inertia = mechanics.inertia + float(np.sum([e.added_inertia() for e in effects]))
    a, g = _fit_scales(measured, inertia, q, qd, qdd, given, gravity)
    of_run = np.asarray(number, np.int64)
    unit = unit_numbers(q, of_run, 0.03 * float(np.ptp(q)), max(10, len(q) // 60)) if len(q) else of_run
    return MissingForce(
        a * inertia * qdd - given - g * gravity,
        a * inertia,
        q,
        qd,
        time,
        of_run,
        unit,
        since,
        np.minimum(q - lower, upper - q),
        command,
        tuple(r.name for r in runs),
        np.array(impacts).reshape(-1, 3),
    )


def smooth_run(run: Run, window: int | None = None) -> tuple[Array, Array, Array, Array, Array, Array] | None:
    """Even times; position as read, smoothed position, velocity, acceleration; and the smoothing kernel of the
    acceleration. None for too short a run.

    `window` is in readings; None for the longest that half swings allow. A local polynomial's second derivative
    (Savitzky and Golay 1964) is exactly the true acceleration convolved with a kernel; forces convolved with it have
    the same bias.
    """
    from scipy.signal import savgol_coeffs, savgol_filter

    known = np.isfinite(run.q)
    if known.sum() < 4 * _SHORTEST:
        return None
    step = float(np.median(np.diff(run.times_s[known])))
    t = np.arange(run.times_s[known][0], run.times_s[known][-1], step)
    raw = np.interp(t, run.times_s[known], run.q[known])
    if window is None:
        turns = len(reversals(raw, 0.1 * float(np.ptp(raw))))
        window = int(len(raw) / max(turns, 1) / _WINDOWS_PER_HALF_SWING) // 2 * 2 + 1
    window = min(max(window, _SHORTEST), _LONGEST, len(raw) // 4 * 2 - 1)
    # remove the trend: with wide windows scipy's coefficients are too imprecise for it
    trend = np.polynomial.Polynomial.fit(t, raw, 2)
    rest = raw - trend(t)
    filtered = [savgol_filter(rest, window, _ORDER, deriv=k, delta=step) for k in range(3)]
    q, qd, qdd = (own + (trend.deriv(k) if k else trend)(t) for k, own in enumerate(filtered))
    kernel = np.cumsum(np.cumsum(savgol_coeffs(window, _ORDER, deriv=2)))[:-2]  # the filter is its second difference
    return t, raw, q, qd, qdd, np.convolve(kernel, [1 / 12, 10 / 12, 1 / 12])


def model_forces(
    measured: Measured,
    mechanics: JointMechanics,
    run: Run,
    effects: tuple[Effect, ...],
    t: Array,
    q: Array,
    qd: Array,
    qdd: Array,
) -> tuple[Array, Array]:
    """(n,) modelled forces without gravity, and gravity."""
    gain = float(np.prod([e.gain() for e in effects]))
    late = float(np.sum([e.delay() for e in effects if e.acts == "command"]))
    acting, drive, how = np.zeros(len(t)), np.zeros(len(t)), measured.interpolation
    effort, push = split_efforts(run, measured)
    on = enabled_at(run, t - late, effort is not None)
    if on.any():
        law = DriveLaw() if measured.actuator is None else measured.actuator.law
        commands, efforts = (
            other if values is None else logged_at(run.times_s, values, how, t - late)
            for values, other in ((run.q_command, np.full(len(t), np.nan)), (effort, np.zeros(len(t))))
        )
        given = gain * law.forces(q, qd, commands, efforts) + float(np.sum([e.bias_force() for e in effects]))
        drive += np.where(on, given, 0.0)
    if push is not None:
        acting += logged_at(run.times_s, push, how, t)
    for effect in effects:
        if effect.acts == "force":
            memory: float | Array = 0.0
            if type(effect).remember is not Effect.remember:
                memory, now = np.zeros(len(q)), 0.0
                for i, at in enumerate(q):
                    now = memory[i] = float(effect.remember(at, now, *effect.values()))
            acting += effect.force(q, qd, t, memory)
    gravity = np.asarray(mechanics.gravity_force(q))
    level, load, carried = np.zeros(len(t)), mechanics.load(q, qd, qdd), np.abs(drive - acting - gravity)
    for effect in effects:
        level += effect.drive_limit(q, qd, carried if effect.geared else load)
    return acting + drive - level * np.sign(qd), gravity


def _fit_scales(
    measured: Measured, inertia: float, q: Array, qd: Array, qdd: Array, given: Array, gravity: Array
) -> tuple[float, float]:
    """Scales of inertia and gravity within their uncertainty, with free smooth losses."""
    from scipy.optimize import lsq_linear

    reach = measured.inertia_relative, measured.gravity_relative
    if len(q) < 20 or max(reach) == 0:
        return 1.0, 1.0
    rest = np.stack([np.ones_like(q), qd, np.sign(qd), qd * np.abs(qd)], -1)
    columns = np.concatenate([(inertia * qdd)[:, None], -gravity[:, None], rest], -1)
    size = np.maximum(np.abs(columns).max(0), 1e-12)
    free = np.full(rest.shape[1], np.inf)
    low = np.concatenate([[1 - reach[0] - 1e-9, 1 - reach[1] - 1e-9], -free]) * size
    high = np.concatenate([[1 + reach[0] + 1e-9, 1 + reach[1] + 1e-9], free]) * size
    found = lsq_linear(columns / size, given, (low, high)).x / size
    if np.ptp(gravity) < 1e-9 * max(float(np.abs(gravity).max()), 1e-12):
        found[1] = 1.0  # a constant force does not determine the scale
    return float(found[0]), float(found[1])


def _is_near_limit(q: Array, lower: float, upper: float) -> NDArray[np.bool_]:
    slack = 0.02 * max(float(np.ptp(q)), 1e-9)
    return (q < lower + slack) | (q > upper - slack)


def _find_impacts(t: Array, raw: Array, touching: NDArray[np.bool_]) -> list[list[float]]:
    """Per impact at a limit: which one (-1 or 1), speed before it, rebound speed after it.

    Speeds are from parabolas through some readings on either side, since after a dead stop gravity may move the part
    away, too.
    """
    found: list[list[float]] = []
    middle = 0.5 * (float(raw.max()) + float(raw.min()))
    half_swing = len(raw) / max(len(reversals(raw, 0.1 * float(np.ptp(raw)))), 1)
    n = min(int(half_swing / 8), _IMPACT_READINGS[1])  # short enough that gravity does not reverse the motion
    if n < _IMPACT_READINGS[0]:
        return []
    for i in np.flatnonzero(touching[1:] & ~touching[:-1]) + 1:
        side = 1.0 if raw[i] > middle else -1.0
        stretch = side * raw[i : i + n]
        at = i + int(np.argmax(stretch))
        if at - n < 0 or at + n >= len(raw):
            continue
        before = np.polyfit(t[at - n : at] - t[at], side * raw[at - n : at], 2)[1]
        after = -np.polyfit(t[at + 1 : at + n + 1] - t[at], side * raw[at + 1 : at + n + 1], 2)[1]
        if before > 0:
            found.append([side, float(before), float(max(after, 0.0))])
    return found


def _distance_since_reversal(q: Array) -> Array:
    out = np.full(len(q), np.nan)
    ends = [*reversals(q, 0.03 * max(float(np.ptp(q)), 1e-9)).tolist(), len(q)]
    for a, b in pairwise(ends):
        out[a:b] = np.abs(q[a:b] - q[a])
    return out
