#include "core/raycast_field.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/range.h"
#include "core/range_parts.h"
#include "core/raycast.h"
#include "core/tape.h"

/*
 * A box is split while its list is longer than SHORT, and DEEP times at most.
 * Endless surfaces' first box is a cube as large as can be; it is split so often
 * that boxes get as small as those of DEEP_INFINITE times in what is looked at
 * from near.
 */
#define DEEP 7
#define DEEP_INFINITE 18
#define SHALLOW 4
#define SHORT 12

/* The largest coordinate that is looked at. */
#define REACH_MAX (0.5 * (double)POINT_REACH)

/* Bytes of boxes and lists; when they are used up boxes stay as they are. */
#define BYTES_MAX ((size_t)128 << 20)

/* Boxes are made so many at a time, and stay in their places. */
#define CHUNK 4096
#define CHUNKS_MAX ((int)(BYTES_MAX / (CHUNK * sizeof(struct cell))))

static struct cell *cell_at(const struct field *f, int at)
{
	return f->chunks[at / CHUNK] + at % CHUNK;
}

/* Room for eight more, which are of one chunk; *has_room: whether there is. */
static enum err reserve(struct field *f, bool *has_room)
{
	const int chunk = f->count / CHUNK;

	*has_room = false;
	if (chunk >= CHUNKS_MAX)
		return ERR_OK;
	if (f->chunks[chunk] == NULL) {
		if (f->bytes + CHUNK * sizeof(struct cell) > BYTES_MAX)
			return ERR_OK;
		f->chunks[chunk] = malloc(CHUNK * sizeof(struct cell));
		if (f->chunks[chunk] == NULL)
			return ERR_MEMORY;
		f->bytes += CHUNK * sizeof(struct cell);
	}
	*has_room = true;
	return ERR_OK;
}

/* Keeps f->part as the cell's own list, if it is enough shorter. */
static enum err keep_list(struct field *f, struct cell *c)
{
	const size_t size = sizeof *c->list.insns + sizeof *c->list.boxes;
	const size_t bytes = (f->part.count + PRUNE_ROOM) * size;
	struct prune_list own;
	enum err err;

	if (f->part.count * 4 > c->list.count * 3 ||
	    f->bytes + bytes > BYTES_MAX)
		return ERR_OK;
	err = range_list_create(&f->part, &own);
	if (err)
		return err;
	memcpy(own.insns, f->part.insns, f->part.count * sizeof *own.insns);
	memcpy(own.boxes, f->part.boxes, f->part.count * sizeof *own.boxes);
	own.count = f->part.count;
	f->bytes += bytes;
	c->list = own;
	c->own_list = true;
	return ERR_OK;
}

static enum err split(struct field *f, struct cell *c)
{
	bool has_room;
	enum err err = reserve(f, &has_room);

	if (err || !has_room)
		return err;
	for (int i = 0; i < 8; i++) {
		struct cell *child = cell_at(f, f->count + i);

		*child = (struct cell){.list = c->list,
		    .depth = (unsigned char)(c->depth + 1)};
		for (int k = 0; k < 3; k++) {
			double middle = 0.5 * (c->min[k] + c->max[k]);

			child->min[k] = i >> k & 1 ? middle : c->min[k];
			child->max[k] = i >> k & 1 ? c->max[k] : middle;
		}
	}
	c->children = f->count;
	c->state = CELL_SPLIT;
	f->count += 8;
	return ERR_OK;
}

/* float32 that is not above x, or not below. */
static float below(double x)
{
	float y = (float)x;

	return y > x ? nextafterf(y, -INFINITY) : y;
}

static float above(double x)
{
	float y = (float)x;

	return y < x ? nextafterf(y, INFINITY) : y;
}

/* The length over which the least primitive of list falls, in world units. */
static double least_size(const struct field *f, const struct prune_list *list)
{
	double least = INFINITY, stretch = 1.0;

	for (size_t i = 0; i < list->count; i++) {
		const struct insn *insn = list->insns + i;

		if (insn->op == OP_FRAME || insn->op == OP_ENTER)
			stretch = range_stretching(f->tape, insn);
		else if (insn->op >= OP_PRIMITIVES && insn->op < OP_MAX)
			least = fmin(least, range_size(f->tape, insn) /
			    stretch);
	}
	return least;
}

