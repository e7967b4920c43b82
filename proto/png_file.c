#include "proto/png_file.h"

#include <setjmp.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include <png.h>

/* Of zlib: level 6 takes three times as long for 5 % less. */
#define COMPRESSION 3

/* A file being written. */
struct file {
	char *data;
	size_t length, room;
};

/* libpng's errors end in longjmp; of memory is the only one there can be. */
static void put(png_structp png, png_bytep bytes, size_t count)
{
	struct file *f = png_get_io_ptr(png);
	size_t room = f->room;
	char *data = f->data;

	if (f->room - f->length < count) {
		room += room / 2 + count + 8192;
		data = realloc(f->data, room);
		if (data == NULL)
			png_error(png, "no memory");
		f->data = data;
		f->room = room;
	}
	memcpy(data + f->length, bytes, count);
	f->length += count;
}

static void flush(png_structp png)
{
	(void)png;
}

static void silent(png_structp png, png_const_charp message)
{
	(void)png;
	(void)message;
}

static void fail(png_structp png, png_const_charp message)
{
	(void)message;
	png_longjmp(png, 1);
}

static bool is_opaque(const uint8_t *rgba, size_t pixels)
{
	for (size_t i = 0; i < pixels; i++) {
		if (rgba[4 * i + 3] != 255)
			return false;
	}
	return true;
}

/* All of it; png's errors jump. */
static void write_all(png_structp png, png_infop info, const uint8_t *rgba,
    size_t width, size_t height)
{
	const bool opaque = is_opaque(rgba, width * height);

	png_set_IHDR(png, info, (png_uint_32)width, (png_uint_32)height, 8,
	    opaque ? PNG_COLOR_TYPE_RGB : PNG_COLOR_TYPE_RGBA,
	    PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
	    PNG_FILTER_TYPE_DEFAULT);
	png_set_sRGB_gAMA_and_cHRM(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
	png_set_compression_level(png, COMPRESSION);
	png_write_info(png, info);
	if (opaque)
		png_set_filler(png, 0, PNG_FILLER_AFTER);
	for (size_t i = 0; i < height; i++)
		png_write_row(png, rgba + 4 * width * i);
	png_write_end(png, info);
}

enum err png_write(const uint8_t *rgba, size_t width, size_t height,
    char **data, size_t *length)
{
	struct file file = {0};
	struct file *const f = &file; /* lives through longjmp */
	png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL,
	    fail, silent);
	png_infop info = png != NULL ? png_create_info_struct(png) : NULL;

	if (info == NULL) {
		png_destroy_write_struct(&png, NULL);
		return ERR_MEMORY;
	}
	png_set_write_fn(png, f, put, flush);
	if (setjmp(png_jmpbuf(png)) != 0) {
		png_destroy_write_struct(&png, &info);
		free(f->data);
		return ERR_MEMORY;
	}
	write_all(png, info, rgba, width, height);
	png_destroy_write_struct(&png, &info);
	*data = f->data;
	*length = f->length;
	return ERR_OK;
}
