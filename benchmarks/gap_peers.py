"""`gap` beside what else one might do, on the same runs: error on runs that nobody fitted, names, processor seconds.

    python -m benchmarks.gap_peers [--names multiarm phy180_31] [--drawn 6] [--seconds 120]

Cases are recordings of others (`real_recordings`) and draws of the hidden world (`benchmarks/world`). Of each case some
runs are taken away: of those marked as held out every second, or the only one, else every fifth of all. Each way sees
the others, and is then judged on those taken away by the root mean square error of position, each run's start state
free: with the library's effects by `simgap.fit.fit`, as `freeart21 replay` finds starts, and MuJoCo's by MuJoCo.

nothing  the asset as it is
gap      `freeart21 gap`, by the files that it delivers
trial    the same, by its trial where it delivers none: of rivals the best, or what it found and did not trust
sysid    `mujoco.sysid`, all that it can express free (`mujoco_sysid`)
fit-all  every effect of the library that these runs could show, at once; claims those whose 90 % interval leaves 0 out
greedy   the effect that lowers BIC most, then the next, while it falls; no run but fitted ones decides

Each has --seconds of processor time and then delivers the best so far; `gap`, which cannot, is killed, and what is not
delivered is judged as nothing. Finished answers are cached in --work. Prints a table and writes
benchmarks/results/gap_peers.json. Recordings that are not at hand, and sets whose force is read, are left out.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import time
from itertools import zip_longest
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.common import (
    RESULTS,
    ROOT,
    commit,
    digest_of,
    keep_row,
    print_table,
    run_cli,
    run_within,
    write_report,
)
from benchmarks.hidden_gap import draw
from benchmarks.real_recordings import recordings
from benchmarks.world.draw import draw_specs
from freeart21.asset import Asset
from freeart21.files import atomic, checked
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured
from freeart21.measured import Measured

WAYS = ("nothing", "gap", "trial", "sysid", "fit-all", "greedy")
RECORDINGS = ("bam_free", "dfki", "rotary_settled", "multiarm", "phy180_32", "adip_pend_cut")
"""The handful that is asked by default, of five machines. Of a motor that turns on and on (hsm150) a
position is no measure: without friction the asset ends 6,700 rad off."""
SEED = 44
"""Of the drawn cases."""
_STRATA = ("clear", "pair", "outside")
_HARD = 4.0
"""Times --seconds that a process may take, with its start, what it judges and the compiling of formulas."""
_STEPS = 6
"""Iterations of a fit on stretches, of a candidate of `greedy` before it is compared."""
_NORMAL_90 = 1.645


def main(
    names: tuple[str, ...] = RECORDINGS,
    drawn: int = 6,
    seconds: float = 120.0,
    ways: tuple[str, ...] = WAYS,
    work: Path = ROOT / "out" / "gap_peers",
    out: Path = RESULTS / "gap_peers.json",
) -> None:
    """Fit, judge and write down.

    Args:
        names: Recordings.
        drawn: Cases of the hidden world: clear single effects, pairs and effects outside the library by turns.
        seconds: Of processor time that each way has for a case.
        ways: Of `WAYS`.
        work: Where cases and answers are cached.
        out: The JSON file.
    """
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))
    here = recordings()
    if here and set(names) - set(here):
        raise SystemExit(f"no recording {', '.join(sorted(set(names) - set(here)))}; there are {', '.join(here)}")
    settings = {"seconds": seconds, "recordings": list(names), "drawn": drawn, "seed": SEED}
    rows: list[dict[str, Any]] = []
    work = work.resolve()
    turns = zip_longest((name for name in names if name in here), _draw_cases(drawn, work))  # whenever it is stopped
    for case in (case for turn in turns for case in turn if case is not None):
        untouched = prepare(case, work / "cases" / case)
        for way in ways:
            rows.append(_ask(case, way, work, seconds, untouched))
            print({k: rows[-1][k] for k in ("case", "way", "error", "names", "seconds")}, flush=True)
        write_report(out, settings, ratios=_compare_ours(rows, ways), rows=rows)
    _print(rows, _compare_ours(rows, ways), ways)


def _draw_cases(count: int, work: Path) -> list[str]:
    """Ids of drawn cases, written to work/drawn."""
    of = {s: [(i, spec) for i, spec in enumerate(draw_specs(1.0, SEED)) if spec.stratum == s] for s in _STRATA}
    chosen, turn = [], 0
    while len(chosen) < count:
        i, spec = of[_STRATA[turn % len(_STRATA)]].pop(0)
        if draw(spec, SEED, i, work / "drawn") is None:
            chosen.append(f"drawn_{i:03d}")
        turn += 1
    return chosen


def prepare(case: str, folder: Path) -> list[str]:
    """Writes asset.urdf, measured/ with all runs and fitted/ without those taken away; the names of these."""
    if not (folder / "untouched.json").is_file():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        if case.startswith("drawn_"):
            made = folder.parents[1] / "drawn" / "cases" / case.removeprefix("drawn_")
            shutil.copytree(made / "measured", folder / "measured")
            shutil.copy(made / "machine.urdf", folder / "asset.urdf")
        else:
            recordings()[case](folder)
        atomic.write_json(folder / "untouched.json", {"runs": take_away(folder / "measured", folder / "fitted")})
    return list(checked.read_json(folder / "untouched.json")["runs"])


def take_away(measured: Path, fitted: Path) -> list[str]:
    """Copy a measured set without some of its runs: of those marked as held out every second, or the only one, else
    every fifth of all; their names."""
    shutil.copytree(measured, fitted)
    doc = json.loads((measured / "measured.json").read_text())
    names = [run.name for run in read_measured(measured).runs]
    held_out = [i for i, run in enumerate(doc["runs"]) if run.get("held_out")]
    gone = held_out[1::2] or held_out or list(range(2, len(names), 5))
    doc["runs"] = [run for i, run in enumerate(doc["runs"]) if i not in gone]
    (fitted / "measured.json").write_text(json.dumps(doc, indent=1) + "\n")
    return [names[i] for i in gone]


def _ask(case: str, way: str, work: Path, seconds: float, untouched: list[str]) -> dict[str, Any]:
    """The row of one way on one case, cached."""
    key = digest_of(seconds, commit("simgap", "freeart21", "benchmarks"))
    file = work / "answers" / case / f"{way}.json"
    return keep_row(file, key, lambda: _answer(case, way, work, seconds, untouched))


def _answer(case: str, way: str, work: Path, seconds: float, untouched: list[str]) -> dict[str, Any]:
    folder = work / "answers" / case / way
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    place, spent, status = work / "cases" / case, 0.0, ""
    if way == "gap":
        words = ("gap", str(place / "asset.urdf"), str(place / "fitted"), "--out", "answer")
        ended = run_within(seconds, (sys.executable, "-m", "freeart21", *words), folder)
        spent, status = ended.seconds, {0: "", 3: "", None: "out of time"}.get(ended.code, f"failed: {ended.last}")
    code = f"from benchmarks.gap_peers import answer; answer({way!r}, {str(place)!r}, '.', {seconds!r})"
    ended = run_within(_HARD * seconds, (sys.executable, "-c", code), folder)
    done = checked.read_json(folder / "done.json") if (folder / "done.json").is_file() else {}
    return {
        "case": case,
        "way": way,
        "untouched": untouched,
        "error": done.get("error"),
        "names": done.get("names", []),
        "seconds": round(done.get("seconds", ended.seconds) + spent, 1),
        "status": status
        or (done["status"] if done else "out of time" if ended.code is None else f"failed: {ended.last}"),
    }


def answer(way: str, place: str, out: str, seconds: float) -> None:
    """Fit one way and judge it, in a process of its own: writes done.json."""
    folder, began = Path(place), time.process_time()
    measured, urdf = read_measured(folder / "measured"), folder / "asset.urdf"
    untouched, finished, names = checked.read_json(folder / "untouched.json")["runs"], True, []
    if way == "sysid":
        from benchmarks.mujoco_sysid import Identification

        runs = tuple(run for run in measured.runs if run.name not in untouched)
        identification = Identification(urdf, measured, runs)
        found = identification.fit(seconds)
        names, finished, spent = found.names, found.finished, time.process_time() - began
        errors = [identification.score(found, run) for run in measured.runs if run.name in untouched]
    else:
        answered, spent = Path(out).resolve().parent / "gap" / "answer", 0.0
        found_in = {"nothing": (), "gap": ("asset",), "trial": ("trial", "asset")}.get(way, ())
        repaired = next((answered / name for name in found_in if (answered / name).is_dir()), urdf)
        library = open_library(read_asset(repaired, measured.joint), measured, untouched)
        if way in ("nothing", "gap", "trial"):
            fit = library.as_delivered()
            names = _claims(answered / "verdict.json") if found_in else []
        else:
            began = time.process_time()
            fit, names, finished = (fit_all if way == "fit-all" else fit_greedy)(library, seconds)
            spent = time.process_time() - began
        errors = library.errors(fit)
    error = float(np.sqrt(np.mean(np.square(errors))))
    status = "finished" if finished else "stopped"
    atomic.write_json(
        Path(out) / "done.json", {"error": error, "names": names, "seconds": spent, "status": status, "runs": errors}
    )


def _claims(path: Path) -> list[str]:
    """What a verdict says: its effects, or its rivals."""
    if not path.is_file():
        return []
    verdict = checked.read_json(path)
    effects, rivals = (effect["name"] for effect in verdict["effects"]), verdict["rivals"]
    names = [" or ".join("+".join(rival) for rival in rivals)] if rivals else sorted(effects)
    return [*names, *(["(in part)"] if verdict.get("in_part") and names else [])]


def open_library(asset: Asset, measured: Measured, untouched: list[str]) -> SimpleNamespace:
    """All that this file takes of `simgap`: fits of sets of the library's effects to the runs that may be fitted, and
    errors, rad or m, of the runs `untouched`."""
    from freeart21.effects import EFFECTS
    from simgap.fit.fit import (
        Fit,
        Model,
        fit_model,
        fit_multiple_shooting,
        fit_starts,
        information_matrix,
        initial_theta,
        residual_dispersion,
    )
    from simgap.fit.guess import neutral_point
    from simgap.fit.problem import make_problem, without_asset_error
    from simgap.fit.search import list_candidates
    from simgap.measure.data import make_fit_runs
    from simgap.models.surrogate import make_plant

    plant = make_plant(asset, measured)
    every, floor = make_fit_runs(measured, plant)
    runs = tuple(run for run in every if run.name not in untouched)
    judged = tuple(run for run in every if run.name in untouched)
    problem = make_problem(plant, measured, runs, floor)

    def fit(names: tuple[str, ...], parent: Fit, iterations: int, stretches: bool = True) -> Fit:
        """From a parent; what it has not begins where it does nothing, on short stretches of the runs first."""
        model = Model(problem, tuple(sorted(names)))
        new = {name: neutral_point(problem, name) for name in model.names if name not in parent.model.names}
        theta = initial_theta(model, parent, new)
        if new and stretches:
            return fit_multiple_shooting(model, runs, theta, iterations)
        return fit_model(model, runs, theta, parent.starts, iterations)

    def deliver() -> Fit:
        model = Model(without_asset_error(problem), (), instant_friction=True)
        return fit_model(model, runs)

    def errors(fit: Fit) -> list[float]:
        refit = fit_starts(fit.model, fit.theta, judged)
        return [float(np.sqrt(np.mean((refit.residuals[run.name] * run.sigma) ** 2))) for run in judged]

    def claims(fit: Fit) -> list[str]:
        variance = np.diag(np.linalg.pinv(information_matrix(fit, residual_dispersion(fit.residuals)), hermitian=True))
        spread = np.sqrt(np.where(variance > 0, variance, np.inf))
        first = {r.owner: i for i, r in reversed(list(enumerate(fit.model.ranges())))}
        return [n for n in fit.model.names
                if abs(fit.theta[first[n]] - EFFECTS[n].neutral) > _NORMAL_90 * spread[first[n]]]  # fmt: skip

    def bic(fit: Fit) -> float:
        readings = sum(len(run.q) for run in runs)
        return float(readings * math.log(fit.rss / readings) + len(fit.theta) * math.log(readings))

    base = fit_multiple_shooting(Model(problem, ()), runs)
    names = list_candidates(problem, runs)
    common = tuple(n for n in names if EFFECTS[n].common)
    smooth = tuple(n for n in names if EFFECTS[n].acts != "slack" and not EFFECTS[n].is_local())
    every_one = tuple(n for n in names if EFFECTS[n].acts != "slack")
    return SimpleNamespace(
        stages=(common, smooth, every_one),
        base=base,
        names=names,
        fit=fit,
        as_delivered=deliver,
        errors=errors,
        claims=claims,
        bic=bic,
    )


def fit_all(library: SimpleNamespace, seconds: float) -> tuple[Any, list[str], bool]:
    """Every effect at once, but a slack, which is a body of its own and no parameter. Starts with those that every
    machine has, then all without a place, for all at once are lost from the start."""
    end, fit = time.process_time() + seconds, library.base
    for names in library.stages:
        fit = min(
            (library.fit(names, fit, _STEPS, stretches) for stretches in (True, False)), key=lambda found: found.cost
        )
    while time.process_time() < end:
        new = library.fit(library.stages[-1], fit, 2 * _STEPS)
        if new.cost > 0.999 * fit.cost:
            return fit, library.claims(fit), True
        fit = new
    return fit, library.claims(fit), False


def fit_greedy(library: SimpleNamespace, seconds: float) -> tuple[Any, list[str], bool]:
    """The effect that lowers BIC most, then the next."""
    end, best = time.process_time() + seconds, library.base
    while True:
        rough = []
        for name in (n for n in library.names if n not in best.model.names):
            if time.process_time() > end:
                return best, list(best.model.names), False
            rough.append(library.fit((*best.model.names, name), best, _STEPS))
        nearest = sorted(rough, key=library.bic)[:2]
        new = min((library.fit(fit.model.names, fit, 3 * _STEPS) for fit in nearest), key=library.bic, default=best)
        if library.bic(new) >= library.bic(best):
            return best, list(best.model.names), True
        best = new


def compare(rows: list[dict[str, Any]], ways: tuple[str, ...], ours: str = "gap") -> dict[str, dict[str, Any]]:
    """Of each way: the geometric mean over cases of our error over its, the standard error of the logarithm, and the
    cases in which ours is worse by more than a tenth. What was not delivered is judged as nothing."""
    of = {(row["case"], row["way"]): row["error"] for row in rows}
    found: dict[str, dict[str, Any]] = {}
    for way in ways:
        logs = {}
        for case in dict.fromkeys(row["case"] for row in rows):
            errors = [of.get((case, w)) or of.get((case, "nothing")) for w in (ours, way)]
            if way not in ("gap", "trial") and all(errors):
                logs[case] = math.log(errors[0] / errors[1])
        if logs:
            values = np.array(list(logs.values()))
            spread = float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else None
            worse = [case for case, x in logs.items() if x > math.log(1.1)]
            mean = float(np.exp(values.mean()))
            found[way] = {"ratio": mean, "standard_error_of_log": spread, "cases": len(logs), "worse": worse}
    return found


def _compare_ours(rows: list[dict[str, Any]], ways: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    return {ours: compare(rows, ways, ours) for ours in ("gap", "trial") if ours in ways}


def _print(rows: list[dict[str, Any]], ratios: dict[str, dict[str, Any]], ways: tuple[str, ...]) -> None:
    of = {(row["case"], row["way"]): row for row in rows}
    lines = []
    for case in dict.fromkeys(row["case"] for row in rows):
        cells = []
        for way in ways:
            row = of[case, way]
            error = "-" if row["error"] is None else f"{1e3 * row['error']:.3g}"
            mark = "" if row["status"] == "finished" else " !"
            cells.append(f"{error}{mark} ({row['seconds']:.0f}) {' '.join(row['names'])}")
        lines.append((case, *cells))
    print_table("error on untouched runs, mrad or mm (processor s); names", ("case", *ways), lines)
    for ours, way, figure in ((ours, way, figure) for ours, of in ratios.items() for way, figure in of.items()):
        spread = figure["standard_error_of_log"]
        factor = "" if spread is None else f", times or over {math.exp(spread):.2f} (one standard error)"
        print(f"{ours} over {way}: {figure['ratio']:.2f}{factor}; worse by a tenth: {figure['worse'] or 'never'}")


if __name__ == "__main__":
    run_cli(main)
