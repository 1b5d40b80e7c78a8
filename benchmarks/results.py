"""All tables of the solver: measured by one version with one command, and written into the documents from the files.

    make results                            # solves what is missing, then writes the tables; half a day of two cores
    python -m benchmarks.results --write    # writes the tables from benchmarks/results/*.json
    python -m benchmarks.results --dry-run  # lists what would be solved

Solves every variant of RUNS (`benchmarks.solve`); a finished object is not solved again, so a run that was stopped goes
on. A table stands between `<!-- table NAME -->` and `<!-- end -->`; no number in it is typed by hand. A row is marked
"old" where what the solver does has changed since.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import assets, outside_assets, priors, real_video, solve
from benchmarks.baselines import METHODS as METHOD_NAMES
from benchmarks.common import RESULTS, ROOT, run_cli, write_report
from benchmarks.freshness import is_current, read_commit
from benchmarks.scale import cost_table
from freeart21 import catalog
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from leaderboard.suite.rates import MEASURED, read_rates, write_rates
from leaderboard.suite.rows import ROWS
from leaderboard.suite.workflow import prepare, run_suite
from reconstruct.settings import ReconstructSettings

DOCUMENTS = (ROOT / "README.md", *(ROOT / "docs" / f"{name}.md" for name in ("results", "scale", "priors")))
TABLE = re.compile(r"(<!-- table (?P<name>[\w-]+) -->\n).*?(<!-- end -->)", re.S)
ASSET_COLUMNS = {
    "failed_rules": "rules failed",
    "mass_pc": "mass, %",
    "iou": "voxel IoU",
    "supposed": "supposed, share",
    "seen_off_pc": "seen faces off, %",
    "supposed_off_pc": "supposed faces off, %",
    "supposed_psnr": "views of supposed faces, dB",
    "visual_deep_mm": "visual in each other, mm",
    "contact_worst_mm": "contact off, mm",
    "shapes": "shapes",
    "speed": "speed",
    "cpu_s": "export, s",
    "ball": "ball",
}
"""Of `benchmarks.assets`."""
PIECES = ("no-gaussians", "no-end-to-end", "no-blended-rendering")


@dataclass(frozen=True)
class Run:
    """One variant: all 21 objects, or the first of each category."""

    title: str
    file: str
    """In benchmarks/results."""
    options: dict[str, Any] = field(default_factory=dict)
    """Of `benchmarks.solve.main`."""


def _with(changes: dict[str, Any]) -> ReconstructSettings:
    """The default settings with those of a row of the suite."""
    base = ReconstructSettings()
    return replace(base, **{group: replace(getattr(base, group), **values) for group, values in changes.items()})


GEOMETRY = {"gaussians": {"refine": False}}


def _short(title: str, name: str, settings: ReconstructSettings | None = None, **options: Any) -> Run:
    """A row of the first object of each category in 100 frames, geometry alone: what Gaussians add, others show."""
    options = {"frames": 100, "settings": settings or _with(GEOMETRY), **options}
    return Run(title, f"reconstruct-{name}.json", options)


def _paper(**paper: bool) -> ReconstructSettings:
    return replace(_with({"paper": paper, **GEOMETRY}), segmentation="paper")


CLEAN = Run("clean, all 21", "reconstruct.json", {"tier": "full", "beside": ("no-gaussians",)})
PAPER = _short("the paper's segmentation", "paper", _paper())
RUNS = (
    CLEAN,
    _short("clean", "clean"),
    _short("2 % of noise on the depth", "noise2", sensor="noise2"),
    _short("time of flight", "tof", sensor="tof"),
    _short("a phone's LiDAR", "phone", sensor="phone"),
    _short("motion blur", "blur", sensor="blur"),
    _short("a hand holds it", "hand", sensor="hand"),
    _short("the base stands, the camera moves", "static_base", motion="static_base"),
    PAPER,
    _short("w/o Smooth Loss", "paper-no-smooth", _paper(use_smoothness=False)),
    _short("w/o Init Loss", "paper-no-init", _paper(use_init=False)),
    _short("2 % of noise, with Gaussians", "noise2-gaussians", ReconstructSettings(), sensor="noise2", beside=PIECES),
    *(
        _short(row.what, row.name, _with({**row.settings, **GEOMETRY}))
        for row in ROWS
        if row.group == "pieces" and row.name.removeprefix("ours-") not in PIECES
    ),
)
RATED = {"reconstruct": CLEAN, "reconstruct-paper": PAPER}
"""Kind of a suite's job to the run that says what its frames take."""
REFERENCES = "references.json"
"""Answers that nobody solved, on all 21: the truth, the truth as an asset, nothing moves, random numbers."""
BASELINES = "baselines.json"
"""Of `benchmarks.baselines`."""
REAL_VIDEO = "real_video.json"
"""Of `benchmarks.real_video`."""
_MATCH_COLUMNS = {"given": ".0f", "right": ".2f", "found": ".2f"}
STRICT_3 = (
    ("depth_median", "depth, median, %", 2),
    ("depth_95", "depth, 95 %, %", 1),
    ("silhouette", "silhouette IoU", 2),
    ("view_iou", "view IoU", 2),
)
"""Metric, column and digits of what strict-3 adds."""
METRICS = {
    "axis": ("axis, deg", 2),
    "position": ("position, %", 2),
    "state": ("state, deg or %", 2),
    "miou": ("mIoU", 3),
    "chamfer_w": ("Chamfer, whole, %", 2),
    "chamfer_m": ("Chamfer, moving, %", 2),
    "psnr": ("PSNR, dB", 1),
}
"""Metric to its column and digits; sliders have no position."""


