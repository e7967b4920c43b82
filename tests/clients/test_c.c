/*
 * The C client's library against a real daemon: scenes, batches, surfaces,
 * errors, progress, cancelling.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/c/blobfield.h"
#include "tests/support/daemon.h"
#include "tests/support/folder.h"
#include "tests/support/near.h"

/* f = 1/2 at 1 from the origin. */
static const char ball[] = "{\"format\": \"blobfield/1\", \"name\": \"ball\","
    " \"root\": {\"type\": \"point\", \"center\": [0, 0, 0], \"radius\": 1,"
    " \"material\": {\"color\": [1, 0.5, 0]}}}";

struct fixture {
	struct daemon *daemon;
	struct blobfield *client;
};

static int setup(void **state)
{
	struct fixture *f = calloc(1, sizeof *f);
	void *d;

	assert_non_null(f);
	assert_int_equal(daemon_setup(&d), 0);
	f->daemon = d;
	f->client = blobfield_create(f->daemon->url);
	assert_non_null(f->client);
	assert_int_equal(blobfield_put(f->client, "ball", ball,
	    sizeof ball - 1, NULL), BLOBFIELD_OK);
	*state = f;
	return 0;
}

static int teardown(void **state)
{
	struct fixture *f = *state;
	void *d = f->daemon;

	blobfield_free(f->client);
	free(f);
	return daemon_teardown(&d);
}

static struct blobfield *client_of(void **state)
{
	return ((struct fixture *)*state)->client;
}

#define assert_ok(client, outcome) \
	assert_ok_at((client), (outcome), __LINE__)

static void assert_ok_at(struct blobfield *b, enum blobfield_outcome outcome,
    int line)
{
	if (outcome != BLOBFIELD_OK)
		fail_msg("line %d: %s", line, blobfield_error(b)->detail);
}

/* ---- scenes ---- */

static void test_put_get_delete(void **state)
{
	struct blobfield *b = client_of(state);
	struct blobfield_bytes bytes = {0};
	char tag[BLOBFIELD_TAG_MAX], header[BLOBFIELD_TAG_MAX + 2];

	assert_ok(b, blobfield_put(b, "x", ball, sizeof ball - 1, tag));
	snprintf(header, sizeof header, "\"%s\"", tag);
	assert_string_equal(blobfield_header(b, "etag"), header);
	assert_ok(b, blobfield_get(b, "x", &bytes));
	assert_int_equal(bytes.size, sizeof ball - 1);
	assert_string_equal((char *)bytes.data, ball);
	blobfield_bytes_fini(&bytes);
	assert_ok(b, blobfield_delete(b, "x"));
	assert_int_equal(blobfield_get(b, "x", &bytes), BLOBFIELD_REFUSED);
	assert_null(bytes.data);
	assert_int_equal(blobfield_error(b)->status, 404);
	assert_string_equal(blobfield_error(b)->type, "not-found");
}

static void test_post_chooses_an_id(void **state)
{
	struct blobfield *b = client_of(state);
	char id[BLOBFIELD_ID_MAX] = "";

	assert_ok(b, blobfield_post(b, ball, sizeof ball - 1, id));
	assert_true(strlen(id) > 0);
	assert_ok(b, blobfield_delete(b, id));
}

static void test_faults_name_their_places(void **state)
{
	static const char bad[] = "{\"format\": \"blobfield/1\", \"root\": "
	    "{\"type\": \"sphere\", \"center\": [0, 0], \"raduis\": 1}}";
	struct blobfield *b = client_of(state);
	const struct blobfield_error *error = blobfield_error(b);

	assert_int_equal(blobfield_put(b, "x", bad, sizeof bad - 1, NULL),
	    BLOBFIELD_REFUSED);
	assert_int_equal(error->outcome, BLOBFIELD_REFUSED);
	assert_int_equal(error->status, 422);
	assert_string_equal(error->type, "invalid");
	assert_string_equal(error->title, "Invalid content");
	assert_int_equal(error->count, 4);
	assert_string_equal(error->places[0].pointer, "/root/center");
	assert_string_equal(error->places[1].pointer, "/root/raduis");
	assert_string_equal(error->places[1].detail,
	    "unknown field 'raduis'; did you mean 'radius'?");
	/* The next call's error is its own. */
	assert_ok(b, blobfield_put(b, "ball", ball, sizeof ball - 1, NULL));
	assert_int_equal(error->count, 0);
	assert_string_equal(error->detail, "");
}

