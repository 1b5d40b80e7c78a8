"""How good exported assets are, from their files alone: whole, of the right mass, sound in every engine, light.

    .venv/bin/python -m benchmarks.assets --data out/freeart21-v1 --results out/reconstruct/public/results/ours

exports each answer in --results and measures the asset. Per part: the voxel IoU of its visual mesh with the solid of
the truth, its mass at the truth's density, the share of faces that nobody saw, how far seen and supposed faces lie from
the truth's outer surface, and how far the collision shapes lie from the visual mesh. Of the whole: how deep the parts
are in each other, how it stands, its limits, the rules of `freeart21 check-asset` that fail in each engine, steps a
processor second in SAPIEN against the object's own hulls, for drawers whether a ball that is dropped into the open one
stays in it while it closes, and the processor seconds of the export. True solids, hulls and drawers are known of
built-in objects.

Prints a table, worst first, and how many reach each goal; writes benchmarks/results/assets.json (summary, rows, commit,
settings, machine). Assets and rows are kept in --work as long as the exporter's commit and the answer's files are the
same: a run that was stopped goes on.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.common import RESULTS, ROOT, commit, digest_of, print_table, run_cli, run_rows, write_report
from export.check.checking import check
from export.check.engines.base import Setting
from export.check.engines.sapien_world import load
from export.contact import read_link_shapes
from export.exporter import export_result
from export.preview import colours_at, project_link
from export.settings import Contact, ExportSettings
from freeart21 import catalog, se3
from freeart21.articulation import PARTS, Articulation
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.benchmark import read_benchmark
from freeart21.files.certificate import read_certificate
from freeart21.files.result import read_result
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.files.urdf import link_poses, read_urdf
from freeart21.joint import Joint
from freeart21.mesh import Mesh, join_meshes
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.truth import Truth
from freeart21.view.link_shapes import ShownUrdf, read_shown
from freeart21.z_buffer import draw_triangles
from generator import objects
from generator.model import ObjectModel
from generator.motion import PRESETS
from generator.partnet_writer import write_partnet
from leaderboard.asset_measurement import measure_asset
from leaderboard.matching import match
from leaderboard.protocols.strict import STANDARD
from leaderboard.submission import read_submission
from leaderboard.surface import Surface

FILE = "assets.json"
DENSITY = 1000.0
"""kg/m^3 of all exports: a mass then gives a volume."""
CELLS = 80
"""Voxels along the longest side of a true part's box, at whose centres inside and outside are compared."""
FALL_S, CLOSE_S = 1.0, 2.0
"""s that a ball falls, and in which the joint closes."""
SETTLE_STEPS, TIMED_STEPS = 250, 500
"""Steps of 2 ms that an asset falls and settles, and that are timed then."""


@dataclass(frozen=True)
class Goal:
    """What a number should be at most, or at least."""

    column: str
    bound: float
    says: str
    at_least: bool = False

    def is_met(self, row: dict[str, Any]) -> bool:
        """By every number of the row's column; not by a missing one."""
        values = numbers_of(row, self.column)
        return bool(values) and all(v >= self.bound if self.at_least else v <= self.bound for v in values)


GOALS = (
    Goal("failed_rules", 0, "rules of check-asset that fail"),
    Goal("mass_pc", 20, "a part's mass from the truth's, at its density, %"),
    Goal("ball", 1, "a ball stays in the open drawer while it closes", at_least=True),
    Goal("visual_deep_mm", 1, "visual meshes in each other, mm"),
    Goal("contact_deep_mm", 0.5, "collision shapes in each other, mm"),
    Goal("contact_mm", 0.6, "surface to collision shapes, median, mm"),
    Goal("contact_worst_mm", 2, "surface to collision shapes, worst, mm"),
    Goal("speed", 0.8, "steps a processor s over those of the object's own hulls", at_least=True),
    Goal("supposed_psnr", 20, "held-out views of supposed faces, dB", at_least=True),
    Goal("cpu_s", 60, "export, processor s"),
    Goal("up_deg", 5, "z from the maker's up, deg"),
    Goal("beyond", 1, "limits beyond the maker's, deg or mm"),
    Goal("short", 0, "states of the video, by the truth, outside the limits, deg or mm"),
)


