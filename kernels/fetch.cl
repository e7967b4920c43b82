/*
 * Interpolated fetches from operator tables (core/table_shape.h). Tables lie in
 * one buffer, or, built with -DTABLES_IMAGE, in two image atlases that the
 * sampler interpolates.
 *
 * TABLE_ARGS declares what a function needs to reach tables and silhouettes,
 * TABLE_PASS hands it on. `curves` holds the silhouettes either way.
 *
 * Coordinates are in nodes, from 0 to N - 1 along each axis and clamped to
 * that; x runs fastest. fetch_first interpolates the first part in x, y and z.
 * fetch_cells gives the first part at both ends of the cell floor(x),
 * interpolated in y and z only: out[0..7]; and, if order > 1, the second part
 * interpolated in x, y and z: out[8..15]. Lanes that are not active give 0 and
 * touch no memory.
 */
#ifdef TABLES_IMAGE

#define TABLE_ARGS __read_only image3d_t atlas_first, \
	__read_only image3d_t atlas_second, __global const float *curves
#define TABLE_PASS atlas_first, atlas_second, curves

/* A lane's place, in nodes. */
struct fetch_cell {
	float x, y, z;
};

/* The same in the atlases, at the centres of nodes. */
static inline float4 fetch_place(__global const struct operator_desc *desc,
    float x, float y, float z)
{
	float last = (float)(desc->resolution - 1u);
	float left = (desc->second & 1u) ? (float)DESCRIPTOR_TILE : 0.0f;
	float low = (desc->second & 2u) ? (float)DESCRIPTOR_TILE : 0.0f;

	return (float4)(left + 0.5f + clamp(x, 0.0f, last),
	    low + 0.5f + clamp(y, 0.0f, last),
	    (float)desc->first + 0.5f + clamp(z, 0.0f, last), 0.0f);
}

#define FETCH_SAMPLER (CLK_NORMALIZED_COORDS_FALSE | \
	CLK_ADDRESS_CLAMP_TO_EDGE | CLK_FILTER_LINEAR)

static inline float4 fetch_cell_first(TABLE_ARGS,
    __global const struct operator_desc *desc, struct fetch_cell cell)
{
	const sampler_t sampler = FETCH_SAMPLER;

	return read_imagef(atlas_first, sampler,
	    fetch_place(desc, cell.x, cell.y, cell.z));
}

/* Along x at nodes, where the sampler's weights are 0 and 1. */
static inline float8 fetch_cell_edge(TABLE_ARGS,
    __global const struct operator_desc *desc, struct fetch_cell cell)
{
	const sampler_t sampler = FETCH_SAMPLER;
	float left = clamp(floor(cell.x), 0.0f,
	    (float)(desc->resolution - 2u));
	float4 a = read_imagef(atlas_first, sampler,
	    fetch_place(desc, left, cell.y, cell.z));

	return (float8)(a, read_imagef(atlas_first, sampler,
	    fetch_place(desc, left + 1.0f, cell.y, cell.z)));
}

/* The second atlas holds a node's last four floats in its further half. */
static inline float8 fetch_cell_second(TABLE_ARGS,
    __global const struct operator_desc *desc, struct fetch_cell cell)
{
	const sampler_t sampler = FETCH_SAMPLER;
	float4 place = fetch_place(desc, cell.x, cell.y, cell.z);
	float4 low = read_imagef(atlas_second, sampler, place);

	place.z += (float)(get_image_depth(atlas_second) / 2);
	return (float8)(low, read_imagef(atlas_second, sampler, place));
}

#else

#define TABLE_ARGS __global const float *tables, __global const float *curves
#define TABLE_PASS tables, curves

/* A lane's cell: its first node's index, and the place within it. */
struct fetch_cell {
	uint node;
	float x, y, z;
};

/* One load brings both nodes of an edge along x. */
static inline float8 fetch_cell_edge(TABLE_ARGS,
    __global const struct operator_desc *desc, struct fetch_cell cell)
{
	uint n = desc->resolution;
	__global const float *at = tables + desc->first + 4u * cell.node;
	float8 a = vload8(0, at), b = vload8(0, at + 4u * n);
	float8 c = vload8(0, at + 4u * n * n);
	float8 d = vload8(0, at + 4u * n * (n + 1u));

	a += cell.y * (b - a);
	c += cell.y * (d - c);
	return a + cell.z * (c - a);
}

