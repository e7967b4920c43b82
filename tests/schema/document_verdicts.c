/*
 * Reads documents from stdin, one a line, and writes a line for each: "ok", or
 * the faults, "pointer<TAB>detail" separated by tabs.
 */
#include <stdio.h>
#include <stdlib.h>

#include "proto/document.h"
#include "proto/fault.h"

static void print_verdict(const char *line, size_t length)
{
	const struct document_limits limits = {.max_nodes = 10000,
	    .layout = LAYOUT_WARPED};
	struct faults faults = {0};
	struct document *d = NULL;
	enum err err = document_parse(line, length, &limits, &d, &faults);

	if (err == ERR_OK)
		printf("ok");
	for (size_t i = 0; err != ERR_OK && i < faults.count && i < FAULT_MAX;
	    i++)
		printf("%s%s\t%s", i ? "\t" : "", faults.list[i].pointer,
		    faults.list[i].detail);
	printf("\n");
	document_free(d);
}

int main(void)
{
	char *line = NULL;
	size_t size = 0;
	ssize_t length;

	while ((length = getline(&line, &size, stdin)) > 0) {
		if (line[length - 1] == '\n')
			length--;
		print_verdict(line, (size_t)length);
	}
	free(line);
	return 0;
}
