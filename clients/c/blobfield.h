/*
 * A client of blobfieldd in C, over libcurl: keeps scenes, evaluates them,
 * meshes them, draws them. proto/README.md of the daemon is what it speaks.
 *
 *	struct blobfield *b = blobfield_create(NULL);
 *	const float points[6] = {0, 0, 2.6f, 0, 0, 1.4f};
 *	float values[2];
 *
 *	if (blobfield_evaluate(b, "a", points, 2, BLOBFIELD_VALUE, values) != 0)
 *		fprintf(stderr, "%s\n", blobfield_error(b)->detail);
 *	blobfield_free(b);
 *
 * Compile with -lblobfield -lcurl -lcjson.
 *
 * Every call that speaks to the daemon returns BLOBFIELD_OK, which is 0, or
 * what went wrong; blobfield_error then says more. Results are untouched on
 * failure. Lengths and coordinates are in the units of the scene, Z up, inside
 * is where the field exceeds 1/2.
 *
 * Threads: one struct blobfield at a time belongs to one thread, but
 * blobfield_cancel may be called by any, and by a signal's handler. It keeps
 * its connection open from one call to the next.
 */
#ifndef BLOBFIELD_H
#define BLOBFIELD_H

#include <stdbool.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

#define BLOBFIELD_URL "http://127.0.0.1:7878"

/* An id, a revision, an outcome: with their NUL. */
#define BLOBFIELD_ID_MAX 65
#define BLOBFIELD_TAG_MAX 80

enum blobfield_outcome {
	BLOBFIELD_OK,
	BLOBFIELD_REFUSED,     /* the daemon has answered with a problem */
	BLOBFIELD_UNREACHABLE, /* no connection, or cut off in the middle */
	BLOBFIELD_CANCELLED,   /* by blobfield_cancel, or by progress */
	BLOBFIELD_STRANGE,     /* an answer that is not what it should be */
	BLOBFIELD_FILE,        /* a file cannot be written */
	BLOBFIELD_ARGUMENT,    /* no such extension; too large; NULL */
	BLOBFIELD_MEMORY
};

/* A place in what was sent, and what is wrong with it. */
struct blobfield_place {
	char pointer[256]; /* JSON pointer (RFC 6901); "" is all of it,
	                    * "?name" a query parameter */
	char detail[256];
};

#define BLOBFIELD_PLACES_MAX 16

struct blobfield_error {
	enum blobfield_outcome outcome; /* of the last call */
	long status;      /* HTTP's; 0: there was no answer */
	char type[64];    /* "invalid", "not-found", "queue-full" ...: of the
	                   * problem, else "" */
	char title[64];
	char detail[512]; /* a sentence for a person */
	size_t count;     /* places that are wrong; may exceed what is kept */
	struct blobfield_place places[BLOBFIELD_PLACES_MAX];
};

struct blobfield;

/*
 * Makes a client of the daemon at url, "http://host:port"; NULL:
 * $BLOBFIELD_URL, else BLOBFIELD_URL. Nothing is sent. NULL: out of memory, or
 * libcurl does not start. Proxies of the environment are not used.
 */
struct blobfield *blobfield_create(const char *url);
void blobfield_free(struct blobfield *b);

/*
 * The token to send, for a daemon that asks for one; NULL or "": none. At first
 * $BLOBFIELD_TOKEN. It is copied; libcurl does not send it on to another host.
 * BLOBFIELD_ARGUMENT: it is no word of up to 255 printable characters.
 * What a daemon makes of it: status 401 (type "unauthorized"), 403
 * ("forbidden"), 429 ("too-many-requests", with the header Retry-After).
 */
enum blobfield_outcome blobfield_set_token(struct blobfield *b,
    const char *token);

/*
 * A file of certificates (PEM) to trust, instead of the system's, for a daemon
 * whose url is https. NULL or "": the system's. At first $BLOBFIELD_CA.
 * BLOBFIELD_ARGUMENT: it cannot be read. What is wrong in it, or with the
 * environment's, shows in the next call: BLOBFIELD_UNREACHABLE.
 */
