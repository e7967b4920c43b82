#include <string.h>

#include <cjson/cJSON.h>

#include "server/access.h"
#include "server/asset.h"
#include "server/asset_reply.h"
#include "server/clock.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/events.h"
#include "server/exchange.h"
#include "server/handlers.h"
#include "server/routes.h"
#include "server/scene_store.h"
#include "server/scheduler.h"
#include "server/server.h"
#include "server/task.h"
#include "server/volume_store.h"

static void reply_index(struct exchange *x)
{
	cJSON *json = cJSON_CreateObject();
	cJSON *list;
	size_t count;
	const struct route *routes = route_list(&count);

	cJSON_AddStringToObject(json, "name", "blobfield");
	cJSON_AddStringToObject(json, "version", BLOBFIELD_VERSION);
	list = cJSON_AddArrayToObject(json, "endpoints");
	for (size_t i = 0; i < count; i++) {
		cJSON *item = cJSON_CreateObject();

		cJSON_AddStringToObject(item, "method", routes[i].method);
		cJSON_AddStringToObject(item, "path", routes[i].pattern);
		cJSON_AddStringToObject(item, "summary", routes[i].summary);
		cJSON_AddItemToArray(list, item);
	}
	exchange_reply_json(x, 200, json);
}

/* Browsers, which ask for HTML first of all, get the previewer. */
void handle_index(struct exchange *x)
{
	enum media_type type = MEDIA_JSON;
	struct asset page;

	if (media_choose(exchange_header(x, "Accept"), 1u << MEDIA_JSON |
	    1u << MEDIA_HTML, MEDIA_JSON, &type) && type == MEDIA_HTML &&
	    asset_find("index.html", &page))
		asset_reply(x, &page);
	else
		reply_index(x);
	exchange_add_header(x, "Vary", "Accept");
}

static void add_device(cJSON *json, const struct device_info *device)
{
	cJSON *object;

	if (device->name[0] == '\0') {
		cJSON_AddNullToObject(json, "device");
		return;
	}
	object = cJSON_AddObjectToObject(json, "device");
	cJSON_AddStringToObject(object, "name", device->name);
	cJSON_AddStringToObject(object, "vendor", device->vendor);
	cJSON_AddStringToObject(object, "version", device->version);
	cJSON_AddStringToObject(object, "driver", device->driver);
	cJSON_AddStringToObject(object, "type", device->is_gpu ? "gpu" :
	    "cpu");
	cJSON_AddNumberToObject(object, "compute_units",
	    device->compute_units);
	cJSON_AddNumberToObject(object, "memory_bytes",
	    (double)device->memory_bytes);
	cJSON_AddNumberToObject(object, "width", device->width);
	cJSON_AddStringToObject(object, "tables",
	    device->tables_are_images ? "images" : "buffers");
}

static void add_limits(cJSON *json, const struct config *config)
{
	cJSON *limits = cJSON_AddObjectToObject(json, "limits");

	cJSON_AddNumberToObject(limits, "max_body", (double)config->max_body);
	cJSON_AddNumberToObject(limits, "max_points",
	    (double)config->max_points);
	cJSON_AddNumberToObject(limits, "max_nodes",
	    (double)config->max_nodes);
	cJSON_AddNumberToObject(limits, "max_scenes",
	    (double)config->max_scenes);
	cJSON_AddNumberToObject(limits, "scene_memory",
	    (double)config->scene_memory);
	cJSON_AddNumberToObject(limits, "volume_memory",
	    (double)config->device.volume_bytes);
	cJSON_AddNumberToObject(limits, "queue", (double)config->queue);
	cJSON_AddNumberToObject(limits, "tasks", (double)config->tasks);
	cJSON_AddNumberToObject(limits, "tasks_waiting", TASKS_WAITING);
	cJSON_AddNumberToObject(limits, "work_time",
	    (double)config->work_time);
	cJSON_AddNumberToObject(limits, "interactive_points",
	    EVALUATION_SMALL_POINTS);
	cJSON_AddNumberToObject(limits, "whole_answer",
	    (double)EVALUATION_SMALL_BYTES);
}

static void add_tables(cJSON *json, const struct scheduler_stats *stats,
    const struct config *config)
{
	cJSON *tables = cJSON_AddObjectToObject(json, "tables");

	cJSON_AddNumberToObject(tables, "bytes", (double)stats->table_bytes);
	cJSON_AddNumberToObject(tables, "max_bytes",
	    (double)config->device.table_bytes);
	cJSON_AddStringToObject(tables, "layout",
	    operator_layout_name(config->layout));
}

