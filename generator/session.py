"""Records one object with its planned motion as a sequence folder and a truth folder."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.camera import Camera
from freeart21.camera_faults import ROOM_M
from freeart21.effects import Effect, effect_from_json
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset import EFFECTS_SCHEMA
from freeart21.files.camera_faults import read_camera_faults
from freeart21.files.sequence import encode_depth, write_header, write_queries
from freeart21.files.truth import write_truth
from freeart21.formats.captured import read_track
from freeart21.formats.third_party import Parts, assign_parts
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.progress import Progress
from freeart21.se3 import Array
from freeart21.truth import Truth
from generator.model import ObjectModel
from generator.motion import PRESETS, STYLES, Plan, motion_range, plan_motion
from generator.motion import track as tracks
from generator.motion.body import Body
from generator.motion.planner import camera_in_world
from generator.object_source import find_object
from generator.queries import PlannedQuery, plan_queries
from generator.release import roll_out_release
from generator.scene import Picture, Scene, simulator
from generator.sensor import Sensor
from generator.settings import TRACK, RecordSettings
from generator.truth_mesh import build_truth
from generator.urdf_object import LoadedObject

LICENCES = {
    "procedural": "CC0-1.0",
    "partnet": "PartNet-Mobility terms of use; not to be redistributed",
    "urdf": "that of the object",
}
"""Licence of a recording by the source of its object."""

_PICTURES = ("sequence/rgb", "sequence/depth", "sequence/mask", "side")
"""Folders in the work folder, each with one picture a frame; `side` holds true labels for the truth folder."""


def record_object(name: str, settings: RecordSettings, work: Path, progress: Progress) -> None:
    """Record the object `name` into `work/sequence` and `work/truth`, both complete.

    `work` is an empty folder. Raises FreeArtError when the object's files are unfit, this machine cannot render, or the
    disk refuses.
    """
    source = find_object(name, settings)
    loaded = source.load(work / "object")
    released = settings.motion == "release" and source.entry.source == "procedural"
    session = Session(loaded, settings, work, progress, source.build() if released else None)
    session.film()
    parts = session.parts()
    views = session.plan_views(parts)
    write_queries(work / "sequence", tuple(view.query for view in views))
    times_s = np.arange(settings.frames) / settings.fps
    gravity = -session.plan.Ts_camera_world[:, :3, 2]
    licence = LICENCES[source.entry.source]
    write_header(work / "sequence", session.camera, session.depth_scale, times_s, licence, gravity)
    facts = {"object": name, "category": loaded.category, "object_source": source.entry.source}
    truth = work / "truth"
    write_truth(truth, session.truth(parts, views, facts), len(views))
    try:
        np.savez_compressed(truth / "world.npz", T_camera_world=session.plan.Ts_camera_world)
        if source.entry.source == "procedural":
            checked.copy_folder(work / "object" / name, truth / "object")
    except OSError as error:
        raise atomic.cannot_write(truth, error) from error


def plan_recording(
    loaded: LoadedObject, settings: RecordSettings, model: ObjectModel | None = None
) -> tuple[Camera, Plan]:
    """The camera and the planned motion. `model` gives the masses of a procedural object for the motion 'release'."""
    preset, s = PRESETS[settings.preset], settings
    fov_y = preset.fov_y_degrees if s.fov_y_degrees is None else s.fov_y_degrees
    camera = Camera.from_fov(s.width, s.height, np.radians(fov_y))
    if s.motion == TRACK:
        return camera, _plan_from_take(loaded, s, camera)
    meshes = loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()
    states = None
    if s.motion == "release":
        effects = () if s.effects is None else read_release_effects(s.effects, loaded.joint)
        low, high = motion_range(loaded.joint)
        start = None if s.let_go is None else low + s.let_go * (high - low)
        states = roll_out_release(loaded, effects, s.frames, s.fps, s.seed, start, model)
    return camera, plan_motion(s.motion, meshes, loaded.joint, camera, s.frames, s.fps, s.seed, preset, states)


def _plan_from_take(loaded: LoadedObject, settings: RecordSettings, camera: Camera) -> Plan:
    """The motion of the settings' take. Poses that are changes since the first start as the motion 'tumble' does."""
    assert settings.track is not None
    s, preset, take = settings, PRESETS[settings.preset], read_track(settings.track)
    body = Body.of((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()), loaded.joint)
    stretch = tracks.resample_take(take, s.fps, s.frames)
    states, state_changes = tracks.fit_states(stretch.states, take, body)
    diagonal = bounding_diagonal(*body.meshes)
    carry, way_changes = tracks.scale_translation(take, diagonal)
    R_first = None
    if take.poses == "first":
        scripted = plan_motion("tumble", body.meshes, loaded.joint, camera, s.frames, s.fps, s.seed, preset)
        R_first = scripted.Ts_camera_object[0, :3, :3]
    Ts = tracks.object_poses(body, stretch, states, take, R_first, camera, preset, carry)
    if take.poses == "camera" and way_changes:
        Ts, more = tracks.move_away(Ts, states, body, camera)
        way_changes["carry"] *= more
    facts: dict[str, Any] = {key: getattr(take, key) for key in ("name", "sha256", "form", "device", "poses")}
    if take.filter is not None:
        facts["filter"] = {"one_euro": asdict(take.filter)}
    plan = Plan(
        Ts,
        states,
        camera_in_world(STYLES["tumble"], Ts, body),
        facts | {"begins_s": stretch.begins_s} | state_changes | way_changes,
    )
    tracks.check_in_view(take.name, plan, body, camera, depth_bounds(Ts, diagonal)[0], s.fps)
    return plan


