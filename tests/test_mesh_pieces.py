"""Mesh files that URDFs name: the same box from each kind, and what they mean by their units and colours."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from refusal import assert_refused

from export.check.engines.plain_urdf import write_plain_urdf
from export.checklist import read_solid
from freeart21.errors import FreeArtError
from freeart21.view.link_shapes import read_shown
from freeart21.view.mesh_pieces import ENDINGS, read_pieces
from generator.urdf_object import load_urdf

SIZE = (0.1, 0.2, 0.04)
URDF = """<robot name="x">
<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
 <visual><geometry>{base}</geometry></visual><collision><geometry>{base}</geometry></collision></link>
<link name="lid"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
 <visual><geometry>{lid}</geometry></visual><collision><geometry>{lid}</geometry></collision></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="lid"/><origin xyz="0 0.1 0.02"/>
<axis xyz="1 0 0"/><limit lower="0" upper="1.5" effort="1" velocity="1"/></joint></robot>"""


def _box() -> trimesh.Trimesh:
    return trimesh.creation.box(SIZE)


def _write(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    kind = path.suffix[1:].lower()
    if kind == "gltf":
        for name, data in trimesh.Scene(_box()).export(file_type="gltf").items():
            (path if name == "model.gltf" else path.parent / name).write_bytes(data)
    else:
        data = _box().export(file_type=kind)
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


@pytest.mark.parametrize("ending", [*ENDINGS, *(ending.upper() for ending in ENDINGS)])
def test_every_kind_is_read_the_same_by_record_and_check_asset_and_view(ending: str, tmp_path: Path) -> None:
    _write(tmp_path / f"x/meshes/a part{ending}")
    (tmp_path / "x/urdf").mkdir()
    urdf = tmp_path / "x/urdf/x.urdf"
    mesh = f'<mesh filename="package://x/meshes/a%20part{ending}" scale="1 1 -2"/>'
    urdf.write_text(URDF.format(base=mesh, lid=mesh))
    wide = np.array(SIZE) * [1, 1, 2]
    recorded = load_urdf(urdf).child_side.surface.mesh()
    np.testing.assert_allclose(np.ptp(recorded.vertices, axis=0), wide, atol=1e-6)
    shown = read_shown(urdf)
    for pieces in (shown.visuals["lid"], shown.collisions["lid"]):
        seen = np.concatenate([piece.mesh.vertices for piece in pieces])
        np.testing.assert_allclose(np.ptp(seen, axis=0), wide, atol=1e-6)
    solid = read_solid(tmp_path / f"x/meshes/a part{ending}")
    assert solid.is_watertight and solid.volume == pytest.approx(np.prod(SIZE), rel=1e-5)
    given = write_plain_urdf(urdf, tmp_path / "x").read_text()
    assert given.count(".obj" if ending.lower() not in (".obj", ".stl") else ending) == 2


def test_collada_is_in_its_unit_and_stands_as_written(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.dae")
    text = re.sub("<unit[^>]*/>|<up_axis>.*</up_axis>", "", path.read_text())

    def write_unit(unit: str, axis: str = "") -> None:
        path.write_text(text.replace("</asset>", f"{unit}{axis}</asset>"))

    for axis in ("X_UP", "Y_UP", "Z_UP", ""):
        write_unit('<unit name="inch" meter="0.0254"/>', axis and f"<up_axis>{axis}</up_axis>")
        vertices = np.concatenate([piece.mesh.vertices for piece in read_pieces(path, tmp_path)])
        np.testing.assert_allclose(np.ptp(vertices, axis=0), np.array(SIZE) * 0.0254, atol=1e-7)
        urdf = tmp_path / "x.urdf"
        urdf.write_text(URDF.format(base='<mesh filename="a.dae"/>', lid='<sphere radius="0.001"/>'))
        notes = load_urdf(urdf).notes
        expected = ["COLLADA's <up_axis> is ignored, as in RViz"] if axis in ("X_UP", "Y_UP") else []
        assert [note.split(":")[0] for note in notes] == expected
    for unit, message in (("0", "its unit is 0 m"), ("x", "could not convert"), ("nan", "its unit is nan m")):
        write_unit(f'<unit meter="{unit}"/>')
        assert_refused(message, read_pieces, path, tmp_path)
    path.write_text('<!DOCTYPE a [<!ENTITY e "x">]>' + text[text.index("<COLLADA") :])
    assert_refused("document type", read_pieces, path, tmp_path)


def test_colours_and_pictures_of_glb_are_kept(tmp_path: Path) -> None:
    red = trimesh.visual.material.PBRMaterial(baseColorFactor=[188, 0, 0, 255])
    left, right = _box(), _box().apply_translation([1, 0, 0])
    left.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=red)
    checks = Image.fromarray(np.array([[[0, 0, 255], [0, 255, 0]]], np.uint8))  # blue to the left, green to the right
    uv = np.column_stack([0.25 + 0.5 * (right.vertices[:, 0] > 1), np.full(8, 0.5)])
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=checks)
    right.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    (tmp_path / "a.glb").write_bytes(trimesh.Scene([left, right]).export(file_type="glb"))
    pieces = read_pieces(tmp_path / "a.glb", tmp_path)
    plain, painted = sorted(pieces, key=lambda piece: piece.mesh.vertices[0, 0])
    assert plain.picture is None
    np.testing.assert_array_equal(plain.mesh.colours[0], [223, 0, 0])  # 188/255 of linear light as sRGB
    assert painted.picture is not None
    far = painted.mesh.vertices[:, 0] > 1
    np.testing.assert_array_equal(painted.mesh.colours[far], np.tile([0, 255, 0], (far.sum(), 1)))
    np.testing.assert_array_equal(painted.mesh.colours[~far], np.tile([0, 0, 255], ((~far).sum(), 1)))
    (tmp_path / "x.urdf").write_text(URDF.format(base='<mesh filename="a.glb"/>', lid='<box size="1 1 1"/>'))
    made = load_urdf(tmp_path / "x.urdf").parent_side.surface
    assert any(paint.picture is not None and paint.picture.shape == (1, 2, 3) for paint in made.paints)


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        ('<box size="0.1 0.2 0.3"/>', (0.1, 0.2, 0.3)),
        ('<sphere radius="0.1"/>', (0.2, 0.2, 0.2)),
        ('<cylinder radius="0.1" length="0.5"/>', (0.2, 0.2, 0.5)),
        ('<capsule radius="0.1" length="0.5"/>', (0.2, 0.2, 0.7)),
    ],
)
def test_primitives_are_recorded_and_shown(shape: str, size: tuple[float, ...], tmp_path: Path) -> None:
    (tmp_path / "x.urdf").write_text(URDF.format(base=shape, lid=shape))
    loaded = load_urdf(tmp_path / "x.urdf")
    surface = loaded.parent_side.surface
    np.testing.assert_allclose(np.ptp(surface.vertices, axis=0), size, atol=2e-3)
    solid = trimesh.Trimesh(surface.vertices, surface.faces)
    assert solid.volume > 0 and len(surface.faces) == len(read_shown(tmp_path / "x.urdf").visuals["base"][0].mesh.faces)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ('<mesh filename="a.glb"/>', r"a\.glb is a pipe, expected a file"),
        ('<sphere radius="-1"/>', r"has a sphere of size \[-1\.0\], expected more than zero"),
        ('<box size="1 0 1"/>', r"has a box of size \[1\.0, 0\.0, 1\.0\], expected more than zero"),
        ('<sphere radius="1e300"/>', "has radius '1e300', expected a finite number of at most 1e\\+09"),
    ],
)
def test_what_is_no_shape_is_refused_by_record_and_view(shape: str, message: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.glb")
    (tmp_path / "x.urdf").write_text(URDF.format(base='<box size="1 1 1"/>', lid=shape))
    for read in (read_shown, load_urdf):
        assert_refused(message, read, tmp_path / "x.urdf")


def test_a_mesh_names_files_of_the_root_alone(tmp_path: Path) -> None:
    path = _write(tmp_path / "x/meshes/a.gltf")
    buffer = next(place for place in path.parent.iterdir() if place.suffix == ".bin")
    names = json.loads(path.read_text())
    buffer.rename(tmp_path / "outside.bin")
    for uri, message in (
        ("../../outside.bin", "leads out of"),
        ("gone.bin", "missing"),
        ("/dev/zero", "leads out"),
    ):
        path.write_text(json.dumps(names | {"buffers": [b | {"uri": uri} for b in names["buffers"]]}))
        assert_refused(message, read_pieces, path, tmp_path / "x")


@pytest.mark.parametrize("count, message", [(10**10, "entries without data"), (-3, r"a\.glb is not a readable .glb")])
def test_accessors_without_data_take_no_memory(tmp_path: Path, count: int, message: str) -> None:
    data = bytearray(_write(tmp_path / "a.glb").read_bytes())
    size = int.from_bytes(data[12:16], "little")
    header = json.loads(data[20 : 20 + size])
    for accessor in header["accessors"]:
        if accessor["type"] == "VEC3":
            del accessor["bufferView"]
            accessor["count"] = count
    text = json.dumps(header).encode()
    data[12 : 20 + size] = len(text).to_bytes(4, "little") + data[16:20] + text
    data[8:12] = len(data).to_bytes(4, "little")
    (tmp_path / "a.glb").write_bytes(data)
    assert_refused(message, read_pieces, tmp_path / "a.glb", tmp_path)


@pytest.mark.parametrize("ending", ENDINGS)
def test_what_is_no_mesh_is_reported_in_a_line(ending: str, tmp_path: Path) -> None:
    whole = _write(tmp_path / f"a{ending}").read_bytes()
    for data in (b"", b"\0" * 200, b"{" * 100_000, whole[: len(whole) // 3]):
        (tmp_path / f"b{ending}").write_bytes(data)
        try:
            pieces = read_pieces(tmp_path / f"b{ending}", tmp_path)
            assert (ending in (".obj", ".stl", ".off") and data == whole[: len(whole) // 3]) or not pieces
        except FreeArtError as error:
            assert str(tmp_path / f"b{ending}") in str(error) and "\n" not in str(error)
    assert_refused(r"x.step is no mesh that is read, expected .obj, .dae", read_pieces, tmp_path / "x.step", tmp_path)
