"""Seeds of the segmentation: windows in which two rigid motions explain the object much better than one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from reconstruct import rigid
from reconstruct.evidence import Evidence, PartReferences, Samples, sample_pixels
from reconstruct.scene import UnsolvableError
from reconstruct.tracks import Tracker, Tracks

WINDOW_SPACING = 6
"""Frames between candidate windows."""
FRAME_GAPS = (3, 6, 12)
"""Frame distances over which two rigid motions are sought in the tracks."""
HYPOTHESES = 120
"""RANSAC samples per window, each from a small neighbourhood."""
NEIGHBOURHOOD = 0.2
"""Radius of that neighbourhood, in object diagonals."""
SAMPLE = 8
"""Tracks per RANSAC sample."""
MAX_TRACKS = 1200
EM_ROUNDS = 4
"""EM iterations of the pair of transforms (supplement, Transformation Initialization)."""
STRETCH = 12
"""Frames; from each stretch the best window of each gap is tried on all pixels of its two frames."""
MAX_REFINED = 12
"""Windows whose motions are refined on all their frames before the best is chosen."""
REFINEMENT_WINDOW = 6
"""Frames of the dense refinement."""
LEAST_PIXELS = 30
"""Smallest number of pixels of a second part in the seed frame. Not measured."""
LEAST_EVIDENCE = 0.9
"""Smallest relative fall of the mean cost of a pixel from one motion to two; a ratio, as noise is not known exactly. At
most 0.64 on eleven videos of still objects (clean, noise2, tof), at least 1.3 on fifteen of moving ones, the smallest
part a faucet's handle of 147 pixels."""
LEAST_COST = 0.02
"""Mean cost of a pixel that counts as noise at least. A clean sensor's residuals are far below SIGMA: it was 0.01 to
0.05."""
UNEXPLAINED = 2.0
"""Cost of a pixel above which the dominant motion does not explain it. Three clean videos of still objects have no
region of LEAST_PIXELS above it."""
MAX_COMPONENTS = 3
"""Unexplained regions of a pair of frames for which a motion of their own is sought, the largest. Not measured."""
LEAST_TRACKS = 0.06
"""Share of the tracks that each of two motions must explain better than the other. Not measured."""

_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)


@dataclass(frozen=True)
class Candidate:
    """Two motions between a pair of frames, fitted to tracks."""

    frame: int
    gap: int
    Ts: Array
    """(2, 4, 4) motions from `frame` to `frame + gap`."""
    gain: float
    """Drop of the mean truncated squared error, in sigmas squared, from one motion to two."""


@dataclass(frozen=True)
class RejectedPair:
    """A pair of frames whose tracks show no two motions."""

    passed: float
    """Number of passed tests plus the ratio to the limit at the failed one."""
    reason: str
    """The failed test with its number and limit."""


@dataclass(frozen=True)
class Seed:
    """A window with labels, from which propagation starts."""

    frame: int
    others: NDArray[np.int64]
    """(s,) frames of the window after `frame`."""
    Ts: Array
    """(s, 2, 4, 4) motions from `frame` to `others`."""
    logodds: NDArray[np.float32]
    """(h, w) > 0 where pixels move by the second motion."""
    evidence: float
    """Relative fall of the mean cost of a pixel from one motion to two."""
    pixels: int
    """Number of pixels that move by the smaller part's motion."""


def find_candidates(evidence: Evidence, tracker: Tracker, rng: np.random.Generator) -> list[Candidate]:
    """Two-motion fits of tracks over the recording, best first.

    Raises UnsolvableError when there are none, with the test that failed in the pair that came nearest.
    """
    pairs = _spaced_pairs(evidence)
    tried = [_fit_two_motions(evidence, tracker, frame, gap, rng) for frame, gap in pairs]
    found = [c for c in tried if isinstance(c, Candidate)]
    if found:
        return sorted(found, key=lambda c: -c.gain)
    rejections = [
        (rejected, frame, frame + gap)
        for rejected, (frame, gap) in zip(tried, pairs, strict=True)
        if isinstance(rejected, RejectedPair)
    ]
    if not rejections:
        raise UnsolvableError(
            f"{len(evidence.scene)} frames hold no pair {min(FRAME_GAPS)} apart, the least that is needed"
        )
    rejected, start, end = max(rejections, key=lambda m: m[0].passed)
    raise UnsolvableError(f"no two frames show two motions; frames {start} and {end} come nearest: {rejected.reason}")


def _spaced_pairs(evidence: Evidence) -> list[tuple[int, int]]:
    """(frame, gap) of the pairs of frames in which two motions are sought."""
    n = len(evidence.scene)
    return [(frame, gap) for gap in FRAME_GAPS for frame in range(0, n - gap, WINDOW_SPACING)]


