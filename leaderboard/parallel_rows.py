"""Scores the rows of one table in separate processes: in parallel on this machine, or as jobs of an executor."""

from __future__ import annotations

import queue
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freeart21 import stopping
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.jobs import Job, run_jobs
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row
from leaderboard.sequence_score import SequenceScorer
from leaderboard.worker import RowAborted, Worker

FOLDERS = ("result", "sequence", "truth")
"""Keys of the folders in a request."""
MOST_WORKERS = 64
MEMORY_GB, LEAST_LIMIT_S = 4.0, 600.0
"""What a job of one row reserves, and its limit besides the row's own: the start of its process, on a busy machine."""

Request = Mapping[str, Any]
"""What a `Worker` scores: the FOLDERS, the name of a `protocol`, and `lacks`, pieces the method never produces."""


def score_rows_locally(
    requests: Sequence[Request], workers: int, limit_s: float, report: Callable[[Row], None] = lambda row: None
) -> list[Row]:
    """The rows of `requests`, in their order, scored by `workers` processes; `report` gets each finished row.

    A row that takes more than `limit_s` seconds is penalised. Raises FreeArtError for a broken sequence or truth.
    """
    if not 1 <= workers <= MOST_WORKERS:
        raise FreeArtError(f"cannot score with {workers} workers; expected 1 to {MOST_WORKERS}")
    scorers = [Worker() for _ in range(max(1, min(workers, len(requests))))]
    free: queue.SimpleQueue[Worker] = queue.SimpleQueue()
    for scorer in scorers:
        free.put(scorer)

    def score(request: Request) -> Row:
        scorer = free.get()
        try:
            return score_row(scorer, request, limit_s)
        finally:
            free.put(scorer)

    pool = ThreadPoolExecutor(len(scorers))
    try:
        with stopping.defer_stop():
            futures: list[Future[Row]] = [pool.submit(score, request) for request in requests]
        for future in as_completed(futures):
            report(future.result())
    finally:
        with stopping.defer_stop():
            pool.shutdown(wait=False, cancel_futures=True)
            for scorer in scorers:
                scorer.end()
            pool.shutdown(wait=True)
            for scorer in scorers:
                scorer.close()
    return [future.result() for future in futures]


def score_row(scorer: Worker, request: Request, limit_s: float) -> Row:
    """The row of `request`, penalised when it takes more than `limit_s` seconds or crashes its process."""
    try:
        return scorer.score(dict(request), limit_s)
    except RowAborted as reason:
        recording, truth = read_sequence(Path(request["sequence"])), read_truth(Path(request["truth"]))
        rules, lacks = protocol_named(request["protocol"]), tuple(request["lacks"])
        return SequenceScorer(rules, recording, truth, lacks).penalised_row("failed", str(reason))


def score_rows_as_jobs(
    requests: Sequence[Request],
    workers: int,
    executor: str,
    limit_s: float,
    work: Path | None,
    report: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """The rows of `requests`, in their order, each scored by a job of `executor`; `report` gets each finished row.

    `work` is a new folder on a file system of all machines, in which the jobs leave their rows. Raises FreeArtError as
    `score_rows_locally`, when `work` is None or exists, and when a job fails.
    """
    if work is None:
        raise FreeArtError(f"scoring by '{executor}' needs a folder that all its machines see, where rows are gathered")
    if work.exists():
        raise FreeArtError(f"{work} exists; choose another place or remove it first")
    work = work.resolve()
    jobs = []
    for k, request in enumerate(requests):
        absolute = {key: str(Path(value).resolve()) if key in FOLDERS else value for key, value in request.items()}
        jobs.append(
            Job(
                f"score/{k:06d}",
                call="leaderboard.parallel_rows:write_row",
                arguments={"request": absolute, "limit_s": limit_s, "out": str(work / "rows" / f"{k:06d}.json")},
                memory_gb=MEMORY_GB,
                limit_s=LEAST_LIMIT_S + 2 * limit_s,
            )
        )

    failed = list(run_jobs(work, jobs, workers, executor, on_done=lambda job: report(_read_row(job))).values())
    if failed:
        raise FreeArtError(f"{failed[0]}{f' (and {len(failed) - 1} more)' if len(failed) > 1 else ''}")
    return [_read_row(job) for job in jobs]


def write_row(request: dict[str, Any], limit_s: float, out: str) -> None:
    """Score `request` and write the row to the JSON file `out`: what a job runs."""
    with closing(Worker()) as scorer:
        atomic.write_json(Path(out), asdict(score_row(scorer, request, limit_s)))


def _read_row(job: Job) -> Row:
    return Row.from_json(checked.read_json(Path(job.arguments["out"])))
