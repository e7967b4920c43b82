#!/usr/bin/python3
"""The commands of the README, as a newcomer types them.

BLOBFIELDD is the daemon and BLOBFIELD the command, those in build/ unless set.
Prints its cases as cmocka does.
"""
import os
import re
import subprocess
import sys
import tempfile
import traceback

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(
    os.path.abspath(__file__))))
DAEMON = os.environ.get("BLOBFIELDD") or "build/blobfieldd"
COMMAND = os.environ.get("BLOBFIELD") or "build/blobfield"
# Of numbers: those printed are another machine's, and of other tables' roundings.
NEAR = 1e-3
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
TIME = re.compile(r'"time":"[^"]*"')


def blocks(language):
    with open(os.path.join(ROOT, "README.md"), encoding="utf-8") as file:
        return re.findall(r"^```%s\n(.*?)^```" % language, file.read(),
                          re.M | re.S)


def shell(command, folder, url):
    """What command prints, run at the root; files it writes go to folder."""
    command = command.replace("-o ", "-o %s/" % folder)
    command = command.replace("build/blobfield ", COMMAND + " ")
    done = subprocess.run(["sh", "-c", command], cwd=ROOT, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          env=dict(os.environ, U=url, BLOBFIELD_URL=url))
    assert done.returncode == 0, (command, done.stderr)
    return done.stdout


def same(found, shown):
    """Texts are equal, numbers near; white space and times do not count."""
    found, shown = (TIME.sub('"time":""', text) for text in (found, shown))
    words = ["".join(NUMBER.sub("#", text).split()) for text in (found, shown)]
    assert words[0] == words[1], (found, shown)
    for a, b in zip(NUMBER.findall(found), NUMBER.findall(shown)):
        assert abs(float(a) - float(b)) <= NEAR * (1 + abs(float(b))), (a, b)


def test_curl_answers_as_shown(url, folder):
    compared = 0
    for block in blocks("console"):
        for part in re.split(r"^\$ ", block, flags=re.M)[1:]:
            command, _, shown = part.partition("\n")
            if not command.startswith("curl"):
                continue
            command = command.replace("curl ", "curl -s --noproxy '*' ", 1)
            if " -N " in command:  # which does not end
                command = "timeout 2 %s || true" % command
            found = shell(command, folder, url)
            # Heads have a date; a blank line ends them.
            if "-i " in command:
                found, shown = (text.partition("\n\n")[2]
                                for text in (found, shown))
            if shown.strip():
                same(found, shown)
                compared += 1
    assert compared >= 4, compared


def test_files_are_what_they_are_called(url, folder):
    for name, begins in (("a.glb", b"glTF"), ("a.png", b"\x89PNG")):
        path = os.path.join(folder, name)
        with open(path, "rb") as file:
            assert file.read(4) == begins, name
        os.remove(path)


def test_the_command_does_as_shown(url, folder):
    lines = [line for block in blocks("sh") for line in block.splitlines()
             if line.startswith("build/blobfield ")]
    assert len(lines) == 4, lines
    for line in lines:
        if " watch " not in line:  # which does not end
            shell(line.partition("#")[0].strip(), folder, url)
    test_files_are_what_they_are_called(url, folder)


def test_python_prints_as_shown(url, folder):
    code, = blocks("python")
    shown = re.search(r"#(.*)$", code, re.M).group(1)
    done = subprocess.run(
        [sys.executable, "-c", code.replace("Client()", "Client(%r)" % url)],
        text=True, stdout=subprocess.PIPE, check=True,
        env=dict(os.environ, PYTHONPATH=os.path.join(ROOT, "clients/python"),
                 PYTHONDONTWRITEBYTECODE="1"))
    same(done.stdout, shown)


def main():
    failed = 0
    daemon = subprocess.Popen([DAEMON, "--no-cache", "--data", ":memory:", "--quiet", "--listen",
                               "127.0.0.1:0"], cwd=ROOT, text=True,
                              stdout=subprocess.PIPE)
    url = daemon.stdout.readline().split()[-1]
    try:
        with tempfile.TemporaryDirectory() as folder:
            for test in (test_curl_answers_as_shown,
                         test_files_are_what_they_are_called,
                         test_the_command_does_as_shown,
                         test_python_prints_as_shown):
                print("[ RUN      ] " + test.__name__)
                try:
                    test(url, folder)
                    print("[       OK ] " + test.__name__)
                except Exception:
                    traceback.print_exc(file=sys.stdout)
                    print("[  FAILED  ] " + test.__name__)
                    failed += 1
    finally:
        daemon.terminate()
        failed += daemon.wait() != 0
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
