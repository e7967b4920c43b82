/*
 * Where vertices are: one for every curve in which the surface meets a cell's
 * faces. First at the point whose squared distances from the tangent planes at
 * the curve's crossings are least (quadric error; Ju, Losasso, Schaefer, Warren
 * 2002), in those directions only that the planes determine, from the crossings'
 * middle on; then along the gradient onto the surface, within the cell.
 */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/mesh_away.h"
#include "core/mesh_planes.h"
#include "core/mesh_work.h"
#include "core/output.h"

/* A vertex is on the surface when it is this close, of a cell's least side, and
 * so near iso. */
#define NEAR_ENOUGH 2e-4
#define NEAR_VALUE 1e-4

/* Farther off than this at its walk's end it is brought there by bisection. */
#define OFF 5e-4
#define OFF_VALUE 4e-4

#define STEPS_MAX 8
#define HALVINGS_MAX 60

/* The first of these are false positions. */
#define FALSE_MAX 8

/*
 * Where the planes' point lies outside of the cell, an edge or corner of the
 * surface pokes out of it: so far beyond its own cell a sharp vertex may go, of
 * an edge, and so near the surface it must then be.
 */
#define AWAY_MOST 0.5
#define AWAY_NEAR 0.05

/*
 * A vertex is on an edge or corner if the surface is so near to the planes' point
 * as a part of the step that led there from the crossings' middle: 0 at an edge,
 * 1/2 on a sphere, whose tangent planes meet above it; and of an edge at least.
 */
#define SHARP_NEAR 0.2
#define SHARP_LEAST 1e-3

/*
 * And if the field's normals so far from it on either side, of a cell, differ by
 * so much of the angle between the two crossings whose normals differ most: at an
 * edge by all of it, where the surface but bends in proportion to the distance.
 */
#define SIDE 0.05
#define SIDE_TURN 0.6

/* A corner that shows in a cell and those beside it only together must lie so
 * near all of their planes, of a cell. */
#define CORNER_NEAR 0.02

enum phase {
	WALKING,   /* along the gradient */
	LOOKING,   /* at the gradient on one side of it */
	LOOKING_2, /* and on the other */
	HALVING    /* between its place and a corner on the other side */
};

/* A vertex that is on its way. */
struct walk {
	uint32_t vertex;
	uint8_t phase, steps;
	bool is_sharp;
	bool is_away;          /* sent to a sharp place, on trial */
	uint16_t own[3], at[3]; /* its cell, the one it is in */
	float home[3];         /* where it goes back to if it is away in vain */
	struct mesh_limits limits; /* of the cell it is in */
	float p[3];            /* that is sampled */
	float best[3], gradient[3]; /* where the error was least */
	double error;          /* there; DBL_MAX: not yet sampled */
	double value;
	float normal[3];       /* mean of the crossings' */
	float middle[3];       /* of the crossings */
	bool is_rim;           /* sharp whatever the field is: beside caps */
	float across[3];       /* from one of its sides to the other, unit */
	float turn, beside[3]; /* their normals' angle; the gradient on one */
	float from[3], to[3];  /* HALVING: the line */
	double t[2], f[2];     /* parts of it, values less iso */
};

struct walks {
	struct mesh_work *w;
	struct walk *walks;
	size_t count, done;
	struct mesh_aways aways;
};

/* ---- limits ---- */

/* The axis along which x is farthest outside, or -1. */
static int outermost(const struct walk *walk, const bool is_free[static 3],
    const double x[static 3])
{
	double most = 0.0;
	int axis = -1;

	for (int k = 0; k < 3; k++) {
		double off = fmax((double)walk->limits.low[k] - x[k],
		    x[k] - (double)walk->limits.high[k]);

		if (is_free[k] && off > most) {
			most = off;
			axis = k;
		}
	}
	return axis;
}

/* The same within the cell: where the point lies outside, the least along the
 * cell's face there, and so on. The point without this to far. */
