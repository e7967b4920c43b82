#!/usr/bin/python3
"""Large documents, work without end, and one who asks for much: what they keep
from others.

Starts the daemon ($BLOBFIELDD, else build/blobfieldd). Prints its cases as
cmocka does.
"""
import contextlib
import http.client
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback

# The tables that tests/run.sh has built for all, or none.
CACHE = (["--cache", os.environ["BLOBFIELD_TEST_CACHE"],
          "--cache-read-only"] if "BLOBFIELD_TEST_CACHE" in os.environ
         else ["--no-cache"])

PATIENCE = 120
BALL = {"format": "blobfield/1",
        "root": {"type": "point", "center": [0, 0, 0], "radius": 1}}
POINTS = [[0, 0, 0.5], [0.25, 0.5, 0]]
NPY = {"Accept": "application/x-npy"}


class Daemon:
    def __init__(self, *more, log=None):
        program = os.environ.get("BLOBFIELDD", "build/blobfieldd")
        self.process = subprocess.Popen(
            [program, *CACHE, "--no-measure", "--data", ":memory:", "--listen",
             "127.0.0.1:0", *(["--quiet"] if log is None else []), *more],
            stdout=subprocess.PIPE, stderr=log, text=True)
        self.port = int(re.search(
            r":(\d+)$", self.process.stdout.readline().strip()).group(1))
        wait_until(lambda: self.ask("GET", "/readyz")[0] == 200)

    def connect(self):
        return http.client.HTTPConnection("127.0.0.1", self.port,
                                          timeout=PATIENCE)

    def ask(self, method, path, body=None, headers=None):
        """Status and what it says; a body that is cut short raises."""
        connection = self.connect()
        with contextlib.closing(connection):
            return ask(connection, method, path, body, headers)

    def send(self, path, body, headers=None):
        """A connection that has asked, and reads nothing."""
        connection = self.connect()
        connection.request("POST", path, json.dumps(body), dict(
            {"Content-Type": "application/json"}, **(headers or {})))
        return connection

    def tasks(self, headers=None):
        return json.loads(self.ask("GET", "/v1/info", None,
                                   headers)[1])["tasks"]

    def metric(self, name):
        text = self.ask("GET", "/metrics")[1].decode()
        found = re.search(r"^%s (.*)$" % re.escape(name), text, re.M)
        return float(found.group(1)) if found else 0.0

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(PATIENCE)
        finally:
            self.process.kill()


@contextlib.contextmanager
def running(*more, log=None):
    daemon = Daemon(*more, log=log)
    try:
        yield daemon
        assert daemon.stop() == 0
    finally:
        daemon.process.kill()
        daemon.process.wait()


def ask(connection, method, path, body=None, headers=None):
    if body is not None and not isinstance(body, (bytes, str)):
        body = json.dumps(body)
    headers = dict(headers or {})
    if body is not None:
        headers.setdefault("Content-Type", "application/json")
    connection.request(method, path, body, headers)
    reply = connection.getresponse()
    return reply.status, reply.read()


def wait_until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it never came to be"
        time.sleep(0.02)


