#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clients/c/command.h"

static bool read_all(FILE *file, struct blobfield_bytes *out)
{
	size_t room = 0, n;

	do {
		if (out->size + 1 >= room) {
			unsigned char *larger;

			room = 2 * room + 65536;
			larger = realloc(out->data, room);
			if (larger == NULL)
				return false;
			out->data = larger;
		}
		n = fread(out->data + out->size, 1, room - out->size - 1,
		    file);
		out->size += n;
	} while (n > 0);
	out->data[out->size] = '\0';
	return ferror(file) == 0;
}

bool command_read(const struct session *s, const char *path,
    struct blobfield_bytes *out)
{
	const bool is_stdin = strcmp(path, "-") == 0;
	FILE *file = is_stdin ? stdin : fopen(path, "rb");
	struct blobfield_bytes bytes = {0};
	bool done;

	done = file != NULL && read_all(file, &bytes);
	if (!done)
		command_say(s, "%s: %s\n", path, strerror(errno));
	if (file != NULL && !is_stdin)
		fclose(file);
	if (done)
		*out = bytes;
	else
		blobfield_bytes_fini(&bytes);
	return done;
}

/* Where a rename would take a device's or a pipe's place. */
static bool is_special(const char *path)
{
	struct stat stat_of;

	return stat(path, &stat_of) == 0 && !S_ISREG(stat_of.st_mode);
}

static bool write_to(const char *path, const void *data, size_t size)
{
	FILE *file = fopen(path, "wb");
	bool done;

	if (file == NULL)
		return false;
	done = fwrite(data, 1, size, file) == size;
	return fclose(file) == 0 && done;
}

static bool replace(const char *path, const void *data, size_t size)
{
	char *part = malloc(strlen(path) + 6);
	bool done;

	if (part == NULL)
		return false;
	strcat(strcpy(part, path), ".part");
	done = write_to(part, data, size) && rename(part, path) == 0;
	if (!done) {
		const int because = errno;

		unlink(part);
		errno = because;
	}
	free(part);
	return done;
}

bool command_write(const struct session *s, const char *path,
    const void *data, size_t size)
{
	bool done;

	if (path == NULL || strcmp(path, "-") == 0) {
		path = "stdout";
		done = fwrite(data, 1, size, stdout) == size &&
		    fflush(stdout) == 0;
	} else if (is_special(path)) {
		done = write_to(path, data, size);
	} else {
		done = replace(path, data, size);
	}
	if (!done)
		command_say(s, "%s: %s\n", path, strerror(errno));
	return done;
}

bool command_has_extension(const char *path, const char *extension)
{
	const size_t length = strlen(path), n = strlen(extension);

	return length > n && strcasecmp(path + length - n, extension) == 0;
}
