"""The generator's commands: tyro reads each function's signature, and the help its docstring."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from freeart21 import processes
from freeart21.errors import FreeArtError
from generator.settings import RecordSettings, TeleopSettings

Positional: Any = tyro.conf.Positional
Flat: Any = tyro.conf.arg(name="")


@dataclass(frozen=True)
class RecordOptions:
    """What `record` records, and where."""

    names: Annotated[tuple[str, ...], Positional]
    """Objects of the catalog (`freeart21 objects`), URDFs as PATH.urdf, PartNet-Mobility ids, or `all`: freeart21-v1
    or, with --partnet-root, the 21 of the official FreeArt-21. With --seed or --motion: the built-in 21."""
    out: Path
    """Data folder; sequences are added to it."""
    frames: int | None = None
    """Frames per sequence; 300 when not given, or the length of the take."""
    seed: int | None = None
    """Seed of shape, motion, sensor and views; 0 when not given."""
    motion: str | None = None
    """tumble (when not given), inspect, wave, turntable, static_base, release, human, or track:FILE, a take (or
    teleop:FILE)."""
    procedural: str | None = None
    """Category, instead of names: --count new objects from the seed."""
    count: int = 1
    """Number of new objects."""
    split: Literal["public", "test"] = "public"
    """Of freeart21-v1: public (for tuning), test (scoring only)."""
    workers: int = 1
    """Processes that record in parallel, one sequence each."""
    executor: Literal["local", "ray", "slurm"] = "local"
    """Where to record: local (this machine), ray or slurm (--out on a file system that all machines share)."""
    settings: Annotated[RecordSettings, Flat] = field(default_factory=RecordSettings)

    def fill_settings(self) -> RecordSettings:
        """The settings with frames, seed and motion; a take has its own length."""
        track = None
        motion, frames = self.motion or "tumble", self.frames
        if motion.startswith(("track:", "teleop:")):
            file = motion.partition(":")[2]
            motion, track = "track", Path(file) if file else None
        if track is not None:
            from freeart21.formats.captured import read_track
            from generator.motion.track import count_frames

            lasts = count_frames(read_track(track), self.settings.fps)
            if frames is not None and frames < lasts:
                print(f"{track} lasts {lasts} frames; the {frames} with most joint motion are recorded")
            frames = lasts if frames is None else min(frames, lasts)
        frames = 300 if frames is None else frames
        return replace(self.settings, frames=frames, seed=self.seed or 0, motion=motion, track=track)


def record(options: Annotated[RecordOptions, Flat]) -> int:
    """Record objects in SAPIEN: the video for methods, and the ground truth in a separate folder.

    Can be stopped at any moment: the same command resumes, with the same data to the last byte.
    """
    from freeart21.files import checked
    from generator import v1
    from generator.dataset import is_unfinished, record_jobs
    from generator.motion.track import describe_changes

    out, settings = options.out, options.fill_settings()
    jobs, label = _planned_jobs(options, settings)
    v1.check_own_sequences(out, jobs, label)
    for job in jobs:
        for note in job.notes:
            print(f"{job.name}: {note}", file=sys.stderr)

    def done(sequence: str) -> None:
        print(out / "sequences" / sequence, flush=True)
        if settings.track is not None:
            source = checked.read_json(out / "truth" / sequence / "truth.json")["source"]
            print(f"{sequence}: {describe_changes(source['track'])}", file=sys.stderr, flush=True)

    with processes.resume_hint(
        lambda: f"finished sequences are in {out}: the same command goes on" if is_unfinished(out) else ""
    ):
        made = record_jobs(out, jobs, options.workers, label, done, options.executor)
    if not made:
        print(f"{out} already has {'this sequence' if len(jobs) == 1 else f'these {len(jobs)} sequences'}")
    return 0


def _planned_jobs(options: RecordOptions, settings: RecordSettings) -> tuple[list[Any], Any]:
    """The recorder's jobs, and the label of the data set (None: its own)."""
    from freeart21.catalog import built_in_names
    from generator import v1
    from generator.dataset import official_names, plan_jobs, procedural_jobs

    names, split, category = options.names, options.split, options.procedural
    if category is not None and names:
        raise FreeArtError(f"record: name objects or a category, not both; got {', '.join(names)} and {category}")
    frozen = names == ("all",) and settings.partnet_root is None and options.seed is None and options.motion is None
    if split != "public" and not frozen:
        raise FreeArtError(f"record: --split {split} needs freeart21-v1: the object `all`, without --seed and --motion")
    if frozen:
        return v1.jobs(split, settings), v1.label(split, settings)
    if category is not None:
        return procedural_jobs(category, options.count, settings.seed, settings), None
    if "all" in names and len(names) > 1:
        raise FreeArtError(f"record: `all` cannot be combined with names; got {' '.join(names)}")
    if names == ("all",):
        root = settings.partnet_root
        names = built_in_names() if root is None else official_names(root, settings.skip_missing)
    if not names:
        raise FreeArtError(f"record: got no object; expected some of {', '.join(built_in_names())}, or all")
    return plan_jobs(names, settings), None


