"""Fusion and held-out views under known labels and poses.

What is seen is there, faces outwards, has its colour; the rest is open.
"""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Frame, Query, Recording
from reconstruct.renders import render, render_queries
from reconstruct.scene import prepare_scene
from reconstruct.settings import SceneSettings, SurfaceSettings
from reconstruct.surfaces import fuse

CAMERA = Camera.from_fov(160, 120, np.radians(20))
ROUND = se3.pose(Rotation.random(60, random_state=0).as_matrix(), np.array([0.0, 0, 1]))
"""Poses in which a body shows all of its sides."""


LAMP = np.array([0.6, -0.4, -0.7])


def shoot(size, T, lamp=None):
    """A frame of a box whose sides (-x, +x, -y, ...) each have a colour of their own, under a lamp or in even light."""
    body = trimesh.creation.box(size)
    side = 2 * np.abs(body.face_normals).argmax(1) + (body.face_normals.sum(1) > 0)
    rays = CAMERA.rays().reshape(-1, 3)
    normals = body.face_normals @ T[:3, :3].T
    caster = trimesh.ray.ray_pyembree.RayMeshIntersector(body.copy().apply_transform(T))
    hit, ray, face = caster.intersects_location(np.zeros_like(rays), rays, multiple_hits=False)
    rgb, depth = np.full((len(rays), 3), 255, np.uint8), np.zeros(len(rays), np.float32)
    light = 1 if lamp is None else (0.3 + 0.7 * np.clip(normals[face] @ lamp, 0, 1))[:, None]
    rgb[ray] = side_colour(side[face]) * light
    depth[ray] = hit[:, 2]
    shape = (CAMERA.height, CAMERA.width)
    return Frame(rgb.reshape(*shape, 3), depth.reshape(shape), depth.reshape(shape) > 0)


def film(size, Ts):
    """Scene and labels of such a box."""
    frames = [shoot(size, T) for T in Ts]
    scene = prepare_scene(Recording(CAMERA, np.arange(len(Ts)) / 30, lambda i: frames[i]), SceneSettings())
    return scene, scene.mask.astype(np.uint8)


def side_colour(side):
    return np.stack([40 * side, np.full_like(side, 30), 250 - 40 * side], -1).astype(np.uint8)


def fused(size, Ts):
    scene, labels = film(size, Ts)
    return fuse(scene, labels, 1, Ts, np.ones(len(Ts), bool), SurfaceSettings()), scene.footprint


@pytest.fixture(scope="module")
def box():
    return (*fused((0.12, 0.09, 0.06), ROUND), np.array([0.12, 0.09, 0.06]))


def test_a_box_seen_all_round_is_closed_faces_outwards_and_has_its_volume(box):
    mesh, footprint, size = box
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert solid.is_watertight
    assert np.prod(size - footprint) < solid.volume < np.prod(size + 0.5 * footprint)
    assert np.abs(np.ptp(mesh.vertices, axis=0) - size).max() < footprint


def test_a_side_that_no_frame_saw_stays_open():
    Ts = se3.pose(se3.exp_so3([[0.3 * np.sin(k), 0.3 * np.cos(k), 0] for k in range(16)]), np.array([0.0, 0, 1]))
    size = np.array([0.12, 0.09, 0.06])
    mesh, footprint = fused(size, Ts)
    assert mesh.vertices[:, 2].max() < size[2] / 2 + 6 * footprint
    front = np.abs(mesh.vertices[:, 2] + size[2] / 2) < 0.5 * footprint
    area = mesh.areas()[front[mesh.faces].all(1)].sum()
    assert area > 0.9 * size[0] * size[1]
    back = (np.abs(mesh.vertices[:, :2]) < size[:2] / 2 - 3 * footprint).all(1) & (mesh.vertices[:, 2] > 0)
    assert not back.any()


def test_the_background_does_not_eat_the_silhouette():
    """From one direction, the outline of a box is where it was, not half a pixel inside, and not a pixel outside."""
    turn = [[0.02 * np.sin(k), 0.02 * np.cos(k), 0.1 * k] for k in range(16)]
    Ts = se3.pose(se3.exp_so3(turn), np.array([0.0, 0, 1]))
    size = np.array([0.12, 0.09, 0.06])
    mesh, footprint = fused(size, Ts)
    extent = np.percentile(mesh.vertices, 99.5, axis=0) - np.percentile(mesh.vertices, 0.5, axis=0)
    assert (extent[:2] > size[:2] - 0.5 * footprint).all() and (extent[:2] < size[:2] + footprint).all()


# ---- held-out views --------------------------------------------------------------------------------------------------

SIZE = np.array([0.12, 0.09, 0.06])


@pytest.fixture(scope="module")
def seen_under_a_lamp():
    """A recording under a lamp beside the camera, its reconstruction, and what its held-out views truly show."""
    lamp = LAMP / np.linalg.norm(LAMP)
    frames = [shoot(SIZE, T, lamp) for T in ROUND]
    moves = se3.pose(se3.exp_so3([[0.15, 0.1, 0.1], [-0.2, 0, 0.1], [0, 0.2, -0.1]]), np.array([0.01, 0, 0.02]))
    queries = tuple(Query(i, 0, T) for i, T in zip((7, 20, 41), moves, strict=True))
    recording = Recording(CAMERA, np.arange(len(ROUND)) / 30, lambda i: frames[i], queries)
    scene = prepare_scene(recording, SceneSettings())
    mesh = fuse(scene, scene.mask.astype(np.uint8), 1, ROUND, np.ones(len(ROUND), bool), SurfaceSettings())
    joint = Joint("joint", "revolute", np.array([0.0, 0, 1]), np.zeros(3), 0, 0)
    masks = np.stack([frame.mask for frame in frames]).astype(np.uint8)
    seen = np.tile([True, False], (len(ROUND), 1))
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3), np.uint8))
    result = Reconstruction(Articulation(joint, mesh, nothing), np.zeros(len(ROUND)), ROUND, ROUND, masks, seen)
    # the lamp stays where it was to the recording camera
    truths = [shoot(SIZE, q.T_newcam_cam @ ROUND[q.pose_of_frame], q.T_newcam_cam[:3, :3] @ lamp) for q in queries]
    return recording, result, truths


def test_held_out_views_are_lit_as_the_lamps_stand(seen_under_a_lamp):
    recording, result, truths = seen_under_a_lamp
    for query, picture, truth in zip(recording.queries, render_queries(result, recording)[0], truths, strict=True):
        both = truth.mask & (picture < 255).any(2)
        off = np.abs(picture[both].astype(int) - truth.rgb[both]).mean()
        plain = render(CAMERA, [result.articulation.reference.moved(query.T_newcam_cam @ ROUND[query.pose_of_frame])])
        both = truth.mask & (plain < 255).any(2)
        assert off < 5 and off < 0.5 * np.abs(plain[both].astype(int) - truth.rgb[both]).mean()


def test_outlines_of_held_out_views_are_neither_eaten_nor_swollen(seen_under_a_lamp):
    recording, result, truths = seen_under_a_lamp
    for picture, truth in zip(render_queries(result, recording)[0], truths, strict=True):
        drawn = (picture < 255).any(2)
        outline = 2 * sum(np.ptp(np.flatnonzero(truth.mask.any(axis))) + 1 for axis in (0, 1))
        assert (truth.mask & ~drawn).sum() < 0.2 * outline and (drawn & ~truth.mask).sum() < 0.4 * outline
