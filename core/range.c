/*
 * A walk along a list as core/evaluate.c's, of ranges instead of jets.
 */
#include "core/range.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/range_parts.h"
#include "core/tape.h"

struct range_tape {
	const struct tape *tape;
	struct prune_index *index;
	struct range_operator *operators;
	struct range_volume **volumes;
	double phi[RANGE_PHI + 1];
};

static double dmax(double a, double b)
{
	return a > b ? a : b;
}

static double dmin(double a, double b)
{
	return a < b ? a : b;
}

/* ---- life ---- */

static enum err create_volumes(struct range_tape *r)
{
	for (size_t i = 0; i < r->tape->volume_count; i++) {
		enum err err = range_volume_create(r->tape->volumes[i],
		    r->volumes + i);

		if (err)
			return err;
	}
	return ERR_OK;
}

enum err range_tape_create(const struct tape *tape, struct range_tape **out)
{
	struct range_tape *r = calloc(1, sizeof *r);
	struct prune_list whole;

	if (r == NULL)
		return ERR_MEMORY;
	r->tape = tape;
	r->operators = calloc(tape->operator_count + 1, sizeof *r->operators);
	r->volumes = calloc(tape->volume_count + 1, sizeof *r->volumes);
	if (r->operators == NULL || r->volumes == NULL ||
	    create_volumes(r) != ERR_OK)
		goto fail;
	whole = range_whole(r);
	if (prune_index_create(&whole, &r->index) != ERR_OK)
		goto fail;
	range_phi_table(r->phi);
	for (size_t i = 0; i < tape->operator_count; i++)
		range_operator_init(tape->operators + i, r->operators + i);
	*out = r;
	return ERR_OK;
fail:
	range_tape_free(r);
	return ERR_MEMORY;
}

void range_tape_free(struct range_tape *r)
{
	if (r == NULL)
		return;
	for (size_t i = 0; r->volumes != NULL && i < r->tape->volume_count; i++)
		range_volume_free(r->volumes[i]);
	prune_index_free(r->index);
	free(r->volumes);
	free(r->operators);
	free(r);
}

struct prune_list range_whole(const struct range_tape *r)
{
	return (struct prune_list){r->tape->insns, r->tape->boxes,
	    r->tape->insn_count, r->index};
}

enum err range_list_create(const struct prune_list *from,
    struct prune_list *out)
{
	size_t count = from->count + PRUNE_ROOM;
	struct prune_list list = {
		.insns = malloc(count * sizeof *list.insns),
		.boxes = malloc(count * sizeof *list.boxes),
	};

	if (list.insns == NULL || list.boxes == NULL) {
		range_list_free(&list);
		return ERR_MEMORY;
	}
	*out = list;
	return ERR_OK;
}

void range_list_free(struct prune_list *list)
{
	free(list->insns);
	free(list->boxes);
	*list = (struct prune_list){0};
}

void range_prune(const struct range_tape *r, const struct prune_list *from,
    const struct tape_box *box, struct prune_list *out)
{
	(void)r;
	prune_operands(from, box, out);
}

/* ---- patches ---- */

void patch_finish(struct patch *s)
{
	const struct vec3 *v = s->v;
	struct vec3 p, q;
	double dd;

	s->h[0] = fabs(v[0].x);
	s->h[1] = fabs(v[0].y);
	s->h[2] = fabs(v[0].z);
	for (int i = 1; i < s->n; i++) {
		s->h[0] += fabs(v[i].x);
		s->h[1] += fabs(v[i].y);
		s->h[2] += fabs(v[i].z);
	}
	if (s->n == 1) {
		s->r = s->speed = vec3_norm(v[0]);
		return;
	}
	/* of the longest of four diagonals */
	p = vec3_add(v[0], v[1]);
	q = vec3_sub(v[0], v[1]);
	dd = dmax(vec3_dot(p, p) + 2.0 * fabs(vec3_dot(p, v[2])),
	    vec3_dot(q, q) + 2.0 * fabs(vec3_dot(q, v[2])));
	s->r = sqrt(dd + vec3_dot(v[2], v[2]));
}

