/*
 * Convolution surfaces with the Cauchy kernel: core/convolution.c in float32,
 * WIDTH points at a time; its comments give the identities. It sums over fewer
 * nodes, and a triangle that is small against its distance by seven points.
 * Members of a jet beyond the order asked for are left unset.
 *
 * In an element's unit coordinates reach CAUCHY_REACH, whose square float32
 * holds and whose fourth power it does not; 1/R^2 goes to 0 instead.
 */

/* Angles under this are none: what their stretch adds is as little. */
#define ANGLE_LEAST 1e-30f

/* Squares of lengths from this up are normal float32 numbers. */
#define SIDE_LEAST 1e-18f

/* A triangle whose longest side is up to this times as long as far is summed
 * over seven points; 1 for the kernel's width counts among the far. */
#define COMPACT 0.25f

/* Nodes and weights of Gauss and Legendre on [0, 1]. */
#define CAUCHY_ALONG 10
__constant float cauchy_along[CAUCHY_ALONG][2] = {
	{0.013046735741f, 0.033335672154f}, {0.067468316656f, 0.074725674575f},
	{0.16029521585f, 0.10954318126f}, {0.28330230294f, 0.13463335965f},
	{0.42556283051f, 0.14776211236f}, {0.57443716949f, 0.14776211236f},
	{0.71669769706f, 0.13463335965f}, {0.83970478415f, 0.10954318126f},
	{0.93253168334f, 0.074725674575f}, {0.98695326426f, 0.033335672154f}};

#define CAUCHY_ACROSS 3
__constant float cauchy_across[CAUCHY_ACROSS][2] = {
	{0.11270166538f, 0.27777777778f}, {0.5f, 0.44444444444f},
	{0.88729833462f, 0.27777777778f}};

/* Radon's rule of degree 5 on a triangle: shares of two corners, weight. */
#define CAUCHY_PLACES 7
__constant float cauchy_places[CAUCHY_PLACES][3] = {
	{0.33333333333f, 0.33333333333f, 0.225f},
	{0.10128650732f, 0.10128650732f, 0.12593918054f},
	{0.10128650732f, 0.79742698535f, 0.12593918054f},
	{0.79742698535f, 0.10128650732f, 0.12593918054f},
	{0.47014206411f, 0.47014206411f, 0.13239415279f},
	{0.47014206411f, 0.05971587179f, 0.13239415279f},
	{0.05971587179f, 0.47014206411f, 0.13239415279f}};

static inline real squared(real x)
{
	return x * x;
}

/* From a to x in the element's unit. */
static struct vec3r cauchy_offset(__global const float *p, struct vec3r x)
{
	struct vec3r e = vec3r_scale(REAL(p[3]), vec3r_sub(x, vec3r_load(p)));
	real far = real_max(fabs(e.x), real_max(fabs(e.y), fabs(e.z)));

	return vec3r_scale(CAUCHY_REACH / real_max(far, REAL(CAUCHY_REACH)), e);
}

/* To world units. */
static void cauchy_finish(__global const float *p, int order, struct jetr *f)
{
	float s = p[3], scale = p[4];

	f->value *= scale;
	if (order >= 1)
		f->gradient = vec3r_scale(REAL(scale * s), f->gradient);
	if (order >= 2)
		f->hessian = sym3r_scale(REAL(scale * s * s), f->hessian);
}

static void cauchy_point(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct vec3r e = cauchy_offset(p, x);
	real b = 1.0f / (1.0f + vec3r_dot(e, e)), b2 = b * b;

	e = vec3r_scale(b, e);
	out->value = b2;
	if (order >= 1)
		out->gradient = vec3r_scale(-4.0f * b2, e);
	if (order >= 2)
		out->hessian = sym3r_axpy(24.0f * b2, sym3r_square(e),
		    sym3r_identity(-4.0f * b2 * b));
	cauchy_finish(p, order, out);
}

/* t0 to t1 of a line, t = q tan phi; delta = phi1 - phi0. */
struct stretch {
	real q, t0, t1;
	float length;
	real cos0, cos1, sin0, sin1; /* of phi */
	real delta, sine; /* of delta */
};

static struct stretch stretch(real q, real t0, float length)
{
	real t1 = t0 + length;
	real inv0 = 1.0f / sqrt(q * q + t0 * t0);
	real inv1 = 1.0f / sqrt(q * q + t1 * t1);
	struct stretch l = {q, t0, t1, length, q * inv0, q * inv1, t0 * inv0,
	    t1 * inv1, REAL(0.0f), REAL(0.0f)};

