"""One loader for PartNet-Mobility folders, ours and real: every habit they show, and one clear line for a fault.

The quirks are those of the data set as people met it (SAPIEN's issues, r-pad's lists, the files themselves), shown by
the real objects, else by a small folder typed here.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mutations import MUTATED, reads_or_refuses

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.doctor import require_rendering
from freeart21.errors import FreeArtError
from freeart21.files.urdf import link_poses, read_urdf_joints
from generator import objects, partnet
from generator.motion import motion_range
from generator.partnet_writer import R_ROOT_MESH, write_partnet
from generator.rays import Caster
from generator.scene import _T_SAPIEN_CAMERA, Scene
from generator.shapes import triangles
from generator.truth_mesh import coincident_faces, outer_faces, visible_faces
from generator.urdf_object import LoadedObject

NAMES = ("stapler", "flip_lighter", "drawer_unit")
"""Three parts; many textures; sliders."""
REAL = Path(__file__).resolve().parents[2] / "shared" / "partnet_mobility"
real_objects = pytest.mark.skipif(not (REAL / "41083").is_dir(), reason="the real objects are not on this machine")


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    place = tmp_path_factory.mktemp("partnet")
    return {name: write_partnet(objects.build(name, 0), place / name) for name in NAMES}


@pytest.fixture
def stapler(folders: dict[str, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(folders["stapler"], tmp_path / "stapler"))


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


# --- objects typed here -----------------------------------------------------------------------------------------------

_CORNERS = [(x, y, z) for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]
_QUADS = ["1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6"]  # counter-clockwise seen from outside
_RED = "newmtl red\nKd 0.8 0.2 0.1\n"
_RED_SRGB = [231, 124, 89]  # of the linear Kd, by IEC 61966-2-1


def _cube(head: str = "mtllib a.mtl\n", at: tuple = (0, 0, 0), flip: bool = False, size: float = 1.0) -> str:
    """A cube as OBJ text: twelve triangles."""
    lines = ["v " + " ".join(str(size * c + o) for c, o in zip(v, at, strict=True)) for v in _CORNERS]
    lines += ["vt 0 0", "usemtl red"]
    for a, b, c, d in (quad.split() for quad in _QUADS):
        for corners in ((a, b, c), (a, c, d)):
            lines.append("f " + " ".join(f"{v}/1" for v in (reversed(corners) if flip else corners)))
    return head + "\n".join(lines) + "\n"


def _link(name: str, *meshes: str, scale: str = "", origin: str = "0 0 0", rpy: str = "0 0 0") -> str:
    where = f'<origin xyz="{origin}" rpy="{rpy}"/>'
    shapes = "".join(
        f'<visual name="part-1">{where}<geometry><mesh filename="{m}"{scale}/></geometry></visual>' for m in meshes
    )
    return f'<link name="{name}">{shapes}</link>'


def _joint(
    name: str,
    kind: str,
    child: str,
    parent: str,
    limit: str = "",
    axis: str = "0 1 0",
    origin: str = '<origin xyz="0 0 0"/>',
) -> str:
    limit = limit and '<limit lower="{}" upper="{}"/>'.format(*limit.split())
    return (
        f'<joint name="{name}" type="{kind}">{origin}<axis xyz="{axis}"/><child link="{child}"/>'
        f'<parent link="{parent}"/>{limit}</joint>'
    )


_ROOT = _joint("joint_9", "fixed", "link_9", "base", origin='<origin rpy="1.570796 0 -1.570796" xyz="0 0 0"/>')
_BODY = _link("link_9", "textured_objs/a.obj")
_LID = _link("link_0", "textured_objs/b.obj")
_SLIDE = _joint("joint_0", "prismatic", "link_0", "link_9", "0 0.5")


def _typed(place: Path, urdf: str = _LID + _SLIDE + _BODY, **files: str | bytes | None) -> Path:
    """A folder of a red cube (the body) and one above it (the lid), with `files` ('a.mtl', ...) changed or left out."""
    folder = place / "toy"
    contents: dict[str, str | bytes | None] = {"a.obj": _cube(), "b.obj": _cube(at=(0, 1.5, 0)), "a.mtl": _RED}
    contents |= {name.replace("__", "."): text for name, text in files.items()}
    (folder / "textured_objs").mkdir(parents=True)
    for name, text in contents.items():
        if text is not None:
            data = text.encode() if isinstance(text, str) else text
            (folder / "textured_objs" / name).write_bytes(data)
    (folder / "mobility.urdf").write_text(f'<robot name="toy"><link name="base"/>{urdf}{_ROOT}</robot>')
    return folder


def _fails(folder: Path, message: str, joint: str | None = None) -> None:
    with pytest.raises(FreeArtError, match=message) as caught:
        partnet.load(folder, joint)
    assert "\n" not in str(caught.value)


_CAMERA = Camera.from_fov(160, 120, 0.8)
_T_CAMERA = se3.pose(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), [0, 0.6, 6.0]) @ se3.exp_se3(
    [0, 0, 0, 0.5, 0.4, 0.6]
)


def _scene(loaded: LoadedObject) -> Scene:
    require_rendering()
    return Scene(loaded.asset.urdf, [s.links for s in loaded.sides], _CAMERA, 0.1, 20, "trivial")


def _engine_poses(scene: Scene) -> dict[str, np.ndarray]:
    """Link name to its pose (4, 4) in the camera's frame, from SAPIEN."""
    poses = {link.name: link.entity_pose for link in scene._object.links}
    return {name: se3.inverse(_T_SAPIEN_CAMERA) @ se3.pose_from_wxyz(pose.p, pose.q) for name, pose in poses.items()}


