"""What can go wrong.

    BlobfieldError
        ConnectionFailed    no daemon there, or the connection was cut
        Cancelled           by a Cancellation
        ProblemError        the daemon says no; by status:
            Unauthorized        401  no token, or one that is not known
            Forbidden           403  the token's role is too small
            NotFound            404
            Conflict            409  a patch's test failed
            PreconditionFailed  412  somebody else changed the scene
            InvalidContent      422  errors says where
            TooManyRequests     429  the token's limits, after the retries
            Busy                503  after the retries
                StoreUnavailable     it cannot be kept now
                DeviceLost           the daemon is getting its device back
            DeadlineExceeded    504
"""
from __future__ import annotations

import json
from typing import Any, Dict, List, NamedTuple, Optional


class BlobfieldError(Exception):
    """All of this package's own errors."""


class ConnectionFailed(BlobfieldError):
    """The daemon cannot be reached, or went away in the middle."""


class Cancelled(BlobfieldError):
    """A Cancellation ended the request."""


class Fault(NamedTuple):
    """One place that is wrong: a JSON pointer into what was sent (or
    "?name", a query parameter), and a sentence."""

    pointer: str
    detail: str


class ProblemError(BlobfieldError):
    """An answer of status 400 and above (RFC 9457).

    type: "/problems/invalid" and so on; slug: its last part; title, status,
    detail; errors: the places that are wrong, perhaps none; error_count: how
    many there are (errors has the first 16); members: the whole answer.
    """

    def __init__(self, status: int, members: Dict[str, Any]) -> None:
        self.members = members
        self.status = status
        self.type = str(members.get("type", "about:blank"))
        self.slug = self.type.rsplit("/", 1)[-1]
        self.title = str(members.get("title", ""))
        self.detail = str(members.get("detail", ""))
        listed = members.get("errors")
        self.errors: List[Fault] = [
            Fault(str(e.get("pointer", "")), str(e.get("detail", "")))
            for e in (listed if isinstance(listed, list) else [])
            if isinstance(e, dict)]
        self.error_count = int(members.get("error_count", len(self.errors)))
        super().__init__(self._message())

    def __reduce__(self) -> Any:  # for other processes
        return type(self), (self.status, self.members)

    def _message(self) -> str:
        head = f"{self.title or 'The daemon refused'} ({self.status})"
        if self.detail.startswith("The document after the patch"):
            head += " in the document after the patch"
        if not self.errors:
            return f"{head}: {self.detail}" if self.detail else head
        lines = [f"{e.pointer or 'the whole'}: {e.detail}"
                 for e in self.errors]
        if self.error_count > len(lines):
            lines.append(f"and {self.error_count - len(lines)} more")
        if len(lines) == 1:
            return f"{head}: {lines[0]}"
        return "\n  ".join([f"{head}, {self.error_count} places:"] + lines)


class Unauthorized(ProblemError):
    """The daemon asks for a token, or does not know this one: Client(token=)
    or BLOBFIELD_TOKEN."""


class Forbidden(ProblemError):
    """The token's role does not suffice; detail says which does."""


class NotFound(ProblemError):
    """No such scene, operator, volume or path."""


class Conflict(ProblemError):
    """The scene is not as a patch's "test" says; nothing has changed."""


class PreconditionFailed(ProblemError):
    """The scene is of another revision than asked for."""


class InvalidContent(ProblemError):
    """Well-formed, but wrong, or beyond a limit: errors says where."""


class TooManyRequests(ProblemError):
    """The token has used what it may; retries did not help. detail says which
    limit."""

    retry_after = 1.0  #: seconds until the next request can come


class Busy(ProblemError):
    """Queue full, out of memory, or about to end; retries did not help."""

    retry_after = 1.0  #: seconds, as the daemon proposes


class StoreUnavailable(Busy):
    """Scenes cannot be kept now (a full disk, a store that is away): nothing
    has changed. Those that are there can be read and evaluated."""


class DeviceLost(Busy):
    """The device failed during the request; the daemon is rebuilding it."""


class DeadlineExceeded(ProblemError):
    """The deadline asked for has passed."""


_KINDS = {401: Unauthorized, 403: Forbidden, 404: NotFound, 409: Conflict,
          412: PreconditionFailed, 422: InvalidContent, 429: TooManyRequests,
          503: Busy, 504: DeadlineExceeded}
_BUSY = {"store-unavailable": StoreUnavailable, "device-lost": DeviceLost}


def problem(status: int, kind: Optional[str], body: bytes) -> ProblemError:
    """The error of an answer: status, Content-Type, body."""
    members: Dict[str, Any] = {}
    if kind and kind.split(";")[0].strip() in ("application/problem+json",
                                               "application/json"):
        try:
            parsed = json.loads(body)
            members = parsed if isinstance(parsed, dict) else {}
        except ValueError:
            pass
    if not members:
        members = {"title": "HTTP error",
                   "detail": body[:200].decode("utf-8", "replace").strip()}
    kind_of = _KINDS.get(status, ProblemError)
    if kind_of is Busy:
        slug = str(members.get("type", "")).rsplit("/", 1)[-1]
        kind_of = _BUSY.get(slug, Busy)
    return kind_of(status, members)
