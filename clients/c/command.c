/*
 * The blobfield command: which subcommand there is, its options and its help,
 * and what is said when something goes wrong.
 */
#include "clients/c/command.h"

#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

static const char program_help[] =
    "usage: blobfield COMMAND [OPTION...] [ARGUMENT...]\n"
    "\n"
    "Asks blobfieldd, the daemon of implicit blends, for values, meshes and\n"
    "pictures. `blobfield COMMAND --help` says more about each:\n"
    "\n";

static const char common_about[] =
    "A SCENE is a document's file (or - for stdin), kept by the daemon for\n"
    "the time of the command; or, where there is no such file, the id of a\n"
    "scene that is kept there.\n"
    "\n"
    "Exit status: 0 all went well; 1 the daemon has refused (a document, an\n"
    "argument, too much work at once); 2 wrong usage; 3 no daemon answers, or\n"
    "the connection was cut; 4 a file cannot be read or written; 130\n"
    "interrupted. What is wrong with a document is said with its place in the\n"
    "file: FILE:LINE:COLUMN: POINTER: WHAT.\n"
    "\n"
    "Environment: BLOBFIELD_URL is the daemon's address,\n"
    BLOBFIELD_URL " unless set; BLOBFIELD_TOKEN the token\n"
    "to send, unless --token says another (which others on this machine see);\n"
    "BLOBFIELD_CA the file of certificates to trust, unless --ca does.\n";

#define ROWS_ABOUT(what, columns) \
    what " (- or nothing: stdin) have " columns " numbers a row: text, a\n" \
    "row a line, separated by commas, semicolons or blanks (# begins a\n" \
    "comment, a first line of words is passed over); .npy; or .f32, raw\n" \
    "float32.\n"

static const struct command commands[] = {
	{"eval", "SCENE [POINTS]", "values, gradients ... at points",
	    "Evaluates a scene at points, and writes them with what was found "
	    "there.\n" ROWS_ABOUT("POINTS", "3"), command_eval},
	{"grid", "SCENE [-o FILE]", "values, gradients ... on a regular grid",
	    "Evaluates a scene at the points of a regular grid, z fastest, "
	    "which need not be\nsent, and writes them with what was found "
	    "there. An .npy file has the grid's\nshape: with --outputs value "
	    "it is what POST /v1/volumes takes.\n", command_grid},
	{"raycast", "SCENE [RAYS]", "where rays meet the surface",
	    "Casts rays, of an origin and a direction each, and writes where "
	    "each first\nmeets the surface. leaf counts the document's "
	    "primitives from 0.\n" ROWS_ABOUT("RAYS", "6"), command_raycast},
	{"project", "SCENE [POINTS]", "points moved onto the surface",
	    "Moves points along the gradient onto the surface.\n"
	    ROWS_ABOUT("POINTS", "3"), command_project},
	{"mesh", "SCENE [-o FILE]", "the surface as triangles",
	    "Meshes a scene. Without -o, what is known of the mesh (triangles, "
	    "genus,\narea, volume ...) goes to stdout, as JSON.\n",
	    command_mesh},
	{"render", "SCENE [-o FILE.png]", "a picture of the surface",
	    "Draws a scene.\n", command_render},
	{"slice", "SCENE [-o FILE]", "the field in a plane",
	    "Draws the field in a plane with its iso-lines, or writes its "
	    "values.\n", command_slice},
	{"bounds", "SCENE", "boxes about field and surface",
	    "Prints the corners of two boxes: the field is 0 outside of the "
	    "first, the\nsurface within the second.\n", command_bounds},
	{"put", "ID [FILE]", "keep a document on the daemon",
	    "Keeps a document, from FILE or stdin, under ID, and prints its "
	    "revision.\n", command_put},
	{"get", "ID [-o FILE]", "the document of a kept scene",
	    "Prints a document as it was put.\n", command_get},
	{"patch", "ID [FILE]", "change a part of a document",
	    "Changes a part of the document under ID by a patch, from FILE or "
	    "stdin, and\nprints the new revision. A patch that is an array is "
	    "a JSON Patch (RFC 6902),\nany other a merge patch (RFC 7396). All "
	    "of it is done, or nothing.\n", command_patch},
	{"revisions", "ID", "what has been kept under an ID",
	    "Prints sequence, time, revision, number of nodes and bytes of "
	    "each revision of\na scene that is kept, the newest first.\n",
	    command_revisions},
	{"events", "ID", "changes of a scene as they are made",
	    "Prints sequence, time, revision, number of nodes and bytes of the "
	    "present\nrevision of a scene, then of each change as it is made; "
	    "\"missed\" behind them\nif there were others before it. Goes on "
	    "when the daemon is started again. Ends\nwhen the scene is deleted "
	    "or when interrupted.\n", command_events},
	{"list", "", "the scenes that are kept",
	    "Prints id, number of nodes and name of each scene.\n",
	    command_scenes},
	{"delete", "ID...", "forget scenes",
	    "Has the daemon forget scenes.\n", command_delete},
	{"watch", "FILE [-o FILE...]", "keep a document as it is saved",
	    "Keeps a document under an id, again whenever FILE is saved, and "
	    "makes meshes\nand pictures of it again. What is wrong with it is "
	    "said, and the last good\none stays. Ends when interrupted.\n",
	    command_watch},
	{"info", "", "version, device, limits of the daemon",
	    "Prints what the daemon says of itself, as JSON.\n", command_info}
};

