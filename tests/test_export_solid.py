"""What an asset is made of for physics: collision shapes, mass, and guessed dynamics."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import trimesh
from solid_case import as_mesh, tray
from test_export import reconstruction

from export.check.contact_rule import judge_contact
from export.collision import convex_hull, make_collision
from export.contact import read_link_shapes
from export.decomposition import Tolerance, decompose
from export.exporter import export_result
from export.fidelity import measure_fidelity
from export.mjcf import format_mjcf
from export.model import AssetModel, LinkModel
from export.outer_surface import sample_outer_surface
from export.primitive_fit import fit_primitive
from export.primitives import Box, Cylinder, Sphere
from export.settings import CollisionSettings, ExportSettings, MeshSettings
from export.urdf import format_urdf
from freeart21 import se3
from freeart21.files.urdf import UrdfInertial, read_urdf
from freeart21.joint import Joint
from freeart21.mesh import Mesh


def turned_pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return se3.exp_se3(np.concatenate([0.1 * rng.normal(size=3), rng.normal(size=3)]))


SHAPES = (
    Box(np.array([0.1, 0.2, 0.3]), turned_pose(0)),
    Cylinder(0.05, 0.4, turned_pose(1)),
    Sphere(0.07, turned_pose(2)),
)


def test_primitives_stand_in_urdf_and_mjcf_where_the_model_has_them(tmp_path: Path):
    import mujoco

    ball = trimesh.creation.icosphere(1, 0.1)
    ball.export(tmp_path / "ball.obj")
    tensor = 1e-3 * np.array([[20, 1, 2], [1, 25, 3], [2, 3, 30]])
    body = UrdfInertial(1.0, np.array([0.01, 0.02, 0.03]), tensor)
    reference = LinkModel("reference", "ball.obj", None, ("ball.obj",), body, SHAPES)
    moving = LinkModel("moving", "ball.obj", None, (), body, SHAPES[:1])
    joint = Joint("hinge", "revolute", np.array([0, 0, 1.0]), np.zeros(3), -1.0, 1.0)
    model = AssetModel("object", reference, moving, joint, 1.0, 1.0)
    (tmp_path / "a.urdf").write_bytes(format_urdf(model))
    (tmp_path / "a.xml").write_bytes(format_mjcf(model))
    read = read_urdf(tmp_path / "a.urdf").links["reference"].collisions
    loaded = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    data = mujoco.MjData(loaded)
    mujoco.mj_forward(loaded, data)
    assert [shape.kind for shape in read] == ["mesh", "box", "cylinder", "sphere"]
    for k, shape in enumerate(SHAPES, 1):
        np.testing.assert_allclose(read[k].T_link_shape, shape.T_link_shape, atol=1e-12)
        geom = data.geom(f"reference_collision_{k:02d}")
        np.testing.assert_allclose(geom.xpos, shape.T_link_shape[:3, 3], atol=1e-12)
        np.testing.assert_allclose(geom.xmat.reshape(3, 3), shape.T_link_shape[:3, :3], atol=1e-12)
    inertial = read_urdf(tmp_path / "a.urdf").links["reference"].inertial
    axes = se3.rotation_from_wxyz(loaded.body("reference").iquat)
    np.testing.assert_allclose(inertial.inertia, tensor)
    np.testing.assert_allclose(axes * loaded.body("reference").inertia @ axes.T, tensor, atol=1e-9)
    np.testing.assert_allclose([inertial.centre, loaded.body("reference").ipos], [body.centre] * 2)
    half = loaded.geom("reference_collision_01").size
    np.testing.assert_allclose([*half, *read[1].size], [0.05, 0.1, 0.15, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(loaded.geom("reference_collision_02").size[:2], [0.05, 0.2])
    names = [e.get("name") for e in ET.parse(tmp_path / "a.urdf").iter("collision")]
    assert len(set(names)) == len(names) == 5


TOLERANCE = Tolerance(1.2e-3, 1e-4, 60_000)


@pytest.mark.parametrize("shape", SHAPES, ids=["box", "cylinder", "sphere"])
def test_a_part_that_is_a_primitive_is_found_to_be_that_one(shape):
    outside = sample_outer_surface(shape.mesh())
    (piece,) = decompose(outside, TOLERANCE, 16)
    found = fit_primitive(piece, outside, 1.2e-3)
    assert type(found) is type(shape)
    np.testing.assert_allclose(found.T_link_shape[:3, 3], shape.T_link_shape[:3, 3], atol=1e-4)
    assert trimesh.Trimesh(found.mesh().vertices, found.mesh().faces).volume == pytest.approx(
        trimesh.Trimesh(shape.mesh().vertices, shape.mesh().faces).volume, rel=0.01
    )
    fidelity = measure_fidelity(outside, [found.mesh()])
    assert fidelity.median < 3e-4 and fidelity.worst < 1e-3


def test_a_part_of_boxes_is_boxes():
    """A slab with a block on it: two pieces, both of them boxes."""
    slab, block = (
        trimesh.creation.box(size, se3.pose(np.eye(3), at))
        for size, at in (((0.2, 0.1, 0.01), (0, 0, 0)), ((0.05, 0.1, 0.05), (0.05, 0, 0.03)))
    )
    cut = make_collision(as_mesh(trimesh.boolean.union([slab, block])), CollisionSettings())
    assert len(cut.primitives) >= 2 and len(cut.hulls) + len(cut.primitives) <= 4
    assert all(isinstance(shape, Box) for shape in cut.primitives)
    fidelity = measure_fidelity(cut.surface, cut.shapes)
    assert fidelity.median < 2e-4 and fidelity.outward < 2e-3
    assert make_collision(as_mesh(slab), CollisionSettings(primitives=False)).primitives == ()


def test_fidelity_of_known_shapes():
    """A box of 100 mm under one that is 1 mm larger all round, and under one that lacks its upper 10 mm."""
    outside = sample_outer_surface(as_mesh(trimesh.creation.box((0.1, 0.1, 0.1))))
    larger = measure_fidelity(outside, [as_mesh(trimesh.creation.box((0.102, 0.102, 0.102)))])
    assert larger.median == pytest.approx(1e-3, abs=1e-5) and larger.uncovered == 0
    assert 1e-3 <= larger.outward <= np.sqrt(3) * 1e-3  # corners, less what lies between points
    short = trimesh.creation.box((0.1, 0.1, 0.09), se3.pose(np.eye(3), (0, 0, -0.005)))
    lacking = measure_fidelity(outside, [as_mesh(short)])
    assert lacking.median == pytest.approx(0, abs=1e-6) and lacking.outward == pytest.approx(0, abs=1e-6)
    assert lacking.uncovered == pytest.approx(0.01, rel=0.01)


def test_an_open_sheet_is_a_plate_behind_it():
    outside = sample_outer_surface(
        Mesh(np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0.0]]), [[0, 1, 2], [0, 2, 3]])
    )
    (piece,) = decompose(outside, TOLERANCE, 16)
    np.testing.assert_allclose(np.ptp(piece, axis=0), [0.1, 0.1, 0.001], atol=1e-6)
    assert outside.excess(np.array([[0.05, 0.05, 0.003], [0.05, 0.05, -0.003]])).tolist() == pytest.approx([0.003, 0])


def test_corners_of_a_piece_are_no_micrometres_apart():
    """What lacks three micrometres of thickness gets corners beside its own, which Drake would refuse."""
    box = trimesh.creation.box((0.01, 0.005, 0.997e-3), turned_pose(3)).vertices
    corners = convex_hull(box, 1e-3, 48).vertices
    apart = np.linalg.norm(corners[:, None] - corners, axis=-1) + np.eye(len(corners))
    assert apart.min() > 9e-6
    assert len(convex_hull(trimesh.creation.icosphere(4).vertices, 1e-3, 6).vertices) >= 4  # few corners make a solid


def test_pieces_end_at_the_ground_whatever_they_stand_out_by():
    """A slab whose underside is rough by half a millimetre: what touches the ground lies in one plane."""
    solid = trimesh.creation.box((0.2, 0.1, 0.02)).subdivide().subdivide().subdivide().subdivide()
    under = solid.vertices[:, 2] < -0.0099
    solid.vertices[under, 2] += np.random.default_rng(0).uniform(0, 5e-4, under.sum())
    ground = float(solid.vertices[:, 2].min())
    cut = make_collision(as_mesh(solid), CollisionSettings(), ground)
    heights = np.concatenate([shape.vertices[:, 2] for shape in cut.shapes]) - ground
    assert heights.min() == pytest.approx(0, abs=5e-5)
    assert not ((heights > 5e-5) & (heights < 1e-3)).any()
    standing = np.concatenate([shape.vertices for shape in cut.shapes])[heights < 5e-5]
    np.testing.assert_allclose(np.ptp(standing[:, :2], axis=0), [0.2, 0.1], atol=2e-3)
    fidelity = measure_fidelity(cut.surface, cut.shapes)
    assert fidelity.median < 5e-4 and fidelity.outward < 2e-3


def test_what_stands_out_within_keeps_its_shape_and_pebbles_share_some():
    """In a tray: a pin of 7 mm, six tolerances high, and nine pebbles of 5.5 mm, 4 mm apart."""
    pin = trimesh.creation.box((0.003, 0.003, 0.008), se3.pose(np.eye(3), (0.05, 0, -0.033)))
    pebbles = [
        trimesh.creation.box((0.003, 0.003, 0.006), se3.pose(np.eye(3), (0.007 * i - 0.05, 0.007 * j, -0.0335)))
        for i in range(3)
        for j in range(3)
    ]
    found = {}
    for name, more in (("plain", []), ("pin", [pin]), ("pebbles", pebbles)):
        made = make_collision(as_mesh(trimesh.boolean.union([tray(0.004), *more])), CollisionSettings())
        found[name] = len(made.shapes), measure_fidelity(made.surface, made.shapes).uncovered
    assert found["plain"][0] == 5 and found["pin"][0] == 6 and 5 < found["pebbles"][0] < 5 + 9
    assert found["pin"][1] < 2e-3 and found["pebbles"][1] < 4e-3


def test_triangles_that_bound_no_solid_get_a_hull_and_a_note(tmp_path: Path, monkeypatch):
    """A soup: cutting it into convex pieces and carving what it sweeps took eight minutes, for nothing."""
    rng = np.random.default_rng(0)
    soup = Mesh(0.05 * rng.normal(size=(300, 3)), rng.integers(0, 300, (500, 3)))
    worked_on = []

    def pieces(outside, *settings):
        worked_on.append(len(outside.points))
        return decompose(outside, *settings)

    monkeypatch.setattr("export.collision.decompose", pieces)
    monkeypatch.setattr("export.parts.carve_overlap", lambda *_: pytest.fail("carved"))
    coarse = ExportSettings(usd=False, meshes=MeshSettings(points=1000, max_faces=1000))
    asset = export_result(reconstruction(moving=soup), tmp_path / "a", coarse)
    assert len(worked_on) == 1  # the slab alone
    facts = asset.source["parts"]
    assert facts["reference"]["solid"] and facts["moving"]["solid"] is False and facts["moving"]["layers"] > 4
    assert facts["moving"]["hulls"] + facts["moving"]["primitives"] == 1
    assert asset.source["penetration"]["not_carved_because"] == "the moving part is no solid"
    assert judge_contact(*read_link_shapes(asset.urdf), asset.urdf.parent).verdict == "fail"
