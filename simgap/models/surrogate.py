"""The fast simulation used by fits: one joint in double precision, with any effects and inputs.

`kernel` steps; here assets, effects and runs become its vectors. A test compares it with `generator.simulate`.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21.asset import Asset
from freeart21.base_motion import N_TERMS
from freeart21.effects import AssetError, Effect
from freeart21.effects.base import strongest_rotor
from freeart21.errors import FreeArtError
from freeart21.joint import JointType
from freeart21.measured import Measured
from freeart21.mechanics import DriveLaw, JointMechanics
from freeart21.se3 import Array
from generator.simulate import load
from simgap.geometry.placing import place
from simgap.models import kernel, laws

_THREADING_SIZE = 20_000
"""Readings and inputs above which rows are distributed to threads. On two free cores 8,000 took .35 ms with one thread
and .45 with two, 24,000 1.0 and .66, 135,000 9.3 and 5.1."""
Steps = tuple[float, float]
"""Time steps, s: away from local effects, and near them."""


@dataclass(frozen=True)
class StepSettings:
    """Time steps of the simulation."""

    phase_per_step: float = 0.15
    """rad of the fastest oscillation per step; the RK4 step is then off by 4e-6 of the motion."""
    local_phase_per_step: float = 0.4
    """The same for effects that are stiff at one place only; a run spends little time there."""
    max_step_s: float = 0.02
    min_step_s: float = 5e-4
    """Oscillations for which this is too coarse are not resolved by readings at usual rates."""


STEPS = StepSettings()


@dataclass(frozen=True)
class Plant:
    """A joint as the asset describes it; frame of the joint's parent link."""

    mechanics: JointMechanics
    lower: float
    upper: float
    effects: tuple[Effect, ...] = ()
    """Effects of the asset."""
    T_parent_canonical: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) pose of the canonical frame."""
    base_is_parent: bool = True
    """Whether the joint moves the moving part, not the reference part (the base)."""
    drive: DriveLaw = DriveLaw()  # noqa: RUF009 (frozen)
    """The actuator's law."""

    @property
    def stiffness(self) -> float:
        """Of the actuator's position law."""
        return self.drive.stiffness

    @property
    def damping(self) -> float:
        """Of the actuator's position law."""
        return self.drive.damping

    @property
    def joint_type(self) -> JointType:
        """revolute or prismatic."""
        return self.mechanics.joint.type

    @cached_property
    def gravity_terms(self) -> Array:
        """(3, 3) cosine, sine and constant of gravity's force: nominal, and per rad of tilt of the base in two
        directions.

        The tilts rotate gravity towards the direction in the plane of a hinge's motion (a slider's axis), and across
        it.
        """
        joint, g = self.mechanics.joint, self.mechanics.gravity
        size = float(np.linalg.norm(g))
        if size == 0:
            return np.zeros((3, 3))
        first = np.cross(joint.axis, g) if joint.type == "revolute" else joint.axis - (joint.axis @ g) * g / size**2
        if np.linalg.norm(first) < 1e-6 * size:
            first = np.cross(np.eye(3)[int(np.argmin(np.abs(g)))], g)
        first = size * first / np.linalg.norm(first)
        second = np.cross(g, first) / size
        return np.stack([_gravity_terms(replace(self.mechanics, gravity=v)) for v in (g, first, second)])


def _gravity_terms(mechanics: JointMechanics) -> Array:
    if mechanics.joint.type == "prismatic":
        return np.array([0.0, 0.0, float(mechanics.gravity_force(0.0))])
    return np.append(mechanics.gravity_force([0.0, np.pi / 2]), 0.0)


def make_plant(asset: Asset, measured: Measured) -> Plant:
    """The joint of `asset` under the gravity and the actuator of `measured`; loads the neutral asset in SAPIEN.

    Raises FreeArtError when what the joint moves has neither mass nor inertia.
    """
    simulated = load(replace(asset, effects={}))
    actuator, placed = measured.actuator, place(asset, measured.gravity)
    if not placed.mechanics.inertia > 0:
        raise FreeArtError(
            f"{asset.urdf}: what joint '{asset.joint}' moves has no inertia about it, expected <inertial> with a mass, "
            "or collision shapes"
        )
    return Plant(
        placed.mechanics,
        simulated.lower,
        simulated.upper,
        tuple(asset.effects.get(asset.joint, ())),
        placed.T_parent_canonical,
        placed.child_moves,
        actuator.law if actuator else DriveLaw(),
    )


def _empty() -> Array:
    return np.zeros(0)


