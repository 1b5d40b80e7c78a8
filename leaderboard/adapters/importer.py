"""Writes a results folder from results of another layout, for all sequences that it has, atomically."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import freeart21
from freeart21 import processes
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.json_record import read_record
from freeart21.files.places import check_place, import_of
from freeart21.files.result import Method, write_method, write_result
from freeart21.files.sequence import read_sequence
from freeart21.reconstruction import Failure, Piece
from freeart21.recording import Recording
from leaderboard.adapters.layout import (
    ImportedResult,
    Layout,
    Options,
    Request,
    common_lacks,
    layout_named,
    to_reconstruction,
)
from leaderboard.submission import find_link_faults
from leaderboard.video_fit import describe_misfit

MOST_FAULTS = 20
"""Most faults in one error message."""


@dataclass(frozen=True)
class Report:
    """The outcome of an import."""

    sequences: tuple[str, ...]
    """Sequences with an answer."""
    failures: tuple[str, ...]
    """Sequences that the method itself counts as failed."""
    missing: tuple[str, ...]
    """Sequences without a result, which the score penalises."""
    lacks: tuple[str, ...]
    """Pieces that the layout has for no sequence."""
    notes: Mapping[str, tuple[str, ...]]
    """Sequence to remarks."""


@dataclass(frozen=True)
class _Source:
    """The folder that holds the result of one sequence, and its options."""

    folder: Path
    options: Options


def import_results(
    layout: str,
    source: Path,
    data: Path,
    out: Path,
    options: Options | None = None,
    sequence: str | None = None,
    map_file: Path | None = None,
    name: str | None = None,
    progress: Callable[[str, int, int], None] = lambda name, done, total: None,
) -> Report:
    """Write the results folder `out` from results in `layout` in `source` for the sequences of `data`.

    A sequence's result is `source` itself when that is the result of one `sequence`; the folder in the JSON file
    `map_file` ({"SEQ": "folder", ...}, or an object with the folder and options of its own); else the folder named as
    the sequence. No truth is read. An older import of the same layout at `out` is replaced, nothing else.

    A note names sequences whose posed parts do not lie on the object in the video (`video_fit`). Raises FreeArtError,
    one line per fault, and writes nothing when no result is found or one cannot be read.
    """
    source, data, out = Path(source), Path(data), Path(out)
    rules, options = layout_named(layout), options or Options()
    kind = import_of(layout)
    check_place(out, kind, (source, data))
    benchmark = read_benchmark(data)
    if not source.is_dir():
        raise FreeArtError(f"{source} is not a folder")
    options = _check_options(rules, options, {}, "import")
    sources = _find_sources(rules, source, benchmark, sequence, map_file, options)
    lacks: list[set[Piece]] = []
    failures, faults = [], []
    notes: dict[str, tuple[str, ...]] = {}
    with atomic.new_folder(out, kind) as staging:
        for done, (key, place) in enumerate(sources.items()):
            progress(f"Importing {key}", done, len(sources))
            recording = read_sequence(benchmark.sequence(key))
            try:
                result, notes[key] = _write_answer(rules, place, source, recording, staging / key)
            except FreeArtError as error:
                faults.append(f"{key}: {error}")
                continue
            if isinstance(result, Failure):
                failures.append(key)
            else:
                lacks.append(result.lacks())
        if faults:
            more = [f"and {len(faults) - MOST_FAULTS} more"] if len(faults) > MOST_FAULTS else []
            raise FreeArtError("\n".join([*faults[:MOST_FAULTS], *more]))
        settings: dict[str, Any] = {
            "imported": rules.name,
            "read_as": rules.source,
            "by": f"freeart21 {freeart21.__version__}",
            "options": {key: _options_to_json(place.options) for key, place in sources.items()},
            "notes": {key: list(lines) for key, lines in notes.items() if lines},
        }
        method = Method(name or out.resolve().name, rules.project, settings, "", common_lacks(lacks))
        write_method(staging, method)
    missing = tuple(key for key in benchmark.sequences if key not in sources)
    answers = tuple(key for key in sources if key not in failures)
    return Report(answers, tuple(failures), missing, method.lacks, notes)


def _write_answer(
    rules: Layout, place: _Source, source: Path, recording: Recording, out: Path
) -> tuple[ImportedResult | Failure, tuple[str, ...]]:
    """Read one result and write it as a result folder; returns it and its notes. Raises FreeArtError, one line."""
    try:
        for fault in find_link_faults(place.folder, source):
            raise FreeArtError(str(fault))
        result = rules.read(place.folder, Request(recording, place.options))
        answer = result if isinstance(result, Failure) else to_reconstruction(result, recording)
    except FreeArtError:
        raise
    except Exception as error:  # parsers of many libraries read hostile bytes, each with its own exceptions
        message = f"{place.folder} cannot be read ({type(error).__name__}: {processes.one_line(error)})"
        raise FreeArtError(message) from error
    notes: tuple[str, ...] = ()
    if not isinstance(result, Failure) and not isinstance(answer, Failure):
        misfit = describe_misfit(answer, recording, tuple(result.lacks()))
        notes = (*result.notes, *([misfit] if misfit else []))
    write_result(out, answer, {"import": {"layout": rules.name, "notes": list(notes)}})
    return result, notes


def _options_to_json(options: Options) -> dict[str, Any]:
    """The options that differ from the default; paths by their name alone."""
    changed = {key: value for key, value in vars(options).items() if value != getattr(Options(), key)}
    return {key: value.name if isinstance(value, Path) else value for key, value in changed.items()}


def _find_sources(
    rules: Layout,
    source: Path,
    benchmark: Benchmark,
    sequence: str | None,
    map_file: Path | None,
    options: Options,
) -> dict[str, _Source]:
    """Sequence to the folder and options of its result, in the benchmark's order."""
    if sequence is not None and map_file is not None:
        raise FreeArtError("--sequence and --map exclude each other; give one of them")
    if map_file is not None:
        return _read_map(map_file, source, benchmark, rules, options)
    if sequence is not None:
        _check_sequence(benchmark, sequence)
        home = _find_home(rules, source)
        if home is None:
            inside = f", or {' or '.join(rules.subfolders)} with them" if rules.subfolders else ""
            raise FreeArtError(f"{source} holds no result of the layout {rules.name}: expected its files{inside}")
        return {sequence: _Source(home, options)}
    sources = {}
    for name in benchmark.sequences:
        for child_name in dict.fromkeys((name, name.replace("_", "-"), *rules.sequence_folders(name))):
            folder = source / child_name
            home = _find_home(rules, folder) if folder.is_dir() else None
            if home is not None:
                sources[name] = _Source(home, options)
                break
    if not sources:
        one = ", or --sequence SEQ if it is the result of one" if _find_home(rules, source) is not None else ""
        raise FreeArtError(
            f"{source} holds no result of the layout {rules.name} in a folder named as a sequence of "
            f"{benchmark.folder} ({_list_some(benchmark.sequences)}); give --map FILE.json with the folder of each{one}"
        )
    return sources


