#!/usr/bin/python3
"""The blobfield command against a real daemon: rows in and out, errors with
their places, exit statuses, watch; and clients/c/README.md's quick start.

In the environment: BLOBFIELDD, BLOBFIELD (the command), BLOBFIELD_LIBRARY
(libblobfield.a). Prints its cases as cmocka does.
"""
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time

BUILD = os.environ.get("B", "build")
DAEMON = os.path.abspath(os.environ.get("BLOBFIELDD", BUILD + "/blobfieldd"))
COMMAND = os.path.abspath(os.environ.get("BLOBFIELD", BUILD + "/blobfield"))
LIBRARY = os.path.abspath(os.environ.get("BLOBFIELD_LIBRARY",
                                         BUILD + "/libblobfield.a"))
LETTER = os.path.abspath("clients/curl/letter-a.json")
README = os.path.abspath("clients/c/README.md")
INCLUDE = os.path.abspath("clients/c")

BAD = """{"format": "blobfield/1",
 "root": {"type": "union", "children": [
\t{"type": "point", "center": [0, 0, 0], "radius": -1},
   {"type": "point", "center": [0, 0, "x"], "radius": 1}]}}
"""
BALL = """{"format": "blobfield/1", "name": "ball",
 "root": {"type": "point", "center": [0, 0, 0], "radius": 1}}
"""

GRID = ["grid", LETTER, "--min=-1,-0.5,0", "--max=1,0.5,2.25"]

folder = tempfile.mkdtemp(prefix="blobfield-")


def run(*arguments, text=None, status=0, program=COMMAND):
    """The command's stdout and stderr, after it has ended with status."""
    done = subprocess.run([program, *arguments], input=text, text=True,
                          capture_output=True, cwd=folder, timeout=120)
    assert done.returncode == status, "%s ended with %d, not %d: %s" % (
        arguments, done.returncode, status, done.stderr)
    return done.stdout, done.stderr


def path(name, text=None):
    """A file in the test's folder, with text if that is given."""
    at = os.path.join(folder, name)
    if text is not None:
        with open(at, "w") as file:
            file.write(text)
    return at


def equal(value, expected):
    assert value == expected, "%r is not %r" % (value, expected)


def same(value, expected):
    assert value in expected or expected in value, "%r is not in %r" % (
        expected, value)


# --- cases ---

def test_help_of_each_command():
    listed = run("--help")[0]
    names = re.findall(r"^  ([a-z]+) ", listed, re.M)
    assert len(names) == 17, names
    for name in names:
        text = run(name, "--help")[0]
        assert text.startswith("blobfield %s - " % name), text
        same(text, "Exit status: 0 all went well")
        assert max(map(len, text.splitlines())) <= 80, name


def test_usage_errors_end_with_2():
    for arguments in ([], ["evil"], ["--url", "x"], ["eval"], ["mesh"],
                      ["eval", LETTER, "-p", "1,2"],
                      ["eval", LETTER, "-p", "1,2,3", "--outputs", "volume"],
                      ["render", LETTER, "--width", "0"],
                      ["render", LETTER, "--eye", "1,2"],
                      ["mesh", LETTER, "--min", "0,0,0"],
                      ["mesh", LETTER, "-o", "mesh.doc"],
                      ["list", "--frobnicate"], ["list", "--url"],
                      ["list", "--quiet=yes"], ["delete", "a/b"],
                      ["eval", "-"], ["grid", LETTER],
                      ["grid", LETTER, "--min", "0,0,0", "--max", "1,1,1"],
                      GRID + ["-n", "2,2,0"], GRID + ["-n", "2,2.5,2"],
                      GRID + ["-n", "2,2,4097"], GRID + ["-n", "2,2"],
                      GRID + ["-n", "2,2,2", "--outputs", "volume"]):
        assert run(*arguments, text="", status=2)[1] != "", arguments


def test_eval_prints_csv():
    out, err = run("eval", LETTER, "-p", "0,0,2.6", "-p=0,0,1.4", status=2)
    out, err = run("eval", LETTER, "-p", "0,0,2.6", "-p0,0,1.4",
                   "--outputs=value")
    lines = out.splitlines()
    equal(lines[0], "x,y,z,value")
    equal(len(lines), 3)
    assert lines[1].startswith("0,0,2.6,1.24"), lines[1]
    equal(err, "")


