"""How quick teleoperation is: pictures a second, and what is added to drawing them from a move to its picture.

    .venv/bin/python -m benchmarks.teleop [--seconds 60] [--object stapler]

starts the server as `freeart21 teleop` does (live pictures of 640 x 360, never finer), drives it by a scripted page
that moves object and joint 60 times a second while it records, prints a table and writes
benchmarks/results/teleop.json (commit, machine, settings, summary). A soak is `--seconds 1800`.

- *fps*: pictures a second that show a newer move than the one before.
- *latency*: from the page's sending of a move to its having the first picture that shows it, milliseconds; the page is
  in a process of its own on this machine, and decodes nothing. *drawing*: what SAPIEN and the JPEG took of it, as the
  simulator's process says of that picture. *added* is the difference: the ways of both messages, and the wait for the
  picture before. Medians and 95th percentiles over all pictures.
- *memory*: resident MB of the server with its simulator's process after `SETTLED` of the time and at the end. The take
  that is recorded meanwhile is part of it.
- *load*: of the machine when it began, and in the end: others' work on the same cores makes all of it slower.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
from rich.console import Console

from benchmarks.common import RESULTS, ROOT, make_table, run_cli, write_report
from freeart21 import se3
from generator.teleop import wire

GOAL_FPS, GOAL_ADDED_MS = 20, 50
HZ = 60
SETTLED = 0.1
"""Share of the time after which memory is compared: caches are full."""
_SERVER = """
import sys
from pathlib import Path
from freeart21.ending import report_errors
from freeart21 import stopping
from generator.session import RecordSettings
from generator.teleop.server import Server
from generator.teleop.start import TeleopSettings, serve
name, out, notes, width, height = sys.argv[1:]
look, file = Server._look, open(notes, "w", buffering=1)
def noted(server):
    shown = server._stage.last
    file.write(f"{shown.mark.n} {shown.drawn_s}\\n")
    look(server)
Server._look = noted
stopping.listen()
with report_errors():
    serve(name, Path(out), TeleopSettings(port=0, width=int(width), height=int(height), finest=1.0), RecordSettings())
"""


def main(
    seconds: float = 60.0,
    object: str = "stapler",
    width: int = 640,
    height: int = 360,
    out: Path = RESULTS / "teleop.json",
) -> None:
    """Measure teleoperation.

    Args:
        seconds: How long it is driven.
        object: What is moved.
        width: Of the live picture, pixels.
        height: Of the live picture, pixels.
        out: The JSON file.
    """
    load_before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="freeart21-") as folder:
        notes = Path(folder) / "notes"
        arguments = [object, f"{folder}/take.jsonl", str(notes), str(width), str(height)]
        server = subprocess.Popen(
            [sys.executable, "-c", _SERVER, *arguments],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        )
        try:
            assert server.stdout is not None
            url = server.stdout.readline().strip()
            drive = asyncio.run(_driven(url, seconds, server.pid))
        finally:
            server.send_signal(signal.SIGTERM)
            server.wait(60)
        drawn = {int(n): float(s) for n, s in (line.split() for line in notes.read_text().splitlines())}
    body = _summary(drive, drawn, seconds) | {"load": [round(load_before, 2), round(os.getloadavg()[0], 2)]}
    _print(body)
    settings = {"seconds": seconds, "object": object, "width": width, "height": height, "moves_a_second": HZ}
    write_report(out, settings, **body)


async def _driven(url: str, seconds: float, pid: int) -> dict[str, Any]:
    """What a scripted page saw: pictures as (arrival in s, move's number, its sending in ms, bytes), and memory."""
    address, _, token = url.partition("/?token=")
    pictures: list[tuple[float, int, float, int]] = []
    memory: list[tuple[float, float]] = []
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{address}/ws?token={token}&v=1", headers={"Origin": address}, max_msg_size=0) as page,
    ):
        hello: dict[str, Any] = {}
        status: dict[str, Any] = {}

        async def read() -> None:
            async for message in page:
                if message.type == aiohttp.WSMsgType.BINARY:
                    n, sent_ms, jpeg = wire.unpack_picture(message.data)
                    pictures.append((time.perf_counter(), n, sent_ms, len(jpeg)))
                    await page.send_json({"type": "seen", "n": len(pictures)})
                else:
                    message_in = json.loads(message.data)
                    (hello if message_in["type"] == "hello" else status).update(message_in)

        reading = asyncio.create_task(read())
        while not status.get("ready"):
            await asyncio.sleep(0.05)
        T = se3.pose_from_wxyz(hello["position"], hello["quaternion"])
        low, high = hello["limits"]
        begin, n = time.perf_counter(), 0
        await page.send_json({"type": "do", "what": "record", "n": 0})
        while (now := time.perf_counter() - begin) < seconds:
            n += 1
            turn = se3.exp_so3(np.array([0.5, 1.0, 0.2]) * np.sin(0.9 * now))
            state = low + (high - low) * (0.5 - 0.5 * np.cos(1.7 * now))
            move = {
                "type": "move",
                "n": n,
                "time": 1e3 * time.perf_counter(),
                "position": (T[:3, 3] + [0.0, 0.0, 0.2 * T[2, 3] * np.sin(0.5 * now) ** 2]).tolist(),
                "quaternion": se3.wxyz(turn @ T[:3, :3]).tolist(),
                "state": float(state),
                "device": "mouse",
            }
            await page.send_json(move)
            if n % HZ == 1:
                memory.append((now, _resident_mb(pid)))
            await asyncio.sleep(max(0.0, begin + n / HZ - time.perf_counter()))
        memory.append((seconds, _resident_mb(pid)))
        reading.cancel()
    return {"pictures": pictures, "memory": memory, "moves": n, "samples": status["samples"]}


