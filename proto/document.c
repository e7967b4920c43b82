#include "proto/document.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/tape.h"
#include "core/volume.h"
#include "proto/document_reader.h"
#include "proto/fault.h"

#define FORMAT "blobfield/1"
#define NAME_BYTES_MAX 256
/* Smaller, and its square over a length's square leaves float32. */
#define NULL_GRADIENT_MIN 1e-6

/* JSON values that a node may take on average (with an id, a matrix and an
 * operator of its own 40), and those for all else: 256 operators of 64 samples
 * each have 60,000. */
#define VALUES_PER_NODE 64
#define VALUES_BESIDE 65536

struct document {
	struct arena arena;
	const char *name;
	struct tree tree;
	struct tape *tape;
	struct volume_list *volumes; /* each held */
	bool has_operators;
};

/* What the top level is read into. */
struct draft {
	struct document *document;
	double null_gradient;
	const cJSON *operators, *root;
};

static void read_format(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	(void)field;
	(void)base;
	if (!cJSON_IsString(value) || strcmp(value->valuestring, FORMAT) != 0)
		reader_fault(r, at, "must be \"%s\"", FORMAT);
}

static void read_name(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	(void)field;
	if (!cJSON_IsString(value)) {
		reader_fault(r, at, "must be a string, not %s",
		    json_kind(value));
		return;
	}
	if (strlen(value->valuestring) > NAME_BYTES_MAX) {
		reader_fault(r, at, "must have at most %d bytes",
		    NAME_BYTES_MAX);
		return;
	}
	draft->document->name = arena_string(r->arena, value->valuestring);
	if (!draft->document->name)
		r->err = ERR_MEMORY;
}

static const struct field document_fields[] = {
	{.name = "format", .read = read_format, .required = true},
	{.name = "name", .read = read_name},
	{.name = "null_gradient", .read = field_number,
	    .offset = offsetof(struct draft, null_gradient),
	    .least = NULL_GRADIENT_MIN, .most = 1.0, .has_fallback = true,
	    .fallback = TREE_NULL_GRADIENT},
	{.name = "operators", .read = field_keep,
	    .offset = offsetof(struct draft, operators)},
	{.name = "root", .read = field_keep,
	    .offset = offsetof(struct draft, root), .required = true},
};

static void read_document(struct reader *r, const struct json_place *at,
    const struct cJSON *json, struct document *document)
{
	static const struct field_set set = FIELD_SET(document_fields);
	const struct json_place operators = json_member(at, "operators");
	const struct json_place root = json_member(at, "root");
	struct draft draft = {.document = document};

	if (!cJSON_IsObject(json)) {
		reader_fault(r, at, "a document must be an object, not %s",
		    json_kind(json));
		return;
	}
	field_read_object(r, at, json, &set, 1, &draft);
	document->tree.null_gradient = draft.null_gradient;
	if (reader_goes_on(r))
		operator_read_all(r, &operators, draft.operators);
	document->has_operators = r->operator_count > 0;
	if (reader_goes_on(r) && draft.root)
		document->tree.root = node_read(r, &root, draft.root, NULL, 0);
	if (reader_goes_on(r))
		ref_resolve(r, &root);
}

static void compile(struct reader *r, const struct json_place *at,
    struct document *document)
{
	const struct json_place root = json_member(at, "root");
	struct tape_error error = {0};
	enum err err;

	err = tape_compile(&document->tree, r->limits->max_nodes,
	    &document->tape, &error);
	if (err == ERR_INVALID || err == ERR_LIMIT)
		ref_fault(r, &root, error.node, NULL, error.detail);
	r->err = err;
}

enum err document_from_json(const struct cJSON *json, const char *prefix,
    const struct document_limits *limits, struct document **out,
    struct faults *faults)
{
	const struct json_place at = json_root(prefix);
	struct document *document;
	struct reader r = {.limits = limits, .faults = faults};

	document = calloc(1, sizeof *document);
	if (!document)
		return ERR_MEMORY;
	document->name = "";
	r.arena = &document->arena;
	r.tail = &r.first;
	read_document(&r, &at, json, document);
	document->volumes = r.volumes;
	if (r.err == ERR_OK)
		compile(&r, &at, document);
	if (r.err != ERR_OK) {
		document_free(document);
		return r.err;
	}
	*out = document;
	return ERR_OK;
}

size_t document_values_max(const struct document_limits *limits)
{
	if (limits->max_nodes > (SIZE_MAX - VALUES_BESIDE) / VALUES_PER_NODE)
		return SIZE_MAX;
	return limits->max_nodes * VALUES_PER_NODE + VALUES_BESIDE;
}

enum err document_parse(const char *text, size_t length,
    const struct document_limits *limits, struct document **out,
    struct faults *faults)
{
	const struct json_place root = json_root("");
	struct arena arena = {0};
	cJSON *json;
	enum err err;

	if (limits->max_bytes > 0 && length > limits->max_bytes) {
		json_fault(faults, &root, "the document has %zu bytes; %zu "
		    "are the most", length, limits->max_bytes);
		return ERR_LIMIT;
	}
	err = json_parse(text, length, document_values_max(limits), &arena,
	    &json, faults);
	if (!err)
		err = document_from_json(json, "", limits, out, faults);
	arena_fini(&arena);
	return err;
}

void document_free(struct document *d)
{
	if (!d)
		return;
	tape_free(d->tape);
	for (const struct volume_list *v = d->volumes; v; v = v->next)
		volume_release(v->volume);
	arena_fini(&d->arena);
	free(d);
}

const char *document_name(const struct document *d)
{
	return d->name;
}

const struct tree *document_tree(const struct document *d)
{
	return &d->tree;
}

bool document_has_operators(const struct document *d)
{
	return d->has_operators;
}

const struct tape *document_tape(const struct document *d)
{
	return d->tape;
}

struct tape *document_take_tape(struct document *d)
{
	struct tape *tape = d->tape;

	d->tape = NULL;
	return tape;
}
