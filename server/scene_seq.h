/*
 * The order of all changes of scenes: what events are resumed by. One daemon
 * counts from 1; several take the ids of the stream they share, "MS-N".
 */
#ifndef SERVER_SCENE_SEQ_H
#define SERVER_SCENE_SEQ_H

#include <stdbool.h>
#include <stdint.h>

struct scene_seq {
	uint64_t major, minor;
};

#define SCENE_SEQ_SIZE 48

/* < 0, 0, > 0 */
int scene_seq_compare(struct scene_seq a, struct scene_seq b);

/* "MAJOR", or "MAJOR-MINOR" where minor is not 0. */
void scene_seq_print(struct scene_seq seq, char out[static SCENE_SEQ_SIZE]);

/* Reads either form; false: it is neither. */
bool scene_seq_parse(const char *text, struct scene_seq *out);

#endif
