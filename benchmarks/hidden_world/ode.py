"""One joint's equation of motion, solved in double precision with its events found within the step.

    inertia * q'' = gravity(q) + forces(q, q', t) - friction + external push + what the actuator's side transmits

`World` holds every number of it; a field's default does nothing. Smooth stretches go by the classical Runge-Kutta
formula of fourth order, the springs of dry friction exactly half a step before and half a step after (Strang's
splitting). Impacts, sticking, release and catch of a latch are found by bisection, and the step goes on from there.
tests/test_hidden_world.py holds it to `scipy.integrate.solve_ivp`.

Laws are this module's own: friction is Maxwell slip, four springs side by side of which each slides at its own force
(Iwan 1966; with the level of Lampaert, Al-Bender and Swevers 2003 that falls with speed), stops and the flanks of a
slack are Hunt and Crossley's (1975), power laws stand for viscous and quadratic losses.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

RIGID, GAP, ELASTIC = 0.0, 1.0, 2.0
"""How the actuator's side is joined to the part: as one body, through a slack, through a spring."""
NO_EFFORT, COMMANDED, EXTERNAL = 0, 1, 2
SHARES, REACHES = (0.4, 0.3, 0.2, 0.1), (0.4, 0.8, 1.6, 3.2)
"""Of each spring of dry friction: its part of the level, and the travel, in `travel`, at which it slides."""
_HALVINGS = 44
_MOST_EVENTS = 60  # in one step; after as many it rests (a bounce that never ends)


class World(NamedTuple):
    """Every number of a joint; SI, with N*m and rad for a hinge, N and m for a slider."""

    inertia: float = 1.0
    gravity_cosine: float = 0.0
    gravity_sine: float = 0.0
    gravity_constant: float = 0.0
    lower: float = -1e9
    upper: float = 1e9
    restitution: float = 0.0  # of a rigid stop
    stop_stiffness: float = 0.0  # above 0 the stops are Hunt and Crossley's: stiffness * depth^1.5 * (1 + loss * rate)
    stop_loss: float = 0.0
    viscous: float = 0.0  # viscous * |v|^power
    viscous_power: float = 1.0
    known_viscous: float = 0.0  # known_viscous * v: what the asset says of itself
    pulsing: float = 0.0  # the viscous loss goes up and down in time by this part
    pulsing_rate: float = 0.0  # Hz
    drag: float = 0.0
    drag_power: float = 2.0
    dry: float = 0.0  # set-valued Coulomb friction, sticking without creep
    friction: float = 0.0  # level of Maxwell slip in fast motion
    friction_rise: float = 0.0
    friction_speed: float = 1.0
    friction_power: float = 1.0  # exponent of Stribeck's curve
    friction_load: float = 0.0  # level per bearing force
    friction_way: float = 0.0  # + this part one way, - the other
    warm_up: float = 0.0  # level grows by this part when cold
    warm_seconds: float = 1.0
    travel: float = 1.0  # over which friction builds up
    mass: float = 0.0  # for the bearing force
    arm: float = 0.0
    load_axial: float = 0.0
    spring: float = 0.0
    spring_rest: float = 0.0
    hardening: float = 0.0  # per distance squared
    detent: float = 0.0
    detent_centre: float = 0.0
    detent_width: float = 1.0
    latch: float = 0.0
    latch_position: float = 0.0
    latch_travel: float = 1.0
    latch_capture: float = 0.5
    cogging: float = 0.0
    cogging_count: float = 0.0
    cogging_phase: float = 0.0
    cable: float = 0.0  # a bundle that stiffens: cable * sinh(3 (q - rest) / reach)
    cable_rest: float = 0.0
    cable_reach: float = 1.0
    stiffness: float = 0.0  # of the position law
    damping: float = 0.0
    gain: float = 1.0
    compression: float = 0.0  # part of the force that is missing at `force_full`
    force_full: float = 1.0
    delay: float = 0.0
    lag: float = 0.0
    link: float = RIGID
    link_width: float = 0.0
    link_inertia: float = 1.0
    link_stiffness: float = 0.0
    link_damping: float = 0.0


class Drive(NamedTuple):
    """What acts on a run from outside: series (k,) that hold each value until the next time."""

    times: NDArray[np.float64]
    command: NDArray[np.float64]
    has_command: bool
    effort: NDArray[np.float64]
    effort_kind: int


