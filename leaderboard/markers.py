"""The joint of a real object from printed tags on both of its parts: a reference that is independent of every solver.

ArUco tags of known size (`cv2.aruco`, 4x4_50) are stuck on the base and on the moving part, the object is filmed, and
one bundle adjustment explains the corners of the tags: the base's pose and the joint's state in every frame, the places
of the tags, and the joint itself. Residuals are pixels; depth and masks are not used. The same adjustment with two free
parts gives the error that the corners have by themselves; a joint that leaves much more is no joint.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.joint_json import joint_to_json
from freeart21.joint import JOINT_TYPES, Joint, JointType
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.truth import Truth

SCHEMA = "freeart21/joint-by-markers/1"
TAGS = 50
"""Of the dictionary: ids 0 to 24 are printed for the base, 25 to 49 for the moving part."""
MODULES = 6
"""Squares along the side of a tag, with its black rim."""
EDGE_PIXELS = 2.5
"""To either side of an edge that its place is looked for: a corner of OpenCV is up to 1.8 pixels off."""
DPI = 600
A4 = (4960, 7016)
"""Pixels at DPI."""
MAX_ITERATIONS = 25
LEAST_GAIN = 1e-3
"""Of the log-likelihood: an iteration that gains less ends the adjustment; half a unit is one standard deviation."""
MOST_RATIO = 2.0
"""Median pixel error under the joint over that of free parts: beyond it the parts do not move as one joint says. In
simulated recordings it is 1.0 to 1.1."""


@dataclass(frozen=True)
class Corners:
    """The m tags that were found in a video."""

    frames: NDArray[np.int64]
    """(m,)"""
    ids: NDArray[np.int64]
    """(m,)"""
    pixels: Array
    """(m, 4, 2) corners clockwise from the tag's upper left; the first pixel's centre is (0.5, 0.5)."""

    def chosen(self, flags: NDArray[np.bool_]) -> Corners:
        """Those of `flags` (m,)."""
        return Corners(self.frames[flags], self.ids[flags], self.pixels[flags])


@dataclass(frozen=True)
class MarkerJoint:
    """What the tags say. The base's frame is that of its most seen tag: x right, y up on the print, z out of it."""

    joint: Joint
    """In the base's frame; its pivot is the point of the axis nearest to the moving part's tags."""
    frames: NDArray[np.int64]
    """(n,) in which both parts show a tag."""
    states: Array
    """(n,) rad or m; zero in the frame with most corners."""
    Ts_camera_base: Array
    """(n, 4, 4)"""
    axis_std: float
    """rad: rms of two tilts. All deviations take the corners' errors as independent."""
    pivot_std: float | None
    """Metres across the axis; None for a prismatic joint."""
    state_std: Array
    """(n,) rad or m."""
    pixel_error: float
    """Median distance of a corner from where the joint puts it."""
    free_pixel_error: float
    """The same where both parts move freely."""
    other_pixel_error: float
    """The same under the other joint type."""

    @property
    def explains(self) -> bool:
        """Whether one joint explains the corners nearly as well as two free parts."""
        return self.pixel_error <= MOST_RATIO * self.free_pixel_error


@dataclass(frozen=True)
class Difference:
    """A result against the tags."""

    same_type: bool
    axis_deg: float
    """Angle between the two axis lines."""
    pivot_m: float | None
    """Distance of the result's axis from the tags' pivot; None unless both are revolute."""
    state: float | None
    """Mean absolute difference, rad or m, after one offset and the sign of the axis; None unless the types agree."""


