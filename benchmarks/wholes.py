"""How whole exported assets are: what stands where nobody saw, what collides, and whether an open drawer holds a ball.

    .venv/bin/python -m benchmarks.wholes --data data/short --results results/short [--contact fast]

exports each answer in --results of a built-in object, and measures the asset from its files: per part the voxel IoU of
its visual mesh with the solid of the truth, its mass at the truth's density, its supposed share and its collision
shapes; how deep the visuals and the collision shapes of the two parts are in each other; for sliding joints, whether a
ball dropped into the open part in SAPIEN stays in it while the joint closes; and the processor seconds of the export.
Prints a table, worst IoU first, and writes benchmarks/results/wholes.json (rows, commit, settings, machine).
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.common import RESULTS, ROOT, make_table, run_cli, wide_console, write_report
from benchmarks.export import are_swapped, join_meshes
from export.check.engines.base import Setting
from export.check.engines.sapien_world import load
from export.collision import Contact
from export.exporter import ExportSettings, export_result
from export.penetration import Overlap
from freeart21 import catalog, se3
from freeart21.articulation import PARTS, Articulation
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.benchmark import read_benchmark
from freeart21.files.result import read_result
from freeart21.files.truth import read_truth
from freeart21.files.urdf import link_poses
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.se3 import Array
from freeart21.truth import Truth
from freeart21.view.link_shapes import ShownUrdf, read_shown
from generator import objects
from generator.motion import PRESETS

DENSITY = 1000.0
"""kg/m^3 of all exports: a mass then gives a volume."""
CELLS = 80
"""Voxels along the longer side of a part's box, at whose centres inside and outside are compared."""
STATES = 21
"""Over the joint's range, at which depths are measured."""
FALL_S, CLOSE_S = 1.0, 2.0
"""s that a ball falls, and in which the joint closes."""


def main(
    data: Path,
    results: Path,
    sequences: tuple[str, ...] = (),
    contact: Contact = "fine",
    work: Path = ROOT / "out" / "wholes",
    out: Path | None = None,
) -> None:
    """Measure how whole the assets of a method's results are.

    Args:
        data: The data folder.
        results: The results folder of a method.
        sequences: These alone.
        contact: Collision shapes.
        work: Where assets are written.
        out: The JSON file. When not given: benchmarks/results/wholes.json, and only when no sequences are named.
    """
    benchmark = read_benchmark(data)
    rows = []
    for name in benchmark.select_sequences(sequences or None):
        if (results / name).is_dir():
            row = measure(results / name, benchmark.sequence(name), benchmark.truth(name), work / name, contact)
            rows.append({"object": name, **row})
            print_rows([rows[-1]])
    rows.sort(key=lambda row: min(row.get("iou") or [2.0]))
    print_rows(rows)
    if out is not None or not sequences:
        write_report(
            out or RESULTS / "wholes.json",
            {"density": DENSITY, "cells": CELLS, "states": STATES, "contact": contact},
            rows=rows,
        )


def measure(
    result: Path, sequence: Path, truth_folder: Path, asset_folder: Path, contact: Contact = "fine"
) -> dict[str, Any]:
    """Export one result, and the numbers of the asset; reference part first where there is one per part."""
    truth, answer = read_truth(truth_folder), read_result(result, appearance=False)
    if isinstance(answer, Failure):
        return {"status": f"{answer.stage}: {answer.reason}"}
    clock, wall = time.process_time(), time.perf_counter()
    try:
        asset = export_result(result, asset_folder, ExportSettings(density=DENSITY, contact=contact), video=sequence)
    except FreeArtError as error:
        return {"status": str(error)}
    seconds = {"cpu_s": round(time.process_time() - clock, 1), "wall_s": round(time.perf_counter() - wall, 1)}
    return {"status": "ok", **figures(asset, answer, truth), **seconds}


