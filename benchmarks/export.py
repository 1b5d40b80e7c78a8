"""Whether exported assets are ready for simulators: of the truth's own geometry, and of a method's reconstructions.

    .venv/bin/python -m benchmarks.export --data data/v1 [--results results/NAME] [--engines sapien mujoco]

exports every sequence's truth as if it were an answer, and the answer in --results where there is one, and measures
each asset from its files: how it stands, its limits, how deep its parts are in each other, its mass, its collision
shapes, its meshes, and which rules of `freeart21 check-asset` it passes in each engine. Prints a table for each of the
two, worst first, and how many assets reach every goal; writes benchmarks/results/export.json (summary, rows, commit,
settings, machine). Rows are kept in --work, keyed by the exporter's code and what was exported: a run that was stopped
goes on.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from rich.console import Console

from benchmarks.common import RESULTS, ROOT, code_of, digest_of, make_table, run_cli, wide_console, write_report
from export.check.checking import check
from export.exporter import ExportSettings, export_result
from export.fidelity import measure_fidelity
from export.outer_surface import sample_outer_surface
from export.penetration import Overlap
from freeart21 import catalog
from freeart21.articulation import Articulation
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.result import read_result
from freeart21.files.truth import read_truth
from freeart21.files.urdf import link_poses
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.truth import Truth
from freeart21.view.link_shapes import ShownUrdf, read_shown
from generator import objects
from generator.motion import PRESETS
from leaderboard.reference import truth_answer

SCHEMA = "freeart21/benchmark-export/1"
DENSITY = 1000.0
"""kg/m^3 of all exports here: a mass then tells a volume, and any other would do."""
STATES = 21
"""Over the joint's range, at which the parts' depth in each other is measured: not those that the exporter looks at."""


@dataclass(frozen=True)
class Goal:
    """What a number should be."""

    column: str
    most: float
    unit: str
    says: str


GOALS = (
    Goal("below_mm", 0.1, "mm", "lowest point from z = 0, joint at zero"),
    Goal("base_mm", 1.0, "mm", "origin from the middle of what it stands on"),
    Goal("up_deg", 5.0, "deg", "z from the maker's up"),
    Goal("beyond", 1.0, "deg or mm", "limits beyond the maker's"),
    Goal("short", 0.0, "deg or mm", "states of the video, by the truth, outside the limits"),
    Goal("deep_mm", 0.5, "mm", "what collides of the parts in each other, anywhere in the range, as the exporter says"),
    Goal("mass_pc", 20.0, "%", "a part's mass from the truth's, at its density"),
    Goal("collision_mm", 0.5, "mm", "surface to collision shapes, median"),
    Goal("collision_worst_mm", 2.0, "mm", "surface to collision shapes, worst"),
    Goal("open_parts", 0.0, "", "parts whose mesh is not closed"),
    Goal("undamped", 0.0, "", "joints that nothing slows"),
    Goal("failed_rules", 0.0, "", "rules of check-asset that fail"),
    Goal("seconds", 60.0, "s", "export"),
)


def main(
    data: Path = ROOT / "data" / "v1",
    results: Path | None = None,
    sequences: tuple[str, ...] = (),
    engines: tuple[str, ...] = (),
    video: bool = True,
    work: Path = ROOT / "out" / "export",
    out: Path | None = None,
) -> None:
    """Measure the exporter.

    Args:
        data: The data folder (`freeart21 record --split public --out data/v1`).
        results: A method's results, of all sequences or some; without them only truths are exported.
        sequences: These alone.
        engines: Engines of check-asset to try; all that are installed when not given.
        video: Bake textures from the videos.
        work: Where assets and rows are kept.
        out: The JSON file. When not given: benchmarks/results/export.json, and only when no sequences are named.
    """
    benchmark = read_benchmark(data)
    console = wide_console()
    tables: dict[str, list[dict[str, Any]]] = {}
    for source in ("truth", "reconstruction") if results else ("truth",):
        rows = []
        for name in benchmark.select_sequences(sequences or None):
            if source == "reconstruction" and results is not None and not (results / name).is_dir():
                console.print(f"{source}: {name}: no result in {results}", highlight=False)
                continue
            rows.append(_row(source, name, benchmark, results, engines, video, work))
            console.print(f"{source}: {name}: {rows[-1]['status']}", highlight=False)
        tables[source] = rows
        _print(console, source, rows)
    if out is None and sequences:
        return
    write_report(
        out or RESULTS / "export.json",
        {"density": DENSITY, "states": STATES, "video": video, "engines": list(engines)},
        summary={source: _count_reached(rows) for source, rows in tables.items()},
        rows=[row for rows in tables.values() for row in rows],
    )


def _row(
    source: str,
    name: str,
    benchmark: Benchmark,
    results: Path | None,
    engines: tuple[str, ...],
    video: bool,
    work: Path,
) -> dict[str, Any]:
    """Export and measure one, unless its row is known."""
    answer = benchmark.truth(name) if results is None or source == "truth" else results / name
    row_file, asset_folder = work / source / f"{name}.json", work / source / name
    parts = sorted(path for path in (answer / "parts").rglob("*") if path.is_file())
    code = [*code_of("export"), Path(__file__)]
    key = digest_of(engines, video, DENSITY, STATES, files=[*code, *parts])
    if row_file.is_file() and (known := checked.read_json(row_file, SCHEMA)).get("key") == key:
        return dict(known["row"])
    row: dict[str, Any] = {"source": source, "object": name}
    try:
        truth = read_truth(benchmark.truth(name))
        result = truth_answer(truth) if source == "truth" else _read(answer)
        begin = time.perf_counter()
        asset = export_result(
            result if source == "truth" else answer,
            asset_folder,
            ExportSettings(density=DENSITY),
            video=benchmark.sequence(name) if video else None,
        )
        row |= {"status": "ok", "seconds": time.perf_counter() - begin}
        row |= figures(asset, result, truth, _volumes(truth))
        report = check(asset_folder, engines or None)
        row |= {
            "failed_rules": float(len(report.not_passed)),
            "failed": [f"{r.rule} ({r.engine}): {r.reason}" for r in report.not_passed],
            "passed_rules": sum(r.verdict == "pass" for r in report.rows),
            "check_seconds": sum(report.seconds.values()),
        }
    except FreeArtError as error:
        row["status"] = str(error).replace(str(work), "WORK")
    atomic.write_json(row_file, {"schema": SCHEMA, "key": key, "row": row})
    return row


def _read(folder: Path) -> Reconstruction:
    read = read_result(folder, appearance=False)
    if isinstance(read, Failure):
        raise FreeArtError(f"a failure, nothing to export: {read.stage}: {read.reason}")
    return read


# --- numbers ----------------------------------------------------------------------------------------------------------


def figures(
    asset: Asset, result: Reconstruction, truth: Truth, volumes: tuple[float, float] | None
) -> dict[str, float | None]:
    """The numbers of an asset, from its files, against its truth.

    Args:
        asset: as read from disk, at `DENSITY`.
        result: what it was made of.
        truth: of its video.
        volumes: m^3 of reference and moving part, or None where nobody knows them.
    """
    shown = read_shown(asset.urdf)
    link = shown.urdf.joints[asset.joint]
    Ts = link_poses(shown.urdf.joints, {**asset.held, asset.joint: 0.0})
    names = (asset.reference_link, asset.moving_link)
    visual = [join_meshes(shown, name, "visuals") for name in names]
    axis = -link.axis if link.child == asset.reference_link else link.axis
    joint = Joint(link.name, _joint_type_of(link.joint_type), axis, np.zeros(3), link.lower, link.upper).moved(
        Ts[link.child]
    )
    parts = Articulation(joint, *(mesh.moved(Ts[name]) for mesh, name in zip(visual, names, strict=True)))
    swapped = are_swapped(result, truth)
    return {
        **_measure_standing(asset, parts, result, truth, swapped),
        **_measure_limits(asset, link.lower, link.upper, result, truth),
        "deep_mm": 1e3 * float(asset.source["penetration"]["deepest_m"]),
        "deep_visual_mm": 1e3 * float(Overlap(parts).max_depths(np.linspace(link.lower, link.upper, STATES)).max()),
        **_solids(asset, shown, volumes[::-1] if volumes and swapped else volumes),
        **_shapes(asset, shown, visual),
        "undamped": float(not (link.damping > 0 or link.friction > 0)),
    }


def _measure_standing(
    asset: Asset, parts: Articulation, result: Reconstruction, truth: Truth, swapped: bool
) -> dict[str, float | None]:
    points = np.concatenate([parts.reference.vertices, parts.moving.vertices])
    low = float(points[:, 2].min())
    base = points[points[:, 2] < low + 1e-3, :2]
    Ts_truth = truth.Ts_camera_moving if swapped else truth.Ts_camera_reference
    first = result.anchor
    up = result.Ts_camera_reference[first, :3, :3].T @ Ts_truth[first, :3, 2]  # the maker's z, in the answer's frame
    cosine = float(np.clip(up @ asset.T_canonical_reference[:3, 2] / np.linalg.norm(up), -1, 1))
    return {
        "below_mm": 1e3 * abs(low),
        "base_mm": 1e3 * float(np.linalg.norm(0.5 * (base.min(0) + base.max(0)))),
        "up_deg": float(np.degrees(np.arccos(cosine))),
    }


def are_swapped(result: Reconstruction, truth: Truth) -> bool:
    """Whether the answer's reference part is the truth's moving one, by the masks of a few frames."""
    agree = [0, 0]
    for i in np.linspace(0, len(truth) - 1, 5).round().astype(int):
        true, answered = truth.part_mask(int(i)), result.part_masks[i]
        agree[0] += int(((true == answered) & (true > 0)).sum())
        agree[1] += int(((true == 3 - answered) & (true > 0) & (answered > 0)).sum())
    return agree[1] > agree[0]


def _measure_limits(
    asset: Asset, lower: float, upper: float, result: Reconstruction, truth: Truth
) -> dict[str, float | None]:
    """How far the limits lie beyond the maker's, and short of what the video showed: deg or mm of true states."""
    true, answered = truth.states, result.states
    sign = 1.0 if np.ptp(answered) == 0 or np.corrcoef(true, answered)[0, 1] >= 0 else -1.0
    shift = float(np.median(true - sign * answered))
    ends = sorted(sign * (q - asset.state_zero) + shift for q in (lower, upper))
    joint = truth.articulation.joint
    unit = float(np.degrees(1)) if joint.type == "revolute" else 1e3
    return {
        "beyond": unit * max(joint.lower - ends[0], ends[1] - joint.upper, 0.0),
        "short": unit * max(ends[0] - float(true.min()), float(true.max()) - ends[1], 0.0),
        "range": unit * (upper - lower),
    }


