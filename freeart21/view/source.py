"""An estimate of an articulated object, or its truth, as the video, the 3D view and the plots of a page show it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.joint import Joint
from freeart21.mesh import bounding_diagonal, box_centre
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array
from freeart21.truth import Truth
from freeart21.view.document import MOVING, REFERENCE, TRUTH

PartMasks = Callable[[int], NDArray[np.uint8]]
"""Frame index to (height, width) part labels: 0 background, 1 reference, 2 moving."""
AXIS = "#AA3377"
"""Colour of the estimated joint axis."""
LAYERS = "reference part", "moving part", "joint axis"


@dataclass(frozen=True)
class Source:
    """What one estimate, or the truth, adds to a page. States and axes of all follow those of the first one."""

    name: str
    colours: tuple[str, str] = (REFERENCE, MOVING)
    """Of reference and moving part."""
    axis_colour: str = ""
    """That of the moving part when empty."""
    articulation: Articulation | None = None
    """In the frame that all sources of a page share; None where nothing can be shown."""
    states: Array = field(default_factory=lambda: np.zeros(0))
    """(n,) rad or m, with its own sign and zero."""
    Ts_camera: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    """(n, 4, 4) camera from the shared frame; (0, 4, 4) without poses."""
    state_std: Array | None = None
    """(n,) standard deviations of the states; NaN where unknown."""
    zero: int | None = None
    """The frame at state zero of a method without states."""
    masks: PartMasks | None = None
    confidence: PartMasks | None = None
    """That of the masks' labels, 0 to 255."""
    layers: tuple[str, str, str] | None = None
    """Names of the parts and the axis in the 3D view; its own when None."""
    is_truth: bool = False
    ghost: bool = False
    """Transparent in the 3D view, and there without vertex colours."""
    shown: bool = True
    """At first."""
    absent: str = ""
    """Why there are no masks."""
    sign: float = 1.0
    """-1 when its axis is opposite to the first one's, else 1."""
    offset: float | None = 0.0
    """Rad or m: at the state q of the first one it is at `sign * q + offset`; None when their types differ."""

    @property
    def joint(self) -> Joint:
        """With its own sign and zero."""
        assert self.articulation is not None
        return self.articulation.joint

    @property
    def states_of_first(self) -> Array:
        """(n,) its states with the sign and zero of the first one."""
        return np.asarray(self.sign * (self.states - (self.offset or 0.0)))

    @property
    def joint_of_first(self) -> Joint:
        """Its joint with the sign and zero of the first one."""
        joint, shift = self.joint if self.sign > 0 else self.joint.reversed(), self.sign * (self.offset or 0.0)
        return replace(joint, lower=joint.lower - shift, upper=joint.upper - shift)

    def follow(self, first: Source) -> Source:
        """The source with its sign and median offset from another one in the same frame, as in scoring."""
        sign = 1.0 if float(self.joint.axis @ first.joint.axis) >= 0 else -1.0
        if self.joint.type != first.joint.type:
            return replace(self, sign=sign, offset=None)
        if self.zero is not None:
            return replace(self, sign=sign, offset=-sign * float(first.states[self.zero]))
        difference = self.states - sign * first.states
        if self.joint.type == "revolute":  # angles near their mean direction
            centre = float(np.angle(np.exp(1j * difference).mean()))
            difference = centre + np.angle(np.exp(1j * (difference - centre)))
        return replace(self, sign=sign, offset=float(np.median(difference)))

    def place(self) -> tuple[Array, float]:
        """Where and how large to draw the axis: middle (3,) of the moving part in frame 0, and the diagonal, m.

        Without a moving part, the middle of the reference part, or the pivot.
        """
        assert self.articulation is not None
        moving = self.articulation.moving.moved(self.joint.transform(float(self.states[0])))
        size = bounding_diagonal(self.articulation.reference, moving) or 1.0
        middles = (box_centre(mesh) for mesh in (moving, self.articulation.reference) if not mesh.empty)
        return next(middles, np.asarray(self.joint.pivot, float)), size

    def axis_in_images(self, camera: Camera | None) -> NDArray[np.float64] | None:
        """(n, 2, 2) both ends of the axis in every image, pixels; None without poses.

        The first one's positive end is last. The line is 1.2 times as long as the object's diagonal; NaN where it is
        behind the camera.
        """
        if camera is None or self.articulation is None or not len(self.Ts_camera):
            return None
        near, size = self.place()
        ends = axis_point(self.joint, near) + 0.6 * size * self.sign * np.array([[-1.0], [1.0]]) * self.joint.axis
        seen = se3.transform(self.Ts_camera, np.broadcast_to(ends, (len(self.Ts_camera), 2, 3)))
        # an end behind the camera is moved along the line to just in front of it
        closest = 0.02 * size
        z, other = seen[..., 2], seen[:, ::-1]
        part = np.clip((closest - z) / np.where(other[..., 2] == z, 1.0, other[..., 2] - z), 0.0, 1.0)
        clipped = np.where((z < closest)[..., None], seen + part[..., None] * (other - seen), seen)
        return np.where((z.max(1) > closest)[:, None, None], camera.project(clipped), np.nan)


def truth_source(truth: Truth, **options: Any) -> Source:
    """The truth in its own frame; `options` are other fields."""
    true = truth.articulation, truth.states, truth.Ts_camera_reference
    own = Source("ground truth", ("#7fcfb6", TRUTH), TRUTH, *true, masks=truth.part_mask, is_truth=True)
    return replace(own, **options)


def align_truth(truth: Truth, result: Reconstruction, estimate: Source) -> Source:
    """The truth over an estimate with the same part names (see `matched`), in its frame.

    They are aligned by the robust mean of the reference part's poses over all frames.
    """
    T_truth_pred = se3.mean_pose(se3.inverse(truth.Ts_camera_reference) @ result.Ts_camera_reference)
    true = truth.articulation.moved(se3.inverse(T_truth_pred))
    poses, layers = truth.Ts_camera_reference @ T_truth_pred, ("ground truth", "ground truth", "true axis")
    own = truth_source(truth, articulation=true, Ts_camera=poses, layers=layers, ghost=True, shown=False)
    return own.follow(estimate)


def matched(result: Reconstruction, truth: Truth) -> Reconstruction:
    """The result, its part names exchanged when that gives a better mean part IoU with the truth."""
    frames = np.unique(np.linspace(0, len(truth) - 1, min(len(truth), 20)).round().astype(int))
    true = np.stack([truth.part_mask(i) for i in frames])
    masks = result.part_masks[frames]

    def iou(a: int, b: int) -> float:
        both, either = ((masks == a) & (true == b)).sum(), ((masks == a) | (true == b)).sum()
        return float(both / either) if either else 1.0

    return result.exchanged() if iou(1, 2) + iou(2, 1) > iou(1, 1) + iou(2, 2) else result


def axis_point(joint: Joint, near: ArrayLike) -> Array:
    """(3,) the axis point nearest to `near`; of a prismatic joint `near` itself, as its axis has no place."""
    near = np.asarray(near, float)
    return near if joint.type == "prismatic" else joint.pivot + joint.axis * (joint.axis @ (near - joint.pivot))
