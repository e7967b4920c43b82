#!/usr/bin/python3
"""Clients that mean no good, against one daemon: what they send is refused or
handled, never taken for another request, and nothing of them stays.

Starts the daemon ($BLOBFIELDD, else build/blobfieldd) with --request-time 2 and
--max-body 1m, and runs every attack HOSTILE_ROUNDS times (2; more in
`make soak`): the first round warms up, and after the last one the daemon
answers as before it, with as many descriptors and threads, and in hardly more
memory. Prints its cases as cmocka does.
"""
import contextlib
import json
import os
import random
import re
import resource
import socket
import struct
import subprocess
import sys
import threading
import time
import traceback

# The tables that tests/run.sh has built for all, or none.
CACHE = (["--cache", os.environ["BLOBFIELD_TEST_CACHE"],
          "--cache-read-only"] if "BLOBFIELD_TEST_CACHE" in os.environ
         else ["--no-cache"])

ROUNDS = int(os.environ.get("HOSTILE_ROUNDS", "2"))
IS_SANITIZED = bool(os.environ.get("SAN"))
REQUEST_TIME = 2
MAX_BODY = 1 << 20
IDLE = 1000
# Resident memory over the rounds after the first, in KiB (measured: 3,700 to
# 38,000, of which 32,768 are 1,000 connections' heads; each of two threads may
# come to have all of them), and over the second half of many (measured: 800).
GROWTH_MOST = 65536
LATE_GROWTH_MOST = 12288
MANY_ROUNDS = 12
# Who hung up on events is noticed when the next line is sent; what was reset
# behind the library, after its 60 s without a byte.
NOTICE_SECONDS = 75

HOST = b"Host: localhost\r\n"
JSON = b"Content-Type: application/json\r\n"
GET = b"GET /healthz HTTP/1.1\r\n"
EVAL = b"POST /v1/eval HTTP/1.1\r\n" + HOST + JSON
END = b"\r\n"
CHUNKED = EVAL + b"Transfer-Encoding: chunked\r\n\r\n"
# Behind what is refused: to be taken for a part of it, never for a request.
SMUGGLED = GET + HOST + END

SCENE = {"format": "blobfield/1", "root": {
    "type": "union", "operator": "camel", "children": [
        {"type": "point", "center": [1.5 * i, 0, 0], "radius": 1}
        for i in range(4)]}}


