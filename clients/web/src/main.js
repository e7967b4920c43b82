// The page: puts the parts together.
import * as api from "./api.js";
import { digits, drag, h, icon, narrow } from "./dom.js";
import { Editor } from "./editor.js";
import { EXAMPLES, Gallery } from "./gallery.js";
import { Inspector } from "./inspector.js";
import * as lava from "./lava.js";
import { nodeOf as nodeIn } from "./nodes.js";
import { applyAll, at as valueAt, mark, read } from "./source.js";
import { keep, recall, remembered, Session } from "./session.js";
import { skeleton } from "./skeleton.js";
import { Slice } from "./slice.js";
import { slider } from "./slider.js";
import { askToken } from "./token.js";
import { Tree } from "./tree.js";
import { Blind, MODES, parse, Viewport } from "./viewport.js";

const session = new Session();
let doc = null;            // the latest that was JSON
let places = new Map();    // of the text, valid or not
let selected = "/root";
let report = {};           // of the surface that is shown
let surface = null;        // {etag, geometry, coarse}
let mode = "colour";
let gauss = false;
let playing = null;

/* ---- what there is on the page ---- */

const button = (name, text, onclick, more = {}) => h("button", { class:
	"tool", title: text, "aria-label": text, onclick, ...more }, icon(name));

const title = h("span", { class: "title" });
const status = h("span", { class: "status", role: "status" });
const dot = h("span", { class: "dot" });
const menu = h("div", { class: "menu", hidden: true, role: "menu" });
const share = h("button", { class: "plain", "aria-label": "Share",
	title: "Copy this scene’s address: whoever opens it sees and makes the same edits",
	onclick: copyLink }, icon("share"), h("span", {}, "Share"));
const header = h("header", { class: "top" },
	h("span", { class: "brand" }, icon("blob"), "blobfield"),
	title, h("span", { class: "space" }),
	h("span", { class: "state" }, dot, status),
	h("button", { class: "plain", "aria-label": "Examples",
		onclick: () => gallery.open() },
		icon("gallery"), h("span", {}, "Examples")),
	h("button", { class: "plain", "aria-label": "Open", title: "Open a document",
		onclick: openFile }, icon("open"),
		h("span", {}, "Open")),
	share,
	h("span", { class: "menu-host" }, h("button", { class: "plain",
		"aria-label": "Export", "aria-haspopup": "menu", "aria-expanded": "false",
		onclick: (event) => {
			event.stopPropagation();
			openMenu(menu.hidden);
		} }, icon("download"), h("span", {}, "Export")), menu));

const treeHost = h("div", { class: "tree" });
const editorHost = h("div", { class: "editor" });
const problemList = h("ul", { class: "problems", hidden: true, "aria-label":
	"Problems" });
const bar1 = h("div", { class: "bar across", role: "separator" });
const left = h("aside", { class: "left" }, treeHost, bar1, editorHost,
	problemList);
const bar2 = h("div", { class: "bar along", role: "separator" });

const view = h("div", { class: "view" });
const modes = h("div", { class: "modes", role: "radiogroup", "aria-label":
	"Shading" }, ...MODES.map((m) => h("button", { role: "radio",
	"data-mode": m, "aria-checked": String(m === mode),
	tabindex: m === mode ? "0" : "-1",
	onclick: () => setMode(m) }, m[0].toUpperCase() + m.slice(1))));
const wireButton = button("wire", "Wireframe (W)", () => setWire(!wire()));
const sliceButton = button("slice", "Slice (S)", () => setSlice(!sliceWanted));
const fitButton = button("fit", "Show all of it (F)", () => viewport.fit());
const views = h("div", { class: "group" }, ...[["X", [1, -1e-4, 0], "From the right"],
	["Y", [0, -1, 0], "From the front"], ["Z", [0, -1e-4, 1], "From above"]]
	.map(([name, d, text]) => h("button", { class: "tool", title: text,
		"aria-label": text, onclick: () => viewport.fit(d) }, name)), fitButton);
const playButton = h("button", { class: "play", hidden: true,
	onclick: () => playing ? stop() : play() }, icon("play"),
h("span", {}, "Play"));
const legend = h("div", { class: "legend", hidden: true });
const facts = h("div", { class: "facts" });
const progress = h("div", { class: "progress", hidden: true, role:
	"progressbar", "aria-label": "The surface", "aria-valuemin": 0, "aria-valuemax": 100 }, h("div"));
