/*
 * Bodies of evaluations, Content-Type, Accept and lists of outputs, by the
 * first byte.
 */
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/output.h"
#include "proto/answer.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "proto/request.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const struct document_limits limits = {.max_nodes = 64,
    .layout = LAYOUT_WARPED};

static void demand(int fine)
{
	if (!fine)
		abort();
}

static void check_problem(const struct faults *faults)
{
	size_t length;
	char *text = answer_problem(422, "slug", "title", "detail", faults,
	    &length);

	demand(text && strlen(text) == length);
	free(text);
}

static void try_body(const char *data, size_t size, bool with_scene)
{
	struct eval_request request = {0};
	struct faults faults = {0};
	enum err err;

	err = eval_request_parse(data, size, with_scene, OUTPUT_VALUE, &limits,
	    100, &request, &faults);
	demand((err == ERR_OK) == (faults.count == 0));
	if (err == ERR_OK) {
		demand(request.outputs != 0 && request.outputs <= OUTPUT_ALL);
		demand((request.document != NULL) == with_scene);
	} else {
		demand(!request.document && !request.points.xyz);
		check_problem(&faults);
	}
	eval_request_fini(&request);
}

static void try_header(const char *text)
{
	struct faults faults = {0};
	enum media_type type = MEDIA_COUNT;
	unsigned outputs;

	if (media_from_content_type(text, &type))
		demand(type < MEDIA_PROBLEM);
	type = MEDIA_COUNT;
	if (media_from_accept(text, &type))
		demand(type < MEDIA_PROBLEM);
	if (outputs_from_list(text, "/outputs", &outputs, &faults) == ERR_OK)
		demand(outputs != 0 && outputs <= OUTPUT_ALL);
	else
		demand(faults.count > 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	char *text;

	if (size == 0)
		return 0;
	if (data[0] % 4 < 3) {
		try_body((const char *)data + 1, size - 1, data[0] % 4 > 0);
		return 0;
	}
	text = malloc(size);
	demand(text != NULL);
	memcpy(text, data + 1, size - 1);
	text[size - 1] = '\0';
	try_header(text);
	free(text);
	return 0;
}
