#include "core/locate.h"

#include <string.h>

#include "core/evaluate.h"
#include "core/operator.h"
#include "core/tape.h"
#include "core/tree.h"

/* From warp node w's own frame to its child's parent frame. */
static struct vec3 through_warp(const struct warp *w, struct vec3 p)
{
	double params[WARP_PARAMS_MAX];
	struct warp_jet jet;

	warp_prepare(w, params);
	warp_eval(w->type, params, p, 0, &jet);
	return jet.point;
}

struct vec3 locate_point(const struct node *node, struct vec3 p)
{
	struct affine inverse;

	if (node->parent != NULL) {
		p = locate_point(node->parent, p);
		if (node->parent->type == NODE_WARP)
			p = through_warp(&node->parent->warp, p);
	}
	if (node->has_transform && affine_invert(&node->transform, &inverse))
		p = affine_point(&inverse, p);
	return p;
}

enum err locate_child(const struct node *node, size_t i, double null_gradient,
    size_t max_nodes, struct vec3 p, int order, struct jet *out)
{
	const struct tree below = {.root = node->children[i],
	    .null_gradient = null_gradient};
	struct tape_error error;
	struct tape *tape;
	enum err err = tape_compile(&below, max_nodes, &tape, &error);

	if (err != ERR_OK)
		return err;
	evaluate(tape, p, order, out);
	tape_free(tape);
	return ERR_OK;
}

static const struct node *find(const struct node *node, const char *id)
{
	const struct node *found = NULL;

	if (node->id != NULL && strcmp(node->id, id) == 0)
		return node;
	for (size_t i = 0; i < node->child_count && found == NULL; i++)
		found = find(node->children[i], id);
	return found;
}

const struct node *locate_node(const struct tree *tree, const char *id)
{
	return find(tree->root, id);
}

/* ---- where a blend ends ---- */

#define PI 3.14159265358979323846

/* Where a blend is asked for. */
struct spot {
	const struct node *node;
	double null_gradient;
	size_t max_nodes;
	struct vec3 own; /* the point in node's own frame */
};

/* The larger of two children and the other. */
struct pair {
	size_t child[2];
	struct jet jet[2];
};

static enum err read_child(const struct spot *s, size_t i, struct jet *out)
{
	return locate_child(s->node, i, s->null_gradient, s->max_nodes, s->own,
	    1, out);
}

static void swap(struct pair *p)
{
	const struct pair old = *p;

	for (int i = 0; i < 2; i++) {
		p->child[i] = old.child[1 - i];
		p->jet[i] = old.jet[1 - i];
	}
}

static enum err read_two(const struct spot *s, const size_t *children,
    struct pair *out)
{
	enum err err = ERR_OK;

	for (int i = 0; i < 2 && err == ERR_OK; i++) {
		out->child[i] = children[i];
		err = read_child(s, children[i], &out->jet[i]);
	}
	if (err == ERR_OK && out->jet[1].value > out->jet[0].value)
		swap(out);
	return err;
}

/* The two largest of all children. */
static enum err read_largest(const struct spot *s, struct pair *out)
{
	static const size_t first[2] = {0, 1};
	enum err err = read_two(s, first, out);

	for (size_t i = 2; i < s->node->child_count && err == ERR_OK; i++) {
		struct jet jet;

		err = read_child(s, i, &jet);
		if (err != ERR_OK || jet.value <= out->jet[1].value)
			continue;
		out->child[1] = i;
		out->jet[1] = jet;
		if (jet.value > out->jet[0].value)
			swap(out);
	}
	return err;
}

/* The angle between two vectors; false if one is 0. */
static bool angle_between(struct vec3 a, struct vec3 b, double *out)
{
	double la = vec3_norm(a), lb = vec3_norm(b);

	if (!(la > 0.0 && lb > 0.0))
		return false;
	a = vec3_scale(1.0 / la, a);
	b = vec3_scale(1.0 / lb, b);
	*out = atan2(vec3_norm(vec3_cross(a, b)), vec3_dot(a, b));
	return true;
}

/* Which alpha of opening is nearest to alpha; of equal ones, which are a jump,
 * the one on alpha's side. */
static int nearest(const struct opening *opening, double alpha)
{
	int best = 0;

	for (int i = 1; i < 3; i++)
		if (fabs(opening->alpha[i] - alpha) <
		    fabs(opening->alpha[best] - alpha) ||
		    (opening->alpha[i] == opening->alpha[best] &&
		    alpha > opening->alpha[i]))
			best = i;
	return best;
}

enum err locate_blend(const struct node *node, const size_t *children,
    double null_gradient, size_t max_nodes, struct vec3 p,
    struct locate_blend *out)
{
	const struct spot spot = {node, null_gradient, max_nodes,
	    locate_point(node, p)};
	struct locate_blend b = {.parameter = -1};
	struct pair pair;
	enum err err = children != NULL ? read_two(&spot, children, &pair)
	    : read_largest(&spot, &pair);

	if (err != ERR_OK)
		return err;
	for (int i = 0; i < 2; i++) {
		b.children[i] = pair.child[i];
		b.values[i] = pair.jet[i].value;
	}
	b.theta = fmin(atan(2.0 * b.values[1]), 0.25 * PI);
	b.has_alpha = angle_between(pair.jet[0].gradient,
	    pair.jet[1].gradient, &b.alpha);
	if (node->op != NULL && opening_is_constant(&node->op->opening))
		b.parameter = LOCATE_CONSTANT;
	else if (b.has_alpha && node->op != NULL)
		b.parameter = nearest(&node->op->opening, b.alpha);
	*out = b;
	return ERR_OK;
}
