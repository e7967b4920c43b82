/*
 * Numbers to and from decimal text: exact, locale-free.
 */
#ifndef PROTO_NUMBER_H
#define PROTO_NUMBER_H

#include <stddef.h>

/* The most characters a printed float32 has, and the room that printing takes:
 * it may write behind the number, too. */
#define NUMBER_FLOAT_MAX 16
#define NUMBER_FLOAT_ROOM 24

/*
 * The shortest decimal that reads back as the same float32, as JSON; among
 * those the nearest. Plain from 1e-5 up to 1e9, else with an exponent. f is
 * finite; -0 prints as 0. Returns the length; no NUL.
 */
size_t number_print_float(float f, char out[static NUMBER_FLOAT_ROOM]);

/*
 * Reads a JSON number (RFC 8259 grammar) from *cursor before end to the
 * nearest double (ties to even), and moves *cursor past it. 0 on success; -1,
 * and *cursor at the offending character, if it is no JSON number. Overflow
 * gives +-HUGE_VAL. Any number of digits.
 */
int number_parse(const char **cursor, const char *end, double *out);

/*
 * The same for most numbers, sooner: up to 19 digits, no exponent, and more
 * characters than those before end. Behind the number, or NULL if it is not
 * one of these.
 */
const char *number_parse_plain(const char *p, const char *end, double *out);

#endif
