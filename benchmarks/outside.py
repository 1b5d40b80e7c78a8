"""The solver on data of others: real video, real objects, real motion; with and without its Gaussians.

    .venv/bin/python -m benchmarks.outside [--partnet ROOT] [--videos FOLDER] [--mocap FOLDER] [--urdfs FOLDER]
        [--clips 1305 laptop]

takes by path what is there of
- PartNet-Mobility: every object in ROOT, by the first joint of its URDF that moves, recorded by our generator with
  scripted motion. In the order of their numbers the sensors take turns: noise2, tof;
- captured motion (ARCTIC): how people moved a laptop, a mixer and a ketchup bottle, the files
  SUBJECT_OBJECT_use_TAKE.object.npy. The first take of each, the stretch over which the joint moves most, replayed on
  the object itself (OBJECT/OBJECT.urdf in the folder of URDFs, or the first other one there that can be recorded), or
  where it is absent on the built-in object of the like joint (`freeart21 record --motion track:FILE`);
- videos with depth: folders of a camera's pictures (rgb/, depth/, masks/, cam_K.txt). They have no truth: what is found
  is reported;
what is absent, or cannot be recorded, is left out with its reason. All is solved from one geometry with the Gaussians
and without, scored by strict-2 where a truth exists, printed worst first, written to benchmarks/results/outside.json.
A run that was stopped goes on from there. Nothing of the data enters the repository.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import RESULTS, ROOT, digest_of, format_number, make_table, run_cli, wide_console, write_report
from benchmarks.solve import (
    OURS,
    PROTOCOL,
    Aim,
    Outcome,
    case_of,
    figures,
    from_geometry,
    key_of,
    print_beside,
    print_outcomes,
    run_calls,
    solve_cases,
    without,
    worst_first,
)
from freeart21 import jobs
from freeart21.errors import FreeArtError
from freeart21.files.result import read_result
from freeart21.files.urdf import read_urdf_joints
from freeart21.formats import rgbd_folder
from freeart21.formats.convert import convert
from freeart21.reconstruction import Failure
from generator.dataset import Job, plan_jobs, record_jobs
from generator.session import TRACK, RecordSettings
from reconstruct import VERSION
from reconstruct.cache import code_digest
from reconstruct.pipeline import reconstruct_folder
from reconstruct.settings import ReconstructSettings, read_settings

BESIDE = "no-gaussians"
SENSORS = ("noise2", "tof")
SEED = 7
SHARED = ROOT.parent / "shared"
CAPTURED = {"laptop": "folding_display", "mixer": "long_arm_stapler", "ketchup": "flip_cap_usb"}
"""The object that was moved before the cameras, and the built-in one that stands in where its URDF is absent."""


@dataclass(frozen=True)
class Clip:
    """One recording of data of others."""

    name: str
    source: str
    """Whose data it is of, and their name of it."""
    settings: RecordSettings
    object: str


@dataclass(frozen=True)
class VideoAnswer:
    """What was found in a video whose truth nobody knows."""

    clip: str
    variant: str
    status: str
    """'ok', or what is hopeless."""
    joint_type: str | None = None
    axis: tuple[float, float, float] | None = None
    """In the camera's frame, with the object as in frame 0."""
    axis_std_deg: float | None = None
    range: float | None = None
    """Of the states, deg or mm."""
    trust: str | None = None
    seconds: float = 0.0


