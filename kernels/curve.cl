/*
 * Curves sampled at regular nodes (core/curve.h), and by them openings: theta
 * at the cosine of the angle between two gradients.
 */

/*
 * The first floats of nodes i and i + 1 of every lane's cell: a and b, each of
 * count <= CURVE_NODE.
 */
static inline void curve_cell(__global const float *samples, mask i,
    int count, real a[4], real b[4])
{
#if WIDTH == 1
	float8 pair = vload8(0, samples + i * CURVE_NODE);

	vstore4(pair.lo, 0, a);
	vstore4(pair.hi, 0, b);
#elif defined(HAS_AVX512)
	mask at = i * CURVE_NODE;

	a[0] = lanes_gather(samples, at);
	a[1] = lanes_gather(samples + 1, at);
	b[0] = lanes_gather(samples + CURVE_NODE, at);
	b[1] = lanes_gather(samples + CURVE_NODE + 1, at);
	if (count > 2) {
		a[2] = lanes_gather(samples + 2, at);
		b[2] = lanes_gather(samples + CURVE_NODE + 2, at);
	}
#else
	int cell[WIDTH];
	float node[2 * CURVE_NODE][WIDTH];

	STORE(i, 0, cell);
	for (int l = 0; l < WIDTH; l++)
		for (int k = 0; k < 2 * CURVE_NODE; k++)
			node[k][l] = samples[cell[l] * CURVE_NODE + k];
	for (int k = 0; k < count; k++) {
		a[k] = LOAD(0, node[k]);
		b[k] = LOAD(0, node[k + CURVE_NODE]);
	}
#endif
}

/* The third floats of these nodes. */
static inline void curve_bends(__global const float *samples, mask i, real *a,
    real *b)
{
#if WIDTH == 1
	*a = samples[i * CURVE_NODE + 2];
	*b = samples[(i + 1) * CURVE_NODE + 2];
#elif defined(HAS_AVX512)
	*a = lanes_gather(samples + 2, i * CURVE_NODE);
	*b = lanes_gather(samples + CURVE_NODE + 2, i * CURVE_NODE);
#else
	int cell[WIDTH];
	float left[WIDTH], right[WIDTH];

	STORE(i, 0, cell);
	for (int l = 0; l < WIDTH; l++) {
		left[l] = samples[cell[l] * CURVE_NODE + 2];
		right[l] = samples[(cell[l] + 1) * CURVE_NODE + 2];
	}
	*a = LOAD(0, left);
	*b = LOAD(0, right);
#endif
}

/* The cubic on [0, 1] with values a, b and slopes a1, b1 at its ends. */
static inline real curve_hermite(real a, real b, real a1, real b1, real x)
{
	real rise = b - a, s = 1.0f - x;

	return a + x * (rise + s * (s * (a1 - rise) - x * (b1 - rise)));
}

/* The cell of x in [0, 1], clamped, and where in it. */
static inline mask curve_place(uint count, real x, real *t)
{
	float steps = (float)(count - 1u);
	real u = real_clamp(x, REAL(0.0f), REAL(1.0f)) * steps;
	mask i = TO_INT(real_min(u, REAL(steps - 1.0f)));

	*t = u - TO_REAL(i);
	return i;
}

/*
 * Value and two derivatives at x in [0, 1], clamped, of a curve of count nodes
 * over an interval of the given length, as core/curve.c has them in float64.
 */
static inline void curve_lookup(__global const float *samples, uint count,
    float length, real x, real out[3])
{
	float step = length / (float)(count - 1u);
	real t, a[4], b[4];
	mask i = curve_place(count, x, &t);

	curve_cell(samples, i, 3, a, b);
	out[0] = curve_hermite(a[0], b[0], step * a[1], step * b[1], t);
	out[1] = curve_hermite(a[1], b[1], step * a[2], step * b[2], t);
	out[2] = a[2] + t * (b[2] - a[2]);
}

/* The value alone. */
static inline real curve_value(__global const float *samples, uint count,
    float length, real x)
{
	float step = length / (float)(count - 1u);
	real t, a[4], b[4];
	mask i = curve_place(count, x, &t);

	curve_cell(samples, i, 2, a, b);
	return curve_hermite(a[0], b[0], step * a[1], step * b[1], t);
}

/* A cell of an opening, as far as theta needs it. */
struct opening_cell {
	mask i;
	real t, a1, b1;
};

/* Of an opening: theta at the cosine c of alpha, in [-1, 1]. */
static inline real opening_theta(__global const float *openings,
    __global const struct operator_desc *desc, real c,
    struct opening_cell *cell)
{
	float step = 2.0f / (float)(desc->opening_count - 1u);
	real a[4], b[4];

	cell->i = curve_place(desc->opening_count, 0.5f * (c + 1.0f),
	    &cell->t);
	curve_cell(openings + desc->opening, cell->i, 2, a, b);
	cell->a1 = a[1];
	cell->b1 = b[1];
	/* Between nodes on either side of a steep rise the cubic overshoots. */
	return real_clamp(curve_hermite(a[0], b[0], step * a[1], step * b[1],
	    cell->t), REAL(0.0f), REAL(0.785398163f));
}

/* There, slope = d theta / d c and bend = d2 theta / d c2. */
static inline void opening_slope(__global const float *openings,
    __global const struct operator_desc *desc,
    const struct opening_cell *cell, real *slope, real *bend)
{
	float step = 2.0f / (float)(desc->opening_count - 1u);
	real a2, b2;

	curve_bends(openings + desc->opening, cell->i, &a2, &b2);
	*slope = curve_hermite(cell->a1, cell->b1, step * a2, step * b2,
	    cell->t);
	*bend = a2 + cell->t * (b2 - a2);
}
