// A scene kept by the daemon, as this page sees it: edits go there, others'
// edits come from there, and surfaces of what is there are fetched.
//
// Order. PUTs go one after another, each on condition (If-Match) that the scene
// is as this page last knew it. Surfaces are fetched one at a time, coarse then
// fine: a newer one aborts the older, whose answer is dropped even if it is
// there. Whatever fails, the last surface stays.
import * as api from "./api.js";
import { read } from "./source.js";

export const COARSE = 24;
const REST = 250;          // ms without an edit before it is sent
const AGAIN = 2000;        // ms from the end of events until they are asked for
const KEPT = "blobfield.scene";

const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const random = () => Array.from(crypto.getRandomValues(new Uint8Array(6)),
	(b) => b.toString(36).padStart(2, "0")).join("").slice(0, 10);

/* Events: "text" {text, from}, "problems" {list}, "surface" {data, coarse, ms,
 * draft, bounds}, "phase", "progress" {stage, done}, "conflict", "gone",
 * "online", "opened". */
export class Session extends EventTarget {
	id = null;
	etag = null;
	text = "";             // as it is here
	saved = null;          // as the daemon has it
	iso = 0.5;
	resolution = 96;
	features = true;
	online = true;
	hears = false;         // of revisions, by events
	poll = 1000;           // ms between looks at the scene
	conflict = null;       // {text, etag}: theirs, while nobody has decided
	gone = false;          // deleted by somebody
	box = null;            // {min, max} of the latest surface that has an end
	phase = "idle";        // "waiting", "sending", "coarse", "fine", "error"
	shown = null;          // etag of the surface that is shown
	coarse = null;         // of what the latest coarse surface is
	sequence = 0;          // of surfaces asked for
	#queue = Promise.resolve();
	#abort = null;
	#timer = null;
	#live = null;
	#seen = 0;             // when the daemon last had the scene, ms
	#failures = 0;         // of the daemon's own, one after another
	#retry = Infinity;     // when to ask again after one, ms
	#endless = null;       // {key, bounds}: a surface that needs bounds

	emit(name, detail = {}) {
		this.dispatchEvent(new CustomEvent(name, { detail }));
	}

