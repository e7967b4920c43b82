#!/usr/bin/env node
/*
 * proto/openapi.json itself: it stands alone, is linted, has the document
 * schema in it, and the routes, methods and query parameters of the daemon; and
 * the judge of the wire finds what is wrong. Prints its cases as cmocka does.
 *
 * In the environment: BLOBFIELDD, the daemon.
 */
import assert from 'node:assert/strict';
import {spawn, spawnSync} from 'node:child_process';
import crypto from 'node:crypto';
import fs from 'node:fs';
import http from 'node:http';
import os from 'node:os';
import readline from 'node:readline';

import {Contract, VERBS} from './contract.mjs';
import {CONTRACT, documentComponents, format, readContract} from './embed.mjs';
import {Messages} from './messages.mjs';

const text = fs.readFileSync(CONTRACT, 'utf8');
const raw = readContract();
const contract = new Contract(raw);

/* Each operation: calls visit(path, verb, operation, place). */
function forOperations(visit) {
	for (const path of Object.keys(raw.paths))
		for (const verb of VERBS) {
			const found = contract.find(verb.toUpperCase(),
				path.replace('{id}', 'x'));

			if (found.operation)
				visit(path, verb, found.operation, found);
		}
}

/* Each object within value, with its place. */
function walk(value, visit, place = '') {
	if (value === null || typeof value !== 'object')
		return;
	visit(value, place);
	for (const [name, item] of Object.entries(value))
		walk(item, visit, `${place}/${name.replace(/~/g, '~0')
			.replace(/\//g, '~1')}`);
}

/* ---- the file ---- */

function test_document_components_are_the_document_schema() {
	const within = Object.fromEntries(Object.entries(
		raw.components.schemas).filter(([name]) =>
		/^Document($|\.)/.test(name)));

	assert.deepEqual(within, documentComponents(),
		'run node tests/contract/embed.mjs');
}

function test_layout_is_that_of_the_tool() {
	assert.ok(text === format(raw) + '\n',
		'run node tests/contract/embed.mjs');
}

