#include "server/limits.h"

#include "server/config.h"
#include "server/server.h"
#include "server/volume_store.h"

struct document_limits limits_new(const struct server *server)
{
	return (struct document_limits){
		.max_nodes = server->config->max_nodes,
		.max_bytes = LIMITS_DOCUMENT_BYTES,
		.layout = server->config->layout,
		.volume = volume_store_find,
		.volume_ctx = server->volumes,
	};
}

struct document_limits limits_kept(const struct server *server)
{
	struct document_limits limits = limits_new(server);

	limits.max_bytes = 0;
	limits.volume = volume_store_recall;
	return limits;
}
