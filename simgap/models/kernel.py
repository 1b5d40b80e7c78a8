"""Simulation of one joint under any effects, compiled: RK4 steps between events, each at its own time.

Events: friction stops the joint (it then sticks, or reverses), an impact at a limit, a change of memory, contact or
separation at a slack, and a jump of an input. A step with an event is cut there, by regula falsi or bisection.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from freeart21.se3 import Array, Ints
from simgap.models.laws import (
    DRIVE,
    FORCE,
    STAMP,
    STOP,
    commanded_force,
    delivered_force,
    drive_rebound,
    inlined,
    jit,
    law,
    meet_part,
    part_at_limit,
    remember,
    touching_side,
)

INERTIA, GRAVITY_COS, GRAVITY_SIN, GRAVITY_CONST = 0, 1, 2, 3
LOAD_ARM2, LOAD_WEIGHT2, LOAD_ACROSS, LOAD_TURNED = 4, 5, 6, 7
GAIN, COMMAND_DELAY, STIFFNESS, DAMPING = 8, 9, 10, 11
LOWER, UPPER, SLACK_WIDTH, SLACK_INERTIA = 12, 13, 14, 15
READING_DELAY, Q0, QD0, TRAVEL, GRIPPING = 16, 17, 18, 19, 20
SHAFT_INERTIA, SHAFT_BACK, SHAFT_SWING, HOLDING = 21, 22, 23, 24
OFFSET, DEAD_BAND, MAX_COMMANDED, BACK_EMF, MAX_FORCE = 25, 26, 27, 28, 29
MOMENT_SCALE, MASS_SCALE, BASE_MOVES = 30, 31, 32
"""Of a moving base: factors of its moment and mass terms (`base_motion.base_motion_terms`), and whether it moves."""
BASE_COS, BASE_SIN, BASE_CONST, BASE_COS2, BASE_SIN2, BASE_LINEAR = 33, 34, 35, 36, 37, 38
"""Force terms of the moving base at present."""
MODEL_ERROR_SPEED = 39
"""Speed at which the speed term of the effects' model error is at its largest; 0 without model error."""
GEARED = 40
"""Whether the drive's gears have friction."""
HEAD = 41
"""Length of the head of the vector that describes a simulation. Then, for each effect: place, model error (TERM_HEAD
numbers together), parameters."""
TERM_HEAD = 5
"""Middle and half width of an effect's place or of its model error's range; shares over speed, over position, and of
the bend."""

_BISECTIONS = 25
_SPARE_STEPS = 4000
"""Steps beyond twice the regular ones that events may add."""
_FALSI = 7
_BEYOND_EVENT = 2.0**-25
"""Share of a step beyond a located event, where it has surely happened: the resolution of the bisection."""
_PRESLIDING_LEFT = 0.02
"""Share of the friction level below which presliding is not resolved by steps."""
_PRESLIDING_TRAVELS = 40.0
"""Presliding travels after which the initial state is forgotten: exp(-40) is below rounding."""
_MAX_REST_LOAD = 0.98
"""Share of the friction level above which a part at rest deflects no further before it slides."""
_CONVERGED = 1e-9
"""Relative change of an acceleration at convergence: four orders below the step's error."""
_MIN_SPEED_SHARE = 0.05
"""Share of MODEL_ERROR_SPEED below which the speed term is constant. Not measured."""
_PLACE_REACH = 2.0
"""Distance to the place of an effect, in half widths, within which steps are fine."""
_STOPPED, _LIMIT, _MEMORY, _MET, _PARTED, _LOCATED = 1, 2, 4, 8, 16, 32


State = tuple[float, float, float, float]
"""Position and speed of the part, then of the drive side."""


