"""The Python client: the copy beside this file in the add-on's zip, else the
one of the source tree."""
import os
import sys

try:
    from . import blobfield
except ImportError:
    _python = os.path.join(os.path.dirname(os.path.abspath(__file__)),
                           os.pardir, os.pardir, "python")
    if _python not in sys.path:
        sys.path.append(_python)
    import blobfield  # type: ignore[no-redef]

__all__ = ["blobfield"]
