"""The rasteriser on an NVIDIA GPU: gsplat (Ye et al. 2024; extra `torch`), with torch's derivatives for the two
motions.

The order of its sums varies, so the last digits differ from run to run.
"""

from __future__ import annotations

import functools
import importlib.util
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from freeart21 import se3
from freeart21.se3 import Array, Floats
from reconstruct.gaussians.rasteriser import (
    DILATION,
    NEAR,
    THIN,
    Backward,
    Lens,
    Picture,
    SplatGradients,
    Splats,
)

if TYPE_CHECKING:
    from torch import Tensor

_DEVICE = "cuda"


def missing_requirement() -> str | None:
    """What gsplat lacks here, in one line; None when nothing. Whether its kernels compile is tested by
    `rendering_error`."""
    for package in ("torch", "gsplat"):
        if importlib.util.find_spec(package) is None:
            return f"{package} is not installed (for an NVIDIA GPU: pip install 'freeart21[torch]')"
    try:
        import torch
    except (ImportError, OSError) as error:
        return f"torch cannot be imported: {_first_line(error)}"
    if not torch.cuda.is_available():
        return f"torch {torch.__version__} finds no CUDA GPU"
    try:
        compiled = importlib.util.find_spec("gsplat.csrc") is not None
    except (ImportError, OSError) as error:
        return f"gsplat cannot be imported: {_first_line(error)}"
    if not compiled and not _compiler():
        return "gsplat has to be compiled and there is no nvcc (a CUDA toolkit on PATH or in CUDA_HOME)"
    return None


@functools.cache
def rendering_error() -> str | None:
    """The error when gsplat draws one Gaussian, in one line; None when there is none.

    Compiles gsplat's kernels the first time, which takes minutes.
    """
    one = np.ones((1, 3), np.float32)
    splat = Splats(0 * one, np.ones((1, 4), np.float32), one, one[:, 0], one, np.zeros(1, np.uint8))
    ahead = np.stack([se3.pose(np.eye(3), [0, 0, 2])] * 2)
    try:
        picture, pull = rasterise(splat, ahead, Lens(8.0, 8.0, 4.0, 4.0, 8, 8))
        pull(np.ones_like(picture.colour), np.ones_like(picture.depth), np.ones_like(picture.alpha))
    except Exception as error:  # of a compiler, a linker, a driver: all mean the same here
        return f"gsplat fails: {_first_line(error)}"
    return None if picture.alpha.max() > 0.9 else "gsplat draws nothing"


def rasterise(splats: Splats, Ts: Array, lens: Lens) -> tuple[Picture, Backward]:
    """See `rasteriser.Rasterise`.

    gsplat linearises the projection of means more than 15 % of the window outside it at the clamped position. Where a
    window cuts an object of Gaussians of 2 to 8 mm, colours differ from the numba backend's by 6e-5 on average and
    0.003 at most.
    """
    if len(splats) == 0:
        return _nothing(lens)
    import torch
    from gsplat import rasterization

    def on_device(array: Any) -> Tensor:
        return torch.tensor(np.asarray(array, np.float32), device=_DEVICE)

    poses, moving = np.asarray(Ts, float), on_device(splats.motion)
    leaves = [on_device(getattr(splats, name)) for name in ("means", "quaternions", "scales", "opacities", "colours")]
    leaves.append(torch.zeros((2, 6), device=_DEVICE))
    for leaf in leaves:
        leaf.requires_grad_()
    means, quaternions, scales, opacities, colours, twists = leaves
    which = torch.stack([1 - moving, moving], 1)  # (M, 2): a product with it, unlike indexing, is quick both ways
    R = (which @ on_device(poses[:, :3, :3]).reshape(2, 9)).reshape(-1, 3, 3)
    placed = (R @ means[:, :, None])[:, :, 0] + which @ on_device(poses[:, :3, 3])
    v, w = (which @ twists).split(3, 1)
    turn = torch.cat([torch.ones_like(v[:, :1]), 0.5 * w], 1)  # exp of a small twist, to first order
    points = placed + v + torch.linalg.cross(w, placed)
    turned = _product(turn, _product(which @ on_device(se3.wxyz(poses)), quaternions))
    seen, alpha, meta = rasterization(
        points,
        turned,
        scales,
        opacities,
        torch.cat([colours, moving[:, None], _planes(points, turned, scales, lens)], 1),
        torch.eye(4, device=_DEVICE)[None],
        on_device([[[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]]]),
        lens.width,
        lens.height,
        near_plane=NEAR,
        eps2d=DILATION,
        packed=False,
        render_mode="RGB",
        rasterize_mode="classic",
    )
    y, x = np.mgrid[: lens.height, : lens.width].astype(np.float32) + np.float32(0.5)
    place = np.stack([np.ones_like(x), x - np.float32(lens.cx), y - np.float32(lens.cy)], 2)
    pictures = [
        _array(seen[0, :, :, :3]),
        (_array(seen[0, :, :, 4:]) * place).sum(2),
        _array(alpha[0, :, :, 0]),
        _array(seen[0, :, :, 3]),
    ]

    def pull(d_colour: Floats, d_depth: Floats, d_alpha: Floats) -> SplatGradients:
        d_seen = np.concatenate([d_colour, np.zeros_like(d_depth)[:, :, None], d_depth[:, :, None] * place], 2)
        given = [on_device(d_seen)[None], on_device(d_alpha)[None, :, :, None]]
        found = torch.autograd.grad([seen, alpha], [*leaves, meta["means2d"]], given)
        *by_splat, by_twists, by_place = (_array(d) for d in found)
        means, quaternions, scales, opacities, colours = by_splat
        drawn = _array((meta["radii"][0] > 0).all(-1))
        screen = np.hypot(*by_place[0].T)
        return SplatGradients(means, quaternions, scales, opacities, colours, by_twists.astype(float), screen, drawn)

    return Picture(*pictures), pull


