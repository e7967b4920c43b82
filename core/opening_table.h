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
 *     256   9.2e-5   4.4e-2     77      2.6e-3
 *     512   1.3e-5   1.0e-2     38      6.4e-4
 *    1024   9.6e-7   1.5e-3     12      1.7e-4
 *    2048   8.4e-8   2.8e-4    3.5      4.1e-5
 *    4096   3.0e-8   1.8e-4    0.9      1.0e-5
 * From 1024 on theta is as exact as float32 arithmetic makes it anyway.
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
