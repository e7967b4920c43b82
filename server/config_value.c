/*
 * Values of options, from text and to text.
 */
#include <ctype.h>
#include <errno.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/config_internal.h"

/* Of bytes and counts, and of sums of two of them. */
#define SIZE_MOST (SIZE_MAX >> 1)

static const char suffixes[] = "kMG";

static void *place(const struct config_option *option, struct config *config)
{
	return (char *)config + option->offset;
}

/* "64M" to bytes: a whole number with an optional k, M or G. What is too large
 * is SIZE_MAX. */
static bool read_size(const char *text, size_t *out)
{
	unsigned long long n;
	unsigned shift = 0;
	char *end;

	if (!isdigit((unsigned char)text[0]))
		return false;
	errno = 0;
	n = strtoull(text, &end, 10);
	if (*end != '\0') {
		const char *at = strchr(suffixes, *end == 'K' ? 'k' : *end);

		if (at == NULL || end[1] != '\0')
			return false;
		shift = 10 * (unsigned)(at - suffixes + 1);
	}
	*out = errno != 0 || n > SIZE_MOST >> shift ? SIZE_MAX :
	    (size_t)n << shift;
	return true;
}

/* The suffix that "1m", "1MB" or "1MiB" mean, or NULL. */
static const char *guess_suffix(const char *text)
{
	const char *at = text + strspn(text, "0123456789");
	const char *rest = at + 1;
	static const char small[] = "kmg";
	const char *found = *at != '\0' && at > text ? strchr(small,
	    tolower((unsigned char)*at)) : NULL;

	if (found == NULL)
		return NULL;
	rest += *rest == 'i';
	rest += *rest == 'B' || *rest == 'b';
	return *rest == '\0' ? suffixes + (found - small) : NULL;
}

static bool read_number(const struct config_option *option, const char *text,
    void *out, char *why)
{
	const size_t most = option->most > 0 ? option->most : SIZE_MOST;
	const char *suffix = guess_suffix(text);
	size_t n = 0;
	const bool is_number = read_size(text, &n);

	if (option->most > 0)
		snprintf(why, CONFIG_WHY_MAX, "a whole number from %zu to %zu",
		    option->least, option->most);
	else if (n > most)
		snprintf(why, CONFIG_WHY_MAX, "%zu at most", most);
	else if (suffix != NULL && strspn(text, "0123456789") < 20)
		snprintf(why, CONFIG_WHY_MAX, "written as %.*s%c",
		    (int)strspn(text, "0123456789"), text, *suffix);
	else
		snprintf(why, CONFIG_WHY_MAX, "a whole number above 0, with "
		    "k, M or G after it if you like");
	if (!is_number || n < option->least || n > most)
		return false;
	*(size_t *)out = n;
	return true;
}

static bool read_width(const char *text, void *out, char *why)
{
	size_t width;

	strcpy(why, "1, 2, 4, 8 or 16");
	if (!read_size(text, &width) || width == 0 || width > 16 ||
	    (width & (width - 1)) != 0)
		return false;
	*(int *)out = (int)width;
	return true;
}

static bool read_listen(const char *text, struct config *config, char *why)
{
	const char *colon = strrchr(text, ':');
	const char *host = text;
	size_t length;
	char *end;

	strcpy(why, "HOST:PORT, such as 127.0.0.1:7878, [::1]:7878 or "
	    "127.0.0.1:0");
	if (colon == NULL || !isdigit((unsigned char)colon[1]))
		return false;
	length = (size_t)(colon - text);
	if (host[0] == '[' && length > 2 && host[length - 1] == ']') {
		host++;
		length -= 2;
	} else if (memchr(host, ':', length) != NULL) {
		return false;
	}
	if (length == 0 || length >= sizeof config->host)
		return false;
	if (strtoul(colon + 1, &end, 10) > 65535 || *end != '\0' ||
	    strlen(colon + 1) >= sizeof config->port)
		return false;
	memcpy(config->host, host, length);
	config->host[length] = '\0';
	strcpy(config->port, colon + 1);
	return true;
}

/* One line, so that it can be printed as one. */
static bool is_plain(const char *text)
{
	for (; *text != '\0'; text++) {
		if (iscntrl((unsigned char)*text))
			return false;
	}
	return true;
}

static bool read_text(const struct config_option *option, const char *text,
    void *out, char *why)
{
	snprintf(why, CONFIG_WHY_MAX, "a text of 1 to %zu bytes, without "
	    "control characters", option->size - 1);
	if (text[0] == '\0' || strlen(text) >= option->size || !is_plain(text))
		return false;
	strcpy(out, text);
	return true;
}

/* "a, b or c" */
static void list_names(const char *const *names, char *out)
{
	int at = 0;

	for (int i = 0; names[i] != NULL; i++)
		at += snprintf(out + at, CONFIG_WHY_MAX - (size_t)at, "%s%s",
		    i == 0 ? "" : names[i + 1] != NULL ? ", " : " or ",
		    names[i]);
}

static int find_name(const char *const *names, const char *text)
{
	for (int i = 0; names[i] != NULL; i++) {
		if (strcmp(names[i], text) == 0)
			return i;
	}
	return -1;
}

