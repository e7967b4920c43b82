/*
 * Imports: whatever is accepted is a document within the same limits, which
 * evaluates to finite numbers, in an answer that is JSON; whatever is refused
 * says why, in clean text.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/evaluate.h"
#include "proto/document.h"
#include "proto/import.h"
#include "proto/json.h"
#include "proto/text.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const struct document_limits limits = {
	.max_nodes = 64,
	.layout = LAYOUT_WARPED,
};

static void demand(int fine)
{
	if (!fine)
		abort();
}

static void check_text(const char *text, size_t size)
{
	const char *end = text + strnlen(text, size);
	size_t n;

	demand(end < text + size);
	for (; text < end; text += n) {
		n = text_sequence(text, end);
		demand(n > 0 && (n > 1 || *text >= 0x20));
	}
}

static void check_faults(const struct faults *faults)
{
	size_t i;

	for (i = 0; i < faults->count && i < FAULT_MAX; i++) {
		check_text(faults->list[i].pointer, FAULT_POINTER_MAX);
		check_text(faults->list[i].detail, FAULT_DETAIL_MAX);
		demand(faults->list[i].detail[0] != '\0');
	}
}

static void check_document(const struct imported *imported)
{
	const struct vec3 points[] = {{0.0, 0.0, 0.0}, {0.3, -0.2, 0.9},
	    {3e38, -3e38, 1e-30}};
	struct document *document;
	struct faults faults = {0};
	struct jet jet;

	demand(document_parse(imported->document, imported->length, &limits,
	    &document, &faults) == ERR_OK);
	for (int i = 0; i < 3; i++) {
		evaluate(document_tape(document), points[i], 1, &jet);
		demand(isfinite(jet.value) && jet.value >= 0.0);
		demand(isfinite(vec3_norm(jet.gradient)));
	}
	document_free(document);
}

static void check_answer(const struct imported *imported)
{
	const struct json_place root = json_root("");
	struct faults faults = {0};
	struct json_text json;
	char *text;
	size_t length;

	demand(import_answer(imported, &text, &length) == ERR_OK);
	json = json_text(text, length, SIZE_MAX, NULL);
	demand(json_skip(&json, &root, &faults) == ERR_OK);
	demand(json_finish(&json, &faults) == ERR_OK);
	free(text);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct imported imported;
	struct faults faults = {0};
	enum err err;

	err = import_blobtree((const char *)data, size, &limits, &imported,
	    &faults);
	demand((err == ERR_OK) == (faults.count == 0));
	check_faults(&faults);
	if (err != ERR_OK) {
		demand(err == ERR_SYNTAX || err == ERR_INVALID ||
		    err == ERR_LIMIT);
		return 0;
	}
	check_faults(&imported.warnings);
	check_document(&imported);
	check_answer(&imported);
	import_fini(&imported);
	return 0;
}
