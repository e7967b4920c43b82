#!/usr/bin/python3
"""Old revisions whose readers are slow: how many texts are in memory for them, and
that nobody's changes are refused for that.

Starts a daemon ($BLOBFIELDD, else build/blobfieldd). Prints its cases as cmocka
does.
"""
import http.client
import json
import os
import re
import socket
import subprocess
import sys
import time
import traceback

PATIENCE = 60.0

# server/http_body.c: TEXTS_MAX
MOST = 256 << 20
LENGTH = 16000000


class Daemon:
    def __init__(self):
        self.process = subprocess.Popen(
            [os.environ.get("BLOBFIELDD", "build/blobfieldd"), "--no-cache",
             "--no-measure", "--quiet", "--listen", "127.0.0.1:0", "--data",
             ":memory:"], stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        self.port = int(re.search(r":(\d+)$", line.strip()).group(1))

    def ask(self, method, path, body=None):
        connection = http.client.HTTPConnection("127.0.0.1", self.port,
                                                timeout=PATIENCE)
        connection.request(method, path, body,
                           {"Content-Type": "application/json"})
        reply = connection.getresponse()
        data = reply.read()
        connection.close()
        return reply.status, data

    def begin(self, path):
        """A request whose answer is not read but for its beginning."""
        s = socket.socket()
        s.settimeout(PATIENCE)
        s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        s.connect(("127.0.0.1", self.port))
        s.sendall(b"GET %s HTTP/1.1\r\nHost: localhost\r\n\r\n"
                  % path.encode())
        return s

    def end(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


def document(radius, length=0):
    return json.dumps({"format": "blobfield/1", "root": {
        "type": "point", "center": [0, 0, 0], "radius": radius}}).ljust(length)


def status_of(s):
    return int(s.recv(12, socket.MSG_WAITALL).split()[1])


def test_slow_readers_of_old_texts_are_bounded(daemon):
    for radius in (1, 2):
        status, said = daemon.ask("PUT", "/v1/scenes/s",
                                  document(radius, LENGTH))
        assert status in (200, 201), said
    said = json.loads(daemon.ask("GET", "/v1/scenes/s/revisions")[1])
    path = "/v1/scenes/s?revision=" + said["revisions"][1]["revision"]
    fit = MOST // LENGTH
    readers = [daemon.begin(path) for _ in range(fit + 3)]
    statuses = sorted(status_of(s) for s in readers)
    assert statuses == [200] * fit + [503] * 3, statuses
    status, said = daemon.ask("GET", path)
    assert status == 503 and b"out-of-memory" in said, said[:300]
    # Nobody else is refused anything.
    for length in (0, 100000, LENGTH):
        status, said = daemon.ask("PUT", "/v1/scenes/%d" % length,
                                  document(1, length))
        assert status == 201, said
    assert daemon.ask("GET", "/v1/scenes/s")[0] == 200
    # And gone, they are not counted any more.
    for s in readers:
        s.close()
    end = time.monotonic() + PATIENCE
    while daemon.ask("GET", path)[0] != 200:
        assert time.monotonic() < end, "they are still counted"
        time.sleep(0.05)


def run_case(case, daemon):
    name = case.__name__
    print("[ RUN      ] " + name, flush=True)
    try:
        case(daemon)
    except Exception:
        print(traceback.format_exc())
        print("[  FAILED  ] " + name, flush=True)
        return False
    print("[       OK ] " + name, flush=True)
    return True


def main():
    daemon = Daemon()
    try:
        return 0 if run_case(test_slow_readers_of_old_texts_are_bounded,
                             daemon) else 1
    finally:
        daemon.end()


if __name__ == "__main__":
    sys.exit(main())
