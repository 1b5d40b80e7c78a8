"""An asset whose motion has a plain equation: a bob on a hinge, or a block on a slope, and what that equation says."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Literal

import numpy as np
import trimesh
from scipy.integrate import solve_ivp

from export.companion_files import write_companion_files
from export.inertia import compute_inertial
from export.meshes import write_hull, write_visual
from export.mjcf import format_mjcf
from export.model import AssetModel, LinkModel
from export.settings import Base
from export.texture import texture_from_vertices
from export.urdf import format_urdf
from freeart21.asset import Asset
from freeart21.effects.base import Effect
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.files.asset import read_asset, write_asset_json
from freeart21.joint import Joint
from freeart21.mesh import Mesh

GRAVITY = 9.81
EFFECTS = {
    "revolute": (ViscousDamping(0.004), CoulombFriction(0.012)),
    "prismatic": (ViscousDamping(0.4), CoulombFriction(0.5)),
}
PIVOT = np.array([0.15, 0.02, 0.1])
AXES = {"revolute": np.array([0.0, 1.0, 0.0]), "prismatic": np.array([0.6, 0.0, -0.8])}
LIMITS = {"revolute": (-2.5, 2.5), "prismatic": (-2.5, 2.5)}
Kind = Literal["revolute", "prismatic"]


def write_case(
    folder: Path,
    kind: Kind,
    effects: tuple[Effect, ...] | None = None,
    base: Base = "free",
    velocity: float = 50.0,
    pivot: np.ndarray = PIVOT,
) -> Asset:
    """The asset, in `folder`: a block and, a hand away unless `pivot` is nearer, a bob whose middle is off the axis."""
    shapes = {"reference": ((0.1, 0.08, 0.06), (0, 0, 0)), "moving": ((0.04, 0.05, 0.16), (0.02, 0.01, -0.08))}
    links = []
    for name, (size, centre) in shapes.items():
        solid = trimesh.creation.box(size, trimesh.transformations.translation_matrix(centre))
        mesh = Mesh(solid.vertices, solid.faces, np.tile(np.array([200, 30, 20], np.uint8), (len(solid.vertices), 1)))
        (folder / "meshes").mkdir(parents=True, exist_ok=True)
        texture = write_visual(folder / "meshes", name, mesh, texture_from_vertices(mesh, mesh))
        write_hull(folder / f"meshes/{name}_hull.obj", mesh)
        hulls = (f"meshes/{name}_hull.obj",)
        links.append(LinkModel(name, f"meshes/{name}.obj", f"meshes/{texture}", hulls, compute_inertial(mesh, 900.0)))
    joint = Joint("hinge", kind, AXES[kind], pivot, *LIMITS[kind])
    effects = EFFECTS[kind] if effects is None else effects
    model = AssetModel("bob", *links, joint, 100.0, velocity, effects, base=base)
    (folder / "object.urdf").write_bytes(format_urdf(model))
    (folder / "object.xml").write_bytes(format_mjcf(model))
    write_asset_json(folder, Asset(folder / "object.urdf", "hinge", "reference", "moving", effects={"hinge": effects}))
    asset = read_asset(folder)
    write_companion_files(folder, asset)
    return asset


def loader(folder: Path, engine: str) -> ModuleType:
    """The asset's own loader, as a user imports it."""
    spec = importlib.util.spec_from_file_location(f"load_{engine}", folder / f"loaders/load_{engine}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Release:
    """A joint let go at rest at `q0`: inertia qdd = gravity(q) - damping qd - friction sign(qd), and the
    result."""

    q0: float
    inertia: float
    gravity: Callable[[float], float]
    damping: float
    friction: float

    def course(self, times: np.ndarray) -> np.ndarray:
        """(n,) positions, rad or m, at `times` (n,), rising from 0; at rest wherever friction holds the joint."""
        q, t = self.q0, 0.0
        out = np.full(len(times), q)
        while t < times[-1] and abs(self.gravity(q)) > self.friction:
            way = np.sign(self.gravity(q))

            def rate(_, state, way=way):
                force = self.gravity(state[0]) - self.damping * state[1] - self.friction * way
                return [state[1], force / self.inertia]

            def turned(_, state, way=way):
                return way * state[1]

            turned.terminal, turned.direction = True, -1
            start = [q, way * 1e-12]
            swing = solve_ivp(rate, (t, times[-1]), start, events=turned, rtol=1e-10, atol=1e-12, dense_output=True)
            out = np.where(times >= t, swing.sol(np.clip(times, t, swing.t[-1]))[0], out)
            q, t = swing.y[0, -1], swing.t[-1]
        return out


def release_of(kind: Kind) -> Release:
    """The release of the asset of this kind, by hand: a box of 900 kg/m^3 turns about y, or slides down a slope."""
    mass = 900 * 0.04 * 0.05 * 0.16
    x, z = 0.02, -0.08
    if kind == "prismatic":
        return Release(-2.0, mass, lambda q: mass * GRAVITY * 0.8, 0.4, 0.5)
    inertia = mass * ((0.04**2 + 0.16**2) / 12 + x**2 + z**2)
    return Release(1.2, inertia, lambda q: mass * GRAVITY * (x * np.cos(q) + z * np.sin(q)), 0.004, 0.012)
