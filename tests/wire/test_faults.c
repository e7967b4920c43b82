/*
 * Faults: the nth OpenCL call, allocation, write, fsync, open, send or thread
 * of a session with the real daemon fails, for every n. Each answer then is
 * right, or a problem that says what to do; and afterwards the same session
 * succeeds, with the same answers.
 *
 * As it stands some n are tried, for 0.3 s a kind, every other time with
 * BURST calls more that fail. FAULTS=all tries every one, alone; FAULTS=bursts
 * every one with those that follow; FAULTS=NUMBER only that; FAULT_SECONDS=60
 * as many as fit. FAULT_KIND=alloc: only that kind.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <math.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <CL/cl.h>
#include <cjson/cJSON.h>

#include "tests/fault/fault.h"
#include "tests/support/daemon.h"
#include "tests/support/folder.h"
#include "tests/support/http.h"
#include "tests/support/npy.h"
#include "tests/support/sanitized.h"

#define BIG_POINTS 20000
#define VOLUME_N 8

/* Seconds a kind, if not all n are tried. */
#define SHORT_SECONDS 0.3

/* Calls that fail after the nth, every other time. */
#define BURST 4

/* Bytes that a socket may not have taken when it is closed. */
#define LONG_BODY 65536

/* Failures told of in full. */
#define TOLD_MAX 100

/* ---- the session ---- */

enum check {
	CHECK_STATUS, /* of JSON also the names of the members */
	CHECK_BYTES   /* the body is what it was the first time */
};

/* What is kept, and the states it may be in. */
enum thing {
	NOTHING,
	A_SCENE,
	A_SCENE_WITH_VOLUME,
	A_VOLUME,
	THINGS
};

enum state {
	ABSENT,
	FIRST,
	PATCHED
};

struct step {
	const char *method, *path, *type, *body;
	size_t length;    /* 0: of a text */
	long status;
	enum check check;
	enum thing thing; /* that it changes: 2xx says that it is on the disk */
	enum state state; /* ... to this one */
};

#define OPERATOR "\"operators\":{\"o\":{\"profile\":{\"type\":\"bulge\"," \
	"\"k\":0.35},\"resolution\":16}}"
#define BLEND "{\"type\":\"union\",\"operator\":\"o\",\"children\":[" \
	"{\"type\":\"segment\",\"a\":[-1,0,0],\"b\":[0,0,2.6],\"radius\":0.2}," \
	"{\"type\":\"segment\",\"a\":[1,0,0],\"b\":[0,0,2.6],\"radius\":0.2}]}"
#define DOCUMENT "{\"format\":\"blobfield/1\"," OPERATOR ",\"root\":" BLEND "}"
#define POINTS "[[0,0,2.4],[0.5,0,1.2],[-1,0,0.1],[0.2,0.1,2.0]]"
#define SCENE "/v1/scenes/fault"
#define JSON "application/json"
#define OCTETS "application/octet-stream"

static float big_points[3 * BIG_POINTS];
static char *volume_file; /* npy */
static size_t volume_length;
static char volume_id[40];
static char volume_document[256], volume_path[64];
static char revision_path[128]; /* the scene before it was patched */

