"""strict-1, strict-2, strict-3: match parts, align frames, then measure every metric.

strict-2 measures the surfaces of the asset, and the moving part's poses. It asks where points of an answer's surface
lie: dust on the true surface, and pictures with noise around the object, score well there. In strict-3 the surface must
also stop the light: depth and silhouette are drawn from cameras that no file names, distances are balanced, pictures
have their background. `benchmarks/gaming.py` has the dishonest answers that must score worse than the honest one;
docs/protocols.md lists all differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from freeart21.truth import Truth
from leaderboard import metrics
from leaderboard.depth_views import cameras, draw, frames_of_views
from leaderboard.matching import Matched, match
from leaderboard.protocol import (
    ANGLE,
    DECIBELS,
    FRACTION,
    Case,
    Measured,
    Metric,
    Protocol,
    Render,
    Scale,
    Shape,
    to_floats,
)
from leaderboard.surface import Surface

PERCENT = Scale("%", "%", "down", 100.0)
ROTATION = Scale("deg", "deg", "down", 180.0)
AXIS_PLACE = Scale("%", None, "down", 100.0)
STATE = Scale("deg", "%", "down", None)
FACTOR = Scale("1", "1", "down", 100.0)
GRIDS = 8
"""Grids that an area is counted in: a plane along one grid fills fewer cells than across another."""
Values = dict[str, float | None]
Pair = tuple[Array, Array]
"""Arrays of the reference and the moving part."""


@dataclass(frozen=True)
class Strict:
    """The constants of one of the protocols: other values are another protocol."""

    version: int
    """3: samples are weighed by cells, and views drawn; 2: the asset's surfaces, and those of the files; 1: these."""
    samples: int = 100_000
    """Points per surface. strict-3 has fewer: cells weigh them, so more change little."""
    seed: int = 0
    """Seed of the samples."""
    poses: int = 5
    """Frames, spread over the joint range, whose surface distances are averaged."""
    near: float = 0.01
    """Threshold of the F-score, in diagonals."""
    seen_share: float = 0.01
    """Least share of the visible foreground for each part in a frame that counts for `state`."""
    signless: float = 1e-9
    """Cosine of the angle between the axes below which the sign of the predicted axis is undetermined."""
    cell: float = 0.01
    """Side of the cells whose samples count as one, in diagonals."""
    area_cell: float = 0.02
    """Side of the cells, in diagonals, that measure an area by how many of them hold samples: faces upon faces add
    nothing, and the samples fill these cells."""
    thin_cell: float = 0.0025
    """Side of the cells, in diagonals, in which the faces of a surface must have some area together."""
    thin: float = 0.05
    """That area, in the cells' squared sides: faces in thinner cells (dust, needles) are no surface that anything can
    be near to. A plane through a cell has an area of 1 there."""
    tail: float = 0.95
    """Share of the pixels whose depth error `depth_95` bounds."""
    background: int = 255
    """Of all three channels, around the object in a picture."""
    tolerance: int = 5
    """A pixel whose channels are all this near the background belongs to it: 2 %."""


STANDARD = {1: Strict(1), 2: Strict(2), 3: Strict(3, samples=30_000)}


def measure(case: Case, constants: Strict) -> Measured:
    """The metrics of a protocol; the part files replace an asset that there is not. strict-1 looks at neither asset nor
    renders of the other choice."""
    c, truth, matched = constants, case.truth, match(case.truth, case.answer, case.lacks)
    values = _joint_values(truth, matched, c)
    values |= {"miou": matched.miou, **_pose_values(truth, matched, 0)}
    if c.version == 1:
        values |= {**surface_values(truth, matched, matched.shape, c), **picture_values(truth, case.renders, c)}
        return Measured(to_floats(values), matched.swapped)
    shape = matched.shape
    if case.asset is not None:
        shape = (case.asset.swapped() if matched.swapped else case.asset).moved(matched.T_truth_pred)
    values |= {**_pose_values(truth, matched, 1), **surface_values(truth, matched, shape, c)}
    if c.version == 2:
        of_parts = values if shape is matched.shape else surface_values(truth, matched, matched.shape, c)
        values |= {f"{id}_parts": of_parts[id] for id in SURFACES if id in of_parts}
    else:
        values |= depth_values(truth, matched, shape, c)
    other_views = matched.swapped and case.renders_other is not None
    renders = case.renders_other if other_views and case.renders_other is not None else case.renders
    values |= picture_values(truth, renders, c)
    return Measured(to_floats(values), matched.swapped, other_views)


