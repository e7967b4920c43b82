#include "tests/support/load.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define HEAD_MAX 4096
#define BUFFER ((size_t)256 << 10)

static double now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *allocate(size_t size)
{
	void *p = malloc(size + 1);

	if (!p)
		abort();
	return p;
}

struct load_request load_request_make(const char *method, const char *path,
    const char *headers, const void *body, size_t length)
{
	struct load_request request;
	char head[HEAD_MAX];
	int n = snprintf(head, sizeof(head), "%s %s HTTP/1.1\r\n"
	    "Host: localhost\r\nContent-Length: %zu\r\n%s\r\n", method, path,
	    length, headers);

	request.length = (size_t)n + length;
	request.bytes = allocate(request.length);
	memcpy(request.bytes, head, (size_t)n);
	memcpy(request.bytes + n, body, length);
	return request;
}

void load_request_fini(struct load_request *request)
{
	free(request->bytes);
	*request = (struct load_request){0};
}

int load_connect(int port)
{
	struct sockaddr_in address = {.sin_family = AF_INET,
		.sin_port = htons((uint16_t)port),
		.sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
	int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0), yes = 1;

	if (fd < 0)
		return -1;
	setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof(yes));
	if (connect(fd, (struct sockaddr *)&address, sizeof(address)) == 0)
		return fd;
	close(fd);
	return -1;
}

/* ---- answers, as they arrive ---- */

/* What is known of an answer while it is read. */
struct reading {
	char head[HEAD_MAX];
	size_t head_length;
	bool has_head, is_chunked, is_done, is_bad;
	int status;
	size_t left;       /* of the body, or of the chunk */
	size_t length;     /* of the body so far */
	enum { CHUNK_SIZE, CHUNK_DATA, CHUNK_END, CHUNK_LAST } chunk;
	char line[32];     /* a chunk's size line */
	size_t line_length;
	char *body;        /* kept, or NULL */
	size_t body_size;
	bool keep;
};

/* The value of a header in a head that ends in NUL, or NULL. */
static const char *find_header(const char *head, const char *name)
{
	size_t length = strlen(name);

	for (const char *at = strstr(head, "\r\n"); at;
	    at = strstr(at + 2, "\r\n")) {
		if (strncasecmp(at + 2, name, length) == 0 &&
		    at[2 + length] == ':')
			return at + 3 + length + strspn(at + 3 + length, " ");
	}
	return NULL;
}

static void parse_head(struct reading *r)
{
	const char *length, *coding;

	r->head[r->head_length] = '\0';
	if (sscanf(r->head, "HTTP/1.%*d %d", &r->status) != 1) {
		r->is_bad = true;
		return;
	}
	length = find_header(r->head, "Content-Length");
	coding = find_header(r->head, "Transfer-Encoding");
	r->is_chunked = coding && strncasecmp(coding, "chunked", 7) == 0;
	r->left = length ? strtoull(length, NULL, 10) : 0;
	r->has_head = true;
	r->is_done = !r->is_chunked && r->left == 0;
}

static void take_data(struct reading *r, const char *data, size_t n)
{
	if (r->keep && r->length + n > r->body_size) {
		r->body_size = 2 * (r->length + n);
		r->body = realloc(r->body, r->body_size);
		if (!r->body)
			abort();
	}
	if (r->keep)
		memcpy(r->body + r->length, data, n);
	r->length += n;
	r->left -= n;
}

/* A byte of a chunk's size line, or of the line end behind a chunk. */
static void take_chunk_byte(struct reading *r, char byte)
{
	if (byte != '\n') {
		if (byte != '\r' && r->line_length < sizeof(r->line) - 1)
			r->line[r->line_length++] = byte;
		return;
	}
	r->line[r->line_length] = '\0';
	if (r->chunk == CHUNK_SIZE) {
		r->left = strtoull(r->line, NULL, 16);
		r->chunk = r->left ? CHUNK_DATA : CHUNK_LAST;
	} else if (r->chunk == CHUNK_END) {
		r->chunk = CHUNK_SIZE;
	} else if (r->line_length == 0) {
		r->is_done = true;
	}
	r->line_length = 0;
}

