"""Geometry from part poses alone, before any dynamics: where the joint's motion is not the asset's ideal joint.

The measured motion is split into its part along the joint (position over time: dynamics and timing) and what is left of
it (geometry). The latter is explained by axis_tilt, pivot_offset, screw_pitch, sag, eccentricity and wobble, alone or
up to three together; runs that were not fitted decide, and what cannot be told apart is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects import EFFECTS
from freeart21.errors import FreeArtError
from freeart21.measured import Measured
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array
from simgap.geometry import pose_search
from simgap.geometry.finding import GeometryVerdict, KinematicsFinding, KinematicsSettings
from simgap.geometry.placing import place
from simgap.geometry.pose_model import (
    ROCK,
    STATIC,
    Geometry,
    Linear,
    PoseModel,
    Rock,
    Track,
    Weighting,
    bounds,
    effect_of,
    named_effects,
    priors,
)
from simgap.geometry.pose_search import Losses
from simgap.geometry.track_geometry import track_geometry
from simgap.measure.swings import unit_numbers

_NOISELESS = np.repeat([1e-12, 1e-12], 3)  # m^2 and rad^2: least noise of any pose
_STRAYS = 5.0
"""Floors off its joint at which a part that stands still along it has moved otherwise."""
_ASTRAY = 1.0
"""rad across the joint's axis by which no joint turns its part, crooked as it may be."""
_ONE_ERROR = 0.16  # chance of more than one standard error upwards


@dataclass(frozen=True)
class _Problem:
    """Training runs thinned out for the search."""

    model: PoseModel
    units: NDArray[np.int64]
    folds: NDArray[np.int64]
    rate_hz: float


def find_geometry(
    tracks: Sequence[Track],
    mechanics: JointMechanics,
    settings: KinematicsSettings | None = None,
    held_out: Sequence[bool] | None = None,
) -> KinematicsFinding:
    """The kinematic effects in runs of part poses.

    Args:
        tracks: runs; their motions are those from joint position zero, in the frame of the joint's parent link.
        mechanics: the asset's joint and masses, in that frame.
        settings: None takes the defaults.
        held_out: for each run whether it may only be used to measure the gap; None holds out none, and cross-validation
            alone decides.

    Raises FreeArtError when there is no run to fit, a run has fewer than 10 poses, or turns the part as no such joint
    does.
    """
    settings = settings or KinematicsSettings()
    flags = [False] * len(tracks) if held_out is None else list(held_out)
    train = tuple(t for t, out in zip(tracks, flags, strict=True) if not out)
    if not train:
        said = ", ".join(t.name for t in tracks)
        raise FreeArtError(f"all runs of poses ({said}) are held out, expected at least one to fit to")
    for t in tracks:
        if len(t.times_s) < 10:
            raise FreeArtError(f"run '{t.name}' has {len(t.times_s)} poses, expected 10 or more")
        turned = float(np.quantile(_swing(t.motions, mechanics.joint.axis), 0.9))
        if turned > _ASTRAY:
            raise FreeArtError(
                f"run '{t.name}' turns the part by {turned:.3g} rad across the axis of joint '{mechanics.joint.name}', "
                f"expected less than {_ASTRAY:g}: is this the joint that was moved, are asset and poses in one frame?"
            )
    problem = _problem(train, mechanics, settings)
    q = problem.model.q0
    least = settings.least_span[0 if mechanics.joint.type == "revolute" else 1]
    weighting = _first_weighting(problem.model, settings)
    if max(float(np.ptp(q[problem.model.run == r])) for r in range(len(train))) < least:
        return _nothing(tracks, flags, mechanics, weighting)
    names = tuple(n for n in STATIC if mechanics.joint.type in _class_types(n) and n not in settings.without)
    weighting, full, lin = _full_fit(problem, names, weighting)
    left = pose_search.free_residual(lin, priors((), weighting))
    frequencies = pose_search.rocking_frequency(lin, left, problem.folds, problem.rate_hz)
    candidates = (
        *names,
        *((ROCK,) if all(f is not None for f in frequencies) and ROCK not in settings.without else ()),
    )
    losses = pose_search.held_out_losses(
        lin,
        names,
        priors(names, weighting),
        bounds(names, weighting),
        problem.units,
        pose_search.subsets_of(candidates, settings.most_effects),
        frequencies,
        problem.folds,
    )
    chosen = _chosen(losses)
    chosen, p_values = _pruned(losses, chosen, settings)
    point = _fitted(problem, chosen, weighting, full, frequencies, lin)
    if point.rock is not None:  # what rocked was taken for noise so far
        weighting = _weighting_over(problem.model, point, weighting)
    return _finding(tracks, flags, mechanics, weighting, problem, losses, chosen, p_values, point, settings)


