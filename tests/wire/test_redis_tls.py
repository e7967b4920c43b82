#!/usr/bin/python3
"""A store in Redis that is reached by TLS: certificates of a CA of one's own, made
here by openssl; those that are not to be trusted, and what becomes of it.

Starts redis-server and daemons ($BLOBFIELDD, else build/blobfieldd). Prints its
cases as cmocka does.
"""
import ctypes
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
import time
import traceback

# The tables that tests/run.sh has built for all, or none.
CACHE = (["--cache", os.environ["BLOBFIELD_TEST_CACHE"],
          "--cache-read-only"] if "BLOBFIELD_TEST_CACHE" in os.environ
         else ["--no-cache"])

PATIENCE = 60.0
JSON = {"Content-Type": "application/json"}


class Skip(Exception):
    """A case that cannot be run here; the message says why."""


def await_true(question, what="it"):
    end = time.monotonic() + PATIENCE
    while not question():
        assert time.monotonic() < end, "%s does not come" % what
        time.sleep(0.02)


def end_with_parent():
    """Of a child process: a test that fails leaves none behind."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as sock:
        return sock.getsockname()[1]


def program():
    return os.environ.get("BLOBFIELDD", "build/blobfieldd")


class Place:
    """Certificates, and a Redis that has one of them."""

    def __init__(self):
        self.folder = tempfile.mkdtemp()
        self.port = free_port()
        self.redis = None
        self.make_ca("ca")
        self.make_ca("other")
        self.make("good", "ca", "DNS:localhost,IP:127.0.0.1")
        self.make("foreign", "other", "DNS:localhost,IP:127.0.0.1")
        self.make("elsewhere", "ca", "DNS:redis.example")
        self.make("old", "ca", "DNS:localhost,IP:127.0.0.1", days=0)
        self.make("client", "ca", "DNS:client")

    def path(self, name):
        return os.path.join(self.folder, name)

    def openssl(self, *words):
        done = subprocess.run(["openssl", *words], capture_output=True,
                              cwd=self.folder, text=True)
        assert done.returncode == 0, done.stderr

    def make_ca(self, name):
        self.openssl("req", "-x509", "-newkey", "ec", "-pkeyopt",
                     "ec_paramgen_curve:P-256", "-nodes", "-keyout",
                     name + ".key", "-out", name + ".pem", "-subj",
                     "/CN=" + name, "-days", "2")

    def make(self, name, ca, names, days=1):
        self.openssl("req", "-newkey", "ec", "-pkeyopt",
                     "ec_paramgen_curve:P-256", "-nodes", "-keyout",
                     name + ".key", "-out", name + ".csr", "-subj", "/CN=x")
        with open(self.path("extensions"), "w") as f:
            f.write("subjectAltName=%s\n" % names)
        self.openssl("x509", "-req", "-in", name + ".csr", "-CA",
                     ca + ".pem", "-CAkey", ca + ".key", "-CAcreateserial",
                     "-days", str(days), "-extfile", "extensions", "-out",
                     name + ".pem")

    def run_redis(self, certificate, *more):
        """Anew, with what it has kept."""
        self.stop_redis()
        words = ["redis-server", "server/deploy/redis.conf", "--dir",
                 self.folder, "--unixsocket", self.path("socket"), "--port",
                 "0", "--tls-port", str(self.port), "--tls-cert-file",
                 self.path(certificate + ".pem"), "--tls-key-file",
                 self.path(certificate + ".key"), "--tls-ca-cert-file",
                 self.path("ca.pem"), "--tls-auth-clients", "no", *more]
        with open(self.path("redis.log"), "a") as log:
            self.redis = subprocess.Popen(words, stdout=log, stderr=log,
                                          preexec_fn=end_with_parent)
        await_true(lambda: "PONG" in self.cli("ping"), "redis-server")

    def cli(self, *words):
        return subprocess.run(["redis-cli", "-s", self.path("socket"), *words],
                              capture_output=True, text=True).stdout

    def stop_redis(self):
        if self.redis is not None:
            self.redis.kill()
            self.redis.wait()

    def url(self, query="ca=ca.pem", host="127.0.0.1", scheme="rediss"):
        for name in ("ca", "cert", "key"):
            query = query.replace(name + "=", name + "=" + self.path(""))
        return "%s://%s:%d?%s" % (scheme, host, self.port, query)

    def end(self):
        self.stop_redis()
        shutil.rmtree(self.folder)


class Daemon:
    """One with that store. Its cache is shared: kernels are compiled once."""

    def __init__(self, place, url):
        self.log = open(place.path("daemon.log"), "w+")
        self.process = subprocess.Popen(
            [program(), "--cache", place.path("cache"), "--no-measure",
             "--log-level", "info", "--listen", "127.0.0.1:0", "--store",
             url], stdout=subprocess.PIPE, stderr=self.log, text=True,
            preexec_fn=end_with_parent)
        line = self.process.stdout.readline().strip()
        assert line, self.said()
        self.port = int(re.search(r":(\d+)$", line).group(1))

    def __enter__(self):
        return self

    def __exit__(self, *failure):
        if failure[0] is not None:
            print(self.said()[-2000:])
        self.process.terminate()
        status = self.process.wait(PATIENCE)
        self.process.stdout.close()
        self.log.close()
        assert failure[0] is not None or status == 0, status

    def said(self):
        self.log.seek(0)
        return self.log.read()

    def ask(self, method, path, body=None, headers=JSON):
        connection = http.client.HTTPConnection("127.0.0.1", self.port,
                                                timeout=PATIENCE)
        connection.request(method, path, body, headers)
        reply = connection.getresponse()
        data = reply.read()
        connection.close()
        return reply.status, data

    def await_ready(self):
        """Not for the device, which is not asked for here."""
        await_true(lambda: self.ask("GET", "/v1/scenes/none")[0] == 404,
                   "ready")

    def put(self, name, radius=1.0, more=""):
        return self.ask("PUT", "/v1/scenes/" + name, json.dumps(
            {"format": "blobfield/1", "name": more, "root": {
                "type": "point", "center": [0, 0, 0], "radius": radius}}))[0]

    def await_said(self, *words):
        """A line of the log with all of them."""
        await_true(lambda: any(all(w in line for w in words)
                               for line in self.said().split("\n")),
                   " ".join(words))


def test_redis_by_tls(place):
    """Kept, told to another daemon, there after a restart; by name as well."""
    place.run_redis("good")
    with Daemon(place, place.url()) as a:
        a.await_ready()
        with Daemon(place, place.url(host="localhost")) as b:
            b.await_ready()
            assert a.put("s") == 201
            await_true(lambda: b.ask("GET", "/v1/scenes/s")[0] == 200)
            for i in range(200):
                assert b.put("s", 2.0 + i) == 200
            await_true(lambda: b'201' in a.ask("GET", "/v1/scenes/s")[1])
    with Daemon(place, place.url()) as a:
        a.await_ready()
        assert b'201' in a.ask("GET", "/v1/scenes/s")[1]
        assert "cannot" not in a.said(), a.said()


def test_redis_large_things_by_tls(place):
    """Of many records, both ways."""
    place.run_redis("good")
    text = json.dumps({"format": "blobfield/1", "root": {
        "type": "point", "center": [0, 0, 0], "radius": 1}})
    text += " " * 3000000
    with Daemon(place, place.url()) as a:
        a.await_ready()
        status, said = a.ask("PUT", "/v1/scenes/large", text)
        assert status == 201, said[:300]
    with Daemon(place, place.url()) as a:
        a.await_ready()
        status, said = a.ask("GET", "/v1/scenes/large")
        assert status == 200 and said == text.encode()
        assert a.ask("DELETE", "/v1/scenes/large")[0] == 204


def test_redis_that_hangs_up_is_asked_anew(place):
    """A connection that was idle and was closed costs no change."""
    place.run_redis("good")
    with Daemon(place, place.url()) as a:
        a.await_ready()
        assert a.put("idle") in (200, 201)
        for i in range(10):
            place.cli("client", "kill", "type", "normal", "skipme", "yes")
            status = a.put("idle", 2.0 + i)
            # The moment in which it is known to be away is not asked for here.
            if status == 503:
                await_true(lambda: a.put("idle", 2.0 + i) == 200)
            else:
                assert status == 200, status


def refused(place, url, *words):
    """A daemon to which Redis is away, and which says why."""
    with Daemon(place, url) as a:
        a.await_said("its scenes cannot be read yet")
        a.await_said("redis 127.0.0.1:%d: " % place.port, *words)
        assert a.ask("GET", "/healthz")[0] == 200
        assert a.ask("GET", "/v1/scenes/none")[0] == 503
        assert a.put("refused") == 503
        # Said now and then, not with each attempt.
        time.sleep(0.5)
        count = a.said().count("redis 127.0.0.1:%d: " % place.port)
        assert count <= 3, a.said()


def test_redis_of_another_authority_is_refused(place):
    place.run_redis("foreign")
    refused(place, place.url(), "NOT trusted", "issuer is unknown")


def test_redis_not_of_the_system_is_refused(place):
    """Without ca=, the system's certificates are what counts."""
    place.run_redis("good")
    if not os.path.exists("/etc/ssl/certs/ca-certificates.crt"):
        raise Skip("the system has no certificates")
    refused(place, place.url(""), "NOT trusted")