@inlined
def error_factor(p: Array, at: int, q: float, v: float) -> float:  # pragma: no cover
    """Factor of an effect's formula with model error: a slope over the logarithm of speed, so that another exponent
    deviates evenly, and a slope and a bend over position."""
    fast = 1.0 - 2.0 * math.log(max(min(abs(v) / p[MODEL_ERROR_SPEED], 1.0), _MIN_SPEED_SHARE)) / math.log(
        _MIN_SPEED_SHARE
    )
    x = min(max((q - p[at]) / p[at + 1], -1.0), 1.0)
    return max(1.0 + p[at + 2] * fast + p[at + 3] * x + p[at + 4] * (1.5 * x * x - 0.5), 0.0)


@njit(cache=True)
def error_factors(p: Array, at: int, q: Array, v: Array) -> Array:  # pragma: no cover
    """(n,) the same along a motion; 1 without model error."""
    found = np.ones(len(q))
    if p[MODEL_ERROR_SPEED] > 0.0:
        for i in range(len(q)):
            found[i] = error_factor(p, at, q[i], v[i])
    return found


@inlined
def _sum(
    acts: int, terms: Ints, p: Array, memory: Array, q: float, v: float, load: float, carried: float,
) -> float:  # pragma: no cover  # fmt: skip
    """Sum of all forces, or of all friction levels, under the bearing's and the gears' load."""
    total = 0.0
    for k in range(len(terms)):
        if terms[k, 1] == acts:
            presses = carried if terms[k, 4] else load
            own = law(terms[k, 0], q, v, presses, memory[k], p, terms[k, 2] + TERM_HEAD)
            total += own if p[MODEL_ERROR_SPEED] == 0.0 else own * error_factor(p, terms[k, 2], q, v)
    return total


@inlined
def _actuator(p: Array, q: float, v: float, position: float, effort: float) -> float:  # pragma: no cover
    """Force of the actuator at the position and speed that it sees; `position` is NaN without a position law. GAIN and
    OFFSET are 0 while it is off."""
    commanded = commanded_force(q, v, position, effort, p[STIFFNESS], p[DAMPING], p[DEAD_BAND])
    return p[GAIN] * delivered_force(commanded, v, p[MAX_COMMANDED], p[BACK_EMF], p[MAX_FORCE]) + p[OFFSET]


@inlined
def _base_force(p: Array, q: float) -> float:  # pragma: no cover
    """Force of a moving base (`base_motion.base_motion_force`)."""
    c, s = math.cos(q), math.sin(q)
    F = p[BASE_CONST] + p[BASE_LINEAR] * q + p[BASE_COS] * c + p[BASE_SIN] * s
    return F + p[BASE_COS2] * (c * c - s * s) + 2.0 * p[BASE_SIN2] * s * c


@inlined
def _total_force(
    terms: Ints, p: Array, memory: Array, q: float, v: float, side: int, push: float, position: float, effort: float,
) -> float:  # pragma: no cover  # fmt: skip
    """All forces on the part but friction."""
    F = p[GRAVITY_CONST] + push
    if p[GRAVITY_COS] != 0.0:
        F += p[GRAVITY_COS] * math.cos(q - p[GRAVITY_SIN])
    if p[BASE_MOVES] != 0.0:
        F += _base_force(p, q)
    F += _sum(FORCE, terms, p, memory, q, v, 0.0, 0.0)
    return F + _drive_force(p, q, v, side, position, effort)


@inlined
def _drive_force(p: Array, q: float, v: float, side: int, position: float, effort: float) -> float:  # pragma: no cover
    """Force of the actuator on the part, 0 within a slack."""
    if p[SLACK_WIDTH] == 0.0:
        return _actuator(p, q, v, position, effort)
    if side != 0:
        return _actuator(p, q + 0.5 * side * p[SLACK_WIDTH], v, position, effort)
    return 0.0


@inlined
def _gear_load(
    p: Array, q: float, v: float, side: int, position: float, effort: float, F: float,
) -> float:  # pragma: no cover  # fmt: skip
    """Load of the gears under all forces `F` but friction; 0 where none have friction."""
    if p[GEARED] == 0.0:
        return 0.0
    return abs(2.0 * _drive_force(p, q, v, side, position, effort) - F)


