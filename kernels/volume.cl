/*
 * Sampled fields, as core/volume.c has them in float64: WIDTH points at a
 * time, of which each lane gathers its own 64 coefficients.
 */

/* What a distance's derivatives, in falloffs, are held within, so that the
 * products formed of them do not overflow; 1 and 1/h are sensible. */
#define VOLUME_SLOPE 1e15f
#define VOLUME_BEND 1e30f

/* What four coefficients of an axis, from first on, weigh: in the value, and
 * in its first and second derivatives. */
struct volume_weights {
	real first;
	real w[3][4];
};

/* The uniform cubic B-spline's four pieces at t in [0, 1], with derivatives. */
static void volume_pieces(real t, real w[3][4])
{
	real s = 1.0f - t;

	w[0][0] = s * s * s * (1.0f / 6.0f);
	w[0][1] = (t * t * (3.0f * t - 6.0f) + 4.0f) * (1.0f / 6.0f);
	w[0][2] = (s * s * (3.0f * s - 6.0f) + 4.0f) * (1.0f / 6.0f);
	w[0][3] = t * t * t * (1.0f / 6.0f);
	w[1][0] = -0.5f * s * s;
	w[1][1] = t * (1.5f * t - 2.0f);
	w[1][2] = s * (2.0f - 1.5f * s);
	w[1][3] = 0.5f * t * t;
	w[2][0] = s;
	w[2][1] = 3.0f * t - 2.0f;
	w[2][2] = 3.0f * s - 2.0f;
	w[2][3] = t;
}

/*
 * Moves the weights by shift, from -3 to 3, to the four that are within the
 * grid. Coefficients beyond are 0, or, with natural ends, 2 c_0 - c_1 and
 * 2 c_{n-1} - c_{n-2}.
 */
static void volume_fold(real shift, int natural, real w[4])
{
	real zero = REAL(0.0f), before = zero, after = zero, to[4];

	for (int k = 0; k < 4; k++) {
		to[k] = zero;
		for (int j = 0; j < 4; j++)
			to[k] += SELECT(zero, w[j], shift == (float)(k - j));
	}
	if (natural) {
		before = SELECT(zero, w[0], shift == -1.0f);
		after = SELECT(zero, w[3], shift == 1.0f);
	}
	w[0] = to[0] + 2.0f * before;
	w[1] = to[1] - before;
	w[2] = to[2] - after;
	w[3] = to[3] + 2.0f * after;
}

/* The weights at u, in spacings from the first of n coefficients. */
static void volume_weigh(real u, float inverse, float n, int natural,
    struct volume_weights *out)
{
	real cell = real_min(floor(u), REAL(natural ? n - 2.0f : n));
	real shift;

	out->first = real_clamp(cell - 1.0f, REAL(0.0f), REAL(n - 4.0f));
	shift = cell - 1.0f - out->first;
	volume_pieces(u - cell, out->w);
	if (ANY(shift != 0.0f))
		for (int d = 0; d < 3; d++)
			volume_fold(shift, natural, out->w[d]);
	for (int k = 0; k < 4; k++) {
		out->w[1][k] *= inverse;
		out->w[2][k] *= inverse * inverse;
	}
}

/* Four coefficients of each lane, from c + at on. */
static inline void volume_gather(__global const float *c, const int *at,
    real out[4])
{
#if WIDTH == 1
	float4 four = vload4(0, c + at[0]);

	out[0] = four.x;
	out[1] = four.y;
	out[2] = four.z;
	out[3] = four.w;
#else
	float lane[4][WIDTH];

	for (int l = 0; l < WIDTH; l++) {
		float4 four = vload4(0, c + at[l]);

		lane[0][l] = four.x;
		lane[1][l] = four.y;
		lane[2][l] = four.z;
		lane[3][l] = four.w;
	}
	for (int k = 0; k < 4; k++)
		out[k] = LOAD(0, lane[k]);
#endif
}

static inline real volume_dot(const real w[4], const real c[4])
{
	return w[0] * c[0] + w[1] * c[1] + w[2] * c[2] + w[3] * c[3];
}

/* The spline of one layer of constant x, in y and z. */
static void volume_layer(__global const float *c, const int *at, int row,
    const struct volume_weights *y, const struct volume_weights *z, int order,
    struct jetr *out)
{
	real r[4], a;

	out->value = REAL(0.0f);
	out->gradient = vec3r(REAL(0.0f), REAL(0.0f), REAL(0.0f));
	out->hessian = sym3r_identity(REAL(0.0f));
	for (int j = 0; j < 4; j++) {
		volume_gather(c + j * row, at, r);
		a = volume_dot(z->w[0], r);
		out->value += y->w[0][j] * a;
		if (order < 1)
			continue;
		out->gradient.y += y->w[1][j] * a;
		if (order >= 2)
			out->hessian.yy += y->w[2][j] * a;
		a = volume_dot(z->w[1], r);
		out->gradient.z += y->w[0][j] * a;
		if (order < 2)
			continue;
		out->hessian.yz += y->w[1][j] * a;
		out->hessian.zz += y->w[0][j] * volume_dot(z->w[2], r);
	}
}

