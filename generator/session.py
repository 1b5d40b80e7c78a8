"""Records one object with its planned motion as a sequence folder and a truth folder."""

from __future__ import annotations

import shutil
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import catalog
from freeart21.camera import Camera
from freeart21.camera_faults import ROOM_M
from freeart21.effects import Effect, effect_from_json
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset import EFFECTS_SCHEMA
from freeart21.files.camera_faults import read_camera_faults
from freeart21.files.hashes import file_sha256
from freeart21.files.sequence import MAX_SIDE, encode_depth, write_header, write_queries
from freeart21.files.take import MAX_TAKE_BYTES
from freeart21.files.truth import write_truth
from freeart21.files.urdf import MAX_URDF_BYTES
from freeart21.formats.captured import read_track
from freeart21.formats.third_party import Parts, assign_parts
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.se3 import Array
from freeart21.truth import Truth
from generator import objects, partnet, urdf_object
from generator.frame_writer import FrameWriter
from generator.model import ObjectModel
from generator.motion import PRESETS, STYLES, Plan, motion_range, plan_motion
from generator.motion import track as tracks
from generator.motion.body import Body
from generator.motion.planner import camera_in_world
from generator.partnet_writer import write_partnet
from generator.progress import Progress
from generator.queries import PlannedQuery, plan_queries
from generator.release import roll_out_release
from generator.scene import Picture, Scene, simulator
from generator.sensor import Sensor
from generator.sensors import check_sensor
from generator.truth_mesh import build_truth
from generator.urdf_object import LoadedObject

LICENCES = {
    "procedural": "CC0-1.0",
    "partnet": "PartNet-Mobility terms of use; not to be redistributed",
    "urdf": "that of the object",
}
"""Licence of a recording by the source of its object."""

ACCESS = "https://sapien.ucsd.edu/downloads"
"""Where to ask for PartNet-Mobility."""

_PICTURES = ("sequence/rgb", "sequence/depth", "sequence/mask", "side")
"""Folders in the work folder, each with one picture a frame; `side` holds true labels for the truth folder."""

TRACK = "track"
"""The motion that replays a take; `RecordSettings.track` is its file."""

SHADERS = ("default", "trivial")
"""SAPIEN's camera shaders that give all pictures that the recorder needs."""

MAX_PICTURES = 100_000
"""Of frames, and of held-out views: their files are numbered with five digits."""
MAX_PIXELS = 1 << 24
"""Pixels of a picture, 4096 x 4096: with 3 bytes each below the 64 MiB that `checked` reads of one file."""

MAX_CARRY = 100.0
"""Largest factor on a take's translation: from millimetres to the size of a room. Not measured."""

_PNG_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"


