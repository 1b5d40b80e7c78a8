"""Which effects explain the runs: fits of one, two and three effects, every larger set started from its subsets."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from freeart21.effects import EFFECTS, Effect
from simgap.data import FitRun
from simgap.fit import Fit, Problem, Starts, Theory, fitted, grown, joined, pieces, placed, resettled
from simgap.guess import Guess, guesses, off
from simgap.settings import ChoiceSettings

_CROSSINGS = 2.5
"""Crossings of the range at top speed that a stretch lasts for, in which a first-order look sees an effect whole."""
_SCREEN = 2
_SLACKS = (0.003, 0.01, 0.03)
"""Parts of the way moved through that a slack is tried at."""
_HOPEFUL = 6.0
"""Times the least sum of squares on stretches that another effect may leave there and still be fitted to whole runs."""
_FAR = 2.0
"""Floors of error beyond which a run is looked at in stretches."""


PLAINER = {
    "stribeck_friction": "coulomb_friction",
    "backlash": "armature",
}
"""Effect to the one that it becomes in a special case: the plainer one has the name unless it does worse."""
TWINS = {"coulomb_friction": ("level", "load_friction"), "load_friction": ("coefficient", "coulomb_friction")}
"""Effect to its size's name and to the effect that does the same where the load on the bearing stays as it is."""


def candidates(problem: Problem, runs: tuple[FitRun, ...], encoder: bool = True) -> tuple[str, ...]:
    """Names of the effects that these runs could show at all; without an `encoder` part poses told the positions."""
    commanded = any(np.any(run.inputs.effort) or np.isfinite(run.inputs.command).any() for run in runs)
    span = problem.q_high - problem.q_low
    near = problem.q_low < problem.plant.lower + 0.02 * span or problem.q_high > problem.plant.upper - 0.02 * span
    driven = commanded or any(np.any(run.inputs.push) for run in runs)
    slack = any(effect.acts == "slack" for effect in problem.plant.effects)

    def possible(cls: type[Effect]) -> bool:
        if problem.plant.joint_type not in cls.joint_types or cls.kind == "kinematics":
            return False
        if cls.name in ("encoder_offset", "encoder_scale") and not encoder:
            return False
        if cls.acts == "command" or cls.acts == "slack":
            return commanded and not (slack and cls.acts == "slack")
        if cls.acts == "stop":
            return near
        return cls.name != "time_offset" or driven or near

    return tuple(name for name, cls in EFFECTS.items() if possible(cls))


