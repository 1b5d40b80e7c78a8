"""How an object stands: the poses in which it rests on a plane and its joint is free, and which of them is up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.mesh import Mesh, bounding_diagonal

STATES = 17
"""States at which the motion is looked at: between two of them a point of a half turn strays by 0.5 % of its arm."""
FLAT = np.radians(5.0)
"""Facets of the hull within this angle of each other are one face to stand on: noise makes many of one."""
TOUCHING = 0.01
"""Part of the object's diagonal: reference points within it of the plane carry. Reconstructed bases are not flat."""
STANDS = np.radians(5.0)
"""What tips over when it leans by less does not stand. The upright phones and scissors of the 21 procedural objects tip
at 0 to 5 degrees, their lighters, which do stand, at 7 to 9."""
CONCENTRATION = 4.0
"""Of the first frame's camera about up (von Mises and Fisher): 40 degrees root mean square. In 21 made recordings it
was 24; people turn what they hold by more."""


@dataclass(frozen=True)
class RestingPose:
    """A way to stand on a plane."""

    up: NDArray[np.float64]
    """(3,) unit, away from the plane, canonical frame."""
    tipping: float
    """Radians by which it may lean to any side before it tips over, at joint state `zero`."""
    mean: float
    """The same, the mean over the joint's range."""
    worst: float
    """The same at the joint's worst state; negative when it tips over by itself there."""
    carrier: str
    """What touches the plane: 'reference', 'moving', or 'both'."""


