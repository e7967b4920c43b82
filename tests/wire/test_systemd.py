#!/usr/bin/python3
"""The daemon under a service manager, which this plays: readiness, reloading,
watchdog, stopping by sd_notify's protocol, a socket that is passed; what
make install leaves, and whether units and manuals are right.

Starts the daemon ($BLOBFIELDD, else build/blobfieldd). Prints its cases as
cmocka does.
"""
import json
import os
import pty
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import traceback
import urllib.error
import urllib.request

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(
    os.path.abspath(__file__))))
DAEMON = os.path.abspath(os.environ.get("BLOBFIELDD") or
                         os.path.join(ROOT, "build/blobfieldd"))
BUILD = os.path.dirname(DAEMON)
# Seconds until anything must have happened; a cold device takes longest.
PATIENCE = 120
DELAY = 5
# What one daemon keeps is the next one's quick start.
CACHE = tempfile.mkdtemp()
EVAL = {"scene": {"format": "blobfield/1",
                  "root": {"type": "point", "center": [0, 0, 0], "radius": 1}},
        "points": [[1, 0, 0]]}


class Skip(Exception):
    """A case that cannot be run here; the message says why."""


class Daemon:
    """A daemon, and the service manager's end of its socket."""

    def __init__(self, folder, *arguments, listeners=(), watchdog=None,
                 stdin=subprocess.DEVNULL):
        self.path = os.path.join(folder, "notify")
        if os.path.exists(self.path):
            os.remove(self.path)
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.path)
        self.heard = []
        env = {name: value for name, value in os.environ.items()
               if not name.startswith("BLOBFIELDD_")}
        env.update(NOTIFY_SOCKET=self.path)
        if watchdog:
            env.update(WATCHDOG_USEC=str(int(watchdog * 1e6)))
        shell = 'WATCHDOG_PID=$$; export WATCHDOG_PID; '
        if listeners:
            # They are to be descriptors 3, 4 ...; what is here may be so, too.
            env.update(LISTEN_FDS=str(len(listeners)))
            shell += "LISTEN_PID=$$; export LISTEN_PID; "
        self.process = subprocess.Popen(
            ["sh", "-c", shell + 'exec "$@"', "sh", DAEMON, "--cache", CACHE,
             "--data", ":memory:", "--no-measure", "--quiet", *arguments],
            env=env, stdin=stdin, stdout=subprocess.PIPE, text=True,
            stderr=subprocess.PIPE,
            close_fds=not listeners, preexec_fn=lambda: pass_on(listeners))
        self.url = None

    def start(self):
        line = self.process.stdout.readline()
        assert line.startswith("blobfieldd listening on http"), \
            (line, self.process.stderr.read())
        self.url = line.split()[-1]
        return self

    def hear(self, wanted, patience=PATIENCE):
        """Waits for the message that has wanted, which it returns; what comes
        before it is in heard."""
        self.socket.settimeout(patience)
        while True:
            message = self.socket.recv(4096).decode()
            self.heard.append(message)
            if wanted in message.split("\n") or wanted in message:
                return message

    def silence(self, seconds):
        """What is heard within so many seconds."""
        end = time.monotonic() + seconds
        heard = []
        while time.monotonic() < end:
            self.socket.settimeout(max(0.01, end - time.monotonic()))
            try:
                heard.append(self.socket.recv(4096).decode())
            except socket.timeout:
                break
        return heard

    def ask(self, path, body=None):
        """The status of a request over a connection of its own."""
        request = urllib.request.Request(
            self.url + path, None if body is None else
            json.dumps(body).encode(), {"Content-Type": "application/json"})
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        try:
            with opener.open(request, timeout=PATIENCE) as reply:
                return reply.status
        except urllib.error.HTTPError as error:
            return error.code

    def end(self, signal_number=signal.SIGTERM):
        self.process.send_signal(signal_number)
        return self.wait()

    def wait(self):
        status = self.process.wait(PATIENCE)
        self.close()
        return status

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()
        self.process.stderr.close()
        self.socket.close()


def pass_on(listeners):
    """In the child: makes sockets descriptors from 3 on."""
    held = [os.dup(listener.fileno()) for listener in listeners]
    held = [os.dup2(fd, 100 + i) for i, fd in enumerate(held)]
    for i, fd in enumerate(held):
        os.dup2(fd, 3 + i)
        os.close(fd)


def listening():
    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    listener.listen(16)
    return listener


