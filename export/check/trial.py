"""The trial of an asset in one engine, rule by rule, against the file's own numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from export.check.engines.base import GRAVITY, Setting, World
from export.check.report import Row
from export.check.rules import (
    DRIFT_M,
    DRIFT_RAD,
    ENERGY_RISE,
    MASS_TOLERANCE,
    POSE_TOLERANCE,
    REST_S,
    STATES,
    TURNS,
)
from export.check.tree import Tree
from freeart21 import processes, se3
from freeart21.files.urdf import LARGEST_LIMIT, UrdfInertial, UrdfJoint
from freeart21.se3 import Array

LIMIT_TOLERANCE = 1e-6
"""rad or m, relative beyond 1: engines keep limits in single precision."""
DRIVEN_JOINTS = 8
"""Number of joints that are pushed, the first ones of the file."""
PUSH_S = 1.5
"""Twice what `push_force` needs for the whole range, so that the joint also rests at its limit."""
REACH = 0.02
"""Fraction of the range by which a joint may miss a limit, or rest beyond it. MuJoCo's limits are springs of 0.02 s:
under `push_force` they yield by 0.1 % of the range."""
BOUNCE = 0.1
"""Fraction of the range by which it may overshoot a limit: at the speed of arrival MuJoCo's yield by 3 %."""
FREE_S = 2.0
SETTLE_S, SAMPLE_S = 0.5, 0.01
SWING = 0.1
"""Fraction of the allowed drift that a body must swing back to count as a reversal, .1 mm or .001 rad: in PyBullet a
lighter's lid hops by .0005 rad for ever on the limit at which gravity holds it."""
STATED = ("engine.tree", "engine.limits", "engine.masses", "engine.poses")
MOVED = ("joint.moves", "joint.stops", "energy.falls", "rest.drift", "rest.oscillation")


