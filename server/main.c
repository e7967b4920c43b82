/*
 * The daemon: starts its parts, waits for a signal, drains and stops them.
 */
#include <errno.h>
#include <malloc.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include "kernels/cache_file.h"
#include "server/access.h"
#include "server/clock.h"
#include "server/config.h"
#include "server/events.h"
#include "server/filler.h"
#include "server/http.h"
#include "server/log.h"
#include "server/metrics.h"
#include "server/notify.h"
#include "server/orders.h"
#include "server/readers.h"
#include "server/scene_store.h"
#include "server/scheduler.h"
#include "server/server.h"
#include "server/table_cache.h"
#include "server/tables.h"
#include "server/task.h"
#include "server/tls.h"
#include "server/volume_store.h"

/* Of a drain: before a client that takes nothing of its answer is cut off: others
 * wait for the end. */
#define STALL_SECONDS 10.0

/* ... and, once every answer is out, before requests still arriving are. */
#define LINGER_SECONDS 5.0

/* Supervisors and terminals may send a signal twice: a second one that comes
 * sooner than this is no wish to give up. */
#define PATIENCE_SECONDS 1.0

/* What stopping takes at most once the drain is over, and what waiting for a
 * store that is away may take before it is asked again: for the service
 * manager, which would give up sooner. */
#define STOP_SECONDS 30
#define AWAY_SECONDS 30

/* How long the daemon runs before it has its kernels put in the cache, which
 * takes a core half a minute: one that runs for less need not begin. */
#define FILL_AFTER_SECONDS 10.0

/* What the main thread waits for. */
enum told {
	TOLD_NOTHING,
	TOLD_TO_RELOAD,
	TOLD_TO_STOP,
	TOLD_OF_FAILURE
};

/* ... and how it hears of it: descriptors of signals, and of an event. */
struct ears {
	int signals;
	int failure;
	int news;            /* something that is_ready() asks for */
	bool hears_terminal; /* SIGHUP says that it has gone, not: reload */
};

struct daemon {
	struct server server;
	struct ears ears;
	struct table_cache *cache; /* or NULL */
	struct filler filler;
	bool is_ready;      /* has been, and the service manager knows */
	const char *status; /* that it knows */
};

static void on_tables_changed(void *ctx)
{
	struct server *server = ctx;

	scheduler_tables_changed(server->scheduler);
}

static void on_ready(void *ctx)
{
	struct daemon *d = ctx;
	struct scheduler_stats stats;

	scheduler_get_stats(d->server.scheduler, &stats);
	log_write(LOG_INFO, "ready after %.0f ms%s",
	    1e3 * (clock_seconds() - d->server.started),
	    stats.device.is_cached ? ", kernels from the cache" : "");
	eventfd_write(d->ears.news, 1);
	tables_measure(d->server.tables);
}

/* Wakes the main thread, which gives up. */
static void on_device_failed(void *ctx)
{
	struct daemon *d = ctx;

	eventfd_write(d->ears.failure, 1);
}

/* ---- the cache ---- */

/* Goes on without one that cannot be used. */
static void prepare_cache(struct config *config)
{
	bool was_asked;
	enum err err;

	config->device.cache = NULL;
	if (config->cache[0] == '\0')
		return;
	was_asked = config->cache_read_only;
	err = cache_prepare(config->cache, &config->cache_read_only);
	if (err == ERR_OK) {
		config->device.cache = config->cache;
		config->device.cache_is_read_only = config->cache_read_only;
		if (config->cache_read_only && !was_asked)
			log_write(LOG_INFO, "cache %s: cannot be written, "
			    "only read", config->cache);
		return;
	}
	log_write(LOG_WARNING, "cache %s: %s; going on without", config->cache,
	    err == ERR_INVALID ? "it is another user's, or others may write it"
	    : strerror(errno));
	config->cache[0] = '\0';
}

/*
 * --fill-cache: opens the device and stores its kernels. Slow, so at the least
 * priority, and in a process of its own: compilers cannot be interrupted.
 */
static int fill_cache(const struct config *config)
{
	struct device_failure failure = {0};
	struct device *device = NULL;
	enum err err;

	if (config->cache[0] == '\0' || config->cache_read_only) {
		log_write(LOG_ERROR, config->cache[0] == '\0' ? "there is "
		    "no cache to fill" : "the cache is only read");
		return 1;
	}
	setpriority(PRIO_PROCESS, 0, 19);
	err = device_open(&config->device, &device, &failure);
	if (err == ERR_OK && !device_get_info(device)->is_cached)
		err = device_keep_kernels(device);
	if (err == ERR_OK)
		log_write(LOG_INFO, "kernels are in the cache");
	else
		log_write(LOG_WARNING, "kernels are not in the cache: %s: %s",
		    err_message(err), device != NULL ? device_message(device) :
		    failure.message);
	device_close(device);
	device_failure_fini(&failure);
	return err == ERR_OK ? 0 : 1;
}