static void test_wrong_ids_are_not_sent(void **state)
{
	static const char *const ids[] = {"", ".", "..", "a/b", "a b", "a?",
	    "0123456789012345678901234567890123456789012345678901234567890123"
	    "4"};
	struct blobfield *b = client_of(state);

	for (size_t i = 0; i < sizeof ids / sizeof *ids; i++) {
		assert_int_equal(blobfield_delete(b, ids[i]),
		    BLOBFIELD_ARGUMENT);
		assert_int_equal(blobfield_error(b)->status, 0);
	}
}

static void test_requests_of_any_kind(void **state)
{
	struct blobfield *b = client_of(state);
	struct blobfield_bytes bytes = {0};

	assert_ok(b, blobfield_request(b, "GET", "/healthz", NULL, NULL, 0,
	    NULL, &bytes));
	assert_string_equal((char *)bytes.data, "{\"status\":\"ok\"}\n");
	blobfield_bytes_fini(&bytes);
	assert_int_equal(blobfield_request(b, "PATCH", "/healthz", NULL, NULL,
	    0, NULL, &bytes), BLOBFIELD_REFUSED);
	assert_int_equal(blobfield_error(b)->status, 405);
	assert_string_equal(blobfield_header(b, "Allow"),
	    "GET, HEAD, OPTIONS");
}

/* ---- batches ---- */

static void test_evaluate_gives_rows(void **state)
{
	struct blobfield *b = client_of(state);
	const float points[6] = {1, 0, 0, 0, 0, 0};
	float rows[2 * 10];

	assert_ok(b, blobfield_evaluate(b, "ball", points, 2,
	    BLOBFIELD_VALUE | BLOBFIELD_GRADIENT | BLOBFIELD_COLOR |
	    BLOBFIELD_NORMAL, rows));
	/* Rounding in float32. */
	assert_near(rows[0], 0.5, 1e-6);
	assert_true(rows[1] < -0.5f);
	assert_near(rows[4], 1.0, 1e-6);
	assert_near(rows[5], 0.5, 1e-6);
	assert_near(rows[7], 1.0, 1e-6);
	assert_near(rows[10], 1.0, 1e-6);
	assert_near(rows[17], 0.0, 0.0);
}

static void test_columns_add_up(void **state)
{
	(void)state;
	assert_int_equal(blobfield_columns(0), 0);
	assert_int_equal(blobfield_columns(BLOBFIELD_VALUE), 1);
	assert_int_equal(blobfield_columns(63), 18);
}

static void test_no_points_are_fine(void **state)
{
	struct blobfield *b = client_of(state);
	float rows[1] = {7.0f};

	assert_ok(b, blobfield_evaluate(b, "ball", rows, 0, BLOBFIELD_VALUE,
	    rows));
	assert_near(rows[0], 7.0, 0.0);
}

static void test_points_that_are_not_finite_are_refused(void **state)
{
	struct blobfield *b = client_of(state);
	const float point[3] = {0, INFINITY, 0};
	float row[1] = {7.0f};

	assert_int_equal(blobfield_evaluate(b, "ball", point, 1,
	    BLOBFIELD_VALUE, row), BLOBFIELD_REFUSED);
	assert_string_equal(blobfield_error(b)->places[0].detail,
	    "point 0: y is not finite as float32");
	assert_near(row[0], 7.0, 0.0);
}