def both_seen(truth: Truth, share: float) -> NDArray[np.bool_]:
    """(n,) frames in which each part has `share` or more of the visible foreground; all frames when there is none."""
    frames = (truth.seen >= share * truth.seen.sum(1, keepdims=True)).all(1) & (truth.seen > 0).all(1)
    return frames if frames.any() else np.ones(len(truth), bool)


def spread_frames(states: Array, count: int) -> list[int]:
    """The frames whose states lie nearest to `count` values spread evenly from the smallest to the largest."""
    return [int(np.argmin(np.abs(states - state))) for state in np.linspace(states.min(), states.max(), count)]


def _joint_values(truth: Truth, matched: Matched, c: Strict) -> Values:
    true, joint, states = truth.articulation.joint, matched.answer.articulation.joint, matched.answer.states
    if joint.type != true.type:  # the other joint metrics are undefined and penalised
        return {"joint_type": 0.0}
    revolute = true.type == "revolute"
    cosine = float(true.axis @ joint.axis)
    signs = (1.0, -1.0) if abs(cosine) < c.signless else (float(np.sign(cosine)),)
    per_diagonal = 100 / matched.diagonal
    scale = np.rad2deg(1.0) if revolute else per_diagonal

    def state(frames: NDArray[np.bool_]) -> float:
        return scale * min(metrics.state_error(truth.states[frames], states[frames], sign, revolute) for sign in signs)

    values: Values = {
        "joint_type": 1.0,
        "axis": np.rad2deg(metrics.axis_error(true.axis, joint.axis)),
        "state": state(both_seen(truth, c.seen_share)),
        "state_all": state(np.ones(len(truth), bool)),
    }
    if revolute:
        lines = true.axis, true.pivot, joint.axis, joint.pivot
        values["position"] = per_diagonal * metrics.position_error(matched.outer[1].centre, *lines)
        values["position_line"] = per_diagonal * metrics.line_to_line(*lines)
    return values


def _pose_values(truth: Truth, matched: Matched, part: int) -> Values:
    """Pose errors of the reference part (0), or of the moving one (1) after a separate alignment, as methods choose its
    frame and state zero."""
    centre = matched.outer[part].centre
    true, found = truth.Ts_camera_reference, matched.answer.Ts_camera_reference
    if part:
        true, found = truth.Ts_camera_moving, matched.answer.Ts_camera_moving
        found = found @ se3.inverse(metrics.align(true, found, centre))
    angle, shift = metrics.pose_error(true, found, centre)
    name = "pose_moving" if part else "pose"
    return {f"{name}_rotation": np.rad2deg(angle), f"{name}_translation": 100 * shift / matched.diagonal}


def _frames(truth: Truth, matched: Matched, c: Strict) -> list[int]:
    """The frames whose states spread over the range; the anchor alone without states."""
    return [matched.answer.anchor] if "states" in matched.lacks else spread_frames(truth.states, c.poses)


def _poses(truth: Truth, matched: Matched, shape: Shape, frame: int) -> tuple[Pair, Pair]:
    """Camera from both parts, of the truth and of the answer."""
    reference = matched.answer.Ts_camera_reference[frame]
    true = truth.Ts_camera_reference[frame], truth.Ts_camera_moving[frame]
    return true, (reference, reference @ shape.motions[frame])


# ---- surfaces

SURFACES = ("chamfer_s", "chamfer_m", "chamfer_w", "fscore")


