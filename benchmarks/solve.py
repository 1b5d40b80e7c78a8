"""How well the geometry solver solves FreeArt-21 v1: strict-2 scores, seconds and memory, object by object.

    .venv/bin/python -m benchmarks.solve [--tier seven|full] [--sensor noise2] [--settings.joint.type-rule paper]
        [--beside no-gaussians no-end-to-end]

records what is missing of the data, solves each object in a process of its own, exports, reloads and scores it, prints
the tables (worst first) and writes benchmarks/results/reconstruct.json (summary, by_type, rows, commit, settings,
machine). Another sensor, motion, split or setting is another variant, with its name in the files. Variants --beside,
rows of the suite that differ from the stage `gaussians` on, are solved from the same geometry and compared with it,
object by object.

Each object is a job (`freeart21.jobs`) in --work/VARIANT, which is not run again as long as its key holds: the solver's
version and code, its settings, how the sequence is recorded, its bytes and its truth's. A run that was stopped goes on
from there, within an object from its last finished stage. Crashes are priced, and tried again.
"""

from __future__ import annotations

import hashlib
import json
import resource
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from rich.table import Table

from benchmarks.common import (
    RESULTS,
    ROOT,
    commit,
    format_number,
    machine,
    make_table,
    run_cli,
    wide_console,
    write_report,
)
from freeart21 import catalog, jobs
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import read_benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.jobs.job import job_digests
from freeart21.jobs.ledger import Ledger
from generator import v1
from generator.dataset import Job, Label, record_jobs
from generator.session import RecordSettings
from leaderboard.protocols import Group, protocol_named
from leaderboard.rows import Row
from leaderboard.score import summarise
from leaderboard.sequence_score import SequenceScorer, score_sequence
from leaderboard.suite.rows import ROWS
from reconstruct import VERSION
from reconstruct.cache import code_digest, work_folder
from reconstruct.settings import ReconstructSettings, read_settings
from reconstruct.stages import settings_used_by

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


@dataclass(frozen=True)
class Aim:
    """All that is to be reached with a sensor; nothing where None or empty."""

    goals: tuple[Goal, ...] = ()
    failures: int | None = None
    seconds: float | None = None
    """Of a mean object on two cores, the stage `gaussians` left out. The paper: 420 s for 100 frames before its
    Gaussians, on an RTX 4090."""
    gaussian_seconds: float | None = None
    """Of that stage."""
    peak_gb: float | None = None
    """Of every object."""
    no_worse: bool = False
    """Whether the Gaussians may make no object worse than geometry alone, by WORSE_AXIS and WORSE_STATE."""


