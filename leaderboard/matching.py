"""Matches an answer to the truth: parts renamed as in the truth, canonical frame aligned with the truth's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.errors import FreeArtError
from freeart21.reconstruction import Piece, Reconstruction
from freeart21.se3 import Array
from freeart21.truth import Truth
from leaderboard import metrics
from leaderboard.protocol import Shape
from leaderboard.surface import Surface

LABELLING_SAMPLES = 5_000
"""Points per part for matching by surfaces, where there are neither masks nor poses."""
LABELLING_SEED = 7


@dataclass(frozen=True)
class Matched:
    """An answer with the truth's part names and canonical frame."""

    answer: Reconstruction
    swapped: bool
    """Whether the answer's moving part was matched to the true reference part."""
    T_truth_pred: Array
    """(4, 4) the alignment, already applied to `answer`."""
    miou: float
    """NaN when the method makes no masks."""
    outer: tuple[Surface, Surface]
    """Outer surfaces of the true reference and moving part."""
    diagonal: float
    """Diagonal of the true object, metres."""
    lacks: tuple[Piece, ...] = ()
    """Pieces that the method never produces."""

    @property
    def shape(self) -> Shape:
        """Its part meshes and the motion of its joint at its states."""
        parts = self.answer.articulation
        motions = np.stack([parts.joint.transform(q) for q in self.answer.states])
        return Shape((parts.reference, parts.moving), motions)


def match(
    truth: Truth,
    answer: Reconstruction,
    lacks: tuple[Piece, ...] = (),
    rename: bool = True,
    align: Callable[[Array, Array, Array], Array] = metrics.align,
) -> Matched:
    """`answer` with its parts matched to the truth's and its canonical frame aligned by the reference part's poses.

    `lacks` names pieces that are only fillers. Without poses, the frames are aligned in the answer's
    anchor frame alone, and the aligned answer gets the truth's poses of the reference part. `rename=False` keeps the
    part names as given. `align(Ts_true, Ts_predicted, centre)` returns T_truth_pred from the poses (n, 4, 4) of the
    reference part and the true part's centre (3,), as `metrics.align` does.
    """
    outer = tuple(Surface(truth.articulation.part(name), faces) for name, faces in zip(PARTS, truth.outer, strict=True))
    if outer[0].empty or outer[1].empty:
        raise FreeArtError("the truth has a part without an outer surface")
    centre, diagonal = outer[0].centre, truth.diagonal
    if "poses" in lacks:
        answer = _posed_as_in_anchor(answer)
    swapped, same, other = match_parts(truth, answer, centre, diagonal, lacks, (outer[0], outer[1]))
    swapped = swapped and rename
    named = answer.exchanged() if swapped else answer
    frames = [answer.anchor] if "poses" in lacks else slice(None)
    T_truth_pred = align(truth.Ts_camera_reference[frames], named.Ts_camera_reference[frames], centre)
    parts = named.articulation.moved(T_truth_pred)
    if "poses" in lacks:
        reference = truth.Ts_camera_reference
        moving = reference @ parts.joint.transform(named.states)
    else:
        back = se3.inverse(T_truth_pred)
        reference, moving = named.Ts_camera_reference @ back, named.Ts_camera_moving @ back
    aligned = replace(named, articulation=parts, Ts_camera_reference=reference, Ts_camera_moving=moving)
    miou = max(same, other) if not rename else other if swapped else same
    return Matched(aligned, swapped, T_truth_pred, miou, (outer[0], outer[1]), diagonal, lacks)


def match_parts(
    truth: Truth,
    answer: Reconstruction,
    centre: Array,
    diagonal: float,
    lacks: tuple[Piece, ...],
    outer: tuple[Surface, Surface],
) -> tuple[bool, float, float]:
    """Whether the answer's part names are swapped, and the mIoU as labelled and swapped (NaN without masks).

    Decided by the better mIoU; on a tie or without masks, by which part follows the true reference part's poses better;
    without poses, by the smaller surface distance in the anchor frame; without meshes, the names stay. `centre` (3,) is
    the true reference part's, `diagonal` the true object's, metres, `outer` the surfaces of its parts.
    """
    same = other = np.nan
    if "masks" not in lacks:
        confusions = np.stack([metrics.confusion(truth.part_mask(i), mask) for i, mask in enumerate(answer.part_masks)])
        same, other = metrics.miou(confusions)
        if same != other:
            return other > same, same, other
    if "poses" not in lacks:
        errors = []
        for Ts in (answer.Ts_camera_reference, answer.Ts_camera_moving):
            T_truth_pred = metrics.align(truth.Ts_camera_reference, Ts, centre)
            angle, shift = metrics.pose_error(truth.Ts_camera_reference, Ts @ se3.inverse(T_truth_pred), centre)
            errors.append(angle + shift / diagonal)
        return errors[1] < errors[0], same, other
    if "meshes" not in lacks:
        as_given, exchanged = _labelling_distances(truth, answer, outer)
        return exchanged < as_given, same, other
    return False, same, other


def _posed_as_in_anchor(answer: Reconstruction) -> Reconstruction:
    """`answer` with the anchor frame's reference pose in every frame, and the moving part posed by joint and states."""
    T_camera_reference = answer.Ts_camera_reference[answer.anchor]
    return replace(
        answer,
        Ts_camera_reference=np.repeat(T_camera_reference[None], len(answer), 0),
        Ts_camera_moving=T_camera_reference @ answer.articulation.joint.transform(answer.states),
    )


def _labelling_distances(truth: Truth, answer: Reconstruction, outer: tuple[Surface, Surface]) -> tuple[float, float]:
    """Summed chamfer distances, metres, in the anchor frame as labelled and swapped (as VideoArtGS and ArtGS match).

    Both 0 when a part has no surface, so that nothing is renamed.
    """
    frame = answer.anchor
    true_poses = truth.Ts_camera_reference[frame], truth.Ts_camera_moving[frame]
    found_poses = answer.Ts_camera_reference[frame], answer.Ts_camera_moving[frame]
    found = Surface(answer.articulation.reference), Surface(answer.articulation.moving)
    if found[0].empty or found[1].empty:
        return 0.0, 0.0
    sums = []
    for order in ((0, 1), (1, 0)):
        total = 0.0
        for true_part, found_part in enumerate(order):
            T_found_true = se3.inverse(found_poses[found_part]) @ true_poses[true_part]
            there = outer[true_part].sample(LABELLING_SAMPLES, (LABELLING_SEED, 0, true_part))
            back = found[found_part].sample(LABELLING_SAMPLES, (LABELLING_SEED, 1, found_part))
            total += metrics.chamfer(
                found[found_part].distance(se3.transform(T_found_true, there)),
                outer[true_part].distance(se3.transform(se3.inverse(T_found_true), back)),
            )
        sums.append(total)
    return sums[0], sums[1]
