"""What one run of part poses says: the joint's position over time, and how far the part is off its joint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array
from simgap.geometry import pose_search
from simgap.geometry.pose_model import Geometry, PoseModel, Rocking, Track, Weighting


@dataclass(frozen=True)
class TrackGeometry:
    """What one run says."""

    name: str
    times_s: Array
    """(n,) s."""
    q: Array
    """(n,) rad or m: the joint's position with the named geometry taken out, for the dynamics that follows."""
    q_before: Array
    """(n,) the same with the asset's ideal joint."""
    time_shift_s: float
    """By how much the clock of this run is set on so that rocking has the phase of the named effect."""
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
    middle = part_centre(mechanics)
    lever = gyration_radius(mechanics, middle)
    q_plain = model.positions(plain, weighting)
    here = _fit_phase(model, point, weighting)
    q = model.positions(here, weighting)
    before, after = (move_twists(middle, model.residuals(g, at)) for g, at in ((plain, q_plain), (here, q)))
    L = weighting.whitening
    along = L @ mechanics.joint.screw
    size = float(np.linalg.norm(along))
    off = np.eye(6) - np.outer(along, along) / size**2
    noise = move_twists(middle, (np.linalg.inv(L) @ off).T)
    return TrackGeometry(
        track.name,
        track.times_s,
        q,
        q_plain,
        _time_shift(point, here),
        1 / size,
        before,
        after,
        rms_displacement(before, lever),
        rms_displacement(after, lever),
        float(rms_displacement(noise, lever) * np.sqrt(len(noise))),
        held_out,
    )


def _fit_phase(model: PoseModel, point: Geometry, weighting: Weighting) -> Geometry:
    """The point of the model with rocking's phase of this one run; direction, amplitude and frequency stay."""
    if point.rock is None:
        return point
    u = point.rock.direction
    amplitude = float(np.sqrt(((u @ point.rock.coefficients) ** 2).sum(-1).mean()))
    still = replace(point, rock=None)
    lin = model.linear(still, model.positions(still, weighting), weighting)
    waves = u @ pose_search.fit_rocking(lin, lin.residual(point), point.rock.frequency)[0]
    waves = amplitude * waves / max(float(np.linalg.norm(waves)), 1e-12)
    return replace(point, rock=Rocking(point.rock.frequency, np.outer(u, waves)[None]))


def _time_shift(point: Geometry, here: Geometry) -> float:
    """Seconds by which rocking of this run's phase is ahead of the first run's."""
    if point.rock is None or here.rock is None:
        return 0.0
    u = point.rock.direction
    first, now = u @ point.rock.coefficients[0], u @ here.rock.coefficients[0]
    ahead = np.arctan2(now[1], now[0]) - np.arctan2(first[1], first[0])
    return float(ahead / (2 * np.pi * point.rock.frequency))


def part_centre(mechanics: JointMechanics) -> Array:
    """(3,) the part's centre of mass at joint position zero, else the pivot."""
    return np.asarray(mechanics.moment_zero / mechanics.mass if mechanics.mass else mechanics.joint.pivot)


def gyration_radius(mechanics: JointMechanics, middle: Array) -> float:
    """m: how far from its middle the part's points are taken to lie, to count turns as displacements."""
    if mechanics.joint.type == "revolute" and mechanics.mass > 0:
        return float(np.sqrt(mechanics.inertia / mechanics.mass))
    return max(float(np.linalg.norm(middle - mechanics.joint.pivot)), 0.05)


def move_twists(point: Array, twists: Array) -> Array:
    """(n, 6) twists whose translation is that of `point` (3,) of the part."""
    return np.concatenate([twists[:, :3] + np.cross(twists[:, 3:], point), twists[:, 3:]], -1)


def rms_displacement(twists: Array, lever: float) -> float:
    """m: root mean square displacement of points at `lever` around where twists (n, 6) are counted."""
    return float(np.sqrt(((twists[:, :3] ** 2).sum(-1) + lever**2 * (twists[:, 3:] ** 2).sum(-1)).mean()))
