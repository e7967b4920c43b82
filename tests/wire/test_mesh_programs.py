#!/usr/bin/python3
"""Meshes of every model, judged by programs that others wrote.

Starts the daemon ($BLOBFIELDD, else build/blobfieldd), keeps every document
that clients/models/expected.json names in it, and asks for meshes:

- admesh: all facets connected, nothing to repair;
- here: the number of parts and the genus are the ones expected;
- assimp: GLB, PLY, STL and OBJ are read, with as many faces;
- gltf-validator, where node and clients/web/node_modules have it: no error, no
  warning;
- rays: where /raycast says that a ray meets the surface, it meets the mesh,
  nearly.

Usage: test_mesh_programs.py [MODEL...]. Prints its cases as cmocka does.
"""
import json
import math
import os
import random
import re
import shutil
import struct
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

MODELS = "clients/models"
WEB = "clients/web"
FORMATS = ("glb", "stl", "ply", "obj")
# Of all models two formats, of each such one the others, too.
OTHER_FORMATS_EVERY = 4
RESOLUTION = 64
# Rays are cast at these, each one over a wide range of slopes and curvatures.
RAY_MODELS = ("letter-a", "handles", "tee", "creature", "cup", "torus-knot")
ORDER_MODELS = ("letter-a", "torus-knot")
RAYS = 300
# Sums of primitives that bend everywhere.
SMOOTH_MODELS = ("thousand", "torus-knot", "convolution", "handles-sum",
                 "metaballs", "tee")
# How far |f - iso| may be at any vertex (measured: 2.0e-4), and how far from
# the surface any may be, in cells (measured: 4e-4); but where the field jumps
# from one side of iso to the other within so many cells (measured: 1 vertex).
VALUE_NEAR = 1e-3
APART_MOST = 2e-3
JUMP_WITHIN = 5e-3
JUMPS_MOST = 3
# Normals of vertices that are not sharp are the gradient's (cos 8 degrees).
NORMAL_NEAR = 0.9903


class Skip(Exception):
    """A case that cannot be run here; the message says why."""


# --- the daemon --------------------------------------------------------------


class Daemon:
    """A ready daemon on a free port."""

    def __init__(self):
        program = os.environ.get("BLOBFIELDD", "build/blobfieldd")
        self.process = subprocess.Popen(
            [program, *CACHE, "--no-measure", "--data", ":memory:", "--listen", "127.0.0.1:0", "--quiet",
             "--no-measure"], stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        self.url = re.search(r"http://\S+", line).group(0)
        self.await_ready()

    def await_ready(self):
        for _ in range(3000):
            try:
                return self.get("/readyz")
            except urllib.error.HTTPError as err:
                if err.code != 503:
                    raise
            if self.process.poll() is not None:
                raise RuntimeError("the daemon has ended")
            try:
                self.process.wait(0.1)
            except subprocess.TimeoutExpired:
                pass
        raise RuntimeError("the daemon does not become ready")

    def ask(self, path, body=None, method=None, **headers):
        request = urllib.request.Request(self.url + path, body, method=method)
        for name, value in headers.items():
            request.add_header(name.replace("_", "-"), value)
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return answer.read()
        except urllib.error.HTTPError as err:
            if err.code == 503:
                raise
            raise RuntimeError("%s: %s" % (path, err.read())) from err

    def get(self, path):
        return self.ask(path)

    def post_json(self, path, value):
        return self.ask(path, json.dumps(value).encode(),
                        Content_Type="application/json")

    def stop(self):
        self.process.terminate()
        self.process.stdout.close()
        if self.process.wait(120) != 0:
            raise RuntimeError("the daemon ended with status %d"
                               % self.process.returncode)


class Model:
    """A document, its meshes as files, and what is known of it."""

    def __init__(self, daemon, name, expected, folder, formats):
        self.daemon = daemon
        self.name = name
        self.path = "/v1/scenes/" + name
        self.expected = expected
        with open(os.path.join(MODELS, name + ".json"), "rb") as f:
            daemon.ask(self.path, f.read(), "PUT",
                       Content_Type="application/json")
        self.files = {}
        for suffix in formats:
            self.files[suffix] = os.path.join(folder, name + "." + suffix)
            with open(self.files[suffix], "wb") as f:
                f.write(self.mesh(suffix))
        self.figures = read_figures(self.files["glb"])

    def mesh(self, suffix, resolution=None):
        resolution = resolution or self.expected.get("resolution", RESOLUTION)
        return self.daemon.post_json(self.path + "/mesh?format=" + suffix,
                                     {"resolution": resolution})


# --- meshes, read here -------------------------------------------------------


def parse_stl(data):
    """Triangles of three (x, y, z) each."""
    (count,) = struct.unpack_from("<I", data, 80)
    assert len(data) == 84 + 50 * count, "the file is cut"
    numbers = [struct.unpack_from("<9f", data, 84 + 50 * i + 12)
               for i in range(count)]
    return [(n[0:3], n[3:6], n[6:9]) for n in numbers]


def read_stl(path):
    with open(path, "rb") as f:
        return parse_stl(f.read())


def read_glb(path):
    """A GLB's scene and its buffer."""
    with open(path, "rb") as f:
        data = f.read()
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20:20 + length]), data[28 + length:]


