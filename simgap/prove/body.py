"""Corrected inertia and weight, written into the `<inertial>` of an asset's moving links."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects import Effect, gravity_change
from freeart21.errors import FreeArtError
from freeart21.files.asset_copy import scale_inertials
from freeart21.files.urdf import read_urdf_joints, subtree_links
from freeart21.se3 import Array
from generator import simulate
from simgap.models.surrogate import Nuisance, Plant

_EXACT = 1e-4
"""Largest relative error of the inertia of the reloaded file; SAPIEN reads single precision."""


@dataclass(frozen=True)
class BodyCorrection:
    """Factors of an asset's `<inertial>` numbers beyond its joint, with which it moves as measured.

    With mass * arm**2 = inertia, and tensors times `inertia`, the total inertia about a hinge is multiplied by
    `inertia` and its weight by mass * arm, and every link stays physically possible.
    """

    inertia: float = 1.0
    """Of tensors: inertia about a hinge, or mass on a slider, over the asset's."""
    mass: float = 1.0
    """Of masses."""
    arm: float = 1.0
    """Of distances of centres of mass from a hinge's axis."""
    turn: float = 0.0
    """rad by which centres of mass are rotated about a hinge's axis."""
    offset: tuple[Effect, ...] = ()
    """Change of gravity's force that no `<inertial>` can express, as an effect: a vertical hinge has no weight to
    scale, and a slider's mass is its inertia."""


NO_CORRECTION = BodyCorrection()


def corrected_gravity(plant: Plant, nuisance: Nuisance) -> Array:
    """(3,) cosine, sine and constant of gravity's force under `nuisance`, N*m or N."""
    terms = plant.gravity_terms
    return np.asarray(nuisance.gravity * (terms[0] + nuisance.lean[0] * terms[1] + nuisance.lean[1] * terms[2]))


def find_correction(plant: Plant, nuisance: Nuisance) -> BodyCorrection:
    """The correction with which an asset of `plant` moves as under `nuisance`."""
    terms, f = plant.gravity_terms, nuisance.inertia
    own, true = terms[0], corrected_gravity(plant, nuisance)
    was, is_now = complex(own[0], own[1]), complex(true[0], true[1])
    if plant.joint_type == "revolute" and abs(is_now - was) < abs(was):
        weight = abs(is_now) / abs(was)
        return BodyCorrection(f, weight**2 / f, f / weight, -float(np.angle(is_now / was)))
    rest = true - f * own  # scaled masses weigh more
    if np.abs(rest).max() <= 1e-9 * np.abs(terms).max():
        return BodyCorrection(f, f)
    return BodyCorrection(f, f, offset=(gravity_change(*(float(value) for value in rest)),))


def correct_body(robot: Any, asset: Asset, correction: BodyCorrection) -> None:
    """Correct the `<inertial>` of all links beyond the joint of `asset` in `robot`, its URDF's element."""
    if correction == NO_CORRECTION:
        return
    loaded = simulate.load(replace(asset, effects={}), gravity=(0.0, 0.0, 0.0))
    hinge = loaded.world_joint
    joints = read_urdf_joints(asset.urdf)

    def move(link: str, centre: Array) -> Array:
        """Scale the distance of a centre of mass from the hinge's axis, and rotate it about that."""
        if hinge.type != "revolute":
            return centre
        to_link = se3.inverse(loaded.link_pose(link))
        axis, pivot = to_link[:3, :3] @ hinge.axis, se3.transform(to_link, hinge.pivot[None])[0]
        arm = centre - pivot
        along = (arm @ axis) * axis
        across = np.cos(correction.turn) * (arm - along) + np.sin(correction.turn) * np.cross(axis, arm)
        return np.asarray(pivot + along + correction.arm * across)

    scale_inertials(robot, subtree_links(joints, joints[asset.joint].child), correction.mass, correction.inertia, move)


def check_body(before: Asset, after: Asset, correction: BodyCorrection, folder: Path) -> None:
    """FreeArtError when the inertia of the reloaded asset is not the corrected one."""
    was, is_now = (simulate.load(asset).joint_inertia for asset in (before, after))
    if abs(is_now / (was * correction.inertia) - 1) > _EXACT:
        raise FreeArtError(
            f"{folder} has an inertia of {is_now:.6g} about its joint once reloaded, expected "
            f"{was * correction.inertia:.6g}: do all its links have an <inertial>?"
        )
