#include "server/backing_redis_url.h"

#include <ctype.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define DEFAULT_PORT 6379
#define LAST_DATABASE 65535

/* length characters of text as a string; false: they do not fit. */
static bool copy(char *out, size_t size, const char *text, size_t length)
{
	if (length >= size)
		return false;
	memcpy(out, text, length);
	out[length] = '\0';
	return true;
}

static int hex_digit(char c)
{
	if (c >= '0' && c <= '9')
		return c - '0';
	c = (char)tolower((unsigned char)c);
	return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

/* The same, %XX undone; false also for %00 and half ones. */
static bool copy_escaped(char *out, size_t size, const char *text,
    size_t length)
{
	size_t used = 0;

	for (size_t i = 0; i < length; i++) {
		char c = text[i];

		if (c == '%') {
			bool whole = i + 2 < length;
			int high = whole ? hex_digit(text[i + 1]) : -1;
			int low = whole ? hex_digit(text[i + 2]) : -1;

			if (high < 0 || low < 0)
				return false;
			c = (char)(high << 4 | low);
			i += 2;
		}
		if (c == '\0' || used + 1 >= size)
			return false;
		out[used++] = c;
	}
	out[used] = '\0';
	return true;
}

/* A whole number of up to most, all of text. */
static bool read_number(const char *text, size_t length, long most, int *out)
{
	long value = 0;

	if (length == 0 || length > 5)
		return false;
	for (size_t i = 0; i < length; i++) {
		if (!isdigit((unsigned char)text[i]))
			return false;
		value = value * 10 + (text[i] - '0');
	}
	if (value > most)
		return false;
	*out = (int)value;
	return true;
}

static bool read_prefix(const char *text, size_t length,
    struct backing_redis_url *url)
{
	static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
	    "abcdefghijklmnopqrstuvwxyz0123456789_.-:";
	char name[BACKING_REDIS_PREFIX_MAX + 1];

	if (length == 0 || !copy(name, sizeof name, text, length) ||
	    strspn(name, letters) != length)
		return false;
	snprintf(url->prefix, sizeof url->prefix, "{%s}:", name);
	return true;
}

/* NAME=FILE of a query, length characters, if that is what it is; *why: it is, but
 * cannot be read. */
static bool read_file(const char *at, size_t length,
    struct backing_redis_url *url, const char **why)
{
	const struct {
		const char *name;
		char *out;
		size_t size;
	} files[] = {
		{"ca=", url->ca, sizeof url->ca},
		{"cert=", url->cert, sizeof url->cert},
		{"key=", url->key, sizeof url->key},
	};

	for (size_t i = 0; url->is_tls && i < sizeof files / sizeof *files;
	    i++) {
		const size_t n = strlen(files[i].name);

		if (strncmp(at, files[i].name, n) != 0)
			continue;
		if (length == n || !copy_escaped(files[i].out, files[i].size,
		    at + n, length - n))
			*why = "a file's name is empty, too long, or has a % "
			    "that is not %XX";
		return true;
	}
	return false;
}

static const char *check_files(const struct backing_redis_url *url)
{
	return (url->cert[0] != '\0') == (url->key[0] != '\0') ? NULL :
	    "of cert= and key= there are both, or none";
}

static const char *read_query(const char *at, struct backing_redis_url *url)
{
	const char *why = NULL;

	while (*at != '\0') {
		size_t length = strcspn(at, "&");

		if (strncmp(at, "prefix=", 7) == 0) {
			if (!read_prefix(at + 7, length - 7, url))
				return "prefix has 1 to 64 of A-Z a-z 0-9 _ . "
				    "- :";
		} else if (strncmp(at, "database=", 9) == 0) {
			if (!read_number(at + 9, length - 9, LAST_DATABASE,
			    &url->database))
				return "database is a whole number";
		} else if (!read_file(at, length, url, &why)) {
			return url->is_tls ? "of a query only prefix=, "
			    "database=, ca=, cert= and key= are known" :
			    "of a query only prefix= and database= are known "
			    "(and of rediss:// ca=, cert= and key=)";
		}
		if (why != NULL)
			return why;
		at += length + (at[length] == '&');
	}
	return check_files(url);
}

/* user:password, length characters. */
static const char *read_user(const char *at, size_t length,
    struct backing_redis_url *url)
{
	const char *colon = memchr(at, ':', length);
	size_t name = colon != NULL ? (size_t)(colon - at) : 0;

	if (colon == NULL)
		return "before @ there is user:password, or :password";
	if (!copy_escaped(url->user, sizeof url->user, at, name) ||
	    !copy_escaped(url->password, sizeof url->password, colon + 1,
	    length - name - 1) || url->password[0] == '\0')
		return "user or password is empty, too long, or has a % that "
		    "is not %XX";
	return NULL;
}

/* host[:port], [address]:port */
static const char *read_host(const char *at, size_t length,
    struct backing_redis_url *url)
{
	size_t host;

	if (length > 0 && at[0] == '[') {
		const char *end = memchr(at, ']', length);

		if (end == NULL)
			return "the address has no ]";
		host = (size_t)(end - at) + 1;
		if (!copy(url->host, sizeof url->host, at + 1, host - 2))
			return "the host is too long";
	} else {
		host = strcspn(at, ":/?");
		host = host < length ? host : length;
		if (!copy(url->host, sizeof url->host, at, host))
			return "the host is too long";
	}
	if (url->host[0] == '\0')
		return "there is no host";
	url->port = DEFAULT_PORT;
	if (host < length && (at[host] != ':' || !read_number(at + host + 1,
	    length - host - 1, 65535, &url->port) || url->port == 0))
		return "the port is a number from 1 to 65535";
	return NULL;
}

/* host[:port][/database][?query] */
static const char *read_network(const char *at, struct backing_redis_url *url)
{
	size_t length = strcspn(at, "/?");
	const char *why = read_host(at, length, url);

	if (why != NULL)
		return why;
	snprintf(url->shown, sizeof url->shown, "%s:%d", url->host, url->port);
	at += length;
	if (*at == '/') {
		length = strcspn(++at, "?");
		if (length > 0 && !read_number(at, length, LAST_DATABASE,
		    &url->database))
			return "the database is a whole number";
		at += length;
	}
	return *at == '?' ? read_query(at + 1, url) : NULL;
}

/* /path[?query] */
static const char *read_path(const char *at, struct backing_redis_url *url)
{
	size_t length = strcspn(at, "?");

	/* The size of sockaddr_un's. */
	if (*at != '/' || length >= 108 ||
	    !copy(url->host, sizeof url->host, at, length))
		return "redis+unix:// is followed by an absolute path of at "
		    "most 107 characters";
	snprintf(url->shown, sizeof url->shown, "%s", url->host);
	return at[length] == '?' ? read_query(at + length + 1, url) : NULL;
}

static const char *parse(const char *text, struct backing_redis_url *url)
{
	bool is_path = strncmp(text, "redis+unix://", 13) == 0;
	const char *at = strstr(text, "://"), *end, *why;

	url->is_tls = strncmp(text, "rediss://", 9) == 0;
	if (!is_path && !url->is_tls && strncmp(text, "redis://", 8) != 0)
		return "it begins neither with redis:// nor rediss:// nor "
		    "redis+unix://";
	at += 3;
	end = at + strcspn(at, "/?");
	while (end > at && *end != '@')
		end--;
	if (*end == '@') {
		why = read_user(at, (size_t)(end - at), url);
		if (why != NULL)
			return why;
		at = end + 1;
	}
	return is_path ? read_path(at, url) : read_network(at, url);
}

enum err backing_redis_url_parse(const char *text,
    struct backing_redis_url *out, const char **why)
{
	struct backing_redis_url url = {.prefix = "{blobfield}:"};
	const char *reason = parse(text, &url);

	if (reason != NULL) {
		*why = reason;
		return ERR_INVALID;
	}
	*out = url;
	return ERR_OK;
}
