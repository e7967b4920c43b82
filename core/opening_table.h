/*
 * Openings sampled for a device: theta and its derivatives at nodes regular in
 * c = cos(alpha) over [-1, 1], so that a lookup needs no acos.
 */
#ifndef CORE_OPENING_TABLE_H
#define CORE_OPENING_TABLE_H

#include "core/opening.h"

/*
 * Nodes by default, 16 KB. Largest errors over the named openings (organic is
 * the worst), with theta up to 0.79, slope up to 6.3 and bend up to 350:
 *   nodes    theta    slope   bend      theta if it were linear
 *     256   9.2e-5   6.8e-2     77      2.6e-3
 *     512   1.3e-5   5.9e-3     38      6.4e-4
 *    1024   9.3e-7   5.9e-4     12      1.7e-4
 *    2048   7.1e-8   6.4e-5    3.5      4.1e-5
 *    4096   3.0e-8   3.8e-6    0.9      1.0e-5
 * Steeper openings do worse: with an interval of 0.01 radians values of
 * compositions are off by up to 6e-4.
 */
#define OPENING_TABLE_COUNT 1024

/*
 * Samples opening at count >= 2 nodes (core/curve.h: theta, slope, bend of
 * struct opening_jet, 0): count * CURVE_NODE floats.
 */
void opening_table_build(const struct opening *opening, int count, float *out);

/*
 * What the device's lookup gives at cosine, clamped to [-1, 1]: curve_lookup.
 */
void opening_table_lookup(const float *table, int count, double cosine,
    struct opening_jet *out);

#endif
