"""Export: the reloaded asset moves exactly as the reconstruction's joint, and everything in its folder is sound."""

from __future__ import annotations

import json
import shutil
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from refusal import assert_refused
from scipy.spatial.distance import cdist
from solid_case import box

from export.checklist import allowed_off, check_asset
from export.collision import convex_hull
from export.exporter import export_result, scale_reconstruction
from export.inertia import compute_inertial, find_unphysical
from export.meshes import flip_faces, is_inside_out, write_visual
from export.settings import CollisionSettings, ExportSettings, PlacementSettings
from export.texture import texture_from_vertices
from freeart21 import doctor, se3
from freeart21.articulation import Articulation
from freeart21.effects.armature import Armature
from freeart21.effects.axis_tilt import AxisTilt
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.quadratic_drag import QuadraticDrag
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.result import write_result
from freeart21.joint import Joint
from freeart21.mesh import Mesh, join_meshes
from freeart21.reconstruction import Failure, Reconstruction
from generator.simulate import joint_motion, load, roll_out
from leaderboard.asset_measurement import measure_asset

RED, BLUE = (200, 30, 20), (20, 40, 220)


def reconstruction(
    kind: str = "revolute", states=(0.0, 0.4, 1.1), frame: int | None = None, slide: float = 0.0, **changes
) -> Reconstruction:
    """A red slab with a blue lid hinged at (or sliding from) its edge, in the canonical frame of seed `frame`."""
    axis = np.array([0.0, -1.0, 0.0])
    joint = Joint("lid joint", kind, axis, np.array([-0.1, 0, 0.02]) + slide * axis, min(states), max(states))
    parts = Articulation(joint, box((0.2, 0.15, 0.04), colour=RED), box((0.2, 0.15, 0.03), (0, 0, 0.04), BLUE))
    if frame is not None:
        rng = np.random.default_rng(frame)
        parts = parts.moved(se3.exp_se3(np.concatenate([rng.uniform(-1, 1, 3), rng.normal(size=3)])))
    parts = replace(parts, **changes)
    n = len(states)
    still = np.tile(np.eye(4), (n, 1, 1))
    return Reconstruction(
        parts,
        np.array(states, float),
        still,
        still @ parts.joint.transform(states),
        np.zeros((n, 4, 4), np.uint8),
        np.ones((n, 2), bool),
    )


EFFECTS = (ViscousDamping(0.02), CoulombFriction(0.01), ReturnSpring(0.5, 0.2))


def export_lid(out: Path) -> Path:
    hulls = ExportSettings(collision=CollisionSettings(primitives=False))
    return export_result(reconstruction(), out, hulls, effects=EFFECTS).urdf.parent


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    return export_lid(tmp_path_factory.mktemp("assets") / "lid")


@pytest.mark.parametrize(
    "kind, states, slide",
    [
        ("revolute", (-0.8, -0.2, -0.5), 20.0),
        ("prismatic", (0.3, 0.5, 0.9), 0.0),
    ],
)
def test_the_reloaded_asset_has_the_joint_and_the_parts_of_the_reconstruction(
    tmp_path: Path, kind: str, states: tuple, slide: float
):
    answer = reconstruction(kind, states, frame=len(kind), slide=slide)
    asset = export_result(answer, tmp_path / "a")
    states_driven = np.array([0.0, *states, -0.35, 1.7])
    np.testing.assert_allclose(
        joint_motion(asset, states_driven), answer.articulation.joint.transform(states_driven), atol=1e-6
    )
    assert check_asset(tmp_path / "a") == []
    simulated = load(asset)
    for state in states:
        simulated.set_state(asset.state_zero + state)
        T_canonical_world = asset.T_canonical_reference @ se3.inverse(simulated.link_pose(asset.reference_link))
        for part, link in (("reference", asset.reference_link), ("moving", asset.moving_link)):
            shown = trimesh.load_mesh(tmp_path / "a" / "meshes" / f"{part}.obj", process=False)
            there = se3.transform(T_canonical_world @ simulated.link_pose(link), shown.vertices)
            expected = answer.articulation.posed(np.eye(4), state)[part == "moving"]
            apart = cdist(there, expected.vertices)
            assert apart.min(0).max() < 1e-6 and apart.min(1).max() < 1e-6


