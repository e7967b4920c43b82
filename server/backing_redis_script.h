/*
 * What is done inside of Redis, at once: Lua, run by EVALSHA. Effects are
 * replicated and written to its log as one transaction.
 *
 * Keys, each behind the prefix:
 *   scene:ID     hash: etag, seq, owner, nodes of the present revision,
 *                text:SEQ of those that are kept, and past: "SEQ BYTES", of all
 *                texts that were kept when the present one was SEQ
 *   history:ID   list, newest first: "SEQ ETAG NODES BYTES"
 *   scenes       set of the ids
 *   volume:ID    hash: data, forgotten (0, 1), since (ms since 1970), owner; of
 *                a forgotten one was, its owner until then, instead
 *   volumes      set of the ids
 *   changes      stream of all changes: kind, id, etag, nodes, bytes, token,
 *                prev, before; its ids are the sequence numbers
 *   last         id of the newest entry of changes
 *   void:TOKEN   a change that is not to be made any more
 *   alive        written now and then, to know that it can be
 * prev of an entry is the id of the one before: who finds another one there has
 * missed some. before is the scene's revision that was there, or "".
 */
#ifndef SERVER_BACKING_REDIS_SCRIPT_H
#define SERVER_BACKING_REDIS_SCRIPT_H

enum backing_redis_script {
	/* KEYS scene history scenes changes last void; ARGV kind ("put",
	 * "delete"), id, expected (etag; "": none; "*": whatever), etag, text,
	 * owner, nodes, token, revisions to keep, entries to keep, the latest
	 * time (ms since 1970, Redis' clock) at which to do it, bytes of older
	 * revisions to keep. Gives {"ok", seq, before, owner, prev, oldest},
	 * {"conflict"}, {"absent"} (nothing to delete), {"late"}, {"void"};
	 * before: seq of what was there, or ""; oldest: of what is kept, or "".
	 * The owner of what is there stays. */
	SCRIPT_COMMIT,
	/* KEYS scene history last. Gives {last} if there is no scene, else {seq, etag, owner, nodes, text, history...}. */
	SCRIPT_FETCH,
	/* KEYS scene history; ARGV etag. Gives {seq, owner, nodes, text} of the
	 * newest such revision, or {}. */
	SCRIPT_READ,
	/* KEYS changes void...; ARGV from (an id of changes), token... Gives,
	 * for each token, the seq of its change, or "": it has not been made,
	 * and will not be. */
	SCRIPT_SETTLE,
	/* KEYS volume volumes changes last; ARGV kind ("volume", "forget",
	 * "gone"), id, data, token, entries to keep, grace (ms after it was
	 * forgotten in which it is not removed), the latest time, owner. Gives
	 * {seq, owner} (of "volume": whose it is); "": there is none, or it is
	 * not forgotten; "early"; "late". The owner of what is there and not
	 * forgotten stays. */
	SCRIPT_VOLUME,
	SCRIPT_COUNT
};

extern const char *const backing_redis_scripts[SCRIPT_COUNT];

#endif
