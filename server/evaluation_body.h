/*
 * Bodies of evaluations, read as they arrive, and what their heads ask for.
 */
#ifndef SERVER_EVALUATION_BODY_H
#define SERVER_EVALUATION_BODY_H

#include <stdbool.h>

#include "core/err.h"
#include "proto/request.h"
#include "server/evaluation.h"

struct exchange;
struct faults;

/*
 * Of the routes (struct route, open): check the head of /v1/eval and of
 * /v1/scenes/{id}/eval, and have x's body read as it arrives; or answer with
 * what is wrong: 415 for the body's type, 406 for Accept, 422 for the query.
 */
void evaluation_body_open_eval(struct exchange *x);
void evaluation_body_open_scene_eval(struct exchange *x);

/*
 * The same checks for a handler whose body is small and kept whole: its type,
 * one of types (1u << MEDIA_*), and what the head asks for, in *out; or answers
 * x: false.
 */
bool evaluation_body_head(struct exchange *x, unsigned types,
    enum media_type *type, struct evaluation_terms *out);

/*
 * For their handlers: what the body holds, as eval_stream_finish says, in *out
 * and faults. Once only.
 */
enum err evaluation_body_finish(struct exchange *x, struct eval_request *out,
    struct faults *faults);

/* What the head asks for, which lives as long as the body. */
const struct evaluation_terms *evaluation_body_terms(const struct exchange *x);

#endif
