/*
 * blobfield watch: a document's file, kept on the daemon as it is saved, and
 * meshes and pictures made again each time.
 *
 * Editors replace files as often as they write them: the folder is watched,
 * not the file. A change while work is under way gives that up.
 */
#include <errno.h>
#include <libgen.h>
#include <limits.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <sys/inotify.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "clients/c/command.h"

/* Milliseconds without another change, before a change is believed to be
 * over. */
#define SETTLE_MS 50

struct watch {
	struct session *s;
	const char *path, *name; /* name: path's last part */
	int notify;              /* inotify */
	const struct options_list *outputs;
	struct blobfield_mesh_options mesh;
	struct blobfield_render_options render;
	bool once;
};

/* Whether the file has been written or replaced since the last call; waits so
 * long, -1: for ever. false if a signal comes. */
static bool has_changed(struct watch *w, int timeout_ms)
{
	_Alignas(struct inotify_event) char buffer[4096];
	struct pollfd poll_fd = {.fd = w->notify, .events = POLLIN};
	bool found = false;

	while (poll(&poll_fd, 1, timeout_ms) == 1) {
		const ssize_t size = read(w->notify, buffer, sizeof buffer);

		for (const char *at = buffer; size > 0 && at < buffer + size;) {
			const struct inotify_event *event =
			    (const void *)at;

			found = found || (event->len > 0 &&
			    strcmp(event->name, w->name) == 0);
			at += sizeof *event + event->len;
		}
		timeout_ms = found ? SETTLE_MS : timeout_ms < 0 ? -1 : 0;
	}
	return found;
}

/* While the client waits: a newer version makes the work pointless. */
static int is_stale(void *ctx, const char *stage, double done)
{
	struct pollfd poll_fd = {.fd = ((struct watch *)ctx)->notify,
	    .events = POLLIN};

	(void)stage;
	(void)done;
	return poll(&poll_fd, 1, 0) == 1;
}

static enum blobfield_outcome render_to(struct watch *w, const char *path)
{
	struct blobfield_bytes bytes = {0};
	enum blobfield_outcome outcome = blobfield_render(w->s->client,
	    w->s->id, &w->render, &bytes);

	if (outcome == BLOBFIELD_OK)
		command_write(w->s, path, bytes.data, bytes.size);
	blobfield_bytes_fini(&bytes);
	return outcome;
}

/* Seconds since *begun. */
static double since(const struct timespec *begun)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (double)(now.tv_sec - begun->tv_sec) +
	    1e-9 * (double)(now.tv_nsec - begun->tv_nsec);
}

static int make_outputs(struct watch *w)
{
	struct session *s = w->s;
	enum blobfield_outcome outcome = BLOBFIELD_OK;

	blobfield_set_progress(s->client, is_stale, w);
	for (size_t i = 0; i < w->outputs->count &&
	    outcome == BLOBFIELD_OK; i++) {
		const char *path = w->outputs->texts[i];
		struct timespec begun;

		clock_gettime(CLOCK_MONOTONIC, &begun);
		outcome = command_has_extension(path, ".png") ?
		    render_to(w, path) : blobfield_mesh_file(s->client, s->id,
		    &w->mesh, path);
		if (outcome == BLOBFIELD_OK && !s->quiet)
			fprintf(stderr, "%s: %.2f s %s\n", path,
			    since(&begun), blobfield_header(s->client,
			    "Blobfield-Mesh"));
	}
	blobfield_set_progress(s->client, NULL, NULL);
	/* Given up for a newer version is nothing to speak of. */
	if (outcome == BLOBFIELD_CANCELLED && is_stale(w, "", 0.0))
		return COMMAND_DONE;
	return outcome == BLOBFIELD_OK ? COMMAND_DONE : command_fail(s, false);
}

/* Keeps the file as it is now, and makes what comes of it. */
static int update(struct watch *w)
{
	struct session *s = w->s;
	char tag[BLOBFIELD_TAG_MAX];
	int status = COMMAND_FILE;

	if (!command_read(s, w->path, &s->text))
		return status;
	s->source = w->path;
	if (blobfield_put(s->client, s->id, (const char *)s->text.data,
	    s->text.size, tag) != BLOBFIELD_OK) {
		status = command_fail(s, true);
	} else {
		if (!s->quiet)
			fprintf(stderr, "%s: kept as %s, revision %.8s\n",
			    w->path, s->id, tag);
		status = make_outputs(w);
	}
	blobfield_bytes_fini(&s->text);
	return status;
}

/* Errors are said and lived with, but that the user has had enough. */
static int watch_on(struct watch *w)
{
	int status = update(w);

	while (!w->once && status != COMMAND_INTERRUPTED) {
		if (!has_changed(w, -1))
			return COMMAND_INTERRUPTED;
		status = update(w);
	}
	return status;
}

/* The file's name without its extension, of letters that ids may have. */
static void make_id(const char *name, char id[static BLOBFIELD_ID_MAX])
{
	size_t length = strcspn(name, ".");

	length = length == 0 || length >= BLOBFIELD_ID_MAX ?
	    BLOBFIELD_ID_MAX - 1 : length;
	snprintf(id, length + 1, "%s", name);
	for (char *p = id; *p != '\0'; p++)
		if (strchr("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwx"
		    "yz0123456789_.-", *p) == NULL)
			*p = '-';
}

static int open_watch(struct watch *w)
{
	char folder[PATH_MAX];
	const char *slash = strrchr(w->path, '/');

	w->name = slash != NULL ? slash + 1 : w->path;
	snprintf(folder, sizeof folder, "%s", w->path);
	w->notify = inotify_init1(IN_NONBLOCK | IN_CLOEXEC);
	if (w->notify < 0 || inotify_add_watch(w->notify, dirname(folder),
	    IN_CLOSE_WRITE | IN_MOVED_TO) < 0) {
		command_say(w->s, "%s: %s\n", w->path, strerror(errno));
		return COMMAND_FILE;
	}
	return COMMAND_DONE;
}

int command_watch(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct options_list outputs = {0};
	struct watch w = {.s = s, .outputs = &outputs, .notify = -1};
	const char *id = NULL;
	const struct options_rule rules[] = {
		{"id", 0, OPTIONS_TEXT, &id, "ID",
		    "of the scene (the file's name without extension)"},
		{"output", 'o', OPTIONS_LIST, &outputs, "FILE",
		    "a mesh or a .png to make; may come several times"},
		{"resolution", 'r', OPTIONS_WHOLE, &w.mesh.resolution, "N",
		    "of meshes (64)"},
		{"width", 'W', OPTIONS_WHOLE, &w.render.width, "PIXELS",
		    "of pictures (640)"},
		{"height", 'H', OPTIONS_WHOLE, &w.render.height, "PIXELS",
		    "of pictures (480)"},
		{"shading", 's', OPTIONS_TEXT, &w.render.shading, "HOW",
		    "of pictures (lit)"},
		{"once", 0, OPTIONS_FLAG, &w.once, NULL,
		    "do it once, and do not watch"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 1, &count, &status))
		return status;
	w.path = argv[0];
	status = open_watch(&w);
	if (status == COMMAND_DONE) {
		if (id != NULL)
			snprintf(s->id, sizeof s->id, "%s", id);
		else
			make_id(w.name, s->id);
		status = watch_on(&w);
	}
	if (w.notify >= 0)
		close(w.notify);
	return status;
}
