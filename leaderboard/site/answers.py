"""A method's result for one sequence, aligned with the truth as the protocol does it, for display.

When the truth is hidden, a result is shown in the camera frame of the first image, as its own poses say: nothing of the
truth is in it, not even an alignment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Piece
from freeart21.se3 import Array
from freeart21.truth import Truth
from freeart21.view.parts import state_offset
from leaderboard import metrics
from leaderboard.submission import read_submission
from leaderboard.surface import Surface

EMPTY = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))


@dataclass(frozen=True)
class Answer:
    """A result in the truth's canonical frame, or in the first image's camera frame; parts by the truth's names."""

    articulation: Articulation
    states: Array
    """(n,) with the result's own sign and zero."""
    sign: float
    """-1 when its axis is opposite to the true one, else 1."""
    offset: float
    """A true state q is the state `sign * q + offset` of the result."""
    comparable: bool
    """Whether its joint has the true type, so that states can be compared."""
    zero: int | None
    """The frame at state zero of a method without states."""
    Ts_camera_articulation: Array
    """(n, 4, 4) camera from the frame of `articulation`; (0, 4, 4) of a method without poses."""
    masks: NDArray[np.uint8]
    """(k, height, width) part labels of the requested frames."""
    lacks: tuple[Piece, ...]

    @property
    def states_as_true(self) -> Array:
        """(n,) its states with the truth's sign and zero."""
        return self.sign * (self.states - self.offset)


def read_answer(
    folder: Path,
    truth: Truth | int,
    frames: Sequence[int],
    swapped: bool,
    lacks: tuple[Piece, ...],
    size: tuple[int, int],
) -> Answer:
    """The result in `folder`.

    Args:
        folder: The result.
        truth: What it is aligned with; the number of frames when that is hidden.
        frames: Frames whose part masks are kept.
        swapped: Whether scoring exchanged its part names.
        lacks: What the method does not make.
        size: (height, width) of the masks.

    Raises FreeArtError when it cannot be shown.
    """
    n = truth if isinstance(truth, int) else len(truth)
    given, _ = read_submission(folder, n, *size)
    if isinstance(given, Failure):
        raise FreeArtError(f"{folder.name} is a failure: {given.reason}")
    joint, states, anchor = given.articulation.joint, given.states, given.anchor
    Ts = [given.Ts_camera_reference, given.Ts_camera_moving]
    parts = [EMPTY if "meshes" in lacks else replace(given.articulation.part(name), colours=None) for name in PARTS]
    masks = np.zeros((0, *size), np.uint8) if "masks" in lacks else given.part_masks[list(frames)]
    if "poses" in lacks:  # as `matching.match`: the anchor frame's only, the moving part posed by its joint
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
    """The result with the sign and offset that align its states with those (n,) of `joint`, in the same frame.

    The sign is that of the axes, the offset the median difference, as in scoring.
    """
    own = answer.articulation.joint
    sign = 1.0 if float(own.axis @ joint.axis) >= 0 else -1.0
    if own.type != joint.type:
        return replace(answer, sign=sign, offset=0.0, comparable=False)
    if answer.zero is not None:
        return replace(answer, sign=sign, offset=-sign * float(states[answer.zero]), comparable=True)
    return replace(answer, sign=sign, offset=state_offset(answer.states - sign * states, own.type), comparable=True)
