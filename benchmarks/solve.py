"""How well the geometry solver solves FreeArt-21 v1: strict-2 scores, seconds and memory, object by object.

    .venv/bin/python -m benchmarks.solve [--tier seven|full] [--sensor noise2] [--settings.joint.type-rule paper]

records what is missing of the data, solves each object in a process of its own, exports, reloads and scores it, prints
the tables (worst first) and writes benchmarks/results/reconstruct.json (summary, by_type, rows, commit, settings,
machine). Another sensor, motion, split or setting is another variant, with its name in the files.

An object's outcome is kept in benchmarks/results/reconstruct/VARIANT/SEQUENCE.json and taken from there as long as its
key holds: the solver's version and code, its settings, how the sequence is recorded, and, where the sequence is here,
its bytes and its truth's. A run that was stopped goes on from there, within an object from its last finished stage.
Crashes are priced, and tried again.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import resource
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread
from typing import Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from benchmarks.common import RESULTS, ROOT, commit, machine
from freeart21 import catalog
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import read_benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from generator import v1
from generator.dataset import Job, Label, record_jobs
from generator.session import RecordSettings
from leaderboard.case import Case, score_sequence
from leaderboard.protocols import Group, protocol_named
from leaderboard.rows import Row
from leaderboard.score import summarise
from reconstruct import VERSION
from reconstruct.cache import code_digest
from reconstruct.settings import ReconstructSettings

PROTOCOL = "strict-2"
SCHEMA = "freeart21/benchmark-reconstruct/1"


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
    Goal("axis", "revolute", 0.5, "1.04"),
    Goal("axis", "prismatic", 0.5, "1.85"),
    Goal("axis", "all", 2.0, "-", "worst"),
    Goal("position", "revolute", 0.2, "about 0.15"),
    Goal("state", "revolute", 0.5, "1.43"),
    Goal("state", "prismatic", 0.3, "about 0.45"),
    Goal("miou", "all", 0.93, "0.909"),
    Goal("chamfer_w", "all", 0.5, "-"),
    Goal("chamfer_m", "all", 0.8, "-"),
)
NOISE_GOALS = (Goal("axis", "revolute", 1.2, "1.41"), Goal("axis", "prismatic", 1.2, "1.86"))
SECONDS, MEMORY_GB = 300.0, 3.0
"""To reach: for 300 frames on two cores. The paper: 420 s for 100 frames before its Gaussians, on an RTX 4090."""


@dataclass(frozen=True)
class Task:
    """One object to be solved and scored."""

    object: str
    motion: str
    sequence: Path
    truth: Path
    result: Path
    settings: ReconstructSettings
    key: str
    """Under which its outcome is kept."""
    data: str
    """Hash over the files of its sequence and truth."""


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
    solver: str
    commit: str
    machine: dict[str, Any]
    workers: int
    """Objects that were solved side by side."""
    data: str
    """Hash over the files of the sequence and its truth."""


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
    known_only: bool = False,
    fresh: bool = False,
    work: Path = ROOT / "out" / "reconstruct",
    kept: Path = RESULTS / "reconstruct",
    out: Path | None = None,
    settings: ReconstructSettings = ReconstructSettings(),  # noqa: B008 (frozen)
) -> None:
    """Solve and score FreeArt-21 v1.

    Args:
        data: Data folder of the split; sequences that it lacks are recorded. Other sensors, motions, presets and
            lengths are recorded beside it, in DATA-SENSOR and so on.
        tier: seven: the first object of each category; full: all 21.
        objects: These instead of a tier's.
        split: public, or test (to be scored only, never looked at).
        sensor: clean, noise2, tof, blur, hand, or several joined by '+'.
        motion: One motion for all objects instead of the benchmark's own.
        preset: handheld, or paper.
        frames: Frames a sequence.
        workers: Objects that are solved side by side: their seconds are not comparable then.
        known_only: Solve nothing: tables of what is known already.
        fresh: Solve all anew, whatever is known.
        work: Where results are kept, to look at.
        kept: Where outcomes are kept, an object a file, to be taken from there by later runs.
        out: The JSON file. When not given: benchmarks/results/reconstruct.json, or reconstruct-VARIANT.json there, and
            only when a whole tier is known.
        settings: Of the solver.
    """
    settings = replace(settings, progress=False)
    recorded = "-".join(_recorded(sensor, motion, preset, frames))
    variant = "-".join([split, *filter(None, [recorded]), *_changed(settings)])
    folder = data.with_name(f"{data.name}-{recorded}") if recorded else data
    chosen = _objects(tier, objects)
    known, todo = {}, []
    for job in _jobs(chosen, split, sensor, motion, preset, frames):
        key = _key(job, settings)
        outcome = None if fresh else read_outcome(kept / variant / f"{job.sequence}.json", key)
        if outcome is None or outcome.data != (_bytes_of(folder, job.sequence) or outcome.data):
            todo.append((job, key))
        else:
            known[job.sequence] = outcome
    if todo and known_only:
        _say(f"not known: {', '.join(job.sequence for job, _ in todo)}")
    elif todo:
        _record(folder, [job for job, _ in todo], split, recorded)
        tasks = [_task(job, key, folder, work / variant, settings) for job, key in todo]
        known |= _solve_all(tasks, workers, kept / variant, len(known))
    if not known:
        raise FreeArtError("nothing is known of this variant")
    outcomes = worst_first(list(known.values()))
    goals = {(): GOALS, ("noise2",): NOISE_GOALS}.get(tuple(_recorded(sensor, motion, preset, frames)), ())
    _print(outcomes, goals, f"{variant}, {'chosen objects' if objects else tier}")
    if out is None and (objects or len(known) < len(chosen)):
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
        "solver": VERSION,
        "code": code_digest(),
        "solver_settings": settings.to_json(),
        "objects": chosen,
    }
    body = {"summary": summary(outcomes), "by_type": by_type(outcomes), "rows": [_line(o) for o in outcomes]}
    atomic.write_json(path, {**body, "commit": commit(), "settings": facts, "machine": machine()})
    _say(f"{path}")


# --- what is to be done -----------------------------------------------------------------------------------------------


def _recorded(sensor: str, motion: str | None, preset: str, frames: int) -> list[str]:
    """What of the recording is not the benchmark's own."""
    found = [sensor] if sensor != "clean" else []
    found += [motion] if motion is not None else []
    found += [preset] if preset != "handheld" else []
    return found + ([f"{frames}frames"] if frames != 300 else [])