def _cell(value: float | None, digits: int, spread: float | None = None) -> str:
    return "-" if value is None else f"{value:.{digits}f}" + ("" if spread is None else f" ± {spread:.{digits}f}")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)) + "\n"


def _stamp(file: str, folder: str, *code: str) -> str:
    """The line under a table that `benchmarks.freshness` reads; the solver's code when none is named."""
    commit, code = read_commit(RESULTS / file), code or ("reconstruct",)
    state = "current" if is_current(commit, code) else "old"
    return f"*Measured at `{commit}`, of {', '.join(f'`{c}`' for c in code)} ([{file}]({folder}/{file})): {state}.*"


def _stamps(files: Sequence[str], folder: str) -> str:
    return "\n" + "\\\n".join(_stamp(file, folder) for file in files) + "\n"


def write_objects(folder: str) -> str:
    """The 21 objects, worst mIoU first."""
    report = checked.read_json(RESULTS / CLEAN.file)
    rows = [
        [
            row["object"],
            *(_cell(row.get(metric), digits) for metric, (_, digits) in METRICS.items()),
            _cell(row.get("pose_rotation"), 2),
            _cell(row.get("pose_moving_rotation"), 2),
            _cell(row.get("seconds_total"), 0),
            _cell(row.get("peak_gb"), 1),
        ]
        for row in sorted(report["rows"], key=lambda row: row["miou"])
    ]
    head = ["object", *(column for column, _ in METRICS.values()), "pose, deg", "pose, moving, deg", "s", "GB"]
    return _table(head, rows) + _stamps([CLEAN.file], folder)


def write_types(folder: str) -> str:
    """Every variant by joint type as in the paper: means and standard deviations over objects."""
    rows, files, missing = [], [], []
    for run in RUNS:
        if not (RESULTS / run.file).is_file():
            missing.append(run.title)
            continue
        report = checked.read_json(RESULTS / run.file)
        files.append(run.file)
        about = f"{_extent(report)}, {report['settings'].get('solver', '?')}, {report['settings']['protocol']}"
        beside = {f"{run.title}, {name}": its for name, its in report.get("beside", {}).items()}
        for title, its in {run.title: report, **beside}.items():
            for kind in ("revolute", "prismatic"):
                found = its["by_type"].get(kind, {})
                cells = [_mean(found.get(m), digits) for m, (_, digits) in METRICS.items()]
                failures = sum(_has_failed(row) for row in its["rows"] if _is_kind(row, kind))
                rows.append([title, kind, f"{failures} of {found.get('n', 0)}", *cells, about])
    if (RESULTS / REFERENCES).is_file():
        for title, groups in checked.read_json(RESULTS / REFERENCES)["rows"].items():
            for kind in ("revolute", "prismatic"):
                cells = [_mean(groups[kind]["statistics"].get(m), digits) for m, (_, digits) in METRICS.items()]
                failures = f"{groups[kind]['failures']} of {groups[kind]['sequences']}"
                rows.append([title, kind, failures, *cells, "300 frames, -, strict-2"])
    else:
        missing.append("the truth, nothing moves, random numbers")
    head = ["video", "joint", "failures", *(column for column, _ in METRICS.values()), "of, solver, protocol"]
    gaps = f"\nNot measured yet: {'; '.join(missing)}.\n" if missing else ""
    return _table(head, rows) + gaps + _stamps(files, folder)


