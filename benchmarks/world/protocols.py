"""What an experimenter does with a machine: 6 to 10 runs of 3 to 15 s, let go from several amplitudes, pushed, driven.

A protocol is drawn by name alone and never sees the effect, so nulls are measured as everything else is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from benchmarks.world import laws as w
from benchmarks.world.machines import Machine, Nuisance, truth

LEAD = 0.15  # s that a run goes on before its log begins; more than any lateness drawn
GRID = 0.002  # s between the corners of a smooth command: 1/20 of the shortest bump
FAR = 2.5  # rad that a pendulum must not pass, so that none goes over the top


@dataclass(frozen=True)
class Run:
    """One run. Times are the run's own, s, the log begins at LEAD.

    `stamps` (n,) of rows; `start` (q, v); `times` (m,) and `values` (m,) are corners of what is commanded, held or
    joined by straight lines (`held`); `role` is `free`, `effort` or `q_command`; `lost` (n,) rows without a reading;
    `session` s into the session.
    """

    stamps: np.ndarray
    start: tuple[float, float]
    role: str
    times: np.ndarray
    values: np.ndarray
    held: bool
    lost: np.ndarray
    session: float
    held_out: bool

    def at(self, t: np.ndarray) -> np.ndarray:
        """(k,) what is commanded at times t."""
        if self.held:
            return self.values[np.clip(np.searchsorted(self.times, t + 1e-12) - 1, 0, None)]
        return np.interp(t, self.times, self.values)


@dataclass(frozen=True)
class Plan:
    """A session: its runs, its columns, and how well what is between two rows is known (a word of docs/formats.md)."""

    runs: tuple[Run, ...]
    rate: float
    has_effort: bool
    has_command: bool
    effort_kind: str  # external or commanded
    interpolation: str


def simulate(
    p: np.ndarray, run: Run, late: np.ndarray | float = 0.0, longest: float = 1e-4, commanded: bool = False
) -> np.ndarray:
    """(n, 5) states of the real machine at the run's rows. Corners of commands are `late` by their own delays, readings
    older by what `p` has. Efforts that are `commanded` of an actuator pass through its gain, and are late; those from
    outside do neither."""
    driven = run.role == "q_command"
    times = np.maximum.accumulate(run.times + (late if commanded or driven else 0.0))
    stamps = run.stamps - p[w.LATE]
    knots = np.unique(np.concatenate([[0.0], times[times > 0], stamps]))
    value = replace(run, times=times).at(knots)
    drive = np.stack([value[:-1], value[:-1] if run.held else value[1:]], 1)
    p, (q, v), still = p.copy(), run.start, np.zeros_like(drive)
    p[w.CLOCK] = run.session
    if not driven:  # the drive is off
        p[w.KP] = p[w.KD] = 0.0
        drive, still = still, drive * (p[w.GAIN] if commanded else 1.0)
    states = w.integrate(p, knots, drive, still, np.array([q, v, 0.0, q, v]), longest)
    return states[np.searchsorted(knots, stamps)]


def _bumps(seconds: float, width: float, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Pushes to and fro, each a bump or a square of `width` s, between -1 and 1."""
    out, at, sign = np.zeros_like(t), LEAD + rng.uniform(0.1, 0.4), 1.0
    while at < seconds * 0.75:
        x = (t - at) / width
        out += sign * rng.uniform(0.6, 1.0) * np.where((x > 0) & (x < 1), np.sin(math.pi * np.clip(x, 0, 1)) ** 2, 0.0)
        sign, at = -sign, at + width * rng.uniform(1.3, 3.5)
    return out


