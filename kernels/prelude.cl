/*
 * Types of the kernels: WIDTH points travel together, one a lane. WIDTH is a
 * build option (1 2 4 8 16); everything below works alike for all of them.
 *
 * Comparisons of reals give masks: 1 in a scalar, -1 in a vector's lane, 0 for
 * false. Combine masks with & | && || and !, never with ~, and turn them into
 * numbers with SELECT only.
 */
#ifndef WIDTH
#define WIDTH 1
#endif

#define PASTE_TOKENS(a, b) a##b
#define PASTE(a, b) PASTE_TOKENS(a, b)

#if WIDTH == 1
typedef float real;
typedef int mask;
#define ANY(m) (m)
#define ALL(m) (m)
/* Lanes i WIDTH ... of an array of float. */
#define LOAD(i, pointer) ((pointer)[i])
#define STORE(value, i, pointer) ((pointer)[i] = (value))
#define TO_INT(x) convert_int(x)
#define TO_REAL(m) convert_float(m)
#else
typedef PASTE(float, WIDTH) real;
typedef PASTE(int, WIDTH) mask;
#define ANY(m) lanes_any(m)
#define ALL(m) (!lanes_any(!(m)))
#define LOAD(i, pointer) PASTE(vload, WIDTH)(i, pointer)
#define STORE(value, i, pointer) PASTE(vstore, WIDTH)(value, i, pointer)
#define TO_INT(x) PASTE(convert_int, WIDTH)(x)
#define TO_REAL(m) PASTE(convert_float, WIDTH)(m)
#endif

/* x in every lane. */
#define REAL(x) ((real)(x))
#define INT(x) ((mask)(x))

#if WIDTH > 1

/*
 * A processor's own instructions, where OpenCL C has no words for them that
 * PoCL's compiler would turn into these: a comparison into bits, a load a lane,
 * a reciprocal root. Of 50 points under camel, curves took a quarter of the
 * time by loads and shuffles, which the compiler takes apart; by gathers a
 * seventh.
 */
#if WIDTH == 16 && defined(__AVX512F__) && defined(__clang__)
#define HAS_AVX512 1
#endif

/* Bit l: whether a mask holds in lane l. */
static inline uint lanes_bits(mask m)
{
#ifdef HAS_AVX512
	return (uint)(ushort)__builtin_ia32_cmpd512_mask(m, INT(0), 1,
	    (ushort)0xffff);
#else
	int lane[WIDTH];
	uint bits = 0u;

	PASTE(vstore, WIDTH)(m, 0, lane);
	for (int l = 0; l < WIDTH; l++)
		bits |= ((uint)lane[l] & 1u) << l;
	return bits;
#endif
}

/*
 * Whether a mask holds in any lane. PoCL's any() is a branch for each pair of
 * lanes, which random points make it mispredict: without them 50 points under
 * camel take 0.87 of the time.
 */
static inline int lanes_any(mask m)
{
#ifdef HAS_AVX512
	return lanes_bits(m) != 0u;
#else
#if WIDTH == 16
	int8 eight = m.lo | m.hi;
#elif WIDTH == 8
	int8 eight = m;
#endif
#if WIDTH >= 8
	int4 four = eight.lo | eight.hi;
#elif WIDTH == 4
	int4 four = m;
#endif
#if WIDTH >= 4
	int2 two = four.lo | four.hi;
#else
	int2 two = m;
#endif

	return (two.x | two.y) != 0;
#endif
}

#ifdef HAS_AVX512
/* from[at] of every lane. */
static inline real lanes_gather(__global const float *from, mask at)
{
	return __builtin_ia32_gathersiv16sf(REAL(0.0f),
	    (const void *)(ulong)from, at, (ushort)0xffff, 4);
}
#endif

/* The numbers of the lanes of bits, plus first, in order to to[0], ..., which
 * has room for WIDTH of them. Their count. */
static inline int lanes_list(uint bits, int first, int *to)
{
#ifdef HAS_AVX512
	const int16 lane = (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12,
	    13, 14, 15);

	vstore16(__builtin_ia32_compresssi512_mask(lane + first, lane,
	    (ushort)bits), 0, to);
	return (int)popcount(bits);
#else
	int count = 0;

	for (; bits != 0u; bits &= bits - 1u)
		to[count++] = first + 31 - (int)clz(bits & -bits);
	return count;
#endif
}

