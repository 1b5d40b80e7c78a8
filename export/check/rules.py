"""The rules by name: what each holds an asset to, and what that is good for. Ids are stable: tools may key on them.

Every number that a rule's text says is a constant of this module, which the code that judges imports from here.
"""

from __future__ import annotations

from dataclasses import dataclass

MAX_HULLS = 256
"""Collision geometries a link may have: a thin-walled part within 2 mm takes up to some hundred.
With 64 the base of a reconstructed stapler, 66, would fail; `export` writes no more than these."""
DRIFT_M, DRIFT_RAD = 1e-3, 1e-2
"""arXiv 2605.19136: an asset at rest drifts by no more."""
GROUND_M = DRIFT_M
"""How far the lowest collision point may be from z = 0: what an asset at rest may drift."""
TURNS = 3
"""The same paper: so many changes of a velocity's sign are an oscillation."""
REST_S = 5.0
"""A creep of 0.2 mm/s drifts by `DRIFT_M` in it."""
STATES = 100
"""Drawn at random: what is wrong in a tenth of a joint's range is missed once in 38,000 times, by 25 once in 14."""
POSE_TOLERANCE = 1e-6
"""Rotation entries, and metres for an asset of up to a metre: 17 roundings to single precision, of 6e-8 each."""
MASS_TOLERANCE = 1e-3
"""Relative, of a link's mass and of its largest moment. Principal moments and axes in single precision, as engines have
them, give 5,000 random tensors back within 2e-7."""
ENERGY_RISE = 0.02
"""Of the greatest kinetic energy on the way. Engines step semi-implicitly at 2 ms: energy errs by half a step times
power. Measured on ten exported reconstructions, in all four engines alike: at most 1 %."""
SHIFT_SHARE = 0.1
"""Part of a link's size by which its collision may be displaced. Of 600 links of PartNet-Mobility, ARCTIC and the URDFs
that come with PyBullet 3.2.7 all are within 0.051 but four, whose collision stands beside what is seen (0.23)."""
THIN_SHARE, THIN_SHIFT = 0.5, 0.02
"""Of a link's own width in that direction, for thin links, if it is more than the second part of its size: of the same
links at most 0.22, and 0.93 of those four."""
BENT_SHARE = 0.6
"""Part of the larger size by which widths may differ, which 2.5 times too large is: of the same links at most 0.57, and
0.89 of one whose collision leaves two thirds out."""
INERTIA_HIGH, INERTIA_LOW = 1.0, 0.01
"""Of mass times squared reach. No mass within reach gives more than 1. Solids of even density have 0.2 to 0.7; of 0.01
all is within a tenth of the size about the centre. Links of the same URDFs that are not placeholders: 0.03 to 1."""
CUT_SHARE = 0.25
"""Part of a part's surface that may pass through its neighbour over the range. Of 53 joints of the same URDFs at most
0.17, but for five that do pass through; PartNet's cabinets with drawers and doors the wrong way round have 0.46 to 0.97
where the doors are no open frames."""
FAR_LIMIT = 1e3
"""rad or m: no joint has such a range, and engines in single precision have 1e-4 rad left there."""
CONTACT_PERCENT = 95
"""The percentile of distances that is judged: few points more are corners and seams."""
CONTACT_SHARE = 0.1
"""Part of a link's size by which 5 % of what is seen may lie off its collision shapes, or of these off what is seen.
Boxes under themselves: 0; convex pieces of scissors: 0.01; one hull around a ketchup bottle 0.01, around its hollow cap
0.13 and around a mixer 0.16; a phone's half, of which the carving took the back from contact: 0.21."""


@dataclass(frozen=True)
class Rule:
    """What is asked of an asset."""

    asks: str
    """What must be so."""
    good_for: str
    """Who suffers when it is not."""


