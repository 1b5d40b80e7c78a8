"""Writes an asset as USD from its URDF: UsdGeom meshes, UsdPhysics bodies and joints; metres, kilograms, z up.

UsdPhysics has no joint friction. Coulomb friction is written for two engines: as `staticFrictionEffort` and
`dynamicFrictionEffort` of NVIDIA's PhysxJointAxisAPI (PhysX 5.6, Isaac Sim 5; N m or N), and as `newton:friction`.
PhysX's older `physxJoint:jointFriction` is a coefficient of the joint's load, a different law, and is not written.
Neither schema is part of usd-core; their names are plain tokens that other readers ignore.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from export.checklist import MAX_MESH_BYTES, values_after
from export.loaders import joint_numbers
from export.model import WORLD
from export.stated_trust import MARK
from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.urdf import UrdfInertial, UrdfJoint, UrdfLink, UrdfShape, read_urdf
from freeart21.files.urdf_files import resolve_file
from freeart21.reconstruction import describe_trust
from freeart21.se3 import Array


def write_usd(path: Path, asset: Asset) -> None:
    """Write the asset as a USD layer beside its URDF, binary when `path` ends in .usdc. Textures stay in
    their files."""
    urdf = read_urdf(asset.urdf)
    layer = Sdf.Layer.CreateAnonymous(path.suffix)
    stage = Usd.Stage.Open(layer)
    layer.documentation = f"{MARK}{describe_trust(asset.trust)}"
    layer.customLayerData = {"freeart21:trust": describe_trust(asset.trust)}
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, f"/{_identifier(urdf.name or 'object')}")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind(Kind.Tokens.component)
    poses = urdf.link_poses(asset.held)
    bodies: dict[str, Any] = {}
    surfaces: Any = joint_numbers(asset)["surfaces"]
    for name, link in urdf.links.items():
        if not (name == WORLD == urdf.root):
            bodies[name] = _add_body(stage, root.GetPath(), link, poses[name], asset.urdf, surfaces.get(name))
    for joint in urdf.joints.values():
        _add_joint(stage, root.GetPath(), joint, bodies, asset)
    if urdf.root in bodies:
        UsdPhysics.ArticulationRootAPI.Apply(bodies[urdf.root].GetPrim())
    with tempfile.TemporaryDirectory() as folder:
        exported = Path(folder) / path.name
        layer.Export(str(exported))
        atomic.write_bytes(path, exported.read_bytes())


def _identifier(name: str) -> str:
    return str(Tf.MakeValidIdentifier(name))


def _add_body(
    stage: Any, root: Any, link: UrdfLink, T_root_link: Array, urdf: Path, surface: dict[str, float] | None
) -> Any:
    """A rigid body with its visual and collision shapes, these with friction and restitution where `surface` has
    them."""
    body = UsdGeom.Xform.Define(stage, root.AppendChild(_identifier(link.name)))
    _set_pose(body, T_root_link)
    UsdPhysics.RigidBodyAPI.Apply(body.GetPrim())
    if link.inertial is not None:
        _add_mass(body, link.inertial)
    for k, shape in enumerate(link.visuals):
        geom = _add_shape(stage, body.GetPath().AppendChild(f"visual_{k:02d}"), shape, urdf)
        _add_material(stage, root, f"{link.name}_{k:02d}", geom, shape, urdf)
    if surface:
        stage.DefinePrim(root.AppendChild("Looks"), "Scope")
        contact = UsdShade.Material.Define(
            stage, root.AppendChild("Looks").AppendChild(_identifier(f"{link.name}_contact"))
        )
        physics = UsdPhysics.MaterialAPI.Apply(contact.GetPrim())
        physics.CreateStaticFrictionAttr(surface["friction"])
        physics.CreateDynamicFrictionAttr(surface["friction"])
        physics.CreateRestitutionAttr(surface["restitution"])
    for k, shape in enumerate(link.collisions):
        geom = _add_shape(stage, body.GetPath().AppendChild(f"collision_{k:02d}"), shape, urdf)
        geom.CreatePurposeAttr(UsdGeom.Tokens.guide)
        UsdPhysics.CollisionAPI.Apply(geom.GetPrim())
        if shape.kind == "mesh":
            approximation = UsdPhysics.MeshCollisionAPI.Apply(geom.GetPrim())
            approximation.CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
        if surface:
            UsdShade.MaterialBindingAPI.Apply(geom.GetPrim()).Bind(contact, materialPurpose="physics")
    return body


def _add_mass(body: Any, of: UrdfInertial) -> None:
    """Mass, and inertia as moments about principal axes."""
    moments, axes = np.linalg.eigh(of.inertia)
    axes = axes * np.where(axes[np.abs(axes).argmax(0), range(3)] < 0, -1.0, 1.0)  # fix the sign of each axis
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    mass = UsdPhysics.MassAPI.Apply(body.GetPrim())
    mass.CreateMassAttr(of.mass)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*of.centre.tolist()))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
    mass.CreatePrincipalAxesAttr(_quaternion(se3.pose(axes, np.zeros(3))))


def _add_joint(stage: Any, root: Any, joint: UrdfJoint, bodies: dict[str, Any], asset: Asset) -> None:
    """The joint between two bodies, or between the world and a fixed base."""
    kinds = {"revolute": UsdPhysics.RevoluteJoint, "prismatic": UsdPhysics.PrismaticJoint, None: UsdPhysics.FixedJoint}
    schema = kinds[joint.joint_type].Define(stage, root.AppendChild(_identifier(joint.name)))
    along_x = _rotation_from_x(joint.axis) if joint.joint_type else np.eye(4)
    if joint.parent in bodies:
        schema.CreateBody0Rel().SetTargets([bodies[joint.parent].GetPath()])
    else:
        UsdPhysics.ArticulationRootAPI.Apply(schema.GetPrim())
    schema.CreateBody1Rel().SetTargets([bodies[joint.child].GetPath()])
    schema.CreateLocalPos0Attr(Gf.Vec3f(*joint.T_parent_joint[:3, 3].tolist()))
    schema.CreateLocalRot0Attr(_quaternion(joint.T_parent_joint @ along_x))
    schema.CreateLocalPos1Attr(Gf.Vec3f(0.0))
    schema.CreateLocalRot1Attr(_quaternion(along_x))
    if joint.joint_type is None:
        return
    per_unit = float(np.degrees(1.0)) if joint.joint_type == "revolute" else 1.0  # UsdPhysics counts degrees
    schema.CreateAxisAttr(UsdPhysics.Tokens.x)
    if np.isfinite([joint.lower, joint.upper]).all():
        schema.CreateLowerLimitAttr(per_unit * joint.lower)
        schema.CreateUpperLimitAttr(per_unit * joint.upper)
    if joint.name == asset.joint:
        _add_dynamics(schema.GetPrim(), joint, joint_numbers(asset), per_unit)


def _add_dynamics(prim: Any, joint: UrdfJoint, numbers: dict[str, Any], per_unit: float) -> None:
    """Damping and spring as a drive, per degree; friction, armature and speed limit as attributes of the engines."""
    axis = {"revolute": "angular", "prismatic": "linear"}[numbers["type"]]
    drive = UsdPhysics.DriveAPI.Apply(prim, axis)
    drive.CreateTypeAttr("force")
    drive.CreateDampingAttr(numbers["damping"] / per_unit)
    drive.CreateStiffnessAttr(numbers["stiffness"] / per_unit)
    drive.CreateTargetPositionAttr(numbers["rest"] * per_unit)
    if joint.effort is not None:
        drive.CreateMaxForceAttr(joint.effort)
    values = {
        f"physxJointAxis:{axis}:staticFrictionEffort": numbers["friction"],
        f"physxJointAxis:{axis}:dynamicFrictionEffort": numbers["friction"],
        f"physxJointAxis:{axis}:armature": numbers["armature"],
        "newton:friction": numbers["friction"],
        "newton:armature": numbers["armature"],
    }
    if joint.velocity is not None:
        values[f"physxJointAxis:{axis}:maxJointVelocity"] = joint.velocity * per_unit
        values["newton:velocityLimit"] = joint.velocity * per_unit
    for schema in (f"PhysxJointAxisAPI:{axis}", "NewtonJointAPI"):
        prim.AddAppliedSchema(schema)
    for name, value in values.items():
        prim.CreateAttribute(name, Sdf.ValueTypeNames.Float, False).Set(float(value))


def _add_shape(stage: Any, path: Any, shape: UrdfShape, urdf: Path) -> Any:
    """The shape at its pose in its link."""
    match shape.kind:
        case "mesh":
            geom = _fill_mesh(UsdGeom.Mesh.Define(stage, path), shape, urdf)
            _set_pose(geom, shape.T_link_shape)
            return geom
        case "box":
            geom = UsdGeom.Cube.Define(stage, path)
            geom.CreateSizeAttr(1.0)
            geom.CreateExtentAttr([Gf.Vec3f(-0.5), Gf.Vec3f(0.5)])
            _set_pose(geom, shape.T_link_shape)
            geom.AddScaleOp().Set(Gf.Vec3f(*shape.size.tolist()))
            return geom
        case "sphere":
            geom = UsdGeom.Sphere.Define(stage, path)
            geom.CreateRadiusAttr(float(shape.size[0]))
        case "cylinder":
            geom = UsdGeom.Cylinder.Define(stage, path)
            geom.CreateRadiusAttr(float(shape.size[0]))
            geom.CreateHeightAttr(float(shape.size[1]))
            geom.CreateAxisAttr(UsdGeom.Tokens.z)
        case _:
            raise FreeArtError(f"{urdf} has a shape '{shape.kind}', expected mesh, box, sphere or cylinder")
    half = np.array([shape.size[0], shape.size[0], 0.5 * shape.size[1] if len(shape.size) > 1 else shape.size[0]])
    geom.CreateExtentAttr([Gf.Vec3f(*(-half).tolist()), Gf.Vec3f(*half.tolist())])
    _set_pose(geom, shape.T_link_shape)
    return geom


def _fill_mesh(geom: Any, shape: UrdfShape, urdf: Path) -> Any:
    path = resolve_file(urdf, shape.filename)
    mesh = trimesh.load_mesh(checked.require_file(path, MAX_MESH_BYTES), process=False)
    points = np.ascontiguousarray(mesh.vertices * shape.size, np.float32)
    geom.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    geom.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
    geom.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(mesh.faces.reshape(-1), np.int32)))
    geom.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)])))
    geom.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    uv = getattr(mesh.visual, "uv", None)
    if uv is not None and len(uv) == len(points):
        st = UsdGeom.PrimvarsAPI(geom).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
        st.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(uv, np.float32)))
        normals = np.ascontiguousarray(mesh.vertex_normals, np.float32)
        geom.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
        geom.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    return geom


def _add_material(stage: Any, root: Any, name: str, geom: Any, shape: UrdfShape, urdf: Path) -> None:
    """UsdPreviewSurface with the texture or colour of the mesh's first material."""
    picture, colour = _read_material(resolve_file(urdf, shape.filename)) if shape.kind == "mesh" else (None, None)
    if colour is None:
        colour = (0.7, 0.7, 0.7) if shape.rgba is None else tuple(shape.rgba[:3].tolist())
    stage.DefinePrim(root.AppendChild("Looks"), "Scope")
    path = root.AppendChild("Looks").AppendChild(_identifier(name))
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, path.AppendChild("surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(1.0)
    diffuse = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    if picture is None:
        diffuse.Set(Gf.Vec3f(*colour))
    else:
        reader = UsdShade.Shader.Define(stage, path.AppendChild("st"))
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        where = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        texture = UsdShade.Shader.Define(stage, path.AppendChild("picture"))
        texture.CreateIdAttr("UsdUVTexture")
        file = f"./{picture.relative_to(urdf.parent.resolve()).as_posix()}"
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(file))
        texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(where)
        diffuse.ConnectToSource(texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3))
    output = surface.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(output)
    UsdShade.MaterialBindingAPI.Apply(geom.GetPrim()).Bind(material)