@dataclass(frozen=True)
class Inputs:
    """Inputs of a run; (i,) arrays, zero-order hold."""

    times_s: Array = field(default_factory=_empty)
    command: Array = field(default_factory=_empty)
    """Commanded positions; NaN without a position law."""
    effort: Array = field(default_factory=_empty)
    """Commanded efforts, which pass the actuator."""
    push: Array = field(default_factory=_empty)
    """External efforts, which act on the part."""
    hold_difference: Array | None = None
    """(3, i) change of commands, efforts and pushes under zero-order hold of the logged rows (`Nuisance.holding` 1);
    None for none."""
    on: NDArray[np.bool_] | None = None
    """(i,) whether the actuator is on; None for always."""
    base_motion: Array | None = None
    """(8, i) force terms of a moving base (`base_motion.base_motion_terms`); None at rest."""

    @property
    def actuator_effort(self) -> Array:
        """(i,) commanded efforts for the kernel: NaN while the actuator is off."""
        return self.effort if self.on is None else np.where(self.on, self.effort, np.nan)

    @cached_property
    def has_position_law(self) -> bool:
        """Whether a position law is active."""
        return bool(np.isfinite(self.command).any())

    def with_rows(self, times_s: Array) -> Inputs:
        """The same, with additional rows at these times (n,)."""
        times = np.union1d(self.times_s, times_s)
        at = np.searchsorted(self.times_s, times, "right") - 1

        def hold(series: NDArray[Any], before: float) -> Array:
            return np.where(at < 0, before, series[..., np.maximum(at, 0)]) if series.size else np.full(len(at), before)

        return Inputs(
            times,
            hold(self.command, np.nan),
            hold(self.effort, 0.0),
            hold(self.push, 0.0),
            None if self.hold_difference is None else hold(self.hold_difference, 0.0),
            None if self.on is None else hold(self.on, False) > 0,
            None if self.base_motion is None else hold(self.base_motion, 0.0),
        )

    def pushed(self, times_s: Array, force: Array) -> Inputs:
        """The same, with an additional force (n,), N*m or N, at some of its times, linear between them."""
        middles = np.append(0.5 * (force[1:] + force[:-1]), force[-1])
        at = np.searchsorted(times_s, self.times_s, "right") - 1
        return replace(self, push=self.push + np.where(at < 0, 0.0, middles[np.maximum(at, 0)]))


@dataclass(frozen=True)
class Nuisance:
    """Errors of the asset, all together."""

    inertia: float = 1.0
    """True over the asset's inertia."""
    gravity: float = 1.0
    """True over the asset's gravity force."""
    lean: tuple[float, float] = (0.0, 0.0)
    """rad of tilt of the base, see `Plant.gravity_terms`."""
    holding: float = 0.0
    """Interpolation of inputs where it is unknown: 0 smooth, 1 zero-order hold."""

    @classmethod
    def of(cls, errors: Iterable[AssetError], holding: float = 0.0) -> Nuisance:
        """Several errors together."""
        inertia, weight, lean, across = 1.0, 1.0, 0.0, 0.0
        for error in errors:
            inertia, weight = inertia * error.inertia_factor(), weight * error.weight_factor()
            lean, across = lean + error.tilt()[0], across + error.tilt()[1]
        return cls(inertia, weight, (lean, across), holding)


def effect_terms(effects: tuple[Effect, ...] | tuple[type[Effect], ...]) -> NDArray[np.int64]:
    """(t, 5) the kernel's description of the effects with a law."""
    rows, at = [], kernel.HEAD
    for effect in effects:
        if effect.name in laws.LAWS:
            place = effect.is_local()
            rows.append((laws.LAWS[effect.name], laws.ACTS[effect.acts], at, place, effect.geared))
            at += kernel.TERM_HEAD + len(effect.parameters())
    return np.array(rows, np.int64).reshape(-1, 5)


