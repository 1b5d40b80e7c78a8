"""Masks of the object without hand work: what is held in front of the static scene, less the hand and the arm.

Evidence of a frame: depth in front of the background that other frames show there (along the camera's motion where it
moves), the nearest of the moving layers, colours that differ from the background where there is no depth. Hand and arm
are what has the colours of skin, and regions that enter from the picture's rim; their colours and the object's are
learned from the whole video. All is carried along the video by optical flow where depths agree. Every frame has a
doubt.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from freeart21.errors import FreeArtError
from freeart21.files.masks import Click, Masks
from freeart21.recording import Recording
from reconstruct.hands import HandNetwork, draw_hand
from reconstruct.segmenters import Prompt, Sam2

Bools = NDArray[np.bool_]
Image = NDArray[np.uint8]
Values = NDArray[Any]
"""Single precision, half precision for flows; OpenCV's stubs give no more exact type."""

Progress = Callable[[str, int, int], None]
QUIET: Progress = lambda what, done, total: None  # noqa: E731

LONGEST_SIDE = 480
"""Pixels of the working pictures."""
STILL_PX = 0.3
"""Flow, pixels a frame, up to which a pixel stands still: three times what DIS gives on static textured scenes."""
LEAST_GAP = 0.012
"""Metres that the object is in front of the background at least: two fingers' thickness. Not measured."""
_SKIN_CR, _SKIN_CB = (133, 173), (77, 127)
"""Chroma of skin of all tones, 8 bits (Chai and Ngan 1999)."""
_TEXTURE = 24.0
"""Sobel's gradient, grey levels, from which on a pixel shows texture: four times that of usual noise."""
_RIM = 2
"""Pixels from the picture's border that count as its rim."""
_SKIN_HUE = (25.0, 68.0)
"""Its hue in CIELAB, degrees: 40 to 65 on average (Xiao et al. 2017), less in red light; wood and brass have more."""
_LEAST_FOUND = 0.1
"""Share of frames in which hands are found, from which on their colours are learned there, not from skin's."""
PROMPTS = 3
"""Frames whose own masks a segmenter starts from, the least doubtful of equal stretches of the video. Set by hand."""
_COLOUR_BINS = (12, 32, 32)
"""Bins of CIELAB lightness, a, b; smoothed by one bin."""


@dataclass(frozen=True)
class _Video:
    """Working pictures: (n, h, w, ...)."""

    rgb: Image
    depth: Values
    K: Values
    forward: Values
    """(n, h, w, 2) flow to the next frame; the last has zeros."""
    backward: Values


class Foreground:
    """What is in front of the static scene, measured once; `masks` then costs a twentieth of a second a frame.

    The masks of the recording are not looked at.
    """

    def __init__(self, recording: Recording, hands: Path | None = None, progress: Progress = QUIET) -> None:
        """`hands`: folder of MediaPipe's networks (`reconstruct.hands`), which find hands by shape, where skin's colour
        misleads. `progress` is called with what is done, how many frames of it, of how many."""
        self._recording = recording
        self._video = video = _load(recording, progress)
        still, motions = _residual_flow(video)
        front, self._notes = _in_front(video, still, motions)
        front = _nearest_layer(video, front)
        self._front = front
        self._palms = None if hands is None else _draw_hands(video, HandNetwork(hands), progress)
        solid = front > 0.5
        moving = (solid & ~still).sum((1, 2)) / np.maximum(solid.sum((1, 2)), 1)
        self._empty = bool(np.median(solid.mean((1, 2))) < 1e-4 or np.percentile(moving, 90) < 0.05)

    def masks(self, clicks: Sequence[Click] = ()) -> Masks:
        """The masks, corrected by clicks: surface around a click, followed by flow, and its colours in all frames.

        Raises FreeArtError when nothing moves and there are no clicks, or a click is not in the video.
        """
        recording, notes = self._recording, list(self._notes)
        if self._empty and not clicks:
            raise FreeArtError(
                f"{recording.name}: nothing that is held in front of the static scene moves: film an object that is "
                "moved before the camera, mark it by clicks (`masks --click`), or name a folder of masks"
            )
        seeds = _carry_clicks(self._video, clicks, recording)
        front = np.where(seeds > 0, np.float32(1), self._front)
        hand = _hand(self._video, front, self._palms, seeds, notes)
        object_ = _carry(self._video, front * (1 - hand), seeds)
        masks, doubt, reasons = _choose(self._video, object_, front, seeds)
        return Masks(_enlarge(masks, object_, recording), doubt, reasons, tuple(notes))