def main(
    partnet: Path = SHARED / "partnet_mobility",
    mocap: Path = SHARED / "mocap",
    urdfs: Path = SHARED / "urdf_objects",
    videos: Path = SHARED / "rgbd",
    clips: tuple[str, ...] = (),
    frames: int = 120,
    fresh: bool = False,
    work: Path = ROOT / "out" / "outside",
    out: Path | None = None,
    settings: ReconstructSettings = ReconstructSettings(),  # noqa: B008 (frozen)
) -> None:
    """Solve and score data of others.

    Args:
        partnet: Folder of PartNet-Mobility objects.
        mocap: Folder of captured motion.
        urdfs: Folder of the objects that were captured, a folder each.
        videos: Folder of videos with depth.
        clips: These alone: numbers of objects, laptop, mixer, ketchup, or names of videos.
        frames: Of what is recorded.
        fresh: Solve all anew, whatever is known.
        work: Where recordings, results and outcomes are kept.
        out: The JSON file. When not given: benchmarks/results/outside.json, and only when no clips are named.
        settings: Of the solver.
    """
    settings = replace(settings, progress=False)
    variants = {OURS: settings, BESIDE: without(settings, BESIDE)}
    chosen, left_out = clips_of(partnet, mocap, urdfs, frames)
    real = sorted(path for path in videos.glob("*") if rgbd_folder.is_rgbd_folder(path))
    if not real:
        left_out["videos"] = f"there are none in {videos}"
    named = [*(clip.name for clip in chosen), *(path.name for path in real)]
    unknown = [name for name in clips if name not in named and name not in left_out]
    if unknown:
        raise FreeArtError(f"there is no clip '{unknown[0]}'; there are {', '.join(named) or 'none'}")
    wanted = [clip for clip in chosen if not clips or clip.name in clips]
    cases = []
    for clip in wanted:
        try:
            folder, recording = record(clip, work / f"{frames}frames")
        except FreeArtError as error:
            left_out[clip.name] = str(error)
            continue
        case = case_of(recording, folder)
        cases.append(case if clip.settings.track is None else replace(case, motion="captured"))
    found = solve_cases(cases, variants, work / "solved", fresh=fresh)
    answers = _solve_videos([path for path in real if not clips or path.name in clips], variants, work, fresh, left_out)
    left_out = {name: hide_roots(why, (partnet, mocap, urdfs, videos)) for name, why in left_out.items()}
    of = {name: worst_first([o for (n, _), o in found.items() if n == name]) for name in variants}
    _print(of, answers, left_out)
    if out is None and clips:
        return
    facts = {
        "protocol": PROTOCOL,
        "solver": VERSION,
        "code": code_digest(),
        "solver_settings": settings.to_json(),
        "frames": frames,
        "seed": SEED,
        "clips": [
            {"name": c.name, "source": c.source, "object": Path(c.object).name, "sensor": c.settings.sensor}
            for c in wanted
        ],
        "left_out": left_out,
    }
    body = {**figures(of[OURS]), "beside": {BESIDE: figures(of[BESIDE])}, "without_truth": [asdict(t) for t in answers]}
    path = out or RESULTS / "outside.json"
    write_report(path, facts, **body)


# --- recordings -------------------------------------------------------------------------------------------------------


def clips_of(partnet: Path, mocap: Path, urdfs: Path, frames: int) -> tuple[list[Clip], dict[str, str]]:
    """What is to be recorded of the data there, by the rules above; and what is left out, with the reason."""
    clips, left_out = [], {}
    numbers = sorted((f.name for f in partnet.glob("*") if f.name.isdigit()), key=int)
    if not numbers:
        left_out["partnet"] = f"there are no objects in {partnet}"
    for k, number in enumerate(numbers):
        settings = _settings(frames, SENSORS[k % len(SENSORS)])
        try:
            joint = next(
                (j.name for j in read_urdf_joints(partnet / number / "mobility.urdf").values() if j.joint_type), ""
            )
        except FreeArtError as error:
            left_out[number] = str(error)
            continue
        settings = replace(settings, partnet_root=partnet, joint=joint, skip_missing=True)
        clips.append(Clip(number, f"PartNet-Mobility {number}", settings, number))
    for k, (thing, name) in enumerate(CAPTURED.items()):
        takes = sorted(mocap.glob(f"*_{thing}_use_*.object.npy"))
        if takes:
            settings = replace(_settings(frames, SENSORS[k % len(SENSORS)]), motion=TRACK, track=takes[0])
            clips.append(Clip(thing, f"ARCTIC {takes[0].name}", settings, str(own_urdf(urdfs / thing) or name)))
        else:
            left_out[thing] = f"there is no take of it in {mocap}"
    return clips, left_out


def own_urdf(folder: Path) -> Path | None:
    """The URDF of an object's folder that can be recorded, the one of the folder's name first; None where none can."""
    every = sorted(folder.glob("*.urdf"), key=lambda path: (path.stem != folder.name, path.name))
    for path in every:
        with contextlib.suppress(FreeArtError):
            plan_jobs([str(path)], _settings(2, "clean"))
            return path
    return None


def hide_roots(text: str, roots: Sequence[Path]) -> str:
    """A text without the machine's folders: each root by its own name."""
    for root in roots:
        text = text.replace(str(root), root.name)
    return text


def _settings(frames: int, sensor: str) -> RecordSettings:
    return RecordSettings(frames=frames, seed=SEED, sensor=sensor)


def record(clip: Clip, data: Path) -> tuple[Path, Job]:
    """The data folder that holds the clip, recorded unless it is there, and how it was recorded."""
    folder = data / ("scripted" if clip.settings.track is None else "tracks")
    job = plan_jobs([clip.object], clip.settings)[0]
    record_jobs(folder, [job])
    return folder, job


