"""A box with a lid, as URDF, with printed tags on all faces of both parts."""

import cv2
import numpy as np
import trimesh
from PIL import Image

SIDE = 0.044
LINKS = {"base": ((0.20, 0.14, 0.07), (0, 0, 0.035), 0), "lid": ((0.20, 0.14, 0.012), (0.10, 0, 0.006), 25)}
"""Size and middle of the box, m, and the first tag."""


def write_tagged_box(folder):
    """The URDF file; its joint is named hinge and opens to 1.9 rad."""
    text = '<robot name="tagged_box">'
    for name, (size, middle, first) in LINKS.items():
        size, middle = np.array(size), np.array(middle)
        box = trimesh.creation.box(size)
        box.apply_translation(middle)
        box.export(folder / f"{name}.obj")
        text += f'<link name="{name}">{_visual(f"{name}.obj")}'
        for tag, (place, right, up) in enumerate(_places(size), first):
            _write_tag(folder, tag, middle + place, right, up)
            text += _visual(f"tag{tag}.obj")
        text += "</link>"
    text += (
        '<joint name="hinge" type="revolute"><parent link="base"/><child link="lid"/><origin xyz="-0.10 0 0.0701"/>'
        '<axis xyz="0 -1 0"/><limit lower="0" upper="1.9" effort="1" velocity="1"/></joint></robot>'
    )
    (folder / "box.urdf").write_text(text)
    return folder / "box.urdf"


def _visual(file):
    return f'<visual><geometry><mesh filename="{file}"/></geometry></visual>'


def _places(size):
    """Middle, right and up of each tag: three on the large faces, one on each side that is high enough."""
    x, y, z = np.eye(3)
    found = [(s * (size[2] / 2 + 2e-4) * z + dx * x, s * x, y) for s in (1, -1) for dx in (-0.06, 0, 0.06)]
    if size[2] > 1.2 * SIDE:
        found += [(-s * (size[1] / 2 + 2e-4) * y + dx * x, s * x, z) for s in (1, -1) for dx in (-0.05, 0.05)]
        found += [(s * (size[0] / 2 + 2e-4) * x, s * y, z) for s in (1, -1)]
    return found


def _write_tag(folder, tag, middle, right, up):
    """A square with a white rim of one module, as an .obj with its texture."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    picture = np.pad(cv2.aruco.generateImageMarker(dictionary, tag, 6 * 32), 32, constant_values=255)
    half = SIDE / 2 * 8 / 6
    corners = np.array([middle + half * (a * right + b * up) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    visual = trimesh.visual.TextureVisuals(
        uv=np.array([[0, 0], [1, 0], [1, 1], [0, 1]]),
        material=trimesh.visual.material.SimpleMaterial(image=Image.fromarray(picture).convert("RGB")),
    )
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)
    text, files = trimesh.exchange.obj.export_obj(mesh, return_texture=True, mtl_name=f"tag{tag}.mtl")
    for name, data in files.items():
        if name.endswith(".mtl"):
            data = data.replace(b"material_0.png", f"tag{tag}.png".encode())
        (folder / name.replace("material_0.png", f"tag{tag}.png")).write_bytes(data)
    (folder / f"tag{tag}.obj").write_text(text)