def main(
    data: Path,
    results: Path,
    sequences: tuple[str, ...] = (),
    contact: Contact = "fine",
    workers: int = 1,
    work: Path = ROOT / "out" / "assets",
    out: Path | None = None,
) -> None:
    """Measure the assets of a method's results.

    Args:
        data: The data folder.
        results: The results folder of a method.
        sequences: These alone.
        contact: Collision shapes.
        workers: Answers that are exported side by side.
        work: Where assets and rows are kept.
        out: The JSON file. When not given: benchmarks/results/assets.json, and only when no sequences are named.
    """
    benchmark = read_benchmark(data)
    names = [name for name in benchmark.select_sequences(sequences or None) if (results / name).is_dir()]
    if not names:
        raise FreeArtError(f"{results} has an answer of no sequence of {data}")
    rows = make_rows(
        {name: (results / name, benchmark.sequence(name), benchmark.truth(name)) for name in names},
        contact, work, workers,
    )  # fmt: skip
    print_rows(rows)
    summary = sum_up(rows)
    for goal in GOALS:
        its = summary[goal.column]
        print(f"{goal.says}: {its['reached']} of {its['of']} reach {goal.bound:g}, worst {its['worst']}")
    if out is not None or not sequences:
        settings = {"data": data.name, "results": results.name, "contact": contact, "density": DENSITY, "cells": CELLS}
        write_report(out or RESULTS / FILE, settings, summary=summary, rows=rows)


def make_rows(
    answers: dict[str, tuple[Path, Path, Path]], contact: Contact, work: Path, workers: int
) -> list[dict[str, Any]]:
    """Rows of answers, by name its result, sequence and truth folder; those that miss most goals first."""
    todo = {}
    for name, places in answers.items():
        files = sorted(places[0].glob("*.json")) + sorted((places[0] / "parts").rglob("*.*"))
        key = digest_of(contact, DENSITY, CELLS, commit("export", "benchmarks/assets.py"), files=files)
        todo[name] = (key, measure, (*places, work / name, contact))
    rows = []
    for name, row in run_rows(work, todo, workers).items():
        status = row.get("crash", "ok").replace(str(work), "WORK").replace(str(answers[name][0].parent), "RESULTS")
        rows.append({"object": name, "status": status, **({} if "crash" in row else row)})
    return sorted(rows, key=lambda row: sum(is_missed(goal, row) for goal in GOALS), reverse=True)


def measure(result: Path, sequence: Path, truth_folder: Path, folder: Path, contact: Contact) -> dict[str, Any]:
    """Export one answer into `folder`, and the numbers of the asset."""
    truth, answer = read_truth(truth_folder), read_result(result, appearance=False)
    if isinstance(answer, Failure):
        raise FreeArtError(f"a failure, nothing to export: {answer.stage}: {answer.reason}")
    clock = time.process_time()
    export_result(result, folder, ExportSettings(density=DENSITY, contact=contact), video=sequence)
    seconds = time.process_time() - clock
    report = check(folder)
    tried = [engine for engine, version in report.engines.items() if version != "not installed"]
    return {
        "cpu_s": round(seconds, 1),
        **figures(read_asset(folder), answer, truth),
        **supposed_faces(result, truth, folder),
        **supposed_views(read_asset(folder), answer, truth, read_sequence(sequence)),
        "engines": tried,
        "failed_rules": len(report.not_passed),
        "failed": [f"{row.rule} ({row.engine}): {row.reason}" for row in report.not_passed],
    }


# --- numbers; of the reference part first where there is one a part ---------------------------------------------------


def figures(asset: Asset, answer: Reconstruction, truth: Truth) -> dict[str, Any]:
    """The numbers of an asset at `DENSITY`, from its files, against the truth."""
    shown, certificate = read_shown(asset.urdf), read_certificate(asset.urdf.parent)
    if certificate is None:
        raise FreeArtError(f"{asset.urdf.parent} has no certificate")
    names = [asset.reference_link, asset.moving_link]
    parts, swapped, model = read_parts(asset, shown), are_swapped(answer, truth), true_model(truth)
    contact = [certificate.links[name].contact for name in names]
    row: dict[str, Any] = {
        "visual_deep_mm": 1e3 * certificate.visual_overlap_m,
        "contact_deep_mm": 1e3 * certificate.contact_overlap_m,
        "contact_mm": [1e3 * its["median_m"] for its in contact],
        "contact_worst_mm": [1e3 * its["worst_m"] for its in contact],
        "shapes": [len(shown.collisions[name]) for name in names],
        **measure_standing(asset, parts, answer, truth, swapped),
        **measure_limits(asset, parts.joint, answer, truth),
    }
    if model is None:
        return row
    solids = true_solids(truth, model)
    solids = solids[::-1] if swapped else solids
    Ts = T_truth_answer(answer, truth, swapped)
    masses = [certificate.links[name].mass_kg for name in names]
    row["iou"] = [
        voxel_iou(mesh.moved(T), solid) for mesh, T, solid in zip(read_canonical(asset, shown), Ts, solids, strict=True)
    ]
    row["mass_pc"] = [100 * (kg / DENSITY / solid.volume - 1) for kg, solid in zip(masses, solids, strict=True)]
    with tempfile.TemporaryDirectory() as folder:
        own = write_partnet(model, Path(folder) / "own")
        row["speed"] = count_steps(asset.urdf) / count_steps(own / "mobility.urdf")
    if catalog.find(str(truth.source["object"])).category == "StorageFurniture":
        row["ball"] = int(drop_ball(asset, parts))
    return row