class _Samples:
    """Points of both parts' surfaces, and what each counts."""

    def __init__(self, surfaces: Sequence[Surface], side: int, diagonal: float, c: Strict) -> None:
        """`side`: 0 for the truth's samples, 1 for the answer's."""
        first, second = (surface.sample(c.samples, (c.seed, side, part)) for part, surface in enumerate(surfaces))
        self.points: Pair = (first, second)
        if c.version == 3:  # all points of both are those of the whole object, the ones of a cell count as one
            self.counts: tuple[int | None, int | None] = (None, None)
            self.weights = [cell_weights(points, c.cell * diagonal) for points in self.points]
            return
        # In proportion to area, the first points of both are those of the whole object.
        total = surfaces[0].area + surfaces[1].area
        count = round(c.samples * surfaces[0].area / total) if total else 0
        self.counts = (count, c.samples - count if not surfaces[1].empty else 0)
        self.weights = [np.ones(len(points)) for points in self.points]

    def whole_weights(self) -> Array:
        """Of the points of the whole object."""
        return np.concatenate([w[:count] for w, count in zip(self.weights, self.counts, strict=True)])


def surface_values(truth: Truth, matched: Matched, shape: Shape, c: Strict) -> Values:
    """Chamfer distances, averaged over frames, and the F-score or (strict-3) the ratio of areas.

    `shape` is in the matched answer's canonical frame. No entry where it has no surface. A true part that the video
    never shows is sampled over its whole outer surface. In strict-3, the samples of a cell count as one, so that no
    crowd of triangles outweighs the rest, and what the truth is near to must have an area, so that a mist about the
    surface brings nothing nearer.
    """
    outer, diagonal, found = matched.outer, matched.diagonal, (Surface(shape.parts[0]), Surface(shape.parts[1]))
    near = found
    if c.version == 3:
        solid = [Surface(mesh, has_area(mesh, c.thin_cell * diagonal, c.thin)) for mesh in shape.parts]
        near = solid[0], solid[1]
    visible = [Surface(truth.articulation.part(name), faces) for name, faces in zip(PARTS, truth.visible, strict=True)]
    shown = [v if not v.empty else o for v, o in zip(visible, outer, strict=True)]
    of_truth, of_answer = _Samples(shown, 0, diagonal, c), _Samples(found, 1, diagonal, c)
    weights = [(*samples.weights, samples.whole_weights()) for samples in (of_truth, of_answer)]
    sums: dict[str, list[float]] = {}
    for frame in _frames(truth, matched, c):
        true_poses, found_poses = _poses(truth, matched, shape, frame)
        forward = part_distances(of_truth.points, true_poses, near, found_poses, of_truth.counts)
        backward = part_distances(of_answer.points, found_poses, outer, true_poses, of_answer.counts)
        for k, id in enumerate(SURFACES[:3]):
            if len(backward[k]) and np.isfinite(forward[k]).all():
                both = (np.average(d[k], weights=w[k]) for d, w in zip((forward, backward), weights, strict=True))
                sums.setdefault(id, []).append(50 * sum(both) / diagonal)
        if "chamfer_w" in sums and c.version < 3:
            sums.setdefault("fscore", []).append(metrics.fscore(forward[2], backward[2], c.near * diagonal))
    values: Values = {id: float(np.mean(numbers)) for id, numbers in sums.items()}
    if c.version == 3:
        every = [surface.sample(c.samples, (c.seed, 1, part)) for part, surface in enumerate(outer)]
        side = c.area_cell * diagonal
        cells, true_cells = (sum(count_cells(points, side) for points in both) for both in (of_answer.points, every))
        if cells:
            values["area"] = max(cells / true_cells, true_cells / cells) - 1
    return values


