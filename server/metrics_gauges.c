#include <dirent.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#include "server/config.h"
#include "server/events.h"
#include "server/http.h"
#include "server/log.h"
#include "server/metrics_internal.h"
#include "server/scene_store.h"
#include "server/scheduler.h"
#include "server/server.h"
#include "server/task.h"
#include "server/volume_store.h"

#define GAUGE "gauge"
#define COUNTER "counter"

/* A sample of the family, with one label. */
static void print_one(struct metrics_page *p, const char *name,
    const char *value, double number)
{
	metrics_page_sample(p, "", (struct metrics_label[]){{name, value},
	    {NULL, NULL}}, number);
}

/* ---- what it is ---- */

static void print_build(struct metrics_page *p)
{
	metrics_page_family(p, "blobfield_build_info", GAUGE,
	    "The daemon's version; always 1.");
	print_one(p, "version", BLOBFIELD_VERSION, 1.0);
}

static void print_device(struct metrics_page *p,
    const struct device_info *device)
{
	if (device->name[0] == '\0')
		return; /* not open yet */
	metrics_page_family(p, "blobfield_device_info", GAUGE,
	    "The OpenCL device; always 1.");
	metrics_page_sample(p, "", (struct metrics_label[]){
		{"name", device->name}, {"vendor", device->vendor},
		{"version", device->version}, {"driver", device->driver},
		{"type", device->is_gpu ? "gpu" : "cpu"}, {NULL, NULL}}, 1.0);
}

/* ---- the device and its queue ---- */

static void print_queue(struct metrics_page *p,
    const struct scheduler_stats *s, const struct config *config)
{
	metrics_page_family(p, "blobfield_queue_jobs", GAUGE,
	    "Evaluations that wait, have begun, or have begun and wait for "
	    "their clients.");
	print_one(p, "state", "waiting", (double)s->waiting);
	print_one(p, "state", "running", (double)(s->running - s->stalled));
	print_one(p, "state", "stalled", (double)s->stalled);
	metrics_page_one(p, "blobfield_queue_jobs_max", GAUGE,
	    "Evaluations that may wait (--queue).", (double)config->queue);
	metrics_page_one(p, "blobfield_queue_held_bytes", GAUGE,
	    "Points, and answers that have not left, of evaluations.",
	    (double)s->held_bytes);
	metrics_page_one(p, "blobfield_jobs_completed_total", COUNTER,
	    "Evaluations that ended in any way, tasks' own among them.",
	    (double)s->completed);
	metrics_page_one(p, "blobfield_jobs_expired_total", COUNTER,
	    "Evaluations past their deadline.", (double)s->expired);
	metrics_page_one(p, "blobfield_jobs_abandoned_total", COUNTER,
	    "Evaluations whose clients had gone.", (double)s->abandoned);
}

static void print_launches(struct metrics_page *p,
    const struct scheduler_stats *s)
{
	metrics_page_one(p, "blobfield_device_points_total", COUNTER,
	    "Points evaluated.", (double)s->points);
	metrics_page_one(p, "blobfield_device_launches_total", COUNTER,
	    "Launches: of a piece of one evaluation, or of several small ones.",
	    (double)s->launches);
	metrics_page_one(p, "blobfield_device_launch_jobs_total", COUNTER,
	    "Evaluations in them, one in several pieces each time: over the "
	    "launches, the mean batch.", (double)s->launched);
	metrics_page_family(p, "blobfield_device_busy_seconds_total", COUNTER,
	    "Time of launches, by who asked.");
	print_one(p, "priority", "interactive", s->seconds[JOB_INTERACTIVE]);
	print_one(p, "priority", "bulk", s->seconds[JOB_BULK]);
	metrics_page_one(p, "blobfield_device_rebuilds_total", COUNTER,
	    "Times that a lost device was opened anew.", (double)s->rebuilds);
	metrics_page_one(p, "blobfield_table_bytes", GAUGE,
	    "Operator tables on the device.", (double)s->table_bytes);
	metrics_page_one(p, "blobfield_table_bytes_max", GAUGE,
	    "Most that operator tables may take (--table-memory).",
	    (double)s->table_bytes_most);
}

static void print_tasks(struct metrics_page *p, struct tasks *tasks)
{
	struct tasks_stats s;

	tasks_get_stats(tasks, &s);
	metrics_page_family(p, "blobfield_tasks", GAUGE,
	    "Meshes, pictures, rays, projections in hand.");
	print_one(p, "state", "waiting", (double)s.waiting);
	print_one(p, "state", "running", (double)s.running);
	metrics_page_one(p, "blobfield_tasks_held_bytes", GAUGE,
	    "Requests of tasks, and their answers that have not left.",
	    (double)s.held_bytes);
	metrics_page_one(p, "blobfield_tasks_completed_total", COUNTER,
	    "Tasks that ended in any way.", (double)s.completed);
	metrics_page_one(p, "blobfield_tasks_expired_total", COUNTER,
	    "Tasks past their deadline.", (double)s.expired);
	metrics_page_one(p, "blobfield_tasks_abandoned_total", COUNTER,
	    "Tasks whose clients had gone.", (double)s.abandoned);
}

/* ---- what is kept ---- */

