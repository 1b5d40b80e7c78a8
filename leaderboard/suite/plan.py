"""The jobs of a suite, and what they will cost."""

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
from freeart21.files.benchmark import Benchmark, file_sha256
from freeart21.files.sequence import read_sequence
from freeart21.jobs import Job
from leaderboard.suite.rates import Rate
from leaderboard.suite.rows import SuiteRow

_RECORDED = ("frames", "seed", "width", "height", "queries", "motion", "preset", "shader")
"""What a truth says of how it was recorded that `freeart21 record` takes."""
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
"""What it does not take, or what would change a sequence's name: such as these only is recorded anew."""


@dataclass
class Plan:
    """The jobs of a suite, and the frames that each works on."""

    rows: list[SuiteRow]
    sequences: tuple[str, ...]
    protocols: tuple[str, ...]
    jobs: list[Job] = field(default_factory=list)
    frames: dict[str, int] = field(default_factory=dict)

    def add(self, rates: dict[str, Rate], frames: int, name: str, **facts: Any) -> str:
        """Add the job `name`, which works on so many frames; returns its name."""
        seconds = rates[name.split("/")[0]].seconds_per_frame * frames
        self.jobs.append(Job(name, seconds=round(seconds, 3), **facts))
        self.frames[name] = frames
        return name


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
    plan = Plan(list(rows), sequences, protocols)
    frames = {name: _frames(benchmark, name) for name in sequences}
    data, total = str(benchmark.folder.resolve()), sum(frames.values())
    key = f"data {file_sha256(benchmark.folder / 'benchmark.json')}"
    for row in rows:
        results, place, names = f"results/{row.name}", data, dict(zip(sequences, sequences, strict=True))
        first: tuple[str, ...] = ()
        if row.sensor is not None:
            place = f"{{folder}}/data/{row.sensor}"
            commands = {name: _recording(benchmark, name, row.sensor) for name in sequences}
            names = {name: f"{words[0]}-s{words[words.index('--seed') + 1]}" for name, words in commands.items()}
            twice = next((name for name in names.values() if list(names.values()).count(name) > 1), None)
            if twice is not None:
                raise FreeArtError(f"two of the sequences would be recorded anew as '{twice}': choose one of them")
            first = (
                plan.add(
                    rates,
                    total,
                    f"record/{row.sensor}",
                    call="leaderboard.suite.steps:record",
                    arguments={"commands": list(commands.values()), "out": place},
                    out=f"data/{row.sensor}",
                    resumes=True,
                    key=key,
                ),
            )
        if row.reference is not None:
            made = plan.add(
                rates,
                total,
                f"reference/{row.name}",
                call="leaderboard.suite.steps:reference",
                arguments={"kind": row.reference, "data": place, "out": "{out}", "sequences": list(sequences)},
                out=results,
                key=f"{key} code {package_digest('leaderboard')}",
            )
            solved = dict.fromkeys(sequences, made)
        else:
            solved = {
                name: plan.add(
                    rates,
                    frames[name],
                    f"{row.kind}/{row.name}/{own}",
                    command=(
                        *("{freeart21}", "reconstruct", f"{place}/sequences/{own}"),
                        *("--out", f"{{folder}}/{results}/{own}"),
                        *(("--settings", f"{{folder}}/settings/{row.name}.json") if row.settings else ()),
                    ),
                    out=f"{results}/{own}",
                    needs=first,
                    codes=(0, 1, 3),  # 1 is an answer, too, as long as the failure is written down
                    key=f"{key} code {package_digest('reconstruct')} "
                    f"settings {json.dumps(row.settings, sort_keys=True)}",
                )
                for name, own in names.items()
            }
        if row.exported:
            solved = {
                name: plan.add(
                    rates,
                    frames[name],
                    f"export/{row.name}/{own}",
                    call="leaderboard.suite.steps:export",
                    arguments={"result": f"{{folder}}/{results}/{own}"},
                    needs=(solved[name],),
                    key=f"code {package_digest('export')}",
                )
                for name, own in names.items()
            }
        for protocol in protocols:
            plan.add(
                rates,
                total,
                f"score/{row.name}/{protocol}",
                call="leaderboard.suite.steps:score",
                arguments={
                    "results": f"{{folder}}/{results}",
                    "data": place,
                    "protocol": protocol,
                    "out": "{out}",
                    "sequences": list(names.values()),
                },
                out=f"scores/{row.name}.{protocol}.json",
                needs=tuple(dict.fromkeys(solved.values())),
                key=f"{key} code {package_digest('leaderboard')}",
            )
    return plan


def disk_bytes(plan: Plan, jobs: Sequence[Job], rates: dict[str, Rate]) -> float:
    """What `jobs` will leave on the disk."""
    return sum(rates[job.kind].bytes_per_frame * plan.frames[job.name] for job in jobs)


@lru_cache
def package_digest(room: str) -> str:
    """SHA-256, hexadecimal, of the version and of a room's code, comments and layout apart; it is not imported."""
    found = importlib.util.find_spec(room)
    places = [] if found is None else list(found.submodule_search_locations or [])
    files = sorted(path for place in places for path in Path(place).rglob("*.py"))
    text = "".join(ast.dump(ast.parse(path.read_text("utf-8"))) for path in files)
    return hashlib.sha256(f"{freeart21.__version__} {text}".encode()).hexdigest()[:16]


def _frames(benchmark: Benchmark, name: str) -> int:
    return len(read_sequence(benchmark.sequence(name)))


def _recording(benchmark: Benchmark, name: str, sensor: str) -> list[str]:
    """The words of `freeart21 record` that record the object and motion of a sequence with another sensor."""
    source = checked.read_json(benchmark.truth(name) / "truth.json").get("source") or {}
    settings = source.get("settings") or {}
    other = next((key for key, value in _FIXED.items() if settings.get(key, value) != value), None)
    if source.get("object_source") != "procedural" or not all(key in settings for key in _RECORDED) or other:
        why = f"it has {other} {settings.get(other)}" if other else "it is no recording of an object of ours"
        raise FreeArtError(f"{name} cannot be recorded with another sensor: {why}; leave out the rows of `sensors`")
    words = [str(source["object"]), "--sensor", sensor]
    for key in _RECORDED:
        words += [f"--{key}", str(settings[key])]
    return words