const stage = h("div", { class: "stage", hidden: true });
const banner = h("div", { class: "banner", hidden: true, role: "alert" });
const toast = h("div", { class: "toast", hidden: true, role: "status" });
view.append(progress, h("div", { class: "tools" }, modes,
	h("div", { class: "group" }, wireButton, sliceButton), h("span",
		{ class: "space" }), views), h("div", { class: "foot" }, facts, legend),
playButton, stage, banner, toast);

const nodePanel = h("section", { class: "panel node-panel" });
const pointPanel = h("section", { class: "panel", hidden: true });
const slicePanel = h("section", { class: "panel", hidden: true });
const surfacePanel = h("section", { class: "panel" });
const right = h("aside", { class: "right" }, pointPanel, nodePanel, slicePanel,
	surfacePanel);
document.body.append(header, h("main", {}, left, bar2, view, right));

/* ---- the parts ---- */

const editor = new Editor(editorHost, { changed: edited, moved: (pointer) =>
	select(nodeIn(pointer), "editor") });
const tree = new Tree(treeHost, (pointer) => select(pointer, "tree"));
const inspector = new Inspector(nodePanel, (edits) =>
	editor.setText(applyAll(editor.text, edits), "slider"), aim);
let viewport;
try {
	viewport = new Viewport(view, { picked: pick, slid: (offset, done) =>
		slice.move(offset, !done) });
} catch {
	viewport = new Blind();
	view.append(h("p", { class: "banner" }, "This browser has no WebGL 2: " +
		"there can be no picture. Editing and export work all the same."));
}
const slice = new Slice(viewport, () => session.etag
	? { id: session.id, iso: session.iso } : null,
(error) => note(`No slice: ${error.message}`));
const gallery = new Gallery((example) => openText(example.text));
document.body.append(gallery.element);
api.asker(askToken);

/* ---- the text ---- */

function edited(text, who) {
	const now = read(text);
	places = now.places;
	if (who === "user" || who === "slider") {
		stop(false);
		session[who === "user" ? "edit" : "live"](text);
	}
	if (now.fault)
		return;
	doc = now.value;
	title.textContent = doc?.name || "untitled";
	document.title = `${doc?.name || "untitled"} – blobfield`;
	tree.render(doc);
	if (valueAt(doc, selected) === undefined)
		select("/root", "text");
	else
		showSelected(false);
	playButton.hidden = !lava.lamp(doc);
}

function select(pointer, from) {
	if (valueAt(doc, pointer) === undefined)
		return;
	selected = pointer;
	tree.select(pointer);
	showSelected(from === "tree" || from === "pick");
}

function showSelected(scroll) {
	inspector.render(doc, selected, viewport.size);
	editor.showNode(selected === "/root" ? null : places.get(selected), scroll);
	viewport.setSkeleton(selected === "/root" ? []
		: skeleton(doc, selected, viewport.size));
}

function showProblems({ list, count }) {
	const placed = list.filter((p) => (p.from ?? p.pointer) !== undefined);
	editor.setProblems(placed.map((p) => ({ message: p.message, ...p.from !==
		undefined ? { from: p.from, to: p.to } : mark(places, p.pointer ?? "") })));
	problemList.hidden = list.length === 0;
	problemList.replaceChildren(...list.map((p) => h("li", {}, h("button", {
		onclick: () => editor.jump(p.from ?? mark(places, p.pointer ?? "").from),
	}, p.pointer !== undefined ? h("code", {}, p.pointer || "/") : null,
	h("span", {}, p.message)))), ...count > list.length
		? [h("li", { class: "soft" }, `and ${count - list.length} more`)] : []);
	problems = list.length;
	showStatus();
}

let problems = 0;

/* ---- the scene ---- */

session.addEventListener("text", ({ detail }) => {
	if (detail.from === "open") {
		editor.open(detail.text);
	} else {
		editor.setText(detail.text, detail.from, { remember: false });
		note("Changed by somebody else.");
	}
});
session.addEventListener("problems", ({ detail }) => showProblems(detail));
session.addEventListener("phase", showStatus);
session.addEventListener("online", () => {
	showStatus();
	if (session.online)
		note("The daemon is back.");
});
session.addEventListener("opened", () => {
	const hash = `#scene=${encodeURIComponent(session.id)}`;
	if (location.hash !== hash)
		history.pushState(null, "", hash);
	stop(false);
	if (aiming)
		aim(null);
	selected = "/root";
	tree.selected = "/root";
	viewport.fitted = false;
	viewport.setPin(null);
	pointPanel.hidden = true;
	slice.placed = false;
});