def test_the_part_that_carries_is_the_root_and_moves_the_same_joint(tmp_path: Path):
    """The same object with its parts' names exchanged: the base still is the root, and nothing else changes."""
    answer = reconstruction()
    whole, joint = answer.articulation, answer.articulation.joint
    T = joint.transform(answer.states)
    exchanged = replace(
        answer,
        articulation=replace(
            whole, joint=replace(joint, axis=-joint.axis), reference=whole.moving, moving=whole.reference
        ),
        Ts_camera_reference=answer.Ts_camera_reference @ T,
        Ts_camera_moving=answer.Ts_camera_reference @ T @ se3.inverse(T),
    )
    upright = ExportSettings(placement=PlacementSettings(up=(0.0, 0.0, 1.0)))
    first = export_result(answer, tmp_path / "a", upright)
    asset = export_result(exchanged, tmp_path / "b", upright)
    assert asset.reference_link == "reference"
    roots = [ET.parse(each.urdf).find("joint/parent").get("link") for each in (first, asset)]
    assert roots == ["reference", "moving"]
    for mesh, same in (("reference", "moving"), ("moving", "reference")):
        one = trimesh.load_mesh(tmp_path / "a" / "meshes" / f"{mesh}.obj")
        other = trimesh.load_mesh(tmp_path / "b" / "meshes" / f"{same}.obj")
        np.testing.assert_allclose(one.bounds, other.bounds, atol=1e-6)
    limits = [ET.parse(each.urdf).find("joint/limit") for each in (first, asset)]
    assert float(limits[0].get("upper")) == pytest.approx(float(limits[1].get("upper")))
    assert check_asset(tmp_path / "b") == []
    angles = np.array([0.0, 0.3, 0.8])
    expected = exchanged.articulation.joint.transform(angles)
    np.testing.assert_allclose(joint_motion(asset, angles), expected, atol=1e-6)


