#include "server/host.h"

#include <arpa/inet.h>
#include <ctype.h>
#include <netinet/in.h>
#include <stddef.h>
#include <string.h>
#include <strings.h>

#include "server/access.h"
#include "server/config.h"
#include "server/exchange.h"
#include "server/log.h"
#include "server/routes.h"
#include "server/server.h"

/* A name has 253 characters at most, and perhaps a dot at its end. */
#define NAME_MAX_LENGTH 254

/* Where a name's characters are, without what does not matter. */
struct name {
	const char *at;
	size_t length;
};

static struct name trim_dot(struct name n)
{
	if (n.length > 1 && n.at[n.length - 1] == '.')
		n.length--;
	return n;
}

static bool is_same(struct name a, struct name b)
{
	return a.length == b.length &&
	    strncasecmp(a.at, b.at, a.length) == 0;
}

/* The next of names, by commas and spaces; of length 0 at the end. *rest is moved
 * past it. */
static struct name next_name(const char **rest)
{
	const char *at = *rest + strspn(*rest, ", \t");
	struct name n = {at, strcspn(at, ", \t")};

	*rest = at + n.length;
	return n;
}

static bool is_name(struct name n)
{
	bool is_good = n.length > 0 && n.length <= NAME_MAX_LENGTH;

	for (size_t i = 0; i < n.length; i++) {
		const bool is_dot = n.at[i] == '.';
		const bool is_part = isalnum((unsigned char)n.at[i]) ||
		    n.at[i] == '-' || n.at[i] == '_';

		/* No part is empty, but one behind the last dot. */
		is_good = is_good && (is_part || (is_dot && i > 0 &&
		    n.at[i - 1] != '.'));
	}
	return is_good;
}

static bool is_address(struct name n)
{
	char text[INET6_ADDRSTRLEN + 1];
	struct in6_addr address;
	const bool is_v6 = n.length > 2 && n.at[0] == '[' &&
	    n.at[n.length - 1] == ']';

	if (is_v6)
		n = (struct name){n.at + 1, n.length - 2};
	if (n.length >= sizeof text)
		return false;
	memcpy(text, n.at, n.length);
	text[n.length] = '\0';
	return inet_pton(is_v6 ? AF_INET6 : AF_INET, text, &address) == 1;
}

bool host_names_are_valid(const char *names)
{
	const char *rest = names;
	struct name n;

	if (strcmp(names, "*") == 0 || names[0] == '\0')
		return true;
	n = next_name(&rest);
	if (n.length == 0) {
		log_write(LOG_ERROR, "--hosts: there is no name in '%s'",
		    names);
		return false;
	}
	for (; n.length > 0; n = next_name(&rest)) {
		if (is_name(n) || is_address(n))
			continue;
		log_write(LOG_ERROR, "--hosts: '%.*s' is no host name: "
		    "letters, digits, - _ and dots, without scheme and port; "
		    "[...] about an IPv6 address, which is allowed anyway; or "
		    "* alone",
		    (int)n.length, n.at);
		return false;
	}
	return true;
}

/* ---- one host ---- */

/* [address] or name, then ":port" or nothing, and blanks. */
static struct name without_port(const char *host)
{
	const char *end = host[0] == '[' ? strchr(host, ']') : NULL;
	struct name n = {host, strcspn(host, ": \t")};

	if (end != NULL)
		n.length = (size_t)(end + 1 - host);
	return n;
}

static bool is_local(struct name n)
{
	static const char local[] = "localhost";
	const size_t length = sizeof local - 1;
	const size_t before = n.length >= length ? n.length - length : 0;

	return is_name(n) && n.length >= length &&
	    is_same((struct name){n.at + before, length},
	    (struct name){local, length}) &&
	    (before == 0 || (before > 1 && n.at[before - 1] == '.'));
}

bool host_is_allowed(const struct config *config, const char *host)
{
	const struct name n = trim_dot(without_port(host));
	const struct name own = {config->host, strlen(config->host)};
	const char *rest = config->hosts;
	struct name listed;

	if (strcmp(config->hosts, "*") == 0 || is_address(n) || is_local(n))
		return true;
	if (is_name(n) && is_same(n, trim_dot(own)))
		return true;
	while (listed = next_name(&rest), listed.length > 0) {
		if (is_name(n) && is_same(n, trim_dot(listed)))
			return true;
	}
	return false;
}

/* ---- a request ---- */

static bool refuse(struct exchange *x, const char *host)
{
	const struct name n = without_port(host);

	exchange_reply_problem(x, PROBLEM_MISDIRECTED, NULL,
	    "This server is not to be asked as '%.*s': it answers to addresses, "
	    "localhost%s. If that name is meant for it, start it with --hosts "
	    "NAME[,NAME...].", n.length < 100 ? (int)n.length : 100, n.at,
	    x->server->config->hosts[0] != '\0' ? " and the names of --hosts" :
	    " and, as long as there are no tokens, to no other name");
	exchange_add_header(x, "Connection", "close");
	return false;
}

/* Of a target in absolute form the host is what counts (RFC 9112, section
 * 3.2.2). */
static bool check_authority(struct exchange *x, const char *at)
{
	const size_t length = strcspn(at, "/?#");
	char host[NAME_MAX_LENGTH + 8];

	if (length >= sizeof host)
		return refuse(x, at);
	memcpy(host, at, length);
	host[length] = '\0';
	return (strchr(host, '@') == NULL &&
	    host_is_allowed(x->server->config, host)) || refuse(x, host);
}

static bool is_probe_of_life(const struct exchange *x)
{
	return x->route != NULL && x->route->is_probe &&
	    x->route->role == ROLE_NONE;
}

bool host_check(struct exchange *x, const char *target)
{
	const struct config *config = x->server->config;
	const char *host = exchange_header(x, "Host");
	const char *scheme = strstr(target, "://");

	if (config->hosts[0] == '\0' && (config->insecure ||
	    access_is_closed(x->server->access)))
		return true;
	if (is_probe_of_life(x))
		return true;
	if (host != NULL && !host_is_allowed(config, host))
		return refuse(x, host);
	return target[0] == '/' || scheme == NULL ||
	    check_authority(x, scheme + 3);
}