def figures(asset: Asset, answer: Reconstruction, truth: Truth) -> dict[str, Any]:
    """The numbers of an asset at `DENSITY`, from its files, against the truth; reference part first."""
    row: dict[str, Any] = {}
    shown = read_shown(asset.urdf)
    names = [asset.reference_link, asset.moving_link]
    parts = read_parts(asset, shown)
    solids = true_solids(truth)
    if solids is not None:
        swapped = are_swapped(answer, truth)
        Ts = T_truth_answer(answer, truth, swapped)
        inertials = [shown.urdf.links[name].inertial for name in names]
        solids = solids[::-1] if swapped else solids
        row["iou"] = [
            voxel_iou(mesh.moved(T), solid)
            for mesh, T, solid in zip(read_canonical(asset, shown), Ts, solids, strict=True)
        ]
        row["mass_pc"] = [
            100 * ((i.mass if i else 0.0) / DENSITY / solid.volume - 1)
            for i, solid in zip(inertials, solids, strict=True)
        ]
    states = np.linspace(parts.joint.lower, parts.joint.upper, STATES)
    facts = [asset.source["parts"][name] for name in PARTS]
    row |= {
        "supposed": [each.get("supposed_share", each["patch"]["area_fraction"]) for each in facts],
        "shapes": [len(shown.collisions[name]) for name in names],
        "visual_deep_mm": 1e3 * float(Overlap(parts).max_depths(states).max()),
        "contact_deep_mm": 1e3 * float(asset.source["penetration"]["deepest_m"]),
        "contact_off_mm": [1e3 * each["collision"]["worst_m"] for each in facts],
        "ball": drop_ball(asset, parts) if parts.joint.type == "prismatic" else None,
    }
    return row


# --- the asset and the truth ------------------------------------------------------------------------------------------


def read_parts(asset: Asset, shown: ShownUrdf) -> Articulation:
    """The asset's visual meshes and joint in the frame of its root at joint position zero."""
    link = shown.urdf.joints[asset.joint]
    Ts = link_poses(shown.urdf.joints, {**asset.held, asset.joint: 0.0})
    names = (asset.reference_link, asset.moving_link)
    axis = -link.axis if link.child == asset.reference_link else link.axis
    kind: Any = link.joint_type
    joint = Joint(link.name, kind, axis, np.zeros(3), link.lower, link.upper).moved(Ts[link.child])
    return Articulation(joint, *(join_meshes(shown, name, "visuals").moved(Ts[name]) for name in names))


def read_canonical(asset: Asset, shown: ShownUrdf) -> tuple[Mesh, Mesh]:
    """The asset's visual meshes in the canonical frame of the answer, each at state zero."""
    Ts = link_poses(shown.urdf.joints, {**asset.held, asset.joint: asset.state_zero})
    T = asset.T_canonical_reference @ se3.inverse(Ts[asset.reference_link])
    first, second = (
        join_meshes(shown, k, "visuals").moved(T @ Ts[k]) for k in (asset.reference_link, asset.moving_link)
    )
    return first, second


def true_solids(truth: Truth) -> tuple[trimesh.Trimesh, trimesh.Trimesh] | None:
    """The built-in object's reference and moving part as solids in its canonical frame; None for other objects."""
    from generator.shapes import triangles, union

    name, settings = str(truth.source.get("object")), truth.source.get("settings") or {}
    if name not in catalog.built_in_names():
        return None
    model = objects.build(name, int(settings["seed"]))
    diagonal = PRESETS[settings["preset"]].diagonal_m
    model = model if diagonal is None else model.scaled(diagonal / model.diagonal)
    links = {f"link_{k}": link for k, link in enumerate(model.links)}
    solids = []
    for part in PARTS:
        pieces = [piece.solid for k in truth.source[f"{part}_links"] if k in links for piece in links[k].pieces]
        solids.append(trimesh.Trimesh(*triangles(union(pieces)), process=False))
    return solids[0], solids[1]


def T_truth_answer(answer: Reconstruction, truth: Truth, swapped: bool) -> tuple[Array, Array]:
    """(4, 4) truth's canonical frame from the answer's, by the reference and by the moving part, at the anchor."""
    i = answer.anchor
    true = (truth.Ts_camera_reference[i], truth.Ts_camera_moving[i])
    found = (answer.Ts_camera_reference[i], answer.Ts_camera_moving[i])
    first, second = (se3.inverse(T) @ there for T, there in zip(true[::-1] if swapped else true, found, strict=True))
    return first, second


