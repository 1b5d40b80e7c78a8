"""What the faces that nobody saw cost: Chamfer's way back, from an asset to the truth, of seen and of supposed faces.

    .venv/bin/python -m benchmarks.supposed --data out/freeart21-v1 --results out/reconstruct/public/results/ours

reads each answer's asset as strict-2 does, tells its seen faces from its supposed ones (asset.json, `patch`), and
measures the mean distance of points on either from the truth's outer surface, per cent of the object's diagonal.
Walls inside a closed carcass have no outer surface near them: they are dear, however right. Prints a table, dearest
first, and writes benchmarks/results/supposed.json.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import RESULTS, ROOT, format_number, make_table, run_cli, wide_console, write_report
from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.benchmark import read_benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.reconstruction import Failure
from leaderboard.asset_measurement import measure_asset
from leaderboard.matching import match
from leaderboard.protocols.strict1 import STANDARD
from leaderboard.submission import read_submission
from leaderboard.surface import Surface

FILE = "supposed.json"


def measure(sequence: Path, truth_folder: Path, folder: Path) -> list[dict[str, Any]]:
    """Of both parts: the supposed faces' share of the area, and mean distances of either kind, % of the diagonal."""
    truth, recording = read_truth(truth_folder), read_sequence(sequence)
    answer, _ = read_submission(folder, len(recording), recording.camera.height, recording.camera.width)
    if isinstance(answer, Failure):
        raise FreeArtError(f"{folder}: {answer.reason}")
    matched, asset = match(truth, answer, ()), read_asset(folder / "asset")
    measured = measure_asset(folder / "asset", answer.states).shape
    shape = (measured.swapped() if matched.swapped else measured).moved(matched.T_truth_pred)
    anchor, found = matched.answer.anchor, []
    for part, name in enumerate(PARTS):
        own = PARTS[1 - part] if matched.swapped else name
        mesh, patch = shape.parts[part], asset.source["parts"][own].get("patch") or {}
        seen = np.arange(len(mesh.faces)) < patch.get("first_face", len(mesh.faces))
        true = (truth.Ts_camera_reference, truth.Ts_camera_moving)[part][anchor]
        T = matched.answer.Ts_camera_reference[anchor]
        T_truth_part = se3.inverse(true) @ (T if part == 0 else T @ shape.motions[anchor])
        row: dict[str, Any] = {"part": name, "supposed_share": 1 - Surface(mesh, seen).area / Surface(mesh).area}
        for kind, faces in (("seen", seen), ("supposed", ~seen)):
            surface = Surface(mesh, faces)
            points = se3.transform(T_truth_part, surface.sample(STANDARD.samples, (0, part)))
            distances = matched.outer[part].distance(points)
            row[kind] = None if surface.empty else float(100 * distances.mean() / matched.diagonal)
        found.append(row)
    return found


def main(data: Path, results: Path) -> None:
    """Measure every answer of the results folder.

    Args:
        data: Data folder with its truth.
        results: Results folder of the same sequences, with assets.
    """
    benchmark, rows = read_benchmark(data), []
    for name in benchmark.sequences:
        if (results / name / "asset" / "asset.json").is_file():
            place = data / "sequences" / name
            rows += [{"sequence": name, **row} for row in measure(place, benchmark.truth(name), results / name)]
    if not rows:
        raise FreeArtError(f"{results} has an asset of none of {len(benchmark.sequences)} sequences of {data}")
    rows.sort(key=lambda row: -row["supposed_share"] * (row["supposed"] or 0.0))
    share = np.array([row["supposed_share"] for row in rows])
    means = {kind: np.array([row[kind] or 0.0 for row in rows]) for kind in ("seen", "supposed")}
    summary = {
        "parts": len(rows),
        "supposed_share": float(share.mean()),
        "seen_pct": float(means["seen"].mean()),
        "supposed_pct": float(means["supposed"][share > 0].mean()),
        "way_back_pct": float(((1 - share) * means["seen"] + share * means["supposed"]).mean()),
    }
    cells = [
        [row["sequence"], row["part"], f"{100 * row['supposed_share']:.0f}", *(format_number(row[k], 3) for k in means)]
        for row in rows
    ]
    head = ["sequence", "part", "supposed, %", "seen, % of diagonal", "supposed, % of diagonal"]
    wide_console().print(make_table("from the asset to the truth, dearest first", head, cells, ("sequence",)))
    print({key: round(value, 3) for key, value in summary.items()})
    write_report(
        RESULTS / FILE,
        {"data": data.name, "results": results.name, "points": STANDARD.samples},
        rows=rows,
        summary=summary,
    )
    print((RESULTS / FILE).relative_to(ROOT))


if __name__ == "__main__":
    run_cli(main)