def masses(folder: Path) -> dict[str, float]:
    """Link name to kg, as SAPIEN has loaded it."""
    simulated = load(read_asset(folder))
    return {link.name: float(link.mass) for link in simulated.articulation.links}


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_scaled_asset_is_the_scaled_object_and_moves_as_it(tmp_path: Path, kind: str):
    answer, k = reconstruction(kind, (0.1, 0.4, 1.1), frame=3), 0.25
    plain, small = (export_result(answer, tmp_path / str(s), ExportSettings(scale=s)) for s in (1.0, k))
    assert (plain.scale, small.scale) == (1.0, k)
    assert json.loads((tmp_path / "0.25" / "asset.json").read_text())["scale"] == k
    travel = k if kind == "prismatic" else 1.0
    angles = np.array([0.0, 0.1, 0.7, 1.2])
    shrunk = joint_motion(plain, angles)
    shrunk[:, :3, 3] *= k
    np.testing.assert_allclose(joint_motion(small, travel * angles), shrunk, atol=1e-6)
    limits = [ET.parse(asset.urdf).find("joint/limit") for asset in (plain, small)]
    for key in ("lower", "upper"):
        assert float(limits[1].get(key)) == pytest.approx(travel * float(limits[0].get(key)))
    sizes = [trimesh.load_mesh(tmp_path / s / "meshes/moving.obj", process=False).extents for s in ("1.0", "0.25")]
    np.testing.assert_allclose(sizes[1], k * sizes[0], rtol=1e-5)
    assert sum(masses(tmp_path / "0.25").values()) == pytest.approx(
        k**3 * sum(masses(tmp_path / "1.0").values()), rel=1e-4
    )
    assert check_asset(tmp_path / "0.25") == []
    assert_refused("has 0.25 times the video's lengths", measure_asset, tmp_path / "0.25", [0.0, 0.5])


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"density": 0.0}, r"density is 0 kg/m\^3, expected 0.001 to 100000"),
        ({"density": np.nan}, "density is nan"),
        ({"mass": 0.0}, "mass is 0 kg, expected 1e-06 to 1e\\+06"),
        ({"mass": 1.0, "density": 600.0}, r"density 600 kg/m\^3 and mass 1 kg: give one of them"),
        ({"scale": 0.0}, "scale is 0, expected 0.0001 to 10000"),
    ],
)
def test_settings_out_of_bounds_cost_one_line_and_leave_nothing(tmp_path: Path, settings: dict, message: str):
    assert_refused(message, export_result, reconstruction(), tmp_path / "a", ExportSettings(**settings))
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_exported_says_why_and_leaves_nothing(tmp_path: Path):
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    lid = box((0.2, 0.15, 0.03), (0, 0, 0.04))
    spiked = lid.vertices + np.array([0, 0, 97.0]) * (np.arange(8) == 3)[:, None]  # depth of a pixel without any
    far = replace(reconstruction().articulation.joint, pivot=np.array([0.0, 0.0, 1e6]))
    cases = [
        (reconstruction(states=(0.2, 0.2, 0.2)), "'lid joint' was seen to move by 0 rad, expected at least 0.001"),
        (reconstruction("prismatic", states=(0.2, 0.20005)), r"move by 5e-05 m, expected at least 0.0001"),
        (reconstruction(moving=nothing), "moving part of joint 'lid joint' is an empty mesh"),
        (reconstruction(reference=nothing), "reference part of joint 'lid joint' is an empty mesh"),
        (reconstruction(moving=flat), "moving part: mesh has no triangle of any area"),
        (reconstruction(moving=Mesh(spiked, lid.faces)), "moving part is 97 m large, expected 1 mm to 10 m"),
        (reconstruction(reference=Mesh(1e30 * lid.vertices, lid.faces)), r"reference part is 2.52e\+29 m large"),
        (reconstruction(moving=Mesh(1e-4 * lid.vertices, lid.faces)), "moving part is 2.52e-05 m large"),
        (reconstruction(joint=far), r"reference part lies 1e\+06 m from the axis of joint 'lid joint'"),
        (reconstruction("prismatic", states=(0.0, 1e5)), r"joint 'lid joint' travels 1e\+05 m, expected"),
    ]
    for answer, message in cases:
        assert_refused(message, export_result, answer, tmp_path / "a")
    with pytest.raises(FreeArtError, match="does not pass its own check: limits: joint 'lid_joint' has effort 0"):
        export_result(reconstruction(), tmp_path / "a", ExportSettings(effort=0))
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "notes.txt").write_text("mine")
    assert_refused("exists and is no older asset", export_result, reconstruction(), tmp_path / "a")
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["notes.txt"]


def test_result_folder_is_exported_with_its_origin_and_a_failure_is_refused(tmp_path: Path):
    lid, crumb = box((0.2, 0.15, 0.03), (0, 0, 0.04)), box((0.002, 0.002, 0.002), (97.0, 0, 0))
    write_result(tmp_path / "ours" / "s1", reconstruction(moving=join_meshes([lid, crumb])))  # the crumb is dropped
    (tmp_path / "ours" / "method.json").write_text('{"schema": "freeart21/method/1", "name": "ours"}')
    asset = export_result(tmp_path / "ours" / "s1", tmp_path / "asset")
    assert (asset.source["method"], asset.source["sequence"]) == ("ours", "s1")
    assert asset.source["parts"]["moving"]["collision"]["median_m"] < 5e-4
    assert asset == replace(read_asset(tmp_path / "asset"), T_canonical_reference=asset.T_canonical_reference)
    write_result(tmp_path / "ours" / "s2", Failure("segmentation", "one motion only"))
    with pytest.raises(FreeArtError, match="is a failure, nothing to export: segmentation: one motion only"):
        export_result(tmp_path / "ours" / "s2", tmp_path / "other")


def test_same_result_same_bytes(exported: Path, tmp_path: Path):
    again = export_lid(tmp_path / "again")
    files = sorted(p.relative_to(exported) for p in exported.rglob("*") if p.is_file())
    assert len(files) >= 11
    for file in files:
        assert (exported / file).read_bytes() == (again / file).read_bytes(), file


