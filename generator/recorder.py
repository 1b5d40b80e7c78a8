"""The recorder: one object becomes a sequence folder, which a method may see, and a truth folder, which it may not."""

from __future__ import annotations

import shutil
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
from freeart21.files.benchmark import write_benchmark
from freeart21.files.sequence import write_sequence
from freeart21.files.truth import write_truth
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.recording import Frame, Recording
from freeart21.se3 import Array
from freeart21.truth import Truth
from generator import objects, partnet
from generator.motion import plan_tumble
from generator.partnet_writer import write_partnet
from generator.progress import Progress, progress_bar
from generator.queries import plan_queries
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
        stack.callback(_remove_half, sequence, truth_folder)
        write_sequence(sequence, session.recording(LICENCES[entry.source]), session.depth_scale)
        facts = {"object": name, "category": loaded.category, "object_source": entry.source}
        write_truth(truth_folder, session.truth(facts), settings.queries)
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


def _remove_half(sequence: Path, truth: Path) -> None:
    """A video without its truth is no recording."""
    if sequence.exists() and not truth.exists():
        shutil.rmtree(sequence)


def nice_scale(least: float) -> float:
    """The smallest 1, 2 or 5 times a power of ten that is at least `least`."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(f"{next(power * k for k in (1, 2, 5, 10) if power * k >= least * (1 - 1e-12)):.1g}")


def other_way_round(joint: Joint) -> Joint:
    """The joint as motion of its parent side against its child side, with the same states: the axis turns round."""
    return replace(joint, axis=-joint.axis)


class _Session:
    """One recording under way: renders frames when asked, and remembers what the truth needs."""

    def __init__(self, loaded: partnet.PartNetObject, settings: RecordSettings, progress: Progress) -> None:
        self.loaded, self.settings, self._progress = loaded, settings, progress
        self.camera = Camera.from_fov(settings.width, settings.height, np.radians(settings.fov_y_degrees))
        coarse = loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()
        diagonal = bounding_diagonal(*coarse)
        fine = [side.surface.subdivided(settings.edge * diagonal).mesh() for side in loaded.sides]
        self.meshes: tuple[Mesh, Mesh] = fine[0], fine[1]
        self.plan = plan_tumble(coarse, loaded.joint, self.camera, settings.frames, settings.fps, settings.seed)
        self.queries = plan_queries(coarse, loaded.joint, self.camera, self.plan, settings.queries, settings.seed)
        reach = np.linalg.norm(self.plan.Ts_camera_object[:, :3, 3], axis=1).max() + 2 * diagonal
        self.depth_scale = nice_scale(reach / 65000)
        self.scene = Scene(
            loaded.asset.urdf, [side.links for side in loaded.sides], self.camera, 1e-3 * reach, reach, settings.shader
        )
        self._sides: dict[int, NDArray[np.uint8]] = {}
        self._views: dict[int, Picture] = {}

    def recording(self, licence: str) -> Recording:
        """The video; its frames are rendered when they are loaded."""
        times = np.arange(self.settings.frames) / self.settings.fps
        return Recording(self.camera, times, self._frame, tuple(q.query for q in self.queries), licence)

    def truth(self, facts: dict[str, Any]) -> Truth:
        """The truth, once all frames are rendered."""
        states, joint = self.plan.states, self.loaded.joint
        masks = [self._sides[i] for i in range(len(states))]
        counts = np.array([[np.sum(mask == 1), np.sum(mask == 2)] for mask in masks])
        order = (1, 0) if counts[:, 1].sum() > counts[:, 0].sum() else (0, 1)
        Ts_sides = self.plan.Ts_camera_object, self.plan.Ts_camera_object @ joint.transform(states)
        outer = outer_faces(self.meshes, self.loaded.joint)
        visible = visible_faces(
            self.meshes,
            self.camera,
            (
                (Ts_sides[0][i], Ts_sides[1][i], masks[i] > 0)
                for i in range(0, len(states), self.settings.visible_every)
            ),
        )
        label = np.array([0, 1 + order.index(0), 1 + order.index(1)], np.uint8)
        source = {
            **facts,
            **simulator(),
            "seed": self.settings.seed,
            "motion": self.settings.motion,
            "sensor": self.settings.sensor,
            "shader": self.settings.shader,
            "joint": joint.name,
            "held": self.loaded.asset.held,
            "semantics": self.loaded.semantics,
            "reference_links": self.loaded.sides[order[0]].links,
            "moving_links": self.loaded.sides[order[1]].links,
        }
        return Truth(
            Articulation(joint if order == (0, 1) else other_way_round(joint), *(self.meshes[k] for k in order)),
            states,
            Ts_sides[order[0]],
            Ts_sides[order[1]],
            counts[:, list(order)],
            (outer[order[0]] | visible[order[0]], outer[order[1]] | visible[order[1]]),
            (visible[order[0]], visible[order[1]]),
            lambda i: label[masks[i]],
            lambda i: self._view(i).rgb,
            lambda i: self._view(i).side > 0,
            source,
        )

    def _frame(self, index: int) -> Frame:
        picture = self._render(self.plan.Ts_camera_object[index], float(self.plan.states[index]))
        self._sides[index] = picture.side
        self._progress(index + 1, self.settings.frames + len(self.queries))
        return Frame(picture.rgb, picture.depth, picture.side > 0)

    def _view(self, index: int) -> Picture:
        if index not in self._views:
            planned = self.queries[index]
            self._views[index] = self._render(planned.T_camera_object, planned.state)
            self._progress(self.settings.frames + len(self._views), self.settings.frames + len(self.queries))
        return self._views[index]

    def _render(self, T_camera_object: Array, state: float) -> Picture:
        return self.scene.render(T_camera_object, {**self.loaded.asset.held, self.loaded.joint.name: state})


__all__ = ["LICENCES", "RecordSettings", "built_in_names", "nice_scale", "other_way_round", "record"]
