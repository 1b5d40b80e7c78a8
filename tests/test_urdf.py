"""The one reader of URDFs: against yourdfpy, a reader of others, and against files that mean harm."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mutations import MUTATED, reads_or_refuses
from refusal import assert_refused
from test_export import reconstruction

from export.check.tree import build_tree, freeze_mimics
from export.exporter import export_result
from freeart21.errors import FreeArtError
from freeart21.files.asset import check_no_mimics, find_movable_joint, held_positions, read_asset
from freeart21.files.urdf import format_urdf, link_poses, read_urdf, read_urdf_joints, read_urdf_parts, resolve_mimics
from freeart21.files.urdf_files import find_file

SHARED = Path(__file__).resolve().parents[2] / "shared"

URDF = """<?xml version="1.0"?>
<robot name="odd">
  <material name="sea"><color rgba="0 0.5 1 1"/></material>
  <link name="lid">
    <inertial><origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/><mass value="2"/>
      <inertia ixx="1" iyy="2" izz="3" ixy="0.1" ixz="0" iyz="0"/></inertial>
    <visual name="v"><origin xyz="1 2 3" rpy="0.3 -0.4 0.5"/><geometry><box size="1 2 3"/></geometry>
      <material name="sea"/></visual>
    <visual name="v"><geometry><sphere radius="0.5"/></geometry></visual>
    <collision><origin rpy="0 0.7 0"/><geometry><cylinder radius="0.2" length="0.9"/></geometry></collision>
  </link>
  <link name="base"><visual><geometry><capsule radius="0.1" length="0.4"/></geometry></visual></link>
  <link name="tip"/>
  <joint name="slide" type="prismatic"><origin xyz="0 0.2 0" rpy="-1.1 0.2 0.9"/><parent link="lid"/>
    <child link="tip"/><axis xyz="1 2 -2"/><limit lower="-0.1" upper="0.4" effort="7"/></joint>
  <joint name="hinge" type="revolute"><origin xyz="0.5 0 0.1" rpy="0.2 0.3 -2.5"/><parent link="base"/>
    <child link="lid"/><axis xyz="0 3 4"/><limit lower="-1" upper="2"/><dynamics damping="0.3" friction="0.1"/></joint>
