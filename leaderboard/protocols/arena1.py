"""arena-1: the joint as a motion, limits included, by the metric of ArticulateArena (arXiv 2609.33931).

A joint is the unordered pair of its end twists {lower xi, upper xi}; the distance of two joints is that of their pairs
under the kinetic-energy norm of the true moving part, in metres. tests/test_arena1.py holds it to the package
`articulatearena`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import QhullError

from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Piece, Reconstruction
from freeart21.se3 import Array
from freeart21.truth import Truth
from leaderboard import metrics
from leaderboard.matching import match
from leaderboard.protocol import FRACTION, Case, Measured, Metric, Protocol, Scale, to_floats

TWIST, COMPACT_TWIST = Scale("m", "m", "down", None), Scale("1", "1", "down", None)
KAPPA = np.pi
"""Metres, the scale of the compact metric, as in their benchmark."""
LEAST_VOLUME = 1e-12
"""m^3; closed meshes of less volume are replaced by their convex hull."""


@dataclass(frozen=True)
class Solid:
    """The mass distribution of a rigid part."""

    mass: float
    """Volume times density 1: only ratios matter."""
    centre: Array
    """(3,) of mass, metres."""
    inertia: Array
    """(3, 3) about the centre of mass, positive definite."""

    def square(self, twist: Array) -> float:
        """Mean squared speed, m^2, of the part's points under `twist` (v, w) (6,): twice kinetic energy over mass."""
        v, w = twist[:3], twist[3:]
        at_centre = v + np.cross(w, self.centre)
        return float(w @ self.inertia @ w / self.mass + at_centre @ at_centre)


def measure(case: Case) -> Measured:
    """The metrics of arena-1; renders and asset are not used."""
    truth, lacks = case.truth, case.lacks
    matched = match(truth, case.answer, lacks)
    true, aligned = truth.articulation.joint, matched.answer
    states, joint = count_from_true_zero(truth, aligned, lacks)
    solid = solid_from_mesh(truth.articulation.moving)
    values: dict[str, float | None] = {
        "joint_type": float(joint.type == true.type),
        "twist_shown": joint_distance(true.spanning(truth.states), joint.spanning(states), solid),
        "twist_compact": joint_distance(true, joint, solid, KAPPA),
    }
    notes: tuple[str, ...] = ()
    if not has_limits(true):
        values["twist"] = None
    elif has_limits(joint):
        values["twist"] = joint_distance(true, joint, solid)
    else:
        notes = ("the joint has no limits, the true one has: no finite distance, twist is penalised",)
    return Measured(to_floats(values), matched.swapped, notes=notes)


def count_from_true_zero(truth: Truth, aligned: Reconstruction, lacks: tuple[Piece, ...] = ()) -> tuple[Array, Joint]:
    """States (n,) and joint of an aligned answer, its limits shifted as well, counted from the truth's state zero.

    A method chooses its own state zero: the offset of strict-2's `state` is removed. For another joint type, the states
    become zero in the frame in which the truth is nearest zero. Without states, the answer's zero is its anchor frame.
    """
    true, joint, states = truth.articulation.joint, aligned.articulation.joint, aligned.states
    sign = 1.0 if true.axis @ joint.axis >= 0 else -1.0
    if "states" in lacks:
        shift = sign * truth.states[aligned.anchor] if joint.type == true.type else 0.0
    elif joint.type != true.type:
        shift = -states[int(np.argmin(np.abs(truth.states)))]
    else:
        shift = -sign * metrics.state_offset(truth.states, states, sign, true.type == "revolute")
    moved = Joint(joint.name, joint.type, joint.axis, joint.pivot, joint.lower + shift, joint.upper + shift)
    return states + shift, moved


def has_limits(joint: Joint) -> bool:
    """Whether the joint has both limits."""
    return bool(np.isfinite([joint.lower, joint.upper]).all())


def solid_from_mesh(mesh: Mesh) -> Solid:
    """`mesh` as a body of uniform density: its interior if closed, else its convex hull.

    A flat mesh, which the original cannot handle, is a sheet of uniform mass.
    """
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    if not (body.is_watertight and body.volume > LEAST_VOLUME):
        try:
            body = body.convex_hull
        except QhullError:
            return _sheet(mesh)
        with np.errstate(invalid="ignore"):  # trimesh divides by the zero volume
            if not body.volume > LEAST_VOLUME:
                return _sheet(mesh)
    inertia = 0.5 * (body.moment_inertia + body.moment_inertia.T)
    least = float(np.linalg.eigvalsh(inertia)[0])
    if least <= 0:
        inertia = inertia + (1e-9 - least) * np.eye(3)
    return Solid(float(body.mass), np.array(body.center_mass, float), inertia)


