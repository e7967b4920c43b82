/*
 * Built programs kept in a cache folder (kernels/cache_file.h). A damaged
 * binary can end the process that hands it to OpenCL, so none is handed on
 * unless its checksum holds.
 *
 * Their key: the source, the build's options, the platform's and the device's
 * names and versions, the driver's version, the vendor, the size of a pointer.
 */
#ifndef KERNELS_DEVICE_CACHE_H
#define KERNELS_DEVICE_CACHE_H

#include "kernels/device_internal.h"

/*
 * As device_build, but from folder if the program is there, which *is_cached
 * then says. folder NULL: as device_build. What is damaged, or refused by the
 * device, is built from source and not mentioned.
 */
enum err device_cache_build(const char *folder, cl_context context,
    cl_device_id id, const char *source, const char *options,
    cl_program *out, bool *is_cached, struct device_failure *failure);

/*
 * Writes program, built so, into folder. PoCL 3.1 adds to a binary each kernel
 * that has been launched, in the form it was launched in, and a general form
 * that it compiles now: 6 to 10 s. ERR_DEVICE, ERR_MEMORY, ERR_IO (with errno).
 */
enum err device_cache_store(const char *folder, cl_device_id id,
    const char *source, const char *options, cl_program program,
    struct device_failure *failure);

/* Removes what d was opened with from the cache; false if that is nothing. */
bool device_cache_forget(struct device *d);

#endif
