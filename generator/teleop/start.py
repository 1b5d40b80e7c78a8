"""Entry point of teleoperation: loads an object and serves it until the process is stopped."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
import ssl
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import processes
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.mesh import bounding_diagonal
from generator.motion.body import Body
from generator.motion.plan import PRESETS
from generator.object_source import find_object
from generator.settings import RecordSettings
from generator.teleop.driving import Driving, Placement
from generator.teleop.gate import Gate, bracketed
from generator.teleop.limits import Workspace
from generator.teleop.stage import Stage
from generator.teleop.takes import Takes
from generator.teleop.wire import Bounds
from generator.urdf_object import LoadedObject

SIDES = 64, 1280
"""Pixels that the live picture may have a side."""


@dataclass(frozen=True)
class TeleopSettings:
    """Settings of teleoperation."""

    host: str = "127.0.0.1"
    """Where the server listens; 0.0.0.0 for all addresses of this machine."""
    port: int = 8021
    """0 takes any free port."""
    width: int = 640
    height: int = 360
    """Size of the live picture, pixels."""
    cert: Path | None = None
    key: Path | None = None
    """PEM files of a certificate and its private key: other hosts than this machine itself are served by https alone,
    because browsers give headsets to no other pages and the address holds the secret."""

    def check(self) -> None:
        """Raise FreeArtError for settings that cannot be served."""
        low, high = SIDES
        if not (low <= min(self.width, self.height) and max(self.width, self.height) <= high):
            raise FreeArtError(
                f"cannot show live pictures of {self.width} x {self.height}; expected {low} to {high} a side"
            )
        if not 0 <= self.port <= 65535:
            raise FreeArtError(f"port {self.port} is none, expected 0 (any free one) to 65535")
        if (self.cert is None) != (self.key is None) or (self.cert is None and not is_loopback(self.host)):
            raise FreeArtError(f"host {self.host} is served by https: needs both --cert FILE and --key FILE")

    def tls(self) -> ssl.SSLContext | None:
        """The context of the certificate, or None for http. Raises FreeArtError."""
        if self.cert is None:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(self.cert, self.key, password="")  # no question at the terminal
        except (OSError, ValueError) as error:
            raise FreeArtError(f"cannot use the certificate {self.cert} with the key {self.key}: {error}") from error
        return context


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.rstrip(".").lower() == "localhost"


def serve(name: str, out: Path, settings: TeleopSettings, record: RecordSettings) -> None:
    """Serve the object `name`, loaded with the settings `record`, until the process is stopped; takes go to `out`.

    Raises FreeArtError when the object is unknown or unfit, `out` exists, the port is taken or the simulator cannot
    show the object; KeyboardInterrupt when stopped. A take that was not saved is then written next to `out`.
    """
    if find_spec("aiohttp") is None:
        raise FreeArtError("teleop needs aiohttp: pip install 'freeart21[teleop]'")
    settings.check()
    context = settings.tls()
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        name, loaded, inputs = _load_object(name, record, Path(place))
        for note in loaded.notes:
            print(f"{name}: {note}", file=sys.stderr)
        size = bounding_diagonal(loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh())
        takes = Takes(out, loaded.joint.type, inputs, size)
        rescued: list[str] = []
        with processes.resume_hint(lambda: "".join(rescued)):
            asyncio.run(_serve(name, loaded, takes, settings, context, rescued))


def _load_object(name: str, record: RecordSettings, place: Path) -> tuple[str, LoadedObject, tuple[Path, ...]]:
    """The object's name, the loaded object, and the user's folders, which are never written to."""
    source = find_object(name, record)
    loaded = source.load(place)
    folder = loaded.asset.urdf.parent
    return source.entry.name, loaded, () if folder.is_relative_to(place) else (folder,)


async def _serve(
    name: str,
    loaded: LoadedObject,
    takes: Takes,
    settings: TeleopSettings,
    context: ssl.SSLContext | None,
    rescued: list[str],
) -> None:
    """Serve until stopped; `rescued` receives a message on an unsaved take."""
    from generator.teleop.server import Server

    body = Body.of((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()), loaded.joint)
    fov_y = float(np.radians(PRESETS["handheld"].fov_y_degrees))
    room = Workspace.of(body, Camera.from_fov(settings.width, settings.height, fov_y))
    start = Placement(room.T_start, room.state)
    with _open_listener(settings) as listener:
        gate = Gate(listener.getsockname()[1], settings.host, context is not None)
        stage = Stage(_stage_setup(loaded, room, fov_y), (settings.width, settings.height), start)
        bounds = Bounds(body.lower, body.upper, room.reach)
        server = Server(object_facts(name, loaded, room, fov_y), bounds, start, stage, takes, gate, _log)
        for path, seconds in takes.find_unsaved_takes():
            _log(f"{path} is a take of {seconds:.1f} s that nobody saved: move it to keep it, or remove it")
        host = socket.gethostname() if settings.host in ("0.0.0.0", "::") else bracketed(settings.host)
        scheme = "http" if context is None else "https"
        print(f"{scheme}://{host}:{gate.port}/?token={gate.token}", flush=True)
        _log(f"{name}: open this address in a browser; takes go to {takes.next_name()}; Ctrl-C ends")
        works = [asyncio.ensure_future(server.run(listener, context)), asyncio.ensure_future(stage.run(_log))]
        try:
            await asyncio.gather(*works)
        finally:
            for work in works:
                work.cancel()
            await asyncio.gather(*works, return_exceptions=True)
            rescued.append(_rescue_take(server.driving, takes))
            if rescued[0] and not processes.stop_signal():
                _log(rescued[0])
            await server.close()


def object_facts(name: str, loaded: LoadedObject, room: Workspace, fov_y: float) -> dict[str, Any]:
    """Facts on the object that every page gets."""
    return {
        "object": name,
        "joint": loaded.joint.name,
        "joint_type": loaded.joint.type,
        "fov_y": fov_y,
        "centre": room.centre.tolist(),
        "depths": [room.nearest, room.farthest],
        "points": [np.round(points, 6).tolist() for points in room.points],
        "axis": loaded.joint.axis.tolist(),
        "pivot": loaded.joint.pivot.tolist(),
    }


def _stage_setup(loaded: LoadedObject, room: Workspace, fov_y: float) -> dict[str, Any]:
    """Arguments of the simulator's process (`stage_process.Stage`)."""
    return {
        "urdf": str(loaded.asset.urdf),
        "root": str(loaded.asset.root),
        "groups": [list(side.links) for side in loaded.sides],
        "joint": loaded.joint.name,
        "held": loaded.asset.held,
        "fov_y": fov_y,
        "near": 0.05 * room.radius,
        "far": 2 * room.reach,
    }


def _rescue_take(driving: Driving, takes: Takes) -> str:
    """Write an unsaved take; returns a message on it, or ''."""
    if not driving.has_take:
        takes.discard()
        return ""
    try:
        return f"the take that was not saved is in {takes.rescue(driving)}"
    except FreeArtError as error:
        return f"the take that was not saved is lost: {error}"


@contextlib.contextmanager
def _open_listener(settings: TeleopSettings) -> Iterator[socket.socket]:
    """Open a listening socket; FreeArtError, in one line, when that fails."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        listener = socket.create_server((settings.host, settings.port), family=family, backlog=128)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FreeArtError(
            f"cannot listen at {settings.host} port {settings.port}: {reason}; --host, --port choose another"
        ) from error
    with listener:
        yield listener


def _log(line: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # the terminal may be gone
        print(f"{time.strftime('%H:%M:%S')} {line}", file=sys.stderr, flush=True)
