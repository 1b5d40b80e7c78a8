"""Geometry from part poses alone, before any dynamics: deviations of the joint from the asset's ideal one.

The measured motion is split into motion along the joint (position over time, for dynamics and timing) and the rest
(geometry). The latter is explained by axis_tilt, pivot_offset, screw_pitch, sag, eccentricity and wobble, alone or up
to three together. Runs that were not fitted decide, and confounded sets are reported as rivals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

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
from simgap.geometry.pose_intervals import intervals
from simgap.geometry.pose_model import ROCK, STATIC, Geometry, Linear, PoseModel, Rocking, Track, Weighting, sine_cosine
from simgap.geometry.pose_search import Losses
from simgap.geometry.track_geometry import TrackGeometry, track_geometry
from simgap.measure.swings import unit_numbers
from simgap.verdict import NamedEffect

_NOISELESS = np.repeat([1e-12, 1e-12], 3)  # m^2 and rad^2: least noise of any pose
_STRAY_RATIO = 5.0
"""Normalised displacement off its joint above which a part at rest along it has moved otherwise."""
_MAX_OFF_AXIS = 1.0
"""Rotation across the joint's axis, rad, that no joint makes."""
_ONE_SIGMA_TAIL = 0.16  # one-sided probability of one standard error


def find_geometry(
    asset: Asset, measured: Measured, settings: KinematicsSettings | None = None
) -> KinematicsFinding | None:
    """The geometry of an asset's joint from the pose runs of a measured set; None without any.

    Held-out runs are only used to measure the gap; cross-validation decides.

    Raises FreeArtError when there is no run to fit, a run has fewer than 10 poses, or rotates the part as no such joint
    does.
    """
    posed = [run for run in measured.runs if run.poses is not None]
    if not posed:
        return None
    if all(run.held_out for run in posed):
        advice = ", ".join(run.name for run in posed)
        raise FreeArtError(f"all runs of poses ({advice}) are held out, expected at least one to fit to")
    placed = place(asset, measured.gravity)
    tracks, mechanics = [placed.track(run) for run in posed], placed.mechanics
    for t in tracks:
        if len(t.times_s) < 10:
            raise FreeArtError(f"run '{t.name}' has {len(t.times_s)} poses, expected 10 or more")
        turned = float(np.quantile(_off_axis_rotation(t.motions, mechanics.joint.axis), 0.9))
        if turned > _MAX_OFF_AXIS:
            raise FreeArtError(
                f"run '{t.name}' turns the part by {turned:.3g} rad across the axis of joint '{mechanics.joint.name}', "
                f"expected less than {_MAX_OFF_AXIS:g}: is this the joint that was moved, and are asset and "
                "poses in one frame?"
            )
    held_out = [bool(run.held_out) for run in posed]
    return _Search(tracks, held_out, mechanics, settings or KinematicsSettings()).find()


def _off_axis_rotation(motions: Array, axis: Array) -> Array:
    """(n,) rad of the motions (n, 4, 4), without their rotation about the axis (3,)."""
    q = se3.wxyz(motions)
    return 2 * np.arccos(np.clip(np.hypot(q[:, 0], q[:, 1:] @ axis), 0.0, 1.0))


