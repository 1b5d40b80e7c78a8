"""Procedural objects: solid, of real size, the same for the same seed, and their joints move freely."""

from __future__ import annotations

import filecmp
from pathlib import Path

import numpy as np
import pytest
from manifold3d import Manifold

from freeart21 import catalog
from freeart21.joint import Joint
from generator import objects
from generator.model import Link, ObjectModel
from generator.partnet_writer import box_uv, crease_normals, write_partnet
from generator.shapes import box, plate, polygon, rod, round_box, triangles, union

NAMES = catalog.built_in_names()


def _solid(links: list[Link]) -> Manifold:
    return union(piece.solid for link in links for piece in link.pieces)


def _joint(model: ObjectModel) -> Joint:
    hinge = model.links[model.scored_joint].hinge
    assert hinge is not None
    return Joint("j", hinge.type, np.array(hinge.axis, float), np.array(hinge.pivot), hinge.lower, hinge.upper)


@pytest.mark.parametrize("seed", [0, 7])
@pytest.mark.parametrize("name", NAMES)
def test_every_piece_is_a_solid_and_the_object_has_real_size_and_mass(name: str, seed: int) -> None:
    model = objects.build(name, seed)
    for link in model.links:
        for piece in link.pieces:
            assert piece.solid.status().name == "NoError" and piece.solid.volume() > 1e-12, piece.name
    bounds = np.array(_solid(list(model.links)).bounding_box())
    diagonal = np.linalg.norm(bounds[3:] - bounds[:3])
    said = catalog.find(name).size_m
    assert said is not None and 0.8 * said < diagonal < 1.25 * said
    hull = Manifold.batch_hull([piece.solid for link in model.links for piece in link.pieces]).volume()
    assert 80 < sum(link.mass for link in model.links) / hull < 8000  # kg/m^3: neither foam nor all of lead


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("name", NAMES)
def test_the_moving_link_does_not_pass_through_the_rest(name: str, seed: int) -> None:
    model = objects.build(name, seed)
    joint = _joint(model)
    moving = model.links[model.scored_joint]
    rest = _solid([link for link in model.links if link is not moving])
    solid = _solid([moving])
    for q in np.linspace(joint.lower, joint.upper, 7):
        common = (solid.transform(joint.transform(q)[:3]) ^ rest).volume()
        assert common < 0.015 * solid.volume(), f"state {q:.2f}: {common / solid.volume():.3f} of the moving part"


@pytest.mark.parametrize("name", NAMES)
def test_same_seed_same_bytes_other_seed_other_object(name: str, tmp_path: Path) -> None:
    folders = [write_partnet(objects.build(name, seed), tmp_path / f"{k}") for k, seed in enumerate((4, 4, 5))]
    files = sorted(str(p.relative_to(folders[0])) for p in folders[0].rglob("*") if p.is_file())
    assert files == sorted(str(p.relative_to(folders[1])) for p in folders[1].rglob("*") if p.is_file())
    assert filecmp.cmpfiles(folders[0], folders[1], files, shallow=False)[1:] == ([], [])
    sizes = [np.array(_solid(list(objects.build(name, seed).links)).bounding_box()) for seed in (4, 5)]
    assert np.abs(sizes[0] - sizes[1]).max() > 1e-4


def test_several_links_materials_and_both_textured_and_plain_areas() -> None:
    for name in NAMES:
        model = objects.build(name, 1)
        materials = {piece.material.name: piece.material for link in model.links for piece in link.pieces}
        assert len(model.links) >= 2 and len(materials) >= 6
        assert any(m.texture is not None for m in materials.values())
        assert any(m.texture is None for m in materials.values())


def test_shapes_have_the_volumes_of_their_closed_forms() -> None:
    a, b, c, e = 3.0, 2.0, 1.0, 0.1
    # the bevel takes prisms of section e^2 / 2 off the 12 edges, and all but e^3 / 6 off the corners, where three meet
    prisms = 4 * (e**2 / 2) * ((a - 2 * e) + (b - 2 * e) + (c - 2 * e))
    assert box((a, b, c), bevel=0).volume() == pytest.approx(6.0)
    corner = e**3 * 5 / 6
    assert box((a, b, c), bevel=e).volume() == pytest.approx(6.0 - prisms - 8 * corner, rel=1e-9)
    assert rod(0.5, 2.0, "x", segments=512).volume() == pytest.approx(np.pi * 0.5, rel=1e-4)
    radius = 0.2
    core = np.array([3.0, 2.0, 1.0]) - 2 * radius
    steiner = np.prod(core) + 2 * radius * (core[0] * core[1] + core[1] * core[2] + core[2] * core[0])
    steiner += np.pi * radius**2 * core.sum() + 4 / 3 * np.pi * radius**3
    assert round_box((3, 2, 1), radius, segments=96).volume() == pytest.approx(steiner, rel=2e-3)


@pytest.mark.parametrize(
    ("axis", "low", "high"),
    [("x", (4.9, 0, 0), (5.1, 3, 1)), ("y", (0, 4.9, 0), (3, 5.1, 1)), ("z", (0, 0, 4.9), (3, 1, 5.1))],
)
def test_a_plate_lies_where_its_axis_says(axis: str, low: tuple, high: tuple) -> None:
    solid = plate(polygon([[0, 0], [3, 0], [3, 1]]), 0.2, axis, 5.0)  # type: ignore[arg-type]
    assert np.allclose(solid.bounding_box(), (*low, *high)) and solid.volume() == pytest.approx(0.3)


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


def test_an_unknown_object_lists_the_known() -> None:
    from freeart21.errors import FreeArtError

    with pytest.raises(
        FreeArtError, match="unknown object 'teapot'; objects: swivel_usb, flip_cap_usb, .*filing_cabinet"
    ):
        catalog.find("teapot")
    with pytest.raises(FreeArtError, match="unknown object '41083'"):
        catalog.find("41083")
    assert catalog.find("41083", partnet=True).source == "partnet"


def test_the_catalog_holds_the_21_official_objects_as_15_hinges_and_6_sliders() -> None:
    official = [entry for entry in catalog.CATALOG if entry.benchmark == "FreeArt-21"]
    assert len({entry.name for entry in official}) == 21
    assert sum(entry.joint_type == "revolute" for entry in official) == 15
    assert sum(entry.joint_type == "prismatic" for entry in official) == 6