def carry_masks(recording: Recording, own: Masks, segmenter: Sam2, clicks: Sequence[Click] = ()) -> Masks:
    """Masks by a segmenter, from our `own` in the least doubtful frames, and from the clicks.

    There are two opinions of every frame: its doubt is what they do not share, 1 - IoU, and 1 where the segmenter
    finds nothing. Raises FreeArtError when no frame has a mask or click.
    """
    stretches = [part for part in np.array_split(np.arange(len(own.doubt)), PROMPTS) if len(part)]
    least = [int(part[np.argmin(own.doubt[part])]) for part in stretches]
    frames = sorted({click.frame for click in clicks})
    prompts = [Prompt(i, own.masks[i]) for i in least if own.masks[i].any() and i not in frames]
    for frame in frames:
        marks = tuple((c.column, c.row, c.on_object) for c in clicks if c.frame == frame)
        prompts.append(Prompt(frame, clicks=marks))
    if not prompts:
        raise FreeArtError(f"{recording.name}: no frame has a mask to start from; mark the object by clicks (--click)")
    found = segmenter.carry([np.ascontiguousarray(frame.rgb) for frame in recording.frames()], prompts)
    union = np.maximum((found | own.masks).sum((1, 2)), 1)
    differs = 1 - (found & own.masks).sum((1, 2)) / union
    empty = found.sum((1, 2)) == 0
    doubt = np.where(empty, 1.0, differs)
    reasons = tuple(
        f"{segmenter.name} finds nothing" if none else f"{segmenter.name} and our own mask differ" for none in empty
    )
    note = f"carried by {segmenter.name} from frames {', '.join(str(p.frame) for p in prompts)}"
    return Masks(found, doubt, reasons, (*own.notes, note))


def _load(recording: Recording, progress: Progress) -> _Video:
    camera = recording.camera
    scale = min(1.0, LONGEST_SIDE / max(camera.width, camera.height))
    width, height = round(scale * camera.width), round(scale * camera.height)
    n = len(recording)
    rgb, depth = np.zeros((n, height, width, 3), np.uint8), np.zeros((n, height, width), np.float32)
    for i, frame in enumerate(recording.frames()):
        rgb[i] = cv2.resize(np.ascontiguousarray(frame.rgb), (width, height), interpolation=cv2.INTER_AREA)
        depth[i] = cv2.resize(frame.depth, (width, height), interpolation=cv2.INTER_NEAREST)
        progress("read", i + 1, n)
    K = np.diag([width / camera.width, height / camera.height, 1.0]) @ camera.K
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in rgb]
    forward, backward = (np.zeros((n, height, width, 2), np.float16) for _ in range(2))
    for i in range(n - 1):
        forward[i] = dis.calc(grey[i], grey[i + 1], np.zeros((height, width, 2), np.float32))
        backward[i + 1] = dis.calc(grey[i + 1], grey[i], np.zeros((height, width, 2), np.float32))
        progress("flow", i + 1, n - 1)
    return _Video(rgb, depth, K.astype(np.float32), forward, backward)


