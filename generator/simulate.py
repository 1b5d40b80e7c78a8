"""The one door to a simulated asset: load it neutral, let its effects act, measure its joint, roll it out.

SAPIEN is not neutral: joint friction is a load coefficient of 0.05 by default, links lose 5 % of their speed a second,
resting bodies fall asleep, and a URDF's Coulomb friction is dropped. `load` switches all of that off. What an asset
shall lose is said by its effects, which act as they mean.

One joint moves; every other one is frozen into the part it hangs on. Time is stepped by the drift-kick-drift leapfrog
(position Verlet): the engine's semi-implicit Euler step, started half a step ahead in position. The position is kept in
double precision. The loss of speed by a
force that depends on the speed is taken exactly for constant slope (exponential Euler, Hochbruck and Ostermann 2010,
eq. 2.1 with one degree of freedom), whatever its strength. The engine knows no limits of this joint: an impact has its
own time within the step, from which the rest of the step goes on.
"""

from __future__ import annotations

import copy
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects.base import Effect, readings, strongest_rotor
from freeart21.errors import FreeArtError
from freeart21.events import drive_rebound, meet_part, part_at_limit, touching_side
from freeart21.files.asset import movable_joint
from freeart21.files.urdf import UrdfJoint, links_beyond, parsed, read_urdf_joints
from freeart21.files.urdf_files import named_file
from freeart21.joint import Joint, JointType
from freeart21.mechanics import Actuator, Body, JointMechanics, joint_inertia
from freeart21.se3 import Array

GRAVITY = (0.0, 0.0, -9.81)
"""m/s^2, world frame."""
Sway = Callable[[float, float], float]
"""Position and time to a force, N*m or N."""

_CREEP_SPEED = 1e-6  # rad/s or m/s at which the saturated damper of Coulomb friction reaches its limit
_PHASE_PER_STEP = 0.1  # rad of the stiffest oscillation per internal step: the period is then 0.04 % short (0.1^2 / 24)
_MAX_SUBSTEPS = 1000
_MASSLESS = 1.1e-6  # kg: the engine gives 1e-6 to a link without mass
WIDE = 1e4
"""rad or m: limits of the engine that no joint reaches."""
_FAST = 1e6  # rad/s or m/s: speed limits of the engine are lifted to this


@dataclass(frozen=True)
class RollOut:
    """A joint trajectory under dynamics; positions and velocities belong to the same instants."""

    times_s: NDArray[np.float64]
    """(n,) seconds from 0, both ends included."""
    q: NDArray[np.float64]
    """(n,) joint position, rad or m."""
    qd: NDArray[np.float64]
    """(n,) joint velocity, rad/s or m/s."""
    energy_j: NDArray[np.float64]
    """(n,) joules, kinetic energy plus potential energy in gravity (zero at q = 0); effects store none of it."""
    q_measured: NDArray[np.float64]
    """(n,) what a position sensor with the sensing effects writes down at these instants; q itself without any."""


