"""HTTP with kept connections: what the rest of the package sends through.

Thread-safe: every request has a connection to itself, taken from a stack of
idle ones or opened, and put back after.
"""
from __future__ import annotations

import http.client
import json
import os
import secrets
import selectors
import socket
import ssl
import threading
import time
import urllib.parse
from concurrent.futures import Future, ThreadPoolExecutor, wait
from email.message import Message
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple, Union

from .errors import (BlobfieldError, Busy, Cancelled, ConnectionFailed,
                     ProblemError, TooManyRequests, problem)

Body = Union[bytes, bytearray, memoryview]
Query = Mapping[str, Union[str, int, float, None]]
#: Called with a stage ("cells", "rays", ...) and how much is done, 0 to 1.
Progress = Callable[[str, float], None]

IDLE_MOST = 8
POLL_S = 0.15


class Cancellation:
    """Ends requests from another thread: give one as `cancel=`, call cancel().

    The connection is closed, at which the daemon gives the work up; the
    request raises Cancelled. It stays cancelled: make another for the next.
    """

    def __init__(self) -> None:
        self._event = threading.Event()
        self._lock = threading.Lock()  # guards _sockets
        self._sockets: List[socket.socket] = []

    @property
    def cancelled(self) -> bool:
        return self._event.is_set()

    def cancel(self) -> None:
        with self._lock:
            self._event.set()
            for s in self._sockets:
                _hang_up(s)

    def check(self) -> None:
        """Raises Cancelled if so."""
        if self.cancelled:
            raise Cancelled("cancelled")

    def sleep(self, seconds: float) -> None:
        """Sleeps, or raises Cancelled."""
        self._event.wait(seconds)
        self.check()

    def _attach(self, s: socket.socket) -> None:
        with self._lock:
            self.check()
            self._sockets.append(s)

    def _detach(self, s: socket.socket) -> None:
        with self._lock:
            self._sockets.remove(s)


class Answer:
    """Status, headers and body of what came back."""

    def __init__(self, status: int, headers: Message, body: Body) -> None:
        self.status = status
        self.headers = headers
        self.body = body

    def json(self) -> Any:
        return json.loads(bytes(self.body))

    @property
    def revision(self) -> Optional[str]:
        """The ETag without its quotes."""
        tag = self.headers.get("ETag")
        return str(tag).strip('"') if tag else None


