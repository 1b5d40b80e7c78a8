"""A box with a lid on a hinge, of primitives alone: it passes every rule; tests break it."""

from __future__ import annotations

from pathlib import Path

URDF = """<?xml version="1.0"?>
<robot name="lid_box">
  <link name="box">
    <inertial><origin xyz="0 0 0.02"/><mass value="{box}"/>
      <inertia ixx="{bxx}" iyy="{byy}" izz="{bzz}" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual name="box_visual"><origin xyz="0 0 0.02"/><geometry><box size="0.2 0.15 0.04"/></geometry></visual>
    <collision name="box_collision"><origin xyz="0 0 0.02"/><geometry><box size="0.2 0.15 0.04"/></geometry></collision>
  </link>
  <link name="lid">
    <inertial><origin xyz="0.1 0 0.005"/><mass value="{lid}"/>
      <inertia ixx="{lxx}" iyy="{lyy}" izz="{lzz}" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual name="lid_visual"><origin xyz="0.1 0 0.005"/><geometry><box size="0.2 0.15 0.01"/></geometry></visual>
    <collision name="lid_collision"><origin xyz="0.1 0 0.005"/><geometry><box size="0.2 0.15 0.01"/></geometry>
    </collision>
  </link>
  <joint name="hinge" type="revolute">
    <parent link="box"/><child link="lid"/>
    <origin xyz="-0.1 0 0.04"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper="1.2" effort="10" velocity="5"/>
    <dynamics damping="{damping}" friction="{friction}"/>
  </joint>
</robot>
"""

MJCF = """<mujoco model="lid_box">
  <compiler angle="radian"/>
  <worldbody>
    <body name="box">
      <freejoint/>
      <inertial pos="0 0 0.02" mass="{box}" diaginertia="{bxx} {byy} {bzz}"/>
      <geom type="box" size="0.1 0.075 0.02" pos="0 0 0.02"/>
      <body name="lid" pos="-0.1 0 0.04">
        <joint name="hinge" axis="0 -1 0" range="0 1.2" damping="{damping}" frictionloss="{friction}"/>
        <inertial pos="0.1 0 0.005" mass="{lid}" diaginertia="{lxx} {lyy} {lzz}"/>
        <geom type="box" size="0.1 0.075 0.005" pos="0.1 0 0.005"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def numbers(kg: float) -> dict[str, str]:
    """Masses and moments of the two boxes, the lid a fifth of `kg`, with damping and friction to match."""
    values: dict[str, float] = {"box": 0.8 * kg, "lid": 0.2 * kg}
    for letter, mass, (x, y, z) in (("b", 0.8 * kg, (0.2, 0.15, 0.04)), ("l", 0.2 * kg, (0.2, 0.15, 0.01))):
        values[f"{letter}xx"] = mass / 12 * (y * y + z * z)
        values[f"{letter}yy"] = mass / 12 * (x * x + z * z)
        values[f"{letter}zz"] = mass / 12 * (x * x + y * y)
    values |= {"damping": 1e-3 * kg, "friction": 1e-2 * kg}
    return {key: repr(value) for key, value in values.items()}


def write_little(folder: Path, kg: float = 0.5, *, mjcf: bool = False) -> Path:
    """The asset's one file in a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / ("lid_box.xml" if mjcf else "lid_box.urdf")
    file.write_text((MJCF if mjcf else URDF).format(**numbers(kg)))
    return file
