"""Writing a results folder from results of another layout: every sequence that is found, whole or not at all."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import freeart21
from freeart21 import child
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.places import Output, check_place, import_of
from freeart21.files.result import Method, write_method, write_result
from freeart21.files.sequence import read_sequence
from freeart21.reconstruction import Failure, Piece, Reconstruction
from leaderboard.adapters.registry import layout_named
from leaderboard.adapters.toolbox import (
    FRAMES,
    Axes,
    Layout,
    Options,
    Request,
    lacking,
    reconstruction,
)
from leaderboard.submission import MAX_FILES
from leaderboard.video_fit import describe_misfit

MOST_FAULTS = 20
"""Faults that are told at once."""


@dataclass(frozen=True)
class Report:
    """What an import wrote."""

    sequences: tuple[str, ...]
    """That have an answer."""
    failures: tuple[str, ...]
    """That the method itself counts as failed."""
    missing: tuple[str, ...]
    """Of which nothing was found: the score prices them."""
    lacks: tuple[str, ...]
    """What the layout does not give for any sequence."""
    notes: Mapping[str, tuple[str, ...]]
    """By sequence."""


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
    """Write the results folder `out` of what `source` holds in `layout` for the sequences of `data`.

    Where a sequence's result lies: in `source` itself when it is of one `sequence`; where the JSON file `map_file` says
    ({"SEQ": "folder", ...}, or an object with the folder and options of its own); else in the folder of the sequence's
    name. No truth is read. An older import of the same layout at `out` is replaced; anything else there is refused.

    Notes say where parts, posed by the answer, do not lie on the object of the video (`video_fit`). Raises
    FreeArtError, a line a fault, when nothing is found or a result cannot be read: then nothing is written.
    """
    source, data, out = Path(source), Path(data), Path(out)
    rules, options = layout_named(layout), options or Options()
    kind = import_of(layout)
    check_place(out, kind, (source, data))
    benchmark = read_benchmark(data)
    if not source.is_dir():
        raise FreeArtError(f"{source} is not a folder")
    _check_options(rules, options)
    places, own = _places(rules, source, benchmark, sequence, map_file, options)
    return _write(rules, places, own, benchmark, source, out, kind, name or out.resolve().name, progress)


def _write(
    rules: Layout,
    places: dict[str, Path],
    options: dict[str, Options],
    benchmark: Benchmark,
    source: Path,
    out: Path,
    kind: Output,
    name: str,
    progress: Callable[[str, int, int], None],
) -> Report:
    lacked: list[set[Piece]] = []
    failures, faults = [], []
    notes: dict[str, tuple[str, ...]] = {}
    with atomic.new_folder(out, kind) as aside:
        for done, (sequence, place) in enumerate(places.items()):
            progress(sequence, done, len(places))
            recording = read_sequence(benchmark.sequence(sequence))
            try:
                _check_links(place, source)
                found = rules.read(place, Request(recording, options[sequence]))
                answer = found if isinstance(found, Failure) else reconstruction(found, recording)
            except FreeArtError as error:
                faults.append(f"{sequence}: {error}")
                continue
            except Exception as error:  # hostile bytes reach parsers of many libraries; each has exceptions of its own
                faults.append(f"{sequence}: {place} cannot be read ({type(error).__name__}: {child.one_line(error)})")
                continue
            notes[sequence] = () if isinstance(found, Failure) else found.notes
            if isinstance(answer, Reconstruction) and not isinstance(found, Failure):
                misfit = describe_misfit(answer, recording, tuple(found.lacks()))
                notes[sequence] += (misfit,) if misfit else ()
            own = {"layout": rules.name, "notes": list(notes[sequence])}
            write_result(aside / sequence, answer, {"import": own})
            if isinstance(found, Failure):
                failures.append(sequence)
            else:
                lacked.append(found.lacks())
        if faults:
            more = [f"and {len(faults) - MOST_FAULTS} more"] if len(faults) > MOST_FAULTS else []
            raise FreeArtError("\n".join([*faults[:MOST_FAULTS], *more]))
        lacks = lacking(lacked)
        said = {sequence: list(lines) for sequence, lines in notes.items() if lines}
        settings: dict[str, Any] = {
            "imported": rules.name,
            "read_as": rules.source,
            "by": f"freeart21 {freeart21.__version__}",
            "options": {sequence: _plain(options[sequence]) for sequence in places},
            "notes": said,
        }
        write_method(aside, Method(name, rules.project, settings, "", lacks))
    missing = tuple(name for name in benchmark.sequences if name not in places)
    done_ = tuple(sequence for sequence in places if sequence not in failures)
    return Report(done_, tuple(failures), missing, lacks, notes)


def _check_links(place: Path, source: Path) -> None:
    """FreeArtError for a result that is, or holds, a link that leads out of `source`, or that has too many files."""
    home = source.resolve()
    if not place.resolve().is_relative_to(home):
        raise FreeArtError(f"{place} leads out of {source}")
    for count, path in enumerate(place.rglob("*")):
        if count > MAX_FILES:
            raise FreeArtError(f"{place} has more than {MAX_FILES} files, expected one result")
        if path.is_symlink() and not path.resolve().is_relative_to(home):
            raise FreeArtError(f"{path} leads out of {source}")


def _plain(options: Options) -> dict[str, Any]:
    """The options that are not as they are by default; the place of object poses by its name alone."""
    told = {key: value for key, value in vars(options).items() if value != getattr(Options(), key)}
    return {key: value.name if isinstance(value, Path) else value for key, value in told.items()}


def _places(
    rules: Layout,
    source: Path,
    benchmark: Benchmark,
    sequence: str | None,
    map_file: Path | None,
    options: Options,
) -> tuple[dict[str, Path], dict[str, Options]]:
    """Sequence to the folder of its result and its options, in the benchmark's order."""
    if sequence is not None and map_file is not None:
        raise FreeArtError("--sequence and --map say the same in two ways; give one of them")
    own = {name: options for name in benchmark.sequences}
    if map_file is not None:
        given, told = _read_map(map_file, source, benchmark, rules, options)
        own |= told
        places = {}
        for name, folder in given.items():
            home = _home(rules, folder)
            if home is None:
                raise FreeArtError(f"{map_file}: {folder} holds no result of the layout {rules.name}")
            places[name] = home
        return {name: places[name] for name in benchmark.sequences if name in places}, own
    if sequence is not None:
        if sequence not in benchmark.sequences:
            raise FreeArtError(f"{benchmark.folder} has no sequence '{sequence}'; it has {_some(benchmark.sequences)}")
        home = _home(rules, source)
        if home is None:
            raise FreeArtError(f"{source} holds no result of the layout {rules.name}: expected {_wanted(rules)}")
        return {sequence: home}, own
    places = {}
    for name in benchmark.sequences:
        for below in dict.fromkeys((name, name.replace("_", "-"), *rules.folders(name))):
            folder = source / below
            home = _home(rules, folder) if folder.is_dir() else None
            if home is not None:
                places[name] = home
                break
    if not places:
        one = ", or --sequence SEQ if it is the result of one" if _home(rules, source) is not None else ""
        raise FreeArtError(
            f"{source} holds no result of the layout {rules.name} in a folder named as a sequence of "
            f"{benchmark.folder} ({_some(benchmark.sequences)}); give --map FILE.json to say which is which{one}"
        )
    return places, own


