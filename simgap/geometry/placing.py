"""A measured set and an asset in one frame: gravity and part poses are given in the reference part's frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.files.asset import find_movable_joint
from freeart21.measured import Run
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array
from generator import simulate
from simgap.geometry.pose_model import Track


@dataclass(frozen=True)
class PlacedAsset:
    """An asset under the gravity of a measured set; its root link's frame is the world."""

    gravity: Array
    """(3,) m/s^2 in the world frame of `generator.simulate`."""
    mechanics: JointMechanics
    """In the frame of the joint's parent link."""
    T_parent_canonical: Array
    """(4, 4) pose of the canonical frame, with the moving part at canonical state zero."""
    state_zero: float
    child_moves: bool
    """False when the moving part is on the joint's parent side; the joint then moves the reference part."""

    def motions(self, poses: Array) -> Array:
        """(n, 4, 4) motion of the child link's side from joint position zero, in the parent link's frame.

        `poses` (n, 4, 4) are of the moving part in the reference part's frame, identity at canonical state zero.
        """
        moved = poses if self.child_moves else se3.inverse(poses)
        T = self.T_parent_canonical
        return T @ moved @ se3.inverse(T) @ self.mechanics.joint.transform(self.state_zero)

    def poses(self, motions: Array) -> Array:
        """(n, 4, 4) inverse of `motions`."""
        T = self.T_parent_canonical
        moved = se3.inverse(T) @ motions @ se3.inverse(self.mechanics.joint.transform(self.state_zero)) @ T
        return np.asarray(moved if self.child_moves else se3.inverse(moved))

    def track(self, run: Run) -> Track:
        """The poses of a run in which the part was seen."""
        assert run.poses is not None
        seen = np.ones(len(run.times_s), bool) if run.seen is None else run.seen
        return Track(run.name, run.times_s[seen], self.motions(run.poses[seen]))


def place(asset: Asset, gravity: Array) -> PlacedAsset:
    """The asset's joint with `gravity` (3,), m/s^2 in the reference part's (canonical) frame."""
    simulated = simulate.load(replace(asset, effects={}), gravity=(0.0, 0.0, 0.0))
    simulated.set_state(asset.state_zero)
    T_world_canonical = simulated.link_pose(asset.reference_link) @ se3.inverse(asset.T_canonical_reference)
    joint = find_movable_joint(asset.urdf, asset.joint)
    T_world_parent = simulated.link_pose(joint.parent)
    g = T_world_canonical[:3, :3] @ np.asarray(gravity, float)
    mechanics = simulated.mechanics
    placed = replace(mechanics, gravity=T_world_parent[:3, :3].T @ g)
    before = simulated.link_pose(asset.moving_link)
    simulated.set_state(asset.state_zero + 0.1)
    child_moves = bool(np.abs(simulated.link_pose(asset.moving_link) - before).max() > 1e-6)
    return PlacedAsset(g, placed, se3.inverse(T_world_parent) @ T_world_canonical, asset.state_zero, child_moves)
