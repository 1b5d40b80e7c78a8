"""How long scoring takes: a whole benchmark of answers with assets, in seconds, processor seconds and memory.

    .venv/bin/python -m benchmarks.score --data data/v1 [--results results/NAME] [--workers 2]

scores all sequences of the data folder and writes benchmarks/results/score.json: wall seconds, processor seconds and
the most memory of all processes together, seconds a row, and what the processor seconds of some rows went into. The
goal is 21 sequences of 300 frames in 90 s and 2 GB on two cores.

Without --results it makes its own under --work, one a sequence, and goes on where an earlier call stopped: the truth
with the axis half a degree and the pivot two millimetres off, states, poses, masks and views a little wrong, parts of
`faces` faces that wave by half a millimetre, and the asset that `freeart21 export` makes of it.
"""

from __future__ import annotations

import cProfile
import os
import pstats
import resource
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the processes that score

import numpy as np
import trimesh

from benchmarks.common import RESULTS, ROOT, run_cli, write_report
from export.exporter import export_result
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.result import Method, write_method, write_result
from freeart21.files.truth import read_truth
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.truth import Truth
from leaderboard.score import score_results
from leaderboard.sequence_score import score_sequence

AXIS_OFF, PIVOT_OFF_M, STATE_OFF = np.deg2rad(0.5), 0.002, 0.01
"""By how much a made answer is wrong: its joint, and its states as a share of their range."""
WAVE_M, WAVES_PER_M = 0.0005, 400.0
"""Height and wave number, rad/m, of the waves in the parts of a made answer."""
STAGES = {
    "read_sequence": "list the sequence",
    "read_truth": "read the truth",
    "read_submission": "read and check the answer",
    "apply_asset": "load, drive and check the asset",
    "match": "match parts by their masks",
    "surface_values": "surface distances",
    "picture_values": "held-out views",
    "_read_renders": "read held-out views",
}
"""Function of the scorer to what it does; none of them calls another."""
SAMPLE_S = 0.05
"""Between looks at the memory of all processes: a row takes seconds."""


@dataclass(frozen=True)
class Used:
    """What a piece of work took, all its processes together."""

    wall_s: float
    cpu_s: float
    peak_bytes: int
    """Most memory at one time (proportional set size where Linux tells it), this process' own included."""


def main(
    data: Path = ROOT / "data" / "v1",
    results: Path | None = None,
    work: Path = ROOT / "out" / "benchmark-score",
    protocol: str = "strict-2",
    workers: int = 2,
    faces: int = 100_000,
    profiled: int = 3,
    out: Path = RESULTS / "score.json",
) -> None:
    """Measure the scorer.

    Args:
        data: The data folder: all its sequences are scored (`freeart21 record --split public --out data/v1`).
        results: A method's results; none makes answers of its own in `work`.
        work: Where answers are made, and kept for the next call.
        protocol: By which is scored.
        workers: Rows scored side by side.
        faces: Least number of faces of a made answer's parts.
        profiled: Rows that are scored once more, in this process, to see what their time goes into.
        out: The JSON file.
    """
    benchmark = read_benchmark(data)
    made = results is None
    results = results or make_results(benchmark, work / f"results-{faces}", faces)
    with measure_use() as used:
        rows = score_results(results, benchmark.folder, protocol, workers=workers).rows
    whole = used()
    stages = _stages(results, benchmark, protocol, profiled)
    write_report(
        out,
        {
            "protocol": protocol,
            "workers": workers,
            "results": "made" if made else results.name,
            "faces": faces if made else None,
            "benchmark": benchmark.name,
        },
        summary={
            "sequences": len(rows),
            "measured": sum(row.status == "ok" for row in rows),
            "wall_s": whole.wall_s,
            "cpu_s": whole.cpu_s,
            "cpu_s_a_row": whole.cpu_s / len(rows),
            "peak_bytes": whole.peak_bytes,
            "load_before": os.getloadavg()[0],
        },
        stages=stages,
        rows=[{"sequence": r.sequence, "status": r.status, "measured_from": r.measured_from} for r in rows],
    )
    print(
        f"{len(rows)} sequences: {whole.wall_s:.1f} s, {whole.cpu_s:.1f} processor seconds, "
        f"{whole.peak_bytes / 1e9:.2f} GB"
    )
    for name, seconds in stages.items():
        print(f"{seconds:8.2f} processor s a row: {name}")


