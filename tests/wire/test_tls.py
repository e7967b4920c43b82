#!/usr/bin/python3
"""HTTPS: certificates of a CA of one's own, made here by openssl; what cannot
be used is refused with a reason; what is new comes with SIGHUP.

Starts daemons ($BLOBFIELDD, else build/blobfieldd). Prints its cases as cmocka
does.
"""
import contextlib
import http.client
import json
import os
import re
import signal
import socket
import ssl
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

RELOADS = 12
SCENE = {"format": "blobfield/1", "root": {
    "type": "point", "center": [0, 0, 0], "radius": 2}}
FOLDER = tempfile.TemporaryDirectory()


class Skip(Exception):
    """A case that cannot be run here; the message says why."""


def path(name):
    return os.path.join(FOLDER.name, name)


def openssl(*arguments):
    done = subprocess.run(["openssl", *arguments], capture_output=True,
                          cwd=FOLDER.name, text=True)
    assert done.returncode == 0, done.stderr


def make_ca():
    openssl("req", "-x509", "-newkey", "ec", "-pkeyopt",
            "ec_paramgen_curve:P-256", "-nodes", "-keyout", "ca.key", "-out",
            "ca.pem", "-subj", "/CN=test CA", "-days", "2")


def make_certificate(name, serial, days=1, algorithm="ec"):
    """NAME.key, and NAME.pem of the CA with that serial number."""
    kind = (["rsa:2048"] if algorithm == "rsa" else
            ["ec", "-pkeyopt", "ec_paramgen_curve:P-256"])
    openssl("req", "-newkey", *kind, "-nodes", "-keyout", name + ".key",
            "-out", name + ".csr", "-subj", "/CN=localhost")
    with open(path("extensions"), "w") as f:
        f.write("subjectAltName=DNS:localhost,IP:127.0.0.1\n")
    openssl("x509", "-req", "-in", name + ".csr", "-CA", "ca.pem", "-CAkey",
            "ca.key", "-set_serial", str(serial), "-days", str(days),
            "-extfile", "extensions", "-out", name + ".pem")
    os.chmod(path(name + ".key"), 0o600)


def install(name):
    """As the pair that daemons here are started with."""
    for suffix in (".key", ".pem"):
        with open(path(name + suffix), "rb") as f:
            text = f.read()
        with open(path("new"), "wb") as f:
            os.fchmod(f.fileno(), 0o600)
            f.write(text)
        os.rename(path("new"), path("server" + suffix))


def arguments_for(cert, key):
    program = os.environ.get("BLOBFIELDD", "build/blobfieldd")
    return [program, *CACHE, "--no-measure", "--data", ":memory:", "--listen",
            "127.0.0.1:0", "--log-level", "warning", "--no-measure",
            "--tls-cert", path(cert), "--tls-key", path(key)]


class Daemon:
    """A daemon on a free port, with HTTPS, ready if need be."""

    def __init__(self, cert="server.pem", key="server.key", more=(),
                 is_ready=False):
        self.log = open(path("log"), "w+")
        self.process = subprocess.Popen(
            arguments_for(cert, key) + list(more), stdout=subprocess.PIPE,
            stderr=self.log, stdin=subprocess.DEVNULL, text=True)
        self.line = self.process.stdout.readline()
        assert "https://127.0.0.1:" in self.line, (self.line, self.said())
        self.port = int(re.search(r":(\d+)$", self.line.strip()).group(1))
        while is_ready and self.ask("GET", "/readyz")[0] != 200:
            time.sleep(0.1)

    def said(self):
        self.log.seek(0)
        return self.log.read()

    def connect(self, context=None):
        sock = socket.create_connection(("127.0.0.1", self.port), 60)
        return (context or trusting()).wrap_socket(
            sock, server_hostname="localhost")

    def raw(self):
        return socket.create_connection(("127.0.0.1", self.port), 60)

    def open(self):
        """A connection that is kept."""
        return http.client.HTTPSConnection("127.0.0.1", self.port,
                                           context=trusting(), timeout=120)

    def ask(self, method, target, value=None, kept=None):
        connection = kept or self.open()
        body = None if value is None else json.dumps(value).encode()
        connection.request(method, target, body,
                           {"Content-Type": "application/json"})
        answer = connection.getresponse()
        data = answer.read()
        if kept is None:
            connection.close()
        return answer.status, data

    def fds(self):
        return len(os.listdir("/proc/%d/fd" % self.process.pid))

    def stop(self):
        self.process.terminate()
        self.process.stdout.close()
        status = self.process.wait(120)
        assert status == 0, (status, self.said())
        self.log.close()


def trusting():
    """Only certificates of the CA here."""
    return ssl.create_default_context(cafile=path("ca.pem"))


