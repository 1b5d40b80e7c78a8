"""The 3D view draws Gaussians as the formulas say, moved by the slider, lit as the video's frame, and in order."""

import cv2
import numpy as np
import pytest
from browser import CHROMIUM, Browser, browser
from gaussian_reference import spherical_harmonics
from page_data import box

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.camera import Camera
from freeart21.gaussians import FAINT_COPY, TURNED_AWAY, Gaussians
from freeart21.joint import Joint
from freeart21.view.document import document
from freeart21.view.scene import Scene, scene_section, sources_scene
from freeart21.view.source import LAYERS, Source

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
    source = Source("", articulation=parts, states=STATES, Ts_camera=camera_poses(), layers=LAYERS)
    return sources_scene([source], camera, gaussians)


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


@pytest.mark.skipif(not CHROMIUM, reason="needs chromium")
def test_pixels_are_those_of_the_formulas_and_surfaces_can_be_chosen(tmp_path):
    """Through the video's camera in frame 2, at a state of the slider that is not that frame's."""
    given, state = make_gaussians(150, light=25), -0.35
    T = camera_poses()[2]
    expected = draw_slowly(given, [T, T @ JOINT.transform(state)], CAMERA)
    assert expected.max() > 100 and (expected.max(-1) > 20).mean() > 0.1, "there is something to see"
    path = tmp_path / "a.html"
    path.write_text(document("gaussians", [scene_section(made_scene(given))]))
    with browser() as chrome:
        link = f"frame=2&state={state}&view=video&show=part"
        chrome.open(f"{path.as_uri()}#{link}", ready="!!document.querySelector('.view canvas')")
        first = shot(chrome)
        difference = np.abs(first - expected)
        assert difference.mean() < 0.5 and np.percentile(difference, 99.9) < 8, (difference.mean(), difference.max())
        for name, least, most in (("Surfaces", 5, 255), ("Gaussians", 0, 0.01), ("Part colours", 5, 255)):
            chrome.run(
                f"[...document.querySelectorAll('button')].find((b) => b.textContent.includes({name!r})).click()"
            )
            assert least <= np.abs(shot(chrome) - first).mean() <= most, name
        assert not chrome.errors
