/*
 * A device that is played: every field is that of a ball, so that there is a
 * surface to be meshed and drawn, and nothing takes time. Operator tables are
 * neither filled nor measured, which nobody sees here (-Wl,--wrap=NAME).
 */
#include <string.h>
#include <stdlib.h>

#include "core/output.h"
#include "core/table.h"
#include "kernels/device.h"

struct device {
	int slots; /* given so far */
};

struct device_tape {
	struct device *device;
};

void __wrap_table_build(struct table *t, int first, int last);
void __wrap_table_measure(const struct table *t, size_t first, size_t last,
    float *errors, size_t stride);
void __wrap_table_sample(enum operator_family family,
    const struct profile *profile, size_t first, size_t last, double *g);
double __wrap_table_measure_g(const struct table *t, size_t first,
    size_t last, const double *exact, double *sum);

void __wrap_table_build(struct table *t, int first, int last)
{
	(void)t, (void)first, (void)last;
}

void __wrap_table_measure(const struct table *t, size_t first, size_t last,
    float *errors, size_t stride)
{
	(void)t;
	for (size_t k = 0; k < TABLE_QUANTITIES; k++)
		for (size_t i = first; i < last; i++)
			errors[k * stride + i] = 0.001f;
}

void __wrap_table_sample(enum operator_family family,
    const struct profile *profile, size_t first, size_t last, double *g)
{
	(void)family, (void)profile;
	for (size_t i = first; i < last; i++)
		g[i] = 0.5;
}

/* As if the error fell with the square of the resolution. */
double __wrap_table_measure_g(const struct table *t, size_t first,
    size_t last, const double *exact, double *sum)
{
	double error = 4.0 / ((double)t->resolution * t->resolution);

	(void)exact;
	*sum += (double)(last - first) * 0.1 * error;
	return error;
}

enum err device_open(const struct device_options *options, struct device **out,
    struct device_failure *failure)
{
	(void)options, (void)failure;
	*out = calloc(1, sizeof **out);
	return *out != NULL ? ERR_OK : ERR_MEMORY;
}

enum err device_check(const struct device_options *options,
    struct device_failure *failure)
{
	(void)options, (void)failure;
	return ERR_OK;
}

void device_failure_fini(struct device_failure *failure)
{
	(void)failure;
}

void device_close(struct device *d)
{
	free(d);
}

enum err device_keep_kernels(struct device *d)
{
	(void)d;
	return ERR_OK;
}

const struct device_info *device_get_info(const struct device *d)
{
	static const struct device_info info = {.name = "played"};

	(void)d;
	return &info;
}

const struct device_times *device_get_times(const struct device *d)
{
	static const struct device_times times = {1e-6, 1e-6, 1e-6};

	(void)d;
	return &times;
}

const char *device_message(const struct device *d)
{
	(void)d;
	return "as told";
}

size_t device_table_bytes(const struct device *d, size_t *most)
{
	(void)d;
	*most = (size_t)1 << 30;
	return 0;
}

enum err device_load_table(struct device *d, const struct table *table,
    int *slot)
{
	(void)table;
	*slot = ++d->slots;
	return ERR_OK;
}

void device_drop_table(struct device *d, int slot)
{
	(void)d, (void)slot;
}

enum err device_load_tape(struct device *d, const struct tape *tape,
    const int *slots, struct device_tape **out)
{
	(void)tape, (void)slots;
	*out = malloc(sizeof **out);
	if (*out == NULL)
		return ERR_MEMORY;
	(*out)->device = d;
	return ERR_OK;
}

void device_drop_tape(struct device *d, struct device_tape *t)
{
	(void)d;
	free(t);
}

size_t device_tape_bytes(const struct device_tape *t)
{
	return sizeof *t;
}

/* f = (1 - r^2 / 4)^2 within r = 2; u is 1 - r^2 / 4. */
static float *write_value(float *row, float u)
{
	*row++ = u * u;
	return row;
}

/* -u p */
static float *write_gradient(float *row, const float *p, float u)
{
	for (int k = 0; k < 3; k++)
		*row++ = -u * p[k];
	return row;
}

/* p_i p_j / 2 - u delta_ij */
static float *write_hessian(float *row, const float *p, float u)
{
	for (int k = 0; k < 3; k++)
		*row++ = u > 0.0f ? 0.5f * p[k] * p[k] - u : 0.0f;
	*row++ = u > 0.0f ? 0.5f * p[0] * p[1] : 0.0f;
	*row++ = u > 0.0f ? 0.5f * p[0] * p[2] : 0.0f;
	*row++ = u > 0.0f ? 0.5f * p[1] * p[2] : 0.0f;
	return row;
}

static float *write_row(float *row, const float *p, unsigned outputs)
{
	float r2 = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
	float u = r2 < 4.0f ? 1.0f - 0.25f * r2 : 0.0f;
	int rest = output_row_floats(outputs & ~(OUTPUT_VALUE |
	    OUTPUT_GRADIENT | OUTPUT_HESSIAN));

	if (outputs & OUTPUT_VALUE)
		row = write_value(row, u);
	if (outputs & OUTPUT_GRADIENT)
		row = write_gradient(row, p, u);
	if (outputs & OUTPUT_HESSIAN)
		row = write_hessian(row, p, u);
	memset(row, 0, (size_t)rest * sizeof *row);
	return row + rest;
}

enum err device_evaluate(struct device *d, struct device_tape *t,
    const float *points, size_t count, unsigned outputs, float *rows,
    bool (*go_on)(void *ctx), void *ctx)
{
	(void)d, (void)t;
	if (go_on != NULL && !go_on(ctx))
		return ERR_CANCELLED;
	for (size_t i = 0; i < count; i++)
		rows = write_row(rows, points + 3 * i, outputs);
	return ERR_OK;
}

enum err device_evaluate_parts(struct device *d, struct device_tape *t,
    const struct device_part *parts, size_t part_count, unsigned outputs)
{
	for (size_t i = 0; i < part_count; i++)
		device_evaluate(d, t, parts[i].points, parts[i].count,
		    outputs, parts[i].rows, NULL, NULL);
	return ERR_OK;
}
