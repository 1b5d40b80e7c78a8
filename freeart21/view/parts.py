"""The 3D view of two parts and their joint, with the true ones laid over them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.gaussians import Gaussians
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal, box_centre
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array
from freeart21.truth import Truth
from freeart21.view.document import MOVING, REFERENCE, TRUTH
from freeart21.view.scene import Layer, Link, Scene, Slider, Surface, axis_mesh, slider_range
from freeart21.view.splats import SplatLayers

AXIS = "#AA3377"
"""Colour of the predicted joint axis."""


@dataclass(frozen=True)
class Alignment:
    """How a truth lies over a prediction (metrics.md): frames by the reference part's poses, states by a median."""

    T_pred_truth: Array
    """(4, 4) the prediction's canonical frame from the truth's: the inverse of the robust mean over all frames."""
    sign: float
    """1, or -1 when the two axes point apart."""
    offset: float
    """Rad or m: a true state q is the state `sign * q + offset` of the prediction."""
    comparable: bool
    """False when the joints are of different types, so that their states cannot be compared."""

    def states(self, truth: Truth) -> NDArray[np.float64]:
        """The true states (n,) as the prediction counts them."""
        return self.sign * truth.states + self.offset

    def joint(self, truth: Truth) -> Joint:
        """The true joint in the prediction's frame, its states and limits as the prediction counts them."""
        joint = truth.articulation.joint.moved(self.T_pred_truth)
        joint = joint if self.sign > 0 else joint.reversed()
        return replace(joint, lower=joint.lower + self.offset, upper=joint.upper + self.offset)


def align(result: Reconstruction, truth: Truth) -> Alignment:
    """Lay a truth over a result whose parts are matched (see `matched`)."""
    T_truth_pred = se3.mean_pose(se3.inverse(truth.Ts_camera_reference) @ result.Ts_camera_reference)
    T_pred_truth = se3.inverse(T_truth_pred)
    found, true = result.articulation.joint, truth.articulation.joint
    sign = 1.0 if found.axis @ (T_pred_truth[:3, :3] @ true.axis) >= 0 else -1.0
    comparable = found.type == true.type
    difference = result.states - sign * truth.states
    if found.type == "revolute":
        middle = np.angle(np.exp(1j * difference).mean())
        difference = middle + np.angle(np.exp(1j * (difference - middle)))
    return Alignment(T_pred_truth, sign, float(np.median(difference)) if comparable else 0.0, comparable)


def matched(result: Reconstruction, truth: Truth) -> Reconstruction:
    """The result with its part names exchanged when they fit the truth better so, judged by mean part IoU."""
    n = len(truth)
    frames = np.unique(np.linspace(0, n - 1, min(n, 20)).round().astype(int))
    true = np.stack([truth.part_mask(i) for i in frames])
    found = result.part_masks[frames]

    def iou(a: int, b: int) -> float:
        both, either = ((found == a) & (true == b)).sum(), ((found == a) | (true == b)).sum()
        return float(both / either) if either else 1.0

    return exchanged(result) if iou(1, 2) + iou(2, 1) > iou(1, 1) + iou(2, 2) else result


def exchanged(result: Reconstruction) -> Reconstruction:
    """The same result with 'reference' and 'moving' exchanged: the same motion, seen from the other part."""
    a, look = result.articulation, result.appearance
    return replace(
        result,
        articulation=Articulation(replace(a.joint, axis=-a.joint.axis), a.moving, a.reference),
        Ts_camera_reference=result.Ts_camera_moving,
        Ts_camera_moving=result.Ts_camera_reference,
        part_masks=np.array([0, 2, 1], np.uint8)[result.part_masks],
        seen=result.seen[:, ::-1],
        covariances=None if result.covariances is None else result.covariances[:, ::-1],
        appearance=look and replace(look, part_weights=1 - look.part_weights),
    )


def articulation_scene(
    articulation: Articulation,
    states: NDArray[np.float64],
    Ts_camera_reference: Array,
    camera: Camera | None = None,
    appearance: Gaussians | None = None,
) -> Scene:
    """Two parts (surfaces, Gaussians), the joint axis, and a slider that can follow the states (n,) of the video."""
    joint = articulation.joint
    moving = joint.transform(float(states[0]))
    size = bounding_diagonal(articulation.reference, articulation.moving.moved(moving)) or 1.0
    lower, upper = slider_range(joint, states, size)
    slider = Slider(joint.name, joint.type, lower, upper, float(states[0]), np.asarray(states, float))
    R_world_camera = Ts_camera_reference[0, :3, :3].T
    return Scene(
        links=(Link(-1), Link(0, joint=joint, slider=0)),
        sliders=(slider,),
        layers=(Layer("reference part", REFERENCE), Layer("moving part", MOVING), Layer("joint axis", AXIS, "axis")),
        surfaces=(
            Surface(_told_apart(articulation.reference), 0, 0),
            Surface(_told_apart(articulation.moving), 1, 1),
            Surface(axis_mesh(joint, _centre(articulation, moving), size), 0, 2),
        ),
        up=R_world_camera @ [0.0, -1.0, 0.0],
        towards_viewer=R_world_camera @ [0.45, -0.4, -1.0],
        camera=camera,
        Ts_camera_world=Ts_camera_reference,
        splats=None if not appearance else SplatLayers(appearance, (0, 1), (0, 1)),
    )


