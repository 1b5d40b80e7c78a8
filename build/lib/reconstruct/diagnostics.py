"""What the solver can say of its own answer without a truth: how well all frames agree with each other.

Samples of every frame are carried into the frames that `poses.choose_pairs` pairs it with by the free poses, and looked
up there, once by the free poses, once by those that obey the joint. Nothing of the answer depends on it.
"""

from __future__ import annotations

import resource
import sys
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from freeart21 import se3
from freeart21.files.diagnostics import Diagnostics
from freeart21.joint import Joint
from freeart21.se3 import Array
from reconstruct.evidence import Evidence, Pixels, Samples, draw, evenly
from reconstruct.growth import Grown, body_points
from reconstruct.joint import JointFit, fit_joint, states_of
from reconstruct.labels import telling_frames
from reconstruct.poses import FreePoses, choose_pairs, part_samples
from reconstruct.rigid import view_angle
from reconstruct.scene import full_masks
from reconstruct.settings import JointSettings, PoseSettings

SAMPLES = 100
"""Pixels a frame and part."""
OFF_MASK = 1.5
"""Pixels from the mask beyond which a sample is off it: more than rounding to whole pixels explains."""
LEAST = 20
"""Fewer samples that could meet the surface tell nothing."""
MOST_FRAMES = 150
"""Frames, evenly drawn, in which a third motion is looked for, and each part's own."""
NEARBY, SAME_VIEW = (2, 4, 8, 12, 20), 0.6
"""Frames before and after, and radians from the view there, in which a frame's pixels are looked up."""
MISFIT = 2.5
"""Cost of a pixel that does not follow a motion: more than two standard deviations, not hidden."""
STATES, AS_WELL, BARRIER = 36, 0.5, 1.3
"""States that are tried each way, over half a turn or the range of motion; and the mean cost of a pixel, that of a
misfit by one standard deviation, up to which a state explains a frame; and how many times that what lies between must
cost. A fan: .05 where it stands, .1 to .3 at 45 degrees, .8 to 1.7 between."""


def diagnose(
    evidence: Evidence,
    grown: Grown,
    free: tuple[FreePoses, ...],
    settings: PoseSettings,
    joints: JointSettings,
    seed: int = 0,
    size: tuple[int, int] | None = None,
) -> Diagnostics:
    """Residuals, inliers and confidence of every frame and part.

    A sample is an inlier when it meets its own part's surface within the joint adjustment's first gate: wide enough to
    tell a bad frame from a good one. With the full picture's `size` (width, height) the maps of confidence are made,
    too.
    """
    scene, rng = evidence.scene, np.random.default_rng([seed, 21])
    gate = settings.gate * evidence.unit
    columns = []
    for k, jointed in enumerate((grown.poses.Ts, grown.poses.Ts_moving)):
        samples = part_samples(evidence, grown.labels, k + 1, SAMPLES, rng, grown.seen[:, k])
        pairs = choose_pairs(free[k].Ts, grown.seen[:, k], settings)
        by_free = agreement(evidence, grown.labels, k + 1, free[k].Ts, samples, pairs, gate)
        by_joint = agreement(evidence, grown.labels, k + 1, jointed, samples, pairs, gate)
        columns.append(np.column_stack([by_free, by_joint[:, 2]]))
    inliers, outside, residual, jointed_residual = np.stack(columns, 2).transpose(1, 0, 2)
    probability = label_probability(grown.labels, grown.logodds)
    maps = np.rint(255 * probability).astype(np.uint8)
    return Diagnostics(
        _pixels(grown.labels, scene.factor),
        _means(grown.labels, probability),
        inliers,
        outside,
        residual,
        jointed_residual,
        gate,
        scene.footprint,
        scene.noise,
        scene.diagonal,
        peak_bytes(),
        None if size is None else full_masks(scene, maps, *size),
        **(_signs(evidence, grown, np.stack([f.Ts for f in free]), joints, rng) if grown.seen.all(1).any() else {}),
    )