function test_it_stands_alone() {
	walk(raw, (value, place) => {
		if (typeof value.$ref !== 'string')
			return;
		assert.match(value.$ref, /^#\/components\//, place);
		assert.ok(contract.resolve(value.$ref.slice(1)).value,
			`${place}: ${value.$ref}`);
	});
}

function test_schemas_compile() {
	for (const name of Object.keys(raw.components.schemas))
		contract.check(`/components/schemas/${name}`, null);
}

function test_examples_are_valid() {
	let count = 0;

	walk(raw.paths, (value, place) => {
		if (!('example' in value) || !value.schema)
			return;
		assert.equal(contract.check(`/paths${place}/schema`,
			value.example), null, place);
		count++;
	});
	assert.ok(count >= 10, `${count} examples`);
}

function test_every_error_is_problem_json() {
	forOperations((path, verb, operation, {place}) => {
		for (const status of Object.keys(operation.responses)) {
			const {value} = contract.resolve(
				`${place}/responses/${status}`);

			if (status >= 400)
				assert.deepEqual(Object.keys(value.content),
					['application/problem+json'], place);
		}
	});
}

function test_spectral_finds_nothing() {
	const done = spawnSync('tests/contract/node_modules/.bin/spectral',
		['lint', '--quiet', '-r', 'tests/contract/ruleset.yaml',
			'--fail-severity=warn', CONTRACT], {encoding: 'utf8'});

	assert.equal(done.status, 0, done.stdout + done.stderr);
}

/* ---- against the daemon ---- */

/* {child, url} of a daemon that has begun to listen. */
async function startDaemon(...options) {
	const child = spawn(process.env.BLOBFIELDD ?? 'build/blobfieldd',
		['--listen', '127.0.0.1:0', '--quiet', '--no-measure',
			'--no-cache', '--data', ':memory:', ...options],
		{stdio: ['ignore', 'pipe', 'inherit']});

	for await (const line of readline.createInterface(
		{input: child.stdout}))
		return {child, url: line.split(' ').pop()};
	throw new Error('the daemon has ended');
}

/* Its exit status. */
function stopDaemon({child}) {
	child.kill('SIGTERM');
	return new Promise((resolve) => child.on('exit', resolve));
}

let daemon;

/* The answer: {status, headers, body}. */
function ask(method, path, body, {url = daemon.url, headers = {}} = {}) {
	return new Promise((resolve, reject) => {
		const type = body ? {'Content-Type': 'application/json'} : {};
		const request = http.request(url + path, {method, agent: false,
			headers: {...type, ...headers}});

		request.on('error', reject);
		request.on('response', (answer) => {
			const parts = [];

			answer.on('data', (part) => parts.push(part));
			answer.on('end', () => resolve({status: answer.statusCode,
				headers: answer.headers,
				body: Buffer.concat(parts).toString()}));
		});
		request.end(body);
	});
}

async function test_routes_are_those_of_the_daemon() {
	const {endpoints} = JSON.parse((await ask('GET', '/')).body);
	const listed = [];

	forOperations((path, verb) => listed.push(
		`${verb.toUpperCase()} ${path}`));
	assert.deepEqual(listed.sort(), endpoints.map(({method, path}) =>
		`${method} ${path}`).sort());
}

async function test_query_parameters_are_those_of_the_daemon() {
	const asked = [];

	forOperations((path, verb, operation, found) => asked.push({path, verb,
		names: contract.parametersOf(found).map(({value}) => value)
			.filter((p) => p.in === 'query').map((p) => p.name)}));
	for (const {path, verb, names} of asked) {
		const {status, body} = await ask(verb.toUpperCase(),
			path.replace('{id}', 'x') + '?frobnicate=1');
		const known = /known here: (.*)\.$/.exec(JSON.parse(body).detail);

		assert.equal(status, 400);
		assert.deepEqual(names.sort(), known[1] === 'none' ? [] :
			known[1].split(' ').sort(), `${verb} ${path}`);
	}
}

async function test_methods_are_those_of_the_daemon() {
	for (const path of Object.keys(raw.paths)) {
		const target = path.replace('{id}', 'x');
		const answer = await ask('OPTIONS', target);

		assert.deepEqual(contract.checkAnswer({method: 'OPTIONS'}, answer,
			contract.find('OPTIONS', target)), [], path);
	}
}

const ROLES = ['read', 'evaluate', 'write', 'admin'];

/* A file of tokens, one for each role, whose secret is its name. */
function writeTokens(folder) {
	const file = `${folder}/tokens.json`;

	fs.writeFileSync(file, JSON.stringify({tokens: ROLES.map((role) =>
		({name: role, role, sha256: crypto.createHash('sha256')
			.update(role).digest('hex')}))}), {mode: 0o600});
	return file;
}

/* The role that the daemon asks for; null: none. */
async function roleAskedFor(verb, path, url) {
	const request = [verb.toUpperCase(), path.replace('{id}', 'x')];
	const {status, headers} = await ask(...request, '', {url});

	if (status !== 401)
		return null;
	assert.equal(headers['www-authenticate'], 'Bearer realm="blobfield"');
	const {headers: {'www-authenticate': challenge}} = await ask(...request,
		'', {url, headers: {Authorization: 'Bearer read'}});

	return challenge ? /scope="(.*)"/.exec(challenge)[1] : 'read';
}

async function test_roles_are_those_of_the_daemon() {
	const folder = fs.mkdtempSync(`${os.tmpdir()}/contract-`);
	const closed = await startDaemon('--tokens', writeTokens(folder));
	const wanted = [], found = [];

	forOperations((path, verb, operation) => wanted.push([verb, path,
		operation.security.length ? operation.security[0].bearer[0] :
			null]));
	for (const [verb, path] of wanted)
		found.push([verb, path, await roleAskedFor(verb, path,
			closed.url)]);
	const status = await stopDaemon(closed);

	fs.rmSync(folder, {recursive: true});
	assert.deepEqual(found, wanted);
	assert.equal(status, 0);
}

/* 401, 403 and 429 are where tokens are asked for, 403 where one may have too
 * small a role. */
function test_refusals_are_those_of_the_role() {
	forOperations((path, verb, {security, responses}) => {
		const role = security[0]?.bearer[0];

		assert.deepEqual([401, 403, 429].filter((s) => responses[s]),
			!role ? [] : role === 'read' ? [401, 429] : [401, 403, 429],
			`${verb} ${path}`);
	});
}

async function test_the_daemon_serves_it() {
	const answer = await ask('GET', '/openapi.json');

	assert.equal(answer.status, 200);
	assert.ok(answer.body === text, 'it serves another');
}

/* Values that a schema excludes, and some at its ends. */
function probe(place) {
	const {value, place: at} = contract.resolve(place);
	const wrong = [];
	const right = [];

	if (value.enum)
		wrong.push('frobnicate');
	if (value.type === 'boolean')
		wrong.push(1);
	if (value.type === 'array')
		wrong.push([...Array((value.minItems ?? 1) + 1).fill(0.5)], [], {});
	if ('minimum' in value) {
		wrong.push(value.minimum - Math.max(1e-3 *
			Math.abs(value.minimum), 1e-12), 'x');
		right.push(value.minimum);
	}
	if ('maximum' in value) {
		wrong.push(value.maximum * 1.001);
		right.push(value.maximum);
	}
	if (value.type === 'integer')
		wrong.push(value.minimum + 0.5);
	return {wrong: wrong.filter((x) => contract.check(at, x) !== null),
		right};
}

/* Bodies that are right and cheap, and the member that others go into. */
const bodies = {
	render: {width: 1, height: 1, samples: 1},
	slice: {width: 1, height: 1},
	mesh: {resolution: 4},
	raycast: {rays: [[0, 0, 5, 0, 0, -1]]},
	project: {points: [[0, 0, 2]]},
	grid: {min: [0, 0, 0], max: [1, 1, 1], counts: [2, 1, 2]},
	'opening-angle': {node: 'u', point: [1, 0, 0]},
};
const ball = (x) => ({type: 'point', center: [x, 0, 0], radius: 1});

function post(tail, body) {
	return ask('POST', `/v1/scenes/probe/${tail}`, JSON.stringify(body));
}

/* Calls visit(tail, name, body with member name = value, value) for values
 * of the kind ("wrong", "right") of each member. */
async function forProbes(kind, visit) {
	for (const [tail, base] of Object.entries(bodies)) {
		const found = contract.find('POST', `/v1/scenes/probe/${tail}`);
		const {place, value} = contract.resolve(`${found.place}` +
			'/requestBody/content/application~1json/schema');

		for (const name of Object.keys(value.properties))
			for (const item of probe(`${place}/properties/${name}`)[kind])
				await visit(tail, name, {...base, [name]: item});
	}
}

async function test_what_the_contract_excludes_is_refused() {
	let count = 0;

	await ask('PUT', '/v1/scenes/probe', JSON.stringify({
		format: 'blobfield/1', root: {type: 'union', id: 'u',
			operator: 'sharp', children: [ball(0), ball(1)]}}));
	await forProbes('wrong', async (tail, name, body) => {
		const {status, body: text} = await post(tail, body);
		const what = `${tail} ${JSON.stringify(body)}: ${text}`;

		assert.equal(status, 422, what);
		assert.ok(JSON.parse(text).errors.some(({pointer}) =>
			pointer.startsWith(`/${name}`)), what);
		count++;
	});
	for (const [tail, base] of Object.entries(bodies))
		assert.equal((await post(tail, {...base, frobnicate: 1})).status,
			422, tail);
	assert.ok(count > 40, `${count} bodies`);
}

/* But sizes, which would take long, or more than there may be. */
async function test_what_the_contract_allows_is_taken() {
	let count = 0;

	await forProbes('right', async (tail, name, body) => {
		if (['width', 'height', 'resolution', 'edge_length',
			'extent'].includes(name))
			return;
		const {status, body: text} = await post(tail, body);

		assert.equal(status, 200, `${tail} ${JSON.stringify(body)}: ${text}`);
		count++;
	});
	assert.ok(count > 10, `${count} bodies`);
}

/* ---- the judge ---- */

function judged(change, {method = 'GET', path = '/v1/scenes/x/bounds'} = {}) {
	const box = {min: [0, 0, 0], max: [1, 1, 1]};
	const answer = {status: 200, headers: {
		'content-type': 'application/json', 'date': 'today',
		'x-request-id': 'a1', 'etag': `"${'0'.repeat(32)}"`},
	json: {...box, bounded: true, empty: false, surface: box}};

	change(answer);
	answer.body = Buffer.from(answer.text ?? JSON.stringify(answer.json));
	return contract.checkAnswer({method}, answer,
		contract.find(method, path)).join('; ');
}

function test_judge_passes_what_is_right() {
	assert.equal(judged(() => {}), '');
	assert.equal(judged((a) => { a.json.surface = null; }), '');
}

function test_judge_finds_what_is_wrong() {
	const problem = (a, status, slug) => {
		a.status = status;
		a.headers = {'content-type': 'application/problem+json',
			'x-request-id': 'a1'};
		a.json = {type: `/problems/${slug}`, title: 't', status};
	};

	assert.match(judged((a) => { a.status = 202; }), /status 202/);
	assert.match(judged((a) => { delete a.headers.etag; }), /ETag is miss/);
	assert.match(judged((a) => { a.headers.etag = 'x'; }), /ETag: 'x'/);
	assert.match(judged((a) => { delete a.headers['x-request-id']; }),
		/X-Request-Id is missing/);
	assert.match(judged((a) => { a.headers['x-new'] = '1'; }), /x-new/);
	assert.match(judged((a) => { a.headers['content-type'] = 'text/plain'; }),
		/text\/plain is not listed/);
	assert.match(judged((a) => { a.json.min = [1, 2]; }), /\/min/);
	assert.match(judged((a) => { a.json.more = 1; }), /additional/);
	assert.match(judged((a) => { a.text = '{'; }), /not JSON/);
	assert.equal(judged((a) => problem(a, 404, 'not-found')), '');
	assert.match(judged((a) => problem(a, 404, 'gone')), /\/type/);
	assert.match(judged((a) => problem(a, 503, 'draining')), /Retry-After/);
	assert.match(judged(() => {}, {path: '/v1/nowhere'}), /404/);
	assert.match(judged(() => {}, {method: 'PATCH'}), /405/);
}

function streamed(text) {
	const path = '/v1/scenes/x/events';

	return contract.checkAnswer({method: 'GET'}, {status: 200,
		body: Buffer.from(text), headers: {'x-request-id': 'a1',
			'content-type': 'text/event-stream',
			'cache-control': 'no-store', 'x-accel-buffering': 'no'}},
	contract.find('GET', path)).join('; ');
}

function test_judge_reads_events() {
	const data = {id: 'x', sequence: '12', time: '2026-11-22T13:35:32.123Z'};
	const text = (kind, more = {}, id = 12) => `id: ${id}\nevent: ${kind}\n` +
		`data: ${JSON.stringify({...data, ...more})}\n\n`;
	const revision = {revision: '0'.repeat(32), nodes: 1, bytes: 9};
	const head = 'retry: 2000\n\n';

	assert.equal(streamed(head + text('revision', revision) +
		': alive\n\n' + text('deleted', {missed: true})), '');
	assert.equal(streamed(head + 'id: 13\nevent: dele'), '');
	assert.match(streamed(text('deleted')), /retry/);
	assert.match(streamed(head + text('revision')), /revision/);
	assert.match(streamed(head + text('deleted', {}, 13)), /id 13/);
	assert.match(streamed(head + text('moved')), /moved is not listed/);
	assert.match(streamed(head + 'event: deleted\ndata: {\n\n'), /JSON/);
}

function test_judge_knows_preflights() {
	const options = (allow, more) => contract.checkAnswer(
		{method: 'OPTIONS'}, {status: 204, headers: {allow,
			'x-request-id': 'a1', ...more}},
		contract.find('OPTIONS', '/v1/scenes/x')).join('; ');
	const methods = 'GET, HEAD, PUT, PATCH, DELETE, OPTIONS';
	const patch = {'accept-patch': 'application/json-patch+json, ' +
		'application/merge-patch+json'};

	assert.equal(options(methods, patch), '');
	assert.equal(options(methods, {...patch, 'vary': 'Origin',
		'access-control-allow-origin': 'https://a.example',
		'access-control-allow-methods': methods,
		'access-control-allow-headers': 'Authorization',
		'access-control-max-age': '600'}), '');
	assert.match(options('GET, HEAD, OPTIONS', patch), /Allow is/);
	assert.match(options(methods, {}), /Accept-Patch/);
	assert.match(options(methods, {...patch, etag: '"x"'}), /etag/);
}

function requested(headers, body, query = '') {
	const request = {method: 'POST', headers, body: Buffer.from(body),
		query: new URLSearchParams(query)};

	return contract.checkRequest(request, contract.find('POST',
		'/v1/scenes/x/eval')).join('; ');
}

function test_judge_reads_requests() {
	const json = {'content-type': 'application/json; charset=utf-8'};
	const octets = {'content-type': 'application/octet-stream'};

	assert.equal(requested(json, '{"points":[[1,2,3]]}',
		'outputs=value,color&deadline=2.5'), '');
	assert.equal(requested(octets, '0123456789ab'), '');
	assert.match(requested(octets, '0123456789'), /float32/);
	assert.match(requested({}, ''), /Content-Type missing/);
	assert.match(requested(json, '{"points":[[1,2]]}'), /points/);
	assert.match(requested(json, '{"points":[]}', 'outputs=mass'),
		/parameter outputs/);
	assert.match(requested(json, '{"points":[]}', 'output=value'),
		/output is not listed/);
}

function test_messages_are_found_however_they_are_cut() {
	const stream = Buffer.from('\r\nPOST /a HTTP/1.1\r\nHost: h\r\n' +
		'Content-Length: 5\r\n\r\nhello' +
		'PUT /b HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n' +
		'3;x=y\r\nabc\r\nA\r\n0123456789\r\n0\r\nT: t\r\n\r\n' +
		'GET /c HTTP/1.1\r\n\r\n');

	for (const size of [1, 2, 3, 7, 1000]) {
		const found = [];
		const messages = new Messages({onHead: () => {},
			onMessage: ({line}, body, isWhole) => found.push([
				line.split(' ')[1], String(body), isWhole]),
			onGarbled: () => found.push('garbled')});

		for (let i = 0; i < stream.length; i += size)
			messages.feed(stream.subarray(i, i + size));
		messages.end();
		assert.deepEqual(found, [['/a', 'hello', true],
			['/b', 'abc0123456789', true], ['/c', '', true]]);
	}
}

function test_messages_end_with_the_stream() {
	const found = [];
	const messages = new Messages({onHead: () => ({untilClose: true}),
		onMessage: (head, body, isWhole) => found.push([String(body),
			isWhole]), onGarbled: () => found.push('garbled')});

	messages.feed(Buffer.from('HTTP/1.1 200 OK\r\n\r\nall of it'));
	messages.end();
	assert.deepEqual(found, [['all of it', true]]);
}

/* ---- running them ---- */

const cases = [test_document_components_are_the_document_schema,
	test_layout_is_that_of_the_tool, test_it_stands_alone,
	test_schemas_compile, test_examples_are_valid,
	test_every_error_is_problem_json, test_spectral_finds_nothing,
	test_routes_are_those_of_the_daemon,
	test_query_parameters_are_those_of_the_daemon,
	test_methods_are_those_of_the_daemon,
	test_roles_are_those_of_the_daemon,
	test_refusals_are_those_of_the_role, test_the_daemon_serves_it,
	test_what_the_contract_excludes_is_refused,
	test_what_the_contract_allows_is_taken,
	test_judge_passes_what_is_right, test_judge_finds_what_is_wrong,
	test_judge_reads_events, test_judge_knows_preflights,
	test_judge_reads_requests,
	test_messages_are_found_however_they_are_cut,
	test_messages_end_with_the_stream];
let failed = 0;

daemon = await startDaemon();
for (const run of cases) {
	console.log(`[ RUN      ] ${run.name}`);
	try {
		await run();
		console.log(`[       OK ] ${run.name}`);
	} catch (error) {
		console.log(error.stack);
		console.log(`[  FAILED  ] ${run.name}`);
		failed = 1;
	}
}
process.exitCode = failed | await stopDaemon(daemon);
