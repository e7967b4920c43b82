#include "proto/text.h"

#include <stdbool.h>
#include <string.h>

#define NAME_MAX_COMPARED 31
#define UNLIKE 99

static bool continues(unsigned char c)
{
	return (c & 0xc0) == 0x80;
}

size_t text_sequence(const char *text, const char *end)
{
	const unsigned char *p = (const unsigned char *)text;
	const size_t left = (size_t)(end - text);
	unsigned char least = 0x80, most = 0xbf;
	size_t length, i;

	if (p[0] < 0x80)
		return 1;
	if (p[0] < 0xc2 || p[0] > 0xf4)
		return 0;
	length = p[0] < 0xe0 ? 2 : p[0] < 0xf0 ? 3 : 4;
	if (length > left)
		return 0;
	/* The second byte's range keeps out overlong forms and surrogates. */
	if (p[0] == 0xe0)
		least = 0xa0;
	else if (p[0] == 0xed)
		most = 0x9f;
	else if (p[0] == 0xf0)
		least = 0x90;
	else if (p[0] == 0xf4)
		most = 0x8f;
	if (p[1] < least || p[1] > most)
		return 0;
	for (i = 2; i < length; i++) {
		if (!continues(p[i]))
			return 0;
	}
	return length;
}

/* Replaces in place what is not clean; lengths do not change. */
static void scrub(char *text)
{
	const char *end = text + strlen(text);
	size_t n;

	for (; text < end; text += n) {
		n = text_sequence(text, end);
		if (n == 0 || (n == 1 && (*text < 0x20 || *text == 0x7f))) {
			*text = '?';
			n = 1;
		}
	}
}

void text_clean(const char *text, int middle, char *out, size_t size)
{
	const size_t length = strlen(text), room = size - 1;
	size_t head, tail;

	if (length <= room) {
		memcpy(out, text, length + 1);
	} else {
		tail = middle ? (room - 3) / 2 : 0;
		head = room - 3 - tail;
		while (head && continues((unsigned char)text[head]))
			head--;
		while (tail && continues((unsigned char)text[length - tail]))
			tail--;
		memcpy(out, text, head);
		memcpy(out + head, "...", 3);
		memcpy(out + head + 3, text + length - tail, tail + 1);
	}
	scrub(out);
}

static int least3(int a, int b, int c)
{
	if (b < a)
		a = b;
	return c < a ? c : a;
}

int text_distance(const char *a, const char *b)
{
	const size_t m = strlen(a), n = strlen(b);
	int d[NAME_MAX_COMPARED + 1][NAME_MAX_COMPARED + 1];
	size_t i, j;

	if (m > NAME_MAX_COMPARED || n > NAME_MAX_COMPARED)
		return UNLIKE;
	for (i = 0; i <= m; i++)
		d[i][0] = (int)i;
	for (j = 0; j <= n; j++)
		d[0][j] = (int)j;
	for (i = 1; i <= m; i++) {
		for (j = 1; j <= n; j++) {
			d[i][j] = least3(d[i - 1][j] + 1, d[i][j - 1] + 1,
			    d[i - 1][j - 1] + (a[i - 1] != b[j - 1]));
			if (i > 1 && j > 1 && a[i - 1] == b[j - 2] &&
			    a[i - 2] == b[j - 1] && d[i - 2][j - 2] + 1 < d[i][j])
				d[i][j] = d[i - 2][j - 2] + 1;
		}
	}
	return d[m][n];
}
