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

/* WIDTH points, stored one after the other. */
static inline struct vec3r load_points(__global const float *points)
{
#if WIDTH == 1
	return vec3r_load(points);
#else
	float x[WIDTH], y[WIDTH], z[WIDTH];

	for (int l = 0; l < WIDTH; l++) {
		x[l] = points[3 * l];
		y[l] = points[3 * l + 1];
		z[l] = points[3 * l + 2];
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

/* Writes the columns of WIDTH rows. */
static inline void store_columns(const real *column, int count,
    __global float *row)
{
#if WIDTH == 1
	for (int k = 0; k < count; k++)
		row[k] = finite(column[k]);
#else
	float lane[OUTPUT_ROW_MAX][WIDTH];

	for (int k = 0; k < count; k++)
		STORE(finite(column[k]), 0, lane[k]);
	for (int l = 0; l < WIDTH; l++)
		for (int k = 0; k < count; k++)
			*row++ = lane[k][l];
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
    uint outputs, __global float *row)
{
	real column[OUTPUT_ROW_MAX];
	int count = 0;

	if (outputs == (OUTPUT_VALUE | OUTPUT_GRADIENT)) {
		/* The commonest, so that the counts are constants. */
		column[0] = f->value;
		put_vector(f->gradient, column + 1);
		store_columns(column, 4, row);
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
	store_columns(column, count, row);
}

/*
 * Whether instruction i < last pushes a point of exponent 3 that the next one
 * adds, up to gradients.
 */
static inline int adds_point(__global const struct insn *insns, uint i,
    uint last, __global const float *params, int order)
{
	return i < last && insns[i].op == OP_POINT && order < 2 &&
	    insns[i + 1].op == OP_SUM && params[insns[i].param + 4] == 3.0f;
}

/* Both instructions in one, without a stop in memory. */
static inline void add_point(__global const float *p, struct vec3r x,
    int order, struct jetr *sum)
{
	struct jetr f;

	point_cubic(p, x, order, &f);
	compose_sum(sum, &f, order);
}

/*
 * Every work-item evaluates BLOCK times WIDTH points, so that the instructions'
 * decoding is shared and independent arithmetic overlaps. The host pads points
 * and rows to whole work-groups, and has checked the tape: nothing here does.
 * Colours are mixed where they are asked for only.
 */
__kernel void evaluate(TABLE_ARGS, __global const float *openings,
    __global const struct operator_desc *descs,
    __global const struct insn *insns, uint insn_count,
    __global const float *params, __global const float *volumes,
    __global const uint *volume_firsts, uint outputs,
    __global const float *points, __global float *rows)
{
	size_t first = get_global_id(0) * (BLOCK * WIDTH);
	uint stride = (uint)output_row_floats(outputs);
	int root_order = output_order(outputs);
	int colored = WHOLE && (outputs & OUTPUT_COLOR) != 0;
	struct vec3r bases[BLOCK][TAPE_WARPS_MAX + 1], x[BLOCK];
	struct jetr stack[BLOCK][TAPE_STACK_MAX];
	struct vec3r colors[BLOCK][TAPE_STACK_MAX];
	struct vec3r color = vec3r(REAL(COLOR_DEFAULT), REAL(COLOR_DEFAULT),
	    REAL(COLOR_DEFAULT));
	uint top = 0, base = 0;

	for (int b = 0; b < BLOCK; b++) {
		bases[b][0] = draw_in(load_points(points +
		    (first + b * WIDTH) * 3));
		x[b] = bases[b][0];
	}
	for (uint i = 0; i < insn_count; i++) {
		struct insn insn = insns[i];
		__global const float *p = params + insn.param;
		int order = min(root_order + (int)insn.extra, 2);

		for (int b = 0; b < BLOCK && colored && insn.op >= OP_MAX; b++)
			compose_colors(insn.op, p, &stack[b][top - 2],
			    &stack[b][top - 1], &colors[b][top - 2],
			    &colors[b][top - 1]);
		if (!colored &&
		    adds_point(insns, i, insn_count - 1, params, order)) {
			for (int b = 0; b < BLOCK && order == 0; b++)
				add_point(p, x[b], 0, &stack[b][top - 1]);
			for (int b = 0; b < BLOCK && order == 1; b++)
				add_point(p, x[b], 1, &stack[b][top - 1]);
			i++;
		} else if (insn.op == OP_FRAME) {
			for (int b = 0; b < BLOCK; b++)
				x[b] = enter_frame(p,
				    bases[b][WHOLE ? base : 0]);
		} else if (insn.op == OP_CARRY) {
			for (int b = 0; b < BLOCK; b++)
				carry(p, &stack[b][top - 1], order);
		} else if (insn.op == OP_COLOR) {
			color = vec3r_load(p);
		} else if (WHOLE && insn.op == OP_ENTER) {
			for (int b = 0; b < BLOCK; b++)
				bases[b][base + 1] = enter_warp(insn.index, p,
				    bases[b][base]);
			base++;
		} else if (WHOLE && insn.op == OP_LEAVE) {
			base--;
			for (int b = 0; b < BLOCK; b++)
				leave_warp(insn.index, p, bases[b][base],
				    &stack[b][top - 1], order);
		} else if (insn.op < OP_MAX) {
			for (int b = 0; b < BLOCK; b++)
				if (WHOLE && insn.op == OP_VOLUME)
					volume_eval(volumes +
					    volume_firsts[insn.index], p, x[b],
					    order, &stack[b][top]);
				else if (WHOLE && insn.op >= OP_CAUCHY_POINT)
					convolution_eval(insn.op, p, x[b],
					    order, &stack[b][top]);
				else
					primitive_eval(insn.op, p, x[b], order,
					    &stack[b][top]);
			for (int b = 0; b < BLOCK && colored; b++)
				colors[b][top] = color;
			top++;
		} else if (insn.op < OP_CLASSIC) {
			top--;
			for (int b = 0; b < BLOCK; b++)
				compose_plain(insn.op, p[0],
				    &stack[b][top - 1], &stack[b][top], order);
		} else if (WHOLE && insn.op < OP_UNION) {
			top--;
			for (int b = 0; b < BLOCK; b++)
				compose_classic(insn.op, insn.index, p,
				    &stack[b][top - 1], &stack[b][top], order);
		} else {
			top--;
			for (int b = 0; b < BLOCK; b++)
				compose_blend(TABLE_PASS, openings,
				    descs + insn.index, insn.op, p[0],
				    &stack[b][top - 1], &stack[b][top], order);
		}
	}
	for (int b = 0; b < BLOCK; b++)
		store_rows(&stack[b][0], &colors[b][0], outputs, rows +
		    (first + b * WIDTH) * stride);
}