def test_it_is_ready_when_it_answers(folder):
    d = Daemon(folder, "--listen", "127.0.0.1:0").start()
    try:
        d.hear("READY=1")
        d.hear("STATUS=serving")
        assert d.ask("/readyz") == 200
        assert d.ask("/v1/eval", EVAL) == 200
        # Nobody asks for signs of life.
        assert not any("WATCHDOG" in m for m in d.silence(2.5))
        assert d.end() == 0
    finally:
        d.close()


def test_a_reload_is_told_and_changes_nothing(folder):
    d = Daemon(folder, "--listen", "127.0.0.1:0", watchdog=20).start()
    try:
        d.hear("READY=1")
        d.process.send_signal(signal.SIGHUP)
        message = d.hear("RELOADING=1")
        begun = int(re.search(r"MONOTONIC_USEC=(\d+)", message).group(1))
        assert abs(begun / 1e6 - time.monotonic()) < PATIENCE, begun
        d.hear("READY=1")
        assert d.ask("/v1/eval", EVAL) == 200
        d.hear("WATCHDOG=1", 10)
        d.hear("WATCHDOG=1", 10)
        assert d.end() == 0
    finally:
        d.close()


def test_readiness_goes_first_then_connections_then_it_ends(folder):
    conf = os.path.join(folder, "conf")
    with open(conf, "w", encoding="utf-8") as file:
        file.write("listen = 127.0.0.1:0\ndrain-delay = %d  # s\n" % DELAY)
    d = Daemon(folder, "--config", conf).start()
    try:
        d.hear("READY=1")
        begin = time.monotonic()
        d.process.send_signal(signal.SIGTERM)
        d.hear("STOPPING=1")
        patience = d.hear("EXTEND_TIMEOUT_USEC=")
        assert int(patience.split("=")[1]) >= (DELAY + 60) * 1000000
        # These connections are new.
        assert d.ask("/readyz") == 503
        assert d.ask("/healthz") == 200
        assert d.ask("/v1/eval", EVAL) == 200
        assert time.monotonic() - begin < DELAY, "this machine is too slow"
        assert d.wait() == 0
        assert DELAY <= time.monotonic() - begin < DELAY + 30
    finally:
        d.close()


def test_a_second_signal_ends_the_delay(folder):
    d = Daemon(folder, "--listen", "127.0.0.1:0", "--drain-delay=600").start()
    try:
        d.hear("READY=1")
        d.process.send_signal(signal.SIGTERM)
        d.hear("STOPPING=1")
        time.sleep(1.5)
        while d.process.poll() is None:  # it may have begun to wait later
            d.process.send_signal(signal.SIGTERM)
            time.sleep(0.1)
        assert d.process.returncode == 0
    finally:
        d.close()


def test_a_socket_that_is_passed_is_served(folder):
    listener = listening()
    address = listener.getsockname()
    # One that waits since before the daemon was there.
    early = socket.create_connection(address)
    early.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
    d = Daemon(folder, "--listen", "127.0.0.1:1", listeners=[listener]).start()
    try:
        assert d.url == "http://127.0.0.1:%d" % address[1], d.url
        early.settimeout(PATIENCE)
        assert early.recv(12) == b"HTTP/1.1 200"
        d.hear("READY=1")
        assert d.ask("/v1/eval", EVAL) == 200
        assert d.end() == 0
        # It stays the manager's: who connects now waits for the next daemon.
        socket.create_connection(address, 5).close()
    finally:
        early.close()
        listener.close()
        d.close()


def test_tokens_may_come_as_a_credential(folder):
    """As LoadCredential=tokens:FILE gives them: a folder and a file that nobody
    may write, in $CREDENTIALS_DIRECTORY."""
    out = subprocess.run([DAEMON, "--make-token", "me:admin"],
                         capture_output=True, text=True, check=True)
    entry = json.loads(out.stdout.split("\n")[1])
    credentials = os.path.join(folder, "credentials")
    os.mkdir(credentials)
    path = os.path.join(credentials, "tokens")
    with open(path, "w") as f:
        json.dump({"tokens": [entry]}, f)
    # With ACLs systemd has them be root's, 0440; without, the service's, 0400.
    for mode in (0o440, 0o400):
        os.chmod(path, mode)
        os.chmod(credentials, 0o500)
        d = Daemon(folder, "--listen", "127.0.0.1:0", "--tokens", path,
                   "--log-level", "info").start()
        try:
            d.hear("READY=1")
            assert d.ask("/v1/info") == 401
            d.process.send_signal(signal.SIGHUP)
            d.hear("RELOADING=1")
            d.hear("READY=1")
            assert d.ask("/v1/info") == 401
            d.process.terminate()
            said = d.process.stderr.read()
            assert "others may" not in said, said
            assert "tokens: 1 of them" in said, said
            assert d.wait() == 0
        finally:
            d.close()
            os.chmod(credentials, 0o700)


