#include "proto/order.h"

#include <string.h>

#include <cjson/cJSON.h>

#include "proto/document_reader.h"
#include "proto/fault.h"

/* A samples profile has 64 points at most. */
#define VALUES_MAX 1024

/* What an order's members are read into. */
struct draft {
	struct order *order;
	const cJSON *profile, *layout, *resolution, *max_error;
};

static void read_family(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	(void)field;
	for (int i = 0; i < FAMILY_COUNT; i++) {
		const enum operator_family family = (enum operator_family)i;

		if (cJSON_IsString(value) && strcmp(value->valuestring,
		    operator_family_name(family)) == 0) {
			draft->order->op.family = family;
			return;
		}
	}
	reader_fault(r, at, "must be \"union\" or \"intersection\"");
}

static const struct field order_fields[] = {
	{.name = "profile", .read = field_keep,
	    .offset = offsetof(struct draft, profile)},
	{.name = "layout", .read = field_keep,
	    .offset = offsetof(struct draft, layout)},
	{.name = "family", .read = read_family},
	{.name = "resolution", .read = field_keep,
	    .offset = offsetof(struct draft, resolution)},
	{.name = "max_error", .read = field_keep,
	    .offset = offsetof(struct draft, max_error)},
};

static void read_max_error(struct reader *r, const struct json_place *at,
    const struct draft *draft)
{
	const struct json_place place = json_member(at, "max_error");

	if (draft->resolution)
		reader_fault(r, &place, "excludes \"resolution\", which it "
		    "is to find");
	else if (field_is_number(r, &place, draft->max_error,
	    ORDER_ERROR_MIN, 1.0))
		draft->order->max_error = draft->max_error->valuedouble;
}

/*
 * The members that a document's operator has, too, are read as there: as an
 * object of copies of them.
 */
static void read_operator(struct reader *r, const struct json_place *at,
    const struct draft *draft)
{
	const cJSON *members[] = {draft->profile, draft->layout,
	    draft->resolution};
	cJSON copies[sizeof members / sizeof *members];
	cJSON object = {.type = cJSON_Object}, *last = NULL;
	const enum operator_family family = draft->order->op.family;
	struct chosen chosen;

	for (size_t i = 0; i < sizeof members / sizeof *members; i++) {
		if (!members[i])
			continue;
		copies[i] = *members[i];
		copies[i].next = NULL;
		copies[i].prev = last;
		*(last ? &last->next : &object.child) = &copies[i];
		last = &copies[i];
	}
	if (!operator_read(r, at, &object, NODE_UNION, &chosen))
		return;
	draft->order->op = *chosen.op;
	draft->order->op.family = family;
}

static void read_order(struct reader *r, const struct cJSON *json,
    struct order *order)
{
	static const struct field_set set = FIELD_SET(order_fields);
	const struct json_place at = json_root("");
	struct draft draft = {.order = order};

	if (!cJSON_IsObject(json)) {
		reader_fault(r, &at, "an order must be an object, not %s",
		    json_kind(json));
		return;
	}
	field_read_object(r, &at, json, &set, 1, &draft);
	if (reader_goes_on(r))
		read_operator(r, &at, &draft);
	if (reader_goes_on(r) && draft.max_error) {
		read_max_error(r, &at, &draft);
		order->op.resolution = 0;
	}
}

enum err order_parse(const char *text, size_t length,
    enum table_layout layout, struct order *out, struct faults *faults)
{
	const struct document_limits limits = {.max_nodes = 1,
	    .layout = layout};
	struct order order = {.max_error = 0.0};
	struct arena arena = {0};
	struct reader r = {.arena = &arena, .limits = &limits,
	    .faults = faults};
	cJSON *json;

	r.tail = &r.first;
	r.err = json_parse(text, length, VALUES_MAX, &arena, &json, faults);
	if (r.err == ERR_OK)
		read_order(&r, json, &order);
	arena_fini(&arena);
	if (r.err == ERR_OK)
		*out = order;
	return r.err;
}
