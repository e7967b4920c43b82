#include "proto/npy.h"

#include <math.h>
#include <string.h>

#include "proto/fault.h"

#define MAGIC "\x93NUMPY"
#define MAGIC_BYTES 6

/* The text of the header being read. */
struct scan {
	const char *p, *end;
};

/* What the header has said so far. */
struct header {
	bool has_descr, has_order, has_shape;
	bool is_float, is_double;
	struct npy npy;
};

static void skip_space(struct scan *s)
{
	while (s->p < s->end && (*s->p == ' ' || *s->p == '\n' ||
	    *s->p == '\t' || *s->p == '\r'))
		s->p++;
}

static bool take(struct scan *s, char c)
{
	skip_space(s);
	if (s->p == s->end || *s->p != c)
		return false;
	s->p++;
	return true;
}

static bool take_word(struct scan *s, const char *word)
{
	const size_t n = strlen(word);

	if ((size_t)(s->end - s->p) < n || memcmp(s->p, word, n) != 0)
		return false;
	s->p += n;
	return true;
}

/* A quoted string without escapes to out; false if it is none, or too long. */
static bool take_string(struct scan *s, char *out, size_t size)
{
	const char quote = take(s, '\'') ? '\'' : '"';
	size_t n = 0;

	if (quote == '"' && !take(s, '"'))
		return false;
	while (s->p < s->end && *s->p != quote && n + 1 < size)
		out[n++] = *s->p++;
	out[n] = '\0';
	return s->p < s->end && *s->p++ == quote;
}

static bool take_integer(struct scan *s, uint64_t *out)
{
	uint64_t value = 0;
	bool any = false;

	skip_space(s);
	for (; s->p < s->end && *s->p >= '0' && *s->p <= '9'; s->p++) {
		if (value > (UINT64_MAX - 9) / 10)
			return false;
		value = 10 * value + (uint64_t)(*s->p - '0');
		any = true;
	}
	*out = value;
	return any;
}

/* A tuple of integers: (), (N,), (N, M), ... */
static bool take_shape(struct scan *s, struct header *h)
{
	uint64_t size;
	size_t n = 0;

	if (!take(s, '('))
		return false;
	while (!take(s, ')')) {
		if (!take_integer(s, &size))
			return false;
		if (n < NPY_AXES)
			h->npy.shape[n] = size;
		n++;
		if (!take(s, ',')) {
			if (!take(s, ')'))
				return false;
			break;
		}
	}
	h->npy.axes = n;
	h->has_shape = true;
	return true;
}

static bool take_entry(struct scan *s, struct header *h)
{
	char key[16], descr[32];

	if (!take_string(s, key, sizeof key) || !take(s, ':'))
		return false;
	if (strcmp(key, "shape") == 0)
		return take_shape(s, h);
	if (strcmp(key, "fortran_order") == 0) {
		skip_space(s);
		h->has_order = true;
		h->npy.is_fortran = take_word(s, "True");
		return h->npy.is_fortran || take_word(s, "False");
	}
	if (strcmp(key, "descr") != 0 ||
	    !take_string(s, descr, sizeof descr))
		return false;
	h->has_descr = true;
	h->is_float = strcmp(descr, "<f4") == 0;
	h->is_double = strcmp(descr, "<f8") == 0;
	return true;
}

static bool parse_header(struct scan s, struct header *h)
{
	if (!take(&s, '{'))
		return false;
	while (!take(&s, '}')) {
		if (!take_entry(&s, h))
			return false;
		if (!take(&s, ',')) {
			if (!take(&s, '}'))
				return false;
			break;
		}
	}
	skip_space(&s);
	return s.p == s.end && h->has_descr && h->has_order && h->has_shape;
}

/* Where the header's text lies; false if data is no npy file. */
static bool find_header(const unsigned char *data, size_t length,
    struct scan *out)
{
	size_t start = MAGIC_BYTES + 4, size;

	if (length < start || memcmp(data, MAGIC, MAGIC_BYTES) != 0 ||
	    data[6] < 1 || data[6] > 3 || data[7] != 0)
		return false;
	size = (size_t)data[8] | (size_t)data[9] << 8;
	if (data[6] > 1) {
		start += 2;
		if (length < start)
			return false;
		size |= (size_t)data[10] << 16 | (size_t)data[11] << 24;
	}
	if (size > length - start)
		return false;
	*out = (struct scan){(const char *)data + start,
	    (const char *)data + start + size};
	return true;
}

static enum err refuse(enum err err, struct faults *faults, const char *why)
{
	faults_add(faults, "", "%s", why);
	return err;
}

enum err npy_read(const void *file, size_t length, struct npy *out,
    struct faults *faults)
{
	struct header h = {0};
	struct scan header;

	if (!find_header(file, length, &header))
		return refuse(ERR_SYNTAX, faults, "not an npy file of format "
		    "1.0, 2.0 or 3.0");
	if (!parse_header(header, &h))
		return refuse(ERR_SYNTAX, faults, "the npy header is not one "
		    "of an array of plain numbers");
	if (!h.is_float && !h.is_double)
		return refuse(ERR_INVALID, faults, "descr must be '<f4' or "
		    "'<f8' (little-endian float32 or float64)");
	h.npy.is_double = h.is_double;
	h.npy.data = (const unsigned char *)header.end;
	h.npy.length = length - (size_t)(header.end - (const char *)file);
	*out = h.npy;
	return ERR_OK;
}

static float load_f4(const unsigned char *p)
{
	const uint32_t bits = (uint32_t)p[0] | (uint32_t)p[1] << 8 |
	    (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
	union {
		uint32_t bits;
		float f;
	} u = {.bits = bits};

	return u.f;
}

static double load_f8(const unsigned char *p)
{
	union {
		uint64_t bits;
		double f;
	} u = {.bits = 0};
	int i;

	for (i = 7; i >= 0; i--)
		u.bits = u.bits << 8 | p[i];
	return u.f;
}

size_t npy_floats(const unsigned char *data, size_t count, bool is_double,
    float *out)
{
	size_t bad = 0, i;

	if (is_double) {
		for (i = 0; i < count; i++) {
			out[i] = (float)load_f8(data + 8 * i);
			bad += !isfinite(out[i]);
		}
	} else {
		for (i = 0; i < count; i++) {
			out[i] = load_f4(data + 4 * i);
			bad += !isfinite(out[i]);
		}
	}
	return bad;
}
