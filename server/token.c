#include "server/token.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include <nettle/memops.h>
#include <nettle/sha2.h>

static_assert(TOKEN_HASH_BYTES == SHA256_DIGEST_SIZE, "one hash");

static const char *const role_names[ROLE_COUNT] = {
	[ROLE_NONE] = "none",
	[ROLE_READ] = "read",
	[ROLE_EVALUATE] = "evaluate",
	[ROLE_WRITE] = "write",
	[ROLE_ADMIN] = "admin",
};

static const char *const rate_names[TOKEN_RATE_COUNT] = {
	[TOKEN_REQUESTS] = "requests_per_second",
	[TOKEN_POINTS] = "points_per_second",
	[TOKEN_BYTES] = "bytes_per_second",
};

const char *role_name(enum role role)
{
	return role_names[role];
}

bool role_named(const char *name, enum role *out)
{
	for (int i = ROLE_READ; i < ROLE_COUNT; i++) {
		if (strcmp(name, role_names[i]) == 0) {
			*out = (enum role)i;
			return true;
		}
	}
	return false;
}

const char *token_rate_name(enum token_rate which)
{
	return rate_names[which];
}

bool token_is_name(const char *name)
{
	static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
	    "abcdefghijklmnopqrstuvwxyz0123456789_.-";
	const size_t length = strlen(name);

	return length > 0 && length <= TOKEN_NAME_MAX &&
	    strspn(name, letters) == length;
}

void token_hash(const char *secret, size_t length,
    uint8_t out[static TOKEN_HASH_BYTES])
{
	struct sha256_ctx ctx;

	sha256_init(&ctx);
	sha256_update(&ctx, length, (const uint8_t *)secret);
	sha256_digest(&ctx, TOKEN_HASH_BYTES, out);
}

/* ---- the table ---- */

static void release_use(struct token_use *use)
{
	if (use == NULL || atomic_fetch_sub(&use->holders, 1) > 1)
		return;
	pthread_mutex_destroy(&use->lock);
	free(use);
}

static void release_guests(struct token_guests *guests)
{
	if (guests == NULL || atomic_fetch_sub(&guests->holders, 1) > 1)
		return;
	for (int i = 0; i < TOKEN_GUESTS; i++)
		pthread_mutex_destroy(&guests->uses[i].lock);
	free(guests);
}

struct token_table *token_table_hold(struct token_table *t)
{
	if (t != NULL)
		atomic_fetch_add(&t->holders, 1);
	return t;
}

void token_table_release(struct token_table *t)
{
	if (t == NULL || atomic_fetch_sub(&t->holders, 1) > 1)
		return;
	for (size_t i = 0; i < t->count; i++)
		release_use(t->tokens[i].use);
	release_guests(t->guests);
	free(t->guest_tokens);
	free(t->tokens);
	free(t);
}

const struct token *token_find(const struct token_table *t,
    const char *secret, size_t length)
{
	uint8_t hash[TOKEN_HASH_BYTES];
	size_t found = 0; /* its index and 1 */

	token_hash(secret, length, hash);
	for (size_t i = 0; i < t->count; i++) {
		const struct token *token = &t->tokens[i];
		const size_t is_it = (size_t)memeql_sec(hash, token->hash,
		    TOKEN_HASH_BYTES) & (size_t)(token != t->anonymous);

		found |= (i + 1) & (0 - is_it);
	}
	return found > 0 ? &t->tokens[found - 1] : NULL;
}

const struct token *token_guest(const struct token_table *t,
    const uint8_t address[static TOKEN_ADDRESS_BYTES])
{
	uint8_t hash[SHA256_DIGEST_SIZE];
	struct sha256_ctx ctx;

	if (t->anonymous == NULL || t->guests == NULL)
		return t->anonymous;
	sha256_init(&ctx);
	sha256_update(&ctx, sizeof t->guests->key, t->guests->key);
	sha256_update(&ctx, TOKEN_ADDRESS_BYTES, address);
	sha256_digest(&ctx, sizeof hash, hash);
	return &t->guest_tokens[(hash[0] << 8 | hash[1]) % TOKEN_GUESTS];
}

bool token_is_anonymous(const struct token *t)
{
	return t->base != NULL || t == t->table->anonymous;
}

/* ---- what it has used ---- */

/* What a guest does is anonymous's as well, in sum. */
static void count(const struct token *t, enum token_rate which, double amount,
    double refused)
{
	if (t->base == NULL)
		return;
	pthread_mutex_lock(&t->base->use->lock);
	t->base->use->taken[which] += amount;
	t->base->use->refused += refused;
	pthread_mutex_unlock(&t->base->use->lock);
}

bool token_is_beyond(const struct token *t, enum token_rate which,
    double amount)
{
	const struct bucket bucket = {.rate = t->rates[which]};

	return bucket_is_beyond(&bucket, amount);
}

double token_try(const struct token *t, enum token_rate which, double amount,
    double now)
{
	struct token_use *use = t->use;
	double wait;

	pthread_mutex_lock(&use->lock);
	wait = bucket_wait(&use->buckets[which], now);
	if (wait > 0.0) {
		use->refused += 1.0;
	} else {
		bucket_take(&use->buckets[which], amount, now);
		use->taken[which] += amount;
	}
	pthread_mutex_unlock(&use->lock);
	count(t, which, wait > 0.0 ? 0.0 : amount, wait > 0.0 ? 1.0 : 0.0);
	return wait;
}

void token_take(const struct token *t, enum token_rate which, double amount,
    double now)
{
	struct token_use *use = t->use;

	pthread_mutex_lock(&use->lock);
	bucket_take(&use->buckets[which], amount, now);
	use->taken[which] += amount;
	pthread_mutex_unlock(&use->lock);
	count(t, which, amount, 0.0);
}
