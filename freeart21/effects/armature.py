"""Armature: the inertia of a rotor or gear train that turns with the joint, and that gravity does not feel."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from freeart21.effects.base import Acts, Effect, parameter

_STEP, _LONGEST = 0.05, 12.0
"""Of the motion of a rotor that presses its part into a limit, and when it surely has come back; rad of its swing."""
_DEADEST = 10.0
"""Damping ratio from which on a rotor's swing comes to nothing."""


@dataclass(frozen=True)
class Armature(Effect):
    """Inertia of the joint = inertia of the links + value; of a geared rotor it is its own times the ratio squared.

    When the links stop dead at a limit the rotor goes on, twists its shaft, presses them into the limit, and takes
    them back with it: see `thrown`. `throw_back` is the part of its speed that the rotor itself comes back with when
    nothing else pulls, exp(-2 z acos(z) / sqrt(1 - z^2)) for a damping ratio z of the rotor on its shaft (a spring and
    a dashpot that let go when they push no more); `swing` the time in which it swings by a radian, 1 / (2 pi) of its
    period. With a swing of 0 the links leave at once, at throw_back times the rotor's share of all inertia. URDF has no
    word for it, MJCF for the inertia only.
    """

    name: ClassVar[str] = "armature"
    acts: ClassVar[Acts] = "inertia"
    common: ClassVar[bool] = True

    value: float = parameter("kg*m^2", "kg", 0.0, 1e4, "added inertia", scale=0.01)
    throw_back: float = parameter("1", "1", 0.0, 1.0, "part of its speed that it comes back with", default=0.0)
    swing: float = parameter("s", "s", 0.0, 1.0, "seconds in which it swings by a radian on its shaft", default=0.0)

    @staticmethod
    def law(q: Any, qd: Any, load: Any, memory: Any, value: Any, throw_back: Any, swing: Any) -> Any:
        return value + 0.0 * qd

    def mjcf_joint(self) -> dict[str, float | tuple[float, ...]]:
        return {"armature": self.value}


def thrown(
    speed: float, press: float, push: float, part: float, drive: float, throw_back: float, swing: float
) -> tuple[float, float]:
    """What a rotor does after its part has stopped dead at a limit: seconds for which the part stays there, and the
    speed, 0 or more, with which it then leaves; a speed of 0 for a part that only other forces can take away.

    The rotor swings on its shaft, a spring and a dashpot, until these press the part no more against what else acts on
    it. From then on both together go on with the rotor's momentum and under all forces; how they swing against each
    other dies within milliseconds and is left out. What acts is taken to last for as long as that.

    Args:
        speed: of the impact, 0 or more, rad/s or m/s.
        press: what else presses the part into the limit, less than 0 for what pulls it away, friction taken off; N*m
            or N.
        push: the actuator's force on the rotor, towards the limit.
        part: inertia of the links, kg*m^2 or kg.
        drive: the rotor's.
        throw_back: part of its speed that the rotor comes back with.
        swing: seconds in which it swings by a radian.
    """
    share = drive / (part + drive)
    if throw_back <= 0.0 or share <= 0.0 or speed <= 0.0:
        return 0.0, 0.0
    if swing <= 0.0:
        return 0.0, share * throw_back * speed
    low, z = 0.0, _DEADEST  # the damping ratio with which so much comes back
    for _ in range(40):
        middle = 0.5 * (low + z)
        swung = math.sqrt(abs(1.0 - middle * middle))
        angle = (math.acos(middle) if middle < 1.0 else math.acosh(middle)) / max(swung, 1e-9)
        if math.exp(-2.0 * middle * angle) > throw_back:
            low = middle
        else:
            z = middle
    unit = swing / (drive * speed)  # of forces, where the rotor comes in with 1 and swings by a radian in 1
    F, against, gone = unit * push, -unit * press, 0.0
    x, w, force = 0.0, 1.0, 2.0 * z
    while force > against:
        if gone > _LONGEST:
            return 0.0, 0.0
        x0, w0, before = x, w, force
        a1 = F - x - 2.0 * z * w
        w2 = w + 0.5 * _STEP * a1
        a2 = F - x - 0.5 * _STEP * w - 2.0 * z * w2
        w3 = w + 0.5 * _STEP * a2
        a3 = F - x - 0.5 * _STEP * w2 - 2.0 * z * w3
        w4 = w + _STEP * a3
        a4 = F - x - _STEP * w3 - 2.0 * z * w4
        x += _STEP * (w + 2.0 * w2 + 2.0 * w3 + w4) / 6.0
        w += _STEP * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
        force, gone = x + 2.0 * z * w, gone + _STEP
        if force <= against:
            over = (force - against) / (force - before)
            x, w, gone = x - over * (x - x0), w - over * (w - w0), gone - over * _STEP
    momentum, ahead = share * w * speed, share * max(x, 0.0) * speed * swing
    away = -(push + press) / (part + drive)
    square = momentum * momentum + 2.0 * away * ahead
    if square <= 0.0 or (momentum > 0.0 and away <= 0.0):
        return 0.0, 0.0
    leaves = math.sqrt(square)
    late = (momentum + leaves) / away if momentum > 0.0 else 2.0 * ahead / (leaves - momentum)
    return gone * swing + late, leaves