def agreement(
    evidence: Evidence,
    labels: NDArray[np.uint8],
    part: int,
    Ts: Array,
    samples: Samples,
    pairs: tuple[NDArray, NDArray],
    gate: float,
) -> Array:
    """(n, 3) of every frame: share of inliers, share outside the mask, root mean square of the inliers, metres.

    `Ts` (n, 4, 4) are T_camera_part, `pairs` (source, target) frames, `gate` in metres. Samples that face away in the
    target, or fall on the other part or behind a hand, are hidden there and do not count. NaN with fewer than LEAST
    that count.
    """
    scene = evidence.scene
    h, w = scene.mask.shape[1:]
    found = np.full((len(Ts), 3), np.nan)
    for i, pixels in samples.items():
        others = pairs[1][pairs[0] == i]
        if not len(others) or not len(pixels):
            continue
        T = Ts[others] @ se3.inverse(Ts[i])
        y, x = pixels.T
        X = se3.transform(T, scene.points[i, y, x][None])
        N = scene.normals[i, y, x] @ np.swapaxes(T[:, :3, :3], 1, 2)
        j = np.broadcast_to(others[:, None], X.shape[:2])
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.floor(scene.fx * X[..., 0] / X[..., 2] + scene.cx[j] + 0.5)
            v = np.floor(scene.fy * X[..., 1] / X[..., 2] + scene.cy[j] + 0.5)
        inside = (X[..., 2] > 0) & (u >= 0) & (v >= 0) & (u < w) & (v < h)
        facing = (N * X).sum(-1) < -0.15 * np.linalg.norm(X, axis=-1)
        X, N, j = X[inside & facing], N[inside & facing], j[inside & facing]
        at = (j, v[inside & facing].astype(int), u[inside & facing].astype(int))
        depth = scene.points[at][:, 2]
        off = (scene.outside[at] > OFF_MASK) & ~((depth < 0) & (X[:, 2] > -depth - gate))
        own = (depth > 0) & (labels[at] != 3 - part)
        counted = int((off | own).sum())
        if counted < LEAST:
            continue
        there = scene.normals[at]
        r = (there * (X - scene.points[at])).sum(-1)
        met = own & ~off & ((there * N).sum(-1) > 0.7) & (np.abs(r) <= gate)
        rms = float(np.sqrt((r[met] ** 2).mean())) if met.any() else np.nan
        found[i] = met.sum() / counted, off.sum() / counted, rms
    return found


def peak_bytes() -> int:
    """Most memory that this process has held, bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak) if sys.platform == "darwin" else 1024 * int(peak)


def _pixels(labels: NDArray[np.uint8], factor: int) -> Array:
    counts = np.stack([(labels == k).sum((1, 2)) for k in (1, 2)], 1)
    return counts.astype(float) * factor**2


def label_probability(labels: NDArray[np.uint8], logodds: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, h, w) probability of the label that each pixel was given, by the log-odds of the second part; 0 for none."""
    toward = np.where(labels == 2, logodds, -logodds)
    return np.where(labels > 0, expit(toward), 0).astype(np.float32)


def _means(labels: NDArray[np.uint8], values: NDArray[np.float32]) -> Array:
    """(n, 2) mean of `values` (n, h, w) over each part; NaN where it has no pixels."""
    masks = np.stack([labels == k for k in (1, 2)], 1)
    counts = masks.sum((2, 3)).astype(float)
    sums = np.einsum("nkhw,nhw->nk", masks, values.astype(float))
    return np.divide(sums, counts, out=np.full_like(counts, np.nan), where=counts > 0)


# --- what only a right answer leaves (freeart21.trust) ----------------------------------------------------------------


def _signs(
    evidence: Evidence, grown: Grown, Ts: Array, settings: JointSettings, rng: np.random.Generator
) -> dict[str, Array]:
    """What the diagnostics tell besides, by name; `Ts` (2, n, 4, 4) are T_camera_part of some frames with both."""
    both = grown.seen.all(1)
    body = body_points(evidence, grown.labels, Ts[1], grown.seen[:, 1])
    reach = settings.farthest_hinge * evidence.scene.diagonal
    relative = se3.inverse(Ts[0, both]) @ Ts[1, both]
    return {
        "unexplained": unexplained(evidence, Ts, grown.seen, rng),
        "other_motion_cost": other_motion_cost(evidence, grown, Ts, body, rng),
        "rival_distance": rival_distance(evidence, grown, rng),
        "type_residuals_m": type_residuals(relative, grown.poses.joint, body, reach, settings),
    }