def _residual_flow(video: _Video) -> tuple[Bools, list[NDArray[np.float64]] | None]:
    """Pixels that move with the static scene, and per frame the (4, 4) camera motion to the next one.

    The motion is None where the picture's rim stands still. It is that of most pixels that are not among the nearest
    third (PnP with RANSAC).
    """
    n, h, w = video.depth.shape
    size = np.linalg.norm(video.forward.astype(np.float32), axis=-1)
    size[-1] = size[max(n - 2, 0)]
    band = max(2, round(0.06 * w))
    rim = np.ones((h, w), bool)
    rim[band:-band, band:-band] = False
    rim[-band:] = False  # arms come from below
    if n < 2:
        return size < STILL_PX, None
    at_rim = []
    for i in range(n - 1):
        grey = cv2.GaussianBlur(cv2.cvtColor(video.rgb[i], cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1)
        textured = rim & (np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)) > _TEXTURE)
        if textured.sum() > 0.1 * rim.sum():
            at_rim.append(np.median(size[i][textured]))
    if not at_rim or np.median(at_rim) < STILL_PX:
        return size < STILL_PX, None
    motions: list[NDArray[np.float64]] = []
    still = np.zeros((n, h, w), bool)
    v, u = (x[::6, ::6].ravel() for x in np.indices((h, w)))
    grid = np.indices((h, w)).astype(np.float32)
    fx, fy, cx, cy = video.K[0, 0], video.K[1, 1], video.K[0, 2], video.K[1, 2]
    rays = np.stack([(u + 0.5 - cx) / fx, (v + 0.5 - cy) / fy, np.ones(len(u))])
    all_rays = np.stack([(grid[1] + 0.5 - cx) / fx, (grid[0] + 0.5 - cy) / fy, np.ones_like(grid[0])], -1)
    for i in range(n - 1):
        z = video.depth[i, v, u]
        known = z > (np.percentile(z[z > 0], 33) if (z > 0).any() else 0)
        T = np.eye(4)
        if np.count_nonzero(known) >= 50:
            points = (rays * z).T[known].astype(np.float64)
            to = (np.stack([u, v], -1) + 0.5 + video.forward[i, v, u].astype(np.float32))[known].astype(np.float64)
            good, turn, shift, _ = cv2.solvePnPRansac(
                points, to, video.K.astype(np.float64), None, iterationsCount=100, reprojectionError=0.7
            )
            if good:
                T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
        motions.append(T)
        moved = (all_rays * video.depth[i][..., None]) @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32)
        seen = moved[..., :2] / np.maximum(moved[..., 2:], 1e-6) * video.K[[0, 1], [0, 1]] + video.K[:2, 2]
        expected = seen - np.stack([grid[1], grid[0]], -1) - 0.5
        off = np.linalg.norm(video.forward[i].astype(np.float32) - expected, axis=-1)
        still[i] = (off < 3 * STILL_PX) & (video.depth[i] > 0)
    still[-1] = still[-2]
    return still, motions


def _gap(depth: Values) -> Values:
    """Difference of depths, metres, that is no noise: four sigma of a Kinect (Nguyen et al. 2012)."""
    return np.maximum(LEAST_GAP, 4 * (0.0012 + 0.0019 * (depth - 0.4) ** 2)).astype(np.float32)


def _in_front(video: _Video, still: Bools, motions: list[NDArray[np.float64]] | None) -> tuple[Values, list[str]]:
    """(n, h, w) probability that a pixel is in front of the static scene, and notes."""
    notes: list[str] = []
    n = len(video.depth)
    if motions is None:
        behind = np.broadcast_to(_static_background(video, still), video.depth.shape)
    else:
        notes.append("the camera moves: the static scene is followed by its depth")
        behind = _moving_background(video, still, motions)
    front = np.zeros(video.depth.shape, np.float32)
    colour = _background_colour(video, still, behind) if motions is None else None
    for i in range(n):
        z = video.depth[i]
        gap = _gap(np.minimum(z, 5))
        p = np.where(z > 0, 1 / (1 + np.exp(-np.clip((behind[i] - z - gap) / (0.25 * gap), -30, 30))), 0)
        known = z > 0
        if colour is not None:
            differs = np.linalg.norm(_lab(video.rgb[i]) - colour, axis=-1)
            p = np.where(known, p, np.where(differs > 15, 0.7, 0.2))
            known = known | np.isfinite(differs)
        front[i] = _fill(p.astype(np.float32), known, video.rgb[i])
    return front, notes


