"""Write the whole site: scores, pages, packed data and pictures, into one new folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from freeart21 import stopping
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.places import SITE, check_place
from freeart21.files.result import Method
from freeart21.joint import JointType
from leaderboard.cached import cached_scores
from leaderboard.compare import check_tables
from leaderboard.protocols import DEFAULT, protocol_named
from leaderboard.rows import Row, Scores
from leaderboard.score import benchmark_facts
from leaderboard.scores_file import read_scores, write_scores
from leaderboard.site import html
from leaderboard.site.definitions_page import definitions_page
from leaderboard.site.downloads_page import downloads_page, scores_csv
from leaderboard.site.entrant import Entrant, entrants
from leaderboard.site.failures_page import failures_page
from leaderboard.site.index_page import index_page
from leaderboard.site.method_page import method_page
from leaderboard.site.names import file_names
from leaderboard.site.sequence_data import Shown, show_sequence, show_table
from leaderboard.site.sequence_page import sequence_page

SCHEMA = "freeart21/site/1"
WORKERS = 2
"""Threads that read and pack sequences: decoding and packing let go of Python's lock."""
Progress = Callable[[str, int, int], None]
"""Called with what was just done, how many of it are done, and of how many."""


def write_site(
    results: Sequence[Path],
    data: Path | None,
    out: Path,
    protocols: Sequence[str] = (),
    keep: Path | None = None,
    title: str | None = None,
    command: Sequence[str] = (),
    progress: Progress | None = None,
    truth: Path | None = None,
) -> Path:
    """Write the site of some methods' results on one data folder to the folder `out`; returns its front page.

    `results` are folders of results, or tables of `score --out`. Folders need `data` and its truth; of tables alone
    (`data` None) the site has no videos and no answers. Scores of folders are read from the folder `keep` where they
    are of these very files, else made and kept there. `truth` is where the truth of a packed data folder lies: answers
    are scored against it, and nothing of it is shown. `protocols` empty takes those of the tables, else the default.

    An older site at `out` is replaced, anything else is refused before any work. Raises FreeArtError when a protocol is
    unknown, two results are one, tables are not of one benchmark, code and protocol, or the benchmark is broken; what
    is wrong with one result stands on its page.
    """
    results = [Path(place) for place in results]
    if not results:
        raise FreeArtError("site: no results were named, expected a folder or a table of scores of each method")
    if len({place.resolve() for place in results}) < len(results):
        raise FreeArtError(f"site: the same results are named twice: {', '.join(map(str, results))}")
    packed = [place for place in results if place.is_file() and place.suffix.lower() == ".zip"]
    if packed:
        raise FreeArtError(f"{packed[0]} is an archive, expected its folder unpacked, or its table of scores")
    tables = {place: read_scores(place) for place in results if not place.is_dir()}
    folders = [place for place in results if place not in tables]
    protocols = tuple(dict.fromkeys(protocol_named(name).name for name in protocols)) or tuple(
        dict.fromkeys(table.protocol for table in tables.values())
    )
    protocols = protocols or (DEFAULT,)
    check_place(out, SITE, [*results, *(place for place in (data, keep, truth) if place)])
    if data is None and folders:
        raise FreeArtError(f"site: {folders[0]} is no table of scores, and --data, which it answers, was not given")
    benchmark = None if data is None else read_benchmark(data, truth)
    methods = _methods_of_tables(tables, protocols)
    if benchmark is None:
        tabled = [table.benchmark for table in tables.values()]
        facts = next((said for said in tabled if said.get("hidden")), tabled[0])
        sequences = tuple(row.sequence for row in next(iter(tables.values())).rows)
    else:
        facts, sequences = benchmark_facts(benchmark), benchmark.sequences
    _check(tables, facts, sequences)
    for folder in folders:
        methods[folder] = _tables(folder, Path(data or ""), protocols, keep, progress, truth)
    if tables and folders:
        _check({**tables, **{folder: methods[folder][protocols[0]] for folder in folders}}, facts, sequences)
    told = [(place, methods[place]) for place in results if place in methods]
    board = entrants(told, facts.get("hidden", ""))
    site = title or f"FreeArt-21: {facts['name']}"
    files = dict(zip(sequences, file_names(sequences), strict=True))
    types = {row.sequence: row.joint_type for row in board[0].scores[protocols[0]].rows}
    with atomic.new_folder(Path(out), SITE) as aside:
        if benchmark is None:
            shown = [show_table(name, types[name], board) for name in sequences]
        else:
            shown = _sequences(aside, benchmark, board, protocols, types, files, progress)
        _pages(aside, site, board, protocols, shown, files, command, facts)
        written = sorted(path.relative_to(aside).as_posix() for path in aside.rglob("*") if path.is_file())
        marker = {
            "schema": SCHEMA,
            "title": site,
            "benchmark": facts["name"],
            "protocols": protocols,
            "files": written,
        }
        atomic.write_json(aside / SITE.marker, marker)
    return Path(out) / "index.html"


