#include "server/etag.h"

#include <stdint.h>
#include <string.h>

#include <nettle/sha2.h>

void etag_of(const void *data, size_t length, char out[static ETAG_SIZE])
{
	static const char hex[] = "0123456789abcdef";
	uint8_t digest[ETAG_DIGITS / 2];
	struct sha256_ctx sha;

	sha256_init(&sha);
	sha256_update(&sha, length, data);
	sha256_digest(&sha, sizeof digest, digest);
	out[0] = '"';
	for (size_t i = 0; i < sizeof digest; i++) {
		out[1 + 2 * i] = hex[digest[i] >> 4];
		out[2 + 2 * i] = hex[digest[i] & 15];
	}
	out[ETAG_DIGITS + 1] = '"';
	out[ETAG_DIGITS + 2] = '\0';
}

/* One tag of a list: where its quote opens, how long with both quotes. */
struct tag {
	const char *at;
	size_t length;
	bool weak;
};

/*
 * The next tag of the list at *cursor. False at its end, and then *cursor is at
 * the NUL, or at what is no tag.
 */
static bool next_tag(const char **cursor, struct tag *out)
{
	const char *at = *cursor + strspn(*cursor, " \t,");
	const char *close;

	*cursor = at;
	out->weak = strncmp(at, "W/", 2) == 0;
	at += out->weak ? 2 : 0;
	close = *at == '"' ? strchr(at + 1, '"') : NULL;
	if (close == NULL)
		return false;
	out->at = at;
	out->length = (size_t)(close + 1 - at);
	*cursor = close + 1;
	return true;
}

static bool is_any(const char *list)
{
	const char *at = list + strspn(list, " \t");

	return at[0] == '*' && at[1 + strspn(at + 1, " \t")] == '\0';
}

static bool is_valid(const char *list)
{
	struct tag tag;
	size_t count = 0;

	if (list == NULL || is_any(list))
		return true;
	while (next_tag(&list, &tag))
		count++;
	return count > 0 && *list == '\0';
}

static bool has_tag(const char *list, const char *etag, bool weakly)
{
	struct tag tag;

	if (is_any(list))
		return true;
	while (next_tag(&list, &tag)) {
		if ((weakly || !tag.weak) && tag.length == strlen(etag) &&
		    memcmp(tag.at, etag, tag.length) == 0)
			return true;
	}
	return false;
}

bool precondition_is_valid(const struct precondition *precondition)
{
	return is_valid(precondition->match) &&
	    is_valid(precondition->none_match);
}

bool precondition_match(const struct precondition *precondition,
    const char *etag)
{
	return precondition->match == NULL ||
	    (etag != NULL && has_tag(precondition->match, etag, false));
}

bool precondition_none_match(const struct precondition *precondition,
    const char *etag)
{
	return precondition->none_match == NULL || etag == NULL ||
	    !has_tag(precondition->none_match, etag, true);
}
