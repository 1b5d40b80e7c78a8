"""The jobs of a suite, with their forecast cost."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import freeart21
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.benchmark import Benchmark
from freeart21.files.hashes import file_sha256
from freeart21.files.sequence import read_sequence
from freeart21.jobs import Job
from leaderboard.suite.rates import Rate
from leaderboard.suite.rows import SuiteRow

_RECORDED = ("frames", "seed", "width", "height", "queries", "motion", "preset", "shader")
"""Settings of a recording (from truth.json) that are options of `freeart21 record`."""
_FIXED = {
    "fov_y_degrees": None,
    "fps": 30.0,
    "joint": None,
    "track": None,
    "effects": None,
    "skip_missing": False,
    "edge": 0.02,
    "visible_every": 3,
}
"""Settings that are not, or that would rename the sequence: only recordings with these values can be repeated."""


@dataclass
class Plan:
    """The jobs of a suite over some sequences."""

    rows: list[SuiteRow]
    sequences: tuple[str, ...]
    protocols: tuple[str, ...]
    rates: dict[str, Rate]
    jobs: list[Job] = field(default_factory=list)
    frames: dict[str, int] = field(default_factory=dict)
    """Job to the number of frames that it works on."""

    def add(self, name: str, frames: int, **facts: Any) -> str:
        """Add the job `name`, which works on `frames` frames and has the fields `facts`; returns its name."""
        seconds = self.rates[name.split("/")[0]].seconds_per_frame * frames
        self.jobs.append(Job(name, seconds=round(seconds, 3), **facts))
        self.frames[name] = frames
        return name

    def disk_bytes(self, jobs: Sequence[Job]) -> float:
        """Forecast of the bytes that `jobs` write to the disk."""
        return sum(self.rates[job.kind].bytes_per_frame * self.frames[job.name] for job in jobs)


def plan_suite(
    benchmark: Benchmark,
    rows: Sequence[SuiteRow],
    sequences: tuple[str, ...],
    protocols: tuple[str, ...],
    rates: dict[str, Rate],
) -> Plan:
    """The jobs that run and score `rows` over `sequences` of `benchmark`.

    Raises FreeArtError when a sequence cannot be recorded with another sensor.
    """
    plan = Plan(list(rows), sequences, protocols, rates)
    frames = {name: len(read_sequence(benchmark.sequence(name))) for name in sequences}
    key = f"data {file_sha256(benchmark.folder / 'benchmark.json')}"
    for row in rows:
        data, names = str(benchmark.folder.resolve()), {name: name for name in sequences}
        recorded: tuple[str, ...] = ()
        if row.sensor is not None:
            data, names, recorded = _add_recording(plan, benchmark, row.sensor, frames, key)
        if row.reference is not None:
            answers = _add_reference(plan, row, data, frames, key)
        else:
            answers = _add_solving(plan, row, data, names, frames, recorded, key)
        if row.exported:
            answers = {
                name: plan.add(
                    f"export/{row.name}/{own}",
                    frames[name],
                    call="leaderboard.suite.steps:export",
                    arguments={"result": f"{{folder}}/results/{row.name}/{own}"},
                    needs=(answers[name],),
                    key=f"code {package_digest('export')}",
                )
                for name, own in names.items()
            }
        for protocol in protocols:
            arguments = {"data": data, "protocol": protocol, "out": "{out}", "sequences": list(names.values())}
            plan.add(
                f"score/{row.name}/{protocol}",
                sum(frames.values()),
                call="leaderboard.suite.steps:score",
                arguments={"results": f"{{folder}}/results/{row.name}", **arguments},
                out=f"scores/{row.name}.{protocol}.json",
                needs=tuple(dict.fromkeys(answers.values())),
                key=f"{key} code {package_digest('leaderboard')}",
            )
    return plan


def _add_recording(
    plan: Plan, benchmark: Benchmark, sensor: str, frames: dict[str, int], key: str
) -> tuple[str, dict[str, str], tuple[str, ...]]:
    """Add the job that records all sequences with `sensor`: its data folder, sequence to new name, and job name."""
    data = f"{{folder}}/data/{sensor}"
    commands = {name: _record_command(benchmark, name, sensor) for name in frames}
    names = {name: f"{words[0]}-s{words[words.index('--seed') + 1]}" for name, words in commands.items()}
    repeated = next((name for name in names.values() if list(names.values()).count(name) > 1), None)
    if repeated is not None:
        raise FreeArtError(f"two of the sequences would be recorded anew as '{repeated}': choose one of them")
    job = plan.add(
        f"record/{sensor}",
        sum(frames.values()),
        call="leaderboard.suite.steps:record",
        arguments={"commands": list(commands.values()), "out": data},
        out=f"data/{sensor}",
        resumes=True,
        key=key,
    )
    return data, names, (job,)


def _add_reference(plan: Plan, row: SuiteRow, data: str, frames: dict[str, int], key: str) -> dict[str, str]:
    """Add the job that writes a reference row; returns sequence to its name."""
    job = plan.add(
        f"reference/{row.name}",
        sum(frames.values()),
        call="leaderboard.suite.steps:reference",
        arguments={"kind": row.reference, "data": data, "out": "{out}", "sequences": list(frames)},
        out=f"results/{row.name}",
        key=f"{key} code {package_digest('leaderboard')}",
    )
    return dict.fromkeys(frames, job)


def _add_solving(
    plan: Plan,
    row: SuiteRow,
    data: str,
    names: dict[str, str],
    frames: dict[str, int],
    recorded: tuple[str, ...],
    key: str,
) -> dict[str, str]:
    """Add a job that solves each sequence; returns sequence to job name."""
    settings = ("--settings", f"{{folder}}/settings/{row.name}.json") if row.settings else ()
    solver = f"code {package_digest('reconstruct')} settings {json.dumps(row.settings, sort_keys=True)}"
    return {
        name: plan.add(
            f"{row.kind}/{row.name}/{own}",
            frames[name],
            command=(
                *("{freeart21}", "reconstruct", f"{data}/sequences/{own}"),
                *("--out", f"{{folder}}/results/{row.name}/{own}"),
                *settings,
            ),
            out=f"results/{row.name}/{own}",
            needs=recorded,
            codes=(0, 1, 3),  # 1: a declared failure is a result, too
            key=f"{key} {solver}",
        )
        for name, own in names.items()
    }


@lru_cache
def package_digest(package: str) -> str:
    """Hash (16 hexadecimal digits) of our version and a package's code without comments; it is not imported."""
    spec = importlib.util.find_spec(package)
    folders = [] if spec is None else list(spec.submodule_search_locations or [])
    files = sorted(path for folder in folders for path in Path(folder).rglob("*.py"))
    text = "".join(ast.dump(ast.parse(path.read_text("utf-8"))) for path in files)
    return hashlib.sha256(f"{freeart21.__version__} {text}".encode()).hexdigest()[:16]


def _record_command(benchmark: Benchmark, name: str, sensor: str) -> list[str]:
    """The words of `freeart21 record` that repeat a sequence's object and motion with another sensor."""
    source = checked.read_json(benchmark.truth(name) / "truth.json").get("source") or {}
    settings = source.get("settings") or {}
    other = next((key for key, value in _FIXED.items() if settings.get(key, value) != value), None)
    if source.get("object_source") != "procedural" or not all(key in settings for key in _RECORDED) or other:
        why = f"it has {other} {settings.get(other)}" if other else "it is not a recording of a catalog object"
        raise FreeArtError(f"{name} cannot be recorded with another sensor: {why}; leave out the rows of `sensors`")
    words = [str(source["object"]), "--sensor", sensor]
    for key in _RECORDED:
        words += [f"--{key}", str(settings[key])]
    return words
