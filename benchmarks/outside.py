"""The solver and its assets on data of others: real objects and real motion, from the video to the simulators.

    .venv/bin/python -m benchmarks.outside [--partnet ROOT] [--mocap FOLDER] [--urdfs FOLDER] [--clips 1305 laptop]

takes by path what is there of
- PartNet-Mobility: every object in ROOT, by the first joint of its URDF that moves, recorded by our generator with
  scripted motion. In the order of their numbers the sensors take turns: noise2, tof;
- captured motion (ARCTIC): how people moved a laptop, a mixer and a ketchup bottle, the files
  SUBJECT_OBJECT_use_TAKE.object.npy. The first take of each, the stretch over which the joint moves most, replayed on
  the object itself (OBJECT/OBJECT.urdf in the folder of URDFs, or the first other one there that can be recorded), or
  where it is absent on the built-in object of the like joint (`freeart21 record --motion track:FILE`);
what is absent, or cannot be recorded or exported, is left out with its reason. Solves each video by geometry alone (or
with --gaussians), scores the answer by strict-2, exports it and measures the asset as `benchmarks.assets` does, but for
what needs a true solid. Prints a table, worst first, and writes benchmarks/results/outside.json. A run that was stopped
goes on. Nothing of the data enters the repository. Real videos are `benchmarks.real_video`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks import assets
from benchmarks.common import RESULTS, ROOT, SHARED, run_cli, write_report
from benchmarks.solve import PIECES, PROTOCOL, Case, Outcome, case_of, solve_cases, with_changes
from export.settings import Contact
from freeart21.errors import FreeArtError
from freeart21.files.result import read_result
from freeart21.files.urdf import read_urdf_joints
from freeart21.reconstruction import Failure
from generator.dataset import Job, plan_jobs, record_jobs
from generator.session import TRACK, RecordSettings
from reconstruct import VERSION

FILE = "outside.json"
SOLVED = ("axis", "state", "miou", "chamfer_w", "chamfer_m")
"""Metrics of the answer that are listed beside its asset."""
SENSORS = ("noise2", "tof")
SEED = 7
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


def main(
    partnet: Path = SHARED / "partnet_mobility",
    mocap: Path = SHARED / "mocap",
    urdfs: Path = SHARED / "urdf_objects",
    clips: tuple[str, ...] = (),
    frames: int = 120,
    gaussians: bool = False,
    contact: Contact = "fine",
    workers: int = 1,
    work: Path = ROOT / "out" / "outside",
    out: Path | None = None,
) -> None:
    """Solve data of others and measure the assets.

    Args:
        partnet: Folder of PartNet-Mobility objects.
        mocap: Folder of captured motion.
        urdfs: Folder of the objects that were captured, a folder each.
        clips: These alone: numbers of objects, or laptop, mixer, ketchup.
        frames: Frames of each video.
        gaussians: Refine by Gaussians.
        contact: Collision shapes.
        workers: Objects that are solved, then exported, side by side.
        work: Where recordings, answers and assets are kept.
        out: The JSON file. When not given: benchmarks/results/outside.json, and only when no clips are named.
    """
    found, left_out = clips_of(partnet, mocap, urdfs, frames)
    if unknown := set(clips) - {clip.name for clip in found} - set(left_out):
        raise FreeArtError(f"there is no clip '{min(unknown)}'; there are {', '.join(c.name for c in found) or 'none'}")
    cases: dict[str, Case] = {}
    for clip in found:
        if not clips or clip.name in clips:
            try:
                folder, recording = record(clip, work / f"{frames}frames")
                cases[clip.name] = case_of(recording, folder)
            except FreeArtError as error:
                left_out[clip.name] = str(error)
    kind = "gaussians" if gaussians else "geometry-alone"
    settings = with_changes({} if gaussians else PIECES["no-gaussians"])
    solved = dict(zip(cases, solve_cases(list(cases.values()), settings, work / kind, workers), strict=True))
    results, place = work / kind / "results", work / f"assets-{kind}-{contact}"
    for name in [name for name, case in cases.items() if not (results / case.sequence.name).is_dir()]:
        left_out[name] = solved[name].row.reason  # crashed
        del cases[name]
    measured = assets.make_rows(
        {name: (results / case.sequence.name, case.sequence, case.truth) for name, case in cases.items()},
        contact, place, workers,
    )  # fmt: skip
    rows = [{**describe_answer(solved[row["object"]], results), **row} for row in measured]
    assets.print_rows(rows)
    left_out = {name: hide_roots(why, (partnet, mocap, urdfs)) for name, why in left_out.items()}
    for name, why in left_out.items():
        print(f"left out: {name}: {why}")
    if out is not None or not clips:
        facts = {"frames": frames, "seed": SEED, "protocol": PROTOCOL, "solver": VERSION, "contact": contact}
        facts |= {"gaussians": gaussians, "density": assets.DENSITY, "sensors": SENSORS, "left_out": left_out}
        write_report(out or RESULTS / FILE, facts, summary=assets.sum_up(rows), rows=rows)


def describe_answer(outcome: Outcome, results: Path) -> dict[str, Any]:
    """How good the answer is that was exported, and whether it is trusted."""
    answer = read_result(results / outcome.row.sequence, appearance=False)
    trust = None if isinstance(answer, Failure) or answer.trust is None else answer.trust.verdict
    return {
        **{metric: outcome.row.values[metric] for metric in SOLVED},
        "type": outcome.row.joint_type,
        "trust": trust,
        "solve_s": round(sum(outcome.seconds.values()), 1),
    }


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


if __name__ == "__main__":
    run_cli(main)
