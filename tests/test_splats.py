"""An asset's Gaussians: seen ones stand on its meshes, and what nobody saw has marked ones in its colours."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy
from test_export import BLUE, RED, reconstruction

from export.exporter import export_result
from export.settings import ExportSettings
from freeart21.articulation import PARTS
from freeart21.files.asset import read_asset
from freeart21.files.gaussians import GAUSSIANS, read_gaussians, write_gaussians
from freeart21.files.result import write_result
from freeart21.gaussians import Gaussians, face_along
from freeart21.mesh import Mesh
from freeart21.view.pages import write_page


def without_bottom(mesh: Mesh, n) -> Mesh:
    normals = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals
    return mesh.with_faces(normals @ n > -0.9)


def seen_gaussians(parts) -> Gaussians:
    """Discs 1 cm wide on both seen parts, at the joint's canonical zero."""
    rows = []
    for weight, name in zip((0.97, 0.03), PARTS, strict=True):
        mesh = trimesh.Trimesh(parts.part(name).vertices, parts.part(name).faces, process=False)
        points, faces = trimesh.sample.sample_surface(mesh, 300, seed=0)
        rows.append((points, mesh.face_normals[faces], np.full(300, weight)))
    points, normals, weights = (np.concatenate(its) for its in zip(*rows, strict=True))
    n = len(points)
    arrays = (points, face_along(normals), np.tile([5e-3, 5e-3, 5e-4], (n, 1)), np.full(n, 0.8), np.full((n, 3), 0.5))
    light = np.array([[3.5, 3.5, 3.5]], np.float32)
    return Gaussians(*(a.astype(np.float32) for a in (*arrays, weights, normals)), light=light)


def test_what_nobody_saw_has_marked_gaussians_in_the_colours_of_the_mesh(tmp_path):
    answer = reconstruction("revolute", (0.3, 0.5, 0.9), frame=3)
    up = answer.articulation.part("moving").vertices.mean(0) - answer.articulation.part("reference").vertices.mean(0)
    open_below = without_bottom(answer.articulation.reference, up / np.linalg.norm(up))
    answer = replace(answer, articulation=replace(answer.articulation, reference=open_below))
    answer = replace(answer, appearance=seen_gaussians(answer.articulation))
    write_result(tmp_path / "result", answer)
    export_result(tmp_path / "result", tmp_path / "asset", ExportSettings(scale=2.0))
    found = read_gaussians(tmp_path / "asset" / GAUSSIANS, needs_parts=True)
    urdf = yourdfpy.URDF.load(str(read_asset(tmp_path / "asset").urdf))
    source = read_asset(tmp_path / "asset").source["parts"]
    assert found.supposed is not None and np.isin(found.part_weights, [0, 1]).all() and len(found.light) == 1
    for name, colour in zip(PARTS, (RED, BLUE), strict=True):
        own = (found.part_weights > 0.5) == (name == "reference")
        frame = urdf.get_transform(getattr(read_asset(tmp_path / "asset"), f"{name}_link"), urdf.base_link)
        file = tmp_path / "asset" / "meshes" / f"{name}.obj"
        mesh = trimesh.load(file, process=False, maintain_order=True).apply_transform(frame)
        first = source[name]["patch"]["first_face"]
        seen, patch = (trimesh.Trimesh(mesh.vertices, mesh.faces[some]) for some in (np.s_[:first], np.s_[first:]))
        assert (own & ~found.supposed).sum() == 300
        off = trimesh.proximity.closest_point(mesh, found.means[own & ~found.supposed])[1]
        assert np.quantile(off, 0.9) < 1e-5 and off.max() < 2e-3, "but where a part was carved at the hinge"
        assert found.scales[own & ~found.supposed].max() == pytest.approx(0.01, rel=1e-3)
        discs = own & found.supposed
        if name == "moving":
            assert first == len(mesh.faces) and not discs.any()
            continue
        assert trimesh.proximity.closest_point(patch, found.means[discs])[1].max() < 1e-5
        points, faces = trimesh.sample.sample_surface(patch, 500, seed=0)
        away = np.linalg.norm(points[:, None] - found.means[discs], axis=-1)
        assert away.min(1).max() < 2 * 0.01 / 0.6, "twice their distance from each other"
        facing = np.einsum("ij,ij->i", found.normals[discs][away.argmin(1)], patch.face_normals[faces])
        assert np.quantile(facing, 0.1) > 0.99
        assert np.abs(found.colours[discs] - np.array(colour[:3]) / 255).max() < 0.02
        assert seen.area > 0


def test_a_page_and_a_file_tell_supposed_gaussians(tmp_path):
    given = seen_gaussians(reconstruction().articulation)
    some = np.arange(len(given)) % 7 == 0
    write_gaussians(tmp_path / "a.ply", replace(given, supposed=some))
    assert np.array_equal(read_gaussians(tmp_path / "a.ply").supposed, some)
    write_page(tmp_path / "a.ply", tmp_path / "a.html")
    assert "On surface that nobody saw" in Path(tmp_path / "a.html").read_text("utf-8")
    write_gaussians(tmp_path / "b.ply", given)
    assert read_gaussians(tmp_path / "b.ply").supposed is None


def test_an_asset_of_a_result_without_gaussians_has_none(tmp_path):
    """A file with no rows is no appearance either: the width of discs would be unknown."""
    none = seen_gaussians(reconstruction().articulation).chosen(np.zeros(0, int))
    export_result(replace(reconstruction(), appearance=none), tmp_path / "asset")
    assert not (tmp_path / "asset" / GAUSSIANS).exists()
