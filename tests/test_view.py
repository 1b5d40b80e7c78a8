"""A page holds what it shows, fetches nothing, and runs nothing that came with the data."""

import base64
import hashlib
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from browser import CHROMIUM, browser
from page_data import Parsed, extract_array
from refusal import assert_refused

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.asset import Asset
from freeart21.camera import Camera
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.files.asset import write_asset_json
from freeart21.files.result import write_result
from freeart21.files.sequence import write_sequence
from freeart21.files.truth import write_truth
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.recording import Frame, Recording
from freeart21.truth import Truth
from freeart21.view import page, write_page
from freeart21.view.asset_scene import asset_scene
from freeart21.view.document import Section, document, embed_json
from freeart21.view.link_shapes import read_shown
from freeart21.view.obj import read_obj
from freeart21.view.parts import align, articulation_scene, exchanged, matched, with_truth
from freeart21.view.plots import state_section
from freeart21.view.scene import Link, link_poses, scene_section, slider_range
from freeart21.view.simplify import box, cylinder, simplified, sphere
from freeart21.view.tables import score_section, source_rows, table_cell
from freeart21.view.video import VideoSettings, shown_frames, video_section

N, WIDTH, HEIGHT = 6, 48, 32
STATIC = Path(__file__).resolve().parents[1] / "freeart21" / "view" / "static"
CSS = (STATIC / "page.css").read_text()
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"'&\u2028"


def coloured(mesh: Mesh, seed: int) -> Mesh:
    colours = np.random.default_rng(seed).integers(0, 256, (len(mesh.vertices), 3))
    return Mesh(mesh.vertices, mesh.faces, colours.astype(np.uint8))


def make_truth(joint_type: str = "revolute") -> Truth:
    joint = Joint("lid", joint_type, [0.0, 0.6, 0.8], [0.05, -0.02, 0.01], -0.2, 1.1)  # type: ignore[arg-type]
    reference = coloured(box([0.2, 0.1, 0.05]), 1)
    moving = coloured(box([0.1, 0.1, 0.02]).moved(se3.pose(np.eye(3), [0.05, 0, 0.04])), 2)
    states = np.linspace(0.0, 1.0, N) ** 2
    twists = np.random.default_rng(3).normal(0, 0.3, (N, 6))
    reference_poses = se3.pose(np.eye(3), [0, 0, 0.8]) @ se3.exp_se3(twists)
    masks = np.zeros((N, HEIGHT, WIDTH), np.uint8)
    masks[:, 8:24, 8:24], masks[:, 8:24, 24:36] = 1, 2
    flags = (np.ones(len(reference.faces), bool), np.ones(len(moving.faces), bool))
    return Truth(
        Articulation(joint, reference, moving),
        states,
        reference_poses,
        reference_poses @ joint.transform(states),
        np.full((N, 2), 200),
        flags,
        flags,
        lambda i: masks[i],
        lambda i: np.zeros((HEIGHT, WIDTH, 3), np.uint8),
        lambda i: masks[i] > 0,
        {"object": "box", "motion": {"name": "tumble", "seed": 3}},
    )


def perfect_result(truth: Truth, shift: float = 0.3, sign: float = -1.0) -> Reconstruction:
    """The truth in another canonical frame, with the axis turned round (or not) and another state zero."""
    T_new_old = se3.exp_se3([0.3, -0.2, 0.1, 0.4, 1.0, -0.7])
    at_shift = truth.articulation.moving.moved(truth.articulation.joint.transform(shift))
    joint = truth.articulation.joint if sign > 0 else truth.articulation.joint.reversed()
    old = Articulation(joint, truth.articulation.reference, at_shift)
    new = old.moved(T_new_old)
    states = sign * (truth.states - shift)
    reference = truth.Ts_camera_reference @ se3.inverse(T_new_old)
    return Reconstruction(
        new,
        states,
        reference,
        reference @ new.joint.transform(states),
        np.stack([truth.part_mask(i) for i in range(N)]),
        np.array([[True, i not in (2, 3)] for i in range(N)]),
        np.array([0.01, 0.02, np.nan, np.nan, 0.02, 0.01]),
        seconds={"tracks": 2.5, "joint": 0.5},
    )


