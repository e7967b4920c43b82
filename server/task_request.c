#include "server/task_request.h"

#include <stdio.h>
#include <string.h>

#include "proto/answer.h"
#include "proto/geometry_request.h"
#include "server/exchange.h"
#include "server/scene_refresh.h"
#include "server/scene_reply.h"

struct scene *task_request_scene(struct exchange *x)
{
	struct precondition precondition;

	return scene_reply_preconditions(x, &precondition) ?
	    scene_refresh_get(x, &precondition) : NULL;
}

bool task_request_accept(struct exchange *x, unsigned mask,
    enum media_type first, enum media_type *out)
{
	const char *accept = exchange_header(x, "Accept");
	char known[200] = "";

	if (media_choose(accept, mask, first, out))
		return true;
	for (int i = 0; i < MEDIA_COUNT; i++) {
		const size_t length = strlen(known);

		if (mask >> i & 1)
			snprintf(known + length, sizeof known - length, "%s%s",
			    length > 0 ? ", " : "",
			    media_name((enum media_type)i));
	}
	exchange_reply_problem(x, PROBLEM_NOT_ACCEPTABLE, NULL,
	    "Accept is '%.100s'; this resource answers %s.", accept, known);
	return false;
}

enum media_type task_request_file(struct exchange *x, unsigned mask,
    enum media_type first)
{
	enum media_type type;

	return media_choose(exchange_header(x, "Accept"), mask, first,
	    &type) ? type : first;
}

enum err task_request_terms(struct exchange *x, struct geometry_terms *out,
    struct faults *faults)
{
	*out = geometry_defaults();
	return geometry_query(exchange_query(x, "iso"),
	    exchange_query(x, "max_distance"), exchange_query(x, "tolerance"),
	    out, faults) ? ERR_OK : ERR_INVALID;
}

void task_reply_rows(struct exchange *x, enum media_type type, float **rows,
    size_t count, int columns)
{
	const size_t length = count * (size_t)columns * sizeof **rows;
	char header[ANSWER_NPY_HEADER_MAX];
	size_t header_length;

	if (type == MEDIA_NPY) {
		header_length = answer_npy_header(count, columns, header);
		exchange_reply_two(x, MEDIA_NPY, header, header_length, *rows,
		    length);
	} else {
		exchange_reply_data(x, 200, MEDIA_OCTETS, *rows, length);
	}
	*rows = NULL;
}
