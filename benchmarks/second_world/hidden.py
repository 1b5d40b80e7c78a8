"""The effects that can be hidden: what each does to a machine, how large it may be, and on which machines it is looked
for.

Sizes are from facts of real rigs (tau/I .15 to 3 rad/s^2, b/I .05 to .6 1/s, c/I .003 to .02) where there are any;
others are what mechanics of such machines have, not measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.second_world import laws as w
from benchmarks.second_world.machines import Machine

Rng = np.random.Generator


@dataclass(frozen=True)
class Sensing:
    """What lies between the joint and the log: reading = scale q + offset, `late` s behind its stamp; commands arrive
    `delay` s late."""

    scale: float = 1.0
    offset: float = 0.0
    late: float = 0.0
    delay: float = 0.0


@dataclass(frozen=True)
class Effect:
    """One hidden effect: `size` is its strength (scaled for weak cases), `form` all else, `value` and `unit` what an
    interval is held to."""

    name: str
    size: float
    form: dict[str, float] = field(default_factory=dict)
    same_form: bool = False
    unit: str = ""


def _log(rng: Rng, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _side(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _reach(m: Machine) -> float:
    """How far runs of this machine go about, rad or m."""
    return {"pendulum": 1.2, "lid": 1.0, "door": 1.0, "drawer": 0.3, "arm": 0.5}[m.kind]


def _unit(m: Machine, kind: str) -> str:
    """Units as docs/formats.md writes them."""
    force = "N" if m.slides else "N*m"
    angle = "m" if m.slides else "rad"
    per = {"viscous": f"{force}*s/{angle}", "drag": f"{force}*s^2/{angle}^2", "stiffness": f"{force}/{angle}"}
    return {"force": force, "angle": angle, "inertia": "kg" if m.slides else "kg*m^2", **per}.get(kind, kind)


def _scale(m: Machine) -> float:
    """m a rad: what turns accelerations of joints that turn into those of slides of like speed."""
    return 0.4 if m.slides else 1.0


def _oil(m: Machine, rng: Rng) -> Effect:
    p = rng.uniform(0.85, 1.15)
    size = m.damping * _log(rng, 0.3, 1.0) if m.kind == "arm" else m.inertia * _log(rng, 0.05, 0.6)
    return Effect("viscous_damping", size, {"power": p}, abs(p - 1) < 0.03, _unit(m, "viscous"))


def _dry_size(m: Machine, rng: Rng) -> float:
    if m.kind in ("door", "drawer"):
        return m.inertia * _scale(m) * _log(rng, 0.1, 0.6)
    if m.kind == "arm":  # gears
        return m.weight * _log(rng, 0.05, 0.4)
    return min(m.inertia * _log(rng, 0.15, 3.0), 0.12 * m.weight)


def _travel(m: Machine, rng: Rng) -> float:
    """Pre-sliding travel, rad or m: to 8e-3, what real joints show (issue 32)."""
    return (0.05 if m.slides else 1.0) * _log(rng, 1.5e-3, 8e-3)


def _dry(m: Machine, rng: Rng) -> Effect:
    return Effect("coulomb_friction", _dry_size(m, rng), {"travel": _travel(m, rng)}, True, _unit(m, "force"))


def _stribeck(m: Machine, rng: Rng) -> Effect:
    form = {"travel": _travel(m, rng), "stick": rng.uniform(1.6, 2.6), "speed": _scale(m) * _log(rng, 0.05, 0.4)}
    return Effect("stribeck_friction", 0.7 * _dry_size(m, rng), form, True, _unit(m, "force"))


def _load(m: Machine, rng: Rng) -> Effect:
    share = _dry_size(m, rng) / (m.mass * 9.81)
    return Effect("load_friction", share, {"travel": _travel(m, rng)})


def _air(m: Machine, rng: Rng) -> Effect:
    p = rng.uniform(1.9, 2.1)
    low, high = (0.05, 0.3) if m.kind in ("door", "drawer") else (0.003, 0.02)
    return Effect(
        "quadratic_drag",
        m.inertia * _log(rng, low, high) / _scale(m),
        {"power": p},
        abs(p - 2) < 0.03,
        _unit(m, "drag"),
    )


def _spring(m: Machine, rng: Rng) -> Effect:
    k = m.inertia * _log(rng, 0.5, 4.0) if m.kind in ("door", "drawer") else m.weight * _log(rng, 0.1, 0.5)
    at = rng.uniform(-0.4, 0.4) * _reach(m)
    return Effect(
        "return_spring", k, {"at": at, "harden": rng.uniform(0.03, 0.1) / _reach(m) ** 2}, True, _unit(m, "stiffness")
    )


def _lean(m: Machine, rng: Rng) -> Effect:
    return Effect("gravity_offset", _side(rng) * math.radians(rng.uniform(4, 10)), {}, False)


def _zero(m: Machine, rng: Rng) -> Effect:
    return Effect("encoder_offset", _side(rng) * math.radians(rng.uniform(4, 10)), {}, True, _unit(m, "angle"))


def _stretch(m: Machine, rng: Rng) -> Effect:
    return Effect("encoder_scale", _side(rng) * rng.uniform(0.04, 0.15), {}, True, "1")


def _behind(m: Machine, rng: Rng) -> Effect:
    return Effect("time_offset", rng.uniform(0.015, 0.06), {}, True, "s")


def _delay(m: Machine, rng: Rng) -> Effect:
    return Effect("actuator_delay", rng.uniform(0.012, 0.06), {}, True, "s")


def _gain(m: Machine, rng: Rng) -> Effect:
    size = rng.uniform(0.18, 0.5) if rng.random() < 0.4 else -rng.uniform(0.15, 0.5)
    return Effect("actuator_gain", size, {}, True, "1")


def _rotor(m: Machine, rng: Rng) -> Effect:
    return Effect("armature", m.inertia * rng.uniform(0.3, 1.0), {}, True, _unit(m, "inertia"))


def _play(m: Machine, rng: Rng) -> Effect:
    return Effect(
        "backlash", math.radians(rng.uniform(1.5, 5)), {"stiff": rng.uniform(30, 60)}, True, _unit(m, "angle")
    )


def _notch(m: Machine, rng: Rng) -> Effect:
    force = (
        m.inertia * _scale(m) * _log(rng, 0.6, 3.0)
        if m.kind in ("door", "drawer")
        else m.weight * _log(rng, 0.08, 0.35)
    )
    form = {"at": rng.uniform(-0.5, 0.5) * _reach(m), "wide": rng.uniform(0.05, 0.14) * _reach(m)}
    return Effect("detent", force, form)


def _catch(m: Machine, rng: Rng) -> Effect:
    out = rng.uniform(0.05, 0.12)
    return Effect("latch", m.inertia * _log(rng, 1.5, 5.0), {"in": out * rng.uniform(0.4, 0.7), "out": out})


def _bounce(m: Machine, rng: Rng) -> Effect:
    return Effect(
        "end_stop_bounce",
        rng.uniform(0.3, 0.7),
        {"depth": rng.uniform(0.006, 0.02), "speed": 0.6 * math.sqrt(2 * m.weight / m.inertia)},
    )


def _cogs(m: Machine, rng: Rng) -> Effect:
    force = m.inertia * _log(rng, 0.8, 3.0) if m.kind == "door" else m.weight * _log(rng, 0.05, 0.2)
    return Effect("cogging", force, {"n": float(rng.integers(6, 25)), "phase": rng.uniform(0, 6.28)})


def _belt(m: Machine, rng: Rng) -> Effect:
    return Effect("belt_elasticity", 1 / (m.stiffness * _log(rng, 0.6, 2.5)), {"rotor": rng.uniform(0.1, 0.25)})


def _warming(m: Machine, rng: Rng) -> Effect:
    form = {"travel": _travel(m, rng), "warm": rng.uniform(1.2, 2.5), "seconds": rng.uniform(40, 120)}
    return Effect("temperature_drift", 0.5 * _dry_size(m, rng), form)


def _cable(m: Machine, rng: Rng) -> Effect:
    force = m.inertia * _log(rng, 1.0, 4.0) if m.kind == "door" else m.weight * _log(rng, 0.3, 1.0)
    return Effect("cable_torque", force, {"at": rng.uniform(-0.2, 0.4) * _reach(m)})


def _magnet(m: Machine, rng: Rng) -> Effect:
    wide = rng.uniform(0.1, 0.3) * _reach(m)
    force = m.inertia * _log(rng, 0.8, 3.0) if m.kind == "door" else m.weight * _log(rng, 0.1, 0.4)
    return Effect("magnet", force * wide, {"at": _side(rng) * rng.uniform(0.5, 1.2) * _reach(m), "wide": wide})


def _one_sided(m: Machine, rng: Rng) -> Effect:
    return Effect(
        "asymmetric_friction",
        _dry_size(m, rng),
        {"travel": _travel(m, rng), "lean": _side(rng) * rng.uniform(0.4, 0.8)},
    )


def _swaying(m: Machine, rng: Rng) -> Effect:
    return Effect(
        "time_varying_damping",
        m.inertia * _log(rng, 0.15, 0.6),
        {"sway": rng.uniform(0.7, 0.95), "seconds": rng.uniform(20, 90)},
    )


DRAWS: dict[str, Callable[[Machine, Rng], Effect]] = {
    "viscous_damping": _oil,
    "coulomb_friction": _dry,
    "stribeck_friction": _stribeck,
    "load_friction": _load,
    "quadratic_drag": _air,
    "return_spring": _spring,
    "gravity_offset": _lean,
    "encoder_offset": _zero,
    "encoder_scale": _stretch,
    "time_offset": _behind,
    "actuator_delay": _delay,
    "actuator_gain": _gain,
    "armature": _rotor,
    "backlash": _play,
    "detent": _notch,
    "latch": _catch,
    "end_stop_bounce": _bounce,
    "cogging": _cogs,
    "belt_elasticity": _belt,
    "temperature_drift": _warming,
    "cable_torque": _cable,
    "magnet": _magnet,
    "asymmetric_friction": _one_sided,
    "time_varying_damping": _swaying,
}


def apply(effect: Effect, m: Machine, p: np.ndarray, sensing: Sensing) -> tuple[np.ndarray, Sensing]:
    """Parameters and sensing with the effect, of those without."""
    p, f, size = p.copy(), effect.form, effect.size
    if "travel" in f:
        p[w.TRAVEL], p[w.DRY], p[w.STICK_V] = f["travel"], size, 0.1 * _scale(m)
        level = size * (m.mass * 9.81 if effect.name == "load_friction" else 1.0)
        p[w.BRISTLE_D] = 0.4 * math.sqrt(level / f["travel"] * p[w.M])  # a fifth of critical
    match effect.name:
        case "viscous_damping" | "time_varying_damping":
            p[w.OIL], p[w.OIL_P] = size, f.get("power", 1.0)
            p[w.SWAY], p[w.SWAY_S] = f.get("sway", 0.0), f.get("seconds", 1.0)
        case "coulomb_friction":
            pass
        case "stribeck_friction":
            p[w.STICK], p[w.STICK_V] = f["stick"], f["speed"]
        case "load_friction":
            p[w.LOAD] = 1.0
        case "temperature_drift":
            p[w.WARM], p[w.WARM_S] = f["warm"], f["seconds"]
        case "asymmetric_friction":
            p[w.LEAN] = f["lean"]
        case "quadratic_drag":
            p[w.AIR], p[w.AIR_P] = size, f["power"]
        case "return_spring":
            p[w.SPRING], p[w.SPRING_Q], p[w.HARDEN] = size, f["at"], f["harden"]
        case "gravity_offset":
            a, b = p[w.GA], p[w.GB]
            p[w.GA], p[w.GB] = a * math.cos(size) + b * math.sin(size), b * math.cos(size) - a * math.sin(size)
        case "armature":
            p[w.M] += size
        case "actuator_gain":
            p[w.GAIN] = 1 + size
        case "detent":
            p[w.NOTCH], p[w.NOTCH_Q], p[w.NOTCH_W] = size, f["at"], f["wide"]
        case "latch":
            p[w.CATCH], p[w.CATCH_IN], p[w.CATCH_OUT] = size, f["in"], f["out"]
        case "end_stop_bounce":
            p[w.STOP_K] = 1.25 * p[w.M] * f["speed"] ** 2 / f["depth"] ** 2.5
            p[w.STOP_C] = 1.5 * (1 - size) / (f["speed"] * (0.3 + 0.7 * size))
        case "backlash" | "belt_elasticity":
            p[w.ROTOR] = f.get("rotor", 0.06) * p[w.M]  # the joint is lighter by it: nothing is added
            p[w.BELT] = f["stiff"] * m.stiffness if effect.name == "backlash" else 1 / size
            p[w.BELT_D] = 0.3 * math.sqrt(p[w.BELT] * p[w.ROTOR])
            p[w.PLAY] = size if effect.name == "backlash" else -1.0
        case "cogging":
            p[w.COG], p[w.COG_N], p[w.COG_PHASE] = size, f["n"], f["phase"]
        case "cable_torque":
            p[w.CABLE], p[w.CABLE_Q] = size, f["at"]
        case "magnet":
            p[w.MAGNET], p[w.MAGNET_Q], p[w.MAGNET_W] = size, f["at"], f["wide"]
        case "encoder_offset":
            sensing = replace(sensing, offset=size)
        case "encoder_scale":
            sensing = replace(sensing, scale=1 + size)
        case "time_offset":
            sensing = replace(sensing, late=size)
        case "actuator_delay":
            sensing = replace(sensing, delay=size)
        case _:
            raise ValueError(f"{effect.name}: not one of {', '.join(DRAWS)}")
    return p, sensing


def true_value(effect: Effect) -> float:
    """What an interval of the principal parameter is held to, in `unit`."""
    return 1 + effect.size if effect.name in ("encoder_scale", "actuator_gain") else effect.size


def plainer(effect: Effect) -> Effect | None:
    """The library's effect that does nearly the same, at about its size: unless runs tell the two apart, naming it is
    no fault."""
    f = effect.form
    match effect.name:
        case "stribeck_friction" | "asymmetric_friction" | "temperature_drift":
            return Effect("coulomb_friction", 1.2 * effect.size, {"travel": f["travel"]})
        case "time_varying_damping":
            return Effect("viscous_damping", effect.size, {"power": 1.0})
        case "cable_torque":
            return Effect("return_spring", 0.6 * effect.size, {"at": f["at"], "harden": 0.0})
        case "magnet":
            return Effect("detent", 1.3 * effect.size / f["wide"], {"at": f["at"], "wide": 0.6 * f["wide"]})
    return None


def longest(p: np.ndarray) -> float:
    """s a step: finer where bristles, teeth or a stop are quick. Halving it moves nothing by a tenth of a quantum
    (tests)."""
    quick = p[w.TRAVEL] > 0 or p[w.ROTOR] > 0 or p[w.STOP_K] > 0
    return 5e-5 if quick else 1e-4
