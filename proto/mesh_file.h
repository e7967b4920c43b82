/*
 * Meshes as files: glTF 2.0 binary, PLY (binary little-endian), STL (binary),
 * Wavefront OBJ; and what is known of them, as JSON.
 */
#ifndef PROTO_MESH_FILE_H
#define PROTO_MESH_FILE_H

#include <stddef.h>

#include "core/err.h"

struct cJSON;
struct mesh;
struct mesh_figures;

/*
 * Writes m. name is the model's, "" if none; UTF-8. *data (malloc'd) is the
 * caller's. Positions stay in world units, Z up; GLB's root node turns Z up to
 * glTF's Y up. Colours: GLB linear float, PLY sRGB bytes, OBJ linear behind the
 * positions, STL none. An empty mesh gives a valid file without geometry. The
 * same mesh gives the same bytes. ERR_MEMORY; ERR_LIMIT: more than a file of
 * 4 GiB holds.
 */
enum err mesh_file_glb(const struct mesh *m, const char *name, char **data,
    size_t *length);
enum err mesh_file_ply(const struct mesh *m, const char *name, char **data,
    size_t *length);
enum err mesh_file_stl(const struct mesh *m, const char *name, char **data,
    size_t *length);
enum err mesh_file_obj(const struct mesh *m, const char *name, char **data,
    size_t *length);

/* The members that proto/README.md names; NULL without memory. */
struct cJSON *mesh_figures_json(const struct mesh_figures *figures);

#endif
