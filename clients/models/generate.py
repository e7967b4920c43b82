#!/usr/bin/python3
"""Writes the models that are made of loops, beside this file.

    /usr/bin/python3 clients/models/generate.py

Python's standard library alone; the same bytes each time.
"""
import colorsys
import math
import os

HERE = os.path.dirname(os.path.abspath(__file__))


def text(value, room=118, indent=0):
    """JSON as in the models written by hand: on one line what fits there."""
    flat = one_line(value)
    if len(flat) + indent <= room or not isinstance(value, (dict, list)):
        return flat
    pad = " " * (indent + 2)
    if isinstance(value, dict):
        items = ['"%s": %s' % (k, text(v, room, indent + 2))
                 for k, v in value.items()]
        return "{\n" + pad + (",\n" + pad).join(items) + "\n" + pad[2:] + "}"
    items = [text(v, room, indent + 2) for v in value]
    return "[\n" + pad + (",\n" + pad).join(items) + "\n" + pad[2:] + "]"


def one_line(value):
    if isinstance(value, dict):
        return "{%s}" % ", ".join('"%s": %s' % (k, one_line(v))
                                  for k, v in value.items())
    if isinstance(value, (list, tuple)):
        return "[%s]" % ", ".join(one_line(v) for v in value)
    if isinstance(value, str):
        return '"%s"' % value
    rounded = round(value, 4)
    return "%d" % rounded if rounded == int(rounded) else repr(rounded)


def write(name, title, root):
    document = {"format": "blobfield/1", "name": title, "root": root}
    with open(os.path.join(HERE, name + ".json"), "w") as file:
        file.write(text(document) + "\n")


def color(hue, saturation=0.85, value=0.8):
    """Linear RGB of a hue that looks even: sRGB squared, nearly."""
    rgb = colorsys.hsv_to_rgb(hue % 1, saturation, value)
    return {"color": [round(c ** 2.2, 3) for c in rgb]}


def turn_z(angle):
    return [0, 0, math.sin(angle / 2), math.cos(angle / 2)]


def chain():
    """Five links, every other one turned by a right angle."""
    def link(i):
        node = {"type": "ref", "ref": "link", "translation": [0.94 * i, 0, 0],
                "material": color(0.08 if i % 2 else 0.58, 0.75, 0.75)}
        if i % 2:
            node["rotation"] = [math.sqrt(0.5), 0, 0, math.sqrt(0.5)]
        return node

    first = {"type": "union", "material": color(0.58, 0.75, 0.75), "children": [
        {"type": "torus", "id": "link", "center": [0, 0, 0],
         "axis": [0, 0, 1], "major": 0.5, "minor": 0.125,
         "falloff": 0.12, "scale": [1.4, 1, 1]}]}
    write("chain", "chain", {
        "type": "union", "operator": "clean", "id": "chain",
        "children": [first] + [link(i) for i in range(1, 5)]})


def torus_knot(p=2, q=3, count=60):
    """A trefoil of segments; camel keeps passing strands apart."""
    def at(i):
        t = 2 * math.pi * (i % count) / count
        r = 1.55 + 0.72 * math.cos(q * t)
        return [r * math.cos(p * t), r * math.sin(p * t),
                0.72 * math.sin(q * t)]

    write("torus-knot", "torus knot", {
        "type": "union", "operator": "camel", "id": "knot",
        "children": [{"type": "segment", "a": at(i), "b": at(i + 1),
                      "radius": 0.27, "material": color(i / count)}
                     for i in range(count)]})


def convolution():
    """The edges of a dodecahedron, convolved."""
    phi = (1 + math.sqrt(5)) / 2
    corners = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    for a in (-1 / phi, 1 / phi):
        for b in (-phi, phi):
            corners += [[0, a, b], [a, b, 0], [b, 0, a]]
    edges = [(a, b) for i, a in enumerate(corners) for b in corners[:i]
             if abs(math.dist(a, b) - 2 / phi) < 1e-6]
    write("convolution", "convolution surface", {
        "type": "convolution", "id": "dodecahedron", "radius": 0.15,
        "material": {"color": [0.06, 0.36, 0.42]},
        "elements": [{"segment": [a, b]} for a, b in edges]})


def tree():
    """Branches by camel, a crown of leaves by contact."""
    wood, leaves = [], []

    def grow(at, azimuth, tilt, length, radius, depth):
        up = [math.sin(tilt) * math.cos(azimuth),
              math.sin(tilt) * math.sin(azimuth), math.cos(tilt)]
        to = [a + length * u for a, u in zip(at, up)]
        wood.append({"type": "segment", "a": at, "b": to,
                     "radii": [radius, 0.72 * radius]})
        if depth == 0:
            leaves.append({"type": "point", "radius": 0.42, "center": [
                t + 0.22 * u for t, u in zip(to, up)],
                "material": color(0.2 + 0.14 * (len(leaves) * 0.382 % 1),
                                  0.85, 0.62)})
            return
        for k in range(3 if depth == 2 else 2):
            turn = azimuth + 0.6 + (2 * math.pi * k / 3 if depth == 2
                                    else math.pi * (k - 0.5) * 0.9)
            grow(to, turn, 0.72 if depth == 2 else 0.95 - 0.25 * k,
                 0.95 * length if depth == 2 else 0.72 * length,
                 0.72 * radius, depth - 1)

    grow([0, 0, 0], 0, 0, 1.5, 0.26, 2)
    roots = [{"type": "segment", "a": [0, 0, 0.1], "b":
              [0.55 * math.cos(a), 0.55 * math.sin(a), -0.06],
              "radii": [0.2, 0.09]} for a in (0.3, 2.2, 4.4)]
    write("tree", "tree", {
        "type": "union", "operator": "clean", "id": "tree", "children": [
            {"type": "union", "operator": "camel", "id": "wood",
             "material": {"color": [0.2, 0.085, 0.03]},
             "children": wood + roots},
            {"type": "union", "operator": "contact", "id": "leaves",
             "children": leaves}]})


