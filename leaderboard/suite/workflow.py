"""Runs a suite: plan and forecast its jobs, run them, collect the tables, check the reference rows."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import freeart21
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import read_benchmark
from freeart21.files.hashes import file_sha256
from freeart21.files.places import SUITE, check_place
from freeart21.jobs import Failed, Job, run_jobs
from freeart21.jobs.ledger import Ledger
from freeart21.jobs.run import Listener, unfinished_jobs
from leaderboard.protocols import DEFAULT, protocol_named
from leaderboard.suite.plan import Plan, plan_suite
from leaderboard.suite.rates import read_rates, update_rates, write_rates
from leaderboard.suite.rows import SuiteRow, choose_rows

SCHEMA = "freeart21/suite/1"
MOST_RIGHT_BY_CHANCE = 0.75
"""Highest mean mIoU of the static and random reference rows."""


@dataclass(frozen=True)
class Suite:
    """The open work of a suite in a folder, with its forecast cost."""

    data: Path
    out: Path
    plan: Plan
    todo: list[Job]
    seconds: float
    """Of one worker, for the jobs `todo`."""
    bytes: float
    """Written to the disk by the jobs `todo`."""
    free_bytes: int
    """Free on the disk."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a suite."""

    tables: dict[str, dict[str, list[dict[str, Any]]]]
    """Protocol to row to its statistics by joint type (`rows.Summary` as JSON)."""
    failed: tuple[Failed, ...]
    """Jobs that failed."""
    objections: tuple[str, ...]
    """Faults of the scoring that the reference rows reveal."""


def prepare(
    data: Path,
    out: Path,
    rows: Sequence[str] = (),
    sequences: Sequence[str] | None = None,
    protocols: Sequence[str] = (DEFAULT,),
) -> Suite:
    """The plan of a suite in the folder `out`; writes nothing.

    Raises FreeArtError when a row, sequence or protocol is unknown, the data folder is broken, or `out` is neither new
    nor a suite over the same data.
    """
    chosen = choose_rows(rows)
    names = list(dict.fromkeys(protocol_named(name).name for name in protocols))
    benchmark = read_benchmark(data)
    check_place(out, SUITE, (data,))
    facts = _describe_data(data)
    if (out / SUITE.marker).is_file():
        before = checked.read_json(out / SUITE.marker, SCHEMA).get("benchmark")
        if before != facts["benchmark"]:
            raise FreeArtError(f"{out} is a suite over other data ({before}); choose another place")
    own_rates = out / "rates.json"
    rates = read_rates(own_rates) if own_rates.is_file() else read_rates()
    plan = plan_suite(benchmark, chosen, benchmark.select_sequences(sequences), tuple(names), rates)
    todo = unfinished_jobs(out, plan.jobs)
    existing = next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.is_dir())
    return Suite(
        Path(data),
        out,
        plan,
        todo,
        sum(job.seconds for job in todo),
        plan.disk_bytes(todo),
        shutil.disk_usage(existing).free,
    )


def run_suite(
    suite: Suite,
    workers: int = 1,
    executor: str = "local",
    listener: Listener | None = None,
) -> Outcome:
    """Run the open jobs of `suite`. A call that was killed can be repeated: finished jobs are not run again.

    Raises FreeArtError when the disk has too little space, and as `freeart21.jobs.run_jobs`.
    """
    plan, out = suite.plan, suite.out
    if suite.bytes > suite.free_bytes:
        raise FreeArtError(
            f"{out} will take about {suite.bytes / 1e9:.1f} GB, and the disk has {suite.free_bytes / 1e9:.1f} GB free; "
            "choose fewer rows, or another place"
        )
    atomic.write_json(out / SUITE.marker, {"schema": SCHEMA, **_describe_data(suite.data)})
    for row in plan.rows:
        if row.settings:
            atomic.write_json(out / "settings" / f"{row.name}.json", row.settings)
    report = run_jobs(out, plan.jobs, workers, executor, listener=listener)
    failed = {f.name for f in report.failed}
    ledger = Ledger(out)
    paths = {job.name: ledger.path("statistics", job.name) for job in plan.jobs}
    statistics = {name: checked.read_json(path) for name, path in paths.items() if path.is_file()}
    finished = [(name.split("/")[0], float(facts["seconds"]), plan.frames[name]) for name, facts in statistics.items()]
    write_rates(out / "rates.json", update_rates(read_rates(), finished, f"this suite, {executor}, {workers} workers"))
    tables: dict[str, dict[str, list[dict[str, Any]]]] = {}
    objections = []
    for protocol in plan.protocols:
        for row in plan.rows:
            name = f"score/{row.name}/{protocol}"
            if name in statistics and name not in failed:
                returned = statistics[name]["returned"]
                tables.setdefault(protocol, {})[row.name] = returned["summaries"]
                objections += _find_objections(row, protocol, returned)
    return Outcome(tables, report.failed, tuple(objections))


def _find_objections(row: SuiteRow, protocol: str, returned: dict[str, Any]) -> list[str]:
    """Faults of the scoring: the truth is not perfect, or the static or random row scores too well."""
    if not protocol.startswith("strict") or row.reference is None or row.exported:
        return []
    if row.reference == "truth":
        lines = returned["imperfect"]
        more = f" (and {len(lines) - 1} more)" if len(lines) > 1 else ""
        return [f"the truth does not score perfect by {protocol}: {lines[0]}{more}"] if lines else []
    (total,) = (summary for summary in returned["summaries"] if summary["group"] == "all")
    miou = total["statistics"]["miou"]["mean"]
    if miou <= MOST_RIGHT_BY_CHANCE:
        return []
    return [
        f"the row '{row.name}' has a mean mIoU of {miou:.2f} by {protocol}, expected {MOST_RIGHT_BY_CHANCE} at most"
    ]


def _describe_data(data: Path) -> dict[str, Any]:
    benchmark = read_benchmark(data)
    return {
        "freeart21": freeart21.__version__,
        "benchmark": f"{benchmark.name} {benchmark.version}, {file_sha256(benchmark.folder / 'benchmark.json')[:16]}",
        "data": str(Path(data).resolve()),
    }


def print_rows(rows: Sequence[SuiteRow]) -> None:
    """Print a line per row."""
    for row in rows:
        print(f"{row.name:28} {row.group:13} {row.what}")