/* The spline: layers, weighed along x. */
static void volume_spline(__global const float *c, const int *at, int row,
    int layer, const struct volume_weights w[3], int order, struct jetr *out)
{
	struct jetr f;

	out->value = REAL(0.0f);
	out->gradient = vec3r(REAL(0.0f), REAL(0.0f), REAL(0.0f));
	out->hessian = sym3r_identity(REAL(0.0f));
	for (int i = 0; i < 4; i++) {
		real w0 = w[0].w[0][i], w1 = w[0].w[1][i];

		volume_layer(c + i * layer, at, row, w + 1, w + 2, order, &f);
		out->value += w0 * f.value;
		if (order < 1)
			continue;
		out->gradient.x += w1 * f.value;
		out->gradient.y += w0 * f.gradient.y;
		out->gradient.z += w0 * f.gradient.z;
		if (order < 2)
			continue;
		out->hessian.xx += w[0].w[2][i] * f.value;
		out->hessian.xy += w1 * f.gradient.y;
		out->hessian.xz += w1 * f.gradient.z;
		out->hessian.yy += w0 * f.hessian.yy;
		out->hessian.yz += w0 * f.hessian.yz;
		out->hessian.zz += w0 * f.hessian.zz;
	}
}

/* 0 where m does not hold. */
static void volume_keep(struct jetr *f, mask m, int order)
{
	real zero = REAL(0.0f);

	f->value = SELECT(zero, f->value, m);
	if (order >= 1)
		f->gradient = vec3r_select(vec3r(zero, zero, zero),
		    f->gradient, m);
	if (order >= 2)
		f->hessian = sym3r_select(sym3r_identity(zero), f->hessian, m);
}

static inline real volume_limit(real x, float most)
{
	return real_clamp(x, REAL(-most), REAL(most));
}

/* The field of a distance; 1, a whole falloff, stands for what is outside. */
static void volume_solid(struct jetr *d, float inv_fall, mask inside,
    int order, struct jetr *out)
{
	struct vec3r *g = &d->gradient;
	struct sym3r *h = &d->hessian;

	d->value = SELECT(REAL(1.0f), d->value * inv_fall, inside);
	*g = vec3r(volume_limit(g->x * inv_fall, VOLUME_SLOPE),
	    volume_limit(g->y * inv_fall, VOLUME_SLOPE),
	    volume_limit(g->z * inv_fall, VOLUME_SLOPE));
	*h = sym3r(volume_limit(h->xx * inv_fall, VOLUME_BEND),
	    volume_limit(h->yy * inv_fall, VOLUME_BEND),
	    volume_limit(h->zz * inv_fall, VOLUME_BEND),
	    volume_limit(h->xy * inv_fall, VOLUME_BEND),
	    volume_limit(h->xz * inv_fall, VOLUME_BEND),
	    volume_limit(h->yz * inv_fall, VOLUME_BEND));
	solid(d, 1.0f, order, out);
}

/* u held within least and most; *near keeps the lanes where it was. */
static inline real volume_hold(real u, float least, float most, mask *near)
{
	*near = *near && u >= least && u <= most;
	return real_clamp(u, REAL(least), REAL(most));
}

/*
 * The field at x, with derivatives up to order; c: the volume's coefficients.
 * Lanes that are not near it give 0.
 */
static void volume_eval(__global const float *c, __global const float *p,
    struct vec3r x, int order, struct jetr *out)
{
	int natural = p[9] > 0.0f, row = (int)p[8], layer = (int)p[7] * row;
	float beyond = natural ? 0.0f : 2.0f;
	struct volume_weights w[3];
	mask near = INT(-1);
	struct jetr f;
	int at[WIDTH];
	real u[3] = {(x.x - p[0]) * p[3], (x.y - p[1]) * p[4],
	    (x.z - p[2]) * p[5]};

	for (int i = 0; i < 3; i++)
		u[i] = volume_hold(u[i], -beyond, p[6 + i] - 1.0f + beyond,
		    &near);
	out->value = REAL(0.0f);
	out->gradient = vec3r(REAL(0.0f), REAL(0.0f), REAL(0.0f));
	out->hessian = sym3r_identity(REAL(0.0f));
	if (!ANY(near))
		return;
	for (int i = 0; i < 3; i++)
		volume_weigh(u[i], p[3 + i], p[6 + i], natural, w + i);
	STORE((TO_INT(w[0].first) * (int)p[7] + TO_INT(w[1].first)) * row +
	    TO_INT(w[2].first), 0, at);
	volume_spline(c, at, row, layer, w, order, &f);
	if (natural) {
		volume_solid(&f, p[9], near, order, out);
		return;
	}
	volume_keep(&f, near && f.value > 0.0f, order);
	*out = f;
}
