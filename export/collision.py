"""Convex collision hulls: CoACD (Wei et al., SIGGRAPH 2022) in a process of its own, or one hull, said aloud."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from export.meshes import reduced
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh

# CoACD can crash or run for hours on bad meshes: it gets its own process and a time limit.
_PROGRAM = """
import json, sys
import coacd, numpy as np
given = np.load(sys.argv[1])
coacd.set_log_level("error")
parts = coacd.run_coacd(coacd.Mesh(given["vertices"], given["faces"]), **json.loads(sys.argv[3]))
arrays = {f"v{i}": p[0] for i, p in enumerate(parts)}
np.savez(sys.argv[2], count=len(parts), **arrays)
"""


# Monte Carlo search of the cutting planes: 4 times quicker than CoACD's defaults, with the same number of hulls
_SEARCH = {"resolution": 1000, "mcts_nodes": 10, "mcts_iterations": 60, "mcts_max_depth": 2}


@dataclass(frozen=True)
class CollisionSettings:
    """How a part is cut into convex hulls."""

    max_hulls: int = 16
    """Hulls a part may have."""
    threshold: float = 0.1
    """CoACD's concavity threshold, fraction of the part's size: 0.01 is fine and slow, 1 is one hull."""
    max_vertices: int = 64
    """Vertices a hull may have; PhysX takes at most 255, MuJoCo likes few."""
    max_faces: int = 3_000
    """Faces of the mesh that CoACD gets; more are reduced first."""
    min_thickness_m: float = 0.002
    """Thinner hulls are made this thick: simulators refuse flat solids."""
    remesh: int = 30
    """Cells along the part when CoACD makes a bad mesh watertight; hulls stick out by about a fifth of one."""
    timeout_s: float = 120.0
    """Seconds that CoACD may take for a part."""
    seed: int = 0
    """CoACD's seed."""


@dataclass(frozen=True)
class Collision:
    """The convex hulls of a part, and how they came about."""

    hulls: tuple[Mesh, ...]
    """Closed convex meshes in the part's frame."""
    method: str
    """'coacd' or 'convex_hull'."""
    reason: str | None = None
    """Why it is a single hull when CoACD was to cut it, else None."""


def convex_parts(mesh: Mesh, settings: CollisionSettings) -> Collision:
    """The part as at most `max_hulls` convex hulls; one, with the reason, when CoACD fails or runs too long."""
    clouds, reason = _coacd(reduced(mesh, settings.max_faces), settings)
    if clouds is None:
        single = convex_hull(mesh.vertices, settings.min_thickness_m, settings.max_vertices)
        return Collision((single,), "convex_hull", reason)
    hulls = (convex_hull(cloud, settings.min_thickness_m, settings.max_vertices) for cloud in clouds)
    return Collision(tuple(hulls), "coacd")


def convex_hull(points: NDArray[np.float64], min_thickness_m: float, max_vertices: int) -> Mesh:
    """The closed convex hull of points (n, 3), made at least `min_thickness_m` thick in every direction.

    When it has more than `max_vertices`, only the points furthest in as many even directions are kept. Raises
    FreeArtError without points.
    """
    if len(points) == 0:
        raise FreeArtError("there are no points to make a convex hull of")
    centre = points.mean(0)
    _, _, axes = np.linalg.svd(points - centre, full_matrices=len(points) < 3)
    for axis in axes:
        height = (points - centre) @ axis
        lack = min_thickness_m - np.ptp(height)
        if lack > 0:
            points = np.concatenate([points + 0.5 * lack * axis, points - 0.5 * lack * axis])
    hull = trimesh.convex.convex_hull(points)
    if len(hull.vertices) > max_vertices:
        furthest = np.unique(np.argmax(hull.vertices @ _even_directions(max_vertices).T, axis=0))
        hull = trimesh.convex.convex_hull(hull.vertices[furthest])
    return Mesh(hull.vertices, hull.faces)


def _even_directions(n: int) -> NDArray[np.float64]:
    """(n, 3) unit vectors spread evenly: the Fibonacci sphere."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(n)
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)


def _coacd(mesh: Mesh, settings: CollisionSettings) -> tuple[list[NDArray[np.float64]] | None, str | None]:
    """Point clouds of CoACD's parts, or None and why."""
    options = {
        "threshold": settings.threshold,
        "max_convex_hull": settings.max_hulls,
        "seed": settings.seed,
        "decimate": True,
        "max_ch_vertex": settings.max_vertices,
        "preprocess_resolution": settings.remesh,
        **_SEARCH,
    }
    with tempfile.TemporaryDirectory() as folder:
        given, answer = Path(folder) / "given.npz", Path(folder) / "answer.npz"
        np.savez(given, vertices=mesh.vertices, faces=mesh.faces)
        command = [sys.executable, "-c", _PROGRAM, str(given), str(answer), json.dumps(options)]
        try:
            done = subprocess.run(command, capture_output=True, timeout=settings.timeout_s, check=False)
        except subprocess.TimeoutExpired:
            return None, f"CoACD took longer than {settings.timeout_s:g} s"
        if done.returncode != 0 or not answer.is_file():
            lines = done.stderr.decode(errors="replace").strip().splitlines()
            return None, f"CoACD ended with exit code {done.returncode}{': ' + lines[-1] if lines else ''}"
        with np.load(answer) as data:
            clouds = [data[f"v{i}"] for i in range(int(data["count"]))]
    if not 0 < len(clouds) <= settings.max_hulls:
        return None, f"CoACD gave {len(clouds)} hulls, expected 1 to {settings.max_hulls}"
    return clouds, None
