/*
 * Answers of HTTP/1.1, read strictly: what is wrong with one ends the program.
 */
#ifndef TESTS_FUZZ_HTTP_ANSWER_H
#define TESTS_FUZZ_HTTP_ANSWER_H

#include <stdbool.h>
#include <stddef.h>

struct http_answer {
	int status;
	bool is_stream;   /* of events: only its head is there */
	bool closes;
	size_t length;    /* of all of it */
	char *body;       /* malloc'd, with a NUL behind it; chunks joined */
	size_t body_length;
};

/*
 * Reads the answer that bytes begin with; is_head: to HEAD; is_over: nothing
 * follows bytes. False: there is not all of it yet. Aborts where it is none, or
 * is not what its head says it is: a problem with another status, JSON that is
 * none, floats that are not finite.
 */
bool http_answer_read(const char *bytes, size_t length, bool is_head,
    bool is_over, struct http_answer *out);

#endif
