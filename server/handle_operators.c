#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/operator.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/server.h"
#include "server/table_reply.h"
#include "server/tables.h"

/* The operators that documents may name (SPEC section 2). */
static const char *const names[] = {"clean", "blend", "camel", "organic",
    "contact"};

#define NAME_COUNT (sizeof names / sizeof *names)

static void describe(const char *name, struct profile *profile,
    struct opening *opening)
{
	*profile = strcmp(name, "contact") == 0 ? profile_bulge(0.8) :
	    profile_smooth();
	if (!opening_named(name, opening))
		*opening = opening_constant(strcmp(name, "clean") == 0 ?
		    atan(1.0) : 0.0);
}

static cJSON *opening_json(const struct opening *opening)
{
	cJSON *json = cJSON_CreateObject();

	cJSON_AddItemToObject(json, "alpha",
	    cJSON_CreateDoubleArray(opening->alpha, 3));
	cJSON_AddItemToObject(json, "theta",
	    cJSON_CreateDoubleArray(opening->theta, 3));
	cJSON_AddItemToObject(json, "w",
	    cJSON_CreateDoubleArray(opening->w, 2));
	return json;
}

/* The tables of profile, or all of them where it is NULL. */
static cJSON *tables_json(const struct table_report *tables, size_t count,
    const struct profile *profile)
{
	cJSON *list = cJSON_CreateArray();

	for (size_t i = 0; i < count; i++) {
		if (profile == NULL ||
		    profile_equal(&tables[i].profile, profile))
			cJSON_AddItemToArray(list, table_reply_json(&tables[i]));
	}
	return list;
}

/* tables NULL: without them. */
static cJSON *operator_json(const char *name,
    const struct table_report *tables, size_t count)
{
	cJSON *json = cJSON_CreateObject();
	struct profile profile;
	struct opening opening;

	describe(name, &profile, &opening);
	cJSON_AddStringToObject(json, "name", name);
	cJSON_AddItemToObject(json, "profile", table_reply_profile(&profile));
	cJSON_AddItemToObject(json, "opening", opening_json(&opening));
	if (tables != NULL)
		cJSON_AddItemToObject(json, "tables",
		    tables_json(tables, count, &profile));
	return json;
}

static bool get_tables(struct exchange *x, struct table_report **out,
    size_t *count)
{
	enum err err = tables_report(x->server->tables, out, count);

	if (err == ERR_OK)
		return true;
	exchange_reply_problem(x, problem_from_err(err), NULL, "%s",
	    err_message(err));
	return false;
}

void handle_operators_list(struct exchange *x)
{
	struct table_report *tables;
	cJSON *json, *list;
	size_t count;

	if (!get_tables(x, &tables, &count))
		return;
	json = cJSON_CreateObject();
	list = cJSON_AddArrayToObject(json, "operators");
	for (size_t i = 0; i < NAME_COUNT; i++)
		cJSON_AddItemToArray(list, operator_json(names[i], NULL, 0));
	cJSON_AddItemToObject(json, "tables",
	    tables_json(tables, count, NULL));
	free(tables);
	exchange_reply_json(x, 200, json);
}

void handle_operator_get(struct exchange *x)
{
	struct table_report *tables;
	size_t count;

	for (size_t i = 0; i < NAME_COUNT; i++) {
		if (strcmp(x->id, names[i]) != 0)
			continue;
		if (!get_tables(x, &tables, &count))
			return;
		exchange_reply_json(x, 200, operator_json(names[i], tables,
		    count));
		free(tables);
		return;
	}
	exchange_reply_problem(x, PROBLEM_NOT_FOUND, NULL,
	    "There is no operator '%s'; the named ones are clean, blend, "
	    "camel, organic and contact.", x->id);
}