def test_other_sockets_are_refused(folder):
    datagrams = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    datagrams.bind(("127.0.0.1", 0))
    one, two = listening(), listening()
    try:
        for listeners in ([one, two], [datagrams]):
            d = Daemon(folder, listeners=listeners)
            said = d.process.stderr.read()
            assert d.wait() == 2
            assert "the service manager must pass" in said, said
    finally:
        for listener in (one, two, datagrams):
            listener.close()


def test_a_terminal_that_goes_stops_it(folder):
    try:
        ours, theirs = pty.openpty()
    except OSError as err:
        raise Skip("there are no terminals here: %s" % err) from err
    d = Daemon(folder, "--listen", "127.0.0.1:0", stdin=theirs).start()
    os.close(theirs)
    try:
        assert d.end(signal.SIGHUP) == 0
    finally:
        os.close(ours)
        d.close()


# --- what is installed -------------------------------------------------------

def run(*command, **options):
    done = subprocess.run(command, text=True, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, check=False, **options)
    assert done.returncode == 0, (command, done.stdout)
    return done.stdout


def make(target, prefix):
    run("make", "-s", target, "B=" + os.path.relpath(BUILD, ROOT), "SAN=",
        "PREFIX=" + prefix, cwd=ROOT)


def files_of(folder):
    return sorted(os.path.join(at, name)[len(folder) + 1:]
                  for at, _, names in os.walk(folder) for name in names)


def test_what_is_installed_is_uninstalled(folder):
    if os.environ.get("SAN"):
        raise Skip("of sanitized programs")
    prefix = os.path.join(folder, "usr")
    make("install", prefix)
    files = files_of(prefix)
    for name in ("bin/blobfieldd", "bin/blobfield", "include/blobfield.h",
                 "lib/libblobfield.a", "share/man/man8/blobfieldd.8",
                 "share/man/man5/blobfieldd.conf.5", "share/man/man1/blobfield.1",
                 "lib/systemd/system/blobfieldd.service",
                 "lib/systemd/system/blobfieldd.socket",
                 "lib/sysusers.d/blobfield.conf",
                 "etc/blobfield/blobfieldd.conf",
                 "share/doc/blobfield/README.md"):
        assert name in files, name
    verify(prefix)
    check_conf(prefix)
    # What somebody has changed is kept, by both.
    conf = os.path.join(prefix, "etc/blobfield/blobfieldd.conf")
    with open(conf, "a", encoding="utf-8") as file:
        file.write("history = 3\n")
    make("install", prefix)
    make("uninstall", prefix)
    assert files_of(prefix) == ["etc/blobfield/blobfieldd.conf"]
    os.remove(conf)
    make("install", prefix)
    make("uninstall", prefix)
    assert files_of(prefix) == []


def verify(prefix):
    if not shutil.which("systemd-analyze"):
        return
    units = [os.path.join(prefix, "lib/systemd/system", name)
             for name in ("blobfieldd.service", "blobfieldd.socket")]
    said = run("systemd-analyze", "verify", "--man=no", *units)
    assert not [line for line in said.splitlines() if "blobfield" in line], said
    said = run("systemd-analyze", "security", "--offline=true", units[0])
    exposure = float(re.search(r"exposure level for .*: ([\d.]+)",
                               said).group(1))
    print("measured: exposure by systemd-analyze security: %.1f" % exposure)
    assert exposure < 3.0, said


def check_conf(prefix):
    """The example reads, and what it says are the defaults are."""
    conf = os.path.join(prefix, "etc/blobfield/blobfieldd.conf")
    plain = dict(os.environ, HOME="/h")
    default = run(DAEMON, "--print-config", env=plain)
    assert run(DAEMON, "--config", conf, "--print-config", env=plain) == default
    with open(conf, encoding="utf-8") as file:
        shown = re.findall(r"^#([a-z-]+) = ([\w:.]+)$", file.read(), re.M)
    assert len(shown) > 8, shown
    for name, value in shown:
        assert re.search(r"^%s = %s +#" % (name, re.escape(value)), default,
                         re.M), (name, value)


# --- manuals -----------------------------------------------------------------

