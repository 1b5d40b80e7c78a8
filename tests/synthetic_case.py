"""A made-up two-part object, its truth, and answers to it: what the tests of the leaderboard score."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Frame, Query, Recording
from freeart21.truth import Truth

FRAMES, HEIGHT, WIDTH, QUERIES = 16, 32, 40, 2


def box(extents, centre) -> Mesh:
    made = trimesh.creation.box(extents).subdivide()
    return Mesh(made.vertices + np.asarray(centre), made.faces)


def random_pose(rng, reach=1.0):
    return se3.exp_se3(np.concatenate([rng.normal(size=3) * reach, rng.normal(size=3)]))


def make_truth(kind="revolute", seed=0) -> Truth:
    """A body and a lid (or drawer) that tumble before the camera; masks and pictures are blocks of pixels."""
    rng = np.random.default_rng(seed)
    axis, pivot = np.array([0.0, 1.0, 0.0]), np.array([-0.2, 0.0, 0.06])
    turns = kind == "revolute"
    joint = Joint("lid", kind, axis, pivot if turns else 0 * pivot, 0.0, 1.2 if turns else 0.3)
    parts = Articulation(joint, box([0.4, 0.3, 0.1], [0, 0, 0]), box([0.36, 0.26, 0.02], [0.01, 0.02, 0.08]))
    states = joint.upper * (0.5 - 0.5 * np.cos(np.linspace(0, 1.7 * np.pi, FRAMES)))
    i = np.arange(FRAMES)[:, None]
    Ts = se3.pose(se3.exp_so3(i * [0.1, 0.07, 0] + [0, 0, 0.3]), np.sin(i) * [0.1, 0, 0] + [0, 0.05, 2.0])
    masks = np.zeros((FRAMES, HEIGHT, WIDTH), np.uint8)
    for mask in masks:
        r, c = rng.integers(4, 10, 2)
        mask[r : r + 16, c : c + 22] = 1
        mask[r : r + rng.integers(3, 8), c : c + 20] = 2
    pictures = rng.integers(0, 255, (QUERIES, HEIGHT, WIDTH, 3)).astype(np.uint8)
    shown = np.zeros((QUERIES, HEIGHT, WIDTH), bool)
    shown[:, 6:25, 8:30] = True
    seen = np.stack([(masks == k).sum((1, 2)) for k in (1, 2)], -1)
    flags = tuple(np.ones(len(part.faces), bool) for part in (parts.reference, parts.moving))
    return Truth(
        parts,
        states,
        Ts,
        Ts @ joint.transform(states),
        seen,
        flags,
        flags,
        masks.__getitem__,
        pictures.__getitem__,
        shown.__getitem__,
    )


def make_recording(truth: Truth, name="sequence") -> Recording:
    def load(i):
        depth = np.ones((HEIGHT, WIDTH), np.float32)
        return Frame(np.full((HEIGHT, WIDTH, 3), i, np.uint8), depth, truth.part_mask(i) > 0)

    queries = tuple(Query(i, i + 1, np.eye(4)) for i in range(QUERIES))
    return Recording(Camera.from_fov(WIDTH, HEIGHT, 0.6), np.arange(len(truth)) / 30, load, queries, name=name)


def truth_as_answer(truth: Truth) -> Reconstruction:
    masks = np.stack([truth.part_mask(i) for i in range(len(truth))])
    return Reconstruction(
        truth.articulation,
        truth.states,
        truth.Ts_camera_reference,
        truth.Ts_camera_moving,
        masks,
        np.ones((len(truth), 2), bool),
    )


def pictures(truth: Truth):
    """The held-out views as an answer has them: white around the object."""
    return [np.where(truth.query_mask(i)[..., None], truth.query_rgb(i), 255).astype(np.uint8) for i in range(QUERIES)]


def noisy_answer(truth: Truth, seed=0) -> Reconstruction:
    """The truth with everything a little wrong, poses and joint no longer of one mind."""
    rng = np.random.default_rng(seed)
    joint = truth.articulation.joint
    twist = np.concatenate([rng.normal(size=3) * 0.02, rng.normal(size=3) * 0.1])
    joint = joint.moved(se3.exp_se3(twist))
    parts = [
        Mesh(part.vertices + rng.normal(size=part.vertices.shape) * 0.005, part.faces)
        for part in (truth.articulation.reference, truth.articulation.moving)
    ]
    noise = [se3.exp_se3(rng.normal(size=(len(truth), 6)) * [0.02, 0.02, 0.02, 0.05, 0.05, 0.05]) for _ in range(2)]
    masks = np.stack([truth.part_mask(i) for i in range(len(truth))])
    masks = np.where(rng.random(masks.shape) < 0.05, rng.integers(0, 3, masks.shape), masks).astype(np.uint8)
    states = truth.states + rng.normal(size=len(truth)) * 0.03
    return Reconstruction(
        Articulation(joint, *parts),
        states,
        truth.Ts_camera_reference @ noise[0],
        truth.Ts_camera_moving @ noise[1],
        masks,
        np.ones((len(truth), 2), bool),
    )


def in_frame(answer: Reconstruction, T_new_old) -> Reconstruction:
    """The same answer with another canonical frame."""
    back = se3.inverse(T_new_old)
    reference, moving = answer.Ts_camera_reference @ back, answer.Ts_camera_moving @ back
    return replace(
        answer,
        articulation=answer.articulation.moved(T_new_old),
        Ts_camera_reference=reference,
        Ts_camera_moving=moving,
    )


def with_joint(answer: Reconstruction, joint: Joint, states=None) -> Reconstruction:
    parts = answer.articulation
    return replace(
        answer,
        articulation=Articulation(joint, parts.reference, parts.moving),
        states=answer.states if states is None else np.asarray(states),
    )


def with_names_exchanged(answer: Reconstruction) -> Reconstruction:
    """The reference part called moving and the other way round: states negated, the axis kept (limits turned)."""
    parts, joint = answer.articulation, answer.articulation.joint
    turned = replace(joint, lower=-joint.upper, upper=-joint.lower)
    exchanged = Articulation(turned, parts.moving, parts.reference)
    masks = np.array([0, 2, 1], np.uint8)[answer.part_masks]
    return replace(
        answer,
        articulation=exchanged,
        states=-answer.states,
        part_masks=masks,
        Ts_camera_reference=answer.Ts_camera_moving,
        Ts_camera_moving=answer.Ts_camera_reference,
    )


def static_answer(truth: Truth) -> Reconstruction:
    """Nothing moves: frame 0 for ever, all pixels one part, a joint through the origin along z."""
    masks = np.stack([(truth.part_mask(i) > 0).astype(np.uint8) for i in range(len(truth))])
    joint = Joint("still", truth.articulation.joint.type, [0, 0, 1.0], np.zeros(3), 0.0, 1.0)
    still = np.repeat(truth.Ts_camera_reference[:1], len(truth), 0)
    parts = Articulation(joint, truth.articulation.reference, truth.articulation.moving)
    return Reconstruction(parts, np.zeros(len(truth)), still, still, masks, np.ones((len(truth), 2), bool))


def random_answer(truth: Truth, seed=0) -> Reconstruction:
    """Numbers from a hat."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    kind = truth.articulation.joint.type
    joint = Joint("any", kind, axis / np.linalg.norm(axis), rng.normal(size=3), -1.0, 1.0)
    parts = [Mesh(rng.normal(size=(30, 3)) * 0.3, rng.integers(0, 30, (20, 3))) for _ in range(2)]
    poses = [np.stack([random_pose(rng) for _ in range(len(truth))]) for _ in range(2)]
    masks = rng.integers(0, 3, (len(truth), HEIGHT, WIDTH)).astype(np.uint8)
    return Reconstruction(
        Articulation(joint, *parts), rng.normal(size=len(truth)), *poses, masks, np.ones((len(truth), 2), bool)
    )
