"""What a method's files say of one sequence, brought to the truth as the protocol aligns it, for display.

Of a set whose truth is hidden, answers lie in the camera frame of the first picture, as each of them says it: nothing
of the truth is in them, not even an alignment to it.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.joint_json import joint_from_json
from freeart21.files.mesh_file import read_ply
from freeart21.files.result import SCHEMA
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Piece
from freeart21.se3 import Array
from freeart21.truth import Truth
from leaderboard import metrics
from leaderboard.submission import LARGEST, find_link_faults
from leaderboard.surface import Surface

EMPTY = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))


@dataclass(frozen=True)
class Answer:
    """An answer in the truth's canonical frame, or in the first picture's camera frame; parts by the truth's names."""

    articulation: Articulation
    states: Array
    """(n,) as the answer counts them."""
    sign: float
    """1, or -1 when its axis points away from the true one."""
    offset: float
    """A true state q is the state `sign * q + offset` of the answer."""
    comparable: bool
    """Whether its joint is of the true type, so that states can be compared."""
    zero: int | None
    """The frame at which a method without states has its state zero."""
    Ts_camera_articulation: Array
    """(n, 4, 4) camera from the frame of `articulation`; (0, 4, 4) of a method without poses."""
    masks: NDArray[np.uint8]
    """(k, height, width) part labels of the frames that were asked for."""
    lacks: tuple[Piece, ...]

    @property
    def states_as_true(self) -> Array:
        """(n,) its states, counted as the truth counts."""
        return self.sign * (self.states - self.offset)


def read_answer(
    folder: Path,
    truth: Truth | int,
    frames: Sequence[int],
    swapped: bool,
    lacks: tuple[Piece, ...],
    size: tuple[int, int],
) -> Answer:
    """The answer in the result folder `folder`, with the part masks of `frames` alone.

    `truth` is what it is brought to, or, where that is hidden, the number of frames. `swapped` is what scoring found of
    the names of its parts, `size` is (height, width). Only what is shown is read. Raises FreeArtError when it cannot be
    shown.
    """
    if any(find_link_faults(folder)):
        raise FreeArtError(f"{folder.name} holds links that lead out of it")
    header, n = folder / "prediction.json", truth if isinstance(truth, int) else len(truth)
    data = checked.read_json(header, SCHEMA)
    joint = joint_from_json(data.get("joint"), header)
    states = checked.numbers(data, "states", (n,), header)
    poses = checked.read_npz(folder / "poses.npz", ("T_camera_reference", "T_camera_moving"))
    Ts = [se3.orthonormalised(se3.check_poses(name, T)) for name, T in poses.items()]
    parts = [EMPTY if "meshes" in lacks else read_ply(folder / "parts" / f"{name}.ply")[0] for name in PARTS]
    masks = np.zeros((0, *size), np.uint8)
    if "masks" not in lacks:
        masks = np.stack([_mask(folder, i, size) for i in frames])
    for what, numbers in (("states", states), ("poses", Ts[0]), *(("meshes", part.vertices) for part in parts)):
        if np.abs(numbers).max(initial=0.0) > LARGEST:
            raise FreeArtError(f"{folder.name}: {what} has numbers beyond {LARGEST:g}")
    anchor = data.get("anchor", 0)
    if not isinstance(anchor, int) or not 0 <= anchor < n:
        raise FreeArtError(f"{folder.name}: 'anchor' is no frame of the video")
    if "poses" in lacks:  # as `matching.match`: the anchor's alone, the moving part after its joint
        Ts = [Ts[0][anchor][None], (Ts[0][anchor] @ joint.transform(states[anchor]))[None]]
    if swapped:  # as `matching.with_parts_swapped`: the axis is reversed, the states stay
        joint, parts, Ts = replace(joint, axis=-joint.axis), parts[::-1], Ts[::-1]
        masks = np.array([0, 2, 1], np.uint8)[masks]
    if isinstance(truth, int):
        T_common_pred = Ts[0][0]
    else:
        outer = Surface(truth.articulation.reference, truth.outer[0])
        true = truth.Ts_camera_reference[[anchor]] if "poses" in lacks else truth.Ts_camera_reference
        T_common_pred = metrics.align(true, Ts[0], outer.centre)
    articulation = Articulation(joint, parts[0], parts[1]).moved(T_common_pred)
    Ts_camera = Ts[0][:0] if "poses" in lacks else Ts[0] @ se3.inverse(T_common_pred)
    zero = anchor if "states" in lacks else None
    answer = Answer(articulation, states, 1.0, 0.0, True, zero, Ts_camera, masks, lacks)
    return answer if isinstance(truth, int) else align_states(answer, truth.articulation.joint, truth.states)


def align_states(answer: Answer, joint: Joint, states: Array) -> Answer:
    """The answer with the sign, offset and type that make its states those (n,) of `joint`, in the same frame.

    That is the sign of the axes, then the median difference, as scoring has it.
    """
    own = answer.articulation.joint
    sign = 1.0 if float(own.axis @ joint.axis) >= 0 else -1.0
    if own.type != joint.type:
        return replace(answer, sign=sign, offset=0.0, comparable=False)
    if answer.zero is not None:
        return replace(answer, sign=sign, offset=-sign * float(states[answer.zero]), comparable=True)
    difference = answer.states - sign * states
    if own.type == "revolute":
        centre = float(np.angle(np.exp(1j * difference).mean()))
        difference = centre + metrics.wrap(difference - centre)
    return replace(answer, sign=sign, offset=float(np.median(difference)), comparable=True)


def _mask(folder: Path, index: int, size: tuple[int, int]) -> NDArray[np.uint8]:
    path = folder / "part_mask" / f"{index:05d}.png"
    head = checked.read_head(path, 24, folder)  # before it is unpacked: a PNG's size stands there
    mask = np.zeros((0, 0), np.uint8)
    if head[:8] == b"\x89PNG\r\n\x1a\n" and head[16:24] == struct.pack(">II", size[1], size[0]):
        mask = checked.read_labels(path, folder)
    if mask.shape != size or mask.max(initial=0) > 2:
        raise FreeArtError(f"{folder.name}/part_mask/{path.name} is no part mask of {size[1]} x {size[0]}")
    return mask
