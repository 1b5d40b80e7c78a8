"""A draw: cases of every stratum, each from its own random numbers, so that any can be made again alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.second_world import hidden as h
from benchmarks.second_world import strata
from benchmarks.second_world.hidden import DRAWS, Effect
from benchmarks.second_world.machines import GRAVITY, Machine, Nuisance, draw_machine, draw_nuisance
from benchmarks.second_world.protocols import Plan, draw_plan
from benchmarks.second_world.sensor import Encoder, draw_encoder
from benchmarks.second_world.strength import strength

CLEAR = 8.0  # floors beyond what nuisance takes up; a clear effect shows at least so much
WEAK = (1.2, 4.0)
MEMBER = 5.0  # floors that each member of a pair shows beyond the other
TWIN = 3.0  # and an effect beyond its plainer likeness, refitted
UNSEEN = 0.7  # floors at most of an effect that is not excited
TRIES = 40
# Cases at share 1, of most strata for each kind. The note asks for 40 a stratum and 200 nulls; nulls are 100,
# for a null takes as long as a case: 0 alarms of 100 prove less than 3.6 %.
COUNTS = {"null": 100, "clear": 4, "weak": 2, "pair": 4, "outside": 6, "still": 20, "gauge": 6}


@dataclass(frozen=True)
class Spec:
    """What a case is to be, before anything is drawn: stratum, hidden effects by name, machine, protocol."""

    stratum: str
    names: tuple[str, ...]
    kind: str
    protocol: str
    group: tuple[str, ...] = ()  # of a gauge: what has to be told together


@dataclass(frozen=True)
class Case:
    """A case with its secret: `effects`, and `floors`, what each shows beside the others (of one, beside nothing)."""

    spec: Spec
    machine: Machine
    nuisance: Nuisance
    plan: Plan
    encoder: Encoder
    effects: tuple[Effect, ...]
    floors: tuple[float, ...]


def specs(share: float, seed: int) -> list[Spec]:
    """The cases of a draw in random order; of each stratum its count times `share`, at least one, those of a kind
    taking turns."""
    rng = np.random.default_rng([seed, 0])
    out: list[Spec] = []
    for stratum, many in COUNTS.items():
        kinds = _kinds(stratum)
        wanted = max(1, round(share * many * (1 if stratum in ("null", "still") else len(kinds))))
        order = [int(k) for _ in range(math.ceil(wanted / len(kinds))) for k in rng.permutation(len(kinds))][:wanted]
        out += [_spec(stratum, kinds[k], rng) for k in order]
    return [out[k] for k in rng.permutation(len(out))]


def _kinds(stratum: str) -> list:
    if stratum == "pair":
        return list(strata.PAIRS)
    if stratum == "gauge":
        return list(strata.GAUGES)
    if stratum == "still":
        return list(strata.STILL)
    return list(strata.OUTSIDE) if stratum == "outside" else list(strata.SINGLES)


def _where(name: str, rng: np.random.Generator) -> tuple[str, str]:
    places = strata.WHERE[name]
    return places[int(rng.integers(len(places)))]


def _spec(stratum: str, what, rng: np.random.Generator) -> Spec:
    if stratum == "pair":
        return Spec(stratum, what, *strata.PAIR_WHERE[what])
    if stratum == "gauge":
        name, kind, protocol, group = what
        return Spec(stratum, (name,), kind, protocol, group)
    if stratum == "still":
        return Spec(stratum, (what[0],), what[1], "still")
    kind, protocol = _where(what, rng)
    if stratum == "null":  # measured as somebody would who looks for one of all these effects
        kind, protocol = _where(list(strata.WHERE)[int(rng.integers(len(strata.WHERE)))], rng)
        return Spec(stratum, (), kind, protocol)
    return Spec(stratum, (what,), kind, protocol)


class TooFaint(RuntimeError):
    """No machine of a kind shows an effect as strongly as its stratum asks: oil beside a stop that throws a lid back is
    .01 to 2 floors, and a member of a pair is 5."""


def draw_case(spec: Spec, seed: int, index: int) -> Case:
    """A case by its spec. Machines and effects are drawn anew until the effect is as strong as the stratum says."""
    rng = np.random.default_rng([seed, 1, index])
    for k in range(TRIES):
        if k % 10 == 9 and spec.stratum in ("clear", "weak", "outside"):  # some machines hardly show some effects
            kind, protocol = _where(spec.names[0], rng)
            spec = replace(spec, kind=kind, protocol=protocol)
        machine = draw_machine(spec.kind, rng)
        if spec.protocol == "caught":
            machine = replace(machine, low=0.0)
        if spec.protocol == "asked":
            machine = replace(machine, slope=0.0)
        nuisance, plan, encoder = (
            draw_nuisance(machine, rng),
            draw_plan(spec.protocol, machine, rng),
            draw_encoder(machine, rng),
        )
        effects = tuple(_drawn(name, spec, machine, rng) for name in spec.names)
        case = Case(spec, machine, nuisance, plan, encoder, effects, ())
        if not effects:
            return case
        fitted = _fitting(case, rng)
        if fitted is not None:
            return fitted
    raise TooFaint(f"{' and '.join(spec.names)} on a {spec.kind}: no strength that fits in {TRIES} tries")


def _drawn(name: str, spec: Spec, machine: Machine, rng: np.random.Generator) -> Effect:
    effect = DRAWS[name](machine, rng)
    if spec.stratum == "gauge" and name == "actuator_gain":  # below 1, or a heavier rotor could not be it
        effect = replace(effect, size=-abs(rng.uniform(0.25, 0.5)))
    if spec.stratum == "pair" and "travel" in effect.form:
        effect = replace(effect, size=0.5 * effect.size)  # two losses together, and the machine still moves
    return effect


def _floors(case: Case) -> tuple[float, ...]:
    c, all_of = case, list(case.effects)
    return tuple(
        strength(c.machine, c.nuisance, c.plan, c.encoder, all_of, [o for o in all_of if o is not e]) for e in all_of
    )


def _fitting(case: Case, rng: np.random.Generator) -> Case | None:
    """The case with the strength its stratum asks for, or None."""
    stratum, floors = case.spec.stratum, _floors(case)
    effect = case.effects[0]
    if stratum == "weak":
        goal, low, high = float(rng.uniform(*WEAK)), 0.0, math.inf  # shares of the drawn size: too little, too much
        share = 1.0
        for _ in range(10):
            if WEAK[0] <= floors[0] <= WEAK[1]:
                return replace(case, floors=floors)
            low, high = (share, high) if floors[0] < goal else (low, share)
            share *= float(np.clip(goal / max(floors[0], 1e-3), 0.05, 3.0))
            if not low < share < high:
                share = 0.5 * (low + min(high, 2 * low))
            floors = _floors(case := replace(case, effects=(replace(effect, size=effect.size * share),)))
        return None
    if stratum == "still":
        return replace(case, floors=floors) if floors[0] <= UNSEEN else None
    if min(floors) < (MEMBER if stratum == "pair" else CLEAR):
        return None
    twin = _twin(effect, case.machine) if stratum in ("clear", "outside") else None
    if twin and strength(case.machine, case.nuisance, case.plan, case.encoder, [effect], [twin], TWIN) < TWIN:
        return None
    return replace(case, floors=floors)


def _twin(effect: Effect, machine: Machine) -> Effect | None:
    if effect.name == "load_friction":  # dry friction of the size that it has at rest
        return Effect("coulomb_friction", effect.size * machine.mass * GRAVITY, {"travel": effect.form["travel"]})
    return h.plainer(effect)
