"""One loader for PartNet-Mobility folders, ours and real: every habit they show, and one clear line for a fault."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from freeart21 import catalog, se3
from freeart21.camera import Camera
from freeart21.doctor import require_rendering
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_urdf_joints
from generator import objects, partnet
from generator.model import Hinge, Link, Material, ObjectModel, Piece
from generator.partnet_writer import R_ROOT_MESH, write_partnet
from generator.shapes import box, triangles

NAMES = catalog.built_in_names()
REAL = Path(__file__).resolve().parents[2] / "shared" / "partnet_mobility"
real_objects = pytest.mark.skipif(not (REAL / "41083").is_dir(), reason="the real objects are not on this machine")


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    place = tmp_path_factory.mktemp("partnet")
    return {name: write_partnet(objects.build(name, 0), place / name) for name in NAMES}


@pytest.fixture
def stapler(folders: dict[str, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(folders["stapler"], tmp_path / "stapler"))


def _edit(folder: Path, change: Callable[[str], str]) -> Path:
    urdf = folder / "mobility.urdf"
    text = urdf.read_text()
    changed = change(text)
    assert changed != text
    urdf.write_text(changed)
    return folder


def _limits(text: str, joint: str, lower: str, upper: str) -> str:
    return re.sub(
        rf'(<joint name="{joint}".*?<limit )lower="[^"]*" upper="[^"]*"',
        rf'\1lower="{lower}" upper="{upper}"',
        text,
        flags=re.S,
    )


# --- writer to loader -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_written_objects_come_back_with_their_joint_sides_and_shape(name: str, folders: dict[str, Path]) -> None:
    model = objects.build(name, 0)
    loaded = partnet.load(folders[name])
    hinge = model.links[model.scored_joint].hinge
    assert hinge is not None
    assert loaded.joint.type == hinge.type and (loaded.joint.lower, loaded.joint.upper) == (hinge.lower, hinge.upper)
    assert np.allclose(loaded.joint.axis, hinge.axis, atol=1e-12)
    assert np.allclose(loaded.joint.pivot, hinge.pivot, atol=1e-12)
    assert loaded.category == model.category
    child = {f"link_{model.scored_joint}"}
    assert set(loaded.child_side.links) == child
    for side, links in zip(
        loaded.sides,
        ([k for k in range(len(model.links)) if k != model.scored_joint], [model.scored_joint]),
        strict=True,
    ):
        pieces = [piece for k in links for piece in model.links[k].pieces]
        corners = np.concatenate([triangles(piece.solid)[0] for piece in pieces])
        assert len(side.surface.faces) == sum(piece.solid.num_tri() for piece in pieces)
        assert np.allclose(np.sort(side.surface.vertices.min(0)), np.sort(corners.min(0)), atol=1e-8)
        assert np.allclose(side.surface.vertices.max(0), corners.max(0), atol=1e-8)
        volume = np.einsum("fc,fc->", *_volume(side.surface.vertices, side.surface.faces)) / 6
        assert volume == pytest.approx(sum(piece.solid.volume() for piece in pieces), rel=1e-5)  # faces look outwards


def _volume(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return a, np.cross(b, c)


@pytest.mark.parametrize("name", NAMES)
def test_written_folders_have_the_habits_of_real_ones(name: str, folders: dict[str, Path]) -> None:
    text = (folders[name] / "mobility.urdf").read_text()
    assert '<link name="base"' in text and "inertial" not in text and "dynamics" not in text
    assert "effort" not in text and "velocity" not in text and "scale=" not in text
    joints = list(read_urdf_joints(folders[name] / "mobility.urdf").values())
    assert (
        joints[-1].type == "fixed" and joints[-1].parent == "base" and text.rindex("<joint") > text.rindex("<link name")
    )
    assert 'rpy="1.570796326794897 0 -1.570796326794897"' in text
    names = re.findall(r'<visual name="([^"]*)"', text)
    assert len(names) > len(set(names)), "real objects repeat visual names"
    assert re.findall(r"<visual.*?<mesh filename=\"([^\"]*)\"", text, re.S) == re.findall(
        r"<collision.*?<mesh filename=\"([^\"]*)\"", text, re.S
    )
    bounds = json.loads((folders[name] / "bounding_box.json").read_text())
    surface = np.concatenate([side.surface.vertices for side in partnet.load(folders[name]).sides]) @ R_ROOT_MESH
    assert np.allclose(surface.min(0), bounds["min"], atol=1e-8) and np.allclose(
        surface.max(0), bounds["max"], atol=1e-8
    )
    mobility = json.loads((folders[name] / "mobility_v2.json").read_text())
    kinds = {"hinge": "revolute", "slider": "prismatic", "heavy": "fixed"}
    assert [kinds[entry["joint"]] for entry in mobility] == [joint.type for joint in joints]


def test_colours_of_the_pictures_reach_the_vertices(folders: dict[str, Path]) -> None:
    mesh = partnet.load(folders["flip_lighter"]).parent_side.surface.subdivided(0.001).mesh()
    assert mesh.colours is not None and len(np.unique(mesh.colours, axis=0)) > 50
    plain = Material("red", (1.0, 0.5, 0.0), "plastic", 1.0)
    base = Link("heavy body", (Piece("block", box((1, 1, 1)), plain),))
    lid = Link(
        "hinge lid",
        (Piece("lid", box((1, 1, 0.1), (0, 0, 1)), plain),),
        Hinge("revolute", "link_1", (0, 1, 0), (0.5, 0, 1), 0, 1),
    )
    folder = write_partnet(ObjectModel("toy", "Box", (lid, base), 0, 0), folders["stapler"].parent / "toy")
    colours = partnet.load(folder).child_side.surface.mesh().colours
    assert (colours == [255, 128, 0]).all()


# --- habits -----------------------------------------------------------------------------------------------------------


def test_the_json_is_never_asked_for_the_joint(stapler: Path) -> None:
    before = partnet.load(stapler).joint
    data = json.loads((stapler / "mobility_v2.json").read_text())
    for entry in data:
        if entry["jointData"]:
            entry["jointData"]["axis"]["direction"] = [0, 0, -1]
            entry["jointData"]["limit"] = {"a": -90, "b": 90, "noLimit": True}
    (stapler / "mobility_v2.json").write_text(json.dumps(data))
    after = partnet.load(stapler).joint
    assert np.array_equal(before.axis, after.axis) and (before.lower, before.upper) == (after.lower, after.upper)
    (stapler / "mobility_v2.json").unlink()
    assert np.array_equal(partnet.load(stapler).joint.pivot, before.pivot)


def test_minus_zero_limits_become_zero(stapler: Path) -> None:
    joint = partnet.load(_edit(stapler, lambda t: _limits(t, "joint_1", "-0.0", "1.57"))).joint
    assert joint.lower == 0 and not np.signbit(joint.lower)


def test_a_joint_whose_limits_exclude_zero_is_held_at_the_nearest(stapler: Path) -> None:
    loaded = partnet.load(_edit(stapler, lambda t: _limits(t, "joint_0", "-0.2", "-0.1")))
    assert loaded.asset.held == {"joint_0": -0.1}
    straight = partnet.load(_edit(stapler, lambda t: _limits(t, "joint_0", "-0.2", "0.1")))
    assert straight.asset.held == {"joint_0": 0.0}
    moved = np.abs(loaded.parent_side.surface.vertices - straight.parent_side.surface.vertices).max()
    assert 0.005 < moved < 0.03  # the magazine is posed as it is held


def test_a_continuous_joint_has_no_limits(stapler: Path) -> None:
    _edit(
        stapler,
        lambda t: re.sub(r'(name="joint_1" type=)"revolute"(.*?)<limit [^>]*>', r'\1"continuous"\2', t, flags=re.S),
    )
    joint = partnet.load(stapler).joint
    assert joint.type == "revolute" and (joint.lower, joint.upper) == (-np.inf, np.inf)


def test_a_link_below_a_moving_link_moves_with_it_and_its_mesh_stays_in_the_object_frame(tmp_path: Path) -> None:
    grey = Material("grey", (0.5, 0.5, 0.5), "plastic", 1000)
    knob = Link(
        "hinge knob",
        (Piece("knob", box((0.1, 0.1, 0.1), (0.8, 0, 2)), grey),),
        Hinge("revolute", "link_1", (1, 0, 0), (0.75, 0, 2), 0, 1),
    )
    door = Link(
        "hinge door",
        (Piece("door", box((1, 0.1, 1), (0.5, 0, 2)), grey),),
        Hinge("revolute", "link_2", (0, 0, 1), (0, 0, 2), -1, 1),
    )
    body = Link("heavy body", (Piece("body", box((1, 1, 1)), grey),))
    folder = write_partnet(ObjectModel("cupboard", "Box", (knob, door, body), 1, 0), tmp_path / "cupboard")
    loaded = partnet.load(folder)
    assert set(loaded.child_side.links) == {"link_0", "link_1"} and set(loaded.parent_side.links) == {"base", "link_2"}
    assert np.allclose(loaded.child_side.surface.vertices.max(0), (1, 0.05, 2.5))
    inner = partnet.load(folder, "joint_0")
    assert inner.child_side.links == ("link_0",) and np.allclose(inner.joint.pivot, (0.75, 0, 2))
    assert np.allclose(inner.joint.axis, (1, 0, 0))


def test_our_link_poses_are_the_simulators(folders: dict[str, Path]) -> None:
    require_rendering()
    from generator.scene import Scene

    for name in NAMES:
        loaded = partnet.load(folders[name])
        scene = Scene(
            loaded.asset.urdf, [s.links for s in loaded.sides], Camera.from_fov(32, 32, 1.0), 0.01, 10, "trivial"
        )
        T = se3.exp_se3([0.1, -0.2, 1.0, 0.4, -0.8, 0.3])
        q = 0.7 * loaded.joint.upper
        scene.render(T, {loaded.joint.name: q})
        poses = scene.link_poses()
        parent, child = loaded.asset.reference_link, loaded.asset.moving_link
        assert np.allclose(poses["base"], T, atol=1e-6)
        assert np.allclose(poses[parent], T @ loaded.asset.T_canonical_reference, atol=1e-6)
        T_child = partnet.link_poses(*_tree(loaded.asset.urdf), {})[child]
        assert np.allclose(poses[child], T @ loaded.joint.transform(q) @ T_child, atol=1e-6)


def _tree(urdf: Path) -> tuple:
    import xml.etree.ElementTree as ET

    joints = read_urdf_joints(urdf)
    return joints, partnet.read_motions(ET.fromstring(urdf.read_bytes()), joints, urdf)


# --- faults -----------------------------------------------------------------------------------------------------------


def _fails(folder: Path, message: str, joint: str | None = None) -> None:
    with pytest.raises(FreeArtError, match=message) as caught:
        partnet.load(folder, joint)
    assert "\n" not in str(caught.value)


def test_an_unknown_joint_lists_the_movable_ones(stapler: Path) -> None:
    _fails(stapler, r"no movable joint 'lid'; movable joints: joint_0, joint_1$", "lid")
    _fails(stapler, r"no movable joint 'joint_2'; movable joints: joint_0, joint_1$", "joint_2")


def test_several_joints_and_none_named_lists_them(stapler: Path) -> None:
    (stapler / "meta.json").unlink()
    _fails(stapler, "no joint was named; movable joints: joint_0, joint_1$")


def test_a_missing_mesh_is_named_or_left_out_on_request(stapler: Path) -> None:
    (stapler / "textured_objs" / "original-3.obj").unlink()
    _fails(stapler, r"names the mesh textured_objs/original-3.obj, which does not exist;")
    loaded = partnet.load(stapler, skip_missing=True)
    assert loaded.missing == ("textured_objs/original-3.obj",)


def test_a_missing_picture_or_material_library_is_named(stapler: Path) -> None:
    (stapler / "images" / "texture_2.png").unlink()
    _fails(stapler, r"names the picture ../images/texture_2.png, which does not exist")
    (stapler / "textured_objs" / "original-2.mtl").unlink()
    _fails(stapler, r"names the material library original-2.mtl, which does not exist")


def test_a_joint_without_range_is_refused(stapler: Path) -> None:
    _fails(
        _edit(stapler, lambda t: _limits(t, "joint_1", "0.5", "0.5")),
        r"'joint_1' cannot move: its limits are \[0.5, 0.5\]",
    )


def test_a_joint_without_direction_is_refused(stapler: Path) -> None:
    _fails(
        _edit(stapler, lambda t: re.sub(r'<axis xyz="[^"]*"', '<axis xyz="0 0 0"', t)), "axis .*expected a direction"
    )
    _fails(_edit(stapler, lambda t: t.replace('<axis xyz="0 0 0"', '<axis xyz="0 nan 0"')), "expected three numbers")


def test_a_folder_without_urdf_a_broken_urdf_and_a_mesh_outside_are_refused(stapler: Path, tmp_path: Path) -> None:
    _fails(tmp_path, "is not a PartNet-Mobility object: it has no mobility.urdf")
    _fails(
        _edit(stapler, lambda t: t.replace("textured_objs/original-1.obj", "../../secret.obj")),
        "leads out of the folder",
    )
    (stapler / "mobility.urdf").write_text("<robot><link")
    _fails(stapler, "is not XML")


def test_links_in_a_loop_and_two_roots_are_refused(stapler: Path) -> None:
    text = (stapler / "mobility.urdf").read_text()
    _edit(stapler, lambda t: t.replace('<parent link="base" />', '<parent link="link_1" />'))
    _fails(stapler, "has the root links none, expected one")
    (stapler / "mobility.urdf").write_text(text)
    _edit(stapler, lambda t: t.replace('<parent link="link_2" />', '<parent link="elsewhere" />', 1))
    _fails(stapler, "has the root links base, elsewhere, expected one")


def test_a_link_without_surface_is_refused(stapler: Path) -> None:
    _edit(stapler, lambda t: re.sub(r'(<link name="link_1">).*?</link>', r"\1</link>", t, flags=re.S))
    _fails(stapler, r"joint 'joint_1' has no surface on the side of links link_1")


def test_a_file_that_is_no_obj_is_refused(stapler: Path) -> None:
    (stapler / "textured_objs" / "original-1.obj").write_text("v 0 0 0\nf 1 2 9\n")
    _fails(stapler, "original-1.obj is not a readable OBJ file")


# --- the real objects -------------------------------------------------------------------------------------------------


@real_objects
@pytest.mark.parametrize(
    ("name", "joint", "kind", "axis", "upper"),
    [
        ("41083", "joint_0", "revolute", (0, 0, 1), np.pi / 2),
        ("41083", "joint_1", "revolute", (0, 0, -1), np.pi / 2),  # its JSON says +y and -90 degrees
        ("41083", "joint_2", "prismatic", (-1, 0, 0), 0.64),
        ("40147", "joint_0", "revolute", (0, 0, 1), np.pi / 2),
        ("40147", "joint_1", "prismatic", (-1, 0, 0), 0.6),
    ],
)
def test_real_objects_load_as_their_urdf_says(name: str, joint: str, kind: str, axis: tuple, upper: float) -> None:
    loaded = partnet.load(REAL / name, joint)
    assert loaded.joint.type == kind and np.allclose(loaded.joint.axis, axis, atol=1e-12)
    assert loaded.joint.lower == 0 and not np.signbit(loaded.joint.lower) and loaded.joint.upper == pytest.approx(upper)
    bounds = json.loads((REAL / name / "bounding_box.json").read_text())
    points = np.concatenate([side.surface.vertices for side in loaded.sides]) @ R_ROOT_MESH
    assert np.allclose(points.min(0), bounds["min"], atol=1e-5) and np.allclose(points.max(0), bounds["max"], atol=1e-5)
    assert loaded.child_side.links == (joint.replace("joint", "link"),)
    assert loaded.category == "StorageFurniture"
    assert (
        loaded.semantics[loaded.child_side.links[0]]
        == {"revolute": "hinge rotation_door", "prismatic": "slider drawer"}[kind]
    )
    colours = loaded.child_side.surface.mesh().colours
    assert colours is not None and colours.std() > 0


@real_objects
def test_a_real_hinge_touches_its_door_and_a_sliders_pivot_means_nothing() -> None:
    door = partnet.load(REAL / "41083", "joint_1")
    points = door.child_side.surface.vertices
    along = points - door.joint.pivot
    distance = np.linalg.norm(along - np.outer(along @ door.joint.axis, door.joint.axis), axis=1)
    assert distance.min() < 0.05  # a wrong root turn or mesh origin would tear the door from its hinge
    assert np.array_equal(partnet.load(REAL / "40147", "joint_1").joint.pivot, (0, 0, 0))


@real_objects
def test_an_unknown_joint_of_a_real_object_lists_its_joints() -> None:
    _fails(REAL / "41083", r"movable joints: joint_0, joint_1, joint_2, joint_3$")
    _fails(REAL / "41083", r"no movable joint 'joint_4'; movable joints", "joint_4")
