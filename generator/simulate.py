"""Simulates an asset: loads it without losses of the engine's own, applies its effects, and rolls its joint out.

SAPIEN adds losses by default: a joint friction coefficient of 0.05, 5 % loss of link speed per second, sleeping bodies;
and it drops a URDF's Coulomb friction. `load` switches all of that off. The asset loses energy by its effects alone.

One joint moves; every other joint is frozen. The state (q, qd) of the joint is kept here, in double precision: the
engine's single-precision positions shift slow motion by up to 5 %. A step of h seconds is

    drift    q_mid = q + h/2 qd
    kick     the engine, placed at q_mid, computes the new velocity from gravity and all forces at q_mid
    drift    q moves with the constant acceleration (qd_new - qd) / h; impacts at limits have their own time in the step

that is, the drift-kick-drift leapfrog (position Verlet). Forces that depend on speed are integrated exactly for a
constant slope dF/dqd (exponential Euler, Hochbruck and Ostermann 2010, eq. 2.1 with one degree of freedom), see
`SimulatedAsset._set_armature`. Coulomb friction is the joint's drive in the engine, see `_set_friction`. Limits and
backlash (the effect that `acts` as "slack") are handled here, by `freeart21.events`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects.base import Effect, readings, strongest_rotor
from freeart21.errors import FreeArtError
from freeart21.events import drive_rebound, meet_part, part_at_limit, touching_side
from freeart21.files.asset import find_movable_joint
from freeart21.files.urdf import UrdfJoint, read_urdf
from freeart21.joint import Joint, JointType
from freeart21.mechanics import Actuator, Body, JointMechanics, joint_inertia
from freeart21.se3 import Array
from generator.sapien_asset import UNREACHED, build_articulation, links_from, physics_scene

__all__ = ["GRAVITY", "UNREACHED", "BaseForce", "RollOut", "SimulatedAsset", "joint_motion", "load", "roll_out"]

GRAVITY = (0.0, 0.0, -9.81)
"""m/s^2, world frame."""
Force = Callable[[float], float]
"""Time, s, to a generalised force on the joint, N*m or N."""
BaseForce = Callable[[float, float], float]
"""Joint position and time to the generalised force that the joint feels because its base moves, N*m or N."""

_CREEP_SPEED = 1e-6  # rad/s or m/s at which the saturated damper that stands for Coulomb friction reaches its limit
_PHASE_PER_STEP = 0.1  # rad of the stiffest oscillation per internal step: the period is then 0.04 % short (0.1^2 / 24)
_MAX_SUBSTEPS = 1000
_MASSLESS = 1.1e-6  # kg: the engine gives 1e-6 to a link without mass


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
    """(n,) reading of a position sensor with the asset's sensing effects; equals q without any."""


