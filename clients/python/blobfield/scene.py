"""A scene on the daemon: a document under an id, and what to ask of it."""
from __future__ import annotations

import json
import operator
import os
import tempfile
import time
import urllib.parse
from contextlib import contextmanager
from typing import (TYPE_CHECKING, Any, Callable, Dict, Iterator, Mapping,
                    Optional, Sequence, Tuple, Union)

import numpy as np
import numpy.typing as npt

from .arrays import (COLUMNS, NPY, OCTETS, Values, chosen, npy_array, octets,
                     table, vectors)
from .build import DocumentLike, document_bytes, json_bytes, leaf_pointers
from .errors import NotFound, PreconditionFailed, ProblemError
from .events import follow
from .mesh import Mesh
from .results import (Bounds, Camera, Event, Hits, OpeningAngle, Projection,
                      Revision)
from .transport import Answer, Body, Cancellation, Progress

if TYPE_CHECKING:
    from .client import Client

JSON = "application/json"
FORMATS = {"glb": "model/gltf-binary", "ply": "application/x-ply",
           "stl": "model/stl", "obj": "model/obj", "json": JSON}
Corner = Sequence[float]
Levels = Union[Sequence[float], float]
# Points of one request: below the daemon's --max-points, 8,000,000 unless said
# otherwise.
PIECE_POINTS = 4000000


