"""Mechanics of a joint: mass, inertia and gravity of the moving part, and the actuator."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from freeart21.joint import Joint
from freeart21.se3 import Array

Body = tuple[float, Array, Array]
"""Mass, kg, centre of mass (3,), m, and inertia about it (3, 3), kg*m^2."""


def joint_inertia(joint: Joint, bodies: Iterable[Body]) -> float:
    """Inertia of `bodies`, all in one frame, at the joint: kg*m^2 about a hinge, kg along a slider."""
    if joint.type == "prismatic":
        return float(sum(mass for mass, _, _ in bodies))
    arms = ((mass, np.cross(joint.axis, centre - joint.pivot), inertia) for mass, centre, inertia in bodies)
    return float(sum(joint.axis @ inertia @ joint.axis + mass * arm @ arm for mass, arm, inertia in arms))


@dataclass(frozen=True)
class JointMechanics:
    """A rigid moving part on a joint with a base at rest; all in the frame of the joint's parent link.

    The equation of free motion is inertia * qdd = gravity_force(q).
    """

    joint: Joint
    """Axis and pivot; states are URDF joint values."""
    mass: float
    """kg."""
    inertia: float
    """kg*m^2 about a revolute joint's axis, kg along a prismatic joint's."""
    moment_zero: Array
    """(3,) kg*m: mass times centre of mass at q = 0."""
    gravity: Array
    """(3,) m/s^2."""
    tensor_zero: Array | None = None
    """(3, 3) kg*m^2 about the pivot, in the directions of the frame, at q = 0; needed for rotating bases only."""

    @cached_property
    def _arms(self) -> tuple[Array, Array, Array]:
        """(3,) each, kg*m from the pivot at q = 0: along the axis, across it, and the latter turned by 90 degrees."""
        arm, axis = self.moment_zero - self.mass * self.joint.pivot, self.joint.axis
        along = (arm @ axis) * axis
        return along, arm - along, np.cross(axis, arm)

    def moment(self, q: ArrayLike) -> Array:
        """(..., 3) kg*m: mass times the vector from the joint's pivot to the centre of mass, at `q` (...)."""
        (along, across, turned), q = self._arms, np.asarray(q, float)[..., None]
        if self.joint.type == "prismatic":
            return np.asarray(along + across + self.mass * q * self.joint.axis)
        return np.asarray(along + np.cos(q) * across + np.sin(q) * turned)

    def gravity_moment(self, q: ArrayLike) -> Array:
        """(..., 3) N*m: the moment of gravity about the joint's pivot."""
        return np.cross(self.moment(q), self.gravity)

    def gravity_force(self, q: ArrayLike) -> Array:
        """(...) N*m or N: gravity's generalised force on the joint."""
        if self.joint.type == "prismatic":
            return np.full(np.shape(q), self.mass * self.joint.axis @ self.gravity)
        return np.asarray(self.gravity_moment(q) @ self.joint.axis)

    def load(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
        """(...) N: size of the bearing force on the moving part at position, velocity and acceleration (...).

        Revolute: |m a - m g| with the acceleration a of the centre of mass. Prismatic: the component across the axis.
        Moments on the bearing are neglected, as is where a push acts.
        """
        weight, axis = self.mass * self.gravity, self.joint.axis
        if self.joint.type == "prismatic":
            return np.full(np.shape(q), np.linalg.norm(weight - (weight @ axis) * axis))
        (_, across, turned), q = self._arms, np.asarray(q, float)
        c, s = np.cos(q)[..., None], np.sin(q)[..., None]
        qd, qdd = np.asarray(qd, float)[..., None], np.asarray(qdd, float)[..., None]
        force = qdd * (c * turned - s * across) - qd**2 * (c * across + s * turned) - weight
        return np.asarray(np.sqrt((force * force).sum(-1)))


@dataclass(frozen=True)
class DcMotor:
    """A DC motor at voltage V, |V| up to `max_voltage`: force = torque_constant * I at the joint, |I| up to
    `max_current`, I = (V - torque_constant * qd) / resistance. Inductance (milliseconds) is neglected."""

    torque_constant: float
    """N*m/A or N/A at the joint, gears included; also the back EMF in V*s/rad or V*s/m."""
    resistance: float
    """ohm."""
    max_voltage: float = math.inf
    """V."""
    max_current: float = math.inf
    """A, either way."""

    @property
    def per_volt(self) -> float:
        """Force at rest per volt, N*m/V or N/V."""
        return self.torque_constant / self.resistance


def commanded_force(
    q: float, qd: float, q_command: float, effort: float, stiffness: float, damping: float, dead_band: float
) -> float:
    """Force commanded by an actuator's law, N*m or N, at position `q` and velocity `qd`; `q_command` is NaN without
    one.

    `simgap.models.kernel` compiles this and `delivered_force`.
    """
    error = q_command - q
    if error == error:
        effort += stiffness * (error - min(max(error, -dead_band), dead_band)) - damping * qd
    return effort


def delivered_force(commanded: float, qd: float, max_commanded: float, back_emf: float, max_force: float) -> float:
    """Force that the actuator delivers for a commanded one, N*m or N."""
    return min(max(min(max(commanded, -max_commanded), max_commanded) - back_emf * qd, -max_force), max_force)


@dataclass(frozen=True)
class DriveLaw:
    """The law of an actuator that is on, in N*m or N."""

    stiffness: float = 0.0
    damping: float = 0.0
    dead_band: float = 0.0
    max_commanded: float = math.inf
    """Limit of the commanded force, before a motor's back EMF."""
    back_emf: float = 0.0
    """Force against the motion per speed, for any command."""
    max_force: float = math.inf
    """Limit of the delivered force."""

    def commanded(self, q: float, qd: float, q_command: float, effort: float) -> float:
        """Commanded force at position `q` and velocity `qd`; `q_command` is NaN without a position law."""
        return commanded_force(q, qd, q_command, effort, self.stiffness, self.damping, self.dead_band)

    def force(self, q: float, qd: float, q_command: float, effort: float) -> float:
        """Delivered force, N*m or N."""
        return delivered_force(
            self.commanded(q, qd, q_command, effort), qd, self.max_commanded, self.back_emf, self.max_force
        )

    def damped(self, q: float, qd: float, q_command: float, effort: float) -> float:
        """Decrease of the force per speed; at its limits only by back EMF."""
        command = self.commanded(q, qd, q_command, effort)
        falls = self.back_emf + (self.damping if q_command == q_command and abs(command) < self.max_commanded else 0.0)
        command = min(max(command, -self.max_commanded), self.max_commanded) - self.back_emf * qd
        return falls if abs(command) < self.max_force else 0.0

    def forces(self, q: ArrayLike, qd: ArrayLike, q_command: ArrayLike, effort: ArrayLike) -> Array:
        """(n,) `force` for arrays."""
        with np.errstate(invalid="ignore"):  # NaN without a position law
            return np.asarray(np.vectorize(self.force, otypes=[float])(q, qd, q_command, effort))


@dataclass(frozen=True)
class Actuator:
    """The drive of a joint: a position law, a commanded effort, or both; a measured set's `actuator` and `effort`.

    Without limits: force = stiffness * (q_command(t) - q) - damping * qd + effort(t).
    """

    q_command: Callable[[float], float] | None = None
    """Time, s, to commanded position, rad or m; None for no position law."""
    stiffness: float = 0.0
    """N*m/rad or N/m; with a `motor` V/rad or V/m."""
    damping: float = 0.0
    """N*m*s/rad or N*s/m, with a `motor` V*s/rad or V*s/m; acts with a position law only."""
    effort: Callable[[float], float] | None = None
    """Time, s, to commanded force, N*m or N; with a `motor` the force of its voltage at rest."""
    dead_band: float = 0.0
    """Position error, rad or m, below which the law is 0; it acts on what is beyond."""
    max_effort: float = math.inf
    """Limit of the force, N*m or N."""
    motor: DcMotor | None = None
    """The motor of a voltage-driven actuator; None where forces are commanded."""
    enabled: Callable[[float], float] | None = None
    """Time, s, to whether it is on (above 0); None for always. When off there is no force and no back EMF."""

    @cached_property
    def law(self) -> DriveLaw:
        """The law in forces."""
        motor = self.motor
        if motor is None:
            return DriveLaw(self.stiffness, self.damping, self.dead_band, max_force=self.max_effort)
        per = motor.per_volt
        return DriveLaw(
            per * self.stiffness,
            per * self.damping,
            self.dead_band,
            per * motor.max_voltage,
            per * motor.torque_constant,
            min(self.max_effort, motor.torque_constant * motor.max_current),
        )

    def on(self, t: float) -> bool:
        """Whether it is on at time `t`."""
        return self.enabled is None or self.enabled(t) > 0

    def force(self, q: float, qd: float, t: float) -> float:
        """Delivered force at position `q` and velocity `qd` by the commands of time `t`."""
        return self.law.force(q, qd, *self._commands_at(t)) if self.on(t) else 0.0

    def damped(self, q: float, qd: float, t: float) -> float:
        """Decrease of that force per speed, N*m*s/rad or N*s/m."""
        return self.law.damped(q, qd, *self._commands_at(t)) if self.on(t) else 0.0

    def _commands_at(self, t: float) -> tuple[float, float]:
        """Commanded position, NaN for none, and effort."""
        return (
            math.nan if self.q_command is None else self.q_command(t),
            0.0 if self.effort is None else self.effort(t),
        )


def interpolate_series(
    times_s: ArrayLike, values: ArrayLike, how: str, over_s: float = 0.0, holding: float = 0.5
) -> Callable[[float], float]:
    """A recorded series (n,) as a function of time, by `interpolation_terms`.

    With `over_s` its mean over a window of so many seconds, centred: what a simulator with one force per step needs for
    the right impulse. NaN values were not logged. With "unknown" interpolation `holding` is the share of zero-order
    hold, the rest is smooth.
    """
    known = np.isfinite(np.asarray(values, float))
    times = [float(t) for t in np.asarray(times_s)[known]]
    rows = interpolation_terms(times, np.asarray(values, float)[known], how)
    rows[:, 1:] *= 1.0 - holding if how == "unknown" else 1.0
    spans = np.diff(times, append=times[-1])
    areas = rows / np.arange(1, 5)
    passed = [0.0, *np.cumsum(_polynomial(areas.T, spans) * spans)[:-1].tolist()]
    series, whole = rows.tolist(), areas.tolist()

    def since(t: float) -> tuple[int, float]:
        i = bisect_right(times, t) - 1
        return (i, t - times[i]) if i >= 0 else (0, 0.0)

    def value(t: float) -> float:
        i, after = since(t)
        return float(_polynomial(series[i], after))

    def integral(t: float) -> float:
        i, after = since(t)
        before = min(t - times[0], 0.0) * series[0][0]
        return passed[i] + float(_polynomial(whole[i], after)) * after + before

    if over_s <= 0:
        return value
    return lambda t: (integral(t + 0.5 * over_s) - integral(t - 0.5 * over_s)) / over_s


def interpolation_terms(times_s: ArrayLike, values: ArrayLike, how: str) -> Array:
    """(n, 4) a recorded series (n,), times rising, as cubic polynomials of the time since each row; its last value
    stays.

    "held" is zero-order hold, "linear" linear interpolation, "unknown" Catmull-Rom cubics (Catmull and Rom 1974):
    through each row with the slope of the parabola through its neighbours. Linear interpolation of a smooth motion
    loses (w dt)^2 / 12 of its amplitude, w being its angular frequency, which looks like a scale error of the sensor.
    """
    times, series = np.asarray(times_s, float), np.asarray(values, float)
    rows = np.zeros((len(series), 4))
    rows[:, 0] = series
    if how == "held" or len(series) < 2:
        return rows
    spans = np.diff(times)
    mean = np.diff(series) / spans
    if how == "linear":
        rows[:-1, 1] = mean
        return rows
    slopes = np.gradient(series, times, edge_order=2 if len(series) > 2 else 1)
    rows[:-1, 1] = slopes[:-1]
    rows[:-1, 2] = (3 * mean - 2 * slopes[:-1] - slopes[1:]) / spans
    rows[:-1, 3] = (slopes[:-1] + slopes[1:] - 2 * mean) / spans**2
    return rows


def _polynomial(terms: Any, x: Any) -> Any:
    """Cubic with four coefficients, the constant first."""
    return terms[0] + x * (terms[1] + x * (terms[2] + x * terms[3]))
