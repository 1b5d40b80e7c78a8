"""Cases: a body, its nuisances, the runs of a rig, and what is hidden in them; drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.hidden_world import effects, poses
from benchmarks.hidden_world.body import Body, draw_body
from benchmarks.hidden_world.nuisance import (
    Nuisance,
    draw_nuisance,
    nominal_times,
    true_world,
)
from benchmarks.hidden_world.rig import RUNS, Plan, Servo, draw_plans, draw_servo
from benchmarks.hidden_world.strength import Gap, Hidden

PAIRS = (
    ("coulomb_friction", "quadratic_drag"),
    ("coulomb_friction", "viscous_damping"),
    ("return_spring", "viscous_damping"),
    ("coulomb_friction", "return_spring"),
    ("coulomb_friction", "detent"),
    ("end_stop_bounce", "viscous_damping"),
    ("actuator_delay", "coulomb_friction"),
    ("actuator_gain", "viscous_damping"),
    ("coulomb_friction", "gravity_offset"),
    ("encoder_offset", "viscous_damping"),
    ("backlash", "viscous_damping"),
    ("armature", "coulomb_friction"),
)
CONSTANT_LOAD = ("load_friction", "coulomb_friction")
"""One and the same where the bearing always carries the same: of what slides."""
GAUGES = (  # effect, rig, families, what cannot be told apart
    ("encoder_offset", "swing", ("pendulum",), ("encoder_offset", "gravity_offset")),
    ("armature", "swing", ("pendulum",), ("armature", "gravity_offset")),
    ("actuator_gain", "servo", ("drawer",), ("actuator_gain", "armature")),
    ("actuator_delay", "effort", ("pendulum", "door", "drawer"), ("actuator_delay", "time_offset")),
    ("load_friction", "full", ("drawer", "slope"), CONSTANT_LOAD),
)
CLEAR, WEAK = (6.0, 40.0), (1.3, 4.0)
"""Floors of the gap that nuisance cannot explain."""
LEAST_CLEAR = 5.0
PASSABLE = 2.5
"""Floors that must remain beyond plainer effects for a clear case."""


@dataclass(frozen=True)
class Wish:
    """What a case shall be, before it is drawn."""

    stratum: str
    """null, single, pair, strange, gauge, still, kinematic."""
    names: tuple[str, ...]
    rig: str
    family: str
    strength: str = "clear"
    sets: tuple[str, ...] = ()
    """Of a gauge: the effects of which the data cannot choose one."""


@dataclass(frozen=True)
class Case:
    """All that decides a measured set."""

    wish: Wish
    seed: int
    body: Body
    servo: Servo
    nuisance: Nuisance
    plans: list[Plan]
    hidden: tuple[Hidden, ...]
    floor: float = 0.0
    """rad or m."""
    ratio: float = 0.0
    """The gap over the floor, after the best nuisance within the asset's uncertainty."""
    distinct: float = 0.0
    """The same, after plainer effects, too; or, of a pair, the less of both without the other."""

    @property
    def strength(self) -> str:
        """clear: 5 floors or more, of which enough remain beyond plainer effects. What counts is what was reached."""
        if not self.hidden or not np.isfinite(self.ratio):
            return "clear"
        return "clear" if self.ratio >= LEAST_CLEAR and self.distinct >= PASSABLE else "weak"

    def label(self) -> dict[str, Any]:
        """What is kept under seal."""
        return {
            "stratum": self.wish.stratum, "strength": self.strength, "rig": self.wish.rig,
            "family": self.wish.family, "kind": self.body.kind, "sets": list(self.wish.sets),
            "effects": [
                {"name": h.name, "size": h.size, "parameters": _said(h, self.body)} for h in self.hidden
            ],
            "floor": self.floor, "ratio": self.ratio, "distinct": self.distinct, "seed": self.seed,
            "known_losses": self.body.damping > 0,
        }  # fmt: skip


def _said(hidden: Hidden, body: Body) -> dict[str, float]:
    return {} if hidden.name in poses.KINEMATIC else effects.parameters(hidden.name, hidden.seed, hidden.size, body)