static void test_grid_is_evaluate_at_its_points(void **state)
{
	/* Exact in float32. */
	const struct blobfield_grid grid = {{-1, -0.5, 0.25}, {1, 0.5, 0.25},
	    {3, 2, 1}};
	const unsigned outputs = BLOBFIELD_VALUE | BLOBFIELD_GRADIENT |
	    BLOBFIELD_CURVATURE;
	struct blobfield *b = client_of(state);
	float points[6 * 3], rows[6 * 6], expected[6 * 6];

	for (int i = 0; i < 6; i++) {
		points[3 * i] = (float)(i / 2 - 1);
		points[3 * i + 1] = (float)(i % 2) - 0.5f;
		points[3 * i + 2] = 0.25f;
	}
	assert_ok(b, blobfield_evaluate(b, "ball", points, 6, outputs,
	    expected));
	assert_ok(b, blobfield_grid(b, "ball", &grid, outputs, rows));
	assert_memory_equal(rows, expected, sizeof rows);
	assert_true(rows[0] > 0.0f && rows[0] < 1.0f);
}

static void test_grids_that_are_refused_leave_rows_alone(void **state)
{
	static const struct {
		struct blobfield_grid grid;
		const char *pointer;
	} wrong[] = {
		{{{0, 0, 0}, {1, 1, 1}, {4096, 4096, 4096}}, "/counts"},
		{{{0, 0, 0}, {1, 1, 1}, {2, 0, 2}}, "/counts/1"},
		{{{0, 0, 0}, {1, 1, 1}, {2, 2, -5}}, "/counts/2"},
		{{{0, 0, 0}, {1, 1, 1}, {5000, 2, 2}}, "/counts/0"},
		{{{0, 0, 2}, {1, 1, 1}, {2, 2, 2}}, "/max/2"},
		{{{0, NAN, 0}, {1, 1, 1}, {2, 2, 2}}, "/min/1"},
		{{{0, 0, 0}, {1, 1, INFINITY}, {2, 2, 2}}, "/max/2"},
	};
	struct blobfield *b = client_of(state);
	float rows[1] = {7.0f};

	for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
		assert_int_equal(blobfield_grid(b, "ball", &wrong[i].grid,
		    BLOBFIELD_VALUE, rows), BLOBFIELD_REFUSED);
		assert_int_equal(blobfield_error(b)->status, 422);
		assert_string_equal(blobfield_error(b)->places[0].pointer,
		    wrong[i].pointer);
	}
	assert_int_equal(blobfield_grid(b, "nowhere", &wrong[0].grid,
	    BLOBFIELD_VALUE, rows), BLOBFIELD_REFUSED);
	assert_int_equal(blobfield_error(b)->status, 404);
	assert_int_equal(blobfield_grid(b, "no/id", &wrong[0].grid,
	    BLOBFIELD_VALUE, rows), BLOBFIELD_ARGUMENT);
	assert_near(rows[0], 7.0, 0.0);
}

static void test_raycast_hits_and_misses(void **state)
{
	struct blobfield *b = client_of(state);
	const float rays[12] = {0, 0, 5, 0, 0, -2, 0, 0, 5, 0, 0, 1};
	const struct blobfield_ray_options near = {.max_distance = 3};
	struct blobfield_hit hits[2];

	assert_ok(b, blobfield_raycast(b, "ball", rays, 2, NULL, hits));
	assert_near(hits[0].hit, 1.0, 0.0);
	/* The daemon's tolerance is 1e-5 of a box of 3.5. */
	assert_near(hits[0].distance, 4.0, 1e-4);
	assert_near(hits[0].position[2], 1.0, 1e-4);
	assert_near(hits[0].color[1], 0.5, 1e-4);
	assert_near(hits[0].leaf, 0.0, 0.0);
	assert_near(hits[1].hit, 0.0, 0.0);
	assert_near(hits[1].leaf, -1.0, 0.0);
	assert_ok(b, blobfield_raycast(b, "ball", rays, 1, &near, hits));
	assert_near(hits[0].hit, 0.0, 0.0);
}

static void test_project_moves_onto_the_surface(void **state)
{
	struct blobfield *b = client_of(state);
	const float point[3] = {0.6f, 0, 0};
	struct blobfield_foot foot;

	assert_ok(b, blobfield_project(b, "ball", point, 1, NULL, &foot));
	assert_near(foot.converged, 1.0, 0.0);
	assert_near(foot.position[0], 1.0, 1e-4);
	assert_near(foot.distance, -0.4, 1e-4);
	assert_near(foot.normal[0], 1.0, 1e-4);
}

