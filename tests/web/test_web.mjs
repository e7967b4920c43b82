#!/usr/bin/env node
// The previewer, driven in Debian's Chromium against the real daemon. Any error
// on the console, any exception and any violation of the page's
// Content-Security-Policy fails the case it happens in, but for the requests
// that a case says will fail.
//
// Prints its cases as cmocka does. The daemon is BLOBFIELDD, else
// build/blobfieldd; CHROMIUM is the browser, else /usr/bin/chromium;
// screenshots go to WEB_SHOTS if that is set. Arguments: the names of cases.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { createHash } from "node:crypto";
import { mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from
	"node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const root = fileURLToPath(new URL("../../", import.meta.url));
const require = createRequire(join(root, "clients/web/package.json"));
const { chromium } = require("playwright-core");

const temporary = mkdtempSync(join(tmpdir(), "blobfield-web-"));
const shots = process.env.WEB_SHOTS;
if (shots)
	mkdirSync(shots, { recursive: true });

/* ---- the daemon ---- */

class Daemon {
	/* At url's port, or a free one. */
	async start(...more) {
		const port = this.url ? new URL(this.url).port : 0;
		this.process = spawn(process.env.BLOBFIELDD ??
			join(root, "build/blobfieldd"), ["--listen", `127.0.0.1:${port}`,
			"--cache", join(temporary, "cache"),
			"--data", ":memory:", ...more],
		{ stdio: ["ignore", "pipe", "ignore"] });
		this.ended = new Promise((done) => this.process.on("exit", done));
		let said = "";
		for await (const chunk of this.process.stdout) {
			said += chunk;
			const m = /http:\/\/\S+/.exec(said);
			if (m) {
				this.url = m[0];
				break;
			}
		}
		assert(this.url, "the daemon did not start");
		for (;;) {
			const answer = await fetch(`${this.url}/readyz`);
			if (answer.ok)
				return;
			await new Promise((done) => setTimeout(done, 100));
		}
	}

	async stop() {
		this.process.kill("SIGTERM");
		await this.ended;
	}

	async json(path, body) {
		const answer = await fetch(this.url + path, body && { method: "POST",
			headers: { "Content-Type": "application/json" },
			body: JSON.stringify(body) });
		return answer.json();
	}
}

const daemon = new Daemon();
let browser;

/* ---- pages ---- */

let faults = [];      // of the case that runs
let expected = [];    // patterns of faults that it expects

function watch(page) {
	page.on("console", (message) => {
		if (message.type() === "error" || message.type() === "warning")
			faults.push(`${message.text()} ${message.location().url}`);
	});
	page.on("pageerror", (error) => faults.push(error.stack));
}

/* A page in a profile of its own. */
async function open(hash = "", options = {}, prepare = null) {
	const context = await browser.newContext({ viewport: { width: 1060,
		height: 640 }, acceptDownloads: true, ...options });
	await context.addInitScript(() =>
		document.addEventListener("securitypolicyviolation", (event) =>
			console.error("CSP violation:", event.violatedDirective,
				event.blockedURI, event.sourceFile, event.lineNumber)));
	const page = await context.newPage();
	page.setDefaultTimeout(60000);
	watch(page);
	await prepare?.(page);
	page.answer = await page.goto(`${daemon.url}/${hash}`);
	await settled(page);
	await page.evaluate(() => { window.__blobfield.session.poll = 250; });
	return page;
}

/* Until a fine surface of the text as it is is shown. */
function settled(page) {
	return page.waitForFunction(() => {
		const b = window.__blobfield;
		return b?.surface && !b.surface.coarse && b.session.phase === "idle" &&
			b.surface.etag === b.session.etag && b.session.text === b.session.saved &&
			b.session.text === b.editor.text;
	}, null, { polling: 30 });
}

const state = (page) => page.evaluate(() => {
	const b = window.__blobfield;
	return { text: b.editor.text, count: b.surface.count, etag: b.surface.etag,
		coarse: b.surface.coarse, phase: b.session.phase, id: b.session.id,
		triangles: b.report.triangles, selected: b.selected,
		camera: b.viewport.camera.position.toArray(), doc: b.doc,
		target: b.viewport.controls.target.toArray(),
		height: b.viewport.box.max.z - b.viewport.box.min.z };
});

/* An edit of the user: a piece of text replaced. */
function edit(page, what, by) {
	return page.evaluate(([what, by]) => {
		const { editor } = window.__blobfield;
		const from = editor.text.indexOf(what);
		if (from < 0)
			throw new Error(`no ${what} in the document`);
		editor.view.dispatch({ changes: { from, to: from + what.length, insert: by } });
	}, [what, by]);
}

/* Another document, and its surface. */
async function show(page, file) {
	await page.evaluate((file) => {
		const { session, EXAMPLES } = window.__blobfield;
		session.open(null, EXAMPLES.find((e) => e.file === file).text);
	}, file);
	await settled(page);
}

const row = (page, name) => page.locator(".row", { has: page.locator(".name",
	{ hasText: new RegExp(`^${name}$`) }) });

/* A slider moved as by hand. */
async function slide(page, name, share) {
	await page.locator(`[data-name="${name}"] input[type=range]`).evaluate(
		(bar, share) => {
			bar.value = String(share * 1000);
			bar.dispatchEvent(new Event("input", { bubbles: true }));
			bar.dispatchEvent(new Event("change", { bubbles: true }));
		}, share);
}

/* Where a point in space is on the page. */
function onScreen(page, point) {
	return page.evaluate((point) => {
		const { viewport } = window.__blobfield;
		viewport.camera.updateMatrixWorld();
		const p = viewport.camera.position.clone().set(...point)
			.project(viewport.camera);
		const box = viewport.canvas.getBoundingClientRect();
		return { x: box.left + (p.x + 1) / 2 * box.width,
			y: box.top + (1 - p.y) / 2 * box.height };
	}, point);
}

/* The picture's pixels: {model: share that is opaque, mean: [r, g, b] of those,
 * sum: a checksum}. */
function pixels(page) {
	return page.evaluate(() => {
		const { viewport } = window.__blobfield;
		viewport.paint();
		const gl = viewport.renderer.getContext();
		const [w, h] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
		const data = new Uint8Array(4 * w * h);
		gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, data);
		let count = 0;
		let sum = 0;
		const mean = [0, 0, 0];
		for (let i = 0; i < data.length; i += 4) {
			sum = (sum * 31 + data[i] + 3 * data[i + 1] + 5 * data[i + 2]) % 1000000007;
			if (data[i + 3] !== 255)
				continue;
			count++;
			for (let c = 0; c < 3; c++)
				mean[c] += data[i + c];
		}
		return { model: count / (w * h), mean: mean.map((m) => m / Math.max(1, count)),
			sum };
	});
}

