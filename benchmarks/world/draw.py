"""A draw: cases of every stratum, each from its own random numbers, so that any can be made again alone.

Which effects are asked for, alone and together, and on which machines, was written down before any case was asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import chain

import numpy as np

from benchmarks.world import laws as w
from benchmarks.world.effects import OUTSIDE, Effect, draw_effect, find_confounded, hide
from benchmarks.world.machines import Nuisance, draw_machine, draw_nuisance
from benchmarks.world.protocols import draw_plan
from benchmarks.world.sensor import STAMP, Rig, draw_encoder, read_exactly

CLEAR = 8.0  # floors beyond what nuisance takes up; a clear effect shows at least so much
WEAK = (1.2, 4.0)
MEMBER = 5.0  # floors that each member of a pair shows beyond the other
CONFOUNDED = 3.0  # and an effect beyond the one that does nearly the same, refitted
UNSEEN = 0.7  # floors at most of an effect that is not excited
TRIES = 40
READINGS = 250  # of a run that are looked at
ROUNDS = 6  # of Gauss and Newton; most end after 3, when one gains less than 3 %
COARSE = 4e-4  # s a step where nothing is quick
LEAN = math.radians(0.4)  # by which a base may stand off unseen; machines do by .3
SIDEWAYS = 0.05  # rad: a weight whose torque is given to 5 % may have its centre so far aside, too
# Cases at share 1, of most strata for each kind; 0 alarms of 100 nulls prove less than 3.6 %.
COUNTS = {"null": 100, "clear": 4, "weak": 2, "pair": 4, "outside": 6, "still": 20, "gauge": 6}

_HUNG, _FREE, _DOOR = ("pendulum", "usual"), ("pendulum", "free"), ("door", "usual")
_SLID, _ARM, _PUSHED, _LID = ("drawer", "usual"), ("arm", "usual"), ("arm", "and pushed"), ("lid", "usual")
# Which machines and protocols an effect is looked for on: what a sensible experimenter would do who suspects it.
WHERE: dict[str, list[tuple[str, str]]] = {
    "viscous_damping": [_HUNG, _DOOR, _SLID, _FREE], "coulomb_friction": [_HUNG, _ARM, _FREE, _SLID, _DOOR],
    "stribeck_friction": [_ARM, _HUNG], "load_friction": [_HUNG, _FREE], "quadratic_drag": [_HUNG, _FREE, _DOOR],
    "return_spring": [_DOOR, _SLID, _HUNG], "encoder_scale": [_HUNG, _FREE], "time_offset": [_HUNG],
    "actuator_delay": [_PUSHED], "actuator_gain": [_ARM, _PUSHED], "armature": [_HUNG, _PUSHED],
    "backlash": [_ARM, _PUSHED], "detent": [_HUNG, _DOOR, _SLID], "latch": [("door", "caught")],
    "end_stop_bounce": [_LID], "cogging": [_HUNG, _DOOR], "belt_elasticity": [_ARM],
    "temperature_drift": [_HUNG, _FREE, _DOOR], "cable_torque": [_HUNG, _DOOR], "magnet": [_HUNG, _DOOR],
    "asymmetric_friction": [_HUNG, _FREE, _DOOR], "time_varying_damping": [_HUNG, _FREE, _DOOR],
}  # fmt: skip
SINGLES = [name for name in WHERE if name not in OUTSIDE]
PAIRS: dict[tuple[str, str], tuple[str, str]] = {
    ("coulomb_friction", "quadratic_drag"): _FREE,  # the masking pair of facts, fact 7
    ("coulomb_friction", "viscous_damping"): _FREE,
    ("coulomb_friction", "return_spring"): _HUNG,
    ("viscous_damping", "return_spring"): _DOOR,
    ("quadratic_drag", "detent"): _HUNG,
    ("coulomb_friction", "encoder_scale"): _HUNG,
    ("viscous_damping", "time_offset"): _HUNG,
    ("viscous_damping", "armature"): _HUNG,
    ("coulomb_friction", "actuator_gain"): _ARM,
    ("actuator_delay", "coulomb_friction"): _PUSHED,
    ("backlash", "actuator_gain"): _ARM,
    ("viscous_damping", "end_stop_bounce"): _LID,
}
# What no such data can tell apart (facts, section 3.1): the hidden one, machine, protocol, the set to be given.
_LEANS, _LAGS = ("gravity_offset", "encoder_offset"), ("actuator_delay", "time_offset")
GAUGES: list[tuple[str, str, str, tuple[str, ...]]] = [
    *((name, *_FREE, _LEANS) for name in _LEANS),
    *((name, *_ARM, _LAGS) for name in _LAGS),
    ("coulomb_friction", *_SLID, ("coulomb_friction", "load_friction")),
    ("actuator_gain", "drawer", "asked", ("actuator_gain", "armature")),
]
# Effects that motions of a quantum or two of the encoder do not show, and the machine.
STILL: list[tuple[str, str]] = [
    ("encoder_scale", "pendulum"), ("time_offset", "pendulum"), ("quadratic_drag", "pendulum"),
    ("quadratic_drag", "door"), ("quadratic_drag", "drawer"), ("actuator_gain", "arm"), ("actuator_delay", "arm"),
]  # fmt: skip


def strength(rig: Rig, effects: list[Effect], others: list[Effect], least: float = 0.0) -> float:
    """Root mean square over all readings, in floors, of what `effects` do beyond the best that `others` can, whatever
    their sizes, less what start states, and inertia, weight and lean within the asset's stated uncertainty, take up:
    least squares within bounds by Gauss and Newton, from the truth on. Given up below `least`."""
    machine, nuisance = rig.machine, rig.nuisance
    p = hide(machine, nuisance, effects)
    runs = []
    for run in rig.plan.runs[:: 2 if others else 1]:  # half of them is as telling
        few = np.unique(np.linspace(0, len(run.stamps) - 1, READINGS).astype(int))
        runs.append(replace(run, stamps=run.stamps[few], lost=run.lost[few]))
    still = [np.zeros(len(run.times)) for run in runs]
    exact = [read_exactly(p, r, rig.plan, z, w.longest_step(p)) for r, z in zip(runs, still, strict=True)]
    own = float(np.hypot(rig.encoder.noise, rig.encoder.quantum / np.sqrt(12)))
    sigma = [math.hypot(own, STAMP * float(np.sqrt(np.mean(v**2)))) for _, v in exact]
    steps = np.array([2e-3, 2e-3, 5e-4] + [0.02] * len(others))
    given, lean = 0.05 if machine.slides else 0.1, LEAN if machine.light else LEAN + SIDEWAYS
    room = np.array([[-given, given], [-0.05, 0.05], [-lean, lean], *([[-0.9, 4.0]] * len(others))])
    room[:2] -= np.array([[nuisance.inertia], [nuisance.weight]])

    def errors(shared: np.ndarray, starts: np.ndarray, i: int) -> np.ndarray:
        sized = [replace(o, size=o.size * (1 + x)) for o, x in zip(others, shared[3:], strict=True)]
        (a, b), lean = nuisance.tilt, shared[2]
        tilt = (a + lean, b) if machine.kind == "door" else (a, b + lean)
        p = hide(machine, Nuisance(nuisance.inertia + shared[0], nuisance.weight + shared[1], tilt), sized)
        moved = replace(runs[i], start=(float(starts[i, 0]), float(starts[i, 1])))
        # Teeth and stops need their fine step; bristles bear four of them (their rate is below 8,000 / s).
        stiff = p[w.ROTOR] > 0 or p[w.STOP_K] > 0
        longest = w.longest_step(p) if stiff else min(4 * w.longest_step(p), COARSE)
        return (exact[i][0] - read_exactly(p, moved, rig.plan, still[i], longest)[0]) / sigma[i]

    def everywhere(shared: np.ndarray, starts: np.ndarray) -> tuple[list[np.ndarray], float]:
        parts = [errors(shared, starts, i) for i in range(len(runs))]
        return parts, float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))

    shared, starts = np.zeros(len(steps)), np.array([run.start for run in runs])
    left, best = everywhere(shared, starts)
    for _ in range(ROUNDS):
        if best < least:
            return best
        step = _step(errors, shared, starts, left, steps, room, 1e-4 * machine.omega)
        for share in (1.0, 0.4, 0.1):
            now, rms = everywhere(shared + share * step[0], starts + share * step[1])
            if rms < best:
                break
        if rms > 0.97 * best:
            return min(best, rms)
        shared, starts, left, best = shared + share * step[0], starts + share * step[1], now, rms
    return best


def _step(errors: Callable, shared: np.ndarray, starts: np.ndarray, left: list, steps, room, fast: float) -> tuple:
    """One step of Gauss and Newton, by differences, of what all runs share and of their starts."""
    from scipy.optimize import lsq_linear

    n, row = len(steps), 0
    columns = np.zeros((sum(len(x) for x in left), n + 2 * len(left)))
    for i, now in enumerate(left):
        part, row = slice(row, row + len(now)), row + len(now)
        for k in range(n):
            nudged = shared + steps * (np.arange(n) == k)
            columns[part, k] = (now - errors(nudged, starts, i)) / steps[k]
        for k, nudge in enumerate((1e-4, fast)):
            moved = starts.copy()
            moved[i, k] += nudge
            columns[part, n + 2 * i + k] = (now - errors(shared, moved, i)) / nudge
    low, high = np.full(columns.shape[1], -np.inf), np.full(columns.shape[1], np.inf)
    low[:n], high[:n] = room[:, 0] - shared - 1e-9, room[:, 1] - shared + 1e-9
    found = lsq_linear(columns, np.concatenate(left), (low, high), tol=1e-8).x
    return found[:n], found[n:].reshape(-1, 2)


@dataclass(frozen=True)
class Spec:
    """What a case is to be, before anything is drawn: stratum, hidden effects by name, machine, protocol."""

    stratum: str
    names: tuple[str, ...]
    kind: str
    protocol: str
    group: tuple[str, ...] = ()  # of a gauge: what has to be given together


@dataclass(frozen=True)
class Case:
    """A case with its secret: `effects`, and `floors`, what each shows beside the others (of one, beside nothing)."""

    spec: Spec
    rig: Rig
    effects: tuple[Effect, ...] = ()
    floors: tuple[float, ...] = ()

    def with_floors(self) -> Case:
        """The case with `floors` measured."""
        every = list(self.effects)
        return replace(self, floors=tuple(strength(self.rig, every, [o for o in every if o is not e]) for e in every))

    def label(self) -> dict:
        """What is hidden, in one object."""
        spec, rig = self.spec, self.rig
        return {
            **{key: getattr(spec, key) for key in ("stratum", "kind", "protocol", "group")},
            "effects": [asdict(e) | {"value": e.size + (e.unit == "1")} for e in self.effects],
            "floors": self.floors,
            "inertia": 1 + rig.nuisance.inertia,
            "known_force": rig.plan.has_effort or rig.plan.has_command,
            "steady_load": rig.machine.light,
        }


def draw_specs(share: float, seed: int) -> list[Spec]:
    """The cases of a draw in random order; of each stratum its count times `share`, at least one, those of a kind
    taking turns."""
    rng = np.random.default_rng([seed, 0])
    kinds_of = {"pair": list(PAIRS), "gauge": GAUGES, "still": STILL, "outside": OUTSIDE}
    out: list[Spec] = []
    for stratum, many in COUNTS.items():
        kinds: list = kinds_of.get(stratum, SINGLES)
        wanted = max(1, round(share * many * (1 if stratum in ("null", "still") else len(kinds))))
        turns = [rng.permutation(len(kinds)) for _ in range(math.ceil(wanted / len(kinds)))]
        out += [_spec(stratum, kinds[int(k)], rng) for k in list(chain(*turns))[:wanted]]
    return [out[k] for k in rng.permutation(len(out))]


def _draw_place(name: str, rng: np.random.Generator) -> tuple[str, str]:
    return WHERE[name][int(rng.integers(len(WHERE[name])))]


def _spec(stratum: str, what, rng: np.random.Generator) -> Spec:
    if stratum == "pair":
        return Spec(stratum, what, *PAIRS[what])
    if stratum == "gauge":
        return Spec(stratum, what[:1], *what[1:])
    if stratum == "still":
        return Spec(stratum, (what[0],), what[1], "still")
    names, place = (what,), _draw_place(what, rng)
    if stratum == "null":  # measured as somebody would who looks for one of all these effects
        names, place = (), _draw_place(list(WHERE)[int(rng.integers(len(WHERE)))], rng)
    return Spec(stratum, names, *place)


class TooFaint(RuntimeError):
    """No machine of a kind shows an effect as strongly as its stratum asks: oil beside a stop that throws a lid back is
    .01 to 2 floors, and a member of a pair is 5."""


def draw_case(spec: Spec, seed: int, index: int) -> Case:
    """A case by its spec. Machines and effects are drawn anew until the effect is as strong as the stratum says."""
    rng = np.random.default_rng([seed, 1, index])
    for k in range(TRIES):
        if k % 10 == 9 and spec.stratum in ("clear", "weak", "outside"):  # some machines hardly show some effects
            kind, protocol = _draw_place(spec.names[0], rng)
            spec = replace(spec, kind=kind, protocol=protocol)
        machine = draw_machine(spec.kind, rng)
        if spec.protocol == "caught":
            machine = replace(machine, low=0.0)
        if spec.protocol == "asked":
            machine = replace(machine, slope=0.0)
        rest = draw_nuisance(machine, rng), draw_plan(spec.protocol, machine, rng), draw_encoder(machine, rng)
        case = Case(spec, Rig(machine, *rest))
        if not spec.names:
            return case
        for effect in (draw_effect(name, machine, rng) for name in spec.names):
            size = effect.size
            if spec.stratum == "gauge" and effect.name == "actuator_gain":  # below 1: a heavier rotor could be it
                size = -abs(rng.uniform(0.25, 0.5))
            if spec.stratum == "pair" and "travel" in effect.form:  # two losses together, and the machine still moves
                size = 0.5 * size
            case = replace(case, effects=(*case.effects, replace(effect, size=size)))
        fitting = _adjust(case, rng)
        if fitting is not None:
            return fitting
    raise TooFaint(f"{' and '.join(spec.names)} on a {spec.kind}: no strength that fits in {TRIES} tries")


def _adjust(case: Case, rng: np.random.Generator) -> Case | None:
    """The case with the strength its stratum asks for, or None."""
    stratum, case, effect = case.spec.stratum, case.with_floors(), case.effects[0]
    if stratum == "weak":
        goal, share, low, high = float(rng.uniform(*WEAK)), 1.0, 0.0, math.inf  # low, high: shares too small, too large
        for _ in range(10):
            floor = case.floors[0]
            if WEAK[0] <= floor <= WEAK[1]:
                return case
            low, high = (share, high) if floor < goal else (low, share)
            share *= float(np.clip(goal / max(floor, 1e-3), 0.05, 3.0))
            if not low < share < high:
                share = 0.5 * (low + min(high, 2 * low))
            case = replace(case, effects=(replace(effect, size=effect.size * share),)).with_floors()
        return None
    if stratum == "still" or min(case.floors) < (MEMBER if stratum == "pair" else CLEAR):
        return case if stratum == "still" and case.floors[0] <= UNSEEN else None
    other = find_confounded(effect, case.rig.machine) if stratum in ("clear", "outside") else None
    return None if other and strength(case.rig, [effect], [other], CONFOUNDED) < CONFOUNDED else case
