/*
 * The document schema within the contract: proto/openapi.json stands alone, so
 * its components Document and Document.* are copies of proto/document.schema.json.
 *
 *	node tests/contract/embed.mjs
 *
 * writes proto/openapi.json anew, with those and in the layout below.
 */
import fs from 'node:fs';
import {pathToFileURL} from 'node:url';

export const CONTRACT = 'proto/openapi.json';
export const DOCUMENT = 'proto/document.schema.json';

const WIDTH = 120;

/* JSON as a person would write it: what fits stands on one line. */
export function format(value, indent = '') {
	if (value === null || typeof value !== 'object')
		return JSON.stringify(value);
	const isArray = Array.isArray(value);
	const parts = Object.entries(value).map(([name, item]) => (isArray ?
		'' : JSON.stringify(name) + ': ') + format(item, indent + ' '));
	const [open, close] = isArray ? '[]' : '{}';
	const line = open + parts.join(', ') + close;

	if (line.length + indent.length <= WIDTH && !line.includes('\n'))
		return line;
	return open + '\n' + parts.map((part) => indent + ' ' + part)
		.join(',\n') + '\n' + indent + close;
}

/* The schema's $defs by their names as components. */
function renamed(value) {
	if (Array.isArray(value))
		return value.map(renamed);
	if (value === null || typeof value !== 'object')
		return value;
	return Object.fromEntries(Object.entries(value).map(([name, item]) =>
		[name, name === '$ref' ? item.replace('#/$defs/',
			'#/components/schemas/Document.') : renamed(item)]));
}

/* The components that are made of the document schema. */
export function documentComponents() {
	const {$schema, $id, $defs, ...schema} = renamed(JSON.parse(
		fs.readFileSync(DOCUMENT, 'utf8')));
	const components = {Document: schema};

	for (const [name, item] of Object.entries($defs))
		components['Document.' + name] = item;
	return components;
}

export function readContract() {
	return JSON.parse(fs.readFileSync(CONTRACT, 'utf8'));
}

if (import.meta.url === pathToFileURL(process.argv[1]).href) {
	const contract = readContract();
	const schemas = contract.components.schemas;
	const own = Object.entries(schemas).filter(([name]) =>
		!/^Document($|\.)/.test(name));

	contract.components.schemas = {...Object.fromEntries(own),
		...documentComponents()};
	fs.writeFileSync(CONTRACT, format(contract) + '\n');
}
