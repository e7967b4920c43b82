/*
 * The interpreter: walks a tape (core/opcode.h) at BLOCK times WIDTH points a
 * work-item.
 */
#ifndef BLOCK
#define BLOCK 1
#endif

/*
 * Whether there may be warps, volumes, convolutions, classic operators, or
 * colours asked for. Without these the compiler keeps more in registers: three
 * blended segments take 0.75 of the time, mixed trees 0.8 to 1.
 */
#ifndef WHOLE
#define WHOLE 1
#endif

/* TREE_COLOR_DEFAULT: what primitives have before any OP_COLOR. */
#define COLOR_DEFAULT 0.8f

/*
 * p, or if it is out of reach the point on its ray that is not. POINT_REACH
 * says why.
 */
static inline struct vec3r draw_in(struct vec3r p)
{
	real far = real_max(fabs(p.x), real_max(fabs(p.y), fabs(p.z)));
	mask beyond = far > POINT_REACH;
	struct vec3r ray;

	if (!ANY(beyond))
		return p;
	ray = vec3r(POINT_REACH * (p.x / far), POINT_REACH * (p.y / far),
	    POINT_REACH * (p.z / far));
	return vec3r_select(p, ray, beyond);
}

static inline struct vec3r enter_frame(__global const float *m,
    struct vec3r p)
{
	return draw_in(vec3r(m[0] * p.x + m[1] * p.y + m[2] * p.z + m[9],
	    m[3] * p.x + m[4] * p.y + m[5] * p.z + m[10],
	    m[6] * p.x + m[7] * p.y + m[8] * p.z + m[11]));
}

/* a^T v */
static inline struct vec3r pull_vector(__global const float *a, struct vec3r v)
{
	return vec3r(a[0] * v.x + a[3] * v.y + a[6] * v.z,
	    a[1] * v.x + a[4] * v.y + a[7] * v.z,
	    a[2] * v.x + a[5] * v.y + a[8] * v.z);
}

/* a^T g and a^T H a */
static void carry(__global const float *a, struct jetr *f, int order)
{
	jetr_limit(f, order);
	if (order >= 1)
		f->gradient = pull_vector(a, f->gradient);
	if (order >= 2) {
		struct sym3r h = f->hessian;
		/* the rows of a^T H, H's rows being its columns */
		struct vec3r x = pull_vector(a, vec3r(h.xx, h.xy, h.xz));
		struct vec3r y = pull_vector(a, vec3r(h.xy, h.yy, h.yz));
		struct vec3r z = pull_vector(a, vec3r(h.xz, h.yz, h.zz));
		struct vec3r p = pull_vector(a, vec3r(x.x, y.x, z.x));
		struct vec3r q = pull_vector(a, vec3r(x.y, y.y, z.y));
		struct vec3r r = pull_vector(a, vec3r(x.z, y.z, z.z));

		f->hessian = sym3r(p.x, q.y, r.z, p.y, p.z, q.z);
	}
	jetr_limit(f, order);
}

/* The base that a warp's child sees: W(A b + t). */
static struct vec3r enter_warp(uint type, __global const float *p,
    struct vec3r base)
{
	return draw_in(warp_point(type, p + 12, enter_frame(p, base)));
}

/* f, of the base within a warp, to the frame of its node. */
static void leave_warp(uint type, __global const float *p, struct vec3r base,
    struct jetr *f, int order)
{
	if (order == 0)
		return;
	jetr_limit(f, order);
	warp_carry(type, p + 12, enter_frame(p, base), f, order);
	jetr_limit(f, order);
}

/* An element of a convolution surface. */
static void convolution_eval(uint op, __global const float *p, struct vec3r x,
    int order, struct jetr *out)
{
	switch (op) {
	case OP_CAUCHY_POINT:
		cauchy_point(p, x, order, out);
		break;
	case OP_CAUCHY_SEGMENT:
		cauchy_segment(p, x, order, out);
		break;
	default:
		cauchy_triangle(p, x, order, out);
		break;
	}
}

