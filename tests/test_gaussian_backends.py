"""Which rasteriser draws, and the way through gsplat: on a GPU where one is, else with its kernels stood in for."""

import inspect
import sys
import types
from dataclasses import fields

import numpy as np
import pytest
from gaussian_scenes import GRADIENT_SCENES, SCENES, check_gradients, check_picture, poses, splats

from freeart21.errors import FreeArtError
from reconstruct.gaussians import backends, gsplat_backend, numba_backend
from reconstruct.gaussians.rasteriser import Lens


@pytest.fixture(autouse=True)
def asked_anew():
    gsplat_backend.rendering_error.cache_clear()
    yield
    gsplat_backend.rendering_error.cache_clear()


@pytest.fixture
def stand_in(monkeypatch):
    """gsplat's function on a processor: everything but its kernels is ours and runs."""
    pytest.importorskip("torch", reason="torch is not installed (extra torch)")
    import gsplat_like

    monkeypatch.setattr(gsplat_backend, "_DEVICE", "cpu")
    monkeypatch.setitem(sys.modules, "gsplat", types.SimpleNamespace(rasterization=gsplat_like.rasterization))
    return gsplat_like


@pytest.mark.parametrize("name", SCENES)
def test_pictures_by_way_of_gsplat(stand_in, name):
    check_picture(gsplat_backend.rasterise, *SCENES[name](), clamp=True)


@pytest.mark.parametrize("name", GRADIENT_SCENES)
def test_gradients_by_way_of_gsplat(stand_in, name):
    check_gradients(gsplat_backend.rasterise, *GRADIENT_SCENES[name](), clamp=True)


def test_the_stand_in_is_called_as_gsplat_is(stand_in, monkeypatch):
    monkeypatch.delitem(sys.modules, "gsplat")
    real = inspect.signature(pytest.importorskip("gsplat", reason="gsplat is not installed").rasterization).parameters
    ours = inspect.signature(stand_in.rasterization).parameters
    names = list(real)
    assert names[:9] == list(ours)[:9]
    assert {name: p.default for name, p in ours.items()} == {name: real[name].default for name in ours}


def test_both_backends_on_a_gpu():
    lack = gsplat_backend.missing_requirement()
    if lack:
        pytest.skip(f"no gsplat on a GPU: {lack}")
    assert gsplat_backend.rendering_error() is None
    some, lens = splats(3000, 40, (0.002, 0.02)), Lens(300.0, 300.0, 101.0, 83.0, 203, 165)
    rng = np.random.default_rng(41)
    weights = [rng.normal(size=s).astype(np.float32) for s in ((165, 203, 3), (165, 203), (165, 203))]
    (ours, our_pull), (theirs, their_pull) = (b.rasterise(some, poses(), lens) for b in (numba_backend, gsplat_backend))
    for field in fields(ours):
        difference = np.abs(getattr(ours, field.name) - getattr(theirs, field.name))
        assert np.quantile(difference, 0.99) < 1e-3 and difference.max() < 0.05, field.name
    a, b = our_pull(*weights), their_pull(*weights)
    for name in ("means", "quaternions", "scales", "opacities", "colours", "twists"):
        x, y = getattr(a, name).ravel(), getattr(b, name).ravel()
        assert np.linalg.norm(x - y) < 0.02 * np.linalg.norm(x), name


# --- which one is taken -----------------------------------------------------------------------------------------------


def test_without_a_package_the_processor_draws(monkeypatch):
    monkeypatch.setattr(gsplat_backend.importlib.util, "find_spec", lambda name: None)
    assert backends.choose_backend() is numba_backend.rasterise
    name, why = backends.predict_backend()
    assert name == "numba" and why.startswith("on the processor: torch is not installed (")
    with pytest.raises(FreeArtError, match="cannot be drawn by gsplat here: torch is not installed") as raised:
        backends.choose_backend("gsplat")
    assert "\n" not in str(raised.value)


def _torch(cuda, toolkit):
    return {
        "torch": types.SimpleNamespace(__version__="2.9", cuda=types.SimpleNamespace(is_available=lambda: cuda)),
        "torch.utils": types.SimpleNamespace(),
        "torch.utils.cpp_extension": types.SimpleNamespace(CUDA_HOME=toolkit),
    }


@pytest.mark.parametrize(
    "cuda, toolkit, built, expected",
    [
        (False, None, True, "finds no CUDA GPU"),
        (True, None, False, "there is no nvcc"),
        (True, "/nowhere", False, "there is no nvcc"),
        (True, None, True, None),
        (True, "here", False, None),
    ],
)
def test_what_is_missing_is_named(monkeypatch, tmp_path, cuda, toolkit, built, expected):
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "nvcc").touch()
    for name, module in _torch(cuda, str(tmp_path) if toolkit == "here" else toolkit).items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(gsplat_backend.shutil, "which", lambda name: None)
    specs = {"torch": 1, "gsplat": 1, **({"gsplat.csrc": 1} if built else {})}
    monkeypatch.setattr(gsplat_backend.importlib.util, "find_spec", specs.get)
    lack = gsplat_backend.missing_requirement()
    assert lack is None if expected is None else expected in lack
    assert backends.predict_backend()[0] == ("gsplat" if expected is None else "numba")