def part_distances(
    points: Pair,
    poses: Pair,
    targets: tuple[Surface, Surface],
    target_poses: Pair,
    counts: tuple[int | None, int | None] = (None, None),
) -> tuple[Array, Array, Array]:
    """Distances, metres, from points of the reference part to the target's, moving to moving, and whole to whole.

    The whole has the first `counts` points of each, or all. Their distance is the smaller of those to the target's two
    parts, each computed in that part's frame.
    """
    owns, wholes = [], []
    for part in (0, 1):
        here = se3.inverse(target_poses[part]) @ poses[part]
        there = se3.inverse(target_poses[1 - part]) @ poses[part]
        own, some = targets[part].distance(se3.transform(here, points[part])), slice(counts[part])
        owns.append(own)
        wholes.append(targets[1 - part].distance(se3.transform(there, points[part][some]), own[some]))
    return owns[0], owns[1], np.concatenate(wholes)


def cell_weights(points: Array, side: float) -> Array:
    """(n,) weights of points (n, 3): those of a cell of this side, metres, have a weight of 1 together."""
    _, at, counts = np.unique(_cells(points, side), return_inverse=True, return_counts=True)
    return np.asarray(1.0 / counts[at.reshape(-1)])


def count_cells(points: Array, side: float) -> float:
    """Number of cells of this side, metres, that hold points (n, 3): the mean over grids turned in all directions."""
    turns = Rotation.random(GRIDS, random_state=0).as_matrix()
    return float(np.mean([len(np.unique(_cells(points @ turn.T, side))) for turn in turns])) if len(points) else 0.0


def has_area(mesh: Mesh, side: float, least: float) -> NDArray[np.bool_]:
    """(F,) faces whose cell of this side, metres, holds faces with an area of `least` squared sides together."""
    _, at = np.unique(_cells(mesh.vertices[mesh.faces].mean(1), side), return_inverse=True)
    areas = np.bincount(at.reshape(-1), mesh.areas())
    return np.asarray(areas >= least * side**2)[at.reshape(-1)]


def _cells(points: Array, side: float) -> NDArray[np.int64]:
    """(n,) number of the cell of each point (n, 3), wherever the points lie."""
    number = np.zeros(len(points), np.int64)
    for column in np.floor(points / side).T:
        values, at = np.unique(column, return_inverse=True)
        _, number = np.unique(number * len(values) + at.reshape(-1), return_inverse=True)
        number = number.reshape(-1)
    return number


# ---- views


def depth_values(truth: Truth, matched: Matched, shape: Shape, c: Strict) -> Values:
    """Depth errors where the cameras see faces that the video showed, and the silhouettes' intersection over union.

    No entry where the answer has no surface. A pixel where the answer has none is 100 % off.
    """
    if shape.parts[0].empty and shape.parts[1].empty:
        return {}
    parts = truth.articulation.reference, truth.articulation.moving
    errors, both, either = [], 0, 0
    for T_view_object, frame in zip(_looks(truth, matched), frames_of_views(_frames(truth, matched, c)), strict=True):
        true_poses, found_poses = _poses(truth, matched, shape, frame)
        T_view_camera = T_view_object @ se3.inverse(true_poses[0])
        true, found = (
            draw(meshes, (T_view_camera @ poses[0], T_view_camera @ poses[1]))
            for meshes, poses in ((parts, true_poses), (shape.parts, found_poses))
        )
        hit, given = true.part >= 0, found.part >= 0
        both, either = both + int((hit & given).sum()), either + int((hit | given).sum())
        seen = np.zeros_like(hit)
        for k, flags in enumerate(truth.visible):
            own = true.part == k
            seen[own] = flags[true.face[own]]
        off = np.abs(np.where(given, found.depth, np.inf)[seen] - true.depth[seen])
        errors.append(np.minimum(100 * off / matched.diagonal, 100.0))
    every = np.concatenate(errors)
    values: Values = {"silhouette": both / either if either else 0.0}
    if len(every):
        values |= {"depth_median": float(np.median(every)), "depth_95": float(np.quantile(every, c.tail))}
    return values


