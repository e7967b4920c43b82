"""What the endpoints answer, as plain values."""
from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np
import numpy.typing as npt

from .arrays import Floats

Doubles = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


class Box(NamedTuple):
    """An axis-parallel box: its least and greatest corner."""

    min: Doubles
    max: Doubles


@dataclass
class Bounds:
    """Outside of min and max the field is 0; infinite where it has no bound.
    surface: a box about the surface f = 1/2, None where there is none or it
    has no bound. empty: the field is 0 everywhere (min and max are 0)."""

    min: Doubles
    max: Doubles
    bounded: bool
    empty: bool
    surface: Optional[Box]

    @classmethod
    def of(cls, answer: Mapping[str, Any]) -> "Bounds":
        if answer["empty"]:
            low = high = np.zeros(3)
        else:
            low = _corner(answer["min"], -np.inf)
            high = _corner(answer["max"], np.inf)
        surface = answer.get("surface")
        return cls(low, high, bool(answer["bounded"]), bool(answer["empty"]),
                   Box(_corner(surface["min"], -np.inf),
                       _corner(surface["max"], np.inf)) if surface else None)


def _corner(coordinates: Optional[List[Optional[float]]],
            unbound: float) -> Doubles:
    return np.array([unbound if c is None else c
                     for c in coordinates or [None] * 3])


@dataclass
class Hits:
    """Where rays of shape (..., 3) meet the surface first.

    hit (...) bool; distance (...), infinite for misses; position (..., 3), NaN
    for misses; value (...), gradient, normal, color (..., 3), 0 for misses;
    leaf (...): the number of the primitive there in document order, -1 for
    misses (see leaf_pointers).
    """

    hit: Bools
    distance: Floats
    position: Floats
    value: Floats
    gradient: Floats
    color: Floats
    leaf: npt.NDArray[np.int32]
    revision: Optional[str] = None

    @classmethod
    def of(cls, rows: Floats, revision: Optional[str]) -> "Hits":
        """Of rows: hit, distance, position, value, gradient, color, leaf."""
        hit = rows[..., 0] != 0
        rows[~hit, 1] = np.inf
        rows[~hit, 2:5] = np.nan
        return cls(hit, rows[..., 1], rows[..., 2:5], rows[..., 5],
                   rows[..., 6:9], rows[..., 9:12],
                   np.rint(rows[..., 12]).astype(np.int32), revision)

    @property
    def normal(self) -> Floats:
        """-gradient / length, 0 where that is 0."""
        length = np.linalg.norm(self.gradient, axis=-1, keepdims=True)
        n: Floats = np.divide(-self.gradient, length, where=length > 0,
                              out=np.zeros_like(self.gradient))
        return n


@dataclass
class Projection:
    """Points of shape (..., 3) brought to the surface.

    converged (...) bool: False where the field is flat, or the surface
    further than max_distance; position, normal (..., 3); distance (...),
    positive outside; value (...).
    """

    converged: Bools
    position: Floats
    distance: Floats
    value: Floats
    normal: Floats
    revision: Optional[str] = None

    @classmethod
    def of(cls, rows: Floats, revision: Optional[str]) -> "Projection":
        return cls(rows[..., 0] != 0, rows[..., 1:4], rows[..., 4],
                   rows[..., 5], rows[..., 6:9], revision)


@dataclass
class Camera:
    """Z is up unless `up` says otherwise. fov: vertical, radians.
    view_height: world units, for projection="orthographic"."""

    eye: Tuple[float, float, float]
    target: Tuple[float, float, float] = (0, 0, 0)
    up: Tuple[float, float, float] = (0, 0, 1)
    fov: Optional[float] = None
    projection: Optional[str] = None
    view_height: Optional[float] = None

    def members(self) -> Dict[str, Any]:
        return {k: v for k, v in vars(self).items() if v is not None}


@dataclass
class OpeningAngle:
    """The opening theta at which the blend of two children ends at a point;
    alpha: the angle between their gradients there, None where one is 0."""

    theta: float
    alpha: Optional[float]
    values: Tuple[float, float]
    children: Tuple[int, int]
    parameter: Optional[str]


@dataclass
class Volume:
    """An uploaded grid. Documents name it by id."""

    id: str
    kind: str
    shape: Tuple[int, int, int]
    min: Tuple[float, float, float]
    max: Tuple[float, float, float]
    bytes: int
    least: float
    most: float
    max_falloff: Optional[float] = None

    @classmethod
    def of(cls, answer: Mapping[str, Any]) -> "Volume":
        i, j, k = answer["shape"]
        x, y, z = answer["min"]
        u, v, w = answer["max"]
        return cls(answer["id"], answer["kind"], (i, j, k), (x, y, z),
                   (u, v, w), answer["bytes"], answer["least"], answer["most"],
                   answer.get("max_falloff"))


@dataclass
class Imported:
    """A document made from another program's; warnings: (pointer, detail)."""

    document: Dict[str, Any]
    warnings: List[Tuple[str, str]]
    warning_count: int


@dataclass
class Summary:
    """A scene in a list. sequence: the number of its last change, as in
    Event; time: when that was; owner: the token that made it, "" if none."""

    id: str
    name: str
    revision: str
    nodes: int
    bytes: int
    sequence: str = ""
    time: Optional[datetime] = None
    owner: str = ""

    @classmethod
    def of(cls, answer: Mapping[str, Any]) -> "Summary":
        return cls(answer["id"], answer["name"], answer["revision"],
                   answer["nodes"], answer["bytes"],
                   answer.get("sequence", ""), _time(answer.get("time")),
                   answer.get("owner", ""))


@dataclass
class Revision:
    """One of those of a scene that are kept: Scene.at(revision) is its
    text."""

    revision: str
    sequence: str
    time: Optional[datetime]
    nodes: int
    bytes: int

    @classmethod
    def of(cls, answer: Mapping[str, Any]) -> "Revision":
        return cls(answer["revision"], answer["sequence"],
                   _time(answer["time"]), answer["nodes"], answer["bytes"])


@dataclass
class Event:
    """A change of a scene. deleted: it is gone, and revision is None, nodes
    and bytes 0. sequence: for Scene.events(last=). missed: there were others
    before it that are not told."""

    id: str
    sequence: str
    time: Optional[datetime]
    revision: Optional[str] = None
    nodes: int = 0
    bytes: int = 0
    deleted: bool = False
    missed: bool = False

    @classmethod
    def of(cls, kind: str, data: Mapping[str, Any]) -> "Event":
        return cls(data["id"], data["sequence"], _time(data.get("time")),
                   data.get("revision"), data.get("nodes", 0),
                   data.get("bytes", 0), kind == "deleted",
                   bool(data.get("missed")))


def _time(text: Optional[str]) -> Optional[datetime]:
    """Of RFC 3339, in UTC."""
    if not text:
        return None
    # Before 3.11 Python knows no "Z".
    return datetime.fromisoformat(text.replace("Z", "+00:00")).astimezone(
        timezone.utc)
