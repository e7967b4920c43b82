#!/usr/bin/python3
"""The models of the gallery: taken by the daemon, with a surface, and listed.

BLOBFIELDD is the daemon, build/blobfieldd unless set. Python's standard
library alone. Prints its cases as cmocka does.
"""
import json
import os
import subprocess
import sys
import tempfile
import traceback
import urllib.error
import urllib.request

# The tables that tests/run.sh has built for all, or none.
CACHE = (["--cache", os.environ["BLOBFIELD_TEST_CACHE"],
          "--cache-read-only"] if "BLOBFIELD_TEST_CACHE" in os.environ
         else ["--no-cache"])

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(
    os.path.abspath(__file__))))
MODELS = os.path.join(ROOT, "clients", "models")
DAEMON = os.environ.get("BLOBFIELDD") or os.path.join(ROOT, "build",
                                                      "blobfieldd")
LISTS = ("index.json", "expected.json")
# A file that a browser opens and an editor shows.
MOST_BYTES = 200000


def read(name):
    with open(os.path.join(MODELS, name), "rb") as file:
        return file.read()


def models():
    return sorted(name for name in os.listdir(MODELS)
                  if name.endswith(".json") and name not in LISTS)


def ask(url, path, body=None, method=None):
    """The status and the answer's JSON."""
    request = urllib.request.Request(url + path, body, method=method, headers={
        "Content-Type": "application/json", "Accept": "application/json"})
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.status, json.load(answer)
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)


def test_models_are_twenty_at_least_and_small(url):
    assert len(models()) >= 20, len(models())
    for name in models():
        assert len(read(name)) < MOST_BYTES, name
    print("measured: %d models, %d bytes in all, the largest %d" % (
        len(models()), sum(len(read(n)) for n in models()),
        max(len(read(n)) for n in models())))


def test_index_lists_every_model_once(url):
    index = json.loads(read("index.json"))
    assert sorted(entry["file"] for entry in index) == models()
    for entry in index:
        assert sorted(entry) == ["file", "note", "title"], entry
        assert entry["title"] and entry["note"].endswith("."), entry
    titles = [entry["title"] for entry in index]
    assert len(set(titles)) == len(titles)


def test_expected_knows_every_model(url):
    expected = json.loads(read("expected.json"))
    assert sorted(name + ".json" for name in expected) == models()
    for name, e in expected.items():
        assert sorted(e) == ["components", "genus"], name
        assert e["components"] >= 1 and e["genus"] >= 0, name


def test_every_model_is_accepted(url):
    for name in models():
        status, answer = ask(url, "/v1/scenes/" + name[:-5], read(name), "PUT")
        assert status in (200, 201), "%s: %s" % (name, answer)
        assert answer["name"], name


def test_every_model_has_a_surface_within_its_support(url):
    for name in models():
        ask(url, "/v1/scenes/" + name[:-5], read(name), "PUT")
        status, box = ask(url, "/v1/scenes/%s/bounds" % name[:-5])
        assert status == 200, "%s: %s" % (name, box)
        surface = box["surface"]
        assert surface, "%s has no bounded surface" % name
        for i in range(3):
            assert surface["min"][i] < surface["max"][i], name
            if box["bounded"]:
                assert box["min"][i] <= surface["min"][i], name
                assert surface["max"][i] <= box["max"][i], name


def test_every_model_is_inside_somewhere_and_outside_elsewhere(url):
    """Along lines through the surface's box."""
    for name in models():
        path = "/v1/scenes/" + name[:-5]
        ask(url, path, read(name), "PUT")
        surface = ask(url, path + "/bounds")[1]["surface"]
        low, high = surface["min"], surface["max"]
        side = 24
        points = [[low[i] + (high[i] - low[i]) * ((k // side ** i) % side + .5)
                   / side for i in range(3)] for k in range(side ** 3)]
        body = json.dumps({"points": points, "outputs": ["value"]}).encode()
        status, answer = ask(url, path + "/eval", body)
        assert status == 200, "%s: %s" % (name, answer)
        assert max(answer["value"]) > 0.5, name
        assert min(answer["value"]) < 0.5, name


def test_generated_models_are_what_generate_writes(url):
    """generate.py writes beside itself: run as a copy, elsewhere."""
    with tempfile.TemporaryDirectory() as folder:
        copy = os.path.join(folder, "generate.py")
        with open(copy, "wb") as file:
            file.write(read("generate.py"))
        subprocess.run([sys.executable, copy], check=True)
        written = [n for n in os.listdir(folder) if n.endswith(".json")]
        assert len(written) >= 5, written
        for name in written:
            with open(os.path.join(folder, name), "rb") as file:
                assert file.read() == read(name), name


def main():
    process = subprocess.Popen(
        [DAEMON, "--listen", "127.0.0.1:0", *CACHE, "--no-measure", "--data", ":memory:"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    url = process.stdout.readline().split()[-1]
    failed = 0
    try:
        for name, test in sorted(globals().items()):
            if not name.startswith("test_"):
                continue
            print("[ RUN      ] " + name, flush=True)
            try:
                test(url)
                print("[       OK ] " + name, flush=True)
            except Exception:
                failed += 1
                traceback.print_exc(file=sys.stdout)
                print("[  FAILED  ] " + name, flush=True)
    finally:
        process.terminate()
        process.wait(30)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