static void take_body(struct reading *r, const char *data, size_t n)
{
	while (n > 0 && !r->is_done) {
		bool whole = !r->is_chunked || r->chunk == CHUNK_DATA;
		size_t part = whole ? (n < r->left ? n : r->left) : 1;

		if (whole)
			take_data(r, data, part);
		else
			take_chunk_byte(r, *data);
		data += part;
		n -= part;
		if (whole && r->left == 0) {
			r->is_done = !r->is_chunked;
			r->chunk = CHUNK_END;
		}
	}
}

/* The next n bytes of an answer. */
static void take(struct reading *r, const char *data, size_t n)
{
	while (n > 0 && !r->has_head && !r->is_bad) {
		r->head[r->head_length++] = *data++;
		n--;
		if (r->head_length == HEAD_MAX - 1)
			r->is_bad = true;
		else if (r->head_length >= 4 && memcmp(r->head +
		    r->head_length - 4, "\r\n\r\n", 4) == 0)
			parse_head(r);
		/* 100 Continue is no answer */
		if (r->has_head && r->status == 100)
			*r = (struct reading){.keep = r->keep};
	}
	if (!r->is_bad)
		take_body(r, data, n);
}

static bool send_all(int fd, const char *bytes, size_t length)
{
	while (length > 0) {
		ssize_t n = send(fd, bytes, length, MSG_NOSIGNAL);

		if (n < 0 && errno == EINTR)
			continue;
		if (n <= 0)
			return false;
		bytes += n;
		length -= (size_t)n;
	}
	return true;
}

int load_exchange(int fd, const struct load_request *request, bool keep,
    struct load_answer *out)
{
	struct reading r = {.keep = keep};
	char *buffer = allocate(BUFFER);
	double begin = now();
	const char *timing;

	*out = (struct load_answer){0};
	if (!send_all(fd, request->bytes, request->length))
		r.is_bad = true;
	while (!r.is_done && !r.is_bad) {
		ssize_t n = recv(fd, buffer, BUFFER, 0);

		if (n <= 0)
			r.is_bad = true;
		else if (r.head_length == 0)
			out->first = now() - begin;
		if (n > 0)
			take(&r, buffer, (size_t)n);
	}
	out->last = now() - begin;
	free(buffer);
	out->status = r.status;
	out->length = r.length;
	out->body = r.body;
	timing = r.has_head ? find_header(r.head, "Server-Timing") : NULL;
	if (timing)
		snprintf(out->timing, sizeof(out->timing), "%.*s",
		    (int)strcspn(timing, "\r"), timing);
	return r.is_bad ? -1 : 0;
}

/* ---- many connections ---- */

struct client {
	int fd;
	const struct load_request *request;
	size_t sent;
	double begun;
	size_t answers;
	struct reading reading;
};

struct load {
	const struct load_options *options;
	struct load_result *result;
	size_t room;   /* of result->seconds */
	size_t begun;  /* requests */
	size_t open;   /* connections with a request under way */
	int epoll;
	double start;
	char *buffer;
};

static void watch(struct load *l, struct client *c, int what, int operation)
{
	struct epoll_event event = {.events = (uint32_t)what,
		.data = {.ptr = c}};

	if (epoll_ctl(l->epoll, operation, c->fd, &event))
		abort();
}

/* Sends what the socket takes; false when it is broken. */
static bool push(struct load *l, struct client *c)
{
	while (c->sent < c->request->length) {
		ssize_t n = send(c->fd, c->request->bytes + c->sent,
		    c->request->length - c->sent, MSG_NOSIGNAL);

		if (n < 0 && errno == EAGAIN) {
			watch(l, c, EPOLLIN | EPOLLOUT, EPOLL_CTL_MOD);
			return true;
		}
		if (n <= 0)
			return false;
		c->sent += (size_t)n;
		if (c->sent == c->request->length)
			watch(l, c, EPOLLIN, EPOLL_CTL_MOD);
	}
	return true;
}

static bool is_over(const struct load *l)
{
	const struct load_options *o = l->options;

	return (o->total && l->begun >= o->total) ||
	    (o->seconds > 0.0 && now() - l->start >= o->seconds) ||
	    (o->stop && __atomic_load_n(o->stop, __ATOMIC_ACQUIRE));
}

