#!/usr/bin/env node
// The committed bundle, clients/web/dist, is what its sources and the lockfile
// give: installed afresh, built into a folder of its own, compared byte for byte.
// BUNDLE_KEEP=1 builds with what is installed already.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { cpSync, mkdtempSync, readdirSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const clients = fileURLToPath(new URL("../../clients/", import.meta.url));
const web = join(clients, "web");
const temporary = mkdtempSync(join(tmpdir(), "blobfield-bundle-"));
const copy = join(temporary, "clients", "web");
const files = ["app.css", "app.js", "index.html"];

const cases = {
	test_lockfile_names_no_registry() {
		const lock = JSON.parse(readFileSync(join(web, "package-lock.json")));
		for (const [name, p] of Object.entries(lock.packages)) {
			assert.equal(p.resolved, undefined, name);
			assert(name === "" || p.integrity, name);
		}
	},
	test_dist_is_three_files() {
		assert.deepEqual(readdirSync(join(web, "dist")).sort(), files);
	},
	test_bundle_rebuilds_byte_for_byte() {
		const left = [join(web, "dist"),
			...process.env.BUNDLE_KEEP ? [] : [join(web, "node_modules")]];
		cpSync(web, copy, { recursive: true,
			filter: (path) => !left.includes(path) });
		cpSync(join(clients, "models"), join(temporary, "clients", "models"),
			{ recursive: true });
		if (!process.env.BUNDLE_KEEP)
			execFileSync("npm", ["ci", "--ignore-scripts", "--no-audit",
				"--no-fund"], { cwd: copy, stdio: ["ignore", "pipe", "pipe"] });
		execFileSync(process.execPath, ["build.mjs", join(temporary, "dist")],
			{ cwd: copy, stdio: ["ignore", "pipe", "pipe"] });
		for (const file of files)
			assert(readFileSync(join(temporary, "dist", file))
				.equals(readFileSync(join(web, "dist", file))),
			`${file} is not what its sources give: npm run build in clients/web`);
	},
	test_bundle_names_no_paths_and_runs_no_text() {
		const app = readFileSync(join(web, "dist", "app.js"), "utf8");
		assert(!app.includes(clients) && !app.includes("node_modules/"));
		assert.doesNotMatch(app, /\beval\(|new Function\(|sourceMappingURL/);
		const html = readFileSync(join(web, "dist", "index.html"), "utf8");
		assert.doesNotMatch(html, /<style|style=|\son\w+=|<script(?![^>]*src=)/);
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
		console.log(String(error.stderr ?? error.stack));
		console.log(`[  FAILED  ] ${name}`);
	}
}
rmSync(temporary, { recursive: true, force: true });
process.exit(failed === 0 ? 0 : 1);
