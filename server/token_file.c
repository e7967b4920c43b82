/*
 * The file of tokens: JSON to a table. Every fault has its place; members that
 * are not known are faults, as a limit that is misspelt must not be none.
 */
#include "server/token.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>

#include <cjson/cJSON.h>

#include "proto/arena.h"
#include "proto/fault.h"
#include "proto/json.h"
#include "server/clock.h"

/* An entry has 12 values with its limits. */
#define VALUES_MAX (TOKENS_MAX * 16 + 16)
#define RATE_MAX 1e15
#define SCENES_MAX 1e9
#define VOLUME_BYTES_MAX 1e15

/* A file being read. */
struct reading {
	struct token_table *table;
	struct faults *faults;
};

/* object's member, or NULL and a fault if it must be there. */
static const cJSON *member(struct reading *r, const struct json_place *at,
    const cJSON *object, const char *name, bool required)
{
	const cJSON *value = cJSON_GetObjectItemCaseSensitive(object, name);

	if (value == NULL && required)
		json_fault(r->faults, at, "needs a member '%s'", name);
	return value;
}

/* Faults members of object that are none of names. */
static void check_names(struct reading *r, const struct json_place *at,
    const cJSON *object, const char *const *names, size_t count)
{
	const cJSON *item;

	cJSON_ArrayForEach(item, object) {
		const struct json_place place = json_member(at, item->string);
		bool known = false;

		for (size_t i = 0; i < count; i++)
			known |= strcmp(item->string, names[i]) == 0;
		if (!known)
			json_fault(r->faults, &place, "is not known here");
	}
}

/* ---- members of an entry ---- */

static void read_name(struct reading *r, const struct json_place *parent,
    const cJSON *value, struct token *token)
{
	const struct json_place at = json_member(parent, "name");

	if (value == NULL)
		return;
	if (cJSON_IsString(value) && token_is_name(value->valuestring))
		strcpy(token->name, value->valuestring);
	else
		json_fault(r->faults, &at, "must be 1 to %d of A-Z a-z 0-9 _ "
		    ". -", TOKEN_NAME_MAX);
}

static void read_role(struct reading *r, const struct json_place *parent,
    const cJSON *value, struct token *token)
{
	const struct json_place at = json_member(parent, "role");

	if (value != NULL && (!cJSON_IsString(value) ||
	    !role_named(value->valuestring, &token->role)))
		json_fault(r->faults, &at, "must be \"read\", \"evaluate\", "
		    "\"write\" or \"admin\"");
	else if (token->role == ROLE_ADMIN &&
	    strcmp(token->name, TOKEN_ANONYMOUS) == 0)
		json_fault(r->faults, &at, "whoever comes without a token "
		    "cannot be \"admin\"");
}

static int hex_digit(char c)
{
	static const char digits[] = "0123456789abcdefABCDEF";
	const char *at = c != '\0' ? strchr(digits, c) : NULL;
	const int i = at != NULL ? (int)(at - digits) : -1;

	return i > 15 ? i - 6 : i;
}

/* Whether text is 64 digits. */
static bool read_hex(const char *text, uint8_t out[static TOKEN_HASH_BYTES])
{
	if (strlen(text) != 2 * TOKEN_HASH_BYTES)
		return false;
	for (int i = 0; i < TOKEN_HASH_BYTES; i++) {
		const int high = hex_digit(text[2 * i]);
		const int low = hex_digit(text[2 * i + 1]);

		if (high < 0 || low < 0)
			return false;
		out[i] = (uint8_t)(16 * high + low);
	}
	return true;
}

static void read_hash(struct reading *r, const struct json_place *parent,
    const cJSON *value, struct token *token)
{
	const struct json_place at = json_member(parent, "sha256");
	const bool is_anonymous = strcmp(token->name, TOKEN_ANONYMOUS) == 0;

	if (value == NULL && !is_anonymous)
		json_fault(r->faults, parent, "needs a member 'sha256': only "
		    "\"anonymous\" has no secret");
	else if (value != NULL && is_anonymous)
		json_fault(r->faults, &at, "\"anonymous\" is for requests "
		    "without a token and has no secret");
	else if (value != NULL && (!cJSON_IsString(value) ||
	    !read_hex(value->valuestring, token->hash)))
		json_fault(r->faults, &at, "must be 64 hexadecimal digits, the "
		    "SHA-256 of the secret (--make-token prints it)");
}

