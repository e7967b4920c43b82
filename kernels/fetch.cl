/*
 * Interpolated fetches from operator tables (core/table_shape.h). Tables lie in
 * one buffer, or, built with -DTABLES_IMAGE, in two image atlases that the
 * sampler interpolates.
 *
 * TABLE_ARGS declares what a function needs to reach tables and silhouettes,
 * TABLE_PASS hands it on. `curves` holds the silhouettes either way.
 *
 * Coordinates are in nodes, from 0 to N - 1 along each axis and clamped to that;
 * x runs fastest. fetch_first and fetch_second interpolate in x, y and z,
 * fetch_edge in y and z only: it gives the first part at both ends of the cell
 * floor(x). Lanes that are not active give 0 and touch no memory.
 */
#ifdef TABLES_IMAGE

#define TABLE_ARGS __read_only image3d_t atlas_first, \
	__read_only image3d_t atlas_second, __global const float *curves
#define TABLE_PASS atlas_first, atlas_second, curves

/* A lane's place in the atlases, at the centres of nodes. */
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

static inline float4 fetch_lane_first(TABLE_ARGS,
    __global const struct operator_desc *desc, float x, float y, float z)
{
	const sampler_t sampler = FETCH_SAMPLER;

	return read_imagef(atlas_first, sampler, fetch_place(desc, x, y, z));
}

/* Along x at nodes, where the sampler's weights are 0 and 1. */
static inline float8 fetch_lane_edge(TABLE_ARGS,
    __global const struct operator_desc *desc, float x, float y, float z)
{
	const sampler_t sampler = FETCH_SAMPLER;
	float left = clamp(floor(x), 0.0f, (float)(desc->resolution - 2u));
	float4 a = read_imagef(atlas_first, sampler,
	    fetch_place(desc, left, y, z));

	return (float8)(a, read_imagef(atlas_first, sampler,
	    fetch_place(desc, left + 1.0f, y, z)));
}

/* The second atlas holds a node's last four floats in its further half. */
static inline float8 fetch_lane_second(TABLE_ARGS,
    __global const struct operator_desc *desc, float x, float y, float z)
{
	const sampler_t sampler = FETCH_SAMPLER;
	float4 place = fetch_place(desc, x, y, z);
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
	float left, x, y, z;
};

static inline struct fetch_cell fetch_cell(uint n, float x, float y, float z)
{
	float last = (float)(n - 1u);
	float u = clamp(x, 0.0f, last), v = clamp(y, 0.0f, last);
	float w = clamp(z, 0.0f, last);
	uint i = min((uint)u, n - 2u), j = min((uint)v, n - 2u);
	uint k = min((uint)w, n - 2u);
	struct fetch_cell cell = {(k * n + j) * n + i, (float)i,
		u - (float)i, v - (float)j, w - (float)k};

	return cell;
}

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

static inline float8 fetch_lane_edge(TABLE_ARGS,
    __global const struct operator_desc *desc, float x, float y, float z)
{
	return fetch_cell_edge(TABLE_PASS, desc,
	    fetch_cell(desc->resolution, x, y, z));
}

static inline float4 fetch_lane_first(TABLE_ARGS,
    __global const struct operator_desc *desc, float x, float y, float z)
{
	struct fetch_cell cell = fetch_cell(desc->resolution, x, y, z);
	float8 edge = fetch_cell_edge(TABLE_PASS, desc, cell);

	return edge.lo + cell.x * (edge.hi - edge.lo);
}

static inline float8 fetch_lane_second(TABLE_ARGS,
    __global const struct operator_desc *desc, float x, float y, float z)
{
	uint n = desc->resolution;
	struct fetch_cell cell = fetch_cell(n, x, y, z);
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

static void fetch_first(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, real out[4])
{
	float4 node = (float4)(0.0f);

	if (active)
		node = fetch_lane_first(TABLE_PASS, desc, x, y, z);
	vstore4(node, 0, out);
}

static void fetch_edge(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, real out[8])
{
	float8 edge = (float8)(0.0f);

	if (active)
		edge = fetch_lane_edge(TABLE_PASS, desc, x, y, z);
	vstore8(edge, 0, out);
}

static void fetch_second(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, real out[8])
{
	float8 node = (float8)(0.0f);

	if (active)
		node = fetch_lane_second(TABLE_PASS, desc, x, y, z);
	vstore8(node, 0, out);
}

#else

/* What the loops over lanes read, spilled from vectors. */
struct fetch_lanes {
	int active[WIDTH];
	float x[WIDTH], y[WIDTH], z[WIDTH];
};

static inline void fetch_spill(mask active, real x, real y, real z,
    struct fetch_lanes *lanes)
{
	STORE(active, 0, lanes->active);
	STORE(x, 0, lanes->x);
	STORE(y, 0, lanes->y);
	STORE(z, 0, lanes->z);
}

/* What lane l fetched into its column. */
static inline void fetch_scatter(float8 r, int l, float (*node)[WIDTH])
{
	node[0][l] = r.s0;
	node[1][l] = r.s1;
	node[2][l] = r.s2;
	node[3][l] = r.s3;
	node[4][l] = r.s4;
	node[5][l] = r.s5;
	node[6][l] = r.s6;
	node[7][l] = r.s7;
}

static void fetch_first(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, real out[4])
{
	struct fetch_lanes lanes;
	float node[4][WIDTH];

	fetch_spill(active, x, y, z, &lanes);
	for (int l = 0; l < WIDTH; l++) {
		float4 r = (float4)(0.0f);

		if (lanes.active[l])
			r = fetch_lane_first(TABLE_PASS, desc, lanes.x[l],
			    lanes.y[l], lanes.z[l]);
		node[0][l] = r.s0;
		node[1][l] = r.s1;
		node[2][l] = r.s2;
		node[3][l] = r.s3;
	}
	for (int k = 0; k < 4; k++)
		out[k] = LOAD(0, node[k]);
}

static void fetch_edge(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, real out[8])
{
	struct fetch_lanes lanes;
	float node[8][WIDTH];

	fetch_spill(active, x, y, z, &lanes);
	for (int l = 0; l < WIDTH; l++) {
		float8 r = (float8)(0.0f);

		if (lanes.active[l])
			r = fetch_lane_edge(TABLE_PASS, desc, lanes.x[l],
			    lanes.y[l], lanes.z[l]);
		fetch_scatter(r, l, node);
	}
	for (int k = 0; k < 8; k++)
		out[k] = LOAD(0, node[k]);
}

static void fetch_second(TABLE_ARGS, __global const struct operator_desc *desc,
    mask active, real x, real y, real z, real out[8])
{
	struct fetch_lanes lanes;
	float node[8][WIDTH];

	fetch_spill(active, x, y, z, &lanes);
	for (int l = 0; l < WIDTH; l++) {
		float8 r = (float8)(0.0f);

		if (lanes.active[l])
			r = fetch_lane_second(TABLE_PASS, desc, lanes.x[l],
			    lanes.y[l], lanes.z[l]);
		fetch_scatter(r, l, node);
	}
	for (int k = 0; k < 8; k++)
		out[k] = LOAD(0, node[k]);
}

#endif