class Scene:
    """One scene of a Client; made by Client.scene or Client.create.

    revision: the last one seen by this object, None before. evaluate, grid,
    raycast, project, mesh, render and slice take, besides their own:
        if_match  a revision: PreconditionFailed if the scene has another
        deadline  seconds: DeadlineExceeded if it takes longer
        cancel    a Cancellation
        progress  (not evaluate, grid) called with a stage and 0..1 while it runs;
                  what it raises cancels the work
    """

    def __init__(self, client: "Client", id: str) -> None:
        self.client = client
        self.id = id
        self.revision: Optional[str] = None
        self._path = "/v1/scenes/" + urllib.parse.quote(id, safe="")

    def __repr__(self) -> str:
        return f"Scene({self.id!r} at {self.client.url})"

    # --- the document -------------------------------------------------------

    def put(self, document: DocumentLike, *, if_match: Optional[str] = None,
            only_new: bool = False) -> "Scene":
        """Keeps the document, whatever was there; answers self.

        if_match: only if the scene has that revision; only_new: only if there
        is none (PreconditionFailed else). InvalidContent says what is wrong.
        """
        headers = _tag(if_match)
        if only_new:
            headers["If-None-Match"] = "*"
        self._note(self.client.transport.request(
            "PUT", self._path, body=document_bytes(document), kind=JSON,
            headers=headers))
        return self

    def text(self) -> bytes:
        """The document's bytes as they came."""
        return bytes(self._note(self.client.transport.request(
            "GET", self._path)).body)

    def document(self) -> Dict[str, Any]:
        """The document."""
        d: Dict[str, Any] = json.loads(self.text())
        return d

    @contextmanager
    def edit(self) -> Iterator[Dict[str, Any]]:
        """The document to be changed; sent at the end of the with block, with
        If-Match: PreconditionFailed if somebody else was faster.

            with scene.edit() as document:
                document["root"]["radius"] = 2
        """
        document = self.document()
        revision = self.revision
        yield document
        self.put(document, if_match=revision)

    def change(self, edit: Callable[[Dict[str, Any]], None],
               attempts: int = 8) -> "Scene":
        """Applies edit to the document, again if somebody else was faster."""
        for left in reversed(range(attempts)):
            try:
                with self.edit() as document:
                    edit(document)
                return self
            except PreconditionFailed:
                if not left:
                    raise
        return self

    def patch(self, patch: Union[Sequence[Mapping[str, Any]],
                                 Mapping[str, Any]], *,
              if_match: Optional[str] = None) -> "Scene":
        """Changes a part of the document on the daemon; answers self.

        A list is a JSON Patch (RFC 6902), a dict a merge patch (RFC 7396):

            scene.patch([{"op": "replace", "path": "/root/radius", "value": 2}])
            scene.patch({"root": {"radius": 2}})

        Whatever others change meanwhile stays, unless if_match asks for a
        revision (PreconditionFailed). Conflict: one of its tests failed.
        InvalidContent says what is wrong with the patch, or with the document
        after it. Nothing has changed then.
        """
        kind = "merge" if isinstance(patch, Mapping) else "json"
        self._note(self.client.transport.request(
            "PATCH", self._path, body=json_bytes(patch),
            kind=f"application/{kind}-patch+json", headers=_tag(if_match),
            again=False))
        return self

    def revisions(self) -> Iterator[Revision]:
        """The kept revisions, the newest first."""
        before: Optional[str] = None
        while True:
            page = self.client.transport.request(
                "GET", self._path + "/revisions",
                query={"before": before}).json()
            yield from (Revision.of(r) for r in page["revisions"])
            before = page.get("next")
            if before is None:
                return

    def at(self, revision: str) -> bytes:
        """The document's bytes as they were then. NotFound: that revision is
        not kept any more."""
        return bytes(self.client.transport.request(
            "GET", self._path, query={"revision": revision}).body)

    def delete(self, *, if_match: Optional[str] = None) -> None:
        self.client.transport.request("DELETE", self._path,
                                      headers=_tag(if_match))
        self.revision = None

    def exists(self) -> bool:
        return self._look(None) is not None

    def events(self, last: Union[Event, str, None] = None, *,
               timeout: Optional[float] = None,
               cancel: Optional[Cancellation] = None) -> Iterator[Event]:
        """The present revision, then every change as it is made, until the
        scene is deleted (which is the last), or timeout seconds after the
        last one. NotFound: there is no scene.

        last: an event, or its sequence: those after it come, as far as they
        are kept; if not all of them are, the present one, which says missed.
        If the connection breaks, or the daemon is started again, this is done
        for you, for as long as that takes; a scene that is gone by then ends
        it. ConnectionFailed only if it cannot be begun.
        """
        return follow(self.client.transport, self._path + "/events",
                      last.sequence if isinstance(last, Event) else last,
                      timeout, cancel or Cancellation(), self._seen)

    def _seen(self, event: Event) -> None:
        self.revision = event.revision

    def watch(self, interval: float = 0.5, timeout: Optional[float] = None,
              cancel: Optional[Cancellation] = None) -> Iterator[str]:
        """The present revision, then every further one, as events tells;
        ends when the scene is gone, or timeout seconds after the last.

        From a daemon that cannot tell (an older one, or too many listen), by
        asking each interval seconds: what changes twice between two looks
        counts once then.
        """
        cancel = cancel or Cancellation()
        seen: Optional[str] = None
        try:
            for event in self.events(timeout=timeout, cancel=cancel):
                if event.revision and event.revision != seen:
                    seen = event.revision
                    yield seen
            return
        except ProblemError as e:
            if e.status not in (404, 405, 503):
                raise
        yield from self._poll(seen, interval, timeout, cancel)

    def _poll(self, seen: Optional[str], interval: float,
              timeout: Optional[float], cancel: Cancellation
              ) -> Iterator[str]:
        last = time.monotonic()
        while True:
            now = self._look(seen)
            if now is None:
                return
            if now != seen:
                seen = self.revision = now
                last = time.monotonic()
                yield now
            if timeout is not None and time.monotonic() - last >= timeout:
                return
            cancel.sleep(interval)

    def _look(self, seen: Optional[str]) -> Optional[str]:
        """The revision, None if there is no scene."""
        try:
            answer = self.client.transport.request(
                "HEAD", self._path,
                headers={"If-None-Match": f'"{seen}"'} if seen else None)
        except NotFound:
            return None
        return answer.revision or seen

    # --- the field ----------------------------------------------------------

    def evaluate(self, points: npt.ArrayLike,
                 outputs: Union[str, Sequence[str]] = ("value", "gradient"),
                 *, priority: Optional[str] = None,
                 if_match: Optional[str] = None,
                 deadline: Optional[float] = None,
                 cancel: Optional[Cancellation] = None) -> Values:
        """Values at points of shape (..., 3), in that shape.

        outputs: of value, gradient, hessian, color, normal, curvature.
        priority: "interactive" or "bulk". ValueError: points that are not
        finite as float32, or of another shape. More than 4,000,000 points go
        in several requests, for each of which the deadline holds;
        PreconditionFailed if the scene changes between them.
        """
        rows = vectors(points, "points")
        names = chosen(outputs)
        flat = rows.reshape(-1, 3)
        got = []
        draft = False
        for at in range(0, max(len(flat), 1), PIECE_POINTS):
            answer = self._post(
                "eval", octets(flat[at:at + PIECE_POINTS]), OCTETS, OCTETS,
                if_match, cancel=cancel, outputs=",".join(names),
                priority=priority, deadline=deadline)
            got.append(table(answer.body, (-1,),
                             sum(COLUMNS[n] for n in names)))
            if_match = answer.revision
            draft |= answer.headers.get("Blobfield-Draft") == "true"
        whole = got[0] if len(got) == 1 else np.concatenate(got)
        return Values(whole.reshape(rows.shape[:-1] + whole.shape[-1:]),
                      names, if_match, draft)

    def grid(self, min: Corner, max: Corner, counts: Sequence[int],
             outputs: Union[str, Sequence[str]] = ("value", "gradient"),
             *, priority: Optional[str] = None,
             if_match: Optional[str] = None,
             deadline: Optional[float] = None,
             cancel: Optional[Cancellation] = None) -> Values:
        """Values on a regular grid, which need not be sent: of shape counts,
        (nx, ny, nz), [i, j, k] along x, y, z, the first point at min, the
        last at max (where a count is 1: at min).

        The numbers are those of evaluate at these points, bit for bit. All
        goes in one request: InvalidContent if there are more points than the
        daemon allows (--max-points, 8,000,000). Client.upload takes `value`
        as it is, from 4 points an axis on.
        """
        names = chosen(outputs)
        shape = tuple(operator.index(n) for n in counts)
        answer = self._json("grid", {"min": min, "max": max, "counts": shape},
                            if_match, OCTETS, cancel=cancel,
                            outputs=",".join(names), priority=priority,
                            deadline=deadline)
        rows = table(answer.body, shape, sum(COLUMNS[n] for n in names))
        return Values(rows, names, answer.revision,
                      answer.headers.get("Blobfield-Draft") == "true")

    def bounds(self) -> Bounds:
        """Boxes about the field and the surface."""
        return Bounds.of(self._note(self.client.transport.request(
            "GET", self._path + "/bounds")).json())

    def opening_angle(self, node: str, point: Corner,
                      children: Optional[Tuple[int, int]] = None, *,
                      if_match: Optional[str] = None) -> OpeningAngle:
        """How far the union of id `node` must open for the blend of two of
        its children to end at a point."""
        a = self._json("opening-angle", {"node": node, "point": point,
                                         "children": children},
                       if_match).json()
        f1, f2 = a["values"]
        i, j = a["children"]
        return OpeningAngle(a["theta"], a["alpha"], (f1, f2), (i, j),
                            a["parameter"])

    def raycast(self, origins: npt.ArrayLike, directions: npt.ArrayLike, *,
                iso: Optional[float] = None,
                max_distance: Optional[float] = None,
                tolerance: Optional[float] = None,
                if_match: Optional[str] = None,
                deadline: Optional[float] = None,
                progress: Optional[Progress] = None,
                cancel: Optional[Cancellation] = None) -> Hits:
        """Where rays meet the surface first, from either side.

        origins and directions of shape (..., 3) are broadcast against each
        other; directions need not be unit.
        """
        o, d = np.broadcast_arrays(vectors(origins, "origins"),
                                   vectors(directions, "directions"))
        rays = np.concatenate((o, d), axis=-1)
        answer = self._post("raycast", octets(rays), OCTETS, OCTETS, if_match,
                            progress, cancel, iso=iso, deadline=deadline,
                            max_distance=max_distance, tolerance=tolerance)
        return Hits.of(table(answer.body, rays.shape[:-1], 13),
                       answer.revision)

    def project(self, points: npt.ArrayLike, *, iso: Optional[float] = None,
                max_distance: Optional[float] = None,
                if_match: Optional[str] = None,
                deadline: Optional[float] = None,
                progress: Optional[Progress] = None,
                cancel: Optional[Cancellation] = None) -> Projection:
        """Points of shape (..., 3) to the surface, along the gradient."""
        rows = vectors(points, "points")
        answer = self._post("project", octets(rows), OCTETS, OCTETS, if_match,
                            progress, cancel, iso=iso, deadline=deadline,
                            max_distance=max_distance)
        return Projection.of(table(answer.body, rows.shape[:-1], 9),
                             answer.revision)

    def leaf_pointers(self) -> Sequence[str]:
        """JSON pointers of the primitives, by Hits.leaf."""
        return leaf_pointers(self.document())

    # --- meshes and pictures ------------------------------------------------

    def mesh(self, *, resolution: Optional[int] = None,
             edge_length: Optional[float] = None,
             bounds: Optional[Tuple[Corner, Corner]] = None,
             iso: Optional[float] = None, features: bool = True,
             normals: bool = True, colors: bool = True,
             if_match: Optional[str] = None,
             deadline: Optional[float] = None,
             progress: Optional[Progress] = None,
             cancel: Optional[Cancellation] = None) -> Mesh:
        """The surface as triangles.

        resolution: cells along the longest side (64), or edge_length: of a
        cell. bounds: (least corner, greatest corner), where the surface is cut
        and capped; the surface's own box without. features: keep sharp edges.
        """
        answer = self._mesh("glb", resolution, edge_length, bounds, iso,
                            features, normals, colors, if_match, deadline,
                            progress, cancel)
        mesh = Mesh.from_glb(answer.body)
        mesh.revision = answer.revision
        return mesh

    def mesh_file(self, path: "Union[str, os.PathLike[str]]",
                  format: Optional[str] = None, *,
                  resolution: Optional[int] = None,
                  edge_length: Optional[float] = None,
                  bounds: Optional[Tuple[Corner, Corner]] = None,
                  iso: Optional[float] = None, features: bool = True,
                  normals: bool = True, colors: bool = True,
                  if_match: Optional[str] = None,
                  deadline: Optional[float] = None,
                  progress: Optional[Progress] = None,
                  cancel: Optional[Cancellation] = None) -> Dict[str, int]:
        """The same, into a file: glb, ply, stl, obj (or json: figures alone),
        by the path's suffix if format is not given. Answers with the numbers
        of vertices and triangles, and the genus."""
        kind = (format or os.path.splitext(os.fspath(path))[1][1:]).lower()
        if kind not in FORMATS:
            raise ValueError(f"format must be one of {', '.join(FORMATS)}, "
                             f"not {kind!r}")
        answer = self._mesh(kind, resolution, edge_length, bounds, iso,
                            features, normals, colors, if_match, deadline,
                            progress, cancel)
        _write(path, answer.body)
        if kind == "json":
            figures = answer.json()
            return {k: int(figures[k])
                    for k in ("vertices", "triangles", "genus")}
        return _counts(answer.headers.get("Blobfield-Mesh", ""))

    def _mesh(self, format: str, resolution: Optional[int],
              edge_length: Optional[float],
              bounds: Optional[Tuple[Corner, Corner]], iso: Optional[float],
              features: bool, normals: bool, colors: bool,
              if_match: Optional[str], deadline: Optional[float],
              progress: Optional[Progress],
              cancel: Optional[Cancellation]) -> Answer:
        body = {"format": format, "resolution": resolution,
                "edge_length": edge_length, "iso": iso, "features": features,
                "normals": normals, "colors": colors,
                "bounds": None if bounds is None else
                {"min": bounds[0], "max": bounds[1]}}
        return self._json("mesh", body, if_match, FORMATS[format], progress,
                          cancel, deadline=deadline)

    def render(self, width: int = 640, height: int = 480, *,
               camera: Union[Camera, Mapping[str, Any], None] = None,
               shading: Optional[str] = None,
               background: Optional[Sequence[float]] = None,
               samples: Optional[int] = None, iso: Optional[float] = None,
               if_match: Optional[str] = None,
               deadline: Optional[float] = None,
               progress: Optional[Progress] = None,
               cancel: Optional[Cancellation] = None) -> bytes:
        """A picture, as the bytes of a PNG file.

        shading: lit, normal, zebra, curvature, field. background: linear RGB,
        transparent without. samples: rays a pixel, 1, 4, 9 or 16. Without a
        camera the whole is in view.
        """
        body = {"width": width, "height": height, "shading": shading,
                "background": background, "samples": samples, "iso": iso,
                "camera": camera.members() if isinstance(camera, Camera)
                else camera}
        return bytes(self._json("render", body, if_match, "image/png",
                                progress, cancel, deadline=deadline).body)

    def slice(self, width: int = 512, height: int = 512, *,
              center: Optional[Corner] = None,
              normal: Optional[Corner] = None, up: Optional[Corner] = None,
              extent: Optional[float] = None,
              outputs: Union[str, Sequence[str]] = "value",
              if_match: Optional[str] = None,
              deadline: Optional[float] = None,
              progress: Optional[Progress] = None,
              cancel: Optional[Cancellation] = None) -> Values:
        """The field on a plane: Values of shape (height, width), the first row
        at the top. extent: the width in world units."""
        names = chosen(outputs)
        body = {"width": width, "height": height, "center": center,
                "normal": normal, "up": up, "extent": extent}
        answer = self._json("slice", body, if_match, NPY, progress, cancel,
                            deadline=deadline, outputs=",".join(names))
        rows = npy_array(answer.body).reshape(
            height, width, sum(COLUMNS[n] for n in names))
        return Values(rows, names, answer.revision)

    def slice_png(self, width: int = 512, height: int = 512, *,
                  center: Optional[Corner] = None,
                  normal: Optional[Corner] = None,
                  up: Optional[Corner] = None,
                  extent: Optional[float] = None,
                  levels: Optional[Levels] = None,
                  iso: Optional[float] = None,
                  if_match: Optional[str] = None,
                  deadline: Optional[float] = None,
                  progress: Optional[Progress] = None,
                  cancel: Optional[Cancellation] = None) -> bytes:
        """The same as a picture with iso-lines, a PNG file's bytes. levels:
        the values of thin lines, or one number, the step between them."""
        steps: Any = ({"step": levels} if isinstance(levels, (int, float))
                      else levels)
        body = {"width": width, "height": height, "center": center,
                "normal": normal, "up": up, "extent": extent,
                "levels": steps, "iso": iso}
        return bytes(self._json("slice", body, if_match, "image/png",
                                progress, cancel, deadline=deadline).body)

    # --- sending ------------------------------------------------------------

    def _json(self, what: str, body: Mapping[str, Any],
              if_match: Optional[str], accept: str = JSON,
              progress: Optional[Progress] = None,
              cancel: Optional[Cancellation] = None,
              **query: Union[str, float, None]) -> Answer:
        """POST of those members that are not None."""
        given = {k: v for k, v in body.items() if v is not None}
        return self._post(what, json_bytes(given), JSON, accept, if_match,
                          progress, cancel, **query)

    def _post(self, what: str, body: Body, kind: str, accept: str,
              if_match: Optional[str], progress: Optional[Progress] = None,
              cancel: Optional[Cancellation] = None,
              **query: Union[str, float, None]) -> Answer:
        return self._note(self.client.transport.request(
            "POST", f"{self._path}/{what}", query=query, body=body, kind=kind,
            accept=accept, headers=_tag(if_match), progress=progress,
            cancel=cancel))

    def _note(self, answer: Answer) -> Answer:
        self.revision = answer.revision or self.revision
        return answer


def _tag(revision: Optional[str]) -> Dict[str, str]:
    return {"If-Match": f'"{revision}"'} if revision else {}


def _counts(header: str) -> Dict[str, int]:
    """Of "vertices=8, triangles=12, genus=0"."""
    pairs = [part.split("=", 1) for part in header.split(",") if "=" in part]
    return {k.strip(): int(v) for k, v in pairs}


def _write(path: "Union[str, os.PathLike[str]]", data: Body) -> None:
    """Writes a file whole or not at all."""
    folder = os.path.dirname(os.path.abspath(os.fspath(path)))
    handle, aside = tempfile.mkstemp(dir=folder)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(aside, 0o666 & ~mask)
        os.replace(aside, path)
    except BaseException:
        os.unlink(aside)
        raise
