#!/usr/bin/python3
"""The Python client against a real daemon, and a server that misbehaves.

BLOBFIELDD is the daemon, build/blobfieldd unless set. Prints its cases as
cmocka does. Names given as arguments choose among them.
"""
import contextlib
import datetime
import http.server
import io
import json
import math
import os
import pickle
import re
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import traceback

import numpy as np

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(
    os.path.abspath(__file__))))
PACKAGE = os.path.join(ROOT, "clients/python")
sys.dont_write_bytecode = True
sys.path.insert(0, PACKAGE)

import blobfield  # noqa: E402
from blobfield import (document, point, segment, sphere, torus,  # noqa: E402
                       union)

DAEMON = os.environ.get("BLOBFIELDD") or os.path.join(ROOT, "build",
                                                      "blobfieldd")
# The tables that tests/run.sh has built for all, or none.
CACHE = (["--cache", os.environ["BLOBFIELD_TEST_CACHE"],
          "--cache-read-only"] if "BLOBFIELD_TEST_CACHE" in os.environ
         else ["--no-cache"])
BALL = point([0, 0, 0], 1)
LETTER = document(union(
    segment([-1, 0, 0], [1, 0, 0], 0.25, color=[0.8, 0.2, 0.1], id="bar"),
    segment([0, 0, 0], [0, 0, 1], 0.25), operator="camel", id="joint"),
    name="T")


