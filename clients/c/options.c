#include "clients/c/options.h"

#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

bool options_vector(const char *text, double out[static 3])
{
	double v[3];

	for (int i = 0; i < 3; i++) {
		char *end;

		v[i] = strtod(text, &end);
		if (end == text || !isfinite(v[i]) ||
		    *end != (i < 2 ? ',' : '\0'))
			return false;
		text = end + 1;
	}
	memcpy(out, v, sizeof v);
	return true;
}

/* NULL, or what value must be. */
static const char *store(const struct options_rule *rule, const char *value)
{
	struct options_vector *vector = rule->out;
	struct options_list *list = rule->out;
	char *end;
	double number;

	switch (rule->kind) {
	case OPTIONS_FLAG:
		*(bool *)rule->out = true;
		return NULL;
	case OPTIONS_TEXT:
		*(const char **)rule->out = value;
		return NULL;
	case OPTIONS_VECTOR:
		vector->is_there = options_vector(value, vector->v);
		return vector->is_there ? NULL : "three numbers, x,y,z";
	case OPTIONS_LIST:
		if (list->count == OPTIONS_LIST_MAX)
			return "there not more than 64 times";
		list->texts[list->count++] = value;
		return NULL;
	case OPTIONS_WHOLE:
	case OPTIONS_NUMBER:
		break;
	}
	number = strtod(value, &end);
	if (end == value || *end != '\0' || !isfinite(number))
		return "a number";
	if (rule->kind == OPTIONS_NUMBER) {
		*(double *)rule->out = number;
		return NULL;
	}
	if (number < 1 || number > INT_MAX || number != floor(number))
		return "a whole number above 0";
	*(int *)rule->out = (int)number;
	return NULL;
}

static const struct options_rule *find(const struct options_rule *rules,
    const char *name, size_t length, char letter)
{
	for (; rules != NULL && rules->name != NULL; rules++)
		if (letter != 0 ? rules->letter == letter :
		    strlen(rules->name) == length &&
		    memcmp(rules->name, name, length) == 0)
			return rules;
	return NULL;
}

/* The option at argv[0]; how many arguments it takes, 0: message. */
static int read_one(const struct options_rule *rules,
    const struct options_rule *more, int argc, char **argv, char *message,
    size_t size)
{
	const char *text = argv[0], *value = NULL, *wrong;
	const bool is_long = text[1] == '-';
	const char letter = is_long ? 0 : text[1];
	const size_t length = is_long ? strcspn(text + 2, "=") : 0;
	const struct options_rule *rule = find(rules, text + 2, length,
	    letter);
	int taken = 1;

	if (rule == NULL)
		rule = find(more, text + 2, length, letter);
	if (rule == NULL) {
		snprintf(message, size, "unknown option '%s'", text);
		return 0;
	}
	if (is_long && text[2 + length] == '=')
		value = text + 3 + length;
	else if (!is_long && text[2] != '\0')
		value = text + 2;
	if (rule->kind == OPTIONS_FLAG && value != NULL) {
		snprintf(message, size, "--%s takes no value", rule->name);
		return 0;
	}
	if (rule->kind != OPTIONS_FLAG && value == NULL) {
		value = argc > 1 ? argv[1] : NULL;
		taken = 2;
		if (value == NULL) {
			snprintf(message, size, "--%s needs a value",
			    rule->name);
			return 0;
		}
	}
	wrong = store(rule, value);
	if (wrong != NULL) {
		snprintf(message, size, "--%s must be %s, not '%s'",
		    rule->name, wrong, value);
		return 0;
	}
	return taken;
}

bool options_read(const struct options_rule *rules,
    const struct options_rule *more, int argc, char **argv, int *count,
    char *message, size_t size)
{
	int kept = 0;

	for (int i = 0; i < argc;) {
		int taken;

		/* "-" alone is a file; so is what follows "--". */
		if (argv[i][0] != '-' || argv[i][1] == '\0') {
			argv[kept++] = argv[i++];
			continue;
		}
		if (strcmp(argv[i], "--") == 0) {
			for (i++; i < argc; i++)
				argv[kept++] = argv[i];
			break;
		}
		taken = read_one(rules, more, argc - i, argv + i, message,
		    size);
		if (taken == 0)
			return false;
		i += taken;
	}
	*count = kept;
	return true;
}

void options_help(FILE *out, const struct options_rule *rules)
{
	for (; rules->name != NULL; rules++) {
		char head[64];

		snprintf(head, sizeof head, "--%s%s%s", rules->name,
		    rules->argument != NULL ? " " : "",
		    rules->argument != NULL ? rules->argument : "");
		if (rules->letter != 0)
			fprintf(out, "  -%c, %-20s %s\n", rules->letter, head,
			    rules->help);
		else
			fprintf(out, "      %-20s %s\n", head, rules->help);
	}
}
