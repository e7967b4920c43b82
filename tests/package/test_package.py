#!/usr/bin/python3
"""The Debian package, $DEB: what is in it, and what it does to a system.

A small Debian ($ROOT: a folder that is copied; else by debootstrap) gets the
package, is booted in a container (systemd-nspawn) with the unit as it is, and
has the package purged. Takes minutes, root, and the network. Prints its cases as
cmocka does.
"""
import glob
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import traceback

DEB = os.path.abspath(os.environ["DEB"])

# Runs in the container once it is up, as a service.
CHECK = """#!/bin/sh
exec > /root/said 2>&1
evaluate() {
	curl -s -H 'Content-Type: application/json' -d '{"points": [[1,0,0]],
	    "scene": {"format": "blobfield/1", "root": {"type": "point",
	    "center": [0,0,0], "radius": 1}}}' http://127.0.0.1:$1/v1/eval
	echo
}
state() {
	echo "$1: $(systemctl show blobfieldd -p "$2" --value)"
}
state active ActiveState
state status StatusText
evaluate 7878
systemctl reload blobfieldd && echo reloaded
state status StatusText
systemctl kill -s KILL blobfieldd
sleep 3
while [ "$(systemctl is-active blobfieldd)" = activating ]; do sleep 1; done
state restarts NRestarts
evaluate 7878
systemctl stop blobfieldd
state stopped Result
mkdir -p /etc/systemd/system/blobfieldd.socket.d
printf '[Socket]\\nListenStream=\\nListenStream=127.0.0.1:80\\n' \\
    > /etc/systemd/system/blobfieldd.socket.d/port.conf
systemctl daemon-reload
systemctl start blobfieldd.socket
evaluate 80
systemctl stop blobfieldd.socket
journalctl -u blobfieldd -o cat --no-pager
systemctl poweroff
"""


class Skip(Exception):
    """A case that cannot be run here; the message says why."""


def run(*command, patience=900):
    done = subprocess.run(command, text=True, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, check=False,
                          stdin=subprocess.DEVNULL, timeout=patience)
    assert done.returncode == 0, (command, done.stdout[-4000:])
    return done.stdout


def test_it_has_what_it_should(_folder):
    names = {line.split()[5] for line in
             run("dpkg-deb", "-c", DEB).splitlines()}
    for name in ("./usr/bin/blobfieldd", "./usr/bin/blobfield",
                 "./lib/systemd/system/blobfieldd.service",
                 "./lib/systemd/system/blobfieldd.socket",
                 "./usr/lib/sysusers.d/blobfield.conf",
                 "./etc/blobfield/blobfieldd.conf",
                 "./usr/share/man/man8/blobfieldd.8.gz",
                 "./usr/share/man/man5/blobfieldd.conf.5.gz",
                 "./usr/share/man/man1/blobfield.1.gz",
                 "./usr/share/doc/blobfield/copyright"):
        assert name in names, name
    depends = run("dpkg-deb", "-f", DEB, "Depends")
    for package in ("pocl-opencl-icd", "libmicrohttpd12", "libsqlite3-0",
                    "libhiredis0.14", "libgnutls30", "libsystemd0"):
        assert package in depends, (package, depends)
    assert run("dpkg-deb", "-I", DEB, "conffiles").split() == \
        ["/etc/blobfield/blobfieldd.conf"]


def test_lintian_has_no_complaint(_folder):
    if not shutil.which("lintian"):
        raise Skip("there is no lintian")
    said = run("lintian", "--allow-root", "--fail-on", "error,warning", DEB)
    assert not re.search(r"^[EW]:", said, re.M), said


def make_root(root):
    if os.environ.get("ROOT"):
        run("cp", "-a", os.environ["ROOT"] + "/.", root)
    else:
        run("debootstrap", "--variant=minbase", "bookworm", root)
    shutil.copy("/etc/resolv.conf", os.path.join(root, "etc/resolv.conf"))
    shutil.copy(DEB, os.path.join(root, "root/blobfield.deb"))


def inside(root, command):
    """In a container that has the network, but its own processes."""
    return run("systemd-nspawn", "-q", "-D", root, "--register=no",
               "--keep-unit", "--console=pipe", "sh", "-c", command)


def boot(root):
    """What CHECK says."""
    check = os.path.join(root, "root/check")
    with open(check, "w", encoding="utf-8") as file:
        file.write(CHECK)
    os.chmod(check, 0o755)
    units = os.path.join(root, "etc/systemd/system")
    with open(units + "/check.service", "w", encoding="utf-8") as file:
        file.write("[Unit]\nAfter=blobfieldd.service\n"
                   "[Service]\nExecStart=/root/check\n")
    os.symlink("../check.service",
               units + "/multi-user.target.wants/check.service")
    run("systemd-nspawn", "-q", "-D", root, "--boot", "--register=no",
        "--keep-unit", "--private-network", "--console=pipe")
    with open(os.path.join(root, "root/said"), encoding="utf-8") as file:
        return file.read()


def check_said(said):
    assert said.count('{"count":1,"value":[0.5]') == 3, said
    for line in ("active: active", "status: serving", "reloaded",
                 "restarts: 1", "stopped: success"):
        assert line in said.splitlines(), (line, said)
    assert "listening on http://127.0.0.1:80\n" in said, said


def left_of_it(root):
    """Files that are called by its name, but logs' and what was put there."""
    return [path for path in
            glob.glob(root + "/**/*blobfield*", recursive=True)
            if not re.search("/(proc|sys|dev|root|var/log|"
                             "etc/systemd/system/blobfieldd.socket.d)(/|$)",
                             path[len(root):])]


def test_it_is_installed_and_boots_and_goes(folder):
    if os.geteuid() != 0 or not shutil.which("systemd-nspawn"):
        raise Skip("needs root and systemd-nspawn")
    root = os.path.join(folder, "root")
    os.mkdir(root)
    make_root(root)
    begin = time.monotonic()
    inside(root, "apt-get update -q && DEBIAN_FRONTEND=noninteractive "
           "apt-get install -y -q --no-install-recommends systemd-sysv curl "
           "/root/blobfield.deb")
    print("measured: apt install with all it needs: %.0f s" %
          (time.monotonic() - begin))
    check_said(boot(root))
    assert os.path.exists(root + "/var/lib/blobfield/scenes.sqlite")
    inside(root, "DEBIAN_FRONTEND=noninteractive apt-get purge -y -q blobfield")
    assert left_of_it(root) == [], left_of_it(root)


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
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
