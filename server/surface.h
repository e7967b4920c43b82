/*
 * What is known of a program's surface: its tape's ranges, and where it is.
 * Found when it is first asked for and kept, since editors ask again and again:
 * on 1,000 primitives it takes tens of milliseconds, on convolutions more. Safe
 * from any thread, none of which waits for another.
 */
#ifndef SERVER_SURFACE_H
#define SERVER_SURFACE_H

#include <stdbool.h>

#include "core/err.h"

struct range_tape;
struct sampler;
struct surface;
struct tape;
struct tape_box;

/* Of tape, which outlives it. ERR_MEMORY. */
enum err surface_create(const struct tape *tape, struct surface **out);

/* NULL does nothing. */
void surface_free(struct surface *s);

/* The tape's ranges, which live as long as s. ERR_MEMORY. */
enum err surface_ranges(struct surface *s, const struct range_tape **out);

/*
 * A box about the level set f = iso, a few percent wider than it is; empty
 * where there is none; infinite coordinates where it is not shown to end. The
 * last one is kept. sampler is asked, as stage "extent", whether to go on.
 * ERR_MEMORY, ERR_CANCELLED.
 */
enum err surface_extent(struct surface *s, double iso, struct sampler *sampler,
    struct tape_box *out);

/* Whether that box is known already; then in *out. */
bool surface_knows(struct surface *s, double iso, struct tape_box *out);

#endif
