"""A daemon, and what it can do without a scene."""
from __future__ import annotations

import os
import time
import urllib.parse
from typing import (Any, Dict, Iterator, List, Mapping, Optional, Sequence,
                    Union)

import numpy as np
import numpy.typing as npt

from .arrays import (COLUMNS, NPY, OCTETS, Values, chosen, npy_bytes, table,
                     vectors)
from .build import DocumentLike, document_bytes, json_bytes
from .errors import BlobfieldError, ConnectionFailed, ProblemError
from .results import Imported, Summary, Volume
from .scene import JSON, Corner, Scene
from .transport import Transport

DEFAULT_URL = "http://127.0.0.1:7878"
# One-shot evaluations of more points than this send them as float32, by way of
# a scene; up to it the one request in JSON is quicker.
JSON_POINTS = 256


class Client:
    """A blobfieldd.

    url: its address; BLOBFIELD_URL of the environment, or
    http://127.0.0.1:7878, without. timeout: seconds of silence after which a
    request is given up (long work is silent until it is done; None: wait as
    long as it takes). retry_for: how many seconds in all a request is repeated
    that the daemon answers with 503 or 429 (nothing has been done then), at
    the pace it proposes; retries: how often at most; 0, either: never.
    headers: sent with every request, for a proxy's authentication. token: for
    a daemon that asks for one; BLOBFIELD_TOKEN of the environment without, ""
    for none. ca: for https, a file of certificates (PEM) to trust instead of
    the system's; BLOBFIELD_CA of the environment without.

    Connections are kept and reused. Any number of threads may use one
    client. `with Client() as client:` closes them at the end.
    """

    def __init__(self, url: Optional[str] = None, *,
                 timeout: Optional[float] = 600.0,
                 connect_timeout: float = 5.0, retry_for: float = 30.0,
                 headers: Optional[Mapping[str, str]] = None,
                 token: Optional[str] = None,
                 ca: "Union[str, os.PathLike[str], None]" = None,
                 retries: Optional[int] = None) -> None:
        if token is None:
            token = os.environ.get("BLOBFIELD_TOKEN")
        if token:
            headers = {"Authorization": "Bearer " + _token(token),
                       **(headers or {})}
        self.transport = Transport(
            url or os.environ.get("BLOBFIELD_URL") or DEFAULT_URL, timeout,
            connect_timeout, retry_for, headers or {},
            ca or os.environ.get("BLOBFIELD_CA") or None, retries)

    @property
    def url(self) -> str:
        return self.transport.url

    def __repr__(self) -> str:
        return f"Client({self.url!r})"

    def close(self) -> None:
        self.transport.close()

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- the daemon ---------------------------------------------------------

    def info(self) -> Dict[str, Any]:
        """Version, device, limits, figures."""
        return self._get("/v1/info")

    def ready(self) -> bool:
        """Whether device and built-in tables are there. ConnectionFailed:
        there is no daemon."""
        try:
            self._get("/readyz", retry=False)
        except ProblemError:
            return False
        return True

    def wait_until_ready(self, timeout: float = 60.0) -> "Client":
        """Waits for a daemon that is starting. ConnectionFailed."""
        last = time.monotonic() + timeout
        why = "it is not ready"
        while time.monotonic() < last:
            try:
                if self.ready():
                    return self
            except ConnectionFailed as e:
                why = str(e)
            time.sleep(0.05)
        raise ConnectionFailed(f"no ready daemon after {timeout:g} s: {why}")

    def operators(self) -> Dict[str, Any]:
        """Built-in operators, and all tables."""
        return self._get("/v1/operators")

    def operator(self, name: str) -> Dict[str, Any]:
        """One of them, with its tables."""
        return self._get("/v1/operators/" + urllib.parse.quote(name, safe=""))

    def build_operator(self, **order: Any) -> Dict[str, Any]:
        """A table to order: profile, family, layout, resolution or max_error.
        The answer's "operator" is for documents."""
        return self._post("/v1/operators", order)

    def import_blobtree(self, document: DocumentLike) -> Imported:
        """A three-js-blobtree document (dict, JSON text, or path) as ours."""
        body = (json_bytes(document) if isinstance(document, Mapping)
                else document_bytes(document))
        a = self._post("/v1/import", body)
        warnings = [(w["pointer"], w["detail"]) for w in a["warnings"]]
        return Imported(a["document"], warnings,
                        a.get("warning_count", len(warnings)))

    # --- scenes -------------------------------------------------------------

    def scene(self, id: str, document: Optional[DocumentLike] = None) -> Scene:
        """The scene of that id; with a document, puts it there."""
        scene = Scene(self, id)
        return scene if document is None else scene.put(document)

    def create(self, document: DocumentLike) -> Scene:
        """A new scene under a random id."""
        answer = self.transport.request(
            "POST", "/v1/scenes", body=document_bytes(document), kind=JSON,
            again=False)
        scene = Scene(self, answer.json()["id"])
        scene.revision = answer.revision
        return scene

    def scenes(self) -> Iterator[Summary]:
        """All scenes, by id."""
        after: Optional[str] = None
        while True:
            page = self.transport.request(
                "GET", "/v1/scenes", query={"after": after}).json()
            yield from (Summary.of(s) for s in page["scenes"])
            after = page.get("next")
            if after is None:
                return

    def evaluate(self, document: DocumentLike, points: npt.ArrayLike,
                 outputs: Union[str, Sequence[str]] = ("value", "gradient")
                 ) -> Values:
        """Values of a document that is not kept: see Scene.evaluate."""
        rows = vectors(points, "points")
        if rows.size > 3 * JSON_POINTS:
            scene = self.create(document)
            try:
                return scene.evaluate(rows, outputs)
            finally:
                try:
                    scene.delete()
                except BlobfieldError:
                    pass  # what went wrong before is worth more
        names = chosen(outputs)
        body = (b'{"scene":' + document_bytes(document) + b',"points":'
                + json_bytes(rows.reshape(-1)) + b',"outputs":'
                + json_bytes(names) + b"}")
        answer = self.transport.request("POST", "/v1/eval", body=body,
                                        kind=JSON, accept=OCTETS)
        return Values(table(answer.body, rows.shape[:-1],
                            sum(COLUMNS[n] for n in names)), names, None,
                      answer.headers.get("Blobfield-Draft") == "true")

    # --- volumes ------------------------------------------------------------

    def upload(self, samples: npt.ArrayLike, min: Corner, max: Corner,
               kind: str = "field") -> Volume:
        """Keeps a grid for documents: {"type": "volume", "volume": id}.

        samples: (nx, ny, nz), [i, j, k] along x, y, z; min and max: where the
        first and the last are. kind: "field" (values, inside above 1/2) or
        "distance" (signed, negative inside).
        """
        a = np.asarray(samples)
        if a.dtype != np.float64:
            a = a.astype("<f4", copy=False)
        answer = self.transport.request(
            "POST", "/v1/volumes", body=npy_bytes(a), kind=NPY,
            query={"min": _comma(min), "max": _comma(max), "kind": kind})
        return Volume.of(answer.json())

    def volumes(self) -> List[Volume]:
        return [Volume.of(v) for v in self._get("/v1/volumes")["volumes"]]

    def delete_volume(self, volume: Union[Volume, str]) -> None:
        """Documents cannot name it any more; scenes that use it go on."""
        id = volume.id if isinstance(volume, Volume) else volume
        self.transport.request(
            "DELETE", "/v1/volumes/" + urllib.parse.quote(id, safe=""))

    # --- sending ------------------------------------------------------------

    def _get(self, path: str, retry: bool = True) -> Dict[str, Any]:
        a: Dict[str, Any] = self.transport.request("GET", path,
                                                   retry=retry).json()
        return a

    def _post(self, path: str, body: Union[bytes, Dict[str, Any]]
              ) -> Dict[str, Any]:
        a: Dict[str, Any] = self.transport.request(
            "POST", path, kind=JSON,
            body=body if isinstance(body, bytes) else json_bytes(body)).json()
        return a


def evaluate(document: DocumentLike, points: npt.ArrayLike,
             outputs: Union[str, Sequence[str]] = ("value", "gradient"),
             url: Optional[str] = None, token: Optional[str] = None,
             ca: "Union[str, os.PathLike[str], None]" = None) -> Values:
    """Values of a document at points of shape (..., 3), in one call."""
    with Client(url, token=token, ca=ca) as client:
        return client.evaluate(document, points, outputs)


def _token(token: str) -> str:
    """It, if a header can carry it."""
    token = token.strip()
    if not token or not token.isascii() or not token.isprintable() \
            or " " in token:
        raise ValueError("a token is one word of ASCII characters")
    return token


def _comma(corner: Corner) -> str:
    return ",".join(repr(float(c)) for c in corner)
