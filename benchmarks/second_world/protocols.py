"""What an experimenter does with a machine: 6 to 10 runs of 3 to 15 s, let go from several amplitudes, pushed, driven.

A protocol is drawn by name alone and never sees the effect, so nulls are measured as everything else is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.second_world import laws as w
from benchmarks.second_world.machines import Machine, Nuisance, truth

LEAD = 0.15  # s that a run goes on before its log begins; more than any lateness drawn
GRID = 0.002  # s between the corners of a smooth command: 1/20 of the shortest bump
FAR = 2.5  # rad that a pendulum may not pass, so that none goes over the top


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


def inputs(run: Run, late: np.ndarray | float = 0.0, lag: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Knots (k,) and what is commanded between them (k - 1, 2), corners `late` by their own delays and readings older
    by `lag`."""
    times = np.maximum.accumulate(run.times + late)
    knots = np.unique(np.concatenate([[0.0], times[times > 0], run.stamps - lag]))
    moved = replace(run, times=times)
    if run.held:
        value = moved.at(knots[:-1])
        return knots, np.stack([value, value], 1)
    value = moved.at(knots)
    return knots, np.stack([value[:-1], value[1:]], 1)


def simulate(
    p: np.ndarray,
    run: Run,
    late: np.ndarray | float = 0.0,
    lag: float = 0.0,
    longest: float = 1e-4,
    asked: bool = False,
) -> np.ndarray:
    """(n, 5) states of the real machine at the run's rows. Efforts that are `asked` of an actuator pass through its
    gain, and are late; those from outside do neither."""
    knots, drive = inputs(run, late if asked or run.role == "q_command" else 0.0, lag)
    p = p.copy()
    p[w.CLOCK] = run.session
    q, v = run.start
    start = np.array([q, v, 0.0, q, v])
    still = np.zeros_like(drive)
    if run.role == "q_command":
        states = w.integrate(p, knots, drive, still, start, longest)
    else:
        p[w.KP] = p[w.KD] = 0.0  # the drive is off
        states = w.integrate(p, knots, still, drive * (p[w.GAIN] if asked else 1.0), start, longest)
    return states[np.searchsorted(knots, run.stamps - lag)]


