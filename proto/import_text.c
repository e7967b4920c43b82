#include <float.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/import_internal.h"
#include "proto/number.h"

#define SIZE_FIRST ((size_t)1 << 12)
#define NUMBER_ROOM 32

/* Room for length bytes more, and a NUL. */
static bool reserve(struct import_text *text, size_t length)
{
	size_t size = text->size ? text->size : SIZE_FIRST;
	char *bytes;

	if (text->failed)
		return false;
	while (length >= size - text->length)
		size *= 2;
	if (size == text->size)
		return true;
	bytes = realloc(text->bytes, size);
	if (!bytes) {
		text->failed = true;
		return false;
	}
	text->bytes = bytes;
	text->size = size;
	return true;
}

void import_put_bytes(struct import_text *text, const char *bytes,
    size_t length)
{
	if (!reserve(text, length))
		return;
	memcpy(text->bytes + text->length, bytes, length);
	text->length += length;
	text->bytes[text->length] = '\0';
}

void import_put(struct import_text *text, const char *string)
{
	import_put_bytes(text, string, strlen(string));
}

static bool reads_back(const char *digits, double number)
{
	const char *end = digits + strlen(digits);
	double back;

	return number_parse(&digits, end, &back) == 0 && back == number;
}

/* 17 digits tell any two doubles apart (DBL_DECIMAL_DIG). */
void import_put_number(struct import_text *text, double number)
{
	char digits[NUMBER_ROOM];
	int count = DBL_DIG - 1;

	do {
		snprintf(digits, sizeof digits, "%.*g", ++count, number);
	} while (count < DBL_DECIMAL_DIG && !reads_back(digits, number));
	import_put(text, digits);
}

void import_put_vec3(struct import_text *text, struct vec3 v)
{
	import_put(text, "[");
	import_put_number(text, v.x);
	import_put(text, ",");
	import_put_number(text, v.y);
	import_put(text, ",");
	import_put_number(text, v.z);
	import_put(text, "]");
}