def make_vector(
    plant: Plant,
    effects: tuple[Effect, ...],
    nuisance: Nuisance = Nuisance(),
) -> Array:
    """The kernel's vector for these effects, start state 0.

    Args:
        plant: the joint.
        effects: all effects, those of the asset included.
        nuisance: errors of the asset.
    """
    mechanics = plant.mechanics
    head = np.zeros(kernel.HEAD)
    added = sum(effect.added_inertia() for effect in effects)
    slack = next((effect for effect in effects if effect.acts == "slack"), None)
    head[kernel.INERTIA] = nuisance.inertia * mechanics.inertia + (0.0 if slack else added)
    if slack:
        head[kernel.SLACK_WIDTH], head[kernel.SLACK_INERTIA] = slack.slack(), slack.rotor().inertia + added
        head[kernel.SHAFT_BACK] = slack.rotor().throw_back
    else:
        head[kernel.SHAFT_INERTIA : kernel.SHAFT_SWING + 1] = strongest_rotor(effects)
    terms = plant.gravity_terms
    head[kernel.GRAVITY_COS : kernel.GRAVITY_CONST + 1] = nuisance.gravity * (
        terms[0] + nuisance.lean[0] * terms[1] + nuisance.lean[1] * terms[2]
    )
    if any(effect.needs_load for effect in effects):
        head[kernel.LOAD_ARM2 : kernel.LOAD_TURNED + 1] = _load_terms(mechanics)
    head[kernel.GEARED] = any(effect.geared for effect in effects)
    head[kernel.GAIN] = np.prod([effect.gain() for effect in effects])
    head[kernel.COMMAND_DELAY] = sum(effect.delay() for effect in effects if effect.acts == "command")
    head[kernel.READING_DELAY] = sum(effect.delay() for effect in effects if effect.kind == "sensing")
    head[kernel.OFFSET] = sum(effect.bias_force() for effect in effects)
    drive = plant.drive
    head[kernel.STIFFNESS], head[kernel.DAMPING] = drive.stiffness, drive.damping
    head[kernel.DEAD_BAND : kernel.MAX_FORCE + 1] = (
        drive.dead_band,
        drive.max_commanded,
        drive.back_emf,
        drive.max_force,
    )
    head[kernel.HOLDING] = nuisance.holding
    head[kernel.MOMENT_SCALE], head[kernel.MASS_SCALE] = nuisance.gravity, nuisance.inertia
    head[kernel.LOWER], head[kernel.UPPER] = plant.lower, plant.upper
    parts = [head]
    for effect in effects:
        if effect.name in laws.LAWS:
            parts += [np.array(_place_of(effect)), np.zeros(kernel.TERM_HEAD - 2), np.array(effect.values())]
    return np.concatenate(parts)


def _place_of(effect: Effect) -> tuple[float, float]:
    """Middle and half width of a local effect's support; 0 and 1 for others."""
    place: float | None = None
    for name, spec in effect.parameters().items():
        value = float(getattr(effect, name))
        if spec.revolute_unit == "rad" and spec.lower < 0:
            place = value
        elif spec.revolute_unit == "rad" and place is not None:
            return place, max(effect.support_widths * value, 1e-9)
    return 0.0, 1.0


def _load_terms(mechanics: JointMechanics) -> tuple[float, float, float, float]:
    """The kernel's numbers for the bearing force (`JointMechanics.load`)."""
    weight, axis = mechanics.mass * mechanics.gravity, mechanics.joint.axis
    if mechanics.joint.type == "prismatic":
        across = weight - (weight @ axis) * axis
        return 0.0, float(across @ across), 0.0, 0.0
    arm = mechanics.moment(0.0)
    across = arm - (arm @ axis) * axis
    turned = np.cross(axis, across)
    return float(across @ across), float(weight @ weight), float(across @ weight), float(turned @ weight)


def time_steps(plant: Plant, effects: tuple[Effect, ...], held: bool = True, settings: StepSettings = STEPS) -> Steps:
    """Longest steps, s, that resolve the fastest oscillation and are stable, away from local effects and near them;
    without the position law unless `held`."""
    gain = float(np.prod([effect.gain() for effect in effects]))
    damping = gain * plant.drive.back_emf
    gain = gain if held else 0.0
    damping += gain * plant.damping
    inertia = plant.mechanics.inertia
    local = (settings.phase_per_step / settings.local_phase_per_step) ** 2
    driven = min([inertia, *(effect.rotor().inertia for effect in effects if effect.acts == "slack")])
    weight = float(np.hypot(*plant.gravity_terms[0, :2]))

    def longest(stiffness: float) -> float:
        rate = np.sqrt(stiffness / inertia + gain * plant.stiffness / driven) + 0.1 * damping / driven
        return float(np.clip(settings.phase_per_step / max(rate, 1e-9), settings.min_step_s, settings.max_step_s))

    away = weight + sum(effect.steepness() for effect in effects if not effect.is_local())
    near = away + sum(effect.steepness() * local for effect in effects if effect.is_local())
    if near > away:  # motion after a local effect depends on how it is entered
        away = min(4 * away, near)
    return limit_creep_steps(plant, effects, (longest(away), longest(near)), settings)


def limit_creep_steps(
    plant: Plant, effects: tuple[Effect, ...], steps_s: Steps, settings: StepSettings = STEPS
) -> Steps:
    """The steps, s, or shorter ones that are stable under strong damping."""
    damping = sum(effect.damping() for effect in effects)
    most = plant.mechanics.inertia / max(damping, 1e-12)
    coarse, fine = (max(min(step, most), settings.min_step_s) for step in steps_s)
    return coarse, fine


