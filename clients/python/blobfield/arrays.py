"""NumPy arrays to and from the wire: rows of little-endian float32."""
from __future__ import annotations

import io
from typing import (Any, Dict, Iterator, List, Optional, Sequence, Tuple,
                    Union)

import numpy as np
import numpy.typing as npt

from .transport import Body

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float32]

OCTETS = "application/octet-stream"
NPY = "application/x-npy"

#: Outputs in the wire's order, and their floats a point.
COLUMNS: Dict[str, int] = {"value": 1, "gradient": 3, "hessian": 6,
                           "color": 3, "normal": 3, "curvature": 2}


def chosen(outputs: Union[str, Sequence[str]]) -> List[str]:
    """Outputs as a list in the wire's order. ValueError: unknown ones."""
    asked = [outputs] if isinstance(outputs, str) else list(outputs)
    wrong = [o for o in asked if o not in COLUMNS]
    if wrong or not asked:
        raise ValueError(f"outputs must be some of {', '.join(COLUMNS)}, "
                         f"not {', '.join(map(repr, wrong)) or 'none'}")
    return [o for o in COLUMNS if o in asked]


def vectors(given: npt.ArrayLike, what: str) -> Floats:
    """given as C-ordered float32 of shape (..., 3). ValueError unless that
    can be, and is finite."""
    a = np.asarray(given)
    if a.ndim < 1 or a.shape[-1] != 3:
        raise ValueError(f"{what} must have shape (..., 3), not {a.shape}")
    with np.errstate(over="ignore", invalid="ignore"):
        rows = np.ascontiguousarray(a, dtype="<f4")
    if not np.isfinite(rows).all():
        where = tuple(map(int, np.argwhere(~np.isfinite(rows))[0]))
        raise ValueError(f"{what}[{', '.join(map(str, where))}] is "
                         f"{a[where]}: not finite as float32")
    return rows


def octets(rows: Floats) -> Body:
    """The bytes of rows, not copied."""
    return rows.reshape(-1).view(np.uint8).data


def table(body: Body, shape: Tuple[int, ...], columns: int) -> Floats:
    """The rows of an answer, as (*shape, columns), not copied."""
    rows: Floats = np.frombuffer(body, "<f4")
    return rows.reshape(shape + (columns,))


def npy_bytes(a: Array) -> bytes:
    """a as an npy file."""
    out = io.BytesIO()
    np.save(out, a, allow_pickle=False)
    return out.getvalue()


def npy_array(body: Body) -> Array:
    """The array of an npy file."""
    a: Array = np.load(io.BytesIO(bytes(body)), allow_pickle=False)
    return a


class Values:
    """What was asked for at each point, as attributes and by name.

    With points of shape (..., 3): value (...), gradient, color, normal
    (..., 3), hessian (..., 3, 3), curvature (..., 2: mean, Gaussian);
    float32, parts of one array. `color` is linear RGB. What was not asked for
    raises AttributeError. draft: a coarser operator table stood in.
    """

    def __init__(self, rows: Floats, outputs: Sequence[str],
                 revision: Optional[str] = None, draft: bool = False) -> None:
        self.revision = revision
        self.draft = draft
        self._parts: Dict[str, Floats] = {}
        at = 0
        for name in outputs:
            n = COLUMNS[name]
            part = rows[..., at] if n == 1 else rows[..., at:at + n]
            self._parts[name] = part
            at += n

    def _part(self, name: str) -> Floats:
        if name not in self._parts:
            raise AttributeError(
                f"{name} was not asked for: outputs=[{name!r}, ...]")
        return self._parts[name]

    @property
    def value(self) -> Floats:
        return self._part("value")

    @property
    def gradient(self) -> Floats:
        return self._part("gradient")

    @property
    def hessian(self) -> Floats:
        # xx yy zz xy xz yz to symmetric matrices.
        rows = self._part("hessian")
        full: Floats = rows[..., [0, 3, 4, 3, 1, 5, 4, 5, 2]]
        return full.reshape(rows.shape[:-1] + (3, 3))

    @property
    def color(self) -> Floats:
        return self._part("color")

    @property
    def normal(self) -> Floats:
        return self._part("normal")

    @property
    def curvature(self) -> Floats:
        return self._part("curvature")

    def __getitem__(self, name: str) -> Floats:
        if name not in self._parts:
            raise KeyError(name)
        a: Floats = getattr(self, name)
        return a

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def __repr__(self) -> str:
        return f"Values({', '.join(self._parts)})"