@inlined
def _bearing_load(p: Array, q: float, v: float) -> tuple[float, float]:  # pragma: no cover
    """Square of the bearing load without acceleration, and its derivative by the acceleration; 0 where no friction
    depends on it."""
    if p[LOAD_WEIGHT2] == 0.0 and p[LOAD_ARM2] == 0.0:
        return 0.0, 0.0
    c, s = math.cos(q), math.sin(q)
    load2 = p[LOAD_ARM2] * v**4 + p[LOAD_WEIGHT2] + 2.0 * v * v * (c * p[LOAD_ACROSS] + s * p[LOAD_TURNED])
    return load2, 2.0 * (s * p[LOAD_ACROSS] - c * p[LOAD_TURNED])


@inlined
def _level_of(
    terms: Ints, p: Array, memory: Array, q: float, v: float, qdd: float, bearing: tuple[float, float], carried: float,
) -> float:  # pragma: no cover  # fmt: skip
    """Friction level at this acceleration, for the loads of `_bearing_load` and `_gear_load`."""
    load2 = bearing[0] + qdd * (bearing[1] + qdd * p[LOAD_ARM2])
    load = math.sqrt(load2) if load2 > 0.0 else 0.0  # avoids a square root, which costs as much as a formula
    return _sum(DRIVE, terms, p, memory, q, v, load, carried)


@inlined
def _level(terms: Ints, p: Array, memory: Array, q: float, carried: float) -> float:  # pragma: no cover
    """Friction level at rest."""
    return _level_of(terms, p, memory, q, 0.0, 0.0, _bearing_load(p, q, 0.0), carried)


@inlined
def _bristle(p: Array, slide: float, grip: tuple[float, float], q: float) -> float:  # pragma: no cover
    """Presliding state at `q`, -1 to 1: `grip` is the state where a motion in direction `slide` began, and that
    position."""
    if p[TRAVEL] == 0.0 or grip[0] == slide:
        return 1.0 * slide
    way = abs(q - grip[1])
    if way > _PRESLIDING_TRAVELS * p[TRAVEL]:
        return 1.0 * slide
    return slide + (grip[0] - slide) * math.exp(-way / p[TRAVEL])


@inlined
def _acceleration(
    terms: Ints, p: Array, memory: Array, q: float, v: float, slide: float, grip: tuple[float, float], side: int,
    push: float, position: float, effort: float, loaded: bool,
) -> float:  # pragma: no cover  # fmt: skip
    """Of a moving part; `slide` is the direction in which it slides against friction, 0 without friction."""
    share = 1.0 / (p[INERTIA] + (p[SLACK_INERTIA] if side != 0 else 0.0))
    F = _total_force(terms, p, memory, q, v, side, push, position, effort)
    free = F * share
    if slide == 0:
        return free
    # LuGre friction: bristles deflect over TRAVEL, with GRIPPING times the usual damping (Canudas de Wit, Olsson,
    # Astrom and Lischinsky 1995); instant without TRAVEL
    bent, damp = _bristle(p, slide, grip, q), 0.0
    if bent != slide:
        damp = p[GRIPPING] * math.sqrt(p[INERTIA] / p[TRAVEL]) * abs(v) * (slide - bent)
    bearing, carried, qdd = _bearing_load(p, q, v), _gear_load(p, q, v, side, position, effort, F), free
    for _ in range(5 if loaded else 1):  # fixed point: the load depends on the acceleration
        level, before = _level_of(terms, p, memory, q, v, qdd, bearing, carried), qdd
        qdd = free - (level * bent + (damp * math.sqrt(level) if damp != 0.0 else 0.0)) * share
        if abs(qdd - before) <= _CONVERGED * abs(qdd):
            break
    return qdd


@inlined
def _slopes(
    y: State, terms: Ints, p: Array, memory: Array, frozen: bool, slide: float, grip: tuple[float, float], side: int,
    push: float, position: float, effort: float, loaded: bool,
) -> tuple[float, float]:  # pragma: no cover  # fmt: skip
    """Accelerations of part and drive side at y = (q, v, x, w)."""
    a = 0.0
    if not frozen:
        a = _acceleration(terms, p, memory, y[0], y[1], slide, grip, side, push, position, effort, loaded)
    b = 0.0
    if p[SLACK_WIDTH] > 0.0:
        b = a if side != 0 else _actuator(p, y[2], y[3], position, effort) / p[SLACK_INERTIA]
    return a, b