/* The arithmetic compositions. */
static void compose_plain(uint op, float n, struct jetr *a, struct jetr *b,
    int order)
{
	switch (op) {
	case OP_MAX:
		compose_max(a, b, order);
		break;
	case OP_MIN:
		compose_min(a, b, order);
		break;
	case OP_MINUS:
		compose_complement(b, order);
		compose_min(a, b, order);
		break;
	case OP_MINUS_SWAPPED:
		compose_complement(a, order);
		compose_min(b, a, order);
		*a = *b;
		break;
	case OP_SUM:
		compose_sum(a, b, order);
		break;
	case OP_RICCI:
		compose_ricci(a, b, n, order);
		break;
	}
}

/* WIDTH points of indices `order`. */
static inline struct vec3r load_points(__global const float *points,
    __global const uint *order)
{
#if WIDTH == 1
	return vec3r_load(points + 3 * (size_t)order[0]);
#else
	float x[WIDTH], y[WIDTH], z[WIDTH];

#if WIDTH == 16
	/* One after the other, as mostly: three loads, and two shuffles each. */
	const int16 places = (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12,
	    13, 14, 15);
	__global const float *first = points + 3 * (size_t)order[0];

	if (ALL(convert_int16(vload16(0, order) - order[0]) == places)) {
		float16 a = vload16(0, first), b = vload16(1, first);
		float16 c = vload16(2, first);

		return vec3r((float16)(a.s0369, a.scf, b.s258b, b.se, c.s147a,
		    c.sd), (float16)(a.s147a, a.sd, b.s0369, b.scf, c.s258b,
		    c.se), (float16)(a.s258b, a.se, b.s147a, b.sd, c.s0369,
		    c.scf));
	}
#endif
	for (int l = 0; l < WIDTH; l++) {
		__global const float *p = points + 3 * (size_t)order[l];

		x[l] = p[0];
		y[l] = p[1];
		z[l] = p[2];
	}
	return vec3r(LOAD(0, x), LOAD(0, y), LOAD(0, z));
#endif
}

/*
 * Every number written is finite, by a last clamp to +-FLT_MAX. The limits of
 * jets leave it little to do: Hessians of models at scales near 1e-9, with a
 * bulge's fold, may reach it. Nor is any number -0, whose sign could tell which
 * points shared a work-item.
 */
static inline real finite(real x)
{
	return real_clamp(x, REAL(-FLT_MAX), REAL(FLT_MAX)) + 0.0f;
}

/* Writes the columns of WIDTH rows to their places. */
static inline void store_columns(const real *column, int count,
    __global const uint *order, __global float *rows)
{
#if WIDTH == 1
	for (int k = 0; k < count; k++)
		rows[(size_t)order[0] * count + k] = finite(column[k]);
#else
	float lane[OUTPUT_ROW_MAX][WIDTH];

	for (int k = 0; k < count; k++)
		STORE(finite(column[k]), 0, lane[k]);
	for (int l = 0; l < WIDTH; l++) {
		__global float *row = rows + (size_t)order[l] * count;

		for (int k = 0; k < count; k++)
			row[k] = lane[k][l];
	}
#endif
}

#if WIDTH == 16
/* The first two, the last two of every four lanes of a and of b in turn. */
#define ZIP_FIRST(a, b) ((float16)(a.s0, b.s0, a.s1, b.s1, a.s4, b.s4, a.s5, \
	b.s5, a.s8, b.s8, a.s9, b.s9, a.sc, b.sc, a.sd, b.sd))
#define ZIP_LAST(a, b) ((float16)(a.s2, b.s2, a.s3, b.s3, a.s6, b.s6, a.s7, \
	b.s7, a.sa, b.sa, a.sb, b.sb, a.se, b.se, a.sf, b.sf))

/* Rows `first` + 0, 4, 8 and 12 of WIDTH. */
static inline void store_quarter(float16 four, __global const uint *order,
    __global float *rows)
{
	vstore4(four.s0123, order[0], rows);
	vstore4(four.s4567, order[4], rows);
	vstore4(four.s89ab, order[8], rows);
	vstore4(four.scdef, order[12], rows);
}
#endif

