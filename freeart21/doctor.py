"""What this machine has and lacks, and the command that fixes each lack.

Whatever may crash (SAPIEN, OpenCV, a Vulkan driver) is tried in a process of its own, so that a broken driver costs one
line of output.
"""

from __future__ import annotations

import functools
import importlib.metadata
import os
import platform
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from freeart21 import processes
from freeart21.errors import FreeArtError

_INSTALL = "pip install -e . -c constraints.txt"
_BACKPORTS = (
    "echo 'deb http://deb.debian.org/debian bookworm-backports main' | "
    "sudo tee /etc/apt/sources.list.d/bookworm-backports.list && sudo apt-get update && "
    "sudo apt-get install -y --no-install-recommends -t bookworm-backports mesa-vulkan-drivers libx11-6"
)
"""Installs a software Vulkan driver that SAPIEN accepts on Debian 12. `make setup` runs the same."""
_PROBES = {
    "OpenCV": "import cv2; print(cv2.__version__)",
    "Vulkan": "import re, sapien; print(*re.findall('GPU: *(.*)', sapien.render.get_device_summary()), sep=', ')",
    "Gaussians": "from reconstruct.gaussians.backends import predict_backend; print(*predict_backend(), sep=': ')",
}
"""What is tried to what prints it, as its last line."""
_OPTIONAL = {
    "torch": "torch",
    "gsplat": "torch",
    "mani_skill": "maniskill",
    "mujoco": "dev",
    "aiohttp": "teleop",
    "av": "cameras",
}
"""Package to its extra of freeart21."""


@dataclass(frozen=True)
class Finding:
    """One checked item."""

    name: str
    status: Literal["ok", "note", "missing"]
    """'note': good to know, but nothing needs it."""
    detail: str
    fix: str = ""
    """The command or step that fixes it; empty when nothing is wrong."""


def examine() -> list[Finding]:
    """Everything that FreeArt-21 needs or can use on this machine, in the order in which to fix it."""
    gpus = ", ".join(_nvidia())
    return [
        Finding("Python", "ok", platform.python_version()),
        *_packages(),
        _probe("OpenCV", "pip install --force-reinstall --no-deps opencv-python-headless"),
        _rendering(),
        Finding("GPU", "ok" if gpus else "note", gpus or f"none; everything runs on {os.cpu_count()} processor cores"),
        _probe("Gaussians", f"{_INSTALL}, or where torch crashes: pip uninstall torch"),
        *map(_optional, _OPTIONAL),
    ]


def require_rendering() -> None:
    """Raise FreeArtError, with the fix, unless SAPIEN can render here; tried once a process."""
    finding = _rendering()
    if finding.status == "missing":
        raise FreeArtError(f"{finding.detail}. Fix: {finding.fix}")


def _packages() -> list[Finding]:
    """The declared core dependencies against the installed versions."""
    from packaging.requirements import Requirement

    if _version("freeart21") is None:
        return [Finding("packages", "missing", "freeart21 itself is not installed", _INSTALL)]
    declared = map(Requirement, importlib.metadata.requires("freeart21") or [])
    core = {r.name: r.specifier for r in declared if r.marker is None or r.marker.evaluate({"extra": ""})}
    found = {name: _version(name) for name in core}
    wrong = [
        Finding("packages", "missing", f"{name} is {version or 'not installed'}, expected {core[name]}", _INSTALL)
        for name, version in found.items()
        if version is None or not core[name].contains(version, prereleases=True)
    ]
    return wrong or [Finding("packages", "ok", f"{len(core)} core packages as declared")]


def _optional(name: str) -> Finding:
    lacking = f"not installed; nothing in the core needs it (pip install 'freeart21[{_OPTIONAL[name]}]')"
    version = _version(name)
    return Finding(name, "note", lacking) if version is None else Finding(name, "ok", version)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


@functools.cache
def _rendering() -> Finding:
    found = _probe("Vulkan", _BACKPORTS)
    chosen = os.environ.get("VK_ICD_FILENAMES") or os.environ.get("VK_DRIVER_FILES")
    if found.status == "ok":
        return found
    if "libX11" in found.detail:
        return replace(found, fix="sudo apt-get install -y libx11-6")
    if found.detail.startswith(("ImportError", "ModuleNotFoundError")):
        return replace(found, fix=_INSTALL)
    if _nvidia() and not chosen:
        return replace(
            found,
            detail=f"there is an NVIDIA GPU but no Vulkan driver for it in this system or container ({found.detail})",
            fix="start the container with NVIDIA_DRIVER_CAPABILITIES=all, or install libnvidia-gl, or set "
            "VK_ICD_FILENAMES=/usr/share/vulkan/icd.d/lvp_icd.x86_64.json for software rendering",
        )
    pointer = f"; VK_ICD_FILENAMES or VK_DRIVER_FILES points to {chosen}" if chosen else ""
    none = f"no Vulkan driver that SAPIEN accepts{pointer} (Debian 12's own Mesa 22.3 is too old); SAPIEN says: "
    return replace(found, detail=none + found.detail)


def _probe(name: str, fix: str) -> Finding:
    """What the code of `_PROBES` prints, or the last line of its error."""
    done = _run(processes.python(_PROBES[name]))
    if done.returncode == 0:
        return Finding(name, "ok", done.stdout.strip().splitlines()[-1])
    lines = done.stderr.strip().splitlines()
    return Finding(name, "missing", lines[-1] if lines else f"exit code {done.returncode}", fix)


@functools.cache
def _nvidia() -> list[str]:
    if shutil.which("nvidia-smi") is None:
        return []
    done = _run(["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"])
    return [line.strip() for line in done.stdout.splitlines() if line.strip()] if done.returncode == 0 else []


def _run(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 124, "", "no answer within 120 s")