static void read_rate(struct reading *r, const struct json_place *parent,
    const cJSON *limits, enum token_rate which, struct token *token)
{
	const char *name = token_rate_name(which);
	const struct json_place at = json_member(parent, name);
	const cJSON *value = cJSON_GetObjectItemCaseSensitive(limits, name);

	if (value == NULL)
		return;
	if (cJSON_IsNumber(value) && value->valuedouble > 0.0 &&
	    value->valuedouble <= RATE_MAX)
		token->rates[which] = value->valuedouble;
	else
		json_fault(r->faults, &at, "must be a number above 0 and at "
		    "most %g", RATE_MAX);
}

/* What there may be so much of, not a second. */
static void read_count(struct reading *r, const struct json_place *parent,
    const cJSON *limits, const char *name, double most, size_t *out)
{
	const struct json_place at = json_member(parent, name);
	const cJSON *value = cJSON_GetObjectItemCaseSensitive(limits, name);

	if (value == NULL)
		return;
	if (cJSON_IsNumber(value) && value->valuedouble >= 0.0 &&
	    value->valuedouble <= most &&
	    value->valuedouble == floor(value->valuedouble))
		*out = (size_t)value->valuedouble;
	else
		json_fault(r->faults, &at, "must be a whole number of 0 to %g",
		    most);
}

static void read_limits(struct reading *r, const struct json_place *parent,
    const cJSON *value, struct token *token)
{
	static const char *const names[] = {"requests_per_second",
	    "points_per_second", "bytes_per_second", "scenes",
	    "volume_bytes"};
	const struct json_place at = json_member(parent, "limits");

	if (value == NULL)
		return;
	if (!cJSON_IsObject(value)) {
		json_fault(r->faults, &at, "must be an object, not %s",
		    json_kind(value));
		return;
	}
	check_names(r, &at, value, names, sizeof names / sizeof *names);
	for (int i = 0; i < TOKEN_RATE_COUNT; i++)
		read_rate(r, &at, value, (enum token_rate)i, token);
	read_count(r, &at, value, "scenes", SCENES_MAX, &token->scenes);
	read_count(r, &at, value, "volume_bytes", VOLUME_BYTES_MAX,
	    &token->volume_bytes);
}

/* ---- entries ---- */

static void read_entry(struct reading *r, const struct json_place *at,
    const cJSON *value, struct token *token)
{
	static const char *const names[] = {"name", "role", "sha256",
	    "limits"};

	*token = (struct token){.table = r->table, .scenes = SIZE_MAX,
	    .volume_bytes = SIZE_MAX};
	if (!cJSON_IsObject(value)) {
		json_fault(r->faults, at, "must be an object, not %s",
		    json_kind(value));
		return;
	}
	check_names(r, at, value, names, sizeof names / sizeof *names);
	read_name(r, at, member(r, at, value, "name", true), token);
	read_role(r, at, member(r, at, value, "role", true), token);
	read_hash(r, at, member(r, at, value, "sha256", false), token);
	read_limits(r, at, member(r, at, value, "limits", false), token);
	if (strcmp(token->name, TOKEN_ANONYMOUS) == 0)
		r->table->anonymous = token;
}

/* Faults an entry that has another's name or secret. */
static void check_twice(struct reading *r, const struct json_place *at,
    size_t index)
{
	const struct token *tokens = r->table->tokens, *token = &tokens[index];

	for (size_t i = 0; i < index; i++) {
		if (token->name[0] != '\0' &&
		    strcmp(token->name, tokens[i].name) == 0)
			json_fault(r->faults, at, "has the name of entry %zu",
			    i);
		else if (memcmp(token->hash, tokens[i].hash,
		    TOKEN_HASH_BYTES) == 0)
			json_fault(r->faults, at, "has the secret of entry "
			    "%zu", i);
	}
}

static enum err read_entries(struct reading *r, const struct json_place *at,
    const cJSON *array)
{
	struct token_table *table = r->table;
	struct json_place place = json_element(at, 0);
	const size_t count = (size_t)cJSON_GetArraySize(array);
	const cJSON *entry;

	if (count > TOKENS_MAX) {
		json_fault(r->faults, at, "has %zu entries; %d are the most",
		    count, TOKENS_MAX);
		return ERR_LIMIT;
	}
	table->tokens = calloc(count > 0 ? count : 1, sizeof *table->tokens);
	if (table->tokens == NULL)
		return ERR_MEMORY;
	cJSON_ArrayForEach(entry, array) {
		read_entry(r, &place, entry, &table->tokens[place.index]);
		table->count++;
		if (r->faults->count == 0)
			check_twice(r, &place, place.index);
		place.index++;
	}
	return r->faults->count > 0 ? ERR_INVALID : ERR_OK;
}

static enum err read_root(struct reading *r, const cJSON *json)
{
	static const char *const names[] = {"tokens"};
	const struct json_place root = json_root("");
	const struct json_place at = json_member(&root, "tokens");
	const cJSON *array;