class SimulatedAsset:
    """An asset in a SAPIEN scene with one moving joint and no losses but its effects. Made by `load`."""

    def __init__(self, asset: Asset, scene: Any, articulation: Any, joint: UrdfJoint, timestep_s: float):
        self.asset = asset
        self.scene = scene
        self.articulation = articulation
        self.gravity = np.array(scene.physx_system.config.gravity, float)
        """(3,) m/s^2, world frame."""
        self.timestep_s = timestep_s
        self.time_s = 0.0
        self.lower, self.upper = joint.lower, joint.upper
        self._links = {link.name: link for link in articulation.links}
        self._joint = next(j for j in articulation.active_joints if j.name == joint.name)
        self._system = scene.physx_system
        self._substeps = 1
        self._q = self._qd = self._qdd = self._engine_q = self._middle = 0.0
        self._forces: list[tuple[Any, tuple[float, ...]]] = []
        self._dampers: list[tuple[Any, tuple[float, ...]]] = []
        self._recalls: list[tuple[int, Any, tuple[float, ...]]] = []
        self._slack: Effect | None = None
        self._actuator: Actuator | None = None
        self._sway: Sway | None = None
        q = float(np.clip(0.0, joint.lower, joint.upper))
        self.set_state(q)
        pose = self._joint.global_pose.to_transformation_matrix().astype(float)
        kind: JointType = "prismatic" if self._joint.type == "prismatic" else "revolute"
        origin = pose[:3, 3] - (q * pose[:3, 0] if kind == "prismatic" else 0.0)  # the engine's frame slides along
        self.world_joint = Joint(joint.name, kind, pose[:3, 0], origin, -np.inf, np.inf)
        """The joint in the world frame, its state being q."""
        moving = _downstream(articulation, joint.child)
        self._moving_links = {link.name for link in moving}
        mechanics = [_link_mechanics(link) for link in moving]
        self.moving_mass = sum(mass for mass, _, _ in mechanics)
        """kg on the far side of the joint."""
        moment = sum((mass * centre for mass, centre, _ in mechanics), np.zeros(3))
        self._mass_moment_zero = (self.world_joint.transform(-q) @ np.append(moment, self.moving_mass))[:3]
        self.joint_inertia = joint_inertia(self.world_joint, mechanics)
        """kg*m^2 about, or kg along, the joint axis; of the links alone."""
        self._parent = joint.parent
        to_parent = se3.inverse(self.link_pose(self._parent))
        self.mechanics = JointMechanics(
            self.world_joint.moved(to_parent),
            self.moving_mass,
            self.joint_inertia,
            (to_parent @ np.append(self._mass_moment_zero, self.moving_mass))[:3],
            to_parent[:3, :3] @ self.gravity,
            _turned(_tensor(self.world_joint, mechanics), to_parent[:3, :3] @ self.world_joint.transform(-q)[:3, :3]),
        )
        """What the joint carries, in the frame of its parent link."""
        self.set_effects(asset.effects.get(asset.joint, ()))

    def set_effects(self, effects: tuple[Effect, ...]) -> None:
        """Let these effects act on the joint, instead of those that it had.

        Raises FreeArtError when a joint of this type cannot have one of them.
        """
        where = f"{self.asset.urdf} joint '{self.asset.joint}'"
        for effect in effects:
            effect.check_joint_type(self.world_joint.type, where)
        slacks = [e for e in effects if e.acts == "slack"]
        if len(slacks) > 1:
            raise FreeArtError(f"{where} has {len(slacks)} effects '{slacks[0].name}', expected at most one")
        self.effects = effects
        self._forces = [(e.law, e.values()) for e in effects if e.acts == "force"]
        forces = [e for e in effects if e.acts == "force"]
        self._dampers = [(e.law, e.values()) for e in forces if e.knows_speed]
        recalling = [(i, e) for i, e in enumerate(forces) if type(e).remember is not Effect.remember]
        self._recalls = [(i, e.remember, e.values()) for i, e in recalling]
        self._drives = [(e.law, e.values(), e.geared) for e in effects if e.acts == "drive"]
        self._needs_load = any(e.needs_load for e in effects)
        self._stops = [e for e in effects if e.acts == "stop"]
        self._poses = [e for e in effects if e.acts == "pose"]
        self._gain = float(np.prod([e.gain() for e in effects]))
        self._delay = float(np.sum([e.delay() for e in effects if e.acts == "command"]))
        self._offset = float(np.sum([e.bias_force() for e in effects]))
        added = float(np.sum([e.inertia() for e in effects]))
        self._slack = slacks[0] if slacks else None
        self._inertia = self.joint_inertia + (0.0 if self._slack else added)
        self._rotor = self._slack.rotor() if self._slack else strongest_rotor(effects)
        self._drive_inertia = self._rotor.inertia + added if self._slack else 0.0
        self._joint.set_drive_properties(stiffness=0.0, damping=0.0, force_limit=0.0, mode="force")
        self._joint.set_drive_velocity_target(0.0)
        self._joint.set_armature(np.zeros(1, np.float32))
        self._drive_limit, self._armature = 0.0, 0.0
        self._forget()
        self._plan_substeps()

    def set_actuator(self, actuator: Actuator | None) -> None:
        """Let this drive the joint from now on; None for nothing. Its times are those of `time_s`."""
        self._actuator = actuator
        self._plan_substeps()

    def set_sway(self, sway: Sway | None) -> None:
        """Let the base be moved: position and time (`time_s`) to the force that the joint feels of it, N*m or N, seen
        from the base, which stays where it is. What bearings carry of it is not counted."""
        self._sway = sway

    def _forget(self) -> None:
        """Effects with memory begin anew, from the state of now."""
        self._qdd = 0.0
        self._memories = [0.0] * len(self._forces)
        self._recall(self._q)
        self._side, self._drive_q, self._drive_qd = 0, self._q, self._qd
        self._struck = 0.0
        """Speed of an impact at a limit in this step; 0 for none."""
        self._leaving: tuple[float, float, float] | None = None
        """Time, s, at which a drive takes the part away from a limit, and the speed and acceleration with which."""

    def set_state(self, q: float, qd: float = 0.0) -> None:
        """Put the joint at position `q`, rad or m, and velocity `qd`. `q` may lie beyond the limits.

        Effects with memory forget it.
        """
        self._q, self._qd = float(q), float(qd)
        self._put(self._q)
        self.articulation.set_qvel(np.array([qd], np.float32))
        self.articulation.set_qf(np.zeros(1, np.float32))
        self._forget()

    def state(self) -> tuple[float, float]:
        """Position, rad or m, and velocity of the joint now."""
        return self._q, self._qd

    def set_base_pose(self, T_world_base: ArrayLike) -> None:
        """Put the root link's frame at (4, 4) `T_world_base`, at rest."""
        import sapien

        self.articulation.set_root_pose(sapien.Pose(np.asarray(T_world_base, np.float32)))
        self.articulation.set_root_linear_velocity(np.zeros(3, np.float32))
        self.articulation.set_root_angular_velocity(np.zeros(3, np.float32))
        self.base_moved()

    def base_moved(self) -> None:
        """Let effects that look at gravity know where the root link stands now."""
        gravity = self._engine_pose(self._parent)[:3, :3].T @ self.gravity
        self.mechanics = replace(self.mechanics, gravity=gravity)

    def link_pose(self, name: str) -> Array:
        """(4, 4) T_world_link of a link's frame, kinematic effects included; FreeArtError lists the links."""
        if name not in self._links:
            raise FreeArtError(f"{self.asset.urdf} has no link '{name}'; links: {', '.join(self._links)}")
        if self._engine_q != self._q:
            self._put(self._q)
        T = self._engine_pose(name)
        if name in self._moving_links and self._poses:
            world = self._engine_pose(self._parent)
            back = se3.inverse(world)
            for effect in reversed(self._poses):
                T = world @ effect.displacement(self._q, self.time_s, self.mechanics) @ back @ T
        return T

    def _engine_pose(self, name: str) -> Array:
        pose = self._links[name].entity_pose
        return se3.pose_from_wxyz(pose.p.astype(float), pose.q.astype(float))

    def T_reference_moving(self) -> Array:
        """(4, 4) moving link's frame in the reference link's frame."""
        return se3.inverse(self.link_pose(self.asset.reference_link)) @ self.link_pose(self.asset.moving_link)

    def step(self, force: Callable[[float], float] | None = None) -> None:
        """Advance by `timestep_s` under gravity, the effects, the actuator if one is set, and the external force(t).

        The force, N*m or N, is a push on the moving part and passes by the actuator's effects.

        Raises FreeArtError when the moving part has no mass.
        """
        h = self._system.timestep = self.timestep_s / self._substeps
        for _ in range(self._substeps):
            if self._leaving:
                self._leave(self._leaving, h)
                continue
            self.before_engine(h, force)
            self._system.step()
            self.after_engine(h, force)

    @property
    def moving_links(self) -> frozenset[str]:
        """Names of the links on the far side of the joint."""
        return frozenset(self._moving_links)

    @property
    def substeps(self) -> int:
        """Steps of the engine in one of `timestep_s`, as the stiffest effect needs them."""
        return self._substeps

    def before_engine(self, h: float, force: Callable[[float], float] | None = None) -> None:
        """The first half of a step of `h` s whose engine somebody else steps: what acts is put in.

        `step` is made of substeps of this, one step of the engine with time step `h`, and `after_engine`.
        """
        if self.joint_inertia <= 0:
            raise FreeArtError(
                f"{self.asset.urdf} joint '{self.asset.joint}' moves nothing of mass: its links have "
                "neither <inertial> nor collision geometry"
            )
        if self._leaving:
            return
        low, high = self._bounds()
        q, t = min(max(self._q + 0.5 * h * self._qd, low), high), self.time_s + 0.5 * h
        self._put(q)
        self._recall(q)
        push = force(t) if force else 0.0
        self._set_drive(q, self._qd, t, push)
        self._set_armature(q, self._qd, h)
        acting = self._acting_force(q, self._qd, t) + push
        self.articulation.set_qf(np.array([acting], np.float32))
        self._middle = q

    def after_engine(self, h: float, force: Callable[[float], float] | None = None) -> None:
        """The second half of a step: what the engine made of the speed moves the joint, limits and slack act."""
        if self._leaving:
            self._leave(self._leaving, h)
            return
        q0, qd0, t = self._q, self._qd, self.time_s + 0.5 * h
        low, high = self._bounds()
        qd = float(self.articulation.qvel[0])
        self._engine_q = float(self.articulation.qpos[0])
        self._qdd, self._struck = (qd - qd0) / h, 0.0
        self._q, self._qd = self._moved(q0, qd0, h, low, high, force(t) if force else 0.0)
        if self._slack:
            self._move_drive_side(self._slack.slack(), self._middle, qd0, t, h)
        if self._qd != qd:
            self.articulation.set_qvel(np.array([self._qd], np.float32))
        self.time_s += h

    def _bounds(self) -> tuple[float, float]:
        """The limits, or where the joint is beyond them."""
        return min(self.lower, self._q), max(self.upper, self._q)

    def _moved(self, q: float, qd: float, h: float, low: float, high: float, push: float) -> tuple[float, float]:
        """Position and velocity after `h` at the constant acceleration of this step, with an impact at a limit; `push`
        is the external force on the part."""
        a = self._qdd
        after = q + h * (qd + 0.5 * h * a)
        farthest = q - 0.5 * qd * qd / a if qd * (qd + h * a) < 0 else after
        if low <= farthest <= high and low <= after <= high:
            return after, qd + h * a
        limit, towards = (low, -1.0) if min(after, farthest) < low else (high, 1.0)
        impact = towards * np.sqrt(max(qd * qd + 2 * a * (limit - q), 0.0))
        if qd * impact > 0:
            before = 2 * (limit - q) / (qd + impact)
        else:
            before = (impact - qd) / a if a else 0.0
        before = min(max(before, 0.0), h)
        self._struck = float(impact)
        qd = max((float(e.rebound(impact)) for e in self._stops), key=abs, default=0.0)
        stays, taken, pulled = self._taken_back(limit, towards, abs(impact), self.time_s + before, push)
        if taken > abs(qd):
            qd, before, a = -towards * taken, before + stays, pulled if stays else a
            if before > h:
                self._qdd, self._leaving = 0.0, (self.time_s + before, qd, a)
                return limit, 0.0
        rest = h - before
        after = limit + rest * (qd + 0.5 * rest * a)
        if low <= after <= high and towards * (qd + 0.5 * rest * a) < 0:
            return after, qd + rest * a
        self._qdd = 0.0
        return limit, 0.0  # it would come back within the step: it stays

    def _taken_back(
        self, limit: float, towards: float, speed: float, t: float, push: float
    ) -> tuple[float, float, float]:
        """Seconds at the limit, and speed and acceleration after them, of a part whose drive takes it back."""
        rotor = self._rotor
        if not rotor.throw_back or self._slack:
            return 0.0, 0.0, 0.0
        pull = float(self.mechanics.gravity_force(limit)) + self._effect_force(limit, 0.0) + push
        pull += self._sway(limit, t) if self._sway else 0.0
        given = self._actuator_force(limit, 0.0, t)
        drive, press = towards * given, towards * pull + self._friction(limit, 0.0, abs(given - pull))
        stays, taken = drive_rebound(speed, press, drive, self._inertia - rotor.inertia, *rotor)
        return stays, taken, towards * (drive + press) / self._inertia

    def _leave(self, leaving: tuple[float, float, float], h: float) -> None:
        """Advance by `h` a part that stays at a limit until its drive takes it away."""
        when, speed, a = leaving
        self.time_s += h
        rest = self.time_s - when
        if rest <= 0:
            return
        self._q += rest * (speed + 0.5 * rest * a)
        self._qd, self._leaving = speed + rest * a, None
        self.articulation.set_qvel(np.array([self._qd], np.float32))

    def _move_drive_side(self, width: float, q: float, qd: float, t: float, h: float) -> None:
        """Advance the body on the actuator's side of a slack, after the part; forces acted at `q`, `qd`, `t`."""
        J, side, back = self._drive_inertia, self._side, self._rotor.throw_back
        if side:
            self._drive_q, self._drive_qd = self._q + 0.5 * side * width, self._qd
            if self._struck:
                self._drive_qd, self._side = part_at_limit(side, self._struck, self._struck, self._qd, back)
                if not self._side:
                    return
            push = self._actuator_force(q + 0.5 * side * width, qd, t) - J * self._qdd
        else:
            asked = self._actuator_force(self._drive_q + 0.5 * h * self._drive_qd, self._drive_qd, t)
            damping = self._actuator_damping(self._drive_q, self._drive_qd, t)
            before, push = self._drive_qd, 0.0
            self._drive_qd += h * asked / (J + h * damping)
            self._drive_q += 0.5 * h * (before + self._drive_qd)
        self._side = touching_side(side, self._drive_q, self._drive_qd, self._q, self._qd, push, width)
        if self._side and not side:
            held = self._qd == 0.0 and self._q == (self.upper if self._side > 0 else self.lower)
            self._drive_q = self._q + 0.5 * self._side * width
            self._qd, self._drive_qd, self._side = meet_part(
                self._side, self._qd, self._drive_qd, held, self._inertia, J, back, 0.0
            )

    def energy(self, q: ArrayLike, qd: ArrayLike) -> NDArray[np.float64]:
        """Joules at positions and velocities (...): kinetic, with armature, plus potential in gravity, 0 at q = 0."""
        q, qd = np.asarray(q, float), np.asarray(qd, float)
        at_zero = np.append(self._mass_moment_zero, self.moving_mass)
        moment = (self.world_joint.transform(q) @ at_zero)[..., :3]
        return 0.5 * self._inertia * qd**2 - (moment - self._mass_moment_zero) @ self.gravity

    def _put(self, q: float) -> None:
        """Let the engine stand at position `q`; its velocity stays."""
        self.articulation.set_qpos(np.array([q], np.float32))
        self._engine_q = q

    def _recall(self, q: float) -> None:
        for i, remember, values in self._recalls:
            self._memories[i] = float(remember(q, self._memories[i], *values))

    def _effect_force(self, q: float, qd: float) -> float:
        return sum(law(q, qd, 0.0, m, *v) for (law, v), m in zip(self._forces, self._memories, strict=True))

    def _actuator_force(self, q: float, qd: float, t: float) -> float:
        """What the actuator gives, by the command of as long ago as it is late."""
        when = t - self._delay
        if self._actuator is None or not self._actuator.on(when):
            return 0.0
        return self._gain * self._actuator.force(q, qd, when) + self._offset

    def _actuator_damping(self, q: float, qd: float, t: float) -> float:
        """By what that falls with speed."""
        return self._gain * self._actuator.damped(q, qd, t - self._delay) if self._actuator else 0.0

    def _acting_force(self, q: float, qd: float, t: float) -> float:
        """Effects and actuator, this as far as it touches the part."""
        acting = self._effect_force(q, qd) + (self._sway(q, t) if self._sway else 0.0)
        return acting + self._driving_force(q, qd, t)

    def _driving_force(self, q: float, qd: float, t: float) -> float:
        """What the actuator gives, as far as it touches the part."""
        if self._slack is None:
            return self._actuator_force(q, qd, t)
        if self._side:
            return self._actuator_force(q + 0.5 * self._side * self._slack.slack(), qd, t)
        return 0.0

    def _damping_slope(self, q: float, qd: float, t: float) -> float:
        """What the forces that act change by with speed, N*m*s/rad or N*s/m."""
        slope, dv = 0.0, 1e-3 * max(abs(qd), 1e-3)
        for law, values in self._dampers:
            slope += (law(q, qd + dv, 0.0, 0.0, *values) - law(q, qd - dv, 0.0, 0.0, *values)) / (2 * dv)
        if self._actuator and (self._slack is None or self._side):
            slope -= self._actuator_damping(q, qd, t)
        return slope

    def _bearing_load(self, q: float, qd: float) -> float:
        """N, as far as an effect looks at it."""
        return float(self.mechanics.load(q, qd, self._qdd)) if self._needs_load else 0.0

    def _friction(self, q: float, qd: float, carried: float) -> float:
        """Largest friction, N*m or N, where the gears carry `carried`."""
        load = self._bearing_load(q, qd)
        return float(sum(law(q, qd, carried if geared else load, 0.0, *v) for law, v, geared in self._drives))

    def _set_drive(self, q: float, qd: float, t: float, push: float) -> None:
        """The saturated damper: force -D qd cut at the limit, so stiff that it sticks (facts: exact, no chatter)."""
        if not self._drives:
            return
        carried = 0.0
        if any(geared for _, _, geared in self._drives):
            given = self._driving_force(q, qd, t)
            others = self._acting_force(q, qd, t) - given + push + float(self.mechanics.gravity_force(q))
            carried = abs(given - others)
        limit = self._friction(q, qd, carried)
        if limit != self._drive_limit:
            self._joint.set_drive_properties(
                stiffness=0.0, damping=limit / _CREEP_SPEED, force_limit=limit, mode="force"
            )
            self._drive_limit = limit

    def _set_armature(self, q: float, qd: float, h: float) -> None:
        """Make the engine's explicit step exponential: speed v' = v + h phi1(z) F / I with z = h (dF/dv) / I.

        Scaling every force by phi1(z) = (exp(z) - 1) / z is the same as an inertia I / phi1(z), which the joint's
        armature supplies: so gravity, friction and pushes keep their proportions, and so do final speeds. Inertia that
        effects add is in the armature too.
        """
        inertia = self._inertia + (self._drive_inertia if self._side else 0.0)
        inverse_phi1 = 1.0
        slope = self._damping_slope(q, qd, self.time_s + 0.5 * h)
        if slope < 0:
            z = -slope * h / inertia
            inverse_phi1 = z / -np.expm1(-z) if z > 1e-9 else 1.0
        armature = inertia * inverse_phi1 - self.joint_inertia
        if abs(armature - self._armature) > 1e-9 * self.joint_inertia:
            self._joint.set_armature(np.array([armature], np.float32))
            self._armature = armature

    def _plan_substeps(self) -> None:
        """Internal steps per `timestep_s`, such that the stiffest spring is stepped finely."""
        self._substeps = 1
        if self.joint_inertia <= 0:
            return
        stiffness = float(np.sum([e.steepness() for e in self.effects]))
        servo = self._gain * self._actuator.law.stiffness if self._actuator else 0.0
        rate = (stiffness + servo) / self._inertia
        if self._slack:
            rate = max(rate, servo / self._drive_inertia)
        self._substeps = max(1, int(np.ceil(self.timestep_s * np.sqrt(rate) / _PHASE_PER_STEP)))
        if self._substeps > _MAX_SUBSTEPS:
            raise FreeArtError(
                f"{self.asset.urdf} joint '{self.asset.joint}': effects of stiffness {stiffness + servo:.3g} on "
                f"an inertia of {self.joint_inertia:.3g} need {self._substeps} internal steps in each "
                f"of {self.timestep_s:g} s, at most {_MAX_SUBSTEPS} are made: shorten timestep_s"
            )


