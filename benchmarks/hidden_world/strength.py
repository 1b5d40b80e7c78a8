"""How strong a case is: the gap in floors that is left when nuisance has explained what it can."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from benchmarks.hidden_world import effects, poses
from benchmarks.hidden_world.body import Body
from benchmarks.hidden_world.nuisance import (
    GRAVITY_VECTOR,
    LEAD,
    Reading,
    drive_of,
    floor,
    nominal_times,
    true_world,
    with_servo,
)
from benchmarks.hidden_world.ode import ELASTIC, Drive, World, longest_step, simulate
from benchmarks.hidden_world.rig import RUNS, Plan

if TYPE_CHECKING:
    from benchmarks.hidden_world.cases import Case

HAIR = 2
"""Runs, those with the largest gaps, that do not count."""
_STEPS = ((0.0, 1.0), (1e-3, 1.0), (1e-2, 1.0), (0.1, 1.0), (1.0, 1.0), (0.0, 0.4), (1e-2, 0.3), (1e-2, 0.1))
"""Damping of a step, and the part of it that is gone, of all that are tried."""


@dataclass(frozen=True)
class Hidden:
    """One hidden effect."""

    name: str
    seed: int
    size: float


def changed(world: World, body: Body, hidden: tuple[Hidden, ...]) -> tuple[World, Reading]:
    """The true world and reading with all that is hidden."""
    reading = Reading()
    for h in hidden:
        if h.name in poses.KINEMATIC:
            continue
        world, read = effects.applied(h.name, h.seed, h.size, body, world)
        reading = reading if read == Reading() else read
    return world, reading


@dataclass
class Gap:
    """How much of a change of the readings nuisance can not explain, in floors; linear in the nuisance."""

    case: Case
    base: World = field(init=False)
    floor: float = field(init=False)
    _asked: NDArray[np.float64] = field(init=False)
    _drives: list[Drive] = field(init=False)
    _beside: tuple[Hidden, ...] = ()
    _kept: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        times = nominal_times()
        self._asked = np.concatenate([[-LEAD], times])
        self._drives = [drive_of(plan, times, self.case.wish.rig == "effort") for plan in self.case.plans]
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
        step = 2 * longest_step(world)
        return simulate(world, plan.q0 + dq, plan.v0 + dv, self._asked, self._drives[i], clock=8.0 * i, step=step)[1:]

    def _ways(self) -> NDArray[np.float64]:
        """(k, 2) unit directions of gravity's (cosine, sine): along the asset's own pull, and across."""
        if not self.case.body.revolute:
            return np.zeros((0, 2))
        cosine, sine, _ = self.case.body.gravity_terms()
        angle = np.arctan2(sine, cosine)
        return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    @property
    def _pull(self) -> float:
        """What gravity's force on the joint is counted in, N*m or N: the uncertainty's own measure."""
        body = self.case.body
        return GRAVITY_VECTOR[body.family] * body.mass * 9.81 * (body.arm if body.revolute else 1.0)

    def _moved(self, at: NDArray[np.float64]) -> World:
        """The world whose inertia and gravity are off by `at` (1 + k,) more than they are."""
        w = self.base
        if self.case.body.revolute:
            c, s = self._pull * at[1:3] @ self._ways()
            w = w._replace(
                inertia=(1 + at[0]) * w.inertia, gravity_cosine=w.gravity_cosine + c, gravity_sine=w.gravity_sine + s
            )
            return changed(w, self.case.body, self._beside)[0]
        w = w._replace(inertia=(1 + at[0]) * w.inertia, gravity_constant=w.gravity_constant + self._pull * at[1])
        return changed(w, self.case.body, self._beside)[0]

    def _told(self, world: World) -> NDArray[np.float64]:
        """(1 + k,) by how much a world's inertia and gravity differ from this one's, in the units of `_moved`."""
        w, own = self.base, world.inertia
        own = own + (world.link_inertia if world.link == ELASTIC and w.link != ELASTIC else 0.0)
        if self.case.body.revolute:
            off = np.array([world.gravity_cosine - w.gravity_cosine, world.gravity_sine - w.gravity_sine])
            return np.append(own / w.inertia - 1, self._ways() @ off / self._pull)
        return np.array([own / w.inertia - 1, (world.gravity_constant - w.gravity_constant) / self._pull])

    def _bounds(self) -> NDArray[np.float64]:
        """(1 + k, 2) how far inertia and gravity may go from where they are.

        What may be off is off already: an effect that takes it back may be as large as both together. A little more
        than the asset says is let pass: a clear effect is no matter of a tenth.
        """
        off = -self._told(self.case.body.world())
        most = np.append(0.105, np.full(len(off) - 1, 1.2))
        return np.stack([-most - off, most - off], 1)

    def _explainable(self, at: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """(rows, 1 + k + 26) what a unit of nuisance does to the readings, about `at`, or about what is."""
        if at is None and "columns" in self._kept:
            return self._kept["columns"]
        body, k = self.case.body, len(self._bounds())
        here = np.zeros(k + 2 * RUNS) if at is None else at
        world = self._moved(here[:k])
        starts = self._starts(here[k:])
        now = np.array([self._run(world, plan, i, *starts[i])[:, 0] for i, plan in enumerate(self.case.plans)])
        columns = []
        for j, step in enumerate((0.02, *np.full(k - 1, 0.05))):
            to = here[:k].copy()
            to[j] += step
            there = self._moved(to)
            rows = [self._run(there, plan, i, *starts[i])[:, 0] for i, plan in enumerate(self.case.plans)]
            columns.append((np.array(rows) - now).ravel() / step)
        for i, plan in enumerate(self.case.plans):
            for dq, dv in ((1e-3 * body.range, 0.0), (0.0, 1e-3 * body.speed)):
                column = np.zeros_like(now)
                sign = -1.0 if plan.q0 + starts[i, 0] > body.upper - 2e-3 * body.range else 1.0
                there_q = self._run(world, plan, i, starts[i, 0] + sign * dq, starts[i, 1] + sign * dv)[:, 0]
                column[i] = (there_q - now[i]) * sign
                columns.append(column.ravel())
        found = np.array(columns).T
        if at is None:
            self._kept["columns"] = found
        return found

    def ratio(self, hidden: tuple[Hidden, ...], beside: tuple[Hidden, ...] = (), closely: bool = False) -> float:
        """Root mean square of what remains, over the floor, with the effects `beside` free to help explaining.

        With `closely` the nuisance that explains most is followed with slopes of its own at every step: far from what
        is, those from here mislead.
        """
        change = self._change(hidden)
        box = self._bounds()

        def size(left: NDArray[np.float64]) -> float:
            """What most runs show: one whose course hangs on a hair tells nothing."""
            powers = np.sort((left.reshape(RUNS, -1) ** 2).mean(1))
            return float(np.sqrt(powers[:-HAIR].mean()) / self.floor)

        lower, upper = np.append(box[:, 0], [-np.inf] * 2 * RUNS), np.append(box[:, 1], [np.inf] * 2 * RUNS)
        if any(rival.name in effects.SENSING for rival in beside):
            columns = np.column_stack([self._explainable(), *(self._change((rival,)) for rival in beside)])
            more = np.zeros(len(beside))
            move = _bounded(columns, change, np.append(lower, more), np.append(upper, more + np.inf))
            return size(change - columns @ move)
        if beside:
            return self._beyond(change, beside, (lower, upper), size)
        same = self._told(changed(self.base, self.case.body, hidden)[0])
        nothing = np.zeros(len(lower))

        def slopes(at: NDArray[np.float64]) -> NDArray[np.float64]:
            return self._explainable(at if closely and np.any(at) else None)

        says = np.append(np.clip(same, box[:, 0], box[:, 1]), nothing[len(box) :])
        best = np.inf
        for at in (nothing, says) if np.any(same) else (nothing,):
            least = _least(at, change, self._shift, slopes, (lower, upper), size, 12 if closely else 2, len(box))
            best = min(best, least)
            if best < 1:
                break
        return best

    def _beyond(
        self,
        change: NDArray[np.float64],
        beside: tuple[Hidden, ...],
        box: tuple[NDArray[np.float64], NDArray[np.float64]],
        size: Callable[[NDArray[np.float64]], float],
    ) -> float:
        """What remains beyond nuisance and plainer effects of any size, slopes taken anew at every step."""
        k, n = len(box[0]), len(beside)
        ends = [-np.inf if rival.name == "gravity_offset" else 0.0 for rival in beside]
        lower, upper = np.append(box[0], ends), np.append(box[1], np.full(n, np.inf))

        def shift(x: NDArray[np.float64]) -> NDArray[np.float64]:
            self._beside = tuple(replace(h, size=float(s)) for h, s in zip(beside, x[k:], strict=True) if abs(s) > 1e-9)
            return self._shift(x[:k])

        def slopes(at: NDArray[np.float64]) -> NDArray[np.float64]:
            now = shift(at)
            columns = [self._explainable(at[:k] if np.any(at) else None)]
            for j, rival in enumerate(beside):
                step = 0.2 * rival.size * np.eye(k + n)[k + j]
                columns.append(((shift(at + step) - now) / (0.2 * rival.size))[:, None])
            return np.concatenate(columns, 1)

        least = _least(np.zeros(k + n), change, shift, slopes, (lower, upper), size, 12, len(self._bounds()))
        self._beside = ()
        return least

    def _starts(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """(runs, 2) by how much start states differ, within the limits."""
        body = self.case.body
        starts = at.reshape(-1, 2) * 1e-3 * np.array([body.range, body.speed])
        q0 = np.array([plan.q0 for plan in self.case.plans])
        starts[:, 0] = np.clip(starts[:, 0], body.lower - q0, body.upper - q0)
        return starts

    def _shift(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """(rows,) what nuisance of this size, in the units of the columns, truly does to the readings."""
        if not np.any(at) and not self._beside:
            return np.zeros(self._q.size)
        k = len(self._bounds())
        world, starts = self._moved(at[:k]), self._starts(at[k:])
        rows = [self._run(world, plan, i, *map(float, starts[i]))[:, 0] for i, plan in enumerate(self.case.plans)]
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


def _least(
    at: NDArray[np.float64],
    change: NDArray[np.float64],
    shift: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    slopes: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    box: tuple[NDArray[np.float64], NDArray[np.float64]],
    size: Callable[[NDArray[np.float64]], float],
    most: int,
    first: int,
) -> float:
    """The least size of `change` that steps from `at` (k,), at most so many, leave: `shift` truly does it, `slopes`
    are its derivative, `box` bounds it. Of every step several lengths are tried (Levenberg and Marquardt's damping),
    and the runs that do not count for the size do not lead it. From `first` on are two numbers of every run's start,
    which go back to 0 where that leaves less of their run: an impact may lead them astray."""
    own = slice(first, first + 2 * RUNS)

    def tried(to: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        back = to.copy()
        back[own] = 0.0
        ways = [(change - shift(there)).reshape(RUNS, -1) for there in (to, back)]
        better = (ways[1] ** 2).mean(1) < (ways[0] ** 2).mean(1)
        to = to.copy()
        to[own] = np.where(np.repeat(better, 2), 0.0, to[own])
        return to, np.where(better[:, None], ways[1], ways[0]).ravel()

    rest = change - shift(at)
    least, idle = size(rest), 0
    for _ in range(most):  # and again of what is left when it truly is so
        powers = (rest.reshape(RUNS, -1) ** 2).mean(1)
        counts = np.repeat(powers <= np.sort(powers)[-HAIR - 1], len(rest) // RUNS)
        J, before, found = slopes(at), least, None
        for damping, part in _STEPS if most > 2 else _STEPS[::2]:
            move = _bounded(J * counts[:, None], rest * counts, box[0] - at, box[1] - at, damping)
            to, left = tried(at + part * move)
            if size(left) < least:
                least, found = size(left), (to, left)
            elif least < 0.7 * before:  # well on the way
                break
        if found is None or least < 1:
            break
        (at, rest), idle = found, idle + 1 if least > 0.97 * before else 0
        if idle == 2:
            break
    return least


def _bounded(
    columns: NDArray[np.float64],
    rest: NDArray[np.float64],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    damping: float = 0.0,
) -> NDArray[np.float64]:
    """(k,) the least squares solution of columns @ x = rest within the bounds; `damping` of every scaled column."""
    scale = np.linalg.norm(columns, axis=0)
    keep = scale > 1e-12
    basis, R = np.linalg.qr(columns[:, keep] / scale[keep])
    ends = [np.minimum(lower[keep] * scale[keep], -1e-12), np.maximum(upper[keep] * scale[keep], 1e-12)]
    A, b = np.vstack([R, np.sqrt(damping) * np.eye(len(R))]), np.append(basis.T @ rest, np.zeros(len(R)))
    found = np.zeros(len(scale))
    found[keep] = lsq_linear(A, b, ends, method="bvls").x / scale[keep]
    return found
