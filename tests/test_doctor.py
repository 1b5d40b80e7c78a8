"""The doctor names what is missing and the command that fixes it."""

import subprocess
import sys

import pytest
from refusal import assert_refused

from freeart21 import doctor


def test_this_machine_is_well():
    found = {finding.name: finding for finding in doctor.examine()}
    assert not [finding for finding in found.values() if finding.status == "missing"]
    assert found["Gaussians"].detail.startswith(("numba: on the processor: ", "gsplat: ")) and found["Vulkan"].detail


def test_a_real_probe_finds_that_a_driver_is_missing():
    code = (
        "from freeart21 import doctor\nfrom freeart21.errors import FreeArtError\n"
        "try: doctor.require_rendering()\nexcept FreeArtError as error: print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={"VK_ICD_FILENAMES": "/nonexistent.json", "PATH": "/usr/bin:/bin"},
    )
    assert "VK_ICD_FILENAMES or VK_DRIVER_FILES points to /nonexistent" in done.stdout
    assert "bookworm-backports mesa-vulkan-drivers" in done.stdout and done.stdout.count("\n") == 1


@pytest.mark.parametrize(
    "code, error, gpus, message",
    [
        (1, "RuntimeError: failed to find a rendering device", [], "failed to find .*Fix: .*bookworm-backports"),
        (1, "RuntimeError: failed to find a rendering device", ["NVIDIA H200"], "NVIDIA_DRIVER_CAPABILITIES"),
        (-6, "", [], "no Vulkan driver .*; SAPIEN says: exit code -6"),
        (1, "ImportError: libX11.so.6: cannot open shared object file", [], "Fix: sudo apt-get install -y libx11-6"),
        (1, "ModuleNotFoundError: No module named 'sapien'", [], "Fix: pip install -e"),
    ],
)
def test_each_reason_for_no_rendering_has_its_fix(monkeypatch, code, error, gpus, message):
    done = subprocess.CompletedProcess([], code, "", error)
    monkeypatch.setattr(doctor, "_run", lambda command: done)
    monkeypatch.setattr(doctor, "_nvidia", lambda: gpus)
    monkeypatch.delenv("VK_ICD_FILENAMES", raising=False)
    assert_refused(message, doctor.require_rendering)


def test_a_wrong_package_version_is_named(monkeypatch):
    real = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: "2.2.2" if name == "sapien" else real(name))
    (finding,) = doctor._packages()
    assert finding.status == "missing" and finding.detail == "sapien is 2.2.2, expected >=3.0.3"


@pytest.fixture(autouse=True)
def _forget():
    doctor._rendering.cache_clear()
    yield
    doctor._rendering.cache_clear()