function showBanner() {
	banner.hidden = !session.conflict && !session.gone;
	if (banner.contains(document.activeElement))
		viewport.canvas?.focus();
	// What is asked is answered, and the keyboard is not lost with the button.
	const choice = (text, act, more) => h("button", { ...more, onclick: act }, text);
	banner.replaceChildren(...session.conflict
		? [h("span", {}, "Somebody else has changed this scene."),
			choice("Take theirs", () => session.settle(true)),
			choice("Keep mine", () => session.settle(false), { class: "primary" })]
		: session.gone ? [h("span", {}, "Somebody has deleted this scene."),
			choice("Put it back", () => session.putBack(), { class: "primary" })]
			: []);
}

session.addEventListener("conflict", showBanner);
session.addEventListener("gone", () => {
	showBanner();
	showStatus();
});
session.addEventListener("progress", ({ detail }) => {
	const on = detail.done !== null && detail.done !== undefined;
	progress.hidden = stage.hidden = !on;
	if (!on)
		return;
	const percent = Math.round(100 * detail.done);
	progress.firstChild.style.width = `${percent}%`;
	progress.setAttribute("aria-valuenow", percent);
	stage.textContent = `${detail.stage} · ${percent} %`;
});

let parsing = 0;
session.addEventListener("surface", async ({ detail }) => {
	const mine = ++parsing;
	const made = await parse(detail.data);
	if (mine !== parsing)
		return;
	const first = !viewport.fitted;
	const was = viewport.size;
	viewport.setGeometry(made.geometry);
	report = made.report;
	surface = { ...detail, geometry: made.geometry, count: (surface?.count ?? 0) + 1 };
	if (!detail.bounds && !viewport.empty)
		session.box = { min: viewport.box.min.toArray(),
			max: viewport.box.max.toArray() };
	facts.replaceChildren(...factsOf(made.geometry, detail));
	if (first || Math.abs(Math.log(viewport.size / was)) > 0.3)
		showSelected(false);
	if (slice.on || sliceWanted)
		setSlice(true, playing || detail.coarse);
	if (mode === "curvature")
		curvatures();
});

function factsOf(geometry, { ms, coarse, draft, bounds }) {
	const count = (x) => x.toLocaleString("en").replaceAll(",", "\u202f");
	const vertices = geometry.getAttribute("position").count;
	if (vertices === 0)
		return ["No surface at this iso-value."];
	const triangles = (geometry.index?.count ?? vertices) / 3;
	return [`${count(triangles)} triangles`,
		report.genus !== undefined ? `genus ${report.genus}` : null,
		report.components > 1 ? `${report.components} parts` : null,
		report.volume ? `volume ${digits(report.volume, 3)}` : null,
		bounds ? `has no end: shown from ${bounds.min.map((x) => digits(x, 2))
			.join(" ")} to ${bounds.max.map((x) => digits(x, 2)).join(" ")}` : null,
		coarse ? "coarse" : null, draft ? "draft tables" : null,
		ms < 1000 ? `${Math.round(ms)} ms` : `${digits(ms / 1000, 2)} s`]
		.filter((t) => t).map((t) => h("span", {}, t));
}

function showStatus() {
	const [kind, text] = !session.online ? ["bad", "Reconnecting…"]
		: session.gone ? ["bad", "Deleted"]
		: problems ? ["bad", problems === 1 ? "1 problem" : `${problems} problems`]
			: { waiting: ["busy", "Edited"], sending: ["busy", "Sending"],
				coarse: ["busy", "Meshing"], fine: ["busy", "Refining"],
				error: ["bad", "Problem"] }[session.phase] ?? ["good", "Up to date"];
	dot.className = `dot ${kind}`;
	status.textContent = text;
	document.body.dataset.phase = session.phase;
	document.body.dataset.online = String(session.online);
}

async function openText(text) {
	await opened(session.open(null, text));
}

async function opened(promise) {
	try {
		await promise;
		return true;
	} catch (error) {
		if (!(error instanceof api.Problem))
			throw error;
		note(error.message);
		return false;
	}
}