@dataclass(frozen=True)
class RecordSettings:
    """How one object is recorded."""

    frames: int = 300
    """Number of pictures of the video."""
    seed: int = 0
    """Seed of the object's sizes and colours, the motion, the sensor and the held-out views."""
    width: int = 640
    height: int = 360
    """Size of the pictures, pixels."""
    fov_y_degrees: float | None = None
    """Vertical field of view, degrees; None takes the preset's."""
    fps: float = 30.0
    """Pictures per second."""
    queries: int = 20
    """Number of held-out views."""
    motion: str = "tumble"
    """How the object is moved: one of `generator.motion.STYLES`, or TRACK."""
    track: Path | None = None
    """File of the take that the motion TRACK replays (`freeart21.formats.captured.read_track`)."""
    carry: float | None = None
    """Factor on the translation of a take whose poses are changes since its first; None scales it by the sizes of the
    objects (`generator.motion.track.scale_translation`)."""
    preset: str = "handheld"
    """Size and distance of the object: one of `generator.motion.PRESETS`."""
    sensor: str = "clean"
    """What the camera adds: one of `generator.sensors.SENSORS`, or several joined by '+'."""
    camera: Path | None = None
    """camera.json with the faults of a real camera (`freeart21.camera_faults`), applied after the sensor."""
    effects: Path | None = None
    """effects.json of the released joint, for the motion 'release'."""
    let_go: float | None = None
    """Start of the released joint, as a share of its range from the lower limit; None draws it from the seed."""
    partnet_root: Path | None = None
    """Folder with PartNet-Mobility objects, one folder for each id."""
    urdf: Path | None = None
    """URDF of an object that is not in the catalog."""
    root: Path | None = None
    """Folder that holds all files that `urdf` names; None takes the URDF's own folder, or its package's."""
    joint: str | None = None
    """Scored joint; None takes the catalog's, or the only movable one."""
    skip_missing: bool = False
    """Leave out absent mesh files instead of refusing the object."""
    shader: str = "default"
    """SAPIEN's camera shader, one of `SHADERS`.

    'default' lights the object: highlights and shading that change with its pose are part of the task. 'trivial' is
    unlit, three times as fast and needs no compilation; it is for tests. 'minimal' is not allowed: the steps of its
    depth are a millimetre.
    """
    edge: float = 0.02
    """Longest edge of the truth meshes, as a share of the object's diagonal."""
    visible_every: int = 3
    """Frames between those in which the truth's visible faces are searched."""

    def check(self) -> None:
        """Raise FreeArtError, in one line, when these settings cannot be recorded."""
        if self.seed < 0:
            raise FreeArtError(f"cannot draw from seed {self.seed}; expected 0 or more")
        if self.frames < 2 or self.fps <= 0 or self.queries < 0 or min(self.width, self.height) < 16:
            raise FreeArtError(
                f"cannot record {self.frames} frames of {self.width} x {self.height} at {self.fps:g} a second with "
                f"{self.queries} held-out views; expected at least 2 frames of 16 x 16, more than 0 a second and 0 "
                "views or more"
            )
        if max(self.frames, self.queries) > MAX_PICTURES:
            raise FreeArtError(
                f"cannot record {self.frames} frames and {self.queries} held-out views; expected at most "
                f"{MAX_PICTURES} each: their files are numbered by five digits"
            )
        if max(self.width, self.height) > MAX_SIDE or self.width * self.height > MAX_PIXELS:
            raise FreeArtError(
                f"cannot record pictures of {self.width} x {self.height}; expected at most {MAX_SIDE} a side and "
                f"{MAX_PIXELS} pixels (4096 x 4096) in all: readers take no larger ones"
            )
        if (self.motion == TRACK) != (self.track is not None):
            raise FreeArtError("the motion track needs the file of a take, and only it has one; expected track:FILE")
        if self.track is not None:
            checked.require_file(self.track, MAX_TAKE_BYTES, checked.ANYWHERE)
        if self.carry is not None and not (self.track is not None and 0 <= self.carry <= MAX_CARRY):
            raise FreeArtError(
                f"the way cannot be scaled by {self.carry:g} in the motion {self.motion}; expected 0 to "
                f"{MAX_CARRY:g}, and the motion track:FILE"
            )
        motions = (*STYLES, TRACK)
        named = ("motion", self.motion, motions), ("preset", self.preset, PRESETS), ("shader", self.shader, SHADERS)
        for what, value, known in named:
            if value not in known:
                raise FreeArtError(f"unknown {what} '{value}'; {what}s: {', '.join(known)}")
        check_sensor(self.sensor)
        if self.camera is not None:
            read_camera_faults(self.camera)
        if self.effects is not None and self.motion != "release":
            raise FreeArtError(
                f"effects act on a joint that is let go: they go with the motion release, not {self.motion}"
            )
        if self.let_go is not None and not (self.motion == "release" and 0 <= self.let_go <= 1):
            raise FreeArtError(
                f"the joint cannot be let go at {self.let_go:g} of its range in the motion {self.motion}; expected 0 "
                "to 1, and the motion release"
            )

    def to_json(self) -> dict[str, Any]:
        """All that decides the recording's bytes, as JSON, without paths of this machine."""
        facts = asdict(self)
        del facts["partnet_root"], facts["root"]
        facts["effects"] = None if self.effects is None else checked.read_json(self.effects, root=checked.ANYWHERE)
        facts["camera"] = None if self.camera is None else checked.read_json(self.camera, root=checked.ANYWHERE)
        for later in ("let_go", "track", "urdf", "camera"):
            if getattr(self, later) is None:
                del facts[later]  # older recordings have no such key
        if self.track is None:
            del facts["carry"]
        if self.urdf is not None:
            facts["urdf"] = {"name": self.urdf.name, "sha256": urdf_object.digest(self.urdf, self.root)}
        if self.track is not None:
            facts["track"] = {"name": self.track.name, "sha256": file_sha256(self.track, checked.ANYWHERE)}
        return facts


def record_object(name: str, settings: RecordSettings, work: Path, progress: Progress) -> None:
    """Record the object `name` into `work/sequence` and `work/truth`, both complete.

    After an interruption the same call continues: existing frames are kept, missing ones drawn, and the result is the
    same to the last byte. `truth` appears last. Raises FreeArtError when the object's files are unfit, this machine
    cannot render, or the disk refuses.
    """
    if (work / "truth").is_dir():
        return
    atomic.remove_leftovers(work)
    entry = catalog_entry(name, settings)
    loaded = load_object(entry, settings, work / "object")
    released = settings.motion == "release" and entry.source == "procedural"
    session = Session(loaded, settings, work, progress, build_model(entry.name, settings) if released else None)
    session.film()
    parts = session.parts()
    views = session.plan_views(parts)
    write_queries(work / "sequence", tuple(view.query for view in views))
    times_s = np.arange(settings.frames) / settings.fps
    gravity = -session.plan.Ts_camera_world[:, :3, 2]
    write_header(work / "sequence", session.camera, session.depth_scale, times_s, LICENCES[entry.source], gravity)
    facts = {"object": name, "category": loaded.category, "object_source": entry.source}
    rough = work / "rough_truth"
    shutil.rmtree(rough, ignore_errors=True)
    write_truth(rough, session.truth(parts, views, facts), len(views))
    try:
        np.savez_compressed(rough / "world.npz", T_camera_world=session.plan.Ts_camera_world)
        if entry.source == "procedural":
            checked.copy_folder(work / "object" / name, rough / "object")
        rough.replace(work / "truth")
    except OSError as error:
        raise atomic.cannot_write(work / "truth", error) from error