def _static_background(video: _Video, still: Bools) -> Values:
    """(h, w) depth of the static scene, metres; infinity where nothing was measured.

    A pixel shows it when it never moves, or, while it stands still, is farther than what moves there at other times.
    Other pixels can have shown the object all the time: they get the depth of the nearest pixel that shows the scene.
    """
    chosen = np.unique(np.linspace(0, len(still) - 1, 64).astype(int))
    depth, calm = video.depth[chosen], still[chosen]
    times, blank = (calm & (depth > 0)).sum(0), (calm & (depth == 0)).sum(0)
    if blank.sum() > times.sum():  # the depth behind was not measured, or has been cut off
        return np.full(times.shape, np.inf, np.float32)
    seen = np.sort(np.where(calm & (depth > 0), depth, np.inf), axis=0)
    at = np.clip((0.85 * (times - 1)).round().astype(int), 0, None)
    behind = np.take_along_axis(seen, at[None], 0)[0].astype(np.float32)
    moves = (np.linalg.norm(video.forward[chosen].astype(np.float32), axis=-1) > 3 * STILL_PX).mean(0)
    never = (moves < 0.03) & (calm.mean(0) > 0.6)
    nearest = np.where(depth > 0, depth, np.inf).min(0)
    farthest = depth.max(0)
    behind[times == 0] = 50
    gap = _gap(np.minimum(behind, 5))
    layers = (times >= 2) & (behind - nearest > 2 * gap) & (farthest - behind < 2 * gap)
    empty = (blank > 4 * times) & (blank >= 2)
    behind[empty] = np.inf
    known = (never & ~_islands(behind, never, layers | empty)) | layers | empty
    if not known.any():
        return np.full(behind.shape, np.inf, np.float32)
    place = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(behind[tuple(place)], np.float32)


def _islands(behind: Values, never: Bools, others: Bools) -> Bools:
    """Of the surfaces that never moved those that stand before all around them: the object can have rested there."""
    jump = np.zeros(never.shape, bool)
    gap = _gap(np.minimum(behind, 5))
    for axis in (0, 1):
        far = np.abs(np.diff(np.minimum(behind, 50), axis=axis)) > (gap[1:] if axis == 0 else gap[:, 1:])
        jump |= np.insert(far, 0, False, axis)
    _, labels, stats, _ = cv2.connectedComponentsWithStats((never & ~jump).astype(np.uint8), connectivity=4)
    at_rim = np.bincount(_rim_of(labels), minlength=len(stats)) > 0.15 * len(_rim_of(labels))  # an arm has less
    found = np.zeros(never.shape, bool)
    for k in range(1, len(stats)):
        x, y, w, h, area = stats[k]
        if at_rim[k] or area > 0.25 * never.size or area < 20:
            continue
        box = (slice(max(y - h, 0), y + 2 * h), slice(max(x - w, 0), x + 2 * w))
        own = labels[box] == k
        around = (never | others)[box] & ~(cv2.dilate(own.astype(np.uint8), np.ones((5, 5))) > 0)
        if not around.any():
            found[box] |= own
            continue
        place = ndimage.distance_transform_edt(~around, return_distances=False, return_indices=True)
        if np.median((np.minimum(behind[box], 50)[tuple(place)] - behind[box])[own] - 2 * gap[box][own]) > 0:
            found[box] |= own
    return cv2.dilate(found.astype(np.uint8), np.ones((5, 5))) > 0


def _moving_background(video: _Video, still: Bools, motions: list[NDArray[np.float64]]) -> Values:
    """(n, h, w) depth of the static scene in every frame: that of still pixels of other frames, seen from this one."""
    n, h, w = video.depth.shape
    rows, columns = h // 2, w // 2
    K = np.diag([columns / w, rows / h, 1.0]) @ video.K
    v, u = np.indices((rows, columns))
    rays = np.stack([(u + 0.5 - K[0, 2]) / K[0, 0], (v + 0.5 - K[1, 2]) / K[1, 1], np.ones((rows, columns))], -1)
    points = []
    for i in range(n):
        z = video.depth[i, : 2 * rows : 2, : 2 * columns : 2]
        calm = still[i, : 2 * rows : 2, : 2 * columns : 2] & (z > 0)
        points.append((rays * z[..., None])[calm])
    T_world = [np.eye(4)]
    for T in motions:
        T_world.append(T_world[-1] @ np.linalg.inv(T))
    result = np.full((n, h, w), np.inf, np.float32)
    for i in range(n):
        layers = []
        for k in (-28, -21, -15, -10, -6, -3, 0, 3, 6, 10, 15, 21, 28):
            if not 0 <= i + k < n:
                continue
            T = np.linalg.inv(T_world[i]) @ T_world[i + k]
            p = points[i + k] @ T[:3, :3].T + T[:3, 3]
            p = p[p[:, 2] > 0.05]
            at = (p[:, :2] / p[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2]).astype(int)
            inside = (at >= 0).all(1) & (at[:, 0] < columns) & (at[:, 1] < rows)
            order = np.argsort(-p[inside, 2])
            layer = np.full((rows, columns), np.nan)
            layer[at[inside][order, 1], at[inside][order, 0]] = p[inside][order, 2]
            layers.append(layer)
        seen = np.sort(np.where(np.isfinite(layers), layers, np.inf), axis=0)
        times = np.isfinite(seen).sum(0)
        at_time = np.clip((0.7 * (times - 1)).round().astype(int), 0, None)
        behind = np.take_along_axis(seen, at_time[None], 0)[0]
        if (times > 0).any():
            nearest = ndimage.distance_transform_edt(times == 0, return_distances=False, return_indices=True)
            behind = behind[tuple(nearest)]
        result[i] = cv2.resize(behind.astype(np.float32), (w, h), interpolation=cv2.INTER_NEAREST)
    return result


