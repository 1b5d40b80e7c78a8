"""Tables of scores that are kept, and made anew only when anything that they come from has changed."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.places import SCORES, check_place
from leaderboard.protocols import protocol_named
from leaderboard.provenance import describe_environment, sha256_or_none, truth_sha256
from leaderboard.rows import Row, Scores
from leaderboard.score import benchmark_facts, check_results_folder, score_results
from leaderboard.scores_file import read_scores, write_scores
from leaderboard.submission import read_submitted_method

_MATTERS = ("freeart21", "scoring", "python", "libraries")
"""Of what numbers were made with: all that they may depend on. The commit says it again; machines agree."""


def cached_scores(
    results: Path,
    data: Path,
    protocol: str,
    keep: Path | None,
    progress: Callable[[Row, int], None] | None = None,
    workers: int = 2,
    truth: Path | None = None,
) -> Scores:
    """The scores of the results folder of one method, from `keep`/METHOD.PROTOCOL.json when they are of these bytes.

    A kept table counts when the results, benchmark.json, the truths, the scoring code and its libraries are what they
    were, by their hashes; else the results are scored (`progress` and `workers` as in `score_results`) and the table is
    written there. `keep` None keeps nothing; `truth` is where a packed data folder's truth lies. Raises FreeArtError as
    `score_results` does, when something that is no table of scores stands in its place, or when the results changed
    while they were scored.
    """
    results, rules, benchmark = Path(results), protocol_named(protocol), read_benchmark(data, truth)
    check_results_folder(results, benchmark.sequences)
    path = None if keep is None else cache_path(results, rules.name, Path(keep))
    if path is not None:
        check_place(path, SCORES, (Path(data), results))
        found = _read(path)
        if found is not None and is_current(found, results, benchmark):
            return found
    before = _fingerprints(results, benchmark)
    scores = score_results(results, data, rules.name, progress, workers=workers, truth=truth)
    if before != {row.sequence: (row.result_sha256, row.truth_sha256) for row in scores.rows}:
        raise FreeArtError(f"{results} changed while it was scored: score it again")
    if path is not None:
        write_scores(path, scores)
    return scores


def cache_path(results: Path, protocol: str, keep: Path) -> Path:
    """Where the table of a results folder is kept: named after the folder, in letters that every disk takes."""
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", results.resolve().name).strip(".-") or "results"
    return keep / f"{name}.{protocol}.json"


def is_current(scores: Scores, results: Path, benchmark: Benchmark) -> bool:
    """Whether scoring `results` now would give `scores`: the same bytes, by the same code and libraries."""
    now = describe_environment()
    if any(scores.made_with.get(key) != now[key] for key in _MATTERS):
        return False
    if scores.benchmark != benchmark_facts(benchmark) or scores.method != read_submitted_method(results)[0]:
        return False
    if tuple(row.sequence for row in scores.rows) != benchmark.sequences:
        return False
    hashed = all(row.truth_sha256 and (row.result_sha256 or row.status == "missing") for row in scores.rows)
    said = {row.sequence: (row.result_sha256, row.truth_sha256) for row in scores.rows}
    return hashed and said == _fingerprints(results, benchmark)


def _fingerprints(results: Path, benchmark: Benchmark) -> dict[str, tuple[str | None, str | None]]:
    """Sequence to the hashes of its result and its truth."""
    return {name: (sha256_or_none(results / name), truth_sha256(benchmark, name)) for name in benchmark.sequences}


def _read(path: Path) -> Scores | None:
    """The table at `path`; None when there is none that this version reads."""
    try:
        return read_scores(path)
    except FreeArtError:
        return None
