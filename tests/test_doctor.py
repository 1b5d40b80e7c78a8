"""The doctor names what is missing and the command that fixes it."""

import subprocess
import sys

import pytest
from refusal import assert_refused

from freeart21 import doctor


@pytest.fixture
def says(monkeypatch):
    """Replaces what the probes print."""
    doctor._rendering.cache_clear()
    answers = {}
    monkeypatch.setattr(doctor, "_run_python", lambda code: subprocess.CompletedProcess([], *answers[code]))
    monkeypatch.setattr(doctor, "_nvidia", lambda: [])
    monkeypatch.delenv("VK_ICD_FILENAMES", raising=False)
    yield answers
    doctor._rendering.cache_clear()


def test_this_machine_can_render():
    doctor._rendering.cache_clear()
    doctor.require_rendering()


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
    assert done.stdout.startswith(
        "no Vulkan driver is installed (VK_ICD_FILENAMES or VK_DRIVER_FILES points to /nonexistent"
    )
    assert "bookworm-backports mesa-vulkan-drivers" in done.stdout and done.stdout.count("\n") == 1


NO_DEVICE = (0, '{"error": "failed to find a rendering device"}')
OLD_DRIVER = (0, '{"devices": ["llvmpipe (LLVM 15.0.6, 256 bits)"]}')
NO_X11 = (0, '{"import": "libX11.so.6: cannot open shared object file"}')


@pytest.mark.parametrize(
    "sapien, vulkan, gpus, message",
    [
        (NO_DEVICE, OLD_DRIVER, [], "the driver of llvmpipe .* is too old or unfit.*Fix: .*bookworm-backports"),
        (NO_DEVICE, (0, '{"devices": []}'), ["NVIDIA H200"], "NVIDIA_DRIVER_CAPABILITIES"),
        ((-6, "terminate called"), (-11, ""), [], "no Vulkan driver .*; SAPIEN says: SAPIEN ended with exit code -6"),
        (NO_X11, (0, ""), [], "Fix: sudo apt-get install -y libx11-6"),
    ],
    ids=["an old driver", "an NVIDIA GPU without its driver", "a probe that crashes", "no X11"],
)
def test_each_reason_for_no_rendering_has_its_fix(says, monkeypatch, sapien, vulkan, gpus, message):
    monkeypatch.setattr(doctor, "_nvidia", lambda: gpus)
    says[doctor._PROBE_SAPIEN], says[doctor._PROBE_VULKAN] = sapien, vulkan
    assert_refused(message, doctor.require_rendering)


def test_a_wrong_package_version_is_named(monkeypatch):
    real = doctor.importlib.metadata.version
    monkeypatch.setattr(doctor.importlib.metadata, "version", lambda name: "2.2.2" if name == "sapien" else real(name))
    (finding,) = doctor._packages()
    assert finding.status == "missing" and finding.detail == "sapien is 2.2.2, expected >=3.0.3"


def test_a_real_probe_names_the_gaussian_rasteriser():
    finding = doctor._gaussians()
    assert finding.status == "ok" and finding.detail.startswith(("numba: on the processor: ", "gsplat: "))