class Daemon:
    def __init__(self, *flags):
        self.flags = flags
        cache = [] if "--cache" in flags else CACHE
        self.process = subprocess.Popen(
            [DAEMON, "--listen", "127.0.0.1:0", "--no-measure", "--data",
             ":memory:", *cache, *flags],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.url = self.process.stdout.readline().split()[-1]

    def stop(self):
        self.process.terminate()
        status = self.process.wait(30)
        assert status == 0, f"the daemon ended with {status}"

    def kill(self):
        self.process.kill()
        self.process.wait(30)

    def again(self):
        """Another where this one was, which has ended."""
        return Daemon(*self.flags, "--listen", self.url.split("//")[1])


@contextlib.contextmanager
def server(answer):
    """A server of one's own: answer(handler) for every request; its URL."""
    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def handle_one(self):
            answer(self)

        do_GET = do_HEAD = do_POST = do_PUT = handle_one

        def log_message(self, *_):
            pass

        def say(self, status, body=b"{}", length=None, **headers):
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name.replace("_", "-"), value)
            self.send_header("Content-Length",
                             str(len(body) if length is None else length))
            self.end_headers()
            self.wfile.write(body)

    class Server(http.server.ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *_):
            pass

    s = Server(("127.0.0.1", 0), Handler)
    threading.Thread(target=s.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{s.server_address[1]}"
    finally:
        s.shutdown()
        s.server_close()


def near(value, expected, tolerance):
    worst = np.max(np.abs(np.asarray(value) - np.asarray(expected)))
    assert worst <= tolerance, f"{value} is not {expected} to {tolerance}"


@contextlib.contextmanager
def raises(kind, *words):
    """The error in a list; its message has the words."""
    got = []
    try:
        yield got
    except kind as e:
        got.append(e)
        for w in words:
            assert w in str(e), f"{w!r} is not in {e}"
    else:
        raise AssertionError(f"no {kind.__name__}")


def scene(doc=BALL, id="test"):
    return client.scene(id, doc)


# --- evaluating -------------------------------------------------------------

def test_evaluate_values():
    v = scene().evaluate([[1, 0, 0], [0, 0, 0.5]])
    near(v.value, [0.5, 0.85311806], 1e-7)  # as printed in proto/README.md
    near(v.gradient[0], [-0.7797631, 0, 0], 1e-7)
    assert list(v) == ["value", "gradient"]
    assert v["value"] is v.value or (v["value"] == v.value).all()
    assert v.revision == scene().revision and not v.draft


def test_evaluate_keeps_the_shape():
    s = scene()
    points = np.random.default_rng(1).normal(size=(4, 5, 6, 3))
    v = s.evaluate(points, ["value", "gradient", "hessian", "curvature"])
    assert v.value.shape == (4, 5, 6) and v.hessian.shape == (4, 5, 6, 3, 3)
    assert v.gradient.shape == points.shape
    assert v.curvature.shape == (4, 5, 6, 2)
    assert s.evaluate([0, 0, 0.5]).value.shape == ()
    assert s.evaluate(np.zeros((0, 3))).value.shape == (0,)
    flat = s.evaluate(points.reshape(-1, 3)).value
    for other in (np.asfortranarray(points), points.astype("f4"),
                  points.astype(">f8"), points.tolist(),
                  np.repeat(points, 2, axis=0)[::2]):
        assert (s.evaluate(other).value.reshape(-1) == flat).all()


def test_evaluate_hessian_is_the_gradient_s_derivative():
    s = scene(LETTER)
    p, h = np.array([0.3, 0.1, 0.2]), 1e-3
    got = s.evaluate(p, ["hessian"]).hessian
    steps = np.concatenate((p + h * np.eye(3), p - h * np.eye(3)))
    g = s.evaluate(steps, "gradient").gradient
    near(got, (g[:3] - g[3:]) / (2 * h), 0.02)  # measured: 0.004
    assert (got == got.T).all()


def test_evaluate_outputs():
    s = scene()
    assert list(s.evaluate([0, 0, 1], ["color", "value"])) == ["value",
                                                               "color"]
    with raises(ValueError, "'colour'", "curvature"):
        s.evaluate([0, 0, 1], "colour")
    with raises(ValueError):
        s.evaluate([0, 0, 1], [])
    with raises(AttributeError, "normal was not asked for"):
        s.evaluate([0, 0, 1]).normal
    with raises(KeyError):
        s.evaluate([0, 0, 1])["normal"]


def test_evaluate_refuses_what_float32_cannot_hold():
    s = scene()
    points = np.zeros((3, 4, 3))
    points[1, 2, 0] = 1e39
    with raises(ValueError, "points[1, 2, 0]", "1e+39"):
        s.evaluate(points)
    with raises(ValueError, "shape (..., 3)"):
        s.evaluate([[1, 2], [3, 4]])
    with raises(ValueError):
        s.evaluate(1.0)


def test_evaluate_without_a_scene():
    near(blobfield.evaluate(BALL, [1, 0, 0], url=client.url).value, 0.5, 1e-7)
    points = np.random.default_rng(2).normal(size=(3000, 3))
    before = [s.id for s in client.scenes()]
    many = client.evaluate(LETTER, points, "value").value
    assert [s.id for s in client.scenes()] == before
    few = client.evaluate(LETTER, points[:200], "value").value
    assert (many[:200] == few).all()
    os.environ["BLOBFIELD_URL"] = client.url
    near(blobfield.evaluate(json.dumps(document(BALL)), [1, 0, 0]).value, 0.5,
         1e-7)
    for points in ([0, 0, 1], np.zeros((1000, 3))):
        with raises(blobfield.InvalidContent, "radius"):
            client.evaluate(point([0, 0, 0], -1), points)


def test_evaluate_in_pieces():
    s = scene(LETTER)
    points = np.random.default_rng(7).uniform(-1, 1, (50, 4, 3))
    expected = s.evaluate(points).gradient
    whole = blobfield.scene.PIECE_POINTS
    blobfield.scene.PIECE_POINTS = 33
    try:
        assert (s.evaluate(points).gradient == expected).all()
        with raises(blobfield.PreconditionFailed):
            s.evaluate(points, if_match="0" * 32)
    finally:
        blobfield.scene.PIECE_POINTS = whole


def test_grid_is_what_evaluate_says():
    s = scene(LETTER)
    # Exact in float32, so that NumPy's points are the daemon's.
    lowest, highest, counts = (-1, -0.5, 0), (1, 0.5, 0.75), (5, 3, 4)
    points = np.stack(np.meshgrid(*map(np.linspace, lowest, highest, counts),
                                  indexing="ij"), axis=-1)
    outputs = ["value", "hessian", "color"]
    got, expected = (s.grid(lowest, highest, counts, outputs),
                     s.evaluate(points, outputs))
    assert list(got) == outputs and got.revision == s.revision
    assert got.value.shape == counts and got.hessian.shape == counts + (3, 3)
    for name in outputs:
        assert (got[name] == expected[name]).all(), name
    flat = s.grid(np.zeros(3), [1, 0, 0], np.array([2, 1, 1]))
    assert flat.value.shape == (2, 1, 1) and list(flat) == ["value",
                                                            "gradient"]
    assert (flat.gradient[:, 0, 0] == s.evaluate([[0, 0, 0], [1, 0, 0]])
            .gradient).all()


def test_grid_becomes_a_volume():
    samples = scene().grid([-2] * 3, [2] * 3, [16] * 3, "value").value
    volume = client.upload(samples, [-2] * 3, [2] * 3)
    assert volume.shape == (16, 16, 16)
    assert volume.most == samples.max()
    client.delete_volume(volume)


def test_grid_refusals():
    s = scene()
    with raises(blobfield.InvalidContent, "/counts") as e:
        s.grid([0, 0, 0], [1, 1, 1], [4096, 4096, 2])
    assert e[0].errors[0].pointer == "/counts"
    with raises(blobfield.InvalidContent) as e:
        s.grid([0, 1, 0], [1, 0, 1], [0, 2])
    assert e[0].errors[0].pointer == "/counts", e[0]
    with raises(blobfield.InvalidContent, "/max/1"):
        s.grid([0, 1, 0], [1, 0, 1], [2, 2, 2])
    with raises(ValueError, "'colour'"):
        s.grid([0, 0, 0], [1, 1, 1], [2, 2, 2], "colour")
    with raises(TypeError):
        s.grid([0, 0, 0], [1, 1, 1], [2, 2, 2.5])
    with raises(blobfield.PreconditionFailed):
        s.grid([0, 0, 0], [1, 1, 1], [2, 2, 2], if_match="0" * 32)
    with raises(blobfield.DeadlineExceeded):
        s.grid([-1, -1, -1], [1, 1, 1], [200, 100, 100], deadline=1e-3)
    with raises(blobfield.Cancelled):
        stop = blobfield.Cancellation()
        stop.cancel()
        s.grid([0, 0, 0], [1, 1, 1], [2, 2, 2], cancel=stop)


def test_grid_cut_short():
    # Rows that end before Content-Length: nothing of them comes out.
    def answer(h):
        h.rfile.read(int(h.headers["Content-Length"]))
        h.say(200, b"\0" * 16, length=32)
        h.close_connection = True
    with server(answer) as url:
        with blobfield.Client(url) as c:
            with raises(blobfield.ConnectionFailed, "in the middle"):
                c.scene("x").grid([0, 0, 0], [1, 1, 1], [2, 2, 2], "value")


def test_evaluate_deadline():
    with raises(blobfield.DeadlineExceeded, "504") as e:
        scene(LETTER).evaluate(np.zeros((2000000, 3)), deadline=1e-3)
    assert e[0].slug == "deadline"


def test_evaluate_a_million_points_against_curl():
    s = scene()
    points = np.random.default_rng(3).uniform(-1, 1, (1000000, 3))
    points = points.astype("f4")
    with tempfile.TemporaryDirectory() as folder:
        file = os.path.join(folder, "points")
        points.tofile(file)
        curl = min(float(subprocess.run(
            ["curl", "-s", "--noproxy", "*", "-o", folder + "/answer", "-w",
             "%{time_total}", "-H", "Content-Type: application/octet-stream",
             "-H", "Accept: application/octet-stream", "--data-binary",
             "@" + file, f"{client.url}/v1/scenes/test/eval"],
            capture_output=True, check=True).stdout) for _ in range(5))
        rows = np.fromfile(folder + "/answer", "<f4").reshape(-1, 4)
    times = []
    for _ in range(5):
        began = time.perf_counter()
        v = s.evaluate(points)
        times.append(time.perf_counter() - began)
    assert (v.value == rows[:, 0]).all()
    assert (v.gradient == rows[:, 1:]).all()
    print(f"measured: 10^6 points, value and gradient: {min(times) * 1e3:.0f} "
          f"ms; curl {curl * 1e3:.0f} ms")


# --- scenes -----------------------------------------------------------------

def test_scene_life():
    s = client.scene("life")
    assert not s.exists()
    with raises(blobfield.NotFound, "life"):
        s.document()
    s.put(BALL, only_new=True)
    assert s.exists() and s.document() == document(BALL)
    with raises(blobfield.PreconditionFailed):
        s.put(BALL, only_new=True)
    assert json.loads(s.text())["root"]["radius"] == 1
    mine = [x for x in client.scenes() if x.id == "life"]
    assert mine[0].revision == s.revision and mine[0].nodes == 1
    with raises(blobfield.PreconditionFailed):
        s.delete(if_match="0" * 32)
    s.delete()
    assert not s.exists() and s.revision is None
    made = client.create(LETTER)
    assert made.document()["name"] == "T"
    made.delete()


def test_scene_documents_of_all_kinds():
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "ball.json")
        with open(path, "w") as file:
            json.dump(document(BALL), file)
        import pathlib
        s = scene(pathlib.Path(path))
    text = s.text()
    assert scene(text).text() == text and scene(text.decode()).text() == text
    scene(point(np.zeros(3), np.float32(1)))
    with raises(ValueError):
        scene(point([0, 0, math.inf], 1))
    with raises(TypeError):
        scene(point([0, 0, 0], object()))


