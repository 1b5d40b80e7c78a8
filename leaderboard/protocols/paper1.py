"""paper-1: the metrics of FreeArtGS's released evaluator, for comparison with the paper's tables.

Re-implemented from its definitions (FreeArtGS/FreeArtGS at 061c6c8, evaluate/; the alignment `average` of its script),
with the failure values of iTACO's evaluator where it has none. docs/protocols.md has its limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from freeart21 import se3
from freeart21.joint import Joint
from freeart21.mesh import join_meshes
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
from leaderboard.published import PUBLISHED
from leaderboard.registration import register_clouds
from leaderboard.surface import Surface

SURFACES = ("cd_w", "cd_m", "cd_s")
PARALLEL = 1e-6
"""Length of the cross product of two axes up to which they are parallel, and the position error is 0."""
EQUAL_DB = 99.0
"""PSNR, dB, of equal pictures."""


@dataclass(frozen=True)
class Paper1:
    """The constants of the protocol: other values are another protocol."""

    samples: int = 10_000
    """Points per surface."""
    seed: int = 0
    """Seed of the samples; the original evaluator has none."""


STANDARD = Paper1()
LENGTH = Scale("cm", "cm", "down", 100.0)
AXIS_PLACE = Scale("cm", None, "down", 100.0)
STATE = Scale("deg", "cm", "down", 90.0)
SQUARED = Scale("dm²", "dm²", "down", 100.0)


def measure(case: Case, constants: Paper1 = STANDARD) -> Measured:
    """The metrics of paper-1; the asset is not used."""
    truth = case.truth
    matched = match(truth, case.answer, case.lacks, rename=False, align=average_alignment)
    aligned, true = matched.answer, truth.articulation.joint
    revolute = true.type == "revolute"
    states = aligned.states
    if aligned.articulation.joint.type == "revolute":  # as the original does; matters when the true joint is prismatic
        states = np.mod(states, 2 * np.pi)
    surfaces, notes = surface_values(truth, matched, constants)
    values = joint_and_camera_values(truth, aligned, state_error(truth.states, states, revolute))
    values |= {"miou": matched.miou, "psnr": picture_value(truth, case.renders), **surfaces}
    if revolute:
        values["position"] = 100 * position_error(true, aligned.articulation.joint)
    return Measured(to_floats(values), False, notes=notes)


def joint_and_camera_values(truth: Truth, aligned: Reconstruction, state_error: float) -> dict[str, float | None]:
    """Type, axis and state of the joint (its `state_error`, rad or m), and the camera seen from the reference part."""
    true, joint = truth.articulation.joint, aligned.articulation.joint
    angle, shift = metrics.camera_error(truth.Ts_camera_reference, aligned.Ts_camera_reference)
    return {
        "joint_type": float(joint.type == true.type),
        "axis": np.rad2deg(metrics.axis_error(true.axis, joint.axis)),
        "state": (np.rad2deg(1.0) if true.type == "revolute" else 100) * state_error,
        "camera_rotation": np.rad2deg(angle),
        "camera_position": 100 * shift,
    }


def average_alignment(Ts_camera_truth: Array, Ts_camera_predicted: Array, centre_truth: Array) -> Array:
    """T_truth_pred (4, 4): the plain mean over frames of T_camera_truth^-1 @ T_camera_predicted (n, 4, 4).

    Translations are averaged at the origin of the prediction's own frame, rotations as quaternions with the signs of
    the first; nothing is trimmed. `centre_truth` is not used.
    """
    Ts = se3.inverse(Ts_camera_truth) @ Ts_camera_predicted
    quaternions = Rotation.from_matrix(Ts[:, :3, :3]).as_quat()
    quaternions = np.where(quaternions @ quaternions[0] < 0, -1.0, 1.0)[:, None] * quaternions
    mean = quaternions.mean(0)
    if np.linalg.norm(mean) < 1e-12:  # turned every way: theirs has no answer either
        mean = quaternions[0]
    return se3.pose(Rotation.from_quat(mean).as_matrix(), Ts[:, :3, 3].mean(0))


def position_error(true: Joint, joint: Joint) -> float:
    """Distance, metres, between the two axes as lines; 0 when they are parallel, however far apart."""
    n = np.cross(joint.axis, true.axis)
    length = float(np.linalg.norm(n))
    return float(abs(n @ (joint.pivot - true.pivot)) / length) if length > PARALLEL else 0.0


def state_error(states_truth: Array, states: Array, wrapped: bool) -> float:
    """Mean absolute difference of joint states (n,), rad or m, for the better one of the two global signs.

    The median difference is removed; `wrapped` differences are mapped to [-pi, pi) before and after.
    """
    wrap = metrics.wrap if wrapped else np.asarray
    errors = []
    for sign in (1.0, -1.0):
        difference = wrap(states_truth - sign * states)
        errors.append(float(np.mean(np.abs(wrap(difference - np.median(difference))))))
    return min(errors)


def posed_surfaces(shape: Shape, frame: int) -> dict[str, Surface]:
    """Surfaces of the whole object, moving and reference part in `frame`, canonical frame; keys as SURFACES."""
    reference, moving = shape.parts[0], shape.parts[1].moved(shape.motions[frame])
    whole = join_meshes([reference, moving])
    return dict(zip(SURFACES, (Surface(whole), Surface(moving), Surface(reference)), strict=True))


def sample_surfaces(truth: Truth, matched: Matched, c: Paper1) -> dict[str, tuple[Surface, Array, Array]]:
    """Of each of the SURFACES that the answer has, in the first frame (without states, the anchor): the true surface,
    and the samples of it and of the answer's."""
    frame = matched.answer.anchor if "states" in matched.lacks else 0
    motions = truth.articulation.joint.transform(truth.states)
    true = posed_surfaces(Shape((truth.articulation.reference, truth.articulation.moving), motions), frame)
    found = posed_surfaces(matched.shape, frame)
    return {
        id: (true[id], true[id].sample(c.samples, (c.seed, 0, k)), found[id].sample(c.samples, (c.seed, 1, k)))
        for k, id in enumerate(SURFACES)
        if not found[id].empty
    }


