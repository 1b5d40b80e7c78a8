"""A predictor under seal: answers cases in a folder, and sees nothing but that folder.

    .venv/bin/python benchmarks/gap_answer.py CASES ANSWERS [--workers 2] [--jobs JOBS.json]

CASES/ID/{asset,measured} becomes ANSWERS/ID/verdict.json, by the function behind `freeart21 gap`, and ANSWERS/ID/
seconds.json: `verdict`, from trajectories to the draft of a verdict, and `whole`, with SAPIEN's replay and the page.
Answers that are there are kept. JOBS.json may map names of answers to {"case", "without"}: an effect to leave out of
the library.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one core a process
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["NUMBA_NUM_THREADS"] = "1"
sys.path[:] = [p for p in sys.path if Path(p or ".").resolve() != Path(__file__).resolve().parent]
"""Else benchmarks/export.py, beside this script, stands for the package of that name."""


def answer(case: Path, out: Path, without: str | None) -> None:
    """One verdict, and how long it took; a crash is an answer, too."""
    from simgap import workflow
    from simgap.settings import GapSettings

    took: list[float] = []
    ask = workflow.explain

    def timed(*given: Any, **named: Any) -> Any:
        began = time.perf_counter()
        found = ask(*given, **named)
        took.append(time.perf_counter() - began)
        return found

    workflow.explain = timed
    began = time.perf_counter()
    aside = out.parent / f".{out.name}.part"
    try:
        settings = GapSettings(without=(without,) if without else ())
        workflow.gap_folder(case / "asset", case / "measured", aside, settings)
    except Exception:
        aside.mkdir(parents=True, exist_ok=True)
        failed = {"verdict": "crashed", "effects": [], "gap": [], "rivals": [], "error": traceback.format_exc()[-2000:]}
        (aside / "verdict.json").write_text(json.dumps(failed))
    finally:
        workflow.explain = ask
    whole = time.perf_counter() - began
    (aside / "seconds.json").write_text(json.dumps({"verdict": took[0] if took else whole, "whole": whole}))
    (aside / "index.html").unlink(missing_ok=True)  # a megabyte a case
    aside.rename(out)


def _one(job: tuple[str, str, str | None]) -> str:
    answer(Path(job[0]), Path(job[1]), job[2])
    return job[1]


def main(cases: Path, answers: Path, workers: int = 2, jobs: Path | None = None) -> None:
    """Answer all cases that have no answer yet."""
    answers.mkdir(parents=True, exist_ok=True)
    if jobs is None:
        asked = {folder.name: {"case": folder.name, "without": None} for folder in sorted(cases.iterdir())}
    else:
        asked = json.loads(jobs.read_text())
    left = [
        (str(cases / job["case"]), str(answers / name), job["without"])
        for name, job in asked.items()
        if not (answers / name).is_dir() and (cases / job["case"]).is_dir()
    ]
    began = time.perf_counter()
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for i, _ in enumerate(pool.map(_one, left), 1):
            if i % 20 == 0 or i == len(left):
                rate = (time.perf_counter() - began) / i
                print(f"{i} of {len(left)} answered, {rate:.1f} s each", flush=True)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
