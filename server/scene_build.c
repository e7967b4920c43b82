#include "server/scene_build.h"

#include "core/tape.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "server/config.h"
#include "server/evaluation.h"
#include "server/program.h"
#include "server/scene_store.h"
#include "server/server.h"

enum err scene_build(struct server *server,
    const struct document_limits *limits, const char *id, const char *text,
    size_t length, struct scene **out, struct faults *faults)
{
	struct program *program;
	struct document *document;
	struct scene *scene;
	enum err err;

	err = document_parse(text, length, limits, &document, faults);
	if (err != ERR_OK)
		return err;
	err = evaluation_program(server, "", document, &program, faults);
	if (err == ERR_OK)
		err = scene_create(server->scheduler, id,
		    document_name(document), text, length, program, &scene);
	document_free(document);
	if (err != ERR_OK)
		return err;
	scene->nodes = program->tape->node_count;
	*out = scene;
	return ERR_OK;
}
