// The wire: one function for each endpoint that the page uses.

/* An answer that is a problem (RFC 9457). */
export class Problem extends Error {
	constructor(status, body) {
		super(body.detail ?? body.title ?? `HTTP ${status}`);
		this.status = status;
		this.slug = (body.type ?? "").split("/").pop();
		this.errors = body.errors ?? [];
		this.count = body.error_count ?? this.errors.length;
	}
}

/* The daemon cannot be reached. */
export class Offline extends Error {}

/* Where the daemon asks for a token: the one this tab has, and who gets one from
 * the user ({ask(wrong): a promise of a token, or null}). */
const TOKEN = "blobfield.token";
let user = null;
export const asker = (ask) => { user = { ask, asked: null }; };

function token() {
	try {
		return sessionStorage.getItem(TOKEN);
	} catch {
		return null;
	}
}

/* True: there is another token now. All requests refused meanwhile wait for the
 * same answer. */
async function askToken(refused) {
	if (!user || token() !== refused)
		return token() !== refused;
	user.asked ??= user.ask(refused !== null).finally(() => {
		user.asked = null;
	});
	const given = await user.asked;
	if (given)
		sessionStorage.setItem(TOKEN, given);
	return Boolean(given);
}

async function fetchAs(secret, path, options) {
	const headers = { ...options.headers,
		...secret && { Authorization: `Bearer ${secret}` } };
	return fetch(path, { cache: "no-store", ...options, headers });
}

async function ask(path, options = {}) {
	let answer;
	try {
		for (;;) {
			const secret = token();
			answer = await fetchAs(secret, path, options);
			if (answer.status !== 401 || !await askToken(secret))
				break;
		}
	} catch (error) {
		if (error.name === "AbortError")
			throw error;
		throw new Offline("The daemon does not answer.");
	}
	if (answer.ok || answer.status === 304)
		return answer;
	let body = {};
	try {
		body = await answer.json();
	} catch {
		// Not from the daemon: the status must do.
	}
	throw new Problem(answer.status, body);
}

/* What is read of an answer may be cut off as well. */
async function whole(promise) {
	try {
		return await promise;
	} catch (error) {
		if (error.name === "AbortError")
			throw error;
		throw new Offline("The answer was cut off.");
	}
}

const scene = (id) => `/v1/scenes/${encodeURIComponent(id)}`;
const json = { "Content-Type": "application/json" };
const octets = "application/octet-stream";

function conditions({ match, none }) {
	return { ...match && { "If-Match": match },
		...none && { "If-None-Match": none } };
}

export async function index() {
	const answer = await ask("/", { headers: { Accept: "application/json" } });
	return whole(answer.json());
}

export async function info() {
	return whole((await ask("/v1/info")).json());
}

/* Lines end in one way only: places in the text are those in the editor. */
export const plain = (text) => text.replaceAll(/\r\n?/g, "\n");

/* {text, etag}, or null where nothing has changed since that etag. */
export async function get(id, etag, signal) {
	const answer = await ask(scene(id),
		{ headers: conditions({ none: etag }), signal });
	if (answer.status === 304)
		return null;
	return { text: plain(await whole(answer.text())),
		etag: answer.headers.get("ETag") };
}

/* The etag. */
export async function put(id, text, when) {
	const answer = await ask(scene(id), { method: "PUT", body: text,
		headers: { ...json, ...conditions(when) } });
	await whole(answer.text());
	return answer.headers.get("ETag");
}

/* Server-Sent Events of a scene, as {type, id, data} to told, until the stream
 * ends; those after `last`, if that is not null. (EventSource cannot send a
 * token.) */
export async function events(id, last, signal, told) {
	const answer = await ask(`${scene(id)}/events`, { signal, headers: {
		Accept: "text/event-stream", ...last && { "Last-Event-ID": last } } });
	const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
	let left = "";
	for (;;) {
		const { done, value } = await whole(reader.read());
		if (done)
			return;
		const blocks = (left + value).split("\n\n");
		left = blocks.pop();
		for (const block of blocks)
			told(event(block));
	}
}

function event(block) {
	const fields = { type: "message", id: null, data: "" };
	for (const line of block.split("\n")) {
		const [, name, value] = /^([^:]*):? ?(.*)$/.exec(line);
		if (name === "event")
			fields.type = value;
		else if (name === "id" || name === "data")
			fields[name] = value;
	}
	return fields;
}

export async function remove(id, options) {
	await ask(scene(id), { method: "DELETE", ...options });
}

function post(id, what, body, { accept, etag, signal, query = "" } = {}) {
	return ask(`${scene(id)}/${what}${query}`, {
		method: "POST", signal,
		body: body instanceof Float32Array ? body : JSON.stringify(body),
		headers: { "Content-Type":
			body instanceof Float32Array ? octets : json["Content-Type"],
		...accept && { Accept: accept }, ...conditions({ match: etag }) },
	});
}

/* {data: ArrayBuffer, draft: whether made with drafts of tables} */
export async function mesh(id, body, { token, ...options }) {
	const answer = await post(id, "mesh", body, { ...options,
		accept: "model/gltf-binary",
		query: token ? `?progress=${token}` : "" });
	return { data: await whole(answer.arrayBuffer()),
		draft: answer.headers.get("Blobfield-Draft") === "true" };
}

export async function file(id, what, body, options) {
	return whole((await post(id, what, body, options)).blob());
}

/* {stage, done}, or null where that request is not under way. */
export async function progress(token, signal) {
	try {
		const answer = await ask(`/v1/progress/${token}`, { signal });
		return await whole(answer.json());
	} catch {
		return null;
	}
}

export async function raycast(id, body, options) {
	return whole((await post(id, "raycast", body, options)).json());
}

/* {theta, parameter, …}: how far a union must open to end at a point. */
export async function openingAngle(id, node, point) {
	return whole((await post(id, "opening-angle", { node, point })).json());
}

/* Rows of float32 for points, 3 floats each. */
export async function evaluate(id, points, outputs, options) {
	const answer = await post(id, "eval", points, { ...options, accept: octets,
		query: `?outputs=${outputs}` });
	return new Float32Array(await whole(answer.arrayBuffer()));
}

/* The field in a plane: {width, height, values}, first row at the top. */
export async function slice(id, body, options) {
	const answer = await post(id, "slice", body,
		{ ...options, accept: "application/x-npy" });
	return npy(await whole(answer.arrayBuffer()));
}

/* An npy file of little-endian float32 in C order, two axes. */
export function npy(buffer) {
	const view = new DataView(buffer);
	const version = view.getUint8(6);
	const length = version === 1 ? view.getUint16(8, true)
		: view.getUint32(8, true);
	const begin = version === 1 ? 10 : 12;
	const head = new TextDecoder("latin1")
		.decode(new Uint8Array(buffer, begin, length));
	const [height, width = 1] = /'shape': \(([^)]*)\)/.exec(head)[1]
		.split(",").filter((n) => n.trim() !== "").map(Number);
	if (!head.includes("<f4"))
		throw new Error("not float32");
	return { width, height,
		values: new Float32Array(buffer.slice(begin + length)) };
}
