"""How well the solver solves FreeArt-21 v1: strict-2 scores, seconds and memory, object by object.

    .venv/bin/python -m benchmarks.solve [--tier seven|full] [--sensor noise2] [--settings.joint.type-rule paper]

records what is missing of the data, solves each object in a process of its own, exports, reloads and scores it, prints
the tables (worst first) and writes benchmarks/results/reconstruct.json (summary, by_type, rows, commit, settings,
machine). Another sensor, motion, split or setting is another variant, with its name in the files.

Rows are kept in --work/VARIANT as long as the solver's version and commit, its settings, how the sequence is recorded,
its bytes and its truth's are the same. A run that was stopped goes on from there, within an object from its last
finished stage. Crashes are priced, and tried again.
"""

from __future__ import annotations

import hashlib
import json
import resource
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from benchmarks.common import (
    RESULTS,
    ROOT,
    commit,
    digest_of,
    format_number,
    machine,
    print_table,
    run_cli,
    run_rows,
    write_report,
)
from freeart21 import catalog
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.benchmark import read_benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from generator import v1
from generator.dataset import Job, Label, record_jobs
from generator.session import RecordSettings
from leaderboard.protocols import Group, protocol_named
from leaderboard.rows import Row
from leaderboard.score import summarise
from leaderboard.sequence_score import SequenceScorer, score_sequence
from reconstruct import VERSION
from reconstruct.settings import ReconstructSettings

PROTOCOL = "strict-2"


@dataclass(frozen=True)
class Goal:
    """A figure that the solver is to reach on the clean, handheld, 300-frame benchmark."""

    metric: str
    """Of the protocol."""
    group: Group
    reach: float
    paper: str
    """What the paper reports of other objects, by its own evaluator; '-' where it reports nothing comparable."""
    statistic: Literal["mean", "worst"] = "mean"


GOALS = (
    Goal("joint_type", "all", 1.0, "-"),
    Goal("axis", "revolute", 0.1, "1.04"),
    Goal("axis", "prismatic", 0.1, "1.85"),
    Goal("axis", "all", 0.5, "-", "worst"),
    Goal("position", "revolute", 0.2, "about 0.15"),
    Goal("state", "revolute", 0.12, "1.43"),
    Goal("state", "prismatic", 0.08, "about 0.45"),
    Goal("miou", "all", 0.965, "0.909"),
    Goal("chamfer_w", "all", 0.14, "-"),
    Goal("chamfer_m", "all", 0.2, "-"),
    Goal("psnr", "all", 30.0, "24.0 (revolute), 22.9 (prismatic)"),
    Goal("psnr", "all", 24.0, "-", "worst"),
)
MORE_IS_BETTER = ("joint_type", "miou", "psnr")


_NEVER = 1e9
PIECES: dict[str, dict[str, Any]] = {
    "no-track-filters": {"tracks": {"visibility_filter": False, "displacement_filter": False}},
    "no-colour": {"evidence": {"colour_weight": 0.0}},
    "one-beginning": {"growth": {"beginnings": 1}},
    "one-attempt": {"growth": {"attempts": 1}},
    "no-even-motion": {"growth": {"surprise_weight": 0.0}},
    "no-recovery": {"growth": {"surprising_cost": _NEVER}},
    "no-votes": {"labels": {"rounds_of_votes": 0}},
    "no-gaps": {"gaps": {"shortest_gap": 1_000_000, "jump": _NEVER}},
    "no-loops": {"poses": {"loops": 0}},
    "paper-type": {"joint": {"type_rule": "paper"}},
    "no-noise-resistance": {"joint": {"noise_resistance": False}},
    "no-gaussians": {"gaussians": {"refine": False}},
    "no-end-to-end": {"gaussians": {"end_to_end": False}},
    "no-blended-rendering": {"gaussians": {"blended": False}},
}
"""Piece of the solver to the settings without it."""
DIGITS = {"axis": 2, "position": 2, "state": 2, "miou": 3, "chamfer_w": 2, "chamfer_m": 2, "psnr": 1}
"""Metrics of the tables, and their digits."""


