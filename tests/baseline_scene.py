"""A short rendered video of two textured boxes on a hinge or a slider, for the tests of the baselines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from baselines.surfaces import draw
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.files import atomic, checked
from freeart21.files.sequence import write_sequence
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.recording import Frame, Query, Recording
from freeart21.truth import Truth

FRAMES, CAMERA = 36, Camera.from_fov(320, 240, 0.6)


def textured_box(extents, centre, seed) -> Mesh:
    """A box with spots of random grey, about 6 mm wide."""
    made = trimesh.creation.box(extents)
    made = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(made.vertices, made.faces, 0.006))
    grey = np.random.default_rng(seed).integers(20, 236, (len(made.vertices), 1))
    return Mesh(made.vertices + centre, made.faces, np.repeat(grey, 3, 1))


def scene(kind: str) -> tuple[Recording, Truth]:
    """A body with a lid that opens by 1.2 rad, or a drawer that comes out by 10 cm, turned before the camera."""
    turns = kind == "revolute"
    joint = Joint("lid", kind, [0, 1, 0] if turns else [1, 0, 0], [-0.1, 0, 0.03], 0.0, 1.2 if turns else 0.1)
    body = textured_box([0.2, 0.16, 0.06], np.zeros(3), 1)
    lid = textured_box([0.18, 0.14, 0.03], np.array([0.01, 0, 0.06]), 2)
    states = joint.upper * (0.5 - 0.5 * np.cos(np.linspace(0, np.pi, FRAMES)))
    if turns:
        states = -states
        joint = Joint("lid", kind, joint.axis, joint.pivot, -1.2, 0.0)
    i = np.arange(FRAMES)[:, None] / FRAMES
    tilt = se3.exp_so3(np.array([np.pi - 0.5, 0, 0]))
    Ts = se3.pose(se3.exp_so3(i * [0.3, 0.5, 0.2]) @ tilt, i * [0.02, 0.01, 0] + [0, 0, 0.6])
    moving = Ts @ joint.transform(states)
    frames, masks = [], []
    for T, S in zip(Ts, moving, strict=True):
        depths, pictures = zip(*(draw(CAMERA, part.moved(P)) for part, P in ((body, T), (lid, S))), strict=True)
        front = np.argmin(depths, 0)
        depth = np.min(depths, 0)
        mask = np.isfinite(depth)
        rgb = np.where(front[..., None] == 0, pictures[0], pictures[1])
        rgb = np.where(mask[..., None], rgb, 128).astype(np.uint8)
        frames.append(Frame(rgb, np.where(mask, depth, 0).astype(np.float32), mask))
        masks.append(np.where(mask, 1 + front, 0).astype(np.uint8))
    queries = (Query(3, 30, np.eye(4)),)
    recording = Recording(CAMERA, np.arange(FRAMES) / 30, frames.__getitem__, queries, name=kind)
    flags = [np.ones(len(part.faces), bool) for part in (body, lid)]
    seen = np.stack([[(mask == k).sum() for k in (1, 2)] for mask in masks])
    shown = np.stack([frames[30].rgb]), np.stack([frames[30].mask])
    truth = Truth(
        Articulation(joint, body, lid),
        states,
        Ts,
        moving,
        seen,
        tuple(flags),
        tuple(flags),
        masks.__getitem__,
        shown[0].__getitem__,
        shown[1].__getitem__,
    )
    return recording, truth


def write_scene(folder: Path, kind: str) -> tuple[Path, Path, Truth]:
    """The sequence folder, the folder of its part masks, and its truth."""
    recording, truth = scene(kind)
    write_sequence(folder / "sequence", recording, 1e-4)
    for i in range(FRAMES):
        atomic.write_bytes(folder / "part_mask" / f"{i:05d}.png", checked.encode_png(truth.part_mask(i)))
    return folder / "sequence", folder / "part_mask", truth
