"""Part meshes of an asset: closed solids that keep what was seen, and textures that show what the video shows."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from refusal import assert_refused
from solid_case import tray

from export.atlas import find_texels, unwrap
from export.exporter import export_result
from export.free_space import SWEPT, SpaceGrid
from export.parts import close_parts
from export.settings import ExportSettings, MeshSettings
from export.surface import Surface, close_surface
from export.symmetry import Supposed
from export.texture import textures_from_video
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files.sequence import write_sequence
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Frame, Recording

FEW = MeshSettings(points=4_000)
CARD_BOX = (0.1, 0.08, 0.04)


def fine(solid: trimesh.Trimesh, edge: float = 0.004) -> Mesh:
    """The triangles of a solid in pieces, as a reconstruction has them."""
    vertices, faces = trimesh.remesh.subdivide_to_size(solid.vertices, solid.faces, edge, max_iter=20)
    return Mesh(vertices, faces)


def without(mesh: Mesh, gone) -> Mesh:
    """The mesh without the triangles whose middle `gone` names."""
    return mesh.with_faces(~gone(mesh.vertices[mesh.faces].mean(1)))


def solid_of(surface: Surface) -> trimesh.Trimesh:
    solid = trimesh.Trimesh(surface.mesh.vertices, surface.mesh.faces, process=False)
    assert solid.is_watertight and solid.is_winding_consistent and solid.volume > 0
    return solid


def test_a_box_nobody_saw_from_below_is_closed_by_a_flat_patch():
    seen = without(fine(trimesh.creation.box((0.1, 0.06, 0.03))), lambda p: p[:, 2] < -0.0149)
    surface = close_surface(seen, FEW)
    solid = solid_of(surface)
    assert solid.volume == pytest.approx(0.1 * 0.06 * 0.03, rel=0.01)
    below = np.arange(len(solid.faces)) >= surface.patch_first
    assert solid.area_faces[below].sum() == pytest.approx(0.1 * 0.06, rel=0.1)
    assert (solid.triangles_center[below][:, 2] < -0.01).all()
    assert surface.patch_share == pytest.approx(0.06 / 0.216, rel=0.1) and surface.patch_count > 0


def test_an_unseen_back_behind_ragged_edges_is_the_plane_at_their_end():
    """Four sides of a box seen to between nine tenths of their length and all of it: the back is where they end."""
    box = fine(trimesh.creation.box((0.1, 0.06, 0.05)), 0.003)

    def hidden(p):
        deepest = 0.05 - 0.01 * np.abs(np.sin(60 * p[:, 1]) * np.cos(45 * p[:, 2] + 0.7))
        return p[:, 0] > deepest - 1e-4

    surface = close_surface(without(box, hidden), FEW)
    solid = solid_of(surface)
    assert solid.volume == pytest.approx(0.1 * 0.06 * 0.05, rel=0.015)
    back = solid.triangles[surface.patch_first :]
    facing = solid.face_normals[surface.patch_first :, 0] > 0.9
    area = solid.area_faces[surface.patch_first :]
    assert area[facing].sum() > 0.9 * 0.06 * 0.05
    assert np.ptp(back[facing][..., 0]) < 2e-3


def test_what_was_seen_stays_where_it_was():
    seen = without(fine(trimesh.creation.icosphere(4, 0.05)), lambda p: p[:, 2] < -0.03)
    surface = close_surface(seen, replace(FEW, points=8_000, max_faces=10**6))
    solid, still = solid_of(surface), np.unique(surface.mesh.faces[: surface.patch_first])
    observed = trimesh.Trimesh(seen.vertices, seen.faces, process=False)
    off = trimesh.proximity.closest_point(observed, solid.vertices[still][::9])[1]
    assert np.quantile(off, 0.97) < 1e-9 and off.max() < 0.006  # a patch's triangles at the edge
    assert np.median(trimesh.proximity.closest_point(solid, seen.vertices[::5])[1]) < 2e-4


@pytest.mark.parametrize("wall", [0.002, 0.004])
def test_an_opening_that_was_seen_stays_open(wall: float):
    seen = without(fine(tray(wall, CARD_BOX), 0.006), lambda p: p[:, 2] < -0.0199)  # all but the underside
    solid = solid_of(close_surface(seen, replace(FEW, points=12_000)))
    assert solid.volume == pytest.approx(tray(wall, CARD_BOX).volume, rel=0.05)
    assert not solid.contains([[0, 0, 0]]).any()


def test_two_sheets_of_a_thin_thing_become_one_plate():
    plate = fine(trimesh.creation.box((0.08, 0.06, 0.001)), 0.002)
    seen = without(plate, lambda p: np.abs(p[:, 2]) < 0.00049)  # both faces, no rim
    solid = solid_of(close_surface(seen, replace(FEW, points=8_000)))
    assert solid.body_count == 1
    assert solid.volume == pytest.approx(0.08 * 0.06 * 0.001, rel=0.08)


def test_ragged_holes_and_crumbs_are_gone():
    rng = np.random.default_rng(1)
    ball = fine(trimesh.creation.icosphere(4, 0.05))
    holes = rng.normal(size=(12, 3))
    holes *= 0.05 / np.linalg.norm(holes, axis=1, keepdims=True)
    seen = without(ball, lambda p: (np.linalg.norm(p[:, None] - holes, axis=-1) < 0.008).any(1))
    crumb = trimesh.creation.icosphere(1, 0.001)
    both = Mesh(
        np.concatenate([seen.vertices, crumb.vertices + 0.08]),
        np.concatenate([seen.faces, crumb.faces + len(seen.vertices)]),
    )
    solid = solid_of(close_surface(both, FEW))
    assert solid.body_count == 1
    assert solid.volume == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=0.03)


def test_a_closed_part_keeps_its_triangles_and_has_no_patch():
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    surface = close_surface(Mesh(box.vertices, box.faces), FEW)
    assert (len(surface.mesh.vertices), len(surface.mesh.faces), surface.patch_count) == (8, 12, 0)
    inside_out = close_surface(Mesh(box.vertices, box.faces[:, ::-1]), FEW)
    assert inside_out.flipped and not surface.flipped and solid_of(inside_out).volume == pytest.approx(1e-3)


def test_overlapping_pieces_count_once():
    one, two = (
        trimesh.creation.box((0.1, 0.1, 0.1)),
        trimesh.creation.box((0.1, 0.1, 0.1), se3.pose(np.eye(3), (0.05, 0, 0))),
    )
    both = trimesh.util.concatenate([one, two])
    assert solid_of(close_surface(Mesh(both.vertices, both.faces), FEW)).volume == pytest.approx(0.15 * 0.01)


def test_many_triangles_are_reduced_and_stay_a_solid():
    ball = trimesh.creation.icosphere(6, 0.05)
    surface = close_surface(Mesh(ball.vertices, ball.faces), replace(FEW, max_faces=3_000))
    assert len(surface.mesh.faces) <= 3_000
    assert solid_of(surface).volume == pytest.approx(ball.volume, rel=0.005)


def test_a_patch_keeps_out_of_the_other_parts_way():
    cup = without(
        fine(trimesh.creation.box((0.06, 0.06, 0.06))), lambda p: p[:, 2] > 0.0299
    )  # open above, inside unseen
    swept = SpaceGrid(se3.pose(np.eye(3), (-0.02, -0.02, -0.01)), 0.001, np.full((41, 41, 51), SWEPT, np.uint8))
    plain, kept_out = (solid_of(close_surface(cup, FEW, where)) for where in (None, swept))
    assert plain.volume == pytest.approx(0.06**3, rel=0.02)
    assert plain.contains([[0, 0, 0.01]]).all() and not kept_out.contains([[0, 0, 0.01]]).any()
    assert kept_out.volume == pytest.approx(0.06**3 - 0.04**2 * 0.04, rel=0.1)


HOSTILE = {
    "one triangle": (Mesh(np.eye(3), [[0, 1, 2]]), None),
    "a flat sheet": (Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]]), None),
    "no triangle": (Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)), "no triangle of any area"),
    "no area": (Mesh(np.zeros((3, 3)), [[0, 1, 2]]), "no triangle of any area"),
    "a line": (Mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]), "no triangle of any area"),
    "ten million": (Mesh(np.eye(3), np.tile([[0, 1, 2]], (10_000_000, 1))), "has 10000000 triangles, expected at most"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_meshes_are_solids_or_one_line(name: str):
    mesh, message = HOSTILE[name]
    if message is None:
        assert solid_of(close_surface(mesh, FEW)).volume > 0
        return
    assert_refused(message, close_surface, mesh, FEW)


# --- atlas and texture


def test_a_huge_surface_gets_larger_texels_not_a_larger_picture():
    ball = trimesh.creation.icosphere(2, 1.0)
    atlas = unwrap(Mesh(ball.vertices, ball.faces), 1e-5)
    assert max(atlas.width, atlas.height) <= 4096 and atlas.texel_m > 1e-5


CAMERA = Camera.from_fov(320, 240, 0.8)


def print_colour(p: np.ndarray) -> np.ndarray:
    """Stripes 2 mm wide."""
    dark = np.floor(p[:, 0] / 0.002) % 2 == 0
    return np.where(dark[:, None], 40.0, 210.0) * np.ones(3)


def filmed(lamp: float = 0.0) -> tuple[Reconstruction, Recording]:
    """A striped card that tips before the camera, a small box before it; `lamp` darkens it by frame."""
    n = 8
    card = fine(trimesh.creation.box((0.08, 0.06, 0.01)), 0.004)
    lid = fine(trimesh.creation.box((0.02, 0.02, 0.01), se3.pose(np.eye(3), (0.02, 0.015, -0.012))), 0.004)
    joint = Joint("lid", "prismatic", np.array([1.0, 0, 0]), np.zeros(3), -0.02, 0.0)
    states = np.linspace(0, -0.02, n)
    tips = np.stack([se3.exp_se3(np.array([0, 0, 0, 0.05 * i - 0.2, 0.3 - 0.08 * i, 0.1])) for i in range(n)])
    tips[:, :3, 3] += [0, 0, 0.2]
    moving = tips @ joint.transform(states)
    frames, labels = [], []
    for i in range(n):
        rgb, label = np.full((240, 320, 3), 120, np.uint8), np.zeros((240, 320), np.uint8)
        depth = np.full(label.shape, np.inf)
        for k, (mesh, T) in enumerate(((card, tips[i]), (lid, moving[i]))):
            T_part_camera = se3.inverse(T)
            rays = CAMERA.rays().reshape(-1, 3) @ T_part_camera[:3, :3].T
            solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
            low, high = solid.bounds
            with np.errstate(divide="ignore", invalid="ignore"):
                near, far = ((bound - T_part_camera[:3, 3]) / rays for bound in (low, high))
            enter, leave = np.minimum(near, far).max(1), np.maximum(near, far).min(1)
            z = np.where(enter < leave, enter, np.inf).reshape(label.shape)
            shown = z < depth
            depth[shown], label[shown] = z[shown], k + 1
            place = T_part_camera[:3, 3] + rays.reshape(*label.shape, 3)[shown] * z[shown][:, None]
            colour = print_colour(place) if k == 0 else np.tile([30.0, 160, 60], (len(place), 1))
            rgb[shown] = np.clip(colour * (1 - lamp * i / n), 0, 255)
        labels.append(label)
        frames.append(Frame(rgb, np.where(np.isfinite(depth), depth, 0).astype(np.float32), label > 0))
    answer = Reconstruction(
        Articulation(joint, card, lid), states, tips, moving, np.stack(labels), np.ones((n, 2), bool)
    )
    return answer, Recording(CAMERA, np.arange(n) / 30, lambda i: frames[i], name="card")


@pytest.mark.parametrize("lamp", [0.0, 0.5])
def test_print_is_read_from_the_video_whatever_the_lamp_does(lamp: float):
    answer, recording = filmed(lamp)
    whole = answer.articulation
    card, lid = textures_from_video(answer, (whole.reference, whole.moving), recording)
    texels = find_texels(card.atlas)
    place = texels.interpolate(whole.reference, whole.reference.vertices).astype(float)
    front = (place[:, 2] < -0.00499) & (np.abs(place[:, 0]) < 0.035) & (np.abs(place[:, 1]) < 0.025)
    under = (place[:, 0] > -0.012) & (place[:, 0] < 0.033) & (place[:, 1] > 0.001)  # behind the lid, in some frame
    middle = np.abs((place[:, 0] / 0.002) % 1 - 0.5) < 0.2  # of a stripe
    sure = front & ~under & middle
    shown = card.image[texels.row, texels.column].astype(float).mean(1)[sure]
    light = print_colour(place[sure])[:, 0] > 100
    assert sure.sum() > 1000
    assert shown[light].min() - shown[~light].max() > 60
    green = lid.image[tuple(np.stack([find_texels(lid.atlas).row, find_texels(lid.atlas).column]))]
    assert (green[:, 1] > green[:, 0] + 40).all()  # nothing of the card's stripes, and what nobody saw is green, too


def test_an_unseen_back_wears_the_colours_of_what_a_symmetry_copies():
    """Points of the card's back are copies of one point of its front: on a light stripe, then on a dark one."""
    answer, recording = filmed()
    whole = answer.articulation
    x, y = (line.ravel() for line in np.meshgrid(np.linspace(-0.03, 0.03, 31), np.linspace(-0.02, 0.02, 21)))
    back, behind = np.stack([x, y, np.full_like(x, 0.005)], -1), np.tile([0.0, 0, 1], (len(x), 1))
    shown = []
    for stripe in (0, 1):
        source = np.array([0.002 * stripe - 0.029, -0.02, -0.005])
        copies = Supposed(back, behind, np.tile(source, (len(x), 1)))
        card, _ = textures_from_video(answer, (whole.reference, whole.moving), recording, (copies, Supposed()))
        texels = find_texels(card.atlas)
        place = texels.interpolate(whole.reference, whole.reference.vertices)
        there = (place[:, 2] > 0.00499) & (np.abs(place[:, 0]) < 0.025) & (np.abs(place[:, 1]) < 0.015)
        assert there.sum() > 1000
        shown.append(card.image[texels.row, texels.column].astype(float).mean(1)[there].mean())
        expected = print_colour(source[None]).mean()
        assert shown[-1] == pytest.approx(expected, abs=20)
    assert abs(shown[0] - shown[1]) > 60