def test_scene_names_are_quoted():
    with raises(blobfield.ProblemError):
        client.scene("a/b", BALL)
    with raises(blobfield.ProblemError):
        client.scene("a?b é", BALL)


def test_scene_edits_of_two():
    s, other = scene(), client.scene("test")
    with raises(blobfield.PreconditionFailed, "412"):
        with s.edit() as d:
            d["root"]["radius"] = 2
            other.put(point([0, 0, 0], 3))
    assert s.document()["root"]["radius"] == 3
    with s.edit() as d:
        d["root"]["radius"] = 4
    assert other.document()["root"]["radius"] == 4
    assert other.revision == s.revision
    with raises(blobfield.PreconditionFailed):
        s.evaluate([0, 0, 0], if_match="0" * 32)
    s.evaluate([0, 0, 0], if_match=s.revision)


def test_scene_changes_by_many_threads():
    s = scene(point([0, 0, 0], 1))

    def add():
        def one(d):
            d["root"]["radius"] += 1
        for _ in range(5):
            client.scene("test").change(one, attempts=1000)

    in_threads(6, add)
    assert s.document()["root"]["radius"] == 31


def in_threads(n, work):
    failed = []

    def run():
        try:
            work()
        except BaseException as e:
            failed.append(e)
    threads = [threading.Thread(target=run) for _ in range(n)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    if failed:
        raise failed[0]


def await_true(condition):
    for _ in range(6000):
        if condition():
            return
        time.sleep(0.01)


def test_scene_watch():
    s = scene()
    seen = []

    def edit():
        for r in (2, 3):
            await_true(lambda: len(seen) >= r - 1)
            client.scene("test", point([0, 0, 0], r))
        await_true(lambda: len(seen) >= 3)
        s.delete()
    t = threading.Thread(target=edit)
    t.start()
    for revision in s.watch(interval=0.02):
        seen.append(revision)
    t.join()
    assert len(seen) == len(set(seen)) == 3, seen
    scene()
    assert len(list(s.watch(interval=0.02, timeout=1))) == 1
    stop = blobfield.Cancellation()
    threading.Timer(0.2, stop.cancel).start()
    with raises(blobfield.Cancelled):
        list(s.watch(interval=5, cancel=stop))


def test_scene_watch_by_asking():
    # A server that knows of no events: 404, as an older daemon.
    revisions = iter(["a", "a", "b", "b"])

    def answer(h):
        if h.path.endswith("/events"):
            return h.say(404)
        r = next(revisions, None)
        return h.say(404) if r is None else h.say(200, b"", ETag=f'"{r}"')
    with server(answer) as url:
        with blobfield.Client(url) as c:
            assert list(c.scene("x").watch(interval=0.01)) == ["a", "b"]
            with raises(blobfield.NotFound):
                list(c.scene("x").events())


def test_scene_patch():
    s = scene(LETTER)
    before = s.revision
    at = "/root/children/0/radius"
    assert s.patch([{"op": "test", "path": at, "value": 0.25},
                    {"op": "replace", "path": at, "value": 0.5}]) is s
    now = s.revision
    assert now != before
    assert s.document()["root"]["children"][0]["radius"] == 0.5
    s.patch({"name": "U", "root": {"operator": None}})
    d = s.document()
    assert d["name"] == "U" and "operator" not in d["root"]
    last = s.revision
    with raises(blobfield.PreconditionFailed):
        s.patch({"name": "V"}, if_match=now)
    with raises(blobfield.Conflict, "(409)") as got:
        s.patch([{"op": "add", "path": "/name", "value": "W"},
                 {"op": "test", "path": at, "value": 7}])
    assert got[0].errors[0].pointer == "/1/value"
    with raises(blobfield.InvalidContent) as got:
        s.patch([{"op": "remove", "path": "/root/children/9"}])
    assert got[0].errors[0].pointer == "/0/path"
    with raises(blobfield.InvalidContent, "after the patch") as got:
        s.patch({"root": {"children": [point([0, 0, 0], -1)]}})
    assert got[0].errors[0].pointer == "/root/children/0/radius"
    assert client.scene("test").document() == d and s.revision == last
    s.patch({"name": "W"}, if_match=last)
    with raises(blobfield.NotFound):
        client.scene("nowhere").patch({"name": "x"})


def test_scene_patches_of_many_threads_are_all_kept():
    s = scene(document(union(BALL)))

    def add(k):
        client.scene("test").patch([{
            "op": "add", "path": "/root/children/-",
            "value": point([k, 0, 0], 1)}])
    threads = [threading.Thread(target=add, args=(k,)) for k in range(1, 13)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    found = [c["center"][0] for c in s.document()["root"]["children"]]
    assert sorted(found) == list(range(13)), found


def test_scene_revisions():
    s = client.scene("history", BALL)
    first = s.revision
    for r in range(2, 7):
        s.put(point([0, 0, 0], r))
    kept = list(s.revisions())
    assert len(kept) == 6 and kept[0].revision == s.revision
    assert kept[-1].revision == first
    assert [k.sequence for k in kept] == sorted(
        (k.sequence for k in kept), key=int, reverse=True)
    assert kept[0].nodes == 1 and kept[0].bytes == len(s.text())
    age = datetime.datetime.now(datetime.timezone.utc) - kept[0].time
    assert datetime.timedelta(0) < age < datetime.timedelta(minutes=1)
    assert json.loads(s.at(first))["root"]["radius"] == 1
    assert s.revision == kept[0].revision
    summary = next(t for t in client.scenes() if t.id == "history")
    assert (summary.sequence, summary.time) == \
        (kept[0].sequence, kept[0].time)
    with raises(blobfield.NotFound):
        s.at("0" * 32)
    s.delete()
    with raises(blobfield.NotFound):
        list(s.revisions())


def test_scene_events():
    s = client.scene("told", BALL)
    events = s.events()
    first = next(events)
    assert (first.id, first.revision) == ("told", s.revision)
    assert first.nodes == 1 and not first.missed and not first.deleted
    other = client.scene("told", point([0, 0, 0], 2))
    second = next(events)
    assert second.revision == other.revision == s.revision
    assert int(second.sequence) > int(first.sequence)
    assert second.time >= first.time
    # What has been since, of those that are kept.
    assert next(s.events(first)).revision == second.revision
    assert list(s.events(second.sequence, timeout=0.3)) == []
    other.delete()
    last = next(events)
    assert last.deleted and last.revision is None and s.revision is None
    assert next(events, None) is None
    with raises(blobfield.NotFound):
        next(s.events())


def test_scene_events_are_cancelled_or_left():
    s = client.scene("told", BALL)
    stop = blobfield.Cancellation()
    threading.Timer(0.3, stop.cancel).start()
    began = time.monotonic()
    with raises(blobfield.Cancelled):
        list(s.events(cancel=stop))
    assert time.monotonic() - began < 60
    for _ in s.events():
        break
    s.delete()


def test_scene_events_go_on_behind_a_broken_connection():
    asked = []
    text = ('id: %d\nevent: revision\ndata: {"id": "x", "sequence": "%d",\n'
            'data: "revision": "r%d", "time": "2026-11-22T13:35:32.123Z", '
            '"nodes": 1, "bytes": 9}\n\n')

    def answer(h):
        n = len(asked)
        asked.append((time.monotonic(), h.headers.get("Last-Event-ID")))
        if n == 1:
            return h.say(503, Retry_After="0.3")
        if n == 3:
            return h.say(404)
        h.send_response(200)
        h.send_header("Content-Type", "text/event-stream")
        h.send_header("Connection", "close")
        h.end_headers()
        # The last one is cut off: without its empty line it is none.
        h.wfile.write((f"retry: 100\n\n: alive\n\n{text % (n, n, n)}"
                       "id: 99\ndata: {").encode())
        h.close_connection = True
    with server(answer) as url:
        with blobfield.Client(url) as c:
            got = list(c.scene("x").events())
    assert [e.revision for e in got] == ["r0", "r2"], got
    assert got[0].time.microsecond == 123000
    assert [a[1] for a in asked] == [None, "0", "0", "2"]
    pauses = np.diff([a[0] for a in asked])
    assert 0.1 <= pauses[0] < 2 and 0.3 <= pauses[1] < 2, pauses


def test_scene_events_go_on_after_a_restart():
    folder = tempfile.mkdtemp(prefix="blobfield-")
    d = Daemon("--no-measure", "--data", folder, "--cache",
               os.path.join(folder, "cache"))
    try:
        with blobfield.Client(d.url) as c, blobfield.Client(d.url) as c2:
            s = c.wait_until_ready().scene("kept", BALL)
            s.put(point([0, 0, 0], 2))
            events = s.events()
            before = next(events)
            d.kill()
            d = d.again()
            c2.wait_until_ready()
            # Made while nobody listens: within the 2 s before the next
            # connection.
            other = c2.scene("kept", point([0, 0, 0], 3))
            after = next(events)
            assert after.revision == other.revision and not after.missed
            assert int(after.sequence) > int(before.sequence)
            kept = list(other.revisions())
            assert [k.revision for k in kept[:2]] == \
                [after.revision, before.revision] and len(kept) == 3
            d.kill()
            d = d.again()
            c2.wait_until_ready()
            other.delete()
            # The deletion is told, or the scene was gone before.
            assert all(e.deleted for e in events)
    finally:
        d.kill()
        shutil.rmtree(folder)


def test_scene_bounds():
    b = scene().bounds()
    near(b.max, [2.20166] * 3, 1e-4)
    assert b.bounded and not b.empty
    b = scene(blobfield.node("plane", point=[0, 0, 0], normal=[0, 0, 1],
                             falloff=1)).bounds()
    assert not b.bounded and b.min[0] == -math.inf
    near(b.max[2], 1, 1e-12)
    assert b.surface is None
    assert scene(point([0, 0, 0], 1, weight=0)).bounds().empty


def test_scene_bounds_of_the_surface():
    b = scene().bounds().surface
    assert b is not None
    for low, high in zip(b.min, b.max):
        assert -1.1 < low <= -1 and 1 <= high < 1.1, b


def test_scene_opening_angle():
    a = scene(LETTER).opening_angle("joint", [0.5, 0, 0.25])
    assert a.parameter in ("theta0", "theta1", "theta2")
    near(math.tan(a.theta), 2 * a.values[1], 1e-6)
    assert sorted(a.children) == [0, 1]
    assert a == client.scene("test").opening_angle("joint", [0.5, 0, 0.25],
                                                   (1, 0))
    with raises(blobfield.InvalidContent, "/node"):
        client.scene("test").opening_angle("nothing", [0, 0, 0])


# --- the daemon -------------------------------------------------------------

def test_client_info():
    assert client.ready() and client.info()["format"] == "blobfield/1"
    names = [o["name"] for o in client.operators()["operators"]]
    assert "camel" in names and client.operator("camel")["tables"]
    with raises(blobfield.NotFound):
        client.operator("camle")
    built = client.build_operator(profile={"type": "bulge", "k": 0.7},
                                  resolution=8)
    scene(union(BALL, BALL, operator=built["operator"]))


def test_client_volumes():
    x = np.linspace(-1, 1, 32)
    grid = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1)
    distance = np.linalg.norm(grid, axis=-1) - 0.6
    v = client.upload(distance, [-1, -1, -1], [1, 1, 1], "distance")
    assert v.shape == (32, 32, 32) and v in client.volumes()
    s = scene(blobfield.node("volume", volume=v.id, falloff=0.2))
    near(s.evaluate([0.6, 0, 0]).value, 0.5, 1e-3)
    client.delete_volume(v)
    assert v not in client.volumes()
    with raises(blobfield.InvalidContent, "/12/3/4"):
        distance[12, 3, 4] = math.nan
        client.upload(distance, [-1, -1, -1], [1, 1, 1], "distance")


def test_client_import():
    p = {"type": "ScalisPoint", "v": [{"position": {"x": 0, "y": 0, "z": 0},
                                       "thickness": 1}],
         "volType": "dist", "density": 1,
         "materials": [{"color": "#ff0000", "roughness": 0.5, "metalness": 0,
                        "emissive": "#000000"}]}
    got = client.import_blobtree({"type": "RootNode", "ricci_n": 64, "iso": 1,
                                  "children": [p]})
    assert got.warnings[0][0] == "/children/0/materials/0/roughness"
    near(scene(got.document).evaluate([0, 0, 0]).value, 1.185185, 1e-5)
    assert client.import_blobtree(p).document["root"]["type"] == "point"


# --- surfaces ---------------------------------------------------------------

def test_raycast_of_a_ball():
    s = scene(point([0, 0, 0], 1, color=[1, 0.5, 0]))
    hits = s.raycast([0, -3, 0], [[[0, 1, 0], [0, 2, 0]],
                                  [[0, -1, 0], [0.1, 1, 0.2]]])
    assert hits.hit.tolist() == [[True, True], [False, True]]
    near(hits.distance[0], [2, 2], 1e-4)
    near(hits.position[0, 1], [0, -1, 0], 1e-4)
    near(hits.normal[0, 0], [0, -1, 0], 1e-4)
    near(hits.value[hits.hit], 0.5, 1e-4)
    near(np.linalg.norm(hits.position[1, 1]), 1, 1e-4)
    near(hits.color[0, 0], [1, 0.5, 0], 1e-3)
    assert hits.leaf.tolist() == [[0, 0], [-1, 0]]
    assert hits.distance[1, 0] == math.inf and np.isnan(hits.position[1, 0, 0])
    assert (hits.normal[1, 0] == 0).all()
    assert not s.raycast([0, -3, 0], [0, 1, 0], max_distance=1).hit
    near(s.raycast([0, 0, 0], [0, 0, 1]).distance, 1, 1e-4)  # from inside
    inner = s.raycast([0, -3, 0], [0, 1, 0], iso=0.8)
    assert inner.distance > 2.1 and abs(inner.value - 0.8) < 1e-3
    with raises(blobfield.InvalidContent, "1"):
        s.raycast([[0, 0, 0]] * 2, [[0, 0, 1], [0, 0, 0]])


def test_raycast_names_the_node():
    doc = document(blobfield.difference(
        union(sphere([0, 0, 0], 1, 0.5), blobfield.node(
            "twist", axis=[0, 0, 1], rate=0.1,
            child=sphere([3, 0, 0], 1, 0.5))),
        sphere([0, 0, 1], 0.5, 0.2), operator="sharp"))
    s = scene(doc)
    pointers = s.leaf_pointers()
    assert pointers == ["/root/children/0/children/0",
                        "/root/children/0/children/1/child",
                        "/root/children/1"]
    rays = [[0, -5, 0, 0, 1, 0], [3, -5, 0, 0, 1, 0], [0, 0, 5, 0, 0, -1]]
    hits = s.raycast(np.array(rays)[:, :3], np.array(rays)[:, 3:])
    answer = client.transport.request(
        "POST", "/v1/scenes/test/raycast", kind="application/json",
        body=json.dumps({"rays": rays}).encode()).json()
    assert [pointers[i] for i in hits.leaf] == answer["node"]
    assert answer["node"] == pointers


def test_project():
    s = scene()
    points = np.random.default_rng(4).normal(size=(10, 20, 3))
    points *= 1.3 / np.linalg.norm(points, axis=-1, keepdims=True)
    got = s.project(points)
    assert got.converged.all() and got.position.shape == points.shape
    near(np.linalg.norm(got.position, axis=-1), 1, 1e-4)
    near(got.distance, 0.3, 1e-4)
    near(got.normal, points / 1.3, 1e-3)
    near(got.value, 0.5, 1e-4)
    far = s.project([[9, 0, 0]])
    assert not far.converged[0] and far.position[0, 0] == 9
    assert not s.project([1.8, 0, 0], max_distance=0.1).converged


def edges_closed(mesh):
    """Whether every directed edge comes once and has its opposite."""
    t = mesh.triangles.astype(np.int64)
    n = len(mesh.vertices)
    there = np.concatenate([t[:, i] * n + t[:, (i + 1) % 3]
                            for i in range(3)])
    back = there % n * n + there // n
    return len(np.unique(there)) == len(there) and \
        (np.sort(there) == np.sort(back)).all()


def test_mesh_of_a_torus():
    s = scene(torus([1, 2, 3], [0, 0, 1], 2, 0.5, 0.25, color=[1, 0.5, 0]))
    m = s.mesh(resolution=48)
    assert m.vertices.dtype == np.float32 and m.triangles.dtype == np.uint32
    assert edges_closed(m) and m.figures["genus"] == 1
    assert len(m.vertices) == m.figures["vertices"]
    assert len(m.triangles) == m.figures["triangles"]
    near(s.evaluate(m.vertices).value, 0.5, 1e-3)
    x, y, z = m.vertices.T - np.array([[1], [2], [3]])
    near(np.hypot(np.hypot(x, y) - 2, z), 0.5, 1e-3)  # Z is up
    near(m.normals, s.evaluate(m.vertices, "normal").normal, 1e-2)
    near(m.colors, [[1, 0.5, 0]] * len(m.vertices), 1e-2)
    p = m.vertices[m.triangles]
    volume = np.einsum("ij,ij->i", p[:, 0],
                       np.cross(p[:, 1], p[:, 2])).sum() / 6
    near(volume, 2 * math.pi ** 2 * 2 * 0.25, 0.1)
    near(volume, m.figures["volume"], 1e-2)
    assert m.revision == s.revision


def test_mesh_options():
    s = scene()
    plain = s.mesh(resolution=8, normals=False, colors=False)
    assert plain.normals is None and plain.colors is None
    assert edges_closed(plain)
    fine = s.mesh(edge_length=0.1)
    near(fine.figures["edge_length"], 0.1, 1e-9)
    half = s.mesh(resolution=16, bounds=([-2, -2, 0], [2, 2, 2]))
    assert edges_closed(half) and half.vertices[:, 2].min() > -0.01
    inner = s.mesh(iso=0.8, resolution=16)
    assert np.linalg.norm(inner.vertices, axis=1).max() < 0.9
    none = s.mesh(bounds=([5, 5, 5], [6, 6, 6]))
    assert none.vertices.shape == none.triangles.shape == (0, 3)
    with raises(blobfield.InvalidContent, "/resolution"):
        s.mesh(resolution=1)
    with raises(blobfield.InvalidContent, "/bounds"):
        scene(blobfield.node("plane", point=[0, 0, 0], normal=[0, 0, 1],
                             falloff=1)).mesh()


def test_mesh_files():
    s = scene()
    with tempfile.TemporaryDirectory() as folder:
        for kind, start in (("glb", b"glTF"), ("ply", b"ply\n"),
                            ("stl", None), ("obj", None), ("json", b"{")):
            path = os.path.join(folder, "ball." + kind)
            counts = s.mesh_file(path, resolution=12)
            with open(path, "rb") as file:
                data = file.read()
            assert counts["vertices"] > 100 and counts["genus"] == 0, \
                (kind, counts)
            if start:
                assert data.startswith(start)
            if kind == "stl":
                n = struct.unpack_from("<I", data, 80)[0]
                assert n == counts["triangles"]
                assert len(data) == 84 + 50 * n
            if kind == "glb":
                m = blobfield.Mesh.from_glb(data)
                assert len(m.vertices) == counts["vertices"]
        with raises(ValueError, "glb, ply"):
            s.mesh_file(os.path.join(folder, "ball.3ds"))
        s.mesh_file(os.path.join(folder, "odd"), "STL", resolution=8)
        with raises(blobfield.InvalidContent):
            s.mesh_file(path + "x", "ply", resolution=0)
        assert sorted(os.listdir(folder)) == [
            "ball.glb", "ball.json", "ball.obj", "ball.ply", "ball.stl",
            "odd"]


def png_size(data):
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack_from(">II", data, 16)


def test_render():
    s = scene(LETTER)
    for shading in ("lit", "normal", "zebra", "curvature", "field"):
        assert png_size(s.render(64, 48, shading=shading)) == (64, 48)
    camera = blobfield.Camera((3, -4, 2), (0, 0, 0.5), fov=0.5)
    assert s.render(64, 48, camera=camera, samples=1,
                    background=[1, 1, 1]) != s.render(64, 48, samples=1)
    with raises(blobfield.InvalidContent, "/shading"):
        s.render(shading="shiny")


def test_slice():
    s = scene(LETTER)
    got = s.slice(40, 30, center=[0, 0, 0.5], normal=[0, -1, 0],
                  extent=4, outputs=["value", "gradient"])
    assert got.value.shape == (30, 40) and got.gradient.shape == (30, 40, 3)
    step = 4 / 40
    x = ((np.arange(40) + 0.5) - 20) * step
    z = 0.5 + (15 - (np.arange(30) + 0.5)) * step
    points = np.zeros((30, 40, 3))
    points[..., 0] = x
    points[..., 2] = z[:, None]
    near(got.value, s.evaluate(points).value, 1e-3)
    assert s.slice(8, 4).value.shape == (4, 8)
    assert png_size(s.slice_png(64, 32, levels=0.1)) == (64, 32)
    assert png_size(s.slice_png(64, 32, levels=[0.2, 0.7])) == (64, 32)


# --- long work --------------------------------------------------------------

def heavy():
    """A scene whose fine mesh takes seconds."""
    rng = np.random.default_rng(5)
    return scene(union(*(point(c, 0.4) for c in rng.uniform(-1, 1, (60, 3))),
                       operator="camel"))


def test_progress_of_a_mesh():
    seen = []
    m = heavy().mesh(resolution=160,
                     progress=lambda stage, done: seen.append((stage, done)))
    assert len(m.vertices) > 10000
    done = [d for _, d in seen]
    assert done[-1] == 1.0 and done == sorted(done), seen
    assert len(seen) > 1, seen
    print(f"measured: {len(seen)} steps of progress: "
          f"{', '.join(dict(seen))}")


def test_progress_that_raises_cancels():
    class Enough(Exception):
        pass

    def progress(stage, done):
        raise Enough

    s = heavy()
    began = time.monotonic()
    with raises(Enough):
        s.mesh(resolution=400, progress=progress)
    assert time.monotonic() - began < 60


def test_cancellation_from_another_thread():
    s = heavy()
    stop = blobfield.Cancellation()
    threading.Timer(0.3, stop.cancel).start()
    began = time.monotonic()
    with raises(blobfield.Cancelled):
        s.mesh(resolution=600, cancel=stop)
    seconds = time.monotonic() - began
    assert seconds < 60, seconds
    with raises(blobfield.Cancelled):
        s.evaluate([0, 0, 0], cancel=stop)
    last = time.monotonic() + 60  # the daemon has dropped it too
    while client.info()["tasks"]["running"] and time.monotonic() < last:
        time.sleep(0.05)
    assert not client.info()["tasks"]["running"]


def test_deadline_of_a_mesh():
    with raises(blobfield.DeadlineExceeded):
        heavy().mesh(resolution=500, deadline=0.2)


# --- errors and the connection ----------------------------------------------

def test_problem_message():
    with raises(blobfield.InvalidContent) as e:
        client.scene("bad", union(point([0, 0], 1),
                                  sphere([0, 0, 0], 1, -1)))
    assert str(e[0]) == (
        "Invalid content (422), 2 places:\n"
        "  /root/children/0/center: must have 3 numbers, not 2\n"
        "  /root/children/1/falloff: must be between 1e-09 and 1000000000, "
        "not -1"), str(e[0])
    assert e[0].errors[0].pointer == "/root/children/0/center"
    assert e[0].type == "/problems/invalid" and e[0].status == 422
    copy = pickle.loads(pickle.dumps(e[0]))
    assert str(copy) == str(e[0]) and copy.errors == e[0].errors
    many = union(*[point([0, 0], 1)] * 30)
    with raises(blobfield.InvalidContent, "and 14 more", "30 places"):
        client.scene("bad", many)


def test_no_daemon():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{s.getsockname()[1]}"
        with raises(blobfield.ConnectionFailed, "is blobfieldd running"):
            blobfield.Client(url).info()
        with raises(blobfield.ConnectionFailed, "no ready daemon"):
            blobfield.Client(url).wait_until_ready(0.2)
    for wrong in ("ftp://x", "http://", "http://x:y"):
        with raises(ValueError, "not the address"):
            blobfield.Client(wrong)


def test_url_forms():
    host = client.url.split("//")[1]
    assert blobfield.Client(host).ready()
    assert blobfield.Client(client.url + "/").ready()
    with server(lambda h: h.say(200, json.dumps({"at": h.path}).encode())) \
            as url:
        with blobfield.Client(url + "/below/") as c:
            assert c.info() == {"at": "/below/v1/info"}


def test_retry_after_503():
    calls = []

    def answer(h):
        calls.append(time.monotonic())
        if len(calls) < 3:
            h.say(503, b'{"type": "/problems/queue-full", "title": "Full"}',
                  Content_Type="application/problem+json", Retry_After="0.2")
        else:
            h.say(200, b'{"a": 1}')
    with server(answer) as url:
        assert blobfield.Client(url).info() == {"a": 1}
    assert 0.35 < calls[2] - calls[0]


def test_retry_is_bounded():
    slug = "queue-full"
    with server(lambda h: h.say(
            503, json.dumps({"type": "/problems/" + slug,
                             "title": "Busy"}).encode(), Retry_After="0.1",
            Content_Type="application/problem+json")) as url:
        began = time.monotonic()
        with raises(blobfield.Busy, "Busy (503)"):
            blobfield.Client(url, retry_for=0.5).info()
        assert 0.3 < time.monotonic() - began < 30
        slug = "draining"
        began = time.monotonic()
        with raises(blobfield.Busy):
            blobfield.Client(url, retry_for=60).info()
        assert time.monotonic() - began < 30
        assert not blobfield.Client(url).ready()


def test_retries_are_counted():
    calls = []

    def answer(h):
        calls.append(h.path)
        h.say(503, b'{"type": "/problems/store-unavailable"}',
              Content_Type="application/problem+json", Retry_After="0.1")
    with server(answer) as url:
        for retries in (0, 2):
            calls.clear()
            with raises(blobfield.StoreUnavailable) as got:
                blobfield.Client(url, retries=retries).info()
            assert len(calls) == retries + 1
            assert got[0].retry_after == 0.1


def test_kinds_of_busy():
    slug = ""
    with server(lambda h: h.say(
            503, json.dumps({"type": "/problems/" + slug}).encode(),
            Content_Type="application/problem+json", Retry_After="2")) as url:
        with blobfield.Client(url, retries=0) as c:
            for slug, kind in (
                    ("device-lost", blobfield.DeviceLost),
                    ("store-unavailable", blobfield.StoreUnavailable),
                    ("queue-full", blobfield.Busy)):
                with raises(blobfield.Busy) as got:
                    c.info()
                assert type(got[0]) is kind and got[0].retry_after == 2
                assert type(pickle.loads(pickle.dumps(got[0]))) is kind


def test_tls():
    if not shutil.which("openssl"):
        print("skipped: openssl is not installed")
        return "skipped"
    folder = tempfile.mkdtemp(prefix="blobfield-")
    key, cert = (os.path.join(folder, n) for n in ("key", "cert"))
    d = None
    try:
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec",
                        "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes",
                        "-keyout", key, "-out", cert, "-days", "2", "-subj",
                        "/CN=blobfield", "-addext",
                        "subjectAltName=IP:127.0.0.1"],
                       check=True, capture_output=True)
        d = Daemon("--no-measure", "--tls-cert", cert, "--tls-key", key)
        assert d.url.startswith("https://"), d.url
        for wrong in (key, folder + "/nowhere"):
            with raises(ValueError, wrong):
                blobfield.Client(d.url, ca=wrong)
        with raises(blobfield.ConnectionFailed, "not to be trusted", "ca="):
            blobfield.Client(d.url).info()
        with blobfield.Client(d.url, ca=cert) as c:
            s = c.wait_until_ready().scene("a", BALL)
            near(s.evaluate([[1, 0, 0]]).value, [0.5], 1e-6)
            events = s.events()
            assert next(events).revision == s.revision
            s.patch({"name": "b"})
            assert next(events).revision == s.revision
            events.close()
            stop = blobfield.Cancellation()
            threading.Timer(0.3, stop.cancel).start()
            with raises(blobfield.Cancelled):
                list(s.events(cancel=stop))
            # Kept connections are used again.
            assert len(c.transport._idle) == 1
            kept = c.transport._idle[0].sock
            for _ in range(3):
                c.info()
            assert c.transport._idle[0].sock is kept
        os.environ["BLOBFIELD_CA"] = cert
        try:
            assert blobfield.Client(d.url).ready()
        finally:
            del os.environ["BLOBFIELD_CA"]
    finally:
        if d is not None:
            d.stop()
        shutil.rmtree(folder)


