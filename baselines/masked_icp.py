"""Coloured ICP (Park et al. 2017, Open3D's) of both parts, whose masks are GIVEN, and the paper's joint estimation.

    python -m baselines.masked_icp SEQUENCE OUT TRUTH/SEQ/part_mask

The part masks of the keyframes are a privileged input: this row shows what registration and joint estimation reach when
segmentation is perfect. Every 3rd frame is used. Each keyframe is registered to a model of the part, which grows.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np

from baselines.answer import Motion, run_baseline
from baselines.commands import run_command
from baselines.surfaces import FUSED, Labels
from baselines.video import UnsolvableError, Video, lift
from freeart21 import se3
from freeart21.files import checked
from freeart21.se3 import Array, Bools

EVERY = 3
COARSE, FINE = 0.03, 0.015
"""Voxel sides over the object's size, of the ICP without colours and of the coloured one."""
REACH = (0.16, 0.06)
"""Over the object's size: within it points meet in the ICP without colours that comes first."""
LEAST_POINTS = 50
LEAST_FITNESS = 0.6
"""Least share of a keyframe's points that must meet the model; below it the part counts as not found."""


def solve(video: Video, rng: np.random.Generator, part_masks: Path) -> Motion:
    """The parts' motion by ICP under the masks PART_MASKS/00000.png, ..., values 1 and 2."""
    labels: dict[int, Labels] = {}
    for k, (number, frame) in enumerate(zip(video.numbers, video.frames, strict=True)):
        label = checked.read_labels(part_masks / f"{number:05d}.png", part_masks)
        if label.shape != frame.mask.shape:
            raise UnsolvableError("reading", f"part mask {number} is {label.shape}, expected {frame.mask.shape}")
        labels[k] = label
    found = [track_part(video, [label == part + 1 for label in labels.values()]) for part in range(2)]
    return Motion(
        np.stack([T for T, _ in found]), np.stack([where for _, where in found]), dict(list(labels.items())[::FUSED])
    )


def track_part(video: Video, masks: list[Bools]) -> tuple[Array, Bools]:
    """Poses (F, 4, 4), camera from the part as in the first keyframe that shows it, and where (F,) it was found."""
    Ts, found = np.tile(np.eye(4), (len(masks), 1, 1)), np.zeros(len(masks), bool)
    model, last, previous = None, [], np.zeros(3)
    for k, mask in enumerate(masks):
        cloud = _cloud(video, k, mask)
        if cloud is None:
            continue
        if model is None:
            model = cloud
        else:
            shifted = last[-1].copy()  # so that the cloud's centre goes with the part
            shifted[:3, 3] += cloud.get_center() - previous
            guesses = [shifted, last[-1] @ se3.inverse(last[-2]) @ last[-1]] if len(last) > 1 else [shifted]
            T, fitness = register(cloud, model, guesses, video.size)
            if fitness < LEAST_FITNESS:
                continue
            Ts[k] = T
            model += _moved(cloud, se3.inverse(T))
            model = model.voxel_down_sample(FINE * video.size)
        found[k], previous = True, cloud.get_center()
        last.append(Ts[k])
    return Ts, found


def register(cloud: Any, model: Any, guesses: list[Array], size: float) -> tuple[Array, float]:
    """The pose T_cloud_model nearest to the best of `guesses`, and the share of `cloud` that then meets `model`.

    ICP of points alone from each guess, coarse to fine, then coloured ICP from the best.
    """
    import open3d

    registration = open3d.pipelines.registration
    few = [part.voxel_down_sample(COARSE * size) for part in (cloud, model)]
    fits = []
    for guess in guesses:
        T = se3.inverse(guess)
        for reach in REACH:
            fit = registration.registration_icp(*few, reach * size, T)
            T = fit.transformation
        fits.append(fit)
    T = max(fits, key=lambda fit: fit.fitness).transformation
    for part in (cloud, model):
        part.estimate_normals(open3d.geometry.KDTreeSearchParamHybrid(radius=3 * FINE * size, max_nn=20))
    with contextlib.suppress(RuntimeError):  # it left the model, as on a plane of one colour: what came before stands
        T = registration.registration_colored_icp(
            *(cloud, model, 2 * FINE * size, T),
            registration.TransformationEstimationForColoredICP(),
            registration.ICPConvergenceCriteria(1e-6, 1e-6, 20),
        ).transformation
    fit = registration.evaluate_registration(cloud, model, 2 * FINE * size, T)
    return se3.inverse(se3.orthonormalised(T)), float(fit.fitness)


def _cloud(video: Video, k: int, mask: Bools) -> Any:
    """Open3D's coloured cloud of the masked pixels of a keyframe, or None when there are too few."""
    import open3d

    row, column = np.nonzero(mask & video.frames[k].mask & (video.frames[k].depth > 0))
    if len(row) < LEAST_POINTS:
        return None
    cloud = open3d.geometry.PointCloud()
    points = lift(video.recording.camera.K, video.frames[k], np.stack([column, row], 1) + 0.5)
    cloud.points = open3d.utility.Vector3dVector(points)
    cloud.colors = open3d.utility.Vector3dVector(video.frames[k].rgb[row, column] / 255.0)
    return cloud.voxel_down_sample(FINE * video.size)


def _moved(cloud: Any, T: Array) -> Any:
    import open3d

    moved = open3d.geometry.PointCloud(cloud)
    return moved.transform(T)


def main(sequence: Path, out: Path, part_masks: Path, every: int = EVERY) -> None:
    """Solve one sequence folder with given part masks; writes the result folder `out`."""
    run_baseline(lambda video, rng: solve(video, rng, part_masks), sequence, out, every, "masked-icp", True)


if __name__ == "__main__":
    run_command(main)
