"""Links and joints as plain numbers, whichever format they were written in, and what follows from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21.files.urdf import Urdf, UrdfInertial, resolve_mimics
from freeart21.joint import Joint, JointType
from freeart21.se3 import Array


@dataclass(frozen=True)
class TreeJoint:
    """A joint, or a rigid connection, between two links."""

    name: str
    kind: JointType | None
    """None when it does not move."""
    parent: str
    child: str
    T_parent_child: Array
    """(4, 4) the child's frame in the parent's at position zero."""
    axis: Array
    """(3,) unit vector in the child's frame."""
    pivot: Array
    """(3,) a point of the axis in the child's frame, m."""
    lower: float
    upper: float
    """rad or m, infinite where the file gives no limit."""
    damping: float = 0.0
    friction: float = 0.0
    mimic: tuple[str, float, float] | None = None
    """The joint that it follows, multiplier and offset."""
    stated: bool = True
    """Whether the file says how far it goes, be it without end."""

    def transform(self, q: float | Array) -> Array:
        """(..., 4, 4) the child's frame in the parent's at position(s) `q` (...)."""
        if self.kind is None:
            return self.T_parent_child
        motion = Joint(self.name, self.kind, self.axis, self.pivot, -np.inf, np.inf).transform(q)
        return np.asarray(self.T_parent_child @ motion)

    @property
    def ordered(self) -> bool:
        """Whether the file leaves it a range."""
        return self.stated and self.lower < self.upper

    @property
    def sweep(self) -> tuple[float, float]:
        """The limits or, where it has none, a turn to and fro or half a metre; twice zero where nothing is left."""
        if not self.ordered:
            return 0.0, 0.0
        end = np.pi if self.kind == "revolute" else 0.5
        lower, upper = self.lower, self.upper
        if np.isinf(lower) and np.isinf(upper):
            return -end, end
        return (upper - end if np.isinf(lower) else lower), (lower + end if np.isinf(upper) else upper)

    @property
    def loaded(self) -> float:
        """The position at which a simulator should load it: zero, or the limit nearest to it."""
        return float(np.clip(0.0, self.lower, self.upper)) if self.ordered else 0.0


