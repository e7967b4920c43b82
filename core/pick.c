/*
 * Down the tree with the point carried into each node's frame. What the children
 * of a composition are worth there says a tape of each, compiled when the
 * composition is first met.
 */
#include "core/pick.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/evaluate.h"
#include "core/tape.h"
#include "core/tree.h"

#define BUCKETS 1024

/* A composition's children; NULL: cannot be compiled by itself, counts as 0. */
struct group {
	const struct node *node;
	struct group *next; /* in its bucket */
	struct tape *tapes[];
};

struct picker {
	const struct tree *tree;
	size_t max_nodes;
	struct group *buckets[BUCKETS];
};

static void group_free(struct group *g)
{
	for (size_t i = 0; i < g->node->child_count; i++)
		tape_free(g->tapes[i]);
	free(g);
}

enum err picker_create(const struct tree *tree, size_t max_nodes,
    struct picker **out)
{
	struct picker *p = calloc(1, sizeof *p);

	if (p == NULL)
		return ERR_MEMORY;
	p->tree = tree;
	p->max_nodes = max_nodes;
	*out = p;
	return ERR_OK;
}

void picker_free(struct picker *p)
{
	if (p == NULL)
		return;
	for (size_t i = 0; i < BUCKETS; i++) {
		struct group *next;

		for (struct group *g = p->buckets[i]; g != NULL; g = next) {
			next = g->next;
			group_free(g);
		}
	}
	free(p);
}

static enum err compile_children(const struct picker *p, struct group *g)
{
	for (size_t i = 0; i < g->node->child_count; i++) {
		const struct tree below = {.root = g->node->children[i],
		    .null_gradient = p->tree->null_gradient};
		struct tape_error error;
		enum err err = tape_compile(&below, p->max_nodes,
		    g->tapes + i, &error);

		if (err == ERR_INVALID)
			g->tapes[i] = NULL;
		else if (err)
			return err;
	}
	return ERR_OK;
}

static enum err find_group(struct picker *p, const struct node *node,
    struct group **out)
{
	struct group **at = p->buckets + ((uintptr_t)node >> 6) % BUCKETS, *g;
	enum err err;

	for (g = *at; g != NULL; g = g->next)
		if (g->node == node) {
			*out = g;
			return ERR_OK;
		}
	g = calloc(1, sizeof *g + node->child_count * sizeof(struct tape *));
	if (g == NULL)
		return ERR_MEMORY;
	g->node = node;
	err = compile_children(p, g);
	if (err) {
		group_free(g);
		return err;
	}
	g->next = *at;
	*out = *at = g;
	return ERR_OK;
}

static bool holds(const struct tape_box *b, struct vec3 x)
{
	return x.x >= b->min[0] && x.x <= b->max[0] && x.y >= b->min[1] &&
	    x.y <= b->max[1] && x.z >= b->min[2] && x.z <= b->max[2];
}

static double value_of(const struct tape *tape, struct vec3 x)
{
	const struct tape_box *last;
	struct jet f;

	if (tape == NULL)
		return 0.0;
	last = tape->boxes + tape->insn_count - 1;
	if (tape->insns[tape->insn_count - 1].op >= OP_PRIMITIVES &&
	    !holds(last, x))
		return 0.0;
	evaluate(tape, x, 0, &f);
	return f.value;
}

/* Which of the children decides at x. */
static size_t decides(const struct group *g, struct vec3 x)
{
	const enum node_type type = g->node->type;
	double best = value_of(g->tapes[0], x);
	size_t out = 0;

	if (type == NODE_INTERSECTION || type == NODE_DIFFERENCE) {
		if (!(best > 0.0))
			return 0;
	}
	for (size_t i = 1; i < g->node->child_count; i++) {
		double value = value_of(g->tapes[i], x);

		if (type == NODE_DIFFERENCE)
			value = 1.0 - value;
		if (type == NODE_INTERSECTION && !(value > 0.0))
			return 0;
		if (type == NODE_INTERSECTION || type == NODE_DIFFERENCE ?
		    value < best : value > best) {
			best = value;
			out = i;
		}
	}
	return out;
}

/* x of node's parent's frame in node's own, and through its warp. */
static struct vec3 enter(const struct node *node, struct vec3 x)
{
	struct affine inverse;

	if (node->has_transform && affine_invert(&node->transform, &inverse))
		x = affine_point(&inverse, x);
	if (node->type == NODE_WARP) {
		double params[WARP_PARAMS_MAX];
		struct warp_jet jet;

		warp_prepare(&node->warp, params);
		warp_eval(node->warp.type, params, x, 0, &jet);
		x = jet.point;
	}
	return x;
}

enum err picker_leaf(struct picker *p, struct vec3 x, const struct node **leaf)
{
	const struct node *node = p->tree->root;

	for (int depth = 0; node->type != NODE_PRIMITIVE; depth++) {
		struct group *g;
		enum err err;

		if (depth > TAPE_NESTING_MAX)
			return ERR_LIMIT;
		x = enter(node, x);
		if (node->type == NODE_REF) {
			node = node->target;
		} else if (node->child_count == 1) {
			node = node->children[0];
		} else {
			err = find_group(p, node, &g);
			if (err)
				return err;
			node = node->children[decides(g, x)];
		}
	}
	*leaf = node;
	return ERR_OK;
}

enum err pick_leaf(const struct tree *tree, size_t max_nodes, struct vec3 p,
    const struct node **leaf)
{
	struct picker *picker;
	enum err err = picker_create(tree, max_nodes, &picker);

	if (err)
		return err;
	err = picker_leaf(picker, p, leaf);
	picker_free(picker);
	return err;
}

static size_t put_pointer(const struct node *node, char *out)
{
	const struct node *parent = node->parent;
	size_t at;

	if (parent == NULL)
		return (size_t)snprintf(out, PICK_POINTER_MAX, "/root");
	at = put_pointer(parent, out);
	if (at + 32 > PICK_POINTER_MAX)
		return at; /* no document nests so deep */
	if (parent->type == NODE_WARP)
		return at + (size_t)sprintf(out + at, "/child");
	return at + (size_t)sprintf(out + at, "/%s/%zu",
	    parent->type == NODE_CONVOLUTION ? "elements" : "children",
	    node->index);
}

void pick_pointer(const struct node *node, char out[static PICK_POINTER_MAX])
{
	put_pointer(node, out);
}

/* Counts primitives from from on, until node; whether it was met. */
static bool count_until(const struct node *from, const struct node *node,
    size_t *count)
{
	if (from == node)
		return true;
	*count += from->type == NODE_PRIMITIVE;
	for (size_t i = 0; i < from->child_count; i++)
		if (count_until(from->children[i], node, count))
			return true;
	return false;
}

size_t pick_ordinal(const struct tree *tree, const struct node *node)
{
	size_t count = 0;

	count_until(tree->root, node, &count);
	return count;
}
