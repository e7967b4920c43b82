/*
 * Events of scenes: their order and ids, resuming, what has been missed, many
 * listeners while many write, slow ones, and how streams end.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "tests/support/daemon.h"
#include "tests/support/http.h"
#include "tests/support/load.h"
#include "tests/support/sanitized.h"
#include "tests/support/sse.h"

#define HISTORY 16 /* revisions that are kept */
#define WAIT 5000  /* milliseconds for an event that must come */

#define LISTENERS 200
#define WRITERS 4
#define CHANGES (SANITIZED ? 100 : 500) /* of all writers */

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* The number that the summary in reply has, which is freed. */
static long sequence_of(struct http_reply *reply)
{
	cJSON *json = cJSON_Parse(reply->body);
	const char *text = cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "sequence"));
	long sequence = text != NULL ? atol(text) : -1;

	cJSON_Delete(json);
	http_reply_fini(reply);
	return sequence;
}

/* Makes the scene's name another one; the change's sequence. */
static long rename_to(const char *url, const char *id, int n)
{
	char document[200], path[80];
	struct http_reply reply;

	snprintf(document, sizeof document, "{\"format\":\"blobfield/1\","
	    "\"name\":\"%d\",\"root\":{\"type\":\"point\",\"center\":[0,0,0],"
	    "\"radius\":1}}", n);
	snprintf(path, sizeof path, "/v1/scenes/%s", id);
	http_json(url, "PUT", path, document, &reply);
	assert_true(reply.status == 200 || reply.status == 201);
	return sequence_of(&reply);
}

/* Makes it count others, one after the other, over one connection; the last
 * one's sequence. */
static long rename_often(int port, const char *id, int count)
{
	char document[200], path[80], *at;
	int fd = load_connect(port);
	long sequence = -1;

	snprintf(path, sizeof path, "/v1/scenes/%s", id);
	for (int i = 0; i < count; i++) {
		struct load_request request;
		struct load_answer answer;

		snprintf(document, sizeof document, "{\"format\":"
		    "\"blobfield/1\",\"name\":\"often %d\",\"root\":"
		    "{\"type\":\"point\",\"center\":[0,0,0],"
		    "\"radius\":1}}", i);
		request = load_request_make("PUT", path,
		    "Content-Type: application/json\r\n", document,
		    strlen(document));
		assert_int_equal(load_exchange(fd, &request, true, &answer),
		    0);
		assert_int_equal(answer.status, 200);
		at = strstr(answer.body, "\"sequence\":\"");
		assert_non_null(at);
		sequence = atol(at + 12);
		free(answer.body);
		load_request_fini(&request);
	}
	close(fd);
	return sequence;
}

static void delete(const char *url, const char *id)
{
	struct http_reply reply;
	char path[80];

	snprintf(path, sizeof path, "/v1/scenes/%s", id);
	http_do(url, &(struct http_request){.method = "DELETE", .path = path},
	    &reply);
	assert_int_equal(reply.status, 204);
	http_reply_fini(&reply);
}

static void listen_to(const struct daemon *d, struct sse *s, const char *id,
    long after)
{
	char path[80], header[80] = "";

	snprintf(path, sizeof path, "/v1/scenes/%s/events", id);
	if (after >= 0)
		snprintf(header, sizeof header, "Last-Event-ID: %ld\r\n",
		    after);
	if (!sse_open(s, d->port, path, header))
		fail_msg("%s", s->head);
}

static bool has_missed(const struct sse_event *event)
{
	return strstr(event->data, "\"missed\":true") != NULL;
}

/* The next event must be a revision of that sequence. */
static void assert_revision(struct sse *s, long sequence, bool missed)
{
	struct sse_event event;

	do
		assert_int_equal(sse_next(s, &event, WAIT), SSE_EVENT);
	while (event.is_comment);
	assert_string_equal(event.event, "revision");
	assert_int_equal(atol(event.id), sequence);
	assert_int_equal(has_missed(&event), missed);
}

static void assert_nothing(struct sse *s)
{
	struct sse_event event;

	assert_int_equal(sse_next(s, &event, 100), SSE_NOTHING);
}

