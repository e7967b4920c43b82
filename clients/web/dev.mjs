// For work on the previewer: builds, serves the bundle as the daemon does, with
// the same Content-Security-Policy, and hands everything else on to a daemon.
//
//   node dev.mjs [DAEMON [PORT]]     (http://127.0.0.1:7878, 7879)
import { createServer, request } from "node:http";
import { readFileSync } from "node:fs";
import { spawnSync } from "node:child_process";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const daemon = new URL(process.argv[2] ?? "http://127.0.0.1:7878");
const port = Number(process.argv[3] ?? 7879);
const policy = "default-src 'none'; script-src 'self'; style-src 'self'; " +
	"connect-src 'self'; img-src 'self' data: blob:; base-uri 'none'; " +
	"form-action 'none'; frame-ancestors 'none'";
const types = { html: "text/html; charset=utf-8",
	js: "text/javascript; charset=utf-8", css: "text/css; charset=utf-8" };

function file(name, response) {
	const type = types[name.split(".").pop()];
	response.writeHead(200, { "Content-Type": type, "Cache-Control": "no-cache",
		"Content-Security-Policy": policy, "X-Content-Type-Options": "nosniff" });
	response.end(readFileSync(join(here, "dist", name)));
}

createServer((from, response) => {
	const path = new URL(from.url, daemon).pathname;
	const html = (from.headers.accept ?? "").includes("text/html");
	if (path === "/" && html) {
		spawnSync(process.execPath, [join(here, "build.mjs")],
			{ stdio: "inherit" });
		return file("index.html", response);
	}
	if (/^\/web\/app\.(js|css)$/.test(path))
		return file(path.slice(5), response);
	const to = request({ host: daemon.hostname, port: daemon.port,
		path: from.url, method: from.method, headers: from.headers },
	(answer) => {
		response.writeHead(answer.statusCode, answer.headers);
		answer.pipe(response);
	});
	to.on("error", () => response.destroy());
	response.on("close", () => to.destroy());
	from.pipe(to);
}).listen(port, "127.0.0.1", () =>
	console.log(`http://127.0.0.1:${port} -> ${daemon.href}`));