def read_figures(path):
    """What a GLB says of itself."""
    return read_glb(path)[0]["asset"]["extras"]["blobfield"]


def read_attribute(path, name):
    """The bytes of float32 triples."""
    gltf, buffer = read_glb(path)
    primitive = gltf["meshes"][0]["primitives"][0]
    accessor = gltf["accessors"][primitive["attributes"][name]]
    view = gltf["bufferViews"][accessor["bufferView"]]
    return buffer[view["byteOffset"]:view["byteOffset"] + view["byteLength"]]


def weld(triangles):
    """Triangles of indices of distinct corners, and how many those are."""
    index = {}
    return [tuple(index.setdefault(corner, len(index)) for corner in triangle)
            for triangle in triangles], len(index)


def count_parts(triangles, vertices):
    parent = list(range(vertices))

    def find(i):
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for a, b, c in triangles:
        parent[find(a)] = parent[find(b)] = find(c)
    return sum(parent[i] == i for i in range(vertices))


def topology(path):
    """(components, genus) of a closed surface; asserts that it is one."""
    triangles, vertices = weld(read_stl(path))
    edges = set()
    for a, b, c in triangles:
        for edge in ((a, b), (b, c), (c, a)):
            assert edge not in edges, "an edge comes twice"
            edges.add(edge)
    for a, b in edges:
        assert (b, a) in edges, "an edge has one side"
    parts = count_parts(triangles, vertices)
    euler = vertices - len(edges) // 2 + len(triangles)
    return parts, parts - euler // 2


# --- programs ----------------------------------------------------------------


def run(*command, **more):
    done = subprocess.run(command, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True,
                          errors="replace", timeout=120, check=False, **more)
    return done.stdout


def need(program, package):
    if shutil.which(program) is None:
        raise Skip("there is no %s (Debian's package %s)" % (program, package))


def numbers_behind(text, label):
    found = re.search(re.escape(label) + r"\s*:\s*(-?\d+)(?:\s+(-?\d+))?",
                      text)
    assert found is not None, "no '%s' in:\n%s" % (label, text)
    return [int(n) for n in found.groups() if n is not None]


def test_every_part_is_closed_by_admesh(models):
    need("admesh", "admesh")
    for model in models:
        text = run("admesh", model.files["stl"])
        assert "All facets connected." in text, "%s:\n%s" % (model.name, text)
        for label in ("Total disconnected facets", "Degenerate facets",
                      "Edges fixed", "Facets removed", "Facets added",
                      "Facets reversed", "Backwards edges"):
            found = numbers_behind(text, label)
            assert not any(found), "%s: %s: %s" % (model.name, label, found)
        parts = numbers_behind(text, "Number of parts")[0]
        assert parts == model.figures["components"], \
            "%s: %d parts, not %d" % (model.name, parts,
                                      model.figures["components"])
    print("measured: %d models closed by admesh, %d facets in all" % (
        len(models), sum(m.figures["triangles"] for m in models)))


