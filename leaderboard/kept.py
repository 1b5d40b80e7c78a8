"""Tables of scores that are kept: read where they are of this very protocol, else scored (a stand-in)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from freeart21.files import checked
from freeart21.files.result import Method
from leaderboard.rows import Row, Scores
from leaderboard.score import score_results, summarise
from leaderboard.scores_file import write_scores


def kept_scores(
    results: Path,
    data: Path,
    protocol: str,
    keep: Path | None,
    progress: Callable[[Row, int], None] | None = None,
    workers: int = 2,
) -> Scores:
    """The table of one method."""
    from leaderboard.protocols import protocol_named

    path = None if keep is None else keep / f"{results.resolve().name}.{protocol}.json"
    if path is not None and path.is_file():
        said = checked.read_json(path)
        rows = tuple(Row.from_json(row) for row in said["rows"])
        method = Method(**{**said["method"], "lacks": tuple(said["method"].get("lacks", ()))})
        rules = protocol_named(protocol)
        return Scores(protocol, method, said["benchmark"], rows, summarise(rows, rules), said["seconds"], tuple(said["notes"]))
    scores = score_results(results, data, protocol, progress)
    if path is not None:
        write_scores(path, scores)
    return scores