def _targets(omega: float, seconds: float, rng: np.random.Generator, t: np.ndarray, kind: int) -> np.ndarray:
    """What is commanded of a servo, between -1 and 1: steps, a slow ramp to and fro, a sweep, a sum of sines."""
    s = t - LEAD
    if kind == 0:
        edges = np.cumsum(rng.uniform(0.5, 1.3, 40))
        return rng.uniform(-1, 1, 41)[np.searchsorted(edges, s)]
    if kind == 1:
        return np.abs(((s / seconds * rng.uniform(1.0, 2.0) + 0.25) % 1) * 4 - 2) - 1
    if kind == 2:
        return np.sin(omega * (0.1 * s + 0.5 * 0.9 * s**2 / seconds))
    f = omega * np.array([rng.uniform(0.1, 0.2), rng.uniform(0.3, 0.6)])
    return 0.65 * np.sin(f[0] * s + rng.uniform(0, 6)) + 0.35 * np.sin(f[1] * s + rng.uniform(0, 6))


class _Sketch(NamedTuple):
    """A run before its times are drawn: start, role, size of what is commanded and its shape."""

    start: tuple[float, float]
    role: str = "free"
    size: float = 0.0
    shape: int = 0


def _sketches(name: str, machine: Machine, n: int, rng: np.random.Generator) -> list[_Sketch]:
    """The runs of a protocol. Amplitudes span 5 to 1 and more (facts, fact 9)."""
    sign = rng.choice([-1.0, 1.0], n)
    kind, unit = machine.kind, machine.inertia * machine.omega**2
    if name == "still":  # moves by a quantum or two of the encoder, where it moves at all
        if kind == "arm":
            return [_Sketch((0.0, 0.0), "q_command", 0.002, int(rng.integers(4))) for _ in range(n)]
        return [_Sketch((s * rng.uniform(0.0005, 0.002) * (0.1 if machine.slides else 1), 0.0)) for s in sign]
    if kind == "arm":
        wide = rng.uniform(0.25, 0.8, n)
        out = [_Sketch((float(rng.uniform(-0.1, 0.1)), 0.0), "q_command", a, i % 4) for i, a in enumerate(wide)]
        if name == "and pushed":  # the drive is off then, so the arm swings
            for k in (-3, -2, -1):
                out[k] = _Sketch((sign[k] * rng.uniform(0, 0.5), 0.0), "effort", unit * rng.uniform(0.2, 0.4), 4)
        return out
    if kind == "pendulum":
        free = n if name == "free" else n - int(rng.integers(2, 4))
        wide = np.geomspace(rng.uniform(0.12, 0.25), rng.uniform(1.2, 2.2), free) * sign[:free]
        out = [_Sketch((float(a), 0.0)) for a in rng.permutation(wide)]
        for i, s in enumerate(sign[free:]):
            out.append(_Sketch((s * rng.uniform(0, 0.3), 0.0), "effort", unit * rng.uniform(0.2, 0.45), 4 + i % 2))
        return out
    if kind == "lid":
        out = [_Sketch((float(a), 0.0)) for a in rng.permutation(np.linspace(0.25, rng.uniform(1.0, 1.4), n - 1))]
        return [*out, _Sketch((0.3, 0.0), "effort", machine.weight * rng.uniform(1.0, 1.5), 6)]
    reach = 0.45 if machine.slides else 1.2
    swing = reach * machine.omega**2 * (1.0 if machine.slides else 0.25) * machine.inertia
    out = []
    for i, s in enumerate(sign):
        if name == "caught" and i % 2:
            out.append(_Sketch((0.0, 0.0), "effort", swing * rng.uniform(0.6, 1.2), 6))
        elif name == "caught":
            out.append(_Sketch((0.6 * reach, -rng.uniform(0.3, 0.9))))
        elif i % 2 and not machine.slope:
            out.append(_Sketch((-s * 0.5 * reach, s * rng.uniform(0.15, 0.7) * reach)))
        else:
            start = (float(rng.uniform(-0.2, 0.2)) * reach, 0.0)
            out.append(_Sketch(start, "effort", swing * rng.uniform(0.3, 0.8), 5 + int(rng.integers(2))))
    return out