/* The commonest rows, value and gradient. */
static inline void store_gradient_rows(const struct jetr *f,
    __global const uint *order, __global float *rows)
{
	real v = finite(f->value), x = finite(f->gradient.x);
	real y = finite(f->gradient.y), z = finite(f->gradient.z);
#if WIDTH == 16
	float16 a = ZIP_FIRST(v, y), b = ZIP_FIRST(x, z);
	float16 c = ZIP_LAST(v, y), d = ZIP_LAST(x, z);

	store_quarter(ZIP_FIRST(a, b), order, rows);
	store_quarter(ZIP_LAST(a, b), order + 1, rows);
	store_quarter(ZIP_FIRST(c, d), order + 2, rows);
	store_quarter(ZIP_LAST(c, d), order + 3, rows);
#else
	const real column[4] = {v, x, y, z};

	store_columns(column, 4, order, rows);
#endif
}

static inline int put_vector(struct vec3r v, real *column)
{
	column[0] = v.x;
	column[1] = v.y;
	column[2] = v.z;
	return 3;
}

static inline int put_hessian(const struct sym3r *h, real *column)
{
	column[0] = h->xx;
	column[1] = h->yy;
	column[2] = h->zz;
	column[3] = h->xy;
	column[4] = h->xz;
	column[5] = h->yz;
	return 6;
}

/* Normal and curvature, of the jet's products: within limits. Their count. */
static int put_surface(struct jetr f, uint outputs, real *column)
{
	int count = 0;

	jetr_limit(&f, output_order(outputs));
	if (outputs & OUTPUT_NORMAL)
		count += put_vector(surface_normal(&f), column);
	if (outputs & OUTPUT_CURVATURE) {
		surface_curvature(&f, column + count, column + count + 1);
		count += 2;
	}
	return count;
}

/* color is read if it is asked for; rounding may have left it over 1. */
static inline void store_rows(const struct jetr *f, const struct vec3r *color,
    uint outputs, __global const uint *order, __global float *rows)
{
	real column[OUTPUT_ROW_MAX];
	int count = 0;

	if (outputs == (OUTPUT_VALUE | OUTPUT_GRADIENT)) {
		store_gradient_rows(f, order, rows);
		return;
	}
	if (outputs & OUTPUT_VALUE)
		column[count++] = f->value;
	if (outputs & OUTPUT_GRADIENT)
		count += put_vector(f->gradient, column + count);
	if (outputs & OUTPUT_HESSIAN)
		count += put_hessian(&f->hessian, column + count);
	if (outputs & OUTPUT_COLOR)
		count += put_vector(vec3r_limit(*color, 1.0f), column + count);
	if (outputs & (OUTPUT_NORMAL | OUTPUT_CURVATURE))
		count += put_surface(*f, outputs, column + count);
	store_columns(column, count, order, rows);
}

/*
 * Adds a point of exponent 3 to sum: f = w b^3, b = 1 - d^2/R^2, which is
 * returned. What b = 0 multiplies is finite in this order of evaluation,
 * however far the point. Value and gradient are rounded once (FUSED_ADD), as
 * they are when added to 0, so that a point is the same bits whether it is
 * pushed or what it is added to is 0.
 */
static inline real cubic_add(__global const float *p, struct vec3r x,
    int order, struct jetr *sum)
{
	struct vec3r e = vec3r_sub(x, vec3r_load(p));
	float inv_r2 = p[3], weight = p[5], slope = -6.0f * inv_r2 * weight;
	real b = real_max(1.0f - vec3r_dot(e, e) * inv_r2, REAL(0.0f));
	real bb = b * b;
	real f1 = slope * bb;

	sum->value = FUSED_ADD(weight * b, bb, sum->value);
	if (order >= 1)
		sum->gradient = vec3r(FUSED_ADD(f1, e.x, sum->gradient.x),
		    FUSED_ADD(f1, e.y, sum->gradient.y),
		    FUSED_ADD(f1, e.z, sum->gradient.z));
	if (order >= 2) {
		/* H = -6 w b^2/R^2 I + 24 w b/R^4 e e^T */
		struct vec3r t = vec3r_scale(REAL(sqrt(inv_r2)), e);
		struct vec3r k = vec3r_scale(24.0f * inv_r2 * weight * b, t);
		struct sym3r h = sym3r(f1 + k.x * t.x, f1 + k.y * t.y,
		    f1 + k.z * t.z, k.x * t.y, k.x * t.z, k.y * t.z);

		sum->hessian = sym3r_axpy(REAL(1.0f), h, sum->hessian);
	}
	return b;
}

