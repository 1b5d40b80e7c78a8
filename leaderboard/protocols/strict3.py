"""strict-3: strict-2 with surfaces as they look from outside, balanced distances, and pictures with their background.

strict-2 asks where points of an answer's surface lie; dust on the true surface, and pictures with noise around the
object, score well there. Here the surface must also stop the light: depth and silhouette are drawn from cameras that
no file names. `benchmarks/gaming.py` has the dishonest answers that must score worse than the honest one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from leaderboard.protocol import FRACTION, Case, Measured, Metric, Protocol, Render, Scale, Shape, to_floats
from leaderboard.protocols.strict1 import PERCENT, Strict1, answer_values, part_distances, penalties, spread_frames
from leaderboard.protocols.strict2 import STRICT_2, moving_pose_values
from leaderboard.surface import Surface

FACTOR = Scale("1", "1", "down", 100.0)


GRIDS = 8
"""Grids that an area is counted in: a plane along one grid fills fewer cells than across another."""


@dataclass(frozen=True)
class Strict3(Strict1):
    """The constants of the protocol: other values are another protocol."""

    samples: int = 30_000
    """Points per part: cells weigh them, so more change little."""
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


STANDARD = Strict3()


def measure(case: Case, constants: Strict3 = STANDARD) -> Measured:
    """The metrics of strict-3; the part files replace an asset that there is not."""
    truth, matched = case.truth, match(case.truth, case.answer, case.lacks)
    shape = matched.shape
    if case.asset is not None:
        shape = (case.asset.swapped() if matched.swapped else case.asset).moved(matched.T_truth_pred)
    other_views = matched.swapped and case.renders_other is not None
    renders = case.renders_other if other_views and case.renders_other is not None else case.renders
    values = {
        **answer_values(truth, matched, constants),
        **moving_pose_values(truth, matched),
        **distance_values(truth, matched, shape, constants),
        **depth_values(truth, matched, shape, constants),
        **picture_values(truth, renders, constants),
    }
    return Measured(to_floats(values), matched.swapped, other_views)


def distance_values(truth: Truth, matched: Matched, shape: Shape, c: Strict3) -> dict[str, float | None]:
    """Balanced Chamfer distances, averaged over frames, and the ratio of areas (in cells).

    No entry where the answer has no surface. The samples of a cell count as one: no crowd of triangles outweighs the
    rest. What the truth is near to must have an area, so that a mist about the surface brings nothing nearer.
    """
    outer, found = matched.outer, (Surface(shape.parts[0]), Surface(shape.parts[1]))
    solid = tuple(Surface(mesh, has_area(mesh, c.thin_cell * matched.diagonal, c.thin)) for mesh in shape.parts)
    visible = [Surface(truth.articulation.part(name), faces) for name, faces in zip(PARTS, truth.visible, strict=True)]
    shown = [v if not v.empty else o for v, o in zip(visible, outer, strict=True)]
    true_points = [surface.sample(c.samples, (c.seed, 0, part)) for part, surface in enumerate(shown)]
    found_points = [surface.sample(c.samples, (c.seed, 1, part)) for part, surface in enumerate(found)]
    side = c.cell * matched.diagonal
    true_weights, found_weights = (
        [cell_weights(points, side) for points in both] for both in (true_points, found_points)
    )
    sums: dict[str, list[float]] = {}
    for frame in _frames(truth, matched, c):
        true_poses, found_poses = _poses(truth, matched, shape, frame)
        there = part_distances(true_points, true_poses, (solid[0], solid[1]), found_poses)
        back = part_distances(found_points, found_poses, outer, true_poses)
        for id, own in (("chamfer_s", 0), ("chamfer_m", 1)):
            if found_points[own].size and np.isfinite(there[own][0]).all():
                means = (_mean(d[own][0], w[own]) for d, w in ((there, true_weights), (back, found_weights)))
                sums.setdefault(id, []).append(50 * sum(means) / matched.diagonal)
        whole = [np.concatenate([d[0][1], d[1][1]]) for d in (there, back)]
        if len(whole[1]) and np.isfinite(whole[0]).all():
            weights = (np.concatenate(true_weights), np.concatenate(found_weights))
            means = (_mean(d, w) for d, w in zip(whole, weights, strict=True))
            sums.setdefault("chamfer_w", []).append(50 * sum(means) / matched.diagonal)
    values: dict[str, float | None] = {id: float(np.mean(numbers)) for id, numbers in sums.items()}
    every = [surface.sample(c.samples, (c.seed, 1, part)) for part, surface in enumerate(outer)]
    cells = [
        sum(count_cells(points, c.area_cell * matched.diagonal) for points in both) for both in (found_points, every)
    ]
    if cells[0]:
        values["area"] = max(cells[0] / cells[1], cells[1] / cells[0]) - 1
    return values


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


def _mean(values: Array, weights: Array) -> float:
    return float(np.average(values, weights=weights))


def depth_values(truth: Truth, matched: Matched, shape: Shape, c: Strict3) -> dict[str, float | None]:
    """Depth errors where the cameras see faces that the video showed, and the silhouettes' intersection over union.

    No entry where the answer has no surface. A pixel where the answer has none is 100 % off.
    """
    if shape.parts[0].empty and shape.parts[1].empty:
        return {}
    parts = truth.articulation.reference, truth.articulation.moving
    errors, both, either = [], 0, 0
    looks = _looks(truth, matched)
    for T_view_object, frame in zip(looks, frames_of_views(_frames(truth, matched, c)), strict=True):
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
    values: dict[str, float | None] = {"silhouette": both / either if either else 0.0}
    if len(every):
        values |= {"depth_median": float(np.median(every)), "depth_95": float(np.quantile(every, c.tail))}
    return values


def picture_values(truth: Truth, renders: Sequence[Render], c: Strict3 = STANDARD) -> dict[str, float | None]:
    """PSNR and SSIM over the whole pictures and the silhouettes' intersection over union, averaged over the queries.

    None without a query that shows the object.
    """
    found: list[tuple[float, float, float]] = []
    for i, render in enumerate(renders):
        mask = truth.query_mask(i)
        if not mask.any():
            continue
        if render is None:
            found.append((0.0, 0.0, 0.0))
            continue
        picture = np.where(mask[..., None], truth.query_rgb(i), np.uint8(c.background)).astype(np.uint8)
        everywhere = np.ones(mask.shape, bool)
        found.append(
            (
                metrics.psnr(picture, render, everywhere),
                metrics.ssim(picture, render, everywhere),
                _silhouette_iou(picture, render, mask, c),
            )
        )
    if not found:
        return {"psnr": None, "ssim": None, "view_iou": None}
    psnr, ssim, iou = np.mean(found, axis=0)
    return {"psnr": float(psnr), "ssim": float(ssim), "view_iou": float(iou)}


def _silhouette_iou(
    picture: NDArray[np.uint8], render: NDArray[np.uint8], mask: NDArray[np.bool_], c: Strict3
) -> float:
    """Pixels of the object that look like the background count in neither."""
    given, plain = ((p.astype(int) < c.background - c.tolerance).any(-1) for p in (render, picture))
    hit, counted = mask & plain, ~mask | plain
    either = int((counted & (given | hit)).sum())
    return int((counted & given & hit).sum()) / either if either else 1.0


def _frames(truth: Truth, matched: Matched, c: Strict1) -> list[int]:
    """The frames whose states spread over the range; the anchor alone without states."""
    return [matched.answer.anchor] if "states" in matched.lacks else spread_frames(truth.states, c.poses)


def _poses(truth: Truth, matched: Matched, shape: Shape, frame: int) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Camera from both parts, of the truth and of the answer."""
    reference = matched.answer.Ts_camera_reference[frame]
    true = truth.Ts_camera_reference[frame], truth.Ts_camera_moving[frame]
    return true, (reference, reference @ shape.motions[frame])