@njit(inline="always")
def _level(p, q, v, clock):
    """Friction force of steady sliding at speed v."""
    load = 0.0
    if p.friction_load > 0.0:
        load = p.load_axial
        if p.arm > 0.0:
            c, s = np.cos(q), np.sin(q)
            pull = (p.gravity_cosine * s - p.gravity_sine * c) / p.arm
            push = p.gravity_cosine * c + p.gravity_sine * s
            along = pull + p.mass * p.arm * v * v
            across = p.mass * p.arm * push / p.inertia - push / p.arm
            load = np.sqrt(along * along + across * across + p.load_axial * p.load_axial)
    level = p.friction + p.friction_load * load
    if p.friction_rise > 0.0:
        level += p.friction_rise * np.exp(-((abs(v) / p.friction_speed) ** p.friction_power))
    way = 1.0 + p.friction_way * np.sign(v)
    return level * way * (1.0 + p.warm_up * np.exp(-clock / p.warm_seconds))


@njit(inline="always")
def _stiffness(p):
    """Level at rest over the travel in which it builds up."""
    return (p.friction + p.friction_rise + p.friction_load * p.mass * 9.81) / p.travel


@njit(inline="always")
def _springs(k, level, s0):
    """Stiffness of the k-th spring of dry friction, and the stretch at which it slides."""
    stiffness = s0 * SHARES[k] / REACHES[k]
    return stiffness, SHARES[k] * level / stiffness


@njit(inline="always")
def _held(p, z, v, level):
    """Dry friction of the springs stretched by z; those that do not slide damp, as half of critical."""
    s0, force, holding = _stiffness(p), 0.0, 0.0
    for k in range(4):
        stiffness, most = _springs(k, level, s0)
        force += stiffness * min(max(z[k], -most), most)
        if z[k] * np.sign(v) < 0.98 * most:
            holding += stiffness
    return force + np.sqrt(holding * p.inertia) * v


@njit(inline="always")
def _bound(k, z, level, s0):
    """The k-th spring at z, or as far as it goes before it slides."""
    most = _springs(k, level, s0)[1]
    return min(max(z, -most), most)


@njit(inline="always")
def _contact(depth, rate, stiffness, loss):
    """Hunt and Crossley: force of a flank pressed in by `depth`; it never pulls."""
    if depth <= 0.0:
        return 0.0
    return stiffness * depth * np.sqrt(depth) * max(0.0, 1.0 + loss * rate)


@njit(inline="always")
def _asked(p, x, w, command, has_command, effort):
    """The actuator's force where its encoder is at x with speed w."""
    force = effort
    if has_command:
        force += p.stiffness * (command - x) - p.damping * w
    force *= p.gain
    return force * (1.0 - p.compression * min(abs(force) / p.force_full, 1.0))


@njit(inline="always")
def _forces(p, q, v, z, x, w, t, clock, caught, command, has_command, effort, push):
    """Force on the part, dry friction left out, and acceleration of the drive side."""
    force = p.gravity_cosine * np.cos(q) + p.gravity_sine * np.sin(q) + p.gravity_constant + push
    force -= p.known_viscous * v
    if p.viscous > 0.0:
        pulse = 1.0 + p.pulsing * np.sin(2.0 * np.pi * p.pulsing_rate * (clock + t))
        force -= p.viscous * pulse * np.sign(v) * abs(v) ** p.viscous_power
    if p.drag > 0.0:
        force -= p.drag * np.sign(v) * abs(v) ** p.drag_power
    if p.friction + p.friction_rise + p.friction_load > 0.0:
        force -= _held(p, z, v, _level(p, q, v, clock + t))
    if p.spring > 0.0:
        away = q - p.spring_rest
        force -= p.spring * away * (1.0 + p.hardening * away * away)
    if p.detent != 0.0:
        r = (q - p.detent_centre) / (p.detent_width * np.sqrt(5.0))
        if abs(r) < 1.0:  # the slope of (1 - r^2)^3, largest at r = 1 / sqrt 5
            force -= p.detent * r * (1.0 - r * r) ** 2 * 25.0 * np.sqrt(5.0) / 16.0
    if caught:
        force -= p.latch * np.sin(0.5 * np.pi * (q - p.latch_position) / p.latch_travel)
    if p.cogging > 0.0:
        force += p.cogging * np.sin(p.cogging_count * q + p.cogging_phase)
    if p.cable > 0.0:
        force -= p.cable * np.sinh(3.0 * (q - p.cable_rest) / p.cable_reach)
    if p.stop_stiffness > 0.0:
        force += _contact(p.lower - q, -v, p.stop_stiffness, p.stop_loss)
        force -= _contact(q - p.upper, v, p.stop_stiffness, p.stop_loss)
    if p.link == RIGID:
        return force + _asked(p, q, v, command, has_command, effort), 0.0
    if p.link == GAP:
        ahead = _contact(x - q - 0.5 * p.link_width, w - v, p.link_stiffness, p.link_damping)
        behind = _contact(q - x - 0.5 * p.link_width, v - w, p.link_stiffness, p.link_damping)
        between = ahead - behind
    else:
        between = p.link_stiffness * (x - q) + p.link_damping * (w - v)
    return force + between, (_asked(p, x, w, command, has_command, effort) - between) / p.link_inertia