def test_effects_are_said_in_every_file_and_act(exported: Path):
    asset = read_asset(exported)
    assert asset.effects == {"lid_joint": EFFECTS}
    assert ET.parse(asset.urdf).find("joint/dynamics").attrib == {"damping": "0.02", "friction": "0.01"}
    words = ET.parse(exported / "object.xml").find(".//joint").attrib
    assert {k: float(words[k]) for k in ("damping", "frictionloss", "stiffness", "springref")} == {
        "damping": 0.02,
        "frictionloss": 0.01,
        "stiffness": 0.5,
        "springref": 0.2,
    }
    run = roll_out(asset, 0.9, duration_s=20, timestep_s=5e-3, gravity=(0, 0, 0))
    assert abs(run.q[-1] - 0.2) <= 0.01 / 0.5 + 1e-3 and np.ptp(run.q[-200:]) < 1e-5


def test_two_springs_are_more_than_a_joint_of_mjcf_can_say(tmp_path: Path):
    with pytest.raises(FreeArtError, match="two effects need MJCF's 'stiffness'"):
        export_result(reconstruction(), tmp_path / "a", effects=(ReturnSpring(1, 0), ReturnSpring(2, 0)))


def test_effects_that_share_a_word_of_mjcf_are_summed_in_it(tmp_path: Path):
    tilt = AxisTilt(0.02, 0.0)  # which the reload check knows to be beyond the URDF
    effects = (ViscousDamping(0.02), QuadraticDrag(0.01), ViscousDamping(0.03), Armature(0.01), Armature(0.02), tilt)
    asset = export_result(reconstruction(), tmp_path / "a", effects=effects)
    joint = ET.parse(asset.urdf.with_suffix(".xml")).find(".//joint")
    assert joint.get("damping") == "0.05 0.01" and joint.get("armature") == "0.03"
    assert read_asset(tmp_path / "a").effects == {"lid_joint": effects}


def test_colours_are_seen_in_sapien(exported: Path):
    try:
        doctor.require_rendering()
    except FreeArtError as error:
        pytest.skip(str(error))
    import sapien

    sapien.render.set_camera_shader_dir("trivial")
    scene = sapien.Scene()
    simulated = load(read_asset(exported), scene=scene, visuals=True)
    simulated.set_state(0.5 * simulated.upper)
    camera = scene.add_camera("c", 160, 120, 1.0, 0.01, 10)
    pixels = []
    for at, q in (([-0.6, 0, 0], [1, 0, 0, 0]), ([0.6, 0, 0], [0, 0, 0, 1])):  # from behind, and from the front
        camera.set_entity_pose(sapien.Pose(at, q))
        scene.update_render()
        camera.take_picture()
        pixels += list(camera.get_picture("Color")[..., :3].reshape(-1, 3))
    for colour in (RED, BLUE):  # this shader answers in linear light
        value = np.array(colour) / 255
        linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        assert (np.abs(np.array(pixels) - linear).max(1) <= 3 / 255).sum() > 100


# --- meshes


def test_faces_that_look_inwards_are_found_and_turned_and_said(tmp_path: Path):
    solid = box((1, 2, 3), (5, 5, 5))
    assert not is_inside_out(solid) and is_inside_out(flip_faces(solid))
    wrong = reconstruction(moving=flip_faces(box((0.2, 0.15, 0.03), (0, 0, 0.04))))
    asset = export_result(wrong, tmp_path / "a")
    assert asset.source["parts"]["moving"]["faces_turned_outwards"] is True
    assert asset.source["parts"]["reference"]["faces_turned_outwards"] is False
    assert trimesh.load_mesh(tmp_path / "a" / "meshes" / "moving.obj", process=True).volume > 0


def test_visual_obj_wears_its_texture_and_a_grey_part_has_none(tmp_path: Path):
    red = box((1, 1, 1), colour=RED)
    assert write_visual(tmp_path, "lid", red, texture_from_vertices(red, red)) == "lid.png"
    read = trimesh.load_mesh(tmp_path / "lid.obj", process=False)
    assert read.volume == pytest.approx(1)
    assert (read.visual.to_color().vertex_colors[:, :3] == RED).all()
    assert write_visual(tmp_path, "grey", box((1, 1, 1)), None) is None
    assert "map_Kd" not in (tmp_path / "grey.mtl").read_text()
    assert len(trimesh.load_mesh(tmp_path / "grey.obj", process=False).faces) == 12