def _lab(rgb: Image) -> Values:
    """CIELAB, lightness 0 to 100."""
    return cv2.cvtColor(rgb.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)


def _background_colour(video: _Video, still: Bools, behind: Values) -> Values:
    """(h, w, 3) CIELAB of the static scene; NaN where it is never seen."""
    chosen = np.unique(np.linspace(0, len(video.depth) - 1, 24).astype(int))
    z = video.depth[chosen]
    back = still[chosen] & ((z == 0) | (behind[chosen] - z < _gap(np.minimum(z, 5))))
    colours = np.stack([_lab(video.rgb[i]) for i in chosen])
    colours[~back] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # pixels without any
        return np.nanmedian(colours, axis=0).astype(np.float32)


def _fill(p: Values, known: Bools, rgb: Image, radius: int = 3) -> Values:
    """`p` (h, w) where it is known, smoothed along the edges of the picture (guided filter of He et al. 2010)."""
    size = (2 * radius + 1, 2 * radius + 1)
    guide = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    weight = known.astype(np.float32) + 1e-3

    def mean(x: Values) -> Values:
        return cv2.blur(x, size, borderType=cv2.BORDER_REFLECT)

    total = mean(weight)
    g, q = mean(weight * guide) / total, mean(weight * p) / total
    slope = (mean(weight * guide * p) / total - g * q) / (mean(weight * guide**2) / total - g * g + 1e-3)
    offset = q - slope * g
    return np.clip(mean(slope) * guide + mean(offset), 0, 1)


def _nearest_layer(video: _Video, front: Values) -> Values:
    """`front` of the nearest layer alone: a person who moves behind the object is another one.

    Layers are parted by gaps in the depths of what is in front, of five frames.
    """
    result = front.copy()
    n = len(front)
    for i in range(n):
        around = [k for k in range(i - 2, i + 3) if 0 <= k < n]
        z = np.concatenate([video.depth[k][(front[k] > 0.5) & (video.depth[k] > 0)] for k in around])
        if len(z) < 200:
            continue
        cut = _split(z)
        if cut is not None:
            result[i][video.depth[i] >= cut] = 0
    return result


def _split(z: Values) -> float | None:
    """Depth, metres, in the first gap of 6 cm behind a twentieth of the depths `z`; None where there is none."""
    counts = np.bincount((z * 100).astype(int))
    behind = np.cumsum(counts) > 0.05 * len(z)
    thin = behind & (counts < max(2, 0.001 * len(z)))
    run = 0
    for k in range(len(thin)):
        run = run + 1 if thin[k] else 0
        if run == 6:
            return (k - 2.5) / 100
    return None


def _skin(rgb: Image) -> Bools:
    """Pixels with the chroma of skin."""
    ycc = cv2.cvtColor(rgb, cv2.COLOR_RGB2YCrCb).astype(int)
    cr, cb = ycc[..., 1], ycc[..., 2]
    inside = (cr >= _SKIN_CR[0]) & (cr <= _SKIN_CR[1]) & (cb >= _SKIN_CB[0]) & (cb <= _SKIN_CB[1])
    lab = _lab(rgb)
    hue = np.degrees(np.arctan2(lab[..., 2], lab[..., 1]))
    return np.asarray(inside & (ycc[..., 0] > 25) & (hue > _SKIN_HUE[0]) & (hue < _SKIN_HUE[1]))


