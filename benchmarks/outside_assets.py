"""How good the assets of strangers' objects are, from the video to the simulators.

    .venv/bin/python -m benchmarks.outside_assets [--partnet ROOT] [--mocap FOLDER] [--urdfs FOLDER]

records what `benchmarks.outside` finds of PartNet-Mobility objects and captured motion, solves each video by geometry
alone, scores the answer by strict-2, exports it and measures the asset as `benchmarks.assets` does, but for what needs
a true solid. Prints a table, worst first, and writes benchmarks/results/outside_assets.json. What cannot be recorded or
exported is listed with its reason. A run that was stopped goes on. Nothing of the data enters the repository.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks import assets, outside
from benchmarks.common import RESULTS, ROOT, run_cli, write_report
from benchmarks.solve import OURS, PROTOCOL, Case, Outcome, case_of, solve_cases, without
from export.collision import Contact
from freeart21.errors import FreeArtError
from freeart21.files.result import read_result
from freeart21.reconstruction import Failure
from reconstruct import VERSION
from reconstruct.settings import ReconstructSettings

FILE = "outside_assets.json"
SOLVED = ("axis", "state", "miou", "chamfer_w", "chamfer_m")
"""Metrics of the answer that are listed beside its asset."""


def main(
    partnet: Path = outside.SHARED / "partnet_mobility",
    mocap: Path = outside.SHARED / "mocap",
    urdfs: Path = outside.SHARED / "urdf_objects",
    clips: tuple[str, ...] = (),
    frames: int = 120,
    contact: Contact = "fine",
    workers: int = 1,
    work: Path = ROOT / "out" / "outside",
    out: Path | None = None,
) -> None:
    """Solve strangers' objects and measure their assets.

    Args:
        partnet: Folder of PartNet-Mobility objects.
        mocap: Folder of captured motion.
        urdfs: Folder of the objects that were captured, a folder each.
        clips: These alone: numbers of objects, or laptop, mixer, ketchup.
        frames: Frames of each video.
        contact: Collision shapes.
        workers: Objects that are solved, then exported, side by side.
        work: Where recordings, answers and assets are kept.
        out: The JSON file. When not given: benchmarks/results/outside_assets.json, and only when no clips are named.
    """
    found, left_out = outside.clips_of(partnet, mocap, urdfs, frames)
    if unknown := set(clips) - {clip.name for clip in found} - set(left_out):
        raise FreeArtError(f"there is no clip '{min(unknown)}'; there are {', '.join(c.name for c in found) or 'none'}")
    cases: dict[str, Case] = {}
    for clip in found:
        if not clips or clip.name in clips:
            try:
                folder, recording = outside.record(clip, work / f"{frames}frames")
                cases[clip.name] = case_of(recording, folder)
            except FreeArtError as error:
                left_out[clip.name] = str(error)
    settings = without(replace(ReconstructSettings(), progress=False), outside.BESIDE)
    solved = solve_cases(list(cases.values()), {OURS: settings}, work / "geometry-alone", workers)
    results, place = work / "geometry-alone" / "results" / OURS, work / f"assets-{contact}"
    for name in [name for name, case in cases.items() if not (results / case.sequence.name).is_dir()]:
        left_out[name] = solved[OURS, cases.pop(name).sequence.name].row.reason  # crashed
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        jobs = {
            name: pool.submit(
                assets.make_row, name, results / case.sequence.name, case.sequence, case.truth, contact, place
            )
            for name, case in cases.items()
        }
        rows = [
            {**describe_answer(solved[OURS, cases[name].sequence.name], results), **job.result()}
            for name, job in jobs.items()
        ]
    rows.sort(key=lambda row: sum(assets.is_missed(goal, row) for goal in assets.GOALS), reverse=True)
    assets.print_rows(rows)
    left_out = {name: outside.hide_roots(why, (partnet, mocap, urdfs)) for name, why in left_out.items()}
    for name, why in left_out.items():
        print(f"left out: {name}: {why}")
    if out is not None or not clips:
        facts = {"frames": frames, "seed": outside.SEED, "protocol": PROTOCOL, "solver": VERSION, "contact": contact}
        facts |= {"density": assets.DENSITY, "sensors": outside.SENSORS, "left_out": left_out}
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


if __name__ == "__main__":
    run_cli(main)
