"""Entry point of teleoperation: loads an object and serves it until the process is stopped."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
import sys
import tempfile
import time
from collections.abc import Iterator
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
from generator.settings import RecordSettings, TeleopSettings
from generator.teleop.driving import Driving, Placement
from generator.teleop.gate import Gate, bracketed
from generator.teleop.limits import Workspace
from generator.teleop.stage import Stage
from generator.teleop.takes import Takes
from generator.teleop.wire import Bounds
from generator.urdf_object import LoadedObject


def serve(name: str, out: Path, settings: TeleopSettings, record: RecordSettings) -> None:
    """Serve the object `name`, loaded with the settings `record`, until the process is stopped; takes go to `out`.

    Raises FreeArtError when the object is unknown or unfit, `out` exists, the port is taken or the simulator cannot
    show the object; KeyboardInterrupt when stopped. A take that was not saved is then written next to `out`.
    """
    if find_spec("aiohttp") is None:
        raise FreeArtError("teleop needs aiohttp: pip install 'freeart21[teleop]'")
    settings.check()
    context = _tls(settings)
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        source = find_object(name, record)
        name, loaded = source.entry.name, source.load(Path(place))
        for note in loaded.notes:
            print(f"{name}: {note}", file=sys.stderr)
        size = bounding_diagonal(loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh())
        folder = loaded.asset.urdf.parent  # the user's is never written to
        inputs = () if folder.is_relative_to(place) else (folder,)
        takes = Takes(out, loaded.joint.type, inputs, size)
        rescued: list[str] = []
        with processes.resume_hint(lambda: "".join(rescued)):
            asyncio.run(_serve(name, loaded, takes, settings, context, rescued))


def _tls(settings: TeleopSettings) -> ssl.SSLContext | None:
    """The context of the certificate, or None for http. Raises FreeArtError."""
    if settings.cert is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(settings.cert, settings.key, password="")  # no question at the terminal
    except (OSError, ValueError) as error:
        raise FreeArtError(
            f"cannot use the certificate {settings.cert} with the key {settings.key}: {error}"
        ) from error
    return context


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