@jit
def _rk4_step(
    y: State, h: float, terms: Ints, p: Array, memory: Array, frozen: bool, slide: float, grip: tuple[float, float],
    side: int, push: float, position: float, effort: float, loaded: bool,
) -> State:  # pragma: no cover  # fmt: skip
    """State after `h` by one RK4 step under constant conditions."""
    q, v, x, w = y
    q1, v1, x1, w1, there = q, v, x, w, y
    for stage in range(4):
        a, b = _slopes(there, terms, p, memory, frozen, slide, grip, side, push, position, effort, loaded)
        share = h / (6.0 if stage == 0 or stage == 3 else 3.0)
        q1, v1, x1, w1 = q1 + share * there[1], v1 + share * a, x1 + share * there[3], w1 + share * b
        far = h if stage == 2 else 0.5 * h
        there = (q + far * there[1], v + far * a, x + far * there[3], w + far * b)
    if side != 0:
        return q1, v1, q1 + 0.5 * side * p[SLACK_WIDTH], v1
    return q1, v1, x1, w1


@jit
def _contact(
    y: State, terms: Ints, p: Array, memory: Array, frozen: bool, slide: float, grip: tuple[float, float], side: int,
    push: float, position: float, effort: float, loaded: bool,
) -> float:  # pragma: no cover  # fmt: skip
    """Force of the drive side on the part in contact."""
    a, _ = _slopes(y, terms, p, memory, frozen, slide, grip, side, push, position, effort, loaded)
    return _actuator(p, y[2], y[3], position, effort) - p[SLACK_INERTIA] * a


@jit
def _events(
    y: State, terms: Ints, p: Array, memory: Array, frozen: bool, slide: float, grip: tuple[float, float], side: int,
    push: float, position: float, effort: float, loaded: bool,
) -> int:  # pragma: no cover  # fmt: skip
    """Events that have happened by the state `y`, as bits."""
    found = 0
    q, v, x, w = y
    if not frozen:
        if slide * v < 0:
            found |= _STOPPED
        if q < p[LOWER] or q > p[UPPER]:
            found |= _LIMIT
        for k in range(len(terms)):
            if terms[k, 1] == FORCE:
                leap = remember(terms[k, 0], q, memory[k], p, terms[k, 2] + TERM_HEAD) - memory[k]
                found |= _MEMORY if abs(leap) > 0.5 else 0
    if p[SLACK_WIDTH] > 0.0:
        pushes = 0.0
        if side != 0:
            pushes = _contact(y, terms, p, memory, frozen, slide, grip, side, push, position, effort, loaded)
        if touching_side(side, x, w, q, v, pushes, p[SLACK_WIDTH]) != side:
            found |= _MET if side == 0 else _PARTED
    return found


@jit
def _event_function(
    what: int, y: State, terms: Ints, p: Array, memory: Array, frozen: bool, slide: float, grip: tuple[float, float],
    side: int, push: float, position: float, effort: float, loaded: bool,
) -> float:  # pragma: no cover  # fmt: skip
    """Zero at the event: distance of the sides of a slack before contact, force between them before separation."""
    if what == _MET:
        return 0.5 * p[SLACK_WIDTH] - abs(y[2] - y[0])
    return side * _contact(y, terms, p, memory, frozen, slide, grip, side, push, position, effort, loaded)


@jit
def _passes_place(terms: Ints, p: Array, a: float, b: float) -> bool:  # pragma: no cover
    """Whether a motion from a to b comes near the place of an effect."""
    for k in range(len(terms)):
        if terms[k, 3]:
            at = terms[k, 2]
            reach = _PLACE_REACH * p[at + 1]
            if min(a, b) <= p[at] + reach and max(a, b) >= p[at] - reach:
                return True
    return False


