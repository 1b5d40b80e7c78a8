"""The recorder: one object becomes a sequence folder, which a method may see, and a truth folder, which it may not."""

from __future__ import annotations

import itertools
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from freeart21 import catalog
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.catalog import built_in_names
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.benchmark import write_benchmark
from freeart21.files.sequence import write_frame, write_header, write_queries
from freeart21.files.truth import write_truth
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.recording import Frame
from freeart21.se3 import Array
from freeart21.truth import Truth
from generator import objects, partnet
from generator.motion import plan_tumble
from generator.partnet_writer import write_partnet
from generator.progress import Progress, progress_bar
from generator.queries import PlannedQuery, plan_queries
from generator.scene import Picture, Scene, simulator
from generator.truth_mesh import outer_faces, visible_faces

LICENCES = {"procedural": "CC0-1.0", "partnet": "PartNet-Mobility terms of use; not to be redistributed"}
"""Licence of a recording by the source of its object."""


@dataclass(frozen=True)
class RecordSettings:
    """How one object is recorded."""

    frames: int = 300
    """Pictures of the video."""
    seed: int = 0
    """Of everything random: the object's sizes and colours, the motion, the held-out views."""
    width: int = 640
    height: int = 360
    """Size of the pictures, pixels."""
    fov_y_degrees: float = 40.0
    """Vertical field of view."""
    fps: float = 30.0
    """Pictures per second."""
    queries: int = 20
    """Held-out views."""
    shader: str = "default"
    """SAPIEN's camera shader: 'default', or 'trivial' (unlit, no compile wait) for tests."""
    partnet_root: Path | None = None
    """Folder that holds PartNet-Mobility objects, one folder an id."""
    joint: str | None = None
    """Scored joint; None takes the catalog's, or the only movable one."""
    skip_missing: bool = False
    """Leave out mesh files that an object names but does not have, rather than refuse the object."""
    motion: Literal["tumble"] = "tumble"
    """How the object is moved."""
    sensor: Literal["clean"] = "clean"
    """What the camera adds: 'clean' adds nothing."""
    edge: float = 0.02
    """Longest edge of the truth meshes, as a share of the object's diagonal."""
    visible_every: int = 3
    """Every how many frames the truth's visible faces are looked for."""


def record(name: str, out: Path, settings: RecordSettings | None = None) -> str:
    """Record the object `name` of the catalog into the data folder `out`; returns the new sequence's name.

    Writes `out/sequences/SEQ` and `out/truth/SEQ`, both or neither, and renews `out/benchmark.json`.
    A progress bar appears when standard error is a terminal. Raises FreeArtError when the object is unknown, its files
    are unfit, the sequence exists already, or this machine cannot render.
    """
    settings = settings or RecordSettings()
    _check(settings)
    out = Path(out)
    with ExitStack() as stack:
        entry = catalog.find(name, partnet=settings.partnet_root is not None)
        loaded = partnet.load(
            _object_folder(entry, settings, stack), settings.joint or entry.joint, settings.skip_missing
        )
        seq_id = _sequence_name(entry, loaded.joint.name, settings.seed)
        sequence, truth_folder = (out / sub / seq_id for sub in ("sequences", "truth"))
        for folder in (sequence, truth_folder):
            if folder.exists():
                raise FreeArtError(f"{folder} exists; choose another place or seed, or remove it first")
        session = _Session(loaded, settings, stack.enter_context(progress_bar(seq_id)))
        aside = stack.enter_context(atomic.new_folder(sequence))  # takes its name when the truth is written, too
        session.film(aside)
        parts = session.parts()
        views = session.plan_views(parts)
        write_queries(aside, tuple(view.query for view in views))
        times_s = np.arange(settings.frames) / settings.fps
        write_header(aside, session.camera, session.depth_scale, times_s, LICENCES[entry.source])
        facts = {"object": name, "category": loaded.category, "object_source": entry.source}
        write_truth(truth_folder, session.truth(parts, views, facts), len(views))
    write_benchmark(out, out.resolve().name, "1", "public")
    return seq_id