/* Has the cache filled with what the device has not found there. */
static void tend_filler(struct daemon *d)
{
	struct scheduler_stats stats;

	if (clock_seconds() - d->server.started < FILL_AFTER_SECONDS)
		return;
	scheduler_get_stats(d->server.scheduler, &stats);
	if (stats.ready)
		filler_tend(&d->filler, &stats.device);
}

/* ---- signals ---- */

/* nohup has it ignored, and means it. */
static bool is_ignored(int signal_number)
{
	struct sigaction action;

	return sigaction(signal_number, NULL, &action) == 0 &&
	    action.sa_handler == SIG_IGN;
}

/* Before any thread is started: they inherit what is blocked. */
static bool open_ears(struct ears *ears)
{
	sigset_t set;

	sigemptyset(&set);
	sigaddset(&set, SIGTERM);
	sigaddset(&set, SIGINT);
	if (!is_ignored(SIGHUP))
		sigaddset(&set, SIGHUP);
	pthread_sigmask(SIG_BLOCK, &set, NULL);
	signal(SIGPIPE, SIG_IGN);
	signal(SIGXFSZ, SIG_IGN); /* writes fail instead */
	ears->hears_terminal = isatty(STDIN_FILENO);
	ears->signals = signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK);
	ears->failure = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	ears->news = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	return ears->signals >= 0 && ears->failure >= 0 && ears->news >= 0;
}

/* What comes within so many milliseconds; a signal, or a failure, once. */
static enum told listen_for(const struct ears *ears, int milliseconds)
{
	struct pollfd fds[3] = {
		{.fd = ears->signals, .events = POLLIN},
		{.fd = ears->failure, .events = POLLIN},
		{.fd = ears->news, .events = POLLIN},
	};
	struct signalfd_siginfo info;
	eventfd_t event;

	poll(fds, 3, milliseconds);
	eventfd_read(ears->news, &event);
	if (read(ears->signals, &info, sizeof info) == sizeof info)
		return info.ssi_signo == SIGHUP && !ears->hears_terminal ?
		    TOLD_TO_RELOAD : TOLD_TO_STOP;
	return eventfd_read(ears->failure, &event) == 0 ? TOLD_OF_FAILURE :
	    TOLD_NOTHING;
}

/* What is wrong is logged, and changes nothing. A manager that is told of it
 * before the daemon is ready would take it for ready after. */
static void reload(struct daemon *d)
{
	if (d->is_ready)
		notify_reloading();
	log_write(LOG_INFO, "reloading");
	access_reload(d->server.access);
	if (d->server.tls != NULL)
		tls_reload(d->server.tls);
	if (d->is_ready)
		notify_ready();
}

/* What a person is told; NULL: all is well. */
static const char *trouble(struct daemon *d)
{
	struct scheduler_stats stats;

	scheduler_get_stats(d->server.scheduler, &stats);
	if (!stats.ready)
		return d->is_ready ? "the device is away" :
		    "the device is being made ready";
	if (!scene_store_is_ready(d->server.scenes))
		return "the store is away, and has not been read yet";
	if (!scene_store_is_well(d->server.scenes))
		return "changes cannot be kept: the store is away, or full";
	return NULL;
}

/* Tells the service manager what has changed. */
static void tend_status(struct daemon *d)
{
	const char *status = trouble(d);
	struct scheduler_stats stats;

	scheduler_get_stats(d->server.scheduler, &stats);
	if (!d->is_ready && stats.ready &&
	    scene_store_is_ready(d->server.scenes)) {
		d->is_ready = true;
		notify_ready();
	}
	/* A store comes when it comes; a device that does not is a failure. */
	if (!d->is_ready && stats.ready)
		notify_patience(AWAY_SECONDS);
	if (status == NULL)
		status = "serving";
	if (status != d->status)
		notify_status(status);
	d->status = status;
}

/*
 * No sign of life while a launch hangs: only a new process gets the device back.
 * One that is lost is no reason, since it is opened anew. Calls here take the
 * scheduler's and the store's locks, so that a lock that is never released
 * silences it, too.
 */
static void tend(struct daemon *d)
{
	http_reap(d->server.http);
	events_tend(d->server.events);
	tend_filler(d);
	tend_status(d);
	if (scheduler_watch(d->server.scheduler))
		notify_alive();
}

