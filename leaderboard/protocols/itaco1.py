"""itaco-1: the metrics of iTACO's evaluate.py on Video2Articulation-S, in deg and cm instead of rad and m.

Re-implemented from its definitions (3dlg-hcvc/video2articulation, evaluate.py). There the object's base is static and
methods get its frame; our answers have a frame of their own, which is aligned with the truth's in the first frame.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array
from freeart21.truth import Truth
from leaderboard import metrics
from leaderboard.matching import match
from leaderboard.protocol import Case, Measured, Metric, Protocol, to_floats
from leaderboard.protocols.paper1 import PAPER_1, STANDARD, Paper1, joint_and_camera_values, sample_surfaces
from leaderboard.published import PUBLISHED

MOVING = 2
"""The moving part's value in part masks."""


def measure(case: Case, constants: Paper1 = STANDARD) -> Measured:
    """The metrics of itaco-1; renders and asset are not used."""
    truth, answer = case.truth, case.answer
    matched = match(truth, answer, case.lacks, rename=False, align=first_alignment)
    aligned, true = matched.answer, truth.articulation.joint
    joint = aligned.articulation.joint
    values = joint_and_camera_values(truth, aligned, state_error(truth.states, aligned.states))
    values["miou"] = moving_map_iou(truth, answer)
    for id, (_, target, points) in sample_surfaces(truth, matched, constants).items():  # nothing is registered
        values[id] = 100 * metrics.squared_chamfer(target, points)
    if true.type == "revolute":
        values["position"] = 100 * metrics.line_to_line(true.axis, true.pivot, joint.axis, joint.pivot)
    return Measured(to_floats(values), False)


def first_alignment(Ts_camera_truth: Array, Ts_camera_predicted: Array, centre_truth: Array) -> Array:
    """T_truth_pred (4, 4) of the first of the frames (n, 4, 4); `centre_truth` is not used."""
    T: Array = se3.inverse(Ts_camera_truth[0]) @ Ts_camera_predicted[0]
    return T


def state_error(states_truth: Array, states: Array) -> float:
    """Mean absolute difference of the magnitudes of joint states (n,), rad or m; an offset is not removed."""
    return float(np.mean(np.abs(np.abs(states_truth) - np.abs(states))))


def moving_map_iou(truth: Truth, answer: Reconstruction) -> float:
    """Intersection over union of the moving part's pixels, mean over the frames in which truth or answer has any.

    1 when no frame has any.
    """
    ratios = []
    for i, labels in enumerate(answer.part_masks):
        true, predicted = truth.part_mask(i) == MOVING, labels == MOVING
        if union := int((true | predicted).sum()):
            ratios.append((true & predicted).sum() / union)
    return float(np.mean(ratios)) if ratios else 1.0


def _as_paper(id: str, definition: str, **changes: Any) -> Metric:
    """The metric of paper-1 with another definition, and other `changes`."""
    return replace(PAPER_1.metric(id), definition=definition, **changes)


def _surface(id: str, what: str) -> Metric:
    return _as_paper(
        id,
        f"{what}: 100 times squared metres (theirs prints m^2): mean squared distance of 10,000 points of the "
        "prediction to the nearest of 10,000 of the truth (all faces of the mesh), plus that of the truth's to the "
        "prediction's, in the first frame, nothing registered",
    )


ITACO_1 = Protocol(
    "itaco-1",
    "What iTACO's evaluate.py computes on Video2Articulation-S, re-implemented; angles in deg and lengths in cm, where "
    "theirs has rad and m. Parts go by the names that the answer gives them. T_truth_pred is that of the first frame, "
    "T_camera_reference(truth)^-1 T_camera_reference(prediction): their methods are told the object's frame, ours have "
    "one of their own. Everything is read from the answer's files; an asset is not looked at. The type of the joint is "
    "a flag and prices nothing. Where theirs gives NaN: an arccos beyond 1 is clipped; the position error of parallel "
    "axes is the distance from a point of one to the other; where no frame has a moving pixel, the moving map counts "
    "1. A failure costs what theirs gives one (90 deg, 1 m, no overlap), its surfaces what theirs gives a missing part "
    "(1 m^2, printed 100). Means and sample standard deviations (ddof 1) are over all sequences of a joint type.",
    (
        PAPER_1.metric("joint_type"),
        PAPER_1.metric("axis"),
        _as_paper(
            "position", "distance between the two axes as lines; point to line when they are parallel within 1e-6"
        ),
        _as_paper(
            "state",
            "mean over all frames of | |truth| - |prediction| |: the sign is not seen, an offset is paid for, and the "
            "number says little where states cross 0",
        ),
        _surface("cd_w", "whole object"),
        _surface("cd_m", "moving part"),
        _surface("cd_s", "reference part"),
        _as_paper(
            "miou",
            "intersection over union of the moving part, mean over the frames in which truth or prediction has any",
            label="moving map (mIoU)",
            column="map",
        ),
        _as_paper("camera_rotation", "mean angle of the camera, seen from the reference part", column="cam.\nrot."),
        _as_paper("camera_position", "mean distance of the camera, seen from the reference part", column="cam.\npos."),
    ),
    measure,
    asset="none",
    published=tuple(row for row in PUBLISHED if row.protocol == "itaco-1"),
)
