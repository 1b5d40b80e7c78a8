"""What this machine has and lacks, and the command that fixes each lack.

Whatever may crash (SAPIEN, OpenCV, a Vulkan driver) is tried in a process of its own, so that a broken driver costs one
line of output.
"""

from __future__ import annotations

import functools
import importlib.metadata
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from freeart21 import processes
from freeart21.errors import FreeArtError

BACKPORTS = (
    "echo 'deb http://deb.debian.org/debian bookworm-backports main' | "
    "sudo tee /etc/apt/sources.list.d/bookworm-backports.list && sudo apt-get update && "
    "sudo apt-get install -y --no-install-recommends -t bookworm-backports mesa-vulkan-drivers libx11-6"
)
"""Installs a software Vulkan driver that SAPIEN accepts on Debian 12. `make setup` runs the same."""

_NEEDED = (
    "SAPIEN needs Vulkan 1.2 with descriptorBindingPartiallyBound, timelineSemaphore and VK_EXT_extended_dynamic_state"
)
_OPTIONAL = {
    "torch": "freeart21[torch]",
    "gsplat": "freeart21[torch]",
    "mani_skill": "freeart21[maniskill]",
    "mujoco": "freeart21[dev]",
    "aiohttp": "freeart21[teleop]",
    "av": "freeart21[cameras]",
}

_PROBE_CV2 = "import cv2; print(cv2.__version__)"
_PROBE_SAPIEN = """
import json
try:
    import sapien
except ImportError as error:
    print(json.dumps({"import": str(error)}))
    raise SystemExit
try:
    print(json.dumps({"summary": sapien.render.get_device_summary()}))
except RuntimeError as error:
    print(json.dumps({"error": str(error)}))
"""
_PROBE_GAUSSIANS = """
import json
from reconstruct.gaussians.backends import predict_backend
print(json.dumps(dict(zip(("backend", "why"), predict_backend()))))
"""
# Names of the devices that the Vulkan loader finds: in VkPhysicalDeviceProperties the name begins at byte 20.
_PROBE_VULKAN = """
import ctypes, json, struct
try:
    vk = ctypes.CDLL("libvulkan.so.1")
except OSError as error:
    print(json.dumps({"loader": str(error)}))
    raise SystemExit
app = struct.pack("=I4xQQI4xQII", 0, 0, 0, 0, 0, 0, 1 << 22)
app_at = ctypes.create_string_buffer(app)
info = struct.pack("=I4xQI4xQI4xQI4xQ", 1, 0, 0, ctypes.addressof(app_at), 0, 0, 0, 0)
instance, count = ctypes.c_void_p(), ctypes.c_uint32()
devices = []
if vk.vkCreateInstance(info, None, ctypes.byref(instance)) == 0:
    vk.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
    handles = (ctypes.c_void_p * count.value)()
    vk.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
    for handle in handles:
        properties = ctypes.create_string_buffer(4096)
        vk.vkGetPhysicalDeviceProperties(ctypes.c_void_p(handle), properties)
        devices.append(properties.raw[20:276].split(bytes(1))[0].decode(errors="replace"))
print(json.dumps({"devices": devices}))
"""


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
    return [_python(), *_packages(), _cv2(), _rendering(), _gpu(), _gaussians(), *_optional()]


def require_rendering() -> None:
    """Raise FreeArtError, with the fix, unless SAPIEN can render here; tried once a process."""
    finding = _rendering()
    if finding.status == "missing":
        raise FreeArtError(f"{finding.detail}. Fix: {finding.fix}")


def _missing(name: str, detail: str, fix: str) -> Finding:
    return Finding(name, "missing", detail, fix)


def _python() -> Finding:
    version = platform.python_version()
    good = (3, 10) <= sys.version_info[:2] <= (3, 12)
    return Finding(
        "Python",
        "ok" if good else "missing",
        version if good else f"{version}, expected 3.10 to 3.12",
        "" if good else "make a virtual environment with Python 3.11: make setup PYTHON=python3.11",
    )


def _packages() -> list[Finding]:
    """The declared core dependencies against the installed versions."""
    from packaging.requirements import Requirement

    try:
        declared = [Requirement(text) for text in importlib.metadata.requires("freeart21") or []]
    except importlib.metadata.PackageNotFoundError:
        return [_missing("packages", "freeart21 itself is not installed", "pip install -e . -c constraints.txt")]
    core = [r for r in declared if r.marker is None or r.marker.evaluate({"extra": ""})]
    wrong = []
    for requirement in core:
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            wrong.append(f"{requirement.name} is not installed, expected {requirement.specifier}")
            continue
        if not requirement.specifier.contains(version, prereleases=True):
            wrong.append(f"{requirement.name} is {version}, expected {requirement.specifier}")
    if wrong:
        return [_missing("packages", text, "pip install -e . -c constraints.txt") for text in wrong]
    return [Finding("packages", "ok", f"{len(core)} core packages as declared")]