def _solids(asset: Asset, shown: ShownUrdf, volumes: tuple[float, float] | None) -> dict[str, float | None]:
    masses = [shown.urdf.links[name].inertial for name in (asset.reference_link, asset.moving_link)]
    kilograms = [inertial.mass if inertial else 0.0 for inertial in masses]
    off = [100 * (kg / DENSITY / v - 1) for kg, v in zip(kilograms, volumes, strict=True)] if volumes else []
    return {
        "mass_pc": max(map(abs, off)) if off else None,
        "mass_reference_pc": off[0] if off else None,
        "mass_moving_pc": off[1] if off else None,
    }


def _shapes(asset: Asset, shown: ShownUrdf, visual: list[Mesh]) -> dict[str, float | None]:
    names = (asset.reference_link, asset.moving_link)
    true = [
        measure_fidelity(sample_outer_surface(mesh), [piece.mesh for piece in shown.collisions[name]])
        for name, mesh in zip(names, visual, strict=True)
    ]
    solids = [trimesh.Trimesh(mesh.vertices, mesh.faces, process=False) for mesh in visual]
    return {
        "collision_mm": 1e3 * max(fidelity.median for fidelity in true),
        "collision_worst_mm": 1e3 * max(fidelity.worst for fidelity in true),
        "shapes": float(sum(len(shown.collisions[name]) for name in names)),
        "open_parts": float(sum(not (solid.is_watertight and solid.volume > 0) for solid in solids)),
        "pieces": float(sum(solid.body_count for solid in solids)),
        "vertices_a_face": max(len(mesh.vertices) / len(mesh.faces) for mesh in visual),
    }