enum blobfield_outcome blobfield_set_ca(struct blobfield *b,
    const char *path);

/* What the last call came to; valid until the next. */
const struct blobfield_error *blobfield_error(const struct blobfield *b);

/* The url, without a slash at its end. */
const char *blobfield_url(const struct blobfield *b);

/*
 * The value of a header of the last answer, "" if it has none; valid until the
 * next call.
 */
const char *blobfield_header(struct blobfield *b, const char *name);

/*
 * Has progress called some five times a second while a call waits for the
 * daemon: with what it is at ("cells", "vertices" ...; "" if that is not known)
 * and how much of the whole is done, 0 to 1. If it returns other than 0, the
 * call is given up, by closing its connection, with BLOBFIELD_CANCELLED. NULL:
 * none. The daemon knows a stage for raycast, project, render, slice, mesh.
 */
void blobfield_set_progress(struct blobfield *b,
    int (*progress)(void *ctx, const char *stage, double done), void *ctx);

/* Seconds after which the daemon gives a work up (504, type "deadline");
 * 0, which it is at first: never. */
void blobfield_set_deadline(struct blobfield *b, double seconds);

/*
 * Gives up the call in progress, or else the next one, with
 * BLOBFIELD_CANCELLED.
 */
void blobfield_cancel(struct blobfield *b);

/* ---- bytes ---- */

/* malloc'd; data has a NUL behind size bytes. Start with {0}. */
struct blobfield_bytes {
	unsigned char *data;
	size_t size;
};

/* Frees data; bytes are as at the start. */
void blobfield_bytes_fini(struct blobfield_bytes *bytes);

/*
 * Any request: for what there is no function for. path begins with "/"; type
 * (of body) and accept may be NULL, body too. Answers of status 400 and above
 * are BLOBFIELD_REFUSED. The caller frees out.
 */
enum blobfield_outcome blobfield_request(struct blobfield *b,
    const char *method, const char *path, const char *type, const void *body,
    size_t size, const char *accept, struct blobfield_bytes *out);

/* ---- scenes ---- */

/*
 * Keeps a document, size bytes of JSON, under id, new or instead of the one
 * there. tag, if not NULL, gets its revision. BLOBFIELD_REFUSED with places
 * that point into the document if something is wrong with it.
 */
enum blobfield_outcome blobfield_put(struct blobfield *b, const char *id,
    const char *document, size_t size, char tag[BLOBFIELD_TAG_MAX]);

/* The same under a new id, which the daemon chooses. */
enum blobfield_outcome blobfield_post(struct blobfield *b,
    const char *document, size_t size, char id[BLOBFIELD_ID_MAX]);

/* The document's bytes, as they were put. The caller frees out. */
enum blobfield_outcome blobfield_get(struct blobfield *b, const char *id,
    struct blobfield_bytes *out);

/*
 * Changes a part of a kept document: patch, size bytes of JSON, is a JSON Patch
 * (RFC 6902) if it is an array, a merge patch (RFC 7396) if it is not. What
 * others change meanwhile stays, unless if_match, a revision, is not NULL:
 * then status 412 (type "precondition-failed") if the scene has another. tag,
 * if not NULL, gets the new revision.
 *
 * BLOBFIELD_REFUSED with status 409 ("conflict"): a "test" of it failed; 422
 * ("invalid"): places point into the patch, or, if the error's detail begins
 * with "The document after the patch", into that. Nothing has changed then.
 */
enum blobfield_outcome blobfield_patch(struct blobfield *b, const char *id,
    const char *patch, size_t size, const char *if_match,
    char tag[BLOBFIELD_TAG_MAX]);

/* Forgets a scene. */
enum blobfield_outcome blobfield_delete(struct blobfield *b, const char *id);

/* ---- changes ---- */

#define BLOBFIELD_SEQUENCE_MAX 48
#define BLOBFIELD_TIME_MAX 32