class Transport:
    """Requests to one daemon.

    url: "http://host:port", a path below it allowed, https too (a proxy's).
    timeout: seconds without a byte from the daemon after which a request is
    given up; None: never. connect_timeout: to open a connection. retry_for:
    seconds that 503 and 429 answers are retried in all, at the pace of
    Retry-After; retries: how often at most. headers: sent with every request.
    ca: a file of certificates to trust instead of the system's.
    """

    def __init__(self, url: str, timeout: Optional[float],
                 connect_timeout: float, retry_for: float,
                 headers: Mapping[str, str],
                 ca: "Union[str, os.PathLike[str], None]" = None,
                 retries: Optional[int] = None) -> None:
        parts = _address(url)
        self.url = urllib.parse.urlunsplit(parts).rstrip("/")
        self._tls = _trust(ca) if parts.scheme == "https" else None
        self._host = parts.hostname or ""
        self._port = parts.port
        self._base = parts.path.rstrip("/")
        self._timeout = timeout
        self._connect_timeout = connect_timeout
        self._retry_for = retry_for
        self._retries = float("inf") if retries is None else retries
        self._headers = dict(headers)
        self._lock = threading.Lock()  # guards _idle
        self._idle: List[http.client.HTTPConnection] = []

    def close(self) -> None:
        """Closes idle connections. More may be opened later."""
        with self._lock:
            idle, self._idle = self._idle, []
        for c in idle:
            c.close()

    def request(self, method: str, path: str, *,
                query: Optional[Query] = None, body: Optional[Body] = None,
                kind: Optional[str] = None, accept: Optional[str] = None,
                headers: Optional[Mapping[str, str]] = None,
                again: bool = True, retry: bool = True,
                progress: Optional[Progress] = None,
                cancel: Optional[Cancellation] = None) -> Answer:
        """Sends, and answers with what came back if its status is below 400
        (304 too); raises its problem else.

        kind: Content-Type of body. again: may be sent twice if a kept
        connection breaks. retry: 503s and 429s are. progress: called from this thread
        while the request runs in another, where path takes ?progress=; what it
        raises cancels the request.
        """
        send = dict(self._headers)
        if kind:
            send["Content-Type"] = kind
        if accept:
            send["Accept"] = accept
        send.update(headers or {})
        given = {k: v for k, v in (query or {}).items() if v is not None}
        if progress is None:
            if not retry:
                return self._once(method, _target(path, given), body, send,
                                  again, cancel)
            return self._persist(method, _target(path, given), body, send,
                                 again, cancel)
        token = secrets.token_hex(12)
        target = _target(path, {**given, "progress": token})
        watched = cancel or Cancellation()
        with ThreadPoolExecutor(1, "blobfield") as pool:
            work = pool.submit(self._persist, method, target, body, send,
                               again, watched)
            try:
                self._watch(token, work, progress)
            except BaseException:
                watched.cancel()
                raise
            return work.result()

    def _watch(self, token: str, work: "Future[Answer]",
               progress: Progress) -> None:
        """Calls progress until work ends."""
        stage = "waiting"
        while not wait([work], timeout=POLL_S).done:
            try:
                at = self._once("GET", _target("/v1/progress/" + token, {}),
                                None, dict(self._headers), True, None).json()
            except BlobfieldError:
                continue  # not begun, or over
            stage = str(at.get("stage", stage))
            progress(stage, float(at.get("done", 0)))
        if work.exception() is None:
            progress(stage, 1.0)

    def _persist(self, method: str, target: str, body: Optional[Body],
                 headers: Dict[str, str], again: bool,
                 cancel: Optional[Cancellation]) -> Answer:
        """_once, until it is neither 503 nor 429, or retry_for is over, or
        retries have been made."""
        last = time.monotonic() + self._retry_for
        left = self._retries
        while True:
            try:
                return self._once(method, target, body, headers, again, cancel)
            except (Busy, TooManyRequests) as busy:
                pause = busy.retry_after
                left -= 1
                if busy.slug == "draining" or left < 0 or \
                        time.monotonic() + pause > last:
                    raise
            (cancel or Cancellation()).sleep(pause)

    def _once(self, method: str, target: str, body: Optional[Body],
              headers: Dict[str, str], again: bool,
              cancel: Optional[Cancellation]) -> Answer:
        while True:
            connection, kept = self._take()
            try:
                return self._exchange(connection, method, self._base + target,
                                      body, headers, cancel)
            except (OSError, http.client.HTTPException) as e:
                connection.close()
                if cancel is not None:
                    cancel.check()
                if kept and again and not isinstance(e, socket.timeout):
                    continue  # it was closed while idle; the next is fresh
                raise ConnectionFailed(self._why(e)) from e
            except BaseException:
                connection.close()
                raise

    def _why(self, e: Exception) -> str:
        if isinstance(e, socket.timeout):
            return f"{self.url} does not answer within the timeout"
        if isinstance(e, ConnectionRefusedError):
            return (f"nothing listens at {self.url}: is blobfieldd running "
                    "there?")
        if isinstance(e, ssl.SSLCertVerificationError):
            return (f"the certificate of {self.url} is not to be trusted: "
                    f"{e.verify_message} (Client(ca=) names the file of one "
                    "that is)")
        if isinstance(e, (http.client.IncompleteRead, ConnectionError)):
            return f"{self.url} closed the connection in the middle"
        return f"{self.url} cannot be reached: {e or type(e).__name__}"

    def _take(self) -> Tuple[http.client.HTTPConnection, bool]:
        """A connection, and whether it was used before."""
        while True:
            with self._lock:
                c = self._idle.pop() if self._idle else None
            if c is None:
                break
            if c.sock is not None and not _readable(c.sock):
                return c, True
            c.close()  # the daemon has closed it
        return self._open(), False

    def _open(self) -> http.client.HTTPConnection:
        """A new one, not yet connected."""
        if self._tls is None:
            return http.client.HTTPConnection(
                self._host, self._port, timeout=self._connect_timeout)
        return http.client.HTTPSConnection(
            self._host, self._port, timeout=self._connect_timeout,
            context=self._tls)

    def stream(self, path: str, *, query: Optional[Query] = None,
               headers: Optional[Mapping[str, str]] = None,
               cancel: Optional[Cancellation] = None) -> "Stream":
        """GET of an answer that goes on, over a connection of its own, which
        close ends. Nothing is retried."""
        given = {k: v for k, v in (query or {}).items() if v is not None}
        cancel = cancel or Cancellation()
        c = self._open()
        try:
            c.connect()
            s: socket.socket = c.sock
            s.settimeout(self._timeout)
            cancel._attach(s)
        except OSError as e:
            c.close()
            raise ConnectionFailed(self._why(e)) from e
        except BaseException:
            c.close()
            raise
        stream = Stream(c, s, cancel)
        try:
            c.request("GET", self._base + _target(path, given),
                      headers={**self._headers, **(headers or {})})
            stream.response = c.getresponse()
            if stream.response.status >= 400:
                raise _refusal(Answer(
                    stream.response.status, stream.response.headers,
                    _read(stream.response)))
        except (OSError, http.client.HTTPException) as e:
            stream.close()
            cancel.check()
            raise ConnectionFailed(self._why(e)) from e
        except BaseException:
            stream.close()
            raise
        return stream

    def _exchange(self, c: http.client.HTTPConnection, method: str,
                  target: str, body: Optional[Body], headers: Dict[str, str],
                  cancel: Optional[Cancellation]) -> Answer:
        if c.sock is None:
            c.connect()
            c.sock.settimeout(self._timeout)  # type: ignore[attr-defined]
        s: socket.socket = c.sock  # type: ignore[assignment]
        if cancel is not None:
            cancel._attach(s)
        try:
            try:
                c.request(method, target, body, headers)
            except (BrokenPipeError, ConnectionResetError):
                pass  # a refusal may have come before the body was read
            response = c.getresponse()
            answer = Answer(response.status, response.headers,
                            _read(response))
        finally:
            if cancel is not None:
                cancel._detach(s)
        if response.will_close:
            c.close()
        else:
            with self._lock:
                if len(self._idle) < IDLE_MOST:
                    self._idle.append(c)
                    c = None  # type: ignore[assignment]
            if c is not None:
                c.close()
        if cancel is not None:
            cancel.check()
        if answer.status >= 400:
            raise _refusal(answer)
        return answer


