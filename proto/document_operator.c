#include <math.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/classic.h"
#include "core/table.h"
#include "proto/document_reader.h"
#include "proto/fault.h"
#include "proto/text.h"

#define PI 3.14159265358979323846
#define THETA_MAX (PI / 4.0)
/* pi/4 and pi rounded up to 3 or 4 decimals are still meant as such. */
#define ANGLE_TOLERANCE 1e-3
#define BULGE_DEFAULT 0.8
#define LINES_DEFAULT (PI / 8.0)
/*
 * Steeper, and the device's samples cannot follow the opening: values are off
 * by 6e-4 with intervals of 0.01 radians, by 9e-3 with 0.003.
 */
#define OPENING_W_MIN 0.05
#define OPENING_W_MAX 20.0
#define OPENING_INTERVAL_MIN 0.01

static const struct opening clean = {
	{0.0, PI / 2.0, PI}, {THETA_MAX, THETA_MAX, THETA_MAX}, {1.0, 1.0}};

/* What an operator's members are read into. */
struct draft {
	struct classic classic;
	struct operator *op;
	double k;
	double alpha[3], theta[3], w[2];
};

static void read_samples(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	const struct json_place points = json_member(at, "points");
	struct json_place point = json_element(&points, 0);
	const cJSON *value = cJSON_GetObjectItemCaseSensitive(object, "points");
	struct draft *draft = base;
	double xy[PROFILE_SAMPLES_MAX][2];
	const cJSON *element;
	const char *why;
	int count, index;
	bool fine = true;

	(void)seen;
	if (!value)
		return;
	count = cJSON_GetArraySize(value);
	if (!cJSON_IsArray(value) || count < 3 || count > PROFILE_SAMPLES_MAX) {
		reader_fault(r, &points, "must be an array of 3 to %d points",
		    PROFILE_SAMPLES_MAX);
		return;
	}
	cJSON_ArrayForEach(element, value) {
		fine = field_numbers(r, &point, element, 2, -2.0, 2.0,
		    xy[point.index]) && fine;
		point.index++;
	}
	if (fine && profile_from_samples((const double (*)[2])xy, count,
	    &draft->op->profile, &why, &index) != ERR_OK) {
		point.index = (size_t)index;
		reader_fault(r, &point, "%s", why);
	}
}

static void make_bulge(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct draft *draft = base;

	(void)r;
	(void)at;
	(void)object;
	(void)seen;
	draft->op->profile = profile_bulge(draft->k);
}

static const struct field type_only[] = {
	{.name = "type"},
};

static const struct field bulge_fields[] = {
	{.name = "type"},
	{.name = "k", .read = field_number, .offset = offsetof(struct draft, k),
	    .has_fallback = true, .most = 1.0, .fallback = BULGE_DEFAULT},
};

static const struct field samples_fields[] = {
	{.name = "type"},
	{.name = "points", .required = true},
};

static const struct variant profiles[] = {
	{.name = "smooth", .fields = FIELD_SET(type_only), .tag = PROFILE_SMOOTH},
	{.name = "bulge", .fields = FIELD_SET(bulge_fields),
	    .tag = PROFILE_BULGE, .check = make_bulge},
	{.name = "circle", .fields = FIELD_SET(type_only), .tag = PROFILE_CIRCLE},
	{.name = "samples", .fields = FIELD_SET(samples_fields),
	    .tag = PROFILE_SAMPLES, .check = read_samples},
};

#define PROFILE_COUNT (sizeof profiles / sizeof *profiles)

static void read_profile_name(struct reader *r, const struct json_place *at,
    const char *name, struct draft *draft)
{
	if (strcmp(name, "smooth") == 0)
		draft->op->profile = profile_smooth();
	else if (strcmp(name, "circle") == 0)
		draft->op->profile = profile_circle();
	else if (strcmp(name, "bulge") == 0)
		draft->op->profile = profile_bulge(BULGE_DEFAULT);
	else
		reader_fault(r, at, "unknown profile '%.64s': \"smooth\", "
		    "\"bulge\", \"circle\", or an object", name);
}

static void read_profile(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	const struct variant *variant;
	struct draft *draft = base;
	unsigned seen;

	(void)field;
	if (cJSON_IsString(value)) {
		read_profile_name(r, at, value->valuestring, draft);
		return;
	}
	variant = field_variant(r, at, value, profiles, PROFILE_COUNT,
	    "profile");
	if (!variant)
		return;
	draft->op->profile = variant->tag == PROFILE_CIRCLE ?
	    profile_circle() : profile_smooth();
	seen = field_read_object(r, at, value, &variant->fields, 1, draft);
	if (variant->check)
		variant->check(r, at, value, seen, draft);
}