def find_seeds(evidence: Evidence, tracker: Tracker, rng: np.random.Generator) -> list[Seed]:
    """Windows whose dense refinement gains most from a second motion, best first.

    Where there is little texture the gain of tracks is mostly noise, so tracks only propose one window per stretch and
    gap; the dense cost of its two frames selects those that are refined on the frames between.

    Raises UnsolvableError when no window gains enough: nothing moves against anything else.
    """
    failure = None
    try:
        chosen = _select_candidates(evidence, find_candidates(evidence, tracker, rng), rng)
    except UnsolvableError as error:
        chosen, failure = [], error
    seeds = [_refine_seed(evidence, c, _refinement_frames(evidence, c), rng) for c in chosen]
    own = np.random.default_rng(0)  # the search for small parts leaves the other draws as they are
    small = _select_candidates(evidence, find_unexplained_parts(evidence, tracker, own), own)
    seeds += [_refine_seed(evidence, c, _refinement_frames(evidence, c), own) for c in small]
    seeds.sort(key=lambda seed: -seed.evidence)
    enough = [s for s in seeds if s.evidence >= LEAST_EVIDENCE and s.pixels >= LEAST_PIXELS]
    if not enough:
        raise UnsolvableError(_explain_rejection(seeds)) if seeds or failure is None else failure
    return enough


def _select_candidates(evidence: Evidence, found: list[Candidate], rng: np.random.Generator) -> list[Candidate]:
    """Of the best candidate of each stretch and gap those with most dense evidence between their two frames."""
    tried = _best_per_stretch(found, STRETCH)
    evidences = [_refine_seed(evidence, c, np.array([c.frame + c.gap]), rng).evidence for c in tried]
    return [tried[c] for c in np.argsort(-np.array(evidences), kind="stable")[:MAX_REFINED]]


def find_unexplained_parts(evidence: Evidence, tracker: Tracker, rng: np.random.Generator) -> list[Candidate]:
    """Second motions of what the object's dominant motion leaves unexplained, best first.

    A small part is a few per cent of the tracks, too few to be found among them; but under the dominant motion its
    pixels form a connected region of large cost.
    """
    pairs = _spaced_pairs(evidence)
    found = [c for frame, gap in pairs for c in _explain_regions(evidence, tracker, frame, gap, rng)]
    return sorted(found, key=lambda c: -c.gain)


def _explain_regions(
    evidence: Evidence, tracker: Tracker, frame: int, gap: int, rng: np.random.Generator
) -> list[Candidate]:
    """The dominant motion between two frames with that of each of the largest regions that it does not explain."""
    scene, other = evidence.scene, np.array([frame + gap])
    valid = scene.valid[frame]
    T = np.eye(4)
    for j in range(frame + 1, frame + gap + 1):
        T = _refine_motion(evidence, frame, j, T, valid & ~scene.edge[frame], 0, rng)
    pixels = np.argwhere(valid)
    costs = evidence.costs(frame, other, T[None, None], pixels)[:, 0, 0]
    unexplained = np.zeros(valid.shape, bool)
    unexplained[tuple(pixels[costs > UNEXPLAINED].T)] = True
    opened = cv2.morphologyEx(unexplained.astype(np.uint8), cv2.MORPH_OPEN, _CROSS)  # single rows lie at depth steps
    _, regions, statistics, _ = cv2.connectedComponentsWithStats(opened, connectivity=8)
    sizes = statistics[1:, cv2.CC_STAT_AREA]
    large = [k + 1 for k in np.argsort(-sizes, kind="stable")[:MAX_COMPONENTS] if sizes[k] >= LEAST_PIXELS]
    tracks = tracker.follow(frame, gap) if large else None
    found = []
    for k in large:
        region = regions == k
        starts = [T]
        tracked = _motion_of_region(tracks, region, 3 * evidence.unit, rng) if tracks is not None else None
        starts += [] if tracked is None else [tracked]
        own = [_refine_motion(evidence, frame, frame + gap, start, region, 0, rng) for start in starts]
        there = np.argwhere(region)
        cost = evidence.costs(frame, other, np.stack([T, *own])[None], there)[:, 0].sum(0)
        best = int(np.argmin(cost[1:]))
        gain = float(cost[0] - cost[1 + best]) / len(pixels)
        found.append(Candidate(frame, gap, np.stack([T, own[best]]), gain))
    return found