</robot>
"""


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    """A URDF with turned frames, its links not in the order of its tree."""
    path = tmp_path / "odd.urdf"
    path.write_text(URDF)
    return path


def _agrees(path: Path, shapes: int) -> None:
    """All poses of links and of visual shapes as yourdfpy has them, joints somewhere within their limits."""
    yourdfpy = pytest.importorskip("yourdfpy")
    theirs = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    ours, rng = read_urdf(path), np.random.default_rng(1)
    assert set(ours.links) == set(theirs.link_map) and set(ours.joints) == set(theirs.joint_map)
    compared = 0
    for _ in range(3):
        q = {
            j.name: float(rng.uniform(max(j.lower, -3), min(j.upper, 3))) for j in ours.joints.values() if j.joint_type
        }
        theirs.update_cfg(q)
        for name, T in ours.link_poses(q).items():
            np.testing.assert_allclose(T, theirs.get_transform(name, ours.root), atol=1e-9, err_msg=name)
    for name, link in ours.links.items():
        for mine, other in zip(link.visuals, theirs.link_map[name].visuals, strict=True):
            origin = np.eye(4) if other.origin is None else other.origin
            np.testing.assert_allclose(mine.T_link_shape, origin, atol=1e-9)
            if other.geometry.mesh is not None:
                assert mine.filename == other.geometry.mesh.filename
            compared += 1
    for joint in ours.joints.values():
        if joint.joint_type:
            np.testing.assert_allclose(joint.axis, theirs.joint_map[joint.name].axis, atol=1e-9)
    assert compared >= shapes


def test_links_and_shapes_stand_where_yourdfpy_puts_them(odd: Path) -> None:
    """yourdfpy knows no capsule, and takes an axis as it is."""
    text = URDF.replace('<axis xyz="1 2 -2"/>', '<axis xyz="0.6 0 -0.8"/>').replace("0 3 4", "0 0.6 0.8")
    odd.write_text(text.replace("capsule", "cylinder"))
    _agrees(odd, 2)


def test_an_exported_asset_is_read_as_yourdfpy_reads_it(tmp_path: Path) -> None:
    _agrees(export_result(reconstruction(), tmp_path / "a").urdf, 2)


@pytest.mark.parametrize(
    "place",
    [*(f"partnet_mobility/{n}/mobility.urdf" for n in (45940, 101450, 40147)), "urdf_objects/mixer/mixer.urdf"],
)
def test_real_objects_are_read_as_yourdfpy_reads_them(place: str) -> None:
    if not (SHARED / place).is_file():
        pytest.skip("outside data are not here")
    _agrees(SHARED / place, 2)


def test_every_number_of_a_urdf_is_read_and_written_again(odd: Path) -> None:
    odd.with_name("again.urdf").write_bytes(format_urdf(read_urdf(odd), "of a test"))
    for read in (read_urdf(odd), read_urdf(odd.with_name("again.urdf"))):
        assert list(read.links) == ["lid", "base", "tip"] and read.parents_first == ("base", "lid", "tip")
        assert read.root == "base" and read.name == "odd"
        hinge, slide = read.joints["hinge"], read.joints["slide"]
        assert (hinge.lower, hinge.upper, hinge.damping, hinge.friction) == (-1, 2, 0.3, 0.1)
        assert (hinge.effort, hinge.velocity, slide.effort) == (None, None, 7)
        np.testing.assert_allclose(hinge.axis, [0, 0.6, 0.8])
        lid = read.links["lid"]
        assert lid.inertial.mass == 2
        np.testing.assert_allclose(lid.inertial.centre, [0.1, 0, 0])
        np.testing.assert_allclose(lid.inertial.inertia, [[2, -0.1, 0], [-0.1, 1, 0], [0, 0, 3]], atol=1e-12)
        box, sphere = lid.visuals
        assert (box.kind, box.name, box.size.tolist(), box.rgba.tolist()) == ("box", "v", [1, 2, 3], [0, 0.5, 1, 1])
        assert sphere.size.tolist() == [0.5] and sphere.rgba is None
        assert lid.collisions[0].size.tolist() == [0.2, 0.9] and read.links["base"].visuals[0].kind == "capsule"
        np.testing.assert_allclose(box.T_link_shape, read_urdf(odd).links["lid"].visuals[0].T_link_shape, atol=1e-15)
        for name, T in read.link_poses({"hinge": 0.4}).items():
            np.testing.assert_allclose(T, read_urdf(odd).link_poses({"hinge": 0.4})[name], atol=1e-15)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_frames_in_gimbal_lock_are_written(odd: Path, pitch: float) -> None:
    odd.write_text(URDF.replace("0.2 0.3 -2.5", f"0.2 {pitch!r} -2.5"))
    read = read_urdf(odd)
    odd.write_bytes(format_urdf(read))
    T = read_urdf(odd).joints["hinge"].T_parent_joint
    np.testing.assert_allclose(T, read.joints["hinge"].T_parent_joint, atol=1e-9)


FAULTS = {
    "is not XML": ("</robot>", ""),
    "link 'tip' 2 times": ('<link name="tip"/>', '<link name="tip"/><link name="tip"/>'),
    "joint 'hinge' has axis '0 x 4', expected 3 finite numbers": ("0 3 4", "0 x 4"),
    r"joint 'hinge' has axis \[0.0, 0.0, 0.0\], expected a direction": ("0 3 4", "0 0 0"),
    "link 'lid': a visual has size '1 2', expected 3": ('1 2 3"/></geom', '1 2"/></geom'),
    "joint 'slide' names link 'lip'; links: lid, base, tip": ('<child link="tip"/>', '<child link="lip"/>'),
    "its joints form a loop at link 'lid'": ('<parent link="base"/>', '<parent link="tip"/>'),
    "link 'tip' is the child of both joints": (
        "</robot>",
        '<joint name="again" type="fixed"><parent link="base"/><child link="tip"/></joint></robot>',
    ),
}


@pytest.mark.parametrize("message", FAULTS)
def test_faults_are_one_line(odd: Path, message: str) -> None:
    odd.write_text(URDF.replace(*FAULTS[message]))
    assert str(odd) in assert_refused(message, read_urdf, odd)


_WORDS = (
    "",
    "x",
    "nan",
    "inf",
    "-1",
    "1e999",
    "1 2",
    "0 0 0",
    "base",
    "tip",
    "fixed",
    "floating",
    "../../a",
    "9" * 400,
)


@MUTATED
@given(st.data())
def test_a_urdf_with_one_fault_is_read_or_refused_in_a_line(odd: Path, data: st.DataObject) -> None:
    pieces = URDF.split('"')
    k = data.draw(st.integers(0, len(pieces) - 1))
    if k % 2:  # an attribute's value
        pieces[k] = data.draw(st.sampled_from(_WORDS))
    text = '"'.join(pieces)
    lines = text.split("\n")
    if not k % 2:
        del lines[data.draw(st.integers(0, len(lines) - 1))]
    odd.write_text("\n".join(lines))
    for read in (read_urdf, read_urdf_parts, read_asset):
        line = reads_or_refuses(read, odd)
        assert not line or str(odd) in line
    with contextlib.suppress(FreeArtError):
        odd.write_bytes(format_urdf(read_urdf(odd)))
        read_urdf(odd)


def test_entities_are_refused_whoever_reads(odd: Path) -> None:
    """A billion laughs, and the same hidden in another encoding: refused where the type is declared."""
    laughs = "".join(f'<!ENTITY l{k + 1} "{f"&l{k};" * 10}">' for k in range(9))
    bomb = f'<!DOCTYPE robot [<!ENTITY l0 "ha">{laughs}]><robot name="&l9;"><link name="base"/></robot>'
    for data in (bomb.encode(), bomb.encode("utf-16")):
        odd.write_bytes(data)
        for read in (read_urdf, read_urdf_parts, read_urdf_joints, read_asset):
            assert_refused("declares a document type 'robot', which is not read", read, odd)


@pytest.mark.parametrize(
    ("urdf", "name", "mesh", "mark"),
    [
        ("pkg/urdf/a.urdf", "package://pkg/meshes/m.stl", "pkg/meshes/m.stl", ""),  # by its name
        ("clone/robots/arm/a.urdf", "package://pkg/meshes/m.stl", "clone/meshes/m.stl", "clone/package.xml"),
        ("models/can/can.sdf.urdf", "model://can/meshes/m.stl", "models/can/meshes/m.stl", ""),
        ("ws/one/urdf/a.urdf", "package://two/m.stl", "ws/two/m.stl", "ws/package.xml"),
        ("x/urdf/a.urdf", "../meshes/m.stl", "x/meshes/m.stl", ""),  # urdf/ beside meshes/
        ("x/a.urdf", "meshes/a%20part.stl", "x/meshes/a part.stl", ""),
        ("x/a.urdf", "meshes/a%20part.stl", "x/meshes/a%20part.stl", ""),  # the name itself is looked for first
        ("x/a.urdf", "meshes\\M.STL", "x/meshes/M.STL", ""),
        ("x/a.urdf", "file://{}/x/meshes/m.stl", "x/meshes/m.stl", ""),
        ("x/a.urdf", "file://localhost{}/x/meshes/m.stl", "x/meshes/m.stl", ""),
        ("x/a.urdf", "{}/x/meshes/m.stl", "x/meshes/m.stl", ""),
    ],
)
def test_layouts_of_packages_are_understood(tmp_path: Path, urdf: str, name: str, mesh: str, mark: str) -> None:
    for file in (urdf, mesh, mark or urdf):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).touch()
    assert find_file(tmp_path / urdf, name.format(tmp_path)) == (tmp_path / mesh).resolve()
    (tmp_path / mesh).unlink()
    with pytest.raises(FreeArtError, match=r"which does not exist: looked for .* in .*; --root DIR") as caught:
        find_file(tmp_path / urdf, name.format(tmp_path))
    assert "\n" not in str(caught.value)


def test_a_root_that_is_given_bounds_what_is_read(tmp_path: Path) -> None:
    for file in ("src/one/urdf/a.urdf", "src/two/meshes/m.stl", "secret.stl"):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).touch()
    urdf, mesh = tmp_path / "src/one/urdf/a.urdf", tmp_path / "src/two/meshes/m.stl"
    for name in ("package://two/meshes/m.stl", "../../two/meshes/m.stl", str(mesh)):
        assert find_file(urdf, name, tmp_path / "src") == mesh.resolve()
        assert_refused(r"leads out of the folder|--root DIR", find_file, urdf, name)
    (tmp_path / "src/link.stl").symlink_to(tmp_path / "secret.stl")
    for name in ("../../link.stl", "../../../secret.stl"):
        with pytest.raises(FreeArtError, match=r"leads out of the folder .*; --root DIR names a larger one"):
            find_file(urdf, name, tmp_path / "src")
    assert_refused(r"the root .*/gone is not a folder", find_file, urdf, str(mesh), tmp_path / "gone")
    with pytest.raises(FreeArtError, match=r"expected a path, or an address of package://, model:// or file://"):
        find_file(urdf, "https://example.org/m.stl")


def test_nobodys_home_is_a_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A URDF from a stranger that lies there cannot name what else is there."""
    monkeypatch.setenv("HOME", str(tmp_path / "me"))
    (tmp_path / "me/got").mkdir(parents=True)
    (tmp_path / "me/private.stl").touch()
    for name in ("package://me/private.stl", "package://me/../private.stl"):
        assert_refused(r"--root DIR", find_file, tmp_path / "me/got/a.urdf", name)