def _bins(rgb: Image) -> NDArray[np.intp]:
    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB).astype(int)
    a, b, c = _COLOUR_BINS
    return (lab[..., 0] * a // 256 * b + lab[..., 1] * b // 256) * c + lab[..., 2] * c // 256


def _histogram(bins: NDArray[np.intp], weights: Values) -> Values:
    counts = np.bincount(bins, weights, int(np.prod(_COLOUR_BINS))).reshape(_COLOUR_BINS)
    smooth = ndimage.gaussian_filter(counts, 0.7)
    return (smooth / max(smooth.sum(), 1e-9)).ravel().astype(np.float32)


def _rim_of(image: NDArray[Any]) -> NDArray[Any]:
    """The pixels of the rim, in no order that matters; those of corners twice."""
    return np.concatenate([side.ravel() for side in (image[:_RIM], image[-_RIM:], image[:, :_RIM], image[:, -_RIM:])])


def _touches_rim(labels: NDArray[Any]) -> NDArray[np.intp]:
    """The labels, other than 0, of what touches the rim."""
    return np.setdiff1d(np.unique(_rim_of(labels)), [0])


def _draw_hands(video: _Video, network: HandNetwork, progress: Progress) -> Bools:
    """(n, h, w) the pixels that hands cover, seen or hidden; none in frames without one."""
    drawn = np.zeros(video.depth.shape, bool)
    for i, picture in enumerate(video.rgb):
        for hand in network.find(picture):
            drawn[i] |= draw_hand(hand, picture.shape)
        progress("hands", i + 1, len(drawn))
    return drawn


def _near(hands: Bools) -> Bools:
    """The pixels of hands and those around them, as far as half the side of a square of their size."""
    reach = max(1, round(0.5 * float(np.sqrt(hands.sum()))))
    return np.asarray(ndimage.distance_transform_edt(~hands) <= reach)


def _hand(video: _Video, front: Values, palms: Bools | None, seeds: NDArray[np.int8], notes: list[str]) -> Values:
    """(n, h, w) probability that a pixel in front is of a hand or an arm, given that it is in front.

    Its first samples are the hands that were found (`palms`), or else the colours of skin.
    """
    n = len(front)
    arm, thing = np.zeros(front.shape, np.float32), np.zeros(front.shape, np.float32)
    found = np.zeros(n, bool) if palms is None else palms.any((1, 2))
    by_shape = found.mean() >= _LEAST_FOUND
    may = np.ones(front.shape, bool)  # be of a hand or an arm
    for i in np.flatnonzero(found) if by_shape else range(n):
        solid = front[i] > 0.5
        own = solid & _skin(video.rgb[i])
        if palms is not None and by_shape:
            may[i] = _near(palms[i])
            own &= may[i]
        skin = cv2.morphologyEx(own.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))) > 0
        rest = cv2.morphologyEx((solid & ~skin).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3)))
        _, labels = cv2.connectedComponents(rest)
        rim = np.isin(labels, _touches_rim(labels)) & (labels > 0)
        arm[i] = skin | rim
        may[i] |= rim
        thing[i] = (rest > 0) & ~rim
    if thing.sum() < 0.1 * arm.sum() and not (seeds > 0).any():
        notes.append("the object has the colour of skin, or leaves the picture: hand and object hardly differ")
        return np.zeros(front.shape, np.float32)
    bins = [_bins(picture) for picture in video.rgb]
    given = _colours_of(bins, seeds)
    for i in range(n):
        arm[i], thing[i] = _obey(arm[i], thing[i], given[bins[i]], seeds[i])
    for _ in range(2):
        flat = np.concatenate([b.ravel() for b in bins])
        h_arm, h_thing = _histogram(flat, arm.ravel()), _histogram(flat, thing.ravel())
        hand = np.zeros(front.shape, np.float32)
        for i in range(n):
            a, t = h_arm[bins[i]], h_thing[bins[i]]
            solid = front[i] > 0.5
            hand[i] = _fill(may[i] * (a + 1e-7) / (a + t + 2e-7), solid, video.rgb[i], 2)
            parted = (solid & (hand[i] > 0.5)).astype(np.float32), (solid & (hand[i] <= 0.5)).astype(np.float32)
            arm[i], thing[i] = _obey(*parted, given[bins[i]], seeds[i])
    return hand


