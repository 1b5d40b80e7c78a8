"""Joints of many environments at once, with their effects, in torch: the steps of `generator.simulate` on any device.

The laws of the effects are not written again: `torch_law` takes each one's own code and gives it torch for numpy.
"""

from __future__ import annotations

import functools
import types
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from freeart21.effects.base import Effect
from freeart21.errors import FreeArtError
from freeart21.events import drive_rebound, meet_part, part_at_limit, touching_side
from generator.simulate import SimulatedAsset


class _Functions:
    """The functions of numpy that laws may use, of tensors and numbers."""

    def __getattr__(self, name: str) -> Callable[..., Any]:
        function = getattr(torch, name)

        def call(*values: Any) -> Any:
            like = next((value for value in values if isinstance(value, Tensor)), torch.zeros((), dtype=torch.float64))
            return function(*(torch.as_tensor(value, dtype=like.dtype, device=like.device) for value in values))

        return call


@functools.cache
def torch_law(law: Callable[..., Any]) -> Callable[..., Any]:
    """`law` or `remember` of an effect, plain numpy, as a function of tensors."""
    if not isinstance(law, types.FunctionType):
        raise FreeArtError(f"{law!r} is no function of plain Python, which is expected of an effect's law")
    return types.FunctionType(law.__code__, {**law.__globals__, "np": _Functions()}, law.__name__, law.__defaults__)


class _Slot(NamedTuple):
    """One effect class in those environments that have it."""

    effect: type[Effect]
    rows: Tensor
    """(m,) environments."""
    values: tuple[Tensor, ...]
    """(m,) each: the parameters."""

    def law(self, q: Tensor, qd: Tensor, load: Tensor, memory: Tensor | float = 0.0) -> Tensor:
        """(m,) of the positions, velocities and loads (n,) of all environments, and memories (m,)."""
        rows = self.rows
        return torch_law(self.effect.law)(q[rows], qd[rows], load[rows], memory, *self.values)


class Kick(NamedTuple):
    """What an engine is to do in a substep, for each environment (n,)."""

    q: Tensor
    """Where the joint is put."""
    force: Tensor
    """Generalised force beside gravity and contacts, N*m or N."""
    friction: Tensor
    """Largest Coulomb friction, N*m or N."""
    armature: Tensor
    """Inertia to add to the links', kg*m^2 or kg."""


@dataclass
class Motor:
    """A position law in each joint, which bears the moving part's weight."""

    stiffness: Tensor
    """(n,) N*m/rad or N/m."""
    damping: Tensor
    """(n,) N*m*s/rad or N*s/m."""


