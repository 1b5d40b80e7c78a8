"""Events of a joint and its drive at limits and at the ends of a slack, shared by both simulations.

Plain numbers and `math` only: `simgap.models.kernel` compiles these functions, `generator.simulate` calls them. Each of
the two detects in its own steps when an event happens.
"""

import math

_STEP, _LONGEST = 0.05, 12.0
"""Integration step of a rotor that presses its part into a limit, and the latest time of its rebound; rad of its
oscillation."""
_DEADEST = 10.0
"""Damping ratio above which a rotor does not rebound."""


def touching_side(side: int, x: float, w: float, q: float, v: float, push: float, width: float) -> int:
    """The side on which drive side and part are in contact: 1 drive side ahead, -1 behind, 0 free.

    Args:
        side: the same, before.
        x: position of the drive side, rad or m.
        w: its velocity.
        q: position of the part.
        v: its velocity.
        push: force of the drive side on the part in contact: the actuator's less drive inertia times acceleration, N*m
            or N.
        width: of the slack.
    """
    if side != 0:
        return side if side * push >= 0 else 0
    if x - q >= 0.5 * width and w > v:
        return 1
    return -1 if q - x >= 0.5 * width and w < v else 0


def meet_part(
    side: int, v: float, w: float, held: bool, part: float, drive: float, throw_back: float, least: float
) -> tuple[float, float, int]:
    """Velocities of part and drive side, and their side of contact, after an impact on `side`.

    Both continue at the speed that conserves momentum: a perfectly inelastic contact. A drive side that meets a part
    held by its limit rebounds.

    Args:
        side: 1 drive side ahead, -1 behind.
        v: velocity of the part before.
        w: velocity of the drive side before.
        held: whether the part rests on the limit that it is pushed into.
        part: inertia, kg*m^2 or kg.
        drive: inertia of the drive side.
        throw_back: rebound speed ratio of the drive side.
        least: rebound speed, 0 or more, below which it stays there.
    """
    if held:
        back = throw_back * abs(w)
        return (0.0, -side * back, 0) if back > least else (0.0, 0.0, side)
    together = (part * v + drive * w) / (part + drive)
    return together, together, side


def part_at_limit(side: int, towards: float, v: float, after: float, throw_back: float) -> tuple[float, int]:
    """Velocity of a drive side, and its side of contact, when its part has met a limit.

    A drive side that the part was pulling continues through the slack. One that was pushing it rebounds with
    `throw_back` of its speed, or stays with the part where that is 0.

    Args:
        side: side of contact, 1 or -1.
        towards: direction of the limit; only its sign matters.
        v: velocity of both before.
        after: velocity of the part after.
        throw_back: rebound speed ratio of the drive side.
    """
    if side * towards < 0:
        return v, 0
    if throw_back == 0.0:
        return after, side
    return -throw_back * v, side if -throw_back * v == after else 0


def drive_rebound(
    speed: float, press: float, push: float, part: float, drive: float, throw_back: float, swing: float
) -> tuple[float, float]:
    """Rebound of a drive whose part has stopped dead at a limit: time that the part stays there, s, and speed at which
    it then leaves, 0 or more; a speed of 0 when only other forces can take it away.

    The rotor oscillates on its shaft, a spring and a dashpot, until these no longer press the part against the other
    forces. Then both move together with the rotor's momentum and under all forces; their relative oscillation decays
    within milliseconds and is neglected. Forces are constant during the rebound.

    Args:
        speed: of the impact, 0 or more, rad/s or m/s.
        press: other forces into the limit, less than 0 away from it, less friction; N*m or N.
        push: the actuator's force on the rotor, towards the limit.
        part: inertia of the links, kg*m^2 or kg.
        drive: inertia of the drive.
        throw_back: rebound speed ratio of the rotor.
        swing: time of one radian of its oscillation, s.
    """
    share = drive / (part + drive)
    if throw_back <= 0.0 or share <= 0.0 or speed <= 0.0:
        return 0.0, 0.0
    if swing <= 0.0:
        return 0.0, share * throw_back * speed
    low, z = 0.0, _DEADEST  # the damping ratio of this rebound
    for _ in range(40):
        middle = 0.5 * (low + z)
        swung = math.sqrt(abs(1.0 - middle * middle))
        angle = (math.acos(middle) if middle < 1.0 else math.acosh(middle)) / max(swung, 1e-9)
        if math.exp(-2.0 * middle * angle) > throw_back:
            low = middle
        else:
            z = middle
    unit = swing / (drive * speed)  # unit of force for an impact speed of 1 and a swing of 1
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
