#include "core/cells.h"

#include <math.h>
#include <stdlib.h>

#include "core/prune.h"
#include "core/range.h"
#include "core/sampler.h"
#include "core/tape.h"

/* Levels of blocks: one block to 2^8 and more along an axis. */
#define LEVELS_MAX 16

/* Lists shorter than this are not worth pruning again. */
#define PRUNE_LEAST 4

/* Ranges between two looks whether to go on. */
#define RANGES_A_LOOK 256

enum err cells_list_add(struct cells_list *list, struct cells_block block)
{
	if (list->count == list->max) {
		size_t max = list->max ? 2 * list->max : 1024;
		struct cells_block *grown = realloc(list->blocks,
		    max * sizeof *grown);

		if (grown == NULL)
			return ERR_MEMORY;
		list->blocks = grown;
		list->max = max;
	}
	list->blocks[list->count++] = block;
	return ERR_OK;
}

void cells_list_fini(struct cells_list *list)
{
	free(list->blocks);
	*list = (struct cells_list){0};
}

/* ---- the grid ---- */

/* Cells of edge that cover length: a last one that would hold a rounding error
 * only is none. */
static double cells_along(double length, double edge)
{
	return fmax(1.0, ceil(length / edge - 1e-6));
}

static enum err place_corners(struct cells_grid *grid, int a, double least,
    double most)
{
	size_t n = grid->counts[a];
	float *at = malloc((n + 3) * sizeof *at);

	if (at == NULL)
		return ERR_MEMORY;
	for (size_t i = 0; i <= n; i++)
		at[i + 1] = (float)(least +
		    (most - least) * ((double)i / (double)n));
	at[0] = at[1];
	at[n + 2] = at[n + 1];
	grid->at[a] = at;
	return ERR_OK;
}

/* The cells along axis a, whose side of the box has this length and reaches to
 * coordinates of reach. ERR_LIMIT, ERR_INVALID. */
static enum err count_cells(struct cells_grid *grid, int a, double length,
    double reach, size_t counts_least, size_t counts_max)
{
	double n = cells_along(length, grid->edge);
	double room = floor(length / (CELLS_LEAST_EDGE * reach));

	n = fmax(n, fmin((double)counts_least, room));
	if (!(n <= (double)counts_max))
		return ERR_LIMIT;
	if (!(n <= room))
		return ERR_INVALID;
	grid->counts[a] = (size_t)n;
	grid->blocks[a] = (grid->counts[a] + 2 + CELLS_SIDE - 1) / CELLS_SIDE;
	grid->steps[a] = length / n;
	grid->grains[a] = CELLS_STEP * reach / grid->steps[a];
	grid->least = fmin(grid->least, grid->steps[a]);
	return ERR_OK;
}

enum err cells_grid_init(struct cells_grid *grid, struct vec3 min,
    struct vec3 max, double edge, double iso, size_t counts_least,
    size_t counts_max)
{
	const double least[3] = {min.x, min.y, min.z};
	const double most[3] = {max.x, max.y, max.z};
	enum err err = ERR_OK;

	*grid = (struct cells_grid){.edge = edge, .iso = iso,
	    .least = INFINITY};
	for (int a = 0; a < 3 && err == ERR_OK; a++)
		err = count_cells(grid, a, most[a] - least[a],
		    fmax(fabs(least[a]), fabs(most[a])), counts_least,
		    counts_max);
	for (int a = 0; a < 3 && err == ERR_OK; a++)
		err = place_corners(grid, a, least[a], most[a]);
	if (err != ERR_OK)
		cells_grid_fini(grid);
	return err;
}

void cells_grid_fini(struct cells_grid *grid)
{
	for (int a = 0; a < 3; a++) {
		free(grid->at[a]);
		grid->at[a] = NULL;
	}
}

/* ---- blocks ---- */

struct search {
	const struct range_tape *tape;
	const struct cells_grid *grid;
	struct sampler *sampler;
	struct prune_list lists[LEVELS_MAX + 1]; /* lists[l] for level l */
	struct cells_list *out;
	size_t ranges; /* taken so far */
	double whole;  /* blocks under the root */
	double done;   /* of them */
};

/* The box of the cells, side along each axis from begin on. False: there are
 * none. *is_rim: whether some are the ring's. */
static bool box_of_cells(const struct cells_grid *grid,
    const size_t begin[static 3], size_t side, struct tape_box *box,
    bool *is_rim)
{
	*is_rim = false;
	for (int a = 0; a < 3; a++) {
		size_t n = grid->counts[a];
		size_t first = begin[a], last = first + side;

		if (first > n + 1)
			return false;
		if (last > n + 1)
			last = n + 2;
		*is_rim |= first == 0 || last == n + 2;
		box->min[a] = cells_corner(grid, a, first);
		box->max[a] = cells_corner(grid, a, last);
	}
	return true;
}

/* That of the blocks, 2^level along each axis from at on. */
static bool box_of(const struct cells_grid *grid, const size_t at[static 3],
    int level, struct tape_box *box, bool *is_rim)
{
	const size_t begin[3] = {at[0] * CELLS_SIDE, at[1] * CELLS_SIDE,
	    at[2] * CELLS_SIDE};

	return box_of_cells(grid, begin, (size_t)CELLS_SIDE << level, box,
	    is_rim);
}

/* A block in the box's midst needs both sides, one at its rim the inside. */
static bool may_hold(const struct search *s, const struct prune_list *list,
    const struct tape_box *box, bool is_rim)
{
	struct range r = range_eval(s->tape, list, box);

	return r.most >= s->grid->iso && (is_rim || r.least < s->grid->iso);
}

