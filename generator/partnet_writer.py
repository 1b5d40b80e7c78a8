"""Writes a procedural object as a PartNet-Mobility folder with the properties of real ones (`generator.partnet`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from freeart21.files import atomic, checked
from freeart21.files.urdf import Urdf, UrdfJoint, UrdfLink, UrdfShape, format_urdf
from freeart21.mesh import triangle_normals
from freeart21.se3 import Array, exp_so3, pose
from generator import textures
from generator.model import SHINE, Finish, ObjectModel, Piece
from generator.shapes import triangles
from generator.surface import crease_normals

R_ROOT_MESH: Array = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Root frame (z up) from PartNet-Mobility's mesh frame (y up): the rotation rpy (pi/2, 0, -pi/2) of its last joint."""
_QUARTER = 1.570796326794897
"""rad, as PartNet-Mobility's files write a quarter turn: the frozen sequences of freeart21-v1 have it."""
_T_ROOT = pose(exp_so3([0, 0, -_QUARTER]) @ exp_so3([_QUARTER, 0, 0]), np.zeros(3))


def write_partnet(model: ObjectModel, folder: Path) -> Path:
    """Write `model` as the new folder `folder`: mobility.urdf, meshes, pictures, semantics.txt and meta.json."""
    with atomic.new_folder(folder) as aside:
        names = _write_meshes(model, aside)
        atomic.write_bytes(aside / "mobility.urdf", _urdf(model, names))
        semantics = "".join(f"link_{k} {link.semantic}\n" for k, link in enumerate(model.links))
        atomic.write_bytes(aside / "semantics.txt", semantics.encode())
        atomic.write_json(
            aside / "meta.json",
            {
                "model_id": f"{model.name}-s{model.seed}",
                "anno_id": f"{model.name}-s{model.seed}",
                "version": "1",
                "model_cat": model.category,
                "scored_joint": f"joint_{model.scored_joint}",
                "link_mass_kg": {f"link_{k}": round(link.mass, 6) for k, link in enumerate(model.links)},
            },
        )
    return folder


def _write_meshes(model: ObjectModel, folder: Path) -> list[list[tuple[str, str]]]:
    """Write textured_objs/ and images/; returns for every link its (visual name, mesh file) pairs."""
    names: list[list[tuple[str, str]]] = []
    part = count = 0
    for link in model.links:
        names.append([])
        for piece in link.pieces:
            part += 1
            for body in piece.solid.decompose():  # several bodies give duplicate visual names, as in real objects
                count += 1
                stem = f"original-{count}"
                atomic.write_bytes(folder / "textured_objs" / f"{stem}.obj", _obj(body, piece, stem))
                lines = material_lines(piece.material.name, piece.material.finish, f"texture_{part}.png")
                atomic.write_bytes(folder / "textured_objs" / f"{stem}.mtl", ("\n".join(lines) + "\n").encode())
                names[-1].append((f"{piece.name}-{part}", f"textured_objs/{stem}.obj"))
            look = piece.material  # plain colours are pictures, too: SAPIEN takes Kd as linear but pictures as sRGB
            picture = textures.plain(look.colour) if look.texture is None else look.texture
            atomic.write_bytes(folder / "images" / f"texture_{part}.png", checked.encode_png(picture))
    return names


def _obj(body: Manifold, piece: Piece, stem: str) -> bytes:
    """OBJ text in the mesh frame, with crease-split normals and box-projected texture coordinates."""
    vertices, faces = triangles(body)
    uv = box_uv(vertices, faces, piece.material.tile_m)
    normals = crease_normals(vertices, faces) @ R_ROOT_MESH
    uv_table, uv_at = np.unique(np.round(uv.reshape(-1, 2), 6), axis=0, return_inverse=True)
    n_table, n_at = np.unique(np.round(normals.reshape(-1, 3), 5), axis=0, return_inverse=True)
    indices = np.stack([faces, uv_at.reshape(-1, 3), n_at.reshape(-1, 3)], -1).reshape(-1, 9) + 1
    lines = [f"mtllib {stem}.mtl", f"o {stem}"]
    lines += ["v " + _row(v, 9) for v in vertices @ R_ROOT_MESH]
    lines += ["vt " + _row(t, 6) for t in uv_table]
    lines += ["vn " + _row(n, 5) for n in n_table]
    lines += [f"usemtl {piece.material.name}"]
    lines += ["f " + " ".join("/".join(map(str, corner)) for corner in row.reshape(3, 3)) for row in indices]
    return ("\n".join(lines) + "\n").encode()


