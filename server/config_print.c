/*
 * --print-config: a file that reads back to the same configuration.
 */
#include <stdio.h>
#include <string.h>

#include "server/config_internal.h"

/* As a file has it: in quotes where it would be read otherwise. */
static void quote(const char *value, char *out)
{
	size_t length = strlen(value);

	if (strpbrk(value, "\"#\\") == NULL && value[0] != ' ' &&
	    (length == 0 || value[length - 1] != ' ')) {
		strcpy(out, value);
		return;
	}
	*out++ = '"';
	for (; *value != '\0'; value++) {
		if (*value == '"' || *value == '\\')
			*out++ = '\\';
		*out++ = *value;
	}
	strcpy(out, "\"");
}

/* Other than by the option that decides: there is a store instead. */
static bool is_idle(const struct config_option *option,
    const struct config *config)
{
	return strcmp(option->name, "data") == 0 && config->store[0] != '\0';
}

static void print_origin(struct config_reading *reading,
    const struct config_option *option)
{
	const struct config_origin *origin = config_origin_of(reading, option);
	char name[CONFIG_NAME_MAX];

	switch (origin->rank) {
	case CONFIG_OF_DEFAULT:
		printf("default");
		break;
	case CONFIG_OF_FILE:
		printf("%s:%d", reading->path, origin->line);
		break;
	case CONFIG_OF_ENVIRONMENT:
		config_variable(origin->option, name);
		printf("environment: %s", name);
		break;
	case CONFIG_OF_FLAG:
		printf("flag: --%s", origin->option->name);
		break;
	}
	if (is_idle(option, reading->config))
		printf("; not used: there is a store");
}

/* is_off: as a comment, which does not set it. */
static void print_line(struct config_reading *reading,
    const struct config_option *option, bool is_off, const char *value,
    const char *note)
{
	char line[2 * CONFIG_VALUE_MAX + CONFIG_NAME_MAX];

	snprintf(line, sizeof line, "%s%s = %s", is_off ? "#" : "",
	    option->name, value);
	printf("%-40s # ", line);
	print_origin(reading, option);
	printf("%s\n", note);
}

static void print_option(struct config_reading *reading,
    const struct config_option *option)
{
	char value[CONFIG_VALUE_MAX], shown[2 * CONFIG_VALUE_MAX];

	if (!config_value_print(option, reading->config, value)) {
		print_line(reading, option, true, "", "");
		return;
	}
	if (option->kind == CONFIG_URL && config_value_hide(value, shown)) {
		print_line(reading, option, true, shown,
		    "; put its password in");
		return;
	}
	quote(value, shown);
	print_line(reading, option, false, shown, "");
}

/* What "" says cannot be said by the option itself: --no-cache. */
static void print_preset(struct config_reading *reading,
    const struct config_option *option)
{
	const char *value = (const char *)reading->config + option->offset;

	if (option->preset[0] == '\0' && value[0] == '\0')
		print_line(reading, option, false, "yes", "");
}

void config_print(struct config_reading *reading)
{
	const struct config_option *o;

	printf("# blobfieldd %s: the configuration in use, and where it is "
	    "from\n", BLOBFIELD_VERSION);
	for (o = config_options; o->name != NULL; o++) {
		if (o->kind == CONFIG_PRESET)
			print_preset(reading, o);
		else if (config_option_is_kept(o))
			print_option(reading, o);
	}
}