/* Numbers in 0..most, give or take the tolerance, drawn into that range. */
static bool read_angles(struct reader *r, const struct json_place *at,
    const struct cJSON *value, double most, double out[static 3])
{
	int i;

	if (!field_numbers(r, at, value, 3, -ANGLE_TOLERANCE,
	    most + ANGLE_TOLERANCE, out))
		return false;
	for (i = 0; i < 3; i++)
		out[i] = fmin(fmax(out[i], 0.0), most);
	return true;
}

static void read_alpha(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	(void)field;
	read_angles(r, at, value, PI, draft->alpha);
}

/* A number is theta at every angle; that needs no alpha. */
static void read_theta(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	(void)field;
	if (cJSON_IsArray(value)) {
		read_angles(r, at, value, THETA_MAX, draft->theta);
		return;
	}
	if (field_is_number(r, at, value, -ANGLE_TOLERANCE,
	    THETA_MAX + ANGLE_TOLERANCE)) {
		draft->theta[0] = fmin(fmax(value->valuedouble, 0.0),
		    THETA_MAX);
		draft->theta[1] = draft->theta[2] = draft->theta[0];
	}
}

static const struct field constant_fields[] = {
	{.name = "theta", .read = read_theta, .required = true},
};

static const struct field opening_fields[] = {
	{.name = "alpha", .read = read_alpha, .required = true},
	{.name = "theta", .read = read_theta, .required = true},
	{.name = "w", .read = field_pair, .offset = offsetof(struct draft, w),
	    .least = OPENING_W_MIN, .most = OPENING_W_MAX},
};

/* An interval is empty, a jump, or wide enough to be sampled. */
static void check_intervals(struct reader *r, const struct json_place *at,
    const double alpha[static 3])
{
	const struct json_place place = json_member(at, "alpha");

	for (int i = 1; i < 3; i++) {
		const double width = alpha[i] - alpha[i - 1];

		if (width > 0.0 && width < OPENING_INTERVAL_MIN) {
			const struct json_place number = json_element(&place,
			    (size_t)i);

			reader_fault(r, &number, "must be the angle before it or "
			    "at least %g beyond it", OPENING_INTERVAL_MIN);
		}
	}
}

static void read_opening_object(struct reader *r, const struct json_place *at,
    const struct cJSON *value, struct draft *draft)
{
	static const struct field_set constant = FIELD_SET(constant_fields);
	static const struct field_set full = FIELD_SET(opening_fields);
	const bool is_constant = cJSON_IsNumber(
	    cJSON_GetObjectItemCaseSensitive(value, "theta"));
	const struct opening rest = opening_constant(THETA_MAX);
	struct json_place place, number;
	const size_t faults = r->faults->count;
	const char *name;
	int index;

	memcpy(draft->alpha, rest.alpha, sizeof draft->alpha);
	draft->w[0] = draft->w[1] = 1.0;
	field_read_object(r, at, value, is_constant ? &constant : &full, 1,
	    draft);
	if (r->faults->count != faults || !reader_goes_on(r))
		return;
	memcpy(draft->op->opening.alpha, draft->alpha, sizeof draft->alpha);
	memcpy(draft->op->opening.theta, draft->theta, sizeof draft->theta);
	memcpy(draft->op->opening.w, draft->w, sizeof draft->w);
	if (opening_check(&draft->op->opening, &name, &index) == ERR_OK) {
		if (!is_constant)
			check_intervals(r, at, draft->alpha);
		return;
	}
	place = json_member(at, name);
	number = json_element(&place, (size_t)index);
	reader_fault(r, &number, "must keep 0 <= alpha0 <= alpha1 <= alpha2 "
	    "<= pi, 0 <= theta <= pi/4 and w > 0");
}

static void read_opening(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	(void)field;
	if (cJSON_IsObject(value)) {
		read_opening_object(r, at, value, draft);
	} else if (!cJSON_IsString(value)) {
		reader_fault(r, at, "must be an object or the name of an "
		    "opening, not %s", json_kind(value));
	} else if (!opening_named(value->valuestring, &draft->op->opening)) {
		reader_fault(r, at, "unknown opening '%.64s': \"camel\", "
		    "\"organic\", \"contact\", or an object",
		    value->valuestring);
	}
}