def _changed(settings: ReconstructSettings) -> list[str]:
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


def _jobs(
    objects: Sequence[str],
    split: Literal["public", "test"],
    sensor: str,
    motion: str | None,
    preset: str,
    frames: int,
) -> list[Job]:
    """The benchmark's own recordings of `objects`, but for what is asked otherwise."""
    jobs = v1.jobs(split, RecordSettings(sensor=sensor, preset=preset, frames=frames))
    if motion is not None:
        jobs = [replace(job, settings=replace(job.settings, motion=motion)) for job in jobs]
    return [job for job in jobs if job.name in objects]


def _key(job: Job, settings: ReconstructSettings) -> str:
    """SHA-256, hexadecimal, of what an outcome depends on, as far as it is known without the data."""
    facts = [PROTOCOL, VERSION, code_digest(), settings.to_json(), job.described(), v1.frozen()[job.sequence]]
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def _bytes_of(folder: Path, sequence: str) -> str | None:
    """SHA-256, hexadecimal, over all files of a sequence and its truth, as benchmark.json says; None without them."""
    if not (folder / "benchmark.json").is_file():
        return None
    hashes = checked.read_json(folder / "benchmark.json").get("sha256", {})
    mine = {path: value for path, value in hashes.items() if Path(path).parts[1:2] == (sequence,)}
    return hashlib.sha256(json.dumps(mine, sort_keys=True).encode()).hexdigest() if mine else None