@dataclass(frozen=True)
class Tree:
    """Links that hang on one root."""

    root: str
    links: tuple[str, ...]
    joints: dict[str, TreeJoint]
    """Name to joint, parents before children."""
    inertials: dict[str, UrdfInertial]
    """Of the links of which the file gives them."""

    @property
    def nailed(self) -> bool:
        """Whether the root is the world itself, as URDFs say a base that does not move."""
        return self.root == "world"

    @property
    def movable(self) -> tuple[TreeJoint, ...]:
        """The joints that move on their own."""
        return tuple(j for j in self.joints.values() if j.kind is not None and j.mimic is None)

    def rigid_groups(self) -> dict[str, tuple[str, Array]]:
        """Link name to the first link that it is welded to, and T (4, 4) from the link's frame to that one's."""
        groups = {self.root: (self.root, np.eye(4))}
        for joint in self.joints.values():
            top, T = groups[joint.parent]
            welded = joint.kind is None
            groups[joint.child] = (top, T @ joint.T_parent_child) if welded else (joint.child, np.eye(4))
        return groups

    def complete(self, q: Mapping[str, float]) -> dict[str, float]:
        """Positions of all joints that move: `q`, and what follows it."""
        return resolve_mimics(self.joints, q)

    def link_poses(self, q: Mapping[str, float | Array]) -> dict[str, Array]:
        """Link name to T_root_link (..., 4, 4) at joint positions `q`, rad or m, each a number or an array (...) of one
        shape; joints that are not named stand at zero. A link that only numbers place has one pose (4, 4)."""
        Ts = {self.root: np.eye(4)}
        for joint in self.joints.values():
            Ts[joint.child] = Ts[joint.parent] @ joint.transform(q.get(joint.name, 0.0))
        return Ts

    def jacobians(self, q: Mapping[str, float], inertials: Mapping[str, UrdfInertial]) -> dict[str, NDArray]:
        """Link name to (6, n): velocity of its centre of mass and angular velocity, in the root's frame, per velocity
        of each of the n `movable` joints."""
        Ts, names = self.link_poses(q), [joint.name for joint in self.movable]
        columns: dict[str, NDArray] = {self.root: np.zeros((6, len(names)))}  # of the link's origin
        for joint in self.joints.values():
            T, J = Ts[joint.child], columns[joint.parent].copy()
            J[:3] += np.cross(J[3:], T[:3, 3] - Ts[joint.parent][:3, 3], axis=0) if len(names) else 0.0
            if joint.name in names:
                k, axis = names.index(joint.name), T[:3, :3] @ joint.axis
                if joint.kind == "prismatic":
                    J[:3, k] = axis
                else:
                    pivot = T[:3, :3] @ joint.pivot
                    J[:3, k], J[3:, k] = np.cross(axis, -pivot), axis
            columns[joint.child] = J
        out = {}
        for name, J in columns.items():
            centre = inertials[name].centre if name in inertials else np.zeros(3)
            arm = Ts[name][:3, :3] @ centre
            out[name] = np.concatenate([J[:3] + np.cross(J[3:].T, arm).T, J[3:]])
        return out

    def mass_matrix(self, q: Mapping[str, float], inertials: Mapping[str, UrdfInertial]) -> NDArray:
        """(n, n) of the movable joints, the root nailed down."""
        Ts, total = self.link_poses(q), np.zeros((len(self.movable),) * 2)
        for name, J in self.jacobians(q, inertials).items():
            if name in inertials:
                body, R = inertials[name], Ts[name][:3, :3]
                total += body.mass * J[:3].T @ J[:3] + J[3:].T @ R @ body.inertia @ R.T @ J[3:]
        return total

    def height_energy(self, q: Mapping[str, float], inertials: Mapping[str, UrdfInertial], gravity: float) -> float:
        """Potential energy, J, with the root's z upwards."""
        Ts = self.link_poses(q)
        return float(sum(gravity * b.mass * (Ts[n] @ [*b.centre, 1.0])[2] for n, b in inertials.items() if n in Ts))


def hold_followers(tree: Tree) -> Tree:
    """The tree with joints that mimic others held where these ask, all as loaded: not every engine obeys a mimic."""
    full = tree.complete({joint.name: joint.loaded for joint in tree.movable})
    joints = {
        name: joint if joint.mimic is None else replace(joint, kind=None, T_parent_child=joint.transform(full[name]))
        for name, joint in tree.joints.items()
    }
    return replace(tree, joints={name: replace(joint, mimic=None) for name, joint in joints.items()})


def tree_of_urdf(urdf: Urdf) -> Tree:
    """The tree of a URDF; FreeArtError when it has several roots."""
    place = {name: i for i, name in enumerate(urdf.parents_first)}
    joints = {
        j.name: TreeJoint(
            j.name,
            j.joint_type,
            j.parent,
            j.child,
            j.T_parent_joint,
            j.axis,
            np.zeros(3),
            j.lower,
            j.upper,
            j.damping,
            j.friction,
            j.mimic,
            j.limited or j.type == "continuous",
        )
        for j in sorted(urdf.joints.values(), key=lambda joint: place[joint.child])
    }
    low = resolve_mimics(joints, {j.name: j.lower for j in joints.values()})
    high = resolve_mimics(joints, {j.name: j.upper for j in joints.values()})
    for name, joint in joints.items():
        if joint.mimic is not None:  # it goes as far as its leader takes it
            joints[name] = replace(joint, lower=min(low[name], high[name]), upper=max(low[name], high[name]))
    inertials = {name: link.inertial for name, link in urdf.links.items() if link.inertial is not None}
    return Tree(urdf.root, tuple(urdf.links), joints, inertials)
