"""The effects that can be hidden: what each does to a machine, and how large it may be.

Sizes are from facts of real rigs (tau/I .15 to 3 rad/s^2, b/I .05 to .6 1/s, c/I .003 to .02) where there are any;
others are what mechanics of such machines have, not measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from benchmarks.world import laws as w
from benchmarks.world.machines import Machine, Nuisance, truth

Rng = np.random.Generator


@dataclass(frozen=True)
class Effect:
    """One hidden effect: `size` is its strength (scaled for weak cases), `form` all else. `same_form`: an interval can
    be held to its size, which has `unit`: 1 of what a factor has beyond 1."""

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


def _scale(m: Machine) -> float:
    """m a rad: what turns accelerations of joints that turn into those of slides of like speed."""
    return 0.4 if m.slides else 1.0


def _travel(m: Machine, rng: Rng) -> float:
    """Pre-sliding travel, rad or m: to 8e-3, what real joints show."""
    return (0.05 if m.slides else 1.0) * _log(rng, 1.5e-3, 8e-3)


def _dry(m: Machine, rng: Rng) -> float:
    if m.light or m.kind == "arm":  # gears
        return _force(m, rng, (0.1, 0.6), (0.05, 0.4), _scale(m))
    return min(m.inertia * _log(rng, 0.15, 3.0), 0.12 * m.weight)


def _force(m: Machine, rng: Rng, light: tuple[float, float], heavy: tuple[float, float], scale: float = 1.0) -> float:
    """Bounds are accelerations where gravity hardly acts, shares of the weight where it does."""
    return m.inertia * scale * _log(rng, *light) if m.light else m.weight * _log(rng, *heavy)


def _shaft(rotor: float, stiff: float, play: float) -> dict[int, float]:
    """The joint is lighter by the rotor: nothing is added."""
    return {w.ROTOR: rotor, w.BELT: stiff, w.BELT_D: 0.3 * math.sqrt(stiff * rotor), w.PLAY: play}


class Law(NamedTuple):
    """`unit`: of the size, with F force, L angle or length, I inertia; empty where no interval can be held to it.
    `draw`: size and form, the order of its entries is that of the random numbers. `act`: parameters that it sets."""

    unit: str
    draw: Callable[[Machine, Rng], dict[str, float]]
    act: Callable[[float, dict[str, float], np.ndarray, Machine], dict[int, float]]


LAWS: dict[str, Law] = {
    "viscous_damping": Law("F*s/L", lambda m, r: {"power": r.uniform(0.85, 1.15), 
            "size": m.damping * _log(r, 0.3, 1.0) if m.kind == "arm" else m.inertia * _log(r, 0.05, 0.6)},
        lambda s, f, p, m: {w.OIL: s, w.OIL_P: f["power"]}),
    "coulomb_friction": Law("F", lambda m, r: {"size": _dry(m, r), "travel": _travel(m, r)}, lambda s, f, p, m: {}),
    "stribeck_friction": Law("F", lambda m, r: {"travel": _travel(m, r), "stick": r.uniform(1.6, 2.6),
                                                "speed": _scale(m) * _log(r, 0.05, 0.4), "size": 0.7 * _dry(m, r)},
        lambda s, f, p, m: {w.STICK: f["stick"], w.STICK_V: f["speed"]}),
    "load_friction": Law("", lambda m, r: {"size": _dry(m, r) / (m.mass * 9.81), "travel": _travel(m, r)},
        lambda s, f, p, m: {w.LOAD: 1.0}),
    "quadratic_drag": Law("F*s^2/L^2", lambda m, r: {
            "power": r.uniform(1.9, 2.1),
            "size": m.inertia * _log(r, *((0.05, 0.3) if m.light else (0.003, 0.02))) / _scale(m)},
        lambda s, f, p, m: {w.AIR: s, w.AIR_P: f["power"]}),
    "return_spring": Law("F/L", lambda m, r: {"size": _force(m, r, (0.5, 4.0), (0.1, 0.5)),
                                              "at": r.uniform(-0.4, 0.4) * _reach(m),
                                              "harden": r.uniform(0.03, 0.1) / _reach(m) ** 2},
        lambda s, f, p, m: {w.SPRING: s, w.SPRING_Q: f["at"], w.HARDEN: f["harden"]}),
    "gravity_offset": Law("", lambda m, r: {"size": _side(r) * math.radians(r.uniform(4, 10))},
        lambda s, f, p, m: {w.GA: p[w.GA] * math.cos(s) + p[w.GB] * math.sin(s),
                            w.GB: p[w.GB] * math.cos(s) - p[w.GA] * math.sin(s)}),
    "encoder_offset": Law("L", lambda m, r: {"size": _side(r) * math.radians(r.uniform(4, 10))},
        lambda s, f, p, m: {w.ZERO: s}),
    "encoder_scale": Law("1", lambda m, r: {"size": _side(r) * r.uniform(0.04, 0.15)},
        lambda s, f, p, m: {w.STRETCH: 1 + s}),
    "time_offset": Law("s", lambda m, r: {"size": r.uniform(0.015, 0.06)}, lambda s, f, p, m: {w.LATE: s}),
    "actuator_delay": Law("s", lambda m, r: {"size": r.uniform(0.012, 0.06)}, lambda s, f, p, m: {w.DELAY: s}),
    "actuator_gain": Law("1", lambda m, r: {
            "size": r.uniform(0.18, 0.5) if r.random() < 0.4 else -r.uniform(0.15, 0.5)},
        lambda s, f, p, m: {w.GAIN: 1 + s}),
    "armature": Law("I", lambda m, r: {"size": m.inertia * r.uniform(0.3, 1.0)}, lambda s, f, p, m: {w.M: p[w.M] + s}),
    "backlash": Law("L", lambda m, r: {"size": math.radians(r.uniform(1.5, 5)), "stiff": r.uniform(30, 60)},
        lambda s, f, p, m: _shaft(0.06 * p[w.M], f["stiff"] * m.stiffness, s)),
    "detent": Law("", lambda m, r: {"size": _force(m, r, (0.6, 3.0), (0.08, 0.35), _scale(m)),
                                    "at": r.uniform(-0.5, 0.5) * _reach(m), "wide": r.uniform(0.05, 0.14) * _reach(m)},
        lambda s, f, p, m: {w.NOTCH: s, w.NOTCH_Q: f["at"], w.NOTCH_W: f["wide"]}),
    "latch": Law("", lambda m, r: {"out": (out := r.uniform(0.05, 0.12)), "size": m.inertia * _log(r, 1.5, 5.0),
                                   "in": out * r.uniform(0.4, 0.7)},
        lambda s, f, p, m: {w.CATCH: s, w.CATCH_IN: f["in"], w.CATCH_OUT: f["out"]}),
    "end_stop_bounce": Law("", lambda m, r: {"size": r.uniform(0.3, 0.7), "depth": r.uniform(0.006, 0.02),
                                             "speed": 0.6 * math.sqrt(2 * m.weight / m.inertia)},
        lambda s, f, p, m: {w.STOP_K: 1.25 * p[w.M] * f["speed"] ** 2 / f["depth"] ** 2.5,
                            w.STOP_C: 1.5 * (1 - s) / (f["speed"] * (0.3 + 0.7 * s))}),
    "cogging": Law("", lambda m, r: {"size": _force(m, r, (0.8, 3.0), (0.05, 0.2)), "n": float(r.integers(6, 25)),
                                     "phase": r.uniform(0, 6.28)},
        lambda s, f, p, m: {w.COG: s, w.COG_N: f["n"], w.COG_PHASE: f["phase"]}),
    "belt_elasticity": Law("", lambda m, r: {"size": 1 / (m.stiffness * _log(r, 0.6, 2.5)),
                                             "rotor": r.uniform(0.1, 0.25)},
        lambda s, f, p, m: _shaft(f["rotor"] * p[w.M], 1 / s, -1.0)),
    "temperature_drift": Law("", lambda m, r: {"travel": _travel(m, r), "warm": r.uniform(1.2, 2.5),
                                               "seconds": r.uniform(40, 120), "size": 0.5 * _dry(m, r)},
        lambda s, f, p, m: {w.WARM: f["warm"], w.WARM_S: f["seconds"]}),
    "cable_torque": Law("", lambda m, r: {"size": _force(m, r, (1.0, 4.0), (0.3, 1.0)),
                                          "at": r.uniform(-0.2, 0.4) * _reach(m)},
        lambda s, f, p, m: {w.CABLE: s, w.CABLE_Q: f["at"]}),
    "magnet": Law("", lambda m, r: {"wide": (wide := r.uniform(0.1, 0.3) * _reach(m)),
                                    "size": _force(m, r, (0.8, 3.0), (0.1, 0.4)) * wide,
                                    "at": _side(r) * r.uniform(0.5, 1.2) * _reach(m)},
        lambda s, f, p, m: {w.MAGNET: s, w.MAGNET_Q: f["at"], w.MAGNET_W: f["wide"]}),
    "asymmetric_friction": Law("", lambda m, r: {"size": _dry(m, r), "travel": _travel(m, r),
                                                 "lean": _side(r) * r.uniform(0.4, 0.8)},
        lambda s, f, p, m: {w.LEAN: f["lean"]}),
    "time_varying_damping": Law("", lambda m, r: {"size": m.inertia * _log(r, 0.15, 0.6), "sway": r.uniform(0.7, 0.95),
                                                  "seconds": r.uniform(20, 90)},
        lambda s, f, p, m: {w.OIL: s, w.OIL_P: 1.0, w.SWAY: f["sway"], w.SWAY_S: f["seconds"]}),
}  # fmt: skip
OUTSIDE = list(LAWS)[-7:]  # what the library does not have


def draw_effect(name: str, m: Machine, rng: Rng) -> Effect:
    """The effect as strong as it may be on this machine."""
    law, form = LAWS[name], LAWS[name].draw(m, rng)
    size, power = form.pop("size"), form.get("power", 1.0)
    force, length, inertia = ("N", "m", "kg") if m.slides else ("N*m", "rad", "kg*m^2")
    unit = law.unit.replace("F", force).replace("L", length).replace("I", inertia)
    return Effect(name, size, form, bool(unit) and abs(power - round(power)) < 0.03, unit)


def hide(m: Machine, nuisance: Nuisance, effects: list[Effect]) -> np.ndarray:
    """Parameters of `laws` of the real machine with these effects."""
    p = truth(m, nuisance)
    for effect in effects:
        f, size = effect.form, effect.size
        if "travel" in f:  # dry friction of any kind
            p[w.TRAVEL], p[w.DRY], p[w.STICK_V] = f["travel"], size, 0.1 * _scale(m)
            level = size * (m.mass * 9.81 if effect.name == "load_friction" else 1.0)
            p[w.BRISTLE_D] = 0.4 * math.sqrt(level / f["travel"] * p[w.M])  # a fifth of critical
        for place, value in LAWS[effect.name].act(size, f, p, m).items():
            p[place] = value
    return p


def find_confounded(effect: Effect, m: Machine) -> Effect | None:
    """The library's effect that does nearly the same, at about its size: unless runs tell the two apart, naming it is
    no fault."""
    f, size = effect.form, effect.size
    match effect.name:
        case "load_friction" | "stribeck_friction" | "asymmetric_friction" | "temperature_drift":
            size = size * m.mass * 9.81 if effect.name == "load_friction" else 1.2 * size  # of the size it has at rest
            return Effect("coulomb_friction", size, {"travel": f["travel"]})
        case "time_varying_damping":
            return Effect("viscous_damping", size, {"power": 1.0})
        case "cable_torque":
            return Effect("return_spring", 0.6 * size, {"at": f["at"], "harden": 0.0})
        case "magnet":
            return Effect("detent", 1.3 * size / f["wide"], {"at": f["at"], "wide": 0.6 * f["wide"]})
    return None