/* ---- surfaces ---- */

static void test_bounds_of_field_and_surface(void **state)
{
	static const char plane[] = "{\"format\": \"blobfield/1\", \"root\": "
	    "{\"type\": \"plane\", \"point\": [0, 0, 0], \"normal\": "
	    "[0, 0, 1], \"falloff\": 1}}";
	struct blobfield *b = client_of(state);
	struct blobfield_bounds bounds;

	assert_ok(b, blobfield_bounds(b, "ball", &bounds));
	assert_false(bounds.is_empty);
	/* 1 / sqrt(1 - 2^(-1/3)) */
	assert_near(bounds.field.max[0], 2.2016636, 1e-5);
	assert_true(bounds.has_surface);
	assert_true(bounds.surface.max[2] >= 1.0);
	assert_true(bounds.surface.max[2] < 1.1);
	assert_ok(b, blobfield_put(b, "plane", plane, sizeof plane - 1,
	    NULL));
	assert_ok(b, blobfield_bounds(b, "plane", &bounds));
	assert_true(isinf(bounds.field.min[0]));
	assert_near(bounds.field.max[2], 1.0, 1e-6);
	assert_false(bounds.has_surface);
	assert_ok(b, blobfield_delete(b, "plane"));
}

static void test_mesh_to_memory_and_file(void **state)
{
	struct blobfield *b = client_of(state);
	const struct blobfield_mesh_options options = {.resolution = 16};
	struct blobfield_bytes bytes = {0};
	char path[] = "/tmp/blobfield-XXXXXX", file[64], line[16] = "";
	FILE *f;

	assert_ok(b, blobfield_mesh(b, "ball", &options, &bytes));
	assert_true(bytes.size > 1000);
	assert_memory_equal(bytes.data, "glTF", 4);
	blobfield_bytes_fini(&bytes);
	assert_true(strstr(blobfield_header(b, "Blobfield-Mesh"),
	    "genus=0") != NULL);
	assert_non_null(mkdtemp(path));
	snprintf(file, sizeof file, "%s/ball.ply", path);
	assert_ok(b, blobfield_mesh_file(b, "ball", &options, file));
	f = fopen(file, "rb");
	assert_non_null(f);
	assert_non_null(fgets(line, sizeof line, f));
	assert_string_equal(line, "ply\n");
	fclose(f);
	unlink(file);
	assert_int_equal(rmdir(path), 0);
}

static void test_mesh_file_is_left_alone_by_failure(void **state)
{
	struct blobfield *b = client_of(state);
	const struct blobfield_mesh_options options = {.resolution = 1};
	char path[] = "/tmp/blobfield-XXXXXX", file[64];

	assert_non_null(mkdtemp(path));
	snprintf(file, sizeof file, "%s/ball.stl", path);
	assert_int_equal(blobfield_mesh_file(b, "ball", &options, file),
	    BLOBFIELD_REFUSED);
	assert_string_equal(blobfield_error(b)->places[0].pointer,
	    "/resolution");
	assert_int_equal(blobfield_mesh_file(b, "nowhere", NULL, file),
	    BLOBFIELD_REFUSED);
	/* Neither the file nor a part of it. */
	assert_int_equal(rmdir(path), 0);
	assert_int_equal(blobfield_mesh_file(b, "ball", NULL, file),
	    BLOBFIELD_FILE);
	assert_int_equal(blobfield_mesh_file(b, "ball", NULL, "ball.doc"),
	    BLOBFIELD_ARGUMENT);
}

