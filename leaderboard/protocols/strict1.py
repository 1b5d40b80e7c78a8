"""strict-1: match parts, align frames, then measure every metric."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array
from freeart21.truth import Truth
from leaderboard import metrics
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
Pair = tuple[Array, Array]
"""Arrays of the reference and the moving part."""


@dataclass(frozen=True)
class Strict1:
    """The constants of the protocol: other values are another protocol."""

    samples: int = 100_000
    """Points per surface."""
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


STANDARD = Strict1()


def measure(case: Case, constants: Strict1 = STANDARD) -> Measured:
    """The metrics of strict-1; asset and renders of the other choice are not used."""
    matched = match(case.truth, case.answer, case.lacks)
    values = {
        **answer_values(case.truth, matched, constants),
        **surface_values(case.truth, matched, matched.shape, constants),
        **picture_values(case.truth, case.renders),
    }
    return Measured(to_floats(values), matched.swapped)


def answer_values(truth: Truth, matched: Matched, c: Strict1) -> dict[str, float | None]:
    """The metrics of joint, masks and the reference part's poses."""
    outer, diagonal = matched.outer, matched.diagonal
    angle, shift = metrics.pose_error(truth.Ts_camera_reference, matched.answer.Ts_camera_reference, outer[0].centre)
    return {
        **_joint_values(truth, matched.answer, outer[1].centre, diagonal, c),
        "miou": matched.miou,
        "pose_rotation": np.rad2deg(angle),
        "pose_translation": 100 * shift / diagonal,
    }


def both_seen(truth: Truth, share: float) -> NDArray[np.bool_]:
    """(n,) frames in which each part has `share` or more of the visible foreground; all frames when there is none."""
    frames = (truth.seen >= share * truth.seen.sum(1, keepdims=True)).all(1) & (truth.seen > 0).all(1)
    return frames if frames.any() else np.ones(len(truth), bool)


def spread_frames(states: Array, count: int) -> list[int]:
    """The frames whose states lie nearest to `count` values spread evenly from the smallest to the largest."""
    return [int(np.argmin(np.abs(states - state))) for state in np.linspace(states.min(), states.max(), count)]


def _joint_values(
    truth: Truth, aligned: Reconstruction, centre: Array, diagonal: float, c: Strict1
) -> dict[str, float | None]:
    true, joint = truth.articulation.joint, aligned.articulation.joint
    if joint.type != true.type:  # the other joint metrics are undefined and penalised
        return {"joint_type": 0.0}
    revolute = true.type == "revolute"
    cosine = float(true.axis @ joint.axis)
    signs = (1.0, -1.0) if abs(cosine) < c.signless else (float(np.sign(cosine)),)
    per_diagonal = 100 / diagonal
    scale = np.rad2deg(1.0) if revolute else per_diagonal

    def state(frames: NDArray[np.bool_]) -> float:
        return scale * min(
            metrics.state_error(truth.states[frames], aligned.states[frames], sign, revolute) for sign in signs
        )

    values: dict[str, float | None] = {
        "joint_type": 1.0,
        "axis": np.rad2deg(metrics.axis_error(true.axis, joint.axis)),
        "state": state(both_seen(truth, c.seen_share)),
        "state_all": state(np.ones(len(truth), bool)),
    }
    if revolute:
        lines = true.axis, true.pivot, joint.axis, joint.pivot
        values["position"] = per_diagonal * metrics.position_error(centre, *lines)
        values["position_line"] = per_diagonal * metrics.line_to_line(*lines)
    return values