class JointBatch:
    """The joints of n environments with bases at rest, each a `SimulatedAsset`'s, as tensors (n,)."""

    def __init__(self, joints: Sequence[SimulatedAsset], device: Any = "cpu"):
        self._device, self.n = device, len(joints)
        self.timestep_s = joints[0].timestep_s
        self.lower, self.upper = self._tensor([j.lower for j in joints]), self._tensor([j.upper for j in joints])
        self.joint_inertia = self._tensor([j.joint_inertia for j in joints])
        self._effects = [joint.effects for joint in joints]
        self._joints = joints
        self._force, self._drive, self._stop = (self._slots(acts) for acts in ("force", "drive", "stop"))
        every = self._effects
        self._gain = self._tensor([_product(e.gain() for e in effects) for effects in every])
        self._bias = self._tensor([sum(e.bias_force() for e in effects) for effects in every])
        self._delay = self._tensor([sum(e.delay() for e in effects if e.acts == "command") for effects in every])
        slacks = [next((e for e in effects if e.acts == "slack"), None) for effects in every]
        self._slack = self._tensor([slack.slack() if slack else 0.0 for slack in slacks])
        self._slack_rows = [i for i, slack in enumerate(slacks) if slack]
        self._has_slack = torch.tensor([slack is not None for slack in slacks], device=device)
        self._inertia = self._tensor([joint._inertia for joint in joints])
        self._drive_inertia = self._tensor([joint._drive_inertia for joint in joints])
        self._rotors = [joint._rotor for joint in joints]
        self._drive_rebounds = torch.tensor(
            [rotor.throw_back > 0 and not slack for rotor, slack in zip(self._rotors, slacks, strict=True)],
            device=device,
        )
        self._read_mechanics()
        self._motor: Motor | None = None
        self._substeps: int | None = None
        self._commands: deque[tuple[Tensor, Tensor]] = deque()
        self.q, self.qd, self.time_s = (self._tensor([0.0] * self.n) for _ in range(3))
        self._memories = [torch.zeros_like(slot.values[0]) for slot in self._force]
        self._qdd, self._impact, self._drive_q, self._drive_qd = (torch.zeros_like(self.q) for _ in range(4))
        self._side = torch.zeros_like(self.q)
        self._departure_time = torch.full_like(self.q, torch.nan)
        self._leaves_with, self._leaves_at = torch.zeros_like(self.q), torch.zeros_like(self.q)
        self.set_state(self._tensor([joint.state()[0] for joint in joints]), torch.zeros_like(self.q))

    def _tensor(self, values: Any) -> Tensor:
        return torch.as_tensor(np.asarray(values, float), device=self._device)

    def _slots(self, acts: str) -> list[_Slot]:
        found: dict[tuple[type[Effect], int], list[tuple[int, Effect]]] = {}
        for i, effects in enumerate(self._effects):
            seen: dict[type[Effect], int] = {}
            for effect in effects:
                if effect.acts == acts:
                    seen[type(effect)] = count = seen.get(type(effect), -1) + 1
                    found.setdefault((type(effect), count), []).append((i, effect))
        return [
            _Slot(
                kind,
                torch.tensor([i for i, _ in having], device=self._device),
                tuple(self._tensor(column) for column in zip(*(e.values() for _, e in having), strict=True)),
            )
            for (kind, _), having in found.items()
        ]

    def _read_mechanics(self) -> None:
        mechanics = [joint.mechanics for joint in self._joints]
        self._turns = torch.tensor([m.joint.type == "revolute" for m in mechanics], device=self._device)
        self._along, self._across, self._turned = (self._tensor([m._arms[k] for m in mechanics]) for k in range(3))
        self._axis = self._tensor([m.joint.axis.tolist() for m in mechanics])
        self._mass = self._tensor([m.mass for m in mechanics])
        self.set_gravity(self._tensor([m.gravity.tolist() for m in mechanics]))

    def set_gravity(self, gravity: Tensor) -> None:
        """Gravity (n, 3), m/s^2, in the frames of the joints' parent links, which turn with their bases."""
        self._weight = self._mass[:, None] * gravity
        pull = [torch.linalg.cross(arm, gravity) for arm in (self._along, self._across, self._turned)]
        self._pulls = [(torque * self._axis).sum(1) for torque in pull]
        self._slides = (self._weight * self._axis).sum(1)
        self._sideways = torch.linalg.norm(self._weight - self._slides[:, None] * self._axis, dim=1)

    # --- state --------------------------------------------------------------------------------------------------------

    def set_state(self, q: Tensor, qd: Tensor, rows: Tensor | None = None, restart: bool = True) -> None:
        """Put the joints of the environments `rows` (all by default) to `q` and `qd`, (m,) each; their effects with
        memory begin anew. With `restart` it is time 0, and their motors hold them there."""
        here = torch.arange(self.n, device=self._device) if rows is None else rows
        self.q[here], self.qd[here] = q.double(), qd.double()
        if restart:
            self.time_s[here] = 0.0
        for tensor in (self._qdd, self._impact, self._side):
            tensor[here] = 0.0
        self._departure_time[here] = torch.nan
        self._drive_q[here], self._drive_qd[here] = self.q[here], self.qd[here]
        restarted = [torch.isin(slot.rows, here) for slot in self._force]
        old = self._memories
        self._memories = [torch.zeros_like(memory) for memory in old]
        self._remember(self.q)
        self._memories = [torch.where(new, m, o) for new, m, o in zip(restarted, self._memories, old, strict=True)]
        if self._motor is not None and restart:
            self.command(self.q[here], here, at_s=-torch.inf)

    def set_motor(self, stiffness: Tensor, damping: Tensor) -> None:
        """Give each joint a motor of these gains (n,), commanded to stay where it is."""
        self._motor, self._substeps = Motor(stiffness.double(), damping.double()), None
        self._commands.clear()
        self.command(self.q)

    def remove_motor(self) -> None:
        """Let the joints go."""
        self._motor = self._substeps = None

    def command(self, targets: Tensor, rows: Tensor | None = None, at_s: float | None = None) -> None:
        """Command the motors of `rows` (all by default) to `targets` (m,), rad or m, from now on.

        With `at_s` what was commanded before is forgotten, and they hold since that time.
        """
        here = torch.arange(self.n, device=self._device) if rows is None else rows
        times = self.time_s.clone()
        if at_s is not None:  # a new beginning: what was commanded before is forgotten
            times[here] = at_s
            for past_times, past_values in self._commands:
                past_times[here], past_values[here] = at_s, targets.double()
        values = self._commands[-1][1].clone() if self._commands else self.q.clone()
        values[here] = targets.double()
        self._commands.append((times, values))
        while len(self._commands) > 1 and bool((self._commands[1][0] <= self.time_s - self._delay).all()):
            self._commands.popleft()

    @property
    def substeps(self) -> int:
        """Engine steps per `timestep_s`, as the stiffest effect or motor of all environments needs them."""
        if self._substeps is None:
            self._substeps = self._plan_substeps()
        return self._substeps

    def _plan_substeps(self) -> int:
        from generator.simulate import _MAX_SUBSTEPS, _PHASE_PER_STEP

        stiffness = self._tensor([sum(e.steepness() for e in effects) for effects in self._effects])
        servo = self._gain * self._motor.stiffness if self._motor else torch.zeros_like(stiffness)
        rate = (stiffness + servo) / self._inertia
        rate = torch.where(self._has_slack, torch.maximum(rate, servo / self._drive_inertia.clamp(min=1e-12)), rate)
        needed = int(torch.ceil(self.timestep_s * rate.sqrt() / _PHASE_PER_STEP).max())
        if needed > _MAX_SUBSTEPS:
            raise FreeArtError(
                f"effects need {needed} steps in {self.timestep_s:g} s, at most {_MAX_SUBSTEPS} are made"
            )
        return max(1, needed)

    # --- forces -------------------------------------------------------------------------------------------------------

    def gravity_force(self, q: Tensor) -> Tensor:
        """(n,) N*m or N: gravity's generalised force on each joint."""
        along, across, turned = self._pulls
        return torch.where(self._turns, along + torch.cos(q) * across + torch.sin(q) * turned, self._slides)

    def load(self, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
        """(n,) N: the bearing's force, as `JointMechanics.load`."""
        c, s, qd, qdd = torch.cos(q)[:, None], torch.sin(q)[:, None], qd[:, None], qdd[:, None]
        force = qdd * (c * self._turned - s * self._across) - qd**2 * (c * self._across + s * self._turned)
        return torch.where(self._turns, torch.linalg.norm(force - self._weight, dim=1), self._sideways)

    def _remember(self, q: Tensor) -> None:
        for k, slot in enumerate(self._force):
            if slot.effect.remember is not Effect.remember:
                remembered = torch_law(slot.effect.remember)(q[slot.rows], self._memories[k], *slot.values)
                self._memories[k] = remembered.to(self.q.dtype)

    def effect_force(self, q: Tensor, qd: Tensor) -> Tensor:
        """(n,) N*m or N: the sum of each joint's effects that act as "force"."""
        total, none = torch.zeros_like(q), torch.zeros_like(q)
        for slot, memory in zip(self._force, self._memories, strict=True):
            total.index_add_(0, slot.rows, slot.law(q, qd, none, memory))
        return total

    def friction(self, q: Tensor, qd: Tensor, gear_load: Tensor) -> Tensor:
        """(n,) N*m or N: largest Coulomb friction where the gears carry `gear_load`, N*m or N."""
        total, load = torch.zeros_like(q), None
        for slot in self._drive:
            if slot.effect.needs_load and load is None:
                load = self.load(q, qd, self._qdd)
            carried = gear_load if slot.effect.geared else torch.zeros_like(q) if load is None else load
            total.index_add_(0, slot.rows, slot.law(q, qd, carried))
        return total

    def _commanded(self, t: Tensor) -> Tensor:
        value = self._commands[0][1]
        for since, values in list(self._commands)[1:]:
            value = torch.where(since <= t - self._delay, values, value)
        return value

    def _actuator_force(self, q: Tensor, qd: Tensor, t: Tensor) -> Tensor:
        if self._motor is None:
            return torch.zeros_like(q)
        commanded = self._motor.stiffness * (self._commanded(t) - q) - self._motor.damping * qd
        return self._gain * (commanded - self.gravity_force(self.q)) + self._bias

    def _transmitted_force(self, q: Tensor, qd: Tensor, t: Tensor) -> Tensor:
        if not self._slack_rows:
            return self._actuator_force(q, qd, t)
        force = self._actuator_force(q + 0.5 * self._side * self._slack, qd, t)
        return torch.where(self._has_slack & (self._side == 0), torch.zeros_like(force), force)

    def _damping_slope(self, q: Tensor, qd: Tensor) -> Tensor:
        slope, none, dv = torch.zeros_like(q), torch.zeros_like(q), 1e-3 * qd.abs().clamp(min=1e-3)
        for slot in self._force:
            if slot.effect.speed_dependent:
                change = slot.law(q, qd + dv, none) - slot.law(q, qd - dv, none)
                slope.index_add_(0, slot.rows, change / (2 * dv[slot.rows]))
        if self._motor is not None:
            damping = self._gain * self._motor.damping
            slope = slope - torch.where(self._has_slack & (self._side == 0), torch.zeros_like(damping), damping)
        return slope

    # --- one step -----------------------------------------------------------------------------------------------------

    def before_engine(self, h: float) -> Kick:
        """First half of a substep of `h` s: where an engine puts the joints, and what acts."""
        low, high = torch.minimum(self.lower, self.q), torch.maximum(self.upper, self.q)
        q = torch.minimum(torch.maximum(self.q + 0.5 * h * self.qd, low), high)
        q = torch.where(self._departure_time.isnan(), q, self.q)
        t, qd = self.time_s + 0.5 * h, self.qd
        self._remember(q)
        self._middle = q
        motor, effects = self._transmitted_force(q, qd, t), self.effect_force(q, qd)
        friction = self.friction(q, qd, (motor - effects - self.gravity_force(q)).abs())
        inertia = self._inertia + torch.where(self._side != 0, self._drive_inertia, torch.zeros_like(q))
        z = (-self._damping_slope(q, qd)).clamp(min=0.0) * h / inertia
        inverse_phi1 = torch.where(z > 1e-9, z / -torch.expm1(-z.clamp(min=1e-9)), torch.ones_like(z))
        return Kick(q, effects + motor, friction, inertia * inverse_phi1 - self.joint_inertia)

    def after_engine(self, qd: Tensor, h: float) -> None:
        """Second half of a substep: move the joints by the engine's new velocities (n,); limits and slack act."""
        qd, waiting = qd.double(), ~self._departure_time.isnan()
        before = self.q, self.qd, self._qdd, self._impact, self._departure_time
        q0, qd0, t = self.q, self.qd, self.time_s + 0.5 * h
        self._qdd, self._impact = (qd - qd0) / h, torch.zeros_like(qd)
        self.q, self.qd = self._advance_part(q0, qd0, h)
        if waiting.any():
            self.q, self.qd, self._qdd, self._impact, self._departure_time = (
                torch.where(waiting, old, new)
                for old, new in zip(
                    before, (self.q, self.qd, self._qdd, self._impact, self._departure_time), strict=True
                )
            )
            self._wait_at_limit(waiting, h)
        for row in self._slack_rows:
            self._advance_drive_side(row, qd0, t, h)
        self.time_s = self.time_s + h

    def _advance_part(self, q: Tensor, qd: Tensor, h: float) -> tuple[Tensor, Tensor]:
        low, high = torch.minimum(self.lower, q), torch.maximum(self.upper, q)
        a = self._qdd
        safe = torch.where(a == 0, torch.ones_like(a), a)
        after = q + h * (qd + 0.5 * h * a)
        farthest = torch.where(qd * (qd + h * a) < 0, q - 0.5 * qd * qd / safe, after)
        least, most = torch.minimum(after, farthest), torch.maximum(after, farthest)
        hits = (least < low) | (most > high)
        if not hits.any():
            return after, qd + h * a
        limit, towards = torch.where(least < low, low, high), torch.where(least < low, -1.0, 1.0).to(q.dtype)
        way = torch.where(hits, limit - q, torch.zeros_like(q))
        impact = towards * (qd * qd + 2 * a * way).clamp(min=0.0).sqrt()
        together = qd * impact > 0
        before = torch.where(
            together,
            2 * way / torch.where(together, qd + impact, torch.ones_like(qd)),
            torch.where(a == 0, torch.zeros_like(a), (impact - qd) / safe),
        ).clamp(0.0, h)
        self._impact = torch.where(hits, impact, torch.zeros_like(impact))
        back, none = torch.zeros_like(q), torch.zeros_like(q)
        for slot in self._stop:
            new = torch.zeros_like(q).index_add_(0, slot.rows, slot.law(q, impact, none))
            back = torch.where(new.abs() > back.abs(), new, back)
        stays = torch.zeros_like(hits)
        if (hits & self._drive_rebounds).any():
            rest, speed, leaving = self._rebounds_of_drives(hits & self._drive_rebounds, limit, towards, impact, before)
            driven_back = speed > back.abs()
            back = torch.where(driven_back, -towards * speed, back)
            before = torch.where(driven_back, before + rest, before)
            a = torch.where(driven_back & (rest != 0), leaving, a)
            stays = driven_back & (before > h)
            self._departure_time = torch.where(stays, self.time_s + before, self._departure_time)
            self._leaves_with = torch.where(stays, back, self._leaves_with)
            self._leaves_at = torch.where(stays, a, self._leaves_at)
        remaining = h - before
        beyond = limit + remaining * (back + 0.5 * remaining * a)
        bounces = (low <= beyond) & (beyond <= high) & (towards * (back + 0.5 * remaining * a) < 0) & ~stays
        q1 = torch.where(hits, torch.where(bounces, beyond, limit), after)
        qd1 = torch.where(hits, torch.where(bounces, back + remaining * a, none), qd + h * a)
        self._qdd = torch.where(hits & ~bounces, none, self._qdd)
        return q1, qd1

    def _rebounds_of_drives(
        self, rows: Tensor, limit: Tensor, towards: Tensor, impact: Tensor, before: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """(n,) each as `SimulatedAsset._rebound_of_drive` gives them; zeros where not in `rows` (n,)."""
        none = torch.zeros_like(limit)
        others = self.gravity_force(limit) + self.effect_force(limit, none)
        motor = self._actuator_force(limit, none, self.time_s + before)
        press = towards * others + self.friction(limit, none, (motor - others).abs())
        rest, speed = none.clone(), none.clone()
        for i in rows.nonzero()[:, 0].tolist():
            rotor = self._rotors[i]
            links = float(self._inertia[i]) - rotor.inertia
            drive = float(towards[i] * motor[i])
            rest[i], speed[i] = self._tensor(
                drive_rebound(abs(float(impact[i])), float(press[i]), drive, links, *rotor)
            )
        return rest, speed, towards * (towards * motor + press) / self._inertia

    def _wait_at_limit(self, waiting: Tensor, h: float) -> None:
        since = self.time_s + h - self._departure_time
        goes = waiting & (since > 0)
        moved = since * (self._leaves_with + 0.5 * since * self._leaves_at)
        self.q = torch.where(goes, self.q + moved, self.q)
        self.qd = torch.where(goes, self._leaves_with + since * self._leaves_at, self.qd)
        self._departure_time = torch.where(goes, torch.full_like(self._departure_time, torch.nan), self._departure_time)

    def _advance_drive_side(self, i: int, qd0: Tensor, t: Tensor, h: float) -> None:
        """`SimulatedAsset._advance_drive_side` of environment `i`; an impact is one row's, and rare."""
        J, width, rotor = float(self._drive_inertia[i]), float(self._slack[i]), self._rotors[i]
        side, impact = int(self._side[i]), float(self._impact[i])
        q, qd = float(self.q[i]), float(self.qd[i])
        if side:
            self._drive_q[i], self._drive_qd[i] = q + 0.5 * side * width, qd
            if impact:
                w, side = part_at_limit(side, impact, impact, qd, rotor.throw_back)
                self._drive_qd[i], self._side[i] = w, side
                if not side:
                    return
            at = self._middle + 0.5 * int(self._side[i]) * self._slack
            push = float(self._actuator_force(at, qd0, t)[i]) - J * float(self._qdd[i])
        else:
            ahead, speed, push = self._drive_q, self._drive_qd.clone(), 0.0
            motor = float(self._actuator_force(ahead + 0.5 * h * speed, speed, t)[i])
            damping = float((self._gain * self._motor.damping)[i]) if self._motor is not None else 0.0
            self._drive_qd[i] += h * motor / (J + h * damping)
            self._drive_q[i] += 0.5 * h * (speed[i] + self._drive_qd[i])
        touching = touching_side(side, float(self._drive_q[i]), float(self._drive_qd[i]), q, qd, push, width)
        self._side[i] = touching
        if touching and not side:
            held = qd == 0.0 and q == float(self.upper[i] if touching > 0 else self.lower[i])
            self._drive_q[i] = q + 0.5 * touching * width
            inertia = float(self._inertia[i])
            v, w, touching = meet_part(touching, qd, float(self._drive_qd[i]), held, inertia, J, rotor.throw_back, 0.0)
            self.qd[i], self._drive_qd[i], self._side[i] = v, w, touching


def _product(factors: Any) -> float:
    return functools.reduce(lambda a, b: a * b, factors, 1.0)