def load(
    asset: Asset,
    *,
    timestep_s: float = 1e-3,
    gravity: ArrayLike = GRAVITY,
    fixed_base: bool = True,
    scene: Any = None,
    visuals: bool = False,
    limited: bool = False,
) -> SimulatedAsset:
    """The asset in simulation: neutral, one joint free, its effects acting.

    Args:
        asset: what to load. Joints other than `asset.joint` are frozen at `asset.held`, or else at the position nearest
            to zero within their limits.
        timestep_s: time of one `step`, s.
        gravity: (3,) m/s^2, world frame; a given `scene` keeps its own.
        fixed_base: whether the root link is nailed to the world.
        scene: a `sapien.Scene` to load into; None makes one of physics only.
        visuals: load visual meshes too; `scene` must then be able to render.
        limited: make a joint to which the engine can be given limits later; they are out of reach (`WIDE`) until then.

    Raises FreeArtError when the URDF is not one tree with the named joint and links, a mesh file is missing, or SAPIEN
    cannot read a file. Links of the asset never collide with each other, nor with other assets loaded here.
    """
    if not timestep_s > 0:
        raise FreeArtError(f"timestep_s is {timestep_s}, expected seconds above 0")
    if visuals and scene is None:
        raise FreeArtError("visuals were asked for without a scene that can render them")
    joints = read_urdf_joints(asset.urdf)
    joint = movable_joint(asset.urdf, asset.joint)
    robot = _readable_urdf(asset, joints, visuals, keep_collisions=scene is not None)
    _check_sides(asset, joints, joint)
    if scene is None:
        scene = _physics_scene(np.asarray(gravity, np.float32))
    builder = _parse(asset.urdf, robot, scene)
    for link in builder.link_builders:
        link.collision_groups = [1, 1, 1 << 15, 0]  # a common bit of the third word: no collisions among these links
        record = link.joint_record
        if record.name in joints and record.name != joint.name and joints[record.name].joint_type:
            _freeze(record, _held_position(asset, joints[record.name]))
        elif record.name == joint.name:
            record.limits = (
                [[-WIDE, WIDE]] if limited else [[-np.inf, np.inf]]
            )  # `step` keeps them, in double precision
            if joint.joint_type == "revolute":
                record.joint_type = "revolute_unwrapped"
    try:
        articulation = builder.build(fix_root_link=fixed_base)
    except Exception as error:
        raise _unreadable(asset.urdf, error) from error
    _neutralise(articulation)
    return SimulatedAsset(asset, scene, articulation, joint, timestep_s)