@contextlib.contextmanager
def closed_daemon(**limits):
    """A daemon that asks for tokens: its URL, and one of role write with
    limits, one of role read."""
    folder = tempfile.mkdtemp(prefix="blobfield-")
    secrets, entries = [], []
    for name in ("w:write", "r:read"):
        secret, entry = subprocess.run(
            [DAEMON, "--make-token", name], stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True, check=True
        ).stdout.splitlines()
        secrets.append(secret)
        entries.append(json.loads(entry))
    entries[0]["limits"] = limits
    path = os.path.join(folder, "tokens")
    with open(os.open(path, os.O_WRONLY | os.O_CREAT, 0o600), "w") as file:
        json.dump({"tokens": entries}, file)
    d = Daemon("--no-measure", "--tokens", path)
    try:
        with blobfield.Client(d.url) as c:
            c.wait_until_ready()
        yield d.url, *secrets
    finally:
        d.stop()
        shutil.rmtree(folder)


def test_token():
    with closed_daemon() as (url, write, read):
        with raises(blobfield.Unauthorized, "Unauthorized (401)", "'read'"):
            blobfield.Client(url).info()
        with raises(blobfield.Unauthorized, "not known"):
            blobfield.Client(url, token="bf_no").info()
        with raises(blobfield.Forbidden, "Forbidden (403)", "'write'"):
            blobfield.Client(url, token=read).scene("a", BALL)
        with blobfield.Client(url, token=write) as c:
            s = c.scene("a", BALL)
            assert s.mesh(resolution=8, progress=lambda *_: None).triangles.size
        os.environ["BLOBFIELD_TOKEN"] = read
        try:
            assert blobfield.Client(url).info()["name"] == "blobfield"
            with raises(blobfield.Unauthorized):
                blobfield.Client(url, token="").info()
        finally:
            del os.environ["BLOBFIELD_TOKEN"]
    for wrong in ("a b", "\u00e4", "a\r\nX: y", " "):
        with raises(ValueError, "one word"):
            blobfield.Client(token=wrong)


