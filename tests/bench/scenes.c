#include "tests/bench/scenes.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/document.h"
#include "proto/fault.h"
#include "tests/support/random_tree.h"

/* Bytes a node's text is less than. */
#define NODE_TEXT 256

__attribute__((format(printf, 2, 3)))
static void append(struct scene *s, const char *format, ...)
{
	va_list list;

	va_start(list, format);
	s->length += (size_t)vsnprintf(s->text + s->length, NODE_TEXT, format,
	    list);
	va_end(list);
}

static void begin(struct scene *s, const char *name, int nodes)
{
	*s = (struct scene){.low = {-1.2, -1.2, -1.2}, .high = {1.2, 1.2, 1.2}};
	snprintf(s->name, sizeof(s->name), "%s", name);
	s->text = calloc((size_t)nodes + 2, NODE_TEXT);
	if (!s->text)
		abort();
	append(s, "{\"format\":\"blobfield/1\",\"root\":");
}

static void parse(struct scene *s)
{
	const struct document_limits limits = {.max_nodes = 100000,
	    .layout = LAYOUT_WARPED};
	struct faults faults = {0};

	if (document_parse(s->text, s->length, &limits, &s->document,
	    &faults)) {
		fprintf(stderr, "%s: %s %s\n", s->name, faults.list[0].pointer,
		    faults.list[0].detail);
		abort();
	}
	s->tape = document_tape(s->document);
}

static void end(struct scene *s)
{
	append(s, "}");
	parse(s);
}

void scene_file(struct scene *s, const char *path)
{
	const char *base = strrchr(path, '/');
	FILE *file = fopen(path, "rb");
	long size;

	*s = (struct scene){0};
	if (file == NULL || fseek(file, 0, SEEK_END) != 0 ||
	    (size = ftell(file)) < 0)
		abort();
	rewind(file);
	snprintf(s->name, sizeof(s->name), "%s", base != NULL ? base + 1 : path);
	s->text = calloc((size_t)size + 1, 1);
	if (s->text == NULL)
		abort();
	s->length = fread(s->text, 1, (size_t)size, file);
	fclose(file);
	parse(s);
}

void scene_fini(struct scene *s)
{
	document_free(s->document);
	free(s->text);
}

void scene_points(struct scene *s, const char *kind, int count)
{
	struct random_stream r = {1};
	double shrink = cbrt(50.0 / count);
	char name[48];

	snprintf(name, sizeof(name), "%d points, %s", count, kind);
	begin(s, name, count);
	append(s, "{%s,\"children\":[", strcmp(kind, "sum") == 0 ? SCENE_SUM :
	    SCENE_CAMEL);
	for (int i = 0; i < count; i++) {
		double radius = shrink * random_in(&r, 0.2, 0.3);
		double x = random_in(&r, -1.0, 1.0);
		double y = random_in(&r, -1.0, 1.0);
		double z = random_in(&r, -1.0, 1.0);

		append(s, "%s{\"type\":\"point\",\"center\":[%.7g,%.7g,%.7g],"
		    "\"radius\":%.7g}", i > 0 ? "," : "", x, y, z, radius);
	}
	append(s, "]}");
	end(s);
}

static void write_vector(struct scene *s, const char *name,
    struct random_stream *r)
{
	double x = random_in(r, -1.0, 1.0), y = random_in(r, -1.0, 1.0);

	append(s, ",\"%s\":[%.4f,%.4f,%.4f]", name, x, y,
	    random_in(r, -1.0, 1.0));
}

/* How a primitive is written, and what its place is called; "translation" where
 * it is given about the origin. */
struct kind {
	const char *rest, *place;
};

/* Every primitive but the plane. */
static const struct kind kinds[] = {
	{"\"point\",\"radius\":0.25", "center"},
	{"\"segment\",\"a\":[0,0,0],\"b\":[0.3,0,0],\"radius\":0.2",
		"translation"},
	{"\"triangle\",\"a\":[0,0,0],\"b\":[0.3,0,0],\"c\":[0,0.3,0],"
		"\"radius\":0.15", "translation"},
	{"\"disc\",\"normal\":[0,0.6,0.8],\"disc_radius\":0.2,"
		"\"radius\":0.15", "center"},
	{"\"circle\",\"normal\":[0.6,0,0.8],\"ring_radius\":0.3,"
		"\"radius\":0.1", "center"},
	{"\"sphere\",\"radius\":0.3,\"falloff\":0.3", "center"},
	{"\"box\",\"half_size\":[0.3,0.2,0.2],\"rounding\":0.05,"
		"\"falloff\":0.3", "center"},
	{"\"cylinder\",\"a\":[0,0,0],\"b\":[0,0,0.4],\"radius\":0.2,"
		"\"falloff\":0.3", "translation"},
	{"\"capsule\",\"a\":[0,0,0],\"b\":[0,0.4,0],\"radius\":0.2,"
		"\"falloff\":0.3", "translation"},
	{"\"cone\",\"a\":[0,0,0],\"b\":[0,0,0.4],\"radii\":[0.3,0.1],"
		"\"falloff\":0.3", "translation"},
	{"\"torus\",\"axis\":[0,0,1],\"major\":0.3,\"minor\":0.1,"
		"\"falloff\":0.2", "center"},
};

