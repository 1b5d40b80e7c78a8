"""The unit of recorded positions, from the asset's equation of motion.

A unit wrong by a factor of 57 (degrees) or 1000 (mm) makes the inertia wrong by the same factor where known efforts
move the joint, and distorts gravity's torque where a pendulum swings far. The equation is tested in weak form: for
smooth windows w(t) that vanish with their slopes at their ends, the integral of inertia * qdd * w equals that of
inertia * q * w'', so that no noise is differentiated.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.files.urdf import read_urdf, subtree_links
from freeart21.joint import Joint
from freeart21.mechanics import JointMechanics, joint_inertia
from freeart21.se3 import Array

INERTIA_FACTOR = 3.0
"""Largest factor between the fitted inertia and the asset's in the right unit: the error of guessed masses and sizes.
Units differ by at least 57."""
MAX_RELATIVE_ERROR = 0.3
"""Largest relative standard error of the fitted inertia."""
BETTER = 4.0
"""Least ratio of residual sums of squares between two units with a plausible inertia. Not measured: errors of windows
are correlated, so that a ratio of 2 can be chance."""
LEAST_WINDOWS = 12
"""Fewest windows for an answer."""
_MOST_WINDOWS = 400
_SAMPLES = 16
"""Least samples of a window."""
_PARTS = 8
"""Windows last at most a run over this number, also where the motion drifts instead of swinging."""


Motion = tuple[Array, Array, Array | None]
"""Times (n,), s, increasing; positions (n,) from the joint's zero in an unknown unit, NaN where there is none; and
efforts (n,) on the joint, N*m or N, None for none."""


def joint_mechanics(asset: Asset, gravity: Array) -> JointMechanics | None:
    """Inertia and mass that the asset's joint moves, from its URDF, in the root link's frame.

    `gravity` is (3,), m/s^2, in the reference link's frame. None when the URDF lacks them, or the joint
    moves the reference link.
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


def unit_by_motion(mechanics: JointMechanics, runs: Sequence[Motion], scales: dict[str, float]) -> str | None:
    """The unit in which the asset's equation of motion holds; None when none does, or several do.

    `scales` maps units to rad or m.
    """
    windows = [window for run in runs for window in _windows(*run)]
    windows = windows[:: max(1, -(-len(windows) // _MOST_WINDOWS))]
    likely = {}
    for unit, scale in scales.items() if len(windows) >= LEAST_WINDOWS else ():
        ratio, error, residual = _fit_inertia(mechanics, windows, scale)
        if 1 / INERTIA_FACTOR < ratio < INERTIA_FACTOR and error < MAX_RELATIVE_ERROR * ratio:
            likely[unit] = residual
    order = sorted(likely, key=lambda unit: likely[unit])
    if len(order) > 1 and likely[order[1]] < BETTER * likely[order[0]]:
        return None
    return order[0] if order else None


def _windows(t: Array, q: Array, effort: Array | None) -> list[Array]:
    """(3, k) each: stretches of a run of at most half a swing, overlapping by half, of times, positions and efforts."""
    table = np.stack([t, q, np.zeros(len(t)) if effort is None else effort])
    table = table[:, np.isfinite(table).all(0)]
    n = table.shape[1]
    if n < 2 * _SAMPLES:
        return []
    crossings = max(1, int(np.count_nonzero(np.diff(np.sign(_smooth(table[1] - np.median(table[1])))))))
    length = int(np.clip(n // crossings, _SAMPLES, max(_SAMPLES, n // _PARTS)))
    return [table[:, a : a + length] for a in range(0, n - length + 1, max(1, length // 2))]


def _smooth(q: Array, width: int = 5) -> Array:
    """(n,) moving average."""
    return np.convolve(np.pad(q, width // 2, mode="edge"), np.full(width, 1 / width), "valid")


def _fit_inertia(mechanics: JointMechanics, windows: list[Array], scale: float) -> tuple[float, float, float]:
    """The fitted inertia over the asset's, its standard error, and the residual sum of squares over that of the forces.

    Viscous and dry friction are fitted, too, and must be dissipative.
    """
    from scipy.optimize import nnls

    rows = []
    for t, raw, effort in windows:
        rate = np.pi / (t[-1] - t[0])
        s, c = np.sin(rate * (t - t[0])), np.cos(rate * (t - t[0]))
        w, dw, ddw = s**4, 4 * rate * s**3 * c, 4 * rate**2 * (3 * s**2 * c**2 - s**4)
        q = scale * raw
        off, turning = q - q.mean(), np.sign(np.gradient(_smooth(q), t))
        terms = (mechanics.inertia * off * ddw, -off * dw, turning * w, (mechanics.gravity_force(q) + effort) * w)
        rows.append([float(np.trapezoid(term, t)) for term in terms])
    *columns, forces = np.array(rows).T
    sizes = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
    X = (np.array(columns) / sizes[:, None]).T
    found, length = nnls(X, forces)
    if not found[0] or not length:
        return 0.0, np.inf, np.inf
    X = X[:, found > 0]
    spread = length * np.sqrt(np.linalg.pinv(X.T @ X)[0, 0] / max(len(forces) - X.shape[1], 1))
    return float(found[0] / sizes[0]), float(spread / sizes[0]), float((length / np.linalg.norm(forces)) ** 2)