def _swing(motions: Array, axis: Array) -> Array:
    """(n,) rad of the motions (n, 4, 4) when their turn about the axis (3,) is left out."""
    q = se3.wxyz(motions)
    return 2 * np.arccos(np.clip(np.hypot(q[:, 0], q[:, 1:] @ axis), 0.0, 1.0))


def _class_types(name: str) -> tuple[str, ...]:
    return type(effect_of(name, np.zeros(STATIC[name]))).joint_types


def _problem(train: tuple[Track, ...], mechanics: JointMechanics, settings: KinematicsSettings) -> _Problem:
    every = max(1, -(-sum(len(t.times_s) for t in train) // settings.most_frames))
    thin = tuple(Track(t.name, t.times_s[::every], t.motions[::every]) for t in train)
    model = PoseModel(thin, mechanics)
    span = float(np.ptp(model.q0)) or 1.0
    frames = len(model.run)
    units = unit_numbers(model.q0, model.run, 0.05 * span, longest=max(20, frames // 24))
    if units.max() < 3:  # a short sweep that never turns back
        units = np.arange(frames) * 4 // frames
    folds = model.run if len(train) >= 3 else _pieces(units, 4)
    rate = 1 / float(np.median(np.concatenate([np.diff(t.times_s) for t in thin])))
    return _Problem(model, units, folds, rate)


def _pieces(units: NDArray[np.int64], least: int) -> NDArray[np.int64]:
    """Folds of whole units, in order, where runs are too few to leave one out."""
    count = int(units.max()) + 1
    return (units * min(least, count)) // count


def _first_weighting(model: PoseModel, settings: KinematicsSettings) -> Weighting:
    """Noise by second differences of the residual to the ideal joint: motion has next to none.

    Along the joint there is no residual, whatever the noise: it is taken to be as across it.
    """
    y = model.residuals(Geometry.zero(()), model.q0)
    same = model.run[2:] == model.run[:-2]
    bends = (y[2:] - 2 * y[1:-1] + y[:-2])[same]
    covariance = bends.T @ bends / (6 * max(len(bends), 1)) + np.diag(_NOISELESS)
    own = slice(3, 6) if model.joint.type == "revolute" else slice(0, 3)
    covariance += 0.5 * np.trace(covariance[own, own]) * np.outer(model.joint.screw, model.joint.screw)
    shrunk = 0.9 * covariance + 0.1 * np.diag(np.diag(covariance))
    return Weighting(shrunk, 1.0, settings.registration_std)


def _full_fit(problem: _Problem, names: tuple[str, ...], weighting: Weighting) -> tuple[Weighting, Geometry, Linear]:
    """The fit with all static effects, with the noise that is left over it; the model about it."""
    model, point = problem.model, Geometry.zero(names)
    for _ in range(2):
        point, q = model.fit(point, weighting)
        weighting = _weighting_over(model, point, weighting)
    return weighting, point, model.linear(point, q, weighting)


def _weighting_over(model: PoseModel, point: Geometry, weighting: Weighting) -> Weighting:
    """Noise by what neither this point of the model nor any function of the joint's position explains."""
    lin = model.linear(point, model.positions(point, weighting), weighting)
    left = pose_search.free_residual(lin, priors((), weighting), model.rocking(lin, point))
    return replace(weighting, covariance=_noise(model, left, weighting), correlation=_correlation(left, model.run))


def _noise(model: PoseModel, left: Array, weighting: Weighting) -> Array:
    """(6, 6) covariance of the noise, scaled and shaped by what is `left` (n, 6): its part along the joint is not seen
    there, and taken to be as the rest."""
    L = weighting.whitening
    scale = float((left**2).sum(-1).mean()) / 5.0
    seen = np.linalg.inv(L) @ left.T
    shape = np.cov(seen) + 1e-3 * scale * weighting.covariance
    along = model.joint.screw / np.linalg.norm(L @ model.joint.screw)  # of unit length once whitened
    return shape + scale * np.outer(along, along) + np.diag(_NOISELESS)


def _correlation(left: Array, run: NDArray[np.int64]) -> float:
    """Frames that count as one: 1 + 2 sum of the autocorrelations, down to the first below 0.1."""
    centred = left - left.mean(0)
    total, power = 1.0, float((centred**2).sum()) or 1.0
    for lag in range(1, min(len(left) // 4, 400)):
        same = run[lag:] == run[:-lag]
        r = float((centred[lag:] * centred[:-lag])[same].sum()) / power
        if r < 0.1:
            break
        total += 2 * r
    return total


def _chosen(losses: Losses) -> tuple[str, ...]:
    """The subset of least held-out loss, or a smaller one that is not worse by more than one standard error."""
    best = min(losses.subsets, key=losses.mean)
    for subset in sorted(losses.subsets, key=lambda s: (len(s), losses.mean(s))):
        if len(subset) >= len(best):
            break
        if losses.gain(losses.of(subset), losses.of(best))[1] > _ONE_ERROR:
            return subset
    return best


def _pruned(
    losses: Losses, chosen: tuple[str, ...], settings: KinematicsSettings
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """The subset without members whose absence costs too little or is not significant; p-values of the others."""
    tests = len(losses.subsets) - 1  # what was looked at before this was chosen
    while chosen:
        whole = losses.mean((ROCK,) if ROCK in chosen else ()) - losses.mean(chosen)
        drops = []
        for name in chosen:
            fewer = tuple(n for n in chosen if n != name)
            gain, p = losses.gain(losses.of(fewer), losses.of(chosen))
            drops.append((gain, min(1.0, p * tests), name))
        least = settings.least_share * losses.mean(chosen)
        formed = max(least, settings.form**2 * whole)
        if all(gain >= (least if n == ROCK else formed) and p <= settings.level for gain, p, n in drops):
            return chosen, tuple(p for _, p, _ in drops)
        weakest = min(drops, key=lambda d: d[0])[2]
        chosen = tuple(n for n in chosen if n != weakest)
    return chosen, ()


def _fitted(
    problem: _Problem,
    chosen: tuple[str, ...],
    weighting: Weighting,
    full: Geometry,
    frequencies: Sequence[float | None],
    lin: Linear,
) -> Geometry:
    """The chosen effects fitted to all training runs, without linearisation."""
    static = tuple(n for n in chosen if n != ROCK)
    start = Geometry.zero(static)
    of_full = dict(full.split())
    values = np.concatenate([of_full[n] for n in start.names] or [np.zeros(0)])
    point, q = problem.model.fit(replace(start, values=values), weighting, rounds=12)
    if ROCK not in chosen:
        return point
    frequency = float(np.median([f for f in frequencies if f is not None]))
    for _ in range(4):
        now = problem.model.linear(replace(point, rock=None), q, weighting)
        left = now.data - now.columns @ np.concatenate([point.values, point.registration])
        frequency = _refined(now, left, frequency)
        rock = Rock(frequency, _one_direction(pose_search.rock_coefficients(now, left, frequency)))
        point, q = problem.model.fit(replace(point, rock=rock), weighting, rounds=4)
    return point


def _refined(lin: Linear, left: Array, frequency: float) -> float:
    """The frequency near this one that fits best."""
    from scipy.optimize import minimize_scalar

    reach = 0.5 / max(float(np.ptp(lin.times_s[lin.run == r])) for r in np.unique(lin.run))

    def loss(f: float) -> float:
        waves = pose_search.waves_at(f, lin.times_s)
        c = pose_search.rock_coefficients(lin, left, f)[lin.run]
        return float(((left - np.einsum("nij,njb,nb->ni", lin.rocks, c, waves)) ** 2).sum())

    return float(minimize_scalar(loss, bounds=(max(frequency - reach, 1e-6), frequency + reach), method="bounded").x)


def _one_direction(coefficients: Array) -> Array:
    """Coefficients (runs, 2, 2) with every run rocking about one and the same direction."""
    stacked = np.concatenate(list(coefficients), -1)
    u = np.linalg.svd(stacked)[0][:, 0]
    return np.asarray(u[:, None] * (u @ coefficients)[:, None, :])


def _finding(
    tracks: Sequence[Track],
    flags: list[bool],
    mechanics: JointMechanics,
    weighting: Weighting,
    problem: _Problem,
    losses: Losses,
    chosen: tuple[str, ...],
    p_values: tuple[float, ...],
    point: Geometry,
    settings: KinematicsSettings,
) -> KinematicsFinding:
    here = losses.of(chosen)
    noise = min(float(np.average(losses.ceiling, weights=losses.weights)), losses.mean(chosen))
    _, p_more = losses.gain(here, losses.ceiling)
    remainder = float(np.sqrt(max(losses.mean(chosen) / noise - 1, 0.0)))
    more = remainder > settings.unexplained_floors and p_more <= settings.level
    gaps = [np.sqrt(losses.mean(s) / noise) for s in ((), chosen)]
    closed = (gaps[0] - gaps[1]) / max(gaps[0] - 1.0, 1e-9)
    rivals = _rivals(losses, chosen, settings)
    plain, _ = problem.model.fit(Geometry.zero(()), weighting)
    if more and closed < settings.closed and chosen and gaps[0] ** 2 - 1 < settings.tracker_floors**2:
        return _finding(tracks, flags, mechanics, weighting, problem, losses, (), (), plain, settings)
    if more and (closed < settings.closed if chosen else remainder > settings.tracker_floors):
        verdict: GeometryVerdict = "unexplained"
    elif not chosen:
        verdict = "no_gap"
    else:
        verdict = "ambiguous" if rivals else "named"
    effects = named_effects(point)
    order = {name: p for name, p in zip(chosen, p_values, strict=True)}
    ends: list[tuple[dict[str, float], dict[str, float]]] = []
    if effects:
        from simgap.geometry.pose_intervals import intervals

        q = problem.model.positions(point, weighting)
        ends = intervals(problem.model.linear(point, q, weighting), point, weighting, problem.units)
    ranking = [
        (s, losses.mean(s) / noise, losses.gain(losses.of(()), losses.of(s))[1] if s else 1.0) for s in losses.subsets
    ]
    return KinematicsFinding(
        verdict,
        effects,
        tuple(low for low, _ in ends),
        tuple(high for _, high in ends),
        rivals,
        tuple(track_geometry(t, out, mechanics, weighting, plain, point) for t, out in zip(tracks, flags, strict=True)),
        tuple(sorted(ranking, key=lambda row: row[1])),
        remainder,
        _experiment(rivals) if rivals else _UNNAMED if verdict == "unexplained" else None,
        (plain.registration, point.registration),
        tuple(order[e.name] for e in effects),
    )


def _nothing(
    tracks: Sequence[Track], flags: list[bool], mechanics: JointMechanics, weighting: Weighting
) -> KinematicsFinding:
    plain = Geometry.zero(())
    seen = tuple(
        track_geometry(t, out, mechanics, weighting, plain, plain) for t, out in zip(tracks, flags, strict=True)
    )
    if any(t.gap_before > _STRAYS * t.floor for t in seen):
        said = "Make sure that this is the joint that was moved, and that asset and poses have one frame."
        return KinematicsFinding("unexplained", (), (), (), (), seen, (), 0.0, said)
    said = "Move the joint through more of its range: it stood all but still."
    return KinematicsFinding("not_excited", (), (), (), (), seen, (), 0.0, said)


def _rivals(losses: Losses, chosen: tuple[str, ...], settings: KinematicsSettings) -> tuple[tuple[str, ...], ...]:
    """The chosen set, then others of no more names that predict held-out runs as well; none without such."""
    if not chosen:
        return ()
    found = []
    for subset in losses.subsets:
        if subset in ((), chosen) or len(subset) > len(chosen) or set(subset) < set(chosen):
            continue
        gain, p = losses.gain(losses.of(subset), losses.of(chosen))
        if p > 0.05 or gain < 0.5 * settings.least_share * losses.mean(chosen):
            found.append((gain, subset))
    return (chosen, *(subset for _, subset in sorted(found))) if found else ()


_UNNAMED = (
    "Move the joint slowly through its whole range, both ways, and once with the part held still, all in the picture."
)
"""What to record of a displacement that has no name: whether it goes with position, direction or time."""


def _experiment(rivals: tuple[tuple[str, ...], ...]) -> str:
    """What to record next so that the rivals part."""
    own = (EFFECTS[name].experiment for name in sorted({n for r in rivals for n in r}))
    return next(filter(None, own), "Record the joint over more of its range: only there do these causes part.")


def find_geometry_of(
    asset: Asset, measured: Measured, settings: KinematicsSettings | None = None
) -> KinematicsFinding | None:
    """The geometry of an asset's joint in the pose runs of a measured set; None when it has none."""
    posed = [run for run in measured.runs if run.poses is not None]
    if not posed:
        return None
    placed = place(asset, measured.gravity)
    tracks = [placed.track(run) for run in posed]
    return find_geometry(tracks, placed.mechanics, settings, [bool(run.held_out) for run in posed])