def resting_poses(object_: Articulation, low: float, high: float, zero: float) -> list[RestingPose]:
    """The poses in which an object rests on a plane at joint state `zero`, rad or m, and its joint is free to move.

    One part stands on the plane and the other moves over the range [low, high]: the plane is a facet of the convex
    hull of all that the parts sweep, as the standing part has it, so that nothing goes below. The centre of mass is
    over what touches the plane. Mass is that of the meshes' volumes when both are closed, else of their areas, as of
    shells.
    """
    states = np.append(zero, np.linspace(low, high, STATES))
    own, other = (_corners(object_.part(name).vertices[np.unique(object_.part(name).faces)]) for name in PARTS)
    motion = object_.joint.transform(states)
    back = motion[0] @ se3.inverse(motion)  # as the moving part has it, where it stands at `zero`
    swept = se3.transform(motion, np.broadcast_to(other, (len(states), *other.shape)))
    swung = se3.transform(back, np.broadcast_to(own, (len(states), *own.shape)))
    centres = centres_of_mass(object_, states)
    ways = {
        "reference": (own, swept, centres),
        "moving": (swept[0], swung, se3.transform(back, centres[:, None])[:, 0]),
    }
    near = TOUCHING * bounding_diagonal(object_.reference, object_.moving)
    found = []
    for carrier, (standing, moving, centre) in ways.items():
        for up in _planes(np.concatenate([standing, moving.reshape(-1, 3)])):
            level = min((standing @ up).min(), (moving @ up).min())
            alone = standing[standing @ up < level + near]
            support = [np.concatenate([alone, there[there @ up < level + near]]) for there in moving]
            by_itself = _tipping(alone, centre[0], up, level)
            angles = [
                _tipping(alone if by_itself > 0 else s, c, up, level) for s, c in zip(support, centre, strict=True)
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
    solids = [_solid(object_.reference), _solid(object_.moving)]
    if all(solid is not None for solid in solids):
        masses = [solid for solid in solids if solid is not None]
    else:
        masses = [_shell(object_.reference), _shell(object_.moving)]
    (m0, c0), (m1, c1) = masses
    moved = se3.transform(object_.joint.transform(states), np.broadcast_to(c1, (len(states), 1, 3)))[:, 0]
    centres: NDArray[np.float64] = (m0 * c0 + m1 * moved) / (m0 + m1)
    return centres


def upright(poses: Sequence[RestingPose], prior: NDArray[np.float64]) -> tuple[RestingPose, float] | None:
    """The likeliest way up and its share among all, 0 to 1; None when the object stands in no pose.

    How stable a pose is (`mean`; those below `STANDS` do not count), times how likely a camera whose own up is `prior`
    (3,) is to look at it so: exp(CONCENTRATION cos(angle)). Of two poses alike, such as a box and the box upside down,
    people film the one that they call upright.
    """
    standing = [pose for pose in poses if pose.tipping >= STANDS and pose.mean > 0]
    if not standing:
        return None
    weights = np.array([pose.mean * np.exp(CONCENTRATION * (pose.up @ prior - 1)) for pose in standing])
    best = int(np.argmax(weights))
    return standing[best], float(weights[best] / weights.sum())


def carrier_of(object_: Articulation, zero: float, up: NDArray[np.float64]) -> str:
    """What touches a plane under the object at joint state `zero`: 'reference', 'moving', or 'both'."""
    heights = [(mesh.vertices[np.unique(mesh.faces)] @ up).min() for mesh in object_.posed(np.eye(4), zero)]
    near = min(heights) + TOUCHING * bounding_diagonal(object_.reference, object_.moving)
    touching = [name for name, height in zip(PARTS, heights, strict=True) if height < near]
    return touching[0] if len(touching) == 1 else "both"


def settled(object_: Articulation, zero: float, up: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """(3,) up as the object comes to rest, let go at joint state `zero` with the direction `up` (3,) up; None if flat.

    It rolls over the edges of the hull of both parts for as long as its centre of mass is beyond one. The mean facet
    under a noisy base is none that it can stand on; this one is, and for a flat base they are the same.
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
    facet = int(np.argmin(np.where(steep > 1e-9, heights / np.maximum(steep, 1e-9), np.inf)))  # that is right below
    for _ in range(len(heights)):
        around = hull.neighbors[facet]
        corners = points[hull.simplices[facet]]  # neighbour k shares the edge that lies opposite corner k
        foot = centre + heights[facet] * outward[facet]
        beyond = [_beyond(foot, corners, k, outward[facet]) for k in range(3)]
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 0:
            break
        facet = int(around[worst])
    return np.asarray(-outward[facet])


def _beyond(foot: NDArray[np.float64], corners: NDArray[np.float64], k: int, normal: NDArray[np.float64]) -> float:
    """m by which a point in the plane of a triangle lies beyond its edge opposite corner `k`; negative before it."""
    start, end = corners[(k + 1) % 3], corners[(k + 2) % 3]
    across = np.cross(end - start, normal)
    across /= max(float(np.linalg.norm(across)), 1e-15)
    outwards = across if across @ (corners[k] - start) < 0 else -across
    return float(outwards @ (foot - start))


def _corners(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points (n, 3) that are corners of their convex hull; all when they lie in a plane."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return points


def _planes(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Unit inward normals of the faces of the hull of points (n, 3), facets within `FLAT` of each other as one."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return []
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    outward = hull.equations[:, :3]
    left, planes = area > 0, []
    while left.any():
        mean = outward[np.argmax(np.where(left, area, 0.0))]
        for _ in range(3):
            near = left & (outward @ mean > np.cos(FLAT))
            if not near.any():
                break
            mean = area[near] @ outward[near]
            mean = mean / np.linalg.norm(mean)
        planes.append(-mean)
        left &= ~near
        left[np.argmax(np.where(left, outward @ mean, -2.0))] &= bool(near.any())
    return planes


def _tipping(support: NDArray[np.float64], centre: NDArray[np.float64], up: NDArray[np.float64], level: float) -> float:
    """Radians that a body may lean before its centre of mass leaves what supports it; negative when it is outside."""
    across = np.linalg.svd(up[None])[2][1:]
    points = support @ across.T
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return -1.0
    margin = -float((hull.equations[:, :2] @ (across @ centre) + hull.equations[:, 2]).max())
    return float(np.arctan2(margin, max(float(centre @ up) - level, 1e-12)))


def _solid(mesh: Mesh) -> tuple[float, NDArray[np.float64]] | None:
    """Volume, m^3, and its centre; None when the mesh is not closed."""
    import trimesh

    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    if not solid.is_volume or not solid.volume > 0:
        return None
    return float(solid.volume), np.asarray(solid.center_mass, float)


def _shell(mesh: Mesh) -> tuple[float, NDArray[np.float64]]:
    """Area, m^2, and its centre."""
    area = mesh.areas()
    return float(area.sum()), np.average(mesh.vertices[mesh.faces].mean(1), axis=0, weights=area)
