/*
 * HTTP/1 messages out of a stream of bytes, as they pass: heads, and bodies as
 * far as they are small enough to be looked at.
 */

/* Larger bodies pass unseen. */
const BODY_MAX = 4 << 20;
const HEAD_MAX = 64 << 10;

function parseHead(text) {
	const lines = text.split('\r\n');
	const headers = Object.create(null);

	for (const line of lines.slice(1)) {
		const match = /^([!#$%&'*+.^_`|~0-9A-Za-z-]+):[ \t]*(.*?)[ \t]*$/s
			.exec(line);

		if (!match)
			return null;
		const name = match[1].toLowerCase();

		headers[name] = name in headers ? `${headers[name]}, ${match[2]}` :
			match[2];
	}
	return {line: lines[0], headers};
}

/*
 * Feeds on buffers. onHead(head) is called behind a head, and may say
 * {hasBody: false}, {untilClose: true} or {skip: true}: no message of its own;
 * onMessage(head, body, isWhole) behind its body, which is null if it was too
 * large; onGarbled() where something is not HTTP, after which nothing is read.
 */
export class Messages {
	constructor({onHead, onMessage, onGarbled}) {
		Object.assign(this, {onHead, onMessage, onGarbled});
		this.rest = Buffer.alloc(0);
		this.begin();
	}

	begin() {
		this.read = this.readHead;
		this.head = null;
		this.parts = [];
		this.size = 0;
		this.left = 0;
	}

	feed(data) {
		if (!this.read)
			return;
		this.rest = this.rest.length ? Buffer.concat([this.rest, data]) :
			data;
		while (this.read && this.rest.length && this.read())
			;
	}

	/* The stream has ended. */
	end() {
		if (this.head)
			this.finish(this.read === this.readUntilClose);
		this.read = null;
	}

	garble() {
		this.read = null;
		this.onGarbled();
		return false;
	}

	take(size) {
		const data = this.rest.subarray(0, size);

		this.rest = this.rest.subarray(data.length);
		return data;
	}

	/* A line without its end; null: not there yet. */
	takeLine() {
		const at = this.rest.indexOf('\r\n');

		if (at >= 0)
			return this.take(at + 2).toString('latin1', 0, at);
		if (this.rest.length > HEAD_MAX)
			this.garble();
		return null;
	}

	keep(data) {
		this.size += data.length;
		this.left -= data.length;
		if (this.size > BODY_MAX)
			this.parts = null;
		this.parts?.push(Buffer.from(data));
	}

	finish(isWhole) {
		const {head, parts} = this;

		this.begin();
		this.onMessage(head, parts && Buffer.concat(parts), isWhole);
		return true;
	}

	/* ---- what is read next; true: go on ---- */

	readHead() {
		/* Empty lines may precede a request (RFC 9112 2.2). */
		while (this.rest[0] === 13 && this.rest[1] === 10)
			this.take(2);
		const at = this.rest.indexOf('\r\n\r\n');

		if (at < 0)
			return this.rest.length > HEAD_MAX ? this.garble() : false;
		const head = parseHead(this.take(at + 4).toString('latin1', 0, at));

		return head ? this.beginBody(head) : this.garble();
	}

	beginBody(head) {
		const {hasBody = true, untilClose = false, skip = false} =
			this.onHead(head) ?? {};
		const length = head.headers['content-length'];

		if (skip)
			return true;
		this.head = head;
		if (!hasBody)
			return this.finish(true);
		if ('transfer-encoding' in head.headers) {
			this.read = this.readChunk;
			return true;
		}
		if (length === undefined && untilClose) {
			this.read = this.readUntilClose;
			return true;
		}
		if (length !== undefined && !/^\d+$/.test(length))
			return this.garble();
		this.left = Number(length ?? 0);
		this.read = this.readLength;
		return this.left > 0 || this.finish(true);
	}

	readLength() {
		this.keep(this.take(this.left));
		return this.left > 0 || this.finish(true);
	}

	readUntilClose() {
		this.keep(this.take(this.rest.length));
		return true;
	}

	readChunk() {
		const line = this.takeLine();

		if (line === null)
			return false;
		if (!/^[0-9a-f]+[ \t]*(;.*)?$/i.test(line))
			return this.garble();
		this.left = parseInt(line, 16);
		this.read = this.left > 0 ? this.readChunkData : this.readTrailer;
		return true;
	}

	readChunkData() {
		if (this.left > 0)
			this.keep(this.take(this.left));
		if (this.left > 0 || this.rest.length < 2)
			return this.left > 0;
		if (this.takeLine() !== '')
			return this.garble();
		this.read = this.readChunk;
		return true;
	}

	readTrailer() {
		const line = this.takeLine();

		if (line === null)
			return false;
		return line === '' ? this.finish(true) : true;
	}
}
