/*
 * The daemon but for its main function, before a device that is played: requests
 * to its real listener, in pieces. Whatever comes, it answers in clean HTTP/1.1,
 * or closes; and then serves the next one.
 *
 * The first byte says how the rest is sent, the second how it is cut. Cooked:
 * requests parted by two bytes 0x1e; lines of heads end with LF, an empty one
 * ends a head; CR, Host and Content-Length are added, and each answer is waited
 * for and looked at. Raw: as it is.
 */
#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "server/access.h"
#include "server/clock.h"
#include "server/config.h"
#include "server/events.h"
#include "server/http.h"
#include "server/metrics.h"
#include "server/orders.h"
#include "server/scene_store.h"
#include "server/scheduler.h"
#include "server/server.h"
#include "server/tables.h"
#include "server/task.h"
#include "server/volume_store.h"
#include "tests/fuzz/http_answer.h"

#define RAW 3              /* of the first byte, modulo 4 */
#define REQUESTS_MOST 8    /* of one input */
#define LISTENERS_MOST 2   /* to events, of one input */
#define ANSWER_SECONDS 60.0
#define GIVE_UP_SECONDS 0.5 /* where it may wait for more */
#define TIDY_EVERY 256     /* inputs */
#define CHECK_EVERY 16

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void demand(int fine)
{
	if (!fine)
		abort();
}

/* ---- the daemon ---- */

static struct config config;
static struct server server = {.config = &config};
static struct sockaddr_in address;

/* The secrets: "friend", "reader", "chief". */
static const char tokens[] = "{\"tokens\":[{\"name\":\"anonymous\",\"role\":"
    "\"write\"},{\"name\":\"ci\",\"role\":\"write\",\"sha256\":"
    "\"cde48537ca2c28084ff560826d0e6388b7c57a51497a6cb56f397289e52ff41b\","
    "\"limits\":{\"requests_per_second\":20,\"points_per_second\":1e4,"
    "\"bytes_per_second\":1e5,\"scenes\":2}},{\"name\":\"reader\",\"role\":"
    "\"read\",\"sha256\":"
    "\"3d0941964aa3ebdcb00ccef58b1bb399f9f898465e9886d5aec7f31090a0fb30\"},"
    "{\"name\":\"chief\",\"role\":\"admin\",\"sha256\":"
    "\"9285827b8031a1dbe7d1d04eb8a08c8891ee424a8002cfc7dd2df3d82cbff611\"}]}";

static void do_nothing(void *ctx)
{
	(void)ctx;
}

static void on_tables_changed(void *ctx)
{
	(void)ctx;
	scheduler_tables_changed(server.scheduler);
}

static void write_tokens(char path[static 32])
{
	int fd;

	strcpy(path, "/tmp/fuzz_http.XXXXXX");
	fd = mkstemp(path);
	demand(fd >= 0 && write(fd, tokens, sizeof tokens - 1) ==
	    (ssize_t)sizeof tokens - 1);
	close(fd);
}

static void configure(char *path)
{
	char *flags[] = {"blobfieldd", "--listen", "127.0.0.1:0", "--data",
	    ":memory:", "--no-cache", "--no-measure", "--max-body", "64k",
	    "--max-points", "4096", "--max-nodes", "64", "--max-scenes", "24",
	    "--scene-memory", "4M", "--volume-memory", "1M", "--table-memory",
	    "16M", "--history", "4", "--max-listeners", "4", "--queue", "8",
	    "--log-level", "debug", "--log-format", "json", "--cors-origin",
	    "http://localhost:3000,null", "--hosts", "x,ation", "--tokens",
	    path};

	demand(config_parse(sizeof flags / sizeof *flags, flags, &config) ==
	    CONFIG_RUN);
}

