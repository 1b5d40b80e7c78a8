"""Checks a data folder: every hash and format, and that each video agrees with its truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.benchmark import Benchmark, is_unfinished, read_benchmark, unfinished_error
from freeart21.files.data_card import CARD_FILES
from freeart21.files.hashes import file_sha256
from freeart21.files.hidden import find_traces
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.recording import Recording
from freeart21.truth import Truth

_SEEN_BY_METHODS = {"sequence.json", "queries.json", "rgb", "depth", "mask"}
_SEQUENCE_KEYS = {"gravity", "schema", "camera", "depth_scale", "times_s", "licence"}
_CLOSE = 1e-9
_S = TypeVar("_S")
_T = TypeVar("_T")
_SCENE_SENSORS = ("hand",)  # sensors whose depth shows more than the object


@dataclass
class Report:
    """Numbers of checked files and sequences, and the findings."""

    files: int = 0
    sequences: int = 0
    findings: list[str] = field(default_factory=list)
    """One line each: the file, what is wrong, what was expected."""


def verify(data: Path, truth: Path | None = None) -> Report:
    """Check the data folder `data`. Raises FreeArtError when it is unfinished, or has no readable benchmark.json.

    A folder that was packed without its truth is searched for traces of the truth. With the folder `truth` of that
    truth, videos and truths are compared as in any other data folder.
    """
    data = Path(data)
    if is_unfinished(data):
        raise unfinished_error(data)
    benchmark = read_benchmark(data, truth)
    listed = listed_files(data)
    report = Report(len(listed), len(benchmark.sequences))
    report.findings += differing_files(data, listed)
    for name in benchmark.sequences:
        found = collect_findings(partial(_check_sequence_folders, benchmark, name))
        report.findings += [line if name in line else f"{name}: {line}" for line in found]
    return report


def _check_sequence_folders(benchmark: Benchmark, name: str) -> Iterator[str]:
    if benchmark.hidden:
        yield from collect_findings(lambda: find_traces(benchmark.sequence(name)))
    if not benchmark.hidden or benchmark.hidden_truth:
        yield from _sequence(benchmark.sequence(name), benchmark.truth(name))


def collect_findings(*checks: Callable[[], Iterable[str]]) -> Iterator[str]:
    """The findings of all `checks`. An error of one is a finding too, and the others still run."""
    for check in checks:
        try:
            yield from check()
        except FreeArtError as error:
            yield str(error)
        except OSError as error:
            yield f"{error.filename} cannot be read: {error.strerror}"


def listed_files(data: Path) -> dict[str, Any]:
    """Name to SHA-256 of every file that benchmark.json of the data folder `data` lists."""
    listed = checked.read_json(data / "benchmark.json").get("sha256")
    if not isinstance(listed, dict):
        raise FreeArtError(
            f"{data}/benchmark.json: 'sha256' is {type(listed).__name__}, expected file names and hashes"
        )
    return listed


def differing_files(data: Path, listed: dict[str, Any]) -> Iterator[str]:
    """A line for every file of the data folder `data` that differs from `listed`: missing, extra, or of other
    content. Its card (`files.data_card`) is no data."""
    here = {str(path.relative_to(data)) for path in data.rglob("*") if not path.is_dir()}
    here -= {"benchmark.json", *CARD_FILES}
    for name in sorted(set(listed) | here):
        path = data / name
        if name not in here:
            yield f"{path} is missing: benchmark.json lists it"
        elif name not in listed:
            yield f"{path} is not listed in benchmark.json"
        elif path.is_symlink() or not path.is_file():
            yield f"{path} is not a plain file"
        else:
            try:
                got = file_sha256(path)
            except FreeArtError as error:
                yield str(error)
                continue
            if got != listed[name]:
                hashes = f"{got[:12]}, expected {str(listed[name])[:12]}"
                yield f"{path} has another content than benchmark.json says: its SHA-256 is {hashes}"


def _sequence(folder: Path, truth_folder: Path) -> Iterator[str]:
    recording, truth = _read(read_sequence, folder), _read(read_truth, truth_folder)
    yield from collect_findings(lambda: _check_contents(folder))
    yield from (found for found in (recording, truth) if isinstance(found, str))
    if isinstance(recording, str) or isinstance(truth, str):
        return
    n = len(recording)
    if len(truth) != n:
        yield f"{truth_folder} is of {len(truth)} frames, its sequence has {n}"
        return
    if truth.seen.shape != (n, 2):
        yield f"{truth_folder}/seen.npz has shape {truth.seen.shape}, expected ({n}, 2)"
        return
    yield from collect_findings(
        lambda: _counts(folder, truth_folder, n, len(recording.queries)),
        lambda: _kinematics(truth_folder, truth),
        *(partial(_frame, folder, truth_folder, recording, truth, i) for i in range(n)),
        *(partial(_query, truth_folder, recording, truth, i) for i in range(len(recording.queries))),
    )


def _read(reader: Callable[[_S], _T], what: _S) -> _T | str:
    """The result of `reader(what)`, or the line of its error."""
    try:
        return reader(what)
    except FreeArtError as error:
        return str(error)


def _check_contents(folder: Path) -> Iterator[str]:
    """Findings when the sequence folder holds more than methods are to see."""
    for path in sorted(folder.iterdir()):
        if path.name not in _SEEN_BY_METHODS:
            yield f"{path} does not belong in a sequence folder; expected {', '.join(sorted(_SEEN_BY_METHODS))}"
    for key in sorted(set(checked.read_json(folder / "sequence.json")) - _SEQUENCE_KEYS):
        yield f"{folder}/sequence.json says '{key}', which methods are not to see"


def _counts(folder: Path, truth_folder: Path, frames: int, queries: int) -> Iterator[str]:
    """Findings when the number of pictures is not that of frames and views."""
    for path, n in (
        *((folder / sub, frames) for sub in ("rgb", "depth", "mask")),
        (truth_folder / "part_mask", frames),
        (truth_folder / "queries" / "rgb", queries),
        (truth_folder / "queries" / "mask", queries),
    ):
        here = {p.name for p in path.iterdir()} if path.is_dir() else set()
        expected = {f"{i:05d}.png" for i in range(n)}
        if here != expected:
            odd = sorted(here ^ expected)[0]
            yield f"{path} holds {len(here)} files, expected {n} from 00000.png on; the first that differs is {odd}"
    stated = checked.read_json(truth_folder / "truth.json").get("queries")
    if stated != queries:
        yield f"{truth_folder}/truth.json has {stated} held-out views, {folder}/queries.json has {queries}"


def _kinematics(folder: Path, truth: Truth) -> Iterator[str]:
    joint, states = truth.articulation.joint, truth.states
    slack = 1e-6 * max(1.0, truth.range_of_motion)
    beyond = np.flatnonzero((states < joint.lower - slack) | (states > joint.upper + slack))
    if len(beyond):
        i = int(beyond[0])
        yield (
            f"{folder}: the state of frame {i} is {states[i]:.6g} {joint.state_unit}, "
            f"expected {joint.lower:.6g} to {joint.upper:.6g}"
        )
    error = np.abs(truth.Ts_camera_reference @ joint.transform(states) - truth.Ts_camera_moving).max((1, 2))
    if error.max() > _CLOSE:
        i = int(error.argmax())
        yield f"{folder}: the moving part's pose of frame {i} differs by {error[i]:.3g} from that of joint and state"


def _frame(folder: Path, truth_folder: Path, recording: Recording, truth: Truth, i: int) -> Iterator[str]:
    name = f"{i:05d}.png"
    try:
        frame, part_mask = recording.frame(i), truth.part_mask(i)
    except FreeArtError as error:
        places = (*(folder / sub / name for sub in ("rgb", "depth", "mask")), truth_folder / "part_mask" / name)
        readers = checked.read_rgb, checked.read_uint16, checked.read_labels, checked.read_labels
        read = [_read(partial(reader, root=p.parent.parent), p) for reader, p in zip(readers, places, strict=True)]
        yield from [found for found in read if isinstance(found, str)] or [str(error)]
        return
    sensors = str(truth.source.get("sensor", "clean")).split("+")
    if part_mask.shape != frame.mask.shape or part_mask.max(initial=0) > 2:
        yield f"{truth_folder}/part_mask/{name} has shape {part_mask.shape}, labels up to {part_mask.max()}"
        return
    if not np.array_equal(frame.mask, part_mask > 0):
        n = int(np.sum(frame.mask != (part_mask > 0)))
        yield f"{folder}/mask/{name} differs in {n} pixels from the truth's part_mask"
    seen = [int(np.sum(part_mask == 1)), int(np.sum(part_mask == 2))]
    if not np.array_equal(truth.seen[i], seen):
        yield f"{truth_folder}/seen.npz says {truth.seen[i].tolist()} of frame {i}, its part_mask shows {seen}"
    if not set(sensors) & set(_SCENE_SENSORS) and (stray := int(np.sum((frame.depth > 0) & ~frame.mask))):
        yield f"{folder}/depth/{name} has depth at {stray} pixels outside the mask"
    if "clean" in sensors and (bare := int(np.sum((frame.depth == 0) & frame.mask))):
        yield f"{folder}/depth/{name} has no depth at {bare} pixels of the mask, and the sensor was clean"


def _query(folder: Path, recording: Recording, truth: Truth, i: int) -> Iterator[str]:
    size = (recording.camera.height, recording.camera.width)
    rgb, mask = _read(truth.query_rgb, i), _read(truth.query_mask, i)
    broken = [found for found in (rgb, mask) if isinstance(found, str)]
    yield from broken
    if isinstance(rgb, str) or isinstance(mask, str):
        return
    if rgb.shape[:2] != size or mask.shape != size:
        yield f"{folder}/queries: view {i} is {rgb.shape[1]} x {rgb.shape[0]}, expected {size[1]} x {size[0]}"
    elif not mask.any():
        yield f"{folder}/queries/mask/{i:05d}.png shows nothing"
