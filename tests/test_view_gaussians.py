"""The 3D view draws Gaussians as the formulas say, moved by the slider, lit as the video's frame, and in order."""

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from browser import CHROMIUM, Browser, browser
from gaussian_reference import spherical_harmonics
from page_data import extract_array
from refusal import assert_refused

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files.gaussians import write_gaussians
from freeart21.files.result import write_result
from freeart21.gaussians import FAINT_COPY, TURNED_AWAY, Gaussians
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.view import page
from freeart21.view.document import document, embed_json
from freeart21.view.pages import write_page
from freeart21.view.parts import articulation_scene, exchanged
from freeart21.view.scene import Scene, scene_section
from freeart21.view.simplify import box
from freeart21.view.splats import MAX_SPLATS, SplatLayers, largest_gaussians, splat_data

STATIC = Path(__file__).resolve().parents[1] / "freeart21" / "view" / "static"
CAMERA = Camera(np.array([[400.0, 0, 165], [0, 390, 85], [0, 0, 1]]), 320, 180)
JOINT = Joint("lid", "revolute", [0.0, 0.6, 0.8], [0.01, -0.02, 0.0], -1.0, 1.0)
STATES = np.array([0.0, 0.4, 0.8])


def make_gaussians(n: int, seed: int = 0, light: int | None = 25) -> Gaussians:
    rng = np.random.default_rng(seed)
    normals, quaternions = rng.normal(size=(n, 3)), rng.normal(size=(n, 4))
    terms = None if light is None else rng.normal(0, 0.4, (light, 3)).astype(np.float32)
    if terms is not None:
        terms[0] = 2.5
    arrays = (
        rng.uniform(-0.05, 0.05, (n, 3)),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        np.exp(rng.uniform(np.log(0.0002), np.log(0.02), (n, 3))),
        rng.uniform(0.3, 1, n),
        rng.uniform(0.1, 0.9, (n, 3)),
        rng.choice([0, 0.3, 0.6, 1], n),
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
    )
    return Gaussians(*(a.astype(np.float32) for a in arrays), light=terms)


def camera_poses() -> np.ndarray:
    return se3.pose(np.eye(3), [0, 0, 0.4]) @ se3.exp_se3(
        np.random.default_rng(1).normal(0, [0.01] * 3 + [0.5] * 3, (3, 6))
    )


def made_scene(gaussians: Gaussians | None, camera: Camera | None = CAMERA) -> Scene:
    parts = Articulation(
        JOINT, box([0.08, 0.06, 0.01]), box([0.08, 0.06, 0.01]).moved(se3.pose(np.eye(3), [0, 0, 0.02]))
    )
    return articulation_scene(parts, STATES, camera_poses(), camera, gaussians)