def joint_motion(asset: Asset, states: ArrayLike, times_s: ArrayLike = 0.0, gravity: ArrayLike = GRAVITY) -> Array:
    """What the loaded joint does: (n, 4, 4) displacements of the moving part, in the asset's canonical frame.

    Each maps the moving part from canonical state zero to one of the canonical `states` (n,), rad or m; states beyond
    the limits are allowed. Measured from the link poses of the loaded asset, not read from the URDF; the engine's poses
    are single precision (1e-7 of the distances). Kinematic effects are in it, as at `times_s` (n,) or one for
    all, under `gravity` (3,), m/s^2 in the world frame; displacements are from where the ideal joint has the part at
    state zero.
    """
    simulated = load(asset, gravity=gravity)
    C = asset.T_canonical_reference

    def displaced(state: float, time_s: float) -> Array:
        simulated.set_state(asset.state_zero + state)
        simulated.time_s = time_s
        return C @ simulated.T_reference_moving()

    effects = simulated.effects
    simulated.set_effects(())
    zero_inverse = se3.inverse(displaced(0.0, 0.0))
    simulated.set_effects(effects)
    flat = np.asarray(states, float).reshape(-1)
    times = np.broadcast_to(np.asarray(times_s, float), flat.shape)
    if not len(flat):
        return np.zeros((0, 4, 4))
    return np.stack([displaced(float(q), float(t)) @ zero_inverse for q, t in zip(flat, times, strict=True)])


