#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/command.h"
#include "proto/fault.h"
#include "proto/npy.h"
#include "proto/number.h"

static const char blanks[] = " \t\r\n,;";

void rows_fini(struct rows *rows)
{
	free(rows->data);
	rows->data = NULL;
	rows->count = 0;
}

/* Room for count more; NULL: none. */
static float *grow(struct rows *rows, size_t count)
{
	const size_t size = rows->columns * sizeof(float);
	float *larger;

	if (count > (SIZE_MAX / size - 1) / 2 - rows->count)
		return NULL;
	larger = realloc(rows->data, (rows->count + count + 1) * size);
	if (larger == NULL)
		return NULL;
	rows->data = larger;
	return larger + rows->count * rows->columns;
}

/* One line's numbers, columns of them, to out. */
static bool read_numbers(const char *text, size_t columns, float *out)
{
	size_t n = 0;

	for (text += strspn(text, blanks); *text != '\0' && *text != '#';
	    text += strspn(text, blanks)) {
		char *end;
		const float number = strtof(text, &end);

		if (end == text || n == columns || !isfinite(number) ||
		    (*end != '\0' && *end != '#' &&
		    strchr(blanks, *end) == NULL))
			return false;
		out[n++] = number;
		text = end;
	}
	return n == columns;
}

bool rows_add(struct rows *rows, const char *text)
{
	float *row = grow(rows, 1);

	if (row == NULL || !read_numbers(text, rows->columns, row))
		return false;
	rows->count++;
	return true;
}

static bool is_empty(const char *line)
{
	line += strspn(line, blanks);
	return *line == '\0' || *line == '#';
}

/* Words, and no number: names of columns. */
static bool is_heading(const char *line)
{
	char *end;

	line += strspn(line, blanks);
	strtof(line, &end);
	return end == line;
}

/* Lines; text is written into. */
static bool add_text(const struct session *s, struct rows *rows,
    const char *path, char *text)
{
	size_t number = 0, lines = 2, used = 0;
	float *at;

	for (const char *p = text; *p != '\0'; p++)
		lines += *p == '\n';
	at = grow(rows, lines);
	if (at == NULL) {
		command_say(s, "%s: out of memory\n", path);
		return false;
	}
	for (char *line = text, *next; line != NULL; line = next) {
		next = strchr(line, '\n');
		if (next != NULL)
			*next++ = '\0';
		number++;
		if (is_empty(line) || (used == 0 && number == 1 &&
		    is_heading(line)))
			continue;
		if (!read_numbers(line, rows->columns,
		    at + used * rows->columns)) {
			command_say(s, "%s:%zu: must have %zu finite "
			    "numbers\n", path, number, rows->columns);
			return false;
		}
		used++;
	}
	rows->count += used;
	return true;
}

static bool add_octets(const struct session *s, struct rows *rows,
    const char *path, const struct blobfield_bytes *bytes)
{
	const size_t size = rows->columns * sizeof(float);
	float *at = bytes->size % size == 0 ? grow(rows, bytes->size / size) :
	    NULL;

	if (at == NULL) {
		command_say(s, "%s: %zu bytes are not whole rows of %zu "
		    "float32\n", path, bytes->size, rows->columns);
		return false;
	}
	memcpy(at, bytes->data, bytes->size);
	rows->count += bytes->size / size;
	return true;
}

static bool add_npy(const struct session *s, struct rows *rows,
    const char *path, const struct blobfield_bytes *bytes)
{
	struct faults faults = {0};
	struct npy npy;
	size_t count;
	float *at;

	if (npy_read(bytes->data, bytes->size, &npy, &faults) != ERR_OK) {
		command_say(s, "%s: %s\n", path, faults.list[0].detail);
		return false;
	}
	count = (size_t)npy.shape[0];
	if (npy.axes != 2 || npy.is_fortran ||
	    npy.shape[1] != rows->columns || npy.length !=
	    npy.shape[0] * rows->columns * (npy.is_double ? 8 : 4)) {
		command_say(s, "%s: must be an array of shape (N, %zu), in C "
		    "order, and whole\n", path, rows->columns);
		return false;
	}
	at = grow(rows, count);
	if (at == NULL || npy_floats(npy.data, count * rows->columns,
	    npy.is_double, at) > 0) {
		command_say(s, "%s: %s\n", path, at == NULL ?
		    "out of memory" : "has numbers that float32 cannot hold");
		return false;
	}
	rows->count += count;
	return true;
}

