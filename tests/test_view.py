"""A page holds what it shows, loads nothing, runs nothing that came with the data, and comes to life in a browser."""

import base64
import hashlib
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from browser import CHROMIUM, browser
from page_data import (
    HOSTILE,
    N,
    Parsed,
    extract_array,
    make_recording,
    make_truth,
    perfect_result,
    write_asset,
    write_urdf,
)
from refusal import assert_refused

from freeart21 import se3
from freeart21.files.benchmark import write_benchmark
from freeart21.files.gaussians import write_gaussians
from freeart21.files.result import write_result
from freeart21.files.sequence import write_sequence
from freeart21.files.truth import write_truth
from freeart21.gaussians import Gaussians
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure
from freeart21.view import page
from freeart21.view.asset_scene import asset_scene
from freeart21.view.link_shapes import of_trimesh, read_shown
from freeart21.view.plots import state_section
from freeart21.view.scene import link_poses, simplified, sources_scene
from freeart21.view.source import Source, align_truth, matched
from freeart21.view.tables import score_section, source_rows


def make_gaussians(n: int) -> Gaussians:
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(n, 4))
    arrays = (
        rng.uniform(-0.1, 0.1, (n, 3)),
        turns / np.linalg.norm(turns, axis=1, keepdims=True),
        np.full((n, 3), 0.01),
        np.full(n, 0.9),
        rng.uniform(0, 1, (n, 3)),
        np.arange(n) % 2,
        np.tile([0, 0, 1], (n, 1)),
    )
    return Gaussians(*(a.astype(np.float32) for a in arrays))


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Path:
    folder, truth = tmp_path_factory.mktemp("view"), make_truth()
    write_sequence(folder / "sequence", make_recording(), 1e-4)
    write_truth(folder / "truth", truth, 0)
    write_result(folder / "result", perfect_result(truth))
    write_result(folder / "with_gaussians", replace(perfect_result(truth), appearance=make_gaussians(50)))
    write_result(folder / "failed", Failure("segmentation", "only one part <moves>", {"tracks": 1.0}))
    write_asset(folder / "asset")
    write_gaussians(folder / "chair.ply", make_gaussians(80))
    for half, path in (("sequences", "sequence"), ("truth", "truth")):
        (folder / "data" / half).mkdir(parents=True)
        (folder / path).rename(folder / "data" / half / "a")
        (folder / path).symlink_to(folder / "data" / half / "a")
    write_benchmark(folder / "data", "toys", "1", "public")
    return folder


KINDS = {
    "sequence": ("Recording", "48 x 32 pixels", "CC-BY-4.0"),
    "truth": ("True joint", "revolute", "motion, name", "tumble"),
    "result": ("Warnings", "Angle between the axes: 0.00°", "2.50 s", "wrote no diagnostics"),
    "with_gaussians": ("Warnings",),
    "failed": ("segmentation", "only one part &lt;moves&gt;"),
    "asset": ("viscous_damping (coefficient 0.02 N m s/rad)", "2.5 kg", "3 N m", "2, 1, 3", "by hand"),
    "chair.ply": ("80 Gaussians", "Of the moving part"),
    "data": ("1 sequence", "6 frames", "Viewpoints covered"),
}
"""Every kind of page, with words that it has."""
COLOURED = """() => {
  const canvas = document.querySelector('.stage canvas'), { width, height } = canvas;
  const data = canvas.getContext('2d').getImageData(0, 0, width, height).data;
  return data.filter((value, i) => i % 4 === 0 && Math.abs(value - data[i + 2]) > 40).length;
}"""
"""How many pixels of the video's canvas are coloured."""


def page_of(world: Path, kind: str) -> str:
    inputs = {"truth": world / "truth", "sequence": world / "sequence"} if kind in ("result", "failed") else {}
    return page(world / kind, **inputs)


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_says_what_it_should_loads_nothing_and_runs_its_own_script_only(world: Path, kind: str) -> None:
    text = page_of(world, kind)
    parsed = Parsed(text)
    assert not [words for words in KINDS[kind] if words not in text]
    assert text == page_of(world, kind), "the same bytes for the same input"
    for name, value in parsed.attributes:
        if name in ("src", "href", "action", "data", "poster", "srcset"):
            assert value.startswith("data:") or value == "#main", f"{name}={value[:60]}"
    assert not re.search(r"https?:|@import|url\(", text)
    policy = next(value for name, value in parsed.attributes if name == "content" and "default-src" in value)
    (script,) = [text for is_data, text in parsed.scripts if not is_data]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert policy.startswith(
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    )


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


