"""A look at a video before it is solved: what it shows, whether that is enough, and what to film otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.recording import Frame, Recording
from reconstruct.scene import MIN_PIXELS, estimate_correlated_noise, estimate_depth_noise
from reconstruct.settings import SceneSettings

SHOWN = 12
"""Frames of the contact sheet."""
SAMPLED = 48
"""Frames that are measured, evenly spread; neighbours of them for the motion."""
_WIDTH = 320
"""Pixels across a picture of the contact sheet."""
_NEAR, _FAR = (40, 60, 235), (250, 210, 60)
"""RGB of the object's nearest and farthest depths."""

Grade = Literal["good", "poor", "bad"]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Finding:
    """One property of a video."""

    what: str
    value: str
    grade: Grade
    """'poor': the answer may suffer. 'bad': it will hardly be solved."""
    advice: str = ""
    """What to do about it; empty where it is good."""


@dataclass(frozen=True)
class Look:
    """What a video shows."""

    findings: tuple[Finding, ...]
    sheet: Image
    """(h, w, 3) RGB: frames with the mask's outline, and their depth inside it below."""

    @property
    def grade(self) -> Grade:
        """The worst of all findings."""
        return max((f.grade for f in self.findings), key=("good", "poor", "bad").index)


def look_at(recording: Recording) -> Look:
    """Measure a video (no truth, nothing is solved). Raises FreeArtError where a frame cannot be read."""
    chosen = np.unique(np.linspace(0, len(recording) - 1, SAMPLED).astype(int))
    frames = [recording.frame(int(i)) for i in chosen]
    focal = float(recording.camera.K[0, 0])
    findings = [*_camera(recording), *_frames(recording), *_masks(frames), *_depths(frames, focal)]
    findings += [*_pictures(frames), *_motion(recording, frames, chosen)]
    shown = np.unique(np.linspace(0, len(frames) - 1, SHOWN).astype(int))
    return Look(tuple(findings), _contact_sheet([frames[i] for i in shown]))


def _grade(value: float, good: tuple[float, float], fair: tuple[float, float]) -> Grade:
    """'good' within the first range, 'poor' within the second, else 'bad'."""
    return "good" if good[0] <= value <= good[1] else "poor" if fair[0] <= value <= fair[1] else "bad"


def _finding(what: str, value: str, grade: Grade, advice: str) -> Finding:
    return Finding(what, value, grade, "" if grade == "good" else advice)


def _camera(recording: Recording) -> Iterator[Finding]:
    """Field of view and principal point: phones and depth cameras have 40 to 90 degrees, and within a tenth."""
    camera, K = recording.camera, recording.camera.K
    degrees = float(np.degrees(2 * np.arctan(0.5 * max(camera.width / K[0, 0], camera.height / K[1, 1]))))
    advice = "check the intrinsic matrix: is it of these pixels, and turned with the pictures?"
    yield _finding("field of view", f"{degrees:.0f}°", _grade(degrees, (35, 100), (20, 130)), advice)
    off = max(abs(K[0, 2] / camera.width - 0.5), abs(K[1, 2] / camera.height - 0.5))
    yield _finding("principal point", f"{100 * off:.0f} % off the middle", _grade(off, (0, 0.1), (0, 0.25)), advice)


def _frames(recording: Recording) -> Iterator[Finding]:
    n, least = len(recording), SceneSettings().min_frames
    advice = f"film for longer; at least {least} frames are needed, 60 to 300 are usual"
    yield _finding("frames", str(n), _grade(n, (60, np.inf), (least, np.inf)), advice)
    if n < 2:
        return
    steps = np.diff(recording.times_s)
    rate, gap = 1 / float(np.median(steps)), float(steps.max() / np.median(steps))
    yield _finding(
        "frame rate", f"{rate:.0f} a second", _grade(rate, (10, np.inf), (4, np.inf)), "film with more frames a second"
    )
    yield _finding(
        "longest gap", f"{gap:.1f} frames", _grade(gap, (0, 3.5), (0, 15)), "frames are lost: record to a faster disk"
    )