def _cv2() -> Finding:
    done = _run_python(_PROBE_CV2)
    if done.returncode == 0:
        return Finding("OpenCV", "ok", done.stdout.strip())
    reason = done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"exit {done.returncode}"
    if "lib" in reason and ".so" in reason:
        reason = f"OpenCV's build with windows overwrote the headless one and needs a screen's libraries ({reason})"
    return _missing("OpenCV", reason, "pip install --force-reinstall --no-deps opencv-python-headless")


@functools.cache
def _rendering() -> Finding:
    done = _run_python(_PROBE_SAPIEN)
    answer = _last_json(done.stdout)
    if "summary" in answer:
        names = [line.split(":", 1)[1].strip() for line in answer["summary"].splitlines() if line.startswith("GPU:")]
        return Finding("Vulkan", "ok", ", ".join(names))
    if "import" in answer:
        if "libX11" in answer["import"]:
            return _missing(
                "Vulkan",
                "SAPIEN cannot be imported: libX11.so.6 is missing",
                "sudo apt-get install -y libx11-6",
            )
        return _missing(
            "Vulkan", f"SAPIEN cannot be imported: {answer['import']}", "pip install -e . -c constraints.txt"
        )
    return _why_no_rendering(answer.get("error") or f"SAPIEN ended with exit code {done.returncode}")


def _why_no_rendering(error: str) -> Finding:
    devices = _last_json(_run_python(_PROBE_VULKAN).stdout).get("devices") or []
    if devices:
        return _missing(
            "Vulkan",
            f"no Vulkan device that SAPIEN accepts: the driver of {', '.join(devices)} is too "
            f"old or unfit; {_NEEDED}; Debian 12's own Mesa 22.3 lacks the first",
            BACKPORTS,
        )
    if _nvidia() and not os.environ.get("VK_ICD_FILENAMES"):
        return _missing(
            "Vulkan",
            "there is an NVIDIA GPU but no Vulkan driver for it in this system or container",
            "start the container with NVIDIA_DRIVER_CAPABILITIES=all, or install libnvidia-gl, or set "
            "VK_ICD_FILENAMES=/usr/share/vulkan/icd.d/lvp_icd.x86_64.json for software rendering",
        )
    hint = os.environ.get("VK_ICD_FILENAMES") or os.environ.get("VK_DRIVER_FILES")
    pointer = f" (VK_ICD_FILENAMES or VK_DRIVER_FILES points to {hint})" if hint else ""
    return _missing("Vulkan", f"no Vulkan driver is installed{pointer}; SAPIEN says: {error}", BACKPORTS)


def _gpu() -> Finding:
    names = _nvidia()
    if names:
        return Finding("GPU", "ok", ", ".join(names))
    return Finding("GPU", "note", f"none; everything runs on the {os.cpu_count()} processor cores")


def _gaussians() -> Finding:
    """The Gaussian rasteriser that `reconstruct` uses here."""
    done = _run_python(_PROBE_GAUSSIANS)
    answer = _last_json(done.stdout)
    if "backend" in answer:
        return Finding("Gaussians", "ok", f"{answer['backend']}: {answer['why']}")
    lines = done.stderr.strip().splitlines()
    reason = lines[-1] if lines else f"exit code {done.returncode}"
    return _missing(
        "Gaussians",
        f"choosing a rasteriser failed ({reason})",
        "pip install -e . -c constraints.txt, or where torch crashes: pip uninstall torch",
    )


def _optional() -> list[Finding]:
    findings = []
    for name, extra in _OPTIONAL.items():
        try:
            findings.append(Finding(name, "ok", importlib.metadata.version(name)))
        except importlib.metadata.PackageNotFoundError:
            findings.append(
                Finding(name, "note", f"not installed; nothing in the core needs it (pip install '{extra}')")
            )
    return findings


def _nvidia() -> list[str]:
    if shutil.which("nvidia-smi") is None:
        return []
    done = _run(["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"])
    return [line.strip() for line in done.stdout.splitlines() if line.strip()] if done.returncode == 0 else []


def _run_python(code: str) -> subprocess.CompletedProcess[str]:
    return _run(processes.python(code))


def _run(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 124, "", "no answer within 120 s")


def _last_json(text: str) -> dict[str, Any]:
    lines = [line for line in text.splitlines() if line.startswith("{")]
    return json.loads(lines[-1]) if lines else {}
