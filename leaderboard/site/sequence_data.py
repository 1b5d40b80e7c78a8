"""All that one sequence shows: pictures of its video, part masks, meshes and joints in 3D, joint states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.benchmark import Benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.joint import Joint, JointType
from freeart21.mesh import Mesh, bounding_diagonal, box_centre
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.truth import Truth
from freeart21.view.document import TRUTH
from freeart21.view.scene import Layer, Link, Scene, Slider, Surface, scene_data, slider_range
from freeart21.view.simplify import simplified
from freeart21.view.video import shown_frames
from leaderboard.rows import Row
from leaderboard.site.answers import EMPTY, Answer, align_states, read_answer
from leaderboard.site.entrant import Entrant
from leaderboard.site.packed import Packed

FRAMES = 72
"""Pictures of a video that are shown, evenly spread."""
MASK_SIDE = 128
"""Pixels of the longer side of part masks; outlines are smoothed between them."""
MASK_RUNS = 18 << 10
"""Of one source's masks, each a byte or two before DEFLATE: noisier ones are made smaller until they fit."""
FACES = 440
"""Triangles a part."""
PICTURE_SIDE = 640
ACROSS, DOWN = 4, 6
"""Pictures a sheet."""
VIDEO_BYTES = 640 << 10
"""All sheets of a sequence: the JPEG quality comes down until they fit."""
QUALITIES = (80, 70, 60, 45, 30)
THUMB = 176
"""Pixels of the width of the small picture."""
NOT_TOLD = "\N{EN DASH}"
_UNKNOWN_SIZE = 0.3  # metres: of an object without depth, as those of the catalog are


@dataclass(frozen=True)
class Shown:
    """One sequence, ready to be written."""

    name: str
    facts: dict[str, Any]
    """What is known of it and stands on its page: joint type, category, frames, seconds, size, source. What only a
    hidden truth would tell is missing; of tables alone all but the joint type is."""
    script: str
    """The packed data of its page; empty where nothing but tables was given."""
    sheets: tuple[bytes, ...]
    """JPEGs of ACROSS x DOWN pictures."""
    thumb: bytes
    """A JPEG; empty as `script`."""
    absent: dict[str, str]
    """Method's file name to why nothing of it can be shown here."""


@dataclass(frozen=True)
class Common:
    """What the sources of one sequence are shown in: a frame, a size, and how states are counted."""

    joint: Joint | None
    """The true one, or, where the truth is hidden, that of the first answer; None without any."""
    states: Array
    """(n,) of that joint."""
    size: float
    """Of the object, metres."""
    near: Array
    """(3,) where axes are drawn."""
    up: Array
    """(3,) in the common frame."""
    towards_viewer: Array
    """(3,) in the common frame."""
    Ts_camera: Array
    """(n, 4, 4) camera from the common frame."""
    bounds: Mesh
    """How far one sees, where the truth does not say it."""


def show_table(name: str, joint_type: JointType, entrants: Sequence[Entrant]) -> Shown:
    """What is shown of a sequence where there is no data folder: nothing but numbers."""
    absent = dict.fromkeys((e.file for e in entrants), "its table of scores alone was given")
    return Shown(name, {"joint_type": joint_type, "category": NOT_TOLD, "source": {}}, "", (), b"", absent)