def _looks(truth: Truth, matched: Matched) -> Array:
    """Cameras about the middle of the object in frame 0, in the truth's canonical frame."""
    moving = truth.articulation.moving.moved(truth.articulation.joint.transform(truth.states[0]))
    corners = np.concatenate([truth.articulation.reference.vertices, moving.vertices])
    return cameras(0.5 * (corners.min(0) + corners.max(0)), matched.diagonal)


def _balanced(metric: Metric) -> Metric:
    return replace(
        metric,
        definition=metric.definition.replace(
            "100k seeded samples",
            "30k seeded samples a part, those of a cell of 1 % of the diagonal counting as one; faces whose cell of "
            ".25 % holds less area than .05 squared sides are nothing that the truth is near to",
        ),
    )


_DRAWN = (
    "24 cameras on a sphere of 3 diagonals about the object, 256 x 256 pixels, at five states spread over the range in "
    "turn; both posed in the camera frame by each side's own reference pose and state"
)
_NEW = (
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
_PICTURES = {
    "psnr": "held-out queries, uint8, over the whole picture with a white background; at most 100; mean over queries; "
    "no search at test time; a missing render counts 0",
    "ssim": "structural similarity (Gaussian window, sigma 1.5) of the same pictures, mean over all pixels",
}


def _strict_3_metrics() -> tuple[Metric, ...]:
    """Those of strict-2 without the part files' surfaces and the F-score."""
    found: list[Metric] = []
    for metric in STRICT_2.metrics:
        if metric.id == "fscore" or metric.id.endswith("_parts"):
            continue
        if metric.id == "psnr":
            found += _NEW
        if metric.id in _PICTURES:
            metric = replace(metric, definition=_PICTURES[metric.id])
        metric = _balanced(metric) if metric.id.startswith("chamfer") else metric
        short = "" if metric.id in ("chamfer_s", "pose_rotation") else metric.column.replace("moving", "mov.")
        found.append(replace(metric, column=short))
    silhouette = Metric(
        "view_iou",
        *FRACTION,
        "intersection over union of the truth's mask and the render's pixels that are not white (a channel under 250); "
        "white pixels of the object count in neither; mean over queries",
        label="silhouette of held-out views",
        needs=("renders",),
    )
    return (*found, silhouette)


STRICT_3 = Protocol(
    "strict-3",
    STRICT_2.preamble.replace(
        "those of the part files stand beside. Without", "part files are not measured then. Without"
    ),
    _strict_3_metrics(),
    measure,
    asset="whole",
    capped=True,
    ranking=True,
    sequence_penalties=penalties,
)
