"""Scoring results against a benchmark: every number of a protocol, from files, with nothing dropped."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import pandas as pd
from numpy.typing import ArrayLike

from freeart21.errors import FreeArtError
from freeart21.files.benchmark import Benchmark, file_sha256, read_benchmark
from freeart21.reconstruction import Piece
from leaderboard.parallel_rows import PLACES, score_rows_as_jobs, score_rows_locally
from leaderboard.protocol import Group, Protocol
from leaderboard.protocols import DEFAULT, protocol_named
from leaderboard.provenance import with_provenance
from leaderboard.rows import Row, Scores, Statistic, Summary, frame
from leaderboard.sequence_score import score_sequence
from leaderboard.submission import read_submitted_method
from leaderboard.worker import ROW_LIMIT_S


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
    """Score the results folder of one method against the benchmark folder `data`: every sequence of it, found or not.

    `progress` is called with each row, as it is done, and how many there will be. Rows are scored in processes of their
    own, `workers` at a time, and one that takes more than `limit_s` seconds is priced; None: in this process, without a
    limit. The numbers and the order of the rows do not depend on `workers` and `executor`
    (`freeart21.jobs.EXECUTORS`); another one than 'local' needs a new folder `work` that its machines see. `sequences`
    chooses some of the benchmark's, and the table says so in a note. `truth` is where the truth of a data folder lies
    that was packed without (`leaderboard.pack`).

    Raises FreeArtError when the protocol or executor is unknown, `results` is not a folder of results, or the benchmark
    is broken; whatever is wrong with one result is priced in its row.
    """
    begun, results = time.perf_counter(), Path(results)
    rules = protocol_named(protocol)
    benchmark = read_benchmark(data, truth)
    check_results_folder(results, benchmark.sequences)
    method, faults = read_submitted_method(results)
    chosen = benchmark.chosen(sequences)
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
    told = (lambda row: progress(row, len(chosen))) if progress else (lambda row: None)
    if limit_s is None:
        rows = []
        for request in requests:
            places = [Path(request[key]) for key in PLACES]
            rows.append(score_sequence(places[0], places[1], places[2], rules.name, method.lacks))
            told(rows[-1])
    elif executor == "local":
        rows = score_rows_locally(requests, workers, limit_s, told)
    else:
        rows = score_rows_as_jobs(requests, workers, executor, limit_s, work, told)
    notes = [*(str(fault) for fault in faults), *describe_lacks(rules, method.lacks)]
    if len(chosen) < len(benchmark.sequences):
        notes.append(f"{len(chosen)} of {len(benchmark.sequences)} sequences were chosen: {', '.join(chosen)}")
    summaries = summarise(rows, rules)
    scores = Scores(rules.name, method, benchmark_facts(benchmark), tuple(rows), summaries, notes=tuple(notes))
    return replace(with_provenance(scores, results, benchmark), seconds=time.perf_counter() - begun)


def benchmark_facts(benchmark: Benchmark) -> dict[str, str]:
    """What a table of scores says of the benchmark that it is of."""
    return {
        "name": benchmark.name,
        "version": benchmark.version,
        "split": benchmark.split,
        "sha256": file_sha256(benchmark.folder / "benchmark.json"),
        **({"hidden": benchmark.hidden} if benchmark.hidden else {}),
    }


def describe_lacks(rules: Protocol, lacks: tuple[Piece, ...]) -> tuple[str, ...]:
    """A line that says which numbers there are not, as the method does not make what it `lacks`."""
    if not lacks:
        return ()
    absent = [metric.id for metric in rules.metrics if {*lacks} & {*metric.needs}]
    said = f"no {', '.join(absent)}" if absent else f"no number of {rules.name} needs it"
    return (f"the method makes no {', '.join(lacks)}: {said}",)


def check_results_folder(results: Path, sequences: tuple[str, ...]) -> None:
    """FreeArtError unless `results` may be the folder of one method; one level too high or too low names the other."""
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
    """Statistics over all rows of each joint type, then over all rows, for every metric that has one unit there."""
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