def _check_sequence(benchmark: Benchmark, name: str, where: str = "") -> None:
    if name not in benchmark.sequences:
        names = _list_some(benchmark.sequences)
        raise FreeArtError(f"{where}{benchmark.folder} has no sequence '{name}'; it has {names}")


def _list_some(names: tuple[str, ...]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _find_home(rules: Layout, folder: Path) -> Path | None:
    """The folder with the files: `folder`, or one of the layout's subfolders; None when there is none."""
    if rules.matches(folder):
        return folder
    root = folder.resolve()
    for pattern in rules.subfolders:
        below = [path for path in folder.glob(pattern) if path.is_dir() and path.resolve().is_relative_to(root)]
        if matching := [path for path in below if rules.matches(path)]:
            return max(matching, key=_number_key)
    return None


def _number_key(path: Path) -> tuple[list[int], str]:
    """Sort key: step_0004000 after step_0000500, and ours_20000 after ours_7000."""
    return [int(number) for number in re.findall(r"[0-9]{1,18}", path.name)], path.name


def _read_map(path: Path, source: Path, benchmark: Benchmark, rules: Layout, options: Options) -> dict[str, _Source]:
    data = checked.read_json(path, root=checked.ANYWHERE)
    sources = {}
    for name, entry in data.items():
        _check_sequence(benchmark, name, f"{path}: ")
        given = {"folder": entry} if isinstance(entry, str) else entry
        own = {key: value for key, value in checked.json_object({name: given}, name, path).items() if key != "folder"}
        place = checked.text(given, "folder", path)
        folder = checked.inside(source, place)
        if not folder.is_dir():
            raise FreeArtError(f"{path}: '{name}' is in {place}, which is not a folder of {source}")
        own_options = _check_options(rules, options, own, f"{path}: '{name}'")
        home = _find_home(rules, folder)
        if home is None:
            raise FreeArtError(f"{path}: {folder} holds no result of the layout {rules.name}")
        sources[name] = _Source(home, own_options)
    if not sources:
        raise FreeArtError(f"{path} names no sequence")
    return {name: sources[name] for name in benchmark.sequences if name in sources}


def _check_options(rules: Layout, common: Options, own: dict[str, Any], where: str) -> Options:
    """The options `common`, with the sequence's `own`; FreeArtError for one of a bad value or no use in the layout."""
    values = {key: value for key, value in vars(common).items() if key != "object_poses"} | own
    if values["joint"] is not None:
        values["joint"] = str(values["joint"])  # its number in JSON
    options = replace(read_record(Options, values, where), object_poses=common.object_poses)
    if not 0 < options.scale < 1e6:
        raise FreeArtError(f"scale is {options.scale:g}, expected metres in one unit of length, above 0")
    without_effect = {
        "frame": options.frame is not None and rules.frame is None,
        "object-poses": options.object_poses is not None and rules.frame is None,
        "axes": options.axes is not None and rules.axes is None,
        "anchor": options.anchor != 0 and rules.frame is None,
        "joint": options.joint is not None and not rules.has_several_joints,
    }
    for option, wrong in without_effect.items():
        if wrong:
            raise FreeArtError(f"the layout {rules.name} has no use for --{option}: its files define it")
    return options
