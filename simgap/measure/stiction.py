"""Pushes that did not move a joint: a lower bound of what holds it.

Dry friction balances any force up to its level, and contacts deform a little before they slide. A joint that moves no
further than that, under a force that would have carried it far, was held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeart21.measured import Measured, Run
from simgap.measure.inputs import enabled_at, logged_at, split_efforts
from simgap.measure.noise import SensorNoise
from simgap.models.surrogate import Plant

PRESLIDING_TRAVEL = {"revolute": 1e-2, "prismatic": 1e-4}
"""Largest presliding displacement, rad or m: a real arm slid after 1.8e-3 rad, filmed pendula after 8e-3 rad, contacts
of sliders after .02 to .05 mm (Armstrong-Helouvry 1994)."""
FREE_TRAVEL_RATIO = 100.0
"""Times that travel by which the push must have moved a free joint."""
FORCE_UNCERTAINTY = 0.05
"""Relative uncertainty of a commanded force; see `Effect.model_error` of the drive."""
_NOISES = 8.0
"""Peak-to-peak noise of a joint at rest, sigmas."""


@dataclass(frozen=True)
class StictionBound:
    """A lower bound of what holds a joint."""

    force: float
    """N*m or N: largest sum of weight and commanded force, less its uncertainty."""
    travel: float
    """rad or m that the joint moved."""
    free_travel: float
    """rad or m that a free joint would have moved."""


def find_stiction_bound(measured: Measured, plant: Plant, noise: SensorNoise) -> StictionBound | None:
    """The bound from all runs; None when the joint moved in any, when no push would have moved it, or when a position
    law may have held it."""
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
