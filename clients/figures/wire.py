"""A daemon to compute figures with: started here, or one that runs already."""
import io
import json
import os
import subprocess
import urllib.error
import urllib.request

import matplotlib.image
import numpy as np

JSON = "application/json"
ROWS = "application/octet-stream"


class Daemon:
    """Evaluates, casts, meshes and renders documents, by name of their own."""

    def __init__(self, program, url=None):
        self.process = None
        self.names = {}
        self.requests = 0
        if url is None:
            self.process = subprocess.Popen(
                [program, "--listen", "127.0.0.1:0", "--data", ":memory:"],
                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
            url = self.process.stdout.readline().split()[-1]
        self.url = url.rstrip("/")

    def stop(self):
        for name in self.names.values():
            self.ask("DELETE", "/v1/scenes/" + name)
        if self.process:
            self.process.terminate()
            self.process.wait(30)

    def ask(self, method, path, body=None, kind=JSON, accept=JSON):
        """The answer's bytes. The problem's detail, if there is one, ends
        the program."""
        self.requests += 1
        request = urllib.request.Request(
            self.url + path, body, method=method,
            headers={"Content-Type": kind, "Accept": accept})
        try:
            with urllib.request.urlopen(request, timeout=300) as answer:
                return answer.read()
        except urllib.error.HTTPError as error:
            raise SystemExit("%s %s: %s" % (
                method, path, json.load(error).get("detail")))

    def ask_json(self, method, path, value=None):
        body = None if value is None else json.dumps(value).encode()
        return json.loads(self.ask(method, path, body))

    def scene(self, document):
        """The path of the scene with this document, made if need be."""
        text = json.dumps(document)
        if text not in self.names:
            self.names[text] = "figure-%d-%d" % (os.getpid(), len(self.names))
            self.ask("PUT", "/v1/scenes/" + self.names[text], text.encode())
        return "/v1/scenes/" + self.names[text]

    def evaluate(self, document, points, outputs="value"):
        """Points (…, 3) to rows (…, floats); to (…) for the value alone."""
        points = np.asarray(points, "<f4")
        flat = np.ascontiguousarray(points.reshape(-1, 3))
        answer = self.ask("POST", "%s/eval?outputs=%s" % (
            self.scene(document), outputs), flat.tobytes(), ROWS, ROWS)
        rows = np.frombuffer(answer, "<f4").astype(float)
        shape = points.shape[:-1]
        if outputs == "value":
            return rows.reshape(shape)
        return rows.reshape(shape + (-1,))

    def reach(self, document, origin, direction):
        """How far from origin the surface is along direction; None: never."""
        answer = self.ask_json("POST", self.scene(document) + "/raycast", {
            "rays": [list(origin) + list(direction)]})
        return answer["distance"][0]

    def mesh(self, document, resolution=128):
        """What the daemon says of the mesh: genus, components, volume, …"""
        return self.ask_json("POST", self.scene(document) + "/mesh", {
            "resolution": resolution, "format": "json"})

    def picture(self, document, width=360, height=360, **members):
        body = {"width": width, "height": height, "background": [1, 1, 1]}
        body.update(members)
        answer = self.ask("POST", self.scene(document) + "/render",
                          json.dumps(body).encode(), JSON, "image/png")
        return matplotlib.image.imread(io.BytesIO(answer))

    def slice(self, document, **members):
        answer = self.ask("POST", self.scene(document) + "/slice",
                          json.dumps(members).encode(), JSON, "image/png")
        return matplotlib.image.imread(io.BytesIO(answer))