static void read_layout(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	(void)field;
	if (cJSON_IsString(value) && strcmp(value->valuestring, "warped") == 0)
		draft->op->layout = LAYOUT_WARPED;
	else if (cJSON_IsString(value) &&
	    strcmp(value->valuestring, "uniform") == 0)
		draft->op->layout = LAYOUT_UNIFORM;
	else
		reader_fault(r, at, "must be \"warped\" or \"uniform\"");
}

static void read_resolution(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	(void)field;
	if (!field_is_number(r, at, value, TABLE_RESOLUTION_MIN,
	    TABLE_RESOLUTION_MAX))
		return;
	draft->op->resolution = (int)value->valuedouble;
	if (draft->op->resolution != value->valuedouble)
		reader_fault(r, at, "must be a whole number");
}

static void read_draft(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;

	(void)field;
	if (cJSON_IsBool(value))
		draft->op->draft = cJSON_IsTrue(value);
	else
		reader_fault(r, at, "must be true or false, not %s",
		    json_kind(value));
}

/* One angle for both boundary lines, or one each. */
static void read_lines(struct reader *r, const struct json_place *at,
    const struct cJSON *value, const struct field *field, void *base)
{
	struct draft *draft = base;
	double *theta = draft->classic.p;
	const double most = THETA_MAX + ANGLE_TOLERANCE;

	(void)field;
	if (cJSON_IsArray(value)) {
		if (!field_numbers(r, at, value, 2, -ANGLE_TOLERANCE, most,
		    theta))
			return;
	} else if (field_is_number(r, at, value, -ANGLE_TOLERANCE, most)) {
		theta[0] = theta[1] = value->valuedouble;
	}
	theta[0] = fmin(fmax(theta[0], 0.0), THETA_MAX);
	theta[1] = fmin(fmax(theta[1], 0.0), THETA_MAX);
}

static void default_lines(struct reader *r, const struct json_place *at,
    const struct cJSON *object, unsigned seen, void *base)
{
	struct draft *draft = base;

	(void)r;
	(void)at;
	(void)seen;
	if (!cJSON_HasObjectItem(object, "theta"))
		draft->classic.p[0] = draft->classic.p[1] = LINES_DEFAULT;
}

/* A number of struct classic: core/classic.h says which and why so far. */
#define PARAMETER(name_, i, least_, most_, fallback_) \
	{.name = name_, .read = field_number, \
	    .offset = offsetof(struct draft, classic.p[i]), \
	    .has_fallback = true, .least = least_, .most = most_, \
	    .fallback = fallback_}

static const struct field gradient_fields[] = {
	{.name = "type"},
	{.name = "profile", .read = read_profile},
	{.name = "opening", .read = read_opening},
	{.name = "layout", .read = read_layout},
	{.name = "resolution", .read = read_resolution},
	{.name = "draft", .read = read_draft},
};

static const struct field super_elliptic_fields[] = {
	{.name = "type"},
	PARAMETER("r1", 0, 0.2, 1.0, 0.5),
	PARAMETER("r2", 1, 0.2, 1.0, 0.5),
	PARAMETER("t", 2, 1.0, 8.0, 2.0),
};

static const struct field r_blend_fields[] = {
	{.name = "type"},
	PARAMETER("a0", 0, -10.0, 10.0, 0.2),
	PARAMETER("a1", 1, 0.01, 100.0, 0.5),
	PARAMETER("a2", 2, 0.01, 100.0, 0.5),
};

static const struct field functional_fields[] = {
	{.name = "type"},
	PARAMETER("d", 0, 0.001, 2.0, 0.5),
};

static const struct field exponent_fields[] = {
	{.name = "type"},
	PARAMETER("n", 0, 1.0, 1000.0, 2.0),
};

static const struct field lines_fields[] = {
	{.name = "type"},
	{.name = "theta", .read = read_lines},
};

static const struct field interpolation_fields[] = {
	{.name = "type"},
	PARAMETER("h", 0, 0.0, 1.0, 0.5),
};

static const struct field power_fields[] = {
	{.name = "type"},
	PARAMETER("alpha", 0, 1.0, 100.0, 1.0),
};

/* Not a CLASSIC_*. */
#define GRADIENT (-1)

#define OPERATOR(name_, table, tag_) \
	{.name = name_, .fields = FIELD_SET(table), .tag = tag_}

