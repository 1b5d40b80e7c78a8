"""The door of teleoperation: an object is loaded, a server started, and it runs until it is told to stop."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import os
import signal
import socket
import ssl
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import stopping
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.urdf import MAX_URDF_BYTES
from generator import partnet, urdf_folder
from generator.motion.body import Body
from generator.motion.plan import PRESETS
from generator.session import RecordSettings, entry_of, load_object
from generator.teleop.limits import Room

PACKAGES = ("aiohttp", "qrcode", "cryptography")
"""Of the extra `teleop`."""
SIDES = 64, 1280
"""Pixels that the live picture may have a side."""


@dataclass(frozen=True)
class TeleopSettings:
    """How an object is put into a hand."""

    host: str = "127.0.0.1"
    """Where the server listens."""
    port: int = 8021
    """0 takes a free one."""
    width: int = 640
    height: int = 360
    """Of the live picture, pixels; a page of another shape gets as many."""


def serve(name: str, out: Path, settings: TeleopSettings, record: RecordSettings) -> None:
    """Serve the object `name`, which `record` tells of, until the process is told to stop; takes go to `out`.

    Raises FreeArtError when the object is unknown or unfit, `out` exists, the port is taken or the simulator cannot
    show it, and KeyboardInterrupt when told to stop; what was taken and not saved is written beside `out` then.
    """
    lacking = [package for package in PACKAGES if find_spec(package) is None]
    if lacking:
        raise FreeArtError(f"teleop needs {', '.join(lacking)}: pip install 'freeart21[teleop]'")
    low, high = SIDES
    if not (low <= min(settings.width, settings.height) and max(settings.width, settings.height) <= high):
        raise FreeArtError(
            f"cannot show live pictures of {settings.width} x {settings.height}; expected {low} to {high} a side"
        )
    if not 0 <= settings.port <= 65535:
        raise FreeArtError(f"port {settings.port} is none, expected 0 (any free one) to 65535")
    from generator.teleop.takes import Takes

    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        loaded, source = _loaded(name, record, Path(place))
        for note in loaded.notes:
            print(f"{name}: {note}", file=sys.stderr)
        takes = Takes(out, loaded.joint.type, source)
        with _heard_by_loop() as told:
            kept = asyncio.run(_serve(name, loaded, takes, settings, told))
    if told:
        with stopping.explained(lambda: kept):
            os.kill(os.getpid(), told[0])
            stopping.check()


def _loaded(name: str, record: RecordSettings, place: Path) -> tuple[partnet.PartNetObject, tuple[Path, ...]]:
    """The object as `record` would film it, and the files that are the user's."""
    if name.lower().endswith(".urdf"):
        record = replace(record, urdf=checked.require_file(Path(name), MAX_URDF_BYTES))
        name = urdf_folder.object_name(Path(name))
    loaded = load_object(entry_of(name, record), record, place)
    own = loaded.asset.urdf.parent
    return loaded, () if own.is_relative_to(place) else (own,)