/* Vectors of points whose sums are kept in registers together. */
#if BLOCK % 2 == 0
#define RUN 2
#else
#define RUN 1
#endif

/*
 * Of a jet BLOCK vectors deep, bit b: vector b is not 0 in all lanes. Where it
 * is, the jet is neither written nor read.
 */
#define ALL_LIVE ((1u << BLOCK) - 1u)

static inline int is_live(uint live, int b)
{
	return (int)(live >> b & 1u);
}

/* A vector's value. */
static inline real value_of(struct jetr *const *stack, const uint *live,
    uint at, int b)
{
	return is_live(live[at], b) ? stack[at][b].value : REAL(0.0f);
}

/* Makes a jet of which not all is live readable. */
static inline void revive(struct jetr *f, uint live, int order)
{
	for (int b = 0; b < BLOCK && live != ALL_LIVE; b++)
		if (!is_live(live, b))
			compose_zero(&f[b], order);
}

/*
 * Adds the points of `pairs` OP_POINT and OP_SUM in a row to BLOCK sums. order
 * is a constant where this is inlined.
 */
static inline void add_run(__global const struct insn *insns, uint pairs,
    __global const float *params, const struct vec3r *x, int order,
    struct jetr *sums)
{
	for (int b = 0; b < BLOCK; b += RUN) {
		struct vec3r x0 = x[b], x1 = x[b + RUN - 1];
		struct jetr s0 = sums[b], s1 = sums[b + RUN - 1];

		for (uint k = 0; k < pairs; k++) {
			__global const float *p = params + insns[2 * k].param;

			cubic_add(p, x0, order, &s0);
			if (RUN > 1)
				cubic_add(p, x1, order, &s1);
		}
		if (RUN > 1)
			sums[b + RUN - 1] = s1;
		sums[b] = s0;
	}
}

static void add_points(__global const struct insn *insns, uint pairs,
    __global const float *params, const struct vec3r *x, int order,
    struct jetr *sums)
{
	if (order == 0)
		add_run(insns, pairs, params, x, 0, sums);
	else if (order == 1)
		add_run(insns, pairs, params, x, 1, sums);
	else
		add_run(insns, pairs, params, x, 2, sums);
}

static inline uint push_points(__global const float *p, const struct vec3r *x,
    int order, struct jetr *out)
{
	uint live = 0u;

	for (int b = 0; b < BLOCK; b++) {
		struct jetr f;

		compose_zero(&f, order);
		if (!ANY(cubic_add(p, x[b], order, &f) > REAL(0.0f)))
			continue;
		live |= 1u << b;
		compose_copy(&out[b], &f, order);
	}
	return live;
}

static uint cubic_push(__global const float *p, const struct vec3r *x,
    int order, struct jetr *out)
{
	if (order == 0)
		return push_points(p, x, 0, out);
	if (order == 1)
		return push_points(p, x, 1, out);
	return push_points(p, x, 2, out);
}

/* Mixes the colours that add_points' sums will have into theirs. */
static void color_points(__global const struct insn *insns, uint pairs,
    __global const float *params, const struct vec3r *x, struct vec3r color,
    const struct jetr *sums, struct vec3r *colors)
{
	for (int b = 0; b < BLOCK; b++) {
		struct jetr sum = sums[b];

		for (uint k = 0; k < pairs; k++) {
			__global const float *p = params + insns[2 * k].param;
			struct jetr f = {.value = REAL(0.0f)};

			cubic_add(p, x[b], 0, &f);
			compose_colors(OP_SUM, p, sum.value, f.value,
			    &colors[b], &color);
			compose_sum(&sum, &f, 0);
		}
	}
}

#if WIDTH > 1 && BLOCK > 1
#define HAS_PACKS 1

#define JET_REALS 10

/* A component of WIDTH lanes of a jet BLOCK vectors deep. */
static inline real pack(const real *component, const int *at)
{
	return lanes_pack((const float *)component, at);
}