def _record(folder: Path, jobs: Sequence[Job], split: Literal["public", "test"], recorded: str) -> None:
    """Record what is missing of `jobs`; what is there is held to their settings."""
    if (folder / "benchmark.json").is_file() and (there := read_benchmark(folder).split) != split:
        raise FreeArtError(f"{folder} is the split '{there}', expected '{split}': name another folder by --data")
    record_jobs(folder, jobs, label=Label("-".join(filter(None, [v1.NAME, recorded])), v1.VERSION, split))


def _task(job: Job, key: str, folder: Path, work: Path, settings: ReconstructSettings) -> Task:
    places = folder / "sequences" / job.sequence, folder / "truth" / job.sequence, work / job.sequence
    data = _bytes_of(folder, job.sequence)
    if data is None:
        raise FreeArtError(f"{folder} has no sequence {job.sequence} in its benchmark.json")
    return Task(job.name, job.settings.motion, *places, settings, key, data)


def read_outcome(path: Path, key: str) -> Outcome | None:
    """The outcome kept in `path`; None when there is none, or it is of another solver, setting or sequence."""
    if not path.is_file():
        return None
    data = checked.read_json(path, SCHEMA)
    if data.get("key") != key:
        return None
    facts = {name: data[name] for name in Outcome.__dataclass_fields__ if name != "row"}
    return Outcome(row=Row(**{**data["row"], "notes": tuple(data["row"]["notes"])}), **facts)


def write_outcome(path: Path, key: str, outcome: Outcome) -> None:
    """Keep `outcome` under `key`."""
    atomic.write_json(path, {"schema": SCHEMA, "key": key, **asdict(outcome)})


# --- doing it ---------------------------------------------------------------------------------------------------------


def _solve_all(todo: list[Task], workers: int, kept: Path, known: int) -> dict[str, Outcome]:
    """Outcomes of all tasks, each kept as soon as it is there; crashes are not kept."""
    found = {}
    pool = ThreadPoolExecutor(workers)
    futures = {pool.submit(_in_a_process, task, workers): task for task in todo}
    try:
        for k, future in enumerate(as_completed(futures)):
            task, (outcome, crashed) = futures[future], future.result()
            found[task.sequence.name] = outcome
            if not crashed:
                write_outcome(kept / f"{task.sequence.name}.json", task.key, outcome)
            _say(f"{known + k + 1}/{known + len(todo)} {_one_line(outcome)}")
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return found


def _in_a_process(task: Task, workers: int) -> tuple[Outcome, bool]:
    """Solve in a fresh process, whose memory is its own and whose crash costs its own row; whether it crashed."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(task, theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        answer: dict[str, Any] = ours.recv()
        process.join()
    except EOFError:
        process.join()
        answer = {"crash": f"crashed: the process ended with code {process.exitcode}"}
    if "broken" in answer:
        raise FreeArtError(answer["broken"])
    row, seconds, peak = answer.get("row"), answer.get("seconds", {}), answer.get("peak_gb")
    if row is None:
        case = Case(protocol_named(PROTOCOL), read_sequence(task.sequence), read_truth(task.truth))
        row = case.priced("failed", answer["crash"])
    outcome = Outcome(task.object, task.motion, row, seconds, peak, VERSION, commit(), machine(), workers, task.data)
    return outcome, "crash" in answer


def _work(task: Task, to: Connection) -> None:
    from export.exporter import export_result
    from freeart21.reconstruction import Failure
    from reconstruct.pipeline import reconstruct_folder

    Thread(target=_end_with_the_parent, daemon=True).start()
    try:
        result = reconstruct_folder(task.sequence, task.result, task.settings)
        peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    except Exception as error:
        to.send({"crash": f"crashed: {type(error).__name__}: {error}"})
        raise
    lacks = None
    if not isinstance(result, Failure):
        try:
            export_result(task.result, task.result / "asset")
        except FreeArtError as error:  # scored from the files then, and marked so
            lacks = f"no asset: {error}"
    try:
        row = score_sequence(task.result, task.sequence, task.truth, PROTOCOL)
    except FreeArtError as error:
        to.send({"broken": str(error)})
        return
    row = row if lacks is None else replace(row, notes=(*row.notes, lacks))
    to.send({"row": row, "seconds": result.seconds, "peak_gb": peak_gb})


def _end_with_the_parent() -> None:
    """A killed benchmark leaves no solver behind."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


