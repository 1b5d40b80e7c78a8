"""Fusion under known labels and poses: what is seen is there, faces outwards, has its colour; the rest is open."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.recording import Frame, Recording
from reconstruct.scene import prepare
from reconstruct.settings import SceneSettings, SurfaceSettings
from reconstruct.surfaces import fuse

CAMERA = Camera.from_fov(160, 120, np.radians(20))
ROUND = se3.pose(Rotation.random(60, random_state=0).as_matrix(), np.array([0.0, 0, 1]))
"""Poses in which a body shows all of its sides."""


def film(size, Ts):
    """Scene and labels of a box whose sides (-x, +x, -y, ...) each have a colour of their own."""
    body = trimesh.creation.box(size)
    side = 2 * np.abs(body.face_normals).argmax(1) + (body.face_normals.sum(1) > 0)
    rays = CAMERA.rays().reshape(-1, 3)
    frames = []
    for T in Ts:
        caster = trimesh.ray.ray_pyembree.RayMeshIntersector(body.copy().apply_transform(T))
        hit, ray, face = caster.intersects_location(np.zeros_like(rays), rays, multiple_hits=False)
        rgb, depth = np.full((len(rays), 3), 255, np.uint8), np.zeros(len(rays), np.float32)
        rgb[ray] = side_colour(side[face])
        depth[ray] = hit[:, 2]
        shape = (CAMERA.height, CAMERA.width)
        frames.append(Frame(rgb.reshape(*shape, 3), depth.reshape(shape), depth.reshape(shape) > 0))
    scene = prepare(Recording(CAMERA, np.arange(len(Ts)) / 30, lambda i: frames[i]), SceneSettings())
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


def test_a_vertex_has_the_colour_of_the_side_it_lies_on(box):
    mesh, footprint, size = box
    inside = np.abs(mesh.vertices) < size / 2 - 2 * footprint
    for axis in range(3):
        for positive in (0, 1):
            on = inside[:, [k for k in range(3) if k != axis]].all(1) & ((mesh.vertices[:, axis] > 0) == positive)
            assert on.sum() > 50
            off = np.abs(mesh.colours[on].astype(int) - side_colour(np.array(2 * axis + positive)))
            assert np.percentile(off, 99) <= 2


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


def test_a_sheet_of_two_voxels_keeps_both_of_its_sides():
    footprint = 1 / CAMERA.K[0, 0]
    size = np.array([0.10, 0.09, 2 * SurfaceSettings().voxel * footprint])
    mesh, _ = fused(size, ROUND)
    inner = (np.abs(mesh.vertices[:, :2]) < size[:2] / 2 - 2 * footprint).all(1)
    height = mesh.vertices[inner, 2]
    for side in (-1, 1):
        off = np.abs(height[height * side > 0] - side * size[2] / 2)
        assert len(off) > 500 and np.median(off) < 0.3 * footprint and np.percentile(off, 99) < footprint
    covered = mesh.areas()[inner[mesh.faces].all(1)].sum()
    assert covered > 1.9 * np.prod(size[:2] - 4 * footprint)


def test_the_background_does_not_eat_the_silhouette():
    """From one direction, the outline of a box is where it was, not half a pixel inside, and not a pixel outside."""
    turn = [[0.02 * np.sin(k), 0.02 * np.cos(k), 0.1 * k] for k in range(16)]
    Ts = se3.pose(se3.exp_so3(turn), np.array([0.0, 0, 1]))
    size = np.array([0.12, 0.09, 0.06])
    mesh, footprint = fused(size, Ts)
    extent = np.percentile(mesh.vertices, 99.5, axis=0) - np.percentile(mesh.vertices, 0.5, axis=0)
    assert (extent[:2] > size[:2] - 0.5 * footprint).all() and (extent[:2] < size[:2] + footprint).all()


def test_a_part_without_pixels_is_empty():
    scene, labels = film((0.12, 0.09, 0.06), ROUND[:12])
    assert fuse(scene, labels, 2, ROUND[:12], np.ones(12, bool), SurfaceSettings()).empty
