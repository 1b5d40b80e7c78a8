"""The same joint in MuJoCo, written as MJCF text: a second opinion on all that both can say.

Implicit-in-velocity integration with steps of 0.1 ms. MuJoCo's limits and dry friction are soft constraints; both are
made as stiff as the step allows. Polynomial springs and dampers are MuJoCo's own (3.7 and later).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_world.ode import COMMANDED, ELASTIC, EXTERNAL, GAP, Drive, World

STEP = 1e-4
_ABLE = {
    "inertia", "gravity_cosine", "gravity_sine", "gravity_constant", "lower", "upper", "viscous", "known_viscous",
    "drag", "dry", "spring", "spring_rest", "hardening", "mass", "arm", "load_axial", "stiffness", "damping", "gain",
    "link", "link_width", "link_inertia", "link_stiffness", "link_damping", "travel",
}  # fmt: skip


def able(world: World) -> bool:
    """Whether MuJoCo can say this world."""
    plain = World()
    other = [n for n in World._fields if n not in _ABLE and getattr(world, n) != getattr(plain, n)]
    used = [n for n in other if not (n.endswith("_power") and getattr(world, n[:-6], 0.0) == 0.0)]
    powers = (world.viscous == 0 or world.viscous_power == 1) and (world.drag == 0 or world.drag_power == 2)
    return powers and not [n for n in used if not n.endswith("_power")] and world.link != GAP


def sayable(world: World) -> World:
    """The nearest world that MuJoCo can say: losses by the first and second power, mixed a little to be neither."""
    if world.viscous:
        mixed = world.drag + 0.04 * world.viscous
        return world._replace(viscous_power=1.0, drag_power=2.0, drag=mixed)
    if world.drag:
        return world._replace(viscous=0.04 * world.drag, viscous_power=1.0, drag_power=2.0)
    return world


def mjcf(world: World, revolute: bool) -> str:
    """One joint, or a rotor and a part behind a spring, without gravity: gravity's pull is applied as a force."""
    kind = "hinge" if revolute else "slide"
    limit = f'limited="true" range="{world.lower!r} {world.upper!r}"' if world.upper < 1e8 else 'limited="false"'
    spring = ""
    if world.spring:
        spring = f'stiffness="{world.spring!r} 0 {world.spring * world.hardening!r}" springref="{world.spring_rest!r}"'
    loss = f"{world.viscous + world.known_viscous!r} {world.drag!r}"
    joint = (
        f'<joint name="q" type="{kind}" axis="0 0 1" {limit} damping="{loss}" {spring} '
        f'frictionloss="{world.dry!r}" solreflimit="{2 * STEP} 60" solimplimit="0.999 0.9999 1e-5" '
        f'solreffriction="{2 * STEP} 1" solimpfriction="0.9999 0.99999 1e-5"/>'
    )
    rotor = ""
    if world.link == ELASTIC:
        rotor = f'<body name="rotor"><joint name="x" type="{kind}" axis="0 0 1"/>{_inertial(world.link_inertia)}</body>'
        shaft = (
            f'<tendon><fixed name="shaft" stiffness="{world.link_stiffness!r}" damping="{world.link_damping!r}" '
            'springlength="0"><joint joint="q" coef="-1"/><joint joint="x" coef="1"/></fixed></tendon>'
        )
    else:
        shaft = ""
    return (
        f'<mujoco><compiler angle="radian" autolimits="false" boundmass="0"/>'
        f'<option timestep="{STEP}" integrator="implicitfast" gravity="0 0 0" iterations="200" tolerance="1e-14"/>'
        f'<worldbody><body name="part">{joint}{_inertial(world.inertia)}</body>{rotor}</worldbody>{shaft}</mujoco>'
    )


def _inertial(value: float) -> str:
    """A point of this mass, or of this moment about the axis."""
    return f'<inertial pos="0 0 0" mass="{value!r}" diaginertia="{value!r} {value!r} {value!r}"/>'


def simulate(
    world: World, q0: float, v0: float, times: NDArray[np.float64], drive: Drive, clock: float = 0.0
) -> NDArray[np.float64]:
    """(n, 2) position and velocity at `times` (n,), as `ode.simulate`; between steps it goes straight on.

    ValueError when MuJoCo cannot say this world.
    """
    import mujoco

    if not able(world):
        raise ValueError("MuJoCo cannot say this world")
    model = mujoco.MjModel.from_xml_string(mjcf(world, True))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q0, v0
    elastic = world.link == ELASTIC
    steps = int(np.ceil((times[-1] - times[0]) / STEP)) + 1
    at = times[0] + STEP * np.arange(steps + 1)
    now = np.clip(np.searchsorted(drive.times, at + 0.5 * STEP, side="right") - 1, 0, len(drive.times) - 1)
    command, effort = drive.command[now], drive.effort[now]
    course = np.empty((steps + 1, 2))
    course[0] = q0, v0
    part, rotor = 0, (1 if elastic else 0)
    force, qpos, qvel = data.qfrc_applied, data.qpos, data.qvel
    for i in range(steps):
        q = qpos[part]
        force[:] = 0.0
        force[part] = world.gravity_cosine * np.cos(q) + world.gravity_sine * np.sin(q) + world.gravity_constant
        if drive.effort_kind == EXTERNAL:
            force[part] += effort[i]
        asked = effort[i] if drive.effort_kind == COMMANDED else 0.0
        if drive.has_command:
            asked += world.stiffness * (command[i] - qpos[rotor]) - world.damping * qvel[rotor]
        force[rotor] += world.gain * asked
        mujoco.mj_step(model, data)
        course[i + 1] = qpos[part], qvel[part]
    return np.column_stack([np.interp(times, at, course[:, k]) for k in range(2)])
