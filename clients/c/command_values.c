/*
 * blobfield eval, grid, raycast, project: rows of numbers in, rows of numbers
 * out.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/command.h"

/* Rows a request: some megabytes, and a bar that moves. */
#define PIECE 262144

/* What the three share. */
struct batch {
	struct session *s;
	struct rows in, out;
	const char *output;
	const char *names;     /* of in's and out's columns */
	unsigned outputs;
	struct blobfield_ray_options options;
	enum blobfield_outcome (*run)(struct batch *batch, const float *in,
	    size_t count, float *out);
};

static enum blobfield_outcome run_pieces(struct batch *batch)
{
	struct session *s = batch->s;
	const size_t n = batch->in.count;
	enum blobfield_outcome outcome = BLOBFIELD_OK;

	progress_begin(s);
	for (size_t i = 0; i < n && outcome == BLOBFIELD_OK; i += PIECE) {
		const size_t count = n - i < PIECE ? n - i : PIECE;

		progress_part((double)i / (double)n,
		    (double)(i + count) / (double)n);
		outcome = batch->run(batch, batch->in.data + i *
		    batch->in.columns, count, batch->out.data + i *
		    batch->out.columns);
	}
	progress_end(s);
	return outcome;
}

static int run_in_scene(struct batch *batch)
{
	struct session *s = batch->s;

	batch->out.data = calloc(batch->in.count * batch->out.columns + 1,
	    sizeof(float));
	if (batch->out.data == NULL) {
		command_say(s, "out of memory\n");
		return COMMAND_FILE;
	}
	batch->out.count = batch->in.count;
	if (run_pieces(batch) != BLOBFIELD_OK)
		return command_fail(s, false);
	return rows_write(s, batch->output, &batch->in, &batch->out,
	    batch->names) ? COMMAND_DONE : COMMAND_FILE;
}

/* Rows of those options and of the file, if there is one. */
static int read_in(struct batch *batch, const struct options_list *given,
    const char *path)
{
	struct session *s = batch->s;

	for (size_t i = 0; i < given->count; i++)
		if (!rows_add(&batch->in, given->texts[i])) {
			command_say(s, "'%s' must be %zu numbers, separated "
			    "by commas\n", given->texts[i],
			    batch->in.columns);
			return COMMAND_USAGE;
		}
	if (path == NULL && given->count > 0)
		return COMMAND_DONE;
	return rows_read(s, &batch->in, path != NULL ? path : "-") ?
	    COMMAND_DONE : COMMAND_FILE;
}

/* argv: a scene, and a file of rows that may be missing. */
static int run_batch(struct batch *batch, const struct options_list *given,
    int count, char **argv)
{
	struct session *s = batch->s;
	const char *path = count > 1 ? argv[1] : NULL;
	int status;

	if (strcmp(argv[0], "-") == 0 && (path == NULL ? given->count == 0 :
	    strcmp(path, "-") == 0)) {
		command_say(s, "the document and the rows cannot both come "
		    "from stdin\n");
		return COMMAND_USAGE;
	}
	status = read_in(batch, given, path);
	if (status == COMMAND_DONE)
		status = command_open_scene(s, argv[0]);
	if (status == COMMAND_DONE)
		status = run_in_scene(batch);
	command_close_scene(s);
	rows_fini(&batch->in);
	rows_fini(&batch->out);
	return status;
}

/* ---- eval ---- */

static const struct {
	const char *name;
	enum blobfield_output output;
	const char *columns;
} outputs_known[] = {
	{"value", BLOBFIELD_VALUE, ",value"},
	{"gradient", BLOBFIELD_GRADIENT, ",gradient_x,gradient_y,gradient_z"},
	{"hessian", BLOBFIELD_HESSIAN, ",hessian_xx,hessian_yy,hessian_zz,"
	    "hessian_xy,hessian_xz,hessian_yz"},
	{"color", BLOBFIELD_COLOR, ",red,green,blue"},
	{"normal", BLOBFIELD_NORMAL, ",normal_x,normal_y,normal_z"},
	{"curvature", BLOBFIELD_CURVATURE, ",mean_curvature,"
	    "gaussian_curvature"}
};

#define OUTPUTS_KNOWN (sizeof outputs_known / sizeof *outputs_known)

/* "value,gradient" as a mask, 0 if it is none. */
static unsigned read_outputs(const char *text)
{
	unsigned mask = 0;

	for (;;) {
		const size_t length = strcspn(text, ",");
		const unsigned before = mask;

		for (size_t i = 0; i < OUTPUTS_KNOWN; i++)
			if (strlen(outputs_known[i].name) == length &&
			    memcmp(outputs_known[i].name, text, length) == 0)
				mask |= outputs_known[i].output;
		if (mask == before)
			return 0;
		if (text[length] == '\0')
			return mask;
		text += length + 1;
	}
}

