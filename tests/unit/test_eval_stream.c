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

#include "core/output.h"
#include "proto/document.h"
#include "proto/eval_stream.h"
#include "proto/fault.h"
#include "tests/support/fail_alloc.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))
#define POINTS_MAX 8
#define BODY_MAX 8192
#define SCENE "{'format':'blobfield/1','root':{'type':'point'," \
	"'center':[0,0,0],'radius':1}}"

static const struct document_limits limits = {.max_nodes = 8};

static uint64_t state = 88172645463325252u;

/* Marsaglia's xorshift, 2003 */
static uint64_t draw(void)
{
	state ^= state << 13;
	state ^= state >> 7;
	state ^= state << 17;
	return state;
}

struct result {
	enum err err;
	struct eval_request request;
	struct faults faults;
};

static struct result whole(const struct eval_stream_options *options,
    const char *body, size_t length)
{
	struct result r = {.request.outputs = OUTPUT_VALUE};

	if (options->type == MEDIA_OCTETS)
		r.err = points_from_octets(body, length, options->max_points,
		    &r.request.points, &r.faults);
	else if (options->type == MEDIA_NPY)
		r.err = points_from_npy(body, length, options->max_points,
		    &r.request.points, &r.faults);
	else
		r.err = eval_request_parse(body, length, options->with_scene,
		    OUTPUT_VALUE, &limits, options->max_points, &r.request,
		    &r.faults);
	return r;
}

/* In pieces of at most size bytes, random ones if that is 0; each is memory of
 * its own, for the sanitizer. */
static struct result in_pieces(const struct eval_stream_options *options,
    const char *body, size_t length, size_t size)
{
	struct result r = {.request.outputs = OUTPUT_VALUE};
	const size_t most = size ? size : 1 + draw() % (draw() % 8 ? 40 : 400);
	struct eval_stream *s;
	enum err err = ERR_OK;
	char *piece;
	size_t n;

	assert_int_equal(eval_stream_create(options, &s), ERR_OK);
	for (; length; length -= n, body += n) {
		n = size ? size : 1 + draw() % most;
		n = n < length ? n : length;
		piece = malloc(n);
		assert_non_null(piece);
		memcpy(piece, body, n);
		err = eval_stream_feed(s, piece, n);
		free(piece);
	}
	r.err = eval_stream_finish(s, OUTPUT_VALUE, &limits, &r.request,
	    &r.faults);
	assert_true(err == ERR_OK || err == r.err);
	eval_stream_free(s);
	return r;
}

static bool same_faults(const struct faults *a, const struct faults *b)
{
	size_t i;

	if (a->count != b->count)
		return false;
	for (i = 0; i < a->count && i < FAULT_MAX; i++) {
		if (strcmp(a->list[i].pointer, b->list[i].pointer) != 0 ||
		    strcmp(a->list[i].detail, b->list[i].detail) != 0)
			return false;
	}
	return true;
}

static bool same_points(const struct points *a, const struct points *b)
{
	return a->count == b->count && a->flat == b->flat &&
	    !a->xyz == !b->xyz && (a->count == 0 || memcmp(a->xyz, b->xyz,
	    3 * a->count * sizeof *a->xyz) == 0);
}

static void check(const struct eval_stream_options *options, const char *body,
    size_t length, size_t size)
{
	struct result a = whole(options, body, length);
	struct result b = in_pieces(options, body, length, size);

	if (a.err != b.err || !same_faults(&a.faults, &b.faults) ||
	    !same_points(&a.request.points, &b.request.points) ||
	    a.request.outputs != b.request.outputs ||
	    !a.request.document != !b.request.document)
		fail_msg("%.*s\nwhole: %s, %zu faults, %s: %s\n"
		    "pieces: %s, %zu faults, %s: %s", (int)length, body,
		    err_message(a.err), a.faults.count,
		    a.faults.list[0].pointer, a.faults.list[0].detail,
		    err_message(b.err), b.faults.count,
		    b.faults.list[0].pointer, b.faults.list[0].detail);
	eval_request_fini(&a.request);
	eval_request_fini(&b.request);
}

