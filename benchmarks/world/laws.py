"""The physics of one joint with whatever acts on it, and an integrator that finds its events.

State: q, v (rad or m, and per second), z (bristle deflection of LuGre, rad or m), qm, vm (a rotor behind a belt or
behind play). All numbers are SI and float64. Formulas differ on purpose from plain textbook terms: dry friction is
LuGre (Canudas de Wit et al. 1995), oil is a power |v|^p, a stop gives way as Hunt and Crossley's (1975), springs
harden.

Runge-Kutta of order 4 at a fixed small step; steps end at every change of a command, and where the joint meets a stop
or a catch, at the instant found by bisection. `tests/test_world.py` holds it to scipy's solve_ivp.
"""

from __future__ import annotations

import math

import numba
import numpy as np

# Places in the vector of parameters. What is 0 does not act, unless stated otherwise.
M, GA, GB, GC = range(4)  # moving inertia, kg m^2 or kg, armature included; torque GA cos q + GB sin q + GC, N m or N
OIL, OIL_P, AIR, AIR_P = range(4, 8)  # OIL |v|^OIL_P + AIR |v|^AIR_P
TRAVEL, BRISTLE_D = 8, 9  # LuGre's pre-sliding travel, rad: bristles are DRY / TRAVEL stiff; their damping at rest
DRY, STICK, STICK_V = range(10, 13)  # sliding friction, N m; breakaway over sliding, >= 1; Stribeck velocity, rad/s
LEAN = 13  # dry friction is (1 + LEAN) forwards and (1 - LEAN) backwards
LOAD, MASS, LEVER, AXIAL = range(14, 18)  # 1: DRY is a share of the bearing's load, m; kg; m to the mass; N along axis
SPRING, SPRING_Q, HARDEN = range(18, 21)  # N m/rad; rad; share of stiffness a unit of squared deflection adds
NOTCH, NOTCH_Q, NOTCH_W = range(21, 24)  # largest force of a notch, N m; its place and width
COG, COG_N, COG_PHASE = range(24, 27)  # cogging: amplitude, periods a turn, phase
CABLE, CABLE_Q = 27, 28  # CABLE (q - CABLE_Q)^1.7 beyond CABLE_Q
MAGNET, MAGNET_Q, MAGNET_W = range(29, 32)  # depth of a magnet's well, J; its place and width
KP, KD, GAIN = range(32, 35)  # the position drive; gain of it and of commanded efforts, 1 is a true one
ROTOR, BELT, BELT_D = range(35, 38)  # inertia of a rotor off the joint (0: it sits on it); stiffness, damping between
PLAY = 38  # free travel between rotor and joint, from end to end; below 0 none, the belt holds both ways
LOW, HIGH, STOP_K, STOP_C = range(39, 43)  # stops; Hunt-Crossley N m/rad^1.5 (0: a dead stop) and loss, s/rad
CATCH, CATCH_IN, CATCH_OUT = range(43, 46)  # force of a catch at LOW; it snaps nearer than IN, lets go beyond OUT
CLOCK, WARM, WARM_S = range(46, 49)  # session time at the run's start, s; dry friction x 1 + WARM exp(-time / WARM_S)
SWAY, SWAY_S = 49, 50  # oil x 1 + SWAY sin(2 pi time / SWAY_S)
STRETCH, ZERO, LATE, DELAY = range(51, 55)  # reading = STRETCH q + ZERO, s behind its stamp; commands arrive s late


def parameters() -> np.ndarray:
    """A vector in which nothing acts: unit inertia, no stops, a true encoder."""
    p = np.zeros(DELAY + 1)
    p[[M, OIL_P, GAIN, STICK, STICK_V, NOTCH_W, MAGNET_W, WARM_S, SWAY_S, MASS, LEVER, STRETCH]] = 1.0
    p[[AIR_P, PLAY, LOW, HIGH]] = 2.0, -1.0, -1e9, 1e9
    return p


def longest_step(p: np.ndarray) -> float:
    """s: finer where bristles, teeth or a stop are quick. Halving it moves nothing by a tenth of a quantum (tests)."""
    return 5e-5 if p[TRAVEL] > 0 or p[ROTOR] > 0 or p[STOP_K] > 0 else 1e-4


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
    return max(0.0, p[STOP_K] * depth**1.5 * (1.0 + p[STOP_C] * speed)) if depth > 0.0 else 0.0


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
def _line(a, k, r):
    """What goes straight from a[k, 0] to a[k, 1], at share r of the way."""
    return a[k, 0] + (a[k, 1] - a[k, 0]) * r


@numba.njit(cache=True)
def _step(p, knots, k, t, h, y, command, effort, caught, out):
    """One Runge-Kutta step of length h from t, which lies between knots k and k + 1."""
    r0, r1 = (t - knots[k]) / (knots[k + 1] - knots[k]), (t + h - knots[k]) / (knots[k + 1] - knots[k])
    c0, c1, e0, e1 = _line(command, k, r0), _line(command, k, r1), _line(effort, k, r0), _line(effort, k, r1)
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
    """States (n, 5) at `knots` (n,), s. From knot i to i + 1 command and effort go straight from [i, 0] to [i, 1]."""
    states, y, new = np.empty((len(knots), 5)), start.copy(), np.empty(5)
    caught = p[CATCH] > 0.0 and y[0] - p[LOW] < p[CATCH_IN]
    resting = 0  # 1 at LOW, 2 at HIGH: a dead stop carries it
    states[0] = y
    for k in range(len(knots) - 1):
        t, span = knots[k], knots[k + 1] - knots[k]
        steps = math.ceil(span / longest) if span > 0.0 else 0
        for s in range(steps):
            left = t + span * (s + 1) / steps - (t + span * s / steps)
            now = t + span * s / steps
            events = 0
            while left > 0.0:
                if resting != 0:
                    r = (now - t) / span
                    push = _rates(p, now, y, _line(command, k, r), _line(effort, k, r), caught)[1]
                    if (resting == 1 and push <= 0.0) or (resting == 2 and push >= 0.0):
                        if p[ROTOR] != 0.0:  # the rotor moves on, the joint stays for this step
                            _step(p, knots, k, now, left, y, command, effort, caught, new)
                            y[3], y[4] = new[3], new[4]
                        break
                    resting = 0
                _step(p, knots, k, now, left, y, command, effort, caught, new)
                event = _beyond(p, new, caught, resting)
                if event == 0 or events > 20:
                    y[:] = new
                    break
                low, high = 0.0, left  # the event lies between them
                for _ in range(40):
                    half = 0.5 * (low + high)
                    _step(p, knots, k, now, half, y, command, effort, caught, new)
                    if _beyond(p, new, caught, resting) == 0:
                        low = half
                    else:
                        high = half
                _step(p, knots, k, now, high, y, command, effort, caught, new)
                event = _beyond(p, new, caught, resting)
                y[:] = new
                if event == 1 or event == 2:
                    y[0], y[1], resting = p[LOW] if event == 1 else p[HIGH], 0.0, event
                elif event != 0:
                    caught = event == 3
                events += 1
                now += high
                left -= high
        states[k + 1] = y
    return states