# --- a video without a truth ------------------------------------------------------------------------------------------


def _convert(source: Path, data: Path) -> Path:
    """The sequence of a folder of pictures, converted unless it is there."""
    sequence = data / "sequences" / source.name
    if not sequence.is_dir():
        list(convert(source, data, "native"))
    return sequence


def _solve_videos(
    sources: list[Path], variants: dict[str, ReconstructSettings], work: Path, fresh: bool, left_out: dict[str, str]
) -> list[VideoAnswer]:
    """What each variant finds in each video; those that cannot be converted, or solved, are added to `left_out`."""
    todo: list[jobs.Job] = []
    for source in sources:
        try:
            sequence = _convert(source, work / "videos")
        except FreeArtError as error:
            left_out[source.name] = str(error)
            continue
        files = digest_of(files=[path for path in sorted(sequence.rglob("*")) if path.is_file()])
        needs: tuple[str, ...] = ()
        for variant, settings in variants.items():
            name = f"{variant}/{source.name}"
            arguments = {
                "sequence": str(sequence.resolve()),
                "result": f"{{folder}}/results/{name}",
                "geometry": f"{{folder}}/geometry/{source.name}",
                "settings": f"{{folder}}/settings/{variant}.json",
            }
            call, key = "benchmarks.outside:solve_video", key_of(settings, files)
            todo.append(jobs.Job(name, call=call, arguments=arguments, needs=needs, key=key))
            needs = (name,)
    answers = []
    for name, answer in run_calls(work / "solved-videos", todo, variants, fresh=fresh).items():
        if "crash" in answer:
            left_out[name] = answer["crash"]
        else:
            answers.append(VideoAnswer(**answer))
    return answers


def solve_video(sequence: str, result: str, geometry: str, settings: str) -> dict[str, Any]:
    """Solve a video, in a process of its own; what was found, as JSON."""
    own = replace(read_settings(Path(settings)), progress=False)
    from_geometry(Path(sequence), Path(result), Path(geometry), own)
    reconstruct_folder(Path(sequence), Path(result), own)
    return asdict(describe_answer(Path(result), Path(settings).stem))


def describe_answer(result: Path, variant: str) -> VideoAnswer:
    """What a result folder says of its joint."""
    answer = read_result(result)
    seconds = sum(answer.seconds.values())
    if isinstance(answer, Failure):
        return VideoAnswer(result.name, variant, f"{answer.stage}: {answer.reason}", seconds=seconds)
    joint = answer.articulation.joint
    unit = 180 / np.pi if joint.type == "revolute" else 1000.0
    return VideoAnswer(
        clip=result.name,
        variant=variant,
        status="ok",
        joint_type=joint.type,
        axis=(float(joint.axis[0]), float(joint.axis[1]), float(joint.axis[2])),
        axis_std_deg=None if answer.axis_std is None else float(np.degrees(answer.axis_std)),
        range=float(np.ptp(answer.states[answer.seen.all(1)]) * unit) if answer.seen.all(1).any() else None,
        trust=None if answer.trust is None else answer.trust.verdict,
        seconds=seconds,
    )


# --- tables -----------------------------------------------------------------------------------------------------------


def _print(of: dict[str, list[Outcome]], answers: list[VideoAnswer], left_out: dict[str, str]) -> None:
    console = wide_console()
    if of[OURS]:
        print_outcomes(of[OURS], Aim(), "data of others")
        print_beside(of[OURS], {BESIDE: of[BESIDE]}, Aim())
    if answers:
        head = ("video", "variant", "", "joint", "axis, camera", "± deg", "range", "trust", "s")
        console.print(make_table("no truth", head, map(_cells, answers), texts=head[1:]))
    for name, why in left_out.items():
        console.print(f"  left out: {name}: {why}", markup=False, highlight=False)


def _cells(t: VideoAnswer) -> tuple[str, ...]:
    axis = "-" if t.axis is None else ", ".join(f"{x:.3f}" for x in t.axis)
    span = "-" if t.range is None else f"{t.range:.1f} {'deg' if t.joint_type == 'revolute' else 'mm'}"
    std = format_number(t.axis_std_deg, 2)
    return t.clip, t.variant, t.status, t.joint_type or "-", axis, std, span, t.trust or "-", f"{t.seconds:.0f}"


if __name__ == "__main__":
    run_cli(main)
