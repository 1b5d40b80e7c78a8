"""Metrics, one function each: arrays in, SI numbers out (radians, metres, fractions, dB).

The protocols (`leaderboard.protocols`) define which are used and what a failure costs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage.metrics import structural_similarity

from freeart21 import se3
from freeart21.se3 import Array

PARALLEL = 1e-6
"""Sine of the angle between two lines below which they count as parallel."""
PSNR_CAP = 100.0
"""dB given to pictures that are equal, whose ratio would be infinite."""
_SSIM_RADIUS = 5  # pixels that the 11 x 11 Gaussian window of SSIM reaches


def axis_error(axis_a: Array, axis_b: Array) -> float:
    """Angle, radians in [0, pi/2], between two unit directions (3,) whatever their signs.

    arccos(|a . b|), computed as atan2(|a x b|, |a . b|), which keeps its digits near zero.
    """
    return float(np.arctan2(np.linalg.norm(np.cross(axis_a, axis_b)), abs(np.dot(axis_a, axis_b))))


def point_to_line(point: Array, axis: Array, pivot: Array) -> float:
    """Distance, metres, from `point` (3,) to the line through `pivot` (3,) along the unit `axis` (3,)."""
    return float(np.linalg.norm(np.cross(point - pivot, axis)))


def position_error(centre: Array, axis_truth: Array, pivot_truth: Array, axis: Array, pivot: Array) -> float:
    """Distance, metres, from the point of the true axis nearest `centre` (3,) to the predicted line.

    Unlike line to line it is not fooled by a tilted axis that crosses the true one far from the object.
    """
    along = np.dot(centre - pivot_truth, axis_truth)
    return point_to_line(pivot_truth + along * axis_truth, axis, pivot)


def line_to_line(axis_a: Array, pivot_a: Array, axis_b: Array, pivot_b: Array) -> float:
    """Distance, metres, between two lines; point to line when they are parallel within PARALLEL.

    |n . (b - a)| / |n| with n = axis_a x axis_b (DigitalTwinArt, ArtGS).
    """
    n = np.cross(axis_a, axis_b)
    length = np.linalg.norm(n)
    if length <= PARALLEL:
        return point_to_line(pivot_a, axis_b, pivot_b)
    return float(abs(n @ (pivot_b - pivot_a)) / length)


def state_error(states_truth: Array, states: Array, sign: float, wrapped: bool) -> float:
    """Mean absolute difference of joint states (n,), rad or m, after `sign` and the median offset.

    `sign` is that of the dot product of the true and the predicted axis: a reversed axis with negated states is the
    same answer. The offset is the one that makes the mean smallest, which is the median; for `wrapped` states it is the
    median on the circle, found among the differences themselves, where the minimum of the sum of arcs always lies.
    """
    difference = sign * states - states_truth - state_offset(states_truth, states, sign, wrapped)
    return float(np.mean(np.abs(wrap(difference) if wrapped else difference)))


def state_offset(states_truth: Array, states: Array, sign: float, wrapped: bool) -> float:
    """The offset, rad or m, that `state_error` removes: `sign` * states is nearest states_truth + offset."""
    difference = sign * states - states_truth
    if not wrapped:
        return float(np.median(difference))
    return float(min(difference, key=lambda offset: np.mean(np.abs(wrap(difference - offset)))))


def wrap(angle: Array) -> Array:
    """Angles (...) brought to [-pi, pi)."""
    return np.mod(angle + np.pi, 2 * np.pi) - np.pi


def confusion(labels_truth: NDArray[np.uint8], labels: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(3, 3) pixel counts of two label maps (height, width): entry [i, j] is truth i, prediction j (0, 1, 2)."""
    return np.bincount(3 * labels_truth.ravel().astype(np.int64) + labels.ravel(), minlength=9).reshape(3, 3)


def miou(confusions: NDArray[np.int64]) -> tuple[float, float]:
    """Mean IoU over frames and both parts from confusions (n, 3, 3): as labelled, and with the predicted parts swapped.

    A part that is absent in both truth and prediction counts 1.
    """
    counts = confusions.astype(float)
    truth, predicted = counts.sum(2), counts.sum(1)
    means = []
    for order in ((1, 2), (2, 1)):
        both = np.stack([counts[:, k, order[k - 1]] for k in (1, 2)], -1)
        union = truth[:, 1:] + predicted[:, order] - both
        means.append(float(np.where(union > 0, both / np.maximum(union, 1), 1.0).mean()))
    return means[0], means[1]