def _looks(truth: Truth, matched: Matched) -> Array:
    """Cameras about the middle of the object in frame 0, in the truth's canonical frame."""
    moving = truth.articulation.moving.moved(truth.articulation.joint.transform(truth.states[0]))
    corners = np.concatenate([truth.articulation.reference.vertices, moving.vertices])
    return cameras(0.5 * (corners.min(0) + corners.max(0)), matched.diagonal)


def picture_values(truth: Truth, renders: Sequence[Render], c: Strict) -> Values:
    """PSNR and SSIM, averaged over the queries that show the object; None without such a query.

    Before strict-3 inside the mask alone; there over whole pictures, with the silhouettes' intersection over union.
    """
    whole = c.version == 3
    found: list[tuple[float, float, float]] = []
    for i, render in enumerate(renders):
        mask = truth.query_mask(i)
        if not mask.any():
            continue
        if render is None:
            found.append((0.0, 0.0, 0.0))
            continue
        picture, counted = truth.query_rgb(i), mask
        if whole:
            picture = np.where(mask[..., None], picture, np.uint8(c.background)).astype(np.uint8)
            counted = np.ones(mask.shape, bool)
        iou = _silhouette_iou(picture, render, mask, c) if whole else 0.0
        found.append((metrics.psnr(picture, render, counted), metrics.ssim(picture, render, counted), iou))
    ids = ("psnr", "ssim", "view_iou") if whole else ("psnr", "ssim")
    if not found:
        return dict.fromkeys(ids)
    return dict(zip(ids, np.mean(found, axis=0), strict=False))


def _silhouette_iou(picture: NDArray[np.uint8], render: NDArray[np.uint8], mask: NDArray[np.bool_], c: Strict) -> float:
    """Pixels of the object that look like the background count in neither."""
    given, plain = ((p.astype(int) < c.background - c.tolerance).any(-1) for p in (render, picture))
    hit, counted = mask & plain, ~mask | plain
    either = int((counted & (given | hit)).sum())
    return int((counted & given & hit).sum()) / either if either else 1.0


# ---- what the protocols say


def penalties(truth: Truth) -> Values:
    """The penalty of the states: the range of motion, deg or % of the diagonal."""
    motion = truth.range_of_motion
    revolute = truth.articulation.joint.type == "revolute"
    penalty = float(np.rad2deg(motion)) if revolute else 100 * motion / truth.diagonal
    return {"state": penalty, "state_all": penalty}


