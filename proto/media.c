/*
 * Media types of requests and answers (RFC 9110, 8.3 and 12.5.1).
 */
#include <string.h>
#include <strings.h>

#include "proto/request.h"

/* Most bytes of a type or parameter that are looked at. */
#define WORD_MAX 64

static const char *const names[MEDIA_COUNT] = {
	[MEDIA_JSON] = "application/json",
	[MEDIA_OCTETS] = "application/octet-stream",
	[MEDIA_NPY] = "application/x-npy",
	[MEDIA_PNG] = "image/png",
	[MEDIA_GLB] = "model/gltf-binary",
	[MEDIA_PLY] = "application/x-ply",
	[MEDIA_STL] = "model/stl",
	[MEDIA_OBJ] = "model/obj",
	[MEDIA_HTML] = "text/html",
	[MEDIA_SCRIPT] = "text/javascript",
	[MEDIA_STYLE] = "text/css",
	[MEDIA_SVG] = "image/svg+xml",
	[MEDIA_PROBLEM] = "application/problem+json",
	[MEDIA_JSON_PATCH] = "application/json-patch+json",
	[MEDIA_MERGE_PATCH] = "application/merge-patch+json",
	[MEDIA_EVENTS] = "text/event-stream",
	[MEDIA_METRICS] = "text/plain",
};

/* Of bodies of points, and of their answers. */
#define POINTS_MASK (1u << MEDIA_JSON | 1u << MEDIA_OCTETS | 1u << MEDIA_NPY)

/* What can be negotiated: all before this one, in the order of preference. */
#define OFFERED MEDIA_PROBLEM

const char *media_name(enum media_type type)
{
	return (unsigned)type < MEDIA_COUNT ? names[type] :
	    "application/octet-stream";
}

const char *media_content_type(enum media_type type)
{
	switch (type) {
	case MEDIA_HTML:
		return "text/html; charset=utf-8";
	case MEDIA_SCRIPT:
		return "text/javascript; charset=utf-8";
	case MEDIA_METRICS:
		return "text/plain; version=0.0.4; charset=utf-8";
	case MEDIA_STYLE:
		return "text/css; charset=utf-8";
	default:
		return media_name(type);
	}
}

static const char *skip_space(const char *p)
{
	return p + strspn(p, " \t");
}

/* Characters of a token (RFC 9110 5.6.2), and '/'. */
static size_t token_span(const char *p)
{
	return strspn(p, "!#$%&'*+-.^_`|~/0123456789abcdefghijklmnopqrstuvwxyz"
	    "ABCDEFGHIJKLMNOPQRSTUVWXYZ");
}

/* Copies n characters, in part if they do not fit. */
static void keep(const char *p, size_t n, char out[static WORD_MAX])
{
	if (n > WORD_MAX - 1)
		n = WORD_MAX - 1;
	memcpy(out, p, n);
	out[n] = '\0';
}

/* The token or quoted string at p, without quotes; behind it. */
static const char *read_value(const char *p, char out[static WORD_MAX])
{
	size_t n = 0;

	if (*p != '"') {
		n = token_span(p);
		keep(p, n, out);
		return p + n;
	}
	for (p++; *p && *p != '"'; p++) {
		if (*p == '\\' && p[1])
			p++;
		if (n < WORD_MAX - 1)
			out[n++] = *p;
	}
	out[n] = '\0';
	return *p ? p + 1 : p;
}

/* "; name=value" at p to name and value; behind it, or NULL if none is there. */
static const char *read_parameter(const char *p, char name[static WORD_MAX],
    char value[static WORD_MAX])
{
	size_t n;

	p = skip_space(p);
	if (*p != ';')
		return NULL;
	p = skip_space(p + 1);
	n = token_span(p);
	keep(p, n, name);
	value[0] = '\0';
	p += n;
	if (*p != '=')
		return p;
	return read_value(p + 1, value);
}

bool media_from_content_type(const char *value, enum media_type *out)
{
	char type[WORD_MAX], name[WORD_MAX], parameter[WORD_MAX];
	const char *p, *next;
	size_t n;

	p = value ? skip_space(value) : "";
	n = token_span(p);
	keep(p, n, type);
	for (p += n; (next = read_parameter(p, name, parameter)); p = next) {
		if (strcasecmp(name, "charset") == 0 &&
		    strcasecmp(parameter, "utf-8") != 0 &&
		    strcasecmp(parameter, "utf8") != 0)
			return false;
	}
	if (*skip_space(p))
		return false;
	for (int i = 0; i < OFFERED; i++) {
		if ((POINTS_MASK >> i & 1) == 0 ||
		    strcasecmp(type, names[i]) != 0)
			continue;
		*out = (enum media_type)i;
		return true;
	}
	return false;
}

/* "0", "1", "0.25"...: thousandths, or -1. */
static int read_quality(const char *text)
{
	int quality, place = 100;

	if (text[0] != '0' && text[0] != '1')
		return -1;
	quality = 1000 * (text[0] - '0');
	if (!text[1])
		return quality;
	if (text[1] != '.')
		return -1;
	for (text += 2; *text >= '0' && *text <= '9' && place; text++) {
		quality += place * (*text - '0');
		place /= 10;
	}
	return *text || quality > 1000 ? -1 : quality;
}

/* How exactly range names type: 3, 2 "application/", 1 any, 0 not at all. */
static int range_fits(const char *range, const char *type)
{
	const size_t slash = (size_t)(strchr(type, '/') - type) + 1;

	if (strcasecmp(range, type) == 0)
		return 3;
	if (strcmp(range, "*/*") == 0)
		return 1;
	return strncasecmp(range, type, slash) == 0 &&
	    strcmp(range + slash, "*") == 0 ? 2 : 0;
}

/* What an Accept header says of one offered type. */
struct preference {
	int fits;    /* of the range that fits best so far */
	int quality; /* thousandths */
};

/* One element of the list at p; behind it. */
static const char *read_range(const char *p,
    struct preference preferences[static OFFERED])
{
	char range[WORD_MAX], name[WORD_MAX], value[WORD_MAX];
	const char *next;
	int quality = 1000, fits;
	size_t n;

	p = skip_space(p);
	n = token_span(p);
	keep(p, n, range);
	for (p += n; (next = read_parameter(p, name, value)); p = next) {
		if (strcasecmp(name, "q") == 0)
			quality = read_quality(value);
	}
	p = skip_space(p);
	if (*p && *p != ',')
		quality = -1;
	for (int i = 0; i < OFFERED && quality >= 0; i++) {
		fits = range_fits(range, names[i]);
		if (fits > preferences[i].fits)
			preferences[i] = (struct preference){fits, quality};
	}
	return p + strcspn(p, ",");
}

bool media_choose(const char *value, unsigned mask, enum media_type first,
    enum media_type *out)
{
	struct preference preferences[OFFERED] = {{0, 0}};
	int best = 0;

	if (!value || !*skip_space(value))
		value = "*/*";
	for (;; value++) {
		value = read_range(value, preferences);
		if (!*value)
			break;
	}
	for (int i = 0; i < OFFERED; i++) {
		int quality = preferences[i].quality;

		if ((mask >> i & 1) == 0 || quality < best || quality == 0 ||
		    (quality == best && i != (int)first))
			continue;
		best = quality;
		*out = (enum media_type)i;
	}
	return best > 0;
}

bool media_from_accept(const char *value, enum media_type *out)
{
	return media_choose(value, POINTS_MASK, MEDIA_JSON, out);
}
