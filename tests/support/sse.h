/*
 * A reader of Server-Sent Events (WHATWG HTML, section 9.2) over HTTP/1.1, for
 * tests: one socket, no thread.
 */
#ifndef TESTS_SUPPORT_SSE_H
#define TESTS_SUPPORT_SSE_H

#include <stdbool.h>
#include <stddef.h>

struct sse_event {
	char id[64];
	char event[32];  /* "message" if the stream says none */
	char data[1024]; /* cut to size */
	bool is_comment; /* a comment line, in data, and nothing else */
};

enum sse_outcome {
	SSE_EVENT,
	SSE_NOTHING, /* in the time given */
	SSE_END,     /* the answer is complete */
	SSE_CUT      /* the connection broke before */
};

/* The rest is its own. */
struct sse {
	int fd;          /* for poll; -1: closed */
	int status;      /* of the answer, 0: none came */
	char head[2048]; /* its head; of other than 200 also the body, cut */
	int retry;       /* milliseconds that the stream has said, or 0 */
	char *raw, *text;
	size_t raw_length, raw_size, text_length, text_size;
	size_t chunk;    /* bytes of the chunk yet to come */
	bool is_inside;  /* a chunk, or behind one */
	bool is_over, is_cut;
};

/*
 * Asks 127.0.0.1:port for path with headers ("Name: value\r\n"..., or "") and
 * reads the answer's head, for 5 s at most; true: it is 200. For sse_close in
 * any case.
 */
bool sse_open(struct sse *s, int port, const char *path,
    const char *headers);

/* The next event or comment within so many milliseconds; 0: of what is there,
 * reading what the socket has. */
enum sse_outcome sse_next(struct sse *s, struct sse_event *out,
    int milliseconds);

void sse_close(struct sse *s);

#endif