def voxel_iou(mesh: Mesh, solid: trimesh.Trimesh) -> float:
    """Intersection over union of two solids, by points on a grid over both."""
    mine = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    low = np.minimum(mesh.vertices.min(0), solid.bounds[0])
    high = np.maximum(mesh.vertices.max(0), solid.bounds[1])
    step = float((high - low).max()) / CELLS
    axes = [np.arange(a + 0.5 * step, b, step) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3) + 1e-5 * step
    a, b = mine.contains(points), solid.contains(points)
    return float((a & b).sum() / max((a | b).sum(), 1))


# --- a ball in a drawer -----------------------------------------------------------------------------------------------


def drop_ball(asset: Asset, parts: Articulation) -> bool:
    """Whether a ball dropped in SAPIEN into the open sliding part lies in it when it has come to rest, and still when
    the joint has closed.

    The asset is loaded from its URDF alone, its base fixed. The joint opens to the end that is further from zero. The
    ball's diameter is a quarter of the least side of what then stands out, it falls over the middle of that.
    """
    import sapien

    world = load(asset.urdf, asset.urdf.parent, Setting(fixed=True, gravity=True, floor=False))
    scene, robot = world.scene, world.articulation
    joint = parts.joint
    opened, closed = sorted((joint.lower, joint.upper), key=abs, reverse=True)
    still, moves = parts.posed(np.eye(4), opened)
    base, box = (np.array([m.vertices.min(0), m.vertices.max(0)]) for m in (still, moves))
    along = int(np.argmax(np.abs(joint.axis)))
    forwards = (opened > closed) == (joint.axis[along] > 0)
    out = box.copy()
    if forwards:
        out[0, along] = max(box[0, along], base[1, along])
    else:
        out[1, along] = min(box[1, along], base[0, along])
    size = out[1] - out[0]
    if not size.min() > 0:
        return False
    radius = float(size.min()) / 8
    builder = scene.create_actor_builder()
    builder.add_sphere_collision(radius=radius, density=300.0)
    builder.set_initial_pose(sapien.Pose([*(out.mean(0)[:2]), float(box[1, 2]) + 2 * radius]))
    ball = builder.build()
    hinge = robot.active_joints[0]
    hinge.set_drive_properties(stiffness=1e5, damping=1e4)
    robot.set_qpos(np.array([opened], np.float32))

    def run(seconds: float, start: float, end: float) -> None:
        steps = round(seconds / scene.physx_system.timestep)
        for k in range(steps):
            hinge.set_drive_target(start + (end - start) * (k + 1) / steps)
            scene.step()

    def lies_inside() -> bool:
        here = box + (float(robot.qpos[0]) - opened) * joint.axis
        at = np.asarray(ball.pose.p, float)
        return bool(((at > here[0]) & (at < here[1])).all())

    run(FALL_S, opened, opened)
    if not lies_inside():
        return False
    run(CLOSE_S, opened, closed)
    run(0.5, closed, closed)
    return lies_inside() and abs(float(robot.qpos[0]) - closed) < 0.1 * abs(opened - closed)


# --- tables -----------------------------------------------------------------------------------------------------------


def print_rows(rows: list[dict[str, Any]]) -> None:
    """A table of rows, each part's numbers side by side."""
    columns = (
        "iou",
        "mass_pc",
        "supposed",
        "shapes",
        "visual_deep_mm",
        "contact_deep_mm",
        "contact_off_mm",
        "ball",
        "cpu_s",
    )

    def text(value: Any) -> str:
        if isinstance(value, list):
            return " ".join(text(each) for each in value)
        return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)

    cells = [[row["object"], *(text(row.get(column)) for column in columns)] for row in rows]
    wide_console().print(make_table("", ["object", *columns], cells))
    for row in rows:
        if row["status"] != "ok":
            print(row["object"], row["status"])


if __name__ == "__main__":
    run_cli(main)