def test_redis_of_another_name_is_refused(place):
    place.run_redis("elsewhere")
    refused(place, place.url(), "name in the certificate does not match")


def test_redis_with_an_old_certificate_is_refused(place):
    place.run_redis("old")
    refused(place, place.url(), "expired")


def test_redis_without_tls_is_not_spoken_to(place):
    """Nor is one with it by redis://."""
    place.run_redis("good", "--tls-port", "0", "--port", str(place.port))
    refused(place, place.url(), "TLS:", "(does it speak TLS?)")
    place.run_redis("good")
    refused(place, place.url("", scheme="redis"))


def test_redis_that_wants_a_certificate(place):
    place.run_redis("good", "--tls-auth-clients", "yes")
    refused(place, place.url(), "ertificate")
    with Daemon(place, place.url(
            "ca=ca.pem&cert=client.pem&key=client.key")) as a:
        a.await_ready()
        assert a.put("known") == 201


def test_redis_that_is_exchanged_counts_as_away(place):
    """Reads go on; no change goes to the wrong one; all is well by itself."""
    place.run_redis("good")
    with Daemon(place, place.url()) as a:
        a.await_ready()
        assert a.put("kept") in (200, 201)
        place.run_redis("foreign")
        a.await_said("scenes cannot be changed")
        a.await_said("redis 127.0.0.1:%d: TLS:" % place.port, "NOT trusted")
        assert a.put("kept", 5.0) == 503
        assert a.ask("GET", "/v1/scenes/kept")[0] == 200
        place.run_redis("good")
        await_true(lambda: a.put("kept", 7.0) == 200, "Redis")


