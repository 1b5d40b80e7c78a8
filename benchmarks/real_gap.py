"""What `gap` says of real recordings, and whether that holds physically.

    .venv/bin/python -m benchmarks.real_gap [--limit 180] [--names multiarm dfki]

makes an asset and a measured set of every recording of ../shared/measured (`real_recordings`), asks `gap` in a process
of its own that is killed after --limit seconds of processor time, and grades the answer (`real_grade`) by what was
known of the recording beforehand (real_expected.json). Prints the table and writes benchmarks/results/real_gap.json.
May be killed and goes on: an answer of the same commit, limit and recording is kept in --work. Recordings that are not
at hand are left out.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

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
from benchmarks.real_grade import grade_answer, measure_closing, overclaims, summarise
from benchmarks.real_recordings import MEASURED, recordings
from freeart21.errors import FreeArtError
from freeart21.files import checked

EXPECTED = ROOT / "benchmarks" / "real_expected.json"
_CODE = ("simgap", "freeart21", "generator", "export", "benchmarks/real_recordings.py")
"""Folders and files that an answer depends on."""
_NO_TIME = {"seconds": 0.0, "wall seconds": 0.0}
_COMMAND = ("-m", "freeart21", "gap", "asset.urdf", "measured", "--out", "answer")


def main(
    limit: float = 180.0,
    names: tuple[str, ...] = (),
    work: Path = ROOT / "out" / "real_gap",
    out: Path | None = None,
) -> None:
    """Ask and grade.

    Args:
        limit: Seconds of processor time that an answer may take.
        names: These recordings alone.
        work: Where sets and answers are kept; what is there already is used.
        out: The JSON file. When not given: benchmarks/results/real_gap.json, and only when all recordings are asked.
    """
    here = recordings()
    if not here:
        print(f"no recordings at {MEASURED}: nothing to do")
        return
    unknown = sorted(set(names) - set(here))
    if unknown:
        raise FreeArtError(f"there is no recording {', '.join(unknown)}; there are {', '.join(here)}")
    known = checked.read_json(EXPECTED)
    chosen = [name for name in here if not names or name in names]
    rows = []
    for k, name in enumerate(chosen, 1):
        key = digest_of(limit, commit(*_CODE))
        row = keep_row(work / f"{name}.json", key, lambda name=name: _ask(name, work / name, limit))
        rows.append(_grade(row, known))
        print(f"{k} of {len(chosen)}: {name}: {rows[-1]['grade']} ({rows[-1]['seconds']:.0f} s)", flush=True)
    _print(rows)
    if out is None and len(chosen) == len(known["recordings"]):
        out = RESULTS / "real_gap.json"
    if out is not None:
        write_report(out, {"limit": limit}, summary=summarise(rows), rows=rows)


def _ask(name: str, folder: Path, limit: float) -> dict[str, Any]:
    """What `gap` says of one recording, and how long it took; nothing where it was killed or refused it."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        recordings()[name](folder)
    except FreeArtError as error:
        return {"name": name, "status": "refused", "message": str(error), **_NO_TIME, "answer": None}
    ended = run_within(limit, [sys.executable, *_COMMAND], folder)
    code, message = ended.code, ended.last
    row = {"name": name, "seconds": ended.seconds, "wall seconds": ended.wall_seconds}
    verdict = folder / "answer" / "verdict.json"
    if code == 0 and verdict.is_file():
        return {**row, "status": "answered", "message": "", "answer": checked.read_json(verdict)}
    status = "out of time" if code is None else "refused" if code == 1 else "failed"
    return {**row, "status": status, "message": "" if code is None else message, "answer": None}


def _grade(row: dict[str, Any], known: dict[str, Any]) -> dict[str, Any]:
    """The row of the results."""
    answer = row["answer"]
    grade, reasons = grade_answer(known["recordings"][row["name"]], known["groups"], answer)
    effects = [] if answer is None else answer["effects"]
    return {
        "name": row["name"],
        "grade": grade,
        "reasons": reasons
        if answer is not None
        else [row["status"] + (f": {row['message']}" if row["message"] else "")],
        "status": row["status"],
        "verdict": None if answer is None else answer["verdict"],
        "effects": {e["name"]: {k: v["value"] for k, v in e["parameters"].items()} for e in effects},
        "rivals": [] if answer is None else answer["rivals"],
        "closed": measure_closing(answer),
        "overclaims": answer is not None and overclaims(answer),
        "sentence": None if answer is None else answer["sentence"],
        "next_experiment": None if answer is None else answer["next_experiment"],
        "seconds": row["seconds"],
        "wall seconds": row["wall seconds"],
    }


def _print(rows: list[dict[str, Any]]) -> None:
    head = ("recording", "grade", "verdict", "names", "gap closed", "floors left", "s", "why")
    cells = []
    for row in rows:
        done = row["closed"]
        share = ("-" if done["share"] is None else f"{done['share']:.0%}") + " !" * row["overclaims"]
        left = "-" if done["after"] is None else f"{done['after']:.3g}"
        message, names = row["verdict"] or row["status"], ", ".join(row["effects"]) or "-"
        why = "; ".join(row["reasons"])
        cells.append((row["name"], row["grade"], message, names, share, left, f"{row['seconds']:.0f}", why))
    print_table("real recordings", head, cells)
    print(summarise(rows))


if __name__ == "__main__":
    run_cli(main)