static void add_queue(cJSON *json, const struct scheduler_stats *stats)
{
	cJSON *queue = cJSON_AddObjectToObject(json, "queue");

	cJSON_AddNumberToObject(queue, "waiting", (double)stats->waiting);
	cJSON_AddNumberToObject(queue, "running", (double)stats->running);
	cJSON_AddNumberToObject(queue, "completed", (double)stats->completed);
	cJSON_AddNumberToObject(queue, "points", (double)stats->points);
	cJSON_AddNumberToObject(queue, "launches", (double)stats->launches);
	cJSON_AddNumberToObject(queue, "launched", (double)stats->launched);
	cJSON_AddNumberToObject(queue, "batched", (double)stats->batched);
	cJSON_AddNumberToObject(queue, "expired", (double)stats->expired);
	cJSON_AddNumberToObject(queue, "abandoned", (double)stats->abandoned);
	cJSON_AddNumberToObject(queue, "interactive_s",
	    stats->seconds[JOB_INTERACTIVE]);
	cJSON_AddNumberToObject(queue, "bulk_s", stats->seconds[JOB_BULK]);
	cJSON_AddNumberToObject(queue, "stalled", (double)stats->stalled);
	cJSON_AddNumberToObject(queue, "held_bytes",
	    (double)stats->held_bytes);
}

static void add_tasks(cJSON *json, const struct server *server)
{
	cJSON *tasks = cJSON_AddObjectToObject(json, "tasks");
	struct tasks_stats stats;

	tasks_get_stats(server->tasks, &stats);
	cJSON_AddNumberToObject(tasks, "running", (double)stats.running);
	cJSON_AddNumberToObject(tasks, "waiting", (double)stats.waiting);
	cJSON_AddNumberToObject(tasks, "completed", (double)stats.completed);
	cJSON_AddNumberToObject(tasks, "expired", (double)stats.expired);
	cJSON_AddNumberToObject(tasks, "abandoned", (double)stats.abandoned);
	cJSON_AddNumberToObject(tasks, "held_bytes", (double)stats.held_bytes);
}

static void add_volumes(cJSON *json, const struct server *server)
{
	cJSON *volumes = cJSON_AddObjectToObject(json, "volumes");
	struct volume_store_stats stats;

	volume_store_get_stats(server->volumes, &stats);
	cJSON_AddNumberToObject(volumes, "count", (double)stats.count);
	cJSON_AddNumberToObject(volumes, "bytes", (double)stats.bytes);
	cJSON_AddNumberToObject(volumes, "max_bytes",
	    (double)server->config->device.volume_bytes);
}

/* Never where: addresses and folders are not every reader's business. */
static const char *store_kind(const struct config *config)
{
	if (config->store[0] != '\0')
		return "redis";
	return strcmp(config->data, ":memory:") == 0 ? "memory" : "sqlite";
}

static void add_store(cJSON *json, const struct server *server)
{
	cJSON *store = cJSON_AddObjectToObject(json, "store");

	cJSON_AddStringToObject(store, "kind", store_kind(server->config));
	cJSON_AddBoolToObject(store, "ready",
	    scene_store_is_ready(server->scenes));
	cJSON_AddBoolToObject(store, "well",
	    scene_store_is_well(server->scenes));
	cJSON_AddNumberToObject(store, "waiting",
	    (double)scene_store_waiting(server->scenes));
	cJSON_AddNumberToObject(store, "history",
	    (double)server->config->history);
	cJSON_AddNumberToObject(store, "history_bytes",
	    (double)server->config->history_bytes);
	cJSON_AddNumberToObject(store, "bytes",
	    (double)scene_store_bytes(server->scenes));
}

static void add_listeners(cJSON *json, const struct server *server)
{
	cJSON *listeners = cJSON_AddObjectToObject(json, "listeners");
	struct events_stats stats;

	events_get_stats(server->events, &stats);
	cJSON_AddNumberToObject(listeners, "count", (double)stats.listeners);
	cJSON_AddNumberToObject(listeners, "max",
	    (double)server->config->max_listeners);
	cJSON_AddNumberToObject(listeners, "sent", (double)stats.sent);
	cJSON_AddNumberToObject(listeners, "cut", (double)stats.cut);
}

static void add_security(cJSON *json, const struct server *server)
{
	cJSON *security = cJSON_AddObjectToObject(json, "security");

	cJSON_AddBoolToObject(security, "tokens",
	    access_is_closed(server->access));
	cJSON_AddBoolToObject(security, "tls", server->tls != NULL);
}

void handle_info(struct exchange *x)
{
	const struct server *server = x->server;
	struct scheduler_stats stats;
	cJSON *json = cJSON_CreateObject();

	scheduler_get_stats(server->scheduler, &stats);
	cJSON_AddStringToObject(json, "name", "blobfield");
	cJSON_AddStringToObject(json, "version", BLOBFIELD_VERSION);
	cJSON_AddStringToObject(json, "format", "blobfield/1");
	cJSON_AddNumberToObject(json, "uptime_s",
	    (double)(long)(clock_seconds() - server->started));
	cJSON_AddBoolToObject(json, "ready", stats.ready);
	add_device(json, &stats.device);
	add_limits(json, server->config);
	add_tables(json, &stats, server->config);
	add_queue(json, &stats);
	add_tasks(json, server);
	cJSON_AddNumberToObject(json, "scenes",
	    (double)scene_store_count(server->scenes));
	add_volumes(json, server);
	add_store(json, server);
	add_listeners(json, server);
	add_security(json, server);
	exchange_reply_json(x, 200, json);
}
