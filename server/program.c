#include "server/program.h"

#include <assert.h>
#include <stdlib.h>

#include "core/tape.h"
#include "core/table.h"
#include "server/tables.h"

/* The least device memory that its operator tables take together. */
static size_t table_bytes_least(const struct program *program)
{
	size_t bytes = 0;

	for (size_t i = 0; i < program->entry_count; i++) {
		size_t n = (size_t)program->tape->operators[i].resolution;
		size_t seen = 0;

		while (program->entries[seen] != program->entries[i])
			seen++;
		if (seen == i)
			bytes += n * n * n * sizeof(float) *
			    (TABLE_FIRST + TABLE_SECOND);
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
	err = ERR_LIMIT;
	if (table_bytes_least(program) > table_bytes_most)
		goto fail;
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
	free(program->entries);
	tape_free(program->tape);
	free(program);
}

size_t program_bytes(const struct program *program)
{
	return program->tape->insn_count * sizeof(struct insn) +
	    program->tape->param_count * sizeof(float);
}
