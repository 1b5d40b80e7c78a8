"""How strict-1 measures one answer against one truth: match parts, align, then every number in its unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array
from freeart21.truth import Truth
from leaderboard import metrics
from leaderboard.surface import Surface

Render = NDArray[np.uint8] | None
Pair = tuple[Array, Array]
"""Something of the reference part, and the same of the moving part."""


@dataclass(frozen=True)
class Strict1:
    """The constants of the protocol: other values are another protocol."""

    samples: int = 100_000
    """Points on each surface."""
    seed: int = 0
    """Of the samples."""
    poses: int = 5
    """Frames, spread over the joint range, over which surface distances are averaged."""
    near: float = 0.01
    """Threshold of the F-score, in diagonals."""
    seen_share: float = 0.01
    """Least share of the visible foreground that each part must have in a frame of `state`."""
    signless: float = 1e-9
    """Cosine of the angle between the axes below which neither direction of the predicted axis is nearer."""


@dataclass(frozen=True)
class Measured:
    """The values of one answer."""

    values: dict[str, float | None]
    """Metric id to value in the metric's unit. None: the sequence has no such number (no query shows the object). An id
    that is missing: the answer has nothing to measure (no surface, another joint type), which the protocol prices."""
    swapped: bool
    """Whether the answer's moving part was matched to the true reference part."""
    other_views: bool = False
    """Whether the pictures were those of the other choice of reference part (`renders_other`)."""


@dataclass(frozen=True)
class Shape:
    """What an answer's two parts look like, in its canonical frame, and how its moving part goes."""

    parts: tuple[Mesh, Mesh]
    """Reference and moving part at state zero."""
    motions: Array
    """(n, 4, 4) displacement of the moving part from state zero in every frame."""

    def moved(self, T_new_canonical: Array) -> Shape:
        """The same shape written in another canonical frame."""
        T = T_new_canonical
        reference, moving = (part.moved(T) for part in self.parts)
        return Shape((reference, moving), T @ self.motions @ se3.inverse(T))

    def swapped(self) -> Shape:
        """The same shape with the names of its parts exchanged."""
        return Shape(self.parts[::-1], se3.inverse(self.motions))


@dataclass(frozen=True)
class Matched:
    """An answer brought to the truth: parts by the truth's names, canonical frame that of the truth."""

    answer: Reconstruction
    swapped: bool
    """Whether the answer's moving part was matched to the true reference part."""
    T_truth_pred: Array
    """(4, 4) the alignment that is already in `answer`."""
    miou: float
    outer: tuple[Surface, Surface]
    """Outer surface of the true reference and moving part."""
    diagonal: float
    """Of the true object, metres."""

    @property
    def shape(self) -> Shape:
        """What the answer's files say: its part meshes, and its joint at its states."""
        parts = self.answer.articulation
        motions = np.stack([parts.joint.transform(q) for q in self.answer.states])
        return Shape((parts.reference, parts.moving), motions)


def measure(
    truth: Truth, answer: Reconstruction, renders: Sequence[Render], constants: Strict1 | None = None
) -> Measured:
    """Every number of strict-1 for an answer of as many frames as the truth, with masks of the truth's size.

    `renders` holds the answer's picture of each held-out query, or None where it has none.
    """
    c = constants or Strict1()
    matched = match(truth, answer)
    values = {
        **answer_values(truth, matched, c),
        **surface_values(truth, matched, matched.shape, c),
        **picture_values(truth, renders),
    }
    return Measured(plain(values), matched.swapped)


def match(truth: Truth, answer: Reconstruction) -> Matched:
    """`answer` with its parts matched to the truth's and its canonical frame aligned by the reference part's poses."""
    outer = tuple(Surface(truth.articulation.part(name), faces) for name, faces in zip(PARTS, truth.outer, strict=True))
    if outer[0].empty or outer[1].empty:
        raise FreeArtError("the truth has a part without an outer surface")
    centre, diagonal = outer[0].centre, truth.diagonal
    swapped, same, other = match_parts(truth, answer, centre, diagonal)
    named = with_parts_swapped(answer) if swapped else answer
    T_truth_pred = metrics.align(truth.Ts_camera_reference, named.Ts_camera_reference, centre)
    aligned = replace(
        named,
        articulation=named.articulation.moved(T_truth_pred),
        Ts_camera_reference=named.Ts_camera_reference @ se3.inverse(T_truth_pred),
        Ts_camera_moving=named.Ts_camera_moving @ se3.inverse(T_truth_pred),
    )
    return Matched(aligned, swapped, T_truth_pred, other if swapped else same, (outer[0], outer[1]), diagonal)


