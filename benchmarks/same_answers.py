"""Whether the solver gives the same answers, to the last byte, as at an older commit.

    .venv/bin/python -m benchmarks.same_answers --before 84f6ef9

makes a few short recordings, new ones each time, solves them by the code of that commit and by that of HEAD, compares
the result folders file by file, prints a table and adds what it found to benchmarks/results/same_answers.json. Figures
of the older commit then count as current (`benchmarks.freshness`). The same bytes on these recordings are evidence for
others: a far-reaching change needs several runs. One answer that differs outweighs all that are equal.

A version of the code is known by its digest: a commit that is rebased afterwards has the same, under another name.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks import common, freshness
from benchmarks.common import ROOT, make_table, run_cli, wide_console
from freeart21.errors import FreeArtError
from freeart21.files import atomic

PACKAGE, WORK = "reconstruct", ROOT / "out" / "same-answers"
RECORDINGS = (
    ("stapler", "clean", "tumble"),
    ("drawer_unit", "noise2", "inspect"),
    ("slider_phone", "tof", "tumble"),
    ("flip_lighter", "hand", "human"),
)
"""Object, sensor and motion: both joint types, four categories, parts that are hidden for a while."""
FRAMES, SIZE = 24, ("--width", "320", "--height", "180", "--queries", "2", "--shader", "trivial")
GEOMETRY: dict[str, Any] = {"gaussians": {"refine": False}}
SETTINGS: dict[str, tuple[dict[str, Any], int]] = {
    "geometry": (GEOMETRY, len(RECORDINGS)),
    "default": ({}, 1),
    "paper": ({**GEOMETRY, "segmentation": "paper"}, 1),
}
"""Settings by name, and how many of the recordings are solved with them: those that geometry alone solves first."""
LEFT_OUT = {"prediction.json": ("seconds", "settings.solver"), "diagnostics.json": ("peak_bytes",)}
"""Fields that are not compared: times, memory and the version that a result names. Of the settings, those that only one
of both knows are left out, too."""


def main(before: str, seed: int | None = None) -> int:
    """Compare the answers of two commits.

    Args:
        before: The older commit.
        seed: Of the recordings; drawn when not given.
    """
    after = common.commit()
    if after == "unknown" or after.endswith("-dirty"):
        raise FreeArtError(f"the tree is {after}: commit first, so that the answers have a commit")
    before = _run(["git", "rev-parse", "--short", "--verify", f"{before}^{{commit}}"], ROOT).strip()
    seed = secrets.randbelow(10**6) if seed is None else seed
    shutil.rmtree(WORK, ignore_errors=True)
    older, solves = WORK / "before", []
    _run(["git", "worktree", "add", "--force", "--detach", str(older), before], ROOT)
    try:
        digests = [freshness.measured_digest(PACKAGE, tree) for tree in (older, ROOT)]
        sequences = [_record(*recording, seed, WORK / "data") for recording in RECORDINGS]
        for name, (settings, many) in SETTINGS.items():
            failed = {solve["recording"] for solve in solves if solve["status"] != "ok"}
            for sequence in sorted(sequences, key=lambda at: at.name in failed)[:many]:
                a, b = (_solve(tree, sequence, settings, WORK / name) for tree in (older, ROOT))
                differing, files = compare_results(a, b)
                status = json.loads((b / "prediction.json").read_text("utf-8"))["status"]
                solve = {"settings": name, "recording": sequence.name, "status": status, "files": files}
                solves.append({**solve, "differing": differing})
                print(*solves[-1].values(), flush=True)
    finally:
        _run(["git", "worktree", "remove", "--force", str(older)], ROOT)
    equal = judge(solves)
    rows = [[value or "-" for value in solve.values()] for solve in solves]
    wide_console().print(make_table(f"{before} and {after}", list(solves[0]), rows, ("recording", "status")))
    if equal is None:
        raise FreeArtError(f"seed {seed}: nothing differs, but with some settings nothing was solved: try another seed")
    if digests[0] != digests[1]:  # otherwise it only shows that solving twice gives the same
        ends = [{"commit": name, "digest": digest} for name, digest in zip((before, after), digests, strict=True)]
        made = {"seed": seed, "frames": FRAMES, "options": SIZE, "recordings": RECORDINGS}
        add_proof({"before": ends[0], "after": ends[1], "equal": equal, **made, "solves": solves}, freshness.PROOFS)
    return 0 if equal else 1


def judge(solves: list[dict[str, Any]]) -> bool | None:
    """Whether all answers are equal; None when they are, but with some settings all of them are failures."""
    if any(solve["differing"] for solve in solves):
        return False
    return True if {solve["settings"] for solve in solves if solve["status"] == "ok"} == set(SETTINGS) else None


def add_proof(proof: dict[str, Any], path: Path) -> None:
    """Add a proof to the file; one of the same code and seed is replaced."""
    known = json.loads(path.read_text("utf-8"))["proofs"] if path.is_file() else []
    key = proof["before"]["digest"], proof["after"]["digest"], proof["seed"]
    proofs = [other for other in known if key != (other["before"]["digest"], other["after"]["digest"], other["seed"])]
    named = {"package": PACKAGE, "left_out": LEFT_OUT, "settings": {name: of for name, (of, _) in SETTINGS.items()}}
    atomic.write_json(path, {**named, "proofs": [*proofs, proof]})
    print(path)


def compare_results(first: Path, second: Path) -> tuple[list[str], int]:
    """Names of files that differ between two result folders, or that only one has, and the number of all."""
    names = {path.relative_to(folder).as_posix() for folder in (first, second) for path in folder.rglob("*.*")}
    differing = [name for name in sorted(names) if not _is_equal(first, second, name)]
    return differing, len(names)


def _is_equal(first: Path, second: Path, name: str) -> bool:
    files = first / name, second / name
    if not all(file.is_file() for file in files):
        return False
    if name not in LEFT_OUT:
        return files[0].read_bytes() == files[1].read_bytes()
    a, b = (json.loads(file.read_text("utf-8")) for file in files)
    for field in LEFT_OUT[name]:
        for data in (a, b):
            *groups, last = field.split(".")
            for group in groups:
                data = data.get(group, {})
            data.pop(last, None)
    a["settings"], b["settings"] = _common(a.get("settings"), b.get("settings"))
    return bool(repr(a) == repr(b))  # as text: NaN is no equal of itself


def _common(a: Any, b: Any) -> tuple[Any, Any]:
    """Two trees of settings without the names that only one has."""
    if not (isinstance(a, dict) and isinstance(b, dict)):
        return a, b
    both = {name: _common(a[name], b[name]) for name in sorted(a.keys() & b.keys())}
    return {name: pair[0] for name, pair in both.items()}, {name: pair[1] for name, pair in both.items()}


def _record(name: str, sensor: str, motion: str, seed: int, data: Path) -> Path:
    options = ("--sensor", sensor, "--motion", motion, "--seed", str(seed), "--frames", str(FRAMES), *SIZE)
    out = data / name
    _run([sys.executable, "-m", "freeart21", "record", name, "--out", str(out), *options], ROOT)
    return next((out / "sequences").iterdir())


def _solve(tree: Path, sequence: Path, settings: dict[str, Any], work: Path) -> Path:
    """The result folder of a sequence, solved by the code of a checkout in a process and with caches of its own."""
    place = work / ("after" if tree == ROOT else "before")
    kernels, out, file = work.parent / "kernels" / place.name, place / sequence.name, place.with_suffix(".json")
    atomic.write_json(file, settings)
    command = [sys.executable, "-m", "freeart21", "reconstruct", str(sequence), "--out", str(out)]
    _run([sys.executable, "-c", f"import reconstruct as r; assert r.__file__.startswith('{tree}/')"], tree)
    _run([*command, "--settings", str(file)], tree, (0, 1, 3), NUMBA_CACHE_DIR=str(kernels))  # 1 failed, 3 doubtful
    if not (out / "prediction.json").is_file():
        raise FreeArtError(f"{out}: no answer by the code in {tree}; try {' '.join(command)}")
    return out


def _run(command: list[str], tree: Path, codes: tuple[int, ...] = (0,), **environment: str) -> str:
    """What a command prints, by the code of a checkout; FreeArtError unless its exit code is one of `codes`."""
    environment = {**os.environ, "PYTHONPATH": str(tree), **environment}
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in codes:
        raise FreeArtError(f"{' '.join(command)}: exit code {done.returncode}, {done.stderr.strip()[-300:]}")
    return done.stdout


if __name__ == "__main__":
    run_cli(main)
