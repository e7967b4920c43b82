/*
 * Curves sampled at regular nodes (core/curve.h), and by them openings: theta
 * at the cosine of the angle between two gradients.
 */

/* Nodes i and i + 1 of every lane's cell: a and b. */
static inline void curve_cell(__global const float *samples, mask i,
    real a[3], real b[3])
{
#if WIDTH == 1
	float8 pair = vload8(0, samples + i * CURVE_NODE);

	a[0] = pair.s0;
	a[1] = pair.s1;
	a[2] = pair.s2;
	b[0] = pair.s4;
	b[1] = pair.s5;
	b[2] = pair.s6;
#else
	int cell[WIDTH];
	float node[6][WIDTH];

	STORE(i, 0, cell);
	for (int l = 0; l < WIDTH; l++) {
		float8 pair = vload8(0,
		    samples + cell[l] * CURVE_NODE);

		node[0][l] = pair.s0;
		node[1][l] = pair.s1;
		node[2][l] = pair.s2;
		node[3][l] = pair.s4;
		node[4][l] = pair.s5;
		node[5][l] = pair.s6;
	}
	for (int k = 0; k < 3; k++) {
		a[k] = LOAD(0, node[k]);
		b[k] = LOAD(0, node[k + 3]);
	}
#endif
}

/* The cubic on [0, 1] with values a, b and slopes a1, b1 at its ends. */
static inline real curve_hermite(real a, real b, real a1, real b1, real x)
{
	real rise = b - a, s = 1.0f - x;

	return a + x * (rise + s * (s * (a1 - rise) - x * (b1 - rise)));
}

/*
 * Value and two derivatives at x in [0, 1], clamped, of a curve of count nodes
 * over an interval of the given length, as core/curve.c has them in float64.
 */
static void curve_lookup(__global const float *samples, uint count,
    float length, real x, real out[3])
{
	float steps = (float)(count - 1u), step = length / steps;
	real u = real_clamp(x, REAL(0.0f), REAL(1.0f)) * steps;
	mask i = TO_INT(real_min(u, REAL(steps - 1.0f)));
	real t = u - TO_REAL(i), a[3], b[3];

	curve_cell(samples, i, a, b);
	out[0] = curve_hermite(a[0], b[0], step * a[1], step * b[1], t);
	out[1] = curve_hermite(a[1], b[1], step * a[2], step * b[2], t);
	out[2] = a[2] + t * (b[2] - a[2]);
}

/*
 * theta, slope = d theta / d c and bend = d2 theta / d c2 at c in [-1, 1], the
 * cosine of alpha.
 */
static void opening_lookup(__global const float *openings,
    __global const struct operator_desc *desc, real c, real *theta,
    real *slope, real *bend)
{
	real at[3];

	curve_lookup(openings + desc->opening, desc->opening_count, 2.0f,
	    0.5f * (c + 1.0f), at);
	/* Between nodes on either side of a steep rise the cubic overshoots. */
	*theta = real_clamp(at[0], REAL(0.0f), REAL(0.785398163f));
	*slope = at[1];
	*bend = at[2];
}
