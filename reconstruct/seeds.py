"""Where to start: windows in which two rigid motions explain the object much better than one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct import rigid
from reconstruct.evidence import Evidence, Samples, draw
from reconstruct.scene import HopelessError
from reconstruct.settings import SeedSettings
from reconstruct.tracks import Tracker

FULL_SHARE = 0.12
"""Of the foreground: a smaller second part must lower the cost of a pixel the more."""
LEAST_TRACKS = 0.06
"""Share of the tracks that each of two motions must explain better than the other. Not measured."""


@dataclass(frozen=True)
class Candidate:
    """Two motions between a pair of frames, as the tracks say."""

    frame: int
    gap: int
    Ts: Array
    """(2, 4, 4) motions from `frame` to `frame + gap`."""
    gain: float
    """Drop of the mean truncated squared error, in sigmas, from one motion to two."""


@dataclass(frozen=True)
class Miss:
    """A pair of frames whose tracks hold no two motions."""

    passed: float
    """How many tests it passed, with the share of its limit at which it failed the next one."""
    reason: str
    """The test that failed, its number and its limit."""


@dataclass(frozen=True)
class Seed:
    """A window with labels: where growth starts."""

    frame: int
    others: NDArray[np.int64]
    """(s,) the frames of the window after `frame`."""
    Ts: Array
    """(s, 2, 4, 4) motions from `frame` to `others`."""
    logodds: NDArray[np.float32]
    """(h, w) > 0 where pixels move by the second motion."""
    gain: float
    """Drop of the mean dense cost from one motion to two, less for a small second part."""
    drop: float = 0.0
    """The same drop, whatever the second part's size."""
    share: float = 0.0
    """Of the foreground, what moves by the motion of the smaller part."""


def candidates(
    evidence: Evidence,
    tracker: Tracker,
    settings: SeedSettings,
    rng: np.random.Generator,
    within: tuple[int, int] | None = None,
) -> list[Candidate]:
    """Two-motion fits of tracks all over the recording, or from the first to the last frame `within`, best first.

    Raises HopelessError when there are none, with the test that failed in the window that came nearest.
    """
    first, last = (0, len(evidence.scene) - 1) if within is None else within
    pairs = [(frame, gap) for gap in settings.gaps for frame in range(first, last - gap + 1, settings.every)]
    tried = [_two_motions(evidence, tracker, frame, gap, settings, rng) for frame, gap in pairs]
    found = [c for c in tried if isinstance(c, Candidate)]
    if found:
        return sorted(found, key=lambda c: -c.gain)
    misses = [
        (miss, frame, frame + gap) for miss, (frame, gap) in zip(tried, pairs, strict=True) if isinstance(miss, Miss)
    ]
    if not misses:
        raise HopelessError(
            f"frames {first} to {last} hold no pair {min(settings.gaps)} apart, the least that is needed"
        )
    miss, start, end = max(misses, key=lambda m: m[0].passed)
    raise HopelessError(f"no two frames show two motions; frames {start} and {end} come nearest: {miss.reason}")


def find_seeds(
    evidence: Evidence,
    tracker: Tracker,
    settings: SeedSettings,
    rng: np.random.Generator,
    within: tuple[int, int] | None = None,
) -> list[Seed]:
    """The windows whose dense refinement gains most from a second motion, best first; all, or those of a stretch.

    They lie from the first to the last frame `within`, but may look a few frames beyond. Where there is little texture
    tracks gain most by their noise, so they only say which window of every few frames is tried: all pixels of its two
    frames choose those that are refined on the frames between as well.

    Raises HopelessError when no window gains: nothing moves against anything else, or there is no second part.
    """
    found = candidates(evidence, tracker, settings, rng, within)
    tried = _best_of_stretches(found, settings.stretch)
    gains = [_dense_seed(evidence, c, np.array([c.frame + c.gap]), settings, rng).gain for c in tried]
    chosen = [tried[c] for c in np.argsort(-np.array(gains), kind="stable")[: settings.refined]]
    seeds = sorted((_dense_seed(evidence, c, _window(evidence, c, settings), settings, rng) for c in chosen), key=_rank)
    if seeds[0].gain < settings.min_gain:
        raise HopelessError(_refusal(seeds, settings))
    return [s for s in seeds if s.gain >= settings.min_gain]


def _refusal(seeds: list[Seed], settings: SeedSettings) -> str:
    """Which tests the window that comes nearest to a second part fails, with its numbers and their limits."""

    def nearness(seed: Seed) -> float:
        return min(seed.share / settings.min_share, seed.drop / needed_drop(seed.share, settings))

    best = max(seeds, key=nearness)
    needed = needed_drop(best.share, settings)
    failed = []
    if best.share < settings.min_share:
        failed.append(
            f"it shows on {_floor(100 * best.share)} % of the object's pixels, at least "
            f"{100 * settings.min_share:.3g} % is needed"
        )
    if best.drop < needed:
        size = f" for a part of {_floor(100 * best.share)} % of the pixels" if best.share < FULL_SHARE else ""
        failed.append(
            f"its motion lowers the mean cost of a pixel by {_floor(best.drop)}, at least {needed:.2g} is needed{size}"
        )
    return f"no second part was found that moves; frame {best.frame} comes nearest: {' and '.join(failed)}"