async function begin() {
	const id = new URLSearchParams(location.hash.slice(1)).get("scene");
	if (id && await opened(session.open(id)))
		return;
	const kept = remembered();
	if (!id && kept)
		return opened(session.open(kept.id, kept.text));
	openText((EXAMPLES.find((e) => e.file === "letter-a.json") ??
		EXAMPLES[0]).text);
}

window.addEventListener("popstate", () => {
	const id = new URLSearchParams(location.hash.slice(1)).get("scene");
	if (id && id !== session.id)
		opened(session.open(id));
});

/* ---- shading, slice, surface ---- */

function setMode(to) {
	mode = to;
	for (const b of modes.children) {
		b.setAttribute("aria-checked", String(b.dataset.mode === to));
		b.tabIndex = b.dataset.mode === to ? 0 : -1;
	}
	viewport.setMode(to);
	showLegend(null);
	if (to === "curvature")
		curvatures();
}

modes.addEventListener("keydown", (event) => {
	const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
	if (!step)
		return;
	event.preventDefault();
	setMode(MODES[(MODES.indexOf(mode) + step + MODES.length) % MODES.length]);
	modes.querySelector("[aria-checked=true]").focus();
});

const wire = () => viewport.material.uniforms.wire.value;

function setWire(on) {
	viewport.setWire(on);
	wireButton.setAttribute("aria-pressed", String(on));
}

/* The field's own curvatures at the surface's vertices. */
async function curvatures() {
	const shown = surface;
	if (!shown || viewport.empty)
		return;
	try {
		const positions = shown.geometry.getAttribute("position").array;
		const values = await api.evaluate(session.id, new Float32Array(positions),
			"curvature", { etag: shown.etag });
		if (shown !== surface)
			return;
		refused = 0;
		viewport.setCurvature(values);
		const sizes = [];
		for (let i = gauss ? 1 : 0; i < values.length; i += 2)
			sizes.push(gauss ? Math.sqrt(Math.abs(values[i])) : Math.abs(values[i]));
		sizes.sort((a, b) => a - b);
		const full = sizes[Math.floor(0.92 * (sizes.length - 1))] || 1;
		viewport.setCurvatureScale(1 / full, gauss);
		if (mode === "curvature")
			showLegend(full);
	} catch (error) {
		if (!(error instanceof api.Problem || error instanceof api.Offline))
			throw error;
		// Another surface comes, or the daemon has too much to do.
		if (shown !== surface || [404, 412].includes(error.status))
			return;
		if (error.status >= 500 && ++refused <= 5)
			setTimeout(() => shown === surface && mode === "curvature" &&
				curvatures(), 400 * refused);
		else if (error instanceof api.Problem)
			note(`No curvatures: ${error.message}`);
	}
}

let refused = 0;

function showLegend(full) {
	legend.hidden = full === null;
	if (full === null)
		return;
	const show = gauss ? full * full : full;
	legend.replaceChildren(h("button", { title: "Mean or Gaussian",
		onclick: () => {
			gauss = !gauss;
			curvatures();
		} }, gauss ? "Gaussian curvature" : "Mean curvature"),
	h("span", {}, `−${digits(show, 2)}`), h("span", { class: "ramp" }),
	h("span", {}, `+${digits(show, 2)}`));
}

let sliceWanted = false;

function setSlice(on, moving = false) {
	const was = sliceWanted;
	sliceWanted = on;
	if (on === slice.on)
		slice.update(moving);
	else
		slice.show(on);
	sliceButton.setAttribute("aria-pressed", String(on));
	slicePanel.hidden = !on || !viewport.box;
	if (on && !slicePanel.firstChild && viewport.box)
		makeSlicePanel();
	if (on && !was && !narrow())
		slicePanel.scrollIntoView({ block: "nearest" });
}