/* ---- one listener ---- */

static struct sse idle; /* for the last test */
static double idle_since;

static void test_an_idle_listener_begins(void **state)
{
	struct daemon *d = *state;
	long sequence = rename_to(d->url, "idle", 0);

	listen_to(d, &idle, "idle", -1);
	assert_revision(&idle, sequence, false);
	idle_since = now();
}

static void test_the_present_comes_first_then_changes(void **state)
{
	struct daemon *d = *state;
	long first = rename_to(d->url, "a", 1), sequence;
	struct sse_event event;
	struct sse s;
	cJSON *json;

	listen_to(d, &s, "a", -1);
	assert_non_null(strstr(s.head, "Content-Type: text/event-stream"));
	assert_non_null(strstr(s.head, "Cache-Control: no-store"));
	assert_non_null(strstr(s.head, "X-Accel-Buffering: no"));
	assert_int_equal(sse_next(&s, &event, WAIT), SSE_EVENT);
	assert_int_equal(s.retry, 2000);
	assert_int_equal(atol(event.id), first);
	json = cJSON_Parse(event.data);
	assert_string_equal(cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "id")), "a");
	assert_string_equal(cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "sequence")), event.id);
	assert_int_equal(strlen(cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "revision"))), 32);
	assert_int_equal(strlen(cJSON_GetStringValue(cJSON_GetObjectItem(json,
	    "time"))), strlen("2026-01-01T00:00:00.000Z"));
	assert_int_equal(cJSON_GetNumberValue(cJSON_GetObjectItem(json,
	    "nodes")), 1);
	assert_int_equal(cJSON_GetNumberValue(cJSON_GetObjectItem(json,
	    "bytes")), strlen("{'format':'blobfield/1','name':'1','root':"
	    "{'type':'point','center':[0,0,0],'radius':1}}"));
	cJSON_Delete(json);
	for (int i = 2; i < 12; i++) {
		sequence = rename_to(d->url, "a", i);
		assert_revision(&s, sequence, false);
	}
	/* Neither what is the same, nor what is elsewhere. */
	rename_to(d->url, "a", 11);
	rename_to(d->url, "b", 1);
	assert_nothing(&s);
	sse_close(&s);
}

static void test_a_deletion_ends_the_stream(void **state)
{
	struct daemon *d = *state;
	long sequence = rename_to(d->url, "gone", 1);
	struct sse_event event;
	struct sse s;

	listen_to(d, &s, "gone", -1);
	assert_revision(&s, sequence, false);
	delete(d->url, "gone");
	assert_int_equal(sse_next(&s, &event, WAIT), SSE_EVENT);
	assert_string_equal(event.event, "deleted");
	assert_true(atol(event.id) > sequence);
	assert_null(strstr(event.data, "revision"));
	assert_int_equal(sse_next(&s, &event, WAIT), SSE_END);
	sse_close(&s);
	assert_false(sse_open(&s, d->port, "/v1/scenes/gone/events", ""));
	assert_int_equal(s.status, 404);
	sse_close(&s);
}

static void test_resuming_within_the_history(void **state)
{
	struct daemon *d = *state;
	long sequences[10];
	struct sse s;

	for (int i = 0; i < 10; i++)
		sequences[i] = rename_to(d->url, "resume", i);
	listen_to(d, &s, "resume", sequences[3]);
	for (int i = 4; i < 10; i++)
		assert_revision(&s, sequences[i], false);
	assert_nothing(&s);
	assert_revision(&s, rename_to(d->url, "resume", 10), false);
	sse_close(&s);
	/* Who has had all hears nothing until there is more. */
	listen_to(d, &s, "resume", sequences[9] + 1);
	assert_nothing(&s);
	assert_revision(&s, rename_to(d->url, "resume", 11), false);
	sse_close(&s);
}