def gear(teeth=16, holes=6):
    """Clean CSG, with a hub that camel blends into the web."""
    steel, bronze = {"color": [0.36, 0.4, 0.45]}, {"color": [0.7, 0.36, 0.1]}
    tooth = {"type": "taper", "id": "tooth", "axis": [1, 0, 0],
             "from": 1.2, "to": 2.0, "factor": 0.5, "child":
             {"type": "box", "center": [1.55, 0, 0],
              "half_size": [0.35, 0.23, 0.3], "rounding": 0.04,
              "falloff": 0.12}}
    ring = [tooth] + [{"type": "ref", "ref": "tooth",
                       "rotation": turn_z(2 * math.pi * i / teeth)}
                      for i in range(1, teeth)]
    hole = {"type": "cylinder", "id": "hole", "a": [0.98, 0, -1],
            "b": [0.98, 0, 1], "radius": 0.25, "falloff": 0.15,
            "material": bronze}
    cuts = [hole] + [{"type": "ref", "ref": "hole",
                      "rotation": turn_z(2 * math.pi * i / holes)}
                     for i in range(1, holes)]
    write("gear", "gear", {
        "type": "difference", "operator": "clean", "id": "gear", "children": [
            {"type": "union", "operator": "camel", "material": steel,
             "children": [
                 {"type": "union", "operator": "clean", "children": [
                     {"type": "cylinder", "id": "rim", "a": [0, 0, -0.3],
                      "b": [0, 0, 0.3], "radius": 1.45, "falloff": 0.2}]
                     + ring},
                 {"type": "cylinder", "id": "hub", "a": [0, 0, -0.6],
                  "b": [0, 0, 0.6], "radius": 0.52, "falloff": 0.3}]},
            {"type": "cylinder", "id": "bore", "a": [0, 0, -1],
             "b": [0, 0, 1], "radius": 0.28, "falloff": 0.2,
             "material": bronze}] + cuts})


def thousand(count=1000):
    """A core and 999 soft points on a sunflower's spiral about it."""
    core = {"type": "sphere", "center": [0, 0, 0], "radius": 1.5,
            "falloff": 0.3, "material": {"color": [0.1, 0.02, 0.02]}}
    golden = math.pi * (3 - math.sqrt(5))
    beads = []
    for i in range(count - 1):
        z = 1 - 2 * (i + 0.5) / (count - 1)
        r, t = math.sqrt(1 - z * z), golden * i
        beads.append({"type": "point", "radius": 0.115, "center": [
            1.5 * r * math.cos(t), 1.5 * r * math.sin(t), 1.5 * z],
            "material": color(0.02 + 0.14 * (i % 34) / 33
                                            - 0.08 * (1 - z) / 2, 0.9, 0.9)})
    write("thousand", "a thousand primitives", {
        "type": "union", "operator": "camel", "id": "all",
        "scale": [1, 1, 1.2], "children": [core] + beads})


def operators():
    """The same two bars by each built-in operator and by the sum."""
    def cross(i, operator):
        node = {"type": "sum"} if operator == "sum" else {
            "type": "union", "operator": operator}
        node["id"] = operator
        node["translation"] = [2.1 * (i % 4), 0, -2.4 * (i // 4)]
        node["material"] = color(0.53 + 0.075 * i, 0.7, 0.75)
        node["children"] = [
            {"type": "segment", "a": [-0.55, 0, 0.55],
             "b": [0.55, 0, -0.55], "radius": 0.24},
            {"type": "segment", "a": [-0.55, 0, -0.55],
             "b": [0.55, 0, 0.55], "radius": 0.24}]
        return node

    names = ["sharp", "clean", "sum", "blend", "camel", "organic", "contact",
             "own"]
    document = {"type": "union", "operator": "sharp", "id": "all",
                "children": [cross(i, n) for i, n in enumerate(names)]}
    own = {"profile": {"type": "bulge", "k": 0.4},
           "opening": {"alpha": [0.3, 1.2, 2.4], "theta": [0.7, 0.05, 0.7],
                       "w": [1, 2]}}
    with open(os.path.join(HERE, "operators.json"), "w") as file:
        file.write(text({"format": "blobfield/1", "name": "operators",
                         "operators": {"own": own}, "root": document}) + "\n")


if __name__ == "__main__":
    for make in (chain, torus_knot, convolution, tree, gear, thousand,
                 operators):
        make()
