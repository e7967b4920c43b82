#include "server/scene_seq.h"

#include <ctype.h>
#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

int scene_seq_compare(struct scene_seq a, struct scene_seq b)
{
	if (a.major != b.major)
		return a.major < b.major ? -1 : 1;
	return (a.minor > b.minor) - (a.minor < b.minor);
}

void scene_seq_print(struct scene_seq seq, char out[static SCENE_SEQ_SIZE])
{
	if (seq.minor == 0)
		snprintf(out, SCENE_SEQ_SIZE, "%" PRIu64, seq.major);
	else
		snprintf(out, SCENE_SEQ_SIZE, "%" PRIu64 "-%" PRIu64, seq.major,
		    seq.minor);
}

/* A whole number at *text, which moves behind it. */
static bool read_number(const char **text, uint64_t *out)
{
	char *end;

	if (!isdigit((unsigned char)**text))
		return false;
	errno = 0;
	*out = strtoull(*text, &end, 10);
	*text = end;
	return errno == 0;
}

bool scene_seq_parse(const char *text, struct scene_seq *out)
{
	struct scene_seq seq = {0, 0};

	if (!read_number(&text, &seq.major))
		return false;
	if (*text == '-') {
		text++;
		if (!read_number(&text, &seq.minor))
			return false;
	}
	if (*text != '\0')
		return false;
	*out = seq;
	return true;
}