/* A change of a scene. */
struct blobfield_event {
	bool is_deletion; /* the scene is gone; then revision is "", nodes and
	                   * bytes 0 */
	bool has_missed;  /* others were before it that are not told */
	char sequence[BLOBFIELD_SEQUENCE_MAX]; /* for blobfield_events */
	char revision[BLOBFIELD_TAG_MAX];
	char time[BLOBFIELD_TIME_MAX]; /* 2026-11-22T13:35:32.123Z */
	size_t nodes, bytes;           /* of the document */
};

/*
 * Calls event with a scene's present revision, then with every change as it is
 * made. last, if not NULL, is the sequence of one: those after it come instead,
 * as far as they are kept; if not all of them are, the present one, which has
 * has_missed. event must call nothing with b but blobfield_cancel; progress is
 * called in between as in any other call.
 *
 * If the connection breaks, or the daemon is started again, it goes on where it
 * was, however long that takes. Returns BLOBFIELD_OK when the scene has been
 * deleted (while there was no connection: without an event), or event has
 * returned other than 0; BLOBFIELD_CANCELLED; BLOBFIELD_UNREACHABLE only if
 * there was no connection at first; BLOBFIELD_REFUSED, with status 404 if there
 * is no scene.
 */
enum blobfield_outcome blobfield_events(struct blobfield *b, const char *id,
    const char *last,
    int (*event)(void *ctx, const struct blobfield_event *event), void *ctx);

/* ---- values ---- */

/* What is asked for of each point, in the order of a row. */
enum blobfield_output {
	BLOBFIELD_VALUE = 1,     /* f: 1 float */
	BLOBFIELD_GRADIENT = 2,  /* x y z */
	BLOBFIELD_HESSIAN = 4,   /* xx yy zz xy xz yz */
	BLOBFIELD_COLOR = 8,     /* red green blue, linear, 0 to 1 */
	BLOBFIELD_NORMAL = 16,   /* x y z, unit, outward; 0 0 0 if there is none */
	BLOBFIELD_CURVATURE = 32 /* mean, Gaussian */
};

/* Floats in a row of outputs, a sum of the above. */
size_t blobfield_columns(unsigned outputs);

/*
 * Evaluates a scene at count points, x y z each. rows: count *
 * blobfield_columns(outputs) floats. Both travel as they are, in float32.
 */
enum blobfield_outcome blobfield_evaluate(struct blobfield *b, const char *id,
    const float *points, size_t count, unsigned outputs, float *rows);

/* A regular grid of points. */
struct blobfield_grid {
	double min[3], max[3]; /* the first and the last, within +-1e9; max
	                        * nowhere less than min */
	int counts[3];         /* along x, y, z, 1 to 4096 each; where there is
	                        * 1, it is at min */
};

/*
 * Evaluates a scene on a grid, whose points need not be sent: as
 * blobfield_evaluate would there, bit for bit. rows: counts[0] * counts[1] *
 * counts[2] * blobfield_columns(outputs) floats, z fastest: point [i, j, k] is
 * row (i * counts[1] + j) * counts[2] + k. BLOBFIELD_REFUSED with places in
 * "/min", "/max", "/counts": more points than the daemon allows, for one
 * (8,000,000 unless it was told otherwise).
 */
enum blobfield_outcome blobfield_grid(struct blobfield *b, const char *id,
    const struct blobfield_grid *grid, unsigned outputs, float *rows);

/* ---- the surface ---- */

/* Where a ray meets the surface; all 0, and leaf -1, if it does not. */
struct blobfield_hit {
	float hit;         /* 1 or 0 */
	float distance;    /* from the origin */
	float position[3];
	float value;
	float gradient[3];
	float color[3];
	float leaf;        /* which primitive, in the document's order */
};

struct blobfield_ray_options {
	double iso;          /* 0: 1/2 */
	double max_distance; /* 0: none */
	double tolerance;    /* 0: 1e-5 of the surface's size */
};

/*
 * Casts count rays, origin and direction each (6 floats; directions of any
 * length but 0). options may be NULL.
 */
