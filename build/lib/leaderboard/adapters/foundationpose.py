"""FoundationPose: the debug folder of run_demo.py, one a part; see `ob_in_cam`.

    ob_in_cam/<frame>.txt

Read in NVlabs/FoundationPose@bf2518348eb2ef8f1fdf786b79ed698db02e8703: run_demo.py (np.savetxt of the pose, camera from
the mesh that it was given; names are those of the pictures), Utils.py (the camera is OpenCV's). Its model_tf.obj stands
in the camera of the first frame and is not read: put the mesh that was given to it, in metres, beside ob_in_cam/ as
mesh.obj or mesh.ply. Its results on LINEMOD and YCB-Video (*_res.yml) are of other data sets, and are not read.
"""

from __future__ import annotations

from leaderboard.adapters.ob_in_cam import reader, runs
from leaderboard.adapters.toolbox import Layout

LAYOUT = Layout(
    "foundationpose",
    "FoundationPose, https://github.com/NVlabs/FoundationPose",
    "NVlabs/FoundationPose@bf2518348eb2ef8f1fdf786b79ed698db02e8703:run_demo.py",
    lambda folder: bool(runs(folder)),
    reader(("mesh.obj", "mesh.ply", "textured_mesh.obj")),
)