def test_token_limits():
    with closed_daemon(points_per_second=1000) as (url, write, _):
        with blobfield.Client(url, token=write, retry_for=0) as c:
            s = c.scene("a", BALL)
            s.evaluate(np.zeros((40000, 3)))
            with raises(blobfield.TooManyRequests, "429",
                        "points_per_second") as got:
                s.evaluate([0, 0, 0])
            assert 2 <= got[0].retry_after <= 39
    with closed_daemon(requests_per_second=4) as (url, write, _):
        with blobfield.Client(url, token=write) as c:
            began = time.monotonic()
            for _ in range(8):
                c.info()  # waits as it is told
            assert 0.9 < time.monotonic() - began


def test_kept_connections():
    peers = set()

    def answer(h):
        peers.add(h.client_address)
        h.say(200)
    with server(answer) as url:
        c = blobfield.Client(url)
        for _ in range(5):
            c.info()
        assert len(peers) == 1
        c.close()
        c.info()
        assert len(peers) == 2


def test_connection_closed_while_idle():
    def answer(h):
        h.say(200)
        h.close_connection = True  # without saying so
    with server(answer) as url:
        c = blobfield.Client(url)
        for wait in (0, 0.1, 0, 0.1, 0):
            c.info()
            time.sleep(wait)


def test_answer_cut_short():
    def answer(h):
        h.say(200, b"{}", length=1000)
        h.close_connection = True
    with server(answer) as url:
        with raises(blobfield.ConnectionFailed, "in the middle"):
            blobfield.Client(url).info()


