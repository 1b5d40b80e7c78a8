"""The physics of one joint with whatever acts on it, and an integrator that finds its events.

State: q, v (rad or m, and per second), z (bristle deflection of LuGre, rad or m), qm, vm (a rotor behind a belt or
behind play). All numbers are SI and float64. Formulas differ on purpose from plain textbook terms: dry friction is
LuGre (Canudas de Wit et al. 1995), oil is a power |v|^p, a stop gives way as Hunt and Crossley's (1975), springs
harden.

Classical Runge-Kutta of order 4 at a fixed small step; steps end at every change of a command, and where the joint
meets a stop or a catch, at the instant found by bisection. `tests/test_second_world.py` holds it to scipy's solve_ivp
and to MuJoCo.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numba
import numpy as np


class P(IntEnum):
    """Places in the vector of parameters; what is 0 does not act, save where it is said."""

    M = 0  # inertia that moves with the joint, kg m^2 or kg, armature included
    GA = 1  # gravity's torque GA cos q + GB sin q + GC, N m or N
    GB = 2
    GC = 3
    OIL = 4  # OIL |v|^OIL_P, N m (s/rad)^p
    OIL_P = 5
    AIR = 6  # AIR |v|^AIR_P
    AIR_P = 7
    TRAVEL = 8  # LuGre's pre-sliding travel, rad: bristles are DRY / TRAVEL stiff; 0: no dry friction
    BRISTLE_D = 9  # their damping at rest, N m s/rad
    DRY = 10  # sliding friction, N m; with LOAD its share of the bearing's load, m (or 1 for a slide)
    STICK = 11  # friction that has to be broken, over sliding friction; at least 1
    STICK_V = 12  # Stribeck velocity, rad/s
    LEAN = 13  # dry friction is (1 + LEAN) forwards and (1 - LEAN) backwards
    LOAD = 14  # 1: dry friction is a share of what the bearing carries
    MASS = 15  # kg
    LEVER = 16  # distance of the centre of mass to the axis, m
    AXIAL = 17  # load along the axis (or across the slide), N
    SPRING = 18  # N m/rad
    SPRING_Q = 19
    HARDEN = 20  # share by which the spring is stiffer per unit of squared deflection
    NOTCH = 21  # largest force of a notch, N m
    NOTCH_Q = 22
    NOTCH_W = 23
    COG = 24  # amplitude of cogging
    COG_N = 25
    COG_PHASE = 26
    CABLE = 27  # CABLE (q - CABLE_Q)^1.7 beyond CABLE_Q
    CABLE_Q = 28
    MAGNET = 29  # depth of a magnet's well, J
    MAGNET_Q = 30
    MAGNET_W = 31
    KP = 32  # the position drive
    KD = 33
    GAIN = 34  # of the drive and of commanded efforts; 1 is a true one
    ROTOR = 35  # inertia of a rotor that the drive turns, when it does not sit on the joint; 0: it does
    BELT = 36  # stiffness between rotor and joint
    BELT_D = 37
    PLAY = 38  # free travel between them, from end to end; below 0 none, the belt holds both ways
    LOW = 39
    HIGH = 40
    STOP_K = 41  # Hunt-Crossley stiffness N m/rad^1.5; 0: a dead stop, as simulators have it
    STOP_C = 42  # its loss, s/rad
    CATCH = 43  # force of a catch at LOW
    CATCH_IN = 44  # it snaps nearer than this to LOW
    CATCH_OUT = 45  # and lets go further off than that
    CLOCK = 46  # session time at the run's start, s
    WARM = 47  # dry friction times 1 + WARM exp(-session time / WARM_S)
    WARM_S = 48
    SWAY = 49  # oil times 1 + SWAY sin(2 pi session time / SWAY_S)
    SWAY_S = 50


SIZE = len(P)
M, GA, GB, GC, OIL, OIL_P, AIR, AIR_P = (int(x) for x in list(P)[0:8])
TRAVEL, BRISTLE_D, DRY, STICK, STICK_V, LEAN, LOAD, MASS, LEVER, AXIAL = (int(x) for x in list(P)[8:18])
SPRING, SPRING_Q, HARDEN, NOTCH, NOTCH_Q, NOTCH_W, COG, COG_N, COG_PHASE = (int(x) for x in list(P)[18:27])
CABLE, CABLE_Q, MAGNET, MAGNET_Q, MAGNET_W, KP, KD, GAIN = (int(x) for x in list(P)[27:35])
ROTOR, BELT, BELT_D, PLAY, LOW, HIGH, STOP_K, STOP_C = (int(x) for x in list(P)[35:43])
CATCH, CATCH_IN, CATCH_OUT, CLOCK, WARM, WARM_S, SWAY, SWAY_S = (int(x) for x in list(P)[43:51])


def parameters() -> np.ndarray:
    """A vector in which nothing acts: unit inertia, no stops."""
    p = np.zeros(SIZE)
    p[[M, OIL_P, GAIN, STICK, STICK_V, NOTCH_W, MAGNET_W, WARM_S, SWAY_S, MASS, LEVER]] = 1.0
    p[AIR_P] = 2.0
    p[PLAY] = -1.0
    p[LOW], p[HIGH] = -1e9, 1e9
    return p


@numba.njit(cache=True)
def _level(p, q, v, pull):
    """Sliding friction now: a constant, or a share of what the bearing carries (radial, tangential and axial)."""
    if p[LOAD] == 0.0:
        return p[DRY]
    if p[LEVER] == 0.0:
        return p[DRY] * abs(p[AXIAL])
    radial = (p[GA] * math.sin(q) - p[GB] * math.cos(q)) / p[LEVER] + p[MASS] * p[LEVER] * v * v
    across = pull / p[LEVER] * (1.0 - p[MASS] * p[LEVER] ** 2 / p[M])
    return p[DRY] * math.sqrt(radial * radial + across * across + p[AXIAL] ** 2) + 1e-12


@numba.njit(cache=True)
def _push_of_stop(p, depth, speed):
    """Hunt-Crossley: depth into the stop and its rate; a stop never pulls."""
    if depth <= 0.0:
        return 0.0
    return max(0.0, p[STOP_K] * depth**1.5 * (1.0 + p[STOP_C] * speed))


@numba.njit(cache=True)
def _between(p, gap, rate):
    """Force on the joint of what lies between rotor and joint: a belt, or teeth that have play."""
    if p[PLAY] < 0.0:
        return p[BELT] * gap + p[BELT_D] * rate
    over = abs(gap) - 0.5 * p[PLAY]
    if over <= 0.0:
        return 0.0
    side = 1.0 if gap > 0.0 else -1.0
    return side * max(0.0, p[BELT] * over + p[BELT_D] * side * rate * min(1.0, over / (0.02 * p[PLAY] + 1e-12)))


@numba.njit(cache=True)
def _rates(p, t, y, command, effort, caught):
    """Time derivatives of the state; `effort` is what is really applied, `command` the drive's target when it reaches
    it."""
    q, v, z, qm, vm = y[0], y[1], y[2], y[3], y[4]
    pull = p[GA] * math.cos(q) + p[GB] * math.sin(q) + p[GC]
    force = pull + effort
    clock = p[CLOCK] + t
    if p[OIL] != 0.0 and v != 0.0:
        oil = p[OIL] * (1.0 + p[SWAY] * math.sin(2.0 * math.pi * clock / p[SWAY_S]))
        force -= math.copysign(oil * abs(v) ** p[OIL_P], v)
    if p[AIR] != 0.0 and v != 0.0:
        force -= math.copysign(p[AIR] * abs(v) ** p[AIR_P], v)
    if p[SPRING] != 0.0:
        d = q - p[SPRING_Q]
        force -= p[SPRING] * d * (1.0 + p[HARDEN] * d * d)
    if p[NOTCH] != 0.0:
        d = (q - p[NOTCH_Q]) / p[NOTCH_W]
        force -= p[NOTCH] * d * math.exp(0.5 * (1.0 - d * d))
    if p[COG] != 0.0:
        force -= p[COG] * math.sin(p[COG_N] * q + p[COG_PHASE])
    if p[CABLE] != 0.0 and q > p[CABLE_Q]:
        force -= p[CABLE] * (q - p[CABLE_Q]) ** 1.7
    if p[MAGNET] != 0.0:
        d = (q - p[MAGNET_Q]) / p[MAGNET_W]
        force -= 2.0 * p[MAGNET] / p[MAGNET_W] * d / (1.0 + d * d) ** 2
    if caught:
        force -= p[CATCH] * math.tanh(4.0 * (q - p[LOW]) / p[CATCH_OUT])
    if p[STOP_K] != 0.0:
        force += _push_of_stop(p, p[LOW] - q, -v) - _push_of_stop(p, q - p[HIGH], v)
    dqm, dvm = 0.0, 0.0
    if p[ROTOR] > 0.0:
        drive = p[GAIN] * (p[KP] * (command - qm) - p[KD] * vm)
        between = _between(p, qm - q, vm - v)
        force += between
        dqm, dvm = vm, (drive - between) / p[ROTOR]
    elif p[KP] != 0.0:
        force += p[GAIN] * (p[KP] * (command - q) - p[KD] * v)
    dz = 0.0
    if p[TRAVEL] > 0.0:
        level = _level(p, q, v, pull) * (1.0 + p[WARM] * math.exp(-clock / p[WARM_S]))
        top = 1.0 + (p[STICK] - 1.0) * math.exp(-((v / p[STICK_V]) ** 2))
        top *= 1.0 + p[LEAN] * (1.0 if v > 0.0 else -1.0)
        dz = v - abs(v) / (p[TRAVEL] * top) * z
        force -= level / p[TRAVEL] * z + p[BRISTLE_D] * math.exp(-((v / p[STICK_V]) ** 2)) * dz
    inertia = p[M] - p[ROTOR]
    return v, force / inertia, dz, dqm, dvm


@numba.njit(cache=True)
def _step(p, t, h, y, c0, c1, e0, e1, caught, out):
    """One Runge-Kutta step of length h; command and effort go straight from c0, e0 to c1, e1."""
    w = np.empty(5)
    a = _rates(p, t, y, c0, e0, caught)
    for i in range(5):
        w[i] = y[i] + 0.5 * h * a[i]
    b = _rates(p, t + 0.5 * h, w, 0.5 * (c0 + c1), 0.5 * (e0 + e1), caught)
    for i in range(5):
        w[i] = y[i] + 0.5 * h * b[i]
    c = _rates(p, t + 0.5 * h, w, 0.5 * (c0 + c1), 0.5 * (e0 + e1), caught)
    for i in range(5):
        w[i] = y[i] + h * c[i]
    d = _rates(p, t + h, w, c1, e1, caught)
    for i in range(5):
        out[i] = y[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i])


@numba.njit(cache=True)
def _beyond(p, y, caught, resting):
    """Which event lies behind this state: 1 below LOW, 2 above HIGH, 3 the catch snaps, 4 it lets go; 0 none."""
    if p[STOP_K] == 0.0 and resting == 0:
        if y[0] < p[LOW]:
            return 1
        if y[0] > p[HIGH]:
            return 2
    if p[CATCH] > 0.0:
        if not caught and y[0] - p[LOW] < p[CATCH_IN] and y[1] < 0.0:
            return 3
        if caught and y[0] - p[LOW] > p[CATCH_OUT]:
            return 4
    return 0


@numba.njit(cache=True)
def integrate(p, knots, command, effort, start, longest):
    """States (n, 5) at `knots` (n,), s. Between knots i and i + 1 command and effort go straight from [i, 0] to [i,
    1]."""
    n = len(knots)
    states = np.empty((n, 5))
    y = start.copy()
    new = np.empty(5)
    caught = p[CATCH] > 0.0 and y[0] - p[LOW] < p[CATCH_IN]
    resting = 0  # 1 at LOW, 2 at HIGH: a dead stop carries it
    states[0] = y
    for k in range(n - 1):
        t, end = knots[k], knots[k + 1]
        span = end - t
        if span <= 0.0:
            states[k + 1] = y
            continue
        steps = math.ceil(span / longest)
        for s in range(steps):
            left = t + span * (s + 1) / steps - (t + span * s / steps)
            now = t + span * s / steps
            events = 0
            while left > 0.0:
                r0, r1 = (now - t) / span, (now + left - t) / span
                c0 = command[k, 0] + (command[k, 1] - command[k, 0]) * r0
                c1 = command[k, 0] + (command[k, 1] - command[k, 0]) * r1
                e0 = effort[k, 0] + (effort[k, 1] - effort[k, 0]) * r0
                e1 = effort[k, 0] + (effort[k, 1] - effort[k, 0]) * r1
                if resting != 0:
                    push = _rates(p, now, y, c0, e0, caught)[1]
                    if (resting == 1 and push <= 0.0) or (resting == 2 and push >= 0.0):
                        if p[ROTOR] == 0.0:
                            break  # it stays for this step
                        _step(p, now, left, y, c0, c1, e0, e1, caught, new)
                        y[3], y[4] = new[3], new[4]
                        break
                    resting = 0
                _step(p, now, left, y, c0, c1, e0, e1, caught, new)
                event = _beyond(p, new, caught, resting)
                if event == 0 or events > 20:
                    y[:] = new
                    break
                low, high = 0.0, left  # the event lies between them
                for _ in range(40):
                    half = 0.5 * (low + high)
                    rh = (now + half - t) / span
                    ch = command[k, 0] + (command[k, 1] - command[k, 0]) * rh
                    eh = effort[k, 0] + (effort[k, 1] - effort[k, 0]) * rh
                    _step(p, now, half, y, c0, ch, e0, eh, caught, new)
                    if _beyond(p, new, caught, resting) == 0:
                        low = half
                    else:
                        high = half
                rh = (now + high - t) / span
                ch = command[k, 0] + (command[k, 1] - command[k, 0]) * rh
                eh = effort[k, 0] + (effort[k, 1] - effort[k, 0]) * rh
                _step(p, now, high, y, c0, ch, e0, eh, caught, new)
                event = _beyond(p, new, caught, resting)
                y[:] = new
                if event == 1:
                    y[0], y[1], resting = p[LOW], 0.0, 1
                elif event == 2:
                    y[0], y[1], resting = p[HIGH], 0.0, 2
                elif event == 3:
                    caught = True
                elif event == 4:
                    caught = False
                events += 1
                now += high
                left -= high
        states[k + 1] = y
    return states


def energy(p: np.ndarray, states: np.ndarray) -> np.ndarray:
    """(n,) J: kinetic, gravity's and a plain spring's; what is conserved where nothing else acts."""
    q, v = states[:, 0], states[:, 1]
    d = q - p[SPRING_Q]
    fall = -p[GA] * np.sin(q) + p[GB] * np.cos(q) - p[GC] * q
    return 0.5 * p[M] * v**2 + fall + p[SPRING] * (0.5 * d**2 + 0.25 * p[HARDEN] * d**4)
