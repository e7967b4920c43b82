#!/usr/bin/python3
"""The daemon killed (SIGKILL) at random moments: what it has acknowledged stays.

Rounds over one folder (--data): the daemon starts, everything it holds is
compared with what it acknowledged before, writers change scenes, it is killed
in the middle of that.

- Owners: each writer has scenes of its own and one request at a time. A scene
  is then exactly as last acknowledged, or as the one request has it that had no
  answer yet; its text, its tag and its number of nodes belong together.
- Together: all writers add children to one scene by JSON Patch, without
  If-Match: each acknowledged child is there exactly once, each other at most
  once.
- Sequence numbers rise over all rounds; the history's newest revision is the
  present one, and acknowledged revisions of this round's history can be read.
- Volumes: an acknowledged one is there, and a scene of it has its value.
- The file stands SQLite's own integrity_check.

$CRASH_ROUNDS: how many (20). Prints its cases as cmocka does.
"""
import hashlib
import http.client
import json
import os
import random
import re
import shutil
import signal
import sqlite3
import struct
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import urllib.parse

ROUNDS = int(os.environ.get("CRASH_ROUNDS", "20"))
WRITERS = 6
SCENES = 3  # of each writer
HISTORY = 8
# Kills come so many seconds after the writers' begin, at random.
LIFE = (0.02, 0.6)


class Gone(Exception):
    """The daemon has gone; what was asked may or may not have been done."""


