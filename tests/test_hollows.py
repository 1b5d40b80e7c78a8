"""What stands where nobody saw: parts that are hollow become hollow, parts that are solid stay so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from export.collision import make_collision
from export.fidelity import measure_fidelity
from export.free_space import SEEN_THROUGH, SWEPT, SpaceGrid, find_free_space
from export.hollows import find_panels, sealed_faces
from export.materials import TABLE
from export.parts import clear_parts, close_parts
from export.penetration import Overlap
from export.primitives import Box
from export.settings import PRESETS, MeshSettings
from export.surface import Surface, close_surface
from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.camera import Camera
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Frame, Recording

CAMERA = Camera(np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]]), 160, 120)
WALL, SHEET = 0.01, 0.006
"""m, of the carcass and of the drawer."""
SIZE = np.array([0.2, 0.16, 0.12])
FRAMES = 24


def block(low, high) -> trimesh.Trimesh:
    low, high = np.array(low, float), np.array(high, float)
    return trimesh.creation.box(high - low, se3.pose(np.eye(3), 0.5 * (low + high)))


def carcass() -> trimesh.Trimesh:
    """A box on z = 0 with one compartment that is open at the front, x = -0.1."""
    x, y, z = 0.5 * SIZE
    return trimesh.boolean.difference(
        [block((-x, -y, 0), (x, y, 2 * z)), block((-x - 1, -y + WALL, WALL), (x - WALL, y - WALL, 2 * z - WALL))]
    )


def drawer() -> trimesh.Trimesh:
    """A tray that fills the compartment with 2 mm to spare, lower than it so that one can look in."""
    low, high = np.array([-0.098, -0.068, 0.012]), np.array([0.086, 0.068, 0.09])
    return trimesh.boolean.difference([block(low, high), block(low + SHEET, high + np.array([-SHEET, -SHEET, 1]))])


def film(parts: list[trimesh.Trimesh], joint: Joint, states: np.ndarray) -> tuple[Reconstruction, Recording]:
    """A clean film from the front, left and right, above and below, and an answer of the triangles that it shows."""
    pieces = [fine(part) for part in parts]
    rays = CAMERA.rays().reshape(-1, 3)
    shown = [np.zeros(len(piece.faces), bool) for piece in pieces]
    Ts, frames = [], []
    for k, state in enumerate(states):
        turn = 1.0 * np.sin(2.4 * k)  # about z; 0 looks at the front, the back is never seen
        rise = 0.9 * np.cos(1.7 * k)
        ahead = se3.exp_so3([0, 0, turn]) @ se3.exp_so3([0, rise, 0]) @ np.array([1.0, 0, 0])
        right = np.cross(ahead, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(ahead, right), ahead])  # camera from world
        T = se3.pose(R, -R @ (np.array([-0.03, 0, 0.06]) - 0.5 * ahead))
        posed = [pieces[0].moved(T), pieces[1].moved(T @ joint.transform(float(state)))]
        count = len(posed[0].faces)
        whole = trimesh.util.concatenate([trimesh.Trimesh(p.vertices, p.faces, process=False) for p in posed])
        where, ray, hit = whole.ray.intersects_location(np.zeros_like(rays), rays, multiple_hits=False)
        depth, label = np.zeros(len(rays), np.float32), np.zeros(len(rays), np.uint8)
        depth[ray], label[ray] = where[:, 2], 1 + (hit >= count)
        shown[0][hit[hit < count]] = True
        shown[1][hit[hit >= count] - count] = True
        size = (CAMERA.height, CAMERA.width)
        rgb = np.full((*size, 3), 128, np.uint8)
        frames.append((Frame(rgb, depth.reshape(size), depth.reshape(size) > 0), label.reshape(size)))
        Ts.append(T)
    seen = [piece.with_faces(flags) for piece, flags in zip(pieces, shown, strict=True)]
    poses = np.stack(Ts)
    answer = Reconstruction(
        Articulation(joint, *seen),
        states,
        poses,
        poses @ joint.transform(states),
        np.stack([label for _, label in frames]),
        np.ones((len(states), 2), bool),
    )
    return answer, Recording(CAMERA, np.arange(len(states)) / 30, lambda i: frames[i][0])


def fine(solid: trimesh.Trimesh) -> Mesh:
    vertices, faces = trimesh.remesh.subdivide_to_size(solid.vertices, solid.faces, 0.006, max_iter=20)
    return Mesh(vertices, faces)


def volume(mesh: Mesh) -> float:
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight and solid.is_winding_consistent
    return float(solid.volume)


SLIDE = Joint("drawer", "prismatic", np.array([-1.0, 0, 0]), np.zeros(3), 0.0, 0.13)
HINGE = Joint("lid", "revolute", np.array([0.0, 1, 0]), np.array([0.1, 0, 0.12]), 0.0, 1.2)
SETTINGS = MeshSettings(points=8_000)


@pytest.fixture(scope="module")
def drawer_unit():
    return film([carcass(), drawer()], SLIDE, 0.065 * (1 - np.cos(0.9 * np.arange(FRAMES))))


def test_a_drawer_and_its_carcass_are_hollow(drawer_unit):
    answer, recording = drawer_unit
    whole = close_parts(answer, recording, SETTINGS)
    parts = whole.parts
    states = np.linspace(whole.found.low, whole.found.high, 7)
    assert Overlap(whole.reconstruction.articulation).max_depth(states) < 1e-3
    for name, true in zip(PARTS, (carcass(), drawer()), strict=True):
        surface = parts[name].surface
        assert volume(surface.mesh) == pytest.approx(true.volume, rel=0.25)
        centres = surface.mesh.vertices[surface.mesh.faces].mean(1)
        off = np.abs(trimesh.proximity.signed_distance(true, centres[surface.observed]))
        area = surface.mesh.areas()[surface.observed]
        assert area[off > 1e-3].sum() < 0.01 * area.sum()  # what was seen stays in place
    found, surface = parts["reference"].panels, parts["reference"].surface
    assert found["cores"][0]["hollow"] and found["cores"][0]["hollow_bits"] < found["cores"][0]["solid_bits"]
    assert found["thickness_by"] == "rims" and found["thickness_m"] == pytest.approx(WALL, abs=1e-3)
    assert 0 < surface.panel_count <= surface.patch_count
    solid = trimesh.Trimesh(surface.mesh.vertices, surface.mesh.faces)
    assert not solid.contains([[0, 0, 0.06], [-0.05, 0.04, 0.03], [0.05, 0, 0.1]]).any()
    assert solid.contains([[0, 0.075, 0.06], [0, -0.075, 0.06], [0, 0, 0.115]]).all()  # sides and top


def test_without_the_video_the_sliding_drawer_alone_empties_its_carcass(drawer_unit):
    answer, _ = drawer_unit
    space = find_free_space(answer, "reference", None)
    assert space.look_up(np.array([[-0.05, 0.0, 0.018], [0.0, 0.0, 0.117]])).tolist() == [SWEPT, 0]


def test_a_cabinet_is_hollow_of_which_one_low_drawer_opens():
    """Its sides are known to be thin in less than a quarter of what was seen of them."""
    x, y, z = 0.5 * SIZE
    top = block((-x - 1, -y + WALL, 0.07), (x - WALL, y - WALL, 2 * z - WALL))
    cabinet = trimesh.boolean.difference([block((-x, -y, 0), (x, y, 2 * z)), top])
    low, high = np.array([-0.098, -0.068, 0.072]), np.array([0.086, 0.068, 0.104])
    tray = trimesh.boolean.difference([block(low, high), block(low + SHEET, high + np.array([-SHEET, -SHEET, 1]))])
    answer, recording = film([cabinet, tray], SLIDE, 0.065 * (1 - np.cos(0.9 * np.arange(FRAMES))))
    found = find_panels_of(answer, recording)
    assert found["thickness_by"] == "rims" and found["thickness_m"] == pytest.approx(WALL, abs=1e-3)
    assert found["cores"][0]["hollow"] and found["cores"][0]["volume_m3"] > 0.5 * 0.18 * 0.14 * 0.05


def find_panels_of(answer, recording) -> dict:
    space = find_free_space(answer, "reference", recording)
    closed = close_surface(answer.articulation.reference, SETTINGS, space)
    return find_panels(closed.mesh, closed.observed, space).report


def test_a_solid_base_under_a_lid_stays_solid():
    base, lid = block((-0.1, -0.08, 0), (0.1, 0.08, 0.12)), block((-0.1, -0.08, 0.12), (0.1, 0.08, 0.13))
    answer, recording = film([base, lid], HINGE, 0.6 * (1 - np.cos(0.9 * np.arange(FRAMES))))
    parts = close_parts(answer, recording, SETTINGS).parts
    for name, true in zip(PARTS, (base, lid), strict=True):
        assert volume(parts[name].surface.mesh) == pytest.approx(true.volume, rel=0.05)
        assert parts[name].surface.panel_count == 0


def test_walls_whose_rims_nobody_saw_are_as_thick_as_usual_for_size_and_material():
    """A box whose inside is known to be empty from 15 mm behind its walls on, in one half."""
    low, high = np.array([-0.1, -0.07, 0.0]), np.array([0.1, 0.07, 0.1])
    box = fine(block(low, high))
    state = np.zeros((107, 77, 57), np.uint8)
    T = se3.pose(np.eye(3), low - 0.006)  # 2 mm voxels, three around
    state[3 + 8 : 53, 3 + 8 : -3 - 8, 3 + 8 : -3 - 8] = SEEN_THROUGH
    space, everything = SpaceGrid(T, 0.002, state), np.ones(len(box.faces), bool)
    plain = find_panels(box, everything, space).report
    assert plain["thickness_by"] == "empty space behind" and plain["thickness_m"] > 0.012
    usual = TABLE["wood"].usual_wall(float(np.linalg.norm(high - low)))
    assert usual == 0.009
    found = find_panels(box, everything, space, usual).report
    assert found["thickness_by"] == "size and material" and found["thickness_m"] == usual


def test_nothing_of_the_other_part_stands_in_a_sealed_hollow():
    """The visual mesh has no walls of sealed hollows, so what stands in one would be deep in the part."""
    hollow = trimesh.boolean.difference([block((0, 0, 0), (0.1, 0.1, 0.1)), block((0.02,) * 3, (0.08,) * 3)])
    loose = trimesh.util.concatenate([block((0.12, 0, 0), (0.2, 0.1, 0.1)), block((0.03,) * 3, (0.05,) * 3)])
    parts = [Mesh(solid.vertices, solid.faces) for solid in (hollow, loose)]
    answer, _ = film(
        [hollow, loose], Joint("slide", "prismatic", np.array([0, 0, 1.0]), np.zeros(3), 0, 0.02), np.array([0, 0.02])
    )
    surfaces = {name: Surface(mesh, len(mesh.faces)) for name, mesh in zip(PARTS, parts, strict=True)}
    cleared, found, _ = clear_parts(answer, surfaces, MeshSettings(), 5e-4, True)
    assert sealed_faces(cleared["reference"].mesh).any()
    visual = {name: surface.mesh.with_faces(~sealed_faces(surface.mesh)) for name, surface in cleared.items()}
    assert Overlap(replace(answer.articulation, **visual)).max_depth(np.linspace(found.low, found.high, 5)) < 5e-4


def test_space_that_the_video_looked_through_is_empty_and_no_other(drawer_unit):
    answer, recording = drawer_unit
    space = find_free_space(answer, "moving", recording)
    assert space.look_up(np.array([[-0.03, 0.0, 0.08]])).tolist() == [SEEN_THROUGH]
    looked = space.centres(space.state == SEEN_THROUGH)
    assert not drawer().contains(looked[::7]).any()
    beside = np.array([[0.0, 0.11, 0.05], [0.0, 1.0, 0.05]])  # the grid, and far away
    assert space.look_up(beside).tolist() == [SEEN_THROUGH, 0]


@pytest.mark.parametrize("preset", ["fine", "fast"])
def test_a_carcass_and_a_drawer_touch_as_their_boards(preset: str):
    """Rough by up to .4 mm, as fused surfaces are: roughness costs no shapes."""
    for true in (carcass(), drawer()):
        rough = fine(true)
        bumps = np.random.default_rng(0).uniform(-4e-4, 4e-4, rough.vertices.shape)
        found = make_collision(Mesh(rough.vertices + bumps, rough.faces), PRESETS[preset])
        assert len(found.shapes) <= 8 and sum(isinstance(shape, Box) for shape in found.primitives) == 5
        fidelity = measure_fidelity(found.surface, found.shapes)
        assert fidelity.worst_of_95 < 1.5e-3 and fidelity.worst < 5e-3


def test_fast_contact_has_sixteen_shapes_at_most():
    rings = [trimesh.creation.torus(0.03, 0.006, transform=se3.pose(np.eye(3), (0.05 * k, 0, 0))) for k in range(4)]
    chain = trimesh.boolean.union([*rings, trimesh.creation.icosphere(3, 0.02)])
    assert 2 <= len(make_collision(Mesh(chain.vertices, chain.faces), PRESETS["fast"]).shapes) <= 16


def test_a_wall_that_is_thinner_than_points_are_apart_has_no_holes():
    """Its inner face was not seen, but the space there is known to be empty."""
    outside = fine(block(-0.5 * SIZE, 0.5 * SIZE))
    seen = outside.with_faces(outside.vertices[outside.faces].mean(1)[:, 0] > -0.0999)  # open at the front
    voxel, wall = 0.002, 0.0025
    shape = np.rint(SIZE / voxel).astype(int) + 1
    at = np.moveaxis(np.indices(shape), 0, -1) * voxel - 0.5 * SIZE
    empty = ((np.abs(at) < 0.5 * SIZE - wall) | ((at < -0.09) & [True, False, False])).all(-1)
    space = SpaceGrid(se3.pose(np.eye(3), -0.5 * SIZE), voxel, np.where(empty, SEEN_THROUGH, 0).astype(np.uint8))
    closed = close_surface(seen, MeshSettings(points=5_000), space)
    assert closed.mesh.areas()[closed.observed].sum() == pytest.approx(seen.areas().sum(), rel=0.03)
    assert volume(closed.mesh) < 2 * wall * seen.areas().sum()
