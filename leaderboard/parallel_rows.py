"""Scores the rows of one table in separate processes: in parallel on this machine, or as jobs of an executor.

A submission can be too slow (a mesh of a million slivers ran for 480 s) or crash native code; it then costs its own row
only.
"""

from __future__ import annotations

import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freeart21 import processes
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.jobs import Job, run_jobs
from leaderboard import asset_measurement, forked, sequence_score
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row

FOLDERS = ("result", "sequence", "truth")
"""Keys of the folders in a request."""
MOST_WORKERS = 64
MEMORY_GB, LEAST_LIMIT_S = 4.0, 600.0
"""What a job of one row reserves, and its limit besides the row's own: the start of its process, on a busy machine."""
ROW_LIMIT_S = 180.0
"""Time limit of a row. Measured: 18 to 40 s (60 frames, 2 parts of 200k faces, an asset) on two cores shared with six
other programs."""
ROW_MEMORY = 12 << 30
"""Bytes of address space of a row's process. Measured: 1.2 GiB."""

Request = Mapping[str, Any]
"""The arguments of `score_sequence` as JSON: the FOLDERS, the name of a `protocol`, and `lacks`."""


def score_rows_locally(
    requests: Sequence[Request], workers: int, limit_s: float, report: Callable[[Row], None] = lambda row: None
) -> list[Row]:
    """The rows of `requests`, in their order, scored by `workers` processes; `report` gets each finished row.

    A row that takes more than `limit_s` seconds is penalised. Raises FreeArtError for a broken sequence or truth.
    """
    if not 1 <= workers <= MOST_WORKERS:
        raise FreeArtError(f"cannot score with {workers} workers; expected 1 to {MOST_WORKERS}")
    servers: list[forked.Server] = []
    own = threading.local()

    def start_thread() -> None:
        own.server = forked.Server(__name__)
        servers.append(own.server)

    def score(request: Request) -> Row:
        return score_row(own.server, request, limit_s)

    pool = ThreadPoolExecutor(workers, initializer=start_thread)
    try:
        with processes.defer_stop():
            futures: list[Future[Row]] = [pool.submit(score, request) for request in requests]
        for future in as_completed(futures):
            report(future.result())
    finally:
        with processes.defer_stop():
            pool.shutdown(wait=False, cancel_futures=True)
            for server in servers:
                server.end()
            pool.shutdown(wait=True)
            for server in servers:
                server.close()
    return [future.result() for future in futures]


def score_row(server: forked.Server, request: Request, limit_s: float) -> Row:
    """The row of `request`, penalised when it takes more than `limit_s` seconds or crashes its process."""
    try:
        with tempfile.TemporaryDirectory() as temporary:
            answer = server.ask(dict(request), Path(temporary), limit_s)
    except forked.TimedOut:
        answer = {"aborted": f"took more than {limit_s:g} s"}
    except forked.Crashed as error:
        answer = {"aborted": f"ended with {str(error).partition(': ')[0]}"}
    if "error" in answer:
        raise FreeArtError(answer["error"])
    if "row" in answer:
        return Row.from_json(answer["row"])
    recording, truth = read_sequence(Path(request["sequence"])), read_truth(Path(request["truth"]))
    rules, lacks = protocol_named(request["protocol"]), tuple(request["lacks"])
    scorer = sequence_score.SequenceScorer(rules, recording, truth, lacks)
    return scorer.penalised_row("failed", f"scoring {answer['aborted']}")


def reply(request: dict[str, Any]) -> dict[str, Any]:
    """The row of `request`, or why there is none: an `error` of the data, or why scoring was `aborted`."""
    _limit_memory()
    result, sequence, truth = (Path(request[key]) for key in FOLDERS)
    try:
        arguments = result, sequence, truth, request["protocol"], tuple(request["lacks"])
        return {"row": asdict(sequence_score.score_sequence(*arguments))}
    except FreeArtError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"aborted": f"took more than {ROW_MEMORY >> 30} GiB of memory"}
    except Exception as error:  # the other rows are still scored
        return {"aborted": f"stopped: {type(error).__name__}: {processes.one_line(error)}"}


def _limit_memory() -> None:
    if sys.platform == "linux":
        import resource

        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        limit = ROW_MEMORY if hard == resource.RLIM_INFINITY else min(ROW_MEMORY, hard)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


def main() -> None:
    """Serve requests, each of which can measure an asset."""
    forked.serve(reply, asset_measurement.MODULES)


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
    with closing(forked.Server(__name__)) as server:
        atomic.write_json(Path(out), asdict(score_row(server, request, limit_s)))


def _read_row(job: Job) -> Row:
    return Row.from_json(checked.read_json(Path(job.arguments["out"])))