/* Serves until told to stop, or of a failure. */
static enum told serve(struct daemon *d)
{
	for (;;) {
		enum told told = listen_for(&d->ears, 1000);

		if (told == TOLD_TO_RELOAD)
			reload(d);
		else if (told != TOLD_NOTHING)
			return told;
		tend(d);
	}
}

/* Whether nothing is left to do since the drain began. */
static bool is_drained(struct server *server, double *idle_since)
{
	double now = clock_seconds();

	if (!readers_are_idle(server->readers) ||
	    !tasks_are_idle(server->tasks) ||
	    !scheduler_is_idle(server->scheduler) ||
	    http_owed(server->http) > 0) {
		*idle_since = now;
		return false;
	}
	return http_active(server->http) == 0 ||
	    now - *idle_since > LINGER_SECONDS;
}

/* Has everybody refuse new work, once the readers have brought what had come;
 * the scheduler, once no task is left that needs it, too. */
static void close_parts(struct server *server)
{
	if (!readers_are_idle(server->readers))
		return;
	tasks_drain(server->tasks);
	orders_drain(server->orders);
	if (tasks_are_idle(server->tasks))
		scheduler_drain(server->scheduler);
}

/*
 * Not ready, but serving: for a load balancer to see it before connections are
 * refused. A second signal ends it.
 */
static void delay(struct daemon *d)
{
	double begin = clock_seconds();
	double most = (double)d->server.config->drain_delay;

	if (most > 0.0)
		log_write(LOG_INFO, "not ready any more; draining in %.0f s",
		    most);
	for (;;) {
		double seconds = clock_seconds() - begin;
		bool told;

		if (seconds >= most)
			return;
		told = listen_for(&d->ears, 100) == TOLD_TO_STOP;
		http_reap(d->server.http);
		notify_alive();
		if (told && seconds > PATIENCE_SECONDS)
			return;
	}
}

/* Has everybody refuse what is new. */
static void begin_drain(struct server *server)
{
	log_write(LOG_INFO, "draining");
	events_drain(server->events);
	http_quiesce(server->http);
	atomic_store(&server->closed, clock_seconds());
	close_parts(server);
}

/* Readiness is the first to go. */
static void leave(struct daemon *d)
{
	const struct config *config = d->server.config;

	atomic_store(&d->server.draining, true);
	notify_stopping();
	notify_status("draining");
	notify_patience((unsigned)(config->drain_delay + config->drain_time) +
	    STOP_SECONDS);
	delay(d);
	begin_drain(&d->server);
}

/* Finishes what runs and what is queued. A signal after a while ends it at
 * once. */
static void drain(struct daemon *d)
{
	struct server *server = &d->server;
	double begin = clock_seconds(), idle_since = begin;
	double most = (double)server->config->drain_time;

	while (!is_drained(server, &idle_since)) {
		double seconds;
		bool told = listen_for(&d->ears, 20) == TOLD_TO_STOP;

		close_parts(server);
		notify_alive();
		seconds = clock_seconds() - begin;
		if (seconds > STALL_SECONDS)
			http_cut_stalled(server->http, STALL_SECONDS);
		if (told && seconds > PATIENCE_SECONDS) {
			log_write(LOG_WARNING, "second signal: giving up");
			_exit(1);
		}
		if (seconds > most) {
			log_write(LOG_WARNING, "still busy after %.0f s: "
			    "giving up the rest", most);
			break;
		}
	}
}

/* ---- parts ---- */

static enum err start_scheduler(struct daemon *d)
{
	struct server *server = &d->server;
	const struct scheduler_options options = {
		.device = server->config->device,
		.tables = server->tables,
		.queue = server->config->queue,
		.ready = on_ready,
		.failed = on_device_failed,
		.ctx = d,
	};

	return scheduler_create(&options, &server->scheduler);
}

static enum err check_device(const struct device_options *options)
{
	struct device_failure failure = {0};
	enum err err = device_check(options, &failure);

	if (err != ERR_OK)
		log_write(LOG_ERROR, "device: %s: %s", err_message(err),
		    failure.message);
	device_failure_fini(&failure);
	return err;
}

/* What the configuration names, besides the store. */
static enum err read_files(struct server *server)
{
	const struct config *config = server->config;
	enum err err = access_create(config, &server->access);

	if (err == ERR_OK && config->tls_cert[0] != '\0')
		err = tls_create(config->tls_cert, config->tls_key,
		    &server->tls);
	/* Missing or unreadable, they are as wrong as what is in them. */
	return err == ERR_IO || err == ERR_SYNTAX ? ERR_INVALID : err;
}

