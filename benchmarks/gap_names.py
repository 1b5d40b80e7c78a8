"""How well `freeart21 gap` names what is missing: sealed cases with hidden effects, and baselines on the same data.

    .venv/bin/python -m benchmarks.gap_names [--share 1.0] [--workers 2] [--seed 20260]

draws and seals some 700 cases (benchmarks/hidden_world: a world that shares no code with the product), lets a child
process answer that sees only the measured files, fixes the hash of every answer, and only then opens the labels. Prints
tables, writes benchmarks/results/simgap.json, adds the draw to simgap-draws.json (not when --out is given) and draws
the confusion matrix to out/simgap_confusion.png.

Finished work is kept in --work and not repeated: cases, answers, baselines. `seconds_per_verdict_median` is the time of
the function that goes from trajectories to a verdict, on one core, with `workers` of them side by side.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one core a process
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["NUMBA_NUM_THREADS"] = "1"

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from benchmarks import gap_baselines as baselines
from benchmarks import gap_draws
from benchmarks import gap_score as score
from benchmarks.common import RESULTS, ROOT, commit, machine
from benchmarks.hidden_world import cases, leak, sealed
from freeart21.files.atomic import write_json


def main(
    share: float = 1.0,
    seed: int = 20260,
    workers: int = 2,
    baseline_cases: int = 60,
    leave_out: int = 2,
    work: Path = ROOT / "out" / "simgap_bench",
    out: Path = RESULTS / "simgap.json",
) -> None:
    """Run the benchmark.

    Args:
        share: Part of each stratum's cases.
        seed: Of the cases; another one makes others.
        workers: Processes side by side.
        baseline_cases: Cases that the baselines are run on.
        leave_out: Cases of each effect that are asked again with that effect left out of the library.
        work: Where cases, answers and labels are kept.
        out: The JSON file.
    """
    place = work / f"{seed}-{share:g}"
    vault = sealed.Vault(place / "seen", place / "vault")
    spent = place / "seconds.json"
    _add(spent, "cases", _build(vault, seed, share, workers))
    answers = place / "answers"
    _add(spent, "answers", _ask(vault.out / "cases", answers, workers))
    labels, rows = _opened(vault, answers)
    jobs = _left_out(rows, leave_out)
    (place / "jobs.json").write_text(json.dumps(jobs))
    _add(spent, "leave_one_out", _ask(vault.out / "cases", place / "without", workers, place / "jobs.json"))
    alone = [_refused(place / "without" / name, job, labels) for name, job in jobs.items()]
    compared, took = _compared(vault, rows, baseline_cases, workers, place / "baselines.json")
    seconds = _add(spent, "baselines", took)
    leaks = _leaks(vault, rows)
    found = {
        **score.summary(rows, alone),
        "leak_p_values": leaks,
        "baselines": baselines.summary(compared, rows),
        "minutes": sum(seconds.values()) / 60,
    }
    score.picture(rows, ROOT / "out" / "simgap_confusion.png")
    _print(found, rows)
    result = {
        "summary": found,
        "smallest_nameable": score.smallest_nameable(rows),
        "rows": rows,
        "leave_one_out": alone,
        "seconds": seconds,
        "commit": commit(),
        "machine": machine(),
        "settings": {"share": share, "seed": seed, "workers": workers, "baseline_cases": baseline_cases},
    }
    write_json(out, result)
    if out == RESULTS / "simgap.json":
        gap_draws.append(result)


def _add(file: Path, stage: str, seconds: float) -> dict[str, float]:
    """Seconds of every stage, this run's added to those of earlier ones; what a kill cut short is not counted."""
    known: dict[str, float] = json.loads(file.read_text()) if file.is_file() else {}
    known[stage] = known.get(stage, 0.0) + seconds
    write_json(file, known)
    return known


def _seal(job: tuple[str, str, Any, str, int]) -> None:
    out, vault, wish, name, seed = job
    if not (Path(out) / "cases" / name).is_dir():
        sealed.Vault(Path(out), Path(vault)).add(name, cases.draw_case(wish, seed))


def _build(vault: sealed.Vault, seed: int, share: float, workers: int) -> float:
    """Draw and seal all cases that are not there; seconds."""
    began = time.perf_counter()
    vault.prepare()
    jobs = [
        (str(vault.out), str(vault.vault), wish, sealed.case_id(seed, i), seed * 10_000 + i)
        for i, wish in enumerate(cases.wishes(seed, share))
    ]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for i, _ in enumerate(pool.map(_seal, jobs, chunksize=4), 1):
            if i % 50 == 0 or i == len(jobs):
                print(f"{i} of {len(jobs)} cases sealed, {time.perf_counter() - began:.0f} s", flush=True)
    vault.publish()
    return time.perf_counter() - began


def _ask(folder: Path, answers: Path, workers: int, jobs: Path | None = None) -> float:
    """Let a child answer that is told of no other place than these two; seconds."""
    began = time.perf_counter()
    command = [sys.executable, str(ROOT / "benchmarks" / "gap_answer.py")]
    command += ["--cases", str(folder), "--answers", str(answers), "--workers", str(workers)]
    command += ["--jobs", str(jobs)] if jobs else []
    subprocess.run(command, check=True, cwd=folder)
    return time.perf_counter() - began


