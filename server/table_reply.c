#include "server/table_reply.h"

#include <math.h>

#include <cjson/cJSON.h>

#include "core/profile.h"
#include "server/tables.h"

/* One half of the curve, as documents may give it. */
static cJSON *points_json(const struct profile *profile)
{
	cJSON *list = cJSON_CreateArray();

	for (int i = 0; i < profile->count; i++) {
		const double point[2] = {profile->x[i], profile->y[i]};

		cJSON_AddItemToArray(list, cJSON_CreateDoubleArray(point, 2));
	}
	return list;
}

cJSON *table_reply_profile(const struct profile *profile)
{
	cJSON *json = cJSON_CreateObject();

	cJSON_AddStringToObject(json, "type", profile_name(profile->type));
	if (profile->type == PROFILE_BULGE)
		cJSON_AddNumberToObject(json, "k", profile->k);
	if (profile->type == PROFILE_SAMPLES)
		cJSON_AddItemToObject(json, "points", points_json(profile));
	return json;
}

void table_reply_add_figure(cJSON *json, const char *name, double value)
{
	double unit = value > 0.0 ? pow(10.0, floor(log10(value)) - 3.0) : 1.0;

	cJSON_AddNumberToObject(json, name, unit >= 1.0 ? round(value) :
	    round(value / unit) / round(1.0 / unit));
}

static cJSON *error_json(const struct table_report *table)
{
	static const char *const quantities[] = {"g", "g1", "g2", "gt", "g11",
	    "g12", "g22", "g1t", "g2t", "gtt"};
	cJSON *json;

	if (!table->measured)
		return cJSON_CreateNull();
	json = cJSON_CreateObject();
	cJSON_AddNumberToObject(json, "count", (double)table->error.count);
	for (int i = 0; i < 10; i++) {
		cJSON *item = cJSON_AddObjectToObject(json, quantities[i]);

		table_reply_add_figure(item, "max", table->error.max[i]);
		table_reply_add_figure(item, "mean", table->error.mean[i]);
		table_reply_add_figure(item, "p99", table->error.p99[i]);
	}
	return json;
}

cJSON *table_reply_json(const struct table_report *table)
{
	cJSON *json = cJSON_CreateObject();

	cJSON_AddStringToObject(json, "family",
	    operator_family_name(table->family));
	cJSON_AddItemToObject(json, "profile", table_reply_profile(&table->profile));
	cJSON_AddStringToObject(json, "layout",
	    operator_layout_name(table->layout));
	cJSON_AddNumberToObject(json, "resolution", table->resolution);
	cJSON_AddBoolToObject(json, "draft", table->draft);
	cJSON_AddStringToObject(json, "state",
	    tables_state_name(table->state));
	cJSON_AddNumberToObject(json, "bytes", (double)table->bytes);
	table_reply_add_figure(json, "build_ms", 1e3 * table->build_seconds);
	cJSON_AddItemToObject(json, "error", error_json(table));
	return json;
}
