/*
 * Wavefront OBJ. Colours stand behind the coordinates, as most programs that
 * read any expect; one normal belongs to each vertex.
 */
#include "proto/mesh_file.h"

#include "core/mesh.h"
#include "proto/mesh_file_internal.h"
#include "proto/number.h"
#include "proto/text.h"

#define NAME_MAX_BYTES 128

/* Room of a line: two letters, six numbers, what printing writes behind. */
#define LINE_MAX (4 + 6 * (NUMBER_FLOAT_MAX + 1) + NUMBER_FLOAT_ROOM)

/* " x y z" to at; behind it. */
static char *put_numbers(char *at, const float *values)
{
	for (int i = 0; i < 3; i++) {
		*at++ = ' ';
		at += number_print_float(values[i], at);
	}
	return at;
}

static void put_vertex(struct mesh_out *out, const struct mesh *m,
    size_t vertex)
{
	char line[LINE_MAX], *at = line;

	*at++ = 'v';
	at = put_numbers(at, m->positions + 3 * vertex);
	if (m->colors != NULL)
		at = put_numbers(at, m->colors + 3 * vertex);
	*at++ = '\n';
	mesh_out_bytes(out, line, (size_t)(at - line));
}

static void put_normal(struct mesh_out *out, const float *normal)
{
	char line[LINE_MAX] = "vn", *at;

	at = put_numbers(line + 2, normal);
	*at++ = '\n';
	mesh_out_bytes(out, line, (size_t)(at - line));
}

static char *put_index(char *at, uint32_t index)
{
	char digits[10];
	int n = 0;

	do
		digits[n++] = (char)('0' + index % 10);
	while ((index /= 10) > 0);
	while (n > 0)
		*at++ = digits[--n];
	return at;
}

/* Counted from 1; "a//a": the normal of the same number. */
static void put_face(struct mesh_out *out, const uint32_t *triangle,
    bool has_normals)
{
	char line[2 + 3 * 24], *at = line;

	*at++ = 'f';
	for (int i = 0; i < 3; i++) {
		*at++ = ' ';
		at = put_index(at, triangle[i] + 1);
		if (!has_normals)
			continue;
		*at++ = '/';
		*at++ = '/';
		at = put_index(at, triangle[i] + 1);
	}
	*at++ = '\n';
	mesh_out_bytes(out, line, (size_t)(at - line));
}

enum err mesh_file_obj(const struct mesh *m, const char *name, char **data,
    size_t *length)
{
	const struct mesh_figures *f = &m->figures;
	struct mesh_out out = {0};
	char line[NAME_MAX_BYTES];

	if (f->vertices >= UINT32_MAX)
		return ERR_LIMIT;
	text_clean(name, 0, line, sizeof line);
	mesh_out_text(&out, "# made by blobfield; Z is up, colours are linear\n"
	    "o %s\n", line[0] != '\0' ? line : "model");
	for (size_t i = 0; i < f->vertices; i++)
		put_vertex(&out, m, i);
	for (size_t i = 0; m->normals != NULL && i < f->vertices; i++)
		put_normal(&out, m->normals + 3 * i);
	for (size_t i = 0; i < f->triangles; i++)
		put_face(&out, m->triangles + 3 * i, m->normals != NULL);
	return mesh_out_finish(&out, data, length);
}