def draw_case(wish: Wish, seed: int, search: bool = True) -> Case:
    """The case that a wish and a seed make. Sizes are searched until the gap is as strong as wished.

    Without `search` sizes are the table's own, and nobody knows how strong the gap is.
    """
    rng = np.random.default_rng([seed, 1])
    body = draw_body(rng, wish.family)
    if wish.stratum == "gauge":
        body = replace(body, damping=0.0, friction=0.0)  # a known force would set the scale
    servo = draw_servo(rng, body)
    nuisance = draw_nuisance(rng, body)
    at_rest = lying_still(body, nuisance) if wish.rig == "still" else body
    plans = draw_plans(rng, at_rest, wish.rig, servo, nominal_times())
    seeds = [int(s) for s in rng.integers(1 << 30, size=2)]
    while wish.stratum == "gauge" and wish.names == ("actuator_gain",) and effects.stronger(seeds[0]):
        seeds[0] += 1  # only a weaker drive may be a heavier one
    case = Case(wish, seed, body, servo, nuisance, plans, ())
    if not wish.names:
        return replace(case, floor=Gap(case).floor if wish.rig != "poses" and search else 0.0)
    if wish.stratum == "kinematic":
        low, high = poses.KINEMATIC[wish.names[0]]
        size = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        return replace(case, hidden=(Hidden(wish.names[0], seeds[0], size),), ratio=np.nan, distinct=np.nan)
    target = float(np.exp(rng.uniform(*np.log(WEAK if wish.strength == "weak" else CLEAR))))
    gap = Gap(case) if search else None
    table = {**effects.START, **effects.STRANGE}
    found = []
    for name, own in zip(wish.names, seeds, strict=False):
        start = float(np.exp(rng.uniform(*np.log(table[name]))))
        if gap is None or wish.stratum == "still":
            found.append(Hidden(name, own, start))
        else:
            found.append(gap.sized(name, own, start, target, wish.stratum == "gauge"))
    hidden = tuple(found)
    if gap is None:
        return replace(case, hidden=hidden, ratio=np.nan, distinct=np.nan)
    total = gap.ratio(hidden, closely=True)
    if wish.stratum == "pair":
        alone = min(total, *(gap.ratio(hidden, beside=(other,)) for other in hidden))
        for one, other in (hidden, hidden[::-1]):
            if one.name in effects.TWINS:
                alone = min(alone, gap.ratio(hidden, beside=(*any_of(effects.TWINS[one.name]), other)))
    else:
        names = effects.RIVALS_OF.get(wish.names[0], ()) if wish.stratum != "still" else ()
        rivals = tuple(rival for name in names for rival in any_of(name))
        alone = min(total, gap.ratio(hidden, beside=rivals)) if rivals else total
    return replace(case, hidden=hidden, floor=gap.floor, ratio=total, distinct=alone)


def any_of(name: str) -> tuple[Hidden, ...]:
    """Effects of this name that together make any of them, at sizes to be found."""
    return tuple(Hidden(name, seed, effects.START[name][0]) for seed in effects.DRAWS.get(name, (5,)))


def lying_still(body: Body, nuisance: Nuisance) -> Body:
    """The hinge's body as it really hangs: who wants it still does not lift it to where its asset says it rests."""
    true = true_world(body, nuisance)
    angle = np.arctan2(true.gravity_cosine, -true.gravity_sine)
    g = body.gravity - (body.gravity @ body.axis) * body.axis
    down, across = g / np.linalg.norm(g), np.cross(body.axis, g / np.linalg.norm(g))
    along = (body.com @ body.axis) * body.axis
    return replace(body, com=along + body.arm * (np.cos(angle) * down - np.sin(angle) * across))


def wishes(seed: int, share: float = 1.0) -> list[Wish]:
    """All cases of a benchmark, shuffled; `share` makes fewer of each stratum. Nulls are 410 of some 700."""
    rng = np.random.default_rng([seed, 2])
    found: list[Wish] = []

    def count(n: int) -> int:
        return max(1, round(n * share))

    def family() -> str:
        return str(rng.choice(["pendulum", "door", "drawer", "slope"], p=[0.4, 0.2, 0.2, 0.2]))

    rigs = ("full", "free", "swing", "push", "servo", "effort", "poses")
    for _ in range(count(410)):
        rig = str(rng.choice(rigs, p=[0.56, 0.09, 0.05, 0.08, 0.08, 0.06, 0.08]))
        found.append(Wish("null", (), rig, "pendulum" if rig == "swing" else family()))
    for strength in ("clear", "weak"):
        for name in effects.START:
            for i in range(count(4)):
                kind = "pendulum" if name == "load_friction" else family()
                sets: tuple[str, ...] = ()
                if name == "coulomb_friction" and strength == "weak":
                    kind = "pendulum"
                if name == "coulomb_friction" and kind == "door":
                    kind = "drawer"  # a door's bearing carries the more the faster it swings
                if name == "coulomb_friction" and kind != "pendulum":
                    sets = CONSTANT_LOAD
                if i % 4 == 3 and name in ("viscous_damping", "coulomb_friction", "quadratic_drag", "return_spring"):
                    rig = str(rng.choice(["free", "push", "servo"]))
                else:
                    rig = "full"
                found.append(Wish("gauge" if sets else "single", (name,), rig, kind, strength, sets))
    for name in ("viscous_damping", "quadratic_drag", "return_spring"):
        found += [Wish("single", (name,), "swing", "pendulum") for _ in range(count(3))]
    for name in poses.KINEMATIC:
        for _ in range(count(4)):
            hinge = name in poses.REVOLUTE_ONLY
            found.append(
                Wish("kinematic", (name,), "poses", str(rng.choice(["pendulum", "door"])) if hinge else family())
            )
    for pair in PAIRS:
        kinds = ["pendulum" if "coulomb_friction" in pair else family() for _ in range(count(3))]
        found += [Wish("pair", pair, "full", kind) for kind in kinds]
    for name in effects.STRANGE:  # some two thirds become clear: of fewer, one is more than 5 %
        for _ in range(count(6)):
            kind = "pendulum" if name == "asymmetric_friction" else family()
            found.append(Wish("strange", (name,), "full", kind))
    for name, rig, families, sets in GAUGES:
        found += [Wish("gauge", (name,), rig, str(rng.choice(families)), sets=sets) for _ in range(count(4))]
    for name in (None, "viscous_damping", "coulomb_friction", "quadratic_drag", "stribeck_friction"):
        found += [Wish("still", () if name is None else (name,), "still", "pendulum") for _ in range(count(4))]
    return [found[i] for i in rng.permutation(len(found))]


assert RUNS == 13