@dataclass(frozen=True)
class Batch:
    """Concatenated runs, as the kernel takes them."""

    times_s: Array
    begins: NDArray[np.int64]
    """(r + 1,) index of the first time of each run, and their number."""
    series: tuple[Array, Array, Array, Array, Array, Array]
    """Times, commands, efforts, pushes, (3, i) `Inputs.hold_difference` and (8, i) `Inputs.base_motion` of all inputs;
    the last is (8, 0) without base motion."""
    enters: NDArray[np.int64]
    """(r, 2) range of the inputs of each run; stretches of one run share them."""
    held: NDArray[np.bool_]
    """(r,) whether a position law is active."""

    @staticmethod
    def of(runs: Sequence[tuple[Array, Inputs]]) -> Batch:
        """From the times and inputs of some runs."""
        own = {id(i): i for _, i in runs}
        shared = [(i.times_s, i.command, i.actuator_effort, i.push) for i in own.values()]
        first, second, third, fourth = (np.concatenate([t[k] for t in shared]).astype(float) for k in range(4))
        extras = [
            np.zeros((3, len(i.times_s))) if i.hold_difference is None else i.hold_difference for i in own.values()
        ]
        base_motions = [
            np.zeros((N_TERMS, len(i.times_s))) if i.base_motion is None else i.base_motion for i in own.values()
        ]
        if all(i.base_motion is None for i in own.values()):
            base_motions = [np.zeros((N_TERMS, 0))]
        ends = dict(zip(own, np.cumsum([len(i.times_s) for i in own.values()]), strict=True))
        return Batch(
            np.concatenate([times for times, _ in runs]).astype(float),
            np.cumsum([0, *(len(times) for times, _ in runs)]),
            (first, second, third, fourth, _stack_rows(extras), _stack_rows(base_motions)),
            np.array([(ends[id(i)] - len(i.times_s), ends[id(i)]) for _, i in runs]),
            np.array([i.has_position_law for _, i in runs]),
        )

    def sweep(self, numbers: Array, terms: NDArray[np.int64], which: NDArray[np.int64], steps_s: Array) -> Array:
        """Positions, delayed as read, of m kernel vectors (m, k), each at the times of run `which` (m,), concatenated;
        `steps_s` (r, 2) are the runs' steps."""
        ends = np.cumsum(np.append(0, self.begins[which + 1] - self.begins[which]))
        out = np.empty(int(ends[-1]))
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        many = len(out) + int((self.enters[which, 1] - self.enters[which, 0]).sum())
        parts = min(cores, len(which)) if many >= _THREADING_SIZE else 1
        cuts = np.searchsorted(ends, np.linspace(0, ends[-1], parts + 1))

        def run_rows(a: int, b: int) -> None:
            own = out[ends[a] : ends[b]]
            shared = (self.times_s, self.begins, *self.series, self.enters, steps_s)
            kernel.sweep(numbers[a:b], terms, which[a:b], *shared, own)

        if parts == 1:
            run_rows(0, len(which))
        else:
            list(_threads(os.getpid()).map(run_rows, cuts[:-1], cuts[1:]))
        return out


@lru_cache(maxsize=1)
def _threads(process: int) -> ThreadPoolExecutor:
    """Thread pool of a process; a forked one needs its own."""
    return ThreadPoolExecutor(thread_name_prefix="sweep")


def _stack_rows(series: list[Array]) -> Array:
    """Concatenated and contiguous: numba's cache mixes up formulas in a process that loads two versions of the
    kernel."""
    return np.ascontiguousarray(np.concatenate(series, 1))


def sweep(numbers: Array, terms: NDArray[np.int64], times_s: Array, inputs: Inputs, steps_s: Steps) -> Array:
    """(m, n) positions, delayed as read, at `times_s` (n,), of m kernel vectors (m, k)."""
    which = np.zeros(len(numbers), np.int64)
    flat = Batch.of([(times_s, inputs)]).sweep(numbers, terms, which, np.array([steps_s]))
    return flat.reshape(len(numbers), len(times_s))


def apply_sensing(effects: tuple[Effect, ...], q: Array) -> Array:
    """Readings of a sensor with these effects at positions (...); the kernel applies the delay."""
    return np.asarray(q + sum(effect.reading_error(q) for effect in effects if effect.kind == "sensing"))


def simulate(
    plant: Plant,
    effects: tuple[Effect, ...],
    times_s: ArrayLike,
    q0: float,
    qd0: float = 0.0,
    inputs: Inputs = Inputs(),
    nuisance: Nuisance = Nuisance(),
    settings: StepSettings = STEPS,
) -> Array:
    """(n,) readings at `times_s` (n,), rising; (q0, qd0) is the state at the first reading."""
    numbers = make_vector(plant, effects, nuisance)
    numbers[kernel.Q0], numbers[kernel.QD0] = q0, qd0
    times = np.ascontiguousarray(times_s, float)
    q = sweep(numbers[None], effect_terms(effects), times, inputs, time_steps(plant, effects, settings=settings))[0]
    return apply_sensing(effects, q)