def _motion_of_region(
    tracks: Tracks, region: NDArray[np.bool_], scale: float, rng: np.random.Generator
) -> Array | None:
    """Motion (4, 4) of the tracks that begin in or beside a region (h, w); None when there are too few."""
    near = cv2.dilate(region.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    at = np.rint(tracks.pixels[:, 0]).astype(int)
    own = near[at[:, 1], at[:, 0]] & tracks.visible[:, -1]
    if own.sum() < SAMPLE:
        return None
    return rigid.ransac_fit(tracks.points[own, 0], tracks.points[own, -1], scale, rng)


def _explain_rejection(seeds: list[Seed]) -> str:
    """Why the best of `seeds` is no second part: the failed tests with their numbers and limits."""
    if not seeds:
        return "no second part was found that moves: one motion explains all pixels"
    best = max(seeds, key=lambda s: min(s.pixels / LEAST_PIXELS, s.evidence / LEAST_EVIDENCE))
    failed = []
    if best.pixels < LEAST_PIXELS:
        failed.append(f"it shows on {best.pixels} pixels, at least {LEAST_PIXELS} are needed")
    if best.evidence < LEAST_EVIDENCE:
        failed.append(
            f"its motion lowers the mean cost of a pixel by a factor of {_round_down(1 + best.evidence)}, at least "
            f"{1 + LEAST_EVIDENCE:.3g} is needed"
        )
    return f"no second part was found that moves; frame {best.frame} comes nearest: {' and '.join(failed)}"


def _round_down(value: float) -> str:
    """`value` rounded down to two digits, so that it never reads like the limit that it misses."""
    if value <= 0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / unit + 1e-6) * unit:.3g}"