def teleop(
    name: Annotated[str, Positional],
    out: Path,
    seed: int = 0,
    partnet_root: Path | None = None,
    joint: str | None = None,
    skip_missing: bool = False,
    root: Path | None = None,
    settings: Annotated[TeleopSettings, Flat] = TeleopSettings(),  # noqa: B008 (frozen)
) -> None:
    """Move an object and its joint by hand in a browser, and record the motion as a take.

    Prints an address with a secret token: the first to open it drives, others watch. `freeart21 record NAME --motion
    track:TAKE` replays a take at full quality. Needs the extra `teleop`.

    Args:
        name: Object of the catalog (`freeart21 objects`), a URDF as PATH.urdf, or a PartNet-Mobility id.
        out: File of the take. Nothing is replaced; further takes are numbered.
        seed: Seed of the object's shape and colours.
        partnet_root: Folder of PartNet-Mobility objects, as ROOT/41083/mobility.urdf or ROOT/dataset/41083.
        joint: Moving joint of a URDF, or of a PartNet-Mobility object for which the catalog names none.
        skip_missing: Leave out missing meshes of the object.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
    """
    from generator.teleop.start import serve

    record = RecordSettings(seed=seed, partnet_root=partnet_root, joint=joint, skip_missing=skip_missing, root=root)
    record.check()
    serve(name, out, settings, record)


def verify(data: Annotated[Path, Positional], deep: bool = False, truth: Path | None = None) -> int:
    """Check a data folder: every hash, every format, and that video and truth agree.

    A folder that was packed without its truth is searched for traces of the truth.

    Args:
        data: A data folder (with benchmark.json).
        truth: Folder of the truth of a packed data folder (from `freeart21 pack DATA --truth`).
        deep: Also render the truth's meshes and objects again, independently of the recorder.
    """
    from freeart21.files.verify import verify as verify_folder

    report = verify_folder(data, truth)
    if deep and not report.findings:
        from generator.golden import verify_deep

        report.findings.extend(verify_deep(data, hidden_truth=truth))
    for finding in report.findings:
        print(finding)
    if report.findings:
        return 1
    print(f"{data}: {report.files} files, {report.sequences} sequences: all well")
    return 0


def convert(
    source: Annotated[Path, Positional],
    out: Path,
    to: Literal["official", "native", "rgbd"],
    layout: Annotated[str | None, tyro.conf.arg(name="from")] = None,
    partnet_root: Path | None = None,
    joint: str | None = None,
    hold_out: bool = False,
    skip_missing: bool = False,
    depth_unit: float = 0.001,
    fps: float | None = None,
    masks: Path | None = None,
    longest_side: int = 1280,
) -> None:
    """Convert recordings of depth cameras, and between layouts: official, Video2Articulation-S, native.

    Args:
        source: A recording, or a folder of recordings.
        out: Folder to add to: a data folder (native), or one for examples/ and data/ (official).
        to: Layout to write.
        layout: native, tum, articulat3d, azure, record3d, rgbd, ros, stray, official or video2articulation.
        partnet_root: Folder of PartNet-Mobility objects, as ROOT/41083/mobility.urdf: a truth needs their meshes.
        joint: Moving joint, where neither the layout nor the catalog names it.
        hold_out: Write the official split: 5 % of the frames go to eval/.
        skip_missing: Leave out missing meshes of a PartNet-Mobility object.
        depth_unit: Metres per depth unit of a picture folder (rgb/, depth/, masks/, cam_K.txt).
        fps: Frames per second of such a folder; from time stamps in its names, or 30, when not given.
        masks: Folder with a mask for each picture that --to rgbd writes of a camera's recording.
        longest_side: Most pixels of width and height of a camera's pictures; larger ones are made smaller.
    """
    from freeart21.formats import convert as formats
    from freeart21.formats.third_party import ReadOptions
    from freeart21.progress import progress_bar
    from generator.third_party import complete_truth

    maker = partial(complete_truth, joint=joint, skip_missing=skip_missing)
    options = ReadOptions(depth_unit, fps, partnet_root, masks, longest_side)
    with progress_bar("Converting") as show:
        for done in formats.convert(source, out, to, layout, maker, options, hold_out, show):
            print(done.folder)
            for note in done.notes:
                print(f"{done.name}: {note}", file=sys.stderr)
