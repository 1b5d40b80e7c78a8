"""Poses in which an object rests on a plane while its joint is free, and the most likely one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.mesh import Mesh, bounding_diagonal, triangle_normals

STATES = 17
"""Joint states per range. Between two of them a point of a half turn deviates by 0.5 % of its arm."""
FACET_ANGLE = np.radians(5.0)
"""Hull facets within this angle are one face to stand on: noise splits a face into many."""
GROUND_SHARE = 0.01
"""Fraction of the object's diagonal within which points touch the plane: reconstructed bases are not flat."""
MIN_TIPPING = np.radians(5.0)
"""An object that tips over when leant by less does not stand. Of the 21 procedural objects upright phones and scissors
tip at 0 to 5 degrees, lighters, which do stand, at 7 to 9."""
CONCENTRATION = 4.0
"""Of the first frame's camera direction about up (von Mises-Fisher): 40 degrees RMS. It was 24 in 21 made recordings;
people turn what they hold by more."""


@dataclass(frozen=True)
class RestingPose:
    """A pose in which the object stands on a plane."""

    up: NDArray[np.float64]
    """(3,) unit normal of the plane, canonical frame."""
    tipping: float
    """rad that it may lean in any direction before it tips over, at joint state `zero`."""
    mean: float
    """The same, averaged over the joint's range."""
    worst: float
    """The same at the worst joint state; negative when it tips over by itself."""
    support: str
    """What touches the plane: 'reference', 'moving', or 'both'."""


def resting_poses(object_: Articulation, low: float, high: float, zero: float) -> list[RestingPose]:
    """Poses in which an object rests on a plane at joint state `zero`, rad or m, and its joint is free to move.

    One part stands on the plane while the other moves over the range [low, high]. The plane is a facet of the convex
    hull of everything the parts sweep, in the standing part's frame, so nothing goes below it. The centre of mass lies
    over the support. Masses are proportional to volumes when both meshes are closed, else to areas.
    """
    states = np.append(zero, np.linspace(low, high, STATES))
    own, other = (_hull_corners(object_.part(name).vertices[np.unique(object_.part(name).faces)]) for name in PARTS)
    motion = object_.joint.transform(states)
    back = motion[0] @ se3.inverse(motion)  # in the moving part's frame at `zero`
    swept = se3.transform(motion, np.broadcast_to(other, (len(states), *other.shape)))
    swung = se3.transform(back, np.broadcast_to(own, (len(states), *own.shape)))
    centres = centres_of_mass(object_, states)
    ways = {
        "reference": (own, swept, centres),
        "moving": (swept[0], swung, se3.transform(back, centres[:, None])[:, 0]),
    }
    near = GROUND_SHARE * bounding_diagonal(object_.reference, object_.moving)
    found = []
    for carrier, (standing, moving, centre) in ways.items():
        for up in _support_planes(np.concatenate([standing, moving.reshape(-1, 3)])):
            level = min((standing @ up).min(), (moving @ up).min())
            alone = standing[standing @ up < level + near]
            support = [np.concatenate([alone, there[there @ up < level + near]]) for there in moving]
            by_itself = _tipping_angle(alone, centre[0], up, level)
            angles = [
                _tipping_angle(alone if by_itself > 0 else s, c, up, level)
                for s, c in zip(support, centre, strict=True)
            ]
            if angles[0] > 0 and len(alone):
                found.append(
                    RestingPose(
                        up, angles[0], float(np.mean(angles[1:])), min(angles), carrier if by_itself > 0 else "both"
                    )
                )
    return sorted(found, key=lambda pose: -pose.tipping)


