"""How good masks without hand work are: recordings with a hand, a room or a person put behind, against their truth.

    python -m benchmarks.masks --data OUT [--saliency u2netp.onnx] [--hands FOLDER]

The recordings (sensor `hand`) are made in OUT when they are not there. A row is a recording with a background: IoU of
the mask per frame (mean and the 10th percentile), the share of the hand's pixels in it, and how well the doubt orders
the frames: the probability that of two frames whose IoUs differ by 0.1 the worse has the higher doubt.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from benchmarks.common import RESULTS, ROOT, format_number, make_table, run_cli, wide_console, write_report
from freeart21 import se3
from freeart21.files.sequence import read_sequence
from freeart21.recording import Frame, Recording
from reconstruct.masks import MaskSettings, find_masks

Background = Literal["none", "room", "person", "handheld"]
BACKGROUNDS: tuple[Background, ...] = ("none", "room", "person", "handheld")
CASES = (("stapler", "human", "hand+tof", 3), ("office_scissors", "human", "hand+tof", 3),
         ("slider_phone", "tumble", "hand+phone", 4), ("tilt_monitor", "tumble", "hand+phone", 4),
         ("flip_lighter", "inspect", "hand", 5), ("drawer_unit", "inspect", "hand", 5))  # fmt: skip
"""Object, motion, sensor, seed."""
_TEXTURES = ("brick.png", "gravel.png", "astronaut.png", "coffee.png")
_GREY = 25
"""Distance of a recording's colours from its grey background, of 255, from which on a pixel shows something."""


def put_behind(recording: Recording, kind: Background, seed: int = 0) -> Recording:
    """`recording` with a wall, a floor and a picture on it behind object and hand, and a swaying person for 'person'.

    'handheld' moves the camera before the room by some 5 cm and 3 degrees; object and hand are held in its frame. The
    depth of what is behind has the noise of a Kinect (Nguyen 2012), and half of the pixels at silhouettes have none.
    """
    if kind == "none":
        return recording
    first = recording.frame(0)
    distance = float(np.median(first.depth[first.mask & (first.depth > 0)]))
    brick, gravel, person, coffee = (_texture(name) for name in _TEXTURES)
    rays = recording.camera.rays()
    phases = np.random.default_rng([seed, 0]).uniform(0, 2 * np.pi, 6)

    def load(index: int) -> Frame:
        frame, t = recording.frame(index), float(recording.times_s[index])
        T = np.eye(4)
        if kind == "handheld":
            wave = np.sin(2 * np.pi * t * np.array([0.5, 0.4, 0.3, 0.45, 0.35, 0.55]) + phases)
            T = se3.pose(se3.exp_so3(np.radians(3) * wave[:3]), 0.15 * distance * wave[3:])
        d, o = rays @ T[:3, :3].T, T[:3, 3]
        rgb, depth = np.zeros_like(frame.rgb), np.full(frame.depth.shape, np.inf)
        wall = np.array([np.sin(0.3), 0.0, np.cos(0.3)])
        _draw_plane(rgb, depth, d, o, wall, 2.5 * distance, brick, distance)
        _draw_plane(rgb, depth, d, o, wall, 2.45 * distance, coffee, distance, (-0.5, -0.6, 0.8, 0.6))
        _draw_plane(rgb, depth, d, o, np.array([0, 1.0, 0.15]), 0.8 * distance, gravel, distance)
        if kind == "person":
            sway = 0.03 * distance * np.sin(2 * np.pi * 0.3 * t + phases[0])
            at = distance + max(0.25, 0.5 * distance)
            _draw_plane(rgb, depth, d, o + np.array([sway, 0, 0]), np.array([0, 0, 1.0]), at, person, distance,
                        (-0.8, -0.8, 1.6, 1.6), outline=True)  # fmt: skip
        rng = np.random.default_rng([seed, 1, index])
        depth += rng.normal(0, 0.0012 + 0.0019 * (np.minimum(depth, 10) - 0.4) ** 2, depth.shape)
        grey = np.median(frame.rgb[~frame.mask & (frame.depth == 0)], axis=0)
        shown = np.linalg.norm(frame.rgb - grey, axis=-1) > _GREY
        near = cv2.dilate((frame.depth > 0).astype(np.uint8), np.ones((3, 3))) > 0
        front = frame.mask | (frame.depth > 0) | (shown & near)
        rim = cv2.dilate(front.astype(np.uint8), np.ones((3, 3))) > 0
        depth[rim & (rng.random(depth.shape) < 0.5)] = 0
        depth[~np.isfinite(depth)] = 0
        return Frame(
            np.where(front[..., None], frame.rgb, rgb),
            np.where(front, frame.depth, depth).astype(np.float32),
            frame.mask,
        )

    return replace(recording, load=load, name=f"{recording.name}-{kind}")