#define KINDS ((int)(sizeof(kinds) / sizeof(*kinds)))

/* A balanced binary tree over primitives first..first + count - 1. */
static void write_mixed(struct scene *s, struct random_stream *r, int first,
    int count)
{
	static const char *const types[] = {SCENE_CAMEL, SCENE_SUM,
		"\"type\":\"union\",\"operator\":\"clean\"",
		"\"type\":\"ricci\",\"n\":2",
		"\"type\":\"union\",\"operator\":\"contact\"",
		"\"type\":\"difference\",\"operator\":\"clean\"",
		"\"type\":\"union\",\"operator\":\"sharp\"",
		"\"type\":\"union\",\"operator\":\"organic\""};

	if (count == 1) {
		append(s, "{\"type\":%s", kinds[first % KINDS].rest);
		write_vector(s, kinds[first % KINDS].place, r);
		append(s, "}");
		return;
	}
	append(s, "{%s,\"children\":[", types[random_below(r, 8)]);
	write_mixed(s, r, first, count / 2);
	append(s, ",");
	write_mixed(s, r, first + count / 2, count - count / 2);
	append(s, "]}");
}

void scene_mixed(struct scene *s, int count)
{
	struct random_stream r = {7};
	char name[48];

	snprintf(name, sizeof(name), "%d mixed", count);
	begin(s, name, 2 * count);
	write_mixed(s, &r, 0, count);
	end(s);
}

void scene_letter(struct scene *s)
{
	static const char *const segments[] = {
		"\"a\":[-1,0,0],\"b\":[0,0,2.6],\"radius\":0.2",
		"\"a\":[1,0,0],\"b\":[0,0,2.6],\"radius\":0.2",
		"\"a\":[-0.69,0,0.8],\"b\":[0.69,0,0.8],\"radius\":0.16"};

	begin(s, "letter A", 4);
	memcpy(s->low, (double[]){-1.5, -0.5, -0.5}, sizeof(s->low));
	memcpy(s->high, (double[]){1.5, 0.5, 3.1}, sizeof(s->high));
	append(s, "{%s,\"children\":[", SCENE_CAMEL);
	for (int i = 0; i < 3; i++)
		append(s, "%s{\"type\":\"segment\",%s}", i > 0 ? "," : "",
		    segments[i]);
	append(s, "]}");
	end(s);
}

const char *scene_order_name(enum scene_order order)
{
	return order == SCENE_GRID ? "coherent" : "random";
}

/* The grid of at least count points with the fewest along x. */
static void place_grid(const struct scene *s, size_t count, float *xyz)
{
	size_t n = 2;

	while (n * n * n < count)
		n++;
	for (size_t i = 0; i < count; i++) {
		const size_t at[] = {i % n, i / n % n, i / n / n};

		for (int k = 0; k < 3; k++)
			xyz[3 * i + (size_t)k] = (float)(s->low[k] +
			    (s->high[k] - s->low[k]) *
			    (double)at[k] / (double)(n - 1));
	}
}

static void shuffle(size_t count, float *xyz)
{
	struct random_stream r = {3};

	for (size_t i = count; i-- > 1;) {
		size_t j = (size_t)random_below(&r, (int)i + 1);
		float swap[3];

		memcpy(swap, xyz + 3 * i, sizeof(swap));
		memcpy(xyz + 3 * i, xyz + 3 * j, sizeof(swap));
		memcpy(xyz + 3 * j, swap, sizeof(swap));
	}
}

void scene_place(const struct scene *s, enum scene_order order, size_t count,
    float *xyz)
{
	struct random_stream r = {5};

	if (order != SCENE_RANDOM)
		place_grid(s, count, xyz);
	if (order == SCENE_SHUFFLED)
		shuffle(count, xyz);
	for (size_t i = 0; order == SCENE_RANDOM && i < 3 * count; i++)
		xyz[i] = (float)random_in(&r, s->low[i % 3], s->high[i % 3]);
}
