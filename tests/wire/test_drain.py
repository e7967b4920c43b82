#!/usr/bin/python3
"""Stopping while clients connect: the daemon ends with status 0, whatever
comes in the moment in which it ceases to listen.

That moment is microseconds long; a shim, built here and preloaded, has the main
thread wait whenever it takes something out of an epoll set or closes, for the
others to come in between. Starts the daemon ($BLOBFIELDD, else
build/blobfieldd). Prints its cases as cmocka does.
"""
import contextlib
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

SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <sys/epoll.h>
#include <sys/syscall.h>
#include <unistd.h>

int epoll_ctl(int set, int what, int fd, struct epoll_event *event)
{
	static int (*real)(int, int, int, struct epoll_event *);

	if (real == NULL)
		real = dlsym(RTLD_NEXT, "epoll_ctl");
	if (what == EPOLL_CTL_DEL && getpid() == syscall(SYS_gettid))
		usleep(200);
	return real(set, what, fd, event);
}
"""
REQUEST = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"
TIMES = 6
PATIENCE = 60


class Skip(Exception):
    """A case that cannot be run here; the message says why."""


def build_shim(folder):
    source = os.path.join(folder, "shim.c")
    with open(source, "w") as f:
        f.write(SHIM)
    out = os.path.join(folder, "shim.so")
    done = subprocess.run([os.environ.get("CC", "cc"), "-shared", "-fPIC",
                           "-o", out, source], capture_output=True)
    if done.returncode != 0:
        raise Skip("no shim can be built")
    return out


def start(shim, *arguments):
    program = os.environ.get("BLOBFIELDD", "build/blobfieldd")
    process = subprocess.Popen(
        [program, *CACHE, "--no-measure", "--data", ":memory:", "--listen",
         "127.0.0.1:0", "--quiet", "--no-measure", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=dict(os.environ, LD_PRELOAD=shim))
    port = int(re.search(r":(\d+)$",
                         process.stdout.readline().strip()).group(1))
    return process, port


def churn(port, over, counts):
    """A connection for each request, until it is over."""
    while not over.is_set():
        with contextlib.suppress(OSError):
            with socket.create_connection(("127.0.0.1", port), 5) as sock:
                sock.sendall(REQUEST)
                counts.append(sock.recv(500).startswith(b"HTTP/1.1 200"))


def stop_under_load(shim, *arguments):
    """Status and last words of a daemon stopped while clients connect."""
    process, port = start(shim, *arguments)
    over, counts = threading.Event(), []
    threads = [threading.Thread(target=churn, args=(port, over, counts))
               for _ in range(4)]
    for thread in threads:
        thread.start()
    while not counts and process.poll() is None:
        time.sleep(0.01)
    time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(PATIENCE)
    finally:
        process.kill()
        over.set()
        for thread in threads:
            thread.join()
    return process.returncode, process.stderr.read()[-300:], len(counts)


def stop_often(*arguments):
    folder = tempfile.mkdtemp()
    try:
        shim = build_shim(folder)
        served = 0
        for _ in range(TIMES):
            status, words, count = stop_under_load(shim, *arguments)
            assert status == 0, (status, words)
            served += count
        return "%d stops amid %d requests" % (TIMES, served)
    finally:
        shutil.rmtree(folder)


def test_clients_that_connect_do_not_break_a_stop():
    return stop_often()


def test_nor_where_connections_are_as_many_as_may_be():
    return stop_often("--max-connections", "8")


def test_who_waits_to_be_taken_is_answered():
    """What is in the listener's queue when it is closed would be reset."""
    process, port = start("", "--drain-time", "60")
    os.kill(process.pid, signal.SIGSTOP)
    socks = [socket.create_connection(("127.0.0.1", port), 20)
             for _ in range(20)]
    for sock in socks:
        sock.sendall(REQUEST)
    process.send_signal(signal.SIGTERM)
    os.kill(process.pid, signal.SIGCONT)
    answers = 0
    for sock in socks:
        sock.settimeout(20)
        with contextlib.suppress(OSError):
            answers += sock.recv(500).startswith(b"HTTP/1.1 200")
        sock.close()
    assert process.wait(PATIENCE) == 0
    assert answers == 20, answers


def run_case(name, case):
    print("[ RUN      ] " + name, flush=True)
    try:
        figure = case()
    except Skip as skip:
        print("skipped: %s" % skip)
        print("[  SKIPPED ] " + name, flush=True)
        return True
    except Exception:
        print(traceback.format_exc())
        print("[  FAILED  ] " + name, flush=True)
        return False
    if figure:
        print("measured: " + figure)
    print("[       OK ] " + name, flush=True)
    return True


def main():
    cases = [(n, c) for n, c in list(globals().items())
             if n.startswith("test_")]
    results = [run_case(n, c) for n, c in cases]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
