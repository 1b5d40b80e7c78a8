"""Checking results as scoring reads them, without measuring: every fault rather than the first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files.benchmark import read_benchmark
from freeart21.files.sequence import read_sequence
from freeart21.reconstruction import Failure, Piece, Reconstruction
from freeart21.recording import Recording
from leaderboard.asset_measurement import measure_asset
from leaderboard.score import check_results_folder
from leaderboard.submission import (
    Fault,
    escape_unprintable,
    find_appearance_faults,
    find_faults,
    find_link_faults,
    read_render,
    read_submitted_method,
)
from leaderboard.video_fit import describe_misfit


@dataclass(frozen=True)
class Report:
    """What a look through a results folder gave."""

    sequences: int
    answers: int
    """Results that would be measured."""
    failures: int
    """Results that declare a failure."""
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    """What is no fault, but the reader may not have meant it."""


def validate_results(results: Path, data: Path) -> Report:
    """Every fault of the results folder of one method against the data folder `data`, whose truth is not read.

    Raises FreeArtError when `results` is not a folder of results, or the data folder is broken.
    """
    results, benchmark = Path(results), read_benchmark(data)
    check_results_folder(results, benchmark.sequences)
    method, faults = read_submitted_method(results)
    notes: list[str] = []
    if not (results / "method.json").exists():
        notes.append(f"there is no method.json: the method is called {results.resolve().name}")
    answers = failures = 0
    for name in benchmark.sequences:
        recording = read_sequence(benchmark.sequence(name))
        answer, found, said = _sequence(results / name, recording, method.lacks)
        faults += found
        notes += said
        answers += isinstance(answer, Reconstruction)
        failures += isinstance(answer, Failure)
    for path in sorted(results.iterdir()):
        if (
            path.name not in (*benchmark.sequences, "method.json")
            and (path.is_dir() or path.is_symlink())
            and path.name[0] != "."
        ):
            notes.append(f"{path.name} is no sequence of {benchmark.name}, and will not be looked at")
    return Report(
        len(benchmark.sequences), answers, failures, tuple(faults), tuple(escape_unprintable(note) for note in notes)
    )


def _sequence(
    folder: Path, recording: Recording, lacks: tuple[Piece, ...]
) -> tuple[Reconstruction | Failure | None, list[Fault], list[str]]:
    height, width = recording.camera.height, recording.camera.width
    if not folder.is_dir() and not folder.is_symlink():
        mend = 'if it has no answer, write prediction.json with "status": "failed", "stage" and "reason"'
        return None, [Fault(folder.name, "is missing", "a folder with prediction.json", mend=mend)], []
    faults: list[Fault] = []
    looking = find_faults(folder, len(recording), height, width)
    while True:
        try:
            faults.append(next(looking))
        except StopIteration as end:
            answer: Reconstruction | Failure | None = end.value
            break
    if any(find_link_faults(folder)):
        return answer, faults, []  # what else is named in it may lie anywhere
    notes = []
    for pictures in ("renders", "renders_other"):
        found = [read_render(folder, pictures, i, height, width) for i in range(len(recording.queries))]
        wrong = [fault for _, some in found for fault in some]
        absent = sum(picture is None for picture, _ in found) - len(wrong)
        faults += wrong
        if (
            isinstance(answer, Reconstruction)
            and absent
            and "renders" not in lacks
            and ((folder / pictures).is_dir() or pictures == "renders")
        ):
            notes.append(f"{folder.name}/{pictures}: {absent} of {len(found)} held-out views have no picture")
    faults += find_appearance_faults(folder)
    if (folder / "asset").exists():
        states = answer.states if isinstance(answer, Reconstruction) else np.zeros(1)
        faults += _asset_faults(folder, states)
    elif isinstance(answer, Reconstruction):
        notes.append(f"{folder.name} has no asset/: joint and surfaces will be measured from the files and marked so")
    misfit = describe_misfit(answer, recording, lacks) if isinstance(answer, Reconstruction) else ""
    return answer, faults, [*notes, *([f"{folder.name}: {misfit}"] if misfit else [])]


def _asset_faults(folder: Path, states: np.ndarray) -> Iterator[Fault]:
    """What keeps the asset from being measured, or what its checks find."""
    fault = Fault(
        f"{folder.name}/asset", "", mend="`freeart21 view` shows it; `freeart21 export` writes one that passes"
    )
    try:
        asset = measure_asset(folder / "asset", states)
    except FreeArtError as error:
        yield replace(fault, found=str(error).removeprefix(str(folder / "asset")).lstrip(": /"))
        return
    for finding in asset.findings:
        yield replace(fault, found=finding, fatal=False)