#define COMMANDS (sizeof commands / sizeof *commands)

/* For the signal's handler. */
static struct blobfield *volatile interrupted_client;

static void interrupt(int number)
{
	(void)number;
	if (interrupted_client != NULL)
		blobfield_cancel(interrupted_client);
}

void command_say(const struct session *s, const char *text, ...)
{
	va_list arguments;

	fprintf(stderr, "blobfield%s%s: ", s != NULL ? " " : "",
	    s != NULL ? s->name : "");
	va_start(arguments, text);
	vfprintf(stderr, text, arguments);
	va_end(arguments);
}

/* ---- help ---- */

static void print_help(const struct command *self,
    const struct options_rule *rules, const struct options_rule *common)
{
	printf("blobfield %s - %s\n\nusage: blobfield %s [OPTION...] %s\n\n%s"
	    "\nOptions:\n", self->name, self->summary, self->name,
	    self->arguments, self->about);
	if (rules != NULL)
		options_help(stdout, rules);
	options_help(stdout, common);
	printf("\n%s", common_about);
}

static int print_program_help(void)
{
	fputs(program_help, stdout);
	for (size_t i = 0; i < COMMANDS; i++)
		printf("  %-9s %-21s %s\n", commands[i].name,
		    commands[i].arguments, commands[i].summary);
	printf("\n%s", common_about);
	return COMMAND_DONE;
}

/* ---- beginning ---- */

static bool is_number_wrong(int count, int least, int most)
{
	return count < least || count > most;
}

/* NULL: as the environment has it. false: said why. */
static bool set_access(struct session *s, const char *token, const char *ca)
{
	const char *wrong = NULL;

	if (token != NULL && blobfield_set_token(s->client, token) !=
	    BLOBFIELD_OK)
		wrong = "token";
	else if (ca != NULL && blobfield_set_ca(s->client, ca) != BLOBFIELD_OK)
		wrong = "ca";
	if (wrong != NULL)
		command_say(s, "--%s: %s\n", wrong,
		    blobfield_error(s->client)->detail);
	return wrong == NULL;
}

bool command_start(struct session *s, const struct command *self,
    const struct options_rule *rules, int argc, char **argv, int least,
    int most, int *count, int *status)
{
	static const struct sigaction once = {.sa_handler = interrupt,
	    .sa_flags = (int)SA_RESETHAND};
	const char *url = NULL, *token = NULL, *ca = NULL;
	double deadline = 0.0;
	bool help = false;
	const struct options_rule common[] = {
		{"url", 0, OPTIONS_TEXT, &url, "URL", "the daemon's address"},
		{"token", 0, OPTIONS_TEXT, &token, "TOKEN",
		    "for a daemon that asks for one"},
		{"ca", 0, OPTIONS_TEXT, &ca, "FILE",
		    "certificates to trust, instead of the system's"},
		{"deadline", 0, OPTIONS_NUMBER, &deadline, "SECONDS",
		    "have the daemon give up after so long"},
		{"quiet", 'q', OPTIONS_FLAG, &s->quiet, NULL,
		    "say nothing but what is wrong"},
		{"progress", 0, OPTIONS_FLAG, &s->progress, NULL,
		    "draw progress bars though stderr is no terminal"},
		{"help", 'h', OPTIONS_FLAG, &help, NULL, "print this"},
		{0}
	};
	char message[256];

	*status = COMMAND_USAGE;
	*count = 0;
	if (!options_read(rules, common, argc, argv, count, message,
	    sizeof message)) {
		command_say(s, "%s; try --help\n", message);
		return false;
	}
	if (help) {
		print_help(self, rules, common);
		*status = COMMAND_DONE;
		return false;
	}
	if (is_number_wrong(*count, least, most)) {
		fprintf(stderr, "usage: blobfield %s [OPTION...] %s\n",
		    self->name, self->arguments);
		return false;
	}
	s->client = blobfield_create(url);
	if (s->client == NULL) {
		command_say(s, "libcurl does not start\n");
		return false;
	}
	if (!set_access(s, token, ca)) {
		blobfield_free(s->client);
		s->client = NULL;
		return false;
	}
	blobfield_set_deadline(s->client, deadline);
	interrupted_client = s->client;
	sigaction(SIGINT, &once, NULL);
	sigaction(SIGTERM, &once, NULL);
	*status = COMMAND_DONE;
	return true;
}

