"""The same joint in MuJoCo: an agreement check on what both engines have. Not a generator of cases."""

from __future__ import annotations

import numpy as np

from benchmarks.second_world import laws as w
from benchmarks.second_world.machines import Machine

STEP = 1e-4  # s; halving it moves the angles of the test by less than 1e-5 rad


def swing(
    machine: Machine, p: np.ndarray, start: tuple[float, float], times: np.ndarray, command: float = 0.0
) -> np.ndarray:
    """(n,) positions at `times` (n,), s, of a machine whose base stands straight. Oil and air have to be plain (|v|,
    |v|^2), springs straight; rotors sit on the joint (`armature` is what `p` has beyond the machine's inertia); the
    drive holds `command`."""
    import mujoco

    x, y, z = machine.arm
    gx, gy, gz = machine.gravity
    about = machine.mass if machine.slides else machine.inertia
    own = max(machine.inertia - machine.mass * machine.lever**2, 1e-9)
    axis = " ".join(str(a) for a in machine.axis)
    drive = ""
    if p[w.KP]:
        gain, damp = p[w.GAIN] * p[w.KP], p[w.GAIN] * p[w.KD]
        drive = f'<actuator><position joint="j" kp="{gain}" kv="{damp}"/></actuator>'
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{STEP}" integrator="implicitfast" gravity="{gx} {gy} {gz}"/>
  <worldbody><body>
    <joint name="j" type="{"slide" if machine.slides else "hinge"}" axis="{axis}" damping="{p[w.OIL]} {p[w.AIR]} 0"
           stiffness="{p[w.SPRING]}" springref="{p[w.SPRING_Q]}" armature="{p[w.M] - about}"/>
    <inertial pos="{x} {y} {z}" mass="{machine.mass}" diaginertia="{own} {own} {own}"/>
  </body></worldbody>
  {drive}
</mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = start
    if p[w.KP]:
        data.ctrl[0] = command
    out = np.empty(len(times))
    for i, t in enumerate(times):
        while data.time < t - STEP / 2:
            mujoco.mj_step(model, data)
        out[i] = data.qpos[0]
    return out