def _best_per_stretch(found: list[Candidate], frames: int) -> list[Candidate]:
    """The first of `found` in each stretch of `frames` frames, for each gap."""
    best: dict[tuple[int, int], Candidate] = {}
    for candidate in found:
        best.setdefault((candidate.frame // frames, candidate.gap), candidate)
    return list(best.values())


def _refinement_frames(evidence: Evidence, candidate: Candidate) -> NDArray[np.int64]:
    """The frames after the candidate's own on which it is refined."""
    first = candidate.frame + 1
    return np.arange(first, min(first + max(REFINEMENT_WINDOW, candidate.gap), len(evidence.scene)))


def _fit_two_motions(
    evidence: Evidence,
    tracker: Tracker,
    frame: int,
    gap: int,
    rng: np.random.Generator,
) -> Candidate | RejectedPair:
    """RANSAC from small neighbourhoods, the best pair of hypotheses, then EM."""
    scene = evidence.scene
    tracks = tracker.follow(frame, gap)
    visible = np.flatnonzero(tracks.visible[:, -1])
    needed = 8 * SAMPLE
    if len(visible) < needed:
        return RejectedPair(
            len(visible) / needed, f"{len(visible)} points of the object can be followed, at least {needed} are needed"
        )
    visible = visible[np.sort(rng.permutation(len(visible))[:MAX_TRACKS])]
    X, Y = tracks.points[visible, 0], tracks.points[visible, -1]
    scale = 2.5 * evidence.unit
    Ts = _sample_local_motions(X, Y, NEIGHBOURHOOD * scene.diagonal, scale, rng)
    if len(Ts) < 2:
        return RejectedPair(
            1 + len(Ts) / 2,
            f"{len(Ts)} neighbourhoods hold {SAMPLE} points that can be followed, at least 2 are needed",
        )
    pixels = np.rint(tracks.pixels[visible, -1]).astype(int)
    normals = scene.normals[frame + gap, pixels[:, 1], pixels[:, 0]].astype(float)
    errors = _truncated_errors(Ts, X, Y, normals, evidence)
    some = errors[:, :400]
    pair_cost = np.stack([np.minimum(one, some).mean(1) for one in some])
    share = np.stack([(one < some).mean(1) for one in some])
    pair_cost[(share < LEAST_TRACKS) | (share > 1 - LEAST_TRACKS)] = np.inf
    a, b = np.unravel_index(pair_cost.argmin(), pair_cost.shape)
    if not np.isfinite(pair_cost[a, b]):
        most = float(np.minimum(share, 1 - share).max())
        return RejectedPair(
            2 + most / LEAST_TRACKS,
            f"a second motion explains {100 * most:.3g} % of the points that can be followed, at least "
            f"{100 * LEAST_TRACKS:.3g} % is needed",
        )
    pair = np.stack([Ts[a], Ts[b]])
    for round_ in range(EM_ROUNDS):
        second = (
            errors[b] < errors[a]
            if round_ == 0
            else np.argmin(_truncated_errors(pair, X, Y, normals, evidence), 0) == 1
        )
        for k, own in enumerate((~second, second)):
            if own.sum() >= SAMPLE:
                pair[k] = rigid.tukey_fit(pair[k], X[own], Y[own], scale, 3)
    one = min(errors.mean(1).min(), _truncated_errors(pair, X, Y, normals, evidence).mean(1).min())
    return Candidate(frame, gap, pair, float(one - _truncated_errors(pair, X, Y, normals, evidence).min(0).mean()))


def _sample_local_motions(X: Array, Y: Array, radius: float, scale: float, rng: np.random.Generator) -> Array:
    """(m, 4, 4) transforms, each from tracks round one point: most neighbourhoods lie on one part."""
    centres = rng.integers(0, len(X), HYPOTHESES)
    near = np.linalg.norm(X[centres][:, None] - X[None], axis=2) < radius
    near = near[near.sum(1) >= SAMPLE]
    if len(near) == 0:
        return np.zeros((0, 4, 4))
    order = np.where(near, rng.random(near.shape), np.inf)
    pick = np.argpartition(order, SAMPLE, axis=1)[:, :SAMPLE]
    Ts = se3.fit_rigid(X[pick], Y[pick])
    for _ in range(2):
        r = rigid.distances(Ts, X[None], Y[None]) / (2 * scale)
        weights = np.where(near & (r < 1), (1 - r**2) ** 2, 0.0)
        enough = (weights > 0).sum(1) >= 6
        Ts[enough] = se3.fit_rigid(X[None], Y[None], weights[enough])
    return Ts


def _truncated_errors(Ts: Array, X: Array, Y: Array, normals: Array, evidence: Evidence) -> Array:
    """(m, p) truncated squared errors in sigmas: tight along the surface normal, loose across it, where only flow
    measures."""
    d = np.einsum("mij,pj->mpi", Ts[:, :3, :3], X) + Ts[:, None, :3, 3] - Y
    along = np.einsum("mpi,pi->mp", d, normals)
    slide = np.maximum((d**2).sum(2) - along**2, 0)
    return np.minimum((along / (1.5 * evidence.sigma)) ** 2 + slide / (4 * evidence.unit) ** 2, 9.0)


def _refine_seed(
    evidence: Evidence,
    candidate: Candidate,
    others: NDArray[np.int64],
    rng: np.random.Generator,
) -> Seed:
    """Labels and motions to the frames `others`, refined alternately on dense evidence, and the gain over a single
    motion."""
    scene, t = evidence.scene, candidate.frame
    Ts = np.stack([_partial_motions(candidate.Ts, (j - t) / candidate.gap) for j in others])
    at = int(np.searchsorted(others, t + candidate.gap))
    logodds = evidence.pixel_logodds(t, others[at : at + 1], Ts[at : at + 1])
    for round_ in range(3):
        for s in range(len(others)):
            if round_ == 0 and s > 0:
                before = Ts[s - 1] @ se3.inverse(Ts[s - 2]) if s > 1 else Ts[0]
                Ts[s] = before @ Ts[s - 1]
            for k in range(2):
                own = evidence.usable_pixels(t, (logodds > 0) == bool(k))
                Ts[s, k] = _refine_motion(evidence, t, int(others[s]), Ts[s, k], own, round_, rng)
        logodds = evidence.pixel_logodds(t, others, Ts)
    valid = scene.valid[t]
    pixels = np.argwhere(valid)[::3]
    costs = evidence.costs(t, others, Ts, pixels).mean(1)
    second = logodds[pixels[:, 0], pixels[:, 1]] > 0
    two = float(np.where(second, costs[:, 1], costs[:, 0]).mean())
    single = [
        np.stack(
            [
                _refine_motion(evidence, t, int(j), T, valid & ~scene.edge[t], 0, rng)
                for j, T in zip(others, Ts[:, k], strict=True)
            ]
        )
        for k in range(2)
    ]
    one = min(float(evidence.costs(t, others, T[:, None], pixels).mean()) for T in single)
    share = float(min(second.mean(), 1 - second.mean()))
    return Seed(t, others, Ts, logodds, (one - two) / max(two, LEAST_COST), round(share * int(valid.sum())))


def _refine_motion(
    evidence: Evidence,
    frame: int,
    other: int,
    T: Array,
    mask: NDArray[np.bool_],
    round_: int,
    rng: np.random.Generator,
) -> Array:
    """`T` from `frame` to `other` after Gauss-Newton on the pixels of `mask`."""
    samples: Samples = {frame: sample_pixels(mask, 700, rng)}
    if len(samples[frame]) < 25:
        return T
    gates = (10.0, 7.0, 5.0, 4.0, 4.0) if round_ == 0 else (5.0, 4.0, 4.0)
    still = PartReferences(np.array([frame]), np.eye(4)[None], evidence.records(samples))
    return evidence.register_pose(T, other, still, gates)[0]


def _partial_motions(Ts: Array, a: float) -> Array:
    """The share `a` of the motions `Ts` (..., 4, 4) along their screws."""
    return se3.exp_se3(a * se3.log_se3(Ts))