def measure_standing(
    asset: Asset, parts: Articulation, answer: Reconstruction, truth: Truth, swapped: bool
) -> dict[str, float]:
    """Degrees between the asset's z and the maker's."""
    Ts_truth = truth.Ts_camera_moving if swapped else truth.Ts_camera_reference
    first = answer.anchor
    up = answer.Ts_camera_reference[first, :3, :3].T @ Ts_truth[first, :3, 2]  # the maker's z, in the answer's frame
    cosine = float(np.clip(up @ asset.T_canonical_reference[:3, 2] / np.linalg.norm(up), -1, 1))
    return {"up_deg": float(np.degrees(np.arccos(cosine)))}


def measure_limits(asset: Asset, joint: Joint, answer: Reconstruction, truth: Truth) -> dict[str, float]:
    """How far the limits lie beyond the maker's, and short of what the video showed: deg or mm of true states."""
    true, answered = truth.states, answer.states
    sign = 1.0 if np.ptp(answered) == 0 or np.corrcoef(true, answered)[0, 1] >= 0 else -1.0
    shift = float(np.median(true - sign * answered))
    low, high = sorted(sign * (q - asset.state_zero) + shift for q in (joint.lower, joint.upper))
    own = truth.articulation.joint
    unit = float(np.degrees(1)) if own.type == "revolute" else 1e3
    return {
        "beyond": unit * max(own.lower - low, high - own.upper, 0.0),
        "short": unit * max(low - float(true.min()), float(true.max()) - high, 0.0),
    }


def supposed_faces(result: Path, truth: Truth, folder: Path) -> dict[str, list[float | None]]:
    """Of both parts: the supposed faces' share of the area, and the mean distance of seen and of supposed faces from
    the truth's outer surface, % of the diagonal.

    Walls inside a closed carcass have no outer surface near them: they are dear, however right.
    """
    frames, height, width = len(truth), *truth.part_mask(0).shape
    answer, _ = read_submission(result, frames, height, width)
    if isinstance(answer, Failure):
        raise FreeArtError(f"{result}: {answer.reason}")
    matched, asset = match(truth, answer, ()), read_asset(folder)
    measured = measure_asset(folder, answer.states).shape
    shape = (measured.swapped() if matched.swapped else measured).moved(matched.T_truth_pred)
    anchor = matched.answer.anchor
    found: dict[str, list[float | None]] = {"supposed": [], "seen_off_pc": [], "supposed_off_pc": []}
    for part, name in enumerate(PARTS):
        own = PARTS[1 - part] if matched.swapped else name
        mesh, patch = shape.parts[part], asset.source["parts"][own].get("patch") or {}
        seen = np.arange(len(mesh.faces)) < patch.get("first_face", len(mesh.faces))
        true = (truth.Ts_camera_reference, truth.Ts_camera_moving)[part][anchor]
        T = matched.answer.Ts_camera_reference[anchor]
        T_truth_part = se3.inverse(true) @ (T if part == 0 else T @ shape.motions[anchor])
        found["supposed"].append(1 - Surface(mesh, seen).area / Surface(mesh).area)
        for kind, faces in (("seen_off_pc", seen), ("supposed_off_pc", ~seen)):
            surface = Surface(mesh, faces)
            points = se3.transform(T_truth_part, surface.sample(STANDARD[1].samples, (0, part)))
            off = None if surface.empty else 100 * matched.outer[part].distance(points).mean() / matched.diagonal
            found[kind].append(None if off is None else float(off))
    return {kind: values[::-1] if matched.swapped else values for kind, values in found.items()}