static int solve_within(const struct mesh_planes *l, const struct walk *walk,
    double x[static 3], double far[static 3])
{
	double start[3] = {x[0], x[1], x[2]};
	bool is_free[3];
	int rank, axis;

	for (int k = 0; k < 3; k++)
		is_free[k] = walk->limits.low[k] < walk->limits.high[k];
	rank = mesh_planes_solve(l, is_free, walk->normal, x);
	memcpy(far, x, sizeof start);
	while ((axis = outermost(walk, is_free, x)) >= 0) {
		is_free[axis] = false;
		start[axis] = x[axis] < walk->limits.low[axis] ?
		    walk->limits.low[axis] : walk->limits.high[axis];
		memcpy(x, start, sizeof start);
		mesh_planes_solve(l, is_free, walk->normal, x);
	}
	return rank;
}

/* ---- curves ---- */

static void put_within(const struct walk *walk, const double x[static 3],
    float p[static 3])
{
	for (int k = 0; k < 3; k++) {
		float v = (float)x[k];

		p[k] = fminf(fmaxf(v, walk->limits.low[k]), walk->limits.high[k]);
	}
}

/* The cell beside walk's own that x lies in. False: it is too far, or no cell
 * of the box. */
static bool find_away(const struct mesh_work *w, const struct walk *walk,
    const double x[static 3], size_t cell[static 3])
{
	for (int k = 0; k < 3; k++) {
		double low = cells_corner(&w->grid, k, walk->own[k]);
		double high = cells_corner(&w->grid, k, walk->own[k] + 1u);

		cell[k] = (size_t)walk->own[k] + (x[k] > high) - (x[k] < low);
		if (fmax(low - x[k], x[k] - high) > AWAY_MOST * w->grid.steps[k] ||
		    cell[k] < 1 || cell[k] > w->grid.counts[k])
			return false;
	}
	return true;
}

/* Sends a walk to x, beside its cell or within, on trial, if it may. */
static void send_away(const struct mesh_work *w, struct walk *walk,
    const double x[static 3])
{
	size_t cell[3];

	if (!find_away(w, walk, x, cell))
		return;
	walk->is_away = true;
	for (int k = 0; k < 3; k++)
		walk->at[k] = (uint16_t)cell[k];
	memcpy(walk->home, walk->p, sizeof walk->home);
	mesh_limits_set(&w->grid, cell, &walk->limits);
	put_within(walk, x, walk->p);
}

/* The angle between two directions, neither 0. */
static double angle(struct vec3 a, struct vec3 b)
{
	return atan2(vec3_norm(vec3_cross(a, b)), vec3_dot(a, b));
}

/* Takes as walk's sides the two of l's crossings whose normals differ most: along
 * their difference lies what is nearer to one than to the other. */
static void set_sides(struct walk *walk, const struct mesh_planes *l)
{
	double least = 2.0;
	int a = 0, b = 0;
	struct vec3 d;

	for (int i = 0; i < l->count; i++)
		for (int k = 0; k < i; k++) {
			double cosine = vec3_dot(vec3_get(l->n[i]),
			    vec3_get(l->n[k]));

			if (cosine < least) {
				least = cosine;
				a = i;
				b = k;
			}
		}
	d = vec3_sub(vec3_get(l->n[a]), vec3_get(l->n[b]));
	if (vec3_norm(d) > 0.0)
		d = vec3_unit(d);
	walk->across[0] = (float)d.x;
	walk->across[1] = (float)d.y;
	walk->across[2] = (float)d.z;
	walk->turn = (float)angle(vec3_get(l->n[a]), vec3_get(l->n[b]));
	mesh_planes_crease(l, walk->normal);
}

/* Adds the crossings of the cell at these coordinates, if there are any. */
static void take_cell(const struct mesh_work *w, const size_t at[static 3],
    struct mesh_planes *l)
{
	const struct mesh_cell *cell = mesh_cell_at(w, at);
	struct mesh_near near;

	if (cell == NULL)
		return;
	mesh_near_init(w, w->blocks + cell->block, 1, &near);
	for (unsigned e = 0; e < 12; e++)
		if ((cell->inside >> mesh_loops_begin(e) ^
		    cell->inside >> mesh_loops_end(e)) & 1)
			mesh_planes_add(w, &near, cell, e, l);
}

/*
 * A curve about a corner may cross two of its planes only, one about an edge one
 * of them: whether with the crossings of the cells beside walk's own there are
 * rank, that meet in x. Their mean normal is then walk's.
 */