/* text with '"' for each '\''. */
static void check_json(const char *text, bool with_scene)
{
	struct eval_stream_options options = {.type = MEDIA_JSON,
	    .with_scene = with_scene, .max_points = POINTS_MAX};
	const size_t length = strlen(text);
	char *body = malloc(length + 1);
	size_t i;

	assert_non_null(body);
	for (i = 0; i <= length; i++)
		body[i] = text[i] == '\'' ? '"' : text[i];
	for (i = 1; i <= 9; i++)
		check(&options, body, length, i);
	check(&options, body, length, length ? length : 1);
	for (i = 0; i < 4; i++)
		check(&options, body, length, 0);
	free(body);
}

static void test_pieces_of_bodies_with_and_without_faults(void **unused)
{
	static const char *const bodies[] = {
		"", " ", "{", "{}", "[]", "7", "[[1,2,3]]", "{'points'",
		"{'points':", "{'points':[", "{'points':[]}", "{'points': []",
		"{'points':[[1,2,3]]}", " {\n'points' :\n [1 , 2,\n3\n] } ",
		"{'points':[[1,2,3],[4,5,6]],'outputs':['gradient']}",
		"{'outputs':['value'],'points':[[-1.5e-3,2.25,1e2]],"
		"'scene':" SCENE "}",
		"{'scene':" SCENE ",'points':[1,2,3]}",
		"{'scene':{'points':[[1]]},'points':[1,2,3]}",
		"{'\\u0070oints':[[1,2,3]]}", "{'points\\u0000':[]}",
		"{'points ':[1,2,3]}", "{'points':{}}", "{'points':null}",
		"{'points':'[1,2,3]'}", "{'points':{'a':[1,2]},'outputs':[]}",
		"{'points':[1,2,3],'points':[4,5,6]}",
		"{'points':{},'points':[4,5,6]}",
		"{'points':[1,2,3],\n'points'\n:[4,5,6]}", "{'points':[1,2,3]]",
		"{'points':[1,2,3]}}", "{'points':[1,2,3]}\n\n x",
		"{'points':[1,2,3]},", "{'points':[1,2,3] 'outputs':[]}",
		"{'points':[1,2,3],}", "{'points':[1,2,3],7:1}",
		"{'points':[1,2,3];", "{'points':[1,2]}", "{'points':[1,2,]}",
		"{'points':[[1,2]],'outputs':['x','y',3]}",
		"{'points':[[1,2,3],[1,2,3,4,[5,{'a':'b]}'}]]],'outputs':7}",
		"{'points':[[1,2,3],null,{'a':tru}]}",
		"{'points':[[1,2,3],null,{'a':true,'a':[]}],\n'outputs':\n[],x",
		"{'points':[[1,2,1e39],{'a\\ud800':1}]}",
		"{'points':[[1,2,1e39],{'a\\ud83d\\ude00':1},\n'\xc3\xa9']}",
		"{'points':[[1,2,1e39],'\xc3']}", "{'points':[[1,2,1e39],'\t']}",
		"{'points':[[1,2,1e39],{1:2}]}", "{'points':[[1,2,1e39],{'a'1}]}",
		"{'points':[[1,2,1e39],{'a':1]]}", "{'points':[[],{'a':1},]}",
		"{'points':[[1,2,1e39],01]}", "{'points':[[1,2,1e39],[,]]}",
		"{'points':[[1,01,3]]}", "{'points':[[1,-,3]]}",
		"{'points':[[1,2.x,3]]}", "{'points':[[1,NaN,3]]}",
		"{'points':[[1,2.\n,3]]}", "{'points':[[1,2-3,3]]}",
		"{'points':[[1,2 3,3]]}", "{'points':[[1,2'3',3]]}",
		"{'points':[1e39'3',3]}", "{'points':[[1,2,'x''y']]}",
		"{'points':[[1,2,true'y']]}", "{'points':[[1,2,true[1]]]}",
		"{'points':[[1,2,{a'y':1}]]}", "{'points':[[1,nul",
		"{'points':[[1,2e", "{'points':[[1,'ab",
		"{'points':[[1,2,3]", "{'points':[[1,2,3],", "{'points':[1,",
		"{'points':[1,2,3,4,5,6,7,8,9,1,2,3,4,5,6,7,8,9,1,2,3,4,5,6,"
		"x", "{'points':[1,2,3,4,5,6,7,8,9,1,2,3,4,5,6,7,8,9,1,2,3,4,"
		"5,6]}",
		"{'points':[[1,2,3],[1,2,3],[1,2,3],[1,2,3],[1,2,3],[1,2,3],"
		"[1,2,3],[1,2,3],[",
		"{'a':[}, 'points':[1,2,]}", "{'a':]}, 'points':[1,2,]}",
		"{'a' 5:1,'points':[1,2,3,x}", "{,'points':[1,2,3,x}",
		"{'x':1,'points':[1,2,3],'y':{'points':[1]}}",
		"{'a':'\\','points':[1,2,3]}", "{'a\\\\':1,'points':[1,2,3]}",
		"x{'points':[1,2,3]}", "{'points':[1e400,2,3]}",
		"{'points':[0.30000000000000004440892098500626162, 1, "
		"123456789012345678901234567890e-25]}",
		"\xef\xbb\xbf{'points':[1,2,3]}",
	};
	size_t i;

	(void)unused;
	for (i = 0; i < COUNT(bodies); i++) {
		check_json(bodies[i], false);
		check_json(bodies[i], true);
	}
}