def test_a_recording_of_something_else_is_refused():
    answer, recording = filmed()
    shorter = replace(
        answer,
        states=answer.states[:5],
        Ts_camera_reference=answer.Ts_camera_reference[:5],
        Ts_camera_moving=answer.Ts_camera_moving[:5],
        part_masks=answer.part_masks[:5],
        seen=answer.seen[:5],
    )
    with pytest.raises(FreeArtError, match="card has 8 frames of 320 x 240, expected 5 frames"):
        close_parts(shorter, recording, FEW)


def test_an_asset_from_a_video_wears_it_and_says_so(tmp_path: Path):
    answer, recording = filmed()
    write_sequence(tmp_path / "card", recording, 1e-4)
    settings = ExportSettings()
    asset = export_result(answer, tmp_path / "a", settings, video=tmp_path / "card")
    facts = json.loads((tmp_path / "a/asset.json").read_text())["source"]["parts"]["reference"]
    assert facts["texture"] == "video" and facts["texel_m"] == pytest.approx(0.2 / CAMERA.K[0, 0] / 2, rel=0.1)
    assert facts["patch"] == {
        "first_face": facts["faces"],
        "faces": 0,
        "symmetric_faces": 0,
        "panel_faces": 0,
        "area_fraction": 0,
    }
    picture = cv2.imread(str(tmp_path / "a/meshes/reference.png"))
    assert np.ptp(picture) > 100
    loaded = trimesh.load_mesh(tmp_path / "a/meshes/reference.obj", process=False, maintain_order=True)
    assert len(loaded.faces) == facts["faces"]
    text = (tmp_path / "a/meshes/reference.obj").read_text()
    assert text.count("\nv ") < 0.6 * facts["faces"]
    assert asset.scale == 1.0
    assert_refused("is not a folder", export_result, answer, tmp_path / "c", settings, video=tmp_path / "none")
    assert not (tmp_path / "c").exists()
