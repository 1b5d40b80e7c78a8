"""How well the solver solves what we did not make: real PartNet-Mobility objects, and a real video of a Kinect.

    .venv/bin/python -m benchmarks.outside [--partnet ROOT] [--videos FOLDER] [--sensor noise2] [--frames 120]

records every object in ROOT, each with the first joint that its file names, and solves it with the Gaussians and, from
the same geometry, without; scores both by strict-2 and prints them side by side, worst first. Videos, folders of a
camera's pictures (rgb/, depth/, masks/, cam_K.txt), have no truth: what was found of them is printed. What cannot be
recorded or converted is said and left out. Writes benchmarks/results/outside.json. A run that was stopped goes on.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import tyro

from benchmarks import solve
from benchmarks.common import RESULTS, ROOT, commit, machine
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.result import read_result
from freeart21.formats.convert import convert
from freeart21.reconstruction import Failure
from generator.dataset import Job, Label, jobs_of, record_jobs
from generator.session import RecordSettings
from reconstruct import VERSION
from reconstruct.cache import code_digest
from reconstruct.pipeline import reconstruct_folder
from reconstruct.settings import ReconstructSettings

WITHOUT = "no-gaussians"
SHARED = ROOT.parent / "shared"


def main(
    partnet: Path = SHARED / "partnet_mobility",
    videos: Path = SHARED / "rgbd",
    sensor: str = "noise2",
    frames: int = 120,
    seed: int = 0,
    objects: tuple[str, ...] = (),
    work: Path = ROOT / "out" / "outside",
    out: Path | None = None,
) -> None:
    """Solve and score outside data.

    Args:
        partnet: Folder of PartNet-Mobility objects.
        videos: Folder of videos with depth.
        sensor: That objects are recorded with.
        frames: Frames a recording.
        seed: Of motions, sensor and views.
        objects: These of the folder's objects alone.
        work: Where recordings and results are kept.
        out: The JSON file; benchmarks/results/outside.json when all objects were solved.
    """
    settings = ReconstructSettings(progress=False)
    variants = {solve.OURS: settings, WITHOUT: solve.without(settings, WITHOUT)}
    found: dict[tuple[str, str], solve.Outcome] = {}
    data = work / f"{sensor}-{frames}frames-s{seed}"
    recording = RecordSettings(partnet_root=partnet, sensor=sensor, frames=frames, seed=seed)
    todo = []
    for job in _jobs(partnet, objects, recording):
        record_jobs(data, [job], label=Label(f"outside-{sensor}"))
        tasks = []
        for name, its in variants.items():
            key = _key(job, its)
            kept = work / "kept" / f"{data.name}-{name}" / f"{job.sequence}.json"
            outcome = solve.read_outcome(kept, key)
            if outcome is not None:
                found[name, job.sequence] = outcome
                continue
            tasks.append(
                solve.Task(
                    object=job.name,
                    motion=job.settings.motion,
                    sequence=data / "sequences" / job.sequence,
                    truth=data / "truth" / job.sequence,
                    result=work / f"{data.name}-{name}" / job.sequence,
                    settings=its,
                    key=key,
                    data="",
                    variant=name,
                    kept=kept,
                    geometry=work / f"{data.name}-geometry" / job.sequence,
                )
            )
        if tasks:
            todo.append(tasks)
    found |= solve.solve_all(todo, 1, len(found))
    of = {name: solve.worst_first([o for (n, _), o in found.items() if n == name]) for name in variants}
    ours = of.pop(solve.OURS)
    seen = list(_videos(videos, work, settings))
    if not ours and not seen:
        raise FreeArtError(f"nothing to solve: neither objects in {partnet} nor videos in {videos}")
    solve.print_beside(ours, of, solve.Aim())
    for line in seen:
        print(json.dumps(line))
    if out is None and objects:
        return
    body: dict[str, Any] = {"videos": seen}
    if ours:
        body |= {**solve.figures(ours), "beside": {name: solve.figures(its) for name, its in of.items()}}
    facts = {"sensor": sensor, "frames": frames, "seed": seed, "protocol": solve.PROTOCOL, "solver": VERSION}
    path = out or RESULTS / "outside.json"
    atomic.write_json(path, {**body, "commit": commit(), "settings": facts, "machine": machine()})
    _say(str(path))


def _jobs(root: Path, objects: tuple[str, ...], settings: RecordSettings) -> Iterator[Job]:
    """A job for every object in `root`, or for those named."""
    there = sorted(file.parent.name for file in root.glob("*/mobility.urdf"))
    for name in objects:
        if name not in there:
            raise FreeArtError(f"{root} has no object '{name}'; it has {', '.join(there) or 'none'}")
    if not there:
        _say(f"{root} has no PartNet-Mobility object: none is solved")
    for name in objects or there:
        try:
            yield from jobs_of([name], replace(settings, joint=_first_joint(root / name / "mobility.urdf")))
        except FreeArtError as error:
            _say(f"left out: {error}")


def _first_joint(urdf: Path) -> str | None:
    kinds = ("revolute", "continuous", "prismatic")
    return next((j.get("name") for j in ElementTree.parse(urdf).iter("joint") if j.get("type") in kinds), None)


def _key(job: Job, settings: ReconstructSettings) -> str:
    """Of what an outcome depends on: the solver, its settings, and how the object is recorded."""
    facts = [solve.PROTOCOL, VERSION, code_digest(), settings.to_json(), job.described()]
    return hashlib.sha256(json.dumps(facts, sort_keys=True, default=str).encode()).hexdigest()


def _videos(folder: Path, work: Path, settings: ReconstructSettings) -> Iterator[dict[str, Any]]:
    """What is found of every video in `folder` that our converter reads."""
    for source in sorted(path for path in folder.glob("*") if (path / "cam_K.txt").is_file()):
        data, result = work / "videos" / source.name, work / "videos" / f"{source.name}-{code_digest()[:8]}"
        try:
            sequences = [done.folder for done in convert(source, data, "native")] if not data.exists() else []
        except FreeArtError as error:
            _say(f"left out: {error}")
            shutil.rmtree(data, ignore_errors=True)
            continue
        for sequence in sequences or sorted((data / "sequences").iterdir()):
            place = result / sequence.name
            answer = read_result(place) if place.exists() else reconstruct_folder(sequence, place, settings)
            yield {"video": source.name, "sequence": sequence.name, **_said(answer)}


def _said(answer: Any) -> dict[str, Any]:
    if isinstance(answer, Failure):
        return {"failed": answer.reason}
    joint, states = answer.articulation.joint, answer.states
    return {
        "joint": joint.type,
        "axis": [round(float(x), 3) for x in joint.axis],
        "states": [round(float(x), 4) for x in (states.min(), states.max())],
        "trust": answer.trust.verdict if answer.trust is not None else None,
        "seconds": {stage: round(s, 1) for stage, s in answer.seconds.items()},
    }


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except FreeArtError as error:
        raise SystemExit(f"outside: {error}") from error
    except KeyboardInterrupt:
        raise SystemExit(130) from None
