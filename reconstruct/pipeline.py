"""From one RGB-D video with foreground masks to two parts, their poses, the joint between them, and meshes.

Each stage of the table in `stages` is one function here. What the expensive ones find is kept until the result is
written (`cache`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from threadpoolctl import threadpool_limits

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.files.diagnostics import Diagnostics
from freeart21.files.places import RESULT, require_replaceable
from freeart21.files.result import write_result
from freeart21.files.sequence import read_sequence
from freeart21.gaussians import Gaussians
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.trust import judge
from reconstruct import VERSION, paper_segmentation
from reconstruct.cache import Kept, Known, Work
from reconstruct.diagnostics import diagnose, peak_bytes
from reconstruct.drawn_back import surface_signs
from reconstruct.evidence import Evidence
from reconstruct.exchanges import exchanged, undo_exchanges
from reconstruct.features import HandMade
from reconstruct.gaps import bridge_gaps, fill_gaps
from reconstruct.gaussians.model import FAINT_COPY
from reconstruct.gaussians.optimisation import optimise
from reconstruct.growth import Grown, body_points
from reconstruct.hypotheses import better_type
from reconstruct.poses import FreePoses, JointedPoses, free_adjustment, joint_adjustment
from reconstruct.renders import render_queries
from reconstruct.scene import HopelessError, Scene, full_labels, prepare
from reconstruct.seeds import find_seeds
from reconstruct.segmentation import grow, relabel
from reconstruct.settings import ReconstructSettings
from reconstruct.stages import KEPT, STAGES, KeptStage, require_kept
from reconstruct.surfaces import fuse
from reconstruct.tracks import DisTracker, Tracker

__all__ = ["ReconstructSettings", "reconstruct", "reconstruct_folder", "reconstruct_until"]


def reconstruct(recording: Recording, settings: ReconstructSettings | None = None) -> Reconstruction | Failure:
    """Solve one recording from RGB, depth, foreground masks and intrinsics alone.

    A `Failure` says that the input is hopeless: too few frames, empty masks, no second part that
    moves and shows on enough of the pixels.
    """
    settings = settings or ReconstructSettings()
    with _Clock(settings.progress) as clock:
        answer, _ = _solve(recording, settings, clock)
    assert answer is not None
    return answer


def reconstruct_folder(
    sequence: Path, out: Path, settings: ReconstructSettings | None = None, keep_work: bool = False
) -> Reconstruction | Failure:
    """Solve a sequence folder and write a result folder, with the held-out views rendered.

    Finished stages are kept beside `out` (`cache.work_folder`) until the result is written, and longer with
    `keep_work`: a call that was killed may be repeated, to the same result. Its seconds are those of the solving.
    Raises FreeArtError when `sequence` is not a sequence or `out` is anything but an older result, and CannotWrite.
    """
    settings = settings or ReconstructSettings()
    require_replaceable(Path(out), RESULT)
    recording, out = read_sequence(Path(sequence)), Path(out)
    work = Work(Path(sequence), out, settings)
    with _Clock(settings.progress) as clock:
        result, diagnostics = _solve(recording, settings, clock, work)
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
        work.remove()
    return result


def reconstruct_until(
    sequence: Path, out: Path, stage: KeptStage, settings: ReconstructSettings | None = None
) -> Path | Failure:
    """Solve a sequence folder up to and with `stage`, which is kept beside `out` as the file that is returned.

    `out` itself stays as it is. Any later call for `out` goes on from there. Raises FreeArtError when no stage of this
    name is kept.
    """
    require_kept(stage)
    settings = settings or ReconstructSettings()
    recording, work = read_sequence(Path(sequence)), Work(Path(sequence), Path(out), settings)
    with _Clock(settings.progress) as clock:
        result, _ = _solve(recording, settings, clock, work, stage)
    return result if isinstance(result, Failure) else work.path(stage)


@threadpool_limits.wrap(limits=1, user_api="blas")  # more would spin on busy cores, and change the last bits
def _solve(
    recording: Recording,
    settings: ReconstructSettings,
    clock: _Clock,
    work: Work | None = None,
    until: KeptStage | None = None,
) -> tuple[Reconstruction | Failure | None, Diagnostics | None]:
    """All stages that are not kept in `work`, one after the other; no answer when stopped after the stage `until`."""
    kept = _last(work, clock) or Kept(None, Known(), np.random.default_rng(settings.seed))
    known, rng = kept.known, kept.rng
    done = 0 if kept.stage is None else KEPT.index(kept.stage) + 1
    if until is not None and done > KEPT.index(until):
        return None, None
    try:
        if known.answer is None:
            with clock.stage("tracks"):
                video = _tracks(recording, settings, clock, with_tracks=done == 0)
        for stage in KEPT[done:]:
            with clock.stage(stage):
                known = _SOLVERS[stage](video, known, settings, rng)
                if work is not None:
                    work.keep(Kept(stage, known, rng, clock.so_far()))
            if stage == until:
                return None, None
    except HopelessError as error:
        return Failure(clock.running, str(error), clock.seconds), None
    assert known.answer is not None
    return replace(known.answer, seconds=clock.seconds), known.diagnostics


def _last(work: Work | None, clock: _Clock) -> Kept | None:
    """The furthest stage that is kept, if any; the clock goes on from there."""
    if work is None:
        return None
    kept, complaints = work.last()
    for line in complaints:
        clock.say(line)
    if kept is not None:
        clock.say(f"going on after {kept.stage}, kept in {work.folder}")
        clock.go_on(kept)
    return kept


# --- the stages -------------------------------------------------------------------------------------------------------


@dataclass
class _Video:
    """A recording made ready for the stages."""

    recording: Recording
    scene: Scene
    evidence: Evidence
    tracker: Tracker | None
    progress: Callable[[float], object]
    """A long stage tells it the share of itself that is done, 0 to 1."""


def _tracks(recording: Recording, settings: ReconstructSettings, clock: _Clock, with_tracks: bool) -> _Video:
    scene = prepare(recording, settings.scene)
    if scene.implausible:
        clock.say(f"{100 * scene.implausible:.2g} % of the object's depths lie implausibly far from it: taken as none")
    tracker = DisTracker(scene, settings.tracks) if with_tracks else None
    evidence = Evidence(scene, settings.evidence, settings.labels)
    return _Video(recording, scene, evidence, tracker, clock.progress)


_Solver = Callable[[_Video, Known, ReconstructSettings, np.random.Generator], Known]
_SOLVERS: dict[str, _Solver] = {}


def _solves(solver: _Solver) -> _Solver:
    """Marks the function that solves the stage of its name: from what is known to what is known after it."""
    _SOLVERS[solver.__name__.removeprefix("_")] = solver
    return solver


@_solves
def _segmentation(video: _Video, known: Known, settings: ReconstructSettings, rng: np.random.Generator) -> Known:
    assert video.tracker is not None
    if settings.segmentation == "paper":
        features = HandMade(video.scene, settings.features)
        found = paper_segmentation.segment(video.evidence, video.tracker, features, settings.paper, rng)
        grown = paper_segmentation.part_poses(video.evidence, video.tracker, found, settings, rng)
        video.tracker = None
        return Known(grown)
    seeds = find_seeds(video.evidence, video.tracker, settings.seeds, rng)
    grown = grow(video.evidence, video.tracker, seeds, settings, rng)
    video.tracker = None  # a gigabyte perhaps, and no later stage looks at it
    return Known(grown)


@_solves
def _joint(video: _Video, known: Known, settings: ReconstructSettings, rng: np.random.Generator) -> Known:
    assert known.grown is not None
    evidence = video.evidence
    anew = settings.segmentation == "ours" or settings.paper.relabel
    grown = undo_exchanges(evidence, known.grown, settings.exchanges, rng) if anew else known.grown
    grown = bridge_gaps(evidence, grown, settings.gaps, rng)
    grown = _labels_again(evidence, grown, settings, rng) if anew else grown
    grown = replace(grown, poses=_type_again(evidence, grown, settings, rng))
    grown = bridge_gaps(evidence, grown, settings.gaps, rng)
    grown = _labels_again(evidence, grown, settings, rng) if anew else grown
    poses = joint_adjustment(evidence, grown.labels, grown.poses, grown.seen, settings.poses, rng)
    grown = fill_gaps(evidence, replace(grown, poses=poses), settings.gaps, rng)
    measured = grown.seen
    grown = _labels_again(evidence, grown, settings, rng) if anew else grown
    seen = measured & grown.seen  # what only now shows was not measured, and what is gone was not that part
    state_std = np.where(seen.all(1), grown.poses.state_std, np.inf)
    return Known(_reference_first(replace(grown, seen=seen, poses=replace(grown.poses, state_std=state_std))))


def _labels_again(evidence: Evidence, grown: Grown, settings: ReconstructSettings, rng: np.random.Generator) -> Grown:
    """`grown` with labels anew, unless they would lose a part."""
    last = relabel(evidence, grown, settings, rng)
    return last if last.seen.all(1).sum() >= 4 else grown


def _type_again(
    evidence: Evidence, grown: Grown, settings: ReconstructSettings, rng: np.random.Generator
) -> JointedPoses:
    """The joint type, decided at first by a few frames, is decided again by all."""
    poses = joint_adjustment(evidence, grown.labels, grown.poses, grown.seen, settings.poses, rng, 8)
    free = np.stack([found.Ts for found in _free(evidence, replace(grown, poses=poses), settings, rng)])
    body = body_points(evidence, grown.labels, free[1], grown.seen[:, 1])
    everywhere = np.ones(len(grown.labels), bool)
    return better_type(evidence, grown.labels, free, grown.seen, body, everywhere, settings, rng, poses)


@_solves
def _gaussians(video: _Video, known: Known, settings: ReconstructSettings, rng: np.random.Generator) -> Known:
    if not settings.gaussians.refine:
        return known
    grown = known.grown
    assert grown is not None
    gate = replace(settings.poses, gate=settings.poses.final_gate)

    def apart(poses: JointedPoses) -> float:
        same = np.random.default_rng(settings.seed)  # the same pixels, whatever the poses
        return joint_adjustment(video.evidence, grown.labels, poses, grown.seen, gate, same, 1).cost

    found = optimise(video.recording, video.scene, grown, settings, rng, video.progress, apart)
    if found is None:
        return known
    free = found.free if found.kept else ()
    return replace(known, grown=found.in_place_of(grown), free=free, appearance=found.gaussians)


@_solves
def _poses(video: _Video, known: Known, settings: ReconstructSettings, rng: np.random.Generator) -> Known:
    assert known.grown is not None
    if known.free:  # the model had them
        return known
    return replace(known, free=_free(video.evidence, known.grown, settings, rng))


def _free(
    evidence: Evidence, grown: Grown, settings: ReconstructSettings, rng: np.random.Generator
) -> tuple[FreePoses, ...]:
    """Poses of both parts without the joint."""
    return tuple(
        free_adjustment(evidence, grown.labels, k + 1, Ts, grown.seen[:, k], settings.poses, rng)
        for k, Ts in enumerate((grown.poses.Ts, grown.poses.Ts_moving))
    )


@_solves
def _surfaces(video: _Video, known: Known, settings: ReconstructSettings, rng: np.random.Generator) -> Known:
    assert known.grown is not None
    grown = known.grown
    meshes = [
        fuse(video.scene, grown.labels, k + 1, Ts, grown.seen[:, k], settings.surfaces)
        for k, Ts in enumerate((grown.poses.Ts, grown.poses.Ts_moving))
    ]
    articulation = Articulation(grown.poses.joint, meshes[0], meshes[1])
    camera = video.recording.camera
    size = (camera.width, camera.height)
    diagnostics = diagnose(video.evidence, grown, known.free, settings.poses, settings.joint, settings.seed, size)
    answer = _canonical(articulation, known.appearance, grown, known.free, video.scene, video.recording)
    diagnostics = replace(diagnostics, **surface_signs(video.scene, answer))
    return Known(answer=replace(answer, trust=judge(answer, diagnostics)), diagnostics=diagnostics)


def _reference_first(grown: Grown) -> Grown:
    """The part with more mask pixels over all frames becomes the first: the reference part."""
    first, second = (int((grown.labels == k).sum()) for k in (1, 2))
    if first >= second:
        return grown
    return exchanged(grown, np.ones(len(grown.labels), bool), 0.0)


def _canonical(
    articulation: Articulation,
    appearance: Gaussians | None,
    grown: Grown,
    free: tuple[FreePoses, ...],
    scene: Scene,
    recording: Recording,
) -> Reconstruction:
    """Everything in the camera frame with the object as in frame 0, state zero in frame 0."""
    q0 = float(grown.poses.states[0])
    T_zero = grown.poses.joint.transform(q0)
    joint = articulation.joint.spanning(grown.poses.states - q0)
    moving = articulation.moving.moved(T_zero)
    T_frame0 = free[0].Ts[0]
    Ts_moving = free[1].Ts @ se3.inverse(T_zero)
    back = se3.inverse(T_frame0)
    axis_std, pivot_std = (None, None) if grown.poses.joint_std is None else grown.poses.joint_std[0]
    return Reconstruction(
        Articulation(joint, articulation.reference, moving).moved(T_frame0),
        grown.poses.states - q0,
        free[0].Ts @ back,
        Ts_moving @ back,
        full_labels(scene, grown.labels, grown.logodds, recording),
        grown.seen,
        _finite_or_nan(grown.poses.state_std),
        np.stack([f.covariances for f in free], 1),
        axis_std=_number_or_none(axis_std),
        pivot_std=_number_or_none(pivot_std),
        appearance=None if appearance is None else _parted(appearance, T_zero).moved(T_frame0),
    )


def _parted(gaussians: Gaussians, T_zero: Array) -> Gaussians:
    """The same pictures in every state, with what moves placed anew by `T_zero`: the joint's motion at the new zero.

    No one place is right for a Gaussian of both parts. It becomes two, each of one part, with its opacity times its
    weight there: what blending draws of it. One too faint to be drawn at all is left out.
    """
    w = gaussians.part_weights
    opacities = gaussians.opacities * np.stack([w, 1 - w])
    part, i = np.nonzero(opacities > FAINT_COPY)
    here, there = gaussians, gaussians.moved(T_zero)
    placed = {
        name: np.where(part[:, None] == 0, getattr(here, name)[i], getattr(there, name)[i])
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


def _finite_or_nan(std: Array) -> NDArray[np.float64]:
    return np.where(np.isfinite(std), std, np.nan)


def _number_or_none(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


class _Clock:
    """Seconds per stage, and a progress bar over the stages."""

    def __init__(self, show: bool) -> None:
        self.seconds: dict[str, float] = {}
        self.running = STAGES[0].name
        """The stage that was begun last."""
        self._began = 0.0
        self._show, self._console = show, Console(stderr=True)
        self._bar = Progress(
            TextColumn("{task.description:>12}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=self._console,
            disable=not (show and self._console.is_terminal),
            transient=True,
        )
        self._task = self._bar.add_task(self.running, total=len(STAGES))

    def __enter__(self) -> _Clock:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times a stage by name; one that was timed before and is repeated keeps its time."""
        self._bar.update(self._task, description=name)
        self.running, self._began = name, time.perf_counter()
        try:
            yield
        finally:
            self.seconds = self.so_far()
            self._bar.update(self._task, completed=len(self.seconds))

    def progress(self, share: float) -> None:
        """Shows how much of the running stage is done, 0 to 1."""
        self._bar.update(self._task, completed=len(self.seconds) + share)

    def so_far(self) -> dict[str, float]:
        """Seconds of all stages, with what the running one has taken until now."""
        took = round(time.perf_counter() - self._began, 3)
        return {**self.seconds, self.running: self.seconds.get(self.running, took)}

    def go_on(self, kept: Kept) -> None:
        """Take over the seconds of stages that need not be solved again."""
        self.seconds = dict(kept.seconds)
        self._bar.update(self._task, completed=len(self.seconds))

    def say(self, line: str) -> None:
        """One plain line on standard error, when progress is shown."""
        if self._show:
            self._console.print(line, highlight=False, markup=False, soft_wrap=True)
