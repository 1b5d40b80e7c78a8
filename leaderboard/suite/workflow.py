"""The suite from a data folder to its table: plan, forecast, run, check the reference rows."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import freeart21
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import file_sha256, read_benchmark
from freeart21.files.places import SUITE, check_place
from freeart21.jobs import ATTEMPTS, Failed, Job, run_jobs
from freeart21.jobs.ledger import Ledger
from freeart21.jobs.run import Listener, unfinished_jobs
from leaderboard.protocols import DEFAULT, protocol_named
from leaderboard.suite.plan import Plan, disk_bytes, plan_suite
from leaderboard.suite.rates import read_rates, update_rates, write_rates
from leaderboard.suite.rows import SuiteRow, chosen_rows

SCHEMA = "freeart21/suite/1"
MOST_RIGHT_BY_CHANCE = 0.75
"""Mean mIoU that an answer in which nothing moves, or all is drawn, stays below."""


@dataclass(frozen=True)
class Suite:
    """What is to be done in a folder, and what it will cost."""

    data: Path
    out: Path
    plan: Plan
    todo: list[Job]
    seconds: float
    """Of one worker, for what is to be done."""
    bytes: float
    """That it will leave on the disk."""
    free_bytes: int
    """That the disk has."""


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    tables: dict[str, dict[str, list[dict[str, Any]]]]
    """Protocol to row to its statistics by joint type (`rows.Summary` as JSON)."""
    failed: tuple[Failed, ...]
    """Jobs that are not finished."""
    objections: tuple[str, ...]
    """What the reference rows show of the scoring that must not be."""


def prepare(
    data: Path,
    out: Path,
    rows: Sequence[str] = (),
    sequences: Sequence[str] | None = None,
    protocols: Sequence[str] = (DEFAULT,),
) -> Suite:
    """What a suite in the folder `out` would do; nothing is written.

    Raises FreeArtError when a row, sequence or protocol is unknown, the data folder is none, or `out` is not a new
    folder or a suite over the same data.
    """
    chosen = chosen_rows(rows)
    names = list(dict.fromkeys(protocol_named(name).name for name in protocols))
    benchmark = read_benchmark(data)
    check_place(out, SUITE, (data,))
    facts = _facts(data, out)
    if (out / SUITE.marker).is_file():
        before = checked.read_json(out / SUITE.marker, SCHEMA).get("benchmark")
        if before != facts["benchmark"]:
            raise FreeArtError(f"{out} is a suite over other data ({before}); choose another place")
    measured = out / "rates.json"
    rates = read_rates(measured) if measured.is_file() else read_rates()
    plan = plan_suite(benchmark, chosen, benchmark.select_sequences(sequences), tuple(names), rates)
    todo = unfinished_jobs(out, plan.jobs)
    above = next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.is_dir())
    return Suite(
        Path(data),
        out,
        plan,
        todo,
        sum(job.seconds for job in todo),
        disk_bytes(plan, todo, rates),
        shutil.disk_usage(above).free,
    )


def run_suite(
    suite: Suite,
    workers: int = 1,
    executor: str = "local",
    attempts: int = ATTEMPTS,
    listener: Listener | None = None,
) -> Outcome:
    """Do what is to be done of `suite`; what was done before is kept. May be killed at any moment, and goes on.

    Raises FreeArtError when the disk has not the room, or as `freeart21.jobs.run_jobs`.
    """
    plan, out = suite.plan, suite.out
    if suite.bytes > suite.free_bytes:
        raise FreeArtError(
            f"{out} will take about {suite.bytes / 1e9:.1f} GB, and the disk has {suite.free_bytes / 1e9:.1f} GB free; "
            "choose fewer rows, or another place"
        )
    atomic.write_json(out / SUITE.marker, {"schema": SCHEMA, **_facts(suite.data, out)})
    for row in plan.rows:
        if row.settings:
            atomic.write_json(out / "settings" / f"{row.name}.json", row.settings)
    report = run_jobs(out, plan.jobs, workers, executor, attempts, listener)
    failed = {f.name for f in report.failed}
    ledger = Ledger(out)
    said = {job.name: checked.read_json(path) for job in plan.jobs if (path := _statistics(ledger, job)).is_file()}
    taken = [(name.split("/")[0], float(facts["seconds"]), plan.frames[name]) for name, facts in said.items()]
    write_rates(out / "rates.json", update_rates(read_rates(), taken, f"this suite, {executor}, {workers} workers"))
    tables: dict[str, dict[str, list[dict[str, Any]]]] = {}
    objections = []
    for protocol in plan.protocols:
        for row in plan.rows:
            name = f"score/{row.name}/{protocol}"
            if name in said and name not in failed:
                returned = said[name]["returned"]
                tables.setdefault(protocol, {})[row.name] = returned["summaries"]
                objections += _objections(row, protocol, returned)
    return Outcome(tables, report.failed, tuple(objections))


def _objections(row: SuiteRow, protocol: str, returned: dict[str, Any]) -> list[str]:
    """What a reference row shows that must not be: a truth that is not perfect, luck that scores."""
    if not protocol.startswith("strict") or row.reference is None or row.exported:
        return []
    if row.reference == "truth":
        found = returned["imperfect"]
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        return [f"the truth does not score perfect by {protocol}: {found[0]}{more}"] if found else []
    (everything,) = (summary for summary in returned["summaries"] if summary["group"] == "all")
    right = everything["statistics"]["miou"]["mean"]
    if right <= MOST_RIGHT_BY_CHANCE:
        return []
    return [
        f"the row '{row.name}' has a mean mIoU of {right:.2f} by {protocol}, expected {MOST_RIGHT_BY_CHANCE} at most"
    ]


def _statistics(ledger: Ledger, job: Job) -> Path:
    return ledger.path("statistics", job.name)


def _facts(data: Path, out: Path) -> dict[str, Any]:
    benchmark = read_benchmark(data)
    return {
        "freeart21": freeart21.__version__,
        "benchmark": f"{benchmark.name} {benchmark.version}, {file_sha256(benchmark.folder / 'benchmark.json')[:16]}",
        "data": str(Path(data).resolve()),
    }


def print_rows(rows: Sequence[SuiteRow], say: Callable[[str], None] = print) -> None:
    """A line a row."""
    for row in rows:
        say(f"{row.name:28} {row.group:13} {row.what}")