def _object_folder(entry: catalog.CatalogEntry, settings: RecordSettings, stack: ExitStack) -> Path:
    """The PartNet-Mobility folder of an object: the user's, or for a procedural object one that `stack` removes."""
    if entry.source == "procedural":
        place = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="freeart21-")))
        return write_partnet(objects.build(entry.name, settings.seed), place / entry.name)
    if settings.partnet_root is None:
        raise FreeArtError(
            f"object '{entry.name}' is from PartNet-Mobility: name the folder that holds {entry.name} by --partnet-root"
        )
    folder = settings.partnet_root / entry.name
    if not folder.is_dir():
        raise FreeArtError(
            f"PartNet-Mobility object {entry.name} is not in {settings.partnet_root}; ask for access to the dataset "
            f"and unpack it so that {folder / partnet.URDF_NAME} exists"
        )
    return folder


def _sequence_name(entry: catalog.CatalogEntry, joint: str, seed: int) -> str:
    """Such as 'stapler-s0' or '41083-joint_2-s0': the joint is named unless it is a procedural object's own."""
    own = entry.source == "procedural" and joint == entry.joint
    return f"{entry.name}-s{seed}" if own else f"{entry.name}-{joint}-s{seed}"


def _check(settings: RecordSettings) -> None:
    if settings.frames < 2 or settings.fps <= 0 or settings.queries < 0:
        raise FreeArtError(
            f"cannot record {settings.frames} frames at {settings.fps:g} a second with {settings.queries} "
            "held-out views; expected at least 2 frames, more than 0 a second and 0 views or more"
        )
    for what, value, known in (("motion", settings.motion, ("tumble",)), ("sensor", settings.sensor, ("clean",))):
        if value not in known:
            raise FreeArtError(f"unknown {what} '{value}'; {what}s: {', '.join(known)}")