static enum blobfield_outcome run_eval(struct batch *batch, const float *in,
    size_t count, float *out)
{
	return blobfield_evaluate(batch->s->client, batch->s->id, in, count,
	    batch->outputs, out);
}

/* The rows that --outputs asks for, and their names behind x,y,z. false: said
 * why not. */
static bool choose_outputs(struct batch *batch, const char *outputs,
    char names[static 256])
{
	batch->outputs = read_outputs(outputs);
	if (batch->outputs == 0) {
		command_say(batch->s, "--outputs: some of value, gradient, "
		    "hessian, color, normal, curvature, each once\n");
		return false;
	}
	strcpy(names, "x,y,z");
	for (size_t i = 0; i < OUTPUTS_KNOWN; i++)
		if (batch->outputs & outputs_known[i].output)
			strcat(names, outputs_known[i].columns);
	batch->names = names;
	batch->out.columns = blobfield_columns(batch->outputs);
	return true;
}

int command_eval(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct batch batch = {.s = s, .in.columns = 3, .run = run_eval};
	struct options_list points = {0};
	const char *outputs = "value,gradient";
	char names[256];
	const struct options_rule rules[] = {
		{"point", 'p', OPTIONS_LIST, &points, "X,Y,Z",
		    "a point, instead of POINTS or before them"},
		{"outputs", 0, OPTIONS_TEXT, &outputs, "LIST",
		    "of value, gradient, hessian, color, normal, curvature"},
		{"output", 'o', OPTIONS_TEXT, &batch.output, "FILE",
		    ".csv, .json, .npy, .f32 (stdout gets CSV)"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 2, &count, &status))
		return status;
	if (!choose_outputs(&batch, outputs, names))
		return COMMAND_USAGE;
	return run_batch(&batch, &points, count, argv);
}

/* ---- grid ---- */

/* Where point i of count between min and max is: as the daemon has it. */
static float coordinate(double min, double max, int i, int count)
{
	if (i == 0)
		return (float)min;
	if (i + 1 == count)
		return (float)max;
	return (float)(min + (max - min) * (double)i / (double)(count - 1));
}

static void place_points(const struct blobfield_grid *g, float *out)
{
	const int *n = g->counts;

	for (int i = 0; i < n[0]; i++)
		for (int j = 0; j < n[1]; j++)
			for (int k = 0; k < n[2]; k++) {
				const int at[3] = {i, j, k};

				for (int axis = 0; axis < 3; axis++)
					*out++ = coordinate(g->min[axis],
					    g->max[axis], at[axis], n[axis]);
			}
}

/* One request, whose rows are the device's as they come: no bar. */
static int run_grid(struct batch *batch, const struct blobfield_grid *grid)
{
	struct session *s = batch->s;
	const size_t count = (size_t)grid->counts[0] *
	    (size_t)grid->counts[1] * (size_t)grid->counts[2];

	batch->in.data = malloc(count * batch->in.columns * sizeof(float));
	batch->out.data = malloc(count * batch->out.columns * sizeof(float));
	if (batch->in.data == NULL || batch->out.data == NULL) {
		command_say(s, "out of memory\n");
		return COMMAND_FILE;
	}
	if (blobfield_grid(s->client, s->id, grid, batch->outputs,
	    batch->out.data) != BLOBFIELD_OK)
		return command_fail(s, false);
	place_points(grid, batch->in.data);
	batch->in.count = batch->out.count = count;
	batch->out.counts = grid->counts;
	return rows_write(s, batch->output, &batch->in, &batch->out,
	    batch->names) ? COMMAND_DONE : COMMAND_FILE;
}

/* Whole ones that the daemon may take; false: said what they must be. */
static bool read_grid(const struct session *s,
    const struct options_vector *least, const struct options_vector *most,
    const struct options_vector *counts, struct blobfield_grid *out)
{
	if (!least->is_there || !most->is_there || !counts->is_there) {
		command_say(s, "--min, --max and --counts are needed\n");
		return false;
	}
	memcpy(out->min, least->v, sizeof out->min);
	memcpy(out->max, most->v, sizeof out->max);
	for (int i = 0; i < 3; i++) {
		if (counts->v[i] < 1 || counts->v[i] > 4096 ||
		    counts->v[i] != floor(counts->v[i])) {
			command_say(s, "--counts must be whole numbers, 1 to "
			    "4096\n");
			return false;
		}
		out->counts[i] = (int)counts->v[i];
	}
	return true;
}

