"""Measured poses of the moving part under a joint with kinematic effects: model, derivatives, fit.

The motion of the moving part from joint position zero, in the frame of the joint's parent link, is X(q, t) J(q) B
noise, with the ideal joint J, the effects' displacements X, and a small constant B, the error of the tracker's part
frame. Noise acts in the part's frame. The position q is free in every frame, so only deviations from the joint's own
motion are geometry. Twists are (v, w), translation first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.effects import EFFECTS, perpendiculars
from freeart21.effects.base import Effect
from freeart21.joint import Joint
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array

STATIC: dict[str, int] = {n: len(c.parameters()) for n, c in EFFECTS.items() if c.acts == "pose" and not c.time_driven}
"""Effects that depend on position alone, with their number of coordinates; first one outermost."""
ROCK = next(name for name, cls in EFFECTS.items() if cls.time_driven)
"""The effect that oscillates in time."""
_STEP = 1e-5  # step of central differences, per scale
_SCALES = {name: next(iter(EFFECTS[name].parameters().values())).scale for name in STATIC}
_PARTS = (1.0, 0.5, 0.25, 0.125)  # step halving
_DONE = 1e-3  # convergence: largest step, per scale
_MOST_REGISTRATION = 3.0  # standard deviations: bound
_WIDE = 100.0  # prior standard deviation, per scale, of unexcited coordinates


@dataclass(frozen=True)
class Track:
    """Poses of one run, frames in which the part was seen."""

    name: str
    times_s: Array
    """(n,) s, rising."""
    motions: Array
    """(n, 4, 4) motion of the moving part from joint position zero, in the parent link's frame, metres."""


@dataclass(frozen=True)
class Rocking:
    """A steady oscillation of the part across the axis (ROCK), with a phase per run."""

    frequency: float
    """Hz."""
    coefficients: Array
    """(runs, 2, 2) rad: about the two directions across the axis, of sine and cosine."""

    @property
    def direction(self) -> Array:
        """(2,) main direction across the axis."""
        return np.asarray(np.linalg.svd(np.concatenate(list(self.coefficients), -1))[0][:, 0])

    def in_one_direction(self) -> Rocking:
        """The same with all runs oscillating about that direction."""
        u = self.direction
        return replace(self, coefficients=u[:, None] * (u @ self.coefficients)[:, None, :])

    def angles(self, run: NDArray[np.int64], times_s: Array, ahead: bool = False) -> Array:
        """(n, 2) rad at times (n,) of runs (n,); `ahead` by a quarter period is the derivative by the phase."""
        waves = sine_cosine(self.frequency, times_s)
        return np.einsum("nab,nb->na", self.coefficients[run], waves[:, ::-1] * [1.0, -1.0] if ahead else waves)


@dataclass(frozen=True)
class Geometry:
    """One point of the model: coordinates of the static effects, registration, rocking."""

    names: tuple[str, ...]
    """Static effects, in the order of STATIC."""
    values: Array
    """(k,) coordinates: parameters, or length * (cos, sin)(angle) of `polar` effects."""
    registration: Array
    """(6,) twist of B."""
    rock: Rocking | None = None

    def effects(self) -> tuple[Effect, ...]:
        """The static effects as the library has them, outermost first."""
        return tuple(effect_of(name, values) for name, values in self.split())

    def split(self) -> list[tuple[str, Array]]:
        """Name and coordinates of every static effect."""
        ends = np.cumsum([STATIC[name] for name in self.names])[:-1]
        return list(zip(self.names, np.split(self.values, ends), strict=True)) if self.names else []

    @classmethod
    def zero(cls, names: tuple[str, ...]) -> Geometry:
        """No deviation of these effects."""
        ordered = tuple(name for name in STATIC if name in names)
        return cls(ordered, np.zeros(sum(STATIC[name] for name in ordered)), np.zeros(6))


def effect_of(name: str, values: Array) -> Effect:
    """A static effect from its coordinates, clipped to its bounds."""
    values = np.clip(values, *_coordinate_bounds(name))
    if EFFECTS[name].polar:
        values = np.array([min(np.hypot(*values), _coordinate_bounds(name)[1][0]), np.arctan2(values[1], values[0])])
    return EFFECTS[name](*values.tolist())


def _coordinate_bounds(name: str) -> tuple[Array, Array]:
    """(k,) lower and upper bounds of the coordinates of a static effect."""
    specs = list(EFFECTS[name].parameters().values())
    if EFFECTS[name].polar:
        return np.full(2, -specs[0].upper), np.full(2, specs[0].upper)
    return np.array([p.lower for p in specs]), np.array([p.upper for p in specs])


def coordinate_scales(names: tuple[str, ...]) -> Array:
    """(k,) typical size of every coordinate."""
    return np.concatenate([np.full(STATIC[name], _SCALES[name]) for name in names] or [np.zeros(0)])


