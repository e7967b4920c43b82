/*
 * The widest vectors that tests build kernels for: 16 on a processor. A GPU's
 * compiler takes minutes for those, and nobody would use them there.
 */
#ifndef TESTS_SUPPORT_WIDEST_H
#define TESTS_SUPPORT_WIDEST_H

#include "kernels/device_internal.h"

static inline int widest(void)
{
	struct device_failure failure = {0};
	struct device_info info = {0};
	cl_device_id id;

	if (device_select(NULL, &id, &info, &failure) != ERR_OK)
		info.is_gpu = false;
	device_failure_fini(&failure);
	return info.is_gpu ? 2 : 16;
}

#endif