int command_grid(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct batch batch = {.s = s, .in.columns = 3};
	struct options_vector least = {0}, most = {0}, counts = {0};
	struct blobfield_grid grid;
	const char *outputs = "value,gradient";
	char names[256];
	const struct options_rule rules[] = {
		{"min", 0, OPTIONS_VECTOR, &least, "X,Y,Z", "the first point"},
		{"max", 0, OPTIONS_VECTOR, &most, "X,Y,Z", "the last one"},
		{"counts", 'n', OPTIONS_VECTOR, &counts, "NX,NY,NZ",
		    "points along each axis, 1 to 4096"},
		{"outputs", 0, OPTIONS_TEXT, &outputs, "LIST",
		    "of value, gradient, hessian, color, normal, curvature"},
		{"output", 'o', OPTIONS_TEXT, &batch.output, "FILE",
		    ".csv, .json, .npy, .f32 (stdout gets CSV)"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 1, &count, &status))
		return status;
	if (!read_grid(s, &least, &most, &counts, &grid) ||
	    !choose_outputs(&batch, outputs, names))
		return COMMAND_USAGE;
	status = command_open_scene(s, argv[0]);
	if (status == COMMAND_DONE)
		status = run_grid(&batch, &grid);
	command_close_scene(s);
	rows_fini(&batch.in);
	rows_fini(&batch.out);
	return status;
}

/* ---- raycast, project ---- */

static enum blobfield_outcome run_raycast(struct batch *batch,
    const float *in, size_t count, float *out)
{
	return blobfield_raycast(batch->s->client, batch->s->id, in, count,
	    &batch->options, (struct blobfield_hit *)(void *)out);
}

int command_raycast(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct batch batch = {
		.s = s,
		.in.columns = 6,
		.out.columns = sizeof(struct blobfield_hit) / sizeof(float),
		.names = "origin_x,origin_y,origin_z,direction_x,direction_y,"
		    "direction_z,hit,distance,x,y,z,value,gradient_x,"
		    "gradient_y,gradient_z,red,green,blue,leaf",
		.run = run_raycast
	};
	struct options_list rays = {0};
	const struct options_rule rules[] = {
		{"ray", 'r', OPTIONS_LIST, &rays, "X,Y,Z,DX,DY,DZ",
		    "a ray, instead of RAYS or before them"},
		{"iso", 0, OPTIONS_NUMBER, &batch.options.iso, "F",
		    "the surface's value (0.5)"},
		{"max-distance", 0, OPTIONS_NUMBER,
		    &batch.options.max_distance, "LENGTH", "no further"},
		{"tolerance", 0, OPTIONS_NUMBER, &batch.options.tolerance,
		    "LENGTH", "thinner parts may be missed"},
		{"output", 'o', OPTIONS_TEXT, &batch.output, "FILE",
		    ".csv, .json, .npy, .f32 (stdout gets CSV)"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 2, &count, &status))
		return status;
	return run_batch(&batch, &rays, count, argv);
}

static enum blobfield_outcome run_project(struct batch *batch,
    const float *in, size_t count, float *out)
{
	return blobfield_project(batch->s->client, batch->s->id, in, count,
	    &batch->options, (struct blobfield_foot *)(void *)out);
}

int command_project(struct session *s, const struct command *self, int argc,
    char **argv)
{
	struct batch batch = {
		.s = s,
		.in.columns = 3,
		.out.columns = sizeof(struct blobfield_foot) / sizeof(float),
		.names = "from_x,from_y,from_z,converged,x,y,z,distance,value,"
		    "normal_x,normal_y,normal_z",
		.run = run_project
	};
	struct options_list points = {0};
	const struct options_rule rules[] = {
		{"point", 'p', OPTIONS_LIST, &points, "X,Y,Z",
		    "a point, instead of POINTS or before them"},
		{"iso", 0, OPTIONS_NUMBER, &batch.options.iso, "F",
		    "the surface's value (0.5)"},
		{"max-distance", 0, OPTIONS_NUMBER,
		    &batch.options.max_distance, "LENGTH", "no further"},
		{"output", 'o', OPTIONS_TEXT, &batch.output, "FILE",
		    ".csv, .json, .npy, .f32 (stdout gets CSV)"},
		{0}
	};
	int count, status;

	if (!command_start(s, self, rules, argc, argv, 1, 2, &count, &status))
		return status;
	return run_batch(&batch, &points, count, argv);
}