def test_frames_and_labels_of_the_video_are_those_of_the_files(world: Path) -> None:
    video = Parsed(page_of(world, "result")).data[0]
    assert video["frames"] == list(range(N)) and video["times_s"] == pytest.approx([i / 10 for i in range(N)])
    estimate, truth, given = video["sources"]
    mask = make_truth().part_mask(2)

    def decode(url: str) -> np.ndarray:
        return cv2.imdecode(np.frombuffer(base64.b64decode(url.split(",")[1]), np.uint8), cv2.IMREAD_UNCHANGED)

    for source, expected in ((estimate, mask), (truth, mask), (given, 2 * (mask > 0))):
        assert np.array_equal(decode(source["labels"][2]) / 100, expected)
    for i, url in enumerate(video["rgb"]):
        assert abs(float(decode(url).mean()) - (20 * i + 40)) < 2, "frames must be in order"
    line, true = (np.array(source["axis"][1]).reshape(2, 2) for source in (estimate, truth))
    across = np.array([line[0, 1] - line[1, 1], line[1, 0] - line[0, 0]]) / np.linalg.norm(line[1] - line[0])
    assert (true - line[0]) @ across == pytest.approx(np.zeros(2), abs=0.3), "one line, to a tenth of a pixel each"
    assert (true[1] - true[0]) @ (line[1] - line[0]) > 0, "and one direction, though this result's axis is turned"


def test_meshes_and_gaussians_of_a_result_are_shown_as_they_are(world: Path) -> None:
    scene = next(data for data in Parsed(page(world / "with_gaussians")).data if "surfaces" in data)
    result = perfect_result(make_truth())
    meshes = result.articulation.reference, result.articulation.moving
    for surface, mesh in zip(scene["surfaces"], meshes, strict=False):
        step = np.ptp(mesh.vertices, 0) / 65535
        assert (np.abs(extract_array(surface["vertices"]) - mesh.vertices) <= 0.5001 * step).all()
        assert np.array_equal(extract_array(surface["faces"]), mesh.faces)
        assert np.array_equal(extract_array(surface["colours"]), mesh.colours)
    assert scene["sliders"][0]["states"] == pytest.approx(result.states.tolist())
    packed, given = scene["gaussians"], make_gaussians(50)
    assert np.array_equal(extract_array(packed["means"]), given.means)
    assert np.array_equal(extract_array(packed["part_weights"]), 255 * given.part_weights)


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("joint_type", ["revolute", "prismatic"])
def test_truth_lies_exactly_over_a_perfect_result(joint_type: str, sign: float, swap: bool) -> None:
    truth = make_truth(joint_type)
    result = perfect_result(truth, sign=sign)
    result = matched(result.exchanged() if swap else result, truth)
    poses = result.Ts_camera_reference
    estimate = Source("estimate", articulation=result.articulation, states=result.states, Ts_camera=poses)
    over = align_truth(truth, result, estimate)
    assert np.abs(over.states_of_first - result.states).max() < 1e-9
    scene = sources_scene([estimate, over])
    reference, moving = (next(s for s in scene.surfaces if s.layer == k) for k in (3, 4))
    for i, state in enumerate(result.states):
        poses = link_poses(scene.links, [state])
        for surface, mesh, T in (
            (reference, truth.articulation.reference, truth.Ts_camera_reference[i]),
            (moving, truth.articulation.moving, truth.Ts_camera_moving[i]),
        ):
            drawn = se3.transform(result.Ts_camera_reference[i] @ poses[surface.link], surface.mesh.vertices)
            assert np.abs(drawn - se3.transform(T, mesh.vertices)).max() < 1e-9
    other = make_truth("prismatic" if joint_type == "revolute" else "revolute")
    scene = sources_scene([estimate, over, align_truth(other, result, estimate)])
    assert [s.type for s in scene.sliders] == [truth.articulation.joint.type, other.articulation.joint.type]


def test_links_of_an_asset_move_about_their_joints_and_missing_meshes_are_named(tmp_path: Path) -> None:
    """The hinge stands at x = 0.1 with its z turned to x, so a quarter turn carries the child's y to world z."""
    body = """<link name="tip"><visual><geometry><mesh filename="gone.obj"/></geometry></visual></link>
      <joint name="second" type="prismatic"><parent link="lid"/><child link="tip"/><axis xyz="1 0 0"/>
      <limit lower="0" upper="1"/><mimic joint="hinge" multiplier="-2" offset="0.5"/></joint>"""
    scene = asset_scene(read_shown(write_urdf(tmp_path, body=body)))
    assert [(slider.name, slider.lower, slider.upper) for slider in scene.sliders] == [("hinge", -0.5, 1.5)]
    T = link_poses(scene.links, [np.pi / 2])[1]
    expected = np.array([[0.1, 0, 1], [1.1, 0, 0], [0.1, 1, 0]])
    assert se3.transform(T, [[0, 1, 0], [0, 0, 1], [1, 0, 0]]) == pytest.approx(expected, abs=1e-12)
    poses = link_poses(scene.links, [0.2])
    assert (se3.inverse(poses[1]) @ poses[2])[:3, 3] == pytest.approx([0.1, 0, 0]), "a mimic joint follows its leader"
    assert "1 mesh files that thing.urdf names are missing: gone.obj" in page(tmp_path / "thing.urdf")