def _masks(frames: list[Frame]) -> Iterator[Finding]:
    """The object's place in the picture. A frame with fewer than MIN_PIXELS is not used by the solver."""
    pixels = np.array([np.count_nonzero(f.mask) for f in frames])
    share, empty = float(np.median(pixels)) / frames[0].mask.size, float(np.mean(pixels < MIN_PIXELS))
    closer = "hold the object closer to the camera"
    yield _finding(
        "object, share of the picture", f"{100 * share:.1f} %", _grade(share, (0.02, 0.6), (0.003, 0.9)),
        closer if share < 0.02 else "hold it farther away: the mask fills the picture",
    )  # fmt: skip
    yield _finding(
        "frames without the object", f"{100 * empty:.0f} %", _grade(empty, (0, 0.02), (0, 0.3)),
        "make masks for every frame, and keep the object in view",
    )  # fmt: skip
    ends = [np.concatenate([f.mask[0], f.mask[-1], f.mask[:, 0], f.mask[:, -1]]).any() for f in frames]
    cut = float(np.mean(ends))
    yield _finding(
        "frames that cut the object",
        f"{100 * cut:.0f} %",
        _grade(cut, (0, 0.1), (0, 0.6)),
        "keep it inside the picture",
    )


def _depths(frames: list[Frame], focal: float) -> Iterator[Finding]:
    """Depth inside the masks: how much, how far, how noisy, and the size that it gives the object."""
    inside = [f.depth[f.mask] for f in frames if f.mask.any()]
    known = [d[d > 0] for d in inside]
    measured = float(np.mean([len(k) / len(d) for k, d in zip(known, inside, strict=True)])) if inside else 0.0
    yield _finding(
        "depth inside the mask", f"{100 * measured:.0f} % of its pixels", _grade(measured, (0.8, 1), (0.3, 1)),
        "avoid dark, shiny and transparent surfaces, and distances that the sensor does not measure",
    )  # fmt: skip
    known = [k for k in known if len(k) >= MIN_PIXELS]
    if not known:
        return
    distance = float(np.median(np.concatenate([k[::16] for k in known])))
    yield _finding(
        "distance", f"{distance:.2f} m", _grade(distance, (0.15, 3), (0.05, 6)),
        "check the unit of the depth: metres a unit of its pictures (`convert --depth-unit`)",
    )  # fmt: skip
    sizes = []
    for f in frames:
        y, x = np.nonzero(f.mask & (f.depth > 0))
        if len(x) >= MIN_PIXELS:
            points = np.stack([x / focal, y / focal, np.ones(len(x))], -1) * f.depth[y, x, None]
            sizes.append(np.linalg.norm(np.percentile(points, 98, axis=0) - np.percentile(points, 2, axis=0)))
    size = float(np.percentile(sizes, 80))
    yield _finding(
        "size of the object", f"{100 * size:.0f} cm", _grade(size, (0.04, 2), (0.02, 5)),
        "check the unit of the depth and the masks: do they hold anything but the object?",
    )  # fmt: skip
    depth = np.stack([np.where(f.mask, f.depth, 0) for f in frames]).astype(np.float32)
    # of quantised depth the median difference is zero: a step of it spreads as step / sqrt(12)
    steps = np.diff(np.unique(depth[depth > 0]))
    noise = max(estimate_depth_noise(depth), float(np.median(steps)) / np.sqrt(12) if len(steps) else 0.0)
    yield _finding(
        "depth noise, pixel by pixel", f"{1000 * noise:.1f} mm", _grade(noise / size, (0, 0.02), (0, 0.1)),
        "hold the object closer, or use a better sensor",
    )  # fmt: skip


def _pictures(frames: list[Frame]) -> Iterator[Finding]:
    """Exposure and sharpness of the object, the latter against the sharpest frames of the same video."""
    inside = [f.rgb[f.mask] for f in frames if f.mask.any()]
    clipped = float(np.mean([np.mean((rgb >= 254).all(-1)) for rgb in inside])) if inside else 0.0
    yield _finding(
        "overexposed pixels", f"{100 * clipped:.0f} %", _grade(clipped, (0, 0.05), (0, 0.3)), "use softer light"
    )
    sharp = []
    for f in frames:
        if f.mask.any():
            edges = cv2.Laplacian(cv2.cvtColor(np.ascontiguousarray(f.rgb), cv2.COLOR_RGB2GRAY), cv2.CV_32F)
            sharp.append(float(np.mean(np.abs(edges[f.mask]))))
    blurred = float(np.mean(np.array(sharp) < 0.5 * np.percentile(sharp, 90))) if sharp else 0.0
    yield _finding(
        "frames half as sharp as the best", f"{100 * blurred:.0f} %", _grade(blurred, (0, 0.15), (0, 0.5)),
        "move more slowly, or use more light and a shorter exposure",
    )  # fmt: skip


