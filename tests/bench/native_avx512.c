/* The native evaluator for processors with AVX-512. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#pragma GCC target("avx512f,avx512dq,avx512vl,avx512bw,avx2,fma")
#pragma GCC optimize("O3,fp-contract=fast,no-trapping-math,no-math-errno")
#define NATIVE_KIND 512
#include "tests/bench/native_walk.h"

const struct native_kind native_avx512 = {"AVX-512", walk, straight};
#else
#include "tests/bench/native_internal.h"

const struct native_kind native_avx512 = {"", NULL, NULL};
#endif