/* ---- what went wrong ---- */

/* The line of the text, and a mark below the column. */
static void print_line(const struct session *s, size_t line, size_t column)
{
	const char *at = (const char *)s->text.data, *end;

	while (--line > 0 && (at = strchr(at, '\n')) != NULL)
		at++;
	if (at == NULL)
		return;
	end = at + strcspn(at, "\r\n");
	if (end - at > 160 || column > (size_t)(end - at) + 1)
		return;
	fprintf(stderr, "  %.*s\n  ", (int)(end - at), at);
	/* Tabs stay tabs, so that the mark is where it should be. */
	for (size_t i = 0; i + 1 < column; i++)
		fputc(at[i] == '\t' ? '\t' : ' ', stderr);
	fputs("^\n", stderr);
}

static void print_place(const struct session *s, const char *pointer,
    const char *detail)
{
	size_t line, column;
	int used = 0;

	/* What is no JSON has its place in the sentence. */
	if (sscanf(detail, "line %zu, column %zu (byte %*u): %n", &line,
	    &column, &used) >= 2 && used > 0)
		detail += used;
	else if (!place_find((const char *)s->text.data, s->text.size,
	    pointer, &line, &column))
		line = column = 1;
	fprintf(stderr, "%s:%zu:%zu: %s%s%s\n", s->source, line, column,
	    pointer, *pointer != '\0' ? ": " : "", detail);
	print_line(s, line, column);
}

static void print_error(const struct session *s,
    const struct blobfield_error *error, bool in_document)
{
	const size_t kept = error->count < BLOBFIELD_PLACES_MAX ?
	    error->count : BLOBFIELD_PLACES_MAX;

	if (kept == 0) {
		command_say(s, "%s%s%s\n", error->title,
		    *error->title != '\0' ? ": " : "", error->detail);
		return;
	}
	for (size_t i = 0; i < kept; i++) {
		const struct blobfield_place *place = &error->places[i];

		if (in_document)
			print_place(s, place->pointer, place->detail);
		else
			command_say(s, "%s%s%s\n", place->pointer,
			    *place->pointer != '\0' ? ": " : "",
			    place->detail);
	}
	if (error->count > kept)
		fprintf(stderr, "and %zu more\n", error->count - kept);
}

int command_fail(struct session *s, bool sent_document)
{
	static const int statuses[] = {
		[BLOBFIELD_OK] = COMMAND_DONE,
		[BLOBFIELD_REFUSED] = COMMAND_REFUSED,
		[BLOBFIELD_UNREACHABLE] = COMMAND_UNREACHABLE,
		[BLOBFIELD_CANCELLED] = COMMAND_INTERRUPTED,
		[BLOBFIELD_STRANGE] = COMMAND_UNREACHABLE,
		[BLOBFIELD_FILE] = COMMAND_FILE,
		[BLOBFIELD_ARGUMENT] = COMMAND_USAGE,
		[BLOBFIELD_MEMORY] = COMMAND_FILE
	};
	const struct blobfield_error *error = blobfield_error(s->client);

	if (error->outcome != BLOBFIELD_CANCELLED)
		print_error(s, error, sent_document && s->text.data != NULL);
	return statuses[error->outcome];
}

/* ---- the program ---- */

static int run(const struct command *command, int argc, char **argv)
{
	struct session session = {.name = command->name};
	int status = command->run(&session, command, argc, argv);

	interrupted_client = NULL;
	blobfield_free(session.client);
	return status;
}

int main(int argc, char **argv)
{
	const char *name = argc > 1 ? argv[1] : "";

	if (strcmp(name, "--help") == 0 || strcmp(name, "-h") == 0 ||
	    strcmp(name, "help") == 0)
		return print_program_help();
	if (strcmp(name, "--version") == 0) {
		printf("blobfield %s\n", BLOBFIELD_VERSION);
		return COMMAND_DONE;
	}
	for (size_t i = 0; i < COMMANDS; i++)
		if (strcmp(commands[i].name, name) == 0)
			return run(&commands[i], argc - 2, argv + 2);
	if (*name == '-')
		command_say(NULL, "options stand behind the command; try "
		    "--help\n");
	else if (argc > 1)
		command_say(NULL, "there is no '%s'; try --help\n", name);
	else
		fprintf(stderr, "usage: blobfield COMMAND [OPTION...] "
		    "[ARGUMENT...]; try --help\n");
	return COMMAND_USAGE;
}