static void test_pieces_of_values_too_deep(void **unused)
{
	char text[1024];
	size_t depth, n;

	(void)unused;
	for (depth = 140; depth < 148; depth++) {
		n = (size_t)sprintf(text, "{'points':[[1,2,3],");
		memset(text + n, '[', depth);
		strcpy(text + n + depth, "7");
		memset(text + n + depth + 1, ']', depth + 1);
		strcpy(text + n + 2 * depth + 2, "}");
		check_json(text, false);
	}
}

/* Adds a number, in one of many spellings. */
static size_t put_number(char *out)
{
	const double unit = (double)(draw() >> 11) * 0x1p-52 - 1.0;

	switch (draw() % 6) {
	case 0:
		return (size_t)sprintf(out, "%d", (int)(draw() % 200) - 100);
	case 1:
		return (size_t)sprintf(out, "%.17g", unit);
	case 2:
		return (size_t)sprintf(out, "%.9g", unit * 1000);
	case 3:
		return (size_t)sprintf(out, "%.*e", (int)(draw() % 22), unit);
	case 4:
		return (size_t)sprintf(out, "%.25f", unit);
	default:
		return (size_t)sprintf(out, "%.1f", unit);
	}
}

static size_t put_space(char *out)
{
	static const char *const spaces[] = {"", "", "", " ", "\n", "\r\n\t"};

	return (size_t)sprintf(out, "%s", spaces[draw() % COUNT(spaces)]);
}

static size_t put_points(char *out)
{
	const size_t count = draw() % (POINTS_MAX + 1) + (draw() % 16 == 0);
	const bool flat = draw() & 1;
	size_t n = 0, i;

	n += (size_t)sprintf(out + n, "[");
	for (i = 0; i < 3 * count; i++) {
		n += put_space(out + n);
		if (!flat && i % 3 == 0)
			n += (size_t)sprintf(out + n, "[");
		n += put_number(out + n);
		n += put_space(out + n);
		if (!flat && i % 3 == 2)
			n += (size_t)sprintf(out + n, "]");
		n += (size_t)sprintf(out + n, i + 1 < 3 * count ? "," : "");
	}
	return n + (size_t)sprintf(out + n, "]");
}

static size_t put_member(char *out, unsigned which)
{
	static const char *const others[] = {
		"\"outputs\":[\"value\",\"gradient\"]",
		"\"outputs\":[\"value\"]",
		"\"outputs\":[\"colour\"]", "\"x\":{\"points\":[1,2,{}]}",
		"\"scene\":{\"format\":\"blobfield/1\",\"root\":{\"type\":"
		"\"point\",\"center\":[0,0,0],\"radius\":1}}",
		"\"scene\":{\"format\":\"blobfield/1\",\"root\":{\"type\":"
		"\"pint\",\"center\":[0,0],\"radius\":-1}}",
	};
	size_t n;

	if (which != 0)
		return (size_t)sprintf(out, "%s",
		    others[draw() % COUNT(others)]);
	n = (size_t)sprintf(out, "\"points\"%s:", draw() & 1 ? "" : " ");
	n += put_space(out + n);
	return n + put_points(out + n);
}

