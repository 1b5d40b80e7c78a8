"""Checks a submission as scoring reads it, without measuring: all faults rather than the first."""

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
    """The outcome of validating a results folder."""

    sequences: int
    answers: int
    """Results that scoring would measure."""
    failures: int
    """Results that declare a failure."""
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    """Remarks that are not faults but may be unintended."""


def validate_results(results: Path, data: Path) -> Report:
    """Every fault of a method's results folder for the data folder `data`, whose truth is not read.

    Raises FreeArtError when `results` is not a results folder or the data folder is broken.
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
        answer, new_faults, new_notes = _validate_sequence(results / name, recording, method.lacks)
        faults += new_faults
        notes += new_notes
        answers += isinstance(answer, Reconstruction)
        failures += isinstance(answer, Failure)
    for path in sorted(results.iterdir()):
        is_folder = (path.is_dir() or path.is_symlink()) and path.name[0] != "."
        if is_folder and path.name not in (*benchmark.sequences, "method.json"):
            notes.append(f"{path.name} is not a sequence of {benchmark.name} and is ignored")
    words = tuple(escape_unprintable(note) for note in notes)
    return Report(len(benchmark.sequences), answers, failures, tuple(faults), words)


def _validate_sequence(
    folder: Path, recording: Recording, lacks: tuple[Piece, ...]
) -> tuple[Reconstruction | Failure | None, list[Fault], list[str]]:
    """The answer in `folder` (None when it cannot be scored), its faults and notes."""
    height, width = recording.camera.height, recording.camera.width
    if not folder.is_dir() and not folder.is_symlink():
        fix = 'if it has no answer, write prediction.json with "status": "failed", "stage" and "reason"'
        return None, [Fault(folder.name, "is missing", "a folder with prediction.json", fix=fix)], []
    answer, faults = find_faults(folder, len(recording), height, width)
    if any(find_link_faults(folder)):
        return answer, faults, []  # its files may lie anywhere: read no more of them
    notes = []
    for subfolder in ("renders", "renders_other"):
        renders = [read_render(folder, subfolder, i, height, width) for i in range(len(recording.queries))]
        wrong = [fault for _, some in renders for fault in some]
        faults += wrong
        absent = sum(render is None for render, _ in renders) - len(wrong)
        expected = "renders" not in lacks and (subfolder == "renders" or (folder / subfolder).is_dir())
        if isinstance(answer, Reconstruction) and absent and expected:
            notes.append(f"{folder.name}/{subfolder}: {absent} of {len(renders)} held-out views have no picture")
    faults += find_appearance_faults(folder)
    if (folder / "asset").exists():
        states = answer.states if isinstance(answer, Reconstruction) else np.zeros(1)
        faults += _find_asset_faults(folder, states)
    elif isinstance(answer, Reconstruction):
        notes.append(f"{folder.name} has no asset/: joint and surfaces will be measured from the files and marked so")
    if isinstance(answer, Reconstruction) and (misfit := describe_misfit(answer, recording, lacks)):
        notes.append(f"{folder.name}: {misfit}")
    return answer, faults, notes


def _find_asset_faults(folder: Path, states: np.ndarray) -> Iterator[Fault]:
    """The fault that keeps the asset from being measured, or the findings of its checks."""
    fix = "`freeart21 view` shows it; `freeart21 export` writes one that passes"
    fault = Fault(f"{folder.name}/asset", "", fix=fix)
    try:
        asset = measure_asset(folder / "asset", states)
    except FreeArtError as error:
        yield replace(fault, found=str(error).removeprefix(str(folder / "asset")).lstrip(": /"))
        return
    for finding in asset.findings:
        yield replace(fault, found=finding, fatal=False)
