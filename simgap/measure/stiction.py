"""Pushes that a joint withstood: what holds it is at least as large, and nothing else is told.

Dry friction takes whatever it is given up to its level, and its contacts bend a little before they slide: a joint that
moves by no more than that, under what would have carried it far, was held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeart21.measured import Measured, Run
from simgap.measure.inputs import enabled_at, logged_at, split_efforts
from simgap.measure.noise import SensorNoise
from simgap.models.surrogate import Plant

PRESLIDING_TRAVEL = {"revolute": 1e-2, "prismatic": 1e-4}
"""rad or m by which what holds a joint may bend: a real arm's friction gave way by 1.8e-3 rad before it slid, filmed
pendula's by 8e-3 of a radian, contacts of sliders by .02 to .05 mm (Armstrong-Helouvry 1994)."""
FREE_TRAVEL_RATIO = 100.0
"""Times that reach that the push alone would have carried it, at least."""
FORCE_UNCERTAINTY = 0.05
"""Part of a told force that is not relied on: what a drive gives is hardly surer (`Effect.departs`)."""
_NOISES = 8.0
"""Of the sensor, that a joint at rest may seem to move by from end to end."""


@dataclass(frozen=True)
class StictionBound:
    """What a joint withstood."""

    force: float
    """N*m or N, the largest, weight and told force together, less what is not sure of them."""
    travel: float
    """rad or m that it moved by."""
    free_travel: float
    """rad or m by which that would have carried it."""


def find_stiction_bound(measured: Measured, plant: Plant, noise: SensorNoise) -> StictionBound | None:
    """What the joint withstood in all runs; None when it moved in any, when no push would have moved it, or when a
    position law may have held it."""
    if any(run.q_command is not None or run.poses is not None for run in measured.runs):
        return None
    found = [_bound_of_run(run, measured, plant) for run in measured.runs]
    reach = max(PRESLIDING_TRAVEL[plant.joint_type], _NOISES * noise.sigma_at_rest)
    most = max(found, key=lambda one: one.force)
    if max(one.travel for one in found) > reach or max(one.free_travel for one in found) < FREE_TRAVEL_RATIO * reach:
        return None
    return StictionBound(most.force, max(one.travel for one in found), most.free_travel)


def _bound_of_run(run: Run, measured: Measured, plant: Plant) -> StictionBound:
    known = np.isfinite(run.q)
    t, q = run.times_s[known], run.q[known]
    zero, drive, others = np.zeros(len(t)), np.zeros(len(t)), np.zeros(len(t))
    effort, push = split_efforts(run, measured)
    if effort is not None:
        drive += np.where(enabled_at(run, t, True), logged_at(run.times_s, effort, measured.interpolation, t), 0.0)
    if push is not None:
        others += logged_at(run.times_s, push, measured.interpolation, t)
    input_force = drive + others
    weight = np.asarray(plant.mechanics.gravity_force(q))
    others = others + weight + sum((np.asarray(e.force(q, zero)) for e in plant.effects), zero)
    load, carried = plant.mechanics.load(q, zero, zero), np.abs(drive - others)
    level = sum((np.asarray(e.drive_limit(q, zero, carried if e.geared else load)) for e in plant.effects), zero)
    net, uncertainty = (
        drive + others,
        FORCE_UNCERTAINTY * np.abs(input_force) + measured.gravity_relative * np.abs(weight) + level,
    )
    net = np.sign(net) * np.maximum(np.abs(net) - uncertainty, 0.0)
    slack = 1e-3 * (plant.upper - plant.lower) if np.isfinite(plant.upper - plant.lower) else 0.0
    stopped = ((q > plant.upper - slack) & (net > 0)) | ((q < plant.lower + slack) & (net < 0))
    net = np.where(stopped, 0.0, net)
    steps = np.diff(t, prepend=t[0])
    alone = np.cumsum(np.cumsum(net / plant.mechanics.inertia * steps) * steps)
    return StictionBound(float(np.abs(net).max()), float(np.ptp(q)), float(np.abs(alone).max()))