static void test_pictures_are_png(void **state)
{
	static const double eye[3] = {0, -5, 0}, middle[3] = {0, 0, 0};
	static const double white[3] = {1, 1, 1};
	const struct blobfield_render_options view = {.width = 32,
	    .height = 24, .samples = 1, .shading = "normal", .eye = eye,
	    .target = middle, .background = white};
	const struct blobfield_slice_options plane = {.width = 20,
	    .height = 10, .step = 0.25};
	struct blobfield *b = client_of(state);
	struct blobfield_bytes bytes = {0};

	assert_ok(b, blobfield_render(b, "ball", &view, &bytes));
	assert_memory_equal(bytes.data, "\x89PNG", 4);
	blobfield_bytes_fini(&bytes);
	assert_ok(b, blobfield_slice(b, "ball", &plane, false, &bytes));
	assert_memory_equal(bytes.data, "\x89PNG", 4);
	blobfield_bytes_fini(&bytes);
	assert_ok(b, blobfield_slice(b, "ball", &plane, true, &bytes));
	assert_memory_equal(bytes.data, "\x93NUMPY", 6);
	assert_true(bytes.size > 20 * 10 * 4 && bytes.size < 1200);
	blobfield_bytes_fini(&bytes);
}

/* ---- changes ---- */

#define PATCH(b, id, text, if_match, tag) \
	blobfield_patch((b), (id), (text), strlen(text), (if_match), (tag))

static void assert_holds(struct blobfield *b, const char *id, const char *text)
{
	struct blobfield_bytes bytes = {0};

	assert_ok(b, blobfield_get(b, id, &bytes));
	if (strstr((const char *)bytes.data, text) == NULL)
		fail_msg("'%s' is not in %s", text, (char *)bytes.data);
	blobfield_bytes_fini(&bytes);
}

static void test_patches_of_both_kinds(void **state)
{
	struct blobfield *b = client_of(state);
	char before[BLOBFIELD_TAG_MAX], tag[BLOBFIELD_TAG_MAX];

	assert_ok(b, blobfield_put(b, "x", ball, sizeof ball - 1, before));
	assert_ok(b, PATCH(b, "x", " \n[{\"op\": \"replace\", \"path\": "
	    "\"/root/radius\", \"value\": 7}]", before, tag));
	assert_string_not_equal(tag, before);
	assert_holds(b, "x", "\"radius\":7");
	assert_ok(b, PATCH(b, "x", "{\"name\": \"other\"}", NULL, NULL));
	assert_holds(b, "x", "\"name\":\"other\"");
	assert_holds(b, "x", "\"radius\":7");
	assert_int_equal(PATCH(b, "x", "{\"name\": \"third\"}", tag, NULL),
	    BLOBFIELD_REFUSED);
	assert_int_equal(blobfield_error(b)->status, 412);
	assert_int_equal(PATCH(b, "x", "{}", "a\"b", NULL),
	    BLOBFIELD_ARGUMENT);
	assert_ok(b, blobfield_delete(b, "x"));
	assert_int_equal(PATCH(b, "x", "{}", NULL, NULL), BLOBFIELD_REFUSED);
	assert_int_equal(blobfield_error(b)->status, 404);
}

static void test_patches_that_are_refused_change_nothing(void **state)
{
	struct blobfield *b = client_of(state);
	const struct blobfield_error *error = blobfield_error(b);

	assert_int_equal(PATCH(b, "ball", "[{\"op\": \"remove\", \"path\": "
	    "\"/name\"}, {\"op\": \"test\", \"path\": \"/root/radius\", "
	    "\"value\": 2}]", NULL, NULL), BLOBFIELD_REFUSED);
	assert_int_equal(error->status, 409);
	assert_string_equal(error->type, "conflict");
	assert_string_equal(error->places[0].pointer, "/1/value");
	assert_int_equal(PATCH(b, "ball", "{\"root\": {\"radius\": -1}}", NULL,
	    NULL), BLOBFIELD_REFUSED);
	assert_int_equal(error->status, 422);
	assert_string_equal(error->places[0].pointer, "/root/radius");
	assert_memory_equal(error->detail, "The document after the patch", 28);
	assert_holds(b, "ball", "\"name\": \"ball\"");
}

/* What a listener has heard; at each event, the next of texts is put, and at
 * the last the scene is deleted. */
struct heard {
	struct blobfield *other;
	const char *const *texts;
	int count;
	struct blobfield_event events[8];
};