class _Search:
    """The search: all runs, and the fitted ones thinned to some frames, with an improving estimate of their noise."""

    def __init__(
        self, tracks: Sequence[Track], held_out: list[bool], mechanics: JointMechanics, settings: KinematicsSettings
    ):
        self.tracks, self.held_out, self.mechanics, self.settings = tracks, held_out, mechanics, settings
        train = [t for t, out in zip(tracks, held_out, strict=True) if not out]
        every = max(1, -(-sum(len(t.times_s) for t in train) // settings.most_frames))
        thin = tuple(Track(t.name, t.times_s[::every], t.motions[::every]) for t in train)
        self.model = model = PoseModel(thin, mechanics)
        self.frames = len(model.run)
        span = float(np.ptp(model.q0)) or 1.0
        units = unit_numbers(model.q0, model.run, 0.05 * span, longest=max(20, self.frames // 24))
        if units.max() < 3:  # no reversals
            units = np.arange(self.frames) * 4 // self.frames
        self.units: NDArray[np.int64] = units
        self.folds = model.run if len(train) >= 3 else _split_units(units, 4)
        self.rate_hz = 1 / float(np.median(np.concatenate([np.diff(t.times_s) for t in thin])))
        self.weighting = self._first_weighting()

    def find(self) -> KinematicsFinding:
        """Search the sets of effects."""
        model, settings = self.model, self.settings
        least = settings.least_span[0 if self.mechanics.joint.type == "revolute" else 1]
        if max(float(np.ptp(model.q0[model.run == r])) for r in np.unique(model.run)) < least:
            return self._not_excited_finding()
        able = [n for n in STATIC if model.joint.type in EFFECTS[n].joint_types and n not in settings.without]
        full = Geometry.zero(tuple(able))
        for _ in range(2):  # noise is re-estimated with all static effects fitted
            full, q = model.fit(full, self.weighting)
            self.weighting = self._weighting_about(full)
        lin = model.linear(full, q, self.weighting)
        residual = pose_search.free_residual(lin, self.weighting.priors(()))
        frequencies = pose_search.find_rocking_frequency(lin, residual, self.folds, self.rate_hz)
        rocks = all(f is not None for f in frequencies) and ROCK not in settings.without
        names = (*able, *((ROCK,) if rocks else ()))
        sizes = range(min(settings.most_effects, len(names)) + 1)
        subsets = tuple(subset for size in sizes for subset in combinations(names, size))
        losses = pose_search.held_out_losses(
            lin, full.names, self.weighting, self.units, subsets, frequencies, self.folds
        )
        chosen, p_values = _prune_subset(losses, _select_subset(losses), settings)
        point = self._fit_chosen(chosen, full, frequencies)
        if point.rock is not None:  # noise without the rocking
            self.weighting = self._weighting_about(point)
        return self._finding(losses, chosen, p_values, point)

    def _first_weighting(self) -> Weighting:
        """Noise from second differences of the residual to the ideal joint, in which motion cancels. Along the joint
        there is no residual; the noise there is taken as across it."""
        model = self.model
        y = model.residuals(Geometry.zero(()), model.q0)
        same = model.run[2:] == model.run[:-2]
        bends = (y[2:] - 2 * y[1:-1] + y[:-2])[same]
        covariance = bends.T @ bends / (6 * max(len(bends), 1)) + np.diag(_NOISELESS)
        own = slice(3, 6) if model.joint.type == "revolute" else slice(0, 3)
        covariance += 0.5 * np.trace(covariance[own, own]) * np.outer(model.joint.screw, model.joint.screw)
        shrunk = 0.9 * covariance + 0.1 * np.diag(np.diag(covariance))
        return Weighting(shrunk, 1.0, self.settings.registration_std)

    def _weighting_about(self, point: Geometry) -> Weighting:
        """Noise from the residual of this point and a free function of position. Its component along the joint is not
        observed, and taken as the rest."""
        model, weighting = self.model, self.weighting
        lin = model.linear(point, model.positions(point, weighting), weighting)
        residual = pose_search.free_residual(lin, weighting.priors(()), model.rocking(lin, point))
        L = weighting.whitening
        scale = float((residual**2).sum(-1).mean()) / 5.0
        shape = np.cov(np.linalg.inv(L) @ residual.T) + 1e-3 * scale * weighting.covariance
        along = model.joint.screw / np.linalg.norm(L @ model.joint.screw)  # unit length, whitened
        noise = shape + scale * np.outer(along, along) + np.diag(_NOISELESS)
        return replace(weighting, covariance=noise, correlation=_correlation(residual, model.run))

    def _fit_chosen(self, chosen: tuple[str, ...], full: Geometry, frequencies: Sequence[float | None]) -> Geometry:
        """The chosen effects fitted to all training runs, nonlinearly."""
        start = Geometry.zero(tuple(n for n in chosen if n != ROCK))
        of_full = dict(full.split())
        values = np.concatenate([of_full[n] for n in start.names] or [np.zeros(0)])
        point, q = self.model.fit(replace(start, values=values), self.weighting, rounds=12)
        if ROCK not in chosen:
            return point
        frequency = float(np.median([f for f in frequencies if f is not None]))
        for _ in range(4):
            now = self.model.linear(replace(point, rock=None), q, self.weighting)
            residual = now.residual(point)
            frequency = _refine_frequency(now, residual, frequency)
            rock = Rocking(frequency, pose_search.fit_rocking(now, residual, frequency)).in_one_direction()
            point, q = self.model.fit(replace(point, rock=rock), self.weighting, rounds=4)
        return point

    def _finding(
        self, losses: Losses, chosen: tuple[str, ...], p_values: tuple[float, ...], point: Geometry
    ) -> KinematicsFinding:
        settings, weighting, model = self.settings, self.weighting, self.model
        noise = min(float(np.average(losses.ceiling, weights=losses.weights)), losses.mean(chosen))
        _, p_more = losses.gain(losses.of(chosen), losses.ceiling)
        remainder = float(np.sqrt(max(losses.mean(chosen) / noise - 1, 0.0)))
        more = remainder > settings.unexplained_floors and p_more <= settings.level
        gaps = [np.sqrt(losses.mean(s) / noise) for s in ((), chosen)]
        closed = (gaps[0] - gaps[1]) / max(gaps[0] - 1.0, 1e-9)
        rivals = _find_rivals(losses, chosen, settings)
        plain, _ = model.fit(Geometry.zero(()), weighting)
        if more and closed < settings.closed and chosen and gaps[0] ** 2 - 1 < settings.tracker_floors**2:
            return self._finding(losses, (), (), plain)
        if more and (closed < settings.closed if chosen else remainder > settings.tracker_floors):
            verdict: GeometryVerdict = "unexplained"
        elif not chosen:
            verdict = "no_gap"
        else:
            verdict = "ambiguous" if rivals else "named"
        named: list[NamedEffect] = []
        if chosen:
            lin = model.linear(point, model.positions(point, weighting), weighting)
            named = intervals(lin, point, weighting, self.units)
        ranking = [
            (s, losses.mean(s) / noise, losses.gain(losses.of(()), losses.of(s))[1] if s else 1.0)
            for s in losses.subsets
        ]
        order = dict(zip(chosen, p_values, strict=True))
        return KinematicsFinding(
            verdict,
            tuple(named),
            rivals,
            self._track_geometries(plain, point),
            tuple(sorted(ranking, key=lambda row: row[1])),
            remainder,
            _suggest_experiment(rivals) if rivals else _UNEXPLAINED_EXPERIMENT if verdict == "unexplained" else None,
            (plain.registration, point.registration),
            tuple(order[each.effect.name] for each in named),
        )

    def _track_geometries(self, plain: Geometry, point: Geometry) -> tuple[TrackGeometry, ...]:
        return tuple(
            track_geometry(track, out, self.mechanics, self.weighting, plain, point)
            for track, out in zip(self.tracks, self.held_out, strict=True)
        )

    def _not_excited_finding(self) -> KinematicsFinding:
        """The finding where the joint hardly moved along itself."""
        seen = self._track_geometries(Geometry.zero(()), Geometry.zero(()))
        if any(t.gap_before > _STRAY_RATIO * t.floor for t in seen):
            advice = "Make sure that this is the joint that was moved, and that asset and poses have one frame."
            return KinematicsFinding("unexplained", (), (), seen, (), 0.0, advice)
        advice = "Move the joint through more of its range: it stood all but still."
        return KinematicsFinding("not_excited", (), (), seen, (), 0.0, advice)


def _split_units(units: NDArray[np.int64], least: int) -> NDArray[np.int64]:
    """Folds of whole units, in order, where there are too few runs to leave one out."""
    count = int(units.max()) + 1
    return (units * min(least, count)) // count


def _correlation(residual: Array, run: NDArray[np.int64]) -> float:
    """Frames per independent frame: 1 + 2 sum of the autocorrelations, down to the first below 0.1."""
    centred = residual - residual.mean(0)
    total, power = 1.0, float((centred**2).sum()) or 1.0
    for lag in range(1, min(len(residual) // 4, 400)):
        same = run[lag:] == run[:-lag]
        r = float((centred[lag:] * centred[:-lag])[same].sum()) / power
        if r < 0.1:
            break
        total += 2 * r
    return total


def _select_subset(losses: Losses) -> tuple[str, ...]:
    """The subset of least held-out loss, or a smaller one within one standard error."""
    best = min(losses.subsets, key=losses.mean)
    for subset in sorted(losses.subsets, key=lambda s: (len(s), losses.mean(s))):
        if len(subset) >= len(best):
            break
        if losses.gain(losses.of(subset), losses.of(best))[1] > _ONE_SIGMA_TAIL:
            return subset
    return best


def _prune_subset(
    losses: Losses, chosen: tuple[str, ...], settings: KinematicsSettings
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """The subset without effects that gain too little or not significantly; p-values of the others."""
    tests = len(losses.subsets) - 1  # number of tests
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


def _refine_frequency(lin: Linear, residual: Array, frequency: float) -> float:
    """The locally best frequency."""
    from scipy.optimize import minimize_scalar

    reach = 0.5 / max(float(np.ptp(lin.times_s[lin.run == r])) for r in np.unique(lin.run))

    def loss(f: float) -> float:
        waves = sine_cosine(f, lin.times_s)
        c = pose_search.fit_rocking(lin, residual, f)[lin.run]
        return float(((residual - np.einsum("nij,njb,nb->ni", lin.rocks, c, waves)) ** 2).sum())

    return float(minimize_scalar(loss, bounds=(max(frequency - reach, 1e-6), frequency + reach), method="bounded").x)


def _find_rivals(losses: Losses, chosen: tuple[str, ...], settings: KinematicsSettings) -> tuple[tuple[str, ...], ...]:
    """The chosen set, then others of no more effects that predict held-out runs as well; empty without such."""
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


_UNEXPLAINED_EXPERIMENT = (
    "Move the joint slowly through its whole range, both ways, and once with the part held still, all in the picture."
)
"""What to record about an unexplained displacement: whether it depends on position, direction or time."""


def _suggest_experiment(rivals: tuple[tuple[str, ...], ...]) -> str:
    """What to record to separate the rivals."""
    own = (EFFECTS[name].experiment for name in sorted({n for r in rivals for n in r}))
    return next(filter(None, own), "Record the joint over more of its range: only there do these causes part.")