def surface_values(truth: Truth, matched: Matched, shape: Shape, c: Strict1) -> dict[str, float | None]:
    """Chamfer distances and F-score, averaged over the chosen frames; no entry where the answer has no surface.

    `shape` is in the matched answer's canonical frame. A true part that the video never shows is sampled over its whole
    outer surface.
    """
    outer, diagonal = matched.outer, matched.diagonal
    visible = [Surface(truth.articulation.part(name), faces) for name, faces in zip(PARTS, truth.visible, strict=True)]
    shown = [v if not v.empty else o for v, o in zip(visible, outer, strict=True)]
    found = Surface(shape.parts[0]), Surface(shape.parts[1])
    true_points, true_counts = _samples((shown[0], shown[1]), c, 0)
    found_points, found_counts = _samples(found, c, 1)
    sums: dict[str, list[float]] = {}
    has_states = "states" not in matched.lacks  # else its parts are posed for the anchor frame alone
    for frame in spread_frames(truth.states, c.poses) if has_states else [matched.answer.anchor]:
        true_poses = truth.Ts_camera_reference[frame], truth.Ts_camera_moving[frame]
        reference = matched.answer.Ts_camera_reference[frame]
        found_poses = reference, reference @ shape.motions[frame]
        forward = _distances(true_points, true_counts, true_poses, found, found_poses)
        backward = _distances(found_points, found_counts, found_poses, outer, true_poses)
        for id, there, back in zip(("chamfer_s", "chamfer_m", "chamfer_w"), forward, backward, strict=True):
            if len(back) and np.isfinite(there).all():
                sums.setdefault(id, []).append(100 * metrics.chamfer(there, back) / diagonal)
        if "chamfer_w" in sums:
            sums.setdefault("fscore", []).append(metrics.fscore(forward[2], backward[2], c.near * diagonal))
    return {id: float(np.mean(values)) for id, values in sums.items()}


def _samples(surfaces: tuple[Surface, Surface], c: Strict1, side: int) -> tuple[Pair, tuple[int, int]]:
    """Points of both parts, and how many of each, in proportion to area, are the samples of the whole object."""
    points = tuple(surface.sample(c.samples, (c.seed, side, part)) for part, surface in enumerate(surfaces))
    total = surfaces[0].area + surfaces[1].area
    first = round(c.samples * surfaces[0].area / total) if total else 0
    return (points[0], points[1]), (first, c.samples - first if not surfaces[1].empty else 0)


def _distances(
    points: Pair, counts: tuple[int, int], poses: Pair, targets: tuple[Surface, Surface], target_poses: Pair
) -> tuple[Array, Array, Array]:
    """Distances, metres, from points of the reference part to the target's, moving to moving, and whole to whole.

    The distance to the whole is the smaller of the distances to its two parts, each computed in that part's frame.
    """
    (first, first_whole), (second, second_whole) = part_distances(points, poses, targets, target_poses, counts)
    return first, second, np.concatenate([first_whole, second_whole])


def part_distances(
    points: Sequence[Array],
    poses: Pair,
    targets: tuple[Surface, Surface],
    target_poses: Pair,
    counts: tuple[int | None, int | None] = (None, None),
) -> list[Pair]:
    """For each part, distances, metres, from its points to the same part of the target, and from the first `counts` of
    them, or all, to the nearest part."""
    found = []
    for part in (0, 1):
        here = se3.inverse(target_poses[part]) @ poses[part]
        there = se3.inverse(target_poses[1 - part]) @ poses[part]
        own = targets[part].distance(se3.transform(here, points[part]))
        some = slice(counts[part])
        found.append((own, targets[1 - part].distance(se3.transform(there, points[part][some]), own[some])))
    return found


def picture_values(truth: Truth, renders: Sequence[Render]) -> dict[str, float | None]:
    """PSNR and SSIM, averaged over the queries that show the object; None without such a query."""
    ratios, similarities = [], []
    for i, render in enumerate(renders):
        mask = truth.query_mask(i)
        if not mask.any():
            continue
        picture = truth.query_rgb(i)
        ratios.append(0.0 if render is None else metrics.psnr(picture, render, mask))
        similarities.append(0.0 if render is None else metrics.ssim(picture, render, mask))
    if not ratios:
        return {"psnr": None, "ssim": None}
    return {"psnr": float(np.mean(ratios)), "ssim": float(np.mean(similarities))}


def penalties(truth: Truth) -> dict[str, float | None]:
    """The penalty of the states: the range of motion, deg or % of the diagonal."""
    motion = truth.range_of_motion
    revolute = truth.articulation.joint.type == "revolute"
    penalty = float(np.rad2deg(motion)) if revolute else 100 * motion / truth.diagonal
    return {"state": penalty, "state_all": penalty}