	l.sine = l.cos0 * (length * inv1);
	l.delta = atan2(l.sine, l.cos0 * l.cos1 + l.sin0 * l.sin1);
	return l;
}

/* Integrals of R^-2, R^-4, R^-6, R^-8. */
struct powers {
	real j1, j2, j3, j4;
};

/* Of sin^2k from -delta/2 to delta/2, k = 0 to 3; s = sin(delta/2). */
struct sines {
	real e0, e2, e4, e6;
};

static struct sines sines_up(real delta, real s, real c)
{
	real s2 = s * s, sc = 2.0f * s * c;
	struct sines e;

	e.e0 = delta;
	e.e2 = (delta - sc) * (1.0f / 2.0f);
	e.e4 = (3.0f * e.e2 - sc * s2) * (1.0f / 4.0f);
	e.e6 = (5.0f * e.e4 - sc * s2 * s2) * (1.0f / 6.0f);
	return e;
}

/* The series of e6, right to 1e-7 up to s^2 = 0.4, and from there down. */
static struct sines sines_down(real s, real c)
{
	real s2 = s * s, sc = 2.0f * s * c, sum = REAL(0.00853977033f);
	struct sines e;

	sum = sum * s2 + 0.00939278892f;
	sum = sum * s2 + 0.0103987263f;
	sum = sum * s2 + 0.011599179f;
	sum = sum * s2 + 0.0130516335f;
	sum = sum * s2 + 0.0148376465f;
	sum = sum * s2 + 0.0170765752f;
	sum = sum * s2 + 0.0199497768f;
	sum = sum * s2 + 0.0237458882f;
	sum = sum * s2 + 0.0289522059f;
	sum = sum * s2 + 0.0364583333f;
	sum = sum * s2 + 0.0480769231f;
	sum = sum * s2 + 0.0681818182f;
	sum = sum * s2 + 0.111111111f;
	sum = sum * s2 + 0.285714286f;
	e.e6 = s * s2 * s2 * s2 * sum;
	e.e4 = (6.0f * e.e6 + sc * s2 * s2) * (1.0f / 5.0f);
	e.e2 = (4.0f * e.e4 + sc * s2) * (1.0f / 3.0f);
	e.e0 = 2.0f * e.e2 + sc;
	return e;
}

static struct sines sines_of(real delta, real s, real c)
{
	struct sines up = sines_up(delta, s, c), down = sines_down(s, c);
	mask m = s * s > 0.4f;
	struct sines e = {SELECT(down.e0, up.e0, m), SELECT(down.e2, up.e2, m),
	    SELECT(down.e4, up.e4, m), SELECT(down.e6, up.e6, m)};

	return e;
}

/* Those that derivatives up to order need; j4 if order is 2. */
static struct powers powers_of(const struct stretch *l, int order)
{
	real x = l->cos0 + l->cos1, y = l->sin0 + l->sin1, one = REAL(1.0f);
	real norm2 = real_max(x * x + y * y, REAL(ANGLE_LEAST));
	real c2 = real_min(norm2 * 0.25f, one), c = sqrt(c2);
	real s = SELECT(l->sine * 0.5f / c, sqrt(1.0f - c2), c2 < 0.5f);
	real cc = real_min(x * x / norm2, one), ss = 1.0f - cc;
	real inv = 1.0f / l->q, inv2 = inv * inv, inv3 = inv * inv2;
	struct sines e = sines_of(l->delta, s, c);
	real k2 = e.e0 - e.e2, k22 = e.e2 - e.e4, k24 = e.e4 - e.e6;
	real k4 = k2 - k22, k42 = k22 - k24, k6 = k4 - k42;
	struct powers j;

	j.j1 = inv * e.e0;
	j.j2 = inv3 * (cc * k2 + ss * e.e2);
	j.j3 = inv3 * inv2 * (cc * cc * k4 + 6.0f * cc * ss * k22 +
	    ss * ss * e.e4);
	if (order >= 2)
		j.j4 = inv3 * inv2 * inv2 * (cc * cc * cc * k6 + 15.0f * cc *
		    ss * (cc * k42 + ss * k24) + ss * ss * ss * e.e6);
	return j;
}

struct ends {
	real z, zz, cube;
};

static struct ends ends_of(const struct stretch *l)
{
	real a0 = squared(l->cos0 / l->q), a1 = squared(l->cos1 / l->q);
	real less = l->length * a0 * ((l->t0 + l->t1) * a1);
	real cube = less * (a0 * a0 + a0 * a1 + a1 * a1);
	mask near0 = fabs(l->t0) <= fabs(l->t1);
	real t = SELECT(l->t1, l->t0, near0), a = SELECT(a0, a1, near0);
	struct ends d = {less * (a0 + a1),
	    4.0f * (t * cube - l->length * a * a * a), cube};