@njit(inline="always")
def _stretched(p, q, v, z, clock, h):
    """The springs of dry friction after h at constant speed."""
    if p.friction + p.friction_rise + p.friction_load == 0.0:
        return z
    level, s0, d = _level(p, q, v, clock), _stiffness(p), v * h
    first, second = _bound(0, z[0] + d, level, s0), _bound(1, z[1] + d, level, s0)
    return first, second, _bound(2, z[2] + d, level, s0), _bound(3, z[3] + d, level, s0)


@njit
def _step(p, y, t, h, clock, locked, way, caught, u, lagged, has_command, effort, push):
    """State (q, v, z, x, w) after h; the command relaxes from `lagged` to u; a locked part stays where it is."""
    q, v, z, x, w = y
    if locked:
        v = 0.0
    else:
        z = _stretched(p, q, v, z, clock + t, 0.5 * h)
    ka = kv = kw = kx = 0.0
    sq = sv = sx = sw = 0.0
    for stage in range(4):
        c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        command = u if p.lag <= 0.0 else u + (lagged - u) * np.exp(-c * h / p.lag)
        qs, vs, xs, ws = q + c * h * kv, v + c * h * ka, x + c * h * kx, w + c * h * kw
        force, kw = _forces(p, qs, vs, z, xs, ws, t + c * h, clock, caught, command, has_command, effort, push)
        ka = 0.0 if locked else (force - way * p.dry) / p.inertia
        kv, kx = (0.0 if locked else vs), ws
        weight = (1.0 if c in (0.0, 1.0) else 2.0) / 6.0
        sq, sv, sx, sw = sq + weight * kv, sv + weight * ka, sx + weight * kx, sw + weight * kw
    q, v, x, w = q + h * sq, v + h * sv, x + h * sx, w + h * sw
    if not locked:
        z = _stretched(p, q, v, z, clock + t + h, 0.5 * h)
    if p.link == RIGID:
        x, w = q, v
    return q, v, z, x, w


@njit(inline="always")
def _happened(p, code, q, v, way, caught):
    """Whether an event lies behind: 0 lower stop, 1 upper stop, 2 speed zero, 3 latch opens, 4 latch catches."""
    if code == 0:
        return p.stop_stiffness <= 0.0 and q < p.lower
    if code == 1:
        return p.stop_stiffness <= 0.0 and q > p.upper
    if code == 2:
        return p.dry > 0.0 and way * v < 0.0
    away = abs(q - p.latch_position)
    if code == 3:
        return caught and away > p.latch_travel
    return p.latch > 0.0 and (not caught) and away < p.latch_capture * p.latch_travel