const shot = (page, name) => shots &&
	page.screenshot({ path: join(shots, `${name}.png`) });

/* Another text, as if pasted. */
function paste(page, doc) {
	return page.evaluate((text) => {
		const { editor } = window.__blobfield;
		editor.view.dispatch({ changes: { from: 0, to: editor.text.length,
			insert: text } });
	}, typeof doc === "string" ? doc : JSON.stringify(doc, null, 2));
}

const scene = (root) => ({ format: "blobfield/1", name: "a test", root });
const balls = (operator, far = 0.6) => scene({ type: "union", operator,
	children: [{ type: "point", center: [0, 0, 0], radius: 0.5 },
		{ type: "point", center: [far, 0, 0], radius: 0.5 }] });

/* A slider's thumb under the mouse, which is pressed: to(share) moves it. */
async function hold(page, name) {
	const bar = page.locator(`[data-name="${name}"] input[type=range]`);
	await bar.scrollIntoViewIfNeeded();
	const box = await bar.boundingBox();
	const at = (share) => [box.x + 7 + (box.width - 14) * share,
		box.y + box.height / 2];
	await page.mouse.move(...at(Number(await bar.inputValue()) / 1000));
	await page.mouse.down();
	return { bar, to: (share) => page.mouse.move(...at(share)) };
}

/* ---- cases ---- */

let page;     // most cases share one
const cases = {};

cases.test_page_comes_under_a_strict_policy = async () => {
	page = await open();
	const policy = page.answer.headers()["content-security-policy"];
	assert.match(policy, /default-src 'none'/);
	assert.match(policy, /script-src 'self'/);
	assert.doesNotMatch(policy, /unsafe|\*/);
	const { model } = await pixels(page);
	assert(model > 0.02 && model < 0.7, `the model covers ${model}`);
	assert.equal(await page.locator(".status").textContent(), "Up to date");
	await shot(page, "first");
};

cases.test_gallery_has_examples_with_pictures = async () => {
	await page.getByRole("button", { name: "Examples" }).click();
	assert(await page.locator(".card").count() >= 20);
	await page.waitForFunction(() =>
		document.querySelectorAll(".card img").length >= 2);
	const drawn = await page.locator(".card img").first().evaluate((image) =>
		image.decode().then(() => image.naturalWidth));
	assert.equal(drawn, 264);
	await shot(page, "gallery");
	const before = page.url();
	await page.locator("[data-file='tee.json']").click();
	await page.waitForFunction((before) => location.href !== before, before);
	await settled(page);
	assert.equal((await state(page)).doc.name, JSON.parse(readFileSync(
		join(root, "clients/models/tee.json"), "utf8")).name);
	await page.goBack();
	await page.waitForFunction((before) => location.href === before, before);
	await settled(page);
	assert.match(await page.locator(".title").textContent(), /letter A/);
};

cases.test_camera_is_kept_across_edits = async () => {
	const box = await page.locator("canvas").boundingBox();
	const before = await state(page);
	await page.mouse.move(box.x + 60, box.y + box.height - 120);
	await page.mouse.down();
	await page.mouse.move(box.x + 160, box.y + box.height - 160, { steps: 4 });
	await page.mouse.up();
	const turned = await state(page);
	assert.notDeepEqual(turned.camera, before.camera);
	await edit(page, "\"radius\": 0.2", "\"radius\": 0.23");
	await settled(page);
	const edited = await state(page);
	assert.notEqual(edited.etag, turned.etag);
	assert.deepEqual(edited.camera, turned.camera);
	assert.deepEqual(edited.target, turned.target);
	await page.getByLabel("From the front").click();
	const front = await state(page);
	assert(Math.abs(front.camera[0] - front.target[0]) < 1e-3);
	await edit(page, "\"radius\": 0.23", "\"radius\": 0.2");
	await settled(page);
};

cases.test_edits_are_debounced_and_shown_coarse_then_fine = async () => {
	const sent = [];
	const listen = (request) => {
		if (request.method() === "PUT")
			sent.push({ put: Date.now() });
		if (request.url().includes("/mesh"))
			sent.push({ mesh: request.postDataJSON().resolution });
	};
	page.on("request", listen);
	await page.evaluate(() => {
		const { editor } = window.__blobfield;
		editor.jump(editor.text.indexOf("0.8]") + 3);
	});
	await page.keyboard.press("5");
	// As fast as people type, whatever else the machine does.
	const typed = await page.evaluate(async () => {
		const { view } = window.__blobfield.editor;
		for (const key of "678") {
			await new Promise((done) => setTimeout(done, 60));
			view.dispatch(view.state.replaceSelection(key));
		}
		return Date.now();
	});
	await settled(page);
	page.off("request", listen);
	const puts = sent.filter((s) => s.put);
	// The key pressed may have come too long before the others.
	assert(puts.length <= 2, `${puts.length} of 4 edits were sent`);
	assert(puts.at(-1).put - typed >= 240, `${puts.at(-1).put - typed} ms`);
	assert.deepEqual(sent.filter((s) => s.mesh).map((s) => s.mesh).slice(-2),
		[24, 96]);
	assert.match((await state(page)).text, /0\.85678\]/);
	await page.getByLabel("resolution").selectOption("48");
	await edit(page, "0.85678]", "0.8]");
	await settled(page);
};