/* The first, then those of core/classic.h in their order. */
static const struct variant types[] = {
	OPERATOR("gradient", gradient_fields, GRADIENT),
	OPERATOR("super-elliptic", super_elliptic_fields,
	    CLASSIC_SUPER_ELLIPTIC),
	OPERATOR("r-blend", r_blend_fields, CLASSIC_R_BLEND),
	OPERATOR("functional", functional_fields, CLASSIC_FUNCTIONAL),
	OPERATOR("r-clean", type_only, CLASSIC_R_CLEAN),
	OPERATOR("barthe-clean", type_only, CLASSIC_BARTHE_CLEAN),
	OPERATOR("ricci", exponent_fields, CLASSIC_RICCI),
	{.name = "barthe-opening", .fields = FIELD_SET(lines_fields),
	    .tag = CLASSIC_BARTHE_OPENING, .check = default_lines},
	OPERATOR("interpolation", interpolation_fields,
	    CLASSIC_INTERPOLATION),
	OPERATOR("power-difference", power_fields, CLASSIC_POWER_DIFFERENCE),
};

#define TYPE_COUNT (sizeof types / sizeof *types)

/* Layout and resolution as the limits say; no opening yet. */
static struct operator *make_operator(struct reader *r)
{
	struct operator *op = reader_alloc(r, 1, sizeof *op);

	if (!op)
		return NULL;
	op->profile = profile_smooth();
	op->layout = r->limits->layout;
	op->resolution = table_resolution(op->layout);
	return op;
}

static const struct operator *read_gradient(struct reader *r,
    const struct json_place *at, const struct cJSON *value)
{
	static const struct field_set set = FIELD_SET(gradient_fields);
	struct draft draft = {.op = make_operator(r)};

	if (!draft.op)
		return NULL;
	draft.op->opening = clean;
	draft.op->resolution = 0;
	field_read_object(r, at, value, &set, 1, &draft);
	if (draft.op->resolution == 0)
		draft.op->resolution = table_resolution(draft.op->layout);
	return draft.op;
}

static const struct classic *read_classic(struct reader *r,
    const struct json_place *at, const struct cJSON *value,
    const struct variant *type)
{
	struct draft draft = {.classic.type = (unsigned)type->tag};
	struct classic *out = reader_alloc(r, 1, sizeof *out);
	unsigned seen;

	if (!out)
		return NULL;
	seen = field_read_object(r, at, value, &type->fields, 1, &draft);
	if (type->check)
		type->check(r, at, value, seen, &draft);
	*out = draft.classic;
	return out;
}

/* After a fault there may be neither op nor classic. */
static struct chosen read_object(struct reader *r,
    const struct json_place *at, const struct cJSON *value)
{
	struct chosen out = {0};
	const struct variant *type = types;

	if (!cJSON_IsObject(value)) {
		reader_fault(r, at, "an operator must be an object, not %s",
		    json_kind(value));
		return out;
	}
	if (cJSON_HasObjectItem(value, "type"))
		type = field_variant(r, at, value, types, TYPE_COUNT,
		    "operator");
	if (type && type->tag == GRADIENT)
		out.op = read_gradient(r, at, value);
	else if (type)
		out.classic = read_classic(r, at, value, type);
	return out;
}

/* Which built-in operator name is; BUILT_IN_COUNT: none. */
static enum built_in find_built_in(const char *name)
{
	static const char *const names[BUILT_IN_COUNT] = {"sharp", "clean",
	    "blend", "camel", "organic", "contact"};
	int i = 0;

	while (i < BUILT_IN_COUNT && !text_equal(names[i], name))
		i++;
	return (enum built_in)i;
}

static void set_built_in(struct operator *op, enum built_in which)
{
	static const char *const openings[BUILT_IN_COUNT] = {
		[BUILT_IN_CAMEL] = "camel",
		[BUILT_IN_ORGANIC] = "organic",
		[BUILT_IN_CONTACT] = "contact",
	};

	if (openings[which])
		opening_named(openings[which], &op->opening);
	else
		op->opening = which == BUILT_IN_BLEND ? opening_constant(0.0) :
		    clean;
	if (which == BUILT_IN_CONTACT)
		op->profile = profile_bulge(BULGE_DEFAULT);
}

static struct chosen built_in(struct reader *r, enum built_in which)
{
	struct operator *op;

