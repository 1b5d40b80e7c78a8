"""The classical baselines on every sequence of the public split: run, scored, and summarised.

    .venv/bin/python -m benchmarks.baselines --data out/freeart21-v1

runs each method of METHODS by its descriptor (`freeart21 run`, which goes on where it was stopped) and scores it by
PROTOCOLS. Writes benchmarks/results/baselines.json: statistics by joint type, failures with their reasons, every row's
numbers, time and memory of every sequence, versions. masked-icp is given the true part masks: its row has a privileged
input.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import RESULTS, ROOT, commit, format_number, print_table, run_cli, write_report
from freeart21.files import checked
from leaderboard.cached import cached_scores
from leaderboard.methods.descriptor import PRIVILEGED, find_descriptor
from leaderboard.methods.run import RUN_SCHEMA, run_method
from leaderboard.points import TRACKS, row_points
from leaderboard.protocols import protocol_named
from leaderboard.rows import Scores

METHODS = ("two-motions", "rigid-clusters", "masked-icp")
PROTOCOLS = ("strict-2", "strict-3")
FILE = "baselines.json"


def describe(scores: Scores) -> dict[str, Any]:
    """The numbers of a table: statistics by group, points by track, failures, and every row."""
    rules = protocol_named(scores.protocol)
    tracks = {
        track: [points for row in scores.rows if (points := row_points(row, track, rules)) is not None]
        for track in TRACKS
    }
    return {
        "failures": sum(row.status != "ok" for row in scores.rows),
        "points": {track: float(np.mean(points)) if points else None for track, points in tracks.items()},
        "by_type": {summary.group: asdict(summary) for summary in scores.summaries},
        "rows": {row.sequence: {"status": row.status, "from": row.measured_from, **row.values} for row in scores.rows},
    }


def measure(name: str, data: Path, out: Path) -> dict[str, Any]:
    """Run and score one method; what the file says of it."""
    method = find_descriptor(name)
    run_method(method, data, out / name)
    run = checked.read_json(out / name / "run.json", RUN_SCHEMA)
    entries = run["sequences"].values()
    return {
        "about": method.about,
        "privileged": [key for key in method.inputs if key in PRIVILEGED],
        "versions": run["versions"],
        "cpu_seconds": {"median": float(np.median([e["cpu_seconds"] for e in entries])),
                        "worst": max(e["cpu_seconds"] for e in entries)},
        "seconds": {"median": float(np.median([e["seconds"] for e in entries])),
                    "worst": max(e["seconds"] for e in entries)},
        "peak_gb": max(e["peak_bytes"] for e in entries) / 1e9,
        "declared": {key: entry["reason"] for key, entry in run["sequences"].items() if entry["reason"]},
        "scores": {rules: describe(cached_scores(out / name, data, rules, out / "scores")) for rules in PROTOCOLS},
    }  # fmt: skip


def main(
    data: Path = ROOT / "out" / "freeart21-v1",
    out: Path = ROOT / "out" / "baselines",
    methods: tuple[str, ...] = METHODS,
    solved_at: str | None = None,
) -> None:
    """Run and score the baselines.

    Args:
        data: Data folder of the public split.
        out: Results, one folder a method, and their tables in scores/.
        methods: Some of METHODS; the file holds these alone.
        solved_at: Commit of the results, where a run of an earlier one went on.
    """
    found = {name: measure(name, data, out) for name in methods}
    rows = []
    for name, its in found.items():
        for rules, scores in its["scores"].items():
            mean = {key: value["mean"] for key, value in scores["by_type"]["all"]["statistics"].items()}
            numbers = [format_number(mean.get(key), 2) for key in ("axis", "miou", "psnr")]
            points = [format_number(scores["points"][track], 1) for track in TRACKS]
            rows.append([name, rules, scores["failures"], *numbers, *points, f"{its['cpu_seconds']['median']:.0f}"])
    head = ["method", "protocol", "failures", "axis, deg", "mIoU", "PSNR, dB", *TRACKS, "processor s"]
    print_table("baselines, all 21", head, rows)
    settings = {"data": data.name, "protocols": PROTOCOLS, "solved_at": solved_at or commit()}
    write_report(RESULTS / FILE, settings, methods=found)


if __name__ == "__main__":
    run_cli(main)
