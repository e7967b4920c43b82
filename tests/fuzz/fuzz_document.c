/*
 * Documents: whatever is accepted evaluates to finite numbers; whatever is
 * refused says why, in clean text.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/evaluate.h"
#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "proto/text.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const struct document_limits limits = {.max_nodes = 64,
    .layout = LAYOUT_WARPED};

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

static void check_jet(const struct tape *tape, struct vec3 p)
{
	struct jet jet;

	evaluate(tape, p, 2, &jet);
	demand(isfinite(jet.value) && jet.value >= 0.0);
	demand(isfinite(jet.gradient.x) && isfinite(jet.gradient.y) &&
	    isfinite(jet.gradient.z));
	demand(isfinite(jet.hessian.xx) && isfinite(jet.hessian.yy) &&
	    isfinite(jet.hessian.zz) && isfinite(jet.hessian.xy) &&
	    isfinite(jet.hessian.xz) && isfinite(jet.hessian.yz));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct faults faults = {0};
	struct document *document = NULL;
	const struct tape *tape;
	enum err err;

	err = document_parse((const char *)data, size, &limits, &document,
	    &faults);
	demand((err == ERR_OK) == (faults.count == 0));
	check_faults(&faults);
	if (err != ERR_OK) {
		demand(err == ERR_SYNTAX || err == ERR_INVALID ||
		    err == ERR_LIMIT);
		return 0;
	}
	tape = document_tape(document);
	demand(tape->node_count >= 1 && tape->node_count <= 64);
	check_jet(tape, vec3(0.0, 0.0, 0.0));
	check_jet(tape, vec3(0.3, -0.2, 0.9));
	check_jet(tape, vec3(1.0, 0.0, 0.0));
	check_jet(tape, vec3(3e38, -3e38, 1e-30));
	document_free(document);
	return 0;
}