@dataclass(frozen=True)
class Weighting:
    """Noise of a pose: covariance in the part's frame, and correlation over time."""

    covariance: Array
    """(6, 6) of the twist (m, rad)."""
    correlation: float = 1.0
    """Frames per independent frame, 1 or more."""
    registration_std: tuple[float, float] = (1e-3, 1e-3)
    """Standard deviation of the tracker's part frame, m and rad."""

    @cached_property
    def whitening(self) -> Array:
        """(6, 6) L with L covariance L^T = 1."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    @property
    def registration_precision(self) -> Array:
        """(6,) of the registration, times `correlation`."""
        return self.correlation / np.repeat(np.square(self.registration_std), 3)

    def priors(self, names: tuple[str, ...]) -> Array:
        """(k + 6,) precisions about zero: wide for the coordinates, the tracker's for the registration."""
        return np.concatenate([(_WIDE * coordinate_scales(names)) ** -2.0, self.registration_precision])

    def bounds(self, names: tuple[str, ...]) -> tuple[Array, Array]:
        """(k + 6,) lower and upper bounds of coordinates and registration."""
        box = _MOST_REGISTRATION * np.repeat(self.registration_std, 3)
        low, high = zip(*(_coordinate_bounds(name) for name in names), (-box, box), strict=True)
        return np.concatenate(low), np.concatenate(high)


@dataclass(frozen=True)
class Linear:
    """The model linearised about one point, frames of all runs in a row, whitened, with the joint's own motion
    projected out.

    residual = data - columns @ (coordinates, registration) - rocks @ coefficients.
    """

    data: Array
    """(n, 6)."""
    columns: Array
    """(n, 6, k + 6)."""
    rocks: Array
    """(n, 6, 2) of rotations about the two directions across the axis."""
    run: NDArray[np.int64]
    """(n,) number of the run."""
    times_s: Array
    """(n,)."""
    q: Array
    """(n,)."""
    parent_to_whitened: Array
    """(n, 6, 6) from twists in the parent's frame, acting outermost."""

    def residual(self, point: Geometry) -> Array:
        """(n, 6) residual of the static effects and the registration of a point."""
        return self.data - self.columns @ np.concatenate([point.values, point.registration])


def first_positions(joint: Joint, motions: Array) -> Array:
    """(n,) joint positions: rotation about the joint's axis, or shift along it."""
    if joint.type == "prismatic":
        return np.asarray((motions[:, :3, 3]) @ joint.axis)
    q = se3.wxyz(motions)
    return np.unwrap(2 * np.arctan2(q[:, 1:] @ joint.axis, q[:, 0]))


