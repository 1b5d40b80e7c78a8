"""The 3D view of two parts and their joint, of others over them, and of a file of Gaussians."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.gaussians import Gaussians
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal, box_centre
from freeart21.reconstruction import Reconstruction
from freeart21.se3 import Array
from freeart21.truth import Truth
from freeart21.view.document import MOVING, REFERENCE
from freeart21.view.scene import Layer, Link, Scene, Slider, Surface, axis_mesh, axis_point, find_focus, slider_range
from freeart21.view.splats import SplatLayers

AXIS = "#AA3377"
"""Colour of the estimated joint axis."""
LAYERS = Layer("reference part", REFERENCE), Layer("moving part", MOVING), Layer("joint axis", AXIS, "axis")
FIRST_VIEW = np.array([0.45, -0.4, -1.0])
"""Direction to the first viewpoint in the camera frame (x right, y down, z away from the camera)."""
MAX_SPLATS_ALONE = 350_000
"""Gaussians in a page of nothing else, 14 MB; from 500,000 on textures exceed what WebGL 2 guarantees."""


@dataclass(frozen=True)
class Alignment:
    """How a truth is laid over an estimate: frames by the reference part's poses, states by sign and median offset."""

    T_pred_truth: Array
    """(4, 4) the estimate's canonical frame from the truth's: inverse of the robust mean over all frames."""
    sign: float
    """-1 when the two axes point in opposite directions, else 1."""
    offset: float
    """Rad or m: a true state q is the state `sign * q + offset` of the estimate."""
    comparable: bool
    """Whether the joints are of one type, so that states can be compared."""

    def states(self, truth: Truth) -> NDArray[np.float64]:
        """The true states (n,) with the sign and zero of the estimate."""
        return self.sign * truth.states + self.offset

    def joint(self, truth: Truth) -> Joint:
        """The true joint in the estimate's frame, with the sign and zero of its states."""
        joint = truth.articulation.joint.moved(self.T_pred_truth)
        joint = joint if self.sign > 0 else joint.reversed()
        return replace(joint, lower=joint.lower + self.offset, upper=joint.upper + self.offset)


def align(result: Reconstruction, truth: Truth) -> Alignment:
    """Lay a truth over a result whose parts are matched (see `matched`)."""
    T_truth_pred = se3.mean_pose(se3.inverse(truth.Ts_camera_reference) @ result.Ts_camera_reference)
    T_pred_truth = se3.inverse(T_truth_pred)
    estimate, true = result.articulation.joint, truth.articulation.joint
    sign = 1.0 if estimate.axis @ (T_pred_truth[:3, :3] @ true.axis) >= 0 else -1.0
    comparable = estimate.type == true.type
    offset = state_offset(result.states - sign * truth.states, estimate.type) if comparable else 0.0
    return Alignment(T_pred_truth, sign, offset, comparable)


def state_offset(difference: NDArray[np.float64], joint_type: str) -> float:
    """The median of state differences (n,), of angles near their mean direction."""
    if joint_type == "revolute":
        centre = float(np.angle(np.exp(1j * difference).mean()))
        difference = centre + np.angle(np.exp(1j * (difference - centre)))
    return float(np.median(difference))


def matched(result: Reconstruction, truth: Truth) -> Reconstruction:
    """The result, its part names exchanged when that gives a better mean part IoU with the truth."""
    n = len(truth)
    frames = np.unique(np.linspace(0, n - 1, min(n, 20)).round().astype(int))
    true = np.stack([truth.part_mask(i) for i in frames])
    masks = result.part_masks[frames]

    def iou(a: int, b: int) -> float:
        both, either = ((masks == a) & (true == b)).sum(), ((masks == a) | (true == b)).sum()
        return float(both / either) if either else 1.0

    return exchanged(result) if iou(1, 2) + iou(2, 1) > iou(1, 1) + iou(2, 2) else result


def exchanged(result: Reconstruction) -> Reconstruction:
    """The same motion with 'reference' and 'moving' exchanged."""
    a, look = result.articulation, result.appearance
    return replace(
        result,
        articulation=Articulation(replace(a.joint, axis=-a.joint.axis), a.moving, a.reference),
        Ts_camera_reference=result.Ts_camera_moving,
        Ts_camera_moving=result.Ts_camera_reference,
        part_masks=np.array([0, 2, 1], np.uint8)[result.part_masks],
        seen=result.seen[:, ::-1],
        covariances=None if result.covariances is None else result.covariances[:, ::-1],
        alternatives=tuple(replace(o, joint=replace(o.joint, axis=-o.joint.axis)) for o in result.alternatives),
        appearance=look and replace(look, part_weights=1 - look.part_weights),
    )


def articulation_scene(
    articulation: Articulation,
    states: NDArray[np.float64],
    Ts_camera_reference: Array,
    camera: Camera | None = None,
    appearance: Gaussians | None = None,
    layers: tuple[Layer, Layer, Layer] = LAYERS,
) -> Scene:
    """Two parts (surfaces, Gaussians), the joint axis, and a slider that can follow the states (n,) of the video.

    `layers` are those of reference part, moving part and axis.
    """
    scene = Scene(
        links=(),
        sliders=(),
        layers=(),
        surfaces=(),
        **seen_from(Ts_camera_reference[0]),
        camera=camera,
        Ts_camera_world=Ts_camera_reference,
        splats=None if not appearance else SplatLayers(appearance, (0, 1), (0, 1)),
    )
    return with_articulation(scene, layers, articulation, states)