def test_every_format_is_read_by_assimp(models):
    need("assimp", "assimp-utils")
    for model in models:
        for suffix, path in model.files.items():
            text = run("assimp", "info", path)
            assert "Importing file ...                   OK" in text, \
                "%s, %s:\n%s" % (model.name, suffix, text)
            faces = numbers_behind(text, "Faces")[0]
            assert faces == model.figures["triangles"], \
                "%s, %s: %d faces, not %d" % (model.name, suffix, faces,
                                              model.figures["triangles"])


VALIDATE = """
const fs = require("fs");
let validator;
try {
  validator = require("gltf-validator");
} catch (e) {
  console.log("absent");
  process.exit(0);
}
(async () => {
  for (const file of process.argv.slice(1)) {
    const report = await validator.validateBytes(
      new Uint8Array(fs.readFileSync(file)), {maxIssues: 5});
    console.log(JSON.stringify({file, issues: report.issues,
      faces: report.info.totalTriangleCount}));
  }
})();
"""


def test_every_glb_is_valid(models):
    need("node", "nodejs")
    text = run("node", "-e", VALIDATE, *[os.path.abspath(m.files["glb"])
                                         for m in models],
               cwd=WEB if os.path.isdir(WEB) else None)
    if text.strip() == "absent":
        raise Skip("there is no gltf-validator in %s/node_modules" % WEB)
    reports = [json.loads(line) for line in text.splitlines()]
    assert len(reports) == len(models), text
    for model, report in zip(models, reports):
        issues = report["issues"]
        assert issues["numErrors"] == 0 and issues["numWarnings"] == 0, \
            "%s: %s" % (model.name, issues["messages"])
        assert report["faces"] == model.figures["triangles"], model.name


def test_every_genus_is_as_expected(models):
    wrong = []
    for model in models:
        parts, genus = topology(model.files["stl"])
        assert parts == model.figures["components"], model.name
        assert genus == model.figures["genus"], model.name
        for name, value in (("components", parts), ("genus", genus)):
            if model.expected.get(name, value) != value:
                wrong.append("%s: %s %d, not %d" % (
                    model.name, name, value, model.expected[name]))
    assert not wrong, "\n".join(wrong)


def evaluate(model, positions):
    """(value, gradient...) at float32 triples."""
    answer = model.daemon.ask(model.path + "/eval?outputs=value,gradient",
                              positions,
                              Content_Type="application/octet-stream",
                              Accept="application/octet-stream")
    return list(struct.iter_unpack("<4f", answer))


def is_jump(model, position, row):
    """Whether the field passes iso near position without being near it."""
    far = JUMP_WITHIN * model.figures["edge_length"]
    step = [far * c for c in unit(row[1:])]
    points = [[p + sign * s for p, s in zip(position, step)]
              for sign in (-1, 1)]
    sides = evaluate(model, struct.pack("<6f", *points[0], *points[1]))
    return (sides[0][0] - 0.5) * (sides[1][0] - 0.5) < 0.0


def test_vertices_are_on_the_surface(models):
    worst = furthest = 0.0
    jumps = []
    for model in models:
        data = read_attribute(model.files["glb"], "POSITION")
        rows = evaluate(model, data)
        edge = model.figures["edge_length"]
        error = max(abs(row[0] - 0.5) for row in rows)
        assert math.isclose(error, model.figures["largest_error"],
                            rel_tol=1e-3, abs_tol=1e-6), model.name
        for position, row in zip(struct.iter_unpack("<3f", data), rows):
            error = abs(row[0] - 0.5)
            apart = error / max(math.sqrt(dot(row[1:], row[1:])), 1e-6) / edge
            if error > VALUE_NEAR or apart > APART_MOST:
                assert is_jump(model, position, row), \
                    "%s: %s: %g, %g cells" % (model.name, position, error,
                                              apart)
                jumps.append(model.name)
                continue
            worst, furthest = max(worst, error), max(furthest, apart)
    print("measured: |f - iso| at vertices up to %.1e, %.1e cells from the "
          "surface; the field jumps at %d: %s" % (
              worst, furthest, len(jumps), " ".join(jumps)))
    assert len(jumps) <= JUMPS_MOST