static struct step steps[] = {
	{"PUT", SCENE, JSON, DOCUMENT, 0, 201, CHECK_STATUS,
	    A_SCENE, FIRST},
	{"POST", "/v1/eval", JSON, "{\"scene\":" DOCUMENT ",\"points\":" POINTS
	    ",\"outputs\":[\"value\",\"gradient\",\"hessian\",\"color\"]}", 0,
	    200, CHECK_BYTES, NOTHING,
	    ABSENT},
	{"POST", SCENE "/eval", JSON, "{\"points\":" POINTS "}", 0, 200,
	    CHECK_BYTES, NOTHING,
	    ABSENT},
	{"POST", SCENE "/eval?outputs=value,gradient", OCTETS,
	    (const char *)big_points, sizeof big_points, 200, CHECK_BYTES,
	    NOTHING, ABSENT},
	{"PATCH", SCENE, "application/json-patch+json",
	    "[{\"op\":\"replace\",\"path\":\"/root/children/0/radius\","
	    "\"value\":0.3}]", 0, 200, CHECK_STATUS, A_SCENE, PATCHED},
	{"POST", SCENE "/eval", JSON, "{\"points\":" POINTS "}", 0, 200,
	    CHECK_BYTES, NOTHING,
	    ABSENT},
	{"GET", SCENE "/revisions", NULL, NULL, 0, 200, CHECK_STATUS, NOTHING,
	    ABSENT},
	{"GET", revision_path, NULL, NULL, 0, 200, CHECK_BYTES, NOTHING,
	    ABSENT},
	{"POST", SCENE "/mesh?format=stl", JSON, "{\"resolution\":12}", 0, 200,
	    CHECK_BYTES, NOTHING,
	    ABSENT},
	{"POST", SCENE "/raycast", JSON, "{\"rays\":[[0,-5,2.4,0,1,0]]}", 0,
	    200, CHECK_STATUS, NOTHING,
	    ABSENT},
	{"POST", SCENE "/slice", JSON, "{\"width\":24,\"height\":24}", 0, 200,
	    CHECK_BYTES, NOTHING,
	    ABSENT},
	{"POST", "/v1/volumes?min=-1,-1,-1&max=1,1,1&kind=field",
	    "application/x-npy", NULL, 0, 201, CHECK_STATUS, A_VOLUME, FIRST},
	{"PUT", SCENE "-volume", JSON, volume_document, 0, 201, CHECK_STATUS,
	    A_SCENE_WITH_VOLUME, FIRST},
	{"POST", SCENE "-volume/eval", JSON, "{\"points\":[[0,0,0],"
	    "[0.3,0.1,0.2]]}", 0, 200, CHECK_BYTES, NOTHING,
	    ABSENT},
	{"GET", SCENE, NULL, NULL, 0, 200, CHECK_BYTES, NOTHING,
	    ABSENT},
	{"GET", "/v1/scenes", NULL, NULL, 0, 200, CHECK_STATUS, NOTHING,
	    ABSENT},
	{"GET", "/metrics", NULL, NULL, 0, 200, CHECK_STATUS, NOTHING,
	    ABSENT},
	{"DELETE", SCENE "-volume", NULL, NULL, 0, 204, CHECK_STATUS,
	    A_SCENE_WITH_VOLUME, ABSENT},
	{"DELETE", volume_path, NULL, NULL, 0, 204, CHECK_STATUS, A_VOLUME,
	    ABSENT},
	{"DELETE", SCENE, NULL, NULL, 0, 204, CHECK_STATUS, A_SCENE, ABSENT},
};

#define STEPS (sizeof steps / sizeof *steps)
#define DELETIONS 3        /* the last ones */
#define GET_PATCHED 14     /* the scene as it was patched */

static struct http_reply golden[STEPS]; /* of those whose bytes count */

static void make_volume(void)
{
	float samples[VOLUME_N * VOLUME_N * VOLUME_N];

	for (int i = 0; i < VOLUME_N * VOLUME_N * VOLUME_N; i++)
		samples[i] = (float)(i % 13) / 13.0f;
	volume_file = npy_file("<f4", "False", "(8, 8, 8)", samples,
	    sizeof samples, &volume_length);
}

static void make_session(void)
{
	for (int i = 0; i < 3 * BIG_POINTS; i++)
		big_points[i] = (float)((i * 7919) % 4001) / 1000.0f - 1.5f;
	make_volume();
	for (size_t i = 0; i < STEPS; i++) {
		if (steps[i].type == NULL)
			continue;
		if (steps[i].body == NULL) {
			steps[i].body = volume_file;
			steps[i].length = volume_length;
		}
	}
}

static void name_volume(const char *id)
{
	snprintf(volume_id, sizeof volume_id, "%s", id);
	snprintf(volume_path, sizeof volume_path, "/v1/volumes/%s", id);
	snprintf(volume_document, sizeof volume_document, "{\"format\":"
	    "\"blobfield/1\",\"root\":{\"type\":\"volume\",\"volume\":\"%s\"}}",
	    id);
}

/* By what the answer says that was kept. */
static void name_revision(const struct http_reply *reply)
{
	cJSON *json = cJSON_Parse(reply->body);

	snprintf(revision_path, sizeof revision_path, SCENE "?revision=%s",
	    cJSON_GetStringValue(cJSON_GetObjectItem(json, "revision")));
	cJSON_Delete(json);
}

static void send_step(const char *url, const struct step *step,
    struct http_reply *reply)
{
	char type[64];

	snprintf(type, sizeof type, "Content-Type: %s",
	    step->type != NULL ? step->type : "");
	http_do(url, &(struct http_request){
		.method = step->method,
		.path = step->path,
		.body = step->body,
		.length = step->length > 0 || step->body == NULL ?
		    step->length : strlen(step->body),
		.headers = {step->type != NULL ? type : NULL,
		    step->type != NULL && strcmp(step->type, OCTETS) == 0 ?
		    "Accept: " OCTETS : NULL},
	}, reply);
}