def join_meshes(shown: ShownUrdf, link: str, which: str) -> Mesh:
    """All shapes of a link as one mesh of shared positions."""
    meshes = [piece.mesh for piece in getattr(shown, which)[link]]
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, first, strict=False)])
    place, back = np.unique(vertices, axis=0, return_inverse=True)
    return Mesh(place, back.reshape(-1)[faces])


def _joint_type_of(kind: str | None) -> Any:
    if kind is None:
        raise FreeArtError("the asset's joint does not move")
    return kind


def _volumes(truth: Truth) -> tuple[float, float] | None:
    """m^3 of the built-in object's reference and moving part; None for other objects."""
    name, settings = str(truth.source.get("object")), truth.source.get("settings") or {}
    if name not in catalog.built_in_names():
        return None
    model = objects.build(name, int(settings["seed"]))
    diagonal = PRESETS[settings["preset"]].diagonal_m
    model = model if diagonal is None else model.scaled(diagonal / model.diagonal)
    of = {f"link_{k}": sum(p.solid.volume() for p in link.pieces) for k, link in enumerate(model.links)}
    reference, moving = (
        sum(of.get(link, 0.0) for link in truth.source[f"{part}_links"]) for part in ("reference", "moving")
    )
    return reference, moving


# --- tables -----------------------------------------------------------------------------------------------------------