def _surface(id: str, what: str, column: str) -> Metric:
    return Metric(
        id,
        *PERCENT,
        (
            f"{what}: mean of the two directed mean distances, point to triangle, 100k seeded samples; truth to "
            "prediction samples the truth's visible surface, prediction to truth measures to the whole outer surface; "
            "averaged over the five frames whose true states lie nearest to five values spread evenly over the range, "
            "parts posed in the camera frame by each side's own reference pose and state"
        ),
        label=f"chamfer, {what}",
        column=column,
        needs=("meshes",) if id.endswith("_s") else ("joint", "meshes"),  # the moving part is posed by the joint
    )


_STATE = (
    "mean absolute difference over {frames}; one global sign, that of the dot product of the two axes; the "
    "offset that makes it smallest (the median) removed; revolute states wrapped"
)
_BOTH = (
    "frames in which the truth shows both parts with 1 % or more of the foreground each (over all frames when "
    "there is none)"
)

STRICT_1 = Protocol(
    "strict-1",
    "Parts are matched to the truth by the better mIoU of the two labelings; on a tie, by the reference poses. "
    "T_truth_pred is the robust mean (chordal L2 for the rotation, translation at the centre of the truth's reference "
    "part, 2 sigma trimmed) over all frames of T_camera_reference(truth)^-1 T_camera_reference(prediction); never "
    "chosen by the joint; scale 1; no registration of parts. A part's centre is that of its outer surface's area. "
    "Lengths are in % of the diagonal of the truth's bounding box at frame 0, cm beside. The joint is measured from "
    "the asset, reloaded and driven in SAPIEN, states beyond its limits driven to the limit; without an asset, read "
    "from the files and marked so. Means and sample standard deviations (ddof 1) are over all sequences of a joint "
    "type: a failure or a missing sequence is priced, never dropped.",
    (
        Metric(
            "joint_type",
            *FRACTION,
            "1 when the joint's type is right, else 0",
            label="joint type",
            needs=("joint",),
        ),
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
        Metric(
            "state",
            *STATE,
            _STATE.format(frames=_BOTH),
            label="joint state",
            column="state",
            needs=("joint", "states"),
        ),
        Metric(
            "state_all",
            *STATE,
            _STATE.format(frames="all frames"),
            label="joint state, all frames",
            needs=("joint", "states"),
        ),
        Metric(
            "miou",
            *FRACTION,
            "intersection over union, mean over frames and both parts; a part absent in both counts 1",
            label="part masks (mIoU)",
            column="mIoU",
            needs=("masks",),
        ),
        Metric(
            "pose_rotation",
            *ROTATION,
            "mean geodesic error of the reference part over all frames after alignment",
            label="rotation of the reference part",
            column="ref.\npart",
            needs=("poses",),
        ),
        Metric(
            "pose_translation",
            *PERCENT,
            "mean distance of the reference part's centre over all frames after alignment",
            label="place of the reference part",
            needs=("poses",),
        ),
        _surface("chamfer_w", "whole object", "cham.\nwhole"),
        _surface("chamfer_m", "moving part", "cham.\nmoving"),
        _surface("chamfer_s", "reference part", "cham.\nref."),
        Metric(
            "fscore",
            *FRACTION,
            "whole object: harmonic mean of precision and recall of the same samples within 1 % of the diagonal",
            label="F-score, whole object",
            needs=("joint", "meshes"),
        ),
        Metric(
            "psnr",
            *DECIBELS,
            "held-out queries, uint8, over the pixels of the truth's mask, white elsewhere, mean over queries; at "
            "most 100; no search at test time; a missing render counts 0",
            label="held-out views (PSNR)",
            column="views\nPSNR",
            needs=("renders",),
        ),
        Metric(
            "ssim",
            *FRACTION,
            "structural similarity (Gaussian window, sigma 1.5) of the same pictures, mean over the mask's pixels",
            "psnr",
            label="held-out views (SSIM)",
            needs=("renders",),
        ),
    ),
    measure,
    asset="joint",
    sequence_penalties=penalties,
)
