// Bundles src/ into three files: index.html, app.js, app.css.
//
//   node build.mjs [FOLDER]      (default: dist)
//
// The output depends on src/, ../models/ and the lockfile alone: no times, no
// paths, the same bytes on every machine and with every version of Node.
import { build } from "esbuild";
import { readFileSync, readdirSync, mkdirSync, writeFileSync, existsSync }
	from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const models = join(here, "..", "models");
const out = resolve(process.argv[2] ?? join(here, "dist"));

// The gallery: ../models/index.json has the order, titles and notes; documents
// that it leaves out come after, by name.
function examples() {
	const index = join(models, "index.json");
	const listed = existsSync(index)
		? JSON.parse(readFileSync(index, "utf8")) : [];
	const names = existsSync(models)
		? readdirSync(models).filter((n) => n.endsWith(".json") &&
			n !== "index.json").sort() : [];
	const rest = names.filter((n) => !listed.some((e) => e.file === n));
	return [...listed.filter((e) => names.includes(e.file)),
		...rest.map((file) => ({ file }))].flatMap(({ file, title, note }) => {
		const text = readFileSync(join(models, file), "utf8");
		const { format, name } = JSON.parse(text);
		return format !== "blobfield/1" ? [] : [{ file, title: title ?? name ??
			file.replace(/\.json$/, ""), note: note ?? "", text }];
	});
}

const gallery = {
	name: "gallery",
	setup(b) {
		b.onResolve({ filter: /^gallery:/ }, (a) =>
			({ path: a.path, namespace: "gallery" }));
		b.onLoad({ filter: /.*/, namespace: "gallery" }, () =>
			({ contents: JSON.stringify(examples()), loader: "json" }));
	},
};

// The licences of what is bundled, once each, behind the code.
function licences(inputs) {
	const packages = new Set();
	for (const input of Object.keys(inputs)) {
		const m = /node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(input);
		if (m)
			packages.add(m[1]);
	}
	const texts = new Map();
	for (const name of [...packages].sort()) {
		const file = join(here, "node_modules", name, "LICENSE");
		const text = readFileSync(file, "utf8").replace(/\r/g, "").trim();
		texts.set(text, [...texts.get(text) ?? [], name]);
	}
	const parts = [...texts].map(([text, names]) =>
		`${names.join(", ")}:\n\n${text.replaceAll("*/", "* /")}`);
	return `/*!\nIn this file:\n\n${parts.join("\n\n----\n\n")}\n*/\n`;
}

const result = await build({
	absWorkingDir: here,
	entryPoints: { app: "src/main.js" },
	bundle: true,
	write: false,
	outdir: "out",
	format: "esm",
	target: "es2022",
	charset: "utf8",
	minify: true,
	legalComments: "none",
	metafile: true,
	plugins: [gallery],
	logLevel: "warning",
});
const styles = await build({
	absWorkingDir: here,
	entryPoints: { app: "src/app.css" },
	bundle: true,
	write: false,
	outdir: "out",
	target: ["chrome100", "firefox100", "safari15.4"],
	charset: "utf8",
	minify: true,
	logLevel: "warning",
});

mkdirSync(out, { recursive: true });
writeFileSync(join(out, "index.html"),
	readFileSync(join(here, "src", "index.html")));
writeFileSync(join(out, "app.js"),
	result.outputFiles[0].text + licences(result.metafile.inputs));
writeFileSync(join(out, "app.css"), styles.outputFiles[0].text);