def _rows(rate: float, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Stamps whose steps vary as those of a real servo's log do: 3.5 to 6 ms about 4.5 (facts, section 6)."""
    steps = rng.uniform(0.78, 1.33, int(seconds * rate)) / rate
    return LEAD + np.cumsum(steps / steps.mean()) / rate - steps[0]


def _bumps(seconds: float, width: float, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Pushes to and fro, each a bump or a square of `width` s, between -1 and 1."""
    out, at, sign = np.zeros_like(t), LEAD + rng.uniform(0.1, 0.4), 1.0
    while at < seconds * 0.75:
        x = (t - at) / width
        out += sign * rng.uniform(0.6, 1.0) * np.where((x > 0) & (x < 1), np.sin(math.pi * np.clip(x, 0, 1)) ** 2, 0.0)
        sign, at = -sign, at + width * rng.uniform(1.3, 3.5)
    return out


def _sway(omega: float, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A push to and fro from rest without a mean speed, off resonance."""
    a, b = omega * rng.uniform(0.35, 0.6), omega * rng.uniform(1.6, 2.4)
    return 0.6 * np.cos(a * (t - LEAD)) + 0.4 * np.cos(b * (t - LEAD))


def _targets(omega: float, seconds: float, rng: np.random.Generator, t: np.ndarray, kind: int) -> np.ndarray:
    """What a servo is told, between -1 and 1: steps, a slow ramp to and fro, a sweep, a sum of sines."""
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


def _rounded(values: np.ndarray, seconds: float) -> np.ndarray:
    """Corners of a smooth command rounded off over `seconds` (straight lines between rows follow it then)."""
    bell = np.hanning(2 * max(2, round(seconds / GRID / 2)) + 1)[1:-1]
    wide = np.pad(values, len(bell) // 2, mode="edge")
    return np.convolve(wide, bell / bell.sum(), mode="valid")


@dataclass(frozen=True)
class _Sketch:
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
            out[-3:] = [
                _Sketch((s * rng.uniform(0, 0.5), 0.0), "effort", unit * rng.uniform(0.2, 0.4), 4) for s in sign[-3:]
            ]
        return out
    if kind == "pendulum":
        free = n if name == "free" else n - int(rng.integers(2, 4))
        wide = np.geomspace(rng.uniform(0.12, 0.25), rng.uniform(1.2, 2.2), free) * sign[:free]
        out = [_Sketch((float(a), 0.0)) for a in rng.permutation(wide)]
        out += [
            _Sketch((s * rng.uniform(0, 0.3), 0.0), "effort", unit * rng.uniform(0.2, 0.45), 4 + i % 2)
            for i, s in enumerate(sign[free:])
        ]
        return out
    if kind == "lid":
        drops = n - 1
        out = [_Sketch((float(a), 0.0)) for a in rng.permutation(np.linspace(0.25, rng.uniform(1.0, 1.4), drops))]
        return [*out, _Sketch((0.3, 0.0), "effort", machine.weight * rng.uniform(1.0, 1.5), 6)]
    reach = 0.45 if machine.slides else 1.2
    swing = reach * machine.omega**2 * (1.0 if machine.slides else 0.25) * machine.inertia
    out = []
    for i, s in enumerate(sign):
        if name == "caught":
            out.append(
                _Sketch((0.0, 0.0), "effort", swing * rng.uniform(0.6, 1.2), 6)
                if i % 2
                else _Sketch((0.6 * reach, -rng.uniform(0.3, 0.9)), "free")
            )
        elif i % 2 and not machine.slope:
            out.append(_Sketch((-s * 0.5 * reach, s * rng.uniform(0.15, 0.7) * reach), "free"))
        else:
            out.append(
                _Sketch(
                    (float(rng.uniform(-0.2, 0.2)) * reach, 0.0),
                    "effort",
                    swing * rng.uniform(0.3, 0.8),
                    5 + int(rng.integers(2)),
                )
            )
    return out


def _command(sketch: _Sketch, machine: Machine, seconds: float, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    if sketch.role == "free":
        return np.zeros_like(t)
    if sketch.role == "q_command":
        return sketch.size * _targets(machine.omega, seconds, rng, t, sketch.shape)
    if sketch.shape == 5:
        value = sketch.size * _sway(machine.omega, rng, t)
    else:
        value = sketch.size * _bumps(seconds, max(0.12, 2.0 / machine.omega), rng, t)
    return value - (
        machine.mass * 9.81 * math.sin(machine.slope) if machine.slides else 0.0
    )  # what holds a slide on its slope


def draw_plan(name: str, machine: Machine, rng: np.random.Generator) -> Plan:
    """A session by protocol `name`: `usual`, `free` (nothing pushes), `and pushed` (an arm, its drive off), `caught` (a
    door at its catch), `asked` (efforts are an actuator's, not a hand's) or `still`."""
    n = int(rng.integers(6, 11))
    rate = float(rng.uniform(50, 250))
    held = bool(rng.random() < 0.5)
    brief = {"lid": (3.0, 4.0), "door": (3.0, 6.0), "drawer": (3.0, 4.5)}.get(machine.kind, (5.0, 15.0))
    empty = bool(held or rng.random() < 0.5)  # lost readings are empty cells, or rows that are not there
    sure = rng.random() < 0.5
    told = ("held" if sure else "unknown") if held else ("linear" if sure and rate > 100 else "unknown")
    runs: list[Run] = []
    session = 0.0
    for i, sketch in enumerate(_sketches(name, machine, n, rng)):
        seconds = float(rng.uniform(*brief))
        stamps = _rows(rate, seconds, rng)
        lost = rng.random(len(stamps)) < rng.uniform(0.005, 0.03)
        lost[:2] = lost[-2:] = False
        if held:
            times = np.concatenate([[0.0], stamps[:: int(rng.integers(1, 3))]])
        else:
            times = np.arange(0.0, stamps[-1] + 2 * GRID, GRID)
        values = _command(sketch, machine, seconds, rng, times)
        values = np.round(values if held else _rounded(values, 6 / rate), 6)
        if held:
            values[0] = values[1]
        run = Run(stamps, sketch.start, sketch.role, times, values, held, lost, session, held_out=i % 4 == 2)
        run = _tamed(run, machine)
        if not empty:
            kept = ~run.lost
            run = replace(run, stamps=run.stamps[kept], lost=run.lost[kept])
        runs.append(run)
        session += seconds + float(rng.uniform(5, 20))
    roles = {run.role for run in runs}
    return Plan(
        tuple(runs), rate, "effort" in roles, "q_command" in roles, "commanded" if name == "asked" else "external", told
    )


def _tamed(run: Run, machine: Machine) -> Run:
    """The push made gentler until the machine as told stays off its stops and off the top; a lid may fall on its
    stop."""
    if run.role != "effort":
        return run
    p = truth(machine, Nuisance())
    p[w.LOW], p[w.HIGH] = (-1e9 if machine.kind != "lid" else machine.low), 1e9
    rest = -machine.mass * 9.81 * math.sin(machine.slope) if machine.slides else 0.0
    far = {"pendulum": FAR, "arm": FAR, "lid": 1.8}.get(machine.kind, 0.8 * machine.high)
    for _ in range(20):
        if np.abs(simulate(p, run, longest=5e-4)[:, 0]).max() < far:
            break
        run = replace(run, values=np.round(rest + 0.75 * (run.values - rest), 6))
    return run
