"""The tables of docs/results.md, one a task, from the files that benchmarks write.

    make results                            # solves what is missing, then writes the tables; half a day of two cores
    python -m benchmarks.results --write    # writes the tables from benchmarks/results/*.json
    python -m benchmarks.results --dry-run  # lists what would be solved

Solves every variant of RUNS (`benchmarks.solve`); a finished object is not solved again, so a run that was stopped goes
on. Prints the tables, and writes them where the page has `<!-- table NAME -->` and `<!-- end -->`; no number in them
is typed by hand. What another benchmark measures is in the file that it wrote last.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks import assets, baselines, outside, solve
from benchmarks.common import RESULTS, ROOT, format_number, run_cli
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked

DOCUMENT = ROOT / "docs" / "results.md"
TABLE = re.compile(r"(<!-- table (?P<name>[\w-]+) -->\n).*?(<!-- end -->)", re.S)
METRICS = {
    "axis": "axis, deg",
    "position": "position, %",
    "state": "state, deg or %",
    "miou": "mIoU",
    "chamfer_w": "Chamfer, whole, %",
    "chamfer_m": "Chamfer, moving, %",
    "psnr": "PSNR, dB",
}
"""Metric to its column; sliders have no position."""
TYPES = ("revolute", "prismatic")


@dataclass(frozen=True)
class Run:
    """One variant: all 21 objects, or the first of each category."""

    title: str
    file: str
    """In benchmarks/results."""
    options: dict[str, Any] = field(default_factory=dict)
    """Of `benchmarks.solve.main`."""
    shown: bool = True
    """Whether the table has it."""


def _short(title: str, name: str, changes: dict[str, Any] | None = None, shown: bool = True, **options: Any) -> Run:
    """A row of the first object of each category in 100 frames, geometry alone."""
    settings = solve.with_changes({**(changes or {}), **solve.PIECES["no-gaussians"]})
    return Run(title, f"reconstruct-{name}.json", {"frames": 100, "settings": settings, **options}, shown)


CLEAN = Run("ours, all 21, 300 frames, with Gaussians", "reconstruct.json", {"tier": "full"})
RUNS = (
    CLEAN,
    _short("ours, 7, 100 frames, geometry alone", "clean"),
    *(
        _short(f"the same, {what}", sensor, sensor=sensor)
        for sensor, what in {
            "noise2": "2 % of noise on the depth",
            "tof": "time of flight",
            "phone": "a phone's LiDAR",
            "blur": "motion blur",
            "hand": "a hand holds it",
        }.items()
    ),
    _short("the same, the base stands, the camera moves", "static_base", motion="static_base"),
    _short("the same, the paper's segmentation", "paper", method="paper"),
    *(
        _short(f"ours, {name}", f"ours-{name}", changes, shown=False)
        for name, changes in solve.PIECES.items()
        if "gaussians" not in changes
    ),
)


def read(file: str) -> dict[str, Any]:
    """A report of benchmarks/results."""
    return dict(checked.read_json(RESULTS / file))


def describe(*files: str) -> str:
    """A line below a table: each file with its commit, and day where it states one; the machines."""
    found, machines = [], {}
    for file in files:
        report = read(file)
        found.append(f"`{file}` {report['commit'][:7]}" + (f" ({report['date']})" if "date" in report else ""))
        machines[f"{report['machine']['processor']}, {report['machine']['cores']} cores"] = None
    return f"*Commits: {', '.join(found)}. Machine: {'; '.join(machines)}.*\n"


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    frame = pd.DataFrame(rows, columns=list(head))
    lines = [list(head), ["---"] * len(head), *frame.astype(str).to_numpy().tolist()]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def figures_of(found: dict[str, Any]) -> list[str]:
    """Mean of every metric, '-' where there is none."""
    means = {metric: found[metric]["mean"] for metric in METRICS if found.get(metric)}
    return [format_number(means.get(metric), solve.DIGITS[metric]) for metric in METRICS]


def write_solver() -> str:
    """Ours, its inputs varied, and the baselines, by joint type: means by strict-2."""
    rows, files = [], []
    for run in RUNS:
        if run.shown and (RESULTS / run.file).is_file():
            report = read(run.file)
            files.append(run.file)
            for kind in TYPES:
                found = report["by_type"].get(kind, {})
                its = [row for row in report["rows"] if (row.get("position") is None) == (kind == "prismatic")]
                lost = sum(bool(row.get("failed", row["status"] != "ok")) for row in its)
                rows.append([run.title, kind, f"{lost} of {len(its)}", *figures_of(found)])
    for name, its in read(baselines.FILE)["methods"].items():
        given = f", given {', '.join(its['privileged'])}" if its["privileged"] else ""
        for kind in TYPES:
            group = its["scores"]["strict-2"]["by_type"][kind]
            lost = f"{group['failures']} of {group['sequences']}"
            rows.append([f"{name}, all 21{given}", kind, lost, *figures_of(group["statistics"])])
    for title, value_of in (("goal", lambda goal: f"{goal.reach:g}"), ("FreeArtGS, its objects", lambda g: g.paper)):
        for kind in TYPES:
            goals = {g.metric: value_of(g) for g in solve.GOALS if g.group in (kind, "all") and g.statistic == "mean"}
            rows.append([title, kind, "", *(goals.get(metric, "-") for metric in METRICS)])
    return markdown(["answers", "joint", "failures", *METRICS.values()], rows) + "\n" + describe(*files, baselines.FILE)


def write_assets() -> str:
    """How many assets reach each goal (`benchmarks.assets.GOALS`), the goal that most miss first; those missed bold."""
    own, others = read(assets.FILE)["summary"], read(outside.FILE)["summary"]
    rows = []
    for goal in sorted(assets.GOALS, key=lambda goal: own[goal.column]["reached"] / own[goal.column]["of"]):
        bound = f"{'at least' if goal.at_least else 'at most'} {goal.bound:g}"
        cells = []
        for summary in (own, others):
            its = summary.get(goal.column)
            if not its or its["median"] is None:  # it concerns none of them
                cells += ["-"] * 3
                continue
            reached = f"{its['reached']} of {its['of']}"
            cells += [
                reached if its["reached"] == its["of"] else f"**{reached}**",
                f"{its['median']:.3g}",
                f"{its['worst']:.3g}",
            ]
        rows.append([goal.says, bound, *cells])
    head = ["", "goal", "the 21", "median", "worst", "strangers' objects", "median", "worst"]
    return markdown(head, rows) + "\n" + describe(assets.FILE, outside.FILE)


def write_score() -> str:
    """What scoring takes, and how many dishonest answers gain by it."""
    score, gaming = read("score.json"), read("gaming.json")
    its = score["summary"]
    rows = [
        ["sequences scored", str(its["sequences"])],
        ["s, on two cores", format_number(its["wall_s"], 0)],
        ["processor s a sequence", format_number(its["cpu_s_a_row"], 1)],
        ["memory of all processes, GB", format_number(its["peak_bytes"] / 1e9, 2)],
    ]
    for protocol, cheats in gaming["wins"].items():
        rows.append([f"cheats that gain by {protocol}", f"{len(cheats)} of {gaming['settings']['cheats']}"])
    return markdown(["", ""], rows) + "\n" + describe("score.json", "gaming.json")


def write_gap() -> str:
    """What `gap` finds: in the hidden world, in real recordings, and beside other methods."""
    rows = []
    for name, figure in read("hidden_gap.json")["figures"].items():
        if figure["goal"]:
            rows.append([f"hidden world: {name}", f"{figure['hits']} of {figure['of']}", figure["goal"]])
    real = read("real_gap.json")["summary"]
    for grade in ("right", "in part", "silent", "wrong"):
        rows.append([f"real recordings: {grade}", f"{real[grade]} of {real['recordings']}", ""])
    for way, its in read("gap_peers.json")["ratios"]["gap"].items():
        rows.append([f"error over that of {way}, {its['cases']} cases", format_number(its["ratio"], 2), ""])
    return markdown(["", "`gap`", "goal"], rows) + "\n" + describe("hidden_gap.json", "real_gap.json", "gap_peers.json")


TABLES: dict[str, Callable[[], str]] = {
    "solver": write_solver,
    "assets": write_assets,
    "score": write_score,
    "gap": write_gap,
}


def fill(text: str) -> str:
    """The text of a document with every table of TABLES written anew."""
    return TABLE.sub(lambda found: f"{found[1]}{TABLES[found['name']]()}{found[3]}" if found["name"] in TABLES
                     else found[0], text)  # fmt: skip


def main(
    data: Path = ROOT / "out" / "freeart21-v1",
    workers: int = 1,
    only: tuple[str, ...] = (),
    write: bool = False,
    dry_run: bool = False,
) -> None:
    """Solve all variants, then print the tables and write them into the page.

    Args:
        data: Data folder of the public split; what it lacks is recorded.
        workers: Objects that are solved side by side.
        only: Some of the files, without .json: nothing but these is solved.
        write: Solve nothing.
        dry_run: List the variants and exit.
    """
    files = [run.file.removesuffix(".json") for run in RUNS]
    if unknown := [name for name in only if name not in files]:
        raise FreeArtError(f"--only: no table '{unknown[0]}'; there are {', '.join(files)}")
    for run in [run for run, name in zip(RUNS, files, strict=True) if not only or name in only]:
        if dry_run:
            print(f"{run.title}: benchmarks/results/{run.file}")
        elif not write:
            solve.main(data=data, workers=workers, out=RESULTS / run.file, **run.options)
    if dry_run:
        return
    for name, make in TABLES.items():
        print(f"\n{name}\n\n{make()}")
    text = DOCUMENT.read_text("utf-8")
    if (filled := fill(text)) != text:
        atomic.write_bytes(DOCUMENT, filled.encode())
        print(DOCUMENT)


if __name__ == "__main__":
    run_cli(main)