def large(size, wrong=None):
    """A document of that many bytes, about; node `wrong` has no radius."""
    pad = "1" * 8 + "0" * 100
    child = ('{"type":"point","center":[0.%s,1.%s,0.%s],"radius":2}'
             % (pad, pad, pad))
    children = [child] * (size // len(child))
    if wrong is not None:
        children[wrong] = child.replace('"radius":2', '"radius":-2')
    return ('{"format":"blobfield/1","root":{"type":"sum","children":[%s]}}'
            % ",".join(children))


def camel(count, step, radius):
    return dict(BALL, root={
        "type": "union", "operator": "camel", "children": [
            {"type": "point", "center": [step * i, 0, 0], "radius": radius}
            for i in range(count)]})


def reason(body):
    return json.loads(body)["type"]


# ---- large documents ----

def test_large_bodies_are_answered_as_small_ones():
    text = large(2 << 20)
    with running() as d, contextlib.closing(d.connect()) as c:
        status, body = ask(c, "PUT", "/v1/scenes/a", text)
        assert status == 201, body
        assert ask(c, "PUT", "/v1/scenes/a", text)[0] == 200
        assert ask(c, "PUT", "/v1/scenes/a", text,
                   {"If-None-Match": "*"})[0] == 412
        assert ask(c, "PUT", "/v1/scenes/a", text,
                   {"Content-Type": "text/plain"})[0] == 415
        assert ask(c, "GET", "/v1/scenes/a")[1].decode().strip() == text
        assert ask(c, "POST", "/v1/scenes", text)[0] == 201
        status, body = ask(c, "POST", "/v1/scenes", large(2 << 20, 3000))
        assert status == 422, body
        assert json.loads(body)["errors"][0]["pointer"] == \
            "/root/children/3000/radius", body
        inline = ask(c, "POST", "/v1/eval", '{"points":%s,"scene":%s}'
                     % (json.dumps(POINTS), text))
        kept = ask(c, "POST", "/v1/scenes/a/eval", {"points": POINTS})
        assert inline[0] == kept[0] == 200, (inline, kept)
        assert inline[1] == kept[1]
        status, body = ask(c, "POST", "/v1/eval", '{"points":%s,"scene":%s}'
                           % (json.dumps(POINTS), text[:-1]))
        assert status == 400, body
        ask(c, "PUT", "/v1/scenes/ball", BALL)
        rays = [[0, 0, 5, 0, 0, -1]] * 5000
        status, body = ask(c, "POST", "/v1/scenes/ball/raycast",
                           {"rays": rays})
        assert status == 200 and len(body) > 5000, body[:300]


def test_others_are_answered_while_documents_are_parsed():
    """Both of HTTP's threads would have several of them at a time."""
    puts, text = 12, large(6 << 20).encode()
    with running("--scene-memory", "4G") as d:
        statuses, answered = [], 0

        def put(i):
            statuses.append(d.ask("PUT", "/v1/scenes/s%d" % i, text)[0])

        threads = [threading.Thread(target=put, args=(i,))
                   for i in range(puts)]
        with contextlib.closing(d.connect()) as c:
            for thread in threads:
                thread.start()
            while len(statuses) < puts:
                assert ask(c, "GET", "/healthz")[0] == 200
                answered += 1
        for thread in threads:
            thread.join()
        assert statuses == [201] * puts, statuses
        # 12 to 30 where HTTP's threads parse; 500 and more where not.
        assert answered > 5 * puts, answered
        return "%d answers beside %d documents" % (answered, puts)


def test_hanging_up_and_sigterm_amid_large_ones():
    text = large(4 << 20).encode()
    head = (b"PUT /v1/scenes/x HTTP/1.1\r\nHost: localhost\r\nContent-Type: "
            b"application/json\r\nContent-Length: %d\r\n\r\n" % len(text))
    with running() as d:
        socks = [socket.create_connection(("127.0.0.1", d.port))
                 for _ in range(6)]
        for sock in socks:
            sock.sendall(head + text)
        for sock in socks[:3]:
            sock.close()
        # Finishes what has come.
        assert d.stop() == 0
        for sock in socks[3:]:
            answer = sock.recv(100)
            assert not answer or answer[9:12] in (b"201", b"200",
                                                  b"503"), answer
            sock.close()


def post(path, body):
    return (b"POST /v1/%s HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"
            b"Content-Type: application/json\r\nContent-Length: %d\r\n\r\n"
            % (path, len(body)) + body)


def statuses_of(sock, out):
    """Sends nothing more, and says in out what the answer is."""
    with contextlib.suppress(OSError):
        answer = sock.recv(100)
        while sock.recv(1 << 20):
            pass
    out.append(answer[9:12].decode() or "none")


def test_what_has_come_is_finished_on_sigterm():
    """Also what waits for a thread that reads it."""
    eval_body = ('{"points":%s,"scene":%s}' % (json.dumps(POINTS),
                                              large(2 << 20))).encode()
    rays = json.dumps({"rays": [[0, 0, 5, 0, 0, -1]] * 2000}).encode()
    requests = [post(b"eval", eval_body),
                post(b"scenes/ball/raycast", rays)] * 10
    answers = []
    with running() as d:
        d.ask("PUT", "/v1/scenes/ball", BALL)
        socks = [socket.create_connection(("127.0.0.1", d.port), PATIENCE)
                 for _ in requests]
        threads = [threading.Thread(target=sock.sendall, args=(text,))
                   for sock, text in zip(socks, requests)]
        threads += [threading.Thread(target=statuses_of, args=(sock, answers))
                    for sock in socks]
        for thread in threads:
            thread.start()
        for thread in threads[:len(socks)]:
            thread.join()
        # Whole; who asks is one of them.
        wait_until(lambda: len(answers) + d.metric(
            'blobfield_http_requests_active{state="arrived"}') >
            len(requests))
        before = len(answers)
        assert d.stop() == 0
        for thread in threads:
            thread.join()
        assert answers == ["200"] * len(requests), answers
        return "%d of %d were still to be answered" % (
            len(requests) - before, len(requests))


# ---- work without end ----

def check_log_of_cut(log):
    log.seek(0)
    lines = [json.loads(line) for line in log]
    cut = [line for line in lines if "cut" in line]
    assert [(line["request_id"], line["status"], line["cut"])
            for line in cut] == [("cut-1", 200, True)], cut
    why = [line["message"] for line in lines if line["level"] == "warning"]
    assert len(why) == 1, why
    for word in ("cut-1", "/v1/scenes/slow/grid", " 1 s (--work-time)"):
        assert word in why[0], why


def test_work_time_ends_what_takes_longer():
    volume = {"min": [-3] * 3, "max": [3] * 3, "counts": [190] * 3,
              "outputs": ["value", "gradient", "hessian"]}
    plane = {"center": [0, 0, 0], "normal": [0, 0, 1], "extent": 6,
             "width": 4000, "height": 1900}
    with tempfile.TemporaryFile("w+") as log, \
            running("--work-time", "1", "--log-format", "json", log=log) as d:
        d.ask("PUT", "/v1/scenes/few", camel(12, 0.1, 2))
        d.ask("PUT", "/v1/scenes/slow", camel(100, 0.01, 3))
        for path, body in [
                ("few/render", {"width": 4000, "height": 1900,
                                "samples": 4}),
                ("slow/slice?outputs=hessian", plane),
                ("slow/grid", volume)]:
            headers = NPY if "slice" in path else None
            status, said = d.ask("POST", "/v1/scenes/" + path, body, headers)
            assert status == 422, (path, status, said[:300])
            assert reason(said) == "/problems/work-time", said
            assert b"--work-time" in said, said
        # What has begun to leave is cut, for the client to see it.
        try:
            d.ask("POST", "/v1/scenes/slow/grid", volume,
                  dict(NPY, **{"X-Request-Id": "cut-1"}))
            raise AssertionError("it came whole")
        except http.client.IncompleteRead as e:
            assert e.partial
        # Others are not concerned.
        assert d.ask("POST", "/v1/eval",
                     {"scene": BALL, "points": POINTS})[0] == 200
        wait_until(lambda: d.metric(
            'blobfield_problems_total{reason="work-time"}') == 4)
        for name in ("blobfield_queue_held_bytes",
                     "blobfield_tasks_held_bytes",
                     'blobfield_queue_jobs{state="running"}'):
            wait_until(lambda name=name: d.metric(name) == 0)
        # Nobody has gone.
        assert d.metric("blobfield_jobs_abandoned_total") == 0
        assert d.metric("blobfield_tasks_abandoned_total") == 0
        check_log_of_cut(log)


def test_work_time_of_a_task_is_its_own():
    """Not what it waits for others' evaluations: its turns come seldom."""
    others = 20
    volume = {"min": [-3] * 3, "max": [3] * 3, "counts": [80] * 3}
    with running("--work-time", "1") as d:
        d.ask("PUT", "/v1/scenes/slow", camel(100, 0.01, 3))
        asked = [d.send("/v1/scenes/slow/grid", volume)
                 for _ in range(others)]
        # Some may have had their second before the last has come.
        wait_until(lambda: d.metric(
            'blobfield_queue_jobs{state="running"}') >= others / 2)
        # 0.1 s of the device by itself, 2 s beside them.
        for width in (270, 400, 500):
            with contextlib.closing(d.send("/v1/scenes/slow/slice", {
                    "center": [0, 0, 0], "normal": [0, 0, 1], "extent": 6,
                    "width": width, "height": width})) as c:
                reply = c.getresponse()
                body = reply.read()
            assert reply.status == 200, body[:300]
            timing = dict(re.findall(r"(\w+);dur=([0-9.]+)",
                                     reply.getheader("Server-Timing")))
            if float(timing["work"]) > 1000:
                break
        for connection in asked:
            connection.close()
        assert float(timing["work"]) > 1000, timing
        return "a task of %s ms, %s of the device, with 1 s" % (
            timing["work"], timing["device"])


# ---- one who asks for much ----

@contextlib.contextmanager
def with_tokens(*names):
    """A file of tokens, and a header for each."""
    program = os.environ.get("BLOBFIELDD", "build/blobfieldd")
    folder = tempfile.mkdtemp()
    try:
        headers, entries = [], []
        for name in names:
            out = subprocess.run(
                [program, "--make-token", name + ":write"], check=True,
                capture_output=True, text=True).stdout.split("\n")
            headers.append({"Authorization": "Bearer " + out[0]})
            entries.append(out[1])
        path = os.path.join(folder, "tokens")
        with open(path, "w") as f:
            f.write('{"tokens": [%s]}' % ",".join(entries))
        os.chmod(path, 0o600)
        yield path, headers
    finally:
        shutil.rmtree(folder)


def test_clients_take_turns_with_tasks():
    """One that has 20 waiting keeps another waiting for one of them."""
    path = "/v1/scenes/slow/slice?outputs=hessian"
    plane = {"center": [0, 0, 0], "normal": [0, 0, 1], "extent": 6,
             "width": 1200, "height": 800}
    with with_tokens("many", "few") as (file, (many, few)), \
            running("--tasks", "1", "--tokens", file) as d:
        # /readyz needs no token.
        d.ask("PUT", "/v1/scenes/slow", camel(100, 0.01, 3), many)
        asked = [d.send(path, plane, dict(many, **NPY)) for _ in range(20)]
        wait_until(lambda: d.tasks(few)["waiting"] +
                   d.tasks(few)["completed"] >= 15)
        before = d.tasks(few)["completed"]
        status, _ = d.ask("POST", path, plane, dict(few, **NPY))
        after = d.tasks(few)
        assert status == 200
        # The one that ran, one of theirs, its own, and one since.
        assert after["completed"] - before <= 6, (before, after)
        assert after["waiting"] > 5, after
        for connection in asked:
            connection.close()
        wait_until(lambda: d.tasks(few)["waiting"] == 0)
        return "%d of the other's done meanwhile" % (
            after["completed"] - before - 1)


def test_one_client_does_not_take_all_places():
    path = "/v1/scenes/slow/slice?outputs=hessian"
    plane = {"center": [0, 0, 0], "normal": [0, 0, 1], "extent": 6,
             "width": 4000, "height": 1900}
    with with_tokens("many", "few") as (file, (many, few)), \
            running("--tasks", "1", "--tokens", file) as d:
        d.ask("PUT", "/v1/scenes/slow", camel(100, 0.01, 3), many)
        asked = [d.send(path, plane, dict(many, **NPY))]
        wait_until(lambda: d.tasks(few)["running"] == 1)
        asked += [d.send(path, plane, dict(many, **NPY)) for _ in range(48)]
        wait_until(lambda: d.tasks(few)["waiting"] == 48)
        status, body = d.ask("POST", path, plane, dict(many, **NPY))
        assert status == 503, status
        assert reason(body) == "/problems/queue-full", body
        asked.append(d.send(path, plane, dict(few, **NPY)))
        wait_until(lambda: d.tasks(few)["waiting"] == 49)
        for connection in asked:
            connection.close()
        wait_until(lambda: d.tasks(few)["waiting"] == 0)


def run_case(name, case):
    print("[ RUN      ] " + name, flush=True)
    try:
        figure = case()
    except Exception:
        print(traceback.format_exc())
        print("[  FAILED  ] " + name, flush=True)
        return False
    if figure:
        print("measured: " + figure)
    print("[       OK ] " + name, flush=True)
    return True


def main():
    chosen = sys.argv[1:]
    cases = [(n, c) for n, c in list(globals().items())
             if n.startswith("test_") and (not chosen or n in chosen)]
    results = [run_case(n, c) for n, c in cases]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
