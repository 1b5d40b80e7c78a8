"""Stand-ins for other projects' programs: they read arguments as those do, and write a made-up truth as they would."""

from __future__ import annotations

import shutil
import stat
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parent
PROGRAM = """import sys
sys.path[:0] = [{tests!r}, {root!r}]
import method_stand_in
method_stand_in.{function}(dict(zip(sys.argv[1::2], sys.argv[2::2])), sys.argv[1:])
"""
PROGRAMS = {
    "run_custom.py": "bundlesdf",
    "run_demo.py": "foundationpose",
    "articulate.py": "articulate_anything",
    "joint_coarse_prediction.py": "nothing",
    "launch_joint_refinement.py": "itaco",
    "extract_mesh.py": "meshes",
    "render.py": "videoartgs",
    "pipelines/freeartgs.py": "freeartgs",
}


def make_home(folder: Path) -> Path:
    """A checkout in which each program stands where the descriptors expect it, and `bin/python`."""
    for name, function in PROGRAMS.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(PROGRAM.format(tests=str(TESTS), root=str(TESTS.parent), function=function))
    (folder / "pipelines" / "freeartgs.sh").write_text('python pipelines/freeartgs.py "$@"\n')
    python = folder / "bin" / "python"
    python.parent.mkdir()
    python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    return folder


def _name_of(path: str) -> str:
    return next(part for part in reversed(Path(path).parts) if part in ("a", "b", "c"))


def nothing(options, words):
    assert Path(options["--view_dir"]).name == Path(options["--prediction_dir"]).name


def freeartgs(options, words):
    from adapters_case import freeartgs as write

    assert options["--config"] == "configs/freeart-21.yaml"
    write(Path("outputs") / options["--object_name"], options["--object_name"])


def itaco(options, words):
    from adapters_case import itaco as write

    assert options["--loss"] == "chamfer" and options["--exp_name"] == "refinement"
    write(
        Path(options["--prediction_dir"]) / "refinement" / "monst3r" / "chamfer" / "0", _name_of(options["--view_dir"])
    )


def meshes(options, words):
    assert Path(options["--refinement_results_dir"]).is_dir()


def _track(video: Path, out: Path, mesh: str, savetxt: bool) -> None:
    """One run on one part: checks what it is given, and writes that part of the truth of the sequence that it shows."""
    import numpy as np
    from adapters_case import tracked, truth_of

    from freeart21.files import checked

    assert np.loadtxt(video / "cam_K.txt").shape == (3, 3)
    pictures = sorted((video / "masks").glob("*.png"))
    mask = checked.read_labels(pictures[0], video)
    assert len(pictures) == len(list((video / "rgb").glob("*.png"))) == len(list((video / "depth").glob("*.png")))
    name, part = next((n, k) for n in "abc" for k in (1, 2) if np.array_equal(mask > 0, truth_of(n).part_mask(0) == k))
    truth = truth_of(name)
    Ts, surface = (
        (truth.Ts_camera_reference, truth.articulation.reference)
        if part == 1
        else (truth.Ts_camera_moving, truth.articulation.moving)
    )
    shutil.rmtree(out, ignore_errors=True)  # as both programs do
    out.mkdir(parents=True)
    tracked(out, Ts, surface, part, names=[path.stem for path in pictures], obj=mesh, savetxt=savetxt)


def bundlesdf(options, words):
    if options["--mode"] == "run_video":
        assert options["--use_gui"] == options["--use_segmenter"] == "0"
        _track(Path(options["--video_dir"]), Path(options["--out_folder"]), "textured_mesh.obj", False)


def foundationpose(options, words):
    import numpy as np
    import trimesh

    given = trimesh.load(options["--mesh_file"], process=False)
    _track(Path(options["--test_scene_dir"]), Path(options["--debug_dir"]), "unused.obj", True)
    out = Path(options["--debug_dir"])
    # its poses are of the mesh that it was given
    from adapters_case import rigid

    part = 1 if out.name == "reference" else 2
    for path in (out / "ob_in_cam").iterdir():
        np.savetxt(path, np.loadtxt(path) @ rigid(part))
    assert len(given.vertices) > 3


def articulate_anything(options, words):
    from adapters_case import articulate_anything as write

    given = dict(word.split("=", 1) for word in words)
    assert given["modality"] == "video" and given["prompt"].endswith(".mp4")
    write(Path(given["out_dir"]) / "joint_actor" / "iter_0" / "seed_0", _name_of(given["out_dir"]))


def videoartgs(options, words):
    from adapters_case import artgs as write

    assert options["--iteration"] == "20000"
    write(Path(options["--model_path"]), options["--scene_name"])