	#phase(phase) {
		this.phase = phase;
		this.emit("phase");
	}

	/* Begins to watch: where the daemon has events, by those, else by asking. */
	async start() {
		this.#watch();
		try {
			const { endpoints } = await api.index();
			this.events = endpoints.some((e) => /\/events$/.test(e.path));
		} catch {
			this.events = false;
		}
		this.#listen();
	}

	/* The scene of that id, which exists; or one of the text, which is new. */
	async open(id, text) {
		this.#stop();
		this.id = id ?? random();
		this.etag = this.shown = this.saved = null;
		this.conflict = this.box = null;
		this.#is(false);
		this.text = api.plain(text ?? "");
		this.emit("opened");
		this.#listen();
		if (id) {
			try {
				const found = await api.get(id);
				if (this.id !== id)
					return;
				this.#adopt(found, "open");
				return;
			} catch (error) {
				if (error instanceof api.Offline)
					return this.#offline();
				if (error.status !== 404)
					throw error;
			}
			const kept = remembered();
			if (text === undefined && kept?.id !== id)
				throw new api.Problem(404, { detail:
					`The daemon has no scene “${id}” (any more).` });
			this.text = api.plain(text ?? kept.text);
		}
		this.emit("text", { text: this.text, from: "open" });
		await this.submit();
	}

	/* An edit: sent when there has been none for a while. */
	edit(text) {
		this.text = text;
		clearTimeout(this.#timer);
		this.#phase("waiting");
		this.#timer = setTimeout(() => this.#rest(), REST);
	}

	/* An edit out of many, as a slider moves or time passes: coarse surfaces as
	 * fast as they come, a fine one when it rests. */
	async live(text, { rest = true } = {}) {
		this.text = text;
		clearTimeout(this.#timer);
		if (rest)
			this.#timer = setTimeout(() => this.#rest(), REST);
		if (this.#live) {
			this.#live.again = true;
			this.#live.fine = false;
			return this.#live.done;
		}
		const live = this.#live = { again: true, fine: false };
		live.done = this.#rounds(live);
		return live.done;
	}

	async #rounds(live) {
		try {
			while (live.again) {
				live.again = false;
				await this.submit({ fine: false });
			}
		} finally {
			if (this.#live === live)
				this.#live = null;
		}
		if (live.fine)
			await this.submit();
	}

	/* A fine surface, after the coarse one that is under way. */
	#rest() {
		if (this.#live)
			this.#live.fine = true;
		else
			this.submit();
	}

	/* Sends what is here, and fetches its surface. */
	async submit({ fine = true } = {}) {
		if (fine)
			clearTimeout(this.#timer);
		const { fault } = read(this.text);
		if (fault) {
			this.#stop();
			this.#phase("error");
			this.emit("problems", { list: [{ ...fault }] });
			return;
		}
		if (this.conflict)
			return;
		const id = this.id;
		const mine = ++this.sequence;
		this.#abort?.abort();
		const sent = await (this.#queue = this.#queue.catch(() => {})
			.then(() => this.#put(id)));
		if (mine !== this.sequence || id !== this.id || !sent)
			return;
		await this.picture({ fine });
	}

	/* Sends the text if the daemon has another; whether it has it now. */
	async #put(id) {
		if (id !== this.id)
			return false;
		const text = this.text;
		if (text === this.saved && this.etag)
			return this.#sent();
		if (this.phase === "idle" || this.phase === "waiting")
			this.#phase("sending");
		try {
			const etag = await api.put(id, text,
				this.etag ? { match: this.etag } : { none: "*" });
			if (id !== this.id)
				return false;
			this.etag = etag;
			this.saved = text;
			remember(id, text);
			return this.#sent();
		} catch (error) {
			if (error.status === 412)
				return this.#disputed(id, text);
			this.#failed(error);
			return false;
		}
	}

	#sent() {
		this.#seen = Date.now();
		this.#is(false);
		this.emit("problems", { list: [] });
		this.emit("saved");
		return true;
	}

	/* The scene is not as we knew it: gone with the daemon, ours after all, or
	 * somebody else's. */
	async #disputed(id, text) {
		try {
			const theirs = await api.get(id);
			if (theirs.text === text || theirs.text === this.saved) {
				this.etag = theirs.etag;
				this.saved = theirs.text;
				return this.#put(id);
			}
			this.conflict = theirs;
			this.#phase("waiting");
			this.emit("conflict");
			return false;
		} catch (error) {
			if (error.status !== 404) {
				this.#failed(error);
				return false;
			}
		}
		if (!await this.#anew())
			return this.#deleted();
		this.etag = this.saved = null;
		return this.#put(id);
	}

	/* Whether the daemon has been started since it last had the scene: it has
	 * forgotten it then, and nobody has deleted it. */
	async #anew() {
		const { uptime_s } = await api.info().catch(() => ({}));
		return !(1000 * uptime_s > Date.now() - this.#seen);
	}

	#is(gone) {
		const changed = gone !== this.gone;
		this.gone = gone;
		if (changed)
			this.emit("gone");
	}

	#deleted() {
		this.#stop();
		this.#phase("error");
		this.#is(true);
		return false;
	}

	/* The scene that was deleted, once more. */
	putBack() {
		this.#is(false);
		this.etag = this.saved = null;
		return this.submit();
	}

	/* theirs: or mine. */
	async settle(theirs) {
		const { text, etag } = this.conflict;
		this.conflict = null;
		this.emit("conflict");
		this.etag = etag;
		this.saved = text;
		if (!theirs)
			return this.submit();
		this.#adopt({ text, etag }, "remote");
	}

	/* The daemon's text is the one here from now on. */
	#adopt({ text, etag }, from) {
		clearTimeout(this.#timer);
		this.text = this.saved = text;
		this.etag = etag;
		this.#seen = Date.now();
		remember(this.id, text);
		this.emit("problems", { list: [] });
		this.emit("text", { text, from });
		this.picture();
	}

	/* The surface, coarse then fine. */
	async picture({ fine = true } = {}) {
		if (!this.etag || this.conflict)
			return;
		const mine = ++this.sequence;
		this.#abort?.abort();
		const abort = this.#abort = new AbortController();
		const current = () => mine === this.sequence;
		const steps = this.resolution <= COARSE ? [this.resolution]
			: !fine ? [COARSE]
				: this.coarse === this.#key() ? [this.resolution]
					: [COARSE, this.resolution];
		try {
			for (const resolution of steps)
				await this.#fetch(resolution, abort.signal, current,
					resolution !== this.resolution);
			if (current()) {
				this.#failures = 0;
				this.#phase("idle");
			}
		} catch (error) {
			if (!current() || error.name === "AbortError")
				return;
			if (error.status === 412 || error.status === 404)
				return this.look();
			this.#failed(error, false);
		} finally {
			if (current())
				this.emit("progress", { done: null });
		}
	}

	#key() {
		return `${this.id} ${this.etag} ${this.iso}`;
	}

	async #fetch(resolution, signal, current, coarse) {
		const token = random();
		const begin = performance.now();
		const etag = this.etag;
		this.#phase(coarse ? "coarse" : "fine");
		const ended = new AbortController();
		this.#follow(token, ended.signal, current);
		try {
			const { data, draft } = await this.#bounded(resolution,
				{ etag, signal, token });
			if (!current())
				return;
			this.shown = etag;
			if (coarse)
				this.coarse = this.#key();
			this.emit("surface", { data, coarse, etag, draft, bounds: this.bounds,
				resolution, ms: performance.now() - begin });
			if (draft && !coarse)
				this.#again(etag);
		} finally {
			ended.abort();
		}
	}

	/* Where the surface has no end: of what was last seen of the model, or of
	 * what is near the origin. */
	async #bounded(resolution, options) {
		const ask = () => this.#patiently(() => api.mesh(this.id,
			{ resolution, iso: this.iso, features: this.features,
				bounds: this.bounds ?? undefined }, options), options.signal);
		try {
			return await ask();
		} catch (error) {
			if (error.status !== 422 || this.bounds ||
			    error.errors[0]?.pointer !== "/bounds")
				throw error;
			this.#endless = { key: this.#key(), bounds: around(this.box) };
			return await ask();
		}
	}

	/* What requests for the surface must be given; null where it has an end. */
	get bounds() {
		return this.#endless?.key === this.#key() ? this.#endless.bounds : null;
	}

	/* Once more, when there may be tables in place of drafts. */
	#again(etag) {
		setTimeout(() => {
			if (this.phase === "idle" && this.etag === etag)
				this.picture();
		}, 1500);
	}

	/* Again, where the daemon has too much to do. */
	async #patiently(ask, signal) {
		for (let i = 0; ; i++) {
			try {
				return await ask();
			} catch (error) {
				if (error.status !== 503 || i >= 5 || signal.aborted)
					throw error;
				await pause(400 * (i + 1));
			}
		}
	}

	/* How far a long request is. */
	async #follow(token, signal, current) {
		await pause(180);
		while (!signal.aborted && current()) {
			const state = await api.progress(token, signal);
			if (state && !signal.aborted && current())
				this.emit("progress", state);
			await pause(120);
		}
	}

	/* Pointers of what is not the document's say nothing about it. */
	#failed(error, document = true) {
		if (error instanceof api.Offline)
			return this.#offline();
		if ([500, 502, 503].includes(error.status))
			this.#retry = Date.now() + 500 * 2 ** Math.min(7, this.#failures++);
		this.#phase("error");
		this.emit("problems", { list: document && error.errors?.length
			? error.errors.map((e) => ({ pointer: e.pointer, message: e.detail }))
			: [{ message: error.message }], count: error.count });
	}

	#offline() {
		this.#stop();
		this.#phase("error");
		if (this.online) {
			this.online = false;
			this.emit("online");
		}
	}

	#stop() {
		this.sequence++;
		this.#abort?.abort();
		this.#retry = Infinity;
		if (this.#live)
			this.#live.again = this.#live.fine = false;
		this.#live = null;
		clearTimeout(this.#timer);
	}

	/* Looks at the scene now and then, for ever. */
	async #watch() {
		for (;;) {
			await pause(this.hears && this.online ? 10 * this.poll : this.poll);
			if (this.id)
				await this.look().catch((error) => console.warn(error));
		}
	}

	/* Whether the scene has changed; what is to be done if so. */
	async look() {
		const id = this.id;
		const failed = this.phase === "error" && Date.now() > this.#retry;
		if (failed)
			this.#retry = Infinity;
		if (this.phase === "sending")
			return;
		if (!this.etag && this.online)
			return failed ? this.submit() : undefined;
		let found;
		try {
			found = await api.get(id, this.etag);
		} catch (error) {
			if (id !== this.id)
				return;
			if (error instanceof api.Offline)
				return this.#offline();
			if (error.status !== 404)
				return;
			this.#online();
			const anew = await this.#anew();
			if (this.text === "" || id !== this.id)
				return;
			if (!anew)
				return this.#deleted();
			this.etag = this.saved = null;
			return this.submit();
		}
		if (id !== this.id)
			return;
		this.#seen = Date.now();
		const put = this.gone;
		this.#is(false);
		const back = this.#online() || failed || put;
		if (!found || found.etag === this.etag) {
			if (back || (this.phase === "idle" && this.shown !== this.etag))
				await this.submit();
			return;
		}
		if (this.conflict) {
			this.conflict = found;
			return;
		}
		if (this.saved !== null && this.text !== this.saved) {
			// There are edits here that have not gone: their PUT will tell, unless
			// it has failed.
			if (this.phase !== "error")
				return;
			this.conflict = found;
			this.emit("conflict");
			return;
		}
		// Our own PUT may have come between.
		await this.#queue;
		if (id !== this.id || found.etag === this.etag)
			return;
		if (this.text === (this.saved ?? this.text))
			this.#adopt(found, "remote");
	}

	#online() {
		const back = !this.online;
		this.online = true;
		if (back)
			this.emit("online");
		return back;
	}

	/* Hears of the scene's revisions, once there is one: source says so. */
	#listen() {
		this.source?.abort();
		this.source = null;
		this.hears = false;
		if (this.events && this.id)
			this.#hear(this.id, new AbortController());
	}

	async #hear(id, abort) {
		let last = null;
		const current = () => id === this.id && !abort.signal.aborted;
		this.source = abort;
		while (current()) {
			if (!this.etag || this.gone) {
				await pause(REST);
				continue;
			}
			try {
				await api.events(id, last, abort.signal, (event) => {
					last = event.id ?? last;
					this.hears = current();
					if (current() && event.type !== "message")
						this.look().catch((error) => console.warn(error));
				});
			} catch {
				// Asking goes on: this.look() says what is wrong.
			}
			if (current())
				this.hears = false;
			await pause(AGAIN);
		}
	}
}

/* A box somewhat larger; of length 4 about the origin for none. */
function around(box) {
	const { min, max } = box ?? { min: [-2, -2, -2], max: [2, 2, 2] };
	const more = box ? 0.1 * Math.max(...max.map((x, i) => x - min[i])) : 0;
	return { min: min.map((x) => x - more), max: max.map((x) => x + more) };
}

/* The scene that this browser had last. */
export const remembered = () => recall(KEPT);

const remember = (id, text) => keep(KEPT, { id, text });

/* What this browser keeps from one time to the next. */
export function recall(key) {
	try {
		return JSON.parse(localStorage.getItem(key));
	} catch {
		return null;
	}
}

export function keep(key, value) {
	try {
		localStorage.setItem(key, JSON.stringify(value));
	} catch {
		// Private windows, full stores: then not.
	}
}
