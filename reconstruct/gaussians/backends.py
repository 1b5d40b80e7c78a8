"""Choice of the rasteriser: gsplat where torch, gsplat and an NVIDIA GPU work, otherwise the one on the processor."""

from __future__ import annotations

from typing import Literal

from freeart21.errors import FreeArtError
from reconstruct.gaussians.rasteriser import Rasterise

Name = Literal["auto", "numba", "gsplat"]


def choose_backend(name: Name = "auto") -> Rasterise:
    """The rasteriser `name`; 'auto' is gsplat where it works, otherwise numba.

    Raises FreeArtError when gsplat is requested and does not work here. Compiles gsplat's kernels if needed, which
    takes minutes.
    """
    from reconstruct.gaussians import gsplat_backend, numba_backend

    if name == "numba":
        return numba_backend.rasterise
    wrong = gsplat_backend.missing_requirement() or gsplat_backend.rendering_error()
    if wrong is None:
        return gsplat_backend.rasterise
    if name == "gsplat":
        raise FreeArtError(f"Gaussians cannot be drawn by gsplat here: {wrong}; expected auto or numba")
    return numba_backend.rasterise


def predict_backend() -> tuple[str, str]:
    """The choice of `choose_backend('auto')`, numba or gsplat, and the reason, in one line; compiles nothing."""
    from reconstruct.gaussians import gsplat_backend

    missing_requirement = gsplat_backend.missing_requirement()
    if missing_requirement is None:
        return "gsplat", "torch, gsplat and a CUDA GPU are here; its kernels are compiled at first use, in minutes"
    return "numba", f"on the processor: {missing_requirement}"