UNREAD = "its files could not be looked through"
"""Why no engine is tried."""
FILE_RULES: dict[str, Rule] = {
    "trust.sound": Rule("the reconstruction that it was made of trusts itself", "believing its shape and its joint"),
    "numbers and meshes": Rule("numbers and meshes can be read", "anything at all"),
    "tree.links-exist": Rule("joints name links that exist", "every loader"),
    "tree.one-root": Rule("one link hangs on no joint, all others on it", "every loader"),
    "tree.one-parent": Rule("no link is the child of two joints", "every loader"),
    "names.unique": Rule("links, joints, and named visuals and collisions have names of their own", "strict parsers"),
    "paths.relative": Rule("files are named relative to the file, without spaces or schemes", "moving the folder"),
    "paths.exist": Rule("files that are named exist", "every loader: some skip them without a word"),
    "inertia.present": Rule("links that move have mass and inertia", "engines invent them, each its own"),
    "inertia.physical": Rule("mass and moments are positive, the largest at most the sum of the others", "stability"),
    "inertia.centre-inside": Rule("the centre of mass lies in the collision box", "balance"),
    "inertia.fits-shape": Rule(
        f"the largest moment is {INERTIA_LOW:g} to {INERTIA_HIGH:g} times mass times squared reach of the shapes",
        "dynamics: units gone wrong (mm, g) and placeholders",
    ),
    "collision.present": Rule("what can be seen can be touched", "grasping"),
    "collision.few": Rule(f"at most {MAX_HULLS} collision shapes a link", "speed"),
    "collision.matches-visual": Rule(
        f"collision shapes lie where visuals do: within {SHIFT_SHARE:g} of the link's size (thin links: "
        f"{THIN_SHARE:g} of their width), and widths differ by at most {BENT_SHARE:g} of it",
        "grasping what is seen; scales and offsets gone wrong",
    ),
    "collision.true-to-visual": Rule(
        f"{CONTACT_PERCENT} % of what is seen of a link lies within {CONTACT_SHARE:g} of its size from the outside of "
        "its collision shapes, and the other way round; asset.json states what its files have",
        "grasping: contact that lacks, openings that are filled",
    ),
    "collision.closed": Rule("collision meshes are closed and face outwards", "contact, volume"),
    "collision.convex": Rule("collision meshes are convex", "engines take the hull: openings close"),
    "textures.exist": Rule("materials and textures that meshes name exist", "rendering"),
    "mesh.readable": Rule("visual meshes can be read and have a surface", "rendering"),
    "mesh.watertight": Rule("visual meshes are closed once equal corners are joined", "volumes, distance fields"),
    "axis.unit": Rule("joint axes have unit length", "loaders that do not normalise"),
    "limits.present": Rule("joints that end say where", "planners"),
    "limits.ordered": Rule("lower < upper", "engines that take the joint for locked, or free"),
    "limits.zero-within": Rule("zero lies within the limits", "a start that breaks a limit"),
    "limits.effort": Rule("effort is positive", "controllers that clamp to it"),
    "limits.velocity": Rule("velocity is positive", "controllers that clamp to it"),
    "parts.clear": Rule(
        f"over a joint's range, others at rest, at most {CUT_SHARE:g} of a part's surface passes through its neighbour "
        "or through a part that hangs on the same one",
        "doors that swing into their body, which engines let pass; drawers that stop each other",
    ),
    "dynamics.damped": Rule("every joint that moves has damping or friction", "doors that swing for ever"),
    "usd.same": Rule(
        "the USD layer that `export` wrote beside a URDF has its bodies, masses, joints, axes and limits",
        "USD engines: an asset that is another one there",
    ),
    "stands.on-ground": Rule(
        f"the lowest collision point lies within {1e3 * GROUND_M:g} mm of zero",
        "placing it on a table",
    ),
}
"""What can be judged from the files alone, in the order of the report."""
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
"""What is tried in each engine."""
RULES = FILE_RULES | ENGINE_RULES
