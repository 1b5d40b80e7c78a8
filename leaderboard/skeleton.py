"""A template of a submission: every file in its format, for every sequence of a data folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

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
Results of one method on the sequences of {name}. What `freeart21 score {folder} --data DATA` reads:

method.json                the method: name, code, settings, hardware
SEQ/prediction.json        the answer, or a failure. As written here: the failure "not solved yet", which is penalised.
SEQ/prediction.example.json  what an answer looks like. Put yours in, and rename it to prediction.json:
                             joint      type (revolute or prismatic), axis (unit vector) and pivot (metres) in the
                                        canonical frame, limits in rad or m; null is none
                             states     one a frame, rad or m
                             seen       optional: was the reference, the moving part seen in the frame
                             seconds    optional: what each stage took
SEQ/poses.npz              T_camera_reference and T_camera_moving, each (frames, 4, 4): the camera's axes (x right,
                           y down, z forward, metres) from the canonical frame, for either part
SEQ/part_mask/00000.png    one a frame, 8 bits: 0 neither part, 1 reference part, 2 moving part
SEQ/parts/reference.ply, SEQ/parts/moving.ply
                           triangle meshes, metres, canonical frame, at state zero
SEQ/renders/00000.png      optional: the held-out view of each entry of the sequence's queries.json
SEQ/renders_other/         optional: the same if the other part is the reference part
SEQ/asset/                 optional: the simulation-ready asset (one URDF with meshes, asset.json). With one, joint and
                           surfaces are measured from it; without, from the files above, and marked so.

The canonical frame, state zero and which part is the reference part are yours to choose. Poses here are the
identity, masks call the whole object the reference part, parts are cubes: placeholders of the right shapes.
`freeart21 validate {folder} --data DATA` lists every fault and how to fix it.
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
    parts = Articulation(joint, _cube(), _cube())
    return Reconstruction(parts, np.zeros(n), still, still, masks, np.ones((n, 2), bool), seconds={"all": 0.0})


def _cube() -> Mesh:
    corners = PLACEHOLDER_M * (np.array(list(np.ndindex(2, 2, 2))) - 0.5)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Mesh(corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))