	if (!cJSON_IsObject(json)) {
		json_fault(r->faults, &root, "must be an object, not %s",
		    json_kind(json));
		return ERR_INVALID;
	}
	check_names(r, &root, json, names, 1);
	array = member(r, &root, json, "tokens", true);
	if (array != NULL && !cJSON_IsArray(array))
		json_fault(r->faults, &at, "must be an array, not %s",
		    json_kind(array));
	return r->faults->count > 0 ? ERR_INVALID :
	    read_entries(r, &at, array);
}

/* ---- what they have used ---- */

static struct token_use *make_use(void)
{
	struct token_use *use = calloc(1, sizeof *use);

	if (use == NULL)
		return NULL;
	atomic_store(&use->holders, 1);
	pthread_mutex_init(&use->lock, NULL);
	return use;
}

static struct token_use *find_use(const struct token_table *old,
    const char *name)
{
	for (size_t i = 0; old != NULL && i < old->count; i++) {
		if (strcmp(old->tokens[i].name, name) != 0)
			continue;
		atomic_fetch_add(&old->tokens[i].use->holders, 1);
		return old->tokens[i].use;
	}
	return make_use();
}

/* Guests that old has had, or new ones. */
static struct token_guests *find_guests(const struct token_table *old)
{
	struct token_guests *guests;

	if (old != NULL && old->guests != NULL) {
		atomic_fetch_add(&old->guests->holders, 1);
		return old->guests;
	}
	guests = calloc(1, sizeof *guests);
	if (guests == NULL)
		return NULL;
	if (getrandom(guests->key, sizeof guests->key, 0) !=
	    sizeof guests->key) {
		free(guests);
		return NULL;
	}
	atomic_store(&guests->holders, 1);
	for (int i = 0; i < TOKEN_GUESTS; i++)
		pthread_mutex_init(&guests->uses[i].lock, NULL);
	return guests;
}

static bool has_rates(const struct token *token)
{
	bool has = false;

	for (int i = 0; i < TOKEN_RATE_COUNT; i++)
		has |= token->rates[i] > 0.0;
	return has;
}

static enum err make_guests(struct token_table *table,
    const struct token_table *old)
{
	const struct token *anonymous = table->anonymous;

	if (anonymous == NULL || !has_rates(anonymous))
		return ERR_OK;
	table->guest_tokens = calloc(TOKEN_GUESTS,
	    sizeof *table->guest_tokens);
	table->guests = find_guests(old);
	if (table->guest_tokens == NULL || table->guests == NULL)
		return ERR_MEMORY;
	for (int i = 0; i < TOKEN_GUESTS; i++) {
		table->guest_tokens[i] = *anonymous;
		table->guest_tokens[i].use = &table->guests->uses[i];
		table->guest_tokens[i].base = anonymous;
	}
	return ERR_OK;
}

static void set_rates(const struct token *token)
{
	struct token_use *use = token->use;
	const double now = clock_seconds();

	pthread_mutex_lock(&use->lock);
	for (int i = 0; i < TOKEN_RATE_COUNT; i++)
		bucket_set_rate(&use->buckets[i], token->rates[i], now);
	pthread_mutex_unlock(&use->lock);
}

/* Nothing that old shares is changed before all of it is there. */
static enum err find_uses(struct token_table *table,
    const struct token_table *old)
{
	for (size_t i = 0; i < table->count; i++) {
		table->tokens[i].use = find_use(old, table->tokens[i].name);
		if (table->tokens[i].use == NULL)
			return ERR_MEMORY;
	}
	if (make_guests(table, old) != ERR_OK)
		return ERR_MEMORY;
	for (size_t i = 0; i < table->count; i++)
		set_rates(&table->tokens[i]);
	for (int i = 0; table->guests != NULL && i < TOKEN_GUESTS; i++)
		set_rates(&table->guest_tokens[i]);
	return ERR_OK;
}

enum err token_table_read(const char *text, size_t length,
    const struct token_table *old, struct token_table **out,
    struct faults *faults)
{
	struct arena arena = {0};
	struct reading r = {calloc(1, sizeof *r.table), faults};
	cJSON *json;
	enum err err;

	if (r.table == NULL)
		return ERR_MEMORY;
	atomic_store(&r.table->holders, 1);
	err = json_parse(text, length, VALUES_MAX, &arena, &json, faults);
	if (err == ERR_OK)
		err = read_root(&r, json);
	if (err == ERR_OK)
		err = find_uses(r.table, old);
	arena_fini(&arena);
	if (err == ERR_OK)
		*out = r.table;
	else
		token_table_release(r.table);
	return err;
}
