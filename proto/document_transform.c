#include <math.h>

#include <cjson/cJSON.h>

#include "proto/document_reader.h"

/* A rotation written with 4 decimals is a unit quaternion to this. */
#define UNIT_TOLERANCE 1e-3

static void read_rotation(struct reader *r, const struct json_place *at,
    const struct cJSON *value, double q[static 4])
{
	double v[4], norm;
	int i;

	if (!field_numbers(r, at, value, 4, -2.0, 2.0, v))
		return;
	norm = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3]);
	if (fabs(norm - 1.0) > UNIT_TOLERANCE) {
		reader_fault(r, at,
		    "must be a unit quaternion (x y z w); its length is %.6g",
		    norm);
		return;
	}
	for (i = 0; i < 4; i++)
		q[i] = v[i] / norm;
}

static void read_scale(struct reader *r, const struct json_place *at,
    const struct cJSON *value, double s[static 3])
{
	const double most = TREE_LENGTH_MAX;
	struct json_place place = json_element(at, 0);
	double v[3];

	if (cJSON_IsNumber(value)) {
		if (!field_is_number(r, at, value, -most, most))
			return;
		v[0] = v[1] = v[2] = value->valuedouble;
	} else if (cJSON_IsArray(value)) {
		if (!field_numbers(r, at, value, 3, -most, most, v))
			return;
	} else {
		reader_fault(r, at,
		    "must be a number or an array of 3 numbers, not %s",
		    json_kind(value));
		return;
	}
	for (; place.index < 3; place.index++) {
		if (fabs(v[place.index]) < TREE_LENGTH_MIN) {
			reader_fault(r, cJSON_IsNumber(value) ? at : &place,
			    "must not be 0, or nearer to it than %g",
			    TREE_LENGTH_MIN);
			return;
		}
		s[place.index] = v[place.index];
	}
}

/* Column-major, as glTF writes it. */
static void read_matrix(struct reader *r, const struct json_place *at,
    const struct cJSON *value, struct affine *out)
{
	double m[16];
	struct affine inverse;
	int row, column;

	if (!field_numbers(r, at, value, 16, -TREE_COORDINATE_MAX,
	    TREE_COORDINATE_MAX, m))
		return;
	if (m[3] != 0.0 || m[7] != 0.0 || m[11] != 0.0 || m[15] != 1.0) {
		reader_fault(r, at, "must be affine, column by column: "
		    "numbers 4, 8 and 12 are 0, number 16 is 1");
		return;
	}
	for (row = 0; row < 3; row++) {
		for (column = 0; column < 3; column++)
			out->a[row][column] = m[4 * column + row];
		out->t[row] = m[12 + row];
	}
	if (!affine_invert(out, &inverse))
		reader_fault(r, at, "must be invertible");
}

static void read_trs(struct reader *r, const struct json_place *at,
    const struct item *item, struct affine *out)
{
	const struct json_place translation = json_member(at, "translation");
	const struct json_place rotation = json_member(at, "rotation");
	const struct json_place scale = json_member(at, "scale");
	double t[3] = {0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};

	if (item->translation)
		field_numbers(r, &translation, item->translation, 3,
		    -TREE_COORDINATE_MAX, TREE_COORDINATE_MAX, t);
	if (item->rotation)
		read_rotation(r, &rotation, item->rotation, q);
	if (item->scale)
		read_scale(r, &scale, item->scale, s);
	*out = affine_from_trs(t, q, s);
}

void transform_read(struct reader *r, const struct json_place *at,
    struct item *item)
{
	const struct json_place matrix = json_member(at, "matrix");
	struct node *node = &item->node;
	const bool trs = item->translation || item->rotation || item->scale;

	node->has_transform = trs || item->matrix;
	if (trs && item->matrix)
		reader_fault(r, &matrix, "excludes 'translation', "
		    "'rotation' and 'scale'");
	else if (trs)
		read_trs(r, at, item, &node->transform);
	else if (item->matrix)
		read_matrix(r, &matrix, item->matrix, &node->transform);
}
