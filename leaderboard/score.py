"""Scores a results folder against a benchmark: every metric of a protocol for every sequence, from files."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import pandas as pd
from numpy.typing import ArrayLike

from freeart21.errors import FreeArtError
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.hashes import file_sha256
from freeart21.reconstruction import Piece
from leaderboard.parallel_rows import FOLDERS, ROW_LIMIT_S, score_rows_as_jobs, score_rows_locally
from leaderboard.protocol import Group, Protocol
from leaderboard.protocols import DEFAULT, protocol_named
from leaderboard.provenance import with_provenance
from leaderboard.rows import Row, Scores, Statistic, Summary, frame
from leaderboard.sequence_score import score_sequence
from leaderboard.submission import read_submitted_method


def score_results(
    results: Path,
    data: Path,
    protocol: str = DEFAULT,
    progress: Callable[[Row, int], None] | None = None,
    limit_s: float | None = ROW_LIMIT_S,
    *,
    workers: int = 1,
    executor: str = "local",
    work: Path | None = None,
    sequences: Sequence[str] | None = None,
    truth: Path | None = None,
) -> Scores:
    """Score a method's results folder against the benchmark folder `data`: every sequence, missing ones included.

    `progress` gets each finished row and the number of rows. Rows are scored in separate processes, `workers` at a
    time; one that takes more than `limit_s` seconds is penalised. `limit_s` None scores in this process, without a
    limit. `executor` is one of `freeart21.jobs.EXECUTORS`; all but 'local' need a new folder `work` on a file system of
    all machines. Neither changes the numbers or the order of the rows. `sequences` limits the table to some of the
    benchmark's sequences, which a note says. `truth` is where the truth of a packed data folder lies
    (`leaderboard.pack`).

    Raises FreeArtError when the protocol or executor is unknown, `results` is not a results folder, or the benchmark is
    broken. A faulty result is penalised in its row.
    """
    start, results = time.perf_counter(), Path(results)
    rules = protocol_named(protocol)
    benchmark = read_benchmark(data, truth)
    check_results_folder(results, benchmark.sequences)
    method, faults = read_submitted_method(results)
    chosen = benchmark.select_sequences(sequences)
    requests: list[dict[str, Any]] = [
        {
            "result": str(results / name),
            "sequence": str(benchmark.sequence(name)),
            "truth": str(benchmark.truth(name)),
            "protocol": rules.name,
            "lacks": list(method.lacks),
        }
        for name in chosen
    ]

    def report(row: Row) -> None:
        if progress is not None:
            progress(row, len(chosen))

    if limit_s is None:
        rows = []
        for request in requests:
            result, sequence, truth_folder = (Path(request[key]) for key in FOLDERS)
            rows.append(score_sequence(result, sequence, truth_folder, rules.name, method.lacks))
            report(rows[-1])
    elif executor == "local":
        rows = score_rows_locally(requests, workers, limit_s, report)
    else:
        rows = score_rows_as_jobs(requests, workers, executor, limit_s, work, report)
    notes = [*(str(fault) for fault in faults), *describe_lacks(rules, method.lacks)]
    if len(chosen) < len(benchmark.sequences):
        notes.append(f"{len(chosen)} of {len(benchmark.sequences)} sequences were chosen: {', '.join(chosen)}")
    summaries = summarise(rows, rules)
    scores = Scores(rules.name, method, benchmark_facts(benchmark), tuple(rows), summaries, notes=tuple(notes))
    return replace(with_provenance(scores, results, benchmark), seconds=time.perf_counter() - start)


def benchmark_facts(benchmark: Benchmark) -> dict[str, str]:
    """The `benchmark` entry of a score table: name, version, split and hash."""
    return {
        "name": benchmark.name,
        "version": benchmark.version,
        "split": benchmark.split,
        "sha256": file_sha256(benchmark.folder / "benchmark.json"),
        **({"hidden": benchmark.hidden} if benchmark.hidden else {}),
    }


def describe_lacks(rules: Protocol, lacks: tuple[Piece, ...]) -> tuple[str, ...]:
    """A note that lists the metrics without a value because the method never produces the pieces `lacks`."""
    if not lacks:
        return ()
    absent = [metric.id for metric in rules.metrics if {*lacks} & {*metric.needs}]
    effect = f"no {', '.join(absent)}" if absent else f"no number of {rules.name} needs it"
    return (f"the method makes no {', '.join(lacks)}: {effect}",)


def check_results_folder(results: Path, sequences: tuple[str, ...]) -> None:
    """Raise FreeArtError unless `results` can be a method's results folder; suggests the folder above or below."""
    if not results.is_dir():
        raise FreeArtError(f"{results} is not a folder of results")
    if (results / "prediction.json").is_file():
        raise FreeArtError(
            f"{results} is the result of one sequence, expected the folder that holds all of a method: did you mean "
            f"{results.resolve().parent}?"
        )
    below = [child for child in sorted(results.iterdir()) if child.is_dir() and child.name not in sequences]
    methods = [child for child in below if any((child / name / "prediction.json").is_file() for name in sequences)]
    if methods and not any((results / name).exists() for name in sequences):
        raise FreeArtError(
            f"{results} holds results of methods rather than of sequences: did you mean "
            f"{' or '.join(str(method) for method in methods[:5])}?"
        )


def summarise(rows: Iterable[Row], rules: Protocol) -> tuple[Summary, ...]:
    """Statistics over the rows of each joint type and over all rows, for every metric with one unit in the group."""
    table, summaries = frame(rows), []
    for group in get_args(Group):
        chosen = table if group == "all" else table[table.truth_type == group]
        if chosen.empty:
            continue
        failures = int((chosen.status != "ok").sum())
        statistics = {
            id: statistic(chosen[id].dropna(), metric.direction)
            for metric in rules.metrics
            if metric.unit(group) is not None
            for id in (metric.id, f"{metric.id}_cm")
            if id in chosen and chosen[id].notna().any()
        }
        summaries.append(Summary(group, len(chosen), failures, 1 - failures / len(chosen), statistics))
    return tuple(summaries)


def statistic(values: ArrayLike, direction: Literal["up", "down"]) -> Statistic:
    """Mean, sample standard deviation (ddof 1), median and worst of one or more values (n,)."""
    column = pd.Series(values, dtype=float)
    std = float(column.std()) if len(column) > 1 else None
    worst = column.max() if direction == "down" else column.min()
    return Statistic(float(column.mean()), std, float(column.median()), float(worst), len(column))
