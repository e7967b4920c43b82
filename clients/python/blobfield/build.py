"""Blob-trees from Python: a function a node, each giving a plain dict.

    letter = union(segment([-1, 0, 0], [1, 0, 0], 0.25),
                   segment([0, 0, 0], [0, 0, 1], 0.25), operator="camel")

Members that have no argument here (exponent, rounding, translation, rotation,
scale, id, ...) go by their own names: point([0, 0, 0], 1, exponent=4). color=
stands for material. What is wrong in a document is the daemon's to say.
proto/DOCUMENT.md describes all of it.
"""
from __future__ import annotations

import json
import os
from typing import Any, Dict, Mapping, Optional, Sequence, Union

import numpy as np

Node = Dict[str, Any]
Vector = Sequence[float]
#: A document, a bare node (which becomes the root of one), JSON text, or the
#: path of a file of it.
DocumentLike = Union[Mapping[str, Any], str, bytes, "os.PathLike[str]"]

FORMAT = "blobfield/1"


def node(type: str, **members: Any) -> Node:
    """Any node: members that are None are left out."""
    made: Node = {"type": type}
    color = members.pop("color", None)
    if color is not None:
        made["material"] = {"color": color}
    made.update((k, v) for k, v in members.items() if v is not None)
    return made


def point(center: Vector, radius: float, **more: Any) -> Node:
    return node("point", center=center, radius=radius, **more)


def segment(a: Vector, b: Vector, radius: Union[float, Vector],
            **more: Any) -> Node:
    """radius: one, or two, at a and at b."""
    name = "radius" if np.ndim(radius) == 0 else "radii"
    return node("segment", a=a, b=b, **{name: radius}, **more)


def triangle(a: Vector, b: Vector, c: Vector, radius: float,
             **more: Any) -> Node:
    return node("triangle", a=a, b=b, c=c, radius=radius, **more)


def sphere(center: Vector, radius: float, falloff: float,
           **more: Any) -> Node:
    return node("sphere", center=center, radius=radius, falloff=falloff,
                **more)


def box(center: Vector, half_size: Vector, falloff: float,
        **more: Any) -> Node:
    return node("box", center=center, half_size=half_size, falloff=falloff,
                **more)


def cylinder(a: Vector, b: Vector, radius: float, falloff: float,
             **more: Any) -> Node:
    return node("cylinder", a=a, b=b, radius=radius, falloff=falloff, **more)


def capsule(a: Vector, b: Vector, radius: float, falloff: float,
            **more: Any) -> Node:
    return node("capsule", a=a, b=b, radius=radius, falloff=falloff, **more)


def torus(center: Vector, axis: Vector, major: float, minor: float,
          falloff: float, **more: Any) -> Node:
    return node("torus", center=center, axis=axis, major=major, minor=minor,
                falloff=falloff, **more)


def union(*children: Node, operator: Union[str, Node, None] = None,
          **more: Any) -> Node:
    return node("union", children=list(children), operator=operator, **more)


def intersection(*children: Node, operator: Union[str, Node, None] = None,
                 **more: Any) -> Node:
    return node("intersection", children=list(children), operator=operator,
                **more)


def difference(*children: Node, operator: Union[str, Node, None] = None,
               **more: Any) -> Node:
    """The first without the others."""
    return node("difference", children=list(children), operator=operator,
                **more)


def ref(id: str, **more: Any) -> Node:
    """The node of that id again."""
    return node("ref", ref=id, **more)


def document(root: Node, name: Optional[str] = None, **more: Any) -> Node:
    """A whole document; more: operators, null_gradient."""
    made: Node = {"format": FORMAT}
    if name is not None:
        made["name"] = name
    made.update((k, v) for k, v in more.items() if v is not None)
    made["root"] = root
    return made


def document_bytes(given: DocumentLike) -> bytes:
    """JSON text of it. ValueError: numbers that JSON does not have."""
    if isinstance(given, bytes):
        return given
    if isinstance(given, str):
        return given.encode()
    if isinstance(given, os.PathLike):
        with open(given, "rb") as file:
            return file.read()
    whole = dict(given)
    if "format" not in whole and "type" in whole:
        whole = document(whole)
    return json_bytes(whole)


def json_bytes(given: Any) -> bytes:
    """JSON of plain values, and of NumPy's."""
    return json.dumps(given, default=_plain, allow_nan=False,
                      separators=(",", ":")).encode()


def _plain(given: Any) -> Any:
    if isinstance(given, (np.ndarray, np.generic)):
        return given.tolist()
    if isinstance(given, (set, frozenset)) or not hasattr(given, "__iter__"):
        raise TypeError(f"{type(given).__name__} is not part of a document")
    return list(given)


def leaf_pointers(given: Mapping[str, Any]) -> Sequence[str]:
    """JSON pointers of a document's primitives in its own order, refs not
    followed: what the numbers of Hits.leaf count."""
    found = []
    waiting = [(given["root"], "/root")]
    while waiting:
        at, pointer = waiting.pop()
        if "children" in at:
            waiting.extend(reversed([
                (c, f"{pointer}/children/{i}")
                for i, c in enumerate(at["children"])]))
        elif "child" in at:
            waiting.append((at["child"], pointer + "/child"))
        elif at.get("type") != "ref":
            found.append(pointer)
    return found
