"""Write the whole site: scores, pages, packed data and pictures, into one new folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from freeart21 import stopping
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.places import SITE, check_place
from leaderboard.kept import kept_scores
from leaderboard.protocols import DEFAULT, protocol_named
from leaderboard.rows import Row, Scores
from leaderboard.scores_file import write_scores
from leaderboard.site import html
from leaderboard.site.definitions_page import definitions_page
from leaderboard.site.downloads_page import downloads_page, scores_csv
from leaderboard.site.entrant import Entrant, entrants
from leaderboard.site.failures_page import failures_page
from leaderboard.site.index_page import index_page
from leaderboard.site.method_page import method_page
from leaderboard.site.names import file_names
from leaderboard.site.sequence_data import Shown, show_sequence
from leaderboard.site.sequence_page import sequence_page

SCHEMA = "freeart21/site/1"
WORKERS = 2
"""Threads that read and pack sequences: decoding and packing let go of Python's lock."""
Progress = Callable[[str, int, int], None]
"""Called with what was just done, how many of it are done, and of how many."""


def write_site(
    results: Sequence[Path],
    data: Path,
    out: Path,
    protocols: Sequence[str] = (DEFAULT,),
    keep: Path | None = None,
    title: str | None = None,
    command: Sequence[str] = (),
    progress: Progress | None = None,
    truth: Path | None = None,
) -> Path:
    """Write the site of some methods' results on one data folder to the folder `out`; returns its front page.

    Tables are read from the folder `keep` where they are of these very files, else scored and kept there; `truth` is
    where the truth of a packed data folder lies, and the site then shows what was held back. An older site
    at `out` is replaced, anything else is refused before any work. Raises FreeArtError when a protocol is unknown, two
    results are one folder, or the benchmark is broken; what is wrong with one result stands on its page.
    """
    results = [Path(folder) for folder in results]
    if not results:
        raise FreeArtError("site: no results were named, expected a folder of each method")
    if len({folder.resolve() for folder in results}) < len(results):
        raise FreeArtError(f"site: the same results are named twice: {', '.join(map(str, results))}")
    protocols = tuple(dict.fromkeys(protocol_named(name).name for name in protocols)) or (DEFAULT,)
    check_place(out, SITE, [*results, data, *(place for place in (keep, truth) if place)])
    benchmark = read_benchmark(data, truth)
    board = entrants([(folder, _tables(folder, data, protocols, keep, progress, truth)) for folder in results])
    site = title or f"FreeArt-21: {benchmark.name}"
    files = dict(zip(benchmark.sequences, file_names(benchmark.sequences), strict=True))
    with atomic.new_folder(Path(out), SITE) as aside:
        shown = _sequences(aside, benchmark, board, protocols, files, progress)
        _pages(aside, site, board, protocols, shown, files, command)
        written = sorted(path.relative_to(aside).as_posix() for path in aside.rglob("*") if path.is_file())
        marker = {
            "schema": SCHEMA,
            "title": site,
            "benchmark": benchmark.name,
            "protocols": protocols,
            "files": written,
        }
        atomic.write_json(aside / SITE.marker, marker)
    return Path(out) / "index.html"


def _tables(
    folder: Path,
    data: Path,
    protocols: Sequence[str],
    keep: Path | None,
    progress: Progress | None,
    truth: Path | None,
) -> dict[str, Scores]:
    tables = {}
    for protocol in protocols:
        done = 0

        def scored(row: Row, of: int) -> None:
            nonlocal done
            done += 1
            if progress:
                progress(f"Scored {folder.name}, {row.sequence}, by {protocol}", done, of)  # noqa: B023

        tables[protocol] = kept_scores(folder, data, protocol, keep, scored, truth=truth)
    return tables


def _sequences(
    aside: Path,
    benchmark: Benchmark,
    board: Sequence[Entrant],
    protocols: Sequence[str],
    files: dict[str, str],
    progress: Progress | None,
) -> list[Shown]:
    """Pack every sequence and write its data and pictures; what comes back keeps the facts alone."""
    shown: list[Shown] = []
    with ThreadPoolExecutor(WORKERS) as pool:
        jobs = [pool.submit(show_sequence, benchmark, name, board, protocols[0]) for name in benchmark.sequences]
        try:
            for job in jobs:
                one = job.result()
                stopping.check()
                file = files[one.name]
                _write(aside / "data" / f"{file}.js", one.script.encode())
                _write(aside / "thumbs" / f"{file}.jpg", one.thumb)
                for k, sheet in enumerate(one.sheets):
                    _write(aside / "video" / f"{file}-{k}.jpg", sheet)
                shown.append(one)
                if progress:
                    progress(f"Packed {one.name}", len(shown), len(jobs))
        finally:
            for job in jobs:
                job.cancel()
    return shown


def _pages(
    aside: Path,
    site: str,
    board: Sequence[Entrant],
    protocols: Sequence[str],
    shown: Sequence[Shown],
    files: dict[str, str],
    command: Sequence[str],
) -> None:
    benchmark = board[0].scores[protocols[0]].benchmark
    _write(aside / "static" / "site.js", html.script().encode())
    _write(aside / "static" / "site.css", html.style().encode())
    tables: dict[str, bytes] = {}
    for entrant in board:
        for protocol in protocols:
            name = f"{entrant.file}.{protocol}"
            write_scores(aside / "scores" / f"{name}.json", entrant.scores[protocol])
            tables[f"{name}.json"] = (aside / "scores" / f"{name}.json").read_bytes()
            tables[f"{name}.csv"] = scores_csv(entrant.scores[protocol])
            _write(aside / "scores" / f"{name}.csv", tables[f"{name}.csv"])
        _write(aside / "methods" / f"{entrant.file}.html", method_page(site, entrant, protocols, shown, files))
    places = [(s.name, files[s.name]) for s in shown]
    for k, one in enumerate(shown):
        around = places[k - 1] if k else None, places[k + 1] if k + 1 < len(places) else None
        _write(
            aside / "sequences" / f"{files[one.name]}.html",
            sequence_page(site, one, files[one.name], board, protocols, around),
        )
    _write(aside / "index.html", index_page(site, board, protocols, shown, files, benchmark))
    _write(aside / "failures.html", failures_page(site, board, protocols[0], shown, files))
    _write(aside / "definitions.html", definitions_page(site, protocols))
    _write(aside / "downloads.html", downloads_page(site, board, protocols, tables, command, benchmark))


def _write(path: Path, data: bytes) -> None:
    atomic.write_bytes(path, data, sync=False)
