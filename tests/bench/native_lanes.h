/*
 * Lanes of the native evaluator: LANES points travel together in a real.
 * NATIVE_KIND says for which processor: 512, 2 (AVX2) or 0 (any).
 */
#ifndef TESTS_BENCH_NATIVE_LANES_H
#define TESTS_BENCH_NATIVE_LANES_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline))

typedef float eight __attribute__((vector_size(32)));

#if NATIVE_KIND == 512

#include <immintrin.h>

#define LANES 16
typedef __m512 real;
typedef int32_t whole __attribute__((vector_size(64)));
typedef __mmask16 mask;

INLINE real all(float x) { return _mm512_set1_ps(x); }
INLINE real load(const float *p) { return _mm512_loadu_ps(p); }
INLINE void store(float *p, real x) { _mm512_storeu_ps(p, x); }
INLINE mask lt(real a, real b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
INLINE mask le(real a, real b) { return _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ); }
INLINE mask not(mask m) { return (mask)~m; }
INLINE unsigned bits(mask m) { return m; }
INLINE mask from_bits(unsigned m) { return (mask)m; }
INLINE real choose(mask m, real yes, real no)
{
	return _mm512_mask_blend_ps(m, no, yes);
}
INLINE real real_max(real a, real b) { return _mm512_max_ps(a, b); }
INLINE real real_min(real a, real b) { return _mm512_min_ps(a, b); }
INLINE real root(real x) { return _mm512_sqrt_ps(x); }
INLINE whole truncate(real x) { return (whole)_mm512_cvttps_epi32(x); }
INLINE real to_real(whole i) { return _mm512_cvtepi32_ps((__m512i)i); }
INLINE real gather(const float *from, whole at)
{
	return _mm512_i32gather_ps((__m512i)at, from, 4);
}
INLINE void scatter(float *to, whole at, mask m, real x)
{
	_mm512_mask_i32scatter_ps(to, m, (__m512i)at, x, 4);
}

/* 1/x: an estimate to 14 bits, and Newton's step. */
INLINE real over(real x)
{
	real r = _mm512_rcp14_ps(x);

	return r + r * (1.0f - x * r);
}

#else

#if NATIVE_KIND == 2
#include <immintrin.h>
#define LANES 8
#else
#define LANES 4
#endif

typedef float real __attribute__((vector_size(4 * LANES)));
typedef int32_t whole __attribute__((vector_size(4 * LANES)));
typedef whole mask;

INLINE real all(float x) { return x - (real){0}; }
INLINE real load(const float *p)
{
	real x;

	memcpy(&x, p, sizeof(x));
	return x;
}
INLINE void store(float *p, real x) { memcpy(p, &x, sizeof(x)); }
INLINE mask lt(real a, real b) { return a < b; }
INLINE mask le(real a, real b) { return a <= b; }
INLINE mask not(mask m) { return ~m; }
INLINE mask from_bits(unsigned m)
{
	mask r = {0};

	for (int l = 0; l < LANES; l++)
		r[l] = m >> l & 1 ? -1 : 0;
	return r;
}
INLINE whole truncate(real x) { return __builtin_convertvector(x, whole); }
INLINE real to_real(whole i) { return __builtin_convertvector(i, real); }
INLINE real over(real x) { return 1.0f / x; }
INLINE void scatter(float *to, whole at, mask m, real x)
{
	for (int l = 0; l < LANES; l++)
		if (m[l])
			to[at[l]] = x[l];
}

#if NATIVE_KIND == 2
INLINE unsigned bits(mask m) { return (unsigned)_mm256_movemask_ps((__m256)m); }
INLINE real choose(mask m, real yes, real no)
{
	return _mm256_blendv_ps(no, yes, (__m256)m);
}
INLINE real real_max(real a, real b) { return _mm256_max_ps(a, b); }
INLINE real real_min(real a, real b) { return _mm256_min_ps(a, b); }
INLINE real root(real x) { return _mm256_sqrt_ps(x); }
INLINE real gather(const float *from, whole at)
{
	return _mm256_i32gather_ps(from, (__m256i)at, 4);
}
#else
INLINE unsigned bits(mask m)
{
	unsigned r = 0;

	for (int l = 0; l < LANES; l++)
		r |= (unsigned)(m[l] & 1) << l;
	return r;
}
INLINE real choose(mask m, real yes, real no)
{
	return (real)(((whole)yes & m) | ((whole)no & ~m));
}
INLINE real real_max(real a, real b) { return choose(b < a, a, b); }
INLINE real real_min(real a, real b) { return choose(a < b, a, b); }
INLINE real root(real x)
{
	for (int l = 0; l < LANES; l++)
		x[l] = sqrtf(x[l]);
	return x;
}
INLINE real gather(const float *from, whole at)
{
	real r;

	for (int l = 0; l < LANES; l++)
		r[l] = from[at[l]];
	return r;
}
#endif
#endif

INLINE mask gt(real a, real b) { return lt(b, a); }
INLINE mask ge(real a, real b) { return le(b, a); }
INLINE mask both(mask a, mask b) { return (mask)(a & b); }
INLINE mask either(mask a, mask b) { return (mask)(a | b); }
INLINE int any(mask m) { return bits(m) != 0; }
INLINE real clamp(real x, float least, float most)
{
	return real_min(real_max(x, all(least)), all(most));
}

