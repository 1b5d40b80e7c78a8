"""Contact pieces of two parts that keep out of each other over the joint's range."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from export.carving import CarvedPart, carve_overlap, cut_spots
from export.clearance import separate_shapes
from export.collision import make_collision
from export.fidelity import depth_in_shapes, shape_planes
from export.outer_surface import sample_evenly
from export.penetration import Overlap
from export.settings import CollisionSettings
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.joint import Joint
from freeart21.mesh import Mesh

SLIDE = Joint("slide", "prismatic", np.array([1.0, 0, 0]), np.zeros(3), 0.0, 0.25)
TOLERANCE = 5e-4


def block(size, centre) -> trimesh.Trimesh:
    return trimesh.creation.box(size, se3.pose(np.eye(3), centre))


def boards(size, wall: float, ways) -> list[np.ndarray]:
    """Corners (8, 3) of the boards of a box of `size` on its sides `ways`, (3,) each."""
    out = []
    for way in np.array(ways, float):
        side = np.where(way != 0, wall, size)
        out.append(np.array(block(side, 0.5 * way * (np.array(size) - wall)).vertices))
    return out


def drawer_in_its_carcass(gap: float = 1e-3) -> tuple[dict[str, list[np.ndarray]], dict[str, trimesh.Trimesh]]:
    """The boards, and the solids of them, of a carcass of 10 mm, open towards +x, and in it a tray of 4 mm, open
    upwards."""
    x, y, z = np.eye(3)
    found = {
        "reference": boards((0.32, 0.22, 0.14), 0.01, (-x, y, -y, z, -z)),
        "moving": boards(np.array([0.3, 0.2, 0.12]) - 2 * gap, 0.004, (x, -x, y, -y, -z)),
    }
    return found, {
        name: trimesh.boolean.union([trimesh.convex.convex_hull(b) for b in bs]) for name, bs in found.items()
    }


def deepest(pieces: dict[str, list[np.ndarray]], joint: Joint, fixed: str, states: int = 9) -> float:
    """m by which points all over the pieces of either part are in a piece of the other."""
    other = next(name for name in pieces if name != fixed)
    solids = {name: [trimesh.convex.convex_hull(p) for p in found] for name, found in pieces.items()}
    spread = {
        name: np.concatenate([sample_evenly(solid, 4e-5)[0] for solid in found]) for name, found in solids.items()
    }
    spread = {name: np.concatenate([points, *pieces[name]]) for name, points in spread.items()}
    worst = 0.0
    for state in np.linspace(joint.lower, joint.upper, states):
        T = joint.transform(state)
        for name, points in ((fixed, se3.transform(se3.inverse(T), spread[fixed])), (other, None)):
            points = se3.transform(T, spread[other]) if points is None else points
            into = shape_planes(solids[other if name == fixed else fixed])
            worst = max(worst, float(depth_in_shapes(points, np.full(len(points), -1), *into).max()))
    return worst


def parted(pieces, parts, joint=SLIDE, fixed="reference"):
    surfaces = {}
    for name, solid in parts.items():
        points = sample_evenly(solid, 1e-5)[0]
        surfaces[name] = (points, solid.area / len(points))
    return separate_shapes(pieces, surfaces, joint, fixed, TOLERANCE, 1e-3)


@pytest.mark.parametrize("fixed", ["reference", "moving"])
def test_pieces_that_stand_out_of_a_drawer_and_its_carcass_are_cut_back_to_them(fixed: str):
    """Boards 3 mm too thick all round, where the gap is 1 mm: then apart over the whole range, and still there."""
    joint = SLIDE if fixed == "reference" else replace(SLIDE, axis=-SLIDE.axis)
    true, parts = drawer_in_its_carcass()
    pieces = {name: [thicker(board, 0.003) for board in found] for name, found in true.items()}
    ways = {name: pieces[name] for name in sorted(pieces, key=lambda name: name != fixed)}
    assert deepest(ways, joint, fixed) > 0.004
    found = parted(pieces, parts, joint, fixed)
    left = {name: [p for p in found[name] if p is not None] for name in ways}
    assert deepest(left, joint, fixed) <= TOLERANCE + 1e-6
    for name, solid in parts.items():
        surface, faces = sample_evenly(solid, 1e-5)
        surface = surface - 2e-4 * solid.face_normals[faces]
        planes = shape_planes([trimesh.convex.convex_hull(p) for p in left[name]])
        assert (depth_in_shapes(surface, np.full(len(surface), -1), *planes) >= 0).mean() > 0.98


def thicker(points: np.ndarray, by: float) -> np.ndarray:
    low, high = points.min(0) - by, points.max(0) + by
    return np.stack(np.meshgrid(*np.stack([low, high], -1), indexing="ij"), -1).reshape(-1, 3)


def test_pieces_that_are_clear_stay_as_they_are():
    pieces, parts = drawer_in_its_carcass()
    found = parted(pieces, parts, replace(SLIDE, lower=1.0, upper=1.2))
    assert all(new is old for name in pieces for new, old in zip(found[name], pieces[name], strict=True))


def test_what_turns_is_clear_between_the_states_that_were_looked_at():
    """A door with a post in its way: cut is the post's false flank, not the door."""
    hinge = Joint("hinge", "revolute", np.array([0, 0, 1.0]), np.zeros(3), 0.0, 1.5)
    parts = {"reference": block((0.02, 0.02, 0.3), (0.16, 0.16, 0)), "moving": block((0.2, 0.01, 0.3), (0.1, 0, 0))}
    pieces = {"reference": [thicker(parts["reference"].vertices, 0.02)], "moving": [np.array(parts["moving"].vertices)]}
    assert deepest(pieces, hinge, "reference", 41) > 0.005
    found = {name: [p for p in left if p is not None] for name, left in parted(pieces, parts, hinge).items()}
    assert trimesh.convex.convex_hull(found["moving"][0]).volume > 0.999 * parts["moving"].volume
    assert deepest(found, hinge, "reference", 157) <= TOLERANCE + 5e-5  # and what an arc bulges out
    planes = shape_planes([trimesh.convex.convex_hull(found["reference"][0])])
    post = parts["reference"].vertices
    assert (depth_in_shapes(post, np.full(len(post), -1), *planes) >= 0).all()