static int hear(void *ctx, const struct blobfield_event *event)
{
	struct heard *h = ctx;
	const char *text;

	assert_true(h->count < 8);
	h->events[h->count++] = *event;
	if (event->is_deletion)
		return 0;
	text = *h->texts++;
	if (text == NULL)
		assert_ok(h->other, blobfield_delete(h->other, "told"));
	else
		assert_ok(h->other, PATCH(h->other, "told", text, NULL, NULL));
	return 0;
}

static int stop(void *ctx, const struct blobfield_event *event)
{
	*(struct blobfield_event *)ctx = *event;
	return 1;
}

static void test_events_until_the_scene_is_deleted(void **state)
{
	static const char *const texts[] = {"{\"name\": \"1\"}",
	    "{\"name\": \"2\"}", NULL};
	struct blobfield *b = client_of(state);
	struct heard h = {.other = blobfield_create(blobfield_url(b)),
	    .texts = texts};
	char tag[BLOBFIELD_TAG_MAX];

	assert_ok(b, blobfield_put(b, "told", ball, sizeof ball - 1, tag));
	assert_ok(b, blobfield_events(b, "told", NULL, hear, &h));
	assert_int_equal(h.count, 4);
	assert_string_equal(h.events[0].revision, tag);
	assert_int_equal(h.events[0].nodes, 1);
	assert_int_equal(h.events[0].bytes, sizeof ball - 1);
	assert_int_equal(strlen(h.events[0].time), 24);
	for (int i = 0; i < 4; i++) {
		assert_false(h.events[i].has_missed);
		assert_int_equal(h.events[i].is_deletion, i == 3);
		assert_true(i == 0 || strtol(h.events[i].sequence, NULL, 10) >
		    strtol(h.events[i - 1].sequence, NULL, 10));
	}
	assert_string_equal(h.events[3].revision, "");
	assert_int_equal(blobfield_events(b, "told", NULL, hear, &h),
	    BLOBFIELD_REFUSED);
	assert_int_equal(blobfield_error(b)->status, 404);
	blobfield_free(h.other);
}

static void test_events_behind_one(void **state)
{
	struct blobfield *b = client_of(state);
	struct blobfield_event first, next;
	char tag[BLOBFIELD_TAG_MAX];

	assert_ok(b, blobfield_put(b, "told", ball, sizeof ball - 1, NULL));
	assert_ok(b, blobfield_events(b, "told", NULL, stop, &first));
	assert_ok(b, PATCH(b, "told", "{\"name\": \"1\"}", NULL, tag));
	assert_ok(b, PATCH(b, "told", "{\"name\": \"2\"}", NULL, NULL));
	assert_ok(b, blobfield_events(b, "told", first.sequence, stop, &next));
	assert_string_equal(next.revision, tag);
	assert_int_equal(blobfield_events(b, "told", "a b", stop, &next),
	    BLOBFIELD_ARGUMENT);
	assert_ok(b, blobfield_delete(b, "told"));
}

/* Events that have been heard. */
static atomic_int heard;

/* Some time after the first. */
static void *cancel_events(void *ctx)
{
	while (atomic_load(&heard) == 0)
		usleep(10000);
	usleep(100000);
	blobfield_cancel(ctx);
	return NULL;
}

static int note(void *ctx, const struct blobfield_event *event)
{
	(void)ctx, (void)event;
	atomic_fetch_add(&heard, 1);
	return 0;
}

static void test_events_are_cancelled(void **state)
{
	struct blobfield *b = client_of(state);
	pthread_t thread;

	assert_int_equal(pthread_create(&thread, NULL, cancel_events, b), 0);
	assert_int_equal(blobfield_events(b, "ball", NULL, note, NULL),
	    BLOBFIELD_CANCELLED);
	pthread_join(thread, NULL);
	assert_int_equal(atomic_load(&heard), 1);
	assert_holds(b, "ball", "ball");
}

/* Listens while the daemon ends and comes again: in a thread of its own, as
 * daemons end with the thread that has started them. */
struct listener {
	struct blobfield *client;
	struct blobfield_event events[2];
	atomic_int count;
	enum blobfield_outcome outcome;
};

static int hear_two(void *ctx, const struct blobfield_event *event)
{
	struct listener *l = ctx;

	l->events[l->count] = *event;
	return atomic_fetch_add(&l->count, 1) == 1;
}