static bool find_corner(const struct mesh_work *w, struct walk *walk,
    int rank, double x[static 3])
{
	static const bool all_free[3] = {true, true, true};
	struct mesh_planes wide;

	wide.count = wide.caps = 0;
	for (int i = 0; i < 7; i++) {
		size_t at[3] = {walk->own[0], walk->own[1], walk->own[2]};

		if (i > 0)
			at[(i - 1) / 2] += i % 2 ? 1 : SIZE_MAX;
		take_cell(w, at, &wide);
	}
	memcpy(x, (double[3]){walk->p[0], walk->p[1], walk->p[2]},
	    3 * sizeof *x);
	if (wide.caps > 0 ||
	    mesh_planes_solve(&wide, all_free, walk->normal, x) < rank ||
	    !mesh_planes_are_near(&wide, x, CORNER_NEAR * w->grid.least))
		return false;
	mesh_planes_normal(&wide, walk->normal);
	set_sides(walk, &wide);
	return true;
}

/* Whether a corner at x is walk's: in its own cell, or in one that has no vertex
 * of its own to find it. */
static bool owns_corner(const struct mesh_work *w, const struct walk *walk,
    const double x[static 3])
{
	size_t cell[3];

	return find_away(w, walk, x, cell) &&
	    (mesh_cell_at(w, cell) == NULL || (cell[0] == walk->own[0] &&
	    cell[1] == walk->own[1] && cell[2] == walk->own[2]));
}

/* Tries the sharp place of a vertex that the curve's planes determine in rank
 * directions, far being where they do. */
static void try_sharp(const struct mesh_work *w, struct walk *walk, int rank,
    const double far[static 3])
{
	struct walk other = *walk;
	double corner[3];

	if (rank < 3 && find_corner(w, &other, 3, corner) &&
	    owns_corner(w, walk, corner)) {
		*walk = other;
		far = corner;
	}
	send_away(w, walk, far);
}

static void go_home(const struct cells_grid *grid, struct walk *walk)
{
	const size_t own[3] = {walk->own[0], walk->own[1], walk->own[2]};

	mesh_limits_set(grid, own, &walk->limits);
	memcpy(walk->p, walk->home, sizeof walk->p);
	memcpy(walk->at, walk->own, sizeof walk->at);
	walk->is_away = false;
	walk->is_sharp = false;
	walk->error = DBL_MAX;
	walk->phase = WALKING;
	walk->steps = 0;
}

static enum err finish(struct walks *s, const struct walk *walk)
{
	struct mesh_work *w = s->w;
	struct vec3 g = vec3(walk->gradient[0], walk->gradient[1],
	    walk->gradient[2]);
	float *normal = w->normals + 3 * (size_t)walk->vertex;

	memcpy(w->positions + 3 * (size_t)walk->vertex, walk->best,
	    sizeof walk->best);
	memcpy(normal, walk->normal, sizeof walk->normal);
	if (!walk->is_sharp && vec3_norm(g) > 0.0) {
		g = vec3_unit(g);
		normal[0] = (float)-g.x;
		normal[1] = (float)-g.y;
		normal[2] = (float)-g.z;
	}
	w->is_sharp[walk->vertex] = walk->is_sharp;
	w->largest_error = fmax(w->largest_error, walk->error);
	s->done++;
	if (memcmp(walk->at, walk->own, sizeof walk->at) == 0)
		return ERR_OK;
	return mesh_aways_add(&s->aways, &(struct mesh_away){walk->vertex,
	    {walk->at[0], walk->at[1], walk->at[2]},
	    {walk->own[0], walk->own[1], walk->own[2]},
	    {walk->home[0], walk->home[1], walk->home[2]}});
}

/* The vertex of a curve on caps alone. */
static void finish_cap(struct walks *s, struct walk *walk)
{
	memcpy(walk->best, walk->p, sizeof walk->best);
	walk->error = 0.0;
	walk->is_sharp = true; /* its normal is the crossings' */
	finish(s, walk);
	s->w->is_sharp[walk->vertex] = 0;
}

/* Moves x, the crossings' middle, to where the vertex may be; how many directions
 * the planes determine, and where they do to far. */
