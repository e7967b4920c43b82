/* The native evaluator for processors with AVX2. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#pragma GCC target("avx2,fma")
#pragma GCC optimize("O3,fp-contract=fast,no-trapping-math,no-math-errno")
#define NATIVE_KIND 2
#include "tests/bench/native_walk.h"

const struct native_kind native_avx2 = {"AVX2", walk, straight};
#else
#include "tests/bench/native_internal.h"

const struct native_kind native_avx2 = {"", NULL, NULL};
#endif