static inline float4 fetch_cell_first(TABLE_ARGS,
    __global const struct operator_desc *desc, struct fetch_cell cell)
{
	float8 edge = fetch_cell_edge(TABLE_PASS, desc, cell);

	return edge.lo + cell.x * (edge.hi - edge.lo);
}

static inline float8 fetch_cell_second(TABLE_ARGS,
    __global const struct operator_desc *desc, struct fetch_cell cell)
{
	uint n = desc->resolution;
	__global const float *at = tables + desc->second + 8u * cell.node;
	float16 a = vload16(0, at), b = vload16(0, at + 8u * n);
	float16 c = vload16(0, at + 8u * n * n);
	float16 d = vload16(0, at + 8u * n * (n + 1u));

	a += cell.y * (b - a);
	c += cell.y * (d - c);
	a += cell.z * (c - a);
	return a.lo + cell.x * (a.hi - a.lo);
}

#endif

#if WIDTH == 1

static inline struct fetch_cell fetch_cell(
    __global const struct operator_desc *desc, float x, float y, float z)
{
#ifdef TABLES_IMAGE
	struct fetch_cell cell = {x, y, z};
#else
	uint n = desc->resolution;
	float last = (float)(n - 1u);
	float u = clamp(x, 0.0f, last), v = clamp(y, 0.0f, last);
	float w = clamp(z, 0.0f, last);
	uint i = min((uint)u, n - 2u), j = min((uint)v, n - 2u);
	uint k = min((uint)w, n - 2u);
	struct fetch_cell cell = {(k * n + j) * n + i, u - (float)i,
		v - (float)j, w - (float)k};
#endif

	return cell;
}

static void fetch_first(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, real out[4])
{
	float4 node = (float4)(0.0f);

	if (active)
		node = fetch_cell_first(TABLE_PASS, desc,
		    fetch_cell(desc, x, y, z));
	vstore4(node, 0, out);
}

static void fetch_cells(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, int order, real out[16])
{
	float8 edge = (float8)(0.0f), second = (float8)(0.0f);

	if (active) {
		struct fetch_cell cell = fetch_cell(desc, x, y, z);

		edge = fetch_cell_edge(TABLE_PASS, desc, cell);
		if (order > 1)
			second = fetch_cell_second(TABLE_PASS, desc, cell);
	}
	vstore8(edge, 0, out);
	vstore8(second, 1, out);
}

#else

/* The lanes' cells, to be read one by one. */
struct fetch_lanes {
#ifndef TABLES_IMAGE
	int node[WIDTH];
#endif
	float x[WIDTH], y[WIDTH], z[WIDTH];
};

static inline void fetch_spill(__global const struct operator_desc *desc,
    real x, real y, real z, struct fetch_lanes *lanes)
{
#ifndef TABLES_IMAGE
	int n = (int)desc->resolution;
	real least = REAL(0.0f), last = REAL((float)(n - 1));
	real end = REAL((float)(n - 2));
	mask i, j, k;

	x = real_clamp(x, least, last);
	y = real_clamp(y, least, last);
	z = real_clamp(z, least, last);
	i = TO_INT(real_min(x, end));
	j = TO_INT(real_min(y, end));
	k = TO_INT(real_min(z, end));
	x -= TO_REAL(i);
	y -= TO_REAL(j);
	z -= TO_REAL(k);
	STORE((k * n + j) * n + i, 0, lanes->node);
#endif
	STORE(x, 0, lanes->x);
	STORE(y, 0, lanes->y);
	STORE(z, 0, lanes->z);
}

static inline struct fetch_cell fetch_cell(const struct fetch_lanes *lanes,
    int l)
{
	struct fetch_cell cell = {
#ifndef TABLES_IMAGE
		(uint)lanes->node[l],
#endif
		lanes->x[l], lanes->y[l], lanes->z[l]};

	return cell;
}

#if WIDTH == 16

/* Pairs of the first and of the last two floats of every quarter of a and b. */
#define FETCH_LOW(a, b) (float16)(a.s0, b.s0, a.s1, b.s1, a.s4, b.s4, a.s5, \
	b.s5, a.s8, b.s8, a.s9, b.s9, a.sc, b.sc, a.sd, b.sd)