static void shut(struct load *l, struct client *c)
{
	close(c->fd);
	c->fd = -1;
	l->open--;
}

static void begin(struct load *l, struct client *c)
{
	c->reading = (struct reading){0};
	c->sent = 0;
	c->begun = now();
	l->begun++;
	if (!push(l, c)) {
		l->result->failures++;
		shut(l, c);
	}
}

static void note(struct load *l, struct client *c)
{
	struct load_result *r = l->result;

	if (r->count == l->room) {
		l->room = l->room ? 2 * l->room : 1024;
		r->seconds = realloc(r->seconds, l->room * sizeof(double));
		if (!r->seconds)
			abort();
	}
	r->seconds[r->count++] = now() - c->begun;
	c->answers++;
	r->failures += c->reading.status / 100 != 2;
}

/* Reads what there is; begins the next request after a whole answer. */
static void pull(struct load *l, struct client *c)
{
	ssize_t n = recv(c->fd, l->buffer, BUFFER, 0);

	if (n < 0 && (errno == EAGAIN || errno == EINTR))
		return;
	if (n > 0)
		take(&c->reading, l->buffer, (size_t)n);
	if (n <= 0 || c->reading.is_bad) {
		l->result->failures++;
		shut(l, c);
	} else if (c->reading.is_done) {
		note(l, c);
		if (is_over(l))
			shut(l, c);
		else
			begin(l, c);
	}
}

static void serve(struct load *l)
{
	struct epoll_event events[64];

	while (l->open > 0) {
		int n = epoll_wait(l->epoll, events, 64, 30000);

		if (n == 0)
			break; /* a stalled server: the counts tell */
		for (int i = 0; i < n; i++) {
			struct client *c = events[i].data.ptr;

			if ((events[i].events & EPOLLOUT) && !push(l, c)) {
				l->result->failures++;
				shut(l, c);
			} else if (events[i].events & ~(uint32_t)EPOLLOUT) {
				pull(l, c);
			}
		}
	}
}

int load_run(const struct load_options *options, struct load_result *out)
{
	struct load l = {.options = options, .result = out,
		.epoll = epoll_create1(EPOLL_CLOEXEC),
		.buffer = allocate(BUFFER)};
	struct client *clients = calloc(options->connections,
	    sizeof(*clients));

	*out = (struct load_result){.fewest = (size_t)-1};
	if (!clients || l.epoll < 0)
		abort();
	l.start = now();
	for (size_t i = 0; i < options->connections; i++) {
		struct client *c = clients + i;

		c->fd = load_connect(options->port);
		if (c->fd < 0)
			break;
		fcntl(c->fd, F_SETFL, O_NONBLOCK);
		c->request = options->requests + i % options->request_count;
		l.open++;
		watch(&l, c, EPOLLIN, EPOLL_CTL_ADD);
		begin(&l, c);
	}
	serve(&l);
	out->elapsed = now() - l.start;
	for (size_t i = 0; i < options->connections; i++) {
		if (clients[i].fd > 0)
			close(clients[i].fd);
		if (clients[i].answers < out->fewest)
			out->fewest = clients[i].answers;
		if (clients[i].answers > out->most)
			out->most = clients[i].answers;
	}
	close(l.epoll);
	free(clients);
	free(l.buffer);
	return out->count > 0 ? 0 : -1;
}

void load_result_fini(struct load_result *result)
{
	free(result->seconds);
	*result = (struct load_result){0};
}

static int by_size(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

double load_quantile(double *values, size_t count, double p)
{
	if (count == 0)
		return 0.0;
	qsort(values, count, sizeof(*values), by_size);
	return values[(size_t)(p * (double)(count - 1) + 0.5)];
}

bool load_is_soon(double seconds, double bound)
{
	double average = 0.0, processors = (double)sysconf(
	    _SC_NPROCESSORS_ONLN), crowd;

	getloadavg(&average, 1);
	crowd = average > processors ? average / processors : 1.0;
	if (seconds >= bound)
		printf("measured: %.2f s, of %.2f, at a load average of %.0f\n",
		    seconds, bound, average);
	return seconds < 4.0 * crowd * bound;
}