function makeSlicePanel() {
	const { min, max } = slice.range;
	const where = slider({ name: "offset", min, max, value: slice.offset,
		title: "slice offset", changed: (v, last) => slice.move(v, !last) });
	const turn = (name, key, low, high) => slider({ name, min: low, max: high,
		title: `slice ${name}`, value: slice[key] * 180 / Math.PI, unit: "°",
		step: 0.5, changed: (v, last) => {
			const middle = viewport.center.dot(slice.normal);
			const off = slice.offset - middle;
			slice[key] = v * Math.PI / 180;
			slice.offset = viewport.center.dot(slice.normal) + off;
			slice.move(slice.offset, !last);
		} });
	const azimuth = turn("turn", "azimuth", -180, 180);
	const tilt = turn("tilt", "tilt", -90, 90);
	const cut = h("input", { type: "checkbox", checked: slice.cut,
		onchange: () => {
			slice.cut = cut.checked;
			slice.update(false);
		} });
	slice.moved = () => {
		where.range(slice.range.min, slice.range.max);
		where.set(slice.offset);
		azimuth.set(slice.azimuth * 180 / Math.PI);
		tilt.set(slice.tilt * 180 / Math.PI);
	};
	const across = (name, a, t) => h("button", { class: "chip",
		onclick: () => {
			slice.turn(a, t);
			slicePanel.replaceChildren();
			makeSlicePanel();
		} }, name);
	slicePanel.append(h("h2", {}, "Slice ", h("span", { class: "soft" },
		"the exact field")),
	h("div", { class: "more" }, across("across x", 0, 0),
		across("across y", -Math.PI / 2, 0), across("across z", 0, Math.PI / 2)),
	where.element, azimuth.element, tilt.element,
	slider({ name: "lines every", title: "slice step", min: 0.02, max: 0.5,
		value: slice.step, changed: (v, last) => {
			slice.step = v;
			slice.update(!last);
		} }).element,
	h("label", { class: "check" }, cut, "cut the model open"));
}

const RESOLUTION = "blobfield.resolution";

function makeSurfacePanel() {
	const resolutions = [24, 48, 64, 96, 128, 192, 256, 384];
	const choice = h("select", { "aria-label": "resolution", onchange: () => {
		session.resolution = Number(choice.value);
		keep(RESOLUTION, session.resolution);
		session.picture();
	} }, ...resolutions.map((r) => h("option", { value: r }, `${r} cells`)));
	const kept = recall(RESOLUTION);
	if (resolutions.includes(kept))
		session.resolution = kept;
	choice.value = String(session.resolution);
	const sharp = h("input", { type: "checkbox", checked: true, onchange: () => {
		session.features = sharp.checked;
		session.coarse = null;
		session.picture();
	} });
	const iso = slider({ name: "iso", title: "iso", min: 0.02, max: 0.98,
		value: session.iso, changed: (v) => {
			session.iso = Math.min(1000, Math.max(0.001, v));
			session.live(session.text);
		} });
	surfacePanel.append(h("h2", {}, "Surface"), iso.element,
		h("div", { class: "slider" }, h("label", {}, "resolution"), choice),
		h("label", { class: "check" }, sharp, "keep sharp edges"));
}

/* ---- picking ---- */

let picks = 0;

/* What is behind a click; of several the latest counts. */
async function pick(ray) {
	const id = session.id;
	const mine = ++picks;
	const late = () => mine !== picks || id !== session.id;
	const opened = slice.on && slice.cut;
	const hidden = (p) => opened && slice.normal.dot(p) >
		slice.offset + 1e-4 * viewport.size;
	const nothing = () => {
		viewport.setPin(null);
		pointPanel.hidden = true;
	};
	const origin = ray.origin.clone();
	const onSlice = hidden(origin);
	if (onSlice) {
		// What is before the cut is not there.
		const b = slice.normal.dot(ray.direction);
		if (b >= 0)
			return nothing();
		ray.at((slice.offset - slice.normal.dot(origin)) / b, origin);
	}
	try {
		const o = origin.toArray();
		if (onSlice && !aiming) {
			const [value, gx, gy, gz] = await api.evaluate(id, new Float32Array(o),
				"value,gradient", {});
			if (late())
				return;
			if (value >= session.iso)
				return showPoint({ position: o, value, gradient: [gx, gy, gz],
					node: null, slice: true });
		}
		const hit = await api.raycast(id, { rays: [[...o,
			...ray.direction.toArray()]], iso: session.iso }, {});
		if (late())
			return;
		const position = hit.position[0];
		if (!hit.hit[0] || hidden(origin.clone().set(...position)))
			return nothing();
		if (aiming)
			return await openTo(position);
		const curvature = await api.evaluate(id, new Float32Array(position),
			"curvature", {});
		if (late())
			return;
		showPoint({ position, value: hit.value[0], gradient: hit.gradient[0],
			normal: hit.normal[0], node: hit.node[0], distance: hit.distance[0],
			curvature });
	} catch (error) {
		if (!(error instanceof api.Problem || error instanceof api.Offline))
			throw error;
		note(error.message);
	}
}