static int find_place(const struct mesh_options *o,
    const struct mesh_planes *l, const struct walk *walk, double x[static 3],
    double far[static 3])
{
	double height;
	int rank = 1;

	if (l->caps == 0 && mesh_planes_are_flat(l, x, walk->normal,
	    &height)) {
		for (int k = 0; k < 3; k++)
			x[k] += height * walk->normal[k];
		return 1;
	}
	if (l->caps < l->count && (o->features || l->caps > 0)) {
		double middle[3] = {x[0], x[1], x[2]};

		rank = solve_within(l, walk, x, far);
		for (int k = 0; k < 3 && rank == 1 && l->caps == 0; k++)
			x[k] = 0.5 * (middle[k] + x[k]);
	}
	return rank;
}

/* Begins with the vertex of curve l. */
static void begin(struct walks *s, const struct mesh_cell *cell,
    uint32_t vertex, const struct mesh_planes *l)
{
	struct walk *walk = s->walks + s->count;
	size_t own[3];
	double x[3], far[3];
	int rank;

	*walk = (struct walk){.vertex = vertex, .error = DBL_MAX};
	mesh_corner_of(s->w->blocks + cell->block, cell->local, own);
	for (int k = 0; k < 3; k++)
		walk->own[k] = walk->at[k] = (uint16_t)own[k];
	mesh_limits_set(&s->w->grid, own, &walk->limits);
	mesh_planes_middle(l, x);
	mesh_planes_normal(l, walk->normal);
	for (int k = 0; k < 3; k++)
		walk->middle[k] = (float)x[k];
	rank = find_place(s->w->options, l, walk, x, far);
	put_within(walk, x, walk->p);
	if (l->caps == l->count) {
		finish_cap(s, walk);
		return;
	}
	walk->is_sharp = rank > 1 || l->caps > 0;
	walk->is_rim = l->caps > 0;
	s->count++;
	if (rank > 1 && l->caps == 0)
		set_sides(walk, l);
	else if (l->caps > 0)
		mesh_planes_crease(l, walk->normal);
	if (rank > 1 && l->caps == 0 && cell->loops == 1)
		try_sharp(s->w, walk, rank, far);
}

static void begin_cell(struct walks *s, const struct mesh_near *near,
    const struct mesh_cell *cell)
{
	struct mesh_loops room;
	const struct mesh_loops *loops = mesh_loops_get(&s->w->cases,
	    cell->inside, cell->joined, &room);

	for (unsigned l = 0; l < loops->count; l++) {
		struct mesh_planes loop;

		loop.count = loop.caps = 0;
		for (unsigned e = 0; e < 12; e++)
			if (loops->of[e] == l)
				mesh_planes_add(s->w, near, cell, e, &loop);
		begin(s, cell, cell->vertex + l, &loop);
	}
}

/* ---- onto the surface ---- */

/* Newton's step from best along the gradient, as far as the cell allows: along
 * its faces where it would leave. False: there is none. */
static bool aim(struct walk *walk, double part)
{
	double g2 = 0.0, x[3];
	bool is_free[3];

	for (int k = 0; k < 3; k++) {
		double to = walk->gradient[k] * (walk->value > 0.0 ? -1.0 : 1.0);

		is_free[k] = to > 0.0 ? walk->best[k] < walk->limits.high[k] :
		    walk->best[k] > walk->limits.low[k];
		if (is_free[k])
			g2 += to * to;
	}
	if (!(g2 > 0.0))
		return false;
	for (int k = 0; k < 3; k++)
		x[k] = (double)walk->best[k] - (is_free[k] ? part *
		    walk->value * (walk->gradient[k] / g2) : 0.0);
	put_within(walk, x, walk->p);
	return memcmp(walk->p, walk->best, sizeof walk->p) != 0;
}

/* How near the surface is to p if that is at an edge of it. */
static double sharp_near(const struct cells_grid *grid,
    const struct walk *walk)
{
	double d[3];

	for (int k = 0; k < 3; k++)
		d[k] = (double)walk->p[k] - walk->middle[k];
	return SHARP_LEAST * grid->least +
	    SHARP_NEAR * vec3_norm(vec3_get(d));
}

/* Whether it is on the surface, by the error there and the gradient's length. */
static bool is_there(const struct cells_grid *grid, double error, double g)
{
	return error <= fmin(NEAR_ENOUGH * grid->least * g, NEAR_VALUE);
}

