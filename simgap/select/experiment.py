"""The next experiment: of a few simple ones, the one whose predictions differ most between rivals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array, exp_so3
from simgap.fit.fit import Fit, ParameterMap
from simgap.models.surrogate import Inputs, Plant, simulate

_SECONDS, _RATE = 5.0, 100.0
_TILT = np.deg2rad(20.0)
_PAYLOAD = 0.5


@dataclass(frozen=True)
class Trial:
    """One possible experiment."""

    words: str
    """What to do, for users."""
    plant: Plant
    q0: float
    inputs: Inputs
    poses: bool = False
    """Whether the true position is recorded in addition to the sensor's readings."""


NO_EXPERIMENT = "No simple experiment would part these explanations by their own predictions."
DISCREPANCY_EXPERIMENTS = {
    "position": "Move it slowly through its whole range, both ways, with a known force, and record again.",
    "velocity": "Record it at several steady speeds, both ways, with a known force.",
    "direction": "Record the same motion both ways, and once with the base turned round.",
    "time": "Begin the same motion early and late after the recording is started.",
    "flexing": "Hold the part and push the drive, and tap it at rest: what rings between them is not in the asset.",
    "session": "Move it for some minutes, then record these runs again, the last ones first.",
    "": "Record free motion without any drive, small and large, then the same with known pushes: what is missing in "
    "both is the joint's, what only in one is the drive's.",
}
"""Kind of discrepancy (`discrepancy.KINDS`, empty for none) to what to record about it."""
_CLEAR = 3.0
"""Noise sigmas by which predictions must differ."""


def next_experiment(fits: Sequence[Fit]) -> str:
    """The experiment that distinguishes all rivals, and by how much the two closest then differ; where none does, the
    one that distinguishes the best two."""
    problem, menu = fits[0].model.problem, list(_list_trials(fits[0]))
    for rivals in (fits, fits[:2]):
        best, most = None, 0.0
        for trial in menu:
            curves = [_predict(trial, fit) for fit in rivals]
            difference = min(float(np.sqrt(np.mean((a - b) ** 2))) for a, b in combinations(curves, 2))
            if difference > 1.3 * most:  # earlier ones are simpler
                best, most = trial, difference
        floors = most / problem.sigma
        if best is None or floors < _CLEAR:
            continue
        unit = f"{np.degrees(most):.2g}°" if problem.plant.joint_type == "revolute" else f"{1e3 * most:.2g} mm"
        which = "the explanations" if len(rivals) == len(fits) else "the first two explanations"
        least = "at least " if len(rivals) > 2 else ""
        return f"{best.words}: {which} then differ by {least}{unit} ({floors:.0f} times the sensor's noise)."
    return NO_EXPERIMENT


def _list_trials(fit: Fit) -> Iterator[Trial]:
    problem = fit.model.problem
    plant, still = problem.plant, Inputs()
    middle, half = problem.reference[1], problem.reference[2]
    times = np.arange(int(_SECONDS * _RATE)) / _RATE
    nothing, none = np.zeros(len(times)), np.full(len(times), np.nan)

    def inside(q: float) -> float:
        return float(np.clip(q, plant.lower, plant.upper))

    usual = inside(middle + 0.7 * half)
    yield Trial("Record the part's pose with a camera beside the sensor", plant, usual, still, poses=True)
    for way, side in ((1, "largest"), (-1, "smallest")):
        far = inside(middle + way * (3.0 if plant.joint_type == "revolute" else 1.5) * half)
        far = float(np.clip(far, -2.6, 2.6)) if plant.joint_type == "revolute" else far
        yield Trial(
            f"Let it go from {_position_text(far, plant)}, near the {side} position that it can have", plant, far, still
        )
    wave = problem.force * np.sin(2 * np.pi * 0.5 * times)
    push = Inputs(times, none, nothing, wave)
    unit = "N m" if plant.joint_type == "revolute" else "N"
    yield Trial(f"Push it to and fro with a known {problem.force:.2g} {unit}, once in 2 s", plant, inside(middle), push)
    ramp = Inputs(times, none, nothing, problem.force * 1.5 * times / _SECONDS)
    yield Trial(f"Push it ever harder from rest, up to {1.5 * problem.force:.2g} {unit}", plant, inside(middle), ramp)
    yield Trial("Tilt the base by 20 degrees in the plane of the motion", _tilt(plant), usual, still)
    yield Trial(f"Add {_PAYLOAD:.0%} of its mass at its centre of mass", _add_payload(plant), usual, still)
    if plant.stiffness > 0:
        step = np.where(times > 0.5, inside(middle + 0.5 * half), inside(middle))
        yield Trial(
            "Command a step while it is pushed by a known force",
            plant,
            inside(middle),
            Inputs(times, step, nothing, wave),
        )


def _position_text(q: float, plant: Plant) -> str:
    return f"{np.degrees(q):.0f}°" if plant.joint_type == "revolute" else f"{100 * q:.1f} cm"


def _tilt(plant: Plant) -> Plant:
    mechanics = plant.mechanics
    axis, g = mechanics.joint.axis, mechanics.gravity
    about = axis if plant.joint_type == "revolute" and np.linalg.norm(np.cross(axis, g)) > 1e-3 else None
    if about is None:
        about = np.cross(g, axis)
        about = about if np.linalg.norm(about) > 1e-6 else np.cross(g, np.eye(3)[int(np.argmin(np.abs(g)))])
        about = about / max(float(np.linalg.norm(about)), 1e-9)
    return replace(plant, mechanics=replace(mechanics, gravity=exp_so3(_TILT * about) @ g))


def _add_payload(plant: Plant) -> Plant:
    m = plant.mechanics
    more = 1 + _PAYLOAD
    arm = m.moment(0.0) / max(m.mass, 1e-12)
    across = arm - (arm @ m.joint.axis) * m.joint.axis
    added = _PAYLOAD * m.mass * (float(across @ across) if plant.joint_type == "revolute" else 1.0)
    loaded = JointMechanics(m.joint, more * m.mass, m.inertia + added, more * m.moment_zero, m.gravity)
    return replace(plant, mechanics=loaded)


def _predict(trial: Trial, fit: Fit) -> Array:
    """(n,) recorded readings, rad or m, by this fit; they begin at the trial's first position."""
    times, reader = np.arange(int(_SECONDS * _RATE)) / _RATE, ParameterMap(fit.model)
    effects, nuisance = reader.effects(fit.theta), reader.nuisance(fit.theta)
    readings = simulate(trial.plant, effects, times[:1], trial.q0, 0.0, trial.inputs, nuisance)
    begin = trial.q0 - float(readings[0] - trial.q0)
    seen = tuple(effect for effect in effects if effect.kind != "sensing") if trial.poses else effects
    return simulate(trial.plant, seen, times, begin, 0.0, trial.inputs, nuisance)