def _row(values: Array, digits: int) -> str:
    return " ".join(f"{v:.{digits}g}" for v in values)


def material_lines(name: str, finish: Finish, picture: str) -> list[str]:
    """Lines of an MTL file: a material whose colours are those of images/`picture`."""
    strength, exponent = SHINE[finish]
    return [
        f"newmtl {name}",
        "illum 2",
        "d 1",
        f"Ns {exponent:g}",
        "Kd 1 1 1",
        f"Ks {strength:g} {strength:g} {strength:g}",
        f"map_Kd ../images/{picture}",
    ]


def box_uv(vertices: Array, faces: NDArray[np.int64], tile_m: float | None) -> Array:
    """Texture coordinates (F, 3, 2) projected along each face's main axis, so that pictures read upright from outside.

    `tile_m` is the length, metres, of one repeat; None fits one picture to the bounding box of the vertices (V, 3).
    """
    corners, normal = vertices[faces], triangle_normals(vertices, faces)
    axis = np.abs(normal).argmax(1)
    positive = np.take_along_axis(normal, axis[:, None], 1)[:, 0] > 0
    across = np.where(axis == 0, 1, 0)  # u runs along y on x faces, along x on y and z faces
    mirrored = np.where(axis == 1, positive, ~positive)
    up = np.where(axis == 2, 1, 2)
    low, high = vertices.min(0), vertices.max(0)
    uv = np.empty((len(faces), 3, 2))
    for k, along in enumerate((across, up)):
        coordinate = np.take_along_axis(corners, along[:, None, None], 2)[..., 0] - low[along][:, None]
        span = np.maximum((high - low)[along][:, None], 1e-9)
        flip = mirrored if k == 0 else np.zeros(len(faces), bool)
        coordinate = np.where(flip[:, None], span - coordinate, coordinate)
        uv[..., k] = coordinate / (span if tile_m is None else tile_m)
    return uv


def _urdf(model: ObjectModel, names: list[list[tuple[str, str]]]) -> bytes:
    """The URDF: no inertia, dynamics or effort, meshes placed by minus the sum of joint origins, root joint last."""
    links = {"base": UrdfLink("base", (), (), None)}
    joints = {}
    for k, link in enumerate(model.links):
        name, hinge, at = f"link_{k}", link.hinge, _origin(model, f"link_{k}")
        shapes = [UrdfShape("mesh", pose(np.eye(3), -at), np.ones(3), mesh, name=own) for own, mesh in names[k]]
        links[name] = UrdfLink(name, tuple(shapes), tuple(replace(shape, name="") for shape in shapes), None)
        joints[f"joint_{k}"] = UrdfJoint(
            f"joint_{k}",
            "fixed" if hinge is None else hinge.type,
            "base" if hinge is None else hinge.parent,
            name,
            _T_ROOT if hinge is None else pose(np.eye(3), at - _origin(model, hinge.parent)),
            np.eye(3)[0] if hinge is None else np.array(hinge.axis, float) @ R_ROOT_MESH,
            -np.inf if hinge is None else hinge.lower,
            np.inf if hinge is None else hinge.upper,
            hinge is not None,
            *(None, None, 0.0, 0.0),
        )
    return format_urdf(Urdf(Path(), f"partnet_{model.name}", links, joints))


def _origin(model: ObjectModel, link: str) -> Array:
    """(3,) where a link's frame stands in the mesh frame: the sum of the joint origins down to it."""
    hinge = model.links[int(link.removeprefix("link_"))].hinge
    return np.zeros(3) if hinge is None else np.array(hinge.pivot, float) @ R_ROOT_MESH
