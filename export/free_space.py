"""Space that is known to be empty of a part: the video looked through it, or the other part passed through it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from export.planes import PLANE_TOLERANCE, fit_planes, plane_axes
from export.winding_number import Winding
from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.mesh import Mesh, bounding_diagonal, triangle_normals
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array

MAX_VOXELS = 1_000_000
"""Voxels of a part's grid: 2.4 mm in a drawer unit of 26 cm, whose floor is 4 mm thick."""
MAX_FRAMES = 120
"""Frames that are looked through, evenly spread over those that show the part."""
MIN_FRAMES = 2
"""Frames that must agree: one frame's pose can be off."""
_PAD = 3
"""Voxels around the part's box."""
_SIGMAS = 3.0
"""Standard deviations of the depth in front of a measured surface from which space is empty."""
_NEAR_SHARE = 0.02
"""Fraction of the part's diagonal within which a pixel's depth belongs to the surface drawn there."""
_SAMPLES = 8_000
"""Points of a part that its largest planes are found with."""
_PROBES = 1.5
"""Voxels behind a surface from which space is looked up; set by hand, above half a voxel's diagonal."""
_FACING = 0.5
"""Cosine, 60 degrees, set by hand."""
INSIDE = 0.75
"""Winding number of a part's seen surface from which a point is inside it. At a hole it is about a half; the value is
set by hand, midway to 1. Without this test a bottle was mirrored into its own inside."""
_STATES = 9
"""States of the other part, evenly over those of the video, at which a point may be inside it; set by hand."""
UNKNOWN, SEEN_THROUGH, SWEPT = 0, 1, 2


@dataclass(frozen=True)
class OtherPart:
    """The other part as it was seen, at some of its states."""

    seen: Winding
    Ts_other_part: Array
    """(m, 4, 4)."""

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3), in this part's frame, are inside the other part in any state."""
        inside = np.zeros(len(points), bool)
        for T in self.Ts_other_part:
            rest = np.flatnonzero(~inside)
            inside[rest] = self.seen.number(se3.transform(T, points[rest])) > INSIDE
        return inside


