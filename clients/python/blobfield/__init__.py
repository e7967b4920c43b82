"""Client of blobfieldd: gradient-based implicit blends over HTTP.

    import blobfield
    scene = blobfield.Client().scene("ball", blobfield.point([0, 0, 0], 1))
    scene.evaluate([[1, 0, 0], [0, 0, 0.5]]).value

Standard library and NumPy only.
"""
from .arrays import Values
from .build import (FORMAT, box, capsule, cylinder, difference, document,
                    intersection, leaf_pointers, node, point, ref, segment,
                    sphere, torus, triangle, union)
from .client import DEFAULT_URL, Client, evaluate
from .errors import (BlobfieldError, Busy, Cancelled, Conflict,
                     ConnectionFailed, DeadlineExceeded, DeviceLost, Fault,
                     Forbidden, InvalidContent, NotFound, PreconditionFailed,
                     ProblemError, StoreUnavailable, TooManyRequests,
                     Unauthorized)
from .mesh import Mesh
from .results import (Bounds, Box, Camera, Event, Hits, Imported,
                      OpeningAngle, Projection, Revision, Summary, Volume)
from .scene import Scene
from .transport import Cancellation

__version__ = "0.4.0"

__all__ = [
    "BlobfieldError", "Bounds", "Box", "Busy", "Camera", "Cancellation",
    "Cancelled", "Client", "Conflict", "ConnectionFailed", "DEFAULT_URL",
    "DeadlineExceeded", "DeviceLost", "Event", "FORMAT", "Fault", "Forbidden",
    "Hits", "Imported", "InvalidContent", "Mesh", "NotFound", "OpeningAngle",
    "PreconditionFailed", "ProblemError", "Projection", "Revision", "Scene",
    "StoreUnavailable", "Summary", "TooManyRequests", "Unauthorized", "Values",
    "Volume", "box", "capsule", "cylinder", "difference", "document",
    "evaluate", "intersection", "leaf_pointers", "node", "point", "ref",
    "segment", "sphere", "torus", "triangle", "union",
]