async def _serve(
    name: str, loaded: partnet.PartNetObject, takes: Any, settings: TeleopSettings, told: list[int]
) -> str:
    """Serve until told to stop; what is to be said of a take that nobody saved."""
    from aiohttp import web

    from generator.teleop import gate, wire
    from generator.teleop.server import Server
    from generator.teleop.stage import Stage, live_size

    body = Body.of((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()), loaded.joint)
    fov_y = float(np.radians(PRESETS["handheld"].fov_y_degrees))
    camera = Camera.from_fov(settings.width, settings.height, fov_y)
    room = Room.of(body, camera)
    token = gate.new_token()
    context = _tls(settings.host)
    scheme = "http" if context is None else "https"
    with _listening(settings) as listener:
        port = listener.getsockname()[1]
        loop = asyncio.get_running_loop()
        from generator.teleop.driving import Placement

        size = live_size(settings.width, settings.height, settings.width / settings.height)
        stage = Stage(
            {
                "urdf": str(loaded.asset.urdf),
                "groups": [list(side.links) for side in loaded.sides],
                "fov_y": fov_y,
                "joint": loaded.joint.name,
                "held": loaded.asset.held,
                "near": 0.1 * room.radius,
                "far": 2 * room.reach,
            },
            size,
            Placement(room.T_start, min(max(0.0, body.lower), body.upper)),
            lambda shown: None,
        )
        facts = {
            "object": name,
            "joint": loaded.joint.name,
            "joint_type": loaded.joint.type,
            "fov_y": fov_y,
            "aspects": [0.4, 16 / 9],
            "size": 2 * room.radius,
            "centre": room.centre.tolist(),
            "radius": room.radius,
            "depths": [room.nearest, room.farthest],
            "points": np.round(room.points, 6).tolist(),
        }
        bounds = wire.Bounds(body.lower, body.upper, room.reach)
        doors = gate.Gate.of(token, scheme, _names(settings.host), port)
        server = Server(facts, bounds, room, stage, takes, doors, _log)
        runner = web.AppRunner(server.app(), access_log=None, handle_signals=False)
        await runner.setup()
        site = web.SockSite(runner, listener, ssl_context=context, shutdown_timeout=1.0)
        await site.start()
        print(f"{scheme}://{_shown(settings.host)}:{port}/?token={token}", flush=True)
        _log(f"{name}: open this address; Ctrl-C ends. Takes go to {takes.next_name()}")
        end = asyncio.Event()

        def stop(number: int) -> None:
            told.append(number)
            end.set()

        for number in stopping.SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                loop.add_signal_handler(number, stop, number)
        drawing = asyncio.create_task(stage.run(_log))
        ticking = asyncio.create_task(server.tick())
        ending = asyncio.create_task(end.wait())
        try:
            await asyncio.wait({drawing, ticking, ending}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            kept = ""
            if server.driving.has_take:
                kept = f"the take that was not saved is in {takes.rescue(server.driving)}"
                if not told:
                    _log(kept)
            stage.stop()
            ticking.cancel()
            ending.cancel()
            await server.close()
            await runner.cleanup()
            with contextlib.suppress(asyncio.TimeoutError, asyncio.CancelledError):
                await asyncio.wait_for(asyncio.shield(asyncio.gather(drawing, return_exceptions=True)), 5.0)
            measured = server.latency()
            if measured is not None:
                _log(f"latency of the last 100 pictures: median {measured[0]:.0f} ms, 95 % below {measured[1]:.0f} ms")
        for task in (drawing, ticking):
            if task.done() and not task.cancelled() and task.exception() is not None:
                raise task.exception()  # type: ignore[misc]
        return kept


@contextlib.contextmanager
def _heard_by_loop() -> Iterator[list[int]]:
    """Signals that say stop go to the event loop in this block (the list gets their numbers), then to who had them."""
    before = {number: signal.getsignal(number) for number in stopping.SIGNALS}
    told: list[int] = []
    try:
        yield told
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _listening(settings: TeleopSettings) -> Iterator[socket.socket]:
    """A socket that listens; FreeArtError, in one line, when it cannot be had."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((settings.host, settings.port))
    except OSError as error:
        listener.close()
        raise FreeArtError(
            f"cannot listen at {settings.host} port {settings.port}: {error.strerror or error}; --port chooses another"
        ) from error
    with listener:
        yield listener


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach a server that listens at `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _tls(host: str) -> ssl.SSLContext | None:
    if is_loopback(host):
        return None
    raise FreeArtError(f"--host {host}: only this machine is served yet, expected 127.0.0.1")


def _names(host: str) -> tuple[str, ...]:
    return ("127.0.0.1", "localhost", "::1", host)


def _shown(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _log(line: str) -> None:
    print(f"{time.strftime('%H:%M:%S')} {line}", file=sys.stderr, flush=True)
