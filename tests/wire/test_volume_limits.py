#!/usr/bin/python3
"""Volumes and whose they are: a token's volume_bytes, over restarts, too.

Starts daemons ($BLOBFIELDD, else build/blobfieldd) that keep what they have in a
folder. Prints its cases as cmocka does.
"""
import http.client
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
import traceback

SIDE = 16
PATH = "/v1/volumes?min=0,0,0&max=1,1,1&kind=field"
PATIENCE = 60.0


class Place:
    """A folder, and a daemon that keeps what it has there."""

    def __init__(self):
        self.folder = tempfile.mkdtemp()
        self.file = os.path.join(self.folder, "tokens.json")
        self.secrets, self.entries = {}, []
        self.process = None

    def add_token(self, name, limits):
        out = subprocess.run([program(), "--make-token", name + ":write"],
                             capture_output=True, text=True, check=True)
        secret, entry = out.stdout.split("\n")[:2]
        self.secrets[name] = secret
        self.entries.append(dict(json.loads(entry), limits=limits))

    def write_tokens(self):
        with open(self.file, "w") as f:
            os.fchmod(f.fileno(), 0o600)
            json.dump({"tokens": self.entries}, f)

    def start(self):
        self.process = subprocess.Popen(
            [program(), "--no-cache", "--no-measure", "--quiet", "--listen",
             "127.0.0.1:0", "--data", os.path.join(self.folder, "data"),
             "--tokens", self.file], stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        self.port = int(re.search(r":(\d+)$", line.strip()).group(1))
        await_true(lambda: self.ask("a", "GET", "/healthz")[0] == 200)

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(PATIENCE) == 0
        self.process.stdout.close()

    def end(self):
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        shutil.rmtree(self.folder)

    def ask(self, name, method, path, body=None, kind="application/json"):
        connection = http.client.HTTPConnection("127.0.0.1", self.port,
                                                timeout=PATIENCE)
        connection.request(method, path, body, {
            "Content-Type": kind,
            "Authorization": "Bearer " + self.secrets[name]})
        reply = connection.getresponse()
        data = reply.read()
        connection.close()
        return reply.status, json.loads(data) if data else None

    def upload(self, name, first):
        """A volume told from others by its first sample."""
        return self.ask(name, "POST", PATH, volume(first),
                        "application/x-npy")


def program():
    return os.environ.get("BLOBFIELDD", "build/blobfieldd")


def await_true(question):
    end = time.monotonic() + PATIENCE
    while not question():
        assert time.monotonic() < end, "it does not come"
        time.sleep(0.05)


def volume(first):
    head = ("{'descr': '<f4', 'fortran_order': False, 'shape': (%d, %d, %d)}"
            % (SIDE, SIDE, SIDE)).encode()
    head += b" " * (-(len(head) + 11) % 64) + b"\n"
    rest = [0.5] * (SIDE ** 3 - 1)
    return (b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head +
            struct.pack("<%df" % SIDE ** 3, first, *rest))


def told(place, name):
    """What GET /v1/tokens says of it."""
    return next(t for t in place.ask("root", "GET", "/v1/tokens")[1]["tokens"]
                if t["name"] == name)


def used(place, name):
    return told(place, name)["used"]


def check(status, expected, said):
    assert status == expected, (status, said)


def test_volume_limits_are_kept(place):
    """Two of its volumes fit. What somebody else has paid for costs nothing."""
    status, one = place.upload("a", 1.0)
    check(status, 201, one)
    assert one["owner"] == "a"
    place.size = one["bytes"]
    place.entries[0]["limits"] = {"volume_bytes": 2 * place.size}
    place.write_tokens()
    place.process.send_signal(signal.SIGHUP)
    await_true(lambda: "volume_bytes" in told(place, "a")["limits"])
    check(place.upload("a", 2.0)[0], 201, "")
    status, said = place.upload("a", 3.0)
    check(status, 507, said)
    assert said["type"] == "/problems/store-full", said
    assert "volume_bytes" in said["detail"] and "'a'" in said["detail"], said
    check(place.upload("a", 2.0)[0], 200, "one's own once more")
    status, said = place.upload("b", 2.0)
    check(status, 200, said)
    assert said["owner"] == "a", said
    check(place.upload("none", 2.0)[0], 200, "a's, for none")
    check(place.upload("none", 9.0)[0], 507, "one's own, for none")
    # b has no limit.
    for i in range(3):
        check(place.upload("b", 10.0 + i)[0], 201, "")
    assert [used(place, name)["volume_bytes"] // place.size
            for name in ("a", "b", "none")] == [2, 3, 0]


def test_volume_limits_survive_a_restart(place):
    place.stop()
    place.start()
    status, said = place.upload("a", 3.0)
    check(status, 507, said)
    listed = place.ask("a", "GET", "/v1/volumes")[1]["volumes"]
    assert sorted(v["owner"] for v in listed) == ["a", "a", "b", "b", "b"]


def test_volume_limits_are_given_back(place):
    """At once, unless a scene uses the volume: then with that."""
    ids = [v["id"] for v in place.ask("a", "GET", "/v1/volumes")[1]["volumes"]
           if v["owner"] == "a"]
    scene = {"format": "blobfield/1",
             "root": {"type": "volume", "volume": ids[0]}}
    status, said = place.ask("b", "PUT", "/v1/scenes/s", json.dumps(scene))
    check(status, 201, said)
    check(place.ask("a", "DELETE", "/v1/volumes/" + ids[0])[0], 204, "")
    check(place.upload("a", 3.0)[0], 507, "a scene uses the first one")
    assert used(place, "a")["volume_bytes"] == 2 * place.size
    assert [used(place, name)["scenes"] for name in ("a", "b")] == [0, 1]
    place.stop()
    place.start()
    check(place.upload("a", 3.0)[0], 507, "still so after a restart")
    check(place.ask("b", "DELETE", "/v1/scenes/s")[0], 204, "")
    await_true(lambda: place.upload("a", 3.0)[0] in (200, 201))
    check(place.upload("a", 4.0)[0], 507, "two again")
    check(place.ask("b", "DELETE", "/v1/volumes/" + ids[1])[0], 204, "")
    check(place.upload("a", 4.0)[0], 201, "one of them is gone")


def test_volume_of_simultaneous_uploads_is_new_once(place):
    """Whoever pays for it: of those of the same one says 201."""
    for first in (20.0, 21.0, 22.0, 23.0):
        said = []
        threads = [threading.Thread(target=lambda: said.append(
            place.upload("b", first))) for _ in range(6)]
        for t in threads:
            t.start()
        for t in threads:
            t.join()
        assert sorted(s for s, _ in said) == [200] * 5 + [201], said
        assert {v["owner"] for _, v in said} == {"b"}, said


def run_case(case, place):
    name = case.__name__
    print("[ RUN      ] " + name, flush=True)
    try:
        case(place)
    except Exception:
        print(traceback.format_exc())
        print("[  FAILED  ] " + name, flush=True)
        return False
    print("[       OK ] " + name, flush=True)
    return True


def main():
    place = Place()
    try:
        place.add_token("a", {})
        place.add_token("b", {})
        place.add_token("none", {"volume_bytes": 0})
        place.add_token("root", {})
        place.entries[-1]["role"] = "admin"
        place.write_tokens()
        place.start()
        fine = True
        for name, case in list(globals().items()):
            if name.startswith("test_"):
                fine &= run_case(case, place)
        place.stop()
    finally:
        place.end()
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
