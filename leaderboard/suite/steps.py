"""The functions that the suite's jobs run, each in a process of its own (`freeart21.jobs`)."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freeart21 import child
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.jobs.worker import kill_with_parent, last_line, wait_for_child
from leaderboard.protocols import Metric, protocol_named
from leaderboard.reference import Kind, write_reference
from leaderboard.rows import Scores
from leaderboard.score import score_results
from leaderboard.scores_file import write_scores


def reference(kind: Kind, data: str, out: str, sequences: Sequence[str]) -> None:
    """Write the results folder of a reference row."""
    write_reference(kind, Path(data), Path(out), sequences=sequences)


def record(commands: Sequence[Sequence[str]], out: str) -> None:
    """Record sequences one after another into the data folder `out`; existing ones stay."""
    for words in commands:
        code, line = _freeart21("record", *words, "--out", out)
        if code:
            raise FreeArtError(line or f"record ended with exit code {code}")


def export(result: str) -> dict[str, Any]:
    """Export a result; returns whether it has an asset and why. Failures and results that cannot be exported have none.

    Raises FreeArtError when the disk or the exporter fails.
    """
    folder = Path(result)
    header = checked.read_json(folder / "prediction.json")
    if header.get("status") != "ok":
        return {"asset": False, "why": f"no answer: {header.get('reason')}"}
    atomic.recover_folder(folder / "asset")
    code, line = _freeart21("export", str(folder), "--out", str(folder / "asset"))
    if (folder / "asset" / "asset.json").is_file() and code in (0, 1, 3):  # 3: exported, but doubtful
        return {"asset": True, "why": line}
    if code == 1 and "cannot write" not in line:
        return {"asset": False, "why": line}
    raise FreeArtError(line or f"export ended with exit code {code}")


def score(results: str, data: str, protocol: str, out: str, sequences: Sequence[str]) -> dict[str, Any]:
    """Score a row and write its table; returns its statistics and the values that are not perfect."""
    scores = score_results(Path(results), Path(data), protocol, sequences=sequences)
    write_scores(Path(out), scores)
    return {"summaries": [asdict(summary) for summary in scores.summaries], "imperfect": list_imperfect(scores)}


TOLERANCE = 0.01
"""Largest deviation of the truth's own values from perfect, in their unit."""


def list_imperfect(scores: Scores) -> list[str]:
    """A line for each value that is further than TOLERANCE from perfect."""
    rules = protocol_named(scores.protocol)
    return [
        f"{row.sequence}: {metric.id} {value:.4g}, expected {perfect_value(metric):g}"
        for row in scores.rows
        for metric in rules.metrics
        if (value := row.values.get(metric.id)) is not None and abs(value - perfect_value(metric)) > TOLERANCE
    ]


def perfect_value(metric: Metric) -> float:
    """The value of a perfect answer."""
    if metric.direction == "down":
        return 0.0
    return 100.0 if "dB" in (metric.revolute_unit, metric.prismatic_unit) else 1.0


def _freeart21(*words: str) -> tuple[int, str]:
    """Run a freeart21 command; returns exit code and last line of standard error, which this job's log gets, too."""
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            [*child.command("freeart21.__main__"), *words],
            stdin=subprocess.DEVNULL,
            stderr=errors,
            preexec_fn=kill_with_parent(),
        )
        try:
            code = wait_for_child(process)
        finally:
            errors.seek(0)
            text = errors.read().decode(errors="replace")
            print(text, end="", file=sys.stderr, flush=True)
    return code, last_line(text).removeprefix("freeart21: ")