def resolve_name(name: str, settings: RecordSettings) -> tuple[str, RecordSettings]:
    """The object's name, and the settings with its URDF when `name` is the path of one."""
    if not name.lower().endswith(urdf_object.URDF_ENDINGS):
        return name, settings
    urdf = checked.require_file(Path(name), MAX_URDF_BYTES, checked.ANYWHERE)
    return urdf_object.object_name(Path(name)), replace(settings, urdf=urdf)


def catalog_entry(name: str, settings: RecordSettings) -> catalog.CatalogEntry:
    """The catalog's entry of `name`, or a new one for the settings' URDF or a PartNet-Mobility id."""
    if settings.urdf is not None:
        return catalog.CatalogEntry(name, "unknown", None, None, "urdf", None)
    return catalog.find(name, partnet=settings.partnet_root is not None)


def load_object(entry: catalog.CatalogEntry, settings: RecordSettings, place: Path) -> LoadedObject:
    """The object of the catalog's `entry`, or of the settings' URDF.

    The folder of a procedural object is written in `place` unless it exists; it gets the preset's size. Other files are
    the user's.
    """
    if settings.urdf is not None:
        return urdf_object.load_urdf(settings.urdf, settings.joint, settings.skip_missing, settings.root)
    folder = (
        place / entry.name if entry.source == "procedural" else find_partnet_folder(entry.name, settings.partnet_root)
    )
    if entry.source == "procedural" and not folder.is_dir():
        write_partnet(build_model(entry.name, settings), folder)
    return partnet.load(folder, settings.joint or entry.joint, settings.skip_missing)


def build_model(name: str, settings: RecordSettings) -> ObjectModel:
    """The procedural object `name`, of the settings' seed and preset's size."""
    model, diagonal = objects.build(name, settings.seed), PRESETS[settings.preset].diagonal_m
    return model if diagonal is None else model.scaled(diagonal / model.diagonal)


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
    carry, way_changes = tracks.scale_translation(take, diagonal, s.carry)
    R_first = None
    if take.poses == "first":
        scripted = plan_motion("tumble", body.meshes, loaded.joint, camera, s.frames, s.fps, s.seed, preset)
        R_first = scripted.Ts_camera_object[0, :3, :3]
    Ts = tracks.object_poses(body, stretch, states, take, R_first, camera, preset, carry)
    if take.poses == "camera" and way_changes:
        Ts, more = tracks.move_away(Ts, states, body, camera)
        way_changes["carry"] *= more
    facts: dict[str, Any] = {
        "name": take.name,
        "sha256": take.sha256,
        "form": take.form,
        "device": take.device,
        "poses": take.poses,
    }
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


def find_partnet_folder(name: str, root: Path | None) -> Path:
    """The folder of the PartNet-Mobility object `name`; FreeArtError when it is absent, with where to ask for it."""
    if root is None:
        raise FreeArtError(
            f"object '{name}' is from PartNet-Mobility: give the folder that holds {name} as --partnet-root; "
            f"access to the dataset: {ACCESS}"
        )
    folder = partnet.find_folder(name, root)
    if folder is None:
        raise FreeArtError(
            f"PartNet-Mobility object {name} is not in {root}; ask for access to the dataset at {ACCESS} and unpack it "
            f"so that {root / name / partnet.URDF_NAME} exists"
        )
    return folder


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
        """Draw all frames of the video that are not in the work folder yet.

        While a frame is encoded and written, the renderer draws the next one. Raises FreeArtError when a picture is
        empty although nothing hides the object: a software renderer was seen to fail like this under heavy load.
        """
        n = self.settings.frames
        is_complete = [all(_is_complete_png(self._work / sub / f"{i:05d}.png") for sub in _PICTURES) for i in range(n)]
        with FrameWriter() as writer:
            for i in range(n):
                if is_complete[i]:
                    side = self._side(i)
                else:
                    shot = self.sensor.shoot(i)
                    if i + 1 < n and not is_complete[i + 1]:
                        self.sensor.start_drawing(i + 1)
                    side = shot.side
                    if not self._may_hide:
                        self._require_seen(side, f"frame {i}")
                    mask = shot.mask.view(np.uint8) * np.uint8(255)
                    images = shot.rgb, encode_depth(shot.depth, self.depth_scale), mask, side
                    writer.put({self._work / sub / f"{i:05d}.png": m for sub, m in zip(_PICTURES, images, strict=True)})
                self._counts[i] = np.count_nonzero(side == 1), np.count_nonzero(side == 2)
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


def _is_complete_png(path: Path) -> bool:
    """Whether a PNG file exists and ends properly: after a power cut files may lack their content."""
    try:
        return checked.read_bytes(path, checked.MAX_IMAGE_BYTES).endswith(_PNG_END)
    except FreeArtError:
        return False