# --- what it means ----------------------------------------------------------------------------------------------------


def failed(row: Row) -> bool:
    """Whether an object counts as a failure: axis over 10 degrees, wrong joint type, or mIoU under 0.6."""
    axis, kind, miou = (row.values[name] for name in ("axis", "joint_type", "miou"))
    return row.status != "ok" or kind != 1 or axis is None or axis > 10 or miou is None or miou < 0.6


def badness(row: Row) -> tuple[float, str]:
    """How many times the figure furthest from its goal is off, and its name; a mIoU is off by what it lacks to 1."""
    worst, name = 0.0, ""
    for goal in GOALS:
        value = row.values.get(goal.metric)
        if goal.group not in ("all", row.joint_type) or goal.statistic == "worst" or value is None:
            continue
        up = goal.metric in ("joint_type", "miou")
        share = (1 - value) / max(1 - goal.reach, 1e-3) if up else value / goal.reach
        if share > worst:
            worst, name = share, goal.metric
    return worst, name


def worst_first(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Failures, then by the figure that is furthest from its goal."""
    return sorted(outcomes, key=lambda o: (not failed(o.row), -badness(o.row)[0], o.row.sequence))


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
        "failures": sum(map(failed, rows)),
        "axis_deg_mean": mean("axis"),
        "axis_deg_worst": max(axes, default=None),
        "position_pct_mean": mean("position", "revolute"),
        "state_deg_mean": mean("state", "revolute"),
        "state_pct_mean": mean("state", "prismatic"),
        "miou_mean": mean("miou"),
        "chamfer_w_pct_mean": mean("chamfer_w"),
        "chamfer_m_pct_mean": mean("chamfer_m"),
        "seconds_mean": sum(totals) / len(totals) if totals else None,
        "peak_gb": max((o.peak_gb for o in outcomes if o.peak_gb is not None), default=None),
    }


def by_type(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Mean, sample standard deviation (ddof 1), median and worst of every metric, by joint type and over all."""
    found = summarise([o.row for o in outcomes], protocol_named(PROTOCOL))
    return {s.group: {"n": s.sequences, **{id: asdict(value) for id, value in s.statistics.items()}} for s in found}


def _line(outcome: Outcome) -> dict[str, Any]:
    row = outcome.row
    return {
        "object": outcome.object,
        "sequence": row.sequence,
        "category": catalog.find(outcome.object).category,
        "joint_type": row.joint_type,
        "motion": outcome.motion,
        "status": row.status,
        "reason": row.reason,
        "failed": failed(row),
        "worst_figure": badness(row)[1],
        **row.values,
        "notes": row.notes,
        "seconds": outcome.seconds,
        "seconds_total": sum(outcome.seconds.values()) if outcome.seconds else None,
        "peak_gb": outcome.peak_gb,
        "solver": outcome.solver,
        "commit": outcome.commit,
        "machine": outcome.machine,
        "workers": outcome.workers,
    }


# --- tables -----------------------------------------------------------------------------------------------------------


def _print(outcomes: list[Outcome], goals: Sequence[Goal], title: str) -> None:
    console = Console()
    if not console.is_terminal:
        console.width = 150
    console.print(_object_table(outcomes, title))
    for outcome in outcomes:
        for text in filter(None, (outcome.row.reason, *outcome.row.notes)):
            console.print(f"  {outcome.row.sequence}: {text}", markup=False, highlight=False)
    console.print(_goal_table(outcomes, goals))
    console.print(_stage_table(outcomes))
    here = machine()
    elsewhere = [o.row.sequence for o in outcomes if o.machine != here or o.workers > 1]
    if elsewhere:
        console.print(f"  seconds of another machine, or of several side by side: {', '.join(elsewhere)}")


def _object_table(outcomes: list[Outcome], title: str) -> Table:
    shown = ("axis", "position", "state", "miou", "chamfer_w", "chamfer_m")
    table = Table(title=f"{PROTOCOL}, {title}: worst first")
    for head in ("sequence", "motion", "", *shown, "worst", "s", "GB"):
        table.add_column(head, justify="left" if head in ("sequence", "motion", "", "worst") else "right")
    for o in outcomes:
        row, style = o.row, "red" if failed(o.row) else None
        status = "FAILED" if failed(row) else row.joint_type
        cells = [_number(row.values.get(id)) for id in shown]
        total = _number(sum(o.seconds.values()), 0) if o.seconds else "-"
        table.add_row(
            row.sequence, o.motion, status, *cells, badness(row)[1], total, _number(o.peak_gb, 2), style=style
        )
    return table


def _goal_table(outcomes: list[Outcome], goals: Sequence[Goal]) -> Table:
    rules, found, figures = protocol_named(PROTOCOL), by_type(outcomes), summary(outcomes)
    table = Table("figure", "of", "mean ± std", "median", "worst", "reach", "paper (other objects)", title="figures")
    lines = [(g.metric, g.group) for g in GOALS if g.statistic == "mean"]
    for metric, group in lines:
        unit = rules.metric(metric).unit(group)
        at = {g.statistic: g for g in goals if (g.metric, g.group) == (metric, group)}
        worst_at = next((g for g in goals if g.metric == metric and g.statistic == "worst"), None)
        value = found.get(group, {}).get(metric)
        if value is None:
            continue
        std = "" if value["std"] is None else f" ± {value['std']:.3f}"
        reach = f"{at['mean'].reach:g}" if "mean" in at else "-"
        reach += f" (worst {worst_at.reach:g})" if worst_at else ""
        paper = at["mean"].paper if "mean" in at else "-"
        name = metric if unit == "fraction" else f"{metric}, {unit}"
        table.add_row(
            name, group, f"{value['mean']:.3f}{std}", _number(value["median"]), _number(value["worst"]), reach, paper
        )
    clean = goals is GOALS
    n = figures["n"]
    table.add_row("failures", "all", f"{figures['failures']} of {n}", "", "", "0" if clean else "-", "-")
    note = "420 for 100 frames, RTX 4090"
    peaks = [o.peak_gb for o in outcomes if o.peak_gb is not None]
    table.add_row("seconds", "all", _number(figures["seconds_mean"], 0), "", "", f"{SECONDS:g}" if clean else "-", note)
    mean_peak = sum(peaks) / len(peaks) if peaks else None
    worst_peak = _number(figures["peak_gb"], 2)
    table.add_row("peak, GB", "all", _number(mean_peak, 2), "", worst_peak, f"{MEMORY_GB:g}" if clean else "-", "-")
    return table


def _stage_table(outcomes: list[Outcome]) -> Table:
    table = Table("stage", "mean s", "longest s", "of", title="seconds a stage")
    for stage in dict.fromkeys(stage for o in outcomes for stage in o.seconds):
        took = [(o.seconds[stage], o.row.sequence) for o in outcomes if stage in o.seconds]
        longest = max(took)
        table.add_row(stage, f"{sum(t for t, _ in took) / len(took):.1f}", f"{longest[0]:.1f}", longest[1])
    return table


def _one_line(outcome: Outcome) -> str:
    row = outcome.row
    figures = ", ".join(f"{id} {_number(row.values.get(id))}" for id in ("axis", "state", "miou", "chamfer_m"))
    mark = " FAILED" if failed(row) else ""
    return f"{row.sequence}{mark}: {figures}; {sum(outcome.seconds.values()):.0f} s, {_number(outcome.peak_gb, 2)} GB"


def _number(value: float | int | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except FreeArtError as error:
        raise SystemExit(f"reconstruct: {error}") from error
    except KeyboardInterrupt:
        raise SystemExit(130) from None