@jit
def _rest_position(
    y: State, p: Array, load: float, part: float, side: int,
) -> tuple[State, tuple[float, float]]:  # pragma: no cover  # fmt: skip
    """State and grip of a part at rest that deflects under a `load` (relative to the friction level) to equilibrium."""
    load = min(max(load, -_MAX_REST_LOAD), _MAX_REST_LOAD)
    if abs(load - part) < 1e-9:
        return y, (part, y[0])
    way = 1.0 if load > part else -1.0
    q = y[0] + way * p[TRAVEL] * math.log((way - part) / (way - load))
    q = min(max(q, p[LOWER]), p[UPPER])
    return (q, 0.0, q + 0.5 * side * p[SLACK_WIDTH] if side != 0 else y[2], y[3]), (load, q)


@jit
def _rebound(terms: Ints, p: Array, v: float) -> float:  # pragma: no cover
    """Speed after an impact with speed `v`."""
    after = 0.0
    for k in range(len(terms)):
        if terms[k, 1] == STOP:
            speed = law(terms[k, 0], 0.0, v, 0.0, 0.0, p, terms[k, 2] + TERM_HEAD)
            if abs(speed) > abs(after):
                after = speed
    return after


@jit
def _rebound_from_drive(
    terms: Ints, p: Array, memory: Array, limit: float, towards: float, v: float, side: int, push: float,
    position: float, effort: float,
) -> tuple[float, float]:  # pragma: no cover  # fmt: skip
    """Time at a limit, s, and speed after it, of a part that hits it with `v` and is taken back by its drive."""
    drive, press, others = 0.0, 0.0, p[INERTIA] - p[SHAFT_INERTIA]
    if p[SHAFT_SWING] > 0.0:
        drive = towards * _actuator(p, limit, 0.0, position, effort)
        F = _total_force(terms, p, memory, limit, 0.0, side, push, position, effort)
        press = towards * F - drive
        press += _level(terms, p, memory, limit, _gear_load(p, limit, 0.0, side, position, effort, F))
    stays, speed = drive_rebound(abs(v), press, drive, others, p[SHAFT_INERTIA], p[SHAFT_BACK], p[SHAFT_SWING])
    return stays, -towards * speed


