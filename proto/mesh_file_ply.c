/*
 * PLY, format binary_little_endian 1.0 (Turk 1994).
 */
#include "proto/mesh_file.h"

#include <math.h>

#include "core/mesh.h"
#include "proto/mesh_file_internal.h"
#include "proto/text.h"

/* Of a comment, which is a line. */
#define NAME_MAX_BYTES 128

#define FACE (1 + 3 * 4)

static void put_header(struct mesh_out *out, const struct mesh *m,
    const char *name)
{
	char line[NAME_MAX_BYTES];

	mesh_out_text(out, "ply\nformat binary_little_endian 1.0\n"
	    "comment made by blobfield; Z is up, colours are sRGB\n");
	text_clean(name, 0, line, sizeof line);
	if (line[0] != '\0')
		mesh_out_text(out, "comment %s\n", line);
	mesh_out_text(out, "element vertex %zu\nproperty float x\n"
	    "property float y\nproperty float z\n", m->figures.vertices);
	if (m->normals != NULL)
		mesh_out_text(out, "property float nx\nproperty float ny\n"
		    "property float nz\n");
	if (m->colors != NULL)
		mesh_out_text(out, "property uchar red\nproperty uchar green\n"
		    "property uchar blue\n");
	mesh_out_text(out, "element face %zu\nproperty list uchar int "
	    "vertex_indices\nend_header\n", m->figures.triangles);
}

/* A linear component as IEC 61966-2-1 encodes it. */
static unsigned char srgb_byte(float linear)
{
	const double c = fmin(fmax(linear, 0.0), 1.0);
	const double encoded = c <= 0.0031308 ? 12.92 * c :
	    1.055 * pow(c, 1.0 / 2.4) - 0.055;

	return (unsigned char)lround(255.0 * encoded);
}

static char *put_vertex(char *at, const struct mesh *m, size_t vertex)
{
	at = mesh_put_floats(at, m->positions + 3 * vertex, 3);
	if (m->normals != NULL)
		at = mesh_put_floats(at, m->normals + 3 * vertex, 3);
	for (int i = 0; m->colors != NULL && i < 3; i++)
		*at++ = (char)srgb_byte(m->colors[3 * vertex + (size_t)i]);
	return at;
}

static char *put_face(char *at, const uint32_t *triangle)
{
	*at++ = 3;
	for (int i = 0; i < 3; i++)
		at = mesh_put_u32(at, triangle[i]);
	return at;
}

enum err mesh_file_ply(const struct mesh *m, const char *name, char **data,
    size_t *length)
{
	const struct mesh_figures *f = &m->figures;
	const size_t vertex = 12 + (m->normals != NULL ? 12u : 0u) +
	    (m->colors != NULL ? 3u : 0u);
	struct mesh_out out = {0};
	size_t bytes;
	char *at;

	if (f->vertices > INT32_MAX / vertex || f->triangles > INT32_MAX / FACE)
		return ERR_LIMIT;
	bytes = f->vertices * vertex + f->triangles * FACE;
	put_header(&out, m, name);
	mesh_out_reserve(&out, bytes);
	at = mesh_out_take(&out, bytes);
	for (size_t i = 0; at != NULL && i < f->vertices; i++)
		at = put_vertex(at, m, i);
	for (size_t i = 0; at != NULL && i < f->triangles; i++)
		at = put_face(at, m->triangles + 3 * i);
	return mesh_out_finish(&out, data, length);
}