def test_eval_reads_text_npy_and_float32():
    points = [(0, 0, 2.6), (0, 0, 1.4), (5, 5, 5)]
    floats = struct.pack("<9f", *[c for p in points for c in p])
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (3, 3), }"
    with open(path("p.f32"), "wb") as file:
        file.write(floats)
    with open(path("p.npy"), "wb") as file:
        file.write(b"\x93NUMPY\1\0" + struct.pack("<H", 118) +
                   header.ljust(117) + b"\n" +
                   struct.pack("<9d", *struct.unpack("<9f", floats)))
    path("p.csv", "x, y, z\n# the top\n0,0,2.6\n\n0 0\t1.4 # a hole\r\n5;5;5")
    expected = run("eval", LETTER, "p.csv")[0]
    equal(expected.count("\n"), 4)
    equal(run("eval", LETTER, "p.npy")[0], expected)
    equal(run("eval", LETTER, "p.f32")[0], expected)
    equal(run("eval", LETTER, text=open(path("p.csv")).read())[0], expected)


def test_rows_are_written_by_extension():
    for name in ("v.csv", "v.json", "v.npy", "v.f32"):
        run("eval", LETTER, "-p", "0,0,2.6", "-o", name)
    value = float(open(path("v.csv")).read().splitlines()[1].split(",")[3])
    made = json.load(open(path("v.json")))
    equal(made["columns"][3], "value")
    equal(made["rows"][0][3], value)
    raw = open(path("v.f32"), "rb").read()
    equal(len(raw), 16)
    npy = open(path("v.npy"), "rb").read()
    same(npy[:128].decode("latin-1"), "'shape': (1, 4)")
    equal(npy[128:], raw)
    assert abs(struct.unpack("<f", raw[:4])[0] - value) < 1e-6
    assert not [n for n in os.listdir(folder) if n.endswith(".part")]


def test_large_batches_go_in_pieces_with_a_bar():
    with open(path("many.f32"), "wb") as file:
        file.write(bytes(12 * 600001))
    err = run("eval", LETTER, "many.f32", "-o", "out.f32",
              "--outputs", "value,hessian", "--progress")[1]
    equal(os.path.getsize(path("out.f32")), 600001 * 7 * 4)
    # The bar, where it was slow enough for one, is wiped out at the end. (Text
    # mode reads carriage returns as newlines.)
    if err:
        assert err.endswith("\n\033[K"), repr(err[-40:])


def test_grid_is_eval_at_its_points():
    out = run(*GRID, "-n", "3,2,4", "--outputs", "value,normal")[0]
    points = "".join("%g,%g,%g\n" % (x, y, z) for x in (-1, 0, 1)
                     for y in (-0.5, 0.5) for z in (0, 0.75, 1.5, 2.25))
    equal(out, run("eval", LETTER, text=points, *["--outputs",
                                                  "value,normal"])[0])
    equal(run(*GRID, "-n", "1,1,1", "--outputs", "value")[0].splitlines()[0],
          "x,y,z,value")


def test_grid_files_have_its_shape():
    run(*GRID, "-n", "5,4,6", "-o", "g.npy", "--outputs", "value")
    npy = open(path("g.npy"), "rb").read()
    same(npy[:128].decode("latin-1"), "'shape': (5, 4, 6), }")
    run(*GRID, "-n", "5,4,6", "-o", "g.f32", "--outputs", "value")
    equal(open(path("g.f32"), "rb").read(), npy[128:])
    equal(len(npy), 128 + 5 * 4 * 6 * 4)
    volume = subprocess.run(
        ["curl", "-sf", "--noproxy", "*", "--data-binary", "@g.npy", "-H",
         "Content-Type: application/x-npy", os.environ["BLOBFIELD_URL"] +
         "/v1/volumes?min=-1,-0.5,0&max=1,0.5,2.25&kind=field"], cwd=folder,
        capture_output=True, check=True).stdout
    equal(json.loads(volume)["shape"], [5, 4, 6])
    run(*GRID, "-n", "5,1,6", "-o", "g.npy")
    same(open(path("g.npy"), "rb").read(128).decode("latin-1"),
         "'shape': (5, 1, 6, 4), }")
    run(*GRID, "-n", "2,1,1", "-o", "g.json")
    equal(len(json.load(open(path("g.json")))["rows"]), 2)