def make_recording(n: int = N, name: str = "sequence", noise: bool = False) -> Recording:
    rng = np.random.default_rng(0)
    truth = make_truth()

    def load(i: int) -> Frame:
        rgb = rng.integers(0, 256, (HEIGHT, WIDTH, 3)) if noise else np.full((HEIGHT, WIDTH, 3), 20 * (i % N) + 40)
        mask = truth.part_mask(i % N) > 0
        return Frame(rgb.astype(np.uint8), np.where(mask, 0.8, 0.0).astype(np.float32), mask)

    return Recording(Camera.from_fov(WIDTH, HEIGHT, 0.8), np.arange(n) / 10, load, licence="CC-BY-4.0", name=name)


@pytest.fixture
def folders(tmp_path: Path) -> dict[str, Path]:
    truth = make_truth()
    write_sequence(tmp_path / "seq", make_recording(), 1e-4)
    write_truth(tmp_path / "truth", truth, 0)
    write_result(tmp_path / "result", perfect_result(truth))
    return {name: tmp_path / name for name in ("seq", "truth", "result")}


def write_urdf(folder: Path, link: str = "lid", body: str = "") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    name = link.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    path = folder / "thing.urdf"
    path.write_text(f"""<?xml version="1.0"?><robot name="thing">
      <link name="base"><visual><geometry><box size="0.2 0.1 0.05"/></geometry>
        <material name="m"><color rgba="1 0 0 1"/></material></visual>
        <inertial><origin rpy="0 0 1.5707963267948966"/><mass value="2.5"/>
        <inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="3"/></inertial></link>
      <link name="{name}"><visual><origin xyz="0.05 0 0"/><geometry><cylinder radius="0.02" length="0.1"/></geometry>
        </visual><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
      <joint name="hinge" type="revolute"><origin xyz="0.1 0 0" rpy="0 1.5707963267948966 0"/><parent link="base"/>
        <child link="{name}"/><axis xyz="0 0 2"/><limit lower="-0.5" upper="1.5" effort="3"/>
        <dynamics damping="0.02"/></joint>{body}</robot>""")
    return path


def write_asset(folder: Path) -> Path:
    urdf = write_urdf(folder)
    effects = {"hinge": (ViscousDamping(0.02),)}
    write_asset_json(folder, Asset(urdf, "hinge", "base", "lid", np.eye(4), 0.25, effects, source={"made": "by hand"}))
    return folder


# ---------------------------------------------------------------- the document


def test_page_fetches_nothing_and_runs_its_own_script_only(folders: dict[str, Path]) -> None:
    text = page(folders["result"], folders["truth"], folders["seq"])
    parsed = Parsed(text)
    for name, value in parsed.attributes:
        if name in ("src", "href", "action", "data", "poster", "srcset"):
            assert value.startswith("data:"), f"{name}={value[:60]}"
    assert not re.search(r"https?:|@import|url\(", text)
    policy = next(value for name, value in parsed.attributes if name == "content" and "default-src" in value)
    (script,) = [text for is_data, text in parsed.scripts if not is_data]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert policy == f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"


def test_hostile_texts_change_no_element_of_the_page(tmp_path: Path) -> None:
    truth = make_truth()

    def build(text: str, folder: Path) -> str:
        result = perfect_result(truth)
        joint = replace(result.articulation.joint, name=text)
        result = replace(result, articulation=replace(result.articulation, joint=joint), seconds={text: 1.0})
        write_result(folder / "result", result)
        write_sequence(folder / "seq", replace(make_recording(), licence=text), 1e-4)
        write_truth(folder / "truth", replace(truth, source={text: text}), 0)
        scores = {text: {"value": text, "unit": text, "better": "up", "beside": text}}
        write_urdf(folder / "result" / "asset", link=text)
        return page(folder / "result", folder / "truth", folder / "seq", scores)

    tame, hostile = build("tame", tmp_path / "1"), build(HOSTILE, tmp_path / "2")
    assert Parsed(hostile).tags == Parsed(tame).tags
    scenes = [data for data in Parsed(hostile).data if "sliders" in data]
    assert scenes[0]["sliders"][0]["name"] == HOSTILE
    assert "alert(1)</script>" not in hostile


def test_json_in_a_page_is_safe_and_says_null_for_what_is_not_finite() -> None:
    data = {"a": [HOSTILE, np.float64(np.nan), np.inf, np.array([1.5, -np.inf]), np.int64(3), None, True]}
    text = embed_json(data)
    assert not set(text) & set("<>&\u2028")
    assert json.loads(text) == {"a": [HOSTILE, None, None, [1.5, None], 3, None, True]}