	return d;
}

static void cauchy_segment(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct vec3r e = cauchy_offset(p, x), u = vec3r_load(p + 5);
	real z = vec3r_dot(u, e);
	struct stretch l;
	struct powers j;
	struct ends d;

	e = vec3r_axpy(-z, u, e);
	l = stretch(sqrt(1.0f + vec3r_dot(e, e)), -z, p[8]);
	j = powers_of(&l, order);
	out->value = j.j2;
	if (order >= 1) {
		d = ends_of(&l);
		out->gradient = vec3r_axpy(d.z, u,
		    vec3r_scale(-4.0f * j.j3, e));
	}
	if (order >= 2) {
		struct sym3r h = sym3r_identity(-4.0f * j.j3);

		h = sym3r_axpy(d.zz + 4.0f * j.j3, sym3r_square(u), h);
		h = sym3r_axpy(REAL(24.0f),
		    sym3r_product(vec3r_scale(0.5f * j.j4, e), e), h);
		out->hessian = sym3r_axpy(REAL(-4.0f),
		    sym3r_product(u, vec3r_scale(d.cube, e)), h);
	}
	cauchy_finish(p, order, out);
}

/* A triangle in its plane: x, y along u, v; h above it; c^2 = 1 + h^2. */
struct flat {
	float base, foot, height;
	real x, y, h, c2;
};

/* One side: its direction and length; from the foot of x to its start; the
 * distance of x, positive inside. */
struct side {
	float ux, uy, length;
	real t0, d;
};

static struct side side_of(const struct flat *f, float ax, float ay, float bx,
    float by)
{
	float dx = bx - ax, dy = by - ay, length = sqrt(dx * dx + dy * dy);
	float inv = length > SIDE_LEAST ? 1.0f / length : 0.0f;
	struct side s = {dx * inv, dy * inv, length};
	real ex = f->x - ax, ey = f->y - ay;

	s.t0 = -(s.ux * ex + s.uy * ey);
	s.d = s.ux * ey - s.uy * ex;
	return s;
}

static real side_distance2(const struct side *s)
{
	real off = real_max(REAL(0.0f), real_max(s->t0, -s->t0 - s->length));

	return s->d * s->d + off * off;
}

/* A jet along x, y and the normal. */
struct flat_jet {
	real value, x, y, n;
	real xx, yy, nn, xy, xn, yn;
};

static struct flat_jet flat_none(void)
{
	real zero = REAL(0.0f);
	struct flat_jet j = {zero, zero, zero, zero, zero, zero, zero, zero,
	    zero, zero};

	return j;
}

static struct flat_jet flat_select(struct flat_jet no, struct flat_jet yes,
    mask m)
{
	struct flat_jet j = {SELECT(no.value, yes.value, m),
	    SELECT(no.x, yes.x, m), SELECT(no.y, yes.y, m),
	    SELECT(no.n, yes.n, m), SELECT(no.xx, yes.xx, m),
	    SELECT(no.yy, yes.yy, m), SELECT(no.nn, yes.nn, m),
	    SELECT(no.xy, yes.xy, m), SELECT(no.xn, yes.xn, m),
	    SELECT(no.yn, yes.yn, m)};

	return j;
}

/* Integrals of R^-4, R^-6 and R^-8 over the triangle. */
struct areas {
	real i2, i3, i4;
};

static void add_inside(const struct side *s, real c2, const struct powers *j,
    int order, struct areas *sum)
{
	real i = 1.0f / c2, di = s->d * i, k3 = i * j->j1 + j->j2;

	sum->i2 += di * j->j1 * (1.0f / 2.0f);
	sum->i3 += di * k3 * (1.0f / 4.0f);
	if (order >= 2)
		sum->i4 += di * (i * k3 + j->j3) * (1.0f / 6.0f);
}

/* sin x for x in [0, pi], to 1e-7. */
static inline real sin_half_turn(real x)
{
	real y = real_min(x, M_PI_F - x), y2 = y * y;
	real p = REAL(-2.50521084e-8f);

	p = p * y2 + 2.75573192e-6f;
	p = p * y2 - 1.98412698e-4f;
	p = p * y2 + 8.33333333e-3f;
	p = p * y2 - 0.166666667f;
	return y + y * (y2 * p);
}

