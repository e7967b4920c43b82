"""Remeshing beside the user's work.

A change marks the model dirty; a timer on the main thread, a little later,
makes the document anew and, if it is another one, hands it to a thread, which
asks the daemon and puts what it gets into a queue; the timer takes it from
there. Only the main thread touches Blender's data. A job that is superseded
is cancelled if it has run for PATIENCE_S already (younger ones are let finish,
so that something moves while the user drags); of cancelled ones nothing is
shown.
"""
import os
import queue
import threading
import time
import uuid

import bpy

from . import preferences, target, tree
from .wire import blobfield

DEBOUNCE_S = 0.12
PATIENCE_S = 2.0
TICK_S = 0.05
# What a text block or a file says is looked at as often as this.
LOOK_S = 0.5


class Order:
    """What a job needs to know: plain values only."""

    def __init__(self, scene, made):
        s = scene.blobfield
        self.scene = scene.name
        self.url = s.url
        self.token = preferences.token(s.url)
        self.made = made  # a tree.Tree, or the user's own text
        self.text = blobfield.build.document_bytes(
            made.document if isinstance(made, tree.Tree) else made)
        self.options = {
            "resolution": s.resolution, "iso": s.iso, "features": s.features,
            "normals": s.smooth, "colors": s.colors}
        self.key = (self.url, self.text, tuple(self.options.items()))

    def place(self, fault):
        """A fault's place in the user's words."""
        if isinstance(self.made, tree.Tree):
            name, below = self.made.origin(fault.pointer)
            if name is not None:
                return f"'{name}' {below}".rstrip()
        return fault.pointer or "the document"


class Job(threading.Thread):
    """One order, in a thread of its own."""

    def __init__(self, number, order, results):
        super().__init__(name=f"blobfield {number}", daemon=True)
        self.number = number
        self.order = order
        self.results = results
        self.began = time.monotonic()
        self.cancellation = blobfield.Cancellation()
        self.stage = ""
        self.done = 0.0
        self.seconds = 0.0

    def run(self):
        try:
            with blobfield.Client(self.order.url, connect_timeout=3,
                                  retry_for=10,
                                  token=self.order.token) as client:
                scene = client.scene(state.scene_id).put(self.order.text)
                got = scene.mesh(progress=self._progress,
                                 cancel=self.cancellation,
                                 **self.order.options)
        except Exception as e:  # shown in the panel, whatever it is
            got = e
        self.seconds = time.monotonic() - self.began
        self.results.put((self.number, got))

    def _progress(self, stage, done):
        self.stage = stage
        self.done = done


class State:
    """All there is of a session, besides what .blend files keep."""

    def __init__(self):
        self.scene_id = "blender-" + uuid.uuid4().hex[:12]
        self.results = queue.Queue()
        self.count = 0         # jobs so far; also the number of the latest
        self.job = None        # the one that runs
        self.dirty = None      # since when, None: clean
        self.looked = 0.0      # when text or file were looked at
        self.shown = None      # key of the order last begun
        self.used = set()      # addresses that have our scene
        self.message = ""
        self.faults = []       # lines
        self.failed = False

    def say(self, message, faults=(), failed=False):
        self.message = message
        self.faults = list(faults)
        self.failed = failed
        redraw()


state = State()


def redraw():
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def make(scene):
    """The scene's Tree, or the document's bytes. TreeError."""
    s = scene.blobfield
    if s.source == "OBJECTS":
        return tree.from_collection(s.collection or scene.collection,
                                    s.operator, s.target)
    if s.source == "TEXT":
        if s.text is None:
            raise tree.TreeError("choose the text block with the document")
        return s.text.as_string().encode()
    if not s.path:
        raise tree.TreeError("choose the file with the document")
    try:
        with open(bpy.path.abspath(s.path), "rb") as file:
            return file.read()
    except OSError as e:
        raise tree.TreeError(f"{os.path.basename(s.path)}: {e.strerror}") \
            from e


def begin(scene, force=True):
    """Starts a job, unless what is shown is what it would show. True if one
    runs for the present model."""
    state.dirty = None
    try:
        order = Order(scene, make(scene))
    except tree.TreeError as e:
        stop()
        state.shown = None
        state.say(str(e), failed=True)
        return False
    if not force and order.key == state.shown:
        return state.job is not None
    stop()
    state.shown = order.key
    state.used.add(order.url)
    state.count += 1
    state.job = Job(state.count, order, state.results)
    state.job.start()
    ensure_timer()
    return True


def stop():
    """Cancels what runs; its result will be dropped."""
    if state.job is not None:
        state.job.cancellation.cancel()
        state.job = None