/* from[at[l]] of every lane l. */
static inline real lanes_pack(const float *from, const int *at)
{
#ifdef HAS_AVX512
	return __builtin_ia32_gathersiv16sf(REAL(0.0f), (const void *)from,
	    vload16(0, at), (ushort)0xffff, 4);
#else
	float lane[WIDTH];

	for (int l = 0; l < WIDTH; l++)
		lane[l] = from[at[l]];
	return LOAD(0, lane);
#endif
}

/* to[at[l]] becomes lane l of x, of the lanes of bits. */
static inline void lanes_unpack(float *to, const int *at, uint bits, real x)
{
#ifdef HAS_AVX512
	__builtin_ia32_scattersiv16sf((void *)to, (ushort)bits,
	    vload16(0, at), x, 4);
#else
	float lane[WIDTH];

	STORE(x, 0, lane);
	for (int l = 0; l < WIDTH; l++)
		if (bits >> l & 1u)
			to[at[l]] = lane[l];
#endif
}

#endif

/* 1/sqrt(x), to 2 ulp, for x from 1e-37 to 1e37. */
static inline real lanes_rsqrt(real x)
{
#ifdef HAS_AVX512
	real r = __builtin_ia32_rsqrt14ps512_mask(x, REAL(0.0f),
	    (ushort)0xffff);

	return r * (1.5f - 0.5f * x * r * r);
#else
	return 1.0f / sqrt(x);
#endif
}

/* 1/x, to 2 ulp, for |x| from 1e-37 to 1e37. */
static inline real lanes_inverse(real x)
{
#ifdef HAS_AVX512
	real r = __builtin_ia32_rcp14ps512_mask(x, REAL(0.0f),
	    (ushort)0xffff);

	return r + r * (1.0f - x * r);
#else
	return 1.0f / x;
#endif
}

/*
 * s + a b, rounded once where the processor does that at no cost: for places
 * where it may not be left to the compiler which. FUSED: a GPU, where all do.
 */
#if defined(__FMA__) || defined(HAS_AVX512) || defined(FUSED)
#define FUSED_ADD(a, b, s) fma(a, b, s)
#else
#define FUSED_ADD(a, b, s) ((s) + (a) * (b))
#endif

/* yes where m holds, no elsewhere; yes and no are real, or both mask. */
#define SELECT(no, yes, m) ((m) ? (yes) : (no))

struct vec3r {
	real x, y, z;
};

struct sym3r {
	real xx, yy, zz, xy, xz, yz;
};

struct jetr {
	real value;
	struct vec3r gradient;
	struct sym3r hessian;
};

/* Selects, since fmax and fmin stop PoCL's vectoriser in large kernels. */
static inline real real_max(real a, real b)
{
	return SELECT(b, a, a > b);
}

static inline real real_min(real a, real b)
{
	return SELECT(b, a, a < b);
}

static inline real real_clamp(real x, real least, real most)
{
	return real_min(real_max(x, least), most);
}

static inline struct vec3r vec3r(real x, real y, real z)
{
	struct vec3r v = {x, y, z};

	return v;
}

/* The same vector, stored as three floats, in every lane. */
static inline struct vec3r vec3r_load(__global const float *p)
{
	return vec3r(REAL(p[0]), REAL(p[1]), REAL(p[2]));
}

static inline struct vec3r vec3r_add(struct vec3r a, struct vec3r b)
{
	return vec3r(a.x + b.x, a.y + b.y, a.z + b.z);
}

static inline struct vec3r vec3r_sub(struct vec3r a, struct vec3r b)
{
	return vec3r(a.x - b.x, a.y - b.y, a.z - b.z);
}

static inline struct vec3r vec3r_scale(real s, struct vec3r a)
{
	return vec3r(s * a.x, s * a.y, s * a.z);
}