@dataclass
class Search:
    """All fits to the runs that may be fitted, kept."""

    problem: Problem
    train: tuple[FitRun, ...]
    settings: ChoiceSettings
    names: tuple[str, ...]
    fits: dict[tuple[str, ...], Fit] = field(default_factory=dict)
    _first: tuple[tuple[FitRun, ...], Starts, list[Guess]] | None = None

    def base(self) -> Fit:
        """Nothing missing but what the asset may be off by."""
        if () not in self.fits:
            self.fits[()] = grown(Theory(self.problem, ()), self.train)
        return self.fits[()]

    def hinted(self) -> float:
        """Floors that the best effect would explain of what the asset alone leaves, to first order."""
        fall = self.base().rss - min((guess.cost for guess in self._guesses()[2]), default=np.inf)
        return float(np.sqrt(max(fall, 0.0) / sum(len(run.q) for run in self.train)))

    def _guesses(self) -> tuple[tuple[FitRun, ...], Starts, list[Guess]]:
        """Stretches that a first-order look can span, their starts, and first guesses of every effect alone by them."""
        if self._first is None:
            base, cut = self.base(), self._cut(self.base())
            at = base if cut is self.train else fitted(base.theory, cut, base.theta, iterations=4, robust=True)
            self._first = cut, at.starts, guesses(at, cut, self.names)
        return self._first

    @property
    def tries(self) -> int:
        """Effects at all their places, widths and speeds that were looked at: any of them might be the best by
        chance."""
        return max(len(self._guesses()[2]), len(self.names))

    def singles(self) -> list[Fit]:
        """Every effect alone, the best first."""
        cut, starts, found = self._guesses()
        rough = []
        for name in list(dict.fromkeys(guess.name for guess in found))[: self.settings.singles]:
            own = self._apart([guess for guess in found if guess.name == name])
            rough.append(self._rough(name, own, cut, starts))
        rough.sort(key=lambda fit: fit.cost)
        hopeful = [fit for i, fit in enumerate(rough) if i < 2 or fit.cost < _HOPEFUL * rough[0].cost]
        for fit in hopeful[: self.settings.contenders + 1]:
            theory, theta, starts = fit.theory, fit.theta, fit.starts
            if cut is not self.train:
                first = {run.name: fit.starts[f"{run.name}#0"] for run in self.train}
                ways = [fitted(theory, self.train, theta, at, _SCREEN) for at in (first, self.base().starts)]
                theta, starts = (best := min(ways, key=lambda way: way.cost)).theta, best.starts
            self._keep(fitted(theory, self.train, theta, starts))
        for name, plainer in PLAINER.items():
            if (name,) in self.fits and (plainer,) in self.fits:
                self._keep_from(name, self.fits[(plainer,)])
        if ("armature",) in self.fits and ("backlash",) in self.fits:
            self._with_slack(self.fits[("armature",)])
        return self._resettled([self.fits[(name,)] for name in self.names if (name,) in self.fits])

    def _with_slack(self, armature: Fit) -> None:
        """Backlash from an armature of its drive's inertia, with a slack so narrow that it hardly makes a difference:
        through a wide one far from the true one all impacts fall elsewhere."""
        theory, span = Theory(self.problem, ("backlash",)), self.problem.q_high - self.problem.q_low
        inertia = next(iter(armature.effects)).inertia()
        if self.fits[("backlash",)].cost < armature.cost or inertia <= 0:
            return
        points = [{"width": part * span, "drive_inertia": inertia} for part in _SLACKS]
        starts = [joined(theory, armature, {"backlash": point}) for point in points]
        tried = [fitted(theory, self.train, theta, armature.starts, _SCREEN) for theta in starts]
        best = min(tried, key=lambda fit: fit.cost)
        self._keep(fitted(theory, self.train, best.theta, best.starts))

    def _apart(self, own: list[Guess]) -> list[Guess]:
        """The best first guesses of one effect that differ: neighbours on the grid lead to the same fit."""
        kept: list[Guess] = []
        for guess in own:
            if len(kept) < self.problem.fit.starts and not any(self._alike(guess, other) for other in kept):
                kept.append(guess)
        return kept

    def _alike(self, first: Guess, second: Guess) -> bool:
        """Whether all but the sizes of two guesses are about the same: places within a tenth of the way moved through,
        widths and speeds within a factor of 2."""
        reach = 0.1 * (self.problem.q_high - self.problem.q_low)
        own = [r for r in Theory(self.problem, (first.name,)).ranges() if r.owner == first.name]
        for r in own[1:]:
            a, b = first.point[r.name], second.point[r.name]
            if abs(a - b) > reach if r.lower < 0 else max(a, b) > 2 * min(a, b):
                return False
        return True

    def _rough(self, name: str, own: list[Guess], cut: tuple[FitRun, ...], starts: Starts) -> Fit:
        """The effect on the stretches, from the best of its first guesses."""
        theory, base = Theory(self.problem, (name,)), self.base()
        tried = [fitted(theory, cut, joined(theory, base, {name: guess.point}), starts, 4) for guess in own]
        return min(tried, key=lambda fit: fit.cost)

    def _keep_from(self, name: str, plainer: Fit) -> None:
        """A general effect fits no worse than the plainer one that it may become, where their parameters agree."""
        fit = self.fits[(name,)]
        shared = {
            r.name: float(x) for r, x in zip(plainer.theory.ranges(), plainer.theta, strict=True) if r.owner != "asset"
        }
        if fit.cost > plainer.cost and set(shared) <= set(EFFECTS[name].parameters()):
            point = {**off(self.problem, name), **shared}
            theta = joined(fit.theory, plainer, {name: point})
            self._keep(fitted(fit.theory, self.train, theta, plainer.starts))

    def larger(self, parents: list[Fit]) -> list[Fit]:
        """The most promising sets of one effect more than some of `parents`, fitted; of every parent's at least one:
        the best single effect is often none of a pair."""
        rough: dict[tuple[str, ...], tuple[float, Fit, Guess]] = {}
        for parent in parents:
            cut = self._cut(parent)
            at = placed(parent, cut) if cut is not self.train else parent
            scale = parent.cost / max(at.cost, 1e-9)  # costs of stretches and of whole runs, made alike
            for guess in guesses(at, cut, self.names):
                names = tuple(sorted((*parent.theory.names, guess.name)))
                cost = guess.cost * scale
                if names not in self.fits and (names not in rough or cost < rough[names][0]):
                    rough[names] = (cost, parent, guess)
        order = sorted(rough.values(), key=lambda entry: entry[0])
        firsts = [next(e for e in order if e[1] is parent) for parent in parents if any(e[1] is parent for e in order)]
        best = (firsts + [e for e in order if not any(e is f for f in firsts)])[: self.settings.shortlist]
        return self._resettled([self._started(parent, guess) for _, parent, guess in best])

    def _resettled(self, level: list[Fit]) -> list[Fit]:
        """The best ones with a new look at their starts; all of them sorted."""
        level = sorted(level, key=lambda fit: fit.cost)
        for fit in level[: self.settings.parents]:
            self.fits[fit.theory.names] = resettled(fit, self.train)
        return sorted((self.fits[fit.theory.names] for fit in level), key=lambda fit: fit.cost)

    def _started(self, parent: Fit, guess: Guess) -> Fit:
        """The set of `parent` and the guessed effect, from the parent's fit."""
        theory = Theory(self.problem, tuple(sorted((*parent.theory.names, guess.name))))
        points = [guess.point]
        alone = self.fits.get((guess.name,))
        if alone is not None:
            values = zip(alone.theory.ranges(), alone.theta, strict=True)
            points.append({r.name: float(x) for r, x in values if r.owner == guess.name})
        tried = [
            fitted(theory, self.train, joined(theory, parent, {guess.name: point}), parent.starts, _SCREEN)
            for point in points
        ]
        best = min(tried, key=lambda fit: fit.cost)
        return self._keep(fitted(theory, self.train, best.theta, best.starts))

    def of(self, names: tuple[str, ...]) -> Fit:
        """The fit of this very set, started from its best subset."""
        if names not in self.fits:
            smaller = [self.fits[s] for n in names if (s := tuple(m for m in names if m != n)) in self.fits]
            parent = min(smaller, key=lambda fit: fit.cost) if smaller else self.base()
            new = tuple(n for n in names if n not in parent.theory.names)
            if len(new) > 1:
                parent = self.of(names[:-1])
                new = names[-1:]
            cut = self._cut(parent)
            at = placed(parent, cut) if cut is not self.train else parent
            self._started(parent, guesses(at, cut, new)[0])
        return self.fits[names]

    def twins(self, fit: Fit) -> list[Fit]:
        """The sets with an effect's twin in its place, started where both do the same under the usual load."""
        found = []
        for name in fit.theory.names:
            size, twin = TWINS.get(name, ("", ""))
            if twin not in self.names or twin in fit.theory.names:
                continue
            names = tuple(sorted({*fit.theory.names, twin} - {name}))
            value = getattr(next(e for e in fit.effects if e.name == name), size)
            usual = value * self.problem.load if name == "load_friction" else value / self.problem.load
            theory = Theory(self.problem, names)
            start = joined(theory, fit, {twin: {TWINS[twin][0]: usual}})
            found.append(self._keep(fitted(theory, self.train, start, fit.starts)))
        return found

    def without(self, fit: Fit, name: str) -> Fit:
        """The set of `fit` without one effect, started from `fit`."""
        theory = Theory(self.problem, tuple(n for n in fit.theory.names if n != name))
        return self._keep(fitted(theory, self.train, joined(theory, fit, {}), fit.starts))

    def _keep(self, fit: Fit) -> Fit:
        """Remember a fit, after making sure that it is no worse than any of a smaller set."""
        for name in fit.theory.names:
            smaller = self.fits.get(tuple(n for n in fit.theory.names if n != name))
            if smaller is not None and smaller.cost < fit.cost - 1e-3 - 1e-6 * fit.cost:
                theta = joined(fit.theory, smaller, {name: off(self.problem, name)})
                again = fitted(fit.theory, self.train, theta, smaller.starts)
                fit = min(fit, again, key=lambda f: f.cost)
        kept = self.fits.get(fit.theory.names)
        self.fits[fit.theory.names] = fit if kept is None or fit.cost < kept.cost else kept
        return self.fits[fit.theory.names]

    def _cut(self, fit: Fit) -> tuple[FitRun, ...]:
        """The runs as they are where a first-order look may span them, else in stretches."""
        readings = sum(len(run.q) for run in self.train)
        near = fit.rss < _FAR**2 * readings
        return self.train if near else pieces(self.train, _CROSSINGS * self.problem.crossing_s)


def relaxed(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The same effects, their sizes free to depart from their formulas within the form tolerance."""
    theory = Theory(fit.theory.problem, fit.theory.names, relaxed=True)
    return fitted(theory, runs, joined(theory, fit, {}), fit.starts, iterations=8)