static inline void unpack(real *component, const int *at, uint bits, real x)
{
	lanes_unpack((float *)component, at, bits, x);
}

static inline void pack_first(const struct jetr *f, const int *at, int order,
    struct jetr *out)
{
	out->value = pack(&f->value, at);
	if (order >= 1)
		out->gradient = vec3r(pack(&f->gradient.x, at),
		    pack(&f->gradient.y, at), pack(&f->gradient.z, at));
}

static inline void pack_hessian(const struct jetr *f, const int *at,
    struct jetr *out)
{
	out->hessian = sym3r(pack(&f->hessian.xx, at),
	    pack(&f->hessian.yy, at), pack(&f->hessian.zz, at),
	    pack(&f->hessian.xy, at), pack(&f->hessian.xz, at),
	    pack(&f->hessian.yz, at));
}

static inline void unpack_jet(struct jetr *f, const int *at, uint bits,
    int order, const struct jetr *from)
{
	unpack(&f->value, at, bits, from->value);
	if (order >= 1) {
		unpack(&f->gradient.x, at, bits, from->gradient.x);
		unpack(&f->gradient.y, at, bits, from->gradient.y);
		unpack(&f->gradient.z, at, bits, from->gradient.z);
	}
	if (order >= 2) {
		unpack(&f->hessian.xx, at, bits, from->hessian.xx);
		unpack(&f->hessian.yy, at, bits, from->hessian.yy);
		unpack(&f->hessian.zz, at, bits, from->hessian.zz);
		unpack(&f->hessian.xy, at, bits, from->hessian.xy);
		unpack(&f->hessian.xz, at, bits, from->hessian.xz);
		unpack(&f->hessian.yz, at, bits, from->hessian.yz);
	}
}

/* Lanes of several vectors where two fields are over 0. */
struct packed {
	int at[(BLOCK + 1) * WIDTH]; /* floats from a jet's first */
	int count, vectors;          /* lanes; vectors that have some */
};

/* both: of the vectors that are live in f and in g. */
static inline void find_packed(uint both, const struct jetr *f,
    const struct jetr *g, struct packed *out)
{
	const real zero = REAL(0.0f);

	out->count = out->vectors = 0;
	for (int b = 0; b < BLOCK; b++) {
		uint bits;

		if (!is_live(both, b))
			continue;
		bits = lanes_bits((f[b].value > zero) & (g[b].value > zero));
		out->vectors += bits != 0u;
		out->count += lanes_list(bits, b * JET_REALS * WIDTH,
		    out->at + out->count);
	}
}

/*
 * A union of which the lanes that may blend fit into one vector, although they
 * lie in several: what is to be known of them is found out once. Of 16 random
 * lanes 1.3 are like that, where any is.
 */
static void unite_packed(TABLE_ARGS, __global const float *openings,
    __global const struct operator_desc *desc, float null_gradient,
    struct packed *lanes, uint first, uint second, int order, struct jetr *f,
    struct jetr *g)
{
	struct blend blend;
	uint bits = 0u;

	for (int l = lanes->count; l < WIDTH; l++)
		lanes->at[l] = lanes->at[lanes->count - 1];
	pack_first(f, lanes->at, compose_first_order(desc, order), &blend.a);
	pack_first(g, lanes->at, compose_first_order(desc, order), &blend.b);
	if (compose_meets(curves, openings, desc, null_gradient, INT(-1),
	    order, &blend)) {
		bits = lanes_bits(blend.region.blend) &
		    (0xffffffffu >> (32 - lanes->count));
		if (compose_order(desc, order) >= 2) {
			pack_hessian(f, lanes->at, &blend.a);
			pack_hessian(g, lanes->at, &blend.b);
		}
		compose_blended(TABLE_PASS, openings, desc, order, &blend);
	}
	for (int b = 0; b < BLOCK; b++)
		if (!is_live(second, b))
			continue;
		else if (!is_live(first, b))
			compose_copy(&f[b], &g[b], order);
		else
			compose_max(&f[b], &g[b], order);
	if (bits != 0u)
		unpack_jet(f, lanes->at, bits, order, &blend.a);
}
#endif