_STATE = (
    "mean absolute difference over {}; one global sign, that of the dot product of the two axes; the offset that makes "
    "it smallest (the median) removed; revolute states wrapped"
)
_BOTH = (
    "frames in which the truth shows both parts with 1 % or more of the foreground each (over all frames when "
    "there is none)"
)
_OWN_ALIGNMENT = (
    "over all frames after an alignment of its own, the robust mean of the moving part's poses: its canonical frame "
    "and state zero are the method's affair, so this is how well the part is followed, whatever the joint"
)
_DRAWN = (
    "24 cameras on a sphere of 3 diagonals about the object, 256 x 256 pixels, at five states spread over the range in "
    "turn; both posed in the camera frame by each side's own reference pose and state"
)
_SAMPLES = "100k seeded samples"
_BALANCED = (
    "30k seeded samples a part, those of a cell of 1 % of the diagonal counting as one; faces whose cell of .25 % "
    "holds less area than .05 squared sides are nothing that the truth is near to"
)
_JOINT: tuple[Metric, ...] = (
    Metric("joint_type", *FRACTION, "1 when the joint's type is right, else 0", label="joint type", needs=("joint",)),
    Metric(
        "axis",
        *ANGLE,
        "arccos of the clipped absolute dot product of the axes",
        label="axis direction",
        column="axis",
        needs=("joint",),
    ),
    Metric(
        "position",
        *AXIS_PLACE,
        "distance from the point of the true axis nearest the moving part's centre to the predicted line",
        label="place of the axis",
        column="place",
        needs=("joint",),
    ),
    Metric(
        "position_line",
        *AXIS_PLACE,
        "distance between the two axes as lines; point to line when they are parallel within 1e-6",
        "position",
        label="place of the axis, line to line",
        needs=("joint",),
    ),
    Metric("state", *STATE, _STATE.format(_BOTH), label="joint state", column="state", needs=("joint", "states")),
    Metric(
        "state_all", *STATE, _STATE.format("all frames"), label="joint state, all frames", needs=("joint", "states")
    ),
)
_MASKS = Metric(
    "miou",
    *FRACTION,
    "intersection over union, mean over frames and both parts; a part absent in both counts 1",
    label="part masks (mIoU)",
    column="mIoU",
    needs=("masks",),
)
_OUTSIDE = (
    Metric(
        "depth_median",
        *PERCENT,
        "median difference of the z-depths of first hits, over pixels where the truth's is a face that the video "
        f"shows; {_DRAWN}",
        label="depth from outside, median",
        needs=("joint", "meshes"),
    ),
    Metric(
        "depth_95",
        *PERCENT,
        "the difference that 95 % of the same pixels do not exceed; a pixel without a surface is 100 % off",
        label="depth from outside, 95 %",
        column="depth\n95 %",
        needs=("joint", "meshes"),
    ),
    Metric(
        "silhouette",
        *FRACTION,
        f"intersection over union of the silhouettes, all views together; {_DRAWN}",
        label="silhouette of the surfaces",
        column="sil.\nIoU",
        needs=("joint", "meshes"),
    ),
    Metric(
        "area",
        *FACTOR,
        "cells of 2 % of the diagonal that hold samples of the answer's surfaces, and of the truth's outer ones, mean "
        "of 8 grids: by what share the larger count is larger",
        label="area of the surfaces",
        needs=("meshes",),
    ),
)
_FSCORE = Metric(
    "fscore",
    *FRACTION,
    "whole object: harmonic mean of precision and recall of the same samples within 1 % of the diagonal",
    label="F-score, whole object",
    needs=("joint", "meshes"),
)
_PICTURES = {  # of strict-1 and strict-2, and of strict-3
    "psnr": (
        "held-out queries, uint8, over the pixels of the truth's mask, white elsewhere, mean over queries; at most "
        "100; no search at test time; a missing render counts 0",
        "held-out queries, uint8, over the whole picture with a white background; at most 100; mean over queries; no "
        "search at test time; a missing render counts 0",
    ),
    "ssim": (
        "structural similarity (Gaussian window, sigma 1.5) of the same pictures, mean over the mask's pixels",
        "structural similarity (Gaussian window, sigma 1.5) of the same pictures, mean over all pixels",
    ),
}
_VIEW_IOU = Metric(
    "view_iou",
    *FRACTION,
    "intersection over union of the truth's mask and the render's pixels that are not white (a channel under 250); "
    "white pixels of the object count in neither; mean over queries",
    label="silhouette of held-out views",
    needs=("renders",),
)


def _metrics(version: int) -> tuple[Metric, ...]:
    """All metrics of a protocol, in the order of its tables. strict-3 has shorter and fewer columns."""
    brief = version == 3
    surfaces = [
        _surface("chamfer_w", "whole object", "cham.\nwhole", brief),
        _surface("chamfer_m", "moving part", "cham.\nmov." if brief else "cham.\nmoving", brief),
        _surface("chamfer_s", "reference part", "" if brief else "cham.\nref.", brief),
    ]
    poses = _poses_of("pose", "reference part", "" if brief else "ref.\npart", "after alignment")
    moving = _poses_of("pose_moving", "moving part", "mov.\npart" if brief else "moving\npart", _OWN_ALIGNMENT)
    views = [
        Metric("psnr", *DECIBELS, _PICTURES["psnr"][brief], None, "held-out views (PSNR)", "views\nPSNR", ("renders",)),
        Metric("ssim", *FRACTION, _PICTURES["ssim"][brief], "psnr", "held-out views (SSIM)", "", ("renders",)),
    ]
    if version == 1:
        return (*_JOINT, _MASKS, *poses, *surfaces, _FSCORE, *views)
    if version == 2:
        of_parts = [_of_parts(metric) for metric in (*surfaces, _FSCORE)]
        return (*_JOINT, _MASKS, *poses, *moving, *surfaces, _FSCORE, *of_parts, *views)
    return (*_JOINT, _MASKS, *poses, *moving, *surfaces, *_OUTSIDE, *views, _VIEW_IOU)


