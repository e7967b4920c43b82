/*
 * Operators without angles: functions of two field values alone. Those that
 * Gourmel et al. 2013 compare theirs with (their sections 2 and 3), and one
 * that documents of other programs need. Compiles as C11 and, for the
 * constants, as OpenCL C.
 *
 * Each is a union U(x, y) of two fields; the rest follows by De Morgan:
 *   intersection  g = max(0, 1 - U(1 - f1, 1 - f2))
 *   difference    g = max(0, 1 - U(1 - f1, min(f2, 1)))
 * Where 1 - f is negative, U is as follows. Operators for an iso-value of 0 act
 * on F = 2f - 1, positive inside, as (G + 1)/2, for which 1 - f is just -F.
 * Those made for fields on [0, 1] with 0 outside the support go on as max where
 * an argument is negative: such an intersection is min where a field exceeds 1.
 *
 * The formulas. t_+ is max(0, t).
 *
 * SUPER_ELLIPTIC (Rockwood 1989; Eq. 4, which prints [(1 - f)/r]_+ for
 *   [1 - f/r]_+ and has f < 0 inside):
 *     G = [1 + F1/r1]_+^t + [1 + F2/r2]_+^t - 1,
 *   each term going on along its tangent where F > 1. 0 where both
 *   f <= (1 - r)/2: the support shrinks to there, for r <= 1.
 * R_BLEND (Pasko, Adzhiev, Sourin, Savchenko 1995; Eq. 5, which prints the
 *   intersection's signs): the R-union with a displacement,
 *     G = F1 + F2 + sqrt(F1^2 + F2^2) + a0/(1 + (F1/a1)^2 + (F2/a2)^2).
 *   Not 0 where both fields are, but (sqrt 2 - 1 + a0/(1 + 1/a1^2 +
 *   1/a2^2))/2, if that is positive; over 1/2, all space is inside.
 * FUNCTIONAL (after Barthe, Gaildrat, Caubet 2001, whose operators extrude a
 *   profile curve along the diagonal; the text of Eq. 6 was not at hand): the
 *   quarter of a circle that is tangent to both axes' lines, extruded along
 *   (1, 1). G is the C with (F1 - C + d)^2 + (F2 - C + d)^2 = d^2,
 *     G = (F1 + F2)/2 + d - sqrt(2d^2 - (F1 - F2)^2)/2 if |F1 - F2| < d,
 *   else max. Where both fields are 0 it is (2 - sqrt 2) d/4.
 * R_CLEAN (R-functions, Pasko et al. 1995; Eq. 8, with f < 0 inside, prints
 *   f1 + f2 - sqrt(f1^2 + f2^2)): R_BLEND with a0 = 0. max's iso-surface, but
 *   no other of its values: (sqrt 2 - 1)/2 where both fields are 0.
 * BARTHE_CLEAN (after Barthe, Wyvill, de Groot 2004; the text of Eq. 9 and 10
 *   was not at hand): their construction, arcs of circles between boundary
 *   curves, with curves that meet on the iso-surface, which are ours:
 *     (f1 - k)^2 + (f2 - k)^2 = (g - k)^2, k(g) = 2g^2, 1/2 where g > 1/2,
 *   where f1 > k(f2) and f2 > k(f1), else max. max's iso-surface and support;
 *   one gradient everywhere but at f1 = f2 = 1/2 (and 0).
 * RICCI (Ricci 1973; Eq. 11): U = (x^n + y^n)^(1/n). max's support.
 *   Intersections by De Morgan too, not by -n, which would shrink operands.
 * BARTHE_OPENING (Barthe, Wyvill, de Groot 2004; Eq. 12, 13): max outside the
 *   lines y = t2 x and x = t1 y, t = tan(theta); between them arcs of
 *   ellipses, U the C with
 *     ((x - t1 C)/(1 - t1))^2 + ((y - t2 C)/(1 - t2))^2 = C^2.
 *   The text was not at hand; this is the ellipse that meets both lines
 *   smoothly. max's support. theta1 = theta2 = 0 is RICCI with n = 2.
 * INTERPOLATION (after Bernhardt, Barthe, Cani, Wyvill 2010, whose text was
 *   not at hand): (1 - h) BARTHE_CLEAN + h (x + y). There h is a field around
 *   the curves where surfaces meet; here it is one number. max's support.
 * POWER_DIFFERENCE: g = max(0, f1 - (2 f2)^alpha / 2); no union.
 *
 * Departures from exact derivatives, so that all is finite: first ones are
 * held within +-CLASSIC_SLOPE_MAX, second ones within +-CLASSIC_BEND_MAX (which
 * bites where RICCI and the arcs go to f1 = f2 = 0, BARTHE_CLEAN to
 * f1 = f2 = 1/2, and at powers under 2 near their base's 0). At F1 = F2 = 0 the
 * root of an R-function counts as flat: U's derivatives are 1 and 1 there. At
 * the other singular points, and where branches meet, they are one side's.
 */
