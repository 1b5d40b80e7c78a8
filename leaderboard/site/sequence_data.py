"""What the page of a sequence shows: video, part masks, meshes and joints in 3D, joint states; packed into a script."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.benchmark import Benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.joint import Joint, JointType
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.truth import Truth
from freeart21.view.document import TRUTH, escape
from freeart21.view.parts import FIRST_VIEW, axis_in_images, axis_place
from freeart21.view.plots import (
    STATE_MARGINS,
    STATE_SIZE,
    Axes,
    Curve,
    curves_data,
    display_unit,
    line_figure,
    unseen_boxes,
    x_range,
)
from freeart21.view.scene import (
    Layer,
    Link,
    Scene,
    Slider,
    Surface,
    axis_arrow,
    axis_pose,
    scene_data,
    slider_range,
)
from freeart21.view.simplify import simplified
from freeart21.view.tables import NONE
from freeart21.view.video import encode_jpeg, fitting_quality, shown_frames
from leaderboard.rows import Row
from leaderboard.site.answers import EMPTY, Answer, align_states, read_answer
from leaderboard.site.entrant import Entrant, svg_mark
from leaderboard.site.packed import Packed

FRAMES = 72
"""Images of a video, evenly spread."""
MASK_SIDE = 128
"""Pixels of the longer side of part masks; outlines are smoothed between them."""
MAX_RUNS = 18 << 10
"""Runs in the masks of one method, a byte or two each before DEFLATE; masks with more are scaled down."""
FACES = 440
"""Triangles per part."""
ARROW_SEGMENTS = (12, 7)
IMAGE_SIDE = 640
ACROSS, DOWN = 4, 6
"""Images per sheet."""
VIDEO_BYTES = 640 << 10
"""Most bytes of all sheets of a sequence; the JPEG quality is lowered until they fit."""
THUMBNAIL_WIDTH, THUMBNAIL_QUALITY = 176, 72
STATE_SAMPLES = 400
"""Most samples of a curve of joint states."""
UNKNOWN_SIZE = 0.3
"""m: diagonal of an object without depth, as those of the catalog."""
TRUTH_SHAPE = "M1.2 8.6l2.2-2.2l3.1 3.1l6.2-6.4l2.2 2.2l-8.4 8.6z"
"""A tick: the mark of the ground truth."""
LACKS = {
    "states": "makes no joint states",
    "poses": "makes no poses of the parts over time",
    "masks": "makes no part masks",
    "meshes": "makes no meshes",
    "renders": "makes no held-out views",
}
"""What a method states that it does not make."""


@dataclass(frozen=True)
class SequenceContent:
    """One sequence, ready to be written."""

    name: str
    facts: dict[str, Any]
    """Joint type, category, frames, seconds, size, source, licence; diagonal and range of a known truth. From tables
    alone, the joint type only."""
    script: str = ""
    """The packed data of its page; empty when only tables were given."""
    sheets: tuple[bytes, ...] = ()
    """JPEGs with ACROSS x DOWN images each."""
    thumb: bytes = b""
    """A JPEG; empty when only tables were given."""
    absent: dict[str, str] = field(default_factory=dict)
    """Method's file name to why nothing of its result can be shown."""
    states: tuple[str, dict[str, Any]] | None = None
    """HTML of the joint states' plot and its script's data; None when no result can be shown."""


@dataclass(frozen=True)
class Common:
    """The frame in which the results for one sequence are shown."""

    joint: Joint | None
    """The true one; that of the first result when the truth is hidden; None without any."""
    states: Array
    """(n,) of that joint."""
    size: float
    """Diagonal of the object, m."""
    near: Array
    """(3,) where axes are drawn."""
    up: Array
    """(3,)"""
    towards_viewer: Array
    """(3,)"""
    Ts_camera: Array
    """(n, 4, 4) camera from the common frame."""
    bounds: Mesh
    """What the first view contains when the truth is hidden."""


@dataclass(frozen=True)
class Source:
    """The ground truth, or a method with its result, as all views show it."""

    id: str
    name: str
    colour: str
    shape: str
    """SVG path of its mark."""
    dash: str
    answer: Answer | None
    """None when it cannot be shown."""
    absent: str = ""
    """Why it cannot."""
    lacks: tuple[str, ...] = ()


def show_table(name: str, joint_type: JointType, entrants: Sequence[Entrant]) -> SequenceContent:
    """What is shown of a sequence without its data folder: numbers alone."""
    absent = dict.fromkeys((e.file for e in entrants), "only its table of scores was given")
    return SequenceContent(name, {"joint_type": joint_type, "category": NONE, "source": {}}, absent=absent)


