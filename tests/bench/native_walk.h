/*
 * The native evaluator's walk: BLOCK vectors of points a decode. For each jet
 * on the stack one bit a vector says whether it is anything but 0 there, so
 * that an operand that is 0 costs nothing. Where few lanes of a block blend
 * they are gathered into dense vectors. Included by one file for each kind of
 * processor.
 */
#include <stdlib.h>

#include "core/output.h"
#include "core/tape.h"
#include "tests/bench/native_operator.h"

#define BLOCK 8
#define RUN 4 /* vectors whose sums are held in registers */
#define POINTS (BLOCK * LANES)
#define JET_FLOATS 10

struct slot {
	float c[JET_FLOATS][POINTS] __attribute__((aligned(64)));
	unsigned live; /* bit b: vector b is not all 0; else c is not read */
};

struct block {
	struct vec base[BLOCK], x[BLOCK];
	struct slot slots[TAPE_STACK_MAX];
	struct slot *stack[TAPE_STACK_MAX]; /* what is beyond top is spare */
	int top;
};

/* Jets by their components, in the order of a slot's columns. */
INLINE real column(const struct slot *s, int k, int b)
{
	return load(s->c[k] + b * LANES);
}

INLINE struct jet get(const struct slot *s, int b, int order)
{
	struct jet j = {.f = column(s, 0, b)};

	if (order >= 1)
		j.g = vec(column(s, 1, b), column(s, 2, b), column(s, 3, b));
	if (order >= 2)
		j.h = sym(column(s, 4, b), column(s, 5, b), column(s, 6, b),
		    column(s, 7, b), column(s, 8, b), column(s, 9, b));
	return j;
}

INLINE void put(struct slot *s, int b, int order, const struct jet *j)
{
	int at = b * LANES;

	store(s->c[0] + at, j->f);
	if (order >= 1) {
		store(s->c[1] + at, j->g.x);
		store(s->c[2] + at, j->g.y);
		store(s->c[3] + at, j->g.z);
	}
	if (order >= 2) {
		store(s->c[4] + at, j->h.xx);
		store(s->c[5] + at, j->h.yy);
		store(s->c[6] + at, j->h.zz);
		store(s->c[7] + at, j->h.xy);
		store(s->c[8] + at, j->h.xz);
		store(s->c[9] + at, j->h.yz);
	}
}

/* Vector b of s, 0 where it is dead. */
INLINE struct jet get_or_zero(const struct slot *s, int b, int order)
{
	if (s->live >> b & 1)
		return get(s, b, order);
	return (struct jet){0};
}

/* --- primitives ----------------------------------------------------------- */

#define EACH(function) \
	for (int b = 0; b < BLOCK; b++) { \
		struct jet j; \
		if (any(function(p, w->x[b], order, &j))) { \
			put(s, b, order, &j); \
			s->live |= 1u << b; \
		} \
	} \
	break

INLINE void push(struct block *w, unsigned op, const float *p, int order)
{
	struct slot *s = w->stack[w->top++];

	s->live = 0;
	switch (op) {
	case OP_POINT: EACH(point);
	case OP_SEGMENT: EACH(segment);
	case OP_TRIANGLE: EACH(triangle);
	case OP_DISC: EACH(disc);
	case OP_CIRCLE: EACH(circle);
	case OP_SPHERE: EACH(sphere);
	case OP_BOX: EACH(box);
	case OP_CYLINDER: EACH(cylinder);
	case OP_CAPSULE: EACH(capsule);
	case OP_CONE: EACH(cone);
	case OP_TORUS: EACH(torus);
	case OP_PLANE: EACH(plane);
	}
}

/* --- runs of points that are added ---------------------------------------- */

/* Adds a ball of exponent 3 to count jets in registers. */
INLINE void add_ball(const struct native_ball *p, const struct vec x[RUN],
    struct jet sum[RUN], int count, int order)
{
	for (int b = 0; b < count; b++) {
		struct vec e = sub(x[b], vec_all(p->c));
		real t = real_max(1.0f - dot(e, e) * p->inv_r2, all(0.0f));
		real s = t * t;

		sum[b].f += s * (p->weight * t);
		if (order >= 1)
			sum[b].g = axpy(p->slope * s, e, sum[b].g);
		if (order >= 2) {
			sum[b].h = sym_square(-4.0f * p->inv_r2 * p->slope * t,
			    e, sum[b].h);
			sum[b].h = sym_axpy(p->slope * s,
			    sym_one(all(1.0f)), sum[b].h);
		}
	}
}