def _opened(vault: sealed.Vault, answers: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Fix the hash of every verdict, then open the labels and judge."""
    verdicts = {p.name: p / "verdict.json" for p in sorted(answers.iterdir()) if (p / "verdict.json").is_file()}
    for name, path in verdicts.items():
        vault.record(name, path)
    labels = vault.open(verdicts)
    rows = []
    for name, path in verdicts.items():
        seconds = json.loads((path.parent / "seconds.json").read_text())
        rows.append(score.judged(labels[name], json.loads(path.read_text()), seconds))
    return labels, rows


def _left_out(rows: list[dict[str, Any]], most: int) -> dict[str, dict[str, str]]:
    """Clear singles that were named, to be asked again without their effect in the library."""
    jobs: dict[str, dict[str, str]] = {}
    count: dict[str, int] = {}
    for row in rows:
        if row["stratum"] in ("single", "kinematic") and row["strength"] == "clear" and row["right"]:
            name = row["truth"][0]
            count[name] = count.get(name, 0) + 1
            if count[name] <= most:
                jobs[f"{row['id']}-without"] = {"case": row["id"], "without": name}
    return jobs


def _refused(folder: Path, job: dict[str, str], labels: dict[str, Any]) -> dict[str, Any]:
    verdict = json.loads((folder / "verdict.json").read_text())
    return {
        "id": job["case"],
        "without": job["without"],
        "verdict": verdict["verdict"],
        "said": score.names_of(verdict),
        "ratio": labels[job["case"]]["ratio"],
        "refused": verdict["verdict"] not in ("named", "crashed"),
    }


def _compared(
    vault: sealed.Vault, rows: list[dict[str, Any]], most: int, workers: int, kept: Path
) -> tuple[dict[str, Any], float]:
    """The baselines' answers on some cases, kept: two in three have a name that they should find."""
    began = time.perf_counter()
    known = json.loads(kept.read_text()) if kept.is_file() else {}
    able = [row for row in rows if row["rig"] in ("full", "free", "swing", "push")]
    named = [row["id"] for row in able if row["stratum"] in ("single", "pair") and row["strength"] == "clear"]
    none = [row["id"] for row in able if row["stratum"] in ("null", "strange")]
    wanted = named[: 2 * most // 3] + none[: most - 2 * most // 3]
    left = [str(vault.out / "cases" / name) for name in wanted if name not in known]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for folder, found in zip(left, pool.map(baselines.answers, left), strict=True):
            known[Path(folder).name] = found
            write_json(kept, known)
    return {name: known[name] for name in wanted}, time.perf_counter() - began


def _leaks(vault: sealed.Vault, rows: list[dict[str, Any]]) -> dict[str, float]:
    """p values of guessing nulls from everything but the readings, among cases of one rig and type of joint."""
    found = {}
    for kind in ("revolute", "prismatic"):
        here = [r for r in rows if r["rig"] == "full" and r["kind"] == kind and r["stratum"] in ("null", "single")]
        told = np.array([r["stratum"] == "null" for r in here], int)
        if min(told.sum(), len(told) - told.sum()) >= 10:
            seen = np.array([leak.features(vault.out / "cases" / r["id"]) for r in here])
            for name, classify in (("logistic", leak.logistic), ("neighbours", leak.nearest)):
                found[f"{kind} {name}"] = leak.p_value(seen, told, classify, 49)
    return found


def _print(found: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    console = Console()
    table = Table("figure", "value", title="simgap")
    for name, value in found.items():
        if not isinstance(value, dict):
            table.add_row(name, f"{value:.4g}" if isinstance(value, float) else str(value))
    for name, value in found["intervals"].items():
        low, high = value["wilson95"]
        table.add_row(name, f"{value['k']} of {value['n']}, {low:.2f} to {high:.2f}")
    console.print(table)
    wrong = Table("truth", "stratum", "strength", "n", "right", "answers", title="By effect")
    for key in sorted({(r["truth"], r["stratum"], r["strength"]) for r in rows}):
        own = [r for r in rows if (r["truth"], r["stratum"], r["strength"]) == key]
        said: dict[str, int] = {}
        for r in own:
            answer = "+".join(r["said"]) if r["verdict"] == "named" else r["verdict"]
            said[answer] = said.get(answer, 0) + 1
        ranked = sorted(said.items(), key=lambda e: -e[1])[:4]
        wrong.add_row(
            "+".join(key[0]) or "-", key[1], key[2], str(len(own)), str(sum(r["right"] for r in own)),
            ", ".join(f"{k} {v}" for k, v in ranked),
        )  # fmt: skip
    console.print(wrong)
    other = Table("baseline", "cases", "right names", "false names", "closed", title="Baselines")
    for name, value in found["baselines"].items():
        cells = [value.get(k) for k in ("cases", "right", "false_names", "closed_fraction_median")]
        other.add_row(name, *("-" if c is None else f"{c:.3g}" for c in cells))
    console.print(other)


if __name__ == "__main__":
    tyro.cli(main)
