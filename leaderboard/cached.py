"""Score tables cached on disk, recomputed only when something that they depend on has changed."""

from __future__ import annotations

import contextlib
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

WORKERS = 2
"""Rows scored side by side."""
_RELEVANT = ("freeart21", "python", "libraries")
"""Entries of the environment that the numbers depend on; commit and machine do not change them."""


def cached_scores(
    results: Path,
    data: Path,
    protocol: str,
    cache: Path | None,
    progress: Callable[[Row, int], None] | None = None,
    truth: Path | None = None,
) -> Scores:
    """The scores of a method's results folder, from the table in the folder `cache` when that is current.

    A table is current when results, benchmark.json, truths, package and libraries have the hashes and versions in it.
    Otherwise the results are scored (arguments as in `score_results`) and the table is written. `cache` None neither
    reads nor writes a table. `truth` is where the truth of a packed data folder lies.

    Raises FreeArtError as `score_results`, when another file lies in the table's place, and when the results change
    while they are scored.
    """
    results, rules, benchmark = Path(results), protocol_named(protocol), read_benchmark(data, truth)
    check_results_folder(results, benchmark.sequences)
    path = None if cache is None else cache_path(results, rules.name, Path(cache))
    if path is not None:
        check_place(path, SCORES, (Path(data), results))
        with contextlib.suppress(FreeArtError):  # there is none, or none that can be read
            found = read_scores(path)
            if is_current(found, results, benchmark):
                return found
    before = _hash_folders(results, benchmark)
    scores = score_results(results, data, rules.name, progress, workers=WORKERS, truth=truth)
    if before != {row.sequence: (row.result_sha256, row.truth_sha256) for row in scores.rows}:
        raise FreeArtError(f"{results} changed while it was scored: score it again")
    if path is not None:
        write_scores(path, scores)
    return scores


def cache_path(results: Path, protocol: str, cache: Path) -> Path:
    """The file of a cached table: FOLDER.PROTOCOL.json, FOLDER reduced to characters that every disk takes."""
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", results.resolve().name).strip(".-") or "results"
    return cache / f"{name}.{protocol}.json"


def is_current(scores: Scores, results: Path, benchmark: Benchmark) -> bool:
    """Whether scoring `results` now would give `scores`: the same bytes, package and libraries."""
    environment = describe_environment()
    stored = {row.sequence: (row.result_sha256, row.truth_sha256) for row in scores.rows}
    return (
        all(scores.made_with.get(key) == environment[key] for key in _RELEVANT)
        and scores.benchmark == benchmark_facts(benchmark)
        and scores.method == read_submitted_method(results)[0]
        and all(row.truth_sha256 and (row.result_sha256 or row.status == "missing") for row in scores.rows)
        and stored == _hash_folders(results, benchmark)
    )


def _hash_folders(results: Path, benchmark: Benchmark) -> dict[str, tuple[str | None, str | None]]:
    """Sequence to the hashes of its result and its truth."""
    return {name: (sha256_or_none(results / name), truth_sha256(benchmark, name)) for name in benchmark.sequences}
