#include "core/mesh.h"

#include <stdlib.h>
#include <string.h>

#include "core/mesh_work.h"
#include "core/output.h"
#include "core/range.h"
#include "core/tape.h"
#include "core/tree.h"

static enum err begin(struct mesh_work *w)
{
	const struct mesh_options *o = w->options;
	enum err err = cells_grid_init(&w->grid, o->min, o->max, o->edge,
	    o->iso, o->counts_least > 0 ? o->counts_least : 1,
	    MESH_CELLS_MAX);

	if (err != ERR_OK)
		return err;
	w->points = malloc(3 * MESH_BATCH * sizeof *w->points);
	w->rows = malloc(4 * MESH_BATCH * sizeof *w->rows);
	return w->points == NULL || w->rows == NULL ? ERR_MEMORY : ERR_OK;
}

static void end(struct mesh_work *w)
{
	cells_grid_fini(&w->grid);
	free(w->index);
	free(w->blocks);
	free(w->cells);
	free(w->crossings);
	free(w->bridges);
	free(w->points);
	free(w->rows);
	free(w->positions);
	free(w->normals);
	free(w->is_sharp);
}

static enum err make_room(struct mesh_work *w)
{
	size_t n = w->vertex_count + 1;

	w->positions = malloc(3 * n * sizeof *w->positions);
	w->normals = malloc(3 * n * sizeof *w->normals);
	w->is_sharp = malloc(n);
	return w->positions == NULL || w->normals == NULL ||
	    w->is_sharp == NULL ? ERR_MEMORY : ERR_OK;
}

/* Whether no primitive has a colour: shares of the same one add up to it. */
static bool is_gray(const struct range_tape *tape)
{
	struct prune_list whole = range_whole(tape);

	for (size_t i = 0; i < whole.count; i++)
		if (whole.insns[i].op == OP_COLOR)
			return false;
	return true;
}

static enum err find_colors(struct mesh_work *w,
    const struct range_tape *tape, struct mesh *m)
{
	size_t count = w->vertex_count;
	bool gray = is_gray(tape);

	m->colors = malloc((3 * count + 1) * sizeof *m->colors);
	if (m->colors == NULL)
		return ERR_MEMORY;
	for (size_t i = 0; i < 3 * count && gray; i++)
		m->colors[i] = (float)TREE_COLOR_DEFAULT;
	if (gray)
		return ERR_OK;
	for (size_t i = 0; i < count; i += MESH_BATCH) {
		size_t n = count - i < MESH_BATCH ? count - i : MESH_BATCH;
		enum err err;

		if (!sampler_goes_on(w->sampler, "normals",
		    0.9 + 0.1 * (double)i / (double)count))
			return ERR_CANCELLED;
		w->points_sampled += n;
		err = w->sampler->sample(w->sampler, w->positions + 3 * i, n,
		    OUTPUT_COLOR, m->colors + 3 * i);
		if (err != ERR_OK)
			return err;
	}
	return ERR_OK;
}

static void take_figures(const struct mesh_work *w, struct mesh_figures *f)
{
	const size_t *n = w->grid.counts;

	f->vertices = w->vertex_count;
	memcpy(f->counts, n, sizeof f->counts);
	f->edge = w->grid.edge;
	f->cells = n[0] * n[1] * n[2];
	f->full_points = (n[0] + 1) * (n[1] + 1) * (n[2] + 1);
	f->cells_evaluated = w->cells_sampled;
	f->points = w->points_sampled;
	f->largest_error = w->largest_error;
	for (size_t i = 0; i < w->vertex_count; i++)
		f->sharp_vertices += w->is_sharp[i];
}

/* Hands what it keeps of w over to m. */
static void take_arrays(struct mesh_work *w, struct mesh *m)
{
	m->positions = w->positions;
	w->positions = NULL;
	if (w->options->normals) {
		m->normals = w->normals;
		w->normals = NULL;
	}
}

/* So that whoever takes the time knows where it went. */
static enum err end_stage(struct mesh_work *w, const char *stage, double done)
{
	return sampler_goes_on(w->sampler, stage, done) ? ERR_OK :
	    ERR_CANCELLED;
}

static enum err build(struct mesh_work *w, const struct range_tape *tape,
    struct mesh *m)
{
	enum err err = begin(w);

	if (err == ERR_OK)
		err = mesh_find_cells(w, tape);
	if (err == ERR_OK)
		err = end_stage(w, "cells", 0.4);
	if (err == ERR_OK)
		err = mesh_find_crossings(w);
	if (err == ERR_OK)
		err = end_stage(w, "edges", 0.6);
	if (err == ERR_OK)
		err = mesh_find_bridges(w);
	if (err == ERR_OK)
		err = make_room(w);
	if (err == ERR_OK)
		err = mesh_place_vertices(w);
	if (err == ERR_OK)
		err = mesh_make_triangles(w, m);
	if (err == ERR_OK)
		err = end_stage(w, "vertices", 0.9);
	if (err == ERR_OK && w->options->colors)
		err = find_colors(w, tape, m);
	if (err != ERR_OK)
		return err;
	take_figures(w, &m->figures);
	take_arrays(w, m);
	err = mesh_measure(m, w->sampler);
	return err == ERR_OK ? end_stage(w, "normals", 1.0) : err;
}

enum err mesh_build(const struct range_tape *tape,
    const struct mesh_options *options, struct sampler *sampler,
    struct mesh **out)
{
	struct mesh_work *w = calloc(1, sizeof *w);
	struct mesh *m = calloc(1, sizeof *m);
	enum err err = ERR_MEMORY;

	if (w != NULL && m != NULL) {
		w->options = options;
		w->sampler = sampler;
		err = build(w, tape, m);
		end(w);
	}
	free(w);
	if (err == ERR_OK)
		*out = m;
	else
		mesh_free(m);
	return err;
}

void mesh_free(struct mesh *m)
{
	if (m == NULL)
		return;
	free(m->positions);
	free(m->normals);
	free(m->colors);
	free(m->triangles);
	free(m);
}