/* One vector of a primitive; whether it was written. */
static inline int push(uint op, uint index, __global const float *p,
    __global const float *volumes, __global const uint *volume_firsts,
    struct vec3r x, int order, struct jetr *out)
{
	if (WHOLE && op == OP_VOLUME) {
		volume_eval(volumes + volume_firsts[index], p, x, order, out);
		return 1;
	}
	if (WHOLE && op >= OP_CAUCHY_POINT && op != OP_ZERO) {
		convolution_eval(op, p, x, order, out);
		return 1;
	}
	return primitive_eval(op, p, x, order, out);
}

/* Compositions that are the other operand where one is 0. */
static inline int is_join(uint op)
{
	return op == OP_SUM || op == OP_UNION || op == OP_RICCI ||
	    op == OP_MAX;
}

/* Which vectors may not be 0 of those that have an operand of 0: a difference
 * is not where only what it takes away is. */
static inline uint live_after(uint op, uint first, uint second)
{
	if (op == OP_MINUS || op == OP_DIFFERENCE)
		return first;
	if (op == OP_MINUS_SWAPPED || op == OP_DIFFERENCE_SWAPPED)
		return second;
	return first & second;
}

/* One vector of a composition; whether anything is left of it. */
static inline int compose(TABLE_ARGS, __global const float *openings,
    __global const struct operator_desc *descs, struct insn insn,
    __global const float *p, int order, struct jetr *a, struct jetr *b)
{
	if (insn.op < OP_CLASSIC)
		compose_plain(insn.op, p[0], a, b, order);
	else if (WHOLE && insn.op < OP_UNION)
		compose_classic(insn.op, insn.index, p, a, b, order);
	else
		return compose_blend(TABLE_PASS, openings,
		    descs + insn.index, insn.op, p[0], a, b, order);
	return 1;
}

/*
 * Every work-item evaluates BLOCK times WIDTH points, so that the instructions'
 * decoding is shared and independent arithmetic overlaps: TILE_POINTS places of
 * `order` are a tile, which a work-item or a work-group has to itself, and walk
 * the tile's own instructions or the whole tape. The host pads order to whole
 * work-groups by repeating an index, and has checked the tape: nothing here
 * does. Colours are mixed where they are asked for only.
 */