@jit
def _roll(
    p: Array, terms: Ints, memory: Array, times: Array, t_in: Array, command: Array, effort: Array, pushes: Array,
    hold_difference: Array, base_motion: Array, coarse: float, fine: float, out: Array,
) -> None:  # pragma: no cover  # fmt: skip
    """Positions `out` (n,) as read at `times` (n,), for one vector; steps are `coarse`, `fine` near the place of an
    effect."""
    n, inputs = len(times), len(t_in)
    dry, loaded = False, p[LOAD_ARM2] > 0
    for k in range(len(terms)):
        dry |= terms[k, 1] == DRIVE
    y = (p[Q0], p[QD0], p[Q0], p[QD0])
    for k in range(len(terms)):
        if terms[k, 1] == FORCE:
            memory[k] = remember(terms[k, 0], y[0], 0.0, p, terms[k, 2] + TERM_HEAD)
    turned = math.atan2(p[GRAVITY_SIN], p[GRAVITY_COS])  # from here on as amplitude and phase
    p[GRAVITY_COS], p[GRAVITY_SIN] = math.hypot(p[GRAVITY_COS], p[GRAVITY_SIN]), turned
    gain, offset = p[GAIN], p[OFFSET]
    if inputs == 0:
        p[GAIN] = p[OFFSET] = 0.0
    delayed, now = p[COMMAND_DELAY], times[0] - p[READING_DELAY]
    end = times[n - 1] - p[READING_DELAY]
    late = early = 0  # current inputs of the actuator, and of pushes
    side, done, resting, passed = 0, 0, 0, -np.inf
    waits, leaves = -np.inf, 0.0  # a drive's rebound: when and how fast the part leaves its limit
    grip = (0.0 if y[1] == 0.0 else math.copysign(1.0, y[1]), y[0])
    most = _SPARE_STEPS + 2 * (int((end - now) / fine) + 2 * inputs)
    for _ in range(most):
        if done == n:
            return
        # inputs
        position, effort_now, push, until = np.nan, 0.0, 0.0, np.inf
        if inputs > 0:
            while late + 1 < inputs and t_in[late + 1] + delayed <= now + 1e-12:
                late += 1
            while early + 1 < inputs and t_in[early + 1] <= now + 1e-12:
                early += 1
            position = command[late] + p[HOLDING] * hold_difference[0, late]
            effort_now = effort[late] + p[HOLDING] * hold_difference[1, late]
            push = pushes[early] + p[HOLDING] * hold_difference[2, early]
            p[GAIN], p[OFFSET] = gain, offset
            if np.isnan(effort_now):  # off
                p[GAIN], p[OFFSET], effort_now = 0.0, 0.0, 0.0
            if p[BASE_MOVES] != 0.0:
                b, m = p[MOMENT_SCALE], p[MASS_SCALE]
                p[BASE_COS] = b * base_motion[0, early] + m * base_motion[3, early]
                p[BASE_SIN] = b * base_motion[1, early] + m * base_motion[4, early]
                p[BASE_CONST], p[BASE_LINEAR] = m * base_motion[2, early], m * base_motion[7, early]
                p[BASE_COS2], p[BASE_SIN2] = m * base_motion[5, early], m * base_motion[6, early]
            if late + 1 < inputs:
                until = t_in[late + 1] + delayed
            if early + 1 < inputs:
                until = min(until, t_in[early + 1])
        step = fine if fine < coarse and (now < passed or _passes_place(terms, p, y[0], y[0])) else coarse
        h = max(min(step, until - now), 1e-9)
        # sticking and resting
        q, v = y[0], y[1]
        frozen, still, slide, F = False, True, 0, 0.0
        if now < waits:
            frozen, h = True, min(h, waits - now)
        elif v == 0.0 and (dry or resting != 0):
            F = _total_force(terms, p, memory, q, 0.0, side, push, position, effort_now)
            carried = _gear_load(p, q, 0.0, side, position, effort_now, F)
            held = _level(terms, p, memory, q, carried) if dry else 0.0
            if abs(F) <= held or (resting != 0 and resting * F >= -held):
                frozen = True
                if p[TRAVEL] > 0.0 and resting == 0 and held > 0.0:
                    y, grip = _rest_position(y, p, F / held, grip[0], side)
                    still, q = y[0] == q, y[0]
            else:
                slide, resting = (1 if F > 0 else -1) if dry else 0, 0
        elif dry:
            slide, resting = 1 if v > 0 else -1, 0
        else:
            resting = 0
        if p[TRAVEL] > 0.0 and slide != 0:
            grip = (grip[0], q)
            if abs(slide - grip[0]) > _PRESLIDING_LEFT:  # resolve presliding
                if v == 0.0:
                    h = min(h, math.sqrt(p[TRAVEL] * p[INERTIA] / max(abs(F), 1e-12)))
                else:
                    h = min(h, 0.5 * p[TRAVEL] / abs(v))
                h = max(h, 0.01 * step)
        if frozen and still and p[SLACK_WIDTH] == 0.0:
            until = min(until, waits) if now < waits else until
            h = max(min(until, end) - now, 1e-9)  # up to the next change
        # a step, cut at events
        after = _rk4_step(y, h, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded)
        if step > fine and _passes_place(terms, p, q, after[0]):
            passed = now + h
            continue
        found = _events(after, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded)
        if v * after[1] < 0.0 and not found & _LIMIT:  # it reverses within the step, perhaps beyond a limit
            turn = v / (v - after[1]) * h
            peak = q + 0.55 * turn * v
            if peak < p[LOWER] or peak > p[UPPER]:
                there = _rk4_step(
                    y, turn, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded
                )
                if there[0] < p[LOWER] or there[0] > p[UPPER]:
                    after, h = there, turn
                    found = _events(
                        after, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded
                    )
        if found in (_STOPPED, _LIMIT):  # a smooth event function: regula falsi (Illinois)
            aim = 0.0 if found == _STOPPED else (p[LOWER] if after[0] < p[LOWER] else p[UPPER])
            which = 1 if found == _STOPPED else 0
            low, high, f_low, f_high = 0.0, h, y[which] - aim, after[which] - aim
            if f_low * f_high < 0.0:
                side_kept = 0
                for _ in range(_FALSI):
                    mid = (low * f_high - high * f_low) / (f_high - f_low)
                    there = _rk4_step(
                        y, mid, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded
                    )
                    f_mid = there[which] - aim
                    if f_mid * f_high > 0.0:
                        high, f_high, after = mid, f_mid, there
                        f_low = 0.5 * f_low if side_kept == 1 else f_low
                        side_kept = 1
                    else:
                        low, f_low, after = mid, f_mid, there
                        f_high = 0.5 * f_high if side_kept == -1 else f_high
                        side_kept = -1
                    h = mid
                    if abs(f_mid) < 1e-12:
                        break
                found |= _LOCATED
        elif found in (_MET, _PARTED):  # the same, and slightly beyond
            low, high, root = 0.0, h, 0.0
            f_low = _event_function(
                found, y, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded
            )
            f_high = _event_function(
                found, after, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded
            )
            if f_low * f_high < 0.0:
                side_kept = 0
                for _ in range(_FALSI):
                    root = (low * f_high - high * f_low) / (f_high - f_low)
                    there = _rk4_step(
                        y, root, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded
                    )
                    f_root = _event_function(
                        found, there, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded
                    )
                    if f_root * f_high > 0.0:
                        high, f_high = root, f_root
                        f_low = 0.5 * f_low if side_kept == 1 else f_low
                        side_kept = 1
                    else:
                        low, f_low = root, f_root
                        f_high = 0.5 * f_high if side_kept == -1 else f_high
                        side_kept = -1
                    if abs(f_root) < 1e-12:
                        break
            root = min(root + _BEYOND_EVENT * h, h)
            there = _rk4_step(y, root, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded)
            beyond = _events(there, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded)
            if beyond:
                after, found, h = there, beyond | _LOCATED, root
        if found and not found & _LOCATED:
            low, high = 0.0, h
            for _ in range(_BISECTIONS):
                mid = 0.5 * (low + high)
                there = _rk4_step(
                    y, mid, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded
                )
                at_mid = _events(there, terms, p, memory, frozen, slide, grip, side, push, position, effort_now, loaded)
                if at_mid:
                    high, after, found = mid, there, at_mid
                else:
                    low = mid
            h = high
        if not abs(after[0]) < 1e6:
            for i in range(done, n):
                out[i] = 1e6
            return
        # readings within the step: cubic Hermite interpolation
        last = now + h >= end - 1e-12
        while done < n and (times[done] - p[READING_DELAY] <= now + h or last):
            s = min((times[done] - p[READING_DELAY] - now) / h, 1.0)
            u = 1.0 - s
            out[done] = u * u * ((1 + 2 * s) * q + s * h * v) + s * s * ((1 + 2 * u) * after[0] - u * h * after[1])
            done += 1
        now += h
        y = after
        if waits > -np.inf and now >= waits - 1e-12:
            y, resting, waits = (y[0], leaves, y[2], y[3]), 0, -np.inf
        if slide != 0:
            grip = (_bristle(p, slide, grip, y[0]), y[0])
        for k in range(len(terms)):
            if terms[k, 1] == FORCE:
                memory[k] = remember(terms[k, 0], y[0], memory[k], p, terms[k, 2] + TERM_HEAD)
        # effects of the event
        if found & _PARTED and not found & (_STOPPED | _LIMIT):  # a part that stops takes its drive side with it
            side = 0
        if found & _MET:
            side = 1 if y[2] > y[0] else -1
            at, part, drive = y[0] + 0.5 * side * p[SLACK_WIDTH], p[INERTIA], p[SLACK_INERTIA]
            least = 0.5 * step * max(side * _actuator(p, y[2], y[3], position, effort_now) / drive, 0.0)
            held = frozen and resting * side > 0  # at its limit
            v1, w1, side = meet_part(side, y[1], y[3], held, part, drive, p[SHAFT_BACK], least)
            y = (y[0], v1, at, w1)
        if found & _LIMIT:
            towards = 1 if y[0] - p[LOWER] > p[UPPER] - y[0] else -1
            limit = p[UPPER] if towards > 0 else p[LOWER]
            back, stays = _rebound(terms, p, y[1]), 0.0
            if p[SHAFT_BACK] > 0.0 and p[SLACK_WIDTH] == 0.0:
                seconds, taken = _rebound_from_drive(
                    terms, p, memory, limit, towards, y[1], side, push, position, effort_now
                )
                if abs(taken) > abs(back):
                    back, stays = taken, seconds
            inward = towards * _total_force(terms, p, memory, limit, 0.0, side, push, position, effort_now) / p[INERTIA]
            if back * towards >= 0 or (inward > 0 and abs(back) < 0.25 * step * inward):
                back, resting, stays = 0.0, towards, 0.0  # it would return within half a step
            if stays > 1e-9:
                waits, leaves, back, resting = now + stays, back, 0.0, towards
            v = y[1]
            y = (limit, back, y[2], y[3])
            if side != 0:
                at = limit + 0.5 * side * p[SLACK_WIDTH]
                w1, side = part_at_limit(side, towards, v, back, p[SHAFT_BACK])
                y = (limit, back, at, w1)
        elif found & _STOPPED:
            y = (y[0], 0.0, y[2], 0.0 if side != 0 else y[3])
    for i in range(done, n):  # endless events: at rest
        out[i] = y[0]