# --- collision and inertia


@pytest.mark.parametrize(
    "points",
    [
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]),
        np.tile([[0.1, 0.2, 0.3]], (5, 1)),
    ],
    ids=["plane", "one point five times"],
)
def test_flat_points_get_a_hull_of_the_least_thickness(points):
    hull = convex_hull(points, 0.002, 64)
    solid = trimesh.Trimesh(hull.vertices, hull.faces)
    assert solid.is_watertight and solid.volume > 0
    _, _, axes = np.linalg.svd(hull.vertices - hull.vertices.mean(0))
    assert np.ptp(hull.vertices @ axes.T, axis=0).min() >= 0.0019
    assert find_unphysical(compute_inertial(hull, 600)) is None


def test_inertia_of_boxes_is_the_closed_form():
    a, b, c, density = 0.2, 0.3, 0.5, 600.0
    one = compute_inertial(box((a, b, c), (1, 2, 3)), density)
    mass = density * a * b * c
    assert one.mass == pytest.approx(mass)
    np.testing.assert_allclose(one.centre, [1, 2, 3])
    closed = mass / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    np.testing.assert_allclose(one.inertia, closed, atol=1e-12)
    thin = compute_inertial(box((a, b, c), (1, 2, 3)), density, 1e-6)  # a shell is what a larger box has more
    more = 2e-6
    outer = compute_inertial(box((a + more, b + more, c + more), (1, 2, 3)), density)
    assert thin.mass == pytest.approx(outer.mass - one.mass, rel=1e-4)
    np.testing.assert_allclose(thin.centre, [1, 2, 3])
    np.testing.assert_allclose(thin.inertia, outer.inertia - one.inertia, rtol=1e-4, atol=1e-12)
    assert find_unphysical(one) is None


# --- checklist


def turn_mjcf_axis(folder: Path) -> None:
    root = ET.parse(folder / "object.xml")
    root.find(".//joint").set("axis", "0.001 1 0")
    root.write(folder / "object.xml")


BREAKS = {
    "textures: moving.mtl names moving.png": lambda folder: (folder / "meshes/moving.png").unlink(),
    "numbers and meshes: ": lambda folder: (folder / "meshes/moving_hull_00.obj").write_text("v 0 0 0\nf 1 2 3\n"),
    "mjcf: object.xml puts 'moving'": turn_mjcf_axis,
    "mjcf: ": lambda folder: (folder / "object.xml").write_text(
        (folder / "object.xml").read_text().replace("meshes/moving.obj", "meshes/no.obj")
    ),
}
"""How a finding begins to what causes it. Faults of the URDF's text are in test_check_asset."""


@pytest.mark.parametrize("message", BREAKS)
def test_checklist_finds_broken_files(exported: Path, tmp_path: Path, message: str):
    folder = Path(shutil.copytree(exported, tmp_path / "a"))
    (folder / "effects.json").unlink()
    BREAKS[message](folder)
    findings = check_asset(folder)
    assert any(str(f).startswith(message) for f in findings), findings


def test_folder_that_is_no_asset_is_one_finding(tmp_path: Path):
    (finding,) = check_asset(tmp_path)
    assert finding.item == "asset" and "is not an asset" in finding.detail
    assert json.dumps(str(finding))


def test_large_objects_are_held_to_single_precision_not_to_a_micrometre(tmp_path):
    """Engines compute in single precision, whose steps grow with the lengths."""
    answer = scale_reconstruction(reconstruction(frame=0), 25.0)
    joint, angles = answer.articulation.joint, np.linspace(0, 1.1, 7)
    asset = export_result(answer, tmp_path / "asset", ExportSettings(dynamics="none"))
    motion = joint_motion(replace(asset, effects={}), angles)
    off = np.abs(motion - joint.transform(angles)).max()
    assert 1e-6 < off < 2 * allowed_off(joint.transform(angles), asset.T_canonical_reference)