def test_title_is_escaped_in_every_place() -> None:
    assert Parsed(document(HOSTILE, [Section(HOSTILE, "")], HOSTILE, [HOSTILE], [HOSTILE])).tags.count("script") == 1


def test_write_page_leaves_nothing_when_it_fails(tmp_path: Path, folders: dict[str, Path]) -> None:
    write_page(folders["seq"], tmp_path / "out" / "page.html")
    assert (tmp_path / "out" / "page.html").read_text().startswith("<!DOCTYPE html>")
    with pytest.raises(FreeArtError):
        write_page(tmp_path, tmp_path / "bad" / "page.html")
    assert not (tmp_path / "bad").exists()


# ---------------------------------------------------------------- what is shown


def test_sequence_page_holds_all_frames(folders: dict[str, Path]) -> None:
    (video,) = Parsed(page(folders["seq"])).data
    assert video["frames"] == list(range(N)) and video["times_s"] == pytest.approx([i / 10 for i in range(N)])
    for kind in ("rgb", "depth", "labels"):
        assert len(video[kind]) == N
    for i, url in enumerate(video["rgb"]):
        image = cv2.imdecode(np.frombuffer(base64.b64decode(url.split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
        assert image.shape == (HEIGHT, WIDTH, 3)
        assert abs(float(image.mean()) - (20 * i + 40)) < 2, "frames must be in order"
    assert not video["estimate"] and not video["truth"]


def test_labels_of_a_frame_decode_to_the_masks(folders: dict[str, Path]) -> None:
    video = Parsed(page(folders["result"], folders["truth"], folders["seq"])).data[0]
    labels = cv2.imdecode(np.frombuffer(base64.b64decode(video["labels"][2].split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
    truth = make_truth().part_mask(2)
    blue_green_red = np.moveaxis(np.rint(labels / 100), -1, 0)
    for got, expected in zip(blue_green_red, (truth, truth, truth > 0), strict=True):
        assert np.array_equal(got, expected)


def test_long_videos_are_thinned_and_large_ones_scaled() -> None:
    assert shown_frames(1000, 150)[[0, -1]].tolist() == [0, 999] and len(shown_frames(1000, 150)) == 150
    assert shown_frames(3, 150).tolist() == [0, 1, 2]
    data = video_section(make_recording(40), settings=VideoSettings(max_frames=7, max_side=24)).data
    assert (data["width"], data["height"], len(data["rgb"])) == (24, 16, 7)


def test_pictures_of_pure_noise_stay_within_the_byte_budget() -> None:
    """Budgets of 6 and 3 MiB for pictures and depth keep every page under 15 MB after base64."""
    settings = VideoSettings()
    assert (settings.rgb_bytes + settings.depth_bytes) * 4 / 3 < 13e6
    free = video_section(make_recording(noise=True)).data
    tight = video_section(make_recording(noise=True), settings=VideoSettings(rgb_bytes=N * 1100)).data
    sizes = [sum(len(base64.b64decode(url.split(",")[1])) for url in data["rgb"]) for data in (free, tight)]
    assert sizes[1] <= N * 1100 < sizes[0]


def test_masks_of_another_size_are_refused() -> None:
    with pytest.raises(FreeArtError, match="mask of the estimated parts is 9 x 8, expected 48 x 32"):
        video_section(make_recording(), estimate=lambda i: np.zeros((8, 9), np.uint8))


def test_result_page_shows_meshes_as_they_are(folders: dict[str, Path]) -> None:
    scene = next(data for data in Parsed(page(folders["result"])).data if "surfaces" in data)
    result = perfect_result(make_truth())
    for surface, mesh in zip(
        scene["surfaces"], (result.articulation.reference, result.articulation.moving), strict=False
    ):
        step = np.ptp(mesh.vertices, 0) / 65535
        assert (np.abs(extract_array(surface["vertices"]) - mesh.vertices) <= 0.5001 * step).all()
        assert np.array_equal(extract_array(surface["faces"]), mesh.faces)
        assert np.array_equal(extract_array(surface["colours"]), mesh.colours)
    assert scene["sliders"][0]["states"] == pytest.approx(result.states.tolist())


def test_part_of_a_single_colour_is_shown_in_the_colour_of_its_part() -> None:
    truth = make_truth()
    white = replace(truth.articulation.moving, colours=np.full_like(truth.articulation.moving.colours, 255))
    scene = articulation_scene(replace(truth.articulation, moving=white), truth.states, truth.Ts_camera_reference)
    assert scene.surfaces[0].mesh.colours is not None and scene.surfaces[1].mesh.colours is None


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("joint_type", ["revolute", "prismatic"])
def test_truth_lies_exactly_over_a_perfect_result(joint_type: str, sign: float, swap: bool) -> None:
    truth = make_truth(joint_type)
    result = perfect_result(truth, sign=sign)
    result = matched(exchanged(result) if swap else result, truth)
    alignment = align(result, truth)
    assert np.abs(alignment.states(truth) - result.states).max() < 1e-9
    found, true = result.articulation.joint, alignment.joint(truth)
    assert np.abs(found.axis - true.axis).max() < 1e-9
    assert alignment.offset == pytest.approx(-0.3 * alignment.sign)
    assert true.lower == pytest.approx(-0.5 if alignment.sign > 0 else -0.8)
    scene = with_truth(
        articulation_scene(result.articulation, result.states, result.Ts_camera_reference), truth, alignment
    )
    names = [layer.name for layer in scene.layers]
    reference, moving = (
        next(s for s in scene.surfaces if s.layer == names.index(name))
        for name in ("true reference part", "true moving part")
    )
    for i, state in enumerate(result.states):
        poses = link_poses(scene.links, [state])
        for surface, mesh, T in (
            (reference, truth.articulation.reference, truth.Ts_camera_reference[i]),
            (moving, truth.articulation.moving, truth.Ts_camera_moving[i]),
        ):
            drawn = se3.transform(result.Ts_camera_reference[i] @ poses[surface.link], surface.mesh.vertices)
            assert np.abs(drawn - se3.transform(T, mesh.vertices)).max() < 1e-9


def test_truth_of_another_joint_type_gets_its_own_slider() -> None:
    truth, other = make_truth("prismatic"), perfect_result(make_truth("revolute"))
    alignment = align(other, truth)
    scene = with_truth(
        articulation_scene(other.articulation, other.states, other.Ts_camera_reference), truth, alignment
    )
    assert not alignment.comparable
    assert [s.type for s in scene.sliders] == ["revolute", "prismatic"]
    assert np.array_equal(scene.sliders[1].states, truth.states)


def test_result_with_empty_parts_no_limits_and_one_frame_is_shown(tmp_path: Path) -> None:
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    joint = Joint("j", "prismatic", [1, 0, 0], [0, 0, 0], -np.inf, np.inf)
    masks = np.zeros((1, 4, 4), np.uint8)
    one = Reconstruction(
        Articulation(joint, nothing, nothing),
        np.zeros(1),
        np.eye(4)[None],
        np.eye(4)[None],
        masks,
        np.zeros((1, 2), bool),
    )
    write_result(tmp_path / "result", one)
    text = page(tmp_path / "result")
    scene = next(data for data in Parsed(text).data if "surfaces" in data)
    assert [scene["layers"][surface["layer"]]["name"] for surface in scene["surfaces"]] == ["joint axis"]
    assert (
        scene["sliders"][0]["lower"] < scene["sliders"][0]["upper"] and "nan" not in text.split("<script>")[0].lower()
    )


def test_failure_page_says_why(tmp_path: Path, folders: dict[str, Path]) -> None:
    write_result(tmp_path / "failed", Failure("segmentation", "only one part <moves>", {"tracks": 1.0}))
    text = page(tmp_path / "failed", folders["truth"], folders["seq"], {"axis": {"value": 90.0, "unit": "deg"}})
    assert "segmentation" in text and "only one part &lt;moves&gt;" in text
    assert [set(data) >= {"rgb"} for data in Parsed(text).data] == [True]


def test_page_of_a_truth_and_of_a_sequence_with_its_truth(folders: dict[str, Path]) -> None:
    alone, both = (Parsed(page(*paths)).data for paths in ([folders["truth"]], [folders["seq"], folders["truth"]]))
    assert alone[0]["rgb"] is None and len(alone[0]["labels"]) == N
    assert both[0]["rgb"] is not None and both[0]["truth"]
    assert both[0]["states"] == pytest.approx(make_truth().states.tolist())


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({"value": 0.07377, "unit": "%"}, "0.07 %"),
        ({"value": 0.98765, "unit": "fraction"}, "0.988"),
        ({"value": 31.4159, "unit": "dB"}, "31.4 dB"),
        ({"value": 123.456, "unit": "deg"}, "123°"),
        ({"value": 0.12345, "unit": "N"}, "0.1235 N"),
        (7, "7"),
        (None, "\N{EN DASH}"),
    ],
)
def test_a_score_has_its_unit_and_few_digits(entry, text: str) -> None:
    assert f"<th scope=row>Pose error </th><td class=number>{text}</td>" in score_section({"pose_error": entry}).html


def test_where_an_asset_came_from_is_shown_without_python() -> None:
    source = {
        "method": "ours",
        "length_unit": "m",
        "parts": {"reference": {"faces": 20, "faces_turned_outwards": False, "reason": None}},
        "settings": {"density": 600.0, "up": [0.0, -1.0, 0.0], "meshes": {"texels": 4}},
        "steps": [{"by": "a", "at": 1}],
    }
    assert source_rows(source) == [
        ("method", "ours"),
        ("length unit", "m"),
        ("parts, reference, faces", "20"),
        ("parts, reference, faces turned outwards", "no"),
        ("settings, density", "600"),
        ("settings, up", "0, -1, 0"),
        ("settings, meshes, texels", "4"),
        ("steps", "by a; at 1"),
    ]


def test_cells_of_numbers_are_kept_on_one_line() -> None:
    for text in ("-61.4° to 11.3°", "3.52e-05", "-0.005 m", "10 rad/s", "0.0542 kg"):
        assert table_cell(text).startswith("<td class=number>"), text
    for text in (
        "-0.002, 0.003, -0.005 m",
        "revolute",
        "viscous_damping (coefficient 0.02 N m s/rad)",
        "2 sequences of 3",
        "none",
    ):
        assert table_cell(text).startswith("<td>"), text


@pytest.mark.parametrize("theme", [0, 1])
def test_texts_have_enough_contrast(theme: int) -> None:
    """4.5 or more (WCAG 2.1, 1.4.3) for every text colour on every background, in the light and the dark theme."""
    colours = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})[;\s]", re.findall(r":root \{(.*?)\}", CSS, re.S)[theme]))

    def luminance(colour: str) -> float:
        parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))

    pairs = [(ink, ground) for ink in ("ink", "soft", "accent", "fail") for ground in ("card", "ground")]
    for ink, ground in [*pairs, ("accent", "press")]:
        low, high = sorted((luminance(colours[ink]), luminance(colours[ground])))
        assert (high + 0.05) / (low + 0.05) >= 4.5, (ink, ground)


