/*
 * Binary STL: 80 bytes of header, how many facets, and 50 bytes for each: a
 * normal, three corners, and two bytes that say nothing.
 */
#include "proto/mesh_file.h"

#include "core/mesh.h"
#include "proto/mesh_file_internal.h"
#include "proto/text.h"

#define HEADER 80
#define FACET 50

/* Readers take a file that begins with "solid" for text. */
static void put_header(struct mesh_out *out, const char *name)
{
	static const char by[] = "blobfield ";
	char header[HEADER + 1] = "";

	memcpy(header, by, sizeof by);
	text_clean(name, 0, header + sizeof by - 1, sizeof header -
	    (sizeof by - 1));
	mesh_out_bytes(out, header, HEADER);
}

static struct vec3 corner(const struct mesh *m, uint32_t vertex)
{
	const float *p = m->positions + 3 * (size_t)vertex;

	return vec3(p[0], p[1], p[2]);
}

/* (b - a) x (c - a), of length 1; 0 of a triangle without area. */
static void facet_normal(const struct vec3 corners[static 3], float out[3])
{
	struct vec3 n = vec3_cross(vec3_sub(corners[1], corners[0]),
	    vec3_sub(corners[2], corners[0]));

	if (vec3_dot(n, n) > 0.0)
		n = vec3_unit(n);
	else
		n = vec3(0.0, 0.0, 0.0);
	out[0] = (float)n.x;
	out[1] = (float)n.y;
	out[2] = (float)n.z;
}

static void put_facet(char *at, const struct mesh *m, const uint32_t *t)
{
	const struct vec3 corners[3] = {corner(m, t[0]), corner(m, t[1]),
	    corner(m, t[2])};
	float normal[3];

	facet_normal(corners, normal);
	at = mesh_put_floats(at, normal, 3);
	for (int i = 0; i < 3; i++)
		at = mesh_put_floats(at, m->positions + 3 * (size_t)t[i], 3);
	at[0] = at[1] = 0;
}

enum err mesh_file_stl(const struct mesh *m, const char *name, char **data,
    size_t *length)
{
	const size_t count = m->figures.triangles;
	struct mesh_out out = {0};
	char *at;

	if (count > UINT32_MAX / FACET)
		return ERR_LIMIT;
	mesh_out_reserve(&out, HEADER + 4 + count * FACET);
	put_header(&out, name);
	at = mesh_out_take(&out, 4 + count * FACET);
	if (at != NULL)
		at = mesh_put_u32(at, (uint32_t)count);
	for (size_t i = 0; at != NULL && i < count; i++, at += FACET)
		put_facet(at, m, m->triangles + 3 * i);
	return mesh_out_finish(&out, data, length);
}