def unexplained(evidence: Evidence, Ts: Array, seen: NDArray[np.bool_], rng: np.random.Generator) -> Array:
    """(n,) share of a frame's pixels that in a quarter of the frames nearby follow neither part's motion there.

    `Ts` (2, n, 4, 4) are T_camera_part, `seen` (n, 2). A third motion leaves all that has it, a right answer next to
    nothing. What leaves the picture is not judged. NaN where no frame nearby shows the like.
    """
    n, shares = len(seen), np.full(len(seen), np.nan)
    known = np.asarray(seen.all(1))
    for i in map(int, evenly(np.flatnonzero(known), MOST_FRAMES)):
        others = np.array([j for d in NEARBY for j in (i - d, i + d) if 0 <= j < n and known[j]], np.int64)
        turn = np.min([view_angle(T[others, :3, :3], T[i, :3, :3]) for T in Ts], axis=0)
        others = others[turn < SAME_VIEW]
        pixels = draw(evidence.usable(i, evidence.scene.valid[i]), 6 * SAMPLES, rng)
        if len(others) < 2 or len(pixels) < LEAST:
            continue
        T = _motions(Ts, i, others)
        costs = evidence.costs(i, others, T, pixels).min(2)
        costs[~_inside(evidence, i, others, T, pixels).all(2)] = np.nan
        costs = costs[np.isfinite(costs).sum(1) >= 2]
        if len(costs) >= LEAST:
            shares[i] = (np.nanpercentile(costs, 75, axis=1) > MISFIT).mean()
    return shares


