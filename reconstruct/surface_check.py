"""Check of the resulting surfaces against the video, by rendering them into it. Needs no ground truth.

The meshes are posed by the reference part's poses, the joint and its states, as a simulation poses them, and compared
with some frames. `freeart21.trust` judges the figures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.articulation import PARTS
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array
from freeart21.trust import object_size
from freeart21.z_buffer import BEHIND, draw_triangles
from reconstruct.evidence import sample_evenly
from reconstruct.scene import LIGHTNESS, Scene
from reconstruct.surfaces import label_components

MOST_DRAWN = 48
"""Frames, evenly spaced, that are compared, including those in which a part was not recognised."""
RIM = 2
"""Pixels next to an outline that are ignored: there depth mixes, and a surface ends half a pixel early or late."""
OFF_SHARE, OFF_NOISE = 0.01, 1.5
"""A pixel is off the surface by more than this share of the object's size, and than so many footprints and depth
deviations: more than fusion rounds. A finer tolerance is needed: with twice as much, an axis that is off by 10 degrees
had 1.1 % of its part's pixels off, like the right ones; with this one, 6.4 %."""
PATCH = np.ones((3, 3), np.uint8)
"""Pixels off both surfaces count in patches of this size and more: single ones and lines are depth steps. Without it up
to 5.4 % of right answers' pixels (a laptop's rim) were off in a tenth of the frames, with it 0.6 %."""
LEAST = 20
"""With fewer pixels a figure is NaN."""


def check_surfaces(scene: Scene, answer: Reconstruction) -> dict[str, Any]:
    """How well the result's surfaces match the video, by the names of `Diagnostics`' fields."""
    size = object_size(answer)
    tolerance = max(OFF_SHARE * size, OFF_NOISE * float(np.hypot(scene.footprint, scene.noise)))
    meshes = [answer.articulation.part(name) for name in PARTS]
    by_frame = {
        name: np.full((len(answer), 2), np.nan) for name in ("uncovered", "spilled", "off_surface", "colour_residual")
    }
    states = [np.tile([[np.inf], [-np.inf]], len(mesh.vertices)) for mesh in meshes]
    widths = np.zeros(2)
    for i in map(int, sample_evenly(np.arange(len(answer)), MOST_DRAWN)):
        posed = answer.articulation.posed(answer.Ts_camera_reference[i], float(answer.states[i]))
        rendered, labels = _render_meshes(scene, i, posed), _crop_labels(scene, answer, i)
        distance = _surface_distance(scene, i, rendered)
        by_frame["uncovered"][i] = _uncovered_shares(scene, i, distance > tolerance, labels)
        if not answer.seen[i].all():
            continue
        for k, mesh in enumerate(posed):
            for name, value in _compare_frame(scene, i, rendered, labels, k + 1, distance > tolerance).items():
                by_frame[name][i, k] = value
            shown = _shown_vertices(scene, i, mesh, tolerance)
            states[k][0, shown] = np.minimum(states[k][0, shown], answer.states[i])
            states[k][1, shown] = np.maximum(states[k][1, shown], answer.states[i])
            widths[k] = max(widths[k], _mask_extent(scene, i, labels == k + 1))
    return by_frame | {
        "extent_ratio": np.array(
            [_ratio(bounding_diagonal(m), width) for m, width in zip(meshes, widths, strict=True)]
        ),
        "seen_share": np.array(
            [_seen_share(m, answer.articulation.joint, s, tolerance) for m, s in zip(meshes, states, strict=True)]
            if answer.seen.all(1).any()
            else [np.nan, np.nan]
        ),
    }


@dataclass(frozen=True)
class _RenderedMeshes:
    """First hits of the rays through a crop's pixels."""

    depth: Array
    """(h, w) metres, infinite without a hit."""
    part: NDArray[np.uint8]
    """(h, w) 1 reference, 2 moving, 0 neither."""
    colours: NDArray[np.float32]
    """(h, w, 3) interpolated vertex colours, RGB 0 to 255; NaN where a mesh has none."""


def _render_meshes(scene: Scene, frame: int, meshes: tuple[Mesh, Mesh]) -> _RenderedMeshes:
    shape = scene.mask.shape[1:]
    depth, part = np.full(shape, np.inf), np.zeros(shape, np.uint8)
    colours = np.full((*shape, 3), np.nan, np.float32)
    for k, mesh in enumerate(meshes):
        if mesh.empty:
            continue
        face, weights = np.full(shape, -1), np.zeros((*shape, 3))
        at = _project_to_crop(scene, frame, mesh.vertices)
        draw_triangles(at, mesh.vertices[:, 2].copy(), mesh.faces, depth, face, weights)
        on = face >= 0
        part[on] = k + 1
        corners = mesh.faces[face[on]]
        colours[on] = np.nan if mesh.colours is None else np.einsum("nk,nkd->nd", weights[on], mesh.colours[corners])
    return _RenderedMeshes(depth, part, colours)


def _project_to_crop(scene: Scene, frame: int, points_camera: Array) -> Array:
    """(p, 2) positions of points (p, 3) in the crop of a frame, pixel centres at + 0.5; 0 for those behind the
    camera."""
    ahead = points_camera[:, 2] > BEHIND
    z = np.where(ahead, points_camera[:, 2], 1.0)
    u = scene.fx * points_camera[:, 0] / z + scene.cx[frame] + 0.5
    v = scene.fy * points_camera[:, 1] / z + scene.cy[frame] + 0.5
    return np.where(ahead[:, None], np.stack([u, v], 1), 0.0)