def serial_of(sock):
    return int(sock.getpeercert()["serialNumber"], 16)


def fails_to_start(cert, key, says, more=()):
    done = subprocess.run(arguments_for(cert, key) + list(more),
                          capture_output=True, text=True, timeout=60)
    assert done.returncode != 0
    assert re.search(says, done.stderr), (says, done.stderr)


# --- cases -------------------------------------------------------------------


def test_old_versions_and_ciphers_are_refused():
    daemon = Daemon()
    try:
        for version in ("TLSv1_2", "TLSv1_3"):
            context = trusting()
            context.minimum_version = context.maximum_version = \
                ssl.TLSVersion[version]
            with daemon.connect(context) as sock:
                assert sock.version() == version.replace("_", ".")
                assert "GCM" in sock.cipher()[0] or \
                    "CHACHA" in sock.cipher()[0], sock.cipher()
        # Python's own OpenSSL would not say TLS 1.0 either without this.
        for options in (["-tls1"], ["-tls1_1"],
                        ["-tls1_2", "-cipher", "AES128-SHA"],
                        ["-tls1_2", "-cipher", "AES256-GCM-SHA384"],
                        ["-tls1_2", "-cipher", "ECDHE-ECDSA-AES128-SHA"]):
            if "-cipher" in options:
                options[-1] += ":@SECLEVEL=0"
            else:
                options += ["-cipher", "ALL:@SECLEVEL=0"]
            done = subprocess.run(
                ["openssl", "s_client", *options, "-connect",
                 "127.0.0.1:%d" % daemon.port], capture_output=True,
                stdin=subprocess.DEVNULL, text=True, timeout=30)
            assert done.returncode != 0 or "Cipher is (NONE)" in done.stdout, \
                (options, done.stdout)
    finally:
        daemon.stop()


def test_evaluations_and_large_answers():
    """By Python and by curl; the answer is the same as without TLS."""
    daemon = Daemon(is_ready=True)
    points = [0.001 * (i % 2000) for i in range(3 * 200000)]
    value = {"scene": SCENE, "points": points, "outputs": [
        "value", "gradient", "hessian"]}
    try:
        status, data = daemon.ask("POST", "/v1/eval", value)
        rows = json.loads(data)
        assert status == 200 and len(data) > 20 << 20, (status, len(data))
        assert len(rows["value"]) == 200000
        with open(path("body"), "w") as f:
            json.dump(value, f)
        done = subprocess.run(
            ["curl", "-sS", "--cacert", path("ca.pem"), "--json",
             "@" + path("body"), "https://127.0.0.1:%d/v1/eval" %
             daemon.port], capture_output=True, timeout=120)
        assert done.returncode == 0 and done.stdout == data, \
            (done.stderr, len(done.stdout), len(data))
        # Many on one connection, small ones among them.
        kept = daemon.open()
        for i in range(20):
            status, data = daemon.ask("POST", "/v1/eval", {
                "scene": SCENE, "points": points[:3 * 5 ** (i % 8)]}, kept)
            assert status == 200
        kept.close()
    finally:
        daemon.stop()


def test_refusals_amid_a_body_are_read():
    """They are sent past libmicrohttpd: through the session."""
    daemon = Daemon(more=("--max-body", "64k"))
    try:
        with daemon.connect() as sock:
            sock.sendall(b"POST /v1/eval HTTP/1.1\r\nHost: localhost\r\nContent-Type: "
                         b"application/json\r\nTransfer-Encoding: chunked\r\n"
                         b"\r\n" + (b"4000\r\n" + b" " * 0x4000 + b"\r\n") * 6)
            answer = b""
            while data := sock.recv(65536):
                answer += data
        assert answer.startswith(b"HTTP/1.1 413 "), answer[:100]
        assert b"65536 bytes" in answer and answer.endswith(b"}"), answer
    finally:
        daemon.stop()


def test_those_who_hang_up_are_noticed():
    """Behind a good-bye, too, which nobody reads while they wait."""
    daemon = Daemon(is_ready=True)
    try:
        daemon.ask("PUT", "/v1/scenes/a", SCENE)
        before = daemon.fds()
        body = json.dumps({"resolution": 512}).encode()
        begin = time.monotonic()
        for polite in (True, False, True, False):
            sock = daemon.connect()
            sock.sendall(b"POST /v1/scenes/a/mesh?format=obj HTTP/1.1\r\n"
                         b"Host: localhost\r\nContent-Type: application/json\r\n"
                         b"Content-Length: %d\r\n\r\n" % len(body) + body)
            time.sleep(0.05)
            if polite:
                with contextlib.suppress(OSError, ValueError):
                    sock.settimeout(0.05)
                    sock.unwrap()
            sock.close()
        # Uploads, of which the end of the stream is all there is to see.
        for _ in range(20):
            sock = daemon.connect()
            sock.sendall(b"POST /v1/eval HTTP/1.1\r\nHost: localhost\r\nContent-Type: "
                         b"application/json\r\nContent-Length: 9999\r\n\r\n{")
            sock.close()
        while daemon.fds() > before and time.monotonic() - begin < 50:
            time.sleep(0.1)
        seconds = time.monotonic() - begin
        assert daemon.fds() <= before
        print("measured: 24 that hung up were noticed after %.1f s" % seconds)
        assert daemon.ask("GET", "/healthz")[0] == 200
    finally:
        daemon.stop()