static void *listen_for_two(void *ctx)
{
	struct listener *l = ctx;

	l->outcome = blobfield_events(l->client, "kept", NULL, hear_two, l);
	return NULL;
}

static void test_events_go_on_after_a_restart(void **state)
{
	char folder[PATH_MAX], address[64], tag[BLOBFIELD_TAG_MAX];
	const char *arguments[] = {"--no-measure", "--data", folder, "--cache",
	    folder, NULL, NULL, NULL};
	struct daemon d;
	struct listener l = {0};
	struct blobfield *b;
	pthread_t thread;

	(void)state;
	folder_make(folder);
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	snprintf(address, sizeof address, "127.0.0.1:%d", d.port);
	arguments[5] = "--listen";
	arguments[6] = address;
	b = blobfield_create(d.url);
	l.client = blobfield_create(d.url);
	assert_ok(b, blobfield_put(b, "kept", ball, sizeof ball - 1, NULL));
	assert_int_equal(pthread_create(&thread, NULL, listen_for_two, &l), 0);
	while (l.count == 0)
		usleep(10000);
	assert_int_equal(daemon_stop(&d, SIGKILL), -1);
	daemon_start(&d, arguments);
	daemon_await_ready(&d);
	assert_ok(b, PATCH(b, "kept", "{\"name\": \"after\"}", NULL, tag));
	pthread_join(thread, NULL);
	assert_ok(l.client, l.outcome);
	assert_string_equal(l.events[1].revision, tag);
	assert_false(l.events[1].has_missed);
	assert_int_equal(daemon_stop(&d, SIGTERM), 0);
	assert_int_equal(blobfield_events(b, "kept", NULL, stop, l.events),
	    BLOBFIELD_UNREACHABLE);
	blobfield_free(l.client);
	blobfield_free(b);
	folder_remove(folder);
}

/* ---- what goes wrong ---- */

static void test_certificates_that_cannot_be_read(void **state)
{
	struct blobfield *b = client_of(state);

	assert_int_equal(blobfield_set_ca(b, "/nowhere/ca.pem"),
	    BLOBFIELD_ARGUMENT);
	assert_string_equal(blobfield_error(b)->detail,
	    "'/nowhere/ca.pem' cannot be read");
	assert_ok(b, blobfield_set_ca(b, NULL));
	assert_holds(b, "ball", "ball");
}

static void test_no_daemon_is_unreachable(void **state)
{
	struct blobfield *b = blobfield_create("http://127.0.0.1:1/");

	(void)state;
	assert_string_equal(blobfield_url(b), "http://127.0.0.1:1");
	assert_int_equal(blobfield_delete(b, "x"), BLOBFIELD_UNREACHABLE);
	assert_int_equal(blobfield_error(b)->status, 0);
	assert_true(strlen(blobfield_error(b)->detail) > 20);
	assert_string_equal(blobfield_header(b, "Date"), "");
	blobfield_free(b);
	blobfield_free(NULL);
}

#define MANY 4000000

static int give_up(void *ctx, const char *stage, double done)
{
	(void)stage;
	assert_true(done >= 0.0 && done <= 1.0);
	return ++*(int *)ctx >= 3;
}

static void test_progress_may_give_up(void **state)
{
	struct blobfield *b = client_of(state);
	float *points = calloc(3 * MANY, sizeof *points);
	float *rows = malloc(18 * MANY * sizeof *rows);
	int calls = 0;

	blobfield_set_progress(b, give_up, &calls);
	assert_int_equal(blobfield_evaluate(b, "ball", points, MANY, 63,
	    rows), BLOBFIELD_CANCELLED);
	assert_int_equal(calls, 3);
	blobfield_set_progress(b, NULL, NULL);
	assert_ok(b, blobfield_evaluate(b, "ball", points, 1, 63, rows));
	free(points);
	free(rows);
}

static void *cancel_soon(void *ctx)
{
	usleep(100000);
	blobfield_cancel(ctx);
	return NULL;
}