static void patch_of_box(double least[static 3], double most[static 3],
    struct patch *out)
{
	double h[3];

	for (int i = 0; i < 3; i++)
		h[i] = 0.5 * (most[i] - least[i]);
	*out = (struct patch){.c = {0.5 * (least[0] + most[0]),
	    0.5 * (least[1] + most[1]), 0.5 * (least[2] + most[2])},
	    .v = {{h[0], 0.0, 0.0}, {0.0, h[1], 0.0}, {0.0, 0.0, h[2]}},
	    .n = 3, .is_box = true};
	patch_finish(out);
}

/* What is out of reach is drawn in along its ray: each coordinate comes nearer
 * to 0. */
static void draw_in(struct patch *s)
{
	const double c[3] = {s->c.x, s->c.y, s->c.z}, reach = POINT_REACH;
	double least[3], most[3], speed;
	bool beyond = false;

	for (int i = 0; i < 3; i++) {
		least[i] = dmax(c[i] - s->h[i], -reach);
		most[i] = dmin(c[i] + s->h[i], reach);
		beyond |= !(fabs(c[i]) + s->h[i] <= reach);
	}
	if (!beyond)
		return;
	for (int i = 0; i < 3; i++) {
		least[i] = dmax(dmin(least[i], 0.0), -reach);
		most[i] = dmin(dmax(most[i], 0.0), reach);
	}
	speed = s->speed;
	patch_of_box(least, most, s);
	s->speed = 2.0 * speed;
}

static struct vec3 linear(const double *m, struct vec3 v)
{
	return vec3(m[0] * v.x + m[1] * v.y + m[2] * v.z,
	    m[3] * v.x + m[4] * v.y + m[5] * v.z,
	    m[6] * v.x + m[7] * v.y + m[8] * v.z);
}

/* No vector grows by more: sqrt(|A|_1 |A|_inf). */
static double linear_norm(const double *m)
{
	double row = 0.0, column = 0.0;

	for (int i = 0; i < 3; i++) {
		row = dmax(row, fabs(m[3 * i]) + fabs(m[3 * i + 1]) +
		    fabs(m[3 * i + 2]));
		column = dmax(column, fabs(m[i]) + fabs(m[3 + i]) +
		    fabs(m[6 + i]));
	}
	return sqrt(row * column);
}

static void enter_frame(const double *m, const struct patch *s,
    struct patch *out)
{
	out->c = vec3_add(linear(m, s->c), vec3_get(m + 9));
	out->n = s->n;
	out->speed = s->speed > 0.0 ? s->speed * linear_norm(m) : 0.0;
	out->is_box = false;
	for (int i = 0; i < s->n; i++)
		out->v[i] = linear(m, s->v[i]);
	patch_finish(out);
	draw_in(out);
}

/* ---- compositions ---- */

void range_max(const struct held *a, const struct held *b,
    struct held *out)
{
	if (a->least > b->most) {
		*out = *a;
	} else if (b->least > a->most) {
		*out = *b;
	} else {
		*out = (struct held){dmax(a->least, b->least),
		    dmax(a->most, b->most), dmin(a->fall, b->fall),
		    dmax(a->rise, b->rise), a->is_angled || b->is_angled};
	}
}

void range_min(const struct held *a, const struct held *b,
    struct held *out)
{
	if (a->most < b->least) {
		*out = *a;
	} else if (b->most < a->least) {
		*out = *b;
	} else {
		*out = (struct held){dmin(a->least, b->least),
		    dmin(a->most, b->most), dmin(a->fall, b->fall),
		    dmax(a->rise, b->rise), a->is_angled || b->is_angled};
	}
}

/* max(0, 1 - f) */
static struct held complement(const struct held *f)
{
	struct held out = {dmax(0.0, 1.0 - f->most), dmax(0.0, 1.0 - f->least),
	    -f->rise, -f->fall, f->is_angled};

