"""The Blender add-on in a real Blender, against a real daemon:

    blender --background --factory-startup --python tests/blender/test_addon.py

or tests/blender/test_addon.sh, which keeps Blender's own settings out of it.
The add-on is the one of clients/blender/make_zip.py, installed as users
install it if BLENDER_USER_SCRIPTS is a folder of the test's own. BLOBFIELDD is
the daemon, build/blobfieldd unless set. Prints its cases as cmocka does.

Blender runs no timers in the background, so the tests turn the add-on's own.
"""
import importlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
import traceback

import bmesh
import bpy
import numpy as np
from mathutils import Vector

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(
    os.path.abspath(__file__))))
DAEMON = os.environ.get("BLOBFIELDD") or os.path.join(ROOT, "build",
                                                      "blobfieldd")
NAME = "blobfield_addon"


class Daemon:
    def __init__(self):
        self.process = subprocess.Popen(
            [DAEMON, "--listen", "127.0.0.1:0", "--no-cache", "--no-measure", "--data", ":memory:"],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.url = self.process.stdout.readline().split()[-1]

    def stop(self):
        self.process.terminate()
        status = self.process.wait(30)
        assert status == 0, f"the daemon ended with {status}"


def install(folder):
    """Makes the zip and installs it; the package."""
    archive = os.path.join(folder, NAME + ".zip")
    subprocess.run(["/usr/bin/python3", os.path.join(
        ROOT, "clients/blender/make_zip.py"), archive], check=True)
    if os.environ.get("BLENDER_USER_SCRIPTS"):
        bpy.ops.preferences.addon_install(filepath=archive)
        bpy.ops.preferences.addon_enable(module=NAME)
    else:
        shutil.unpack_archive(archive, folder)
        sys.path.insert(0, folder)
        importlib.import_module(NAME).register()
    return sys.modules[NAME]


def module(name):
    return sys.modules[f"{NAME}.{name}"]


def scene():
    return bpy.context.scene


def settings():
    return scene().blobfield


def state():
    return module("live").state


def fresh():
    """An empty scene with our settings, nothing running."""
    live = module("live")
    live.stop()
    settings().live = False
    for ob in list(bpy.data.objects):
        bpy.data.objects.remove(ob)
    for c in list(bpy.data.collections):
        bpy.data.collections.remove(c)
    for t in list(bpy.data.texts):
        bpy.data.texts.remove(t)
    s = settings()
    for name in s.bl_rna.properties.keys():
        if name not in ("rna_type", "name"):
            s.property_unset(name)
    s.url = daemon.url
    s.resolution = 32
    live.state.shown = live.state.dirty = None
    live.state.say("")


def empty(name, location, size=1.0, display="SPHERE"):
    ob = bpy.data.objects.new(name, None)
    ob.empty_display_type = display
    ob.empty_display_size = size
    ob.location = location
    scene().collection.objects.link(ob)
    bpy.context.view_layer.update()
    return ob


def curve(name, places, kind="POLY", radii=None, depth=0.0):
    data = bpy.data.curves.new(name, "CURVE")
    data.dimensions = "3D"
    data.bevel_depth = depth
    spline = data.splines.new(kind)
    points = spline.bezier_points if kind == "BEZIER" else spline.points
    points.add(len(places) - 1)
    for i, (p, at) in enumerate(zip(points, places)):
        p.co = at if kind == "BEZIER" else tuple(at) + (1,)
        p.radius = radii[i] if radii else 1.0
        if kind == "BEZIER":
            p.handle_left_type = p.handle_right_type = "AUTO"
    ob = bpy.data.objects.new(name, data)
    scene().collection.objects.link(ob)
    bpy.context.view_layer.update()
    return ob


def remesh():
    """Through the operator; the target's mesh."""
    assert bpy.ops.blobfield.remesh(wait=True) == {"FINISHED"}, \
        [state().message] + state().faults
    return settings().target.data


def check_closed(mesh):
    """Every edge has two faces that run along it in opposite directions."""
    b = bmesh.new()
    b.from_mesh(mesh)
    assert all(e.is_manifold and e.is_contiguous for e in b.edges)
    assert all(v.is_manifold for v in b.verts)
    volume = b.calc_volume(signed=True)
    euler = len(b.verts) - len(b.edges) + len(b.faces)
    b.free()
    return volume, euler


def width(mesh, axis):
    a = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", a)
    a = a.reshape(-1, 3)[:, axis]
    return a.min(), a.max()


def near(value, expected, tolerance):
    assert abs(value - expected) <= tolerance, \
        f"{value} is not {expected} to {tolerance}"


def test_addon_registers():
    assert hasattr(bpy.types.Scene, "blobfield")
    assert "BLOBFIELD_PT_panel" in dir(bpy.types)
    assert module("wire").blobfield.__name__ == NAME + ".blobfield"
    assert settings().operator == "camel"


def test_addon_checks_the_connection():
    assert bpy.ops.blobfield.check() == {"FINISHED"}
    assert state().message.startswith("blobfield "), state().message
    settings().url = "http://127.0.0.1:1"
    assert bpy.ops.blobfield.check() == {"CANCELLED"}
    assert state().failed
    assert "is blobfieldd running" in state().message, state().message
    settings().url = "not an address:x"
    assert bpy.ops.blobfield.check() == {"CANCELLED"}
    assert "not an address" in state().message, state().message


def test_tree_of_objects():
    ball = empty("ball", (1, 2, 3), 0.5)
    ball.color = (1, 0, 0, 1)
    empty("block", (4, 0, 0), 2, "CUBE").blobfield.cut = True
    curve("tube", [(0, 0, 0), (1, 0, 0), (1, 1, 0)], radii=[1, 2, 2],
          depth=0.1)
    tree = module("tree").from_collection(scene().collection, "organic")
    root = tree.document["root"]
    assert root["type"] == "difference" and root["operator"] == "organic"
    whole, cut = root["children"]
    assert [c["type"] for c in whole["children"]] == ["point", "union"]
    point, tube = whole["children"]
    assert point["radius"] == 0.5
    assert point["matrix"][12:] == [1, 2, 3, 1]
    assert point["material"] == {"color": [1, 0, 0]}
    first, second = tube["children"]
    near(first["radii"][1], 0.2, 1e-7)
    near(second["radius"], 0.2, 1e-7)
    assert cut["half_size"] == [2, 2, 2]
    assert tree.origin("/root/children/0/children/1/children/0/radii") \
        == ("tube", "/children/0/radii")
    assert tree.origin("/root/children/1") == ("block", "")
    assert tree.origin("/operators/x") == (None, "/operators/x")


def test_tree_of_nested_collections():
    inner = bpy.data.collections.new("inner")
    scene().collection.children.link(inner)
    inner.blobfield.operator = "sum"
    for i in range(2):
        ob = empty(f"in{i}", (i, 0, 0))
        scene().collection.objects.unlink(ob)
        inner.objects.link(ob)
    empty("out", (0, 0, 0))
    tree = module("tree").from_collection(scene().collection, "camel")
    out, sums = tree.document["root"]["children"]
    assert out["type"] == "point" and sums["type"] == "sum"
    assert tree.origin("/root/children/1/children/1/radius") == (
        "in1", "/radius")


def test_tree_of_bezier_cyclic():
    c = curve("ring", [(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)],
              "BEZIER", depth=0.1)
    c.data.splines[0].use_cyclic_u = True
    c.data.splines[0].resolution_u = 6
    bpy.context.view_layer.update()
    segments = module("tree").object_node(c)["children"]
    assert len(segments) == 24, len(segments)
    assert segments[-1]["b"] == segments[0]["a"]
    # An automatic Bezier circle: of radius 1 to a few percent.
    for s in segments:
        near(math.hypot(*s["a"]), 1, 0.05)


def test_tree_colours():
    tree = module("tree")
    c = curve("tube", [(0, 0, 0), (1, 0, 0)])
    assert tree.object_color(c) is None
    c.color = (0.5, 0, 2, 1)
    assert tree.object_color(c) == [0.5, 0, 1]
    material = bpy.data.materials.new("green")
    material.diffuse_color = (0, 0.5, 0, 1)
    c.data.materials.append(material)
    assert tree.object_color(c) == [0, 0.5, 0]
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs[
        "Base Color"].default_value = (0.25, 0.75, 0, 1)
    assert tree.object_color(c) == [0.25, 0.75, 0]


def test_tree_refusals():
    error = module("tree").TreeError
    live = module("live")
    assert not live.begin(scene())
    assert "add empties" in state().message and state().failed
    flat = empty("flat", (0, 0, 0))
    flat.scale = (1, 1, 0)
    bpy.context.view_layer.update()
    for prepare, words in (
            (lambda: None, "'flat' is scaled to nothing"),
            (lambda: setattr(flat.blobfield, "kind", "NODE"), "not JSON"),
            (lambda: setattr(flat.blobfield, "node", '{"type": "point", '
             '"scale": 2}'), "may have no 'scale'")):
        prepare()
        try:
            module("tree").from_collection(scene().collection, "camel")
        except error as e:
            assert words in str(e), str(e)
        else:
            raise AssertionError("not refused: " + words)
    curve("spline", [(0, 0, 0), (1, 0, 0)], "NURBS")
    flat.blobfield.kind = "NONE"
    try:
        module("tree").from_collection(scene().collection, "camel")
    except error as e:
        assert "NURBS" in str(e)


def test_remesh_of_a_ball():
    empty("ball", (0, 0, 0), 1).color = (0, 0.5, 1, 1)
    mesh = remesh()
    assert len(mesh.vertices) > 1000, len(mesh.vertices)
    volume, euler = check_closed(mesh)
    assert euler == 2
    # Of the polyhedron within, 32 cells across.
    near(volume, 4 / 3 * math.pi, 0.05)
    mesh.calc_normals_split()
    worst = min(Vector(mesh.vertices[loop.vertex_index].co).normalized().dot(
        loop.normal) for loop in mesh.loops)
    assert worst > 0.999, worst  # custom normals are the field's
    rgb = mesh.color_attributes["Color"].data[0].color
    for value, expected in zip(rgb, (0, 0.5, 1, 1)):
        near(value, expected, 1e-2)
    assert mesh.materials[0].name == "Blobfield"
    print(f"measured: {len(mesh.vertices)} vertices, {state().message}")


def test_remesh_of_empties_and_a_curve():
    empty("a", (0, 0, 0), 0.5)
    empty("b", (2, 0, 0), 0.5)
    curve("tube", [(0, 0, 0), (1, 0, 1), (2, 0, 0)], radii=[1, 2, 1],
          depth=0.15)
    mesh = remesh()
    volume, euler = check_closed(mesh)
    assert volume > 0 and euler == 2, (volume, euler)
    low, high = width(mesh, 0)
    assert low < -0.45 and high > 2.45, (low, high)


def test_remesh_of_a_cut_and_a_cube():
    cube = bpy.data.meshes.new("cube")
    b = bmesh.new()
    bmesh.ops.create_cube(b, size=2)
    b.to_mesh(cube)
    b.free()
    ob = bpy.data.objects.new("cube", cube)
    ob.blobfield.falloff = 0.3
    scene().collection.objects.link(ob)
    hole = curve("hole", [(0, 0, -2), (0, 0, 2)], depth=0.5)
    hole.blobfield.cut = True
    settings().operator = "sharp"
    mesh = remesh()
    volume, euler = check_closed(mesh)
    assert euler == 0, euler  # a handle
    near(volume, 8 - 2 * math.pi * 0.25, 0.05)
    assert len(remesh().vertices) == len(mesh.vertices)
    assert sum(ob.type == "MESH" for ob in bpy.data.objects) == 2


def test_remesh_without_normals_and_colours():
    empty("ball", (0, 0, 0), 1)
    settings().smooth = settings().colors = False
    mesh = remesh()
    check_closed(mesh)
    assert not mesh.polygons[0].use_smooth
    assert not mesh.color_attributes


def test_live_update_after_moving():
    a = empty("a", (0, 0, 0), 1)
    empty("b", (1.5, 0, 0), 1)
    settings().live = True
    bpy.context.view_layer.update()
    assert module("live").wait()
    before = width(settings().target.data, 0)
    near(before[1], 2.5, 0.02)
    jobs = state().count
    a.location = (-3, 0, 0)
    bpy.context.view_layer.update()  # as the user's drag does
    assert state().dirty is not None
    began = time.monotonic()
    assert module("live").wait()
    seconds = time.monotonic() - began
    near(width(settings().target.data, 0)[0], -4, 0.02)
    check_closed(settings().target.data)
    assert state().count == jobs + 1, state().count
    # What we made ourselves is no change of the model.
    bpy.context.view_layer.update()
    for _ in range(10):
        module("live").pump()
        time.sleep(0.03)
    assert state().count == jobs + 1, state().count
    print(f"measured: live update {seconds * 1e3:.0f} ms after the change")


def test_live_follows_a_text():
    text = bpy.data.texts.new("model")
    text.write('{"format": "blobfield/1", "root": {"type": "point", '
               '"center": [0,0,0], "radius": 1}}')
    settings().source = "TEXT"
    settings().text = text
    settings().live = True
    module("live").pump()
    time.sleep(0.15)
    assert module("live").wait()
    near(width(settings().target.data, 2)[1], 1, 0.01)
    text.from_string(text.as_string().replace('"radius": 1', '"radius": 2'))
    last = time.monotonic() + 30
    while time.monotonic() < last and \
            width(settings().target.data, 2)[1] < 1.5:
        module("live").pump()
        time.sleep(0.02)
    near(width(settings().target.data, 2)[1], 2, 0.02)


def test_live_follows_an_animation():
    ball = empty("ball", (0, 0, 0), 1)
    for frame, x in ((1, 0), (11, 4)):
        ball.location.x = x
        ball.keyframe_insert("location", frame=frame)
    scene().frame_set(1)
    settings().live = True
    assert module("live").wait()
    near(width(settings().target.data, 0)[1], 1, 0.02)
    scene().frame_set(11)
    assert module("live").wait()
    near(width(settings().target.data, 0)[1], 5, 0.02)


def test_stale_results_are_dropped():
    live = module("live")
    ball = empty("ball", (0, 0, 0), 1)
    remesh()
    ball.location = (5, 0, 0)
    bpy.context.view_layer.update()
    live.begin(scene())
    first = live.state.job
    ball.location = (9, 0, 0)
    bpy.context.view_layer.update()
    live.begin(scene())
    assert first.cancellation.cancelled
    # A result that had already come when its job was superseded.
    fake = module("wire").blobfield.Mesh(
        np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    live.state.results.put((first.number, fake))
    assert live.wait()
    near(width(settings().target.data, 0)[1], 10, 0.02)


def test_wrong_object_is_named():
    empty("good", (0, 0, 0), 1)
    mesh = remesh()
    count = len(mesh.vertices)
    bad = empty("wonky", (0, 0, 0), 1)
    bad.blobfield.kind = "NODE"
    bad.blobfield.node = '{"type": "point", "center": [0, 0], "radius": 1}'
    assert bpy.ops.blobfield.remesh(wait=True) == {"CANCELLED"}
    assert state().failed and "422" in state().message, state().message
    assert state().faults == ["'wonky' /center: must have 3 numbers, not 2"], \
        state().faults
    assert len(settings().target.data.vertices) == count  # the old one stays


def test_wrong_document_is_placed():
    text = bpy.data.texts.new("model")
    text.write('{"format": "blobfield/1", "root": {"type": "ball"}}')
    settings().source = "TEXT"
    settings().text = text
    assert bpy.ops.blobfield.remesh(wait=True) == {"CANCELLED"}
    assert state().faults[0].startswith("/root/type: "), state().faults
    text.from_string("{")
    assert bpy.ops.blobfield.remesh(wait=True) == {"CANCELLED"}
    assert "400" in state().message, state().message


def test_file_document():
    settings().source = "FILE"
    assert bpy.ops.blobfield.remesh(wait=True) == {"CANCELLED"}
    settings().path = "/nowhere/model.json"
    assert bpy.ops.blobfield.remesh(wait=True) == {"CANCELLED"}
    assert "No such file" in state().message, state().message
    settings().path = os.path.join(ROOT, "clients/curl/letter-a.json")
    _, euler = check_closed(remesh())
    assert euler == 0, euler  # the A has one handle


def test_document_to_text():
    empty("ball", (0, 0, 0), 1)
    assert bpy.ops.blobfield.to_text() == {"FINISHED"}
    document = json.loads(settings().text.as_string())
    assert document["root"]["type"] == "point"
    settings().source = "TEXT"
    check_closed(remesh())


def test_no_server_is_told():
    empty("ball", (0, 0, 0), 1)
    settings().url = "http://127.0.0.1:1"
    assert bpy.ops.blobfield.remesh(wait=True) == {"CANCELLED"}
    assert "is blobfieldd running" in state().message, state().message


def test_cancel():
    empty("ball", (0, 0, 0), 1)
    settings().resolution = 300
    module("live").begin(scene())
    job = state().job
    assert bpy.ops.blobfield.cancel() == {"FINISHED"}
    job.join(20)
    assert not job.is_alive()
    module("live").pump()
    assert settings().target is None and state().message == "cancelled"


def test_unregister_leaves_nothing():
    """The last one."""
    empty("ball", (0, 0, 0), 1)
    remesh()
    client = module("wire").blobfield.Client(daemon.url)
    assert len(list(client.scenes())) == 1
    live = module("live")
    if os.environ.get("BLENDER_USER_SCRIPTS"):
        bpy.ops.preferences.addon_disable(module=NAME)
    else:
        sys.modules[NAME].unregister()
    assert not hasattr(bpy.types.Scene, "blobfield")
    assert live.on_depsgraph_update not in \
        bpy.app.handlers.depsgraph_update_post
    assert live.on_frame_change not in bpy.app.handlers.frame_change_post
    assert not bpy.app.timers.is_registered(live.pump)
    assert not list(client.scenes())
    client.close()


def main():
    global daemon
    failed = 0
    daemon = Daemon()
    folder = tempfile.mkdtemp()
    try:
        install(folder)
        for name, case in list(globals().items()):
            if not name.startswith("test_"):
                continue
            print(f"[ RUN      ] {name}", flush=True)
            try:
                fresh()
                case()
                print(f"[       OK ] {name}", flush=True)
            except Exception:
                traceback.print_exc(file=sys.stdout)
                print(f"[  FAILED  ] {name}", flush=True)
                failed += 1
        daemon.stop()
    except Exception:
        traceback.print_exc(file=sys.stdout)
        failed += 1
        daemon.process.kill()
    finally:
        shutil.rmtree(folder)
    sys.stdout.flush()
    os._exit(1 if failed else 0)  # Blender would make it 0


main()