def print_tags(path: Path, side_m: float) -> int:
    """Write a PDF of A4 pages with all tags, labelled; gives the number of pages.

    Each page has a 100 mm line: measure it, printers scale. FreeArtError when the tags do not fit on a page.
    """
    from PIL import Image, ImageDraw, ImageFont

    module = round(side_m / 0.0254 * DPI / MODULES)
    side, gap = module * MODULES, max(2 * module, DPI // 5)
    columns, rows = (A4[0] - DPI) // (side + gap), (A4[1] - 2 * DPI) // (side + gap)
    if module < 1 or columns < 1 or rows < 1:
        raise FreeArtError(f"a tag of {1000 * side_m:g} mm does not fit an A4 page; expected 1 to 150 mm")
    font = ImageFont.load_default(size=DPI // 12)
    pages, dictionary = [], _dictionary()
    for first in range(0, TAGS, columns * rows):
        page = Image.new("1", A4, 1)
        draw = ImageDraw.Draw(page)
        shown = f"freeart21 tags 4x4_50, side {1000 * side / DPI * 0.0254:.2f} mm: print at 100 %. This line is 100 mm:"
        draw.text((DPI // 2, DPI // 3), shown, fill=0, font=font)
        draw.rectangle((DPI // 2, DPI * 9 // 16, DPI // 2 + round(100 / 25.4 * DPI), DPI * 9 // 16 + 8), fill=0)
        for place, tag in enumerate(range(first, min(first + columns * rows, TAGS))):
            x = DPI // 2 + place % columns * (side + gap)
            y = DPI + place // columns * (side + gap)
            picture = Image.fromarray(cv2.aruco.generateImageMarker(dictionary, tag, MODULES))
            page.paste(picture.resize((side, side), Image.Resampling.NEAREST), (x, y))
            draw.text((x, y + side + 4), f"{tag} {'base' if tag < TAGS // 2 else 'moving'}", fill=0, font=font)
        pages.append(page)
    file = io.BytesIO()
    pages[0].save(file, "PDF", save_all=True, append_images=pages[1:], resolution=DPI)
    atomic.write_bytes(path, file.getvalue())
    return len(pages)


def _dictionary() -> Any:
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)


def find_corners(recording: Recording, report: Callable[[int, int], None] = lambda done, total: None) -> Corners:
    """The tags in every frame of a recording."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(_dictionary(), parameters)
    frames, ids, pixels = [], [], []
    for i in range(len(recording)):
        report(i, len(recording))
        grey = cv2.cvtColor(recording.load(i).rgb, cv2.COLOR_RGB2GRAY)
        found, names, _ = detector.detectMarkers(grey)
        for corners, tag in zip(found, () if names is None else np.ravel(names), strict=True):
            frames.append(i)
            ids.append(int(tag))
            pixels.append(_cross_edges(grey, np.asarray(corners, float).reshape(4, 2) + 0.5))
    return Corners(np.array(frames, int), np.array(ids, int), np.array(pixels).reshape(-1, 4, 2))


def _cross_edges(grey: NDArray[Any], corners: Array) -> Array:
    """Corners (4, 2) as the crossings of the four edges, each a line through the steepest places across it.

    OpenCV's own corners lie inside: of a simulated tag of 40 pixels by .26 (SUBPIX) to .8 (CONTOUR), so that it stands
    1 to 3 % too far away; these by .05, and their median error is .13 pixels where SUBPIX has .42.
    """
    x, y = corners.T
    area = abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
    middles, directions = [], []
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        length = float(np.linalg.norm(b - a))
        along = (b - a) / length
        reach = min(EDGE_PIXELS, 0.45 * area / length / MODULES)  # short of the next module
        across = np.linspace(-reach, reach, 21)
        starts = a + np.linspace(0.12, 0.88, 25)[:, None] * (b - a)
        normal = np.array([along[1], -along[0]])
        at = (starts[:, None] + across[:, None] * normal - 0.5).astype(np.float32)
        slope = np.abs(np.diff(cv2.remap(grey.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR), axis=1))
        offset = (slope * (across[1:] + across[:-1]) / 2).sum(1) / np.maximum(slope.sum(1), 1e-6)
        away = np.abs(offset - np.median(offset))
        points = (starts + offset[:, None] * normal)[away <= 3 * 1.4826 * np.median(away) + 0.05]
        middles.append(points.mean(0))
        directions.append(np.linalg.svd(points - points.mean(0))[2][0])
    crossings = []
    for k in range(4):
        pair = np.stack([directions[k - 1], -directions[k]], 1)
        if abs(np.linalg.det(pair)) < 0.05:  # a tag seen from its edge
            return corners
        crossings.append(middles[k - 1] + np.linalg.solve(pair, middles[k] - middles[k - 1])[0] * directions[k - 1])
    return np.array(crossings)


def measure_joint(
    corners: Corners, camera: Camera, side_m: float, base: Sequence[int], moving: Sequence[int]
) -> MarkerJoint:
    """The joint between the part with the tags `base` and the one with the tags `moving`.

    FreeArtError when fewer than three frames show both parts, or when the joint did not move.
    """
    if both := set(base) & set(moving):
        raise FreeArtError(f"tag {min(both)} is named as the base's and as the moving part's")
    corners = corners.chosen(np.isin(corners.ids, [*base, *moving]))
    start = _begin(corners, camera, side_m, base, moving)
    free = _adjust(start, camera)
    fits = {kind: _adjust(_with_joint(free, kind), camera) for kind in JOINT_TYPES}
    cost = {kind: _cost(fit, camera, free) for kind, fit in fits.items()}
    kind: JointType = "revolute" if cost["revolute"] < cost["prismatic"] else "prismatic"
    other = next(name for name in JOINT_TYPES if name != kind)
    fit = _with_near_pivot(fits[kind])
    assert fit.joint is not None
    axis_std, pivot_std, state_std = _deviations(fit, camera)
    if np.ptp(fit.states) < 5 * np.median(state_std):
        unit = fit.joint.state_unit
        raise FreeArtError(f"the joint moved by {np.ptp(fit.states):.2g} {unit}: too little to tell its axis")
    error = {name: _median_error(its, camera) for name, its in (*fits.items(), ("free", free))}
    return MarkerJoint(
        fit.joint.spanning(fit.states),
        np.unique(fit.corners.frames),
        fit.states,
        fit.Ts_camera_base,
        axis_std,
        pivot_std if kind == "revolute" else None,
        state_std,
        error[kind],
        error["free"],
        error[other],
    )


def compare(found: MarkerJoint, result: Reconstruction | Truth) -> Difference:
    """How far a result of the same video is from what the tags say.

    The result's part that stands still against the base is taken for it, whichever the result calls the reference; the
    base's frame is placed in the result's canonical one by the mean over all frames.
    """
    at = found.frames[found.frames < len(result.states)]
    if not len(at):
        raise FreeArtError(f"the result has {len(result.states)} frames, and none of them shows tags of both parts")
    base = found.Ts_camera_base[: len(at)]
    centre, lever = found.joint.pivot, np.linalg.norm(found.joint.pivot)  # of the joint from the base's tag

    def place(Ts_camera_part: Array) -> tuple[float, Array]:
        steps = se3.inverse(Ts_camera_part[at]) @ base
        mean = se3.mean_pose(steps)
        points = se3.transform(steps, centre[None])[:, 0] - se3.transform(mean, centre)
        turns = se3.rotation_angle(steps[:, :3, :3] @ mean[:3, :3].T)
        return float(np.median(np.linalg.norm(points, axis=1) + lever * turns)), mean

    T = min((place(result.Ts_camera_reference), place(result.Ts_camera_moving)), key=lambda its: its[0])[1]
    measured, joint = found.joint.moved(T), result.articulation.joint
    same = joint.type == measured.type
    gap = measured.pivot - joint.pivot
    # the sign of the states depends on the axis and on which part is the reference: the better one counts
    offsets = [found.states[: len(at)] - sign * result.states[at] for sign in (1, -1)]
    state = min(float(np.mean(np.abs(offset - np.median(offset)))) for offset in offsets)
    return Difference(
        same,
        float(np.degrees(np.arcsin(np.minimum(np.linalg.norm(np.cross(measured.axis, joint.axis)), 1.0)))),
        float(np.linalg.norm(gap - gap @ joint.axis * joint.axis)) if same and joint.type == "revolute" else None,
        state if same else None,
    )


def write_marker_joint(path: Path, found: MarkerJoint, side_m: float, difference: Difference | None) -> None:
    """Write all as JSON."""
    body = {
        "schema": SCHEMA,
        "joint": joint_to_json(found.joint),
        "side_m": side_m,
        "state_unit": found.joint.state_unit,
        "frames": found.frames,
        "states": found.states,
        "T_camera_base": found.Ts_camera_base,
        "deviations": {"axis_rad": found.axis_std, "pivot_m": found.pivot_std, "state": found.state_std},
        "pixel_error": {
            "joint": found.pixel_error,
            "free parts": found.free_pixel_error,
            "other type": found.other_pixel_error,
        },
        "one_joint_explains": found.explains,
    }
    atomic.write_json(path, body | ({"result": vars(difference)} if difference else {}))


# --- the bundle adjustment --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Bundle:
    """All unknowns. Frames are numbered 0 to n - 1 and tags 0 to k - 1, base first."""

    corners: Corners
    frame: NDArray[np.int64]
    """(m,) number of the frame."""
    tag: NDArray[np.int64]
    """(m,) number of the tag."""
    n_base: int
    """Tags of the base."""
    square: Array
    """(4, 3) metres: the corners in a tag's frame."""
    Ts_camera_base: Array
    """(n, 4, 4)"""
    Ts_base_moving: Array
    """(n, 4, 4) without a joint."""
    tags: Array
    """(k, 4, 4) of the base or the moving part from the tag; the first of each part is the part's frame."""
    joint: Joint | None
    states: Array
    """(n,) with a joint; 0 in frame `zero`."""
    zero: int


def _begin(corners: Corners, camera: Camera, side_m: float, base: Sequence[int], moving: Sequence[int]) -> _Bundle:
    """First guesses from each tag alone; of the two poses of a plane that of the smaller error."""
    shows = [np.isin(corners.ids, names) for names in (base, moving)]
    both = np.intersect1d(corners.frames[shows[0]], corners.frames[shows[1]])
    if len(both) < 3:
        found = [", ".join(map(str, np.unique(corners.ids[flags]))) or "none" for flags in shows]
        raise FreeArtError(
            f"{len(both)} frames show a tag of both parts, expected at least 3; tags of the base: {found[0]}, of the "
            f"moving part: {found[1]}"
        )
    corners = corners.chosen(np.isin(corners.frames, both))
    half = side_m / 2
    square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    alone = np.array([_pose_of_square(pixels, square, camera) for pixels in corners.pixels])
    frame = np.searchsorted(both, corners.frames)
    of_part, places = [], []
    for names in (base, moving):
        its = np.isin(corners.ids, names)
        order, tags = _place_tags(corners.ids[its], frame[its], alone[its])
        number = {int(name): k for k, name in enumerate(order)}
        local = np.array([number.get(int(name), -1) for name in corners.ids])
        used = its & (local >= 0)
        part = alone[used] @ se3.inverse(tags[local[used]])
        of_part.append({i: se3.mean_pose(part[frame[used] == i]) for i in np.unique(frame[used])})
        places.append((order, tags))
    order = [*places[0][0], *places[1][0]]
    known = [i for i in range(len(both)) if i in of_part[0] and i in of_part[1]]
    keep = np.isin(frame, known) & np.isin(corners.ids, order)
    corners, frame = corners.chosen(keep), np.searchsorted(known, frame[keep])
    if len(known) < 3:
        raise FreeArtError(f"{len(known)} frames show tags of both parts that were seen together, expected at least 3")
    Ts = [np.array([its[i] for i in known]) for its in of_part]
    number = {int(name): k for k, name in enumerate(order)}
    tag = np.array([number[int(name)] for name in corners.ids])
    zero = int(np.argmax(np.bincount(frame)))
    tags = np.concatenate([places[0][1], places[1][1]])
    Ts_base_moving = se3.inverse(Ts[0]) @ Ts[1]
    nothing = np.zeros(len(known))
    return _Bundle(corners, frame, tag, len(places[0][0]), square, Ts[0], Ts_base_moving, tags, None, nothing, zero)


def _pose_of_square(pixels: Array, square: Array, camera: Camera) -> Array:
    """T_camera_tag (4, 4) by the infinitesimal plane-based method (Collins and Bartoli 2014)."""
    _, turn, shift = cv2.solvePnP(square, pixels, camera.K, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)[:3]
    return se3.pose(cv2.Rodrigues(turn)[0], shift[:, 0])


def _place_tags(ids: NDArray[np.int64], frame: NDArray[np.int64], alone: Array) -> tuple[list[int], Array]:
    """Ids (k,) of a part's tags and their poses (k, 4, 4) in the frame of the most seen one.

    Each is placed by the tag with which it was seen most often; one that never shares a frame with them is left out.
    """
    names, counts = np.unique(ids, return_counts=True)
    placed = {int(names[np.argmax(counts)]): np.eye(4)}
    at = {int(name): dict(zip(frame[ids == name], alone[ids == name], strict=True)) for name in names}
    while True:
        pairs = [(len(at[a].keys() & at[b].keys()), a, b) for a in placed for b in at if b not in placed]
        shared, a, b = max(pairs, default=(0, 0, 0))
        if not shared:
            return list(placed), np.array(list(placed.values()))
        frames = sorted(at[a].keys() & at[b].keys())
        steps = se3.inverse(np.array([at[a][i] for i in frames])) @ np.array([at[b][i] for i in frames])
        placed[b] = placed[a] @ se3.mean_pose(steps)


def _with_joint(free: _Bundle, kind: str) -> _Bundle:
    """The bundle with a joint of this type: the screw between the two frames that are farthest apart."""
    centre = free.tags[free.n_base :, :3, 3].mean(0)
    Ts = free.Ts_base_moving @ se3.inverse(free.Ts_base_moving[free.zero])
    at = se3.transform(free.Ts_base_moving, centre[None])[:, 0]
    if kind == "prismatic":
        axis = np.linalg.svd(at - at.mean(0))[2][0]
        states = (at - at[free.zero]) @ axis
        joint = Joint("joint", "prismatic", axis, at.mean(0), -np.inf, np.inf)
    else:
        turns = se3.log_so3(Ts[:, :3, :3])
        axis = turns[np.argmax(np.linalg.norm(turns, axis=1))]
        axis = axis / max(float(np.linalg.norm(axis)), 1e-12) if np.any(axis) else np.array([0.0, 0.0, 1.0])
        states = np.unwrap(turns @ axis)
        about = (np.eye(3) - Ts[:, :3, :3]).reshape(-1, 3)  # t = (I - R) pivot; along the axis the pivot is free
        pivot = np.linalg.lstsq(np.append(about, axis[None], 0), np.append(Ts[:, :3, 3].ravel(), 0.0), rcond=1e-9)[0]
        joint = Joint("joint", "revolute", axis, pivot, -np.inf, np.inf)
    moving = free.Ts_base_moving[free.zero] @ free.tags[free.n_base :]
    return replace(free, joint=joint, states=states, tags=np.concatenate([free.tags[: free.n_base], moving]))


def _with_near_pivot(bundle: _Bundle) -> _Bundle:
    """The bundle whose pivot is the point of the axis nearest to the middle of the moving part's tags."""
    assert bundle.joint is not None
    joint, centre = bundle.joint, bundle.tags[bundle.n_base :, :3, 3].mean(0)
    return replace(bundle, joint=replace(joint, pivot=joint.pivot + (centre - joint.pivot) @ joint.axis * joint.axis))


def _errors(bundle: _Bundle, camera: Camera) -> Array:
    """(m, 4, 2) pixels from where the unknowns put the corners."""
    points = se3.transform(bundle.tags[bundle.tag], np.broadcast_to(bundle.square, (len(bundle.tag), 4, 3)))
    Ts = bundle.Ts_base_moving if bundle.joint is None else bundle.joint.transform(bundle.states)
    Ts = np.where((bundle.tag < bundle.n_base)[:, None, None], np.eye(4), Ts[bundle.frame])
    at = se3.transform(bundle.Ts_camera_base[bundle.frame] @ Ts, points)
    at[..., 2] = np.maximum(at[..., 2], 1e-6)
    return camera.project(at) - bundle.corners.pixels


def _shift(bundle: _Bundle, local: Array, shared: Array) -> _Bundle:
    """The bundle moved by `local` (n, 7 or 12) and `shared` (s,)."""
    Ts_camera_base = se3.exp_se3(local[:, :6]) @ bundle.Ts_camera_base
    free = bundle.joint is None
    tags = bundle.tags.copy()
    loose = [k for k in range(len(tags)) if k and not (free and k == bundle.n_base)]
    tags[loose] = bundle.tags[loose] @ se3.exp_se3(shared[: 6 * len(loose)].reshape(-1, 6))
    if bundle.joint is None:
        moving = bundle.Ts_base_moving @ se3.exp_se3(local[:, 6:])
        return replace(bundle, Ts_camera_base=Ts_camera_base, tags=tags, Ts_base_moving=moving)
    joint, rest = bundle.joint, shared[6 * len(loose) :]
    across = np.linalg.svd(joint.axis[None])[2][1:]
    axis = joint.axis + rest[:2] @ across
    pivot = joint.pivot + (rest[2:] @ across if joint.type == "revolute" else 0)
    joint = replace(joint, axis=axis / np.linalg.norm(axis), pivot=pivot)
    states = bundle.states + local[:, 6]
    return replace(bundle, Ts_camera_base=Ts_camera_base, tags=tags, joint=joint, states=states)


def _sizes(bundle: _Bundle) -> tuple[int, int]:
    """Unknowns of a frame, and of all together."""
    if bundle.joint is None:
        return 12, 6 * (len(bundle.tags) - 2)
    return 7, 6 * (len(bundle.tags) - 1) + (4 if bundle.joint.type == "revolute" else 2)


def _normal_equations(bundle: _Bundle, camera: Camera, weights: Array) -> tuple[Array, Array, Array, Array, Array]:
    """H (n, l, l), H (n, l, s), H (s, s) and the gradients (n, l), (s,) by forward differences."""
    n, (own, s) = len(bundle.states), _sizes(bundle)
    step, at = 1e-7, _errors(bundle, camera)
    local, shared = np.zeros((n, own)), np.zeros(s)
    columns = []
    for j in range(own + s):
        moved, all_moved = local.copy(), shared.copy()
        if j < own:
            moved[:, j] = step
        else:
            all_moved[j - own] = step
        columns.append((_errors(_shift(bundle, moved, all_moved), camera) - at) / step)
    J = np.moveaxis(np.array(columns), 0, -1).reshape(len(at), 8, own + s)
    if bundle.joint is not None:
        J[bundle.frame == bundle.zero, :, 6] = 0  # its state is 0 by definition
    w = np.repeat(weights, 2, axis=1)  # (m, 8)
    of_tag = np.einsum("mi,mia,mib->mab", w, J, J, optimize=True)
    slope = np.einsum("mi,mia,mi->ma", w, J, at.reshape(len(at), 8))
    H_ll, H_ls, g_l = np.zeros((n, own, own)), np.zeros((n, own, s)), np.zeros((n, own))
    np.add.at(H_ll, bundle.frame, of_tag[:, :own, :own])
    np.add.at(H_ls, bundle.frame, of_tag[:, :own, own:])
    np.add.at(g_l, bundle.frame, slope[:, :own])
    if bundle.joint is not None:
        H_ll[bundle.zero, 6, 6] = 1
    return H_ll, H_ls, of_tag[:, own:, own:].sum(0), g_l, slope[:, own:].sum(0)


def _adjust(bundle: _Bundle, camera: Camera) -> _Bundle:
    """Levenberg-Marquardt with the frames eliminated; corners far beyond the median error weigh less (Cauchy)."""
    for _ in range(3):  # the scale of the loss from the fit before it
        scale = max(1.5 * _median_error(bundle, camera), 0.02)
        damping, cost = 1e-4, _robust_cost(bundle, camera, scale)
        for _ in range(MAX_ITERATIONS):
            weights = 1 / (1 + (np.linalg.norm(_errors(bundle, camera), axis=2) / scale) ** 2)
            H_ll, H_ls, H_ss, g_l, g_s = _normal_equations(bundle, camera, weights)
            while damping < 1e8:
                A = H_ll + damping * H_ll * np.eye(H_ll.shape[1]) + 1e-12 * np.eye(H_ll.shape[1])
                B = H_ss + damping * H_ss * np.eye(len(H_ss)) + 1e-12 * np.eye(len(H_ss))
                solved = np.linalg.solve(A, np.concatenate([H_ls, g_l[..., None]], 2))
                S = B - np.einsum("nla,nlb->ab", H_ls, solved[..., :-1])
                shared = -np.linalg.solve(S, g_s - np.einsum("nla,nl->a", H_ls, solved[..., -1]))
                local = -(solved[..., -1] + solved[..., :-1] @ shared)
                trial = _shift(bundle, local, shared)
                now = _robust_cost(trial, camera, scale)
                if now < cost:
                    break
                damping *= 10
            else:
                break
            gain, bundle, cost, damping = cost - now, trial, now, max(damping / 10, 1e-9)
            if gain < LEAST_GAIN:
                break
    return bundle


def _robust_cost(bundle: _Bundle, camera: Camera, scale: float) -> float:
    return float(np.log1p((np.linalg.norm(_errors(bundle, camera), axis=2) / scale) ** 2).sum())


def _median_error(bundle: _Bundle, camera: Camera) -> float:
    return float(np.median(np.linalg.norm(_errors(bundle, camera), axis=2)))


def _cost(bundle: _Bundle, camera: Camera, free: _Bundle) -> float:
    """Bayesian information criterion of a joint type, corners' errors Cauchy at the scale of the free parts."""
    scale = max(1.5 * _median_error(free, camera), 0.02)
    return 2 * _robust_cost(bundle, camera, scale) + _sizes(bundle)[1] * np.log(bundle.corners.pixels.size)


def _deviations(bundle: _Bundle, camera: Camera) -> tuple[float, float, Array]:
    """Standard deviations of the axis, rad, the pivot, m, and the states (n,)."""
    weights = np.ones(bundle.corners.pixels.shape[:2])
    H_ll, H_ls, H_ss, _, _ = _normal_equations(bundle, camera, weights)
    unknowns = H_ll.shape[0] * H_ll.shape[1] + len(H_ss)
    count = bundle.corners.pixels.size
    variance = (_median_error(bundle, camera) / 1.1774) ** 2 * count / max(count - unknowns, 1)  # of a coordinate
    inverse = np.linalg.pinv(H_ll, hermitian=True)
    S = H_ss - np.einsum("nla,nlm,nmb->ab", H_ls, inverse, H_ls, optimize=True)
    shared = variance * np.linalg.pinv(S, hermitian=True)
    row = np.einsum("nm,nms->ns", inverse[:, 6], H_ls)
    states = variance * inverse[:, 6, 6] + np.einsum("ns,st,nt->n", row, shared, row)
    states[bundle.zero] = np.median(states)
    first = len(H_ss) - (4 if bundle.joint is not None and bundle.joint.type == "revolute" else 2)
    spread = np.diag(shared)[first:]
    return (
        float(np.sqrt(spread[:2].mean())),
        float(np.sqrt(spread[2:].mean())) if len(spread) > 2 else 0.0,
        np.sqrt(states),
    )
