"""Runs as fits take them: readings with their noise, inputs, initial guesses of the start state, and the regime."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.measured import Measured
from freeart21.se3 import Array
from simgap.measure.inputs import make_inputs
from simgap.measure.noise import SensorNoise, estimate_noise
from simgap.measure.swings import reversals
from simgap.models.surrogate import Inputs, Plant, time_steps

MAX_SAMPLES = 1500
"""Readings of a run that a fit uses, where they resolve its motion; more are thinned out evenly."""
LEAST_A_SWING = 4.0
"""Readings per half swing that must remain; a sine needs two."""
MOST_SAMPLES = 6000
"""Most readings of a run that a fit uses; its time grows with them. Not measured."""


_START_WINDOWS_S = (0.06, 0.12, 0.25)
"""First seconds of a run that give its initial velocity: short windows are noisy, long ones may contain an impact."""


@dataclass(frozen=True, eq=False)
class FitRun:
    """One run, or a stretch of one; compared by identity."""

    name: str
    times_s: Array
    """(n,) s."""
    q: Array
    """(n,) readings."""
    sigma: Array
    """(n,) standard deviations of the readings."""
    speed: Array
    """(n,) rough velocities."""
    inputs: Inputs
    held_out: bool | None
    regime: str = ""
    order: int = 0
    """Place in the order of recording."""

    @property
    def joint_position(self) -> Array:
        """(n,) joint position, rad or m."""
        return self.q

    @property
    def reading_scale(self) -> float:
        """Standard deviation of the motion, to which a model's error is relative."""
        return float(np.std(self.q))

    @property
    def start(self) -> tuple[float, float]:
        """Initial guess of the state at the first reading."""
        return self.starts[0]

    @cached_property
    def starts(self) -> list[tuple[float, float]]:
        """Guesses of the state at the first reading, from parabolas through ever longer beginnings."""
        found = []
        for seconds in _START_WINDOWS_S:
            k = max(7, int(np.searchsorted(self.times_s, self.times_s[0] + seconds)))
            k = min(len(self.q), k)
            t = (self.times_s[:k] - self.times_s[0]) / (self.times_s[k - 1] - self.times_s[0])
            powers = t[:, None] ** np.arange(3 if k > 4 else 2)
            fit = np.linalg.lstsq(powers, self.q[:k], None)[0]
            found.append((float(fit[0]), float(fit[1] / (self.times_s[k - 1] - self.times_s[0]))))
        return found

    def between(self, begin: int, end: int) -> FitRun:
        """The stretch of readings begin to end."""
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        cut: dict[str, Any] = {k: v[..., begin:end] for k, v in own.items() if isinstance(v, np.ndarray)}
        return replace(self, **cut)


def make_fit_runs(measured: Measured, plant: Plant) -> tuple[tuple[FitRun, ...], SensorNoise]:
    """All runs of a measured set with known positions, and the noise of its sensor.

    Raises FreeArtError when the readings cannot be positions of this joint: far beyond its limits, or in degrees.
    """
    series = []
    for run in measured.runs:
        good = np.isfinite(run.q)
        series.append((run.times_s[good], run.q[good]))
    _check_units(measured, plant, series)
    noise = estimate_noise(series)
    runs, longest = [], time_steps(plant, plant.effects)[0]
    for order, (run, (times, q)) in enumerate(zip(measured.runs, series, strict=True)):
        stride = thinning_stride(times, q)
        speed, inputs = rough_speed(times, q)[::stride], make_inputs(run, measured, longest, plant)
        read = np.ascontiguousarray(times[::stride]), q[::stride], noise.sigma(speed), speed
        runs.append(FitRun(run.name, *read, inputs, run.held_out, order=order))
    return _label_regimes(runs), noise


def thinning_stride(times: Array, q: Array) -> int:
    """Use every n-th reading: as few as the motion needs."""
    few = -(-len(times) // MAX_SAMPLES)
    if few == 1:
        return 1
    turns = reversals(q, 0.1 * float(np.ptp(q)))
    swing = float(np.median(np.diff(turns))) if len(turns) >= 3 else np.inf
    return max(1, -(-len(times) // MOST_SAMPLES), int(min(few, swing / LEAST_A_SWING)))


def thinning_notes(measured: Measured) -> tuple[str, ...]:
    """A line for each run that is thinned out."""
    notes = []
    for run in measured.runs:
        good = np.isfinite(run.q)
        stride = thinning_stride(run.times_s[good], run.q[good]) if good.any() else 1
        if stride > 1:
            rate = float(1 / np.median(np.diff(run.times_s[good])))
            notes.append(
                f"run '{run.name}': one reading of {stride} is looked at, {rate / stride:.3g} of {rate:.3g} a second"
            )
    return tuple(notes)


def rough_speed(times: Array, q: Array) -> Array:
    """(n,) slope of a straight line through five neighbours."""
    reach = min(2, (len(q) - 1) // 2)
    width = 2 * reach + 1
    padded = (np.pad(series, reach, mode="reflect", reflect_type="odd") for series in (times, q))
    t, v = (np.lib.stride_tricks.sliding_window_view(series, width) for series in padded)
    t = t - t.mean(1, keepdims=True)
    return np.asarray((t * v).sum(1) / (t * t).sum(1))


def _label_regimes(runs: list[FitRun]) -> tuple[FitRun, ...]:
    """Runs with regimes: driven or free, and slow or fast relative to the others of their kind."""
    driven = [
        np.isfinite(inputs.command).any()
        or any(np.any(each) for each in (inputs.effort, inputs.push, inputs.base_motion))
        for inputs in (run.inputs for run in runs)
    ]
    fast = np.array([float(np.sqrt(np.mean(run.speed**2))) for run in runs])
    named = []
    for i, run in enumerate(runs):
        same_kind = fast[[d == driven[i] for d in driven]]
        middle = np.sqrt(same_kind.min() * same_kind.max())
        size = "" if same_kind.max() < 1.5 * same_kind.min() else (" slow" if fast[i] < middle else " fast")
        named.append(replace(run, regime=("driven" if driven[i] else "free") + size))
    return tuple(named)


def _check_units(measured: Measured, plant: Plant, series: list[tuple[Array, Array]]) -> None:
    unit, wrong_unit = ("rad", "degrees") if plant.joint_type == "revolute" else ("m", "mm")
    for run, (_, q) in zip(measured.runs, series, strict=True):
        low, high, span = float(q.min()), float(q.max()), plant.upper - plant.lower
        beyond = max(plant.lower - low, high - plant.upper)
        if np.isfinite(span) and beyond > 0.25 * span + (0.3 if unit == "rad" else 0.0):
            raise FreeArtError(
                f"run '{run.name}' reads {low:.4g} to {high:.4g} {unit}, but joint '{measured.joint}' has limits "
                f"{plant.lower:.4g} to {plant.upper:.4g} {unit}: are its units {wrong_unit}?"
            )
        turns = np.abs(np.diff(q[[0, *reversals(q, 0.1 * float(np.ptp(q))), -1]]))
        if unit == "rad" and len(turns) >= 3 and np.median(turns) > 4 * np.pi:
            raise FreeArtError(
                f"run '{run.name}' swings by {np.median(turns):.4g} rad between turns of joint '{measured.joint}', "
                "expected less than 2 turns: are its units degrees?"
            )
