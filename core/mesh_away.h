/*
 * Sharp vertices that have left their cell for the one beside it that an edge or
 * corner lies in: those that come too near another vertex there go back, so that
 * no two vertices are at the same place.
 */
#ifndef CORE_MESH_AWAY_H
#define CORE_MESH_AWAY_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct mesh_work;

struct mesh_away {
	uint32_t vertex;
	uint16_t cell[3]; /* where it is */
	uint16_t own[3];  /* where it belongs */
	float home[3];    /* where it goes back to */
};

/* A list of them; all 0 is an empty one. */
struct mesh_aways {
	struct mesh_away *list;
	size_t count, max;
};

/* ERR_MEMORY. */
enum err mesh_aways_add(struct mesh_aways *aways,
    const struct mesh_away *away);
void mesh_aways_fini(struct mesh_aways *aways);

/* Takes those that are too near other vertices from aways to gone; their
 * positions become their homes. All vertices of cells are placed. ERR_MEMORY. */
enum err mesh_aways_settle(struct mesh_aways *aways,
    const struct mesh_work *w, struct mesh_aways *gone);

#endif