def _extent(report: dict[str, Any]) -> str:
    """How many frames a report is of, and whether geometry alone."""
    alone = not report["settings"]["solver_settings"].get("gaussians", {}).get("refine", False)
    return f"{report['settings']['frames']} frames" + (" by geometry alone" if alone else "")


def _mean(statistic: dict[str, Any] | None, digits: int) -> str:
    return "-" if statistic is None else _cell(statistic["mean"], digits, statistic["std"])


def _has_failed(row: dict[str, Any]) -> bool:
    return bool(row.get("failed", row["status"] != "ok"))


def _is_kind(row: dict[str, Any], kind: str) -> bool:
    """Whether a row is of this joint type; sliders have no position."""
    return (row.get("position") is None) == (kind == "prismatic")


def write_categories(folder: str) -> str:
    """The 21 objects by category."""
    report = checked.read_json(RESULTS / CLEAN.file)
    found: dict[str, list[dict[str, Any]]] = {}
    for row in report["rows"]:
        found.setdefault(catalog.find(row["object"]).category, []).append(row)
    rows = []
    for name, its in found.items():
        values = {m: [row[m] for row in its if row.get(m) is not None] for m in METRICS}
        cells = [
            _cell(float(np.mean(values[m])), digits, float(np.std(values[m], ddof=1)))
            if len(values[m]) > 1
            else _cell(next(iter(values[m]), None), digits)
            for m, (_, digits) in METRICS.items()
        ]
        rows.append([name, str(len(its)), *cells])
    head = ["category", "objects", *(column for column, _ in METRICS.values())]
    return _table(head, rows) + _stamps([CLEAN.file], folder)


def write_gaussians(folder: str) -> str:
    """Every object that was solved without the articulated Gaussians and with them from the same geometry."""
    rows, files = [], []
    for run in RUNS:
        report = checked.read_json(RESULTS / run.file) if (RESULTS / run.file).is_file() else {}
        before = {row["sequence"]: row for row in report.get("beside", {}).get("no-gaussians", {}).get("rows", ())}
        files += [run.file] if before else []
        for row in sorted(report.get("rows", ()), key=lambda row: row.get("psnr") or 0.0):
            if row["sequence"] in before:
                was = before[row["sequence"]]
                cells = [f"{_cell(was.get(m), d)} > {_cell(row.get(m), d)}" for m, (_, d) in METRICS.items()]
                rows.append([f"{run.title}: {row['object']}", *cells])
    return _table(["video", *(column for column, _ in METRICS.values())], rows) + _stamps(files, folder)


