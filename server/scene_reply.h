/*
 * Answers that the scene handlers share, and how they wait for the store.
 */
#ifndef SERVER_SCENE_REPLY_H
#define SERVER_SCENE_REPLY_H

#include <stdbool.h>
#include <stddef.h>

#include "server/scene_seq.h"

#define SCENE_TIME_SIZE 40

struct cJSON;
struct exchange;
struct precondition;
struct scene;
struct scene_change;

/* If-Match and If-None-Match, in *out; or answers 400: false. */
bool scene_reply_preconditions(struct exchange *x, struct precondition *out);

/* 404; or, of one that is kept and cannot be used now, 422 with what is wrong, or
 * 503. */
void scene_reply_absent(struct exchange *x);

/* 404: there was none when a change's turn came, whatever is there since. */
void scene_reply_missing(struct exchange *x);

/* 412 */
void scene_reply_changed(struct exchange *x);

/* ?limit, 1 to most, which is also without it; or answers 400: false. */
bool scene_reply_limit(struct exchange *x, size_t most, size_t *out);

/* Seconds since 1970 as RFC 3339 has them, UTC, with milliseconds; what is not
 * within its years of four digits as 0. */
void scene_reply_time(double time, char out[static SCENE_TIME_SIZE]);

/* Adds revision, sequence and time to json. etag is quoted. */
void scene_reply_add_revision(struct cJSON *json, const char *etag,
    struct scene_seq seq, double time);

/* {id, name, revision, sequence, time, nodes, bytes}, and owner, if there is
 * one */
struct cJSON *scene_reply_summary(const struct scene *scene);

/* Has x wait for change, whose done resumes it: then resumed answers. It is
 * called, with the result, also where the store does not take the change. */
void scene_reply_wait(struct exchange *x, struct scene_change *change,
    void (*resumed)(struct exchange *x));

#endif