/* Takes a sample; whether it is there, or can get no nearer. */
static bool step(const struct cells_grid *grid, struct walk *walk,
    const float row[static 4])
{
	double value = (double)row[0] - grid->iso, error = fabs(value);
	double g = sqrt((double)row[1] * row[1] + (double)row[2] * row[2] +
	    (double)row[3] * row[3]);

	if (walk->steps == 0 && walk->is_sharp && !walk->is_rim)
		walk->is_sharp = error <= g * sharp_near(grid, walk);
	if (walk->is_away && walk->steps == 0 && !(walk->is_sharp &&
	    error <= AWAY_NEAR * grid->least * g)) {
		go_home(grid, walk);
		return false;
	}
	walk->steps++;
	if (error < walk->error) {
		walk->error = error;
		walk->value = value;
		memcpy(walk->best, walk->p, sizeof walk->best);
		memcpy(walk->gradient, row + 1, sizeof walk->gradient);
		return is_there(grid, error, g) ||
		    walk->steps >= STEPS_MAX || !aim(walk, 1.0);
	}
	return walk->steps >= STEPS_MAX ||
	    !aim(walk, ldexp(1.0, -walk->steps));
}

/* ---- beside what looks sharp ---- */

/* Aims a little to side i of best. */
static void look(const struct cells_grid *grid, struct walk *walk, int i)
{
	double far = (i == 0 ? SIDE : -SIDE) * grid->least;

	for (int k = 0; k < 3; k++)
		walk->p[k] = (float)(walk->best[k] + far * walk->across[k]);
	walk->phase = i == 0 ? LOOKING : LOOKING_2;
}

/* Takes the gradient beside it; whether the walk has ended. */
static bool look_beside(const struct cells_grid *grid, struct walk *walk,
    const float row[static 4])
{
	struct vec3 n = vec3(row[1], row[2], row[3]);

	if (walk->phase == LOOKING) {
		memcpy(walk->beside, row + 1, sizeof walk->beside);
		look(grid, walk, 1);
		return false;
	}
	walk->phase = WALKING;
	if (angle(n, vec3(walk->beside[0], walk->beside[1],
	    walk->beside[2])) >= SIDE_TURN * walk->turn)
		return true;
	walk->is_sharp = false;
	if (!walk->is_away)
		return true;
	go_home(grid, walk);
	return false;
}

/* ---- by halving ---- */

/* The values at the ends of a crossing's edge, less iso, and where they are. */
struct ends {
	double f[2];
	float p[2][3];
};

/* False: it is a cap's. */
static bool get_ends(const struct mesh_work *w, const struct mesh_near *near,
    const struct mesh_cell *cell, unsigned edge, struct ends *out)
{
	const struct mesh_crossing *c = w->crossings +
	    mesh_cell_crossing(near, cell->local, edge);
	unsigned a = edge / 4;
	size_t corner[3];

	mesh_corner_of(w->blocks + cell->block, cell->local, corner);
	corner[(a + 1) % 3] += edge & 1;
	corner[(a + 2) % 3] += edge >> 1 & 1;
	for (int i = 0; i < 2; i++) {
		out->f[i] = (double)c->ends[i] - w->grid.iso;
		for (int k = 0; k < 3; k++)
			out->p[i][k] = cells_corner(&w->grid, k, corner[k] +
			    ((unsigned)k == a ? (size_t)i : 0));
	}
	return !mesh_is_cap(&w->grid, corner, a);
}

/* How well p lies where the gradient at best says that the surface is. */
static double fitness(const struct walk *walk, const float p[static 3])
{
	double to[3], g[3], sign = walk->value > 0.0 ? -1.0 : 1.0;

	for (int k = 0; k < 3; k++) {
		to[k] = (double)p[k] - walk->best[k];
		g[k] = sign * walk->gradient[k];
	}
	return vec3_norm(vec3_get(g)) > 0.0 && vec3_norm(vec3_get(to)) > 0.0 ?
	    vec3_dot(vec3_unit(vec3_get(g)), vec3_unit(vec3_get(to))) :
	    -vec3_norm(vec3_get(to));
}

/* The corner of walk's cell, of its curve's crossed edges, that is on the other
 * side of the surface than best is. False: there is none. */