static bool read_choice(const struct config_option *option, const char *text,
    void *out, char *why)
{
	int i = find_name(option->names, text);

	list_names(option->names, why);
	if (i < 0)
		return false;
	*(int *)out = i; /* enums of the table have int's size: config.c */
	return true;
}

bool config_value_is(const char *text, bool *out)
{
	static const char *const words[] = {"no", "yes", "false", "true",
	    "off", "on", "0", "1", NULL};
	int i = find_name(words, text);

	if (i < 0)
		return false;
	*out = i % 2 == 1;
	return true;
}

static bool read_switch(const struct config_option *option, const char *text,
    bool *out, char *why)
{
	bool is;

	strcpy(why, "yes or no");
	if (!config_value_is(text, &is))
		return false;
	*out = is == option->yes;
	return true;
}

static bool read_token(const char *text, struct config *config, char *why)
{
	static const char *const roles[] = {"read", "evaluate", "write",
	    "admin", NULL};
	const char *colon = strrchr(text, ':');

	strcpy(why, "NAME:ROLE, the role read, evaluate, write or admin");
	if (colon == NULL || colon == text || !is_plain(text) ||
	    strlen(text) >= sizeof config->token ||
	    find_name(roles, colon + 1) < 0)
		return false;
	strcpy(config->token, text);
	config->token[colon - text] = '\0';
	config->make_token[0] = config->token;
	config->make_token[1] = config->token + (colon - text) + 1;
	return true;
}

bool config_value_read(const struct config_option *option, const char *text,
    struct config *config, char why[static CONFIG_WHY_MAX])
{
	void *out = place(option, config);

	switch (option->kind) {
	case CONFIG_LISTEN:
		return read_listen(text, config, why);
	case CONFIG_BYTES:
	case CONFIG_NUMBER:
		return read_number(option, text, out, why);
	case CONFIG_WIDTH:
		return read_width(text, out, why);
	case CONFIG_TEXT:
	case CONFIG_URL:
		return read_text(option, text, out, why);
	case CONFIG_CHOICE:
		return read_choice(option, text, out, why);
	case CONFIG_SWITCH:
	case CONFIG_DEED:
		return read_switch(option, text, out, why);
	case CONFIG_TOKEN:
		return read_token(text, config, why);
	case CONFIG_PRESET:
	case CONFIG_PATH:
		break;
	}
	return true;
}

/* With the largest suffix that leaves a whole number. */
static void print_bytes(size_t n, char *text)
{
	int i = 0;

	while (suffixes[i] != '\0' && n > 0 && n % 1024 == 0) {
		n /= 1024;
		i++;
	}
	snprintf(text, CONFIG_VALUE_MAX, "%zu%.1s", n,
	    i > 0 ? suffixes + i - 1 : "");
}

static void print_listen(const struct config *config, char *text)
{
	bool is_bare = strchr(config->host, ':') != NULL;

	snprintf(text, CONFIG_VALUE_MAX, "%s%s%s:%s", is_bare ? "[" : "",
	    config->host, is_bare ? "]" : "", config->port);
}

bool config_value_print(const struct config_option *option,
    const struct config *config, char text[static CONFIG_VALUE_MAX])
{
	const void *in = (const char *)config + option->offset;

	text[0] = '\0';
	switch (option->kind) {
	case CONFIG_LISTEN:
		print_listen(config, text);
		break;
	case CONFIG_BYTES:
		print_bytes(*(const size_t *)in, text);
		break;
	case CONFIG_NUMBER:
		snprintf(text, CONFIG_VALUE_MAX, "%zu", *(const size_t *)in);
		break;
	case CONFIG_WIDTH:
		if (*(const int *)in > 0)
			snprintf(text, CONFIG_VALUE_MAX, "%d", *(const int *)in);
		break;
	case CONFIG_TEXT:
	case CONFIG_URL:
		snprintf(text, CONFIG_VALUE_MAX, "%s", (const char *)in);
		break;
	case CONFIG_CHOICE:
		strcpy(text, option->names[*(const int *)in]);
		break;
	case CONFIG_SWITCH:
		strcpy(text, *(const bool *)in == option->yes ? "yes" : "no");
		break;
	case CONFIG_PRESET:
	case CONFIG_DEED:
	case CONFIG_TOKEN:
	case CONFIG_PATH:
		break;
	}
	return text[0] != '\0';
}

/* RFC 3986, section 3.2.1: userinfo is what is before the authority's last @;
 * from its first colon on it is the password. */
bool config_value_hide(const char *url, char text[static CONFIG_VALUE_MAX])
{
	const char *begin = strstr(url, "://");
	const char *at = NULL, *colon;

	snprintf(text, CONFIG_VALUE_MAX, "%s", url);
	if (begin == NULL)
		return false;
	begin += 3;
	/* One that is not escaped may hold a slash. */
	at = strrchr(begin, '@');
	if (at == NULL)
		return false;
	colon = memchr(begin, ':', (size_t)(at - begin));
	if (colon == NULL)
		return false;
	snprintf(text, CONFIG_VALUE_MAX, "%.*s***%s", (int)(colon + 1 - url),
	    url, at);
	return true;
}
