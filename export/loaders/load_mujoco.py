"""This asset in MuJoCo, from its MJCF, which says more than its URDF does. Measured with MuJoCo 4.0.0.

MuJoCo knows no velocity limit. The MJCF holds everything else that MuJoCo can say of the joint; what is put back here
is only the choice of the base, and a place in a scene. MuJoCo's own reading of the URDF always nails the base, drops
textures, and lets the two parts collide.
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
    said = json.loads((here / "joint.json").read_text())
    if said["base"] == "fixed" and fixed is False:
        raise ValueError(f"{said['mjcf']} was exported with a fixed base and cannot move freely")
    if said["trust"].startswith("doubtful"):
        warnings.warn(f"{said['mjcf']} was made of a reconstruction that is {said['trust']}", stacklevel=2)
    if left := [name for name, word in said["effects"].items() if word not in PLAYED]:
        warnings.warn(f"MuJoCo plays {said['mjcf']} without {', '.join(left)}", stacklevel=2)

    spec = mujoco.MjSpec.from_file(str(here.parent / said["mjcf"]))
    if fixed and said["base"] == "free":
        spec.delete(next(j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE))
    if scene is None:
        body = spec.body(said["base_link"])
        body.pos, body.quat = position, quaternion
        return spec
    scene.attach(spec, prefix=prefix, frame=scene.worldbody.add_frame(pos=position, quat=quaternion))
    return scene
