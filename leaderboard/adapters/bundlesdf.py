"""BundleSDF: the output folder of run_custom.py, one per part; see `ob_in_cam`.

    ob_in_cam/<frame>.txt   textured_mesh.obj

Read in NVlabs/BundleSDF@cf0610e3636bc42535c996f129161f44beeadc56: BundleTrack/src/Bundler.cpp (saveNewframeResult: the
object's pose in the camera, ten digits), bundlesdf.py (textured_mesh.obj is in the object's frame, in metres;
mesh_cleaned.obj is in normalised space and is not read), offscreen_renderer.py (OpenCV camera), run_custom.py (names
are those of the pictures).
"""

from __future__ import annotations

from leaderboard.adapters.layout import Layout
from leaderboard.adapters.ob_in_cam import list_runs, make_reader

LAYOUT = Layout(
    "bundlesdf",
    "BundleSDF, https://github.com/NVlabs/BundleSDF",
    "NVlabs/BundleSDF@cf0610e3636bc42535c996f129161f44beeadc56:BundleTrack/src/Bundler.cpp, bundlesdf.py",
    lambda folder: bool(list_runs(folder)),
    make_reader(("textured_mesh.obj",)),
)