class PoseModel:
    """The model of some runs; `linear` and `fit` take all frames of all runs at once."""

    def __init__(self, tracks: tuple[Track, ...], mechanics: JointMechanics):
        self.tracks, self.mechanics, self.joint = tracks, mechanics, mechanics.joint
        self.run = np.repeat(np.arange(len(tracks)), [len(t.times_s) for t in tracks])
        self.times_s = np.concatenate([t.times_s for t in tracks])
        self.motions = np.concatenate([t.motions for t in tracks])
        self.q0 = np.concatenate([first_positions(self.joint, t.motions) for t in tracks])
        first, second = perpendiculars(self.joint.axis)
        self.rock_screws = np.stack([replace(self.joint, type="revolute", axis=axis).screw for axis in (first, second)])

    def poses(self, point: Geometry, q: Array) -> Array:
        """(n, 4, 4) modelled motions at positions `q` (n,)."""
        X = self._rocking_transform(point)
        for effect in point.effects():
            X = X @ effect.displacement(q, self.times_s, self.mechanics)
        return X @ self.joint.transform(q) @ se3.exp_se3(point.registration)

    def residuals(self, point: Geometry, q: Array) -> Array:
        """(n, 6) twists from the model to the measurement, in the part's frame."""
        return se3.log_se3(se3.inverse(self.poses(point, q)) @ self.motions)

    def positions(self, point: Geometry, weighting: Weighting, q: Array | None = None, rounds: int = 3) -> Array:
        """(n,) the position in every frame with the least residual; steps that increase it are rejected."""
        q = self.q0 if q is None else q
        along = self._tangents(point, q) @ weighting.whitening.T
        y = self.residuals(point, q) @ weighting.whitening.T
        for _ in range(rounds):
            moved = q + (along * y).sum(-1) / (along * along).sum(-1)
            residual = self.residuals(point, moved) @ weighting.whitening.T
            less = (residual**2).sum(-1) < (y**2).sum(-1)
            q, y = np.where(less, moved, q), np.where(less[:, None], residual, y)
        return q

    def linear(self, point: Geometry, q: Array, weighting: Weighting) -> Linear:
        """The model about `point` and `q`, in absolute coordinates."""
        L = weighting.whitening
        M = self.poses(point, q)
        y = se3.log_se3(se3.inverse(M) @ self.motions)
        to_part = se3.adjoint(se3.inverse(M))
        columns = np.concatenate(
            [to_part @ self._effect_twists(point, q), np.broadcast_to(np.eye(6), (len(q), 6, 6))], -1
        )
        along = self._tangents(point, q) @ L.T
        along = along / np.linalg.norm(along, axis=-1, keepdims=True)
        project = (np.eye(6) - along[:, :, None] * along[:, None, :]) @ L
        columns = project @ columns
        rocks = project @ (to_part @ self.rock_screws.T)
        data = (project @ y[..., None])[..., 0] + columns @ np.concatenate([point.values, point.registration])
        lin = Linear(data, columns, rocks, self.run, self.times_s, q, project @ to_part)
        return lin if point.rock is None else replace(lin, data=data + self.rocking(lin, point))

    def fit(self, point: Geometry, weighting: Weighting, rounds: int = 6) -> tuple[Geometry, Array]:
        """Coordinates and registration (rocking fixed) of least weighted squares, by Gauss-Newton with step halving;
        positions (n,)."""
        q = self.positions(point, weighting)
        prior = weighting.priors(point.names)
        k = len(point.values)

        def squares(at: Geometry, q: Array) -> float:
            residual = self.residuals(at, q) @ weighting.whitening.T
            size = np.concatenate([at.values, at.registration])
            return float((residual**2).sum(-1).sum() + prior @ size**2)

        least = squares(point, q)
        for _ in range(rounds):
            lin = self.linear(point, q, weighting)
            A, b = normal_equations(lin.columns, lin.data - self.rocking(lin, point))
            found = solve_bounded(A + np.diag(prior), b, *weighting.bounds(point.names))
            step = found - np.concatenate([point.values, point.registration])
            for part in _PARTS:
                here = part * step
                moved = replace(point, values=point.values + here[:k], registration=point.registration + here[k:])
                q_moved = self.positions(moved, weighting, q, rounds=2)
                now = squares(moved, q_moved)
                if now <= least:
                    break
            else:
                break
            point, q, least = moved, q_moved, now
            if np.abs(here[:k] / coordinate_scales(point.names)).max(initial=0.0) < _DONE:
                break
        return point, q

    def rocking(self, lin: Linear, point: Geometry) -> Array:
        """(n, 6) contribution of rocking to `lin`'s data."""
        if point.rock is None:
            return np.zeros((len(self.times_s), 6))
        return np.asarray((lin.rocks @ point.rock.angles(self.run, self.times_s)[..., None])[..., 0])

    def _rocking_transform(self, point: Geometry) -> Array:
        if point.rock is None:
            return np.broadcast_to(np.eye(4), (len(self.times_s), 4, 4))
        return se3.exp_se3(point.rock.angles(self.run, self.times_s) @ self.rock_screws)

    def _tangents(self, point: Geometry, q: Array) -> Array:
        """(n, 6) twist of the part, in its frame, per unit of q."""
        h = 1e-4
        return se3.log_se3(se3.inverse(self.poses(point, q - h)) @ self.poses(point, q + h)) / (2 * h)

    def _effect_twists(self, point: Geometry, q: Array) -> Array:
        """(n, 6, k) derivative of the displacement by every coordinate, as outermost twists in the parent's frame."""
        before = self._rocking_transform(point)
        columns = []
        for name, values in point.split():
            to_outer = se3.adjoint(before)
            h = _STEP * _SCALES[name]
            low, high = _coordinate_bounds(name)
            base = np.clip(values, low + h, high - h)  # one-sided at a bound
            for i in range(len(values)):
                ends = [
                    effect_of(name, base + s * h * np.eye(len(values))[i]).displacement(q, self.times_s, self.mechanics)
                    for s in (-1, 1)
                ]
                columns.append((to_outer @ (se3.log_se3(ends[1] @ se3.inverse(ends[0])) / (2 * h))[..., None])[..., 0])
            before = before @ effect_of(name, values).displacement(q, self.times_s, self.mechanics)
        return np.stack(columns, -1) if columns else np.zeros((len(q), 6, 0))


def solve_bounded(A: Array, b: Array, low: Array, high: Array) -> Array:
    """(k,) minimiser x of x A x / 2 - b x within bounds, by clamping violated ones."""
    x = np.asarray(np.linalg.solve(A, b), float)
    held = np.zeros(len(b), bool)
    for _ in range(len(b)):
        out = ~held & ((x < low) | (x > high))
        if not out.any():
            break
        held |= out
        x[held] = np.clip(x, low, high)[held]
        free = ~held
        if free.any():
            x[free] = np.linalg.solve(A[np.ix_(free, free)], b[free] - A[np.ix_(free, held)] @ x[held])
    return np.clip(x, low, high)


def normal_equations(columns: Array, data: Array) -> tuple[Array, Array]:
    """(k, k) and (k,) of least squares; columns (n, 6, k), data (n, 6)."""
    flat = columns.reshape(-1, columns.shape[-1])
    return flat.T @ flat, flat.T @ data.reshape(-1)


def sine_cosine(frequency: float, times_s: Array) -> Array:
    """(n, 2) sine and cosine."""
    angle = 2 * np.pi * frequency * times_s
    return np.stack([np.sin(angle), np.cos(angle)], -1)


def rocking_effect(rock: Rocking) -> Effect:
    """The library's effect: amplitude over all runs, phase of the first run."""
    return EFFECTS[ROCK].from_rocking(rock.frequency, rock.coefficients)
