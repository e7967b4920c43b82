/*
 * The yardstick of the evaluator: a tape walked by hand-written C in float32,
 * with AVX-512 or AVX2 where the processor has it, on two threads. It does the
 * kernels' work (core/opcode.h's plain opcodes; values, gradients, Hessians;
 * warped tables) but is no part of any product: it takes finite, sensible
 * points and documents, and has no limits against overflow.
 */
#ifndef TESTS_BENCH_NATIVE_H
#define TESTS_BENCH_NATIVE_H

#include <stdbool.h>
#include <stddef.h>

#define NATIVE_THREADS 2

struct native;
struct table;
struct tape;

/*
 * Prepares tape, which must outlive the result; tables[i] is the warped table of
 * tape->operators[i], and must outlive it too. NULL: the tape has
 * instructions that are not plain.
 */
struct native *native_create(const struct tape *tape,
    const struct table *const *tables);

/* Frees n; NULL does nothing. */
void native_free(struct native *n);

/*
 * Rows as those of device_evaluate; outputs of OUTPUT_VALUE, OUTPUT_GRADIENT and
 * OUTPUT_HESSIAN. Small batches are one thread's.
 */
void native_evaluate(const struct native *n, const float *points,
    size_t count, unsigned outputs, float *rows);

/* Whether native_straight can do it: points of exponent 3 under one sum. */
bool native_is_straight(const struct native *n);

/* Values and gradients of such a tape, by one loop over its points. */
void native_straight(const struct native *n, const float *points,
    size_t count, float *rows);

/* "AVX-512", "AVX2" or "plain". */
const char *native_name(void);

#endif