static size_t make_body(char *out)
{
	const unsigned count = (unsigned)(1 + draw() % 4);
	const unsigned where = (unsigned)(draw() % count);
	unsigned i;
	size_t n = 0;

	n += put_space(out + n);
	n += (size_t)sprintf(out + n, "{");
	for (i = 0; i < count; i++) {
		n += (size_t)sprintf(out + n, i ? "," : "");
		n += put_space(out + n);
		n += put_member(out + n, i - where);
	}
	n += (size_t)sprintf(out + n, "}");
	return n + put_space(out + n);
}

/* Changes, drops or doubles a character, or cuts the body. */
static size_t spoil(char *body, size_t length)
{
	static const char likely[] = "[]{},:\"\\0123-.eE nt\n\xc3\xa9\x01";
	const size_t at = draw() % length;

	switch (draw() % 5) {
	case 0:
		return at;
	case 1:
		memmove(body + at, body + at + 1, length - at - 1);
		return length - 1;
	case 2:
		memmove(body + at + 1, body + at, length - at);
		return length + 1;
	default:
		body[at] = likely[draw() % (sizeof likely - 1)];
		return length;
	}
}

static void test_pieces_of_random_and_spoiled_bodies(void **unused)
{
	static char body[BODY_MAX];
	struct eval_stream_options options = {.type = MEDIA_JSON,
	    .max_points = POINTS_MAX};
	size_t length, i, spoilt;

	(void)unused;
	for (i = 0; i < 12000; i++) {
		length = make_body(body);
		for (spoilt = draw() % 4; spoilt && length; spoilt--)
			length = spoil(body, length);
		assert_in_range(length, 0, BODY_MAX - 64);
		options.with_scene = draw() & 1;
		options.promise = draw() & 1 ? length : 0;
		check(&options, body, length, draw() % 3 == 0 ? 1 : 0);
	}
}

/* A body of n nested points, all different. */
static char *many(size_t n, size_t *length)
{
	char *text = malloc(n * 48 + 64), *p = text;
	size_t i;

	assert_non_null(text);
	p += sprintf(p, "{\"points\":[");
	for (i = 0; i < n; i++)
		p += sprintf(p, "%s[%zu.5,%.17g,-%zue-2]", i ? "," : "", i,
		    1.0 / (double)(i + 3), i);
	p += sprintf(p, "]}");
	*length = (size_t)(p - text);
	return text;
}

static void test_many_points_in_pieces_of_many_sizes(void **unused)
{
	struct eval_stream_options options = {.max_points = 3000};
	size_t length, size;
	char *body = many(3000, &length);

	(void)unused;
	for (size = 1; size < 2 * length; size = size * 3 + 1)
		check(&options, body, length, size);
	check(&options, body, length, 0);
	options.max_points = 2999;
	check(&options, body, length, 100);
	free(body);
}

static void test_only_the_points_are_held(void **unused)
{
	enum { N = 20000, PIECE = 1000 };
	struct eval_stream_options options = {.max_points = N};
	struct eval_request request;
	struct faults faults = {0};
	struct eval_stream *s;
	size_t length, at, n, floats = 3 * sizeof(float), base;
	char *body = many(N, &length);

	(void)unused;
	assert_int_equal(eval_stream_create(&options, &s), ERR_OK);
	base = eval_stream_bytes(s);
	for (at = 0; at < length; at += n) {
		n = length - at < PIECE ? length - at : PIECE;
		assert_int_equal(eval_stream_feed(s, body + at, n), ERR_OK);
		/* 20 bytes of text, or more, make a point. */
		assert_in_range(eval_stream_bytes(s), base,
		    base + 8192 + 2 * floats * (at + n) / 20);
	}
	assert_in_range(eval_stream_bytes(s), base + N * floats,
	    base + N * floats + 8192);
	assert_int_equal(eval_stream_finish(s, OUTPUT_VALUE, &limits, &request,
	    &faults), ERR_OK);
	assert_int_equal(request.points.count, N);
	eval_request_fini(&request);
	eval_stream_free(s);
	free(body);
}