cases.test_errors_are_placed_and_the_old_picture_stays = async () => {
	expected = [/422 \(/];
	const before = await state(page);
	const picture = await pixels(page);
	await edit(page, "\"radius\": 0.16", "\"raduis\": 0.16");
	await page.locator(".problems li").first().waitFor();
	const places = await page.locator(".problems code").allTextContents();
	assert(places.includes("/root/children/2/raduis"), String(places));
	assert.match(await page.locator(".problems").textContent(),
		/did you mean 'radius'/);
	const marked = await page.locator(".cm-lintRange-error").allTextContents();
	assert(marked.includes("\"raduis\": 0.16"), String(marked));
	assert(await page.locator(".cm-lint-marker-error").count() >= 1);
	assert.match(await page.locator(".status").textContent(), /problem/);
	const after = await state(page);
	assert.equal(after.etag, before.etag);
	assert.equal(after.count, before.count);
	assert.equal((await pixels(page)).model, picture.model);
	await shot(page, "errors");
	await page.locator(".problems button").first().click();
	await edit(page, "raduis", "radius");
	await settled(page);
	assert.equal(await page.locator(".problems").isVisible(), false);
	assert.equal(await page.locator(".cm-lintRange-error").count(), 0);
};

cases.test_what_is_no_json_is_not_sent = async () => {
	let puts = 0;
	const listen = (request) => { puts += request.method() === "PUT"; };
	page.on("request", listen);
	await edit(page, "\"children\": [", "\"children\": ");
	await page.locator(".problems li").first().waitFor();
	assert.match(await page.locator(".problems").textContent(), /Not JSON/);
	assert(await page.locator(".row").count() > 3, "the tree stays");
	await edit(page, "\"children\": ", "\"children\": [");
	await settled(page);
	page.off("request", listen);
	// Back at what the daemon has.
	assert.equal(puts, 0);
};

cases.test_superseded_requests_are_aborted_and_stale_answers_dropped = async () => {
	const failed = [];
	const listen = (request) => failed.push(request.failure().errorText);
	page.on("requestfailed", listen);
	let held = 0, release;
	const released = new Promise((done) => { release = done; });
	await page.route("**/mesh*", async (route) => {
		if (held++ === 0)
			await released;
		await route.continue().catch(() => {});
	});
	const surfaces = await page.evaluateHandle(() => {
		const seen = [];
		window.__blobfield.session.addEventListener("surface", ({ detail }) =>
			seen.push(detail.etag));
		return seen;
	});
	await edit(page, "\"radius\": 0.16", "\"radius\": 0.31");
	await page.waitForFunction(() => window.__blobfield.session.phase === "coarse");
	const stale = await page.evaluate(() => window.__blobfield.session.etag);
	await edit(page, "\"radius\": 0.31", "\"radius\": 0.12");
	await settled(page);
	release();
	await page.waitForTimeout(500);
	const seen = await surfaces.jsonValue();
	const now = await state(page);
	assert.notEqual(now.etag, stale);
	assert(seen.length >= 2 && seen.every((etag) => etag === now.etag));
	assert(failed.some((text) => text.includes("ERR_ABORTED")), String(failed));
	page.off("requestfailed", listen);
	await page.unroute("**/mesh*");
	await edit(page, "\"radius\": 0.12", "\"radius\": 0.16");
	await settled(page);
};

cases.test_tree_selects_in_editor_and_panel = async () => {
	await row(page, "bar").click();
	assert.equal((await state(page)).selected, "/root/children/2");
	const lines = (await page.locator(".cm-node").allTextContents()).join("");
	assert.match(lines, /"id": "bar"/);
	assert.equal(await page.locator(".node-head strong").textContent(), "bar");
	assert(await page.evaluate(() => window.__blobfield.viewport.skeleton
		.children[0].geometry.getAttribute("position").count) > 20);
	await page.locator(".tree").press("ArrowUp");
	assert.equal((await state(page)).selected, "/root/children/1");
	assert.equal(await page.locator(".row[aria-selected=true] .name").textContent(),
		"right-leg");
	// The other way round: the editor's cursor.
	await page.evaluate(() => {
		const { editor } = window.__blobfield;
		editor.view.focus();
		editor.view.dispatch({ selection: { anchor: editor.text.indexOf("left-leg") } });
	});
	assert.equal((await state(page)).selected, "/root/children/0");
};

cases.test_sliders_change_numbers_in_place = async () => {
	await row(page, "bar").click();
	const before = await state(page);
	await slide(page, "radius", 0.6);
	await page.waitForFunction((old) => window.__blobfield.surface.etag !== old,
		before.etag);
	await settled(page);
	const after = await state(page);
	const radius = after.doc.root.children[2].radius;
	assert(radius > 0.25 && radius < 0.4, String(radius));
	assert.equal(after.text.replace(`"radius": ${radius}`, "\"radius\": 0.16"),
		before.text);
	await page.locator("[data-name='radius'] .number").fill("0.16");
	await page.locator("[data-name='radius'] .number").press("Enter");
	await settled(page);
	assert.equal((await state(page)).text, before.text);
	await page.locator("[data-add=translation]").click();
	await slide(page, "translation y", 0.7);
	await settled(page);
	assert((await state(page)).doc.root.children[2].translation[1] > 0.3);
	await page.evaluate((text) => window.__blobfield.editor.setText(text),
		before.text);
	await settled(page);
};

cases.test_opening_is_plotted_and_edited = async () => {
	await row(page, "letter").click();
	const curve = page.locator(".plot.opening .curve");
	const before = await state(page);
	const drawn = await curve.getAttribute("d");
	await slide(page, "theta1", 0.5);
	await settled(page);
	const { operator } = (await state(page)).doc.root;
	assert(Math.abs(operator.opening.theta[1] - Math.PI / 8) < 2e-3);
	assert.deepEqual(operator.opening.alpha, [0, 1.5708, 3.1416]);
	assert.notEqual(await curve.getAttribute("d"), drawn);
	// The middle point, by the mouse, past its neighbour: the order holds.
	const dot = await page.locator(".plot.opening .dot").nth(1).boundingBox();
	const plot = await page.locator(".plot.opening").boundingBox();
	await page.mouse.move(dot.x + dot.width / 2, dot.y + dot.height / 2);
	await page.mouse.down();
	await page.mouse.move(plot.x + plot.width * 0.75, plot.y + 30, { steps: 3 });
	await page.mouse.up();
	await settled(page);
	const { alpha, theta } = (await state(page)).doc.root.operator.opening;
	assert(alpha[1] > 1.9 && alpha[1] <= alpha[2], String(alpha));
	assert(theta[1] > 0.55, String(theta));
	assert.equal(await page.getByLabel("alpha1, number").inputValue(),
		String(Number(alpha[1].toPrecision(4))));
	await shot(page, "opening");
	await page.evaluate((text) => window.__blobfield.editor.setText(text),
		before.text);
	await settled(page);
};

cases.test_opening_follows_a_click = async () => {
	const before = await state(page);
	await page.getByRole("button", { name: "open to a clicked point" }).click();
	// On the right leg's front, above the bar's end, which still reaches there.
	await page.evaluate(() => window.__blobfield.viewport.fit([0, -1, 0]));
	const at = await onScreen(page, [0.625, -0.19, 0.97]);
	await page.mouse.click(at.x, at.y);
	await page.waitForFunction((old) => window.__blobfield.editor.text !== old,
		before.text);
	await settled(page);
	const { theta } = (await state(page)).doc.root.operator.opening;
	assert(theta.some((t, i) => t !== [0.7854, 0, 0.7854][i]), String(theta));
	await page.evaluate((text) => window.__blobfield.editor.setText(text),
		before.text);
	await settled(page);
};

cases.test_profile_is_plotted_and_edited = async () => {
	const before = await state(page);
	const curve = page.locator(".plot.profile .curve");
	const smooth = await curve.getAttribute("d");
	await page.getByLabel("profile", { exact: true }).selectOption("bulge");
	await settled(page);
	const bulge = await curve.getAttribute("d");
	assert.notEqual(bulge, smooth);
	await slide(page, "bulge K", 0.3);
	await settled(page);
	const { operator } = (await state(page)).doc.root;
	assert(Math.abs(operator.profile.k - 0.3) < 2e-3);
	assert.equal(operator.draft, true);
	assert.notEqual(await curve.getAttribute("d"), bulge);
	await page.getByLabel("operator").selectOption("contact");
	await settled(page);
	assert.equal((await state(page)).doc.root.operator, "contact");
	await page.evaluate((text) => window.__blobfield.editor.setText(text),
		before.text);
	await settled(page);
};

cases.test_shadings_differ = async () => {
	await page.keyboard.press("Escape");
	await page.evaluate(() => window.__blobfield.viewport.setSkeleton([]));
	const seen = {};
	for (const mode of ["normal", "zebra", "curvature", "colour"]) {
		await page.locator(`[data-mode=${mode}]`).click();
		if (mode === "curvature")
			await page.locator(".legend").waitFor();
		seen[mode] = await pixels(page);
		await shot(page, mode);
	}
	const kinds = new Set(Object.values(seen).map((p) => p.sum));
	assert.equal(kinds.size, 4);
	for (const p of Object.values(seen))
		assert(Math.abs(p.model - seen.colour.model) < 1e-3);
	// From the front normals point to −y: little green.
	const [r, g, b] = seen.normal.mean;
	assert(g < 0.6 * r && g < 0.6 * b, String(seen.normal.mean));
	await page.getByLabel("Wireframe (W)").click();
	const wire = await pixels(page);
	assert(wire.mean[0] < seen.colour.mean[0] - 3);
	await shot(page, "wireframe");
	await page.getByLabel("Wireframe (W)").click();
	assert.equal((await pixels(page)).sum, seen.colour.sum);
};

cases.test_slice_shows_the_exact_field_and_can_be_dragged = async () => {
	const got = (many) => page.waitForFunction((many) => {
		const { slice } = window.__blobfield;
		return slice.pixels === 384 && slice.pictures >= many;
	}, many);
	await page.evaluate(() => window.__blobfield.viewport.fit([1, -1.6, 0.7]));
	const before = await pixels(page);
	await page.getByLabel("Slice (S)").click();
	await got(1);
	assert.notEqual((await pixels(page)).sum, before.sum);
	// Values in the picture are those of the field.
	const check = async () => {
		const samples = await page.evaluate(() => {
			const { slice } = window.__blobfield;
			const { center, right, up, extent } = slice.place;
			return [[192, 192], [100, 300], [250, 250], [140, 180]].map(([i, j]) => {
				const s = extent / 384;
				const p = center.clone().addScaledVector(right, (i + 0.5 - 192) * s)
					.addScaledVector(up, (192 - j - 0.5) * s);
				return { p: p.toArray(), f: slice.values[384 * j + i] };
			});
		});
		const { value } = await daemon.json(
			`/v1/scenes/${(await state(page)).id}/eval`,
			{ points: samples.map(({ p }) => p), outputs: ["value"] });
		// float32 coordinates, measured: 1e-6.
		samples.forEach(({ f }, i) => assert(Math.abs(f - value[i]) < 2e-5,
			`${f} ${value[i]}`));
		return samples;
	};
	assert((await check()).some(({ f }) => f > 0));
	await shot(page, "slice");
	const center = await page.evaluate(() =>
		window.__blobfield.slice.place.center.toArray());
	const at = await onScreen(page, center);
	const to = await onScreen(page, [center[0], center[1] - 0.12, center[2]]);
	const camera = (await state(page)).camera;
	const many = await page.evaluate(() => window.__blobfield.slice.pictures);
	await page.mouse.move(at.x, at.y);
	await page.mouse.down();
	await page.mouse.move(to.x, to.y, { steps: 5 });
	await page.waitForFunction((many) =>
		window.__blobfield.slice.pictures > many, many);
	await page.mouse.up();
	await page.waitForTimeout(250);
	await got(many + 2);
	const offset = await page.evaluate(() => window.__blobfield.slice.offset);
	assert(Math.abs(offset - 0.12) < 0.03, String(offset));
	assert.deepEqual((await state(page)).camera, camera);
	await check();
	await page.getByLabel("Slice (S)").click();
	await page.waitForTimeout(50);
	assert.equal((await pixels(page)).model.toFixed(3), before.model.toFixed(3));
};

cases.test_pick_tells_value_gradient_and_node = async () => {
	// On the bar, towards the camera.
	await page.evaluate(() => window.__blobfield.viewport.fit([0, -1, 0]));
	const at = await onScreen(page, [0, -0.16, 0.8]);
	await page.mouse.click(at.x, at.y);
	const panel = page.locator(".panel", { hasText: "steepness" });
	await panel.waitFor();
	const texts = await panel.locator("dd").allTextContents();
	const numbers = texts[0].trim().split(/\s+/).map(Number);
	assert(Math.abs(numbers[1] + 0.16) < 0.01, texts[0]);
	assert(Math.abs(Number(texts[1]) - 0.5) < 1e-3, texts[1]);
	const gradient = texts[2].trim().split(/\s+/).map(Number);
	assert(gradient[1] > 1, texts[2]);
	assert.equal(texts.at(-1), "/root/children/2");
	assert.equal((await state(page)).selected, "/root/children/2");
	assert.equal(await page.locator(".row[aria-selected=true] .name").textContent(),
		"bar");
	await shot(page, "pick");
	// Beside it: nothing.
	await page.mouse.click(at.x, at.y + 150);
	await page.waitForFunction(() => !window.__blobfield.viewport.pin.visible);
	assert.equal(await panel.isVisible(), false);
};

cases.test_iso_and_resolution = async () => {
	const before = await state(page);
	await page.getByLabel("resolution").selectOption("24");
	await settled(page);
	const coarse = await state(page);
	assert(coarse.triangles < 0.5 * before.triangles);
	await page.getByLabel("iso, number").fill("0.2");
	await page.getByLabel("iso, number").press("Enter");
	await page.waitForTimeout(300);
	await settled(page);
	const fat = await state(page);
	assert(fat.height > before.height + 0.05);
	await page.getByLabel("iso, number").fill("0.5");
	await page.getByLabel("iso, number").press("Enter");
	await page.waitForTimeout(300);
	await settled(page);
	assert(Math.abs((await state(page)).height - coarse.height) < 1e-6);
};

cases.test_exports = async () => {
	const begins = { glb: /^glTF/, png: /^\x89PNG/, ply: /^ply\n/, obj: /^(#|v|o|g|mtllib) ?/,
		json: /^\{\n {2}"format"/ };
	// A small picture will do here.
	await page.route("**/render", (route) => route.continue({ postData:
		JSON.stringify({ ...route.request().postDataJSON(), width: 160,
			height: 120, samples: 1 }) }));
	for (const format of ["glb", "ply", "stl", "obj", "png", "json"]) {
		await page.getByRole("button", { name: "Export" }).click();
		const [download] = await Promise.all([page.waitForEvent("download"),
			page.locator(`[data-format=${format}]`).click()]);
		assert.equal(download.suggestedFilename(), `letter-A.${format}`);
		const data = readFileSync(await download.path());
		if (format === "stl")
			assert.equal(data.length, 84 + 50 * data.readUInt32LE(80));
		else
			assert.match(data.toString("latin1"), begins[format]);
		if (format === "json")
			assert.equal(data.toString(), (await state(page)).text);
	}
	await page.unroute("**/render");
};

cases.test_progress_is_shown = async () => {
	await show(page, "thousand.json");
	await page.getByLabel("resolution").selectOption("384");
	await page.locator(".stage").waitFor();
	assert.match(await page.locator(".stage").textContent(), /^[a-z]+ · \d+ %$/);
	assert(Number(await page.locator(".progress").getAttribute("aria-valuenow")) >= 0);
	await page.getByLabel("resolution").selectOption("48");
	await settled(page);
	assert.equal(await page.locator(".progress").isVisible(), false);
};

cases.test_lava_lamp_moves = async () => {
	await show(page, "lava-lamp.json");
	const before = await state(page);
	await page.getByRole("button", { name: "Play" }).click();
	await page.waitForFunction(() => window.__blobfield.playing?.frames >= 6);
	const etags = await page.evaluate(() => window.__blobfield.surface.etag);
	assert.notEqual(etags, before.etag);
	await page.getByRole("button", { name: "Pause" }).click();
	await settled(page);
	const after = await state(page);
	assert.notDeepEqual(after.doc, before.doc);
	assert.deepEqual(after.camera, before.camera);
	await shot(page, "lava");
};

cases.test_opening_another_stops_the_lamp = async () => {
	await show(page, "lava-lamp.json");
	await page.getByRole("button", { name: "Play" }).click();
	await page.waitForFunction(() => window.__blobfield.playing?.frames >= 2);
	await show(page, "tee.json");
	await page.waitForTimeout(400);
	await settled(page);
	const tee = readFileSync(join(root, "clients/models/tee.json"), "utf8");
	const now = await state(page);
	assert.equal(now.text, tee);
	assert.equal(await (await fetch(`${daemon.url}/v1/scenes/${now.id}`)).text(),
		tee);
};

cases.test_typing_stops_the_lamp_and_is_kept = async () => {
	await show(page, "lava-lamp.json");
	await page.getByRole("button", { name: "Play" }).click();
	await page.waitForFunction(() => window.__blobfield.playing?.frames >= 2);
	// Where it stands does not matter: "name" is before all that moves.
	await page.evaluate(() => {
		const { editor } = window.__blobfield;
		editor.jump(editor.text.indexOf("\"name\": \"") + 9);
	});
	await page.keyboard.press("Q");
	await settled(page);
	const now = await state(page);
	assert.match(now.doc.name, /^Q/);
	assert.equal(await page.evaluate(() => window.__blobfield.playing), null);
};

cases.test_half_written_openings_are_sent_and_told_of = async () => {
	expected = [/422 \(/];
	for (const opening of [{ alpha: 1.5 }, { alpha: ["a", 1, 2] }, { theta: "x" },
		{ theta: [0.1] }]) {
		await paste(page, balls({ profile: "smooth", opening }));
		await page.locator(".problems code", { hasText: "/opening" }).first()
			.waitFor();
		assert.equal(await page.evaluate(() => window.__blobfield.session.text ===
			window.__blobfield.editor.text), true);
		await paste(page, balls("camel"));
		await settled(page);
	}
};

cases.test_slider_under_slow_surfaces_ends_fine = async () => {
	await page.getByLabel("resolution").selectOption("48");
	await paste(page, balls("camel"));
	await settled(page);
	await row(page, "point").first().click();
	let asked = [];
	await page.route("**/mesh*", async (route) => {
		asked.push(route.request().postDataJSON().resolution);
		await new Promise((done) => setTimeout(done, 280));
		await route.continue().catch(() => {});
	});
	const held = await hold(page, "radius");
	for (let i = 0; i < 12; i++) {
		await held.to(0.2 + 0.02 * i);
		await page.waitForTimeout(40);
	}
	await page.mouse.up();
	await settled(page);
	assert.equal(asked.at(-1), 48);
	assert(asked.length >= 3, String(asked));
	// So does iso, and there are pictures meanwhile.
	asked = [];
	const before = await state(page);
	const iso = await hold(page, "iso");
	let during = before;
	for (let i = 0; i < 14 || (during.count === before.count && i < 500); i++) {
		await iso.to(0.5 - 0.015 * (i % 14));
		await page.waitForTimeout(60);
		during = await state(page);
	}
	await page.mouse.up();
	await settled(page);
	await page.unroute("**/mesh*");
	assert(during.count > before.count, "no picture while it was dragged");
	assert.equal(asked.at(-1), 48);
	await page.getByLabel("iso, number").fill("0.5");
	await page.getByLabel("iso, number").press("Enter");
	await settled(page);
};

cases.test_undo_ends_where_the_document_begins = async () => {
	await show(page, "tee.json");
	await edit(page, "\"root\"", "\"roof\"");
	await edit(page, "\"roof\"", "\"root\"");
	await show(page, "die.json");
	const before = await state(page);
	await page.evaluate(() => window.__blobfield.editor.view.focus());
	for (let i = 0; i < 3; i++)
		await page.keyboard.press("Control+z");
	assert.equal((await state(page)).text, before.text);
};

cases.test_rotation_sliders_follow_the_text = async () => {
	const box = (rotation) => scene({ type: "box", center: [0, 0, 0],
		half_size: [0.5, 0.3, 0.2], falloff: 0.2, rotation });
	await paste(page, box([0, 0, 0, 1]));
	await settled(page);
	await row(page, "box").click();
	await paste(page, box([0, 0, 0.707107, 0.707107]));
	await settled(page);
	assert.equal(Math.round(await page.getByLabel("rotation z, number")
		.inputValue()), 90);
	const held = await hold(page, "rotation x");
	await held.to(0.6);
	await page.mouse.up();
	await settled(page);
	const q = (await state(page)).doc.root.rotation;
	assert(q.filter((x) => Math.abs(x) > 0.1).length === 4, String(q));
};

cases.test_the_daemons_failures_are_tried_again = async () => {
	expected = [/503 \(/];
	await show(page, "tee.json");
	let left = 1;
	await page.route("**/v1/scenes/*", async (route) => {
		if (route.request().method() !== "PUT" || left-- <= 0)
			return route.continue();
		await route.fulfill({ status: 503, json: { title: "busy" } });
	});
	await edit(page, "\"name\"", "\"name\" ");
	await settled(page);
	assert(left < 0);
	await page.unroute("**/v1/scenes/*");
	// A slice too.
	left = 1;
	await page.route("**/slice", (route) => left-- > 0
		? route.fulfill({ status: 503, json: { title: "busy" } })
		: route.continue());
	const many = await page.evaluate(() => window.__blobfield.slice.pictures ?? 0);
	await page.getByLabel("Slice (S)").click();
	await page.waitForFunction((many) =>
		window.__blobfield.slice.pictures > many, many);
	assert(left < 0);
	await page.getByLabel("Slice (S)").click();
	await page.unroute("**/slice");
};

cases.test_deleted_scene_is_put_back_only_if_asked = async () => {
	expected = [/404 \(/];
	const path = `${daemon.url}/v1/scenes/${(await state(page)).id}`;
	await fetch(path, { method: "DELETE" });
	await page.locator(".banner", { hasText: "deleted" }).waitFor();
	assert.equal((await fetch(path)).status, 404);
	assert.equal(await page.locator(".status").textContent(), "Deleted");
	await page.getByRole("button", { name: "Put it back" }).click();
	await settled(page);
	assert.equal((await fetch(path)).status, 200);
	assert.equal(await page.locator(".banner").isVisible(), false);
};

cases.test_named_operators_are_dragged_to_the_end = async () => {
	await paste(page, balls("camel"));
	await settled(page);
	await row(page, "union").click();
	const dot = page.locator(".plot.opening .dot").nth(1);
	await dot.scrollIntoViewIfNeeded();
	const before = await dot.boundingBox();
	const [x, y] = [before.x + before.width / 2, before.y + before.height / 2];
	await page.mouse.move(x, y);
	await page.mouse.down();
	await page.mouse.move(x, y - 40, { steps: 8 });
	await page.mouse.up();
	const moved = before.y - (await dot.boundingBox()).y;
	assert(Math.abs(moved - 40) < 2, `${moved} of 40 pixels`);
	await paste(page, balls("camel"));
	const held = await hold(page, "theta1");
	for (let i = 1; i <= 8; i++)
		await held.to(i / 16);
	await page.mouse.up();
	const { theta } = (await state(page)).doc.root.operator.opening;
	assert(Math.abs(theta[1] - Math.PI / 8) < 0.02, String(theta));
	await paste(page, balls("camel"));
	await held.bar.focus();
	for (let i = 0; i < 6; i++)
		await page.keyboard.press("ArrowRight");
	assert.equal(await held.bar.inputValue(), "6");
	await settled(page);
};

cases.test_slider_goes_on_while_the_model_grows = async () => {
	await row(page, "point").nth(1).click();
	const size = await page.evaluate(() => window.__blobfield.viewport.size);
	const held = await hold(page, "center x");
	const from = Number(await held.bar.inputValue()) / 1000;
	for (const share of [0.3, 0.6, 1]) {
		await held.to(from + (1 - from) * share);
		await page.waitForFunction((count) =>
			window.__blobfield.surface.count > count, (await state(page)).count);
	}
	const max = await page.evaluate(() =>
		window.__blobfield.doc.root.children[1].center[0]);
	assert.equal(await held.bar.inputValue(), "1000");
	await page.mouse.up();
	await settled(page);
	assert(max > 0.95 * size, `${max} of ${size}`);
	// Let go, its ends follow.
	await page.waitForFunction(() => document.querySelector(
		"[data-name='center x'] input[type=range]").value < 950);
};

cases.test_slice_ends_where_the_model_does = async () => {
	await paste(page, balls("blend"));
	await settled(page);
	await page.getByLabel("Slice (S)").click();
	await page.getByRole("button", { name: "across x" }).click();
	await paste(page, balls("blend", 12));
	await settled(page);
	const held = await hold(page, "slice offset");
	await held.to(0.97);
	await page.mouse.up();
	assert(await page.evaluate(() => window.__blobfield.slice.offset) > 11);
	await page.getByLabel("Slice (S)").click();
};

cases.test_surface_without_end_is_shown_in_part = async () => {
	expected = [/422 \(/];
	await show(page, "tee.json");
	await paste(page, scene({ type: "plane", point: [0, 0, 0],
		normal: [0, 0, 1], falloff: 1 }));
	await settled(page);
	assert.match(await page.locator(".facts").textContent(), /no end/);
	assert((await state(page)).triangles > 10);
	const button = page.getByLabel("Slice (S)");
	await button.click();
	assert.equal(await button.getAttribute("aria-pressed"), "true");
	await button.click();
	assert.equal(await button.getAttribute("aria-pressed"), "false");
	// Nor does a slice of nothing stay.
	await paste(page, balls("blend"));
	await page.getByLabel("iso, number").fill("900");
	await page.getByLabel("iso, number").press("Enter");
	await page.locator(".facts", { hasText: "No surface" }).waitFor();
	await button.click();
	await button.click();
	assert.equal(await button.getAttribute("aria-pressed"), "false");
	await page.getByLabel("iso, number").fill("0.5");
	await page.getByLabel("iso, number").press("Enter");
	await page.waitForTimeout(300);
	await settled(page);
};

cases.test_picks_come_in_order_and_not_from_what_is_cut_away = async () => {
	await paste(page, scene({ type: "union", operator: "sharp", children: [
		{ type: "sphere", id: "near", center: [0, -1, 0], radius: 0.5, falloff: 0.3 },
		{ type: "sphere", id: "far", center: [0, 1, 0], radius: 0.5, falloff: 0.3 },
	] }));
	await settled(page);
	await page.evaluate(() => window.__blobfield.viewport.fit([1, 0, 0.2]));
	const [near, far] = [await onScreen(page, [0, -1, 0]),
		await onScreen(page, [0, 1, 0])];
	let held = 0;
	await page.route("**/raycast", async (route) => {
		if (held++ === 0)
			await new Promise((done) => setTimeout(done, 700));
		await route.continue();
	});
	await page.mouse.click(near.x, near.y);
	await page.mouse.click(far.x, far.y);
	await page.waitForFunction(() =>
		window.__blobfield.selected === "/root/children/1");
	await page.waitForTimeout(1000);
	await page.unroute("**/raycast");
	assert.equal((await state(page)).selected, "/root/children/1");
	// A slice at y = 0 takes the near one away.
	await page.keyboard.press("Escape");
	await page.getByLabel("Slice (S)").click();
	await page.getByRole("button", { name: "across y" }).click();
	await page.mouse.click(near.x, near.y);
	await page.waitForFunction(() => !window.__blobfield.viewport.pin.visible);
	assert.equal((await state(page)).selected, "/root");
	await page.mouse.click(far.x, far.y);
	await page.waitForFunction(() =>
		window.__blobfield.selected === "/root/children/1");
	await page.getByLabel("Slice (S)").click();
};

cases.test_two_pages_see_each_others_edits = async () => {
	expected = [/412 \(/];
	await show(page, "letter-a.json");
	const other = await open(`#scene=${(await state(page)).id}`);
	await other.getByLabel("resolution").selectOption("24");
	assert.equal((await state(other)).text, (await state(page)).text);
	await edit(page, "\"radius\": 0.16", "\"radius\": 0.3");
	await other.waitForFunction(() =>
		window.__blobfield.editor.text.includes("\"radius\": 0.3"));
	await settled(other);
	assert.equal((await state(other)).etag, (await state(page)).etag);
	await edit(other, "\"radius\": 0.3", "\"radius\": 0.16");
	await page.waitForFunction(() =>
		window.__blobfield.editor.text.includes("\"radius\": 0.16"));
	await settled(page);
	// Both at once: the one that comes second is asked.
	for (const choice of ["Take theirs", "Keep mine"]) {
		await edit(page, "\"radius\": 0.16", "\"radius\": 0.21");
		await edit(other, "\"radius\": 0.16", "\"radius\": 0.22");
		const loser = await Promise.race([page, other].map((p) =>
			p.locator(".banner").waitFor().then(() => p)));
		if (choice === "Keep mine")
			await shot(loser, "conflict");
		const mine = loser === page ? "0.21" : "0.22";
		const theirs = loser === page ? "0.22" : "0.21";
		await loser.getByRole("button", { name: choice }).click();
		const end = choice === "Take theirs" ? theirs : mine;
		for (const p of [page, other]) {
			await p.waitForFunction((end) => window.__blobfield.editor.text
				.includes(`"radius": ${end}`), end);
			await settled(p);
			assert.equal(await p.locator(".banner").isVisible(), false);
		}
		await edit(page, `"radius": ${end}`, "\"radius\": 0.16");
		await settled(page);
		await other.waitForFunction(() =>
			window.__blobfield.editor.text.includes("\"radius\": 0.16"));
		await settled(other);
	}
	await other.context().close();
};

cases.test_others_edits_come_as_events = async () => {
	const other = await open(`#scene=${(await state(page)).id}`);
	await other.waitForFunction(() => window.__blobfield.session.hears);
	await other.evaluate(() => { window.__blobfield.session.poll = 1e6; });
	await other.waitForTimeout(600); // the last look that was under way
	await edit(page, "\"radius\": 0.16", "\"radius\": 0.17");
	await other.waitForFunction(() =>
		window.__blobfield.editor.text.includes("\"radius\": 0.17"));
	await other.context().close();
	await edit(page, "\"radius\": 0.17", "\"radius\": 0.16");
	await settled(page);
};

cases.test_a_token_is_asked_for_where_the_daemon_wants_one = async () => {
	const secret = "bf_test";
	const file = join(temporary, "tokens.json");
	writeFileSync(file, JSON.stringify({ tokens: [{ name: "me", role: "write",
		sha256: createHash("sha256").update(secret).digest("hex") }] }),
	{ mode: 0o600 });
	const closed = new Daemon();
	await closed.start("--tokens", file);
	expected = [/401 \(/];
	const context = await browser.newContext();
	try {
		const other = await context.newPage();
		other.setDefaultTimeout(12000);
		watch(other);
		await other.goto(`${closed.url}/`);
		const dialog = other.locator("dialog.ask");
		await dialog.waitFor();
		await other.getByLabel("Token", { exact: true }).last().fill("wrong");
		await dialog.getByText("Go on").click();
		await dialog.getByText("does not count").waitFor();
		if (shots)
			await other.screenshot({ path: join(shots, "token.png") });
		await other.getByLabel("Token", { exact: true }).last().fill(secret);
		await dialog.getByText("Go on").click();
		await settled(other);
		await other.waitForFunction(() => window.__blobfield.session.hears);
	} finally {
		await context.close();
		await closed.stop();
	}
};

cases.test_what_cannot_be_shown_is_explained = async () => {
	expected = [/422 \(/];
	const before = await state(page);
	// So far away float32 has no places for it.
	await paste(page, scene({ type: "point", center: [1e7, 0, 0], radius: 0.5 }));
	await page.locator(".problems li").first().waitFor();
	assert.equal(await page.locator(".cm-lintRange-error").count(), 0);
	assert.equal((await state(page)).count, before.count);
	await page.evaluate((text) => window.__blobfield.editor.setText(text),
		before.text);
	await settled(page);
	// Nothing at all is no error.
	await edit(page, "\"root\": {", "\"root\": {\"translation\": [0, 0, 1], ");
	await page.getByLabel("iso, number").fill("900");
	await page.getByLabel("iso, number").press("Enter");
	await page.locator(".facts", { hasText: "No surface" }).waitFor();
	await page.getByLabel("iso, number").fill("0.5");
	await page.getByLabel("iso, number").press("Enter");
	await page.evaluate((text) => window.__blobfield.editor.setText(text),
		before.text);
	await page.waitForFunction((text) =>
		window.__blobfield.session.saved === text, before.text);
	await page.waitForTimeout(300);
	await settled(page);
	assert((await pixels(page)).model > 0.02);
};

cases.test_daemon_may_be_restarted = async () => {
	expected = [/ERR_CONNECTION|ERR_EMPTY_RESPONSE|ERR_SOCKET/,
		/404 \(/, /412 \(/];
	const before = await state(page);
	await daemon.stop();
	await page.waitForFunction(() => document.body.dataset.online === "false");
	assert.equal(await page.locator(".status").textContent(), "Reconnecting…");
	await edit(page, "\"radius\": 0.16", "\"radius\": 0.18");
	assert((await pixels(page)).model > 0.02, "the picture stays");
	await daemon.start();
	await page.waitForFunction(() => document.body.dataset.online === "true");
	await settled(page);
	const after = await state(page);
	assert.equal(after.id, before.id);
	const kept = await fetch(`${daemon.url}/v1/scenes/${after.id}`);
	assert.equal(await kept.text(), after.text);
	assert.match(after.text, /0\.18/);
};

cases.test_dark_scheme = async () => {
	const ground = () => page.evaluate(() =>
		getComputedStyle(document.body).backgroundColor);
	const light = await ground();
	await page.emulateMedia({ colorScheme: "dark" });
	assert.notEqual(await ground(), light);
	await page.waitForFunction(() => window.__blobfield.viewport.dark);
	await shot(page, "dark");
};

cases.test_unknown_scene_says_so = async () => {
	expected = [/404 \(/];
	const other = await open("#scene=never-was");
	assert.match(await other.locator(".toast").textContent(), /never-was/);
	assert.notEqual((await state(other)).id, "never-was");
	await other.context().close();
};

/* ---- all of them ---- */

// A request for progress may come just after the end of what it asks about.
const usual = [/\/v1\/progress\//];

async function main() {
	const wanted = process.argv.slice(2);
	const begin = Date.now();
	await daemon.start();
	browser = await chromium.launch({
		executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
		args: ["--no-sandbox", "--disable-quic", "--no-first-run",
			"--disable-background-networking", "--disable-component-update",
			"--disable-sync", "--use-gl=angle", "--use-angle=swiftshader",
			"--enable-unsafe-swiftshader"] });
	let failed = 0;
	for (const [name, run] of Object.entries(cases)) {
		if (wanted.length && !wanted.includes(name) && page)
			continue;
		console.log(`[ RUN      ] ${name}`);
		faults = [];
		expected = [];
		const started = Date.now();
		try {
			await run();
			const bad = faults.filter((f) =>
				![...usual, ...expected].some((pattern) => pattern.test(f)));
			assert.deepEqual(bad, []);
			console.log(`[       OK ] ${name}`);
			if (process.env.V)
				console.log(`${Date.now() - started} ms`);
		} catch (error) {
			failed++;
			console.log(String(error.stack ?? error));
			if (faults.length)
				console.log("console:", faults);
			console.log(`[  FAILED  ] ${name}`);
			if (!page)
				return 1;
			if (page && shots)
				await shot(page, `failed-${name}`).catch(() => {});
		}
	}
	console.log(`measured: previewer in Chromium, ${
		((Date.now() - begin) / 1000).toFixed(0)} s`);
	return failed === 0 ? 0 : 1;
}

let status = 1;
try {
	status = await main();
} catch (error) {
	console.log(error.stack);
} finally {
	await browser?.close().catch(() => {});
	if (daemon.process?.exitCode === null)
		await daemon.stop();
	rmSync(temporary, { recursive: true, force: true });
}
process.exit(status);
