"""What a joint and its drive do at limits and at the ends of a slack: the one code of both simulations.

Numbers in, numbers out, and `math` alone: `simgap.models.kernel` compiles these functions, `generator.simulate` calls
them. When an event is, each of the two finds in its own steps.
"""

import math

_STEP, _LONGEST = 0.05, 12.0
"""Of the motion of a rotor that presses its part into a limit, and when it surely has come back; rad of its swing."""
_DEADEST = 10.0
"""Damping ratio from which on a rotor's swing comes to nothing."""


def touching_side(side: int, x: float, w: float, q: float, v: float, push: float, width: float) -> int:
    """The side on which a drive side and its part touch: 1 drive side ahead, -1 behind, 0 apart.

    Args:
        side: the same, until now.
        x: position of the drive side, rad or m.
        w: its velocity.
        q: position of the part.
        v: its velocity.
        push: force that the drive side puts on the part if they touch: the actuator's less drive inertia times
            acceleration, N*m or N.
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
    """Velocities of the part and of the drive side, and the side on which they touch, after they have met on `side`.

    Both go on at the speed that keeps the momentum: a perfectly inelastic contact. A drive side that comes upon a part
    that its limit holds comes back from there.

    Args:
        side: 1 drive side ahead, -1 behind.
        v: velocity of the part before.
        w: velocity of the drive side before.
        held: whether the part rests on the limit that it is pushed into.
        part: inertia, kg*m^2 or kg.
        drive: inertia of the drive side.
        throw_back: part of its speed that the drive side comes back with.
        least: speed, 0 or more, up to which it stays there instead.
    """
    if held:
        back = throw_back * abs(w)
        return (0.0, -side * back, 0) if back > least else (0.0, 0.0, side)
    together = (part * v + drive * w) / (part + drive)
    return together, together, side


def part_at_limit(side: int, towards: float, v: float, after: float, throw_back: float) -> tuple[float, int]:
    """Velocity of a drive side, and the side on which it touches its part, when this has met a limit.

    One that the part was dragging along goes on through the slack; one that was pushing it comes back with `throw_back`
    of its speed, or, where that is 0, stays with the part.

    Args:
        side: on which they touched, 1 or -1.
        towards: the limit's direction, its sign counts.
        v: velocity of both before.
        after: velocity of the part after.
        throw_back: part of its speed that the drive side comes back with.
    """
    if side * towards < 0:
        return v, 0
    if throw_back == 0.0:
        return after, side
    return -throw_back * v, side if -throw_back * v == after else 0


def drive_rebound(
    speed: float, press: float, push: float, part: float, drive: float, throw_back: float, swing: float
) -> tuple[float, float]:
    """What a drive does after its part has stopped dead at a limit: seconds for which the part stays there, and the
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
        drive: the drive's.
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