	if (f->most > 1.0) {
		out.fall = dmin(out.fall, 0.0);
		out.rise = dmax(out.rise, 0.0);
	}
	return out;
}

static double norm_of(double n, double a, double b)
{
	double most = dmax(a, b), least = dmin(a, b);

	if (!(least > 0.0))
		return most;
	return most * pow(1.0 + pow(least / most, n), 1.0 / n);
}

/* Its first derivatives are from 0 to 1, for n >= 1; less steep powers are
 * steeper than that near 0. */
static void ricci(double n, const struct held *a, const struct held *b,
    struct held *out)
{
	const double steep = n >= 1.0 ? 1.0 : INFINITY;

	*out = (struct held){norm_of(n, a->least, b->least),
	    norm_of(n, a->most, b->most), -INFINITY, INFINITY,
	    a->is_angled || b->is_angled};
	if (a->fall >= 0.0 && b->fall >= 0.0)
		out->fall = 0.0;
	else if (n >= 1.0)
		out->fall = steep * (dmin(a->fall, 0.0) + dmin(b->fall, 0.0));
	if (a->rise <= 0.0 && b->rise <= 0.0)
		out->rise = 0.0;
	else if (n >= 1.0)
		out->rise = steep * (dmax(a->rise, 0.0) + dmax(b->rise, 0.0));
}

/* Two jets' ranges, a the one that comes first in the tree. */
static void compose(const struct range_tape *r, const struct insn *insn,
    const struct held *a, const struct held *b, struct held *out)
{
	const double *params = r->tape->params + insn->param;
	struct held inverse;

	switch (insn->op) {
	case OP_MAX:
		range_max(a, b, out);
		return;
	case OP_MIN:
		range_min(a, b, out);
		return;
	case OP_MINUS:
	case OP_MINUS_SWAPPED:
		inverse = complement(b);
		range_min(a, &inverse, out);
		return;
	case OP_SUM:
		*out = (struct held){a->least + b->least, a->most + b->most,
		    a->fall + b->fall, a->rise + b->rise,
		    a->is_angled || b->is_angled};
		return;
	case OP_RICCI:
		ricci(params[0], a, b, out);
		return;
	case OP_CLASSIC:
	case OP_CLASSIC_SWAPPED:
		range_classic(insn->index, params, a, b, out);
		return;
	case OP_DIFFERENCE:
	case OP_DIFFERENCE_SWAPPED:
		inverse = complement(b);
		b = &inverse;
		break;
	}
	range_compose(r->operators + insn->index, r->phi, a, b, out);
}

/* ---- the walk ---- */

struct walk {
	const struct range_tape *tape;
	struct held stack[TAPE_STACK_MAX], *end;
	struct patch bases[TAPE_WARPS_MAX + 1], *base;
	struct patch x; /* the primitives' */
};

#define FRAME_PARAMS 12

static void enter_warp(struct walk *w, const struct insn *insn,
    const double *params)
{
	struct patch framed;

	assert(w->base < w->bases + TAPE_WARPS_MAX);
	enter_frame(params, w->base, &framed);
	range_warp(insn->index, params + FRAME_PARAMS, &framed, ++w->base);
	draw_in(w->base);
	w->x = *w->base;
}

static void push_primitive(struct walk *w, const struct insn *insn,
    const double *params)
{
	if (insn->op == OP_ZERO)
		*w->end++ = (struct held){0};
	else if (insn->op == OP_VOLUME)
		range_volume_eval(w->tape->volumes[insn->index], params, &w->x,
		    w->end++);
	else
		range_primitive(insn->op, params, &w->x, w->end++);
}

static bool is_swapped(OPCODE_UINT op)
{
	return op == OP_MINUS_SWAPPED || op == OP_CLASSIC_SWAPPED ||
	    op == OP_DIFFERENCE_SWAPPED;
}