def test_refusal_before_the_body_is_read():
    def answer(h):
        h.say(413, b'{"type": "/problems/too-large", "title": "Too large", '
              b'"detail": "no"}', Content_Type="application/problem+json",
              Connection="close")
        h.close_connection = True
    with server(answer) as url:
        with raises(blobfield.ProblemError) as e:
            blobfield.Client(url).create(b" " * 50000000)
    assert e[0].slug == "too-large", e


def test_timeout_and_cancellation_of_silence():
    with server(lambda h: time.sleep(60)) as url:
        began = time.monotonic()
        with raises(blobfield.ConnectionFailed, "within the timeout"):
            blobfield.Client(url, timeout=0.3).info()
        stop = blobfield.Cancellation()
        threading.Timer(0.3, stop.cancel).start()
        with raises(blobfield.Cancelled):
            blobfield.Client(url).scene("x").evaluate([0, 0, 0], cancel=stop)
        assert time.monotonic() - began < 50


def test_answers_that_are_not_json():
    with server(lambda h: h.say(502, b"<html>Bad gateway",
                                Content_Type="text/html")) as url:
        with raises(blobfield.ProblemError, "502", "Bad gateway"):
            blobfield.Client(url).info()


def test_one_client_in_many_threads():
    rng = np.random.default_rng(6)
    for i in range(4):
        client.scene(f"many{i}", point([i, 0, 0], 1))
    points = rng.normal(size=(500, 3))
    expected = [client.scene(f"many{i}").evaluate(points).value
                for i in range(4)]

    def work():
        for n in range(40):
            i = n % 4
            got = client.scene(f"many{i}").evaluate(points).value
            assert (got == expected[i]).all()
    in_threads(8, work)
    assert len(client.transport._idle) <= 8


