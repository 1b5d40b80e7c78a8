"""The next experiment: which of a few simple ones would part the rivals most, by their own predictions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array, exp_so3
from simgap.fit.fit import Fit, Reader
from simgap.measure.data import FitRun
from simgap.models.surrogate import Inputs, Plant, simulate

_SECONDS, _RATE = 5.0, 100.0
_TILT = np.deg2rad(20.0)
_PAYLOAD = 0.5


@dataclass(frozen=True)
class Trial:
    """One experiment that could be made."""

    words: str
    """What to do, for a mechanic."""
    plant: Plant
    q0: float
    inputs: Inputs
    poses: bool = False
    """Whether the true position is recorded besides the sensor's readings."""


def next_experiment(fits: list[Fit], runs: tuple[FitRun, ...]) -> str:
    """What would part the first two fits most, and by how much."""
    best, most = None, 0.0
    for trial in _menu(fits[0], runs):
        apart = _divergence(trial, fits[0], fits[1])
        if apart > 1.3 * most:  # earlier ones are simpler
            best, most = trial, apart
    problem = fits[0].theory.problem
    floors = most / problem.sigma
    if best is None or floors < 3:
        return "No simple experiment would part these explanations by their own predictions."
    unit = f"{np.degrees(most):.2g}°" if problem.plant.joint_type == "revolute" else f"{1e3 * most:.2g} mm"
    return f"{best.words}: the explanations then differ by {unit} ({floors:.0f} times the sensor's noise)."


def _menu(fit: Fit, runs: tuple[FitRun, ...]) -> Iterator[Trial]:
    problem = fit.theory.problem
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
        yield Trial(f"Let it go from {_at(far, plant)}, near the {side} position that it can have", plant, far, still)
    wave = problem.force * np.sin(2 * np.pi * 0.5 * times)
    push = Inputs(times, none, nothing, wave)
    unit = "N m" if plant.joint_type == "revolute" else "N"
    yield Trial(f"Push it to and fro with a known {problem.force:.2g} {unit}, once in 2 s", plant, inside(middle), push)
    ramp = Inputs(times, none, nothing, problem.force * 1.5 * times / _SECONDS)
    yield Trial(f"Push it ever harder from rest, up to {1.5 * problem.force:.2g} {unit}", plant, inside(middle), ramp)
    yield Trial("Tilt the base by 20 degrees in the plane of the motion", _tilted(plant), usual, still)
    yield Trial(f"Add {_PAYLOAD:.0%} of its mass at its centre of mass", _loaded(plant), usual, still)
    if plant.stiffness > 0:
        step = np.where(times > 0.5, inside(middle + 0.5 * half), inside(middle))
        yield Trial(
            "Command a step while it is pushed by a known force",
            plant,
            inside(middle),
            Inputs(times, step, nothing, wave),
        )


def _at(q: float, plant: Plant) -> str:
    return f"{np.degrees(q):.0f}°" if plant.joint_type == "revolute" else f"{100 * q:.1f} cm"


def _tilted(plant: Plant) -> Plant:
    mechanics = plant.mechanics
    axis, g = mechanics.joint.axis, mechanics.gravity
    about = axis if plant.joint_type == "revolute" and np.linalg.norm(np.cross(axis, g)) > 1e-3 else None
    if about is None:
        about = np.cross(g, axis)
        about = about if np.linalg.norm(about) > 1e-6 else np.cross(g, np.eye(3)[int(np.argmin(np.abs(g)))])
        about = about / max(float(np.linalg.norm(about)), 1e-9)
    return replace(plant, mechanics=replace(mechanics, gravity=exp_so3(_TILT * about) @ g))


def _loaded(plant: Plant) -> Plant:
    m = plant.mechanics
    more = 1 + _PAYLOAD
    arm = m.moment(0.0) / max(m.mass, 1e-12)
    across = arm - (arm @ m.joint.axis) * m.joint.axis
    added = _PAYLOAD * m.mass * (float(across @ across) if plant.joint_type == "revolute" else 1.0)
    loaded = JointMechanics(m.joint, more * m.mass, m.inertia + added, more * m.moment_zero, m.gravity)
    return replace(plant, mechanics=loaded)


def _divergence(trial: Trial, first: Fit, second: Fit) -> float:
    """Root mean square difference of what the two predict, rad or m."""
    times = np.arange(int(_SECONDS * _RATE)) / _RATE
    curves: list[list[Array]] = []
    for fit in (first, second):
        reader = Reader(fit.theory)
        effects, nuisance = reader.effects(fit.theta), reader.nuisance(fit.theta)
        made = [simulate(trial.plant, effects, times, trial.q0, 0.0, trial.inputs, nuisance)]
        if trial.poses:
            dynamic = tuple(effect for effect in effects if effect.kind != "sensing")
            offset = made[0][0] - trial.q0
            made.append(simulate(trial.plant, dynamic, times, trial.q0 - offset, 0.0, trial.inputs, nuisance))
        curves.append(made[1:] if trial.poses else made)
    return float(max(np.sqrt(np.mean((a - b) ** 2)) for a, b in zip(*curves, strict=True)))