@dataclass(frozen=True)
class Trial:
    """One asset in one engine."""

    engine: str
    tree: Tree | None
    """From the file; None where only the engine can read it."""
    lowest: float | None
    """Height, m, of the lowest collision point in the root's frame, joints as loaded."""
    load: Callable[[Setting], World]

    def rows(self, say: Callable[[str], None]) -> Iterator[Row]:
        """Every rule, in order. `say` is called with each rule before it is tried."""
        say("engine.loads")
        try:
            world = self.load(Setting(fixed=True, gravity=False, floor=False))
        except Exception as error:  # the engine's own faults, of any type
            yield self._row("engine.loads", "fail", processes.one_line(error)[:300])
            for rule in (*STATED, *MOVED):
                yield self._row(rule, "skip", "it does not load")
            return
        yield self._row("engine.loads", "pass", f"{len(world.parents)} links, {len(world.limits)} joints that move")
        stated: dict[str, Callable[[World, Tree], Row]] = {
            "engine.tree": self._same_tree,
            "engine.limits": self._limits,
            "engine.masses": self._masses,
            "engine.poses": self._poses,
        }
        for rule, judged in stated.items():
            say(rule)
            if self.tree is None:
                yield self._row(rule, "skip", "the file has what only the engine reads")
            else:
                yield self._guarded(rule, lambda judged=judged: [judged(world, self.tree)])[0]  # type: ignore[misc]
        moved: dict[tuple[str, ...], Callable[[], list[Row]]] = {
            ("joint.moves", "joint.stops"): lambda: self._driven(world),
            ("energy.falls",): self._energy,
            ("rest.drift", "rest.oscillation"): self._rest,
        }
        for rules, tried in moved.items():
            say(rules[0])
            yield from self._guarded(rules[0], tried, rules[1:])

    def _guarded(self, rule: str, tried: Callable[[], list[Row]], others: tuple[str, ...] = ()) -> list[Row]:
        try:
            return tried()
        except Exception as error:
            left = [self._row(other, "skip", f"see {rule}") for other in others]
            return [self._row(rule, "fail", processes.one_line(error)[:300]), *left]

    def _row(self, rule: str, verdict: Any, reason: str = "", value: float | None = None, unit: str = "") -> Row:
        return Row(rule, self.engine, verdict, reason, value, unit)

    def _bounded_row(self, rule: str, value: float, bar: float, unit: str, what: str) -> Row:
        """A row for a number with an upper bound."""
        reason = f"{what}: {value:.3g}{f' {unit}' if unit else ''}, expected at most {bar:g}"
        return self._row(rule, "pass" if value <= bar else "fail", reason, float(value), unit)

    # ---- the engine's numbers

    def _same_tree(self, world: World, tree: Tree) -> Row:
        expected: dict[str, str | None] = {tree.root: None} | {j.child: j.parent for j in tree.joints.values()}
        if tree.fixed_base:  # some engines take a link of that name for their world, some for an ordinary link
            expected.pop(tree.root)
            found = {k: None if v == tree.root else v for k, v in world.parents.items() if k != tree.root}
            expected = {k: None if v == tree.root else v for k, v in expected.items()}
        else:
            found = world.parents
        for link in {**expected, **found}:
            if link not in found:
                return self._row("engine.tree", "fail", f"link '{link}' is missing")
            if link not in expected:
                return self._row("engine.tree", "fail", f"link '{link}' is not the file's")
            if expected[link] != found[link]:
                parents = f"has parent '{found[link]}', expected '{expected[link]}'"
                return self._row("engine.tree", "fail", f"link '{link}' {parents}")
        if still := {j.name for j in tree.movable} - {*world.limits}:
            return self._row("engine.tree", "fail", f"joints that do not move: {', '.join(sorted(still))}")
        return self._row("engine.tree", "pass")

    def _limits(self, world: World, tree: Tree) -> Row:
        worst, judged = 0.0, [j for j in tree.movable if j.ordered and j.name in world.limits]
        for joint in judged:
            for mine, its in zip((joint.lower, joint.upper), world.limits[joint.name], strict=True):
                if _is_unlimited(mine) and _is_unlimited(its):
                    continue
                off = abs(mine - its) / max(1.0, abs(mine)) if np.isfinite(mine) else np.inf
                worst = max(worst, off)
                if off > LIMIT_TOLERANCE:
                    reason = f"joint '{joint.name}' has the limit {its:g}, expected {mine:g}"
                    return self._row("engine.limits", "fail", reason, float(worst), "rad or m")
        if not judged:
            return self._row("engine.limits", "skip", "no joint has a range")
        return self._row("engine.limits", "pass", "", worst, "rad or m")

    def _masses(self, world: World, tree: Tree) -> Row:
        found, worst, which = world.inertials(), 0.0, ""
        for name, body in tree.inertials.items():
            if name not in found or body.mass <= 0:
                continue
            moment = max(np.linalg.eigvalsh(body.inertia)[-1], 1e-300)
            off = max(
                abs(found[name].mass - body.mass) / body.mass,
                float(np.abs(found[name].inertia - body.inertia).max() / moment),
            )
            if off > worst:
                worst, which = off, name
        if not tree.inertials:
            return self._row("engine.masses", "skip", "the file gives none")
        return self._bounded_row("engine.masses", worst, MASS_TOLERANCE, "", f"link '{which}' is off by the fraction")

    def _poses(self, world: World, tree: Tree) -> Row:
        rng, worst, which = np.random.default_rng(0), 0.0, tree.root
        for _ in range(STATES):
            q = tree.complete({joint.name: rng.uniform(*joint.sweep) for joint in tree.movable})
            world.put(q)
            expected, found = tree.link_poses(q), world.poses()
            base = se3.inverse(found.get(tree.root, np.eye(4)))
            for name in tree.links:
                if name in found:
                    reach = max(1.0, float(np.abs(expected[name][:3, 3]).max()))
                    off = float(np.abs(base @ found[name] - expected[name]).max()) / reach
                    if off > worst:
                        worst, which = off, name
        world.put({})
        return self._bounded_row("engine.poses", worst, POSE_TOLERANCE, "", f"link '{which}' is off by")

    # ---- motion

    def _driven(self, world: World) -> list[Row]:
        if self.tree is None:
            return [self._row(rule, "skip", "the file has what only the engine reads") for rule in MOVED[:2]]
        tree, bodies = self.tree, world.inertials()
        start = tree.complete({joint.name: joint.loaded for joint in tree.movable})
        weights = np.diag(tree.mass_matrix(start, bodies))
        short, beyond, judged = ("", 0.0), ("", 0.0), 0
        for joint, inertia in list(zip(tree.movable, weights, strict=True))[:DRIVEN_JOINTS]:
            if joint.name not in world.limits or not joint.ordered or not inertia > 0:
                continue
            judged += 1
            ends, low, high = self._pushed(world, joint, float(inertia), start)
            span = _joint_range(joint)
            limited = np.isfinite([joint.lower, joint.upper]).all()
            if limited:
                miss = max(joint.upper - ends[1], ends[0] - joint.lower, 0.0) / span
                rests = max(ends[1] - joint.upper, joint.lower - ends[0], 0.0) / span / REACH
                shot = max(high - joint.upper, joint.lower - low, 0.0) / span / BOUNCE
                if not max(rests, shot) <= beyond[1]:
                    beyond = (joint.name, max(rests, shot))
            else:
                miss = max(0.0, 1.0 - (ends[1] - ends[0]) / (2 * span))
            if not miss <= short[1]:
                short = (f"joint '{joint.name}' went from {ends[0]:.4g} to {ends[1]:.4g}", miss)
        if not judged:
            why = "no joint with a range moves any mass"
            return [self._row(rule, "skip", why) for rule in MOVED[:2]]
        moves = self._bounded_row(
            "joint.moves", short[1], REACH, "of its range", f"{short[0] or 'all joints'}, short by"
        )
        if moves.verdict == "fail":
            return [moves, self._row("joint.stops", "skip", "it does not reach them")]
        what = f"joint '{beyond[0]}' is beyond a limit, relative to the tolerance" if beyond[0] else "beyond a limit"
        return [moves, self._bounded_row("joint.stops", beyond[1], 1.0, "", what)]

    def _pushed(
        self, world: World, joint: UrdfJoint, inertia: float, start: Mapping[str, float]
    ) -> tuple[tuple[float, float], float, float]:
        """Where `joint` rests when pushed down and when pushed up, and its least and greatest position on the way."""
        force, endless = push_force(joint, inertia), not np.isfinite(joint.upper - joint.lower)
        world.put(start)
        seen, ends = [], []
        for push in (force, -force):
            if endless:
                world.put(start)
            way = [start[joint.name]]
            for _ in range(round(PUSH_S / SAMPLE_S)):
                world.advance(SAMPLE_S, {joint.name: push})
                way.append(world.state()[0][joint.name])
                if endless and joint.joint_type == "revolute":
                    way[-1] = float(np.unwrap(way[-2:])[-1])  # SAPIEN wraps the angle of an endless joint
                if endless and abs(way[-1] - way[0]) > _joint_range(joint):
                    break
            seen += way
            ends.append(way[-1])
        world.advance(SAMPLE_S)
        world.put(start)
        return (ends[1], ends[0]), min(seen), max(seen)

    def _energy(self) -> list[Row]:
        world = self.load(Setting(fixed=True, gravity=True, floor=False))
        bodies = world.inertials()
        start, speed = {}, {}
        for name in world.limits:
            known = None if self.tree is None else self.tree.joints.get(name)
            if known is not None and known.mimic is None and known.ordered:
                low, high = known.sweep
                start[name] = 0.5 * (low + high) if np.isfinite(known.lower) else 0.0
                speed[name] = 0.5 * _joint_range(known)
        if not start:
            return [self._row("energy.falls", "skip", "no joint has a range that is known")]
        world.put(start, speed)
        energies = []
        for k in range(round(FREE_S / SAMPLE_S) + 1):
            if k:
                world.advance(SAMPLE_S)
            energies.append((self._joules(world, bodies), self._kinetic(*world.state(), bodies)))
        E, kinetic = np.array(energies).T
        if not np.isfinite(E).all():
            return [self._row("energy.falls", "fail", "its state is no number any more")]
        if not kinetic[0] > 0:
            return [self._row("energy.falls", "skip", "nothing of it that moves has mass")]
        rise = float((E - E[0]).max() / kinetic.max())
        return [
            self._bounded_row(
                "energy.falls", rise, ENERGY_RISE, "of its greatest kinetic energy", "its energy rises by"
            )
        ]

    def _kinetic(self, q: Mapping[str, float], qd: Mapping[str, float], bodies: Mapping[str, UrdfInertial]) -> float:
        if self.tree is None:
            return 0.0
        v = np.array([qd.get(joint.name, 0.0) for joint in self.tree.movable])
        return float(0.5 * v @ self.tree.mass_matrix(self.tree.complete(q), bodies) @ v)

    def _joules(self, world: World, bodies: Mapping[str, UrdfInertial]) -> float:
        energy = world.energy()
        if energy is not None:
            return energy
        assert self.tree is not None
        q, qd = world.state()
        return self._kinetic(q, qd, bodies) + self.tree.height_energy(self.tree.complete(q), bodies, GRAVITY)

    def _rest(self) -> list[Row]:
        if self.tree is not None and self.tree.fixed_base:
            return [self._row(rule, "skip", "the file nails it to the world") for rule in MOVED[3:]]
        world = self.load(Setting(fixed=False, gravity=True, floor=True))
        start = {}
        if self.tree is not None:
            start = self.tree.complete({joint.name: joint.loaded for joint in self.tree.movable})
            world.put(start)
        if world.root_held:
            why = "the engine holds its root: it has no mass, or is attached to the world by a joint"
            return [self._row(rule, "skip", why) for rule in MOVED[3:]]
        lowest = world.lowest()
        if lowest is None and self.lowest is None:
            return [self._row(rule, "skip", "it has no collision shapes") for rule in MOVED[3:]]
        root = next(name for name, parent in world.parents.items() if parent is None)
        T = world.poses()[root].copy()
        if self.lowest is not None:
            T[2, 3] = -self.lowest
            world.place(T)
            lowest = world.lowest()
        if lowest is not None:  # with the engine's own margins
            T[2, 3] -= lowest
            world.place(T)
        bodies = world.inertials()
        names = [name for name in world.parents if name in bodies]
        centres = np.array([bodies[name].centre for name in names])
        frames = [_stack_poses(world.poses(), names)]
        for _ in range(round(REST_S / SAMPLE_S)):
            world.advance(SAMPLE_S)
            frames.append(_stack_poses(world.poses(), names))
        return self._rested(np.stack(frames), names, centres)

    def _rested(self, Ts: Array, names: list[str], centres: Array) -> list[Row]:
        """Rows from link poses (frames, links, 4, 4)."""
        if not np.isfinite(Ts).all():
            return [
                self._row("rest.drift", "fail", "its state is no number any more"),
                self._row("rest.oscillation", "skip", "it did not stay"),
            ]
        at = np.einsum("flij,lj->fli", Ts[..., :3, :3], centres) + Ts[..., :3, 3]
        moved = np.linalg.norm(at - at[0], axis=-1)
        turned = se3.rotation_angle(Ts[..., :3, :3] @ np.swapaxes(Ts[0, :, :3, :3], -1, -2))
        off = np.maximum(moved / DRIFT_M, turned / DRIFT_RAD).max(0)
        k = int(off.argmax())
        reason = f"link '{names[k]}' moves by {1e3 * moved[:, k].max():.3g} mm and {turned[:, k].max():.3g} rad"
        if k and off[0] <= 1:
            reason += f", its root by {1e3 * moved[:, 0].max():.3g} mm"
        drift = self._row("rest.drift", "pass" if off[k] <= 1 else "fail", reason, float(off[k]), "of the bar")
        if drift.verdict == "fail":
            return [drift, self._row("rest.oscillation", "skip", "it did not stay")]
        settled = round(SETTLE_S / SAMPLE_S)
        R = Ts[settled:, :, :3, :3]
        spun = se3.log_so3(R @ np.swapaxes(R[:1], -1, -2))
        turns = max(_count_reversals(at[settled:], SWING * DRIFT_M), _count_reversals(spun, SWING * DRIFT_RAD))
        what = "changes of a velocity's sign"
        return [drift, self._bounded_row("rest.oscillation", turns, TURNS - 1, "", what)]