def test_grid_refusals_have_their_places():
    same(run(*GRID, "-n", "1000,1000,9", status=1)[1],
         "blobfield grid: /counts: there are 9000000 points")
    same(run(*GRID[:2], "--min", "0,1,0", "--max", "1,0,1", "-n", "2,2,2",
             status=1)[1], "blobfield grid: /max/1: ")
    run("grid", "nobody", *GRID[2:], "-n", "2,2,2", status=1)
    equal(run("list")[0], "")


def test_bad_rows_end_with_4():
    err = run("eval", LETTER, text="1,2,3\n1,2\n", status=4)[1]
    same(err, "-:2: must have 3 finite numbers")
    run("eval", LETTER, text="1,2,nan\n", status=4)
    run("eval", LETTER, "nowhere.csv", status=4)
    path("odd.f32", "odd")
    same(run("eval", LETTER, "odd.f32", status=4)[1], "3 bytes")
    path("odd.npy", "odd")
    run("eval", LETTER, "odd.npy", status=4)
    run("eval", LETTER, "-p", "1,2,3", "-o", "no/where.csv", status=4)


def test_faults_are_placed_in_the_file():
    path("bad.json", BAD)
    err = run("put", "bad", "bad.json", status=1)[1].splitlines()
    assert err[0].startswith("bad.json:3:41: /root/children/0/radius: "), err
    equal(err[1], '  \t{"type": "point", "center": [0, 0, 0], "radius": -1},')
    equal(err[2], "  \t" + 39 * " " + "^")
    assert err[3].startswith("bad.json:4:39: /root/children/1/center/2: "), \
        err[3]
    odd = BALL.replace('"radius"', '"a/b~\\u0041": 1,\n  "radius"')
    err = run("put", "bad", text=odd, status=1)[1]
    assert err.startswith("stdin:2:49: /root/a~1b~0A: unknown"), err
    err = run("eval", "-", "-p", "0,0,0", text=BAD[:-3], status=1)[1]
    assert err.startswith("stdin:4:"), err
    equal(run("list")[0], "")


def test_faults_elsewhere_have_their_pointers():
    err = run("mesh", LETTER, "--resolution", "1", status=1)[1]
    assert err.startswith("blobfield mesh: /resolution: "), err
    err = run("eval", "nobody", "-p", "0,0,0", status=1)[1]
    equal(err, "blobfield eval: Not found: There is no scene 'nobody'.\n")


def test_no_daemon_ends_with_3():
    same(run("info", "--url", "http://127.0.0.1:1", status=3)[1],
         "http://127.0.0.1:1: ")


def test_put_get_list_delete():
    tag = run("put", "ball", text=BALL)[0]
    assert re.fullmatch("[0-9a-f]{32}\n", tag), tag
    equal(run("get", "ball")[0], BALL)
    run("get", "ball", "-o", "copy.json")
    equal(open(path("copy.json")).read(), BALL)
    equal(run("list")[0].split(), ["ball", "1", "ball"])
    equal(run("put", "-q", "ball", "copy.json")[0], "")
    run("delete", "ball", "ball", status=1)
    equal(run("list")[0], "")


def test_list_goes_through_all_pages():
    for i in range(3):
        run("put", "-q", "s%d" % i, text=BALL)
    equal([line.split()[0] for line in run("list")[0].splitlines()],
          ["s0", "s1", "s2"])
    run("delete", "s0", "s1", "s2")


def test_files_are_forgotten_again():
    run("bounds", LETTER)
    run("eval", LETTER, "-p", "0,0,0")
    equal(run("list")[0], "")


def test_info_is_json():
    equal(json.loads(run("info")[0])["name"], "blobfield")


def test_meshes_and_pictures():
    known = json.loads(run("mesh", LETTER, "--resolution", "24")[0])
    equal(known["genus"], 1)
    err = run("mesh", LETTER, "-o", "a.stl", "-r", "24")[1]
    same(err, "a.stl: vertices=")
    size = os.path.getsize(path("a.stl"))
    equal((size - 84) % 50, 0)
    run("render", LETTER, "-o", "a.png", "--width=40", "--height=30",
        "--eye", "0,-8,1", "--target", "0,0,1", "--background", "1,1,1")
    run("slice", LETTER, "-o", "s.npy", "-W", "20", "-H", "10")
    equal(open(path("a.png"), "rb").read(4), b"\x89PNG")
    same(open(path("s.npy"), "rb").read(128).decode("latin-1"), "(10, 20)")