def supposed_views(asset: Asset, answer: Reconstruction, truth: Truth, recording: Recording) -> dict[str, float | None]:
    """PSNR, dB, of the asset's textured meshes in the held-out views, over the truth's pixels that show seen faces, and
    over those that show supposed ones; and these pixels' share."""
    shown = read_shown(asset.urdf)
    first = {
        link: (asset.source["parts"][name].get("patch") or {}).get("first_face", np.inf)
        for link, name in ((asset.reference_link, "reference"), (asset.moving_link, "moving"))
    }
    errors: list[list[Array]] = [[], []]
    for i, query in enumerate(recording.queries):
        mask, picture = truth.query_mask(i), truth.query_rgb(i).astype(float)
        Ts = link_poses(
            shown.urdf.joints, {**asset.held, asset.joint: answer.states[query.state_of_frame] + asset.state_zero}
        )
        T = query.T_newcam_cam @ answer.Ts_camera_reference[query.pose_of_frame] @ asset.T_canonical_reference
        T = T @ se3.inverse(Ts[asset.reference_link])
        nearest, colour, supposed = np.full(mask.shape, np.inf), np.zeros((*mask.shape, 3)), np.zeros(mask.shape, int)
        for link in shown.visuals:
            for points, faces, marks, image in project_link(shown, link, T @ Ts[link], np.eye(3)):
                face, weights = np.full(mask.shape, -1), np.zeros((*mask.shape, 3))
                draw_triangles(recording.camera.project(points), points[:, 2].copy(), faces, nearest, face, weights)
                drawn = face >= 0
                colour[drawn] = colours_at(weights[drawn], marks[faces[face[drawn]]], image)
                supposed[drawn] = 1 + (face[drawn] >= first[link])
        error = ((colour - picture) ** 2).mean(-1)
        for kind in (0, 1):
            errors[kind].append(error[mask & (supposed == 1 + kind)])
    seen, never = (np.concatenate(its) if its else np.zeros(0) for its in errors)
    return {
        "seen_psnr": _decibels(seen),
        "supposed_psnr": _decibels(never),
        "supposed_pixels": len(never) / max(len(never) + len(seen), 1),
    }


def _decibels(squares: Array) -> float | None:
    """Of squared errors of 8-bit colours; None without any, or where nothing is off."""
    return float(10 * np.log10(255**2 / squares.mean())) if squares.any() else None


# --- the asset and the truth ------------------------------------------------------------------------------------------


def read_parts(asset: Asset, shown: ShownUrdf) -> Articulation:
    """The asset's visual meshes and joint in the frame of its root at joint position zero."""
    link = shown.urdf.joints[asset.joint]
    Ts = link_poses(shown.urdf.joints, {**asset.held, asset.joint: 0.0})
    names = (asset.reference_link, asset.moving_link)
    axis = -link.axis if link.child == asset.reference_link else link.axis
    kind: Any = link.joint_type
    joint = Joint(link.name, kind, axis, np.zeros(3), link.lower, link.upper).moved(Ts[link.child])
    return Articulation(joint, *(join_visuals(shown, name).moved(Ts[name]) for name in names))


def read_canonical(asset: Asset, shown: ShownUrdf) -> tuple[Mesh, Mesh]:
    """The asset's visual meshes in the canonical frame of the answer, each at state zero."""
    Ts = link_poses(shown.urdf.joints, {**asset.held, asset.joint: asset.state_zero})
    T = asset.T_canonical_reference @ se3.inverse(Ts[asset.reference_link])
    first, second = (join_visuals(shown, k).moved(T @ Ts[k]) for k in (asset.reference_link, asset.moving_link))
    return first, second


def join_visuals(shown: ShownUrdf, link: str) -> Mesh:
    """The visual shapes of a link as one mesh of shared positions."""
    mesh = join_meshes([piece.mesh for piece in shown.visuals[link]])
    place, back = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return Mesh(place, back.reshape(-1)[mesh.faces])


def are_swapped(answer: Reconstruction, truth: Truth) -> bool:
    """Whether the answer's reference part is the truth's moving one, by the masks of a few frames."""
    agree = [0, 0]
    for i in np.linspace(0, len(truth) - 1, 5).round().astype(int):
        true, answered = truth.part_mask(int(i)), answer.part_masks[i]
        agree[0] += int(((true == answered) & (true > 0)).sum())
        agree[1] += int(((true == 3 - answered) & (true > 0) & (answered > 0)).sum())
    return agree[1] > agree[0]