def _poses_agree(loaded: LoadedObject, seed: int) -> None:
    """SAPIEN and our reader give every link the same pose, at random states within the limits."""
    scene, rng = _scene(loaded), np.random.default_rng(seed)
    joints = read_urdf_joints(loaded.asset.urdf)
    for _ in range(4):
        q = {j.name: float(rng.uniform(max(j.lower, -3), min(j.upper, 3))) for j in joints.values() if j.joint_type}
        scene.render(_T_CAMERA, q)
        theirs, ours = _engine_poses(scene), link_poses(joints, q)
        assert set(theirs) == set(ours)
        for link, T in ours.items():
            assert np.allclose(theirs[link], _T_CAMERA @ T, atol=3e-6), link


def _depths_agree(loaded: LoadedObject, q: float) -> None:
    """SAPIEN's depth and part of every pixel are what rays against our surfaces and joint meet, but for edges."""
    picture = _scene(loaded).render(_T_CAMERA, {**loaded.asset.held, loaded.joint.name: q})
    meshes = loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()
    hits = Caster(meshes).look(_CAMERA, (_T_CAMERA, _T_CAMERA @ loaded.joint.transform(q)))
    depth = np.where(hits.side >= 0, hits.distance, 0).reshape(picture.depth.shape)
    side = (hits.side + 1).reshape(picture.side.shape)
    assert all((side == k).sum() > 40 for k in (1, 2)), np.bincount(side.ravel())
    same = side == picture.side
    assert same.mean() > 0.995 and np.quantile(np.abs(depth - picture.depth)[same], 0.99) < 1e-3


# --- the fourteen quirks ----------------------------------------------------------------------------------------------


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
def test_axis_and_limits_are_the_urdfs(name: str, joint: str, kind: str, axis: tuple, upper: float) -> None:
    loaded = partnet.load(REAL / name, joint)
    assert loaded.joint.type == kind and np.allclose(loaded.joint.axis, axis, atol=1e-12)
    assert loaded.joint.lower == 0 and not np.signbit(loaded.joint.lower) and loaded.joint.upper == pytest.approx(upper)
    bounds = json.loads((REAL / name / "bounding_box.json").read_text())
    points = np.concatenate([side.surface.vertices for side in loaded.sides]) @ R_ROOT_MESH
    assert np.allclose(points.min(0), bounds["min"], atol=1e-5) and np.allclose(points.max(0), bounds["max"], atol=1e-5)
    assert loaded.child_side.links == (joint.replace("joint", "link"),)
    assert loaded.category == "StorageFurniture" and not loaded.notes
    assert (
        loaded.semantics[loaded.child_side.links[0]]
        == {"revolute": "hinge rotation_door", "prismatic": "slider drawer"}[kind]
    )
    colours = loaded.child_side.surface.mesh().colours
    assert colours is not None and colours.std() > 0


_CAP = (
    _link("link_0_helper")
    + _joint("joint_0_helper", "prismatic", "link_0_helper", "link_9", "-0.108 -0.008")
    + _link("link_0", "textured_objs/b.obj")
    + _joint("joint_0", "continuous", "link_0", "link_0_helper")
)
"""A bottle's cap that slides and turns ('slider+'), as in the object 3763."""


