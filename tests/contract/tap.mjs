/*
 * A tap on the daemon's wire: passes every byte on, both ways, as it comes,
 * and reads along: each request that succeeds and each answer must be as
 * proto/openapi.json says.
 *
 *	node tests/contract/tap.mjs http://127.0.0.1:PORT
 *
 * The first line on stdout has its own address. Ends on SIGTERM: with status
 * 65 if anything was not as it should be, which stderr tells, once for each
 * operation and sentence. With CONTRACT_LOG, a file, a line of JSON is added to
 * it: {"exchanges", "violations", "operations": {…: {status: count}}, …}.
 *
 * It changes nothing, so that raw sockets, broken framing, slow readers and
 * those who hang up are as they are without; what is no HTTP is not judged.
 * Bodies above 4 MiB are not looked into.
 */
import fs from 'node:fs';
import net from 'node:net';

import {Contract, mediaOf} from './contract.mjs';
import {readContract} from './embed.mjs';
import {Messages} from './messages.mjs';

const upstream = new URL(process.argv[2]);
const contract = new Contract(readContract());
const seen = new Map();
const totals = {exchanges: 0, violations: 0, garbled: 0, cut: 0, large: 0,
	operations: {}};

function complain(what, sentence) {
	const line = `${what}: ${sentence}`;

	totals.violations++;
	if (!seen.has(line))
		console.error(`contract: ${line.slice(0, 500)}`);
	seen.set(line, (seen.get(line) ?? 0) + 1);
}

/* Escapes of what needs none (RFC 3986, 2.3), or of a slash: paths of nothing. */
const ODD = /%(2[def]|3\d|4[1-9a-f]|5[0-9af]|6[1-9a-f]|7[0-9ae])/i;

/* The path, its escapes undone, and the query of a request's target. */
function readTarget(target) {
	const relative = target.replace(/^https?:\/\/[^/?]*/i, '') || '/';
	const at = relative.indexOf('?');
	const path = at < 0 ? relative : relative.slice(0, at);
	let decoded = path;

	try {
		decoded = decodeURIComponent(path);
	} catch {
		/* As it is. */
	}
	return {path: ODD.test(path) ? '\0' : decoded,
		query: new URLSearchParams(at < 0 ? '' : relative.slice(at + 1))};
}

function judge(request, answer) {
	/* A NUL is in no path. */
	const found = request.path.includes('\0') ? null :
		contract.find(request.method, request.path);
	const name = found ? `${request.method} ${found.path}` : 'elsewhere';
	const what = `${request.method} ${request.target.slice(0, 100)} ` +
		answer.status;
	const counts = totals.operations[name] ??= {};
	const wrong = [];

	totals.exchanges++;
	counts[answer.status] = (counts[answer.status] ?? 0) + 1;
	if (request.path === '*')
		return;
	wrong.push(...contract.checkAnswer(request, answer, found));
	if (found?.operation && answer.status < 300 && request.isWhole &&
		request.method !== 'OPTIONS')
		wrong.push(...contract.checkRequest(request, found));
	for (const sentence of wrong)
		complain(what, sentence);
}

/* Reads both directions of one connection. */
class Exchange {
	constructor() {
		this.waiting = []; /* requests without an answer yet */
		this.isGarbled = false;
		this.requests = new Messages({
			onHead: (head) => this.onRequestHead(head),
			onMessage: (head, body, isWhole) =>
				this.onRequest(head, body, isWhole),
			onGarbled: () => this.onGarbled(),
		});
		this.answers = new Messages({
			onHead: (head) => this.onAnswerHead(head),
			onMessage: (head, body, isWhole) =>
				this.onAnswer(head, body, isWhole),
			onGarbled: () => this.onGarbled(),
		});
	}

	onGarbled() {
		if (!this.isGarbled)
			totals.garbled++;
		this.isGarbled = true;
	}

	onRequestHead(head) {
		const match = /^(\S+) (\S+) HTTP\/1\.[01]$/.exec(head.line);
		const request = {isWhole: false, body: null,
			headers: head.headers};

		if (match)
			Object.assign(request, {method: match[1],
				target: match[2]}, readTarget(match[2]));
		else
			this.onGarbled();
		head.request = request;
		this.waiting.push(request);
	}

	onRequest(head, body, isWhole) {
		head.request.body = body;
		head.request.isWhole = isWhole;
		if (body === null)
			totals.large++;
	}

	onAnswerHead(head) {
		const status = Number(/^HTTP\/1\.1 (\d{3})/.exec(head.line)?.[1]);

		head.status = status;
		if (status < 200)
			return {skip: true};
		head.request = this.waiting.shift();
		return {
			hasBody: head.request?.method !== 'HEAD' && status !== 204 &&
				status !== 304,
			untilClose: true,
		};
	}

	onAnswer(head, body, isWhole) {
		const {request, status, headers} = head;
		/* Clients end these wherever they like. */
		const isStream = mediaOf(headers['content-type']) ===
			'text/event-stream';

		if (!isWhole && !isStream)
			totals.cut++;
		else if (request?.method && !this.isGarbled)
			judge(request, {status, headers, body});
		if (body === null)
			totals.large++;
	}
}

function serve(client) {
	const server = net.connect({port: Number(upstream.port),
		host: upstream.hostname, allowHalfOpen: true, noDelay: true});
	const exchange = new Exchange();
	const link = (from, to, messages) => {
		from.on('data', (data) => {
			try {
				messages.feed(data);
			} catch (error) {
				complain('the tap', error.stack);
			}
			if (!to.write(data))
				from.pause();
		});
		to.on('drain', () => from.resume());
		from.on('end', () => {
			messages.end();
			to.end();
		});
		from.on('error', () => to.resetAndDestroy());
		from.on('close', (hadError) => {
			messages.end();
			if (hadError || !from.readableEnded)
				to.destroy();
		});
	};

	client.setNoDelay(true);
	link(client, server, exchange.requests);
	link(server, client, exchange.answers);
}

function finish() {
	const log = process.env.CONTRACT_LOG;

	if (log)
		fs.appendFileSync(log, JSON.stringify(totals) + '\n');
	process.exit(totals.violations > 0 ? 65 : 0);
}

const tap = net.createServer({allowHalfOpen: true}, serve);

tap.listen(0, '127.0.0.1', () => console.log('tap listening on ' +
	`http://127.0.0.1:${tap.address().port}`));
process.on('SIGTERM', finish);
process.on('SIGINT', finish);
