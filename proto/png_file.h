/*
 * PNG pictures, by libpng.
 */
#ifndef PROTO_PNG_FILE_H
#define PROTO_PNG_FILE_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

/* width * height pixels, sRGB with alpha, rows from the top; *data (malloc'd)
 * is the caller's. ERR_MEMORY. */
enum err png_write(const uint8_t *rgba, size_t width, size_t height,
    char **data, size_t *length);

#endif