def answer_values(truth: Truth, matched: Matched, c: Strict1) -> dict[str, float | None]:
    """The numbers of joint, masks and the reference part's poses."""
    outer, diagonal = matched.outer, matched.diagonal
    angle, shift = metrics.pose_error(truth.Ts_camera_reference, matched.answer.Ts_camera_reference, outer[0].centre)
    return {
        **_joint_values(truth, matched.answer, outer[1].centre, diagonal, c),
        "miou": matched.miou,
        "pose_rotation": np.rad2deg(angle),
        "pose_translation": 100 * shift / diagonal,
    }


def plain(values: dict[str, float | None]) -> dict[str, float | None]:
    """`values` as Python's own numbers."""
    return {id: None if value is None else float(value) for id, value in values.items()}


def match_parts(truth: Truth, answer: Reconstruction, centre: Array, diagonal: float) -> tuple[bool, float, float]:
    """Whether the answer's parts go by each other's names, and the mIoU as labelled and swapped.

    On a tie (an answer without masks) the part that better keeps to the true reference part's poses is the reference.
    `centre` (3,) is the true reference part's, `diagonal` the true object's, metres.
    """
    confusions = np.stack([metrics.confusion(truth.part_mask(i), mask) for i, mask in enumerate(answer.part_masks)])
    same, other = metrics.miou(confusions)
    if same != other:
        return other > same, same, other
    errors = []
    for Ts in (answer.Ts_camera_reference, answer.Ts_camera_moving):
        T_truth_pred = metrics.align(truth.Ts_camera_reference, Ts, centre)
        angle, shift = metrics.pose_error(truth.Ts_camera_reference, Ts @ se3.inverse(T_truth_pred), centre)
        errors.append(angle + shift / diagonal)
    return errors[1] < errors[0], same, other


def with_parts_swapped(answer: Reconstruction) -> Reconstruction:
    """The same answer with the names of its parts exchanged.

    The canonical frame stays where it is. Seen from the moving part, the reference part turns about (slides along) the
    same line the other way: the axis is reversed, the states stay.
    """
    joint, parts = answer.articulation.joint, answer.articulation
    return replace(
        answer,
        articulation=Articulation(replace(joint, axis=-joint.axis), parts.moving, parts.reference),
        Ts_camera_reference=answer.Ts_camera_moving,
        Ts_camera_moving=answer.Ts_camera_reference,
        part_masks=np.array([0, 2, 1], np.uint8)[answer.part_masks],
        seen=answer.seen[:, ::-1],
        covariances=None if answer.covariances is None else answer.covariances[:, ::-1],
    )


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
    if joint.type != true.type:  # the other figures do not exist; the protocol prices them
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

    `shape` is in the matched answer's canonical frame. A true part of which the video shows nothing is sampled over its
    outer surface.
    """
    outer, diagonal = matched.outer, matched.diagonal
    visible = [Surface(truth.articulation.part(name), faces) for name, faces in zip(PARTS, truth.visible, strict=True)]
    shown = [v if not v.empty else o for v, o in zip(visible, outer, strict=True)]
    found = Surface(shape.parts[0]), Surface(shape.parts[1])
    true_points, true_counts = _samples((shown[0], shown[1]), c, 0)
    found_points, found_counts = _samples(found, c, 1)
    sums: dict[str, list[float]] = {}
    for frame in spread_frames(truth.states, c.poses):
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
    """Points of both parts, and how many of each, in proportion to area, make as many samples of the whole."""
    points = tuple(surface.sample(c.samples, (c.seed, side, part)) for part, surface in enumerate(surfaces))
    total = surfaces[0].area + surfaces[1].area
    first = round(c.samples * surfaces[0].area / total) if total else 0
    return (points[0], points[1]), (first, c.samples - first if not surfaces[1].empty else 0)


def _distances(
    points: Pair, counts: tuple[int, int], poses: Pair, targets: tuple[Surface, Surface], target_poses: Pair
) -> tuple[Array, Array, Array]:
    """Distances, metres, from the points of the reference part to the target's, moving to moving, and whole to whole.

    The distance to the whole is the smaller of the distances to its two parts, each measured in that part's own frame.
    """
    own, whole = [], []
    for part in (0, 1):
        here = se3.inverse(target_poses[part]) @ poses[part]
        there = se3.inverse(target_poses[1 - part]) @ poses[part]
        own.append(targets[part].distance(se3.transform(here, points[part])))
        some = slice(counts[part])
        whole.append(targets[1 - part].distance(se3.transform(there, points[part][some]), own[part][some]))
    return own[0], own[1], np.concatenate(whole)


def picture_values(truth: Truth, renders: Sequence[Render]) -> dict[str, float | None]:
    """PSNR and SSIM, averaged over the queries that show the object; none when there is no such query."""
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
