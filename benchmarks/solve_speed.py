"""Processor seconds of the solver's stages against frames, pixels and Gaussians.

    .venv/bin/python -m benchmarks.solve_speed [--object stapler] [--frames 24 48] [--heights 180 360]
        [--gaussians 5000 20000] [--rounds 2] [--sensor clean]

prints a table and writes benchmarks/results/solve_speed.json (commit, machine, settings, summary, a row a case). A case
is one recording, solved in this process: the first of `frames` at the first of `heights` without Gaussians, and from
there one quantity changed at a time. A small case that is not measured comes first, so that everything is compiled.

Processor seconds are those of all threads, user and system. They depend on the other load of the machine (two threads
of one core slow each other down), so cases to be compared belong into one run on a quiet machine; `wall_s` over
`cpu_s` tells how quiet it was. Numbers of different objects or motions are not comparable: propagation takes more where
a part is lost.
"""

from __future__ import annotations

import resource
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, print_table, run_cli, write_report
from freeart21.errors import FreeArtError
from freeart21.files.sequence import read_sequence
from freeart21.reconstruction import Failure
from generator.recorder import record
from generator.session import RecordSettings
from reconstruct import VERSION, pipeline
from reconstruct.settings import ReconstructSettings
from reconstruct.stages import STAGES

WARM_UP = (24, 180, 500)
"""Frames, height and Gaussians of the case that is not measured."""
MEASURED = tuple(stage.name for stage in STAGES if stage.name != "renders")


def main(
    object: str = "stapler",
    frames: tuple[int, ...] = (24, 48),
    heights: tuple[int, ...] = (180, 360),
    gaussians: tuple[int, ...] = (5000, 20000),
    rounds: int = 2,
    sensor: str = "clean",
    seed: int = 1,
    out: Path = RESULTS / "solve_speed.json",
) -> None:
    """Measure the solver's stages.

    Args:
        object: Of the catalog.
        frames: Lengths of the video.
        heights: Heights of the picture, pixels; 16 by 9.
        gaussians: Numbers of Gaussians, at the start and at most; none leaves the stage out.
        rounds: Rounds of their optimisation; the default of the solver is 12, and their time is proportional to it.
        sensor: Of the recorder.
        seed: Of shape, motion and sensor.
        out: The JSON file.
    """
    first = (frames[0], heights[0], 0)
    cases = [first, *((n, *first[1:]) for n in frames[1:]), *((first[0], h, 0) for h in heights[1:])]
    cases += [(*first[:2], most) for most in gaussians]
    with tempfile.TemporaryDirectory(prefix="freeart21-") as folder:
        chosen = {"seed": seed, "sensor": sensor, "queries": 0}
        solved = [_solve(object, case, rounds, chosen, Path(folder)) for case in (WARM_UP, *cases)]
    rows = solved[1:]
    head = [
        "frames",
        "width",
        "height",
        "object_pixels",
        "gaussians",
        *(f"{name}_s" for name in MEASURED),
        "cpu_s",
        "wall_s",
    ]
    cells = [[f"{row[key]:.1f}" if isinstance(row[key], float) else row[key] for key in head] for row in rows]
    print_table(f"processor seconds, {object}, {sensor}", head, cells)
    summary = {
        f"geometry_s_a_frame_{row['frames']}x{row['height']}": _geometry(row) / row["frames"]
        for row in rows
        if not row["gaussians"]
    }
    settings = {"object": object, "rounds": rounds, **chosen, "solver": VERSION}
    write_report(out, settings, summary=summary, rows=rows)


def _geometry(row: dict[str, Any]) -> float:
    """Processor seconds of all stages but the Gaussians'."""
    return float(row["cpu_s"] - row["gaussians_s"])


def _solve(name: str, case: tuple[int, int, int], rounds: int, chosen: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The row of one case: processor seconds of each stage."""
    frames, height, most = case
    width = round(height * 16 / 9)
    data = folder / f"{frames}x{height}"
    sequence = record(name, data, RecordSettings(frames=frames, width=width, height=height, **chosen))
    recording = read_sequence(data / "sequences" / sequence)
    settings = ReconstructSettings(progress=False)
    own = {"begin": most, "most": most, "rounds": rounds, "warm_up": 1} if most else {"refine": False}
    settings = replace(settings, gaussians=replace(settings.gaussians, **own))
    with _processor_seconds() as seconds:
        answer = pipeline.reconstruct(recording, settings)
    if isinstance(answer, Failure):
        raise FreeArtError(f"{name} with {frames} frames of {width} x {height} is not solved: {answer.reason}")
    return {
        "frames": frames,
        "width": width,
        "height": height,
        "object_pixels": int((answer.part_masks > 0).sum((1, 2)).mean()),
        "gaussians": 0 if answer.appearance is None else len(answer.appearance),
        **{f"{stage}_s": spent for stage, spent in seconds.items()},
        "cpu_s": sum(seconds.values()),
        "wall_s": sum(answer.seconds.values()),
    }


@contextmanager
def _processor_seconds() -> Iterator[dict[str, float]]:
    """The processor seconds of every stage that is solved within, by its name."""
    seconds: dict[str, float] = {}
    own = pipeline._StageClock.stage

    def used() -> float:
        usage = resource.getrusage(resource.RUSAGE_SELF)
        return usage.ru_utime + usage.ru_stime

    @contextmanager
    def timed(self: Any, name: str) -> Iterator[None]:
        before = used()
        with own(self, name):
            yield
        seconds[name] = seconds.get(name, 0.0) + used() - before

    pipeline._StageClock.stage = timed
    try:
        yield seconds
    finally:
        pipeline._StageClock.stage = own


if __name__ == "__main__":
    run_cli(main)