def true_model(truth: Truth) -> ObjectModel | None:
    """The built-in object that was recorded, at its size; None for other objects."""
    name, settings = str(truth.source.get("object")), truth.source.get("settings") or {}
    if name not in catalog.built_in_names():
        return None
    model = objects.build(name, int(settings["seed"]))
    diagonal = PRESETS[settings["preset"]].diagonal_m
    return model if diagonal is None else model.scaled(diagonal / model.diagonal)


def true_solids(truth: Truth, model: ObjectModel) -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """The reference and the moving part of a built-in object as solids in its canonical frame."""
    from generator.shapes import triangles, union

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
    """Intersection over union of a mesh and a true solid, by points on a lattice that the solid alone places.

    On another lattice thin walls count otherwise.
    """
    mine = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    step = float(np.ptp(solid.bounds, axis=0).max()) / CELLS
    low = np.floor(np.minimum(mesh.vertices.min(0) - solid.bounds[0], 0) / step)
    high = np.ceil((np.maximum(mesh.vertices.max(0), solid.bounds[1]) - solid.bounds[0]) / step)
    cells = np.meshgrid(*(np.arange(*ends) + 0.5 for ends in zip(low, high, strict=True)), indexing="ij")
    points = solid.bounds[0] + step * np.stack(cells, -1).reshape(-1, 3) + 1e-5 * step
    a, b = mine.contains(points), solid.contains(points)
    return float((a & b).sum() / max((a | b).sum(), 1))


# --- in SAPIEN --------------------------------------------------------------------------------------------------------


def count_steps(urdf: Path) -> float:
    """Steps of 2 ms a processor second of a URDF that fell from 1 cm onto a plane and settled there, its joint free."""
    read, (_, collisions) = read_urdf(urdf), read_link_shapes(urdf)
    Ts = read.link_poses({name: float(np.clip(0, j.lower, j.upper)) for name, j in read.joints.items() if j.joint_type})
    low = min(se3.transform(Ts[link] @ T, m.vertices)[:, 2].min() for link, of in collisions.items() for T, m in of)
    world = load(urdf, urdf.parent, Setting(fixed=False, gravity=True, floor=True))
    world.put({})
    world.place(se3.pose(np.eye(3), np.array([0.0, 0.0, 0.01 - low])))
    step = world.scene.physx_system.timestep
    world.advance(SETTLE_STEPS * step)
    clock = time.process_time()
    world.advance(TIMED_STEPS * step)
    return TIMED_STEPS / (time.process_time() - clock)


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


def numbers_of(row: dict[str, Any], column: str) -> list[float]:
    """The sizes of a row's numbers in a column: none, one, or one a part."""
    value = row.get(column)
    return [abs(each) for each in (value if isinstance(value, list) else [value]) if each is not None]


def is_missed(goal: Goal, row: dict[str, Any]) -> bool:
    """Whether a row has numbers for the goal, or no asset, and does not meet it."""
    return not goal.is_met(row) and (row["status"] != "ok" or bool(numbers_of(row, goal.column)))


def sum_up(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Goal to how many rows reach it, of how many that it concerns, the median and the worst."""
    found: dict[str, Any] = {}
    for goal in GOALS:
        worst_of: Callable[[list[float]], float] = min if goal.at_least else max
        values = [worst_of(numbers_of(row, goal.column)) for row in rows if numbers_of(row, goal.column)]
        missed = sum(is_missed(goal, row) for row in rows)
        met = sum(goal.is_met(row) for row in rows)
        found[goal.column] = {
            "goal": goal.bound,
            "reached": met,
            "of": met + missed,
            "median": float(np.median(values)) if values else None,
            "worst": float(worst_of(values)) if values else None,
        }
    return found


def print_rows(rows: list[dict[str, Any]]) -> None:
    """A table of rows, each part's numbers side by side; then what is no number."""
    columns = (*(goal.column for goal in GOALS), "iou", "shapes", "supposed")

    def text(value: Any) -> str:
        if isinstance(value, list):
            return " ".join(text(each) for each in value)
        return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)

    cells = [[row["object"], *(text(row.get(column)) for column in columns)] for row in rows]
    print_table("assets", ["object", *columns], cells)
    for row in rows:
        if row["status"] != "ok":
            print(row["object"], row["status"])
        for failed in row.get("failed", ()):
            print(row["object"], failed)


if __name__ == "__main__":
    run_cli(main)