def test_redis_files_that_cannot_be_used_are_told_at_the_start(place):
    with open(place.path("empty.pem"), "w"):
        pass
    for query, word in (("ca=none.pem", "none.pem"),
                        ("ca=empty.pem", "empty.pem"),
                        ("ca=ca.pem&cert=good.pem&key=client.key", "cert"),
                        ("ca=ca.pem&cert=none.pem&key=client.key", "cert")):
        done = subprocess.run(
            [program(), *CACHE, "--no-measure", "--listen", "127.0.0.1:0", "--store",
             place.url(query)], capture_output=True, text=True,
            timeout=PATIENCE)
        assert done.returncode != 0, query
        assert "--store" in done.stderr and word in done.stderr, done.stderr


def run_case(case, place):
    name = case.__name__
    print("[ RUN      ] " + name, flush=True)
    begin = time.monotonic()
    try:
        case(place)
    except Skip as skip:
        print("skipped: %s" % skip)
        print("[  SKIPPED ] " + name, flush=True)
        return True
    except Exception:
        print(traceback.format_exc())
        print("[  FAILED  ] " + name, flush=True)
        return False
    if os.environ.get("TLS_TIMES"):
        print("  %.1f s" % (time.monotonic() - begin))
    print("[       OK ] " + name, flush=True)
    return True


def main():
    if not all(shutil.which(p) for p in ("redis-server", "redis-cli",
                                         "openssl")):
        print("skipped: there is no redis-server, or no openssl")
        return 0
    place = Place()
    try:
        fine = True
        for name, case in list(globals().items()):
            if name.startswith("test_") and (not sys.argv[1:] or
                                             name in sys.argv[1:]):
                fine &= run_case(case, place)
    finally:
        place.end()
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
