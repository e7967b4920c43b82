/*
 * What is wrong with a request's content: a list of places and sentences, the
 * "errors" member of problem details (SPEC section 3).
 */
#ifndef PROTO_FAULT_H
#define PROTO_FAULT_H

#include <stddef.h>

#define FAULT_MAX 16       /* kept; more are only counted */
#define FAULT_POINTER_MAX 256
#define FAULT_DETAIL_MAX 192

struct fault {
	char pointer[FAULT_POINTER_MAX]; /* JSON pointer (RFC 6901), "" the whole */
	char detail[FAULT_DETAIL_MAX];   /* a sentence for a person */
};

/* Start with {0}. */
struct faults {
	size_t count;                    /* may exceed FAULT_MAX */
	struct fault list[FAULT_MAX];
};

/*
 * Adds one. A pointer too long for its field is cut in the middle with "...";
 * control characters and broken UTF-8 in what a user wrote are replaced.
 */
void faults_add(struct faults *faults, const char *pointer,
    const char *detail, ...) __attribute__((format(printf, 3, 4)));

#endif
