/*
 * One scan of the list with a stack of what its jets' instructions have become:
 * where they begin in the result, and which frame and colour held before, so
 * that they can be cut off again.
 */
#include "core/prune.h"

#include <assert.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* What a composition does with an operand that is 0. */
enum rule {
	RULE_STATE,  /* none: FRAME, COLOR, ENTER */
	RULE_PUSH,
	RULE_CHANGE, /* CARRY */
	RULE_LEAVE,
	RULE_EITHER, /* is the other one */
	RULE_BOTH,   /* is 0 */
	RULE_FIRST,  /* is 0 of the first operand, something of the second */
	RULE_SECOND, /* the same, swapped */
	RULE_NONE    /* may be anything */
};

static const unsigned char rules[OP_COUNT] = {
	[OP_FRAME] = RULE_STATE, [OP_COLOR] = RULE_STATE,
	[OP_ENTER] = RULE_STATE, [OP_CARRY] = RULE_CHANGE,
	[OP_LEAVE] = RULE_LEAVE,
	[OP_POINT] = RULE_PUSH, [OP_SEGMENT] = RULE_PUSH,
	[OP_TRIANGLE] = RULE_PUSH, [OP_DISC] = RULE_PUSH,
	[OP_CIRCLE] = RULE_PUSH, [OP_SPHERE] = RULE_PUSH,
	[OP_BOX] = RULE_PUSH, [OP_CYLINDER] = RULE_PUSH,
	[OP_CAPSULE] = RULE_PUSH, [OP_CONE] = RULE_PUSH,
	[OP_TORUS] = RULE_PUSH, [OP_PLANE] = RULE_PUSH,
	[OP_CAUCHY_POINT] = RULE_PUSH, [OP_CAUCHY_SEGMENT] = RULE_PUSH,
	[OP_CAUCHY_TRIANGLE] = RULE_PUSH, [OP_VOLUME] = RULE_PUSH,
	[OP_ZERO] = RULE_PUSH,
	[OP_MAX] = RULE_EITHER, [OP_SUM] = RULE_EITHER,
	[OP_RICCI] = RULE_EITHER, [OP_UNION] = RULE_EITHER,
	[OP_MIN] = RULE_BOTH, [OP_INTERSECTION] = RULE_BOTH,
	[OP_MINUS] = RULE_FIRST, [OP_DIFFERENCE] = RULE_FIRST,
	[OP_MINUS_SWAPPED] = RULE_SECOND, [OP_DIFFERENCE_SWAPPED] = RULE_SECOND,
	[OP_CLASSIC] = RULE_NONE, [OP_CLASSIC_SWAPPED] = RULE_NONE,
};

