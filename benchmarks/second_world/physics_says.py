"""What counts as right by physics, written down before any case was asked: names that no data of the kind can tell
apart, families, and what of an effect outside the library is truly there. From a note on confusions of such tests
(exact gauges and practical pairs)."""

from __future__ import annotations

FAMILIES: dict[str, str] = {
    "coulomb_friction": "dry friction",
    "stribeck_friction": "dry friction",
    "load_friction": "dry friction",
    "viscous_damping": "loss that grows with speed",
    "quadratic_drag": "loss that grows with speed",
    "return_spring": "force of position",
    "gravity_offset": "force of position",
    "detent": "force of place",
    "latch": "force of place",
    "end_stop_bounce": "stop",
    "actuator_delay": "lateness",
    "time_offset": "lateness",
    "actuator_gain": "drive",
    "armature": "drive",
    "backlash": "drive",
    "encoder_offset": "encoder",
    "encoder_scale": "encoder",
}


def equals(name: str, label: dict) -> dict[str, str]:
    """Names as good as `name` on this case, each with its reason; never `name` itself."""
    out: dict[str, str] = {}
    if name in ("coulomb_friction", "load_friction") and label["steady_load"]:
        other = "load_friction" if name == "coulomb_friction" else "coulomb_friction"
        out[other] = "friction a load differs from dry friction only where the load does, and here it is constant"
    if name in ("gravity_offset", "encoder_offset") and label["kind"] != "drawer":
        other = "encoder_offset" if name == "gravity_offset" else "gravity_offset"
        out[other] = "a joint under gravity shows but the sum of encoder zero, lean and angle of the centre of mass"
    if name in ("actuator_delay", "time_offset") and label["kind"] == "arm" and label["protocol"] == "usual":
        other = "time_offset" if name == "actuator_delay" else "actuator_delay"
        out[other] = (
            "commands that come late and readings that come late are one shift, where nothing else acts at a known time"
        )
    if name in ("actuator_gain", "armature") and label["protocol"] == "asked":
        other = "armature" if name == "actuator_gain" else "actuator_gain"
        out[other] = "without gravity and without a known force only the ratio of drive and inertia is seen"
    return out


# Of effects outside the library: names that say a part of the truth. Said of the whole, they claim too much.
IN_PART: dict[str, dict[str, str]] = {
    "cogging": {},
    "belt_elasticity": {},
    "temperature_drift": {"coulomb_friction": "it is dry friction, of a size that changes"},
    "cable_torque": {"return_spring": "it pulls back as a spring does, on one side and stiffening"},
    "magnet": {"detent": "it draws the part to a place, as a notch does, but from further off"},
    "asymmetric_friction": {"coulomb_friction": "it is dry friction, of two sizes"},
    "time_varying_damping": {"viscous_damping": "it is oil, of a size that changes"},
}
for _name in ("temperature_drift", "asymmetric_friction"):
    IN_PART[_name]["load_friction"] = "where the load is constant (`equals` decides)"


def part_of(name: str, label: dict) -> set[str]:
    """Names that say a part of what effect `name`, from outside the library, does on this case."""
    names = set(IN_PART[name])
    if "load_friction" in names and not label["steady_load"]:
        names.discard("load_friction")
    return names
