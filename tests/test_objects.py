"""Procedural objects: solid, of real size, the same for the same seed, and their joints move freely."""

from __future__ import annotations

import filecmp
import functools
from pathlib import Path

import numpy as np
import pytest
from manifold3d import Manifold

from freeart21 import catalog
from freeart21.joint import Joint
from generator import objects
from generator.model import Link, ObjectModel
from generator.partnet_writer import box_uv, crease_normals, write_partnet
from generator.shapes import box, triangles, union

NAMES = catalog.built_in_names()
SEEDS = (0, 3)

build = functools.cache(objects.build)


def _solid(links: list[Link]) -> Manifold:
    return union(piece.solid for link in links for piece in link.pieces)


def _extent(links: list[Link]) -> np.ndarray:
    bounds = np.array([piece.solid.bounding_box() for link in links for piece in link.pieces])
    return bounds[:, 3:].max(0) - bounds[:, :3].min(0)


def _joint(model: ObjectModel) -> Joint:
    hinge = model.links[model.scored_joint].hinge
    assert hinge is not None
    return Joint("j", hinge.type, np.array(hinge.axis, float), np.array(hinge.pivot), hinge.lower, hinge.upper)


@pytest.mark.parametrize("name", NAMES)
def test_links_and_joints_are_as_the_catalog_says(name: str) -> None:
    entry, model = catalog.find(name), build(name, SEEDS[0])
    assert (model.name, model.category) == (name, entry.category)
    assert f"joint_{model.scored_joint}" == entry.joint and _joint(model).type == entry.joint_type
    assert [link.hinge is None for link in model.links] == [False] * (len(model.links) - 1) + [True]
    for k, link in enumerate(model.links):
        kind = link.semantic.split(" ", 1)[0]
        if link.hinge is None:
            assert kind == "heavy"
            continue
        assert kind == {"revolute": "hinge", "prismatic": "slider"}[link.hinge.type]
        assert np.linalg.norm(link.hinge.axis) == pytest.approx(1)
        assert link.hinge.parent in {f"link_{j}" for j in range(len(model.links)) if j != k}
        assert link.hinge.lower <= 0 <= link.hinge.upper


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", NAMES)
def test_every_piece_is_a_solid_and_the_object_has_real_size_and_mass(name: str, seed: int) -> None:
    model = build(name, seed)
    for link in model.links:
        for piece in link.pieces:
            assert piece.solid.status().name == "NoError" and piece.solid.volume() > 1e-12, piece.name
    size = catalog.find(name).size_m
    assert size is not None and 0.8 * size < np.linalg.norm(_extent(list(model.links))) < 1.25 * size
    hull = Manifold.batch_hull([piece.solid for link in model.links for piece in link.pieces]).volume()
    assert 80 < sum(link.mass for link in model.links) / hull < 8000  # kg/m^3: neither foam nor all of lead
    assert sum(piece.solid.num_tri() for link in model.links for piece in link.pieces) < 30_000


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", NAMES)
def test_the_moving_link_does_not_pass_through_the_rest(name: str, seed: int) -> None:
    model = build(name, seed)
    joint = _joint(model)
    moving = model.links[model.scored_joint]
    rest = _solid([link for link in model.links if link is not moving])
    solid = _solid([moving])
    for q in np.linspace(joint.lower, joint.upper, 9):
        common = (solid.transform(joint.transform(q)[:3]) ^ rest).volume()
        assert common < 0.015 * solid.volume(), f"state {q:.2f}: {common / solid.volume():.3f} of the moving part"


@pytest.mark.parametrize("name", NAMES)
def test_nothing_hangs_in_the_air(name: str) -> None:
    model = build(name, SEEDS[0])
    near = 0.01 * float(np.linalg.norm(_extent(list(model.links))))
    for k, link in enumerate(model.links):
        assert _floating(link, near) == [], f"link {k}"


def _floating(link: Link, near: float) -> list[str]:
    """Names of the pieces with a body that no chain of others, each within `near` metres, ties to the greatest."""
    bodies = [(piece.name, body) for piece in link.pieces for body in piece.solid.decompose()]
    boxes = np.array([body.bounding_box() for _, body in bodies])
    far = set(range(len(bodies)))
    todo = [max(far, key=lambda j: bodies[j][1].volume())]
    while todo:
        k = todo.pop()
        far.discard(k)
        close = ((boxes[:, :3] <= boxes[k, 3:] + near) & (boxes[:, 3:] >= boxes[k, :3] - near)).all(1)
        found = [j for j in far if close[j] and bodies[j][1].min_gap(bodies[k][1], 1.01 * near) <= near]
        far -= set(found)
        todo += found
    return sorted({bodies[j][0] for j in far})


def test_the_same_object_is_written_as_the_same_bytes(tmp_path: Path) -> None:
    folders = [write_partnet(objects.build("stapler", 4), tmp_path / f"{k}") for k in range(2)]
    files = sorted(str(p.relative_to(folders[0])) for p in folders[0].rglob("*") if p.is_file())
    assert files == sorted(str(p.relative_to(folders[1])) for p in folders[1].rglob("*") if p.is_file())
    assert filecmp.cmpfiles(folders[0], folders[1], files, shallow=False)[1:] == ([], [])


@pytest.mark.parametrize("tile", [None, 0.5])
def test_pictures_read_upright_and_unmirrored_on_all_side_faces(tile: float | None) -> None:
    vertices, faces = triangles(box((1, 2, 3)))
    uv = box_uv(vertices, faces, tile)
    for face, coordinates in zip(faces, uv, strict=True):
        a, b, c = vertices[face]
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        jacobian = np.linalg.lstsq(np.stack([b - a, c - a]), coordinates[1:] - coordinates[0], rcond=None)[0].T
        assert np.dot(np.cross(jacobian[0], jacobian[1]), normal) > 0, "mirrored"
        if abs(normal[2]) < 0.5:
            assert jacobian[1][2] > 0 and np.allclose(jacobian[1][:2], 0), "not upright"
        if tile is not None:
            assert np.allclose(np.linalg.norm(jacobian, axis=1), 1 / tile)
    if tile is None:
        assert uv.min() == 0 and uv.max() == 1


def test_normals_stay_sharp_at_edges_and_smooth_on_curves() -> None:
    vertices, faces = triangles(box((1, 2, 3)))
    corners = vertices[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert np.allclose(crease_normals(vertices, faces), flat[:, None])
    vertices, faces = triangles(Manifold.sphere(2.0, 64))
    assert (np.einsum("fkc,fkc->fk", crease_normals(vertices, faces), vertices[faces]) / 2 > 0.999).all()