def show_sequence(
    benchmark: Benchmark, name: str, entrants: Sequence[Entrant], protocol: str, joint_type: JointType
) -> SequenceContent:
    """Read one sequence, its truth and every method's result, and pack them.

    Nothing of a hidden truth is read: results are shown as they are, with the foreground masks that methods see.
    """
    recording = read_sequence(benchmark.sequence(name))
    truth = None if benchmark.hidden else read_truth(benchmark.truth(name))
    frames = shown_frames(len(recording), FRAMES)
    size = recording.camera.height, recording.camera.width
    answers: dict[str, Answer] = {}
    absent: dict[str, str] = {}
    for entrant in entrants:
        row = entrant.row(protocol, name)
        answer = _read_answer(entrant, name, row, truth or len(recording), frames.tolist(), size)
        if isinstance(answer, Answer):
            answers[entrant.file] = answer
        else:
            absent[entrant.file] = answer
    if truth is None:
        common = _common_of_answers(recording, list(answers.values()))
        if common.joint is not None:
            answers = {file: align_states(one, common.joint, common.states) for file, one in answers.items()}
    else:
        common = _common_of_truth(truth)
    sources = [
        Source(e.file, e.name, e.colour, e.shape, e.dash, answers.get(e.file), absent.get(e.file, ""), e.method.lacks)
        for e in entrants
    ]
    masks = np.stack(
        [truth.part_mask(i) if truth else recording.frame(i).mask.astype(np.uint8) for i in frames.tolist()]
    )
    if truth is not None:
        own = _truth_as_answer(truth, masks)
        sources = [Source("truth", "ground truth", TRUTH, TRUTH_SHAPE, "", own), *sources]
    packed = Packed()
    header = {"overlays": _overlays(packed, recording, common, truth is None, frames, sources)}
    states = None
    if common.joint is not None:
        header["scene"] = _scene(packed, recording, common, sources)
        seen = None if truth is None else truth.seen[:, 1] > 0
        states = _states(recording, common.joint, seen, sources)
    images = [checked.read_rgb(benchmark.sequence(name) / "rgb" / f"{i:05d}.png") for i in frames.tolist()]
    facts: dict[str, Any] = {
        "joint_type": joint_type,
        "category": NONE,
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
    return SequenceContent(
        name, facts, packed.script(header), _sheets(images), _thumbnail(images, masks), absent, states
    )


def _read_answer(
    entrant: Entrant, name: str, row: Row | None, truth: Truth | int, frames: list[int], size: tuple[int, int]
) -> Answer | str:
    """A method's result, or why it cannot be shown; `truth` as in `read_answer`."""
    if row is None:
        return "its table has no such row"
    if entrant.folder is None:
        return "only its table of scores was given"
    if row.status != "ok":
        return f"{row.status}: {row.reason}"
    try:
        return read_answer(entrant.folder / name, truth, frames, row.swapped, entrant.method.lacks, size)
    except Exception as error:  # hostile files reach parsers of many libraries; each has exceptions of its own
        reason = str(error) if isinstance(error, FreeArtError) else type(error).__name__
        return f"its files cannot be shown: {reason}"


def _truth_as_answer(truth: Truth, masks: NDArray[np.uint8]) -> Answer:
    """The truth as a perfect result, with its outer surfaces."""
    outer = [truth.articulation.part(n).with_faces(f) for n, f in zip(PARTS, truth.outer, strict=True)]
    parts = Articulation(truth.articulation.joint, outer[0], outer[1])
    return Answer(parts, truth.states, 1.0, 0.0, True, None, truth.Ts_camera_reference, masks, ())


def _common_of_truth(truth: Truth) -> Common:
    R_world_camera = truth.Ts_camera_reference[0, :3, :3].T
    return Common(
        truth.articulation.joint,
        truth.states,
        truth.diagonal,
        axis_place(truth.articulation, truth.states)[0],
        R_world_camera @ [0.0, -1.0, 0.0],
        R_world_camera @ FIRST_VIEW,
        truth.Ts_camera_reference,
        EMPTY,
    )


def _common_of_answers(recording: Recording, answers: Sequence[Answer]) -> Common:
    """The camera frame of the first image, with the object's place and size by its depth.

    Joint and states are those of the first result with the most frequent joint type; of one with states, if any.
    """
    types = [one.articulation.joint.type for one in answers]
    frequent = [one for one, kind in zip(answers, types, strict=True) if kind == max(types, key=types.count)]
    first = next((one for one in frequent if one.zero is None), next(iter(frequent), None))
    posed = next((one for one in answers if len(one.Ts_camera_articulation)), None)
    points = np.zeros((0, 3))
    for frame in recording.frames():
        points = recording.camera.backproject(frame.depth)[frame.mask & (frame.depth > 0)]
        if len(points):
            break
    low, high = np.percentile(points, [1, 99], axis=0) if len(points) else np.zeros((2, 3))
    size = float(np.linalg.norm(high - low)) or UNKNOWN_SIZE
    near = (low + high) / 2 if len(points) else np.array([0.0, 0.0, 1.0])
    corners = near + 0.6 * size * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return Common(
        first.articulation.joint if first else None,
        first.states if first else np.zeros(len(recording)),
        size,
        near,
        np.array([0.0, -1.0, 0.0]),
        FIRST_VIEW,
        posed.Ts_camera_articulation if posed else np.repeat(np.eye(4)[None], len(recording), 0),
        Mesh(corners, np.arange(8)[:, None].repeat(3, 1)),
    )


# --- video ------------------------------------------------------------------------------------------------------------


def _overlays(
    packed: Packed,
    recording: Recording,
    common: Common,
    hidden: bool,
    frames: NDArray[np.int64],
    sources: Sequence[Source],
) -> dict[str, Any]:
    """Input of the player: masks and axes of every source; with a `hidden` truth, axes by each result's own poses."""
    entries = []
    for k, source in enumerate(sources):
        masks, axis, answer = None, None, source.answer
        if answer is not None:
            Ts = answer.Ts_camera_articulation if hidden else common.Ts_camera
            joint, place = answer.articulation.joint, (common.near, common.size)
            axis = packed.lines(axis_in_images(joint, *place, Ts[frames], recording.camera)) if len(Ts) else None
            masks = _masks(packed, answer.masks) if len(answer.masks) else None
        entries.append(
            {
                **{key: getattr(source, key) for key in ("id", "name", "colour", "shape")},
                "first": k < (1 if hidden else 2),  # the truth and the first method are shown at first
                "why": _brief(source.absent or (LACKS["masks"] if "masks" in source.lacks else "")),
                "masks": masks,
                "axis": axis,
            }
        )
    return {
        "frames": frames.tolist(),
        "times": packed.curve(recording.times_s[frames], 0.0, 1e-3),
        "width": recording.camera.width,
        "height": recording.camera.height,
        "across": ACROSS,
        "down": DOWN,
        "sources": entries,
    }


def _masks(packed: Packed, masks: NDArray[np.uint8]) -> dict[str, Any]:
    """Label maps (k, height, width), scaled down until they have at most MAX_RUNS runs."""
    side = MASK_SIDE
    height, width = masks.shape[1:]
    while True:
        scale = min(1.0, side / max(height, width))
        small = max(1, round(width * scale)), max(1, round(height * scale))
        frames = np.stack([cv2.resize(mask, small, interpolation=cv2.INTER_NEAREST) for mask in masks])
        runs = int(np.count_nonzero(np.diff(frames.reshape(len(frames), -1), axis=1)) + len(frames))
        if runs <= MAX_RUNS or side <= MASK_SIDE // 8:
            return {"width": small[0], "height": small[1], "labels": packed.labels(frames)}
        side //= 2


def _brief(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}…"


def _reduced(image: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    scale = min(1.0, side / max(image.shape[:2]))
    size = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8) if scale < 1 else image


def _sheets(images: list[NDArray[np.uint8]]) -> tuple[bytes, ...]:
    """All images as JPEG sheets."""
    small = [_reduced(image, IMAGE_SIDE) for image in images]
    quality, per = fitting_quality(small, VIDEO_BYTES), ACROSS * DOWN
    sheets = []
    for at in range(0, len(small), per):
        cells = small[at : at + per]
        cells += [np.zeros_like(small[0])] * (-len(cells) % ACROSS)
        rows = [np.hstack(cells[k : k + ACROSS]) for k in range(0, len(cells), ACROSS)]
        sheets.append(encode_jpeg(np.vstack(rows), quality))
    return tuple(sheets)


def _thumbnail(images: list[NDArray[np.uint8]], masks: NDArray[np.uint8]) -> bytes:
    """A 16:9 image of the object alone, from the frame that shows the most of both its parts."""
    seen = np.stack([(masks == k).sum((1, 2)) for k in (1, 2)]).astype(float)
    best = int(np.argmax(np.sqrt(seen[0] * seen[1]) + 1e-3 * seen.sum(0)))
    rows, columns = np.flatnonzero(masks[best].any(1)), np.flatnonzero(masks[best].any(0))
    image = images[best]
    if len(rows):
        height, width = image.shape[:2]
        middle_y, middle_x = (rows[0] + rows[-1]) / 2, (columns[0] + columns[-1]) / 2
        half = max(0.62 * (columns[-1] - columns[0]), 0.62 * (rows[-1] - rows[0]) * 16 / 9, 8.0)
        half = min(half, width / 2, height / 2 * 16 / 9)
        x, y = np.clip(middle_x, half, width - half), np.clip(middle_y, half * 9 / 16, height - half * 9 / 16)
        left, top = int(max(x - half, 0)), int(max(y - half * 9 / 16, 0))
        image = image[top : top + max(1, int(half * 9 / 8)), left : left + max(1, int(2 * half))]
    small = cv2.resize(image, (THUMBNAIL_WIDTH, THUMBNAIL_WIDTH * 9 // 16), interpolation=cv2.INTER_AREA)
    return encode_jpeg(small.astype(np.uint8), THUMBNAIL_QUALITY)


# --- 3D view ----------------------------------------------------------------------------------------------------------


def _scene(packed: Packed, recording: Recording, common: Common, sources: Sequence[Source]) -> dict[str, Any]:
    """The 3D view of all sources with a result, moved by one slider where their joints are of one type.

    A source has three links (reference part, moving part, axis) and two layers (parts, axis).
    """
    first, size = common.joint, common.size
    assert first is not None
    ends = slider_range(first, common.states, size)
    sliders = [Slider(f"{first.type} joint", first.type, *ends, float(common.states[0]), common.states)]
    links: list[Link] = []
    layers: list[Layer] = []
    surfaces: list[dict[str, Any]] = []
    bounds = [] if common.bounds.empty else [Surface(common.bounds, 0, 0)]
    answers = [(source, source.answer) for source in sources if source.answer is not None]
    for source, answer in answers:
        parts, root, layer = answer.articulation, len(links), len(layers)
        if not bounds:  # the truth, which is the first one
            bounds = [Surface(parts.reference, 0, 0), Surface(parts.moving, 1, 0)]
        T_arrow = axis_pose(parts.joint, common.near)
        T_arrow[:3, :3] *= size
        links += [Link(-1), _moving_link(source.name, answer, root, sliders, size), Link(root, T_arrow)]
        layers += [Layer(source.name, source.colour), Layer("axis", source.colour, "axis")]
        for k, mesh in enumerate((parts.reference, parts.moving)):
            near = _without_far_vertices(mesh, size)
            if not near.empty:
                colour = source.colour if k else _pale(source.colour)
                body = packed.mesh(simplified(near, FACES))
                surfaces.append({"link": root + k, "layer": layer, "mesh": body, "colour": colour})
        surfaces.append({"link": root + 2, "layer": layer + 1, "mesh": _packed_arrow(packed, parts.joint.type)})
    views, camera = (common.up, common.towards_viewer), recording.camera
    data = scene_data(Scene(tuple(links), tuple(sliders), tuple(layers), tuple(bounds), *views, camera))
    roots = list(range(0, len(links), 3))
    below = data["centre"] - 0.66 * data["radius"] * common.up
    for k, (source, _) in enumerate(answers):
        data["layers"][2 * k]["shape"] = source.shape
        data["layers"][2 * k + 1]["follows"] = 2 * k
    data |= {
        "surfaces": surfaces,
        "roots": roots,
        "labels": [
            {"text": source.name, "link": root, "layer": 2 * k, "at": below}
            for k, ((source, _), root) in enumerate(zip(answers, roots, strict=True))
        ],
        "arrangements": _arrangements(data, len(answers), camera.width / camera.height),
    }
    for slider in data["sliders"]:
        slider["states"] = packed.states(slider["states"])
    return {**_rounded(data), "camera_poses": packed.poses(common.Ts_camera)}


def _moving_link(name: str, answer: Answer, root: int, sliders: list[Slider], size: float) -> Link:
    """The link of a result's moving part; a joint of another type than the common one gets a slider of its own."""
    joint = answer.articulation.joint
    if answer.comparable:
        return Link(root, joint=joint, slider=0, scale=answer.sign, offset=answer.offset)
    ends = slider_range(joint, answer.states, size)
    sliders.append(Slider(f"{name}: {joint.type}", joint.type, *ends, float(answer.states[0]), answer.states))
    return Link(root, joint=joint, slider=len(sliders) - 1)


def _packed_arrow(packed: Packed, joint_type: str) -> dict[str, Any]:
    """The arrow of an axis; the links have its size, so that all methods share one mesh."""
    return packed.mesh(axis_arrow(joint_type, segments=ARROW_SEGMENTS))


def _without_far_vertices(mesh: Mesh, size: float) -> Mesh:
    """The mesh without what is farther out than ten objects, because all vertices share one quantisation."""
    if mesh.empty or bounding_diagonal(mesh) < 10 * size:
        return mesh
    near = np.abs(mesh.vertices).max(1) < 5 * size
    return mesh.with_faces(near[mesh.faces].all(1))


def _arrangements(data: dict[str, Any], count: int, aspect: float) -> list[dict[str, Any]]:
    """Sources side by side in a grid that faces the viewer, or all in one place with the first one transparent."""
    up = data["up"] / np.linalg.norm(data["up"])
    front = data["towards_viewer"] - up * (up @ data["towards_viewer"])
    right = np.cross(up, front / np.linalg.norm(front))
    columns = min(count, 2 if count in (2, 4) else 3)
    rows = -(-count // columns)
    room = 0.82 * data["radius"]  # the radius also contains the moving part at the ends of its range
    shifts = []
    for k in range(count):
        column, row = k % columns, k // columns
        shifts.append(1.8 * room * (column - (columns - 1) / 2) * right - 1.9 * room * (row - (rows - 1) / 2) * up)
    radius = 1.12 * room * max(0.95 * (rows - 1) + 0.9, columns / max(1.0, aspect))
    beside = {"name": "Side by side", "shifts": shifts, "radius": radius}
    over = {"name": "Overlaid", "shifts": [[0.0, 0.0, 0.0]] * count, "radius": 1.1 * room, "ghost": True}
    return [beside, over] if count > 1 else []


def _pale(colour: str) -> str:
    """The colour halfway to white, for the reference part."""
    return "#" + "".join(f"{(int(colour[k : k + 2], 16) + 255) // 2:02x}" for k in (1, 3, 5))


def _rounded(value: Any) -> Any:
    """Plain data with numbers to six significant digits."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: one if key == "$" or "$" in value else _rounded(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(one) for one in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


# --- joint states -----------------------------------------------------------------------------------------------------


def _states(
    recording: Recording, joint: Joint, seen: NDArray[np.bool_] | None, sources: Sequence[Source]
) -> tuple[str, dict[str, Any]]:
    """The plot of joint states, with a button to hide each curve, and the methods without a curve below it.

    `seen` (n,) is False in frames without a pixel of the moving part; None when the truth is hidden.
    """
    frames = shown_frames(len(recording), STATE_SAMPLES)
    x = recording.times_s[frames] - recording.times_s[0]
    unit, factor = display_unit(joint.type)
    curves, without = [], ""
    for source in sources:
        answer = source.answer
        if answer is not None and answer.comparable and "states" not in answer.lacks:
            values = factor * answer.states_as_true[frames]
            style = "wide" if source.id == "truth" else ""
            curves.append(Curve(source.name, source.colour, values, style, None, source.dash))
        else:
            why = source.absent or (LACKS["states"] if "states" in source.lacks else "another joint type")
            name = f'<span class="who">{escape(source.name)}</span><small>{escape(_brief(why))}</small>'
            without += f'<span class="chip absent">{svg_mark(source.shape, source.colour)}{name}</span>'
    first = curves[0].values if curves else np.zeros(1)
    every = np.concatenate([first, *(curve.values for curve in curves)])
    span = float(np.ptp(first)) or 1.0
    low = max(first.min() - 0.75 * span, every.min() - 0.05 * span)
    high = min(first.max() + 0.75 * span, every.max() + 0.05 * span)
    curves = [replace(curve, values=np.clip(curve.values, low, high)) for curve in curves]
    axes = Axes(*STATE_SIZE, STATE_MARGINS, x_range(x), (low, high))
    under = unseen_boxes(axes, x, seen[frames]) if seen is not None else []
    entry = '<li><button type="button" class="chip" aria-pressed="true">{}</button></li>'
    html = line_figure(axes, x, curves, "", f"joint state, {unit}", " s", (6, 5), under, entry=entry)
    html = f'<div class="charts wide">{html}</div>' + (f'<div class="sources">{without}</div>' if without else "")
    return html, curves_data(axes, x, [curves], frames)