def write_reach(folder: str) -> str:
    """What is reached, beside the goals (`benchmarks.solve.GOALS`) and the paper; missed goals bold."""
    report = checked.read_json(RESULTS / CLEAN.file)
    rows = []
    for goal in solve.GOALS:
        value = report["by_type"][goal.group].get(goal.metric)
        column, digits = METRICS.get(goal.metric, ("joint types right", 2))
        if value is not None:
            reached = value[goal.statistic]
            met = reached >= goal.reach if goal.metric in solve.MORE_IS_BETTER else reached <= goal.reach
            title = f"{column}, {goal.group}" + (", worst" if goal.statistic == "worst" else "")
            rows.append([title, _bold(_cell(reached, digits), met), f"{goal.reach:g}", goal.paper])
    files = [CLEAN.file]
    for run in RUNS[1:]:
        if "sensor" in run.options and "beside" not in run.options and (RESULTS / run.file).is_file():
            report = checked.read_json(RESULTS / run.file)
            lost, mean = sum(map(_has_failed, report["rows"])), report["by_type"]["all"]
            reached = f"{mean['axis']['mean']:.2f}, {mean['miou']['mean']:.3f}, {lost} of {len(report['rows'])}"
            rows.append(
                [
                    f"{run.title}, {_extent(report)}: axis, deg, mIoU, failures",
                    _bold(reached, not lost),
                    "0 failures",
                    "-",
                ]
            )
            files.append(run.file)
    hidden = checked.read_json(RESULTS / "hidden_gap.json")["figures"]
    for name, figure in hidden.items():
        if figure["goal"]:
            goal_text, share = figure["goal"], 100 * figure["hits"] / figure["of"]
            bound = float(re.sub(r"[^\d.]", "", goal_text))
            met = share >= bound if goal_text.startswith(">") else share <= bound
            reached = _bold(f"{figure['hits']} of {figure['of']}", met)
            rows.append([f"`gap`, a hidden world: {name}", reached, goal_text, "-"])
    real = checked.read_json(RESULTS / "real_gap.json")["summary"]
    grades = ", ".join(f"{real[grade]} {grade}" for grade in ("right", "in part", "silent", "wrong"))
    rows.append([f"`gap`, {real['recordings']} sets of real recordings", _bold(grades, not real["wrong"]), "", "-"])
    stamps = _stamps(files, folder).rstrip("\n")
    more = [_stamp(file, folder, "simgap") for file in ("hidden_gap.json", "real_gap.json")]
    return _table(["", "ours", "goal", "FreeArtGS"], rows) + "\\\n".join([stamps, *more]) + "\n"


def write_baselines(folder: str) -> str:
    """The classical baselines by joint type, beside our method, by strict-2; failures count with their penalty."""
    report = checked.read_json(RESULTS / BASELINES)
    rows = []
    for name, its in report["methods"].items():
        title = f"{name}, **given {', '.join(its['privileged'])}**" if its["privileged"] else name
        for kind in ("revolute", "prismatic"):
            group = its["scores"]["strict-2"]["by_type"][kind]
            cells = [_mean(group["statistics"].get(m), digits) for m, (_, digits) in METRICS.items()]
            rows.append([title, kind, f"{group['failures']} of {group['sequences']}", *cells])
    ours = checked.read_json(RESULTS / CLEAN.file)
    for kind in ("revolute", "prismatic"):
        found = ours["by_type"].get(kind, {})
        cells = [_mean(found.get(m), digits) for m, (_, digits) in METRICS.items()]
        failures = sum(_has_failed(row) for row in ours["rows"] if _is_kind(row, kind))
        rows.append(["ours", kind, f"{failures} of {found.get('n', 0)}", *cells])
    head = ["method", "joint", "failures", *(column for column, _ in METRICS.values())]
    stamps = [_stamp(BASELINES, folder, "baselines"), _stamp(CLEAN.file, folder)]
    missing = [name for name in METHOD_NAMES if name not in report["methods"]]
    gaps = f"\nNot measured yet: {', '.join(missing)}.\n" if missing else ""
    return _table(head, rows) + gaps + "\n" + "\\\n".join(stamps) + "\n"


def write_baseline_points(folder: str) -> str:
    """The same answers by strict-3: points in its tracks, medians over all 21, time and memory."""
    report = checked.read_json(RESULTS / BASELINES)
    rows = []
    for name, its in report["methods"].items():
        scores = its["scores"]["strict-3"]
        group = scores["by_type"]["all"]["statistics"]
        cells = [_cell(group[m]["median"] if m in group else None, digits) for m, _, digits in STRICT_3]
        points = [_cell(value, 1) for value in scores["points"].values()]
        use = [_cell(its["cpu_seconds"][k], 0) for k in ("median", "worst")]
        rows.append([name, str(scores["failures"]), *points, *cells, " / ".join(use), _cell(its["peak_gb"], 1)])
    tracks = next(iter(report["methods"].values()))["scores"]["strict-3"]["points"]
    head = ["method", "failures", *(f"points, {track}" for track in tracks)]
    head += [*(f"{column}, median" for _, column, _ in STRICT_3), "processor s, median / worst", "GB"]
    failed = [
        f"- {name}: " + "; ".join(f"{key.removesuffix('-v1')} ({reason})" for key, reason in its["declared"].items())
        for name, its in report["methods"].items()
        if its["declared"]
    ]
    listed = "\nDeclared failures:\n\n" + "\n".join(failed) + "\n" if failed else ""
    return _table(head, rows) + listed + "\n" + _stamp(BASELINES, folder, "baselines") + "\n"