def draw_slowly(gaussians: Gaussians, Ts_camera_part: list[np.ndarray], camera: Camera) -> np.ndarray:
    """(height, width, 3) 0 to 255, before black: pixel by pixel, as the formulas stand in the papers."""
    copies = []
    for moved, T in enumerate(Ts_camera_part):
        R = T[:3, :3]
        means, turns = se3.transform(T, gaussians.means), R @ se3.rotation_from_wxyz(gaussians.quaternions)
        covariances = turns @ (gaussians.scales.astype(float)[..., None] ** 2 * np.swapaxes(turns, 1, 2))
        colours = gaussians.colours.astype(float)
        if gaussians.light is not None:
            colours = colours * (spherical_harmonics(gaussians.normals @ R.T, len(gaussians.light)) @ gaussians.light)
        shares = 1 - gaussians.part_weights if moved else gaussians.part_weights
        opacities = gaussians.opacities * shares
        facing = -((gaussians.normals @ R.T) * means).sum(1) / np.linalg.norm(means, axis=1)
        shown = (opacities > FAINT_COPY) & ((facing > TURNED_AWAY) | (gaussians.light is None))
        rows = [a[shown] for a in (means, covariances, colours.clip(0, 1), opacities)]
        copies += list(zip(*rows, strict=True))
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    picture = np.zeros((camera.height, camera.width, 3))
    (fx, _, _), (_, fy, _), _ = camera.K
    for (x, y, z), cov, colour, opacity in sorted(copies, key=lambda copy: -copy[0][2]):
        J = np.array([[fx / z, 0, -fx * x / z**2], [0, fy / z, -fy * y / z**2]])
        inverse = np.linalg.inv(J @ cov @ J.T + 0.3 * np.eye(2))
        d = np.stack([u, v], -1) - camera.project(np.array([x, y, z]))
        alpha = np.minimum(0.999, opacity * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", d, inverse, d)))[..., None]
        picture = np.where(alpha < 1 / 255, picture, (1 - alpha) * picture + alpha * colour)
    return 255 * picture


# ---------------------------------------------------------------- what stands in the page


def test_a_page_holds_the_gaussians_of_a_result(tmp_path):
    scene, given = made_scene(None), make_gaussians(300)
    assert scene.splats is None and scene_section(scene).data["gaussians"] is None
    poses = camera_poses()
    result = Reconstruction(
        Articulation(JOINT, box([0.1, 0.1, 0.1]), box([0.1, 0.1, 0.1])),
        STATES,
        poses,
        poses @ JOINT.transform(STATES),
        np.zeros((3, 18, 32), np.uint8),
        np.ones((3, 2), bool),
        appearance=given,
    )
    write_result(tmp_path / "result", result)
    text = page(tmp_path / "result")
    data = json.loads(next(t for t in text.split('<script type="application/json">') if '"sliders"' in t).split("<")[0])
    packed = data["gaussians"]
    means = np.array(packed["low"]) + extract_array(packed["means"]) / 65535 * (
        np.array(packed["high"]) - packed["low"]
    )
    assert np.abs(means - given.means).max() < 1e-6
    least, most = packed["scales_between"]
    scales = np.exp(least + (most - least) * extract_array(packed["scales"]) / 255)
    assert np.abs(scales / given.scales - 1).max() < 0.01
    turned = extract_array(packed["quaternions"]).astype(float) - 128
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    assert np.degrees(2 * np.arccos(np.abs((turned * given.quaternions).sum(1)).clip(0, 1))).max() < 1
    assert np.abs(extract_array(packed["colours"]) / 255 - given.colours).max() < 0.002
    assert np.abs(extract_array(packed["part_weights"]) / 255 - given.part_weights).max() < 0.002
    assert np.array(packed["light"]) == pytest.approx(given.light)
    (tmp_path / "result" / "gaussians.ply").write_bytes(b"ply\n")
    spoilt = page(tmp_path / "result")
    assert "The Gaussians cannot be shown: " in spoilt and '"gaussians":null' in spoilt
    other = exchanged(result).appearance
    assert np.array_equal(other.part_weights, 1 - given.part_weights)


def test_a_page_of_very_many_gaussians_keeps_those_that_cover_most():
    given = make_gaussians(MAX_SPLATS + 5000, light=9)
    faint = np.arange(len(given)) % 25 == 3
    given = replace(given, opacities=np.where(faint, 1e-6, given.opacities).astype(np.float32))
    chosen = largest_gaussians(given, MAX_SPLATS)
    assert len(chosen) == MAX_SPLATS and (chosen.opacities < 1e-5).sum() < faint.sum()
    assert np.abs(np.sort(chosen.means[:, 0])[0] - np.sort(given.means[:, 0])[0]) < 1e-2
    assert largest_gaussians(chosen, MAX_SPLATS) is chosen
    section = scene_section(made_scene(given))
    assert f"the {MAX_SPLATS:,} largest of {len(given):,} Gaussians" in section.html
    assert "Gaussians" not in scene_section(made_scene(chosen)).html
    assert len(embed_json(splat_data(SplatLayers(given, (0, 1), (0, 1))))) < 2.4e6


def test_one_gaussian_and_gaussians_in_one_place_stand_in_a_page():
    one = make_gaussians(1)
    same = replace(make_gaussians(4), means=np.ones((4, 3), np.float32), scales=np.ones((4, 3), np.float32))
    for given in (one, same):
        text = embed_json(splat_data(SplatLayers(given, (0, 1), (0, 1))))
        assert "null" not in text
    none = Gaussians(*(np.zeros((0, k)[: 1 + (k > 0)], np.float32) for k in (3, 4, 3, 0, 3, 0, 3)))
    assert made_scene(none).splats is None, "nothing to choose between"


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_script_sorts_from_the_farthest_and_keeps_copies_apart():
    given = make_gaussians(500)
    data = splat_data(SplatLayers(given, (0, 1), (0, 1)))
    views = [se3.exp_se3([0.1, 0, 0.3, 0.2, 0.5, 1.0]), se3.exp_se3([0, 0.2, -0.5, 1.2, 0.1, 0.3])]
    code = f"""const S = require({json.dumps(str(STATIC / "splats.js"))}); const d = {embed_json(data)};
      const kinds = {{ f32: Float32Array, u16: Uint16Array, u8: Uint8Array }};
      const array = (a) => new kinds[a.dtype](Uint8Array.from(Buffer.from(a.base64, "base64")).buffer);
      const s = S.unpack(d, array), n = s.copies.length, order = new Uint32Array(n);
      const views = {json.dumps([view.ravel().tolist() for view in views])};
      const room = {{ depths: new Float32Array(n), kept: new Uint32Array(n), counts: new Uint32Array(65537) }};
      const sorted = (shown) => [...order.slice(0, S.sort(s, views, shown, order, room))];
      const both = sorted([true, true]), moved = sorted([false, true]);
      console.log(JSON.stringify({{ both, moved, shapes: [...s.shapes] }}))"""
    run = subprocess.run(["node", "-e", code], capture_output=True, text=True, timeout=60, check=True)
    reply = json.loads(run.stdout)
    order, shapes = np.array(reply["both"]), np.array(reply["shapes"]).reshape(-1, 16)
    expected = [2 * i for i in range(500) if given.part_weights[i] > 0.02]
    expected += [2 * i + 1 for i in range(500) if given.part_weights[i] < 0.98]
    assert sorted(order.tolist()) == sorted(expected)
    assert sorted(reply["moved"]) == sorted(copy for copy in expected if copy % 2)
    depths = np.stack([se3.transform(view, given.means)[:, 2] for view in views], -1).ravel()[order]
    assert (np.diff(depths) > -2e-4).all(), "an eye looks along -z: the farthest comes first"
    turns = se3.rotation_from_wxyz(given.quaternions)
    covariances = turns @ (given.scales[..., None] ** 2 * np.swapaxes(turns, 1, 2))
    upper = covariances[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    assert np.abs(shapes[:, 4:10] - upper).max() < 0.03 * upper.max()
    assert ((shapes[:, 12:15] * given.normals).sum(1) > 0.9999).all()


# ---------------------------------------------------------------- in a browser

needs_browser = pytest.mark.skipif(not CHROMIUM, reason="needs chromium")
SHOWN = "!!document.querySelector('.view canvas')"


@pytest.fixture(scope="module")
def chrome():
    with browser() as one:
        yield one


def shot(chrome: Browser) -> np.ndarray:
    """(height, width, 3) RGB of the 3D view alone, before black."""
    chrome.run(
        "(({ style }) => Object.assign(style, { width: '320px', height: '180px', background: '#000', border: '0', "
        "borderRadius: '0', aspectRatio: 'auto' }))(document.querySelector('.view'))"
    )
    chrome.run("document.querySelector('.corner').style.visibility = 'hidden'")
    chrome.run("new Promise((done) => setTimeout(() => requestAnimationFrame(() => requestAnimationFrame(done)), 150))")
    x, y = chrome.run("(({ left, top }) => [left, top])(document.querySelector('.view').getBoundingClientRect())")
    image = cv2.imdecode(np.frombuffer(chrome.picture(), np.uint8), cv2.IMREAD_COLOR)
    return image[round(y) : round(y) + 180, round(x) : round(x) + 320, ::-1].astype(float)


def press(chrome: Browser, text: str) -> None:
    chrome.run(f"[...document.querySelectorAll('button')].find((b) => b.textContent.includes({text!r})).click()")


def show(chrome: Browser, path: Path, scene: Scene, link: str) -> None:
    path.write_text(document("gaussians", [scene_section(scene)]))
    chrome.open(f"{path.resolve().as_uri()}#{link}", ready=SHOWN)


@needs_browser
@pytest.mark.parametrize("terms", [None, 1, 25])
def test_pixels_are_those_of_the_formulas(chrome, tmp_path, terms):
    """Through the video's camera in frame 2, at a state of the slider that is not that frame's."""
    given, state = make_gaussians(150, light=terms), -0.35
    show(chrome, tmp_path / "a.html", made_scene(given), f"frame=2&state={state}&view=video&show=part")
    T = camera_poses()[2]
    expected = draw_slowly(given, [T, T @ JOINT.transform(state)], CAMERA)
    assert expected.max() > 100 and (expected.max(-1) > 20).mean() > 0.1, "there is something to see"
    difference = np.abs(shot(chrome) - expected)
    assert difference.mean() < 0.5 and np.percentile(difference, 99.9) < 8, (difference.mean(), difference.max())
    assert not chrome.errors


@needs_browser
def test_the_nearer_one_hides_the_other_from_either_side(chrome, tmp_path):
    """A red one before a blue one, seen by the orbit's eye, and half a turn on."""
    two = Gaussians(
        np.array([[0, 0, -0.03], [0, 0, 0.03]], np.float32),
        np.array([[1, 0, 0, 0]] * 2, np.float32),
        np.full((2, 3), 0.02, np.float32),
        np.full(2, 0.99, np.float32),
        np.array([[1, 0, 0], [0, 0, 1]], np.float32),
        np.ones(2, np.float32),
        np.array([[1, 0, 0], [1, 0, 0]], np.float32),
    )
    scene = replace(made_scene(two), up=np.array([0.0, -1, 0]), towards_viewer=np.array([0.0, 0, -1]))
    middles = []
    for yaw in (0.0001, np.pi):
        show(chrome, tmp_path / f"{yaw:.0f}.html", scene, f"yaw={yaw}&show=part")
        middles.append(shot(chrome)[80:100, 150:170].mean((0, 1)))
    assert middles[0][0] > 200 > 30 > middles[0][2] and middles[1][2] > 200 > 30 > middles[1][0], middles


@needs_browser
def test_a_disc_shows_its_outer_face_alone(chrome, tmp_path):
    """A red disc that faces the eye and a blue one that faces away; and both, where without light no face is outer."""
    two = Gaussians(
        np.array([[-0.03, 0, 0], [0.03, 0, 0]], np.float32),
        np.array([[1, 0, 0, 0]] * 2, np.float32),
        np.array([[0.02, 0.02, 0.001]] * 2, np.float32),
        np.full(2, 0.99, np.float32),
        np.array([[1, 0, 0], [0, 0, 1]], np.float32),
        np.array([1, 0], np.float32),
        np.array([[0, 0, -1], [0, 0, 1]], np.float32),
    )
    light = np.full((1, 3), np.sqrt(4 * np.pi), np.float32)
    seen = []
    for yaw, terms in ((0.0001, light), (np.pi, light), (0.0001, None)):
        scene = made_scene(replace(two, light=terms))
        scene = replace(scene, up=np.array([0.0, -1, 0]), towards_viewer=np.array([0.0, 0, -1]))
        show(chrome, tmp_path / f"{yaw:.0f}-{terms is None}.html", scene, f"yaw={yaw}&show=part&state=0")
        picture = shot(chrome)
        seen.append([bool((picture[..., k] - picture[..., 2 - k] > 150).sum() > 200) for k in (0, 2)])
    assert seen == [[True, False], [False, True], [True, True]], "red, blue"
    assert not chrome.errors


@needs_browser
def test_the_reader_chooses_between_gaussians_and_surfaces(chrome, tmp_path):
    given = replace(make_gaussians(200, light=None), part_weights=(np.arange(200) % 2).astype(np.float32))
    show(chrome, tmp_path / "a.html", made_scene(given), "state=0.4&view=video&show=part")
    first = shot(chrome)
    press(chrome, "Surfaces")
    surfaces = shot(chrome)
    assert np.abs(surfaces - first).mean() > 5
    press(chrome, "Gaussians")
    assert np.abs(shot(chrome) - first).max() < 3, "and back"
    press(chrome, "moving part")
    T = camera_poses()[0]
    still = given.part_weights == 1
    half = given.chosen(still)
    difference = np.abs(shot(chrome) - draw_slowly(half, [T, T], CAMERA))
    assert difference.mean() < 1 and np.percentile(difference, 99.5) < 8, "the moving part's are hidden"
    press(chrome, "moving part")
    press(chrome, "Part colours")
    tinted = shot(chrome)
    assert np.abs(tinted - first).mean() > 5
    show(chrome, tmp_path / "b.html", made_scene(given), "state=0.4&view=video&show=part&look=surfaces")
    assert np.abs(shot(chrome) - surfaces).max() < 3, "a link chooses, too"
    show(chrome, tmp_path / "c.html", made_scene(None), "state=0.4&view=video&show=part&look=gaussians")
    assert np.abs(shot(chrome) - surfaces).max() < 3 and not chrome.run("!!document.querySelector('.panel .choice')")
    assert not chrome.errors


@needs_browser
def test_gaussians_are_shown_where_there_are_no_surfaces(chrome, tmp_path):
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    scene = articulation_scene(
        Articulation(JOINT, nothing, nothing), STATES, camera_poses(), None, make_gaussians(60, light=9)
    )
    show(chrome, tmp_path / "a.html", scene, "")
    assert chrome.run("[...document.querySelectorAll('.layers button')].map((b) => b.textContent)") == [
        "reference part",
        "moving part",
        "joint axis",
    ]
    assert (shot(chrome).max(-1) > 40).mean() > 0.05, "they fill a part of the view"
    assert not chrome.errors


def test_a_file_of_gaussians_is_a_page_of_its_own(tmp_path):
    write_gaussians(
        tmp_path / "chair.ply", replace(make_gaussians(80, light=None), part_weights=np.ones(80, np.float32))
    )
    write_page(tmp_path / "chair.ply", tmp_path / "chair.html")
    whole = (tmp_path / "chair.html").read_text()
    assert "80 Gaussians" in whole and "Of the moving part" not in whole
    write_gaussians(tmp_path / "gaussians.ply", make_gaussians(80, light=9))
    write_page(tmp_path / "gaussians.ply", tmp_path / "parted.html")
    assert "Of the moving part" in (tmp_path / "parted.html").read_text()
    with pytest.raises(FreeArtError, match="without a truth"):
        write_page(tmp_path / "chair.ply", tmp_path / "no.html", truth=tmp_path / "truth")
    write_gaussians(tmp_path / "none.ply", make_gaussians(0, light=None))
    assert_refused("has no Gaussians", write_page, tmp_path / "none.ply", tmp_path / "no.html")
    (tmp_path / "mesh.ply").write_text("ply\nformat ascii 1.0\nend_header\n")
    assert_refused("mesh.ply", write_page, tmp_path / "mesh.ply", tmp_path / "no.html")
    assert not (tmp_path / "no.html").exists()


def test_strays_do_not_coarsen_the_places_of_the_others():
    given = make_gaussians(100, light=None)
    given = replace(given, means=np.concatenate([np.full((1, 3), 1e4, np.float32), given.means[1:]]))
    data = splat_data(SplatLayers(given, (0, 0), (0, 0)))
    assert data["means"]["dtype"] == "f32"
