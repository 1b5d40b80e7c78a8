"""What a symmetry of the seen surface puts where nobody looked, and what speaks against it."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from export.free_space import SEEN_THROUGH, OtherPart, SpaceGrid
from export.settings import MeshSettings
from export.surface import close_surface
from export.symmetry import suppose_by_symmetry
from export.winding_number import Winding
from freeart21 import se3
from freeart21.mesh import Mesh

SPACING, VOXEL = 0.004, 0.005


def seen_part(solid, hidden):
    """The triangles of a solid without those that are `hidden`, even points on them with outward normals, and a grid
    around it in which all is seen through but for the solid and what is hidden."""
    points, faces = trimesh.sample.sample_surface_even(solid, 12_000, seed=0)
    normals = solid.face_normals[faces]
    low = solid.bounds[0] - 6 * VOXEL
    shape = np.ceil(np.ptp(solid.bounds, axis=0) / VOXEL).astype(int) + 13
    centres = low + VOXEL * np.argwhere(np.ones(shape, bool))
    empty = ~hidden(centres) & ~trimesh.Trimesh(*enlarge(solid)).contains(centres)
    state = np.where(empty.reshape(shape), SEEN_THROUGH, 0).astype(np.uint8)
    keep = ~hidden(points)
    fine = solid.subdivide_to_size(SPACING)
    seen = Mesh(fine.vertices, fine.faces[~hidden(fine.triangles_center)])
    return seen, points[keep], normals[keep], SpaceGrid(se3.pose(np.eye(3), low), VOXEL, state)


def enlarge(solid):
    """A convex solid a voxel larger all around: space beside a surface is not known."""
    middle = solid.bounds.mean(0)
    scale = 1 + 2 * VOXEL / np.ptp(solid.bounds, axis=0)
    return middle + (solid.vertices - middle) * scale, solid.faces


@pytest.fixture(scope="module")
def turned():
    """(3, 3) so that nothing lies along the axes."""
    return se3.exp_so3(np.array([0.3, -0.5, 0.2]))


def test_the_back_of_a_cylinder_is_round(turned):
    solid = trimesh.creation.cylinder(radius=0.05, height=0.12, sections=128)
    solid = solid.apply_transform(se3.pose(turned, [1, 2, 3]))
    behind = turned @ np.array([1.0, 0.4, 0.0]) / np.hypot(1, 0.4)
    *seen, space = seen_part(solid, lambda p: (p - [1, 2, 3]) @ behind > 0.015)
    found = suppose_by_symmetry(*seen, np.eye(3), space, SPACING)
    off = np.abs(trimesh.proximity.signed_distance(solid, found.points))
    right = found.bits > 4  # a mirror plane across, in which three quarters of the images are right, has fewer
    assert right.sum() > 300 and off[right].max() < 0.002, "on the cylinder"
    assert (found.bits > 1).all() and (off[~right].size == 0 or found.bits[~right].max() < 2)
    away = (found.points[right] - [1, 2, 3]) @ turned
    assert (away @ (turned.T @ behind)).max() > 0.045, "as far as its back"
    assert (np.einsum("ij,ij->i", found.normals[right], away @ turned.T) > 0).all(), "facing outwards"


def test_a_vessel_that_was_seen_from_one_side_is_closed_round(turned):
    solid = trimesh.creation.cylinder(radius=0.05, height=0.12, sections=128)
    solid = solid.apply_transform(se3.pose(turned, [0, 0, 0]))
    behind = turned @ np.array([1.0, 0.0, 0.0])
    seen, *_, space = seen_part(solid, lambda p: p @ behind > 0.01)
    flat, whole = (close_surface(seen, MeshSettings(points=20_000), given) for given in (None, space))
    volumes = [trimesh.Trimesh(s.mesh.vertices, s.mesh.faces).volume for s in (flat, whole)]
    assert volumes[0] < 0.8 * solid.volume and volumes[1] == pytest.approx(solid.volume, rel=0.03)
    assert whole.patch_first < whole.patch_first + whole.symmetric_count <= len(whole.mesh.faces)
    copied = whole.mesh.faces[whole.patch_first :][: whole.symmetric_count]
    assert (whole.mesh.vertices[copied].mean(1) @ behind).max() > 0.045


def test_a_hidden_end_is_the_mirror_image_of_the_other(turned):
    solid = trimesh.creation.icosphere(subdivisions=5)
    solid.vertices *= [0.12, 0.06, 0.03]
    solid.vertices[:, 2] += 1.5 * solid.vertices[:, 0] ** 2  # one plane of symmetry is left across x, one across y
    solid = solid.convex_hull.apply_transform(se3.pose(turned, [0, 0, 1]))
    along = turned[:, 1]
    *seen, space = seen_part(solid, lambda p: (p - [0, 0, 1]) @ along > 0.03)
    found = suppose_by_symmetry(*seen, np.eye(3), space, SPACING)
    assert len(found.points) > 100 and ((found.points - [0, 0, 1]) @ along).max() > 0.05
    assert np.abs(trimesh.proximity.signed_distance(solid, found.points)).max() < 0.003
    images = found.sources - 2 * ((found.sources - [0, 0, 1]) @ along)[:, None] * along
    assert np.linalg.norm(images - found.points, axis=1).max() < 0.003


def test_nothing_is_supposed_inside_the_other_part(turned):
    solid = trimesh.creation.cylinder(radius=0.05, height=0.12, sections=128)
    *seen, space = seen_part(solid, lambda p: p[:, 0] > 0.015)
    other = trimesh.creation.box((0.1, 0.3, 0.3), se3.pose(np.eye(3), [0.09, 0, 0]))  # from x = 0.04 on, or far away
    poses = np.stack([se3.pose(np.eye(3), [9.0, 0, 0]), np.eye(4)])
    beside = replace(space, other=OtherPart(Winding(Mesh(other.vertices, other.faces)), poses))
    ends = [suppose_by_symmetry(*seen, np.eye(3), given, SPACING).points[:, 0].max() for given in (space, beside)]
    assert ends[0] > 0.045 and 0.03 < ends[1] < 0.04


def test_what_was_seen_to_be_otherwise_is_not_supposed(turned):
    """A half of a cylinder, cut off flat: the space where its other half would be was looked through."""
    solid = trimesh.creation.cylinder(radius=0.05, height=0.12, sections=128)
    solid = trimesh.intersections.slice_mesh_plane(solid, [-1, 0, 0], [0, 0, 0], cap=True).apply_transform(
        se3.pose(turned, [0, 0, 0])
    )
    behind = turned @ np.array([1.0, 0.0, 0.0])
    *seen, space = seen_part(solid, lambda p: np.abs(p @ behind) < 1e-3)
    found = suppose_by_symmetry(*seen, np.eye(3), space, SPACING)
    assert not len(found.points) or (found.points @ behind).max() < 0.01


def test_a_wall_that_is_hardly_bent_is_no_part_of_a_huge_ring(turned):
    """Bent about an axis a kilometre away: a ring of that radius, in steps of the spacing, would not fit in memory."""
    rows, columns = (line.ravel() for line in np.mgrid[-0.1:0.1:41j, -0.1:0.1:41j])
    points = np.stack([rows, columns, -(rows**2) / 2000], -1)
    faces = np.concatenate([[[k, k + 41, k + 1], [k + 1, k + 41, k + 42]] for k in range(41 * 40) if k % 41 < 40])
    seen = Mesh(points, faces)
    normals = np.stack([rows / 1000, np.zeros_like(rows), np.ones_like(rows)], -1)
    space = SpaceGrid(se3.pose(np.eye(3), [-0.2, -0.2, -0.2]), 0.1, np.full((5, 5, 5), SEEN_THROUGH, np.uint8))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert not len(suppose_by_symmetry(seen, points, normals, np.eye(3), space, SPACING).points)