def _crop_labels(scene: Scene, answer: Reconstruction, frame: int) -> NDArray[np.uint8]:
    """(h, w) the result's part masks in the crop of a frame."""
    h, w = scene.mask.shape[1:]
    (x, y), at = scene.origin[frame], scene.factor // 2
    return np.asarray(answer.part_masks[frame][y + at :: scene.factor, x + at :: scene.factor][:h, :w], np.uint8)


def _surface_distance(scene: Scene, frame: int, rendered: _RenderedMeshes) -> Array:
    """(h, w) metres from the points of a crop to the rendered surface; infinite where either is missing."""
    points, met = scene.points[frame], (rendered.part > 0) & scene.valid[frame]
    along = np.where(met, rendered.depth, 0) / np.where(met, points[..., 2], 1) - 1
    return np.where(met, np.abs(along * (scene.normals[frame] * points).sum(-1)), np.inf)


def _uncovered_shares(scene: Scene, frame: int, off: NDArray[np.bool_], labels: NDArray[np.uint8]) -> list[float]:
    """Share of each part's pixels, away from outline and depth steps, in patches that lie `off` (h, w) the surfaces.

    Unlabelled object pixels count for both parts.
    """
    tested = scene.valid[frame] & ~scene.edge[frame] & _inside(scene.mask[frame])
    patches = cv2.morphologyEx((tested & off).astype(np.uint8), cv2.MORPH_OPEN, PATCH) > 0
    return [_mean_or_nan(patches[tested & (labels != 3 - k)]) for k in (1, 2)]


def _inside(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(h, w) pixels of `mask` (h, w) that are not next to its outline."""
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3) > RIM)


def _compare_frame(
    scene: Scene, frame: int, rendered: _RenderedMeshes, labels: NDArray[np.uint8], part: int, off: NDArray[np.bool_]
) -> dict[str, float]:
    """One frame's figures of a part (1 or 2); `off` (h, w) marks pixels off the rendered surface."""
    own, points = labels == part, scene.points[frame]
    inner = _inside(own)
    here = rendered.part == part
    hidden = (points[..., 2] < 0) & (-points[..., 2] < rendered.depth)  # by a hand
    spilled = here & (scene.outside[frame] > RIM) & ~hidden
    met = inner & here & scene.valid[frame]
    lab = cv2.cvtColor((np.nan_to_num(rendered.colours) / 255).astype(np.float32), cv2.COLOR_RGB2LAB) * np.array(
        [LIGHTNESS, 1, 1], np.float32
    )
    painted = met & np.isfinite(rendered.colours).all(-1)
    colour = np.linalg.norm(lab - scene.features[frame], axis=-1)[painted]
    return {
        "spilled": _mean_or_nan(spilled[here & ~hidden]),
        "off_surface": _mean_or_nan(off[met]),
        "colour_residual": float(np.median(colour)) if len(colour) >= LEAST else np.nan,
    }


def _mean_or_nan(values: NDArray[np.bool_]) -> float:
    return float(values.mean()) if len(values) >= LEAST else np.nan


def _shown_vertices(scene: Scene, frame: int, mesh: Mesh, tolerance: float) -> NDArray[np.bool_]:
    """(V,) vertices of a posed mesh at which the frame's depth lies within `tolerance`, metres."""
    h, w = scene.mask.shape[1:]
    x, y = np.floor(_project_to_crop(scene, frame, mesh.vertices)).astype(int).T
    inside = (mesh.vertices[:, 2] > BEHIND) & (x >= 0) & (y >= 0) & (x < w) & (y < h)
    found = np.zeros(len(mesh.vertices), bool)
    depth = scene.points[frame, y[inside], x[inside], 2]
    found[inside] = (depth > 0) & (np.abs(mesh.vertices[inside, 2] - depth) < tolerance)
    return found


def _mask_extent(scene: Scene, frame: int, mask: NDArray[np.bool_]) -> float:
    """Extent across the image, metres, of the pixels of `mask` (h, w) at their median depth; 0 when they are few."""
    rows, columns = np.nonzero(mask & scene.valid[frame])
    if len(rows) < LEAST:
        return 0.0
    depth = float(np.median(scene.points[frame, rows, columns, 2]))
    return float(np.hypot(np.ptp(rows) + 1, np.ptp(columns) + 1)) * depth / scene.fx


def _ratio(extent: float, width: float) -> float:
    return extent / width if width > 0 else np.nan


def _seen_share(mesh: Mesh, joint: Joint, states: Array, tolerance: float) -> float:
    """Share of a mesh's area, 0 to 1, in faces with a vertex that some frame showed; NaN when it has no area.

    `states` (2, V) are the lowest and the highest state, rad or m, at which each vertex was shown. A detached component
    does not count when less than half of its shown area was shown over states that displace it by `tolerance`, metres,
    or more: it may belong to the other part.
    """
    areas, (low, high) = mesh.areas(), states
    if not areas.sum() > 0:
        return np.nan
    shown = low <= high
    lever = np.ones(len(low))
    if joint.type == "revolute":
        lever = np.linalg.norm(np.cross(mesh.vertices - joint.pivot, joint.axis), axis=1)
    span = float(np.ptp(states[:, shown])) if shown.any() else 0.0
    moved = lever * np.where(shown, high - low, 0)
    known = shown & ((moved >= tolerance) | (lever * span < tolerance))
    component = label_components(mesh.faces, len(mesh.vertices))
    area, area_shown, area_known = (
        np.bincount(component, areas * faces)
        for faces in (np.ones(len(areas)), shown[mesh.faces].any(1), known[mesh.faces].any(1))
    )
    counts = area_known >= 0.5 * area_shown
    counts[np.argmax(area)] = True
    return float(area_shown[counts].sum() / areas.sum())
