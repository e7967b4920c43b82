#include "server/backing_redis_script.h"

/* The first write is XADD: one that is refused for want of memory leaves nothing
 * behind. */
static const char commit[] =
"local scene, history, scenes, changes, last, void = unpack(KEYS)\n"
"local kind, id, expected, etag, text, owner, nodes, token, revisions,\n"
"    entries, latest, most = unpack(ARGV)\n"
"local now = redis.call('TIME')\n"
"if now[1] * 1000 + math.floor(now[2] / 1000) > tonumber(latest) then\n"
"	return {'late'}\n"
"end\n"
"if redis.call('EXISTS', void) == 1 then return {'void'} end\n"
"local found = redis.call('HMGET', scene, 'etag', 'seq', 'owner', 'past')\n"
"local there, before = found[1] or '', found[2] or ''\n"
"if expected ~= '*' and expected ~= there then return {'conflict'} end\n"
"if kind == 'delete' and there == '' then return {'absent'} end\n"
"local function bytes_of(line)\n"
"	return tonumber(string.match(line, ' (%d+)$')) or 0\n"
"end\n"
/* Who does not know of the field leaves it as it was. */
"local at, past = string.match(found[4] or '', '^(%S+) (%d+)$')\n"
"past = at == before and tonumber(past)\n"
"if kind == 'put' and not past then\n"
"	local list = redis.call('LRANGE', history, 0, -1)\n"
"	past = 0\n"
"	for i = 1, #list do past = past + bytes_of(list[i]) end\n"
"end\n"
"local prev = redis.call('GET', last) or '0-0'\n"
"local seq = redis.call('XADD', changes, 'MAXLEN', '~', entries, '*',\n"
"    'kind', kind, 'id', id, 'etag', etag, 'nodes', nodes, 'bytes', #text,\n"
"    'token', token, 'prev', prev, 'before', before)\n"
"redis.call('SET', last, seq)\n"
"if found[1] then owner = found[3] or '' end\n"
"if kind == 'delete' then\n"
"	redis.call('DEL', scene, history)\n"
"	redis.call('SREM', scenes, id)\n"
"	return {'ok', seq, before, owner, prev, ''}\n"
"end\n"
"redis.call('HSET', scene, 'etag', etag, 'seq', seq, 'owner', owner,\n"
"    'nodes', nodes, 'text:' .. seq, text)\n"
"redis.call('SADD', scenes, id)\n"
"local count = redis.call('LPUSH', history,\n"
"    seq .. ' ' .. etag .. ' ' .. nodes .. ' ' .. #text)\n"
"while count > 1 and (count > tonumber(revisions) or\n"
"    past > tonumber(most)) do\n"
"	local old = redis.call('RPOP', history)\n"
"	redis.call('HDEL', scene, 'text:' .. string.match(old, '^%S+'))\n"
"	past = past - bytes_of(old)\n"
"	count = count - 1\n"
"end\n"
"redis.call('HSET', scene, 'past', string.format('%s %.0f', seq,\n"
"    math.max(0, past) + #text))\n"
"local oldest = redis.call('LINDEX', history, -1)\n"
"return {'ok', seq, before, owner, prev, string.match(oldest, '^%S+')}\n";

static const char fetch[] =
"local scene, history, last = unpack(KEYS)\n"
"local now = redis.call('HMGET', scene, 'seq', 'etag', 'owner', 'nodes')\n"
"if not now[1] then return {redis.call('GET', last) or '0-0'} end\n"
"now[5] = redis.call('HGET', scene, 'text:' .. now[1])\n"
"local list = redis.call('LRANGE', history, 1, -1)\n"
"for i = 1, #list do now[5 + i] = list[i] end\n"
"return now\n";

static const char read[] =
"local scene, history = unpack(KEYS)\n"
"local list = redis.call('LRANGE', history, 0, -1)\n"
"for i = 1, #list do\n"
"	local seq, etag, nodes = string.match(list[i],\n"
"	    '^(%S+) (%S+) (%S+)')\n"
"	if etag == ARGV[1] then\n"
"		return {seq, redis.call('HGET', scene, 'owner'), nodes,\n"
"		    redis.call('HGET', scene, 'text:' .. seq)}\n"
"	end\n"
"end\n"
"return {}\n";

/* Only what is in the stream has been made. */
static const char settle[] =
"local made = {}\n"
"local list = redis.call('XRANGE', KEYS[1], ARGV[1], '+')\n"
"for i = 1, #list do\n"
"	local fields = list[i][2]\n"
"	for j = 1, #fields, 2 do\n"
"		if fields[j] == 'token' then\n"
"			made[fields[j + 1]] = list[i][1]\n"
"		end\n"
"	end\n"
"end\n"
"local out = {}\n"
"for i = 2, #ARGV do\n"
"	out[i - 1] = made[ARGV[i]] or ''\n"
"	if not made[ARGV[i]] then\n"
"		redis.call('SET', KEYS[i], 1, 'EX', 60)\n"
"	end\n"
"end\n"
"return out\n";

static const char volume[] =
"local volume, volumes, changes, last = unpack(KEYS)\n"
"local kind, id, data, token, entries, grace, latest, owner = unpack(ARGV)\n"
"local there = redis.call('HMGET', volume, 'forgotten', 'since')\n"
"local time = redis.call('TIME')\n"
"local now = time[1] * 1000 + math.floor(time[2] / 1000)\n"
"if now > tonumber(latest) then return 'late' end\n"
"if kind ~= 'volume' and not there[1] then return '' end\n"
"if kind == 'gone' and there[1] ~= '1' then return '' end\n"
"if kind == 'gone' and\n"
"    math.abs(now - (there[2] or 0)) < tonumber(grace) then\n"
"	return 'early'\n"
"end\n"
"local prev = redis.call('GET', last) or '0-0'\n"
"local seq = redis.call('XADD', changes, 'MAXLEN', '~', entries, '*',\n"
"    'kind', kind, 'id', id, 'etag', '', 'token', token, 'prev', prev)\n"
"redis.call('SET', last, seq)\n"
"if kind == 'volume' then\n"
"	if there[1] == '0' then\n"
"		owner = redis.call('HGET', volume, 'owner') or ''\n"
"	end\n"
"	redis.call('HSET', volume, 'data', data, 'forgotten', 0,\n"
"	    'owner', owner)\n"
"	redis.call('SADD', volumes, id)\n"
"elseif kind == 'forget' then\n"
"	redis.call('HSET', volume, 'forgotten', 1, 'since', now)\n"
"else\n"
"	redis.call('DEL', volume)\n"
"	redis.call('SREM', volumes, id)\n"
"end\n"
"return seq\n";

const char *const backing_redis_scripts[SCRIPT_COUNT] = {
	[SCRIPT_COMMIT] = commit,
	[SCRIPT_FETCH] = fetch,
	[SCRIPT_READ] = read,
	[SCRIPT_SETTLE] = settle,
	[SCRIPT_VOLUME] = volume,
};