class _Departure(NamedTuple):
    """A drive will pull the part away from the limit where it now rests."""

    time_s: float
    velocity: float
    acceleration: float


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
        self._q = self._qd = self._qdd = 0.0
        self._engine_q = self._middle_q = 0.0
        self._force_laws: list[tuple[Any, tuple[float, ...]]] = []
        self._memory_laws: list[tuple[int, Any, tuple[float, ...]]] = []
        self._slack: Effect | None = None
        self._actuator: Actuator | None = None
        self._base_force: BaseForce | None = None
        q = float(np.clip(0.0, joint.lower, joint.upper))
        self.set_state(q)
        self.world_joint = self._read_joint(joint.name, q)
        """The joint in the world frame, its state being q."""
        moving = links_from(articulation, joint.child)
        self._moving_links = {link.name for link in moving}
        bodies = [_rigid_body(link) for link in moving]
        self.moving_mass = sum(mass for mass, _, _ in bodies)
        """kg on the far side of the joint."""
        moment = sum((mass * centre for mass, centre, _ in bodies), np.zeros(3))
        self._moment_at_zero = (self.world_joint.transform(-q) @ np.append(moment, self.moving_mass))[:3]
        self.joint_inertia = joint_inertia(self.world_joint, bodies)
        """kg*m^2 about, or kg along, the joint axis; of the links alone."""
        self._parent = joint.parent
        T_parent_world = se3.inverse(self.link_pose(self._parent))
        R = T_parent_world[:3, :3] @ self.world_joint.transform(-q)[:3, :3]
        self.mechanics = JointMechanics(
            self.world_joint.moved(T_parent_world),
            self.moving_mass,
            self.joint_inertia,
            (T_parent_world @ np.append(self._moment_at_zero, self.moving_mass))[:3],
            T_parent_world[:3, :3] @ self.gravity,
            np.asarray(R @ _inertia_about_pivot(self.world_joint, bodies) @ R.T),
        )
        """Mass, inertia and gravity of the moving side, in the frame of the joint's parent link."""
        self.set_effects(asset.effects.get(asset.joint, ()))

    def _read_joint(self, name: str, q: float) -> Joint:
        """The joint as the engine has it in the world while it stands at position `q`."""
        pose = self._joint.global_pose.to_transformation_matrix().astype(float)
        kind: JointType = "prismatic" if self._joint.type == "prismatic" else "revolute"
        pivot = pose[:3, 3] - (q * pose[:3, 0] if kind == "prismatic" else 0.0)  # the engine's frame slides with q
        return Joint(name, kind, pose[:3, 0], pivot, -np.inf, np.inf)

    # --- what acts ----------------------------------------------------------------------------------------------------

    def set_effects(self, effects: tuple[Effect, ...]) -> None:
        """Replace the joint's effects. Raises FreeArtError when a joint of this type cannot have one of them."""
        where = f"{self.asset.urdf} joint '{self.asset.joint}'"
        for effect in effects:
            effect.check_joint_type(self.world_joint.type, where)
        slacks = [e for e in effects if e.acts == "slack"]
        if len(slacks) > 1:
            raise FreeArtError(f"{where} has {len(slacks)} effects '{slacks[0].name}', expected at most one")
        self.effects = effects
        forces = [e for e in effects if e.acts == "force"]
        self._force_laws = [(e.law, e.values()) for e in forces]
        self._speed_laws = [(e.law, e.values()) for e in forces if e.speed_dependent]
        with_memory = [(i, e) for i, e in enumerate(forces) if type(e).remember is not Effect.remember]
        self._memory_laws = [(i, e.remember, e.values()) for i, e in with_memory]
        self._friction_laws = [(e.law, e.values(), e.geared) for e in effects if e.acts == "drive"]
        self._needs_load = any(e.needs_load for e in effects)
        self._stop_effects = [e for e in effects if e.acts == "stop"]
        self._pose_effects = [e for e in effects if e.acts == "pose"]
        self._gain = float(np.prod([e.gain() for e in effects]))
        self._delay_s = float(np.sum([e.delay() for e in effects if e.acts == "command"]))
        self._bias_force = float(np.sum([e.bias_force() for e in effects]))
        added = float(np.sum([e.added_inertia() for e in effects]))
        self._slack = slacks[0] if slacks else None
        self._inertia = self.joint_inertia + (0.0 if self._slack else added)
        self._rotor = self._slack.rotor() if self._slack else strongest_rotor(effects)
        self._drive_inertia = self._rotor.inertia + added if self._slack else 0.0
        self._joint.set_drive_properties(stiffness=0.0, damping=0.0, force_limit=0.0, mode="force")
        self._joint.set_drive_velocity_target(0.0)
        self._joint.set_armature(np.zeros(1, np.float32))
        self._friction_limit, self._armature = 0.0, 0.0
        self._reset_memory()
        self._plan_substeps()

    def set_actuator(self, actuator: Actuator | None) -> None:
        """Drive the joint by this actuator, whose times are those of `time_s`; None for no actuator."""
        self._actuator = actuator
        self._plan_substeps()

    def set_base_force(self, base_force: BaseForce | None) -> None:
        """Apply the force that a moving base exerts on the joint, in the base's frame; the base itself stays at rest.

        The load on the bearing does not include it.
        """
        self._base_force = base_force

    # --- state --------------------------------------------------------------------------------------------------------

    def set_state(self, q: float, qd: float = 0.0) -> None:
        """Set position `q`, rad or m, and velocity `qd`. `q` may be outside the limits. Resets effects with memory."""
        self._q, self._qd = float(q), float(qd)
        self._place_engine(self._q)
        self.articulation.set_qvel(np.array([qd], np.float32))
        self.articulation.set_qf(np.zeros(1, np.float32))
        self._reset_memory()

    def state(self) -> tuple[float, float]:
        """Position, rad or m, and velocity of the joint now."""
        return self._q, self._qd

    def _reset_memory(self) -> None:
        """Restart effects with memory, slack and events from the present state."""
        self._qdd = 0.0
        self._memories = [0.0] * len(self._force_laws)
        self._update_memories(self._q)
        self._side = 0
        """Side on which the drive side of a slack touches the part: 1 ahead, -1 behind, 0 apart."""
        self._drive_q, self._drive_qd = self._q, self._qd
        self._impact_velocity = 0.0
        """Velocity of an impact at a limit in this step; 0 for none."""
        self._departure: _Departure | None = None

    def set_base_pose(self, T_world_base: ArrayLike) -> None:
        """Put the root link's frame at (4, 4) `T_world_base`, at rest."""
        import sapien

        self.articulation.set_root_pose(sapien.Pose(np.asarray(T_world_base, np.float32)))
        self.articulation.set_root_linear_velocity(np.zeros(3, np.float32))
        self.articulation.set_root_angular_velocity(np.zeros(3, np.float32))
        self.update_gravity()

    def update_gravity(self) -> None:
        """Update the direction of gravity in `mechanics` after the root link has moved."""
        gravity = self._engine_pose(self._parent)[:3, :3].T @ self.gravity
        self.mechanics = replace(self.mechanics, gravity=gravity)

    def link_pose(self, name: str) -> Array:
        """(4, 4) T_world_link of a link's frame, kinematic effects included; FreeArtError for an unknown link."""
        if name not in self._links:
            raise FreeArtError(f"{self.asset.urdf} has no link '{name}'; links: {', '.join(self._links)}")
        if self._engine_q != self._q:
            self._place_engine(self._q)
        T = self._engine_pose(name)
        if name in self._moving_links and self._pose_effects:
            T_world_parent = self._engine_pose(self._parent)
            T_parent_world = se3.inverse(T_world_parent)
            for effect in reversed(self._pose_effects):
                displacement = effect.displacement(self._q, self.time_s, self.mechanics)
                T = T_world_parent @ displacement @ T_parent_world @ T
        return T

    def T_reference_moving(self) -> Array:
        """(4, 4) moving link's frame in the reference link's frame."""
        return se3.inverse(self.link_pose(self.asset.reference_link)) @ self.link_pose(self.asset.moving_link)

    @property
    def moving_links(self) -> frozenset[str]:
        """Names of the links on the far side of the joint."""
        return frozenset(self._moving_links)

    def energy(self, q: ArrayLike, qd: ArrayLike) -> NDArray[np.float64]:
        """Joules at positions and velocities (...): kinetic, with armature, plus potential in gravity, 0 at q = 0."""
        q, qd = np.asarray(q, float), np.asarray(qd, float)
        at_zero = np.append(self._moment_at_zero, self.moving_mass)
        moment = (self.world_joint.transform(q) @ at_zero)[..., :3]
        return np.asarray(0.5 * self._inertia * qd**2 - (moment - self._moment_at_zero) @ self.gravity)

    def _engine_pose(self, name: str) -> Array:
        pose = self._links[name].entity_pose
        return se3.pose_from_wxyz(pose.p.astype(float), pose.q.astype(float))

    def _place_engine(self, q: float) -> None:
        """Set the engine's position; its velocity stays."""
        self.articulation.set_qpos(np.array([q], np.float32))
        self._engine_q = q

    # --- one step -----------------------------------------------------------------------------------------------------

    def step(self, force: Force | None = None) -> None:
        """Advance by `timestep_s` under gravity, effects, actuator and the external `force`.

        `force` pushes the moving part directly; the actuator's effects do not change it. Raises FreeArtError when the
        moving part has no mass.
        """
        h = self._system.timestep = self.timestep_s / self._substeps
        for _ in range(self._substeps):
            if self._departure:
                self._wait_at_limit(self._departure, h)
                continue
            self.before_engine(h, force)
            self._system.step()
            self.after_engine(h, force)

    @property
    def substeps(self) -> int:
        """Engine steps per `timestep_s`, as the stiffest effect needs them."""
        return self._substeps

    def before_engine(self, h: float, force: Force | None = None) -> None:
        """First half of a substep of `h` s: place the engine and set all that acts.

        A substep of `step` is this, one engine step of length `h`, and `after_engine`. The caller who steps the engine
        himself (ManiSkill) calls both.
        """
        if self.joint_inertia <= 0:
            raise FreeArtError(
                f"{self.asset.urdf} joint '{self.asset.joint}' moves nothing of mass: its links have "
                "neither <inertial> nor collision geometry"
            )
        if self._departure:
            return
        low, high = self._bounds()
        q, t = min(max(self._q + 0.5 * h * self._qd, low), high), self.time_s + 0.5 * h
        self._place_engine(q)
        self._update_memories(q)
        push = force(t) if force else 0.0
        self._set_friction(q, self._qd, t, push)
        self._set_armature(q, self._qd, h)
        acting = self._acting_force(q, self._qd, t) + push
        self.articulation.set_qf(np.array([acting], np.float32))
        self._middle_q = q

    def after_engine(self, h: float, force: Force | None = None) -> None:
        """Second half of a substep: move the joint by the engine's new velocity; limits and slack act."""
        if self._departure:
            self._wait_at_limit(self._departure, h)
            return
        q0, qd0, t = self._q, self._qd, self.time_s + 0.5 * h
        low, high = self._bounds()
        qd = float(self.articulation.qvel[0])
        self._engine_q = float(self.articulation.qpos[0])
        self._qdd, self._impact_velocity = (qd - qd0) / h, 0.0
        self._q, self._qd = self._advance_part(q0, qd0, h, low, high, force(t) if force else 0.0)
        if self._slack:
            self._advance_drive_side(self._slack.slack(), self._middle_q, qd0, t, h)
        if self._qd != qd:
            self.articulation.set_qvel(np.array([self._qd], np.float32))
        self.time_s += h

    def _bounds(self) -> tuple[float, float]:
        """The limits, extended to the present position where it is outside."""
        return min(self.lower, self._q), max(self.upper, self._q)

    def _advance_part(self, q: float, qd: float, h: float, low: float, high: float, push: float) -> tuple[float, float]:
        """Position and velocity of the part after `h` at constant acceleration, with an impact at a limit.

        `push` is the external force on the part.
        """
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
        self._impact_velocity = float(impact)
        qd = max((float(e.rebound(impact)) for e in self._stop_effects), key=abs, default=0.0)
        rest, speed, acceleration = self._rebound_of_drive(limit, towards, abs(impact), self.time_s + before, push)
        if speed > abs(qd):
            qd, before, a = -towards * speed, before + rest, acceleration if rest else a
            if before > h:
                self._qdd, self._departure = 0.0, _Departure(self.time_s + before, qd, a)
                return limit, 0.0
        remaining = h - before
        after = limit + remaining * (qd + 0.5 * remaining * a)
        if low <= after <= high and towards * (qd + 0.5 * remaining * a) < 0:
            return after, qd + remaining * a
        self._qdd = 0.0
        return limit, 0.0  # it would return to the limit within this step: it stays there

    def _rebound_of_drive(
        self, limit: float, towards: float, impact_speed: float, t: float, push: float
    ) -> tuple[float, float, float]:
        """Seconds that the part rests at the limit, then its speed and acceleration away from it; zeros for none.

        A drive whose rotor is flexibly coupled pulls the part back after an impact (`freeart21.events.drive_rebound`).
        """
        rotor = self._rotor
        if not rotor.throw_back or self._slack:
            return 0.0, 0.0, 0.0
        others = float(self.mechanics.gravity_force(limit)) + self._effect_force(limit, 0.0) + push
        others += self._base_force(limit, t) if self._base_force else 0.0
        motor = self._actuator_force(limit, 0.0, t)
        drive = towards * motor
        press = towards * others + self._friction(limit, 0.0, abs(motor - others))
        rest, speed = drive_rebound(impact_speed, press, drive, self._inertia - rotor.inertia, *rotor)
        return rest, speed, towards * (drive + press) / self._inertia

    def _wait_at_limit(self, departure: _Departure, h: float) -> None:
        """Advance by `h` a part that rests at a limit until its drive pulls it away."""
        self.time_s += h
        since = self.time_s - departure.time_s
        if since <= 0:
            return
        self._q += since * (departure.velocity + 0.5 * since * departure.acceleration)
        self._qd, self._departure = departure.velocity + since * departure.acceleration, None
        self.articulation.set_qvel(np.array([self._qd], np.float32))

    def _advance_drive_side(self, width: float, q: float, qd: float, t: float, h: float) -> None:
        """Advance the body on the actuator's side of a slack of `width`, after the part.

        `q`, `qd`, `t` are the position, velocity and time at which the forces of this step acted.
        """
        J, side, throw_back = self._drive_inertia, self._side, self._rotor.throw_back
        if side:
            self._drive_q, self._drive_qd = self._q + 0.5 * side * width, self._qd
            if self._impact_velocity:
                impact = self._impact_velocity
                self._drive_qd, self._side = part_at_limit(side, impact, impact, self._qd, throw_back)
                if not self._side:
                    return
            push = self._actuator_force(q + 0.5 * side * width, qd, t) - J * self._qdd
        else:
            motor = self._actuator_force(self._drive_q + 0.5 * h * self._drive_qd, self._drive_qd, t)
            damping = self._actuator_damping(self._drive_q, self._drive_qd, t)
            before, push = self._drive_qd, 0.0
            self._drive_qd += h * motor / (J + h * damping)
            self._drive_q += 0.5 * h * (before + self._drive_qd)
        self._side = touching_side(side, self._drive_q, self._drive_qd, self._q, self._qd, push, width)
        if self._side and not side:
            at_limit = self._qd == 0.0 and self._q == (self.upper if self._side > 0 else self.lower)
            self._drive_q = self._q + 0.5 * self._side * width
            self._qd, self._drive_qd, self._side = meet_part(
                self._side, self._qd, self._drive_qd, at_limit, self._inertia, J, throw_back, 0.0
            )

    # --- forces -------------------------------------------------------------------------------------------------------

    def _update_memories(self, q: float) -> None:
        for i, remember, values in self._memory_laws:
            self._memories[i] = float(remember(q, self._memories[i], *values))

    def _effect_force(self, q: float, qd: float) -> float:
        """Sum of the effects that act as "force", N*m or N."""
        laws = zip(self._force_laws, self._memories, strict=True)
        return float(sum(law(q, qd, 0.0, m, *v) for (law, v), m in laws))

    def _actuator_force(self, q: float, qd: float, t: float) -> float:
        """The actuator's force at position `q` of its side, from the delayed command."""
        commanded_at = t - self._delay_s
        if self._actuator is None or not self._actuator.on(commanded_at):
            return 0.0
        return self._gain * self._actuator.force(q, qd, commanded_at) + self._bias_force

    def _actuator_damping(self, q: float, qd: float, t: float) -> float:
        """-d(actuator force)/d(qd), N*m*s/rad or N*s/m."""
        return self._gain * self._actuator.damped(q, qd, t - self._delay_s) if self._actuator else 0.0

    def _transmitted_force(self, q: float, qd: float, t: float) -> float:
        """The actuator's force on the part: none while a slack is open."""
        if self._slack is None:
            return self._actuator_force(q, qd, t)
        if self._side:
            return self._actuator_force(q + 0.5 * self._side * self._slack.slack(), qd, t)
        return 0.0

    def _acting_force(self, q: float, qd: float, t: float) -> float:
        """Effects, base motion and actuator on the part, N*m or N; without gravity, friction and pushes."""
        acting = self._effect_force(q, qd) + (self._base_force(q, t) if self._base_force else 0.0)
        return acting + self._transmitted_force(q, qd, t)

    def _damping_slope(self, q: float, qd: float, t: float) -> float:
        """dF/d(qd) of effects and actuator, N*m*s/rad or N*s/m."""
        slope, dv = 0.0, 1e-3 * max(abs(qd), 1e-3)
        for law, values in self._speed_laws:
            slope += (law(q, qd + dv, 0.0, 0.0, *values) - law(q, qd - dv, 0.0, 0.0, *values)) / (2 * dv)
        if self._actuator and (self._slack is None or self._side):
            slope -= self._actuator_damping(q, qd, t)
        return slope

    def _friction(self, q: float, qd: float, gear_load: float) -> float:
        """Largest friction, N*m or N; `gear_load` is what the gears carry, N*m or N."""
        load = float(self.mechanics.load(q, qd, self._qdd)) if self._needs_load else 0.0
        return float(sum(law(q, qd, gear_load if geared else load, 0.0, *v) for law, v, geared in self._friction_laws))

    def _set_friction(self, q: float, qd: float, t: float, push: float) -> None:
        """Set Coulomb friction as the engine's joint drive: the damper -D qd, saturated at the friction limit.

        D is so large that the joint sticks; measured, that is exact and free of chatter.
        """
        if not self._friction_laws:
            return
        gear_load = 0.0
        if any(geared for _, _, geared in self._friction_laws):
            motor = self._transmitted_force(q, qd, t)
            others = self._acting_force(q, qd, t) - motor + push + float(self.mechanics.gravity_force(q))
            gear_load = abs(motor - others)
        limit = self._friction(q, qd, gear_load)
        if limit != self._friction_limit:
            self._joint.set_drive_properties(
                stiffness=0.0, damping=limit / _CREEP_SPEED, force_limit=limit, mode="force"
            )
            self._friction_limit = limit

    def _set_armature(self, q: float, qd: float, h: float) -> None:
        """Make the engine's explicit step exponential: v' = v + h phi1(z) F / I, with z = h (dF/dv) / I.

        Scaling all forces by phi1(z) = (exp(z) - 1) / z equals an inertia of I / phi1(z). The joint's armature supplies
        it, so that gravity, friction and pushes keep their proportions, and final speeds are right. The armature also
        holds the inertia that effects add.
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
        """Choose the engine steps per `timestep_s` so that the stiffest spring turns `_PHASE_PER_STEP` rad in each."""
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
    settable_limits: bool = False,
) -> SimulatedAsset:
    """Load an asset for simulation: one joint free, its effects acting, no other losses.

    Args:
        asset: what to load. Joints other than `asset.joint` are frozen at `asset.held`, or else at the position nearest
            to zero within their limits.
        timestep_s: time of one `step`, s.
        gravity: (3,) m/s^2, world frame; a given `scene` keeps its own.
        fixed_base: fix the root link to the world.
        scene: a `sapien.Scene` to load into; None makes one of physics only.
        visuals: load visual meshes too; `scene` must then be able to render.
        settable_limits: make a joint to which the engine can be given limits later; they are `UNREACHED` until then.

    Links of assets never collide with each other. Raises FreeArtError when the URDF is not one tree with the named
    joint and links, a mesh file is missing, or SAPIEN cannot read a file.
    """
    if not timestep_s > 0:
        raise FreeArtError(f"timestep_s is {timestep_s}, expected seconds above 0")
    if visuals and scene is None:
        raise FreeArtError("visuals were asked for without a scene that can render them")
    urdf = read_urdf(asset.urdf)
    joint = find_movable_joint(asset.urdf, asset.joint)
    collisions = scene is not None
    scene = physics_scene(np.asarray(gravity, np.float32)) if scene is None else scene
    articulation = build_articulation(
        asset,
        urdf,
        joint,
        scene,
        fixed_base=fixed_base,
        visuals=visuals,
        collisions=collisions,
        settable_limits=settable_limits,
    )
    return SimulatedAsset(asset, scene, articulation, joint, timestep_s)


def joint_motion(asset: Asset, states: ArrayLike, times_s: ArrayLike = 0.0, gravity: ArrayLike = GRAVITY) -> Array:
    """(n, 4, 4) displacements of the moving part in the loaded asset, in the asset's canonical frame.

    Each maps the moving part from canonical state zero of the ideal joint to one of the canonical `states` (n,), rad or
    m. States outside the limits are allowed. The displacements are measured from the link poses of the loaded asset,
    not read from the URDF; the engine's poses are single precision (1e-7 of the distances). They include kinematic
    effects at `times_s` (n,), or one time for all, under `gravity` (3,), m/s^2 in the world frame.
    """
    simulated = load(asset, gravity=gravity)
    C = asset.T_canonical_reference

    def pose_at(state: float, time_s: float) -> Array:
        simulated.set_state(asset.state_zero + state)
        simulated.time_s = time_s
        return C @ simulated.T_reference_moving()

    effects = simulated.effects
    simulated.set_effects(())
    zero_inverse = se3.inverse(pose_at(0.0, 0.0))
    simulated.set_effects(effects)
    flat = np.asarray(states, float).reshape(-1)
    times = np.broadcast_to(np.asarray(times_s, float), flat.shape)
    if not len(flat):
        return np.zeros((0, 4, 4))
    return np.stack([pose_at(float(q), float(t)) @ zero_inverse for q, t in zip(flat, times, strict=True)])


def roll_out(
    asset: Asset | SimulatedAsset,
    q0: float,
    qd0: float = 0.0,
    *,
    duration_s: float,
    timestep_s: float = 1e-3,
    gravity: ArrayLike = GRAVITY,
    force: Force | None = None,
    actuator: Actuator | None = None,
    base_force: BaseForce | None = None,
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
        actuator: drives the joint, through the effects of an actuator; its times are seconds since the start.
        base_force: force on the joint because its base moves, see `SimulatedAsset.set_base_force`.

    Raises FreeArtError when the moving part has no mass, or the start is outside the limits.
    """
    simulated = asset if isinstance(asset, SimulatedAsset) else load(asset, timestep_s=timestep_s, gravity=gravity)
    where = f"{simulated.asset.urdf} joint '{simulated.asset.joint}'"
    tolerance = 1e-6 * max(1.0, abs(q0))
    if not simulated.lower - tolerance <= q0 <= simulated.upper + tolerance:
        raise FreeArtError(
            f"{where} starts at {q0:g}, expected within its limits {simulated.lower:g} to {simulated.upper:g}"
        )
    n = round(duration_s / simulated.timestep_s)
    simulated.set_state(q0, qd0)
    simulated.time_s = 0.0
    simulated.set_actuator(actuator)
    simulated.set_base_force(base_force)
    states = np.empty((n + 1, 2))
    states[0] = q0, qd0
    try:
        for i in range(n):
            simulated.step(force)
            states[i + 1] = simulated.state()
    finally:
        simulated.set_actuator(None)
        simulated.set_base_force(None)
    q, qd = states[:, 0].copy(), states[:, 1].copy()
    times = np.arange(n + 1, dtype=float) * simulated.timestep_s
    return RollOut(times, q, qd, simulated.energy(q, qd), readings(simulated.effects, times, q))


def _rigid_body(link: Any) -> Body:
    """Mass, kg, centre of mass, m, and inertia about it, kg*m^2, of an engine link, world frame."""
    frame = (link.entity_pose * link.cmass_local_pose).to_transformation_matrix().astype(float)
    R = frame[:3, :3]
    if link.mass < _MASSLESS:
        return 0.0, frame[:3, 3], np.zeros((3, 3))
    return float(link.mass), frame[:3, 3], R @ np.diag(link.inertia.astype(float)) @ R.T


def _inertia_about_pivot(joint: Joint, bodies: list[Body]) -> Array:
    """(3, 3) kg*m^2 of bodies about the joint's pivot."""
    total = np.zeros((3, 3))
    for mass, centre, inertia in bodies:
        arm = centre - joint.pivot
        total += inertia + mass * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
    return total