def _sheet(mesh: Mesh) -> Solid:
    """The triangles of `mesh` as a thin sheet of 1 kg/m^2."""
    corners, areas = mesh.vertices[mesh.faces], mesh.areas()
    centre = np.average(corners.mean(1), axis=0, weights=areas)
    from_centre = corners - centre
    sums = from_centre.sum(1)  # a triangle's second moment is A/12 (sum of v v' + sum v sum v')
    moment = np.einsum("f,fki,fkj->ij", areas, from_centre, from_centre) + np.einsum("f,fi,fj->ij", areas, sums, sums)
    return Solid(float(areas.sum()), centre, (np.trace(moment) * np.eye(3) - moment) / 12)


def end_twists(joint: Joint, solid: Solid, kappa: float | None = None) -> tuple[Array, Array]:
    """The end twists (v, w) (6,) of a joint, lower and upper; with `kappa` mapped into the unit ball of the norm.

    An infinite limit is mapped to the unit twist in its direction.
    """
    if kappa is None:
        return joint.lower * joint.screw, joint.upper * joint.screw
    size = np.sqrt(solid.square(joint.screw))
    lower, upper = (np.tanh(limit * size / kappa) / size * joint.screw for limit in (joint.lower, joint.upper))
    return lower, upper


def joint_distance(true: Joint, joint: Joint, solid: Solid, kappa: float | None = None) -> float:
    """Distance of two joints in one frame: metres, or without unit in [0, 2 sqrt 2] when mapped with `kappa`."""
    return pair_distance(end_twists(true, solid, kappa), end_twists(joint, solid, kappa), solid.square)


def pair_distance(a: tuple[Array, Array], b: tuple[Array, Array], square: Callable[[Array], float]) -> float:
    """Root of the smaller sum of squares over the two pairings of the ends of `a` with those of `b`."""
    straight = square(a[0] - b[0]) + square(a[1] - b[1])
    crossed = square(a[0] - b[1]) + square(a[1] - b[0])
    return float(np.sqrt(min(straight, crossed)))


def still_distance(joint: Joint, solid: Solid, kappa: float | None = None) -> float:
    """Distance of a joint to one that does not move: the tree distance's cost of a missing joint."""
    nothing = np.zeros(6), np.zeros(6)
    return pair_distance(end_twists(joint, solid, kappa), nothing, solid.square)


def penalties(truth: Truth) -> dict[str, float | None]:
    """The distance of the true joint to one that does not move."""
    joint, solid = truth.articulation.joint, solid_from_mesh(truth.articulation.moving)
    return {
        "twist": still_distance(joint, solid) if has_limits(joint) else None,
        "twist_shown": still_distance(joint.spanning(truth.states), solid),
        "twist_compact": still_distance(joint, solid, KAPPA),
    }


_NOTHING = "what a joint that does not move costs"
_METRIC = (
    "sqrt of the smaller of |a1-b1|^2 + |a2-b2|^2 and |a1-b2|^2 + |a2-b1|^2 for the end twists (limit times unit "
    "screw) of the two joints, under the kinetic-energy norm, divided by the mass, of the true moving part as a solid "
    "of uniform density "
)

ARENA_1 = Protocol(
    "arena-1",
    "The joint as a motion, by the metric E of ArticulateArena (arXiv 2609.33931): one true metric for type, axis, "
    "place and limits, blind to the axis's sign and to where the pivot lies along it. Parts are matched and poses "
    "aligned as by strict-2; positions are counted from the truth's state zero, the prediction's offset taken off as "
    "strict-2's `state` does. The joint is measured from the asset, reloaded and driven in SAPIEN, with its own "
    "limits; without an asset, read from the files and marked so. A failure or a missing sequence costs what their "
    "tree distance charges for a joint that is not found: its distance to a joint that does not move. That is no cap: "
    "a joint that moves the part elsewhere may be further from the truth than none. Means and sample standard "
    "deviations (ddof 1) are over all sequences of a joint type.",
    (
        Metric(
            "joint_type",
            *FRACTION,
            "1 when the joint's type is right, else 0; the metric itself knows no types",
            label="joint type",
            needs=("joint",),
        ),
        Metric(
            "twist",
            *TWIST,
            f"{_METRIC}(its convex hull where the mesh is not closed), at state zero; none where the true joint has no "
            "limits",
            label="joint as a motion (E)",
            column="E",
            penalty_source=_NOTHING,
            needs=("joint",),
        ),
        Metric(
            "twist_shown",
            *TWIST,
            "the same with the smallest and largest state in the video as the limits of both: what the joint is, "
            "whatever its stated limits",
            label="joint as a motion, over the states of the video",
            column="E\nshown",
            needs=("joint", "states"),
            penalty_source=_NOTHING,
        ),
        Metric(
            "twist_compact",
            *COMPACT_TWIST,
            "the same as twist with each end u replaced by tanh(|u| / pi m) u / |u|, which joints without limits have, "
            "too",
            label="joint as a motion, compact (E phi)",
            column="E phi",
            penalty_source=_NOTHING,
            needs=("joint",),
        ),
    ),
    measure,
    asset="joint",
    sequence_penalties=penalties,
)