static void start(void)
{
	const struct scheduler_options options = {.device = config.device,
	    .queue = config.queue, .ready = do_nothing, .failed = do_nothing};
	struct scheduler_options with_tables = options;
	char url[HTTP_URL_MAX];

	server.started = clock_seconds();
	demand(metrics_create(&server.metrics) == ERR_OK);
	demand(access_create(&config, &server.access) == ERR_OK);
	demand(http_listen(&server, url) == ERR_OK);
	demand(tables_create(config.layout, &server.tables) == ERR_OK);
	demand(volume_store_create(config.device.volume_bytes,
	    &server.volumes) == ERR_OK);
	with_tables.tables = server.tables;
	demand(scheduler_create(&with_tables, &server.scheduler) == ERR_OK);
	demand(events_create(config.max_listeners, &server.events) == ERR_OK);
	demand(scene_store_create(&server, &server.scenes) == ERR_OK);
	demand(tables_start(server.tables, config.measure, NULL,
	    on_tables_changed, NULL) == ERR_OK);
	demand(orders_create(server.tables, config.device.table_bytes,
	    &server.orders) == ERR_OK);
	demand(tasks_create(config.tasks, &server.tasks) == ERR_OK);
	demand(http_start(server.http) == ERR_OK);
	address.sin_family = AF_INET;
	address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
	address.sin_port = htons((uint16_t)atoi(strrchr(url, ':') + 1));
}

/* What main() does about once a second. */
static void tend(void)
{
	http_reap(server.http);
	events_tend(server.events);
}

/* ---- a connection ---- */

struct peer {
	int fd;           /* -1: none */
	char *bytes;      /* that have come, and are not answers read yet */
	size_t count, room;
	bool is_over;     /* nothing more will */
};

