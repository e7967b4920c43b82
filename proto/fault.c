#include "proto/fault.h"

#include <stdarg.h>
#include <stdio.h>

#include "proto/text.h"

/* Longer than a detail, so that a cut shows as "...". */
#define DRAFT_MAX (FAULT_DETAIL_MAX + 64)

void faults_add(struct faults *faults, const char *pointer,
    const char *detail, ...)
{
	struct fault *fault;
	char draft[DRAFT_MAX];
	va_list ap;

	if (faults->count++ >= FAULT_MAX)
		return;
	fault = &faults->list[faults->count - 1];
	text_clean(pointer, 1, fault->pointer, sizeof fault->pointer);
	va_start(ap, detail);
	if (vsnprintf(draft, sizeof draft, detail, ap) < 0)
		draft[0] = '\0';
	va_end(ap);
	text_clean(draft, 0, fault->detail, sizeof fault->detail);
}