def seen_from(T_camera_world: Array) -> dict[str, Any]:
    """`up` and `towards_viewer` of a scene that is first seen from near a camera (4, 4)."""
    R_world_camera = T_camera_world[:3, :3].T
    return {"up": R_world_camera @ [0.0, -1.0, 0.0], "towards_viewer": R_world_camera @ FIRST_VIEW}


def with_articulation(
    scene: Scene,
    layers: tuple[Layer, Layer, Layer],
    articulation: Articulation,
    states: NDArray[np.float64],
    aligned: tuple[float, float] | None = None,
) -> Scene:
    """The scene with two parts and their axis, in its frame, on layers of their own.

    Args:
        scene: Without anything, or with other parts.
        layers: Of the reference part, the moving part and the axis.
        articulation: The parts and their joint.
        states: (n,) of the joint, in the video.
        aligned: Scale and offset that give its state from the scene's first slider; None for a slider of its own.
    """
    joint, first, root = articulation.joint, len(scene.layers), len(scene.links)
    (near, size), sliders = axis_place(articulation, states), scene.sliders
    if aligned is None:
        name = f"{layers[0].name}: {joint.type}" if sliders else joint.name
        ends = slider_range(joint, states, size)
        sliders = (*sliders, Slider(name, joint.type, *ends, float(states[0]), np.asarray(states, float)))
        moving = Link(root, joint=joint, slider=len(sliders) - 1)
    else:
        moving = Link(root, joint=joint, slider=0, scale=aligned[0], offset=aligned[1])
    meshes = articulation.reference, articulation.moving, axis_mesh(joint, near, size)
    added = (Surface(_without_single_colour(mesh), root + (k == 1), first + k) for k, mesh in enumerate(meshes))
    scene = replace(
        scene,
        links=(*scene.links, Link(-1), moving),
        sliders=sliders,
        layers=(*scene.layers, *layers),
        surfaces=(*scene.surfaces, *added),
    )
    return replace(scene, focus=scene.focus or find_focus(scene))


def with_truth(scene: Scene, truth: Truth, alignment: Alignment, layers: tuple[Layer, Layer, Layer]) -> Scene:
    """The scene of a result with the true parts and axis over it, moved by the same slider.

    When the joint types differ the truth gets a slider of its own.
    """
    true, sign = truth.articulation.moved(alignment.T_pred_truth), alignment.sign
    true = replace(true, reference=replace(true.reference, colours=None), moving=replace(true.moving, colours=None))
    if alignment.comparable:
        slider, states = scene.sliders[0], alignment.states(truth)
        ends = min(slider.lower, float(states.min())), max(slider.upper, float(states.max()))
        scene = replace(scene, sliders=(replace(slider, lower=ends[0], upper=ends[1]), *scene.sliders[1:]))
    aligned = (sign, -sign * alignment.offset) if alignment.comparable else None  # q_truth = sign * (q - offset)
    return with_articulation(scene, layers, true, truth.states, aligned)


def gaussians_scene(gaussians: Gaussians) -> Scene:
    """Gaussians alone, y down and z away from the viewer as in the first camera of a video."""
    layers: tuple[Layer, ...] = (Layer("Gaussians", REFERENCE),)
    if (gaussians.part_weights < 1).any():
        layers = LAYERS[:2]
    splats = SplatLayers(gaussians, (0, 0), (0, len(layers) - 1), MAX_SPLATS_ALONE)
    return Scene((Link(-1),), (), layers, (), **seen_from(np.eye(4)), splats=splats)


def axis_place(articulation: Articulation, states: NDArray[np.float64]) -> tuple[Array, float]:
    """Where and how large to draw the axis: middle (3,) of the moving part in frame 0, and the object's diagonal, m.

    Without a moving part, the middle of the reference part, or the pivot.
    """
    moving = articulation.moving.moved(articulation.joint.transform(float(states[0])))
    size = bounding_diagonal(articulation.reference, moving) or 1.0
    for mesh in (moving, articulation.reference):
        if not mesh.empty:
            return box_centre(mesh), size
    return np.asarray(articulation.joint.pivot, float), size


def axis_in_images(joint: Joint, near: ArrayLike, size: float, Ts_camera: Array, camera: Camera) -> NDArray[np.float64]:
    """(n, 2, 2) both ends of the joint axis in every image, pixels, positive end last; NaN where behind the camera.

    The line is centred at the axis point nearest to `near` (3,) and 1.2 times `size` (m) long; `Ts_camera` (n, 4, 4) is
    the camera from the joint's frame.
    """
    ends = axis_point(joint, near) + 0.6 * size * np.array([[-1.0], [1.0]]) * joint.axis
    seen = se3.transform(Ts_camera, np.broadcast_to(ends, (len(Ts_camera), 2, 3)))
    # an end behind the camera is moved along the line to just in front of it
    closest = 0.02 * size
    z, other = seen[..., 2], seen[:, ::-1]
    part = np.clip((closest - z) / np.where(other[..., 2] == z, 1.0, other[..., 2] - z), 0.0, 1.0)
    clipped = np.where((z < closest)[..., None], seen + part[..., None] * (other - seen), seen)
    return np.where((z.max(1) > closest)[:, None, None], camera.project(clipped), np.nan)


def _without_single_colour(mesh: Mesh) -> Mesh:
    """The mesh without its vertex colours when they are all the same, so that it gets its part's colour."""
    same = mesh.colours is not None and (mesh.colours == mesh.colours[:1]).all()
    return replace(mesh, colours=None) if same else mesh