def show_sequence(
    benchmark: Benchmark, name: str, entrants: Sequence[Entrant], protocol: str, joint_type: JointType
) -> Shown:
    """Read one sequence, its truth and every method's answer, and pack what is shown of them.

    Of a hidden truth nothing is read: answers are shown as they are, and the masks are those that methods see.
    """
    recording = read_sequence(benchmark.sequence(name))
    truth = None if benchmark.hidden else read_truth(benchmark.truth(name))
    frames = shown_frames(len(recording), FRAMES)
    size = recording.camera.height, recording.camera.width
    answers: dict[str, Answer] = {}
    absent: dict[str, str] = {}
    for entrant in entrants:
        row = entrant.row(protocol, name)
        found = _answer(entrant, name, row, truth or len(recording), frames.tolist(), size)
        if isinstance(found, Answer):
            answers[entrant.file] = found
        else:
            absent[entrant.file] = found
    packed = Packed()
    shown = [e for e in entrants if e.file in answers]
    if truth is None:
        common = _common_of_answers(recording, [answers[e.file] for e in shown])
        if common.joint is not None:
            answers = {file: align_states(one, common.joint, common.states) for file, one in answers.items()}
    else:
        common = _common_of_truth(truth)
    masks = [truth.part_mask(int(i)) if truth else recording.frame(int(i)).mask.astype(np.uint8) for i in frames]
    header: dict[str, Any] = {
        "player": {
            "frames": frames.tolist(),
            "times": packed.curve(recording.times_s[frames], 0.0, 1e-3),
            "width": size[1],
            "height": size[0],
            "across": ACROSS,
            "down": DOWN,
            "masks": {
                **({"truth": _masks(packed, np.stack(masks))} if truth else {}),
                **{e.file: _masks(packed, answers[e.file].masks) for e in shown if len(answers[e.file].masks)},
            },
        },
        "axes": {
            "size": round(common.size, 6),
            "near": _round(common.near),
            "sources": {
                **({"truth": _axis(truth.articulation.joint)} if truth else {}),
                **{e.file: _axis(answers[e.file].articulation.joint) for e in shown},
            },
            "poses": {}
            if truth
            else {e.file: packed.poses(T[frames]) for e in shown if len(T := answers[e.file].Ts_camera_articulation)},
        },
    }
    if common.joint is not None:
        header["states"] = {
            "type": common.joint.type,
            "times": packed.curve(recording.times_s, 0.0, 1e-3),
            **({"truth": packed.states(truth.states)} if truth else {}),
            "gone": _gone(truth) if truth else [],
            "methods": {
                e.file: packed.states(answers[e.file].states_as_true)
                for e in shown
                if answers[e.file].comparable and "states" not in answers[e.file].lacks
            },
        }
        header["scene"] = _scene(packed, recording, common, truth, frames, [(e, answers[e.file]) for e in shown])
    pictures = [checked.read_rgb(benchmark.sequence(name) / "rgb" / f"{i:05d}.png") for i in frames.tolist()]
    facts: dict[str, Any] = {
        "joint_type": joint_type,
        "category": NOT_TOLD,
        "frames": len(recording),
        "seconds": float(recording.times_s[-1] - recording.times_s[0]),
        "size": f"{size[1]} \N{MULTIPLICATION SIGN} {size[0]}",
        "source": {},
        "licence": recording.licence,
    }
    if truth is not None:
        category = str(truth.source.get("category") or "unknown")
        facts |= {"category": category, "diagonal_cm": 100 * truth.diagonal, "range": float(np.ptp(truth.states))}
        facts["source"] = truth.source
    return Shown(name, facts, packed.script(header), _sheets(pictures), _thumb(pictures, np.stack(masks)), absent)


def _common_of_truth(truth: Truth) -> Common:
    R_world_camera = truth.Ts_camera_reference[0, :3, :3].T
    return Common(
        truth.articulation.joint,
        truth.states,
        truth.diagonal,
        _near(truth),
        R_world_camera @ [0.0, -1.0, 0.0],
        R_world_camera @ [0.45, -0.4, -1.0],
        truth.Ts_camera_reference,
        EMPTY,
    )


def _common_of_answers(recording: Recording, answers: Sequence[Answer]) -> Common:
    """The camera frame of the first picture, the object's place and size as its depth shows them, and the joint and
    states of the first answer of the type that most have; of one that makes states, if any does."""
    types = [one.articulation.joint.type for one in answers]
    usual = [one for one, kind in zip(answers, types, strict=True) if kind == max(types, key=types.count)]
    first = next((one for one in usual if one.zero is None), next(iter(usual), None))
    posed = next((one for one in answers if len(one.Ts_camera_articulation)), None)
    points = np.zeros((0, 3))
    for frame in recording.frames():
        points = recording.camera.backproject(frame.depth)[frame.mask & (frame.depth > 0)]
        if len(points):
            break
    low, high = np.percentile(points, [1, 99], axis=0) if len(points) else np.zeros((2, 3))
    size = float(np.linalg.norm(high - low)) or _UNKNOWN_SIZE
    near = (low + high) / 2 if len(points) else np.array([0.0, 0.0, 1.0])
    corners = near + 0.6 * size * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    still = np.repeat(np.eye(4)[None], len(recording), 0)
    return Common(
        first.articulation.joint if first else None,
        first.states if first else np.zeros(len(recording)),
        size,
        near,
        np.array([0.0, -1.0, 0.0]),
        np.array([0.45, -0.4, -1.0]),
        posed.Ts_camera_articulation if posed else still,
        Mesh(corners, np.arange(8)[:, None].repeat(3, 1)),
    )