def test_normals_are_the_gradients(models):
    """But those of sharp vertices, of which smooth models have none."""
    smooth = 0
    for model in models:
        rows = evaluate(model, read_attribute(model.files["glb"], "POSITION"))
        normals = struct.iter_unpack(
            "<3f", read_attribute(model.files["glb"], "NORMAL"))
        off = sum(dot(normal, unit([-g for g in row[1:]])) < NORMAL_NEAR
                  for normal, row in zip(normals, rows)
                  if dot(row[1:], row[1:]) > 0.0)
        sharp = model.figures["sharp_vertices"]
        assert off <= sharp, "%s: %d normals are off, %d vertices sharp" % (
            model.name, off, sharp)
        if model.name in SMOOTH_MODELS:
            assert sharp == 0, "%s: %d sharp vertices" % (model.name, sharp)
        smooth += sharp == 0
    print("measured: %d of %d models have no sharp vertex" % (
        smooth, len(models)))


# --- rays --------------------------------------------------------------------


def sub(a, b):
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0])


def unit(a):
    length = math.sqrt(dot(a, a))
    return (a[0] / length, a[1] / length, a[2] / length)


class Hierarchy:
    """Triangles in boxes of boxes, halved along their longest side."""

    LEAF = 8

    def __init__(self, triangles):
        self.least = tuple(min(c[k] for t in triangles for c in t)
                           for k in range(3))
        self.most = tuple(max(c[k] for t in triangles for c in t)
                          for k in range(3))
        self.triangles = self.halves = None
        if len(triangles) <= self.LEAF:
            self.triangles = triangles
            return
        axis = max(range(3), key=lambda k: self.most[k] - self.least[k])
        triangles = sorted(triangles,
                           key=lambda t: t[0][axis] + t[1][axis] + t[2][axis])
        middle = len(triangles) // 2
        self.halves = (Hierarchy(triangles[:middle]),
                       Hierarchy(triangles[middle:]))

    def meets(self, origin, inverse, most):
        least = 0.0
        for k in range(3):
            a = (self.least[k] - origin[k]) * inverse[k]
            b = (self.most[k] - origin[k]) * inverse[k]
            least = max(least, min(a, b))
            most = min(most, max(a, b))
        return least <= most

    def cast(self, origin, direction, inverse, best):
        """The nearest (distance, |cosine to the facet's normal|)."""
        if not self.meets(origin, inverse, best[0]):
            return best
        if self.halves is not None:
            for half in self.halves:
                best = half.cast(origin, direction, inverse, best)
            return best
        for triangle in self.triangles:
            hit = meet_triangle(origin, direction, triangle)
            if hit is not None and hit[0] < best[0]:
                best = hit
        return best


def meet_triangle(origin, direction, triangle):
    """Moeller and Trumbore 1997."""
    e1, e2 = sub(triangle[1], triangle[0]), sub(triangle[2], triangle[0])
    normal = cross(e1, e2)
    slope = dot(normal, direction)
    if slope == 0.0:
        return None
    p = cross(direction, e2)
    s = sub(origin, triangle[0])
    u = dot(s, p) / dot(e1, p)
    q = cross(s, e1)
    v = dot(direction, q) / dot(e1, p)
    t = dot(e2, q) / dot(e1, p)
    if u < 0.0 or v < 0.0 or u + v > 1.0 or t <= 0.0:
        return None
    return t, abs(slope) / math.sqrt(dot(normal, normal))


def random_rays(rng, least, most):
    """From a sphere about the box towards places in it."""
    centre = [(a + b) / 2 for a, b in zip(least, most)]
    radius = math.dist(least, most)
    rays = []
    for _ in range(RAYS):
        away = unit([rng.gauss(0.0, 1.0) for _ in range(3)])
        origin = [c + radius * a for c, a in zip(centre, away)]
        target = [rng.uniform(a, b) for a, b in zip(least, most)]
        # As float32, which both sides then work with.
        rays.append(struct.unpack("<6f", struct.pack(
            "<6f", *origin, *unit(sub(target, origin)))))
    return rays


def ask_rays(model, rays):
    """(distance, normal) of each, or None."""
    body = b"".join(struct.pack("<6f", *ray) for ray in rays)
    answer = model.daemon.ask(model.path + "/raycast", body,
                        Content_Type="application/octet-stream",
                        Accept="application/octet-stream")
    assert len(answer) == 52 * len(rays)
    hits = []
    for i in range(len(rays)):
        row = struct.unpack_from("<13f", answer, 52 * i)
        hits.append((row[1], row[6:9]) if row[0] else None)
    return hits