static void print_store(struct metrics_page *p, const struct server *server)
{
	struct scene_store *store = server->scenes;

	metrics_page_one(p, "blobfield_scenes", GAUGE, "Scenes kept.",
	    (double)scene_store_count(store));
	metrics_page_one(p, "blobfield_scenes_max", GAUGE,
	    "Scenes that may be kept (--max-scenes).",
	    (double)server->config->max_scenes);
	metrics_page_one(p, "blobfield_scene_bytes", GAUGE,
	    "Memory that scenes take.", (double)scene_store_bytes(store));
	metrics_page_one(p, "blobfield_scene_bytes_max", GAUGE,
	    "Memory that scenes may take (--scene-memory).",
	    (double)server->config->scene_memory);
	metrics_page_one(p, "blobfield_scene_history_bytes", GAUGE,
	    "Texts of scenes' revisions but the present ones.",
	    (double)scene_store_history_bytes(store));
	metrics_page_one(p, "blobfield_store_ready", GAUGE,
	    "1: what is kept has been read.", scene_store_is_ready(store));
	metrics_page_one(p, "blobfield_store_well", GAUGE,
	    "1: changes can be kept now.", scene_store_is_well(store));
	metrics_page_one(p, "blobfield_store_changes_waiting", GAUGE,
	    "Changes that wait to be kept.",
	    (double)scene_store_waiting(store));
}

static void print_volumes(struct metrics_page *p, const struct server *server)
{
	struct volume_store_stats s;

	volume_store_get_stats(server->volumes, &s);
	metrics_page_one(p, "blobfield_volumes", GAUGE, "Volumes kept.",
	    (double)s.count);
	metrics_page_one(p, "blobfield_volume_bytes", GAUGE,
	    "Memory that volumes take.", (double)s.bytes);
	metrics_page_one(p, "blobfield_volume_bytes_max", GAUGE,
	    "Memory that volumes may take (--volume-memory).",
	    (double)server->config->device.volume_bytes);
}

/* ---- who is there ---- */

static void print_clients(struct metrics_page *p, const struct server *server)
{
	struct events_stats s;

	metrics_page_family(p, "blobfield_http_requests_active", GAUGE,
	    "Requests begun and not over; of them, those that have arrived.");
	print_one(p, "state", "begun", (double)http_active(server->http));
	print_one(p, "state", "arrived", (double)http_owed(server->http));
	metrics_page_one(p, "blobfield_http_connections_refused_total", COUNTER,
	    "Connections closed at once: too many of one address "
	    "(--max-connections-per-address).",
	    (double)http_refused(server->http));
	events_get_stats(server->events, &s);
	metrics_page_one(p, "blobfield_listeners", GAUGE,
	    "Streams of scenes' events.", (double)s.listeners);
	metrics_page_one(p, "blobfield_listeners_max", GAUGE,
	    "Streams of scenes' events that there may be (--max-listeners).",
	    (double)server->config->max_listeners);
	metrics_page_one(p, "blobfield_events_sent_total", COUNTER,
	    "Events sent to listeners.", (double)s.sent);
	metrics_page_one(p, "blobfield_listeners_cut_total", COUNTER,
	    "Listeners that were too slow.", (double)s.cut);
}

static void print_state(struct metrics_page *p, struct server *server,
    bool is_device_ready)
{
	bool draining = atomic_load(&server->draining);

	metrics_page_one(p, "blobfield_ready", GAUGE,
	    "1: as /readyz says.", !draining && is_device_ready &&
	    scene_store_is_ready(server->scenes));
	metrics_page_one(p, "blobfield_draining", GAUGE,
	    "1: the daemon is about to end.", draining);
	metrics_page_one(p, "blobfield_log_lines_lost_total", COUNTER,
	    "Lines of the log that could not be written.",
	    (double)log_lost());
}

/* ---- the process, named as all of Prometheus's clients do ---- */

static double count_files(void)
{
	DIR *folder = opendir("/proc/self/fd");
	double count = -1.0; /* its own */

	if (folder == NULL)
		return 0.0;
	for (struct dirent *entry; (entry = readdir(folder)) != NULL;)
		count += entry->d_name[0] != '.';
	closedir(folder);
	return count;
}

/* Pages: of the address space, and resident (proc(5), statm). */
static void read_memory(unsigned long out[static 2])
{
	FILE *file = fopen("/proc/self/statm", "re");

	out[0] = out[1] = 0;
	if (file == NULL)
		return;
	if (fscanf(file, "%lu %lu", &out[0], &out[1]) != 2)
		out[0] = out[1] = 0;
	fclose(file);
}

static double read_clock(clockid_t clock)
{
	struct timespec t = {0};

	clock_gettime(clock, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void print_process(struct metrics_page *p, double started)
{
	double page = (double)sysconf(_SC_PAGESIZE);
	struct rlimit files = {0};
	unsigned long pages[2];

	read_memory(pages);
	getrlimit(RLIMIT_NOFILE, &files);
	metrics_page_one(p, "process_cpu_seconds_total", COUNTER,
	    "Processor time, of user and system.",
	    read_clock(CLOCK_PROCESS_CPUTIME_ID));
	metrics_page_one(p, "process_resident_memory_bytes", GAUGE,
	    "Resident memory.", page * (double)pages[1]);
	metrics_page_one(p, "process_virtual_memory_bytes", GAUGE,
	    "Address space.", page * (double)pages[0]);
	metrics_page_one(p, "process_open_fds", GAUGE, "Open files.",
	    count_files());
	metrics_page_one(p, "process_max_fds", GAUGE,
	    "Most files that may be open.", (double)files.rlim_cur);
	metrics_page_one(p, "process_start_time_seconds", GAUGE,
	    "When the daemon was started, seconds since 1970.", started);
}

void metrics_print_gauges(struct metrics_page *p, struct server *server)
{
	struct scheduler_stats s;

	scheduler_get_stats(server->scheduler, &s);
	print_build(p);
	print_device(p, &s.device);
	print_queue(p, &s, server->config);
	print_launches(p, &s);
	print_tasks(p, server->tasks);
	print_store(p, server);
	print_volumes(p, server);
	print_clients(p, server);
	print_state(p, server, s.ready);
	print_process(p, server->metrics->started);
}
