"""The style `release`: the base is fixed and tipped so that gravity moves the joint; the camera rests."""

from __future__ import annotations

import numpy as np

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from generator.motion import turns
from generator.motion.body import Body
from generator.motion.framing import place_object
from generator.motion.plan import Plan, Preset
from generator.motion.style import Style
from generator.motion.visibility import Atlas

SLOPE = np.radians(20.0)
"""Downward slope of a sliding joint's axis."""
_REST = 0.55  # share of the range at which a hinged part hangs straight down, if it has a moment about the axis
_WIDEST = np.radians(150.0)  # largest angle of the start from there
_VIEWS = 60
_UP: Array = np.array([0.0, 0.0, 1.0])


def tip_base(body: Body) -> tuple[Array, float]:
    """Rotation (3, 3) world (z up) from object for which gravity moves the joint, and the state of the release.

    A hinge is level, and the moving side hangs straight down just past the middle of its range: released at the upper
    end it swings without touching a limit. A slide descends by 20 degrees towards its upper limit and is released at
    its lower one. The mass is assumed to be spread evenly over the moving side's surface.
    """
    joint = body.joint
    if joint.type == "prismatic":
        flat = (
            _unit(_UP - joint.axis * (joint.axis @ _UP)) if abs(joint.axis @ _UP) < 0.99 else _perpendicular(joint.axis)
        )
        return _with_up(np.cos(SLOPE) * flat - np.sin(SLOPE) * joint.axis), body.lower
    rest = body.lower + _REST * (body.upper - body.lower)
    arm = se3.transform(joint.transform(rest), _surface_centre(body.meshes[1])[None])[0] - joint.pivot
    arm -= joint.axis * (joint.axis @ arm)
    down = _unit(arm) if np.linalg.norm(arm) > 1e-3 * body.radius else _perpendicular(joint.axis)
    return _with_up(-down), min(body.upper, rest + _WIDEST)


def plan_release(body: Body, states: Array, camera: Camera, preset: Preset, seed: int) -> Plan:
    """The base at rest, oriented by `tip_base`, seen upright from where both sides show best over `states` (n,)."""
    R_world_object, _ = tip_base(body)
    rng = np.random.default_rng([seed, 2])
    yaws, pitches = rng.uniform(-np.pi, np.pi, _VIEWS), rng.uniform(0.05, 0.7, _VIEWS)
    looks = turns.upright_rotation(yaws, pitches) @ R_world_object
    atlas = Atlas(body, body.radius * 2.2 * camera.K[1, 1] / camera.height, 96, 4)
    some = states[np.unique(np.linspace(0, len(states) - 1, 12).astype(int))]
    shares = [float(np.minimum(atlas.shares(np.tile(-R[2], (len(some), 1)), some), 0.25).mean()) for R in looks]
    R = looks[int(np.argmax(np.round(shares, 2)))]
    n = len(states)
    Rs, rest = np.broadcast_to(R, (n, 3, 3)), np.zeros(n)
    Ts = place_object(Rs, np.zeros((n, 3)), rest, states, body, camera, preset, still=True)
    T_object_world = se3.inverse(se3.pose(R_world_object, -R_world_object @ body.centre))
    return Plan(Ts, states, Ts @ T_object_world)


def _surface_centre(mesh: Mesh) -> Array:
    """(3,) the mean of a mesh's surface."""
    areas = mesh.areas()
    return np.asarray(areas @ mesh.vertices[mesh.faces].mean(1) / areas.sum())


def _with_up(up: Array) -> Array:
    """(3, 3) the shortest rotation that takes the unit vector `up` to the world's z."""
    axis, cosine = np.cross(up, _UP), float(up @ _UP)
    size = float(np.linalg.norm(axis))
    if size < 1e-9:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    return se3.exp_so3(axis / size * np.arctan2(size, cosine))


def _perpendicular(axis: Array) -> Array:
    return _unit(np.cross(axis, np.eye(3)[np.abs(axis).argmin()]))


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v)


STYLE = Style("release", 5, plan=plan_release)
