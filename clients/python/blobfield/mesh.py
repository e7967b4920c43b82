"""Triangle meshes, read from glTF 2.0 binary files."""
from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from typing import Any, Dict, Optional

import numpy as np
import numpy.typing as npt

from .arrays import Floats
from .transport import Body

# glTF's component types and the numbers of a type.
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2",
               5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass
class Mesh:
    """Closed, 2-manifold, counter-clockwise from outside, in world units,
    Z up.

    vertices (V, 3) float32; triangles (T, 3) uint32; normals (V, 3), unit and
    outward, and colors (V, 3), linear RGB, or None if not asked for. figures:
    what the daemon says of it (genus, area, volume, seconds, ...). An empty
    surface has V = T = 0.
    """

    vertices: Floats
    triangles: npt.NDArray[np.uint32]
    normals: Optional[Floats] = None
    colors: Optional[Floats] = None
    figures: Dict[str, Any] = field(default_factory=dict)
    revision: Optional[str] = None

    @classmethod
    def from_glb(cls, data: Body) -> "Mesh":
        """Of the first primitive of a .glb file, without its node's transform.
        ValueError: no such file."""
        head, binary = _chunks(data)
        figures = (head.get("asset", {}).get("extras", {})
                   .get("blobfield", {}))
        if not head.get("meshes"):
            return cls(np.zeros((0, 3), "<f4"), np.zeros((0, 3), "<u4"),
                       figures=figures)
        primitive = head["meshes"][0]["primitives"][0]
        parts = primitive["attributes"]
        vertices = _accessor(head, binary, parts["POSITION"])
        triangles = np.ascontiguousarray(
            _accessor(head, binary, primitive["indices"]).reshape(-1, 3),
            np.uint32)
        normals = colors = None
        if "NORMAL" in parts:
            normals = _accessor(head, binary, parts["NORMAL"])
        if "COLOR_0" in parts:
            colors = _accessor(head, binary, parts["COLOR_0"])[:, :3]
        return cls(vertices, triangles, normals, colors, figures)


def _chunks(data: Body) -> "tuple[Dict[str, Any], memoryview]":
    """The JSON and the binary chunk."""
    view = memoryview(data)
    if len(view) < 20 or bytes(view[:4]) != b"glTF":
        raise ValueError("not a binary glTF file")
    head: Dict[str, Any] = {}
    binary = view[:0]
    at = 12
    while at + 8 <= len(view):
        length, kind = struct.unpack_from("<I4s", view, at)
        chunk = view[at + 8:at + 8 + length]
        if len(chunk) < length:
            raise ValueError("a binary glTF file that is cut short")
        if kind == b"JSON":
            head = json.loads(bytes(chunk))
        elif kind == b"BIN\0":
            binary = chunk
        at += 8 + length
    return head, binary


def _accessor(head: Dict[str, Any], binary: memoryview, index: int) -> Any:
    accessor = head["accessors"][index]
    view = head["bufferViews"][accessor["bufferView"]]
    dtype = np.dtype(_COMPONENTS[accessor["componentType"]])
    columns = _WIDTHS[accessor["type"]]
    row = dtype.itemsize * columns
    a: npt.NDArray[Any] = np.ndarray(
        (accessor["count"], columns), dtype, binary,
        view.get("byteOffset", 0) + accessor.get("byteOffset", 0),
        (view.get("byteStride", row), dtype.itemsize))
    if accessor.get("normalized") and dtype.kind == "u":
        return (a / np.float32(np.iinfo(dtype).max)).astype("<f4")
    return a[:, 0] if columns == 1 else a