def _inside(evidence: Evidence, frame: int, others: NDArray[np.int64], T: Array, pixels: Pixels) -> NDArray[np.bool_]:
    """(p, s, k) whether `pixels` (p, 2) of `frame`, moved by T (s, k, 4, 4), are inside the pictures of `others`."""
    scene = evidence.scene
    h, w = scene.mask.shape[1:]
    X = se3.transform(T, scene.points[frame][tuple(pixels.T)][None, None]).transpose(2, 0, 1, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = scene.fx * X[..., 0] / X[..., 2] + scene.cx[others][:, None]
        v = scene.fy * X[..., 1] / X[..., 2] + scene.cy[others][:, None]
    return np.asarray((X[..., 2] > 0) & (u > -0.5) & (v > -0.5) & (u < w - 0.5) & (v < h - 0.5))


def other_motion_cost(evidence: Evidence, grown: Grown, Ts: Array, body: Array, rng: np.random.Generator) -> Array:
    """(n, 2) mean cost of each part's samples if they followed the other part, in frames where the joint stands
    elsewhere; NaN where there are none. `Ts` (2, n, 4, 4) are T_camera_part, `body` points of the second part."""
    found = np.full((len(grown.seen), 2), np.nan)
    known = np.asarray(grown.seen.all(1))
    for i in map(int, evenly(np.flatnonzero(known), MOST_FRAMES)):
        others = telling_frames(evidence, i, Ts, body, known, rng)
        for k in range(2):
            pixels = draw(evidence.usable(i, grown.labels[i] == k + 1), 2 * SAMPLES, rng)
            if len(others) and len(pixels) >= LEAST:
                T = _motions(Ts, i, others)[:, 1 - k :][:, :1]
                found[i, k] = evidence.costs(i, others, T, pixels).mean()
    return found


def rival_distance(evidence: Evidence, grown: Grown, rng: np.random.Generator) -> Array:
    """(n,) rad or m from a frame's state to the nearest other one that explains its moving part as well; 0 for none.

    As well: to one standard deviation, or nearly as the state itself, and beyond states that do not, so that the
    bottom in which the state itself lies does not count. Some frames are asked, NaN in others.
    """
    poses, joint, found = grown.poses, grown.poses.joint, np.full(len(grown.seen), np.nan)
    frames = np.flatnonzero(grown.seen.all(1))
    span = np.pi if joint.type == "revolute" else float(np.ptp(poses.states[frames]))
    steps = np.linspace(0, span, STATES + 1)[1:]
    tried = np.concatenate([-steps[::-1], [0.0], steps])
    for i in map(int, evenly(frames, 24)):
        others = frames[np.abs(frames - i) > 1]
        turn = view_angle(poses.Ts[others, :3, :3], poses.Ts[i, :3, :3])
        others = others[np.argsort(turn, kind="stable")][:6]
        pixels = draw(evidence.usable(i, grown.labels[i] == 2), 2 * SAMPLES, rng)
        if len(pixels) < LEAST or not len(others):
            continue
        here = se3.inverse(poses.Ts[i] @ joint.transform(poses.states[i] + tried))
        costs = evidence.costs(i, others, poses.Ts_moving[others][:, None] @ here, pixels).mean((0, 1))
        found[i] = _nearest_rival(costs, tried)
    return found


def _nearest_rival(costs: Array, tried: Array) -> float:
    """Distance of the nearest of the states `tried` (q,), by `costs` (q,), that is as good as the one at distance 0."""
    own = int(np.argmin(np.abs(tried)))
    enough = max(AS_WELL, 1.2 * float(costs[own]))
    found = []
    for side in (costs[own::-1], costs[own:]):
        barrier = np.flatnonzero(side > BARRIER * enough)
        beyond = np.flatnonzero(side <= enough)
        beyond = beyond[beyond > barrier[0]] if len(barrier) else beyond[:0]
        if len(beyond):
            basin = beyond[: int(np.argmax(np.append(np.diff(beyond), 2) > 1)) + 1]
            found.append(int(basin[np.argmin(side[basin])]))
    return min(found) * abs(float(tried[own + 1] - tried[own])) if found else 0.0


def type_residuals(relative: Array, joint: Joint, body: Array, reach: float, settings: JointSettings) -> Array:
    """(2,) metres: median misfit of poses T_first_second (n, 4, 4) to the best joint of this type and of the other.

    `body` (b, 3) are points of the second part in its own frame. A hinge is sought within `reach`, metres, of it:
    farther off it says no more than a slide.
    """
    centre = body.mean(0)
    lever = float(np.linalg.norm(body - centre, axis=1).mean())
    slide, hinge = (fit_joint(relative, kind, centre, lever, settings) for kind in ("prismatic", "revolute"))
    near = np.linalg.norm(np.cross(se3.transform(hinge.T_zero, centre) - hinge.pivot, hinge.axis)) < reach
    hinged = [hinge.residual] if near else []
    hinged += [_bent(slide, relative, body, direction, reach) for direction in _across(slide.axis)]
    found = np.array([min(hinged), slide.residual])
    return found if joint.type == "revolute" else np.array([slide.residual, min(hinged)])


def _bent(slide: JointFit, relative: Array, body: Array, direction: Array, reach: float) -> float:
    """Median misfit, metres, of the circle of radius `reach` that leaves the slide's middle towards `direction`."""
    middle = slide.T_zero.copy()
    middle[:3, 3] += np.median(slide.states) * slide.axis
    pivot = se3.transform(middle, body.mean(0)) + reach * direction
    axis = np.cross(slide.axis, direction)
    fit = replace(slide, type="revolute", axis=axis, pivot=pivot, T_zero=middle)
    placed = np.zeros((len(relative), *body.shape))
    now = se3.transform(relative, np.broadcast_to(body, placed.shape))
    for _ in range(4):  # the best states, and the best place at state zero
        states = states_of(fit, relative, body)
        J = fit.joint().transform(states)
        fit = replace(fit, T_zero=se3.mean_pose(se3.inverse(J) @ relative))
        placed = se3.transform(J @ fit.T_zero, np.broadcast_to(body, placed.shape))
    return float(np.median(np.sqrt(((now - placed) ** 2).sum(2).mean(1))))


def _across(axis: Array) -> Array:
    """(8, 3) unit vectors round an axis."""
    u, v = np.linalg.svd(axis[None])[2][1:]
    angles = np.arange(8) * np.pi / 4
    return np.asarray(np.cos(angles)[:, None] * u + np.sin(angles)[:, None] * v)


def _motions(Ts: Array, frame: int, others: NDArray[np.int64]) -> Array:
    """(s, 2, 4, 4) of both parts from `frame` to `others`."""
    return np.stack([T[others] @ se3.inverse(T[frame]) for T in Ts], 1)
