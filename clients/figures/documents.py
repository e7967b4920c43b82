"""The documents that figures are made of."""
import copy
import json
import math
import os

MODELS = os.path.join(os.path.dirname(os.path.dirname(
    os.path.abspath(__file__))), "models")
BLUE, ORANGE = [0.04, 0.3, 0.42], [0.85, 0.42, 0.08]
RED, CREAM = [0.7, 0.13, 0.06], [0.8, 0.7, 0.5]


def model(name):
    with open(os.path.join(MODELS, name + ".json")) as file:
        return json.load(file)


def document(root, **members):
    return dict({"format": "blobfield/1", "root": root}, **members)


def paint(color):
    return {"color": color}


def segment(a, b, radius, color=BLUE):
    return {"type": "segment", "a": a, "b": b, "radius": radius,
            "material": paint(color)}


def point(center, radius, color=BLUE):
    return {"type": "point", "center": center, "radius": radius,
            "material": paint(color)}


def compose(operator, children):
    """A union by the operator; "sum" is the classic one."""
    if operator == "sum":
        return {"type": "sum", "children": children}
    return {"type": "union", "operator": operator, "children": children}


def joined(operator, children):
    return document(compose(operator, children))


def with_operator(doc, operator):
    """The document with all its unions made by another operator."""
    def walk(node):
        for child in node.get("children", []):
            walk(child)
        if "child" in node:
            walk(node["child"])
        if node["type"] in ("union", "sum"):
            node.pop("operator", None)
            node["type"] = "sum" if operator == "sum" else "union"
            if operator != "sum":
                node["operator"] = operator

    doc = copy.deepcopy(doc)
    walk(doc["root"])
    return doc


def half_space(angle):
    """A plane through the y axis whose outward normal is at angle from x."""
    return {"type": "plane", "point": [0, 0, 0], "falloff": 1,
            "normal": [math.cos(angle), 0, math.sin(angle)]}


def constant(theta, profile="smooth"):
    return {"profile": profile, "opening": {"theta": theta}}


def bars(operator, angle, radius=0.25, length=1.1):
    """Two bars crossing at the origin in the plane y = 0."""
    c, s = length * math.cos(angle / 2), length * math.sin(angle / 2)
    return joined(operator, [
        segment([-c, 0, -s], [c, 0, s], radius, BLUE),
        segment([-c, 0, s], [c, 0, -s], radius, ORANGE)])


def ball_on_bar(operator):
    """In the plane y = 0: gradients at every angle."""
    return joined(operator, [
        segment([-1.1, 0, -0.1], [1.1, 0, -0.1], 0.22, BLUE),
        point([0.1, 0, 0.32], 0.36, ORANGE)])


def apart(operator, gap=0.12, radius=0.3):
    """Two bars that pass each other at right angles, gap between them."""
    z = radius + gap / 2
    return joined(operator, [
        segment([-1.1, 0, -z], [1.1, 0, -z], radius, BLUE),
        segment([0, -1.1, z], [0, 1.1, z], radius, ORANGE)])


def spiked(operator, spikes=True):
    """A large ball with small spikes."""
    children = [point([0, 0, 0], 1, BLUE)]
    for x, z in ((-0.55, 0.3), (0, 0.45), (0.5, 0.2), (-0.25, -0.3),
                 (0.3, -0.35)) if spikes else ():
        y = -math.sqrt(1 - x * x - z * z)
        children.append(segment([0.95 * x, 0.95 * y, 0.95 * z],
                                [1.18 * x, 1.18 * y, 1.18 * z], 0.07, ORANGE))
    return joined(operator, children)


def letter(operator, radius):
    """The letter A with strokes of a radius."""
    return joined(operator, [
        segment([-1, 0, 0], [0, 0, 2.6], radius, RED),
        segment([1, 0, 0], [0, 0, 2.6], radius, RED),
        segment([-0.69, 0, 0.8], [0.69, 0, 0.8], 0.8 * radius, ORANGE)])


def tee_by_table(layout, resolution):
    return document(compose({"profile": "smooth", "opening": "camel",
                             "layout": layout, "resolution": resolution}, [
        segment([-1, 0, 0], [1, 0, 0], 0.3, BLUE),
        segment([0, 0, -1.2], [0, 0, 0], 0.3, BLUE)]))


def on_cube(operator):
    return document(compose(operator, [
        {"type": "box", "center": [0, 0, 0.8], "half_size": [0.8, 0.8, 0.8],
         "rounding": 0.12, "falloff": 0.7, "material": paint(BLUE)},
        {"type": "sphere", "center": [0, 0, 1.9], "radius": 0.65,
         "falloff": 0.6, "material": paint(ORANGE)}]))


def lava(operator, time):
    """The lava of a lamp: a blob leaves the pool, another comes back."""
    up, down = time, 1 - time
    warm = [0.9, 0.16, 0.02]
    return joined(operator, [
        {"type": "disc", "center": [0, 0, 0], "normal": [0, 0, 1],
         "disc_radius": 0.45, "radius": 0.22, "material": paint(RED)},
        point([0.02, 0, -0.05 + 1.5 * up], 0.3, warm),
        point([-0.12, 0, 0.75 + 1.35 * down], 0.22, [0.95, 0.4, 0.04]),
        point([0.1, 0, 2.35 + 0.1 * math.sin(6 * time)], 0.26,
              [0.95, 0.5, 0.06])])


def elbow(operator, angle):
    """A joint: two segments, the fore one turned up by angle."""
    return joined(operator, [
        {"type": "segment", "a": [-1.4, 0, 0], "b": [0, 0, 0],
         "radii": [0.36, 0.3], "material": paint([0.72, 0.4, 0.26])},
        {"type": "segment", "a": [0, 0, 0],
         "b": [1.3 * math.cos(angle), 0, 1.3 * math.sin(angle)],
         "radii": [0.3, 0.22], "material": paint([0.72, 0.4, 0.26])}])
