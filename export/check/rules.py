"""The rules by name: what each demands of an asset, and why. Ids are stable, for tools.

Numbers in the texts are constants of this module, and the judging code imports them from here.
"""

from __future__ import annotations

from dataclasses import dataclass

MAX_HULLS = 256
"""Collision geometries per link. A thin-walled part within 2 mm takes up to a few hundred. With 64 the base of a
reconstructed stapler, 66, would fail; `export` writes at most this many."""
DRIFT_M, DRIFT_RAD = 1e-3, 1e-2
"""Largest drift of an asset at rest (arXiv 2605.19136)."""
GROUND_M = DRIFT_M
"""Largest distance of the lowest collision point from z = 0: the allowed drift."""
TURNS = 3
"""Sign changes of a velocity that are an oscillation (the same paper)."""
REST_S = 5.0
"""s. A creep of 0.2 mm/s drifts by `DRIFT_M` in it."""
STATES = 100
"""Random states: a fault in a tenth of a joint's range is missed once in 38,000 times, with 25 once in 14."""
POSE_TOLERANCE = 1e-6
"""Rotation entries, and metres for an asset of up to a metre: 17 roundings to single precision of 6e-8 each."""
MASS_TOLERANCE = 1e-3
"""Relative, of a link's mass and largest moment. 5,000 random tensors converted to principal moments and axes in single
precision, as engines do, came back within 2e-7."""
ENERGY_RISE = 0.02
"""Over the largest kinetic energy on the way. Engines step semi-implicitly at 2 ms: energy errs by half a step times
power. Measured on ten exported reconstructions in all four engines: at most 1 %."""
SHIFT_SHARE = 0.1
"""Displacement of a link's collision over its size. Of 600 links of PartNet-Mobility, ARCTIC and the URDFs of PyBullet
3.2.7 all are within 0.051, except four with collision shapes in another place (0.23)."""
THIN_SHARE, THIN_SHIFT = 0.5, 0.02
"""Over a thin link's own width in that direction, if it exceeds the second number times its size: at most 0.22 of the
same links, and 0.93 of those four."""
BENT_SHARE = 0.6
"""Difference of widths over the larger size; a shape 2.5 times too large has it. At most 0.57 of the same links, and
0.89 of one whose collision omits two thirds."""
INERTIA_HIGH, INERTIA_LOW = 1.0, 0.01
"""Of mass times squared reach. More than 1 is impossible. Solids of uniform density have 0.2 to 0.7; at 0.01 all mass
is within a tenth of the size around the centre. Links of the same URDFs that are no placeholders have 0.03 to 1."""
CUT_SHARE = 0.25
"""Share of a part's surface that may pass through its neighbour over the range. At most 0.17 of 53 joints of the same
URDFs, except five that do pass through. PartNet's cabinets with reversed drawers and doors have 0.46 to 0.97, unless
the doors are open frames."""

VISUAL_DEPTH_M = 1e-3
"""Depth of one visual mesh of our assets in the other: what is seen from half a metre as one thing in another."""
DENSITY_LOW, DENSITY_HIGH = 1.0, 22590.0
"""kg/m^3, of a body over the hull of its shapes: that of air, and osmium's, the densest there is."""
AXIS_SHARE = 3.0
"""Distance of a hinge's axis from the nearest point that it moves, over the size of what it moves and of what bears
it. At most 0.07 of 13 hinges of PartNet-Mobility and ARCTIC; 1.4 of one whose meshes are scaled and whose origins are
not."""

CONTACT_PERCENT = 95
"""Percentile of distances that is judged: the remaining points are corners and seams."""
CONTACT_SHARE = 0.1
"""Distance, over a link's size, of 5 % of the visual surface from the collision shapes, or the other way round. Boxes
against themselves: 0; convex hulls of scissors: 0.01; one hull around a ketchup bottle 0.01, around its hollow cap
0.13 and around a mixer 0.16; a phone's half whose back was carved away: 0.21."""


@dataclass(frozen=True)
class Rule:
    """A demand on an asset."""

    asks: str
    """What must hold."""
    good_for: str
    """What fails otherwise."""


