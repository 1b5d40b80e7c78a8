"""Numbers and effects in the words of a mechanic."""

from __future__ import annotations

import numpy as np

from freeart21.effects.base import Effect
from freeart21.joint import JointType

PLAIN: dict[str, str] = {
    "viscous_damping": "it is damped as by oil",
    "coulomb_friction": "it rubs: dry friction",
    "stribeck_friction": "it sticks before it moves",
    "quadratic_drag": "air or fluid slows it when it is fast",
    "load_friction": "it rubs the more, the more it carries",
    "return_spring": "a spring pulls it",
    "gravity_offset": "its weight pulls otherwise than the model's",
    "detent": "it clicks into a notch",
    "latch": "a catch holds it",
    "backlash": "the drive has play",
    "end_stop_bounce": "it bounces off its stop",
    "actuator_delay": "the drive acts late",
    "actuator_gain": "the drive is weaker or stronger than told",
    "armature": "the drive's own inertia turns with it",
    "axis_tilt": "its axis points elsewhere",
    "pivot_offset": "its axis lies elsewhere",
    "screw_pitch": "it screws: it shifts along its axis as it turns",
    "wobble": "it rocks in a worn bearing",
    "sag": "it sags under its weight",
    "eccentricity": "its pin is out of round",
    "encoder_offset": "the sensor's zero is off",
    "encoder_scale": "the sensor's scale is off",
    "time_offset": "the sensor's clock is off",
}
"""Effect name to what a mechanic would say of it; none is needed for an effect to work."""


def plain(name: str) -> str:
    """What a mechanic would call the effect of this name."""
    return PLAIN.get(name, name.replace("_", " "))


def amount(value: float, unit: str) -> str:
    """A number with its SI unit as people write it, such as '12 mN m'."""
    unit = unit.replace("*", " ")
    if unit == "1":
        return f"{value:.3g}"
    if unit == "rad":
        return f"{np.degrees(value):.3g}°"
    size = abs(value)
    if unit in ("m", "s", "N m", "N", "m/rad") and 0 < size < 0.1:
        return f"{1e3 * value:.3g} m{unit}" if size >= 1e-4 else f"{1e6 * value:.3g} µ{unit}"
    return f"{value:.3g} {unit}"


def effect_words(effect: Effect, joint_type: JointType) -> str:
    """An effect with its numbers, such as 'dry friction ... (coulomb_friction: torque 0.12 N m)'."""
    numbers = ", ".join(
        f"{name} {amount(getattr(effect, name), spec.unit(joint_type))}"
        for name, spec in effect.parameters(joint_type).items()
    )
    return f"{plain(effect.name)} ({effect.name}: {numbers})"


def span_text(quantity: str, low: float, high: float, joint_type: JointType) -> str:
    """A range of a quantity in degrees or centimetres, their speeds, or seconds."""
    if quantity == "time":
        return f"{low:.1f} to {high:.1f} s"
    factor, unit = (np.degrees(1.0), "°") if joint_type == "revolute" else (100.0, " cm")
    per = "/s" if quantity == "velocity" else ""
    digits = max(0, 1 - int(np.floor(np.log10(max(factor * (high - low), 1e-6)))))
    ends = [f"{round(factor * v, digits) + 0.0:.{digits}f}" for v in (low, high)]
    return f"{ends[0]} to {ends[1]}{unit}{per}"