def roll_out(
    asset: Asset | SimulatedAsset,
    q0: float,
    qd0: float = 0.0,
    *,
    duration_s: float,
    timestep_s: float = 1e-3,
    gravity: ArrayLike = GRAVITY,
    force: Callable[[float], float] | None = None,
    actuator: Actuator | None = None,
    sway: Sway | None = None,
) -> RollOut:
    """The joint's trajectory from position `q0` and velocity `qd0` (rad or m, URDF joint values), base fixed.

    Args:
        asset: an asset to load, or a loaded one to use again (which keeps its own time step and gravity).
        q0: start position.
        qd0: start velocity.
        duration_s: seconds; rounded to whole steps.
        timestep_s: seconds a step, one sample a step.
        gravity: (3,) m/s^2.
        force: seconds since the start to an external generalised force on the joint, N*m or N.
        actuator: what drives the joint, through the effects that an actuator has; its times are since the start.
        sway: what the joint feels of a base that is moved, see `SimulatedAsset.set_sway`.

    Raises FreeArtError when the moving part has no mass, or the start lies beyond the limits.
    """
    simulated = asset if isinstance(asset, SimulatedAsset) else load(asset, timestep_s=timestep_s, gravity=gravity)
    where = f"{simulated.asset.urdf} joint '{simulated.asset.joint}'"
    slack = 1e-6 * max(1.0, abs(q0))
    if not simulated.lower - slack <= q0 <= simulated.upper + slack:
        raise FreeArtError(
            f"{where} starts at {q0:g}, expected within its limits {simulated.lower:g} to {simulated.upper:g}"
        )
    n = round(duration_s / simulated.timestep_s)
    simulated.set_state(q0, qd0)
    simulated.time_s = 0.0
    simulated.set_actuator(actuator)
    simulated.set_sway(sway)
    states = np.empty((n + 1, 2))
    states[0] = q0, qd0
    try:
        for i in range(n):
            simulated.step(force)
            states[i + 1] = simulated.state()
    finally:
        simulated.set_actuator(None)
        simulated.set_sway(None)
    q, qd = states[:, 0].copy(), states[:, 1].copy()
    times = np.arange(n + 1, dtype=float) * simulated.timestep_s
    return RollOut(times, q, qd, simulated.energy(q, qd), readings(simulated.effects, times, q))