WORSE_AXIS, WORSE_STATE = 0.05, 0.1
"""Degrees; degrees or per cent."""
AIMS = {
    "": Aim(GOALS, 0, 120.0, 80.0, 2.5, no_worse=True),
    "noise2": Aim(
        (
            Goal("axis", "revolute", 0.3, "1.41"),
            Goal("axis", "prismatic", 0.3, "1.86"),
            Goal("state", "revolute", 0.4, "-"),
            Goal("state", "prismatic", 0.4, "-"),
        ),
        gaussian_seconds=240.0,
        peak_gb=3.0,
    ),
    "tof": Aim((Goal("miou", "all", 0.92, "-"),), failures=0, gaussian_seconds=240.0, peak_gb=3.0),
}
"""By what of the recording is not the benchmark's own. Of 300 frames, hand-held."""
OURS = "ours"
DIGITS = {"axis": 2, "position": 2, "state": 2, "miou": 3, "chamfer_w": 2, "chamfer_m": 2, "psnr": 1}
SHOWN = tuple(DIGITS)
"""Metrics of the tables, and their digits beside each other."""


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
    known_only: bool = False,
    fresh: bool = False,
    beside: tuple[str, ...] = (),
    work: Path = ROOT / "out" / "reconstruct",
    out: Path | None = None,
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
        known_only: Solve nothing: tables of what is known already.
        fresh: Solve all anew, whatever is known.
        beside: Variants that are solved from the same geometry and compared: no-gaussians, no-end-to-end,
            no-blended-rendering.
        work: Where results are kept, to look at, and what is known of them.
        out: The JSON file. When not given: benchmarks/results/reconstruct.json, or reconstruct-VARIANT.json there, and
            only when a whole tier is known.
        settings: Of the solver.
    """
    settings = replace(settings, progress=False)
    variants = {OURS: settings, **{name: without(settings, name) for name in dict.fromkeys(beside)}}
    recorded = "-".join(_name_recording(sensor, motion, preset, frames))
    names = {name: "-".join([split, *filter(None, [recorded]), *_name_changes(its)]) for name, its in variants.items()}
    if len(set(names.values())) < len(names):
        raise FreeArtError(f"--beside names what --settings says already: {', '.join(names.values())}")
    variant = names[OURS]
    folder = data.with_name(f"{data.name}-{recorded}") if recorded else data
    chosen = _objects(tier, objects)
    recordings = _recordings(chosen, split, sensor, motion, preset, frames)
    if not known_only:
        _record(folder, recordings, split, recorded)
    cases = [case_of(recording, folder) for recording in recordings]
    known = solve_cases(cases, variants, work / variant, workers, fresh, known_only)
    of = {name: worst_first([o for (n, _), o in known.items() if n == name]) for name in variants}
    outcomes = of.pop(OURS)
    if not outcomes:
        raise FreeArtError("nothing is known of this variant")
    aim = AIMS.get(recorded, Aim())
    print_outcomes(outcomes, aim, f"{variant}, {'chosen objects' if objects else tier}")
    print_beside(outcomes, of, aim)
    if out is None and (objects or len(known) < len(chosen) * len(variants)):
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
        "workers": workers,
        "objects": chosen,
    }
    body = figures(outcomes)
    if beside:
        body["beside"] = {name: {"variant": names[name], **figures(its)} for name, its in of.items()}
    write_report(path, facts, **body)


# --- what is to be done -----------------------------------------------------------------------------------------------


def without(settings: ReconstructSettings, name: str) -> ReconstructSettings:
    """`settings` with what the suite's row of the piece `name` says.

    FreeArtError when the suite has no such row, or one that differs before the stage `gaussians`.
    """
    late = set(settings.to_json()) - set(settings_used_by("joint", settings.to_json()))
    pieces = {row.name.removeprefix("ours-"): row.settings for row in ROWS if row.group == "pieces"}
    offered = [piece for piece, its in pieces.items() if set(its) <= late]
    if name not in offered:
        raise FreeArtError(f"--beside has no '{name}'; it has {', '.join(offered)}")
    changed = {group: replace(getattr(settings, group), **values) for group, values in pieces[name].items()}
    return replace(settings, **changed)


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


def key_of(settings: ReconstructSettings, *recording: Any) -> str:
    """SHA-256, hexadecimal, of what an outcome depends on; `recording` decides the bytes of the sequence, as JSON."""
    facts = [PROTOCOL, VERSION, code_digest(), settings.to_json(), *recording]
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


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
    cases: Sequence[Case],
    variants: Mapping[str, ReconstructSettings],
    folder: Path,
    workers: int = 1,
    fresh: bool = False,
    known_only: bool = False,
) -> dict[tuple[str, str], Outcome]:
    """Outcomes by variant and sequence; without `known_only` of all `cases`, by jobs in `folder`."""
    todo = [job for case in cases for job in solving_jobs(case, variants)]
    returned = run_calls(folder, todo, variants, workers, fresh, known_only)
    found = {}
    for case in cases:
        for variant in variants:
            answer = returned.get(f"{variant}/{case.sequence.name}")
            if answer is not None:
                found[variant, case.sequence.name] = _outcome(case, answer)
    return found


def solving_jobs(case: Case, variants: Mapping[str, ReconstructSettings]) -> list[jobs.Job]:
    """A job for each variant of a case, one after the other: the first solves the geometry that they share."""
    made: list[jobs.Job] = []
    for variant, settings in variants.items():
        name = f"{variant}/{case.sequence.name}"
        arguments = {
            "sequence": str(case.sequence.resolve()),
            "truth": str(case.truth.resolve()),
            "result": f"{{folder}}/results/{name}",
            "geometry": f"{{folder}}/geometry/{case.sequence.name}" if len(variants) > 1 else None,
            "settings": f"{{folder}}/settings/{variant}.json",
        }
        needs, key = tuple(job.name for job in made[-1:]), key_of(settings, case.recording)
        made.append(jobs.Job(name, call="benchmarks.solve:solve", arguments=arguments, needs=needs, key=key))
    return made


def run_calls(
    folder: Path,
    todo: Sequence[jobs.Job],
    variants: Mapping[str, ReconstructSettings],
    workers: int = 1,
    fresh: bool = False,
    known_only: bool = False,
) -> dict[str, Any]:
    """Job name to what its call returned, of all finished ones; to {"crash": reason} of those that failed now.

    The settings of each variant are written to `folder`/settings, where the calls read them.
    """
    ledger, digests = Ledger(folder), job_digests(todo)
    crashes: dict[str, str] = {}
    if not known_only:
        for job in todo if fresh else ():
            ledger.forget(job)
        for variant, settings in variants.items():
            atomic.write_json(folder / "settings" / f"{variant}.json", settings.to_json())
        report = jobs.run_jobs(folder, todo, workers, attempts=1, listener=_say_progress)
        crashes = {one.name: one.reason for one in report.failed}
    found: dict[str, Any] = {}
    for job in todo:
        if ledger.finished(job, digests[job.name]):
            found[job.name] = ledger.read_statistics(job, digests[job.name])["returned"]
        elif job.name in crashes:
            found[job.name] = {"crash": f"crashed: {crashes[job.name]}"}
        else:
            say(f"not known: {job.name}")
    return found


def _say_progress(event: str, job: jobs.Job, facts: dict[str, object]) -> None:
    if event != "begins":
        say(f"{job.name}: {event}, {facts.get('line') or ''} {facts.get('seconds', 0):.0f} s")


def _outcome(case: Case, answer: dict[str, Any]) -> Outcome:
    """The outcome of what `solve` returned; a crash costs the penalty."""
    if "crash" not in answer:
        return Outcome(case.object, case.motion, **{**answer, "row": Row.from_json(answer["row"])})
    scorer = SequenceScorer(protocol_named(PROTOCOL), read_sequence(case.sequence), read_truth(case.truth))
    row = scorer.penalised_row("failed", answer["crash"])
    return Outcome(case.object, case.motion, row, {}, None, commit(), machine())


def solve(sequence: str, truth: str, result: str, geometry: str | None, settings: str) -> dict[str, Any]:
    """Solve, export and score a recording, in a process of its own; the fields of `Outcome` that are not the case's."""
    from export.exporter import export_result
    from freeart21.reconstruction import Failure
    from reconstruct.pipeline import reconstruct_folder

    own, place = replace(read_settings(Path(settings)), progress=False), Path(result)
    before_gb = from_geometry(Path(sequence), place, None if geometry is None else Path(geometry), own)
    found = reconstruct_folder(Path(sequence), place, own)
    peak_gb, lacks = max(before_gb, _peak_gb()), ()
    if not isinstance(found, Failure):
        try:
            export_result(place, place / "asset")
        except FreeArtError as error:  # scored from the files then, and marked so
            lacks = (f"no asset: {error}",)
    row = score_sequence(place, Path(sequence), Path(truth), PROTOCOL)
    body = {"row": asdict(replace(row, notes=(*row.notes, *lacks))), "seconds": found.seconds, "peak_gb": peak_gb}
    return {**body, "commit": commit(), "machine": machine()}


