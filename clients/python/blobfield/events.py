"""Changes of a scene as they are made: server-sent events (WHATWG HTML, 9.2),
over connections that are made again when they break."""
from __future__ import annotations

import json
import math
import time
from typing import Callable, Iterator, List, NamedTuple, Optional

from .errors import Busy, ConnectionFailed, NotFound, TooManyRequests
from .results import Event
from .transport import Cancellation, Stream, Transport

#: Seconds of silence after which a connection is broken: the daemon sends a
#: line every 15 s.
SILENCE_S = 40.0
#: Seconds from the end of a connection to the next one, unless told.
PAUSE_S = 2.0


class Message(NamedTuple):
    """What lies between two empty lines."""

    kind: str
    data: str
    id: Optional[str]
    retry: Optional[float]  # s


def parse(lines: List[bytes]) -> Message:
    kind, data, id, retry = "message", [], None, None
    for line in lines:
        name, _, value = line.decode("utf-8", "replace").partition(":")
        value = value[1:] if value.startswith(" ") else value
        if name == "event":
            kind = value
        elif name == "data":
            data.append(value)
        elif name == "id":
            id = value
        elif name == "retry" and value.isdecimal():
            retry = int(value) / 1000
    return Message(kind, "\n".join(data), id, retry)


def messages(stream: Stream, left: Callable[[], float]
             ) -> Iterator[Message]:
    """Those of one connection, until it ends, or nothing comes for so many
    seconds as left says each time."""
    lines: List[bytes] = []
    while True:
        line = stream.line(min(SILENCE_S, left()))
        if not line:
            return  # what is not ended by an empty line does not count
        line = line.rstrip(b"\r\n")
        if line:
            lines.append(line)
        elif lines:
            yield parse(lines)
            lines = []


def follow(transport: Transport, path: str, last: Optional[str],
           timeout: Optional[float], cancel: Cancellation,
           seen: Callable[[Event], None]) -> Iterator[Event]:
    """Scene.events. seen: called with each before it comes."""
    begun = False
    pause = PAUSE_S
    until = math.inf  # before the first event: as long as it takes

    def left() -> float:
        return until - time.monotonic()
    while True:
        wait = pause
        try:
            stream = transport.stream(
                path, cancel=cancel,
                headers={"Accept": "text/event-stream",
                         **({"Last-Event-ID": last} if last else {})})
        except NotFound:
            if begun:
                return  # deleted while nobody listened
            raise
        except (ConnectionFailed, Busy, TooManyRequests) as e:
            if not begun:
                raise
            wait = max(pause, getattr(e, "retry_after", 0.0))
        else:
            begun = True
            if last and timeout is not None and until == math.inf:
                until = time.monotonic() + timeout  # there may be no event
            try:
                for m in messages(stream, left):
                    pause = wait = pause if m.retry is None else m.retry
                    if m.kind not in ("revision", "deleted"):
                        continue
                    event = Event.of(m.kind, json.loads(m.data))
                    last = m.id or event.sequence
                    if timeout is not None:
                        until = time.monotonic() + timeout
                    seen(event)
                    yield event
                    if event.deleted:
                        return
            finally:
                stream.close()
        if left() <= 0:
            return
        cancel.sleep(min(wait, left()))