def _summary(drive: dict[str, Any], drawn: dict[int, float], seconds: float) -> dict[str, Any]:
    first: dict[int, tuple[float, float, int]] = {}
    for arrived, n, sent_ms, size in drive["pictures"]:
        if sent_ms > 0:
            first.setdefault(n, (arrived, sent_ms, size))
    latency = np.array([1e3 * arrived - sent for arrived, sent, _ in first.values()])
    drawing = np.array([1e3 * drawn[n] for n in first])

    def spread(values: np.ndarray) -> dict[str, float]:
        median, p95 = np.percentile(values, [50, 95])
        return {"median": round(float(median), 1), "p95": round(float(p95), 1)}

    settled = next(mb for at, mb in drive["memory"] if at >= SETTLED * seconds)
    return {
        "fps": round(len(first) / seconds, 1),
        "added_ms": spread(latency - drawing),
        "latency_ms": spread(latency),
        "drawing_ms": spread(drawing),
        "jpeg_kb": round(float(np.mean([size for *_, size in first.values()])) / 1e3, 1),
        "memory_mb": {"settled": round(settled, 1), "end": round(drive["memory"][-1][1], 1)},
        "moves": drive["moves"],
        "samples": drive["samples"],
        "reached": {
            "fps": len(first) / seconds >= GOAL_FPS,
            "added": float(np.median(latency - drawing)) <= GOAL_ADDED_MS,
        },
    }


def _resident_mb(pid: int) -> float:
    """Of a process and its children."""
    pids = [pid, *map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())]
    pages = sum(int(Path(f"/proc/{one}/statm").read_text().split()[1]) for one in pids)
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _print(body: dict[str, Any]) -> None:
    times = [(name, body[name]["median"], body[name]["p95"]) for name in ("added_ms", "latency_ms", "drawing_ms")]
    console = Console()
    console.print(make_table("freeart21 teleop", ("", "median", "95 %"), times))
    memory = body["memory_mb"]
    console.print(f"{body['fps']} pictures a second; load {body['load']}")
    console.print(f"memory {memory['settled']} MB, in the end {memory['end']} MB")


if __name__ == "__main__":
    run_cli(main)
