/*
 * Bodies of mesh requests: whatever is accepted is within its ranges; whatever
 * is refused says why, in clean text.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/mesh.h"
#include "core/tree.h"
#include "proto/fault.h"
#include "proto/mesh_request.h"
#include "proto/text.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

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
	for (size_t i = 0; i < faults->count && i < FAULT_MAX; i++) {
		check_text(faults->list[i].pointer, FAULT_POINTER_MAX);
		check_text(faults->list[i].detail, FAULT_DETAIL_MAX);
		demand(faults->list[i].detail[0] != '\0');
	}
}

static void check_axis(double min, double max)
{
	demand(fabs(min) <= TREE_COORDINATE_MAX);
	demand(fabs(max) <= TREE_COORDINATE_MAX);
	demand(min < max);
}

static void check_request(const struct mesh_request *r)
{
	if (r->has_bounds) {
		check_axis(r->min.x, r->max.x);
		check_axis(r->min.y, r->max.y);
		check_axis(r->min.z, r->max.z);
	}
	if (r->resolution == 0)
		demand(r->edge_length >= TREE_LENGTH_MIN &&
		    r->edge_length <= TREE_LENGTH_MAX);
	else
		demand(r->resolution >= 2 && r->resolution <= MESH_CELLS_MAX);
	demand(r->iso >= 1e-3 && r->iso <= 1e3);
	demand(!r->has_format || ((MESH_FILES | 1u << MEDIA_JSON) >> r->format & 1));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct mesh_request request;
	struct faults faults = {0};
	const enum err err = mesh_request_parse((const char *)data, size,
	    &request, &faults);

	demand((err == ERR_OK) == (faults.count == 0));
	check_faults(&faults);
	if (err == ERR_OK)
		check_request(&request);
	else
		demand(err == ERR_SYNTAX || err == ERR_INVALID ||
		    err == ERR_LIMIT);
	return 0;
}