@dataclass(frozen=True)
class SpaceGrid:
    """Voxels around a part, along its largest planes, in the part's frame."""

    T_part_grid: Array
    """(4, 4); the grid's origin is the centre of voxel (0, 0, 0)."""
    voxel: float
    """m, edge of a voxel."""
    state: NDArray[np.uint8]
    """(X, Y, Z) `UNKNOWN`, `SEEN_THROUGH` or `SWEPT`."""
    swept_normals: NDArray[np.float32] | None = None
    """(X, Y, Z, 3) sum of the outward normals of the other part's surface that passed through a voxel; None: unknown,
    all of it counts."""

    around: SpaceGrid | None = None
    """Coarser, of three times the extent: a mirror image reaches no further. None: unknown."""
    other: OtherPart | None = None
    """The other part. None: unknown."""

    def centres(self, chosen: NDArray[np.bool_]) -> Array:
        """(n, 3) centres of the voxels where `chosen` (X, Y, Z) is true, in the part's frame."""
        return se3.transform(self.T_part_grid, self.voxel * np.argwhere(chosen))

    def look_up(self, points: Array) -> NDArray[np.uint8]:
        """(n,) states at points (n, 3): outside the grid those `around`, and beyond `UNKNOWN`."""
        at, within = self._voxels(points)
        found = np.zeros(len(points), np.uint8)
        found[within] = self.state[tuple(at[within].T)]
        if self.around is not None and not within.all():
            found[~within] = self.around.look_up(points[~within])
        return found

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3) lie in the grid or around it: of others nothing is known."""
        within = self._voxels(points)[1]
        return within if self.around is None else within | self.around.holds(points)

    def is_empty_behind(self, points: Array, normals: Array) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3) behind surface with outward normals (n, 3) are known to be empty.

        Space that the other part's surface passed counts where that faces as the surface here does, within
        `_FACING`: then it passed behind a wall. Else it is that part's back or edge, which reached into this one by the
        error of poses and outlines, as where two parts slide on each other.
        """
        at, within = self._voxels(points)
        state, empty = self.state[tuple(at[within].T)], np.zeros(len(points), bool)
        swept = state == SWEPT
        if self.swept_normals is not None:
            m = self.swept_normals[tuple(at[within].T)]
            turned = np.einsum("ij,ij->i", m, normals[within] @ self.T_part_grid[:3, :3])
            swept &= turned > _FACING * np.linalg.norm(m, axis=1)
        empty[within] = (state == SEEN_THROUGH) | swept
        return empty

    def depth_to_empty(self, points: Array, normals: Array, most: float | Array = np.inf) -> Array:
        """(n,) m inwards from points (n, 3) of a surface with outward normals (n, 3) to the first voxel that is known
        to be empty, `_PROBES` voxels deep or more; infinite where there is none up to `most`, m."""
        found, limits = np.full(len(points), np.inf), np.broadcast_to(most, len(points))
        longest = self.voxel * float(np.linalg.norm(self.state.shape))
        waiting = np.arange(len(points))
        for depth in np.arange(_PROBES * self.voxel, longest, self.voxel):
            waiting = waiting[depth < limits[waiting]]
            if not len(waiting):
                break
            empty = self.is_empty_behind(points[waiting] - depth * normals[waiting], normals[waiting])
            found[waiting[empty]] = depth
            waiting = waiting[~empty]
        return found

    def _voxels(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """(n, 3) voxels of points, and (n,) whether these are in the grid."""
        at = np.rint(se3.transform(se3.inverse(self.T_part_grid), points) / self.voxel).astype(np.int64)
        return at, np.asarray(((at >= 0) & (at < self.state.shape)).all(1))


def find_free_space(reconstruction: Reconstruction, name: str, recording: Recording | None) -> SpaceGrid:
    """The voxels around part `name` that are known to be empty of it, in its canonical frame.

    A voxel is seen through when at least `MIN_FRAMES` frames measured depth behind it, or no object there, in all
    pixels around it; frames of all states count. It is swept when the other part's seen surface passes through it
    within the range of states. Without a recording nothing is seen through.
    """
    own = reconstruction.articulation.part(name)
    around = _fill_grid(reconstruction, name, recording, *_lay_grid(own, MAX_VOXELS // 4, 1.0))
    q, k = reconstruction.states, PARTS.index(name)
    Ts = reconstruction.articulation.joint.transform(np.linspace(q.min(), q.max(), _STATES))
    other = OtherPart(Winding(reconstruction.articulation.part(PARTS[1 - k])), Ts if k else se3.inverse(Ts))
    return replace(_fill_grid(reconstruction, name, recording, *_lay_grid(own, MAX_VOXELS)), around=around, other=other)


def _fill_grid(
    reconstruction: Reconstruction,
    name: str,
    recording: Recording | None,
    T: Array,
    voxel: float,
    shape: tuple[int, int, int],
) -> SpaceGrid:
    """`find_free_space` in one grid."""
    whole = reconstruction.articulation
    other = whole.part("moving" if name == "reference" else "reference")
    state, normals = np.zeros(shape, np.uint8), np.zeros((*shape, 3), np.float32)
    q = reconstruction.states
    Ts = whole.joint.transform(np.linspace(q.min(), q.max(), _count_states(reconstruction, other, voxel)))
    Ts = se3.inverse(T) @ (Ts if name == "reference" else se3.inverse(Ts))
    _mark_swept(state, normals, Ts, *_sample(other, voxel), voxel)
    if recording is not None:
        seen = _count_looks(reconstruction, name, recording, T, voxel, shape)
        state[seen >= MIN_FRAMES] = SEEN_THROUGH
    return SpaceGrid(T, voxel, state, normals)


def _lay_grid(part: Mesh, most: int, margin: float = 0.0) -> tuple[Array, float, tuple[int, int, int]]:
    """T_part_grid, the voxel's edge, m, and the shape of a grid of at most `most` voxels around a part, along its
    largest planes; on each side there are `margin` times the part's extent, and `_PAD` voxels."""
    points = part.vertices[np.unique(part.faces)]
    centres, across = part.vertices[part.faces].mean(1), triangle_normals(part.vertices, part.faces)
    few = np.searchsorted(np.cumsum(part.areas()), part.areas().sum() * (np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    few = few.clip(max=len(part.faces) - 1)
    normals = across[few] / np.linalg.norm(across[few], axis=1, keepdims=True)
    axes = plane_axes(fit_planes(centres[few], normals, PLANE_TOLERANCE * bounding_diagonal(part)), points)
    along = points @ axes
    low, high = along.min(0), along.max(0)
    low, high = low - margin * (high - low), high + margin * (high - low)
    size = np.maximum(high - low, 1e-3 * np.max(high - low))
    voxel = float(np.prod(size) / most) ** (1 / 3)
    while np.prod(np.ceil(size / voxel) + 2 * _PAD + 1) > most:
        voxel *= 1.02
    shape = tuple(int(n) for n in np.ceil(size / voxel) + 2 * _PAD + 1)
    return se3.pose(axes, axes @ (low - _PAD * voxel)), voxel, (shape[0], shape[1], shape[2])


def _count_states(reconstruction: Reconstruction, other: Mesh, voxel: float) -> int:
    """States at which the other part is placed, so that it moves by at most a voxel between two."""
    joint, q = reconstruction.articulation.joint, reconstruction.states
    arm = 1.0
    if joint.type == "revolute":
        arm = float(np.linalg.norm(np.cross(joint.axis, other.vertices - joint.pivot), axis=1).max())
    return int(np.clip(np.ceil(np.ptp(q) * arm / voxel), 1, 1000)) + 1


def _sample(mesh: Mesh, spacing: float) -> tuple[Array, Array]:
    """(n, 3) points on the triangles of a mesh, one per cubic cell of side `spacing`, and outward normals (n, 3)."""
    across = triangle_normals(mesh.vertices, mesh.faces)
    across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    split = np.maximum(1, np.ceil(np.sqrt(2 * mesh.areas()) / (0.7 * spacing))).astype(np.int64)
    points, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for n in np.unique(split):
        i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
        u, v = ((i + 1 / 3) / n)[i + j < n], ((j + 1 / 3) / n)[i + j < n]
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces[split == n]], 1, 0)[:, :, None]
        points.append((a + u[:, None] * (b - a) + v[:, None] * (c - a)).reshape(-1, 3))
        normals.append(np.repeat(across[split == n], len(u), axis=0))
    every = np.concatenate(points)
    first = np.sort(np.unique(np.floor(every / spacing).astype(np.int64), axis=0, return_index=True)[1])
    return every[first], np.concatenate(normals)[first]


@njit(nogil=True, cache=True)
def _mark_swept(
    state: NDArray[np.uint8], sums: NDArray[np.float32], Ts: Array, points: Array, normals: Array, voxel: float
) -> None:  # pragma: no cover
    """Mark the voxels that contain a point (n, 3) moved by one of Ts (m, 4, 4), grid from the points' frame, and add
    its normal (n, 3), turned, to `sums` (X, Y, Z, 3)."""
    for k in range(len(Ts)):
        T = Ts[k]
        for i in range(len(points)):
            x, y, z = points[i]
            a = round((T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / voxel)
            b = round((T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / voxel)
            c = round((T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]) / voxel)
            if 0 <= a < state.shape[0] and 0 <= b < state.shape[1] and 0 <= c < state.shape[2]:
                state[a, b, c] = 2
                x, y, z = normals[i]
                for r in range(3):
                    sums[a, b, c, r] += T[r, 0] * x + T[r, 1] * y + T[r, 2] * z


def _count_looks(
    reconstruction: Reconstruction, name: str, recording: Recording, T: Array, voxel: float, shape: tuple[int, ...]
) -> NDArray[np.uint8]:
    """(X, Y, Z) in how many frames a voxel was looked through."""
    k = PARTS.index(name)
    Ts = (reconstruction.Ts_camera_reference, reconstruction.Ts_camera_moving)[k]
    frames = np.flatnonzero(reconstruction.seen[:, k])
    frames = (
        frames[np.unique(np.linspace(0, len(frames) - 1, MAX_FRAMES).round().astype(int))] if len(frames) else frames
    )
    part, K = reconstruction.articulation.part(name), recording.camera.K
    points = part.vertices[:: len(part.vertices) // 5000 + 1]
    near = _NEAR_SHARE * bounding_diagonal(part)
    counts = np.zeros(shape, np.uint8)
    for i in frames:
        frame = recording.frame(int(i))
        limit = _look_limits(frame.depth, frame.mask)
        error = _surface_error(points, Ts[i], K, frame.depth, near)
        _look_through(counts, Ts[i] @ T, voxel, limit, voxel + _SIGMAS * error, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    return counts


def _look_limits(depth: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(h, w) least depth in the 3 x 3 pixels around each, up to which all is empty: 0 where the object's depth is
    unknown, infinite where there is neither object nor anything before it."""
    import cv2

    limit = np.where(depth > 0, depth, np.where(mask, np.float32(0), np.float32(np.inf))).astype(np.float32)
    return np.asarray(cv2.erode(limit, np.ones((3, 3), np.uint8)), np.float32)


def _surface_error(points: Array, T: Array, K: Array, depth: NDArray[np.float32], near: float) -> float:
    """Standard deviation, m, of measured depth about the reconstructed surface points (n, 3) that a frame shows."""
    p = se3.transform(T, points)
    p = p[p[:, 2] > 0]
    u = np.floor(K[0, 0] * p[:, 0] / p[:, 2] + K[0, 2]).astype(int)
    v = np.floor(K[1, 1] * p[:, 1] / p[:, 2] + K[1, 2]).astype(int)
    within = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
    off = depth[v[within], u[within]] - p[within, 2]
    off = np.abs(off[np.abs(off) < near])
    return 1.4826 * float(np.median(off)) if len(off) else 0.0


@njit(nogil=True, cache=True)
def _look_through(
    counts: NDArray[np.uint8], T: Array, voxel: float, limit: NDArray[np.float32], margin: float,
    fx: float, fy: float, cx: float, cy: float,
) -> None:  # pragma: no cover  # fmt: skip
    """Count one for every voxel that lies more than `margin`, m, before the limit (h, w) of the pixel that it is in.

    T (4, 4) is the camera from the grid.
    """
    h, w = limit.shape
    for a in range(counts.shape[0]):
        for b in range(counts.shape[1]):
            x = T[0, 0] * a * voxel + T[0, 1] * b * voxel + T[0, 3]
            y = T[1, 0] * a * voxel + T[1, 1] * b * voxel + T[1, 3]
            z = T[2, 0] * a * voxel + T[2, 1] * b * voxel + T[2, 3]
            for c in range(counts.shape[2]):
                pz = z + T[2, 2] * c * voxel
                if pz <= 0 or counts[a, b, c] == 255:
                    continue
                u = int(np.floor(fx * (x + T[0, 2] * c * voxel) / pz + cx))
                v = int(np.floor(fy * (y + T[1, 2] * c * voxel) / pz + cy))
                if 0 <= u < w and 0 <= v < h and pz + margin < limit[v, u]:
                    counts[a, b, c] += 1