__kernel void evaluate(TABLE_ARGS, __global const float *openings,
    __global const struct operator_desc *descs,
    __global const struct insn *insns, uint insn_count,
    __global const float *params, __global const float *volumes,
    __global const uint *volume_firsts, uint outputs,
    __global const struct tile *tiles,
    __global const struct insn *tile_insns, __global const uint *order,
    __global const float *points, __global float *rows)
{
	size_t first = get_global_id(0) * (BLOCK * WIDTH);
	struct tile tile = tiles[first / TILE_POINTS];
	int root_order = output_order(outputs);
	int colored = WHOLE && (outputs & OUTPUT_COLOR) != 0;
	struct vec3r bases[TAPE_WARPS_MAX + 1][BLOCK], x[BLOCK];
	struct jetr jets[TAPE_STACK_MAX][BLOCK];
	struct jetr *stack[TAPE_STACK_MAX]; /* what is beyond top is spare */
	uint live[TAPE_STACK_MAX];
	struct vec3r colors[TAPE_STACK_MAX][BLOCK];
	struct vec3r color = vec3r(REAL(COLOR_DEFAULT), REAL(COLOR_DEFAULT),
	    REAL(COLOR_DEFAULT));
	uint top = 0, base = 0;

	order += first;
	if (tile.count > 0) {
		insns = tile_insns + tile.first;
		insn_count = tile.count;
	}
	for (int k = 0; k < TAPE_STACK_MAX; k++)
		stack[k] = jets[k];
	for (int b = 0; b < BLOCK; b++) {
		x[b] = draw_in(load_points(points, order + b * WIDTH));
		bases[0][b] = x[b];
	}
	for (uint i = 0; i < insn_count; i++) {
		struct insn insn = insns[i];
		__global const float *p = params + insn.param;
		int deep = min(root_order + (int)insn.extra, 2);

		if (colored && insn.op >= OP_MAX)
			for (int b = 0; b < BLOCK; b++)
				compose_colors(insn.op, p,
				    value_of(stack, live, top - 2, b),
				    value_of(stack, live, top - 1, b),
				    &colors[top - 2][b], &colors[top - 1][b]);
		if (insn.op == OP_POINT && insn.index > 0) {
			revive(stack[top - 1], live[top - 1], deep);
			live[top - 1] = ALL_LIVE;
			if (colored)
				color_points(insns + i, insn.index, params, x,
				    color, stack[top - 1], colors[top - 1]);
			add_points(insns + i, insn.index, params, x, deep,
			    stack[top - 1]);
			i += 2 * insn.index - 1;
		} else if (insn.op == OP_FRAME) {
			for (int b = 0; b < BLOCK; b++)
				x[b] = enter_frame(p,
				    bases[WHOLE ? base : 0][b]);
		} else if (insn.op == OP_CARRY) {
			for (int b = 0; b < BLOCK; b++)
				if (is_live(live[top - 1], b))
					carry(p, &stack[top - 1][b], deep);
		} else if (insn.op == OP_COLOR) {
			color = vec3r_load(p);
		} else if (WHOLE && insn.op == OP_ENTER) {
			for (int b = 0; b < BLOCK; b++)
				bases[base + 1][b] = enter_warp(insn.index, p,
				    bases[base][b]);
			base++;
		} else if (WHOLE && insn.op == OP_LEAVE) {
			base--;
			for (int b = 0; b < BLOCK; b++)
				if (is_live(live[top - 1], b))
					leave_warp(insn.index, p,
					    bases[base][b],
					    &stack[top - 1][b], deep);
		} else if (insn.op < OP_MAX) {
			uint some = 0u;

			if (insn.op == OP_POINT && p[4] == 3.0f)
				some = cubic_push(p, x, deep, stack[top]);
			else
				for (int b = 0; b < BLOCK; b++)
					some |= (uint)push(insn.op, insn.index,
					    p, volumes, volume_firsts, x[b],
					    deep, &stack[top][b]) << b;
			live[top] = some;
			for (int b = 0; b < BLOCK && colored; b++)
				colors[top][b] = color;
			top++;
		} else if (is_join(insn.op)) {
			uint first = live[top - 2], second = live[top - 1];
			struct jetr *f = stack[top - 2], *g = stack[top - 1];

			top--;
			live[top - 1] = first | second;
			if (first == 0u) {
				stack[top - 1] = g;
				stack[top] = f;
				continue;
			}
#ifdef HAS_PACKS
			if (insn.op == OP_UNION) {
				struct packed lanes;

				find_packed(first & second, f, g, &lanes);
				if (lanes.vectors > 1 &&
				    lanes.count <= WIDTH) {
					unite_packed(TABLE_PASS, openings,
					    descs + insn.index, p[0], &lanes,
					    first, second, deep, f, g);
					continue;
				}
			}
#endif
			for (int b = 0; b < BLOCK; b++)
				if (!is_live(second, b))
					continue;
				else if (!is_live(first, b))
					compose_copy(&f[b], &g[b], deep);
				else
					compose(TABLE_PASS, openings, descs,
					    insn, p, deep, &f[b], &g[b]);
		} else {
			uint first = live[top - 2], second = live[top - 1];
			struct jetr *f = stack[top - 2], *g = stack[top - 1];
			int most = min(deep + 1, 2);
			uint some = ALL_LIVE;

			top--;
			if (insn.op != OP_CLASSIC &&
			    insn.op != OP_CLASSIC_SWAPPED)
				some = live_after(insn.op, first, second);
			if (some != 0u) {
				revive(f, first, most);
				revive(g, second, most);
			}
			live[top - 1] = 0u;
			for (int b = 0; b < BLOCK; b++)
				if (is_live(some, b))
					live[top - 1] |= (uint)compose(
					    TABLE_PASS, openings, descs, insn,
					    p, deep, &f[b], &g[b]) << b;
		}
	}
	revive(stack[0], live[0], root_order);
	for (int b = 0; b < BLOCK; b++)
		store_rows(&stack[0][b], &colors[0][b], outputs,
		    order + b * WIDTH, rows);
}