def _answer(
    entrant: Entrant, name: str, row: Row | None, truth: Truth | int, frames: list[int], size: tuple[int, int]
) -> Answer | str:
    """What can be shown of a method's answer, or why nothing can; `truth` as in `read_answer`."""
    if row is None:
        return "its table has no such row"
    if entrant.folder is None:
        return "its table of scores alone was given"
    if row.status != "ok":
        return f"{row.status}: {row.reason}"
    try:
        return read_answer(entrant.folder / name, truth, frames, row.swapped, entrant.method.lacks, size)
    except Exception as error:  # hostile files reach parsers of many libraries; each has exceptions of its own
        said = str(error) if isinstance(error, FreeArtError) else type(error).__name__
        return f"its files cannot be shown: {said}"


def _masks(packed: Packed, masks: NDArray[np.uint8]) -> dict[str, Any]:
    """Small label maps (k, height, width): the noisier, the smaller."""
    side = MASK_SIDE
    height, width = masks.shape[1:]
    while True:
        scale = min(1.0, side / max(height, width))
        small = max(1, round(width * scale)), max(1, round(height * scale))
        frames = np.stack([cv2.resize(mask, small, interpolation=cv2.INTER_NEAREST) for mask in masks])
        if _runs(frames) <= MASK_RUNS or side <= MASK_SIDE // 8:
            return {"width": small[0], "height": small[1], "labels": packed.labels(frames)}
        side //= 2


def _runs(frames: NDArray[np.uint8]) -> int:
    return int(np.count_nonzero(np.diff(frames.reshape(len(frames), -1), axis=1)) + len(frames))


def _gone(truth: Truth) -> list[list[int]]:
    """[first, last] of every run of frames in which not one pixel of the moving part is seen."""
    gone = np.concatenate([[0], (truth.seen[:, 1] == 0).astype(int), [0]])
    starts, ends = np.flatnonzero(np.diff(gone) == 1), np.flatnonzero(np.diff(gone) == -1) - 1
    return [[int(a), int(b)] for a, b in zip(starts, ends, strict=True)]


def _axis(joint: Joint) -> dict[str, Any]:
    return {"type": joint.type, "axis": _round(joint.axis), "pivot": _round(joint.pivot)}


def _round(values: Any) -> list[float]:
    return [float(f"{v:.6g}") for v in np.asarray(values, float).reshape(-1)]


def _near(truth: Truth) -> Array:
    """(3,) the middle of the true moving part in frame 0: where axes are drawn."""
    return box_centre(truth.articulation.moving.moved(truth.articulation.joint.transform(float(truth.states[0]))))


def _arrow_pose(joint: Joint, near: Array, size: float) -> Array:
    """(4, 4), with the scale `size` in it, that puts the unit arrow of `static/arrows.js` on the axis near `near`."""
    at = near if joint.type == "prismatic" else joint.pivot + joint.axis * (joint.axis @ (near - joint.pivot))
    other = np.eye(3)[np.argmin(np.abs(joint.axis))]
    x = np.cross(other, joint.axis)
    x /= np.linalg.norm(x)
    T = se3.pose(np.stack([x, np.cross(joint.axis, x), joint.axis], -1), at)
    T[:3, :3] *= size
    return T