def push_force(joint: UrdfJoint, inertia: float) -> float:
    """Force, N m or N, that moves the joint over its range in `PUSH_S` / 2 s without gravity: for its inertia (kg m^2
    or kg) and the file's damping and friction."""
    seconds, span = 0.5 * PUSH_S, _joint_range(joint)
    return 2 * inertia * span / seconds**2 + 2 * joint.damping * span / seconds + 1.5 * joint.friction


def _joint_range(joint: UrdfJoint) -> float:
    low, high = joint.sweep
    return high - low


def _is_unlimited(limit: float) -> bool:
    return not np.isfinite(limit) or abs(limit) > LARGEST_LIMIT


def _stack_poses(poses: Mapping[str, Array], names: list[str]) -> Array:
    return np.stack([poses[name] for name in names])


def _count_reversals(path: NDArray[np.float64], swing: float) -> int:
    """Largest number of reversals of a component of a path (n, ...); reversals by less than `swing` do not count."""
    most = 0
    for component in path.reshape(len(path), -1).T:
        low = high = component[0]
        way, count = 0, 0
        for value in component:
            low, high = min(low, value), max(high, value)
            if way >= 0 and value < high - swing:
                count += way > 0
                way, low = -1, value
            elif way <= 0 and value > low + swing:
                count += way < 0
                way, high = 1, value
        most = max(most, count)
    return most