/* A run of pairs of OP_POINT, OP_SUM. */
INLINE void add_balls(const struct native_run *run, struct block *w, int order)
{
	struct slot *s = w->stack[w->top - 1];
	int count = order < 2 ? RUN : RUN / 2;

	for (int part = 0; part < BLOCK; part += count) {
		struct jet sum[RUN];
		struct vec x[RUN];

		for (int b = 0; b < count; b++) {
			sum[b] = get_or_zero(s, part + b, order);
			x[b] = w->x[part + b];
		}
		for (size_t i = 0; i < run->count; i++)
			add_ball(run->balls + i, x, sum, count, order);
		for (int b = 0; b < count; b++)
			put(s, part + b, order, sum + b);
	}
	s->live = (1u << BLOCK) - 1;
}

/* --- compositions --------------------------------------------------------- */

INLINE struct jet pick(mask m, const struct jet *yes, const struct jet *no,
    int order)
{
	struct jet j = {.f = choose(m, yes->f, no->f)};

	if (order >= 1)
		j.g = vec_select(m, yes->g, no->g);
	if (order >= 2)
		j.h = sym_select(m, yes->h, no->h);
	return j;
}

INLINE void complement(struct jet *a, int order)
{
	real value = 1.0f - a->f;
	real sign = choose(gt(value, all(0.0f)), all(-1.0f), all(0.0f));

	a->f = real_max(value, all(0.0f));
	if (order >= 1)
		a->g = scale(sign, a->g);
	if (order >= 2)
		a->h = sym_scale(sign, a->h);
}

INLINE struct jet plus(const struct jet *a, const struct jet *b, int order)
{
	struct jet j = {.f = a->f + b->f};

	if (order >= 1)
		j.g = add(a->g, b->g);
	if (order >= 2)
		j.h = sym_axpy(all(1.0f), b->h, a->h);
	return j;
}

/* (1 + t)^(1/n) and t = r^n; n = 2 is what documents say. */
INLINE real ricci_power(real r, float n, real *t)
{
	real q;

	if (n == 2.0f) {
		*t = r * r;
		return root(1.0f + *t);
	}
	q = *t = power(r, n);
	for (int l = 0; l < LANES; l++)
		q[l] = powf(1.0f + q[l], 1.0f / n);
	return q;
}

/* kernels/compose.cl, compose_ricci */
INLINE struct jet ricci(const struct jet *a, const struct jet *b, float n,
    int order)
{
	mask m = ge(a->f, b->f);
	struct jet j = pick(m, a, b, order), least = pick(m, b, a, order);
	real inv = over(real_max(j.f, all(1e-30f))), t, q, big, small, rest;
	real r = real_max(least.f * inv, all(1e-12f));

	q = ricci_power(r, n, &t);
	rest = over(1.0f + t);
	big = q * rest;
	small = big * t * over(r);
	if (order >= 2) {
		struct vec d = axpy(-over(real_max(least.f, all(1e-30f))),
		    least.g, scale(inv, j.g));

		j.h = sym_axpy(small, least.h, sym_scale(big, j.h));
		j.h = sym_square((n - 1.0f) * t * j.f * big * rest, d, j.h);
	}
	if (order >= 1)
		j.g = axpy(small, least.g, scale(big, j.g));
	j.f *= q;
	return j;
}

/* Lanes of a block where both operands are not 0, in order. */
struct dense {
	int32_t at[POINTS + LANES];
	int count, vectors; /* lanes; vectors that have some */
};

INLINE void find_dense(const struct slot *a, const struct slot *b,
    struct dense *d)
{
	d->count = d->vectors = 0;
	for (int k = 0; k < BLOCK; k++) {
		real zero = all(0.0f);
		unsigned m;

		if (!(a->live & b->live & 1u << k))
			continue;
		m = bits(both(gt(load(a->c[0] + k * LANES), zero),
		    gt(load(b->c[0] + k * LANES), zero)));
		d->vectors += m != 0;
		for (; m; m &= m - 1)
			d->at[d->count++] = k * LANES + __builtin_ctz(m);
	}
}