def with_truth(scene: Scene, truth: Truth, alignment: Alignment) -> Scene:
    """The scene of a result with the true parts and the true axis over it, moved by the same slider.

    When the joint types differ the truth gets a slider of its own.
    """
    true = truth.articulation.moved(alignment.T_pred_truth)
    size = truth.diagonal or 1.0
    T_first = true.joint.transform(float(truth.states[0]))
    links, sliders = len(scene.links), scene.sliders
    if alignment.comparable:
        # q_truth = sign * (q - offset)
        moving = Link(
            links, joint=true.joint, slider=0, scale=alignment.sign, offset=-alignment.sign * alignment.offset
        )
        sliders = (_widened(sliders[0], alignment.states(truth)), *sliders[1:])
    else:
        moving = Link(links, joint=true.joint, slider=len(sliders))
        sliders = (
            *sliders,
            Slider(
                f"{true.joint.name} (truth)",
                true.joint.type,
                *slider_range(true.joint, truth.states, size),
                float(truth.states[0]),
                truth.states,
            ),
        )
    reference, moved, axis = range(len(scene.layers), len(scene.layers) + 3)
    return replace(
        scene,
        links=(*scene.links, Link(-1), moving),
        sliders=sliders,
        layers=(
            *scene.layers,
            Layer("true reference part", TRUTH, "ghost", False),
            Layer("true moving part", TRUTH, "ghost", False),
            Layer("true axis", TRUTH, "axis"),
        ),
        surfaces=(
            *scene.surfaces,
            Surface(replace(true.reference, colours=None), links, reference),
            Surface(replace(true.moving, colours=None), links + 1, moved),
            Surface(axis_mesh(alignment.joint(truth), _centre(true, T_first), size, 1.4), links, axis),
        ),
    )


def _widened(slider: Slider, states: NDArray[np.float64]) -> Slider:
    return replace(slider, lower=min(slider.lower, float(states.min())), upper=max(slider.upper, float(states.max())))


def _told_apart(mesh: Mesh) -> Mesh:
    """The mesh without its colours when they are all the same: it is then shown in the colour of its part."""
    same = mesh.colours is not None and (mesh.colours == mesh.colours[:1]).all()
    return replace(mesh, colours=None) if same else mesh


def _centre(articulation: Articulation, T_moving: Array) -> Array:
    """(3,) the middle of the moving part's box where `T_moving` puts it, or of the other when it is empty."""
    for mesh in (articulation.moving.moved(T_moving), articulation.reference):
        if not mesh.empty:
            return box_centre(mesh)
    return np.asarray(articulation.joint.pivot, float)


def axis_in_pictures(
    articulation: Articulation, states: NDArray[np.float64], Ts_camera_reference: Array, camera: Camera
) -> NDArray[np.float64]:
    """(n, 2, 2) both ends of the joint axis in every picture, pixels, positive end last; NaN where behind the camera.

    The line passes the moving part's middle and reaches a little beyond the object.
    """
    joint = articulation.joint
    moving = joint.transform(float(states[0]))
    near = _centre(articulation, moving)
    size = bounding_diagonal(articulation.reference, articulation.moving.moved(moving)) or 1.0
    at = near if joint.type == "prismatic" else joint.pivot + joint.axis * (joint.axis @ (near - joint.pivot))
    ends = at + 0.6 * size * np.array([[-1.0], [1.0]]) * joint.axis
    seen = se3.transform(Ts_camera_reference, np.broadcast_to(ends, (len(states), 2, 3)))
    # an end behind the camera is drawn in to just before it, along the line
    closest = 0.02 * size
    z, other = seen[..., 2], seen[:, ::-1]
    part = np.clip((closest - z) / np.where(other[..., 2] == z, 1.0, other[..., 2] - z), 0.0, 1.0)
    drawn = np.where((z < closest)[..., None], seen + part[..., None] * (other - seen), seen)
    pixels = camera.project(drawn)
    return np.where((z.max(1) > closest)[:, None, None], pixels, np.nan)
