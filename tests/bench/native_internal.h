/*
 * What native.c prepares and the walks (native_walk.h, compiled once for each
 * kind of processor) read.
 */
#ifndef TESTS_BENCH_NATIVE_INTERNAL_H
#define TESTS_BENCH_NATIVE_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>

#include "core/opcode.h"

/* An operator: its table's arrays, and its opening's samples. */
struct native_operator {
	bool is_union, is_constant;
	float theta, theta_least;
	int resolution;
	const float *first, *second, *phi, *sigma;
	float *opening;
};

/* A point of exponent 3: f = weight b^3, b = 1 - inv_r2 |x - c|^2. */
struct native_ball {
	float c[3], inv_r2, weight, slope; /* slope: -6 inv_r2 weight */
};

/* Pairs of OP_POINT with exponent 3 and OP_SUM that follow one another. */
struct native_run {
	const struct native_ball *balls;
	size_t count;
};

struct native {
	const struct insn *insns;
	size_t insn_count;
	float *params;
	struct native_operator *operators;
	size_t operator_count;
	struct native_run *runs;   /* one an instruction: that begins there */
	struct native_ball *balls; /* of exponent 3, in the tape's order */
	size_t ball_count;
	bool is_straight;          /* the tape is a sum of them */
};

/* Points first..last-1 of a batch. */
struct native_share {
	const float *points;
	float *rows;
	size_t first, last;
	unsigned outputs;
};

/* A walk for one kind of processor. */
struct native_kind {
	const char *name;
	void (*evaluate)(const struct native *n, const struct native_share *s);
	void (*straight)(const struct native *n, const struct native_share *s);
};

extern const struct native_kind native_avx512, native_avx2, native_plain;

#endif
