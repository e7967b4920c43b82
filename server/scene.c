#include "server/scene_store.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>

#include "core/tape.h"
#include "server/program.h"
#include "server/scheduler.h"

static void scene_free(struct scene *scene)
{
	if (scene->program != NULL)
		scheduler_release(scene->scheduler, scene->program);
	free(scene->name);
	free(scene->text);
	free(scene);
}

static size_t tape_bytes(const struct tape *tape)
{
	return sizeof *tape + tape->insn_count *
	    (sizeof *tape->insns + sizeof *tape->boxes) +
	    tape->param_count * sizeof *tape->params +
	    tape->operator_count * sizeof *tape->operators;
}

enum err scene_create(struct scheduler *scheduler, const char *id,
    const char *name, const char *text, size_t length,
    struct program *program, struct scene **out)
{
	struct scene *scene = calloc(1, sizeof *scene);

	if (scene == NULL) {
		if (program != NULL)
			scheduler_release(scheduler, program);
		return ERR_MEMORY;
	}
	atomic_init(&scene->refs, 1);
	scene->scheduler = scheduler;
	scene->program = program;
	strncpy(scene->id, id, SCENE_ID_MAX);
	scene->name = strdup(name);
	scene->text = malloc(length + 1);
	if (scene->name == NULL || scene->text == NULL) {
		scene_free(scene);
		return ERR_MEMORY;
	}
	memcpy(scene->text, text, length);
	scene->text[length] = '\0';
	scene->length = length;
	scene->bytes = sizeof *scene + length;
	if (program != NULL)
		scene->bytes += tape_bytes(program->tape);
	etag_of(text, length, scene->etag);
	*out = scene;
	return ERR_OK;
}

struct scene *scene_hold(struct scene *scene)
{
	atomic_fetch_add(&scene->refs, 1);
	return scene;
}

void scene_release(struct scene *scene)
{
	if (atomic_fetch_sub(&scene->refs, 1) == 1)
		scene_free(scene);
}

bool scene_id_is_valid(const char *id)
{
	static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
	    "abcdefghijklmnopqrstuvwxyz0123456789_.-";
	size_t length = strlen(id);

	return length >= 1 && length <= SCENE_ID_MAX &&
	    strspn(id, letters) == length && strcmp(id, ".") != 0 &&
	    strcmp(id, "..") != 0;
}

enum err scene_id_random(char out[static SCENE_ID_MAX + 1])
{
	static const char digits[] = "0123456789abcdefghijklmnopqrstuv";
	uint8_t bytes[26]; /* 26 digits of 5 bits: 130 bits */

	if (getrandom(bytes, sizeof bytes, 0) != sizeof bytes)
		return ERR_IO;
	for (size_t i = 0; i < sizeof bytes; i++)
		out[i] = digits[bytes[i] & 31];
	out[sizeof bytes] = '\0';
	return ERR_OK;
}