/* What fails soonest comes first. ERR_INVALID: no new start would mend it. */
static enum err start(struct daemon *d, char url[static HTTP_URL_MAX])
{
	struct server *server = &d->server;
	const struct config *config = server->config;
	enum err err;

	err = metrics_create(&server->metrics);
	if (err == ERR_OK)
		err = read_files(server);
	if (err == ERR_OK)
		err = http_listen(server, url);
	if (err == ERR_OK)
		err = check_device(&config->device);
	if (err == ERR_OK)
		err = tables_create(config->layout, &server->tables);
	if (err == ERR_OK)
		err = volume_store_create(config->device.volume_bytes,
		    &server->volumes);
	if (err == ERR_OK && config->device.cache != NULL)
		err = table_cache_create(config->cache, config->cache_size,
		    config->cache_read_only, &d->cache);
	if (err == ERR_OK)
		err = start_scheduler(d);
	if (err == ERR_OK)
		err = events_create(config->max_listeners, &server->events);
	if (err == ERR_OK)
		err = scene_store_create(server, &server->scenes);
	if (err == ERR_OK)
		err = tables_start(server->tables, config->measure, d->cache,
		    on_tables_changed, server);
	if (err == ERR_OK)
		err = orders_create(server->tables,
		    config->device.table_bytes, &server->orders);
	if (err == ERR_OK)
		err = tasks_create(config->tasks, &server->tasks);
	if (err == ERR_OK)
		err = readers_create(&server->readers);
	if (err == ERR_OK)
		err = http_start(server->http);
	return err;
}

/*
 * In this order: readers bring work to all others, tasks ask the scheduler,
 * nothing may wait when HTTP stops, HTTP's exchanges and the scenes hold
 * programs, and programs hold tables.
 */
static void stop(struct server *server)
{
	if (server->events != NULL)
		events_drain(server->events);
	readers_stop(server->readers);
	if (server->scenes != NULL)
		scene_store_stop(server->scenes);
	if (server->tasks != NULL)
		tasks_stop(server->tasks);
	if (server->scheduler != NULL)
		scheduler_stop(server->scheduler);
	if (server->orders != NULL)
		orders_stop(server->orders);
	http_stop(server->http);
	readers_free(server->readers);
	tasks_free(server->tasks);
	events_free(server->events);
	scene_store_free(server->scenes);
	volume_store_free(server->volumes);
	if (server->tables != NULL)
		tables_stop(server->tables);
	tables_free(server->tables);
	orders_free(server->orders);
	scheduler_free(server->scheduler);
	tls_free(server->tls);
	access_free(server->access);
	metrics_free(server->metrics);
}

static int run(const struct config *config, char **argv)
{
	struct daemon d = {.server = {.config = config},
	    .filler = {.argv = argv, .cache = config->cache_read_only ? NULL :
	    config->device.cache}};
	char url[HTTP_URL_MAX];
	int status = 1;
	enum err err = ERR_IO;

	d.server.started = clock_seconds();
	if (open_ears(&d.ears))
		err = start(&d, url);
	if (err == ERR_OK) {
		printf("blobfieldd listening on %s\n", url);
		fflush(stdout);
		status = serve(&d) == TOLD_TO_STOP ? 0 : 1;
		filler_stop(&d.filler);
		leave(&d);
		drain(&d);
	} else {
		notify_status("cannot start; the log says why");
		log_write(LOG_ERROR, "cannot start: %s", err == ERR_INVALID ?
		    "the configuration, or what it names, is wrong" :
		    err_message(err));
		/* Supervisors need not try again. */
		status = err == ERR_INVALID ? 2 : 1;
	}
	stop(&d.server);
	table_cache_free(d.cache);
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

/*
 * Bodies, points and rows are of any size and come and go: what is large is to
 * go back to the system when it is freed, not to raise the bounds from which on
 * it would, and threads are not to keep an arena each.
 */
static void set_up_memory(void)
{
	mallopt(M_MMAP_THRESHOLD, 1 << 20);
	mallopt(M_TRIM_THRESHOLD, 4 << 20);
	mallopt(M_ARENA_MAX, 2);
}

int main(int argc, char **argv)
{
	struct config config;

	set_up_memory();
	switch (config_parse(argc, argv, &config)) {
	case CONFIG_DONE:
		return 0;
	case CONFIG_BAD:
		return 2;
	case CONFIG_RUN:
		break;
	}
	if (config.make_token[0] != NULL)
		return access_make_token(config.make_token[0],
		    config.make_token[1]);
	if (config.list_devices)
		return list_devices();
	prepare_cache(&config);
	return config.fill_cache ? fill_cache(&config) : run(&config, argv);
}
