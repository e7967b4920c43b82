#!/usr/bin/env node
// The previewer's parts that need no browser: where things are in a document's
// text, changes of it, and the curves that are plotted.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const root = fileURLToPath(new URL("../../", import.meta.url));
const from = (name) => import(pathToFileURL(join(root, "clients/web/src", name)));
const source = await from("source.js");
const curves = await from("curves.js");
const nodes = await from("nodes.js");
const lava = await from("lava.js");
const crease = await from("crease.js");

const TEXT = `{
  "format": "blobfield/1", "a~/b": [1, {"x": null}],
  "root": {
    "type": "union",
    "children": [
      {"type": "point", "center": [0, 0.5, -1e-3], "radius": 1},
      {"type": "point"}
    ]
  }
}
`;
const cut = (text, { from, to }) => text.slice(from, to);

function golden(name) {
	const lines = readFileSync(join(root, "tests/golden", name), "utf8").trim()
		.split("\n").filter((line) => !line.startsWith("#"));
	const columns = lines.shift().split(",");
	return lines.map((line) => Object.fromEntries(line.split(",").map((v, i) =>
		[columns[i], v.trim() === "" || Number.isNaN(Number(v)) ? v : Number(v)])));
}

const cases = {
	test_places_are_those_of_pointers() {
		const { places, value, fault } = source.read(TEXT);
		assert.equal(fault, null);
		let count = 0;
		for (const [pointer, place] of places) {
			assert.deepEqual(JSON.parse(cut(TEXT, place)), source.at(value, pointer));
			count++;
		}
		assert.equal(count, 18);
		assert.equal(cut(TEXT, places.get("/a~0~1b/1/x")), "null");
		assert.equal(source.pointerAt(places, TEXT.indexOf("0.5") + 1),
			"/root/children/0/center/1");
	},
	test_places_heed_escapes_and_braces_in_strings() {
		const text = `[{"a\\"b\\\\": "}\\\\\\"]", "c/d":{} , "e" : -1e3},[ ], [null]]`;
		const { places, value } = source.read(text);
		for (const [pointer, place] of places)
			assert.deepEqual(JSON.parse(cut(text, place)), source.at(value, pointer));
		assert.deepEqual([...places.keys()], ["", "/0", "/0/a\"b\\", "/0/c~1d",
			"/0/e", "/1", "/2", "/2/0"]);
		assert.equal(text.slice(places.get("/0/e").keyFrom, places.get("/0/e").to),
			"\"e\" : -1e3");
	},
	test_faults_are_marked_where_they_are() {
		const { places } = source.read(TEXT);
		const marked = (pointer) => cut(TEXT, source.mark(places, pointer));
		assert.equal(marked("/root/children/0/radius"), "\"radius\": 1");
		assert.equal(marked("/root"), "\"type\": \"union\"");
		assert.equal(marked("/root/children/1/radius"), "\"type\": \"point\"");
		assert.equal(marked("/root/children/0/center/7"),
			"\"center\": [0, 0.5, -1e-3]");
		assert.equal(marked("/root/children/0/cen..."), "\"type\": \"point\"");
	},
	test_broken_text_has_a_fault_and_places() {
		const broken = TEXT.replace("\"radius\": 1", "\"radius\" 1");
		const { value, places, fault } = source.read(broken);
		assert.equal(value, undefined);
		assert.match(fault.message, /^Not JSON: /);
		assert(Math.abs(fault.from - broken.indexOf("\"radius\" 1") - 9) <= 1);
		assert(places.has("/root/children/0/center/2"));
		assert.match(source.read("").fault.message, /^Not JSON/);
		assert(source.read("[1, 2").fault);
	},
	test_changes_leave_the_rest_as_it_is() {
		const to = source.applyAll(TEXT, [
			{ pointer: "/root/children/0/center/1", value: 0.25 },
			{ pointer: "/root/children/0/radius", value: 2 }]);
		assert.equal(to, TEXT.replace("0.5", "0.25").replace("\"radius\": 1",
			"\"radius\": 2"));
		assert.equal(source.applyAll(TEXT, [{ pointer: "/root/children/1/radius",
			value: 3 }]), TEXT.replace("{\"type\": \"point\"}",
			"{\"type\": \"point\", \"radius\": 3}"));
		assert.equal(source.applyAll(TEXT, [{ pointer: "/root/operator",
			value: { a: [1, "b"] } }]), TEXT.replace("    ]\n  }",
			"    ],\n    \"operator\": {\"a\": [1, \"b\"]}\n  }"));
		const without = source.applyAll(TEXT, [{ pointer: "/root/type" }]);
		assert.deepEqual(Object.keys(JSON.parse(without).root), ["children"]);
		assert.equal(source.applyAll("{}", [{ pointer: "/x~1y", value: 1 }]),
			"{\"x/y\": 1}");
	},
	test_half_written_operators_have_curves() {
		for (const opening of [{ alpha: 1.5 }, { alpha: ["a", 1, 2] }, { theta: "x" },
			{ theta: [0.1] }, { w: [1, null] }, null, 7, "what"])
			for (const profile of [{ type: "samples", points: 5 }, null, 7]) {
				const node = { operator: { opening, profile } };
				const now = curves.operatorOf({}, node, "/root");
				for (const a of [0, 1, 2, Math.PI])
					assert(Number.isFinite(curves.opening(now.opening, a)));
				curves.silhouette(now.profile);
			}
	},
	test_creases_have_a_normal_for_each_side() {
		// A cube: at each corner three faces, where it has one normal.
		const positions = [0, 1, 2, 3, 4, 5, 6, 7].flatMap((i) =>
			[i & 1, i >> 1 & 1, i >> 2].map((x) => 2 * x - 1));
		const faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3],
			[0, 4, 6, 2], [1, 3, 7, 5]];
		const index = faces.flatMap(([a, b, c, d]) => [a, b, c, a, c, d]);
		const made = crease.creases(index, positions,
			positions.map((x) => x / Math.sqrt(3)));
		assert.equal(made.from.length, 24);
		made.index.forEach((v, c) => {
			assert.equal(made.from[v - 8], index[c]);
			const n = made.normals.slice(3 * (v - 8), 3 * (v - 8) + 3);
			const [a] = faces[Math.floor(c / 6)];
			// Along one axis, towards the face, as measured exactly.
			const axis = n.findIndex((x) => Math.abs(x) === 1);
			assert.equal(n[axis], positions[3 * a + axis]);
		});
		// A flat one stays as it is.
		assert.equal(crease.creases([0, 1, 2], [0, 0, 0, 1, 0, 0, 0, 1, 0],
			[0, 0, 1, 0, 0, 1, 0, 0, 1]).from.length, 0);
	},
	test_openings_are_the_reference_values() {
		let worst = 0;
		let count = 0;
		for (const [name, opening] of Object.entries(curves.OPENINGS)) {
			for (const { alpha, theta } of golden(`opening_${name}.csv`)) {
				worst = Math.max(worst,
					Math.abs(curves.opening(opening, alpha) - theta));
				count++;
			}
		}
		console.log(`measured: opening against the reference: ${worst}, ${count} values`);
		assert(count > 100);
		// The references have 12 digits; measured 5.7e-12.
		assert(worst < 1e-11);
	},
	test_silhouettes_end_where_they_should() {
		for (const profile of [{ type: "smooth" }, { type: "bulge", k: 0.8 },
			{ type: "circle" }, { type: "samples", points: [[0, 1], [0.4, 0.98],
				[0.8, 0.8]] }]) {
			const points = curves.silhouette(profile);
			// ν(0) is finite: 1 − η(0) is 1 − 2.6e-7.
			const near = (p, q) => Math.hypot(p[0] - q[0], p[1] - q[1]) < 1e-6;
			assert(near(points[0], [0, 1]) && near(points.at(-1), [1, 0]),
				profile.type);
			const mirrored = points.map(([x, y]) => [y, x]).reverse();
			points.forEach((p, i) => assert(near(p, mirrored[i]), profile.type));
		}
		// SPEC, section 1: s(pi/4) of the smooth profile.
		const smooth = curves.silhouette({ type: "smooth" });
		const middle = smooth[(smooth.length - 1) / 2];
		assert(Math.abs(Math.hypot(...middle) - 1.140250301) < 1e-8);
	},
	test_nodes_are_those_of_the_schema() {
		const { $defs } = JSON.parse(readFileSync(join(root,
			"proto/document.schema.json"), "utf8"));
		const types = new Map();
		const visit = (s) => {
			if (s && typeof s === "object") {
				const type = s.properties?.type?.const;
				if (typeof type === "string" && s.properties.translation)
					types.set(type, s);
				Object.values(s).forEach(visit);
			}
		};
		visit($defs);
		for (const [type, { members }] of Object.entries(nodes.TYPES)) {
			assert(types.has(type), type);
			for (const member of Object.keys(members))
				assert(member in types.get(type).properties, `${type} ${member}`);
		}
	},
	test_lava_lamp_begins_as_it_is() {
		const doc = JSON.parse(readFileSync(join(root,
			"clients/models/lava-lamp.json"), "utf8"));
		assert(lava.lamp(doc));
		for (const { pointer, value } of lava.at(doc, 0))
			if (/center|radius/.test(pointer))
				[value].flat().forEach((v, i) => assert(Math.abs(v -
					[source.at(doc, pointer)].flat()[i]) < 1e-4, pointer));
		const later = source.applyAll(JSON.stringify(doc), lava.at(doc, 5));
		assert.notEqual(later, JSON.stringify(doc));
		assert(JSON.parse(later).root);
	},
};

let failed = 0;
for (const [name, run] of Object.entries(cases)) {
	console.log(`[ RUN      ] ${name}`);
	try {
		run();
		console.log(`[       OK ] ${name}`);
	} catch (error) {
		failed++;
		console.log(error.stack);
		console.log(`[  FAILED  ] ${name}`);
	}
}
process.exit(failed === 0 ? 0 : 1);
