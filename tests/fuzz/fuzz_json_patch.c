/*
 * Patches: whatever is accepted gives JSON within its bounds, the same each
 * time, and a merge patch applied twice changes nothing more; whatever is
 * refused says at which place. The first byte says what kind it is; text and
 * patch follow, parted by a NUL.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "proto/arena.h"
#include "proto/fault.h"
#include "proto/json.h"
#include "proto/json_patch.h"

#define VALUES_MOST 2000
#define BYTES_MOST 20000

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void demand(int fine)
{
	if (!fine)
		abort();
}

struct result {
	enum err err;
	char *text;
	size_t length;
};

static struct result apply(const struct json_patch *patch, const char *text,
    size_t length)
{
	struct faults faults = {0};
	struct result r = {ERR_OK, NULL, 0};

	r.err = json_patch_text(patch, text, length, &r.text, &r.length,
	    &faults);
	demand((r.err == ERR_OK) == (r.text != NULL));
	demand((r.err == ERR_OK) == (faults.count == 0));
	return r;
}

/* A result is JSON, and not too much of it. */
static void check_json(const struct result *r)
{
	struct arena arena = {0};
	struct faults faults = {0};
	struct cJSON *json;

	demand(r->length <= BYTES_MOST);
	demand(json_parse(r->text, r->length, VALUES_MOST, &arena, &json,
	    &faults) == ERR_OK);
	arena_fini(&arena);
}

static bool is_same(const struct result *a, const char *text, size_t length)
{
	return a->length == length && memcmp(a->text, text, length) == 0;
}

static void check(const struct json_patch *patch, const char *text,
    size_t length)
{
	struct result r = apply(patch, text, length), again;

	if (r.err != ERR_OK)
		return;
	check_json(&r);
	again = apply(patch, text, length);
	demand(again.err == ERR_OK && is_same(&again, r.text, r.length));
	free(again.text);
	if (patch->is_merge) {
		again = apply(patch, r.text, r.length);
		demand(again.err == ERR_OK);
		demand(is_same(&again, r.text, r.length));
		free(again.text);
	}
	free(r.text);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct json_patch patch = {.values_most = VALUES_MOST,
	    .bytes_most = BYTES_MOST};
	struct arena arena = {0};
	struct faults faults = {0};
	const char *text = (const char *)data + 1, *middle;
	struct cJSON *json;
	size_t length;

	if (size < 2)
		return 0;
	middle = memchr(text, '\0', size - 1);
	if (middle == NULL)
		return 0;
	length = size - 2 - (size_t)(middle - text);
	if (json_patch_read(middle + 1, length, VALUES_MOST, &arena, &json,
	    &faults) == ERR_OK) {
		patch.patch = json;
		patch.is_merge = data[0] & 1;
		check(&patch, text, (size_t)(middle - text));
	} else {
		demand(faults.count > 0);
	}
	arena_fini(&arena);
	return 0;
}