static void test_resuming_from_too_long_ago(void **state)
{
	struct daemon *d = *state;
	long first = rename_to(d->url, "old", 0), last = first;
	struct sse s;

	for (int i = 1; i < HISTORY + 5; i++)
		last = rename_to(d->url, "old", i);
	listen_to(d, &s, "old", first);
	assert_revision(&s, last, true);
	assert_nothing(&s);
	sse_close(&s);
	/* ... from another store's time, which had more */
	listen_to(d, &s, "old", last + 1000000);
	assert_revision(&s, last, true);
	assert_revision(&s, rename_to(d->url, "old", -1), false);
	sse_close(&s);
}

static void test_resuming_behind_a_deletion(void **state)
{
	struct daemon *d = *state;
	long first = rename_to(d->url, "again", 0), last;
	struct sse s;

	delete(d->url, "again");
	last = rename_to(d->url, "again", 1);
	listen_to(d, &s, "again", first);
	assert_revision(&s, last, true);
	sse_close(&s);
}

static void test_what_is_no_id(void **state)
{
	static const char *const ids[] = {"x", "-1", "1.5", "1-", "12 13",
	    "99999999999999999999999"};
	struct daemon *d = *state;
	char header[80];
	struct sse s;

	rename_to(d->url, "a", 1);
	for (size_t i = 0; i < sizeof ids / sizeof *ids; i++) {
		snprintf(header, sizeof header, "Last-Event-ID: %s\r\n",
		    ids[i]);
		assert_false(sse_open(&s, d->port, "/v1/scenes/a/events",
		    header));
		assert_int_equal(s.status, 400);
		assert_non_null(strstr(s.head, "Last-Event-ID"));
		sse_close(&s);
	}
	/* An empty one is none. */
	assert_true(sse_open(&s, d->port, "/v1/scenes/a/events",
	    "Last-Event-ID:\r\n"));
	sse_close(&s);
}

/* ---- many ---- */

struct heard {
	struct sse s;
	double since;              /* when it was there */
	long first, last;
	double times[CHANGES + 2]; /* when each event came, by its sequence less
	                            * the first */
	bool missed[CHANGES + 2];
	int count, missed_count;
};

struct crowd {
	const struct daemon *d;
	int changes;               /* CHANGES at most */
	double pause;              /* of a writer between two, seconds */
	long base;                 /* the sequence before all changes */
	double acknowledged[CHANGES + 2];
	atomic_int next;
	struct heard *list;
};

static double cpu_seconds(pid_t pid)
{
	unsigned long user, system;
	char path[64], text[1024], *at;
	FILE *file;
	size_t n;

	snprintf(path, sizeof path, "/proc/%d/stat", (int)pid);
	file = fopen(path, "r");
	assert_non_null(file);
	n = fread(text, 1, sizeof text - 1, file);
	text[n] = '\0';
	fclose(file);
	at = strrchr(text, ')');
	assert_int_equal(sscanf(at + 2, "%*c %*d %*d %*d %*d %*d %*u %*u %*u "
	    "%*u %*u %lu %lu", &user, &system), 2);
	return (double)(user + system) / (double)sysconf(_SC_CLK_TCK);
}

static void *change_often(void *arg)
{
	struct crowd *c = arg;
	int fd = load_connect(c->d->port), n;

	while ((n = atomic_fetch_add(&c->next, 1)) < c->changes) {
		struct load_request request;
		struct load_answer answer;
		char body[80], *at;

		snprintf(body, sizeof body, "[{\"op\":\"replace\",\"path\":"
		    "\"/name\",\"value\":\"n%d\"}]", n);
		request = load_request_make("PATCH", "/v1/scenes/crowd",
		    "Content-Type: application/json-patch+json\r\n", body,
		    strlen(body));
		assert_int_equal(load_exchange(fd, &request, true, &answer),
		    0);
		assert_int_equal(answer.status, 200);
		at = strstr(answer.body, "\"sequence\":\"");
		assert_non_null(at);
		c->acknowledged[atol(at + 12) - c->base] = now();
		load_request_fini(&request);
		free(answer.body);
		usleep((useconds_t)(1e6 * c->pause));
	}
	close(fd);
	return NULL;
}