def depth_bounds(Ts_camera_object: Array, diagonal: float) -> tuple[float, float]:
    """Near and far clipping depth, metres, for an object of this diagonal at poses (n, 4, 4)."""
    reach = float(np.linalg.norm(Ts_camera_object[:, :3, 3], axis=1).max() + 2 * diagonal)
    return 1e-3 * reach, reach


def read_release_effects(path: Path, joint: Joint) -> tuple[Effect, ...]:
    """Read the joint's effects from an effects.json; FreeArtError when one of them cannot act on a released joint."""
    entries = checked.read_json(path, EFFECTS_SCHEMA, checked.ANYWHERE).get("joints")
    if not isinstance(entries, dict) or not all(isinstance(v, list) for v in entries.values()):
        raise FreeArtError(f"{path}: 'joints' must map joint names to lists of effects")
    if joint.name not in entries:
        raise FreeArtError(f"{path} has no joint '{joint.name}'; its joints: {', '.join(entries) or 'none'}")
    effects = tuple(effect_from_json(e, joint.type, f"{path} joint '{joint.name}'") for e in entries[joint.name])
    odd = [effect.name for effect in effects if effect.kind != "dynamics" or effect.acts == "command"]
    if odd:
        raise FreeArtError(
            f"{path} gives joint '{joint.name}' {', '.join(odd)}: a released joint takes effects of dynamics only, not "
            "of geometry, sensors or drives"
        )
    return effects