def _planes(points: Tensor, turns: Tensor, scales: Tensor, lens: Lens) -> Tensor:
    """(M, 3) depth of Gaussians in the camera's frame as coefficients of 1, x - cx and y - cy. See `Picture`.

    gsplat itself only has the depth of the means.
    """
    import torch

    points, turns, scales = points.double(), turns.double(), scales.double()  # needles cancel in single precision
    w, i, j, k = (turns / torch.linalg.norm(turns, dim=1, keepdim=True)).unbind(1)
    rows = [
        torch.stack([1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)], 1) * scales,
        torch.stack([2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)], 1) * scales,
        torch.stack([2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)], 1) * scales,
    ]
    x, y, z = (p[:, None] for p in points.unbind(1))
    u, v = (lens.fx * (rows[0] - x / z * rows[2]) / z, lens.fy * (rows[1] - y / z * rows[2]) / z)
    a, b, c = (u * u).sum(1) + THIN, (u * v).sum(1), (v * v).sum(1) + THIN
    with_u, with_v = (u * rows[2]).sum(1), (v * rows[2]).sum(1)
    thin = a * c - b * b
    across, down = (c * with_u - b * with_v) / thin, (a * with_v - b * with_u) / thin
    x, y, z = points.unbind(1)
    return torch.stack([z - across * lens.fx * x / z - down * lens.fy * y / z, across, down], 1).float()


def _product(a: Tensor, b: Tensor) -> Tensor:
    """Quaternion product (M, 4), wxyz: the rotation b, then a."""
    import torch

    aw, ax, ay, az = a.unbind(1)
    bw, bx, by, bz = b.unbind(1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        1,
    )


def _array(tensor: Tensor) -> Any:
    return np.ascontiguousarray(tensor.detach().cpu().numpy())


def _nothing(lens: Lens) -> tuple[Picture, Backward]:
    """The empty image of no Gaussians."""
    empty = np.zeros((lens.height, lens.width), np.float32)
    one, three, four = (np.zeros((0, *shape), np.float32) for shape in ((), (3,), (4,)))
    gradients = SplatGradients(three, four, three, one, three, np.zeros((2, 6)), one, np.zeros(0, bool))
    return Picture(np.zeros((*empty.shape, 3), np.float32), empty, empty, empty), lambda *_: gradients


def _compiler() -> bool:
    from torch.utils.cpp_extension import CUDA_HOME

    return shutil.which("nvcc") is not None or (CUDA_HOME is not None and (Path(CUDA_HOME) / "bin" / "nvcc").is_file())


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
