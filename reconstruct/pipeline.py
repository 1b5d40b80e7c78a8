"""From one RGB-D video with foreground masks to two parts, their poses, the joint between them, and meshes.

tracks         crop, points and normals; optical flow between neighbours
segmentation   a window where two motions beat one; growth both ways in time
joint          adjustment of all frames under one joint; labels again; adjustment again
poses          both parts' poses, unconstrained by the joint
surfaces       depth fused to one mesh a part
renders        the held-out views
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.files.result import write_result
from freeart21.files.sequence import read_sequence
from freeart21.joint import Joint
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array
from reconstruct.evidence import Evidence
from reconstruct.gaps import bridge_gaps
from reconstruct.poses import FreePoses, free_adjustment, joint_adjustment
from reconstruct.renders import render_queries
from reconstruct.scene import HopelessError, Scene, full_masks, prepare
from reconstruct.seeds import find_seeds
from reconstruct.segmentation import Grown, grow, relabel
from reconstruct.settings import ReconstructSettings
from reconstruct.surfaces import fuse
from reconstruct.tracks import optical_flow

__all__ = ["ReconstructSettings", "reconstruct", "reconstruct_folder"]

STAGES = ("tracks", "segmentation", "joint", "poses", "surfaces", "renders")


def reconstruct(recording: Recording, settings: ReconstructSettings | None = None) -> Reconstruction | Failure:
    """Solve one recording from RGB, depth, foreground masks and intrinsics alone.

    A `Failure` says that the input is hopeless: too few frames, empty masks, no second part, no relative motion.
    """
    settings = settings or ReconstructSettings()
    with _Clock(settings.progress) as clock:
        return _solve(recording, settings, clock)


def reconstruct_folder(
    sequence: Path, out: Path, settings: ReconstructSettings | None = None
) -> Reconstruction | Failure:
    """Solve a sequence folder and write a result folder, with the held-out views rendered."""
    settings = settings or ReconstructSettings()
    recording = read_sequence(Path(sequence))
    with _Clock(settings.progress) as clock:
        result = _solve(recording, settings, clock)
        renders = []
        if isinstance(result, Reconstruction):
            with clock.stage("renders"):
                renders = render_queries(result, recording.camera, recording.queries)
        result = replace(result, seconds=clock.seconds)
    write_result(Path(out), result, settings.to_json(), renders)
    return result


def _solve(recording: Recording, settings: ReconstructSettings, clock: _Clock) -> Reconstruction | Failure:
    rng = np.random.default_rng(settings.seed)
    try:
        with clock.stage("tracks"):
            scene = prepare(recording, settings.scene)
            flow = optical_flow(scene)
            evidence = Evidence(scene, settings.evidence, settings.labels)
        with clock.stage("segmentation"):
            seeds = find_seeds(evidence, flow, settings.seeds, settings.tracks, rng)
            grown = grow(evidence, flow, seeds[0], settings, rng)
        with clock.stage("joint"):
            grown = bridge_gaps(evidence, grown, settings.gaps, rng)
            for _ in range(2):
                grown = relabel(evidence, grown, settings, rng)
                poses = joint_adjustment(evidence, grown.labels, grown.poses, grown.seen, settings.poses, rng)
                grown = replace(grown, poses=poses)
            grown = _reference_first(grown)
        with clock.stage("poses"):
            free = [
                free_adjustment(evidence, grown.labels, k + 1, Ts, grown.seen[:, k], settings.poses, rng)
                for k, Ts in enumerate((grown.poses.Ts, grown.poses.Ts_moving))
            ]
        with clock.stage("surfaces"):
            meshes = [
                fuse(scene, grown.labels, k + 1, Ts, grown.seen[:, k], settings.surfaces)
                for k, Ts in enumerate((grown.poses.Ts, grown.poses.Ts_moving))
            ]
    except HopelessError as error:
        return Failure(error.stage, error.reason, clock.seconds)
    joint = grown.poses.joint
    articulation = Articulation(joint, meshes[0], meshes[1])
    return _canonical(articulation, grown, free, scene, recording, clock.seconds)


def _reference_first(grown: Grown) -> Grown:
    """The part with more mask pixels over all frames becomes the first: the reference part."""
    first, second = (int((grown.labels == k).sum()) for k in (1, 2))
    if first >= second:
        return grown
    poses = grown.poses
    swapped = np.array([0, 2, 1], np.uint8)[grown.labels]
    # T_second = T_first J(q), so T_first = T_second J(-q): the same axis, the states negated
    joint = _with_range(poses.joint, -poses.states)
    turned = replace(poses, Ts=poses.Ts_moving, joint=joint, states=-poses.states)
    return Grown(turned, swapped, -grown.logodds, grown.seen[:, ::-1].copy())


def _with_range(joint: Joint, states: Array) -> Joint:
    return replace(joint, lower=float(states.min()), upper=float(states.max()))


def _canonical(
    articulation: Articulation,
    grown: Grown,
    free: list[FreePoses],
    scene: Scene,
    recording: Recording,
    seconds: dict[str, float],
) -> Reconstruction:
    """Everything in the camera frame with the object as in frame 0, state zero in frame 0."""
    q0 = float(grown.poses.states[0])
    T_zero = grown.poses.joint.transform(q0)
    joint = _with_range(articulation.joint, grown.poses.states - q0)
    moving = articulation.moving.moved(T_zero)
    T_frame0 = free[0].Ts[0]
    Ts_moving = free[1].Ts @ se3.inverse(T_zero)
    back = se3.inverse(T_frame0)
    return Reconstruction(
        Articulation(joint, articulation.reference, moving).moved(T_frame0),
        grown.poses.states - q0,
        free[0].Ts @ back,
        Ts_moving @ back,
        full_masks(scene, grown.labels, recording.camera.width, recording.camera.height),
        grown.seen,
        _finite_or_nan(grown.poses.state_std),
        np.stack([f.covariances for f in free], 1),
        seconds,
    )


def _finite_or_nan(std: Array) -> NDArray[np.float64]:
    return np.where(np.isfinite(std), std, np.nan)


class _Clock:
    """Seconds per stage, and a progress bar over the stages."""

    def __init__(self, show: bool) -> None:
        self.seconds: dict[str, float] = {}
        self._bar = Progress(
            TextColumn("{task.description:>12}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=Console(stderr=True),
            disable=not show,
            transient=True,
        )
        self._task = self._bar.add_task(STAGES[0], total=len(STAGES))

    def __enter__(self) -> _Clock:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times a stage by name."""
        self._bar.update(self._task, description=name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = round(time.perf_counter() - start, 3)
            self._bar.advance(self._task)