def _some(names: tuple[str, ...]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _wanted(rules: Layout) -> str:
    return f"its files, or {' or '.join(rules.inside)} with them" if rules.inside else "its files"


def _home(rules: Layout, folder: Path) -> Path | None:
    """The folder with the files, `folder` itself or one below where the project puts them; None when there is none."""
    if rules.fits(folder):
        return folder
    root = folder.resolve()
    for pattern in rules.inside:
        below = [path for path in folder.glob(pattern) if path.is_dir() and path.resolve().is_relative_to(root)]
        fitting = [path for path in below if rules.fits(path)]
        if fitting:
            return max(fitting, key=_numbers)
    return None


def _numbers(path: Path) -> tuple[list[int], str]:
    """Orders step_0004000 behind step_0000500, and ours_20000 behind ours_7000."""
    return [int(number) for number in re.findall(r"[0-9]{1,18}", path.name)], path.name


def _read_map(
    path: Path, source: Path, benchmark: Benchmark, rules: Layout, options: Options
) -> tuple[dict[str, Path], dict[str, Options]]:
    data = checked.read_json(path, root=checked.ANYWHERE)
    places, own = {}, {}
    for name, entry in data.items():
        if name not in benchmark.sequences:
            raise FreeArtError(
                f"{path}: {benchmark.folder} has no sequence '{name}'; it has {_some(benchmark.sequences)}"
            )
        told = {"folder": entry} if isinstance(entry, str) else entry
        if not isinstance(told, dict) or not isinstance(told.get("folder"), str):
            raise FreeArtError(f"{path}: '{name}' is {entry!r}, expected a folder, or an object with one"[:300])
        unknown = set(told) - {"folder", "frame", "axes", "anchor", "scale", "joint"}
        if unknown:
            raise FreeArtError(
                f"{path}: '{name}' has '{min(unknown)}', expected folder, frame, axes, anchor, scale or joint"
            )
        places[name] = checked.inside(source, told["folder"])
        if not places[name].is_dir():
            raise FreeArtError(f"{path}: '{name}' is in {told['folder']}, which is not a folder of {source}")
        own[name] = _own_options(path, name, told, options)
        _check_options(rules, own[name])
    if not places:
        raise FreeArtError(f"{path} names no sequence")
    return places, own


def _own_options(path: Path, name: str, told: dict[str, Any], options: Options) -> Options:
    kinds = {"anchor": (int,), "scale": (int, float), "joint": (str, int), "frame": (str,), "axes": (str,)}
    for key, allowed in kinds.items():
        if key in told and (isinstance(told[key], bool) or not isinstance(told[key], allowed)):
            raise FreeArtError(f"{path}: '{key}' of '{name}' is {told[key]!r}, expected {allowed[0].__name__}"[:300])
    given = {key: told[key] for key in kinds if key in told}
    if "joint" in given:
        given["joint"] = str(given["joint"])
    return replace(options, **given)


def _check_options(rules: Layout, options: Options) -> None:
    """FreeArtError for an option that the layout has no use for, or that is none of its values."""
    if options.frame is not None and options.frame not in FRAMES:
        raise FreeArtError(f"frame is '{options.frame}', expected one of {', '.join(FRAMES)}")
    if options.axes is not None and options.axes not in get_args(Axes):
        raise FreeArtError(f"axes are '{options.axes}', expected opencv or opengl")
    if not 0 < options.scale < 1e6:
        raise FreeArtError(f"scale is {options.scale:g}, expected metres in one unit of length, above 0")
    useless = {
        "frame": options.frame is not None and rules.frame is None,
        "object-poses": options.object_poses is not None and rules.frame is None,
        "axes": options.axes is not None and rules.axes is None,
        "anchor": options.anchor != 0 and rules.frame is None,
        "joint": options.joint is not None and not rules.joint_choice,
    }
    for option, wrong in useless.items():
        if wrong:
            raise FreeArtError(f"the layout {rules.name} has no use for --{option}: its files say it")
