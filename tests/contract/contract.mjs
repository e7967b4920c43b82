/*
 * proto/openapi.json as a judge: whether a request and its answer are as it
 * says. What is wrong is told in sentences.
 */
import Ajv2020 from 'ajv/dist/2020.js';

/* Headers of HTTP itself, which the contract does not list. */
const PLAIN = new Set(['connection', 'content-length', 'content-type', 'date',
	'keep-alive', 'transfer-encoding']);

/* What may be answered before a path or a method is looked at. */
const EARLY = [400, 413, 414, 415, 431, 500, 501, 503, 505];

/* The methods that have operations; HEAD and OPTIONS have none of their own. */
export const VERBS = ['get', 'post', 'put', 'patch', 'delete'];

const MAGIC = {
	'application/x-npy': '\x93NUMPY',
	'image/png': '\x89PNG\r\n\x1a\n',
	'model/gltf-binary': 'glTF',
	'application/x-ply': 'ply\n',
};

const escaped = (name) => name.replace(/~/g, '~0').replace(/\//g, '~1');

/* The media type of a Content-Type. */
export const mediaOf = (value) => (value ?? '').split(';')[0].trim()
	.toLowerCase();

/* A block of a stream of Server-Sent Events: {field: value}; a comment's field
 * is ''. */
const fieldsOf = (block) => Object.fromEntries(block.split('\n').map((line) => {
	const at = line.indexOf(':');

	return [line.slice(0, at), line.slice(at + 1).trimStart()];
}));

export class Contract {
	constructor(contract) {
		this.contract = contract;
		this.ajv = new Ajv2020({strict: false, validateFormats: false});
		this.ajv.addSchema(contract, 'contract:');
		this.compiled = new Map();
		this.events = new Set(); /* blocks that are right: many hear them */
		this.paths = Object.entries(contract.paths).map(([path, item]) =>
			({path, item, pattern: new RegExp('^' +
				path.replace(/[.]/g, '\\.').replace(/{[^}]*}/g,
					'([^/]+)') + '$')}));
	}

	/* The place that a $ref leads to, if place has one. */
	resolve(place) {
		const value = place.split('/').slice(1).reduce((at, name) =>
			at?.[name.replace(/~1/g, '/').replace(/~0/g, '~')],
		this.contract);

		return value?.$ref ? this.resolve(value.$ref.slice(1)) :
			{place, value};
	}

	/* null, or what is wrong with value by the schema at place. */
	check(place, value) {
		let validate = this.compiled.get(place);

		if (!validate) {
			validate = this.ajv.compile({$ref: 'contract:#' +
				encodeURI(place)});
			this.compiled.set(place, validate);
		}
		if (validate(value))
			return null;
		return validate.errors.map((e) => (e.instancePath || '""') +
			' ' + e.message).join('; ');
	}

	/* The operation that a request is of: {path, place, operation, id}; only
	 * with a path if that has other methods; null without. */
	find(method, path) {
		for (const {path: name, item, pattern} of this.paths) {
			const match = pattern.exec(path);
			const verb = method === 'HEAD' ? 'get' :
				method.toLowerCase();

			if (match)
				return {path: name, item, id: match[1],
					operation: item[verb],
					place: `/paths/${escaped(name)}/${verb}`};
		}
		return null;
	}

	/* All parameters, resolved, with their places. */
	parametersOf(found) {
		const base = `/paths/${escaped(found.path)}`;
		const list = (at, item) => (item.parameters ?? []).map((_, i) =>
			this.resolve(`${at}/parameters/${i}`));

		return [...list(base, found.item), ...list(found.place,
			found.operation)];
	}

	/* ---- answers ---- */

	checkAnswer(request, answer, found) {
		const wrong = [];

		/* The HTTP library's own page, of what never comes to the daemon:
		 * HTML, but of a head as large as its memory not even that is
		 * said. The daemon's own always say what they are. */
		if (EARLY.includes(answer.status) && ['text/html', ''].includes(
			mediaOf(answer.headers['content-type'])))
			return wrong;
		if (!found)
			this.checkEarly(request, answer, [404], wrong);
		else if (request.method === 'OPTIONS')
			this.checkOptions(request, found, answer, wrong);
		else if (!found.operation)
			this.checkMethod(request, found, answer, wrong);
		else if (!found.operation.responses[answer.status])
			wrong.push(`status ${answer.status} is not listed`);
		else
			this.checkListed(this.resolve(found.place +
				`/responses/${answer.status}`), request, answer,
			wrong);
		return wrong;
	}

	/* An answer of components/responses with one of those statuses, or of
	 * the early ones. */
	checkEarly(request, answer, statuses, wrong) {
		const name = Object.keys(this.contract.components.responses)
			.find((key) => this.problemStatus(key) === answer.status);

		if (![...EARLY, ...statuses].includes(answer.status) || !name)
			wrong.push(`status ${answer.status} instead of ` +
				statuses.join(', '));
		else
			this.checkListed(this.resolve('/components/responses/' +
				name), request, answer, wrong);
	}

	problemStatus(name) {
		return this.contract.components.responses[name].content?.[
			'application/problem+json']?.schema.allOf[1].properties
			.status.const;
	}

	methodsOf(found) {
		const verbs = VERBS.filter((verb) => found.item[verb])
			.map((verb) => verb.toUpperCase());

		return [...verbs, ...(verbs.includes('GET') ? ['HEAD'] : []),
			'OPTIONS'].sort().join(', ');
	}

	checkAllow(found, answer, wrong) {
		const allow = (answer.headers.allow ?? '').split(', ').sort()
			.join(', ');

		if (allow !== this.methodsOf(found))
			wrong.push(`Allow is '${allow}', the contract has ` +
				this.methodsOf(found));
	}

	checkOptions(request, found, answer, wrong) {
		if (answer.status !== 204) {
			this.checkEarly(request, answer, [], wrong);
			return;
		}
		this.checkListed(this.resolve('/components/responses/Options'),
			request, answer, wrong);
		this.checkAllow(found, answer, wrong);
		if (('accept-patch' in answer.headers) !== ('patch' in found.item))
			wrong.push('Accept-Patch is for paths with PATCH');
	}

	checkMethod(request, found, answer, wrong) {
		this.checkEarly(request, answer, [405], wrong);
		if (answer.status === 405)
			this.checkAllow(found, answer, wrong);
	}

	checkListed({place, value: response}, request, answer, wrong) {
		this.checkHeaders(place, response, answer, wrong);
		this.checkContent(place, response, request, answer, wrong);
	}

	checkHeaders(place, response, answer, wrong) {
		const known = new Set();

		for (const name of Object.keys(response.headers ?? {})) {
			const header = this.resolve(`${place}/headers/${name}`);
			const given = answer.headers[name.toLowerCase()];
			const bad = given !== undefined && this.check(
				header.place + '/schema', given);

			known.add(name.toLowerCase());
			if (header.value.required && given === undefined)
				wrong.push(`header ${name} is missing`);
			if (bad)
				wrong.push(`header ${name}: '${given}' ${bad}`);
		}
		for (const name of Object.keys(answer.headers))
			if (!PLAIN.has(name) && !known.has(name))
				wrong.push(`header ${name} is not listed`);
	}

	checkContent(place, response, request, answer, wrong) {
		const media = mediaOf(answer.headers['content-type']);

		if (!response.content) {
			/* A 304 may say what a 200 would. */
			if (answer.body?.length)
				wrong.push('a body, where none is listed');
			return;
		}
		if (!response.content[media]) {
			wrong.push(`Content-Type ${media || 'missing'} is not listed`);
			return;
		}
		if (request.method !== 'HEAD' && answer.body)
			this.checkBody(`${place}/content/${escaped(media)}`, media,
				answer.body, wrong);
	}

	checkBody(place, media, body, wrong) {
		const {schema} = this.resolve(place).value;
		let value;

		if (media === 'text/event-stream') {
			this.checkEvents(place, body.toString(), wrong);
		} else if (/json$/.test(media)) {
			try {
				value = JSON.parse(body.toString());
			} catch {
				wrong.push('the body is not JSON');
				return;
			}
			const bad = schema && this.check(`${place}/schema`, value);

			if (bad)
				wrong.push(`the body: ${bad}`);
		} else if (media === 'application/octet-stream') {
			if (body.length % 4)
				wrong.push('the body is not whole float32');
		} else if (MAGIC[media] && !body.toString('latin1', 0, 16)
			.startsWith(MAGIC[media])) {
			wrong.push(`the body is no ${media}`);
		}
	}

	/* A stream of events, which may have been cut anywhere. */
	checkEvents(place, text, wrong) {
		const [head, ...blocks] = text.split('\n\n').slice(0, -1);
		const before = wrong.length;

		if (head !== undefined && !/^retry: \d+$/.test(head))
			wrong.push('the stream does not begin with retry');
		for (const block of blocks) {
			if (block.startsWith(':') || this.events.has(block))
				continue;
			this.checkEvent(place, fieldsOf(block), wrong);
			if (wrong.length === before)
				this.events.add(block);
		}
	}

	checkEvent(place, {id, event, data}, wrong) {
		if (!this.resolve(place).value['x-event-data'][event]) {
			wrong.push(`event ${event} is not listed`);
			return;
		}
		try {
			const value = JSON.parse(data);
			const bad = this.check(`${place}/x-event-data/${event}`,
				value);

			if (bad)
				wrong.push(`event ${event}: ${bad}`);
			if (value.sequence !== id)
				wrong.push(`event ${event}: id ${id} is not its ` +
					'sequence');
		} catch {
			wrong.push(`event ${event}: its data is not JSON`);
		}
	}

	/* ---- requests that have succeeded ---- */

	checkRequest(request, found) {
		const wrong = [];

		this.checkParameters(request, found, wrong);
		this.checkRequestBody(request, found, wrong);
		return wrong.map((sentence) => 'request: ' + sentence);
	}

	/* A parameter's text as its schema means it. */
	read({place, value}, given) {
		const {type} = this.resolve(`${place}/schema`).value;
		const number = (text) => /^-?\d/.test(text) ? Number(text) : text;

		if (type === 'array')
			return given.split(',').map(number);
		return type === 'number' || type === 'integer' ? number(given) :
			given;
	}

	checkParameters(request, found, wrong) {
		const parameters = this.parametersOf(found);
		const names = new Set();

		for (const parameter of parameters) {
			const {name, in: where, required} = parameter.value;
			const given = where === 'path' ? found.id : where === 'query' ?
				request.query.get(name) ?? undefined :
				request.headers[name.toLowerCase()];
			const bad = given !== undefined && this.check(
				`${parameter.place}/schema`, this.read(parameter,
					given));

			if (where === 'query')
				names.add(name);
			if (given === undefined && required)
				wrong.push(`${where} parameter ${name} is missing`);
			if (bad)
				wrong.push(`${where} parameter ${name}: ${bad}`);
		}
		for (const name of request.query.keys())
			if (!names.has(name))
				wrong.push(`query parameter ${name} is not listed`);
	}

	checkRequestBody(request, found, wrong) {
		const body = found.operation.requestBody;
		const media = mediaOf(request.headers['content-type']);

		/* GET and the like pass over theirs. */
		if (!body)
			return;
		if (!body.content[media])
			wrong.push(`Content-Type ${media || 'missing'} is not listed`);
		else if (request.body)
			this.checkBody(`${found.place}/requestBody/content/` +
				escaped(media), media, request.body, wrong);
	}
}