/* Finds out what a new cell is. */
static enum err open_cell(struct field *f, struct cell *c)
{
	struct tape_box box;
	struct range range;
	enum err err;

	for (int i = 0; i < 3; i++) {
		box.min[i] = below(c->min[i]);
		box.max[i] = above(c->max[i]);
	}
	range_prune(f->tape, &c->list, &box, &f->part);
	range = range_eval(f->tape, &f->part, &box);
	if (range.most < f->iso || range.least > f->iso) {
		c->state = CELL_EMPTY;
		return ERR_OK;
	}
	c->state = CELL_LEAF;
	c->least = least_size(f, &f->part);
	err = keep_list(f, c);
	if (err || c->depth >= f->deep ||
	    (c->depth >= SHALLOW && c->list.count <= SHORT))
		return err;
	return split(f, c);
}

enum err field_find(struct field *f, const double p[static 3],
    const double direction[static 3], const struct cell **out)
{
	struct cell *c = cell_at(f, 0);

	for (;;) {
		int child = 0;

		if (c->state == CELL_NEW) {
			enum err err = open_cell(f, c);

			if (err)
				return err;
		}
		if (c->state != CELL_SPLIT) {
			*out = c;
			return ERR_OK;
		}
		for (int k = 0; k < 3; k++) {
			double middle = 0.5 * (c->min[k] + c->max[k]);

			child |= (p[k] > middle || (p[k] == middle &&
			    direction[k] > 0.0)) << k;
		}
		c = cell_at(f, c->children + child);
	}
}

void field_fini(struct field *f)
{
	for (int i = 0; i < f->count; i++)
		if (cell_at(f, i)->own_list)
			range_list_free(&cell_at(f, i)->list);
	for (int i = 0; f->chunks != NULL && i < CHUNKS_MAX; i++)
		free(f->chunks[i]);
	free(f->chunks);
	range_list_free(&f->part);
}

double field_reach(const struct tape_box *extent, double far)
{
	double reach = fmax(far, 1.0);

	for (int i = 0; i < 3; i++) {
		if (isfinite(extent->min[i]))
			reach = fmax(reach, fabs((double)extent->min[i]));
		if (isfinite(extent->max[i]))
			reach = fmax(reach, fabs((double)extent->max[i]));
	}
	return fmin(reach * RAYCAST_REACH, REACH_MAX);
}

/* The first cell, with seven beside it that nothing is in: eights begin at
 * eights. */
static void put_root(struct field *f, const struct tape_box *extent)
{
	const double reach = field_reach(extent, 0.0);
	struct cell *root = cell_at(f, 0);
	bool is_endless = false;

	for (int i = 0; i < 8; i++)
		root[i] = (struct cell){.list = f->whole};
	for (int i = 0; i < 3; i++) {
		root->min[i] = fmax(extent->min[i], -REACH_MAX);
		root->max[i] = fmin(extent->max[i], REACH_MAX);
		is_endless |= !isfinite(extent->min[i]) ||
		    !isfinite(extent->max[i]);
	}
	f->count = 8;
	f->deep = DEEP;
	if (!is_endless)
		return;
	for (int i = 0; i < 3; i++) {
		root->min[i] = -REACH_MAX;
		root->max[i] = REACH_MAX;
	}
	f->deep = DEEP_INFINITE + (int)ceil(log2(REACH_MAX / reach));
}

enum err field_init(struct field *f, const struct range_tape *tape, double iso,
    const struct tape_box *extent)
{
	bool has_room;
	enum err err;

	*f = (struct field){.tape = tape, .iso = iso,
	    .whole = range_whole(tape)};
	err = range_list_create(&f->whole, &f->part);
	if (err)
		return err;
	f->chunks = calloc((size_t)CHUNKS_MAX, sizeof *f->chunks);
	err = f->chunks != NULL ? reserve(f, &has_room) : ERR_MEMORY;
	if (err) {
		field_fini(f);
		return err;
	}
	put_root(f, extent);
	return ERR_OK;
}