static enum err add_leaf(struct search *s, const size_t at[static 3])
{
	return cells_list_add(s->out, (struct cells_block){
	    {(uint16_t)at[0], (uint16_t)at[1], (uint16_t)at[2]}, 0xff});
}

static enum err descend(struct search *s, const struct prune_list *list,
    const size_t at[static 3], int level)
{
	struct prune_list *own = s->lists + level;
	struct tape_box box;
	enum err err = ERR_OK;
	bool is_rim, may;

	if (s->ranges++ % RANGES_A_LOOK == 0 &&
	    !sampler_goes_on(s->sampler, "cells", 0.1 * s->done / s->whole))
		return ERR_CANCELLED;
	may = box_of(s->grid, at, level, &box, &is_rim) &&
	    may_hold(s, list, &box, is_rim);
	if (!may || level == 0)
		s->done += ldexp(1.0, 3 * level);
	if (!may)
		return ERR_OK;
	if (level == 0)
		return add_leaf(s, at);
	if (list->count >= PRUNE_LEAST) {
		range_prune(s->tape, list, &box, own);
		list = own;
	}
	for (size_t i = 0; i < 8 && err == ERR_OK; i++) {
		size_t half = (size_t)1 << (level - 1);
		size_t child[3] = {at[0] + (i & 1 ? half : 0),
		    at[1] + (i & 2 ? half : 0), at[2] + (i & 4 ? half : 0)};

		err = descend(s, list, child, level - 1);
	}
	return err;
}

static int levels_of(const struct cells_grid *grid)
{
	int level = 0;

	for (int a = 0; a < 3; a++)
		while ((size_t)1 << level < grid->blocks[a])
			level++;
	return level;
}

static enum err search_init(struct search *s, int levels)
{
	struct prune_list whole = range_whole(s->tape);
	enum err err = ERR_OK;

	for (int l = 0; l <= levels && err == ERR_OK; l++)
		err = range_list_create(&whole, s->lists + l);
	return err;
}

static void search_fini(struct search *s, int levels)
{
	for (int l = 0; l <= levels; l++)
		range_list_free(s->lists + l);
}

enum err cells_find(const struct range_tape *tape,
    const struct cells_grid *grid, struct sampler *sampler,
    struct cells_list *out)
{
	struct prune_list whole = range_whole(tape);
	struct cells_list list = {0};
	struct search s = {tape, grid, sampler, {{0}}, &list, 0, 0.0, 0.0};
	const size_t origin[3] = {0, 0, 0};
	int levels = levels_of(grid);
	enum err err = search_init(&s, levels);

	s.whole = ldexp(1.0, 3 * levels);
	if (err == ERR_OK)
		err = descend(&s, &whole, origin, levels);
	search_fini(&s, levels);
	if (err == ERR_OK)
		*out = list;
	else
		cells_list_fini(&list);
	return err;
}

/* ---- parts ---- */

/* The way down to a block: the lists of those that it is in. */
struct path {
	struct prune_list at[LEVELS_MAX + 2]; /* [levels + 1]: all */
	struct cells_block block;             /* where it leads */
	bool is_set;
};

/* Leads path to block. */
static void lead(struct search *s, struct path *path, int levels,
    const struct cells_block *block)
{
	bool is_new = !path->is_set;

	for (int l = levels; l >= 0; l--) {
		size_t at[3];
		struct tape_box box;
		bool is_rim;

		for (int a = 0; a < 3; a++) {
			at[a] = (size_t)(block->at[a] >> l) << l;
			is_new |= block->at[a] >> l != path->block.at[a] >> l;
		}
		if (!is_new)
			continue;
		path->at[l] = path->at[l + 1];
		if (path->at[l].count >= PRUNE_LEAST &&
		    box_of(s->grid, at, l, &box, &is_rim)) {
			range_prune(s->tape, path->at + l + 1, &box,
			    s->lists + l);
			path->at[l] = s->lists[l];
		}
	}
	path->block = *block;
	path->is_set = true;
}

/* Those of doubts that hold none. */
static unsigned empty_parts(const struct search *s,
    const struct prune_list *list, const struct cells_block *block,
    unsigned doubts)
{
	unsigned empty = 0;

	for (unsigned i = 0; i < 8; i++) {
		struct tape_box box;
		size_t begin[3];
		bool is_rim;

		if (!(doubts >> i & 1))
			continue;
		for (int a = 0; a < 3; a++)
			begin[a] = block->at[a] * (size_t)CELLS_SIDE +
			    (i >> a & 1) * (CELLS_SIDE / 2);
		if (!box_of_cells(s->grid, begin, CELLS_SIDE / 2, &box,
		    &is_rim) || !may_hold(s, list, &box, is_rim))
			empty |= 1u << i;
	}
	return empty;
}

enum err cells_thin_out(const struct range_tape *tape,
    const struct cells_grid *grid, struct sampler *sampler,
    const uint8_t *doubts, struct cells_list *list)
{
	struct search s = {.tape = tape, .grid = grid, .sampler = sampler};
	struct path path = {.is_set = false};
	int levels = levels_of(grid);
	enum err err = search_init(&s, levels);

	path.at[levels + 1] = range_whole(tape);
	for (size_t i = 0; i < list->count && err == ERR_OK; i++) {
		struct cells_block *b = list->blocks + i;

		if (i % (RANGES_A_LOOK / 8) == 0 && !sampler_goes_on(sampler,
		    "cells", 0.15 + 0.05 * (double)i / (double)list->count))
			err = ERR_CANCELLED;
		if (doubts[i] == 0 || err != ERR_OK)
			continue;
		lead(&s, &path, levels, b);
		b->parts &= (uint8_t)~empty_parts(&s, path.at, b, doubts[i]);
	}
	search_fini(&s, levels);
	return err;
}
