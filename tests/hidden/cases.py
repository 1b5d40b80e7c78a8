"""Cases: a body, its nuisances, the runs of a rig, and what is hidden in them; drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from hidden import effects, poses
from hidden.body import Body, draw_body
from hidden.nuisance import (
    GRAVITY_VECTOR,
    LEAD,
    Nuisance,
    Reading,
    draw_nuisance,
    drive_of,
    floor,
    nominal_times,
    true_world,
    with_servo,
)
from hidden.ode import World, longest_step, simulate
from hidden.rig import RUNS, Plan, Servo, draw_plans, draw_servo

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
GAUGES = (  # effect, rig, families, what cannot be told apart
    ("encoder_offset", "swing", ("pendulum",), ("encoder_offset", "gravity_offset")),
    ("armature", "swing", ("pendulum",), ("armature", "gravity_offset")),
    ("actuator_gain", "servo", ("drawer",), ("actuator_gain", "armature")),
    ("actuator_delay", "effort", ("pendulum", "door", "drawer"), ("actuator_delay", "time_offset")),
    ("load_friction", "full", ("drawer", "slope"), ("load_friction", "coulomb_friction")),
)
CLEAR, WEAK = (6.0, 40.0), (1.3, 4.0)
"""Floors of the gap that nuisance cannot explain."""
LEAST_CLEAR = 5.0
PASSABLE = 2.5
"""Floors that must remain beyond plainer effects for a clear case."""


@dataclass(frozen=True)
class Hidden:
    """One hidden effect."""

    name: str
    seed: int
    size: float


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


def changed(world: World, body: Body, hidden: tuple[Hidden, ...]) -> tuple[World, Reading]:
    """The true world and reading with all that is hidden."""
    reading = Reading()
    for h in hidden:
        if h.name in poses.KINEMATIC:
            continue
        world, read = effects.applied(h.name, h.seed, h.size, body, world)
        reading = reading if read == Reading() else read
    return world, reading


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
    plans = draw_plans(rng, body, wish.rig, servo, nominal_times())
    seeds = [int(s) for s in rng.integers(1 << 30, size=2)]
    case = Case(wish, seed, body, servo, nuisance, plans, ())
    if not wish.names:
        return replace(case, floor=_Gap(case).floor if wish.rig != "poses" and search else 0.0)
    if wish.stratum == "kinematic":
        low, high = poses.KINEMATIC[wish.names[0]]
        size = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        return replace(case, hidden=(Hidden(wish.names[0], seeds[0], size),), ratio=np.nan, distinct=np.nan)
    target = float(np.exp(rng.uniform(*np.log(WEAK if wish.strength == "weak" else CLEAR))))
    gap = _Gap(case) if search else None
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
    total = gap.ratio(hidden)
    if wish.stratum == "pair":
        alone = min(gap.ratio((h,), beside=(other,)) for h, other in zip(hidden, hidden[::-1], strict=True))
    else:
        rivals = tuple(
            Hidden(name, 5, effects.START[name][0])
            for name in effects.RIVALS_OF.get(wish.names[0], ())
            if wish.stratum != "still"
        )
        alone = gap.ratio(hidden, beside=rivals) if rivals else total
    return replace(case, hidden=hidden, floor=gap.floor, ratio=total, distinct=alone)


@dataclass
class _Gap:
    """How much of a change of the readings nuisance can not explain, in floors; linear in the nuisance."""

    case: Case
    base: World = field(init=False)
    floor: float = field(init=False)
    _kept: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.base = with_servo(true_world(self.case.body, self.case.nuisance), self.case.servo)
        self._q, speeds = self._trace(self.base)
        self.floor = floor(self.case.nuisance, float(np.sqrt((speeds**2).mean())))

    def _trace(self, world: World, reading: Reading | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(13, n) readings and speeds without noise, on the nominal times."""
        rows = [self._run(world, plan, i) for i, plan in enumerate(self.case.plans)]
        q, v = np.array([r[:, 0] for r in rows]), np.array([r[:, 1] for r in rows])
        if reading is not None and reading != Reading():
            if reading.late:
                q = q - reading.late * v
            q = reading.factor * q + reading.curve * q**3 + reading.offset
            q = q + reading.ripple * np.sin(reading.ripple_count * q)
        return q, v

    def _run(self, world: World, plan: Plan, i: int, dq: float = 0.0, dv: float = 0.0) -> NDArray[np.float64]:
        times = nominal_times()
        drive = drive_of(plan, times, self.case.wish.rig == "effort")
        asked = np.concatenate([[-LEAD], times])
        step = 2 * longest_step(world)
        return simulate(world, plan.q0 + dq, plan.v0 + dv, asked, drive, clock=8.0 * i, step=step)[1:]

    def _explainable(self) -> tuple[NDArray[np.float64], list[tuple[float, float]]]:
        """(rows, k) what nuisance does to the readings, and how far each may go from where it is.

        What may be off is off already: an effect that takes it back may be as large as both together.
        """
        if "columns" in self._kept:
            return self._kept["columns"]
        body, w = self.case.body, self.base
        g = GRAVITY_VECTOR[body.family] * body.mass * 9.81 * (body.arm if body.revolute else 1.0)
        off = self.case.nuisance.inertia - 1
        moves = [(w._replace(inertia=1.02 * w.inertia), 0.02)]
        bounds = [(-0.1 - off, 0.1 - off)]
        for name in ("gravity_cosine", "gravity_sine") if body.revolute else ("gravity_constant",):
            moves.append((w._replace(**{name: getattr(w, name) + 0.05 * g}), 0.05))
            off = (getattr(w, name) - getattr(body.world(), name)) / g
            bounds.append((-1.1 - off, 1.1 - off))
        columns = [(self._trace(world)[0] - self._q).ravel() / step for world, step in moves]
        for i, plan in enumerate(self.case.plans):
            for dq, dv in ((1e-3 * body.range, 0.0), (0.0, 1e-3 * body.speed)):
                column = np.zeros_like(self._q)
                sign = -1.0 if plan.q0 > body.upper - 2e-3 * body.range else 1.0
                column[i] = (self._run(w, plan, i, sign * dq, dv)[:, 0] - self._q[i]) * sign
                columns.append(column.ravel())
                bounds.append((-np.inf, np.inf))
        self._kept["columns"] = np.array(columns).T, bounds
        return self._kept["columns"]

    def ratio(self, hidden: tuple[Hidden, ...], beside: tuple[Hidden, ...] = ()) -> float:
        """Root mean square of what remains, over the floor, with the effects `beside` free to help explaining."""
        columns, bounds = self._explainable()
        change = self._change(hidden)
        lower, upper = [low for low, _ in bounds], [high for _, high in bounds]
        for rival in beside:
            columns = np.column_stack([columns, self._change((rival,))])
            lower, upper = [*lower, 0.0], [*upper, np.inf]
        scale = np.linalg.norm(columns, axis=0)
        keep = scale > 1e-12
        basis, R = np.linalg.qr(columns[:, keep] / scale[keep])
        at, rest, best = np.zeros(len(scale)), change, np.inf
        for _ in range(8):  # what nuisance explains, and again of what is left when it truly is so
            before = best
            inside = basis.T @ rest
            room = [(np.array(ends) - at)[keep] * scale[keep] for ends in (lower, upper)]
            found = lsq_linear(R, inside, (np.minimum(room[0], -1e-12), np.maximum(room[1], 1e-12)), method="bvls")
            best = min(best, float(rest @ rest - inside @ inside + 2 * found.cost))
            if beside:
                break
            at[keep] += found.x / scale[keep]
            rest = change - self._shift(at)
            best = min(best, float(rest @ rest))
            if best > 0.8 * before:
                break
        return float(np.sqrt(max(best, 0.0) / len(change)) / self.floor)

    def _shift(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """(rows,) what nuisance of this size, in the units of the columns, truly does to the readings."""
        body, w = self.case.body, self.base
        g = GRAVITY_VECTOR[body.family] * body.mass * 9.81 * (body.arm if body.revolute else 1.0)
        names = ("gravity_cosine", "gravity_sine") if body.revolute else ("gravity_constant",)
        moved = {name: getattr(w, name) + x * g for name, x in zip(names, at[1:], strict=False)}
        world = w._replace(inertia=(1 + at[0]) * w.inertia, **moved)
        starts = at[1 + len(names) :].reshape(-1, 2) * 1e-3 * np.array([body.range, body.speed])
        rows = []
        for i, (plan, (dq, dv)) in enumerate(zip(self.case.plans, starts, strict=True)):
            dq = float(np.clip(dq, body.lower - plan.q0, body.upper - plan.q0))
            rows.append(self._run(world, plan, i, dq, float(dv))[:, 0])
        return np.asarray((np.array(rows) - self._q).ravel())

    def _change(self, hidden: tuple[Hidden, ...]) -> NDArray[np.float64]:
        world, reading = changed(self.base, self.case.body, hidden)
        return np.asarray((self._trace(world, reading)[0] - self._q).ravel())

    def sized(self, name: str, seed: int, start: float, target: float, gauge: bool) -> Hidden:
        """The effect at a size that makes a gap of `target` floors, within the sizes that it may have."""
        low, high = effects.SMALLEST.get(name, 1e-6), effects.LARGEST.get(name, 1e3)
        size = best = start
        off, below, above = np.inf, None, None
        for _ in range(1 if gauge else 8):
            found = max(self.ratio((Hidden(name, seed, size),)), 1e-3)
            if abs(np.log(found / target)) < off:
                best, off = size, abs(np.log(found / target))
            if off < 0.3:
                break
            below, above = (size, above) if found < target else (below, size)
            if below is not None and above is not None:
                size = float(np.sqrt(below * above))
            else:
                size = float(np.clip(size * np.clip(target / found, 0.1, 8.0), low, high))
        return Hidden(name, seed, best)


def wishes(seed: int, share: float = 1.0) -> list[Wish]:
    """All cases of a benchmark, shuffled; `share` makes fewer of each stratum. Nulls are 400 of about 950."""
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
            for i in range(count(8)):
                kind = "pendulum" if name == "load_friction" else family()
                if i % 4 == 3 and name in ("viscous_damping", "coulomb_friction", "quadratic_drag", "return_spring"):
                    rig = str(rng.choice(["free", "push", "servo"]))
                else:
                    rig = "full"
                found.append(Wish("single", (name,), rig, kind, strength))
    for name in ("viscous_damping", "quadratic_drag", "return_spring"):
        found += [Wish("single", (name,), "swing", "pendulum") for _ in range(count(6))]
    for name in poses.KINEMATIC:
        for _ in range(count(8)):
            hinge = name in poses.REVOLUTE_ONLY
            found.append(
                Wish("kinematic", (name,), "poses", str(rng.choice(["pendulum", "door"])) if hinge else family())
            )
    for pair in PAIRS:
        found += [Wish("pair", pair, "full", family()) for _ in range(count(5))]
    for name in effects.STRANGE:
        for _ in range(count(8)):
            kind = "pendulum" if name == "asymmetric_friction" else family()
            found.append(Wish("strange", (name,), "full", kind))
    for name, rig, families, sets in GAUGES:
        found += [Wish("gauge", (name,), rig, str(rng.choice(families)), sets=sets) for _ in range(count(8))]
    for name in (None, "viscous_damping", "coulomb_friction", "quadratic_drag", "stribeck_friction"):
        found += [Wish("still", () if name is None else (name,), "still", "pendulum") for _ in range(count(8))]
    return [found[i] for i in rng.permutation(len(found))]


assert RUNS == 13
