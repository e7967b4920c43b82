/*
 * The daemon: starts its parts, waits for a signal, drains and stops them.
 */
#include <errno.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/clock.h"
#include "server/config.h"
#include "server/http.h"
#include "server/log.h"
#include "server/scene_store.h"
#include "server/scheduler.h"
#include "server/server.h"
#include "server/tables.h"

/* How long a drain may take before what is left is given up. */
#define DRAIN_SECONDS 60.0

/* ... and, once every answer is out, before requests still arriving are. */
#define LINGER_SECONDS 5.0

static void on_tables_changed(void *ctx)
{
	struct server *server = ctx;

	scheduler_tables_changed(server->scheduler);
}

static void on_ready(void *ctx)
{
	struct server *server = ctx;

	log_write(LOG_INFO, "ready after %.0f ms",
	    1e3 * (clock_seconds() - server->started));
	tables_measure(server->tables);
}

/* Wakes the main thread, which gives up. */
static void on_device_failed(void *ctx)
{
	(void)ctx;
	kill(getpid(), SIGUSR1);
}

/* ---- signals ---- */

static void block_signals(sigset_t *set)
{
	sigemptyset(set);
	sigaddset(set, SIGTERM);
	sigaddset(set, SIGINT);
	sigaddset(set, SIGUSR1);
	pthread_sigmask(SIG_BLOCK, set, NULL);
	signal(SIGPIPE, SIG_IGN);
}

/* The next of set's signals; 0 after so many seconds without one. */
static int await_signal(const sigset_t *set, double seconds)
{
	const struct timespec timeout = {(time_t)seconds,
	    (long)((seconds - (double)(time_t)seconds) * 1e9)};
	int signal_number = sigtimedwait(set, NULL, &timeout);

	return signal_number > 0 ? signal_number : 0;
}

/* Serves until told to stop; returns the signal that told. */
static int serve(struct server *server, const sigset_t *set)
{
	int told;

	while ((told = await_signal(set, 1.0)) == 0)
		http_reap(server->http);
	return told;
}

/* Whether nothing is left to do since the drain began. */
static bool is_drained(struct server *server, double *idle_since)
{
	double now = clock_seconds();

	if (!scheduler_is_idle(server->scheduler) ||
	    http_owed(server->http) > 0) {
		*idle_since = now;
		return false;
	}
	return http_active(server->http) == 0 ||
	    now - *idle_since > LINGER_SECONDS;
}

/* Finishes what runs and what is queued. A second signal ends it at once. */
static void drain(struct server *server, const sigset_t *set)
{
	double begin = clock_seconds(), idle_since = begin;

	log_write(LOG_INFO, "draining");
	atomic_store(&server->draining, true);
	http_quiesce(server->http);
	scheduler_drain(server->scheduler);
	while (!is_drained(server, &idle_since)) {
		if (await_signal(set, 0.02) != 0) {
			log_write(LOG_WARNING, "second signal: giving up");
			_exit(1);
		}
		if (clock_seconds() - begin > DRAIN_SECONDS) {
			log_write(LOG_WARNING, "still busy after %.0f s: "
			    "giving up the rest", DRAIN_SECONDS);
			break;
		}
	}
}

/* ---- parts ---- */

static enum err start_scheduler(struct server *server)
{
	const struct scheduler_options options = {
		.device = server->config->device,
		.tables = server->tables,
		.queue = server->config->queue,
		.ready = on_ready,
		.failed = on_device_failed,
		.ctx = server,
	};

	return scheduler_create(&options, &server->scheduler);
}

static enum err start(struct server *server, char url[static HTTP_URL_MAX])
{
	const struct config *config = server->config;
	enum err err;

	err = tables_create(config->layout, &server->tables);
	if (err == ERR_OK)
		err = scene_store_create(config->max_scenes, &server->scenes);
	if (err == ERR_OK)
		err = start_scheduler(server);
	if (err == ERR_OK)
		err = tables_start(server->tables, config->measure,
		    on_tables_changed, server);
	if (err == ERR_OK)
		err = http_start(server, url);
	return err;
}

/*
 * In this order: nothing may wait when HTTP stops, HTTP's exchanges and the
 * scenes hold programs, and programs hold tables.
 */
static void stop(struct server *server)
{
	if (server->scheduler != NULL)
		scheduler_stop(server->scheduler);
	http_stop(server->http);
	scene_store_free(server->scenes);
	if (server->tables != NULL)
		tables_stop(server->tables);
	tables_free(server->tables);
	scheduler_free(server->scheduler);
}

static int run(const struct config *config)
{
	struct server server = {.config = config};
	char url[HTTP_URL_MAX];
	sigset_t signals;
	int status = 1;
	enum err err;

	block_signals(&signals);
	server.started = clock_seconds();
	err = start(&server, url);
	if (err == ERR_OK) {
		printf("blobfieldd listening on %s\n", url);
		fflush(stdout);
		if (serve(&server, &signals) != SIGUSR1) {
			drain(&server, &signals);
			status = 0;
		}
	} else {
		log_write(LOG_ERROR, "cannot start: %s", err_message(err));
	}
	stop(&server);
	log_write(LOG_INFO, "stopped");
	return status;
}

/* ---- --list-devices ---- */

static void print_device(void *ctx, int index, const struct device_info *info)
{
	(void)ctx;
	printf("%d: %s (%s, %s), %u compute units, %zu MiB, %s\n", index,
	    info->name, info->vendor, info->is_gpu ? "GPU" : "CPU",
	    info->compute_units, info->memory_bytes >> 20, info->version);
}

static int list_devices(void)
{
	struct device_failure failure = {0};
	enum err err = device_list(print_device, NULL, &failure);

	if (err != ERR_OK)
		fprintf(stderr, "blobfieldd: %s: %s\n", err_message(err),
		    failure.message);
	device_failure_fini(&failure);
	return err == ERR_OK ? 0 : 1;
}

int main(int argc, char **argv)
{
	struct config config;

	switch (config_parse(argc, argv, &config)) {
	case CONFIG_DONE:
		return 0;
	case CONFIG_BAD:
		return 2;
	case CONFIG_RUN:
		break;
	}
	log_set_level(config.log_level);
	if (config.list_devices)
		return list_devices();
	return run(&config);
}
