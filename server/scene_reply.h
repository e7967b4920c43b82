/*
 * Answers that the scene handlers share.
 */
#ifndef SERVER_SCENE_REPLY_H
#define SERVER_SCENE_REPLY_H

#include <stdbool.h>

struct cJSON;
struct exchange;
struct precondition;
struct scene;

/* If-Match and If-None-Match, in *out; or answers 400: false. */
bool scene_reply_preconditions(struct exchange *x, struct precondition *out);

/* 404 */
void scene_reply_absent(struct exchange *x);

/* 412 */
void scene_reply_changed(struct exchange *x);

/* {id, name, revision, nodes, bytes} */
struct cJSON *scene_reply_summary(const struct scene *scene);

#endif