class Daemon:
    def __init__(self, data, cache):
        program = os.environ.get("BLOBFIELDD", "build/blobfieldd")
        self.process = subprocess.Popen(
            [program, "--listen", "127.0.0.1:0", "--quiet", "--no-measure",
             "--data", data, "--cache", cache, "--history", str(HISTORY)],
            stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        if "listening on" not in line:
            raise AssertionError("the daemon does not start: status %s"
                                 % self.process.wait())
        at = urllib.parse.urlsplit(re.search(r"http://\S+", line).group(0))
        self.host, self.port = at.hostname, at.port

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        status = self.process.wait()
        self.process.stdout.close()
        return status


class Client:
    """One connection, kept alive."""

    def __init__(self, daemon):
        self.connection = http.client.HTTPConnection(daemon.host, daemon.port,
                                                     timeout=30)

    def ask(self, method, path, body=None, headers=None):
        """(status, headers, bytes); Gone."""
        try:
            self.connection.request(method, path, body, headers or {})
            answer = self.connection.getresponse()
            return answer.status, answer.headers, answer.read()
        except (OSError, http.client.HTTPException) as err:
            self.connection.close()
            raise Gone(str(err)) from err

    def put(self, path, text, **headers):
        return self.ask("PUT", path, text,
                        {"Content-Type": "application/json", **headers})


def document(rng, name):
    """A document of random size, as bytes."""
    children = [{"type": "point", "center": [rng.random() for _ in range(3)],
                 "radius": 0.5} for _ in range(rng.choice((1, 2, 5, 40)))]
    return json.dumps({"format": "blobfield/1", "name": name, "root": {
        "type": "union", "children": children}}).encode()


def tag_of(text):
    return '"%s"' % hashlib.sha256(text).hexdigest()[:32]


def volume(rng):
    """(npy, value at the middle sample) of a grid of 5 x 5 x 5."""
    value = rng.randrange(1, 1000) / 1024
    head = b"{'descr': '<f4', 'fortran_order': False, 'shape': (5, 5, 5), }"
    head += b" " * ((64 - (10 + len(head) + 1) % 64) % 64) + b"\n"
    return (b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head +
            struct.pack("<125f", *[value] * 125), value)


class Writer(threading.Thread):
    """Changes its own scenes, and the one of all, until the daemon has gone."""

    def __init__(self, number, seed, model, shared):
        super().__init__()
        self.number = number
        self.rng = random.Random(seed)
        self.model = model      # id -> text acknowledged, or None
        self.pending = {}       # id -> text, or None: asked, not answered
        self.shared = shared    # names acknowledged
        self.unsure = set()     # names asked, not answered
        self.acknowledged = 0
        self.sequences = []
        self.error = None
        self.daemon_ = None

    def begin(self, daemon):
        self.daemon_ = daemon
        self.start()

    def run(self):
        client = Client(self.daemon_)
        try:
            while True:
                self.step(client)
        except Gone:
            pass
        except Exception as err:  # told by the main thread
            self.error = err

    def step(self, client):
        kind = self.rng.random()
        if kind < 0.25:
            self.patch_shared(client)
        elif kind < 0.85:
            self.put_own(client)
        else:
            self.delete_own(client)

    def own(self):
        return "w%d-%d" % (self.number, self.rng.randrange(SCENES))

    def note(self, body):
        self.acknowledged += 1
        if body:
            self.sequences.append(int(json.loads(body)["sequence"]))

    def put_own(self, client):
        name = self.own()
        text = document(self.rng, name)
        self.pending[name] = text
        old = self.model.get(name)
        headers = {"If-Match": tag_of(old)} if old else {"If-None-Match": "*"}
        status, head, body = client.put("/v1/scenes/" + name, text, **headers)
        assert status in (200, 201), (status, body)
        assert head["ETag"] == tag_of(text), "wrong ETag"
        del self.pending[name]
        self.model[name] = text
        self.note(body)

    def delete_own(self, client):
        name = self.own()
        if not self.model.get(name):
            return
        self.pending[name] = None
        status, _, body = client.ask("DELETE", "/v1/scenes/" + name, None,
                                     {"If-Match": tag_of(self.model[name])})
        assert status == 204, (status, body)
        del self.pending[name]
        self.model[name] = None
        self.note(b"")

    def patch_shared(self, client):
        name = "c%d-%08x" % (self.number, self.rng.getrandbits(32))
        patch = [{"op": "add", "path": "/root/children/-", "value": {
            "type": "point", "id": name, "center": [0, 0, 0], "radius": 1}}]
        self.unsure.add(name)
        status, _, body = client.ask(
            "PATCH", "/v1/scenes/all", json.dumps(patch),
            {"Content-Type": "application/json-patch+json"})
        assert status == 200, (status, body)
        self.unsure.discard(name)
        self.shared.add(name)
        self.note(body)


class Checker:
    """Rounds over one folder."""

    def __init__(self, folder, seed):
        self.data = os.path.join(folder, "data")
        self.cache = os.path.join(folder, "cache")
        self.rng = random.Random(seed)
        self.models = [{} for _ in range(WRITERS)]
        self.pending = [{} for _ in range(WRITERS)]
        self.shared, self.unsure = set(), set()
        self.volumes = {}     # id -> value
        self.sequence = 0
        self.kills = self.acknowledged = self.in_doubt = self.kept = 0
        self.starts = []

    def start(self):
        begin = time.monotonic()
        daemon = Daemon(self.data, self.cache)
        client = Client(daemon)
        while client.ask("GET", "/v1/scenes?limit=1")[0] != 200:
            time.sleep(0.01)
        self.starts.append(time.monotonic() - begin)
        return daemon, client

    # --- what must be true after a start ---

    def check_own(self, client):
        for model, pending in zip(self.models, self.pending):
            for name in set(model) | set(pending):
                status, head, body = client.ask("GET", "/v1/scenes/" + name)
                now = body if status == 200 else None
                allowed = [model.get(name)]
                if name in pending:
                    self.in_doubt += 1
                    self.kept += now == pending[name]
                    allowed.append(pending[name])
                assert status in (200, 404), (name, status, body)
                assert now in allowed, "%s is lost: %r" % (name, now)
                assert now is None or head["ETag"] == tag_of(now), name
                model[name] = now
                if now is not None:
                    self.check_history(client, name, now)
            pending.clear()

    def check_history(self, client, name, now):
        status, _, body = client.ask(
            "GET", "/v1/scenes/%s/revisions" % name)
        assert status == 200, (name, status, body)
        list_ = json.loads(body)["revisions"]
        assert 1 <= len(list_) <= HISTORY, (name, len(list_))
        assert '"%s"' % list_[0]["revision"] == tag_of(now), name
        numbers = [int(r["sequence"]) for r in list_]
        assert numbers == sorted(numbers, reverse=True), numbers
        oldest = list_[-1]["revision"]
        status, _, text = client.ask(
            "GET", "/v1/scenes/%s?revision=%s" % (name, oldest))
        assert status == 200 and tag_of(text) == '"%s"' % oldest, name

    def check_shared(self, client):
        status, _, body = client.ask("GET", "/v1/scenes/all")
        assert status == 200, (status, body)
        there = [c["id"] for c in json.loads(body)["root"]["children"]
                 if "id" in c]
        assert len(there) == len(set(there))
        missing = self.shared - set(there)
        assert not missing, "lost: %s" % sorted(missing)
        assert set(there) <= self.shared | self.unsure
        self.shared, self.unsure = set(there), set()

    def check_volumes(self, client):
        for name, value in self.volumes.items():
            body = {"scene": {"format": "blobfield/1", "root": {
                "type": "volume", "volume": name}}, "points": [[2, 2, 2]]}
            for _ in range(600):
                status, _, answer = client.ask(
                    "POST", "/v1/eval", json.dumps(body),
                    {"Content-Type": "application/json"})
                if status != 503:
                    break
                time.sleep(0.05)
            assert status == 200, (status, answer)
            got = json.loads(answer)["value"][0]
            assert abs(got - value) < 1e-3, (got, value)

    def check_file(self):
        """On a copy, with the daemon dead."""
        copy = self.data + ".copy"
        shutil.copytree(self.data, copy)
        try:
            files = [f for f in os.listdir(copy) if f.endswith(".sqlite")]
            assert files, os.listdir(copy)
            database = sqlite3.connect(os.path.join(copy, files[0]))
            rows = database.execute("PRAGMA integrity_check").fetchall()
            database.close()
            assert rows == [("ok",)], rows
        finally:
            shutil.rmtree(copy)

    # --- one round ---

    def renew(self, client):
        """The scene of all, small again; and a volume."""
        text = json.dumps({"format": "blobfield/1", "root": {
            "type": "union", "children": [{"type": "point",
                                           "center": [0, 0, 0],
                                           "radius": 1}]}}).encode()
        status, _, body = client.put("/v1/scenes/all", text)
        assert status in (200, 201), (status, body)
        self.shared, self.unsure = set(), set()
        if len(self.volumes) < 4:
            npy, value = volume(self.rng)
            status, _, body = client.ask(
                "POST", "/v1/volumes?min=0,0,0&max=4,4,4&kind=field", npy,
                {"Content-Type": "application/x-npy"})
            assert status in (200, 201), (status, body)
            self.volumes[json.loads(body)["id"]] = value

    def round(self):
        daemon, client = self.start()
        try:
            self.check_own(client)
            if self.kills:
                self.check_shared(client)
            self.check_volumes(client)
            if not self.kills or len(self.shared) > 200:
                self.renew(client)
            self.write_and_kill(daemon)
        finally:
            if daemon.process.poll() is None:
                daemon.kill()

    def write_and_kill(self, daemon):
        writers = [Writer(i, self.rng.getrandbits(32), self.models[i],
                          set()) for i in range(WRITERS)]
        for w in writers:
            w.begin(daemon)
        time.sleep(self.rng.uniform(*LIFE))
        daemon.kill()
        self.kills += 1
        for w in writers:
            w.join()
            if w.error:
                raise w.error
            self.pending[w.number] = w.pending
            self.shared |= w.shared
            self.unsure |= w.unsure
            self.acknowledged += w.acknowledged
            for number in w.sequences:
                assert number > self.sequence, "sequence went back"
        self.sequence = max([self.sequence] +
                            [n for w in writers for n in w.sequences])


def test_acknowledged_revisions_survive_kills():
    folder = tempfile.mkdtemp(prefix="blobfield_crash_")
    seed = int(os.environ.get("CRASH_SEED", random.SystemRandom().
                              randrange(1 << 31)))
    checker = Checker(folder, seed)
    try:
        for i in range(ROUNDS):
            checker.round()
            if i % 10 == 9:
                checker.check_file()
        daemon, client = checker.start()
        checker.check_own(client)
        checker.check_shared(client)
        checker.check_volumes(client)
        assert daemon.stop() == 0, "a clean stop"
        checker.check_file()
    except BaseException:
        print("seed %d, round %d" % (seed, checker.kills))
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    starts = sorted(checker.starts)
    print("measured: %d kills, %d acknowledged changes, none lost; of %d in "
          "flight %d were kept; from start to answers: median %.0f ms, most "
          "%.0f ms" % (checker.kills, checker.acknowledged, checker.in_doubt,
                       checker.kept, 1e3 * starts[len(starts) // 2],
                       1e3 * starts[-1]))


def main():
    name = "test_acknowledged_revisions_survive_kills"
    print("[ RUN      ] %s" % name, flush=True)
    try:
        test_acknowledged_revisions_survive_kills()
    except Exception:
        traceback.print_exc(file=sys.stdout)
        print("[  FAILED  ] %s" % name)
        return 1
    print("[       OK ] %s" % name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
