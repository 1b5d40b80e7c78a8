"""The whole path on several objects: record, reconstruct, export, reload, score by strict-2.

    .venv/bin/python -m benchmarks.thin_path --partnet-root DIR

prints the table and writes benchmarks/results/thin_path.json (commit, machine, settings, summary, a row a sequence).
Finished stages are kept in --work and not repeated.
"""

from __future__ import annotations

import itertools
from dataclasses import asdict
from pathlib import Path

import tyro

from benchmarks.common import RESULTS, ROOT, commit, machine
from freeart21 import cli
from freeart21.files.atomic import write_json
from freeart21.files.benchmark import write_benchmark
from leaderboard.score import score_results
from leaderboard.tables import print_scores


def main(
    names: tuple[str, ...] = ("stapler", "drawer_unit", "flip_lighter"),
    real: tuple[str, ...] = ("41083:joint_2",),
    partnet_root: Path | None = None,
    frames: int = 120,
    seeds: tuple[int, ...] = (0, 7),
    work: Path = ROOT / "out" / "thin_path",
    out: Path = RESULTS / "thin_path.json",
) -> None:
    """Run the thin path.

    Args:
        names: Built-in objects.
        real: PartNet-Mobility objects as ID:JOINT; used when partnet_root is given.
        partnet_root: Folder that holds PartNet-Mobility objects.
        frames: Frames a sequence.
        seeds: Seeds of shape, motion and views.
        work: Where data and results are kept.
        out: The JSON file.
    """
    data, results = work / "data", work / "results" / "ours"
    wanted = [(name, None) for name in names]
    if partnet_root is not None:
        wanted += [tuple(entry.split(":", 1)) for entry in real]
    for (name, joint), seed in itertools.product(wanted, seeds):
        if not any((data / "truth").glob(f"{name}*-s{seed}/truth.json")):
            cli.record((name,), data, frames, seed, partnet_root if joint else None, joint)
    benchmark = write_benchmark(data, "thin-path", "1", "public")
    for name in benchmark.sequences:
        if (
            not (results / name / "prediction.json").is_file()
            and cli.reconstruct(benchmark.sequence(name), results / name) == 0
        ):
            cli.export(results / name, results / name / "asset")
    scores = score_results(results, data, "strict-2")
    print_scores(scores)
    write_json(
        out,
        {
            "summary": {s.group: asdict(s) for s in scores.summaries},
            "rows": [asdict(row) for row in scores.rows],
            "protocol": scores.protocol,
            "commit": commit(),
            "machine": machine(),
            "settings": {"frames": frames, "seeds": seeds, "names": names, "real": real if partnet_root else []},
        },
    )


if __name__ == "__main__":
    tyro.cli(main)
