#include "tests/support/folder.h"

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <dirent.h>
#include <ftw.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

void folder_make(char path[static PATH_MAX])
{
	const char *above = getenv("TMPDIR");

	snprintf(path, PATH_MAX, "%s/blobfield-XXXXXX",
	    above != NULL ? above : "/tmp");
	assert_non_null(mkdtemp(path));
}

static int remove_one(const char *path, const struct stat *info, int type,
    struct FTW *ftw)
{
	(void)info, (void)type, (void)ftw;
	return remove(path);
}

void folder_remove(const char *path)
{
	nftw(path, remove_one, 16, FTW_DEPTH | FTW_PHYS);
}

int folder_each(const char *path, void (*each)(void *ctx, const char *file),
    void *ctx)
{
	DIR *dir = opendir(path);
	struct dirent *entry;
	int count = 0;

	assert_non_null(dir);
	while ((entry = readdir(dir)) != NULL) {
		char file[PATH_MAX + NAME_MAX + 2];

		if (entry->d_name[0] == '.')
			continue;
		count++;
		snprintf(file, sizeof file, "%s/%s", path, entry->d_name);
		if (each != NULL)
			each(ctx, file);
	}
	closedir(dir);
	return count;
}

struct search {
	const char *prefix;
	char *file; /* NULL: count only */
	int count;
};

static void look(void *ctx, const char *file)
{
	struct search *search = ctx;
	const char *name = strrchr(file, '/') + 1;

	if (strncmp(name, search->prefix, strlen(search->prefix)) != 0)
		return;
	if (search->file != NULL && search->count == 0)
		snprintf(search->file, PATH_MAX, "%s", file);
	search->count++;
}

int folder_count(const char *path, const char *prefix)
{
	struct search search = {.prefix = prefix};

	folder_each(path, look, &search);
	return search.count;
}

void folder_find(const char *path, const char *prefix,
    char file[static PATH_MAX])
{
	struct search search = {.prefix = prefix, .file = file};

	folder_each(path, look, &search);
	assert_true(search.count > 0);
}
