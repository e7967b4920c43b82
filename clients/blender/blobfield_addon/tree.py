"""Blob-trees from Blender's objects.

A collection becomes a composition of its objects and of the collections in it;
objects marked as cuts are taken away from the rest. Nodes are in the object's
own frame, with its world matrix, so that scaling stretches them and their
fall-offs.

    empty, by its display: cube -> box, circle -> circle, cone -> cone,
                           any other -> point, of the radius of its display
    curve, poly and Bezier -> segments, of the points' radii times the bevel's
                           depth (the object's radius without bevel)
    mesh, a cube           -> box
"""
import json

from mathutils.geometry import interpolate_bezier

from .wire import blobfield

# Blender draws an empty's circle and cone about its Y axis, a cone twice as
# high as its base's radius.
AXIS = [0, 1, 0]
DETERMINANT_LEAST = 1e-12


class TreeError(Exception):
    """The objects make no tree; the message is for people."""


class Tree:
    """A document and where its nodes come from: (pointer, object's name)."""

    def __init__(self, document, origins):
        self.document = document
        self.origins = origins

    def origin(self, pointer):
        """The name of the object that a JSON pointer leads into, and the rest
        of the pointer; None and all of it where there is none."""
        best = max((o for o in self.origins
                    if (pointer + "/").startswith(o[0] + "/")),
                   key=lambda o: len(o[0]), default=("", None))
        return best[1], pointer[len(best[0]):]


def from_collection(collection, operator, skip=None):
    """The Tree of a collection, without the object skip. TreeError: nothing
    is in it, or an object cannot be meant."""
    root, origins = _collection(collection, operator, "/root", skip)
    if root is None:
        raise TreeError(f"nothing to blend in the collection "
                        f"'{collection.name}': add empties or curves to it")
    return Tree(blobfield.document(root, name=collection.name[:64]), origins)


def _collection(collection, operator, pointer, skip):
    """The node of a collection, None if it is empty, and its origins."""
    own = collection.blobfield.operator
    operator = operator if own == "INHERIT" else own
    made = []  # (node, cut, origins below the node: (suffix, name))
    for ob in sorted(collection.objects, key=lambda o: o.name):
        node = None if ob == skip else object_node(ob)
        if node is not None:
            made.append((node, ob.blobfield.cut, [("", ob.name)]))
    for child in sorted(collection.children, key=lambda c: c.name):
        node, origins = _collection(child, operator, "", skip)
        if node is not None:
            made.append((node, child.blobfield.cut, origins))
    solid = [m for m in made if not m[1]]
    cuts = [m for m in made if m[1]]
    if not solid:
        return None, []
    whole, origins = _composition(solid, operator, pointer if not cuts
                                  else pointer + "/children/0")
    if cuts:
        for i, (_, _, below) in enumerate(cuts):
            origins += [(f"{pointer}/children/{i + 1}{s}", name)
                        for s, name in below]
        whole = blobfield.difference(
            whole, *(m[0] for m in cuts),
            operator=None if operator == "sum" else operator)
    return whole, origins


def _composition(parts, operator, pointer):
    if len(parts) == 1:
        return parts[0][0], [(pointer + s, n) for s, n in parts[0][2]]
    nodes = [p[0] for p in parts]
    origins = [(f"{pointer}/children/{i}{s}", n)
               for i, p in enumerate(parts) for s, n in p[2]]
    if operator == "sum":
        return blobfield.node("sum", children=nodes), origins
    return blobfield.union(*nodes, operator=operator), origins


def object_node(ob):
    """The node of an object, None if it is no part of the model."""
    kind = ob.blobfield.kind
    if kind == "NONE" or ob.hide_viewport:
        return None
    if kind == "NODE":
        node = _written(ob)
    elif ob.type == "EMPTY":
        node = _empty(ob, kind)
    elif ob.type == "CURVE":
        node = _curve(ob)
    elif ob.type == "MESH" and (kind == "BOX" or _is_cube(ob.data)):
        node = _bounding_box(ob)
    else:
        return None
    if node is None:
        return None
    matrix = ob.matrix_world
    if abs(matrix.to_3x3().determinant()) < DETERMINANT_LEAST:
        raise TreeError(f"'{ob.name}' is scaled to nothing")
    node["matrix"] = [x for column in matrix.transposed() for x in column]
    node["matrix"][3::4] = [0, 0, 0, 1]
    color = object_color(ob)
    if color is not None and "material" not in node:
        node["material"] = {"color": color}
    return node