UNREAD = "its files could not be looked through"
"""Why no engine is tried."""
FILE_RULES: dict[str, Rule] = {
    "trust.sound": Rule("the reconstruction that it was made of is trusted", "relying on its shape and its joint"),
    "numbers and meshes": Rule("numbers and meshes can be read", "anything at all"),
    "tree.links-exist": Rule("joints name links that exist", "every loader"),
    "tree.one-root": Rule("one link is no joint's child, all others descend from it", "every loader"),
    "tree.one-parent": Rule("no link is the child of two joints", "every loader"),
    "names.unique": Rule("links, joints, and named visuals and collisions have unique names", "strict parsers"),
    "paths.relative": Rule("files are named relative to the file, without spaces or schemes", "moving the folder"),
    "paths.exist": Rule("files that are named exist", "every loader: some skip them silently"),
    "inertia.present": Rule("links that move have mass and inertia", "engines invent them, each its own"),
    "inertia.physical": Rule("mass and moments are positive, the largest at most the sum of the others", "stability"),
    "inertia.centre-inside": Rule("the centre of mass lies in the collision box", "balance"),
    "inertia.fits-shape": Rule(
        f"the largest moment is {INERTIA_LOW:g} to {INERTIA_HIGH:g} times mass times squared reach of the shapes",
        "dynamics: units gone wrong (mm, g) and placeholders",
    ),
    "mass.possible": Rule(
        f"mass over the hull of a body's shapes is {DENSITY_LOW:g} to {DENSITY_HIGH:g} kg a cubic metre",
        "dynamics: grams or millimetres gone wrong in all of them",
    ),
    "collision.present": Rule("links with visuals have collision shapes", "grasping"),
    "collision.few": Rule(f"at most {MAX_HULLS} collision shapes a link", "speed"),
    "collision.matches-visual": Rule(
        f"collision shapes lie where visuals do: within {SHIFT_SHARE:g} of the link's size (thin links: "
        f"{THIN_SHARE:g} of their width), and widths differ by at most {BENT_SHARE:g} of it",
        "grasping what is seen; scales and offsets gone wrong",
    ),
    "collision.true-to-visual": Rule(
        f"{CONTACT_PERCENT} % of a link's visual surface lies within {CONTACT_SHARE:g} of its size from the outer "
        "surface of its collision shapes, and the other way round; asset.json states the same",
        "grasping: missing contact, filled openings",
    ),
    "collision.closed": Rule("collision meshes are closed and face outwards", "contact, volume"),
    "collision.convex": Rule("collision meshes are convex", "engines take the hull: openings close"),
    "textures.exist": Rule("materials and textures that meshes name exist", "rendering"),
    "mesh.readable": Rule("visual meshes can be read and have a surface", "rendering"),
    "mesh.watertight": Rule("visual meshes are closed once equal corners are joined", "volumes, distance fields"),
    "axis.unit": Rule("joint axes have unit length", "loaders that do not normalise"),
    "axis.near": Rule(
        f"a hinge's axis passes the part that it turns within {AXIS_SHARE:g} of the size of both parts",
        "joints: offsets in another unit",
    ),
    "limits.present": Rule("revolute and prismatic joints have limits", "planners"),
    "limits.ordered": Rule("lower < upper", "engines that take the joint for locked, or free"),
    "limits.zero-within": Rule("zero lies within the limits", "a start that breaks a limit"),
    "limits.effort": Rule("effort is positive", "controllers that clamp to it"),
    "limits.velocity": Rule("velocity is positive", "controllers that clamp to it"),
    "parts.clear": Rule(
        f"over a joint's range, others at rest, at most {CUT_SHARE:g} of a part's surface passes through its neighbour "
        "or through a part with the same parent",
        "doors that swing into their body, which engines allow; drawers that block each other",
    ),
    "parts.visuals-clear": Rule(
        f"visual meshes of an exported asset are at most {1e3 * VISUAL_DEPTH_M:g} mm in each other over the range",
        "rendering: a part seen in another",
    ),
    "dynamics.damped": Rule("every joint that moves has damping or friction", "doors that swing for ever"),
    "usd.same": Rule(
        "the USD layer that `export` wrote has the URDF's bodies, masses, joints, axes and limits",
        "USD engines: another asset than in the others",
    ),
    "mjcf.same": Rule(
        "the MJCF that `export` wrote has the URDF's bodies, masses, collision shapes, joints, limits and poses",
        "MuJoCo: another asset than in the others",
    ),
    "loaders.same": Rule("the loaders' joint.json has the asset's numbers", "engines started by the asset's loaders"),
    "certificate.same": Rule("certificate.json states what the files give", "relying on its numbers"),
    "stands.on-ground": Rule(
        f"the lowest collision point lies within {1e3 * GROUND_M:g} mm of zero",
        "placing it on a table",
    ),
}
"""Rules on files, in the order of the report."""
ENGINE_RULES: dict[str, Rule] = {
    "engine.loads": Rule("the engine loads it", "using it there"),
    "engine.tree": Rule("links, joints and parents are the file's", "finding them by name"),
    "engine.limits": Rule("limits are the file's", "planning"),
    "engine.masses": Rule(f"masses and moments are the file's within {MASS_TOLERANCE:g} of themselves", "dynamics"),
    "engine.poses": Rule(
        f"links stand within {POSE_TOLERANCE:g} of the file's forward kinematics in {STATES} states", "everything"
    ),
    "joint.moves": Rule("pushed, each joint reaches both limits", "opening it"),
    "joint.stops": Rule("pushed on, each joint stays within its limits", "closing it"),
    "energy.falls": Rule(f"moving freely, its energy never rises by more than {ENERGY_RISE:.0%}", "stability"),
    "rest.drift": Rule(
        f"left on a plane for {REST_S:g} s, no link moves by more than {1e3 * DRIFT_M:g} mm or {DRIFT_RAD:g} rad",
        "standing still",
    ),
    "rest.oscillation": Rule(f"left on a plane, no link swings back {TURNS} times", "standing still"),
}
"""Rules tried in each engine."""
RULES = FILE_RULES | ENGINE_RULES
