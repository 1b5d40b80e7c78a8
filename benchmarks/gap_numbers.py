"""Whether the numbers that decide a verdict of `gap` hold for machines that they were not set on.

    .venv/bin/python -m benchmarks.gap_numbers [--names multiarm dfki]

asks `gap` of the real recordings (`real_recordings`) with each number of `JudgementSettings` divided and multiplied by
1.5, one at a time, and grades every answer (`real_grade`). Then, for each machine, the settings with the best grades of
all other machines are taken, and the grade of this machine's recordings is the mean over these settings. Answers are
those of the fits: SAPIEN's replay, which can take a name back, is left out, so the default's grades stand beside them.
Prints the table and writes benchmarks/results/gap_numbers.json. An answer that is in --work is used again.
"""

from __future__ import annotations

import shutil
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from benchmarks.common import RESULTS, ROOT, commit, machine
from benchmarks.real_gap import EXPECTED
from benchmarks.real_grade import GRADES, grade_answer
from benchmarks.real_recordings import recordings
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured
from simgap import workflow
from simgap.select import choose
from simgap.settings import GapSettings, JudgementSettings

FACTOR = 1.5
"""Each number is divided and multiplied by it. A choice."""
NUMBERS = tuple(f.name for f in fields(JudgementSettings) if not f.name.startswith("least_") or f.name == "least_gap")
"""Those that decide once there is enough motion."""
SAME_MACHINE = {"adip": "rotary"}
"""Recordings of one machine begin with one word but these."""
WEIGHTS = {"right": 1.0, "in part": 1.0, "silent": 0.0, "wrong": -2.0}
"""Worth of a grade where settings are compared: a wrong name costs more than silence."""
SECONDS = 600.0
"""Limit of a search, s of processor time; the time to search is not what is measured here."""
_COSTLY = ("evaluate_set", "evaluate_with_model_error", "fit_for_simulator", "find_discrepancies")


def variants() -> dict[str, JudgementSettings]:
    """The default settings, and those with one number smaller or larger; shares stay below 1."""
    found = {"default": JudgementSettings()}
    for name in NUMBERS:
        value = getattr(JudgementSettings(), name)
        for text, other in (("/", value / FACTOR), ("*", value * FACTOR)):
            other = min(other, 0.5 * (1 + value)) if value < 1 else other
            found[f"{name} {text} {FACTOR:g}"] = replace(JudgementSettings(), **{name: other})
    return found


def ask(folder: Path) -> dict[str, dict[str, Any]]:
    """Settings to the answer about the asset and runs of a folder; sets are fitted once for all settings. Nothing where
    the choice is not reached."""
    measured = read_measured(folder / "measured")
    asset = read_asset(folder / "asset.urdf", measured.joint, guesses=False)
    answers = {}

    def judge_all(prepared: workflow.Prepared, _: JudgementSettings) -> workflow.Draft:
        for method in ("explore", "fit_shapes", "is_promising"):
            setattr(prepared.search, method, _Recall(getattr(prepared.search, method)))
        drafts = {name: judge(prepared, settings) for name, settings in variants().items()}
        answers.update({name: draft.verdict.to_json(measured.joint_type) for name, draft in drafts.items()})
        return drafts["default"]

    judge = workflow.judge
    with ExitStack() as patches:
        for module, name in ((workflow, "deliver"), *((choose, name) for name in _COSTLY)):
            patches.enter_context(mock.patch.object(module, name, _Recall(getattr(module, name))))
        patches.enter_context(mock.patch.object(workflow, "judge", judge_all))
        workflow.explain(asset, measured, GapSettings(seconds=SECONDS))
    return answers


class _Recall:
    """A function that returns the result of an earlier call with the same objects."""

    def __init__(self, function: Callable[..., Any]):
        self.function = function
        self._known: dict[tuple[int, ...], tuple[Any, tuple[Any, ...]]] = {}

    def __call__(self, *given: Any) -> Any:
        key = tuple(map(id, given))
        if key not in self._known:
            self._known[key] = self.function(*given), given
        return self._known[key][0]


def leave_machines_out(grades: dict[str, dict[str, str]]) -> dict[str, dict[str, float]]:
    """Recording to the share of each grade under the settings that are best for all other machines.

    Args:
        grades: recording to settings to grade.
    """
    machines = defaultdict(list)
    for name in grades:
        first = name.split("_")[0]
        machines[SAME_MACHINE.get(first, first)].append(name)
    found = {}
    for own in machines.values():
        worth = {
            settings: sum(WEIGHTS[row[settings]] for name, row in grades.items() if name not in own)
            for settings in variants()
        }
        best = [settings for settings, sum_ in worth.items() if sum_ == max(worth.values())]
        for name in own:
            found[name] = {g: float(np.mean([grades[name][settings] == g for settings in best])) for g in GRADES}
    return found


def main(names: tuple[str, ...] = (), work: Path = ROOT / "out" / "gap_numbers", out: Path | None = None) -> None:
    """Ask, grade, leave each machine out.

    Args:
        names: These recordings alone.
        work: Where sets and answers are kept.
        out: The JSON file. When not given: benchmarks/results/gap_numbers.json, and only when all recordings are asked.
    """
    known, here = checked.read_json(EXPECTED), recordings()
    unknown = sorted(set(names) - set(here))
    if unknown:
        raise FreeArtError(f"there is no recording {', '.join(unknown)}; there are {', '.join(here)}")
    grades: dict[str, dict[str, str]] = {}
    for name in names or here:
        answer_file, folder = work / f"{name}.json", work / name
        if not answer_file.is_file():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            here[name](folder)
            atomic.write_json(answer_file, ask(folder))
        answers = checked.read_json(answer_file)
        expected = known["recordings"][name]
        grades[name] = {s: grade_answer(expected, known["groups"], answers.get(s))[0] for s in variants()}
        print(f"{len(grades)} of {len(names or here)}: {name}: {grades[name]['default']}", flush=True)
    counts = {s: {g: sum(row[s] == g for row in grades.values()) for g in GRADES} for s in variants()}
    left_out = leave_machines_out(grades)
    counts["set without the machine"] = {g: round(sum(row[g] for row in left_out.values()), 2) for g in GRADES}
    table = Table("settings", *GRADES)
    for settings, row in counts.items():
        table.add_row(settings, *(f"{row[g]:g}" for g in GRADES))
    Console(width=120).print(table)
    if out is None and len(grades) == len(known["recordings"]):
        out = RESULTS / "gap_numbers.json"
    if out is not None:
        about = {"commit": commit(), "machine": machine(), "settings": {"factor": FACTOR, "seconds": SECONDS}}
        atomic.write_json(out, {**about, "counts": counts, "left out": left_out, "grades": grades})
        print(out)


if __name__ == "__main__":
    tyro.cli(main)
