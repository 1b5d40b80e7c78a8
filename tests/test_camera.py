"""The camera model, by hand."""

import numpy as np
import pytest
from refusal import assert_refused

from freeart21.camera import Camera
from freeart21.errors import FreeArtError

CAMERA = Camera(np.array([[500.0, 0, 320], [0, 400, 180], [0, 0, 1]]), 640, 360)


def test_a_hand_made_point_lands_on_a_hand_computed_pixel():
    # x: 500 * 0.2 / 2 + 320 = 370; y: 400 * -0.1 / 2 + 180 = 160
    np.testing.assert_allclose(CAMERA.project([0.2, -0.1, 2.0]), [370, 160])


def test_the_first_pixel_has_its_centre_at_half_half():
    direction = CAMERA.rays()[0, 0]
    np.testing.assert_allclose(direction, [(0.5 - 320) / 500, (0.5 - 180) / 400, 1])
    np.testing.assert_allclose(CAMERA.project(3 * direction), [0.5, 0.5])


def test_right_is_x_and_down_is_y():
    u, v = CAMERA.project([[0.1, 0, 1], [0, 0.1, 1]])
    assert u[0] > CAMERA.K[0, 2] and u[1] == CAMERA.K[1, 2]
    assert v[1] > CAMERA.K[1, 2] and v[0] == CAMERA.K[0, 2]


def test_a_slanted_plane_backprojects_onto_itself():
    n, d = np.array([0.3, -0.4, 1.0]), 2.0  # n . X = d
    depth = d / (CAMERA.rays() @ n)
    points = CAMERA.backproject(depth)
    np.testing.assert_allclose(points @ n, d, atol=1e-12)
    u, v = np.meshgrid(np.arange(640) + 0.5, np.arange(360) + 0.5)
    np.testing.assert_allclose(CAMERA.project(points), np.stack([u, v], -1), atol=1e-9)


def test_points_behind_the_camera_project_to_nan():
    assert np.isnan(CAMERA.project([[0.0, 0, -1], [0, 0, 0]])).all()


def test_field_of_view_is_vertical():
    camera = Camera.from_fov(640, 360, np.deg2rad(40))
    top = camera.project([0, -np.tan(np.deg2rad(20)), 1])
    np.testing.assert_allclose(top, [320, 0], atol=1e-9)


def test_bad_cameras_are_refused():
    with pytest.raises(FreeArtError, match="expected \\[\\[fx, 0, cx\\]"):
        Camera(np.array([[500.0, 1, 320], [0, 400, 180], [0, 0, 1]]), 640, 360)
    assert_refused("0 x 360", Camera, CAMERA.K, 0, 360)
    assert_refused("expected \\(360, 640\\)", CAMERA.backproject, np.zeros((640, 360)))
