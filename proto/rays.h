/*
 * Batches of rays in: JSON, raw float32, npy.
 */
#ifndef PROTO_RAYS_H
#define PROTO_RAYS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/raycast.h"

struct faults;
struct json_place;
struct json_text;

/* RAY_FLOATS numbers each: origin within TREE_COORDINATE_MAX, a finite
 * direction other than 0. Start with {0}; rays_fini frees. */
struct rays {
	float *numbers; /* malloc'd; NULL if count is 0 */
	size_t count;
	bool flat;      /* JSON gave [ox,oy,oz,dx,dy,dz,ox,...], so vectors of
	                 * the answer are flat, too */
};
void rays_fini(struct rays *rays);

/*
 * Reads a JSON array of rays, nested or flat, within a longer text, after white
 * space; at: its place. ERR_SYNTAX: not JSON; ERR_INVALID: other JSON, the text
 * is then read on behind it; ERR_LIMIT: more than max_rays; each adds a fault.
 * ERR_MEMORY.
 */
enum err rays_read(struct json_text *text, const struct json_place *at,
    size_t max_rays, struct rays *out, struct faults *faults);

/* Little-endian float32; length a multiple of 24, else ERR_SYNTAX. Otherwise
 * the same errors; pointers are "/rays/i", too, though there is no JSON. */
enum err rays_from_octets(const void *data, size_t length, size_t max_rays,
    struct rays *out, struct faults *faults);

/* NumPy .npy of shape (N, 6), '<f4' or '<f8', C order. ERR_SYNTAX when it is no
 * npy file, or shorter or longer than it says. */
enum err rays_from_npy(const void *data, size_t length, size_t max_rays,
    struct rays *out, struct faults *faults);

#endif
