/*
 * Sums up what taps have written to a CONTRACT_LOG:
 *
 *	node tests/contract/sum.mjs LOG
 *
 * Status 1 if anything was amiss, or an operation of the contract was never seen
 * to succeed.
 */
import fs from 'node:fs';

import {VERBS} from './contract.mjs';
import {readContract} from './embed.mjs';

const all = {exchanges: 0, violations: 0, garbled: 0, cut: 0, large: 0};
const seen = {};

for (const line of fs.readFileSync(process.argv[2], 'utf8').split('\n')) {
	if (!line)
		continue;
	const {operations, ...totals} = JSON.parse(line);

	for (const name of Object.keys(all))
		all[name] += totals[name];
	for (const [name, counts] of Object.entries(operations))
		for (const [status, count] of Object.entries(counts)) {
			seen[name] ??= {};
			seen[name][status] = (seen[name][status] ?? 0) + count;
		}
}

const missing = [];

for (const [path, item] of Object.entries(readContract().paths))
	for (const verb of VERBS) {
		const name = `${verb.toUpperCase()} ${path}`;

		if (item[verb] && !Object.keys(seen[name] ?? {}).some((status) =>
			status < 300))
			missing.push(name);
	}
if (process.argv.includes('--all'))
	console.log(seen);
console.log(`contract: ${all.exchanges} exchanges, ${all.violations} ` +
	`violations; unjudged: ${all.garbled} connections with what is no ` +
	`HTTP, ${all.cut} messages cut short, ${all.large} large bodies`);
for (const name of missing)
	console.log(`contract: never seen to succeed: ${name}`);
process.exitCode = all.violations > 0 || missing.length > 0 ? 1 : 0;