def compare(ray, hit, tree):
    """How far, along the normal, a ray's places on surface and mesh are apart;
    None: it meets neither, infinite: only one."""
    direction = unit(ray[3:6])
    inverse = [1.0 / d if d else math.inf for d in direction]
    t, cosine = tree.cast(ray[:3], direction, inverse, (math.inf, 0.0))
    if hit is None and t == math.inf:
        return None
    if hit is None or t == math.inf:
        return math.inf
    return abs(hit[0] - t) * cosine


def compare_all(rays, hits, tree):
    apart = [compare(ray, hit, tree) for ray, hit in zip(rays, hits)]
    return [d for d in apart if d is not None]


def test_rays_agree_with_meshes(models):
    """Beside a surface of curvature k, facets lie within k h^2 / 8 of it, of
    edges h. Rays that all but touch may pass one and meet the other, or meet a
    part further on."""
    rng = random.Random(1)
    for model in models:
        if model.name not in RAY_MODELS:
            continue
        tree = Hierarchy(read_stl(model.files["stl"]))
        rays = random_rays(rng, tree.least, tree.most)
        edge = model.figures["edge_length"]
        apart = compare_all(rays, ask_rays(model, rays), tree)
        near = [d for d in apart if d <= edge]
        print("measured: %s: %d rays meet surface and mesh, within %.3f cells "
              "along the normal; %d differ" % (
                  model.name, len(near), max(near) / edge,
                  len(apart) - len(near)))
        assert len(near) > RAYS / 20
        # Measured: 0.138 cells, of the creature.
        assert max(near) < 0.25 * edge, model.name
        # Measured: none or 1 of 300.
        assert len(apart) - len(near) <= 0.01 * len(rays), model.name


def test_rays_agree_to_second_order(models):
    """Half the cells' size: a quarter of the distance."""
    rng = random.Random(2)
    for model in models:
        if model.name not in ORDER_MODELS:
            continue
        trees = [Hierarchy(parse_stl(model.mesh("stl", n))) for n in (32, 64)]
        rays = random_rays(rng, trees[1].least, trees[1].most)
        hits = ask_rays(model, rays)
        means = []
        for tree in trees:
            near = [d for d in compare_all(rays, hits, tree)
                    if d < 0.1 * math.dist(tree.least, tree.most)]
            means.append(sum(near) / len(near))
        print("measured: %s: rays meet the mesh %.2e from the surface, %.2e "
              "with cells of half the size" % (model.name, *means))
        # Measured: 0.22 and 0.25.
        assert means[1] < 0.4 * means[0], model.name


# --- cases -------------------------------------------------------------------


def run_case(name, case):
    print("[ RUN      ] " + name)
    try:
        case()
    except Skip as why:
        print("skipped: %s" % why)
        print("[  SKIPPED ] " + name)
        return True
    except Exception:
        print(traceback.format_exc())
        print("[  FAILED  ] " + name)
        return False
    print("[       OK ] " + name, flush=True)
    return True


def main():
    with open(os.path.join(MODELS, "expected.json")) as f:
        expected = json.load(f)
    names = sys.argv[1:] or sorted(expected)
    daemon = Daemon()
    with tempfile.TemporaryDirectory() as folder:
        models = []

        def make():
            for i, name in enumerate(names):
                formats = FORMATS[:2] if i % OTHER_FORMATS_EVERY else FORMATS
                models.append(Model(daemon, name, expected.get(name, {}),
                                    folder, formats))
            assert len(sys.argv) > 1 or len(models) >= 20, \
                "%d models are not 20" % len(models)

        fine = run_case("test_every_model_is_meshed", make)
        for case in (test_every_part_is_closed_by_admesh,
                     test_every_format_is_read_by_assimp,
                     test_every_glb_is_valid,
                     test_every_genus_is_as_expected,
                     test_vertices_are_on_the_surface,
                     test_normals_are_the_gradients,
                     test_rays_agree_with_meshes,
                     test_rays_agree_to_second_order):
            if models:
                fine &= run_case(case.__name__,
                                 lambda case=case: case(models))
        fine &= run_case("test_the_daemon_ends_well", daemon.stop)
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