def touch():
    """Something may have changed."""
    if state.dirty is None:
        state.dirty = time.monotonic()
    ensure_timer()


def pump():
    """One turn of the timer: results in, changes out. Answers when to come
    again, None if there is nothing to wait for."""
    _take_results()
    scene = bpy.context.scene
    live = scene.blobfield.live
    now = time.monotonic()
    if live and scene.blobfield.source != "OBJECTS" \
            and now - state.looked > LOOK_S:
        state.looked = now
        if state.dirty is None:
            state.dirty = now - DEBOUNCE_S
    if live and state.dirty is not None \
            and now - state.dirty >= DEBOUNCE_S \
            and (state.job is None or now - state.job.began > PATIENCE_S):
        begin(scene, force=False)
    if state.job is not None:
        _tell_progress(state.job)
        return TICK_S
    if state.dirty is not None and live:
        return TICK_S
    return LOOK_S if live and scene.blobfield.source != "OBJECTS" else None


def _take_results():
    while True:
        try:
            number, got = state.results.get_nowait()
        except queue.Empty:
            return
        job = state.job
        if job is None or job.number != number:
            continue  # stale
        state.job = None
        if isinstance(got, Exception):
            _tell_failure(job.order, got)
        else:
            _show(job, got)


def _show(job, mesh):
    scene = bpy.data.scenes.get(job.order.scene)
    if scene is None:
        return
    target.apply(scene, mesh, scene.blobfield.smooth)
    if not len(mesh.triangles):
        state.say(f"no surface ({job.seconds:.2f} s)")
        return
    state.say(f"{len(mesh.vertices):,} vertices, "
              f"{len(mesh.triangles):,} triangles, {job.seconds:.2f} s")


def _tell_failure(order, e):
    if isinstance(e, blobfield.ProblemError):
        faults = [f"{order.place(f)}: {f.detail}" for f in e.errors]
        state.say(f"{e.title} ({e.status})",
                  faults or [e.detail], failed=True)
    elif isinstance(e, (blobfield.BlobfieldError, ValueError)):
        state.say(str(e), failed=True)
        if isinstance(e, blobfield.ConnectionFailed):
            state.shown = None  # to be tried again
    else:
        state.say(f"{type(e).__name__}: {e}", failed=True)


def _tell_progress(job):
    if time.monotonic() - job.began > 0.3 and job.stage:
        message = f"{job.stage} {job.done:.0%}"
        if message != state.message:
            state.say(message)


def wait(timeout=120.0):
    """Pumps until nothing runs: for scripts. False after timeout seconds."""
    last = time.monotonic() + timeout
    while state.job is not None or (state.dirty is not None
                                    and bpy.context.scene.blobfield.live):
        if time.monotonic() > last:
            return False
        pump()
        time.sleep(0.01)
    return True


@bpy.app.handlers.persistent
def on_depsgraph_update(scene, depsgraph):
    s = scene.blobfield
    if not s.live or bpy.app.is_job_running("RENDER"):
        return  # a render calls handlers from a thread of its own
    own = {s.target, s.target.data} if s.target else set()
    if any(u.id.original not in own for u in depsgraph.updates):
        touch()


@bpy.app.handlers.persistent
def on_frame_change(scene, _):
    if scene.blobfield.live and not bpy.app.is_job_running("RENDER"):
        touch()


@bpy.app.handlers.persistent
def on_load(_):
    """Another file: nothing of the last one counts."""
    stop()
    state.dirty = state.shown = None
    state.say("")
    if bpy.context.scene.blobfield.live:
        touch()


def ensure_timer():
    if not bpy.app.timers.is_registered(pump):
        bpy.app.timers.register(pump, first_interval=TICK_S)


def forget():
    """Takes our scene off the daemons that have it."""
    for url in state.used:
        try:
            with blobfield.Client(url, timeout=2, connect_timeout=1,
                                  retry_for=0,
                                  token=preferences.token(url)) as client:
                client.scene(state.scene_id).delete()
        except (blobfield.BlobfieldError, ValueError):
            pass
    state.used.clear()


def register():
    bpy.app.handlers.depsgraph_update_post.append(on_depsgraph_update)
    bpy.app.handlers.frame_change_post.append(on_frame_change)
    bpy.app.handlers.load_post.append(on_load)


def unregister():
    stop()
    forget()
    bpy.app.handlers.depsgraph_update_post.remove(on_depsgraph_update)
    bpy.app.handlers.frame_change_post.remove(on_frame_change)
    bpy.app.handlers.load_post.remove(on_load)
    if bpy.app.timers.is_registered(pump):
        bpy.app.timers.unregister(pump)
    state.dirty = state.shown = None
    state.say("")
