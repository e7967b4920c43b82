/*
 * Ids and what refers to them. Cycles are left to tape_compile, which follows
 * refs anyway.
 */
#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "proto/document_reader.h"

/* A node with an id; order is its place in the document. */
struct entry {
	const struct node *node;
	size_t order;
};

struct index {
	struct entry *entries;
	size_t count;
};

void ref_fault(struct reader *r, const struct json_place *root,
    const struct node *node, const char *member, const char *detail)
{
	/* From the leaf up: a node, then the member it stands in. */
	struct json_place chain[2 * DOCUMENT_DEPTH_MAX + 3];
	struct json_place *at = chain, *last = NULL;

	if (member) {
		*at = json_member(NULL, member);
		last = at++;
	}
	for (; node && node->parent; node = node->parent) {
		const enum node_type type = node->parent->type;

		assert(at + 2 <= chain + sizeof chain / sizeof *chain);
		if (last)
			last->parent = at;
		if (type != NODE_WARP) {
			*at = json_element(at + 1, node->index);
			at++;
		}
		*at = json_member(NULL, type == NODE_WARP ? "child" :
		    type == NODE_CONVOLUTION ? "elements" : "children");
		last = at++;
	}
	if (last)
		last->parent = root;
	reader_fault(r, last ? chain : root, "%s", detail);
}

static int compare_entries(const void *a, const void *b)
{
	const struct entry *x = a, *y = b;
	const int order = strcmp(x->node->id, y->node->id);

	if (order)
		return order;
	return x->order < y->order ? -1 : x->order > y->order;
}

static const struct node *find(const struct index *index, const char *id)
{
	size_t low = 0, high = index->count, middle;
	int order;

	while (low < high) {
		middle = low + (high - low) / 2;
		order = strcmp(index->entries[middle].node->id, id);
		if (order == 0)
			return index->entries[middle].node;
		if (order < 0)
			low = middle + 1;
		else
			high = middle;
	}
	return NULL;
}

static bool build_index(struct reader *r, struct index *index)
{
	const struct item *item;
	size_t order = 0;

	*index = (struct index){
		reader_alloc(r, r->named_count, sizeof *index->entries), 0};
	if (!index->entries)
		return false;
	for (item = r->first; item; item = item->next, order++) {
		if (item->node.id)
			index->entries[index->count++] =
			    (struct entry){&item->node, order};
	}
	if (index->count)
		qsort(index->entries, index->count, sizeof *index->entries,
		    compare_entries);
	return true;
}

void ref_resolve(struct reader *r, const struct json_place *root)
{
	struct index index;
	struct item *item;
	size_t i;

	if (!build_index(r, &index))
		return;
	for (i = 1; i < index.count; i++) {
		if (strcmp(index.entries[i - 1].node->id,
		    index.entries[i].node->id) == 0)
			ref_fault(r, root, index.entries[i].node, "id",
			    "another node has this id already");
	}
	for (item = r->first; item; item = item->next) {
		if (!item->ref)
			continue;
		item->node.target = find(&index, item->ref);
		/* It may be in what could not be read. */
		if (!item->node.target && !r->skipped)
			ref_fault(r, root, &item->node, "ref",
			    "no node has this id");
	}
}