INLINE struct jet gather_jet(const struct slot *s, whole at, int order)
{
	struct jet j = {.f = gather(s->c[0], at)};

	if (order >= 1)
		j.g = vec(gather(s->c[1], at), gather(s->c[2], at),
		    gather(s->c[3], at));
	if (order >= 2)
		j.h = sym(gather(s->c[4], at), gather(s->c[5], at),
		    gather(s->c[6], at), gather(s->c[7], at),
		    gather(s->c[8], at), gather(s->c[9], at));
	return j;
}

INLINE void scatter_jet(struct slot *s, whole at, mask m, int order,
    const struct jet *j)
{
	scatter(s->c[0], at, m, j->f);
	if (order >= 1) {
		scatter(s->c[1], at, m, j->g.x);
		scatter(s->c[2], at, m, j->g.y);
		scatter(s->c[3], at, m, j->g.z);
	}
	if (order >= 2) {
		scatter(s->c[4], at, m, j->h.xx);
		scatter(s->c[5], at, m, j->h.yy);
		scatter(s->c[6], at, m, j->h.zz);
		scatter(s->c[7], at, m, j->h.xy);
		scatter(s->c[8], at, m, j->h.xz);
		scatter(s->c[9], at, m, j->h.yz);
	}
}

/* Blends the lanes of d, the rest of whose last vector are copies, to out. */
INLINE void blend_dense(const struct native_operator *o, float null_gradient,
    const struct slot *a, const struct slot *b, struct dense *d, int order,
    struct jet out[BLOCK])
{
	int deep = o->is_constant || order == 2 ? order : order + 1;

	for (int l = d->count; l < d->count + LANES; l++)
		d->at[l] = d->at[d->count - 1];
	for (int i = 0; i < d->count; i += LANES) {
		struct jet x, y;
		whole at;

		memcpy(&at, d->at + i, sizeof(at));
		x = gather_jet(a, at, deep);
		y = gather_jet(b, at, deep);
		blend(o, null_gradient, &x, &y, order, out + i / LANES);
	}
}

INLINE void put_dense(const struct dense *d, const struct jet *from, int order,
    struct slot *to)
{
	for (int i = 0; i < d->count; i += LANES) {
		int left = d->count - i;
		whole at;

		memcpy(&at, d->at + i, sizeof(at));
		scatter_jet(to, at, from_bits(left >= LANES ? ~0u :
		    (1u << left) - 1), order, from + i / LANES);
	}
}

/* Vectors k of a and b that are both live, in place. */
INLINE void blend_vector(const struct native_operator *o, float null_gradient,
    struct slot *a, const struct slot *b, int k, int order)
{
	int deep = o->is_constant || order == 2 ? order : order + 1;
	struct jet x = get(a, k, deep), y = get(b, k, deep), r;

	blend(o, null_gradient, &x, &y, order, &r);
	put(a, k, order, &r);
}

/* The larger one of both. */
INLINE void merge_vector(struct slot *a, const struct slot *b, int k,
    int order)
{
	struct jet x = get(a, k, order), y = get(b, k, order);
	mask m = lt(x.f, y.f);

	if (!any(m))
		return;
	x = pick(m, &y, &x, order);
	put(a, k, order, &x);
}

INLINE void unite(const struct native_operator *o, float null_gradient,
    struct slot *a, const struct slot *b, int order)
{
	struct jet blended[BLOCK];
	struct dense d;
	int pays;

	find_dense(a, b, &d);
	pays = (d.count + LANES - 1) / LANES < d.vectors;
	if (pays)
		blend_dense(o, null_gradient, a, b, &d, order, blended);
	for (int k = 0; k < BLOCK; k++) {
		struct jet y;

		if (!(b->live >> k & 1))
			continue;
		if (!(a->live >> k & 1)) {
			y = get(b, k, order);
			put(a, k, order, &y);
		} else if (pays) {
			merge_vector(a, b, k, order);
		} else {
			blend_vector(o, null_gradient, a, b, k, order);
		}
	}
	if (pays)
		put_dense(&d, blended, order, a);
	a->live |= b->live;
}