def test_a_cap_that_slides_and_turns_is_two_joints_each_within_its_limits(tmp_path: Path) -> None:
    folder = _typed(tmp_path, _CAP + _BODY)
    slides = partnet.load(folder, "joint_0_helper")
    assert slides.child_side.links == ("link_0_helper", "link_0") and slides.asset.held == {"joint_0": 0.0}
    assert motion_range(slides.joint) == (-0.108, -0.008)
    assert slides.notes == ("joint 'joint_0_helper' never stands at 0: its limits are [-0.108, -0.008]",)
    turns = partnet.load(folder, "joint_0")
    assert turns.parent_side.links == ("base", "link_0_helper", "link_9")
    assert turns.asset.held == {"joint_0_helper": -0.008}
    assert turns.child_side.surface.vertices[:, 2].max() == pytest.approx(2.0 - 0.008)  # posed as it is held
    assert turns.joint.type == "revolute" and (turns.joint.lower, turns.joint.upper) == (-np.inf, np.inf)
    low, high = motion_range(turns.joint)
    assert high - low == pytest.approx(2 * np.pi)
    assert turns.notes == (
        f"joint 'joint_0' has no limits: it is moved from {low:.4g} to {high:.4g} rad",
        "joint 'joint_0_helper' cannot stand at 0 and is held at -0.008",
    )
    _poses_agree(turns, 8)
    _depths_agree(slides, -0.1)


@pytest.mark.parametrize(
    ("mtl", "note", "colour"),
    [
        (
            _RED + "map_Kd ../images/texture_0.jpg\n",
            "absent pictures leave the plain colour: ../images/texture_0.jpg",
            _RED_SRGB,
        ),
        (_RED + "map_Kd ..\\images\\texture_0.jpg\nmap_bump x.png\n", "absent pictures", _RED_SRGB),
        (None, "absent material libraries leave plain grey: a.mtl", [203, 203, 203]),
    ],
)
def test_what_has_no_picture_is_drawn_plain(mtl: str | None, note: str, colour: list[int], tmp_path: Path) -> None:
    loaded = partnet.load(_typed(tmp_path, a__mtl=mtl))
    assert len(loaded.notes) == 1 and loaded.notes[0].startswith(note)
    assert (loaded.child_side.surface.mesh().colours == colour).all()
    picture = _scene(loaded).render(_T_CAMERA, {})
    assert np.abs(picture.rgb[picture.side > 0].astype(int) - colour).max() <= 1  # as SAPIEN shows it


def test_an_absent_mesh_is_refused_or_left_out_on_request(tmp_path: Path) -> None:
    lid = _link("link_0", "textured_objs/b.obj", "textured_objs/gone.obj")
    folder = _typed(tmp_path, lid + _SLIDE + _BODY)
    _fails(folder, r"names the mesh 'textured_objs/gone.obj', which does not exist: .*; --skip-missing leaves")
    loaded = partnet.load(folder, skip_missing=True)
    assert loaded.notes == ("absent meshes are left out: textured_objs/gone.obj",)
    _depths_agree(loaded, 0.2)


def test_faces_drawn_twice_are_judged_as_one_and_inner_faces_apart(tmp_path: Path) -> None:
    names = [f"textured_objs/{n}.obj" for n in ("a", "back", "inner")]
    twice = _typed(
        tmp_path, _LID + _SLIDE + _link("link_9", *names), back__obj=_cube(flip=True), inner__obj=_cube(size=0.6)
    )
    loaded = partnet.load(twice)
    meshes = loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()
    groups = coincident_faces(meshes[0])
    assert (np.sort(np.bincount(groups)) == [1] * 12 + [2] * 12).all()
    outer = outer_faces(meshes, loaded.joint)[0]
    assert outer[:24].all() and not outer[24:].any()
    T = se3.pose(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), [0, 0, 5])  # looks along +x
    visible = visible_faces(meshes, _CAMERA, [(T, T, np.ones((120, 160), bool))])[0]
    assert visible.sum() == 4  # two triangles, each with the one that lies on it
    front = meshes[0].vertices[meshes[0].faces[visible]]
    assert np.allclose(front[..., 0], -0.5) and len(np.unique(groups[visible])) == 2