/* The next click says where the blend of that node is to end. */
function aim(pointer) {
	aiming = pointer && { pointer, id: inspector.named(pointer) };
	view.classList.toggle("aim", Boolean(aiming));
	note(aiming ? "Click the surface where the blend is to end." : null, true);
}

let aiming = null;

/* Section 2 of the paper: the operator opens so far that it ends there. */
async function openTo(point) {
	const { pointer, id } = aiming;
	aim(null);
	const scene = session.id;
	const { theta, alpha, parameter } =
		await api.openingAngle(scene, id, point);
	if (scene !== session.id)
		return;
	if (!parameter)
		return note(alpha === null ? "Nothing else reaches that point."
			: "This operator has no opening.");
	inspector.open(pointer, parameter, theta);
	note(`${parameter.replace("theta", "θ")} = ${digits(theta)}`);
}

function showPoint({ position, value, gradient, normal, node, curvature, slice:
	inSlice }) {
	const steep = Math.hypot(...gradient);
	viewport.setPin(position, normal ?? gradient.map((g) => -g));
	const row = (name, text) => [h("dt", {}, name), h("dd", {}, text)];
	const triple = (v) => v.map((x) => digits(x, 4)).join("  ");
	pointPanel.replaceChildren(h("h2", {}, "Point ", h("span", { class: "soft" },
		inSlice ? "in the slice" : "on the surface"), h("span", { class: "space" }),
	h("button", { class: "icon-button", "aria-label": "Close", onclick: () => {
		pointPanel.hidden = true;
		viewport.setPin(null);
	} }, icon("close"))), h("dl", {},
		...row("position", triple(position)), ...row("value", digits(value, 7)),
		...row("gradient", triple(gradient)), ...row("steepness", digits(steep, 4)),
		...normal ? row("normal", triple(normal)) : [],
		...curvature ? row("curvature", `mean ${digits(curvature[0], 3)}, Gaussian ${
			digits(curvature[1], 3)}`) : [],
		...node ? row("node", h("button", { class: "link", onclick: () =>
			select(node, "pick") }, node)) : []));
	pointPanel.hidden = false;
	if (node)
		select(node, "pick");
}

/* ---- time ---- */

async function play() {
	const base = { doc: structuredClone(doc), text: editor.text };
	const mine = playing = { begin: performance.now() };
	showPlay();
	let written = 0;
	while (playing === mine) {
		const now = performance.now();
		const text = applyAll(base.text, lava.at(base.doc, (now - mine.begin) / 1000));
		if (now - written > 240) {
			written = now;
			editor.setText(text, "play", { remember: false });
		}
		mine.text = text;
		await session.live(text, { rest: false });
		mine.frames = (mine.frames ?? 0) + 1;
		if (playing !== mine)
			return;
		if (session.phase === "error" || session.conflict)
			return stop();
		await new Promise((done) => setTimeout(done,
			Math.max(0, 33 - (performance.now() - now))));
	}
}

/* keep: the text is to be what is shown; else there is another already. */
function stop(keep = true) {
	const was = playing;
	playing = null;
	showPlay();
	if (keep && was?.text) {
		editor.setText(was.text, "play", { remember: false });
		session.edit(was.text);
	}
}

function showPlay() {
	playButton.replaceChildren(icon(playing ? "pause" : "play"),
		h("span", {}, playing ? "Pause" : "Play"));
}

/* ---- files, links ---- */

