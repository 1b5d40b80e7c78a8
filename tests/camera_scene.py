"""A scene that every camera of the tests films: a slanted board before a slanted wall, known in closed form."""

from __future__ import annotations

import numpy as np

from freeart21 import se3
from freeart21.formats.rgbd_video import Lens

BOARD, WALL = (200, 60, 40), (40, 90, 200)
"""Colours of both, RGB."""
HALF_BOARD = (0.12, 0.09)
"""Half its width and height along x and y of the first camera, m."""
_BOARD_PLANE = (0.1, -0.2, 1.0), 0.6
_WALL_PLANE = (0.2, 0.1, 1.0), 1.1
"""Normal and offset, m: normal @ point == offset."""


def view_scene(rays: np.ndarray, T_scene_camera: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
    """Whether rays (..., 3) with z = 1 hit the board, and the z-depths of the planes of board and wall, metres."""
    T = np.eye(4) if T_scene_camera is None else T_scene_camera
    direction, origin = rays @ T[:3, :3].T, T[:3, 3]

    def distance(plane):
        normal, offset = plane
        return (offset - np.dot(normal, origin)) / (direction @ np.array(normal))

    near, far = distance(_BOARD_PLANE), distance(_WALL_PLANE)
    hit = origin + direction * near[..., None]
    on_board = (np.abs(hit[..., 0]) < HALF_BOARD[0]) & (np.abs(hit[..., 1]) < HALF_BOARD[1]) & (near > 0)
    return on_board, near, far


def distort(at: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """The rational model of Brown and Conrady, in OpenCV's order k1, k2, p1, p2, k3, k4, k5, k6."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = at[..., 0], at[..., 1]
    r2 = x**2 + y**2
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    moved = [2 * p1 * x * y + p2 * (r2 + 2 * x**2), p1 * (r2 + 2 * y**2) + 2 * p2 * x * y]
    return np.stack([x * radial + moved[0], y * radial + moved[1]], -1)


def film(lens: Lens, T_scene_camera: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """RGB (height, width, 3), z-depth in metres and the board's mask as `lens` sees them."""
    u, v = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
    aim = (np.stack([u, v], -1) - lens.K[:2, 2]) / [lens.K[0, 0], lens.K[1, 1]]
    rays = aim.copy()
    while lens.distorts and np.abs(missed := aim - distort(rays, lens.distortion)).max() > 1e-9:
        rays += missed
    rays = np.concatenate([rays, np.ones((lens.height, lens.width, 1))], -1)
    board, near, far = view_scene(rays, T_scene_camera)
    depth = np.where(board, near, far)
    rgb = np.where(board[..., None], BOARD, WALL).astype(np.uint8)
    return rgb, depth, board


def small_lens(lens: Lens, factor: int) -> Lens:
    """The same view in fewer pixels."""
    width, height = lens.width // factor, lens.height // factor
    return Lens(lens.scaled(width, height), width, height, lens.distortion)


def rig() -> np.ndarray:
    """T_colour_depth of two cameras 5 cm apart, turned by three degrees."""
    return se3.exp_se3(np.array([0.02, -0.05, 0.01, 0.05, 0.002, -0.003]))