static void add_outside(const struct side *s, real c2, struct areas *sum)
{
	real far = fabs(s->d), t1 = s->t0 + s->length;
	real inv0 = 1.0f / sqrt(far * far + s->t0 * s->t0);
	real inv1 = 1.0f / sqrt(far * far + t1 * t1);
	real cos0 = far * inv0;
	real sine = cos0 * (s->length * inv1);
	real delta = atan2(sine, cos0 * (far * inv1) +
	    s->t0 * inv0 * (t1 * inv1));
	real turn = SELECT(delta, -delta, s->d > 0.0f);
	mask some = sine > ANGLE_LEAST;
	real over = 1.0f / SELECT(REAL(1.0f), sine, some);

	turn = SELECT(REAL(0.0f), turn, some);
	for (int i = 0; i < CAUCHY_ALONG; i++) {
		float x = cauchy_along[i][0];
		real g = (sin_half_turn((1.0f - x) * delta) * inv0 +
		    sin_half_turn(x * delta) * inv1) * over;
		real b = g * g / (1.0f + c2 * (g * g));
		real w = cauchy_along[i][1] * turn * b;

		sum->i2 += w * (1.0f / 2.0f);
		sum->i3 += w * b * (1.0f / 4.0f);
		sum->i4 += w * b * b * (1.0f / 6.0f);
	}
}

static void add_side(const struct side *s, real h, const struct stretch *l,
    const struct powers *j, int order, struct flat_jet *out)
{
	float nx = -s->uy, ny = s->ux;
	real across, z;

	out->x += nx * j->j2;
	out->y += ny * j->j2;
	if (order < 2)
		return;
	z = ends_of(l).z;
	across = -4.0f * s->d * j->j3;
	out->xx += nx * s->ux * z + nx * nx * across;
	out->yy += ny * s->uy * z + ny * ny * across;
	out->xy += (nx * s->uy + ny * s->ux) * 0.5f * z + nx * ny * across;
	out->xn -= nx * 4.0f * (h * j->j3);
	out->yn -= ny * 4.0f * (h * j->j3);
}

static struct flat_jet whole_triangle(const struct flat *f,
    const struct side *sides, mask outside, int order)
{
	struct flat_jet out = flat_none();
	struct areas in = {out.x, out.x, out.x}, off = in;

	for (int i = 0; i < 3; i++) {
		struct stretch l = stretch(sqrt(f->c2 + squared(sides[i].d)),
		    sides[i].t0, sides[i].length);
		struct powers j = powers_of(&l, order);

		add_inside(sides + i, f->c2, &j, order, &in);
		if (ANY(outside))
			add_outside(sides + i, f->c2, &off);
		add_side(sides + i, f->h, &l, &j, order, &out);
	}
	in.i2 = SELECT(in.i2, off.i2, outside);
	in.i3 = SELECT(in.i3, off.i3, outside);
	in.i4 = SELECT(in.i4, off.i4, outside);
	out.value = real_max(in.i2, REAL(0.0f));
	out.n = -4.0f * f->h * in.i3;
	out.nn = 24.0f * f->h * (f->h * in.i4) - 4.0f * in.i3;
	return out;
}

/* One place of the triangle, at (ex, ey, h) from x, R^-2 = b, weight wb / b. */
static void add_place(real wb, real b, real ex, real ey, real h, int order,
    struct flat_jet *out)
{
	real x = b * ex, y = b * ey, n = b * h, w2 = wb * b, w3, w4;

	out->value += w2;
	if (order < 1)
		return;
	w3 = -4.0f * w2;
	out->x += w3 * x;
	out->y += w3 * y;
	out->n += w3 * n;
	if (order < 2)
		return;
	w3 *= b;
	w4 = 24.0f * w2;
	out->xx += w3 + w4 * x * x;
	out->yy += w3 + w4 * y * y;
	out->nn += w3 + w4 * n * n;
	out->xy += w4 * x * y;
	out->xn += w4 * x * n;
	out->yn += w4 * y * n;
}

static void add_line(const struct flat *f, float ax, float y, float width,
    int order, struct flat_jet *out)
{
	struct side s = side_of(f, ax, 0.0f, f->foot, y);
	struct stretch l = stretch(sqrt(f->c2 + s.d * s.d), s.t0, s.length);
	mask some = l.sine > ANGLE_LEAST;
	real over = 1.0f / SELECT(REAL(1.0f), l.sine, some);
	real w = SELECT(REAL(0.0f), width * l.delta / l.q, some);
	/* r0 over the line's length */
	real reach = l.q / l.cos0 * (1.0f / s.length);

	for (int i = 0; i < CAUCHY_ALONG; i++) {
		float x = cauchy_along[i][0];
		real up = sin_half_turn(x * l.delta);
		real cosine = (sin_half_turn((1.0f - x) * l.delta) * l.cos0 +
		    up * l.cos1) * over;
		real b = squared(cosine / l.q);
		real tau = real_min(reach * up /
		    real_max(cosine, REAL(ANGLE_LEAST)), REAL(1.0f));
		real t = s.t0 + tau * s.length;

		add_place(cauchy_along[i][1] * w * tau, b,
		    -t * s.ux - s.d * s.uy, -t * s.uy + s.d * s.ux, f->h,
		    order, out);
	}
}