def _poses_of(id: str, what: str, column: str, after: str) -> tuple[Metric, Metric]:
    over = after if after.startswith("over") else f"over all frames {after}"
    turned, placed = f"mean geodesic error of the {what} {over}", f"mean distance of the {what}'s centre {over}"
    return (
        Metric(f"{id}_rotation", *ROTATION, turned, None, f"rotation of the {what}", column, ("poses",)),
        Metric(f"{id}_translation", *PERCENT, placed, None, f"place of the {what}", "", ("poses",)),
    )


def _surface(id: str, what: str, column: str, balanced: bool) -> Metric:
    return Metric(
        id,
        *PERCENT,
        f"{what}: mean of the two directed mean distances, point to triangle, {_BALANCED if balanced else _SAMPLES}; "
        "truth to prediction samples the truth's visible surface, prediction to truth measures to the whole outer "
        "surface; averaged over the five frames whose true states lie nearest to five values spread evenly over the "
        "range, parts posed in the camera frame by each side's own reference pose and state",
        label=f"chamfer, {what}",
        column=column,
        needs=("meshes",) if id.endswith("_s") else ("joint", "meshes"),  # the moving part is posed by the joint
    )


def _of_parts(metric: Metric) -> Metric:
    """The same metric measured from the part files."""
    return replace(
        metric,
        id=f"{metric.id}_parts",
        definition=f"{metric.id} measured from parts/*.ply instead of the asset's visual meshes",
        supplements=metric.id,
        label=f"{metric.label}, from the part files",
        column="",
    )


_PREAMBLE = (
    "Parts are matched to the truth by the better mIoU of the two labelings; on a tie, by the reference poses. "
    "T_truth_pred is the robust mean (chordal L2 for the rotation, translation at the centre of the truth's reference "
    "part, 2 sigma trimmed) over all frames of T_camera_reference(truth)^-1 T_camera_reference(prediction); never "
    "chosen by the joint; scale 1; no registration of parts. A part's centre is that of its outer surface's area. "
    "Lengths are in % of the diagonal of the truth's bounding box at frame 0, cm beside. The joint is measured from "
    "the asset, reloaded and driven in SAPIEN, states beyond its limits driven to the limit{}. Means and sample "
    "standard deviations (ddof 1) are over all sequences of a joint type: a failure or a missing sequence is priced, "
    "never dropped."
)
_OF_ASSETS = (
    ". Surfaces are the asset's own visual meshes, placed by the simulator's link poses at the answer's states; {}. "
    "Without an asset both are read from the files and marked so. An asset with a broken mesh or mass is a failure. "
    "Held-out views may be given for both choices of the reference part; those of the matched choice count. A price is "
    "a cap: no number costs more than a failure"
)

STRICT_1 = Protocol(
    "strict-1",
    _PREAMBLE.format("; without an asset, read from the files and marked so"),
    _metrics(1),
    partial(measure, constants=STANDARD[1]),
    asset="joint",
    sequence_penalties=penalties,
)
STRICT_2 = Protocol(
    "strict-2",
    _PREAMBLE.format(_OF_ASSETS.format("those of the part files stand beside")),
    _metrics(2),
    partial(measure, constants=STANDARD[2]),
    asset="whole",
    capped=True,
    ranking=True,
    sequence_penalties=penalties,
)
STRICT_3 = replace(
    STRICT_2,
    name="strict-3",
    preamble=_PREAMBLE.format(_OF_ASSETS.format("part files are not measured then")),
    metrics=_metrics(3),
    measure=partial(measure, constants=STANDARD[3]),
)
