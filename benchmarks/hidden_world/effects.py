"""Every effect by name, in another form than any library has it, and at any size; and some that no library has.

`applied(name, seed, size, body, world)` gives the changed world and reading. What is drawn at random comes from `seed`
alone, so an effect grows with `size` and stays the same else. `START` is where a search for a size begins, for a clear
one; sizes are relative to the body's own force, inertia, speed and range.
"""

from __future__ import annotations

import numpy as np

from benchmarks.hidden_world.body import Body
from benchmarks.hidden_world.nuisance import Reading
from benchmarks.hidden_world.ode import ELASTIC, GAP, World

START: dict[str, tuple[float, float]] = {
    "viscous_damping": (0.1, 0.5),
    "coulomb_friction": (0.02, 0.1),
    "stribeck_friction": (0.03, 0.12),
    "quadratic_drag": (0.05, 0.3),
    "load_friction": (0.02, 0.08),
    "return_spring": (0.2, 0.8),
    "gravity_offset": (0.15, 0.4),
    "detent": (0.1, 0.4),
    "latch": (0.15, 0.5),
    "backlash": (0.02, 0.06),
    "end_stop_bounce": (0.3, 0.7),
    "actuator_delay": (0.015, 0.05),
    "actuator_gain": (0.12, 0.35),
    "armature": (0.35, 1.0),
    "encoder_offset": (0.03, 0.08),
    "encoder_scale": (0.03, 0.1),
    "time_offset": (0.015, 0.04),
}
"""Library effects of dynamics and sensing: the sizes of clear ones."""
LARGEST = {"end_stop_bounce": 0.85, "actuator_delay": 0.12, "time_offset": 0.1, "backlash": 0.15, "actuator_gain": 0.6,
           "encoder_offset": 0.3, "gravity_offset": 0.9, "armature": 4.0, "encoder_scale": 0.3}  # fmt: skip
"""Sizes that are not exceeded in making an effect clear."""
SMALLEST = {"armature": 0.2, "end_stop_bounce": 0.1, "backlash": 0.002, "belt_elasticity": 0.05}
"""Nor gone below: there the asset's own uncertainty begins, or there is next to nothing."""
STRANGE: dict[str, tuple[float, float]] = {
    "cogging": (0.1, 0.3),
    "belt_elasticity": (0.3, 0.8),
    "temperature_drift": (0.05, 0.15),
    "cable_torque": (0.05, 0.2),
    "asymmetric_friction": (0.05, 0.15),
    "pulsing_damping": (0.4, 0.9),
    "repelling_magnet": (0.15, 0.4),
}
"""Effects of no library."""
RIVALS_OF = {
    "viscous_damping": ("quadratic_drag",),
    "stribeck_friction": ("coulomb_friction",),
    "load_friction": ("coulomb_friction",),
    "quadratic_drag": ("viscous_damping",),
    "temperature_drift": ("coulomb_friction", "viscous_damping"),
    "cable_torque": ("return_spring", "gravity_offset"),
    "asymmetric_friction": ("coulomb_friction", "gravity_offset", "viscous_damping"),
    "pulsing_damping": ("viscous_damping", "coulomb_friction"),
    "belt_elasticity": ("armature", "actuator_delay", "viscous_damping"),
    "repelling_magnet": ("gravity_offset", "return_spring"),
    "cogging": ("coulomb_friction", "viscous_damping"),
    "latch": ("detent",),
    "gravity_offset": ("return_spring",),
    "return_spring": ("gravity_offset",),
}
"""Other effects that might pass for it: what is left beyond these must show, too."""
TWINS = {
    "coulomb_friction": "load_friction",
    "viscous_damping": "quadratic_drag",
    "quadratic_drag": "viscous_damping",
    "gravity_offset": "return_spring",
    "return_spring": "gravity_offset",
}
"""The one that might pass for it beside another effect."""
DRAWS = {"return_spring": (7, 14), "gravity_offset": (53, 2014)}
"""Seeds whose effects together make any of the kind: springs that rest at either end, pulls in two directions (that
hardly change the inertia)."""


def applied(name: str, seed: int, size: float, body: Body, world: World) -> tuple[World, Reading]:
    """The world and the reading with effect `name` at `size` added to `world`."""
    rng = np.random.default_rng([seed, 77])
    if name in SENSING:
        return world, SENSING[name](rng, size, body)
    return DYNAMICS[name](rng, size, body, world), Reading()


def _viscous_damping(rng, s, body: Body, w: World) -> World:
    power = rng.uniform(0.85, 1.15)  # the same force at half the usual speed, whatever the power
    return w._replace(viscous=s * body.inertia * (0.5 * body.speed) ** (1 - power), viscous_power=power)


def _coulomb_friction(rng, s, body: Body, w: World) -> World:
    return w._replace(friction=s * body.force, travel=body.range * rng.uniform(2e-4, 6e-4))


