#!/usr/bin/python3
"""A storm of edits, evaluations and listeners on a few scenes.

Editors PUT, PATCH and DELETE, evaluators ask for values, meshes, rays and the
past, listeners come, go and read on, somebody reads /metrics, and SIGHUP has the
tokens read anew. Then: every answer was one that the protocol has, every value
was finite and of the revision that its ETag names, what a listener was told rose,
and the daemon ends as it should. With `make test SAN=thread` the daemon is built
with the thread sanitizer, whose report fails the test.

$STORM_SECONDS: how long (6). Prints its cases as cmocka does.
"""
import collections
import hashlib
import http.client
import json
import math
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import urllib.parse

SECONDS = float(os.environ.get("STORM_SECONDS", "6"))
SCENES = ["s%d" % i for i in range(4)]
SECRET = "storm"
# What may be answered besides success: scenes come and go, and are changed
# between a look and a change; the device and the tasks have their bounds.
ALLOWED = {404, 409, 412, 422, 429, 503}


class Storm:
    def __init__(self, daemon, host, port):
        self.daemon, self.host, self.port = daemon, host, port
        self.over = threading.Event()
        self.statuses = collections.Counter()
        self.kinds = collections.Counter()
        self.lock = threading.Lock()
        self.values = {}     # etag -> expected value at the origin
        self.errors = []

    def connect(self):
        return http.client.HTTPConnection(self.host, self.port, timeout=60)

    def ask(self, connection, kind, method, path, body=None, **headers):
        head = {"Authorization": "Bearer " + SECRET}
        head.update({k.replace("_", "-"): v for k, v in headers.items()})
        connection.request(method, path, body, head)
        answer = connection.getresponse()
        data = answer.read()
        with self.lock:
            self.statuses[answer.status] += 1
            self.kinds[kind] += 1
        if answer.status >= 400:
            assert answer.status in ALLOWED, (path, answer.status, data)
            problem = json.loads(data)
            assert problem["status"] == answer.status
        return answer, data

    def run(self, step, rng):
        connection = self.connect()
        try:
            while not self.over.is_set():
                step(connection, rng)
        except Exception:
            self.errors.append(traceback.format_exc())
            self.over.set()
        finally:
            connection.close()

    # --- editors ---

    def document(self, rng):
        """A sphere whose value at the origin tells which one it is."""
        weight = rng.randrange(1, 1000) / 1024
        text = json.dumps({"format": "blobfield/1", "root": {
            "type": "point", "center": [0, 0, 0], "radius": 1,
            "weight": weight}}).encode()
        tag = '"%s"' % hashlib.sha256(text).hexdigest()[:32]
        with self.lock:
            self.values[tag] = weight
        return text

    def edit(self, connection, rng):
        path = "/v1/scenes/" + rng.choice(SCENES)
        kind = rng.random()
        if kind < 0.45:
            self.ask(connection, "put", "PUT", path, self.document(rng),
                     Content_Type="application/json")
        elif kind < 0.7:
            self.ask(connection, "merge", "PATCH", path, json.dumps({
                "name": "n%d" % rng.randrange(50)}),
                     Content_Type="application/merge-patch+json")
        elif kind < 0.95:
            self.ask(connection, "patch", "PATCH", path, json.dumps([
                {"op": "test", "path": "/root/type", "value": "point"},
                {"op": "replace", "path": "/root/radius",
                 "value": rng.choice((1, 2, 3))}]),
                     Content_Type="application/json-patch+json")
        else:
            self.ask(connection, "delete", "DELETE", path)

    # --- readers ---

    def evaluate(self, connection, rng):
        path = "/v1/scenes/" + rng.choice(SCENES)
        kind = rng.random()
        if kind < 0.6:
            count = rng.choice((1, 1, 300, 5000))
            answer, data = self.ask(
                connection, "eval", "POST", path + "/eval",
                json.dumps({"points": [[0, 0, 0]] * count}),
                Content_Type="application/json")
            if answer.status == 200:
                self.check_values(answer, json.loads(data), count)
        elif kind < 0.7:
            self.ask(connection, "mesh", "POST", path + "/mesh",
                     json.dumps({"resolution": 8}),
                     Content_Type="application/json")
        elif kind < 0.8:
            self.ask(connection, "raycast", "POST", path + "/raycast",
                     json.dumps({"rays": [[0, -5, 0, 0, 1, 0]]}),
                     Content_Type="application/json")
        elif kind < 0.9:
            _, data = self.ask(connection, "revisions", "GET",
                               path + "/revisions")
            past = json.loads(data).get("revisions")
            if past:
                self.ask(connection, "revision", "GET", path + "?revision=" +
                         rng.choice(past)["revision"])
        else:
            self.ask(connection, "list", "GET", "/v1/scenes")

    def check_values(self, answer, body, count):
        assert body["count"] == count
        assert all(math.isfinite(v) for v in body["value"])
        # Patches change what does not change the value there.
        known = self.values.get(answer.headers["ETag"])
        if known is not None:
            assert all(abs(v - known) < 1e-4 for v in body["value"])

    def operate(self, connection, _rng):
        self.ask(connection, "metrics", "GET", "/metrics")
        self.ask(connection, "info", "GET", "/v1/info")
        self.ask(connection, "ready", "GET", "/readyz")
        self.daemon.send_signal(signal.SIGHUP)
        time.sleep(0.1)

    # --- listeners ---

    def listen(self, _connection, rng):
        """One stream, for a while; often given up without a word."""
        connection = self.connect()
        last = 0
        end = time.monotonic() + rng.uniform(0.05, 1.5)
        try:
            connection.request("GET", "/v1/scenes/%s/events"
                               % rng.choice(SCENES), None,
                               {"Authorization": "Bearer " + SECRET})
            answer = connection.getresponse()
            with self.lock:
                self.statuses[answer.status] += 1
            if answer.status != 200:
                assert answer.status in ALLOWED, answer.status
                time.sleep(0.02)
                return
            connection.sock.settimeout(0.3)
            while time.monotonic() < end and not self.over.is_set():
                line = answer.readline()
                if not line:
                    break
                if line.startswith(b"id:"):
                    number = int(line[3:])
                    assert number > last, (last, number)
                    last = number
                    with self.lock:
                        self.kinds["event"] += 1
        except TimeoutError:
            pass
        finally:
            connection.close()