WEDGE = trimesh.convex.convex_hull(np.array([[0, -0.02, -0.02], [0, 0.02, -0.02], [0, 0, 0.03], [0.05, 0, -0.01]]))


@pytest.mark.parametrize("larger", ["reference", "moving"])
def test_what_slides_is_carved_as_it_is(larger: str):
    """A wedge pulled through a block, or a block over a wedge: what it sweeps is known."""
    way = 1 if larger == "reference" else -1  # of the wedge through the block
    solid = block((0.8, 0.2, 0.2), (0.1 * way, 0, 0))
    meshes = {"reference": WEDGE, "moving": WEDGE} | {larger: solid}
    parts = Articulation(SLIDE, *(Mesh(meshes[name].vertices, meshes[name].faces) for name in ("reference", "moving")))
    cut = carve_overlap(parts, 0.0, 0.25, TOLERANCE, Overlap(parts))
    assert isinstance(cut, CarvedPart) and cut.name == larger
    assert cut.volume == pytest.approx(WEDGE.volume + 0.25 * 0.5 * 0.04 * 0.05, rel=0.03)  # ridges between copies
    apart = replace(parts, reference=cut.mesh) if larger == "reference" else replace(parts, moving=cut.mesh)
    assert Overlap(apart).max_depth(np.linspace(0, 0.25, 9)) <= TOLERANCE


TWO_SIDES = np.array([[0, 1, 2], [0, 2, 1]])


def test_small_feet_carry_the_object():
    board, foot = trimesh.creation.box((0.3, 0.2, 0.1)), trimesh.creation.box((0.01, 0.01, 0.0052))
    feet = [foot.copy().apply_translation((x, y, 0.0026)) for x in (-0.13, 0.13) for y in (-0.08, 0.08)]
    solid = trimesh.boolean.union([board.apply_translation((0, 0, 0.055)), *feet], engine="manifold")
    made = make_collision(Mesh(np.array(solid.vertices), np.array(solid.faces)), CollisionSettings(), ground=0.0)
    low = np.concatenate([shape.vertices for shape in made.shapes])
    stands_on = low[low[:, 2] < 1e-6]
    assert {tuple(np.sign(point[:2])) for point in stands_on} == {(-1, -1), (-1, 1), (1, -1), (1, 1)}
    assert len(made.shapes) <= 6


@pytest.mark.parametrize("carved", ["reference", "moving"])
@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_a_spike_in_the_way_is_cut_and_nothing_else(carved: str, kind: str):
    """A block that passes over a plate with one point that stands up, as simplifying leaves it."""
    hinge = Joint("hinge", "revolute", np.array([0, 0, 1.0]), np.array([0, 0.3, 0]), 0.0, 0.7)
    joint = replace(SLIDE, upper=0.2) if kind == "prismatic" else hinge
    plate = block((0.6, 0.6, 0.02), (0, 0, -0.0101)).subdivide_to_size(0.012)
    spike = int(np.linalg.norm(plate.vertices - [0.1, 0, 0], axis=1).argmin())
    plate.vertices[spike, 2] += 0.003
    meshes = {"reference": block((0.05, 0.05, 0.05), (0, 0, 0.025)), "moving": block((0.05, 0.05, 0.05), (0, 0, 0.025))}
    meshes[carved] = plate
    if carved == "moving":
        joint = replace(joint, axis=-joint.axis)
    parts = Articulation(joint, *(Mesh(meshes[name].vertices, meshes[name].faces) for name in ("reference", "moving")))
    states = np.linspace(joint.lower, joint.upper, 17)
    rest = cut_spots(parts, carved, states, TOLERANCE)
    apart = replace(parts, reference=rest) if carved == "reference" else replace(parts, moving=rest)
    assert Overlap(parts).max_depth(states) > 2e-3
    assert Overlap(apart).max_depth(states) <= 1.2 * TOLERANCE, "vertices are looked at, not the edges between them"
    assert trimesh.Trimesh(rest.vertices, rest.faces).volume > 0.9999 * plate.volume