def nice_scale(least: float) -> float:
    """The smallest 1, 2 or 5 times a power of ten that is at least `least`."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(f"{next(power * k for k in (1, 2, 5, 10) if power * k >= least * (1 - 1e-12)):.1g}")


class Session:
    """The state of one recording: the scene, the planned motion, and a work folder for its pictures."""

    def __init__(
        self,
        loaded: LoadedObject,
        settings: RecordSettings,
        work: Path,
        progress: Progress,
        model: ObjectModel | None = None,
    ) -> None:
        self.loaded, self.settings, self._work, self._progress = loaded, settings, work, progress
        coarse = loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()
        diagonal = bounding_diagonal(*coarse)
        fine = [side.surface.subdivided(settings.edge * diagonal).mesh() for side in loaded.sides]
        self.meshes: tuple[Mesh, Mesh] = fine[0], fine[1]
        self.camera, self.plan = plan_recording(loaded, settings, model)
        near, far = depth_bounds(self.plan.Ts_camera_object, diagonal)
        self.depth_scale = nice_scale((far if settings.camera is None else 2 * far + ROOM_M) / 65000)
        groups = [side.links for side in loaded.sides]
        faults = None if settings.camera is None else read_camera_faults(settings.camera)
        self.scene = Scene(loaded.asset.urdf, groups, self.camera, near, far, settings.shader, loaded.asset.root)
        self.sensor = Sensor(
            settings.sensor, self.scene, self.plan, loaded, coarse, settings.seed, settings.fps, faults
        )
        self._may_hide = any(model.occludes for model in self.sensor.models)
        self._counts = np.zeros((settings.frames, 2), np.int64)
        self._done = 0

    def film(self) -> None:
        """Draw all frames of the video into the work folder.

        While a frame is encoded and written, the renderer draws the next one. Raises FreeArtError when a picture is
        empty although nothing hides the object: a software renderer was seen to fail like this under heavy load.
        """
        n = self.settings.frames
        with _png_writer() as put:
            for i in range(n):
                shot = self.sensor.shoot(i)
                if i + 1 < n:
                    self.sensor.start_drawing(i + 1)
                if not self._may_hide:
                    self._require_seen(shot.side, f"frame {i}")
                mask = (shot.side > 0).view(np.uint8) * np.uint8(255)
                images = shot.rgb, encode_depth(shot.depth, self.depth_scale), mask, shot.side
                put({self._work / sub / f"{i:05d}.png": image for sub, image in zip(_PICTURES, images, strict=True)})
                self._counts[i] = np.count_nonzero(shot.side == 1), np.count_nonzero(shot.side == 2)
                self._count_picture()

    def parts(self) -> Parts:
        """Choose the reference part: the side with more pixels over all frames."""
        plan = self.plan
        return assign_parts(self._counts, plan.Ts_camera_object, plan.states, self.loaded.joint, self._side)

    def plan_views(self, parts: Parts) -> tuple[PlannedQuery, ...]:
        """Plan the held-out views of the video."""
        meshes = self.meshes[parts.order[0]], self.meshes[parts.order[1]]
        n, seed = self.settings.queries, self.settings.seed
        return plan_queries(meshes, parts.joint, self.camera, parts.Ts_camera[0], self.plan.states, n, seed)

    def truth(self, parts: Parts, views: tuple[PlannedQuery, ...], facts: dict[str, Any]) -> Truth:
        """The truth of the video, with the held-out views rendered; these are clean for every sensor."""
        pictures = [self._view(i, view, parts) for i, view in enumerate(views)]
        return build_truth(
            self.meshes,
            parts,
            self.plan.states,
            self.camera,
            range(0, self.settings.frames, self.settings.visible_every),
            facts | simulator() | self._truth_source(parts.order),
            lambda i: pictures[i].rgb,
            lambda i: pictures[i].side > 0,
        )

    def _side(self, i: int) -> NDArray[np.uint8]:
        return checked.read_labels(self._work / "side" / f"{i:05d}.png")

    def _truth_source(self, order: tuple[int, int]) -> dict[str, Any]:
        settings, links = self.settings, [side.links for side in self.loaded.sides]
        track = {} if self.plan.source is None else {"track": self.plan.source}
        return track | {
            "seed": settings.seed,
            "motion": settings.motion,
            "sensor": settings.sensor,
            "shader": settings.shader,
            "joint": self.loaded.joint.name,
            "held": self.loaded.asset.held,
            "semantics": self.loaded.semantics,
            "notes": self.loaded.notes,
            "reference_links": links[order[0]],
            "moving_links": links[order[1]],
            "settings": settings.to_json(),
        }

    def _view(self, i: int, view: PlannedQuery, parts: Parts) -> Picture:
        """Render held-out view `i`. The lamps stay fixed in the world; the root link belongs to the parent side."""
        T_parent = (view.T_camera_reference, view.T_camera_reference @ parts.joint.transform(view.state))
        positions = {**self.loaded.asset.held, self.loaded.joint.name: view.state}
        query = view.query
        self.scene.set_camera(self.camera)
        T_camera_world = query.T_newcam_cam @ self.plan.Ts_camera_world[query.pose_of_frame]
        picture = self.scene.render(T_parent[parts.order.index(0)], positions, T_camera_world)
        self._require_seen(picture.side, f"held-out view {i}")
        self._count_picture()
        return picture

    @staticmethod
    def _require_seen(side: NDArray[np.uint8], what: str) -> None:
        if not side.any():
            raise FreeArtError(f"the renderer drew nothing of the object in {what}; run the same command again")

    def _count_picture(self) -> None:
        self._done += 1
        self._progress(self._done, self.settings.frames + self.settings.queries)


@contextmanager
def _png_writer() -> Iterator[Callable[[dict[Path, NDArray[Any]]], None]]:
    """A function that writes pictures as PNG, each to its path; all are on disk when the context ends.

    The simulator holds Python's global lock while it draws, and a thread that wants the lock waits for a whole picture.
    So a thread only encodes, which needs no lock; the function returns when the encoding has started; and the caller's
    thread writes the encoded files. Memory is bounded: the function waits when all threads are busy.
    """
    started, waiting = threading.Semaphore(0), deque[list[tuple[Path, Future[bytes]]]]()

    def encode(image: NDArray[Any]) -> bytes:
        started.release()
        return checked.encode_png(image)

    def write_oldest() -> None:
        for path, future in waiting.popleft():
            atomic.write_bytes(path, future.result(), sync=False)

    def put(pictures: dict[Path, NDArray[Any]]) -> None:
        while waiting and all(future.done() for _, future in waiting[0]):
            write_oldest()
        waiting.append([(path, pool.submit(encode, image)) for path, image in pictures.items()])
        for _ in pictures:
            started.acquire()

    with ThreadPoolExecutor(min(max(4, os.cpu_count() or 1), 16), "png") as pool:
        yield put
        while waiting:
            write_oldest()