def _physics_scene(gravity: NDArray[np.float32]) -> Any:
    """A scene that needs no graphics device. The engine takes gravity from a process-wide setting, put back here."""
    import sapien

    before = sapien.physx.get_scene_config()
    mine = copy.copy(before)
    mine.gravity = gravity
    sapien.physx.set_scene_config(mine)
    try:
        return sapien.Scene([sapien.physx.PhysxCpuSystem()])
    finally:
        sapien.physx.set_scene_config(before)


def _parse(urdf: Path, robot: ET.Element, scene: Any) -> Any:
    """SAPIEN's articulation builder of the rewritten URDF."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "asset.urdf"
        ET.ElementTree(robot).write(path, encoding="utf-8")
        try:
            articulations, actors, _ = scene.create_urdf_loader().parse(str(path))
        except Exception as error:
            raise _unreadable(urdf, error) from error
    if len(articulations) != 1 or actors:
        raise FreeArtError(
            f"{urdf} holds {len(articulations)} articulations and {len(actors)} loose bodies, expected one articulation"
        )
    return articulations[0]


def _unreadable(urdf: Path, error: Exception) -> FreeArtError:
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return FreeArtError(f"{urdf} cannot be loaded by SAPIEN: {lines[0]}")


def _neutralise(articulation: Any) -> None:
    """Switch off every loss and limit of the engine's own."""
    articulation.set_sleep_threshold(0.0)
    for link in articulation.links:
        link.set_linear_damping(0.0)
        link.set_angular_damping(0.0)
        link.set_max_linear_velocity(_FAST)
        link.set_max_angular_velocity(_FAST)
    for joint in articulation.active_joints:
        joint.set_friction(0.0)
        joint.set_armature(np.zeros(joint.dof, np.float32))
        joint.set_max_velocity(_FAST)


