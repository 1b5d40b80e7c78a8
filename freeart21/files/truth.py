"""A truth folder: the ground truth of a sequence, in a folder of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.joint_json import joint_from_json, joint_to_json
from freeart21.files.mesh_file import read_ply, write_ply
from freeart21.truth import Truth

SCHEMA = "freeart21/truth/1"


def write_truth(folder: Path, truth: Truth, n_queries: int) -> None:
    """Write a whole truth folder, with part masks of all frames and `n_queries` query pictures."""
    with atomic.new_folder(folder) as aside:
        joint = truth.articulation.joint
        atomic.write_json(
            aside / "truth.json",
            {
                "schema": SCHEMA,
                "joint": joint_to_json(joint),
                "states": truth.states,
                "state_unit": joint.state_unit,
                "diagonal_m": truth.diagonal,
                "queries": n_queries,
                "source": truth.source,
            },
        )
        np.savez_compressed(
            aside / "poses.npz", T_camera_reference=truth.Ts_camera_reference, T_camera_moving=truth.Ts_camera_moving
        )
        np.savez_compressed(aside / "seen.npz", seen=truth.seen)
        for k, name in enumerate(PARTS):
            write_ply(
                aside / "parts" / f"{name}.ply",
                truth.articulation.part(name),
                {"outer": truth.outer[k], "visible": truth.visible[k]},
            )
        for i in range(len(truth)):
            atomic.write_bytes(aside / "part_mask" / f"{i:05d}.png", checked.encode_png(truth.part_mask(i)))
        for i in range(n_queries):
            atomic.write_bytes(aside / "queries" / "rgb" / f"{i:05d}.png", checked.encode_png(truth.query_rgb(i)))
            mask = truth.query_mask(i).astype(np.uint8) * 255
            atomic.write_bytes(aside / "queries" / "mask" / f"{i:05d}.png", checked.encode_png(mask))


def read_truth(folder: Path) -> Truth:
    """The truth in a truth folder; masks and pictures load lazily."""
    folder = Path(folder)
    header = folder / "truth.json"
    if not checked.is_there(header):
        raise FreeArtError(f"{folder} holds no truth: it has no truth.json")
    data = checked.read_json(header, SCHEMA, folder)
    poses = checked.read_npz(folder / "poses.npz", ("T_camera_reference", "T_camera_moving"), folder)
    parts = [read_ply(folder / "parts" / f"{name}.ply", folder) for name in PARTS]
    for name, (mesh, flags) in zip(PARTS, parts, strict=True):
        if not mesh.empty and not {"outer", "visible"} <= set(flags):
            raise FreeArtError(f"{folder}/parts/{name}.ply has face flags {sorted(flags)}, expected outer and visible")
    no_faces = np.zeros(0, bool)
    return Truth(
        Articulation(joint_from_json(data.get("joint"), header), parts[0][0], parts[1][0]),
        checked.numbers(data, "states", (None,), header),
        poses["T_camera_reference"],
        poses["T_camera_moving"],
        checked.read_npz(folder / "seen.npz", ("seen",), folder)["seen"],
        (parts[0][1].get("outer", no_faces), parts[1][1].get("outer", no_faces)),
        (parts[0][1].get("visible", no_faces), parts[1][1].get("visible", no_faces)),
        lambda i: checked.read_labels(folder / "part_mask" / f"{i:05d}.png", folder),
        lambda i: checked.read_rgb(folder / "queries" / "rgb" / f"{i:05d}.png", folder),
        lambda i: checked.read_labels(folder / "queries" / "mask" / f"{i:05d}.png", folder) > 127,
        data.get("source") or {},
    )