def _floor(value: float) -> str:
    """`value` rounded down to two digits, so that it never reads like the limit that it misses."""
    if value <= 0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / unit + 1e-6) * unit:.3g}"


def needed_drop(share: float, settings: SeedSettings) -> float:
    """Drop of the mean cost of a pixel that a second part with this `share` of the foreground, 0 to 1, must make."""
    return settings.min_gain / max(min(1.0, share / FULL_SHARE), 1e-9)


def _best_of_stretches(found: list[Candidate], frames: int) -> list[Candidate]:
    """Of every stretch of so many `frames`, the first of `found` of each gap."""
    best: dict[tuple[int, int], Candidate] = {}
    for candidate in found:
        best.setdefault((candidate.frame // frames, candidate.gap), candidate)
    return list(best.values())


def _window(evidence: Evidence, candidate: Candidate, settings: SeedSettings) -> NDArray[np.int64]:
    """The frames after the candidate's own on which it is refined."""
    first = candidate.frame + 1
    return np.arange(first, min(first + max(settings.window, candidate.gap), len(evidence.scene)))


def _rank(seed: Seed) -> float:
    """Less is better."""
    return -seed.gain


def _two_motions(
    evidence: Evidence,
    tracker: Tracker,
    frame: int,
    gap: int,
    settings: SeedSettings,
    rng: np.random.Generator,
) -> Candidate | Miss:
    """RANSAC from small neighbourhoods, the best pair of hypotheses, then EM."""
    scene = evidence.scene
    tracks = tracker.follow(frame, gap)
    kept = np.flatnonzero(tracks.visible[:, -1])
    least = 8 * settings.sample
    if len(kept) < least:
        return Miss(len(kept) / least, f"{len(kept)} points of the object can be followed, at least {least} are needed")
    kept = kept[np.sort(rng.permutation(len(kept))[: settings.max_tracks])]
    X, Y = tracks.points[kept, 0], tracks.points[kept, -1]
    scale = 2.5 * evidence.unit
    Ts = _local_hypotheses(X, Y, settings.neighbourhood * scene.diagonal, scale, settings, rng)
    if len(Ts) < 2:
        return Miss(
            1 + len(Ts) / 2,
            f"{len(Ts)} neighbourhoods hold {settings.sample} points that can be followed, at least 2 are needed",
        )
    pixels = np.rint(tracks.pixels[kept, -1]).astype(int)
    normals = scene.normals[frame + gap, pixels[:, 1], pixels[:, 0]].astype(float)
    errors = _errors(Ts, X, Y, normals, evidence)
    some = errors[:, :400]
    pair_cost = np.stack([np.minimum(one, some).mean(1) for one in some])
    share = np.stack([(one < some).mean(1) for one in some])
    pair_cost[(share < LEAST_TRACKS) | (share > 1 - LEAST_TRACKS)] = np.inf
    a, b = np.unravel_index(pair_cost.argmin(), pair_cost.shape)
    if not np.isfinite(pair_cost[a, b]):
        most = float(np.minimum(share, 1 - share).max())
        return Miss(
            2 + most / LEAST_TRACKS,
            f"a second motion explains {100 * most:.3g} % of the points that can be followed, at least "
            f"{100 * LEAST_TRACKS:.3g} % is needed",
        )
    pair = np.stack([Ts[a], Ts[b]])
    for round_ in range(settings.em_rounds):
        second = errors[b] < errors[a] if round_ == 0 else np.argmin(_errors(pair, X, Y, normals, evidence), 0) == 1
        for k, mine in enumerate((~second, second)):
            if mine.sum() >= settings.sample:
                pair[k] = rigid.tukey_fit(pair[k], X[mine], Y[mine], scale, 3)
    one = min(errors.mean(1).min(), _errors(pair, X, Y, normals, evidence).mean(1).min())
    return Candidate(frame, gap, pair, float(one - _errors(pair, X, Y, normals, evidence).min(0).mean()))


def _local_hypotheses(
    X: Array, Y: Array, radius: float, scale: float, settings: SeedSettings, rng: np.random.Generator
) -> Array:
    """(m, 4, 4) transforms, each from tracks round one point: a neighbourhood mostly lies on one part."""
    centres = rng.integers(0, len(X), settings.hypotheses)
    near = np.linalg.norm(X[centres][:, None] - X[None], axis=2) < radius
    near = near[near.sum(1) >= settings.sample]
    if len(near) == 0:
        return np.zeros((0, 4, 4))
    draw = np.where(near, rng.random(near.shape), np.inf)
    pick = np.argpartition(draw, settings.sample, axis=1)[:, : settings.sample]
    Ts = rigid.rigid_fit(X[pick], Y[pick])
    for _ in range(2):
        r = rigid.distances(Ts, X[None], Y[None]) / (2 * scale)
        weights = np.where(near & (r < 1), (1 - r**2) ** 2, 0.0)
        held = (weights > 0).sum(1) >= 6
        Ts[held] = rigid.rigid_fit(X[None], Y[None], weights[held])
    return Ts


def _errors(Ts: Array, X: Array, Y: Array, normals: Array, evidence: Evidence) -> Array:
    """(m, p) truncated squared errors in sigmas: tight along the surface normal, loose where only flow measures."""
    d = np.einsum("mij,pj->mpi", Ts[:, :3, :3], X) + Ts[:, None, :3, 3] - Y
    along = np.einsum("mpi,pi->mp", d, normals)
    slide = np.maximum((d**2).sum(2) - along**2, 0)
    return np.minimum((along / (1.5 * evidence.sigma)) ** 2 + slide / (4 * evidence.unit) ** 2, 9.0)


def _dense_seed(
    evidence: Evidence,
    candidate: Candidate,
    others: NDArray[np.int64],
    settings: SeedSettings,
    rng: np.random.Generator,
) -> Seed:
    """Labels and motions to the frames `others`, refined in turn on all the evidence; compared with a single motion."""
    scene, t = evidence.scene, candidate.frame
    Ts = np.stack([_fraction(candidate.Ts, (j - t) / candidate.gap) for j in others])
    at = int(np.searchsorted(others, t + candidate.gap))
    logodds = evidence.pixel_logodds(t, others[at : at + 1], Ts[at : at + 1])
    for round_ in range(3):
        for s in range(len(others)):
            if round_ == 0 and s > 0:
                before = Ts[s - 1] @ se3.inverse(Ts[s - 2]) if s > 1 else Ts[0]
                Ts[s] = before @ Ts[s - 1]
            for k in range(2):
                mine = ((logodds > 0) == bool(k)) & scene.valid[t] & ~scene.edge[t]
                Ts[s, k] = _refined(evidence, t, int(others[s]), Ts[s, k], mine, round_, rng)
        logodds = evidence.pixel_logodds(t, others, Ts)
    valid = scene.valid[t]
    pixels = np.argwhere(valid)[::3]
    costs = evidence.costs(t, others, Ts, pixels).mean(1)
    second = logodds[pixels[:, 0], pixels[:, 1]] > 0
    two = float(np.where(second, costs[:, 1], costs[:, 0]).mean())
    single = [
        np.stack(
            [
                _refined(evidence, t, int(j), T, valid & ~scene.edge[t], 0, rng)
                for j, T in zip(others, Ts[:, k], strict=True)
            ]
        )
        for k in range(2)
    ]
    one = min(float(evidence.costs(t, others, T[:, None], pixels).mean()) for T in single)
    share = min(second.mean(), 1 - second.mean())
    gain = (one - two) * min(1.0, share / FULL_SHARE) if share >= settings.min_share else 0.0
    return Seed(t, others, Ts, logodds, gain, one - two, float(share))


def _refined(
    evidence: Evidence,
    frame: int,
    other: int,
    T: Array,
    mask: NDArray[np.bool_],
    round_: int,
    rng: np.random.Generator,
) -> Array:
    """`T` from `frame` to `other` after Gauss-Newton on the pixels of `mask`."""
    samples: Samples = {frame: draw(mask, 700, rng)}
    if len(samples[frame]) < 25:
        return T
    for gate in (10.0, 7.0, 5.0, 4.0, 4.0) if round_ == 0 else (5.0, 4.0, 4.0):
        H, g, _ = evidence.register(np.array([frame]), np.array([other]), T[None], samples, gate)
        T = stepped(T, H[0], g[0])
    return T


def stepped(T: Array, H: Array, g: Array, most: float = 0.1) -> Array:
    """`T` after one damped Gauss-Newton step of its left twist, at most `most` radians."""
    diagonal = np.diag(H)
    if not diagonal.max() > 0:
        return T
    damped = H + np.diag(1e-3 * diagonal + 1e-9 * diagonal.max())
    x = -np.linalg.solve(damped, g)
    return se3.orthonormalised(se3.exp_se3(x * min(1.0, most / max(float(np.linalg.norm(x[3:])), 1e-12))) @ T)


def _fraction(Ts: Array, a: float) -> Array:
    """`Ts` (..., 4, 4) travelled by the share `a` along their screws."""
    return se3.exp_se3(a * se3.log_se3(Ts))