def _stribeck_friction(rng, s, body: Body, w: World) -> World:
    return w._replace(
        friction=0.5 * s * body.force, friction_rise=s * body.force * rng.uniform(0.8, 1.4),
        friction_speed=body.speed * rng.uniform(0.1, 0.25), friction_power=1.0,
        travel=body.range * rng.uniform(2e-4, 6e-4),
    )  # fmt: skip


def _quadratic_drag(rng, s, body: Body, w: World) -> World:
    power = rng.uniform(1.85, 2.15)
    return w._replace(drag=s * body.inertia * (1.0 / body.speed) * body.speed ** (2 - power), drag_power=power)


def _load_friction(rng, s, body: Body, w: World) -> World:
    usual = body.mass * 9.81 if body.revolute else max(w.load_axial, 1e-9)
    return w._replace(friction_load=s * body.force / usual, travel=body.range * rng.uniform(2e-4, 6e-4))


def _return_spring(rng, s, body: Body, w: World) -> World:
    rest = body.lower + body.range * rng.uniform(0.0, 1.0)
    return _sprung(w, s * body.force / body.range, rest, rng.uniform(0.05, 0.15) / body.range**2)


def _sprung(w: World, stiffness: float, rest: float, hardening: float) -> World:
    """The world with a spring more: beside another the two are one, but for how each hardens."""
    both = w.spring + stiffness
    if both == 0.0:
        return w
    share = stiffness / both
    return w._replace(
        spring=both, spring_rest=(1 - share) * w.spring_rest + share * rest,
        hardening=(1 - share) * w.hardening + share * hardening,
    )  # fmt: skip


def _gravity_offset(rng, s, body: Body, w: World) -> World:
    """A hinge's base leans and its mass is off; a drawer stands on a slope whose rails bend."""
    way = rng.choice([-1.0, 1.0])
    if not body.revolute:
        bend = rng.uniform(0.02, 0.06) * abs(s) * body.force / body.range
        return _sprung(w._replace(gravity_constant=w.gravity_constant + way * s * body.force), bend, body.rest, 0.0)
    share = rng.uniform(-0.8, 0.8)
    c, m = way * s * body.force * np.array([np.sqrt(1 - share**2), share])
    return w._replace(
        gravity_cosine=w.gravity_cosine + c, gravity_sine=w.gravity_sine + m,
        inertia=w.inertia * (1 + 0.02 * rng.uniform(-1, 1)),
    )  # fmt: skip


def _detent(rng, s, body: Body, w: World) -> World:
    centre = body.rest + body.range * rng.uniform(-0.22, 0.22)
    return w._replace(detent=s * body.force, detent_centre=centre, detent_width=body.range * rng.uniform(0.03, 0.07))


def _latch(rng, s, body: Body, w: World) -> World:
    """A catch that eases before it lets go, somewhere in the middle or next to the closed end."""
    place = body.rest if rng.uniform() < 0.6 else body.lower + 0.12 * body.range
    return w._replace(
        latch=s * body.force, latch_position=place + 0.05 * body.range * rng.uniform(-1, 1),
        latch_travel=body.range * rng.uniform(0.04, 0.08), latch_capture=rng.uniform(0.35, 0.6),
    )  # fmt: skip


def _backlash(rng, s, body: Body, w: World) -> World:
    depth = 0.001 * body.range  # of its flanks under the usual force
    return w._replace(
        link=GAP, link_width=s * body.range, link_inertia=body.inertia * rng.uniform(0.12, 0.3) * min(1.0, s / 0.02),
        link_stiffness=body.force / depth**1.5, link_damping=3 / (0.15 * body.speed),
    )  # fmt: skip


def _end_stop_bounce(rng, s, body: Body, w: World) -> World:
    """Pressed in by half a thousandth of the range at the usual speed; restitution as asked for at half of that."""
    depth, usual = 0.0005 * body.range, 0.5 * body.speed
    stiffness = 1.25 * body.inertia * body.speed**2 / depth**2.5
    return w._replace(stop_stiffness=stiffness, stop_loss=_loss(s) / usual)


def _loss(e: float) -> float:
    """Hunt and Crossley's loss times the approach speed that leaves a restitution e (Zhang and Sharf 2009, closed form:
    the impact ends where (1 + d e) = (1 - d) exp(d (1 + e)))."""
    low, high = 1e-6, 400.0
    for _ in range(80):
        d = np.sqrt(low * high)
        left, right = 1e-9, 1.0
        for _ in range(60):  # restitution at this loss
            mid = 0.5 * (left + right)
            # (1+d) exp(-d(1+mid)) = 1 - d mid gives mid; below the root the left side is larger
            if np.log1p(d) - d * (1 + mid) > np.log(max(1 - d * mid, 1e-300)):
                right = mid
            else:
                left = mid
        low, high = (d, high) if left > e else (low, d)
    return float(np.sqrt(low * high))


def _actuator_delay(rng, s, body: Body, w: World) -> World:
    share = rng.uniform(0.65, 0.85)  # part of it is a lag
    return w._replace(delay=share * s, lag=(1 - share) * s)