static struct flat_jet thin_triangle(const struct flat *f, int order)
{
	struct flat_jet out = flat_none();

	for (int i = 0; i < 2 * CAUCHY_ACROSS; i++) {
		float ax = i < CAUCHY_ACROSS ? 0.0f : f->base;
		float width = fabs(f->foot - ax);
		int k = i < CAUCHY_ACROSS ? i : i - CAUCHY_ACROSS;
		float y = cauchy_across[k][0] * f->height;
		float length = sqrt(width * width + y * y);

		if (width > 0.0f && length > SIDE_LEAST)
			add_line(f, ax, y, cauchy_across[k][1] * f->height *
			    (width / length), order, &out);
	}
	return out;
}

static struct flat_jet compact_triangle(const struct flat *f, int order)
{
	struct flat_jet out = flat_none();
	float area = f->base * f->height * 0.5f;

	for (int i = 0; i < CAUCHY_PLACES; i++) {
		float to_b = cauchy_places[i][0], to_c = cauchy_places[i][1];
		real ex = f->x - (to_b * f->base + to_c * f->foot);
		real ey = f->y - to_c * f->height;
		real b = 1.0f / (f->c2 + ex * ex + ey * ey);

		add_place(cauchy_places[i][2] * area * b, b, ex, ey, f->h,
		    order, &out);
	}
	return out;
}

static struct flat_jet flat_triangle(const struct flat *f, int order)
{
	struct side sides[3];
	real zero = REAL(0.0f), rho2;
	mask outside, compact, thin;
	struct flat_jet j = flat_none();

	rho2 = squared(f->x - (f->base + f->foot) * (1.0f / 3.0f)) +
	    squared(f->y - f->height * (1.0f / 3.0f));
	compact = squared(REAL(f->base / COMPACT)) <= f->c2 + rho2;
	if (ANY(compact))
		j = compact_triangle(f, order);
	if (ALL(compact))
		return j;
	sides[0] = side_of(f, 0.0f, 0.0f, f->base, 0.0f);
	sides[1] = side_of(f, f->base, 0.0f, f->foot, f->height);
	sides[2] = side_of(f, f->foot, f->height, 0.0f, 0.0f);
	outside = sides[0].d < 0.0f || sides[1].d < 0.0f || sides[2].d < 0.0f;
	rho2 = real_min(side_distance2(sides),
	    real_min(side_distance2(sides + 1), side_distance2(sides + 2)));
	rho2 = SELECT(zero, rho2, outside);
	thin = squared(REAL(f->height / CAUCHY_THIN)) <= f->c2 + rho2;
	if (ANY(thin && !compact))
		j = flat_select(thin_triangle(f, order), j, compact);
	if (!ALL(thin || compact))
		j = flat_select(whole_triangle(f, sides, rho2 >
		    CAUCHY_BEYOND * CAUCHY_BEYOND * f->c2, order), j,
		    thin || compact);
	return j;
}

static void cauchy_triangle(__global const float *p, struct vec3r x, int order,
    struct jetr *out)
{
	struct vec3r e = cauchy_offset(p, x);
	struct vec3r u = vec3r_load(p + 5), v = vec3r_load(p + 8);
	struct vec3r n = vec3r_cross(u, v);
	struct flat f = {p[11], p[12], p[13], vec3r_dot(u, e), vec3r_dot(v, e),
	    vec3r_dot(n, e), REAL(0.0f)};
	struct flat_jet j;

	f.c2 = 1.0f + f.h * f.h;
	j = flat_triangle(&f, order);
	out->value = j.value;
	if (order >= 1)
		out->gradient = vec3r_axpy(j.x, u, vec3r_axpy(j.y, v,
		    vec3r_scale(j.n, n)));
	if (order >= 2) {
		struct sym3r h = sym3r_axpy(j.xx, sym3r_square(u),
		    sym3r_scale(j.nn, sym3r_square(n)));

		h = sym3r_axpy(j.yy, sym3r_square(v), h);
		h = sym3r_axpy(j.xy, sym3r_product(u, v), h);
		h = sym3r_axpy(j.xn, sym3r_product(u, n), h);
		out->hessian = sym3r_axpy(j.yn, sym3r_product(v, n), h);
	}
	cauchy_finish(p, order, out);
}