@dataclass(frozen=True)
class Case:
    """One recording to be solved and scored."""

    object: str
    motion: str
    sequence: Path
    truth: Path
    recording: Any
    """All that decides its bytes, as JSON."""


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    object: str
    motion: str
    row: Row
    """By the protocol."""
    seconds: dict[str, float]
    """Per stage of the solver."""
    peak_gb: float | None
    """Of the solver's process, before export and score; None when it crashed."""
    commit: str
    machine: dict[str, Any]


def main(
    data: Path = ROOT / "out" / "freeart21-v1",
    tier: Literal["seven", "full"] = "seven",
    objects: tuple[str, ...] = (),
    split: Literal["public", "test"] = "public",
    sensor: str = "clean",
    motion: str | None = None,
    preset: str = "handheld",
    frames: int = 300,
    workers: int = 1,
    work: Path = ROOT / "out" / "reconstruct",
    out: Path | None = None,
    method: Literal["ours", "paper"] = "ours",
    settings: ReconstructSettings = ReconstructSettings(),  # noqa: B008 (frozen)
) -> None:
    """Solve and score FreeArt-21 v1.

    Args:
        data: Data folder of the split; sequences that it lacks are recorded. Other sensors, motions, presets and
            lengths are recorded next to it, in DATA-SENSOR and so on.
        tier: seven: the first object of each category; full: all 21.
        objects: These instead of a tier's.
        split: public, or test (to be scored only, never looked at).
        sensor: clean, noise2, tof, phone, blur, hand, or several joined by '+'.
        motion: One motion for all objects instead of the benchmark's own.
        preset: handheld, or paper.
        frames: Frames a sequence.
        workers: Objects that are solved side by side: their seconds are not comparable then.
        work: Where results are kept, to look at, and what is known of them.
        out: The JSON file. When not given: benchmarks/results/reconstruct.json, or reconstruct-VARIANT.json there, and
            only when a whole tier is known.
        method: ours, or `baselines.paper`, which has no settings.
        settings: Of the solver.
    """
    settings = replace(settings, progress=False)
    recorded = "-".join(_name_recording(sensor, motion, preset, frames))
    variant = "-".join(
        [split, *filter(None, [recorded]), *([] if method == "ours" else [method]), *_name_changes(settings)]
    )
    folder = data.with_name(f"{data.name}-{recorded}") if recorded else data
    chosen = _objects(tier, objects)
    recordings = _recordings(chosen, split, sensor, motion, preset, frames)
    _record(folder, recordings, split, recorded)
    cases = [case_of(recording, folder) for recording in recordings]
    outcomes = worst_first(solve_cases(cases, settings, work / variant, workers, method))
    print_outcomes(outcomes, f"{variant}, {'chosen objects' if objects else tier}")
    if out is None and objects:
        return
    path = out or RESULTS / ("reconstruct.json" if variant == "public" else f"reconstruct-{variant}.json")
    facts = {
        "tier": tier,
        "split": split,
        "sensor": sensor,
        "motion": motion or "own",
        "preset": preset,
        "frames": frames,
        "protocol": PROTOCOL,
        "method": method,
        "solver": VERSION,
        "solver_settings": settings.to_json(),
        "workers": workers,
        "objects": chosen,
    }
    write_report(path, facts, **figures(outcomes))


def with_changes(changes: dict[str, dict[str, Any]]) -> ReconstructSettings:
    """The default settings with some fields of some groups changed, without progress."""
    base = ReconstructSettings(progress=False)
    return replace(base, **{group: replace(getattr(base, group), **values) for group, values in changes.items()})


# --- what is to be done -----------------------------------------------------------------------------------------------


