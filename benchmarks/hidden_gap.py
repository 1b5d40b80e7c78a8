"""How well `freeart21 gap` names what is hidden by a world that shares nothing with it: draw, ask, score.

    python -m benchmarks.hidden_gap --seed 1 --share 0.1 --out DIR    # a development draw, some 34 cases
    python -m benchmarks.hidden_gap --release --out DIR          # the release's 112 cases: scored once, tuned on never

A draw that was stopped goes on where it was. DIR/cases/ID has what `gap` sees, DIR/labels what is hidden. `gap` runs
as a user runs it, on a copy that nothing lies beside. The docstring of `benchmarks/world` has how the world was made,
and what must never change it. Never use the release's seed for anything else: who looked at a draw may tune on it.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.common import RESULTS, run_cli, run_within, write_report
from benchmarks.world import grade, sensor
from benchmarks.world.draw import Spec, TooFaint, draw_case, draw_specs
from benchmarks.world.effects import hide
from freeart21.files.atomic import write_json

RELEASE = 320_001  # the seed of the release's draw, not run while the world was made
RELEASE_SHARE = 1 / 3  # of the full draw, which takes three hours of two cores


def draw(spec: Spec, seed: int, index: int, out: Path) -> str | None:
    """Writes out/cases/INDEX and out/labels/INDEX.json, or leaves them as they are; the reason where there is none."""
    folder, secret = out / "cases" / f"{index:03d}", out / "labels" / f"{index:03d}.json"
    if secret.is_file():
        return None
    try:
        case = draw_case(spec, seed, index)
    except TooFaint as error:
        return str(error)
    p, rng = hide(case.rig.machine, case.rig.nuisance, list(case.effects)), np.random.default_rng([seed, 2, index])
    shutil.rmtree(folder, ignore_errors=True)
    sensor.write(folder, case.rig, sensor.read(p, case.rig, rng))
    write_json(secret, case.label())
    return None


def ask(case: Path, out: Path, limit: float) -> None:
    """Writes the answer: verdict.json beside exit code, processor seconds and the last line of its output."""
    if out.is_file():
        return
    with tempfile.TemporaryDirectory() as scratch:
        shutil.copytree(case, Path(scratch) / "case")
        words = ("-m", "freeart21", "gap", "case/machine.urdf", "case/measured", "--out", "answer")
        ended, file = run_within(limit, (sys.executable, *words), Path(scratch)), Path(scratch) / "answer/verdict.json"
        verdict = json.loads(file.read_text()) if ended.code == 0 and file.is_file() else None
    last = f"no answer in {limit:.0f} s" if ended.code is None else ended.last
    write_json(out, {"exit": ended.code, "seconds": ended.seconds, "error": last, "verdict": verdict})
    print(f"{out.stem} {ended.seconds:6.1f} s  {verdict['verdict'] if verdict else last}", file=sys.stderr, flush=True)


def hash_files(folder: Path) -> str:
    """SHA-256 of all files of a folder and their names."""
    files = sorted(f for f in folder.rglob("*") if f.is_file())
    lines = [f"{f.relative_to(folder)} {hashlib.sha256(f.read_bytes()).hexdigest()}" for f in files]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def main(
    out: Path, seed: int = 1, share: float = 0.1, release: bool = False, jobs: int = 1, limit: float = 300.0
) -> None:
    """Draw, ask, score: writes benchmarks/results/hidden_gap.json, hidden_gap-dev.json where it is no release.

    Args:
        out: Folder of cases, labels and answers.
        seed: Of the cases.
        share: Of the full draw of 336 cases.
        release: The release's draw: its own seed, a third of all cases.
        jobs: Processes side by side.
        limit: Seconds of processor time an answer may take.
    """
    if seed == RELEASE and not release:
        raise SystemExit(f"--seed: {RELEASE} is the release's; run it with --release, or take another")
    seed, share = (RELEASE, RELEASE_SHARE) if release else (seed, share)
    settings, drawn = {"seed": seed, "share": share}, out / "settings.json"
    if drawn.is_file() and json.loads(drawn.read_text()) != settings:
        raise SystemExit(f"--out: {out} holds another draw, {json.loads(drawn.read_text())}")
    write_json(drawn, settings)
    with ProcessPoolExecutor(jobs) as pool:
        made = [pool.submit(draw, spec, seed, i, out) for i, spec in enumerate(draw_specs(share, seed))]
        for done in made:
            if done.result():
                print(f"left out: {done.result()}", file=sys.stderr, flush=True)
    names = sorted(path.stem for path in (out / "labels").glob("*.json"))
    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(lambda name: ask(out / "cases" / name, out / "answers" / f"{name}.json", limit), names))
    pairs = {n: [json.loads((out / k / f"{n}.json").read_text()) for k in ("labels", "answers")] for n in names}
    rows = [{"case": name, **grade.grade(*pair)} for name, pair in pairs.items()]
    print("\n".join(grade.table_lines(rows)))
    seconds = sorted(row["seconds"] for row in rows)
    write_report(
        RESULTS / ("hidden_gap.json" if release else "hidden_gap-dev.json"),
        settings | {"limit_s": limit, "cases": len(names), "jobs": jobs, "release": release},
        cases_sha256=hash_files(out / "cases"),
        figures=grade.count_figures(rows),
        seconds={"median": float(np.median(seconds)), "most": max(seconds)},
        rows=rows,
    )


if __name__ == "__main__":
    run_cli(main)