def _mimics(text: str, mimics: str) -> str:
    """A hinge a, and joints that follow, by <mimic> elements of b and c."""
    joint = '<joint name="{0}" type="revolute"><parent link="base"/><child link="{0}"/><limit {2}/>{1}</joint>'.format
    b, c = mimics.split("|")
    links = "".join(f'<link name="{name}"/>' for name in ("base", "a", "b", "c"))
    return f'<robot name="x">{links}{joint("a", "", text)}{joint("b", b, text)}{joint("c", c, text)}</robot>'


def test_followers_stand_where_their_leader_puts_them(odd: Path) -> None:
    follows = '<mimic joint="{}" multiplier="{}" offset="{}"/>'.format
    odd.write_text(_mimics('lower="0.5" upper="2"', f"{follows('a', -2, 0.25)}|{follows('b', 0.5, 1)}"))
    joints = read_urdf_joints(odd)
    assert resolve_mimics(joints, {"a": 0.75}) == {"a": 0.75, "b": -1.25, "c": 0.375}
    assert held_positions(joints, "a") == {"b": 0.25, "c": 1.125}, "at the scored joint's zero"
    assert find_movable_joint(odd).name == "a", "the only one that moves by itself"
    assert_refused(r"joint 'b' follows 'a' \(mimic\), expected one that does not", find_movable_joint, odd, "b")
    assert_refused(r"'b' follows 'a' \(mimic\), but gap moves one part alone", check_no_mimics, odd, "a", "gap")
    held = freeze_mimics(build_tree(read_urdf(odd)))
    assert [j.name for j in held.movable] == ["a"]
    np.testing.assert_allclose(held.link_poses({})["c"], link_poses(joints, {"c": 0.5 * (-2 * 0.5 + 0.25) + 1})["c"])
    for second, message in (("c", "mimics itself by way of 'c'"), ("d", "mimics 'd', which is no joint")):
        odd.write_text(_mimics("", f"{follows(second, 1, 0)}|{follows('b', 1, 0)}"))
        assert_refused(message, resolve_mimics, read_urdf_joints(odd), {})


