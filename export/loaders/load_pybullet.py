"""This asset in PyBullet, with what PyBullet drops or adds put right. Measured with PyBullet 3.2.7.

PyBullet reads a URDF's friction and velocity limit and ignores both, holds every joint with a motor of its own until
told otherwise, and slows every link by 4 % a second. Here that motor becomes the joint's Coulomb friction (speed 0, at
most the friction's force), the speed is limited, and the links' own damping is gone. The motor is not free for anything
else then.
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
    said = json.loads((here / "joint.json").read_text())
    if said["base"] == "fixed" and fixed is False:
        raise ValueError(f"{said['urdf']} was exported with a fixed base and cannot move freely")
    if said["trust"].startswith("doubtful"):
        warnings.warn(f"{said['urdf']} was made of a reconstruction that is {said['trust']}", stacklevel=2)
    if left := [name for name, word in said["effects"].items() if word not in PLAYED]:
        warnings.warn(f"PyBullet plays {said['urdf']} without {', '.join(left)}", stacklevel=2)

    body = pybullet.loadURDF(
        str(here.parent / said["urdf"]),
        position,
        quaternion,
        useFixedBase=said["base"] == "fixed" if fixed is None else fixed,
        flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
        physicsClientId=client,
    )
    names = [
        pybullet.getJointInfo(body, i, physicsClientId=client)[1] for i in range(pybullet.getNumJoints(body, client))
    ]
    for index in range(-1, len(names)):
        pybullet.changeDynamics(body, index, linearDamping=0, angularDamping=0, physicsClientId=client)
    joint = names.index(said["joint"].encode())
    if said["velocity"]:
        pybullet.changeDynamics(body, joint, maxJointVelocity=said["velocity"], physicsClientId=client)
    friction = {"targetVelocity": 0, "force": said["friction"], "physicsClientId": client}
    pybullet.setJointMotorControl2(body, joint, pybullet.VELOCITY_CONTROL, **friction)
    return int(body)
