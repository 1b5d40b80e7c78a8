"""The rows of one table, scored in processes of their own: side by side on this machine, or as jobs on others."""

from __future__ import annotations

import queue
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
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
from leaderboard.worker import RowAborted, Worker, worker

PLACES = ("result", "sequence", "truth")
"""The folders that a request names, beside its protocol."""
MOST_WORKERS = 64
SECONDS = 20.0
"""What a row takes, about, with the start of a process for it alone."""

Request = Mapping[str, Any]
"""What `leaderboard.worker` is asked: PLACES, protocol, and the pieces that the method lacks."""


def score_rows_locally(
    requests: Sequence[Request], workers: int, limit_s: float, told: Callable[[Row], None] = lambda row: None
) -> list[Row]:
    """The rows of `requests`, in their order, `workers` at a time; `told` hears of each as it is done.

    Each worker keeps one process for all its rows (`Worker`). Raises FreeArtError when a sequence or truth is broken.
    """
    if not 1 <= workers <= MOST_WORKERS:
        raise FreeArtError(f"cannot score with {workers} workers; expected 1 to {MOST_WORKERS}")
    scorers = [Worker() for _ in range(max(1, min(workers, len(requests))))]
    idle: queue.SimpleQueue[Worker] = queue.SimpleQueue()
    for scorer in scorers:
        idle.put(scorer)

    def scored(request: Request) -> Row:
        scorer = idle.get()
        try:
            return score_row(scorer, request, limit_s)
        finally:
            idle.put(scorer)

    pool = ThreadPoolExecutor(len(scorers))
    try:
        with stopping.deferred():
            futures: list[Future[Row]] = [pool.submit(scored, request) for request in requests]
        for future in as_completed(futures):
            told(future.result())
    finally:
        with stopping.deferred():
            pool.shutdown(wait=False, cancel_futures=True)
            for scorer in scorers:
                scorer.end()
            pool.shutdown(wait=True)
            for scorer in scorers:
                scorer.close()
    return [future.result() for future in futures]


def score_row(scorer: Worker, request: Request, limit_s: float) -> Row:
    """The row of `request`, priced when it takes more than `limit_s` seconds or ends the process."""
    try:
        return scorer.score(dict(request), limit_s)
    except RowAborted as reason:
        case = SequenceScorer(
            protocol_named(request["protocol"]),
            read_sequence(Path(request["sequence"])),
            read_truth(Path(request["truth"])),
            tuple(request["lacks"]),
        )
        return case.penalised_row("failed", str(reason))


def score_rows_as_jobs(
    requests: Sequence[Request],
    workers: int,
    executor: str,
    limit_s: float,
    work: Path | None,
    told: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """The rows of `requests`, in their order, each a job of `executor`; `told` hears of each as it is done.

    `work` is a new folder that every machine sees: rows are handed back there. Raises FreeArtError as
    `score_rows_locally`, and when `work` is None or exists, or a job fails.
    """
    if work is None:
        raise FreeArtError(f"scoring by '{executor}' needs a folder that all its machines see, where rows are gathered")
    if work.exists():
        raise FreeArtError(f"{work} exists; choose another place or remove it first")
    work = work.resolve()
    jobs = [
        Job(
            f"score/{k:06d}",
            call="leaderboard.parallel_rows:write_row",
            arguments={
                "request": {
                    key: value if key not in PLACES else str(Path(value).resolve()) for key, value in r.items()
                },
                "limit_s": limit_s,
                "out": "{out}",
            },
            out=f"rows/{k:06d}.json",
            seconds=SECONDS,
        )
        for k, r in enumerate(requests)
    ]

    def listener(event: str, job: Job, facts: dict[str, object]) -> None:
        if event == "finished":
            told(_row(work / str(job.out)))

    report = run_jobs(work, jobs, workers, executor, listener=listener)
    if report.failed:
        more = f" (and {len(report.failed) - 1} more)" if len(report.failed) > 1 else ""
        raise FreeArtError(f"{report.failed[0].reason}{more}")
    return [_row(work / str(job.out)) for job in jobs]


def write_row(request: dict[str, Any], limit_s: float, out: str) -> None:
    """What the job of a row does."""
    with worker() as scorer:
        atomic.write_json(Path(out), asdict(score_row(scorer, request, limit_s)))


def _row(path: Path) -> Row:
    return Row.from_json(checked.read_json(path))