class Daemon:
    """A daemon on a free port, ready if need be."""

    def __init__(self, *arguments, is_ready=False):
        program = os.environ.get("BLOBFIELDD", "build/blobfieldd")
        self.process = subprocess.Popen(
            [program, *CACHE, "--no-measure", "--data", ":memory:", "--listen",
             "127.0.0.1:0", "--quiet", "--no-measure", *arguments],
            stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        self.port = int(re.search(r":(\d+)$", line.strip()).group(1))
        while is_ready and self.get("/readyz")[0] != 200:
            if self.process.poll() is not None:
                raise RuntimeError("the daemon has ended")
            time.sleep(0.1)

    def connect(self):
        sock = socket.create_connection(("127.0.0.1", self.port), 60)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return sock

    def get(self, path):
        return self.ask(b"GET %s HTTP/1.1\r\n" % path.encode() + HOST +
                        b"Connection: close\r\n\r\n")

    def post(self, path, value):
        return self.ask(post(path, value, b"Connection: close\r\n"))

    def ask(self, text):
        """Status and body of the first answer to text; 0: none."""
        return split(self.talk(text))

    def talk(self, text, patience=60):
        """All that comes until the daemon closes, or nothing does."""
        with self.connect() as sock:
            with contextlib.suppress(OSError):
                sock.sendall(text)
            return drain(sock, patience)

    def stop(self):
        self.process.terminate()
        self.process.stdout.close()
        status = self.process.wait(120)
        assert status == 0, "the daemon ended with status %d" % status

    # --- what it takes ---

    def count(self, folder):
        return len(os.listdir("/proc/%d/%s" % (self.process.pid, folder)))

    def resident(self):
        """KiB."""
        with open("/proc/%d/status" % self.process.pid) as f:
            return int(re.search(r"VmRSS:\s*(\d+)", f.read()).group(1))

    def settle(self):
        """Waits until what has been hung up is gone; descriptors, threads."""
        last = None
        for _ in range(60):
            now = self.count("fd"), self.count("task")
            if now == last:
                return now
            last = now
            time.sleep(2.5)
        return last


def drain(sock, patience):
    """All bytes up to the end; of a connection that stays open, what came."""
    sock.settimeout(patience)
    parts = []
    with contextlib.suppress(ConnectionError, TimeoutError):
        while data := sock.recv(65536):
            parts.append(data)
    return b"".join(parts)


def split(answer):
    match = re.match(rb"HTTP/1\.1 (\d+)", answer)
    return (int(match.group(1)) if match else 0,
            answer.partition(b"\r\n\r\n")[2])


def post(path, value, headers=b""):
    body = json.dumps(value).encode()
    return (b"POST %s HTTP/1.1\r\n" % path.encode() + HOST + JSON + headers +
            b"Content-Length: %d\r\n\r\n" % len(body) + body)


def statuses(answer):
    return [int(s) for s in re.findall(rb"HTTP/1\.1 (\d\d\d) ", answer)]


def is_soon(seconds, bound):
    """Of what takes so many seconds where nothing else runs; load is let pass."""
    crowd = max(1.0, os.getloadavg()[0] / os.cpu_count())
    return seconds < 2 * crowd * bound


def alive(daemon):
    begin = time.monotonic()
    assert daemon.get("/healthz")[0] == 200
    return time.monotonic() - begin


# --- bytes and what they get -------------------------------------------------

# name, bytes, statuses one of which the first answer has; 0: closed without.
# All close the connection, and what is behind is not answered.
REFUSED = [
    # What is no request line.
    ("no version", b"GET /healthz\r\n" + HOST + END, {400}),
    ("version in small letters", b"GET /healthz http/1.1\r\n" + HOST + END,
     {400}),
    ("HTTP/1.10", b"GET /healthz HTTP/1.10\r\n" + HOST + END, {400}),
    ("HTTP/0.9", b"GET /healthz HTTP/0.9\r\n" + HOST + END, {505}),
    ("HTTP/1.2", b"GET /healthz HTTP/1.2\r\n" + HOST + END, {505}),
    ("HTTP/2.0", b"GET /healthz HTTP/2.0\r\n" + HOST + END, {505}),
    ("HTTP/2's preface", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", {505}),
    ("one word", b"GET\r\n\r\n", {0, 400}),
    ("blanks in the target", b"GET /heal thz HTTP/1.1\r\n" + HOST + END,
     {400}),
    ("a tab in the target", b"GET /heal\tthz HTTP/1.1\r\n" + HOST + END,
     {400}),
    ("a NUL in the target", b"GET /healthz\0 HTTP/1.1\r\n" + HOST + END,
     {400}),
    ("a NUL in the query", b"GET /healthz?\0=1 HTTP/1.1\r\n" + HOST + END,
     {400}),
    ("a NUL in the method", b"GE\0T /healthz HTTP/1.1\r\n" + HOST + END,
     {0, 400}),
    ("no method", b" /healthz HTTP/1.1\r\n" + HOST + END, {0, 400}),
    ("a method of other characters", b"G@T /healthz HTTP/1.1\r\n" + HOST + END,
     {400}),
    ("a tab behind the method", b"GET\t/ /healthz HTTP/1.1\r\n" + HOST + END,
     {400}),
    # Line ends.
    ("LF alone behind the request line",
     b"GET /healthz HTTP/1.1\n" + HOST + END, {400}),
    ("LF alone behind a header", GET + b"Host: localhost\nX: y\r\n\r\n",
     {400}),
    ("LF alone behind the last header", GET + b"Host: localhost\n\r\n", {400}),
    ("an empty line of LF alone", GET + HOST + b"\n", {400}),
    ("LF alone everywhere", b"GET /healthz HTTP/1.1\nHost: a\n\n", {400}),
    ("CR alone in a value", GET + b"Host: localhost\rX: y\r\n\r\n", {400}),
    ("CR alone behind a value", GET + HOST + b"X: y\r\r\n\r\n", {400}),
    # Headers.
    ("a blank before the colon", GET + b"Host : localhost\r\n\r\n", {400}),
    ("a tab before the colon", GET + HOST + b"X\t: 1\r\n\r\n", {400}),
    ("a length with a blank before its colon",
     EVAL + b"Content-Length : 5\r\n\r\nhello", {400}),
    ("no colon", GET + HOST + b"nonsense\r\n\r\n", {400}),
    ("no name", GET + HOST + b": x\r\n\r\n", {400}),
    ("a NUL in a name", GET + HOST + b"X\0Y: 1\r\n\r\n", {400}),
    ("a NUL in a value", GET + HOST + b"X: a\0b\r\n\r\n", {400}),
    ("a NUL behind a value", GET + HOST + b"X: a\0\r\n\r\n", {400}),
    ("a line that begins with a NUL", EVAL + b"\0X: a\r\n"
     b"Content-Length: 5\r\n\r\nhello", {400}),
    ("a header behind a NUL", EVAL + b"X: a\0\0Content-Length\0: 5\r\n\r\n",
     {400}),
    ("a control character in a value", GET + HOST + b"X: \x01\r\n\r\n", {400}),
    ("a DEL in a value", GET + HOST + b"X: \x7f\r\n\r\n", {400}),
    ("a name that is no token", GET + HOST + b"X(y): 1\r\n\r\n", {400}),
    ("a name in UTF-8", GET + HOST + "Gr\u00fc\u00dfe: 1\r\n\r\n".encode(),
     {400}),
    ("a header that goes on", GET + HOST + b"X: a\r\n b\r\n\r\n", {400}),
    ("a header that goes on after nothing", GET + HOST + b"X:\r\n\ta\r\n\r\n",
     {400}),
    ("Transfer-Encoding that goes on",
     EVAL + b"Transfer-Encoding:\r\n chunked\r\n\r\n0\r\n\r\n", {400}),
    ("Content-Length that goes on",
     EVAL + b"Content-Length: 5\r\n 0\r\n\r\nhello", {400}),
    ("a first header that goes on nothing", GET + b" X: a\r\n" + HOST + END,
     {400}),
    # Host.
    ("no Host", GET + END, {400}),
    ("an empty Host", GET + b"Host:\r\n\r\n", {400}),
    ("two Hosts", GET + HOST + HOST + END, {400}),
    ("two Hosts that differ in case", GET + HOST + b"hOST: b\r\n\r\n", {400}),
    ("a Host of two words", GET + b"Host: a b\r\n\r\n", {400}),
    ("a Host with a path", GET + b"Host: a/b\r\n\r\n", {400}),
    ("a Host with a user", GET + b"Host: me@a\r\n\r\n", {400}),
    ("a Host with a comma in its port", GET + b"Host: a:1,2\r\n\r\n", {400}),
    ("a Host with a long port", GET + b"Host: a:123456\r\n\r\n", {400}),
    ("a Host with half a bracket", GET + b"Host: [::1\r\n\r\n", {400}),
    # Lengths.
    ("two lengths", EVAL + b"Content-Length: 2\r\nContent-Length: 2\r\n\r\n{}",
     {400}),
    ("two lengths that differ",
     EVAL + b"Content-Length: 2\r\nContent-Length: 3\r\n\r\n{}", {400}),
    ("two lengths of nothing",
     EVAL + b"Content-Length: 0\r\nContent-Length: 0\r\n\r\n", {400}),
    ("a list of lengths", EVAL + b"Content-Length: 2, 2\r\n\r\n{}", {400}),
    ("a length of +2", EVAL + b"Content-Length: +2\r\n\r\n{}", {400}),
    ("a length of -2", EVAL + b"Content-Length: -2\r\n\r\n{}", {400}),
    ("a length of 0x2", EVAL + b"Content-Length: 0x2\r\n\r\n{}", {400}),
    ("a length of 2.0", EVAL + b"Content-Length: 2.0\r\n\r\n{}", {400}),
    ("a length of 2 and a blank", EVAL + b"Content-Length: 2 \r\n\r\n{}",
     {400}),
    ("a length in quotes", EVAL + b'Content-Length: "2"\r\n\r\n{}', {400}),
    ("a length of nothing", EVAL + b"Content-Length:\r\n\r\n{}", {400}),
    ("a length of 2^64 + 2",
     EVAL + b"Content-Length: 18446744073709551618\r\n\r\n{}", {413}),
    ("a length of 2^64 - 1",
     EVAL + b"Content-Length: 18446744073709551615\r\n\r\n{}", {400, 413}),
    ("a length over the limit", EVAL + b"Content-Length: 1048577\r\n\r\n{}",
     {413}),
    ("a length over the limit, expecting 100",
     EVAL + b"Content-Length: 1048577\r\nExpect: 100-continue\r\n\r\n", {413}),
    ("a length over the limit where there is nothing",
     b"POST /nowhere HTTP/1.1\r\n" + HOST + b"Content-Length: 1048577\r\n"
     b"Expect: 100-continue\r\n\r\n", {413}),
    # Transfer-Encoding.
    ("length and chunks",
     EVAL + b"Content-Length: 2\r\nTransfer-Encoding: chunked\r\n\r\n"
     b"0\r\n\r\n", {400}),
    ("chunks and length",
     EVAL + b"Transfer-Encoding: chunked\r\nContent-Length: 5\r\n\r\n"
     b"0\r\n\r\n", {400}),
    ("chunked twice", EVAL + b"Transfer-Encoding: chunked\r\n"
     b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", {400}),
    ("chunked and identity", EVAL + b"Transfer-Encoding: chunked\r\n"
     b"Transfer-Encoding: identity\r\n\r\n0\r\n\r\n", {400}),
    ("chunked, identity",
     EVAL + b"Transfer-Encoding: chunked, identity\r\n\r\n0\r\n\r\n", {501}),
    ("gzip, chunked",
     EVAL + b"Transfer-Encoding: gzip, chunked\r\n\r\n0\r\n\r\n", {501}),
    ("xchunked", EVAL + b"Transfer-Encoding: xchunked\r\n\r\n0\r\n\r\n",
     {501}),
    ("identity", EVAL + b"Transfer-Encoding: identity\r\n\r\n{}", {501}),
    ("chunked and a blank",
     EVAL + b"Transfer-Encoding: chunked \r\n\r\n0\r\n\r\n", {501}),
    ("chunked in quotes",
     EVAL + b'Transfer-Encoding: "chunked"\r\n\r\n0\r\n\r\n', {501}),
    ("chunked behind a vertical tab",
     EVAL + b"Transfer-Encoding: \x0bchunked\r\n\r\n0\r\n\r\n", {400}),
    ("an empty Transfer-Encoding",
     EVAL + b"Transfer-Encoding:\r\n\r\n0\r\n\r\n", {501}),
    ("chunks in HTTP/1.0", b"POST /v1/eval HTTP/1.0\r\n" + HOST + JSON +
     b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", {400}),
    ("a GET of unknown encoding",
     GET + HOST + b"Transfer-Encoding: cow\r\n\r\n", {501}),
    # Chunks.
    ("a chunk without a size", CHUNKED + b"\r\nx\r\n0\r\n\r\n", {400}),
    ("a chunk of -1", CHUNKED + b"-1\r\nx\r\n0\r\n\r\n", {400}),
    ("a chunk of +1", CHUNKED + b"+1\r\nx\r\n0\r\n\r\n", {400}),
    ("a chunk of 0x1", CHUNKED + b"0x1\r\nx\r\n0\r\n\r\n", {400}),
    ("a chunk of g", CHUNKED + b"g\r\nx\r\n0\r\n\r\n", {400}),
    ("a chunk of 1 and a blank", CHUNKED + b"1 \r\nx\r\n0\r\n\r\n", {400}),
    ("a blank before a chunk", CHUNKED + b" 1\r\nx\r\n0\r\n\r\n", {400}),
    ("a chunk of 2^64 + 1",
     CHUNKED + b"10000000000000001\r\nx\r\n0\r\n\r\n", {413}),
    ("a chunk of many digits",
     CHUNKED + b"f" * 60 + b"\r\nx\r\n0\r\n\r\n", {413}),
    ("a chunk longer than it says", CHUNKED + b"1\r\nxy\r\n0\r\n\r\n", {400}),
    ("a chunk that ends with CR", CHUNKED + b"1\r\nx\r0\r\n\r\n", {400}),
    ("a chunk over the limit",
     CHUNKED + b"100001\r\n" + bytes(0x100001) + b"\r\n0\r\n\r\n", {413}),
    ("an extension of 100 KB", CHUNKED + b"1;" + b"a" * 100000 +
     b"\r\nx\r\n0\r\n\r\n", {0, 400, 413, 431, 500}),
    ("a trailer without a colon", CHUNKED + b"0\r\nnonsense\r\n\r\n", {400}),
    ("trailers of 100 KB", CHUNKED + b"0\r\n" + b"X: y\r\n" * 16000 + END,
     {0, 413, 431}),
    # Bodies in other clothes.
    ("a body in gzip", EVAL + b"Content-Encoding: gzip\r\n"
     b"Content-Length: 2\r\n\r\n{}", {415}),
    ("two Content-Types", EVAL + JSON + b"Content-Length: 2\r\n\r\n{}",
     {400}),
    # Too much.
    ("a target of 5,000 bytes", b"GET /" + b"a" * 5000 + b" HTTP/1.1\r\n" +
     HOST + b"Content-Length: 1\r\n\r\n", {414}),
    ("a target of 1 MB", b"GET /" + b"a" * 1000000 + b" HTTP/1.1\r\n" + HOST +
     END, {0, 414}),
    ("a method of 1 MB", b"A" * 1000000 + b" / HTTP/1.1\r\n" + HOST + END,
     {0, 414, 400}),
    ("a header of 1 MB", GET + HOST + b"X: " + b"a" * 1000000 + b"\r\n\r\n",
     {0, 431}),
    ("a name of 1 MB", GET + HOST + b"a" * 1000000 + b": x\r\n\r\n", {0, 431}),
    ("10,000 headers", GET + HOST + b"X: y\r\n" * 10000 + END, {0, 431}),
    ("10,000 cookies", GET + HOST + b"Cookie: " + b"a=b;" * 10000 + b"\r\n\r\n",
     {0, 431}),
    # Other protocols.
    ("TLS", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(32) +
     b"\r\n\r\n", {0, 400}),
]

# name, bytes, the statuses of all answers. The connection stays as it should.
HANDLED = [
    ("two requests at once", GET + HOST + END + GET + HOST +
     b"Connection: close\r\n\r\n", [200, 200]),
    ("empty lines before a request", b"\r\n\r\n" + GET + HOST +
     b"Connection: close\r\n\r\n", [200]),
    # To libmicrohttpd a line that begins with a NUL is an empty one.
    ("zeros before a request", bytes(100) + b"\r\n" + GET + HOST +
     b"Connection: close\r\n\r\n", [200]),
    ("HTTP/1.0", b"GET /healthz HTTP/1.0\r\n\r\n" + SMUGGLED, [200]),
    ("HTTP/1.0, kept", b"GET /healthz HTTP/1.0\r\nConnection: keep-alive\r\n"
     b"\r\n" + GET + HOST + b"Connection: close\r\n\r\n", [200, 200]),
    ("a Host with a port", GET + b"Host: localhost:80\r\n"
     b"Connection: close\r\n\r\n", [200]),
    ("a Host by number", GET + b"Host: [::1]:80\r\nConnection: close\r\n\r\n",
     [200]),
    # RFC 9112, section 3.2.2: the target's host counts; there is but one here.
    ("a target with another host", b"GET http://elsewhere/healthz HTTP/1.1\r\n"
     + HOST + b"Connection: close\r\n\r\n", [200]),
    ("UTF-8 in a value", GET + HOST + "X: Gr\u00fc\u00dfe\r\n".encode() +
     b"Connection: close\r\n\r\n", [200]),
    ("tabs around a value", GET + HOST + b"X:\ty\t\r\n"
     b"Connection: close\r\n\r\n", [200]),
    ("Host at the end", GET + b"X:\r\nConnection: close\r\n" + HOST + END,
     [200]),
    ("Chunked in capitals", EVAL + b"Transfer-Encoding: CHUNKED\r\n"
     b"Connection: close\r\n\r\n2\r\n{}\r\n0\r\n\r\n", [422]),
    ("extensions and trailers", EVAL + b"Transfer-Encoding: chunked\r\n"
     b"\r\n1;a=\"b\"\r\n{\r\n00001\r\n}\r\n0;c\r\nContent-Length: 7\r\n"
     b"Host: b\r\n\r\n" + GET + HOST + b"Connection: close\r\n\r\n",
     [422, 200]),
    ("a GET with a body", GET + HOST + b"Content-Length: 5\r\n\r\nhello" +
     GET + HOST + b"Connection: close\r\n\r\n", [200, 200]),
    ("a GET in chunks", GET + HOST + b"Transfer-Encoding: chunked\r\n\r\n"
     b"5\r\nhello\r\n0\r\n\r\n" + GET + HOST + b"Connection: close\r\n\r\n",
     [200, 200]),
    ("CONNECT", b"CONNECT localhost:80 HTTP/1.1\r\n" + HOST +
     b"Connection: close\r\n\r\n", [404]),
    ("TRACE", b"TRACE /healthz HTTP/1.1\r\n" + HOST +
     b"Connection: close\r\n\r\n", [405]),
    ("an upgrade to HTTP/2", GET + HOST + b"Connection: Upgrade, "
     b"HTTP2-Settings, close\r\nUpgrade: h2c\r\nHTTP2-Settings: AAMAAABk\r\n"
     b"\r\n", [200]),
    ("an upgrade to WebSocket", GET + HOST + b"Connection: Upgrade, close\r\n"
     b"Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
     b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n", [200]),
    ("a strange expectation", EVAL + b"Content-Length: 2\r\nExpect: wonders"
     b"\r\nConnection: close\r\n\r\n{}", [422]),
    ("100 of 100 headers", GET + HOST + b"X: y\r\n" * 100 +
     b"Connection: close\r\n\r\n", [200]),
]


def attack_with_refused(daemon):
    """All at once by a few threads: each waits for its connection's end."""
    wrong = []
    cases = list(REFUSED)

    def work():
        while cases:
            try:
                name, text, allowed = cases.pop()
            except IndexError:
                return
            answer = daemon.talk(text + SMUGGLED)
            got = statuses(answer)
            if (got[0] if got else 0) not in allowed or 200 in got:
                wrong.append("%s: %s" % (name, answer[:300]))

    together([work] * 8)
    assert not wrong, "\n".join(wrong)


def attack_with_handled(daemon):
    for name, text, expected in HANDLED:
        answer = daemon.talk(text)
        assert statuses(answer) == expected, (name, answer[:500])


# --- many, slow, gone --------------------------------------------------------


def together(works):
    failures = []

    def run(work):
        try:
            work()
        except Exception:
            failures.append(traceback.format_exc())

    threads = [threading.Thread(target=run, args=(work,)) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures, failures[0]


def reset(sock):
    """Closes so that the other side gets a reset."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER,
                    struct.pack("ii", 1, 0))
    sock.close()


def attack_by_dripping(daemon):
    """Heads, bodies and chunks of a byte now and then, many at a time: cut
    after --request-time, and nobody else has to wait."""
    starts = ([b""] * 30 + [GET] * 30 + [GET + HOST + b"X: "] * 30 +
              [EVAL + b"Content-Length: 1000\r\n\r\n"] * 30 + [CHUNKED] * 30)
    socks = []
    for start in starts:
        sock = daemon.connect()
        sock.sendall(start)
        socks.append(sock)
    begin = time.monotonic()
    longest = 0.0
    left = list(zip(socks, starts))
    while left and time.monotonic() - begin < 45:
        rest = []
        for sock, start in left:
            try:
                sock.sendall(b"1;a\r\n1\r\n" if start == CHUNKED else b"a")
                sock.setblocking(False)
                gone = sock.recv(4096) == b""
            except BlockingIOError:
                gone = False
            except OSError:
                gone = True
            if not gone:
                sock.setblocking(True)
                rest.append((sock, start))
        left = rest
        longest = max(longest, alive(daemon))
        time.sleep(0.2)
    seconds = time.monotonic() - begin
    for sock in socks:
        sock.close()
    assert not left, "%d are not cut" % len(left)
    # Looked for once a second; the request line counts from the start. Else it would be the library's minute of silence.
    assert is_soon(seconds, 2 + REQUEST_TIME), seconds
    assert is_soon(longest, 1.0), longest
    return "the last of 150 that drip was cut after %.1f s of %d, others " \
        "waited %.0f ms at most" % (seconds, REQUEST_TIME, 1e3 * longest)


def attack_by_half_closing(daemon):
    """What is complete is answered; what is not is closed."""
    def check(text, expected):
        with daemon.connect() as sock:
            sock.sendall(text)
            sock.shutdown(socket.SHUT_WR)
            answer = drain(sock, 8)
        assert statuses(answer) == expected, (text[:200], answer[:200])

    together([lambda case=case: check(*case) for case in (
            (SMUGGLED, [200]),
            (SMUGGLED * 3, [200] * 3),
            (GET + HOST, []),
            (GET, []),
            (b"", []),
            (EVAL + b"Content-Length: 2\r\n\r\n{", []),
            (EVAL + b"Content-Length: 2\r\n\r\n{}", [422]),
            (EVAL + b"Content-Length: 50002\r\n\r\n{%50000s}" % b"", [422]),
            (CHUNKED + b"2\r\n{}\r\n", []),
            (CHUNKED + b"2\r\n{}\r\n0\r\n\r\n", [422]))])
    # Changes are made, also those that a thread of its own reads.
    for i, size in enumerate((1000, 50000) * 3):
        path, text = b"/v1/scenes/half%d" % i, json.dumps(SCENE).encode()
        check(b"PUT %s HTTP/1.1\r\n" % path + HOST + JSON +
              b"Content-Length: %d\r\n\r\n" % size + text.ljust(size), [201])
        status, _ = daemon.ask(b"DELETE %s HTTP/1.1\r\n" % path + HOST +
                               b"Connection: close\r\n\r\n")
        assert status == 204, status

def attack_by_idling(daemon):
    """Connections that say no more lock nobody out. All have said something:
    what they take at most is taken in the first round, not bit by bit."""
    socks = [daemon.connect() for _ in range(IDLE)]
    for sock in socks:
        sock.sendall(SMUGGLED)
    for sock in socks:
        assert statuses(sock.recv(4096)) == [200]
    slowest = max(alive(daemon) for _ in range(20))
    assert daemon.post("/v1/eval", {"scene": SCENE,
                                    "points": [0, 0, 0]})[0] == 200
    for sock in socks:
        sock.close()
    # Those that come next are of the same address.
    end = time.monotonic() + 90
    while daemon.count("fd") > IDLE / 2 and time.monotonic() < end:
        time.sleep(0.02)
    assert is_soon(slowest, 2.5 if IS_SANITIZED else 1.0), slowest
    return "beside %d idle connections the slowest of 20 GETs took %.1f ms" % (
        IDLE, 1e3 * slowest)


def attack_by_resetting(daemon):
    for i in range(300):
        sock = daemon.connect()
        sock.sendall((b"", GET, SMUGGLED, CHUNKED)[i % 4])
        reset(sock)
    alive(daemon)


def attack_by_hanging_up(daemon):
    """In the middle of everything: by an end, by a reset."""
    points = [0.001 * (i % 1000) for i in range(3 * 30000)]
    works = [
        post("/v1/eval", {"scene": SCENE, "points": points,
                          "outputs": ["value", "gradient", "hessian"]}),
        post("/v1/scenes/hostile/mesh", {"resolution": 128}),
        post("/v1/scenes/hostile/mesh?format=obj", {"resolution": 200}),
        post("/v1/scenes/hostile/render", {"width": 512, "height": 512}),
        post("/v1/scenes/hostile/slice", {"width": 512, "height": 512}),
        post("/v1/scenes/hostile/raycast", {"rays": [
            [0.001 * i, -5, 0, 0, 1, 0] for i in range(3000)]}),
        EVAL + b"Content-Length: 900000\r\n\r\n" + b" " * 100000,
        b"GET /v1/scenes/hostile/events HTTP/1.1\r\n" + HOST + END,
    ]
    for text in works:
        for delay, end in ((0, reset), (0, socket.socket.close),
                           (0.03, reset), (0.03, socket.socket.close)):
            sock = daemon.connect()
            # So that the daemon has to wait with an answer.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            with contextlib.suppress(OSError):
                sock.sendall(text)
            time.sleep(delay)
            end(sock)
    alive(daemon)


def send_garbage(daemon, seed):
    rng = random.Random(seed)
    text = bytearray(rng.choice([text for _, text, _ in REFUSED + HANDLED
                                 if len(text) < 1000]))
    if seed % 3 == 0:
        text = bytearray(rng.randbytes(rng.randrange(1, 2000)))
    for _ in range(rng.randrange(4)):
        text[rng.randrange(len(text))] = rng.randrange(256)
    with daemon.connect() as sock:
        with contextlib.suppress(OSError):
            sock.sendall(text)
            sock.shutdown(socket.SHUT_WR)
        answer = drain(sock, 20)
    assert all(status < 500 or status in (501, 505)
               for status in statuses(answer)), (seed, answer[:300])


def attack_with_garbage(daemon):
    """Random bytes, and requests with some of their bytes changed."""
    first = random.randrange(1 << 30)
    seeds = list(range(first, first + 200))

    def work():
        while seeds:
            with contextlib.suppress(IndexError):
                send_garbage(daemon, seeds.pop())

    together([work] * 20)
    alive(daemon)


ATTACKS = (attack_with_refused, attack_with_handled, attack_by_dripping,
           attack_by_half_closing, attack_by_idling, attack_by_resetting,
           attack_by_hanging_up, attack_with_garbage)


# --- afterwards --------------------------------------------------------------


class Before:
    """How the daemon answers, and what it takes, after the first round."""

    def __init__(self, daemon):
        self.answers = self.ask(daemon)
        self.fds, self.threads = daemon.settle()
        self.resident = self.middle = daemon.resident()

    @staticmethod
    def ask(daemon):
        return [daemon.post("/v1/eval", {
            "scene": SCENE, "points": [0.1 * i for i in range(300)],
            "outputs": ["value", "gradient"]}),
            daemon.get("/v1/scenes/hostile"), daemon.get("/nowhere")[0]]


def check_after(daemon, before):
    assert before.ask(daemon) == before.answers, "it answers otherwise"
    fds, threads = daemon.settle()
    begin = time.monotonic()
    while fds > before.fds and time.monotonic() - begin < NOTICE_SECONDS:
        time.sleep(1)
        fds = daemon.count("fd")
    resident = daemon.resident()
    print("measured: %d rounds: descriptors %d -> %d, threads %d -> %d, "
          "resident %d -> %d KiB" % (ROUNDS, before.fds, fds, before.threads,
                                     threads, before.resident, resident))
    assert fds <= before.fds, "descriptors are lost"
    assert threads == before.threads, "threads are lost"
    assert IS_SANITIZED or resident < before.resident + GROWTH_MOST, \
        "memory is lost"
    assert IS_SANITIZED or ROUNDS < MANY_ROUNDS or \
        resident < before.middle + LATE_GROWTH_MOST, \
        "memory is lost: %d after half the rounds" % before.middle


# --- limits, of daemons of their own -----------------------------------------


def test_idle_connections_make_place():
    """Of 64 that there may be, those that say nothing leave for others."""
    daemon = Daemon("--max-connections", "64")
    socks = [daemon.connect() for _ in range(300)]
    slowest = max(alive(daemon) for _ in range(20))
    for sock in socks:
        sock.close()
    daemon.stop()
    assert is_soon(slowest, 1.5), slowest
    print("measured: with 300 idle connections where 64 may be, the slowest "
          "of 20 GETs took %.1f ms" % (1e3 * slowest))


def test_connections_of_an_address_are_counted():
    daemon = Daemon("--max-connections-per-address", "20")
    time.sleep(0.5)
    socks = [daemon.connect() for _ in range(30)]
    time.sleep(0.5)
    served = 0
    for sock in socks:
        with contextlib.suppress(OSError):
            sock.sendall(SMUGGLED)
            served += drain_some(sock).startswith(b"HTTP/1.1 200")
        sock.close()
    # Those that hung up make room as soon as it is noticed.
    begin = time.monotonic()
    while not is_alive(daemon):
        assert time.monotonic() - begin < 45
        time.sleep(0.1)
    daemon.stop()
    assert served == 20, served


def is_alive(daemon):
    with contextlib.suppress(OSError):
        return daemon.get("/healthz")[0] == 200
    return False


def drain_some(sock):
    sock.settimeout(60)
    return sock.recv(4096)


def test_open_files_are_as_many_as_connections_need():
    """Where the limit is low it is raised, as far as it can be."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
    try:
        daemon = Daemon("--max-connections", "2000",
                        "--max-connections-per-address", "2000")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    with open("/proc/%d/limits" % daemon.process.pid) as f:
        raised = int(re.search(r"Max open files\s+(\d+)", f.read()).group(1))
    daemon.stop()
    assert raised >= min(2000, hard), raised


# --- cases -------------------------------------------------------------------


def run_case(name, case):
    print("[ RUN      ] " + name, flush=True)
    begin = time.monotonic()
    try:
        figure = case()
    except Exception:
        print(traceback.format_exc())
        print("[  FAILED  ] " + name, flush=True)
        return False
    if figure:
        print("measured: " + figure)
    if os.environ.get("HOSTILE_TIMES"):
        print("  %.1f s" % (time.monotonic() - begin))
    print("[       OK ] " + name, flush=True)
    return True


def main():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 4096), hard))
    daemon = Daemon("--request-time", str(REQUEST_TIME), "--max-body",
                    str(MAX_BODY), is_ready=True)
    text = json.dumps(SCENE).encode()
    daemon.ask(b"PUT /v1/scenes/hostile HTTP/1.1\r\n" + HOST + JSON +
               b"Connection: close\r\nContent-Length: %d\r\n\r\n" % len(text) +
               text)
    fine = True
    for attack in ATTACKS:
        fine &= run_case(attack.__name__.replace("attack", "test_attack"),
                         lambda attack=attack: attack(daemon))
    attack_by_idling(daemon)
    before = Before(daemon)
    for i in range(1, ROUNDS):
        if i == ROUNDS // 2:
            before.middle = daemon.resident()
        for attack in ATTACKS:
            # What waits is as in the first round: a soak's rounds do, too.
            if attack is not attack_by_dripping or i % 5 == 0:
                fine &= run_case("%s_%d" % (attack.__name__.replace(
                    "attack", "test_attack"), i + 1),
                    lambda attack=attack: attack(daemon))
    fine &= run_case("test_the_daemon_is_as_before",
                     lambda: check_after(daemon, before))
    fine &= run_case("test_the_daemon_ends_well", daemon.stop)
    for case in (test_idle_connections_make_place,
                 test_connections_of_an_address_are_counted,
                 test_open_files_are_as_many_as_connections_need):
        fine &= run_case(case.__name__, case)
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