def test_scores_stand_in_the_page(folders: dict[str, Path]) -> None:
    scores = {"axis": {"value": 1.23456, "unit": "deg", "better": "down", "beside": "4 cm"}, "plain": 0.5, "none": None}
    text = page(folders["result"], scores=scores)
    assert re.search(r"Axis <abbr[^>]*>↓</abbr></th><td class=number>1.23°</td><td class=number>4 cm</td>", text)
    assert_refused("score 'axis'", score_section, {"axis": {"value": 1, "better": "sideways"}})


# ---------------------------------------------------------------- state plot


def test_state_plot_marks_unseen_frames_and_leaves_out_unknown_bands() -> None:
    result = perfect_result(make_truth())
    frames = np.arange(N, dtype=float)
    section = state_section("revolute", frames, False, result.states, result.state_std, result.seen[:, 1])
    (box_,) = re.findall(r'<rect class="unseen" x="([\d.]+)" width="([\d.]+)"', section.html)
    x = section.data["x"]
    assert float(box_[0]) == pytest.approx((x[1] + x[2]) / 2, abs=0.1)
    assert float(box_[0]) + float(box_[1]) == pytest.approx((x[3] + x[4]) / 2, abs=0.1)
    assert section.html.count('class="band"') == 2, "one band on either side of the unknown frames"
    assert section.data["charts"][0][0] == pytest.approx(np.degrees(result.states), rel=1e-3)
    assert not re.search("nan", section.html, re.IGNORECASE)