/* Intersections and differences, which are 0 where the first operand is. */
INLINE void intersect(const struct native_operator *o, unsigned op,
    float null_gradient, struct slot *a, struct slot *b, int order)
{
	int deep = o->is_constant || order == 2 ? order : order + 1;
	unsigned live = 0;

	for (int k = 0; k < BLOCK; k++) {
		struct jet x = get_or_zero(a, k, deep), r;
		struct jet y = get_or_zero(b, k, deep);

		if (op == OP_DIFFERENCE)
			complement(&y, deep);
		if (op == OP_DIFFERENCE_SWAPPED)
			complement(&x, deep);
		if (!any(both(gt(x.f, all(0.0f)), gt(y.f, all(0.0f)))))
			continue;
		blend(o, null_gradient, &x, &y, order, &r);
		put(a, k, order, &r);
		live |= 1u << k;
	}
	a->live = live;
}

INLINE void by_table(const struct native *n, const struct insn *insn,
    struct block *w, int order)
{
	const struct native_operator *o = n->operators + insn->index;
	float null_gradient = n->params[insn->param];
	struct slot *a = w->stack[w->top - 1], *b = w->stack[w->top];

	if (insn->op != OP_UNION) {
		intersect(o, insn->op, null_gradient, a, b, order);
	} else if (!a->live) {
		w->stack[w->top - 1] = b;
		w->stack[w->top] = a;
	} else if (b->live) {
		unite(o, null_gradient, a, b, order);
	}
}

/* One vector of the compositions that give the other operand where one is 0. */
INLINE struct jet join(unsigned op, float n, const struct jet *x,
    const struct jet *y, int order)
{
	if (op == OP_SUM)
		return plus(x, y, order);
	if (op == OP_RICCI)
		return ricci(x, y, n, order);
	return pick(ge(x->f, y->f), x, y, order);
}

INLINE void join_all(unsigned op, float n, struct block *w, int order)
{
	struct slot *a = w->stack[w->top - 1], *b = w->stack[w->top];

	if (!a->live) {
		w->stack[w->top - 1] = b;
		w->stack[w->top] = a;
		return;
	}
	for (int k = 0; k < BLOCK; k++) {
		struct jet x, y;

		if (!(b->live >> k & 1))
			continue;
		y = get(b, k, order);
		if (a->live >> k & 1) {
			x = get(a, k, order);
			y = join(op, n, &x, &y, order);
		}
		put(a, k, order, &y);
	}
	a->live |= b->live;
}

/* OP_MIN and its like */
INLINE void cut_all(unsigned op, struct block *w, int order)
{
	struct slot *a = w->stack[w->top - 1], *b = w->stack[w->top];
	unsigned live = 0;

	for (int k = 0; k < BLOCK; k++) {
		struct jet x = get_or_zero(a, k, order);
		struct jet y = get_or_zero(b, k, order);

		if (op == OP_MINUS)
			complement(&y, order);
		if (op == OP_MINUS_SWAPPED)
			complement(&x, order);
		if (op == OP_MINUS_SWAPPED)
			x = pick(le(y.f, x.f), &y, &x, order);
		else
			x = pick(le(x.f, y.f), &x, &y, order);
		put(a, k, order, &x);
		if (any(gt(x.f, all(0.0f))))
			live |= 1u << k;
	}
	a->live = live;
}

INLINE void compose(const struct native *n, const struct insn *insn,
    struct block *w, int order)
{
	w->top--;
	if (insn->op >= OP_UNION)
		by_table(n, insn, w, order);
	else if (insn->op == OP_SUM || insn->op == OP_RICCI ||
	    insn->op == OP_MAX)
		join_all(insn->op, n->params[insn->param], w, order);
	else
		cut_all(insn->op, w, order);
}

/* --- frames --------------------------------------------------------------- */

INLINE void enter(const float *m, struct block *w)
{
	for (int b = 0; b < BLOCK; b++) {
		struct vec p = w->base[b];

		w->x[b] = vec(m[0] * p.x + m[1] * p.y + m[2] * p.z + m[9],
		    m[3] * p.x + m[4] * p.y + m[5] * p.z + m[10],
		    m[6] * p.x + m[7] * p.y + m[8] * p.z + m[11]);
	}
}