def _texture(name: str) -> np.ndarray:
    import skimage.data

    image = cv2.imread(str(Path(skimage.data.__file__).parent / name))
    assert image is not None
    return np.asarray(image[..., ::-1])


def _draw_plane(rgb: np.ndarray, depth: np.ndarray, d: np.ndarray, o: np.ndarray, normal: np.ndarray, offset: float,
                texture: np.ndarray, scale: float, box: tuple[float, float, float, float] | None = None,
                outline: bool = False) -> None:  # fmt: skip
    """Draw the plane normal . x = offset where it is nearer than `depth`; only `box` (x, y, w, h, in `scale`)."""
    z = (offset - o @ normal) / np.where(np.abs(d @ normal) < 1e-6, np.nan, d @ normal)
    at = (o + z[..., None] * d) / scale
    u, v = at[..., 0], np.where(abs(normal[1]) > 0.5, at[..., 2], at[..., 1])
    seen = (z > 0) & (z < depth)
    if box is None:
        u, v = u - np.floor(u), v - np.floor(v)
    else:
        u, v = (u - box[0]) / box[2], (v - box[1]) / box[3]
        seen &= (u > 0) & (u < 1) & (v > 0) & (v < 1)
    if outline:  # head and shoulders of the portrait
        seen &= (np.hypot((u - 0.43) / 0.14, (v - 0.22) / 0.2) < 1) | (np.hypot((u - 0.45) / 0.4, (v - 1) / 0.62) < 1)
    h, w = texture.shape[:2]
    with np.errstate(invalid="ignore"):
        i, j = (np.clip(np.nan_to_num(x) * n, 0, n - 1).astype(int) for x, n in ((v, h), (u, w)))
    rgb[seen], depth[seen] = texture[i, j][seen], z[seen]


def measure_masks(recording: Recording, settings: MaskSettings) -> dict[str, float]:
    """Numbers of one recording whose masks are true."""
    start = time.process_time()
    found = find_masks(recording, settings)
    seconds = time.process_time() - start
    true = np.stack([frame.mask for frame in recording.frames()])
    both, either = (true & found.masks).sum((1, 2)), (true | found.masks).sum((1, 2))
    iou = both / np.maximum(either, 1)
    worse = iou[:, None] < iou[None] - 0.1
    order = np.sign(found.doubt[:, None] - found.doubt[None])[worse]
    return {
        "iou": float(iou.mean()),
        "iou_10": float(np.percentile(iou, 10)),
        "missed": float(1 - both.sum() / true.sum()),
        "too_much": float(1 - both.sum() / max(found.masks.sum(), 1)),
        "doubt": float(found.doubt.mean()),
        "doubt_order": float((1 + order).mean() / 2) if len(order) else float("nan"),
        "seconds_per_frame": seconds / len(true),
    }


def main(
    data: Path,
    frames: int = 48,
    saliency: Path | None = None,
    hands: Path | None = None,
    out: Path = RESULTS / "masks.json",
    only: tuple[str, ...] = (),
) -> None:
    """Measure automatic masks.

    Args:
        data: Folder for the recordings.
        frames: Of each recording, 480 by 270 pixels.
        saliency: u2netp.onnx.
        hands: Folder of MediaPipe's networks.
        out: JSON file with the table.
        only: Objects; all when empty.
    """
    rows = []
    for name, motion, sensor, seed in CASES:
        if only and name not in only:
            continue
        folder = data / f"{motion}-{sensor}" / "sequences" / f"{name}-s{seed}"
        if not folder.is_dir():
            command = [*("record", name, "--motion", motion, "--sensor", sensor, "--seed", str(seed)), "--frames"]
            command += [str(frames), "--width", "480", "--height", "270", "--queries", "0"]
            place = str(data / f"{motion}-{sensor}")
            subprocess.run([sys.executable, "-m", "freeart21", *command, "--out", place], check=True, cwd=ROOT)
        recording = read_sequence(folder)
        for kind in BACKGROUNDS:
            row = {"object": name, "sensor": sensor, "background": kind}
            settings = MaskSettings(saliency=saliency, hands=hands)
            rows.append({**row, **measure_masks(put_behind(recording, kind), settings)})
            print(json.dumps(rows[-1]), flush=True)
    rows.sort(key=lambda row: row["iou"])
    numbers = list(rows[0])[3:]
    lines = [
        [row["object"], row["sensor"], row["background"], *(format_number(row[k]) for k in numbers)] for row in rows
    ]
    wide_console().print(make_table("masks without hand work", list(rows[0]), lines, ("sensor", "background")))
    write_report(out, {"frames": frames, "saliency": saliency is not None, "hands": hands is not None}, rows=rows)


if __name__ == "__main__":
    run_cli(main)
