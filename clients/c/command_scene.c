#include <errno.h>
#include <string.h>
#include <unistd.h>

#include "clients/c/command.h"

static bool is_file(const char *argument)
{
	return strcmp(argument, "-") == 0 || access(argument, F_OK) == 0 ||
	    strchr(argument, '/') != NULL ||
	    command_has_extension(argument, ".json");
}

bool command_is_id(const struct session *s, const char *text)
{
	static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
	    "abcdefghijklmnopqrstuvwxyz0123456789_.-";
	const size_t length = strlen(text);

	if (length > 0 && length < BLOBFIELD_ID_MAX &&
	    strspn(text, letters) == length && strcmp(text, ".") != 0 &&
	    strcmp(text, "..") != 0)
		return true;
	command_say(s, "'%s' is none: 1 to 64 of A-Z a-z 0-9 _ . -\n", text);
	return false;
}

int command_open_scene(struct session *s, const char *argument)
{
	if (!is_file(argument)) {
		if (strlen(argument) >= sizeof s->id) {
			command_say(s, "'%s' is neither a file nor an id\n",
			    argument);
			return COMMAND_USAGE;
		}
		strcpy(s->id, argument);
		return COMMAND_DONE;
	}
	if (!command_read(s, argument, &s->text))
		return COMMAND_FILE;
	s->source = strcmp(argument, "-") == 0 ? "stdin" : argument;
	if (blobfield_post(s->client, (const char *)s->text.data,
	    s->text.size, s->id) != BLOBFIELD_OK)
		return command_fail(s, true);
	s->is_temporary = true;
	return COMMAND_DONE;
}

void command_close_scene(struct session *s)
{
	if (s->is_temporary)
		blobfield_delete(s->client, s->id);
	s->is_temporary = false;
	blobfield_bytes_fini(&s->text);
}
