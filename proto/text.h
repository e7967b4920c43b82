/*
 * UTF-8, and names compared by how they are spelt.
 */
#ifndef PROTO_TEXT_H
#define PROTO_TEXT_H

#include <stdbool.h>
#include <stddef.h>
#include <string.h>

/* Whether a and b are the same. Inline: most names differ at once. */
static inline bool text_equal(const char *a, const char *b)
{
	return *a == *b && strcmp(a, b) == 0;
}

/* Bytes of the UTF-8 sequence at p < end (1 to 4), or 0 if it is not
 * well-formed (RFC 3629: no overlong forms, no surrogates). */
size_t text_sequence(const char *p, const char *end);

/*
 * Copies text to out of size > 8 bytes, NUL included, as clean UTF-8: control
 * characters and broken sequences become '?'. What does not fit is left out,
 * in the middle if middle is true, else at the end, and "..." stands for it.
 */
void text_clean(const char *text, int middle, char *out, size_t size);

/*
 * How many single-character slips (one missing, too many, wrong, or two
 * swapped) lie between a and b; names of more than 31 bytes count as unlike
 * anything, 99.
 */
int text_distance(const char *a, const char *b);

#endif