/* a + s b */
static inline struct vec3r vec3r_axpy(real s, struct vec3r b, struct vec3r a)
{
	return vec3r(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}

static inline real vec3r_dot(struct vec3r a, struct vec3r b)
{
	return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline struct vec3r vec3r_cross(struct vec3r a, struct vec3r b)
{
	return vec3r(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z,
	    a.x * b.y - a.y * b.x);
}

static inline struct vec3r vec3r_select(struct vec3r no, struct vec3r yes,
    mask m)
{
	return vec3r(SELECT(no.x, yes.x, m), SELECT(no.y, yes.y, m),
	    SELECT(no.z, yes.z, m));
}

static inline struct sym3r sym3r(real xx, real yy, real zz, real xy, real xz,
    real yz)
{
	struct sym3r a = {xx, yy, zz, xy, xz, yz};

	return a;
}

/* The identity times s. */
static inline struct sym3r sym3r_identity(real s)
{
	return sym3r(s, s, s, REAL(0.0f), REAL(0.0f), REAL(0.0f));
}

static inline struct sym3r sym3r_scale(real s, struct sym3r a)
{
	return sym3r(s * a.xx, s * a.yy, s * a.zz, s * a.xy, s * a.xz,
	    s * a.yz);
}

/* a + s b */
static inline struct sym3r sym3r_axpy(real s, struct sym3r b, struct sym3r a)
{
	return sym3r(a.xx + s * b.xx, a.yy + s * b.yy, a.zz + s * b.zz,
	    a.xy + s * b.xy, a.xz + s * b.xz, a.yz + s * b.yz);
}

/* u u^T */
static inline struct sym3r sym3r_square(struct vec3r u)
{
	return sym3r(u.x * u.x, u.y * u.y, u.z * u.z, u.x * u.y, u.x * u.z,
	    u.y * u.z);
}

/* u v^T + v u^T */
static inline struct sym3r sym3r_product(struct vec3r u, struct vec3r v)
{
	return sym3r(2.0f * u.x * v.x, 2.0f * u.y * v.y, 2.0f * u.z * v.z,
	    u.x * v.y + u.y * v.x, u.x * v.z + u.z * v.x,
	    u.y * v.z + u.z * v.y);
}

static inline struct vec3r sym3r_apply(struct sym3r a, struct vec3r u)
{
	return vec3r(a.xx * u.x + a.xy * u.y + a.xz * u.z,
	    a.xy * u.x + a.yy * u.y + a.yz * u.z,
	    a.xz * u.x + a.yz * u.y + a.zz * u.z);
}

static inline struct sym3r sym3r_select(struct sym3r no, struct sym3r yes,
    mask m)
{
	return sym3r(SELECT(no.xx, yes.xx, m), SELECT(no.yy, yes.yy, m),
	    SELECT(no.zz, yes.zz, m), SELECT(no.xy, yes.xy, m),
	    SELECT(no.xz, yes.xz, m), SELECT(no.yz, yes.yz, m));
}

/*
 * What a jet is held within before products are formed of it, so that none
 * overflows and so no NaN arises. Trees keep their lengths within
 * TREE_LENGTH_MIN..MAX, so gradients stay under about 1e10 and Hessians under
 * 1e20 times the weights: this bites only beyond any sensible document.
 */
#define LIMIT_VALUE 1e18f
#define LIMIT_GRADIENT 1e13f
#define LIMIT_HESSIAN 1e30f
#define LIMIT_COSINE 1e12f

/* NaN becomes -most. */
static inline struct vec3r vec3r_limit(struct vec3r a, float most)
{
	return vec3r(real_clamp(a.x, REAL(-most), REAL(most)),
	    real_clamp(a.y, REAL(-most), REAL(most)),
	    real_clamp(a.z, REAL(-most), REAL(most)));
}

static inline struct sym3r sym3r_limit(struct sym3r a, float most)
{
	real least = REAL(-most), top = REAL(most);

	return sym3r(real_clamp(a.xx, least, top),
	    real_clamp(a.yy, least, top), real_clamp(a.zz, least, top),
	    real_clamp(a.xy, least, top), real_clamp(a.xz, least, top),
	    real_clamp(a.yz, least, top));
}

static inline void jetr_limit(struct jetr *a, int order)
{
	a->value = real_clamp(a->value, REAL(0.0f), REAL(LIMIT_VALUE));
	if (order >= 1)
		a->gradient = vec3r_limit(a->gradient, LIMIT_GRADIENT);
	if (order >= 2)
		a->hessian = sym3r_limit(a->hessian, LIMIT_HESSIAN);
}
