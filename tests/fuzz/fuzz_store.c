/*
 * A file of scenes that is damaged: opening it, reading it and changing it ends
 * with an error, or gives scenes whose texts are what their tags say.
 *
 * The input is what is done to a sound file, or (odd first byte) to its log:
 * three bytes an edit, an offset and what is put there; the second and third
 * byte, if not 0, cut the file.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/backing.h"
#include "server/etag.h"
#include "server/log.h"

#define FILE_MOST ((size_t)256 << 10)
#define SCENES 3

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void demand(int fine)
{
	if (!fine)
		abort();
}

void log_write(enum log_level level, const char *format, ...)
{
	(void)level, (void)format;
}

/* ---- files ---- */

struct image {
	uint8_t bytes[FILE_MOST];
	size_t length;
};

static char folder[64];
static struct image sound, sound_log; /* with and without what the log has */

static void path_of(const char *name, char out[static 128])
{
	snprintf(out, 128, "%s/%s", folder, name);
}

static void read_image(const char *name, struct image *image)
{
	char path[128];
	FILE *file;

	path_of(name, path);
	file = fopen(path, "rb");
	demand(file != NULL);
	image->length = fread(image->bytes, 1, FILE_MOST, file);
	fclose(file);
	demand(image->length > 0 && image->length < FILE_MOST);
}

static void write_image(const char *name, const struct image *image)
{
	char path[128];
	FILE *file;

	path_of(name, path);
	file = fopen(path, "wb");
	demand(file != NULL && fwrite(image->bytes, 1, image->length, file) ==
	    image->length);
	fclose(file);
}

static void clear(void)
{
	static const char *const names[] = {"scenes.sqlite",
	    "scenes.sqlite-wal", "scenes.sqlite-shm", "lock"};
	char path[128];

	for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
		path_of(names[i], path);
		unlink(path);
	}
}

static void remove_folder(void)
{
	clear();
	rmdir(folder);
}

/* ---- who is told ---- */

static void check_text(const struct backing_revision *r)
{
	char etag[ETAG_SIZE];

	etag_of(r->text, r->length, etag);
	demand(strcmp(etag, r->etag) == 0);
}

static enum err on_revision(void *ctx, const struct backing_revision *r)
{
	size_t *count = ctx;

	demand(r->id != NULL && r->owner != NULL && r->etag != NULL);
	demand(strlen(r->id) + strlen(r->owner) + strlen(r->etag) < FILE_MOST);
	if (r->text != NULL && r->text[0] != '\0')
		check_text(r);
	++*count;
	return ERR_OK;
}

static enum err on_volume(void *ctx, const struct backing_volume *v)
{
	size_t *count = ctx;
	char *copy = malloc(v->length + 1);

	demand(v->id != NULL && copy != NULL);
	memcpy(copy, v->data, v->length);
	free(copy);
	++*count;
	return ERR_OK;
}

static void on_guard(void *ctx, bool is_begun)
{
	(void)ctx, (void)is_begun;
}

static void on_lost(void *ctx)
{
	(void)ctx;
}

static enum err open_it(struct backing **out)
{
	const struct backing_options options = {.history = 2,
	    .guard = on_guard, .lost = on_lost};

	return backing_open_sqlite(folder, &options, out);
}

/* ---- a sound file ---- */

static enum err put(struct backing *b, const char *id, const char *text)
{
	char etag[ETAG_SIZE];
	struct backing_write w = {.revision = {.id = id, .etag = etag,
	    .text = text, .length = text != NULL ? strlen(text) : 0,
	    .owner = "me", .nodes = 3}, .is_any = true};

	etag_of(text != NULL ? text : "", w.revision.length, etag);
	return b->ops->commit(b, &w, 1);
}

static void make_sound(void)
{
	static char volume[9000];
	const struct backing_volume v = {.id = "0123456789abcdef",
	    .data = volume, .length = sizeof volume};
	struct backing *b;
	char id[16], text[6000];

	demand(open_it(&b) == ERR_OK);
	for (int i = 0; i < 2 * SCENES; i++) {
		snprintf(id, sizeof id, "scene-%d", i % SCENES);
		memset(text, 'a' + i, sizeof text - 1);
		text[i % SCENES == 0 ? sizeof text - 1 : 40] = '\0';
		demand(put(b, id, text) == ERR_OK);
	}
	demand(b->ops->put_volume(b, &v) == ERR_OK);
	b->ops->free(b);
	read_image("scenes.sqlite", &sound);
	demand(open_it(&b) == ERR_OK);
	demand(put(b, "scene-0", "{\"later\":1}") == ERR_OK);
	demand(put(b, "scene-1", NULL) == ERR_OK);
	read_image("scenes.sqlite-wal", &sound_log);
	b->ops->free(b);
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
	(void)argc, (void)argv;
	strcpy(folder, access("/dev/shm", W_OK) == 0 ?
	    "/dev/shm/fuzz_store.XXXXXX" : "/tmp/fuzz_store.XXXXXX");
	demand(mkdtemp(folder) != NULL);
	atexit(remove_folder);
	make_sound();
	return 0;
}

/* ---- damage ---- */

static void damage(const struct image *from, const uint8_t *edits,
    size_t size, struct image *out)
{
	size_t cut = (size_t)edits[0] << 8 | edits[1];

	out->length = from->length;
	memcpy(out->bytes, from->bytes, from->length);
	if (cut > 0 && cut < out->length)
		out->length = cut;
	for (size_t i = 2; i + 3 <= size; i += 3) {
		size_t at = (size_t)edits[i] << 8 | edits[i + 1];

		out->bytes[at % out->length] = edits[i + 2];
	}
}

/* All that the store would do. */
static void use(struct backing *b)
{
	size_t count = 0;
	const struct backing_reader reader = {on_revision, on_volume, &count};
	char id[16];

	if (b->ops->load(b, &reader) != ERR_OK)
		return;
	for (int i = 0; i < SCENES; i++) {
		snprintf(id, sizeof id, "scene-%d", i);
		b->ops->read(b, id, "\"0123456789abcdef0123456789abcdef\"",
		    &reader);
	}
	put(b, "scene-1", "{}");
	put(b, "scene-2", NULL);
	b->ops->forget_volume(b, "0123456789abcdef", true);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	static struct image damaged;
	bool is_log = size > 0 && data[0] & 1;
	struct backing *b;

	if (size < 3)
		return 0;
	clear();
	damage(is_log ? &sound_log : &sound, data + 1, size - 1, &damaged);
	if (is_log) {
		write_image("scenes.sqlite", &sound);
		write_image("scenes.sqlite-wal", &damaged);
	} else {
		write_image("scenes.sqlite", &damaged);
	}
	if (open_it(&b) != ERR_OK)
		return 0;
	use(b);
	b->ops->free(b);
	return 0;
}