static void step(struct walk *w, const struct insn *insn)
{
	const double *params = w->tape->tape->params + insn->param;
	int first = is_swapped(insn->op);
	struct held *top, out;

	switch (insn->op) {
	case OP_FRAME:
		enter_frame(params, w->base, &w->x);
		return;
	case OP_CARRY:
	case OP_COLOR:
		return;
	case OP_ENTER:
		enter_warp(w, insn, params);
		return;
	case OP_LEAVE:
		w->base--;
		return;
	}
	if (insn->op < OP_MAX) {
		push_primitive(w, insn, params);
		return;
	}
	top = --w->end - 1;
	compose(w->tape, insn, top + first, top + 1 - first, &out);
	*top = out;
}

static struct held walk_list(struct walk *w, const struct range_tape *r,
    const struct prune_list *list)
{
	w->tape = r;
	w->end = w->stack;
	w->base = w->bases;
	draw_in(w->base);
	w->x = *w->base;
	for (size_t i = 0; i < list->count; i++)
		step(w, list->insns + i);
	return w->stack[0];
}

struct range range_eval(const struct range_tape *r,
    const struct prune_list *list, const struct tape_box *box)
{
	double least[3], most[3];
	struct held out;
	struct walk w;

	for (int i = 0; i < 3; i++) {
		least[i] = box->min[i];
		most[i] = box->max[i];
	}
	patch_of_box(least, most, w.bases);
	out = walk_list(&w, r, list);
	return (struct range){
	    dmax(0.0, out.least - RANGE_MARGIN * dmax(1.0, out.least)),
	    out.most + RANGE_MARGIN * dmax(1.0, out.most)};
}

void range_stretch(const struct range_tape *r, const struct prune_list *list,
    struct vec3 a, struct vec3 b, struct held *out)
{
	struct walk w;

	w.bases[0].c = vec3_scale(0.5, vec3_add(a, b));
	w.bases[0].v[0] = vec3_scale(0.5, vec3_sub(b, a));
	w.bases[0].n = 1;
	w.bases[0].is_box = false;
	patch_finish(w.bases);
	*out = walk_list(&w, r, list);
}

double range_stretching(const struct range_tape *r, const struct insn *insn)
{
	return dmax(linear_norm(r->tape->params + insn->param), 1e-30);
}

double range_size(const struct range_tape *r, const struct insn *insn)
{
	static const struct {
		unsigned char at;
		enum { LENGTH, INVERSE, INVERSE_SQUARE } is;
	} sizes[OP_MAX] = {
		[OP_POINT] = {3, INVERSE_SQUARE},
		[OP_SEGMENT] = {7, LENGTH},
		[OP_TRIANGLE] = {9, INVERSE_SQUARE},
		[OP_DISC] = {7, INVERSE_SQUARE},
		[OP_CIRCLE] = {7, INVERSE_SQUARE},
		[OP_SPHERE] = {4, INVERSE},
		[OP_BOX] = {7, INVERSE},
		[OP_CYLINDER] = {8, INVERSE},
		[OP_CAPSULE] = {8, INVERSE},
		[OP_CONE] = {9, INVERSE},
		[OP_TORUS] = {8, INVERSE},
		[OP_PLANE] = {6, INVERSE},
		[OP_CAUCHY_POINT] = {3, INVERSE},
		[OP_CAUCHY_SEGMENT] = {3, INVERSE},
		[OP_CAUCHY_TRIANGLE] = {3, INVERSE},
	};
	const double *p = r->tape->params + insn->param;
	double x = p[sizes[insn->op].at];

	if (insn->op == OP_ZERO)
		return INFINITY;
	if (insn->op == OP_VOLUME)
		return 1.0 / dmax(p[3], dmax(p[4], p[5]));
	if (insn->op == OP_SEGMENT)
		return dmin(x, dmax(x + p[8] * p[6], 1e-3 * x));
	return sizes[insn->op].is == INVERSE ? 1.0 / x : 1.0 / sqrt(x);
}
