"""A method's answer to a recording: a reconstruction, or a failure with its reason."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from freeart21.articulation import Articulation
from freeart21.errors import FreeArtError
from freeart21.gaussians import Gaussians
from freeart21.joint import Joint
from freeart21.se3 import Array, check_poses


@dataclass(frozen=True)
class Failure:
    """No answer, and why. Protocols penalise it; it is never dropped."""

    stage: str
    """The stage that gave up, such as 'segmentation'."""
    reason: str
    """One readable line."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Seconds per stage until then."""


Piece = Literal["joint", "states", "poses", "masks", "meshes", "renders"]
PIECES: tuple[Piece, ...] = get_args(Piece)
"""Parts of a result that a method can declare as lacking in its method.json (`freeart21.files.result.Method.lacks`)."""
Verdict = Literal["sound", "doubtful"]
VERDICTS: tuple[str, ...] = get_args(Verdict)
NOT_STATED = "not stated"
"""Replaces the verdict of a result whose method gives none."""


@dataclass(frozen=True)
class Trust:
    """A method's own judgement of its result, without ground truth."""

    verdict: Verdict
    reasons: tuple[str, ...] = ()
    """One line each, why it is doubtful; none when it is sound."""

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise FreeArtError(f"trust is '{self.verdict}', expected {' or '.join(VERDICTS)}")
        if self.verdict == "sound" and self.reasons:
            raise FreeArtError(f"trust is 'sound' with {len(self.reasons)} reasons for doubt, expected none")


def describe_trust(trust: Trust | None) -> str:
    """The verdict in one line, with the reasons for doubt."""
    if trust is None:
        return f"{NOT_STATED}: the method does not say whether to trust its answer"
    if trust.verdict == "doubtful" and not trust.reasons:
        return "doubtful: no reason is given"
    return ": ".join([trust.verdict, *(["; ".join(trust.reasons)] if trust.reasons else [])])


@dataclass(frozen=True)
class Alternative:
    """A joint of the other type that explains the video nearly as well as the result's."""

    joint: Joint
    """In the result's canonical frame."""
    states: NDArray[np.float64]
    """(n,) rad or m, 0 in frame 0."""
    cost_difference: float
    """Mean cost of a pixel (negative log-likelihood) beyond that under the result's joint; negative when lower."""


@dataclass(frozen=True)
class Reconstruction:
    """Two parts, their joint, and the poses of both in every frame.

    The canonical frame is the method's choice (ours: the camera frame with the object as in frame 0); both meshes stand
    in it at state zero. The part poses are measured, not derived from the joint.
    """

    articulation: Articulation
    states: NDArray[np.float64]
    """(n,) joint state in every frame, rad or m; interpolated where the moving part was not seen."""
    Ts_camera_reference: Array
    """(n, 4, 4) camera from canonical, reference part."""
    Ts_camera_moving: Array
    """(n, 4, 4) camera from canonical, moving part."""
    part_masks: NDArray[np.uint8]
    """(n, height, width): 0 neither, 1 reference, 2 moving."""
    seen: NDArray[np.bool_]
    """(n, 2) whether the reference and the moving part were seen well enough to be measured."""
    state_std: NDArray[np.float64] | None = None
    """(n,) standard deviation of each state, rad or m; NaN where unknown; None when not estimated."""
    covariances: Array | None = None
    """(n, 2, 6, 6) of the left twist (v, w) of each part pose, reference then moving; None when not estimated."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Seconds per stage."""
    trust: Trust | None = None
    """None when the method gives none."""
    axis_std: float | None = None
    """Standard deviation of the axis direction, rad: rms of its two tilts; None when not estimated."""
    pivot_std: float | None = None
    """Standard deviation, metres, of the axis line's position at the point nearest the moving part's centre: rms of the
    two directions across it; None when not estimated, and for a prismatic joint."""

    anchor: int = 0
    """The one frame with poses, for a method that makes none of the other frames (it lacks 'poses')."""

    alternatives: tuple[Alternative, ...] = ()
    """Joints between which and this one the video does not decide."""

    appearance: Gaussians | None = None
    """Gaussians in the canonical frame; None when there are none."""

    def __post_init__(self) -> None:
        n = len(self.states)
        if n == 0 or not np.isfinite(self.states).all():
            raise FreeArtError("reconstruction states must be finite, one a frame")
        for name in ("Ts_camera_reference", "Ts_camera_moving"):
            object.__setattr__(self, name, check_poses(f"reconstruction {name}", getattr(self, name)))
        shapes = {
            "Ts_camera_reference": (n, 4, 4),
            "Ts_camera_moving": (n, 4, 4),
            "seen": (n, 2),
            "state_std": (n,),
            "covariances": (n, 2, 6, 6),
        }
        for name, expected in shapes.items():
            value = getattr(self, name)
            if value is not None and np.shape(value) != expected:
                raise FreeArtError(f"reconstruction {name} has shape {np.shape(value)}, expected {expected}")
        for name in ("axis_std", "pivot_std"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < np.inf:
                raise FreeArtError(f"reconstruction {name} is {value}, expected a finite number, not negative")
        if any(len(other.states) != n or not np.isfinite(other.states).all() for other in self.alternatives):
            raise FreeArtError(f"reconstruction alternatives must have {n} finite states each, as the result")
        if self.part_masks.ndim != 3 or len(self.part_masks) != n or self.part_masks.max(initial=0) > 2:
            raise FreeArtError(
                f"reconstruction part_masks has shape {self.part_masks.shape}, expected ({n}, height, width) "
                "with values 0, 1, 2"
            )
        if self.appearance is not None and not len(self.appearance):
            object.__setattr__(self, "appearance", None)

    def __len__(self) -> int:
        return len(self.states)

    def exchanged(self) -> Reconstruction:
        """The same motion with the names of the parts exchanged.

        The canonical frame and the states stay; the axis is reversed, as the reference part moves about (along) the
        same line in the opposite direction when seen from the moving part.
        """
        a, look = self.articulation, self.appearance
        return replace(
            self,
            articulation=Articulation(replace(a.joint, axis=-a.joint.axis), a.moving, a.reference),
            Ts_camera_reference=self.Ts_camera_moving,
            Ts_camera_moving=self.Ts_camera_reference,
            part_masks=np.array([0, 2, 1], np.uint8)[self.part_masks],
            seen=self.seen[:, ::-1],
            covariances=None if self.covariances is None else self.covariances[:, ::-1],
            alternatives=tuple(replace(o, joint=replace(o.joint, axis=-o.joint.axis)) for o in self.alternatives),
            appearance=look and replace(look, part_weights=1 - look.part_weights),
        )