def _motion(recording: Recording, frames: list[Frame], chosen: NDArray[np.int64]) -> Iterator[Finding]:
    """How far the object's pixels move from a frame to the next, and correlated depth noise from the same pairs."""
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    steps: list[float] = []
    shared: list[tuple[float, float]] = []
    for i, first in zip(chosen[::4], frames[::4], strict=True):
        if i + 1 >= len(recording) or np.count_nonzero(first.mask) < MIN_PIXELS:
            continue
        second = recording.frame(int(i) + 1)
        pair = [np.where(f.mask[..., None], f.rgb, 0).astype(np.uint8) for f in (first, second)]
        grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in pair]
        moved = flow.calc(grey[0], grey[1], np.zeros((*grey[0].shape, 2), np.float32))
        steps.append(float(np.median(np.linalg.norm(moved[first.mask], axis=-1))))
        depth = np.stack([np.where(f.mask, f.depth, 0) for f in (first, second)]).astype(np.float32)
        if (depth > 0).any():
            footprint = float(np.median(depth[depth > 0])) / float(recording.camera.K[0, 0])
            shared.append(estimate_correlated_noise(np.stack(pair), depth, footprint))
    if steps:
        fast, still = float(np.percentile(steps, 90)), float(np.mean(np.array(steps) < 0.1))
        yield _finding(
            "motion from frame to frame", f"{fast:.1f} pixels (90 % are slower)", _grade(fast, (0.2, 12), (0.05, 40)),
            "move more slowly" if fast > 12 else "nothing moves: turn the object and open it while you film",
        )  # fmt: skip
        if still > 0.5:
            yield Finding("frames that stand still", f"{100 * still:.0f} %", "poor", "move the object all the time")
    sigma, area = np.median(shared, axis=0) if shared else (0.0, 1.0)
    if sigma > 0:
        yield Finding(
            "depth errors shared by neighbours", f"{1000 * sigma:.1f} mm over {np.sqrt(area):.0f} pixels", "poor",
            "a phone's depth is smoothed: move slowly, film from 25 to 50 cm, and expect a doubtful answer",
        )  # fmt: skip


def _contact_sheet(frames: list[Frame]) -> Image:
    """Pictures with the mask's outline in a row of four, each with its depth below."""
    tiles = []
    for f in frames:
        height = round(_WIDTH * f.mask.shape[0] / f.mask.shape[1])
        picture = cv2.resize(np.ascontiguousarray(f.rgb), (_WIDTH, height), interpolation=cv2.INTER_AREA)
        mask = cv2.resize(f.mask.astype(np.uint8), (_WIDTH, height), interpolation=cv2.INTER_NEAREST)
        lines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, lines, -1, (255, 80, 0), 1)
        depth = cv2.resize(np.where(f.mask, f.depth, 0), (_WIDTH, height), interpolation=cv2.INTER_NEAREST)
        known = depth > 0
        low, high = np.percentile(depth[known], [2, 98]) if known.any() else (0.0, 1.0)
        far = np.clip((depth - low) / max(high - low, 1e-6), 0, 1)[..., None]
        tint = np.where(known[..., None], (1 - far) * _NEAR + far * _FAR, 235).astype(np.uint8)
        tiles.append(np.vstack([picture, tint]))
    blank = np.full_like(tiles[0], 255)
    rows = [np.hstack([*tiles[i : i + 4], *[blank] * (4 - len(tiles[i : i + 4]))]) for i in range(0, len(tiles), 4)]
    return np.asarray(np.vstack(rows), np.uint8)


def read_for_look(path: Path) -> Recording:
    """The recording of a sequence folder; FreeArtError names the command that makes one of something else."""
    from freeart21.files.sequence import read_sequence

    if not (path / "sequence.json").is_file():
        raise FreeArtError(
            f"{path} is not a sequence folder (with sequence.json); a camera's recording becomes one by "
            f"`freeart21 convert {path} --to native --out DATA`, then `freeart21 look DATA/sequences/NAME`"
        )
    return read_sequence(path)
