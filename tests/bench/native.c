/* Chooses the walk, prepares tapes for it, and shares batches out. */
#include "tests/bench/native.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "core/curve.h"
#include "core/opening_table.h"
#include "core/output.h"
#include "core/table.h"
#include "core/tape.h"
#include "tests/bench/native_internal.h"

/* Points a thread takes at a time; batches under two of them are one thread's. */
#define CHUNK 8192

static const struct native_kind *kind(void)
{
#if defined(__x86_64__) && defined(__GNUC__)
	if (native_avx512.evaluate && __builtin_cpu_supports("avx512f") &&
	    __builtin_cpu_supports("avx512dq") &&
	    __builtin_cpu_supports("avx512vl") &&
	    __builtin_cpu_supports("avx512bw"))
		return &native_avx512;
	if (native_avx2.evaluate && __builtin_cpu_supports("avx2") &&
	    __builtin_cpu_supports("fma"))
		return &native_avx2;
#endif
	return &native_plain;
}

const char *native_name(void)
{
	return kind()->name;
}

static void *allocate(size_t size)
{
	void *p = calloc(1, size ? size : 1);

	if (!p)
		abort();
	return p;
}

static bool is_plain(const struct insn *insn)
{
	return insn->op <= OP_COLOR ||
	    (insn->op >= OP_POINT && insn->op <= OP_PLANE) ||
	    insn->op == OP_ZERO || (insn->op >= OP_MAX &&
	    insn->op <= OP_RICCI) || insn->op >= OP_UNION;
}

static void prepare_operator(const struct operator *from,
    const struct table *table, struct native_operator *to)
{
	*to = (struct native_operator){from->family == FAMILY_UNION,
		opening_is_constant(&from->opening),
		(float)opening_least(&from->opening),
		(float)opening_least(&from->opening), table->resolution,
		table->first, table->second,
		table->curves + CURVE_NODE * TABLE_PHI,
		table->curves + CURVE_NODE * TABLE_SIGMA, NULL};
	to->opening = allocate(OPENING_TABLE_COUNT * CURVE_NODE *
	    sizeof(float));
	opening_table_build(&from->opening, OPENING_TABLE_COUNT, to->opening);
}

static bool is_ball(const struct native *n, size_t i)
{
	return n->insns[i].op == OP_POINT &&
	    n->params[n->insns[i].param + 4] == 3.0f;
}

static bool is_added(const struct native *n, size_t i)
{
	return i + 1 < n->insn_count && is_ball(n, i) &&
	    n->insns[i + 1].op == OP_SUM;
}

/* Runs are read from their beginnings only: of one, the later members have
 * runs too, shorter by as many. */
static void prepare_balls(struct native *n)
{
	size_t count = n->insn_count;

	n->balls = allocate((count + 1) * sizeof(*n->balls));
	n->runs = allocate((count + 2) * sizeof(*n->runs));
	for (size_t i = 0; i < count; i++) {
		const float *p = n->params + n->insns[i].param;

		if (!is_ball(n, i))
			continue;
		n->runs[i].balls = n->balls + n->ball_count;
		n->balls[n->ball_count++] = (struct native_ball){
			{p[0], p[1], p[2]}, p[3], p[5], -6.0f * p[3] * p[5]};
	}
	for (size_t i = count; i-- > 0;)
		if (is_added(n, i))
			n->runs[i].count = 1 + n->runs[i + 2].count;
	n->is_straight = count % 2 == 1 && is_ball(n, 0) &&
	    (count == 1 || n->runs[1].count == count / 2);
}

struct native *native_create(const struct tape *tape,
    const struct table *const *tables)
{
	struct native *n = allocate(sizeof(*n));

	for (size_t i = 0; i < tape->insn_count; i++)
		if (!is_plain(tape->insns + i)) {
			free(n);
			return NULL;
		}
	n->insns = tape->insns;
	n->insn_count = tape->insn_count;
	n->params = allocate((tape->param_count + 16) * sizeof(float));
	for (size_t i = 0; i < tape->param_count; i++)
		n->params[i] = (float)tape->params[i];
	n->operator_count = tape->operator_count;
	n->operators = allocate(n->operator_count * sizeof(*n->operators));
	for (size_t i = 0; i < tape->operator_count; i++)
		prepare_operator(tape->operators + i, tables[i],
		    n->operators + i);
	prepare_balls(n);
	return n;
}

void native_free(struct native *n)
{
	if (!n)
		return;
	for (size_t i = 0; i < n->operator_count; i++)
		free(n->operators[i].opening);
	free(n->operators);
	free(n->params);
	free(n->balls);
	free(n->runs);
	free(n);
}

bool native_is_straight(const struct native *n)
{
	return n->is_straight;
}

/* A batch that threads take chunks of. */
struct batch {
	const struct native *native;
	struct native_share share;
	void (*evaluate)(const struct native *n, const struct native_share *s);
	atomic_size_t next;
};

static void *take_chunks(void *batch)
{
	struct batch *b = batch;
	size_t count = b->share.last;

	for (;;) {
		struct native_share s = b->share;

		s.first = atomic_fetch_add(&b->next, CHUNK);
		s.last = s.first + CHUNK < count ? s.first + CHUNK : count;
		if (s.first >= count)
			return NULL;
		b->evaluate(b->native, &s);
	}
}

static void share_out(struct batch *b)
{
	pthread_t threads[NATIVE_THREADS - 1];

	if (b->share.last < 2 * CHUNK) {
		b->evaluate(b->native, &b->share);
		return;
	}
	for (int i = 0; i < NATIVE_THREADS - 1; i++)
		if (pthread_create(threads + i, NULL, take_chunks, b))
			abort();
	take_chunks(b);
	for (int i = 0; i < NATIVE_THREADS - 1; i++)
		pthread_join(threads[i], NULL);
}

void native_evaluate(const struct native *n, const float *points,
    size_t count, unsigned outputs, float *rows)
{
	struct batch b = {.native = n, .evaluate = kind()->evaluate,
		.share = {points, rows, 0, count, outputs}};

	share_out(&b);
}

void native_straight(const struct native *n, const float *points,
    size_t count, float *rows)
{
	struct batch b = {.native = n, .evaluate = kind()->straight,
		.share = {points, rows, 0, count,
		OUTPUT_VALUE | OUTPUT_GRADIENT}};

	share_out(&b);
}
