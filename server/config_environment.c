/*
 * Options in the environment.
 */
#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/config_internal.h"
#include "server/log.h"

#define PREFIX "BLOBFIELDD_"

void config_variable(const struct config_option *option,
    char name[static CONFIG_NAME_MAX])
{
	char *p = name + sprintf(name, PREFIX);

	for (const char *from = option->name; *from != '\0'; from++)
		*p++ = *from == '-' ? '_' :
		    (char)toupper((unsigned char)*from);
	*p = '\0';
}

static bool read_variable(struct config_reading *reading,
    const struct config_option *option)
{
	struct config_origin origin = {CONFIG_OF_ENVIRONMENT, 0, option};
	char name[CONFIG_NAME_MAX], why[CONFIG_WHY_MAX];
	const char *value;

	config_variable(option, name);
	value = getenv(name);
	if (value == NULL || value[0] == '\0')
		return true;
	if (config_set(reading, origin, value, why))
		return true;
	fprintf(stderr, "blobfieldd: %s: must be %s, not '%.64s'\n", name, why,
	    value);
	return false;
}

bool config_environment_read(struct config_reading *reading)
{
	const char *path = getenv(PREFIX "CONFIG");
	const struct config_option *o;

	for (o = config_options; o->name != NULL; o++) {
		if (config_option_is_kept(o) && !read_variable(reading, o))
			return false;
	}
	if (reading->path == NULL && path != NULL && path[0] != '\0')
		reading->path = path;
	return true;
}

static bool is_variable(const struct config_option *option,
    const char *entry)
{
	char name[CONFIG_NAME_MAX];

	config_variable(option, name);
	return strlen(name) == strcspn(entry, "=") &&
	    strncmp(entry, name, strlen(name)) == 0 &&
	    (config_option_is_kept(option) || option->kind == CONFIG_PATH);
}

/* Says what entry may be meant as. */
static void warn_of(const char *entry)
{
	const struct config_option *like;
	int length = (int)strcspn(entry, "=");
	char name[CONFIG_NAME_MAX], *p = name;

	for (int i = (int)strlen(PREFIX); i < length && p < name + 64; i++)
		*p++ = entry[i] == '_' ? '-' :
		    (char)tolower((unsigned char)entry[i]);
	*p = '\0';
	like = config_option_like(name);
	if (like != NULL && (config_option_is_kept(like) ||
	    like->kind == CONFIG_PATH)) {
		config_variable(like, name);
		log_write(LOG_WARNING, "the environment's %.*s is no option; "
		    "did you mean %s?", length, entry, name);
	} else {
		log_write(LOG_WARNING, "the environment's %.*s is no option",
		    length, entry);
	}
}

void config_environment_warn(void)
{
	for (char **entry = environ; *entry != NULL; entry++) {
		const struct config_option *o = config_options;

		if (strncmp(*entry, PREFIX, strlen(PREFIX)) != 0)
			continue;
		while (o->name != NULL && !is_variable(o, *entry))
			o++;
		if (o->name == NULL)
			warn_of(*entry);
	}
}
