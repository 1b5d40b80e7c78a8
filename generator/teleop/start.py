"""The door of teleoperation: an object is loaded, a server started, and it runs until it is told to stop."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Coroutine, Iterator
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
from freeart21.mesh import bounding_diagonal
from generator import partnet, urdf_folder
from generator.motion.body import Body
from generator.motion.plan import PRESETS
from generator.session import RecordSettings, catalog_entry, load_object
from generator.teleop.address import addresses, is_loopback, qr_code
from generator.teleop.certificate import Certificate, own_certificate, usual_host
from generator.teleop.driving import Driving, Placement
from generator.teleop.gate import Gate, new_token
from generator.teleop.limits import Room
from generator.teleop.stage import GROWTHS, Stage
from generator.teleop.takes import Takes
from generator.teleop.wire import Bounds

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
    finest: float = GROWTHS[-1]
    """How much finer it may be, a side, where the machine draws that in time."""


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
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        name, loaded, inputs = _loaded(name, record, Path(place))
        for note in loaded.notes:
            print(f"{name}: {note}", file=sys.stderr)
        size = bounding_diagonal(loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh())
        takes = Takes(out, loaded.joint.type, inputs, size)
        with _heard_by_loop() as told:
            kept = asyncio.run(_serve(name, loaded, takes, settings, told))
    if told:
        with stopping.explained(lambda: kept):
            os.kill(os.getpid(), told[0])
            stopping.check()


def _loaded(name: str, record: RecordSettings, place: Path) -> tuple[str, partnet.PartNetObject, tuple[Path, ...]]:
    """What the object is called, the object as `record` would film it, and the folders that are the user's."""
    if name.lower().endswith(urdf_folder.URDF_ENDINGS):
        record = replace(record, urdf=checked.require_file(Path(name), MAX_URDF_BYTES, checked.ANYWHERE))
        name = urdf_folder.object_name(Path(name))
    loaded = load_object(catalog_entry(name, record), record, place)
    own = loaded.asset.urdf.parent
    return name, loaded, () if own.is_relative_to(place) else (own,)


async def _serve(
    name: str, loaded: partnet.PartNetObject, takes: Takes, settings: TeleopSettings, told: list[int]
) -> str:
    """Serve until told to stop; what is to be said of a take that nobody saved."""
    from generator.teleop.server import Server

    body = Body.of((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()), loaded.joint)
    fov_y = float(np.radians(PRESETS["handheld"].fov_y_degrees))
    room = Room.of(body, Camera.from_fov(settings.width, settings.height, fov_y))
    start = Placement(room.T_start, room.state)
    with _listening(settings) as listener:
        port = listener.getsockname()[1]
        own = None if is_loopback(settings.host) else own_certificate(settings.host)
        here = "127.0.0.1", "localhost", "::1", settings.host
        scheme, names = ("http", here) if own is None else ("https", own.names)
        gate = Gate.of(new_token(), scheme, names, port)
        stage = Stage(_told(loaded, room, fov_y), (settings.width, settings.height), start, settings.finest)
        bounds = Bounds(body.lower, body.upper, room.reach)
        server = Server(_facts(name, loaded, room, fov_y), bounds, start, stage, takes, gate, _log)
        for path, seconds in takes.unsaved_takes():
            _log(f"{path} is a take of {seconds:.1f} s that nobody saved: move it to keep it, or remove it")
        _announce(addresses(settings.host, port, gate.token), own)
        _log(f"{name}: open this address in a browser; takes go to {takes.next_name()}; Ctrl-C ends")
        try:
            await _until_told(told, [server.run(listener, None if own is None else own.context()), stage.run(_log)])
        finally:
            await server.finish_saving()
            kept = _rescued(server.driving, takes)
            if kept and not told:
                _log(kept)
            await server.close()
            if server.latency_ms is not None:
                median, high = server.latency_ms
                _log(f"from a move to its picture: median {median:.0f} ms, 95 % within {high:.0f} ms (the last 100)")
                _log(f"drawing a picture: median {stage.drawing_ms():.0f} ms")
    return kept


def _facts(name: str, loaded: partnet.PartNetObject, room: Room, fov_y: float) -> dict[str, Any]:
    """What every page is told of the object."""
    return {
        "object": name,
        "joint": loaded.joint.name,
        "joint_type": loaded.joint.type,
        "fov_y": fov_y,
        "size": 2 * room.radius,
        "radius": room.radius,
        "centre": room.centre.tolist(),
        "depths": [room.nearest, room.farthest],
        "points": [np.round(points, 6).tolist() for points in room.points],
        "axis": loaded.joint.axis.tolist(),
        "pivot": loaded.joint.pivot.tolist(),
    }


def _told(loaded: partnet.PartNetObject, room: Room, fov_y: float) -> dict[str, Any]:
    """What the simulator's process is made of."""
    return {
        "urdf": str(loaded.asset.urdf),
        "groups": [list(side.links) for side in loaded.sides],
        "joint": loaded.joint.name,
        "held": loaded.asset.held,
        "fov_y": fov_y,
        "near": 0.05 * room.radius,
        "far": 2 * room.reach,
    }


async def _until_told(told: list[int], works: list[Coroutine[Any, Any, None]]) -> None:
    """Do the works until the process is told to stop, or one of them ends; its fault is raised."""
    loop, end = asyncio.get_running_loop(), asyncio.Event()

    def stop(number: int) -> None:
        told.append(number)
        end.set()

    for number in stopping.SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            loop.add_signal_handler(number, stop, number)
    tasks = [asyncio.ensure_future(work) for work in (*works, end.wait())]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        ended = [task for task in tasks if task.done()]
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in ended:
        task.result()


def _rescued(driving: Driving, takes: Takes) -> str:
    """Write a take that nobody saved; what is to be said of it."""
    if not driving.has_take:
        takes.discard()
        return ""
    try:
        return f"the take that was not saved is in {takes.rescue(driving)}"
    except FreeArtError as error:
        return f"the take that was not saved is lost: {error}"


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
    usual_host(settings.host)
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((settings.host, settings.port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise FreeArtError(
            f"cannot listen at {settings.host} port {settings.port}: {error.strerror or error}; --port chooses another"
        ) from error
    with listener:
        yield listener


def _announce(found: tuple[str, ...], own: Certificate | None) -> None:
    """Say where the page is, the best address first; who looks at a terminal gets a code for a camera, too."""
    print("\n".join(found), flush=True)
    if sys.stderr.isatty():
        print(qr_code(found[0]), file=sys.stderr, flush=True)
    if own is not None:
        _log(f"this machine made its certificate itself: a browser warns, and must show the SHA-256 {own.fingerprint}")


def _log(line: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # the terminal may be gone
        print(f"{time.strftime('%H:%M:%S')} {line}", file=sys.stderr, flush=True)
