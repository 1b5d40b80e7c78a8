"""Runs with prescribed motion: the fitted reading is the force.

With a speed-controlled drive positions do not show friction; the required force does. Nearly all of that force is
friction and hardly any inertia, so a simulation under it would drift anywhere: commanded force is known to a few
percent, which is more than what accelerates the joint. The reading is therefore the commanded force, and models predict
it by inverse dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from freeart21.base_motion import base_motion_force
from freeart21.measured import Measured, Run
from freeart21.mechanics import DriveLaw
from freeart21.se3 import Array
from simgap.measure.data import MAX_SAMPLES, FitRun
from simgap.measure.inputs import base_force_of, enabled_at, logged_at, split_efforts
from simgap.measure.noise import SensorNoise, estimate_noise
from simgap.measure.swings import reversals
from simgap.models.equation_error import smooth_run
from simgap.models.surrogate import Inputs, Plant

MAX_INERTIA_SHARE = 0.01
"""Share of inertia in the commanded force, RMS while the joint slides, below which motion is prescribed. A real arm at
steady speeds has .0001 to .004, a motor under torque steps .025, swings 1. Commanded forces are hardly more accurate.
"""
_WINDOWS = (7, 11, 15, 21, 31, 45, 65, 95, 135, 201, 301, 501)
"""Smoothing windows of accelerations, readings: the shortest whose noise is small relative to that of the force,"""
_NOISE_SHARE = 0.1
"""... by this share. With as much noise as the force's, a fit makes inertia small and the drive strong."""
_RESTING = 0.02
"""Share of a run's RMS speed below which the joint turns or rests."""
_MOVING_SIGMAS = 4.0
"""Standard deviations of speed above which the joint surely moves."""
_PRESLIDING_SHARE = 0.1
"""Share of the travel since a rest or turn over which friction may build up. Contacts of a real arm slid after .1
degree, and it turned by .8 degrees in its slowest runs."""
_FEWEST = 8
"""Readings of the force that a run must have while sliding."""


@dataclass(frozen=True)
class ForceRun(FitRun):
    """A run with measured force: `q` and `sigma` are of the commanded force, N*m or N, `speed` is of the joint."""

    position: Array = field(kw_only=True)
    """(n,) rad or m."""
    acceleration: Array = field(kw_only=True)
    """(n,) rad/s^2 or m/s^2."""
    commanded: Array = field(kw_only=True)
    """(n,) commanded force of the actuator."""
    on: Array = field(kw_only=True)
    """(n,) 1 while the actuator was on, else 0."""
    cos_sin: Array = field(kw_only=True)
    """(2, n) smoothed cosine and sine of the position, for gravity."""
    load: Array = field(kw_only=True)
    """(n,) bearing force, N."""

    @property
    def joint_position(self) -> Array:
        """(n,) rad or m."""
        return self.position

    @property
    def reading_scale(self) -> float:
        """RMS force."""
        return float(np.sqrt(np.mean(self.q**2)))


def make_force_runs(
    measured: Measured, plant: Plant
) -> tuple[tuple[ForceRun, ...], SensorNoise, tuple[str, ...]] | None:
    """The runs for fits to force, their noise, and a line for each dropped run; None when motion is not prescribed.

    It is where measured.json says so, or, without that, where inertia is a tiny share of the force in every run.
    """
    candidates = [run for run in measured.runs if run.prescribed] or list(measured.runs)
    if any(
        _logged_force(run, measured) is None or run.poses is not None or run.prescribed is False for run in candidates
    ):
        return None
    if any(run.q_command is not None and not run.prescribed for run in candidates):
        return None  # with a position law the simulation can follow the motion
    if not (candidates[0].prescribed or all(_is_steady(run, measured, plant) for run in candidates)):
        return None
    noise = estimate_noise([_finite(run.times_s, _logged_force(run, measured)) for run in candidates]).sigma_at_rest
    still = estimate_noise([_finite(run.times_s, run.q) for run in candidates]).sigma_at_rest
    seen = [_make_run(measured, plant, run, noise, still) for run in candidates]
    force_runs = [run for run in seen if run is not None]
    if not force_runs:
        return None
    names = {run.name for run in force_runs}
    notes = [f"run '{r.name}': its joint slides for too few readings: it was left out" for r in candidates
             if r.name not in names]  # fmt: skip
    notes += [f"run '{r.name}': its motion is not prescribed as that of others is: it was left out"
              for r in measured.runs if r not in candidates]  # fmt: skip
    return tuple(force_runs), SensorNoise(float(np.median([run.sigma[0] for run in force_runs])), 0.0), tuple(notes)


def _logged_force(run: Run, measured: Measured) -> Array | None:
    """(n,) the commanded force, of the actuator or a push; None for none."""
    commanded, push = split_efforts(run, measured)
    return commanded if push is None else push


def _finite(times: Array, values: Array | None) -> tuple[Array, Array]:
    assert values is not None
    known = np.isfinite(values)
    return times[known], values[known]