def _freeze(record: Any, q: float) -> None:
    """Turn a movable joint of a builder into a fixed one at position `q`: its axis is the x axis of its frame."""
    import sapien

    motion = se3.exp_se3(np.eye(6)[0] * q if record.joint_type == "prismatic" else np.eye(6)[3] * q)
    record.pose_in_parent = record.pose_in_parent * sapien.Pose(motion.astype(np.float32))
    record.joint_type, record.limits = "fixed", []


def _held_position(asset: Asset, joint: UrdfJoint) -> float:
    return asset.held.get(joint.name, float(np.clip(0.0, joint.lower, joint.upper)))


def _downstream(articulation: Any, first: str) -> list[Any]:
    """The link named `first` and all links that hang on it."""
    names = {first}
    links = []
    for link in articulation.links:  # parents come before children
        if link.name in names or (link.parent is not None and link.parent.name in names):
            names.add(link.name)
            links.append(link)
    return links


def _link_mechanics(link: Any) -> Body:
    """Of a link, world frame."""
    frame = (link.entity_pose * link.cmass_local_pose).to_transformation_matrix().astype(float)
    R = frame[:3, :3]
    if link.mass < _MASSLESS:
        return 0.0, frame[:3, 3], np.zeros((3, 3))
    return float(link.mass), frame[:3, 3], R @ np.diag(link.inertia.astype(float)) @ R.T