function save(blob, name) {
	const link = h("a", { href: URL.createObjectURL(blob), download: name });
	link.click();
	setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

const fileName = (ending) => `${String(doc?.name || "blobfield")
	.replaceAll(/[^\w.-]+/g, "-")}.${ending}`;

async function exportMesh(format, accept) {
	note(`Making the ${format.toUpperCase()}…`, true);
	try {
		save(await api.file(session.id, "mesh", { resolution: session.resolution,
			iso: session.iso, features: session.features, format,
			bounds: session.bounds ?? undefined },
		{ accept }), fileName(format));
		note(null);
	} catch (error) {
		note(error.message);
	}
}

async function exportPicture() {
	note("Rendering…", true);
	const { clientWidth: w, clientHeight: h_ } = view;
	// As many pixels as full HD.
	const scale = Math.sqrt(1920 * 1080 / (w * h_));
	try {
		save(await api.file(session.id, "render", {
			width: Math.round(w * scale), height: Math.round(h_ * scale),
			camera: viewport.view, samples: 4, iso: session.iso,
			shading: { colour: "lit" }[mode] ?? mode }, { accept: "image/png" }),
		fileName("png"));
		note(null);
	} catch (error) {
		note(error.message);
	}
}

for (const [name, what, action] of [
	["GLB", "glTF, with colours", () => exportMesh("glb", "model/gltf-binary")],
	["PLY", "with colours", () => exportMesh("ply", "application/x-ply")],
	["STL", "for printing", () => exportMesh("stl", "model/stl")],
	["OBJ", "as text", () => exportMesh("obj", "model/obj")],
	["PNG", "ray-cast by the daemon", exportPicture],
	["JSON", "the document", () => save(new Blob([editor.text],
		{ type: "application/json" }), fileName("json"))],
])
	menu.append(h("button", { role: "menuitem", "data-format": name.toLowerCase(),
		onclick: action }, h("strong", {}, name), h("span", { class: "soft" }, what)));
document.addEventListener("click", () => openMenu(false));

function openMenu(open) {
	const opener = menu.previousElementSibling;
	if (!open && menu.contains(document.activeElement))
		opener.focus();
	menu.hidden = !open;
	opener.setAttribute("aria-expanded", String(open));
}

menu.parentElement.addEventListener("keydown", (event) => {
	const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
	if (event.key === "Escape" && !menu.hidden) {
		event.stopPropagation();
		openMenu(false);
	} else if (step) {
		event.preventDefault();
		openMenu(true);
		const all = [...menu.children];
		const i = all.indexOf(document.activeElement);
		all[i < 0 ? 0 : (i + step + all.length) % all.length].focus();
	}
});

function openFile() {
	const input = h("input", { type: "file", accept: ".json,application/json" });
	input.addEventListener("change", async () => {
		if (input.files[0])
			openText(await input.files[0].text());
	});
	input.click();
}

view.addEventListener("dragover", (event) => event.preventDefault());
view.addEventListener("drop", async (event) => {
	event.preventDefault();
	if (event.dataTransfer.files[0])
		openText(await event.dataTransfer.files[0].text());
});

async function copyLink() {
	try {
		await navigator.clipboard.writeText(location.href);
		note("Link copied. Whoever opens it edits the same scene.");
	} catch {
		note(location.href);
	}
}

let noteTimer = null;

/* Says it for a while; until something else is said, if stay. */
function note(text, stay = false) {
	clearTimeout(noteTimer);
	toast.hidden = text === null;
	toast.textContent = text ?? "";
	if (!stay)
		noteTimer = setTimeout(() => { toast.hidden = true; }, 4000);
}

/* ---- keys, sizes ---- */

document.addEventListener("keydown", (event) => {
	const typing = event.composedPath().some((e) => e instanceof HTMLElement &&
		(e.isContentEditable || /^(INPUT|TEXTAREA|SELECT)$/.test(e.tagName)));
	if (typing || event.ctrlKey || event.metaKey || event.altKey ||
	    gallery.element.open)
		return;
	const keys = { f: () => viewport.fit(), w: () => setWire(!wire()),
		s: () => setSlice(!sliceWanted), 1: () => setMode(MODES[0]),
		2: () => setMode(MODES[1]), 3: () => setMode(MODES[2]),
		4: () => setMode(MODES[3]), Escape: () => aiming ? aim(null) : select("/root", "key") };
	keys[event.key]?.();
});

drag(bar2, () => ({ move: (event) => document.body.style.setProperty("--left",
	`${Math.min(innerWidth * 0.6, Math.max(220, event.clientX))}px`) }));
drag(bar1, () => ({ move: (event) => left.style.setProperty("--tree",
	`${Math.max(60, event.clientY - left.getBoundingClientRect().top)}px`) }));

makeSurfacePanel();
showStatus();
session.start();
begin();

/* For tests. */
window.__blobfield = { session, viewport, slice, editor, EXAMPLES,
	get surface() { return surface; }, get report() { return report; },
	get selected() { return selected; }, get doc() { return doc; },
	get playing() { return playing; } };
