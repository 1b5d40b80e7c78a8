"""Which rasteriser draws here: gsplat where torch, gsplat and an NVIDIA GPU are, else the processor's."""

from __future__ import annotations

from typing import Literal

from freeart21.errors import FreeArtError
from reconstruct.gaussians.rasteriser import Rasterise

Name = Literal["auto", "numba", "gsplat"]


def choose(name: Name = "auto") -> Rasterise:
    """The rasteriser `name`; auto is gsplat where it works, else numba.

    Raises FreeArtError when gsplat is asked for and does not work here. Where gsplat is not compiled yet, it is now,
    which takes minutes.
    """
    from reconstruct.gaussians import gsplat_backend, numba_backend

    if name == "numba":
        return numba_backend.rasterise
    wrong = gsplat_backend.lack() or gsplat_backend.fault()
    if wrong is None:
        return gsplat_backend.rasterise
    if name == "gsplat":
        raise FreeArtError(f"Gaussians cannot be drawn by gsplat here: {wrong}; expected auto or numba")
    return numba_backend.rasterise


def outlook() -> tuple[str, str]:
    """What `choose('auto')` would take, numba or gsplat, and why, in one line; compiles nothing."""
    from reconstruct.gaussians import gsplat_backend

    lack = gsplat_backend.lack()
    if lack is None:
        return "gsplat", "torch, gsplat and a CUDA GPU are here; its kernels are compiled at first use, in minutes"
    return "numba", f"on the processor: {lack}"