# --- the package ------------------------------------------------------------

def test_readme_runs():
    with open(os.path.join(PACKAGE, "README.md")) as file:
        blocks = re.findall(r"^```python\n(.*?)^```$", file.read(),
                            re.M | re.S)
    assert len(blocks) >= 6 and blocks[0].count("\n") == 3
    os.environ["BLOBFIELD_URL"] = client.url
    names = {}
    here = os.getcwd()
    folder = tempfile.mkdtemp()
    os.chdir(folder)
    try:
        for i, block in enumerate(blocks):
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(block, f"README.md block {i}", "exec"), names)
            # What a comment behind a print, or below, promises.
            said = re.findall(r"^print.*  # (.*)$|^# (.*)$", block, re.M)
            for promise in (a or b for a, b in said):
                assert promise.strip() in out.getvalue(), \
                    (promise, out.getvalue())
        assert sorted(os.listdir(".")) == ["letter.glb", "letter.png"]
    finally:
        os.chdir(here)
        shutil.rmtree(folder)


def test_types():
    if not shutil.which("mypy"):
        print("skipped: mypy is not installed")
        return "skipped"
    # Beside the daemon, so that only the first time takes long.
    cache = os.path.join(os.path.dirname(os.path.abspath(DAEMON)), "mypy")
    got = subprocess.run(["mypy", "--strict", "--cache-dir", cache,
                          "blobfield"], cwd=PACKAGE, text=True,
                         capture_output=True)
    assert got.returncode == 0, got.stdout