def _tensor(joint: Joint, mechanics: list[Body]) -> Array:
    """(3, 3) kg*m^2 of links about the joint's pivot."""
    total = np.zeros((3, 3))
    for mass, centre, inertia in mechanics:
        arm = centre - joint.pivot
        total += inertia + mass * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
    return total


def _turned(tensor: Array, R: Array) -> Array:
    return np.asarray(R @ tensor @ R.T)


def _check_sides(asset: Asset, joints: dict[str, UrdfJoint], joint: UrdfJoint) -> None:
    """Reference and moving link must hang on different sides of the joint."""
    beyond = links_beyond(joints, joint.child)
    if (asset.reference_link in beyond) == (asset.moving_link in beyond):
        raise FreeArtError(
            f"{asset.urdf}: links '{asset.reference_link}' and '{asset.moving_link}' are on the same "
            f"side of joint '{joint.name}', expected one on each side"
        )


def _readable_urdf(asset: Asset, joints: dict[str, UrdfJoint], visuals: bool, keep_collisions: bool) -> ET.Element:
    """The URDF as SAPIEN can read it from anywhere: absolute file names, full limits, no more than it needs."""
    root = parsed(asset.urdf)
    for element in list(root):
        if element.tag not in ("link", "joint", "material"):
            root.remove(element)
    links = [link.get("name", "") for link in root.findall("link")]
    _check_tree(asset, joints, links)
    for file in [*root.iter("mesh"), *root.iter("texture")]:
        file.set("filename", str(named_file(asset.urdf, file.get("filename", ""), asset.root)))
    dropped = () if visuals else ("visual",)
    for link in root.findall("link"):
        weighed = float(_attribute(link, "inertial/mass", "value", "0")) > 0
        for child in list(link):
            if child.tag in dropped or (child.tag == "collision" and weighed and not keep_collisions):
                link.remove(child)
    for element in root.findall("joint"):
        for child in [c for c in element if c.tag in ("mimic", "dynamics", "limit")]:
            element.remove(child)
        joint = joints[element.get("name", "")]
        if joint.type in ("revolute", "prismatic"):
            ET.SubElement(element, "limit", {"lower": repr(joint.lower), "upper": repr(joint.upper)})
    return root


def _attribute(element: ET.Element, path: str, name: str, default: str) -> str:
    found = element.find(path)
    return default if found is None else found.get(name, default)


def _check_tree(asset: Asset, joints: dict[str, UrdfJoint], links: list[str]) -> None:
    """One root, every link once and hung once, the asset's links and joint types known."""
    if len(set(links)) != len(links):
        twice = next(name for name in links if links.count(name) > 1)
        raise FreeArtError(f"{asset.urdf} has link '{twice}' {links.count(twice)} times, expected unique names")
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link not in links:
                raise FreeArtError(f"{asset.urdf}: joint '{joint.name}' names link '{link}'; links: {', '.join(links)}")
        if joint.joint_type is None and joint.type != "fixed":
            raise FreeArtError(
                f"{asset.urdf}: joint '{joint.name}' has type '{joint.type}', expected fixed, revolute, "
                "continuous or prismatic"
            )
    children = [joint.child for joint in joints.values()]
    roots = [link for link in links if link not in children]
    if len(roots) != 1 or len(set(children)) != len(children):
        raise FreeArtError(
            f"{asset.urdf} is not one tree: its roots are {', '.join(roots) or 'none'}, expected one, "
            "and every other link the child of one joint"
        )
    for link in (asset.reference_link, asset.moving_link):
        if link not in links:
            raise FreeArtError(f"{asset.urdf} has no link '{link}'; links: {', '.join(links)}")