@pytest.mark.parametrize("states", [np.zeros(1), np.zeros(4), np.full(4, 1e9), np.array([0.0, 1e-12, 0.0, 0.0])])
def test_plot_of_states_that_hardly_move_is_finite(states: np.ndarray) -> None:
    section = state_section("prismatic", np.arange(len(states), dtype=float), True, states)
    assert not re.search(r"nan|inf", section.html)


def test_slider_range_covers_limits_and_states() -> None:
    joint = Joint("j", "revolute", [0, 0, 1], [0, 0, 0], -np.inf, np.inf)
    assert slider_range(joint) == (-np.pi, np.pi)
    assert slider_range(joint, [0.5, 2.0]) == (0.5, 2.0)
    assert slider_range(replace(joint, lower=0.0, upper=1.0), [0.5, 2.0]) == (0.0, 2.0)
    lower, upper = slider_range(replace(joint, lower=1.0, upper=1.0))
    assert lower < 1.0 < upper


# ---------------------------------------------------------------- assets


def test_a_described_asset_is_read_inside_of_the_root_that_is_given(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    tip = '<link name="tip"><visual><geometry><mesh filename="gone.obj"/></geometry></visual></link>'
    joint = '<joint name="t" type="fixed"><parent link="base"/><child link="tip"/></joint>'
    urdf = write_urdf(tmp_path / "asset", body=tip + joint)
    write_asset_json(urdf.parent, Asset(urdf, "hinge", "base", "lid"))
    assert "gone.obj" in page(urdf.parent)
    assert_refused("leads out of the folder .*/other", page, urdf.parent, root=tmp_path / "other")


def test_asset_page_has_a_slider_over_the_limits_and_says_what_acts(tmp_path: Path) -> None:
    text = page(write_asset(tmp_path / "asset"))
    (scene,) = Parsed(text).data
    (slider,) = scene["sliders"]
    assert (slider["lower"], slider["upper"], slider["value"]) == (-0.5, 1.5, 0.25)
    assert "viscous_damping (coefficient 0.02 N m s/rad)" in text and "2.5 kg" in text and "3 N m" in text
    assert "2, 1, 3</td>" in text, "inertia is turned into the link's frame"
    assert [layer["shown"] for layer in scene["layers"] if layer["name"] == "collision shapes"] == [False]


def test_urdf_link_moves_about_its_joint(tmp_path: Path) -> None:
    """The hinge stands at x = 0.1 with its z turned to x, so a quarter turn carries the child's y to world z."""
    scene = asset_scene(read_shown(write_urdf(tmp_path)))
    T = link_poses(scene.links, [np.pi / 2])[-1]
    assert se3.transform(T, [[0, 1, 0], [0, 0, 1], [1, 0, 0]]) == pytest.approx(
        np.array([[0.1, 0, 1], [1.1, 0, 0], [0.1, 1, 0]]), abs=1e-12
    )


def test_mimic_joint_follows_its_leader_and_missing_mesh_is_reported(tmp_path: Path) -> None:
    body = """<link name="tip"><visual><geometry><mesh filename="gone.obj"/></geometry></visual></link>
      <joint name="second" type="prismatic"><parent link="lid"/><child link="tip"/><axis xyz="1 0 0"/>
      <limit lower="0" upper="1"/><mimic joint="hinge" multiplier="-2" offset="0.5"/></joint>"""
    path = write_urdf(tmp_path, body=body)
    scene = asset_scene(read_shown(path))
    assert [slider.name for slider in scene.sliders] == ["hinge"]
    poses = link_poses(scene.links, [0.2])
    assert (se3.inverse(poses[1]) @ poses[2])[:3, 3] == pytest.approx([0.1, 0, 0])
    assert "1 mesh files that thing.urdf names are missing: gone.obj" in page(path)


def test_urdf_faults_are_reported_in_one_line(tmp_path: Path) -> None:
    loop = '<joint name="back" type="fixed"><parent link="lid"/><child link="base"/></joint>'
    cases = {
        loop: "loop",
        '<joint name="x" type="fixed"><parent link="lid"/><child link="nobody"/></joint>': "names link 'nobody'",
        '<link name="z"><visual><geometry><torus/></geometry></visual></link>': "geometry <torus> is unknown",
        '<link name="z"><visual><geometry><box size="1 1"/></geometry></visual></link>': "expected 3 finite numbers",
        '<link name="z"><visual><geometry><mesh filename="../../x.obj"/></geometry></visual></link>': "leads out",
    }
    for i, (body, message) in enumerate(cases.items()):
        assert_refused(message, page, write_urdf(tmp_path / str(i), body=body))


def test_obj_reads_polygons_negative_indices_materials_and_textures(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "t.png"), np.full((4, 4, 3), 128, np.uint8))
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0.5 0\nnewmtl b\nKd 1 1 1\nmap_Kd t.png\n")
    (tmp_path / "o.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\n"
        "usemtl a\nf 1 2 3 4\nusemtl b\nf -4/1 -3/2 -2/3\n"
    )
    plain, textured = read_obj(tmp_path / "o.obj", tmp_path)
    assert plain.mesh.areas().sum() == pytest.approx(1.0)
    assert plain.mesh.colours[0].tolist() == [255, 128, 0] and plain.texture is None
    assert textured.texture == (tmp_path / "t.png").resolve() and textured.uv is not None
    assert textured.uv.tolist() == [[0, 0], [1, 0], [1, 1]] and textured.mesh.vertices[0].tolist() == [0, 0, 0]
    mesh = '<link name="tip"><visual><geometry><mesh filename="o.obj"/></geometry></visual></link>'
    joint = '<joint name="t" type="fixed"><parent link="base"/><child link="tip"/></joint>'
    (scene,) = Parsed(page(write_urdf(tmp_path, body=mesh + joint))).data
    assert [url.partition(",")[0] for url in scene["textures"]] == ["data:image/jpeg;base64"]
    (tmp_path / "m.mtl").write_text("newmtl b\nmap_Kd ../../../etc/hostname\n")
    assert_refused("leads out", read_obj, tmp_path / "o.obj", tmp_path)
    (tmp_path / "bad.obj").write_text("v 0 0 0\nf 1 2 3\n")
    assert_refused("vertex that does not exist", read_obj, tmp_path / "bad.obj", tmp_path)


