#include "tests/bench/echo.h"

#include <microhttpd.h>
#include <stdio.h>
#include <stdlib.h>

#define THREADS 2
#define CONNECTION_MEMORY ((size_t)32 << 10)
#define ANSWER_MAX ((size_t)64 << 20)

static enum MHD_Result on_access(void *ctx, struct MHD_Connection *connection,
    const char *path, const char *method, const char *version,
    const char *data, size_t *length, void **request)
{
	static char body[1] = "", *answer;
	struct MHD_Response *response;
	enum MHD_Result result;
	size_t size;

	(void)ctx, (void)method, (void)version, (void)data;
	if (*request == NULL) {
		*request = body;
		return MHD_YES;
	}
	if (*length > 0) {
		*length = 0;
		return MHD_YES;
	}
	*request = NULL;
	size = strtoul(path + 1, NULL, 10);
	if (!answer)
		answer = calloc(1, ANSWER_MAX);
	if (!answer || size > ANSWER_MAX)
		return MHD_NO;
	response = MHD_create_response_from_buffer(size, answer,
	    MHD_RESPMEM_PERSISTENT);
	result = MHD_queue_response(connection, 200, response);
	MHD_destroy_response(response);
	return result;
}

struct MHD_Daemon *echo_start(int *port)
{
	struct MHD_Daemon *echo = MHD_start_daemon(MHD_USE_EPOLL |
	    MHD_USE_INTERNAL_POLLING_THREAD | MHD_ALLOW_SUSPEND_RESUME, 0,
	    NULL, NULL, on_access, NULL,
	    MHD_OPTION_THREAD_POOL_SIZE, (unsigned)THREADS,
	    MHD_OPTION_CONNECTION_MEMORY_LIMIT, CONNECTION_MEMORY,
	    MHD_OPTION_END);
	const union MHD_DaemonInfo *info;

	if (!echo)
		abort();
	info = MHD_get_daemon_info(echo, MHD_DAEMON_INFO_BIND_PORT);
	*port = info->port;
	return echo;
}

void echo_stop(struct MHD_Daemon *echo)
{
	MHD_stop_daemon(echo);
}