def _read_material(obj: Path) -> tuple[Path | None, tuple[float, ...] | None]:
    """Texture and colour of the first material of an OBJ file; None where missing."""
    libraries = values_after(obj, "mtllib") if obj.suffix.lower() == ".obj" else []
    mtl = obj.parent / libraries[0] if libraries else None
    if mtl is None or not mtl.is_file():
        return None, None
    pictures, colours = values_after(mtl, "map_Kd"), values_after(mtl, "Kd")
    found = checked.inside(obj.parent, pictures[0]) if pictures else None
    return found, tuple(float(word) for word in colours[0].split()) if colours else None


def _set_pose(geom: Any, T: Array) -> None:
    geom.AddTranslateOp().Set(Gf.Vec3d(*T[:3, 3].tolist()))
    geom.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(*np.asarray(se3.wxyz(T), float).tolist()))


def _quaternion(T: Array) -> Any:
    return Gf.Quatf(*np.asarray(se3.wxyz(T), float).tolist())


def _rotation_from_x(axis: Array) -> Array:
    """(4, 4) the shortest rotation from x to the unit vector `axis`."""
    x = np.eye(3)[0]
    across = np.cross(x, axis)
    sine, cosine = float(np.linalg.norm(across)), float(axis @ x)
    across = across / sine if sine > 1e-12 else np.eye(3)[2]
    return se3.pose(se3.exp_so3(np.arctan2(sine, cosine) * across), np.zeros(3))