static void test_a_failed_stream_holds_nothing_more(void **unused)
{
	struct eval_stream_options options = {.max_points = 100};
	struct eval_request request;
	struct faults faults = {0};
	struct eval_stream *s;
	size_t length, base, i;
	char *body = many(101, &length);

	(void)unused;
	assert_int_equal(eval_stream_create(&options, &s), ERR_OK);
	base = eval_stream_bytes(s);
	assert_int_equal(eval_stream_feed(s, body, length), ERR_LIMIT);
	assert_in_range(eval_stream_bytes(s), base, base + 8192);
	for (i = 0; i < 100; i++)
		assert_int_equal(eval_stream_feed(s, body, length), ERR_LIMIT);
	assert_in_range(eval_stream_bytes(s), base, base + 8192);
	assert_int_equal(eval_stream_finish(s, OUTPUT_VALUE, &limits, &request,
	    &faults), ERR_LIMIT);
	assert_string_equal(faults.list[0].detail, "more than 100 points");
	eval_stream_free(s);
	eval_stream_free(NULL);
	free(body);
}

static void check_binary(enum media_type type, const void *body,
    size_t length)
{
	struct eval_stream_options options = {.type = type,
	    .max_points = POINTS_MAX};
	size_t size;

	for (size = 0; size < 16; size++) {
		options.promise = size & 1 ? length : 0;
		check(&options, body, length, size);
	}
}

static void test_octets_in_pieces(void **unused)
{
	float values[3 * (POINTS_MAX + 2)];
	size_t length, i;

	(void)unused;
	for (i = 0; i < COUNT(values); i++)
		values[i] = (float)i - 1.5f;
	for (length = 0; length <= sizeof values; length++)
		check_binary(MEDIA_OCTETS, values, length);
	values[4] = NAN;
	values[17] = -INFINITY;
	values[26] = INFINITY;
	for (length = 0; length <= sizeof values; length++)
		check_binary(MEDIA_OCTETS, values, length);
	for (i = 0; i < COUNT(values); i++)
		values[i] = NAN;
	for (length = 0; length <= sizeof values; length += 12)
		check_binary(MEDIA_OCTETS, values, length);
}

/* An npy file of count float32 or float64 to out. */
static size_t make_npy(int version, const char *header, const double *values,
    size_t count, bool is_double, char out[static 1024])
{
	const size_t size = strlen(header), start = version > 1 ? 12 : 10;
	float single;
	size_t i;

	memset(out, 0, 16);
	memcpy(out, "\x93NUMPY", 6);
	out[6] = (char)version;
	out[8] = (char)(size & 0xff);
	out[9] = (char)(size >> 8);
	memcpy(out + start, header, size);
	for (i = 0; i < count; i++) {
		single = (float)values[i];
		if (is_double)
			memcpy(out + start + size + 8 * i, &values[i], 8);
		else
			memcpy(out + start + size + 4 * i, &single, 4);
	}
	return start + size + count * (is_double ? 8 : 4);
}

#define HEADER(descr, order, shape) \
	"{'descr': " descr ", 'fortran_order': " order ", 'shape': " shape ", }"

static void test_npy_in_pieces(void **unused)
{
	static const char *const headers[] = {
		HEADER("'<f4'", "False", "(3, 3)"),
		HEADER("'<f8'", "False", "(3, 3)"),
		HEADER("'<f8'", "False", "(0, 3)"),
		HEADER("'<f4'", "True", "(3, 3)"),
		HEADER("'<f4'", "False", "(3, 4)"),
		HEADER("'<f4'", "False", "(9, 3)"),
		HEADER("'<f4'", "False", "(9"),
		HEADER("'>f4'", "False", "(3, 3)"),
	};
	double values[9] = {1, 2, 3, 4, 5, 6, 7, 8, 0.1};
	char file[1024];
	size_t i, length;
	int version;

	(void)unused;
	for (i = 0; i < 2 * COUNT(headers); i++) {
		for (version = 0; version <= 4; version++) {
			length = make_npy(version, headers[i / 2], values, 9,
			    i / 2 == 1, file);
			check_binary(MEDIA_NPY, file, length);
			check_binary(MEDIA_NPY, file, length - 3);
			check_binary(MEDIA_NPY, file, length + 12);
		}
		values[4] = i & 1 ? 5 : 1e39;
	}
	length = make_npy(2, headers[1], values, 9, true, file);
	for (i = 0; i < length; i++)
		check_binary(MEDIA_NPY, file, i);
}

