/*
 * What operator tables hold, for C and OpenCL C alike.
 *
 * A table has N^3 nodes, node (it, iu, iv) at index (it N + iu) N + iv, and two
 * parts: "first" (g and its first derivatives) and "second".
 *
 * Layout "uniform" (the paper's): f1 = iv/(N-1), f2 = iu/(N-1), theta =
 * (pi/4) it/(N-1). A node holds g, g1, g2, gt; g11, g12, g22, g1t, g2t, gtt.
 *
 * Layout "warped" (SPEC section 1): with "near" the field that g falls back to
 * (union: the larger; intersection: the smaller), "far" the other, k the
 * boundary at near, and D = near - k:
 *   T = tan(theta) = 1 - (1-z)^2, z = it/(N-1);
 *   union:        near = (1 - (1-u)^2)/2, in [0, 1/2];
 *   intersection: the same of 2u for u <= 1/2, and 1 - near(1-u) above: [0, 1];
 *   far = k + w D with w = 1 - (1-v)^2, u = iu/(N-1), v = iv/(N-1).
 * A node holds q = (g - near)/D, gn, gf, gt/E; D gnn, D gnf, D gff, gnt, gft,
 * gtt/E (n: near, f: far, t: theta). D scales away what diverges at the origin,
 * and E = near (union) or near (1 - near) (intersection) what vanishes at the
 * ends of the range, where whole blends lie within one cell. A
 * lookup is linear in u and z, and cubic (Hermite) along v for q, whose slope there is
 * dq/dv = gf dw/dv: that takes nothing from memory, and divides the mean error
 * in g by 3 to 10 and the fold's largest by 3.
 *
 * Beside the parts lie two curves (core/curve.h) of TABLE_CURVE_NODES nodes:
 * phi on [0, 2], and sigma on [0, 1], the union's closed form for C >= 1/2, over
 * v with b/a = 1 - (1-v)^2: on the fold of bulge with K = 1 it rises as a root.
 * g = T/2 + a sigma(b/a) with a = near - T/2, b = far - T/2.
 */
#ifndef CORE_TABLE_SHAPE_H
#define CORE_TABLE_SHAPE_H

/* Raised whenever a table of the same kind comes out different: what lies on
 * disk with another number is built anew. */
#define TABLE_VERSION 1

#define TABLE_FIRST 4   /* floats a node has in the first part */
#define TABLE_SECOND 8  /* and in the second; two are unused */
#define TABLE_CURVE_NODES 513
#define TABLE_PHI 0                  /* first node of phi */
#define TABLE_SIGMA TABLE_CURVE_NODES /* first node of sigma */

/* Slopes of sigma in b/a are sigma_v/(2 (1-v)), and its second derivative
 * divides by (1-v)^2: below these 1-v, neighbouring values stand for them. */
#define TABLE_FOLD_FIRST 1e-3f
#define TABLE_FOLD_SECOND 3e-2f

/* D is held this far from 0, where theta = pi/4 closes the region at 1/2. */
#define TABLE_DEPTH_MIN 1e-7f

#endif
