"""Loads this asset into PyBullet and corrects what PyBullet drops or adds. Tested with PyBullet 3.2.7.

PyBullet ignores a URDF's friction and velocity limit, holds every joint with a default motor, and damps every link by 4
% a second. Here that motor becomes the joint's Coulomb friction (target speed 0, at most the friction's force), so it
cannot serve as a drive; the speed is limited, and the links' damping is removed.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path

PLAYED = {"damping", "friction"}


def load(
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    fixed: bool | None = None,
    client: int = 0,
) -> int:
    """The body's id in the PyBullet `client`.

    The root link's frame is put at `position` (m) and `quaternion` (x, y, z, w); `fixed` None takes the asset's own
    base.
    """
    import pybullet

    here = Path(__file__).resolve().parent
    info = json.loads((here / "joint.json").read_text())
    if info["base"] == "fixed" and fixed is False:
        raise ValueError(f"{info['urdf']} was exported with a fixed base and cannot move freely")
    if info["trust"].startswith("doubtful"):
        warnings.warn(f"{info['urdf']} was made of a reconstruction that is {info['trust']}", stacklevel=2)
    if ignored := [name for name, word in info["effects"].items() if word not in PLAYED]:
        warnings.warn(f"PyBullet plays {info['urdf']} without {', '.join(ignored)}", stacklevel=2)

    body = pybullet.loadURDF(
        str(here.parent / info["urdf"]),
        position,
        quaternion,
        useFixedBase=info["base"] == "fixed" if fixed is None else fixed,
        flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
        physicsClientId=client,
    )
    names = [
        pybullet.getJointInfo(body, i, physicsClientId=client)[1] for i in range(pybullet.getNumJoints(body, client))
    ]
    for index in range(-1, len(names)):
        pybullet.changeDynamics(body, index, linearDamping=0, angularDamping=0, physicsClientId=client)
    links = {pybullet.getBodyInfo(body, physicsClientId=client)[0].decode(): -1} | {
        pybullet.getJointInfo(body, i, physicsClientId=client)[12].decode(): i for i in range(len(names))
    }
    for link, surface in info["surfaces"].items():
        kinds = {"lateralFriction": surface["friction"], "restitution": surface["restitution"]}
        pybullet.changeDynamics(body, links[link], **kinds, physicsClientId=client)
    joint = names.index(info["joint"].encode())
    if info["velocity"]:
        pybullet.changeDynamics(body, joint, maxJointVelocity=info["velocity"], physicsClientId=client)
    friction = {"targetVelocity": 0, "force": info["friction"], "physicsClientId": client}
    pybullet.setJointMotorControl2(body, joint, pybullet.VELOCITY_CONTROL, **friction)
    return int(body)