/* ---- the daemon with faults ---- */

struct bed {
	struct daemon daemon;
	struct fault_control *control;
	char folder[PATH_MAX], control_path[PATH_MAX + 16];
	char data[PATH_MAX + 16], cache[PATH_MAX + 16];
	char *library;
	int failures, deaths, rounds;
	unsigned possible[THINGS]; /* the states each may be in: bits */
	unsigned long tried, bad[600]; /* answers by status */
	unsigned long start_calls[FAULT_KINDS];
	bool is_stopped; /* only starts are tried from now on */
};

static struct bed beds[2]; /* with fail_libc.so, with fail_cl.so */

static const char *const kind_names[FAULT_KINDS] = {"cl", "alloc", "write",
	"sync", "open", "send", "thread"};

/* The library, two folders above the test program's. */
static char *library_path(const char *name)
{
	static char path[PATH_MAX + 64];
	char self[PATH_MAX];
	ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);

	assert_true(length > 0);
	self[length] = '\0';
	for (int i = 0; i < 2; i++)
		*strrchr(self, '/') = '\0';
	snprintf(path, sizeof path, "%s/fault/%s", self, name);
	if (access(path, R_OK) != 0)
		fail_msg("there is no %s", path);
	return path;
}

static void disarm(struct bed *bed)
{
	atomic_store(&bed->control->kind, FAULT_KINDS);
}

/* Has calls first to last of kind, counted from now on, fail with code. */
static void arm(struct bed *bed, enum fault_kind kind, unsigned long first,
    unsigned long last, int code)
{
	struct fault_control *c = bed->control;

	disarm(bed);
	atomic_store(&c->failed, 0);
	for (int i = 0; i < FAULT_KINDS; i++)
		atomic_store(&c->calls[i], 0);
	atomic_store(&c->first, first);
	atomic_store(&c->last, last);
	atomic_store(&c->code, code);
	atomic_store(&c->kind, (int)kind);
}

static void start(struct bed *bed)
{
	const char *const arguments[] = {"--no-measure", "--data", bed->data,
		"--cache", bed->cache, "--quiet", NULL};

	arm(bed, FAULT_KINDS, 0, 0, 0);
	setenv("FAULT_CONTROL", bed->control_path, 1);
	setenv("LD_PRELOAD", bed->library, 1);
	daemon_start(&bed->daemon, arguments);
	unsetenv("LD_PRELOAD");
	unsetenv("FAULT_CONTROL");
	daemon_await_ready(&bed->daemon);
}

