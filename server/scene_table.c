#include "server/scene_table.h"

#include <stdlib.h>
#include <string.h>

static void free_slot(struct scene_slot *slot)
{
	if (slot->scene != NULL)
		scene_release(slot->scene);
	free(slot->past);
	free(slot);
}

void scene_table_fini(struct scene_table *table)
{
	for (size_t i = 0; i < table->count; i++)
		free_slot(table->slots[i]);
	free(table->slots);
	*table = (struct scene_table){.history = table->history,
	    .history_bytes = table->history_bytes};
}

size_t scene_table_place(const struct scene_table *table, const char *id,
    bool *there)
{
	size_t low = 0, high = table->count;

	while (low < high) {
		size_t middle = low + (high - low) / 2;

		if (strcmp(table->slots[middle]->id, id) < 0)
			low = middle + 1;
		else
			high = middle;
	}
	*there = low < table->count && strcmp(table->slots[low]->id, id) == 0;
	return low;
}

struct scene_slot *scene_table_find(const struct scene_table *table,
    const char *id)
{
	bool there;
	size_t at = scene_table_place(table, id, &there);

	return there ? table->slots[at] : NULL;
}

/* Room for one more. */
static enum err grow(struct scene_table *table)
{
	size_t size = table->size > 0 ? 2 * table->size : 16;
	struct scene_slot **slots;

	if (table->count < table->size)
		return ERR_OK;
	slots = realloc(table->slots, size * sizeof *slots);
	if (slots == NULL)
		return ERR_MEMORY;
	table->slots = slots;
	table->size = size;
	return ERR_OK;
}

enum err scene_table_add(struct scene_table *table, const char *id,
    struct scene_slot **out)
{
	struct scene_slot *slot;
	bool there;
	size_t at = scene_table_place(table, id, &there);

	if (there) {
		*out = table->slots[at];
		return ERR_OK;
	}
	slot = calloc(1, sizeof *slot);
	if (slot == NULL || grow(table) != ERR_OK) {
		free(slot);
		return ERR_MEMORY;
	}
	strncpy(slot->id, id, SCENE_ID_MAX);
	memmove(table->slots + at + 1, table->slots + at,
	    (table->count - at) * sizeof *table->slots);
	table->slots[at] = slot;
	table->count++;
	*out = slot;
	return ERR_OK;
}

/* Forgets the oldest of past. */
static void trim(struct scene_slot *slot, size_t over)
{
	if (over == 0)
		return;
	for (size_t i = 0; i < over; i++)
		slot->past_bytes -= slot->past[i].length;
	slot->trimmed = slot->past[over - 1].seq;
	slot->past_count -= over;
	memmove(slot->past, slot->past + over,
	    slot->past_count * sizeof *slot->past);
}

void scene_table_forget_before(struct scene_slot *slot, struct scene_seq seq)
{
	size_t over = 0;

	while (over < slot->past_count &&
	    scene_seq_compare(slot->past[over].seq, seq) < 0)
		over++;
	trim(slot, over);
}

/* How many of the oldest are beyond what may be kept. */
static size_t count_over(const struct scene_table *table,
    const struct scene_slot *slot)
{
	size_t last = slot->past_count - 1, over = 0;
	size_t bytes = slot->past_bytes - slot->past[last].length;

	while (over < last && (slot->past_count - over > table->history ||
	    (table->history_bytes > 0 && bytes > table->history_bytes)))
		bytes -= slot->past[over++].length;
	return over;
}

enum err scene_table_remember(struct scene_table *table,
    struct scene_slot *slot, const struct scene_past *past)
{
	struct scene_past *grown = realloc(slot->past,
	    (slot->past_count + 1) * sizeof *grown);
	size_t at = slot->past_count;

	if (grown == NULL)
		return ERR_MEMORY;
	slot->past = grown;
	while (at > 0 && scene_seq_compare(grown[at - 1].seq, past->seq) > 0)
		at--;
	if (at > 0 && scene_seq_compare(grown[at - 1].seq, past->seq) == 0) {
		grown[at - 1].has_gap &= past->has_gap;
		return ERR_OK;
	}
	memmove(grown + at + 1, grown + at,
	    (slot->past_count - at) * sizeof *grown);
	grown[at] = *past;
	slot->past_count++;
	slot->past_bytes += past->length;
	trim(slot, count_over(table, slot));
	return ERR_OK;
}

size_t scene_table_past_bytes(const struct scene_table *table)
{
	size_t bytes = 0;

	for (size_t i = 0; i < table->count; i++) {
		const struct scene_slot *slot = table->slots[i];

		if (slot->past_count > 0)
			bytes += slot->past_bytes -
			    slot->past[slot->past_count - 1].length;
	}
	return bytes;
}

/* Takes scene out of the sums. */
static void discount(struct scene_table *table, const struct scene *scene)
{
	table->bytes -= scene->bytes;
	table->unusable -= scene->program == NULL;
}

void scene_table_set(struct scene_table *table, struct scene_slot *slot,
    struct scene *scene)
{
	struct scene *old = slot->scene;

	slot->scene = scene_hold(scene);
	table->bytes += scene->bytes;
	table->unusable += scene->program == NULL;
	if (old != NULL) {
		discount(table, old);
		scene_release(old);
	}
}

void scene_table_remove(struct scene_table *table, const char *id)
{
	bool there;
	size_t at = scene_table_place(table, id, &there);

	if (!there)
		return;
	if (table->slots[at]->scene != NULL)
		discount(table, table->slots[at]->scene);
	free_slot(table->slots[at]);
	memmove(table->slots + at, table->slots + at + 1,
	    (--table->count - at) * sizeof *table->slots);
}

struct scene_past scene_table_past_of(const struct scene *scene,
    bool is_first)
{
	struct scene_past past = {.is_first = is_first, .seq = scene->seq,
	    .time = scene->time, .nodes = scene->nodes,
	    .length = scene->length};

	memcpy(past.etag, scene->etag, ETAG_SIZE);
	return past;
}