def test_imports_nothing_else():
    code = ("import sys, numpy; there = set(sys.modules); "
            "sys.path.insert(0, sys.argv[1]); import blobfield; "
            "print(*{m.split('.')[0] for m in set(sys.modules) - there})")
    names = subprocess.run([sys.executable, "-c", code, PACKAGE],
                           capture_output=True, text=True,
                           check=True).stdout.split()
    others = set(names) - set(sys.stdlib_module_names) - {"numpy", "blobfield"}
    assert "blobfield" in names and not others, others


def main():
    global client
    failed = 0
    daemon = Daemon()
    client = blobfield.Client(daemon.url).wait_until_ready()
    for name, case in list(globals().items()):
        if not name.startswith("test_") or \
                (sys.argv[1:] and name not in sys.argv[1:]):
            continue
        print(f"[ RUN      ] {name}", flush=True)
        try:
            if case() == "skipped":
                print(f"[  SKIPPED ] {name}", flush=True)
            else:
                print(f"[       OK ] {name}", flush=True)
        except Exception:
            traceback.print_exc(file=sys.stdout)
            print(f"[  FAILED  ] {name}", flush=True)
            failed += 1
    client.close()
    try:
        daemon.stop()
    except Exception:
        traceback.print_exc(file=sys.stdout)
        failed += 1
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