def _scene(
    packed: Packed,
    recording: Recording,
    common: Common,
    truth: Truth | None,
    frames: NDArray[np.int64],
    answers: Sequence[tuple[Entrant, Answer]],
) -> dict[str, Any]:
    """The 3D view: truth (unless hidden) and answers, moved by one slider where their joints are of one type."""
    first, states, size, near = common.joint, common.states, common.size, common.near
    assert first is not None
    lower, upper = slider_range(first, states, size)
    sliders = [Slider(f"{first.type} joint", first.type, lower, upper, float(states[0]), states)]
    links: list[Link] = []
    layers: list[Layer] = []
    surfaces: list[Surface] = []
    extra: list[dict[str, Any]] = []

    def add(name: str, colour: str, parts: Sequence[Mesh], joint: Joint, moving: Link) -> None:
        root, layer = len(links), len(layers)
        links.extend([Link(-1), replace(moving, parent=root), Link(root, _arrow_pose(joint, near, 1.15 * size))])
        layers.extend([Layer(name, colour), Layer(f"axis of {name}", colour, "axis")])
        for k, mesh in enumerate(parts):
            surfaces.append(Surface(mesh, root + k, layer))
            extra.append({"colour": colour if k else _pale(colour)})
        surfaces.append(Surface(Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)), root + 2, layer + 1))
        extra.append({"arrow": joint.type})

    if truth is not None:
        outer = [truth.articulation.part(n).with_faces(f) for n, f in zip(PARTS, truth.outer, strict=True)]
        add("truth", TRUTH, outer, first, Link(-1, joint=first, slider=0))
    for entrant, answer in answers:
        joint = answer.articulation.joint
        moving = Link(-1, joint=joint, slider=0, scale=answer.sign, offset=answer.offset)
        if not answer.comparable:
            moving = Link(-1, joint=joint, slider=len(sliders))
            ends = slider_range(joint, answer.states, size)
            at = float(answer.states[0])
            sliders.append(Slider(f"{entrant.name}: {joint.type}", joint.type, *ends, at, answer.states))
        parts = [_near_enough(part, size) for part in (answer.articulation.reference, answer.articulation.moving)]
        add(entrant.name, entrant.colour, parts, joint, moving)
    scene = Scene(
        tuple(links),
        tuple(sliders),
        tuple(layers),
        tuple(surfaces[:2]) if truth else (Surface(common.bounds, 0, 0),),  # no answer says how far one sees
        common.up,
        common.towards_viewer,
        recording.camera,
    )
    data = scene_data(scene)
    for link in data["links"]:
        link["T"] = np.round(link["T"], 6).tolist()
        link["offset"] = round(link["offset"], 6)
        if link["joint"] is not None:
            link["joint"] = {k: v if k == "type" else _round(v) for k, v in link["joint"].items()}
    for slider, made in zip(data["sliders"], sliders, strict=True):
        told = packed.states(made.states) if made.states is not None else None
        slider |= {"states": told, "lower": round(made.lower, 6), "upper": round(made.upper, 6)}
    data["layers"] = [{"colour": layer["colour"], "style": layer["style"], "shown": True} for layer in data["layers"]]
    for k, layer in enumerate(data["layers"]):
        if k % 2:
            layer["follows"] = k - 1
    for surface, more in zip(surfaces, extra, strict=True):
        body = None if surface.mesh.empty else packed.mesh(simplified(surface.mesh, FACES))
        data["surfaces"].append({"link": surface.link, "layer": surface.layer, "mesh": body, **more})
    data |= {
        "up": _round(data["up"]),
        "towards_viewer": _round(data["towards_viewer"]),
        "centre": _round(data["centre"]),
        "radius": _round(data["radius"])[0],
        "camera": {**data["camera"], "K": recording.camera.K.tolist()},
        "camera_poses": packed.poses(common.Ts_camera[frames]),
        "arrangements": _arrangements(data, len(answers) + (truth is not None)),
    }
    return data


def _near_enough(mesh: Mesh, size: float) -> Mesh:
    """The mesh without what lies farther out than ten objects: one stray vertex must not blur all others."""
    if mesh.empty or bounding_diagonal(mesh) < 10 * size:
        return mesh
    near = np.abs(mesh.vertices).max(1) < 5 * size
    return mesh.with_faces(near[mesh.faces].all(1))