def _methods_of_tables(tables: Mapping[Path, Scores], protocols: Sequence[str]) -> dict[Path, Mapping[str, Scores]]:
    """The tables of each method by protocol, under the place of the first of them.

    Tables of one method are of the same results and say the same of it. Raises FreeArtError where one is of another
    protocol, or a method lacks one.
    """
    methods: dict[Path, dict[str, Scores]] = {}
    for place, table in tables.items():
        if table.protocol not in protocols:
            raise FreeArtError(f"{place} is scored by {table.protocol}, expected {' or '.join(protocols)}")
        key = _results_of(table)
        own = next(
            (m for m in methods.values() if table.protocol not in m and key in map(_results_of, m.values())), None
        )
        if own is None:
            methods[place] = {table.protocol: table}
        else:
            own[table.protocol] = table
    for place, own in methods.items():
        for protocol in protocols:
            if protocol not in own:
                raise FreeArtError(
                    f"{place}: there is no table of {next(iter(own.values())).method.name} by {protocol}, "
                    f"expected one by each of {', '.join(protocols)}"
                )
    return {place: {protocol: own[protocol] for protocol in protocols} for place, own in methods.items()}


def _results_of(scores: Scores) -> tuple[Method, tuple[tuple[str, str | None], ...]]:
    """The method and the hash of each of its results."""
    return scores.method, tuple(sorted((row.sequence, row.result_sha256) for row in scores.rows))


def _check(tables: Mapping[Path, Scores], facts: dict[str, str], sequences: tuple[str, ...]) -> None:
    """FreeArtError unless the tables may stand on one board: as in a comparison, and of all sequences."""
    if not tables:
        return
    check_tables(list(tables.items()), facts, sequences)
    for place, scores in tables.items():
        if len(scores.rows) < len(sequences):
            raise FreeArtError(
                f"{place} has rows for {len(scores.rows)} of {len(sequences)} sequences: score all of them"
            )


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

        tables[protocol] = cached_scores(folder, data, protocol, keep, scored, truth=truth)
    return tables


def _sequences(
    aside: Path,
    benchmark: Benchmark,
    board: Sequence[Entrant],
    protocols: Sequence[str],
    types: Mapping[str, JointType],
    files: dict[str, str],
    progress: Progress | None,
) -> list[Shown]:
    """Pack every sequence and write its data and pictures; what comes back keeps the facts alone."""
    shown: list[Shown] = []
    with ThreadPoolExecutor(WORKERS) as pool:
        jobs = [
            pool.submit(show_sequence, benchmark, name, board, protocols[0], types[name])
            for name in benchmark.sequences
        ]
        try:
            for job in jobs:
                one = job.result()
                stopping.raise_if_stopped()
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
    benchmark: dict[str, str],
) -> None:
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
