"""What `film` makes of real clips and of captures that users' cameras write, and whether that holds.

    .venv/bin/python -m benchmarks.real_video [--limit 1800] [--names kinect_tube] [--gaussians]

films every clip of ../shared that is at hand, each in a process of its own, and grades what it delivered by what was
known beforehand (real_video_expected.json: type, travel, axis, and why):

    right      the joint holds and is called sound; where nothing moves, no asset is called sound
    doubted    the joint holds and is called doubtful
    silent     no answer, or a doubtful one that does not hold
    wrong      a joint that does not hold, called sound

Prints the table, worst first, and writes benchmarks/results/real_video.json. May be killed and goes on.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import (
    RESULTS,
    ROOT,
    SHARED,
    commit,
    digest_of,
    keep_row,
    print_table,
    run_cli,
    run_within,
    write_report,
)
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.result import read_result
from freeart21.reconstruction import Reconstruction

EXPECTED = ROOT / "benchmarks" / "real_video_expected.json"
GRADES = ("wrong", "silent", "doubted", "right")


def main(
    limit: float = 1800.0,
    names: tuple[str, ...] = (),
    gaussians: bool = False,
    work: Path = ROOT / "out" / "real_video",
    out: Path | None = None,
) -> None:
    """Film and grade.

    Args:
        limit: Seconds of processor time that a clip may take.
        names: These clips alone.
        gaussians: Refine by Gaussians.
        work: Where all is kept; what is there already is used.
        out: The JSON file. When not given: benchmarks/results/real_video.json, and only when all clips are filmed.
    """
    known: dict[str, Any] = checked.read_json(EXPECTED)["clips"]
    here = [name for name in known if (SHARED / known[name]["path"]).is_dir()]
    unknown = sorted(set(names) - set(here))
    if unknown:
        raise FreeArtError(f"there is no clip {', '.join(unknown)}; there are {', '.join(here) or 'none'}")
    rows = []
    for name in [name for name in here if not names or name in names]:
        key = digest_of(limit, gaussians, known[name], commit("reconstruct", "freeart21", "export"))
        row = keep_row(work / f"{name}.json", key, lambda name=name: _film(known[name], work / name, limit, gaussians))
        grade, reasons = grade_clip(known[name], row)
        rows.append({"clip": name, "grade": grade, "reasons": reasons, **row})
        print(f"{name}: {grade} ({row['seconds']:.0f} s)", flush=True)
    rows.sort(key=lambda row: GRADES.index(row["grade"]))
    _print(rows)
    if out is None and len(rows) == len(known):
        out = RESULTS / "real_video.json"
    if out is not None:
        counts = {grade: sum(row["grade"] == grade for row in rows) for grade in reversed(GRADES)}
        write_report(out, {"limit": limit, "gaussians": gaussians}, summary=counts, rows=rows)


def _film(clip: dict[str, Any], folder: Path, limit: float, gaussians: bool) -> dict[str, Any]:
    """What `film` delivered of a clip, read from its files, and how long that took."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    masks = ["--masks", "auto"] if clip["masks"] == "auto" else []
    refined = "--gaussians" if gaussians else "--no-gaussians"
    words = ["-m", "freeart21", "film", str(SHARED / clip["path"]), "--out", "film", *masks, refined]
    ended = run_within(limit, [sys.executable, *words], folder)
    row: dict[str, Any] = {
        "seconds": ended.seconds,
        "exit": ended.code,
        "last": "out of time" if ended.code is None else ended.last.replace(str(SHARED), "").replace(str(folder), ""),
        "asset": (folder / "film" / "result" / "asset" / "asset.json").is_file(),
        "type": None,
    }
    if not (folder / "film" / "result" / "prediction.json").is_file():
        return row
    answer = read_result(folder / "film" / "result", appearance=False)
    if not isinstance(answer, Reconstruction):
        return row | {"last": f"{answer.stage}: {answer.reason}"}
    joint, span = answer.articulation.joint, float(np.ptp(answer.states[np.isfinite(answer.states)]))
    axis = answer.Ts_camera_reference[0][:3, :3] @ joint.axis
    return row | {
        "type": joint.type,
        "travel": round(float(np.degrees(span)), 2) if joint.type == "revolute" else round(span, 4),
        "axis": [round(float(x), 3) for x in axis / np.linalg.norm(axis)],
        "trust": None if answer.trust is None else answer.trust.verdict,
    }


def grade_clip(known: dict[str, Any], row: dict[str, Any]) -> tuple[str, list[str]]:
    """Grade and reasons of what was delivered (`row`, of `_film`)."""
    sound = row["type"] is not None and row["trust"] == "sound"
    if known["type"] == "nothing":
        return ("wrong", [f"a sound {row['type']} joint of what does not move"]) if sound else ("right", [])
    if row["type"] is None:
        return "silent", [row["last"]]
    faults = []
    if row["type"] != known["type"]:
        faults.append(f"{row['type']}, expected {known['type']}")
    elif not known["travel"][0] <= row["travel"] <= known["travel"][1]:
        faults.append(f"travel {row['travel']:g}, expected {known['travel'][0]:g} to {known['travel'][1]:g}")
    if "axis" in known:
        along = abs(np.dot(known["axis"], row["axis"])) / np.linalg.norm(known["axis"])
        off = float(np.degrees(np.arccos(min(along, 1.0))))
        if off > known["axis_within"]:
            faults.append(f"axis {off:.0f} degrees off, expected at most {known['axis_within']}")
    if faults:
        return ("wrong" if sound else "silent"), faults
    return ("right" if sound else "doubted"), []


def _print(rows: list[dict[str, Any]]) -> None:
    head = ("clip", "grade", "type", "travel", "trust", "asset", "s", "why")
    cells = [
        (
            row["clip"],
            row["grade"],
            row["type"] or "-",
            f"{row['travel']:g}" if row["type"] else "-",
            row.get("trust") or "-",
            "yes" if row["asset"] else "no",
            f"{row['seconds']:.0f}",
            "; ".join(row["reasons"]),
        )
        for row in rows
    ]
    print_table("real clips", head, cells)


if __name__ == "__main__":
    run_cli(main)
