"""Layouts of other projects' results: what a layout is, the user's options, and an imported result.

No adapter reads a truth. Pieces that a layout lacks stay None in an `ImportedResult`; `to_reconstruction` replaces them
by fillers of the right shape, and `common_lacks` lists them, so that metrics that need them get no value.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.errors import FreeArtError
from freeart21.formats import freeart21_official
from freeart21.formats.third_party import T_GL_CV
from freeart21.formats.video2articulation import R_OBJECT_LABEL
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import PIECES, Failure, Piece, Reconstruction
from freeart21.recording import Recording
from freeart21.registry import find_instances
from freeart21.se3 import Array

Axes = Literal["opencv", "opengl"]
Frame = Literal["camera", "opengl", "link", "label", "zup"]
FRAMES: tuple[str, ...] = get_args(Frame)
"""World frame of a layout whose files do not define it: the camera of the anchor frame (OpenCV or OpenGL axes), the
object's root link in its URDF (z up), the mesh files of PartNet-Mobility (label frame, y up), or these as PARIS turns
them for Blender, (x, -z, y)."""
IN_OBJECT: dict[str, Array] = {
    "link": np.eye(4),
    "label": se3.pose(R_OBJECT_LABEL, np.zeros(3)),
    "zup": se3.pose([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.zeros(3)),
}
"""T_link_world of the frames that are fixed to the object."""
_FILLER = Mesh(
    0.001 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)
"""A tetrahedron of a millimetre, in place of a missing mesh."""


@dataclass(frozen=True)
class Options:
    """What the user has to add because the files of a layout do not contain it."""

    frame: Frame | None = None
    """World frame of the layout; None: that of its own evaluator."""
    axes: Axes | None = None
    """Axes of its cameras; None: those of its own evaluator."""
    anchor: int = 0
    """Frame of the video that shows a result without poses, at joint state zero."""
    scale: float = 1.0
    """Metres per unit of length of the layout."""
    joint: str | None = None
    """Name or number of the joint to import, for layouts with several."""
    object_poses: Path | None = None
    """Official FreeArt-21 examples, whose object_poses.json has the object's poses."""


@dataclass(frozen=True)
class Request:
    """The sequence that a folder of a layout is imported for."""

    recording: Recording
    options: Options = field(default_factory=Options)

    @property
    def frames(self) -> int:
        """Number of frames of the video."""
        return len(self.recording)

    @property
    def anchor(self) -> int:
        """`options.anchor`; raises FreeArtError unless it is a frame of the video."""
        if not 0 <= self.options.anchor < self.frames:
            raise FreeArtError(
                f"{self.recording.name}: the anchor is frame {self.options.anchor}, expected 0 to {self.frames - 1}"
            )
        return self.options.anchor

    @functools.cached_property
    def foreground(self) -> NDArray[np.bool_]:
        """(n, height, width) the object's masks in the video."""
        return np.stack([self.recording.frame(i).mask for i in range(self.frames)])

    def T_camera_world(self, folder: Path, default: Frame) -> Array:
        """(4, 4) the anchor frame's camera from the layout's world: `options.frame`, else `default`.

        Raises FreeArtError when that frame is fixed to the object and the object's pose is unknown: neither
        `options.object_poses` nor an object_poses.json in `folder`.
        """
        frame = self.options.frame or default
        if frame == "camera":
            return np.eye(4)
        if frame == "opengl":
            return se3.inverse(T_GL_CV)
        example = self._find_example(folder)
        if example is None:
            raise FreeArtError(
                f"{folder} stands in the object's frame ({frame}), and the object's pose in the video is unknown: "
                "give --object-poses EXAMPLES (official FreeArt-21 examples, with object_poses.json and "
                "camera_params.json), or --frame camera if the method was run in the camera's frame"
            )
        Ts = freeart21_official.read_object_poses(example)
        if len(Ts) != self.frames:
            raise FreeArtError(f"{example} has {len(Ts)} object poses, the video has {self.frames} frames")
        return np.asarray(Ts[self.anchor] @ IN_OBJECT[frame])

    def _find_example(self, folder: Path) -> Path | None:
        given, name = self.options.object_poses, self.recording.name
        if given is None:
            return folder if (folder / "object_poses.json").is_file() else None
        official = name.replace("_", "-")  # official names have no '_'
        places = [given, *(parent / child for parent in (given, given / "examples") for child in (name, official))]
        found = [place for place in places if (place / "object_poses.json").is_file()]
        if not found:
            raise FreeArtError(f"{given} has no object_poses.json of {name}: looked for {given}/{name} and examples/")
        return found[-1]


