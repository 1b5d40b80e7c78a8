"""The rules by name: what each holds an asset to, and what that is good for. Ids are stable: tools may key on them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rule:
    """What is asked of an asset."""

    asks: str
    """What must be so."""
    good_for: str
    """Who suffers when it is not."""


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
    "inertia.physical": Rule("mass and moments above 0, the largest at most the sum of the others", "stability"),
    "inertia.centre-inside": Rule("the centre of mass lies in the collision box", "balance"),
    "collision.present": Rule("what can be seen can be touched", "grasping"),
    "collision.few": Rule("at most 64 collision shapes a link", "speed"),
    "collision.closed": Rule("collision meshes are closed and face outwards", "contact, volume"),
    "collision.convex": Rule("collision meshes are convex", "engines take the hull: openings close"),
    "textures.exist": Rule("materials and textures that meshes name exist", "rendering"),
    "mesh.readable": Rule("visual meshes can be read and have a surface", "rendering"),
    "mesh.watertight": Rule("visual meshes are closed once equal corners are joined", "volumes, distance fields"),
    "axis.unit": Rule("joint axes have length 1", "loaders that do not normalise"),
    "limits.present": Rule("joints that end say where", "planners"),
    "limits.ordered": Rule("lower < upper", "engines that take the joint for locked, or free"),
    "limits.zero-within": Rule("zero lies within the limits", "a start that breaks a limit"),
    "limits.effort": Rule("effort above 0", "controllers that clamp to it"),
    "limits.velocity": Rule("velocity above 0", "controllers that clamp to it"),
    "dynamics.damped": Rule("every joint that moves has damping or friction", "doors that swing for ever"),
    "stands.on-ground": Rule("the lowest collision point lies within 1 mm of z = 0", "placing it on a table"),
}
"""What can be judged from the files alone, in the order of the report."""
ENGINE_RULES: dict[str, Rule] = {
    "engine.loads": Rule("the engine loads it", "using it there"),
    "engine.tree": Rule("links, joints and parents are the file's", "finding them by name"),
    "engine.limits": Rule("limits are the file's", "planning"),
    "engine.masses": Rule("masses and moments are the file's within 1e-3", "dynamics"),
    "engine.poses": Rule("links stand within 1e-6 of the file's forward kinematics in 100 states", "everything"),
    "joint.moves": Rule("pushed, each joint reaches both limits", "opening it"),
    "joint.stops": Rule("pushed on, each joint stays within its limits", "closing it"),
    "energy.falls": Rule("moving freely, its energy never rises by more than 2 %", "stability"),
    "rest.drift": Rule("left on a plane, no link moves by more than 1 mm or 0.01 rad", "standing still"),
    "rest.oscillation": Rule("left on a plane, no link swings back three times", "standing still"),
}
"""What is tried in each engine."""
RULES = FILE_RULES | ENGINE_RULES