def _count_reached(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """How many rows reach each goal, the median and the worst."""
    found: dict[str, Any] = {"rows": len(rows), "exported": sum(row["status"] == "ok" for row in rows)}
    for goal in GOALS:
        values = [row[goal.column] for row in rows if row.get(goal.column) is not None]
        found[goal.column] = {
            "goal": goal.most,
            "reached": sum(value <= goal.most for value in values),
            "of": len(rows),
            "median": float(np.median(values)) if values else None,
            "worst": float(max(values)) if values else None,
        }
    return found


def _count_missed(row: dict[str, Any]) -> int:
    return sum(row.get(goal.column) is None or row[goal.column] > goal.most for goal in GOALS)


def _print(console: Console, source: str, rows: list[dict[str, Any]]) -> None:
    columns = [goal.column for goal in GOALS] + ["deep_visual_mm", "shapes", "pieces", "vertices_a_face"]
    cells = [
        [row["object"], *("-" if row.get(column) is None else f"{row[column]:.3g}" for column in columns)]
        for row in sorted(rows, key=_count_missed, reverse=True)
    ]
    head = ["object", *(column.replace("_", " ") for column in columns)]
    console.print(make_table(f"of {source}: worst first", head, cells))
    for row in rows:
        if row["status"] != "ok":
            console.print(f"{row['object']}: {row['status']}", highlight=False)
        for failed in row.get("failed", ()):
            console.print(f"{row['object']}: {failed}", highlight=False)
    reached = _count_reached(rows)
    for goal in GOALS:
        one = reached[goal.column]
        worst = "-" if one["worst"] is None else f"{one['worst']:.3g}"
        console.print(
            f"{goal.says}: {one['reached']} of {one['of']} within {goal.most:g} {goal.unit}, worst {worst}",
            highlight=False,
        )


if __name__ == "__main__":
    run_cli(main)
