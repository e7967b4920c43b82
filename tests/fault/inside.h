/*
 * Inside the daemon: whether a call is to fail. Included by each library once.
 */
#ifndef TESTS_FAULT_INSIDE_H
#define TESTS_FAULT_INSIDE_H

#include <dlfcn.h>
#include <fcntl.h>
#include <link.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "tests/fault/fault.h"

#define PARTS_MAX 16

/* A part of the address space that a call may come from. */
struct inside_part {
	uintptr_t from, to, base;
};

static struct fault_control *control; /* NULL: nothing fails */
static struct inside_part parts[PARTS_MAX];
static int part_count;

static bool is_ours(const char *name)
{
	return name[0] == '\0' || strstr(name, "libcjson") != NULL ||
	    strstr(name, "libsqlite3") != NULL;
}

/* The executable comes first, without a name. */
static int note_part(struct dl_phdr_info *info, size_t size, void *ctx)
{
	(void)size;
	(void)ctx;
	if (!is_ours(info->dlpi_name))
		return 0;
	for (int i = 0; i < info->dlpi_phnum; i++) {
		const ElfW(Phdr) *p = &info->dlpi_phdr[i];

		if (p->p_type != PT_LOAD || (p->p_flags & PF_X) == 0 ||
		    part_count == PARTS_MAX)
			continue;
		parts[part_count++] = (struct inside_part){
			info->dlpi_addr + p->p_vaddr,
			info->dlpi_addr + p->p_vaddr + p->p_memsz,
			info->dlpi_addr};
	}
	return 0;
}

__attribute__((constructor))
static void inside_open(void)
{
	const char *path = getenv("FAULT_CONTROL");
	void *at;
	int fd;

	if (path == NULL || (fd = open(path, O_RDWR | O_CLOEXEC)) < 0)
		return;
	at = mmap(NULL, sizeof *control, PROT_READ | PROT_WRITE, MAP_SHARED,
	    fd, 0);
	close(fd);
	dl_iterate_phdr(note_part, NULL);
	if (at != MAP_FAILED)
		control = at;
}

/* Whether the call that returns there is the program's, or cJSON's or
 * SQLite's. */
__attribute__((unused))
static bool is_from_ours(const void *address)
{
	uintptr_t at = (uintptr_t)address;

	for (int i = 0; i < part_count; i++)
		if (at >= parts[i].from && at < parts[i].to)
			return true;
	return false;
}

/* Counts a call of kind, which returns to address; whether it is to fail. */
static bool fails(enum fault_kind kind, const char *name, const void *address)
{
	unsigned long number;

	if (control == NULL)
		return false;
	number = atomic_fetch_add(&control->calls[kind], 1) + 1;
	if (atomic_load(&control->kind) != (int)kind ||
	    number < atomic_load(&control->first) ||
	    number > atomic_load(&control->last))
		return false;
	strncpy(control->name, name, sizeof control->name - 1);
	atomic_store(&control->at, part_count > 0 ?
	    (uintptr_t)address - parts[0].base : 0);
	atomic_fetch_add(&control->failed, 1);
	return true;
}

/* The function of that name that would be called without us. */
static void *next_of(const char *name)
{
	void *found = dlsym(RTLD_NEXT, name);

	if (found == NULL) {
		fprintf(stderr, "fault: there is no %s\n", name);
		abort();
	}
	return found;
}

/* ... declared as *pointer, found once. */
#define FIND(pointer, name) do { \
	void *found_ = atomic_load(&pointer); \
	if (found_ == NULL) \
		atomic_store(&pointer, next_of(name)); \
} while (0)

#define HERE __builtin_return_address(0)

#endif