def test_rays_and_projection():
    out = run("raycast", "-", "-r", "0,0,5,0,0,-1", text=BALL)[0]
    row = dict(zip(*[line.split(",") for line in out.splitlines()]))
    equal(row["hit"], "1")
    assert abs(float(row["distance"]) - 4) < 1e-4, row
    out = run("project", "-", "-p", "0,0.5,0", text=BALL)[0]
    row = dict(zip(*[line.split(",") for line in out.splitlines()]))
    assert abs(float(row["y"]) - 1) < 1e-4, row


def test_interrupt_ends_with_130_and_forgets():
    child = subprocess.Popen([COMMAND, "mesh", LETTER, "-r", "1000", "-o",
                              "big.glb"], cwd=folder)
    for _ in range(1200):  # until its scene is kept
        if run("list")[0]:
            break
        time.sleep(0.05)
    child.send_signal(signal.SIGINT)
    equal(child.wait(120), 130)
    equal(run("list")[0], "")
    equal([n for n in os.listdir(folder) if n.startswith("big")], [])


def await_text(file, text):
    for _ in range(1200):
        if text in open(file).read():
            return
        time.sleep(0.05)
    raise AssertionError("%r is not in %r" % (text, open(file).read()))


def test_watch_follows_the_file():
    path("ball 2.json", BALL)
    log = path("log")
    with open(log, "w") as err:
        child = subprocess.Popen([COMMAND, "watch", "ball 2.json", "-o",
                                  "w.ply", "-r", "8"], cwd=folder, stderr=err)
    try:
        await_text(log, "kept as ball-2")
        await_text(log, "w.ply: ")
        path("ball 2.json", BAD)
        await_text(log, "ball 2.json:3:41: /root/children/0/radius")
        # As editors do it.
        path("new.json", BALL.replace("ball", "again"))
        os.rename(path("new.json"), path("ball 2.json"))
        for _ in range(1200):
            if "again" in run("list")[0]:
                break
            time.sleep(0.05)
        same(run("list")[0], "again")
    finally:
        child.send_signal(signal.SIGINT)
        equal(child.wait(120), 130)
    run("delete", "ball-2")


def test_token():
    lines = [subprocess.run(
        [DAEMON, "--make-token", name], stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL, text=True, check=True).stdout.splitlines()
        for name in ("w:write", "r:read")]
    tokens = path("tokens", json.dumps(
        {"tokens": [json.loads(entry) for _, entry in lines]}))
    os.chmod(tokens, 0o600)
    daemon, url = start("--tokens", tokens)
    path("ball.json", BALL)
    try:
        _, error = run("info", "--url", url, status=1)
        same(error, "asks for a token")
        _, error = run("info", "--url", url, "--token", "bf_no", status=1)
        same(error, "not known")
        _, error = run("info", "--url", url, "--token", "a b", status=2)
        same(error, "--token: a token is one word")
        same(run("info", "--url", url, "--token", lines[1][0])[0], "blobfield")
        _, error = run("put", "ball", "ball.json", "--url", url, "--token",
                       lines[1][0], status=1)
        same(error, "this needs 'write'")
        os.environ["BLOBFIELD_TOKEN"] = lines[0][0]
        # --progress asks by a second connection, with the token, too.
        run("mesh", "ball.json", "--url", url, "-r", "96", "--progress", "-o",
            "t.ply")
        equal(os.path.exists(path("t.ply")), True)
        _, error = run("info", "--url", url, "--token", "", status=1)
        same(error, "asks for a token")
    finally:
        os.environ.pop("BLOBFIELD_TOKEN", None)
        daemon.send_signal(signal.SIGTERM)
        equal(daemon.wait(120), 0)