def surface_values(truth: Truth, matched: Matched, c: Paper1) -> tuple[dict[str, float | None], tuple[str, ...]]:
    """Chamfer distances, each surface registered to its truth first; no entry where the answer has no surface.

    A note lists values near the sampling floor: the distance between two samplings of the truth.
    """
    values: dict[str, float | None] = {}
    floors = []
    for id, (true, target, points) in sample_surfaces(truth, matched, c).items():
        distance = 100 * metrics.squared_chamfer(se3.transform(register_clouds(points, target), points), target)
        again = true.sample(c.samples, (c.seed, 2, SURFACES.index(id)))
        floor = 100 * metrics.squared_chamfer(again, target)
        values[id] = distance
        if distance < 2 * floor:
            floors.append(f"{id} {floor:.3g}")
    if not floors:
        return values, ()
    return values, (f"near the floor, the distance of two samplings of the truth: {', '.join(floors)}",)


def picture_value(truth: Truth, renders: Sequence[Render]) -> float | None:
    """PSNR, dB, averaged over the queries that show the object; None when there is no such query."""
    ratios = []
    for i, render in enumerate(renders):
        mask = truth.query_mask(i)
        if not mask.any():
            continue
        error = 0.0 if render is None else np.mean((truth.query_rgb(i)[mask].astype(float) - render[mask]) ** 2)
        ratios.append(0.0 if render is None else EQUAL_DB if error == 0 else 10 * np.log10(255**2 / error))
    return float(np.mean(ratios)) if ratios else None


def _surface(id: str, name: str, what: str) -> Metric:
    return Metric(
        id,
        *SQUARED,
        (
            f"{what}: printed as cm, but it is 100 times squared metres: mean squared distance of 10,000 points of "
            "the prediction to the nearest of 10,000 of the truth (all faces of the mesh, inner ones too), plus that "
            "of the truth's to the prediction's, in the first frame, after this surface alone was registered to its "
            "truth"
        ),
        label=f'{name} (printed as "cm")',
        column=name,
        needs=("meshes",) if id.endswith("_s") else ("joint", "meshes"),  # the moving part is posed by the joint
    )


PAPER_1 = Protocol(
    "paper-1",
    "What the evaluator released by FreeArtGS computes, re-implemented; to be laid beside that paper's tables, and "
    "beside nothing else. Parts go by the names that the answer gives them. T_truth_pred is the plain mean over all "
    "frames of T_camera_reference(truth)^-1 T_camera_reference(prediction), translations at the prediction's origin. "
    "Everything is read from the answer's files; an asset is not looked at. The type of the joint is a flag and prices "
    "nothing. Lengths are in cm. The evaluator searches the joint state of each held-out picture for the best PSNR: "
    "an answer holds finished pictures, so that search cannot be made, and the pictures are scored as they are. A "
    "missing part costs 100 as theirs; where theirs ends without a number, a failure costs what iTACO's evaluator says "
    "(90 deg, 1 m). Means and sample standard deviations (ddof 1) are over all sequences of a joint type.",
    (
        Metric(
            "joint_type",
            *FRACTION,
            "1 when the joint's type is right, else 0; no other number minds it",
            label="joint type",
            needs=("joint",),
        ),
        Metric(
            "axis",
            *ANGLE,
            "angle between the axes, whatever their signs",
            label="axis",
            column="axis",
            needs=("joint",),
        ),
        Metric(
            "position",
            *AXIS_PLACE,
            "distance between the two axes as lines; 0 when they are parallel (|a x b| up to 1e-6), however far apart",
            label="position",
            column="position",
            needs=("joint",),
        ),
        Metric(
            "state",
            *STATE,
            "mean absolute difference over all frames for the better of the two signs, whatever the axis, the median "
            "difference taken off; revolute differences wrapped",
            label="state",
            column="state",
            needs=("joint", "states"),
            prismatic_penalty=100.0,
        ),
        _surface("cd_w", "CD-w", "whole object"),
        _surface("cd_m", "CD-m", "moving part"),
        _surface("cd_s", "CD-s", "reference part"),
        Metric(
            "psnr",
            *DECIBELS,
            "held-out queries, uint8, over the pixels of the truth's mask, mean over queries; 99 for equal pictures; a "
            "missing picture counts 0 (theirs leaves it out)",
            label="PSNR",
            column="PSNR",
            needs=("renders",),
        ),
        Metric(
            "miou",
            *FRACTION,
            "intersection over union, mean over all frames and both parts, for the better of the two labelings; a part "
            "absent in both counts 1",
            label="mIoU",
            column="mIoU",
            needs=("masks",),
        ),
        Metric(
            "camera_rotation",
            *ANGLE,
            "mean angle of the camera, seen from the reference part, after the alignment",
            label="camera rotation",
            needs=("poses",),
        ),
        Metric(
            "camera_position",
            *LENGTH,
            "mean distance of the camera, seen from the reference part, after the alignment",
            label="camera position",
            needs=("poses",),
        ),
    ),
    measure,
    asset="none",
    published=tuple(row for row in PUBLISHED if row.protocol == "paper-1"),
)