def _name_recording(sensor: str, motion: str | None, preset: str, frames: int) -> list[str]:
    """What of the recording is not the benchmark's own."""
    found = [sensor] if sensor != "clean" else []
    found += [motion] if motion is not None else []
    found += [preset] if preset != "handheld" else []
    return found + ([f"{frames}frames"] if frames != 300 else [])


def _name_changes(settings: ReconstructSettings) -> list[str]:
    """A name for settings that are not the solver's own: the changed ones, or a digest of many."""
    own, now = _flat(ReconstructSettings(progress=False).to_json()), _flat(settings.to_json())
    changed = [f"{name.rsplit('.', 1)[-1]}={now[name]}" for name in now if now[name] != own[name]]
    text = "-".join(changed)
    if not text:
        return []
    plain = all(c.isalnum() or c in "=-_." for c in text) and len(text) < 80
    return [text if plain else f"settings-{hashlib.sha256(text.encode()).hexdigest()[:8]}"]


def _flat(data: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in data.items():
        found |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return found


def _objects(tier: str, named: Sequence[str] = ()) -> list[str]:
    """All built-in objects, or the first of each category: chosen by place, not by how they fare; or those named."""
    names = catalog.built_in_names()
    unknown = [name for name in named if name not in names]
    if unknown:
        raise FreeArtError(f"the benchmark has no object '{unknown[0]}'; it has {', '.join(names)}")
    if named:
        return list(dict.fromkeys(named))
    if tier == "full":
        return list(names)
    first: dict[str, str] = {}
    for name in names:
        first.setdefault(catalog.find(name).category, name)
    return list(first.values())


def _recordings(
    objects: Sequence[str],
    split: Literal["public", "test"],
    sensor: str,
    motion: str | None,
    preset: str,
    frames: int,
) -> list[Job]:
    """The benchmark's own recordings of `objects`, but for what is asked otherwise."""
    found = v1.jobs(split, RecordSettings(sensor=sensor, preset=preset, frames=frames))
    if motion is not None:
        found = [replace(job, settings=replace(job.settings, motion=motion)) for job in found]
    return [job for job in found if job.name in objects]


def _bytes_of(folder: Path, sequence: str) -> str | None:
    """SHA-256, hexadecimal, over all files of a sequence and its truth, as benchmark.json says; None without them."""
    if not (folder / "benchmark.json").is_file():
        return None
    hashes = checked.read_json(folder / "benchmark.json").get("sha256", {})
    mine = {path: value for path, value in hashes.items() if Path(path).parts[1:2] == (sequence,)}
    return hashlib.sha256(json.dumps(mine, sort_keys=True).encode()).hexdigest() if mine else None


def _record(folder: Path, recordings: Sequence[Job], split: Literal["public", "test"], recorded: str) -> None:
    """Record what is missing; what is there is held to the settings of `recordings`."""
    if (folder / "benchmark.json").is_file() and (there := read_benchmark(folder).split) != split:
        raise FreeArtError(f"{folder} is the split '{there}', expected '{split}': name another folder by --data")
    record_jobs(folder, recordings, label=Label("-".join(filter(None, [v1.NAME, recorded])), v1.VERSION, split))


def case_of(recording: Job, folder: Path) -> Case:
    """The case of a recording in the data folder `folder`."""
    name, data = recording.sequence, _bytes_of(folder, recording.sequence)
    if data is None:
        raise FreeArtError(f"{folder} has no sequence {name} in its benchmark.json")
    facts = [recording.to_json(), data]
    return Case(recording.name, recording.settings.motion, folder / "sequences" / name, folder / "truth" / name, facts)


# --- doing it ---------------------------------------------------------------------------------------------------------


def solve_cases(
    cases: Sequence[Case], settings: ReconstructSettings, folder: Path, workers: int = 1, method: str = "ours"
) -> list[Outcome]:
    """Outcomes of the cases, solved in `folder`, which keeps results (results/SEQUENCE) and rows."""
    todo = {}
    for case in cases:
        key = digest_of(PROTOCOL, VERSION, method, commit("reconstruct"), settings.to_json(), case.recording)
        place = folder / "results" / case.sequence.name
        todo[case.sequence.name] = (key, solve, (case.sequence, case.truth, place, settings, method))
    rows = run_rows(folder / "rows", todo, workers)
    return [_outcome(case, rows[case.sequence.name]) for case in cases]


def _outcome(case: Case, answer: dict[str, Any]) -> Outcome:
    """The outcome of what `solve` returned; a crash costs the penalty."""
    if "crash" not in answer:
        return Outcome(case.object, case.motion, **{**answer, "row": Row.from_json(answer["row"])})
    scorer = SequenceScorer(protocol_named(PROTOCOL), read_sequence(case.sequence), read_truth(case.truth))
    row = scorer.penalised_row("failed", f"crashed: {answer['crash']}")
    return Outcome(case.object, case.motion, row, {}, None, commit(), machine())


def solve(sequence: Path, truth: Path, place: Path, settings: ReconstructSettings, method: str) -> dict[str, Any]:
    """Solve, export and score a recording, in a process of its own; the fields of `Outcome` that are not the case's."""
    from baselines import paper
    from export.exporter import export_result
    from freeart21.reconstruction import Failure
    from reconstruct.pipeline import reconstruct_folder

    found = paper.main(sequence, place) if method == "paper" else reconstruct_folder(sequence, place, settings)
    peak_gb, lacks = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9, ()
    if not isinstance(found, Failure):
        try:
            export_result(place, place / "asset")
        except FreeArtError as error:  # scored from the files then, and marked so
            lacks = (f"no asset: {error}",)
    row = score_sequence(place, sequence, truth, PROTOCOL)
    body = {"row": asdict(replace(row, notes=(*row.notes, *lacks))), "seconds": found.seconds, "peak_gb": peak_gb}
    return {**body, "commit": commit(), "machine": machine()}


# --- what it means ----------------------------------------------------------------------------------------------------


def has_failed(row: Row) -> bool:
    """Whether an object counts as a failure: axis over 10 degrees, wrong joint type, or mIoU under 0.6."""
    axis, kind, miou = (row.values[name] for name in ("axis", "joint_type", "miou"))
    return row.status != "ok" or kind != 1 or axis is None or axis > 10 or miou is None or miou < 0.6


def badness(row: Row) -> tuple[float, str]:
    """How many times the figure furthest from its goal is off, and its name: a mIoU by what it lacks to 1, a
    PSNR by the error that it stands for."""
    worst, name = 0.0, ""
    for goal in GOALS:
        value = row.values.get(goal.metric)
        if goal.group not in ("all", row.joint_type) or goal.statistic == "worst" or value is None:
            continue
        if goal.metric == "psnr":  # decibels of errors of a picture
            share = 10 ** ((goal.reach - value) / 20)
        elif goal.metric in MORE_IS_BETTER:
            share = (1 - value) / max(1 - goal.reach, 1e-3)
        else:
            share = value / goal.reach
        if share > worst:
            worst, name = share, goal.metric
    return worst, name


def worst_first(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Failures, then by the figure that is furthest from its goal."""
    return sorted(outcomes, key=lambda o: (not has_failed(o.row), -badness(o.row)[0], o.row.sequence))


def summary(outcomes: Sequence[Outcome]) -> dict[str, float | int | None]:
    """Figures followed from change to change: means over all objects of a kind, failures at their price."""
    rows = [o.row for o in outcomes]

    def mean(metric: str, kind: str | None = None) -> float | None:
        values = [row.values[metric] for row in rows if kind in (None, row.joint_type)]
        there = [value for value in values if value is not None]
        return sum(there) / len(there) if there else None

    axes = [row.values["axis"] for row in rows if row.values["axis"] is not None]
    totals = [sum(o.seconds.values()) for o in outcomes if o.seconds]
    return {
        "n": len(rows),
        "type_right": sum(row.values["joint_type"] == 1 for row in rows),
        "failures": sum(map(has_failed, rows)),
        "axis_deg_mean": mean("axis"),
        "axis_deg_worst": max(axes, default=None),
        "position_pct_mean": mean("position", "revolute"),
        "state_deg_mean": mean("state", "revolute"),
        "state_pct_mean": mean("state", "prismatic"),
        "miou_mean": mean("miou"),
        "chamfer_w_pct_mean": mean("chamfer_w"),
        "chamfer_m_pct_mean": mean("chamfer_m"),
        "psnr_db_mean": mean("psnr"),
        "psnr_db_worst": min((row.values["psnr"] for row in rows if row.values["psnr"] is not None), default=None),
        "seconds_mean": sum(totals) / len(totals) if totals else None,
        "peak_gb": max((o.peak_gb for o in outcomes if o.peak_gb is not None), default=None),
    }


def by_type(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Mean, sample standard deviation (ddof 1), median and worst of every metric, by joint type and over all."""
    found = summarise([o.row for o in outcomes], protocol_named(PROTOCOL)) if outcomes else []
    return {s.group: {"n": s.sequences, **{id: asdict(value) for id, value in s.statistics.items()}} for s in found}


def figures(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """All that the JSON file says of a variant."""
    return {"summary": summary(outcomes), "by_type": by_type(outcomes), "rows": [_line(o) for o in outcomes]}


def _line(outcome: Outcome) -> dict[str, Any]:
    row = outcome.row
    return {
        "object": outcome.object,
        "sequence": row.sequence,
        "category": catalog.find(outcome.object, partnet=True).category,
        "joint_type": row.joint_type,
        "motion": outcome.motion,
        "status": row.status,
        "reason": row.reason,
        "failed": has_failed(row),
        "worst_figure": badness(row)[1],
        **row.values,
        "notes": row.notes,
        "seconds": outcome.seconds,
        "seconds_total": sum(outcome.seconds.values()) if outcome.seconds else None,
        "peak_gb": outcome.peak_gb,
        "commit": outcome.commit,
        "machine": outcome.machine,
    }


# --- tables -----------------------------------------------------------------------------------------------------------


def print_outcomes(outcomes: Sequence[Outcome], title: str) -> None:
    """Every object, worst first, what all of them reach, and seconds a stage."""
    cells = []
    for o in outcomes:
        status = "FAILED" if has_failed(o.row) else o.row.joint_type
        numbers = [format_number(o.row.values.get(id)) for id in DIGITS]
        total = format_number(sum(o.seconds.values()), 0) if o.seconds else "-"
        cells.append(
            [o.row.sequence, o.motion, status, *numbers, badness(o.row)[1], total, format_number(o.peak_gb, 2)]
        )
    print_table(f"{PROTOCOL}, {title}: worst first", ("sequence", "motion", "", *DIGITS, "worst", "s", "GB"), cells)
    for outcome in outcomes:
        for text in filter(None, (outcome.row.reason, *outcome.row.notes)):
            print(f"  {outcome.row.sequence}: {text}")
    found = by_type(outcomes)
    lines = [
        (goal.metric, goal.group, goal.statistic, format_number(value[goal.statistic]), f"{goal.reach:g}", goal.paper)
        for goal in GOALS
        if (value := found.get(goal.group, {}).get(goal.metric)) is not None
    ]
    print_table("figures", ("figure", "of", "", "reached", "goal", "paper (other objects)"), lines)
    for name, value in summary(outcomes).items():
        print(f"  {name}: {format_number(value)}")
    stages = []
    for stage in dict.fromkeys(stage for o in outcomes for stage in o.seconds):
        took = [(o.seconds[stage], o.row.sequence) for o in outcomes if stage in o.seconds]
        stages.append((stage, f"{sum(t for t, _ in took) / len(took):.1f}", f"{max(took)[0]:.1f}", max(took)[1]))
    print_table("seconds a stage", ("stage", "mean s", "longest s", "of"), stages)


if __name__ == "__main__":
    run_cli(main)