bool rows_read(const struct session *s, struct rows *rows, const char *path)
{
	struct blobfield_bytes bytes = {0};
	bool done;

	if (!command_read(s, path, &bytes))
		return false;
	if (command_has_extension(path, ".npy") || (bytes.size >= 6 &&
	    memcmp(bytes.data, "\x93NUMPY", 6) == 0))
		done = add_npy(s, rows, path, &bytes);
	else if (command_has_extension(path, ".f32"))
		done = add_octets(s, rows, path, &bytes);
	else
		done = add_text(s, rows, path, (char *)bytes.data);
	blobfield_bytes_fini(&bytes);
	return done;
}

/* ---- writing ---- */

static void print_number(FILE *out, float number)
{
	char text[NUMBER_FLOAT_ROOM];

	/* The daemon never sends others, and JSON has none. */
	if (!isfinite(number))
		fputs("null", out);
	else
		fwrite(text, 1, number_print_float(number, text), out);
}

static void print_csv(FILE *out, const struct rows *a, const struct rows *b,
    const char *names)
{
	fprintf(out, "%s\n", names);
	for (size_t i = 0; i < b->count; i++) {
		for (size_t j = 0; j < a->columns; j++) {
			print_number(out, a->data[i * a->columns + j]);
			fputc(',', out);
		}
		for (size_t j = 0; j < b->columns; j++) {
			print_number(out, b->data[i * b->columns + j]);
			fputc(j + 1 < b->columns ? ',' : '\n', out);
		}
	}
}

static void print_json_row(FILE *out, const float *row, size_t columns,
    bool *is_first)
{
	for (size_t j = 0; j < columns; j++) {
		if (!*is_first)
			fputc(',', out);
		print_number(out, row[j]);
		*is_first = false;
	}
}

/* {"columns": [names], "rows": [[…], …]} */
static void print_json(FILE *out, const struct rows *a, const struct rows *b,
    const char *names)
{
	fputs("{\"columns\":[\"", out);
	for (; *names != '\0'; names++)
		if (*names == ',')
			fputs("\",\"", out);
		else
			fputc(*names, out);
	fputs("\"],\"rows\":[", out);
	for (size_t i = 0; i < b->count; i++) {
		bool is_first = true;

		fputs(i > 0 ? ",\n[" : "\n[", out);
		print_json_row(out, a->data + i * a->columns, a->columns,
		    &is_first);
		print_json_row(out, b->data + i * b->columns, b->columns,
		    &is_first);
		fputc(']', out);
	}
	fputs("\n]}\n", out);
}

/* (rows, columns), or of a grid (nx, ny, nz, columns), without the last where
 * that is 1: as the daemon has it. */
static void print_shape(char *out, size_t size, const struct rows *b)
{
	int used;

	if (b->counts == NULL) {
		snprintf(out, size, "(%zu, %zu)", b->count, b->columns);
		return;
	}
	used = snprintf(out, size, "(%d, %d, %d", b->counts[0], b->counts[1],
	    b->counts[2]);
	snprintf(out + used, size - (size_t)used, b->columns > 1 ?
	    ", %zu)" : ")", b->columns);
}

/* Format 1.0; what precedes the numbers is a multiple of 64 bytes. */
static void print_npy(FILE *out, const struct rows *b)
{
	char header[118], shape[48];

	print_shape(shape, sizeof shape, b);
	snprintf(header, sizeof header, "{'descr': '<f4', 'fortran_order': "
	    "False, 'shape': %s, }", shape);
	fprintf(out, "\x93NUMPY%c%c%c%c%-117s\n", 1, 0, 118, 0, header);
	fwrite(b->data, sizeof(float), b->count * b->columns, out);
}

bool rows_write(const struct session *s, const char *path,
    const struct rows *a, const struct rows *b, const char *names)
{
	char *text = NULL;
	size_t size = 0;
	FILE *out = open_memstream(&text, &size);
	const char *by = path != NULL ? path : "-.csv";
	bool done;

	if (out == NULL) {
		command_say(s, "out of memory\n");
		return false;
	}
	if (command_has_extension(by, ".npy"))
		print_npy(out, b);
	else if (command_has_extension(by, ".f32"))
		fwrite(b->data, sizeof(float), b->count * b->columns, out);
	else if (command_has_extension(by, ".json"))
		print_json(out, a, b, names);
	else
		print_csv(out, a, b, names);
	done = fclose(out) == 0 && command_write(s, path, text, size);
	free(text);
	return done;
}
