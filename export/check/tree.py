"""Links and joints as numbers, independent of the file format; kinematics and dynamics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from freeart21.files.urdf import Urdf, UrdfInertial, UrdfJoint, resolve_mimics
from freeart21.se3 import Array


@dataclass(frozen=True)
class Tree:
    """Links below one root."""

    root: str
    links: tuple[str, ...]
    joints: dict[str, UrdfJoint]
    """Name to joint, parents first."""
    inertials: dict[str, UrdfInertial]
    """Of the links for which the file has them."""

    @property
    def fixed_base(self) -> bool:
        """Whether the root is the world itself, as in URDFs with a fixed base."""
        return self.root == "world"

    @property
    def movable(self) -> tuple[UrdfJoint, ...]:
        """The joints that move on their own."""
        return tuple(j for j in self.joints.values() if j.joint_type is not None and j.mimic is None)

    def rigid_groups(self) -> dict[str, tuple[str, Array]]:
        """Link name to the first link that it is welded to, and T (4, 4) from the link's frame to that one's."""
        groups = {self.root: (self.root, np.eye(4))}
        for joint in self.joints.values():
            top, T = groups[joint.parent]
            welded = joint.joint_type is None
            groups[joint.child] = (top, T @ joint.T_parent_joint) if welded else (joint.child, np.eye(4))
        return groups

    def complete(self, q: Mapping[str, float]) -> dict[str, float]:
        """Positions of all joints that move: `q`, and its mimics."""
        return resolve_mimics(self.joints, q)

    def link_poses(self, q: Mapping[str, float | Array]) -> dict[str, Array]:
        """Link name to T_root_link (..., 4, 4) at joint positions `q`, rad or m, numbers or arrays (...) of one shape;
        joints missing in `q` are at zero. Links placed by numbers only have one pose (4, 4)."""
        Ts = {self.root: np.eye(4)}
        for joint in self.joints.values():
            Ts[joint.child] = Ts[joint.parent] @ joint.transform(q.get(joint.name, 0.0))
        return Ts

    def jacobians(self, q: Mapping[str, float], inertials: Mapping[str, UrdfInertial]) -> dict[str, Array]:
        """Link name to (6, n): velocity of its centre of mass and angular velocity, root's frame, per velocity of the
        `movable` joints."""
        Ts, names = self.link_poses(q), [joint.name for joint in self.movable]
        columns: dict[str, Array] = {self.root: np.zeros((6, len(names)))}  # of the link's origin
        for joint in self.joints.values():
            T, J = Ts[joint.child], columns[joint.parent].copy()
            J[:3] += np.cross(J[3:], T[:3, 3] - Ts[joint.parent][:3, 3], axis=0) if len(names) else 0.0
            if joint.name in names:
                k, axis = names.index(joint.name), T[:3, :3] @ joint.axis
                if joint.joint_type == "prismatic":
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

    def mass_matrix(self, q: Mapping[str, float], inertials: Mapping[str, UrdfInertial]) -> Array:
        """(n, n) of the movable joints, with the root fixed."""
        Ts, total = self.link_poses(q), np.zeros((len(self.movable),) * 2)
        for name, J in self.jacobians(q, inertials).items():
            if name in inertials:
                body, R = inertials[name], Ts[name][:3, :3]
                total += body.mass * J[:3].T @ J[:3] + J[3:].T @ R @ body.inertia @ R.T @ J[3:]
        return total

    def height_energy(self, q: Mapping[str, float], inertials: Mapping[str, UrdfInertial], gravity: float) -> float:
        """Potential energy, J, with the root's z up."""
        Ts = self.link_poses(q)
        return float(sum(gravity * b.mass * (Ts[n] @ [*b.centre, 1.0])[2] for n, b in inertials.items() if n in Ts))


def freeze_mimics(tree: Tree) -> Tree:
    """The tree with mimic joints fixed at their position as loaded: not every engine supports mimics."""
    full = tree.complete({joint.name: joint.loaded for joint in tree.movable})
    joints = {
        name: joint
        if joint.mimic is None
        else replace(joint, type="fixed", mimic=None, T_parent_joint=joint.transform(full[name]))
        for name, joint in tree.joints.items()
    }
    return replace(tree, joints=joints)


def build_tree(urdf: Urdf) -> Tree:
    """The tree of a URDF; FreeArtError when it has several roots."""
    place = {name: i for i, name in enumerate(urdf.parents_first)}
    joints = {j.name: j for j in sorted(urdf.joints.values(), key=lambda joint: place[joint.child])}
    low = resolve_mimics(joints, {j.name: j.lower for j in joints.values()})
    high = resolve_mimics(joints, {j.name: j.upper for j in joints.values()})
    for name, joint in joints.items():
        if joint.mimic is not None:  # its range follows from its leader's
            joints[name] = replace(joint, lower=min(low[name], high[name]), upper=max(low[name], high[name]))
    inertials = {name: link.inertial for name, link in urdf.links.items() if link.inertial is not None}
    return Tree(urdf.root, tuple(urdf.links), joints, inertials)