def test_patch():
    path("ball.json", BALL)
    first = run("put", "p", "ball.json")[0].strip()
    path("patch.json", """[
 {"op": "test", "path": "/root/radius", "value": 1},
 {"op": "replace", "path": "/root/radius", "value": 3}]""")
    second = run("patch", "p", "patch.json", "--if-match", first)[0].strip()
    assert second not in ("", first), second
    equal(json.loads(run("get", "p")[0])["root"]["radius"], 3)
    # A merge patch, from stdin.
    run("patch", "p", text='{"name": "other"}')
    same(run("list")[0], "other")
    # Wrong at a place of the patch, of the document after it; and too late.
    err = run("patch", "p", "patch.json", status=1)[1]
    same(err, "patch.json:2:41: /0/value: the test failed")
    err = run("patch", "p", text='{"root": {"radius": -1}}', status=1)[1]
    same(err, "after the patch")
    same(err, "blobfield patch: /root/radius: ")
    same(run("patch", "p", "-", "--if-match", first, text="{}", status=1)[1],
         "blobfield patch: ")
    same(run("patch", "nowhere", text="{}", status=1)[1], "no scene 'nowhere'")
    run("patch", "a/b", text="{}", status=2)
    # What there has been.
    lines = [line.split() for line in run("revisions", "p")[0].splitlines()]
    equal(len(lines), 3)
    equal([line[2] for line in lines[1:]], [second, first])
    equal(run("get", "p", "--revision", first)[0], BALL)
    same(run("get", "p", "--revision", "0" * 32, status=1)[1], "Not found")
    run("get", "p", "--revision", "a/b", status=2)
    run("delete", "p")
    same(run("revisions", "p", status=1)[1], "no scene 'p'")
    run("revisions", "a/b", status=2)


def test_events():
    path("ball.json", BALL)
    run("put", "e", "ball.json")
    log = path("events")
    with open(log, "w") as out:
        child = subprocess.Popen([COMMAND, "events", "e"], cwd=folder,
                                 stdout=out)
    try:
        first = run("revisions", "e")[0].strip()
        await_text(log, first)
        tag = run("patch", "e", text='{"name": "told"}')[0].strip()
        await_text(log, tag)
        run("delete", "e")
        equal(child.wait(20), 0)
    finally:
        child.kill()
        child.wait()
    lines = open(log).read().splitlines()
    equal(len(lines), 3)
    equal(lines[2].split()[2:], ["deleted", "0", "0"])
    same(run("events", "e", status=1)[1], "no scene 'e'")
    run("put", "e", "ball.json")
    run("patch", "e", text='{"name": "told"}')
    since = run("revisions", "e")[0].splitlines()
    out = run("events", "e", "-n", "1", "--last", since[1].split()[0])[0]
    equal(out.strip(), since[0].strip())
    child = subprocess.Popen([COMMAND, "events", "e"], cwd=folder,
                             stdout=subprocess.PIPE)
    child.stdout.readline()
    child.send_signal(signal.SIGINT)
    equal(child.wait(20), 130)
    child.stdout.close()
    run("delete", "e")


def test_certificates():
    if not shutil.which("openssl"):
        return
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt",
                    "ec_paramgen_curve:P-256", "-nodes", "-keyout", "key",
                    "-out", "cert", "-days", "2", "-subj", "/CN=blobfield",
                    "-addext", "subjectAltName=IP:127.0.0.1"], check=True,
                   capture_output=True, cwd=folder)
    daemon, url = start("--tls-cert", path("cert"), "--tls-key", path("key"))
    path("ball.json", BALL)
    try:
        same(url, "https://127.0.0.1:")
        same(run("info", "--url", url, status=3)[1], "certificate")
        same(run("info", "--url", url, "--ca", "nowhere", status=2)[1],
             "--ca: 'nowhere' cannot be read")
        run("put", "t", "ball.json", "--url", url, "--ca", "cert")
        os.environ["BLOBFIELD_CA"] = "nowhere"
        same(run("info", "--url", url, status=3)[1], "nowhere")
        os.environ["BLOBFIELD_CA"] = "cert"
        run("mesh", "t", "--url", url, "-r", "96", "--progress", "-o", "t.ply")
        same(run("events", "t", "--url", url, "-n", "1")[0],
             run("revisions", "t", "--url", url)[0].strip())
    finally:
        os.environ.pop("BLOBFIELD_CA", None)
        daemon.send_signal(signal.SIGTERM)
        equal(daemon.wait(120), 0)


