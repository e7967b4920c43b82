#include "server/table_cache.h"

#include <errno.h>
#include <math.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#include "kernels/cache_file.h"
#include "server/log.h"

#define KIND_TABLE "table"
#define KIND_FIGURES "figures"

/* Nodes, and nodes of curves, that a table read must have right: 0.4 ms. */
#define VERIFY_NODES 64

#define LARGE_PAGE ((uintptr_t)2 << 20)

struct table_cache {
	char *folder;
	size_t most;
	bool is_read_only;
	atomic_bool has_failed; /* to write, and said so */
};

/* struct table_figures as it lies on disk. */
struct stored_figures {
	double build_seconds;
	uint64_t is_measured;
	struct table_error error;
};

enum err table_cache_create(const char *folder, size_t most,
    bool is_read_only, struct table_cache **out)
{
	struct table_cache *c = calloc(1, sizeof *c);

	if (c == NULL)
		return ERR_MEMORY;
	c->most = most;
	c->folder = strdup(folder);
	if (c->folder == NULL) {
		free(c);
		return ERR_MEMORY;
	}
	c->is_read_only = is_read_only;
	if (!is_read_only)
		cache_trim(folder, most);
	*out = c;
	return ERR_OK;
}

void table_cache_free(struct table_cache *c)
{
	if (c == NULL)
		return;
	free(c->folder);
	free(c);
}

/* What the type does not use is not in the key. */
static void add_profile(struct cache_key *key, const struct profile *profile)
{
	size_t count = (size_t)profile->count;

	cache_key_add_int(key, profile->type);
	if (profile->type == PROFILE_BULGE)
		cache_key_add(key, &profile->k, sizeof profile->k);
	if (profile->type != PROFILE_SAMPLES)
		return;
	cache_key_add_int(key, profile->count);
	cache_key_add(key, profile->x, count * sizeof *profile->x);
	cache_key_add(key, profile->y, count * sizeof *profile->y);
	cache_key_add(key, profile->slope, count * sizeof *profile->slope);
}

static void make_key(struct cache_key *key, const struct operator *op)
{
	const double number = 1.0 / 3.0;

	key->size = 0;
	cache_key_add_text(key, KIND_TABLE);
	cache_key_add_int(key, TABLE_VERSION);
	cache_key_add(key, &number, sizeof number);
	cache_key_add(key, &(float){(float)number}, sizeof(float));
	cache_key_add_int(key, sizeof(size_t)); /* in struct table_error */
	cache_key_add_int(key, op->family);
	cache_key_add_int(key, op->layout);
	cache_key_add_int(key, op->resolution);
	add_profile(key, &op->profile);
}

/* ---- reading ---- */

/* Leaves *out alone if there are none. */
static void load_figures(const struct table_cache *c,
    const struct cache_key *key, struct table_figures *out)
{
	struct stored_figures stored;
	struct cache_file file;

	if (cache_file_open(c->folder, KIND_FIGURES, key, &file) != ERR_OK)
		return;
	if (file.size != sizeof stored) {
		cache_file_close(&file);
		return;
	}
	if (cache_file_read(&file, &stored) != ERR_OK ||
	    !isfinite(stored.build_seconds))
		return;
	out->build_seconds = stored.build_seconds;
	out->is_measured = stored.is_measured == 1;
	if (out->is_measured)
		out->error = stored.error;
}

/* Has the kernel give table's memory in large pages, where it has them: single
 * ones take longer to come than to fill. */
static void use_large_pages(const struct table *table)
{
	uintptr_t begin = (uintptr_t)table->first;
	uintptr_t end = begin + table_bytes(table);

	begin = (begin + LARGE_PAGE - 1) & ~(LARGE_PAGE - 1);
	end &= ~(LARGE_PAGE - 1);
	if (begin < end)
		madvise((void *)begin, end - begin, MADV_HUGEPAGE);
}

static enum err read_table(struct cache_file *file, struct table *table)
{
	enum err err;

	if (file->size != table_bytes(table)) {
		cache_file_close(file);
		return ERR_INVALID;
	}
	err = cache_file_read(file, table->first);
	if (err == ERR_OK && !table_verify(table, VERIFY_NODES))
		err = ERR_INVALID;
	return err;
}

static enum err load_table(const struct table_cache *c,
    const struct operator *op, const struct cache_key *key,
    struct table **out)
{
	struct cache_file file;
	struct table *table;
	enum err err = cache_file_open(c->folder, KIND_TABLE, key, &file);

	if (err != ERR_OK)
		return err;
	err = table_create(op->family, &op->profile, op->layout,
	    op->resolution, &table);
	if (err != ERR_OK) {
		cache_file_close(&file);
		return err;
	}
	use_large_pages(table);
	err = read_table(&file, table);
	if (err != ERR_OK) {
		table_free(table);
		return err;
	}
	*out = table;
	return ERR_OK;
}

enum err table_cache_load(struct table_cache *c, const struct operator *op,
    struct table **out, struct table_figures *figures)
{
	struct cache_key key;
	enum err err;

	make_key(&key, op);
	err = load_table(c, op, &key, out);
	if (err == ERR_OK) {
		*figures = (struct table_figures){0};
		load_figures(c, &key, figures);
		return ERR_OK;
	}
	if (err != ERR_NOT_FOUND)
		log_write(LOG_WARNING, "a table in the cache cannot be used "
		    "and is built anew: %s", err_message(err));
	return ERR_NOT_FOUND;
}

/* ---- writing ---- */

static void write_file(struct table_cache *c, const char *kind,
    const struct cache_key *key, const void *content, size_t size)
{
	enum err err = cache_file_write(c->folder, kind, key, content, size);
	int reason = errno;

	if (err == ERR_OK || atomic_exchange(&c->has_failed, true))
		return;
	log_write(LOG_WARNING, "cannot write to the cache %s: %s", c->folder,
	    err == ERR_IO ? strerror(reason) : err_message(err));
}

static void write_figures(struct table_cache *c, const struct cache_key *key,
    const struct table_figures *figures)
{
	struct stored_figures stored;

	memset(&stored, 0, sizeof stored);
	stored.build_seconds = figures->build_seconds;
	stored.is_measured = figures->is_measured;
	if (figures->is_measured)
		stored.error = figures->error;
	write_file(c, KIND_FIGURES, key, &stored, sizeof stored);
}

void table_cache_store(struct table_cache *c, const struct table *table,
    const struct table_figures *figures)
{
	const struct operator op = {.family = table->family,
	    .profile = table->profile, .layout = table->layout,
	    .resolution = table->resolution};
	struct cache_key key;

	/* Larger than all there may be: it would only push the others out. */
	if (c->is_read_only || table_bytes(table) > c->most)
		return;
	make_key(&key, &op);
	write_file(c, KIND_TABLE, &key, table->first, table_bytes(table));
	write_figures(c, &key, figures);
	cache_trim(c->folder, c->most);
}

void table_cache_store_figures(struct table_cache *c,
    const struct operator *op, const struct table_figures *figures)
{
	struct cache_key key;

	if (c->is_read_only)
		return;
	make_key(&key, op);
	write_figures(c, &key, figures);
}

void table_cache_touch(struct table_cache *c, const struct operator *op)
{
	struct cache_key key;

	if (c->is_read_only)
		return;
	make_key(&key, op);
	cache_file_touch(c->folder, KIND_TABLE, &key);
	cache_file_touch(c->folder, KIND_FIGURES, &key);
}