/* Notes what h's socket has; sequences rise. */
static void hear(struct crowd *c, struct heard *h)
{
	struct sse_event event;
	long sequence;

	while (sse_next(&h->s, &event, 0) == SSE_EVENT) {
		if (event.is_comment)
			continue;
		sequence = atol(event.id);
		assert_true(sequence > h->last);
		assert_true(sequence <= c->base + c->changes);
		if (h->count++ == 0)
			h->first = sequence;
		h->last = sequence;
		h->times[sequence - c->base] = now();
		h->missed[sequence - c->base] = has_missed(&event);
		h->missed_count += has_missed(&event);
	}
}

/* Until all have heard the last change. */
static void hear_all(struct crowd *c, int listeners)
{
	struct pollfd fds[LISTENERS];
	double end = now() + 60.0;
	int left = listeners;

	for (int i = 0; i < listeners; i++)
		fds[i] = (struct pollfd){c->list[i].s.fd, POLLIN, 0};
	while (left > 0) {
		assert_true(now() < end);
		poll(fds, (nfds_t)listeners, 1000);
		for (int i = 0; i < listeners; i++) {
			if (fds[i].fd < 0 || fds[i].revents == 0)
				continue;
			hear(c, &c->list[i]);
			if (c->list[i].last == c->base + c->changes) {
				fds[i].fd = -1;
				left--;
			}
		}
	}
}

/* Nothing is left out but before an event that says so. */
static void assert_whole(const struct crowd *c, const struct heard *h)
{
	bool gap = false;

	for (long n = h->first - c->base + 1; n <= c->changes; n++) {
		if (h->times[n] == 0.0) {
			gap = true;
			continue;
		}
		if (gap)
			assert_true(h->missed[n]);
		gap = false;
	}
	assert_false(gap);
}

static void tell_delays(const struct crowd *c, int listeners, double cpu)
{
	double *delays = malloc((size_t)listeners * CHANGES * sizeof *delays);
	size_t count = 0, heard = 0;
	int missed = 0;

	for (int i = 0; i < listeners; i++) {
		const struct heard *h = &c->list[i];

		heard += (size_t)h->count;
		missed += h->missed_count;
		for (int n = 1; n <= c->changes; n++)
			if (h->times[n] != 0.0 &&
			    h->since < c->acknowledged[n])
				delays[count++] = h->times[n] -
				    c->acknowledged[n];
	}
	printf("measured: %zu events to %d listeners of %d changes by %d "
	    "writers; behind the acknowledgement p50 %.1f ms, p99 %.1f ms, "
	    "most %.1f ms; %.1f us of the daemon's CPU an event; %d said that "
	    "some were left out\n", heard, listeners, c->changes, WRITERS,
	    1e3 * load_quantile(delays, count, 0.5),
	    1e3 * load_quantile(delays, count, 0.99),
	    1e3 * load_quantile(delays, count, 1.0),
	    1e6 * cpu / (double)heard, missed);
	free(delays);
}

static void join(struct crowd *c, int i, long after)
{
	listen_to(c->d, &c->list[i].s, "crowd", after);
	c->list[i].since = now();
}

/* Half of them are there before the first change, the others join later, from
 * the beginning on. */
static void listen_while_changed(const struct daemon *d, int changes,
    double pause)
{
	struct crowd *c = calloc(1, sizeof *c);
	pthread_t threads[WRITERS];
	double cpu;

	c->d = d;
	c->changes = changes;
	c->pause = pause;
	c->list = calloc(LISTENERS, sizeof *c->list);
	c->base = rename_to(c->d->url, "crowd", 0);
	for (int i = 0; i < LISTENERS / 2; i++)
		join(c, i, -1);
	cpu = cpu_seconds(c->d->pid);
	for (int i = 0; i < WRITERS; i++)
		pthread_create(&threads[i], NULL, change_often, c);
	for (int i = LISTENERS / 2; i < LISTENERS; i++)
		join(c, i, c->base);
	hear_all(c, LISTENERS);
	for (int i = 0; i < WRITERS; i++)
		pthread_join(threads[i], NULL);
	cpu = cpu_seconds(c->d->pid) - cpu;
	for (int i = 0; i < LISTENERS; i++) {
		assert_whole(c, &c->list[i]);
		sse_close(&c->list[i].s);
	}
	tell_delays(c, LISTENERS, cpu);
	free(c->list);
	free(c);
}