def _written(ob):
    try:
        node = json.loads(ob.blobfield.node)
    except ValueError as e:
        raise TreeError(f"the node of '{ob.name}' is not JSON: {e}") from e
    if not isinstance(node, dict) or "type" not in node:
        raise TreeError(f"the node of '{ob.name}' must be an object with a "
                        "'type'")
    # The object's transform would be hidden by the node's own.
    for member in ("matrix", "translation", "rotation", "scale"):
        if member in node:
            raise TreeError(f"the node of '{ob.name}' may have no '{member}': "
                            "the object has it")
    return node


def _empty(ob, kind):
    size = ob.empty_display_size
    own = ob.blobfield
    if kind == "AUTO":
        kind = {"CUBE": "BOX", "CIRCLE": "CIRCLE", "CONE": "CONE"}.get(
            ob.empty_display_type, "POINT")
    o = [0, 0, 0]
    if kind == "SPHERE":
        return blobfield.sphere(o, size, own.falloff)
    if kind == "BOX":
        return blobfield.box(o, [size] * 3, own.falloff)
    if kind == "CIRCLE":
        return blobfield.node("circle", center=o, normal=AXIS,
                              ring_radius=size, radius=own.radius)
    if kind == "TORUS":
        return blobfield.torus(o, AXIS, size, own.radius, own.falloff)
    if kind == "CONE":
        return blobfield.node("cone", a=o, b=[0, 2 * size, 0],
                              radii=[size, 0], falloff=own.falloff)
    return blobfield.point(o, size)


def _is_cube(mesh):
    return len(mesh.vertices) == 8 and len(mesh.polygons) == 6


def _bounding_box(ob):
    low = [min(c[i] for c in ob.bound_box) for i in range(3)]
    high = [max(c[i] for c in ob.bound_box) for i in range(3)]
    return blobfield.box([(a + b) / 2 for a, b in zip(low, high)],
                         [(b - a) / 2 for a, b in zip(low, high)],
                         ob.blobfield.falloff)


def _curve(ob):
    depth = ob.data.bevel_depth or ob.blobfield.radius
    segments = []
    for spline in ob.data.splines:
        places = _spline(ob, spline)
        if len(places) == 1:
            places = places * 2
        if spline.use_cyclic_u:
            places.append(places[0])
        for (a, r), (b, s) in zip(places, places[1:]):
            radius = r * depth if r == s else [r * depth, s * depth]
            segments.append(blobfield.segment(list(a), list(b), radius))
    if not segments:
        return None
    if len(segments) == 1:
        return segments[0]
    # Consecutive segments agree about their common end, so that the largest
    # is all a tube needs; clean keeps its gradient continuous beside.
    return blobfield.union(*segments, operator="clean")


def _spline(ob, spline):
    """(place, radius) along a spline."""
    if spline.type == "POLY":
        return [(tuple(p.co[:3]), p.radius) for p in spline.points]
    if spline.type == "BEZIER":
        return _bezier(spline)
    raise TreeError(f"'{ob.name}' has a NURBS spline: make it a Bezier or "
                    "poly spline")


def _bezier(spline):
    knots = list(spline.bezier_points)
    places = [(tuple(knots[0].co), knots[0].radius)]
    n = max(spline.resolution_u, 1)
    following = knots[1:] + (knots[:1] if spline.use_cyclic_u else [])
    for p, q in zip(knots, following):
        curve = interpolate_bezier(p.co, p.handle_right, q.handle_left, q.co,
                                   n + 1)
        places += [(tuple(c), p.radius + (q.radius - p.radius) * (i + 1) / n)
                   for i, c in enumerate(curve[1:])]
    if spline.use_cyclic_u:
        places.pop()
    return places


def object_color(ob):
    """Linear RGB of the first material, or of the object where that is not
    white; None where there is neither."""
    for slot in ob.material_slots:
        if slot.material is not None:
            return _clamped(_material_color(slot.material))
    if tuple(ob.color[:3]) != (1, 1, 1):
        return _clamped(ob.color)
    return None


def _material_color(material):
    if material.use_nodes and material.node_tree:
        for node in material.node_tree.nodes:
            if node.type == "BSDF_PRINCIPLED":
                return node.inputs["Base Color"].default_value
    return material.diffuse_color


def _clamped(color):
    return [min(max(c, 0.0), 1.0) for c in color[:3]]