class Stream:
    """An answer that comes line by line for as long as it lasts."""

    response: http.client.HTTPResponse

    def __init__(self, connection: http.client.HTTPConnection,
                 s: socket.socket, cancel: Cancellation) -> None:
        self._connection = connection
        self._socket = s
        self._cancel = cancel

    def line(self, timeout: float) -> Optional[bytes]:
        """The next line with its end, b"" if it is over or broken; None: it
        does not come within timeout seconds, and the stream is of no use any
        more. Raises Cancelled."""
        try:
            self._socket.settimeout(max(timeout, 0.001))
            got = self.response.readline()
        except socket.timeout:
            return None
        except (OSError, ValueError, http.client.HTTPException):
            got = b""
        self._cancel.check()
        return got

    def close(self) -> None:
        self._cancel._detach(self._socket)
        self._connection.close()
        if hasattr(self, "response"):
            self.response.close()


def _refusal(answer: Answer) -> ProblemError:
    e = problem(answer.status, answer.headers.get("Content-Type"),
                bytes(answer.body))
    if isinstance(e, (Busy, TooManyRequests)):
        e.retry_after = _seconds(answer.headers.get("Retry-After"),
                                 10.0 if isinstance(e, Busy) else 1e9)
    return e


def _address(url: str) -> urllib.parse.SplitResult:
    parts = urllib.parse.urlsplit(url if "//" in url else "http://" + url)
    try:
        parts.port  # raises what urllib thinks of it
        good = parts.scheme in ("http", "https") and parts.hostname
    except ValueError:
        good = None
    if not good:
        raise ValueError(f"not the address of a daemon: {url!r}")
    return parts


def _trust(ca: "Union[str, os.PathLike[str], None]") -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=ca)
    except OSError as e:  # of the file, or of what is in it
        raise ValueError(f"{ca} has no certificates to trust: "
                         f"{e.strerror or e}") from e


def _target(path: str, query: Mapping[str, Any]) -> str:
    if not query:
        return path
    return path + "?" + urllib.parse.urlencode(query, safe=",")


def _read(response: http.client.HTTPResponse) -> Body:
    """The body, into memory that NumPy may write to."""
    if not response.length:
        return bytearray(response.read())
    data = bytearray(response.length)
    view = memoryview(data)
    at = 0
    while at < len(data):
        n = response.readinto(view[at:])
        if not n:
            raise http.client.IncompleteRead(b"", len(data) - at)
        at += n
    response.read()  # marks its end
    return data


def _seconds(retry_after: Optional[str], most: float) -> float:
    try:
        return min(max(float(retry_after or 1), 0.05), most)
    except ValueError:
        return 1.0


def _readable(s: socket.socket) -> bool:
    with selectors.DefaultSelector() as selector:
        selector.register(s, selectors.EVENT_READ)
        return bool(selector.select(0))


def _hang_up(s: socket.socket) -> None:
    try:
        s.shutdown(socket.SHUT_RDWR)
    except OSError:
        pass