@dataclass(frozen=True)
class ImportedResult:
    """The result in one folder of a layout: metres, radians, OpenCV cameras; None for what the layout lacks.

    The canonical frame is the reference part's, at an arbitrary place: `poses` or `anchor_pose` define it.
    """

    joint: Joint | None
    """In the canonical frame; None when the folder tracks one rigid body only."""
    states: Array | None = None
    """(n,) joint states, zero where the meshes stand."""
    poses: tuple[Array, Array] | None = None
    """T_camera_reference and T_camera_moving, (n, 4, 4) each."""
    anchor: int = 0
    anchor_pose: Array | None = None
    """(4, 4) T_camera_reference in the frame `anchor`, for layouts without poses; without states, at state zero."""
    masks: NDArray[np.uint8] | None = None
    """(n, height, width): 0 neither part, 1 reference, 2 moving."""
    meshes: tuple[Mesh, Mesh] | None = None
    """Reference and moving part, canonical frame, at state zero."""
    seen: NDArray[np.bool_] | None = None
    """(n,) frames with a result; None for all."""
    notes: tuple[str, ...] = ()
    """Remarks for the row of the score, one line each."""

    def lacks(self) -> set[Piece]:
        """The pieces that are None, and the held-out views, which no layout has."""
        pieces: dict[Piece, object] = {
            "joint": self.joint,
            "states": self.states,
            "poses": self.poses,
            "masks": self.masks,
            "meshes": self.meshes,
            "renders": None,
        }
        return {piece for piece, value in pieces.items() if value is None}


@dataclass(frozen=True)
class Layout:
    """One layout of another project's results."""

    name: str
    """Its name on the command line."""
    project: str
    """Name and address of the project."""
    source: str
    """repository@commit:paths that define its files, frames and units."""
    matches: Callable[[Path], bool]
    """Whether a folder holds the result of one sequence."""
    read: Callable[[Path, Request], ImportedResult | Failure]
    """The result in that folder; raises FreeArtError, one line, when it cannot be read."""
    subfolders: tuple[str, ...] = ()
    """Glob patterns of the project's result folder within a sequence's folder. Among several matches, the last in the
    order of the numbers in their names counts (the longest training)."""
    frame: Frame | None = None
    """World frame in its own evaluator; None when the files define it."""
    axes: Axes | None = None
    """Camera axes in its own evaluator; None when it has no cameras."""
    has_several_joints: bool = False
    """Whether a result can have several joints."""
    sequence_folders: Callable[[str], tuple[str, ...]] = lambda sequence: ()
    """The project's own folders for a sequence of that name, relative to the source."""


def to_reconstruction(result: ImportedResult, recording: Recording) -> Reconstruction:
    """`result` as an answer to `recording`, with fillers for what is None."""
    n, camera = len(recording), recording.camera
    joint = result.joint or Joint("unknown", "revolute", np.array([0.0, 0.0, 1.0]), np.zeros(3), -np.inf, np.inf)
    states = np.zeros(n) if result.states is None else result.states
    joint = joint.spanning(states) if result.states is not None else joint
    if result.poses is None:
        pose = np.eye(4) if result.anchor_pose is None else result.anchor_pose
        moving = pose @ joint.transform(states[result.anchor])
        poses = np.repeat(pose[None], n, 0), np.repeat(moving[None], n, 0)
    else:
        poses = result.poses
    masks = np.zeros((n, camera.height, camera.width), np.uint8) if result.masks is None else result.masks
    seen = np.ones(n, bool) if result.seen is None else result.seen
    Ts = tuple(se3.orthonormalised(T) for T in poses)
    parts = Articulation(joint, *(result.meshes or (_FILLER, _FILLER)))
    return Reconstruction(parts, states, Ts[0], Ts[1], masks, np.column_stack([seen, seen]), anchor=result.anchor)


def common_lacks(lacks: Sequence[set[Piece]]) -> tuple[Piece, ...]:
    """The pieces that every result lacks (`ImportedResult.lacks`): those that the method never produces."""
    absent = set.intersection(*lacks) if lacks else {"renders"}
    return tuple(piece for piece in PIECES if piece in absent)


@functools.cache
def layouts() -> dict[str, Layout]:
    """Name to layout: modules of this folder, and entry points `leaderboard.adapters` of other packages."""
    return find_instances("leaderboard.adapters", Layout)


def layout_named(name: str) -> Layout:
    """The layout `name`; FreeArtError lists the known ones."""
    if name not in layouts():
        raise FreeArtError(f"unknown layout '{name}'; known: {', '.join(layouts())}")
    return layouts()[name]
