"""How one object is recorded. Light to import: the command line reads its options and their help here."""

from __future__ import annotations

import ipaddress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Suppress

from freeart21.errors import FreeArtError

TRACK = "track"
"""The motion that replays a take; `RecordSettings.track` is its file."""

SHADERS = ("default", "trivial")
"""SAPIEN's camera shaders that give all pictures that the recorder needs."""

MAX_PICTURES = 100_000
"""Of frames, and of held-out views: their files are numbered with five digits."""
MAX_PIXELS = 1 << 24
"""Pixels of a picture, 4096 x 4096: with 3 bytes each below the 64 MiB that `checked` reads of one file."""


@dataclass(frozen=True)
class RecordSettings:
    """How one object is recorded."""

    frames: Annotated[int, Suppress] = 300
    """Number of pictures of the video."""
    seed: Annotated[int, Suppress] = 0
    """Seed of the object's sizes and colours, the motion, the sensor and the held-out views."""
    width: int = 640
    """Width of the pictures, pixels."""
    height: int = 360
    """Height of the pictures, pixels."""
    fov_y_degrees: Annotated[float | None, Suppress] = None
    """Vertical field of view, degrees; None takes the preset's."""
    fps: Annotated[float, Suppress] = 30.0
    """Pictures per second."""
    queries: int = 20
    """Number of held-out views."""
    motion: Annotated[str, Suppress] = "tumble"
    """How the object is moved: one of `generator.motion.STYLES`, or TRACK."""
    track: Annotated[Path | None, Suppress] = None
    """File of the take that the motion TRACK replays (`freeart21.formats.captured.read_track`)."""
    preset: str = "handheld"
    """handheld (real size, filling the picture) or paper (PartNet scale, 3 m away)."""
    sensor: str = "clean"
    """What the camera adds: clean, noise2, tof, phone, blur, hand, or several joined by '+'."""
    camera: Path | None = None
    """camera.json of `gap`: faults of a real camera, added to those of the sensor."""
    effects: Path | None = None
    """effects.json of the released joint, for the motion release."""
    let_go: float | None = None
    """Where the motion release lets the joint go, 0 to 1 of its range; from the seed when not given."""
    partnet_root: Path | None = None
    """Folder of PartNet-Mobility objects, as ROOT/41083/mobility.urdf or ROOT/dataset/41083."""
    urdf: Annotated[Path | None, Suppress] = None
    """URDF of an object that is not in the catalog."""
    root: Path | None = None
    """Folder with all files of a URDF; its own, or its package's, when not given."""
    joint: str | None = None
    """Moving joint, where several can move; the catalog's, or the only movable one, when not given."""
    skip_missing: bool = False
    """Leave out missing meshes of an object and, with `all`, objects missing in --partnet-root."""
    shader: str = "default"
    """SAPIEN's camera shader: default, or trivial (unlit, three times as fast, no compilation: for tests).

    'default' lights the object: highlights and shading that change with its pose are part of the task. 'minimal' is
    not allowed: the steps of its depth are a millimetre.
    """
    edge: Annotated[float, Suppress] = 0.02
    """Longest edge of the truth meshes, as a share of the object's diagonal."""
    visible_every: Annotated[int, Suppress] = 3
    """Frames between those in which the truth's visible faces are searched."""

    def check(self) -> None:
        """Raise FreeArtError, in one line, when these settings cannot be recorded."""
        from freeart21.files import checked
        from freeart21.files.camera_faults import read_camera_faults
        from freeart21.files.sequence import MAX_SIDE
        from freeart21.files.take import MAX_TAKE_BYTES
        from generator.motion import PRESETS, STYLES
        from generator.sensors import check_sensor

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
        from freeart21.files import checked
        from freeart21.files.hashes import file_sha256
        from generator import urdf_object

        facts = asdict(self)
        del facts["partnet_root"], facts["root"]
        facts["effects"] = None if self.effects is None else checked.read_json(self.effects, root=checked.ANYWHERE)
        facts["camera"] = None if self.camera is None else checked.read_json(self.camera, root=checked.ANYWHERE)
        for later in ("let_go", "track", "urdf", "camera"):
            if getattr(self, later) is None:
                del facts[later]  # older recordings have no such key
        if self.urdf is not None:
            facts["urdf"] = {"name": self.urdf.name, "sha256": urdf_object.digest(self.urdf, self.root)}
        if self.track is not None:
            facts["track"] = {"name": self.track.name, "sha256": file_sha256(self.track, checked.ANYWHERE)}
        return facts


SIDES = 64, 1280
"""Pixels that the live picture of teleoperation may have a side."""


@dataclass(frozen=True)
class TeleopSettings:
    """How an object is served for teleoperation."""

    host: str = "127.0.0.1"
    """Address to listen at; 0.0.0.0 for all of this machine. Others than 127.0.0.1 need --cert and --key: browsers give
    headsets to no other pages, and the address holds the secret."""
    port: int = 8021
    """Port to listen at; 0 takes a free one."""
    width: int = 640
    """Width of the live picture, pixels."""
    height: int = 360
    """Height of the live picture, pixels."""
    cert: Path | None = None
    """PEM file of your certificate, for https."""
    key: Path | None = None
    """PEM file of its private key."""

    def check(self) -> None:
        """Raise FreeArtError for settings that cannot be served."""
        low, high = SIDES
        if not (low <= min(self.width, self.height) and max(self.width, self.height) <= high):
            raise FreeArtError(
                f"cannot show live pictures of {self.width} x {self.height}; expected {low} to {high} a side"
            )
        if not 0 <= self.port <= 65535:
            raise FreeArtError(f"port {self.port} is none, expected 0 (any free one) to 65535")
        if (self.cert is None) != (self.key is None) or (self.cert is None and not _is_loopback(self.host)):
            raise FreeArtError(f"host {self.host} is served by https: needs both --cert FILE and --key FILE")


def _is_loopback(host: str) -> bool:
    """Whether only this machine can reach `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.rstrip(".").lower() == "localhost"
