"""Fusion and held-out views under known labels and poses.

What is seen is there, faces outwards, has its colour; the rest is open.
"""

from dataclasses import replace

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


def test_the_other_views_are_those_of_the_result_with_its_parts_named_the_other_way(seen_under_a_lamp):
    recording, result, _ = seen_under_a_lamp
    joint = Joint("joint", "revolute", np.array([0.6, 0, 0.8]), np.array([0.01, 0, 0]), 0, 1)
    half = result.articulation.reference.faces
    parts = [
        Mesh(result.articulation.reference.vertices, f, result.articulation.reference.colours)
        for f in (half[::2], half[1::2])
    ]
    states = np.linspace(0, 1, len(ROUND))
    moving = se3.exp_se3([0, 0.002, 0, 0, 0, 0]) @ ROUND @ joint.transform(states)  # measured: a little off the joint
    seen = np.ones_like(result.seen)
    answer = replace(
        result, articulation=Articulation(joint, *parts), states=states, Ts_camera_moving=moving, seen=seen
    )
    turned = replace(joint, axis=joint.axis, lower=-1, upper=0)
    labels = np.array([0, 2, 1], np.uint8)[answer.part_masks]
    renamed = replace(
        answer,
        articulation=Articulation(turned, parts[1], parts[0]),
        states=-states,
        Ts_camera_reference=moving,
        Ts_camera_moving=ROUND,
        part_masks=labels,
    )
    first, other = render_queries(answer, recording)
    expected, back = render_queries(renamed, recording)
    assert len(other) == len(recording.queries) and all(map(np.array_equal, other, expected))
    assert all(map(np.array_equal, first, back))
    assert not any(map(np.array_equal, first, other))


def test_a_recording_without_held_out_views_has_no_pictures(seen_under_a_lamp):
    recording, result, _ = seen_under_a_lamp
    assert render_queries(result, Recording(CAMERA, recording.times_s, recording.load)) == ([], [])


def test_a_few_wrong_labels_make_no_surface_of_the_other_part():
    """A side that two frames of sixty give to the second part stays with the first, and is none of the second."""
    scene, labels = film(SIZE, ROUND)
    points = np.stack([se3.transform(se3.inverse(T), p) for T, p in zip(ROUND, scene.points, strict=True)])
    far_end = scene.mask & (points[..., 0] > 0.02)
    labels[far_end] = 2
    actual_camera = np.argsort(-((points[..., 2] > 0.029) & (points[..., 0] < 0) & scene.mask).sum((1, 2)))[:2]
    labels[actual_camera] = 2 * scene.mask[actual_camera]
    mesh = fuse(scene, labels, 2, ROUND, np.ones(len(ROUND), bool), SurfaceSettings())
    assert mesh.vertices[:, 0].max() > 0.055
    assert (mesh.areas() * (mesh.vertices[mesh.faces].mean(1)[:, 0] < 0.01)).sum() < 0.02 * mesh.areas().sum()