static bool find_other_side(const struct mesh_work *w, struct walk *walk)
{
	const size_t own[3] = {walk->own[0], walk->own[1], walk->own[2]};
	const struct mesh_cell *cell = mesh_cell_at(w, own);
	const struct mesh_loops *loops;
	struct mesh_loops room;
	struct mesh_near near;
	double most = -INFINITY;

	mesh_near_init(w, w->blocks + cell->block, 1, &near);
	loops = mesh_loops_get(&w->cases, cell->inside, cell->joined, &room);
	for (unsigned e = 0; e < 12; e++) {
		struct ends ends;
		int i;

		if (loops->of[e] != walk->vertex - cell->vertex ||
		    !get_ends(w, &near, cell, e, &ends))
			continue;
		i = (ends.f[0] >= 0.0) == (walk->value >= 0.0);
		if (fitness(walk, ends.p[i]) <= most)
			continue;
		most = fitness(walk, ends.p[i]);
		walk->f[1] = ends.f[i];
		memcpy(walk->to, ends.p[i], sizeof walk->to);
	}
	return most > -INFINITY;
}

/* Aims between its ends; whether that is one of them in float32. */
static bool halve(struct walk *walk)
{
	double d = walk->f[1] - walk->f[0];
	double length = walk->t[1] - walk->t[0], t;
	bool is_end[2] = {true, true};

	t = walk->t[0] + (walk->steps < FALSE_MAX && d != 0.0 ?
	    fmin(fmax(-walk->f[0] / d, 0.01), 0.99) : 0.5) * length;
	for (int k = 0; k < 3; k++) {
		double x[3] = {walk->t[0], walk->t[1], t};

		for (int i = 0; i < 3; i++)
			x[i] = walk->from[k] +
			    x[i] * ((double)walk->to[k] - walk->from[k]);
		walk->p[k] = (float)x[2];
		is_end[0] &= walk->p[k] == (float)x[0];
		is_end[1] &= walk->p[k] == (float)x[1];
	}
	return (is_end[0] || is_end[1]) && walk->steps >= FALSE_MAX;
}

/* Begins to look for the surface between best and the other side. False: there
 * is none. */
static bool begin_halving(const struct mesh_work *w, struct walk *walk)
{
	if (!find_other_side(w, walk))
		return false;
	memcpy(walk->from, walk->best, sizeof walk->from);
	walk->t[0] = 0.0;
	walk->t[1] = 1.0;
	walk->f[0] = walk->value;
	walk->phase = HALVING;
	walk->steps = 0;
	halve(walk);
	return true;
}

/* The part of the line that p is, along its longest axis. */
static double part_of(const struct walk *walk)
{
	int a = 0;

	for (int k = 1; k < 3; k++)
		if (fabs((double)walk->to[k] - walk->from[k]) >
		    fabs((double)walk->to[a] - walk->from[a]))
			a = k;
	return ((double)walk->p[a] - walk->from[a]) /
	    ((double)walk->to[a] - walk->from[a]);
}

/* Takes a sample between the ends; whether it has ended. */
static bool halve_step(const struct cells_grid *grid, struct walk *walk,
    const float row[static 4])
{
	const size_t own[3] = {walk->own[0], walk->own[1], walk->own[2]};
	double f = (double)row[0] - grid->iso;
	double g = vec3_norm(vec3(row[1], row[2], row[3]));
	int end = (f >= 0.0) == (walk->f[1] >= 0.0);

	if (fabs(f) < walk->error) {
		mesh_limits_set_wide(grid, own, &walk->limits);
		for (int k = 0; k < 3; k++)
			walk->best[k] = fminf(fmaxf(walk->p[k],
			    walk->limits.low[k]), walk->limits.high[k]);
		walk->error = fabs(f);
		memcpy(walk->gradient, row + 1, sizeof walk->gradient);
	}
	walk->t[end] = part_of(walk);
	walk->f[end] = f;
	walk->steps++;
	return is_there(grid, fabs(f), g) || walk->steps >= HALVINGS_MAX ||
	    halve(walk);
}

/* ---- all of it ---- */