@njit(cache=True)
def _run(p, q0, v0, breaks, is_sample, times, commands, has_command, efforts, kind, clock, longest, n):
    out = np.empty((n, 2))
    y = (q0, v0, (0.0, 0.0, 0.0, 0.0), q0, v0)
    caught = p.latch > 0.0 and abs(q0 - p.latch_position) <= p.latch_capture * p.latch_travel
    way = np.sign(v0)
    side = 0  # the stop that it rests at
    stuck = p.dry > 0.0 and v0 == 0.0
    lagged = commands[0]
    k = 0
    if is_sample[0]:
        out[k, 0], out[k, 1] = y[0], y[1]
        k += 1
    for b in range(len(breaks) - 1):
        t, end = breaks[b], breaks[b + 1]
        middle = 0.5 * (t + end)
        now = min(max(np.searchsorted(times, middle, side="right") - 1, 0), len(times) - 1)
        then = min(max(np.searchsorted(times, middle - p.delay, side="right") - 1, 0), len(times) - 1)
        u = commands[then]
        effort = efforts[then] if kind == COMMANDED else 0.0
        push = efforts[now] if kind == EXTERNAL else 0.0
        fine = longest
        if p.stop_stiffness > 0.0:  # fast only where it is pressed in
            reach = 3.0 * abs(y[1]) * (end - t) + 1e-3 * (p.upper - p.lower)
            pace = abs(y[1]) / (p.upper - p.lower)
            if (y[0] - p.lower < reach or p.upper - y[0] < reach) and pace > 1e-4:
                fine = min(longest, 0.04 * longest * min(max(pace**-0.2, 1.0), 6.0))  # an impact lasts v^-1/5
        steps = max(1, int(np.ceil((end - t) / fine)))
        h = (end - t) / steps
        for _ in range(steps):
            left, count = h, 0
            while left > 0.0:
                command = u if p.lag <= 0.0 else lagged
                free, _aw = _forces(
                    p, y[0], y[1], y[2], y[3], y[4], t, clock, caught, command, has_command, effort, push
                )
                if side != 0 and free * side < -p.dry:
                    side = 0
                    way = np.sign(free)
                if stuck and side == 0 and abs(free) > p.dry:
                    stuck = False
                    way = np.sign(free)
                locked = side != 0 or stuck
                new = _step(p, y, t, left, clock, locked, way, caught, u, lagged, has_command, effort, push)
                first, took = -1, left
                if not locked:
                    for code in range(5):
                        if _happened(p, code, new[0], new[1], way, caught):
                            low, high = 0.0, took
                            for _h in range(_HALVINGS):
                                mid = 0.5 * (low + high)
                                at = _step(
                                    p, y, t, mid, clock, locked, way, caught, u, lagged, has_command, effort, push
                                )
                                if _happened(p, code, at[0], at[1], way, caught):
                                    high = mid
                                else:
                                    low = mid
                            if first < 0 or high < took:
                                first, took = code, high
                if first >= 0:
                    new = _step(p, y, t, took, clock, locked, way, caught, u, lagged, has_command, effort, push)
                q, v, z, x, w = new
                if first == 0 or first == 1:
                    limit, towards = (p.lower, -1) if first == 0 else (p.upper, 1)
                    v = -p.restitution * v
                    if abs(v) < 1e-7 or count > _MOST_EVENTS or v * towards > 0.0:
                        v, side = 0.0, towards
                    q = limit
                    way = np.sign(v)
                    if p.link == RIGID:
                        x, w = q, v
                elif first == 2:
                    v = 0.0
                    stuck = True
                    w = 0.0 if p.link == RIGID else w
                elif first == 3:
                    caught = False
                elif first == 4:
                    caught = True
                if p.lag > 0.0:
                    lagged = u + (lagged - u) * np.exp(-took / p.lag)
                y = (q, v, z, x, w)
                t += took
                left -= took
                count += 1
                if first < 0 or count > _MOST_EVENTS + 5:
                    left = 0.0
        if is_sample[b + 1]:
            out[k, 0], out[k, 1] = y[0], y[1]
            k += 1
    return out


def longest_step(world: World) -> float:
    """Seconds of a step that resolves the fastest thing in this world."""
    most = 2e-4 if world.friction + world.friction_rise + world.friction_load > 0 else 5e-4
    if world.link == RIGID:
        return most
    servo = max(np.sqrt(world.stiffness / world.link_inertia), world.damping / world.link_inertia)
    if world.link == GAP:
        return float(min(1e-4, 0.3 / max(servo, 1e-9)))
    light = world.inertia * world.link_inertia / (world.inertia + world.link_inertia)
    shaft = max(np.sqrt(world.link_stiffness / light), world.link_damping / light)
    return float(min(most, 0.1 / max(servo, shaft, 1e-9)))


def simulate(
    world: World, q0: float, v0: float, times: NDArray[np.float64], drive: Drive, clock: float = 0.0, step: float = 0.0
) -> NDArray[np.float64]:
    """(n, 2) position and velocity of the part at `times` (n,), rising, the first of which is the start.

    Args:
        world: the joint.
        q0: start position; the actuator's side stands in the middle of its slack.
        v0: start velocity.
        times: seconds.
        drive: what acts from outside; its times are on the same clock as `times`.
        clock: seconds since the session began at time 0 of this run: what is warm by then.
        step: longest step, s; 0 for one that fits the world.
    """
    breaks, sample = _breaks(times.tobytes(), drive.times.tobytes(), world.delay)
    found = _run(
        world, float(q0), float(v0), breaks, sample, drive.times, drive.command, drive.has_command, drive.effort,
        drive.effort_kind, float(clock), step or longest_step(world), len(times),
    )  # fmt: skip
    return np.asarray(found)


@lru_cache(64)
def _breaks(asked: bytes, driven: bytes, delay: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Times, s, at which something changes or is asked for, and which of them are asked for; of the same runs again and
    again."""
    times, changes = np.frombuffer(asked), np.frombuffer(driven)
    changes = np.concatenate([changes, changes + delay]) if delay else changes
    inside = changes[(changes > times[0]) & (changes < times[-1])]
    breaks = np.unique(np.concatenate([times, inside]))
    keep = np.concatenate([[True], np.diff(breaks) > 1e-12])
    sample = np.isin(breaks, times)
    return breaks[keep | sample], sample[keep | sample]


def nothing(times: NDArray[np.float64]) -> Drive:
    """No command and no push."""
    still = np.zeros(len(times))
    return Drive(times, still, False, still, NO_EFFORT)
