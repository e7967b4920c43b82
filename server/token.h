/*
 * Tokens, what each may do and has used, and the file that says so:
 *
 *	{"tokens": [
 *	  {"name": "ci", "role": "write", "sha256": "<64 hex digits>",
 *	   "limits": {"requests_per_second": 50, "points_per_second": 1e6,
 *	              "bytes_per_second": 1e7, "scenes": 100,
 *	              "volume_bytes": 1e8}},
 *	  {"name": "anonymous", "role": "read"}]}
 *
 * sha256 is that of the secret (FIPS 180-4); secrets themselves are nowhere.
 * The entry "anonymous", which has none, is for requests without a token.
 *
 * Threads: a table never changes; what its tokens have used is locked.
 */
#ifndef SERVER_TOKEN_H
#define SERVER_TOKEN_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "server/access.h"
#include "server/bucket.h"

struct faults;

#define TOKENS_MAX 1024
#define TOKEN_HASH_BYTES 32
#define TOKEN_ANONYMOUS "anonymous"

/* Requests without a token have rates of their own by address; addresses that
 * share one of so many places (by a keyed hash) share those. */
#define TOKEN_GUESTS 1024
#define TOKEN_ADDRESS_BYTES 16

/* Of what there may be so much a second. */
enum token_rate {
	TOKEN_REQUESTS,
	TOKEN_POINTS,
	TOKEN_BYTES,
	TOKEN_RATE_COUNT
};

/* What a name has used: of all tables that have had it. */
struct token_use {
	atomic_int holders;   /* tables */
	pthread_mutex_t lock; /* guards: */
	struct bucket buckets[TOKEN_RATE_COUNT];
	double taken[TOKEN_RATE_COUNT]; /* in all */
	double refused;                 /* requests */
};

struct token {
	struct token_table *table; /* that it is in, and lives as long as */
	char name[TOKEN_NAME_MAX + 1];
	enum role role;
	uint8_t hash[TOKEN_HASH_BYTES];
	double rates[TOKEN_RATE_COUNT]; /* 0: any */
	size_t scenes;                  /* SIZE_MAX: any */
	size_t volume_bytes;            /* the same */
	struct token_use *use;
	const struct token *base;       /* of a guest: the entry "anonymous",
	                                 * whose use is that of all; or NULL */
};

/* What guests have used: of all tables that have had them. */
struct token_guests {
	atomic_int holders;   /* tables */
	uint8_t key[16];      /* random: nobody chooses who shares with whom */
	struct token_use uses[TOKEN_GUESTS];
};

struct token_table {
	atomic_int holders;
	size_t count;
	struct token *tokens;
	const struct token *anonymous; /* of them, or NULL */
	struct token_guests *guests;   /* NULL: anonymous has no rates */
	struct token *guest_tokens;    /* TOKEN_GUESTS, then */
};

/* "read", "evaluate", "write", "admin". */
const char *role_name(enum role role);
bool role_named(const char *name, enum role *out);

/* 1 to TOKEN_NAME_MAX of A-Z a-z 0-9 _ . - */
bool token_is_name(const char *name);

/* "requests_per_second" ... */
const char *token_rate_name(enum token_rate which);

void token_hash(const char *secret, size_t length,
    uint8_t out[static TOKEN_HASH_BYTES]);

/*
 * The table that a file's text says, held once; names that old has (NULL: no
 * table) go on with what they have used, at the new rates. ERR_SYNTAX,
 * ERR_INVALID, ERR_LIMIT: faults says at which places why, and old is as it
 * was. ERR_MEMORY.
 */
enum err token_table_read(const char *text, size_t length,
    const struct token_table *old, struct token_table **out,
    struct faults *faults);

/* Both may be given NULL. */
struct token_table *token_table_hold(struct token_table *t);
void token_table_release(struct token_table *t);

/*
 * The token of that secret, or NULL. All hashes are compared in full, with no
 * branch and no address that depends on the outcome: the time tells the number
 * of tokens and the length of the secret that was sent, nothing else.
 */
const struct token *token_find(const struct token_table *t,
    const char *secret, size_t length);

/* Of requests without a token that come from address: the entry "anonymous", or,
 * where that has rates, one like it; NULL: there is none. */
const struct token *token_guest(const struct token_table *t,
    const uint8_t address[static TOKEN_ADDRESS_BYTES]);

/* Whether t is for requests without a token. */
bool token_is_anonymous(const struct token *t);

/* Whether so much at once is more than may ever be taken. */
bool token_is_beyond(const struct token *t, enum token_rate which,
    double amount);

/* Takes amount if anything is left: 0. Else takes nothing, counts a refusal,
 * and returns the seconds until there is. */
double token_try(const struct token *t, enum token_rate which, double amount,
    double now);

/* Takes it in any case. */
void token_take(const struct token *t, enum token_rate which, double amount,
    double now);

#endif
