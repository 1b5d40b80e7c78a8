"""FoundationPose: the debug folder of run_demo.py, one per part; see `ob_in_cam`.

    ob_in_cam/<frame>.txt

Read in NVlabs/FoundationPose@bf2518348eb2ef8f1fdf786b79ed698db02e8703: run_demo.py (np.savetxt of the pose, camera from
the given mesh; names are those of the pictures), Utils.py (OpenCV camera). Its model_tf.obj is in the camera frame of
the first picture and is not read: copy the mesh that was given to it, in metres, into the folder of ob_in_cam/ as
mesh.obj or mesh.ply. Its results on LINEMOD and YCB-Video (*_res.yml) are not read.
"""

from __future__ import annotations

from leaderboard.adapters.layout import Layout
from leaderboard.adapters.ob_in_cam import list_runs, make_reader

LAYOUT = Layout(
    "foundationpose",
    "FoundationPose, https://github.com/NVlabs/FoundationPose",
    "NVlabs/FoundationPose@bf2518348eb2ef8f1fdf786b79ed698db02e8703:run_demo.py",
    lambda folder: bool(list_runs(folder)),
    make_reader(("mesh.obj", "mesh.ply", "textured_mesh.obj")),
)