def _actuator_gain(rng, s, body: Body, w: World) -> World:
    weaker = rng.uniform() < 0.6
    full = max(0.4 * w.stiffness * body.range, body.force)
    return w._replace(gain=1 - s if weaker else 1 + s, compression=rng.uniform(0.01, 0.03), force_full=full)


def stronger(seed: int) -> bool:
    """Whether the drive of an actuator_gain of this seed is stronger than told."""
    return bool(np.random.default_rng([seed, 77]).uniform() >= 0.6)


def _armature(rng, s, body: Body, w: World) -> World:
    """A rotor behind a stiff shaft with losses: without them it would come back from every stop, another effect."""
    return _shaft(w, s * body.inertia, rng.uniform(45, 70), 0.5)


def _shaft(w: World, inertia: float, hertz: float, ratio: float) -> World:
    light = w.inertia * inertia / (w.inertia + inertia)
    rate = 2 * np.pi * hertz
    return w._replace(
        link=ELASTIC, link_inertia=inertia, link_stiffness=light * rate**2, link_damping=2 * ratio * rate * light
    )


def _encoder_offset(rng, s, body: Body) -> Reading:
    offset = rng.choice([-1, 1]) * s * body.range
    return Reading(offset=offset, ripple=0.02 * offset, ripple_count=1 if body.revolute else 6 / body.range)


def _encoder_scale(rng, s, body: Body) -> Reading:
    s = rng.choice([-1, 1]) * s
    return Reading(factor=1 + s, curve=0.03 * s / max(abs(body.lower), abs(body.upper)) ** 2)


def _time_offset(rng, s, body: Body) -> Reading:
    late = rng.uniform() < 0.75
    return Reading(late=s if late else -s, window=rng.uniform(0.05, 0.3) * s)


def _cogging(rng, s, body: Body, w: World) -> World:
    count = rng.uniform(7, 15) * (2 * np.pi / 2.5) / body.range
    return w._replace(cogging=s * body.force, cogging_count=count, cogging_phase=rng.uniform(0, 6.28))


def _belt_elasticity(rng, s, body: Body, w: World) -> World:
    rate = 2 * np.pi * rng.uniform(4, 7)
    return w._replace(
        link=ELASTIC, link_inertia=0.15 * body.inertia, link_stiffness=body.inertia * rate**2 * 0.5 / s,
        link_damping=0.03 * body.inertia * rate,
    )  # fmt: skip


def _temperature_drift(rng, s, body: Body, w: World) -> World:
    w = _coulomb_friction(rng, s, body, w)
    return w._replace(warm_up=rng.uniform(3, 6), warm_seconds=rng.uniform(60, 200))


def _cable_torque(rng, s, body: Body, w: World) -> World:
    end = body.lower if rng.uniform() < 0.5 else body.upper
    return w._replace(cable=s * body.force / 3, cable_rest=end, cable_reach=body.range)


def _asymmetric_friction(rng, s, body: Body, w: World) -> World:
    way = rng.choice([-1, 1]) * rng.uniform(0.6, 0.9)
    return _coulomb_friction(rng, s, body, w)._replace(friction_way=way)


def _pulsing_damping(rng, s, body: Body, w: World) -> World:
    return w._replace(viscous=s * body.inertia, pulsing=rng.uniform(0.85, 1.0), pulsing_rate=rng.uniform(0.15, 0.5))


def _repelling_magnet(rng, s, body: Body, w: World) -> World:
    return _detent(rng, -s, body, w)


DYNAMICS = {
    name: globals()[f"_{name}"]
    for name in (*START, *STRANGE)
    if name not in ("encoder_offset", "encoder_scale", "time_offset")
}
SENSING = {"encoder_offset": _encoder_offset, "encoder_scale": _encoder_scale, "time_offset": _time_offset}


def parameters(name: str, seed: int, size: float, body: Body) -> dict[str, float]:
    """The library's parameters where its form and ours mean the same number; empty or fewer where they do not."""
    rng = np.random.default_rng([seed, 77])
    base = body.world()._replace(stiffness=1.0)
    if name in SENSING:
        reading = SENSING[name](rng, size, body)
        return {
            "encoder_offset": {"offset": reading.offset}, "encoder_scale": {"factor": reading.factor},
            "time_offset": {"seconds": reading.late},
        }[name]  # fmt: skip
    if name not in START:
        return {}
    w = DYNAMICS[name](rng, size, body, base)
    return {
        "coulomb_friction": {"level": w.friction},
        "load_friction": {"coefficient": w.friction_load},
        "return_spring": {"stiffness": w.spring * (1 + 0.25 * w.hardening * body.range**2), "rest": w.spring_rest},
        "detent": {"peak": w.detent, "centre": w.detent_centre, "width": w.detent_width},
        "latch": {"hold": w.latch, "position": w.latch_position, "travel": w.latch_travel},
        "backlash": {"width": w.link_width, "drive_inertia": w.link_inertia},
        "actuator_delay": {"seconds": size},
        "actuator_gain": {"factor": w.gain},
        "armature": {"value": w.link_inertia},
    }.get(name, {})  # fmt: skip