def start(folder):
    tokens = os.path.join(folder, "tokens.json")
    with open(tokens, "w", encoding="ascii") as file:
        json.dump({"tokens": [{
            "name": "storm", "role": "admin",
            "sha256": hashlib.sha256(SECRET.encode()).hexdigest()}]}, file)
    os.chmod(tokens, 0o600)
    program = os.environ.get("BLOBFIELDD", "build/blobfieldd")
    daemon = subprocess.Popen(
        [program, "--listen", "127.0.0.1:0", "--quiet", "--no-measure",
         "--no-cache", "--data", os.path.join(folder, "data"), "--tokens",
         tokens], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True)
    line = daemon.stdout.readline()
    at = urllib.parse.urlsplit(re.search(r"http://\S+", line).group(0))
    for _ in range(3000):
        connection = http.client.HTTPConnection(at.hostname, at.port)
        connection.request("GET", "/readyz")
        status = connection.getresponse().status
        connection.close()
        if status == 200:
            return daemon, at.hostname, at.port
        time.sleep(0.1)
    raise AssertionError("the daemon does not become ready")


def test_storm_of_edits_evaluations_and_listeners():
    folder = tempfile.mkdtemp(prefix="blobfield_storm_")
    seed = int(os.environ.get("STORM_SEED",
                              random.SystemRandom().randrange(1 << 31)))
    daemon, host, port = start(folder)
    said = []
    reader = threading.Thread(target=lambda: said.append(
        daemon.stderr.read()))
    reader.start()
    storm = Storm(daemon, host, port)
    steps = [storm.edit] * 4 + [storm.evaluate] * 4 + [storm.listen] * 6 + \
        [storm.operate]
    threads = [threading.Thread(target=storm.run, args=(
        step, random.Random(seed + i))) for i, step in enumerate(steps)]
    try:
        for t in threads:
            t.start()
        storm.over.wait(SECONDS)
        storm.over.set()
        for t in threads:
            t.join()
        daemon.terminate()
        status = daemon.wait(60)
    finally:
        daemon.kill()
        reader.join()
        daemon.stdout.close()
        shutil.rmtree(folder, ignore_errors=True)
    assert not storm.errors, "seed %d: %s" % (seed, storm.errors[0])
    assert "Sanitizer" not in said[0], said[0]
    assert status == 0, (status, said[0])
    for kind in ("put", "patch", "merge", "delete", "eval", "mesh", "raycast",
                 "revision", "metrics", "event"):
        assert storm.kinds[kind] > 0, kind
    print("measured: in %.0f s %s; statuses %s" % (
        SECONDS, ", ".join("%d %s" % (n, k) for k, n in
                           storm.kinds.most_common()),
        ", ".join("%d: %d" % s for s in sorted(storm.statuses.items()))))


def main():
    name = "test_storm_of_edits_evaluations_and_listeners"
    print("[ RUN      ] %s" % name, flush=True)
    try:
        test_storm_of_edits_evaluations_and_listeners()
    except Exception:
        traceback.print_exc(file=sys.stdout)
        print("[  FAILED  ] %s" % name)
        return 1
    print("[       OK ] %s" % name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
