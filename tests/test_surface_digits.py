"""What makes distances fast changes no digit of them: each is what a search that knows nothing before it finds."""

import numpy as np
import pytest
import trimesh

from freeart21 import se3
from freeart21.mesh import Mesh
from leaderboard.surface import Surface


def _rough(rng):
    made = trimesh.creation.icosphere(4, radius=0.2)
    return Mesh(made.vertices + rng.normal(size=made.vertices.shape) * 0.002, made.faces)


def _boxes(rng):
    made = trimesh.creation.box([0.4, 0.3, 0.02]).subdivide().subdivide().subdivide()
    return Mesh(made.vertices, made.faces)


@pytest.mark.parametrize("make", [_rough, _boxes])
@pytest.mark.parametrize("limited", [False, True])
def test_a_point_among_others_gets_the_digits_that_it_gets_alone(make, limited):
    """Corners and edges that triangles share are where a search's order could show: points lie near all kinds."""
    rng = np.random.default_rng(5)
    mesh = make(rng)
    surface = Surface(mesh)
    near = np.concatenate([surface.sample(1500, (1,)), np.repeat(mesh.vertices, 2, 0)[:1500]])
    points = se3.transform(se3.exp_se3([0.001, 0.002, 0.001, 0.01, 0.0, 0.02]), near)
    points = np.concatenate([points, near + np.array([0, 0, 0.001]), rng.normal(size=(500, 3))])
    limits = rng.random(len(points)) * 0.01 if limited else np.full(len(points), np.inf)
    alone = [surface.distance(point[None], limit[None])[0] for point, limit in zip(points, limits, strict=True)]
    assert np.array_equal(surface.distance(points, limits), alone)