static void test_octets_are_never_held_far_ahead(void **unused)
{
	enum { N = 50000 };
	struct eval_stream_options options = {.type = MEDIA_OCTETS,
	    .max_points = N, .promise = 12 * (size_t)N};
	static const char zeros[1200];
	struct eval_request request;
	struct faults faults = {0};
	struct eval_stream *s;
	size_t base, at;

	(void)unused;
	assert_int_equal(eval_stream_create(&options, &s), ERR_OK);
	base = eval_stream_bytes(s);
	for (at = sizeof zeros; at <= options.promise; at += sizeof zeros) {
		assert_int_equal(eval_stream_feed(s, zeros, sizeof zeros),
		    ERR_OK);
		assert_in_range(eval_stream_bytes(s), base + at,
		    base + 2 * at + 4096);
	}
	assert_int_equal(eval_stream_bytes(s), base + options.promise);
	assert_int_equal(eval_stream_finish(s, OUTPUT_VALUE, &limits, &request,
	    &faults), ERR_OK);
	assert_int_equal(request.points.count, N);
	assert_int_equal(request.outputs, OUTPUT_VALUE);
	eval_request_fini(&request);
	eval_stream_free(s);
}

static void test_what_the_promise_forbids_is_refused_at_once(void **unused)
{
	struct eval_stream_options options = {.type = MEDIA_OCTETS,
	    .max_points = 10, .promise = 132};
	struct eval_request request;
	struct faults faults = {0};
	struct eval_stream *s;

	(void)unused;
	assert_int_equal(eval_stream_create(&options, &s), ERR_OK);
	assert_int_equal(eval_stream_feed(s, "a", 1), ERR_LIMIT);
	assert_int_equal(eval_stream_finish(s, OUTPUT_VALUE, &limits, &request,
	    &faults), ERR_LIMIT);
	assert_string_equal(faults.list[0].detail, "more than 10 points");
	eval_stream_free(s);
}

/* All of a stream's life; the body in pieces of 7. */
static enum err live(const struct eval_stream_options *options,
    const char *body, size_t length)
{
	struct eval_request request = {0};
	struct faults faults = {0};
	struct eval_stream *s;
	enum err err;
	size_t n;

	err = eval_stream_create(options, &s);
	if (err)
		return err;
	for (; length; length -= n, body += n) {
		n = length < 7 ? length : 7;
		err = eval_stream_feed(s, body, n);
		if (err)
			break;
	}
	if (eval_stream_finish(s, OUTPUT_VALUE, &limits, &request, &faults) !=
	    err && err)
		fail_msg("%s came first", err_message(err));
	err = request.points.count ? ERR_OK : ERR_MEMORY;
	eval_request_fini(&request);
	eval_stream_free(s);
	return err;
}

static void check_allocations(const struct eval_stream_options *options,
    const char *body, size_t length, long least)
{
	enum err err;
	long n;

	for (n = 1;; n++) {
		fail_alloc_set(n);
		err = live(options, body, length);
		if (!fail_alloc_happened())
			break;
		/* Shrinking may fail; then all is well. */
		assert_int_equal(fail_alloc_live(), 0);
	}
	fail_alloc_set(0);
	assert_int_equal(err, ERR_OK);
	assert_true(n > least);
}

static void test_every_allocation_may_fail(void **unused)
{
	struct eval_stream_options options = {.max_points = 3000};
	static const float zeros[9000];
	static const double values[9];
	char *body, file[1024];
	size_t length;

	(void)unused;
	if (!fail_alloc_available())
		skip();
	body = many(2000, &length);
	check_allocations(&options, body, length, 8);
	free(body);
	options.type = MEDIA_OCTETS;
	check_allocations(&options, (const char *)zeros, sizeof zeros, 4);
	options.type = MEDIA_NPY;
	length = make_npy(1, HEADER("'<f8'", "False", "(3, 3)"), values, 9,
	    true, file);
	check_allocations(&options, file, length, 2);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_pieces_of_bodies_with_and_without_faults),
		cmocka_unit_test(test_pieces_of_values_too_deep),
		cmocka_unit_test(test_pieces_of_random_and_spoiled_bodies),
		cmocka_unit_test(test_many_points_in_pieces_of_many_sizes),
		cmocka_unit_test(test_only_the_points_are_held),
		cmocka_unit_test(test_a_failed_stream_holds_nothing_more),
		cmocka_unit_test(test_octets_in_pieces),
		cmocka_unit_test(test_npy_in_pieces),
		cmocka_unit_test(test_octets_are_never_held_far_ahead),
		cmocka_unit_test(
		    test_what_the_promise_forbids_is_refused_at_once),
		cmocka_unit_test(test_every_allocation_may_fail),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