def nice_scale(least: float) -> float:
    """The smallest 1, 2 or 5 times a power of ten that is at least `least`."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(f"{next(power * k for k in (1, 2, 5, 10) if power * k >= least * (1 - 1e-12)):.1g}")


def other_way_round(joint: Joint) -> Joint:
    """The joint as motion of its parent side against its child side, with the same states: the axis turns round."""
    return replace(joint, axis=-joint.axis)


@dataclass(frozen=True)
class _Parts:
    """Which side of the joint became the reference part, and what follows from it."""

    order: tuple[int, int]
    """Side (0 parent, 1 child) of the reference and of the moving part."""
    joint: Joint
    """Motion of the moving part against the reference part."""
    Ts_camera: tuple[Array, Array]
    """Poses (n, 4, 4) of reference and moving part."""
    seen: NDArray[np.int64]
    """(n, 2) pixels of reference and moving part."""


class _Session:
    """One recording under way: the scene, the planned motion, and which side each pixel of the video showed."""

    def __init__(self, loaded: partnet.PartNetObject, settings: RecordSettings, progress: Progress) -> None:
        self.loaded, self.settings, self._progress = loaded, settings, progress
        self.camera = Camera.from_fov(settings.width, settings.height, np.radians(settings.fov_y_degrees))
        coarse = loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()
        diagonal = bounding_diagonal(*coarse)
        fine = [side.surface.subdivided(settings.edge * diagonal).mesh() for side in loaded.sides]
        self.meshes: tuple[Mesh, Mesh] = fine[0], fine[1]
        self.plan = plan_tumble(coarse, loaded.joint, self.camera, settings.frames, settings.fps, settings.seed)
        reach = np.linalg.norm(self.plan.Ts_camera_object[:, :3, 3], axis=1).max() + 2 * diagonal
        self.depth_scale = nice_scale(reach / 65000)
        groups = [side.links for side in loaded.sides]
        self.scene = Scene(loaded.asset.urdf, groups, self.camera, 1e-3 * reach, reach, settings.shader)
        self._sides: list[NDArray[np.uint8]] = []
        self._done = 0

    def film(self, folder: Path) -> None:
        """Render all frames of the video into `folder`."""
        for i, (T, q) in enumerate(zip(self.plan.Ts_camera_object, self.plan.states, strict=True)):
            picture = self._render(T, float(q))
            write_frame(folder, i, Frame(picture.rgb, picture.depth, picture.side > 0), self.depth_scale)
            self._sides.append(picture.side)

    def parts(self) -> _Parts:
        """Reference and moving part of the video: the side with more pixels over all frames is the reference."""
        counts = np.array([[np.sum(side == 1), np.sum(side == 2)] for side in self._sides])
        order = (1, 0) if counts[:, 1].sum() > counts[:, 0].sum() else (0, 1)
        joint = self.loaded.joint
        Ts = self.plan.Ts_camera_object, self.plan.Ts_camera_object @ joint.transform(self.plan.states)
        own = joint if order == (0, 1) else other_way_round(joint)
        return _Parts(order, own, (Ts[order[0]], Ts[order[1]]), counts[:, list(order)])

    def plan_views(self, parts: _Parts) -> tuple[PlannedQuery, ...]:
        """The held-out views of the video."""
        meshes = self.meshes[parts.order[0]], self.meshes[parts.order[1]]
        return plan_queries(
            meshes,
            parts.joint,
            self.camera,
            parts.Ts_camera[0],
            self.plan.states,
            self.settings.queries,
            self.settings.seed,
        )

    def truth(self, parts: _Parts, views: tuple[PlannedQuery, ...], facts: dict[str, Any]) -> Truth:
        """The truth of the video; renders the held-out views.

        Faces that nothing outside can ever see (where solids of one part meet) are left out: no video tells of them,
        and handed in as an answer the truth must score perfect.
        """
        order, every = parts.order, self.settings.visible_every
        meshes = self.meshes[order[0]], self.meshes[order[1]]
        shown = ((T, U, side > 0) for T, U, side in zip(*parts.Ts_camera, self._sides, strict=True))
        visible = visible_faces(meshes, self.camera, itertools.islice(shown, 0, None, every))
        outer = [o | v for o, v in zip(outer_faces(meshes, parts.joint), visible, strict=True)]
        label = np.array([0, 1 + order.index(0), 1 + order.index(1)], np.uint8)
        pictures = [self._view(view, parts) for view in views]
        return Truth(
            Articulation(parts.joint, *(mesh.with_faces(o) for mesh, o in zip(meshes, outer, strict=True))),
            self.plan.states,
            *parts.Ts_camera,
            parts.seen,
            (outer[0][outer[0]], outer[1][outer[1]]),
            (visible[0][outer[0]], visible[1][outer[1]]),
            lambda i: label[self._sides[i]],
            lambda i: pictures[i].rgb,
            lambda i: pictures[i].side > 0,
            facts | simulator() | self._source(order),
        )

    def _source(self, order: tuple[int, int]) -> dict[str, Any]:
        settings, links = self.settings, [side.links for side in self.loaded.sides]
        return {
            "seed": settings.seed,
            "motion": settings.motion,
            "sensor": settings.sensor,
            "shader": settings.shader,
            "joint": self.loaded.joint.name,
            "held": self.loaded.asset.held,
            "semantics": self.loaded.semantics,
            "reference_links": links[order[0]],
            "moving_links": links[order[1]],
        }

    def _view(self, view: PlannedQuery, parts: _Parts) -> Picture:
        """A held-out view; the root link stands with the joint's parent side, whichever part that is."""
        T_parent = (view.T_camera_reference, view.T_camera_reference @ parts.joint.transform(view.state))
        return self._render(T_parent[parts.order.index(0)], view.state)

    def _render(self, T_camera_object: Array, state: float) -> Picture:
        picture = self.scene.render(T_camera_object, {**self.loaded.asset.held, self.loaded.joint.name: state})
        self._done += 1
        self._progress(self._done, self.settings.frames + self.settings.queries)
        return picture


__all__ = ["LICENCES", "RecordSettings", "built_in_names", "nice_scale", "other_way_round", "record"]