_CHAIN = (
    _link("link_0", "textured_objs/a.obj", scale=' scale="0.4 0.9 -0.6"', origin="0 0.5 0.1", rpy="0.3 -0.2 0.5")
    + _joint(
        "joint_0",
        "revolute",
        "link_0",
        "link_9",
        "-0.7 1.2",
        "0.6 0 0.8",
        '<origin xyz="0.2 0.6 0.3" rpy="0.2 0.4 -1"/>',
    )
    + _link("link_1", "textured_objs/a.obj", scale=' scale="0.3 0.3 0.3"')
    + _joint(
        "joint_1", "prismatic", "link_1", "link_0", "-0.2 0.4", "-3 0 4", '<origin xyz="0.1 0.9 0" rpy="-0.5 0 2"/>'
    )
    + _link("link_2", "textured_objs/a.obj", scale=' scale="-0.2 0.5 0.2"', origin="0 0.3 0")
    + _joint("joint_2", "continuous", "link_2", "link_1", "", "0 -1 0", '<origin xyz="0 0.2 0.2" rpy="0 1 0"/>')
)


def test_sapien_reads_a_chain_of_turned_and_scaled_links_as_we_do(tmp_path: Path) -> None:
    folder = _typed(tmp_path, _CHAIN + _BODY)
    _poses_agree(partnet.load(folder, "joint_2"), 0)
    for joint, q in (("joint_0", 0.9), ("joint_1", 0.3), ("joint_2", 2.0)):
        loaded = partnet.load(folder, joint)
        _depths_agree(loaded, q)
        corners = [side.surface.vertices[side.surface.faces] for side in loaded.sides]
        assert all(
            np.einsum("fc,fc->", c[:, 0], np.cross(c[:, 1], c[:, 2])) > 0 for c in corners
        )  # outwards, mirrored too


# --- faults -----------------------------------------------------------------------------------------------------------


def test_the_choice_of_joints_is_listed_with_type_range_and_part(tmp_path: Path) -> None:
    folder = _typed(tmp_path, _CHAIN + _BODY)
    (folder / "semantics.txt").write_text("link_0 hinge door\nlink_1 slider drawer\n")
    listed = (
        r"movable joints: joint_0 \(revolute -40.1..68.8 deg, hinge door\), "
        r"joint_1 \(prismatic -0.2..0.4 m, slider drawer\), joint_2 \(continuous without limits\)$"
    )
    _fails(folder, "no joint was named; " + listed)
    _fails(folder, "no movable joint 'joint_9'; " + listed, "joint_9")


FAULTS = {
    r"'joint_0' cannot move: its limits are \[0, 0\]": ("0.5", "0.0"),
    "joint 'joint_0' is prismatic and has no <limit>": ('<limit lower="0" upper="0.5"/>', ""),
    "'../../etc/b.obj', which leads out of the folder": ("textured_objs/b.obj", "../../etc/b.obj"),
    "b.obj is not a readable OBJ file: a face names a vertex before the first": ("f 1/1", "f 0/1"),
    "b.obj names the material library '/etc/passwd', expected a path inside": ("mtllib a.mtl", "mtllib /etc/passwd"),
    "a.mtl: Kd is '0.8 nan 0.1', expected numbers": ("Kd 0.8 0.2", "Kd 0.8 nan"),
    "names the picture '.*x.png', which leads out of the folder": ("Kd 0.8", "map_Kd ../../x.png\nKd 0.8"),
}


@pytest.mark.parametrize("message", FAULTS)
def test_faults_are_one_line(message: str, tmp_path: Path) -> None:
    folder = _typed(tmp_path)
    old, new = FAULTS[message]
    changed = 0
    for name in ("mobility.urdf", "textured_objs/b.obj", "textured_objs/a.mtl"):
        text = (folder / name).read_text()
        changed += old in text
        (folder / name).write_text(text.replace(old, new))
    assert changed
    _fails(folder, message)


@MUTATED
@given(st.data())
def test_an_obj_or_mtl_with_one_fault_is_read_or_refused_in_a_line(tmp_path: Path, data: st.DataObject) -> None:
    folder = _typed(tmp_path / str(len(list(tmp_path.iterdir()))))
    file = folder / "textured_objs" / data.draw(st.sampled_from(["b.obj", "a.mtl"]))
    lines = [line.split(" ") for line in file.read_text().split("\n")]
    words = data.draw(st.sampled_from([line for line in lines if line[0]]))
    k = data.draw(st.integers(0, len(words) - 1))
    words[k] = data.draw(
        st.sampled_from(["", "x", "nan", "1e30", "0", "99", "-1", "-99", "1/", "1//1", "../../a", "v"])
    )
    file.write_text("\n".join(map(" ".join, lines)))
    reads_or_refuses(partnet.load, folder)