MANUALS = ("server/man/blobfieldd.8", "server/man/blobfieldd.conf.5",
           "clients/c/blobfield.1")


def read(name):
    with open(os.path.join(ROOT, name), encoding="utf-8") as file:
        return file.read()


def test_manuals_are_well_formed(_folder):
    if not shutil.which("mandoc"):
        raise Skip("there is no mandoc")
    for name in MANUALS:
        run("mandoc", "-T", "lint", "-W", "warning", name, cwd=ROOT)


def test_the_daemons_manual_has_its_options(_folder):
    said = run(DAEMON, "--help")
    options = re.findall(r"^  --([a-z-]+)(?: ([A-Z:]+))?(?:\s|$)", said, re.M)
    manual = read(MANUALS[0])
    written = re.findall(r"^\.It Fl -([a-z-]+)(?: Ar (\S+))?$", manual, re.M)
    assert sorted(options) == sorted(written), \
        sorted(set(options) ^ set(written))
    # And the defaults, of those that have some that are no paths.
    for name, default in re.findall(r"^  --([a-z-]+) [A-Z:]+\s+.*"
                                    r"\(([\w.:]+)\)", said, re.M):
        text = manual.split(".It Fl -%s " % name)[1].split(".It Fl")[0]
        assert "(%s)" % default in text, (name, default)


def examples(manual):
    """The shell's words of a manual's examples."""
    return [text.replace("\\e", "\\") for text in re.findall(
        r"^\.Bd -literal -offset indent\n(.*?)^\.Ed$",
        read(manual).split(".Sh EXAMPLES")[1], re.M | re.S)]


def test_the_manuals_examples_make_a_file_of_tokens(folder):
    script = os.path.join(folder, "bin")
    os.mkdir(script)
    os.symlink(DAEMON, os.path.join(script, "blobfieldd"))
    env = dict(os.environ, PATH=script + ":" + os.environ["PATH"])
    serve = next(text for text in examples(MANUALS[0]) if "--tokens" in text)
    first = next(text for text in examples(MANUALS[1]) if "printf" in text)
    # Before the daemon is started; before it is put where the service wants it.
    for text in (serve.split("\nblobfieldd --listen")[0],
                 first.split("\ninstall ")[0]):
        run("sh", "-ec", text, env=env, cwd=folder)
    names = ["me"]
    if shutil.which("jq"):
        run("sh", "-ec", next(text for text in examples(MANUALS[1])
                              if "jq" in text), env=env, cwd=folder)
        names.append("ci")
    tokens = os.path.join(folder, "tokens.json")
    with open(tokens, encoding="utf-8") as file:
        assert [e["name"] for e in json.load(file)["tokens"]] == names
    assert os.stat(tokens).st_mode & 0o077 == 0
    d = Daemon(folder, "--listen", "127.0.0.1:0", "--tokens", tokens).start()
    try:
        d.hear("READY=1")
        assert d.ask("/v1/info") == 401
        assert d.end() == 0
    finally:
        d.close()


def test_the_commands_manual_has_its_options(_folder):
    command = os.environ.get("BLOBFIELD") or os.path.join(BUILD, "blobfield")
    if not os.path.exists(command):
        raise Skip("there is no " + command)
    manual = read(MANUALS[2])
    common = manual.split(".Sh OPTIONS")[1]
    for name in re.findall(r"^  ([a-z]+)\s", run(command, "--help"), re.M):
        part = manual.split(".Ss %s\n" % name)[1].split(".Ss ")[0]
        for letter, option, argument in re.findall(
                r"^  (?:-(\w), |    )--([a-z-]+)(?: ([A-Z][A-Z.,]*))?\s",
                run(command, name, "--help"), re.M):
            line = "\n.It Fl %s-%s%s\n" % (
                letter + " , Fl " if letter else "", option,
                " Ar " + argument if argument else "")
            assert line in part or line in common, (name, line)


def main():
    failed = 0
    for name, test in sorted(globals().items()):
        if not name.startswith("test_"):
            continue
        print("[ RUN      ] " + name)
        folder = tempfile.mkdtemp()
        try:
            test(folder)
            print("[       OK ] " + name)
        except Skip as skip:
            print("skipped: %s: %s" % (name, skip))
            print("[  SKIPPED ] " + name)
        except Exception:  # pylint: disable=broad-except
            traceback.print_exc(file=sys.stdout)
            print("[  FAILED  ] " + name)
            failed += 1
        finally:
            shutil.rmtree(folder)
        sys.stdout.flush()
    shutil.rmtree(CACHE)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