def _colours_of(bins: list[NDArray[np.intp]], seeds: NDArray[np.int8]) -> NDArray[np.int8]:
    """Colour bin to 1 where clicks say object, -1 where they say other things, 0 where nothing or both."""
    flat, marks = np.concatenate([b.ravel() for b in bins]), seeds.ravel()
    given = np.zeros(int(np.prod(_COLOUR_BINS)), np.int8)
    for sign in (1, -1):
        if (marks == sign).any():
            share = _histogram(flat, (marks == sign).astype(np.float32))
            given += (sign * (share > 0.05 * share.max())).astype(np.int8)
    return given


def _obey(arm: Values, thing: Values, given: NDArray[np.int8], seeds: NDArray[np.int8]) -> tuple[Values, Values]:
    """Samples of arm and object, in which pixels go to the side that clicks give them or their colours."""
    own = np.where(seeds != 0, seeds, np.where(arm + thing > 0, given, 0))
    return np.where(own > 0, 0, np.where(own < 0, 1, arm)), np.where(own < 0, 0, np.where(own > 0, 1, thing))


def _warp(image: Values, flow: Values) -> Values:
    """`image` (h, w) of the frame to which `flow` (h, w, 2) leads, in the pixels of the frame where it starts."""
    h, w = image.shape[:2]
    row, column = np.indices((h, w), np.float32)
    flow = flow.astype(np.float32)
    return cv2.remap(
        image, column + flow[..., 0], row + flow[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )


def _carry(video: _Video, p: Values, seeds: NDArray[np.int8]) -> Values:
    """`p` (n, h, w) averaged with what neighbours in time have where flow leads and depths agree."""
    n = len(p)
    for _ in range(3):
        before = np.where(seeds > 0, 1, np.where(seeds < 0, 0, p)).astype(np.float32)
        p = before.copy()
        for i in range(n):
            total, weight = before[i].copy(), np.ones(p.shape[1:], np.float32)
            for k, flow in ((i + 1, video.forward[i]), (i - 1, video.backward[i])):
                if 0 <= k < n:
                    z, own = _warp(video.depth[k], flow), video.depth[i]
                    agree = np.where((z > 0) & (own > 0), np.abs(z - own) < 2 * _gap(own), True)
                    w = 0.5 * agree.astype(np.float32)
                    total += w * _warp(before[k], flow)
                    weight += w
            p[i] = total / weight
    return np.where(seeds > 0, 1, np.where(seeds < 0, 0, p)).astype(np.float32)


def _carry_clicks(video: _Video, clicks: Sequence[Click], recording: Recording) -> NDArray[np.int8]:
    """(n, h, w) 1 where clicks say object, -1 where they say it is not, 0 elsewhere.

    The surface around a click: depth within the noise, colours within 8 of 255 of CIELAB, or a disc of 1 % of the
    picture's width. It is followed until a third is left; of two clicks the nearer in time is believed.
    """
    n, h, w = video.depth.shape
    seeds, age = np.zeros((n, h, w), np.int8), np.full((n, h, w), n, np.int32)
    scale = np.array([w / recording.camera.width, h / recording.camera.height])
    for click in clicks:
        u, v = (np.array([click.column, click.row]) * scale).astype(int)
        if not (0 <= click.frame < n and 0 <= u < w and 0 <= v < h):
            raise FreeArtError(
                f"a click is at frame {click.frame}, pixel {click.column:g}, {click.row:g}: not in the video"
            )
        lab = cv2.cvtColor(video.rgb[click.frame], cv2.COLOR_RGB2LAB)
        flooded = np.zeros((h + 2, w + 2), np.uint8)
        z = video.depth[click.frame]
        if z[v, u] > 0:
            flooded[1:-1, 1:-1] = (z > 0) & (np.abs(z - z[v, u]) > 4 * _gap(z))
        flags = 4 | (2 << 8) | cv2.FLOODFILL_MASK_ONLY | cv2.FLOODFILL_FIXED_RANGE
        cv2.floodFill(lab, flooded, (int(u), int(v)), (0, 0, 0), (8, 8, 8), (8, 8, 8), flags)
        region = (flooded[1:-1, 1:-1] == 2).astype(np.uint8)
        cv2.circle(region, (int(u), int(v)), max(2, round(0.01 * w)), 1, -1)
        for direction, flow in ((1, video.backward), (-1, video.forward)):
            at, now = click.frame, region.astype(np.float32)
            while 0 <= at < n and now.sum() > 0.33 * region.sum():
                newer = (now > 0.5) & (np.abs(at - click.frame) <= age[at])
                seeds[at][newer], age[at][newer] = (1 if click.on_object else -1), abs(at - click.frame)
                if not 0 <= at + direction < n:
                    break
                there, own = _warp(video.depth[at], flow[at + direction]), video.depth[at + direction]
                agree = (there == 0) | (own == 0) | (np.abs(there - own) < 2 * _gap(own))
                now, at = _warp(now, flow[at + direction]) * agree, at + direction
    return seeds


def _choose(video: _Video, p: Values, front: Values, seeds: NDArray[np.int8]) -> tuple[Bools, Values, tuple[str, ...]]:
    """Masks, doubts and their reasons: of the pieces of each frame those that hang together in time, without specks."""
    n = len(p)
    masks = np.zeros(p.shape, bool)
    for i in range(n):
        solid = cv2.morphologyEx((p[i] > 0.5).astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2)))
        count, labels, stats, _ = cv2.connectedComponentsWithStats(solid)
        if count < 2:
            continue
        area = stats[1:, cv2.CC_STAT_AREA].astype(float)
        rim = np.isin(np.arange(1, count), _touches_rim(labels))
        value = np.where(rim, 0.3, 1.0) * area
        keep = np.flatnonzero((value > 0.05 * value.max()) & (~rim | (value == value.max()))) + 1
        clicked = np.setdiff1d(np.unique(labels[seeds[i] > 0]), [0])
        masks[i] = np.isin(labels, [*keep, *clicked])
    area = masks.sum((1, 2)).astype(np.float32)
    doubt, reasons = np.zeros(n, np.float32), []
    typical = float(np.median(area[area > 0])) if (area > 0).any() else 1.0
    for i in range(n):
        causes = {"": 0.0}
        if area[i] == 0:
            causes["no object is found"] = 1.0
        else:
            unsure = float(((p[i] > 0.35) & (p[i] < 0.65) & (front[i] > 0.35)).sum()) / area[i]
            causes["hand and object hardly differ"] = min(1.0, unsure / 0.5)
            others = []
            for k, flow in ((i + 1, video.forward[i]), (i - 1, video.backward[i])):
                if 0 <= k < n and area[k]:
                    other = _warp(masks[k].astype(np.float32), flow) > 0.5
                    differs = (masks[i] & ~_grow(other)).sum() + (other & ~_grow(masks[i])).sum()
                    others.append(float(differs / area[i]))
            if others:
                causes["it differs from its neighbours in time"] = min(1.0, max(others) / 0.3)
            causes["its area differs from the others"] = float(min(1, abs(np.log(area[i] / typical)) / np.log(6)))
            edge = np.concatenate([masks[i][0], masks[i][-1], masks[i][:, 0], masks[i][:, -1]])
            causes["it leaves the picture"] = 0.6 if edge.sum() > 3 else 0.0
        worst = max(causes, key=lambda name: causes[name])
        doubt[i] = causes[worst]
        reasons.append(worst)
    return masks, doubt, tuple(reasons)


def _grow(mask: Bools) -> Bools:
    """`mask` with two more pixels all around."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((5, 5))) > 0


def _enlarge(masks: Bools, p: Values, recording: Recording) -> Bools:
    """Masks in the recording's own pixels."""
    size = (recording.camera.width, recording.camera.height)
    if masks.shape[2:0:-1] == size:
        return masks
    result = np.zeros((len(masks), size[1], size[0]), bool)
    for i, mask in enumerate(masks):
        grown = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3)))
        soft = cv2.resize(np.where(grown > 0, p[i], 0).astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        result[i] = soft > 0.5
    return result