def align(Ts_camera_truth: Array, Ts_camera_predicted: Array, centre_truth: Array) -> Array:
    """T_truth_pred (4, 4): the robust mean over frames of T_camera_truth^-1 @ T_camera_predicted (n, 4, 4).

    Chordal L2 mean of the rotations, 2 sigma trimmed (`se3.mean_pose`); scale 1. Translations are averaged at the point
    of the prediction that lies, on trimmed average, where the truth has `centre_truth` (3,), its reference part's
    centre: a prediction that moves its canonical frame elsewhere gets the same alignment.
    """
    Ts = se3.inverse(Ts_camera_truth) @ Ts_camera_predicted
    at_centre = se3.transform(se3.inverse(Ts), np.broadcast_to(centre_truth, (len(Ts), 1, 3)))[:, 0]
    T_pred_centred = se3.mean_pose(se3.pose(np.eye(3), at_centre))
    return se3.mean_pose(Ts @ T_pred_centred) @ se3.inverse(T_pred_centred)


def pose_error(Ts_camera_truth: Array, Ts_camera_aligned: Array, centre_truth: Array) -> tuple[float, float]:
    """Mean geodesic angle, radians, and mean distance, metres, between two stacks of poses (n, 4, 4) of one part.

    The distance is that of the part's centre `centre_truth` (3,), in the frame that both stacks map to the camera.
    """
    angles = se3.rotation_angle(np.swapaxes(Ts_camera_truth[:, :3, :3], -1, -2) @ Ts_camera_aligned[:, :3, :3])
    true, aligned = (se3.transform(Ts, centre_truth[None]) for Ts in (Ts_camera_truth, Ts_camera_aligned))
    return float(angles.mean()), float(np.linalg.norm(true - aligned, axis=-1).mean())


def chamfer(forward: Array, backward: Array) -> float:
    """Mean, metres, of the two directed mean distances (n,) and (m,): not squared."""
    return float(0.5 * (np.mean(forward) + np.mean(backward)))


def squared_chamfer(a: Array, b: Array) -> float:
    """m^2: mean squared distance of the points `a` (n, 3) to the nearest of `b` (m, 3), plus that of b to a.

    The default of PyTorch3D's chamfer_distance, which this field's evaluators print as cm or mm.
    """
    there, back = cKDTree(b).query(a)[0], cKDTree(a).query(b)[0]
    return float(np.mean(there**2) + np.mean(back**2))


def camera_error(Ts_camera_truth: Array, Ts_camera_aligned: Array) -> tuple[float, float]:
    """Mean angle, radians, and mean distance, metres, of the camera as seen from the object, for poses (n, 4, 4)."""
    true, found = se3.inverse(Ts_camera_truth), se3.inverse(Ts_camera_aligned)
    angles = se3.rotation_angle(found[:, :3, :3] @ np.swapaxes(true[:, :3, :3], -1, -2))
    return float(angles.mean()), float(np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=-1).mean())


def fscore(forward: Array, backward: Array, threshold: float) -> float:
    """Harmonic mean of recall (truth to prediction, `forward`) and precision (`backward`) within `threshold`, metres.

    Knapitsch et al. 2017 (Tanks and Temples), eq. 5; 0 when both are 0.
    """
    recall, precision = (float(np.mean(d <= threshold)) for d in (forward, backward))
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def psnr(truth: NDArray[np.uint8], picture: NDArray[np.uint8], mask: NDArray[np.bool_]) -> float:
    """Peak signal-to-noise, dB, of two pictures (height, width, 3) over `mask` (height, width), at most PSNR_CAP."""
    error = np.mean((truth[mask].astype(float) - picture[mask]) ** 2)
    return PSNR_CAP if error == 0 else float(min(PSNR_CAP, 10 * np.log10(255**2 / error)))


def ssim(truth: NDArray[np.uint8], picture: NDArray[np.uint8], mask: NDArray[np.bool_]) -> float:
    """Structural similarity (Wang et al. 2004: Gaussian window, sigma 1.5) of two pictures (height, width, 3).

    Both are white outside `mask` (height, width); the mean is over the pixels of `mask`.
    """
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    pad = [(_SSIM_RADIUS, _SSIM_RADIUS)] * 2
    white = [
        np.pad(np.where(mask[..., None], image, 255)[box], [*pad, (0, 0)], constant_values=255).astype(np.uint8)
        for image in (truth, picture)
    ]
    _, similarity = structural_similarity(
        *white, channel_axis=2, data_range=255, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True
    )
    return float(similarity[np.pad(mask[box], pad)].mean())
