"""What the public checker `simcheck` says of the objects' own shapes, exported.

    .venv/bin/python -m benchmarks.simcheck --data data/v1

exports every sequence's truth as if it were an answer, checks it by `freeart21 check-asset --simcheck` (extra
`simcheck`) with MuJoCo beside, and writes benchmarks/results/simcheck.json: a row an object, what failed and why, what
it warned of, seconds, commit, machine. Assets are kept in --work, keyed by the exporter's code and the truth, rows by
the checker's code and the asset: a run that was stopped goes on.
"""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.common import RESULTS, ROOT, code_of, digest_of, make_table, run_cli, wide_console, write_report
from export.check.checking import check
from export.exporter import ExportSettings, export_result
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset import read_asset
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.truth import read_truth
from freeart21.files.urdf import parse_urdf
from leaderboard.reference import truth_answer

SCHEMA = "freeart21/benchmark-simcheck/1"
DENSITY = 1000.0
"""kg/m^3, of all exports here, as in benchmarks.export."""
ASIDE = ("check", "maniskill")
"""Folders of `export` that make no asset."""


def main(
    data: Path = ROOT / "data" / "v1",
    sequences: tuple[str, ...] = (),
    engines: tuple[str, ...] = ("mujoco",),
    limit_s: float = 900.0,
    work: Path = ROOT / "out" / "simcheck",
    out: Path | None = None,
) -> None:
    """Run the public checker over exported truths.

    Args:
        data: The data folder (`freeart21 record --split public --out data/v1`).
        sequences: These alone.
        engines: Engines of check-asset that try each asset, too.
        limit_s: Seconds that simcheck may take of an asset: more where the machine has other work.
        work: Where assets and rows are kept.
        out: The JSON file. When not given: benchmarks/results/simcheck.json, and only when no sequences are named.
    """
    benchmark, console = read_benchmark(data), wide_console()
    rows = []
    for name in benchmark.select_sequences(sequences or None):
        rows.append(_row(name, benchmark, engines, work, limit_s))
        console.print(f"{name}: {_describe(rows[-1])}", highlight=False)
    _print(console, rows)
    if out is None and sequences:
        return
    write_report(
        out or RESULTS / "simcheck.json",
        {
            "density": DENSITY,
            "video": False,
            "engines": list(engines),
            "limit_s": limit_s,
            "versions": _versions(),
        },
        summary={
            "objects": len(rows),
            "exported": sum(row["status"] == "ok" for row in rows),
            "without_error": sum(row["status"] == "ok" and not row["failed"] for row in rows),
            "without_warning": sum(row["status"] == "ok" and not (row["failed"] or row["warned"]) for row in rows),
        },
        rows=rows,
    )


def _row(name: str, benchmark: Benchmark, engines: tuple[str, ...], work: Path, limit_s: float) -> dict[str, Any]:
    """Export one and check it, unless that is known."""
    asset, row = work / name, {"object": name, "status": "ok"}
    try:
        _export(benchmark.truth(name), asset, work / f"{name}.asset.json")
    except FreeArtError as error:
        return row | {"status": str(error).replace(str(work), "WORK")}
    row_file = work / f"{name}.row.json"
    key = digest_of(engines, _versions(), files=[*code_of("export/check"), *_files(asset)])
    if row_file.is_file() and (known := checked.read_json(row_file, SCHEMA)).get("key") == key:
        return row | dict(known["row"])
    report = check(asset, engines, simcheck=True, limit_s=limit_s)
    public = [r for r in report.rows if r.engine.startswith("simcheck")]
    found = {
        "pieces": len(parse_urdf(read_asset(asset).urdf).findall("link/collision")),
        "passed": sum(r.verdict == "pass" and not r.reason.startswith("warn: ") for r in public),
        "skipped": sum(r.verdict == "skip" for r in public),
        "failed": [f"{r.rule} ({r.engine}): {r.reason}" for r in public if r in report.not_passed],
        "warned": [f"{r.rule} ({r.engine}): {r.reason}" for r in public if r.reason.startswith("warn: ")],
        "seconds": report.seconds["simcheck"],
        "own_failed": [f"{r.rule} ({r.engine}): {r.reason}" for r in report.not_passed if r not in public],
    }
    if not found["failed"]:  # what failed, for lack of time perhaps, is asked again
        atomic.write_json(row_file, {"schema": SCHEMA, "key": key, "row": found})
    return row | found


def _export(truth: Path, asset: Path, export_file: Path) -> None:
    """The asset, unless that is there."""
    code = [f for f in code_of("export") if f.relative_to(ROOT / "export").parts[0] not in ASIDE]
    key = digest_of(DENSITY, files=[*code, *_files(truth / "parts"), *_files(truth, "*.json")])
    if export_file.is_file() and checked.read_json(export_file, SCHEMA).get("key") == key and asset.is_dir():
        return
    export_file.unlink(missing_ok=True)
    export_result(truth_answer(read_truth(truth)), asset, ExportSettings(density=DENSITY))
    atomic.write_json(export_file, {"schema": SCHEMA, "key": key})


def _files(folder: Path, pattern: str = "**/*") -> list[Path]:
    return sorted(path for path in folder.glob(pattern) if path.is_file())


def _versions() -> dict[str, str]:
    """Of simcheck, and of the engines that it uses where they are installed."""
    found = {}
    for name in ("simcheck", "mujoco", "pybullet"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    if found["simcheck"] == "not installed":
        raise FreeArtError("simcheck is not installed: pip install 'freeart21[simcheck]'")
    return found


def _describe(row: dict[str, Any]) -> str:
    if row["status"] != "ok":
        return str(row["status"])
    return f"{len(row['failed'])} failed, {len(row['warned'])} warnings, {row['seconds']:.0f} s"


def _print(console: Console, rows: list[dict[str, Any]]) -> None:
    columns = ("passed", "skipped", "failed", "warned", "pieces", "seconds")
    good = [row for row in rows if row["status"] == "ok"]
    good.sort(key=lambda row: (-len(row["failed"]), -len(row["warned"]), -row["seconds"]))
    cells = [[row["object"], *(_figure(row[column]) for column in columns)] for row in good]
    console.print(make_table("simcheck, worst first", ("object", *columns), cells))
    for row in rows:
        for reason in [row["status"]] if row["status"] != "ok" else row["failed"]:
            console.print(f"{row['object']}: {reason}", highlight=False)


def _figure(value: list[str] | float) -> str:
    return str(len(value)) if isinstance(value, list) else f"{value:.0f}"


if __name__ == "__main__":
    run_cli(main)