static void test_many_listeners_while_many_write(void **state)
{
	listen_while_changed(*state, CHANGES, 0.0);
}

/* At 40 changes a second: delays that are the fan-out's own. */
static void test_many_listeners_while_some_write(void **state)
{
	listen_while_changed(*state, SANITIZED ? 20 : 80, 0.1);
}

/*
 * Comes and goes all the time, resuming: of what is not said to be missed, it
 * hears everything once.
 */
static void test_coming_and_going_while_many_write(void **state)
{
	struct crowd *c = calloc(1, sizeof *c);
	struct heard *h = calloc(1, sizeof *h);
	pthread_t threads[WRITERS];
	int visits = 0;

	c->d = *state;
	c->changes = CHANGES;
	h->first = h->last = c->base = rename_to(c->d->url, "crowd", -1);
	for (int i = 0; i < WRITERS; i++)
		pthread_create(&threads[i], NULL, change_often, c);
	for (double end = now() + 60.0; h->last < c->base + c->changes;
	    visits++) {
		struct pollfd p;

		assert_true(now() < end);
		listen_to(c->d, &h->s, "crowd", h->last);
		p = (struct pollfd){h->s.fd, POLLIN, 0};
		poll(&p, 1, 5);
		hear(c, h);
		sse_close(&h->s);
	}
	for (int i = 0; i < WRITERS; i++)
		pthread_join(threads[i], NULL);
	h->first = c->base;
	assert_whole(c, h);
	printf("measured: %d visits, %d of %d changes heard\n", visits,
	    h->count, c->changes);
	free(h);
	free(c);
}

/* ---- slow, too many, the end ---- */

/* A listener with a small window that reads nothing for a while. */
static void open_slow(const struct daemon *d, struct sse *s, const char *id)
{
	const struct sockaddr_in address = {.sin_family = AF_INET,
	    .sin_port = htons((uint16_t)d->port),
	    .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
	int fd = socket(AF_INET, SOCK_STREAM, 0), small = 2048;
	char request[200];

	setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &small, sizeof small);
	assert_int_equal(connect(fd, (const struct sockaddr *)&address,
	    sizeof address), 0);
	memset(s, 0, sizeof *s);
	s->fd = fd;
	snprintf(request, sizeof request, "GET /v1/scenes/%s/events HTTP/1.1"
	    "\r\nHost: 127.0.0.1\r\n\r\n", id);
	assert_true(write(fd, request, strlen(request)) > 0);
}

/* Removes the answer's head, of which the reader knows nothing. */
static void skip_head(struct sse *s)
{
	static const char end[] = "\r\n\r\n";
	size_t n = 0;
	char c;

	while (n < 4) {
		assert_int_equal(read(s->fd, &c, 1), 1);
		n = c == end[n] ? n + 1 : c == '\r';
	}
}

static void test_a_slow_listener_hears_the_newest(void **state)
{
	struct daemon *d = *state;
	long last, sequence, previous = 0;
	struct sse_event event;
	struct sse s;
	int heard = 0, missed = 0, changes = SANITIZED ? 500 : 1500;

	rename_to(d->url, "slow", 0);
	open_slow(d, &s, "slow");
	last = rename_often(d->port, "slow", changes);
	skip_head(&s);
	do {
		assert_int_equal(sse_next(&s, &event, WAIT), SSE_EVENT);
		sequence = atol(event.id);
		assert_true(sequence > previous);
		assert_true(has_missed(&event) || previous == 0 ||
		    sequence == previous + 1);
		missed += has_missed(&event);
		previous = sequence;
		heard++;
	} while (sequence < last);
	printf("measured: a listener that read nothing during %d changes heard "
	    "%d of them, and %d times that some were left out\n", changes,
	    heard, missed);
	/* A proxy has more room than sockets have. */
	assert_true(SANITIZED || getenv("BLOBFIELD_PROXY") != NULL ||
	    missed > 0);
	sse_close(&s);
}

