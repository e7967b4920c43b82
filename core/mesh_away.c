#include "core/mesh_away.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/mesh_work.h"

/* Vertices nearer than this along all axes are too near, of a cell. */
#define TOO_NEAR 0.02

enum err mesh_aways_add(struct mesh_aways *aways,
    const struct mesh_away *away)
{
	struct mesh_away *list = mesh_room(aways->list, &aways->max,
	    aways->count + 1, sizeof *list);

	if (list == NULL)
		return ERR_MEMORY;
	aways->list = list;
	aways->list[aways->count++] = *away;
	return ERR_OK;
}

void mesh_aways_fini(struct mesh_aways *aways)
{
	free(aways->list);
	*aways = (struct mesh_aways){0};
}

static int compare(const void *a, const void *b)
{
	const struct mesh_away *x = a, *y = b;

	for (int k = 0; k < 3; k++)
		if (x->cell[k] != y->cell[k])
			return x->cell[k] < y->cell[k] ? -1 : 1;
	return x->vertex < y->vertex ? -1 : x->vertex > y->vertex;
}

static bool is_near(const struct mesh_work *w, uint32_t a, uint32_t b)
{
	const float *p = w->positions + 3 * (size_t)a;
	const float *q = w->positions + 3 * (size_t)b;

	for (int k = 0; k < 3; k++)
		if (fabs((double)p[k] - q[k]) > TOO_NEAR * w->grid.steps[k])
			return false;
	return true;
}

/* Whether number i is in a crowd; of those before it stay left, in order. */
static bool is_crowded(const struct mesh_work *w,
    const struct mesh_aways *aways, size_t left, size_t i)
{
	const struct mesh_away *away = aways->list + i;
	const size_t at[3] = {away->cell[0], away->cell[1], away->cell[2]};
	const struct mesh_cell *cell = mesh_cell_at(w, at);

	for (uint32_t k = 0; cell != NULL && k < cell->loops; k++)
		if (is_near(w, away->vertex, cell->vertex + k))
			return true;
	while (left > 0 && memcmp(aways->list[left - 1].cell, away->cell,
	    sizeof away->cell) == 0)
		if (is_near(w, away->vertex, aways->list[--left].vertex))
			return true;
	return false;
}

enum err mesh_aways_settle(struct mesh_aways *aways,
    const struct mesh_work *w, struct mesh_aways *gone)
{
	size_t left = 0;
	enum err err = ERR_OK;

	if (aways->count > 0)
		qsort(aways->list, aways->count, sizeof *aways->list, compare);
	for (size_t i = 0; i < aways->count && err == ERR_OK; i++) {
		struct mesh_away away = aways->list[i];

		if (!is_crowded(w, aways, left, i)) {
			aways->list[left++] = away;
			continue;
		}
		memcpy(w->positions + 3 * (size_t)away.vertex, away.home,
		    sizeof away.home);
		err = mesh_aways_add(gone, &away);
	}
	aways->count = left;
	return err;
}
