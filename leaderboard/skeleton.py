"""A template of a submission: every file in its format, for every sequence of a data folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from freeart21.articulation import Articulation
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.benchmark import read_benchmark
from freeart21.files.result import Method, write_method, write_result
from freeart21.files.sequence import read_sequence
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.recording import Recording

PLACEHOLDER_M = 0.1
"""Side, metres, of the placeholder cubes."""
NOT_SOLVED = Failure("none", "not solved yet")
_README = """\
Results of one method on the sequences of {name}, to fill in. docs/formats.md describes each file.

method.json                  the method: name, code, settings, hardware
SEQ/prediction.json          the answer, or a failure; as written here "not solved yet", which is penalised
SEQ/prediction.example.json  what an answer looks like: put yours in, and rename it to prediction.json
SEQ/poses.npz                both parts' poses, (frames, 4, 4): camera (x right, y down, z forward, metres) from part
SEQ/part_mask/00000.png      one a frame: 0 neither part, 1 reference part, 2 moving part
SEQ/parts/reference.ply, SEQ/parts/moving.ply
                             triangle meshes, metres, canonical frame, at state zero
SEQ/renders/, SEQ/renders_other/, SEQ/asset/  optional: held-out views (the other if the other part is the reference
                             part), and the simulation-ready asset, from which joint and surfaces are measured then

The canonical frame, state zero and which part is the reference part are yours to choose. What is here are placeholders
of the right shapes. `freeart21 validate {folder} --data DATA` lists every fault and how to fix it.
"""


def write_skeleton(data: Path, out: Path) -> tuple[str, ...]:
    """Write the results folder `out` for all sequences of `data`; returns their names.

    Each result declares the failure NOT_SOLVED and holds an example of every file of an answer. Raises FreeArtError
    when `out` exists.
    """
    benchmark = read_benchmark(data)
    if out.is_symlink():
        raise FreeArtError(f"{out} exists; choose another place or remove it first")
    with atomic.new_folder(out) as staging:
        write_method(staging, Method(out.resolve().name, "address and version of your code", {}, "what it ran on"))
        for name in benchmark.sequences:
            recording = read_sequence(benchmark.sequence(name))
            folder = staging / name
            write_result(folder, make_placeholder(recording))
            (folder / "prediction.json").replace(folder / "prediction.example.json")
            declared = staging / "declared"
            write_result(declared, NOT_SOLVED)
            (declared / "prediction.json").replace(folder / "prediction.json")
            declared.rmdir()
        readme = _README.format(name=benchmark.name, folder=out.name)
        atomic.write_bytes(staging / "README.txt", readme.encode())
    return benchmark.sequences


def make_placeholder(recording: Recording) -> Reconstruction:
    """An answer to `recording` in the right shapes without content: a cube at rest that is the whole object."""
    n = len(recording)
    masks = np.stack([recording.frame(i).mask.astype(np.uint8) for i in range(n)])
    still = np.repeat(np.eye(4)[None], n, 0)
    joint = Joint("joint", "revolute", np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0, 1.0)
    box = trimesh.creation.box([PLACEHOLDER_M] * 3)
    cube = Mesh(np.asarray(box.vertices), np.asarray(box.faces))
    parts = Articulation(joint, cube, cube)
    return Reconstruction(parts, np.zeros(n), still, still, masks, np.ones((n, 2), bool), seconds={"all": 0.0})