/* What comes after the walk along the gradient; whether nothing does. */
static bool conclude(const struct mesh_work *w, struct walk *walk)
{
	double g = vec3_norm(vec3(walk->gradient[0], walk->gradient[1],
	    walk->gradient[2]));

	if (walk->error > fmin(OFF * w->grid.least * g, OFF_VALUE)) {
		if (walk->is_away) {
			go_home(&w->grid, walk);
			return false;
		}
		walk->is_sharp = walk->is_rim;
		return !begin_halving(w, walk);
	}
	if (!walk->is_sharp || walk->is_rim)
		return true;
	look(&w->grid, walk, 0);
	return false;
}

/* Takes a sample; whether the vertex has its place. */
static bool advance(const struct mesh_work *w, struct walk *walk,
    const float row[static 4])
{
	switch (walk->phase) {
	case WALKING:
		return step(&w->grid, walk, row) && conclude(w, walk);
	case HALVING:
		return halve_step(&w->grid, walk, row);
	default:
		return look_beside(&w->grid, walk, row);
	}
}

static enum err run(struct walks *s)
{
	struct mesh_work *w = s->w;
	size_t count = s->count, left = 0;
	enum err err;

	if (!sampler_goes_on(w->sampler, "vertices",
	    fmin(0.9, 0.6 + 0.2 * (double)s->done /
	    (double)(w->vertex_count + 1))))
		return ERR_CANCELLED;
	for (size_t i = 0; i < count; i++)
		memcpy(w->points + 3 * i, s->walks[i].p, sizeof s->walks[i].p);
	err = mesh_sample(w, count, OUTPUT_VALUE | OUTPUT_GRADIENT);
	if (err != ERR_OK)
		return err;
	for (size_t i = 0; i < count && err == ERR_OK; i++) {
		struct walk *walk = s->walks + i;

		if (advance(w, walk, w->rows + 4 * i))
			err = finish(s, walk);
		else
			s->walks[left++] = *walk;
	}
	s->count = left;
	return err;
}

/* Fewer that are still on their way than this wait for others. */
#define WALKS_MAX (MESH_BATCH / 2)

static enum err walk_block(struct walks *s, const struct mesh_block *b)
{
	struct mesh_work *w = s->w;
	struct mesh_near near;
	enum err err = ERR_OK;

	mesh_near_init(w, b, 1, &near);
	for (size_t i = 0; i < mesh_bits(b->cells) && err == ERR_OK; i++) {
		begin_cell(s, &near, w->cells + b->first_cell + i);
		while (s->count + MESH_LOOPS_MAX > WALKS_MAX && err == ERR_OK)
			err = run(s);
	}
	return err;
}

/* ---- beside edges ---- */

/* A cell beside a sharp one that crosses one plane only, although the edge may
 * pass through it: places its vertex on the edge if it does. */
static void begin_second(struct walks *s, const struct mesh_cell *cell)
{
	static const bool all_free[3] = {true, true, true};
	struct mesh_work *w = s->w;
	struct walk *walk = s->walks + s->count;
	size_t own[3];
	double x[3];

	*walk = (struct walk){.vertex = cell->vertex, .error = DBL_MAX,
	    .is_sharp = true};
	mesh_corner_of(w->blocks + cell->block, cell->local, own);
	for (int k = 0; k < 3; k++)
		walk->own[k] = walk->at[k] = (uint16_t)own[k];
	mesh_limits_set(&w->grid, own, &walk->limits);
	memcpy(walk->p, w->positions + 3 * (size_t)cell->vertex,
	    sizeof walk->p);
	memcpy(walk->normal, w->normals + 3 * (size_t)cell->vertex,
	    sizeof walk->normal);
	memcpy(walk->middle, walk->p, sizeof walk->middle);
	if (!find_corner(w, walk, 2, x) || outermost(walk, all_free, x) >= 0)
		return;
	send_away(w, walk, x);
	s->count++;
}

/* Whether a vertex is to be looked at because of a sharp one beside it: no cap's,
 * alone in its cell. */
static bool is_plain(const struct mesh_work *w, const struct mesh_cell *cell)
{
	size_t at[3];

	mesh_corner_of(w->blocks + cell->block, cell->local, at);
	for (int k = 0; k < 3; k++)
		if (at[k] < 1 || at[k] > w->grid.counts[k])
			return false;
	return cell->loops == 1 && w->is_sharp[cell->vertex] == 0;
}