static void peer_open(struct peer *p)
{
	/* Reset at the end, so that no port waits for what cannot come. */
	struct linger linger = {1, 0};
	int yes = 1;

	p->fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
	demand(p->fd >= 0);
	setsockopt(p->fd, SOL_SOCKET, SO_LINGER, &linger, sizeof linger);
	setsockopt(p->fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
	demand(connect(p->fd, (const struct sockaddr *)&address,
	    sizeof address) == 0);
	p->count = 0;
	p->is_over = false;
}

static void peer_close(struct peer *p)
{
	if (p->fd >= 0)
		close(p->fd);
	free(p->bytes);
	*p = (struct peer){.fd = -1};
}

/* What comes within so many milliseconds. */
static bool peer_receive(struct peer *p, int milliseconds)
{
	struct pollfd fd = {.fd = p->fd, .events = POLLIN};
	ssize_t n;

	if (poll(&fd, 1, milliseconds) <= 0)
		return false;
	if (p->room - p->count < 65536) {
		p->room = 2 * p->room + 65536;
		p->bytes = realloc(p->bytes, p->room);
		demand(p->bytes != NULL);
	}
	n = recv(p->fd, p->bytes + p->count, p->room - p->count, 0);
	if (n <= 0)
		p->is_over = true;
	else
		p->count += (size_t)n;
	return true;
}

static void peer_drop(struct peer *p, size_t length)
{
	p->count -= length;
	memmove(p->bytes, p->bytes + length, p->count);
}

/* All of it, in pieces of random length if cut is not 0; until it is refused. */
static void peer_send(struct peer *p, const char *data, size_t length,
    unsigned cut)
{
	uint32_t random = cut;

	while (length > 0) {
		size_t n = length;
		ssize_t sent;

		random = random * 1664525u + 1013904223u;
		if (cut > 0 && n > 1 + (random >> 16) % (8 * cut))
			n = 1 + (random >> 16) % (8 * cut);
		sent = send(p->fd, data, n, MSG_NOSIGNAL);
		if (sent <= 0)
			return;
		data += sent;
		length -= (size_t)sent;
		if (cut > 0)
			sched_yield();
	}
}

/*
 * The next answer. False: the connection ended without one. Given is_strict, one
 * comes, or an end; else the daemon may wait for more, which does not come.
 */
static bool peer_read(struct peer *p, bool is_head, bool is_strict,
    struct http_answer *answer)
{
	double begin = clock_seconds();

	while (p->count == 0 || !http_answer_read(p->bytes, p->count, is_head,
	    p->is_over, answer)) {
		double seconds = clock_seconds() - begin;

		if (p->is_over || (!is_strict && seconds > GIVE_UP_SECONDS))
			return false;
		demand(seconds < ANSWER_SECONDS);
		if (peer_receive(p, is_strict ? 200 : 2))
			continue;
		if (!is_strict)
			shutdown(p->fd, SHUT_WR);
		if (seconds > 0.1)
			tend();
	}
	peer_drop(p, answer->length);
	return true;
}

/* ---- requests of its own ---- */

/* The body, for free. */
static char *ask(const char *method, const char *path, const char *body,
    int *status)
{
	struct peer p = {.fd = -1};
	struct http_answer answer;
	char text[4096];

	snprintf(text, sizeof text, "%s %s HTTP/1.1\r\nHost: x\r\n"
	    "Content-Type: application/json\r\nContent-Length: %zu\r\n\r\n%s",
	    method, path, strlen(body), body);
	peer_open(&p);
	peer_send(&p, text, strlen(text), 0);
	demand(peer_read(&p, false, true, &answer));
	peer_close(&p);
	*status = answer.status;
	if (answer.body != NULL)
		answer.body[answer.body_length] = '\0';
	return answer.body;
}

static void put_base(void)
{
	static const char text[] = "{\"format\":\"blobfield/1\",\"root\":"
	    "{\"type\":\"union\",\"id\":\"u\",\"children\":[{\"type\":\"point\","
	    "\"id\":\"p\",\"center\":[0,0,0],\"radius\":1},{\"type\":"
	    "\"segment\",\"a\":[0,0,0],\"b\":[1,0,0],\"radius\":0.5}]}}";
	int status;

	free(ask("PUT", "/v1/scenes/base", text, &status));
	demand(status == 200 || status == 201);
}

static void delete_all(const char *list, const char *path)
{
	int status;
	char *text = ask("GET", path, "", &status);
	cJSON *json = cJSON_Parse(text), *item;

	demand(status == 200 && json != NULL);
	cJSON_ArrayForEach(item, cJSON_GetObjectItem(json, list)) {
		char place[256];

		snprintf(place, sizeof place, "/v1/%s/%s", list,
		    cJSON_GetStringValue(cJSON_GetObjectItem(item, "id")));
		free(ask("DELETE", place, "", &status));
		demand(status == 204 || status == 200 || status == 404);
	}
	cJSON_Delete(json);
	free(text);
}

static void tidy(void)
{
	delete_all("scenes", "/v1/scenes?limit=1000");
	delete_all("volumes", "/v1/volumes");
	put_base();
	tend();
}

static void check_health(void)
{
	int status;

	free(ask("GET", "/healthz", "", &status));
	demand(status == 200);
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
	char path[32];

	(void)argc, (void)argv;
	signal(SIGPIPE, SIG_IGN);
	write_tokens(path);
	configure(path);
	start();
	unlink(path);
	put_base();
	return 0;
}

/* ---- cooked ---- */

struct input {
	struct peer peer;
	struct peer listeners[LISTENERS_MOST];
	size_t listener_count;
	unsigned cut;
};

struct text {
	char bytes[65536];
	size_t length;
};

static void add(struct text *t, const char *data, size_t length)
{
	size_t room = sizeof t->bytes - t->length;

	length = length < room ? length : room;
	memcpy(t->bytes + t->length, data, length);
	t->length += length;
}

static bool has_header(const char *head, size_t length, const char *name)
{
	size_t n = strlen(name);

	for (size_t i = 0; i + n < length; i++)
		if (head[i] == '\n' && strncasecmp(head + i + 1, name, n) == 0)
			return true;
	return false;
}

static void add_lines(struct text *t, const char *at, size_t length)
{
	while (length > 0) {
		const char *end = memchr(at, '\n', length);
		size_t n = end != NULL ? (size_t)(end - at) : length;

		add(t, at, n);
		add(t, "\r\n", 2);
		n += end != NULL;
		at += n;
		length -= n;
	}
}

/* Whether t's framing is ours, so that an answer must come. */
static bool cook(struct text *t, const char *data, size_t length)
{
	const char *gap = memmem(data, length, "\n\n", 2);
	size_t head = gap != NULL ? (size_t)(gap - data) : length;
	size_t body = gap != NULL ? length - head - 2 : 0;
	bool is_framed = has_header(data, head, "Content-Length:") ||
	    has_header(data, head, "Transfer-Encoding:");
	char line[48];

	t->length = 0;
	add_lines(t, data, head);
	if (!has_header(data, head, "Host:"))
		add(t, "Host: x\r\n", 9);
	if (!is_framed && (body > 0 || data[0] == 'P')) {
		snprintf(line, sizeof line, "Content-Length: %zu\r\n", body);
		add(t, line, strlen(line));
	}
	add(t, "\r\n", 2);
	if (body > 0)
		add(t, gap + 2, body);
	return !is_framed && t->length < sizeof t->bytes;
}

/* p goes on as it is; another connection takes its place. */
static void keep_listening(struct input *in)
{
	if (in->listener_count == LISTENERS_MOST) {
		peer_close(&in->peer);
		return;
	}
	in->listeners[in->listener_count++] = in->peer;
	in->peer = (struct peer){.fd = -1};
}

/* What is wrong with a head may end the connection without an answer; what has
 * begun is whole, but for answers that leave as they are made. */
static void send_cooked(struct input *in, const char *data, size_t length)
{
	static struct text text;
	bool is_framed = cook(&text, data, length);
	bool is_head = length > 4 && memcmp(data, "HEAD ", 5) == 0;
	struct http_answer answer = {.status = 100};
	bool is_there = true;

	if (in->peer.fd < 0)
		peer_open(&in->peer);
	peer_send(&in->peer, text.bytes, text.length, in->cut);
	while (is_there && answer.status == 100)
		is_there = peer_read(&in->peer, is_head, is_framed, &answer);
	if (!is_there) {
		demand(in->peer.count == 0 || !is_framed);
		peer_close(&in->peer);
		return;
	}
	free(answer.body);
	if (answer.is_stream)
		keep_listening(in);
	else if (answer.closes || !is_framed || in->peer.count > 0)
		peer_close(&in->peer);
}

static void try_cooked(struct input *in, const char *data, size_t size)
{
	for (int i = 0; i < REQUESTS_MOST && size > 0; i++) {
		const char *end = memmem(data, size, "\x1e\x1e", 2);
		size_t n = end != NULL ? (size_t)(end - data) : size;

		if (n > 0)
			send_cooked(in, data, n);
		n += end != NULL ? 2 : 0;
		data += n;
		size -= n;
	}
}

/* ---- raw ---- */

/* Only the first answer is looked at: to what the others are, only the daemon
 * knows. */
static void try_raw(struct input *in, const char *data, size_t size)
{
	bool is_head = size > 4 && memcmp(data, "HEAD ", 5) == 0;
	struct http_answer answer;
	int patience = 100;

	peer_open(&in->peer);
	peer_send(&in->peer, data, size, in->cut);
	while (!in->peer.is_over && patience > 0) {
		if (peer_receive(&in->peer, 1))
			continue;
		/* It makes the answer, or sends events; or waits for more. */
		if (http_owed(server.http) == 0)
			shutdown(in->peer.fd, SHUT_WR);
		if (--patience % 8 == 0)
			tend();
	}
	if (in->peer.count > 0 && http_answer_read(in->peer.bytes,
	    in->peer.count, is_head, in->peer.is_over, &answer))
		free(answer.body);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	static unsigned long count;
	struct input in = {.peer.fd = -1};

	if (size < 3 || size > 65536)
		return 0;
	in.cut = data[1];
	if (data[0] % 4 == RAW)
		try_raw(&in, (const char *)data + 2, size - 2);
	else
		try_cooked(&in, (const char *)data + 2, size - 2);
	peer_close(&in.peer);
	for (size_t i = 0; i < in.listener_count; i++)
		peer_close(&in.listeners[i]);
	count++;
	if (count % CHECK_EVERY == 0)
		check_health();
	if (count % TIDY_EVERY == 0)
		tidy();
	return 0;
}