static void test_cancel_from_another_thread(void **state)
{
	struct blobfield *b = client_of(state);
	float *points = calloc(3 * MANY, sizeof *points);
	float *rows = malloc(18 * MANY * sizeof *rows);
	pthread_t thread;

	assert_int_equal(pthread_create(&thread, NULL, cancel_soon, b), 0);
	assert_int_equal(blobfield_evaluate(b, "ball", points, MANY, 63,
	    rows), BLOBFIELD_CANCELLED);
	pthread_join(thread, NULL);
	assert_int_equal(blobfield_error(b)->outcome, BLOBFIELD_CANCELLED);
	assert_ok(b, blobfield_evaluate(b, "ball", points, 1, 63, rows));
	free(points);
	free(rows);
}

static void test_deadline_is_sent(void **state)
{
	struct blobfield *b = client_of(state);
	const float point[3] = {0};
	float row[1];

	blobfield_set_deadline(b, 1e-9);
	assert_int_equal(blobfield_evaluate(b, "ball", point, 1,
	    BLOBFIELD_VALUE, row), BLOBFIELD_REFUSED);
	assert_string_equal(blobfield_error(b)->type, "deadline");
	blobfield_set_deadline(b, 0.0);
	assert_ok(b, blobfield_evaluate(b, "ball", point, 1, BLOBFIELD_VALUE,
	    row));
}

struct stages {
	int calls;
	double last;
	bool is_named;
};

static int note_stage(void *ctx, const char *stage, double done)
{
	struct stages *stages = ctx;

	assert_true(done >= stages->last - 1e-9);
	stages->last = done;
	stages->is_named = stages->is_named || *stage != '\0';
	stages->calls++;
	return 0;
}

static void test_progress_of_a_mesh_grows(void **state)
{
	struct blobfield *b = client_of(state);
	const struct blobfield_mesh_options options = {.resolution = 300};
	struct blobfield_bytes bytes = {0};
	struct stages stages = {0};

	blobfield_set_progress(b, note_stage, &stages);
	assert_ok(b, blobfield_mesh(b, "ball", &options, &bytes));
	blobfield_set_progress(b, NULL, NULL);
	blobfield_bytes_fini(&bytes);
	assert_true(stages.is_named);
	assert_true(stages.calls > 5);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_put_get_delete),
		cmocka_unit_test(test_post_chooses_an_id),
		cmocka_unit_test(test_faults_name_their_places),
		cmocka_unit_test(test_wrong_ids_are_not_sent),
		cmocka_unit_test(test_requests_of_any_kind),
		cmocka_unit_test(test_evaluate_gives_rows),
		cmocka_unit_test(test_columns_add_up),
		cmocka_unit_test(test_no_points_are_fine),
		cmocka_unit_test(test_points_that_are_not_finite_are_refused),
		cmocka_unit_test(test_grid_is_evaluate_at_its_points),
		cmocka_unit_test(test_grids_that_are_refused_leave_rows_alone),
		cmocka_unit_test(test_raycast_hits_and_misses),
		cmocka_unit_test(test_project_moves_onto_the_surface),
		cmocka_unit_test(test_bounds_of_field_and_surface),
		cmocka_unit_test(test_mesh_to_memory_and_file),
		cmocka_unit_test(test_mesh_file_is_left_alone_by_failure),
		cmocka_unit_test(test_pictures_are_png),
		cmocka_unit_test(test_patches_of_both_kinds),
		cmocka_unit_test(test_patches_that_are_refused_change_nothing),
		cmocka_unit_test(test_events_until_the_scene_is_deleted),
		cmocka_unit_test(test_events_behind_one),
		cmocka_unit_test(test_events_are_cancelled),
		cmocka_unit_test(test_events_go_on_after_a_restart),
		cmocka_unit_test(test_certificates_that_cannot_be_read),
		cmocka_unit_test(test_no_daemon_is_unreachable),
		cmocka_unit_test(test_progress_may_give_up),
		cmocka_unit_test(test_cancel_from_another_thread),
		cmocka_unit_test(test_deadline_is_sent),
		cmocka_unit_test(test_progress_of_a_mesh_grows),
	};

	return cmocka_run_group_tests_name("c", tests, setup, teardown);
}