/* Columns of eight floats a lane: column[k] holds rows[l][k] in lane l. */
INLINE void transpose(const eight rows[LANES], real column[8])
{
#if NATIVE_KIND == 512
	const __m256 *r = (const __m256 *)rows;
	real z[8], t[8];

	for (int i = 0; i < 8; i++)
		z[i] = _mm512_insertf32x8(_mm512_castps256_ps512(
		    r[i < 4 ? i : i + 4]), r[i < 4 ? i + 4 : i + 8], 1);
	for (int i = 0; i < 8; i += 4) {
		__m512d a = _mm512_castps_pd(_mm512_unpacklo_ps(z[i], z[i + 1]));
		__m512d b = _mm512_castps_pd(_mm512_unpackhi_ps(z[i], z[i + 1]));
		__m512d c = _mm512_castps_pd(
		    _mm512_unpacklo_ps(z[i + 2], z[i + 3]));
		__m512d d = _mm512_castps_pd(
		    _mm512_unpackhi_ps(z[i + 2], z[i + 3]));

		t[i] = _mm512_castpd_ps(_mm512_unpacklo_pd(a, c));
		t[i + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(a, c));
		t[i + 2] = _mm512_castpd_ps(_mm512_unpacklo_pd(b, d));
		t[i + 3] = _mm512_castpd_ps(_mm512_unpackhi_pd(b, d));
	}
	for (int k = 0; k < 4; k++) {
		column[k] = _mm512_shuffle_f32x4(t[k], t[k + 4], 0x88);
		column[k + 4] = _mm512_shuffle_f32x4(t[k], t[k + 4], 0xdd);
	}
#else
	float turned[8][LANES];

	for (int k = 0; k < 8; k++) {
		for (int l = 0; l < LANES; l++)
			turned[k][l] = rows[l][k];
		column[k] = load(turned[k]);
	}
#endif
}

/* --- vectors and symmetric matrices --------------------------------------- */

struct vec {
	real x, y, z;
};

struct sym {
	real xx, yy, zz, xy, xz, yz;
};

struct jet {
	real f;
	struct vec g;
	struct sym h;
};

INLINE struct vec vec(real x, real y, real z)
{
	return (struct vec){x, y, z};
}

/* x y z in every lane */
INLINE struct vec vec_all(const float p[3])
{
	return vec(all(p[0]), all(p[1]), all(p[2]));
}

INLINE struct vec add(struct vec a, struct vec b)
{
	return vec(a.x + b.x, a.y + b.y, a.z + b.z);
}

INLINE struct vec sub(struct vec a, struct vec b)
{
	return vec(a.x - b.x, a.y - b.y, a.z - b.z);
}

INLINE struct vec scale(real s, struct vec a)
{
	return vec(s * a.x, s * a.y, s * a.z);
}

/* a + s b */
INLINE struct vec axpy(real s, struct vec b, struct vec a)
{
	return vec(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}

INLINE real dot(struct vec a, struct vec b)
{
	return a.x * b.x + a.y * b.y + a.z * b.z;
}

INLINE struct vec vec_select(mask m, struct vec yes, struct vec no)
{
	return vec(choose(m, yes.x, no.x), choose(m, yes.y, no.y),
	    choose(m, yes.z, no.z));
}

INLINE struct sym sym(real xx, real yy, real zz, real xy, real xz, real yz)
{
	return (struct sym){xx, yy, zz, xy, xz, yz};
}

INLINE struct sym sym_one(real s)
{
	real o = all(0.0f);

	return sym(s, s, s, o, o, o);
}

INLINE struct sym sym_scale(real s, struct sym a)
{
	return sym(s * a.xx, s * a.yy, s * a.zz, s * a.xy, s * a.xz, s * a.yz);
}

/* a + s b */
INLINE struct sym sym_axpy(real s, struct sym b, struct sym a)
{
	return sym(a.xx + s * b.xx, a.yy + s * b.yy, a.zz + s * b.zz,
	    a.xy + s * b.xy, a.xz + s * b.xz, a.yz + s * b.yz);
}

/* a + s u u^T */
INLINE struct sym sym_square(real s, struct vec u, struct sym a)
{
	struct vec v = scale(s, u);

	return sym(a.xx + v.x * u.x, a.yy + v.y * u.y, a.zz + v.z * u.z,
	    a.xy + v.x * u.y, a.xz + v.x * u.z, a.yz + v.y * u.z);
}

/* a + u v^T + v u^T */
INLINE struct sym sym_product(struct vec u, struct vec v, struct sym a)
{
	return sym(a.xx + 2.0f * u.x * v.x, a.yy + 2.0f * u.y * v.y,
	    a.zz + 2.0f * u.z * v.z, a.xy + u.x * v.y + u.y * v.x,
	    a.xz + u.x * v.z + u.z * v.x, a.yz + u.y * v.z + u.z * v.y);
}

INLINE struct vec apply(struct sym a, struct vec u)
{
	return vec(a.xx * u.x + a.xy * u.y + a.xz * u.z,
	    a.xy * u.x + a.yy * u.y + a.yz * u.z,
	    a.xz * u.x + a.yz * u.y + a.zz * u.z);
}

INLINE struct sym sym_select(mask m, struct sym yes, struct sym no)
{
	return sym(choose(m, yes.xx, no.xx), choose(m, yes.yy, no.yy),
	    choose(m, yes.zz, no.zz), choose(m, yes.xy, no.xy),
	    choose(m, yes.xz, no.xz), choose(m, yes.yz, no.yz));
}

#endif