def test_handshakes_have_a_deadline():
    daemon = Daemon(more=("--request-time", "2"))
    try:
        begin = time.monotonic()
        silent = [daemon.raw() for _ in range(50)]
        for i, sock in enumerate(silent):
            if i % 2:
                sock.sendall(b"\x16\x03\x01\x02\x00\x01")
        for sock in silent:
            sock.settimeout(50)
            with contextlib.suppress(ConnectionError):
                assert sock.recv(1) == b""
            sock.close()
        seconds = time.monotonic() - begin
        # Else it would be the library's minute.
        assert 1.5 < seconds < 45, seconds
    finally:
        daemon.stop()


def test_plain_http_and_garbage_at_the_port():
    daemon = Daemon()
    try:
        for text in (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
                     b"\x16\x03\x01\x00\x05hello", b"\0" * 3000,
                     b"\x16\x03\x01\xff\xff" + bytes(70000),
                     b"\x80\x2e\x01\x00\x02" + bytes(50)):
            with daemon.raw() as sock:
                answer = b""
                with contextlib.suppress(OSError):
                    sock.sendall(text)
                    sock.shutdown(socket.SHUT_WR)
                    sock.settimeout(20)
                    while data := sock.recv(4096):
                        answer += data
            # An alert at most.
            assert len(answer) < 100 and b"HTTP" not in answer, answer
        assert daemon.ask("GET", "/healthz")[0] == 200
    finally:
        daemon.stop()


def test_answers_that_leave_as_they_are_made():
    """A mesh's progress, line by line, while the mesh is being made; and a
    scene's events, where there are any."""
    daemon = Daemon(is_ready=True)
    try:
        daemon.ask("PUT", "/v1/scenes/a", SCENE)
        sock = daemon.connect()
        sock.sendall(b"GET /v1/scenes/a/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        sock.settimeout(60)
        first = sock.recv(4096)
        if not first.startswith(b"HTTP/1.1 200"):
            raise Skip("there are no events: %s" % first[:30])
        text = first
        while b"event: revision" not in text:
            text += sock.recv(4096)
        changed = dict(SCENE, name="changed")
        daemon.ask("PUT", "/v1/scenes/a", changed)
        while text.count(b"event: revision") < 2:
            text += sock.recv(4096)
        sock.close()
    finally:
        daemon.stop()


def test_reloading_under_load():
    """Each handshake sees the old certificate or the new one, nobody is
    refused, and connections that stand go on."""
    install("first")
    daemon = Daemon(is_ready=True)
    stop = threading.Event()
    seen, failures, asked = set(), [], [0]

    def shake():
        while not stop.is_set():
            try:
                with daemon.connect() as sock:
                    seen.add(serial_of(sock))
                    sock.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
                                 b"Connection: close\r\n\r\n")
                    assert sock.recv(4096).startswith(b"HTTP/1.1 200")
                asked[0] += 1
            except Exception:
                failures.append(traceback.format_exc())
                return

    kept = daemon.open()
    assert daemon.ask("GET", "/healthz", kept=kept)[0] == 200
    threads = [threading.Thread(target=shake) for _ in range(6)]
    for thread in threads:
        thread.start()
    try:
        for i in range(RELOADS):
            install(("second", "first", "rsa")[i % 3])
            daemon.process.send_signal(signal.SIGHUP)
            expected = (2, 1, 3)[i % 3]
            for _ in range(1200):
                with daemon.connect() as sock:
                    if serial_of(sock) == expected:
                        break
                time.sleep(0.05)
            else:
                raise AssertionError("the new certificate is not seen")
            assert daemon.ask("GET", "/healthz", kept=kept)[0] == 200
    finally:
        stop.set()
        for thread in threads:
            thread.join()
        kept.close()
        said = daemon.said()
        daemon.stop()
        install("first")
    assert not failures, failures[0]
    assert seen == {1, 2, 3}, seen
    assert "error" not in said, said
    print("measured: %d reloads beside %d handshakes, none of which failed" %
          (RELOADS, asked[0]))


