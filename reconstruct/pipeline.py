"""From one RGB-D video with foreground masks to two parts, their poses, the joint between them, and meshes.

One function per stage of the table in `stages`. Outcomes of expensive stages are cached until the result is written
(`cache`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.files.diagnostics import Diagnostics
from freeart21.files.places import RESULT, require_replaceable
from freeart21.files.result import write_result
from freeart21.files.sequence import read_sequence
from freeart21.gaussians import FAINT_COPY, Gaussians
from freeart21.progress import print_line, progress_bar
from freeart21.reconstruction import Alternative, Failure, Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.trust import judge
from reconstruct import VERSION
from reconstruct.cache import CachedStage, SolverState, StageCache
from reconstruct.diagnostics import diagnose, peak_bytes
from reconstruct.evidence import Evidence
from reconstruct.gaps import bridge_gaps, fill_gaps
from reconstruct.gaussians.optimisation import optimise
from reconstruct.joint_type import choose_joint_type, find_rival
from reconstruct.pose_sources import find_poses
from reconstruct.poses import FINAL_GATE, FreePoses, JointedPoses, free_adjustment, joint_adjustment
from reconstruct.propagation import PartEstimate, body_points
from reconstruct.renders import render_queries
from reconstruct.scene import Scene, UnsolvableError, prepare_scene, uncrop_labels
from reconstruct.seeds import find_seeds
from reconstruct.segmentation import propagate_from_seeds, relabel_frames
from reconstruct.settings import ReconstructSettings
from reconstruct.stages import CACHED_STAGES, STAGES, CachedStageName, require_cached
from reconstruct.surface_check import check_surfaces
from reconstruct.surfaces import fuse
from reconstruct.trackers import make_tracker
from reconstruct.tracks import Tracker

__all__ = ["ReconstructSettings", "reconstruct", "reconstruct_folder", "reconstruct_until"]


def reconstruct(
    recording: Recording, settings: ReconstructSettings | None = None, solvers: Mapping[str, StageSolver] | None = None
) -> Reconstruction | Failure:
    """Solve one recording from RGB, depth, foreground masks and intrinsics alone, its stages by `solvers` (SOLVERS).

    Returns a `Failure` when the input cannot be solved: too few frames, empty masks, or no second part that moves and
    covers enough pixels.
    """
    settings = settings or ReconstructSettings()
    with _one_blas_thread(), _StageClock(settings.progress) as clock:
        result, _ = _solve(recording, settings, clock, solvers=solvers)
    assert result is not None
    return result


def reconstruct_folder(
    sequence: Path, out: Path, settings: ReconstructSettings | None = None, keep_work: bool = False
) -> Reconstruction | Failure:
    """Solve a sequence folder and write a result folder, with the held-out views rendered.

    Finished stages are cached next to `out` (`cache.work_folder`) until the result is written, or longer with
    `keep_work`: a killed call may be repeated and gives the same result. Raises FreeArtError when `sequence` is not a
    sequence or `out` is anything but an older result, and CannotWrite.
    """
    settings = settings or ReconstructSettings()
    require_replaceable(Path(out), RESULT)
    recording, out = read_sequence(Path(sequence)), Path(out)
    cache = StageCache(Path(sequence), out, settings)
    with _StageClock(settings.progress) as clock:
        with _one_blas_thread():
            result, diagnostics = _solve(recording, settings, clock, cache)
        assert result is not None
        renders: tuple[list[NDArray[np.uint8]], list[NDArray[np.uint8]]] = [], []
        if isinstance(result, Reconstruction):
            with clock.stage("renders"):
                renders = render_queries(result, recording, settings.renders)
        result = replace(result, seconds=clock.seconds)
    if diagnostics is not None:
        diagnostics = replace(diagnostics, peak_bytes=peak_bytes())
    write_result(out, result, {"solver": VERSION, **settings.to_json()}, renders[0], diagnostics, renders[1])
    if not keep_work:
        cache.remove()
    return result


def reconstruct_until(
    sequence: Path, out: Path, stage: CachedStageName, settings: ReconstructSettings | None = None
) -> Path | Failure:
    """Solve a sequence folder up to and including `stage`; returns the file next to `out` that caches its outcome.

    `out` itself is not touched. A later call for `out` continues from there. Raises FreeArtError when no cached stage
    has this name.
    """
    require_cached(stage)
    settings = settings or ReconstructSettings()
    recording, cache = read_sequence(Path(sequence)), StageCache(Path(sequence), Path(out), settings)
    with _one_blas_thread(), _StageClock(settings.progress) as clock:
        result, _ = _solve(recording, settings, clock, cache, stage)
    return result if isinstance(result, Failure) else cache.path(stage)


def _one_blas_thread() -> AbstractContextManager[Any]:
    """More threads are slower, and change the last bits."""
    return threadpool_limits(limits=1, user_api="blas")


def _solve(
    recording: Recording,
    settings: ReconstructSettings,
    clock: _StageClock,
    cache: StageCache | None = None,
    until: CachedStageName | None = None,
    solvers: Mapping[str, StageSolver] | None = None,
) -> tuple[Reconstruction | Failure | None, Diagnostics | None]:
    """Solve all stages that are not in `cache`; no result when stopped after the stage `until`."""
    last = _load_last(cache, clock) or CachedStage(None, SolverState(), np.random.default_rng(settings.seed))
    state, rng = last.state, last.rng
    done = 0 if last.stage is None else CACHED_STAGES.index(last.stage) + 1
    if until is not None and done > CACHED_STAGES.index(until):
        return None, None
    try:
        if state.result is None:
            with clock.stage("tracks"):
                video = _tracks(recording, settings, clock, with_tracks=done == 0)
        for stage in CACHED_STAGES[done:]:
            with clock.stage(stage):
                state = (solvers or SOLVERS)[stage](video, state, settings, rng)
                if cache is not None:
                    cache.store(CachedStage(stage, state, rng, clock.so_far()))
            if stage == until:
                return None, None
    except UnsolvableError as error:
        return Failure(clock.running, str(error), clock.seconds), None
    assert state.result is not None
    return replace(state.result, seconds=clock.seconds), state.diagnostics


def _load_last(cache: StageCache | None, clock: _StageClock) -> CachedStage | None:
    """The furthest cached stage, if any; the clock continues from its time."""
    if cache is None:
        return None
    last, complaints = cache.load_last()
    for line in complaints:
        clock.say(line)
    if last is not None:
        clock.say(f"going on after {last.stage}, cached in {cache.folder}")
        clock.resume(last)
    return last


# --- the stages -------------------------------------------------------------------------------------------------------


@dataclass
class PreparedVideo:
    """A recording prepared for the stages."""

    recording: Recording
    scene: Scene
    evidence: Evidence
    tracker: Tracker | None
    progress: Callable[[float], object]
    """To be called by a long stage with its finished share, 0 to 1."""


def _tracks(
    recording: Recording, settings: ReconstructSettings, clock: _StageClock, with_tracks: bool
) -> PreparedVideo:
    scene = prepare_scene(recording, settings.scene)
    if scene.implausible:
        clock.say(f"{100 * scene.implausible:.2g} % of the object's depths lie implausibly far from it: taken as none")
    tracker = make_tracker(scene, settings.tracks) if with_tracks else None
    evidence = Evidence(scene, settings.evidence, settings.labels, find_poses(scene, settings.poses_from))
    return PreparedVideo(recording, scene, evidence, tracker, clock.progress)


StageSolver = Callable[[PreparedVideo, SolverState, ReconstructSettings, np.random.Generator], SolverState]
"""From the state before a stage to the state after it."""


def _segmentation(
    video: PreparedVideo, state: SolverState, settings: ReconstructSettings, rng: np.random.Generator
) -> SolverState:
    assert video.tracker is not None
    seeds = find_seeds(video.evidence, video.tracker, rng)
    estimate = propagate_from_seeds(video.evidence, video.tracker, seeds, settings, rng)
    video.tracker = None  # frees up to a gigabyte; no later stage uses it
    return SolverState(estimate)


def solve_joint(
    video: PreparedVideo,
    state: SolverState,
    settings: ReconstructSettings,
    rng: np.random.Generator,
    relabel: bool = True,
) -> SolverState:
    """The joint, and all poses under it; with `relabel` new labels by them."""
    assert state.estimate is not None
    evidence = video.evidence
    estimate = bridge_gaps(evidence, state.estimate, settings.gaps, rng)
    estimate = _relabel_unless_lost(evidence, estimate, rng) if relabel else estimate
    estimate = replace(estimate, poses=_choose_joint_type(evidence, estimate, settings, rng))
    estimate = bridge_gaps(evidence, estimate, settings.gaps, rng)
    estimate = _relabel_unless_lost(evidence, estimate, rng) if relabel else estimate
    poses = joint_adjustment(evidence, estimate.labels, estimate.poses, estimate.seen, settings.poses, rng)
    estimate = fill_gaps(evidence, replace(estimate, poses=poses), settings.gaps, rng)
    measured = estimate.seen
    estimate = _relabel_unless_lost(evidence, estimate, rng) if relabel else estimate
    seen = measured & estimate.seen  # the adjustment did not measure what only the last labels show
    state_std = np.where(seen.all(1), estimate.poses.state_std, np.inf)
    estimate = replace(estimate, seen=seen, poses=replace(estimate.poses, state_std=state_std))
    return SolverState(_put_larger_part_first(estimate))


def _relabel_unless_lost(evidence: Evidence, estimate: PartEstimate, rng: np.random.Generator) -> PartEstimate:
    """`estimate` with new labels, unless they would lose a part."""
    relabelled = relabel_frames(evidence, estimate, rng)
    return relabelled if relabelled.seen.all(1).sum() >= 4 else estimate


def _choose_joint_type(
    evidence: Evidence, estimate: PartEstimate, settings: ReconstructSettings, rng: np.random.Generator
) -> JointedPoses:
    """The joint type, first decided by a few frames, decided again by all."""
    poses = joint_adjustment(evidence, estimate.labels, estimate.poses, estimate.seen, settings.poses, rng, 8)
    free_poses = _adjust_without_joint(evidence, replace(estimate, poses=poses), settings, rng)
    free = np.stack([found.Ts for found in free_poses])
    body = body_points(evidence, estimate.labels, free[1], estimate.seen[:, 1])
    everywhere = np.ones(len(estimate.labels), bool)
    return choose_joint_type(evidence, estimate.labels, free, estimate.seen, body, everywhere, settings, rng, poses)


def _gaussians(
    video: PreparedVideo, state: SolverState, settings: ReconstructSettings, rng: np.random.Generator
) -> SolverState:
    if not settings.gaussians.refine:
        return state
    estimate = state.estimate
    assert estimate is not None

    def depth_disagreement(poses: JointedPoses) -> float:
        """Squared disagreement of the depth images under a motion, on the same pixels each time."""
        same_rng = np.random.default_rng(settings.seed)
        known = video.evidence, estimate.labels, poses, estimate.seen
        return joint_adjustment(*known, settings.poses, same_rng, 1, gate=FINAL_GATE).cost

    arguments = video.recording, video.scene, estimate, settings, rng
    model = optimise(*arguments, video.progress, depth_disagreement)
    if model is None:
        return state
    free_poses = model.free if model.motion_refined else ()
    return replace(state, estimate=model.apply_to(estimate), free_poses=free_poses, appearance=model.gaussians)


def _poses(
    video: PreparedVideo, state: SolverState, settings: ReconstructSettings, rng: np.random.Generator
) -> SolverState:
    assert state.estimate is not None
    if state.free_poses:  # from the Gaussians
        return state
    return replace(state, free_poses=_adjust_without_joint(video.evidence, state.estimate, settings, rng))


def _adjust_without_joint(
    evidence: Evidence, estimate: PartEstimate, settings: ReconstructSettings, rng: np.random.Generator
) -> tuple[FreePoses, ...]:
    """Poses of both parts without the joint."""
    return tuple(
        free_adjustment(evidence, estimate.labels, k + 1, Ts, estimate.seen[:, k], settings.poses, rng)
        for k, Ts in enumerate((estimate.poses.Ts, estimate.poses.Ts_moving))
    )


def _surfaces(
    video: PreparedVideo, state: SolverState, settings: ReconstructSettings, rng: np.random.Generator
) -> SolverState:
    assert state.estimate is not None
    estimate, camera = state.estimate, video.recording.camera
    meshes = [
        fuse(video.scene, estimate.labels, k + 1, Ts, estimate.seen[:, k], settings.surfaces)
        for k, Ts in enumerate((estimate.poses.Ts, estimate.poses.Ts_moving))
    ]
    articulation = Articulation(estimate.poses.joint, meshes[0], meshes[1])
    size = (camera.width, camera.height)
    known = video.evidence, estimate, state.free_poses
    diagnostics = diagnose(*known, settings.poses, settings.seed, size)
    result = _to_canonical_frame(articulation, state, video.scene, video.recording)
    rival, costs = _find_rival(video.evidence, state, settings)
    if rival is not None:
        joint = rival.joint.spanning(rival.states - rival.states[0]).moved(state.free_poses[0].Ts[0])
        alternative = Alternative(joint, rival.states - rival.states[0], float(costs[1] - costs[0]))
        result = replace(result, alternatives=(alternative,))
    diagnostics = replace(diagnostics, type_costs=costs, **check_surfaces(video.scene, result))
    return SolverState(result=replace(result, trust=judge(result, diagnostics)), diagnostics=diagnostics)


SOLVERS: dict[str, StageSolver] = {
    "segmentation": _segmentation,
    "joint": solve_joint,
    "gaussians": _gaussians,
    "poses": _poses,
    "surfaces": _surfaces,
}
"""By stage."""


def _find_rival(
    evidence: Evidence, state: SolverState, settings: ReconstructSettings
) -> tuple[JointedPoses | None, Array]:
    """See `find_rival`."""
    estimate, Ts = state.estimate, np.stack([free.Ts for free in state.free_poses])
    assert estimate is not None
    if settings.joint.type_rule == "paper" or not estimate.seen.all(1).any():
        return None, np.full(2, np.nan)
    body = body_points(evidence, estimate.labels, Ts[1], estimate.seen[:, 1])
    return find_rival(evidence, estimate.labels, estimate.poses, Ts, estimate.seen, body, settings)


def _put_larger_part_first(estimate: PartEstimate) -> PartEstimate:
    """The part with more mask pixels over all frames becomes the first: the reference part."""
    first, second = (int((estimate.labels == k).sum()) for k in (1, 2))
    if first >= second:
        return estimate
    poses, labels = estimate.poses, estimate.labels
    swapped = np.where(labels > 0, 3 - labels, 0).astype(np.uint8)
    std = None if poses.joint_std is None else poses.joint_std[::-1]
    states = -poses.states
    poses = replace(poses, joint=poses.joint.spanning(states), states=states, Ts=poses.Ts_moving, joint_std=std)
    return PartEstimate(poses, swapped, -estimate.logodds, estimate.seen[:, ::-1])


def _to_canonical_frame(
    articulation: Articulation, state: SolverState, scene: Scene, recording: Recording
) -> Reconstruction:
    """The result in the camera frame with the object as in frame 0, where the state is zero."""
    estimate, free_poses, appearance = state.estimate, state.free_poses, state.appearance
    assert estimate is not None
    poses, joint_std = estimate.poses, estimate.poses.joint_std
    q0 = float(poses.states[0])
    T_zero = poses.joint.transform(q0)
    joint = articulation.joint.spanning(poses.states - q0)
    moving = articulation.moving.moved(T_zero)
    T_frame0 = free_poses[0].Ts[0]
    Ts_moving = free_poses[1].Ts @ se3.inverse(T_zero)
    to_frame0 = se3.inverse(T_frame0)
    axis_std, pivot_std = (None, None) if joint_std is None else joint_std[0]
    return Reconstruction(
        Articulation(joint, articulation.reference, moving).moved(T_frame0),
        poses.states - q0,
        free_poses[0].Ts @ to_frame0,
        Ts_moving @ to_frame0,
        uncrop_labels(scene, estimate.labels, estimate.logodds, recording),
        estimate.seen,
        np.where(np.isfinite(poses.state_std), poses.state_std, np.nan),
        np.stack([f.covariances for f in free_poses], 1),
        axis_std=_number_or_none(axis_std),
        pivot_std=_number_or_none(pivot_std),
        appearance=None if appearance is None else _split_shared_gaussians(appearance, T_zero).moved(T_frame0),
    )


def _split_shared_gaussians(gaussians: Gaussians, T_zero: Array) -> Gaussians:
    """The same images in every state, with the moving part placed at the new state zero by `T_zero`.

    A Gaussian of both parts becomes two, one per part, each with the opacity that blending gives it there. Copies too
    faint to be drawn are left out.
    """
    w = gaussians.part_weights
    opacities = gaussians.opacities * np.stack([w, 1 - w])
    part, i = np.nonzero(opacities > FAINT_COPY)
    moved = gaussians.moved(T_zero)
    placed = {
        name: np.where(part[:, None] == 0, getattr(gaussians, name)[i], getattr(moved, name)[i])
        for name in ("means", "quaternions", "normals")
    }
    return Gaussians(
        **placed,
        scales=gaussians.scales[i],
        opacities=opacities[part, i],
        colours=gaussians.colours[i],
        part_weights=(part == 0).astype(np.float32),
        light=gaussians.light,
    )


def _number_or_none(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


class _StageClock:
    """Seconds per stage, and a progress bar over the stages."""

    def __init__(self, show: bool) -> None:
        self.seconds: dict[str, float] = {}
        self.running = STAGES[0].name
        """The stage that was started last."""
        self._start, self._show = 0.0, show
        self._bar = progress_bar("") if show else nullcontext(lambda text, done, total: None)

    def __enter__(self) -> _StageClock:
        self._update = self._bar.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._bar.__exit__(*error)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times a stage by name; a repeated one keeps its first time."""
        self.running, self._start = name, time.perf_counter()
        self.progress(0)
        try:
            yield
        finally:
            self.seconds = self.so_far()

    def progress(self, share: float) -> None:
        """Shows the finished share, 0 to 1, of the running stage."""
        self._update(self.running, round(1000 * (len(self.seconds) + share)), 1000 * len(STAGES))

    def so_far(self) -> dict[str, float]:
        """Seconds of all stages, the running one until now."""
        elapsed = round(time.perf_counter() - self._start, 3)
        return {**self.seconds, self.running: self.seconds.get(self.running, elapsed)}

    def resume(self, last: CachedStage) -> None:
        """Take over the seconds of cached stages."""
        self.seconds = dict(last.seconds)

    def say(self, line: str) -> None:
        """Print one line on standard error, when progress is shown."""
        if self._show:
            print_line(line)
