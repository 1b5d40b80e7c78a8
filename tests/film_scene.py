"""A clean film of a two-part object, cast by rays of trimesh, with its truth and its asset: no renderer of ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.files.sequence import write_sequence
from freeart21.files.truth import write_truth
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.recording import Frame, Recording
from freeart21.truth import Truth

FRAMES, WIDTH, HEIGHT = 45, 128, 96
CAMERA = Camera(np.array([[120.0, 0, 64], [0, 120, 48], [0, 0, 1]]), WIDTH, HEIGHT)
HINGE = Joint("lid", "revolute", np.array([0.0, 1, 0]), np.array([-0.1, 0, 0.05]), 0.0, 1.2)


def _boxes(knob: bool) -> tuple[list[tuple[trimesh.Trimesh, tuple[float, ...]]], ...]:
    """Base and lid as boxes with a colour each, the lid with a knob on it."""

    def box(size: tuple[float, ...], at: tuple[float, ...], colour: tuple[float, ...]):
        mesh = trimesh.creation.box(size)
        mesh.apply_translation(at)
        return mesh, colour

    base = [
        box((0.2, 0.14, 0.06), (0, 0, 0.02), (0.75, 0.55, 0.3)),
        box((0.06, 0.1, 0.05), (0.12, 0, 0.02), (0.12, 0.1, 0.14)),
        box((0.1, 0.04, 0.04), (0, 0.08, 0.02), (0.35, 0.6, 0.55)),
    ]
    lid = [
        box((0.19, 0.13, 0.02), (0, 0, 0.06), (0.3, 0.5, 0.8)),
        box((0.1, 0.05, 0.012), (0.02, 0.02, 0.075), (0.15, 0.12, 0.1)),
        box((0.05, 0.03, 0.015), (-0.05, -0.03, 0.077), (0.85, 0.82, 0.7)),
    ]
    if knob:
        lid.append(box((0.04, 0.04, 0.05), (0.07, -0.04, 0.095), (0.6, 0.25, 0.2)))
    return base, lid


def _motion() -> tuple[np.ndarray, np.ndarray]:
    """Poses (n, 4, 4) and states: the object is turned about, comes and goes, and the lid opens and closes."""
    Ts, states = [], []
    for i in range(FRAMES):
        s = i / 44  # of a turn of one and a half seconds
        R = se3.exp_so3([0.8 + 0.6 * np.sin(4 * s), 0.6 * np.sin(5 * s + 1), 2.5 * s]) @ se3.exp_so3([np.pi, 0, 0])
        t = np.array([0.05 * np.sin(6 * s), 0.04 * np.cos(5 * s), 0.45 + 0.08 * np.sin(6 * s)])
        Ts.append(se3.pose(R, t))
        states.append(0.6 - 0.6 * np.cos(6 * s))
    return np.stack(Ts), np.array(states)


def _cast(parts, poses) -> Frame:
    """One picture: the first hit of the ray through every pixel's centre."""
    rays = CAMERA.rays().reshape(-1, 3)
    pieces = [
        (mesh.copy().apply_transform(T), colour)
        for boxes, T in zip(parts, poses, strict=True)
        for mesh, colour in boxes
    ]
    whole = trimesh.util.concatenate([mesh for mesh, _ in pieces])
    colours = np.concatenate([np.tile(colour, (len(mesh.faces), 1)) for mesh, colour in pieces])
    hit, ray = whole.ray.intersects_id(np.zeros_like(rays), rays, multiple_hits=False)
    n, p = whole.face_normals[hit], whole.triangles[hit][:, 0]
    z = (n * p).sum(1) / (n * rays[ray]).sum(1)
    depth, rgb = np.zeros(len(rays), np.float32), np.zeros((len(rays), 3), np.uint8)
    depth[ray], rgb[ray] = z, np.rint(255 * colours[hit])
    shape = (HEIGHT, WIDTH)
    return Frame(rgb.reshape(*shape, 3), depth.reshape(shape), depth.reshape(shape) > 0)


def _obj(path: Path, boxes) -> None:
    """The boxes as one OBJ with vertex colours."""
    lines, count = [], 0
    for mesh, colour in boxes:
        lines += [f"v {x:.9f} {y:.9f} {z:.9f} {colour[0]} {colour[1]} {colour[2]}" for x, y, z in mesh.vertices]
        lines += [f"f {a + 1 + count} {b + 1 + count} {c + 1 + count}" for a, b, c in mesh.faces]
        count += len(mesh.vertices)
    path.write_text("\n".join(lines) + "\n")


def film_with_truth(folder: Path, knob: bool = True, only_asset: bool = False) -> tuple[Path, Path]:
    """Asset (a URDF) and sequence folder of a clean film; `knob` is whether the asset has the lid's knob."""
    asset = folder / "asset"
    asset.mkdir(parents=True)
    base, lid = _boxes(knob)
    _obj(asset / "base.obj", base)
    hinge = np.eye(4)
    hinge[:3, 3] = -HINGE.pivot
    _obj(asset / "lid.obj", [(mesh.copy().apply_transform(hinge), colour) for mesh, colour in lid])
    at = " ".join(f"{v:g}" for v in HINGE.pivot)
    (asset / "thing.urdf").write_text(
        '<robot name="thing"><link name="base"><visual><geometry><mesh filename="base.obj"/></geometry></visual></link>'
        '<link name="lid"><visual><geometry><mesh filename="lid.obj"/></geometry></visual></link>'
        f'<joint name="lid_joint" type="revolute"><parent link="base"/><child link="lid"/><origin xyz="{at}"/>'
        '<axis xyz="0 1 0"/><limit lower="0" upper="1.2" effort="1" velocity="1"/></joint></robot>'
    )
    sequence = folder / "data" / "sequences" / "thing"
    if only_asset:
        return asset, sequence
    parts = _boxes(knob=True)
    Ts, states = _motion()
    moving = Ts @ HINGE.transform(states)
    frames = [_cast(parts, poses) for poses in zip(Ts, moving, strict=True)]
    write_sequence(sequence, Recording(CAMERA, np.arange(FRAMES) / 30, frames.__getitem__), 1e-5)
    meshes = []
    for boxes in parts:
        whole = trimesh.util.concatenate([mesh for mesh, _ in boxes])
        meshes.append(Mesh(whole.vertices, whole.faces))
    yes = tuple(np.ones(len(m.faces), bool) for m in meshes)
    source = {"reference_links": ["base"], "moving_links": ["lid"], "joint": "lid_joint", "held": {}}
    label = lambda i: frames[i].mask.astype(np.uint8)  # noqa: E731
    nothing = lambda i: frames[i].rgb  # noqa: E731
    truth = Truth(
        Articulation(HINGE, *meshes), states, Ts, moving, np.full((FRAMES, 2), 100), yes, yes, label, nothing,
        lambda i: frames[i].mask, source,
    )  # fmt: skip
    write_truth(folder / "data" / "truth" / "thing", truth, 0)
    return asset, sequence
