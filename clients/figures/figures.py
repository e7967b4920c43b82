#!/usr/bin/python3
"""Computes the figures of the paper, all through a daemon.

    make figures
    /usr/bin/python3 clients/figures/figures.py [--url URL] [NAME …]

Writes NAME.png, figures.json (what was measured) and README.md (the gallery
page) beside this file. Names given choose among the figures; the others'
numbers are then kept. BLOBFIELDD is the daemon, build/blobfieldd unless set.
Needs NumPy and matplotlib.

The paper: Gourmel, Barthe, Cani, Wyvill, Bernhardt, Paulin, Grasberger, A
Gradient-Based Implicit Blend, ACM TOG 32(2), 2013. These are figures after the
paper's, of the same subjects.
"""
import argparse
import io
import json
import math
import os
import sys
import time

sys.dont_write_bytecode = True
import matplotlib
matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from PIL import Image  # noqa: E402

import documents as d  # noqa: E402
from wire import Daemon  # noqa: E402

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
PI = math.pi
MOST_BYTES = 145000
plt.rcParams.update({"font.size": 9, "axes.titlesize": 9})

# Of the paper: Fig. 11, errors of g for N = 16, 32, 64, 128.
PAPER_ERRORS = {16: (5.03e-2, 2.97e-3), 32: (2.90e-2, 1.43e-3),
                64: (1.39e-2, 7.32e-4), 128: (6.72e-3, 3.69e-4)}


def save(figure, name):
    """The figure as a PNG; with a palette, if it is large without."""
    buffer, path = io.BytesIO(), os.path.join(HERE, name + ".png")
    figure.savefig(buffer, dpi=100)
    plt.close(figure)
    image = Image.open(buffer).convert("RGB")
    image.save(path, optimize=True)
    if os.path.getsize(path) > MOST_BYTES:
        palette = image.quantize(256, kmeans=2)
        image.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG
                       ).save(path, optimize=True)


def board(rows, titles=None, sides=None, name=None, cell=2.3, height=None):
    """Pictures in rows: titles above the columns or above each, sides at
    the left."""
    rows = [list(row) for row in rows]
    columns = max(len(row) for row in rows)
    left = 0.3 if sides else 0.03
    each = isinstance(titles, list) and titles and isinstance(titles[0], list)
    tall = height or cell
    size = (columns * cell + left, len(rows) * (tall + (0.25 if each else 0))
            + (0.0 if each else 0.25))
    figure = plt.figure(figsize=size)
    for r, row in enumerate(rows):
        for c, picture in enumerate(row):
            y = size[1] - (r + 1) * (tall + (0.25 if each else 0)) - (
                0 if each else 0.25)
            axes = figure.add_axes([(left + c * cell) / size[0], y / size[1],
                                    cell / size[0], tall / size[1]])
            axes.imshow(picture, aspect="equal", interpolation="antialiased")
            axes.axis("off")
            if each:
                axes.set_title(titles[r][c], pad=2)
            elif titles and r == 0:
                axes.set_title(titles[c], pad=2)
        if sides:
            figure.text(0.15 / size[0], (size[1] - (r + 0.5) * tall - 0.25)
                        / size[1], sides[r], rotation=90, va="center",
                        ha="center", weight="bold")
    save(figure, name)


def camera(eye, target=(0, 0, 0), fov=0.5):
    return {"eye": list(eye), "target": list(target), "up": [0, 0, 1],
            "fov": fov}