#define FETCH_HIGH(a, b) (float16)(a.s2, b.s2, a.s3, b.s3, a.s6, b.s6, a.s7, \
	b.s7, a.sa, b.sa, a.sb, b.sb, a.se, b.se, a.sf, b.sf)
/* The first and the last pairs of every quarter. */
#define FETCH_FIRST(a, b) (float16)(a.s01, b.s01, a.s45, b.s45, a.s89, b.s89, \
	a.scd, b.scd)
#define FETCH_LAST(a, b) (float16)(a.s23, b.s23, a.s67, b.s67, a.sab, b.sab, \
	a.sef, b.sef)

/*
 * Four floats of each of 16 rows, ROW(l), into 4 columns, by shuffles: quarter
 * q of a_ has row 4q, of b_ row 4q + 1, and so on.
 */
#define FETCH_COLUMNS(ROW, out) do { \
	float16 a_ = (float16)(ROW(0), ROW(4), ROW(8), ROW(12)); \
	float16 b_ = (float16)(ROW(1), ROW(5), ROW(9), ROW(13)); \
	float16 c_ = (float16)(ROW(2), ROW(6), ROW(10), ROW(14)); \
	float16 d_ = (float16)(ROW(3), ROW(7), ROW(11), ROW(15)); \
	float16 p_ = FETCH_LOW(a_, b_), q_ = FETCH_LOW(c_, d_); \
	float16 r_ = FETCH_HIGH(a_, b_), s_ = FETCH_HIGH(c_, d_); \
\
	(out)[0] = FETCH_FIRST(p_, q_); \
	(out)[1] = FETCH_LAST(p_, q_); \
	(out)[2] = FETCH_FIRST(r_, s_); \
	(out)[3] = FETCH_LAST(r_, s_); \
} while (0)

#endif

/* Columns of rows of eight. */
static inline void fetch_columns(const float8 *row, real out[8])
{
#if WIDTH == 16
#define FETCH_ROW(l) row[l].lo
	FETCH_COLUMNS(FETCH_ROW, out);
#undef FETCH_ROW
#define FETCH_ROW(l) row[l].hi
	FETCH_COLUMNS(FETCH_ROW, out + 4);
#undef FETCH_ROW
#else
	float node[8][WIDTH];

	for (int l = 0; l < WIDTH; l++) {
		float lane[8];

		vstore8(row[l], 0, lane);
		for (int k = 0; k < 8; k++)
			node[k][l] = lane[k];
	}
	for (int k = 0; k < 8; k++)
		out[k] = LOAD(0, node[k]);
#endif
}

static void fetch_first(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, real out[4])
{
	struct fetch_lanes lanes;
	uint bits = lanes_bits(active);
	float8 row[WIDTH];
	real column[8];

	fetch_spill(desc, x, y, z, &lanes);
	for (int l = 0; l < WIDTH; l++)
		row[l] = (float8)(0.0f);
	for (; bits != 0u; bits &= bits - 1u) {
		int l = 31 - (int)clz(bits & -bits);

		row[l].lo = fetch_cell_first(TABLE_PASS, desc,
		    fetch_cell(&lanes, l));
	}
	fetch_columns(row, column);
	for (int k = 0; k < 4; k++)
		out[k] = column[k];
}

static void fetch_cells(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, int order, real out[16])
{
	struct fetch_lanes lanes;
	uint bits = lanes_bits(active);
	float8 row[2][WIDTH];

	fetch_spill(desc, x, y, z, &lanes);
	for (int l = 0; l < WIDTH; l++)
		row[0][l] = (float8)(0.0f);
	for (int l = 0; l < WIDTH && order > 1; l++)
		row[1][l] = (float8)(0.0f);
	for (; bits != 0u; bits &= bits - 1u) {
		int l = 31 - (int)clz(bits & -bits);
		struct fetch_cell cell = fetch_cell(&lanes, l);

		row[0][l] = fetch_cell_edge(TABLE_PASS, desc, cell);
		if (order > 1)
			row[1][l] = fetch_cell_second(TABLE_PASS, desc, cell);
	}
	fetch_columns(row[0], out);
	if (order > 1)
		fetch_columns(row[1], out + 8);
}

#endif