def make_results(benchmark: Benchmark, folder: Path, faces: int) -> Path:
    """Answers with assets to all sequences of `benchmark` in `folder`; those that are there are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    write_method(folder, Method("benchmark", "the truth, a little wrong", {"faces": faces}))
    todo = [name for name in benchmark.sequences if not (folder / name / "asset").is_dir()]
    for name in todo:
        print(f"making an answer to {name}", flush=True)
        truth = read_truth(benchmark.truth(name))
        queries = len(list((benchmark.truth(name) / "queries" / "rgb").glob("*.png")))
        views = [_dim(truth.query_rgb(i)) for i in range(queries)]
        write_result(folder / name, make_answer(truth, faces), renders=views)
        export_result(folder / name, folder / name / "asset")
    return folder


def make_answer(truth: Truth, faces: int, seed: int = 0) -> Reconstruction:
    """The truth, a little wrong; its parts have `faces` faces or more."""
    rng = np.random.default_rng(seed)
    joint, n = truth.articulation.joint, len(truth)
    aside = np.cross(joint.axis, np.eye(3)[np.argmin(np.abs(joint.axis))])
    axis = joint.axis + np.tan(AXIS_OFF) * aside / np.linalg.norm(aside)
    pivot = joint.pivot + PIVOT_OFF_M * aside / np.linalg.norm(aside)
    joint = replace(joint, axis=axis / np.linalg.norm(axis), pivot=pivot)
    states = truth.states + STATE_OFF * truth.range_of_motion * rng.normal(size=n)
    shake = se3.exp_se3(rng.normal(size=(n, 6)) * [0.001, 0.001, 0.001, 0.002, 0.002, 0.002])
    poses = truth.Ts_camera_reference @ shake
    parts = (_wave(part, faces) for part in (truth.articulation.reference, truth.articulation.moving))
    masks = np.stack([np.roll(truth.part_mask(i), 1, axis=1) for i in range(n)])
    return Reconstruction(
        Articulation(joint, *parts), states, poses, poses @ joint.transform(states), masks, np.ones((n, 2), bool)
    )


def _wave(part: Mesh, faces: int) -> Mesh:
    """`part`, its largest faces cut in four until there are `faces`, with small waves all over it."""
    vertices, triangles = np.array(part.vertices), np.array(part.faces)
    while len(triangles) < faces:
        areas = Mesh(vertices, triangles).areas()
        most = max(min((faces - len(triangles) + 2) // 3, len(triangles)), 1)
        vertices, triangles = trimesh.remesh.subdivide(vertices, triangles, np.argsort(-areas, kind="stable")[:most])
    return Mesh(vertices + WAVE_M * np.sin(WAVES_PER_M * vertices[:, [1, 2, 0]]), triangles)


def _dim(picture: np.ndarray) -> np.ndarray:
    return (picture * 0.95).astype(np.uint8)


def _stages(results: Path, benchmark: Benchmark, protocol: str, rows: int) -> dict[str, float]:
    """Processor seconds a row of each stage, over `rows` rows scored one after another in this process."""
    chosen = benchmark.sequences[:: max(len(benchmark.sequences) // rows, 1)][:rows] if rows else ()
    if not chosen:
        return {}

    def score(name: str) -> None:
        score_sequence(results / name, benchmark.sequence(name), benchmark.truth(name), protocol)

    score(chosen[0])  # imports and compiled kernels
    profile, before = cProfile.Profile(time.process_time), (time.process_time(), _cpu_of_all())
    profile.enable()
    for name in chosen:
        score(name)
    profile.disable()
    own, whole = time.process_time() - before[0], _cpu_of_all() - before[1]
    seconds = dict.fromkeys(STAGES.values(), 0.0)
    for (_, _, function), (_, _, _, total, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        if function in STAGES:
            seconds[STAGES[function]] += total / len(chosen)
    seconds[STAGES["apply_asset"]] += (whole - own) / len(chosen)  # in a process of its own
    seconds["all else"] = whole / len(chosen) - sum(seconds.values())
    return seconds


@contextmanager
def measure_use() -> Iterator[Any]:
    """A function that says, when the block has ended, what it used, all its processes together."""
    most, stop = 0, threading.Event()

    def watch() -> None:
        nonlocal most
        while not stop.wait(SAMPLE_S):
            most = max(most, sum(map(_memory, [os.getpid(), *descendants(os.getpid())])))

    watcher = threading.Thread(target=watch, daemon=True)
    began, cpu = time.perf_counter(), _cpu_of_all()
    watcher.start()
    used = Used(0.0, 0.0, 0)
    try:
        yield lambda: used
    finally:
        stop.set()
        watcher.join()
        used = Used(time.perf_counter() - began, _cpu_of_all() - cpu, most)


def descendants(pid: int) -> list[int]:
    """All processes that `pid` has started, and those that they have (Linux)."""
    children: dict[int, list[int]] = {}
    for place in Path("/proc").glob("[0-9]*"):
        fields = _stat(int(place.name))
        if fields:
            children.setdefault(int(fields[1]), []).append(int(place.name))
    found, waiting = [], [pid]
    while waiting:
        below = children.get(waiting.pop(), [])
        found += below
        waiting += below
    return found


def _cpu_of_all() -> float:
    """Processor seconds of this process and all that it has started, ended ones included once they were waited for."""
    tick = os.sysconf("SC_CLK_TCK")
    running = sum(sum(map(int, fields[11:15])) for pid in descendants(os.getpid()) if (fields := _stat(pid)))
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime + running / tick


def _stat(pid: int) -> list[str]:
    """The fields of /proc/PID/stat after the name; empty when there is no such process (any more)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def _memory(pid: int) -> int:
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("Pss:"))
    except (OSError, StopIteration):
        return 0


if __name__ == "__main__":
    run_cli(main)