def times(number):
    """1.2e-3 as people write it."""
    mantissa, exponent = ("%.2e" % number).split("e")
    return "%s·10⁻%s" % (mantissa, str(-int(exponent)).translate(
        str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")))


# Where f1 is x and f2 is y: of two half-spaces at a right angle, whose
# falloff takes a coordinate to a value.

def at_values(daemon, values):
    """The coordinates x with f(x) = value of a half-space of falloff 1."""
    line = np.linspace(1, -1, 20001)
    points = np.stack([line, 0 * line, 0 * line], -1)
    f = daemon.evaluate(d.document(d.half_space(0)), points)
    return np.interp(values, f, line)


def sweep(daemon, operator, count=161):
    """g over (f1, f2) in [0, 1]², by the daemon: values and g[j, i]."""
    values = np.linspace(0, 1, count)
    x = at_values(daemon, values)
    X, Z = np.meshgrid(x, x)
    doc = d.joined(operator, [d.half_space(0), d.half_space(PI / 2)])
    return values, daemon.evaluate(doc, np.stack([X, 0 * X, Z], -1))


def iso_curves(daemon, profile, name):
    """Five openings. Measures the least max(f1, f2) where g is ½: how far
    the surface comes out."""
    thetas = [0, PI / 16, PI / 8, 3 * PI / 16, PI / 4]
    names = ["0", "π/16", "π/8", "3π/16", "π/4"]
    figure, all_axes = plt.subplots(1, 5, figsize=(11.5, 2.75))
    measured = {}
    for axes, theta, label in zip(all_axes, thetas, names):
        f, g = sweep(daemon, d.constant(theta, profile))
        axes.contourf(f, f, g, np.linspace(0, 1.45, 30), cmap="YlGnBu_r",
                      alpha=0.7)
        axes.contour(f, f, g, np.arange(0.1, 1.5, 0.1), colors="k",
                     linewidths=0.5)
        axes.contour(f, f, g, [0.5], colors="#c23b10", linewidths=2)
        axes.set(aspect="equal", title="θ = " + label, xlabel="f₁",
                 xticks=[0, .5, 1], yticks=[0, .5, 1])
        F1, F2 = np.meshgrid(f, f)
        measured[label] = round(float(np.maximum(F1, F2)[g >= 0.5].min()), 3)
    all_axes[0].set_ylabel("f₂")
    figure.tight_layout(pad=0.4)
    save(figure, name)
    return measured


def figure_1d(daemon):
    """Lava: organic above, the sum below."""
    moments = [0, 0.2, 0.4, 0.6, 0.8, 1]
    view = camera((1.2, -7, 2.4), (0, 0, 1.15), 0.45)
    rows, measured = [], {}
    for operator in ("organic", "sum"):
        rows.append([daemon.picture(d.lava(operator, t), 200, 380,
                                    camera=view) for t in moments])
        reports = [daemon.mesh(d.lava(operator, t), 96) for t in moments]
        measured[operator] = {
            "components": [r["components"] for r in reports],
            "volume": [round(r["volume"], 3) for r in reports]}
    board(rows, ["frame %d" % (i + 1) for i in range(6)],
          ["organic", "sum"], "fig01d", 1.6, 3.0)
    m = measured
    return ("Fig. 1(d)", "Frames of an animation: lava. Drops blend as they "
            "touch; the sum joins them from afar.",
            "Bodies in each frame, by the mesh: organic %s, sum %s. Volume: "
            "organic %s to %s, sum %s to %s." % (
                ", ".join(map(str, m["organic"]["components"])),
                ", ".join(map(str, m["sum"]["components"])),
                min(m["organic"]["volume"]), max(m["organic"]["volume"]),
                min(m["sum"]["volume"]), max(m["sum"]["volume"])), measured)


def figure_2(daemon):
    """The angle between the gradients, and what camel makes of it."""
    doc = d.ball_on_bar("camel")
    parts = doc["root"]["children"]
    x, z = np.linspace(-1.3, 1.3, 261), np.linspace(-0.6, 1, 161)
    X, Z = np.meshgrid(x, z)
    points = np.stack([X, 0 * X, Z], -1)
    n = [daemon.evaluate(d.document(part), points, "gradient")
         for part in parts]
    length = [np.linalg.norm(g, axis=-1) for g in n]
    both = (length[0] > 1e-3) & (length[1] > 1e-3)
    alpha = np.where(both, np.arccos(np.clip(
        (n[0] * n[1]).sum(-1) / np.maximum(length[0] * length[1], 1e-12),
        -1, 1)), np.nan)
    figure = plt.figure(figsize=(11.5, 4.9))
    for i, (title, operator) in enumerate((
            ("the angle α between ∇f₁ and ∇f₂", None),
            ("sum", "sum"), ("camel", "camel"))):
        axes = figure.add_axes([0.01 + 0.345 * i, 0.49, 0.29, 0.45])
        if operator is None:
            shown = axes.imshow(np.degrees(alpha), origin="lower",
                                extent=(-1.3, 1.3, -0.6, 1), cmap="RdYlBu",
                                vmin=0, vmax=180)
            for part in parts:
                axes.contour(X, Z, daemon.evaluate(d.document(part), points),
                             [0.5], colors="k")
            bar = figure.colorbar(shown, ticks=[0, 90, 180], cax=(
                figure.add_axes([0.303, 0.5, 0.008, 0.43])))
            bar.ax.set_yticklabels(["0°", "90°", "180°"])
        else:
            f = daemon.evaluate(d.ball_on_bar(operator), points)
            axes.contourf(X, Z, f, np.arange(0, 2.3, 0.1), cmap="YlGnBu_r",
                          alpha=0.7)
            axes.contour(X, Z, f, np.arange(0.1, 1, 0.1), colors="k",
                         linewidths=0.4)
            axes.contour(X, Z, f, [0.5], colors="#c23b10", linewidths=2)
            sharp = daemon.evaluate(d.ball_on_bar("sharp"), points)
            axes.contour(X, Z, sharp, [0.5], colors="k", linestyles=":")
        axes.set(title=title, xticks=[], yticks=[], aspect="equal")
    measured = {}
    for i, degrees in enumerate((90, 60, 30)):
        axes = figure.add_axes([0.01 + 0.335 * i, 0.0, 0.31, 0.44])
        turned = math.radians(degrees)
        axes.imshow(daemon.picture(d.bars("camel", turned), 480, 300,
                                   camera=camera((0.9, -4.6, 1.6), fov=0.5)))
        axes.axis("off")
        reach = {}
        for side, way in (("acute", [1, 0, 0]), ("obtuse", [0, 0, 1])):
            values = [daemon.reach(d.bars(o, turned), [0, 0, 0], way)
                      for o in ("sharp", "camel", "sum")]
            reach[side] = {o: round(v, 4) for o, v in zip(
                ("sharp", "camel", "sum"), values)}
        above = [daemon.reach(d.bars(o, turned), [0, 0, 0], [0, -1, 0])
                 for o in ("sharp", "camel", "sum")]
        reach["across"] = {o: round(v, 4) for o, v in zip(
            ("sharp", "camel", "sum"), above)}
        measured["%d°" % degrees] = reach
        axes.set_title("camel, bars at %d°" % degrees, pad=2)
    save(figure, "fig02")
    m = measured["90°"]
    return ("Fig. 2", "The blend is steered by the angle between gradients: "
            "none where they agree (across the joint) or oppose, all of it "
            "where they are perpendicular (in its corners).",
            "Bars of radius 0.25 at 90°, surface from the crossing: in the "
            "corner %s with sharp, %s camel, %s sum; across, where a bulge "
            "would be, %s, %s, %s." % (
                m["acute"]["sharp"], m["acute"]["camel"], m["acute"]["sum"],
                m["across"]["sharp"], m["across"]["camel"],
                m["across"]["sum"]), measured)


def figure_3(daemon):
    m = iso_curves(daemon, "smooth", "fig03")
    return ("Fig. 3", "Iso-curves of g over (f₁, f₂) for five openings θ, "
            "profile smooth; ½ in red.",
            "The curve of ½ comes in as far as max(f₁, f₂) = " + ", ".join(
                "%s (θ = %s)" % (v, k) for k, v in m.items()) + ".", m)


def figure_13(daemon):
    m = iso_curves(daemon, {"type": "bulge", "k": 0.8}, "fig13")
    return ("Fig. 13", "The same for the profile bulge, K = 0.8, of contact: "
            "folded along f₁ = f₂.",
            "The curve of ½ comes in as far as max(f₁, f₂) = " + ", ".join(
                "%s (θ = %s)" % (v, k) for k, v in m.items()) + ".", m)


def gap_between(daemon, operator):
    """The length outside between the two bars of d.apart."""
    z = np.linspace(-0.36, 0.36, 7201)
    f = daemon.evaluate(d.apart(operator),
                        np.stack([0 * z, 0 * z, z], -1))
    return float((f < 0.5).sum() * (z[1] - z[0]))


def figure_4(daemon):
    views = [camera((1.6, -5.2, 3.2), (0, 0, 1.05), 0.6),
             camera((2.3, -3.6, 1.4), (0, 0, 0), 0.6),
             camera((0.9, -3.9, 0.8), (0, -0.1, 0), 0.55),
             camera((1.2, -5.6, 2.6), (0, 0, 1.4), 0.58)]
    rows, measured = [], {"nominal gap": 0.12}
    nominal = (daemon.mesh(d.spiked("sharp"), 160)["volume"]
               - daemon.mesh(d.spiked("sharp", False), 160)["volume"])
    measured["nominal detail"] = round(nominal, 4)
    for operator, tail in (("sum", "-sum"), ("camel", "")):
        tee, handles = d.model("tee" + tail), d.model("handles" + tail)
        docs = [tee, d.apart(operator), d.spiked(operator), handles]
        rows.append([daemon.picture(doc, 330, 330, camera=view)
                     for doc, view in zip(docs, views)])
        detail = (daemon.mesh(docs[2], 160)["volume"]
                  - daemon.mesh(d.spiked(operator, False), 160)["volume"])
        measured[operator] = {
            "bulge": round(3 - daemon.reach(tee, [0, 0, 5], [0, 0, -1]), 4),
            "gap": round(gap_between(daemon, operator), 4),
            "detail": round(detail, 4),
            "genus": daemon.mesh(handles)["genus"]}
    board(rows, ["bulge", "blending at a distance", "details blown up",
                 "holes filled in"], ["sum", "camel"], "fig04", 2.7)
    s, c = measured["sum"], measured["camel"]
    return ("Fig. 4", "Four problems, and none of them: classic above, ours "
            "below.", "Sum and camel: height of the bulge over the bar %s, "
            "%s; gap %s, %s (modelled: 0.12); volume of the details %s, %s "
            "(of a sharp union: %s); genus of the amphora %d, %d." % (
                s["bulge"], abs(c["bulge"]), s["gap"], c["gap"], s["detail"],
                c["detail"], measured["nominal detail"], s["genus"],
                c["genus"]), measured)


def figure_5(daemon):
    radii = [0.2, 0.28, 0.36, 0.42]
    view = camera((1.6, -5.6, 2.1), (0, 0, 1.32), 0.68)
    rows, measured = [], {"radius": radii}
    for operator in ("sum", "camel", "sharp"):
        measured[operator] = [daemon.mesh(d.letter(operator, r))["genus"]
                              for r in radii]
        if operator != "sharp":
            rows.append([daemon.picture(d.letter(operator, r), 300, 300,
                                        camera=view) for r in radii])
    board(rows, ["radius %s" % r for r in radii], ["sum", "camel"], "fig05",
          2.4)
    return ("Fig. 5", "The blend has the topology of the union: strokes "
            "grow, and the hole of the A stays as long as theirs does.",
            "Genus by the mesh at radius %s: sum %s, camel %s, sharp union "
            "%s." % tuple(", ".join(map(str, measured[k])) for k in (
                "radius", "sum", "camel", "sharp")), measured)


def figure_7(daemon):
    thetas = [(PI / 16, "π/16"), (PI / 8, "π/8"), (3 * PI / 16, "3π/16")]
    figure, all_axes = plt.subplots(1, 3, figsize=(9.6, 3.6))
    measured = {}
    for axes, (theta, label) in zip(all_axes, thetas):
        f, g = sweep(daemon, d.constant(theta), 321)
        F1, F2 = np.meshgrid(f, f)
        blend = g - np.maximum(F1, F2)
        axes.contourf(f, f, blend > 1e-4, [0.5, 1.5], colors=["#f3c98b"])
        axes.contour(f, f, g, np.arange(0.1, 1.3, 0.1), colors="k",
                     linewidths=0.5)
        axes.contour(f, f, g, [0.5], colors="#c23b10", linewidths=2)
        axes.set(aspect="equal", title="θ = " + label, xlabel="f₁",
                 xticks=[0, .5, 1], yticks=[0, .5, 1])
        # Where the blend begins at f2 = 1/2, from below: k(1/2) = T / 2.
        row = blend[len(f) // 2]
        begins = float(f[np.argmax(row > 1e-4)])
        axes.plot([begins, math.tan(theta) / 2], [0.5, 0.5], "ko", ms=3)
        measured[label] = {"begins": round(begins, 4),
                           "k(1/2)": round(math.tan(theta) / 2, 4),
                           "share": round(float((blend > 1e-4).mean()), 3)}
    all_axes[0].set_ylabel("f₂")
    figure.tight_layout(pad=0.4)
    save(figure, "fig07")
    return ("Fig. 7", "Where fields blend (shaded: g exceeds the maximum by "
            "10⁻⁴): between the boundaries k, which θ draws together.",
            "At f₂ = ½ that is seen from f₁ = %s on; k(½) = %s (g leaves the "
            "maximum there with all derivatives 0)." % (
                ", ".join(str(v["begins"]) for v in measured.values()),
                ", ".join(str(v["k(1/2)"]) for v in measured.values())),
            measured)


def figure_11(daemon):
    view = camera((0.9, -1.9, -1.0), (0.12, 0, -0.22), 0.42)
    tables = [("uniform", n) for n in (16, 32, 64, 128)] + [("warped", 64)]
    rows = [[], []]
    measured = {"paper": {str(n): e for n, e in PAPER_ERRORS.items()}}
    for layout, n in tables:
        told = daemon.ask_json("POST", "/v1/operators", {
            "profile": "smooth", "layout": layout, "resolution": n})
        measured["%s %d" % (layout, n)] = {
            "max": told["measured"]["max"], "mean": told["measured"]["mean"],
            "MiB": round(told["bytes"] / 2 ** 20, 2)}
        doc = d.tee_by_table(layout, n)
        for row, shading in zip(rows, ("zebra", "curvature")):
            row.append(daemon.picture(doc, 280, 280, camera=view,
                                      shading=shading))
    board(rows, ["%s, %d³" % t for t in tables], ["zebra", "curvature"],
          "fig11", 2.2)
    lines = ["", "| nodes an axis | 16 | 32 | 64 | 128 |",
             "|---|---|---|---|---|"]
    lines.append("| the paper: largest, mean | %s |" % " | ".join(
        "%s, %s" % (times(a), times(b)) for a, b in PAPER_ERRORS.values()))
    lines.append("| its grid here (`uniform`) | %s |" % " | ".join(
        "%s, %s" % (times(measured["uniform %d" % n]["max"]),
                    times(measured["uniform %d" % n]["mean"]))
        for n in PAPER_ERRORS))
    w = measured["warped 64"]
    lines.append("| our default (`warped`, 64) | | | %s, %s | |" % (
        times(w["max"]), times(w["mean"])))
    return ("Fig. 11", "A joint by tables of growing size, close up, and "
            "their errors in g.", "\n".join(lines), measured)


def kappa_theta(alpha, o):
    """θ(α) by Eq. 15 and 16."""
    a0, a1, a2 = o["alpha"]
    t0, t1, t2 = o["theta"]
    w0, w1 = o.get("w", [1, 1])

    def kappa(x):
        if x <= 0 or x >= 1:
            return min(max(x, 0), 1)
        return 1 - math.exp(1 - 1 / (1 - math.exp(1 - 1 / x)))

    if alpha <= a0:
        return t0
    if alpha >= a2:
        return t2
    if alpha <= a1:
        return kappa((alpha - a1) / (a0 - a1)) ** w0 * (t0 - t1) + t1
    return kappa((alpha - a1) / (a2 - a1)) ** w1 * (t2 - t1) + t1


def figure_12(daemon):
    """The curves by the formula; marks by the daemon, from g(½, ½)."""
    told = {o["name"]: o for o in
            daemon.ask_json("GET", "/v1/operators")["operators"]}
    thetas = np.linspace(0, PI / 4, 33)
    middle = [[0, 0, 0]]
    crossing = [d.half_space(0), d.half_space(PI / 2)]
    g = [daemon.evaluate(d.joined(d.constant(t), crossing), middle)[0]
         for t in thetas]
    figure, axes = plt.subplots(figsize=(6.4, 3.2))
    measured, alphas = {}, np.linspace(0.02, PI - 0.02, 25)
    for name, color in (("camel", "#0b6e8f"), ("organic", "#3b8a3e"),
                        ("contact", "#c2571a")):
        o = told[name]["opening"]
        fine = np.linspace(0, PI, 400)
        axes.plot(np.degrees(fine), [kappa_theta(a, o) for a in fine],
                  color=color, label=name)
        seen = []
        for a in alphas:
            doc = d.joined({"profile": "smooth", "opening": name},
                           [d.half_space(0), d.half_space(a)])
            value = daemon.evaluate(doc, middle)[0]
            seen.append(float(np.interp(-value, [-v for v in g], thetas)))
        axes.plot(np.degrees(alphas), seen, "o", color=color, ms=3.5)
        measured[name] = round(max(abs(t - kappa_theta(a, o))
                                   for a, t in zip(alphas, seen)), 4)
    axes.set(xlabel="α, degrees", ylabel="θ", xticks=[0, 45, 90, 135, 180],
             yticks=[0, PI / 8, PI / 4])
    axes.set_yticklabels(["0", "π/8", "π/4"])
    axes.legend(frameon=False)
    figure.tight_layout(pad=0.4)
    save(figure, "fig12")
    return ("Fig. 12", "Openings θ(α): the formula, and marks, read from "
            "what the daemon answers for g(½, ½) of two half-spaces at the "
            "angle α.", "Largest difference: " + ", ".join(
                "%s %s" % kv for kv in measured.items()) + ".", measured)


def against_sum(daemon, name, view, file, resolution=128, own=None):
    """A model as it is and with every union a sum."""
    doc = own or d.model(name)
    classic = d.with_operator(doc, "sum")
    pictures, measured = [], {}
    for label, one in ((name, doc), ("the same, sum", classic)):
        pictures.append(daemon.picture(one, 420, 420, camera=view))
        report = daemon.mesh(one, resolution)
        measured[label] = {k: report[k] if k != "volume" else
                           round(report[k], 3)
                           for k in ("components", "genus", "volume")}
    board([pictures], [name, "the same, every union a sum"], None, file, 3.6)
    ours, theirs = measured.values()
    return measured, ("genus %d, volume %s; every union a sum: genus %d, "
                      "volume %s." % (ours["genus"], ours["volume"],
                                      theirs["genus"], theirs["volume"]))


def figure_14(daemon):
    m, words = against_sum(daemon, "creature", camera(
        (2.2, -7.2, 2.6), (0, 0.1, 1.45), 0.55), "fig14")
    return ("Fig. 14", "An organic shape: limbs, stalks and tail by organic, "
            "the mouth cut by camel.", words[0].upper() + words[1:], m)


def figure_15(daemon):
    m, words = against_sum(daemon, "hand", camera(
        (1.2, -7.2, 1.6), (-0.1, 0, 0.85), 0.58), "fig15")
    return ("Fig. 15", "A hand: fingers side by side stay apart, and grow out "
            "of the palm without swelling it.", words[0].upper() + words[1:], m)


def figure_16(daemon):
    angles = [15, 60, 105, 135]
    view = camera((0.3, -5.2, 1.3), (-0.35, 0, 0.45), 0.6)
    squeeze = {"profile": {"type": "bulge", "k": 0.5}, "opening": "contact"}
    rows, measured = [], {"angle": angles}
    for name, operator in (("sum", "sum"), ("camel", "camel"),
                           ("contact, K = ½", squeeze)):
        docs = [d.elbow(operator, math.radians(a)) for a in angles]
        rows.append([daemon.picture(doc, 280, 230, camera=view)
                     for doc in docs])
        measured[name] = [round(daemon.mesh(doc)["volume"], 3)
                          for doc in docs]
    board(rows, ["bent by %d°" % a for a in angles],
          ["sum", "camel", "contact"], "fig16", 2.3, 1.9)
    return ("Fig. 16", "A joint in motion: the sum swells at the elbow, "
            "camel does not, contact folds.", "Volume over the motion: " +
            "; ".join("%s %s" % (k, ", ".join(map(str, v)))
                      for k, v in measured.items() if k != "angle") + ".",
            measured)


def figure_17(daemon):
    names = ["bracket", "gear", "bent-bar"]
    views = [None, camera((2.0, -4.2, 3.8), (0, 0, -0.05), 0.6), None]
    pictures, measured = [], {}
    for name, view in zip(names, views):
        doc = d.model(name)
        more = {"camera": view} if view else {}
        pictures.append(daemon.picture(doc, 420, 380, **more))
        report = daemon.mesh(doc, 160)
        measured[name] = {"genus": report["genus"],
                          "sharp vertices": report["sharp_vertices"],
                          "volume": round(report["volume"], 3)}
    board([pictures], names, None, "fig17", 3.3, 3.0)
    return ("Fig. 17, like", "Constructive parts: camel for castings, clean "
            "for drilling; their edges are kept in meshes.", "; ".join(
                "%s: genus %d, volume %s" % (k, v["genus"], v["volume"])
                for k, v in measured.items()) + ".", measured)


def figure_18(daemon):
    m, words = against_sum(daemon, "tree", camera(
        (2.5, -9, 3.4), (0.2, -0.1, 1.8), 0.55), "fig18")
    return ("Fig. 18", "A tree: branches blend where they fork, leaves press "
            "on them.", words[0].upper() + words[1:], m)


def figure_19(daemon):
    view = camera((1.9, -5.2, 4.2), (0, 0, 1.2), 0.52)
    operators = ["sharp", "camel", "organic", "contact"]
    rows, measured = [[], []], {}
    for operator in operators:
        doc = d.on_cube(operator)
        rows[0].append(daemon.picture(doc, 330, 330, camera=view))
        rows[1].append(daemon.slice(
            doc, center=[0, 0, 1.45], normal=[1, -1, 0], extent=2.6,
            width=330, height=250, levels={"step": 0.1}))
        # The rim: the surface outside the sphere's own place, along the
        # cube's diagonal, where its top is flat to 0.9.
        heights = {r: round(3.4 - daemon.reach(
            doc, [r / math.sqrt(2), r / math.sqrt(2), 5], [0, 0, -1]), 4)
            for r in (0.67, 0.7, 0.75, 0.8)}
        measured[operator] = {
            "rim": heights,
            "volume": round(daemon.mesh(doc)["volume"], 3)}
    board(rows, operators, None, "fig19", 2.7)
    return ("Fig. 19", "A sphere pressed into a cube: contact pushes "
            "material up around it, and leaves a crease where they meet; "
            "camel fills the corner. Below, slices along the diagonal.",
            "Height over the cube's top 0.05 from the sphere's side (0.7 from "
            "the axis): " + ", ".join("%s %s" % (k, v["rim"][0.7])
                                  for k, v in measured.items()) +
            "; volume " + ", ".join(str(v["volume"])
                                    for v in measured.values()) + ".",
            measured)


def figure_gallery(daemon):
    with open(os.path.join(d.MODELS, "index.json")) as file:
        index = json.load(file)
    pictures, titles, measured = [], [], {}
    for entry in index:
        name = entry["file"][:-5]
        doc = d.model(name)
        pictures.append(daemon.picture(doc, 210, 210))
        titles.append(entry["title"].replace(", classic sum", ", sum"))
        r = daemon.mesh(doc, 96)
        measured[name] = {"genus": r["genus"], "components": r["components"],
                          "volume": round(r["volume"], 4)}
    width = 7
    rows = [pictures[i:i + width] for i in range(0, len(pictures), width)]
    board(rows, [titles[i:i + width] for i in range(0, len(titles), width)],
          None, "gallery", 1.7)
    return ("The models", "All of [`clients/models`](../models), as the "
            "daemon renders them.", "%d models, genus by the mesh 0 but for "
            "%s." % (len(measured), ", ".join(
                "%s %d" % (name, m["genus"]) for name, m in measured.items()
                if m["genus"])), measured)


FIGURES = {"gallery": figure_gallery, "fig01d": figure_1d, "fig02": figure_2,
           "fig03": figure_3, "fig04": figure_4, "fig05": figure_5,
           "fig07": figure_7, "fig11": figure_11, "fig12": figure_12,
           "fig13": figure_13, "fig14": figure_14, "fig15": figure_15,
           "fig16": figure_16, "fig17": figure_17, "fig18": figure_18,
           "fig19": figure_19}


def write_page(kept):
    """README.md, of all that figures.json has."""
    lines = ["# Figures", "",
             "The figures of Gourmel et al., *A Gradient-Based Implicit "
             "Blend* (2013), computed by `make figures` through a daemon: "
             "fields by `eval`, surfaces by", "`render`, numbers by `mesh` "
             "and `raycast`. They are after the paper's, of the same "
             "subjects, not copies. \"sum\" is the classic blend, f₁ + f₂. "
             "The page, too, is written", "by [`figures.py`](figures.py); "
             "all numbers are in [`figures.json`](figures.json)."]
    for name in FIGURES:
        if name in kept:
            k = kept[name]
            lines += ["", "## " + k["title"], "", k["caption"], "",
                      "![%s](%s.png)" % (k["title"], name), "",
                      "Measured: " + k["words"] if not
                      k["words"].startswith("\n") else k["words"].strip("\n")]
    with open(os.path.join(HERE, "README.md"), "w") as file:
        file.write("\n".join(lines) + "\n")


def main():
    parser = argparse.ArgumentParser(description="The paper's figures.")
    parser.add_argument("--url", help="a daemon that runs already")
    parser.add_argument("names", nargs="*", metavar="NAME",
                        help=" ".join(FIGURES))
    chosen = parser.parse_args()
    for name in chosen.names:
        if name not in FIGURES:
            parser.error("no figure '%s'" % name)
    path = os.path.join(HERE, "figures.json")
    kept = {}
    if os.path.exists(path):
        with open(path) as file:
            kept = json.load(file)
    daemon = Daemon(os.environ.get("BLOBFIELDD")
                    or os.path.join(ROOT, "build", "blobfieldd"), chosen.url)
    try:
        for name in chosen.names or FIGURES:
            begun = time.monotonic()
            title, caption, words, measured = FIGURES[name](daemon)
            kept[name] = {"title": title, "caption": caption, "words": words,
                          "measured": measured}
            print("%-8s %5.1f s  %s" % (name, time.monotonic() - begun,
                                        words.strip().split("\n")[-1]),
                  flush=True)
    finally:
        daemon.stop()
    with open(path, "w") as file:
        json.dump({n: kept[n] for n in FIGURES if n in kept}, file, indent=1,
                  ensure_ascii=False)
        file.write("\n")
    write_page(kept)


if __name__ == "__main__":
    main()
