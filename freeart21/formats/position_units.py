"""Which unit positions are in that nobody told: by the joint's limits, and by the asset's equation of motion.

A unit that is wrong by a factor of 57 (degrees) or 1000 (mm) makes the inertia wrong by it, where known efforts
moved the joint, and bends the pull of gravity, where a pendulum swings far. Both are looked at in weak form: for smooth
windows w(t) that vanish with their slopes at their ends, the integral of inertia * qdd * w is that of inertia * q *
w'', so that no noise is differentiated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.files.urdf import read_urdf, subtree_links
from freeart21.joint import Joint
from freeart21.mechanics import JointMechanics, joint_inertia
from freeart21.se3 import Array

LIKE = 3.0
"""Factor by which the inertia that a motion shows may differ from the asset's, losses beside it having been fitted,
for the unit to be right: what people guess masses and sizes to. Units differ by 57 at least."""
SURE = 0.3
"""Part of itself that this inertia may be uncertain by."""
BETTER = 4.0
"""Times the sum of squares that is left by one of two units with a likely inertia, for the other to be right. Not
measured: errors of windows last, so that twice may be chance."""
LEAST_WINDOWS = 12
"""Fewer say nothing."""
_MOST_WINDOWS = 400
_SAMPLES = 16
"""Of a window at least."""
_PARTS = 8
"""Of a run, at least, that windows last for: motion that drifts to one side does not swing."""


@dataclass(frozen=True)
class RawMotion:
    """One run as it was recorded."""

    times_s: Array
    """(n,) s, rising."""
    q: Array
    """(n,) position from the joint's zero, in the unit that is asked for; NaN where there is none."""
    effort: Array | None
    """(n,) N*m or N on the joint; None for none."""


def joint_mechanics(asset: Asset, gravity: Array) -> JointMechanics | None:
    """What the asset's joint carries, from its URDF alone, in the root link's frame.

    `gravity` is (3,), m/s^2, in the reference link's frame. None where the URDF does not say, or the joint moves the
    reference link.
    """
    urdf = read_urdf(asset.urdf)
    scored = urdf.joints[asset.joint]
    moving = subtree_links(urdf.joints, scored.child)
    if asset.reference_link in moving or scored.joint_type is None:
        return None
    Ts = urdf.link_poses(asset.held)  # of the joint itself at zero
    T_joint = Ts[scored.parent] @ scored.T_parent_joint
    joint = Joint(scored.name, scored.joint_type, T_joint[:3, :3] @ scored.axis, T_joint[:3, 3], -np.inf, np.inf)
    bodies = [
        (own.mass, se3.transform(Ts[name], own.centre[None])[0], Ts[name][:3, :3] @ own.inertia @ Ts[name][:3, :3].T)
        for name in sorted(moving)
        if (own := urdf.links[name].inertial) is not None
    ]
    inertia = joint_inertia(joint, bodies)
    if inertia <= 0:
        return None
    moment = np.sum([mass * centre for mass, centre, _ in bodies], axis=0)
    gravity = Ts[asset.reference_link][:3, :3] @ gravity
    return JointMechanics(joint, sum(body[0] for body in bodies), inertia, moment, gravity)


def unit_by_motion(mechanics: JointMechanics, runs: Sequence[RawMotion], scales: dict[str, float]) -> str | None:
    """The one of the units with which the asset's equation of motion holds; None where none, or more than one, does.

    `scales` maps units to rad or m.
    """
    windows = [window for run in runs for window in _windows(run)]
    windows = windows[:: max(1, -(-len(windows) // _MOST_WINDOWS))]
    if len(windows) < LEAST_WINDOWS:
        return None
    likely = {}
    for unit, scale in scales.items():
        ratio, error, left = _inertia_shown(mechanics, windows, scale)
        if 1 / LIKE < ratio < LIKE and error < SURE * ratio:
            likely[unit] = left
    order = sorted(likely, key=lambda unit: likely[unit])
    if len(order) > 1 and likely[order[1]] < BETTER * likely[order[0]]:
        return None
    return order[0] if order else None


def _windows(run: RawMotion) -> list[RawMotion]:
    """Stretches of a run that each last for half a swing at most, every one half over the next."""
    good = np.isfinite(run.q) if run.effort is None else np.isfinite(run.q) & np.isfinite(run.effort)
    t, q = run.times_s[good], run.q[good]
    effort = None if run.effort is None else run.effort[good]
    if len(t) < 2 * _SAMPLES:
        return []
    middle = q - np.median(q)
    crossings = max(1, int(np.count_nonzero(np.diff(np.sign(_smooth(middle))))))
    length = int(np.clip(len(t) // crossings, _SAMPLES, max(_SAMPLES, len(t) // _PARTS)))
    begins = range(0, len(t) - length + 1, max(1, length // 2))
    return [
        RawMotion(t[a : a + length], q[a : a + length], None if effort is None else effort[a : a + length])
        for a in begins
    ]


def _smooth(q: Array, width: int = 5) -> Array:
    """(n,) means of neighbours."""
    return np.convolve(np.pad(q, width // 2, mode="edge"), np.full(width, 1 / width), "valid")


def _inertia_shown(mechanics: JointMechanics, windows: list[RawMotion], scale: float) -> tuple[float, float, float]:
    """The inertia with which known forces drive the motion, over the asset's; its standard error; the sum of squares
    that is left, over that of the forces. Oil and dry friction are free beside it, and none of them may push."""
    rows, forces = [], []
    for run in windows:
        span = run.times_s[-1] - run.times_s[0]
        phase = np.pi * (run.times_s - run.times_s[0]) / span
        s, c, rate = np.sin(phase), np.cos(phase), np.pi / span
        w, dw, ddw = s**4, 4 * rate * s**3 * c, 4 * rate**2 * (3 * s**2 * c**2 - s**4)
        q = scale * run.q
        known = mechanics.gravity_force(q) + (0.0 if run.effort is None else run.effort)
        off = q - q.mean()
        turning = np.sign(np.gradient(_smooth(q), run.times_s))
        terms = (mechanics.inertia * off * ddw, -off * dw, turning * w, known * w)
        sums = [float(np.trapezoid(term, run.times_s)) for term in terms]
        rows.append(sums[:3])
        forces.append(sums[3])
    columns, y = np.array(rows), np.array(forces)
    if not np.any(y):
        return 0.0, np.inf, np.inf
    kept = [0, 1, 2]
    while True:
        X = columns[:, kept] / np.maximum(np.linalg.norm(columns[:, kept], axis=0), 1e-300)
        found, *_ = np.linalg.lstsq(X, y, rcond=1e-10)
        pushing = [k for k, value in zip(kept, found, strict=True) if k and value < 0]
        if not pushing:
            break
        kept.remove(pushing[0])
    left = float(((y - X @ found) ** 2).sum())
    spread = np.sqrt(left / max(len(y) - len(kept), 1) * np.linalg.pinv(X.T @ X)[0, 0])
    size = max(float(np.linalg.norm(columns[:, 0])), 1e-300)
    return float(found[0]) / size, float(spread) / size, left / float(y @ y)
