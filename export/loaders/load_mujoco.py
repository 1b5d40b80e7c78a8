"""Loads this asset into MuJoCo from its MJCF. Tested with MuJoCo 4.0.0.

The MJCF holds everything that MuJoCo can express of the joint; there is no velocity limit. This loader only chooses the
base and a place in a scene. MuJoCo's own URDF import fixes the base, drops textures, and lets the two parts collide.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

PLAYED = {"damping", "friction", "armature", "stiffness", "drag"}


def load(
    scene: Any = None,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    prefix: str = "",
    fixed: bool | None = None,
) -> Any:
    """The asset's mujoco.MjSpec, or `scene` (another one) with the asset in it; `.compile()` makes the model.

    `position` (m) and `quaternion` (w, x, y, z) place it; `prefix` goes before its names in the scene; `fixed` None
    takes the asset's own base.
    """
    import mujoco

    here = Path(__file__).resolve().parent
    info = json.loads((here / "joint.json").read_text())
    if info["base"] == "fixed" and fixed is False:
        raise ValueError(f"{info['mjcf']} was exported with a fixed base and cannot move freely")
    if info["trust"].startswith("doubtful"):
        warnings.warn(f"{info['mjcf']} was made of a reconstruction that is {info['trust']}", stacklevel=2)
    if ignored := [name for name, word in info["effects"].items() if word not in PLAYED]:
        warnings.warn(f"MuJoCo plays {info['mjcf']} without {', '.join(ignored)}", stacklevel=2)

    spec = mujoco.MjSpec.from_file(str(here.parent / info["mjcf"]))
    if fixed and info["base"] == "free":
        spec.delete(next(j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE))
    if scene is None:
        body = spec.body(info["base_link"])
        body.pos, body.quat = position, quaternion
        return spec
    scene.attach(spec, prefix=prefix, frame=scene.worldbody.add_frame(pos=position, quat=quaternion))
    return scene