static const struct tape_box nowhere = {
	{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

/* Instructions of the list that set frame and colour, or: */
#define AS_IT_BEGAN SIZE_MAX   /* none has */
#define NOT_KNOWN (SIZE_MAX - 1)

struct state {
	size_t frame, color;
};

/* The instructions of a jet, or of a warp entered: from begin on, if it is not
 * dropped; before them the result had state. */
struct piece {
	size_t begin;
	struct state state;
	bool alive;
};

/* Four numbers that are compared at once. */
typedef float lanes __attribute__((vector_size(16)));
typedef int32_t lane_masks __attribute__((vector_size(16)));

/* A box as other boxes are compared with it: overlapping quarters of theirs,
 * min[0] to max[0] and min[2] to max[2], each have a lane of no account. */
struct probe {
	lanes most, least;
};

#define QUARTER (2 * sizeof(float))

static struct probe probe_of(const struct tape_box *b)
{
	return (struct probe){
	    {b->max[0], b->max[1], b->max[2], INFINITY},
	    {-INFINITY, b->min[0], b->min[1], b->min[2]}};
}

/* A primitive with what is done to it alone, and the union or sum that takes it:
 * without it nothing changes. */
struct term {
	size_t first, last; /* the primitive, the composition */
	struct state wants;
};

/* Terms that are looked at before those alive are kept: no branch depends on
 * which they are. */
#define TERMS 64

/* Terms of an index that are compared at once, a row: six sides of their boxes,
 * each of all of them. */
#define ROW 16

struct row {
	float min[3][ROW], max[3][ROW];
};

/* Terms in a row, of instructions begin to end, and what they end with. */
struct chain {
	size_t begin, end;
	size_t first, count; /* of the terms; first is a row's */
	struct state wants;
};

/* Chains shorter than this are not worth an entry. */
#define CHAIN_LEAST 32

/* A term's state: what held when its chain began. */
#define INHERITED (SIZE_MAX - 2)

struct prune_index {
	struct chain *chains;
	size_t chain_count, chain_max;
	struct term *terms;
	struct row *rows;
	size_t term_count, term_max; /* whole rows */
};

struct scan {
	const struct prune_list *from;
	const struct chain *chain, *chains_end; /* the next one */
	struct probe probe;
	struct insn *insns; /* the result's */
	struct tape_box *boxes;
	size_t count;
	struct state has, wants; /* of the result so far, of the list so far */
	struct piece jets[TAPE_STACK_MAX], *end;
	struct piece warps[TAPE_WARPS_MAX], *warp;
};

static inline bool meets(const struct tape_box *b, const struct probe *probe)
{
	lanes low, high;
	lane_masks all;
	uint64_t halves[2];

	memcpy(&low, b, sizeof(low));
	memcpy(&high, (const char *)b + QUARTER, sizeof(high));
	all = (low <= probe->most) & (high >= probe->least);
	memcpy(halves, &all, sizeof(halves));
	return (halves[0] & halves[1]) == UINT64_MAX;
}

static inline void keep(struct scan *s, size_t i)
{
	s->insns[s->count] = s->from->insns[i];
	s->boxes[s->count++] = s->from->boxes[i];
}

/* Drops everything from where p began. */
static inline void cut(struct scan *s, struct piece *p)
{
	s->count = p->begin;
	s->has = p->state;
	p->alive = false;
}

/* A primitive that is alive, in its frame and colour. */
static inline void keep_primitive(struct scan *s, size_t i)
{
	if (s->has.frame != s->wants.frame) {
		s->has.frame = s->wants.frame;
		keep(s, s->has.frame);
	}
	if (s->has.color != s->wants.color) {
		s->has.color = s->wants.color;
		keep(s, s->has.color);
	}
	keep(s, i);
}

static inline void push(struct scan *s, size_t i)
{
	struct piece *p = s->end++;

	p->begin = s->count;
	p->state = s->has;
	p->alive = meets(s->from->boxes + i, &s->probe);
	if (p->alive)
		keep_primitive(s, i);
}

/*
 * Finds terms from instruction i on, up to something else; those that are alive
 * to terms, how many to *alive. Returns the next instruction.
 */
static size_t find_terms(struct scan *s, size_t i,
    struct term terms[static TERMS + 1], size_t *alive)
{
	const struct insn *insns = s->from->insns;
	const struct tape_box *boxes = s->from->boxes;
	const struct probe probe = s->probe;
	struct state wants = s->wants;
	size_t n = 0, end = s->from->count;

	while (n < TERMS && i + 1 < end) {
		unsigned rule = rules[insns[i].op], next;
		size_t last = i + 1;

		if (rule != RULE_PUSH) {
			if (insns[i].op == OP_FRAME)
				wants.frame = i++;
			else if (insns[i].op == OP_COLOR)
				wants.color = i++;
			else
				break;
			continue;
		}
		next = rules[insns[last].op];
		if (next == RULE_CHANGE && i + 2 < end)
			next = rules[insns[++last].op];
		if (next != RULE_EITHER)
			break;
		terms[n] = (struct term){i, last, wants};
		n += meets(boxes + i, &probe);
		i = last + 1;
	}
	s->wants = wants;
	*alive = n;
	return i;
}

/* The last instruction kept, whose OP_SUM is dropped, is in no pair. */
static inline void part_pair(struct scan *s)
{
	struct insn *last = s->insns + s->count - 1;

	if (last->op == OP_POINT)
		last->index = 0;
}

static void keep_term(struct scan *s, const struct term *t)
{
	struct piece *a = s->end - 1;

	s->wants = t->wants;
	keep_primitive(s, t->first);
	if (t->first + 1 < t->last)
		keep(s, t->first + 1);
	if (a->alive)
		keep(s, t->last);
	else
		part_pair(s);
	a->alive = true;
}

/* From instruction i on; the next one. */
static size_t add_terms(struct scan *s, size_t i)
{
	struct term terms[TERMS + 1];
	size_t count, next = find_terms(s, i, terms, &count);
	struct state wants = s->wants;

	for (size_t k = 0; k < count; k++)
		keep_term(s, terms + k);
	s->wants = wants;
	return next;
}

/* Keeps a term of a chain that began with state. */
static void keep_chained(struct scan *s, const struct term *t,
    const struct state *began)
{
	struct term term = *t;

	if (term.wants.frame == INHERITED)
		term.wants.frame = began->frame;
	if (term.wants.color == INHERITED)
		term.wants.color = began->color;
	keep_term(s, &term);
}

/* Whether boxes of a row meet s's: of each all bits are set, or none. False:
 * none does. */
static inline bool meet_row(const struct row *row, const struct probe *probe,
    uint32_t hits[static ROW])
{
	uint64_t some = 0, halves[2];

	for (size_t k = 0; k < ROW; k += 4) {
		lane_masks all = {-1, -1, -1, -1};
		lanes side;

		for (int a = 0; a < 3; a++) {
			memcpy(&side, row->min[a] + k, sizeof(side));
			all &= side <= probe->most[a];
			memcpy(&side, row->max[a] + k, sizeof(side));
			all &= side >= probe->least[a + 1];
		}
		memcpy(hits + k, &all, sizeof(all));
		memcpy(halves, &all, sizeof(halves));
		some |= halves[0] | halves[1];
	}
	return some != 0;
}

/* The chain that begins here; the next instruction. */
static size_t add_chain(struct scan *s, const struct prune_index *x)
{
	const struct chain *c = s->chain++;
	const struct probe probe = s->probe;
	const struct state began = s->wants;
	uint32_t hits[ROW];

	for (size_t k = 0; k < c->count; k += ROW) {
		size_t at = c->first + k;
		size_t n = c->count - k < ROW ? c->count - k : ROW;

		if (!meet_row(x->rows + at / ROW, &probe, hits))
			continue;
		for (size_t j = 0; j < n; j++)
			if (hits[j])
				keep_chained(s, x->terms + at + j, &began);
	}
	s->wants = began;
	if (c->wants.frame != INHERITED)
		s->wants.frame = c->wants.frame;
	if (c->wants.color != INHERITED)
		s->wants.color = c->wants.color;
	return c->end;
}

/* OP_ZERO in front of what is from place on. */
static void insert_zero(struct scan *s, size_t place)
{
	size_t after = s->count++ - place;

	memmove(s->insns + place + 1, s->insns + place,
	    after * sizeof(*s->insns));
	memmove(s->boxes + place + 1, s->boxes + place,
	    after * sizeof(*s->boxes));
	s->insns[place] = (struct insn){.op = OP_ZERO};
	s->boxes[place] = nowhere;
}

static void enter(struct scan *s, size_t i)
{
	assert(s->warp < s->warps + TAPE_WARPS_MAX);
	*s->warp++ = (struct piece){s->count, s->has, true};
	keep(s, i);
	s->has.frame = s->wants.frame = NOT_KNOWN;
}

static void leave(struct scan *s, size_t i)
{
	struct piece *warp = --s->warp, *jet = s->end - 1;
	bool alive = jet->alive;

	*jet = *warp;
	if (!alive) {
		cut(s, jet);
		return;
	}
	keep(s, i);
	s->has.frame = s->wants.frame = NOT_KNOWN;
}

static void set_state(struct scan *s, size_t i, unsigned op)
{
	if (op == OP_FRAME)
		s->wants.frame = i;
	else if (op == OP_COLOR)
		s->wants.color = i;
	else
		enter(s, i);
}

/* A composition of which an operand is 0; a: the first on the stack. */
static void compose_zero(struct scan *s, size_t i, unsigned rule,
    struct piece *a, const struct piece *b)
{
	bool first = rule == RULE_SECOND ? b->alive : a->alive;

	if (rule == RULE_EITHER) {
		if (b->alive)
			part_pair(s);
		a->alive |= b->alive;
		return;
	}
	if (rule == RULE_BOTH || (rule != RULE_NONE && !first)) {
		cut(s, a);
		return;
	}
	if (!a->alive)
		insert_zero(s, a->begin);
	if (!b->alive)
		insert_zero(s, s->count);
	a->alive = true;
	keep(s, i);
}

static inline void compose(struct scan *s, size_t i, unsigned rule)
{
	struct piece *b = --s->end, *a = b - 1;

	if ((rule == RULE_BOTH || rule == RULE_NONE) &&
	    !meets(s->from->boxes + i, &s->probe))
		cut(s, a);
	else if (!a->alive || !b->alive)
		compose_zero(s, i, rule, a, b);
	else
		keep(s, i);
}

static inline void step(struct scan *s, size_t i)
{
	unsigned op = s->from->insns[i].op, rule = rules[op];

	if (rule == RULE_PUSH)
		push(s, i);
	else if (rule >= RULE_EITHER)
		compose(s, i, rule);
	else if (rule == RULE_STATE)
		set_state(s, i, op);
	else if (rule == RULE_LEAVE)
		leave(s, i);
	else if (s->end[-1].alive)
		keep(s, i);
}

void prune_operands(const struct prune_list *from, const struct tape_box *box,
    struct prune_list *out)
{
	const struct state none = {AS_IT_BEGAN, AS_IT_BEGAN};
	struct scan s;

	s.from = from;
	s.probe = probe_of(box);
	s.insns = out->insns;
	s.boxes = out->boxes;
	s.count = 0;
	s.has = s.wants = none;
	s.end = s.jets;
	s.warp = s.warps;
	s.chain = from->index ? from->index->chains : NULL;
	s.chains_end = s.chain ? s.chain + from->index->chain_count : NULL;
	for (size_t i = 0; i < from->count;) {
		size_t next;

		if (s.chain < s.chains_end && i == s.chain->begin)
			next = add_chain(&s, from->index);
		else
			next = add_terms(&s, i);
		if (next == i)
			step(&s, next++);
		i = next;
	}
	if (!s.jets[0].alive) {
		s.count = 0;
		insert_zero(&s, 0);
	}
	out->count = s.count;
}

/* The orders that insn, of extra, asks of its operands. */
static unsigned asks(const struct insn *insn, unsigned extra,
    const bool *is_constant)
{
	if (insn->op >= OP_UNION && !is_constant[insn->index])
		extra++;
	return extra < 2 ? extra : 2;
}

/* From the end: what has not been asked for yet is on the stack, deepest
 * first. */
void prune_orders(struct prune_list *list, const bool *is_constant)
{
	unsigned jets[TAPE_STACK_MAX + 1] = {0}, warps[TAPE_WARPS_MAX];
	size_t jet = 1, warp = 0;
	unsigned last = 0; /* of the primitive that FRAME and COLOR precede */

	for (size_t i = list->count; i-- > 0;) {
		struct insn *insn = list->insns + i;
		unsigned rule = rules[insn->op];

		if (rule == RULE_PUSH) {
			insn->extra = last = jets[--jet];
		} else if (rule >= RULE_EITHER) {
			insn->extra = jets[jet - 1];
			jets[jet - 1] = asks(insn, insn->extra, is_constant);
			jets[jet] = jets[jet - 1];
			jet++;
		} else if (insn->op == OP_ENTER) {
			insn->extra = warps[--warp];
		} else if (rule == RULE_STATE) {
			insn->extra = last;
		} else {
			insn->extra = jets[jet - 1];
			if (rule == RULE_LEAVE)
				warps[warp++] = insn->extra;
		}
	}
}

void prune(const struct prune_list *from, const struct tape_box *box,
    const bool *is_constant, struct prune_list *out)
{
	prune_operands(from, box, out);
	prune_orders(out, is_constant);
}

/* ---- an index ---- */

/* Room for so many more terms, in whole rows. */
static bool reserve_terms(struct prune_index *x, size_t more)
{
	size_t most = 2 * x->term_max;
	struct term *terms;
	struct row *rows;

	if (x->term_count + more <= x->term_max)
		return true;
	if (most < x->term_count + more)
		most = x->term_count + more;
	most = (most + ROW - 1) / ROW * ROW;
	terms = realloc(x->terms, most * sizeof(*terms));
	if (!terms)
		return false;
	x->terms = terms;
	rows = realloc(x->rows, most / ROW * sizeof(*rows));
	if (!rows)
		return false;
	x->rows = rows;
	x->term_max = most;
	return true;
}

static void put_box(struct prune_index *x, size_t at,
    const struct tape_box *b)
{
	struct row *row = x->rows + at / ROW;

	for (int a = 0; a < 3; a++) {
		row->min[a][at % ROW] = b->min[a];
		row->max[a][at % ROW] = b->max[a];
	}
}

static bool put_terms(struct prune_index *x, const struct prune_list *list,
    const struct term *terms, size_t count)
{
	if (!reserve_terms(x, count + ROW))
		return false;
	for (size_t k = 0; k < count; k++) {
		x->terms[x->term_count] = terms[k];
		put_box(x, x->term_count++, list->boxes + terms[k].first);
	}
	return true;
}

/* A chain's end: one that is long enough is an entry, others are forgotten. */
static bool put_chain(struct prune_index *x, const struct chain *c)
{
	size_t most = 2 * x->chain_max + 1;
	struct chain *chains;

	if (x->term_count - c->first < CHAIN_LEAST) {
		x->term_count = c->first;
		return true;
	}
	if (x->chain_count == x->chain_max) {
		chains = realloc(x->chains, most * sizeof(*chains));
		if (!chains)
			return false;
		x->chains = chains;
		x->chain_max = most;
	}
	x->chains[x->chain_count] = *c;
	x->chains[x->chain_count++].count = x->term_count - c->first;
	for (; x->term_count % ROW; x->term_count++)
		put_box(x, x->term_count, &nowhere);
	return true;
}

/* The terms from *i on, as find_terms has them where all are alive; the next
 * instruction. */
static bool index_chain(struct prune_index *x, struct scan *s, size_t *i)
{
	struct chain c = {.begin = *i, .first = x->term_count};
	struct term terms[TERMS + 1];
	size_t count, next;

	s->wants = (struct state){INHERITED, INHERITED};
	for (;; c.end = *i = next) {
		next = find_terms(s, *i, terms, &count);
		if (!put_terms(x, s->from, terms, count))
			return false;
		if (next == *i)
			break;
	}
	c.wants = s->wants;
	return *i == c.begin || put_chain(x, &c);
}

enum err prune_index_create(const struct prune_list *list,
    struct prune_index **out)
{
	static const struct tape_box everywhere = {
		{-INFINITY, -INFINITY, -INFINITY},
		{INFINITY, INFINITY, INFINITY}};
	struct prune_index *x = calloc(1, sizeof(*x));
	struct scan s = {.from = list, .probe = probe_of(&everywhere)};

	if (!x)
		return ERR_MEMORY;
	for (size_t i = 0; i < list->count; i++)
		if (!index_chain(x, &s, &i)) {
			prune_index_free(x);
			return ERR_MEMORY;
		}
	*out = x;
	return ERR_OK;
}

void prune_index_free(struct prune_index *x)
{
	if (!x)
		return;
	free(x->chains);
	free(x->terms);
	free(x->rows);
	free(x);
}

size_t prune_index_bytes(const struct prune_index *x)
{
	return sizeof(*x) + x->chain_max * sizeof(*x->chains) + x->term_max *
	    (sizeof(*x->terms) + sizeof(*x->rows) / ROW);
}