def _compile_sweep(stamp: int) -> Any:
    """The entry point, as a closure over the formulas' stamp, so that numba's disk cache notices changed formulas."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def sweep(
        numbers: Array, terms: Ints, which: Ints, times: Array, begins: Ints, t_in: Array, command: Array,
        effort: Array, pushes: Array, hold_difference: Array, base_motion: Array, enters: Ints, steps: Array,
        out: Array,
    ) -> None:  # pragma: no cover  # fmt: skip
        if stamp < 0:
            return
        memory, done, p = np.zeros(len(terms)), 0, np.empty(numbers.shape[1])
        for row in range(len(numbers)):
            run = which[row]
            first, last = enters[run, 0], enters[run, 1]
            own = times[begins[run] : begins[run + 1]]
            memory[:] = 0.0
            p[:] = numbers[row]
            p[BASE_MOVES] = 1.0 if base_motion.shape[1] > 0 else 0.0
            _roll(
                p,
                terms,
                memory,
                own,
                t_in[first:last],
                command[first:last],
                effort[first:last],
                pushes[first:last],
                hold_difference[:, first:last],
                base_motion[:, first:last],
                steps[run, 0],
                steps[run, 1],
                out[done : done + len(own)],
            )
            done += len(own)

    return sweep


sweep = _compile_sweep(STAMP)
"""sweep(numbers (m, k), terms (t, 5), which (m,), times, begins, t_in, command, effort, pushes, hold_difference,
base_motion, enters, steps, out): m simulations; row j is of run which[j].

Runs are concatenated: times of run r from begins[r] to begins[r + 1], inputs from enters[r, 0] to enters[r, 1],
steps[r] coarse and fine. `terms` are law, action (FORCE, DRIVE, STOP), index of its numbers, whether it has a place
near which steps are fine, and whether it depends on the gears' load. Inputs are constant from `t_in` to the next;
HOLDING times `hold_difference` (3, i) is added to the three. `base_motion` is (8, i), or (8, 0) without. `out` are the
positions of all rows at the times of their runs, concatenated. A run that diverges reads 1e6; one with endless events
stays where they begin.
"""