/* a^T v */
INLINE struct vec pull(const float *a, struct vec v)
{
	return vec(a[0] * v.x + a[3] * v.y + a[6] * v.z,
	    a[1] * v.x + a[4] * v.y + a[7] * v.z,
	    a[2] * v.x + a[5] * v.y + a[8] * v.z);
}

INLINE void carry(const float *a, struct slot *s, int order)
{
	for (int b = 0; b < BLOCK && order > 0; b++) {
		struct jet j;
		struct vec x, y, z, p, q, r;

		if (!(s->live >> b & 1))
			continue;
		j = get(s, b, order);
		j.g = pull(a, j.g);
		if (order >= 2) {
			x = pull(a, vec(j.h.xx, j.h.xy, j.h.xz));
			y = pull(a, vec(j.h.xy, j.h.yy, j.h.yz));
			z = pull(a, vec(j.h.xz, j.h.yz, j.h.zz));
			p = pull(a, vec(x.x, y.x, z.x));
			q = pull(a, vec(x.y, y.y, z.y));
			r = pull(a, vec(x.z, y.z, z.z));
			j.h = sym(p.x, q.y, r.z, p.y, p.z, q.z);
		}
		put(s, b, order, &j);
	}
}

/* --- the walk ------------------------------------------------------------- */

/* One instruction at an order that is a constant; returns the next one. */
INLINE size_t step(const struct native *n, struct block *w, size_t i,
    int order)
{
	const struct insn *insn = n->insns + i;
	const float *p = n->params + insn->param;

	if (n->runs[i].count > 0) {
		add_balls(n->runs + i, w, order);
		return i + 2 * n->runs[i].count;
	}
	if (insn->op == OP_CARRY)
		carry(p, w->stack[w->top - 1], order);
	else if (insn->op >= OP_MAX)
		compose(n, insn, w, order);
	else
		push(w, insn->op, p, order);
	return i + 1;
}

static size_t step0(const struct native *n, struct block *w, size_t i)
{
	return step(n, w, i, 0);
}

static size_t step1(const struct native *n, struct block *w, size_t i)
{
	return step(n, w, i, 1);
}

static size_t step2(const struct native *n, struct block *w, size_t i)
{
	return step(n, w, i, 2);
}

static void walk_block(const struct native *n, struct block *w, int root)
{
	w->top = 0;
	for (size_t i = 0; i < n->insn_count;) {
		const struct insn *insn = n->insns + i;

		if (insn->op == OP_FRAME) {
			enter(n->params + insn->param, w);
			i++;
			continue;
		}
		if (insn->op == OP_COLOR) {
			i++;
			continue;
		}
		switch (tape_order(insn, root)) {
		case 0:
			i = step0(n, w, i);
			break;
		case 1:
			i = step1(n, w, i);
			break;
		default:
			i = step2(n, w, i);
		}
	}
}

/* --- points in, rows out -------------------------------------------------- */

INLINE struct vec load_points(const float *p)
{
#if NATIVE_KIND == 512
	const whole at = {0, 3, 6, 9, 12, 15, 18, 21, 24, 27, 30, 33, 36, 39,
		42, 45};

	return vec(gather(p, at), gather(p + 1, at), gather(p + 2, at));
#else
	float x[LANES], y[LANES], z[LANES];

	for (int l = 0; l < LANES; l++) {
		x[l] = p[3 * l];
		y[l] = p[3 * l + 1];
		z[l] = p[3 * l + 2];
	}
	return vec(load(x), load(y), load(z));
#endif
}

