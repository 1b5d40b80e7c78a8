"""gsplat's `rasterization` without a GPU: the arguments and results that we use, in plain torch, for small scenes.

Written from its documentation and from what its kernels do (1.5.3).
"""

import torch


def rasterization(
    means,
    quats,
    scales,
    opacities,
    colors,
    viewmats,
    Ks,
    width,
    height,
    near_plane=0.01,
    far_plane=1e10,
    eps2d=0.3,
    packed=True,
    render_mode="RGB",
    rasterize_mode="classic",
):
    """Pictures (1, h, w, D), alphas (1, h, w, 1), and `means2d`, `radii`, `depths`, `conics`."""
    n = len(means)
    assert means.shape == (n, 3) and quats.shape == (n, 4) and scales.shape == (n, 3) and opacities.shape == (n,)
    assert colors.ndim == 2 and len(colors) == n and viewmats.shape == (1, 4, 4) and Ks.shape == (1, 3, 3)
    assert not packed and render_mode == "RGB" and rasterize_mode == "classic"
    radii, means2d, depths, conics = project(
        means, quats, scales, opacities, viewmats[0], Ks[0], width, height, near_plane, far_plane, eps2d
    )
    means2d = means2d[None]  # what stands in meta is what the picture depends on, as there
    order = torch.nonzero((radii > 0).all(-1))[:, 0]
    order = order[torch.argsort(depths[order], stable=True)]
    pictures = blend(*(x[order] for x in (means2d[0], conics, colors, opacities)), width, height)
    meta = {"means2d": means2d, "radii": radii[None], "depths": depths[None], "conics": conics[None]}
    return *(picture[None] for picture in pictures), meta


def blend(means2d, conics, values, opacities, width, height):
    """Front to back: values (h, w, D) and opacity (h, w, 1)."""
    ys, xs = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    dx, dy = xs.reshape(1, -1) - means2d[:, :1], ys.reshape(1, -1) - means2d[:, 1:]
    a, b, c = (x[:, None] for x in conics.unbind(-1))
    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    alphas = torch.clamp_max(opacities[:, None] * torch.exp(-sigma), 0.999)
    alphas = torch.where((alphas < 1 / 255) | (sigma < 0), torch.zeros_like(alphas), alphas)
    after = torch.cumprod(1 - alphas, 0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    weights = torch.where(after > 1e-4, alphas * before, torch.zeros_like(after))
    shape = (height, width, -1)
    return (weights.T @ values).reshape(shape), weights.sum(0).reshape(shape)


def project(means, quats, scales, opacities, viewmat, K, width, height, near_plane, far_plane, eps2d):
    """Radii (M, 2), projected means (M, 2), depths (M,) and inverse covariances (M, 3)."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    R = torch.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ],
        -1,
    ).reshape(-1, 3, 3)  # fmt: skip
    turn, shift = viewmat[:3, :3], viewmat[:3, 3]
    px, py, pz = (means @ turn.T + shift).unbind(-1)
    M = turn @ (R * scales[:, None, :])
    safe = torch.where(pz.abs() < 1e-9, torch.full_like(pz, 1e-9), pz)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    tx = torch.clamp(px / safe, -(cx + 0.15 * width) / fx, (width - cx + 0.15 * width) / fx)
    ty = torch.clamp(py / safe, -(cy + 0.15 * height) / fy, (height - cy + 0.15 * height) / fy)
    zero = torch.zeros_like(pz)
    J = torch.stack([fx / safe, zero, -fx * tx / safe, zero, fy / safe, -fy * ty / safe], -1).reshape(-1, 2, 3)
    P = J @ M
    covariance = P @ P.transpose(1, 2) + eps2d * torch.eye(2)
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = a * c - b * b
    conics = torch.stack([c, -b, a], -1) / determinant[:, None]
    means2d = torch.stack([fx * px / safe + cx, fy * py / safe + cy], -1)
    with torch.no_grad():
        reach = torch.sqrt(2 * torch.log((opacities * 255).clamp_min(1))).clamp_max(3.33)
        radii = torch.ceil(reach[:, None] * torch.stack([a, c], -1).sqrt())
        window = torch.tensor([width, height])
        inside = ((means2d + radii > 0) & (means2d - radii < window)).all(-1)
        good = inside & (pz >= near_plane) & (pz <= far_plane) & (opacities >= 1 / 255) & (determinant > 0)
        radii = torch.where(good[:, None], radii, torch.zeros_like(radii)).to(torch.int32)
    return radii, means2d, pz, conics