/* Marks cells beside sharp ones: is_sharp of their vertices becomes 2. */
static void mark_beside(struct mesh_work *w, const struct mesh_cell *cell)
{
	size_t own[3];

	mesh_corner_of(w->blocks + cell->block, cell->local, own);
	for (int i = 0; i < 6; i++) {
		size_t at[3] = {own[0], own[1], own[2]};
		const struct mesh_cell *beside;

		at[i / 2] += i % 2 ? 1 : SIZE_MAX;
		beside = mesh_cell_at(w, at);
		if (beside != NULL && is_plain(w, beside))
			w->is_sharp[beside->vertex] = 2;
	}
}

/* Cells that are looked at between two questions whether to go on: at a few
 * microseconds each. */
#define BESIDE_A_LOOK 4096

static enum err place_beside(struct walks *s)
{
	struct mesh_work *w = s->w;
	size_t looked = 0;
	enum err err = ERR_OK;

	for (size_t i = 0; i < w->cell_count; i++)
		if (w->cells[i].loops == 1 &&
		    w->is_sharp[w->cells[i].vertex] == 1)
			mark_beside(w, w->cells + i);
	for (size_t i = 0; i < w->cell_count && err == ERR_OK; i++) {
		if (w->is_sharp[w->cells[i].vertex] != 2)
			continue;
		if (++looked % BESIDE_A_LOOK == 0 &&
		    !sampler_goes_on(w->sampler, "vertices", 0.9))
			return ERR_CANCELLED;
		w->is_sharp[w->cells[i].vertex] = 0;
		begin_second(s, w->cells + i);
		while (s->count == WALKS_MAX && err == ERR_OK)
			err = run(s);
	}
	return err;
}

/* ---- back home ---- */

/* Begins anew with a vertex that found its place taken. */
static void begin_again(struct walks *s, const struct mesh_away *away)
{
	const size_t own[3] = {away->own[0], away->own[1], away->own[2]};
	struct walk *walk = s->walks + s->count++;

	*walk = (struct walk){.vertex = away->vertex, .error = DBL_MAX};
	memcpy(walk->own, away->own, sizeof walk->own);
	memcpy(walk->at, away->own, sizeof walk->at);
	memcpy(walk->p, away->home, sizeof walk->p);
	memcpy(walk->normal, s->w->normals + 3 * (size_t)away->vertex,
	    sizeof walk->normal);
	mesh_limits_set(&s->w->grid, own, &walk->limits);
}

static enum err run_all(struct walks *s)
{
	enum err err = ERR_OK;

	while (s->count > 0 && err == ERR_OK)
		err = run(s);
	return err;
}

static enum err walk_again(struct walks *s, const struct mesh_aways *gone)
{
	enum err err = ERR_OK;

	for (size_t i = 0; i < gone->count && err == ERR_OK; i++) {
		begin_again(s, gone->list + i);
		if (s->count == WALKS_MAX)
			err = run_all(s);
	}
	return err == ERR_OK ? run_all(s) : err;
}

/* Sends back whoever is too near others, until nobody is: who goes back may
 * crowd another one in its own cell. */
static enum err settle(struct walks *s)
{
	enum err err = ERR_OK;

	for (size_t left = 1; left > 0 && err == ERR_OK;) {
		struct mesh_aways gone = {0};

		err = mesh_aways_settle(&s->aways, s->w, &gone);
		left = gone.count;
		if (err == ERR_OK)
			err = walk_again(s, &gone);
		mesh_aways_fini(&gone);
	}
	return err;
}

enum err mesh_place_vertices(struct mesh_work *w)
{
	struct walks s = {w, malloc(WALKS_MAX * sizeof(struct walk)), 0, 0,
	    {0}};
	enum err err = s.walks == NULL ? ERR_MEMORY : ERR_OK;

	for (size_t i = 0; i < w->block_count && err == ERR_OK; i++)
		err = walk_block(&s, w->blocks + i);
	if (err == ERR_OK)
		err = run_all(&s);
	if (err == ERR_OK && w->options->features)
		err = place_beside(&s);
	if (err == ERR_OK)
		err = run_all(&s);
	if (err == ERR_OK)
		err = mesh_part_vertices(w);
	if (err == ERR_OK)
		err = settle(&s);
	if (err == ERR_OK)
		err = mesh_place_bridges(w);
	free(s.walks);
	mesh_aways_fini(&s.aways);
	return err;
}