@pytest.mark.parametrize("end", ["1e30", "1e16", "1001", "inf", "Infinity"])
def test_limits_that_nothing_reaches_are_none(odd: Path, end: str) -> None:
    odd.write_text(_mimics(f'lower="-{end}" upper="{end}" effort="inf"', "|"))
    joint = read_urdf_joints(odd)["a"]
    assert (joint.lower, joint.upper, joint.effort) == (-np.inf, np.inf, None)
    odd.write_text(_mimics(f'lower="0" upper="{end}"', "|"))
    assert (read_urdf_joints(odd)["a"].lower, read_urdf_joints(odd)["a"].upper) == (0, np.inf)
    odd.write_text(_mimics('lower="nan" upper="1"', "|"))
    assert_refused("has lower 'nan', expected a finite number", read_urdf_joints, odd)


@pytest.mark.parametrize(
    "text",
    [
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="x.xacro"/></robot>',
        '<robot><xacro:property name="a" value="1"/></robot>',  # the prefix is not declared
        '<robot><link name="${prefix}base"/></robot>',
        '<robot><link name="a"><visual><geometry><mesh filename="$(find p)/a.stl"/></geometry></visual></link></robot>',
    ],
)
def test_xacro_is_said_to_be_xacro(odd: Path, text: str) -> None:
    odd.write_text(text)
    for read in (read_urdf, read_urdf_parts, read_urdf_joints, read_asset):
        assert_refused(r"is a xacro file, .*: expand it first, `xacro odd.urdf > expanded", read, odd)
    odd.write_text('<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a"/></robot>')
    assert list(read_urdf(odd).links) == ["a"]  # what xacro writes keeps its name space