	if (which != BUILT_IN_SHARP && !r->built_in[which]) {
		op = make_operator(r);
		if (op)
			set_built_in(op, which);
		r->built_in[which] = op;
	}
	return (struct chosen){.sharp = which == BUILT_IN_SHARP,
	    .op = r->built_in[which]};
}

/* Whether the document has an operator of that name; *place is where it is,
 * or belongs. */
static bool find_operator(const struct reader *r, const char *name,
    size_t *place)
{
	size_t low = 0, high = r->operator_count, middle;
	int order = 1;

	while (low < high && order) {
		middle = low + (high - low) / 2;
		order = strcmp(r->operators[middle].name, name);
		if (order < 0)
			low = middle + 1;
		else
			high = middle;
	}
	*place = high;
	return order == 0;
}

static struct chosen read_name(struct reader *r, const struct json_place *at,
    const char *name)
{
	const enum built_in which = find_built_in(name);
	size_t place;

	if (which != BUILT_IN_COUNT)
		return built_in(r, which);
	if (find_operator(r, name, &place))
		return r->operators[place].chosen;
	reader_fault(r, at, "unknown operator '%.64s': neither built in nor in "
	    "the document's \"operators\"", name);
	return (struct chosen){0};
}

/* That node's type takes out's operator. */
static void check_family(struct reader *r, const struct json_place *at,
    enum node_type node, const struct chosen *out)
{
	const int family = node == NODE_UNION ? CLASSIC_UNION :
	    node == NODE_INTERSECTION ? CLASSIC_INTERSECTION :
	    CLASSIC_DIFFERENCE;

	if (out->classic && !classic_has_family(out->classic->type, family))
		reader_fault(r, at, "a %s operator is for a difference alone",
		    types[1 + out->classic->type].name);
}

bool operator_read(struct reader *r, const struct json_place *at,
    const struct cJSON *value, enum node_type node, struct chosen *out)
{
	const size_t faults = r->faults->count;

	*out = (struct chosen){0};
	if (!value)
		*out = built_in(r, BUILT_IN_CLEAN);
	else if (cJSON_IsString(value))
		*out = read_name(r, at, value->valuestring);
	else if (cJSON_IsObject(value))
		*out = read_object(r, at, value);
	else
		reader_fault(r, at, "must be a name or an object, not %s",
		    json_kind(value));
	check_family(r, at, node, out);
	return reader_goes_on(r) && r->faults->count == faults;
}

static void add_named(struct reader *r, size_t place, const char *name,
    const struct chosen *chosen)
{
	struct named_operator *slot = r->operators + place;

	memmove(slot + 1, slot, (r->operator_count - place) * sizeof *slot);
	*slot = (struct named_operator){arena_string(r->arena, name),
	    *chosen};
	if (slot->name)
		r->operator_count++;
	else
		r->err = ERR_MEMORY;
}

static void read_named(struct reader *r, const struct json_place *at,
    const struct cJSON *member)
{
	struct chosen chosen;
	size_t place;

	if (!field_is_id(member->string)) {
		reader_fault(r, at, "an operator's name must be 1 to %d of the "
		    "characters A-Z a-z 0-9 _ . -", NODE_ID_MAX);
		return;
	}
	if (find_built_in(member->string) != BUILT_IN_COUNT) {
		reader_fault(r, at, "'%s' is the name of a built-in operator",
		    member->string);
		return;
	}
	if (find_operator(r, member->string, &place)) {
		reader_fault(r, at, "given twice");
		return;
	}
	chosen = read_object(r, at, member);
	if (reader_goes_on(r))
		add_named(r, place, member->string, &chosen);
}

void operator_read_all(struct reader *r, const struct json_place *at,
    const struct cJSON *value)
{
	const cJSON *member;
	struct json_place place;
	const int count = cJSON_GetArraySize(value);

	if (!value)
		return;
	if (!cJSON_IsObject(value)) {
		reader_fault(r, at, "must be an object, not %s",
		    json_kind(value));
		return;
	}
	if ((size_t)count > DOCUMENT_OPERATORS_MAX) {
		reader_limit(r, at, "more than %d operators",
		    DOCUMENT_OPERATORS_MAX);
		return;
	}
	r->operators = reader_alloc(r, (size_t)count, sizeof *r->operators);
	if (!r->operators)
		return;
	cJSON_ArrayForEach(member, value) {
		place = json_member(at, member->string);
		read_named(r, &place, member);
		if (!reader_goes_on(r))
			return;
	}
}