def test_watch_once():
    path("once.json", BALL)
    err = run("watch", "--once", "once.json", "--id", "o")[1]
    same(err, "once.json: kept as o, revision ")
    run("delete", "o")


def blocks(language):
    text = open(README).read()
    return re.findall(r"^```%s\n(.*?)^```$" % language, text, re.M | re.S)


def test_readme_quick_start():
    tools = os.path.join(folder, "bin")
    os.mkdir(tools)
    os.symlink(COMMAND, os.path.join(tools, "blobfield"))
    shutil.copy(LETTER, path("a.json"))
    env = dict(os.environ, PATH=tools + ":" + os.environ["PATH"])
    done = subprocess.run(["sh", "-eux", "-c", blocks("sh")[0]], cwd=folder,
                          env=env, text=True, capture_output=True)
    equal((done.returncode, done.stderr[-300:] if done.returncode else ""),
          (0, ""))
    for name in ("a.glb", "a.png", "a-slice.png"):
        assert os.path.getsize(path(name)) > 1000, name
    equal(os.path.getsize(path("a.npy")), 128 + 64 * 32 * 64 * 4)


def test_readme_program():
    path("ball.c", blocks("c")[0])
    line = blocks("sh")[1].strip()
    equal(line, "cc ball.c -lblobfield -lcurl -lcjson")
    sanitize = os.environ.get("SAN")
    line = line.replace("-lblobfield", "'%s' -I '%s' %s" % (
        LIBRARY, INCLUDE, "-fsanitize=" + sanitize if sanitize else ""))
    run("-c", line, program="/bin/sh")
    equal(run(program=path("a.out"))[0], "0.5 1\n")


def test_no_leaks():
    if os.environ.get("SAN") or not shutil.which("valgrind"):
        return
    path("bad.json", BAD)
    for status, arguments in ((0, ["eval", LETTER, "-p", "0,0,0"]),
                              (1, ["put", "bad", "bad.json"]),
                              (1, ["patch", "nowhere", "bad.json"]),
                              (1, ["revisions", "nowhere"]),
                              (1, ["events", "nowhere"]),
                              (0, ["mesh", LETTER, "-r", "8", "-o", "v.ply"]),
                              (0, GRID + ["-n", "3,3,3", "-o", "v.npy"]),
                              (1, GRID + ["-n", "1000,1000,9"]),
                              (4, ["eval", LETTER, "nowhere.csv"])):
        # curl's and OpenSSL's own are still reachable.
        run("-q", "--leak-check=full", "--show-leak-kinds=definite,indirect",
            "--errors-for-leak-kinds=definite,indirect",
            "--error-exitcode=99", COMMAND, *arguments, status=status,
            program="valgrind")


# --- running them ---

def start(*flags):
    """The daemon and its URL, once it is ready."""
    daemon = subprocess.Popen([DAEMON, "--listen", "127.0.0.1:0", "--quiet",
                               "--no-measure", "--no-cache", "--data",
                               ":memory:", *flags],
                              stdout=subprocess.PIPE, text=True)
    url = daemon.stdout.readline().split()[-1]
    for _ in range(6000):
        if subprocess.run(["curl", "-skf", "--noproxy", "*", "-o", "/dev/null",
                           url + "/readyz"]).returncode == 0:
            return daemon, url
        time.sleep(0.05)
    raise SystemExit("the daemon does not get ready")


def run_case(name, case):
    print("[ RUN      ] " + name, flush=True)
    try:
        case()
    except Exception as error:  # whatever it is, the next case is another
        print("%s: %s" % (type(error).__name__, error))
        print("[  FAILED  ] " + name, flush=True)
        return False
    print("[       OK ] " + name, flush=True)
    return True


def main():
    daemon, os.environ["BLOBFIELD_URL"] = start()
    cases = [(name, case) for name, case in globals().items()
             if name.startswith("test_") and
             (len(sys.argv) < 2 or name in sys.argv[1:])]
    try:
        passed = [run_case(name, case) for name, case in cases]
    finally:
        daemon.send_signal(signal.SIGTERM)
        status = daemon.wait(120)
        shutil.rmtree(folder)
    return 0 if all(passed) and status == 0 else 1


sys.exit(main())