def test_what_is_wrong_on_reloading_changes_nothing():
    install("first")
    daemon = Daemon()
    try:
        os.rename(path("server.pem"), path("away"))
        daemon.process.send_signal(signal.SIGHUP)
        wait_for(lambda: "stays as it was" in daemon.said())
        assert "server.pem: cannot be read" in daemon.said(), daemon.said()
        with daemon.connect() as sock:
            assert serial_of(sock) == 1
        os.rename(path("away"), path("server.pem"))
    finally:
        daemon.stop()


def wait_for(condition):
    for _ in range(1200):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("it does not come")


def test_files_that_cannot_be_used():
    with open(path("empty"), "w"):
        pass
    with open(path("words"), "w") as f:
        f.write("-----BEGIN NONSENSE-----\nAAAA\n-----END NONSENSE-----\n")
    openssl("ec", "-in", "first.key", "-aes128", "-passout", "pass:secret",
            "-out", "locked.key")
    with open(path("unsorted.pem"), "w") as out:
        for name in ("ca.pem", "first.pem"):
            with open(path(name)) as f:
                out.write(f.read())
    fails_to_start("nowhere.pem", "first.key",
                   "nowhere.pem: cannot be read: No such file")
    fails_to_start("first.pem", "nowhere.key",
                   "nowhere.key: cannot be read: No such file")
    fails_to_start("empty", "first.key", "empty: there is no certificate")
    fails_to_start("words", "first.key", "words: there is no certificate")
    fails_to_start("first.key", "first.key",
                   "first.key: there is no certificate")
    fails_to_start("first.pem", "first.pem",
                   "first.pem: there is no private key")
    fails_to_start("first.pem", "empty", "empty: there is no private key")
    fails_to_start("first.pem", "locked.key", "locked.key: .*password")
    fails_to_start("unsorted.pem", "ca.key", "vouched for by the next")
    fails_to_start("first.pem", "second.key", "do not belong together")


def test_one_flag_needs_the_other():
    program = os.environ.get("BLOBFIELDD", "build/blobfieldd")
    for flag, name in (("--tls-cert", "first.pem"), ("--tls-key",
                                                     "first.key")):
        done = subprocess.run(
            [program, *CACHE, "--no-measure", "--data", ":memory:", "--listen",
             "127.0.0.1:0", flag, path(name)], capture_output=True, text=True,
            timeout=60)
        assert done.returncode != 0 and "needs both" in done.stderr, done.stderr


def test_keys_that_others_may_read_are_warned_of():
    os.chmod(path("second.key"), 0o644)
    daemon = Daemon("second.pem", "second.key")
    os.chmod(path("second.key"), 0o600)
    said = daemon.said()
    daemon.stop()
    assert re.search(r"warning: .*second.key: .*chmod", said), said


def test_chains_are_sent_whole():
    """An intermediate one that clients do not know."""
    with open(path("extensions"), "w") as f:
        f.write("basicConstraints=critical,CA:true\n")
    openssl("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256",
            "-nodes", "-keyout", "middle.key", "-out", "middle.csr", "-subj",
            "/CN=middle")
    openssl("x509", "-req", "-in", "middle.csr", "-CA", "ca.pem", "-CAkey",
            "ca.key", "-set_serial", "7", "-days", "1", "-extfile",
            "extensions", "-out", "middle.pem")
    with open(path("extensions"), "w") as f:
        f.write("subjectAltName=DNS:localhost\n")
    openssl("x509", "-req", "-in", "first.csr", "-CA", "middle.pem", "-CAkey",
            "middle.key", "-set_serial", "8", "-days", "1", "-extfile",
            "extensions", "-out", "leaf.pem")
    with open(path("chain.pem"), "w") as out:
        for name in ("leaf.pem", "middle.pem"):
            with open(path(name)) as f:
                out.write(f.read())
    daemon = Daemon("chain.pem", "first.key")
    try:
        with daemon.connect() as sock:
            assert serial_of(sock) == 8
    finally:
        daemon.stop()


# --- running -----------------------------------------------------------------


def run_case(case):
    name = case.__name__
    print("[ RUN      ] " + name, flush=True)
    begin = time.monotonic()
    try:
        case()
    except Skip as why:
        print("skipped: %s" % why)
        print("[  SKIPPED ] " + name)
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
    make_ca()
    make_certificate("first", 1)
    make_certificate("second", 2)
    make_certificate("rsa", 3, algorithm="rsa")
    install("first")
    fine = True
    for name, case in list(globals().items()):
        if name.startswith("test_") and (not sys.argv[1:] or
                                         name in sys.argv[1:]):
            fine &= run_case(case)
    FOLDER.cleanup()
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