def test_scores_have_their_unit_and_few_digits_and_sources_are_flat() -> None:
    given = {
        "a": (0.07377, "%"),
        "b": (0.98765, "fraction"),
        "c": (123.456, "deg"),
        "d": (0.12345, "N"),
        "e": (None, "m"),
    }
    html = score_section({name: {"value": v, "unit": unit} for name, (v, unit) in given.items()}).html
    assert [re.sub("<.*?>", " ", row).split()[1:] for row in html.split("<tr>")[1:]] == [
        ["0.07", "%"],
        ["0.988"],
        ["123°"],
        ["0.1235", "N"],
        ["\N{EN DASH}"],
    ]
    source = {"length_unit": "m", "parts": {"reference": {"solid": False, "reason": None}}, "up": [0.0, -1.0]}
    assert source_rows(source) == [("length unit", "m"), ("parts, reference, solid", "no"), ("up", "0, -1")]


def test_a_plot_breaks_where_nothing_is_known_and_a_mesh_is_simplified_with_its_colours() -> None:
    result = perfect_result(make_truth())
    source = Source("a&b", articulation=result.articulation, states=result.states, state_std=result.state_std)
    section = state_section([source], np.arange(N, dtype=float), False, result.seen[:, 1])
    assert section.html.count('class="unseen"') == 1 and section.html.count('class="band"') == 2
    for states in (np.zeros(1), np.full(4, 1e9), np.full(3, np.nan)):
        x = np.arange(len(states), dtype=float)
        assert not re.search(r"nan|inf", state_section([replace(source, states=states, state_std=None)], x, True).html)
    ball = of_trimesh(trimesh.creation.uv_sphere(1.0))
    both = Mesh(ball.vertices, ball.faces, np.where(ball.vertices[:, :1] > 0, 255, 0) * np.ones((1, 3), np.uint8))
    small = simplified(both, 300)
    assert len(small.faces) <= 300 and set(np.unique(small.colours)) == {0, 255}
    assert np.abs(np.linalg.norm(small.vertices, axis=1) - 1).max() < 0.1


def test_what_cannot_be_shown_is_answered_in_one_line(tmp_path: Path, world: Path) -> None:
    (tmp_path / "notes.txt").write_text("")
    for word in ("sequence.json", "prediction.json", "truth.json", "asset.json", ".urdf", "notes.txt"):
        assert_refused(re.escape(word), page, tmp_path)
    write_sequence(tmp_path / "long", make_recording(N + 1), 1e-4)
    assert_refused("sequence has 7 frames, the result has 6", page, world / "result", sequence=tmp_path / "long")
    body = '<link name="z"><visual><geometry><mesh filename="../../x.obj"/></geometry></visual></link>'
    assert_refused("leads out", page, write_urdf(tmp_path / "out", body=body))


@pytest.mark.skipif(not CHROMIUM, reason="needs chromium")
def test_every_page_comes_to_life_in_a_browser(tmp_path: Path, world: Path) -> None:
    """No script fails, nothing is refused by the page's own policy, no page is wider than the screen."""
    with browser() as chrome:
        for kind in KINDS:
            file = tmp_path / f"{kind}.html"
            file.write_text(page_of(world, kind))
            for width in (400, 1280):
                chrome.open(file, width)
                assert chrome.run("document.documentElement.scrollWidth") <= width, (kind, width)
                assert not chrome.errors, (kind, chrome.errors)
        chrome.open((tmp_path / "result.html").as_uri() + "#frame=4&state=-0.5")
        chrome.run("document.querySelector('.view canvas').focus()")
        chrome.press("ArrowRight")  # turns the 3D view, not the video
        texts = chrome.run("[...document.querySelectorAll('output')].map((o) => o.textContent)")
        assert "frame 4 · 0.40 s · -19.5°" in texts, "the player is at frame 4, with its state"
        assert f"{np.degrees(-0.5):.1f}°" in texts, "the slider is at the state of the link"
        assert texts.count("-19.5") == 2, "estimate and truth in the plot"
        view = f"({COLOURED})()"
        coloured = chrome.run(f"new Promise((done) => setTimeout(() => done({view}), 300))")
        assert coloured > 100, "parts are drawn over the grey video"
        chrome.open(tmp_path / "data.html")
        chrome.run("document.querySelector('.sortable thead button').click()")
        assert chrome.run("document.querySelector('th[aria-sort]').ariaSort") == "ascending" and not chrome.errors