def _arrangements(data: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Sources beside each other in a grid as the viewer sees it, or all in one place with the truth see-through."""
    up = np.asarray(data["up"]) / np.linalg.norm(data["up"])
    front = np.asarray(data["towards_viewer"]) - up * (up @ data["towards_viewer"])
    right = np.cross(up, front / np.linalg.norm(front))
    columns = min(count, 2 if count in (2, 4) else 3)
    rows = -(-count // columns)
    room = 0.82 * data["radius"]  # which reaches as far as the part ever does
    across, down = 1.8 * room, 1.9 * room
    shifts = []
    for k in range(count):
        column, row = k % columns, k // columns
        place = across * (column - (columns - 1) / 2) * right - down * (row - (rows - 1) / 2) * up
        shifts.append(_round(place))
    camera = data["camera"]  # whose shape the view has
    need = 1.12 * room * max(0.95 * (rows - 1) + 0.9, columns / max(1.0, camera["width"] / camera["height"]))
    beside = {"name": "Side by side", "shifts": shifts, "radius": _round(need)[0]}
    over = {"name": "Overlaid", "shifts": [[0.0, 0.0, 0.0]] * count, "radius": _round(1.1 * room)[0], "ghost": True}
    return [beside, over] if count > 1 else []


def _pale(colour: str) -> str:
    """The colour half way to white: of the reference part."""
    return "#" + "".join(f"{(int(colour[k : k + 2], 16) + 255) // 2:02x}" for k in (1, 3, 5))


def _jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    ok, data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise FreeArtError(f"cannot encode a picture of shape {picture.shape}")
    return bytes(data)


def _fitted(picture: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    scale = min(1.0, side / max(picture.shape[:2]))
    size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.uint8) if scale < 1 else picture


def _sheets(pictures: list[NDArray[np.uint8]]) -> tuple[bytes, ...]:
    """All pictures as JPEG sheets, of the best quality at which they fit VIDEO_BYTES, judged by some of them."""
    small = [_fitted(picture, PICTURE_SIDE) for picture in pictures]
    quality = QUALITIES[-1]
    some = small[:: max(1, len(small) // 6)]
    for quality in QUALITIES:
        if np.mean([len(_jpeg(picture, quality)) for picture in some]) * len(small) <= VIDEO_BYTES:
            break
    blank = np.zeros_like(small[0])
    sheets = []
    for at in range(0, len(small), ACROSS * DOWN):
        cells = small[at : at + ACROSS * DOWN]
        rows = -(-len(cells) // ACROSS)
        cells = cells + [blank] * (rows * ACROSS - len(cells))
        sheets.append(_jpeg(np.vstack([np.hstack(cells[r * ACROSS : (r + 1) * ACROSS]) for r in range(rows)]), quality))
    return tuple(sheets)


def _thumb(pictures: list[NDArray[np.uint8]], masks: NDArray[np.uint8]) -> bytes:
    """A small picture of the object alone, from the frame that shows the most of both its parts."""
    seen = np.stack([(masks == k).sum((1, 2)) for k in (1, 2)]).astype(float)
    best = int(np.argmax(np.sqrt(seen[0] * seen[1]) + 1e-3 * seen.sum(0)))
    rows, columns = np.flatnonzero(masks[best].any(1)), np.flatnonzero(masks[best].any(0))
    picture = pictures[best]
    if len(rows):
        height, width = picture.shape[:2]
        middle_y, middle_x = (rows[0] + rows[-1]) / 2, (columns[0] + columns[-1]) / 2
        half = max(0.62 * (columns[-1] - columns[0]), 0.62 * (rows[-1] - rows[0]) * 16 / 9, 8.0)
        half = min(half, width / 2, height / 2 * 16 / 9)
        x, y = np.clip(middle_x, half, width - half), np.clip(middle_y, half * 9 / 16, height - half * 9 / 16)
        left, top = int(max(x - half, 0)), int(max(y - half * 9 / 16, 0))
        picture = picture[top : top + max(1, int(half * 9 / 8)), left : left + max(1, int(2 * half))]
    small = cv2.resize(picture, (THUMB, THUMB * 9 // 16), interpolation=cv2.INTER_AREA)
    return _jpeg(small.astype(np.uint8), 72)
