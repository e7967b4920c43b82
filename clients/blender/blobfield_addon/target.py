"""The object that shows the surface."""
import bpy
import numpy as np

NAME = "Blobfield"
COLOR = "Color"


def apply(scene, mesh, smooth):
    """Puts a client's Mesh into the scene's target object, made if missing.
    Its transform, modifiers and materials stay."""
    ob = ensure(scene)
    data = ob.data
    data.clear_geometry()
    for attribute in list(data.color_attributes):
        data.color_attributes.remove(attribute)
    fill(data, mesh, smooth)
    if mesh.colors is not None and not data.materials:
        data.materials.append(_material())
    return ob


def ensure(scene):
    settings = scene.blobfield
    ob = settings.target
    if ob is not None and ob.type == "MESH":
        if ob.name not in scene.objects:
            scene.collection.objects.link(ob)
        return ob
    ob = bpy.data.objects.new(NAME, bpy.data.meshes.new(NAME))
    scene.collection.objects.link(ob)
    settings.target = ob
    return ob


def fill(data, mesh, smooth):
    """Geometry, normals and colours of an empty Blender mesh."""
    n, t = len(mesh.vertices), len(mesh.triangles)
    if not n:
        data.update()
        return
    data.vertices.add(n)
    data.vertices.foreach_set("co", _flat(mesh.vertices))
    data.loops.add(3 * t)
    data.loops.foreach_set("vertex_index",
                           mesh.triangles.astype(np.int32).reshape(-1))
    data.polygons.add(t)
    data.polygons.foreach_set("loop_start",
                              np.arange(0, 3 * t, 3, dtype=np.int32))
    data.polygons.foreach_set("loop_total", np.full(t, 3, np.int32))
    data.polygons.foreach_set("use_smooth", np.full(t, smooth, bool))
    data.update(calc_edges=True)
    if smooth and mesh.normals is not None:
        data.use_auto_smooth = True  # custom normals need it
        data.normals_split_custom_set_from_vertices(mesh.normals)
    if mesh.colors is not None:
        layer = data.color_attributes.new(COLOR, "FLOAT_COLOR", "POINT")
        rgba = np.ones((n, 4), np.float32)
        rgba[:, :3] = mesh.colors
        layer.data.foreach_set("color", rgba.reshape(-1))


def _flat(a):
    return np.ascontiguousarray(a, np.float32).reshape(-1)


def _material():
    """One that shows the vertices' colours."""
    material = bpy.data.materials.get(NAME)
    if material is not None:
        return material
    material = bpy.data.materials.new(NAME)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    attribute = nodes.new("ShaderNodeVertexColor")
    attribute.layer_name = COLOR
    attribute.location = (-250, 250)
    surface = next(n for n in nodes if n.type == "BSDF_PRINCIPLED")
    material.node_tree.links.new(attribute.outputs["Color"],
                                 surface.inputs["Base Color"])
    return material
