"""BundleSDF: the output folder of run_custom.py, one a part; see `ob_in_cam`.

    ob_in_cam/<frame>.txt   textured_mesh.obj

Read in NVlabs/BundleSDF@cf0610e3636bc42535c996f129161f44beeadc56: BundleTrack/src/Bundler.cpp (saveNewframeResult: the
pose of the object in the camera, ten digits), bundlesdf.py (textured_mesh.obj is put back into the object's frame, in
metres; mesh_cleaned.obj beside it is still in normalised space, and is not read), offscreen_renderer.py (the
camera is OpenCV's), run_custom.py (names are those of the pictures).
"""

from __future__ import annotations

from leaderboard.adapters.ob_in_cam import reader, runs
from leaderboard.adapters.toolbox import Layout

LAYOUT = Layout(
    "bundlesdf",
    "BundleSDF, https://github.com/NVlabs/BundleSDF",
    "NVlabs/BundleSDF@cf0610e3636bc42535c996f129161f44beeadc56:BundleTrack/src/Bundler.cpp, bundlesdf.py",
    lambda folder: bool(runs(folder)),
    reader(("textured_mesh.obj",)),
)
