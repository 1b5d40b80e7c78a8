"""One run of part poses: the joint's position over time, and the part's displacement off its joint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array
from simgap.geometry import pose_search
from simgap.geometry.pose_model import Geometry, PoseModel, Rocking, Track, Weighting


@dataclass(frozen=True)
class TrackGeometry:
    """Geometry of one run."""

    name: str
    times_s: Array
    """(n,) s."""
    q: Array
    """(n,) rad or m: joint position without the named geometry, for the analysis of dynamics."""
    q_before: Array
    """(n,) the same with the asset's ideal joint."""
    time_shift_s: float
    """Shift of this run's clock with which rocking has the phase of the named effect."""
    q_std: float
    """Noise of `q`, standard deviation."""
    off_before: Array
    """(n, 6) m and rad: twist off the ideal joint, at the moving part's centre."""
    off_after: Array
    """(n, 6) the same off the joint with the named effects."""
    gap_before: float
    """m: RMS displacement of the part off the ideal joint."""
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
    """The point with the phase of rocking fitted to this run; direction, amplitude and frequency stay."""
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
    """Time, s, by which this run's phase is ahead of the first run's."""
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
    """m: radius of gyration, to count rotations as displacements."""
    if mechanics.joint.type == "revolute" and mechanics.mass > 0:
        return float(np.sqrt(mechanics.inertia / mechanics.mass))
    return max(float(np.linalg.norm(middle - mechanics.joint.pivot)), 0.05)


def move_twists(point: Array, twists: Array) -> Array:
    """(n, 6) twists with the translation of `point` (3,) of the part."""
    return np.concatenate([twists[:, :3] + np.cross(twists[:, 3:], point), twists[:, 3:]], -1)


def rms_displacement(twists: Array, lever: float) -> float:
    """m: RMS displacement of points at `lever` around the reference point of the twists (n, 6)."""
    return float(np.sqrt(((twists[:, :3] ** 2).sum(-1) + lever**2 * (twists[:, 3:] ** 2).sum(-1)).mean()))
