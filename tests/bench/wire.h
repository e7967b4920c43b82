/*
 * The bench's part over the wire.
 */
#ifndef TESTS_BENCH_WIRE_H
#define TESTS_BENCH_WIRE_H

#include <stdbool.h>

/* Starts the daemon and reports the group "wire"; quick: shorter loads. */
void bench_wire(bool quick);

#endif
