"""What one run of part poses says: the joint's position over time, and how far the part is off its joint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array
from simgap import pose_search
from simgap.pose_model import Geometry, PoseModel, Rock, Track, Weighting, rock_direction


@dataclass(frozen=True)
class TrackGeometry:
    """What one run says."""

    name: str
    times_s: Array
    """(n,) s."""
    q: Array
    """(n,) rad or m: the joint's position with the named geometry taken out, for the dynamics that follows."""
    q_std: float
    """Standard deviation of the noise of `q`."""
    off_before: Array
    """(n, 6) m and rad: twist off the ideal joint, at the moving part's middle."""
    off_after: Array
    """(n, 6) the same off the joint with the named effects."""
    gap_before: float
    """m: root mean square displacement of the part off the ideal joint."""
    gap_after: float
    """m: off the joint with the named effects."""
    floor: float
    """m: noise of the poses."""
    held_out: bool


def track_geometry(
    track: Track, held_out: bool, mechanics: JointMechanics, weighting: Weighting, plain: Geometry, point: Geometry
) -> TrackGeometry:
    """One run off the ideal joint (`plain`, registration only) and off the joint of `point`."""
    model = PoseModel((track,), mechanics)
    middle = mechanics.moment_zero / mechanics.mass if mechanics.mass else mechanics.joint.pivot
    lever = _lever(mechanics, middle)
    q_plain = model.positions(plain, weighting)
    here = _with_phase(model, point, weighting)
    q = model.positions(here, weighting)
    before, after = (_at(middle, model.residuals(g, at)) for g, at in ((plain, q_plain), (here, q)))
    L = weighting.whitening
    along = L @ mechanics.joint.screw
    size = float(np.linalg.norm(along))
    off = np.eye(6) - np.outer(along, along) / size**2
    noise = _at(middle, (np.linalg.inv(L) @ off).T)
    return TrackGeometry(
        track.name,
        track.times_s,
        q,
        1 / size,
        before,
        after,
        _displacement(before, lever),
        _displacement(after, lever),
        _displacement(noise, lever) * np.sqrt(len(noise)),
        held_out,
    )


def _with_phase(model: PoseModel, point: Geometry, weighting: Weighting) -> Geometry:
    """The point of the model with rocking's phase of this one run; direction, amplitude and frequency stay."""
    if point.rock is None:
        return point
    u = rock_direction(point.rock)
    amplitude = float(np.sqrt(((u @ point.rock.coefficients) ** 2).sum(-1).mean()))
    still = replace(point, rock=None)
    lin = model.linear(still, model.positions(still, weighting), weighting)
    left = lin.data - lin.columns @ np.concatenate([point.values, point.registration])
    waves = u @ pose_search.rock_coefficients(lin, left, point.rock.frequency)[0]
    waves = amplitude * waves / max(float(np.linalg.norm(waves)), 1e-12)
    return replace(point, rock=Rock(point.rock.frequency, np.outer(u, waves)[None]))


def _lever(mechanics: JointMechanics, middle: Array) -> float:
    """m: how far from its middle the part's points are taken to lie, to count turns as displacements."""
    if mechanics.joint.type == "revolute" and mechanics.mass > 0:
        return float(np.sqrt(mechanics.inertia / mechanics.mass))
    return max(float(np.linalg.norm(middle - mechanics.joint.pivot)), 0.05)


def _at(point: Array, twists: Array) -> Array:
    """(n, 6) twists whose translation is that of `point` (3,) of the part."""
    return np.concatenate([twists[:, :3] + np.cross(twists[:, 3:], point), twists[:, 3:]], -1)


def _displacement(twists: Array, lever: float) -> float:
    return float(np.sqrt(((twists[:, :3] ** 2).sum(-1) + lever**2 * (twists[:, 3:] ** 2).sum(-1)).mean()))