static void make_bed(struct bed *bed, const char *library)
{
	char folder[PATH_MAX];
	int fd;

	folder_make(folder);
	*bed = (struct bed){.library = strdup(library_path(library))};
	strcpy(bed->folder, folder);
	snprintf(bed->control_path, sizeof bed->control_path, "%s/control",
	    folder);
	snprintf(bed->data, sizeof bed->data, "%s/data", folder);
	snprintf(bed->cache, sizeof bed->cache, "%s/cache", folder);
	fd = open(bed->control_path, O_RDWR | O_CREAT | O_EXCL, 0600);
	assert_true(fd >= 0);
	assert_int_equal(ftruncate(fd, sizeof *bed->control), 0);
	bed->control = mmap(NULL, sizeof *bed->control,
	    PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
	assert_ptr_not_equal(bed->control, MAP_FAILED);
	close(fd);
	snprintf(bed->control->folder, sizeof bed->control->folder, "%.4000s",
	    bed->data);
	start(bed);
}

static int free_bed(struct bed *bed)
{
	int status = 0;

	if (bed->control == NULL)
		return 0;
	disarm(bed);
	if (!bed->is_stopped)
		status = daemon_stop(&bed->daemon, SIGTERM);
	munmap(bed->control, sizeof *bed->control);
	folder_remove(bed->folder);
	free(bed->library);
	return status;
}

static bool is_alive(struct bed *bed)
{
	int status;

	if (waitpid(bed->daemon.pid, &status, WNOHANG) == 0)
		return true;
	fprintf(stderr, "the daemon is dead: %s %d\n", WIFSIGNALED(status) ?
	    "signal" : "status", WIFSIGNALED(status) ? WTERMSIG(status) :
	    WEXITSTATUS(status));
	return false;
}

/* Whether it is ready within so many seconds. */
static bool is_ready(struct bed *bed, double seconds)
{
	for (int i = 0; i < seconds * 100.0; i++) {
		struct http_reply reply;

		http_get(bed->daemon.url, "/readyz", &reply);
		http_reply_fini(&reply);
		if (reply.status == 200)
			return true;
		usleep(10000);
	}
	return false;
}

static size_t count_descriptors(struct bed *bed)
{
	char path[64];
	size_t count = 0;
	DIR *folder;

	snprintf(path, sizeof path, "/proc/%d/fd", bed->daemon.pid);
	folder = opendir(path);
	while (folder != NULL && readdir(folder) != NULL)
		count++;
	if (folder != NULL)
		closedir(folder);
	return count;
}

static double resident_mb(struct bed *bed)
{
	char path[64];
	unsigned long size = 0, resident = 0;
	FILE *file;

	snprintf(path, sizeof path, "/proc/%d/statm", bed->daemon.pid);
	file = fopen(path, "r");
	if (file != NULL) {
		if (fscanf(file, "%lu %lu", &size, &resident) != 2)
			resident = 0;
		fclose(file);
	}
	return (double)resident * (double)sysconf(_SC_PAGESIZE) * 1e-6;
}

/* ---- judging ---- */

/* What is wrong, for the first few times. */
__attribute__((format(printf, 2, 3)))
static void complain(struct bed *bed, const char *format, ...)
{
	const struct fault_control *c = bed->control;
	va_list args;

	if (bed->failures++ >= TOLD_MAX)
		return;
	fprintf(stderr, "call %lu (%s, code %d, at %#lx of the program): ",
	    atomic_load(&c->first), c->name, atomic_load(&c->code),
	    atomic_load(&c->at));
	va_start(args, format);
	vfprintf(stderr, format, args);
	va_end(args);
	fputc('\n', stderr);
}

static bool is_problem(const struct http_reply *reply)
{
	cJSON *json = cJSON_Parse(reply->body);
	const cJSON *status = cJSON_GetObjectItem(json, "status");
	bool is = cJSON_IsNumber(status) &&
	    (long)status->valuedouble == reply->status &&
	    cJSON_IsString(cJSON_GetObjectItem(json, "type"));

	cJSON_Delete(json);
	return is;
}

/* Whether both have the same members, down to the numbers of elements. */
static bool is_alike(const cJSON *a, const cJSON *b)
{
	const cJSON *x, *y;

	if (a == NULL || b == NULL || a->type != b->type)
		return a == b;
	x = a->child;
	y = b->child;
	for (; x != NULL && y != NULL; x = x->next, y = y->next)
		if ((x->string != NULL && strcmp(x->string, y->string) != 0) ||
		    !is_alike(x, y))
			return false;
	return x == y;
}

static bool is_like(const char *a, const char *b)
{
	cJSON *x = cJSON_Parse(a), *y = cJSON_Parse(b);
	bool is = is_alike(x, y);

	cJSON_Delete(x);
	cJSON_Delete(y);
	return is;
}

static bool is_right(size_t i, const struct http_reply *reply)
{
	if (reply->status != steps[i].status)
		return false;
	if (steps[i].check == CHECK_STATUS)
		return reply->status == 204 ||
		    is_like(reply->body, golden[i].body);
	return reply->length == golden[i].length &&
	    memcmp(reply->body, golden[i].body, reply->length) == 0;
}

/* Whether reply to step is an honest refusal. */
static bool is_clean(const struct step *step, const struct http_reply *reply,
    enum fault_kind kind, bool has_failed)
{
	char after[16];
	long status = reply->status;

	/* Without memory for a request nothing is read of its body, and what
	 * is answered may be lost to the reset, if the body is long. */
	if (status == 0)
		return kind == FAULT_SEND || (kind == FAULT_ALLOC &&
		    step->length > LONG_BODY);
	http_header(reply, "Retry-After", after, sizeof after);
	/* Where memory fails for long there may be none for words. */
	if (status == 503)
		return (is_problem(reply) || (kind == FAULT_ALLOC &&
		    reply->length == 0)) && after[0] != '\0';
	if (status == 500 || status == 507)
		return is_problem(reply);
	/* What an earlier step should have made is not there, or what it should
	 * have removed is. */
	return has_failed && (status == 200 || status == 201 ||
	    status == 204 || status == 404 || status == 409 || status == 422);
}

/* What step's answer says of what is kept now. */
static void note_change(struct bed *bed, const struct step *step, long status)
{
	unsigned *possible = &bed->possible[step->thing];

	if (status >= 200 && status < 300)
		*possible = 1u << step->state;
	else if (status == 0 || status >= 500)
		*possible |= 1u << step->state;
}

/* The first count steps of the session, with a fault among them. */
static void run_faulty(struct bed *bed, enum fault_kind kind, size_t count)
{
	bool has_failed = false;

	for (int i = 0; i < THINGS; i++)
		bed->possible[i] = 1u << ABSENT;
	for (size_t i = 0; i < count; i++) {
		struct http_reply reply;

		send_step(bed->daemon.url, &steps[i], &reply);
		bed->bad[reply.status >= 0 && reply.status < 600 ?
		    reply.status : 0]++;
		if (!is_right(i, &reply)) {
			bool changed = reply.status == steps[i].status;

			/* A patch that failed leaves the scene as it was. */
			if (!is_clean(&steps[i], &reply, kind, has_failed) ||
			    (changed && !has_failed))
				complain(bed, "step %zu: %s %s: %ld %.300s", i,
				    steps[i].method, steps[i].path,
				    reply.status, reply.status == 200 ?
				    "another answer" : reply.body != NULL ?
				    reply.body : "");
			has_failed = true;
		}
		note_change(bed, &steps[i], reply.status);
		http_reply_fini(&reply);
	}
}

/* Which state of a scene or volume reply is, as a bit; 0: none. */
static unsigned state_of(const struct http_reply *reply, const char *first)
{
	if (reply->status == 404)
		return 1u << ABSENT;
	if (reply->status != 200)
		return 0;
	if (first == NULL || strcmp(reply->body, first) == 0)
		return 1u << FIRST;
	return strcmp(reply->body, golden[GET_PATCHED].body) == 0 ?
	    1u << PATCHED : 0;
}

/* What was acknowledged is there after a restart, what was not is there or is
 * not. */
static void check_kept(struct bed *bed)
{
	const struct {
		enum thing thing;
		const char *path, *first;
	} things[] = {
		{A_SCENE, SCENE, DOCUMENT},
		{A_SCENE_WITH_VOLUME, SCENE "-volume", volume_document},
		{A_VOLUME, volume_path, NULL},
	};

	for (int i = 0; i < 3; i++) {
		struct http_reply reply;
		unsigned state;

		http_get(bed->daemon.url, things[i].path, &reply);
		state = state_of(&reply, things[i].first);
		if ((state & bed->possible[things[i].thing]) == 0)
			complain(bed, "after a restart %s is %ld, state %#x "
			    "of the possible %#x: %.200s", things[i].path,
			    reply.status, state,
			    bed->possible[things[i].thing], reply.body);
		http_reply_fini(&reply);
	}
}

/* The session without: all as it was the first time. */
static bool run_clean(struct bed *bed)
{
	bool is_fine = true;

	for (size_t i = 0; i < STEPS; i++) {
		struct http_reply reply;

		send_step(bed->daemon.url, &steps[i], &reply);
		if (!is_right(i, &reply)) {
			complain(bed, "then step %zu: %s %s: %ld %.300s", i,
			    steps[i].method, steps[i].path, reply.status,
			    reply.status == 200 ? "another answer" :
			    reply.body != NULL ? reply.body : "");
			is_fine = false;
		}
		http_reply_fini(&reply);
	}
	return is_fine;
}

/* Forgets what the session may have left. */
static void clean_up(struct bed *bed)
{
	for (size_t i = STEPS - DELETIONS; i < STEPS; i++) {
		struct http_reply reply;

		send_step(bed->daemon.url, &steps[i], &reply);
		http_reply_fini(&reply);
	}
}

/* The first session, which says what is right. */
static void learn(struct bed *bed)
{
	for (size_t i = 0; i < STEPS; i++) {
		struct http_reply reply;

		send_step(bed->daemon.url, &steps[i], &reply);
		if (reply.status != steps[i].status)
			fail_msg("%s %s: %ld %s", steps[i].method,
			    steps[i].path, reply.status, reply.body);
		if (steps[i].body == volume_file) {
			cJSON *json = cJSON_Parse(reply.body);

			name_volume(cJSON_GetStringValue(
			    cJSON_GetObjectItem(json, "id")));
			cJSON_Delete(json);
		}
		if (i == 0)
			name_revision(&reply);
		http_reply_fini(&golden[i]);
		golden[i] = reply;
	}
}

/* ---- every n ---- */

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double seconds(void)
{
	const char *given = getenv("FAULT_SECONDS");

	return given != NULL ? atof(given) : SHORT_SECONDS;
}

/* The errors of kind, by turns. */
static int code_of(enum fault_kind kind, unsigned long n)
{
	static const int cl[] = {CL_OUT_OF_RESOURCES, CL_DEVICE_NOT_AVAILABLE,
		CL_OUT_OF_HOST_MEMORY, CL_INVALID_COMMAND_QUEUE,
		CL_MEM_OBJECT_ALLOCATION_FAILURE, CL_INVALID_CONTEXT};
	static const int files[] = {EIO, ENOSPC, 0};

	if (kind == FAULT_CL)
		return cl[n % (sizeof cl / sizeof *cl)];
	return kind == FAULT_OPEN ? EMFILE :
	    files[n % (sizeof files / sizeof *files)];
}

static void restart(struct bed *bed, int signal_number)
{
	daemon_stop(&bed->daemon, signal_number);
	start(bed);
}

/* Whether what was acknowledged is to be looked at after a restart. */
static bool is_about_disk(enum fault_kind kind)
{
	return kind == FAULT_WRITE || kind == FAULT_SYNC;
}

/* Lets calls n to last of a session fail, of its first count steps. */
static void try(struct bed *bed, enum fault_kind kind, unsigned long n,
    unsigned long last, int code, size_t count)
{
	bool is_kept = is_about_disk(kind);

	arm(bed, kind, n, last, code);
	run_faulty(bed, kind, count);
	disarm(bed);
	bed->tried += atomic_load(&bed->control->failed) > 0;
	if (!is_alive(bed)) {
		complain(bed, "the daemon is dead");
		bed->deaths++;
		close(bed->daemon.out);
		start(bed);
	} else if (!is_ready(bed, 30.0)) {
		complain(bed, "not ready again after 30 s");
		restart(bed, SIGKILL);
	} else if (is_kept) {
		restart(bed, SIGKILL);
	}
	if (is_kept)
		check_kept(bed);
	clean_up(bed);
	if (!run_clean(bed))
		restart(bed, SIGKILL);
	clean_up(bed);
}

/* What is deleted in the end tells little of what was kept: so without that,
 * too, where it matters. */
static void try_ways(struct bed *bed, enum fault_kind kind, unsigned long n,
    bool is_burst)
{
	unsigned long last = is_burst ? n + BURST : n;
	int code = code_of(kind, n + (unsigned long)bed->rounds++);

	try(bed, kind, n, last, code, STEPS);
	if (is_about_disk(kind))
		try(bed, kind, n, last, code, STEPS - DELETIONS);
}

/* Which n come: all of them, or as many as there is time for, spread evenly. */
static void try_all(struct bed *bed, enum fault_kind kind, unsigned long most)
{
	const char *which = getenv("FAULTS");
	double end = now() + seconds();
	bool bursts = which != NULL && strcmp(which, "bursts") == 0;

	if (which != NULL && !bursts && strcmp(which, "all") != 0) {
		try_ways(bed, kind, strtoul(which, NULL, 10), false);
	} else if (which != NULL) {
		for (unsigned long n = 1; n <= most; n++)
			try_ways(bed, kind, n, bursts);
	} else {
		/* Steps of the golden section meet no period. */
		for (unsigned long i = 0; now() < end; i++)
			try_ways(bed, kind, 1 + (unsigned long)(fmod(0.5 +
			    0.6180339887 * (double)i, 1.0) * (double)most),
			    i % 2 == 1);
	}
}

static void report(struct bed *bed, enum fault_kind kind, unsigned long most,
    size_t descriptors, double resident)
{
	printf("measured: %s: %lu of about %lu calls failed, %d deaths, %d "
	    "complaints; answers", kind_names[kind], bed->tried, most,
	    bed->deaths, bed->failures);
	for (int i = 0; i < 600; i++)
		if (bed->bad[i] > 0)
			printf(" %d: %lu", i, bed->bad[i]);
	printf("; descriptors %zu, then %zu; %.0f MB, then %.0f\n",
	    descriptors, count_descriptors(bed), resident, resident_mb(bed));
}

/* ---- starting ---- */

/* The store may be away after a fault, for a while. */
static void await_store(struct bed *bed)
{
	struct http_reply reply = {.status = 503};

	for (int i = 0; i < 1000 && reply.status == 503; i++) {
		usleep(i == 0 ? 0 : 10000);
		send_step(bed->daemon.url, &steps[0], &reply);
		http_reply_fini(&reply);
	}
}

/* Starts the daemon while call n of kind fails, until it is ready, or ends. */
static void try_start(struct bed *bed, enum fault_kind kind, unsigned long n,
    int code)
{
	char log[PATH_MAX + 16], text[400] = "";
	const char *binary = getenv("BLOBFIELDD");
	int status = 0, ends[2];
	struct daemon *d = &bed->daemon;
	bool has_ended = false;
	ssize_t length = 0;
	FILE *file;

	snprintf(log, sizeof log, "%s/log", bed->folder);
	assert_int_equal(pipe(ends), 0);
	arm(bed, kind, n, n, code);
	d->pid = fork();
	assert_true(d->pid >= 0);
	if (d->pid == 0) {
		prctl(PR_SET_PDEATHSIG, SIGKILL);
		setenv("FAULT_CONTROL", bed->control_path, 1);
		setenv("LD_PRELOAD", bed->library, 1);
		dup2(ends[1], STDOUT_FILENO);
		dup2(open(log, O_WRONLY | O_CREAT | O_TRUNC, 0600),
		    STDERR_FILENO);
		execl(binary, binary, "--listen", "127.0.0.1:0",
		    "--no-measure", "--data", bed->data, "--cache",
		    bed->cache, (char *)NULL);
		_exit(127);
	}
	close(ends[1]);
	while (length < (ssize_t)sizeof text - 1 &&
	    strchr(text, '\n') == NULL) {
		ssize_t got = read(ends[0], text + length,
		    sizeof text - 1 - (size_t)length);

		if (got <= 0)
			break;
		length += got;
	}
	close(ends[0]);
	d->url[0] = '\0';
	sscanf(text, "blobfieldd listening on %255s", d->url);
	for (int i = 0; i < 3000 && !has_ended; i++) {
		has_ended = waitpid(d->pid, &status, WNOHANG) == d->pid;
		if (!has_ended && d->url[0] != '\0' && is_ready(bed, 0.015))
			break;
		usleep(has_ended ? 0 : 10000);
	}
	disarm(bed);
	bed->tried += atomic_load(&bed->control->failed) > 0;
	file = fopen(log, "r");
	length = file != NULL ? (ssize_t)fread(text, 1, sizeof text - 1, file) :
	    0;
	text[length] = '\0';
	if (file != NULL)
		fclose(file);
	if (has_ended) {
		bed->bad[WIFEXITED(status) ? WEXITSTATUS(status) : 599]++;
		if (!WIFEXITED(status) || WEXITSTATUS(status) == 0 ||
		    WEXITSTATUS(status) > 2)
			complain(bed, "starting ended with status %#x", status);
		else if (strstr(text, "error") == NULL)
			complain(bed, "starting failed without a word");
		return;
	}
	bed->bad[200]++;
	if (!is_ready(bed, 1.0)) {
		complain(bed, "neither ready nor ended after 30 s");
	} else {
		await_store(bed);
		clean_up(bed);
		run_clean(bed);
	}
	kill(d->pid, SIGTERM);
	for (int i = 0; i < 3000 &&
	    waitpid(d->pid, &status, WNOHANG) != d->pid; i++)
		usleep(10000);
	if (status != 0)
		complain(bed, "then stopping ended with status %#x", status);
}

/* Counts the calls of a start that goes well; the daemon is stopped then. */
static void learn_start(struct bed *bed)
{
	if (bed->is_stopped)
		return;
	assert_int_equal(daemon_stop(&bed->daemon, SIGTERM), 0);
	start(bed);
	for (int i = 0; i < FAULT_KINDS; i++)
		bed->start_calls[i] = atomic_load(&bed->control->calls[i]);
	assert_int_equal(daemon_stop(&bed->daemon, SIGTERM), 0);
	bed->is_stopped = true;
}

static void try_starts(struct bed *bed, enum fault_kind kind)
{
	const char *which = getenv("FAULTS");
	bool all = which != NULL && strcmp(which, "all") == 0;
	double end = now() + seconds();
	unsigned long most = bed->start_calls[kind];

	assert_true(most > 0);
	for (unsigned long i = 0; all ? i < most : now() < end; i++)
		try_start(bed, kind, all ? i + 1 : 1 + (unsigned long)(fmod(
		    0.3 + 0.6180339887 * (double)i, 1.0) * (double)most),
		    code_of(kind, i));
	printf("measured: %s at the start: %lu of about %lu calls failed, %d "
	    "complaints;", kind_names[kind], bed->tried, most, bed->failures);
	for (int i = 0; i < 600; i++)
		if (bed->bad[i] > 0)
			printf(" %s %d: %lu", i < 100 ? "ended with" :
			    "status", i, bed->bad[i]);
	printf("\n");
}

static bool is_asked_for(enum fault_kind kind)
{
	const char *only = getenv("FAULT_KIND");

	return only == NULL || strcmp(only, kind_names[kind]) == 0;
}

/* The one with that library, for all kinds that it has. */
static struct bed *use_bed(const char *library)
{
	struct bed *bed = &beds[strcmp(library, "fail_cl.so") == 0];

	if (bed->control == NULL) {
		make_bed(bed, library);
		learn(bed);
	}
	bed->failures = bed->deaths = bed->rounds = 0;
	bed->tried = 0;
	memset(bed->bad, 0, sizeof bed->bad);
	return bed;
}

static int free_beds(void **state)
{
	(void)state;
	return free_bed(&beds[0]) | free_bed(&beds[1]);
}

static void check_kind(enum fault_kind kind, const char *library)
{
	struct bed *bed;
	size_t descriptors;
	double resident;
	unsigned long most;

	if (SANITIZED || getenv("BLOBFIELD_PROXY") != NULL ||
	    !is_asked_for(kind)) {
		printf("skipped: not with a sanitizer or a proxy, or not "
		    "asked for\n");
		skip();
	}
	bed = use_bed(library);
	for (int i = 0; i < 2; i++) {
		arm(bed, FAULT_KINDS, 0, 0, 0);
		assert_true(run_clean(bed));
	}
	most = atomic_load(&bed->control->calls[kind]);
	descriptors = count_descriptors(bed);
	resident = resident_mb(bed);
	assert_true(most > 0);
	try_all(bed, kind, most);
	report(bed, kind, most, descriptors, resident);
	assert_int_equal(bed->failures, 0);
	assert_true(bed->tried > 0);
}

static void test_the_nth_opencl_call_fails(void **state)
{
	(void)state;
	check_kind(FAULT_CL, "fail_cl.so");
}

static void test_the_nth_allocation_fails(void **state)
{
	(void)state;
	check_kind(FAULT_ALLOC, "fail_libc.so");
}

static void test_the_nth_write_fails(void **state)
{
	(void)state;
	check_kind(FAULT_WRITE, "fail_libc.so");
}

static void test_the_nth_fsync_fails(void **state)
{
	(void)state;
	check_kind(FAULT_SYNC, "fail_libc.so");
}

static void test_the_nth_send_fails(void **state)
{
	(void)state;
	check_kind(FAULT_SEND, "fail_libc.so");
}

static void check_start(enum fault_kind kind, const char *library)
{
	struct bed *bed;

	if (SANITIZED || getenv("BLOBFIELD_PROXY") != NULL ||
	    getenv("BLOBFIELDD") == NULL || !is_asked_for(kind)) {
		printf("skipped: not with a sanitizer or a proxy, or not "
		    "asked for\n");
		skip();
	}
	bed = use_bed(library);
	learn_start(bed);
	try_starts(bed, kind);
	assert_int_equal(bed->failures, 0);
}

static void test_a_start_without_some_memory(void **state)
{
	(void)state;
	check_start(FAULT_ALLOC, "fail_libc.so");
}

static void test_a_start_with_a_failing_disk(void **state)
{
	(void)state;
	check_start(FAULT_WRITE, "fail_libc.so");
}

static void test_a_start_with_files_that_cannot_be_opened(void **state)
{
	(void)state;
	check_start(FAULT_OPEN, "fail_libc.so");
}

static void test_a_start_without_some_threads(void **state)
{
	(void)state;
	check_start(FAULT_THREAD, "fail_libc.so");
}

static void test_a_start_with_a_failing_device(void **state)
{
	(void)state;
	check_start(FAULT_CL, "fail_cl.so");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_nth_opencl_call_fails),
		cmocka_unit_test(test_the_nth_allocation_fails),
		cmocka_unit_test(test_the_nth_write_fails),
		cmocka_unit_test(test_the_nth_fsync_fails),
		cmocka_unit_test(test_the_nth_send_fails),
		cmocka_unit_test(test_a_start_without_some_memory),
		cmocka_unit_test(test_a_start_with_a_failing_disk),
		cmocka_unit_test(
		    test_a_start_with_files_that_cannot_be_opened),
		cmocka_unit_test(test_a_start_without_some_threads),
		cmocka_unit_test(test_a_start_with_a_failing_device),
	};

	setvbuf(stdout, NULL, _IOLBF, 0);
	make_session();
	return cmocka_run_group_tests(tests, NULL, free_beds);
}
