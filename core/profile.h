/*
 * Profiles: the silhouette curve of a blend, from (0,1) to (1,0), symmetric
 * about the diagonal (SPEC section 1). Each is held as y = B(x) over the half
 * with y >= x; the other half is its mirror image.
 */
#ifndef CORE_PROFILE_H
#define CORE_PROFILE_H

#include <stdbool.h>

#include "core/err.h"

#define PROFILE_SAMPLES_MAX 64

enum profile_type {
	PROFILE_SMOOTH,  /* y = 1 - eta(x) (Eq. 30) */
	PROFILE_BULGE,   /* Eq. 31, with K; folds on the diagonal on purpose */
	PROFILE_CIRCLE,  /* x^2 + y^2 = 1 */
	PROFILE_SAMPLES, /* a user's curve */
	PROFILE_TYPE_COUNT
};

/*
 * Plain data, freely copied. Make one with profile_smooth() and its like;
 * slope[] is filled by profile_from_samples.
 */
struct profile {
	enum profile_type type;
	double k;                              /* bulge: K in [0, 1] */
	int count;                             /* samples: how many */
	double x[PROFILE_SAMPLES_MAX];         /* samples, x rising from 0 */
	double y[PROFILE_SAMPLES_MAX];         /* samples, y falling from 1 */
	double slope[PROFILE_SAMPLES_MAX];     /* dy/dx at each sample */
};

/* Where the smooth silhouette meets the diagonal: x = 1 - eta(x), phi(1). */
#define PROFILE_DIAGONAL 0.80627872039391879

/* B, dB/dx and d2B/dx2 at one x. */
struct profile_jet {
	double y, slope, bend;
};

struct profile profile_smooth(void);
struct profile profile_circle(void);

/* K in [0, 1]; the caller has checked. */
struct profile profile_bulge(double k);

/*
 * A user's curve of count >= 3 points (x, y), from (0,1) either to a point on
 * the diagonal or all the way to (1,0), in which case it must be its own
 * mirror image to 1e-6. It must be monotone (x rises, y does not: so it is
 * star-shaped seen from the origin), nowhere inside the line from (0,1) to
 * (1,0), and end flat: its first step falls by no more than a fifth of its
 * length, so that the blend joins the maximum smoothly. Interpolated by a C2
 * cubic spline, or, where that would not be monotone, by a monotone cubic
 * (Fritsch and Carlson 1980), whose second derivative jumps at samples.
 * ERR_INVALID leaves a sentence in *why and the sample's index in *index.
 */
enum err profile_from_samples(const double (*xy)[2], int count,
    struct profile *out, const char **why, int *index);

/*
 * B at x in [0, x_d], x_d the curve's point on the diagonal. Below 0 it is 1;
 * beyond x_d it goes on so that y - B(x) keeps its sign along rays.
 */
void profile_eval(const struct profile *profile, double x,
    struct profile_jet *out);

/*
 * The smooth profile's eta (Eq. 19) for x in [0, 1], with two derivatives;
 * eta(0) = 2.6e-7, not 0. Also the half of phi's definition (Eq. 20).
 */
void profile_eta(double x, double out[static 3]);

bool profile_equal(const struct profile *a, const struct profile *b);

/* "smooth", "bulge", "circle" or "samples". */
const char *profile_name(enum profile_type type);

#endif