def _is_steady(run: Run, measured: Measured, plant: Plant) -> bool:
    """Whether inertia is a tiny share of the force. Accelerations are smoothed as much as half a swing allows."""
    smooth = smooth_run(run)
    if smooth is None:
        return False
    t, _, q, _, qdd, kernel = smooth
    half, force = len(kernel) // 2 + 1, np.interp(t, *_finite(run.times_s, _logged_force(run, measured)))
    slides = _sliding(q)  # excludes acceleration from rest
    slides[:half], slides[-half:] = False, False
    if not slides.any():
        return False
    taken, given = (float(np.sqrt(np.mean(v[slides] ** 2))) for v in (plant.mechanics.inertia * qdd, force))
    return taken < MAX_INERTIA_SHARE * given


def _make_run(measured: Measured, plant: Plant, run: Run, noise: float, still: float) -> ForceRun | None:
    """The run while its joint slides off its limits; None where that is too little."""
    inertia, mechanics = plant.mechanics.inertia, plant.mechanics
    smooth, sigma, spread = smooth_run(run), 0.0, 0.0
    widest = 0 if smooth is None else len(smooth[5])
    for window in (*(w for w in _WINDOWS if w < widest), widest):
        found = smooth_run(run, window)
        if found is None:
            return None
        smooth = found
        step = float(found[0][1] - found[0][0])
        spread, bend = (still * _noise_gain(window, deriv, step) for deriv in (1, 2))
        of_force, of_bend = noise * float(np.sqrt(found[5] @ found[5])), inertia * bend
        sigma = float(np.hypot(of_force, of_bend))
        if of_bend <= _NOISE_SHARE * of_force:
            break
    if smooth is None:
        return None
    t, _, q, qd, qdd, kernel = smooth
    if run.qd is not None:
        qd = np.interp(t, *_finite(run.times_s, run.qd))
    effort, push = split_efforts(run, measured)
    how = measured.interpolation
    on = enabled_at(run, t, effort is not None).astype(float)
    law = DriveLaw() if measured.actuator is None else measured.actuator.law
    commanded = np.zeros(len(t)) if effort is None else logged_at(run.times_s, effort, how, t)
    commanded = on * law.forces(q, qd, np.full(len(t), np.nan), commanded)
    external = np.zeros(len(t)) if push is None else logged_at(run.times_s, push, how, t)
    if run.base is not None:
        external = external + base_motion_force(base_force_of(run, measured, plant).at(t), q)
    seen = (np.convolve(series, kernel, "same") for series in (commanded, external, np.cos(q), np.sin(q), qd))
    commanded, external, cosine, sine, speed = seen  # smoothed as the acceleration
    half, span = len(kernel) // 2 + 1, plant.upper - plant.lower
    slack = 1e-3 * span if np.isfinite(span) else 0.0
    usual = float(np.sqrt(np.mean(qd**2)))
    rests = (np.abs(speed) < max(_RESTING * usual, _MOVING_SIGMAS * spread)) | (on < float(effort is not None))
    rests |= ~_sliding(q)
    rests |= (q < plant.lower + slack) | (q > plant.upper - slack)
    near = np.convolve(rests, np.ones(2 * half + 1), "same") > 0.5
    keep = ~near & (np.arange(len(t)) >= half) & (np.arange(len(t)) < len(t) - half)
    at = np.flatnonzero(keep)
    at = at[:: max(1, round(1 / float(kernel @ kernel)), -(-len(at) // MAX_SAMPLES))]
    if len(at) < _FEWEST:
        return None
    ways = np.sign(speed[at])
    regime = "forwards" if (ways > 0).all() else "backwards" if (ways < 0).all() else "both ways"
    read = t[at] - run.times_s[0], (commanded + external)[at], np.full(len(at), sigma), speed[at]
    return ForceRun(
        *(run.name, *read, Inputs(), run.held_out, regime, measured.runs.index(run)),
        position=q[at],
        acceleration=qdd[at],
        commanded=commanded[at],
        on=on[at],
        cos_sin=np.stack([cosine, sine])[:, at],
        load=mechanics.load(q, qd, qdd)[at],
    )


def _sliding(q: Array) -> NDArray[np.bool_]:
    """(n,) whether the joint moved far enough since it began or turned back for its contacts to slide."""
    ends, slides = [0, *reversals(q, 0.03 * max(float(np.ptp(q)), 1e-12)).tolist(), len(q)], []
    for a, b in pairwise(ends):
        gone = np.abs(q[a:b] - q[a])
        slides.append(gone > _PRESLIDING_SHARE * float(gone.max(initial=0.0)))
    return np.concatenate(slides)


def _noise_gain(window: int, deriv: int, step: float) -> float:
    """Standard deviation of white noise of 1 in a smoothed derivative."""
    from scipy.signal import savgol_coeffs

    return float(np.linalg.norm(savgol_coeffs(window, 4, deriv=deriv, delta=step)))
