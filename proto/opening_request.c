#include "proto/opening_request.h"

#include <math.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "proto/document_reader.h"
#include "proto/fault.h"

/* The most JSON values of a body, of what does not belong, too. */
#define VALUES_MAX 256

/* The largest index of a child that is read: indices above are no children of
 * any node. */
#define INDEX_MAX 0x7fffffff

/* What the body is read into. */
struct draft {
	struct opening_request request;
	const char *node;
	double children[2];
};

static void read_children(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;
	struct json_place place = json_element(at, 0);

	if (!field_numbers(r, at, value, 2, field->least, field->most,
	    draft->children))
		return;
	draft->request.has_children = true;
	for (; place.index < 2; place.index++) {
		const double index = draft->children[place.index];

		if (index != floor(index))
			reader_fault(r, &place, "must be a whole number");
		draft->request.children[place.index] = (size_t)index;
	}
	if (draft->children[0] == draft->children[1])
		reader_fault(r, at, "must be two different children");
}

static const struct field fields[] = {
	{.name = "node", .read = field_id,
	    .offset = offsetof(struct draft, node), .required = true},
	{.name = "point", .read = field_vec3,
	    .offset = offsetof(struct draft, request.point), .required = true,
	    .least = -TREE_COORDINATE_MAX, .most = TREE_COORDINATE_MAX},
	{.name = "children", .read = read_children, .most = INDEX_MAX},
};

static void read_body(struct reader *r, const cJSON *json,
    struct opening_request *out)
{
	static const struct field_set set = FIELD_SET(fields);
	const struct json_place at = json_root("");
	struct draft draft = {.node = NULL};

	if (!cJSON_IsObject(json)) {
		reader_fault(r, &at, "must be an object, not %s",
		    json_kind(json));
		return;
	}
	field_read_object(r, &at, json, &set, 1, &draft);
	if (r->err != ERR_OK)
		return;
	*out = draft.request;
	strcpy(out->node, draft.node);
}

enum err opening_request_parse(const char *text, size_t length,
    struct opening_request *out, struct faults *faults)
{
	struct arena arena = {0};
	struct reader r = {.arena = &arena, .faults = faults};
	cJSON *json;

	r.err = json_parse(text, length, VALUES_MAX, &arena, &json, faults);
	if (r.err == ERR_OK)
		read_body(&r, json, out);
	arena_fini(&arena);
	return r.err;
}