def write_assets(folder: str) -> str:
    """How many assets reach each goal (`benchmarks.assets.GOALS`); those that not all reach are bold."""
    summary = checked.read_json(RESULTS / assets.FILE)["summary"]
    rows = []
    for goal in assets.GOALS:
        its = summary[goal.column]
        reached = _bold(f"{its['reached']} of {its['of']}", its["reached"] == its["of"])
        bound = f"{'at least' if goal.at_least else 'at most'} {goal.bound:g}"
        rows.append([goal.says, bound, reached, *(_figure(its[key]) for key in ("median", "worst"))])
    return _table(["", "goal", "reach it", "median", "worst"], rows) + _stamp_assets(folder)


def write_asset_rows(folder: str) -> str:
    """Each asset, that which misses most goals first; both parts' numbers, the reference part's first."""
    return _asset_table(checked.read_json(RESULTS / assets.FILE)["rows"], ASSET_COLUMNS) + _stamp_assets(folder)


def write_outside_assets(folder: str) -> str:
    """Strangers' objects: the answer, then its asset; that which misses most goals first."""
    answer = {"axis": "axis, deg", "state": "state, deg or %", "miou": "mIoU", "trust": "trust"}
    columns = answer | ASSET_COLUMNS | {"failed_rules": "rules failed, but for trust"}
    columns = {k: its for k, its in columns.items() if k not in ("mass_pc", "iou", "speed", "ball")}
    report = checked.read_json(RESULTS / outside_assets.FILE)
    for row in report["rows"]:
        failed = row.get("failed", ())
        row["failed_rules"] = row.get("failed_rules") and sum(not each.startswith("trust.") for each in failed)
    left_out = [f"- {name}: {why}" for name, why in sorted(report["settings"]["left_out"].items())]
    listed = "\nLeft out:\n\n" + "\n".join(left_out) + "\n" if left_out else ""
    stamp = _stamp(outside_assets.FILE, folder, "reconstruct", "export")
    return _asset_table(report["rows"], columns) + listed + "\n" + stamp + "\n"


def _asset_table(rows: Sequence[dict[str, Any]], columns: dict[str, str]) -> str:
    """Rows of assets; a cell holds both parts' numbers."""
    cells = []
    for row in rows:
        values = [row.get(column) for column in columns]
        texts = [" / ".join(map(_figure, value if isinstance(value, list) else [value])) for value in values]
        cells.append([row["object"].removesuffix("-v1"), *texts])
    return _table(["object", *columns.values()], cells)


def _stamp_assets(folder: str) -> str:
    return "\n" + _stamp(assets.FILE, folder, "export") + "\n"


def _figure(value: float | str | None) -> str:
    return "-" if value is None else value if isinstance(value, str) else f"{value:.3g}"


def write_real_video(folder: str) -> str:
    """Real clips against what was written down of them beforehand."""
    report = checked.read_json(RESULTS / REAL_VIDEO)
    known = checked.read_json(real_video.EXPECTED)["clips"]
    rows = []
    for row in report["rows"]:
        wanted = known[row["clip"]]
        travel = "-" if wanted.get("travel") is None else " to ".join(f"{x:g}" for x in wanted["travel"])
        cells = [row.get("type") or "-", _cell(row.get("travel"), 1), travel, row.get("trust") or "-"]
        rows.append([row["clip"], row["grade"], *cells, _cell(row["seconds"], 0)])
    head = ["clip", "grade", "type", "travel, deg", "expected", "trust", "s"]
    return _table(head, rows) + "\n" + _stamp(REAL_VIDEO, folder) + "\n"


