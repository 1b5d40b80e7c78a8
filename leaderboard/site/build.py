"""Write a site: scores, pages, packed data and images, into one new folder."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.benchmark import read_benchmark
from freeart21.files.places import SITE, check_place
from freeart21.view.document import Section
from leaderboard.cached import cached_scores
from leaderboard.compare import check_tables
from leaderboard.protocols import DEFAULT, protocol_named
from leaderboard.rows import Row, Scores
from leaderboard.score import benchmark_facts
from leaderboard.scores_file import read_scores, write_scores
from leaderboard.site.common import Board
from leaderboard.site.definitions_page import definitions_page, scores_csv
from leaderboard.site.entrant import entrants
from leaderboard.site.failures_page import failures_page
from leaderboard.site.index_page import index_page
from leaderboard.site.method_page import method_page
from leaderboard.site.names import file_names
from leaderboard.site.sequence_page import sequence_page
from leaderboard.site.sequence_view import show_sequence

SCHEMA = "freeart21/site/1"
Progress = Callable[[str, int, int], None]
"""Called with what was just done, how many of it are done, and how many there are."""


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
    """Write the site of some methods' results on one data folder; an older site at `out` is replaced.

    Args:
        results: Folders of results, or tables of `score --out`.
        data: The data folder. Without it, with tables only, the site has no videos and no results.
        out: Folder of the site. Anything but an older site there is refused before any work.
        protocols: Names; those of the tables when empty, else the default.
        keep: Folder with cached scores of result folders: used while all files are the same, else written.
        title: Of the site.
        command: The command that made it, for its pages.
        progress: Called after every step.
        truth: Truth of a packed data folder: results are scored with it, and nothing of it is shown.

    Returns the front page. Raises FreeArtError when a protocol is unknown, two results are one, tables are not of one
    benchmark, code and protocol, or the benchmark is broken; faults of a result are shown on its page.
    """
    results = [Path(place) for place in results]
    tables = _read_tables(results)
    folders = [place for place in results if place not in tables]
    protocols = tuple(dict.fromkeys(protocol_named(name).name for name in protocols))
    protocols = protocols or tuple(dict.fromkeys(table.protocol for table in tables.values())) or (DEFAULT,)
    check_place(out, SITE, [*results, *(place for place in (data, keep, truth) if place)])
    if data is None and folders:
        raise FreeArtError(f"site: {folders[0]} is no table of scores, and --data, which it answers, was not given")
    benchmark = None if data is None else read_benchmark(data, truth)
    methods = _methods_of_tables(tables, protocols)
    if benchmark is None:
        given = [table.benchmark for table in tables.values()]
        facts = next((one for one in given if one.get("hidden")), given[0])
        sequences = tuple(row.sequence for row in next(iter(tables.values())).rows)
    else:
        facts, sequences = benchmark_facts(benchmark), benchmark.sequences
    _check_tables(tables, facts, sequences)
    done, steps = itertools.count(1), len(folders) * len(protocols) * len(sequences)

    def report(folder: Path, name: str, row: Row, _: int) -> None:
        if progress:
            progress(f"Scored {folder.name}, {row.sequence}, by {name}", next(done), steps)

    for folder in folders:
        methods[folder] = {
            name: cached_scores(folder, Path(data or ""), name, keep, partial(report, folder, name), truth=truth)
            for name in protocols
        }
    if tables and folders:
        _check_tables({**tables, **{folder: methods[folder][protocols[0]] for folder in folders}}, facts, sequences)
    methods_given = [(place, methods[place]) for place in results if place in methods]
    board_entrants = entrants(methods_given, facts.get("hidden", ""))
    title = title or f"FreeArt-21: {facts['name']}"
    files = dict(zip(sequences, file_names(sequences), strict=True))
    types = {row.sequence: row.joint_type for row in board_entrants[0].scores[protocols[0]].rows}
    visual: dict[str, list[Section]] = {}
    with atomic.new_folder(Path(out), SITE) as new:
        shown = []
        for count, sequence in enumerate(sequences, 1):
            source = benchmark, sequence, board_entrants, protocols[0], types[sequence]
            content, visual[sequence] = show_sequence(*source)
            shown.append(content)
            if progress:
                progress(f"Packed {sequence}", count, len(sequences))
        board = Board(title, board_entrants, protocols, shown, files, facts, command)
        for k, sequence in enumerate(sequences):
            _write(new / "sequences" / f"{files[sequence]}.html", sequence_page(board, k, visual.pop(sequence)))
        for entrant in board_entrants:
            for protocol, table in entrant.scores.items():
                write_scores(new / "scores" / f"{entrant.file}.{protocol}.json", table)
                _write(new / "scores" / f"{entrant.file}.{protocol}.csv", scores_csv(table))
            _write(new / "methods" / f"{entrant.file}.html", method_page(board, entrant))
        for name, make in (("index", index_page), ("failures", failures_page), ("definitions", definitions_page)):
            _write(new / f"{name}.html", make(board))
        marker = {"schema": SCHEMA, "title": title, "benchmark": facts["name"], "protocols": protocols}
        atomic.write_json(new / SITE.marker, marker)
    return Path(out) / "index.html"


def _read_tables(results: Sequence[Path]) -> dict[Path, Scores]:
    """Those results that are tables of scores; FreeArtError when there are no results, or one of them twice."""
    if not results:
        raise FreeArtError("site: no results were named, expected a folder or a table of scores of each method")
    if len({place.resolve() for place in results}) < len(results):
        raise FreeArtError(f"site: the same results are named twice: {', '.join(map(str, results))}")
    packed = [place for place in results if place.is_file() and place.suffix.lower() == ".zip"]
    if packed:
        raise FreeArtError(f"{packed[0]} is an archive, expected its folder unpacked, or its table of scores")
    return {place: read_scores(place) for place in results if not place.is_dir()}


def _methods_of_tables(tables: Mapping[Path, Scores], protocols: Sequence[str]) -> dict[Path, Mapping[str, Scores]]:
    """The tables of each method by protocol, under the path of its first table.

    Tables of one method have the same method.json and result hashes. Raises FreeArtError when a table is of another
    protocol, or a method has none of one.
    """
    methods: dict[tuple[str, int], tuple[Path, dict[str, Scores]]] = {}
    for place, table in tables.items():
        if table.protocol not in protocols:
            raise FreeArtError(f"{place} is scored by {table.protocol}, expected {' or '.join(protocols)}")
        hashes = repr((table.method, sorted((row.sequence, str(row.result_sha256)) for row in table.rows)))
        again = sum(key[0] == hashes and table.protocol in own for key, (_, own) in methods.items())
        methods.setdefault((hashes, again), (place, {}))[1][table.protocol] = table
    for place, own in methods.values():
        for protocol in protocols:
            if protocol not in own:
                raise FreeArtError(
                    f"{place}: there is no table of {next(iter(own.values())).method.name} by {protocol}, "
                    f"expected one by each of {', '.join(protocols)}"
                )
    return {place: {protocol: own[protocol] for protocol in protocols} for place, own in methods.values()}


def _check_tables(tables: Mapping[Path, Scores], facts: dict[str, str], sequences: tuple[str, ...]) -> None:
    """FreeArtError unless the tables can be compared and have all sequences."""
    if not tables:
        return
    check_tables(list(tables.items()), facts, sequences)
    for place, scores in tables.items():
        if len(scores.rows) < len(sequences):
            raise FreeArtError(
                f"{place} has rows for {len(scores.rows)} of {len(sequences)} sequences: score all of them"
            )


def _write(path: Path, data: bytes) -> None:
    atomic.write_bytes(path, data, sync=False)