def test_a_folder_without_urdf_and_one_that_is_no_robot_are_refused(tmp_path: Path) -> None:
    _fails(tmp_path, "is not a PartNet-Mobility object: it has no mobility.urdf")
    folder = _typed(tmp_path)
    with (folder / "textured_objs/b.obj").open("ab") as file:
        file.truncate(1 << 29)  # a hole: no disk is filled
    _fails(folder, f"textured_objs/b.obj has {1 << 29} bytes, at most")
    (folder / "mobility.urdf").write_text("<sdf/>")
    _fails(folder, "is not a URDF: its root is <sdf>, expected <robot>")
    (folder / "mobility.urdf").write_bytes(
        '<?xml version="1.0" encoding="latin-1"?><robot name="ö"/>'.encode("latin-1")
    )
    _fails(folder, "is not UTF-8 text")
    (folder / "meta.json").write_text('{"scored_joint": 3}')
    _fails(folder, "scored_joint is 3, expected a joint's name")


def test_links_out_of_the_folder_and_in_circles_are_refused(tmp_path: Path) -> None:
    folder = _typed(tmp_path, b__obj=None)
    (tmp_path / "secret.obj").write_text(_cube())
    lid = folder / "textured_objs" / "b.obj"
    lid.symlink_to(tmp_path / "secret.obj")
    _fails(folder, "the file 'textured_objs/b.obj', which leads out of the folder")
    lid.unlink()
    lid.symlink_to("b.obj")
    _fails(folder, "cannot be looked up: ")
    lid.unlink()
    lid.symlink_to(lid.parent / "a.obj")
    assert len(partnet.load(folder).child_side.surface.faces) == 12  # within the folder they are files like others


# --- what OBJ and MTL files may look like -----------------------------------------------------------------------------


def _back(text: str) -> str:
    """The same OBJ text with indices that count back."""
    return re.sub(r"(\d+)/1", lambda m: f"{int(m[1]) - 9}/-1", text)


_PENTAGON = (
    "mtllib a.mtl\nusemtl red\nv 0 2 0\nv 1 2 0\nv 1.5 3 0\nv 0.5 3.5 0\nv -0.5 3 0\nf 1 2 3 4 5\nv 9 9 9\nf 1 2 3\n"
)


@pytest.mark.parametrize(
    ("obj", "mtl", "faces"),
    [
        (_back(_cube(at=(0, 1.5, 0))), _RED, 12),
        (_PENTAGON, _RED, 4),
        ("v 5 5 5\n" + _PENTAGON.replace("f 1 2 3 4 5", "f -5 -4 -3 -2 -1").replace("f 1 2 3", "f 2 3 4"), _RED, 4),
        (_cube(at=(0, 1.5, 0)).replace("\n", "\r\n"), _RED.replace("\n", "\r\n"), 12),
        ("\ufeff" + _cube(at=(0, 1.5, 0)), "\ufeff" + _RED, 12),
        (_cube("mtllib my file.mtl\n", at=(0, 1.5, 0)).replace("usemtl red", "usemtl deep red"), _RED, 12),
        (_cube(at=(0, 1.5, 0)) + "l 1 2\np 3\n# mtllib no.mtl\n", _RED + "d 1.0\nTr 0\n", 12),
    ],
    ids=["counting back", "polygon", "counting back between", "crlf", "byte order mark", "spaces", "lines and points"],
)
def test_meshes_are_read_as_sapien_reads_them(obj: str, mtl: str, faces: int, tmp_path: Path) -> None:
    files = {"b__obj": obj, "a__mtl": mtl, "my file__mtl": mtl.replace("red", "deep red")}
    loaded = partnet.load(_typed(tmp_path, **files))  # type: ignore[arg-type]
    assert len(loaded.child_side.surface.faces) == faces and not loaded.notes
    assert (loaded.child_side.surface.mesh().colours == _RED_SRGB).all()
    _depths_agree(loaded, 0.4)
    picture = _scene(loaded).render(_T_CAMERA, {})
    assert np.abs(picture.rgb[picture.side == 2].astype(int) - _RED_SRGB).max() <= 1