enum blobfield_outcome blobfield_raycast(struct blobfield *b, const char *id,
    const float *rays, size_t count,
    const struct blobfield_ray_options *options, struct blobfield_hit *hits);

/* Where a point comes to on the surface. */
struct blobfield_foot {
	float converged;   /* 1 or 0 */
	float position[3];
	float distance;    /* from the point, positive outside */
	float value;
	float normal[3];
};

/*
 * Moves count points, x y z each, onto the surface along the gradient. Of
 * options, which may be NULL, tolerance is not used.
 */
enum blobfield_outcome blobfield_project(struct blobfield *b, const char *id,
    const float *points, size_t count,
    const struct blobfield_ray_options *options, struct blobfield_foot *feet);

/* A box; what is not bounded is infinite. */
struct blobfield_box {
	double min[3], max[3];
};

struct blobfield_bounds {
	bool is_empty;              /* then field is all 0 */
	struct blobfield_box field; /* the field is 0 outside of it */
	bool has_surface;           /* else surface is all 0: none, or unbounded */
	struct blobfield_box surface; /* f = 1/2 lies within */
};

enum blobfield_outcome blobfield_bounds(struct blobfield *b, const char *id,
    struct blobfield_bounds *out);

/* ---- meshes and pictures ---- */

/* {0} is all defaults. */
struct blobfield_mesh_options {
	const char *format;     /* "glb", "ply", "stl", "obj", "json": what is
	                         * known of the mesh, without it; NULL: "glb",
	                         * or by the file's extension */
	int resolution;         /* cells along the longest side; 0: 64 */
	double edge_length;     /* instead of resolution; 0: none */
	double iso;             /* 0: 1/2 */
	const struct blobfield_box *box; /* NULL: all of the surface */
	bool no_features;       /* round sharp edges off */
	bool no_normals, no_colors;
};

/* The surface as triangles, to memory. The caller frees out. The header
 * Blobfield-Mesh tells their number and more. options may be NULL. */
enum blobfield_outcome blobfield_mesh(struct blobfield *b, const char *id,
    const struct blobfield_mesh_options *options, struct blobfield_bytes *out);

/* The same to a file, which is replaced only once all is there. */
enum blobfield_outcome blobfield_mesh_file(struct blobfield *b, const char *id,
    const struct blobfield_mesh_options *options, const char *path);

/* {0} is all defaults. */
struct blobfield_render_options {
	int width, height;        /* 0: 640, 480 */
	const char *shading;      /* "lit" (NULL), "normal", "zebra",
	                           * "curvature", "field" */
	int samples;              /* rays a pixel: 1, 4 (0), 9, 16 */
	double iso;               /* 0: 1/2 */
	const double *background; /* red green blue, linear; NULL: transparent */
	const double *eye;        /* 3; both of these, or NULL, and then none of */
	const double *target;     /* those below: the surface is framed */
	const double *up;         /* 3; NULL: Z */
	double fov;               /* of the height, radians; 0: 0.6 */
	double view_height;       /* above 0: orthographic, so much in view */
};

/* A picture, PNG. The caller frees out. */
enum blobfield_outcome blobfield_render(struct blobfield *b, const char *id,
    const struct blobfield_render_options *options,
    struct blobfield_bytes *out);

/* {0} is all defaults. */
struct blobfield_slice_options {
	int width, height;    /* pixels; 0: 512, 512 */
	const double *center; /* 3; NULL: the middle of the surface */
	const double *normal; /* 3; NULL: 0 -1 0 */
	const double *up;     /* 3; NULL: Z */
	double extent;        /* the width in world units; 0: all of it */
	double step;          /* between iso-lines; 0: as the daemon has it */
	double iso;           /* the thick one; 0: 1/2 */
};

/* The field in a plane, as a picture, PNG, or with npy as float32 values of
 * shape (height, width) in an npy file. The caller frees out. */
enum blobfield_outcome blobfield_slice(struct blobfield *b, const char *id,
    const struct blobfield_slice_options *options, bool npy,
    struct blobfield_bytes *out);

#ifdef __cplusplus
}
#endif

#endif