def write_matches(folder: str) -> str:
    """How far ways of matching are from the true flow, at the gaps of `benchmarks.priors`."""
    found: dict[tuple[str, str], dict[int, dict[str, Any]]] = {}
    for row in checked.read_json(RESULTS / priors.FILE)["matches"]:
        found.setdefault((row["recording"], row["way"]), {})[row["gap"]] = row
    rows = []
    for (recording, way), by_gap in found.items():
        cells = [f"{by_gap[gap][key]:{form}}" for gap in priors.GAPS for key, form in _MATCH_COLUMNS.items()]
        rows.append([recording, way, *cells, _cell(float(np.mean([row["cpu_s"] for row in by_gap.values()])), 2)])
    head = [f"{key} at {gap}" for gap in priors.GAPS for key in _MATCH_COLUMNS]
    stamp = _stamp(priors.FILE, folder, "reconstruct/matchers", "reconstruct/trackers/matched.py")
    return _table(["recording", "way", *head, "cpu s"], rows) + "\n" + stamp + "\n"


def write_trackers(folder: str) -> str:
    """Recordings that were solved with every tracker, by strict-2, without Gaussians."""
    rows = [
        [
            row["recording"],
            row["tracker"],
            *(_cell(row[key], digits) for key, digits in (("axis", 2), ("state", 2), ("miou", 3), ("cpu_s", 0))),
        ]
        for row in checked.read_json(RESULTS / priors.FILE)["solved"]
    ]
    head = ["recording", "tracker", "axis, deg", "state, deg or %", "mIoU", "processor s"]
    stamp = _stamp(priors.FILE, folder, "reconstruct", "reconstruct/matchers", "reconstruct/trackers/matched.py")
    return _table(head, rows) + "\n" + stamp + "\n"


def write_costs(folder: str) -> str:
    """What 100,000 sequences of 300 frames cost, by the rates, at the example prices of docs/scale.md."""
    return "\n".join(cost_table(read_rates(), 100_000, 300, 0.04, 0.02)) + "\n"


def rate_solver() -> None:
    """Put the solver's seconds a frame, as the tables have them, among the rates (`leaderboard.suite.rates`)."""
    rates = read_rates()
    for kind, run in RATED.items():
        report = checked.read_json(RESULTS / run.file)
        seconds = float(np.mean([row["seconds_total"] for row in report["rows"] if row["seconds_total"]]))
        rates[kind] = replace(rates[kind], seconds_per_frame=round(seconds / report["settings"]["frames"], 3))
    write_rates(MEASURED, rates)


def _bold(text: str, met: bool) -> str:
    return text if met else f"**{text}**"


TABLES: dict[str, Callable[[str], str]] = {
    "objects": write_objects,
    "types": write_types,
    "categories": write_categories,
    "gaussians": write_gaussians,
    "baselines": write_baselines,
    "baseline-points": write_baseline_points,
    "reach": write_reach,
    "assets": write_assets,
    "asset-rows": write_asset_rows,
    "outside-assets": write_outside_assets,
    "real-video": write_real_video,
    "matches": write_matches,
    "trackers": write_trackers,
    "costs": write_costs,
}


def fill(document: Path) -> str:
    """The text of a document with every table written anew."""
    folder = os.path.relpath(RESULTS, document.parent)
    text = document.read_text("utf-8")
    return TABLE.sub(lambda found: f"{found[1]}{TABLES[found['name']](folder)}{found[3]}", text)


def score_references(data: Path, out: Path, workers: int) -> None:
    """Writes REFERENCES; suite folder in `out`."""
    outcome = run_suite(prepare(data, out, ("reference",), protocols=(solve.PROTOCOL,)), workers)
    for complaint in (*(failed.reason for failed in outcome.failed), *outcome.objections):
        raise FreeArtError(complaint)
    tables = outcome.tables[solve.PROTOCOL]
    rows = {name: {summary["group"]: summary for summary in its} for name, its in tables.items()}
    write_report(RESULTS / REFERENCES, {"protocol": solve.PROTOCOL, "data": data.name}, rows=rows)


def main(
    data: Path = ROOT / "out" / "freeart21-v1",
    workers: int = 1,
    only: tuple[str, ...] = (),
    write: bool = False,
    dry_run: bool = False,
) -> None:
    """Solve all variants, then write the tables.

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
    if not (dry_run or write or only):
        score_references(data, ROOT / "out" / "references", workers)
    if not dry_run:
        rate_solver()
    for document in DOCUMENTS if not dry_run else ():
        if (filled := fill(document)) != document.read_text("utf-8"):
            atomic.write_bytes(document, filled.encode())
            print(document)


if __name__ == "__main__":
    run_cli(main)