#ifndef CORE_CLASSIC_H
#define CORE_CLASSIC_H

/* Values of an instruction's index. */
#define CLASSIC_SUPER_ELLIPTIC 0u
#define CLASSIC_R_BLEND 1u
#define CLASSIC_FUNCTIONAL 2u
#define CLASSIC_R_CLEAN 3u
#define CLASSIC_BARTHE_CLEAN 4u
#define CLASSIC_RICCI 5u
#define CLASSIC_BARTHE_OPENING 6u
#define CLASSIC_INTERPOLATION 7u
#define CLASSIC_POWER_DIFFERENCE 8u
#define CLASSIC_TYPE_COUNT 9u

#define CLASSIC_UNION 0
#define CLASSIC_INTERSECTION 1
#define CLASSIC_DIFFERENCE 2

/* Parameters that every one has on a tape, those it does not need 0: first the
 * family (CLASSIC_UNION ...), then what classic_prepare makes of its own. */
#define CLASSIC_PARAMS_MAX 8

#define CLASSIC_SLOPE_MAX 1e12f
#define CLASSIC_BEND_MAX 1e11f
/* Fields are taken as at least this where one is divided by. */
#define CLASSIC_TINY 1e-30f
/* BARTHE_CLEAN is max below this: squares stay within float32. */
#define CLASSIC_LEAST 1e-15f
/* The base-2 logarithm past which powers of fields are not followed: over any
 * field, 1e18 at most. */
#define CLASSIC_POWER_MAX 62.0f
/* |F/a| past which R_BLEND's displacement, under 1e-12 of a0, is not
 * followed. */
#define CLASSIC_FAR 1e6f

#ifndef __OPENCL_C_VERSION__

#include <stdbool.h>

struct operator_jet;

/*
 * What a document says of such an operator. p, by type:
 *   SUPER_ELLIPTIC    r1, r2 in [0.2, 1]; t in [1, 8]
 *   R_BLEND           a0 in [-10, 10]; a1, a2 in [0.01, 100]
 *   FUNCTIONAL        d in [0.001, 2]
 *   RICCI             n in [1, 1000]
 *   BARTHE_OPENING    theta1, theta2 in [0, pi/4]; over 0.7849 (1 - tan
 *                     below 1e-3) is max
 *   INTERPOLATION     h in [0, 1]
 *   POWER_DIFFERENCE  alpha in [1, 100]
 */
struct classic {
	unsigned type; /* CLASSIC_SUPER_ELLIPTIC ... */
	double p[CLASSIC_PARAMS_MAX - 1];
};

/* Whether type has that family (CLASSIC_UNION ...). */
bool classic_has_family(unsigned type, int family);

/* A tape's parameters, and a device's, of c in a family that it has. */
void classic_prepare(const struct classic *c, int family,
    double params[static CLASSIC_PARAMS_MAX]);

/*
 * g(f1, f2) with derivatives to order (0, 1 or 2; those beyond, and members
 * with t, are 0). params: classic_prepare's. f1, f2 >= 0, up to 1e18; g >= 0;
 * every number is finite. Roots are exact to rounding.
 */
void classic_eval(unsigned type, const double *params, double f1, double f2,
    int order, struct operator_jet *out);

#endif

#endif
