/*
 * The examples of proto/DOCUMENT.md: every block of JSON is a document, or the
 * root of one, and every "f(x, y, z) = v" below it is so.
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

#include "core/evaluate.h"
#include "core/tape.h"
#include "core/volume.h"
#include "proto/arena.h"
#include "proto/document.h"
#include "proto/fault.h"
#include "proto/json.h"

#define BEGIN "```json\n"
#define END "\n```\n"

/* The values have up to 4 decimals; the volume's sphere is off by 2e-5. */
#define TOLERANCE 1e-4

#define VOLUME_ID "0123456789abcdef0123456789abcdef"
#define SAMPLES 33

static char *read_file(const char *path)
{
	static char text[1 << 18];
	FILE *file = fopen(path, "r");
	size_t n;

	assert_non_null(file);
	n = fread(text, 1, sizeof text - 1, file);
	fclose(file);
	assert_in_range(n, 1, sizeof text - 2);
	text[n] = '\0';
	return text;
}

/* The distances of a sphere of radius 1 over [-2, 2]^3. */
static struct volume *make_sphere(void)
{
	static float samples[SAMPLES * SAMPLES * SAMPLES];
	const size_t count[3] = {SAMPLES, SAMPLES, SAMPLES};
	const double step = 4.0 / (SAMPLES - 1);
	struct volume *v;

	for (size_t i = 0; i < sizeof samples / sizeof *samples; i++) {
		double x = (double)(i / (SAMPLES * SAMPLES)) * step - 2.0;
		double y = (double)(i / SAMPLES % SAMPLES) * step - 2.0;
		double z = (double)(i % SAMPLES) * step - 2.0;

		samples[i] = (float)(sqrt(x * x + y * y + z * z) - 1.0);
	}
	assert_int_equal(volume_create(samples, count, vec3(-2, -2, -2),
	    vec3(2, 2, 2), true, &v), ERR_OK);
	return v;
}

static struct volume *find_volume(void *ctx, const char *id)
{
	return strcmp(id, VOLUME_ID) == 0 ? volume_hold(ctx) : NULL;
}

static struct document *parse_example(const char *json, size_t length,
    struct volume *volume)
{
	const struct document_limits limits = {.max_nodes = 100,
	    .layout = LAYOUT_WARPED, .volume = find_volume,
	    .volume_ctx = volume};
	static char text[8192];
	struct faults faults = {0};
	struct document *d = NULL;
	bool whole = strncmp(json, "{\"format\"", 9) == 0;
	int n = snprintf(text, sizeof text, "%s%.*s%s", whole ? "" :
	    "{\"format\": \"blobfield/1\", \"root\": ", (int)length, json,
	    whole ? "" : "}");

	assert_in_range(n, 1, sizeof text - 1);
	if (document_parse(text, (size_t)n, &limits, &d, &faults) != ERR_OK)
		fail_msg("%s\n%s: %s", text, faults.list[0].pointer,
		    faults.list[0].detail);
	return d;
}

/* Checks the values between text and end; how many. */
static int check_values(const struct document *d, const char *text,
    const char *end)
{
	int count = 0;

	for (; text && text < end; text = strstr(text, "f(")) {
		struct vec3 p;
		struct jet f;
		double v;

		if (sscanf(text, "f(%lf, %lf, %lf) = %lf", &p.x, &p.y, &p.z,
		    &v) == 4) {
			evaluate(document_tape(d), p, 0, &f);
			if (!(fabs(f.value - v) <= TOLERANCE))
				fail_msg("f(%g, %g, %g) is %.6g, not %g", p.x,
				    p.y, p.z, f.value, v);
			count++;
		}
		text++;
	}
	return count;
}

static void test_examples_are_as_the_reference_says(void **unused)
{
	char *text = read_file("proto/DOCUMENT.md");
	struct volume *sphere = make_sphere();
	int examples = 0, values = 0;

	(void)unused;
	while ((text = strstr(text, BEGIN)) != NULL) {
		char *json = text + strlen(BEGIN);
		char *after = strstr(json, END), *end;
		struct document *d;
		int found;

		assert_non_null(after);
		d = parse_example(json, (size_t)(after - json), sphere);
		after += strlen(END);
		end = strstr(after, "\n\n");
		found = check_values(d, after, end ? end : after);
		if (!found)
			fail_msg("no value below %.60s", json);
		document_free(d);
		values += found;
		examples++;
		text = after;
	}
	printf("measured: %d examples with %d values\n", examples, values);
	assert_true(examples >= 10);
	volume_release(sphere);
}

/* Every "type" below a node of the schema has an example. */
static void test_every_node_has_an_example(void **unused)
{
	struct arena arena = {0};
	struct faults faults = {0};
	char *schema_text = read_file("proto/document.schema.json");
	cJSON *schema;
	const cJSON *def;
	const char *text;
	int types = 0;

	(void)unused;
	assert_int_equal(json_parse(schema_text, strlen(schema_text), 100000,
	    &arena, &schema, &faults), ERR_OK);
	text = read_file("proto/DOCUMENT.md");
	cJSON_ArrayForEach(def, cJSON_GetObjectItemCaseSensitive(schema,
	    "$defs")) {
		char wanted[80];

		if (strncmp(def->string, "node_", 5) != 0)
			continue;
		types++;
		snprintf(wanted, sizeof wanted, "{\"type\": \"%s\", ",
		    def->string + 5);
		if (!strstr(text, wanted))
			fail_msg("no example of %s", def->string + 5);
	}
	assert_true(types >= 23);
	arena_fini(&arena);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_examples_are_as_the_reference_says),
		cmocka_unit_test(test_every_node_has_an_example),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
