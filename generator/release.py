"""The motion 'release': the joint of a fixed, tipped object is released, and SAPIEN simulates its motion.

A procedural object has the masses of its materials. A PartNet-Mobility object has none; SAPIEN takes its convex
collision shapes at 1000 kg/m^3.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from freeart21.asset import Asset
from freeart21.effects.base import Effect
from freeart21.errors import FreeArtError
from freeart21.files.urdf import UrdfInertial, format_urdf, read_urdf
from freeart21.se3 import Array
from generator import simulate
from generator.model import Link, ObjectModel
from generator.motion.body import Body
from generator.motion.styles.release import tip_base
from generator.partnet_writer import R_ROOT_MESH
from generator.shapes import triangles
from generator.urdf_object import LoadedObject

_TIMESTEP_S = 1e-3


def roll_out_release(
    loaded: LoadedObject,
    effects: tuple[Effect, ...],
    frames: int,
    fps: float,
    seed: int = 0,
    start: float | None = None,
    model: ObjectModel | None = None,
) -> Array:
    """Joint states (frames,), rad or m, after the joint is released at rest in frame 0.

    Args:
        loaded: the object; its base is fixed as `tip_base` says, which 'release' plans show too.
        effects: what acts on the joint besides gravity; without effects there are no losses.
        frames: 2 or more.
        fps: frames a second.
        seed: of the start when `start` is None: within the last tenth of the range.
        start: state at the release, rad or m.
        model: the procedural object that was loaded; its materials give the masses.

    Raises FreeArtError when the start is outside the limits or the moving part has no mass.
    """
    parent, child = (side.surface.mesh() for side in loaded.sides)
    body = Body.of((parent, child), loaded.joint)
    R_world_object, top = tip_base(body)
    if start is None:
        way = 0.1 * (body.upper - body.lower) * float(np.random.default_rng([seed, 4]).uniform())
        start = top + way if loaded.joint.type == "prismatic" else top - way
    if not body.lower <= start <= body.upper:
        raise FreeArtError(
            f"the joint cannot be let go at {start:g}, expected a state within {body.lower:g} to {body.upper:g}"
        )
    per_frame = int(np.ceil(1 / (fps * _TIMESTEP_S)))
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        asset = loaded.asset if model is None else add_inertia(loaded.asset, model, Path(place))
        asset = replace(asset, effects={asset.joint: tuple(effects)})
        rolled = simulate.roll_out(
            asset,
            start,
            duration_s=(frames - 1) / fps,
            timestep_s=1 / (fps * per_frame),
            gravity=R_world_object.T @ np.array(simulate.GRAVITY),
        )
    return rolled.q[::per_frame][:frames]


def add_inertia(asset: Asset, model: ObjectModel, folder: Path, shapes: bool = False) -> Asset:
    """`asset`, written from `model`, with a new URDF in `folder` that has inertia by the materials.

    The URDF has the visual and collision shapes only with `shapes`.
    """
    urdf = read_urdf(asset.urdf)
    links = {}
    for name, link in urdf.links.items():
        link = link if shapes else replace(link, visuals=(), collisions=())
        if name.startswith("link_"):
            made = model.links[int(name.removeprefix("link_"))]
            pivot = np.zeros(3) if made.hinge is None else np.array(made.hinge.pivot, float)
            link = replace(link, inertial=_inertial(made, pivot))
        links[name] = link
    path = folder / "weighed.urdf"
    path.write_bytes(format_urdf(replace(urdf, links=links)))
    return replace(asset, urdf=path)


def _inertial(link: Link, pivot: Array) -> UrdfInertial:
    """The mass properties of a link, in the link's frame: at `pivot` (3,) of the object, with mesh-frame axes."""
    mass, moment, about_zero = 0.0, np.zeros(3), np.zeros((3, 3))
    for piece in link.pieces:
        solid = trimesh.Trimesh(*triangles(piece.solid), process=False)
        solid.density = piece.material.density
        m, c = float(solid.mass), np.asarray(solid.center_mass)
        mass += m
        moment += m * c
        about_zero += np.asarray(solid.moment_inertia) + m * (c @ c * np.eye(3) - np.outer(c, c))
    centre = moment / mass
    inertia = about_zero - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    centre, inertia = (centre - pivot) @ R_ROOT_MESH, R_ROOT_MESH.T @ inertia @ R_ROOT_MESH
    return UrdfInertial(mass, centre, inertia)