def _command(sketch: _Sketch, machine: Machine, seconds: float, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    if sketch.role == "free":
        return np.zeros_like(t)
    if sketch.role == "q_command":
        return sketch.size * _targets(machine.omega, seconds, rng, t, sketch.shape)
    if sketch.shape == 5:  # to and fro from rest without a mean speed, off resonance
        a, b = machine.omega * rng.uniform(0.35, 0.6), machine.omega * rng.uniform(1.6, 2.4)
        value = sketch.size * (0.6 * np.cos(a * (t - LEAD)) + 0.4 * np.cos(b * (t - LEAD)))
    else:
        value = sketch.size * _bumps(seconds, max(0.12, 2.0 / machine.omega), rng, t)
    return value - (machine.weight if machine.slides else 0.0)  # what holds a slide on its slope


def draw_plan(name: str, machine: Machine, rng: np.random.Generator) -> Plan:
    """A session by protocol `name`: `usual`, `free` (nothing pushes), `and pushed` (an arm, its drive off), `caught` (a
    door at its catch), `asked` (efforts are an actuator's, not a hand's) or `still`."""
    n, rate, held = int(rng.integers(6, 11)), float(rng.uniform(50, 250)), bool(rng.random() < 0.5)
    brief = {"lid": (3.0, 4.0), "door": (3.0, 6.0), "drawer": (3.0, 4.5)}.get(machine.kind, (5.0, 15.0))
    empty = bool(held or rng.random() < 0.5)  # lost readings are empty cells, or rows that are not there
    sure = rng.random() < 0.5
    between = ("held" if held else "linear") if sure and (held or rate > 100) else "unknown"
    runs: list[Run] = []
    session = 0.0
    for i, sketch in enumerate(_sketches(name, machine, n, rng)):
        seconds = float(rng.uniform(*brief))
        steps = rng.uniform(0.78, 1.33, int(seconds * rate)) / rate  # as those of a servo's log (facts, section 6)
        stamps = LEAD + np.cumsum(steps / steps.mean()) / rate - steps[0]
        lost = rng.random(len(stamps)) < rng.uniform(0.005, 0.03)
        lost[:2] = lost[-2:] = False
        smooth = np.arange(0.0, stamps[-1] + 2 * GRID, GRID)
        times = np.concatenate([[0.0], stamps[:: int(rng.integers(1, 3))]]) if held else smooth
        values = _command(sketch, machine, seconds, rng, times)
        if not held:  # corners rounded off over six rows: straight lines between rows follow it then
            bell = np.hanning(2 * max(2, round(6 / rate / GRID / 2)) + 1)[1:-1]
            values = np.convolve(np.pad(values, len(bell) // 2, mode="edge"), bell / bell.sum(), mode="valid")
        values = np.round(values, 6)
        if held:
            values[0] = values[1]
        run = _tame(Run(stamps, sketch.start, sketch.role, times, values, held, lost, session, i % 4 == 2), machine)
        if not empty:
            run = replace(run, stamps=run.stamps[~lost], lost=lost[~lost])
        runs.append(run)
        session += seconds + float(rng.uniform(5, 20))
    roles = {run.role for run in runs}
    effort_kind = "commanded" if name == "asked" else "external"
    return Plan(tuple(runs), rate, "effort" in roles, "q_command" in roles, effort_kind, between)


def _tame(run: Run, machine: Machine) -> Run:
    """The push made gentler until the machine as given stays off the top and its stops; a lid may fall on its stop."""
    if run.role != "effort":
        return run
    p = truth(machine, Nuisance())
    p[w.LOW], p[w.HIGH] = (-1e9 if machine.kind != "lid" else machine.low), 1e9
    rest = -machine.weight if machine.slides else 0.0
    far = {"pendulum": FAR, "arm": FAR, "lid": 1.8}.get(machine.kind, 0.8 * machine.high)
    for _ in range(20):
        if np.abs(simulate(p, run, longest=5e-4)[:, 0]).max() < far:
            break
        run = replace(run, values=np.round(rest + 0.75 * (run.values - rest), 6))
    return run
