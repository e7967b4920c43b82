#include "server/program.h"

#include <assert.h>
#include <stdint.h>
#include <stdlib.h>

#include "core/curve.h"
#include "core/descriptor.h"
#include "core/opening_table.h"
#include "core/tape.h"
#include "core/table.h"
#include "server/surface.h"
#include "server/tables.h"

/* That an operator of the program has this table. */
struct use {
	const struct table_entry *entry;
	size_t operator;
};

static int compare_uses(const void *a, const void *b)
{
	const struct use *x = a, *y = b;
	uintptr_t p = (uintptr_t)x->entry, q = (uintptr_t)y->entry;

	return (p > q) - (p < q);
}

/* All uses, those of a table side by side; NULL: no memory. */
static struct use *sort_uses(const struct program *program)
{
	size_t count = program->entry_count;
	struct use *uses = malloc(sizeof *uses * (count + 1));

	for (size_t i = 0; uses != NULL && i < count; i++)
		uses[i] = (struct use){program->entries[i], i};
	if (uses != NULL)
		qsort(uses, count, sizeof *uses, compare_uses);
	return uses;
}

/* The least device memory that its operator tables take together. */
static size_t table_bytes_least(const struct program *program,
    const struct use *uses)
{
	size_t bytes = 0;

	for (size_t i = 0; i < program->entry_count; i++) {
		size_t n = (size_t)program->tape->operators[
		    uses[i].operator].resolution;

		if (i == 0 || uses[i].entry != uses[i - 1].entry)
			bytes += n * n * n * sizeof(float) *
			    (TABLE_FIRST + TABLE_SECOND);
	}
	return bytes;
}

static bool has_drafts(const struct tape *tape)
{
	for (size_t i = 0; i < tape->operator_count; i++) {
		if (tables_has_draft(&tape->operators[i]))
			return true;
	}
	return false;
}

/* Acquires the draft of each of the operators in uses, which have one table,
 * unless one of them is to have it in full. */
static enum err acquire_draft(struct tables *tables, struct program *program,
    const struct use *uses, size_t count)
{
	const struct operator *operators = program->tape->operators;
	enum err err = ERR_OK;

	for (size_t i = 0; i < count; i++) {
		if (!tables_has_draft(&operators[uses[i].operator]))
			return ERR_OK;
	}
	for (size_t i = 0; i < count && err == ERR_OK; i++) {
		size_t k = uses[i].operator;

		err = tables_acquire_draft(tables, &operators[k],
		    &program->drafts[k]);
	}
	return err;
}

/* With entries filled: the drafts, if there are any. */
static enum err acquire_drafts(struct tables *tables, struct program *program,
    const struct use *uses)
{
	size_t count = program->entry_count, n;
	enum err err = ERR_OK;

	program->loaded_entries = program->entries;
	if (!has_drafts(program->tape))
		return ERR_OK;
	program->drafts = calloc(2 * count, sizeof *program->drafts);
	if (program->drafts == NULL)
		return ERR_MEMORY;
	program->loaded_entries = program->drafts + count;
	for (size_t i = 0; i < count && err == ERR_OK; i += n) {
		for (n = 1; i + n < count &&
		    uses[i + n].entry == uses[i].entry; n++)
			;
		err = acquire_draft(tables, program, uses + i, n);
	}
	return err;
}

/* With entries filled: what they have in common. */
static enum err share_tables(struct tables *tables, struct program *program,
    size_t table_bytes_most)
{
	struct use *uses = sort_uses(program);
	enum err err;

	if (uses == NULL)
		return ERR_MEMORY;
	err = ERR_LIMIT;
	if (table_bytes_least(program, uses) <= table_bytes_most)
		err = acquire_drafts(tables, program, uses);
	free(uses);
	return err;
}

/* Instructions are there once more, with boxes, and boxes again in an index,
 * for culling. Of an opening that depends on the angle samples are uploaded; one
 * that operators share is counted for each, which is more than it takes. */
static size_t count_bytes(const struct tape *tape)
{
	size_t bytes = tape->insn_count * (2 * sizeof(struct insn) +
	    2 * sizeof(struct tape_box)) + tape->param_count * sizeof(float);

	for (size_t i = 0; i < tape->operator_count; i++) {
		bytes += sizeof(struct operator_desc);
		if (!opening_is_constant(&tape->operators[i].opening))
			bytes += OPENING_TABLE_COUNT * CURVE_NODE *
			    sizeof(float);
	}
	return bytes;
}

enum err program_create(struct tables *tables, struct tape *tape,
    size_t table_bytes_most, struct program **out)
{
	struct program *program = calloc(1, sizeof *program);
	enum err err = ERR_MEMORY;

	if (program == NULL) {
		tape_free(tape);
		return ERR_MEMORY;
	}
	program->tape = tape;
	program->entries = calloc(tape->operator_count + 1,
	    sizeof *program->entries);
	if (program->entries == NULL)
		goto fail;
	for (size_t i = 0; i < tape->operator_count; i++) {
		err = tables_acquire(tables, &tape->operators[i],
		    &program->entries[i]);
		if (err != ERR_OK)
			goto fail;
		program->entry_count++;
	}
	err = share_tables(tables, program, table_bytes_most);
	if (err == ERR_OK)
		err = surface_create(tape, &program->surface);
	if (err != ERR_OK)
		goto fail;
	program->bytes = count_bytes(tape);
	atomic_init(&program->refs, 1);
	*out = program;
	return ERR_OK;
fail:
	program_free(tables, program);
	return err;
}

struct program *program_hold(struct program *program)
{
	atomic_fetch_add(&program->refs, 1);
	return program;
}

void program_free(struct tables *tables, struct program *program)
{
	assert(program->loaded == NULL);
	for (size_t i = 0; i < program->entry_count; i++)
		tables_release(tables, program->entries[i]);
	for (size_t i = 0; program->drafts != NULL &&
	    i < program->entry_count; i++) {
		if (program->drafts[i] != NULL)
			tables_release(tables, program->drafts[i]);
	}
	free(program->drafts);
	free(program->entries);
	surface_free(program->surface);
	tape_free(program->tape);
	free(program);
}

size_t program_bytes(const struct program *program)
{
	return program->bytes;
}