def from_geometry(sequence: Path, result: Path, geometry: Path | None, settings: ReconstructSettings) -> float:
    """Keep the stages before `gaussians` beside `result`, to go on from: those beside `geometry`, solved if they lack.

    Returns what they took of memory, GB. Nothing is done without `geometry`, or where the video is hopeless.
    """
    if geometry is None:
        return 0.0
    from freeart21.reconstruction import Failure
    from reconstruct.pipeline import reconstruct_until

    file = reconstruct_until(sequence, geometry, "joint", settings)
    if isinstance(file, Failure):  # found again by the solving itself
        return 0.0
    peak = file.with_name("peak.json")
    took = max(_peak_gb(), checked.read_json(peak)["gb"] if peak.is_file() else 0.0)
    atomic.write_json(peak, {"gb": took})
    atomic.write_bytes(work_folder(result) / file.name, file.read_bytes())
    return took


def _peak_gb() -> float:
    """Of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


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


def pairs(before: Sequence[Outcome], after: Sequence[Outcome]) -> list[tuple[Outcome, Outcome]]:
    """Outcomes of the same sequences, in the order of `after`."""
    of = {o.row.sequence: o for o in before}
    return [(of[o.row.sequence], o) for o in after if o.row.sequence in of]


def worse(before: Row, after: Row) -> list[str]:
    """Of axis and state, what the Gaussians made worse than they may."""
    limits = {"axis": WORSE_AXIS, "state": WORSE_STATE}
    values = {name: (before.values.get(name), after.values.get(name)) for name in limits}
    return [
        name for name, (was, now) in values.items() if was is not None and (now is None or now - was > limits[name])
    ]


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


def print_outcomes(outcomes: list[Outcome], aim: Aim, title: str) -> None:
    """Every object, worst first, and what all of them reach."""
    console = wide_console()
    console.print(_object_table(outcomes, title))
    for outcome in outcomes:
        for text in filter(None, (outcome.row.reason, *outcome.row.notes)):
            console.print(f"  {outcome.row.sequence}: {text}", markup=False, highlight=False)
    console.print(_goal_table(outcomes, aim))
    console.print(_stage_table(outcomes))
    here = machine()
    elsewhere = [o.row.sequence for o in outcomes if o.machine != here]
    if elsewhere:
        console.print(f"  seconds of another machine: {', '.join(elsewhere)}")


def _object_table(outcomes: list[Outcome], title: str) -> Table:
    table = make_table(
        f"{PROTOCOL}, {title}: worst first",
        ("sequence", "motion", "", *SHOWN, "worst", "s", "GB"),
        (),
        texts=("motion", "", "worst"),
    )
    for o in outcomes:
        row, style = o.row, "red" if has_failed(o.row) else None
        status = "FAILED" if has_failed(row) else row.joint_type
        cells = [format_number(row.values.get(id)) for id in SHOWN]
        total = format_number(sum(o.seconds.values()), 0) if o.seconds else "-"
        ends = badness(row)[1], total, format_number(o.peak_gb, 2)
        table.add_row(row.sequence, o.motion, status, *cells, *ends, style=style)
    return table


def _goal_table(outcomes: list[Outcome], aim: Aim) -> Table:
    rules, found, means = protocol_named(PROTOCOL), by_type(outcomes), summary(outcomes)
    table = Table("figure", "of", "mean ± std", "median", "worst", "reach", "paper (other objects)", title="figures")
    for metric, group in [(g.metric, g.group) for g in GOALS if g.statistic == "mean"]:
        value = found.get(group, {}).get(metric)
        if value is None:
            continue
        unit, up = rules.metric(metric).unit(group), metric in MORE_IS_BETTER
        at = {g.statistic: g for g in aim.goals if (g.metric, g.group) == (metric, group)}
        worst_of_all = next((g for g in aim.goals if g.metric == metric and g.statistic == "worst"), None)
        reach = [_reach(value["mean"], at["mean"].reach, up)] if "mean" in at else []
        reach += [f"worst {_reach(value['worst'], worst_of_all.reach, up)}"] if worst_of_all else []
        std = "" if value["std"] is None else f" ± {value['std']:.3f}"
        table.add_row(
            metric if unit == "fraction" else f"{metric}, {unit}",
            group,
            f"{value['mean']:.3f}{std}",
            format_number(value["median"]),
            format_number(value["worst"]),
            "; ".join(reach) or "-",
            at["mean"].paper if "mean" in at else "-",
        )
    count = f"{means['failures']} of {means['n']}"
    table.add_row("failures", "all", count, "", "", _reach(means["failures"], aim.failures), "-")
    fitting = [o.seconds["gaussians"] for o in outcomes if "gaussians" in o.seconds]
    others = [sum(o.seconds.values()) - o.seconds.get("gaussians", 0.0) for o in outcomes if o.seconds]
    published = "420 for 100 frames, RTX 4090"
    for name, took, reach_s, paper in (
        ("seconds without gaussians", others, aim.seconds, published),
        ("seconds of gaussians", fitting, aim.gaussian_seconds, "-"),
    ):
        worst_s = format_number(max(took, default=None), 0)
        table.add_row(name, "all", format_number(_mean(took), 0), "", worst_s, _reach(_mean(took), reach_s), paper)
    mean_gb, most = _mean([o.peak_gb for o in outcomes if o.peak_gb is not None]), means["peak_gb"]
    gigabytes = format_number(mean_gb, 2), "", format_number(most, 2)
    table.add_row("peak, GB", "all", *gigabytes, _reach(most, aim.peak_gb), "-")
    return table


def _reach(value: float | None, reach: float | None, up: bool = False) -> str:
    """What is to be reached, and whether it is."""
    if reach is None:
        return "-"
    met = value is not None and (value >= reach if up else value <= reach)
    return f"{reach:g} {'met' if met else 'missed'}"


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def print_beside(outcomes: Sequence[Outcome], beside: dict[str, list[Outcome]], aim: Aim) -> None:
    """Each variant before > after our own outcomes, object by object; then the means of all."""
    if not beside:
        return
    console = wide_console()
    for name, its in beside.items():
        console.print(beside_table(pairs(its, outcomes), f"{name} > {OURS}: worst first"))
    console.print(_means_table({OURS: list(outcomes), **beside}))
    if aim.no_worse and "no-gaussians" in beside:
        console.print(no_worse_line(pairs(beside["no-gaussians"], outcomes)), markup=False, highlight=False)


def no_worse_line(both: Sequence[tuple[Outcome, Outcome]]) -> str:
    """Whether the Gaussians made an object worse, and which."""
    lines = [f"{now.row.sequence} ({', '.join(reasons)})" for was, now in both if (reasons := worse(was.row, now.row))]
    goal = f"no object worse by more than {WORSE_AXIS:g} deg (axis), {WORSE_STATE:g} (state)"
    return f"{goal}: " + (f"missed by {', '.join(lines)}" if lines else f"met by all {len(both)}")


def beside_table(both: Sequence[tuple[Outcome, Outcome]], title: str) -> Table:
    """A row an object: every figure before > after."""
    table = make_table(title, ("sequence", *SHOWN, "s", "GB", "worse"), (), texts=("worse",))
    for was, now in both:
        cells = [_change(was.row.values.get(id), now.row.values.get(id), DIGITS[id]) for id in SHOWN]
        before_s, after_s = (sum(o.seconds.values()) if o.seconds else None for o in (was, now))
        marks = [f"FAILED {when}" for when, o in (("before", was), ("after", now)) if has_failed(o.row)]
        marks += worse(was.row, now.row)
        style = "red" if has_failed(now.row) else "yellow" if marks else None
        ends = _change(before_s, after_s, 0), _change(was.peak_gb, now.peak_gb, 2), ", ".join(marks)
        table.add_row(now.row.sequence, *cells, *ends, style=style)
    return table


def _means_table(variants: dict[str, list[Outcome]]) -> Table:
    """Means by joint type, a row a variant and type."""
    table = Table("variant", "of", "n", *SHOWN, "failures", "s", title="means")
    for name, outcomes in variants.items():
        for group, found in by_type(outcomes).items():
            its = [o for o in outcomes if group in ("all", o.row.joint_type)]
            cells = [format_number(found[id]["mean"], DIGITS[id]) if id in found else "-" for id in SHOWN]
            totals = [sum(o.seconds.values()) for o in its if o.seconds]
            lost = str(sum(has_failed(o.row) for o in its))
            table.add_row(name, group, str(found["n"]), *cells, lost, format_number(_mean(totals), 0))
    return table


def _change(before: float | None, after: float | None, digits: int) -> str:
    return f"{format_number(before, digits)} > {format_number(after, digits)}"


def _stage_table(outcomes: list[Outcome]) -> Table:
    table = Table("stage", "mean s", "longest s", "of", title="seconds a stage")
    for stage in dict.fromkeys(stage for o in outcomes for stage in o.seconds):
        took = [(o.seconds[stage], o.row.sequence) for o in outcomes if stage in o.seconds]
        longest = max(took)
        table.add_row(stage, f"{sum(t for t, _ in took) / len(took):.1f}", f"{longest[0]:.1f}", longest[1])
    return table


def say(line: str) -> None:
    """A line of progress."""
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    run_cli(main)