def centres_of_mass(object_: Articulation, states: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) centre of mass of both parts at joint states (n,), canonical frame."""
    solids = [_volume_and_centre(object_.reference), _volume_and_centre(object_.moving)]
    if all(solid is not None for solid in solids):
        masses = [solid for solid in solids if solid is not None]
    else:
        masses = [_area_and_centre(object_.reference), _area_and_centre(object_.moving)]
    (m0, c0), (m1, c1) = masses
    moved = se3.transform(object_.joint.transform(states), np.broadcast_to(c1, (len(states), 1, 3)))[:, 0]
    centres: NDArray[np.float64] = (m0 * c0 + m1 * moved) / (m0 + m1)
    return centres


def choose_upright(poses: Sequence[RestingPose], prior: NDArray[np.float64]) -> tuple[RestingPose, float] | None:
    """The most likely pose and its probability; None when the object stands in no pose.

    A pose weighs as its stability (`mean`; below `MIN_TIPPING` it does not count) times the likelihood
    exp(CONCENTRATION cos(angle)) of a camera whose own up is `prior` (3,). The latter decides between a box and the box
    upside down: people film objects upright.
    """
    standing = [pose for pose in poses if pose.tipping >= MIN_TIPPING and pose.mean > 0]
    if not standing:
        return None
    weights = np.array([pose.mean * np.exp(CONCENTRATION * (pose.up @ prior - 1)) for pose in standing])
    best = int(np.argmax(weights))
    return standing[best], float(weights[best] / weights.sum())


def find_support(object_: Articulation, zero: float, up: NDArray[np.float64]) -> str:
    """What touches a plane under the object at joint state `zero`: 'reference', 'moving', or 'both'."""
    heights = [(mesh.vertices[np.unique(mesh.faces)] @ up).min() for mesh in object_.posed(np.eye(4), zero)]
    near = min(heights) + GROUND_SHARE * bounding_diagonal(object_.reference, object_.moving)
    touching = [name for name, height in zip(PARTS, heights, strict=True) if height < near]
    return touching[0] if len(touching) == 1 else "both"


def settle(object_: Articulation, zero: float, up: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """(3,) up direction in which the object comes to rest when released at joint state `zero` with `up` (3,) up; None
    if flat.

    It rolls over edges of the convex hull of both parts while its centre of mass lies beyond one. For a noisy base the
    mean facet of `resting_poses` is no pose to stand in, while this one is; for a flat base they agree.
    """
    points = np.concatenate([mesh.vertices[np.unique(mesh.faces)] for mesh in object_.posed(np.eye(4), zero)])
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    centre = centres_of_mass(object_, np.array([zero]))[0]
    outward, offset = hull.equations[:, :3], hull.equations[:, 3]
    heights = -(outward @ centre + offset)  # of the centre over each facet
    steep = -(outward @ up)
    facet = int(np.argmin(np.where(steep > 1e-9, heights / np.maximum(steep, 1e-9), np.inf)))  # right below the centre
    for _ in range(len(heights)):
        around = hull.neighbors[facet]
        corners = points[hull.simplices[facet]]  # neighbour k shares the edge opposite corner k
        foot = centre + heights[facet] * outward[facet]
        beyond = [_distance_beyond_edge(foot, corners, k, outward[facet]) for k in range(3)]
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 0:
            break
        facet = int(around[worst])
    return np.asarray(-outward[facet])


def _distance_beyond_edge(
    foot: NDArray[np.float64], corners: NDArray[np.float64], k: int, normal: NDArray[np.float64]
) -> float:
    """m by which a point in the plane of a triangle lies beyond its edge opposite corner `k`; negative inside."""
    start, end = corners[(k + 1) % 3], corners[(k + 2) % 3]
    across = np.cross(end - start, normal)
    across /= max(float(np.linalg.norm(across)), 1e-15)
    outwards = across if across @ (corners[k] - start) < 0 else -across
    return float(outwards @ (foot - start))


def _hull_corners(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points (n, 3) that are vertices of their convex hull; all when they are coplanar."""
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        return points


def _support_planes(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Unit inward normals of the hull of points (n, 3); facets within `FACET_ANGLE` are merged."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return []
    area = 0.5 * np.linalg.norm(triangle_normals(points, hull.simplices), axis=1)
    outward = hull.equations[:, :3]
    unused, planes = area > 0, []
    while unused.any():
        mean = outward[np.argmax(np.where(unused, area, 0.0))]
        for _ in range(3):
            near = unused & (outward @ mean > np.cos(FACET_ANGLE))
            if not near.any():
                break
            mean = area[near] @ outward[near]
            mean = mean / np.linalg.norm(mean)
        planes.append(-mean)
        unused &= ~near
        unused[np.argmax(np.where(unused, outward @ mean, -2.0))] &= bool(near.any())
    return planes


def _tipping_angle(
    support: NDArray[np.float64], centre: NDArray[np.float64], up: NDArray[np.float64], level: float
) -> float:
    """rad that a body may lean before its centre of mass leaves its support; negative when it is already outside."""
    across = np.linalg.svd(up[None])[2][1:]
    points = support @ across.T
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return -1.0
    margin = -float((hull.equations[:, :2] @ (across @ centre) + hull.equations[:, 2]).max())
    return float(np.arctan2(margin, max(float(centre @ up) - level, 1e-12)))


def _volume_and_centre(mesh: Mesh) -> tuple[float, NDArray[np.float64]] | None:
    """Volume, m^3, and centroid; None when the mesh is not closed."""
    import trimesh

    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    if not solid.is_volume or not solid.volume > 0:
        return None
    return float(solid.volume), np.asarray(solid.center_mass, float)


def _area_and_centre(mesh: Mesh) -> tuple[float, NDArray[np.float64]]:
    """Area, m^2, and centroid."""
    area = mesh.areas()
    return float(area.sum()), np.average(mesh.vertices[mesh.faces].mean(1), axis=0, weights=area)