# ---------------------------------------------------------------- meshes for display


def fine_box(n: int = 60) -> Mesh:
    """A unit box of six grids of n x n squares."""
    u, v = (
        a.reshape(-1) for a in np.meshgrid(np.linspace(-0.5, 0.5, n + 1), np.linspace(-0.5, 0.5, n + 1), indexing="ij")
    )
    i, j = (a.reshape(-1) for a in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a, b, c, d = i * (n + 1) + j, (i + 1) * (n + 1) + j, (i + 1) * (n + 1) + j + 1, i * (n + 1) + j + 1
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    flat = np.stack([u, v, np.full_like(u, 0.5)], -1)
    turns = [[0, 0, 0], [np.pi, 0, 0], [np.pi / 2, 0, 0], [-np.pi / 2, 0, 0], [0, np.pi / 2, 0], [0, -np.pi / 2, 0]]
    vertices = np.concatenate([flat @ se3.exp_so3(turn).T for turn in turns])
    return Mesh(vertices, np.concatenate([faces + k * len(flat) for k in range(6)]))


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def test_simplified_mesh_keeps_planes_edges_and_colours() -> None:
    mesh = fine_box()
    sides = Mesh(mesh.vertices, mesh.faces, np.where(mesh.vertices[:, :1] > 0, 255, 0) * np.ones((1, 3)))
    small = simplified(sides, 5000)
    assert 1000 < len(small.faces) <= 5000 < len(mesh.faces)
    distance = np.abs(np.abs(small.vertices).max(1) - 0.5)
    assert distance.max() < 2e-3, "no vertex leaves the surface of the box, not even at its edges"
    assert volume(small) == pytest.approx(1.0, abs=0.01)
    assert set(np.unique(small.colours)) == {0, 255}
    assert simplified(mesh, len(mesh.faces)) is mesh


def test_primitives_are_closed_and_face_outwards() -> None:
    assert volume(box([1, 2, 3])) == pytest.approx(6)
    assert volume(sphere(1.0)) == pytest.approx(4 / 3 * np.pi, rel=0.03)
    assert volume(cylinder(1.0, 2.0)) == pytest.approx(2 * np.pi, rel=0.02)


def test_large_layers_are_simplified_in_the_page() -> None:
    truth = make_truth()
    big = replace(truth.articulation, reference=fine_box(60))
    data = scene_section(articulation_scene(big, truth.states, truth.Ts_camera_reference), max_faces=3000).data
    assert data["surfaces"][0]["faces"]["shape"][0] <= 3000


# ---------------------------------------------------------------- bad input


def test_unknown_folder_is_answered_with_what_was_looked_for_and_what_is_there(
    tmp_path: Path, folders: dict[str, Path]
) -> None:
    (tmp_path / "notes.txt").write_text("")
    message = assert_refused("", page, tmp_path)
    for word in ("sequence.json", "prediction.json", "truth.json", "asset.json", ".urdf", "notes.txt", "result, seq"):
        assert word in message
    assert "\n" not in message
    (tmp_path / "empty").mkdir()
    for path, line in (
        (tmp_path / "empty", "found nothing"),
        (tmp_path / "none", "does not exist"),
        (tmp_path / "notes.txt", "is a file, expected a URDF"),
    ):
        assert_refused(line, page, path)


def test_things_that_do_not_belong_together_are_refused(tmp_path: Path, folders: dict[str, Path]) -> None:
    write_sequence(tmp_path / "long", make_recording(N + 1), 1e-4)
    with pytest.raises(FreeArtError, match="the sequence has 7 frames, the result has 6 frames"):
        page(folders["result"], sequence=tmp_path / "long")


# ---------------------------------------------------------------- the scripts


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_scripts_move_links_as_the_library_does() -> None:
    rng = np.random.default_rng(5)
    unit = rng.normal(size=(2, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    links = [
        Link(-1, se3.exp_se3(rng.normal(size=6))),
        Link(0, se3.exp_se3(rng.normal(size=6)), Joint("a", "revolute", unit[0], [0.3, -0.2, 0.5], -9, 9), 0),
        Link(1, se3.exp_se3(rng.normal(size=6)), Joint("b", "prismatic", unit[1], [0, 0, 0], -9, 9), 1, -2.0, 0.3),
    ]
    values = [2.1, -0.4]
    camera = Camera(np.array([[500.0, 0, 310], [0, 480, 170], [0, 0, 1]]), 640, 360)
    given = embed_json(
        {
            "links": [
                {"parent": k.parent, "T": k.T_parent_link, "slider": k.slider, "scale": k.scale, "offset": k.offset}
                | {"joint": k.joint and {"type": k.joint.type, "axis": k.joint.axis, "pivot": k.joint.pivot}}
                for k in links
            ],
            "values": values,
            "camera": {"K": camera.K, "width": 640, "height": 360},
        }
    )
    code = f"""const K = require({json.dumps(str(STATIC / "kinematics.js"))}); const d = {given};
      console.log(JSON.stringify([K.linkPoses(d.links, d.values), K.pinhole(d.camera, 640 / 360, 0.1, 10)]))"""
    run = subprocess.run(["node", "-e", code], capture_output=True, text=True, timeout=60, check=True)
    poses, projection = json.loads(run.stdout)
    assert np.array(poses).reshape(-1, 4, 4) == pytest.approx(np.stack(link_poses(links, values)), abs=1e-12)
    point = np.array([0.1, -0.05, 0.7])
    x, y, _, w = np.array(projection).reshape(4, 4) @ [*(point * [1, -1, -1]), 1.0]
    assert [(x / w + 1) * 320, (1 - y / w) * 180] == pytest.approx(camera.project(point), abs=1e-9)


@pytest.mark.skipif(not CHROMIUM, reason="needs chromium")
def test_page_comes_to_life_in_a_browser(tmp_path: Path, folders: dict[str, Path]) -> None:
    """A deep link sets frame and state; no script fails and nothing is refused by the page's own policy."""
    write_page(folders["result"], tmp_path / "page.html", folders["truth"], folders["seq"])
    with browser() as chrome:
        chrome.open((tmp_path / "page.html").as_uri() + "#frame=4&state=-0.5&parts=beside")
        chrome.run("document.querySelector('.view canvas').focus()")
        chrome.press("ArrowRight")  # turns the 3D view, not the video
        texts = chrome.run("[...document.querySelectorAll('output')].map((o) => o.textContent)")
        legends = chrome.run("[...document.querySelectorAll('.legend li')].map((li) => li.textContent)")
        assert not chrome.errors
    assert "frame 4 · 0.40 s · -19.5°" in texts, "the player is at frame 4, with its state"
    assert f"{np.degrees(-0.5):.1f}°" in texts, "the slider is at the state of the link"
    assert texts.count("-19.5") == 2, "estimate and truth in the plot"
    assert legends.count("moving part 0") == 2, "a perfect result has no joint residual"
    assert "true axis" in legends
