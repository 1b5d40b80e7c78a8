"""Which effects are asked for, alone and together, and on which machines: written down before any case was asked."""

from __future__ import annotations

from benchmarks.second_world.hidden import DRAWS

# Which machines and protocols an effect is looked for on: what a sensible experimenter would do who suspects it.
WHERE: dict[str, list[tuple[str, str]]] = {
    "viscous_damping": [("pendulum", "usual"), ("door", "usual"), ("drawer", "usual"), ("pendulum", "free")],
    "coulomb_friction": [
        ("pendulum", "usual"),
        ("arm", "usual"),
        ("pendulum", "free"),
        ("drawer", "usual"),
        ("door", "usual"),
    ],
    "stribeck_friction": [("arm", "usual"), ("pendulum", "usual")],
    "load_friction": [("pendulum", "usual"), ("pendulum", "free")],
    "quadratic_drag": [("pendulum", "usual"), ("pendulum", "free"), ("door", "usual")],
    "return_spring": [("door", "usual"), ("drawer", "usual"), ("pendulum", "usual")],
    "encoder_scale": [("pendulum", "usual"), ("pendulum", "free")],
    "time_offset": [("pendulum", "usual")],
    "actuator_delay": [("arm", "and pushed")],
    "actuator_gain": [("arm", "usual"), ("arm", "and pushed")],
    "armature": [("pendulum", "usual"), ("arm", "and pushed")],
    "backlash": [("arm", "usual"), ("arm", "and pushed")],
    "detent": [("pendulum", "usual"), ("door", "usual"), ("drawer", "usual")],
    "latch": [("door", "caught")],
    "end_stop_bounce": [("lid", "usual")],
    "cogging": [("pendulum", "usual"), ("door", "usual")],
    "belt_elasticity": [("arm", "usual")],
    "temperature_drift": [("pendulum", "usual"), ("pendulum", "free"), ("door", "usual")],
    "cable_torque": [("pendulum", "usual"), ("door", "usual")],
    "magnet": [("pendulum", "usual"), ("door", "usual")],
    "asymmetric_friction": [("pendulum", "usual"), ("pendulum", "free"), ("door", "usual")],
    "time_varying_damping": [("pendulum", "usual"), ("pendulum", "free"), ("door", "usual")],
}
OUTSIDE = list(DRAWS)[-7:]
SINGLES = [name for name in WHERE if name not in OUTSIDE]
PAIRS: list[tuple[str, str]] = [
    ("coulomb_friction", "quadratic_drag"),  # the masking pair of facts, fact 7
    ("coulomb_friction", "viscous_damping"),
    ("coulomb_friction", "return_spring"),
    ("viscous_damping", "return_spring"),
    ("quadratic_drag", "detent"),
    ("coulomb_friction", "encoder_scale"),
    ("viscous_damping", "time_offset"),
    ("viscous_damping", "armature"),
    ("coulomb_friction", "actuator_gain"),
    ("actuator_delay", "coulomb_friction"),
    ("backlash", "actuator_gain"),
    ("viscous_damping", "end_stop_bounce"),
]
# Kind and protocol of a pair, where its first member alone would be measured otherwise.
PAIR_WHERE: dict[tuple[str, str], tuple[str, str]] = {
    PAIRS[2]: ("pendulum", "usual"),
    PAIRS[3]: ("door", "usual"),
    PAIRS[4]: ("pendulum", "usual"),
    PAIRS[5]: ("pendulum", "usual"),
    PAIRS[6]: ("pendulum", "usual"),
    PAIRS[7]: ("pendulum", "usual"),
    PAIRS[8]: ("arm", "usual"),
    PAIRS[9]: ("arm", "and pushed"),
    PAIRS[10]: ("arm", "usual"),
    PAIRS[11]: ("lid", "usual"),
}
for _pair in PAIRS[:2]:
    PAIR_WHERE[_pair] = ("pendulum", "free")
# What no such data can tell apart (facts, section 3.1): the hidden one, machine, protocol, the set that has to be told.
GAUGES: list[tuple[str, str, str, tuple[str, ...]]] = [
    ("gravity_offset", "pendulum", "free", ("gravity_offset", "encoder_offset")),
    ("encoder_offset", "pendulum", "free", ("gravity_offset", "encoder_offset")),
    ("actuator_delay", "arm", "usual", ("actuator_delay", "time_offset")),
    ("time_offset", "arm", "usual", ("actuator_delay", "time_offset")),
    ("coulomb_friction", "drawer", "usual", ("coulomb_friction", "load_friction")),
    ("actuator_gain", "drawer", "asked", ("actuator_gain", "armature")),
]
# Effects that motions of a quantum or two of the encoder do not show, and the machine.
STILL: list[tuple[str, str]] = [
    ("encoder_scale", "pendulum"),
    ("time_offset", "pendulum"),
    ("quadratic_drag", "pendulum"),
    ("quadratic_drag", "door"),
    ("quadratic_drag", "drawer"),
    ("actuator_gain", "arm"),
    ("actuator_delay", "arm"),
]