/* LANES rows of 4 from 4 columns. */
INLINE void store_rows4(const real column[4], float *row)
{
#if NATIVE_KIND == 512
	__m512d a = _mm512_castps_pd(_mm512_unpacklo_ps(column[0], column[1]));
	__m512d b = _mm512_castps_pd(_mm512_unpackhi_ps(column[0], column[1]));
	__m512d c = _mm512_castps_pd(_mm512_unpacklo_ps(column[2], column[3]));
	__m512d d = _mm512_castps_pd(_mm512_unpackhi_ps(column[2], column[3]));
	real t[4] = {_mm512_castpd_ps(_mm512_unpacklo_pd(a, c)),
		_mm512_castpd_ps(_mm512_unpackhi_pd(a, c)),
		_mm512_castpd_ps(_mm512_unpacklo_pd(b, d)),
		_mm512_castpd_ps(_mm512_unpackhi_pd(b, d))};

	for (int k = 0; k < 4; k++) {
		_mm_storeu_ps(row + 4 * k, _mm512_castps512_ps128(t[k]));
		_mm_storeu_ps(row + 4 * (4 + k),
		    _mm512_extractf32x4_ps(t[k], 1));
		_mm_storeu_ps(row + 4 * (8 + k),
		    _mm512_extractf32x4_ps(t[k], 2));
		_mm_storeu_ps(row + 4 * (12 + k),
		    _mm512_extractf32x4_ps(t[k], 3));
	}
#else
	for (int l = 0; l < LANES; l++)
		for (int k = 0; k < 4; k++)
			row[4 * l + k] = column[k][l];
#endif
}

static void store_rows(struct slot *s, unsigned outputs, float *row)
{
	int stride = output_row_floats(outputs), from[JET_FLOATS], count = 0;
	const struct jet zero = {.f = all(0.0f)};

	for (int k = 0; k < JET_FLOATS; k++)
		if (outputs & (k == 0 ? OUTPUT_VALUE : k < 4 ?
		    OUTPUT_GRADIENT : OUTPUT_HESSIAN))
			from[count++] = k;
	for (int b = 0; b < BLOCK; b++, row += LANES * stride) {
		struct jet j = zero;

		if (!(s->live >> b & 1))
			put(s, b, 2, &zero);
		if (outputs == (OUTPUT_VALUE | OUTPUT_GRADIENT)) {
			j = get(s, b, 1);
			store_rows4((const real[]){j.f, j.g.x, j.g.y, j.g.z},
			    row);
			continue;
		}
		for (int l = 0; l < LANES; l++)
			for (int k = 0; k < count; k++)
				row[l * stride + k] =
				    s->c[from[k]][b * LANES + l];
	}
}

static void walk_points(const struct native *n, struct block *w,
    unsigned outputs, const float *points, float *rows)
{
	for (int b = 0; b < BLOCK; b++)
		w->x[b] = w->base[b] = load_points(points + 3 * LANES * b);
	walk_block(n, w, output_order(outputs));
	store_rows(w->stack[0], outputs, rows);
}

static void walk(const struct native *n, const struct native_share *s)
{
	int stride = output_row_floats(s->outputs);
	struct block *w = aligned_alloc(64, sizeof(*w));
	size_t i;

	if (!w)
		abort();
	for (int k = 0; k < TAPE_STACK_MAX; k++)
		w->stack[k] = w->slots + k;
	for (i = s->first; i + POINTS <= s->last; i += POINTS)
		walk_points(n, w, s->outputs, s->points + 3 * i,
		    s->rows + i * (size_t)stride);
	if (i < s->last) {
		float points[3 * POINTS], rows[JET_FLOATS * POINTS];

		for (size_t k = 0; k < POINTS; k++)
			memcpy(points + 3 * k, s->points + 3 * (i + k <
			    s->last ? i + k : s->last - 1), 3 * sizeof(float));
		walk_points(n, w, s->outputs, points, rows);
		memcpy(s->rows + i * (size_t)stride, rows,
		    (s->last - i) * (size_t)stride * sizeof(float));
	}
	free(w);
}

#define STEP ((size_t)RUN * LANES)

/* Whole steps of a straight tape's points. */
static void straight(const struct native *n, const struct native_share *s)
{
	for (size_t i = s->first; i + STEP <= s->last;
	    i += STEP) {
		struct jet sum[RUN] = {0};
		struct vec x[RUN];

		for (int b = 0; b < RUN; b++)
			x[b] = load_points(s->points + 3 * (i +
			    (size_t)b * LANES));
		for (size_t k = 0; k < n->ball_count; k++) {
			add_ball(n->balls + k, x, sum, RUN, 1);
		}
		for (int b = 0; b < RUN; b++)
			store_rows4((const real[]){sum[b].f, sum[b].g.x,
			    sum[b].g.y, sum[b].g.z}, s->rows + 4 * (i +
			    (size_t)b * LANES));
	}
}
