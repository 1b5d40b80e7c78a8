"""Scoring one submission by one protocol where it can do no harm: in a container, or in a bounded process."""

from __future__ import annotations

import functools
import os
import shutil
import signal
import subprocess
import tempfile
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from freeart21 import child
from freeart21.errors import FreeArtError
from leaderboard.board.settings import BoardSettings
from leaderboard.submission import shorten

Kind = Literal["docker", "podman", "process without network", "process"]
_PROGRAM = "import sys\nsys.argv[0] = 'freeart21'\nfrom freeart21.__main__ import main\nmain()"
_ENVIRONMENT = ("PATH", "HOME", "TMPDIR", "LANG", "VK_ICD_FILENAMES", "NUMBA_CACHE_DIR", "XDG_RUNTIME_DIR")
"""What a scoring process gets of the environment: no secret."""
_PROCESSES = 256
_LAST_BYTES = 4096
WORKERS = 2


@dataclass(frozen=True)
class Request:
    """What is scored by what, and the table to write."""

    results: Path
    data: Path
    truth: Path | None
    protocol: str
    table: Path


class NotScored(FreeArtError):
    """Scoring ended without a table."""


def choose_isolation(settings: BoardSettings) -> Kind:
    """What submissions are scored in here. Raises FreeArtError where board.json demands a container and none runs."""
    if settings.isolation != "process":
        for engine in ("docker", "podman"):
            if shutil.which(engine) and _runs((engine, "info")):
                return engine
    if settings.isolation == "container":
        raise FreeArtError("board.json demands a container, and neither docker nor podman runs here")
    return "process without network" if _runs((*_WITHOUT_NETWORK, "true")) else "process"


_WITHOUT_NETWORK = ("unshare", "--user", "--map-root-user", "--net")


def score_in(kind: Kind, request: Request, settings: BoardSettings) -> None:
    """Write the table of `request`. Raises NotScored, one line, when that fails or exceeds the limits."""
    limits, name = settings.limits, f"freeart21-{uuid.uuid4().hex[:12]}"
    if kind in ("docker", "podman"):
        command = container_command(kind, name, request, settings)
    else:
        named = (request.results, request.data, request.truth, request.table)
        command = [*child.python(_PROGRAM), *_words(request.protocol, *named)]
        if kind == "process without network":
            command = [*_WITHOUT_NETWORK, *command]
    environment = {key: os.environ[key] for key in _ENVIRONMENT if key in os.environ}
    with tempfile.TemporaryFile() as messages:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            env=environment,
            start_new_session=True,
        )
        try:
            code = process.wait(60 * limits.minutes)
        except subprocess.TimeoutExpired as error:
            raise NotScored(f"scoring took more than {limits.minutes} minutes") from error
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                if kind in ("docker", "podman"):
                    subprocess.run([kind, "kill", name], capture_output=True, timeout=60)
        messages.seek(-min(messages.seek(0, os.SEEK_END), _LAST_BYTES), os.SEEK_END)
        lines = [line for line in messages.read().decode("utf-8", "replace").splitlines() if line.strip()]
    if not request.table.is_file():
        raise NotScored(f"scoring ended without a table: {shorten(lines[-1]) if lines else f'exit code {code}'}")


def container_command(engine: str, name: str, request: Request, settings: BoardSettings) -> list[str]:
    """The command that scores in a container: no network, nothing to write but the table's folder, no privileges."""
    mounts = [(request.results, "/results", "ro"), (request.data, "/data", "ro"), (request.table.parent, "/out", "rw")]
    if request.truth is not None:
        mounts.append((request.truth, "/truth", "ro"))
    inside = [Path("/results"), Path("/data"), Path("/truth") if request.truth else None, Path("/out")]
    paths = (*inside[:3], Path("/out") / request.table.name)
    return [
        *(engine, "run", "--rm", "--name", name, "--network", "none", "--read-only", "--tmpfs", "/tmp:size=8g,exec"),
        *("--cap-drop", "ALL", "--security-opt", "no-new-privileges", "--pids-limit", str(_PROCESSES)),
        *("--memory", f"{settings.limits.memory_gib}g", "--user", f"{os.getuid()}:{os.getgid()}", "--env", "HOME=/tmp"),
        *(word for host, there, way in mounts for word in ("--volume", f"{host.resolve()}:{there}:{way}")),
        *(settings.image, "freeart21", *_words(request.protocol, *paths)),
    ]


def _words(protocol: str, results: Path | None, data: Path | None, truth: Path | None, table: Path | None) -> list[str]:
    hidden = [] if truth is None else ["--truth", str(truth)]
    place = ["score", str(results), "--data", str(data), *hidden]
    return [*place, "--protocol", protocol, "--out", str(table), "--workers", str(WORKERS)]


@functools.cache
def _runs(command: tuple[str, ...]) -> bool:
    try:
        return subprocess.run(command, capture_output=True, timeout=60).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False
