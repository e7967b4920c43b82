/* The native evaluator for any processor. */
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O3,fp-contract=fast,no-trapping-math,no-math-errno")
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#define NATIVE_KIND 0
#include "tests/bench/native_walk.h"

const struct native_kind native_plain = {"plain", walk, straight};