/* As many as there may be, s, and one that does not read. */
static void fill_with_listeners(const struct daemon *d, struct sse *s,
    struct sse *stuck)
{
	rename_to(d->url, "a", 0);
	open_slow(d, stuck, "a");
	for (int i = 0; i < LISTENERS; i++)
		listen_to(d, &s[i], "a", -1);
}

/* One more is refused, until one has gone, which is seen in a second or two. */
static void assert_bounded(const struct daemon *d, struct sse *s)
{
	struct sse more;
	double end = now() + 60.0;

	assert_false(sse_open(&more, d->port, "/v1/scenes/a/events", ""));
	assert_int_equal(more.status, 503);
	assert_non_null(strstr(more.head, "queue-full"));
	assert_non_null(strstr(more.head, "Retry-After: 1"));
	sse_close(&more);
	sse_close(s);
	while (!sse_open(s, d->port, "/v1/scenes/a/events", "")) {
		assert_true(now() < end);
		sse_close(s);
		usleep(50000);
	}
}

static void drain_events(struct sse *s, int milliseconds)
{
	struct sse_event event;

	while (sse_next(s, &event, milliseconds) == SSE_EVENT)
		;
}

/* All are told of the end, but for one that is stuck; it comes at once. */
static void test_listeners_are_bounded_and_end_with_the_daemon(void **unused)
{
	static const char *const arguments[] = {"--no-measure",
	    "--max-listeners", "201", NULL};
	struct sse *s = calloc(LISTENERS, sizeof *s), stuck;
	struct sse_event event;
	struct daemon d;
	double begin;

	(void)unused;
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	fill_with_listeners(&d, s, &stuck);
	assert_bounded(&d, &s[7]);
	rename_often(d.port, "a", SANITIZED ? 100 : 600);
	usleep(1200000);
	for (int i = 0; i < LISTENERS; i++)
		drain_events(&s[i], 0);
	begin = now();
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	begin = now() - begin;
	for (int i = 0; i < LISTENERS; i++) {
		drain_events(&s[i], 1000);
		assert_int_equal(sse_next(&s[i], &event, 0), SSE_END);
		sse_close(&s[i]);
	}
	sse_close(&stuck);
	free(s);
	printf("measured: the daemon ended in %.0f ms with %d listeners, one "
	    "stuck\n", 1e3 * begin, LISTENERS + 1);
	assert_true(SANITIZED || load_is_soon(begin, 10.0));
}

static void test_an_idle_listener_hears_a_comment(void **state)
{
	struct daemon *d = *state;
	struct sse_event event;

	int comments = 0;
	double seconds;

	do {
		assert_int_equal(sse_next(&idle, &event, 20000), SSE_EVENT);
		assert_true(event.is_comment);
		assert_string_equal(event.data, "alive");
		comments++;
		seconds = now() - idle_since;
		/* Every 15 s, seen once a second. */
	} while (comments < (int)(seconds / 17.0));
	printf("measured: %d comments in %.1f s\n", comments, seconds);
	assert_true(comments <= seconds / 15.0);
	assert_revision(&idle, rename_to(d->url, "idle", 1), false);
	sse_close(&idle);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_idle_listener_begins),
		cmocka_unit_test(test_the_present_comes_first_then_changes),
		cmocka_unit_test(test_a_deletion_ends_the_stream),
		cmocka_unit_test(test_resuming_within_the_history),
		cmocka_unit_test(test_resuming_from_too_long_ago),
		cmocka_unit_test(test_resuming_behind_a_deletion),
		cmocka_unit_test(test_what_is_no_id),
		cmocka_unit_test(test_many_listeners_while_many_write),
		cmocka_unit_test(test_many_listeners_while_some_write),
		cmocka_unit_test(test_coming_and_going_while_many_write),
		cmocka_unit_test(test_a_slow_listener_hears_the_newest),
		cmocka_unit_test(
		    test_listeners_are_bounded_and_end_with_the_daemon),
		cmocka_unit_test(test_an_idle_listener_hears_a_comment),
	};

	return cmocka_run_group_tests(tests, daemon_setup, daemon_teardown);
}
